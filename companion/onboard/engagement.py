"""What is remembered while the companion steers, and forgotten when it no longer does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from companion.guard.types import Setpoint


class PositionFix(NamedTuple):
    """A position on the plane of the picture, and when it was true."""

    position_ned_m: tuple[float, float]
    at_s: float


class GridSetpoint(NamedTuple):
    """A setpoint from grid north, and the convergence at the place that it was made for."""

    setpoint: Setpoint
    convergence_rad: float


@dataclass(frozen=True)
class Engagement:
    """The latches of one engagement: from the first tick that steers to the first that does not."""

    arrived: bool = False
    giving_way: bool = False
    """Whether another agent arrives first."""
    at_home: bool = False
    loiter_place_ned_m: tuple[float, float] | None = None
    """Where it loiters; None while it goes somewhere."""
    uncertified_from_s: float | None = None
    """Since when the guard has had no certified back-up."""
    abilities_changed: bool = False
    """Whether the vehicle can now do other things than those that guard and guidance keep to."""
    last_fix: PositionFix | None = None
    """Where the last tick found the vehicle."""
    setpoint: GridSetpoint | None = None
    """The setpoint that stands; None after one that was withdrawn or that the guard did not allow."""
