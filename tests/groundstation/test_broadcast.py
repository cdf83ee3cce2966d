"""Cutting the picture into frames: nothing missing, nothing twice that must be once, each frame useful alone."""

from __future__ import annotations

import math
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.drawing import resolve
from companion.mission import AgentSpec, Mission, TargetSpec, ThreatSpec, load_mission
from companion.picture import Picture
from companion.wire import (
    BANDS_PER_FRAME,
    THREATS_PER_FRAME,
    BandEntry,
    Directive,
    FrameReader,
    FrameWriter,
    Kind,
    MotionFrame,
    Stamp,
    StateFrame,
)
from groundstation.broadcast import band_frames, motion_frames, state_frames
from groundstation.picture import GroundPicture, Track

START_S = 1_790_000_000
STAMP = Stamp(START_S, 0, 1)
ids_16 = st.integers(1, 65_535)
places = st.tuples(st.integers(0, 200_000), st.integers(0, 200_000)).map(lambda p: (float(p[0]), float(p[1])))


def mission_of(
    agents: dict[int, tuple[float, float]],
    targets: dict[int, tuple[float, float]],
    threats: dict[int, tuple[float, float]],
) -> Mission:
    # Legal starts do not matter here, so neither does check_start.
    return Mission.model_construct(
        **{
            **dict(load_mission("paper-static")),
            "agents": tuple(AgentSpec(id=k, north_m=n, east_m=e, heading_deg=0.0) for k, (n, e) in agents.items()),
            "targets": tuple(TargetSpec(id=k, north_m=n, east_m=e) for k, (n, e) in targets.items()),
            "threats": tuple(
                ThreatSpec(id=k, north_m=n, east_m=e, detection_radius_m=5_000.0, attack_radius_m=2_000.0)
                for k, (n, e) in threats.items()
            ),
        }
    )


@st.composite
def worlds(draw: st.DrawFn) -> tuple[Mission, dict[int, int]]:
    """Return a mission with ids anywhere in 16 bits, and an assignment that leaves some agents without a target."""

    def things(least: int, most: int) -> dict[int, tuple[float, float]]:
        identities = draw(st.lists(ids_16, min_size=least, max_size=most, unique=True))
        return {identity: draw(places) for identity in identities}

    agents, targets, threats = things(0, 40), things(0, 15), things(0, 12)
    assignment = {}
    for agent in agents:
        target = draw(st.sampled_from([None, *targets]))
        if target is not None:
            assignment[agent] = target
    return mission_of(agents, targets, threats), assignment


def ground(mission: Mission) -> GroundPicture:
    return GroundPicture(mission, START_S, silent_after_s=None)


def states(mission: Mission, assignment: dict[int, int]) -> list[StateFrame]:
    return state_frames(ground(mission), mission, assignment, Directive.NORMAL, STAMP)


def sparse() -> tuple[Mission, dict[int, int]]:
    agents = {(7 + 1_009 * k) % 65_535 + 1: (3_000.0 * k, 1_000.0 * (k % 7)) for k in range(60)}
    targets = {(11 + 3_001 * k) % 65_535 + 1: (9_000.0 * k, 150_000.0) for k in range(20)}
    threats = {(13 + 5_003 * k) % 65_535 + 1: (15_000.0 * k, 80_000.0) for k in range(12)}
    names = list(targets)
    return mission_of(agents, targets, threats), {agent: names[k % 20] for k, agent in enumerate(agents)}


def assert_whole(frames: list[StateFrame], mission: Mission, assignment: dict[int, int]) -> None:
    agents = Counter(agent.id for frame in frames for agent in frame.agents)
    assert agents == Counter(agent.id for agent in mission.agents)
    assert {t.id for frame in frames for t in frame.targets} == {target.id for target in mission.targets}
    assert {t.id for frame in frames for t in frame.threats} == {threat.id for threat in mission.threats}
    for frame in frames:
        present = {target.id for target in frame.targets}
        for agent in frame.agents:
            assert agent.target_id == assignment.get(agent.id)
            assert agent.target_id is None or agent.target_id in present


def test_the_papers_mission_takes_one_frame() -> None:
    mission = resolve(load_mission("paper-dynamic"), 1)
    assignment = {agent.id: mission.targets[k % 5].id for k, agent in enumerate(mission.agents)}
    (frame,) = states(mission, assignment)
    assert (len(frame.agents), len(frame.targets), len(frame.threats)) == (10, 5, 4)
    assert len(FrameWriter().encode(frame, bytes(range(1, 65)))) <= 235
    assert len(motion_frames(ground(mission), mission, STAMP)) == 1


def test_sixty_agents_with_ids_all_over_arrive_whole() -> None:
    mission, assignment = sparse()
    frames = states(mission, assignment)
    assert_whole(frames, mission, assignment)
    assert len(frames) > 6


@settings(max_examples=60, deadline=None)
@given(worlds())
def test_a_broadcast_holds_everything_and_every_agent_once_beside_its_target(
    world: tuple[Mission, dict[int, int]],
) -> None:
    assert_whole(states(*world), *world)


@settings(max_examples=60, deadline=None)
@given(worlds())
def test_every_frame_can_be_sent_and_is_accepted(world: tuple[Mission, dict[int, int]]) -> None:
    mission, assignment = world
    writer, reader = FrameWriter(), FrameReader()
    frames = [*states(mission, assignment), *motion_frames(ground(mission), mission, STAMP)]
    for frame in frames:
        assert len(reader.read(writer.encode(frame))) == 1
    assert reader.rejected.total() == 0


@settings(max_examples=60, deadline=None)
@given(worlds())
def test_the_frames_of_a_broadcast_are_numbered(world: tuple[Mission, dict[int, int]]) -> None:
    mission, assignment = world
    for frames in (states(mission, assignment), motion_frames(ground(mission), mission, STAMP)):
        assert [frame.stamp.frame_index for frame in frames] == list(range(len(frames)))
        assert {frame.stamp.frame_count for frame in frames} <= {len(frames)}


@settings(max_examples=40, deadline=None)
@given(worlds())
def test_each_agent_believes_its_assignment_and_every_threat_after_one_broadcast(
    world: tuple[Mission, dict[int, int]],
) -> None:
    mission, assignment = world
    frames = states(mission, assignment)
    for spec in mission.agents[:3]:
        picture = Picture(spec.id)
        for frame in frames:
            picture.take_state(frame, START_S)
        view = picture.view(START_S)
        wanted = assignment.get(spec.id)
        place = next((t.position_ned_m for t in mission.targets if t.id == wanted), None)
        assert view.target_ned_m == place
        assert len(view.threats_ned_m) == len(mission.threats)
        assert len(view.peers_ned_m) == len(mission.agents) - 1


def test_an_agents_frame_holds_the_threats_nearest_to_its_group() -> None:
    agents = {k: (0.0, 100.0 * k) for k in range(1, 11)}
    threats = {k: (10_000.0 * k, 0.0) for k in range(1, 9)}
    frames = states(mission_of(agents, {1: (90_000.0, 0.0)}, threats), dict.fromkeys(agents, 1))
    assert [threat.id for threat in frames[0].threats] == [1, 2, 3, 4]
    assert [threat.id for threat in frames[1].threats] == [5, 6, 7, 8]


@settings(max_examples=40, deadline=None)
@given(st.lists(places, min_size=1, max_size=10), st.lists(places, min_size=5, max_size=12))
def test_no_threat_left_out_of_a_frame_is_nearer_than_one_in_it(
    agents: list[tuple[float, float]], threats: list[tuple[float, float]]
) -> None:
    mission = mission_of(dict(enumerate(agents, 1)), {1: (0.0, 0.0)}, dict(enumerate(threats, 1)))
    first = states(mission, dict.fromkeys(range(1, len(agents) + 1), 1))[0]
    chosen = {threat.id for threat in first.threats}
    assert len(chosen) == THREATS_PER_FRAME
    distance_m = {k: min(math.dist(threat, agent) for agent in agents) for k, threat in enumerate(threats, 1)}
    left_out = [d for k, d in distance_m.items() if k not in chosen]
    assert max(distance_m[k] for k in chosen) <= min(left_out)


def test_a_picture_with_nothing_in_it_is_still_a_frame_that_says_so() -> None:
    (frame,) = states(mission_of({}, {}, {}), {})
    assert (frame.agents, frame.targets, frame.threats) == ((), (), ())
    assert frame.stamp.frame_count == 1


def test_a_threat_seen_long_ago_is_broadcast_larger() -> None:
    mission = mission_of({1: (0.0, 0.0)}, {1: (9.0, 9.0)}, {1: (50_000.0, 0.0)})
    later = Stamp(START_S, 20_000, 5)
    (frame,) = state_frames(ground(mission), mission, {}, Directive.NORMAL, later)
    (threat,) = frame.threats
    assert (threat.detection_radius_m, threat.attack_radius_m) == (5_200.0, 2_200.0)


def test_an_agent_seen_a_while_ago_is_broadcast_where_it_must_be_by_now() -> None:
    mission = mission_of({1: (0.0, 0.0)}, {1: (9.0, 9.0)}, {})
    picture = ground(mission)
    picture.tracks[Kind.AGENT, 1] = Track(100.0, 200.0, 60.0, -10.0, START_S)
    (frame,) = state_frames(picture, mission, {}, Directive.NORMAL, Stamp(START_S, 2_000, 5))
    assert (frame.agents[0].north_m, frame.agents[0].east_m) == (220.0, 180.0)


def test_lost_agents_and_completed_targets_are_left_out() -> None:
    mission = mission_of({1: (0.0, 0.0), 2: (5.0, 0.0)}, {1: (9.0, 9.0), 2: (8.0, 8.0)}, {})
    picture = ground(mission)
    picture.lost, picture.completed = {1}, {2}
    (frame,) = state_frames(picture, mission, {2: 1}, Directive.NORMAL, STAMP)
    assert [agent.id for agent in frame.agents] == [2]
    assert [target.id for target in frame.targets] == [1]


def motions(tracks: dict[tuple[Kind, int], Track], at_s: float) -> MotionFrame:
    mission = mission_of({1: (0.0, 0.0)}, {2: (9.0, 9.0)}, {3: (50_000.0, 0.0)})
    picture = ground(mission)
    picture.tracks.update(tracks)
    (frame,) = motion_frames(picture, mission, Stamp(START_S, round(at_s * 1000), 5))
    return frame


def test_a_motion_frame_tells_velocities_and_ages() -> None:
    frame = motions(
        {
            (Kind.AGENT, 1): Track(0.0, 0.0, 0.0, 60.0, START_S + 1.0),
            (Kind.TARGET, 2): Track(0.0, 0.0, -3.0, 4.0, START_S + 2.0),
            (Kind.THREAT, 3): Track(0.0, 0.0, 5.0, -6.0, START_S),
        },
        4.0,
    )
    (agent,), (target,), (threat,) = frame.agents, frame.targets, frame.threats
    assert (agent.id, agent.speed_m_s, agent.age_s) == (1, 60.0, 3.0)
    assert agent.heading_rad == pytest.approx(math.pi / 2)
    assert (target.velocity_north_m_s, target.velocity_east_m_s, target.age_s) == (-3.0, 4.0, 2.0)
    assert (threat.velocity_north_m_s, threat.velocity_east_m_s, threat.age_s) == (5.0, -6.0, 4.0)


def test_an_agent_that_stands_has_no_heading() -> None:
    frame = motions({(Kind.AGENT, 1): Track(0.0, 0.0, 0.05, 0.0, START_S)}, 0.0)
    assert frame.agents[0].heading_rad is None


@settings(max_examples=40, deadline=None)
@given(worlds())
def test_the_motion_frames_hold_everything_once(world: tuple[Mission, dict[int, int]]) -> None:
    mission, _ = world
    frames = motion_frames(ground(mission), mission, STAMP)
    assert Counter(a.id for f in frames for a in f.agents) == Counter(a.id for a in mission.agents)
    assert Counter(t.id for f in frames for t in f.targets) == Counter(t.id for t in mission.targets)
    assert Counter(t.id for f in frames for t in f.threats) == Counter(t.id for t in mission.threats)


# Case II: what is reckoned is not broadcast


def unseen(mission: Mission) -> Mission:
    return mission.model_copy(update={"case": "II"})


@settings(max_examples=40, deadline=None)
@given(worlds())
def test_in_case_ii_a_broadcast_tells_no_place_and_no_motion_of_any_agent(
    world: tuple[Mission, dict[int, int]],
) -> None:
    mission, assignment = unseen(world[0]), world[1]
    frames = states(mission, assignment)
    assert_whole(frames, mission, assignment)
    assert {(agent.north_m, agent.east_m) for frame in frames for agent in frame.agents} <= {(None, None)}
    moving = motion_frames(ground(mission), mission, STAMP)
    assert [agent for frame in moving for agent in frame.agents] == []
    assert Counter(t.id for f in moving for t in f.targets) == Counter(t.id for t in mission.targets)
    assert Counter(t.id for f in moving for t in f.threats) == Counter(t.id for t in mission.threats)


@settings(max_examples=30, deadline=None)
@given(worlds())
def test_in_case_ii_threats_travel_with_whom_they_are_near_just_as_in_case_i(
    world: tuple[Mission, dict[int, int]],
) -> None:
    mission, assignment = world
    for seen, told in zip(states(mission, assignment), states(unseen(mission), assignment), strict=True):
        assert (seen.threats, seen.targets) == (told.threats, told.targets)


def test_in_case_ii_a_frame_is_as_fine_as_targets_and_threats_alone_allow() -> None:
    mission = unseen(mission_of({1: (150_000.0, 0.0)}, {1: (100.0, 100.0)}, {}))
    (frame,) = states(mission, {1: 1})
    (decoded,) = FrameReader().read(FrameWriter().encode(frame))
    assert isinstance(decoded, StateFrame)
    assert (decoded.targets[0].north_m, decoded.agents[0].position_ned_m) == (100.0, None)


def test_in_case_ii_the_papers_mission_takes_one_frame_of_the_same_size() -> None:
    mission = unseen(resolve(load_mission("paper-dynamic"), 1))
    (frame,) = states(mission, {agent.id: mission.targets[k % 5].id for k, agent in enumerate(mission.agents)})
    assert len(FrameWriter().encode(frame, bytes(range(1, 65)))) <= 235


# Heights that threats reach

limits = st.none() | st.integers(-900, 400).map(float)


@settings(max_examples=30)
@given(st.dictionaries(ids_16, st.tuples(limits, limits.map(lambda floor: None if floor is None else floor + 1_500.0))))
def test_every_band_goes_out_once_and_a_threat_without_one_is_not_named(
    bands: dict[int, tuple[float | None, float | None]],
) -> None:
    threats = tuple(
        ThreatSpec(id=k, detection_radius_m=2.0, attack_radius_m=1.0, floor_m=floor_m, ceiling_m=ceiling_m)
        for k, (floor_m, ceiling_m) in bands.items()
    )
    mission = mission_of({1: (0.0, 0.0)}, {1: (0.0, 0.0)}, {}).model_copy(update={"threats": threats})
    frames = band_frames(mission, STAMP)
    told = [threat for frame in frames for threat in frame.threats]
    assert sorted(told, key=lambda threat: threat.id) == [
        BandEntry(k, *limits_m) for k, limits_m in sorted(bands.items()) if limits_m != (None, None)
    ]
    assert [frame.stamp.frame_index for frame in frames] == list(range(len(frames)))
    assert {frame.stamp.frame_count for frame in frames} <= {len(frames)}
    for frame in frames:
        assert len(frame.threats) <= BANDS_PER_FRAME
        assert FrameReader().read(FrameWriter().encode(frame)) == [frame]
