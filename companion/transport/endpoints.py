"""MAVLink connection strings and the end points behind them (docs/links.md).

There are three kinds: the vehicle only receives the broadcast (a receiver has no way to write), the ground only sends
it (no reply changes a sender's destination), and only the autopilot link is two-way.
"""

from __future__ import annotations

from companion.errors import InputError
from companion.transport.file import open_file_receiver, open_file_sender
from companion.transport.link import (
    ALLOWED,
    DUPLEX,
    FORMS,
    RECEIVING,
    SCHEMES,
    SENDING,
    Address,
    Link,
    OnChunk,
    OnDatagram,
    RadioReading,
    ReceiveCounts,
    Receiver,
    SendCounts,
    Sender,
    parse_link,
)
from companion.transport.serial import SerialDuplex, open_serial_duplex, open_serial_receiver, open_serial_sender
from companion.transport.tcp import TcpDuplex, open_tcp_duplex
from companion.transport.udp import (
    RECEIVE_BUFFER_BYTES,
    UdpDuplex,
    UdpSender,
    open_udp_duplex,
    open_udp_receiver,
    open_udp_sender,
)

__all__ = [
    "ALLOWED",
    "DUPLEX",
    "FORMS",
    "RECEIVE_BUFFER_BYTES",
    "RECEIVING",
    "SCHEMES",
    "SENDING",
    "Address",
    "Duplex",
    "Link",
    "OnChunk",
    "OnDatagram",
    "ReceiveCounts",
    "Receiver",
    "SendCounts",
    "Sender",
    "UdpSender",
    "open_duplex",
    "open_receiver",
    "open_sender",
    "parse_link",
]

Duplex = UdpDuplex | TcpDuplex | SerialDuplex
"""A two-way end point, for an autopilot link."""


async def open_receiver(
    link: Link,
    on_datagram: OnDatagram,
    *,
    receive_buffer_bytes: int = RECEIVE_BUFFER_BYTES,
    most_share: float = 0.5,
) -> Receiver:
    """Listen on a link; `on_datagram` is called on the event loop with each datagram, or each chunk of a stream.

    Reading from a network, what `on_datagram` does included, takes at most `most_share` of the time, below 1.
    Raises InputError if the link only sends or cannot be opened.
    """
    if link.scheme not in RECEIVING:
        raise InputError(f"link '{link}': this end only listens; allowed: {_forms(RECEIVING)}")
    if link.scheme == "serial":
        return await open_serial_receiver(link, on_datagram)
    if link.scheme == "file":
        return await open_file_receiver(link, on_datagram)
    return await open_udp_receiver(link, on_datagram, receive_buffer_bytes, most_share)


async def open_sender(link: Link, radio: RadioReading | None = None) -> Sender:
    """Open a link to send on; raises InputError if it only listens or cannot be opened.

    `radio` makes the reader of a serial radio's own reports, for `Sender.txbuf_percent`.
    """
    if link.scheme not in SENDING:
        raise InputError(f"link '{link}': this end only sends; allowed: {_forms(SENDING)}")
    if link.scheme == "serial":
        return await open_serial_sender(link, radio)
    if link.scheme == "file":
        return await open_file_sender(link)
    return await open_udp_sender(link)


async def open_duplex(link: Link, on_chunk: OnChunk, *, receive_buffer_bytes: int = RECEIVE_BUFFER_BYTES) -> Duplex:
    """Open an autopilot link: `udpin` sends to the peer that is bound, `udpout` exchanges with one fixed peer only.

    `on_chunk` is called on the event loop with what came, which may be cut anywhere. Raises InputError if the link goes
    one way only, its host is unknown, or its port or device cannot be used.
    """
    if link.scheme not in DUPLEX or link.others:
        allowed = "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, serial:DEVICE:BAUD"
        raise InputError(f"link '{link}': this end goes both ways; allowed: {allowed}")
    if link.scheme == "tcp":
        return await open_tcp_duplex(link, on_chunk)
    if link.scheme == "serial":
        return await open_serial_duplex(link, on_chunk)
    return await open_udp_duplex(link, on_chunk, receive_buffer_bytes)


def _forms(schemes: tuple[str, ...]) -> str:
    return ", ".join(FORMS[scheme] for scheme in schemes)
