"""The sizes that a mission's lint and the detector's range are judged by must follow from the rule."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.geo.right_of_way import (
    Rules,
    interaction_radius_m,
    least_detector_range_m,
    least_spacing_m,
    reserved_gap_m,
)
from companion.guard.types import Motion

DT_S = 0.5
PLANES = Rules(separation_m=100.0, n_max=1.0, speed_m_s=60.0)
COPTERS = Rules(separation_m=20.0, n_max=0.25, speed_m_s=8.0, reaction_s=0.2, can_stop=True, braking_m_s2=2.0)

headings_rad = st.floats(-math.pi, math.pi)


def apart(
    distance_m: float, bearing_rad: float, headings: tuple[float, float], speed_m_s: float
) -> tuple[Motion, Motion]:
    there_m = distance_m * math.cos(bearing_rad), distance_m * math.sin(bearing_rad)
    return Motion(0.0, 0.0, headings[0], speed_m_s), Motion(*there_m, headings[1], speed_m_s)


@pytest.mark.parametrize("rules", [PLANES, replace(PLANES, n_max=10.0, reaction_s=1.0), COPTERS])
@given(headings=st.tuples(headings_rad, headings_rad), bearing=headings_rad)
def test_what_vehicles_reserve_never_overlaps_from_the_least_spacing_on(
    rules: Rules, headings: tuple[float, float], bearing: float
) -> None:
    speed_m_s = 0.0 if rules.can_stop else rules.speed_m_s
    pair = apart(least_spacing_m(rules, DT_S), bearing, headings, speed_m_s)
    assert reserved_gap_m(*pair, rules, DT_S) >= -1e-6


def test_the_least_spacing_is_no_more_than_the_worst_headings_need() -> None:
    pair = apart(least_spacing_m(PLANES, DT_S), 0.0, (-math.pi / 2, math.pi / 2), PLANES.speed_m_s)
    assert reserved_gap_m(*pair, PLANES, DT_S) == pytest.approx(0.0, abs=1e-6)
    assert least_spacing_m(PLANES, DT_S) == pytest.approx(4.0 * 60.0**2 / 9.80665 + 100.0)


@pytest.mark.parametrize("rules", [PLANES, replace(PLANES, reaction_s=1.0), COPTERS])
def test_whoever_the_detector_shows_in_time_matters_later_than_that(rules: Rules) -> None:
    assert least_spacing_m(rules, DT_S) < least_detector_range_m(rules, DT_S) <= interaction_radius_m(rules, DT_S)


def test_copters_stand_as_near_as_the_separation_allows() -> None:
    assert COPTERS.separation_m <= least_spacing_m(COPTERS, DT_S) < COPTERS.separation_m + 1.0
