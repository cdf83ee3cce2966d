"""The score against hand-made runs and against plain loops over the file."""

from __future__ import annotations

import csv
import json
import math
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.mission.model import Mission, ThreatSpec, parse_mission
from companion.mission.resolve import resolve
from sim.changes import Change, with_all_things
from sim.flown_path import ROUNDING_M
from sim.score import Score, score
from sim.trajectory import Trajectory, TrajectoryBuilder, read_csv

Track = Sequence[tuple[float, float]]

SCORE_LIMIT_S = 2.0
"""For 10 agents and 5000 samples; the aim is a tenth of it."""


def mission_of(
    agents: int,
    targets: int,
    threats: Sequence[tuple[float, float]] = (),
    *,
    motion: object = "static",
    losses: Sequence[tuple[int, float]] = (),
    arrival_radius_m: float = 10.0,
    separation_m: float = 5.0,
    floor_m: float | None = None,
    layers: int = 1,
    layer_spacing_m: float = 0.0,
    only_target: int | None = None,
    queue: bool = False,
) -> Any:  # noqa: ANN401  (stands in for a Mission)
    return SimpleNamespace(
        name="stand-in",
        origin=SimpleNamespace(alt_m=500.0),
        layers=layers,
        layer_spacing_m=layer_spacing_m,
        agents=tuple(
            SimpleNamespace(id=index + 1, height_m=30.0, only_target=only_target, speed_m_s=1.0, n_max=1.0)
            for index in range(agents)
        ),
        wind=SimpleNamespace(speed_m_s=0.0, gust_m_s=0.0),
        targets=tuple(SimpleNamespace(id=index + 11) for index in range(targets)),
        threats=tuple(
            SimpleNamespace(
                id=index + 21,
                detection_radius_m=detection,
                attack_radius_m=attack,
                motion=motion,
                floor_m=floor_m,
                ceiling_m=None,
            )
            for index, (detection, attack) in enumerate(threats)
        ),
        losses=tuple(SimpleNamespace(agent=agent, t_s=t_s) for agent, t_s in losses),
        arrival_radius_m=arrival_radius_m,
        separation_m=separation_m,
        queue=queue,
    )


def flown(agents: Sequence[Track], targets: Sequence[Track] = (), threats: Sequence[Track] = ()) -> Trajectory:
    """Return the trajectory of tracks sampled once a second; a track of one point stays there."""
    steps = max(len(track) for track in (*agents, *targets, *threats))
    builder = TrajectoryBuilder(range(1, len(agents) + 1), range(11, len(targets) + 11), range(21, len(threats) + 21))
    for step in range(steps):
        rows = [
            [(*track[min(step, len(track) - 1)], 0.0, 0.0) for track in tracks] for tracks in (agents, targets, threats)
        ]
        builder.append(float(step), *rows)
    return builder.build()


def test_an_agent_arrives_at_exactly_the_arrival_radius() -> None:
    found = score(flown([[(0, 0), (90, 0)]], [[(100, 0)]]), mission_of(1, 1))
    assert (found.arrived, found.targets_reached, found.targets) == (1, 1, 1)
    assert found.per_agent[0].arrived_t_s == 1.0
    assert found.per_target[0].agent_id == 1


def test_an_agent_a_millimetre_outside_the_radius_does_not_arrive() -> None:
    found = score(flown([[(0, 0), (89.999, 0)]], [[(100, 0)]]), mission_of(1, 1))
    assert (found.arrived, found.targets_reached) == (0, 0)
    assert found.per_target[0].reached_t_s is None


def test_two_agents_at_the_same_sample_both_arrive_at_one_target() -> None:
    found = score(flown([[(0, 0), (92, 0)], [(0, 50), (95, 0)]], [[(100, 0)]]), mission_of(2, 1))
    assert (found.arrived, found.targets_reached) == (2, 1)
    assert found.per_target[0].agent_id == 2


def test_an_agent_that_comes_after_the_target_was_reached_does_not_arrive() -> None:
    found = score(flown([[(0, 0), (95, 0)], [(0, 50), (0, 50), (100, 0)]], [[(100, 0)]]), mission_of(2, 1))
    assert found.arrived == 1
    assert found.per_agent[1].arrived_t_s is None


def test_an_agent_that_has_arrived_cannot_reach_another_target() -> None:
    found = score(flown([[(0, 0), (100, 0), (200, 0)]], [[(100, 0)], [(200, 0)]]), mission_of(1, 2))
    assert (found.arrived, found.targets_reached) == (1, 1)


def test_in_a_mission_with_a_queue_an_agent_reaches_one_target_after_the_other() -> None:
    tracks = [[(0, 0), (100, 0), (200, 0), (200, 50)]]
    found = score(flown(tracks, [[(100, 0)], [(200, 0)], [(300, 300)]]), mission_of(1, 3, queue=True))
    assert (found.arrived, found.targets_reached, found.targets) == (1, 2, 3)
    (agent,) = found.per_agent
    assert [one.target_id for one in agent.reached] == [11, 12]
    assert [one.t_s for one in agent.reached] == pytest.approx([0.9, 1.9])
    assert (agent.target_id, agent.arrived_t_s) == (12, agent.reached[1].t_s)
    assert (agent.path_to_end_m, agent.shortest_path_m) == pytest.approx((190.0, 190.0))
    assert [target.agent_id for target in found.per_target] == [1, 1, None]


def test_with_a_queue_the_shortest_path_leads_by_every_arrival() -> None:
    tracks = [[(0, 0), (100, 0), (0, 0), (0, 100)]]
    found = score(flown(tracks, [[(110, 0)], [(0, 110)]]), mission_of(1, 2, queue=True))
    assert found.shortest_path_m == pytest.approx((100.0 + math.hypot(100.0, 100.0),))
    assert found.per_agent[0].path_to_end_m == pytest.approx(300.0)


def test_an_agent_within_reach_of_two_targets_at_once_reaches_the_first_in_file_order() -> None:
    found = score(flown([[(0, 0), (100, 0)]], [[(105, 0)], [(100, 0)]]), mission_of(1, 2))
    assert [target.reached_t_s for target in found.per_target] == [pytest.approx(0.95), None]


def test_a_target_that_moves_is_reached_where_it_is_then() -> None:
    found = score(flown([[(0, 0), (50, 0)]], [[(500, 0), (55, 0)]]), mission_of(1, 1))
    assert found.arrived == 1


def test_a_lost_agent_does_not_arrive_from_the_sample_of_its_loss() -> None:
    run = flown([[(0, 0), (50, 0), (100, 0)]], [[(100, 0)]])
    assert score(run, mission_of(1, 1, losses=[(1, 2.0)])).arrived == 0
    assert score(run, mission_of(1, 1, losses=[(1, 2.001)])).arrived == 1


def test_an_agent_lost_after_its_arrival_has_arrived() -> None:
    found = score(flown([[(0, 0), (100, 0), (100, 0)]], [[(100, 0)]]), mission_of(1, 1, losses=[(1, 2.0)]))
    assert found.arrived == 1
    assert found.per_agent[0].lost_t_s == 2.0


def test_crossing_both_radii_twice_is_two_entries_of_each() -> None:
    track = [(-30.0, 0.0), (0.0, 0.0), (30.0, 0.0), (0.0, 1.0), (30.0, 0.0)]
    found = score(flown([track], threats=[[(0, 0)]]), mission_of(1, 0, [(20, 10)]))
    assert (found.threat_entries_detection, found.threat_entries_attack) == (2, 2)
    assert found.worst_depth_m == 20.0


def test_starting_inside_is_no_entry_but_has_a_depth() -> None:
    found = score(flown([[(5.0, 0.0), (30.0, 0.0)]], threats=[[(0, 0)]]), mission_of(1, 0, [(20, 10)]))
    assert (found.threat_entries_detection, found.threat_entries_attack, found.worst_depth_m) == (0, 0, 15.0)


def test_the_edge_of_a_radius_is_outside() -> None:
    found = score(flown([[(30.0, 0.0), (20.0, 0.0)]], threats=[[(0, 0)]]), mission_of(1, 0, [(20, 10)]))
    assert (found.threat_entries_detection, found.worst_depth_m) == (0, 0.0)


def test_a_threat_that_comes_over_an_agent_counts_as_an_entry() -> None:
    found = score(flown([[(0, 0)]], threats=[[(30, 0), (15, 0)]]), mission_of(1, 0, [(20, 10)]))
    assert (found.threat_entries_detection, found.threat_entries_attack, found.worst_depth_m) == (1, 0, 5.0)


def test_a_lost_agent_enters_nothing() -> None:
    run = flown([[(30.0, 0.0), (30.0, 0.0), (0.0, 0.0)]], threats=[[(0, 0)]])
    found = score(run, mission_of(1, 0, [(20, 10)], losses=[(1, 2.0)]))
    assert (found.threat_entries_detection, found.worst_depth_m) == (0, 0.0)


def test_an_agent_that_has_arrived_still_enters() -> None:
    run = flown([[(100.0, 0.0), (0.0, 0.0)]], [[(100, 0)]], [[(0, 0)]])
    assert score(run, mission_of(1, 1, [(20, 10)])).threat_entries_detection == 1


def test_the_path_counts_to_the_loss_and_the_path_to_the_end_without_the_loiter() -> None:
    track = [(0.0, 0.0), (30.0, 40.0), (30.0, 60.0), (30.0, 90.0)]
    arrived = score(flown([track], [[(30, 40)]]), mission_of(1, 1)).per_agent[0]
    assert (arrived.path_length_m, arrived.path_to_end_m) == pytest.approx((100.0, 40.0))
    lost = score(flown([track]), mission_of(1, 0, losses=[(1, 2.5)])).per_agent[0]
    assert (lost.path_length_m, lost.path_to_end_m, lost.end_ned_m) == (70.0, 70.0, (30.0, 60.0))


def test_an_agent_lost_from_the_start_flew_nothing() -> None:
    found = score(flown([[(0, 0), (50, 0)]]), mission_of(1, 0, losses=[(1, 0.0)]))
    assert (found.path_length_m, found.shortest_path_m, found.per_agent[0].end_ned_m) == ((0.0,), (0.0,), None)


def test_the_shortest_path_goes_around_static_detection_discs_to_the_arrival() -> None:
    run = flown([[(0.0, 0.0), (50.0, 30.0), (100.0, 0.0)]], [[(100, 0)]], [[(50, 0)]])
    expected = 2 * math.sqrt(50**2 - 20**2) + 20 * (math.pi - 2 * math.acos(20 / 50))
    arrival = mission_of(1, 1, [(20, 10)], arrival_radius_m=1e-3)
    assert score(run, arrival).shortest_path_m[0] == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("motion", ["random", SimpleNamespace(heading_deg=0.0, speed_m_s=1.0)])
def test_the_shortest_path_leaves_out_threats_that_move(motion: object) -> None:
    run = flown([[(0.0, 0.0), (100.0, 0.0)]], [[(100, 0)]], [[(50, 0)]])
    assert score(run, mission_of(1, 1, [(20, 10)], motion=motion)).shortest_path_m == pytest.approx((90.0,))


@pytest.mark.parametrize("centre", [(5.0, 5.0), (95.0, 5.0)])
def test_the_shortest_path_leaves_out_a_disc_that_contains_either_end(centre: tuple[float, float]) -> None:
    run = flown([[(0.0, 0.0), (100.0, 0.0)]], [[(100, 0)]], [[centre]])
    assert score(run, mission_of(1, 1, [(20, 10)])).shortest_path_m == pytest.approx((90.0,))


def test_separation_is_seen_between_samples() -> None:
    found = score(flown([[(0.0, 0.0), (100.0, 0.0)], [(100.0, 3.0), (0.0, 3.0)]]), mission_of(2, 0))
    assert (found.min_separation_m, found.separation_breaches) == (3.0, 1)


def test_a_lasting_approach_is_one_breach_and_coming_back_is_another() -> None:
    other = [(100.0, 0.0), (3.0, 0.0), (2.0, 0.0), (3.0, 0.0), (100.0, 0.0), (100.0, 0.0), (4.0, 0.0), (100.0, 0.0)]
    found = score(flown([[(0.0, 0.0)], other]), mission_of(2, 0))
    assert (found.separation_breaches, found.min_separation_m) == (2, 2.0)


def test_exactly_the_required_separation_is_no_breach() -> None:
    found = score(flown([[(0.0, 0.0)], [(100.0, 0.0), (5.0, 0.0)]]), mission_of(2, 0))
    assert (found.separation_breaches, found.min_separation_m) == (0, 5.0)


def test_a_lost_agent_comes_near_nobody() -> None:
    run = flown([[(0.0, 0.0)], [(100.0, 0.0), (50.0, 0.0), (0.0, 0.0)]])
    found = score(run, mission_of(2, 0, losses=[(2, 2.0)]))
    assert (found.separation_breaches, found.min_separation_m) == (0, 50.0)


def test_one_agent_has_no_separation() -> None:
    assert score(flown([[(0.0, 0.0), (1.0, 0.0)]]), mission_of(1, 0)).min_separation_m is None


def test_a_breach_that_spans_the_pieces_of_a_long_run_is_counted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    run = flown([[(0.0, 0.0)], [(3.0, 0.0)] * 20], threats=[[(100.0, 0.0)] * 9 + [(5.0, 0.0)] * 11])
    whole = score(run, mission_of(2, 0, [(20, 10)]))
    monkeypatch.setattr("sim.approaches._CHUNK_CELLS", 3)
    pieces = score(run, mission_of(2, 0, [(20, 10)]))
    assert pieces.separation_breaches == 1
    assert pieces == whole


def test_the_flight_time_is_from_the_first_sample_to_the_last() -> None:
    builder = TrajectoryBuilder([1], [], [])
    for t_s in (2.5, 3.0, 9.25):
        builder.append(t_s, [(0, 0, 0, 0)], [], [])
    assert score(builder.build(), mission_of(1, 0)).flight_time_s == 6.75


def test_the_history_holds_the_least_clearance_and_separation() -> None:
    run = flown([[(0.0, 0.0)], [(30.0, 0.0), (8.0, 0.0), (50.0, 0.0)]], threats=[[(-25, 0)]])
    found = score(run, mission_of(2, 0, [(20, 10)], losses=[(1, 2.0)]))
    assert found.history.clearance_m.tolist() == [5.0, 5.0, pytest.approx(13.0)]
    np.testing.assert_array_equal(found.history.separation_m, [30.0, 8.0, np.nan])


def test_a_trajectory_of_another_mission_is_refused() -> None:
    with pytest.raises(ValueError, match="agents"):
        score(flown([[(0, 0)]]), mission_of(2, 0))


def test_the_figures_are_json_under_the_names_of_the_result_file() -> None:
    found = score(flown([[(0, 0), (90, 0)]], [[(100, 0)]], [[(0, 50)]]), mission_of(1, 1, [(20, 10)])).to_dict()
    assert list(found) == [
        "arrived",
        "targets_reached",
        "targets",
        "flight_time_s",
        "path_length_m",
        "shortest_path_m",
        "threat_entries_detection",
        "threat_entries_attack",
        "worst_depth_m",
        "separation_breaches",
        "min_separation_m",
    ]
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_a_shortest_path_with_no_way_becomes_null_in_the_result_file() -> None:
    ring = [[(50 * math.cos(angle), 50 * math.sin(angle))] for angle in np.arange(8) * math.tau / 8]
    run = flown([[(0.0, 0.0), (200.0, 0.0)]], threats=ring)
    assert score(run, mission_of(1, 0, [(20, 10)] * 8)).to_dict()["shortest_path_m"] == [None]


def test_five_thousand_samples_of_ten_agents_are_scored_in_time() -> None:
    walk = np.cumsum(np.random.default_rng(1).normal(0, 30, (5_000, 19, 2)), axis=0)
    tracks = [[tuple(point) for point in walk[:, index]] for index in range(19)]
    run = flown(tracks[:10], tracks[10:15], tracks[15:])
    mission = mission_of(10, 5, [(1_000, 500)] * 4, motion="random")
    begin_s = time.perf_counter()
    score(run, mission)
    assert time.perf_counter() - begin_s < SCORE_LIMIT_S


def closest_of(gap0: complex, gap1: complex) -> float:
    """Return the closest approach of two straight moves; complex numbers make it short to write."""
    move = gap1 - gap0
    when = -(gap0 * move.conjugate()).real / abs(move) ** 2 if move else 0.0
    return abs(gap0 + min(max(when, 0.0), 1.0) * move)


def by_plain_loops(path: Path, mission: Any) -> dict[str, Any]:  # noqa: ANN401
    """Return the figures from the file alone, one row at a time."""
    samples: list[tuple[float, dict[tuple[str, int], tuple[float, float]]]] = []
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            t_s = float(row["t_s"])
            if not samples or samples[-1][0] != t_s:
                samples.append((t_s, {}))
            samples[-1][1][row["kind"], int(row["id"])] = (float(row["north_m"]), float(row["east_m"]))
    lost_s = {loss.agent: loss.t_s for loss in mission.losses}
    agents = [agent.id for agent in mission.agents]

    def alive(agent: int, sample: int) -> bool:
        return bool(samples[sample][0] < lost_s.get(agent, math.inf))

    def at(kind: str, identity: int, sample: int) -> tuple[float, float]:
        return samples[sample][1][kind, identity]

    def gap_of(agent: int, kind: str, identity: int, sample: int) -> complex:
        return complex(*at("agent", agent, sample)) - complex(*at(kind, identity, sample))

    def passing_m(agent: int, kind: str, identity: int, sample: int) -> float:
        return closest_of(gap_of(agent, kind, identity, max(sample - 1, 0)), gap_of(agent, kind, identity, sample))

    arrived: dict[int, int] = {}
    reached: dict[int, int] = {}
    for sample in range(len(samples)):
        for target in mission.targets:
            if target.id in reached:
                continue
            for agent in agents:
                gap = passing_m(agent, "target", target.id, sample)
                if agent not in arrived and alive(agent, sample) and gap <= mission.arrival_radius_m:
                    arrived[agent] = sample
                    reached[target.id] = sample
    entries = {"detection_radius_m": 0, "attack_radius_m": 0}
    depth = 0.0
    for agent in agents:
        for threat in mission.threats:
            for sample in range(len(samples)):
                if not alive(agent, sample):
                    break
                gap = math.dist(at("agent", agent, sample), at("threat", threat.id, sample))
                closest = passing_m(agent, "threat", threat.id, sample)
                depth = max(depth, threat.detection_radius_m - gap)
                if sample == 0:
                    continue
                before = math.dist(at("agent", agent, sample - 1), at("threat", threat.id, sample - 1))
                if min(before, gap) < threat.detection_radius_m or closest < threat.detection_radius_m - ROUNDING_M:
                    depth = max(depth, threat.detection_radius_m - closest)
                for name in entries:
                    radius = getattr(threat, name)
                    entries[name] += before >= radius and (gap < radius or closest < radius - ROUNDING_M)
    lengths = [
        sum(
            math.dist(at("agent", agent, sample - 1), at("agent", agent, sample))
            for sample in range(1, len(samples))
            if alive(agent, sample)
        )
        for agent in agents
    ]
    nearest, breaches = math.inf, 0
    for first in agents:
        for second in agents:
            if first >= second:
                continue
            near_before = False
            for sample in range(len(samples)):
                if not (alive(first, sample) and alive(second, sample)):
                    break
                closest = passing_m(first, "agent", second, sample)
                nearest = min(nearest, closest)
                if sample == 0:
                    continue
                near = closest < mission.separation_m
                breaches += near and not near_before
                near_before = near
    return {
        "arrived": len(arrived),
        "targets_reached": len(reached),
        "targets": len(mission.targets),
        "flight_time_s": samples[-1][0] - samples[0][0],
        "path_length_m": lengths,
        "threat_entries_detection": entries["detection_radius_m"],
        "threat_entries_attack": entries["attack_radius_m"],
        "worst_depth_m": depth,
        "separation_breaches": breaches,
        "min_separation_m": None if math.isinf(nearest) else nearest,
    }


@pytest.mark.slow
@settings(max_examples=120)
@given(
    agents=st.integers(1, 4),
    targets=st.integers(0, 3),
    threats=st.integers(0, 3),
    steps=st.integers(1, 25),
    losses=st.dictionaries(st.integers(1, 4), st.integers(0, 60).map(lambda value: value / 2), max_size=3),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_score_equals_plain_loops_over_the_file(
    agents: int, targets: int, threats: int, steps: int, losses: dict[int, float], seed: int
) -> None:
    generator = np.random.default_rng(seed)
    walk = generator.uniform(-60, 60, (1, agents + targets + threats, 2)) + np.cumsum(
        generator.normal(0, 8, (steps, agents + targets + threats, 2)), axis=0
    )
    builder = TrajectoryBuilder(range(1, agents + 1), range(11, targets + 11), range(21, threats + 21))
    for step in range(steps):
        rows = np.pad(walk[step], ((0, 0), (0, 2)))
        builder.append(step * 1.0, rows[:agents], rows[agents : agents + targets], rows[agents + targets :])
    mission = mission_of(
        agents,
        targets,
        [(25, 12)] * threats,
        motion="random",
        losses=[(agent, t_s) for agent, t_s in losses.items() if agent <= agents],
        arrival_radius_m=8.0,
        separation_m=15.0,
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trajectory.csv"
        builder.build().write_csv(path)
        found: Score = score(read_csv(path), mission)
        expected = by_plain_loops(path, mission)
    for name, value in expected.items():
        assert found.to_dict()[name] == pytest.approx(value, abs=2e-6), name


def test_a_threat_above_the_agents_height_is_not_entered() -> None:
    across = [[(0, 0), (50, 0), (100, 0)]]
    above = score(flown(across, [[(100, 0)]], [[(50, 0)]]), mission_of(1, 1, [(20.0, 10.0)], floor_m=531.0))
    assert (above.threat_entries_detection, above.worst_depth_m) == (0, 0.0)
    assert above.shortest_path_m == pytest.approx((90.0,))
    level = score(flown(across, [[(100, 0)]], [[(50, 0)]]), mission_of(1, 1, [(20.0, 10.0)], floor_m=530.0))
    assert level.threat_entries_detection == 1


def test_agents_on_different_layers_keep_apart_by_their_heights() -> None:
    crossing = flown([[(0, 0), (10, 0)], [(10, 0), (0, 0)]])
    assert score(crossing, mission_of(2, 0)).separation_breaches == 1
    layered = score(crossing, mission_of(2, 0, layers=2, layer_spacing_m=30.0))
    assert layered.separation_breaches == 0
    assert layered.min_separation_m is None


def test_an_agent_that_is_kept_for_a_target_arrives_only_there() -> None:
    run = flown([[(0, 0), (100, 0), (200, 0)]], [[(100, 0)], [(200, 0)]])
    kept = score(run, mission_of(1, 2, only_target=12))
    assert kept.per_agent[0].target_id == 12
    assert [target.reached_t_s for target in kept.per_target] == [None, pytest.approx(1.9)]


# Things that are added, moved and retired in flight


def changing_mission(**update: object) -> Mission:
    text = """
agents: [{id: 1, north_m: 0, east_m: 0, speed_m_s: 10}, {id: 2, north_m: 0, east_m: 5000, speed_m_s: 10}]
targets: [{id: 1, north_m: 1000, east_m: 0}]
threats: [{id: 1, north_m: 500, east_m: 300, detection_radius_m: 100, attack_radius_m: 50}]
arrival_radius_m: 10
queue: true
"""
    return resolve(parse_mission(text, "test"), 1).model_copy(update=update)


def flown_north(changes: Sequence[Change], metres: int = 1_000) -> Score:
    """Return the score of a flight straight north at 10 m/s, in which things changed."""
    builder = TrajectoryBuilder([1, 2], [1], [1])
    for step in range(metres // 10 + 1):
        mission = [change.mission for change in changes if change.t_s <= step][-1]
        builder.follow([one.id for one in mission.targets], [one.id for one in mission.threats])
        rows = [[(*one.position_ned_m, 0.0, 0.0) for one in things] for things in (mission.targets, mission.threats)]
        builder.append(float(step), [(10.0 * step, 0.0, 0.0, 10.0), (0.0, 5_000.0, 0.0, 0.0)], *rows)
    return score(builder.build(), with_all_things(changes), changes)


def threat_at(north_m: float, east_m: float, identity: int = 2, radius_m: float = 100.0) -> ThreatSpec:
    return ThreatSpec(
        id=identity, north_m=north_m, east_m=east_m, detection_radius_m=radius_m, attack_radius_m=radius_m / 2.0
    )


def test_a_threat_that_is_added_ahead_of_an_agent_is_entered_and_one_that_is_added_upon_it_is_not() -> None:
    start = changing_mission()
    ahead = [Change(0.0, start), Change(20.0, changing_mission(threats=(*start.threats, threat_at(400.0, 0.0))))]
    found = flown_north(ahead)
    assert (found.threat_entries_detection, found.threat_entries_attack) == (1, 1)
    assert found.worst_depth_m == pytest.approx(100.0, abs=0.1)
    upon = [Change(0.0, start), Change(20.0, changing_mission(threats=(*start.threats, threat_at(200.0, 0.0))))]
    found = flown_north(upon)
    assert (found.threat_entries_detection, found.threat_entries_attack) == (0, 0)
    assert found.worst_depth_m == pytest.approx(100.0, abs=0.1)


def test_a_threat_counts_only_until_it_is_retired() -> None:
    start = changing_mission(threats=(threat_at(400.0, 0.0, identity=1),))
    found = flown_north([Change(0.0, start), Change(20.0, changing_mission(threats=()))])
    assert (found.threat_entries_detection, found.worst_depth_m) == (0, 0.0)
    nearest = found.per_agent[0].nearest_detection
    assert nearest is not None
    assert nearest.distance_m == pytest.approx(110.0)
    assert nearest.t_s == 19.0


def test_a_threat_that_jumps_over_an_agent_or_grows_onto_it_was_not_flown_into() -> None:
    start = changing_mission(threats=(threat_at(450.0, -300.0, identity=1),))
    jumped = changing_mission(threats=(threat_at(450.0, 300.0, identity=1),))
    found = flown_north([Change(0.0, start), Change(45.0, jumped)])
    assert (found.threat_entries_detection, found.worst_depth_m) == (0, 0.0)
    grown = changing_mission(threats=(threat_at(450.0, -300.0, identity=1, radius_m=400.0),))
    found = flown_north([Change(0.0, start), Change(45.0, grown)])
    assert found.threat_entries_detection == 0
    assert found.worst_depth_m == pytest.approx(100.0)


def test_a_target_that_is_added_is_reached_and_one_that_is_retired_unreached_does_not_count() -> None:
    start = changing_mission()
    (target,) = start.targets
    second = target.model_copy(update={"id": 2, "north_m": 600.0})
    found = flown_north(
        [
            Change(0.0, start),
            Change(20.0, changing_mission(targets=(target, second))),
            Change(80.0, changing_mission(targets=(second,))),
        ]
    )
    assert (found.targets_reached, found.targets) == (1, 1)
    assert [one.target_id for one in found.per_agent[0].reached] == [2]
    assert [one.retired_t_s for one in found.per_target] == [80.0, None]
