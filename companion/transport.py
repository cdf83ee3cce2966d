"""MAVLink connection strings and the datagram end points behind them.

Three kinds, because the rules of the air differ: the broadcast is only ever heard on the vehicle (a receiver has no way
to write), only ever spoken by the ground (a sender never reads, so no replier can capture it), and only the autopilot
link goes both ways. Losing a datagram is normal here; nothing the network does may raise into the guidance loop.
"""

from __future__ import annotations

import asyncio
import errno
import re
import socket
from collections.abc import Callable
from dataclasses import dataclass, field

from companion.errors import InputError, nearest_hint

OnDatagram = Callable[[bytes], None]
Address = tuple[str, int]

SCHEMES = ("udpin", "udpout")
ALLOWED = "udpin:HOST:PORT (listen) or udpout:HOST:PORT (send)"

RECEIVE_BUFFER_BYTES = 4 * 1024 * 1024
"""Asked of the kernel, which may grant less: its usual 208 KiB hold only about 166 broadcast frames (measured)."""

_HOST = re.compile(r"[A-Za-z0-9._-]+")
_PORT_MAX = 65535


@dataclass(frozen=True, slots=True)
class Link:
    """A parsed connection string."""

    scheme: str
    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.scheme}:{self.host}:{self.port}"


def parse_link(text: str) -> Link:
    """Return the link that a connection string names; raises InputError saying what is allowed."""
    scheme, _, rest = text.partition(":")
    if scheme not in SCHEMES:
        hint = nearest_hint(scheme.lower(), SCHEMES)
        raise InputError(f"link '{text}': unknown scheme '{scheme}'; allowed: {ALLOWED}{hint}")
    host, _, port_text = rest.rpartition(":")
    if not host:
        raise InputError(f"link '{text}': host or port missing; allowed: {ALLOWED}")
    if not _HOST.fullmatch(host):
        raise InputError(f"link '{text}': '{host}' is no host name or IPv4 address; allowed: {ALLOWED}")
    if not (port_text.isascii() and port_text.isdigit() and 1 <= int(port_text[:6]) <= _PORT_MAX):
        raise InputError(f"link '{text}': port '{port_text}' is not a number from 1 to {_PORT_MAX}; allowed: {ALLOWED}")
    return Link(scheme, host, int(port_text))


@dataclass(slots=True)
class SendCounts:
    """What became of the datagrams given to an end point."""

    sent: int = 0
    refused: int = 0
    """The other end's host said that nobody listens (ECONNREFUSED)."""
    full: int = 0
    """The socket's buffer was full (EWOULDBLOCK): dropped, because a late datagram is worth less than the next one."""
    no_peer: int = 0
    """Nobody to answer yet."""
    failed: int = 0
    """Any other error of the network, such as no route."""


class Receiver:
    """A receive-only end point. It has no way to send: the broadcast must never be answered."""

    def __init__(self, transport: asyncio.DatagramTransport) -> None:
        self._transport = transport

    def close(self) -> None:
        """Stop receiving and free the port."""
        self._transport.close()


class Sender:
    """A send-only end point with one fixed destination. What comes back is never read."""

    def __init__(self, sock: socket.socket, destination: Address) -> None:
        self._sock = sock
        self._destination = destination
        self.counts = SendCounts()

    def send(self, datagram: bytes) -> None:
        """Send one datagram; a failure is counted, never raised."""
        _send_counted(self._sock, datagram, self._destination, self.counts)

    def close(self) -> None:
        """Free the socket; later sends count as failed."""
        self._sock.close()


class Duplex:
    """The end point of an autopilot link: a fixed peer, or the one that was heard last."""

    def __init__(self, sock: socket.socket, transport: asyncio.DatagramTransport, protocol: _DuplexProtocol) -> None:
        self._sock = sock
        self._transport = transport
        self._protocol = protocol
        self.counts = SendCounts()

    @property
    def peer(self) -> Address | None:
        """Who gets the next datagram, if anybody is known."""
        return self._protocol.peer

    def send(self, datagram: bytes) -> None:
        """Send one datagram to the peer; a failure, or having no peer yet, is counted, never raised."""
        if self._protocol.peer is None:
            self.counts.no_peer += 1
        elif self._transport.is_closing():
            self.counts.failed += 1
        else:
            # Past the transport's own sendto, which would queue without bound behind a full socket.
            _send_counted(self._sock, datagram, self._protocol.peer, self.counts)

    def close(self) -> None:
        """Stop receiving and free the port; later sends count as failed."""
        self._transport.close()


async def open_receiver(
    link: Link, on_datagram: OnDatagram, *, receive_buffer_bytes: int = RECEIVE_BUFFER_BYTES
) -> Receiver:
    """Listen on a `udpin` link; `on_datagram` is called on the event loop with each datagram.

    Raises InputError if the link is not `udpin`, its host is unknown or its port is in use.
    """
    if link.scheme != "udpin":
        raise InputError(f"link '{link}': this end only listens; allowed: udpin:HOST:PORT")
    sock = await _bound_socket(link, receive_buffer_bytes)
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: _ReceiverProtocol(on_datagram), sock=sock
    )
    return Receiver(transport)


async def open_sender(link: Link) -> Sender:
    """Open a `udpout` link, which may name a broadcast address.

    Raises InputError if the link is not `udpout` or its host is unknown.
    """
    if link.scheme != "udpout":
        raise InputError(f"link '{link}': this end only sends; allowed: udpout:HOST:PORT")
    destination = await _resolve(link)
    sock = _new_socket()
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    return Sender(sock, destination)


async def open_duplex(
    link: Link, on_datagram: OnDatagram, *, receive_buffer_bytes: int = RECEIVE_BUFFER_BYTES
) -> Duplex:
    """Open an autopilot link: `udpin` answers the last peer heard, `udpout` talks to its fixed peer and hears only it.

    `on_datagram` is called on the event loop. Raises InputError if the host is unknown or the port is in use.
    """
    if link.scheme == "udpin":
        sock, fixed_peer = await _bound_socket(link, receive_buffer_bytes), None
    else:
        fixed_peer = await _resolve(link)
        sock = _new_socket(receive_buffer_bytes)
        sock.bind(("", 0))
    transport, protocol = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: _DuplexProtocol(on_datagram, fixed_peer), sock=sock
    )
    return Duplex(sock, transport, protocol)


@dataclass(slots=True)
class _ReceiverProtocol(asyncio.DatagramProtocol):
    on_datagram: OnDatagram

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self.on_datagram(data)

    def error_received(self, exc: Exception) -> None:
        """Drop what ICMP reports: an absent peer is no reason to stop listening."""


@dataclass(slots=True)
class _DuplexProtocol(asyncio.DatagramProtocol):
    on_datagram: OnDatagram
    fixed_peer: Address | None
    peer: Address | None = field(init=False)

    def __post_init__(self) -> None:
        self.peer = self.fixed_peer

    def datagram_received(self, data: bytes, addr: Address) -> None:
        if self.fixed_peer is None:
            self.peer = addr
        elif addr != self.fixed_peer:
            return
        self.on_datagram(data)

    def error_received(self, exc: Exception) -> None:
        """Drop what ICMP reports: an autopilot that starts later must still be heard."""


def _send_counted(sock: socket.socket, datagram: bytes, destination: Address, counts: SendCounts) -> None:
    try:
        sock.sendto(datagram, destination)
    except BlockingIOError:
        counts.full += 1
    except ConnectionRefusedError:
        counts.refused += 1
    except OSError:
        counts.failed += 1
    else:
        counts.sent += 1


def _new_socket(receive_buffer_bytes: int | None = None) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    if receive_buffer_bytes is not None:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer_bytes)
    return sock


async def _bound_socket(link: Link, receive_buffer_bytes: int) -> socket.socket:
    address = await _resolve(link)
    sock = _new_socket(receive_buffer_bytes)
    try:
        # Without SO_REUSEADDR: with it a second program would silently take over the datagrams of the first.
        sock.bind(address)
    except OSError as error:
        sock.close()
        reason = {
            errno.EADDRINUSE: f"port {link.port} is in use by another program",
            errno.EADDRNOTAVAIL: f"{link.host} is not an address of this computer",
            errno.EACCES: f"no permission to use port {link.port}",
        }.get(error.errno or 0, str(error.strerror))
        raise InputError(f"link '{link}': {reason}") from error
    return sock


async def _resolve(link: Link) -> Address:
    loop = asyncio.get_running_loop()
    try:
        found = await loop.getaddrinfo(link.host, link.port, family=socket.AF_INET, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise InputError(f"link '{link}': host name '{link.host}' is unknown") from error
    host, port = found[0][4][:2]
    return str(host), int(port)
