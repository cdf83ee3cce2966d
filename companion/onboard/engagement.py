"""The state of one engagement: kept from tick to tick while the companion steers, and dropped when it stops."""

from __future__ import annotations

from typing import NamedTuple

from companion.guard.types import Setpoint
from companion.onboard.obedience import Obedience


class PositionFix(NamedTuple):
    """A position (north, east) on the picture's plane, and the time when the vehicle was there."""

    position_ned_m: tuple[float, float]
    at_s: float


class GridSetpoint(NamedTuple):
    """A setpoint whose heading is from grid north, and the meridian convergence at the place that it was made for."""

    setpoint: Setpoint
    convergence_rad: float


class Engagement(NamedTuple):
    """What one tick leaves to the next, from the first tick that steers to the first that does not."""

    arrived_ned_m: tuple[float, float] | None = None
    """Where the target was when the vehicle arrived at it; None before that."""
    giving_way: bool = False
    """Whether the vehicle waits because another agent arrives at the target first."""
    at_home: bool = False
    """Whether the vehicle has returned home."""
    loiter_place_ned_m: tuple[float, float] | None = None
    """Where the vehicle loiters; None while it goes somewhere."""
    loiter_about_ned_m: tuple[float, float] | None = None
    """The target or home that this loiter place was chosen for; None if it was chosen for where the vehicle was."""
    target_ned_m: tuple[float, float] | None = None
    """Where the target was that the vehicle last went to; None before the first."""
    refused: bool = False
    """Whether the guard refused the last step, or let the vehicle only continue its back-up."""
    uncertified_from_s: float | None = None
    """Time since which the guard has had no certified back-up; None if it has one."""
    abilities_changed: bool = False
    """Whether the vehicle's abilities now give other limits than those that guard and guidance steer by."""
    climbs: bool = False
    """Whether the vehicle was handed over below `limits.height_min_m` and climbs to it before anything else."""
    last_fix: PositionFix | None = None
    """Position of the vehicle at the last tick."""
    setpoint: GridSetpoint | None = None
    """The setpoint in force; None after one was withdrawn or refused by the guard."""
    jumps: int = 0
    """Number of jumps of the position since the hand-over that the places in here know of."""
    obedience: Obedience = Obedience()
    """How the vehicle has answered its setpoints."""
