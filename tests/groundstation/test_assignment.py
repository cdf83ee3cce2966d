"""Who goes where: every target covered while there are agents in range of it, and nobody could do better."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from groundstation.assignment import (
    CLOSEST_M,
    OBJECTIVES,
    Objective,
    assign,
    assign_least_latest,
    assign_least_total,
    within_range,
)

Points = list[tuple[float, float]]
Table = list[list[bool]]
# Whole metres: distances then differ by more than rounding, or not at all.
points = st.tuples(st.integers(-1_000, 1_000), st.integers(-1_000, 1_000)).map(lambda p: (float(p[0]), float(p[1])))


def assigned(
    agents: Points, targets: Points, objective: Objective = "distance", reachable: Table | None = None
) -> list[int]:
    table = None if reachable is None else np.array(reachable, dtype=bool).reshape(len(agents), len(targets))
    found = assign(np.array(agents).reshape(-1, 2), np.array(targets).reshape(-1, 2), objective, table)
    return [int(target) for target in found]


def worth(agents: Points, targets: Points, chosen: tuple[int, ...] | list[int], objective: Objective) -> float:
    """Return what the objective makes as great as it can."""
    distances_m = [
        max(math.dist(agent, targets[k]), CLOSEST_M) for agent, k in zip(agents, chosen, strict=True) if k >= 0
    ]
    return -sum(distances_m) if objective == "distance" else sum(1.0 / distance_m for distance_m in distances_m)


def allowed(number_of_agents: int, number_of_targets: int) -> list[tuple[int, ...]]:
    """Return every way of giving the agents targets copied in turn; one each if there are fewer agents."""
    copies = [k % number_of_targets for k in range(max(number_of_agents, number_of_targets))]
    return sorted(set(itertools.permutations(copies, number_of_agents)))


@pytest.mark.slow
@pytest.mark.parametrize("objective", OBJECTIVES)
@given(data=st.data(), number_of_targets=st.integers(1, 8), more=st.integers(0, 10))
def test_targets_are_copied_in_turn_so_that_each_has_an_agent(
    objective: Objective, data: st.DataObject, number_of_targets: int, more: int
) -> None:
    number_of_agents = number_of_targets + more
    agents = data.draw(st.lists(points, min_size=number_of_agents, max_size=number_of_agents))
    targets = data.draw(st.lists(points, min_size=number_of_targets, max_size=number_of_targets))
    chosen = assigned(agents, targets, objective)
    for target in range(number_of_targets):
        copies = number_of_agents // number_of_targets + (target < number_of_agents % number_of_targets)
        assert chosen.count(target) == copies


@pytest.mark.slow
@pytest.mark.parametrize("objective", OBJECTIVES)
@given(data=st.data(), number_of_agents=st.integers(1, 5), more=st.integers(1, 5))
def test_too_few_agents_go_to_one_target_each(
    objective: Objective, data: st.DataObject, number_of_agents: int, more: int
) -> None:
    agents = data.draw(st.lists(points, min_size=number_of_agents, max_size=number_of_agents))
    targets = data.draw(st.lists(points, min_size=number_of_agents + more, max_size=number_of_agents + more))
    chosen = assigned(agents, targets, objective)
    assert len(set(chosen)) == number_of_agents
    assert all(0 <= target < len(targets) for target in chosen)


@pytest.mark.parametrize("objective", OBJECTIVES)
@settings(max_examples=60)
@given(data=st.data(), number_of_agents=st.integers(1, 5), number_of_targets=st.integers(1, 5))
def test_no_other_assignment_is_better(
    objective: Objective, data: st.DataObject, number_of_agents: int, number_of_targets: int
) -> None:
    agents = data.draw(st.lists(points, min_size=number_of_agents, max_size=number_of_agents))
    targets = data.draw(st.lists(points, min_size=number_of_targets, max_size=number_of_targets))
    ours = worth(agents, targets, assigned(agents, targets, objective), objective)
    best = max(worth(agents, targets, way, objective) for way in allowed(number_of_agents, number_of_targets))
    assert ours == pytest.approx(best, rel=1e-9)


def test_the_greatest_sum_of_inverse_distances_is_not_the_least_sum_of_distances() -> None:
    """One agent very near a target outweighs all of the first, not the second (docs/method.md section 2, point 3)."""
    agents = [(0.0, 0.0), (90.0, 0.0)]
    targets = [(85.0, 0.0), (500.0, 0.0)]
    assert assigned(agents, targets, "inverse-distance") == [1, 0]
    assert assigned(agents, targets, "distance") == [0, 1]


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_an_agent_on_its_target_is_no_division_by_zero(objective: Objective) -> None:
    place = (5.0, 5.0)
    assert assigned([place, place], [place, (900.0, 0.0)], objective) in ([0, 1], [1, 0])
    assert assigned([(900.0, 0.0), place], [place, (900.0, 0.0)], objective) == [1, 0]


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_nobody_and_nowhere_give_no_assignment(objective: Objective) -> None:
    assert assigned([], [(1.0, 1.0)], objective) == []
    assert assigned([(1.0, 1.0)], [], objective) == [-1]
    assert assigned([], [], objective) == []


@st.composite
def restricted(draw: st.DrawFn) -> tuple[Points, Points, Table]:
    """Draw up to 5 agents and 5 targets, and who can reach what: often little, so that the priorities disagree."""
    n, k = draw(st.integers(1, 5)), draw(st.integers(1, 5))
    agents = draw(st.lists(points, min_size=n, max_size=n))
    targets = draw(st.lists(points, min_size=k, max_size=k))
    possible = st.integers(0, 9).map(lambda one_in_ten: one_in_ten < level)
    level = draw(st.integers(2, 9))
    return agents, targets, draw(st.lists(st.lists(possible, min_size=k, max_size=k), min_size=n, max_size=n))


def ranked(agents: Points, targets: Points, chosen: tuple[int, ...], objective: Objective) -> tuple[int, int, float]:
    """Return the three priorities in their order, each the greater the better."""
    sent = [k for k in chosen if k >= 0]
    return len(set(sent)), len(sent), worth(agents, targets, chosen, objective)


def best_rank(agents: Points, targets: Points, reachable: Table, objective: Objective) -> tuple[int, int, float]:
    """Return the best that any way of sending agents where they can go achieves, by trying them all."""
    n, k = len(agents), len(targets)
    copies = [sum(column % k == target for column in range(max(n, k))) for target in range(k)]
    options = [[-1, *(target for target in range(k) if row[target])] for row in reachable]
    ways = [way for way in itertools.product(*options) if all(way.count(t) <= copies[t] for t in range(k))]
    return max(ranked(agents, targets, way, objective) for way in ways)


@pytest.mark.slow
@pytest.mark.parametrize("objective", OBJECTIVES)
@settings(max_examples=150)
@given(scene=restricted())
def test_in_range_most_targets_are_covered_then_most_agents_used_then_the_objective_decides(
    objective: Objective, scene: tuple[Points, Points, Table]
) -> None:
    agents, targets, reachable = scene
    chosen = assigned(agents, targets, objective, reachable)
    assert all(target == -1 or row[target] for row, target in zip(reachable, chosen, strict=True))
    ours = ranked(agents, targets, tuple(chosen), objective)
    best = best_rank(agents, targets, reachable, objective)
    assert ours[:2] == best[:2]
    assert ours[2] == pytest.approx(best[2], rel=1e-9)


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_the_objective_stays_exact_among_hundreds_of_agents(objective: Objective) -> None:
    """Islands 100 km apart that cannot reach each other: the whole must be as good as each island by itself."""
    rng = np.random.default_rng(5)
    islands, size = 100, 4
    reachable = np.zeros((islands * size, islands * size), dtype=bool)
    agents: Points = []
    targets: Points = []
    best = []
    for island in range(islands):
        places = rng.uniform(-1e4, 1e4, (2 * size, 2)) + (1e5 * island, 0.0)
        # Pairs a millimetre better or worse than others: a penalty in one number with the costs would blur them.
        places[1] = places[0] + (0.0, 1e-3)
        own = rng.random((size, size)) < 0.4
        block = slice(island * size, (island + 1) * size)
        reachable[block, block] = own
        here = [(float(north), float(east)) for north, east in places]
        agents, targets = agents + here[:size], targets + here[size:]
        best.append(best_rank(here[:size], here[size:], own.tolist(), objective))
    chosen = assigned(agents, targets, objective, reachable.tolist())
    for island, expected in enumerate(best):
        block = slice(island * size, (island + 1) * size)
        ours = ranked(agents[block], targets, tuple(chosen[block]), objective)
        assert ours[:2] == expected[:2]
        assert ours[2] == pytest.approx(expected[2], rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("objective", OBJECTIVES)
@given(data=st.data(), number_of_agents=st.integers(1, 12), number_of_targets=st.integers(1, 12))
def test_where_everything_is_in_range_the_range_changes_nothing(
    objective: Objective, data: st.DataObject, number_of_agents: int, number_of_targets: int
) -> None:
    agents = np.array(data.draw(st.lists(points, min_size=number_of_agents, max_size=number_of_agents)))
    targets = np.array(data.draw(st.lists(points, min_size=number_of_targets, max_size=number_of_targets)))
    copies = np.arange(max(number_of_agents, number_of_targets)) % number_of_targets
    distance_m = np.maximum(np.hypot(*(agents[:, None] - targets[copies]).transpose(2, 0, 1)), CLOSEST_M)
    if objective == "distance":
        rows, columns = linear_sum_assignment(distance_m)
    else:
        rows, columns = linear_sum_assignment(1.0 / distance_m, maximize=True)
    plain = np.full(number_of_agents, -1)
    plain[rows] = copies[columns]
    everything = np.ones((number_of_agents, number_of_targets), dtype=bool)
    np.testing.assert_array_equal(assign(agents, targets, objective), plain)
    np.testing.assert_array_equal(assign(agents, targets, objective, everything), plain)


def test_the_only_agent_in_range_of_a_target_takes_it_though_another_is_nearer_to_it() -> None:
    agents, targets = [(0.0, 0.0), (10.0, 0.0)], [(0.0, 1.0), (500.0, 0.0)]
    assert assigned(agents, targets, "distance", [[True, True], [True, False]]) == [1, 0]


def test_a_far_target_is_covered_before_a_near_one_gets_its_second_agent() -> None:
    agents, targets = [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)], [(0.0, 0.0), (90_000.0, 0.0)]
    assert assigned(agents, targets, "distance", [[True, False], [True, True], [True, False]]) == [0, 1, 0]


def test_no_target_has_more_than_its_copies_though_its_agents_can_go_nowhere_else() -> None:
    agents, targets = [(3.0, 0.0), (2.0, 0.0), (1.0, 0.0), (4.0, 0.0)], [(0.0, 0.0), (9.0, 0.0)]
    assert assigned(agents, targets, "distance", [[True, False]] * 4) == [-1, 0, 0, -1]


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_agents_that_reach_nothing_go_nowhere(objective: Objective) -> None:
    places = [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)]
    assert assigned(places, places[:2], objective, [[False, False]] * 3) == [-1, -1, -1]
    assert assigned([], places, objective, []) == []
    assert assigned(places, [], objective, [[], [], []]) == [-1, -1, -1]


@pytest.mark.parametrize(
    ("name", "shapes"),
    [
        ("agents_ned_m", ((3, 3), (2, 2), (3, 2))),
        ("targets_ned_m", ((3, 2), (2,), (3, 2))),
        ("reachable", ((3, 2), (2, 2), (2, 3))),
        ("reachable", ((3, 2), (2, 2), (3,))),
    ],
)
def test_an_assignment_whose_shapes_disagree_is_refused(name: str, shapes: tuple[tuple[int, ...], ...]) -> None:
    agents, targets, reachable = (np.zeros(shape) for shape in shapes)
    with pytest.raises(ValueError, match=f"{name} has shape"):
        assign(agents, targets, "distance", reachable)


# Costs of any kind, blocked pairs, and the present assignment


@dataclass(frozen=True)
class Costs:
    """Costs, what is in reach and what is blocked, of up to 5 agents and 4 targets; and a present assignment."""

    cost: np.ndarray  # (N, K)
    reachable: np.ndarray  # (N, K) bool
    blocked: np.ndarray  # (N, K) bool
    present: np.ndarray  # (N,)

    def ways(self) -> list[tuple[int, ...]]:
        """Return every way of giving agents a target in reach, no target to more than its copies."""
        n, k = self.cost.shape
        copies = [sum(column % k == target for column in range(max(n, k))) for target in range(k)]
        options = [[-1, *np.flatnonzero(row)] for row in self.reachable]
        ways = [tuple(map(int, way)) for way in itertools.product(*options)]
        return [way for way in ways if all(way.count(target) <= copies[target] for target in range(k))]

    def rank(self, way: tuple[int, ...]) -> tuple[int, int, int]:
        """Return what comes before any cost, each the greater the better."""
        pairs = self.pairs(way)
        return len({k for _, k in pairs}), len(pairs), -sum(bool(self.blocked[pair]) for pair in pairs)

    def pairs(self, way: tuple[int, ...]) -> list[tuple[int, int]]:
        return [(agent, target) for agent, target in enumerate(way) if target >= 0]

    def best_ways(self) -> list[tuple[int, ...]]:
        ways = self.ways()
        best = max(self.rank(way) for way in ways)
        return [way for way in ways if self.rank(way) == best]

    def total(self, way: tuple[int, ...], share: float = 0.0) -> float:
        """Return the total cost, present pairs counted less by a share."""
        kept = {(agent, int(target)) for agent, target in enumerate(self.present)}
        return float(sum(self.cost[pair] - share * (pair in kept) * abs(self.cost[pair]) for pair in self.pairs(way)))

    def latest(self, way: tuple[int, ...]) -> float:
        return max((float(self.cost[pair]) for pair in self.pairs(way) if not self.blocked[pair]), default=-math.inf)


@st.composite
def tables(draw: st.DrawFn, least_cost: int = 1) -> Costs:
    n, k = draw(st.integers(1, 5)), draw(st.integers(1, 4))
    cells = n * k

    def cell_table(cell: st.SearchStrategy[float] | st.SearchStrategy[bool]) -> np.ndarray:
        return np.array(draw(st.lists(cell, min_size=cells, max_size=cells))).reshape(n, k)

    cost = cell_table(st.integers(least_cost, 1_000).map(float))
    reachable = cell_table(st.booleans()) | cell_table(st.booleans()) | draw(st.booleans())
    blocked = cell_table(st.booleans()) & cell_table(st.booleans()) & draw(st.booleans())
    table = Costs(cost, reachable, blocked, np.full(n, -1))
    return replace(table, present=np.array(draw(st.sampled_from(table.ways()))))


shares = st.sampled_from([0.0, 0.02, 0.3])


@settings(max_examples=50)
@given(table=tables(), share=shares)
def test_fewest_blocked_pairs_are_used_and_then_the_total_is_least_what_is_kept_counting_a_share_less(
    table: Costs, share: float
) -> None:
    chosen = tuple(assign_least_total(table.cost, table.reachable, table.blocked, table.present, share).tolist())
    assert chosen in table.best_ways()
    assert table.total(chosen, share) == pytest.approx(min(table.total(way, share) for way in table.best_ways()))


@settings(max_examples=50)
@given(table=tables())
def test_without_a_share_the_latest_arrival_is_least_and_then_the_total(table: Costs) -> None:
    chosen = assign_least_latest(table.cost, table.reachable, table.blocked, table.present, 0.0)
    ways = table.best_ways()
    latest, total = min((table.latest(way), table.total(way)) for way in ways)
    assert tuple(chosen.tolist()) in ways
    assert (table.latest(tuple(chosen)), table.total(tuple(chosen))) == pytest.approx((latest, total))


@settings(max_examples=50)
@given(table=tables(), share=shares)
def test_the_latest_arrival_stands_unless_it_can_fall_by_more_than_the_share(table: Costs, share: float) -> None:
    chosen = assign_least_latest(table.cost, table.reachable, table.blocked, table.present, share)
    ways = table.best_ways()
    assert tuple(chosen.tolist()) in ways
    least = min(table.latest(way) for way in ways)
    present = tuple(table.present.tolist())
    if present in ways and least >= (1.0 - share) * table.latest(present):
        assert table.latest(tuple(chosen)) <= table.latest(present)
        assert table.total(tuple(chosen), share) <= table.total(present, share) + 1e-9
    else:
        assert table.latest(tuple(chosen)) <= max(least, table.latest(present) if share > 0.0 else least)


def settle(table: Costs, latest: bool, present: np.ndarray | None, share: float) -> np.ndarray:
    if latest:
        return assign_least_latest(table.cost, table.reachable, table.blocked, present, share)
    return assign_least_total(table.cost, table.reachable, table.blocked, present, share)


@pytest.mark.slow
@pytest.mark.parametrize("latest", [False, True], ids=["total", "latest"])
@settings(max_examples=25)
@given(table=tables(least_cost=100), seed=st.integers(0, 2**32))
def test_costs_that_tremble_by_less_than_the_share_bring_no_assignment_back_that_was_left(
    latest: bool, table: Costs, seed: int
) -> None:
    rng, share = np.random.default_rng(seed), 0.05
    # Every cost is at least 100, and a change must save more than 5 of 100: trembling may then be just below 2.5.
    tremble = 0.5 if latest else 2.4
    present: np.ndarray | None = None
    left: set[tuple[int, ...]] = set()
    for _ in range(25):
        shaken = replace(table, cost=table.cost + rng.uniform(-tremble, tremble, table.cost.shape))
        chosen = settle(shaken, latest, present, share)
        assert tuple(chosen.tolist()) not in left
        if present is not None and not np.array_equal(present, chosen):
            left.add(tuple(present.tolist()))
        present = chosen


@pytest.mark.parametrize("latest", [False, True], ids=["total", "latest"])
def test_without_a_share_a_trembling_tie_is_settled_anew_each_time(latest: bool) -> None:
    found = set()
    for tremble in (-1.0, 1.0):
        cost = np.array([[500.0 + tremble, 500.0], [500.0, 500.0 + tremble]])
        tie = Costs(cost, np.ones((2, 2), dtype=bool), np.zeros((2, 2), dtype=bool), np.array([0, 1]))
        found.add(tuple(settle(tie, latest, tie.present, 0.0).tolist()))
        assert settle(tie, latest, tie.present, 0.02).tolist() == [0, 1]
    assert found == {(0, 1), (1, 0)}


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_agents_change_when_those_that_change_save_more_than_the_share(objective: Objective) -> None:
    targets = [(0.0, 0.0), (1_000.0, 0.0)]
    for apart_m, expected in ((10.0, [0, 1]), (200.0, [1, 0])):
        agents = np.array([(500.0 + apart_m, 0.0), (500.0 - apart_m, 0.0)])
        kept = assign(agents, np.array(targets), objective, None, np.array([0, 1]), 0.2)
        assert kept.tolist() == expected
        assert assign(agents, np.array(targets), objective, None, np.array([0, 1]), 0.0).tolist() == [1, 0]


def test_who_is_blocked_at_its_present_target_leaves_it_whatever_the_share() -> None:
    cost, blocked = np.array([[1.0, 500.0], [500.0, 900.0]]), np.array([[True, False], [False, False]])
    assert assign_least_total(cost, None, blocked, np.array([0, 1]), 0.5).tolist() == [1, 0]
    assert assign_least_latest(cost, None, blocked, np.array([0, 1]), 0.5).tolist() == [1, 0]


def test_a_target_that_is_blocked_to_all_has_its_agents_all_the_same() -> None:
    cost, blocked = np.array([[1.0, 9.0], [2.0, 9.0]]), np.array([[True, False], [True, False]])
    assert sorted(assign_least_total(cost, None, blocked).tolist()) == [0, 1]
    assert sorted(assign_least_latest(cost, None, blocked).tolist()) == [0, 1]


@pytest.mark.parametrize("share", [-0.1, 1.0, math.nan])
def test_a_share_that_is_none_is_refused(share: float) -> None:
    with pytest.raises(ValueError, match="switching_share"):
        assign_least_total(np.ones((1, 1)), switching_share=share)


@pytest.mark.parametrize("name", ["cost", "reachable", "blocked", "present"])
def test_costs_whose_shapes_disagree_are_refused(name: str) -> None:
    given: dict[str, Any] = {
        "cost": np.ones((2, 3)),
        "reachable": np.ones((2, 3)),
        "blocked": np.ones((2, 3)),
        "present": np.zeros(2, int),
    }
    with pytest.raises(ValueError, match=f"{name} has shape"):
        assign_least_total(**(given | {name: np.ones(3)}))


AGENTS = np.array([[0.0, 0.0], [1_000.0, 0.0]])
TARGETS = np.array([[3_000.0, 4_000.0], [1_000.0, 0.0], [0.0, 9_000.0]])


def test_without_homes_the_straight_way_must_be_in_range() -> None:
    """From the first agent the targets are 5000, 1000 and 9000 m away; what is just enough is enough."""
    within = within_range(AGENTS, TARGETS, np.array([5_000.0, 0.0]), None, 1.1)
    assert within.tolist() == [[True, True, False], [False, True, False]]


def test_with_homes_the_way_home_from_the_target_must_be_in_range_with_its_reserve() -> None:
    homes = np.array([[0.0, 0.0], [3_000.0, 0.0]])
    # The first needs 5000 + 1.1 * 5000 m; the second, at a target 2000 m from home, just 1.1 * 2000 m.
    for left_m, expected in (((10_500.0, 2_200.0), (True, True)), ((10_499.0, 2_199.0), (False, False))):
        within = within_range(AGENTS, TARGETS, np.array(left_m), homes, 1.1)
        assert (within[0, 0], within[1, 1]) == expected


def test_an_agent_that_would_turn_home_at_once_is_not_sent_even_to_a_target_beside_its_home() -> None:
    far, home = np.array([[100_000.0, 0.0]]), np.array([[0.0, 0.0]])
    assert within_range(far, home, np.array([110_001.0]), home, 1.1).all()
    assert not within_range(far, home, np.array([109_999.0]), home, 1.1).any()


def test_an_agent_that_cannot_return_any_more_may_still_arrive() -> None:
    agent, target, home = np.array([[100_000.0, 0.0]]), np.array([[130_000.0, 0.0]]), np.array([[0.0, 0.0]])
    assert within_range(agent, target, np.array([30_000.0]), home, 1.1).all()
    assert not within_range(agent, target, np.array([29_999.0]), home, 1.1).any()


@pytest.mark.parametrize("homes", [None, AGENTS])
def test_an_unlimited_range_reaches_everything_and_an_exceeded_or_unknown_one_nothing(homes: np.ndarray | None) -> None:
    assert within_range(AGENTS, TARGETS, np.full(2, np.inf), homes, 1.1).all()
    assert not within_range(AGENTS, TARGETS, np.array([-1.0, np.nan]), homes, 1.1).any()


def test_ways_that_are_longer_than_the_straight_one_count_in_full() -> None:
    there_m = np.array([[5_001.0, 1_000.0, 9_000.0], [1.0, 0.0, 1.0]])
    within = within_range(AGENTS, TARGETS, np.array([5_000.0, 0.0]), None, 1.1, there_m)
    assert within.tolist() == [[False, True, False], [False, True, False]]
    with pytest.raises(ValueError, match="there_m has shape"):
        within_range(AGENTS, TARGETS, np.zeros(2), None, 1.1, there_m.T)


def test_nobody_and_nowhere_are_in_range_of_nothing() -> None:
    nothing = np.zeros((0, 2))
    assert within_range(nothing, TARGETS, np.zeros(0), nothing, 1.1).shape == (0, 3)
    assert within_range(AGENTS, nothing, np.zeros(2), AGENTS, 1.1).shape == (2, 0)


@pytest.mark.parametrize(
    ("name", "shapes"),
    [
        ("agents_ned_m", ((2, 3), (3, 2), (2,), (2, 2))),
        ("targets_ned_m", ((2, 2), (3,), (2,), (2, 2))),
        ("left_m", ((2, 2), (3, 2), (3,), (2, 2))),
        ("left_m", ((2, 2), (3, 2), (), (2, 2))),
        ("home_ned_m", ((2, 2), (3, 2), (2,), (1, 2))),
    ],
)
def test_a_range_whose_shapes_disagree_is_refused(name: str, shapes: tuple[tuple[int, ...], ...]) -> None:
    agents, targets, left_m, homes = (np.zeros(shape) for shape in shapes)
    with pytest.raises(ValueError, match=f"{name} has shape"):
        within_range(agents, targets, left_m, homes, 1.1)
