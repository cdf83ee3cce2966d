"""The smooth f4: the price of a target beyond the range budget, and the gradient that shortens the way to it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.surrogate.cost import Scene, Weights, range_penalty
from companion.surrogate.profiles import HALF_WIDTH, range_cost, range_gradient

K_L = 1e10
"""m^2 (docs/method.md section 4)."""
RANGE_M = 500_000.0
"""docs/method.md section 4."""
TARGET = np.array([20_000.0, -10_000.0])

offsets = st.tuples(st.floats(100.0, 100_000.0), st.floats(0.0, math.tau)).map(
    lambda polar: polar[0] * np.array([math.cos(polar[1]), math.sin(polar[1])])
)
half_widths = st.sampled_from([HALF_WIDTH, 0.1, 0.5])
ratios = st.floats(0.5, 1.5)
"""(flown + remaining) / range."""


def scene(position_ned_m: np.ndarray, flown_m: float, range_m: float = RANGE_M) -> Scene:
    """Return one agent on its way to TARGET, without threats."""
    return Scene(
        agents_ned_m=position_ned_m[np.newaxis],
        targets_ned_m=TARGET[np.newaxis],
        threats_ned_m=np.zeros((0, 2)),
        detection_radius_m=np.zeros(0),
        attack_radius_m=np.zeros(0),
        separation_m=100.0,
        flown_m=np.array([flown_m]),
        range_m=np.array([range_m]),
    )


@pytest.mark.slow
@given(offset_m=offsets, ratio=ratios, half_width=half_widths)
def test_the_gradient_is_the_slope_of_the_cost(offset_m: np.ndarray, ratio: float, half_width: float) -> None:
    flown_m = ratio * RANGE_M - float(np.hypot(*offset_m))
    position = TARGET + offset_m
    step_m = 1.0
    differences = [
        (
            range_cost(position + step, TARGET, flown_m, RANGE_M, K_L, half_width)
            - range_cost(position - step, TARGET, flown_m, RANGE_M, K_L, half_width)
        )
        / (2.0 * step_m)
        for step in step_m * np.eye(2)
    ]
    gradient_m = range_gradient(position, TARGET, flown_m, RANGE_M, K_L, half_width)
    # The difference itself is bent over a step: by (step / distance)^2 across the way, by the third derivative along.
    np.testing.assert_allclose(
        gradient_m, differences, rtol=1e-6, atol=1e-4 * float(np.hypot(*gradient_m)) + K_L * 1e-15 / step_m
    )


@pytest.mark.slow
@given(offset_m=offsets, ratio=ratios, half_width=half_widths)
def test_descent_points_at_the_target(offset_m: np.ndarray, ratio: float, half_width: float) -> None:
    descent_m = -range_gradient(TARGET + offset_m, TARGET, ratio * RANGE_M, RANGE_M, K_L, half_width)
    towards = -offset_m / np.hypot(*offset_m)
    assert descent_m @ towards > 0.0
    assert descent_m @ towards == pytest.approx(float(np.hypot(*descent_m)), rel=1e-9)


def test_at_the_edge_it_is_half_the_weight_and_as_steep_as_the_polygon() -> None:
    position, flown_m = TARGET + np.array([30_000.0, 0.0]), RANGE_M - 30_000.0
    assert range_cost(position, TARGET, flown_m, RANGE_M, K_L) == pytest.approx(K_L / 2.0)
    weights, step_m = Weights(k_l=K_L), np.array([1.0, 0.0])
    further, nearer = (
        float(range_penalty(scene(place, flown_m), weights, HALF_WIDTH)[0])
        for place in (position + step_m, position - step_m)
    )
    gradient_m = range_gradient(position, TARGET, flown_m, RANGE_M, K_L)
    np.testing.assert_allclose(gradient_m, [(further - nearer) / 2.0, 0.0], rtol=1e-6)


@pytest.mark.slow
@given(offset_m=offsets, ratio=st.floats(0.3, 3.0).filter(lambda ratio: abs(ratio - 1.0) > 10.0 * HALF_WIDTH))
def test_far_from_the_edge_it_is_the_polygons_value(offset_m: np.ndarray, ratio: float) -> None:
    flown_m = ratio * RANGE_M - float(np.hypot(*offset_m))
    polygon = float(range_penalty(scene(TARGET + offset_m, flown_m), Weights(k_l=K_L), HALF_WIDTH)[0])
    assert range_cost(TARGET + offset_m, TARGET, flown_m, RANGE_M, K_L) == pytest.approx(polygon, abs=1e-8 * K_L)


@pytest.mark.parametrize("ratio", [0.1, 0.3, 0.6, 1.4, 3.0, 100.0])
def test_far_from_the_edge_nothing_pulls(ratio: float) -> None:
    """A ten-thousandth of the attraction that a target 1 m away has: |U - T| is 1 m there (fun1)."""
    position = TARGET + np.array([0.0, 0.05 * RANGE_M])
    gradient_m = range_gradient(position, TARGET, (ratio - 0.05) * RANGE_M, RANGE_M, K_L)
    assert np.hypot(*gradient_m) < 1e-4


@pytest.mark.slow
@given(
    near_m=st.floats(0.0, 50_000.0),
    more_m=st.floats(100.0, 50_000.0),
    flown_m=st.floats(0.9 * RANGE_M, RANGE_M),
    more_flown_m=st.floats(100.0, 50_000.0),
)
def test_further_off_and_further_flown_cost_more(
    near_m: float, more_m: float, flown_m: float, more_flown_m: float
) -> None:
    def cost(distance_m: float, flown_m: float) -> float:
        return range_cost(TARGET + np.array([0.0, distance_m]), TARGET, flown_m, RANGE_M, K_L)

    assert cost(near_m, flown_m) < cost(near_m + more_m, flown_m)
    assert cost(near_m, flown_m) < cost(near_m, flown_m + more_flown_m)
    assert 0.0 < cost(near_m, flown_m) < K_L


def test_an_unlimited_range_costs_nothing_and_pulls_nowhere() -> None:
    position = TARGET + np.array([3.0, 4.0])
    assert range_cost(position, TARGET, 1e9, math.inf, K_L) == 0.0
    np.testing.assert_array_equal(range_gradient(position, TARGET, 1e9, math.inf, K_L), [0.0, 0.0])


def test_on_the_target_there_is_no_direction() -> None:
    assert range_cost(TARGET, TARGET, RANGE_M, RANGE_M, K_L) == pytest.approx(K_L / 2.0)
    np.testing.assert_array_equal(range_gradient(TARGET, TARGET, RANGE_M, RANGE_M, K_L), [0.0, 0.0])


@pytest.mark.slow
@given(
    offset_m=st.tuples(st.floats(-1e9, 1e9), st.floats(-1e9, 1e9)).map(np.array),
    flown_m=st.floats(0.0, 1e12),
    range_m=st.one_of(st.floats(1e-3, 1e12), st.just(math.inf)),
    half_width=st.floats(1e-6, 1.0),
)
def test_no_distance_and_no_range_overflows(
    offset_m: np.ndarray, flown_m: float, range_m: float, half_width: float
) -> None:
    origin = np.zeros(2)
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        cost = range_cost(offset_m, origin, flown_m, range_m, K_L, half_width)
        gradient_m = range_gradient(offset_m, origin, flown_m, range_m, K_L, half_width)
    assert 0.0 <= cost <= K_L
    assert np.all(np.isfinite(gradient_m))


def test_the_weight_scales_the_cost_and_the_gradient() -> None:
    position, flown_m = TARGET + np.array([3_000.0, 4_000.0]), RANGE_M - 1_000.0
    double = 2.0 * K_L
    assert range_cost(position, TARGET, flown_m, RANGE_M, double) == 2.0 * range_cost(
        position, TARGET, flown_m, RANGE_M, K_L
    )
    np.testing.assert_array_equal(
        range_gradient(position, TARGET, flown_m, RANGE_M, double),
        2.0 * range_gradient(position, TARGET, flown_m, RANGE_M, K_L),
    )
