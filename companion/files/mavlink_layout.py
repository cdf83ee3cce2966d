"""Lengths and offsets of the parts of a MAVLink frame, version 1 or 2 (mavlink.io, "Packet Serialization").

They stand in this module only. A log and a link find the end of a frame with it without decoding the message; what
decodes a message finds its parts with it.
"""

from __future__ import annotations

import binascii

MARKER_V1 = 0xFE
MARKER_V2 = 0xFD
HEADER_V1_BYTES = 6
HEADER_V2_BYTES = 10
CRC_BYTES = 2
SIGNATURE_BYTES = 13
"""Length of the signature behind the CRC of a signed MAVLink 2 frame: link id, 48-bit time and 48 bits of hash."""
SIGNED_FLAG = 0x01
"""Incompatibility flag of a signed MAVLink 2 frame; the standard defines no other."""
OVERHEAD_BYTES = HEADER_V2_BYTES + CRC_BYTES
"""Bytes of an unsigned MAVLink 2 frame beside its payload."""
MAX_PAYLOAD_BYTES = 255
MAX_FRAME_BYTES = HEADER_V2_BYTES + MAX_PAYLOAD_BYTES + CRC_BYTES + SIGNATURE_BYTES

LENGTH_AT = 1
"""Offset of the payload's length, in both versions."""
FLAGS_AT = 2
"""Offset of the incompatibility flags of MAVLink 2."""
HEAD_BYTES = FLAGS_AT + 1
"""Number of first bytes that tell the length of a frame."""
SEQUENCE_V1_AT, SYSTEM_V1_AT, COMPONENT_V1_AT, MESSAGE_ID_V1_AT = 2, 3, 4, 5
"""Offsets in a MAVLink 1 frame; the message id has one byte."""
SEQUENCE_AT, SYSTEM_AT, COMPONENT_AT, MESSAGE_ID_AT = 4, 5, 6, 7
"""Offsets in a MAVLink 2 frame; the message id has three bytes, the lowest first."""


def may_begin_frame(data: bytes, at: int) -> bool:
    """Return whether a frame may begin at offset `at`: a marker is there, and no undefined flag so far."""
    if data[at] != MARKER_V2:
        return data[at] == MARKER_V1
    return at + FLAGS_AT >= len(data) or not data[at + FLAGS_AT] & ~SIGNED_FLAG


def frame_length(data: bytes, at: int = 0) -> int | None:
    """Return the length of the frame that begins at offset `at`; None if none does or HEAD_BYTES are not there yet."""
    if len(data) - at < HEAD_BYTES:
        return None
    payload_length = data[at + LENGTH_AT]
    if data[at] == MARKER_V1:
        return HEADER_V1_BYTES + payload_length + CRC_BYTES
    if data[at] != MARKER_V2:
        return None
    return HEADER_V2_BYTES + payload_length + CRC_BYTES + _signature_bytes(data[at + FLAGS_AT])


def frame_parts(data: bytes, at: int = 0) -> tuple[int, int, int, int]:
    """Return message id and the offsets of payload, CRC and end of the frame at offset `at`, whose header is whole."""
    if data[at] == MARKER_V1:
        payload_at = at + HEADER_V1_BYTES
        crc_at = payload_at + data[at + LENGTH_AT]
        return data[at + MESSAGE_ID_V1_AT], payload_at, crc_at, crc_at + CRC_BYTES
    message_id = data[at + MESSAGE_ID_AT] | data[at + MESSAGE_ID_AT + 1] << 8 | data[at + MESSAGE_ID_AT + 2] << 16
    payload_at = at + HEADER_V2_BYTES
    crc_at = payload_at + data[at + LENGTH_AT]
    return message_id, payload_at, crc_at, crc_at + CRC_BYTES + _signature_bytes(data[at + FLAGS_AT])


def crc_extra_of(frame: bytes) -> int | None:
    """Return the CRC_EXTRA with which a whole frame's CRC is right; None if it is wrong with every one.

    So the CRC of a message that no table knows can be checked: bytes that are no frame have one in 256 times.
    """
    _, _, crc_at, _ = frame_parts(frame)
    # CRC-16/MCRF4XX is CRC-CCITT with the bits of every byte, and of the result, in the other order.
    mirrored = binascii.crc_hqx(frame[1:crc_at].translate(_MIRRORED), 0xFFFF)
    crc = _MIRRORED[mirrored >> 8] | _MIRRORED[mirrored & 0xFF] << 8
    step = _STEPS.get((frame[crc_at] | frame[crc_at + 1] << 8) ^ crc >> 8)
    return None if step is None else step ^ crc & 0xFF


def _crc_step(byte: int) -> int:
    """Return what the CRC gets from one more byte, which its lower half is already combined with."""
    byte = (byte ^ byte << 4) & 0xFF
    return byte << 8 ^ byte << 3 ^ byte >> 4


_MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_STEPS = {_crc_step(byte): byte for byte in range(256)}


def _signature_bytes(flags: int) -> int:
    return SIGNATURE_BYTES if flags & SIGNED_FLAG else 0
