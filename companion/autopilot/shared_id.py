"""Whether two autopilots answer to one system id: one autopilot seldom contradicts itself, two do it all the time."""

from __future__ import annotations

import math
from collections import deque

SHARED_ID_STEPS = 2
SHARED_ID_WITHIN_S = 10.0
"""An autopilot takes longer than this to start twice, so a clock that goes back this many times is two autopilots'
clocks."""
SHARED_ID_CONTRADICTIONS = 20
"""Where the clocks are alike: this many positions within that time that come late, or are elsewhere at the same moment.
A link that puts a fifth of its datagrams out of order is none."""
SHARED_ID_MEMORY_S = 30.0


class SharedIdMonitor:
    """Counts what one autopilot seldom does. Times are given by the caller."""

    def __init__(self) -> None:
        self._heard_s = -math.inf
        self._backward_s: deque[float] = deque(maxlen=SHARED_ID_STEPS)
        self._contradicted_s: deque[float] = deque(maxlen=SHARED_ID_CONTRADICTIONS)
        self._shared_s = -math.inf

    @property
    def shared(self) -> bool:
        """Whether two autopilots answered to one system id not long ago, as of the last message."""
        return self._heard_s - self._shared_s <= SHARED_ID_MEMORY_S

    def hear(self, now_s: float) -> None:
        """Note that a message came."""
        self._heard_s = now_s

    def clock_went_back(self, now_s: float) -> None:
        """Note that the autopilot's clock was set back."""
        self._note(self._backward_s, now_s)

    def contradicted(self, now_s: float) -> None:
        """Note a position that came late, or was another one at the same moment."""
        self._note(self._contradicted_s, now_s)

    def _note(self, times_s: deque[float], now_s: float) -> None:
        times_s.append(now_s)
        if len(times_s) == times_s.maxlen and now_s - times_s[0] <= SHARED_ID_WITHIN_S:
            self._shared_s = now_s
