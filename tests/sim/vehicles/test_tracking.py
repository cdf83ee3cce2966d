"""Each kind, flown by its adapter on its stand-in, stays where guidance and guard reckon with it."""

from __future__ import annotations

import math

import pytest

from tests.sim.vehicles.tracking import HEIGHT_M, TURNS_RAD, Flight, off, turned

KINDS = [("arducopter", 8.0), ("arduplane", 22.0), ("px4-copter", 10.0), ("px4-plane", 15.0)]


@pytest.mark.parametrize(("kind", "speed_m_s"), KINDS)
@pytest.mark.parametrize("turn", ["S", "360"])
def test_a_vehicle_that_turns_as_fast_as_it_may_stays_on_the_reckoned_path(
    kind: str, speed_m_s: float, turn: str
) -> None:
    flight = Flight(kind, speed_m_s)
    start_s, rate_rad_s = turned(flight, TURNS_RAD[turn])
    abilities = flight.adapter.abilities
    assert off(flight, start_s, rate_rad_s, abilities.reaction_s).place_m <= abilities.tracking_m


@pytest.mark.parametrize(("kind", "speed_m_s"), KINDS)
def test_the_parameters_are_read_from_the_stand_in_before_a_person_hands_over(kind: str, speed_m_s: float) -> None:
    flight = Flight(kind, speed_m_s)
    assert flight.adapter.parameters_known
    assert flight.adapter.abilities.assumed == ()
    assert flight.adapter.failures == ()


@pytest.mark.parametrize(("kind", "speed_m_s"), KINDS)
def test_in_wind_the_course_over_the_ground_is_the_one_decided(kind: str, speed_m_s: float) -> None:
    flight = Flight(kind, speed_m_s, wind_m_s=(0.0, 3.0))
    while flight.now_s < 20.0:
        flight.decide(0.0)
    course_rad = [abs(place.course_rad) for place in flight.flown if place.t_s > 15.0]
    assert max(course_rad) < math.radians(1.5)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "speed_m_s"), KINDS)
def test_a_change_of_height_is_flown(kind: str, speed_m_s: float) -> None:
    flight = Flight(kind, speed_m_s)
    for height_m in (HEIGHT_M + 30.0, HEIGHT_M - 10.0):
        for _ in range(140):
            flight.decide(0.0, height_m)
        assert flight.vehicle.truth.altitude_m == pytest.approx(height_m, abs=2.0)
    assert not flight.adapter.failures
