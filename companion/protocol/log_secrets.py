"""What of a frame a log may hold: no signature and no key, neither its own nor one of a frame that it carries.

A frame may carry others, in V2_EXTENSION, TUNNEL or any other message with room for bytes, and they may carry others
again. A signature that stood in a log could be used against whoever shares the key, if his clock were set back.
"""

from __future__ import annotations

from typing import NamedTuple

from companion.files.mavlink_layout import (
    CRC_BYTES,
    FLAGS_AT,
    HEADER_V2_BYTES,
    MARKER_V2,
    SIGNED_FLAG,
    crc_extra_of,
    frame_length,
    frame_parts,
    may_begin_frame,
)
from companion.protocol.frame import RawFrame, crc_bytes
from companion.protocol.mavlink_signing import strip_signature

SETUP_SIGNING_ID = 256
"""Id of the MAVLink message SETUP_SIGNING, which carries a secret key."""


class _Inner(NamedTuple):
    """A frame that another one carries."""

    at: int
    crc_at: int
    end: int
    """Offset of its end, which is behind the other one's payload where that was cut."""
    crc_extra: int


def without_secrets(frame: RawFrame) -> bytes | None:
    """Return a frame as a log may hold it; None for one that carries a key.

    Its own MAVLink signature is cut off, those of the frames in it are overwritten with zeros; CRCs are set to match.
    """
    if frame.message_id == SETUP_SIGNING_ID:
        return None
    data = strip_signature(frame)
    end = frame.crc_at
    if data.find(MARKER_V2, frame.header_bytes, end) < 0:
        return data
    if _carries_key(data, frame.header_bytes, end):
        return None
    inner = _carried(data, frame.header_bytes, end)
    return _blanked(data, end, inner) if any(_is_signed(data, one) for one in inner) else data


def _carries_key(data: bytes, start: int, end: int) -> bool:
    """Return whether a SETUP_SIGNING begins between two offsets, whole or not."""
    at = start - 1
    while (at := data.find(MARKER_V2, at + 1, end)) >= 0:
        if at + HEADER_V2_BYTES <= end and may_begin_frame(data, at) and frame_parts(data, at)[0] == SETUP_SIGNING_ID:
            return True
    return False


def _carried(data: bytes, start: int, end: int) -> list[_Inner]:
    """Return the frames that begin between two offsets, one inside the other too; zeros may be cut off at the end."""
    found = []
    at = start - 1
    while (at := data.find(MARKER_V2, at + 1, end)) >= 0:
        length = frame_length(data, at) if at + HEADER_V2_BYTES <= end and may_begin_frame(data, at) else None
        if length is None:
            continue
        frame = data[at : min(at + length, end)].ljust(length, b"\0")
        extra = crc_extra_of(frame)
        if extra is not None:
            _, _, crc_at, _ = frame_parts(frame)
            found.append(_Inner(at, at + crc_at, at + length, extra))
    return found


def _is_signed(data: bytes, inner: _Inner) -> bool:
    return bool(data[inner.at + FLAGS_AT] & SIGNED_FLAG)


def _blanked(data: bytes, end: int, inner: list[_Inner]) -> bytes:
    """Return a frame, whose payload ends at `end`, with zeros for the signatures in it, the innermost first."""
    outer_extra = crc_extra_of(data)
    content = bytearray(data)
    for one in reversed(inner):
        if _is_signed(data, one):
            signature_at = min(one.crc_at + CRC_BYTES, end)
            content[signature_at : min(one.end, end)] = bytes(max(0, min(one.end, end) - signature_at))
        if one.crc_at + CRC_BYTES <= end:
            covered = bytes(content[one.at : one.crc_at])
            content[one.crc_at : one.crc_at + CRC_BYTES] = crc_bytes(covered, bytes((one.crc_extra,)))
    if outer_extra is not None:
        content[end : end + CRC_BYTES] = crc_bytes(bytes(content[:end]), bytes((outer_extra,)))
    return bytes(content)
