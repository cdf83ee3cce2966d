"""Finds whole MAVLink 2 frames of our dialect in whatever arrives, without ever losing one to junk in front of it.

The stock parser swallows what follows a false start; here every byte may begin a frame, and what begins none is
skipped. A frame found is whole, of a known message id, with a correct CRC and no flag that we do not know; who sent it
is asked elsewhere. One inside a V2_EXTENSION (companion/protocol/v2_extension.py) is given as if it had come alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from enum import Enum

from companion.files.mavlink_layout import (
    FLAGS_AT,
    HEADER_V2_BYTES,
    MARKER_V1,
    MARKER_V2,
    SIGNATURE_BYTES,
    SIGNED_FLAG,
    frame_parts,
    may_begin_frame,
)
from companion.protocol.dialect import oneway
from companion.protocol.frame import RawFrame, crc_bytes, crc_holds, raw_frame
from companion.protocol.v2_extension import INNER_AT, V2_EXTENSION_CRC_EXTRA, V2_EXTENSION_ID, inner_of

MAX_DATAGRAM_BYTES = 2048
"""More than any link of ours hands over at once: it holds seven of the longest frames."""
MAX_FALSE_STARTS = 16
"""After as many marker bytes that begin no frame the rest of a datagram is left: a bound on the work per datagram."""

DAMAGED = "damaged"
"""Begins as a frame of ours, but its CRC is wrong or it has an unknown flag."""
INCOMPLETE = "incomplete"
FOREIGN = "foreign"
"""A message that is not of our dialect, so that its CRC cannot be known."""
MAVLINK_1 = "MAVLink 1"
JUNK = "junk"

_CRC_EXTRA = {number: bytes((kind.crc_extra,)) for number, kind in oneway.mavlink_map.items()} | {
    V2_EXTENSION_ID: bytes((V2_EXTENSION_CRC_EXTRA,))
}
"""What is added to each message's bytes before its CRC is made, by message id: of our dialect, and of what carries its
frames."""


class _Found(Enum):
    WHOLE = "whole"
    DAMAGED = DAMAGED
    PARTIAL = INCOMPLETE
    FOREIGN = FOREIGN
    MAVLINK_1 = MAVLINK_1
    JUNK = JUNK


def crc_of(head_and_payload: bytes, number: int) -> bytes:
    """Return the two CRC bytes of a frame of our dialect, given all its bytes before them and its message id."""
    return crc_bytes(head_and_payload, _CRC_EXTRA[number])


def frames_in(datagram: bytes, skipped: Counter[str]) -> Iterator[RawFrame]:
    """Yield the whole frames in a datagram; each run of bytes that is skipped counts once, by what it begins with."""
    if datagram and _look(datagram, 0) == (_Found.WHOLE, len(datagram)):
        # Nearly always; in a flood it is what counts.
        yield _unwrapped(datagram)
        return
    false_starts, skipping = 0, False
    for found, at, end in _scan(datagram):
        if found is _Found.WHOLE:
            skipping = False
            yield _unwrapped(datagram[at:end])
            continue
        if not skipping:
            skipped[found.value] += 1
        skipping = True
        false_starts += datagram[at] == MARKER_V2
        if false_starts == MAX_FALSE_STARTS:
            return


class StreamFramer:
    """Finds frames in a byte stream that arrives in chunks, such as a radio's; keeps no more than one frame's bytes."""

    def __init__(self) -> None:
        self.skipped: Counter[str] = Counter()
        self._kept = b""
        self._skipping = False

    def feed(self, chunk: bytes) -> list[RawFrame]:
        """Return the frames completed by a chunk.

        A frame is given as soon as its last byte is there, even when what looks like the start of a longer one
        precedes it.
        """
        buffer = self._kept + chunk
        frames = []
        waiting_at: int | None = None
        for found, at, end in _scan(buffer):
            if found is _Found.WHOLE:
                # What a V2_EXTENSION has behind its inner frame is nothing to report.
                is_inner = waiting_at is not None and _is_inner(buffer, waiting_at, at)
                if waiting_at is not None and not is_inner and not self._skipping:
                    self.skipped[DAMAGED] += 1
                frames.append(_unwrapped(buffer[at:end]))
                waiting_at, self._skipping = None, is_inner
            elif found is _Found.PARTIAL:
                waiting_at = at if waiting_at is None else waiting_at
            elif waiting_at is None:
                if not self._skipping:
                    self.skipped[found.value] += 1
                self._skipping = True
        self._kept = b"" if waiting_at is None else buffer[waiting_at:]
        return frames


def _scan(data: bytes) -> Iterator[tuple[_Found, int, int]]:
    """Yield what begins at each place where a frame could, its place and, of a whole frame, its end.

    The 13 bytes of a MAVLink signature are not under the CRC: where they were cut off, the next frame begins among
    what looks like them. So frames are looked for there too, but other bytes there are nothing to report.
    """
    at = passed = 0
    while at < len(data):
        found, end = _look(data, at)
        if found is _Found.WHOLE:
            yield found, at, end
            passed = end
            start = end - SIGNATURE_BYTES if data[at + FLAGS_AT] & SIGNED_FLAG else end
        else:
            if at >= passed or found is _Found.PARTIAL:
                yield found, at, at
            start = at + 1
        at = _next_marker(data, start)
        if start <= passed:
            # What stands right behind a frame is looked at whatever it is, so that it is counted.
            at = min(at, passed)


def _look(data: bytes, at: int) -> tuple[_Found, int]:
    """Return what begins at a byte, and where a whole frame that begins there ends."""
    if data[at] != MARKER_V2:
        return (_Found.MAVLINK_1 if data[at] == MARKER_V1 else _Found.JUNK), at
    if len(data) - at < HEADER_V2_BYTES:
        # As much of the header as is there must look like ours: only then is more worth waiting for.
        return (_Found.PARTIAL if may_begin_frame(data, at) else _Found.DAMAGED), at
    if data[at + FLAGS_AT] & ~SIGNED_FLAG:
        return _Found.DAMAGED, at
    number, payload_at, crc_at, end = frame_parts(data, at)
    crc_extra = _CRC_EXTRA.get(number)
    if crc_extra is None:
        return _Found.FOREIGN, at
    if end > len(data):
        return _Found.PARTIAL, at
    if not crc_holds(data, at, crc_at, crc_extra):
        return _Found.DAMAGED, at
    if number == V2_EXTENSION_ID:
        return _look_inside(data[payload_at:crc_at], at, end)
    return _Found.WHOLE, end


def _look_inside(payload: bytes, at: int, end: int) -> tuple[_Found, int]:
    """Return what a V2_EXTENSION is that begins and ends there: whole if just one whole frame of ours is inside."""
    inner = inner_of(payload)
    if inner is None or frame_parts(inner)[0] == V2_EXTENSION_ID:
        # Of others; its bytes may hold whole frames all the same.
        return _Found.FOREIGN, at
    found, _ = _look(inner, 0)
    return found, end if found is _Found.WHOLE else at


def _is_inner(data: bytes, outer_at: int, at: int) -> bool:
    """Return whether what begins at `at` stands where the frame inside a V2_EXTENSION would."""
    return at == outer_at + INNER_AT and frame_parts(data, outer_at)[0] == V2_EXTENSION_ID


def _unwrapped(data: bytes) -> RawFrame:
    """Return the frame inside a whole V2_EXTENSION, any other frame as it is."""
    frame = raw_frame(data)
    inner = inner_of(frame.payload) if frame.message_id == V2_EXTENSION_ID else None
    return frame if inner is None else raw_frame(inner)


def _next_marker(data: bytes, start: int) -> int:
    at = data.find(MARKER_V2, start)
    return at if at >= 0 else len(data)
