"""Finds whole MAVLink 2 frames of our dialect in received bytes, without losing any to junk in front of it.

The stock parser swallows the bytes that follow a false start; here every byte may begin a frame, and bytes that begin
none are skipped. A frame found is whole, of a known message id, with a correct CRC and no unknown flag; its sender is
checked elsewhere. A frame inside a V2_EXTENSION (companion/protocol/v2_extension.py) is returned as if it had come
alone.
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
"""Greatest length of an accepted datagram: seven of the longest frames, more than any link hands over at once."""
MAX_FALSE_STARTS = 16
"""Number of marker bytes that begin no frame after which the rest of a datagram is skipped, to bound the work."""

DAMAGED = "damaged"
"""Reason for bytes that begin as a frame of our dialect, but with a wrong CRC or an unknown flag."""
INCOMPLETE = "incomplete"
FOREIGN = "foreign"
"""Reason for a message that is not of our dialect, so that its CRC cannot be checked."""
MAVLINK_1 = "MAVLink 1"
JUNK = "junk"

_CRC_EXTRA = {number: bytes((kind.crc_extra,)) for number, kind in oneway.mavlink_map.items()} | {
    V2_EXTENSION_ID: bytes((V2_EXTENSION_CRC_EXTRA,))
}
"""CRC_EXTRA by message id: of our dialect's messages, and of V2_EXTENSION, which may carry them."""


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
    """Yield the whole frames in a datagram; count each run of skipped bytes once, by the reason of its first byte."""
    if datagram and _look(datagram, 0) == (_Found.WHOLE, len(datagram)):
        # Nearly every datagram is one frame; in a flood the speed of this case counts.
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
    """Finds frames in a byte stream that comes in chunks, such as a serial radio's; stores at most one frame."""

    def __init__(self) -> None:
        self.skipped: Counter[str] = Counter()
        self._kept = b""
        self._skipping = False

    def feed(self, chunk: bytes) -> list[RawFrame]:
        """Return the frames completed by a chunk.

        A frame is returned with its last byte, even if bytes before it look like the start of a longer one.
        """
        buffer = self._kept + chunk
        frames = []
        waiting_at: int | None = None
        for found, at, end in _scan(buffer):
            if found is _Found.WHOLE:
                # Bytes of a V2_EXTENSION after its inner frame are not reported.
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
    """Yield the finding at each offset where a frame could begin, that offset and, of a whole frame, its end.

    The 13 bytes of a MAVLink signature are not covered by the CRC: if they were cut off, the next frame begins in their
    place. So frames are searched for there too, but other bytes there are not reported.
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
            # The byte right after a frame is examined even if it is no marker, so that it is counted.
            at = min(at, passed)


def _look(data: bytes, at: int) -> tuple[_Found, int]:
    """Return the finding at an offset and, if a whole frame begins there, the offset of its end."""
    if data[at] != MARKER_V2:
        return (_Found.MAVLINK_1 if data[at] == MARKER_V1 else _Found.JUNK), at
    if len(data) - at < HEADER_V2_BYTES:
        # Only if the part of the header that is there looks like ours is it worth waiting for more.
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
    """Return the finding for a V2_EXTENSION: whole if its payload holds exactly one whole frame of our dialect."""
    inner = inner_of(payload)
    if inner is None or frame_parts(inner)[0] == V2_EXTENSION_ID:
        # A V2_EXTENSION that is not ours: whole frames of ours may still begin among its bytes.
        return _Found.FOREIGN, at
    found, _ = _look(inner, 0)
    return found, end if found is _Found.WHOLE else at


def _is_inner(data: bytes, outer_at: int, at: int) -> bool:
    """Return whether `at` is the offset of the frame inside the V2_EXTENSION that begins at `outer_at`."""
    return at == outer_at + INNER_AT and frame_parts(data, outer_at)[0] == V2_EXTENSION_ID


def _unwrapped(data: bytes) -> RawFrame:
    """Return the frame inside a whole V2_EXTENSION, any other frame unchanged."""
    frame = raw_frame(data)
    inner = inner_of(frame.payload) if frame.message_id == V2_EXTENSION_ID else None
    return frame if inner is None else raw_frame(inner)


def _next_marker(data: bytes, start: int) -> int:
    at = data.find(MARKER_V2, start)
    return at if at >= 0 else len(data)
