"""Whatever a vehicle does after a word of it, what it reserves lies within the growth of what the word says."""

from __future__ import annotations

import cmath
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geo.kinematics import GRAVITY_M_S2, nearest_on_way, turn_rate_rad_s
from companion.geo.right_of_way import SPEED_UP_SHARE, Rules, circle, growth_m, way_to_stop_m

DT_S = 0.5
FINE_S = 0.01
COPTERS = Rules(separation_m=20.0, n_max=0.2, speed_m_s=8.0, can_stop=True, braking_m_s2=2.0)
PLANES = Rules(separation_m=40.0, n_max=0.7, speed_m_s=22.0)

ages_s = st.floats(0.1, 6.0)
controls = st.lists(st.tuples(st.floats(-1.0, 1.0), st.sampled_from([-1.0, 0.0, 1.0])), min_size=4, max_size=4)
"""Turn and push of four equal parts of the time, as shares of the greatest; a push of 0 keeps the speed."""


def copter_after(speed_m_s: float, age_s: float, parts: list[tuple[float, float]]) -> tuple[complex, complex]:
    """Return the place, m, and velocity, m/s, of a copter that flew north at a speed and was steered since."""
    place, heading_rad = 0j, 0.0
    steps = round(age_s / FINE_S)
    for step in range(steps):
        turn, push = parts[min(4 * step // steps, 3)]
        heading_rad += turn * COPTERS.n_max * GRAVITY_M_S2 / max(speed_m_s, 0.05) * FINE_S
        most = 2.0 * SPEED_UP_SHARE if push > 0.0 else 2.0
        speed_m_s = min(max(speed_m_s + push * most * FINE_S, 0.0), COPTERS.speed_m_s)
        place += cmath.rect(speed_m_s * FINE_S, heading_rad)
    return place, cmath.rect(speed_m_s, heading_rad)


@settings(max_examples=150)
@given(st.sampled_from([0.0, 1.0, 4.0, 8.0]), ages_s, controls)
def test_a_copter_stops_within_the_growth_of_the_way_that_was_told(
    speed_m_s: float, age_s: float, parts: list[tuple[float, float]]
) -> None:
    place, velocity = copter_after(speed_m_s, age_s, parts)
    told = complex(speed_m_s * age_s + way_to_stop_m(speed_m_s, COPTERS), 0.0)
    direction = velocity / abs(velocity) if abs(velocity) > 0.0 else 1.0
    grown_m = growth_m(speed_m_s, age_s, True, COPTERS, DT_S)
    for there in (place, place + way_to_stop_m(abs(velocity), COPTERS) * direction):
        assert abs(there - nearest_on_way(there, told)) <= grown_m + 0.1


@settings(max_examples=100)
@given(ages_s, st.floats(-math.pi, math.pi), controls)
def test_a_copter_whose_velocity_was_never_told_stops_within_the_growth_of_its_place(
    age_s: float, course_rad: float, parts: list[tuple[float, float]]
) -> None:
    place, velocity = copter_after(8.0, age_s, parts)
    grown_m = growth_m(0.0, age_s, False, COPTERS, DT_S)
    assert abs(place * cmath.rect(1.0, course_rad)) <= grown_m
    assert abs(place) + way_to_stop_m(abs(velocity), COPTERS) <= grown_m + 0.1


@settings(max_examples=150)
@given(ages_s, controls)
def test_a_plane_circles_within_the_growth_of_the_circle_that_was_told(
    age_s: float, parts: list[tuple[float, float]]
) -> None:
    speed_m_s, rate_rad_s = PLANES.speed_m_s, turn_rate_rad_s(PLANES.speed_m_s, PLANES.n_max)
    radius_m = speed_m_s / rate_rad_s
    place, heading_rad = 0j, 0.0
    steps = round(age_s / FINE_S)
    for step in range(steps):
        heading_rad += parts[min(4 * step // steps, 3)][0] * rate_rad_s * FINE_S
        place += cmath.rect(speed_m_s * FINE_S, heading_rad)
    centre = place + cmath.rect(radius_m, heading_rad + math.pi / 2.0)
    told = complex(speed_m_s * age_s, radius_m)
    assert abs(centre - told) <= growth_m(speed_m_s, age_s, True, PLANES, DT_S) + 0.1
    assert abs(centre) + radius_m <= growth_m(0.0, age_s, False, PLANES, DT_S) + circle(0.0, PLANES, DT_S)[1] + 0.5


@pytest.mark.parametrize("rules", [COPTERS, PLANES])
@pytest.mark.parametrize("told", [True, False])
def test_a_word_grows_with_its_age_and_a_word_of_now_does_not(rules: Rules, told: bool) -> None:
    grown_m = [growth_m(4.0, 0.25 * k, told, rules, DT_S) for k in range(40)]
    assert grown_m[0] == 0.0
    assert grown_m == sorted(grown_m)
