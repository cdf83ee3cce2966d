"""One grid for a revision: what stands is told by the same bytes, and revisions begin only for a reason."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.mission.extent import FARTHEST_M, REACH_S, WHOLE_PLANE_M, Extent, mission_extent
from companion.mission.model import Mission, parse_mission
from companion.protocol.codec import (
    Detection,
    DetectionsFrame,
    FleetFrame,
    FrameReader,
    FrameWriter,
    Kind,
    RadiiFrame,
    StateFrame,
)
from companion.protocol.messages import REVISIONS
from groundstation.ground_station import GroundStation, Resumed
from groundstation.plausibility import SENSOR_ERROR_M
from groundstation.revision import first_revision, next_revision
from groundstation.track import Track
from groundstation.tracks import TrackTable

START_S = 1_790_000_000.0
PERIOD_S = 5.0
STANDING = (
    "{id: 1, north_m: 3001.7, east_m: -1234.5, detection_radius_m: 333.3, attack_radius_m: 111.1, speed_bound_m_s: 0}"
)
MOVING = "{id: 2, north_m: -900, east_m: 1800, detection_radius_m: 300, attack_radius_m: 150, speed_bound_m_s: 4}"
TEXT = """
name: grid
agents:
- {id: 1, north_m: 0, east_m: 0, heading_deg: 0, speed_m_s: 20, n_max: 1}
- {id: 2, north_m: 100, east_m: 900, heading_deg: 0, speed_m_s: 20, n_max: 1}
targets:
- {id: 1, north_m: 8000, east_m: 7.77, speed_bound_m_s: 0}
- {id: 2, north_m: 7000, east_m: 70, speed_bound_m_s: 3}
threats:
- {id: 1, north_m: 3001.7, east_m: -1234.5, detection_radius_m: 333.3, attack_radius_m: 111.1, speed_bound_m_s: 0}
- {id: 2, north_m: -900, east_m: 1800, detection_radius_m: 300, attack_radius_m: 150, speed_bound_m_s: 4}
"""


def mission(text: str = TEXT, **changes: object) -> Mission:
    return parse_mission(text, "grid").model_copy(update=changes)


def tracks_of(given: Mission) -> TrackTable:
    return TrackTable(given, START_S, silent_after_s=None)


def seen(kind: Kind, identity: int, north_m: float, east_m: float) -> Detection:
    return Detection(kind, identity, north_m, east_m, 0.0, 0.0)


def sense(station: GroundStation, now_s: float, *detections: Detection) -> None:
    origin = station.mission.origin
    time_ms = round(1000 * (now_s - START_S))
    frame = DetectionsFrame(int(START_S), time_ms, origin.lat_deg, origin.lon_deg, detections)
    station.sense(FrameWriter().encode(frame), now_s)


def states(station: GroundStation, now_s: float) -> list[StateFrame]:
    frames = [frame for raw in station.tick(now_s) for frame in FrameReader().read(raw)]
    return [frame for frame in frames if isinstance(frame, StateFrame)]


# Extents


def test_the_extent_holds_everything_with_the_room_that_it_needs() -> None:
    given = mission()
    extent = mission_extent(given)
    reach_m = 4.0 * 20.0**2 / 9.80665 + 30.0 * 20.0
    assert extent.low_ned_m == pytest.approx((-900.0 - 4.0 * REACH_S, 70.0 - 3.0 * REACH_S))
    assert extent.high_ned_m == pytest.approx((7_000.0 + 3.0 * REACH_S, 1_800.0 + 4.0 * REACH_S))
    assert extent.radius_m == 300.0 + 4.0 * REACH_S
    standing = mission_extent(mission(targets=given.targets[:1], threats=given.threats[:1]))
    assert standing.high_ned_m == pytest.approx((8_000.0 + reach_m, 900.0 + reach_m))


def test_what_moves_needs_room_for_no_longer_than_the_mission_lasts() -> None:
    assert mission_extent(mission(max_time_s=60.0)).radius_m == 300.0 + 4.0 * 60.0


def test_the_fence_is_inside_and_an_unused_area_is_not() -> None:
    fenced = mission(fence=((-20_000.0, 0.0), (0.0, 30_000.0), (9_000.0, -9_000.0)))
    extent = mission_extent(fenced)
    assert (extent.low_ned_m[0], extent.high_ned_m[1]) == (-20_000.0, 30_000.0)
    assert mission_extent(mission()).high_ned_m[0] < 10_000.0


def test_where_no_agent_is_told_none_needs_room() -> None:
    given = mission()
    extent = mission_extent(mission(case="II", targets=given.targets[:1], threats=given.threats[:1]))
    assert (extent.low_ned_m, extent.high_ned_m) == ((3_001.7, -1_234.5), (8_000.0, 7.77))


@given(st.tuples(*[st.floats(-FARTHEST_M, FARTHEST_M)] * 2), st.floats(0.0, WHOLE_PLANE_M), st.floats(1.0, 1e5))
def test_a_widened_extent_holds_what_it_was_widened_for_and_is_at_least_twice_as_wide_there(
    point: tuple[float, float], radius_m: float, side_m: float
) -> None:
    before = Extent((-side_m, 0.0), (side_m, side_m), 100.0)
    after = before.widened([point], radius_m)
    assert after.holds(point)
    assert after.holds(before.low_ned_m)
    assert after.holds(before.high_ned_m)
    assert after.radius_m >= max(before.radius_m, radius_m)
    assert after.radius_m in (100.0, 200.0, radius_m)
    for axis in (0, 1):
        span_m = before.high_ned_m[axis] - before.low_ned_m[axis]
        grown_m = after.high_ned_m[axis] - after.low_ned_m[axis]
        assert grown_m == pytest.approx(span_m) or grown_m >= min(2.0 * span_m, FARTHEST_M) - 1e-6


# Revisions


def test_nothing_new_begins_no_revision() -> None:
    given = mission()
    tracks = tracks_of(given)
    first = first_revision(given, tracks, 7)
    assert next_revision(first, given, tracks, [333.3, 300.0]) is first


def test_a_threat_that_should_stand_but_has_moved_begins_one_and_so_does_its_coming_back() -> None:
    given = mission()
    tracks = tracks_of(given)
    first = first_revision(given, tracks, 7)
    home = tracks.tracks[Kind.THREAT, 1]
    tracks.tracks[Kind.THREAT, 1] = Track(3_050.0, -1_234.5, 0.0, 0.0, START_S)
    second = next_revision(first, given, tracks, [333.3])
    assert (second.number, second.moved, second.state_cm) == (8, {1: (3_050.0, -1_234.5)}, first.state_cm)
    assert next_revision(second, given, tracks, [333.3]) is second
    tracks.tracks[Kind.THREAT, 1] = home
    assert next_revision(second, given, tracks, [333.3]).number == 9


@pytest.mark.parametrize("kind", [Kind.TARGET, Kind.THREAT])
def test_what_leaves_the_grid_begins_one_with_a_coarser_grid_and_then_none_for_long(kind: Kind) -> None:
    given = mission()
    tracks = tracks_of(given)
    first = revision = first_revision(given, tracks, 1)
    for step in range(1, 200):
        tracks.tracks[kind, 2] = Track(9_000.0 + 200.0 * step, 0.0, 0.0, 0.0, START_S)
        revision = next_revision(revision, given, tracks, [333.3])
        assert revision.extent.holds(tracks.tracks[kind, 2].position_ned_m)
    assert 3 <= revision.number <= 4
    assert revision.state_cm > 2 * first.state_cm


def test_a_radius_that_has_outgrown_the_grid_begins_one() -> None:
    given = mission()
    first = first_revision(given, tracks_of(given), REVISIONS - 1)
    second = next_revision(first, given, tracks_of(given), [first.extent.radius_m + 1.0])
    assert (second.number, second.extent.radius_m) == (0, 2.0 * first.extent.radius_m)


def test_an_agent_that_leaves_the_grid_begins_none_and_has_no_place_until_it_is_back() -> None:
    station = GroundStation(mission(), START_S)
    for t_s in (0.0, 1.0, 2.0):
        # The mission has it elsewhere; three looks show that.
        sense(station, START_S + t_s, seen(Kind.AGENT, 1, 0.0, 0.0), seen(Kind.AGENT, 2, -50_000.0, 0.0))
    (frame,) = states(station, START_S + 2.0)
    assert station.revision == 1
    assert [agent.position_ned_m is None for agent in frame.agents] == [False, True]
    assert [agent.target_id is None for agent in frame.agents] == [False, False]
    for t_s in (3_000.0, 3_001.0, 3_002.0):
        sense(station, START_S + t_s, seen(Kind.AGENT, 1, 0.0, 0.0), seen(Kind.AGENT, 2, 0.0, 50.0))
    (frame,) = states(station, START_S + 3_002.0)
    assert [agent.position_ned_m is None for agent in frame.agents] == [False, False]


@given(st.floats(-SENSOR_ERROR_M, SENSOR_ERROR_M), st.floats(0.0, math.tau))
@settings(max_examples=20)
def test_a_sensors_last_centimetres_do_not_move_what_stands(off_m: float, bearing_rad: float) -> None:
    given = mission()
    station = GroundStation(given, START_S)
    before = states(station, START_S)[0]
    off = 0.9 * off_m * math.cos(bearing_rad), 0.9 * off_m * math.sin(bearing_rad)
    threat, target = given.threats[0].position_ned_m, given.targets[0].position_ned_m
    sense(
        station,
        START_S + 4.0,
        seen(Kind.THREAT, 1, threat[0] + off[0], threat[1] + off[1]),
        seen(Kind.TARGET, 1, target[0] + off[0], target[1] + off[1]),
    )
    after = states(station, START_S + PERIOD_S)[0]
    assert (after.threats[0], after.targets[0]) == (before.threats[0], before.targets[0])
    assert after.revision == before.revision == 1


def test_a_standing_threat_that_is_seen_elsewhere_is_told_where_the_mission_has_it_and_the_doubt_is_said() -> None:
    station = GroundStation(mission(), START_S)
    before = states(station, START_S)[0]
    for step in range(12):
        sense(station, START_S + 1.0 + step, seen(Kind.THREAT, 1, 2_000.0, 0.0))
    after = states(station, START_S + 13.0)[0]
    assert (after.revision, after.threats[0]) == (before.revision, before.threats[0])
    assert station.tracks.refusals.news(START_S + 13.0) == [
        "sensor: threat 1 seen 1.6 km from where its bound of 0 m/s allows: not believed, 12 times"
    ]


def test_a_run_goes_on_behind_the_last_revision_of_the_run_before() -> None:
    station = GroundStation(mission(), START_S, resumed=Resumed(revision=41))
    assert states(station, START_S)[0].revision == station.revision == 41


# The same thing by the same bytes


@settings(max_examples=30)
@given(st.lists(st.tuples(*[st.floats(-500.0, 500.0)] * 4), min_size=1, max_size=6), st.booleans())
def test_what_stands_is_told_the_same_wherever_everything_else_moves(
    moves: list[tuple[float, float, float, float]], packed: bool
) -> None:
    station = GroundStation(mission(), START_S)
    told: set[str] = set()
    for step, (north_m, east_m, other_m, age_s) in enumerate(moves):
        now_s = START_S + PERIOD_S * step
        sense(
            station,
            now_s,
            seen(Kind.AGENT, 1, north_m, east_m),
            seen(Kind.AGENT, 2, other_m, north_m),
            seen(Kind.TARGET, 2, 7_000.0 + other_m, east_m),
            *([seen(Kind.THREAT, 2, east_m, other_m)] if age_s > 0.0 else []),
        )
        if not packed:
            (frame,) = states(station, now_s)
            told.add(repr((frame.threats[0], frame.targets[0], frame.revision, frame.resolution_cm)))
            continue
        station.advance(now_s)
        for sent in (*station.refresh(now_s, 60), *station.carousel(now_s, 60)):
            (decoded,) = FrameReader().read(FrameWriter().encode(sent))
            if isinstance(decoded, FleetFrame):
                told.update(repr(replace(one, age_s=0.0)) for one in decoded.threats if one.id == 1)
                told.update(repr(one) for one in decoded.targets if one.id == 1)
                told.add(repr(decoded.grid))
            if isinstance(decoded, RadiiFrame):
                told.update(repr(one) for one in decoded.threats if one.id == 1)
                told.add(repr(decoded.resolution_cm))
    assert len(told) == (5 if packed else 1)
