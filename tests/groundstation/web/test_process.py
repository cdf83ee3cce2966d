"""The web process itself: started, asked over real sockets, killed, started again, ended with the ground station."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator

import httpx
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from groundstation.web.address import Address, bound, listen
from groundstation.web.bridge import Bridge
from groundstation.web.hub import MOST_BROWSERS
from groundstation.web.site import Site

PATIENCE_S = 60.0
"""Longest wait for the process, which yields to everything else on the computer."""


class _Station:
    """A ground station that publishes pictures, and obeys every command but a pause."""

    def __init__(self) -> None:
        listener = listen(Address("127.0.0.1", 0))
        self.address = bound(listener)
        self.bridge = Bridge(Site(self.address), listener)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        number = 0
        while not self._stopped.wait(0.02):
            self.bridge.publish({"type": "picture", "t_s": time.time(), "event": number, "sources": []})
            for request in self.bridge.pump():
                if request.command["do"] == "pause":
                    self.bridge.refuse(request.id, "not today")
                    continue
                number += 1
                event = {"number": number, "event": request.command["do"], "who": {"name": request.who.name}}
                self.bridge.publish({"type": "event", "event": event})
                self.bridge.reply(request.id, event)

    @property
    def url(self) -> str:
        return f"http://{self.address}"

    @property
    def pid(self) -> int:
        child = self.bridge._child
        assert child is not None
        return int(child.pid)  # type: ignore[attr-defined]

    def wait(self) -> None:
        """Wait until the page answers."""
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            with contextlib.suppress(httpx.HTTPError):
                if httpx.get(f"{self.url}/api/v1/picture", timeout=PATIENCE_S).status_code == 200:
                    return
            time.sleep(0.05)
        raise AssertionError("the page does not answer")

    def close(self) -> None:
        self._stopped.set()
        self._thread.join()
        self.bridge.close()


@pytest.fixture(scope="module")
def station() -> Iterator[_Station]:
    one = _Station()
    one.wait()
    yield one
    one.close()


def _answer(station: _Station, request: bytes) -> bytes:
    """Return the answer to raw bytes; none if the connection was closed before it."""
    answer = b""
    with socket.create_connection(station.address, PATIENCE_S) as stream, contextlib.suppress(OSError):
        stream.sendall(request)
        while b'"}' not in answer and (data := stream.recv(65_536)):
            answer += data
    return answer


def _why(answer: bytes) -> str:
    detail = json.loads(answer.partition(b"\r\n\r\n")[2])["detail"]
    assert isinstance(detail, str)
    return detail


@pytest.mark.slow
def test_commands_are_answered_and_the_stream_shows_pictures_and_events(station: _Station) -> None:
    with connect(f"ws://{station.address}/api/v1/stream") as stream:
        assert json.loads(stream.recv())["type"] == "picture"
        answer = httpx.post(f"{station.url}/api/v1/commands", json={"do": "resume"}, timeout=PATIENCE_S)
        assert answer.json()["event"] == "resume"
        while (message := json.loads(stream.recv()))["type"] != "event":
            pass
        assert message["event"]["number"] == answer.json()["number"]
    refused = httpx.post(f"{station.url}/api/v1/commands", json={"do": "pause"}, timeout=PATIENCE_S)
    assert (refused.status_code, refused.json()) == (409, {"detail": "not today"})


@pytest.mark.slow
@pytest.mark.parametrize("origin", ["http://evil.example", "null"])
def test_a_stream_for_another_sites_page_is_refused_with_the_reason(station: _Station, origin: str) -> None:
    with (
        pytest.raises(InvalidStatus) as caught,
        connect(f"ws://{station.address}/api/v1/stream", origin=Origin(origin)),
    ):
        pass
    assert caught.value.response.status_code == 403
    assert b"Origin" in caught.value.response.body


@pytest.mark.slow
def test_more_streams_than_are_allowed_are_refused_and_those_that_nobody_reads_hold_up_nobody(
    station: _Station,
) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(MOST_BROWSERS):
            stack.enter_context(connect(f"ws://{station.address}/api/v1/stream", close_timeout=0.01))
        with pytest.raises(InvalidStatus) as caught, connect(f"ws://{station.address}/api/v1/stream"):
            pass
        assert caught.value.response.status_code == 503
        assert b"streams are open" in caught.value.response.body
        assert httpx.get(f"{station.url}/api/v1/session", timeout=PATIENCE_S).status_code == 200


@pytest.mark.slow
def test_a_stream_takes_no_long_messages(station: _Station) -> None:
    with connect(f"ws://{station.address}/api/v1/stream") as stream, pytest.raises(ConnectionClosed):
        stream.send("x" * 100_000)
        while True:
            stream.recv()


@pytest.mark.slow
def test_whatever_bytes_come_the_refusal_says_why_and_the_process_goes_on(station: _Station) -> None:
    head = b"POST /api/v1/commands HTTP/1.1\r\nHost: %s\r\nContent-Type: application/json\r\n" % str(
        station.address
    ).encode("ascii")
    pid = station.pid
    assert "at most" in _why(_answer(station, head + b"Content-Length: 10000000000\r\n\r\n"))
    flood = head + b"Transfer-Encoding: chunked\r\n\r\n" + b"4000\r\n" + b"a" * 16_384 + b"\r\n"
    assert "at most" in _why(_answer(station, flood + (b"4000\r\n" + b"a" * 16_384 + b"\r\n") * 5))
    for junk in (b"\0" * 1_000, b"\x16\x03\x01\x02\0\x01\0", b"GET /" + b"a" * 100_000 + b" HTTP/1.1\r\n\r\n"):
        answer = _answer(station, junk)
        assert not answer or b" 400 " in answer.partition(b"\r\n")[0]
    for path in (b"/page/../../api.py", b"/page/%2e%2e/api.py", b"/page//etc/passwd", b"/page/%00", b"/leaflet/..%5cx"):
        answer = _answer(station, b"GET " + path + b" HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        assert b" 404 " in answer.partition(b"\r\n")[0], path
    assert station.pid == pid


@pytest.mark.slow
def test_a_killed_process_is_started_again_and_shows_everything_that_was(station: _Station) -> None:
    before = httpx.post(f"{station.url}/api/v1/commands", json={"do": "resume"}, timeout=PATIENCE_S).json()
    pid = station.pid
    os.kill(pid, signal.SIGKILL)
    while station.bridge._child is None or station.pid == pid:
        time.sleep(0.05)
    station.wait()
    assert before in httpx.get(f"{station.url}/api/v1/events", timeout=PATIENCE_S).json()


@pytest.mark.slow
def test_the_process_ends_with_the_ground_station(station: _Station) -> None:
    pid = station.pid
    station.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
