"""The rule by which an autopilot passes messages on: a one-radio deployment stands and falls with it."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM
from companion.protocol.frame import raw_frame
from companion.protocol.v2_extension import unwrap, wrap
from sim.vehicles.routing import Router
from sim.vehicles.stand_in import parse

RADIO, COMPANION, THIRD = 0, 1, 2
HEARTBEAT = common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def packed(message: Any, system: int = 255, component: int = 190) -> bytes:  # noqa: ANN401
    return bytes(message.pack(common.MAVLink(None, srcSystem=system, srcComponent=component)))


def route(router: Router, link: int, datagram: bytes) -> list[tuple[int, bytes]]:
    return router.route(link, parse(datagram))


def connected() -> Router:
    """Return the router of system 1 with a ground station on the radio and a companion."""
    router = Router(1)
    route(router, RADIO, packed(HEARTBEAT))
    route(router, COMPANION, packed(HEARTBEAT, 1, 191))
    return router


KNOWN = {
    "V2_EXTENSION": common.MAVLink_v2_extension_message(0, 0, 0, 7, list(range(249))),
    "TUNNEL": common.MAVLink_tunnel_message(0, 0, 1, 128, list(range(128))),
    "HEARTBEAT": HEARTBEAT,
    "ADSB_VEHICLE": common.MAVLink_adsb_vehicle_message(1, 0, 0, 0, 0, 0, 0, 0, b"OW00001", 0, 0, 0, 0),
}


@pytest.mark.parametrize("name", sorted(KNOWN))
def test_what_is_known_and_for_everybody_goes_to_the_other_links_byte_for_byte(name: str) -> None:
    frame = packed(KNOWN[name])
    assert route(connected(), RADIO, frame) == [(COMPANION, frame)]


@pytest.mark.parametrize("message_id", [600, 42999, 51000, 0xA00001])
def test_an_unknown_message_goes_nowhere_in_either_direction(message_id: int) -> None:
    head = bytes([0xFD, 4, 0, 0, 0, 255, 190]) + message_id.to_bytes(3, "little")
    router = connected()
    for link in (RADIO, COMPANION):
        assert route(router, link, head + b"abcd" + b"\x12\x34") == []


def test_a_link_that_has_never_transmitted_gets_nothing() -> None:
    router = Router(1)
    frame = packed(KNOWN["V2_EXTENSION"])
    assert route(router, RADIO, frame) == []
    route(router, COMPANION, packed(HEARTBEAT, 1, 191))
    assert route(router, RADIO, frame) == [(COMPANION, frame)]


def test_what_is_for_one_system_goes_only_where_that_was_heard() -> None:
    router = connected()
    route(router, THIRD, packed(HEARTBEAT, 7, 1))
    for target, links in (((7, 1), [THIRD]), ((1, 191), [COMPANION]), ((7, 0), [THIRD]), ((9, 1), []), ((1, 1), [])):
        command = common.MAVLink_command_long_message(*target, 176, 0, 1, 4, 0, 0, 0, 0, 0)
        assert [link for link, _ in route(router, RADIO, packed(command))] == links


def test_its_own_words_that_come_back_over_a_loop_are_not_passed_on() -> None:
    assert route(connected(), RADIO, packed(HEARTBEAT, 1, 1)) == []


def test_a_radios_status_is_not_passed_on() -> None:
    status = common.MAVLink_radio_status_message(0, 0, 0, 0, 0, 0, 0)
    assert route(connected(), RADIO, packed(status)) == []


def test_a_broadcast_frame_wrapped_for_the_radio_reaches_the_companion_whole() -> None:
    inner = packed(KNOWN["TUNNEL"])
    frames = [wrap(inner, sequence, GROUND_SYSTEM, GROUND_COMPONENT) for sequence in range(3)]
    routed = route(connected(), RADIO, b"".join(frames))
    assert [unwrap(raw_frame(frame)) for _, frame in routed] == [inner] * 3
