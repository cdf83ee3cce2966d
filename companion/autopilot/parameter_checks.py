"""What `companion check` checks in an autopilot's parameters: on them rests what a dead companion leaves behind."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class ParameterCheck:
    """A parameter by its first name, what it may be, why, and what to do about another value."""

    name: str
    why: str
    remedy: str
    least: float = -math.inf
    greatest: float = math.inf
    allowed: tuple[float, ...] = ()
    """Where only these will do."""
    when_fenced: bool = False
    """Demanded only of a vehicle whose companion has a fence."""

    def met_by(self, value: float) -> bool:
        """Return whether a value will do."""
        return value in self.allowed if self.allowed else self.least <= value <= self.greatest

    @property
    def words(self) -> str:
        """What is allowed, in words."""
        if self.allowed:
            return " or ".join(f"{value:g}" for value in self.allowed)
        if self.least == -math.inf:
            return f"at most {self.greatest:g}"
        if self.greatest == math.inf:
            return f"at least {self.least:g}"
        return f"{self.least:g} to {self.greatest:g}"
