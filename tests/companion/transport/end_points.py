"""What the tests of end points share: an event loop with a time limit, and waiting for what must come."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

WITHIN_S = 10.0


def run(body: Callable[[], Awaitable[None]]) -> None:
    """Run a test's body; one that hangs fails."""

    async def within_time() -> None:
        await asyncio.wait_for(body(), WITHIN_S)

    asyncio.run(within_time())


async def until(condition: Callable[[], bool]) -> None:
    """Return as soon as the condition holds, which must be within about two seconds."""
    for _ in range(1000):
        if condition():
            return
        await asyncio.sleep(0.002)
    raise AssertionError("nothing arrived")
