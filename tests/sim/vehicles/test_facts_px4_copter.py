"""Each row of docs/autopilots.md on the PX4 copter that a client can observe holds on the stand-in."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from statistics import fmean

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from sim.vehicles.px4_copter import Px4Copter
from tests.sim.vehicles.px4_flight import (
    ACCEPTED,
    ALTITUDE,
    HOLD,
    LAND,
    NAN,
    OFFBOARD,
    POSITION,
    REJECTED,
    RETURN,
    STABILIZED,
    TAKE_OFF,
    UNSUPPORTED,
    Flight,
    Make,
    Message,
    local,
)

VELOCITY, VELOCITY_YAW, VELOCITY_YAW_RATE, VELOCITY_AND_HEIGHT, NO_VERTICAL = 0xDC7, 0x9C7, 0x5C7, 0xDE3, 0xDE7
FRAME_BODY_OFFSET = 12


@dataclass(frozen=True)
class Fact:
    """A row of the table: what is claimed, and what shows it on a fresh vehicle that holds at 100 m."""

    title: str
    holds: Callable[[Flight], bool]


def velocity(north_m_s: float, east_m_s: float = 0.0, mask: int = VELOCITY, **fields: float) -> Make:
    return lambda flight: local(mask, vx=north_m_s, vy=east_m_s, **fields)


def speeds(flight: Flight, times_s: tuple[float, ...], make: Make | None) -> list[float]:
    """Return the speeds over the ground at times after now."""
    began_s, found = flight.now_s, []
    for time_s in times_s:
        flight.run(began_s + time_s - flight.now_s, make)
        found.append(flight.speed_m_s)
    return found


def near(found: list[float], wanted: tuple[float, ...], within: float) -> bool:
    return all(abs(a - b) <= within for a, b in zip(found, wanted, strict=True))


def at_speed(flight: Flight, north_m_s: float = 10.0) -> Flight:
    flight.engage(velocity(north_m_s))
    flight.run(6.0, velocity(north_m_s))
    return flight


def steps_to(speed_m_s: float, times_s: tuple[float, ...], wanted_m_s: tuple[float, ...]) -> Callable[[Flight], bool]:
    def holds(flight: Flight) -> bool:
        flight.engage(velocity(0.0))
        return near(speeds(flight, times_s, velocity(speed_m_s)), wanted_m_s, 0.3)

    return holds


def stops_from_ten(flight: Flight) -> bool:
    return near(speeds(at_speed(flight), (1.0, 2.0), velocity(0.0)), (3.0, 0.4), 0.2)


def first_moves_after_a_fifth_of_a_second(flight: Flight) -> bool:
    flight.engage(velocity(0.0))
    early, late = speeds(flight, (0.1, 0.3), velocity(10.0))
    return early < 0.1 and late > 0.5


def mask_is_flown(make: Make) -> Callable[[Flight], bool]:
    def holds(flight: Flight) -> bool:
        flight.engage(make)
        flight.run(6.0, make)
        north_m_s, east_m_s = flight.velocity_m_s
        return abs(north_m_s - 3.0) < 0.1 and abs(east_m_s - 4.0) < 0.1

    return holds


def yaw_is_taken(flight: Flight) -> bool:
    flight.engage(velocity(3.0, mask=VELOCITY_YAW, yaw=1.5))
    flight.run(4.0, velocity(3.0, mask=VELOCITY_YAW, yaw=1.5))
    return bool(abs(flight.heard["ATTITUDE"].yaw - 1.5) < 0.01)


def yaw_stays_without_one(flight: Flight) -> bool:
    flight.engage(velocity(0.0, 5.0))
    flight.run(4.0, velocity(0.0, 5.0))
    return abs(flight.heard["ATTITUDE"].yaw) < 0.01 and flight.velocity_m_s[1] > 4.9


def yaw_rate_is_taken(flight: Flight) -> bool:
    make = velocity(3.0, mask=VELOCITY_YAW_RATE, yaw_rate=0.2)
    flight.engage(make)
    before_rad = flight.heard["ATTITUDE"].yaw
    flight.run(5.0, make)
    return bool(abs(flight.heard["ATTITUDE"].yaw - before_rad - 1.0) < 0.05)


def height_is_taken(flight: Flight) -> bool:
    make = velocity(3.0, mask=VELOCITY_AND_HEIGHT, z=-110.0)
    flight.engage(make)
    flight.run(12.0, make)
    return abs(flight.height_m - 110.0) < 0.2


def no_vertical_stops(flight: Flight) -> bool:
    at_speed(flight)
    flight.run(6.0, velocity(10.0, mask=NO_VERTICAL))
    return flight.speed_m_s < 0.2 and flight.mode == OFFBOARD


def nan_vertical_stops(flight: Flight) -> bool:
    at_speed(flight)
    flight.run(6.0, velocity(10.0, vz=NAN))
    return flight.speed_m_s < 0.2 and flight.mode == OFFBOARD


def is_no_stream(make: Make) -> Callable[[Flight], bool]:
    def holds(flight: Flight) -> bool:
        flight.set_parameter("COM_OBL_RC_ACT", 5.0)
        at_speed(flight, 5.0)
        flight.run(2.5, make)
        return flight.mode == HOLD and flight.critical

    return holds


def slow_stream_suffices(flight: Flight) -> bool:
    flight.engage(velocity(5.0))
    modes = set()
    flight.run(20.0, velocity(5.0), rate_hz=2.5, watch=lambda: modes.add(flight.mode))
    return modes == {OFFBOARD}


def refused_without_stream(flight: Flight) -> bool:
    results = flight.set_mode(OFFBOARD)
    flight.run(3.0)
    return results[-1] == REJECTED and flight.mode == HOLD


def refused_after_a_lapsed_stream(flight: Flight) -> bool:
    flight.run(2.0, velocity(0.0))
    flight.run(1.5)
    return bool(flight.set_mode(OFFBOARD)[-1] == REJECTED)


def entered_when_the_stream_is_a_second_old(flight: Flight) -> bool:
    flight.run(0.1, velocity(0.0))
    results = flight.set_mode(OFFBOARD)
    flight.run(0.7, velocity(0.0))
    early = flight.vehicle.mode
    flight.run(0.4, velocity(0.0))
    return results[-1] == ACCEPTED and early == 4 << 16 | 3 << 24 and flight.vehicle.mode == 6 << 16


def young_stream_that_ends_is_not_entered(flight: Flight) -> bool:
    flight.run(0.2, velocity(0.0))
    flight.set_mode(OFFBOARD)
    flight.run(4.0)
    return flight.mode == HOLD and not flight.critical


def mode_is_acknowledged_twice(flight: Flight) -> bool:
    return flight.set_mode(OFFBOARD) == [ACCEPTED, REJECTED] and flight.set_mode(RETURN) == [ACCEPTED, ACCEPTED]


def heartbeat_tells_the_mode_once_a_second(flight: Flight) -> bool:
    flight.run(0.5)
    answers = {answer.get_type() for answer in flight.send(_mode_message(RETURN))}
    early = flight.mode
    flight.run(1.0)
    return answers == {"COMMAND_ACK"} and early == HOLD and flight.mode == RETURN


def _mode_message(mode: tuple[int, int]) -> Message:
    number = common.MAV_CMD_DO_SET_MODE
    return common.MAVLink_command_long_message(1, 1, number, 0, 1.0, *mode, 0.0, 0.0, 0.0, 0.0)


def offboard_ends_after(timeout_s: float) -> Callable[[Flight], bool]:
    def holds(flight: Flight) -> bool:
        flight.set_parameter("COM_OBL_RC_ACT", 5.0)
        flight.set_parameter("COM_OF_LOSS_T", timeout_s)
        at_speed(flight)
        # The last setpoint was sent a tenth of a second ago.
        flight.run(timeout_s - 0.2)
        still = flight.vehicle.mode == 6 << 16
        flight.run(0.3)
        return still and flight.vehicle.mode == 4 << 16 | 3 << 24

    return holds


def lost(action: int, duration_s: float = 10.0) -> Callable[[Flight], Flight]:
    def fly(flight: Flight) -> Flight:
        flight.set_parameter("COM_OBL_RC_ACT", action)
        at_speed(flight)
        flight.run(0.9 + duration_s)
        assert flight.critical and flight.texts == []
        return flight

    return fly


def drifts_and_sinks(flight: Flight) -> bool:
    lost(0)(flight)
    return flight.mode == POSITION and flight.speed_m_s > 1.0 and abs(flight.climb_m_s + 0.7) < 0.02


def drifts(action: int, mode: tuple[int, int]) -> Callable[[Flight], bool]:
    def holds(flight: Flight) -> bool:
        lost(action)(flight)
        return flight.mode == mode and flight.speed_m_s > 1.0 and abs(flight.climb_m_s) < 0.02

    return holds


def returns(flight: Flight) -> bool:
    lost(3, 5.0)(flight)
    away_m = math.hypot(*flight.place_m)
    flight.run(6.0)
    return flight.mode == RETURN and math.hypot(*flight.place_m) < away_m - 20.0


def lands(flight: Flight) -> bool:
    lost(4)(flight)
    return flight.mode == LAND and flight.climb_m_s < -1.0


def holds_within_six_seconds(flight: Flight) -> bool:
    flight.set_parameter("COM_OBL_RC_ACT", 5)
    at_speed(flight)
    last_m = flight.place_m
    flight.run(7.0)
    slow, place_m = flight.speed_m_s < 0.6, flight.place_m
    flight.run(20.0)
    away_m = math.dist(last_m, place_m)
    holds = math.dist(place_m, flight.place_m) < 1.5 and abs(flight.height_m - 100) < 0.5
    return slow and flight.mode == HOLD and holds and abs(away_m - 33.5) < 2.5


def brakes_in_hold(flight: Flight) -> bool:
    at_speed(flight)
    flight.set_mode(HOLD)
    return near(speeds(flight, (1.0, 2.0, 3.0), None), (8.67, 5.7, 2.76), 1.4)


def turning(rate_deg_s: float, drag: float, speed_m_s: float, lag_deg: float) -> Callable[[Flight], bool]:
    """Return whether a velocity of 8 m/s that is turned each half second is followed at this mean speed and lag."""

    def holds(flight: Flight) -> bool:
        flight.set_parameter("SIH_KDV", drag)
        at_speed(flight, 8.0)
        began_s, flown_m_s, behind_deg = flight.now_s, [], []

        def turned(_flight: Flight) -> Message:
            asked_rad = math.radians(rate_deg_s) * 0.5 * math.floor((flight.now_s - began_s) / 0.5 + 1e-6)
            return local(VELOCITY, vx=8.0 * math.cos(asked_rad), vy=8.0 * math.sin(asked_rad))

        def watch() -> None:
            flown_m_s.append(flight.speed_m_s)
            behind_deg.append(-flight.offset_deg(rate_deg_s * (flight.now_s - began_s)))

        flight.run(20.0, turned)
        flight.run(360.0 / rate_deg_s, turned, watch=watch)
        return abs(fmean(flown_m_s) - speed_m_s) < 0.2 and abs(fmean(behind_deg) - lag_deg) < 1.5

    return holds


def sluggish(make: Make, times_s: tuple[float, ...], wanted_m_s: tuple[float, ...]) -> Callable[[Flight], bool]:
    """Return whether the speeds after a change of the velocity, with SIH_KDV 1, are those measured."""

    def holds(flight: Flight) -> bool:
        flight.set_parameter("SIH_KDV", 1.0)
        flight.engage(velocity(0.0))
        if make(flight).vx == 0.0:
            flight.run(25.0, velocity(10.0))
        return near(speeds(flight, times_s, make), wanted_m_s, 0.35)

    return holds


def stops_late_with_more_drag(flight: Flight) -> bool:
    flight.set_parameter("SIH_KDV", 1.0)
    flight.set_parameter("COM_OBL_RC_ACT", 5)
    flight.engage(velocity(8.0))
    flight.run(25.0, velocity(8.0))
    last_m = flight.place_m
    flight.run(7.0)
    return abs(math.dist(last_m, flight.place_m) - 25.0) < 1.5 and flight.speed_m_s < 0.6


def returns_to_offboard_by_itself(action: int) -> Callable[[Flight], bool]:
    def holds(flight: Flight) -> bool:
        lost(action, 5.0)(flight)
        flight.run(3.0, velocity(4.0))
        return flight.mode == OFFBOARD and not flight.critical and flight.speed_m_s > 3.8

    return holds


def stays_out_after_a_person_chose_another_mode(flight: Flight) -> bool:
    at_speed(flight)
    flight.set_mode(HOLD)
    flight.run(8.0, velocity(10.0))
    return flight.mode == HOLD and flight.speed_m_s < 0.3


def sticks_are_refused_in_flight(flight: Flight) -> bool:
    return bool(flight.set_mode(POSITION)[-1] == REJECTED)


def landed_in_offboard(flight: Flight) -> Flight:
    flight.engage(velocity(0.0, vz=1.5))
    flight.run(90.0, velocity(0.0, vz=1.5), rate_hz=5.0)
    flight.run(3.0)
    return flight


def reads_offboard_after_landing_and_will_not_arm(flight: Flight) -> bool:
    landed_in_offboard(flight)
    reads = flight.mode == OFFBOARD and flight.landed and not flight.armed
    denied = flight.command(common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == [REJECTED]
    flight.set_mode(HOLD)
    return reads and denied and flight.command(common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == [ACCEPTED]


def lands_without_gps_and_comes_back(flight: Flight) -> bool:
    at_speed(flight, 5.0)
    flight.vehicle.lose_gps(True)
    flight.run(5.8, velocity(5.0))
    before = flight.mode
    flight.run(1.4, velocity(5.0))
    landing, critical = flight.mode, flight.critical
    flight.run(8.0, velocity(5.0))
    height_m = flight.height_m
    flight.vehicle.lose_gps(False)
    flight.run(2.6, velocity(5.0))
    waits = flight.mode
    flight.run(4.0, velocity(5.0))
    back = flight.mode == OFFBOARD and flight.speed_m_s > 4.5
    return (before, landing, waits) == (OFFBOARD, LAND, LAND) and critical and height_m < 95.0 and back


def turns_a_body_velocity_with_the_nose(flight: Flight) -> bool:
    flight.engage(velocity(0.0, mask=VELOCITY_YAW, yaw=math.pi / 2.0))
    flight.run(3.0, velocity(0.0, mask=VELOCITY_YAW, yaw=math.pi / 2.0))
    flight.run(5.0, lambda _: local(VELOCITY_YAW_RATE, common.MAV_FRAME_BODY_NED, vx=5.0))
    return abs(flight.velocity_m_s[0]) < 0.1 and flight.velocity_m_s[1] > 4.9


def top_speed_is_the_parameter(flight: Flight) -> bool:
    flight.engage(velocity(30.0))
    flight.run(10.0, velocity(30.0))
    return abs(flight.speed_m_s - 12.0) < 0.2


FACTS = (
    Fact("5 m/s asked gives 3.9 at 1 s and 5.1 at 2 s", steps_to(5.0, (1.0, 2.0), (3.9, 5.1))),
    Fact("10 m/s asked gives 6.3, 9.4 and 9.95 at 1, 2 and 3 s", steps_to(10.0, (1.0, 2.0, 3.0), (6.3, 9.4, 9.95))),
    Fact("stop from 10 m/s leaves 3.0 at 1 s and 0.4 at 2 s", stops_from_ten),
    Fact("first motion after 0.2 s", first_moves_after_a_fifth_of_a_second),
    Fact("mask 0xDC7 flies the velocity", mask_is_flown(velocity(3.0, 4.0))),
    Fact("mask 0x9C7 flies the velocity", mask_is_flown(velocity(3.0, 4.0, VELOCITY_YAW, yaw=1.0))),
    Fact("mask 0x5C7 flies the velocity", mask_is_flown(velocity(3.0, 4.0, VELOCITY_YAW_RATE, yaw_rate=0.1))),
    Fact("mask 0xDE3 flies the velocity", mask_is_flown(velocity(3.0, 4.0, VELOCITY_AND_HEIGHT, z=-100.0))),
    Fact("mask 0x9C7 turns the nose to the yaw", yaw_is_taken),
    Fact("mask 0xDC7 leaves the nose where it is", yaw_stays_without_one),
    Fact("mask 0x5C7 turns at the yaw rate", yaw_rate_is_taken),
    Fact("mask 0xDE3 flies to the height", height_is_taken),
    Fact("ignoring both z and vz stops it, in OFFBOARD", no_vertical_stops),
    Fact("a NaN vertical velocity stops it as ignoring it does", nan_vertical_stops),
    Fact("a setpoint of NaN keeps no stream alive", is_no_stream(velocity(NAN, NAN, vz=NAN))),
    Fact("a setpoint that ignores all keeps no stream alive", is_no_stream(lambda _: local(0xDFF))),
    Fact("frame 12 keeps no stream alive", is_no_stream(lambda _: local(VELOCITY, FRAME_BODY_OFFSET, vx=5.0))),
    Fact("frame 8 is along the nose", turns_a_body_velocity_with_the_nose),
    Fact("2.5 Hz is enough to stay in OFFBOARD", slow_stream_suffices),
    Fact("MPC_XY_VEL_MAX limits what is asked", top_speed_is_the_parameter),
    Fact("OFFBOARD without a stream is refused", refused_without_stream),
    Fact("OFFBOARD after a lapsed stream is refused", refused_after_a_lapsed_stream),
    Fact("OFFBOARD is entered once the stream is about 1 s old", entered_when_the_stream_is_a_second_old),
    Fact("OFFBOARD is not entered by a stream that ends before", young_stream_that_ends_is_not_entered),
    Fact("DO_SET_MODE is acknowledged twice and the last one counts", mode_is_acknowledged_twice),
    Fact("HEARTBEAT tells a changed mode with its next, once a second", heartbeat_tells_the_mode_once_a_second),
    Fact("a mode for a stick is refused in flight, there is none", sticks_are_refused_in_flight),
    Fact("OFFBOARD ends COM_OF_LOSS_T = 1 s after the last setpoint", offboard_ends_after(1.0)),
    Fact("OFFBOARD ends COM_OF_LOSS_T = 0.5 s after the last setpoint", offboard_ends_after(0.5)),
    Fact("COM_OBL_RC_ACT 0 drifts and sinks 0.7 m/s", drifts_and_sinks),
    Fact("COM_OBL_RC_ACT 1 drifts", drifts(1, ALTITUDE)),
    Fact("COM_OBL_RC_ACT 2 drifts", drifts(2, STABILIZED)),
    Fact("COM_OBL_RC_ACT 3 returns", returns),
    Fact("COM_OBL_RC_ACT 4 lands", lands),
    Fact("COM_OBL_RC_ACT 5 stops 33.5 m after the last setpoint at 10 m/s and holds", holds_within_six_seconds),
    Fact("HOLD brakes to 8.67, 5.7 and 2.76 m/s after 1, 2 and 3 s", brakes_in_hold),
    Fact("8 m/s turned at 10 deg/s is followed at 8.1, 9 deg behind", turning(10.0, 0.2, 8.08, 8.7)),
    Fact("8 m/s turned at 15 deg/s is followed at 8.1, 14 deg behind", turning(15.0, 0.2, 8.07, 13.6)),
    Fact("SIH_KDV 1, 8 m/s turned at 5 deg/s: 7.5 m/s, 12 deg behind", turning(5.0, 1.0, 7.45, 12.3)),
    Fact("SIH_KDV 1, 8 m/s turned at 10 deg/s: 6.7 m/s, 19 deg behind", turning(10.0, 1.0, 6.66, 18.5)),
    Fact("SIH_KDV 1, 8 m/s turned at 15 deg/s: 6.2 m/s, 22 deg behind", turning(15.0, 1.0, 6.22, 22.2)),
    Fact(
        "SIH_KDV 1, 5 m/s asked gives 3.0, 3.8, 4.0 and 4.6 at 1, 2, 4 and 10 s",
        sluggish(velocity(5.0), (1.0, 2.0, 4.0, 10.0), (3.01, 3.77, 4.04, 4.62)),
    ),
    Fact(
        "SIH_KDV 1, stop from 10 m/s leaves 3.6, 2.3, 1.6 and 0.7 at 1, 2, 4 and 10 s",
        sluggish(velocity(0.0), (1.0, 2.0, 4.0, 10.0), (3.55, 2.25, 1.62, 0.67)),
    ),
    Fact("SIH_KDV 1, 8 m/s: it stands 25 m after the last setpoint, after 6.2 s", stops_late_with_more_drag),
    Fact("the stream coming back returns it to OFFBOARD, out of HOLD", returns_to_offboard_by_itself(5)),
    Fact("the stream coming back returns it to OFFBOARD, out of RETURN", returns_to_offboard_by_itself(3)),
    Fact("the stream coming back returns it to OFFBOARD, out of LAND", returns_to_offboard_by_itself(4)),
    Fact("a person's other mode stays, whatever is streamed", stays_out_after_a_person_chose_another_mode),
    Fact("GPS lost: it lands after 6 s, and is back in OFFBOARD 3 s after GPS", lands_without_gps_and_comes_back),
    Fact("after landing it reads OFFBOARD and will not arm", reads_offboard_after_landing_and_will_not_arm),
)


@pytest.mark.parametrize("fact", FACTS, ids=lambda fact: fact.title)
def test_the_fact_holds(fact: Fact) -> None:
    assert fact.holds(Flight(Px4Copter))


def test_a_person_arms_takes_off_repositions_and_lands() -> None:
    flight = Flight(Px4Copter, height_m=0.0)
    assert flight.command(common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == [ACCEPTED]
    assert flight.command(common.MAV_CMD_NAV_TAKEOFF, *(NAN,) * 7) == [ACCEPTED]
    flight.run(2.0)
    assert flight.mode == TAKE_OFF
    flight.run(6.0)
    assert flight.mode == HOLD and abs(flight.height_m - 2.5) < 0.2
    x, y = round(47.0002e7), round(8.0e7)
    assert flight.command_int(common.MAV_CMD_DO_REPOSITION, -1.0, 1.0, x=x, y=y, z=20.0) == [ACCEPTED]
    flight.run(30.0)
    assert flight.mode == HOLD and abs(flight.height_m - 20.0) < 0.3 and math.dist(flight.place_m, (22.24, 0.0)) < 1.0
    assert flight.command(common.MAV_CMD_NAV_LAND) == [ACCEPTED]
    flight.run(40.0)
    assert flight.landed and not flight.armed and flight.mode == LAND
    assert flight.command(common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == [REJECTED]


def test_it_disarms_by_itself_when_armed_and_left_on_the_ground() -> None:
    flight = Flight(Px4Copter, height_m=0.0)
    flight.command(common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    flight.run(9.0)
    assert flight.armed
    flight.run(3.0)
    assert not flight.armed


def test_it_is_not_disarmed_in_flight_unless_forced() -> None:
    flight = Flight(Px4Copter)
    assert flight.command(common.MAV_CMD_COMPONENT_ARM_DISARM, 0.0) == [REJECTED]
    assert flight.command(common.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 21196.0) == [ACCEPTED]
    flight.run(6.0)
    assert flight.landed


def test_return_flies_home_and_lands_there() -> None:
    flight = at_speed(Flight(Px4Copter))
    assert flight.command(common.MAV_CMD_NAV_RETURN_TO_LAUNCH) == [ACCEPTED]
    flight.run(130.0)
    assert flight.landed and not flight.armed and math.hypot(*flight.place_m) < 1.5


def test_a_reboot_in_flight_forgets_the_mode_and_the_stream() -> None:
    flight = at_speed(Flight(Px4Copter))
    flight.vehicle.reboot(flight.now_s)
    flight.run(8.0)
    assert flight.mode == HOLD and flight.armed and flight.speed_m_s < 0.3
    assert flight.set_mode(OFFBOARD)[-1] == REJECTED


def test_a_reposition_that_does_not_ask_for_the_mode_is_unsupported() -> None:
    flight = at_speed(Flight(Px4Copter))
    assert flight.command(common.MAV_CMD_DO_REPOSITION, -1.0, 0.0, 0.0, NAN, 47.0, 8.0, 600.0) == [UNSUPPORTED]
    assert flight.mode == OFFBOARD


def test_an_integer_parameter_travels_by_its_bytes() -> None:
    flight = Flight(Px4Copter)
    bytewise = struct.unpack("<f", struct.pack("<i", 5))[0]
    name = b"COM_OBL_RC_ACT"
    (answer,) = flight.send(common.MAVLink_param_set_message(1, 1, name, bytewise, common.MAV_PARAM_TYPE_INT32))
    assert answer.param_type == common.MAV_PARAM_TYPE_INT32
    assert struct.unpack("<i", struct.pack("<f", answer.param_value))[0] == 5
    assert flight.vehicle.parameters["COM_OBL_RC_ACT"] == 5.0


def test_a_wind_above_what_it_can_lean_against_carries_it_off() -> None:
    flight = Flight(Px4Copter)
    flight.set_parameter("SIH_KDV", 1.0)
    flight.vehicle.wind_m_s = (25.0, 0.0)
    flight.run(20.0)
    assert flight.velocity_m_s[0] > 2.0


def test_it_keeps_its_velocity_over_the_ground_in_a_wind() -> None:
    flight = Flight(Px4Copter)
    flight.vehicle.wind_m_s = (-6.0, 3.0)
    flight.engage(velocity(5.0))
    flight.run(6.0, velocity(5.0))
    assert math.dist(flight.velocity_m_s, (5.0, 0.0)) < 0.1


anything = st.floats(width=32)


@pytest.mark.slow
@settings(max_examples=60)
@given(
    mask=st.integers(0, 0xFFFF),
    frame=st.integers(0, 21),
    numbers=st.lists(anything, min_size=11, max_size=11),
)
def test_no_setpoint_makes_its_place_anything_but_a_number(mask: int, frame: int, numbers: list[float]) -> None:
    flight = Flight(Px4Copter)
    flight.engage(velocity(1.0))
    message = common.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *numbers)
    flight.run(0.5, lambda _: message)
    assert all(map(math.isfinite, (*flight.place_m, flight.height_m, *flight.velocity_m_s, flight.bank_deg)))


@settings(max_examples=100)
@given(
    number=st.sampled_from((16, 17, 20, 21, 22, 176, 178, 192, 400)),
    numbers=st.lists(anything, min_size=7, max_size=7),
)
def test_no_command_makes_it_raise_or_lose_its_place(number: int, numbers: list[float]) -> None:
    flight = Flight(Px4Copter)
    flight.command(number, *numbers)
    flight.run(0.3)
    assert all(map(math.isfinite, (*flight.place_m, flight.height_m)))
