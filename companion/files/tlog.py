"""Telemetry logs, which every MAVLink tool opens: each record is a time stamp and one raw frame.

A `.tlog` keeps what was on the wire, byte for byte, and survives a crash: only the record being written is lost.
"""

from __future__ import annotations

import errno
import itertools
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO, FileIO, RawIOBase
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Protocol, Self

from companion.errors import InputError
from companion.files.mavlink_layout import frame_length
from companion.files.records import LOOKAHEAD_BYTES, NEAR_US, STAMP, RecordFinder

MAX_PLACES = 1_000
"""Greatest number of places of damage that are remembered; further ones are only counted."""
SHOWN_PLACES = 5
"""Number of places of damage that a message names."""
_MICROSECONDS = 1e6
_READ_BLOCK_BYTES = 1 << 20
STEADY_RECORDS = 8
"""Number of records ahead by which an absurd stamp is told from a step of the clock."""
_BAD_BLOCK_BYTES = 4_096
"""Bytes that are passed over where the disk cannot read: a page, or one block of most disks."""


class Sink(Protocol):
    """An object that bytes can be written to, such as a binary file."""

    def write(self, content: bytes, /) -> object:
        """Append bytes; raises OSError."""
        ...

    def flush(self) -> None:
        """Pass buffered bytes on to the disk or stream; raises OSError."""
        ...

    def close(self) -> None:
        """Flush and close; nothing can be written after that. Raises OSError."""
        ...


class TlogWriter:
    """Writes records to a file that it opens and closes itself, or to a sink that the caller closes."""

    def __init__(self, target: str | os.PathLike[str] | Sink) -> None:
        """Open the log, replacing an older one; raises InputError if the path cannot be written."""
        self._owned = isinstance(target, str | os.PathLike)
        if isinstance(target, str | os.PathLike):
            try:
                self._file: Sink = Path(target).open("wb")
            except OSError as error:
                raise InputError(f"{os.fspath(target)}: cannot write the log: {error.strerror}") from error
        else:
            self._file = target

    def write(self, t_unix_s: float, frame: bytes) -> None:
        """Append one frame, stamped in seconds since 1970.

        Raises ValueError if the bytes are not one whole frame: a reader finds the next record by the frame's length.
        """
        if frame_length(frame) != len(frame):
            raise ValueError("a tlog record holds exactly one whole MAVLink frame")
        self._file.write(STAMP.pack(round(t_unix_s * _MICROSECONDS)) + frame)

    def flush(self) -> None:
        """Pass buffered records on to the operating system, or to the sink's own flush."""
        self._file.flush()

    def close(self) -> None:
        """Flush, and close the file if this writer opened it."""
        if self._owned:
            self._file.close()
        else:
            self._file.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def whole_frames(datagram: bytes) -> Iterator[bytes]:
    """Yield the frames at the start of a datagram one by one, up to the first bytes that are not a whole frame."""
    at = 0
    while True:
        length = frame_length(datagram, at)
        if length is None or at + length > len(datagram):
            return
        yield datagram[at : at + length]
        at += length


def read_tlog(path: str | os.PathLike[str]) -> Tlog:
    """Return the records of a log as (t_unix_s, frame), and what is left out of it.

    Raises InputError at once for a file that cannot be opened, and while iterating at one that cannot be read on or, at
    its end, holds no record.
    """
    try:
        file = FileIO(path)
    except OSError as error:
        raise InputError(f"{os.fspath(path)}: cannot read the log: {error.strerror}") from error
    return Tlog(file, os.fspath(path))


class LeftOut(NamedTuple):
    """Bytes of a log in which no record can be read."""

    at: int
    """Offset of the first."""
    length: int
    """Number of them."""


class Tlog(Iterator[tuple[float, bytes]]):
    """The records of a log, which may be damaged: behind bytes that are none, the next record is found again.

    A record in its place is delivered as it is, its CRC unchecked: a log may hold damaged frames on purpose. Beside
    damage only a frame whose CRC can be right is delivered. A stamp that is more than NEAR_US off its neighbours, which
    are near each other, is replaced. The time that reading takes grows with the log's length alone, whatever is in it.
    """

    def __init__(self, file: RawIOBase | BytesIO, name: str) -> None:
        """Read an open file, and close it at its end; `name` names it in messages."""
        self.left_out: list[LeftOut] = []
        """What was left out so far: the first MAX_PLACES of it."""
        self.places = 0
        """Number of places where something was left out so far."""
        self.bytes_left_out = 0
        self.restamped = 0
        """Number of stamps replaced so far."""
        self._name = name
        self._records = _steadied(self._found(file), self._note_restamped)

    @property
    def whole(self) -> bool:
        """Whether nothing was left out or replaced so far."""
        return self.places == 0 and self.restamped == 0

    @property
    def words(self) -> str:
        """What was left out and replaced so far, in words; empty if nothing was."""
        shown = self.left_out[:SHOWN_PLACES]
        parts = [f"{_spaced(gap.length)}{' bytes' * (gap is shown[0])} at {_spaced(gap.at)}" for gap in shown]
        if self.places > len(shown):
            parts.append(f"{_spaced(self.bytes_left_out)} at {_spaced(self.places)} places in all")
        said = [f"left out {', '.join(parts)}"] if parts else []
        if self.restamped:
            said.append(f"{_spaced(self.restamped)} absurd times replaced by their neighbours'")
        return "; ".join(said)

    def __next__(self) -> tuple[float, bytes]:
        return next(self._records)

    def _found(self, file: RawIOBase | BytesIO) -> Iterator[tuple[int, bytes]]:
        """Yield stamp and frame of each record, in the order of the file."""
        finder, pending = RecordFinder(), b""
        expected = passed = 0
        """Offsets in the file: where the last record ended, and of the first byte of `pending`."""
        delivered = ended = False
        with file:
            while not ended:
                block = _next_block(file, self._name)
                ended = not block
                pending += block
                at = max(0, expected - passed)
                in_step = expected >= passed
                while (found := finder.next_in(pending, at, ended, in_step)) is not None:
                    start, at = found
                    in_step = True
                    self._leave_out(expected, passed + start)
                    expected, delivered = passed + at, True
                    yield STAMP.unpack_from(pending, start)[0], pending[start + STAMP.size : at]
                # Where no record was found up to here, none begins before the bytes that could not be judged yet.
                at = max(at, len(pending) - LOOKAHEAD_BYTES)
                passed, pending = passed + at, pending[at:]
        self._leave_out(expected, passed + len(pending))
        if not delivered and self.places:
            raise InputError(f"{self._name}: no MAVLink frame in {_spaced(self.bytes_left_out)} bytes; is it a .tlog?")

    def _leave_out(self, at: int, end: int) -> None:
        if end > at:
            self.places += 1
            self.bytes_left_out += end - at
            if self.places <= MAX_PLACES:
                self.left_out.append(LeftOut(at, end - at))

    def _note_restamped(self) -> None:
        self.restamped += 1


def _next_block(file: RawIOBase | BytesIO, name: str) -> bytes:
    """Return the next bytes of a file, zeros for a block that its disk cannot read, nothing at its end."""
    try:
        return file.read(_READ_BLOCK_BYTES) or b""
    except OSError as error:
        at = file.tell()
        if error.errno != errno.EIO or at >= os.fstat(file.fileno()).st_size:
            raise InputError(f"{name}: cannot read the log: {error.strerror}") from error
        file.seek(at + _BAD_BLOCK_BYTES)
        return bytes(_BAD_BLOCK_BYTES)


def _steadied(records: Iterator[tuple[int, bytes]], note: Callable[[], None]) -> Iterator[tuple[float, bytes]]:
    """Yield records (t_unix_s, frame) with absurd stamps replaced by a neighbour's; `note` is called for each."""
    coming = deque(itertools.islice(records, STEADY_RECORDS))
    before_us: int | None = None
    while coming:
        stamp_us, frame = coming.popleft()
        if before_us is None or abs(stamp_us - before_us) > NEAR_US:
            steady_us = _steady_us(before_us, stamp_us, [later_us for later_us, _ in coming])
            if steady_us != stamp_us:
                note()
            stamp_us = steady_us
        before_us = stamp_us
        yield stamp_us / _MICROSECONDS, frame
        coming.extend(itertools.islice(records, 1))


def _steady_us(before_us: int | None, stamp_us: int, later_us: Sequence[int]) -> int:
    """Return the stamp of a record that is first or far off the one before, or its neighbour's if the log goes on so.

    A step that stays, of a clock that was set while the log was written, is none.
    """
    if before_us is None:
        # The first stamp has only those behind it to be judged by; they must agree with each other.
        goes_on = len(later_us) >= 2 and all(abs(one - later_us[0]) <= NEAR_US for one in later_us)
        return later_us[0] if goes_on and abs(stamp_us - later_us[0]) > NEAR_US else stamp_us
    goes_on = not later_us or any(abs(one - before_us) <= NEAR_US for one in later_us)
    return before_us if goes_on else stamp_us


def _spaced(number: int) -> str:
    """Return a number with its thousands apart, such as 88 213."""
    return f"{number:,}".replace(",", " ")
