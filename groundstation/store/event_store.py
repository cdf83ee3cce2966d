"""Events, kept values and recordings on their way to disk: nobody waits in the broadcast loop, and nothing is lost.

A thread writes. What an operator asks is acknowledged once it is on disk, or refused with the reason where the disk
does not take it. What the ground station itself did is a fact: it waits in memory until the disk takes it.
"""

from __future__ import annotations

import errno
import threading
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path

from companion.runtime.console import program_logger
from companion.runtime.io_thread import SLOW_S, IoThread
from groundstation.store.database import Database
from groundstation.store.rows import Batch, EventRow, Recorded

LOGGER = program_logger("groundstation")
RETRY_S = 1.0
"""Time after which a write that failed is tried again."""
ATTEMPTS, PAUSE_S = 3, 0.2
"""Number of times that a write is tried before what waits for it is refused, and the time between two of them."""
MOST_WAITING = 100
"""Greatest number of pictures and frames that wait for the disk; further ones are left out."""
RISK = "not know what was decided since, forget the directive and tell the threats where the mission says"
"""What a restart does whose events and state could not be written."""


@dataclass
class _Ticket:
    """Events that are to be written together, and who waits for them."""

    events: tuple[EventRow, ...]
    written: Future[None] | None
    """Who asked, and may be refused; None for what has happened and must be written some time."""


@dataclass
class _Waiting:
    """What the disk has not taken yet."""

    tickets: list[_Ticket] = field(default_factory=list)
    kept: dict[str, str] = field(default_factory=dict)
    recorded: list[Recorded] = field(default_factory=list)

    def __bool__(self) -> bool:
        return bool(self.tickets or self.kept or self.recorded)


class EventStore:
    """Writes to one store in the background; an error of the disk is told once, and when it is over."""

    def __init__(self, path: Path | None, database: Database | None, files: IoThread, most_recorded_bytes: int) -> None:
        """Write to an open database on a thread; pictures and frames have at most `most_recorded_bytes`.

        Without a database one is made at the path by the first write, or in memory without a path.
        """
        self.path = path
        self._database = Database.in_memory() if path is None else database
        self._files = files
        self._most_recorded_bytes = most_recorded_bytes
        self._lock = threading.Lock()
        self._waiting = _Waiting()
        self._kept: dict[str, str] = {}
        """Kept values as they were handed over last."""
        self._busy_since_s: float | None = None
        self._is_writing = False
        """Whether events or kept values are being written."""
        self._next_s = 0.0
        self.trouble: str | None = None
        """Why the disk takes nothing at present; None if it does."""
        self._left_out = False
        """Whether it was told that pictures and frames are left out."""

    @property
    def is_awaited(self) -> bool:
        """Whether events or kept values are being written, and no error of the disk was told."""
        with self._lock:
            unwritten = self._waiting.tickets or self._waiting.kept or self._is_writing
            return bool(unwritten) and self.trouble is None

    def append(self, events: Iterable[EventRow]) -> Future[None]:
        """Write what somebody asked for; the future ends when it is on disk, or with OSError if it is refused.

        A future that is cancelled before its turn leaves nothing on disk; one that cannot be cancelled any more is
        being written. While the disk is in trouble everything is refused at once, but for one try every RETRY_S.
        """
        future: Future[None] = Future()
        with self._lock:
            if self.trouble is not None and (self._busy_since_s is not None or time.monotonic() < self._next_s):
                future.set_exception(OSError(errno.EIO, self.trouble))
                return future
            self._waiting.tickets.append(_Ticket(tuple(events), future))
        self._begin()
        return future

    def note(self, events: Iterable[EventRow]) -> None:
        """Write what has happened; it is tried until the disk takes it."""
        noted = tuple(events)
        if noted:
            with self._lock:
                self._waiting.tickets.append(_Ticket(noted, None))
            self._begin()

    def keep(self, name: str, value: str) -> None:
        """Write the newest of the values of a name; it is tried until the disk takes it or a newer one comes."""
        with self._lock:
            if self._kept.get(name) == value:
                return
            self._kept[name] = self._waiting.kept[name] = value
        self._begin()

    def record(self, things: Sequence[Recorded]) -> None:
        """Write pictures and frames, if the disk takes them now."""
        with self._lock:
            if len(self._waiting.recorded) + len(things) <= MOST_WAITING:
                self._waiting.recorded += things
        self._begin()

    def retry_if_due(self) -> None:
        """Try again to write what the disk did not take, and tell of a disk that hangs; call it regularly."""
        with self._lock:
            busy_s = 0.0 if self._busy_since_s is None else time.monotonic() - self._busy_since_s
            if busy_s > SLOW_S:
                self._tell("the disk is too slow")
            due = bool(self._waiting) and time.monotonic() >= self._next_s
        if due:
            self._begin()

    def close(self) -> None:
        """Have the file closed after the last write; what the disk does not take by then is lost."""
        self._next_s = 0.0
        self._begin()
        self._files.do(self._close)

    def _begin(self) -> None:
        with self._lock:
            now_s = time.monotonic()
            if self._busy_since_s is not None or now_s < self._next_s or not self._waiting:
                return
            self._busy_since_s = now_s
        if not self._files.do(self._work):
            with self._lock:
                self._busy_since_s = None
                self._refuse("the disk is too slow")

    def _work(self) -> None:
        """Write all that waits, in turn, until nothing does or the disk refuses; on the thread."""
        while True:
            with self._lock:
                taken, self._waiting = self._waiting, _Waiting()
                self._is_writing = bool(taken.tickets or taken.kept)
                if not taken:
                    self._busy_since_s = None
                    return
            tickets = [
                one for one in taken.tickets if one.written is None or one.written.set_running_or_notify_cancel()
            ]
            batch = Batch(tuple(event for ticket in tickets for event in ticket.events), taken.kept)
            try:
                if batch.events or batch.kept:
                    self._write(batch)
            except OSError as error:
                self._put_back(tickets, taken, error.strerror or str(error))
                return
            for ticket in tickets:
                if ticket.written is not None:
                    ticket.written.set_result(None)
            self._recover()
            self._record(taken.recorded)

    def _write(self, batch: Batch) -> None:
        """Write a batch, trying again after faults that pass; raises OSError."""
        for attempt in range(ATTEMPTS):
            try:
                self._there().write(batch)
                return
            except OSError:
                if attempt == ATTEMPTS - 1:
                    raise
            time.sleep(PAUSE_S)

    def _there(self) -> Database:
        """Return the open database: made if there is none yet, and anew if its file was taken away; raises OSError."""
        if self._database is None:
            assert self.path is not None
            self._database = Database.create(self.path, Batch())
        elif self.path is not None and not self._database.is_in_place():
            new = self._database.moved_to(self.path)
            self._database.close()
            self._database = new
            LOGGER.warning("%s: it was taken away; a new one has all events, but no pictures and frames", self.path)
        return self._database

    def _close(self) -> None:
        if self._database is not None:
            self._database.close()

    def _record(self, things: Sequence[Recorded]) -> None:
        if not things:
            return
        try:
            self._there().record(things, self._most_recorded_bytes)
        except OSError as error:
            if not self._left_out:
                LOGGER.warning("%s: pictures and frames are left out: %s", self.path, error.strerror)
            self._left_out = True
        else:
            self._left_out = False

    def _put_back(self, tickets: Sequence[_Ticket], taken: _Waiting, why: str) -> None:
        """Refuse what may be refused, and let facts and kept values wait, before what came meanwhile."""
        with self._lock:
            facts = [ticket for ticket in tickets if ticket.written is None]
            self._waiting.tickets[:0] = facts
            self._waiting.kept = {**taken.kept, **self._waiting.kept}
            self._busy_since_s, self._is_writing = None, False
            self._next_s = time.monotonic() + RETRY_S
            self._tell(why)
        for ticket in tickets:
            if ticket.written is not None:
                ticket.written.set_exception(OSError(errno.EIO, why))

    def _refuse(self, why: str) -> None:
        """Refuse all that may be refused; the lock is held."""
        asked = [ticket for ticket in self._waiting.tickets if ticket.written is not None]
        self._waiting.tickets = [ticket for ticket in self._waiting.tickets if ticket.written is None]
        self._next_s = time.monotonic() + RETRY_S
        self._tell(why)
        for ticket in asked:
            if ticket.written is not None and ticket.written.set_running_or_notify_cancel():
                ticket.written.set_exception(OSError(errno.EIO, why))

    def _recover(self) -> None:
        with self._lock:
            self._is_writing = False
            was, self.trouble = self.trouble, None
        if was is not None:
            LOGGER.info("%s: the store is written again", self.path)

    def _tell(self, why: str) -> None:
        """Tell of trouble with the disk once; the lock is held."""
        if self.trouble is None:
            LOGGER.warning(
                "%s: cannot write the store: %s; it is tried again; commands are refused meanwhile, and a restart now "
                "would %s",
                self.path,
                why,
                RISK,
            )
        self.trouble = why
