"""Where the records of a telemetry log stand, also among bytes that are none: time stamp and frame, one after another.

A damaged log has zeros where a disk lost a block, half a record where a program died, or another log in its middle.
"""

from __future__ import annotations

import re
import struct

from companion.files.mavlink_layout import (
    CRC_BYTES,
    HEAD_BYTES,
    MAX_FRAME_BYTES,
    crc_extra_of,
    frame_length,
    frame_parts,
    may_begin_frame,
)

STAMP = struct.Struct(">Q")
"""The time of a record, as MAVProxy and pymavlink write it: microseconds since 1970, big endian; the frame follows."""
NEAR_US = 86_400 * 10**6
"""Time between two stamps up to which one record is taken for the other's neighbour: a day, in microseconds."""
LOOKAHEAD_BYTES = 2 * (STAMP.size + MAX_FRAME_BYTES) + STAMP.size + HEAD_BYTES
"""Bytes from a record's beginning by which it is judged: of it, of one inside it, and of the head behind that."""
_FRAME_OF_RECORD = re.compile(rb"(?<=\x00[\x00-\x1f].{6})(?:\xfe|\xfd(?=.[\x00\x01]))", re.DOTALL)
"""First byte of a frame behind a stamp of the years 1970 to 2255."""


class RecordFinder:
    """Finds the records of a log one after the other; it remembers what tells a record from other bytes."""

    def __init__(self) -> None:
        self._last_us: int | None = None
        """Stamp of the record found last."""
        self._extras: dict[int, int | None] = {}
        """CRC_EXTRA of the first record found of each message, by message id; None if its CRC was wrong."""

    def next_in(self, data: bytes, at: int, ended: bool, in_step: bool) -> tuple[int, int] | None:
        """Return start and end of the first record from offset `at` on; None if there is none that can be judged yet.

        `data`: a part of a log, the last one if it has `ended`; records that begin in the last LOOKAHEAD_BYTES of
        another one are not judged. `in_step`: the record before ends at `at`.
        """
        stop = len(data) if ended else len(data) - LOOKAHEAD_BYTES
        if at >= stop:
            return None
        end = _end(data, at) if in_step else None
        if end is None or not (self._is_in_place(data, at, end) or self._stands(data, at, end, stop)):
            found = self._search(data, at + in_step, stop)
            if found is None:
                return None
            at, end = found
        self._last_us = STAMP.unpack_from(data, at)[0]
        number = frame_parts(data, at + STAMP.size)[0]
        if number not in self._extras:
            self._extras[number] = crc_extra_of(data[at + STAMP.size : end])
        return at, end

    def _is_in_place(self, data: bytes, at: int, end: int) -> bool:
        """Return whether a record's stamp is near its neighbours', and its CRC fits or none is inside it.

        The damaged length of a record may reach exactly to the beginning of a later one.
        """
        if not (self._last_us is None or self._is_near(data, at)) or not self._goes_on(data, at, end):
            return False
        frame = data[at + STAMP.size : end]
        number, _, _, _ = frame_parts(frame)
        if number in self._extras and self._extras[number] == crc_extra_of(frame):
            return True
        return not self._has_inside(data, at, end)

    def _is_near(self, data: bytes, at: int) -> bool:
        """Return whether a record's stamp is near that of the record found last."""
        return self._last_us is not None and abs(STAMP.unpack_from(data, at)[0] - self._last_us) <= NEAR_US

    def _goes_on(self, data: bytes, at: int, end: int) -> bool:
        """Return whether the log ends behind a record, or another one follows it whose stamp is near."""
        return _is_followed(data, end) and (end == len(data) or _are_near(data, at, end))

    def _stands(self, data: bytes, at: int, end: int, stop: int) -> bool:
        """Return whether a record whose stamp is off, or that none follows, is one: its CRC fits, and none is in it.

        Besides, the next one follows at once, or there is none, or the stamp is near one of its neighbours'.
        """
        if not self._crc_fits(data, at, end) or self._has_inside(data, at, end):
            return False
        if self._is_near(data, at) or _is_followed(data, end):
            return True
        found = self._search(data, end, stop)
        return found is None or _are_near(data, at, found[0])

    def _has_inside(self, data: bytes, at: int, end: int) -> bool:
        """Return whether another record begins in one: its frame, or its stamp too where no CRC covers the bytes."""
        _, _, crc_at, _ = frame_parts(data, at + STAMP.size)
        is_signed = crc_at + CRC_BYTES < end
        return self._search(data, at + 1, end if is_signed else end - STAMP.size) is not None

    def _search(self, data: bytes, start: int, stop: int) -> tuple[int, int] | None:
        """Return the first record that begins at an offset from `start` to before `stop`, by all that tells one."""
        for match in _FRAME_OF_RECORD.finditer(data, start + STAMP.size, stop + STAMP.size + HEAD_BYTES):
            at = match.start() - STAMP.size
            if at >= stop:
                return None
            end = _end(data, at)
            if end is None or not self._crc_fits(data, at, end):
                continue
            if self._is_near(data, at) or self._goes_on(data, at, end):
                return at, end
        return None

    def _crc_fits(self, data: bytes, at: int, end: int) -> bool:
        """Return whether a frame's CRC can be right: with the CRC_EXTRA of the same message before, or with any."""
        frame = data[at + STAMP.size : end]
        extra = crc_extra_of(frame)
        return extra is not None and self._extras.get(frame_parts(frame)[0]) in (None, extra)


def _end(data: bytes, at: int) -> int | None:
    """Return the end of the record that begins at an offset; None if no frame follows its stamp, or not a whole one."""
    start = at + STAMP.size
    if start + HEAD_BYTES > len(data) or not may_begin_frame(data, start):
        return None
    length = frame_length(data, start)
    return None if length is None or start + length > len(data) else start + length


def _is_followed(data: bytes, end: int) -> bool:
    """Return whether a frame begins where that of the next record would, or the log ends."""
    if len(data) - end < STAMP.size + HEAD_BYTES:
        return end == len(data)
    return may_begin_frame(data, end + STAMP.size)


def _are_near(data: bytes, one_at: int, other_at: int) -> bool:
    """Return whether the stamps of two records are near each other."""
    one_us: int = STAMP.unpack_from(data, one_at)[0]
    other_us: int = STAMP.unpack_from(data, other_at)[0]
    return abs(one_us - other_us) <= NEAR_US
