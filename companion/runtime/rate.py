"""The rate of the setpoint loop: slots on a fixed grid of the monotonic clock, and measured gaps between setpoints."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

LONG_GAP_S = 0.5
"""Gap between two setpoints after which an autopilot may begin to give the companion up (docs/autopilots.md)."""
STEERING_ENDED_S = 3.0
"""Pause that counts as the end of the steering, not as a gap between two setpoints."""
_BIN_S = 1e-3
"""Width of a bin of the histogram of gaps."""


@dataclass(slots=True)
class LoopRate:
    """Slots every `period_s` seconds from the first one on. A slot that was missed is left out, never made up for."""

    period_s: float
    due_s: float
    """Time of the current slot, by the monotonic clock."""

    def next_after(self, now_s: float) -> float:
        """Move on to the next slot that is later than `now_s`, and return its time."""
        self.due_s += self.period_s * max(1, math.floor((now_s - self.due_s) / self.period_s) + 1)
        return self.due_s


def next_due_s(due_s: float, done_s: float, step_s: float) -> float:
    """Return when the next decision is due, after one that was due at `due_s` and was made in the slot at `done_s`.

    It is due a step after `due_s`, or a step after `done_s` where the decision was made more than half a step early or
    at least a whole step late. Times are of the monotonic clock.
    """
    in_turn = due_s - 0.5 * step_s <= done_s < due_s + step_s
    return (due_s if in_turn else done_s) + step_s


class SetpointGaps:
    """Statistics of the gaps between successive setpoints, to the millisecond.

    A pause of `STEERING_ENDED_S` or more is not counted.
    """

    def __init__(self) -> None:
        self._counts = np.zeros(round(STEERING_ENDED_S / _BIN_S) + 1, dtype=np.int64)
        self._last_s: float | None = None
        self._recent_max_s = 0.0
        self.max_s = 0.0
        self.long = 0
        """Number of gaps longer than `LONG_GAP_S`."""

    def note(self, now_s: float) -> None:
        """Note that a setpoint was sent at `now_s`."""
        last_s, self._last_s = self._last_s, now_s
        if last_s is None or now_s - last_s >= STEERING_ENDED_S:
            return
        gap_s = now_s - last_s
        self._counts[round(gap_s / _BIN_S)] += 1
        self.max_s = max(self.max_s, gap_s)
        self._recent_max_s = max(self._recent_max_s, gap_s)
        self.long += gap_s > LONG_GAP_S

    def end(self) -> None:
        """Note that the steering ended: the time until the next setpoint is no gap."""
        self._last_s = None

    @property
    def count(self) -> int:
        """Number of gaps noted."""
        return int(self._counts.sum())

    def quantile_s(self, share: float) -> float:
        """Return the gap that a share (0 to 1) of all gaps did not exceed, to the millisecond; NaN without any gap."""
        if not self.count:
            return math.nan
        return float(np.searchsorted(np.cumsum(self._counts), share * self.count)) * _BIN_S

    def take_recent_max_s(self) -> float:
        """Return the longest gap noted since the last call of this method, or 0 if there was none."""
        longest_s, self._recent_max_s = self._recent_max_s, 0.0
        return longest_s

    @property
    def summary(self) -> str:
        """The statistics as one line of text."""
        if not self.count:
            return "no setpoints sent"
        return (
            f"{self.count} setpoint gaps: median {1e3 * self.quantile_s(0.5):.0f} ms, "
            f"99 % within {1e3 * self.quantile_s(0.99):.0f} ms, longest {1e3 * self.max_s:.0f} ms, "
            f"{self.long or 'none'} over {LONG_GAP_S:g} s"
        )
