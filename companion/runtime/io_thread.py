"""A thread for writes that may be slow (a disk, a full pipe), so that the setpoint loop never waits for them."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

MAX_WAITING_JOBS = 1_000
"""Greatest number of waiting jobs; while a disk hangs, further jobs are dropped and the setpoint loop goes on."""
FILE_CHUNK_BYTES = 65_536
"""Number of buffered bytes from which an IoThreadFile hands them to the thread without being flushed."""
CLOSE_TIMEOUT_S = 5.0
"""Longest wait for a place in the queue, and then for the thread to end, when an IoThread is closed."""


class IoThread:
    """A thread that does jobs one after the other. A job must not raise anything but OSError, which is ignored."""

    def __init__(self, name: str) -> None:
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue(MAX_WAITING_JOBS)
        # Not waited for at exit: a disk or pipe that hangs for ever must not keep the program from ending.
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def do(self, job: Callable[[], None]) -> bool:
        """Queue a job for the thread; return False, and drop the job, if MAX_WAITING_JOBS wait already."""
        try:
            self._jobs.put_nowait(job)
        except queue.Full:
            return False
        return True

    def close(self) -> None:
        """Wait until all queued jobs are done, but no longer than twice CLOSE_TIMEOUT_S."""
        with suppress(queue.Full):
            self._jobs.put(None, timeout=CLOSE_TIMEOUT_S)
            self._thread.join(CLOSE_TIMEOUT_S)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            with suppress(OSError):
                job()


class IoThreadFile:
    """A binary file that an IoThread writes; an error of the disk is raised by the next call of `write`."""

    def __init__(self, path: Path, background: IoThread) -> None:
        """Open the file, replacing an older one; raises OSError."""
        self._file = path.open("wb", buffering=0)
        self._background = background
        self._pending = bytearray()
        self._error: OSError | None = None
        self._closed = False

    def write(self, content: bytes) -> None:
        """Buffer bytes for the next flush; raises the OSError of an earlier write that failed."""
        if self._error is not None:
            raise self._error
        self._pending += content
        if len(self._pending) >= FILE_CHUNK_BYTES:
            self.flush()

    def flush(self) -> None:
        """Hand the buffered bytes to the thread; raises OSError if its queue is full because the disk is too slow."""
        if self._closed or not self._pending:
            return
        content, self._pending = bytes(self._pending), bytearray()
        if not self._background.do(lambda: self._write_out(content)):
            raise OSError(0, "the disk is too slow")

    def close(self) -> None:
        """Flush, and have the thread close the file after its last write."""
        if not self._closed:
            self.flush()
            self._closed = True
            self._background.do(self._file.close)

    def _write_out(self, content: bytes) -> None:
        try:
            while content and self._error is None:
                content = content[self._file.write(content) :]
        except OSError as error:
            self._error = error
