"""Serves the page on a recorded run until it is interrupted."""

from __future__ import annotations

import asyncio

from companion.errors import InputError
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
    program_logger(program).info("page: %s", site.url)
    asyncio.run(serve(Playback(recording), site, listener))
