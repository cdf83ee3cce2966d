"""The stand-ins fly the missions that real programs are flown through, a few of each sort, and keep their promises."""

from __future__ import annotations

import pytest

from sim.lockstep import FlightOptions, fly
from sim.score import score
from tests.real.flight import SEED
from tests.real.lane import Job

pytestmark = pytest.mark.slow
FLOWN = (
    "discs:arducopter",
    "discs:arduplane",
    "discs:px4-copter",
    "discs:px4-copter-low-drag",
    "discs:px4-plane",
    "wind-5:arducopter",
    "wind-7:arducopter",
    "wind-7-others:arduplane",
    "crossing:arducopter",
    "crossing-adsb:px4-copter",
    "three-crossing:arduplane",
)


@pytest.mark.parametrize("name", FLOWN)
def test_a_stand_in_reaches_every_target_without_an_entry_or_a_breach(name: str) -> None:
    job = Job.named(name)
    mission = job.scenario.mission(job.kind)
    parameters = tuple(job.scenario.stand_in_parameters(job.kind).items())
    options = FlightOptions(law="routed", autopilot=job.kind.name, parameters=parameters)
    scored = score(fly(mission, SEED, options).trajectory, mission)
    assert (scored.threat_entries_detection, scored.separation_breaches) == (0, 0)
    assert scored.targets_reached == scored.targets
