"""The stand-in must behave as the measured autopilots do, refusals and silences included."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.geo.local_frame import LocalFrame
from sim.vehicles import LOCKSTEP_RATES_HZ, ArduCopter, Home, Setup, StandIn, kinematic_profile
from sim.vehicles.modes import ALT_HOLD, BRAKE, GUIDED, LAND, LOITER, RTL, STABILIZE

Message = Any
"""A message of the generated module, or an option of the stand-in: neither is worth a type here."""

FRAME = LocalFrame(47.0, 8.0)
GROUND_M = 500.0
VELOCITY, VELOCITY_YAW, VELOCITY_YAW_RATE, VELOCITY_ALL, POSITION = 0x0DC7, 0x09C7, 0x05C7, 0x01C7, 0x0DF8
NAN = math.nan

companion = common.MAVLink(None, srcSystem=1, srcComponent=191)


def on_the_ground(**options: Message) -> StandIn:
    return StandIn(ArduCopter, Setup(1, FRAME, altitude_m=GROUND_M, **options))


def hovering(**options: Message) -> StandIn:
    flying: dict[str, Any] = {"in_air": True, "armed": True, "guided": True, "altitude_m": 600.0}
    return StandIn(ArduCopter, Setup(1, FRAME, home=Home(0.0, 0.0, GROUND_M), **{**flying, **options}))


def point(**options: Message) -> StandIn:
    flying: dict[str, Any] = {"in_air": True, "armed": True, "guided": True, "altitude_m": 600.0, "speed_m_s": 60.0}
    profile = kinematic_profile(n_max=2.0, min_speed_m_s=40.0, max_speed_m_s=80.0)
    return StandIn(profile, Setup(1, FRAME, home=Home(0.0, 0.0, GROUND_M), **{**flying, **options}))


def pack(message: Message) -> bytes:
    return bytes(message.pack(companion))


def parsed(frames: list[bytes]) -> list[Any]:
    messages = []
    for frame in frames:
        found = common.MAVLink(None).parse_buffer(frame)
        assert found is not None and len(found) == 1
        messages.append(found[0])
    return messages


def of_type(frames: list[bytes], name: str) -> list[Any]:
    return [message for message in parsed(frames) if message.get_type() == name]


def ask(vehicle: StandIn, command: int, *parameters: float, t_s: float = 0.0, target: int = 1) -> list[bytes]:
    padded = [*parameters, *[0.0] * (7 - len(parameters))]
    return vehicle.receive(pack(companion.command_long_encode(target, 1, command, 0, *padded)), t_s)


def result(frames: list[bytes]) -> int:
    (ack,) = of_type(frames, "COMMAND_ACK")
    return int(ack.result)


def set_mode(vehicle: StandIn, mode: int, t_s: float = 0.0) -> list[bytes]:
    return ask(vehicle, common.MAV_CMD_DO_SET_MODE, 1, mode, t_s=t_s)


def arm(vehicle: StandIn, *, disarm: bool = False, force: bool = False) -> list[bytes]:
    return ask(vehicle, common.MAV_CMD_COMPONENT_ARM_DISARM, float(not disarm), 21196.0 if force else 0.0)


def setpoint(
    mask: int = VELOCITY,
    frame: int = 1,
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    yaw_rate: float = 0.0,
    target: int = 1,
) -> bytes:
    return pack(
        companion.set_position_target_local_ned_encode(
            0, target, 1, frame, mask, *position, *velocity, 0.0, 0.0, 0.0, yaw, yaw_rate
        )
    )


def fly(vehicle: StandIn, until_s: float, datagram: bytes | Callable[[float], bytes], from_s: float = 0.0) -> None:
    """Stream a setpoint at 10 Hz."""
    for index in range(round((until_s - from_s) * 10)):
        t_s = from_s + index / 10
        assert vehicle.receive(datagram(t_s) if callable(datagram) else datagram, t_s) == []
        vehicle.step_to(t_s + 0.1)


def heartbeat_mode(frames: list[bytes]) -> int:
    return int(of_type(frames, "HEARTBEAT")[-1].custom_mode)


# Modes, arming, take-off


@pytest.mark.parametrize("mode", [STABILIZE, ALT_HOLD, GUIDED, LOITER, RTL, LAND, BRAKE])
def test_a_mode_is_set_acknowledged_and_announced_at_once(mode: int) -> None:
    vehicle = hovering(guided=mode != GUIDED)
    frames = set_mode(vehicle, mode)
    assert result(frames) == common.MAV_RESULT_ACCEPTED
    assert heartbeat_mode(frames) == vehicle.mode == mode


def test_a_mode_is_set_by_command_int_too() -> None:
    vehicle = on_the_ground()
    frames = vehicle.receive(pack(companion.command_int_encode(1, 1, 0, 176, 0, 0, 1, GUIDED, 0, 0, 0, 0, 0)), 0.0)
    assert (result(frames), heartbeat_mode(frames)) == (common.MAV_RESULT_ACCEPTED, GUIDED)


def test_a_mode_is_set_by_the_old_message_without_an_acknowledgement() -> None:
    vehicle = on_the_ground()
    frames = vehicle.receive(pack(companion.set_mode_encode(1, 1, GUIDED)), 0.0)
    assert [message.get_type() for message in parsed(frames)] == ["HEARTBEAT"]
    assert heartbeat_mode(frames) == GUIDED


@pytest.mark.parametrize("mode", [3, 99, 1e30, -4])
def test_an_unknown_mode_fails_with_a_text(mode: float) -> None:
    vehicle = on_the_ground()
    frames = ask(vehicle, common.MAV_CMD_DO_SET_MODE, 1, mode)
    assert result(frames) == common.MAV_RESULT_FAILED
    assert of_type(frames, "STATUSTEXT")[0].text.startswith("No such mode")
    assert vehicle.mode == STABILIZE


@pytest.mark.parametrize("parameters", [(0, 4), (NAN, 4), (1, NAN), (math.inf, 4)])
def test_a_mode_command_that_is_no_custom_mode_is_denied(parameters: tuple[float, float]) -> None:
    vehicle = on_the_ground()
    assert result(ask(vehicle, common.MAV_CMD_DO_SET_MODE, *parameters)) == common.MAV_RESULT_DENIED
    assert vehicle.mode == STABILIZE


@pytest.mark.parametrize("mode", [RTL, LAND, BRAKE])
def test_arming_is_denied_with_a_text_in_a_mode_that_cannot_arm(mode: int) -> None:
    vehicle = on_the_ground()
    set_mode(vehicle, mode)
    frames = arm(vehicle)
    assert result(frames) == common.MAV_RESULT_DENIED
    assert "not armable" in of_type(frames, "STATUSTEXT")[0].text
    assert not vehicle.armed


@pytest.mark.parametrize("mode", [STABILIZE, ALT_HOLD, GUIDED, LOITER])
def test_arming_is_accepted_and_announced_at_once_in_the_other_modes(mode: int) -> None:
    vehicle = on_the_ground()
    set_mode(vehicle, mode)
    frames = arm(vehicle)
    assert result(frames) == common.MAV_RESULT_ACCEPTED
    assert of_type(frames, "HEARTBEAT")[0].base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED


def test_disarming_is_accepted_on_the_ground_and_denied_in_the_air() -> None:
    parked, flying = on_the_ground(armed=True), hovering()
    assert result(arm(parked, disarm=True)) == common.MAV_RESULT_ACCEPTED
    assert result(arm(flying, disarm=True)) == common.MAV_RESULT_DENIED
    assert (parked.armed, flying.armed) == (False, True)


def test_a_forced_disarm_in_the_air_lets_the_copter_fall() -> None:
    vehicle = hovering()
    assert result(arm(vehicle, disarm=True, force=True)) == common.MAV_RESULT_ACCEPTED
    vehicle.step_to(2.0)
    assert vehicle.truth.altitude_m == pytest.approx(600.0 - 0.5 * 9.81 * 4.0, abs=1.5)
    vehicle.step_to(20.0)
    assert (vehicle.truth.altitude_m, vehicle.in_air) == (GROUND_M, False)


def test_a_take_off_climbs_at_two_and_a_half_metres_a_second_and_holds_its_height() -> None:
    vehicle = on_the_ground(guided=True, armed=True)
    assert result(ask(vehicle, common.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 40.0)) == common.MAV_RESULT_ACCEPTED
    vehicle.step_to(5.0)
    before_m = vehicle.truth.altitude_m
    vehicle.step_to(9.0)
    assert vehicle.truth.altitude_m - before_m == pytest.approx(10.0, abs=0.01)
    vehicle.step_to(40.0)
    assert vehicle.truth.altitude_m == pytest.approx(GROUND_M + 40.0, abs=0.1)


def test_a_take_off_shows_in_the_landed_state() -> None:
    vehicle = on_the_ground(guided=True, armed=True)

    def landed_state() -> int:
        frames = ask(vehicle, common.MAV_CMD_REQUEST_MESSAGE, common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
        return int(of_type(frames, "EXTENDED_SYS_STATE")[0].landed_state)

    seen = [landed_state()]
    ask(vehicle, common.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 5.0)
    seen.append(landed_state())
    vehicle.step_to(20.0)
    seen.append(landed_state())
    set_mode(vehicle, LAND)
    seen.append(landed_state())
    assert seen == [
        common.MAV_LANDED_STATE_ON_GROUND,
        common.MAV_LANDED_STATE_TAKEOFF,
        common.MAV_LANDED_STATE_IN_AIR,
        common.MAV_LANDED_STATE_LANDING,
    ]


@pytest.mark.parametrize(
    ("vehicle", "height_m"),
    [
        (on_the_ground(guided=True), 10.0),
        (on_the_ground(armed=True), 10.0),
        (hovering(), 200.0),
        (on_the_ground(guided=True, armed=True), NAN),
        (on_the_ground(guided=True, armed=True), -5.0),
        (on_the_ground(guided=True, armed=True), math.inf),
    ],
    ids=["disarmed", "not guided", "flying", "nan", "downwards", "inf"],
)
def test_a_take_off_fails_otherwise(vehicle: StandIn, height_m: float) -> None:
    altitude_m = vehicle.truth.altitude_m
    frames = ask(vehicle, common.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height_m)
    assert result(frames) == common.MAV_RESULT_FAILED
    vehicle.step_to(5.0)
    assert vehicle.truth.altitude_m == altitude_m


def test_landing_touches_down_disarms_and_announces_it_at_once() -> None:
    vehicle = hovering(altitude_m=GROUND_M + 5.0)
    set_mode(vehicle, LAND)
    t_s = 0.0
    while vehicle.armed:
        t_s += 0.01
        assert t_s < 20.0
        vehicle.telemetry(t_s)
        vehicle.step_to(t_s)
    assert (vehicle.truth.altitude_m, vehicle.in_air) == (GROUND_M, False)
    (heartbeat,) = of_type(vehicle.telemetry(t_s + 0.001), "HEARTBEAT")
    assert not heartbeat.base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED


def test_a_return_climbs_flies_home_and_lands() -> None:
    vehicle = hovering(north_m=120.0, east_m=-90.0, altitude_m=GROUND_M + 5.0)
    set_mode(vehicle, RTL)
    vehicle.step_to(6.0)
    assert vehicle.truth.altitude_m > GROUND_M + 10.0
    assert math.hypot(vehicle.truth.north_m - 120.0, vehicle.truth.east_m + 90.0) < 1.0
    vehicle.step_to(200.0)
    assert math.hypot(vehicle.truth.north_m, vehicle.truth.east_m) < 1.0
    assert not vehicle.armed


@pytest.mark.parametrize("mode", [LOITER, ALT_HOLD, STABILIZE])
def test_a_mode_that_wants_sticks_sinks_without_them(mode: int) -> None:
    vehicle = hovering()
    set_mode(vehicle, mode)
    vehicle.step_to(10.0)
    before_m = vehicle.truth.altitude_m
    vehicle.step_to(14.0)
    assert before_m - vehicle.truth.altitude_m == pytest.approx(10.0, abs=0.01)


def test_brake_stops_and_holds_height() -> None:
    vehicle = hovering(speed_m_s=10.0)
    set_mode(vehicle, BRAKE)
    vehicle.step_to(10.0)
    assert vehicle.truth.speed_m_s < 0.05
    assert vehicle.truth.altitude_m == 600.0


# Setpoints, as measured


def test_five_metres_a_second_is_ninety_per_cent_reached_after_two_point_three_five_seconds() -> None:
    vehicle = hovering()
    vehicle.receive(setpoint(velocity=(5.0, 0.0, 0.0)), 0.0)
    times_s = [index * 0.02 for index in range(1, 175)]
    t90_s = math.inf
    for t_s in times_s:
        vehicle.step_to(t_s)
        if vehicle.truth.speed_m_s >= 4.5:
            t90_s = min(t90_s, t_s)
    assert t90_s == pytest.approx(2.35, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("lean_cdeg", "top_m_s"), [(3000.0, 10.3), (4500.0, 15.0)])
@given(speed=st.floats(16.0, 999.0), course=st.floats(-math.pi, math.pi))
@settings(max_examples=10)
def test_the_top_speed_is_the_lean_limits_whatever_is_asked(
    lean_cdeg: float, top_m_s: float, speed: float, course: float
) -> None:
    vehicle = hovering()
    vehicle.receive(pack(companion.param_set_encode(1, 1, b"ANGLE_MAX", lean_cdeg, 9)), 0.0)
    fly(vehicle, 15.0, setpoint(velocity=(speed * math.cos(course), speed * math.sin(course), 0.0)))
    assert vehicle.truth.speed_m_s == pytest.approx(top_m_s, abs=0.01)


def test_acceleration_exceeds_its_limit_by_no_more_than_the_corrections() -> None:
    vehicle = hovering()
    last = (0.0, 0.0)
    for index in range(200):
        vehicle.receive(setpoint(velocity=(10.0 * (-1) ** (index // 50), 3.0, 0.0)), index / 10)
        vehicle.step_to((index + 1) / 10)
        frames = ask(vehicle, common.MAV_CMD_REQUEST_MESSAGE, common.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
        (position,) = of_type(frames, "LOCAL_POSITION_NED")
        assert math.dist(last, (position.vx, position.vy)) <= 1.2 * 0.25
        last = (position.vx, position.vy)


def test_silence_brakes_a_half_second_after_the_time_out_and_it_hovers_in_guided() -> None:
    vehicle = hovering(speed_m_s=10.0)
    vehicle.receive(setpoint(velocity=(10.0, 0.0, 0.0)), 0.0)
    vehicle.step_to(3.0)
    assert vehicle.truth.speed_m_s == pytest.approx(10.0, abs=0.05)
    # The jerk is limited: half a second later it has lost a twentieth of its speed, and brakes fully.
    vehicle.step_to(3.5)
    assert 9.4 < vehicle.truth.speed_m_s < 9.7
    # Measured: stopped after 7.1 s and 53 m.
    vehicle.step_to(8.0)
    assert vehicle.truth.speed_m_s < 0.5
    vehicle.step_to(60.0)
    assert vehicle.truth.north_m == pytest.approx(53.0, abs=4.0)
    assert vehicle.truth.speed_m_s == pytest.approx(0.0, abs=1e-3)
    assert (vehicle.truth.altitude_m, vehicle.mode) == (600.0, GUIDED)


def test_a_shorter_time_out_brakes_sooner() -> None:
    vehicle = hovering(speed_m_s=10.0)
    vehicle.receive(pack(companion.param_set_encode(1, 1, b"GUID_TIMEOUT", 0.5, 9)), 0.0)
    vehicle.receive(setpoint(velocity=(10.0, 0.0, 0.0)), 0.0)
    vehicle.step_to(60.0)
    # Measured: 28 m.
    assert vehicle.truth.north_m == pytest.approx(28.0, abs=4.0)


def test_setpoints_every_two_and_a_half_seconds_are_enough() -> None:
    vehicle = hovering()
    for index in range(8):
        vehicle.receive(setpoint(velocity=(5.0, 0.0, 0.0)), index * 2.5)
        vehicle.step_to((index + 1) * 2.5)
    assert vehicle.truth.speed_m_s == pytest.approx(5.0, abs=1e-3)


@pytest.mark.parametrize("mode", [STABILIZE, ALT_HOLD, LOITER, RTL, LAND, BRAKE])
def test_a_velocity_is_ignored_in_silence_outside_guided(mode: int) -> None:
    with_setpoints, without = hovering(), hovering()
    for vehicle in (with_setpoints, without):
        set_mode(vehicle, mode)
    fly(with_setpoints, 5.0, setpoint(velocity=(5.0, 5.0, 0.0)))
    for index in range(50):
        without.step_to((index + 1) / 10)
    assert with_setpoints.truth == without.truth


def test_a_velocity_is_ignored_in_silence_on_the_ground() -> None:
    vehicle = on_the_ground(guided=True, armed=True)
    fly(vehicle, 5.0, setpoint(velocity=(5.0, 0.0, -2.0)))
    assert (vehicle.truth.north_m, vehicle.truth.altitude_m) == (0.0, GROUND_M)


def test_entering_guided_forgets_the_old_setpoint() -> None:
    vehicle = hovering()
    fly(vehicle, 2.0, setpoint(velocity=(5.0, 0.0, 0.0)))
    set_mode(vehicle, BRAKE, t_s=2.0)
    set_mode(vehicle, GUIDED, t_s=2.0)
    vehicle.step_to(3.0)
    assert vehicle.truth.speed_m_s < 3.5


@pytest.mark.parametrize("mask", [VELOCITY, VELOCITY_YAW, VELOCITY_YAW_RATE, VELOCITY_ALL])
@pytest.mark.parametrize("frame", [1, 7])
def test_every_velocity_mask_flies_north_and_east(mask: int, frame: int) -> None:
    vehicle = hovering(heading_rad=2.0)
    fly(vehicle, 8.0, setpoint(mask, frame, velocity=(3.0, 4.0, 0.0), yaw=2.0))
    assert vehicle.truth.speed_m_s == pytest.approx(5.0, abs=0.05)
    assert math.atan2(vehicle.truth.east_m, vehicle.truth.north_m) == pytest.approx(math.atan2(4.0, 3.0), abs=1e-3)


@pytest.mark.parametrize("frame", [8, 9])
def test_a_body_frame_is_turned_by_the_nose(frame: int) -> None:
    vehicle = hovering(heading_rad=math.pi / 2)
    fly(vehicle, 8.0, setpoint(VELOCITY_YAW, frame, velocity=(4.0, 0.0, 0.0), yaw=math.pi / 2))
    assert vehicle.truth.east_m > 20.0
    assert abs(vehicle.truth.north_m) < 0.1


@pytest.mark.parametrize(
    "datagram",
    [
        setpoint(frame=12, velocity=(5.0, 0.0, 0.0)),
        setpoint(velocity=(NAN, 0.0, 0.0)),
        setpoint(velocity=(5.0, 0.0, NAN)),
        setpoint(velocity=(math.inf, 0.0, 0.0)),
        setpoint(velocity=(1e4, 0.0, 0.0)),
        setpoint(POSITION, position=(NAN, 0.0, 0.0)),
        setpoint(mask=0x0DFF),
    ],
    ids=["frame 12", "nan north", "nan down", "inf", "insane", "nan place", "nothing asked"],
)
def test_a_setpoint_that_makes_no_sense_brakes_to_a_stop(datagram: bytes) -> None:
    vehicle = hovering(speed_m_s=8.0)
    fly(vehicle, 10.0, datagram)
    truth = vehicle.truth
    assert truth.speed_m_s < 0.05
    assert all(map(math.isfinite, (truth.north_m, truth.east_m, truth.altitude_m, truth.heading_rad)))


def test_the_nose_follows_the_track_unless_a_yaw_is_given() -> None:
    tracking, yawing = hovering(), hovering()
    fly(tracking, 5.0, setpoint(velocity=(0.0, 5.0, 0.0)))
    fly(yawing, 5.0, setpoint(VELOCITY_YAW, velocity=(0.0, 5.0, 0.0), yaw=-1.0))
    assert tracking.truth.heading_rad == pytest.approx(math.pi / 2, abs=1e-3)
    assert yawing.truth.heading_rad == pytest.approx(-1.0, abs=1e-3)


@pytest.mark.parametrize("mask", [VELOCITY_YAW, VELOCITY_YAW_RATE, VELOCITY_ALL])
def test_a_yaw_that_is_no_number_leaves_the_nose_on_the_track(mask: int) -> None:
    vehicle = hovering()
    fly(vehicle, 5.0, setpoint(mask, velocity=(0.0, 5.0, 0.0), yaw=NAN, yaw_rate=NAN))
    assert vehicle.truth.heading_rad == pytest.approx(math.pi / 2, abs=1e-3)


def test_a_yaw_rate_turns_the_nose() -> None:
    vehicle = hovering()
    fly(vehicle, 4.0, setpoint(VELOCITY_YAW_RATE, velocity=(0.0, 5.0, 0.0), yaw_rate=0.2))
    assert vehicle.truth.heading_rad == pytest.approx(0.8, abs=1e-6)


@pytest.mark.parametrize(("down_m_s", "climb_m_s"), [(-1.0, 1.0), (-9.0, 2.5), (1.0, -1.0), (9.0, -1.5)])
def test_a_vertical_velocity_is_obeyed_within_its_limits(down_m_s: float, climb_m_s: float) -> None:
    vehicle = hovering()
    fly(vehicle, 4.0, setpoint(velocity=(0.0, 0.0, down_m_s)))
    before_m = vehicle.truth.altitude_m
    fly(vehicle, 5.0, setpoint(velocity=(0.0, 0.0, down_m_s)), from_s=4.0)
    assert vehicle.truth.altitude_m - before_m == pytest.approx(climb_m_s, abs=1e-6)


@pytest.mark.parametrize(
    ("frame", "position", "place"),
    [
        (1, (50.0, -30.0, -120.0), (50.0, -30.0, 620.0)),
        (7, (50.0, -30.0, -20.0), (60.0, -10.0, 620.0)),
        (8, (50.0, 0.0, 0.0), (10.0, 70.0, 600.0)),
    ],
)
def test_a_position_is_flown_to_and_held(
    frame: int, position: tuple[float, float, float], place: tuple[float, float, float]
) -> None:
    vehicle = hovering(north_m=10.0, east_m=20.0, heading_rad=math.pi / 2)
    vehicle.receive(setpoint(POSITION, frame, position=position), 0.0)
    vehicle.step_to(60.0)
    truth = vehicle.truth
    assert (truth.north_m, truth.east_m, truth.altitude_m) == pytest.approx(place, abs=0.2)


def test_a_setpoint_in_the_air_replaces_a_take_off() -> None:
    vehicle = on_the_ground(guided=True, armed=True)
    ask(vehicle, common.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 50.0)
    vehicle.step_to(4.0)
    fly(vehicle, 10.0, setpoint(velocity=(0.0, 0.0, 0.0)), from_s=4.0)
    assert vehicle.truth.altitude_m < GROUND_M + 15.0


def test_a_setpoint_on_the_ground_does_not_replace_a_take_off() -> None:
    vehicle = on_the_ground(guided=True, armed=True)
    ask(vehicle, common.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 20.0)
    vehicle.receive(setpoint(velocity=(0.0, 0.0, 0.0)), 0.0)
    vehicle.step_to(30.0)
    assert vehicle.truth.altitude_m == pytest.approx(GROUND_M + 20.0, abs=0.1)


def test_the_parts_of_a_step_make_the_same_flight_as_the_whole() -> None:
    coarse, fine = hovering(), hovering()
    for vehicle in (coarse, fine):
        vehicle.receive(setpoint(velocity=(6.0, -4.0, -1.0)), 0.0)
    coarse.step_to(10.0)
    for index in range(1, 1001):
        fine.step_to(index / 100)
    assert math.dist((coarse.truth.north_m, coarse.truth.east_m), (fine.truth.north_m, fine.truth.east_m)) < 0.25


# The kinematic point


@given(st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi), st.floats(0.05, 2.0))
def test_a_point_turns_at_its_limit_and_no_faster(heading: float, course: float, dt: float) -> None:
    vehicle = point(heading_rad=heading)
    vehicle.receive(setpoint(velocity=(60.0 * math.cos(course), 60.0 * math.sin(course), 0.0)), 0.0)
    vehicle.step_to(dt)
    wanted_rad = abs(math.remainder(course - heading, math.tau))
    limit_rad = 2.0 * 9.80665 / 60.0 * dt
    turned_rad = abs(math.remainder(vehicle.truth.heading_rad - heading, math.tau))
    assert turned_rad == pytest.approx(min(wanted_rad, limit_rad), abs=1e-6)


@pytest.mark.parametrize(("asked_m_s", "flown_m_s"), [(50.0, 50.0), (10.0, 40.0), (200.0, 80.0)])
def test_a_point_takes_the_asked_speed_at_once_within_its_limits(asked_m_s: float, flown_m_s: float) -> None:
    vehicle = point()
    vehicle.receive(setpoint(velocity=(asked_m_s, 0.0, 0.0)), 0.0)
    vehicle.step_to(1.0)
    assert vehicle.truth.north_m == pytest.approx(flown_m_s)
    assert vehicle.truth.speed_m_s == pytest.approx(flown_m_s)


def test_a_point_without_setpoints_circles_to_the_right_at_its_least_radius() -> None:
    vehicle = point(heading_rad=0.0)
    radius_m = 60.0**2 / (2.0 * 9.80665)
    for index in range(1, 200):
        vehicle.step_to(index * 0.5)
        assert math.dist((vehicle.truth.north_m, vehicle.truth.east_m), (0.0, radius_m)) == pytest.approx(radius_m)
        assert vehicle.truth.speed_m_s == pytest.approx(60.0)


def test_a_point_flies_on_for_exactly_three_seconds_after_its_last_setpoint() -> None:
    vehicle = point(heading_rad=0.0)
    vehicle.receive(setpoint(velocity=(60.0, 0.0, 0.0)), 0.0)
    vehicle.step_to(10.0)
    expected_rad = math.remainder(7.0 * 2.0 * 9.80665 / 60.0, math.tau)
    assert vehicle.truth.heading_rad == pytest.approx(expected_rad, abs=1e-6)


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.0), (NAN, 1.0, 0.0)])
def test_a_point_told_to_stop_circles(velocity: tuple[float, float, float]) -> None:
    vehicle = point()
    fly(vehicle, 2.0, setpoint(velocity=velocity))
    assert vehicle.truth.speed_m_s == pytest.approx(60.0)
    assert vehicle.truth.heading_rad == pytest.approx(2.0 * 2.0 * 9.80665 / 60.0)


def test_a_point_outside_guided_circles_whatever_is_sent() -> None:
    vehicle = point()
    assert heartbeat_mode(set_mode(vehicle, LOITER)) == LOITER
    fly(vehicle, 2.0, setpoint(velocity=(60.0, 0.0, 0.0)))
    assert vehicle.truth.heading_rad == pytest.approx(2.0 * 2.0 * 9.80665 / 60.0)


def test_a_point_on_the_ground_does_not_exist() -> None:
    with pytest.raises(ValueError, match="cannot stop"):
        point(in_air=False)


@pytest.mark.parametrize(("n_max", "least", "greatest"), [(0.0, 1.0, 2.0), (NAN, 1.0, 2.0), (1.0, 0.0, 2.0), (1, 3, 2)])
def test_a_profile_of_impossible_limits_is_refused(n_max: float, least: float, greatest: float) -> None:
    with pytest.raises(ValueError, match="kinematic profile"):
        kinematic_profile(n_max, least, greatest)


# Wind


def in_wind(vehicle: StandIn, north_m_s: float, east_m_s: float) -> StandIn:
    vehicle.wind_m_s = (north_m_s, east_m_s)
    return vehicle


def flown_m_s(vehicle: StandIn, dt_s: float, datagram: bytes, from_s: float) -> tuple[float, float]:
    """Return how fast, (north, east), the truth moves while a setpoint is streamed."""
    before = vehicle.truth
    fly(vehicle, from_s + dt_s, datagram, from_s=from_s)
    after = vehicle.truth
    return (after.north_m - before.north_m) / dt_s, (after.east_m - before.east_m) / dt_s


def reported_m_s(vehicle: StandIn, name: str, message_id: int) -> tuple[float, float]:
    (report,) = of_type(ask(vehicle, common.MAV_CMD_REQUEST_MESSAGE, message_id), name)
    return report.vx, report.vy


winds = st.tuples(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0))


@pytest.mark.parametrize("make", [point, hovering])
def test_setting_still_air_before_each_step_changes_no_byte(make: Callable[..., StandIn]) -> None:
    untouched, set_still = make(north_m=3_000.0), make(north_m=3_000.0)
    for index in range(100):
        # The setpoints end half-way, so that both steering and what follows silence are flown.
        if index < 50:
            asked = setpoint(velocity=(50.0 - index, index * 0.9, 0.5))
            assert untouched.receive(asked, index * 0.1) == set_still.receive(asked, index * 0.1)
        set_still.wind_m_s = (0.0, 0.0)
        untouched.step_to((index + 1) * 0.1)
        set_still.step_to((index + 1) * 0.1)
        assert untouched.telemetry((index + 1) * 0.1) == set_still.telemetry((index + 1) * 0.1)
        assert untouched.truth == set_still.truth


@given(course=st.floats(-math.pi, math.pi), wind=winds)
@settings(max_examples=50)
def test_a_point_crabs_along_the_course_asked_for_at_the_speed_of_the_wind_triangle(
    course: float, wind: tuple[float, float]
) -> None:
    vehicle = in_wind(point(heading_rad=course), *wind)
    asked = setpoint(velocity=(60.0 * math.cos(course), 60.0 * math.sin(course), 0.0))
    fly(vehicle, 5.0, asked)
    north_m_s, east_m_s = flown_m_s(vehicle, 2.0, asked, from_s=5.0)
    along_m_s = wind[0] * math.cos(course) + wind[1] * math.sin(course)
    across_m_s = wind[1] * math.cos(course) - wind[0] * math.sin(course)
    ground_m_s = along_m_s + math.sqrt(60.0**2 - across_m_s**2)
    assert (north_m_s, east_m_s) == pytest.approx(
        (ground_m_s * math.cos(course), ground_m_s * math.sin(course)), abs=0.01
    )
    assert vehicle.truth.speed_m_s == pytest.approx(ground_m_s, abs=0.01)
    assert math.sin(course - vehicle.truth.heading_rad) * 60.0 == pytest.approx(across_m_s, abs=0.01)


@pytest.mark.parametrize(("wind_m_s", "ground_m_s"), [(20.0, 80.0), (-20.0, 40.0), (-70.0, -10.0)])
def test_a_point_gains_a_tail_wind_and_loses_a_head_wind(wind_m_s: float, ground_m_s: float) -> None:
    vehicle = in_wind(point(), wind_m_s, 0.0)
    assert flown_m_s(vehicle, 2.0, setpoint(velocity=(60.0, 0.0, 0.0)), from_s=0.0) == pytest.approx((ground_m_s, 0.0))
    assert vehicle.truth.heading_rad == pytest.approx(0.0)


def test_a_cross_wind_above_its_airspeed_carries_a_point_off_with_its_nose_against_it() -> None:
    vehicle = in_wind(point(), 5.0, 75.0)
    asked = setpoint(velocity=(60.0, 0.0, 0.0))
    fly(vehicle, 10.0, asked)
    assert flown_m_s(vehicle, 2.0, asked, from_s=10.0) == pytest.approx((5.0, 15.0), abs=0.01)
    assert vehicle.truth.heading_rad == pytest.approx(-math.pi / 2, abs=1e-3)


@pytest.mark.slow
@given(st.lists(st.tuples(winds, st.floats(-math.pi, math.pi), st.floats(0.0, 100.0)), min_size=1, max_size=12))
def test_no_wind_makes_a_point_turn_faster_through_the_air_than_its_limit(
    legs: list[tuple[tuple[float, float], float, float]],
) -> None:
    vehicle = point()
    for index, (wind, course, asked_m_s) in enumerate(legs):
        before_rad = vehicle.truth.heading_rad
        in_wind(vehicle, *wind)
        asked = (asked_m_s * math.cos(course), asked_m_s * math.sin(course), 0.0)
        vehicle.receive(setpoint(velocity=asked), index * 0.5)
        vehicle.step_to((index + 1) * 0.5)
        ground_m_s = vehicle.ground_velocity_m_s
        airspeed_m_s = math.dist(ground_m_s, wind)
        turned_rad = abs(math.remainder(vehicle.truth.heading_rad - before_rad, math.tau))
        assert turned_rad <= 2.0 * 9.80665 / airspeed_m_s * 0.5 + 1e-9
        assert 40.0 - 1e-9 <= airspeed_m_s <= 80.0 + 1e-9


@pytest.mark.parametrize(
    ("make", "velocity"), [(point, (0.0, 60.0, 0.0)), (hovering, (3.0, -5.0, 0.0)), (hovering, (9.0, 9.0, 0.0))]
)
def test_the_reported_velocity_in_wind_is_how_the_truth_moves(
    make: Callable[..., StandIn], velocity: tuple[float, float, float]
) -> None:
    # North of the origin the plane's convergence is nil, so grid and wire compare as they are.
    vehicle = in_wind(make(north_m=1_000.0), -8.0, 3.0)
    asked = setpoint(velocity=velocity)
    fly(vehicle, 15.0, asked)
    moved_m_s = flown_m_s(vehicle, 1.0, asked, from_s=15.0)
    assert vehicle.ground_velocity_m_s == pytest.approx(moved_m_s, abs=0.01)
    local_m_s = reported_m_s(vehicle, "LOCAL_POSITION_NED", common.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
    assert local_m_s == pytest.approx(moved_m_s, abs=0.01)
    global_cm_s = reported_m_s(vehicle, "GLOBAL_POSITION_INT", common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    assert global_cm_s == pytest.approx((moved_m_s[0] * 100.0, moved_m_s[1] * 100.0), abs=1.5)
    (fix,) = of_type(ask(vehicle, common.MAV_CMD_REQUEST_MESSAGE, common.MAVLINK_MSG_ID_GPS_RAW_INT), "GPS_RAW_INT")
    assert fix.vel == pytest.approx(math.hypot(*moved_m_s) * 100.0, abs=1.5)
    assert fix.cog == pytest.approx(math.degrees(math.atan2(moved_m_s[1], moved_m_s[0])) % 360.0 * 100.0, abs=10.0)


def test_a_point_reports_its_nose_where_it_flies_another_course() -> None:
    vehicle = in_wind(point(north_m=1_000.0), 0.0, 30.0)
    fly(vehicle, 5.0, setpoint(velocity=(60.0, 0.0, 0.0)))
    (report,) = of_type(
        ask(vehicle, common.MAV_CMD_REQUEST_MESSAGE, common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT), "GLOBAL_POSITION_INT"
    )
    assert (report.hdg, report.vy) == (33000, 0)


def test_a_wind_that_changes_is_felt_by_a_point_at_once() -> None:
    vehicle = in_wind(point(), 10.0, 0.0)
    assert vehicle.truth.speed_m_s == pytest.approx(70.0)
    in_wind(vehicle, 0.0, 0.0)
    assert vehicle.truth.speed_m_s == pytest.approx(60.0)


def test_a_point_without_setpoints_circles_in_the_air_and_drifts_with_the_wind() -> None:
    vehicle = in_wind(point(), 7.0, -4.0)
    radius_m = 60.0**2 / (2.0 * 9.80665)
    for index in range(1, 200):
        t_s = index * 0.5
        vehicle.step_to(t_s)
        centre = (7.0 * t_s, radius_m - 4.0 * t_s)
        assert math.dist((vehicle.truth.north_m, vehicle.truth.east_m), centre) == pytest.approx(radius_m)


def test_the_parts_of_a_step_in_wind_make_the_same_flight_as_the_whole_where_nothing_is_steered() -> None:
    coarse, fine = in_wind(point(), 9.0, 12.0), in_wind(point(), 9.0, 12.0)
    coarse.step_to(10.0)
    for index in range(1, 1001):
        fine.step_to(index / 100)
    assert (fine.truth.north_m, fine.truth.east_m) == pytest.approx((coarse.truth.north_m, coarse.truth.east_m))


@given(velocity=st.tuples(st.floats(-4.0, 4.0), st.floats(-4.0, 4.0)), wind=st.tuples(*[st.floats(-3.0, 3.0)] * 2))
@settings(max_examples=20)
def test_a_copter_holds_its_ground_velocity_in_a_wind_it_can_fly_against(
    velocity: tuple[float, float], wind: tuple[float, float]
) -> None:
    vehicle = in_wind(hovering(), *wind)
    fly(vehicle, 15.0, setpoint(velocity=(*velocity, 0.0)))
    assert vehicle.ground_velocity_m_s == pytest.approx(velocity, abs=0.01)


@pytest.mark.parametrize(
    ("wind", "ground"),
    [
        ((-5.0, 0.0), (5.3, 0.0)),
        ((5.0, 0.0), (15.3, 0.0)),
        # What lies across the wanted course comes first.
        ((0.0, 5.0), (math.sqrt(10.3**2 - 5.0**2), 0.0)),
    ],
    ids=["head", "tail", "cross"],
)
def test_a_copter_asked_for_too_much_flies_at_its_top_speed_through_the_air(
    wind: tuple[float, float], ground: tuple[float, float]
) -> None:
    vehicle = in_wind(hovering(), *wind)
    fly(vehicle, 30.0, setpoint(velocity=(30.0, 0.0, 0.0)))
    assert vehicle.ground_velocity_m_s == pytest.approx(ground, abs=0.01)
    assert math.dist(vehicle.ground_velocity_m_s, wind) == pytest.approx(10.3, abs=0.01)


@pytest.mark.parametrize(("wind_m_s", "drift_m_s"), [(8.0, 0.0), (14.3, 4.0)])
def test_a_copter_that_brakes_stands_until_the_wind_is_above_its_top_speed(wind_m_s: float, drift_m_s: float) -> None:
    vehicle = in_wind(hovering(), 0.0, wind_m_s)
    set_mode(vehicle, BRAKE)
    vehicle.step_to(30.0)
    assert vehicle.ground_velocity_m_s == pytest.approx((0.0, drift_m_s), abs=0.01)


@pytest.mark.parametrize("armed", [False, True])
def test_no_wind_moves_a_copter_on_the_ground(armed: bool) -> None:
    vehicle = in_wind(on_the_ground(guided=True, armed=armed), 25.0, 25.0)
    vehicle.step_to(10.0)
    assert (vehicle.truth.north_m, vehicle.truth.east_m, vehicle.truth.speed_m_s) == (0.0, 0.0, 0.0)


# The plane and true north


def test_a_setpoint_is_along_true_north_and_the_truth_along_the_grid() -> None:
    vehicle = point(north_m=150_000.0, east_m=150_000.0)
    convergence_rad = FRAME.convergence_rad(150_000.0, 150_000.0)
    assert abs(convergence_rad) > 0.01
    fly(vehicle, 1.0, setpoint(velocity=(0.0, 60.0, 0.0)))
    fly(vehicle, 6.0, setpoint(velocity=(0.0, 60.0, 0.0)), from_s=1.0)
    assert vehicle.truth.heading_rad == pytest.approx(math.pi / 2 - convergence_rad, abs=1e-4)


@pytest.mark.parametrize("make", [point, hovering])
def test_the_reported_velocity_is_how_the_reported_place_moves(make: Callable[..., StandIn]) -> None:
    vehicle = make(north_m=150_000.0, east_m=150_000.0)
    asked = setpoint(velocity=(6.0, -8.0, 0.0))
    fly(vehicle, 20.0, asked)

    def reported(t_s: float) -> Message:
        frames = ask(vehicle, common.MAV_CMD_REQUEST_MESSAGE, common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, t_s=t_s)
        return of_type(frames, "GLOBAL_POSITION_INT")[0]

    before = reported(20.0)
    fly(vehicle, 22.0, asked, from_s=20.0)
    after = reported(22.0)
    moved = LocalFrame(before.lat / 1e7, before.lon / 1e7).to_local(after.lat / 1e7, after.lon / 1e7)
    assert moved == pytest.approx((before.vx / 50.0, before.vy / 50.0), abs=0.05)
    assert after.hdg / 100.0 == pytest.approx(math.degrees(math.atan2(-8.0, 6.0)) % 360.0, abs=0.1)


def test_the_local_position_is_from_home_and_a_position_setpoint_comes_back_in_it() -> None:
    home = Home(150_000.0, 150_000.0, GROUND_M)
    vehicle = StandIn(
        ArduCopter,
        Setup(
            1,
            FRAME,
            north_m=150_100.0,
            east_m=150_000.0,
            altitude_m=600.0,
            home=home,
            in_air=True,
            armed=True,
            guided=True,
        ),
    )
    vehicle.receive(setpoint(POSITION, position=(40.0, -30.0, -90.0)), 0.0)
    vehicle.step_to(60.0)
    frames = ask(vehicle, common.MAV_CMD_REQUEST_MESSAGE, common.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
    (position,) = of_type(frames, "LOCAL_POSITION_NED")
    assert (position.x, position.y, position.z) == pytest.approx((40.0, -30.0, -90.0), abs=0.1)


def test_an_offset_position_is_along_true_north() -> None:
    vehicle = hovering(north_m=150_000.0, east_m=150_000.0)
    vehicle.receive(setpoint(POSITION, 7, position=(800.0, 0.0, 0.0)), 0.0)
    vehicle.step_to(200.0)
    start = LocalFrame(*FRAME.to_global(150_000.0, 150_000.0))
    flown = start.to_local(*FRAME.to_global(vehicle.truth.north_m, vehicle.truth.east_m))
    assert flown == pytest.approx((800.0, 0.0), abs=0.5)


# Telemetry, requests, parameters


def count(vehicle: StandIn, seconds: int) -> dict[str, int]:
    counts: dict[str, int] = {}
    for index in range(seconds * 50):
        vehicle.step_to(index / 50)
        for message in parsed(vehicle.telemetry(index / 50)):
            counts[message.get_type()] = counts.get(message.get_type(), 0) + 1
    return counts


def test_everything_is_streamed_at_its_default_rate() -> None:
    assert count(hovering(), 10) == {
        "HEARTBEAT": 10,
        "SYS_STATUS": 10,
        "EXTENDED_SYS_STATE": 10,
        "GPS_RAW_INT": 10,
        "GLOBAL_POSITION_INT": 100,
        "LOCAL_POSITION_NED": 40,
        "ATTITUDE": 40,
        "VFR_HUD": 20,
        "HOME_POSITION": 2,
        "BATTERY_STATUS": 2,
    }


def test_an_interval_can_be_set_stopped_and_put_back() -> None:
    vehicle = hovering(rates_hz=LOCKSTEP_RATES_HZ)
    interval, attitude = common.MAV_CMD_SET_MESSAGE_INTERVAL, common.MAVLINK_MSG_ID_ATTITUDE
    assert result(ask(vehicle, interval, attitude, 200_000.0)) == common.MAV_RESULT_ACCEPTED
    ask(vehicle, interval, common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, -1.0)
    ask(vehicle, interval, common.MAVLINK_MSG_ID_HEARTBEAT, 100_000.0)
    ask(vehicle, interval, common.MAVLINK_MSG_ID_HEARTBEAT, 0.0)
    counts = count(vehicle, 10)
    assert (counts["ATTITUDE"], counts["HEARTBEAT"], "GLOBAL_POSITION_INT" in counts) == (50, 10, False)


@pytest.mark.parametrize("message_id", [0, 1, 24, 30, 32, 33, 74, 147, 148, 242, 245])
def test_every_message_can_be_requested(message_id: int) -> None:
    frames = ask(hovering(), common.MAV_CMD_REQUEST_MESSAGE, message_id)
    assert result(frames) == common.MAV_RESULT_ACCEPTED
    assert [message.get_msgId() for message in parsed(frames)] == [common.MAVLINK_MSG_ID_COMMAND_ACK, message_id]


@pytest.mark.parametrize("message_id", [149.0, NAN, -1.0, 1e30])
def test_a_message_it_does_not_have_is_unsupported(message_id: float) -> None:
    frames = ask(hovering(), common.MAV_CMD_REQUEST_MESSAGE, message_id)
    assert [message.get_type() for message in parsed(frames)] == ["COMMAND_ACK"]
    assert result(frames) == common.MAV_RESULT_UNSUPPORTED


def test_an_unknown_command_is_unsupported_and_the_answer_goes_to_who_asked() -> None:
    (ack,) = of_type(ask(hovering(), 31010), "COMMAND_ACK")
    assert (ack.command, ack.result) == (31010, common.MAV_RESULT_UNSUPPORTED)
    assert (ack.target_system, ack.target_component) == (1, 191)


def test_time_boot_counts_milliseconds_of_the_given_clock_from_the_start() -> None:
    vehicle = hovering(start_s=1000.0)
    frames = vehicle.telemetry(1002.5)
    assert of_type(frames, "GLOBAL_POSITION_INT")[0].time_boot_ms == 2500


@pytest.mark.parametrize(("make", "autopilot"), [(hovering, 3), (point, 0)])
def test_a_point_says_that_it_is_generic_and_a_copter_that_it_is_ardupilot(
    make: Callable[[], StandIn], autopilot: int
) -> None:
    assert of_type(make().telemetry(0.0), "HEARTBEAT")[0].autopilot == autopilot


def test_health_says_that_it_may_be_armed() -> None:
    (status,) = of_type(hovering().telemetry(0.0), "SYS_STATUS")
    needed = 1 | 2 | 4 | 32 | common.MAV_SYS_STATUS_PREARM_CHECK
    assert status.onboard_control_sensors_health & needed == needed
    assert (status.voltage_battery, status.battery_remaining) == (12600, 100)


def test_parameters_are_listed_read_and_set() -> None:
    vehicle = hovering()
    listed = of_type(vehicle.receive(pack(companion.param_request_list_encode(1, 1)), 0.0), "PARAM_VALUE")
    told = {value.param_id: value.param_value for value in listed}
    assert (
        told.items()
        >= {
            "GUID_TIMEOUT": 3.0,
            "WPNAV_ACCEL": 250.0,
            "ANGLE_MAX": 3000.0,
            "FS_GCS_ENABLE": 0.0,
            "WPNAV_SPEED": 1000.0,
            "PSC_JERK_XY": 5.0,
            "BATT_LOW_VOLT": 10.5,
            "BATT_FS_LOW_ACT": 0.0,
            "FS_EKF_ACTION": 1.0,
            "FENCE_ENABLE": 0.0,
            "FENCE_ACTION": 1.0,
            "ADSB_TYPE": 0.0,
        }.items()
    )
    (changed,) = of_type(
        vehicle.receive(pack(companion.param_set_encode(1, 1, b"WPNAV_ACCEL", 500.0, 9)), 0.0), "PARAM_VALUE"
    )
    by_name = pack(companion.param_request_read_encode(1, 1, b"WPNAV_ACCEL", -1))
    by_index = pack(companion.param_request_read_encode(1, 1, b"", 1))
    for request in (by_name, by_index):
        (read,) = of_type(vehicle.receive(request, 0.0), "PARAM_VALUE")
        assert (read.param_id, read.param_value) == (changed.param_id, 500.0)


@pytest.mark.parametrize("value", [NAN, math.inf, -1.0, 0.0, 99.0])
def test_a_parameter_value_out_of_range_comes_back_unchanged(value: float) -> None:
    vehicle = hovering()
    request = pack(companion.param_set_encode(1, 1, b"GUID_TIMEOUT", value, 9))
    (kept,) = of_type(vehicle.receive(request, 0.0), "PARAM_VALUE")
    assert kept.param_value == 3.0


def test_an_unknown_parameter_is_ignored() -> None:
    assert hovering().receive(pack(companion.param_set_encode(1, 1, b"NO_SUCH", 1.0, 9)), 0.0) == []


# Hostile and foreign input


@pytest.mark.parametrize("target", [2, 255])
def test_what_is_addressed_to_another_system_is_ignored(target: int) -> None:
    vehicle = hovering()
    assert ask(vehicle, common.MAV_CMD_DO_SET_MODE, 1, LAND, target=target) == []
    vehicle.receive(setpoint(velocity=(5.0, 0.0, 0.0), target=target), 0.0)
    vehicle.step_to(2.0)
    assert (vehicle.mode, vehicle.truth.speed_m_s) == (GUIDED, 0.0)


def test_what_is_addressed_to_everybody_is_obeyed() -> None:
    vehicle = hovering()
    ask(vehicle, common.MAV_CMD_DO_SET_MODE, 1, LAND, target=0)
    assert vehicle.mode == LAND


def test_what_is_addressed_to_another_component_is_ignored() -> None:
    message = companion.command_long_encode(1, 154, common.MAV_CMD_DO_SET_MODE, 0, 1, LAND, 0, 0, 0, 0, 0)
    vehicle = hovering()
    assert vehicle.receive(pack(message), 0.0) == []
    assert vehicle.mode == GUIDED


def test_a_damaged_datagram_does_not_swallow_the_next() -> None:
    vehicle = hovering()
    assert vehicle.receive(b"\xfd\xff\x01", 0.0) == []
    assert result(set_mode(vehicle, BRAKE)) == common.MAV_RESULT_ACCEPTED


def test_a_damaged_command_is_ignored() -> None:
    frame = bytearray(pack(companion.command_long_encode(1, 1, 176, 0, 1, LAND, 0, 0, 0, 0, 0)))
    frame[12] ^= 0x10
    vehicle = hovering()
    assert vehicle.receive(bytes(frame), 0.0) == []
    assert vehicle.mode == GUIDED


@given(st.binary(max_size=600), st.sampled_from([b"", b"\xfd", b"\xfe"]))
def test_random_bytes_never_raise(data: bytes, marker: bytes) -> None:
    vehicle = hovering()
    vehicle.receive(marker + data, 0.0)
    vehicle.step_to(0.5)
    vehicle.telemetry(0.5)


any_float = st.floats(width=32)
any_byte = st.integers(0, 255)
hostile_messages = st.one_of(
    st.builds(
        lambda command, parameters: companion.command_long_encode(1, 1, command, 0, *parameters),
        st.sampled_from([20, 21, 22, 176, 400, 511, 512, 31010]),
        st.lists(any_float, min_size=7, max_size=7),
    ),
    st.builds(
        lambda frame, mask, values: companion.set_position_target_local_ned_encode(0, 1, 1, frame, mask, *values),
        st.one_of(st.sampled_from([1, 7, 8, 9, 12]), any_byte),
        st.one_of(st.sampled_from([VELOCITY, VELOCITY_ALL, POSITION]), st.integers(0, 65535)),
        st.lists(any_float, min_size=11, max_size=11),
    ),
    st.builds(
        lambda name, value, kind: companion.param_set_encode(1, 1, name, value, kind),
        st.one_of(st.sampled_from([b"GUID_TIMEOUT", b"WPNAV_ACCEL"]), st.binary(max_size=16)),
        any_float,
        any_byte,
    ),
    st.builds(
        lambda name, index: companion.param_request_read_encode(1, 1, name, index),
        st.binary(max_size=16),
        st.integers(-(2**15), 2**15 - 1),
    ),
    st.builds(lambda base, custom: companion.set_mode_encode(1, base, custom), any_byte, st.integers(0, 2**32 - 1)),
)


@pytest.mark.slow
@pytest.mark.parametrize("make", [hovering, point])
@given(messages=st.lists(hostile_messages, max_size=8))
def test_hostile_values_never_raise_nor_make_the_truth_unreal(make: Callable[[], StandIn], messages: list[Any]) -> None:
    vehicle = make()
    for index, message in enumerate(messages):
        vehicle.receive(pack(message), index * 0.5)
        vehicle.step_to((index + 1) * 0.5)
        vehicle.telemetry((index + 1) * 0.5)
    truth = vehicle.truth
    assert all(map(math.isfinite, (truth.north_m, truth.east_m, truth.altitude_m, truth.heading_rad)))


def test_the_same_input_gives_the_same_frames_byte_for_byte() -> None:
    def run() -> list[bytes]:
        vehicle, frames = hovering(), []
        for index in range(50):
            frames += vehicle.receive(setpoint(velocity=(index * 0.2, 1.0, 0.0)), index * 0.1)
            vehicle.step_to((index + 1) * 0.1)
            frames += vehicle.telemetry((index + 1) * 0.1)
        return frames

    assert run() == run()
