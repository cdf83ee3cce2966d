"""Autopilot links that are byte streams: TCP that connects again, a serial line."""

from __future__ import annotations

import asyncio
import os
import socket
import tty

import pytest
from pymavlink.dialects.v20 import common

from companion.errors import InputError
from companion.transport import tcp as tcp_module
from companion.transport.endpoints import Link, open_duplex, parse_link
from tests.companion.transport.end_points import run, until

LOCALHOST = "127.0.0.1"
_MAV = common.MAVLink(None, srcSystem=1, srcComponent=1)
HEARTBEAT = bytes(common.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3).pack(_MAV))
LONG_TEXT = bytes(common.MAVLink_statustext_message(6, b"x" * 50, 1, 0).pack(_MAV))


class Server:
    """A TCP server that a test speaks through, one client at a time."""

    def __init__(self) -> None:
        self.heard = b""
        self.writer: asyncio.StreamWriter | None = None
        self.clients = 0
        self._server: asyncio.Server | None = None

    async def open(self, port: int = 0) -> int:
        self._server = await asyncio.start_server(self._serve, LOCALHOST, port, reuse_address=True)
        return int(self._server.sockets[0].getsockname()[1])

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.writer = writer
        self.clients += 1
        while chunk := await reader.read(1000):
            self.heard += chunk

    def close(self) -> None:
        assert self._server is not None
        self._server.close()
        if self.writer is not None:
            self.writer.transport.abort()


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tcp_module, "RECONNECT_FIRST_S", 0.01)


@pytest.mark.usefixtures("at_once")
def test_a_tcp_link_goes_both_ways() -> None:
    async def body() -> None:
        server = Server()
        heard: list[bytes] = []
        duplex = await open_duplex(Link("tcp", LOCALHOST, await server.open()), lambda chunk, _: heard.append(chunk))
        await until(lambda: server.writer is not None)
        assert server.writer is not None
        server.writer.write(HEARTBEAT[:5])
        await asyncio.sleep(0.02)
        server.writer.write(HEARTBEAT[5:] + LONG_TEXT)
        duplex.send(HEARTBEAT)
        await until(lambda: b"".join(heard) == HEARTBEAT + LONG_TEXT and server.heard == HEARTBEAT)
        duplex.close()
        server.close()

    run(body)


@pytest.mark.usefixtures("at_once")
def test_a_tcp_link_comes_back_after_the_other_end_was_gone() -> None:
    async def body() -> None:
        first, second = Server(), Server()
        heard: list[bytes] = []
        port = await first.open()
        duplex = await open_duplex(Link("tcp", LOCALHOST, port), lambda chunk, _: heard.append(chunk))
        await until(lambda: first.writer is not None)
        first.close()
        await asyncio.sleep(0.05)
        duplex.send(HEARTBEAT)
        assert duplex.counts.failed > 0
        await second.open(port)
        await until(lambda: second.writer is not None)
        assert second.writer is not None
        second.writer.write(HEARTBEAT)
        await until(lambda: heard == [HEARTBEAT])
        assert duplex.counts.reopened == 1
        duplex.close()
        second.close()

    run(body)


def test_a_tcp_link_to_nobody_is_no_error_and_costs_no_time() -> None:
    async def body() -> None:
        with socket.socket() as taken:
            taken.bind((LOCALHOST, 0))
            loop = asyncio.get_running_loop()
            began_s = loop.time()
            duplex = await open_duplex(Link("tcp", LOCALHOST, taken.getsockname()[1]), lambda *_: None)
            duplex.send(HEARTBEAT)
            assert loop.time() - began_s < 0.5
            await until(lambda: duplex.counts.failed >= 2)
            duplex.close()

    run(body)


def test_a_tcp_link_to_an_unknown_host_is_refused() -> None:
    async def body() -> None:
        with pytest.raises(InputError, match="host name 'no-such-host.invalid' is unknown"):
            await open_duplex(parse_link("tcp:no-such-host.invalid:5760"), lambda *_: None)

    run(body)


def test_a_serial_line_to_an_autopilot_goes_both_ways() -> None:
    async def body() -> None:
        far, near = os.openpty()
        tty.setraw(near)
        heard: list[bytes] = []
        duplex = await open_duplex(
            Link("serial", path=os.ttyname(near), baud=57600), lambda chunk, _: heard.append(chunk)
        )
        os.write(far, b"\xfd\x03noise" + HEARTBEAT[:9])
        await asyncio.sleep(0.02)
        os.write(far, HEARTBEAT[9:])
        await until(lambda: b"".join(heard) == b"\xfd\x03noise" + HEARTBEAT)
        duplex.send(LONG_TEXT)
        await asyncio.sleep(0.02)
        assert os.read(far, 1000) == LONG_TEXT
        duplex.close()
        for end in (far, near):
            os.close(end)

    run(body)


def test_a_missing_serial_port_is_named() -> None:
    async def body() -> None:
        with pytest.raises(InputError, match="link 'serial:/dev/no-such-port:57600': no such device"):
            await open_duplex(parse_link("serial:/dev/no-such-port:57600"), lambda *_: None)

    run(body)
