"""Vehicles that stand near each other must all get away, whatever their order, and keep their separation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geo.right_of_way import Rules, growth_m
from companion.onboard.lint.spacing import MOST_GROWN
from tests.benchmarks import swarm

Places = list[tuple[float, float]]


@st.composite
def rules_of_copters(draw: st.DrawFn) -> Rules:
    """Return the rules of copters that turn within a few separations."""
    separation_m, n_max = draw(st.sampled_from([5.0, 10.0, 20.0, 40.0])), draw(st.sampled_from([0.1, 0.2, 0.5, 1.0]))
    quickest_m_s = math.sqrt(2.5 * separation_m * n_max * 9.80665)
    return Rules(
        separation_m=separation_m,
        n_max=n_max,
        speed_m_s=min(draw(st.sampled_from([3.0, 8.0, 15.0])), quickest_m_s),
        can_stop=True,
        braking_m_s2=draw(st.sampled_from([1.0, 2.0, 4.0])),
    )


def starts_of(shape: str, count: int, spacing_m: float, rng: np.random.Generator) -> Places:
    """Return places of a row, a grid or a ring with a spacing, or scattered with at least that."""
    towards_rad = rng.uniform(0.0, math.tau)
    if shape == "row":
        along = math.cos(towards_rad), math.sin(towards_rad)
        return [(k * spacing_m * along[0], k * spacing_m * along[1]) for k in range(count)]
    if shape == "grid":
        width = math.ceil(math.sqrt(count))
        return [(spacing_m * (k // width), spacing_m * (k % width)) for k in range(count)]
    if shape == "ring":
        radius_m, bearings_rad = spacing_m / (2.0 * math.sin(math.pi / count)), math.tau / count * np.arange(count)
        return [(radius_m * math.cos(at), radius_m * math.sin(at)) for at in (towards_rad + bearings_rad).tolist()]
    return swarm.scattered(count, 2.0 * spacing_m * math.sqrt(count), spacing_m, rng)


def ends_of(order: str, starts: Places, spacing_m: float, far_m: float, rng: np.random.Generator) -> Places:
    """Return targets with a spacing: anywhere, in a line in another order, or each opposite through the middle."""
    count = len(starts)
    if order == "anywhere":
        return swarm.scattered(count, 2.5 * spacing_m * math.sqrt(count) + far_m, spacing_m, rng)
    if order == "line":
        towards_rad = rng.uniform(0.0, math.tau)
        along, across = np.array([math.cos(towards_rad), math.sin(towards_rad)]), rng.permutation(count) - 0.5 * count
        beside = np.array([-along[1], along[0]])
        line = far_m * along + spacing_m * np.outer(across, beside)
        return [(north_m, east_m) for north_m, east_m in line.tolist()]
    middle = np.mean(starts, axis=0)
    away = np.array(starts) - middle
    least_m = min(np.hypot(*(away[i] - away[j])) for i in range(count) for j in range(i))
    # The middle of a row or a grid is its own opposite: it arrives where it stands, and the others pass it.
    opposite = middle - away * max(spacing_m / least_m, 1.0)
    return [(north_m, east_m) for north_m, east_m in opposite.tolist()]


def fly_from_a_stand(
    rules: Rules, shape: str, order: str, count: int, closeness: float, seed: int, word_period_s: float = 0.0
) -> swarm.Outcome:
    """Return the outcome of a flight of copters that stand at `closeness` times the separation, facing anywhere.

    With `word_period_s` they know of one another only what is told at that period; targets are then farther apart.
    """
    rng = np.random.default_rng(seed)
    turn_radius_m = rules.speed_m_s**2 / (rules.n_max * 9.80665)
    # Copters of this harness pass their targets at cruise speed.
    arrival_radius_m = max(0.5 * rules.separation_m, turn_radius_m)
    starts = starts_of(shape, count, closeness * rules.separation_m, rng)
    spacing_m = 2.0 * arrival_radius_m + 3.0 * rules.separation_m
    spacing_m += growth_m(0.0, word_period_s, True, rules, swarm.DT_S)
    ends = ends_of(order, starts, spacing_m, 10.0 * rules.speed_m_s, rng)
    ways = list(zip(starts, ends, strict=True))
    crafts = [swarm.bound(here, there, rules.speed_m_s, k) for k, (here, there) in enumerate(ways)]
    for craft in crafts:
        craft.heading_rad = rng.uniform(-math.pi, math.pi)
    longest_m = max(math.dist(here, there) for here, there in ways)
    limit_s = 120.0 + 5.0 * longest_m / rules.speed_m_s
    return swarm.fly(crafts, rules, limit_s, 10.0, 600.0, arrival_radius_m, standing=True, word_period_s=word_period_s)


def assert_all_got_away(outcome: swarm.Outcome, rules: Rules) -> None:
    assert outcome.arrived == outcome.bound
    assert outcome.least_m >= rules.separation_m - 1e-6


SCENES = (
    st.sampled_from(["row", "grid", "ring", "scattered"]),
    st.sampled_from(["anywhere", "line", "opposite"]),
    st.integers(2, 8),
    st.floats(1.001, 3.0),
    st.integers(0, 2**32 - 1),
)


@settings(max_examples=10)
@given(rules_of_copters(), *SCENES)
def test_all_that_stand_get_away_one_after_the_other(
    rules: Rules, shape: str, order: str, count: int, closeness: float, seed: int
) -> None:
    assert_all_got_away(fly_from_a_stand(rules, shape, order, min(count, 4), closeness, seed), rules)


@pytest.mark.slow
@settings(max_examples=100)
@given(rules_of_copters(), *SCENES)
def test_crowds_that_stand_get_away_one_after_the_other(
    rules: Rules, shape: str, order: str, count: int, closeness: float, seed: int
) -> None:
    assert_all_got_away(fly_from_a_stand(rules, shape, order, count, closeness, seed), rules)


def is_told_in_time(rules: Rules, word_period_s: float) -> bool:
    """Return whether words of a period grow so little that `sim fly` does not warn of them."""
    age_s = 1.5 * word_period_s + swarm.DT_S
    return growth_m(rules.speed_m_s, age_s, True, rules, swarm.DT_S) <= MOST_GROWN * rules.separation_m


TOLD = st.tuples(rules_of_copters(), st.sampled_from([0.5, 1.0, 1.5, 3.0])).filter(lambda told: is_told_in_time(*told))


@pytest.mark.slow
@settings(max_examples=8)
@given(TOLD, *SCENES)
def test_crowds_that_only_hear_of_each_other_in_time_get_away_too(
    told: tuple[Rules, float], shape: str, order: str, count: int, closeness: float, seed: int
) -> None:
    rules, word_period_s = told
    assert_all_got_away(fly_from_a_stand(rules, shape, order, count, closeness, seed, word_period_s), rules)


@pytest.mark.parametrize("yaw_rad", [0.0, math.pi / 2, math.pi])
def test_two_that_stand_at_the_separation_and_want_through_each_other_go_round(yaw_rad: float) -> None:
    rules = Rules(separation_m=20.0, n_max=0.1, speed_m_s=5.0, can_stop=True, braking_m_s2=1.0)
    crafts = [swarm.bound((0.0, 0.0), (120.0, 0.0), 5.0, 0), swarm.bound((20.02, 0.0), (-100.0, 0.0), 5.0, 1)]
    for craft, turned_rad in zip(crafts, (yaw_rad, yaw_rad + math.pi), strict=True):
        craft.heading_rad = turned_rad
    assert_all_got_away(swarm.fly(crafts, rules, 200.0, 10.0, 600.0, 26.0, standing=True), rules)
