"""What the shells share."""

from __future__ import annotations

import asyncio
import socket

from companion.runtime.clock import drain_sockets
from companion.transport.endpoints import open_duplex, parse_link
from tests.ports import free_port


def test_all_that_came_while_the_program_hung_is_heard_before_it_goes_on() -> None:
    heard: list[bytes] = []

    async def run() -> None:
        port = free_port()
        duplex = await open_duplex(parse_link(f"udpin:127.0.0.1:{port}"), lambda chunk, _: heard.append(chunk))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
            for number in range(100):
                autopilot.sendto(bytes([number]), ("127.0.0.1", port))
        await drain_sockets()
        duplex.close()

    asyncio.run(run())
    assert heard == [bytes([number]) for number in range(100)]
