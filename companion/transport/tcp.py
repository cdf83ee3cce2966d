"""A TCP client as autopilot link, for simulators and radio bridges that serve MAVLink over TCP.

A lost connection is made again after ever longer waits, in the background.
"""

from __future__ import annotations

import asyncio
import socket

from companion.errors import InputError
from companion.transport.link import Link, OnChunk, Sender

RECONNECT_FIRST_S = 0.25
"""Wait after which a connection is first tried again; each further wait is twice the one before."""
RECONNECT_MAX_S = 4.0
"""Greatest wait before a connection is tried again."""
CONNECT_TIMEOUT_S = 5.0
UNANSWERED_MS = 4_000
"""Time without acknowledgement of sent bytes after which a connection ends, because the other machine is gone."""
_READ_BYTES = 65_536


async def open_tcp_duplex(link: Link, on_chunk: OnChunk) -> TcpDuplex:
    """Begin to connect; raises InputError for an unknown host. A server that does not listen yet is no error."""
    loop = asyncio.get_running_loop()
    try:
        await loop.getaddrinfo(link.host, link.port, family=socket.AF_INET, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise InputError(f"link '{link}': host name '{link.host}' is unknown") from error
    return TcpDuplex(link, on_chunk)


class TcpDuplex(Sender):
    """Sends whole frames, hands on bytes as they come, and reconnects until it is closed."""

    def __init__(self, link: Link, on_chunk: OnChunk) -> None:
        """Begin to connect on the running event loop."""
        super().__init__()
        self._link = link
        self._on_chunk = on_chunk
        self._writer: asyncio.StreamWriter | None = None
        self._connected_before = False
        self._task = asyncio.get_running_loop().create_task(self._serve())

    def send(self, datagram: bytes) -> None:
        """Send one frame; drop and count it while there is no connection or an earlier frame is still unsent."""
        if self._writer is None or self._writer.is_closing():
            self.counts.failed += 1
        elif self._writer.transport.get_write_buffer_size():
            self.counts.full += 1
        else:
            self._writer.write(datagram)
            self.counts.sent += 1

    def close(self) -> None:
        """Disconnect for good; later sends count as failed."""
        self._task.cancel()
        self._disconnect()

    async def _serve(self) -> None:
        wait_s = RECONNECT_FIRST_S
        while True:
            try:
                async with asyncio.timeout(CONNECT_TIMEOUT_S):
                    reader, self._writer = await asyncio.open_connection(self._link.host, self._link.port)
                self._set_up(self._writer.get_extra_info("socket"))
                while chunk := await reader.read(_READ_BYTES):
                    wait_s = RECONNECT_FIRST_S
                    self._on_chunk(chunk, None)
            except OSError:
                self.counts.failed += 1
            self._disconnect()
            await asyncio.sleep(wait_s)
            wait_s = min(2.0 * wait_s, RECONNECT_MAX_S)

    def _set_up(self, sock: socket.socket) -> None:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNANSWERED_MS)
        self.counts.reopened += self._connected_before
        self._connected_before = True

    def _disconnect(self) -> None:
        if self._writer is not None:
            # Aborted, because bytes that are still unsent are old by now.
            self._writer.transport.abort()
            self._writer = None
