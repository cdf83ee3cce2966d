"""Connection strings, and the base of all end points: a receiver cannot write, no reply changes a sender's destination.

A lost datagram is normal here; no fault of a network, a cable or a disk may raise into the guidance loop.
"""

from __future__ import annotations

import ipaddress
import re
import termios
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

from companion.errors import InputError, nearest_hint

OnDatagram = Callable[[bytes], None]
"""Callback that takes each received datagram, or each chunk of a stream."""
OnChunk = Callable[[bytes, "Address | None"], None]
"""Callback that takes what a two-way end received, cut anywhere, and the sender's address where there are several."""
RadioReading = Callable[[], Callable[[bytes], int | None]]
"""Makes a reader of a radio's own reports. The reader takes each chunk received from the radio and returns the free
share of its transmit buffer in percent, None without a new report."""
Address = tuple[str, int]
"""Host and port."""

FORMS = {
    "udpin": "udpin:HOST:PORT",
    "udpout": "udpout:HOST:PORT[,HOST:PORT...]",
    "udpbcast": "udpbcast:HOST:PORT",
    "mcast": "mcast:GROUP:PORT[@INTERFACE]",
    "serial": "serial:DEVICE:BAUD",
    "file": "file:PATH.tlog",
    "tcp": "tcp:HOST:PORT",
}
"""Form of the connection string of each scheme."""
SCHEMES = tuple(FORMS)
RECEIVING = tuple(scheme for scheme in SCHEMES if scheme not in ("udpout", "tcp"))
SENDING = tuple(scheme for scheme in SCHEMES if scheme not in ("udpin", "tcp"))
DUPLEX = ("udpin", "udpout", "tcp", "serial")
ALLOWED = ", ".join(FORMS.values())

BAUD_RATES = tuple(
    sorted(int(name[1:]) for name in dir(termios) if re.fullmatch(r"B[1-9][0-9]*", name) and int(name[1:]) >= 1200)
)
"""Baud rates, in bit/s, that the operating system's serial drivers know by name; no radio is slower than 1200."""
DATA_BITS_SHARE = 0.1
"""Bytes per second at one bit per second: eight data bits are sent with a start and a stop bit."""

_HOST = re.compile(r"[A-Za-z0-9._-]+")
_PORT_MAX = 65535
_SERIAL_AS_PYMAVLINK = re.compile(r"(/[^,]*),([^,]*)")
"""pymavlink's form of a serial link, /DEVICE,BAUD."""
_LOG_SUFFIX = ".tlog"


@dataclass(frozen=True, slots=True)
class Link:
    """A parsed connection string. Host and port are for the network, path and baud for a serial device or a file."""

    scheme: str
    host: str = ""
    """Host; the broadcast address of `udpbcast`, the group of `mcast`."""
    port: int = 0
    others: tuple[Address, ...] = ()
    """Further destinations of `udpout`."""
    interface: str = ""
    """Address of the network interface for `mcast`; empty leaves the choice to the routing table."""
    path: str = ""
    baud: int = 0

    @property
    def is_loopback(self) -> bool:
        """Whether it is listened on where only programs of this computer can send to."""
        return self.scheme == "udpin" and (self.host == "localhost" or self.host.startswith("127."))

    def __str__(self) -> str:
        if self.scheme == "file":
            return f"file:{self.path}"
        if self.scheme == "serial":
            return f"serial:{self.path}:{self.baud}"
        others = "".join(f",{host}:{port}" for host, port in self.others)
        interface = f"@{self.interface}" if self.interface else ""
        return f"{self.scheme}:{self.host}:{self.port}{others}{interface}"


def parse_link(text: str) -> Link:
    """Return the link that a connection string names; raises InputError saying what is allowed."""
    known = _SERIAL_AS_PYMAVLINK.fullmatch(text)
    if known is not None:
        return _serial_link(text, known[1], known[2])
    scheme, _, rest = text.partition(":")
    if scheme not in SCHEMES:
        hint = nearest_hint(scheme.lower(), SCHEMES)
        raise InputError(f"link '{text}': unknown scheme '{scheme}'; allowed: {ALLOWED}{hint}")
    if scheme == "file":
        return _file_link(text, rest)
    if scheme == "serial":
        device, _, baud_text = rest.rpartition(":")
        return _serial_link(text, device, baud_text)
    if scheme == "mcast":
        return _multicast_link(text, rest)
    addresses = [_address(text, part, FORMS[scheme]) for part in rest.split(",")]
    if len(addresses) > 1 and scheme != "udpout":
        raise InputError(f"link '{text}': {len(addresses)} addresses; allowed: {FORMS[scheme]}")
    if len(set(addresses)) < len(addresses):
        raise InputError(f"link '{text}': an address is there twice; allowed: {FORMS[scheme]}, each once")
    (host, port), *others = addresses
    return Link(scheme, host, port, tuple(others))


def _address(text: str, part: str, form: str) -> Address:
    host, _, port_text = part.rpartition(":")
    if not host:
        raise InputError(f"link '{text}': host or port missing; allowed: {form}")
    if not _HOST.fullmatch(host):
        raise InputError(f"link '{text}': '{host}' is no host name or IPv4 address; allowed: {form}")
    if not (port_text.isascii() and port_text.isdigit() and 1 <= int(port_text[:6]) <= _PORT_MAX):
        raise InputError(f"link '{text}': port '{port_text}' is not a number from 1 to {_PORT_MAX}; allowed: {form}")
    return host, int(port_text)


def _multicast_link(text: str, rest: str) -> Link:
    form = FORMS["mcast"]
    destination, at, interface = rest.partition("@")
    group, port = _address(text, destination, form)
    if not _is_ipv4(group) or not ipaddress.IPv4Address(group).is_multicast:
        raise InputError(f"link '{text}': '{group}' is no group; allowed: {form} with 224.0.0.0 to 239.255.255.255")
    if at and not _is_ipv4(interface):
        raise InputError(f"link '{text}': interface '{interface}' is no IPv4 address of this computer; allowed: {form}")
    return Link("mcast", group, port, interface=interface)


def _serial_link(text: str, device: str, baud_text: str) -> Link:
    form = f"{FORMS['serial']} or /DEVICE,BAUD"
    if not device.startswith("/") or "\0" in device:
        raise InputError(f"link '{text}': '{device}' is no device's full path; allowed: {form}")
    if baud_text not in map(str, BAUD_RATES):
        rates = ", ".join(map(str, BAUD_RATES))
        raise InputError(f"link '{text}': baud rate '{baud_text}'; allowed: {form} with a rate of {rates}")
    return Link("serial", path=device, baud=int(baud_text))


def _file_link(text: str, path: str) -> Link:
    if not path.endswith(_LOG_SUFFIX) or "\0" in path:
        raise InputError(f"link '{text}': '{path}' is no telemetry log's name; allowed: {FORMS['file']}")
    return Link("file", path=path)


def _is_ipv4(text: str) -> bool:
    try:
        ipaddress.IPv4Address(text)
    except ValueError:
        return False
    return True


@dataclass(slots=True)
class SendCounts:
    """Outcomes of the datagrams given to an end point; each destination of a datagram counts."""

    sent: int = 0
    refused: int = 0
    """Datagrams for which the destination's host reported that no program listens (ECONNREFUSED)."""
    full: int = 0
    """Datagrams dropped at a full buffer (EWOULDBLOCK), because a late one is worth less than the next one."""
    no_peer: int = 0
    """Datagrams dropped before any peer was bound."""
    failed: int = 0
    """Any other error, such as no route, an unplugged radio or a full disk."""
    reopened: int = 0
    """Number of times that a serial device or a TCP connection came back."""


@dataclass(slots=True)
class ReceiveCounts:
    """Counts of a receiver's inputs and errors."""

    chunks: int = 0
    """Datagrams, or chunks of a stream as they were read."""
    failed: int = 0
    """Errors while reading, such as an unplugged radio or a damaged log."""
    reopened: int = 0
    """Number of times that a serial device, or the network interface of a multicast group, came back."""


class Receiver:
    """A receive-only end point. It has no way to send: the broadcast must never be answered."""

    def __init__(
        self,
        close: Callable[[], None],
        counts: ReceiveCounts,
        *,
        is_stream: bool = False,
        overruns: Callable[[], int] = lambda: 0,
    ) -> None:
        self._close = close
        self.counts = counts
        self.is_stream = is_stream
        """Whether the input is handed on as chunks of a byte stream, cut anywhere, instead of as whole datagrams."""
        self.overruns = overruns
        """Returns how many datagrams the kernel dropped because its buffer for this end point was full."""

    def close(self) -> None:
        """Stop receiving and free the port."""
        self._close()


class Sender(ABC):
    """An end point that sends to fixed destinations, which no reply can change.

    The exception is an autopilot link by `udpin`, which sends to the peer that its owner binds.
    """

    def __init__(self) -> None:
        self.counts = SendCounts()

    @property
    def txbuf_percent(self) -> int | None:
        """Free share of the radio's transmit buffer as the radio reports it; None where nothing reports it."""
        return None

    def bind(self, peer: Address) -> None:  # noqa: B027 - most ends have one peer for good
        """Send to this peer from now on, where the end leaves that to its owner (an autopilot link by `udpin`)."""

    def overruns(self) -> int:
        """Return how many received datagrams the kernel dropped as its buffer was full; 0 where it does not tell."""
        return 0

    @abstractmethod
    def send(self, datagram: bytes) -> None:
        """Send one datagram; a failure is counted, never raised."""

    @abstractmethod
    def close(self) -> None:
        """Release the socket, device or file; later sends count as failed."""
