"""What the broadcast sends: how much, how often each kind of frame, and how long ago the last one was."""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

from companion.protocol.dialect import oneway
from companion.protocol.frame import raw_frame
from companion.transport.endpoints import Link
from groundstation.options import Options
from groundstation.view import Surroundings

WINDOW_S = 10.0
"""Time over which rate and periods are taken: a few broadcast periods."""
MOST_SENDS = 20_000
"""Greatest number of frames in that time that are remembered."""


_NAMES = {number: kind.msgname.removeprefix("ONEWAY_").lower() for number, kind in oneway.mavlink_map.items()}
"""Names of the messages as a page shows them: `state` for ONEWAY_STATE."""


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


def name_of(frame: bytes) -> str:
    """Return the name of a frame's message as a page shows it."""
    name: str = _NAMES.get(raw_frame(frame).message_id, "other")
    return name


def shown(link: Link) -> str:
    """Return a link as a page shows it: without the path of a device or file."""
    return link.scheme if link.path else str(link)


class BroadcastMeter:
    """Counts what one run sends, and says it as its page shows it."""

    def __init__(self, options: Options) -> None:
        self.options = options
        self._meter = Meter()

    def sent(self, frame: bytes, on_air_bytes: int, now_s: float) -> None:
        """Take note of a frame that was sent."""
        self._meter.sent(name_of(frame), on_air_bytes, now_s)

    def surroundings(self, now_s: float) -> Surroundings:
        """Return what a page shows beside the ground station's picture."""
        radio = self.options.radio
        broadcast = self._meter.reading(now_s) | {
            "budget_bytes_per_s": None if radio is None else radio.budget_bytes_per_s,
            "authentication": self.options.authentication,
            "link": shown(self.options.link),
        }
        return Surroundings("live", broadcast)
