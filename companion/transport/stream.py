"""Whole MAVLink frames out of a byte stream of the autopilot's: a serial line or TCP cuts them anywhere.

The frames are those of MAVLink's common set, whose checks are known; others are passed over, because what begins like
one may be noise, and nobody here reads them.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import common

from companion.files.mavlink_layout import CRC_BYTES, frame_length, frame_parts, may_begin_frame

_CRC_EXTRA = {number: kind.crc_extra for number, kind in common.mavlink_map.items()}


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
            if not may_begin_frame(data, at):
                at += 1
                continue
            length = frame_length(data, at)
            if length is None or at + length > len(data):
                # It may be noise that looks like the start of a long frame: what follows is not kept waiting for it.
                waiting_at = at if waiting_at is None else waiting_at
                at += 1
            elif _is_whole(data, at):
                frames.append(data[at : at + length])
                at, waiting_at = at + length, None
            else:
                at += 1
        self._kept = b"" if waiting_at is None else data[waiting_at:]
        return frames


def _is_whole(data: bytes, at: int) -> bool:
    """Return whether the frame that begins at a byte, and is there to its end, is of a known message and undamaged."""
    message_id, _, crc_at, _ = frame_parts(data, at)
    extra = _CRC_EXTRA.get(message_id)
    if extra is None:
        return False
    crc = common.x25crc(data[at + 1 : crc_at] + bytes((extra,))).crc
    return bool(int.from_bytes(data[crc_at : crc_at + CRC_BYTES], "little") == crc)
