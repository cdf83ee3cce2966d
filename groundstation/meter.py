"""What the broadcast sends: how much, how often each kind of frame, and how long ago the last one was."""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

WINDOW_S = 10.0
"""Time over which rate and periods are taken: a few broadcast periods."""
MOST_SENDS = 20_000
"""Greatest number of frames in that time that are remembered."""


class _Send(NamedTuple):
    sent_at_s: float
    name: str
    on_air_bytes: int


class Meter:
    """Counts the frames of one broadcast."""

    def __init__(self) -> None:
        self.frames = 0
        self.bytes = 0
        self._sends: deque[_Send] = deque(maxlen=MOST_SENDS)
        self._last_s: dict[str, float] = {}
        """Time at which a kind of frame was sent last, by its name."""

    def sent(self, name: str, on_air_bytes: int, now_s: float) -> None:
        """Take note of a frame."""
        self.frames += 1
        self.bytes += on_air_bytes
        self._last_s[name] = now_s
        self._sends.append(_Send(now_s, name, on_air_bytes))

    def reading(self, now_s: float) -> dict[str, Any]:
        """Return the figures as a page shows them: rate in bytes per second, ages and periods in seconds."""
        while self._sends and self._sends[0].sent_at_s < now_s - WINDOW_S:
            self._sends.popleft()
        spans: dict[str, list[float]] = {}
        for send in self._sends:
            spans.setdefault(send.name, []).append(send.sent_at_s)
        items = [
            {"name": name, "period_s": _period_s(spans.get(name, ())), "age_s": round(max(0.0, now_s - last_s), 2)}
            for name, last_s in sorted(self._last_s.items())
        ]
        last_s = max(self._last_s.values(), default=None)
        return {
            "bytes_per_s": round(sum(send.on_air_bytes for send in self._sends) / WINDOW_S, 1),
            "frames": self.frames,
            "bytes": self.bytes,
            "last_frame_age_s": None if last_s is None else round(max(0.0, now_s - last_s), 2),
            "items": items,
        }


def _period_s(sent_s: list[float] | tuple[float, ...]) -> float | None:
    """Return the mean time between frames of one kind; None if fewer than two were sent in the window."""
    if len(sent_s) < 2:
        return None
    return round((sent_s[-1] - sent_s[0]) / (len(sent_s) - 1), 3)
