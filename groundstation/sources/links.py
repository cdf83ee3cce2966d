"""The links and files of live sources: opened, heard, and opened again, without ever holding up the event loop.

No fault of a source stops the ground station: it becomes the source's health, and the link is tried again after ever
longer waits. Nothing is ever sent but, where a server must be told where to send to, a heartbeat.
"""

from __future__ import annotations

import asyncio
import os
import socket
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress

from pymavlink.dialects.v20 import common

from companion.errors import InputError, one_line
from companion.protocol.codec import GROUND_SYSTEM
from companion.transport.endpoints import open_duplex, open_receiver, parse_link
from companion.transport.link import Address
from companion.transport.tcp import CONNECT_TIMEOUT_S
from groundstation.sources.feed import Feed
from groundstation.sources.playback import Due, open_recording, replayed, sightings_in

AGAIN_FIRST_S = 0.5
"""Wait after which a link is first tried again; each further wait is twice the one before."""
AGAIN_MOST_S = 15.0
"""Greatest wait before a link is tried again."""
READ_BYTES = 8_192
"""Bytes of a stream that are parsed at once: a hundred lines, some milliseconds."""
SHARE = 0.1
"""Greatest share of the time that one source's parsing takes."""
REST_S = 0.005
"""Least rest after a piece of a stream."""
HEARTBEAT_S = 1.0
_AHEAD_S = 0.02
"""Time by which what is due is played early, rather than waiting for a timer."""


async def run_source(feed: Feed, now_s: Callable[[], float]) -> None:
    """Hear a source until the task is cancelled; its link or file is opened again whenever it ends."""
    wait_s = AGAIN_FIRST_S
    while True:
        heard = feed.pulse.heard
        try:
            if feed.spec.file is not None:
                await _play(feed, now_s)
                return
            await _hear(feed, now_s)
        except (OSError, InputError, TimeoutError, EOFError, zlib.error) as error:
            feed.link.fault = _words(error)
        if feed.pulse.heard > heard:
            if feed.spec.file is not None:
                # A recording that is damaged is not played from its beginning again and again.
                return
            wait_s = AGAIN_FIRST_S
        await asyncio.sleep(wait_s)
        wait_s = min(2.0 * wait_s, AGAIN_MOST_S)


async def _hear(feed: Feed, now_s: Callable[[], float]) -> None:
    """Hear a link until it ends; a datagram link never does."""
    assert feed.spec.url is not None
    link = parse_link(feed.spec.url)
    if link.scheme == "tcp":
        await _hear_stream(feed, link.host, link.port, now_s)
        return

    def take(data: bytes, peer: Address | None = None) -> None:
        feed.hear(data, now_s(), peer)

    if link.scheme == "udpout":
        end = await open_duplex(link, take)
        feed.link.fault, feed.link.note = None, str(link)
        try:
            while True:
                # The server learns from it where to send to.
                end.send(_heartbeat())
                await asyncio.sleep(HEARTBEAT_S)
        finally:
            end.close()
    receiver = await open_receiver(link, take, most_share=SHARE)
    feed.link.fault, feed.link.note = None, str(link)
    try:
        await asyncio.Event().wait()
    finally:
        receiver.close()


async def _hear_stream(feed: Feed, host: str, port: int, now_s: Callable[[], float]) -> None:
    """Read a TCP server's bytes until it ends the connection."""
    async with asyncio.timeout(CONNECT_TIMEOUT_S):
        reader, writer = await asyncio.open_connection(host, port, limit=READ_BYTES)
    feed.link.fault, feed.link.note = None, f"tcp:{host}:{port}"
    try:
        while data := await reader.read(READ_BYTES):
            began_s = time.monotonic()
            feed.hear(data, now_s(), port)
            # What comes faster than that waits in the kernel, and then at the server.
            await asyncio.sleep(max(REST_S, (time.monotonic() - began_s) * (1.0 / SHARE - 1.0)))
    finally:
        writer.transport.abort()
    raise ConnectionError("the server ended the connection")


async def _play(feed: Feed, now_s: Callable[[], float]) -> None:
    """Play a recording to its end."""
    spec = feed.spec
    assert spec.file is not None
    file = await asyncio.to_thread(open_recording, spec.file)
    feed.link.fault, feed.link.note = None, spec.file
    try:
        blocks = sightings_in(file, spec.kind, feed.parse)
        began: tuple[float, float] | None = None
        while (block := await asyncio.to_thread(_next, blocks)) is not None:
            for due in block:
                began = began or (now_s(), due.at_s)
                speed = spec.play_speed or 1.0
                at_s = due.at_s if spec.play_speed is None else began[0] + (due.at_s - began[1]) / speed
                while (left_s := at_s - now_s()) > _AHEAD_S:
                    await asyncio.sleep(left_s)
                feed.offer([replayed(due, at_s - due.at_s, speed)], now_s())
            await asyncio.sleep(0.0)
    finally:
        with suppress(OSError):
            file.close()
    feed.link.note = f"{spec.file}: played to its end"


def _next(blocks: Iterator[list[Due]]) -> list[Due] | None:
    return next(blocks, None)


def _heartbeat() -> bytes:
    heartbeat = common.MAVLink_heartbeat_message(
        common.MAV_TYPE_GCS, common.MAV_AUTOPILOT_INVALID, 0, 0, common.MAV_STATE_ACTIVE, 3
    )
    return bytes(heartbeat.pack(common.MAVLink(None, srcSystem=GROUND_SYSTEM)))


def _words(error: Exception) -> str:
    # asyncio's own words are "Connect call failed"; gaierror's number is none of the system's.
    number = error.errno if isinstance(error, OSError) and not isinstance(error, socket.gaierror) else None
    text = str(error) if number is None else os.strerror(number)
    return one_line(text or type(error).__name__)[:200]
