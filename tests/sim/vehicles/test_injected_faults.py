"""What a test can do to a stand-in must show on the wire as it would show of a real autopilot, and nowhere else."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.geo.air_density import true_per_indicated
from sim.vehicles import CRAFTS
from tests.sim.vehicles.pilot import FRAME, Pilot

KINDS = sorted(CRAFTS)
POSITION, LOCAL, ATTITUDE, HUD, GPS, STATUS, BATTERY = (
    "GLOBAL_POSITION_INT",
    "LOCAL_POSITION_NED",
    "ATTITUDE",
    "VFR_HUD",
    "GPS_RAW_INT",
    "SYS_STATUS",
    "BATTERY_STATUS",
)


def said(pilot: Pilot, name: str) -> list[Any]:
    return [message for message in pilot.told if message.get_type() == name]


def away_m(pilot: Pilot, message: Any) -> float:  # noqa: ANN401
    """Return how far a reported position is from where the vehicle is now."""
    return math.dist(FRAME.to_local(message.lat / 1e7, message.lon / 1e7), pilot.place_m)


@pytest.mark.parametrize("kind", KINDS)
def test_frozen_telemetry_repeats_itself_while_heartbeats_go_on(kind: str) -> None:
    pilot = Pilot(kind, guided=False)
    pilot.wait(5.0)
    pilot.vehicle.freeze_telemetry(True)
    pilot.told.clear()
    pilot.wait(5.0)
    frozen = said(pilot, POSITION)
    assert len(frozen) == 50
    assert len({(message.time_boot_ms, message.lat, message.lon) for message in frozen}) == 1
    assert len(said(pilot, "HEARTBEAT")) == 5
    pilot.vehicle.freeze_telemetry(False)
    pilot.told.clear()
    pilot.wait(1.0)
    assert said(pilot, POSITION)[0].time_boot_ms == 10_100
    assert away_m(pilot, said(pilot, POSITION)[-1]) < 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_corrupt_telemetry_is_not_a_number_in_floats_and_right_in_integers(kind: str) -> None:
    pilot = Pilot(kind, guided=False)
    pilot.vehicle.corrupt_telemetry(True)
    pilot.wait(2.0)
    assert all(math.isnan(message.yaw) for message in said(pilot, ATTITUDE))
    assert all(math.isnan(message.x) and math.isnan(message.vz) for message in said(pilot, LOCAL))
    assert all(math.isnan(message.airspeed) for message in said(pilot, HUD))
    assert away_m(pilot, said(pilot, POSITION)[-1]) < 0.1
    pilot.vehicle.corrupt_telemetry(False)
    pilot.told.clear()
    pilot.wait(1.0)
    assert all(math.isfinite(message.yaw) for message in said(pilot, ATTITUDE))


@pytest.mark.parametrize("kind", KINDS)
def test_a_lost_fix_is_told_and_the_position_leaves_the_truth(kind: str) -> None:
    pilot = Pilot(kind, guided=False)
    pilot.wait(2.0)
    pilot.vehicle.lose_gps(True)
    pilot.wait(20.0)
    fix, status = said(pilot, GPS)[-1], said(pilot, STATUS)[-1]
    assert (fix.fix_type, fix.satellites_visible, fix.eph) == (common.GPS_FIX_TYPE_NO_FIX, 0, 65_535)
    assert not status.onboard_control_sensors_health & common.MAV_SYS_STATUS_SENSOR_GPS
    assert fix.h_acc > 30_000
    assert 15.0 < away_m(pilot, said(pilot, POSITION)[-1]) < 25.0
    pilot.vehicle.lose_gps(False)
    pilot.told.clear()
    pilot.wait(2.0)
    assert said(pilot, GPS)[-1].fix_type == common.GPS_FIX_TYPE_3D_FIX
    assert away_m(pilot, said(pilot, POSITION)[-1]) < 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_a_reboot_is_silent_starts_the_clock_anew_and_forgets_all_but_parameters(kind: str) -> None:
    pilot = Pilot(kind)
    name = pilot.vehicle.craft.parameters[0].name
    pilot.wait(10.0)
    kept = dict(pilot.vehicle.parameters)
    guided = pilot.vehicle.mode
    pilot.vehicle.reboot(pilot.t_s)
    pilot.told.clear()
    pilot.wait(1.9)
    assert pilot.told == []
    assert pilot.say(common.MAVLink_param_request_read_message(1, 1, name.encode(), -1)) == []
    pilot.wait(1.1)
    assert said(pilot, POSITION)[0].time_boot_ms < 2_200
    assert said(pilot, "HEARTBEAT")[0].custom_mode != guided
    assert (pilot.vehicle.parameters, pilot.vehicle.in_air) == (kept, True)


def test_the_battery_drains_while_armed_and_is_told() -> None:
    pilot = Pilot("arducopter")
    pilot.vehicle.battery.percent = 60.0
    pilot.vehicle.battery.drain_percent_s = 0.5
    pilot.wait(20.0)
    assert said(pilot, STATUS)[-1].battery_remaining == 50
    assert said(pilot, STATUS)[-1].voltage_battery < said(pilot, STATUS)[0].voltage_battery
    assert said(pilot, BATTERY)[-1].battery_remaining == 50
    pilot.vehicle.battery.drain_percent_s = 500.0
    pilot.wait(2.0)
    assert said(pilot, STATUS)[-1].battery_remaining == 0


def test_a_parked_vehicle_drains_nothing() -> None:
    pilot = Pilot("arducopter", flying=False)
    pilot.vehicle.battery.drain_percent_s = 1.0
    pilot.wait(5.0)
    assert pilot.vehicle.battery.percent == 100.0


@pytest.mark.slow
def test_the_receivers_noise_has_the_deviation_asked_for_and_leaves_the_truth_alone() -> None:
    noisy, exact = Pilot("arducopter"), Pilot("arducopter")
    noisy.vehicle.sensors.noise_m = 3.0
    errors_m: list[float] = []
    for pilot in (noisy, exact):
        pilot.wait(600.0, period_s=0.5)
    assert noisy.vehicle.truth == exact.vehicle.truth
    for message in said(noisy, POSITION):
        errors_m += FRAME.to_local(message.lat / 1e7, message.lon / 1e7)
    deviation_m = math.sqrt(sum(error_m**2 for error_m in errors_m) / len(errors_m))
    assert deviation_m == pytest.approx(3.0, rel=0.25)
    assert said(noisy, GPS)[-1].h_acc == pytest.approx(3.0 * math.sqrt(2.0) * 1000.0, abs=1.0)


@pytest.mark.slow
@given(st.integers(0, 1000))
@settings(max_examples=10)
def test_the_same_seed_makes_the_same_noise_and_another_another(seed: int) -> None:
    def reported(seed: int) -> list[Any]:
        pilot = Pilot("arducopter", seed=seed)
        pilot.vehicle.sensors.noise_m = 2.0
        pilot.wait(3.0)
        return [(message.lat, message.lon) for message in said(pilot, POSITION)]

    assert reported(seed) == reported(seed)
    assert reported(seed) != reported(seed + 1)


@pytest.mark.parametrize("delay_s", [0.2, 0.55, 1.0])
def test_a_delayed_position_is_where_the_vehicle_was(delay_s: float) -> None:
    pilot = Pilot("arducopter", speed_m_s=8.0)
    pilot.vehicle.sensors.delay_s = delay_s
    pilot.wait(10.0, lambda: pilot.velocity(8.0, 0.0))
    assert away_m(pilot, said(pilot, POSITION)[-1]) == pytest.approx(8.0 * delay_s, abs=0.05)


def test_a_delay_longer_than_the_flight_tells_the_start() -> None:
    pilot = Pilot("arducopter", speed_m_s=8.0)
    pilot.vehicle.sensors.delay_s = 5.0
    pilot.wait(2.0, lambda: pilot.velocity(8.0, 0.0))
    assert away_m(pilot, said(pilot, POSITION)[-1]) == pytest.approx(16.0, abs=1.0)


@pytest.mark.parametrize("kind", KINDS)
def test_airspeed_and_ground_speed_are_told_apart_in_wind(kind: str) -> None:
    pilot = Pilot(kind, guided=False)
    pilot.vehicle.wind_m_s = (3.0, 0.0)
    pilot.wait(20.0)
    hud = said(pilot, HUD)[-1]
    velocity_m_s = pilot.vehicle.ground_velocity_m_s
    assert hud.groundspeed == pytest.approx(math.hypot(*velocity_m_s), abs=0.3)
    true_m_s = hud.airspeed * true_per_indicated(pilot.vehicle.truth.altitude_m)
    assert true_m_s == pytest.approx(math.hypot(velocity_m_s[0] - 3.0, velocity_m_s[1]), abs=0.3)


@pytest.mark.parametrize("kind", KINDS)
def test_a_mission_list_is_empty(kind: str) -> None:
    (count,) = Pilot(kind).say(common.MAVLink_mission_request_list_message(1, 1, 0))
    assert (count.get_type(), count.count, count.target_system) == ("MISSION_COUNT", 0, 255)


@pytest.mark.parametrize(
    ("kind", "autopilot"),
    [("arducopter", 3), ("arduplane", 3), ("px4-copter", 12), ("px4-plane", 12)],
)
def test_the_heartbeat_says_whose_it_is(kind: str, autopilot: int) -> None:
    pilot = Pilot(kind)
    pilot.wait(1.0)
    assert said(pilot, "HEARTBEAT")[0].autopilot == autopilot


any_float = st.floats(width=32)
any_e7 = st.integers(-(2**31), 2**31 - 1)
COMMANDS = [16, 17, 20, 21, 22, 176, 178, 192, 400, 511, 512, 520, 43000, 43001, 43002]
hostile = st.one_of(
    st.builds(
        lambda command, frame, values, x, y: common.MAVLink_command_int_message(
            1, 1, frame, command, 0, 0, *values[:4], x, y, values[4]
        ),
        st.sampled_from(COMMANDS),
        st.integers(0, 21),
        st.lists(any_float, min_size=5, max_size=5),
        any_e7,
        any_e7,
    ),
    st.builds(
        lambda command, values: common.MAVLink_command_long_message(1, 1, command, 0, *values),
        st.sampled_from(COMMANDS),
        st.lists(any_float, min_size=7, max_size=7),
    ),
    st.builds(
        lambda mask, values: common.MAVLink_set_attitude_target_message(0, 1, 1, mask, values[:4], *values[4:]),
        st.one_of(st.just(0xC6), st.integers(0, 255)),
        st.lists(any_float, min_size=8, max_size=8),
    ),
    st.builds(
        lambda frame, mask, place, values: common.MAVLink_set_position_target_global_int_message(
            0, 1, 1, frame, mask, *place, *values
        ),
        st.integers(0, 21),
        st.one_of(st.sampled_from([0x0DFB, 0x0DC0, 0x0DF8]), st.integers(0, 65535)),
        st.tuples(any_e7, any_e7),
        st.lists(any_float, min_size=9, max_size=9),
    ),
    st.builds(
        lambda frame, mask, values: common.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *values),
        st.integers(0, 21),
        st.one_of(st.sampled_from([0x0DC7, 0x0DC0, 0x09C7]), st.integers(0, 65535)),
        st.lists(any_float, min_size=11, max_size=11),
    ),
    st.builds(
        lambda name, value: common.MAVLink_param_set_message(1, 1, name.encode(), value, 9),
        st.sampled_from(sorted({name.name for kind in KINDS for name in Pilot(kind).vehicle.craft.parameters})),
        any_float,
    ),
)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@given(messages=st.lists(hostile, max_size=8), flying=st.booleans())
@settings(max_examples=40)
def test_hostile_values_never_raise_nor_make_the_truth_unreal(kind: str, messages: list[Any], flying: bool) -> None:
    pilot = Pilot(kind, flying=flying)
    for message in messages:
        pilot.say(message)
        pilot.wait(0.5)
    truth = pilot.vehicle.truth
    assert all(map(math.isfinite, (truth.north_m, truth.east_m, truth.altitude_m, truth.heading_rad, truth.speed_m_s)))
