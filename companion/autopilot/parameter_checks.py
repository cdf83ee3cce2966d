"""The demands of `companion check` on autopilot parameters that decide what the vehicle does if its companion dies."""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.autopilot.parameters import Told


@dataclass(frozen=True)
class ParameterCheck:
    """The values allowed for one parameter (by its first name in `Wanted`, in that name's unit), reason and remedy."""

    name: str
    why: str
    best: float
    """The value that a person is told to set."""
    least: float = -math.inf
    greatest: float = math.inf
    allowed: tuple[float, ...] = ()
    """The only allowed values; if empty, `least` and `greatest` bound the value."""
    when_fenced: bool = False
    """Whether the check applies only to a vehicle whose companion has a fence or exclusions."""
    further: str = ""
    """What the remedy says after the value, beginning with a space."""
    when_told: bool = False
    """Whether the check applies only to a vehicle that has the parameter: some versions do not."""
    by_size: bool = False
    """Whether only the value's size counts: a radius below 0 is a circle to the left."""

    def met_by(self, value: float) -> bool:
        """Return whether a value is allowed."""
        value = abs(value) if self.by_size else value
        return value in self.allowed if self.allowed else self.least <= value <= self.greatest

    def words(self, told: Told) -> str:
        """Return the allowed values in words and in the unit that the vehicle uses."""
        if self.allowed:
            return " or ".join(f"{told.in_its_unit(value):g}" for value in self.allowed)
        least, greatest = told.in_its_unit(self.least), told.in_its_unit(self.greatest)
        if self.least == -math.inf:
            return f"at most {greatest:g}"
        if self.greatest == math.inf:
            return f"at least {least:g}"
        left = f", or {-greatest:g} to {-least:g} (to the left)" if self.by_size else ""
        return f"{least:g} to {greatest:g}{left}"

    def best_for(self, told: Told) -> float:
        """Return the value to set in the unit that the vehicle uses; where only the size counts, to the same side."""
        best = told.in_its_unit(self.best)
        return math.copysign(best, told.value) if self.by_size else best

    def remedy(self, told: Told) -> str:
        """Return what to set, by the name and in the unit that the vehicle uses: in another it would be dangerous."""
        return f"set {told.name} to {self.best_for(told):g}{self.further}"
