"""Ways around threats: no pair counts less than its path, and the assignment is the best there is by all paths."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.guidance.route.router import Reach, shortest_route
from groundstation.assignment import assign, assign_least_latest, within_range
from groundstation.route_cost import (
    UNREACHED_PENALTY,
    AssignmentRule,
    RouteCosts,
    RouteObjective,
    Scene,
    assign_by_route_cost,
)

OBJECTIVES: tuple[RouteObjective, ...] = ("route", "latest")
Points = list[tuple[float, float]]


def scene_of(
    agents: Points,
    targets: Points,
    discs: list[tuple[float, float, float]],
    heading_rad: float = math.nan,
    turn_radius_m: float = 0.0,
) -> Scene:
    rows = np.array(discs, dtype=float).reshape(-1, 3)
    return Scene(
        np.array(agents, dtype=float).reshape(-1, 2),
        np.full(len(agents), heading_rad),
        np.full(len(agents), turn_radius_m),
        np.array(targets, dtype=float).reshape(-1, 2),
        rows[:, :2],
        rows[:, 2],
        np.ones((len(agents), len(rows)), dtype=bool),
    )


def unlimited(there_m: np.ndarray) -> np.ndarray:
    return np.ones(there_m.shape, dtype=bool)


def assigned(
    scene: Scene,
    objective: RouteObjective = "route",
    present: list[int] | None = None,
    share: float = 0.0,
    speeds_m_s: float | list[float] = 20.0,
) -> list[int]:
    count = len(scene.agents_ned_m)
    speeds = np.broadcast_to(np.array(speeds_m_s), (count,))
    held = np.full(count, -1) if present is None else np.array(present)
    found = assign_by_route_cost(RouteCosts(scene), speeds, AssignmentRule(objective, share), unlimited, held)
    return [int(target) for target in found]


def all_searched(scene: Scene) -> RouteCosts:
    costs = RouteCosts(scene)
    for pair in np.ndindex(costs.known.shape):
        costs.search(*pair)
    return costs


@st.composite
def scenes(draw: st.DrawFn, least_agents: int = 1) -> Scene:
    """Draw up to 4 agents with headings and turning circles, up to 3 targets and 7 discs, anything inside anything."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    n, k, m = draw(st.integers(least_agents, 4)), draw(st.integers(1, 3)), draw(st.integers(0, 7))
    return Scene(
        rng.uniform(0.0, 10_000.0, (n, 2)),
        np.where(rng.random(n) < 0.2, math.nan, rng.uniform(-math.pi, math.pi, n)),
        rng.choice([0.0, 100.0, 600.0], n),
        rng.uniform(0.0, 10_000.0, (k, 2)),
        rng.uniform(0.0, 10_000.0, (m, 2)),
        rng.uniform(200.0, 2_500.0, m),
        rng.random((n, m)) < 0.9,
    )


# Single ways


@settings(max_examples=60)
@given(scene=scenes())
def test_what_is_known_without_a_search_is_the_length_of_the_path_and_the_rest_is_no_longer_than_it(
    scene: Scene,
) -> None:
    costs, searched = RouteCosts(scene), all_searched(scene)
    assert costs.searched == 0
    for agent, target in np.argwhere(costs.known):
        there, heading_rad = scene.obstructs[agent], scene.headings_rad[agent]
        route = shortest_route(
            scene.agents_ned_m[agent],
            scene.targets_ned_m[target],
            scene.centres_ned_m[there],
            scene.radii_m[there],
            None if math.isnan(heading_rad) else heading_rad,
            scene.turn_radii_m[agent],
        )
        assert route.reach is Reach.TARGET
        assert costs.length_m[agent, target] == pytest.approx(route.length_m, rel=1e-9)
    assert np.all(costs.cost_m <= searched.cost_m * (1.0 + 1e-9))


@settings(max_examples=30)
@given(scene=scenes())
def test_where_nothing_is_in_the_way_every_way_is_known_but_to_what_is_inside_a_turning_circle(scene: Scene) -> None:
    bare = replace(scene, obstructs=np.zeros_like(scene.obstructs))
    apart_m = np.hypot(*(scene.agents_ned_m[:, np.newaxis] - scene.targets_ned_m).transpose(2, 0, 1))
    assert RouteCosts(bare).known[apart_m >= 2.0 * scene.turn_radii_m[:, np.newaxis]].all()


def test_a_target_abeam_costs_a_quarter_turn_and_the_line_that_leaves_it() -> None:
    costs = RouteCosts(scene_of([(0.0, 0.0)], [(100.0, 1_100.0), (100.0, -1_100.0)], [], 0.0, 100.0))
    assert costs.length_m[0] == pytest.approx(50.0 * math.pi + 1_000.0)
    assert costs.known.all()


def test_a_disc_on_the_arc_alone_is_in_the_way() -> None:
    # Half a turn to the right and back south; the disc is a quarter of the way round.
    scene = scene_of([(0.0, 0.0)], [(-5_000.0, 2_000.0)], [(1_000.0, 1_000.0, 100.0)], 0.0, 1_000.0)
    costs, bare = RouteCosts(scene), RouteCosts(replace(scene, obstructs=np.zeros((1, 1), dtype=bool)))
    assert bare.length_m[0, 0] == pytest.approx(1_000.0 * math.pi + 5_000.0)
    assert bare.known[0, 0]
    assert not costs.known[0, 0]


def test_a_target_inside_the_turning_circle_is_searched_for() -> None:
    costs = RouteCosts(scene_of([(0.0, 0.0)], [(0.0, 100.0)], [], 0.0, 100.0))
    assert (costs.known[0, 0], costs.length_m[0, 0]) == (False, 100.0)
    costs.search(0, 0)
    assert costs.length_m[0, 0] > 200.0


def test_around_one_disc_the_bound_is_the_way_itself() -> None:
    costs = RouteCosts(scene_of([(0.0, -5_000.0)], [(0.0, 5_000.0)], [(0.0, 0.0, 3_000.0)]))
    assert not costs.known[0, 0]
    arc_rad = math.pi - 2.0 * math.acos(0.6)
    assert costs.length_m[0, 0] == pytest.approx(2.0 * 4_000.0 + 3_000.0 * arc_rad)
    bound_m = costs.length_m[0, 0]
    costs.search(0, 0)
    assert costs.length_m[0, 0] == pytest.approx(bound_m)


def test_a_target_inside_a_disc_costs_the_way_to_its_edge_and_the_rest_many_times() -> None:
    costs = RouteCosts(scene_of([(0.0, -5_000.0)], [(0.0, -500.0)], [(0.0, 0.0, 2_000.0)]))
    costs.search(0, 0)
    assert (costs.length_m[0, 0], costs.rest_m[0, 0]) == pytest.approx((3_000.0, 1_500.0))
    assert costs.blocked[0, 0]
    assert costs.cost_m[0, 0] == pytest.approx(3_000.0 + UNREACHED_PENALTY * 1_500.0)


RING = [(2_000.0 * math.cos(k * math.pi / 6), 2_000.0 * math.sin(k * math.pi / 6), 700.0) for k in range(12)]


def test_an_agent_that_is_walled_in_beside_its_wall_has_no_way_but_a_cost() -> None:
    start = (1_299.0, 0.0)
    assert shortest_route(start, (9_000.0, 0.0), np.array(RING)[:, :2], np.array(RING)[:, 2]).reach is not Reach.TARGET
    costs = RouteCosts(scene_of([start], [(9_000.0, 0.0)], RING))
    costs.search(0, 0)
    assert costs.blocked[0, 0]
    assert math.isfinite(costs.cost_m[0, 0])
    assert costs.length_m[0, 0] + costs.rest_m[0, 0] >= 7_700.0


# Assignments


def best_total(
    table: RouteCosts, share: float, present: np.ndarray, speeds_m_s: np.ndarray, latest: bool
) -> tuple[float, ...]:
    """Return the least (blocked pairs, latest arrival if that counts, total), by trying every assignment."""
    return min(worth(table, way, share, present, speeds_m_s, latest) for way in every(table.known.shape))


def every(shape: tuple[int, ...]) -> list[tuple[int, ...]]:
    n, k = shape
    copies = [column % k for column in range(max(n, k))]
    return sorted(set(itertools.permutations(copies, n)))


def worth(
    table: RouteCosts, way: tuple[int, ...], share: float, present: np.ndarray, speeds_m_s: np.ndarray, latest: bool
) -> tuple[float, ...]:
    cost = table.cost_m / (speeds_m_s[:, np.newaxis] if latest else 1.0)
    pairs = list(enumerate(way))
    free = [cost[pair] for pair in pairs if not table.blocked[pair]]
    total = sum(cost[pair] * (1.0 - share * (present[pair[0]] == pair[1])) for pair in pairs)
    late = (max(free, default=0.0),) if latest else ()
    return (float(sum(table.blocked[pair] for pair in pairs)), *map(float, late), float(total))


@pytest.mark.parametrize("objective", OBJECTIVES)
@settings(max_examples=40)
@given(scene=scenes(), seed=st.integers(0, 99))
def test_by_all_paths_no_other_assignment_is_better(objective: RouteObjective, scene: Scene, seed: int) -> None:
    rng, searched = np.random.default_rng(seed), all_searched(scene)
    speeds_m_s = rng.uniform(10.0, 30.0, len(scene.agents_ned_m))
    latest, share = objective == "latest", 0.0
    present = np.array(every(searched.known.shape)[0])
    chosen = tuple(assigned(scene, objective, present.tolist(), share, speeds_m_s.tolist()))
    ours = worth(searched, chosen, share, present, speeds_m_s, latest)
    assert ours == pytest.approx(best_total(searched, share, present, speeds_m_s, latest), rel=1e-9)


@settings(max_examples=25)
@given(scene=scenes(least_agents=2), data=st.data())
def test_by_all_paths_agents_change_only_where_they_save_more_than_the_share(scene: Scene, data: st.DataObject) -> None:
    searched, share = all_searched(scene), 0.1
    present = np.array(data.draw(st.sampled_from(every(searched.known.shape))))
    speeds_m_s = np.full(len(present), 20.0)
    ours = worth(searched, tuple(assigned(scene, "route", present.tolist(), share)), share, present, speeds_m_s, False)
    assert ours == pytest.approx(best_total(searched, share, present, speeds_m_s, False), rel=1e-9)


@pytest.mark.slow
@settings(max_examples=80)
@given(scene=scenes(least_agents=3), data=st.data())
def test_the_latest_arrival_stands_or_falls_as_it_does_by_all_paths(scene: Scene, data: st.DataObject) -> None:
    searched, share = all_searched(scene), 0.1
    present = np.array(data.draw(st.sampled_from(every(searched.known.shape))))
    speeds_m_s = np.full(len(present), 20.0)
    expected = assign_least_latest(searched.cost_m / 20.0, None, searched.blocked, present, share)
    assert worth(
        searched, tuple(assigned(scene, "latest", present.tolist(), share)), share, present, speeds_m_s, True
    ) == pytest.approx(worth(searched, tuple(expected.tolist()), share, present, speeds_m_s, True), rel=1e-9)


def test_the_present_latest_arrival_is_that_of_its_paths_and_not_of_what_they_cannot_be_shorter_than() -> None:
    agents = [(3_379.0, 4_585.0), (9_350.0, 9_468.0), (968.0, 9.0), (4_533.0, 9_083.0)]
    discs = [
        (7_874.0, 4_147.0, 2_209.0),
        (2_006.0, 2_262.0, 1_020.0),
        (2_173.0, 5_488.0, 2_431.0),
        (5_453.0, 2_611.0, 2_420.0),
        (6_071.0, 2_959.0, 931.0),
        (4_458.0, 4_003.0, 656.0),
    ]
    scene, present = scene_of(agents, [(8_106.0, 9_044.0), (8_129.0, 1_628.0)], discs), [1, 1, 0, 0]
    searched = all_searched(scene)
    expected = assign_least_latest(searched.cost_m / 20.0, None, searched.blocked, np.array(present), 0.3)
    assert assigned(scene, "latest", present, 0.3) == expected.tolist()


WALL = [(float(north), 0.0, 1_500.0) for north in range(-8_000, 8_001, 2_000)]
BEHIND = scene_of([(0.0, -2_000.0), (12_000.0, 0.0)], [(0.0, 2_000.0), (7_000.0, -4_500.0)], WALL)


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_nobody_is_sent_to_the_far_side_of_a_wall_when_a_swap_is_cheaper(objective: RouteObjective) -> None:
    """The first target is nearest to the first agent, straight through the wall that the second is at the end of."""
    assert assign(BEHIND.agents_ned_m, BEHIND.targets_ned_m, "distance").tolist() == [0, 1]
    assert assigned(BEHIND, objective) == [1, 0]
    bare = replace(BEHIND, obstructs=np.zeros_like(BEHIND.obstructs))
    assert assigned(bare, "route") == [0, 1]


def test_a_threat_that_does_not_reach_an_agents_height_is_not_in_its_way() -> None:
    above = BEHIND.obstructs.copy()
    above[0] = False
    assert assigned(replace(BEHIND, obstructs=above)) == [0, 1]


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_a_target_that_cannot_be_reached_is_never_preferred_to_one_that_can(objective: RouteObjective) -> None:
    """The first agent is walled in with the first target: the second goes where only it can, however far that is."""
    scene = scene_of([(0.0, 0.0), (0.0, 3_000.0)], [(0.0, 900.0), (50_000.0, 0.0)], RING)
    assert assigned(scene, objective) == [0, 1]
    assert assigned(scene, objective, present=[1, 0], share=0.5) == [0, 1]


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_a_target_inside_a_disc_is_covered_all_the_same(objective: RouteObjective) -> None:
    scene = scene_of([(0.0, 0.0), (0.0, 500.0)], [(0.0, 20_000.0), (0.0, 9_000.0)], [(0.0, 9_000.0, 3_000.0)])
    assert sorted(assigned(scene, objective)) == [0, 1]


def test_the_latest_arrival_is_a_matter_of_time_and_not_of_length() -> None:
    scene = scene_of([(0.0, 0.0), (1_000.0, 0.0)], [(5_000.0, 0.0), (9_000.0, 0.0)], [])
    assert assigned(scene, "latest", speeds_m_s=[40.0, 10.0]) == [1, 0]
    assert assigned(scene, "latest", speeds_m_s=[10.0, 40.0]) == [0, 1]
    assert assigned(scene, "route", speeds_m_s=[40.0, 10.0]) == assigned(scene, "route", speeds_m_s=[10.0, 40.0])


def test_the_least_latest_arrival_is_not_the_least_total() -> None:
    # Both to their own: 1 + 8062 m. Crossed: 4000 + 5000 m, more together but sooner done.
    scene = scene_of([(0.0, 0.0), (3_000.0, 4_000.0)], [(0.0, 1.0), (-4_000.0, 0.0)], [])
    assert assigned(scene, "route") == [0, 1]
    assert assigned(scene, "latest") == [1, 0]


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_agents_that_tremble_do_not_swap_back_and_forth(objective: RouteObjective) -> None:
    rng = np.random.default_rng(3)
    changes = {0.0: 0, 0.02: 0}
    for share in changes:
        # Two agents abreast, a disc between them and two targets abreast: a swap costs hardly anything.
        present = None
        for _ in range(20):
            shaken = rng.uniform(-10.0, 10.0, (2, 2))
            scene = scene_of([(0.0, 0.0), (1.0, 0.0)], [(0.0, 9_000.0), (1.0, 9_000.0)], [(0.0, 5_000.0, 1_000.0)])
            chosen = assigned(replace(scene, agents_ned_m=scene.agents_ned_m + shaken), objective, present, share)
            changes[share] += present is not None and chosen != present
            present = chosen
    assert changes[0.02] == 0 < changes[0.0]


def test_the_range_is_that_of_the_way_and_not_of_the_line() -> None:
    scene = scene_of([(0.0, -5_000.0)], [(0.0, 5_000.0)], [(0.0, 0.0, 3_000.0)])

    def sent(left_m: float) -> list[int]:
        def in_range(there_m: np.ndarray) -> np.ndarray:
            return within_range(scene.agents_ned_m, scene.targets_ned_m, np.array([left_m]), None, 1.1, there_m)

        rule = AssignmentRule("route", 0.0)
        found = assign_by_route_cost(RouteCosts(scene), np.array([20.0]), rule, in_range, np.array([-1]))
        return [int(target) for target in found]

    length_m = 8_000.0 + 3_000.0 * (math.pi - 2.0 * math.acos(0.6))
    assert (sent(length_m - 1.0), sent(length_m + 1.0)) == ([-1], [0])


def test_no_more_paths_are_searched_than_allowed_and_all_targets_are_covered_all_the_same() -> None:
    rng = np.random.default_rng(1)
    discs = [(*rng.uniform(0.0, 10_000.0, 2), 1_000.0) for _ in range(15)]
    scene = scene_of(rng.uniform(0.0, 10_000.0, (8, 2)).tolist(), rng.uniform(0.0, 10_000.0, (4, 2)).tolist(), discs)
    for most in (0, 3):
        costs = RouteCosts(scene)
        chosen = assign_by_route_cost(
            costs, np.full(8, 20.0), AssignmentRule("latest", 0.0, most), unlimited, np.full(8, -1)
        )
        assert costs.searched == most
        assert np.bincount(chosen).tolist() == [2, 2, 2, 2]


def test_only_pairs_that_an_assignment_would_use_are_searched() -> None:
    """Twenty agents beside a target each, a wall between every other pair: nothing is worth a search."""
    agents = [(2_000.0 * k, 0.0) for k in range(20)]
    discs = [(2_000.0 * k + 1_000.0, 500.0, 400.0) for k in range(19)]
    costs = RouteCosts(scene_of(agents, [(north, 1_000.0) for north, _ in agents], discs))
    assert not costs.known.all()
    chosen = assign_by_route_cost(costs, np.full(20, 20.0), AssignmentRule("route", 0.0), unlimited, np.full(20, -1))
    assert chosen.tolist() == list(range(20))
    assert costs.searched == 0


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_nobody_and_nowhere_give_no_assignment(objective: RouteObjective) -> None:
    assert assigned(scene_of([], [(1.0, 1.0)], RING), objective) == []
    assert assigned(scene_of([(1.0, 1.0)], [], RING), objective) == [-1]
