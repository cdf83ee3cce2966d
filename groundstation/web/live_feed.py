"""The web process's end of the pipe to the ground station."""

from __future__ import annotations

import asyncio
import socket

from companion.errors import InputError
from groundstation.web.feed import Refused, Sink
from groundstation.web.pipe import READ_BYTES, Message, Unpacker, Who, frames_of, packed

ANSWER_S = 10.0
"""Longest wait for the answer to a command: a disk that takes so long is said to be slow."""
MOST_ASKED = 100
"""Greatest number of commands that wait for their answers."""
_ENDED = "the ground station has ended"
_UNANSWERED = "the ground station does not answer; look at its events before asking again, as it may have obeyed"


class LiveFeed:
    """Messages from the ground station, and commands to it."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer
        self._unpacker = Unpacker()
        self._early: list[Message] = []
        """Messages that came with the greeting."""
        self._answers: dict[int, asyncio.Future[Message]] = {}
        self._last = 0
        self._has_ended = False

    @classmethod
    async def open(cls, end: socket.socket) -> LiveFeed:
        """Return the feed at this end of the pipe, on the running event loop."""
        end.setblocking(False)
        return cls(*await asyncio.open_connection(sock=end))

    async def greeting(self) -> Message:
        """Return the first message; raises InputError if the pipe ends before it."""
        while data := await self._reader.read(READ_BYTES):
            messages = self._unpacker.feed(data)
            if messages:
                self._early = messages[1:]
                return messages[0]
        raise InputError(_ENDED)

    async def run(self, sink: Sink) -> None:
        """Hand the ground station's messages to the sink until the pipe ends."""
        early, self._early = self._early, []
        try:
            for message in early:
                self._take(message, sink)
            while data := await self._reader.read(READ_BYTES):
                for message in self._unpacker.feed(data):
                    self._take(message, sink)
        finally:
            # Also where the pipe is reset, as by a ground station that ends with a command still unread.
            self._has_ended = True
            for answer in self._answers.values():
                if not answer.done():
                    answer.set_exception(OSError(_ENDED))

    def _take(self, message: Message, sink: Sink) -> None:
        kind = message["type"]
        if kind in ("reply", "refusal"):
            answer = self._answers.get(message["id"])
            if answer is not None and not answer.done():
                answer.set_result(message)
        elif kind == "frames":
            sink.frames(*frames_of(message))
        else:
            sink.message(message)

    async def command(self, who: Who, command: Message) -> Message:
        """Return the event that the ground station made of a command; raises Refused with its reason."""
        if len(self._answers) >= MOST_ASKED:
            raise Refused(f"{MOST_ASKED} commands wait for their answers; ask again later", 503)
        if self._has_ended:
            raise Refused(_ENDED, 503)
        self._last += 1
        identity = self._last
        answer: asyncio.Future[Message] = asyncio.get_running_loop().create_future()
        self._answers[identity] = answer
        request = {"type": "request", "id": identity, "name": who.name, "role": who.role, "command": command}
        try:
            self._writer.write(packed(request))
            async with asyncio.timeout(ANSWER_S):
                message = await answer
        except (TimeoutError, OSError, asyncio.CancelledError) as error:
            # Cancelled by a server that stops while answers are under way: whoever asks still gets one.
            raise Refused(_UNANSWERED, 503) from error
        except InputError as error:
            raise Refused(str(error), 422) from error
        finally:
            del self._answers[identity]
        if message["type"] == "refusal":
            raise Refused(str(message["detail"]))
        event: Message = message["event"]
        return event

    async def playback(self, control: Message) -> Message:
        """Raise Refused: what happens now cannot be wound back."""
        raise Refused("this is no playback; allowed: on a page of `groundstation log` or `sim replay`", 404)
