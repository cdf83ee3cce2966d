"""The stream of messages to a browser or program: a WebSocket on which the newest picture comes first."""

from __future__ import annotations

import asyncio

from fastapi import APIRouter
from starlette.responses import JSONResponse
from starlette.websockets import WebSocket

from groundstation.web.api import Api
from groundstation.web.feed import Refused
from groundstation.web.guards import TOO_BUSY
from groundstation.web.hub import Browser

SEND_S = 20.0
"""Time within which a browser must take a message."""


def stream_router(api: Api) -> APIRouter:
    """Return the route of the stream."""
    router = APIRouter(prefix="/api/v1")

    @router.websocket("/stream")
    async def stream(socket: WebSocket) -> None:
        try:
            await api.who(socket)
            with api.hub.shown() as browser:
                await socket.accept()
                await _show(socket, browser)
        except Refused as refused:
            await socket.send_denial_response(JSONResponse({"detail": str(refused)}, refused.status))

    return router


async def _show(socket: WebSocket, browser: Browser) -> None:
    """Send what there is until either side ends."""
    tasks = [asyncio.create_task(_send(socket, browser)), asyncio.create_task(_until_gone(socket))]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _send(socket: WebSocket, browser: Browser) -> None:
    while not browser.is_too_slow:
        for text in await browser.taken():
            async with asyncio.timeout(SEND_S):
                await socket.send_text(text)
    await socket.close(TOO_BUSY, "too slow; connect again, and ask for the events that are missing")


async def _until_gone(socket: WebSocket) -> None:
    """Wait until the other side has closed; what it sends means nothing."""
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass
