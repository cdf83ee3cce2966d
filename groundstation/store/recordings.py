"""A recorded run as a playback sees it: what was known, decided and sent up to any time of it."""

from __future__ import annotations

import json
from bisect import bisect_right
from collections.abc import Iterator
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from companion.errors import InputError
from companion.files.records import STAMP
from companion.files.tlog import whole_frames
from groundstation.operations import Operations, applied
from groundstation.store.chapters import Chapter, chapters_in, event_of_row
from groundstation.store.database import Database

Json = dict[str, Any]


class Span(NamedTuple):
    """The time that a recording covers, Unix seconds."""

    from_s: float
    to_s: float


class Recording(Protocol):
    """What a playback plays."""

    @property
    def span(self) -> Span:
        """The time that it covers."""

    def mission_at(self, at_s: float) -> Json | None:
        """Return the mission as it was at a time, as its model is written; None if it is not known."""

    def picture_at(self, at_s: float) -> Json | None:
        """Return the newest picture up to a time; None before the first."""

    def events(self, after_s: float, to_s: float) -> list[Json]:
        """Return the events after one time, up to another, at most the last MOST_EVENTS of them."""

    def frames(self, after_s: float, to_s: float) -> Iterator[tuple[float, list[bytes]]]:
        """Yield the unsigned frames that were broadcast after one time, up to another."""


MOST_EVENTS = 1_000
"""Greatest number of events that a playback is given at once."""


class _Folded(NamedTuple):
    """What the events of a chapter up to a number make of its mission."""

    chapter: Chapter
    number: int
    operations: Operations


class StoredRun:
    """A recording in a store."""

    def __init__(self, path: Path) -> None:
        """Open a store to read it; raises InputError if it cannot be, or if it holds no event and no picture."""
        self._database = Database.read_only(path)
        self._chapters = chapters_in(self._database.all_kept())
        self._folded: _Folded | None = None
        """What was asked for last, from which what comes later goes on."""
        numbered = [(row.number, row.unix_s) for row in self._database.events()]
        self._numbers = [number for number, _ in numbered]
        self._times_s = [at_s for _, at_s in numbered]
        spans = [span for span in (self._database.span_s("picture"), self._database.span_s("frames")) if span]
        times_s = [at_s for span in spans for at_s in span] or self._times_s
        if not times_s:
            self._database.close()
            raise InputError(f"{path}: no events and no pictures; allowed: the store of a run")
        self.span = Span(min(times_s), max(times_s))

    def close(self) -> None:
        """Close the store."""
        self._database.close()

    def mission_at(self, at_s: float) -> Json | None:
        """Return the mission as it was at a time: that of its chapter, with the events since."""
        number = self._last_number(at_s)
        chapters = [chapter for chapter in self._chapters if chapter.first <= max(number, 1)]
        if not chapters:
            return None
        operations = self._operations(chapters[-1], number)
        mission: Json = operations.mission.model_dump(mode="json")
        return mission

    def picture_at(self, at_s: float) -> Json | None:
        """Return the newest picture up to a time; None before the first."""
        recorded = self._database.last_picture(at_s)
        if recorded is None:
            return None
        try:
            picture: Json = json.loads(recorded.body)
        except ValueError:
            return None
        return picture

    def events(self, after_s: float, to_s: float) -> list[Json]:
        """Return the events after one time, up to another, at most the last MOST_EVENTS of them."""
        first, last = (bisect_right(self._times_s, at_s) for at_s in (after_s, to_s))
        first = max(first, last - MOST_EVENTS)
        if first >= last:
            return []
        after = self._numbers[first] - 1
        return [json.loads(row.body) for row in self._database.events(after, self._numbers[last - 1])]

    def frames(self, after_s: float, to_s: float) -> Iterator[tuple[float, list[bytes]]]:
        """Yield the unsigned frames that were broadcast after one time, up to another."""
        # The frames of a second are stored at its end.
        for recorded in self._database.recorded("frames", after_s, to_s + 2.0):
            for at_s, frame in records_in(recorded.body):
                if after_s < at_s <= to_s:
                    yield at_s, [frame]

    def _last_number(self, at_s: float) -> int:
        index = bisect_right(self._times_s, at_s)
        return self._numbers[index - 1] if index else 0

    def _operations(self, chapter: Chapter, number: int) -> Operations:
        before = self._folded
        if before is None or before.chapter is not chapter or before.number > number:
            before = _Folded(chapter, chapter.first - 1, Operations.begun(chapter.mission()))
        rows = self._database.events(before.number, number)
        operations = reduce(applied, map(event_of_row, rows), before.operations)
        self._folded = _Folded(chapter, number, operations)
        return operations


def records_in(body: bytes) -> Iterator[tuple[float, bytes]]:
    """Yield the records (Unix s, frame) of a piece of a .tlog that this program wrote."""
    at = 0
    while at + STAMP.size < len(body):
        frame = next(whole_frames(body[at + STAMP.size :]), None)
        if frame is None:
            return
        yield STAMP.unpack_from(body, at)[0] / 1e6, frame
        at += STAMP.size + len(frame)
