"""What each adapter sends, byte for byte, and what it never sends."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.autopilot.arduplane import LOITER_PERIOD_S, RESEND_PERIOD_S
from companion.autopilot.heartbeat import IDENTITIES, HeartbeatIdentity
from companion.autopilot.intake import Message
from companion.autopilot.linked import VERTICAL_SPEED_M_S, LinkedAdapter
from companion.autopilot.registry import ADAPTERS
from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.geo.air_density import true_per_indicated
from companion.guard.types import Setpoint

SYSTEM = 7
HEIGHT_M = 20.0
NORTH_EAST = Setpoint(math.radians(30.0), 10.0, 21.0)
IDENTITY_OF = {identity.kind.name: identity for identity in IDENTITIES}
VELOCITY_KINDS = ("arducopter", "px4-copter", "ardurover", "kinematic")
GUIDED = common.MAV_MODE_FLAG_SAFETY_ARMED | common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED

GOLDEN: dict[str, tuple[str, ...]] = {
    "arducopter": (
        "fd3500000007bf540000881300000000000000000000000000000f811f414664493f000000bf000000000000000000000000"
        "0000000000000000c70d070101acc2",
        "fd3500000107bf540000ec1300000000000000000000000000006b421f410d05763f000000bf000000000000000000000000"
        "0000000000000000c70d0701016850",
    ),
    "arduplane": (
        "fd2700000207bf520000881300002365763f68ee8a3e0000000000000000000000000000000000000000000000000701c66844",
        "fd2000000007bf4b000000000000000000000000000000000000000000000000000000400244f9a707016658",
        "fd2100000107bf4b0000000000005e081c410000000000000000000000000000000000000000f8a7070103f82d",
        "fd2700000407bf520000ec130000c6c7713fc743a83e0000000000000000000000000000000000000000000000000701c61a19",
        "fd2000000307bf4b0000000080bf00000000000070420000000080a1031c00b4c40400400244c00007011694",
    ),
    "px4-copter": (
        "fd3500000007bf540000881300000000000000000000000000006a1e1f413727863f000000bf000000000000000000000000"
        "3d0ad73d00000000c7090701011c4d",
        "fd3500000107bf540000ec1300000000000000000000000000004abb1e4185daa03f000000bf000000000000000000000000"
        "2506013e00000000c709070101c8d3",
    ),
    "px4-plane": (
        "fd3500000007bf540000881300000000c842000048c2000098c1bab46941c7695a4000000000000000000000000000000000"
        "0000000000000000c00d0701013928",
        "fd3500000107bf540000ec1300000000c842000048c2000098c1d33c6841182e724000000000000000000000000000000000"
        "0000000000000000c00d0701012db1",
    ),
    "ardurover": (
        "fd3500000007bf540000881300000000000000000000000000007c9e1c4128df024000000080000000000000000000000000"
        "0000000000000000c70d070101d0bb",
        "fd3500000107bf540000ec13000000000000000000000000000099231b41838e1c4000000080000000000000000000000000"
        "0000000000000000c70d070101dd02",
    ),
    "kinematic": (
        "fd3500000007bf5400008813000000000000000000000000000067900a410000a040000000bf000000000000000000000000"
        "0000000000000000c70d070101e24f",
        "fd3500000107bf540000ec13000000000000000000000000000067900a410000a040000000bf000000000000000000000000"
        "0000000000000000c70d0701013d95",
    ),
}
"""Two setpoints a tenth of a second apart: a vehicle that flies north at 15 m/s shall fly 10 m/s on 30 degrees."""
HELD = {
    "px4-copter": [
        "fd3500000007bf54000088130000000000000000000000000000000000000000000000000000000000000000000000000000"
        "db0fc93f00000000c709070101399d",
    ],
    "px4-plane": [
        "fd3500000007bf540000881300000000c842000048c2000090c1000070410000000000000000000000000000000000000000"
        "0000000000000000c00d070101334c",
    ],
}
ASKED = [
    "fd2000000007bf4c0000000004420050c3470000000000000000000000000000000000000000ff010701d140",
    "fd1100000107bf140000ffff0701434f4d5f4f465f4c4f53535f54e64b",
    "fd1200000207bf140000ffff0701434f4d5f4f424c5f52435f414354d85a",
]
"""The first message rate and the first parameters."""


def mav() -> common.MAVLink:
    return common.MAVLink(None, srcSystem=SYSTEM, srcComponent=common.MAV_COMP_ID_AUTOPILOT1)


def told(adapter: LinkedAdapter, *messages: Message, now_s: float = 0.0) -> None:
    for message in messages:
        adapter.receive(bytes(message.pack(mav())), now_s)


def type_of(kind: HeartbeatIdentity) -> int:
    return common.MAV_TYPE_GENERIC if kind.types is None else min(kind.types)


def beat(kind: HeartbeatIdentity, base_mode: int = GUIDED, mode: int | None = None) -> Message:
    mode = kind.guided_mode if mode is None else mode
    return common.MAVLink_heartbeat_message(type_of(kind), kind.autopilot, base_mode, mode, common.MAV_STATE_ACTIVE, 3)


def where(boot_ms: int = 1_000, speed_cm_s: int = 1_500, course_rad: float = 0.0, height_mm: int = 20_000) -> Message:
    vx, vy = round(speed_cm_s * math.cos(course_rad)), round(speed_cm_s * math.sin(course_rad))
    return common.MAVLink_global_position_int_message(
        boot_ms, 470_000_000, 80_000_000, 520_000, height_mm, vx, vy, 0, 9_000
    )


def flying(
    name: str, speed_cm_s: int = 1_500, course_rad: float = 0.0, height_mm: int = 20_000, mode: int | None = None
) -> LinkedAdapter:
    """Return an adapter that has heard its autopilot, guided and flying north at 20 m."""
    adapter = ADAPTERS[name](SYSTEM)
    told(
        adapter,
        beat(IDENTITY_OF[name], mode=mode),
        where(1_000, speed_cm_s, course_rad, height_mm),
        common.MAVLink_local_position_ned_message(1_000, 100.0, -50.0, -18.0, 0.0, 0.0, 0.0),
        common.MAVLink_attitude_message(1_000, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        now_s=5.0,
    )
    return adapter


def decoded(frame: bytes) -> Message:
    (message,) = common.MAVLink(None).parse_buffer(bytearray(frame))
    return message


def sent(adapter: LinkedAdapter, setpoint: Setpoint, convergence_rad: float = 0.0, now_s: float = 5.0) -> list[Message]:
    return [decoded(frame) for frame in adapter.encode(setpoint, convergence_rad, now_s)]


# Bytes


@pytest.mark.parametrize("name", sorted(GOLDEN))
def test_the_bytes_that_each_kind_sends_are_pinned(name: str) -> None:
    adapter = flying(name)
    frames = adapter.encode(NORTH_EAST, 0.0, 5.0) + adapter.encode(NORTH_EAST, 0.0, 5.1)
    assert tuple(frame.hex() for frame in frames) == GOLDEN[name]


def test_every_kind_has_its_bytes_pinned() -> None:
    assert set(GOLDEN) == set(ADAPTERS)


def test_the_bytes_of_holding_are_pinned() -> None:
    held = {name: [frame.hex() for frame in flying(name, mode=0).hold(5.0)] for name in ADAPTERS}
    assert {name: frames for name, frames in held.items() if frames} == HELD


def test_the_bytes_of_what_is_asked_first_are_pinned() -> None:
    assert [frame.hex() for frame in flying("px4-plane").requests(5.0)] == ASKED


MASKS = {"arducopter": 0x0DC7, "ardurover": 0x0DC7, "kinematic": 0x0DC7, "px4-copter": 0x09C7, "px4-plane": 0x0DC0}


@pytest.mark.parametrize("name", sorted(MASKS))
def test_a_setpoint_is_one_message_in_the_local_frame_for_the_autopilot_alone(name: str) -> None:
    (message,) = sent(flying(name), NORTH_EAST)
    assert message.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
    assert (message.type_mask, message.coordinate_frame) == (MASKS[name], common.MAV_FRAME_LOCAL_NED)
    assert (message.target_system, message.target_component) == (SYSTEM, 1)
    assert (message.get_srcSystem(), message.get_srcComponent()) == (SYSTEM, COMPANION_COMPONENT)
    assert message.time_boot_ms == 5_000


@pytest.mark.parametrize("name", ADAPTERS)
def test_the_time_of_a_setpoint_wraps_within_its_field(name: str) -> None:
    adapter = flying(name)
    assert sent(adapter, NORTH_EAST, now_s=1_790_000_000.5)[0].time_boot_ms == 1_790_000_000_500 % 2**32


UNUSABLE = [math.nan, math.inf, -math.inf]


@pytest.mark.parametrize("name", ADAPTERS)
@pytest.mark.parametrize("value", UNUSABLE, ids=str)
def test_what_is_not_finite_is_never_sent(name: str, value: float) -> None:
    for setpoint in (Setpoint(value, 10.0, 20.0), Setpoint(0.0, value, 20.0), Setpoint(0.0, 10.0, value)):
        assert flying(name).encode(setpoint, 0.0, 5.0) == []
    assert flying(name).encode(NORTH_EAST, value, 5.0) == []


@pytest.mark.parametrize("name", ADAPTERS)
def test_before_anything_is_heard_nothing_that_is_not_finite_is_sent(name: str) -> None:
    for frame in ADAPTERS[name]().encode(NORTH_EAST, 0.0, 5.0) + ADAPTERS[name]().hold(5.0):
        assert all(math.isfinite(value) for value in numbers(decoded(frame)))


def numbers(message: Message) -> list[float]:
    values: list[float] = []
    for name in message.get_fieldnames():
        value = getattr(message, name)
        values += value if isinstance(value, list) else [value]
    return values


@settings(max_examples=60)
@given(
    st.sampled_from(sorted(ADAPTERS)),
    st.lists(
        st.tuples(st.floats(-20.0, 20.0), st.floats(0.0, 60.0), st.floats(-1e3, 1e4), st.floats(0.0, 3.0)), max_size=12
    ),
    st.integers(0, 6_000),
)
def test_whatever_is_asked_what_is_sent_is_finite_and_whole(
    name: str, asked: list[tuple[float, float, float, float]], speed_cm_s: int
) -> None:
    adapter, now_s = flying(name, speed_cm_s), 5.0
    for heading_rad, speed_m_s, height_m, wait_s in asked:
        now_s += wait_s
        for message in sent(adapter, Setpoint(heading_rad, speed_m_s, height_m), 0.01, now_s):
            assert message.get_type() != "BAD_DATA"
            assert all(math.isfinite(value) for value in numbers(message))


# Velocities


@pytest.mark.parametrize("name", ["arducopter", "px4-copter", "kinematic"])
@given(st.floats(0.0, math.tau), st.floats(-0.1, 0.1), st.floats(0.0, 60.0))
def test_the_velocity_is_turned_from_grid_to_local_north(
    name: str, heading_rad: float, convergence_rad: float, speed_m_s: float
) -> None:
    north_rad = heading_rad + convergence_rad
    adapter = flying(name, 1_000, north_rad)
    (message,) = sent(adapter, Setpoint(heading_rad, speed_m_s, HEIGHT_M), convergence_rad)
    # The course that was told is good to a centimetre per second of its velocity, and leads by more than itself.
    assert message.vx == pytest.approx(speed_m_s * math.cos(north_rad), abs=0.005 * speed_m_s + 1e-4)
    assert message.vy == pytest.approx(speed_m_s * math.sin(north_rad), abs=0.005 * speed_m_s + 1e-4)


@pytest.mark.parametrize("name", ["arducopter", "px4-copter", "kinematic"])
@pytest.mark.parametrize(
    ("height_m", "wanted_m", "climb_m_s"),
    [
        (20, 20.0, 0.0),
        (20, 21.0, 0.5),
        (20, 19.0, -0.5),
        (0, 500.0, VERTICAL_SPEED_M_S),
        (500, 0.0, -VERTICAL_SPEED_M_S),
    ],
)
def test_the_climb_follows_the_height_error_and_is_limited(
    name: str, height_m: int, wanted_m: float, climb_m_s: float
) -> None:
    adapter = flying(name, height_mm=height_m * 1_000)
    assert sent(adapter, Setpoint(0.0, 5.0, wanted_m))[0].vz == pytest.approx(-climb_m_s)


def test_a_rover_never_climbs() -> None:
    assert sent(flying("ardurover"), Setpoint(0.0, 2.0, 50.0))[0].vz == 0.0


def test_a_px4_copter_looks_along_its_track() -> None:
    (message,) = sent(flying("px4-copter", course_rad=2.0), Setpoint(2.0, 5.0, HEIGHT_M))
    assert message.yaw == pytest.approx(2.0, abs=0.01)
    assert math.atan2(message.vy, message.vx) == pytest.approx(message.yaw)


# A turn


@pytest.mark.parametrize(("name", "lead_s"), [("arducopter", 0.45), ("px4-copter", 0.5), ("px4-plane", 0.9)])
def test_on_a_turn_the_course_asked_for_leads_by_the_lag_of_the_kind(name: str, lead_s: float) -> None:
    adapter = flying(name)
    rate_rad_s = 0.1
    for step in range(40):
        now_s = 5.0 + 0.1 * step
        decided_rad = 0.5 * rate_rad_s * (step // 5 + 1)
        (message,) = sent(adapter, Setpoint(decided_rad, 10.0, HEIGHT_M), 0.0, now_s)
        asked_rad = math.atan2(message.vy, message.vx)
        assert asked_rad == pytest.approx(rate_rad_s * (0.1 * step + lead_s), abs=1e-3)


@pytest.mark.parametrize("name", ["arducopter", "px4-copter", "px4-plane"])
def test_a_leap_of_the_heading_is_flown_as_a_turn_that_the_vehicle_can_make(name: str) -> None:
    adapter = flying(name)
    asked = [sent(adapter, Setpoint(2.0, 8.0, HEIGHT_M), 0.0, 5.0 + 0.1 * step)[0] for step in range(200)]
    courses_rad = [math.atan2(message.vy, message.vx) for message in asked]
    speed_m_s = 15.0 * true_per_indicated(520.0) if name == "px4-plane" else 8.0
    step_rad = 0.1 * adapter.abilities.n_max * 9.80665 / speed_m_s
    turns_rad = [after - before for before, after in zip(courses_rad[1:-1], courses_rad[2:], strict=True)]
    assert 0.99 * step_rad < max(turns_rad) < 1.01 * step_rad
    assert courses_rad[-1] == pytest.approx(2.0, abs=1e-6)


@pytest.mark.parametrize("name", ["arducopter", "arduplane", "px4-copter", "px4-plane"])
def test_a_steering_that_ended_leaves_nothing_to_the_next(name: str) -> None:
    used = flying(name)
    for step in range(5):
        used.encode(Setpoint(1.0, 10.0, 50.0), 0.0, 5.0 + 0.1 * step)
    used.release()
    assert bodies(used) == bodies(flying(name))


def bodies(adapter: LinkedAdapter) -> list[bytes]:
    """Return what is sent, without its numbers in turn and checksums."""
    return [frame[7:-2] for frame in adapter.encode(NORTH_EAST, 0.0, 5.5)]


# PX4 planes


def test_a_px4_plane_is_asked_for_its_own_place_and_the_height_wanted() -> None:
    (message,) = sent(flying("px4-plane"), Setpoint(0.0, 30.0, 21.0))
    assert (message.x, message.y, message.z) == (100.0, -50.0, -19.0)
    assert math.hypot(message.vx, message.vy) == pytest.approx(15.0)
    assert message.vz == 0.0


@pytest.mark.parametrize(("wanted_m", "down_m"), [(200.0, -26.0), (0.0, -10.0)])
def test_a_px4_plane_is_never_asked_for_a_height_so_far_off_that_it_loiters(wanted_m: float, down_m: float) -> None:
    (message,) = sent(flying("px4-plane"), Setpoint(0.0, 15.0, wanted_m))
    assert message.z == down_m


def test_a_px4_plane_that_has_not_told_its_place_is_not_steered() -> None:
    adapter = ADAPTERS["px4-plane"](SYSTEM)
    told(adapter, beat(IDENTITY_OF["px4-plane"]), where())
    assert adapter.encode(NORTH_EAST, 0.0, 5.0) == []


def test_a_px4_plane_that_does_not_know_its_local_place_says_what_it_lacks() -> None:
    adapter = ADAPTERS["px4-plane"](SYSTEM)
    told(adapter, beat(IDENTITY_OF["px4-plane"]), where())
    assert adapter.missing_telemetry == "no local position"
    assert {name: flying(name).missing_telemetry for name in ADAPTERS} == dict.fromkeys(ADAPTERS)


def test_holding_is_standing_still_for_a_px4_copter_and_straight_on_for_a_plane() -> None:
    copter = decoded(*flying("px4-copter").hold(5.0))
    assert (copter.vx, copter.vy, copter.vz, copter.type_mask) == (0.0, 0.0, 0.0, 0x09C7)
    assert copter.yaw == pytest.approx(math.pi / 2)
    plane = decoded(*flying("px4-plane", course_rad=1.0, mode=0).hold(5.0))
    assert math.atan2(plane.vy, plane.vx) == pytest.approx(1.0, abs=1e-2)
    assert (plane.z, plane.type_mask) == (-18.0, 0x0DC0)


def test_holding_is_a_circle_for_a_plane_that_obeys() -> None:
    plane = decoded(*flying("px4-plane", course_rad=1.0).hold(5.0))
    rate_rad_s = 0.8 * 0.4 * 9.80665 / 15.0
    assert math.atan2(plane.vy, plane.vx) == pytest.approx(1.0 + 1.17 * rate_rad_s, abs=1e-2)
    assert (plane.z, plane.type_mask) == (-18.0, 0x0DC0)


# ArduPlane


def roll_rad(message: Message) -> float:
    assert message.get_type() == "SET_ATTITUDE_TARGET"
    return 2.0 * math.atan2(message.q[1], message.q[0])


def test_a_plane_is_asked_for_a_bank_and_nothing_else() -> None:
    message = sent(flying("arduplane", 2_200), Setpoint(0.0, 22.0, HEIGHT_M))[0]
    assert (message.type_mask, message.target_system, message.target_component) == (0xC6, SYSTEM, 1)
    assert (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate, message.thrust) == (0, 0, 0, 0)
    assert roll_rad(message) == 0.0


def test_the_bank_is_of_the_turn_and_of_the_course_error() -> None:
    adapter = flying("arduplane", 2_200)
    first = roll_rad(sent(adapter, Setpoint(0.05, 22.0, HEIGHT_M))[0])
    assert first == pytest.approx(math.atan(22.0 * 0.1 / 9.80665), abs=1e-6)
    # A tenth of a second later, and the plane has not turned yet.
    told(adapter, where(1_100, 2_200), now_s=5.1)
    later = roll_rad(sent(adapter, Setpoint(0.05, 22.0, HEIGHT_M), 0.0, 5.1)[0])
    assert later == pytest.approx(first + 3.0 * 0.01, abs=1e-6)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_bank_stays_within_what_the_autopilot_allows(side: float) -> None:
    adapter = flying("arduplane", 2_200)
    told(adapter, common.MAVLink_param_value_message(b"ROLL_LIMIT_DEG", 35.0, 9, 1, 0))
    banks = []
    for step in range(20):
        banks.append(roll_rad(sent(adapter, Setpoint(side * 1.5, 22.0, HEIGHT_M), 0.0, 5.0 + 0.1 * step)[0]))
    assert max(abs(bank) for bank in banks) == pytest.approx(math.radians(35.0))


def orders(adapter: LinkedAdapter, setpoint: Setpoint, now_s: float) -> list[Message]:
    return [message for message in sent(adapter, setpoint, 0.0, now_s) if message.get_type() == "COMMAND_INT"]


def acknowledge(adapter: LinkedAdapter, command: int, result: int = common.MAV_RESULT_ACCEPTED) -> None:
    told(adapter, common.MAVLink_command_ack_message(command, result, 0, 0, SYSTEM, COMPANION_COMPONENT))


def flown(adapter: LinkedAdapter, setpoint: Setpoint, start_s: float, seconds: float) -> list[tuple[float, Message]]:
    """Return the commands of a stretch of flight with their times; each is accepted at once."""
    given = []
    for step in range(round(10 * seconds)):
        now_s = start_s + 0.1 * step
        for message in orders(adapter, setpoint, now_s):
            given.append((now_s, message))
            acknowledge(adapter, message.command)
    return given


def test_height_and_airspeed_are_ordered_when_they_change() -> None:
    adapter = flying("arduplane")
    flown(adapter, Setpoint(0.0, 22.0, 100.0), 5.0, 1.0)
    changed = flown(adapter, Setpoint(0.0, 20.0, 120.0), 6.0, 1.0)
    assert [(message.command, message.frame) for _, message in changed] == [
        (common.MAV_CMD_GUIDED_CHANGE_ALTITUDE, common.MAV_FRAME_GLOBAL),
        (common.MAV_CMD_GUIDED_CHANGE_SPEED, common.MAV_FRAME_GLOBAL_RELATIVE_ALT),
    ]
    # Home is at 500 m.
    assert (changed[0][1].z, changed[0][1].param3) == (620.0, 0.0)
    assert changed[1][1].param1 == 0.0
    assert changed[1][1].param2 == pytest.approx(20.0 / true_per_indicated(520.0))


def test_a_loiter_lies_underneath_where_the_plane_was_a_moment_ago() -> None:
    adapter = flying("arduplane")
    told(adapter, common.MAVLink_param_value_message(b"WP_LOITER_RAD", 70.0, 9, 1, 0))
    loiters = [
        (now_s, message)
        for now_s, message in flown(adapter, Setpoint(0.0, 22.0, 100.0), 5.0, 12.5)
        if message.command == common.MAV_CMD_DO_REPOSITION
    ]
    times_s = [now_s for now_s, _ in loiters]
    assert [after - before for before, after in zip(times_s, times_s[1:], strict=False)] == pytest.approx(
        [LOITER_PERIOD_S] * 3, abs=0.11
    )
    place = loiters[0][1]
    assert (place.x, place.y, place.z, place.param3) == (470_000_000, 80_000_000, 600.0, 70.0)
    assert place.frame == common.MAV_FRAME_GLOBAL
    # It must never choose the mode: that is a person's.
    assert place.param2 == 0.0


def test_height_and_speed_are_ordered_again_from_time_to_time() -> None:
    heights_s = [
        now_s
        for now_s, message in flown(flying("arduplane"), Setpoint(0.0, 22.0, 100.0), 5.0, 21.0)
        if message.command == common.MAV_CMD_GUIDED_CHANGE_ALTITUDE
    ]
    assert heights_s == pytest.approx([5.0, 5.0 + RESEND_PERIOD_S, 5.0 + 2.0 * RESEND_PERIOD_S], abs=0.11)


def test_no_heading_command_is_ever_sent_because_it_never_expires() -> None:
    given = flown(flying("arduplane"), Setpoint(1.0, 22.0, 100.0), 5.0, 30.0)
    assert given
    assert common.MAV_CMD_GUIDED_CHANGE_HEADING not in {message.command for _, message in given}


def test_orders_of_a_steering_that_ended_never_leave_with_the_requests() -> None:
    adapter = flying("arduplane")
    assert orders(adapter, Setpoint(0.0, 22.0, 100.0), 5.0)
    adapter.release()
    for step in range(50):
        for frame in adapter.requests(6.0 + 0.1 * step):
            assert decoded(frame).get_type() != "COMMAND_INT"


def test_a_command_that_is_denied_is_told() -> None:
    adapter = flying("arduplane")
    orders(adapter, Setpoint(0.0, 22.0, 100.0), 5.0)
    acknowledge(adapter, common.MAV_CMD_GUIDED_CHANGE_SPEED, common.MAV_RESULT_FAILED)
    assert adapter.failures == ("indicated airspeed 21.5 m/s: failed",)


# What is heard decides whether it is steered


@pytest.mark.parametrize("name", ADAPTERS)
@pytest.mark.parametrize(
    ("base_mode", "guided", "steerable"),
    [
        (GUIDED, True, True),
        (GUIDED, False, False),
        (common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, True, False),
        (common.MAV_MODE_FLAG_SAFETY_ARMED, True, False),
        (0, True, False),
    ],
)
def test_only_a_vehicle_armed_and_guided_is_steered(name: str, base_mode: int, guided: bool, steerable: bool) -> None:
    adapter, kind = ADAPTERS[name](SYSTEM), IDENTITY_OF[name]
    assert not adapter.steerable
    told(adapter, beat(kind, base_mode, kind.guided_mode if guided else 5))
    assert adapter.steerable is steerable


@pytest.mark.parametrize("name", ADAPTERS)
@pytest.mark.parametrize("heard", IDENTITIES, ids=lambda identity: identity.kind.name)
def test_another_kind_than_configured_is_refused_with_its_name(name: str, heard: HeartbeatIdentity) -> None:
    adapter = ADAPTERS[name](SYSTEM)
    assert adapter.refusal is None
    told(adapter, beat(heard))
    assert (adapter.refusal is None) == (heard.kind.name == name)
    if adapter.refusal is not None:
        assert adapter.refusal.endswith(f"configured autopilot.kind {name}: set autopilot.kind to {heard.kind.name}")


def test_a_vehicle_that_no_adapter_steers_is_refused() -> None:
    adapter = ADAPTERS["arducopter"](SYSTEM)
    told(adapter, common.MAVLink_heartbeat_message(common.MAV_TYPE_SUBMARINE, 3, GUIDED, 4, 4, 3))
    assert adapter.refusal is not None
    assert adapter.refusal.endswith("this vehicle cannot be steered")


def test_another_system_id_than_configured_is_refused_with_both() -> None:
    adapter = ADAPTERS["arducopter"](system_id=9)
    told(adapter, beat(IDENTITY_OF["arducopter"]))
    assert adapter.refusal is not None
    assert "heard system 7, configured autopilot.system_id 9" in adapter.refusal


def test_two_autopilots_with_one_system_id_are_refused() -> None:
    adapter = flying("arducopter")
    for step in range(5):
        for began_ms in (2_000, 500_000):
            told(adapter, where(began_ms + 1_000 * step), now_s=6.0 + step)
    assert adapter.refusal is not None
    assert "two autopilots say they are system 7" in adapter.refusal


@pytest.mark.parametrize("name", ADAPTERS)
def test_the_heartbeat_is_an_onboard_controllers_and_never_a_ground_stations(name: str) -> None:
    message = decoded(flying(name).heartbeat())
    assert message.get_type() == "HEARTBEAT"
    assert (message.type, message.base_mode) == (common.MAV_TYPE_ONBOARD_CONTROLLER, 0)
    assert message.autopilot == common.MAV_AUTOPILOT_INVALID
    assert (message.get_srcSystem(), message.get_srcComponent()) == (SYSTEM, COMPANION_COMPONENT)


def test_frames_to_the_autopilot_are_numbered_in_turn() -> None:
    adapter = flying("arducopter")
    assert [adapter.heartbeat()[4] for _ in range(257)] == [*range(256), 0]


# What is asked of the autopilot


def asked(adapter: LinkedAdapter, start_s: float, seconds: float) -> list[tuple[float, Message]]:
    return [
        (start_s + 0.1 * step, decoded(frame))
        for step in range(round(10 * seconds))
        for frame in adapter.requests(start_s + 0.1 * step)
    ]


@pytest.mark.parametrize("name", ADAPTERS)
def test_nothing_is_asked_before_a_heartbeat_or_of_a_wrong_kind(name: str) -> None:
    adapter = ADAPTERS[name](SYSTEM)
    assert asked(adapter, 0.0, 3.0) == []
    told(adapter, beat(IDENTITY_OF["arducopter" if name != "arducopter" else "arduplane"]))
    assert asked(adapter, 3.0, 3.0) == []


@pytest.mark.parametrize("name", sorted(set(ADAPTERS) - {"kinematic"}))
def test_an_autopilot_that_answers_nothing_is_asked_a_bounded_number_of_times_and_then_left_alone(name: str) -> None:
    adapter = flying(name)
    assert not adapter.parameters_known
    requests = asked(adapter, 5.0, 60.0)
    assert adapter.parameters_known
    assert requests[-1][0] < 45.0
    assert max(sum(1 for at_s, _ in requests if start_s <= at_s < start_s + 1.0) for start_s in range(5, 35)) <= 30
    assert adapter.abilities.assumed
    assert any("no answer" in trouble for trouble in adapter.failures)


@pytest.mark.parametrize("name", ["arducopter", "px4-plane"])
def test_position_and_attitude_are_asked_for_ten_times_a_second(name: str) -> None:
    adapter = flying(name)
    rates: dict[int, float] = {}
    for step in range(100):
        for frame in adapter.requests(5.0 + 0.1 * step):
            message = decoded(frame)
            if message.get_type() == "COMMAND_LONG":
                assert message.command == common.MAV_CMD_SET_MESSAGE_INTERVAL
                rates[int(message.param1)] = 1e6 / message.param2
                acknowledge(adapter, message.command)
    assert rates[common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT] == rates[common.MAVLINK_MSG_ID_ATTITUDE] == 10.0
    assert (common.MAVLINK_MSG_ID_LOCAL_POSITION_NED in rates) == (name == "px4-plane")
    assert adapter.failures == ()


def rates_asked(adapter: LinkedAdapter, start_s: float, seconds: float) -> list[tuple[float, int]]:
    """Return when which message's rate is asked of an autopilot that acknowledges."""
    rates = []
    for step in range(round(10 * seconds)):
        for frame in adapter.requests(start_s + 0.1 * step):
            message = decoded(frame)
            if message.get_type() == "COMMAND_LONG":
                rates.append((start_s + 0.1 * step, int(message.param1)))
                acknowledge(adapter, message.command)
    return rates


@pytest.mark.parametrize("name", sorted(set(ADAPTERS) - {"kinematic", "ardurover"}))
def test_the_aircraft_that_it_sees_are_asked_of_an_autopilot_that_sends_them_only_on_request(name: str) -> None:
    asked_for = [message_id for _, message_id in rates_asked(flying(name), 5.0, 20.0)]
    assert asked_for.count(common.MAVLINK_MSG_ID_ADSB_VEHICLE) == name.startswith("ardu")


def test_the_aircraft_that_it_sees_are_asked_for_again_when_they_came_and_come_no_more() -> None:
    adapter = flying("arducopter")
    rates_asked(adapter, 5.0, 20.0)
    assert adapter.sees_others is None
    place = (7, 470000000, 80000000, common.ADSB_ALTITUDE_TYPE_GEOMETRIC, 500_000)
    told(adapter, common.MAVLink_adsb_vehicle_message(*place, 0, 0, 0, b"OW00007", 14, 0, 0x1F, 0), now_s=25.0)
    assert adapter.sees_others is True
    again = rates_asked(adapter, 25.0, 50.0)
    assert [message_id for _, message_id in again] == [common.MAVLINK_MSG_ID_ADSB_VEHICLE]
    assert again[0][0] == pytest.approx(55.0, abs=0.2)


def test_an_ardupilot_whose_parameter_names_no_receiver_sees_nobody() -> None:
    adapter = flying("arducopter")
    told(adapter, common.MAVLink_param_value_message(b"ADSB_TYPE", 0.0, common.MAV_PARAM_TYPE_REAL32, 1, 0), now_s=5.0)
    assert adapter.sees_others is False


def test_a_board_that_refuses_adsb_has_not_failed() -> None:
    adapter = flying("arduplane")
    for step in range(100):
        for frame in adapter.requests(5.0 + 0.1 * step):
            message = decoded(frame)
            if message.get_type() == "COMMAND_LONG":
                refused = message.param1 == common.MAVLINK_MSG_ID_ADSB_VEHICLE
                acknowledge(
                    adapter, message.command, common.MAV_RESULT_DENIED if refused else common.MAV_RESULT_ACCEPTED
                )
    assert adapter.failures == ()


def test_after_a_restart_of_the_autopilot_rates_and_parameters_are_asked_for_again() -> None:
    adapter = flying("arducopter")
    asked(adapter, 5.0, 40.0)
    told(adapter, where(41_000), now_s=45.0)
    assert asked(adapter, 45.0, 5.0) == []
    for boot_ms in (2_000, 2_100, 2_200):
        told(adapter, where(boot_ms), now_s=48.0 + boot_ms / 1e3)
    kinds = {message.get_type() for _, message in asked(adapter, 50.0, 5.0)}
    assert kinds == {"COMMAND_LONG", "PARAM_REQUEST_READ"}
    # What was known holds until it is told again.
    assert adapter.parameters_known


def test_the_stand_ins_point_is_asked_for_nothing() -> None:
    adapter = flying("kinematic")
    assert adapter.parameters_known
    assert asked(adapter, 5.0, 5.0) == []


# Abilities follow from parameters


def with_parameters(name: str, **values: float) -> LinkedAdapter:
    adapter = flying(name)
    for key, value in values.items():
        told(adapter, common.MAVLink_param_value_message(key.encode(), value, common.MAV_PARAM_TYPE_REAL32, 1, 0))
    return adapter


@pytest.mark.parametrize(
    ("name", "key", "less", "more", "ability"),
    [
        ("arducopter", "WPNAV_ACCEL", 100.0, 500.0, "n_max"),
        ("arducopter", "WPNAV_ACCEL", 100.0, 500.0, "braking_m_s2"),
        ("arducopter", "WP_ACC", 1.0, 5.0, "n_max"),
        ("arducopter", "ANGLE_MAX", 2000.0, 4500.0, "speed_max_m_s"),
        ("arducopter", "ATC_ANGLE_MAX", 20.0, 45.0, "speed_max_m_s"),
        ("arduplane", "ROLL_LIMIT_DEG", 30.0, 45.0, "n_max"),
        ("arduplane", "LIM_ROLL_CD", 3000.0, 4500.0, "n_max"),
        ("arduplane", "AIRSPEED_MAX", 20.0, 30.0, "speed_max_m_s"),
        ("arduplane", "ARSPD_FBW_MIN", 10.0, 15.0, "speed_min_m_s"),
        ("px4-copter", "MPC_ACC_HOR", 2.0, 5.0, "n_max"),
        ("px4-copter", "MPC_XY_VEL_MAX", 5.0, 12.0, "speed_max_m_s"),
        ("px4-plane", "FW_AIRSPD_TRIM", 12.0, 18.0, "speed_min_m_s"),
        ("px4-plane", "FW_R_LIM", 20.0, 50.0, "n_max"),
        ("ardurover", "ATC_TURN_MAX_G", 0.2, 0.6, "n_max"),
    ],
)
def test_what_the_vehicle_can_do_follows_from_its_parameters(
    name: str, key: str, less: float, more: float, ability: str
) -> None:
    abilities = [getattr(with_parameters(name, **{key: value}).abilities, ability) for value in (less, more)]
    assert abilities[0] < abilities[1]


def test_a_plane_never_banks_over_45_degrees_whatever_its_limit() -> None:
    assert (
        with_parameters("arduplane", ROLL_LIMIT_DEG=65.0).abilities
        == with_parameters("arduplane", ROLL_LIMIT_DEG=45.0).abilities
    )


@pytest.mark.parametrize("name", ADAPTERS)
@given(st.lists(st.floats(width=32, allow_nan=True, allow_infinity=True), min_size=8, max_size=8))
@settings(max_examples=30)
def test_nonsense_in_the_parameters_leaves_abilities_that_can_be_reckoned_with(name: str, values: list[float]) -> None:
    adapter = flying(name)
    for wanted, value in zip(adapter.wanted, values, strict=False):
        told(adapter, common.MAVLink_param_value_message(wanted.name.encode(), value, 9, 1, 0))
    abilities = adapter.abilities
    assert 0.0 <= abilities.speed_min_m_s <= abilities.speed_max_m_s
    assert abilities.n_max > 0.0
    assert abilities.braking_m_s2 > 0.0
    for message in sent(adapter, NORTH_EAST):
        assert all(map(math.isfinite, numbers(message)))
