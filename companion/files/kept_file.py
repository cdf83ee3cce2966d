"""A state file that is written in the background, again and again until the disk takes it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from logging import Logger
from pathlib import Path

from companion.errors import InputError
from companion.files.state import write_state_file
from companion.runtime.io_thread import SLOW_S, IoThread

RETRY_S = 1.0
"""Time after which a write that failed is tried again."""


class KeptFile:
    """Keeps the newest text that it was given in a file; an error of the disk is told once, and when it is over.

    Nobody waits for the disk. Texts that a newer one overtakes are not written.
    """

    def __init__(
        self,
        path: Path,
        files: IoThread,
        logger: Logger,
        risk: str,
        write: Callable[[Path, str], None] = write_state_file,
    ) -> None:
        """Write with `write`, which raises InputError, on a thread; `risk`: what a restart without the text does."""
        self._path = path
        self._files = files
        self._logger = logger
        self._risk = risk
        self._write = write
        self._lock = threading.Lock()
        self._wanted: str | None = None
        self._written: str | None = None
        self._busy_since_s: float | None = None
        self._next_s = 0.0
        self._told = False

    @property
    def is_written(self) -> bool:
        """Whether the newest text is on disk."""
        with self._lock:
            return self._wanted == self._written

    @property
    def is_awaited(self) -> bool:
        """Whether the newest text is being written, and no error of the disk was told."""
        with self._lock:
            return self._wanted != self._written and not self._told

    def write(self, text: str) -> None:
        """Have a text written; call it again regularly until `is_written`."""
        now_s = time.monotonic()
        with self._lock:
            self._wanted = text
            if self._busy_since_s is not None:
                if now_s - self._busy_since_s > SLOW_S:
                    self._tell(f"{self._path}: cannot write the state: the disk is too slow")
                return
            if text == self._written or now_s < self._next_s:
                return
            self._busy_since_s = now_s
        if not self._files.do(self._work):
            with self._lock:
                self._busy_since_s = None
                self._tell(f"{self._path}: cannot write the state: the disk is too slow")

    def _work(self) -> None:
        while (text := self._next_text()) is not None:
            try:
                self._write(self._path, text)
            except InputError as error:
                with self._lock:
                    self._next_s = time.monotonic() + RETRY_S
                    self._busy_since_s = None
                    self._tell(str(error))
                return
            with self._lock:
                self._written = text
                if self._told:
                    self._logger.info("%s: the state is written again", self._path)
                self._told = False

    def _next_text(self) -> str | None:
        """Return the text that is to be written; None, and be idle, if the newest is."""
        with self._lock:
            if self._wanted != self._written:
                return self._wanted
            self._busy_since_s = None
            return None

    def _tell(self, words: str) -> None:
        if not self._told:
            self._told = True
            self._logger.warning("%s; it is tried again; a restart now would %s", words, self._risk)
