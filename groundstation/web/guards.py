"""What every request must pass before it is looked at: its host, its origin, its size, how often; as ASGI middleware.

The Host header must be the site's own name, so that no other site's name can be made to lead here (DNS rebinding); what
changes something or opens a stream must come from this site's own page or from no page at all (CSRF), also on the
loopback address, which every page in a browser of this computer can reach.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

import orjson
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from groundstation.web.limits import Limits

MOST_BODY_BYTES = 65_536
"""Greatest length of a request's body."""
BODY_S = 10.0
"""Time within which a body must have come."""
SAFE = ("GET", "HEAD", "OPTIONS")
SESSION_PATH = "/api/v1/session"
TOO_BUSY = 1013
"""Close code of a WebSocket that is to be tried again later."""
_SECURITY = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
        "font-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
}
_HSTS = ("strict-transport-security", "max-age=31536000")


class Refusal(NamedTuple):
    """Why a request is not looked at."""

    status: int
    why: str
    retry_after_s: float = 0.0


def headers_of(scope: Scope) -> dict[str, str]:
    """Return a request's headers by their names in small letters; of several with one name the last."""
    return {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}


def host_of(header: str) -> str:
    """Return the host in a Host header or an origin's authority, without port, in small letters."""
    host = header.strip().lower()
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.rpartition(":")[0] if host.count(":") == 1 else host


def cross_site(headers: Mapping[str, str], scheme: str) -> str | None:
    """Return why a request comes from another site's page; None if it does not."""
    fetched = headers.get("sec-fetch-site", "none")
    if fetched not in ("none", "same-origin"):
        return f"Sec-Fetch-Site: {fetched[:20]}; allowed: this site's own page, or a program"
    origin = headers.get("origin")
    if origin is not None and origin.lower() != f"{scheme}://{headers.get('host', '').lower()}":
        return "Origin: another site; allowed: this site's own page, or a program that sends none"
    return None


class Guards:
    """Refuses requests by host, origin, size and rate, and gives every answer the headers that guard the page."""

    def __init__(
        self, app: ASGIApp, hosts: Collection[str], is_tls: bool, answered: Callable[[int], object] = lambda _: None
    ) -> None:
        """Guard an application that is asked for by `hosts`; `answered` is called with the status of each answer."""
        self._app = app
        self._answered = answered
        self._hosts = frozenset(host.lower() for host in hosts)
        self._headers = [(name.encode(), value.encode()) for name, value in _SECURITY.items()]
        if is_tls:
            self._headers.append((_HSTS[0].encode(), _HSTS[1].encode()))
        self.limits = Limits()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        refusal = self._refusal(scope, headers_of(scope), time.monotonic())
        if scope["type"] == "websocket":
            await self._stream(refusal, scope, receive, send)
            return
        guarded = self._guarded(send)
        if refusal is None and scope["method"] not in SAFE:
            refusal, receive = await _whole_body(receive)
        if refusal is None:
            await self._app(scope, receive, guarded)
        else:
            await _answer(refusal, guarded)

    async def _stream(self, refusal: Refusal | None, scope: Scope, receive: Receive, send: Send) -> None:
        if refusal is None:
            await self._app(scope, receive, send)
            return
        await receive()
        await _answer(refusal, send, "websocket.http")

    def _refusal(self, scope: Scope, headers: Mapping[str, str], now_s: float) -> Refusal | None:
        """Return why a request is refused by its head; None if it is not."""
        if [name for name, _ in scope["headers"]].count(b"host") != 1 or host_of(headers["host"]) not in self._hosts:
            return Refusal(421, "Host: not this site; allowed: the name or address that the ground station was given")
        is_stream = scope["type"] == "websocket"
        scheme = "https" if scope["scheme"] in ("https", "wss") else "http"
        changes = not is_stream and scope["method"] not in SAFE
        if changes or is_stream:
            why = cross_site(headers, scheme)
            if why is not None:
                return Refusal(403, why)
        asker = scope["client"][0] if scope.get("client") else "?"
        limit = self.limits.changes if changes else self.limits.reads
        if changes and scope["path"] == SESSION_PATH and scope["method"] == "POST":
            limit = self.limits.logins
        wait_s = limit.wait_s(asker, now_s)
        if wait_s > 0.0:
            return Refusal(429, f"too many requests; allowed: the next one in {wait_s:.1f} s", wait_s)
        return _body_refusal(headers) if changes else None

    def _guarded(self, send: Send) -> Send:
        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                given = [(name.lower(), value) for name, value in message.get("headers", ())]
                present = {name for name, _ in given}
                self._answered(message["status"])
                message["headers"] = [*given, *(pair for pair in self._headers if pair[0] not in present)]
            await send(message)

        return guarded


def _body_refusal(headers: Mapping[str, str]) -> Refusal | None:
    length = headers.get("content-length", "0")
    if not length.isdigit() or int(length) > MOST_BODY_BYTES:
        return Refusal(413, f"a body of {length[:20]} bytes; allowed: at most {MOST_BODY_BYTES}")
    kind = headers.get("content-type", "").partition(";")[0].strip().lower()
    has_body = length != "0" or "transfer-encoding" in headers
    if kind != "application/json" and (has_body or kind):
        return Refusal(415, f"Content-Type: '{kind[:60]}'; allowed: application/json")
    return None


async def _whole_body(receive: Receive) -> tuple[Refusal | None, Receive]:
    """Return the body as one message to receive, or why it is refused."""
    body, more = b"", True
    try:
        async with asyncio.timeout(BODY_S):
            while more:
                message = await receive()
                if message["type"] == "http.disconnect":
                    return None, _then(message, receive)
                body += message.get("body", b"")
                more = message.get("more_body", False)
                if len(body) > MOST_BODY_BYTES:
                    why = f"a body of more than {MOST_BODY_BYTES} bytes; allowed: at most that"
                    return Refusal(413, why), receive
    except TimeoutError:
        return Refusal(408, f"the body did not come within {BODY_S:g} s"), receive
    return None, _then({"type": "http.request", "body": body, "more_body": False}, receive)


def _then(first: Message, receive: Receive) -> Receive:
    """Return a `receive` that hands out a message, and then what comes."""
    waiting = [first]

    async def received() -> Message:
        return waiting.pop() if waiting else await receive()

    return received


async def _answer(refusal: Refusal, send: Send, kind: str = "http") -> None:
    """Answer a refused request, or the handshake of a WebSocket (`kind` websocket.http)."""
    body = orjson.dumps({"detail": refusal.why})
    headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
    if refusal.retry_after_s > 0.0:
        headers.append((b"retry-after", str(math.ceil(refusal.retry_after_s)).encode()))
    if refusal.status in (408, 413):
        headers.append((b"connection", b"close"))
    await send({"type": f"{kind}.response.start", "status": refusal.status, "headers": headers})
    await send({"type": f"{kind}.response.body", "body": body})
