"""Cutting the picture into frames: nothing missing, nothing twice that must be once, each frame useful alone."""

from __future__ import annotations

import json
import math
import random
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import groundstation
from companion.files.mavlink_layout import SIGNATURE_BYTES
from companion.mission.extent import REACH_S
from companion.mission.model import AgentSpec, Mission, TargetSpec, ThreatSpec, load_mission
from companion.mission.resolve import resolve
from companion.onboard.world_model import WorldModel
from companion.protocol.codec import (
    BANDS_PER_FRAME,
    THREATS_PER_FRAME,
    BandEntry,
    Directive,
    FleetFrame,
    Frame,
    FrameReader,
    FrameWriter,
    Kind,
    MotionFrame,
    Stamp,
    StateFrame,
    WireError,
    decode_frame,
    frame_resolution_cm,
)
from companion.protocol.dialect import oneway
from companion.protocol.fleet_codec import (
    FLEET_HEAD_BYTES,
    MISSION_HEAD_BYTES,
    RADII_HEAD_BYTES,
    data_bytes,
)
from companion.protocol.frame import ED25519_BYTES, raw_frame
from groundstation.broadcast import (
    Broadcast,
    band_frames,
    fleet_frames,
    mission_digest,
    mission_frame,
    motion_frames,
    radii_frames,
    state_frames,
    surrogate_digest,
)
from groundstation.progress import MissionProgress
from groundstation.revision import Revision, first_revision
from groundstation.track import Track
from groundstation.tracks import TrackTable

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
            "targets": tuple(
                TargetSpec(id=k, north_m=n, east_m=e, speed_bound_m_s=10.0) for k, (n, e) in targets.items()
            ),
            "threats": tuple(
                ThreatSpec(
                    id=k,
                    north_m=n,
                    east_m=e,
                    detection_radius_m=5_000.0,
                    attack_radius_m=2_000.0,
                    speed_bound_m_s=10.0,
                )
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


def ground(mission: Mission) -> TrackTable:
    return TrackTable(mission, START_S, silent_after_s=None)


def revision(mission: Mission) -> Revision:
    return first_revision(mission, ground(mission), 1)


def broadcast(mission: Mission, stamp: Stamp = STAMP, directive: Directive = Directive.NORMAL) -> Broadcast:
    return Broadcast(stamp, directive, revision(mission))


def states(mission: Mission, assignment: dict[int, int]) -> list[StateFrame]:
    return state_frames(ground(mission), mission, assignment, broadcast(mission))


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
    assert len(FrameWriter().encode(frame)) + ED25519_BYTES <= 239
    assert len(motion_frames(ground(mission), mission, STAMP)) == 1


def test_sixty_agents_with_ids_all_over_arrive_whole() -> None:
    mission, assignment = sparse()
    frames = states(mission, assignment)
    assert_whole(frames, mission, assignment)
    assert len(frames) > 6


@pytest.mark.slow
@settings(max_examples=60)
@given(worlds())
def test_a_broadcast_holds_everything_and_every_agent_once_beside_its_target(
    world: tuple[Mission, dict[int, int]],
) -> None:
    assert_whole(states(*world), *world)


@pytest.mark.slow
@settings(max_examples=60)
@given(worlds())
def test_every_frame_can_be_sent_and_is_accepted(world: tuple[Mission, dict[int, int]]) -> None:
    mission, assignment = world
    writer, reader = FrameWriter(), FrameReader()
    frames: list[StateFrame | MotionFrame] = [
        *states(mission, assignment),
        *motion_frames(ground(mission), mission, STAMP),
    ]
    for frame in frames:
        assert len(reader.read(writer.encode(frame))) == 1
    assert reader.rejected.total() == 0


@pytest.mark.slow
@settings(max_examples=60)
@given(worlds())
def test_the_frames_of_a_broadcast_are_numbered(world: tuple[Mission, dict[int, int]]) -> None:
    mission, assignment = world
    for frames in (states(mission, assignment), motion_frames(ground(mission), mission, STAMP)):
        assert [frame.stamp.frame_index for frame in frames] == list(range(len(frames)))
        assert {frame.stamp.frame_count for frame in frames} <= {len(frames)}


@pytest.mark.slow
@settings(max_examples=40)
@given(worlds())
def test_each_agent_believes_its_assignment_and_every_threat_after_one_broadcast(
    world: tuple[Mission, dict[int, int]],
) -> None:
    mission, assignment = world
    frames = states(mission, assignment)
    for spec in mission.agents[:3]:
        picture = WorldModel(spec.id)
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


@settings(max_examples=40)
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
    (frame,) = state_frames(ground(mission), mission, {}, broadcast(mission, later))
    (threat,) = frame.threats
    assert (threat.detection_radius_m, threat.attack_radius_m) == (5_200.0, 2_200.0)


def test_an_agent_seen_a_while_ago_is_broadcast_where_it_must_be_by_now() -> None:
    mission = mission_of({1: (0.0, 0.0)}, {1: (9.0, 9.0)}, {})
    picture = ground(mission)
    picture.tracks[Kind.AGENT, 1] = Track(100.0, 200.0, 60.0, -10.0, START_S)
    (frame,) = state_frames(picture, mission, {}, broadcast(mission, Stamp(START_S, 2_000, 5)))
    assert (frame.agents[0].north_m, frame.agents[0].east_m) == (220.0, 180.0)


def test_lost_agents_and_completed_targets_are_left_out() -> None:
    mission = mission_of({1: (0.0, 0.0), 2: (5.0, 0.0)}, {1: (9.0, 9.0), 2: (8.0, 8.0)}, {})
    picture = ground(mission)
    picture.progress = MissionProgress(lost=frozenset({1}), completed=frozenset({2}))
    (frame,) = state_frames(picture, mission, {2: 1}, broadcast(mission))
    assert [agent.id for agent in frame.agents] == [2]
    assert [target.id for target in frame.targets] == [1]


def test_each_agent_travels_with_its_own_directive_and_a_lost_one_only_with_that() -> None:
    mission = mission_of({1: (0.0, 0.0), 2: (5.0, 0.0), 3: (9.0, 9.0)}, {1: (9.0, 9.0)}, {})
    picture = ground(mission)
    picture.progress = MissionProgress(lost=frozenset({1, 2}))
    told = broadcast(mission)._replace(directives={1: Directive.RETURN, 3: Directive.HOLD, 7: Directive.HOLD})
    (state,) = state_frames(picture, mission, {3: 1}, told)
    (fleet,) = fleet_frames(picture, mission, {3: 1}, told, 200)
    assert {agent.id: (agent.position_ned_m is None, agent.target_id, agent.directive) for agent in state.agents} == {
        1: (True, None, Directive.RETURN),
        3: (False, 1, Directive.HOLD),
    }
    assert {agent.id: agent.directive for agent in fleet.agents} == {1: Directive.RETURN, 3: Directive.HOLD}


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


@pytest.mark.slow
@settings(max_examples=40)
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


@pytest.mark.slow
@settings(max_examples=40)
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


@pytest.mark.slow
@settings(max_examples=30)
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
    reach_m = 10.0 * REACH_S  # as far as the target may get
    assert decoded.resolution_cm == frame_resolution_cm([(100.0 + reach_m, 100.0 + reach_m)], [])
    assert decoded.agents[0].position_ned_m is None


def test_in_case_ii_the_papers_mission_takes_one_frame_of_the_same_size() -> None:
    mission = unseen(resolve(load_mission("paper-dynamic"), 1))
    (frame,) = states(mission, {agent.id: mission.targets[k % 5].id for k, agent in enumerate(mission.agents)})
    assert len(FrameWriter().encode(frame)) + ED25519_BYTES <= 239


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


# Packed

ROOMS = st.integers(20, 255 - FLEET_HEAD_BYTES)
PATH_BYTES = 252
CAROUSEL_PERIOD_S = 5.0


def fleet_of(
    mission: Mission, assignment: dict[int, int], room: int, own: Mapping[int, Directive] | None = None
) -> list[FleetFrame]:
    told = broadcast(mission, directive=Directive.HOLD)._replace(directives=own or {})
    return fleet_frames(ground(mission), mission, assignment, told, room)


def five_hundred() -> tuple[Mission, dict[int, int]]:
    """Return 500 agents, 50 targets and 50 threats all over 200 km, and who goes where."""

    def scattered(count: int, salt: int) -> dict[int, tuple[float, float]]:
        return {
            k: (float(k * 7_919 * salt % 200_000), float(k * 104_729 * salt % 200_000)) for k in range(1, count + 1)
        }

    mission = mission_of(scattered(500, 1), scattered(50, 3), scattered(50, 7))
    return mission, {k: 1 + k % 50 for k in range(1, 501)}


@pytest.mark.slow
@settings(max_examples=60)
@given(worlds(), ROOMS)
def test_fleet_frames_hold_everything_once_and_no_more_than_there_is_room_for(
    world: tuple[Mission, dict[int, int]], room: int
) -> None:
    mission, assignment = world
    own = {agent.id: Directive(1 + agent.id % 2) for agent in mission.agents if agent.id % 3 == 0}
    frames = fleet_of(mission, assignment, room, own)
    decoded = [decode_frame(raw_frame(FrameWriter().encode(frame))) for frame in frames]
    assert [frame.stamp.frame_index for frame in frames] == list(range(len(frames)))
    assert {frame.stamp.frame_count for frame in frames} == {len(frames)}
    agents, targets, threats = Counter[int](), Counter[int](), Counter[int]()
    for frame in decoded:
        assert isinstance(frame, FleetFrame)
        assert frame.directive is Directive.HOLD
        agents.update(agent.id for agent in frame.agents)
        targets.update(target.id for target in frame.targets)
        threats.update(threat.id for threat in frame.threats)
        assert all(agent.target_id == assignment.get(agent.id) for agent in frame.agents)
        assert all(agent.directive is own.get(agent.id, Directive.NORMAL) for agent in frame.agents)
    assert agents == Counter(agent.id for agent in mission.agents)
    assert targets == Counter(target.id for target in mission.targets)
    assert threats == Counter(threat.id for threat in mission.threats)
    assert all(used_bytes(frame) <= room for frame in frames)


@pytest.mark.parametrize(("directed", "bytes_on_air"), [(0, 3_564), (1, 3_569), (500, 4_209)])
def test_directives_for_single_agents_cost_five_bytes_and_for_all_of_five_hundred_a_fifth(
    directed: int, bytes_on_air: int
) -> None:
    mission, assignment = five_hundred()
    own = dict.fromkeys([agent.id for agent in mission.agents[:directed]], Directive.RETURN)
    assert on_air(fleet_of(mission, assignment, rooms(0)[0], own), 0) == bytes_on_air


def used_bytes(frame: Frame) -> int:
    (message,) = oneway.MAVLink(None).parse_buffer(bytearray(FrameWriter().encode(frame)))
    size: int = message.size
    return size


@pytest.mark.slow
@settings(max_examples=30)
@given(worlds(), st.randoms(use_true_random=False))
def test_each_agent_knows_all_it_needs_after_a_packed_broadcast_in_any_order(
    world: tuple[Mission, dict[int, int]], chance: random.Random
) -> None:
    mission, assignment = world
    frames: list[Frame] = [
        *fleet_of(mission, assignment, 100),
        *radii_frames(mission, revision(mission), STAMP, 60),
        mission_frame(mission, revision(mission), bytes(8), STAMP, 100),
    ]
    chance.shuffle(frames)
    for spec in mission.agents[:2]:
        picture = WorldModel(spec.id)
        for frame in frames:
            assert picture.take(decode_frame(raw_frame(FrameWriter().encode(frame))), START_S)
        view = picture.view(START_S)
        wanted = next((t.position_ned_m for t in mission.targets if t.id == assignment.get(spec.id)), None)
        assert (view.target_ned_m is None) == (wanted is None)
        if wanted is not None and view.target_ned_m is not None:
            assert math.dist(view.target_ned_m, wanted) <= 3.0
        assert view.threat_ids.tolist() == sorted(threat.id for threat in mission.threats)
        assert len(view.peers_ned_m) == len(mission.agents) - 1
        for identity, centre, radius_m in zip(view.threat_ids, view.threats_ned_m, view.attack_radius_m, strict=True):
            truth = next(threat for threat in mission.threats if threat.id == identity)
            assert math.dist(centre, truth.position_ned_m) + truth.attack_radius_m <= radius_m + 1e-3


def on_air(frames: Sequence[Frame], overhead_bytes: int, typed_signature_bytes: int = 0) -> int:
    """Return the bytes of frames; a typed message carries its signature after all of its fields."""
    writer = FrameWriter()
    sizes = [max(len(writer.encode(frame)), 175 if typed_signature_bytes else 0) + overhead_bytes for frame in frames]
    assert max(sizes) <= PATH_BYTES
    return sum(sizes)


def rooms(overhead_bytes: int) -> list[int]:
    heads = (FLEET_HEAD_BYTES, RADII_HEAD_BYTES, MISSION_HEAD_BYTES)
    return [data_bytes(head, PATH_BYTES, overhead_bytes) for head in heads]


def carousel(mission: Mission, overhead_bytes: int) -> list[Frame]:
    _, radii_room, mission_room = rooms(overhead_bytes)
    return [
        *radii_frames(mission, revision(mission), STAMP, radii_room),
        mission_frame(mission, revision(mission), bytes(8), STAMP, mission_room),
    ]


@pytest.mark.parametrize(("overhead_bytes", "limit"), [(SIGNATURE_BYTES, 3_900), (ED25519_BYTES, 5_300)])
def test_five_hundred_agents_once_a_second_with_their_carousel_keep_the_budget(overhead_bytes: int, limit: int) -> None:
    mission, assignment = five_hundred()
    state_bytes = on_air(fleet_of(mission, assignment, rooms(overhead_bytes)[0]), overhead_bytes)
    carousel_bytes = on_air(carousel(mission, overhead_bytes), overhead_bytes)
    assert state_bytes + carousel_bytes / CAROUSEL_PERIOD_S <= limit


@pytest.mark.parametrize(("column", "overhead_bytes"), list(enumerate([0, 13, 64, 77])))
def test_the_bytes_per_second_of_the_wire_page_are_those_of_five_hundred_agents(
    column: int, overhead_bytes: int
) -> None:
    text = (Path(groundstation.__file__).parents[1] / "docs" / "wire.md").read_text(encoding="utf-8")
    table = text[text.index("| bytes per second |") :].split("\n\n")[0].splitlines()[2:]
    told = [int(row.split("|")[2 + column]) for row in table]
    mission, assignment = five_hundred()
    room = rooms(overhead_bytes)[0]
    frames = fleet_of(mission, assignment, room)
    state_bytes = on_air(frames, overhead_bytes)
    carousel_bytes = on_air(carousel(mission, overhead_bytes), overhead_bytes)
    unseen = fleet_of(mission.model_copy(update={"case": "II"}), assignment, room)
    assert told == [
        state_bytes,
        len(frames),
        round(state_bytes + carousel_bytes / CAROUSEL_PERIOD_S),
        on_air(unseen, overhead_bytes),
        on_air(states(mission, assignment), overhead_bytes, ED25519_BYTES if overhead_bytes >= 64 else 0),
        600 * (12 + 38 + overhead_bytes),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2, 10, 100, 1_000])
def test_any_number_of_agents_travels_packed(count: int) -> None:
    agents = {k: (20.0 * k, 7.0) for k in range(1, count + 1)}
    frames = fleet_of(mission_of(agents, {1: (0.0, 0.0)}, {}), dict.fromkeys(agents, 1), 205)
    assert sum(len(frame.agents) for frame in frames) == count
    assert len(frames) == math.ceil((count + 1) / 39.5)


def test_agents_that_nobody_sees_travel_without_a_place() -> None:
    mission, assignment = five_hundred()
    frames = fleet_of(mission.model_copy(update={"case": "II"}), assignment, 205)
    assert all(agent.position_ned_m is None for frame in frames for agent in frame.agents)
    assert sum(len(frame.agents) for frame in frames) == 500
    assert len(frames) == 5


def test_a_threat_seen_long_ago_travels_with_its_age() -> None:
    mission = mission_of({1: (0.0, 0.0)}, {1: (9.0, 9.0)}, {1: (50_000.0, 0.0)})
    (frame,) = fleet_frames(ground(mission), mission, {}, broadcast(mission, Stamp(START_S, 20_000, 5)), 200)
    assert [threat.age_s for threat in frame.threats] == [20.0]


def test_a_fleet_of_nobody_is_still_a_frame_that_says_so() -> None:
    (frame,) = fleet_of(mission_of({}, {}, {}), {}, 200)
    assert (frame.agents, frame.targets, frame.threats) == ((), (), ())


def test_no_threats_take_no_radii_frame() -> None:
    mission = mission_of({}, {}, {})
    assert radii_frames(mission, revision(mission), STAMP, 200) == []


def test_a_path_with_no_room_for_one_entry_is_refused() -> None:
    mission, assignment = five_hundred()
    with pytest.raises(WireError, match="allowed: at least 11"):
        fleet_of(mission, assignment, 10)
    with pytest.raises(WireError, match="allowed: at least 9"):
        radii_frames(mission, revision(mission), STAMP, 8)


def test_a_mission_frame_tells_what_holds_for_all() -> None:
    mission, _ = five_hundred()
    frame = mission_frame(mission, revision(mission), surrogate_digest(mission), STAMP, 200)
    assert (frame.agents, frame.targets, frame.threats) == (500, 50, 50)
    assert (frame.origin_lat_deg, frame.origin_alt_m) == (mission.origin.lat_deg, mission.origin.alt_m)
    assert (frame.separation_m, frame.arrival_radius_m) == (mission.separation_m, mission.arrival_radius_m)
    assert frame.name == mission.name


def test_the_digest_of_a_mission_is_another_for_another_origin_target_or_threat_and_for_nothing_else() -> None:
    mission, _ = five_hundred()
    threat, target, agent = mission.threats[0], mission.targets[0], mission.agents[0]
    others: list[dict[str, Any]] = [
        {"origin": mission.origin.model_copy(update={"alt_m": 501.0})},
        {"targets": (target.model_copy(update={"north_m": 1.0}), *mission.targets[1:])},
        *(
            {"threats": (threat.model_copy(update=changed), *mission.threats[1:])}
            for changed in (
                {"id": 4_000},
                {"east_m": 1.0},
                {"detection_radius_m": 9_999.0},
                {"attack_radius_m": 1.0},
                {"speed_bound_m_s": 77.0},
                {"floor_m": 1.0},
                {"ceiling_m": 9_000.0},
            )
        ),
    ]
    digests = [mission_digest(mission.model_copy(update=changed)) for changed in [{}, *others]]
    assert len(set(digests)) == len(digests)
    assert {len(digest) for digest in digests} == {8}
    same = {"name": "x", "agents": (agent.model_copy(update={"north_m": 1.0}), *mission.agents[1:])}
    assert mission_digest(mission.model_copy(update=same)) == digests[0]
    assert mission_frame(mission, revision(mission), bytes(8), STAMP, 100).mission_digest == digests[0]


def test_a_long_name_is_cut_between_characters() -> None:
    mission = mission_of({}, {}, {}).model_copy(update={"name": "ü" * 40})
    assert mission_frame(mission, revision(mission), bytes(8), STAMP, 7).name == "üüü"


@pytest.mark.parametrize(("surrogate", "known"), [("pairwise", True), ("monolithic", True), ("analytic", False)])
def test_the_digest_is_that_of_the_weights_the_mission_flies_by(surrogate: str, known: bool) -> None:
    mission = mission_of({}, {}, {}).model_copy(update={"surrogate": surrogate})
    digest = surrogate_digest(mission)
    if not known:
        assert digest == bytes(8)
    else:
        text = (resources.files("companion.surrogate") / "weights" / f"{surrogate}.json").read_text(encoding="utf-8")
        assert json.loads(text)["sha256"].startswith(digest.hex())
        assert digest != bytes(8)
