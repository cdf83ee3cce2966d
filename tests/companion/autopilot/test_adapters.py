"""The autopilot link: whatever comes over it, only what makes sense is believed."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

import pytest
from fastcrc.crc16 import mcrf4xx
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega, common

from companion.autopilot.aircraft import MAX_NEIGHBOURS, NEIGHBOUR_MEMORY_S, Neighbour
from companion.autopilot.linked import LinkedAdapter
from companion.autopilot.registry import ADAPTERS
from companion.autopilot.telemetry import (
    COMPANION_COMPONENT,
    METRES_PER_HDOP,
    Telemetry,
)

SYSTEM = 7
ARMED_GUIDED = common.MAV_MODE_FLAG_SAFETY_ARMED | common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
GUIDED_MODE = 4
"""ArduCopter's."""


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
    boot_ms: int = 1_000,
    system: int = SYSTEM,
    component: int = common.MAV_COMP_ID_AUTOPILOT1,
) -> bytes:
    message = common.MAVLink_global_position_int_message(boot_ms, lat_e7, lon_e7, 512_345, height_mm, vx, vy, 10, hdg)
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


class Reader:
    """What an adapter reads from its link."""

    def __init__(self) -> None:
        self._adapter = ADAPTERS["arducopter"](SYSTEM)
        self.receive = self._adapter.receive
        self.rejected = self._adapter.rejected

    @property
    def telemetry(self) -> Telemetry:
        return self._adapter.telemetry

    @property
    def neighbours(self) -> Mapping[int, Neighbour]:
        return self._adapter._reader.neighbours


def reader_of(*datagrams: bytes) -> Reader:
    reader = Reader()
    for index, datagram in enumerate(datagrams):
        reader.receive(datagram, 100.0 + index)
    return reader


def seen_by(reader: Reader) -> Neighbour:
    (found,) = reader.neighbours.values()
    return found


def decoded(datagram: bytes) -> common.MAVLink_message:
    (message,) = common.MAVLink(None).parse_buffer(bytearray(datagram))
    return message


# Telemetry


def test_nothing_is_known_before_anything_is_heard() -> None:
    telemetry = Reader().telemetry
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
    [position(lat_e7=900_000_001), position(lon_e7=-1_800_000_001), home(950_000_000), home(0, 0)],
    ids=["latitude", "longitude", "home", "no home"],
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
    reader = Reader()
    reader.receive(heartbeat(), 100.0)
    reader.receive(neighbour(1), 100.0)
    reader.receive(neighbour(2), 100.0 + NEIGHBOUR_MEMORY_S - 0.1)
    assert set(reader.neighbours) == {1, 2}
    reader.receive(neighbour(3), 100.0 + NEIGHBOUR_MEMORY_S + 0.1)
    assert set(reader.neighbours) == {2, 3}


def test_a_swarm_of_forged_neighbours_is_bounded_and_leaves_those_known_alone() -> None:
    reader = Reader()
    reader.receive(heartbeat(), 100.0)
    for address in range(MAX_NEIGHBOURS + 50):
        reader.receive(neighbour(address), 100.0)
    assert set(reader.neighbours) == set(range(MAX_NEIGHBOURS))
    assert reader.rejected == {"too many neighbours": 50}
    reader.receive(neighbour(7, lat_e7=472_000_000), 101.0)
    assert reader.neighbours[7].lat_deg == 47.2


@pytest.mark.parametrize("kind", ADAPTERS)
def test_every_kind_offers_the_neighbours(kind: str) -> None:
    adapter = ADAPTERS[kind](SYSTEM)
    assert isinstance(adapter, LinkedAdapter)
    mav_type = min(adapter.identity.types or [common.MAV_TYPE_QUADROTOR])
    adapter.receive(told(common.MAVLink_heartbeat_message(mav_type, adapter.identity.autopilot, 0, 0, 4, 3)), 100.0)
    adapter.receive(neighbour(), 100.0)
    assert [found.agent_id for found in adapter.neighbours] == [12]


# What the newer fields are read from


def told(message: common.MAVLink_message, component: int = common.MAV_COMP_ID_AUTOPILOT1) -> bytes:
    return bytes(message.pack(mav(component=component)))


def attitude(roll_rad: float = 0.25, boot_ms: int = 1_000) -> bytes:
    return told(common.MAVLink_attitude_message(boot_ms, roll_rad, 0.0, 1.0, 0.0, 0.0, 0.0))


def local_position(north_m: float = 1.0, down_m: float = -3.0, boot_ms: int = 1_000) -> bytes:
    return told(common.MAVLink_local_position_ned_message(boot_ms, north_m, 2.0, down_m, 0.0, 0.0, 0.0))


def hud(airspeed_m_s: float = 15.5) -> bytes:
    return told(common.MAVLink_vfr_hud_message(airspeed_m_s, 15.0, 0, 0, 0.0, 0.0))


def receiver(fix: int = 3, eph: int = 80, h_acc_mm: int = 0) -> bytes:
    return told(common.MAVLink_gps_raw_int_message(0, fix, 0, 0, 0, eph, 0, 0, 0, 12, h_acc=h_acc_mm))


def estimator(accuracy_m: float) -> bytes:
    return told(common.MAVLink_estimator_status_message(0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, accuracy_m, 1.0))


def battery(percent: int) -> bytes:
    return told(common.MAVLink_sys_status_message(0, 0, 0, 500, 11_000, -1, percent, 0, 0, 0, 0, 0, 0))


def test_the_heartbeat_tells_what_the_autopilot_is_and_how_it_fares() -> None:
    telemetry = reader_of(heartbeat()).telemetry
    assert (telemetry.autopilot, telemetry.mav_type, telemetry.system_status) == (3, 2, common.MAV_STATE_ACTIVE)


def test_the_wind_of_ardupilot_is_where_it_blows_to() -> None:
    message = ardupilotmega.MAVLink_wind_message(direction=270.0, speed=5.0, speed_z=0.0)
    wind_ned_m_s = reader_of(heartbeat(), told(message)).telemetry.wind_ned_m_s
    assert wind_ned_m_s == pytest.approx((0.0, 5.0), abs=1e-6)


def test_the_wind_of_px4_is_its_velocity() -> None:
    message = common.MAVLink_wind_cov_message(0, 3.0, -4.0, *(0.0,) * 6)
    assert reader_of(heartbeat(), told(message)).telemetry.wind_ned_m_s == (3.0, -4.0)


def test_a_wind_that_is_no_number_is_none() -> None:
    message = common.MAVLink_wind_cov_message(0, math.nan, -4.0, *(0.0,) * 6)
    assert reader_of(heartbeat(), told(message)).telemetry.wind_ned_m_s is None


def test_attitude_airspeed_and_the_local_position_are_read() -> None:
    telemetry = reader_of(heartbeat(), attitude(), hud(), local_position()).telemetry
    assert (telemetry.roll_rad, telemetry.attitude_at_s) == (0.25, 101.0)
    assert telemetry.airspeed_m_s == 15.5
    assert telemetry.local_ned_m == (1.0, 2.0, -3.0)


def test_a_local_position_that_no_longer_comes_is_none() -> None:
    reader = reader_of(heartbeat(), local_position())
    reader.receive(position(boot_ms=2_000), 103.0)
    assert reader.telemetry.local_ned_m is not None
    reader.receive(position(boot_ms=3_000), 103.1)
    assert reader.telemetry.local_ned_m is None


@pytest.mark.parametrize(
    "datagram",
    [
        attitude(math.nan, boot_ms=2_000),
        attitude(math.inf, boot_ms=2_000),
        hud(math.nan),
        local_position(math.nan, boot_ms=2_000),
        estimator(math.nan),
    ],
    ids=["roll", "infinite roll", "airspeed", "local position", "accuracy"],
)
def test_a_message_with_what_is_not_finite_is_dropped_and_counted(datagram: bytes) -> None:
    reader = reader_of(heartbeat(), attitude(), hud(), local_position(), estimator(1.5), position())
    before = reader.telemetry
    reader.receive(datagram, 200.0)
    assert (reader.telemetry, reader.rejected) == (before, {"not finite": 1})


def test_the_accuracy_is_the_receivers_own_or_its_dilution_of_precision() -> None:
    assert reader_of(heartbeat(), receiver(h_acc_mm=1_500)).telemetry.position_accuracy_m == 1.5
    assert reader_of(heartbeat(), receiver(eph=80)).telemetry.position_accuracy_m == pytest.approx(
        0.8 * METRES_PER_HDOP
    )
    assert math.isnan(reader_of(heartbeat(), receiver(eph=65_535)).telemetry.position_accuracy_m)


def test_of_receiver_and_estimator_the_worse_counts() -> None:
    first = reader_of(heartbeat(), receiver(h_acc_mm=1_500), estimator(20.0))
    assert first.telemetry.position_accuracy_m == 20.0
    first.receive(estimator(1.0), 110.0)
    assert first.telemetry.position_accuracy_m == 1.5


def test_the_fix_of_the_receiver_is_read() -> None:
    assert reader_of(heartbeat(), receiver(fix=2)).telemetry.gps_fix == 2


@pytest.mark.slow
@pytest.mark.parametrize(("told_percent", "percent"), [(73, 73.0), (0, 0.0), (-1, None), (101, None)])
def test_a_battery_that_is_not_known_is_none(told_percent: int, percent: float | None) -> None:
    assert reader_of(heartbeat(), battery(told_percent)).telemetry.battery_percent == percent
