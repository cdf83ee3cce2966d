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


@pytest.mark.parametrize(("kind", "spacing_m"), [("arducopter", 27.0), ("px4-copter", 41.0)])
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


ENCOUNTER = {
    # Speed m/s, n_max, separation m, half of the way m, arrival radius m.
    "arducopter": (8.0, 0.178, 20.0, 150.0, 20.0),
    "px4-copter": (8.0, 0.2, 20.0, 150.0, 20.0),
    "arduplane": (22.0, 0.7, 40.0, 900.0, 100.0),
    "px4-plane": (15.0, 0.7, 30.0, 600.0, 80.0),
}
Way = tuple[tuple[float, float, float], tuple[float, float]]


def ways_of(encounter: str, half_m: float, separation_m: float) -> list[Way]:
    """Return for both the start (north m, east m, heading deg) and the target (north m, east m) of an encounter."""
    onward: Way = ((0.0, 0.0, 0.0), (2.0 * half_m, 0.0))
    beside_m = 3.0 * separation_m
    return {
        "head-on": [onward, ((2.0 * half_m, 0.0, 180.0), (0.0, 0.0))],
        "crossing": [onward, ((half_m, -half_m, 90.0), (half_m, half_m))],
        "converging": [
            ((0.0, -beside_m, 0.0), (2.0 * half_m, beside_m)),
            ((0.0, beside_m, 0.0), (2.0 * half_m, -beside_m)),
        ],
        "overtaking": [onward, ((-2.0 * beside_m, 0.0, 0.0), (2.0 * half_m, 2.0 * beside_m))],
    }[encounter]


def encounter_of(kind: str, encounter: str, sense: str, wind_m_s: float) -> Mission:
    speed_m_s, n_max, separation_m, half_m, arrival_m = ENCOUNTER[kind]
    ways = ways_of(encounter, half_m, separation_m)
    # Who is overtaken is slower where its kind can be; planes of one speed follow each other.
    slower = 0.6 if encounter == "overtaking" and kind.endswith("copter") else 1.0
    speeds = (slower * speed_m_s, speed_m_s)
    agents = [
        f"north_m: {north_m}, east_m: {east_m}, heading_deg: {heading}, only_target: {k}, speed_m_s: {speeds[k - 1]}"
        for k, ((north_m, east_m, heading), _) in enumerate(ways, start=1)
    ]
    targets = [f"north_m: {north_m}, east_m: {east_m}" for _, (north_m, east_m) in ways]
    lines = (
        f"defaults: {{agent: {{n_max: {n_max}, range_m: 20000}}}}\nbroadcast_period_s: 1\ndetector: {sense}\n"
        f"wind: {{from_deg: 250, speed_m_s: {wind_m_s}}}\narrival_radius_m: {arrival_m}\n"
        f"separation_m: {separation_m}\nmax_time_s: {6.0 * half_m / speed_m_s + 100.0}\n"
    )
    return mission_of(agents, targets, lines)


@pytest.mark.parametrize(
    ("kind", "encounter", "sense", "wind_m_s"),
    [
        ("arducopter", "head-on", "adsb", 0.0),
        ("arducopter", "crossing", "broadcast", 0.0),
        ("arducopter", "overtaking", "broadcast", 0.0),
        ("px4-copter", "crossing", "adsb", 0.0),
        ("px4-copter", "converging", "broadcast", 3.0),
        ("px4-copter", "head-on", "broadcast", 0.0),
        ("arduplane", "head-on", "broadcast", 5.0),
        ("arduplane", "converging", "adsb", 0.0),
        ("arduplane", "overtaking", "adsb", 5.0),
        ("px4-plane", "crossing", "adsb", 5.0),
        ("px4-plane", "converging", "broadcast", 0.0),
    ],
)
def test_two_that_meet_keep_apart_by_what_they_see_or_only_hear(
    kind: str, encounter: str, sense: str, wind_m_s: float
) -> None:
    assert_all_arrive_apart(flown(encounter_of(kind, encounter, sense, wind_m_s), kind), ENCOUNTER[kind][2])


def test_two_copters_that_cross_without_any_sense_meet() -> None:
    result = flown(encounter_of("arducopter", "crossing", "none", 0.0), "arducopter")
    assert result.min_separation_m is not None
    assert result.min_separation_m < 5.0


def test_a_broadcast_of_which_half_is_lost_keeps_two_copters_apart() -> None:
    mission = encounter_of("px4-copter", "crossing", "broadcast", 0.0)
    lossy = mission.model_copy(update={"link": mission.link.model_copy(update={"loss": 0.5})})
    assert_all_arrive_apart(flown(lossy, "px4-copter", seed=3), 20.0)


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
