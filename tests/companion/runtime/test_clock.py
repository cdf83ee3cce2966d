"""What the shells share."""

from __future__ import annotations

import array
import asyncio
import fcntl
import os
import socket
import termios
import tty

from companion.runtime.clock import drain_sockets
from companion.transport.endpoints import Address, OnChunk, open_duplex, parse_link
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


def waiting(descriptor: int, request: int) -> int:
    """Return how many bytes wait to be read, or to be acknowledged."""
    count = array.array("i", [0])
    fcntl.ioctl(descriptor, request, count)
    return count[0]


def test_a_tcp_link_and_a_serial_line_are_read_to_their_end_before_a_decision() -> None:
    heard: dict[str, bytes] = {"tcp": b"", "serial": b""}
    sent = bytes(range(250)) * 10

    async def run() -> None:
        with socket.create_server(("127.0.0.1", 0)) as server:
            far, near = os.openpty()
            tty.setraw(near)
            links = {
                "tcp": f"tcp:127.0.0.1:{server.getsockname()[1]}",
                "serial": f"serial:{os.ttyname(near)}:115200",
            }

            def into(name: str) -> OnChunk:
                def take(chunk: bytes, _: Address | None) -> None:
                    heard[name] += chunk

                return take

            duplexes = [await open_duplex(parse_link(link), into(name)) for name, link in links.items()]
            server.setblocking(False)
            client, _ = await asyncio.get_running_loop().sock_accept(server)
            with client:
                client.setblocking(True)
                await drain_sockets()
                client.sendall(sent)
                os.write(far, sent)
                # The kernel passes on both in its own time: all of it waits before the program goes on.
                while waiting(near, termios.FIONREAD) < len(sent) or waiting(client.fileno(), termios.TIOCOUTQ):
                    pass
                await drain_sockets()
            for duplex in duplexes:
                duplex.close()
            os.close(far)
            os.close(near)

    asyncio.run(run())
    assert heard == {"tcp": sent, "serial": sent}
