"""What the page's tests stand on: the ground station's own web server in a thread, fed by the test, and Chromium.

One browser for each module, one server for each feed. Every request that a page makes is recorded, so that one that
leaves this computer is seen.
"""

from __future__ import annotations

import asyncio
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.parse import urlsplit

from playwright.sync_api import Browser, ConsoleMessage, Page, Request, ViewportSize, sync_playwright

from groundstation.web.address import Address, bound, listen
from groundstation.web.feed import Feed, Refused, Sink
from groundstation.web.pipe import Message, Who
from groundstation.web.server import serve
from groundstation.web.site import Site

CHROMIUM = Path("/usr/bin/chromium")
NO_CHROMIUM = f"{CHROMIUM} is missing: apt-get install chromium"
ARGUMENTS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)
WIDE: ViewportSize = {"width": 1400, "height": 900}
NARROW: ViewportSize = {"width": 360, "height": 740}
_TOLD = re.compile(r"the server responded with a status of (401|409)")
"""Pattern of what Chromium complains of where the ground station refuses something: the page tells the operator."""
PATIENCE_MS = 20_000
"""Longest wait for something on the page, on a machine that does much else."""


class Stage:
    """A feed that a test plays: it shows what the test shows, and keeps what is asked."""

    def __init__(self, answer: Callable[[Message], Message] | None = None) -> None:
        self.asked: list[Message] = []
        self.controls: list[Message] = []
        self._answer = answer
        self._sink: Sink | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._early: list[Message] = []

    async def run(self, sink: Sink) -> None:
        """Wait until the test ends; `show` hands the messages over."""
        for message in self._early:
            sink.message(message)
        self._sink, self._loop = sink, asyncio.get_running_loop()
        await asyncio.Event().wait()

    def show(self, *messages: Message) -> None:
        """Show messages to all browsers."""
        for message in messages:
            if self._sink is None or self._loop is None:
                self._early.append(message)
            else:
                self._loop.call_soon_threadsafe(self._sink.message, message)

    async def command(self, _who: Who, command: Message) -> Message:
        """Keep a command, and answer as the test says."""
        self.asked.append(command)
        if self._answer is None:
            raise Refused("nothing is obeyed here; allowed: looking")
        return self._answer(command)

    async def playback(self, control: Message) -> Message:
        """Keep a control of the playback."""
        self.controls.append(control)
        return {"type": "playback", **control}


@contextmanager
def served(feed: Feed, site: Site | None = None) -> Iterator[str]:
    """Serve a feed in a thread of its own; yields the page's address."""
    listener = listen(Address("127.0.0.1", 0))
    running: list[tuple[asyncio.AbstractEventLoop, asyncio.Task[None]]] = []
    ready = threading.Event()

    async def run() -> None:
        task = asyncio.current_task()
        assert task is not None
        running.append((asyncio.get_running_loop(), task))
        ready.set()
        await serve(feed, site or Site(), listener)

    def thread() -> None:
        with suppress(asyncio.CancelledError):
            asyncio.run(run())

    server = threading.Thread(target=thread, daemon=True)
    server.start()
    ready.wait()
    try:
        yield f"http://{bound(listener)}"
    finally:
        ((loop, task),) = running
        loop.call_soon_threadsafe(task.cancel)
        server.join(10.0)
        listener.close()


@contextmanager
def chromium() -> Iterator[Browser]:
    """Start Debian's Chromium without a window."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=list(ARGUMENTS))
        try:
            yield browser
        finally:
            browser.close()


class Tab:
    """A page of the browser, with all that it asked for and all that it complained of."""

    def __init__(self, browser: Browser, url: str, size: ViewportSize = WIDE) -> None:
        self.requested: list[str] = []
        self.complaints: list[str] = []
        self.context = browser.new_context(viewport=size, color_scheme="light")
        self.page: Page = self.context.new_page()
        self.page.set_default_timeout(PATIENCE_MS)
        self.page.on("request", self._note_request)
        self.page.on("console", self._note_console)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.open(url, size)

    def open(self, url: str, size: ViewportSize = WIDE) -> None:
        """Open an address anew, with nothing noted and nothing kept from before."""
        if self.page.url != "about:blank":
            self.page.evaluate("() => localStorage.clear()")
        self.page.set_viewport_size(size)
        self.requested.clear()
        self.complaints.clear()
        self.page.goto(url)

    def _note_request(self, request: Request) -> None:
        self.requested.append(request.url)

    def _note_console(self, message: ConsoleMessage) -> None:
        if message.type in ("error", "warning") and not _TOLD.search(message.text):
            self.complaints.append(message.text)

    def hosts(self) -> set[str | None]:
        """Return the hosts that were asked for anything."""
        return {urlsplit(url).hostname for url in self.requested if not url.startswith("data:")}

    def close(self) -> None:
        """Close the page and forget what it stored."""
        self.context.close()
