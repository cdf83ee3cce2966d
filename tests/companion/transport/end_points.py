"""Helpers of the tests of end points: an event loop with a time limit, and waiting for a condition."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

WITHIN_S = 10.0


def run(body: Callable[[], Awaitable[None]]) -> None:
    """Run a test's body in an event loop; fail it if it takes longer than WITHIN_S."""

    async def within_time() -> None:
        await asyncio.wait_for(body(), WITHIN_S)

    asyncio.run(within_time())


async def until(condition: Callable[[], bool]) -> None:
    """Return as soon as the condition holds; fail if it does not within about two seconds."""
    for _ in range(1000):
        if condition():
            return
        await asyncio.sleep(0.002)
    raise AssertionError("nothing arrived")
