"""Whole MAVLink frames out of a byte stream of the autopilot's: a serial line or TCP cuts them anywhere.

The frames are those of MAVLink's common set, whose checks are known; others are passed over, because what begins like
one may be noise, and nobody here reads them.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import common

_CRC_EXTRA = {number: kind.crc_extra for number, kind in common.mavlink_map.items()}
# The framing of MAVLink 1 and 2 (mavlink.io, "Packet Serialization").
_MARKER_V1, _MARKER_V2 = 0xFE, 0xFD
_HEADER_V1_BYTES, _HEADER_V2_BYTES = 6, 10
_CRC_BYTES = 2
_SIGNATURE_BYTES = 13
_FLAG_SIGNED = 0x01


class FrameCutter:
    """Finds whole frames of both versions of MAVLink; keeps no more than one frame's bytes."""

    def __init__(self) -> None:
        self._kept = b""

    def feed(self, chunk: bytes) -> list[bytes]:
        """Return the frames that a piece of the stream completes."""
        data = self._kept + chunk
        frames, at = [], 0
        waiting_at: int | None = None
        while at < len(data):
            length = _length(data, at)
            if length is not None and at + length > len(data):
                # It may be noise that looks like the start of a long frame: what follows is not kept waiting for it.
                waiting_at = at if waiting_at is None else waiting_at
                at += 1
            elif length is not None and _is_whole(data[at : at + length]):
                frames.append(data[at : at + length])
                at, waiting_at = at + length, None
            else:
                at += 1
        self._kept = b"" if waiting_at is None else data[waiting_at:]
        return frames


def _length(data: bytes, at: int) -> int | None:
    """Return how long a frame is that begins at a byte, as far as its head is there; None if none begins."""
    if data[at] == _MARKER_V1:
        return _HEADER_V1_BYTES + _CRC_BYTES + (data[at + 1] if at + 1 < len(data) else 0)
    if data[at] != _MARKER_V2:
        return None
    if at + 2 >= len(data):
        return _HEADER_V2_BYTES + _CRC_BYTES
    if data[at + 2] & ~_FLAG_SIGNED:
        return None
    return _HEADER_V2_BYTES + data[at + 1] + _CRC_BYTES + (_SIGNATURE_BYTES if data[at + 2] else 0)


def _is_whole(frame: bytes) -> bool:
    if frame[0] == _MARKER_V1:
        number, crc_at = frame[5], _HEADER_V1_BYTES + frame[1]
    else:
        number, crc_at = int.from_bytes(frame[7:10], "little"), _HEADER_V2_BYTES + frame[1]
    extra = _CRC_EXTRA.get(number)
    if extra is None:
        return False
    crc = common.x25crc(frame[1:crc_at] + bytes((extra,))).crc
    return bool(int.from_bytes(frame[crc_at : crc_at + _CRC_BYTES], "little") == crc)
