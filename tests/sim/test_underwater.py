"""The slow vehicle that cannot stop and hears little: the paper's underwater vehicle, on the packaged mission."""

from __future__ import annotations

import functools

import pytest

from companion.geo.kinematics import GRAVITY_M_S2
from companion.mission.model import Mission, load_mission
from companion.mission.resolve import resolve
from sim.lockstep import Flight, FlightOptions, fly
from sim.score import score

pytestmark = pytest.mark.slow


@functools.cache
def flown() -> tuple[Mission, Flight]:
    mission = resolve(load_mission("underwater"), 1)
    return mission, fly(mission, 1, FlightOptions(law="routed"))


def test_the_vehicle_is_slow_and_turns_in_circles_of_tens_of_metres() -> None:
    for agent in load_mission("underwater").agents:
        radius_m = agent.speed_m_s**2 / (agent.n_max * GRAVITY_M_S2)
        assert agent.speed_m_s == 2.0 and 10.0 < radius_m < 100.0


def test_it_hears_a_broadcast_minutes_apart_and_loses_a_third_of_it() -> None:
    mission, flight = flown()
    assert mission.broadcast_period_s >= 120.0
    assert flight.frames_lost > flight.broadcast_frames * len(mission.agents) / 3.0


def test_everybody_arrives_without_an_entry() -> None:
    mission, flight = flown()
    result = score(flight.trajectory, mission)
    assert result.targets_reached == result.targets == 3
    assert (result.threat_entries_detection, result.worst_depth_m, result.separation_breaches) == (0, 0.0, 0)
