"""Frames wrapped in V2_EXTENSION, for links through an autopilot that forwards only messages that it knows.

The outer frame is MAVLink's message 248; its payload holds a whole frame of the dialect, signatures included. MAVLink
cuts the zeros at a payload's end, so the inner frame may arrive short; its own length byte gives its full length.
"""

from __future__ import annotations

import struct

from companion.files.mavlink_layout import (
    CRC_BYTES,
    HEADER_V2_BYTES,
    MARKER_V2,
    frame_length,
)
from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM
from companion.protocol.frame import RawFrame, crc_bytes, crc_holds, head_v2

V2_EXTENSION_ID = 248
V2_EXTENSION_CRC_EXTRA = 8
"""CRC_EXTRA of V2_EXTENSION, from its definition in common.xml."""
MESSAGE_TYPE = 0xA001
"""Message type of a wrapped frame. Chosen: types below 32768 are reserved for registered extensions."""

_FIELDS = struct.Struct("<HBBB")
"""Fields before the inner frame: message type, then target network, system and component (0: all)."""
WRAP_BYTES = HEADER_V2_BYTES + _FIELDS.size + CRC_BYTES
"""Bytes that wrapping adds to a frame: MAVLink's header and CRC, and the fields before the inner frame."""
INNER_AT = HEADER_V2_BYTES + _FIELDS.size
"""Offset of the inner frame, after MAVLink's header and the fields before it."""

_LEAST_BYTES = HEADER_V2_BYTES + CRC_BYTES
"""Length of the shortest MAVLink 2 frame."""
_MOST_INNER_BYTES = 249
"""Greatest length of an inner frame: that of V2_EXTENSION's `payload` array."""
_CRC_EXTRA = bytes((V2_EXTENSION_CRC_EXTRA,))


def wrap(raw: bytes, sequence: int, system: int = GROUND_SYSTEM, component: int = GROUND_COMPONENT) -> bytes:
    """Return the V2_EXTENSION frame that carries one whole frame; `sequence` is MAVLink's, for the outer frame.

    Raises ValueError if the frame is longer than the message's payload area.
    """
    if len(raw) > _MOST_INNER_BYTES:
        raise ValueError(f"{len(raw)} bytes in a V2_EXTENSION; allowed: at most {_MOST_INNER_BYTES}")
    payload = (_FIELDS.pack(MESSAGE_TYPE, 0, 0, 0) + raw).rstrip(b"\x00")
    body = head_v2(len(payload), sequence % 256, (system, component), V2_EXTENSION_ID) + payload
    return body + crc_bytes(body, _CRC_EXTRA)


def unwrap(frame: RawFrame) -> bytes | None:
    """Return the inner frame of a V2_EXTENSION frame with our message type, None for any other frame. Never raises.

    The outer frame's checksum is verified, its MAVLink signature is not; of the inner frame only the length is checked.
    """
    if frame.version != 2 or frame.message_id != V2_EXTENSION_ID:
        return None
    return inner_of(frame.payload) if crc_holds(frame.data, 0, frame.crc_at, _CRC_EXTRA) else None


def inner_of(payload: bytes) -> bytes | None:
    """Return the inner frame in a V2_EXTENSION's payload, None if its message type is not ours. Never raises."""
    inner = payload[_FIELDS.size :]
    if payload[:2] != MESSAGE_TYPE.to_bytes(2, "little") or not inner or inner[0] != MARKER_V2:
        return None
    inner = inner.ljust(_LEAST_BYTES, b"\x00")
    length = frame_length(inner)
    return None if length is None or len(inner) > length else inner.ljust(length, b"\x00")
