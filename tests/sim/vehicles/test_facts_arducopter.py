"""Every fact about ArduCopter that a client can observe (docs/autopilots.md) holds on the stand-in, within a tolerance.

A row says what was measured; its function does what was done then and returns what the stand-in did. Where the stand-in
is known to be further off than measured values usually scatter, the row's tolerance says by how much.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from statistics import fmean

import pytest
from pymavlink.dialects.v20 import common

from companion.autopilot.telemetry import COMPANION_COMPONENT
from sim.vehicles.ardupilot import READY_TEXT
from tests.sim.vehicles.pilot import GROUND_M, HEIGHT_M, NAN, Pilot

STABILIZE, GUIDED, LOITER, RTL, LAND, BRAKE = 0, 4, 5, 6, 9, 17
ACCEPTED = [common.MAV_RESULT_ACCEPTED]
DO_SET_MODE = common.MAV_CMD_DO_SET_MODE


def copter(**options: float) -> Pilot:
    """Return a copter that hovers or flies north, in a wind from the north of `wind_m_s`."""
    pilot = Pilot("arducopter", speed_m_s=options.get("speed_m_s", 0.0))
    pilot.vehicle.wind_m_s = (-options.get("wind_m_s", 0.0), 0.0)
    return pilot


def time_to_90_percent(asked_m_s: float) -> float:
    pilot = copter()
    return pilot.until(lambda: pilot.speed_m_s >= 0.9 * asked_m_s, lambda: pilot.velocity(asked_m_s, 0.0))


def speed_reached(asked_m_s: float, angle_max_cdeg: float = 3000.0, mask: int = 0x0DC7, frame: int = 1) -> float:
    pilot = copter()
    pilot.set("ANGLE_MAX", angle_max_cdeg)
    pilot.wait(20.0, lambda: pilot.velocity(asked_m_s, 0.0, mask=mask, frame=frame))
    return pilot.speed_m_s


def following(rate_deg_s: float, **parameters: float) -> tuple[float, float]:
    """Return the speed and the lag in deg behind a 10 m/s vector that turns, each the mean of a whole turn."""
    pilot = copter(speed_m_s=10.0)
    for name, value in parameters.items():
        pilot.set(name, value)

    def turn() -> None:
        angle_rad = math.radians(rate_deg_s) * pilot.t_s
        pilot.velocity(10.0 * math.cos(angle_rad), 10.0 * math.sin(angle_rad))

    pilot.wait(24.0, turn)
    speeds_m_s, lags_rad = [], []
    for _ in range(round(360.0 / rate_deg_s)):
        pilot.wait(1.0, turn)
        north_m_s, east_m_s = pilot.vehicle.ground_velocity_m_s
        speeds_m_s.append(pilot.speed_m_s)
        asked_rad = math.radians(rate_deg_s) * pilot.t_s
        lags_rad.append(math.remainder(asked_rad - math.atan2(east_m_s, north_m_s), math.tau))
    return fmean(speeds_m_s), math.degrees(fmean(lags_rad))


def stopping(time_out_s: float) -> tuple[float, float]:
    """Return time and distance from the last setpoint at 10 m/s to standing."""
    pilot = copter(speed_m_s=10.0)
    pilot.set("GUID_TIMEOUT", time_out_s)
    pilot.wait(5.0, lambda: pilot.velocity(10.0, 0.0))
    pilot.velocity(10.0, 0.0)
    began_m = pilot.place_m[0]
    stopped_s = pilot.until(lambda: pilot.speed_m_s < 0.3)
    pilot.wait(5.0)
    return stopped_s, pilot.place_m[0] - began_m


def reversal_s(asked_m_s: float) -> float:
    """Return how long it goes on north after having been asked for so much north, and then for south."""
    pilot = copter()
    pilot.wait(30.0, lambda: pilot.velocity(asked_m_s, 0.0))
    return pilot.until(lambda: pilot.vehicle.ground_velocity_m_s[0] < 0.0, lambda: pilot.velocity(-10.0, 0.0))


def held_at(period_s: float, time_out_s: float) -> float:
    """Return the least speed while 5 m/s are asked for so rarely."""
    pilot = copter(speed_m_s=5.0)
    pilot.set("GUID_TIMEOUT", time_out_s)
    slowest_m_s = 5.0
    for _ in range(8):
        pilot.velocity(5.0, 0.0)
        for _ in range(round(period_s / 0.1)):
            pilot.wait(0.1)
            slowest_m_s = min(slowest_m_s, pilot.speed_m_s)
    return slowest_m_s


def asked_in_turn(wind_m_s: float, *courses_deg: float) -> tuple[float, float]:
    """Return the speed and course over the ground after 8 m/s were asked for along the courses, 20 s each."""
    pilot = copter(wind_m_s=wind_m_s)
    for course_deg in courses_deg:
        pilot.wait(20.0, partial(pilot.velocity, *_along(course_deg)))
    return pilot.speed_m_s, pilot.course_deg


def led_by_its_course(wind_m_s: float) -> tuple[float, float]:
    """Return the speed and course after 40 s in which 8 m/s were asked for along its course and 8.6 deg further."""
    pilot = copter(wind_m_s=wind_m_s)
    pilot.wait(20.0, partial(pilot.velocity, -8.0, 0.0))
    pilot.wait(40.0, lambda: pilot.velocity(*_along(pilot.course_deg - 8.6)))
    return pilot.speed_m_s, pilot.course_deg


def turned_by_its_course_deg(wind_m_s: float) -> float:
    """Return how far it turns in 30 s in which 8 m/s are asked for along its course and 8.6 deg further."""
    pilot = copter(wind_m_s=wind_m_s)
    pilot.wait(20.0, partial(pilot.velocity, -8.0, 0.0))
    turned_deg = 0.0
    for _ in range(60):
        before_deg = pilot.course_deg
        pilot.wait(0.5, lambda: pilot.velocity(*_along(pilot.course_deg + 8.6)))
        turned_deg += math.degrees(math.remainder(math.radians(pilot.course_deg - before_deg), math.tau))
    return turned_deg


def _along(course_deg: float) -> tuple[float, float]:
    return 8.0 * math.cos(math.radians(course_deg)), 8.0 * math.sin(math.radians(course_deg))


FIGURES: list[tuple[str, Callable[[], float], float, float]] = [
    ("5 m/s is 90 % reached after 2.35 s", lambda: time_to_90_percent(5.0), 2.35, 0.15),
    ("10 m/s is 90 % reached after 2.4 to 5 s", lambda: time_to_90_percent(10.0), 3.7, 1.3),
    ("5 m/s: 4.99 is reached", lambda: speed_reached(5.0), 4.99, 0.03),
    ("20 m/s asked at 30 degrees of lean: 10.3", lambda: speed_reached(20.0), 10.3, 0.1),
    ("20 m/s asked at 45 degrees of lean: 15.0", lambda: speed_reached(20.0, 4500.0), 15.0, 0.1),
    ("mask velocity + yaw works", lambda: speed_reached(5.0, mask=0x09C7), 5.0, 0.05),
    ("mask velocity + yaw rate works", lambda: speed_reached(5.0, mask=0x05C7), 5.0, 0.05),
    ("mask all works", lambda: speed_reached(5.0, mask=0x01C7), 5.0, 0.05),
    ("frame 7 works", lambda: speed_reached(5.0, frame=7), 5.0, 0.05),
    ("frame 8 works", lambda: speed_reached(5.0, frame=8), 5.0, 0.05),
    ("frame 12 does not move it", lambda: speed_reached(5.0, frame=12), 0.0, 0.01),
    ("turning at 10 deg/s it flies 9.8 m/s", lambda: following(10.0)[0], 9.8, 0.2),
    ("turning at 10 deg/s it lags 0.62 s", lambda: following(10.0)[1] / 10.0, 0.62, 0.04),
    ("turning at 30 deg/s it collapses to 4.9 m/s", lambda: following(30.0)[0], 4.9, 0.3),
    ("turning at 30 deg/s it lags 56 deg", lambda: following(30.0)[1], 56.0, 12.0),
    (
        "turning at 30 deg/s with more acceleration, jerk and lean it flies 10.1 m/s",
        lambda: following(30.0, WPNAV_ACCEL=1000.0, PSC_JERK_XY=20.0, ANGLE_MAX=4500.0)[0],
        10.1,
        0.5,
    ),
    (
        "turning at 30 deg/s with more acceleration, jerk and lean it lags 23 deg",
        lambda: following(30.0, WPNAV_ACCEL=1000.0, PSC_JERK_XY=20.0, ANGLE_MAX=4500.0)[1],
        23.0,
        5.0,
    ),
    ("setpoints stop: it stands after 53 m", lambda: stopping(3.0)[1], 53.0, 0.15 * 53.0),
    ("setpoints stop: it stands after 7.1 s", lambda: stopping(3.0)[0], 7.1, 0.5),
    ("setpoints stop, time-out 0.5 s: it stands after 28 m", lambda: stopping(0.5)[1], 28.0, 0.15 * 28.0),
    ("setpoints stop, time-out 0.5 s: it stands after 4.6 s", lambda: stopping(0.5)[0], 4.6, 0.5),
    ("0.4 Hz holds the speed with a time-out of 3 s", lambda: held_at(2.5, 3.0), 5.0, 0.05),
    ("2 Hz holds the speed with a time-out of 0.5 s", lambda: held_at(0.5, 0.5), 5.0, 0.05),
    ("8 m/s asked against 3 m/s: 7.4 are flown", lambda: asked_in_turn(3.0, 90.0, 40.0, 0.0)[0], 7.4, 0.15),
    ("8 m/s asked 64 deg off 5 m/s of wind keeps the course", lambda: asked_in_turn(5.0, 180.0, 64.0)[1], 64.0, 1.0),
    # The simulator's drag acts along the body's axes; here it is the same from all sides.
    ("8 m/s asked 64 deg off 5 m/s of wind: 7.8 are flown", lambda: asked_in_turn(5.0, 180.0, 64.0)[0], 7.8, 0.8),
    (
        "a setpoint 14 deg nearer to the wind does not turn it",
        lambda: asked_in_turn(5.0, 180.0, 64.0, 50.0)[1],
        64.0,
        1,
    ),
    ("a setpoint far from its course does turn it", lambda: abs(asked_in_turn(5.0, 64.0, 180.0)[1]), 180.0, 1.0),
    ("led by its own course in 5 m/s it stays 57 deg off the wind", lambda: led_by_its_course(5.0)[1], 57.0, 10.0),
    ("led by its own course in 5 m/s it flies on at 7.2 m/s", lambda: led_by_its_course(5.0)[0], 7.2, 0.2),
    ("led by its own course in 4.1 m/s it stays 46 deg off the wind", lambda: led_by_its_course(4.1)[1], 46.0, 7.0),
    ("led by its own course in 3 m/s it stays 16 deg off the wind", lambda: led_by_its_course(3.0)[1], 16.0, 7.0),
    ("led by its own course in 2.4 m/s it turns, at 14 deg/s", lambda: turned_by_its_course_deg(2.4), 420.0, 40.0),
]


@pytest.mark.parametrize(
    ("measure", "fact", "tolerance"), [row[1:] for row in FIGURES], ids=[row[0] for row in FIGURES]
)
def test_a_measured_figure_holds(measure: Callable[[], float], fact: float, tolerance: float) -> None:
    assert measure() == pytest.approx(fact, abs=tolerance)


def accelerates_at_its_limit() -> bool:
    """WPNAV_ACCEL limits the acceleration: a second after the start, twice as much of it makes twice the speed."""
    speeds_m_s = []
    for acceleration_cm_s2 in (100.0, 200.0):
        pilot = copter()
        pilot.set("WPNAV_ACCEL", acceleration_cm_s2)
        pilot.wait(4.0, partial(pilot.velocity, 10.0, 0.0))
        speeds_m_s.append(pilot.speed_m_s)
    return 1.8 < speeds_m_s[1] / speeds_m_s[0] < 2.2


def obeys_no_speed_command() -> bool:
    pilot = copter()
    pilot.set("WPNAV_SPEED", 300.0)
    accepted = pilot.command(common.MAV_CMD_DO_CHANGE_SPEED, 1, 3.0) == ACCEPTED
    pilot.wait(15.0, lambda: pilot.velocity(8.0, 0.0))
    return accepted and pilot.speed_m_s > 7.9


def brakes_on_nan() -> bool:
    pilot = copter()
    pilot.wait(8.0, lambda: pilot.velocity(5.0, 0.0))
    pilot.wait(8.0, lambda: pilot.velocity(NAN, 0.0))
    return pilot.speed_m_s < 0.1


def acknowledges_no_setpoint() -> bool:
    pilot = copter()
    pilot.velocity(5.0, 0.0)
    return pilot.told == []


def ignores_setpoints_in_brake() -> bool:
    pilot = copter()
    pilot.command(DO_SET_MODE, 1, BRAKE)
    pilot.told.clear()
    pilot.wait(5.0, lambda: pilot.velocity(5.0, 0.0))
    return pilot.speed_m_s == 0.0 and not pilot.texts()


def turns_its_nose_along_the_track() -> bool:
    pilot = copter()
    pilot.wait(10.0, lambda: pilot.velocity(0.0, 5.0))
    return abs(pilot.off_deg(90.0)) < 1.0


def hovers_in_guided_after_silence() -> bool:
    pilot = copter(speed_m_s=10.0)
    pilot.velocity(10.0, 0.0)
    pilot.wait(60.0)
    return (pilot.vehicle.mode, pilot.height_m) == (GUIDED, HEIGHT_M) and pilot.speed_m_s < 0.01


def gives_up_too_rare_setpoints() -> bool:
    return held_at(1.5, 0.5) < 4.5


def winds_up() -> bool:
    """Asking for more than is reachable slows a reversal, by more than a second."""
    return reversal_s(20.0) > reversal_s(10.0) + 1.0


def ground_station_loss_does_nothing() -> bool:
    pilot = copter()
    pilot.say(common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    pilot.wait(30.0)
    return pilot.vehicle.mode == GUIDED


def ground_station_loss_returns_if_enabled() -> bool:
    pilot = copter()
    pilot.set("FS_GCS_ENABLE", 1.0)
    pilot.say(common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    pilot.wait(4.0)
    before = pilot.vehicle.mode
    pilot.wait(2.0)
    heartbeat = [message for message in pilot.told if message.get_type() == "HEARTBEAT"][-1]
    return (before, pilot.vehicle.mode, heartbeat.system_status) == (GUIDED, RTL, common.MAV_STATE_CRITICAL)


def loiter_sinks_without_sticks() -> bool:
    pilot = copter()
    pilot.command(DO_SET_MODE, 1, LOITER)
    pilot.wait(5.0)
    before_m = pilot.height_m
    pilot.wait(4.0)
    return abs(before_m - pilot.height_m - 10.0) < 0.1


def brake_holds() -> bool:
    pilot = copter(speed_m_s=5.0)
    pilot.command(DO_SET_MODE, 1, BRAKE)
    pilot.wait(30.0)
    return pilot.height_m == HEIGHT_M and pilot.speed_m_s < 0.01


def status(pilot: Pilot) -> int:
    """Return the state in the newest heartbeat."""
    return int([message for message in pilot.told if message.get_type() == "HEARTBEAT"][-1].system_status)


def obeys(pilot: Pilot) -> bool:
    """Return whether it still reaches a velocity that is asked for."""
    pilot.wait(8.0, lambda: pilot.velocity(0.0, 5.0))
    return bool(abs(pilot.vehicle.ground_velocity_m_s[1] - 5.0) < 0.1)


def lands_without_gps() -> bool:
    pilot = copter()
    pilot.wait(2.0, lambda: pilot.velocity(5.0, 0.0))
    pilot.vehicle.lose_gps(True)
    pilot.wait(7.8, lambda: pilot.velocity(5.0, 0.0))
    before = pilot.vehicle.mode, status(pilot)
    pilot.wait(0.5, lambda: pilot.velocity(5.0, 0.0))
    landing = pilot.vehicle.mode, status(pilot), pilot.texts()
    pilot.vehicle.lose_gps(False)
    pilot.wait(10.0, lambda: pilot.velocity(5.0, 0.0))
    stays = pilot.vehicle.mode == LAND and pilot.height_m < HEIGHT_M - 10.0
    told = ["EKF Failsafe: changed to LAND Mode"]
    return before == (GUIDED, common.MAV_STATE_ACTIVE) and landing == (LAND, common.MAV_STATE_CRITICAL, told) and stays


def goes_on_after_a_short_loss_of_gps() -> bool:
    pilot = copter()
    pilot.vehicle.lose_gps(True)
    pilot.wait(6.0, lambda: pilot.velocity(5.0, 0.0))
    pilot.vehicle.lose_gps(False)
    pilot.wait(6.0, lambda: pilot.velocity(5.0, 0.0))
    return pilot.vehicle.mode == GUIDED and obeys(pilot)


def low_battery(action: float) -> tuple[int, int]:
    """Return mode and state after a battery below BATT_LOW_VOLT for 11 s."""
    pilot = copter()
    pilot.set("BATT_LOW_VOLT", 11.0)
    pilot.set("BATT_FS_LOW_ACT", action)
    pilot.vehicle.battery.percent = 20.0
    pilot.wait(11.0)
    return pilot.vehicle.mode, status(pilot)


def latches_a_warning_and_obeys() -> bool:
    pilot = copter()
    pilot.set("BATT_LOW_VOLT", 11.0)
    pilot.vehicle.battery.percent = 20.0
    pilot.wait(9.0)
    early = status(pilot)
    pilot.wait(2.0)
    pilot.vehicle.battery.percent = 100.0
    pilot.wait(20.0, lambda: pilot.velocity(5.0, 0.0))
    latched = (early, status(pilot)) == (common.MAV_STATE_ACTIVE, common.MAV_STATE_CRITICAL)
    return latched and pilot.vehicle.mode == GUIDED and obeys(pilot) and "Battery Failsafe" in pilot.texts()


def goes_on_without_radio_control() -> bool:
    pilot = copter()
    pilot.vehicle.warn("Radio Failsafe - Continuing Guided Mode")
    pilot.wait(2.0)
    return status(pilot) == common.MAV_STATE_CRITICAL and pilot.vehicle.mode == GUIDED and obeys(pilot)


def loses_a_mode_that_was_set_too_early() -> bool:
    pilot = Pilot("arducopter", flying=False, guided=False)
    pilot.vehicle.craft.boot(0.0)  # type: ignore[attr-defined]
    accepted = pilot.command(DO_SET_MODE, 1, GUIDED) == ACCEPTED
    shown = pilot.vehicle.mode
    pilot.wait(5.0)
    late = pilot.command(DO_SET_MODE, 1, GUIDED) == ACCEPTED
    pilot.wait(5.0)
    heartbeats = [message.custom_mode for message in pilot.told if message.get_type() == "HEARTBEAT"]
    return accepted and late and shown == GUIDED and STABILIZE in heartbeats[1:] and pilot.vehicle.mode == GUIDED


def says_when_it_is_ready() -> bool:
    pilot = Pilot("arducopter", flying=False, guided=False)
    pilot.vehicle.craft.boot(0.0)  # type: ignore[attr-defined]
    pilot.wait(2.0)
    early = pilot.texts()
    pilot.wait(3.0)
    return (early, pilot.texts()) == ([], [READY_TEXT])


ROWS: list[tuple[str, Callable[[], bool]]] = [
    ("acceleration is WPNAV_ACCEL", accelerates_at_its_limit),
    ("neither WPNAV_SPEED nor DO_CHANGE_SPEED limits a velocity", obeys_no_speed_command),
    ("a NaN velocity brakes to a stop", brakes_on_nan),
    ("no setpoint is acknowledged", acknowledges_no_setpoint),
    ("outside GUIDED a setpoint is ignored in silence", ignores_setpoints_in_brake),
    ("with mask 0x0DC7 the yaw follows the track", turns_its_nose_along_the_track),
    ("after silence it stays in GUIDED and hovers", hovers_in_guided_after_silence),
    ("0.67 Hz is too rare with a time-out of 0.5 s", gives_up_too_rare_setpoints),
    ("asking for too much winds up", winds_up),
    ("the ground station's loss does nothing with FS_GCS_ENABLE 0", ground_station_loss_does_nothing),
    ("the ground station's loss returns it with FS_GCS_ENABLE 1", ground_station_loss_returns_if_enabled),
    ("LOITER without sticks sinks at 2.5 m/s", loiter_sinks_without_sticks),
    ("BRAKE holds", brake_holds),
    ("GPS lost: it lands after 8 s, CRITICAL, and goes on when GPS is back", lands_without_gps),
    ("GPS lost for 6 s does nothing", goes_on_after_a_short_loss_of_gps),
    ("a low battery without an action latches CRITICAL, and GUIDED goes on", latches_a_warning_and_obeys),
    ("a low battery lands with BATT_FS_LOW_ACT 1", lambda: low_battery(1.0) == (LAND, common.MAV_STATE_CRITICAL)),
    ("a low battery returns with BATT_FS_LOW_ACT 2", lambda: low_battery(2.0) == (RTL, common.MAV_STATE_CRITICAL)),
    ("radio control lost with continue in guided latches CRITICAL, and GUIDED goes on", goes_on_without_radio_control),
    ("a mode set before it is ready is acknowledged and lost", loses_a_mode_that_was_set_too_early),
    ("it says when it is ready", says_when_it_is_ready),
]


@pytest.mark.slow
@pytest.mark.parametrize("holds", [row[1] for row in ROWS], ids=[row[0] for row in ROWS])
def test_a_fact_holds(holds: Callable[[], bool]) -> None:
    assert holds()


def test_the_companions_heartbeat_is_not_the_ground_stations() -> None:
    pilot = copter()
    pilot.set("FS_GCS_ENABLE", 1.0)
    link = common.MAVLink(None, srcSystem=1, srcComponent=COMPANION_COMPONENT)
    frame = common.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(link)
    pilot.vehicle.receive(frame, 0.0)
    pilot.wait(10.0)
    assert pilot.vehicle.mode == GUIDED


def test_it_goes_where_a_map_asks_it_to() -> None:
    pilot = copter()
    assert pilot.command_int(common.MAV_CMD_DO_REPOSITION, -1, 1, place=(60.0, -40.0), height_m=80.0) == ACCEPTED
    pilot.wait(60.0)
    assert pilot.place_m == pytest.approx((60.0, -40.0), abs=0.5)
    assert pilot.vehicle.truth.altitude_m == pytest.approx(GROUND_M + 80.0, abs=0.5)


@pytest.mark.parametrize("e7", [(1_000_000_000, 0), (0, 2_000_000_000)])
def test_a_place_that_is_not_on_earth_is_denied(e7: tuple[int, int]) -> None:
    message = common.MAVLink_command_int_message(1, 1, 6, common.MAV_CMD_DO_REPOSITION, 0, 0, -1, 1, 0, 0, *e7, 80.0)
    assert copter().results(message) == [common.MAV_RESULT_DENIED]
