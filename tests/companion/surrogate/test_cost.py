"""The paper's cost, term by term, at and around its jumps."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.surrogate.cost import (
    Scene,
    Weights,
    collision_penalty,
    distance_cost,
    penalty_sum,
    range_penalty,
    threat_penalty,
    total_cost,
    unit_disc_indicator,
)

WEIGHTS = Weights(k_d=2.0, k_a=3.0, k_c=5.0, k_l=7.0)
ETA = 0.1


def scene(agents: list[list[float]], threats: list[list[float]] | None = None) -> Scene:
    """Return agents on their targets, far from their range, among threats of R_d = 100 m and R_a = 50 m."""
    positions = np.array(agents, dtype=float)
    discs = np.array(threats or [], dtype=float).reshape(-1, 2)
    return Scene(
        agents_ned_m=positions,
        targets_ned_m=positions.copy(),
        threats_ned_m=discs,
        detection_radius_m=np.full(len(discs), 100.0),
        attack_radius_m=np.full(len(discs), 50.0),
        separation_m=10.0,
        flown_m=np.zeros(len(positions)),
        range_m=np.full(len(positions), 1000.0),
    )


def test_default_weights_are_the_papers_in_square_metres() -> None:
    assert Weights() == Weights(k_d=1e5 * 1e6, k_a=1e5 * 1e6, k_c=1e4 * 1e6, k_l=1e4 * 1e6)


def test_distance_cost_is_half_the_squared_distance_to_the_own_target() -> None:
    moved = replace(scene([[0.0, 0.0], [100.0, 0.0]]), targets_ned_m=np.array([[3.0, 4.0], [100.0, 2.0]]))
    np.testing.assert_allclose(distance_cost(moved), [12.5, 2.0])


@pytest.mark.parametrize(("north_m", "expected"), [(100.1, 0.0), (100.0, 2.0), (50.1, 2.0), (50.0, 5.0), (0.0, 5.0)])
def test_threat_penalty_jumps_at_both_radii_and_counts_the_edge_as_inside(north_m: float, expected: float) -> None:
    np.testing.assert_allclose(threat_penalty(scene([[north_m, 0.0]], [[0.0, 0.0]]), WEIGHTS), [expected])


def test_each_threat_is_measured_by_its_own_radii() -> None:
    mixed = replace(
        scene([[80.0, 0.0]], [[0.0, 0.0], [160.0, 0.0]]),
        detection_radius_m=np.array([100.0, 70.0]),
        attack_radius_m=np.array([50.0, 60.0]),
    )
    np.testing.assert_allclose(threat_penalty(mixed, WEIGHTS), [WEIGHTS.k_d])


def test_an_agent_does_not_collide_with_itself() -> None:
    np.testing.assert_array_equal(collision_penalty(scene([[0.0, 0.0]]), WEIGHTS), [0.0])


def test_two_agents_within_the_separation_are_both_charged() -> None:
    trio = scene([[0.0, 0.0], [9.0, 0.0], [30.0, 0.0]])
    np.testing.assert_allclose(collision_penalty(trio, WEIGHTS), [5.0, 5.0, 0.0])


def test_agents_at_the_same_point_collide() -> None:
    np.testing.assert_allclose(collision_penalty(scene([[1.0, 1.0], [1.0, 1.0]]), WEIGHTS), [5.0, 5.0])


@pytest.mark.parametrize(("flown_m", "expected"), [(899.0, 0.0), (900.0, 0.0), (901.0, 7.0)])
def test_range_penalty_starts_when_flown_and_remaining_distance_exceed_the_range(
    flown_m: float, expected: float
) -> None:
    far = replace(scene([[0.0, 0.0]]), targets_ned_m=np.array([[100.0, 0.0]]), flown_m=np.array([flown_m]))
    np.testing.assert_allclose(range_penalty(far, WEIGHTS), [expected])


@pytest.mark.parametrize("half_width", [0.0, ETA])
def test_an_unlimited_range_is_never_exceeded(half_width: float) -> None:
    unlimited = replace(scene([[0.0, 0.0]]), flown_m=np.array([1e9]), range_m=np.array([np.inf]))
    np.testing.assert_array_equal(range_penalty(unlimited, WEIGHTS, half_width), [0.0])


def test_penalties_add_up_over_agents_and_terms() -> None:
    both = replace(scene([[0.0, 0.0], [5.0, 0.0]], [[40.0, 0.0]]), flown_m=np.array([0.0, 2000.0]))
    assert penalty_sum(both, WEIGHTS) == pytest.approx(2 * (2.0 + 3.0) + 2 * 5.0 + 7.0)


def test_total_cost_adds_the_distance_cost_to_the_penalties() -> None:
    away = replace(scene([[0.0, 0.0]], [[40.0, 0.0]]), targets_ned_m=np.array([[6.0, 8.0]]))
    assert total_cost(away, WEIGHTS) == pytest.approx(50.0 + 5.0)


def test_one_agent_without_threats_costs_nothing_on_its_target() -> None:
    assert total_cost(scene([[3.0, 4.0]]), WEIGHTS) == 0.0


@pytest.mark.parametrize(("ratio", "expected"), [(0.9, 1.0), (0.95, 0.75), (1.0, 0.5), (1.05, 0.25), (1.1, 0.0)])
def test_polygon_falls_linearly_across_the_band(ratio: float, expected: float) -> None:
    assert unit_disc_indicator(np.array(ratio), ETA) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(("needed", "expected"), [(0.9, 0.0), (0.95, 1.75), (1.0, 3.5), (1.1, 7.0)])
def test_polygon_of_the_range_penalty_rises_across_the_band(needed: float, expected: float) -> None:
    near = replace(scene([[0.0, 0.0]]), flown_m=np.array([needed * 1000.0]))
    np.testing.assert_allclose(range_penalty(near, WEIGHTS, ETA), [expected], atol=1e-9)


@given(
    threat_ratio=st.floats(0.0, 3.0).filter(lambda r: abs(r - 1.0) > ETA and abs(2.0 * r - 1.0) > ETA),
    peer_ratio=st.floats(0.0, 3.0).filter(lambda r: abs(r - 1.0) > ETA),
    range_ratio=st.floats(0.0, 3.0).filter(lambda r: abs(r - 1.0) > ETA),
)
def test_polygon_equals_the_step_outside_the_bands(threat_ratio: float, peer_ratio: float, range_ratio: float) -> None:
    # The second agent and the threat lie on opposite sides of the first, so that each band is entered alone.
    outside = replace(
        scene([[0.0, 0.0], [0.0, 10.0 * peer_ratio]], [[0.0, -100.0 * threat_ratio]]),
        flown_m=np.array([1000.0 * range_ratio, 0.0]),
        attack_radius_m=np.array([50.0]),
    )
    penalties = (threat_penalty, collision_penalty, range_penalty)
    steps, polygons = ([penalty(outside, WEIGHTS, eta)[0] for penalty in penalties] for eta in (0.0, ETA))
    np.testing.assert_allclose(polygons, steps, atol=1e-12)


def test_polygon_sum_equals_the_step_sum_away_from_every_edge() -> None:
    clear = scene([[0.0, 0.0], [5.0, 0.0], [300.0, 0.0]], [[70.0, 0.0]])
    assert penalty_sum(clear, WEIGHTS, ETA) == penalty_sum(clear, WEIGHTS) == 2 * 2.0 + 2 * 5.0


def test_reordering_the_agents_reorders_their_penalties() -> None:
    agents = [[0.0, 0.0], [5.0, 0.0], [90.0, 0.0], [300.0, 0.0]]
    order = [2, 0, 3, 1]
    straight = scene(agents, [[70.0, 0.0]])
    shuffled = scene([agents[k] for k in order], [[70.0, 0.0]])
    for penalty in (threat_penalty, collision_penalty):
        np.testing.assert_array_equal(penalty(shuffled, WEIGHTS), penalty(straight, WEIGHTS)[order])


def test_a_scene_whose_shapes_disagree_is_refused() -> None:
    with pytest.raises(ValueError, match="targets_ned_m"):
        replace(scene([[0.0, 0.0]]), targets_ned_m=np.zeros((2, 2)))


@pytest.mark.parametrize("name", ["detection_radius_m", "attack_radius_m", "range_m"])
def test_a_scene_with_a_radius_or_range_of_zero_is_refused(name: str) -> None:
    of_zero: dict[str, Any] = {name: np.zeros(1)}
    with pytest.raises(ValueError, match=f"{name} must be positive"):
        replace(scene([[0.0, 0.0]], [[1.0, 0.0]]), **of_zero)
