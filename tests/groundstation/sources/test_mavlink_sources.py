"""Agents by their telemetry and aircraft by ADSB_VEHICLE, from the frames of stand-ins and of pymavlink."""

from __future__ import annotations

import math
from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.protocol.codec import GROUND_SYSTEM
from groundstation.sources.mavlink import AdsbParser, TelemetryParser
from groundstation.sources.sighting import NO_PLACE, Category, Datum, Sighting
from sim.vehicles import CRAFTS, Setup, StandIn
from tests.groundstation.sources.given import FRAME, START_S

KINDS = ("arducopter", "arduplane", "px4-copter")
FLAGS = (
    common.ADSB_FLAGS_VALID_COORDS
    | common.ADSB_FLAGS_VALID_ALTITUDE
    | common.ADSB_FLAGS_VALID_HEADING
    | common.ADSB_FLAGS_VALID_VELOCITY
    | common.ADSB_FLAGS_VALID_CALLSIGN
)


@cache
def of_three() -> list[tuple[float, bytes]]:
    """Return what three stand-ins, systems 1 to 3, send on one link within some seconds, with times of arrival."""
    sent = []
    for number, kind in enumerate(KINDS):
        speed_m_s = 20.0 if kind == "arduplane" else 0.0
        setup = Setup(
            number + 1,
            FRAME,
            north_m=1_000.0 * number,
            altitude_m=560.0,
            speed_m_s=speed_m_s,
            in_air=True,
            armed=True,
            start_s=START_S,
        )
        vehicle = StandIn(CRAFTS[kind], setup)
        for tick in range(30):
            now_s = START_S + tick / 10.0
            vehicle.step_to(now_s)
            sent += [(now_s, frame) for frame in vehicle.telemetry(now_s)]
    return sorted(sent, key=lambda one: one[0])


def heard(frames: list[tuple[float, bytes]]) -> list[Sighting]:
    parser = TelemetryParser()
    return [seen for now_s, frame in frames for seen in parser.feed(frame, now_s)]


def position(mav: common.MAVLink, boot_ms: int, lat: int = 487_000_000, lon: int = 23_500_000, vx: int = 100) -> bytes:
    message = common.MAVLink_global_position_int_message(boot_ms, lat, lon, 600_000, 100_000, vx, 0, 0, 0)
    return bytes(message.pack(mav))


def aircraft(flags: int = FLAGS, tslc: int = 1, mav: common.MAVLink | None = None, lat: int = 487_000_000) -> bytes:
    message = common.MAVLink_adsb_vehicle_message(
        0x4B1C22, lat, 23_500_000, 0, 1_000_000, 9_000, 5_000, 0, b"SWR12", 1, tslc, flags, 7_000
    )
    return bytes(message.pack(mav or common.MAVLink(None, srcSystem=1, srcComponent=156)))


def test_three_vehicles_on_one_link_are_three_agents_where_they_are() -> None:
    seen = heard(of_three())
    assert {one.key for one in seen} == {"1", "2", "3"}
    for one in seen:
        north_m, east_m = FRAME.to_local(one.lat_deg, one.lon_deg)
        assert math.hypot(north_m - 1_000.0 * (int(one.key) - 1), east_m) < 100.0
    assert abs([one.velocity or 0j for one in seen if one.key == "2"][-1]) == pytest.approx(20.0, abs=3.0)


def test_what_a_router_copies_is_seen_once() -> None:
    twice = [one for frame in of_three() for one in (frame, (frame[0] + 0.02, frame[1]))]
    assert len(heard(twice)) == len(heard(of_three()))


@given(st.lists(st.integers(1, 60), max_size=20))
def test_telemetry_cut_anywhere_is_the_same(sizes: list[int]) -> None:
    stream = b"".join(frame for now_s, frame in of_three() if now_s < START_S + 0.3)
    parser, seen = TelemetryParser(), []
    for size in [*sizes, len(stream)]:
        seen += parser.feed(stream[:size], START_S)
        stream = stream[size:]
    assert {one.key for one in seen} == {"1", "2", "3"}


def test_both_versions_of_mavlink_are_read() -> None:
    mav = common.MAVLink(None, srcSystem=9, srcComponent=1)
    message = common.MAVLink_global_position_int_message(1_000, 487_000_000, 23_500_000, 0, 0, 0, 0, 0, 0)
    (first,) = TelemetryParser().feed(bytes(message.pack(mav, force_mavlink1=True)), START_S)
    (second,) = TelemetryParser().feed(bytes(message.pack(mav)), START_S)
    assert first == second


def test_frames_out_of_order_move_nothing_back() -> None:
    parser, mav = TelemetryParser(), common.MAVLink(None, srcSystem=1, srcComponent=1)
    assert len(parser.feed(position(mav, 2_000), START_S)) == 1
    assert parser.feed(position(mav, 1_500), START_S + 0.1) == []
    assert parser.refused.total() == 1


def test_an_autopilot_without_a_fix_is_nowhere() -> None:
    parser, mav = TelemetryParser(), common.MAVLink(None, srcSystem=1, srcComponent=1)
    assert parser.feed(position(mav, 1_000, 0, 0), START_S) == []
    assert parser.feed(position(mav, 2_000, 910_000_000, 0), START_S + 1.0) == []
    assert parser.refused == {NO_PLACE: 2}


def test_what_another_component_says_of_its_own_place_is_not_the_vehicles() -> None:
    parser = TelemetryParser()
    assert parser.feed(position(common.MAVLink(None, srcSystem=1, srcComponent=100), 1_000), START_S) == []
    assert parser.refused.total() == 1


def test_two_vehicles_with_one_system_id_are_believed_neither_and_named() -> None:
    parser, mav = TelemetryParser(), common.MAVLink(None, srcSystem=4, srcComponent=1)
    last = []
    for tick in range(100):
        now_s = START_S + tick / 5.0
        last = parser.feed(position(mav, 10_000 + 200 * tick), now_s)
        last += parser.feed(position(mav, 500_000 + 200 * tick, 489_000_000), now_s + 0.01)
    assert last == []
    assert any("system 4" in reason for reason in parser.refused)


def test_an_aircraft_of_adsb_is_where_its_flags_allow_to_say() -> None:
    (seen,) = AdsbParser().feed(aircraft(), START_S)
    assert (seen.key, seen.name, seen.category) == ("4B1C22", "SWR12", Category.AIRCRAFT)
    assert (seen.at_s, seen.altitude_m, seen.datum) == (START_S - 1.0, 1_000.0, Datum.PRESSURE)
    assert seen.velocity == pytest.approx(50j)


@pytest.mark.parametrize(
    ("flag", "field", "value"),
    [
        (common.ADSB_FLAGS_VALID_ALTITUDE, "altitude_m", None),
        (common.ADSB_FLAGS_VALID_VELOCITY, "velocity", None),
        (common.ADSB_FLAGS_VALID_HEADING, "velocity", None),
        (common.ADSB_FLAGS_VALID_CALLSIGN, "name", ""),
    ],
)
def test_what_a_flag_does_not_mark_as_valid_is_not_read(flag: int, field: str, value: object) -> None:
    (seen,) = AdsbParser().feed(aircraft(FLAGS & ~flag), START_S)
    assert getattr(seen, field) == value


@pytest.mark.parametrize(
    "data", [aircraft(FLAGS & ~common.ADSB_FLAGS_VALID_COORDS), aircraft(tslc=200), aircraft(lat=910_000_000)]
)
def test_an_aircraft_without_a_place_of_now_is_refused(data: bytes) -> None:
    parser = AdsbParser()
    assert parser.feed(data, START_S) == []
    assert parser.refused.total() == 1


def test_a_copy_of_an_aircraft_is_no_second_word_and_our_own_mirror_is_none() -> None:
    parser = AdsbParser()
    assert len(parser.feed(aircraft() * 3, START_S)) == 1
    mirror = common.MAVLink(None, srcSystem=GROUND_SYSTEM, srcComponent=common.MAV_COMP_ID_ADSB)
    assert parser.feed(aircraft(mav=mirror), START_S + 5.0) == []
