"""Messages to the operator about the setpoint loop: that it was held up, and that a link is flooded."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from companion.runtime.rate import Lateness, Stall

MEASURED_S = 1.0
"""Time over which the rate of a flood is measured."""
CALM_S = 5.0
"""Time without a dropped datagram after which a flood has ended."""
REPEAT_S = 60.0
"""Time after which a flood that goes on is told again."""
STALLS_APART_S = 10.0
"""Shortest time between two messages about stalls; the worst of those between is told with the next one."""


class Counts(NamedTuple):
    """Datagrams of a link since the start."""

    offered: int = 0
    """Those that were read from the link."""
    dropped: int = 0
    """Those of them that were dropped unread."""
    overran: int = 0
    """Those that the kernel dropped because its buffer was full."""


class StallWatch:
    """Notices slots of the setpoint loop that came late; the caller gives the times."""

    def __init__(self) -> None:
        self.lateness = Lateness()
        self._worst: Stall | None = None
        """The worst stall that was not told yet."""
        self._told_s = -math.inf

    def note_slot(self, due_s: float, now_s: float, cpu_s: float) -> None:
        """Note the beginning of a slot; see `Lateness.note`."""
        stall = self.lateness.note(due_s, now_s, cpu_s)
        if stall is not None and (self._worst is None or stall.late_s > self._worst.late_s):
            self._worst = stall

    def news(self, now_s: float) -> list[str]:
        """Return the messages that are new since the last call, one line each."""
        if self._worst is None or now_s - self._told_s < STALLS_APART_S:
            return []
        worst, self._worst, self._told_s = self._worst, None, now_s
        count = self.lateness.stalls
        return [f"warning: {worst.words}" + (f", the worst of late; {count} stalls in all" if count > 1 else "")]


class FloodWatch:
    """Notices floods of a link; the caller gives the times."""

    def __init__(self, link: str, count: Callable[[], Counts]) -> None:
        """Watch a link by its name in messages; `count` returns what came on it since the start."""
        self._link = link
        self._count = count
        self._counts = Counts()
        self._measured_s = self._lost_s = self._told_s = -math.inf
        self._began: tuple[float, int] | None = None
        """Time at which the present flood began, and how many datagrams had been lost by then; None without one."""

    def news(self, now_s: float) -> list[str]:
        """Return the messages that are new since the last call, one line each."""
        passed_s = now_s - self._measured_s
        if passed_s < MEASURED_S:
            return []
        before, self._counts, self._measured_s = self._counts, self._count(), now_s
        lost = _lost(self._counts) - _lost(before)
        if lost:
            self._lost_s = now_s
            return self._goes_on(before, lost, passed_s, now_s)
        if self._began is None or now_s - self._lost_s < CALM_S:
            return []
        (began_s, lost_before), self._began = self._began, None
        lost_in_all = _lost(self._counts) - lost_before
        return [f"{self._link} no longer flooded: {lost_in_all} datagrams dropped in {self._lost_s - began_s:.0f} s"]

    def _goes_on(self, before: Counts, lost: int, passed_s: float, now_s: float) -> list[str]:
        if self._began is None:
            # It may have begun a moment ago: its rate is that of the next second.
            self._began = now_s - min(passed_s, MEASURED_S), _lost(before)
            self._told_s = -math.inf
            return []
        if now_s - self._told_s < REPEAT_S:
            return []
        self._told_s = now_s
        overran = self._counts.overran - before.overran
        came = self._counts.offered - before.offered + overran
        by_kernel = f", {overran / passed_s:.0f} of them by the kernel" if overran else ""
        return [
            f"warning: {self._link} flooded: {lost / passed_s:.0f} of {came / passed_s:.0f} datagrams/s "
            f"dropped unread{by_kernel}"
        ]


@dataclass(frozen=True)
class LoopWatch:
    """All who notice what holds up the setpoint loop."""

    stalls: StallWatch
    floods: tuple[FloodWatch, ...]

    def news(self, now_s: float) -> list[str]:
        """Return the messages that are new since the last call, one line each."""
        return self.stalls.news(now_s) + [line for flood in self.floods for line in flood.news(now_s)]


def _lost(counts: Counts) -> int:
    return counts.dropped + counts.overran
