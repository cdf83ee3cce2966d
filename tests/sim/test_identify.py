"""Identification flown on the stand-ins of all kinds, in virtual time: what it measures beside what is known."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import pytest
from pymavlink.dialects.v20 import common

from companion.files.tlog import TlogWriter, read_tlog
from companion.onboard.authority import MODE_LEFT
from companion.onboard.config import Config, LimitsSection
from companion.onboard.identification.estimators import Identified, identify
from companion.onboard.identification.identifier import FLOWN, NO_ORIGIN
from companion.onboard.identification.service import table_of
from companion.onboard.identification.table import remedies
from companion.onboard.identification.track import track_of
from companion.onboard.limits import within
from tests.sim.identify_flight import LIMITS, IdentifyFlight, config_of, square_m

KINDS = ("arducopter", "px4-copter", "arduplane", "px4-plane")
WIND_M_S = (2.0, 1.5)
STORM_M_S = 30.0
"""Wind that no copter of these flights can fly against."""


@cache
def flown(kind: str) -> IdentifyFlight:
    """Return the flight of a whole pattern in wind, flown once for all tests."""
    flight = IdentifyFlight(config_of(kind), WIND_M_S)
    flight.fly()
    return flight


@cache
def found(kind: str) -> Identified:
    config = flown(kind).companion.config
    track = track_of(flown(kind).records, config)
    can_stop = flown(kind).companion.adapter.can_stop
    return identify(track, within(config.limits, track.abilities), can_stop)


def hand_over(flight: IdentifyFlight) -> None:
    flight.fly(lambda: flight.companion.steers)
    flight.fly(lambda: flight.companion.end is not None or flight.t_s > 12.0)


def change_mode(flight: IdentifyFlight) -> None:
    """Let a person choose LOITER, or what the kind calls so."""
    px4 = flight.vehicle.kind.startswith("px4")
    mode = (4.0, 3.0) if px4 else ({"arducopter": 17.0, "arduplane": 12.0}[flight.vehicle.kind], 0.0)
    command = common.MAVLink_command_long_message(1, 1, common.MAV_CMD_DO_SET_MODE, 0, 1.0, *mode, 0.0, 0.0, 0.0, 0.0)
    pilot = common.MAVLink(None, srcSystem=255, srcComponent=190)
    flight.vehicle.receive(bytes(command.pack(pilot)), flight.now_s)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_pattern_is_flown_in_one_to_two_minutes(kind: str) -> None:
    flight = flown(kind)
    assert flight.companion.end is not None and flight.companion.end.words == FLOWN
    assert 60.0 <= flight.sent_s[-1] - flight.sent_s[0] <= 130.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_reaction_is_the_adapters_own_to_what_is_known_of_it(kind: str) -> None:
    reaction_s = found(kind).reaction_s
    assert reaction_s is not None
    # tests/benchmarks/lags.py knows the adapters' REACTION_S to 0.05 s; telemetry at 10 Hz is up to 0.1 s old.
    known_s = flown(kind).companion.adapter.abilities.reaction_s
    assert reaction_s.low - 0.1 <= known_s <= reaction_s.high + 0.1


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_vehicle_that_obeys_is_asked_neither_for_more_reaction_nor_for_slower_turns(kind: str) -> None:
    asked = remedies(table_of(flown(kind).records, flown(kind).companion.config))
    assert not {"reaction_s", "rate_share"} & set(asked)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_stand_ins_turn_as_fast_as_their_adapters_ask(kind: str) -> None:
    share = found(kind).rate_share
    assert share is not None and share.high >= 0.99 and share.low > 0.85


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "name", "known_m_s2"),
    # docs/autopilots.md: WPNAV_ACCEL; ArduPlane's 3 m/s in 5.9 s are 0.6 m/s^2 and a lag; PX4 loses 7 m/s in 1 s.
    [
        ("arducopter", "acceleration_m_s2", 2.5),
        ("arducopter", "braking_m_s2", 2.5),
        ("px4-copter", "braking_m_s2", 7.0),
        ("arduplane", "acceleration_m_s2", 0.6),
    ],
)
def test_acceleration_and_braking_are_those_that_were_measured_of_the_autopilots(
    kind: str, name: str, known_m_s2: float
) -> None:
    estimate = getattr(found(kind), name)
    assert estimate.low * 0.9 <= known_m_s2 <= estimate.high * 1.1


@pytest.mark.slow
@pytest.mark.parametrize("kind", ("arduplane", "px4-plane"))
def test_a_plane_finds_wind_and_airspeed_from_its_circle(kind: str) -> None:
    wind, airspeed = found(kind).wind_m_s, found(kind).top_speed_m_s
    assert wind is not None and abs(wind.value - math.hypot(*WIND_M_S)) < 0.1
    assert found(kind).wind_ned_m_s == pytest.approx(WIND_M_S, abs=0.1)
    # True airspeed: what the autopilot is asked for as indicated one is less, 560 m above the sea.
    asked_m_s = flown(kind).companion.steering.config.limits.speed_m_s
    assert airspeed is not None and abs(airspeed.value - asked_m_s) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("kind", ("arducopter", "px4-copter"))
def test_a_copter_keeps_its_place_within_a_metre(kind: str) -> None:
    hold_m = found(kind).hold_m
    assert hold_m is not None and hold_m.high < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_at_its_end_a_copter_stands_and_nothing_more_is_sent(kind: str) -> None:
    flight = flown(kind)
    assert not flight.companion.steers
    if flight.companion.adapter.can_stop:
        assert flight.vehicle.truth.speed_m_s < 0.5


@pytest.mark.slow
def test_a_copter_that_is_weaker_than_its_parameters_say_is_found_out() -> None:
    flight = IdentifyFlight(config_of("arducopter"))
    flight.fly(lambda: flight.companion.steers)
    flight.vehicle.parameters["WPNAV_ACCEL"] = 90.0
    flight.fly()
    table = table_of(flight.records, flight.companion.config)
    asked = remedies(table)
    # It was asked for a lateral acceleration of 0.7 of 2.5 m/s^2, and has 0.9. A velocity that changes by so much turns
    # a right angle along the chord, which is shorter than the arc by 2 sqrt(2) / pi.
    assert 0.3 <= asked["rate_share"] <= 0.9 / 1.75 * math.pi / math.sqrt(8.0)
    assert asked["braking_m_s2"] <= 0.9


@pytest.mark.slow
def test_a_quadrotor_with_the_drag_that_px4_comes_with_is_found_out() -> None:
    flight = IdentifyFlight(config_of("px4-copter"))
    flight.vehicle.parameters["SIH_KDV"] = 1.0
    flight.fly()
    # The real PX4 with it: rate_share 0.7 and speed_m_s 7.1 (docs/identify.md).
    asked = remedies(table_of(flight.records, flight.companion.config))
    assert asked["rate_share"] == pytest.approx(0.7, abs=0.11)
    assert asked["speed_m_s"] == pytest.approx(7.1, abs=0.3)


@pytest.mark.slow
def test_a_log_read_from_its_file_gives_the_table_of_the_flight(tmp_path: object) -> None:
    flight = flown("arducopter")
    path = f"{tmp_path}/vehicle-1.tlog"
    with TlogWriter(path) as writer:
        for t_s, frame in flight.records:
            writer.write(t_s, frame)
    assert table_of(read_tlog(path), flight.companion.config) == table_of(flight.records, flight.companion.config)


@pytest.mark.parametrize("kind", KINDS)
def test_a_change_of_the_mode_ends_it_within_two_tenths_of_a_second(kind: str) -> None:
    flight = IdentifyFlight(config_of(kind))
    hand_over(flight)
    assert flight.companion.steers
    change_mode(flight)
    flight.fly(lambda: flight.companion.adapter.telemetry.custom_mode == flight.vehicle.mode)
    changed_s = flight.t_s
    for _ in range(30):
        flight.slot()
    assert flight.sent_s[-1] <= changed_s
    assert flight.over and flight.companion.end is not None and MODE_LEFT in flight.companion.end.words


def test_a_copter_that_loses_its_gps_is_told_to_stand_and_then_nothing() -> None:
    flight = IdentifyFlight(config_of("arducopter"))
    hand_over(flight)
    flight.vehicle.lose_gps(True)
    flight.fly()
    assert flight.companion.end is not None and "GPS" in flight.companion.end.words
    assert flight.asked_m_s[-1] == 0.0


def test_a_plane_with_a_low_battery_gets_no_further_setpoint() -> None:
    flight = IdentifyFlight(config_of("arduplane"))
    hand_over(flight)
    flight.vehicle.battery.percent = 10.0
    low_s = flight.t_s
    flight.fly()
    assert flight.companion.end is not None and flight.companion.end.words == "battery low"
    assert flight.sent_s[-1] <= low_s + 2.0


def test_with_a_low_battery_it_does_not_begin() -> None:
    flight = IdentifyFlight(config_of("arducopter"))
    flight.vehicle.battery.percent = 10.0
    flight.fly(lambda: flight.t_s > 6.0)
    assert flight.said[-1] == "battery low" and flight.sent_s == []


def test_silence_of_the_autopilot_ends_it() -> None:
    flight = IdentifyFlight(config_of("px4-copter"))
    hand_over(flight)
    flight.silent = True
    flight.fly()
    assert flight.companion.end is not None and not flight.companion.end.complete
    assert not flight.companion.steers


def test_without_room_inside_the_fence_it_refuses_with_the_numbers_before_flying() -> None:
    flight = IdentifyFlight(config_of("arducopter", limits=limits_with(fence=square_m(60.0))))
    flight.tell_origin()
    flight.fly()
    assert flight.sent_s == []
    assert flight.companion.end is not None
    assert flight.companion.end.words.startswith("not enough room: the pattern is up to ")


def test_inside_a_fence_with_room_it_flies_and_keeps_its_margin() -> None:
    flight = IdentifyFlight(config_of("arducopter", limits=limits_with(fence=square_m(450.0))))
    flight.tell_origin()
    hand_over(flight)
    assert flight.companion.steers


def blown(flight: IdentifyFlight) -> Callable[[], bool]:
    """Return what blows the vehicle to the north, by a wind that it cannot fly against."""

    def blow() -> bool:
        flight.vehicle.wind_m_s = (STORM_M_S, 0.0)
        return False

    return blow


def test_a_vehicle_blown_to_the_fence_is_told_to_stand() -> None:
    flight = IdentifyFlight(config_of("arducopter", limits=limits_with(fence=square_m(450.0))))
    flight.tell_origin()
    hand_over(flight)
    flight.fly(blown(flight))
    assert flight.companion.end is not None and "m to fence or disc" in flight.companion.end.words
    assert flight.asked_m_s[-1] == 0.0


def test_a_vehicle_that_does_not_turn_is_not_left_to_fly_on() -> None:
    flight = IdentifyFlight(config_of("arducopter"))
    hand_over(flight)
    flight.fly(blown(flight))
    assert flight.companion.end is not None
    assert flight.companion.end.words.startswith("it does not fly what it is asked to")
    assert flight.asked_m_s[-1] == 0.0


def test_a_fence_whose_origin_is_not_known_is_waited_for() -> None:
    flight = IdentifyFlight(config_of("arducopter", limits=limits_with(fence=square_m(450.0))))
    flight.fly(lambda: flight.t_s > 6.0)
    assert flight.said[-1] == NO_ORIGIN and flight.sent_s == []


def test_outside_the_heights_it_does_not_begin() -> None:
    flight = IdentifyFlight(config_of("arducopter", limits=limits_with(height_max_m=50.0), height_m=30.0))
    flight.fly(lambda: flight.t_s > 6.0)
    assert flight.said[-1].startswith("at a height of 60 m") and flight.sent_s == []


def limits_with(**more: object) -> LimitsSection:
    return LimitsSection.model_validate(LIMITS["arducopter"].model_dump() | more)


def test_the_configuration_of_every_kind_is_one_that_flies() -> None:
    assert all(isinstance(config_of(kind), Config) for kind in LIMITS)
