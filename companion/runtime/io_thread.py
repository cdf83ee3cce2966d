"""What may be slow (disks, a full pipe) done on a thread of its own, in order: the setpoint loop never waits for it."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

MAX_WAITING_JOBS = 1_000
"""Jobs that may wait; a disk that hangs for longer loses what comes then, not the loop."""
FILE_CHUNK_BYTES = 65_536
"""A background file hands on what it was given in pieces of about this size, or when it is flushed."""
CLOSE_TIMEOUT_S = 5.0


class IoThread:
    """One thread that does jobs one after the other. A job must not raise anything but OSError, which is dropped."""

    def __init__(self, name: str) -> None:
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue(MAX_WAITING_JOBS)
        # Not waited for at exit: a disk or pipe that hangs for ever must not keep the program from ending.
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def do(self, job: Callable[[], None]) -> bool:
        """Have a job done; return False, and drop it, if too many wait already."""
        try:
            self._jobs.put_nowait(job)
        except queue.Full:
            return False
        return True

    def close(self) -> None:
        """Wait until everything is done, but not for ever."""
        with suppress(queue.Full):
            self._jobs.put(None, timeout=CLOSE_TIMEOUT_S)
            self._thread.join(CLOSE_TIMEOUT_S)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            with suppress(OSError):
                job()


class IoThreadFile:
    """A binary file for writing whose disk is waited for elsewhere; its errors are raised at the next write."""

    def __init__(self, path: Path, background: IoThread) -> None:
        """Open the file, replacing an older one; raises OSError."""
        self._file = path.open("wb", buffering=0)
        self._background = background
        self._pending = bytearray()
        self._error: OSError | None = None
        self._closed = False

    def write(self, content: bytes) -> None:
        """Keep bytes for the next flush; raises OSError for what went wrong before."""
        if self._error is not None:
            raise self._error
        self._pending += content
        if len(self._pending) >= FILE_CHUNK_BYTES:
            self.flush()

    def flush(self) -> None:
        """Hand what is kept to the thread; raises OSError if the disk has been too slow for too long."""
        if self._closed or not self._pending:
            return
        content, self._pending = bytes(self._pending), bytearray()
        if not self._background.do(lambda: self._write_out(content)):
            raise OSError(0, "the disk is too slow")

    def close(self) -> None:
        """Write out and close, when the thread comes to it."""
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
