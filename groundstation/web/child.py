"""The web process: started by the ground station (bridge.py) with a pipe and a listening socket, and ends with it."""

from __future__ import annotations

import asyncio
import ctypes
import os
import signal
import socket
import sys

from companion.errors import InputError
from companion.runtime.console import messages_as_json, program_logger
from groundstation.web.live_feed import LiveFeed
from groundstation.web.server import serve
from groundstation.web.site import site_from

LOGGER = program_logger("groundstation")
_PR_SET_PDEATHSIG = 1
"""Of prctl(2)."""
NICENESS = 5
"""The page yields the processor to the broadcast."""


async def _run(pipe: socket.socket, listener: socket.socket) -> None:
    feed = await LiveFeed.open(pipe)
    hello = await feed.greeting()
    site = site_from(hello["site"])
    if site.log_format == "json":
        for name in ("groundstation", "uvicorn.error"):
            messages_as_json(name)
    await serve(feed, site, listener, bytes.fromhex(hello["session_key"]))


def _die_with_parent() -> None:
    """Have this process killed when the ground station is: the next one needs the listening socket's address at once.

    Only Linux can; elsewhere the end of the pipe does it, some time later.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def main() -> None:
    """Serve until the pipe, whose descriptor is the first argument, ends; the second is the listening socket's."""
    _die_with_parent()
    # Ctrl-C reaches the whole group of processes: the ground station decides what ends when.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(NICENESS)
    pipe, listener = (socket.socket(fileno=int(number)) for number in sys.argv[1:])
    try:
        asyncio.run(_run(pipe, listener))
    except InputError as error:
        LOGGER.error("page: %s", error)


if __name__ == "__main__":
    main()
