"""Telemetry logs as links: a sender writes one, a receiver plays one back at the pace at which it was recorded."""

from __future__ import annotations

import asyncio
import time

from companion.errors import InputError
from companion.files.tlog import Tlog, TlogWriter, read_tlog, whole_frames
from companion.transport.link import Link, OnDatagram, ReceiveCounts, Receiver, Sender


async def open_file_receiver(link: Link, on_datagram: OnDatagram) -> Receiver:
    """Play a log back, one frame at a time; raises InputError if it cannot be read."""
    playback = _Playback(read_tlog(link.path), on_datagram)
    return Receiver(playback.close, playback.counts)


async def open_file_sender(link: Link) -> FileSender:
    """Begin a log, replacing an older one; raises InputError if it cannot be written."""
    return FileSender(TlogWriter(link.path))


MOST_PAUSE_S = 3_600.0
"""Time between two records above which no flight was logged: the clock was set, and the second is played at once."""


class FileSender(Sender):
    """Writes each frame with the time at which it was sent."""

    def __init__(self, writer: TlogWriter) -> None:
        super().__init__()
        self._writer: TlogWriter | None = writer

    def send(self, datagram: bytes) -> None:
        """Append a datagram's frames; a datagram that has other bytes, or cannot be written, is counted as failed."""
        frames = list(whole_frames(datagram))
        if self._writer is None or sum(map(len, frames)) != len(datagram):
            self.counts.failed += 1
            return
        try:
            for frame in frames:
                self._writer.write(time.time(), frame)
            # Flushed at once, so that a log that is cut off lacks nothing that was sent before.
            self._writer.flush()
        except OSError:
            self.counts.failed += 1
        else:
            self.counts.sent += 1

    def close(self) -> None:
        """Close the log; later sends count as failed."""
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.close()
            except OSError:
                self.counts.failed += 1


class _Playback:
    """Hands a log's frames on when they are due, one at a time so that other tasks on the event loop get their turn."""

    def __init__(self, records: Tlog, on_datagram: OnDatagram) -> None:
        self.counts = ReceiveCounts()
        self._records = records
        self._on_datagram = on_datagram
        self._loop = asyncio.get_running_loop()
        self._due_s = self._loop.time()
        """Time of the event loop at which the newest record is due."""
        self._shift_s = 0.0
        """Time of the event loop less that of the log."""
        self._first = True
        """Whether no record was read yet."""
        self._places = 0
        """Number of damaged places in the log that are counted already."""
        self._waiting: asyncio.TimerHandle | None = None
        self._wait_for_next()

    def close(self) -> None:
        """Stop playing."""
        if self._waiting is not None:
            self._waiting.cancel()

    def _wait_for_next(self) -> None:
        try:
            record = next(self._records, None)
        except InputError:
            # The disk is gone, or nothing in the file is a record.
            self.counts.failed += 1
            record = None
        if self._records.places != self._places:
            self.counts.failed += self._records.places - self._places
            self._places = self._records.places
        if record is None:
            self._waiting = None
            return
        t_unix_s, frame = record
        due_s = t_unix_s + self._shift_s
        if self._first or due_s - self._due_s > MOST_PAUSE_S:
            # Where the clock was set while the log was written, nobody waits for years.
            self._first = False
            due_s = self._due_s
            self._shift_s = due_s - t_unix_s
        self._due_s = due_s
        self._waiting = self._loop.call_at(due_s, self._hand_on, frame)

    def _hand_on(self, frame: bytes) -> None:
        self.counts.chunks += 1
        self._wait_for_next()
        self._on_datagram(frame)
