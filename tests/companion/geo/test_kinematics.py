"""The arcs must be exact, or the truth of a run would depend on its step."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from companion.geo.kinematics import advance, shorter_turn_rad, turn_towards

headings_rad = st.floats(-math.pi, math.pi)
speeds_m_s = st.floats(0.1, 300.0)
rates_rad_s = st.floats(-3.0, 3.0)
steps_s = st.floats(0.001, 5.0)


def circular_difference_rad(first_rad: float, second_rad: float) -> float:
    return abs(math.remainder(first_rad - second_rad, math.tau))


@given(headings_rad, speeds_m_s, rates_rad_s, steps_s)
def test_two_half_steps_of_an_arc_are_one_step(heading: float, speed: float, rate: float, dt: float) -> None:
    whole = advance(0.0, 0.0, heading, speed, rate, dt)
    halves = advance(*advance(0.0, 0.0, heading, speed, rate, dt / 2), speed, rate, dt / 2)
    assert math.dist(whole[:2], halves[:2]) <= 1e-9 * speed * dt
    assert circular_difference_rad(whole[2], halves[2]) <= 1e-9


@given(headings_rad, speeds_m_s, rates_rad_s, steps_s)
def test_an_arc_has_the_length_of_speed_times_time(heading: float, speed: float, rate: float, dt: float) -> None:
    north, east, pieces, length = 0.0, 0.0, 2000, 0.0
    turned = heading
    for _ in range(pieces):
        last = (north, east)
        north, east, turned = advance(north, east, turned, speed, rate, dt / pieces)
        length += math.dist(last, (north, east))
    assert length == pytest.approx(speed * dt, rel=1e-5)


@given(headings_rad, speeds_m_s, st.floats(0.01, 3.0), st.sampled_from([-1.0, 1.0]), steps_s)
def test_an_arc_keeps_the_distance_speed_over_rate_to_its_centre(
    heading: float, speed: float, rate: float, side: float, dt: float
) -> None:
    radius = speed / rate
    to_centre = heading + side * math.pi / 2
    centre = (radius * math.cos(to_centre), radius * math.sin(to_centre))
    north, east, _ = advance(0.0, 0.0, heading, speed, side * rate, dt)
    assert math.dist((north, east), centre) == pytest.approx(radius, rel=1e-9)


@given(headings_rad, st.floats(1e-300, 1e-9))
def test_a_tiny_rate_flies_straight_to_the_last_digit(heading: float, rate: float) -> None:
    curved = advance(0.0, 0.0, heading, 60.0, rate, 0.5)
    straight = advance(0.0, 0.0, heading, 60.0, 0.0, 0.5)
    assert math.dist(curved[:2], straight[:2]) < 1e-7


def test_a_full_circle_returns_to_its_start() -> None:
    north, east, heading = advance(3.0, 4.0, 1.0, 60.0, math.tau / 20.0, 20.0)
    assert (north, east, heading) == pytest.approx((3.0, 4.0, 1.0), abs=1e-9)


def test_a_positive_rate_turns_clockwise_from_north_to_east() -> None:
    north, east, heading = advance(0.0, 0.0, 0.0, 10.0, math.pi / 2, 1.0)
    radius = 10.0 / (math.pi / 2)
    assert (north, east, heading) == pytest.approx((radius, radius, math.pi / 2))


@given(headings_rad, headings_rad, speeds_m_s, st.floats(0.01, 3.0), steps_s)
def test_two_half_turns_towards_a_heading_are_one(
    heading: float, wanted: float, speed: float, rate: float, dt: float
) -> None:
    whole = turn_towards(0.0, 0.0, heading, speed, wanted, rate, dt)
    first = turn_towards(0.0, 0.0, heading, speed, wanted, rate, dt / 2)
    halves = turn_towards(*first[:2], first[2], speed, wanted, rate, dt / 2)
    assert math.dist(whole[:2], halves[:2]) <= 1e-6 * speed * dt
    assert circular_difference_rad(whole[2], halves[2]) <= 1e-9


@given(headings_rad, headings_rad, speeds_m_s, st.floats(0.0, 3.0), steps_s)
def test_a_turn_never_exceeds_the_rate_nor_overshoots(
    heading: float, wanted: float, speed: float, rate: float, dt: float
) -> None:
    after = turn_towards(0.0, 0.0, heading, speed, wanted, rate, dt)[2]
    before_rad = abs(shorter_turn_rad(heading, wanted))
    assert circular_difference_rad(after, heading) <= rate * dt + 1e-9
    assert circular_difference_rad(after, wanted) == pytest.approx(max(before_rad - rate * dt, 0.0), abs=1e-9)


@given(headings_rad)
@example(0.0)
@example(math.pi)
@example(-math.pi)
@example(0.1)
def test_half_a_circle_is_turned_to_the_right(heading: float) -> None:
    for wanted in (heading + math.pi, heading - math.pi):
        assert turn_towards(0.0, 0.0, heading, 60.0, wanted, 0.5, 0.5)[2] == pytest.approx(
            math.remainder(heading + 0.25, math.tau), abs=1e-9
        )


def test_the_rest_of_the_step_after_the_turn_is_straight() -> None:
    north, east, heading = turn_towards(0.0, 0.0, 0.0, 10.0, math.pi / 2, math.pi / 2, 3.0)
    radius = 10.0 / (math.pi / 2)
    assert (north, east, heading) == pytest.approx((radius, radius + 20.0, math.pi / 2))
