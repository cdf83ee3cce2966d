"""A stand-in passes on what its ADS-B receiver hears as its autopilot does: asked and listed, or at once."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from companion.geo.local_frame import LocalFrame
from sim.mavlink_sender import MavlinkSender
from sim.vehicles import CRAFTS, Setup, StandIn

ADSB = common.MAVLINK_MSG_ID_ADSB_VEHICLE
TRANSPONDER = MavlinkSender(9, common.MAV_COMP_ID_ADSB)
ASKER = MavlinkSender(1, common.MAV_COMP_ID_ONBOARD_COMPUTER)


def stand_in(kind: str, receiver: float = 1.0) -> StandIn:
    vehicle = StandIn(CRAFTS[kind], Setup(1, LocalFrame(47.0, 8.0), altitude_m=530.0, in_air=True, armed=True))
    if kind.startswith("ardu"):
        vehicle.parameters["ADSB_TYPE"] = receiver
    return vehicle


def contact(address: int) -> bytes:
    place = (address, 470000000, 80000000, common.ADSB_ALTITUDE_TYPE_GEOMETRIC, 530_000)
    callsign = f"OW{address:05d}".encode()
    return TRANSPONDER.pack(TRANSPONDER.mav.adsb_vehicle_encode(*place, 0, 500, 0, callsign, 14, 0, 0x1F, 0))


def ask(vehicle: StandIn, rate_hz: float) -> list[bytes]:
    interval_us = -1.0 if rate_hz == 0.0 else 1e6 / rate_hz
    message = ASKER.mav.command_long_encode(
        *(1, 1, common.MAV_CMD_SET_MESSAGE_INTERVAL, 0, float(ADSB), interval_us, 0.0, 0.0, 0.0, 0.0, 0.0)
    )
    return vehicle.receive(ASKER.pack(message), 0.0)


def heard(vehicle: StandIn, addresses: tuple[int, ...], until_s: float, silent_from_s: float = 1e9) -> list[Any]:
    """Return the ADSB_VEHICLE messages of a stand-in beside transponders that are heard twice a second."""
    messages = []
    for tenth in range(round(until_s * 10.0)):
        t_s = 0.1 * tenth
        vehicle.step_to(t_s)
        calls = [contact(address) for address in addresses] if tenth % 5 == 0 and t_s < silent_from_s else []
        for frame in vehicle.hear_adsb(calls, t_s) + vehicle.telemetry(t_s):
            for message in common.MAVLink(None).parse_buffer(frame) or ():
                if message.get_type() == "ADSB_VEHICLE":
                    messages.append((t_s, message))
    return messages


@pytest.mark.parametrize("kind", ["arducopter", "arduplane"])
def test_ardupilot_sends_nobody_unless_it_is_asked(kind: str) -> None:
    assert heard(stand_in(kind), (2,), 5.0) == []


def test_ardupilot_asked_sends_each_about_once_a_second_one_at_a_time() -> None:
    vehicle = stand_in("arducopter")
    ask(vehicle, 10.0)
    assert len(heard(vehicle, (2,), 8.0)) in (8, 9)
    both = heard(stand_in("arducopter"), (2, 3), 0.1)
    assert both == []
    vehicle = stand_in("arduplane")
    ask(vehicle, 10.0)
    both = heard(vehicle, (2, 3), 3.0)
    assert [message.ICAO_address for _, message in both] == [2, 3] * 3
    assert len({t_s for t_s, _ in both}) == 6


def test_ardupilot_without_a_receiver_sends_nobody_though_it_acknowledges() -> None:
    vehicle = stand_in("arducopter", receiver=0.0)
    (ack,) = [common.MAVLink(None).parse_buffer(frame)[0] for frame in ask(vehicle, 10.0)]
    assert ack.result == common.MAV_RESULT_ACCEPTED
    assert heard(vehicle, (2,), 5.0) == []


def test_ardupilot_says_how_old_its_word_is_and_forgets_who_falls_silent() -> None:
    vehicle = stand_in("arducopter")
    ask(vehicle, 10.0)
    silent = [(t_s, message.tslc) for t_s, message in heard(vehicle, (2,), 12.0, silent_from_s=1.1)]
    assert max(tslc for _, tslc in silent) in (4, 5)
    assert max(t_s for t_s, _ in silent) < 1.1 + 6.0


@pytest.mark.parametrize("kind", ["px4-copter", "px4-plane"])
def test_px4_passes_on_each_at_once_without_being_asked(kind: str) -> None:
    assert len(heard(stand_in(kind), (2, 3), 4.0)) == 16


@pytest.mark.parametrize("kind", ["px4-copter", "arducopter"])
def test_what_comes_from_another_system_is_passed_on_as_the_autopilots_own_and_rubbish_is_not(kind: str) -> None:
    vehicle = stand_in(kind)
    ask(vehicle, 10.0)
    messages = [message for _, message in heard(vehicle, (2,), 2.0)]
    assert {message.get_srcSystem() for message in messages} == {1}
    assert vehicle.hear_adsb([b"", b"rubbish", bytes(300)], 2.0) == []
