"""Connections: bounded in number, by address, and in the time that the head of a request takes."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import pytest
from starlette.types import Receive, Scope, Send
from uvicorn import Config
from uvicorn.server import ServerState

from groundstation.web.connection import HEAD_S, MOST_CONNECTIONS, MOST_OF_ONE, BoundedConnection, settings

HEAD = b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"


class _Timer:
    def __init__(self, loop: _Loop, due_s: float, job: Any) -> None:  # noqa: ANN401
        self.due_s, self.job = due_s, job
        self._loop = loop

    def cancel(self) -> None:
        if self in self._loop.timers:
            self._loop.timers.remove(self)


class _Loop:
    """A loop of the test's clock that runs no task."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.timers: list[_Timer] = []

    def call_later(self, wait_s: float, job: Any, *_: Any) -> _Timer:  # noqa: ANN401
        self.timers.append(_Timer(self, self.now_s + wait_s, job))
        return self.timers[-1]

    def create_task(self, work: Any) -> asyncio.Future[None]:  # noqa: ANN401
        work.close()
        return asyncio.Future(loop=_IDLE)

    def advance(self, by_s: float) -> None:
        self.now_s += by_s
        for timer in [timer for timer in self.timers if timer.due_s <= self.now_s]:
            timer.cancel()
            timer.job()


class _Transport:
    def __init__(self, address: str) -> None:
        self.aborted = False
        self.written = b""
        self._address = (address, 50_000)

    def get_extra_info(self, name: str, default: object = None) -> object:
        return {"peername": self._address, "sockname": ("127.0.0.1", 8750)}.get(name, default)

    def abort(self) -> None:
        self.aborted = True

    def write(self, data: bytes) -> None:
        self.written += data

    def is_closing(self) -> bool:
        return self.aborted

    def close(self) -> None:
        self.aborted = True


_IDLE = asyncio.new_event_loop()


@pytest.fixture(scope="module", autouse=True)
def idle_loop() -> Iterator[None]:
    yield
    _IDLE.close()


async def _no_application(_scope: Scope, _receive: Receive, _send: Send) -> None:
    raise AssertionError("no task runs here")


class _Server:
    """Takes connections without a socket."""

    def __init__(self) -> None:
        self.loop = _Loop()
        self._config = Config(_no_application, lifespan="off", **settings())
        self._config.load()
        self._state = ServerState()

    def connect(self, address: str = "127.0.0.1") -> tuple[BoundedConnection, _Transport]:
        connection = BoundedConnection(self._config, self._state, {}, self.loop)  # type: ignore[arg-type]
        transport = _Transport(address)
        connection.connection_made(transport)  # type: ignore[arg-type]
        return connection, transport


def test_a_connection_on_which_no_whole_head_comes_in_time_is_closed_however_often_bytes_come() -> None:
    server = _Server()
    connection, transport = server.connect()
    for byte in HEAD[:20]:
        connection.data_received(bytes([byte]))
        server.loop.advance(HEAD_S / 25.0)
    assert len(server.loop.timers) == 1
    assert not transport.aborted
    server.loop.advance(HEAD_S / 4.0)
    assert transport.aborted


def test_a_whole_head_ends_the_wait_and_an_idle_connection_is_kept_for_the_next_request() -> None:
    server = _Server()
    connection, transport = server.connect()
    connection.data_received(HEAD)
    server.loop.advance(2.0 * HEAD_S)
    assert not transport.aborted


def test_more_connections_than_are_allowed_are_closed_at_once() -> None:
    server = _Server()
    transports = [server.connect()[1] for _ in range(MOST_CONNECTIONS + 1)]
    assert [transport.aborted for transport in transports] == [False] * MOST_CONNECTIONS + [True]


def test_one_address_beyond_loopback_cannot_take_all_connections() -> None:
    server = _Server()
    transports = [server.connect("192.168.1.66")[1] for _ in range(MOST_OF_ONE + 1)]
    assert [transport.aborted for transport in transports] == [False] * MOST_OF_ONE + [True]
    assert not server.connect("192.168.1.67")[1].aborted
