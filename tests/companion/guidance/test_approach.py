"""How a vehicle that can stop changes its velocity, slows down before a place and turns by slowing down."""

from __future__ import annotations

import cmath
import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from companion.guidance.approach import (
    CRUISING_SHARE,
    Flown,
    Pace,
    approach_m,
    approach_speed_m_s,
    bounded,
    led,
    time_to_stand_s,
)

COPTER = Pace(cruise_m_s=8.0, braking_m_s2=2.0, sideways_m_s2=1.75, reaction_s=0.2, dt_s=0.5)
HEADINGS = st.floats(0.0, math.tau)
PACES = st.builds(
    Pace,
    cruise_m_s=st.floats(2.0, 15.0),
    braking_m_s2=st.floats(1.0, 5.0),
    sideways_m_s2=st.floats(1.0, 5.0),
    reaction_s=st.floats(0.0, 1.0),
    dt_s=st.floats(0.1, 1.0),
)


@st.composite
def _velocities(draw: st.DrawFn) -> tuple[Pace, Flown, Flown]:
    pace = draw(PACES)
    before, wanted = (Flown(draw(HEADINGS), draw(st.floats(0.0, pace.cruise_m_s))) for _ in range(2))
    return pace, before, wanted


@given(_velocities(), st.floats(0.0, 500.0))
def test_a_step_changes_the_velocity_by_no_more_than_braking_speeding_up_and_turning_allow(
    drawn: tuple[Pace, Flown, Flown], to_go_m: float
) -> None:
    pace, before, wanted = drawn
    assume(min(before.speed_m_s, wanted.speed_m_s) < CRUISING_SHARE * pace.cruise_m_s)
    after = bounded(before, wanted, to_go_m, pace)
    turn_rad = abs(math.remainder(after.heading_rad - before.heading_rad, math.tau))
    most_rad = pace.sideways_m_s2 * pace.dt_s / max(before.speed_m_s, after.speed_m_s, 0.5)
    if turn_rad <= most_rad:
        most_m_s2 = max(1.25 * pace.braking_m_s2, pace.sideways_m_s2)
        assert abs(after.vector - before.vector) <= most_m_s2 * pace.dt_s + 1e-9


@given(_velocities())
def test_what_is_wanted_comes_nearer_with_every_step_and_is_reached(drawn: tuple[Pace, Flown, Flown]) -> None:
    pace, flown, wanted = drawn
    assume(min(flown.speed_m_s, wanted.speed_m_s) < CRUISING_SHARE * pace.cruise_m_s)
    least_m_s = min(pace.braking_m_s2, pace.sideways_m_s2) * pace.dt_s
    for _ in range(8 + math.ceil(6.0 * pace.cruise_m_s / least_m_s + math.pi / (pace.sideways_m_s2 * pace.dt_s))):
        after = bounded(flown, wanted, 0.0, pace)
        turn_rad = math.remainder(after.heading_rad - flown.heading_rad, math.tau)
        most_rad = pace.sideways_m_s2 * pace.dt_s / max(flown.speed_m_s, after.speed_m_s, 0.5)
        flown = Flown(flown.heading_rad + min(max(turn_rad, -most_rad), most_rad), after.speed_m_s)
    assert abs(flown.vector - wanted.vector) < 1e-6


@pytest.mark.parametrize("turn_deg", [-80.0, 10.0, 60.0])
def test_on_its_way_a_vehicle_keeps_its_speed_in_turns(turn_deg: float) -> None:
    wanted = Flown(math.radians(turn_deg), 8.0)
    assert bounded(Flown(0.0, 8.0), wanted, 1_000.0, COPTER) == wanted


@pytest.mark.parametrize(("turn_deg", "to_go_m"), [(180.0, 1_000.0), (120.0, 1_000.0), (80.0, 40.0)])
def test_to_turn_around_and_to_what_lies_inside_its_turning_circle_it_slows_down(
    turn_deg: float, to_go_m: float
) -> None:
    assert bounded(Flown(0.0, 8.0), Flown(math.radians(turn_deg), 8.0), to_go_m, COPTER).speed_m_s < 7.7


def test_from_a_standstill_a_vehicle_gathers_speed_the_way_it_wants() -> None:
    after = bounded(Flown(0.0, 0.0), Flown(0.6, 8.0), 1_000.0, COPTER)
    assert (after.heading_rad, after.speed_m_s) == pytest.approx((0.6, 1.25))


def test_what_lies_behind_one_that_stands_is_turned_to_before_it_is_flown_to() -> None:
    assert bounded(Flown(0.0, 0.0), Flown(math.pi, 8.0), 1_000.0, COPTER).speed_m_s < 0.2


@given(PACES, st.floats(0.0, 300.0), st.floats(0.0, 50.0))
def test_the_farther_the_place_the_faster_it_is_approached_and_never_faster_than_cruise(
    pace: Pace, distance_m: float, farther_m: float
) -> None:
    nearer, farther = (approach_speed_m_s(away_m, pace) for away_m in (distance_m, distance_m + farther_m))
    assert nearer <= farther <= pace.cruise_m_s
    assert nearer * nearer <= 2.0 * pace.braking_m_s2 * distance_m + 1e-9


@given(PACES, st.floats(0.01, 0.99))
def test_a_vehicle_slows_down_where_the_way_to_a_place_is_as_long_as_the_approach(pace: Pace, share: float) -> None:
    speed_m_s = share * pace.cruise_m_s
    left_m = approach_m(speed_m_s, pace) - speed_m_s * pace.delay_s
    assert approach_speed_m_s(left_m, pace) == pytest.approx(speed_m_s)


def test_a_command_is_no_farther_ahead_of_the_flown_velocity_than_a_lag_explains() -> None:
    ahead = led(Flown(0.0, 8.0), Flown(0.0, 7.0), COPTER)
    assert ahead == Flown(0.0, 8.0)
    # A lag of a second at 2.5 m/s^2, or a quarter turn ahead of what it flies.
    for measured_m_s, most_m_s in ((1.0, 2.5 * (0.2 + 0.5 + 1.0)), (8.0, 8.0 * math.sqrt(2.0))):
        brought_back = led(Flown(0.0, 8.0), Flown(math.pi, measured_m_s), COPTER)
        assert abs(brought_back.vector - cmath.rect(measured_m_s, math.pi)) == pytest.approx(most_m_s)


@pytest.mark.parametrize(("north_m", "speed_m_s", "takes_s"), [(0.3, 0.1, 0.0), (30.0, 8.0, 9.0), (-30.0, 8.0, 17.0)])
def test_the_time_to_stand_is_that_of_a_copter(north_m: float, speed_m_s: float, takes_s: float) -> None:
    found_s = time_to_stand_s(complex(north_m), 0j, Flown(0.0, speed_m_s), COPTER, 40.0)
    assert found_s == pytest.approx(takes_s, abs=1.0)


def test_a_place_that_is_too_far_away_is_not_stood_at_in_time() -> None:
    assert time_to_stand_s(200 + 0j, 0j, Flown(0.0, 8.0), COPTER, 13.0) == math.inf


@given(PACES, HEADINGS, st.floats(0.0, 1.0), st.floats(0.0, 40.0), HEADINGS)
def test_a_place_is_stood_at_from_anywhere_near(
    pace: Pace, heading_rad: float, share: float, away_m: float, bearing_rad: float
) -> None:
    pace = pace._replace(dt_s=min(pace.dt_s, 0.5))
    flown = Flown(heading_rad, share * pace.cruise_m_s)
    place = cmath.rect(away_m, bearing_rad)
    assert time_to_stand_s(place, 0j, flown, pace, 120.0) < math.inf
