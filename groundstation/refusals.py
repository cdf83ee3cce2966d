"""What the ground station's inputs said and is not believed: counted by cause, and told in a line each.

The first of a kind is told at once, later ones with their number once in TOLD_PERIOD_S, so that a flood of them is a
line a minute. The table is bounded, as what comes in may be anything.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

TOLD_PERIOD_S = 60.0
"""Least time between two lines about the same cause."""
MOST_CAUSES = 64
"""Greatest number of causes that are counted by themselves; any further one counts with the others."""
_OTHERS = "others"


@dataclass
class _Cause:
    """A cause of refusals, and what was told of it."""

    words: str
    """Sentence about the last refusal, with `{}` in the place of the number."""
    count: int = 0
    told: int = 0
    told_at_s: float | None = None


class Refusals:
    """Counts what was refused, by cause."""

    def __init__(self) -> None:
        self._causes: dict[Hashable, _Cause] = {}

    def add(self, cause: Hashable, words: str) -> None:
        """Count one refusal; `words` is the sentence about it, with `{}` in the place of the number of refusals."""
        if cause not in self._causes and len(self._causes) >= MOST_CAUSES:
            cause, words = _OTHERS, "inputs: {} refused for other causes"
        known = self._causes.setdefault(cause, _Cause(words))
        known.words = words
        known.count += 1

    def count(self, cause: Hashable) -> int:
        """Return how often something was refused for a cause."""
        return self._causes[cause].count if cause in self._causes else 0

    @property
    def total(self) -> int:
        """Number of all refusals."""
        return sum(cause.count for cause in self._causes.values())

    def news(self, now_s: float) -> list[str]:
        """Return the lines that are due."""
        lines = []
        for cause in self._causes.values():
            is_due = cause.told_at_s is None or now_s - cause.told_at_s >= TOLD_PERIOD_S
            if cause.count > cause.told and is_due:
                lines.append(cause.words.format(cause.count))
                cause.told, cause.told_at_s = cause.count, now_s
        return lines
