"""Ends a flight early: at a signal, or where the disk takes no more; what was flown until then is kept."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from companion.errors import EXIT_SIGNALLED, EXIT_UNUSABLE

SIGNALS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated", signal.SIGHUP: "hung up"}
"""Signals that end a flight early, in words: Ctrl-C, `kill` and the end of the terminal."""


@dataclass(frozen=True)
class Stop:
    """Why a flight is ended early, and the exit status of the program then."""

    why: str
    status: int


def disk_stop(error: OSError, folder: Path | None) -> Stop:
    """Return the reason for ending a flight whose files in a folder cannot be written."""
    where = error.filename or folder
    return Stop(f"{where}: {error.strerror or error}" if where else str(error), EXIT_UNUSABLE)


@contextmanager
def stop_at_signals() -> Iterator[Callable[[], Stop | None]]:
    """Catch SIGNALS while the context lasts; yield the function that says whether one came.

    A second one interrupts at once, by KeyboardInterrupt. A signal that is ignored (as under nohup) stays ignored. In a
    thread that is not the main one nothing is caught.
    """
    came: list[Stop] = []

    def catch(number: int, _: FrameType | None) -> None:
        if came:
            raise KeyboardInterrupt
        name = signal.Signals(number)
        came.append(Stop(f"{SIGNALS[name]} ({name.name})", EXIT_SIGNALLED + number))

    is_main = threading.current_thread() is threading.main_thread()
    taken = [one for one in SIGNALS if is_main and signal.getsignal(one) not in (signal.SIG_IGN, None)]
    before = {one: signal.signal(one, catch) for one in taken}
    try:
        yield lambda: came[0] if came else None
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)
