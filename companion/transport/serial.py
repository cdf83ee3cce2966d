"""Serial end points: they hand on bytes as read, never queue behind a slow radio, and reopen an unplugged device.

The device is opened and set up here, without a library, for one property: the receiver's descriptor is read-only, so
that the kernel refuses every write. Flow control lines are not used (three wires are enough): the sender is paced.
"""

from __future__ import annotations

import asyncio
import errno
import fcntl
import os
import termios
from collections.abc import Callable
from contextlib import suppress

from companion.errors import InputError
from companion.transport.link import (
    Link,
    OnChunk,
    OnDatagram,
    RadioReading,
    ReceiveCounts,
    Receiver,
    SendCounts,
    Sender,
)

REOPEN_FIRST_S = 0.25
"""Time after which an unplugged device is first opened again; each further wait is twice the one before."""
REOPEN_MAX_S = 4.0
"""Greatest wait before an unplugged device is opened again."""
TXBUF_VALID_S = 5.0
"""Age up to which a radio's report is used; a radio reports about once a second."""

_READ_BYTES = 4096


async def open_serial_receiver(link: Link, on_chunk: OnDatagram) -> Receiver:
    """Listen on a serial device; raises InputError if it cannot be opened."""
    counts = ReceiveCounts()

    def take(chunk: bytes) -> None:
        counts.chunks += 1
        on_chunk(chunk)

    device = _Device(link, os.O_RDONLY, take, counts)
    device.open_first()
    return Receiver(device.close, counts, is_stream=True)


async def open_serial_sender(link: Link, radio: RadioReading | None = None) -> SerialSender:
    """Open a serial device to send; raises InputError if it cannot be opened.

    `radio` makes the reader of the radio's own reports; without it no reports are read.
    """
    sender = SerialSender(link, radio)
    sender.open_first()
    return sender


async def open_serial_duplex(link: Link, on_chunk: OnChunk) -> SerialDuplex:
    """Open a serial line to an autopilot; raises InputError if it cannot be opened."""
    duplex = SerialDuplex(link, on_chunk)
    duplex.open_first()
    return duplex


class SerialSender(Sender):
    """Writes whole frames to a serial radio, and reads nothing but the radio's own reports of its transmit buffer."""

    def __init__(self, link: Link, radio: RadioReading | None = None) -> None:
        super().__init__()
        self._device = _Device(link, os.O_RDWR, self._hear, self.counts)
        self._device.on_lost = self._forget
        self._radio = radio
        self._read_txbuf = None if radio is None else radio()
        self._rest = b""
        self._txbuf: tuple[float, int] | None = None

    def open_first(self) -> None:
        """Open the device; raises InputError if that fails."""
        self._device.open_first()

    @property
    def txbuf_percent(self) -> int | None:
        """Free share of the radio's transmit buffer by its last report; None if that is older than TXBUF_VALID_S."""
        if self._txbuf is None or self._device.loop.time() - self._txbuf[0] > TXBUF_VALID_S:
            return None
        return self._txbuf[1]

    def send(self, datagram: bytes) -> None:
        """Write one datagram whole, or drop it while an earlier one is still being written."""
        if self._device.fd is None:
            self.counts.failed += 1
        elif self._rest:
            self.counts.full += 1
        else:
            self._write(datagram)

    def close(self) -> None:
        """Close the device; later sends count as failed."""
        self._device.close()

    def _write(self, datagram: bytes) -> None:
        fd = self._device.fd
        assert fd is not None
        try:
            written = os.write(fd, datagram)
        except BlockingIOError:
            self.counts.full += 1
        except OSError:
            self._device.lose()
        else:
            self.counts.sent += 1
            self._rest = datagram[written:]
            if self._rest:
                self._device.loop.add_writer(fd, self._write_rest)

    def _write_rest(self) -> None:
        fd = self._device.fd
        assert fd is not None
        try:
            self._rest = self._rest[os.write(fd, self._rest) :]
        except BlockingIOError:
            return
        except OSError:
            self._device.lose()
            return
        if not self._rest:
            self._device.loop.remove_writer(fd)

    def _hear(self, chunk: bytes) -> None:
        txbuf_percent = None if self._read_txbuf is None else self._read_txbuf(chunk)
        if txbuf_percent is not None:
            self._txbuf = (self._device.loop.time(), txbuf_percent)

    def _forget(self) -> None:
        """Drop the unsent bytes and the reports of the device that was lost."""
        self._rest, self._txbuf = b"", None
        self._read_txbuf = None if self._radio is None else self._radio()


class SerialDuplex(SerialSender):
    """An autopilot's serial line: received bytes are handed on as they come."""

    def __init__(self, link: Link, on_chunk: OnChunk) -> None:
        super().__init__(link)
        self._on_chunk = on_chunk

    def _hear(self, chunk: bytes) -> None:
        super()._hear(chunk)
        self._on_chunk(chunk, None)


class _Device:
    """A serial device that, once lost, is opened again after ever longer waits."""

    def __init__(self, link: Link, access: int, on_chunk: OnDatagram, counts: SendCounts | ReceiveCounts) -> None:
        self.loop = asyncio.get_running_loop()
        self.fd: int | None = None
        self.on_lost: Callable[[], None] = lambda: None
        self._link = link
        self._access = access
        self._on_chunk = on_chunk
        self._counts = counts
        self._wait_s = REOPEN_FIRST_S
        self._reopening: asyncio.TimerHandle | None = None

    def open_first(self) -> None:
        """Open the device for the first time; raises InputError that names the reason."""
        try:
            self._open()
        except OSError as error:
            reason = {
                errno.ENOENT: "no such device",
                errno.EACCES: "no permission; allowed: a member of the device's group, often dialout",
                errno.EBUSY: "in use by another program",
                errno.ENOTTY: "not a serial device",
            }.get(error.errno or 0, str(error.strerror))
            raise InputError(f"link '{self._link}': {reason}") from error

    def lose(self) -> None:
        """Count the loss of the device, release it and schedule its reopening."""
        self._counts.failed += 1
        self._release()
        self.on_lost()
        self._reopen_later()

    def close(self) -> None:
        """Close the device and do not open it again."""
        self._release()
        if self._reopening is not None:
            self._reopening.cancel()

    def _open(self) -> None:
        fd = os.open(self._link.path, self._access | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            _set_up(fd, self._link.baud)
        except termios.error as error:
            os.close(fd)
            raise OSError(*error.args) from error
        except OSError:
            os.close(fd)
            raise
        self.fd = fd
        self.loop.add_reader(fd, self._read)

    def _read(self) -> None:
        assert self.fd is not None
        try:
            chunk = os.read(self.fd, _READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            chunk = b""
        if chunk:
            self._wait_s = REOPEN_FIRST_S
            self._on_chunk(chunk)
        else:
            self.lose()

    def _release(self) -> None:
        if self.fd is not None:
            self.loop.remove_reader(self.fd)
            self.loop.remove_writer(self.fd)
            os.close(self.fd)
            self.fd = None

    def _reopen_later(self) -> None:
        self._reopening = self.loop.call_later(self._wait_s, self._reopen)
        self._wait_s = min(2.0 * self._wait_s, REOPEN_MAX_S)

    def _reopen(self) -> None:
        try:
            self._open()
        except OSError:
            self._reopen_later()
        else:
            self._counts.reopened += 1


def _set_up(fd: int, baud: int) -> None:
    """Set eight bits, no parity, one stop bit, nothing echoed or translated; raises termios.error or OSError."""
    speed = getattr(termios, f"B{baud}")
    characters = termios.tcgetattr(fd)[6]
    characters[termios.VMIN], characters[termios.VTIME] = 1, 0
    modes = termios.CS8 | termios.CREAD | termios.CLOCAL
    termios.tcsetattr(fd, termios.TCSANOW, [termios.IGNBRK, 0, modes, 0, speed, speed, characters])
    with suppress(OSError):
        # Exclusive, because two readers would each get only a part of the bytes.
        fcntl.ioctl(fd, termios.TIOCEXCL)
    termios.tcflush(fd, termios.TCIOFLUSH)
