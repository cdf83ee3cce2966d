"""How well the broadcast is heard: what arrives against what was sent, and how old each kind of news is.

What was sent is not known on board, but follows from the frames heard: each says how many frames its broadcast has,
and two of them how often there is one. The clock is the caller's; silence counts as loss.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median
from typing import NamedTuple

from companion.protocol.freshness import SenderClock
from companion.protocol.messages import (
    BandsFrame,
    FleetFrame,
    Frame,
    MissionFrame,
    MotionFrame,
    RadiiFrame,
    StateFrame,
)

WINDOW_S = 60.0
ASSUMED_PERIOD_S = 1.0
"""Between broadcasts, until two were heard."""
PERIODS = 31
"""Newest intervals between broadcasts that the median is taken of: a leap of the sequence is one among many."""
BEGIN_SHARE = 0.5
END_SHARE = 0.7
"""A warning of bad reception begins below the one and ends above the other, so that it does not flicker."""

MIN_EXPECTED = 10
"""Frames expected before a warning may begin: a share of fewer says little."""
MAX_ARRIVALS = 65_536
"""Bound on memory; a window of any broadcast in use holds far fewer frames."""

_KINDS: dict[type, str] = {
    StateFrame: "state",
    FleetFrame: "state",
    MotionFrame: "motion",
    BandsFrame: "bands",
    RadiiFrame: "radii",
    MissionFrame: "mission",
}


@dataclass(frozen=True)
class LinkQuality:
    """How the broadcast is heard by now."""

    received: int
    """State frames within the window; copies of one count once."""
    expected: int
    share: float
    """Received of expected, at most 1; 0 where nothing was heard yet."""
    last_good_s: float | None
    """When the last frame was accepted, by the clock of the vehicle."""
    ages_s: Mapping[str, float]
    """Age of the newest news of each kind that was ever heard."""


class Warnings:
    """Says when reception becomes bad and when it is good again, with hysteresis between."""

    def __init__(self, begin_share: float = BEGIN_SHARE, end_share: float = END_SHARE) -> None:
        self.begin_share = begin_share
        self.end_share = end_share
        self.active = False

    def update(self, quality: LinkQuality) -> str | None:
        """Return what is to be said of a change, None if there is none."""
        heard = f"{quality.received} of {quality.expected} frames heard"
        if self.active and quality.share > self.end_share:
            self.active = False
            return f"reception is good again: {heard}"
        if not self.active and quality.expected >= MIN_EXPECTED and quality.share < self.begin_share:
            self.active = True
            return f"warning: reception is bad: {heard}"
        return None


class _Broadcast(NamedTuple):
    epoch_s: int
    sequence: int
    unix_s: float


class LinkMonitor:
    """Counts accepted frames over a window; all times are this vehicle's clock."""

    def __init__(self, window_s: float = WINDOW_S, *, clocks_agree: bool = True) -> None:
        self.window_s = window_s
        self._sender_clock = SenderClock(agrees=clocks_agree)
        self._arrivals_s: deque[float] = deque(maxlen=MAX_ARRIVALS)
        self._frame_count = 1
        self._first_s: float | None = None
        self._last_good_s: float | None = None
        self._true_at_s: dict[str, float] = {}
        self._newest: _Broadcast | None = None
        self._periods_s: deque[float] = deque(maxlen=PERIODS)

    def note(self, frame: Frame, now_s: float) -> None:
        """Count an accepted frame; one that is not of the broadcast is not counted."""
        if not isinstance(frame, StateFrame | FleetFrame | MotionFrame | BandsFrame | RadiiFrame | MissionFrame):
            return
        kind = _KINDS[type(frame)]
        self._last_good_s = now_s
        true_at_s = self._sender_clock.true_at_s(frame.stamp, now_s)
        self._true_at_s[kind] = max(true_at_s, self._true_at_s.get(kind, -math.inf))
        if isinstance(frame, StateFrame | FleetFrame):
            self._first_s = now_s if self._first_s is None else self._first_s
            self._arrivals_s.append(now_s)
            self._frame_count = frame.stamp.frame_count
            self._learn_period(_Broadcast(frame.stamp.epoch_s, frame.stamp.sequence, frame.stamp.unix_s))
            self._forget(now_s)

    def quality(self, now_s: float) -> LinkQuality:
        """Return how the broadcast is heard at `now_s`."""
        self._forget(now_s)
        received, expected = len(self._arrivals_s), self._expected(now_s)
        return LinkQuality(
            received=received,
            expected=expected,
            share=min(1.0, received / expected) if expected else 0.0,
            last_good_s=self._last_good_s,
            ages_s={kind: max(0.0, now_s - true_at_s) for kind, true_at_s in self._true_at_s.items()},
        )

    def _expected(self, now_s: float) -> int:
        if self._first_s is None:
            return 0
        heard_for_s = now_s - self._first_s
        # The first broadcast heard opens the count; from then on there is one each period.
        broadcasts = (
            self.window_s / self._period_s
            if heard_for_s >= self.window_s
            else math.floor(heard_for_s / self._period_s) + 1
        )
        return max(1, round(broadcasts * self._frame_count))

    @property
    def _period_s(self) -> float:
        return median(self._periods_s) if self._periods_s else ASSUMED_PERIOD_S

    def _learn_period(self, broadcast: _Broadcast) -> None:
        before, self._newest = self._newest, broadcast
        if before is None or before.epoch_s != broadcast.epoch_s:
            return
        steps = broadcast.sequence - before.sequence
        passed_s = broadcast.unix_s - before.unix_s
        if steps > 0 and passed_s > 0:
            self._periods_s.append(passed_s / steps)

    def _forget(self, now_s: float) -> None:
        while self._arrivals_s and self._arrivals_s[0] <= now_s - self.window_s:
            self._arrivals_s.popleft()
