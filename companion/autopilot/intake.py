"""Finds the MAVLink frames in what comes over an autopilot's link, whichever way it comes.

A serial line or TCP cuts a stream of bytes anywhere, and so does a bridge from a serial line to UDP: every sender's
datagrams are one stream. Frames of both versions of MAVLink are found by their checks; what is no frame is counted.
"""

from __future__ import annotations

import re
from collections import Counter, OrderedDict
from collections.abc import Hashable
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega

from companion.files.mavlink_layout import (
    HEADER_V1_BYTES,
    HEADER_V2_BYTES,
    LENGTH_AT,
    MARKER_V1,
    MARKER_V2,
    OVERHEAD_BYTES,
    frame_parts,
    may_begin_frame,
)
from companion.protocol.dialect import oneway
from companion.protocol.frame import RawFrame, crc_holds, raw_frame

Message = Any
"""A decoded message; pymavlink's generated module has no type annotations."""

MAX_SOURCES = 16
"""Greatest number of senders whose cut frames are kept; beyond it the one that was silent for longest is forgotten."""
DAMAGED = "damaged"
"""Reason for bytes that begin as a known message, but have a wrong CRC."""
UNKNOWN = "unknown message"
"""Reason for a frame whose message is in none of the dialects, so that its CRC cannot be checked."""
JUNK = "no frame"

_KINDS = ardupilotmega.mavlink_map
"""The messages of ArduPilot's dialect, which has all of `common`."""
_CRC_EXTRA = {number: bytes((kind.crc_extra,)) for number, kind in (oneway.mavlink_map | _KINDS).items()}
_MOST_BYTES = {number: kind.unpacker.size for number, kind in (oneway.mavlink_map | _KINDS).items()}
"""The longest payload of each message, extension fields included."""
_CARRIERS = frozenset(
    number
    for number, kind in (oneway.mavlink_map | _KINDS).items()
    for name, length in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True)
    if length > OVERHEAD_BYTES and kind.fieldtypes[kind.fieldnames.index(name)] in ("uint8_t", "char")
)
"""The messages with a field of bytes that has room for a whole frame."""
_MARKER = re.compile(bytes((ord("["), MARKER_V1, MARKER_V2, ord("]"))))
_DECODER = ardupilotmega.MAVLink(None)


def is_whole(frame: RawFrame) -> bool:
    """Return whether a frame is of a known message and its CRC is right."""
    extra = _CRC_EXTRA.get(frame.message_id)
    return extra is not None and crc_holds(frame.data, 0, frame.crc_at, extra)


def decode(frame: RawFrame) -> Message | None:
    """Return the message of a frame; None if it is damaged, or not of ArduPilot's dialect. Never raises."""
    if frame.message_id not in _KINDS:
        return None
    try:
        return _DECODER.decode(bytearray(frame.data))
    except (ardupilotmega.MAVError, ValueError):
        return None


class _Look(NamedTuple):
    """What is at an offset of a stream: a frame, bytes to skip, or the beginning of a frame that is not all there."""

    end: int
    """Offset at which the search goes on."""
    is_frame: bool = False
    is_partial: bool = False
    may_carry: bool = False
    """Whether the content of the partial frame may itself be a frame."""
    reason: str = JUNK
    """Why the bytes are no frame."""


class Deframer:
    """Finds the whole frames in one sender's stream of bytes; keeps at most the bytes of one frame.

    Bytes that begin like a message may be noise, so frames are found behind them before it is complete. Only a message
    that may carry whole frames as its content is waited for: what it carries is not its sender's.
    """

    def __init__(self, skipped: Counter[str]) -> None:
        """Count in `skipped` each run of bytes that is no frame, by the reason of its first byte."""
        self._skipped = skipped
        self._kept = b""
        self._in_step = True
        """Whether a frame ended where the kept bytes begin, so that another one is due there."""

    def feed(self, chunk: bytes) -> list[RawFrame]:
        """Return the frames that a chunk of the stream completes."""
        data = self._kept + chunk
        frames: list[RawFrame] = []
        at, in_step = 0, self._in_step
        waiting: tuple[int, bool] | None = None
        while at < len(data):
            look = _look(data, at, in_step)
            if look.is_partial:
                waiting = waiting or (at, in_step)
                if look.may_carry:
                    break
            elif look.is_frame:
                if waiting is not None:
                    self._skipped[DAMAGED] += 1
                waiting = None
                frames.append(raw_frame(data[at : look.end]))
            elif in_step and waiting is None:
                self._skipped[look.reason] += 1
            at, in_step = look.end, look.is_frame or look.end > at + 1
            if not in_step:
                at = _next_marker(data, at)
        at, self._in_step = waiting or (len(data), in_step)
        self._kept = data[at:]
        return frames


def _next_marker(data: bytes, start: int) -> int:
    """Return the next offset at which a frame may begin, or the end: noise is passed over at once."""
    found = _MARKER.search(data, start)
    return len(data) if found is None else found.start()


def _look(data: bytes, at: int, in_step: bool) -> _Look:
    """Return what begins at an offset; `in_step`: a frame ended there, so that a frame of an unknown message counts."""
    if not may_begin_frame(data, at):
        return _Look(at + 1)
    header_bytes = HEADER_V1_BYTES if data[at] == MARKER_V1 else HEADER_V2_BYTES
    if at + header_bytes > len(data):
        return _Look(at + 1, is_partial=True)
    number, _, crc_at, end = frame_parts(data, at)
    crc_extra = _CRC_EXTRA.get(number)
    if crc_extra is None:
        # Skipped whole only where nothing speaks against its length: it may be noise, with frames behind it.
        followed = end == len(data) or (end < len(data) and may_begin_frame(data, end))
        return _Look(end if in_step and followed else at + 1, reason=UNKNOWN)
    if data[at + LENGTH_AT] > _MOST_BYTES[number]:
        return _Look(at + 1)
    if end > len(data):
        return _Look(at + 1, is_partial=True, may_carry=number in _CARRIERS)
    if crc_holds(data, at, crc_at, crc_extra):
        return _Look(end, is_frame=True)
    return _Look(at + 1, reason=DAMAGED)


class Intake:
    """Finds the frames of every sender on a link, each sender's bytes being a stream of their own."""

    def __init__(self) -> None:
        self.skipped: Counter[str] = Counter()
        """The number of runs of bytes that were no known frame, by reason."""
        self._streams: OrderedDict[Hashable, Deframer] = OrderedDict()

    def feed(self, chunk: bytes, source: Hashable = None) -> list[RawFrame]:
        """Return the frames that a chunk of a sender's stream completes; `source` tells senders apart."""
        stream = self._streams.get(source)
        if stream is None:
            stream = self._streams[source] = Deframer(self.skipped)
            if len(self._streams) > MAX_SOURCES:
                self._streams.popitem(last=False)
        self._streams.move_to_end(source)
        return stream.feed(chunk)
