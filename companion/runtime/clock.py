"""What the shells of all three programs share: a clock that never steps, waiting, and running until a signal."""

from __future__ import annotations

import asyncio
import signal
import time
from collections.abc import Callable, Coroutine
from typing import TypeVar

Result = TypeVar("Result")

_MICROSECONDS = 1e6
BACKLOG_DATAGRAMS = 256
"""Several seconds of an autopilot's telemetry: what a program that hung finds waiting."""


def logged_s(t_unix_s: float) -> float:
    """Return a time as a log gives it back: who acts on it acts the same again in a replay."""
    return round(t_unix_s * _MICROSECONDS) / _MICROSECONDS


class SteadyClock:
    """Unix time that never steps, in whole microseconds: as logs hold it, so that a replay has the very same times."""

    def __init__(self) -> None:
        self._offset_s = time.time() - time.monotonic()

    def now_s(self) -> float:
        """Return seconds since 1970 by the system clock at the start plus what the monotonic clock has counted."""
        return logged_s(self._offset_s + time.monotonic())


async def drain_sockets() -> None:
    """Let every socket hand over what came while the program hung, before anything is decided on what is older."""
    for _ in range(BACKLOG_DATAGRAMS):
        # A socket hands over one datagram in a round of the loop.
        await asyncio.sleep(0.0)


async def wait(stop: asyncio.Event, wait_s: float) -> None:
    """Wait for `wait_s` seconds, or until `stop` is set."""
    try:
        await asyncio.wait_for(stop.wait(), max(wait_s, 0.0))
    except TimeoutError:
        # Late or not, the sockets get their turn.
        await asyncio.sleep(0.0)


def run_until_signal(program: Callable[[asyncio.Event], Coroutine[None, None, Result]]) -> Result:
    """Run a program that ends when its event is set, set it on SIGINT or SIGTERM, and return what it returns."""

    async def run() -> Result:
        stop = asyncio.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        return await program(stop)

    return asyncio.run(run())
