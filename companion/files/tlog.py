"""Telemetry logs, which every MAVLink tool opens: each record is a time stamp and one raw frame.

A `.tlog` keeps what was on the wire, byte for byte, and survives a crash: only the record being written is lost.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Protocol, Self

from companion.errors import InputError
from companion.files.mavlink_layout import HEAD_BYTES, frame_length

# The format, as MAVProxy and pymavlink write it: microseconds since 1970, big endian, then the frame.
_STAMP = struct.Struct(">Q")
_MICROSECONDS = 1e6
_READ_BLOCK_BYTES = 1 << 20


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
        self._file.write(_STAMP.pack(round(t_unix_s * _MICROSECONDS)) + frame)

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


def read_tlog(path: str | os.PathLike[str]) -> Iterator[tuple[float, bytes]]:
    """Return an iterator over the records of a log as (t_unix_s, frame); a truncated last record is left out.

    Raises InputError at once for a file that cannot be opened, and while iterating where a record does not begin with
    a MAVLink frame.
    """
    try:
        file = Path(path).open("rb")
    except OSError as error:
        raise InputError(f"{os.fspath(path)}: cannot read the log: {error.strerror}") from error
    return _records(file, os.fspath(path))


def _records(file: BinaryIO, name: str) -> Iterator[tuple[float, bytes]]:
    with file:
        pending = b""
        passed_bytes = 0
        while block := file.read(_READ_BLOCK_BYTES):
            pending += block
            at = 0
            while at + _STAMP.size + HEAD_BYTES <= len(pending):
                start = at + _STAMP.size
                length = frame_length(pending, start)
                if length is None:
                    raise InputError(f"{name}: byte {passed_bytes + start}: not a MAVLink frame; is it a .tlog?")
                if start + length > len(pending):
                    break
                yield _STAMP.unpack_from(pending, at)[0] / _MICROSECONDS, pending[start : start + length]
                at = start + length
            passed_bytes += at
            pending = pending[at:]
