"""How often somebody may ask: a bucket of requests for each, which fills again steadily.

Pure: the caller gives the time.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import NamedTuple

MOST_KEPT = 4_096
"""Greatest number of buckets: whoever has not asked for longest is forgotten, and begins with a full one."""


class Rate(NamedTuple):
    """Requests per second in the long run, and the greatest number at once."""

    per_s: float
    burst: float


READS = Rate(50.0, 300.0)
"""Of one address: the page with its modules and map tiles, and a program that asks ten times a second."""
CHANGES = Rate(10.0, 60.0)
"""Of one address: faster than hands, and than any source that the API is meant for."""
LOGINS = Rate(0.2, 10.0)
"""Of one address: a token has 256 bits, so that this only keeps the log short."""


class RateLimit:
    """Buckets of one rate, by whoever asks."""

    def __init__(self, rate: Rate) -> None:
        self._rate = rate
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()
        """Requests left, and the time in seconds at which they were counted."""

    def wait_s(self, asker: str, now_s: float) -> float:
        """Take a request from a bucket and return 0, or else the time until there is one."""
        left, counted_s = self._buckets.pop(asker, (self._rate.burst, now_s))
        left = min(self._rate.burst, left + max(0.0, now_s - counted_s) * self._rate.per_s)
        allowed = left >= 1.0
        self._buckets[asker] = (left - 1.0 if allowed else left, now_s)
        if len(self._buckets) > MOST_KEPT:
            self._buckets.popitem(last=False)
        return 0.0 if allowed else (1.0 - left) / self._rate.per_s


class Limits:
    """The limits of one site, by the address that asks."""

    def __init__(self) -> None:
        self.reads, self.changes, self.logins = RateLimit(READS), RateLimit(CHANGES), RateLimit(LOGINS)
