"""The order of one sender's frames that carry no time: MAVLink's sequence number, and the memory of what was heard.

The number has eight bits and counts every frame of a sender, so it begins again after 256 frames: 5 s on a link of 50
frames a second. A number is taken for ahead only as far as the link's rate allows since the last frame, else for late.
Each kind of message has an order of its own, so that one that overtakes others on the way does not push them out.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable
from typing import NamedTuple

WRAP = 256
MEMORY_S = 10.5
"""Time for which frames are remembered: a copy that comes up to 10 s after the first one is known as a copy."""
MAX_REMEMBERED = 4_096
"""Greatest number of frames that are remembered, beyond which the oldest are forgotten."""
MAX_KEYS = 1_024
"""Greatest number of messages whose order is kept, beyond which all are forgotten."""
AHEAD_FRAMES = 16
"""How many frames may have been lost however short the time."""
RATE_FACTOR = 1.5
"""How many times its measured rate a link may be taken to run, for the frames that may have been lost in a time."""
STALE_S = 4.0
"""Time without a newer frame after which every number is taken for ahead: the autopilot counts as lost by then."""
RATE_STEP_S, RATE_STEPS = 0.25, 9
"""Least time between two of the points by which the rate is measured, and their number."""


class Ordered(NamedTuple):
    """How a frame stands to those before it."""

    reason: str | None
    """Why it is not to be believed: it is a copy, or late; None if it is the newest of its kind."""
    late_by_s: float = 0.0
    """By how much it is behind the newest frame of its sender."""


DUPLICATE = "duplicate"
LATE = "late"


class FrameOrder:
    """Judges one sender's frames by number and content. Times are the caller's, in seconds of one clock."""

    def __init__(self) -> None:
        self._counts = False
        """Whether the sender was ever seen to count: one that does not has no order, and repeats itself."""
        self._number: int | None = None
        self._index = 0
        """The newest number, counted on without beginning again."""
        self._at_s = 0.0
        self._newest: dict[Hashable, tuple[int, bytes]] = {}
        self._heard_s: dict[bytes, float] = {}
        self._points: deque[tuple[float, int]] = deque(maxlen=RATE_STEPS)

    def restart(self) -> None:
        """Begin anew after a restart of the sender; copies of what was heard before are still known."""
        self._number = None
        self._newest.clear()
        self._points.clear()

    def anchor(self, number: int, now_s: float) -> None:
        """Go on to the number of a frame that is the newest one by its own time."""
        if self._number is not None:
            ahead = (number - self._number) % WRAP
            self._counts = self._counts or ahead != 0
            if ahead >= WRAP - AHEAD_FRAMES and ahead > self._most_ahead(now_s):
                # A frame without a time that was sent after this one has overtaken it.
                return
            self._index += ahead
        self._advance(number, now_s)

    def take(self, number: int, key: Hashable, payload: bytes, frame: bytes, now_s: float) -> Ordered:
        """Judge a frame without a time of its own; `key` is the kind of message that it is newer or older among."""
        if self._number is None:
            self._advance(number, now_s)
        ahead = (number - (self._number or 0)) % WRAP
        self._counts = self._counts or ahead != 0
        is_ahead = not self._counts or 0 < ahead <= self._most_ahead(now_s)
        index = self._index + (ahead if is_ahead else ahead - WRAP)
        before = self._newest.get(key)
        if self._counts:
            # What was true is true still: a heartbeat is the same, byte by byte, each time the number comes round.
            says_the_same = is_ahead and before is not None and before[1] == payload
            if self._is_known(frame, now_s) and not says_the_same:
                return Ordered(DUPLICATE)
            if before is not None and index <= before[0]:
                return Ordered(LATE)
        self._remember(frame, now_s)
        if len(self._newest) >= MAX_KEYS:
            self._newest.clear()
        self._newest[key] = index, payload
        late_by_s = (self._index - index) / self._rate_hz if index < self._index and self._rate_hz else 0.0
        if is_ahead:
            self._index = index
            self._advance(number, now_s)
        return Ordered(None, late_by_s)

    def _advance(self, number: int, now_s: float) -> None:
        self._number, self._at_s = number, now_s
        if not self._points or now_s - self._points[-1][0] >= RATE_STEP_S:
            self._points.append((now_s, self._index))

    @property
    def _rate_hz(self) -> float:
        """Frames per second; 0 while that is not known."""
        if len(self._points) < 2:
            return 0.0
        (first_s, first), (last_s, last) = self._points[0], self._points[-1]
        return (last - first) / (last_s - first_s)

    def _most_ahead(self, now_s: float) -> float:
        """Return by how much the number may have grown since the last frame."""
        passed_s = now_s - self._at_s
        if passed_s >= STALE_S or not self._rate_hz:
            return WRAP - 1
        return AHEAD_FRAMES + RATE_FACTOR * self._rate_hz * passed_s

    def _is_known(self, frame: bytes, now_s: float) -> bool:
        """Return whether the same bytes were heard within MEMORY_S."""
        heard_s = self._heard_s.get(frame)
        return heard_s is not None and now_s - heard_s <= MEMORY_S

    def _remember(self, frame: bytes, now_s: float) -> None:
        """Remember a frame, and forget what is too old or too much; the oldest stand first."""
        heard_s = self._heard_s
        heard_s.pop(frame, None)
        while heard_s and (len(heard_s) >= MAX_REMEMBERED or now_s - next(iter(heard_s.values())) > MEMORY_S):
            del heard_s[next(iter(heard_s))]
        heard_s[frame] = now_s
