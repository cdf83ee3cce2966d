"""A clock that never steps, waiting in the event loop, and running a program until a signal ends it."""

from __future__ import annotations

import asyncio
import signal
import time
from collections.abc import Callable, Coroutine
from typing import TypeVar

Result = TypeVar("Result")

_MICROSECONDS = 1e6
DRAIN_ROUNDS = 8
"""Rounds of the event loop that read what waits: a UDP link hands on 128 datagrams in a round, a TCP link 64 KiB every
second round, a serial line all that it holds."""
DRAIN_S = 0.03
"""Time after which no further round is made: a link that never runs dry must not hold up the setpoints."""


def logged_s(t_unix_s: float) -> float:
    """Return a time rounded to the microsecond, as a log stores it: a replay then computes with the flight's times."""
    return round(t_unix_s * _MICROSECONDS) / _MICROSECONDS


def steady_s() -> float:
    """Return seconds of a clock that never steps, and that counts the time while the computer was suspended too."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class SteadyClock:
    """A clock of Unix time that never steps, in whole microseconds (see `logged_s`)."""

    def __init__(self) -> None:
        self._offset_s = time.time() - steady_s()

    def now_s(self) -> float:
        """Return seconds since 1970: the system clock at the start, carried on by the steady clock."""
        return logged_s(self._offset_s + steady_s())


async def drain_sockets() -> None:
    """Let every link hand on what has come until now, so that the next decision has it."""
    began_s = time.monotonic()
    for _ in range(DRAIN_ROUNDS):
        await asyncio.sleep(0.0)
        if time.monotonic() - began_s > DRAIN_S:
            return


async def wait(stop: asyncio.Event, wait_s: float) -> None:
    """Wait for `wait_s` seconds, or until `stop` is set."""
    try:
        await asyncio.wait_for(stop.wait(), max(wait_s, 0.0))
    except TimeoutError:
        # With no time left wait_for returns at once; a loop that is always late must still let the sockets be read.
        await asyncio.sleep(0.0)


def run_until_signal(program: Callable[[asyncio.Event], Coroutine[None, None, Result]]) -> Result:
    """Run a program until it ends; SIGINT and SIGTERM set its stop event. Return the program's result."""

    async def run() -> Result:
        stop = asyncio.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        return await program(stop)

    return asyncio.run(run())
