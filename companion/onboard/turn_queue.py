"""Turns for what anybody may have sent: it is worked on in a share of the time that the autopilot leaves.

What comes on the broadcast link, or from strangers on the autopilot's, is only put aside. It is worked on in short
turns of the event loop between the slots of the setpoint loop, never before a decision. When more comes than the share
allows, chance decides what is worked on (`companion/runtime/fair_share.py`); the rest is dropped unread and counted.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from companion.runtime.fair_share import FairShare

BURST_S = 4.0
"""Work saved up in quiet times, in seconds of the share: the 255 frames of a longest broadcast take 0.07 s of work
here, and ten times that on a small computer."""
TURN_S = 0.002
"""Time after which the other links get their turn, and by which a slot of the setpoint loop may be late."""
FIRST_COST_S = 1e-3
"""Expected cost of one thing before any was measured."""
MOST_READY = 64
"""Greatest number of things that wait for work without having been drawn."""


ThingT = TypeVar("ThingT")
LEAST_PAUSE_S = 1e-4
"""Least pause between two turns: one that rounding leaves of nothing would be asked for again and again."""


class Pending(Protocol):
    """A call that was asked for and may be called off."""

    def cancel(self) -> None:
        """Call it off."""


class Scheduler(Protocol):
    """What an event loop offers to those who take turns."""

    def time(self) -> float:
        """Return the event loop's time, in seconds."""

    def call_soon(self, callback: Callable[[], None], /) -> Pending:
        """Call a function in the next round."""

    def call_later(self, delay_s: float, callback: Callable[[], None], /) -> Pending:
        """Call a function after a time."""


class TurnQueue(Generic[ThingT]):
    """Holds back what came until its turn; it runs on an event loop and by that loop's time."""

    def __init__(
        self,
        take: Callable[[ThingT], None],
        share: float,
        loop: Scheduler,
        check: Callable[[], float] = lambda: math.inf,
        rng: random.Random | None = None,
    ) -> None:
        """Hand what is drawn to `take`, in at most a `share` of the time.

        `check` does a few of the costly checks that wait from earlier, and returns after how many seconds more are due:
        0 at once, inf if none waits.
        """
        self.offered = 0
        """Number of things that came."""
        self._take = take
        self._check = check
        self._loop = loop
        self._share = FairShare[ThingT](share, share * BURST_S, rng or random.Random(), FIRST_COST_S)
        self._ready: list[ThingT] = []
        self._until_s = math.inf
        """Time by which the last turn must have ended, -inf while none is given."""
        self._turn: Pending | None = None
        """The turn that is asked for."""
        self._soon = False
        """Whether that is the next round of the event loop."""

    @property
    def dropped(self) -> int:
        """Number of things that were dropped unread."""
        return self._share.dropped

    def offer(self, thing: ThingT) -> None:
        """Put a thing aside until its turn."""
        self.offered += 1
        now_s = self._loop.time()
        if self._share.offer(thing, now_s, at_once=len(self._ready) < MOST_READY):
            self._ready.append(thing)
            self._wake()
        elif self._turn is None:
            self._ask_again(math.inf, now_s)

    def hold(self) -> None:
        """Give no turns: the autopilot's link is read, and a decision made."""
        self._until_s = -math.inf

    def go_on(self, for_s: float) -> None:
        """Give turns again for so many seconds, but one in any case: an overloaded computer hears it, too."""
        self._until_s = self._loop.time() + max(for_s, 2.0 * TURN_S)
        self._wake()

    def _wake(self) -> None:
        """Take a turn as soon as the other links had theirs."""
        if not self._soon:
            if self._turn is not None:
                self._turn.cancel()
            self._turn, self._soon = self._loop.call_soon(self._work), True

    def _work(self) -> None:
        """Take one turn, and ask for the next one when there will be something to do."""
        self._turn, self._soon = None, False
        began_s = self._loop.time()
        if began_s > self._until_s - TURN_S:
            return
        pause_s = self._share.pause_s(began_s)
        if pause_s > 0.0:
            self._turn = self._loop.call_later(max(pause_s, LEAST_PAUSE_S), self._work)
            return
        check_s = self._check()
        self._ready += self._share.due(began_s)
        count = 0
        while count < len(self._ready) and self._loop.time() - began_s < TURN_S:
            self._take(self._ready[count])
            count += 1
        ended_s = self._loop.time()
        self._share.settle(ended_s - began_s, count)
        self._ready = self._share.thinned(self._ready[count:], ended_s)
        self._ask_again(check_s, ended_s)

    def _ask_again(self, check_s: float, now_s: float) -> None:
        wait_s = 0.0 if self._ready else min(check_s, self._share.due_s() - now_s)
        if wait_s <= 0.0:
            self._wake()
        elif math.isfinite(wait_s):
            self._turn = self._loop.call_later(max(wait_s, LEAST_PAUSE_S), self._work)
