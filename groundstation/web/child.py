"""The web process: started by the ground station (bridge.py) with a pipe and a listening socket, and ends with it.

It is killed when the ground station is, as early in its life as can be: the next ground station needs the listening
socket's address at once. So everything that takes time to load is loaded after that is arranged.
"""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import struct
import sys

_PR_SET_PDEATHSIG = 1
"""Of prctl(2)."""
_CREDENTIALS = struct.Struct("3i")
"""Process, user and group of who made a socket pair (SO_PEERCRED)."""
NICENESS = 5
"""The page yields the processor to the broadcast."""


def _die_with_parent(pipe: socket.socket) -> None:
    """Have this process killed when the ground station is, or end it if that is gone already.

    Only Linux can; elsewhere the end of the pipe ends the process, some time later.
    """
    if sys.platform != "linux":
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    maker, _, _ = _CREDENTIALS.unpack(pipe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size))
    if os.getppid() != maker:
        sys.exit()


async def _run(pipe: socket.socket, listener: socket.socket) -> None:
    from companion.runtime.console import messages_as_json
    from groundstation.web.live_feed import LiveFeed
    from groundstation.web.server import serve
    from groundstation.web.site import site_from

    feed = await LiveFeed.open(pipe)
    hello = await feed.greeting()
    site = site_from(hello["site"])
    if site.log_format == "json":
        for name in ("groundstation", "uvicorn.error"):
            messages_as_json(name)
    await serve(feed, site, listener, bytes.fromhex(hello["session_key"]))


def main() -> None:
    """Serve until the pipe, whose descriptor is the first argument, ends; the second is the listening socket's."""
    pipe, listener = (socket.socket(fileno=int(number)) for number in sys.argv[1:])
    _die_with_parent(pipe)
    os.nice(NICENESS)
    import asyncio

    from companion.errors import InputError
    from companion.runtime.console import program_logger

    try:
        asyncio.run(_run(pipe, listener))
    except InputError as error:
        program_logger("groundstation").error("page: %s", error)


if __name__ == "__main__":
    main()
