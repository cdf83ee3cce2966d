"""Reader of lines on standard input that set the directive for all vehicles."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Callable

from companion.errors import InputError, nearest_hint
from companion.protocol.messages import Directive
from companion.runtime.console import program_logger

LOGGER = program_logger("groundstation")
_LINE_BYTES = 4096
"""Greatest number of bytes read at once, and kept of a line that is not complete."""


def directive_from(line: str) -> Directive:
    """Return the directive that a line names.

    Raises:
        InputError: the line names no directive.

    """
    words = {directive.name.lower(): directive for directive in Directive}
    word = line.strip().lower()
    if word not in words:
        raise InputError(f"directive: '{word[:40]}'{nearest_hint(word, words)}; allowed: {', '.join(words)}")
    return words[word]


class DirectiveInput:
    """Tells of the directives in lines on standard input.

    Nothing is read if no input can be waited for, as without standard input or in the background of a terminal.
    """

    def __init__(self, direct: Callable[[Directive], None]) -> None:
        """Begin to read on the running event loop; `direct` is called with each directive."""
        self._direct = direct
        self._loop = asyncio.get_running_loop()
        self._descriptor: int | None = _standard_input()
        self._begun_line = b""
        try:
            self._loop.add_reader(self._descriptor, self._read)
        except (OSError, ValueError):
            self._descriptor = None
            return
        # In the background a terminal would stop a program that reads from it; so reading fails instead.
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)

    def close(self) -> None:
        """Stop reading."""
        if self._descriptor is not None:
            self._loop.remove_reader(self._descriptor)
            self._descriptor = None

    def _read(self) -> None:
        assert self._descriptor is not None
        try:
            chunk = os.read(self._descriptor, _LINE_BYTES)
        except OSError:
            chunk = b""
        if not chunk:
            self.close()
            return
        *lines, begun = (self._begun_line + chunk).split(b"\n")
        self._begun_line = begun[-_LINE_BYTES:]
        for line in lines:
            self._obey(line.decode(errors="replace"))

    def _obey(self, line: str) -> None:
        if not line.strip():
            return
        try:
            self._direct(directive_from(line))
        except InputError as error:
            LOGGER.error("%s", error)


def _standard_input() -> int:
    try:
        return sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):
        return -1
