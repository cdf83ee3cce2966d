"""The rate of the setpoint loop: slots on a fixed grid of the steady clock, how late they came, and setpoint gaps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

LONG_GAP_S = 0.5
"""Gap between two setpoints after which an autopilot may begin to give the companion up (docs/autopilots.md)."""
STALL_S = 0.2
"""Lateness of a slot from which it counts as a stall: at 10 Hz two slots in a row did not come."""
HISTOGRAM_S = 3.0
"""Gap from which all gaps are in one bin of the histogram; the longest is told by itself."""
_BIN_S = 1e-3
"""Width of a bin of the histogram of gaps."""


@dataclass(slots=True)
class LoopRate:
    """Slots every `period_s` seconds from the first one on. A slot that was missed is left out, never made up for."""

    period_s: float
    due_s: float
    """Time of the current slot, by the steady clock."""

    def next_after(self, now_s: float) -> float:
        """Move on to the next slot that is later than `now_s`, and return its time."""
        self.due_s += self.period_s * max(1, math.floor((now_s - self.due_s) / self.period_s) + 1)
        return self.due_s


def next_due_s(due_s: float, done_s: float, step_s: float) -> float:
    """Return when the next decision is due, after one that was due at `due_s` and was made in the slot at `done_s`.

    It is due a step after `due_s`, or a step after `done_s` where the decision was made more than half a step early or
    at least a whole step late. Times are of the steady clock.
    """
    in_turn = due_s - 0.5 * step_s <= done_s < due_s + step_s
    return (due_s if in_turn else done_s) + step_s


class Greatest:
    """The greatest of the values since it was last taken."""

    def __init__(self) -> None:
        self._value = 0.0

    def note(self, value: float) -> None:
        """Note a value, which is not negative."""
        self._value = max(self._value, value)

    def take(self) -> float:
        """Return the greatest value noted since the last call of this method, or 0 if there was none."""
        value, self._value = self._value, 0.0
        return value


class Evenness(NamedTuple):
    """How even the setpoint loop was for a while."""

    gap_s: float = 0.0
    """The longest gap between two setpoints."""
    late_s: float = 0.0
    """The greatest lateness of a slot."""


class SetpointGaps:
    """Statistics of the gaps between successive setpoints, to the millisecond.

    The time from the last setpoint to the slot that ends the steering is a gap, too: when the program stood still, the
    first slot after that may send none.
    """

    def __init__(self) -> None:
        self._counts = np.zeros(round(HISTOGRAM_S / _BIN_S) + 1, dtype=np.int64)
        self._last_s: float | None = None
        self.recent = Greatest()
        """Gaps for whoever takes the longest now and then."""
        self.max_s = 0.0
        self.long = 0
        """Number of gaps longer than `LONG_GAP_S`."""

    def note(self, now_s: float) -> None:
        """Note that a setpoint was sent at `now_s`, by the steady clock."""
        last_s, self._last_s = self._last_s, now_s
        if last_s is None:
            return
        gap_s = now_s - last_s
        self._counts[min(round(gap_s / _BIN_S), len(self._counts) - 1)] += 1
        self.max_s = max(self.max_s, gap_s)
        self.recent.note(gap_s)
        self.long += gap_s > LONG_GAP_S

    def end(self, now_s: float) -> None:
        """Note that no setpoint is to be sent at `now_s`: the time from then until the next setpoint is no gap."""
        self.note(now_s)
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


@dataclass(frozen=True, slots=True)
class Stall:
    """A slot that came late, measured against the grid: what held the program up cannot have stopped that clock."""

    late_s: float
    busy_share: float
    """Share of the time since the slot before for which this program had a processor."""

    @property
    def words(self) -> str:
        """What held the loop up, and for how long."""
        who = "this program was busy" if self.busy_share >= 0.5 else "this computer stood still"
        return f"{who} for {self.late_s:.1f} s"


class Lateness:
    """How late the slots of the setpoint loop came; the caller reads the clocks at the beginning of each."""

    def __init__(self) -> None:
        self._at_s = -math.inf
        self._cpu_s = 0.0
        self.recent = Greatest()
        """Lateness for the named values, which take the greatest since they were last sent."""
        self.of_decision = Greatest()
        """Lateness for the table of decisions, which takes the greatest since the last decision."""
        self.stalls = 0
        """Number of slots that were late by STALL_S or more."""
        self.max_s = 0.0

    def note(self, due_s: float, now_s: float, cpu_s: float) -> Stall | None:
        """Note a slot that was due at `due_s` and began at `now_s`; return the stall before it, if there was one.

        `cpu_s`: the processor time that the program has used since its start.
        """
        late_s, passed_s = max(0.0, now_s - due_s), now_s - self._at_s
        busy_share = (cpu_s - self._cpu_s) / passed_s if passed_s > 0.0 else 0.0
        self._at_s, self._cpu_s = now_s, cpu_s
        self.max_s = max(self.max_s, late_s)
        self.recent.note(late_s)
        self.of_decision.note(late_s)
        if late_s < STALL_S:
            return None
        self.stalls += 1
        return Stall(late_s, busy_share)

    @property
    def summary(self) -> str:
        """The stalls as one line of text."""
        return f"slots at most {1e3 * self.max_s:.0f} ms late, {self.stalls or 'none'} by {STALL_S:g} s or more"
