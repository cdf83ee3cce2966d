"""The demands of `companion check` on autopilot parameters that decide what the vehicle does if its companion dies."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class ParameterCheck:
    """The values allowed for one parameter (by its first name in `Wanted`), the reason, and the remedy."""

    name: str
    why: str
    remedy: str
    least: float = -math.inf
    greatest: float = math.inf
    allowed: tuple[float, ...] = ()
    """The only allowed values; if empty, `least` and `greatest` bound the value."""
    when_fenced: bool = False
    """Whether the check applies only to a vehicle whose companion has a fence or exclusions."""

    def met_by(self, value: float) -> bool:
        """Return whether a value is allowed."""
        return value in self.allowed if self.allowed else self.least <= value <= self.greatest

    @property
    def words(self) -> str:
        """The allowed values in words, for messages."""
        if self.allowed:
            return " or ".join(f"{value:g}" for value in self.allowed)
        if self.least == -math.inf:
            return f"at most {self.greatest:g}"
        if self.greatest == math.inf:
            return f"at least {self.least:g}"
        return f"{self.least:g} to {self.greatest:g}"
