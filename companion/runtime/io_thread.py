"""A thread for writes that may be slow (a disk, a full pipe), so that the setpoint loop never waits for them."""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Protocol

MAX_WAITING_JOBS = 1_000
"""Greatest number of waiting jobs; while a disk hangs, further jobs are dropped and the setpoint loop goes on."""
FILE_CHUNK_BYTES = 65_536
"""Number of buffered bytes from which an IoThreadFile hands them to the thread without being flushed."""
SLOW_S = 10.0
"""Time for which a disk may keep bytes waiting before it counts as one that hangs."""
FIRST_RETRY_S = 1.0
MOST_RETRY_S = 30.0
"""Times after which an IoThreadFile tries again after an error: each is twice the one before, to the greatest."""
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


def open_io_thread(name: str, stack: ExitStack) -> IoThread:
    """Return a new thread, which `stack` closes."""
    thread = IoThread(name)
    stack.callback(thread.close)
    return thread


class Target(Protocol):
    """An object that appends bytes to a file, such as companion.files.log_series.LogSeries."""

    def append(self, content: bytes) -> None:
        """Append bytes, all of them or none; raises OSError, and a later call tries again."""
        ...

    def close(self) -> None:
        """Close the file; raises OSError."""
        ...


class IoThreadFile:
    """A binary file that an IoThread writes. After an error of the disk it tries again by itself, less and less often.

    What was to be written until then is lost, but for the bytes at which the error came: they are the first that are
    written again.
    """

    def __init__(self, target: Target, background: IoThread) -> None:
        self._target = target
        self._background = background
        self._pending = bytearray()
        self._handed: deque[float] = deque()
        """Times at which bytes were handed to the thread that it has not written yet."""
        self._error: OSError | None = None
        self._kept = b""
        """The bytes at which the error came."""
        self._retry_at_s = 0.0
        self._retry_s = FIRST_RETRY_S
        self._retrying = False
        self._closed = False

    def write(self, content: bytes) -> None:
        """Buffer bytes for the next flush; raises OSError, and drops them, while the disk takes none."""
        if self._error is not None:
            self._pending.clear()
            self._try_again()
            raise OSError(self._error.errno, self._error.strerror)
        self._pending += content
        if len(self._pending) >= FILE_CHUNK_BYTES:
            self.flush()

    def flush(self) -> None:
        """Hand the buffered bytes to the thread."""
        if self._closed or not self._pending or self._error is not None:
            return
        content, self._pending = bytes(self._pending), bytearray()
        now_s = time.monotonic()
        # Noted before it is handed over: the thread may have written it before do() returns, and takes off only what
        # it was given, so that this one stands here meanwhile.
        self._handed.append(now_s)
        is_hung = now_s - self._handed[0] > SLOW_S
        if is_hung or not self._background.do(lambda: self._write_out(content)):
            self._handed.pop()
            self._fail(OSError(0, "the disk is too slow"), content)

    def close(self) -> None:
        """Flush, and have the thread close the file after its last write."""
        if not self._closed:
            self.flush()
            self._closed = True
            self._background.do(self._target.close)

    def _write_out(self, content: bytes) -> None:
        if self._error is None:
            try:
                self._target.append(content)
                self._retry_s = FIRST_RETRY_S
            except OSError as error:
                self._fail(error, content)
        self._handed.popleft()

    def _fail(self, error: OSError, content: bytes) -> None:
        self._kept = content
        self._retry_at_s = time.monotonic() + self._retry_s
        self._retry_s = min(2.0 * self._retry_s, MOST_RETRY_S)
        self._error = error

    def _try_again(self) -> None:
        if not self._retrying and time.monotonic() >= self._retry_at_s:
            self._retrying = self._background.do(self._write_kept)

    def _write_kept(self) -> None:
        try:
            self._target.append(self._kept)
        except OSError as error:
            self._fail(error, self._kept)
        else:
            self._error = None
        self._retrying = False
