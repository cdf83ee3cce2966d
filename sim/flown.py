"""A flown mission with its trajectory and score: the input of figures and reports."""

from __future__ import annotations

from dataclasses import dataclass

from companion.mission.model import Mission
from sim.changes import Change
from sim.score import Score
from sim.trajectory import Trajectory

KINEMATIC = "kinematic simulator"
"""The vehicles' name in reports and figures if they are kinematic points, not stand-ins of an autopilot."""


@dataclass(frozen=True)
class FlownMission:
    """One flight of a resolved mission, and its score."""

    mission: Mission
    trajectory: Trajectory
    score: Score
    seed: int
    law: str
    stand_in: str = KINEMATIC
    """Which vehicles flew, in words for reports and figures."""
    ended_early: str | None = None
    """Why the flight was ended early; None if it flew to its end."""
    changes: tuple[Change, ...] = ()
    """What was there from when on, if things were added, changed or retired; the mission has all that ever were."""
