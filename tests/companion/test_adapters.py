"""The autopilot link: what it says is read carefully, and what is asked of it is exactly one known message."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

import pytest
from fastcrc.crc16 import mcrf4xx
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.adapters import ADAPTERS
from companion.adapters.base import (
    COMPANION_COMPONENT,
    MAX_NEIGHBOURS,
    NEIGHBOUR_MEMORY_S,
    Neighbour,
    TelemetryReader,
    _is_one_other_message,
)
from companion.adapters.velocity import GUIDED_MODE, VERTICAL_SPEED_M_S, VelocityAdapter
from companion.guard import Setpoint

SYSTEM = 7
ARMED_GUIDED = common.MAV_MODE_FLAG_SAFETY_ARMED | common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
GOLDEN_SETPOINT = (
    "fd3500000007bf540000881300000000000000000000000000000000a04000000000000000bf0000"
    "000000000000000000000000000000000000c70d070101bdb1"
)
WANTED = ("HEARTBEAT", "GLOBAL_POSITION_INT", "HOME_POSITION", "ADSB_VEHICLE")
SIGNATURE_BYTES = 13


def mav(system: int = SYSTEM, component: int = common.MAV_COMP_ID_AUTOPILOT1) -> common.MAVLink:
    return common.MAVLink(None, srcSystem=system, srcComponent=component)


def heartbeat(
    base_mode: int = ARMED_GUIDED,
    custom_mode: int = GUIDED_MODE,
    *,
    autopilot: int = common.MAV_AUTOPILOT_ARDUPILOTMEGA,
    system: int = SYSTEM,
    component: int = common.MAV_COMP_ID_AUTOPILOT1,
) -> bytes:
    message = common.MAVLink_heartbeat_message(
        common.MAV_TYPE_QUADROTOR, autopilot, base_mode, custom_mode, common.MAV_STATE_ACTIVE, 3
    )
    return bytes(message.pack(mav(system, component)))


def position(
    lat_e7: int = 471_234_567,
    lon_e7: int = -87_654_321,
    height_mm: int = 12_345,
    vx: int = -150,
    vy: int = 250,
    hdg: int = 9_000,
    *,
    system: int = SYSTEM,
    component: int = common.MAV_COMP_ID_AUTOPILOT1,
) -> bytes:
    message = common.MAVLink_global_position_int_message(1_000, lat_e7, lon_e7, 512_345, height_mm, vx, vy, 10, hdg)
    return bytes(message.pack(mav(system, component)))


def home(lat_e7: int = 470_000_000, lon_e7: int = 80_000_000, *, system: int = SYSTEM) -> bytes:
    message = common.MAVLink_home_position_message(
        lat_e7, lon_e7, 500_000, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0
    )
    return bytes(message.pack(mav(system)))


ALL_VALID = (
    common.ADSB_FLAGS_VALID_COORDS
    | common.ADSB_FLAGS_VALID_HEADING
    | common.ADSB_FLAGS_VALID_VELOCITY
    | common.ADSB_FLAGS_VALID_CALLSIGN
)


def neighbour(
    address: int = 0xABC,
    lat_e7: int = 471_000_000,
    lon_e7: int = 81_000_000,
    *,
    callsign: bytes = b"OW00012",
    flags: int = ALL_VALID,
    heading_cdeg: int = 9_000,
    speed_cm_s: int = 6_000,
    silent_s: int = 0,
    system: int = SYSTEM,
    component: int = common.MAV_COMP_ID_ADSB,
) -> bytes:
    kind, emitter = common.ADSB_ALTITUDE_TYPE_GEOMETRIC, common.ADSB_EMITTER_TYPE_UAV
    message = common.MAVLink_adsb_vehicle_message(
        address, lat_e7, lon_e7, kind, 530_000, heading_cdeg, speed_cm_s, 0, callsign, emitter, silent_s, flags, 1_200
    )
    return bytes(message.pack(mav(system, component)))


def reader_of(*datagrams: bytes) -> TelemetryReader:
    reader = TelemetryReader()
    for index, datagram in enumerate(datagrams):
        reader.receive(datagram, 100.0 + index)
    return reader


def seen_by(reader: TelemetryReader) -> Neighbour:
    (found,) = reader.neighbours.values()
    return found


def decoded(datagram: bytes) -> common.MAVLink_message:
    (message,) = common.MAVLink(None).parse_buffer(bytearray(datagram))
    return message


def sent(
    setpoint: Setpoint, convergence_rad: float = 0.0, height_mm: int = 20_000, now_s: float = 5.0
) -> common.MAVLink_set_position_target_local_ned_message:
    adapter = VelocityAdapter("arducopter", can_stop=True)
    adapter.receive(heartbeat(), 0.0)
    adapter.receive(position(height_mm=height_mm), 0.0)
    return decoded(*adapter.encode(setpoint, convergence_rad, now_s))


# Telemetry


def test_nothing_is_known_before_anything_is_heard() -> None:
    telemetry = TelemetryReader().telemetry
    assert telemetry.system_id is None
    assert not telemetry.armed
    assert telemetry.position_at_s is None


def test_the_position_is_read_in_degrees_metres_and_radians() -> None:
    telemetry = reader_of(heartbeat(), position()).telemetry
    assert (telemetry.lat_deg, telemetry.lon_deg, telemetry.height_m) == (47.1234567, -8.7654321, 12.345)
    assert (telemetry.velocity_north_m_s, telemetry.velocity_east_m_s) == (-1.5, 2.5)
    assert telemetry.yaw_rad == pytest.approx(math.pi / 2)
    assert telemetry.position_at_s == 101.0


def test_an_unknown_yaw_is_none() -> None:
    assert reader_of(heartbeat(), position(hdg=65_535)).telemetry.yaw_rad is None


def test_home_is_read() -> None:
    assert reader_of(heartbeat(), home()).telemetry.home_deg == (47.0, 8.0)


def test_the_heartbeat_tells_system_arming_and_mode() -> None:
    telemetry = reader_of(heartbeat(ARMED_GUIDED, 4)).telemetry
    assert (telemetry.system_id, telemetry.armed, telemetry.custom_mode) == (SYSTEM, True, 4)


def test_the_newest_heartbeat_counts() -> None:
    telemetry = reader_of(heartbeat(ARMED_GUIDED, 4), heartbeat(1, 6)).telemetry
    assert (telemetry.armed, telemetry.custom_mode) == (False, 6)


def test_a_mode_without_its_flag_is_no_mode() -> None:
    assert reader_of(heartbeat(common.MAV_MODE_FLAG_SAFETY_ARMED, 4)).telemetry.custom_mode is None


def test_two_messages_in_one_datagram_are_both_read() -> None:
    telemetry = reader_of(heartbeat() + position()).telemetry
    assert telemetry.armed
    assert telemetry.height_m == 12.345


@pytest.mark.parametrize(
    "other",
    [
        heartbeat(0, 0, autopilot=common.MAV_AUTOPILOT_INVALID, component=common.MAV_COMP_ID_GIMBAL),
        heartbeat(0, 0, autopilot=common.MAV_AUTOPILOT_INVALID, system=255, component=190),
        heartbeat(0, 0, autopilot=common.MAV_AUTOPILOT_GENERIC, component=common.MAV_COMP_ID_CAMERA),
    ],
    ids=["gimbal", "ground station", "camera that claims an autopilot"],
)
def test_the_heartbeat_of_another_component_is_ignored(other: bytes) -> None:
    assert reader_of(other).telemetry.system_id is None
    telemetry = reader_of(heartbeat(), other).telemetry
    assert (telemetry.system_id, telemetry.armed, telemetry.custom_mode) == (SYSTEM, True, GUIDED_MODE)


def test_another_system_is_ignored_and_counted() -> None:
    reader = reader_of(heartbeat(), position(), heartbeat(0, 0, system=8), position(lat_e7=0, system=8), home(system=8))
    assert (reader.telemetry.system_id, reader.telemetry.lat_deg, reader.telemetry.home_deg) == (7, 47.1234567, None)
    assert reader.rejected == {"other system": 3}


def test_the_position_of_another_component_is_ignored_and_counted() -> None:
    reader = reader_of(heartbeat(), position(), position(lat_e7=0, component=common.MAV_COMP_ID_GPS))
    assert reader.telemetry.lat_deg == 47.1234567
    assert reader.rejected == {"other component": 1}


def test_a_position_before_the_first_heartbeat_belongs_to_nobody() -> None:
    assert reader_of(position()).telemetry.position_at_s is None


@pytest.mark.parametrize(
    "datagram",
    [position(lat_e7=900_000_001), position(lon_e7=-1_800_000_001), home(950_000_000)],
    ids=["latitude", "longitude", "home"],
)
def test_a_place_that_is_not_on_earth_is_ignored_and_counted(datagram: bytes) -> None:
    reader = reader_of(heartbeat(), datagram)
    assert (reader.telemetry.position_at_s, reader.telemetry.home_deg) == (None, None)
    assert reader.rejected == {"out of range": 1}


@given(st.binary(max_size=300) | st.binary(max_size=300).map(lambda data: b"\xfd" + data))
def test_random_bytes_change_nothing(datagram: bytes) -> None:
    reader = reader_of(heartbeat(), position())
    before = reader.telemetry
    reader.receive(datagram, 200.0)
    assert (reader.telemetry, reader.neighbours) == (before, {})


@given(st.sampled_from([heartbeat(), position(), home(), neighbour()]), st.data())
def test_a_damaged_message_changes_nothing(datagram: bytes, data: st.DataObject) -> None:
    damaged = bytearray(datagram)
    damaged[data.draw(st.integers(0, len(datagram) - 1))] ^= data.draw(st.integers(1, 255))
    reader = reader_of(heartbeat(), position())
    before = reader.telemetry
    reader.receive(bytes(damaged), 200.0)
    assert (reader.telemetry, reader.neighbours) == (before, {})


@settings(max_examples=200)
@given(st.sampled_from([heartbeat(), position(), home(), neighbour()]), st.data())
def test_a_forged_message_with_a_good_checksum_leaves_finite_telemetry(datagram: bytes, data: st.DataObject) -> None:
    payload_bytes = datagram[1]
    payload = data.draw(st.binary(min_size=payload_bytes, max_size=payload_bytes))
    kind = common.mavlink_map[int.from_bytes(datagram[7:10], "little")]
    body = datagram[1:10] + payload
    crc = mcrf4xx(body + bytes([kind.crc_extra]))
    reader = reader_of(heartbeat(), position())
    reader.receive(b"\xfd" + body + struct.pack("<H", crc), 200.0)
    telemetry = reader.telemetry
    assert abs(telemetry.lat_deg) <= 90.0
    assert abs(telemetry.lon_deg) <= 180.0
    assert all(map(math.isfinite, (telemetry.height_m, telemetry.velocity_north_m_s, telemetry.velocity_east_m_s)))
    for other in reader.neighbours.values():
        assert abs(other.lat_deg) <= 90.0
        assert abs(other.lon_deg) <= 180.0
        assert math.hypot(other.velocity_north_m_s, other.velocity_east_m_s) <= 656.0
        assert other.agent_id is None or 1 <= other.agent_id <= 99_999


# The vehicle's own detector


def test_a_neighbour_is_read_in_degrees_and_metres_per_second() -> None:
    reader = reader_of(heartbeat(), neighbour())
    found = seen_by(reader)
    assert (found.agent_id, found.lat_deg, found.lon_deg, found.seen_at_s) == (12, 47.1, 8.1, 101.0)
    assert (found.velocity_north_m_s, found.velocity_east_m_s) == pytest.approx((0.0, 60.0))
    assert reader.rejected.total() == 0


@pytest.mark.parametrize(
    ("callsign", "agent_id"),
    [
        (b"OW00012", 12),
        (b"OW65535", 65_535),
        (b"OW00012 ", 12),
        (b"OW00000", None),
        (b"OW0012", None),
        (b"OW000012", None),
        (b"ow00012", None),
        (b"XOW00012", None),
        (b"OW-0012", None),
        (b"DLH123", None),
        (b"", None),
    ],
)
def test_a_neighbour_is_an_agent_by_its_callsign_and_else_a_stranger(callsign: bytes, agent_id: int | None) -> None:
    assert seen_by(reader_of(heartbeat(), neighbour(callsign=callsign))).agent_id == agent_id


def test_a_callsign_that_is_not_valid_names_nobody() -> None:
    flags = ALL_VALID & ~common.ADSB_FLAGS_VALID_CALLSIGN
    assert seen_by(reader_of(heartbeat(), neighbour(flags=flags))).agent_id is None


def test_a_neighbour_without_coordinates_is_ignored_and_counted() -> None:
    reader = reader_of(heartbeat(), neighbour(flags=ALL_VALID & ~common.ADSB_FLAGS_VALID_COORDS))
    assert (reader.neighbours, reader.rejected) == ({}, {"no coordinates": 1})


@pytest.mark.parametrize("datagram", [neighbour(lat_e7=900_000_001), neighbour(lon_e7=-1_800_000_001)])
def test_a_neighbour_that_is_not_on_earth_is_ignored_and_counted(datagram: bytes) -> None:
    reader = reader_of(heartbeat(), datagram)
    assert (reader.neighbours, reader.rejected) == ({}, {"out of range": 1})


@pytest.mark.parametrize("flag", [common.ADSB_FLAGS_VALID_HEADING, common.ADSB_FLAGS_VALID_VELOCITY])
def test_a_neighbour_whose_velocity_is_not_whole_stands_still(flag: int) -> None:
    found = seen_by(reader_of(heartbeat(), neighbour(flags=ALL_VALID & ~flag)))
    assert (found.velocity_north_m_s, found.velocity_east_m_s) == (0.0, 0.0)


@pytest.mark.parametrize(
    "component", [common.MAV_COMP_ID_AUTOPILOT1, common.MAV_COMP_ID_ADSB, COMPANION_COMPONENT], ids=str
)
def test_a_neighbour_is_heard_from_the_autopilot_or_the_detector_beside_it(component: int) -> None:
    assert seen_by(reader_of(heartbeat(), neighbour(component=component))).agent_id == 12


def test_a_neighbour_that_another_system_tells_of_is_ignored_and_counted() -> None:
    reader = reader_of(heartbeat(), neighbour(system=8))
    assert (reader.neighbours, reader.rejected) == ({}, {"other system": 1})


def test_a_neighbour_before_the_first_heartbeat_belongs_to_nobody() -> None:
    assert reader_of(neighbour()).neighbours == {}


def test_a_neighbour_seen_again_is_where_it_was_seen_last() -> None:
    found = seen_by(reader_of(heartbeat(), neighbour(), neighbour(lat_e7=472_000_000)))
    assert (found.lat_deg, found.seen_at_s) == (47.2, 102.0)


def test_a_neighbour_is_as_old_as_the_detector_says() -> None:
    assert seen_by(reader_of(heartbeat(), neighbour(silent_s=3))).seen_at_s == 98.0


def test_neighbours_at_two_addresses_are_two() -> None:
    reader = reader_of(heartbeat(), neighbour(1, callsign=b"OW00001"), neighbour(2, callsign=b"OW00002"))
    assert {found.agent_id for found in reader.neighbours.values()} == {1, 2}


def test_a_neighbour_not_seen_for_long_is_forgotten() -> None:
    reader = TelemetryReader()
    reader.receive(heartbeat(), 100.0)
    reader.receive(neighbour(1), 100.0)
    reader.receive(neighbour(2), 100.0 + NEIGHBOUR_MEMORY_S - 0.1)
    assert set(reader.neighbours) == {1, 2}
    reader.receive(neighbour(3), 100.0 + NEIGHBOUR_MEMORY_S + 0.1)
    assert set(reader.neighbours) == {2, 3}


def test_a_swarm_of_forged_neighbours_is_bounded_and_leaves_those_known_alone() -> None:
    reader = TelemetryReader()
    reader.receive(heartbeat(), 100.0)
    for address in range(MAX_NEIGHBOURS + 50):
        reader.receive(neighbour(address), 100.0)
    assert set(reader.neighbours) == set(range(MAX_NEIGHBOURS))
    assert reader.rejected == {"too many neighbours": 50}
    reader.receive(neighbour(7, lat_e7=472_000_000), 101.0)
    assert reader.neighbours[7].lat_deg == 47.2


@pytest.mark.parametrize("kind", ADAPTERS)
def test_every_kind_offers_the_neighbours(kind: str) -> None:
    adapter = ADAPTERS[kind]()
    adapter.receive(heartbeat(), 100.0)
    adapter.receive(neighbour(), 100.0)
    assert [found.agent_id for found in adapter.neighbours] == [12]


# The short cut past messages nobody reads


def other_messages() -> list[bytes]:
    link = mav()
    return [
        bytes(message.pack(link))
        for message in (
            common.MAVLink_attitude_message(1, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0),
            common.MAVLink_sys_status_message(0, 0, 0, 500, 11_000, -1, 90, 0, 0, 0, 0, 0, 0),
            common.MAVLink_vfr_hud_message(0.0, 0.0, 0, 0, 0.0, 0.0),
            common.MAVLink_statustext_message(6, b"EKF3 IMU0 is using GPS"),
            common.MAVLink_param_value_message(b"GUID_TIMEOUT", 3.0, 9, 1, 0),
        )
    ]


SHORT = bytes(common.MAVLink_global_position_int_message(0, 0, 0, 0, 0, 0, 0, 0, 0).pack(mav()))
"""A wanted message of the least length there is: its payload is one byte."""
GENUINE = [*other_messages(), heartbeat(), position(), home(), neighbour(), SHORT]


def signed(datagram: bytes) -> bytes:
    signing = mav()
    signing.signing.secret_key = bytes(range(32))
    signing.signing.sign_outgoing = True
    return bytes(decoded(datagram).pack(signing))


def test_the_short_cut_is_taken_for_a_single_message_that_nobody_reads() -> None:
    for datagram in other_messages():
        assert _is_one_other_message(datagram)
        assert _is_one_other_message(signed(datagram))


@settings(max_examples=300)
@given(st.lists(st.tuples(st.sampled_from(GENUINE), st.booleans()), min_size=1, max_size=4), st.binary(max_size=14))
def test_the_short_cut_never_hides_a_wanted_message(chosen: list[tuple[bytes, bool]], tail: bytes) -> None:
    datagram = b"".join(signed(one) if sign else one for one, sign in chosen) + tail
    wanted = any(decoded(one).get_type() in WANTED for one, _ in chosen)
    if wanted:
        assert not _is_one_other_message(datagram)


def test_a_wanted_message_of_the_least_length_behind_another_is_not_hidden() -> None:
    assert len(SHORT) == SIGNATURE_BYTES
    reader = reader_of(heartbeat(), other_messages()[0] + SHORT)
    # Seen, and refused for its place: so short a position is one at latitude and longitude 0.
    assert reader.rejected["out of range"] == 1


# Steering


@pytest.mark.parametrize(
    ("base_mode", "custom_mode", "steerable"),
    [
        (ARMED_GUIDED, GUIDED_MODE, True),
        (ARMED_GUIDED, 5, False),
        (ARMED_GUIDED, 0, False),
        (common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, GUIDED_MODE, False),
        (common.MAV_MODE_FLAG_SAFETY_ARMED, GUIDED_MODE, False),
        (0, GUIDED_MODE, False),
    ],
)
def test_only_a_vehicle_armed_and_guided_is_steered(base_mode: int, custom_mode: int, steerable: bool) -> None:
    adapter = VelocityAdapter("arducopter", can_stop=True)
    assert not adapter.steerable
    adapter.receive(heartbeat(base_mode, custom_mode), 0.0)
    assert adapter.steerable is steerable


def test_the_bytes_of_a_setpoint_are_pinned() -> None:
    adapter = VelocityAdapter("arducopter", can_stop=True)
    adapter.receive(heartbeat(), 0.0)
    adapter.receive(position(height_mm=20_000), 0.0)
    (datagram,) = adapter.encode(Setpoint(0.0, 5.0, 21.0), 0.0, 5.0)
    assert datagram.hex() == GOLDEN_SETPOINT


def test_a_setpoint_asks_for_a_velocity_in_the_local_frame_and_nothing_else() -> None:
    message = sent(Setpoint(math.radians(30.0), 10.0, 20.0))
    assert message.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
    assert message.type_mask == 0x0DC7
    assert message.coordinate_frame == common.MAV_FRAME_LOCAL_NED == 1
    assert (message.target_system, message.target_component) == (SYSTEM, 1)
    assert (message.vx, message.vy) == pytest.approx((10.0 * math.cos(math.pi / 6), 5.0))
    assert message.time_boot_ms == 5_000


@given(st.floats(0.0, math.tau), st.floats(-0.1, 0.1), st.floats(0.0, 100.0))
def test_the_velocity_is_turned_from_grid_to_local_north(
    heading_rad: float, convergence_rad: float, speed_m_s: float
) -> None:
    message = sent(Setpoint(heading_rad, speed_m_s, 20.0), convergence_rad)
    assert message.vx == pytest.approx(speed_m_s * math.cos(heading_rad + convergence_rad), abs=1e-4)
    assert message.vy == pytest.approx(speed_m_s * math.sin(heading_rad + convergence_rad), abs=1e-4)


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
def test_the_climb_follows_the_height_error_and_is_limited(height_m: int, wanted_m: float, climb_m_s: float) -> None:
    assert sent(Setpoint(0.0, 5.0, wanted_m), height_mm=height_m * 1_000).vz == pytest.approx(-climb_m_s)


def test_the_time_of_a_setpoint_wraps_within_its_field() -> None:
    assert sent(Setpoint(0.0, 5.0, 20.0), now_s=1_790_000_000.5).time_boot_ms == 1_790_000_000_500 % 2**32


def test_the_heartbeat_is_an_onboard_controllers_and_never_a_ground_stations() -> None:
    adapter = VelocityAdapter("arducopter", can_stop=True)
    adapter.receive(heartbeat(), 0.0)
    message = decoded(adapter.heartbeat())
    assert message.get_type() == "HEARTBEAT"
    assert message.type == common.MAV_TYPE_ONBOARD_CONTROLLER
    assert message.autopilot == common.MAV_AUTOPILOT_INVALID
    assert message.base_mode == 0
    assert (message.get_srcSystem(), message.get_srcComponent()) == (SYSTEM, COMPANION_COMPONENT)


def test_frames_to_the_autopilot_are_numbered_in_turn() -> None:
    adapter = VelocityAdapter("arducopter", can_stop=True)
    adapter.receive(heartbeat(), 0.0)
    assert [adapter.heartbeat()[4] for _ in range(257)] == [*range(256), 0]


@pytest.mark.parametrize("kind", ADAPTERS)
def test_every_kind_reads_the_same_telemetry(kind: str) -> None:
    build: Callable[[], object] = ADAPTERS[kind]
    adapter = build()
    assert isinstance(adapter, VelocityAdapter)
    adapter.receive(heartbeat(), 0.0)
    assert adapter.telemetry.system_id == SYSTEM


def test_a_copter_can_stop_and_the_kinematic_stand_in_cannot() -> None:
    assert (ADAPTERS["arducopter"]().can_stop, ADAPTERS["kinematic"]().can_stop) == (True, False)


def test_a_position_of_zero_and_zero_is_an_autopilot_without_a_fix() -> None:
    reader = TelemetryReader()
    autopilot = common.MAVLink(None, srcSystem=1, srcComponent=1)
    reader.receive(bytes(autopilot.heartbeat_encode(2, 3, 129, 4, 4).pack(autopilot)), 1.0)
    nowhere = autopilot.global_position_int_encode(0, 0, 0, 0, 0, 0, 0, 0, 0)
    reader.receive(bytes(nowhere.pack(autopilot)), 1.0)
    assert reader.telemetry.position_at_s is None
