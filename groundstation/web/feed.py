"""Where the page's messages come from: a ground station over its pipe, or a recorded run that is played back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from groundstation.web.pipe import Message, Who


class Refused(Exception):
    """A request that is not obeyed; the text says why, and `status` is that of the HTTP answer."""

    def __init__(self, why: str, status: int = 409) -> None:
        super().__init__(why)
        self.status = status


class Sink(Protocol):
    """What takes in a feed's messages."""

    def message(self, message: Message) -> None:
        """Take in a picture, moves, an event, a playback state or a mission, as `type` says."""

    def frames(self, t_s: float, datagrams: Sequence[bytes]) -> None:
        """Take in unsigned frames that were broadcast at a time in seconds."""

    def forget(self) -> None:
        """Forget all frames, events and trails, as where a playback jumps."""


class Feed(Protocol):
    """A source of the page's messages, which also takes commands."""

    async def run(self, sink: Sink) -> None:
        """Hand messages to the sink until cancelled, or until there will be no more."""

    async def command(self, who: Who, command: Message) -> Message:
        """Return the event that a command became; raises Refused."""

    async def playback(self, control: Message) -> Message:
        """Obey `at_s`, `speed` and `playing` of a playback and return its state; raises Refused if it is none."""
