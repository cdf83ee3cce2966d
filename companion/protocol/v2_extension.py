"""Frames inside V2_EXTENSION, for paths through an autopilot that passes on only messages that it knows.

The outer frame is MAVLink's message 248 with our whole frame, signatures and all, as its payload. MAVLink cuts the
zeros at a payload's end, so the inner frame may arrive short; its own length byte says how long it was.
"""

from __future__ import annotations

import struct

from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM
from companion.protocol.dialect.oneway import x25crc

V2_EXTENSION_ID = 248
V2_EXTENSION_CRC_EXTRA = 8
"""Of the message as common.xml defines it."""
MESSAGE_TYPE = 0xA001
"""Ours; types below 32768 are kept for registered extensions."""
WRAP_BYTES = 12 + 5
"""MAVLink's own frame around the payload, and the fields before the inner frame."""
INNER_AT = 10 + 5
"""Where the inner frame begins: behind MAVLink's header and those fields."""

_MARKER = 0xFD
_FLAG_SIGNED = 0x01
_SIGNATURE_BYTES = 13
_HEAD = struct.Struct("<BBBBBBBHB")
"""Marker, payload length, incompatible and compatible flags, sequence, system, component, message id in 24 bits."""
_FIELDS = struct.Struct("<HBBB")
"""Message type, and network, system and component that it is for: 0, everybody's."""
_FRAME_BYTES = 12
_MOST_INNER_BYTES = 249
"""The payload area of a V2_EXTENSION."""


def wrap(raw: bytes, sequence: int, system: int = GROUND_SYSTEM, component: int = GROUND_COMPONENT) -> bytes:
    """Return the V2_EXTENSION frame that carries one whole frame; `sequence` is MAVLink's, of the outer frames.

    Raises ValueError if the frame is longer than the message's payload area.
    """
    if len(raw) > _MOST_INNER_BYTES:
        raise ValueError(f"{len(raw)} bytes in a V2_EXTENSION; allowed: at most {_MOST_INNER_BYTES}")
    payload = (_FIELDS.pack(MESSAGE_TYPE, 0, 0, 0) + raw).rstrip(b"\x00")
    head = _HEAD.pack(_MARKER, len(payload), 0, 0, sequence % 256, system, component, V2_EXTENSION_ID, 0)
    return head + payload + _checksum(head[1:] + payload)


def unwrap(raw: bytes) -> bytes | None:
    """Return the inner frame of one whole V2_EXTENSION frame of ours, None of anything else. Never raises.

    The outer frame's checksum is verified, its signature, if it has one, is not; nothing inside is looked at but the
    length.
    """
    if len(raw) < _FRAME_BYTES:
        return None
    marker, length, flags, _, _, _, _, low_id, high_id = _HEAD.unpack_from(raw)
    signature_bytes = _SIGNATURE_BYTES if flags & _FLAG_SIGNED else 0
    if marker != _MARKER or (low_id, high_id) != (V2_EXTENSION_ID, 0):
        return None
    end = _HEAD.size + length
    if len(raw) != _FRAME_BYTES + length + signature_bytes or raw[end : end + 2] != _checksum(raw[1:end]):
        return None
    return inner_of(raw[_HEAD.size : end])


def inner_of(payload: bytes) -> bytes | None:
    """Return the inner frame in the payload of a V2_EXTENSION, None if it is not one of ours. Never raises."""
    inner = payload[_FIELDS.size :]
    if payload[:2] != MESSAGE_TYPE.to_bytes(2, "little") or not inner or inner[0] != _MARKER:
        return None
    inner = inner.ljust(_FRAME_BYTES, b"\x00")
    inner_bytes = _FRAME_BYTES + inner[1] + (_SIGNATURE_BYTES if inner[2] & _FLAG_SIGNED else 0)
    return inner.ljust(inner_bytes, b"\x00") if len(inner) <= inner_bytes else None


def _checksum(covered: bytes) -> bytes:
    crc = x25crc(covered)
    crc.accumulate(bytes([V2_EXTENSION_CRC_EXTRA]))
    return int(crc.crc).to_bytes(2, "little")
