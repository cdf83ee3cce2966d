"""Keeps in the store what a run shows: a picture a second, and every frame that was broadcast."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

import orjson

from companion.files.records import STAMP
from groundstation.store.rows import Recorded

PERIOD_S = 1.0
"""Least time between two pictures that are kept, by their own times."""
_TOLERANCE_S = 0.1
"""A picture that is early by this is kept, too."""


class Screen(Protocol):
    """What shows a run on a page."""

    def publish(self, message: Mapping[str, Any]) -> None:
        """Show a message."""

    def frames(self, t_s: float, datagrams: Iterable[bytes]) -> None:
        """Show unsigned frames that were broadcast at a time in seconds."""

    def reply(self, identity: int, event: Mapping[str, Any]) -> None:
        """Answer a request with its event."""

    def refuse(self, identity: int, why: str) -> None:
        """Answer a request that is not obeyed."""

    def pump(self) -> Sequence[Any]:
        """Send and receive without waiting, and return what was asked."""


class Keeper(Protocol):
    """Where things are recorded: an EventStore."""

    def record(self, things: Sequence[Recorded]) -> None:
        """Keep pictures and frames, if the disk takes them now."""


class Recorder:
    """A screen that keeps what it is shown, and passes it on to another one, if there is one."""

    def __init__(self, store: Keeper, screen: Screen | None) -> None:
        self._store = store
        self._screen = screen
        self._kept_s = float("-inf")
        """Time of the last picture that was kept."""
        self._heard_s = float("-inf")
        """Time of the last frames."""
        self._records = bytearray()
        """Frames since, as records of a .tlog."""

    def publish(self, message: Mapping[str, Any]) -> None:
        """Keep a picture if it is due, and pass everything on."""
        if message["type"] == "picture" and abs(message["t_s"] - self._kept_s) >= PERIOD_S - _TOLERANCE_S:
            self._kept_s = at_s = message["t_s"]
            self._store.record([Recorded("picture", at_s, orjson.dumps(message)), *self._frames_until(at_s)])
        if self._screen is not None:
            self._screen.publish(message)

    def frames(self, t_s: float, datagrams: Iterable[bytes]) -> None:
        """Keep unsigned frames that were broadcast at a time in seconds, and pass them on."""
        shown = list(datagrams)
        self._heard_s = t_s
        stamp = STAMP.pack(round(1e6 * t_s))
        for frame in shown:
            self._records += stamp + frame
        if self._screen is not None:
            self._screen.frames(t_s, shown)

    def close(self) -> None:
        """Keep the frames since the last picture, as a run ends."""
        self._store.record(self._frames_until(self._heard_s))

    def _frames_until(self, at_s: float) -> list[Recorded]:
        """Return the frames that are not kept yet, the last of them broadcast at a time, and begin anew."""
        if not self._records:
            return []
        frames = Recorded("frames", at_s, bytes(self._records))
        self._records.clear()
        return [frames]

    def reply(self, identity: int, event: Mapping[str, Any]) -> None:
        """Pass an answer on."""
        if self._screen is not None:
            self._screen.reply(identity, event)

    def refuse(self, identity: int, why: str) -> None:
        """Pass an answer on."""
        if self._screen is not None:
            self._screen.refuse(identity, why)

    def pump(self) -> Sequence[Any]:
        """Return what was asked on the other screen."""
        return () if self._screen is None else self._screen.pump()
