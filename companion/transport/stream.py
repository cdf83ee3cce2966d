"""Finds whole MAVLink frames in the autopilot's byte stream, which a serial line or TCP cuts anywhere.

Only messages of MAVLink's common set are found, because their CRC_EXTRA is known. Others are skipped: bytes that begin
like one may be noise, and no adapter reads them.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import common

from companion.files.mavlink_layout import CRC_BYTES, frame_length, frame_parts, may_begin_frame

_CRC_EXTRA = {number: kind.crc_extra for number, kind in common.mavlink_map.items()}


class FrameCutter:
    """Finds whole frames of both versions of MAVLink; stores at most one frame's bytes."""

    def __init__(self) -> None:
        self._kept = b""

    def feed(self, chunk: bytes) -> list[bytes]:
        """Return the frames that a chunk of the stream completes."""
        data = self._kept + chunk
        frames, at = [], 0
        waiting_at: int | None = None
        while at < len(data):
            if not may_begin_frame(data, at):
                at += 1
                continue
            length = frame_length(data, at)
            if length is None or at + length > len(data):
                # It may be noise that looks like the start of a long frame: frames after it must not wait for it.
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
    """Return whether the complete frame that begins at `at` is of a known message and has the right CRC."""
    message_id, _, crc_at, _ = frame_parts(data, at)
    extra = _CRC_EXTRA.get(message_id)
    if extra is None:
        return False
    crc = common.x25crc(data[at + 1 : crc_at] + bytes((extra,))).crc
    return bool(int.from_bytes(data[crc_at : crc_at + CRC_BYTES], "little") == crc)
