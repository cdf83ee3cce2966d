"""The ground station's side of the page: a child process that serves it, fed over a socket pair without ever waiting.

The child is shown what the ground station knows and passes on what is asked; it holds no key and sends no frame. A
child that is slow gets the newest picture only, and every event in order. One that ends is started again, later each
time; the broadcast goes on meanwhile.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Protocol

from companion.errors import InputError
from companion.runtime.console import program_logger
from groundstation.web.pipe import (
    MOST_REQUEST_BYTES,
    READ_BYTES,
    Message,
    Request,
    Unpacker,
    frames_message,
    packed,
    request_of,
)
from groundstation.web.site import Site, site_to_dict

LOGGER = program_logger("groundstation")
NEWEST_ONLY = ("mission", "picture", "moves", "playback")
"""Types of messages of which only the newest counts, in the order in which they are sent."""
MOST_EVENTS = 10_000
"""Greatest number of events that are kept for a child that starts later: a day with one every eight seconds."""
MOST_FRAME_MESSAGES = 600
"""Greatest number of messages with frames that are kept: two a second for five minutes."""
FIRST_BACK_OFF_S = 0.5
"""Wait before a child that ended is started again; it doubles each time, up to MOST_BACK_OFF_S."""
MOST_BACK_OFF_S = 30.0
STEADY_S = 60.0
"""Time after which a child counts as running well, so that the waits begin anew."""
CLOSING_S = 3.0
"""Time that a child has for saying good-bye before it is killed."""
STUCK_S = 30.0
"""Time after which a child that has read nothing of what waits for it is ended, and started again."""
_AT_ONCE = 100
"""Greatest number of events, and of messages with frames, that are packed at once."""
_SESSION_KEY_BYTES = 32
_ENDED = "it has ended"
_INHERITED = ("HOME", "LANG", "LC_ALL", "PATH", "PYTHONPATH", "TMPDIR", "TZ", "VIRTUAL_ENV")
"""Variables of the environment that the child is given; others may hold secrets."""


class Child(Protocol):
    """A started web process."""

    def poll(self) -> int | None:
        """Return the exit status, None while it runs."""

    def wait(self, timeout: float | None = None) -> int:
        """Wait until it has ended."""

    def kill(self) -> None:
        """End it at once."""


def start_child(end: socket.socket, listener: socket.socket) -> Child:
    """Start the web process, which inherits its end of the socket pair and the listening socket, and nothing else."""
    numbers = [str(end.fileno()), str(listener.fileno())]
    return subprocess.Popen(
        [sys.executable, "-m", "groundstation.web.child", *numbers],
        pass_fds=[end.fileno(), listener.fileno()],
        stdin=subprocess.DEVNULL,
        # Of its own, which Ctrl-C at the terminal does not reach: the ground station decides what ends when.
        process_group=0,
        env={name: os.environ[name] for name in _INHERITED if name in os.environ},
    )


def _sendable(message: Message) -> bytes:
    """Return a message as it is sent; one that cannot be is told, and nothing, or to whoever asked why."""
    try:
        return packed(message)
    except InputError as error:
        LOGGER.warning("page: %s; left out", error)
    if message["type"] != "reply":
        return b""
    why = "it was obeyed, but its event cannot be shown; look at the picture"
    return packed({"type": "refusal", "id": message["id"], "detail": why})


class _Outbox:
    """What waits to be sent to the child: events in order, frames, and the newest message of each other type."""

    def __init__(self) -> None:
        self._events: deque[Message] = deque(maxlen=MOST_EVENTS)
        self._frames: deque[Message] = deque(maxlen=MOST_FRAME_MESSAGES)
        self._newest: dict[str, Message] = {}
        self._ordered: deque[Message] = deque(maxlen=MOST_EVENTS)
        """Events and answers that wait."""
        self._heard: deque[Message] = deque(maxlen=MOST_FRAME_MESSAGES)
        """Frames that wait."""
        self._waiting: set[str] = set()
        """Types of the newest messages that wait."""
        self._bytes = memoryview(b"")

    def put(self, message: Message) -> None:
        """Take in a message that the ground station publishes, also for children that start later."""
        kind = message["type"]
        if kind == "event":
            self._events.append(message)
            self._ordered.append(message)
        elif kind == "frames":
            self._frames.append(message)
            self._heard.append(message)
        else:
            assert kind in NEWEST_ONLY, kind
            self._newest[kind] = message
            self._waiting.add(kind)

    def answer(self, message: Message) -> None:
        """Take in an answer to what this child asked."""
        self._ordered.append(message)

    def begin(self, hello: Message) -> None:
        """Begin anew for a child that has just started: a greeting, and then all that is known."""
        self._bytes = memoryview(packed(hello))
        self._ordered = deque(self._events, maxlen=MOST_EVENTS)
        self._heard = deque(self._frames, maxlen=MOST_FRAME_MESSAGES)
        self._waiting = set(self._newest)

    def chunk(self) -> memoryview:
        """Return the bytes that are to be sent next; none if nothing waits."""
        if not self._bytes:
            messages = [self._newest[kind] for kind in NEWEST_ONLY if kind in self._waiting]
            self._waiting.clear()
            for waiting in (self._ordered, self._heard):
                messages += [waiting.popleft() for _ in range(min(len(waiting), _AT_ONCE))]
            self._bytes = memoryview(b"".join(map(_sendable, messages)))
        return self._bytes

    def sent(self, count: int) -> None:
        """Take note that so many of these bytes were sent."""
        self._bytes = self._bytes[count:]


class Bridge:
    """Starts the web process and keeps it running, shows it what the ground station knows, and hears what it asks."""

    def __init__(
        self,
        site: Site,
        listener: socket.socket,
        start: Callable[[socket.socket, socket.socket], Child] = start_child,
        steady_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start the child; `steady_s` is the clock of its restarts."""
        session_key = secrets.token_hex(_SESSION_KEY_BYTES)
        self._hello: Message = {"type": "hello", "site": site_to_dict(site), "session_key": session_key}
        self._listener = listener
        self._start = start
        self._steady_s = steady_s
        self._outbox = _Outbox()
        self._unpacker = Unpacker(MOST_REQUEST_BYTES)
        self._child: Child | None = None
        self._end: socket.socket | None = None
        self._back_off_s = FIRST_BACK_OFF_S
        self._changed_at_s = steady_s()
        """Time at which the child was started, or has ended."""
        self._moved_at_s = steady_s()
        """Time at which the child last read something, or nothing waited for it."""
        self._begin()

    def publish(self, message: Message) -> None:
        """Show a message (its `type` is mission, picture, moves, playback or event); sent by the next `pump`."""
        self._outbox.put(message)

    def frames(self, t_s: float, datagrams: Iterable[bytes]) -> None:
        """Show unsigned frames that were broadcast at a time in seconds."""
        if shown := list(datagrams):
            self._outbox.put(frames_message(t_s, shown))

    def reply(self, identity: int, event: Message) -> None:
        """Answer a request with the event that it became."""
        self._outbox.answer({"type": "reply", "id": identity, "event": event})

    def refuse(self, identity: int, why: str) -> None:
        """Answer a request that is not obeyed."""
        self._outbox.answer({"type": "refusal", "id": identity, "detail": why})

    def pump(self) -> Sequence[Request]:
        """Send and receive what can be without waiting, start a child that has ended, and return what was asked."""
        if self._end is None:
            has_ended = self._child is None or self._child.poll() is not None
            if has_ended and self._steady_s() - self._changed_at_s >= self._back_off_s:
                self._back_off_s = min(2.0 * self._back_off_s, MOST_BACK_OFF_S)
                self._begin()
            return ()
        try:
            self._send()
            return self._received()
        except OSError:
            self._lose(_ENDED)
        except InputError as error:
            self._lose(str(error))
        return ()

    def close(self) -> None:
        """End the child: gracefully within CLOSING_S, else at once."""
        child = self._child
        if self._end is not None:
            with contextlib.suppress(OSError):
                self._send()
            self._end.close()
            self._end = None
        if child is not None:
            try:
                child.wait(CLOSING_S)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
        self._child = None
        self._listener.close()

    def _begin(self) -> None:
        """Start a child; if the computer cannot, it is tried again later."""
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        self._changed_at_s = self._steady_s()
        try:
            self._child = self._start(theirs, self._listener)
        except OSError as error:
            ours.close()
            LOGGER.warning("page: cannot be started: %s; the broadcast goes on", error.strerror)
            return
        finally:
            theirs.close()
        self._end, self._unpacker, self._moved_at_s = ours, Unpacker(MOST_REQUEST_BYTES), self._changed_at_s
        self._outbox.begin(self._hello)

    def _send(self) -> None:
        assert self._end is not None
        now_s = self._steady_s()
        while chunk := self._outbox.chunk():
            try:
                self._outbox.sent(self._end.send(chunk))
            except BlockingIOError:
                break
            self._moved_at_s = now_s
        else:
            self._moved_at_s = now_s
        if now_s - self._moved_at_s > STUCK_S:
            raise InputError(f"it has read nothing for {STUCK_S:g} s")

    def _received(self) -> list[Request]:
        assert self._end is not None
        try:
            data = self._end.recv(READ_BYTES)
        except BlockingIOError:
            return []
        if not data:
            raise InputError(_ENDED)
        asked = [request_of(message) for message in self._unpacker.feed(data)]
        return [request for request in asked if request is not None]

    def _lose(self, why: str) -> None:
        """Give up a child; the next one is started after a wait."""
        assert self._end is not None
        self._end.close()
        self._end = None
        if self._child is not None and self._child.poll() is None:
            self._child.kill()
        now_s = self._steady_s()
        if now_s - self._changed_at_s >= STEADY_S:
            self._back_off_s = FIRST_BACK_OFF_S
        self._changed_at_s = now_s
        LOGGER.warning("page: %s; started again in %g s, the broadcast goes on", why, self._back_off_s)
