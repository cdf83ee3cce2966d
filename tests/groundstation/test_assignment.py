"""Who goes where: every target covered while there are agents, and nobody could do better."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.assignment import CLOSEST_M, OBJECTIVES, Objective, assign

Points = list[tuple[float, float]]
# Whole metres: distances then differ by more than rounding, or not at all.
points = st.tuples(st.integers(-1_000, 1_000), st.integers(-1_000, 1_000)).map(lambda p: (float(p[0]), float(p[1])))


def assigned(agents: Points, targets: Points, objective: Objective = "distance") -> list[int]:
    return assign(np.array(agents).reshape(-1, 2), np.array(targets).reshape(-1, 2), objective).tolist()


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
@settings(max_examples=60, deadline=None)
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
    """METHOD.md 2.3: one agent very near a target outweighs everything in the first, and not in the second."""
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
