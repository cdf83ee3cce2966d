"""What one tick decided, and why (docs/design.md, rule 6)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from companion.guard.types import NO_BACKUP, Setpoint
from companion.onboard.failsafe import Stage


class Purpose(Enum):
    """What the companion is doing. Order and values are on the wire and in logs."""

    IDLE = "idle"
    """Not steering: no telemetry, or the safety pilot has the vehicle."""
    TARGET = "target"
    LOITER = "loiter"
    RETURN = "return"


@dataclass(frozen=True)
class Decision:
    """One tick's decision and why. Headings are from grid north."""

    t_s: float
    purpose: Purpose
    reason: str
    stage: Stage
    picture_age_s: float | None
    target_id: int | None = None
    wanted_heading_rad: float = math.nan
    """Before the turn limit."""
    turn_limited: bool = False
    setpoint: Setpoint | None = None
    guard_changes: tuple[str, ...] = ()
    broken: tuple[str, ...] = ()
    """Assumptions of the guard's that do not hold (docs/guard.md)."""
    gave_way: str | None = None
    """What the right of way changed."""
    note: str | None = None
    """What else the law says of it."""
    stay: str | None = None
    """Why the law could do no better than to loiter."""
    opposed: bool = False
    """The surrogate's component against the route was dropped."""
    triggers: tuple[str, ...] = ()
    """All that speaks for the stage or a milder one, the most severe first."""

    @property
    def uncertified(self) -> bool:
        """Whether the guard had no certified back-up for this decision."""
        return NO_BACKUP in self.guard_changes
