"""Bounds costly work on what anybody may send; when there is too much of it, chance decides what gets its share."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field
from typing import Generic, TypeVar

WINDOW_S = 0.05
"""Time for which things wait in a flood, so that the first of a burst have no better chance than the last."""
_COST_GAIN = 0.3
"""Weight of the newest measured cost in the mean."""
_LEAST_COST = 1e-6
"""Least expected cost of one thing: what a clock is too coarse to measure is not free."""

OfferedT = TypeVar("OfferedT")


@dataclass(slots=True)
class _Window(Generic[OfferedT]):
    """What was offered until a time: how much there was, and what is drawn of it so far."""

    closes_s: float
    places: int
    offered: int = 0
    waiting: list[tuple[int, OfferedT]] = field(default_factory=list)


class FairShare(Generic[OfferedT]):
    """Bounds the rate of work (checks, or seconds), and draws at random what is worked on when there is too much.

    In quiet times what is offered is worked on at once. When half of the saved work is used up, what comes is gathered
    for a window; then what is worked on is drawn, each with the same chance (reservoir sampling), so that a forger
    gains nothing by being first or last. With F forged ones in a window a genuine one is drawn with a probability of at
    least rate * window / (cost * (F + 1)). All times are of one clock.
    """

    def __init__(self, per_s: float, burst: float, rng: random.Random, cost: float = 1.0) -> None:
        """Allow work at a mean rate of `per_s`, of which at most `burst` is saved up; one thing costs `cost`."""
        self.dropped = 0
        """Number of things that got no share."""
        self._cost = cost
        self._rate_per_s = per_s
        self._burst = burst
        self._rng = rng
        self._saved = burst
        """Work that may be done; what is expected of the things in `_charged` is taken off already."""
        self._charged = 0
        """Number of things that were returned for work and not settled yet."""
        self._saved_at_s: float | None = None
        self._window: _Window[OfferedT] | None = None
        self._drawn: list[OfferedT] = []
        """What was drawn and not returned yet, the newest first."""

    def due_s(self) -> float:
        """Return the time from which `due` returns something: at once (-inf), or never (inf) if nothing waits."""
        if self._drawn:
            return -math.inf
        return math.inf if self._window is None else self._window.closes_s

    def offer(self, one: OfferedT, now_s: float, at_once: bool = True) -> bool:
        """Return whether to work on a thing at once; if not, `due` may return it later. Never without `at_once`."""
        window = self._window
        if window is None:
            self._save(now_s)
            if at_once and self._saved >= self._burst / 2:
                self._charge(1)
                return True
            window = self._window = self._opened(now_s)
        window.offered += 1
        if len(window.waiting) < window.places:
            window.waiting.append((window.offered, one))
            return False
        self.dropped += 1
        place = self._rng.randrange(window.offered)
        if place < window.places:
            window.waiting[place] = (window.offered, one)
        return False

    def due(self, now_s: float, most: int | None = None) -> list[OfferedT]:
        """Return what was drawn from a window that has ended, in order of arrival, at most `most` things at a time."""
        window = self._window
        if window is not None and now_s >= window.closes_s:
            self._save(now_s)
            drawn = [one for _, one in sorted(window.waiting, key=_arrival, reverse=True)]
            self._charge(len(drawn))
            self._drawn, self._window = drawn + self._drawn, None
        count = len(self._drawn) if most is None else min(most, len(self._drawn))
        due = self._drawn[len(self._drawn) - count :][::-1]
        del self._drawn[len(self._drawn) - count :]
        return due

    def settle(self, spent: float, count: int) -> None:
        """Charge what work on `count` things took, instead of what was expected, and expect that of the next ones."""
        self._charge(-count)
        self._saved -= spent
        if count:
            cost = max(_LEAST_COST, self._cost + _COST_GAIN * (spent / count - self._cost))
            self._saved += self._charged * (self._cost - cost)
            self._cost = cost

    def pause_s(self, now_s: float) -> float:
        """Return how long no more work should be done, as the work that was done took more than the share."""
        self._save(now_s)
        return max(0.0, -(self._saved + self._charged * self._cost) / self._rate_per_s)

    def thinned(self, things: list[OfferedT], now_s: float) -> list[OfferedT]:
        """Return, of things that wait for work and turned out costlier than expected, as many as there is work for.

        They are drawn, each with the same chance, and stay in order; the others count as dropped.
        """
        self._save(now_s)
        short = -(self._saved + self._rate_per_s * WINDOW_S)
        kept = len(things) - math.ceil(max(0.0, short) / self._cost)
        if kept >= len(things):
            return things
        kept = max(min(1, len(things)), kept)
        self.dropped += len(things) - kept
        self._charge(kept - len(things))
        return [things[place] for place in sorted(self._rng.sample(range(len(things)), kept))]

    def _opened(self, now_s: float) -> _Window[OfferedT]:
        """Return a new window, long enough for the share of one thing at least."""
        window_s = max(WINDOW_S, self._cost / self._rate_per_s)
        work = self._saved + self._rate_per_s * window_s
        return _Window(now_s + window_s, max(1, int(work / self._cost)))

    def _charge(self, count: int) -> None:
        self._charged += count
        self._saved -= count * self._cost

    def _save(self, now_s: float) -> None:
        if self._saved_at_s is not None:
            passed_s = max(0.0, now_s - self._saved_at_s)
            self._saved = min(self._burst, self._saved + passed_s * self._rate_per_s)
        self._saved_at_s = now_s


def _arrival(waiting: tuple[int, object]) -> int:
    return waiting[0]
