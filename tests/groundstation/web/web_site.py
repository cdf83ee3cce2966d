"""A site served in this process, with a feed of the test's, and clients of it."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import Any

import httpx

from groundstation.web.access import Access
from groundstation.web.api import Api
from groundstation.web.application import application
from groundstation.web.feed import Refused, Sink
from groundstation.web.hub import Hub
from groundstation.web.limits import Limits
from groundstation.web.pipe import Message, Who, packed
from groundstation.web.site import Site

URL = "http://127.0.0.1:8750"


class FakeFeed:
    """Obeys every command by making it an event, unless the test says why it is refused."""

    def __init__(self) -> None:
        self.commands: list[tuple[Who, Message]] = []
        self.refusal: Refused | None = None

    async def run(self, sink: Sink) -> None:
        """Wait for ever."""
        await asyncio.Event().wait()

    async def command(self, who: Who, command: Message) -> Message:
        """Return an event with the command in it."""
        if self.refusal is not None:
            raise self.refusal
        packed(command)  # As the pipe to the ground station takes it.
        self.commands.append((who, command))
        return {"number": len(self.commands), "event": command["do"], "who": {"name": who.name, "role": who.role}}

    async def playback(self, control: Message) -> Message:
        """Return what was asked."""
        return {"type": "playback", **control}


class Served:
    """A site in this process: its hub, its feed and its application."""

    def __init__(self, site: Site | None = None, hosts: tuple[str, ...] = ()) -> None:
        self.site = site or Site()
        self.hub = Hub()
        self.feed = FakeFeed()
        self.api = Api(self.site, self.hub, self.feed, Access(self.site, b"k" * 32))
        self.app = application(self.api, ["127.0.0.1", "localhost", *hosts])

    def reset(self) -> None:
        """Forget all that was shown and asked."""
        self.hub = self.api.hub = Hub()
        self.feed = FakeFeed()
        self.api.feed = self.feed
        self.app.limits = Limits()

    def ask(
        self,
        method: str,
        path: str,
        json: object = None,
        headers: Mapping[str, str] | Sequence[tuple[str, str]] = (),
        content: bytes | None = None,
    ) -> httpx.Response:
        """Return the answer to one request."""

        async def answer() -> httpx.Response:
            transport = httpx.ASGITransport(self.app, raise_app_exceptions=False)
            async with httpx.AsyncClient(transport=transport, base_url=URL, verify=False) as client:
                given: dict[str, Any] = {"headers": dict(headers)}
                if json is not None:
                    given["json"] = json
                if content is not None:
                    given["content"] = content
                return await client.request(method, path, **given)

        return asyncio.run(answer())


def why(answer: httpx.Response) -> str:
    """Return the reason in a refusal, which is all that is in it."""
    body = answer.json()
    assert list(body) == ["detail"]
    assert isinstance(body["detail"], str)
    assert body["detail"]
    return str(body["detail"])
