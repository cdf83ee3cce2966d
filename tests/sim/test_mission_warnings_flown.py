"""Fifty good missions are not warned about and fly as hoped; what is warned about happens in flight."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import pytest
import yaml

from companion.geo.polygon import inside_polygon
from companion.guidance.settings import LawName
from companion.mission.model import Mission, parse_mission
from companion.mission.resolve import resolve
from companion.onboard.lint.warnings import lint_flight
from sim.arena.flight import fly_arena
from sim.lockstep import FlightOptions, fly
from sim.score import Score, score
from tests.sim.good_missions import good_mission


@pytest.mark.parametrize("seed", range(50))
def test_a_good_mission_raises_no_warning(seed: int) -> None:
    mission, kind = good_mission(seed)
    assert lint_flight(mission, "routed", (kind,), mission.name) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 8])
def test_a_mission_without_a_warning_flies_as_its_author_hopes(seed: int) -> None:
    mission, kind = good_mission(seed)
    scored = score(fly(mission, seed, FlightOptions(law="routed", autopilot=kind)).trajectory, mission)
    assert scored.targets_reached == scored.targets
    assert (scored.threat_entries_detection, scored.separation_breaches) == (0, 0)


# What is warned about happens


class Flown(NamedTuple):
    """A flight of a mission that was warned about, and the warnings."""

    warnings: list[str]
    score: Score
    outside_fence: bool


def flown(law: LawName = "routed", **keys: object) -> Flown:
    data = {"max_time_s": 400.0, "arrival_radius_m": 100.0, **keys}
    mission = resolve(parse_mission(yaml.safe_dump(data), "test"), 1)
    flight = fly_arena(mission, 1, law)
    return Flown(
        lint_flight(mission, law, ("kinematic",), "test"),
        score(flight.trajectory, mission),
        _leaves_the_fence(mission, flight.trajectory.agents_ned_m[:, 0].tolist()),
    )


def _leaves_the_fence(mission: Mission, places_m: list[tuple[float, float]]) -> bool:
    return mission.fence is not None and not all(inside_polygon(place, mission.fence) for place in places_m)


def agent(identity: int, north_m: float, east_m: float, heading_deg: float, n_max: float = 1.0) -> dict[str, float]:
    place = {"id": identity, "north_m": north_m, "east_m": east_m, "heading_deg": heading_deg}
    return {**place, "n_max": n_max, "only_target": identity}


def target(identity: int, north_m: float, east_m: float) -> dict[str, float]:
    return {"id": identity, "north_m": north_m, "east_m": east_m}


def disc(identity: int, north_m: float, east_m: float, radius_m: float) -> dict[str, float]:
    radii = {"detection_radius_m": radius_m, "attack_radius_m": 0.5 * radius_m}
    return {"id": identity, "north_m": north_m, "east_m": east_m, **radii}


def ring(count: int, radius_m: float, disc_m: float) -> list[dict[str, Any]]:
    """Return discs about a target at (9000, 0), the first of them to the north of it."""
    turns = [math.tau * number / count for number in range(count)]
    return [
        disc(number + 1, 9000.0 + radius_m * math.cos(turn), radius_m * math.sin(turn), disc_m)
        for number, turn in enumerate(turns)
    ]


@pytest.mark.slow
def test_from_an_uncertified_start_a_disc_is_entered() -> None:
    one = flown(
        agents=[agent(1, 2995.0, 0.0, 0.0)], targets=[target(1, 9000.0, 0.0)], threats=[disc(3, 4000.0, 0.0, 1000.0)]
    )
    assert ["no certified back-up" in warning for warning in one.warnings] == [True]
    assert one.score.threat_entries_detection == 1


@pytest.mark.slow
def test_from_a_start_at_the_fence_it_is_left() -> None:
    fence = [[-2000.0, -2000.0], [9000.0, -2000.0], [9000.0, 2000.0], [-2000.0, 2000.0]]
    one = flown(agents=[agent(1, 0.0, 1999.5, 45.0)], targets=[target(1, 6000.0, 0.0)], fence=fence)
    assert ["m from the fence" in warning for warning in one.warnings] == [True]
    assert one.outside_fence


@pytest.mark.slow
def test_pairs_that_start_too_near_breach_the_separation() -> None:
    one = flown(
        agents=[agent(1, 0.0, 0.0, 0.0), agent(2, 110.0, 0.0, 180.0)],
        targets=[target(1, 6000.0, 150.0), target(2, -6000.0, -150.0)],
        max_time_s=60.0,
    )
    assert ["starts 110 m from agent 1" in warning for warning in one.warnings] == [True]
    assert one.score.separation_breaches > 0


@pytest.mark.slow
def test_vehicles_that_see_each_other_too_late_breach_the_separation() -> None:
    one = flown(
        agents=[agent(1, -3500.0, 0.0, 0.0), agent(2, 3500.0, 0.0, 180.0)],
        targets=[target(1, 8000.0, 0.0), target(2, -8000.0, 0.0)],
        detector_range_m=350.0,
        # In Case I the centre would tell each of the other in time.
        case="II",
    )
    assert ["detector_range_m: 350" in warning for warning in one.warnings] == [True]
    assert one.score.separation_breaches > 0


@pytest.mark.slow
def test_vehicles_of_different_turn_limits_breach_the_separation() -> None:
    one = flown(
        agents=[agent(1, -4000.0, 0.0, 0.0, n_max=0.5), agent(2, 4000.0, 100.0, 180.0, n_max=2.0)],
        targets=[target(1, 8000.0, 0.0), target(2, -8000.0, 100.0)],
        detector_range_m=20000.0,
    )
    assert ["has n_max 0.5 and id 2 2" in warning for warning in one.warnings] == [True]
    assert one.score.separation_breaches > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "keys", "said"),
    [
        ("routed", {"threats": [disc(3, 9300.0, 0.0, 500.0)]}, "200 m inside threat 3"),
        ("routed", {"threats": ring(12, 2000.0, 600.0)}, "walled off"),
        ("routed", {"threats": ring(9, 700.0, 400.0)[1:], "arrival_radius_m": 30.0}, "no room about it"),
        (
            "routed",
            {
                "fence": [[-4000.0, -4000.0], [9010.0, -4000.0], [9010.0, 10.0], [-4000.0, 10.0]],
                "agents": [agent(1, 0.0, -2000.0, 0.0)],
            },
            "no room about it",
        ),
        ("seed", {"threats": [disc(3, 9000.0, 2050.0, 2000.0)], "arrival_radius_m": 30.0}, "farther off"),
        (
            "seed",
            {"targets": [target(1, 0.0, 300.0)], "arrival_radius_m": 30.0, "max_time_s": 150.0},
            "circle its target for ever",
        ),
    ],
    ids=["inside a disc", "behind a ring", "in a yard", "in a corner", "beside a disc", "inside its own turn"],
)
def test_targets_that_are_warned_about_are_not_reached(law: LawName, keys: dict[str, Any], said: str) -> None:
    one = flown(law, **{"agents": [agent(1, 0.0, 0.0, 0.0)], "targets": [target(1, 9000.0, 0.0)], **keys})
    assert [said in warning for warning in one.warnings] == [True]
    assert one.score.targets_reached == 0
