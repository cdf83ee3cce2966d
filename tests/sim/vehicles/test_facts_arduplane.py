"""Every fact about ArduPlane that a client can observe (docs/autopilots.md) holds on the stand-in, within a tolerance.

A row says what was measured; its function does what was done then and returns what the stand-in did. Where the stand-in
is known to be further off than measured values usually scatter, the row's tolerance says by how much.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from pymavlink.dialects.v20 import common

from companion.geo.air_density import true_per_indicated
from sim.vehicles.arduplane import AIRFRAME, GUIDED, LOITER, RTL, TAKEOFF
from tests.sim.vehicles.pilot import HEIGHT_M, NAN, Pilot

G_M_S2, CRUISE_M_S = 9.81, 22.0
ACCEPTED, DENIED, FAILED, UNSUPPORTED = (
    [common.MAV_RESULT_ACCEPTED],
    [common.MAV_RESULT_DENIED],
    [common.MAV_RESULT_FAILED],
    [common.MAV_RESULT_UNSUPPORTED],
)
SPEED, ALTITUDE, HEADING = (
    common.MAV_CMD_GUIDED_CHANGE_SPEED,
    common.MAV_CMD_GUIDED_CHANGE_ALTITUDE,
    common.MAV_CMD_GUIDED_CHANGE_HEADING,
)
REPOSITION = common.MAV_CMD_DO_REPOSITION
COURSE, NOSE = 0.0, 1.0


def plane(*, straight: bool = True) -> Pilot:
    """Return a plane in GUIDED: on a steady course north, or circling where it is."""
    pilot = Pilot("arduplane")
    if straight:
        assert pilot.command_int(HEADING, NOSE, 0.0, 20.0) == ACCEPTED
        pilot.wait(0.1)
        # What it had begun to circle is over.
        pilot.until(lambda: abs(pilot.off_deg(0.0)) < 0.1 and abs(pilot.vehicle.craft.body.roll_rad) < 0.01)
    return pilot


def indicated_m_s(pilot: Pilot) -> float:
    """Return the indicated airspeed of a plane in still air."""
    return pilot.speed_m_s / true_per_indicated(pilot.vehicle.truth.altitude_m)


def heading_step_s(push_m_s2: float, gain: float = 5000.0) -> float:
    pilot = plane()
    pilot.set("GUIDED_P", gain)
    pilot.command_int(HEADING, NOSE, 90.0, push_m_s2)
    return pilot.until(lambda: abs(pilot.off_deg(90.0)) < 5.0)


def sustained_deg_s(push_m_s2: float) -> float:
    """Return the turn rate while the heading asked for stays far to the right."""
    pilot = plane()

    def ask() -> None:
        pilot.command_int(HEADING, NOSE, (pilot.heading_deg + 150.0) % 360.0, push_m_s2)

    pilot.wait(5.0, ask)
    before_deg = pilot.heading_deg
    pilot.wait(2.0, ask)
    return -pilot.off_deg(before_deg) % 360.0 / 2.0


def ramp_lag_s(rate_hz: float, gain: float = 5000.0) -> float:
    """Return the mean lag behind a heading that turns at 10 deg/s."""
    pilot = plane()
    pilot.set("GUIDED_P", gain)
    lags_s: list[float] = []
    began_s = pilot.t_s

    def wanted_deg() -> float:
        return 10.0 * (pilot.t_s - began_s) % 360.0

    for _ in range(round(60.0 * rate_hz)):
        pilot.command_int(HEADING, NOSE, wanted_deg(), 50.0)
        for _ in range(round(1.0 / rate_hz / 0.05)):
            pilot.wait(0.05, period_s=0.05)
            lags_s.append(pilot.off_deg(wanted_deg()) / 10.0)
    late_s = lags_s[len(lags_s) // 2 :]
    return sum(late_s) / len(late_s)


def own_loop(wanted_deg: Callable[[float], float], rate_deg_s: float, rate_hz: float, duration_s: float) -> list[float]:
    """Return the errors in deg of a heading loop of our own over roll-only SET_ATTITUDE_TARGET, every 0.05 s."""
    pilot = plane()
    began_s = pilot.t_s
    push = CRUISE_M_S * math.radians(rate_deg_s) / (AIRFRAME.turn_share * G_M_S2)
    errors_deg: list[float] = []
    for index in range(round(duration_s / 0.05)):
        error_deg = pilot.off_deg(wanted_deg(pilot.t_s - began_s))
        errors_deg.append(error_deg)
        if index % round(20.0 / rate_hz) == 0:
            pilot.roll(min(max(3.0 * error_deg + math.degrees(math.atan(push)), -65.0), 65.0))
        pilot.wait(0.05, period_s=0.05)
    return errors_deg


def own_step_s() -> float:
    errors_deg = own_loop(lambda _t_s: 90.0, 0.0, 10.0, 8.0)
    return next(index * 0.05 for index, error_deg in enumerate(errors_deg) if abs(error_deg) < 5.0)


def own_ramp_deg(rate_hz: float) -> float:
    errors_deg = own_loop(lambda t_s: 10.0 * t_s % 360.0, 10.0, rate_hz, 40.0)
    return max(abs(error_deg) for error_deg in errors_deg[400:])


def bank_reached_s() -> float:
    pilot = plane()
    return pilot.until(lambda: pilot.vehicle.craft.body.roll_rad > math.radians(40.0), lambda: pilot.roll(45.0))


def turn_share(bank_deg: float) -> float:
    """Return the sustained turn rate as a share of g tan(bank) / V."""
    pilot = plane()
    pilot.wait(5.0, lambda: pilot.roll(bank_deg))
    before_deg = pilot.heading_deg
    pilot.wait(2.0, lambda: pilot.roll(bank_deg))
    rate_rad_s = math.radians(-pilot.off_deg(before_deg) % 360.0 / 2.0)
    return rate_rad_s / (G_M_S2 * math.tan(math.radians(bank_deg)) / pilot.speed_m_s)


def bank_kept_s() -> float:
    """Return how long after the last SET_ATTITUDE_TARGET the bank was still what it asked for."""
    pilot = plane()
    pilot.wait(3.0, lambda: pilot.roll(30.0))
    pilot.roll(30.0)
    return pilot.until(lambda: pilot.vehicle.craft.body.roll_rad < math.radians(29.0))


def faster_s() -> float:
    pilot = plane()
    assert pilot.command_int(SPEED, 0.0, 25.0) == ACCEPTED
    return pilot.until(lambda: indicated_m_s(pilot) > 24.9)


def climb_m_s(rate: float) -> float:
    """Return the climb that GUIDED_CHANGE_ALTITUDE with a third parameter makes."""
    pilot = plane()
    assert pilot.command_int(ALTITUDE, 0.0, 0.0, rate, height_m=300.0) == ACCEPTED
    pilot.wait(6.0)
    before_m = pilot.height_m
    pilot.wait(4.0)
    return (pilot.height_m - before_m) / 4.0


FIGURES: list[tuple[str, Callable[[], float], float, float]] = [
    ("it flies at 22 m/s indicated", lambda: indicated_m_s(plane()), 22.0, 0.1),
    ("which is more over the ground, 500 m up: 22.5 m/s", lambda: plane().speed_m_s, 22.55, 0.1),
    ("heading step of 90 deg, p3 5: within 5 deg after 13 s", lambda: heading_step_s(5.0), 13.0, 1.3),
    ("heading step of 90 deg, p3 10: within 5 deg after 10.2 s", lambda: heading_step_s(10.0), 10.2, 1.1),
    ("heading step of 90 deg, p3 20: within 5 deg after 8.2 s", lambda: heading_step_s(20.0), 8.2, 0.5),
    ("heading step of 90 deg, p3 50: within 5 deg after 8.2 s", lambda: heading_step_s(50.0), 8.2, 0.5),
    ("heading step, GUIDED_P 20000: 3.4 s", lambda: heading_step_s(20.0, 20000.0), 3.4, 0.6),
    ("p3 5 sustains 11 deg/s", lambda: sustained_deg_s(5.0), 11.0, 1.6),
    ("p3 10 sustains 17.5 deg/s", lambda: sustained_deg_s(10.0), 17.5, 2.6),
    ("p3 20 sustains 37 deg/s", lambda: sustained_deg_s(20.0), 37.0, 2.5),
    ("a heading ramp sent at 1 Hz is followed 3.5 s late", lambda: ramp_lag_s(1.0), 3.5, 0.4),
    ("a heading ramp sent at 10 Hz is followed 3.5 s late", lambda: ramp_lag_s(10.0), 3.5, 0.4),
    ("GUIDED_P 20000: 1 s late", lambda: ramp_lag_s(10.0, 20000.0), 1.0, 0.25),
    ("own heading loop: 90 deg in 3.4 s", own_step_s, 3.4, 0.7),
    ("own heading loop: ramp under 0.4 deg at 10 Hz", lambda: own_ramp_deg(10.0), 0.0, 0.4),
    ("own heading loop: ramp under 0.4 deg at 5 Hz", lambda: own_ramp_deg(5.0), 0.0, 0.4),
    ("own heading loop: ramp under 0.4 deg at 2 Hz", lambda: own_ramp_deg(2.0), 0.0, 0.4),
    ("bank 0 to 45 deg reaches 40 deg in 0.7 s", bank_reached_s, 0.7, 0.1),
    ("a bank of 20 deg turns 0.73 to 0.76 of g tan(bank) / V", lambda: turn_share(20.0), 0.745, 0.015),
    ("a bank of 45 deg turns 0.73 to 0.76 of g tan(bank) / V", lambda: turn_share(45.0), 0.745, 0.015),
    ("ROLL_LIMIT_DEG 65 limits a bank of 80 deg", lambda: turn_share(80.0) * math.tan(1.396), 0.745 * 2.145, 0.05),
    ("a bank is kept 3.0 s after the last message", bank_kept_s, 3.0, 0.15),
    ("airspeed 22 to 25 in 5.9 s", faster_s, 5.9, 0.5),
    ("GUIDED_CHANGE_ALTITUDE p3 100 climbs at 3 m/s", lambda: climb_m_s(100.0), 3.0, 0.1),
    ("GUIDED_CHANGE_ALTITUDE p3 50 climbs at 1.5 m/s", lambda: climb_m_s(50.0), 1.5, 0.1),
]


@pytest.mark.parametrize(
    ("measure", "fact", "tolerance"), [row[1:] for row in FIGURES], ids=[row[0] for row in FIGURES]
)
def test_a_measured_figure_holds(measure: Callable[[], float], fact: float, tolerance: float) -> None:
    assert measure() == pytest.approx(fact, abs=tolerance)


def ignores_velocity() -> bool:
    """Compare the same flight with and without."""
    asked, left = plane(), plane()
    asked.told.clear()
    asked.wait(10.0, lambda: asked.velocity(0.0, 22.0, -3.0))
    left.wait(10.0)
    replies = [message for message in asked.told if message.get_type() in ("COMMAND_ACK", "STATUSTEXT")]
    return asked.vehicle.truth == left.vehicle.truth and not replies


def steps_altitude_in_frame_7() -> bool:
    """Twice the same message is twice the step; the velocity in it is ignored."""
    pilot = plane()
    for _ in range(2):
        pilot.velocity(0.0, 22.0, mask=0x0DC3, frame=7, z=-10.0)
    pilot.wait(30.0)
    return abs(pilot.height_m - HEIGHT_M - 20.0) < 0.5 and abs(pilot.off_deg(0.0)) < 1.0


def takes_altitude_only_from_global() -> bool:
    pilot = plane()
    for mask, height_m in ((0x0DFB, 130.0), (0x0DF8, 300.0), (0x0DC7, 300.0)):
        lat_e7, lon_e7 = 470_000_000, 81_000_000
        pilot.say(
            common.MAVLink_set_position_target_global_int_message(
                0, 1, 1, 6, mask, lat_e7, lon_e7, height_m, 0.0, 22.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            )
        )
    pilot.wait(30.0)
    return abs(pilot.height_m - 130.0) < 0.5 and abs(pilot.off_deg(0.0)) < 1.0


def never_turns_without_p3() -> bool:
    pilot = plane()
    accepted = pilot.command_int(HEADING, NOSE, 90.0, 0.0) == ACCEPTED
    pilot.wait(60.0)
    return accepted and abs(pilot.off_deg(0.0)) < 1.0


def never_forgets_a_heading() -> bool:
    pilot = plane()
    pilot.command_int(HEADING, NOSE, 45.0, 20.0)
    pilot.wait(600.0)
    return abs(pilot.off_deg(45.0)) < 1.0


def flies_a_course_against_the_wind() -> bool:
    """p1 0 is over the ground, p1 1 the nose's."""
    courses_deg = []
    for kind in (COURSE, NOSE):
        pilot = plane()
        pilot.vehicle.wind_m_s = (0.0, 8.0)
        pilot.command_int(HEADING, kind, 0.0, 20.0)
        pilot.wait(60.0)
        north_m_s, east_m_s = pilot.vehicle.ground_velocity_m_s
        courses_deg.append(math.degrees(math.atan2(east_m_s, north_m_s)))
    return abs(courses_deg[0]) < 0.5 and courses_deg[1] > 15.0


def refuses_headings_out_of_range() -> bool:
    asked = [(NOSE, 360.0, 20.0), (NOSE, -1.0, 20.0), (NOSE, NAN, 20.0), (2.0, 90.0, 20.0), (NOSE, 90.0, NAN)]
    return all(plane().command_int(HEADING, *parameters) == DENIED for parameters in asked)


def refuses_speeds() -> bool:
    pilot = plane()
    results = [pilot.command_int(SPEED, kind, speed_m_s) for kind, speed_m_s in ((1.0, 25.0), (0.0, 200.0), (0.0, 2.0))]
    pilot.wait(20.0)
    return results == [DENIED, FAILED, FAILED] and abs(indicated_m_s(pilot) - 22.0) < 0.1


def altitude_without_p3() -> bool:
    pilot = plane()
    accepted = pilot.command_int(ALTITUDE, height_m=160.0) == ACCEPTED
    pilot.wait(40.0)
    up_m = pilot.height_m
    pilot.command_int(ALTITUDE, height_m=90.0)
    pilot.wait(60.0)
    return accepted and abs(up_m - 160.0) < 0.5 and abs(pilot.height_m - 90.0) < 0.5


def altitude_command_outlasts_carrots() -> bool:
    """After GUIDED_CHANGE_ALTITUDE a DO_REPOSITION's altitude is ignored until GUIDED is entered anew."""
    pilot = plane()
    pilot.command_int(ALTITUDE, height_m=120.0)
    pilot.command_int(REPOSITION, -1, 0, 0, 0, place=(0.0, 1000.0), height_m=200.0)
    pilot.wait(40.0)
    ignored = abs(pilot.height_m - 120.0) < 0.5
    pilot.command(common.MAV_CMD_DO_SET_MODE, 1, GUIDED)
    pilot.command_int(REPOSITION, -1, 0, 0, 0, place=(0.0, 1000.0), height_m=200.0)
    pilot.wait(40.0)
    return ignored and abs(pilot.height_m - 200.0) < 0.5


def takes_no_long_reposition() -> bool:
    return plane().command(REPOSITION, -1, 1, 0, 0, 47.0, 8.01, 100.0) == UNSUPPORTED


def steers_by_a_carrot() -> bool:
    pilot = plane()

    def carrot() -> None:
        north_m, east_m = pilot.place_m
        assert pilot.command_int(REPOSITION, -1, 0, 0, 0, place=(north_m, east_m + 400.0), height_m=100.0) == ACCEPTED

    pilot.wait(30.0, carrot)
    return abs(pilot.off_deg(90.0)) < 15.0


def near_carrots_need_a_small_radius() -> bool:
    """120 m ahead it steers with a radius of 10 m, and well off its course with the default radius."""
    off_deg = []
    for radius_m in (10.0, 0.0):
        pilot = plane()

        def carrot(pilot: Pilot = pilot, radius_m: float = radius_m) -> None:
            north_m, east_m = pilot.place_m
            pilot.command_int(REPOSITION, -1, 0, radius_m, 0, place=(north_m, east_m + 120.0), height_m=100.0)

        pilot.wait(30.0, carrot)
        off_deg.append(abs(pilot.off_deg(90.0)))
    return off_deg[0] < 15.0 and off_deg[1] > 30.0


def carrots_lift_but_do_not_lower() -> bool:
    pilot = plane()
    heights_m = []
    for height_m in (150.0, 90.0):
        pilot.command_int(REPOSITION, -1, 0, 0, 0, place=(0.0, 800.0), height_m=height_m)
        pilot.wait(40.0)
        heights_m.append(pilot.height_m)
    return all(abs(height_m - 150.0) < 0.5 for height_m in heights_m)


def bank_keeps_altitude_and_speed() -> bool:
    pilot = plane()
    pilot.wait(20.0, lambda: pilot.roll(45.0))
    roll_deg = math.degrees(pilot.vehicle.craft.body.roll_rad)
    return (
        abs(pilot.height_m - HEIGHT_M) < 0.5 and abs(indicated_m_s(pilot) - 22.0) < 0.1 and abs(roll_deg - 45.0) < 0.01
    )


def turned_after_silence_s() -> float:
    """Return how long after the last bank of a straight flight it has turned by 90 degrees, back to its loiter."""
    pilot = Pilot("arduplane")
    pilot.wait(20.0)
    pilot.command(common.MAV_CMD_DO_SET_MODE, 1, GUIDED)
    pilot.wait(40.0, lambda: pilot.roll(min(max(3.0 * pilot.off_deg(0.0), -45.0), 45.0)))
    return pilot.until(lambda: abs(pilot.off_deg(0.0)) >= 90.0)


def low_battery_mode(action: float) -> int:
    pilot = plane()
    pilot.set("BATT_LOW_VOLT", 11.0)
    pilot.set("BATT_FS_LOW_ACT", action)
    pilot.vehicle.battery.percent = 20.0
    pilot.wait(11.0)
    return pilot.vehicle.mode


def bank_reverts_to_the_heading() -> bool:
    pilot = plane()
    pilot.wait(5.0, lambda: pilot.roll(40.0))
    turned = abs(pilot.off_deg(0.0)) > 30.0
    pilot.wait(30.0)
    return turned and abs(pilot.off_deg(0.0)) < 1.0


def bank_reverts_to_the_circle() -> bool:
    pilot = plane(straight=False)
    pilot.command_int(REPOSITION, -1, 0, 0, 0, place=(0.0, 0.0), height_m=100.0)
    pilot.wait(10.0, lambda: pilot.roll(0.0))
    away_m = math.hypot(*pilot.place_m)
    pilot.wait(60.0)
    return away_m > 150.0 and abs(math.hypot(*pilot.place_m) - 60.0) < 10.0


def minds_two_hertz_of_bank() -> bool:
    pilot = plane()
    pilot.wait(10.0, lambda: pilot.roll(30.0), period_s=0.5)
    return abs(math.degrees(pilot.vehicle.craft.body.roll_rad) - 30.0) < 0.01


def ignores_other_attitude_masks() -> bool:
    pilot = plane()
    pilot.wait(5.0, lambda: pilot.roll(30.0, mask=0xC7))
    return abs(pilot.vehicle.craft.body.roll_rad) < 0.01


def ignores_a_bank_outside_guided() -> bool:
    pilot = plane(straight=False)
    pilot.command(common.MAV_CMD_DO_SET_MODE, 1, LOITER)
    pilot.wait(60.0, lambda: pilot.roll(0.0))
    return math.hypot(*pilot.place_m) < 80.0


def refuses_a_take_off_in_guided() -> bool:
    pilot = Pilot("arduplane", flying=False)
    pilot.command(common.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    refused = pilot.command(common.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 50.0) != ACCEPTED
    pilot.wait(20.0)
    return refused and pilot.height_m == 0.0


def takes_off_in_takeoff() -> bool:
    pilot = Pilot("arduplane", flying=False, guided=False)
    accepted = pilot.command(common.MAV_CMD_DO_SET_MODE, 1, TAKEOFF) == ACCEPTED
    accepted &= pilot.command(common.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED
    pilot.wait(90.0)
    return accepted and abs(pilot.height_m - 50.0) < 2.0 and math.hypot(*pilot.place_m) < 500.0


def commands_fail_outside_guided() -> bool:
    pilot = plane(straight=False)
    pilot.command(common.MAV_CMD_DO_SET_MODE, 1, LOITER)
    asked: list[tuple[int, tuple[float, ...]]] = [
        (SPEED, (0.0, 25.0)),
        (ALTITUDE, (0.0, 0.0)),
        (HEADING, (0.0, 90.0, 20.0)),
    ]
    return all(pilot.command_int(command, *parameters) == FAILED for command, parameters in asked)


def returns_and_circles_home() -> bool:
    pilot = plane()
    pilot.wait(30.0)
    pilot.command(common.MAV_CMD_DO_SET_MODE, 1, RTL)
    pilot.wait(120.0)
    return abs(math.hypot(*pilot.place_m) - 60.0) < 10.0 and abs(pilot.height_m - 100.0) < 1.0


def loiters_in_wind() -> bool:
    pilot = plane(straight=False)
    pilot.command(common.MAV_CMD_DO_SET_MODE, 1, LOITER)
    pilot.vehicle.wind_m_s = (8.0, 0.0)
    pilot.wait(60.0)
    away_m = []
    pilot.wait(60.0, lambda: away_m.append(math.hypot(*pilot.place_m)))
    return min(away_m) > 45.0 and max(away_m) < 80.0


ROWS: list[tuple[str, Callable[[], bool]]] = [
    ("a velocity is ignored, and not acknowledged", ignores_velocity),
    ("frame 7: z is a relative altitude step, once per message", steps_altitude_in_frame_7),
    ("SET_POSITION_TARGET_GLOBAL_INT: altitude only, mask 0x0DFB", takes_altitude_only_from_global),
    ("GUIDED_CHANGE_HEADING with p3 0 gives no turn", never_turns_without_p3),
    ("GUIDED_CHANGE_HEADING never expires", never_forgets_a_heading),
    ("p1 0 is a course, p1 1 a heading", flies_a_course_against_the_wind),
    ("headings outside [0, 360) are denied", refuses_headings_out_of_range),
    ("GUIDED_CHANGE_SPEED: ground speed DENIED, out of range FAILED", refuses_speeds),
    ("GUIDED_CHANGE_ALTITUDE with p3 0 works, up and down", altitude_without_p3),
    ("DO_REPOSITION's altitude is ignored after it", altitude_command_outlasts_carrots),
    ("DO_REPOSITION as COMMAND_LONG is unsupported", takes_no_long_reposition),
    ("a carrot 400 m ahead steers", steers_by_a_carrot),
    ("a carrot 120 m ahead needs a radius of 5 to 20 m", near_carrots_need_a_small_radius),
    ("a carrot climbs but does not descend", carrots_lift_but_do_not_lower),
    ("a bank is held exactly, altitude and speed are kept", bank_keeps_altitude_and_speed),
    ("silence: turned by 90 degrees after 6.7 s", lambda: abs(turned_after_silence_s() - 6.7) < 0.6),
    ("a low battery does nothing with BATT_FS_LOW_ACT 0", lambda: low_battery_mode(0.0) == GUIDED),
    ("a low battery returns with BATT_FS_LOW_ACT 1", lambda: low_battery_mode(1.0) == RTL),
    ("an expired bank leaves the heading that was before", bank_reverts_to_the_heading),
    ("an expired bank leaves the loiter that was before", bank_reverts_to_the_circle),
    ("2 Hz of bank are enough", minds_two_hertz_of_bank),
    ("other masks of SET_ATTITUDE_TARGET do nothing", ignores_other_attitude_masks),
    ("outside GUIDED a bank does nothing", ignores_a_bank_outside_guided),
    ("NAV_TAKEOFF in GUIDED is refused", refuses_a_take_off_in_guided),
    ("mode TAKEOFF (13) and arming take off", takes_off_in_takeoff),
    ("the guided commands fail outside GUIDED", commands_fail_outside_guided),
    ("RTL circles home", returns_and_circles_home),
    ("LOITER stays in a wind", loiters_in_wind),
]


@pytest.mark.slow
@pytest.mark.parametrize("holds", [row[1] for row in ROWS], ids=[row[0] for row in ROWS])
def test_a_fact_holds(holds: Callable[[], bool]) -> None:
    assert holds()


@pytest.mark.parametrize("q", [[NAN] * 4, [0.0] * 4, [5.0, 0.0, 0.0, 0.0]])
def test_an_attitude_that_is_none_is_ignored(q: list[float]) -> None:
    pilot = plane()
    for _ in range(20):
        pilot.say(common.MAVLink_set_attitude_target_message(0, 1, 1, 0xC6, q, 0.0, 0.0, 0.0, 0.0))
        pilot.wait(0.1)
    assert abs(pilot.vehicle.craft.body.roll_rad) < 0.01


def test_the_ground_stations_loss_returns_it_only_if_both_parameters_say_so() -> None:
    modes = []
    for enabled, action in ((1.0, 1.0), (1.0, 0.0), (0.0, 1.0)):
        pilot = plane()
        pilot.set("FS_GCS_ENABL", enabled)
        pilot.set("FS_LONG_ACTN", action)
        pilot.say(common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        pilot.wait(10.0)
        modes.append(pilot.vehicle.mode)
    assert modes == [RTL, GUIDED, GUIDED]
