"""UDP end points for one address or a list, a subnet's broadcast address, or a multicast group."""

from __future__ import annotations

import asyncio
import errno
import random
import socket
import struct
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

from companion.errors import InputError
from companion.transport.link import Address, Link, OnChunk, OnDatagram, ReceiveCounts, Receiver, SendCounts, Sender

RECEIVE_BUFFER_BYTES = 4 * 1024 * 1024
"""Receive buffer asked of the kernel, which may grant less; the default 208 KiB hold about 166 frames (measured)."""
MAX_PER_WAKE = 128
"""Greatest number of datagrams read before other tasks on the event loop get their turn."""
STRANGERS_SHARE = 1.0 / 16.0
"""Share of the time in which others than the bound peer of an autopilot link are read."""
REST_S = 0.004
"""Mean time for which a receiver rests after it has read, so that a flood wakes the program 250 times a second and not
20 000 times. The time is drawn anew each time, so that no sender's period stays in step with it."""

REJOIN_PERIOD_S = 5.0
"""Period at which a multicast group is joined again: an unplugged network interface comes back as a new one."""

_DATAGRAM_BYTES = 65_536
"""Size of the buffer for one datagram: the longest that UDP carries fits."""
_TTL = 1
"""Greatest number of hops of a multicast datagram, so that it stays in its own network."""
_IP_MULTICAST_ALL = 49
"""Socket option of linux/in.h that the standard library lacks; 0 delivers only groups that this socket has joined."""
_SO_MEMINFO = 55
"""Socket option of asm-generic/socket.h that the standard library lacks: the counts of a socket's memory."""
_MEMINFO = struct.Struct("=9I")
"""The counts of SO_MEMINFO (linux/sock_diag.h); the last are the datagrams that the kernel dropped."""
_UNUSED_PORT = 9
"""Port (discard) of an address that is only tested: nothing is sent to it."""
_ANY = "0.0.0.0"

OnFrom = Callable[[bytes, Address], None]
"""Callback that takes a datagram and its sender's address."""


async def open_udp_receiver(
    link: Link, on_datagram: OnDatagram, receive_buffer_bytes: int, most_share: float
) -> Receiver:
    """Listen on a `udpin`, `udpbcast` or `mcast` link as `open_receiver` does; raises InputError if it cannot be."""
    sock = await _listening_socket(link, receive_buffer_bytes)
    _forbid_writing(sock)
    reading = _Reading(sock, lambda datagram, _: on_datagram(datagram), most_share)
    rejoining = _Rejoining(link, sock, reading.counts) if link.scheme == "mcast" else None

    def close() -> None:
        if rejoining is not None:
            rejoining.cancel()
        reading.close()

    return Receiver(close, reading.counts, overruns=lambda: _overruns(sock))


async def open_udp_sender(link: Link) -> UdpSender:
    """Open a `udpout`, `udpbcast` or `mcast` link; raises InputError if it cannot be opened."""
    destinations = [await _resolve(link, address) for address in dict.fromkeys([(link.host, link.port), *link.others])]
    if link.scheme == "udpbcast":
        _require_broadcast(link, destinations[0][0])
    # Nothing is ever read, so no received datagram needs to be buffered.
    sock = _new_socket(receive_buffer_bytes=0)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    if link.scheme != "mcast":
        return UdpSender(sock, destinations)
    try:
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, _TTL)
        return MulticastSender(sock, destinations[0], _interface(link))
    except OSError as error:
        sock.close()
        raise InputError(f"link '{link}': {_why(link, error)}") from error


async def open_udp_duplex(link: Link, on_chunk: OnChunk, receive_buffer_bytes: int) -> UdpDuplex:
    """Open a `udpin` or a `udpout` link in both directions; raises InputError if it cannot be opened."""
    if link.scheme == "udpin":
        sock, fixed_peer = await _listening_socket(link, receive_buffer_bytes), None
    else:
        fixed_peer = await _resolve(link, (link.host, link.port))
        sock = _new_socket(receive_buffer_bytes)
        sock.bind(("", 0))
    return UdpDuplex(sock, on_chunk, fixed_peer)


class UdpSender(Sender):
    """Sends each datagram to every destination; replies are never read."""

    def __init__(self, sock: socket.socket, destinations: Sequence[Address]) -> None:
        super().__init__()
        self._sock = sock
        self._destinations = tuple(destinations)

    def send(self, datagram: bytes) -> None:
        """Send one datagram to each destination; a failure is counted, never raised."""
        for destination in self._destinations:
            _send_counted(self._sock, datagram, destination, self.counts)

    def close(self) -> None:
        """Free the socket; later sends count as failed."""
        self._sock.close()


class MulticastSender(UdpSender):
    """Sends to a multicast group through one interface, even after that was unplugged and plugged in again."""

    def __init__(self, sock: socket.socket, group: Address, interface: bytes) -> None:
        """Choose the interface by its IPv4 address in four bytes; raises OSError if this computer does not have it."""
        super().__init__(sock, [group])
        self._interface = interface
        self._choose_interface()

    def send(self, datagram: bytes) -> None:
        """Send one datagram to the group; a failure is counted, never raised."""
        failed_before = self.counts.failed
        super().send(datagram)
        if self.counts.failed > failed_before:
            with suppress(OSError):
                self._choose_interface()

    def _choose_interface(self) -> None:
        self._sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, self._interface)


class UdpDuplex(Sender):
    """End point of an autopilot link that sends to one fixed peer, or to the one that its owner binds.

    A bound peer is heard on a socket of its own, with a buffer of its own: what others send to the port neither takes
    its place nor is read as often.
    """

    def __init__(self, sock: socket.socket, on_chunk: OnChunk, fixed_peer: Address | None) -> None:
        """Exchange datagrams on the running event loop."""
        super().__init__()
        self._sock = sock
        self._on_chunk = on_chunk
        self._fixed_peer = self._peer = fixed_peer
        self._reading = _Reading(sock, self._hear)
        self._of_peer: _Reading | None = None

    @property
    def peer(self) -> Address | None:
        """Address that the next datagram goes to, None if no peer is bound yet."""
        return self._peer

    def bind(self, peer: Address) -> None:
        """Send to this address from now on; a fixed peer stays."""
        if self._fixed_peer is not None or peer == self._peer:
            return
        self._peer = peer
        if self._of_peer is not None:
            self._of_peer.close()
        own = _socket_of(self._sock, peer)
        self._of_peer = None if own is None else _Reading(own, self._hear)
        self._reading.most_share = 1.0 if self._of_peer is None else STRANGERS_SHARE

    def overruns(self) -> int:
        """Return how many datagrams of all but the bound peer the kernel dropped because its buffer was full."""
        return _overruns(self._sock)

    def send(self, datagram: bytes) -> None:
        """Send one datagram to the peer; a failure, or having none yet, is counted, never raised."""
        if self._peer is None:
            self.counts.no_peer += 1
        else:
            _send_counted(self._sock, datagram, self._peer, self.counts)

    def close(self) -> None:
        """Stop receiving and free the port; later sends count as failed."""
        self._reading.close()
        if self._of_peer is not None:
            self._of_peer.close()

    def _hear(self, datagram: bytes, address: Address) -> None:
        if self._fixed_peer is None or address == self._fixed_peer:
            self._on_chunk(datagram, address)


class _Reading:
    """Reads the datagrams that wait in a socket, a bounded number at a time, and rests between where it has a share."""

    def __init__(self, sock: socket.socket, on_datagram: OnFrom, most_share: float = 1.0) -> None:
        """Begin to read on the running event loop; see `open_receiver` for `most_share`, of which 1 means no rest."""
        self.most_share = most_share
        self.counts = ReceiveCounts()
        self._sock = sock
        self._on_datagram = on_datagram
        self._buffer = bytearray(_DATAGRAM_BYTES)
        self._loop = asyncio.get_running_loop()
        self._resting: asyncio.TimerHandle | None = None
        self._loop.add_reader(sock, self._read)

    def close(self) -> None:
        """Stop reading and close the socket."""
        if self._resting is not None:
            self._resting.cancel()
        if self._sock.fileno() >= 0:
            self._loop.remove_reader(self._sock)
            self._sock.close()

    def _read(self) -> None:
        # By processor time: where others have the core meanwhile, the buffer fills all the sooner.
        began_s = time.thread_time()
        for _ in range(MAX_PER_WAKE):
            try:
                size, address = self._sock.recvfrom_into(self._buffer)
            except BlockingIOError:
                break
            except OSError:
                # An error such as the network going down, or an autopilot that is not there yet, is no reason to stop.
                self.counts.failed += 1
                break
            self.counts.chunks += 1
            self._on_datagram(bytes(self._buffer[:size]), address)
            # The callback that took the datagram may have closed the end point.
            if self._sock.fileno() < 0:
                return
        if self.most_share < 1.0:
            self._loop.remove_reader(self._sock)
            rest_s = max(REST_S, (time.thread_time() - began_s) * (1.0 / self.most_share - 1.0))
            self._resting = self._loop.call_later(random.uniform(0.0, 2.0) * rest_s, self._go_on)

    def _go_on(self) -> None:
        self._loop.add_reader(self._sock, self._read)


def _socket_of(sock: socket.socket, peer: Address) -> socket.socket | None:
    """Return a socket on the same port that hears one peer alone; None where the system refuses."""
    own = _new_socket(RECEIVE_BUFFER_BYTES)
    try:
        for one in (sock, own):
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        own.bind(sock.getsockname())
        own.connect(peer)
    except OSError:
        own.close()
        return None
    finally:
        # From here on the port is shared with nobody else.
        for one in (sock, own):
            if one.fileno() >= 0:
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
    return own


class _Rejoining:
    """Joins a multicast group again every REJOIN_PERIOD_S; the kernel refuses while the membership still exists."""

    def __init__(self, link: Link, sock: socket.socket, counts: ReceiveCounts) -> None:
        self._link = link
        self._sock = sock
        self._counts = counts
        self._wait()

    def cancel(self) -> None:
        self._waiting.cancel()

    def _wait(self) -> None:
        self._waiting = asyncio.get_running_loop().call_later(REJOIN_PERIOD_S, self._join)

    def _join(self) -> None:
        with suppress(OSError):
            _join(self._link, self._sock)
            self._counts.reopened += 1
        self._wait()


def _overruns(sock: socket.socket) -> int:
    """Return how many datagrams the kernel dropped as a socket's buffer was full; 0 where it does not tell."""
    try:
        counts = sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
        return int(_MEMINFO.unpack(counts)[-1])
    except (OSError, struct.error):
        return 0


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


async def _listening_socket(link: Link, receive_buffer_bytes: int) -> socket.socket:
    address = await _resolve(link, (link.host, link.port))
    if link.scheme == "udpbcast" and address[0] != _ANY:
        _require_broadcast(link, address[0])
    sock = _new_socket(receive_buffer_bytes)
    try:
        if link.scheme != "udpin":
            # Each receiver on this computer gets its copy. Not for udpin: datagrams to one computer's own address would
            # silently all go to a second program.
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(address)
        if link.scheme == "mcast":
            sock.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(link.host) + _interface(link))
    except OSError as error:
        sock.close()
        raise InputError(f"link '{link}': {_why(link, error)}") from error
    return sock


def _join(link: Link, sock: socket.socket) -> None:
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(link.host) + _interface(link))


def _interface(link: Link) -> bytes:
    return socket.inet_aton(link.interface or _ANY)


def _why(link: Link, error: OSError) -> str:
    if link.scheme == "mcast" and error.errno in (errno.EADDRNOTAVAIL, errno.ENODEV):
        if link.interface:
            return f"{link.interface} is not an address of this computer"
        return "no route to the group; name the interface: @ADDRESS"
    return {
        errno.EADDRINUSE: f"port {link.port} is in use by another program",
        errno.EADDRNOTAVAIL: f"{link.host} is not an address of this computer",
        errno.EACCES: f"no permission to use port {link.port}",
    }.get(error.errno or 0, str(error.strerror))


def _require_broadcast(link: Link, host: str) -> None:
    """Raise InputError for an address that is no broadcast address of a network of this computer.

    With such an address no error would tell that at most the one computer that has it receives anything.
    """
    with _new_socket() as probe:
        try:
            probe.connect((host, _UNUSED_PORT))
        except OSError:
            # Refused to a socket without SO_BROADCAST: the routing table knows it as a broadcast address. Without a
            # route the address cannot be checked, and sent datagrams count as failed until there is one.
            return
    raise InputError(
        f"link '{link}': {host} is not the broadcast address of a network of this computer; "
        "allowed: that address, as `ip address` shows it after brd, or 0.0.0.0 to listen"
    )


def _forbid_writing(sock: socket.socket) -> None:
    """Make the kernel itself refuse every write to a socket that is only for listening."""
    with suppress(OSError):
        # Linux marks the socket as shut down, but still returns ENOTCONN because there is no peer to notify.
        sock.shutdown(socket.SHUT_WR)


async def _resolve(link: Link, address: Address) -> Address:
    loop = asyncio.get_running_loop()
    try:
        found = await loop.getaddrinfo(*address, family=socket.AF_INET, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise InputError(f"link '{link}': host name '{address[0]}' is unknown") from error
    host, port = found[0][4][:2]
    return str(host), int(port)
