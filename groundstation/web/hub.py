"""What the page is shown: the newest message of each type, encoded once for all browsers, and what each still needs.

A browser that is slow is skipped: it gets the newest picture when it can take one. Events are kept in order; a browser
that has too many of them waiting is cut off, and asks again for those it has not seen.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import orjson

from groundstation.web.feed import Refused
from groundstation.web.pipe import Message
from groundstation.web.trails import Trails

SHOWN = ("timeline", "picture", "moves", "routes", "playback")
"""Types of messages of which a browser needs only the newest, in the order in which they are sent."""
MOST_EVENTS = 10_000
"""Greatest number of events that are kept to be asked for."""
MOST_WAITING = 1_000
"""Greatest number of events that wait for a browser."""
MOST_BROWSERS = 64
"""Greatest number of streams at a time."""
KEPT_S = 300.0
"""Time for which frames are kept: long enough for the slowest carousel."""
MOST_FRAMES = 5_000
"""Greatest number of frames that are kept."""


class Browser:
    """What waits to be sent to one browser."""

    def __init__(self) -> None:
        self.is_too_slow = False
        self._newest: dict[str, str] = {}
        self._events: deque[str] = deque()
        self._wake = asyncio.Event()

    def put(self, kind: str, text: str) -> None:
        """Take in a message: an event after those that wait, anything else in the place of the last one."""
        if kind != "event":
            self._newest[kind] = text
        elif len(self._events) < MOST_WAITING:
            self._events.append(text)
        else:
            self.is_too_slow = True
        self._wake.set()

    async def taken(self) -> list[str]:
        """Wait until something waits, and return it."""
        await self._wake.wait()
        self._wake.clear()
        texts = [self._newest[kind] for kind in SHOWN if kind in self._newest]
        texts += self._events
        self._newest.clear()
        self._events.clear()
        return texts


class Hub:
    """Takes in a feed's messages, and hands them to the browsers."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}
        self.picture: dict[str, Any] | None = None
        """The newest picture; None before the first one."""
        self.mission: Message | None = None
        """The mission as its model is written; None before it is known."""
        self.events: deque[Message] = deque(maxlen=MOST_EVENTS)
        """The last events, in order."""
        self.heard: deque[tuple[float, bytes]] = deque(maxlen=MOST_FRAMES)
        """Unsigned frames of the last KEPT_S seconds, with the times in seconds at which they were broadcast."""
        self.can_stop = False
        """Whether the vehicles can stand still."""
        self.trails = Trails()
        self.answered: Counter[int] = Counter()
        """Number of requests answered, by HTTP status."""
        self._shown_at_s = -math.inf
        """Time of the newest picture by the monotonic clock."""
        self._browsers: set[Browser] = set()

    @property
    def picture_age_s(self) -> float:
        """Time since the newest picture came; infinite before the first one."""
        return time.monotonic() - self._shown_at_s

    def message(self, message: Message) -> None:
        """Take in a message of a feed."""
        kind = message["type"]
        if kind == "mission":
            self.mission = message["mission"]
            self.can_stop = bool(message.get("can_stop", False))
            return
        if kind == "picture":
            self.picture = dict(message)
            self._shown_at_s = time.monotonic()
        elif kind == "event":
            self.events.append(message["event"])
        elif kind == "moves":
            self.trails.add(message)
        text = orjson.dumps(message).decode()
        if kind in SHOWN:
            self._texts[kind] = text
        for browser in self._browsers:
            browser.put(kind, text)

    def frames(self, t_s: float, datagrams: Sequence[bytes]) -> None:
        """Keep unsigned frames that were broadcast at a time in seconds."""
        self.heard.extend((t_s, datagram) for datagram in datagrams)
        while self.heard and self.heard[0][0] < t_s - KEPT_S:
            self.heard.popleft()

    def forget(self) -> None:
        """Forget all frames, events and trails, as where a playback jumps."""
        self.heard.clear()
        self.events.clear()
        self.trails = Trails()

    def text(self, kind: str) -> str | None:
        """Return the newest message of a type as JSON text; None before the first one."""
        return self._texts.get(kind)

    def events_after(self, number: int) -> list[Message]:
        """Return the events kept with a number above `number`."""
        return [event for event in self.events if event["number"] > number]

    @property
    def browsers(self) -> int:
        """Number of browsers that are shown the stream."""
        return len(self._browsers)

    @contextmanager
    def shown(self) -> Iterator[Browser]:
        """Show the stream to a browser, at first all that is there; raises Refused if there are too many."""
        if len(self._browsers) >= MOST_BROWSERS:
            raise Refused(f"{MOST_BROWSERS} streams are open; allowed: that many", 503)
        browser = Browser()
        for kind, text in self._texts.items():
            browser.put(kind, text)
        self._browsers.add(browser)
        try:
            yield browser
        finally:
            self._browsers.discard(browser)
