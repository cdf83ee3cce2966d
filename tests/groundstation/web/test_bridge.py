"""The ground station's side of the page: nothing waits for the child, and a child that ends is started again."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import Any

import pytest

from groundstation.web.address import Address, listen
from groundstation.web.bridge import FIRST_BACK_OFF_S, NEWEST_ONLY, STUCK_S, Bridge
from groundstation.web.pipe import Request, Unpacker, Who, frames_of, packed
from groundstation.web.site import Site, site_from


class _Child:
    """A child whose end of the pipe the test holds."""

    def __init__(self, end: socket.socket) -> None:
        self.end = end.dup()
        self.end.setblocking(False)
        self.status: int | None = None

    def poll(self) -> int | None:
        return self.status

    def wait(self, timeout: float | None = None) -> int:
        self.status = 0
        return 0

    def kill(self) -> None:
        self.status = -9

    def read(self) -> list[Any]:
        """Return the messages that have come."""
        unpacker, messages = Unpacker(), []
        while True:
            try:
                messages += unpacker.feed(self.end.recv(1_000_000))
            except BlockingIOError:
                return messages


class _Desk:
    """A bridge with children and a clock of the test's."""

    def __init__(self) -> None:
        self.children: list[_Child] = []
        self.now_s = 0.0
        listener = listen(Address("127.0.0.1", 0))
        self.bridge = Bridge(Site(), listener, self._start, lambda: self.now_s)

    def _start(self, end: socket.socket, _listener: socket.socket) -> _Child:
        self.children.append(_Child(end))
        return self.children[-1]


@pytest.fixture
def desk() -> Iterator[_Desk]:
    desk = _Desk()
    yield desk
    desk.bridge.close()
    for child in desk.children:
        child.end.close()


def _types(messages: list[Any]) -> list[str]:
    return [message["type"] for message in messages]


def test_a_child_is_greeted_with_the_site_and_then_told_all_that_is_known(desk: _Desk) -> None:
    desk.bridge.publish({"type": "event", "event": {"number": 1}})
    desk.bridge.publish({"type": "picture", "t_s": 1.0})
    desk.bridge.frames(2.0, [b"one", b"two"])
    desk.bridge.pump()
    messages = desk.children[0].read()
    assert _types(messages) == ["hello", "picture", "event", "frames"]
    assert site_from(messages[0]["site"]) == Site()
    assert frames_of(messages[3]) == (2.0, [b"one", b"two"])


def test_a_slow_child_gets_the_newest_picture_and_every_event_in_order(desk: _Desk) -> None:
    filler = "x" * 10_000
    for number in range(2_000):
        desk.bridge.publish({"type": "picture", "number": number, "filler": filler})
        if number % 10 == 0:
            desk.bridge.publish({"type": "event", "event": {"number": number}})
        desk.bridge.pump()
    unpacker, messages, last = Unpacker(), [], None
    while last != 1_999:
        desk.bridge.pump()
        messages += unpacker.feed(desk.children[0].end.recv(1_000_000))
        last = next((one["number"] for one in reversed(messages) if one["type"] == "picture"), None)
    pictures = [one["number"] for one in messages if one["type"] == "picture"]
    assert len(pictures) < 200
    assert pictures == sorted(pictures)
    assert [one["event"]["number"] for one in messages if one["type"] == "event"] == list(range(0, 2_000, 10))


def test_what_the_child_asks_comes_out_with_who_asks_and_its_answer_goes_back(desk: _Desk) -> None:
    request = {"type": "request", "id": 7, "name": "anna", "role": "operator", "command": {"do": "pause"}}
    desk.children[0].end.send(packed(request))
    assert list(desk.bridge.pump()) == [Request(7, Who("anna", "operator"), {"do": "pause"})]
    desk.bridge.reply(7, {"number": 3})
    desk.bridge.refuse(8, "no such agent")
    desk.bridge.pump()
    assert desk.children[0].read()[1:] == [
        {"type": "reply", "id": 7, "event": {"number": 3}},
        {"type": "refusal", "id": 8, "detail": "no such agent"},
    ]


@pytest.mark.parametrize("sent", [b"\xff\xff\xff\xff", b"\x00\x00\x00\x02[]", b"\x00\x00\x00\x01{", b""])
def test_a_child_that_talks_nonsense_or_hangs_up_is_ended_and_started_again_later(desk: _Desk, sent: bytes) -> None:
    desk.bridge.publish({"type": "event", "event": {"number": 1}})
    desk.bridge.pump()
    child = desk.children[0]
    child.end.sendall(sent) if sent else child.end.shutdown(socket.SHUT_RDWR)
    assert list(desk.bridge.pump()) == []
    assert child.status == -9
    desk.now_s += FIRST_BACK_OFF_S / 2.0
    desk.bridge.pump()
    assert len(desk.children) == 1
    desk.now_s += FIRST_BACK_OFF_S
    desk.bridge.pump()
    desk.bridge.pump()
    assert _types(desk.children[1].read()) == ["hello", "event"]


def test_each_further_start_waits_twice_as_long(desk: _Desk) -> None:
    waits = []
    for _ in range(4):
        desk.children[-1].end.shutdown(socket.SHUT_RDWR)
        desk.bridge.pump()
        began_s, count = desk.now_s, len(desk.children)
        while len(desk.children) == count:
            desk.now_s += FIRST_BACK_OFF_S / 4.0
            desk.bridge.pump()
        waits.append((desk.now_s - began_s) / FIRST_BACK_OFF_S)
    assert waits == [1.0, 2.0, 4.0, 8.0]


def test_a_child_that_reads_nothing_any_more_is_ended(desk: _Desk) -> None:
    for _ in range(100):
        desk.bridge.publish({"type": "picture", "filler": "x" * 10_000})
        desk.bridge.pump()
    desk.now_s += STUCK_S + 1.0
    desk.bridge.pump()
    assert desk.children[0].status == -9


def test_a_start_that_the_computer_refuses_is_tried_again(desk: _Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_end: socket.socket, _listener: socket.socket) -> _Child:
        raise OSError(11, "Resource temporarily unavailable")

    desk.children[0].end.shutdown(socket.SHUT_RDWR)
    desk.bridge.pump()
    monkeypatch.setattr(desk.bridge, "_start", refused)
    desk.now_s += 1.0
    desk.bridge.pump()
    monkeypatch.undo()
    desk.now_s += 10.0
    desk.bridge.pump()
    assert len(desk.children) == 2


def test_only_types_that_the_bridge_knows_are_published(desk: _Desk) -> None:
    with pytest.raises(AssertionError):
        desk.bridge.publish({"type": "secret"})
    assert "event" not in NEWEST_ONLY


def test_what_cannot_be_packed_ends_nothing_and_whoever_asked_is_told(desk: _Desk) -> None:
    desk.bridge.publish({"type": "event", "event": {"number": 2**64}})
    desk.bridge.reply(7, {"number": 1, "name": "\ud800"})
    desk.bridge.publish({"type": "picture", "t_s": 1.0})
    desk.bridge.pump()
    messages = desk.children[0].read()
    assert _types(messages) == ["hello", "picture", "refusal"]
    assert (messages[2]["id"], messages[2]["detail"][:15]) == (7, "it was obeyed, ")
