"""Whole flights of vehicles among each other: whoever waits goes on, all arrive, and the separation holds."""

from __future__ import annotations

import pytest

from companion.mission.model import Mission, parse_mission
from companion.mission.resolve import resolve
from sim.lockstep import FlightOptions, fly
from sim.score import Score, score

pytestmark = pytest.mark.slow

COPTERS = ("arducopter", "px4-copter")
LIMITS = """
defaults: {agent: {speed_m_s: 7, n_max: 0.2, range_m: 9000}}
arrival_radius_m: 25
separation_m: 22
detector_range_m: 500
"""


def flown(mission: Mission, kind: str = "kinematic", seed: int = 1) -> Score:
    """Return the score of a flight of a mission whose numbers fit the vehicle already."""
    return score(fly(mission, seed, FlightOptions(law="routed", autopilot=kind)).trajectory, mission)


def mission_of(agents: list[str], targets: list[str], lines: str) -> Mission:
    """Return a mission of agents and targets, given by the words that follow their ids."""
    parts = [f"agents:\n{_numbered(agents)}", f"targets:\n{_numbered(targets, ', speed_bound_m_s: 0')}", lines]
    return resolve(parse_mission("name: among each other\n" + "".join(parts), "among each other"), 1)


def _numbered(words: list[str], more: str = "") -> str:
    return "".join(f"  - {{id: {k}, {each}{more}}}\n" for k, each in enumerate(words, start=1))


def assert_all_arrive_apart(result: Score, least_m: float) -> None:
    assert result.targets_reached == result.targets
    assert result.separation_breaches == 0
    assert result.min_separation_m is not None
    assert result.min_separation_m >= least_m


@pytest.mark.parametrize("kind", COPTERS)
@pytest.mark.parametrize("across_m", [60.0, 250.0])
def test_two_copters_that_cross_do_not_wait_for_each_other_for_ever(kind: str, across_m: float) -> None:
    agents = [
        f"north_m: 0, east_m: {east_m}, heading_deg: 0, only_target: {k}" for k, east_m in ((1, 0), (2, across_m))
    ]
    targets = [f"north_m: 420, east_m: {across_m}", "north_m: 420, east_m: 0"]
    assert_all_arrive_apart(flown(mission_of(agents, targets, LIMITS + "max_time_s: 300\n"), kind), 22.0)


@pytest.mark.parametrize("kind", COPTERS)
@pytest.mark.parametrize("spacing_m", [27.0, 41.0])
def test_a_row_of_copters_takes_off_beside_discs(kind: str, spacing_m: float) -> None:
    agents = [f"north_m: 30, east_m: {40 + k * spacing_m}" for k in range(4)]
    ends = ((900, 700), (1000, 380), (800, 60), (300, 900))
    targets = [f"north_m: {north_m}, east_m: {east_m}" for north_m, east_m in ends]
    discs = """
threats:
  - {id: 1, north_m: 500, east_m: 300, detection_radius_m: 180, attack_radius_m: 90, speed_bound_m_s: 0}
  - {id: 2, north_m: 650, east_m: 760, detection_radius_m: 120, attack_radius_m: 60, speed_bound_m_s: 0}
max_time_s: 500
"""
    result = flown(mission_of(agents, targets, LIMITS + discs), kind)
    assert_all_arrive_apart(result, 22.0)
    assert result.threat_entries_detection == 0


def test_the_last_of_two_columns_of_planes_finds_its_target_free() -> None:
    def places(begin_m: float, step_m: float, count: int) -> list[float]:
        return [begin_m + k * step_m for k in range(count)]

    agents = [f"north_m: {at}, east_m: 0, heading_deg: 0" for at in places(-3500.0, -1600.0, 5)]
    agents += [f"north_m: 0, east_m: {at}, heading_deg: 90" for at in places(-3500.0, -1600.0, 5)]
    agents = [f"{words}, only_target: {k}" for k, words in enumerate(agents, start=1)]
    targets = [f"north_m: {at}, east_m: 0" for at in places(6500.0, 1550.0, 5)]
    targets += [f"north_m: 0, east_m: {at}" for at in places(6500.0, 1550.0, 5)]
    lines = "defaults: {agent: {speed_m_s: 60, n_max: 1}}\narrival_radius_m: 100\nseparation_m: 100\nmax_time_s: 800\n"
    assert_all_arrive_apart(flown(mission_of(agents, targets, lines)), 100.0)
