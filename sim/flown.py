"""A mission that was flown, as its figures and its report show it."""

from __future__ import annotations

from dataclasses import dataclass

from companion.mission.model import Mission
from sim.score import Score
from sim.trajectory import Trajectory

KINEMATIC = "kinematic simulator"
"""What flew, as reports and figures say it, where no stand-in of an autopilot did."""


@dataclass(frozen=True)
class FlownMission:
    """One flight of a resolved mission and what it came to."""

    mission: Mission
    trajectory: Trajectory
    score: Score
    seed: int
    law: str
    stand_in: str = KINEMATIC
    """What flew."""
