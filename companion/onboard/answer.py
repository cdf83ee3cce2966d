"""The ladder of a vehicle that does not answer: slowed, stopped, at last left to its autopilot; and the way back.

A copter that is saturated regains authority when less is asked of it, so it is slowed first. A vehicle that cannot stop
is left to its autopilot at once, which loiters (docs/autopilots.md).
"""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

SLOWER_SHARE = 0.5
"""Share of the speed that each step of the ladder leaves."""
MOST_SLOWER = 2
"""Number of times that a vehicle is slowed before it is stopped: at a quarter of its speed, drag takes a sixteenth."""
RECOVER_S = 15.0
"""Time of answers after which a slowed vehicle is given the next greater speed; doubled by every step down since."""
STOPPED_S = 10.0
"""Time for which a stopped vehicle stands before it goes on, slowed; doubled by every stop since it was engaged."""
MOST_DOUBLINGS = 3
"""Number of times that RECOVER_S and STOPPED_S are doubled."""
MOST_STOPS = 3
"""Number of stops after which the vehicle goes on only when it is handed over anew."""


class Rung(Enum):
    """How far the ladder has been gone down, the mildest first."""

    ANSWERS = "answers"
    SLOWED = "slowed"
    STOPPED = "stopped"
    LEFT = "left to its autopilot"
    """No setpoint is sent until the vehicle is handed over anew."""


class Answer(NamedTuple):
    """Whether a vehicle answers, and what is done if it does not."""

    rung: Rung = Rung.ANSWERS
    slower: int = 0
    """Number of times that its speed was cut by SLOWER_SHARE."""
    since_s: float = -math.inf
    """Time of the last change, or of the last sign that it does not answer."""
    downs: int = 0
    """Number of steps down since the engagement began."""
    stops: int = 0
    words: str = ""
    """What was asked and what it did; empty while it answers."""

    @property
    def speed_share(self) -> float:
        """The share of its speed that may be asked of the vehicle: 1 if it answers, 0 if it is stopped."""
        if self.rung in (Rung.STOPPED, Rung.LEFT):
            return 0.0
        return float(SLOWER_SHARE**self.slower)

    @property
    def trigger(self) -> str | None:
        """The reason for the failsafe in words; None while the vehicle answers."""
        if self.rung is Rung.ANSWERS:
            return None
        return f"{self.rung.value}: {self.words}"


def worse(before: Answer, words: str, can_stop: bool, now_s: float) -> Answer:
    """Return the next step down, for a vehicle that did not answer the present one, as `words` say."""
    downs = before.downs + 1
    if not can_stop or before.rung in (Rung.STOPPED, Rung.LEFT):
        return before._replace(rung=Rung.LEFT, since_s=now_s, downs=downs, words=words)
    if before.slower < MOST_SLOWER:
        return Answer(Rung.SLOWED, before.slower + 1, now_s, downs, before.stops, words)
    return Answer(Rung.STOPPED, before.slower, now_s, downs, before.stops + 1, words)


def better(before: Answer, standing: bool, now_s: float) -> Answer:
    """Return the next step up if the vehicle has answered for long enough; `standing`: it stands still."""
    if before.rung is Rung.SLOWED:
        if now_s - before.since_s < RECOVER_S * 2 ** min(max(before.downs - 1, 0), MOST_DOUBLINGS):
            return before
        if before.slower > 1:
            return before._replace(slower=before.slower - 1, since_s=now_s)
        return Answer(since_s=now_s, downs=before.downs, stops=before.stops)
    if before.rung is Rung.STOPPED and before.stops < MOST_STOPS:
        if not standing:
            return before._replace(since_s=now_s)
        if now_s - before.since_s >= STOPPED_S * 2 ** min(before.stops - 1, MOST_DOUBLINGS):
            return before._replace(rung=Rung.SLOWED, since_s=now_s)
    return before
