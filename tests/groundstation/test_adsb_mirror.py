"""The display for ground-control stations: threats, and agents where they are reckoned, as ADSB_VEHICLE."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import common

from companion.geo.local_frame import LocalFrame
from companion.mission.model import Mission, parse_mission
from companion.protocol.messages import Kind
from groundstation.adsb_mirror import AGENT_ADDRESS, THREAT_ADDRESS, AdsbMirror
from groundstation.progress import MissionProgress
from groundstation.track import Track
from groundstation.tracks import TrackTable

START_S = 1_790_000_000.0
TEXT = """
case: {case}
origin: {{lat_deg: 47.0, lon_deg: 8.0, alt_m: 500}}
agents: [{{id: 3, north_m: 0, east_m: 0, height_m: 80}}, {{id: 4, north_m: 0, east_m: 5000}}]
targets: [{{id: 1, north_m: 20000, east_m: 0}}]
threats: [{{id: 7, north_m: 10000, east_m: 60000, detection_radius_m: 3000, attack_radius_m: 1000}}]
"""


def scene(case: str) -> tuple[Mission, TrackTable]:
    mission = parse_mission(TEXT.format(case=case), "test")
    return mission, TrackTable(mission, START_S, None)


def shown(mission: Mission, picture: TrackTable, now_s: float = START_S) -> list[common.MAVLink_message]:
    return [common.MAVLink(None).parse_buffer(data)[0] for data in AdsbMirror(mission).tick(picture, now_s)]


def contacts(mission: Mission, picture: TrackTable, now_s: float = START_S) -> dict[int, common.MAVLink_message]:
    return {m.ICAO_address: m for m in shown(mission, picture, now_s) if m.get_type() == "ADSB_VEHICLE"}


def test_it_goes_out_once_a_second() -> None:
    mission, picture = scene("I")
    mirror = AdsbMirror(mission)
    times = [tick * 0.05 for tick in range(100) if mirror.tick(picture, START_S + tick * 0.05)]
    assert times == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_a_heartbeat_says_who_shows_it() -> None:
    heartbeat = shown(*scene("I"))[0]
    assert heartbeat.get_type() == "HEARTBEAT"
    assert heartbeat.type == common.MAV_TYPE_ADSB
    assert (heartbeat.get_srcSystem(), heartbeat.get_srcComponent()) == (254, common.MAV_COMP_ID_ADSB)


def test_frames_are_numbered_without_a_gap() -> None:
    mission, picture = scene("II")
    mirror = AdsbMirror(mission)
    data = [one for second in range(100) for one in mirror.tick(picture, START_S + second)]
    assert [one[4] for one in data] == [number % 256 for number in range(len(data))]


def test_a_threat_is_shown_where_it_was_seen_and_how_long_ago() -> None:
    mission, picture = scene("I")
    picture.tracks[Kind.THREAT, 7] = Track(10_000.0, 60_000.0, 0.0, 12.0, START_S - 8.5)
    threat = contacts(mission, picture)[THREAT_ADDRESS + 7]
    lat_deg, lon_deg, convergence_rad = LocalFrame(47.0, 8.0).to_global_with_convergence(10_000.0, 60_000.0)
    assert (threat.lat / 1e7, threat.lon / 1e7) == pytest.approx((lat_deg, lon_deg), abs=1e-7)
    assert threat.heading == pytest.approx(9_000 + math.degrees(convergence_rad) * 100.0, abs=1.0)
    assert (threat.hor_velocity, threat.tslc, threat.callsign) == (1_200, 9, "T7")
    assert not threat.flags & common.ADSB_FLAGS_VALID_ALTITUDE
    assert threat.flags & common.ADSB_FLAGS_VALID_COORDS


def test_an_agent_that_is_reckoned_is_shown_at_its_height() -> None:
    agent = contacts(*scene("II"))[AGENT_ADDRESS + 3]
    assert agent.altitude == 580_000
    assert agent.flags & common.ADSB_FLAGS_VALID_ALTITUDE
    assert (agent.callsign, agent.emitter_type) == ("A3", common.ADSB_EMITTER_TYPE_UAV)


def test_agents_that_are_detected_are_not_shown() -> None:
    assert set(contacts(*scene("I"))) == {THREAT_ADDRESS + 7}


def test_an_agent_that_is_lost_is_shown_no_more() -> None:
    mission, picture = scene("II")
    picture.progress = MissionProgress(lost=frozenset({4}))
    assert set(contacts(mission, picture)) == {THREAT_ADDRESS + 7, AGENT_ADDRESS + 3}


def test_addresses_have_24_bits_and_none_is_used_twice() -> None:
    assert THREAT_ADDRESS + 65_535 < 1 << 24
    assert AGENT_ADDRESS + 65_535 < THREAT_ADDRESS


def test_what_was_seen_long_ago_and_moved_fast_fits_its_fields() -> None:
    mission, picture = scene("I")
    picture.tracks[Kind.THREAT, 7] = Track(10_000.0, 60_000.0, -900.0, -1.0, START_S - 1e6)
    threat = contacts(mission, picture)[THREAT_ADDRESS + 7]
    assert (threat.hor_velocity, threat.tslc) == (65_535, 255)
    assert 0 <= threat.heading < 36_000
