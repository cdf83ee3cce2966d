"""Where the parts of a MAVLink frame lie: the one place that knows (mavlink.io, "Packet Serialization").

A log and a link must find the end of a frame without knowing what it says; whoever reads it finds its parts here too.
"""

from __future__ import annotations

MARKER_V1 = 0xFE
MARKER_V2 = 0xFD
HEADER_V1_BYTES = 6
HEADER_V2_BYTES = 10
CRC_BYTES = 2
SIGNATURE_BYTES = 13
"""Link id, 48-bit time and 48 bits of hash, behind the CRC of a signed MAVLink 2 frame."""
SIGNED_FLAG = 0x01
"""Of the incompatibility flags of MAVLink 2: the only one that is defined."""
MAX_PAYLOAD_BYTES = 255
MAX_FRAME_BYTES = HEADER_V2_BYTES + MAX_PAYLOAD_BYTES + CRC_BYTES + SIGNATURE_BYTES

LENGTH_AT = 1
FLAGS_AT = 2
"""MAVLink 2: incompatibility flags."""
HEAD_BYTES = FLAGS_AT + 1
"""As many bytes tell how long a frame is."""
SYSTEM_V1_AT, COMPONENT_V1_AT, MESSAGE_ID_V1_AT = 3, 4, 5
SYSTEM_AT, COMPONENT_AT, MESSAGE_ID_AT = 5, 6, 7
"""MAVLink 2; the message id has three bytes, the lowest first."""


def may_begin_frame(data: bytes, at: int) -> bool:
    """Return whether the bytes from `at` on, as many as are there, look like the beginning of a frame."""
    if data[at] != MARKER_V2:
        return data[at] == MARKER_V1
    return at + FLAGS_AT >= len(data) or not data[at + FLAGS_AT] & ~SIGNED_FLAG


def frame_length(data: bytes, at: int = 0) -> int | None:
    """Return how many bytes a frame that begins at a byte has; None if none begins there or its head is not whole."""
    if len(data) - at < HEAD_BYTES:
        return None
    payload_length = data[at + LENGTH_AT]
    if data[at] == MARKER_V1:
        return HEADER_V1_BYTES + payload_length + CRC_BYTES
    if data[at] != MARKER_V2:
        return None
    return HEADER_V2_BYTES + payload_length + CRC_BYTES + _signature_bytes(data[at + FLAGS_AT])


def frame_parts(data: bytes, at: int = 0) -> tuple[int, int, int, int]:
    """Return message id, where payload and CRC begin, and where it all ends, of a frame whose header is whole."""
    if data[at] == MARKER_V1:
        payload_at = at + HEADER_V1_BYTES
        crc_at = payload_at + data[at + LENGTH_AT]
        return data[at + MESSAGE_ID_V1_AT], payload_at, crc_at, crc_at + CRC_BYTES
    message_id = data[at + MESSAGE_ID_AT] | data[at + MESSAGE_ID_AT + 1] << 8 | data[at + MESSAGE_ID_AT + 2] << 16
    payload_at = at + HEADER_V2_BYTES
    crc_at = payload_at + data[at + LENGTH_AT]
    return message_id, payload_at, crc_at, crc_at + CRC_BYTES + _signature_bytes(data[at + FLAGS_AT])


def _signature_bytes(flags: int) -> int:
    return SIGNATURE_BYTES if flags & SIGNED_FLAG else 0
