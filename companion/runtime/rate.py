"""The beat of the setpoint loop: slots on a fixed grid of the monotonic clock, and how evenly setpoints really left."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

LONG_GAP_S = 0.5
"""An autopilot that hears no setpoint for longer may begin to give the companion up (docs/autopilots.md)."""
STEERING_ENDED_S = 3.0
"""After this time without a setpoint the next one begins another stretch of steering."""
_BIN_S = 1e-3


@dataclass(slots=True)
class LoopRate:
    """Slots every `period_s` from the first on. A slot that was slept through is left out, never made up for."""

    period_s: float
    due_s: float

    def next_after(self, now_s: float) -> float:
        """Move on to the first slot that is still to come, and return its time."""
        self.due_s += self.period_s * max(1, math.floor((now_s - self.due_s) / self.period_s) + 1)
        return self.due_s


def next_due_s(due_s: float, done_s: float, step_s: float) -> float:
    """Return when the next decision is due, after one that was due at `due_s` and was made in the slot at `done_s`.

    One made out of turn, or later than its successor's time, begins the steps anew.
    """
    in_turn = due_s - 0.5 * step_s <= done_s < due_s + step_s
    return (due_s if in_turn else done_s) + step_s


class SetpointGaps:
    """How long it took from each setpoint to the next, counted to the millisecond up to `STEERING_ENDED_S`."""

    def __init__(self) -> None:
        self._counts = np.zeros(round(STEERING_ENDED_S / _BIN_S) + 1, dtype=np.int64)
        self._last_s: float | None = None
        self._recent_max_s = 0.0
        self.max_s = 0.0
        self.long = 0
        """How many were over `LONG_GAP_S`."""

    def note(self, now_s: float) -> None:
        """Note that a setpoint left."""
        last_s, self._last_s = self._last_s, now_s
        if last_s is None or now_s - last_s >= STEERING_ENDED_S:
            return
        gap_s = now_s - last_s
        self._counts[round(gap_s / _BIN_S)] += 1
        self.max_s = max(self.max_s, gap_s)
        self._recent_max_s = max(self._recent_max_s, gap_s)
        self.long += gap_s > LONG_GAP_S

    def end(self) -> None:
        """Note that the steering ended: what comes next is no gap."""
        self._last_s = None

    @property
    def count(self) -> int:
        """How many gaps were noted."""
        return int(self._counts.sum())

    def quantile_s(self, share: float) -> float:
        """Return the gap that this share of all did not exceed, to the millisecond; NaN without any."""
        if not self.count:
            return math.nan
        return float(np.searchsorted(np.cumsum(self._counts), share * self.count)) * _BIN_S

    def take_recent_max_s(self) -> float:
        """Return the longest gap since the last call, 0 without any."""
        longest_s, self._recent_max_s = self._recent_max_s, 0.0
        return longest_s

    @property
    def summary(self) -> str:
        """All of it in a line."""
        if not self.count:
            return "no setpoints sent"
        return (
            f"{self.count} setpoint gaps: median {1e3 * self.quantile_s(0.5):.0f} ms, "
            f"99 % within {1e3 * self.quantile_s(0.99):.0f} ms, longest {1e3 * self.max_s:.0f} ms, "
            f"{self.long or 'none'} over {LONG_GAP_S:g} s"
        )
