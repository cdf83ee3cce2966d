"""Link quality of the broadcast: the share of sent frames that arrive, and the age of each kind of message.

The number of frames sent is not known on board but estimated from those received: each says how many frames its
broadcast has, and two of them give the broadcast period. A broadcast that was not heard at all counts as one of the
mean size of those that were. Times are arguments; silence counts as loss.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import fmean, median
from typing import NamedTuple

from companion.protocol.freshness import SenderClock
from companion.protocol.messages import (
    BandsFrame,
    FleetFrame,
    Frame,
    MissionFrame,
    MotionFrame,
    RadiiFrame,
    Stamp,
    StateFrame,
)

WINDOW_S = 60.0
"""Length of the window over which frames are counted."""
ASSUMED_PERIOD_S = 1.0
"""Time between two broadcasts that is assumed until two were heard."""
PERIODS = 31
"""Number of newest intervals between broadcasts whose median is the period: a jump of the sequence is one of many."""
BEGIN_SHARE = 0.5
"""Share of received frames below which a warning of bad reception begins."""
END_SHARE = 0.7
"""Share of received frames above which that warning ends: higher than BEGIN_SHARE, so that it does not flicker."""

MIN_EXPECTED = 10
"""Least number of expected frames for a warning to begin: the share of fewer frames means little."""
MAX_ARRIVALS = 65_536
"""Greatest number of arrival times stored, to bound memory; a window of any broadcast in use has far fewer frames."""

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
    """Link quality of the broadcast at one moment."""

    received: int
    """Number of state frames received within the window; copies of one count once."""
    expected: int
    """Number of state frames that were sent within the window, as estimated."""
    share: float
    """Received divided by expected frames, at most 1; 0 before any was received."""
    last_good_s: float | None
    """Time by the vehicle's clock at which the last frame was accepted, None before the first."""
    ages_s: Mapping[str, float]
    """Age of the newest message of each kind (state, motion, ...) that was ever received."""


class Warnings:
    """Reports when reception becomes bad and when it is good again, with hysteresis."""

    def __init__(self, begin_share: float = BEGIN_SHARE, end_share: float = END_SHARE) -> None:
        self.begin_share = begin_share
        self.end_share = end_share
        self.active = False

    def update(self, quality: LinkQuality) -> str | None:
        """Return the message about reception having become bad or good again, None if nothing changed."""
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


class _Heard(NamedTuple):
    at_s: float
    """When its first frame was heard."""
    broadcast: _Broadcast
    frame_count: int
    """Number of its frames that could be heard."""
    missed: int
    """Number of broadcasts before it of which nothing was heard."""


class LinkMonitor:
    """Measures link quality from the accepted frames of a window; all times are by this vehicle's clock."""

    def __init__(self, window_s: float = WINDOW_S, *, clocks_agree: bool = True) -> None:
        self.window_s = window_s
        self._sender_clock = SenderClock(agrees=clocks_agree)
        self._arrivals_s: deque[float] = deque(maxlen=MAX_ARRIVALS)
        self._broadcasts: deque[_Heard] = deque()
        """Those of which the first arrival is among the stored ones."""
        self._newest: _Heard | None = None
        self._newest_s = 0.0
        """When its last frame was heard."""
        self._sent = 0
        """Number of frames of the newest broadcast that were sent when its last was heard."""
        self._last_good_s: float | None = None
        self._true_at_s: dict[str, float] = {}
        self._periods_s: deque[float] = deque(maxlen=PERIODS)

    def note(self, frame: Frame, now_s: float) -> None:
        """Count an accepted frame; a message that the ground station does not broadcast is ignored."""
        if not isinstance(frame, StateFrame | FleetFrame | MotionFrame | BandsFrame | RadiiFrame | MissionFrame):
            return
        kind = _KINDS[type(frame)]
        self._last_good_s = now_s
        true_at_s = self._sender_clock.true_at_s(frame.stamp, now_s)
        self._true_at_s[kind] = max(true_at_s, self._true_at_s.get(kind, -math.inf))
        if isinstance(frame, StateFrame | FleetFrame):
            heard = self._heard(frame.stamp, now_s)
            if heard is not self._newest:
                self._newest = heard
                self._broadcasts.append(heard)
            self._newest_s = now_s
            self._arrivals_s.append(now_s)
            self._sent = min(frame.stamp.frame_index + 1, heard.frame_count)
            self._forget(now_s)

    def quality(self, now_s: float) -> LinkQuality:
        """Return the link quality at `now_s`."""
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
        if self._newest is None:
            return 0
        heard, period_s = self._broadcasts, self._period_s
        silent_s = min(now_s - self._newest_s, self.window_s)
        # A broadcast that takes longer than those before is not late yet.
        silent = math.floor(silent_s / max(period_s, self._periods_s[-1] if self._periods_s else 0.0))
        sent = [one.frame_count for one in heard]
        mean = fmean(sent or [self._newest.frame_count])
        if heard and heard[-1] is self._newest and silent_s < 0.5 * period_s:
            # The rest of it may be still to come.
            sent[-1] = self._sent
        missed = sum(one.missed for one in heard)
        if heard:
            # Those before the window do not count.
            since_s = heard[0].at_s - (now_s - self.window_s)
            missed -= max(0, heard[0].missed - math.floor(since_s / period_s))
        return max(1, round(sum(sent) + (missed + silent) * mean))

    @property
    def period_s(self) -> float | None:
        """Time between two broadcasts by their stamps; None before two were heard."""
        return median(self._periods_s) if self._periods_s else None

    @property
    def _period_s(self) -> float:
        return ASSUMED_PERIOD_S if self.period_s is None else self.period_s

    def _heard(self, stamp: Stamp, now_s: float) -> _Heard:
        """Return the broadcast that a state or fleet frame is of, the newest or a new one; learn the period from it."""
        now, newest = _Broadcast(stamp.epoch_s, stamp.sequence, stamp.unix_s), self._newest
        if newest is None:
            # What was sent of it before that could not be heard.
            return _Heard(now_s, now, stamp.frame_count - stamp.frame_index, 0)
        before = newest.broadcast
        steps, passed_s = now.sequence - before.sequence, now.unix_s - before.unix_s
        if before.epoch_s != now.epoch_s or steps < 0:
            return _Heard(now_s, now, stamp.frame_count, 0)
        if steps == 0:
            return newest
        if passed_s > 0:
            self._periods_s.append(passed_s / steps)
        # A leap of the sequence is no loss, nor is a time between two broadcasts that has become longer.
        missed = min(steps, round(max(0.0, passed_s) / self._period_s)) - 1
        return _Heard(now_s, now, stamp.frame_count, max(0, missed))

    def _forget(self, now_s: float) -> None:
        arrivals_s, broadcasts = self._arrivals_s, self._broadcasts
        while arrivals_s and arrivals_s[0] <= now_s - self.window_s:
            arrivals_s.popleft()
        while broadcasts and (not arrivals_s or broadcasts[0].at_s < arrivals_s[0]):
            broadcasts.popleft()
