"""The wind must be bounded and follow from the seed alone, or no flight in it could be repeated or certified."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.mission.model import Wind
from sim.wind import GUST_HOLD_S, WindField

seeds = st.integers(0, 2**63 - 1)
times_s = st.floats(0.0, 1e6)


@pytest.mark.parametrize(
    ("from_deg", "velocity_m_s"), [(270.0, (0.0, 12.0)), (0.0, (-12.0, 0.0)), (45.0, (-8.4853, -8.4853))]
)
def test_the_mean_blows_away_from_where_the_wind_comes_from(from_deg: float, velocity_m_s: tuple[float, float]) -> None:
    field = WindField(Wind(from_deg=from_deg, speed_m_s=12.0), seed=1)
    assert field.at(0.0) == field.at(1234.5) == pytest.approx(velocity_m_s, abs=1e-4)


def test_a_mission_without_wind_has_none() -> None:
    assert WindField(Wind(), seed=1).at(17.0) == (0.0, 0.0)


@given(seeds, times_s, st.floats(0.0, 50.0))
def test_a_gust_never_exceeds_its_bound(seed: int, t_s: float, gust_m_s: float) -> None:
    field = WindField(Wind(from_deg=30.0, speed_m_s=9.0, gust_m_s=gust_m_s), seed)
    mean_m_s = WindField(Wind(from_deg=30.0, speed_m_s=9.0), seed).at(t_s)
    assert math.dist(field.at(t_s), mean_m_s) <= gust_m_s + 1e-9


@given(seeds, st.lists(times_s, min_size=1, max_size=20), times_s)
def test_the_wind_at_a_time_does_not_depend_on_when_it_was_looked_at_before(
    seed: int, earlier_s: list[float], t_s: float
) -> None:
    wind = Wind(speed_m_s=5.0, gust_m_s=3.0)
    field = WindField(wind, seed)
    for time_s in earlier_s:
        field.at(time_s)
    assert field.at(t_s) == WindField(wind, seed).at(t_s)


def test_another_seed_has_other_gusts() -> None:
    wind = Wind(gust_m_s=3.0)
    assert WindField(wind, 1).at(3.0) != WindField(wind, 2).at(3.0)


@pytest.mark.slow
def test_the_wind_changes_no_faster_than_by_a_gusts_diameter_in_a_hold() -> None:
    field = WindField(Wind(gust_m_s=4.0), seed=3)
    step_s = 0.01
    samples = np.array([field.at(index * step_s) for index in range(20_000)])
    changes_m_s = np.hypot(*np.diff(samples, axis=0).T)
    assert changes_m_s.max() <= 2.0 * 4.0 * step_s / GUST_HOLD_S + 1e-9
    assert np.hypot(*samples.T).max() > 2.0


def test_gusts_fill_their_disc_evenly() -> None:
    field = WindField(Wind(gust_m_s=10.0), seed=5)
    gusts_m_s = np.array([field.at(index * GUST_HOLD_S) for index in range(4_000)])
    strengths_m_s = np.hypot(*gusts_m_s.T)
    # Half the area lies within 1/sqrt(2) of the radius, a quarter of it in each quadrant: 4 standard deviations.
    assert np.mean(strengths_m_s < 10.0 / math.sqrt(2.0)) == pytest.approx(0.5, abs=0.032)
    assert np.mean((gusts_m_s > 0.0).all(axis=1)) == pytest.approx(0.25, abs=0.028)
