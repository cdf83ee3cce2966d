"""Serves the page on a recorded run until it is interrupted."""

from __future__ import annotations

import asyncio
import contextlib

from companion.errors import InputError
from companion.runtime.clock import run_until_signal
from companion.runtime.console import program_logger
from groundstation.store.playback import Playback
from groundstation.store.recordings import Recording
from groundstation.web.address import bound, listen, parse_address
from groundstation.web.server import serve
from groundstation.web.site import Site


def serve_playback(recording: Recording, address: str, program: str) -> None:
    """Play a recording on the page at an address of this computer; `program` names who says where.

    Raises:
        InputError: the address cannot be used.

    """
    place = parse_address(address)
    if not place.is_loopback:
        raise InputError(
            f"--ui: '{place}'; allowed for a playback: an address of this computer, such as 127.0.0.1:8750"
        )
    listener = listen(place)
    site = Site(place._replace(port=bound(listener).port), mode="playback")

    async def play(stop: asyncio.Event) -> None:
        """Serve until a signal comes: to the server, or before that takes signals itself."""
        program_logger(program).info("page: %s", site.url)
        serving = asyncio.ensure_future(serve(Playback(recording), site, listener))
        stopped = asyncio.ensure_future(stop.wait())
        await asyncio.wait({serving, stopped}, return_when=asyncio.FIRST_COMPLETED)
        if stopped.done():
            serving.cancel()
        stopped.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await serving

    run_until_signal(play)
