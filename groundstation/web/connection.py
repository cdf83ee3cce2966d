"""HTTP connections that are bounded in number and in time, and that tell the application the peer's certificate."""

from __future__ import annotations

import asyncio
import ipaddress
from typing import Any

import h11
import orjson
from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_CONNECTIONS = 256
"""Greatest number of connections at a time: a browser opens six, and one for the stream."""
MOST_OF_ONE = 64
"""Greatest number of connections of one address beyond loopback."""
HEAD_S = 10.0
"""Time within which the head of a request must have come."""
MOST_HEAD_BYTES = 16_384


class BoundedConnection(H11Protocol):
    """uvicorn's connection, closed if there are too many, or if no whole head comes in time."""

    _head_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, or close it."""
        super().connection_made(transport)
        if len(self.connections) > MOST_CONNECTIONS or self._has_enough():
            transport.abort()
            return
        self.app_state = {**self.app_state, "peer_certificate": transport.get_extra_info("peercert")}
        self._await_head()

    def _has_enough(self) -> bool:
        """Return whether the address of this connection has more than it may; programs of this computer share one."""
        if self.client is None or ipaddress.ip_address(self.client[0].partition("%")[0]).is_loopback:
            return False
        addresses = [(getattr(connection, "client", None) or ("",))[0] for connection in self.connections]
        return addresses.count(self.client[0]) > MOST_OF_ONE

    def data_received(self, data: bytes) -> None:
        """Take bytes in."""
        super().data_received(data)
        if self.conn.their_state is h11.IDLE:
            # uvicorn ended its own wait for the next request with the first byte of it.
            self._await_head()
        else:
            self._stop_waiting()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget a connection."""
        self._stop_waiting()
        super().connection_lost(exc)

    def send_400_response(self, msg: str) -> None:
        """Answer what is no HTTP."""
        body = orjson.dumps({"detail": msg})
        headers = [
            (b"content-type", b"application/json"),
            (b"content-length", str(len(body)).encode()),
            (b"connection", b"close"),
        ]
        for event in (h11.Response(status_code=400, headers=headers, reason=b"Bad Request"), h11.Data(data=body)):
            self.transport.write(self.conn.send(event) or b"")
        self.transport.close()

    def _await_head(self) -> None:
        """Close the connection unless a whole head comes in time, counted from its beginning."""
        if self._head_timer is None:
            self._head_timer = self.loop.call_later(HEAD_S, self.transport.abort)

    def _stop_waiting(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None


def settings() -> dict[str, Any]:
    """Return the settings of uvicorn that belong to such connections."""
    return {
        "http": BoundedConnection,
        "h11_max_incomplete_event_size": MOST_HEAD_BYTES,
        "timeout_keep_alive": 15,
        "ws_max_size": 4_096,
        "ws_per_message_deflate": False,
        "ws_ping_interval": 20.0,
        "ws_ping_timeout": 20.0,
        "access_log": False,
        "proxy_headers": False,
        "server_header": False,
        "log_config": None,
    }
