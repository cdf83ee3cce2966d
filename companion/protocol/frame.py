"""One raw MAVLink frame, parsed once, so that no other module has to measure its bytes again."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

from companion.files.mavlink_layout import (
    COMPONENT_AT,
    COMPONENT_V1_AT,
    CRC_BYTES,
    FLAGS_AT,
    HEADER_V1_BYTES,
    HEADER_V2_BYTES,
    LENGTH_AT,
    MARKER_V2,
    MESSAGE_ID_AT,
    MESSAGE_ID_V1_AT,
    SIGNED_FLAG,
    SYSTEM_AT,
    SYSTEM_V1_AT,
)
from companion.files.tlog import whole_frames
from companion.protocol.dialect import oneway

ED25519_BYTES = 64
"""Length of the signature inside a broadcast message, after its content (`ed25519.py`)."""
_STAMP = struct.Struct("<III")
"""Epoch, time and sequence, with which the payload of every broadcast message begins."""


class FrameStamp(NamedTuple):
    """The broadcast to which a frame belongs, and the frame's time: epoch_s + time_ms / 1000 in Unix seconds."""

    epoch_s: int
    time_ms: int
    sequence: int

    @property
    def unix_s(self) -> float:
        """Time of the frame by the sender's clock, in Unix seconds."""
        return self.epoch_s + self.time_ms / 1000.0


class RawFrame(NamedTuple):
    """A whole MAVLink frame of version 1 or 2: its bytes and the values of its header. `raw_frame` makes it."""

    data: bytes
    """The whole frame, signature included."""
    version: int
    """MAVLink version, 1 or 2."""
    system: int
    component: int
    message_id: int
    header_bytes: int
    payload_length: int
    """Number of payload bytes in the frame, which may lack the payload's trailing zeros."""
    is_signed: bool
    """Whether a MAVLink signature follows the CRC."""

    @property
    def sender(self) -> tuple[int, int]:
        """System and component id of the sender."""
        return self.system, self.component

    @property
    def payload(self) -> bytes:
        """The payload as sent, without the trailing zeros that were cut."""
        return self.data[self.header_bytes : self.header_bytes + self.payload_length]

    @property
    def crc_at(self) -> int:
        """Offset of the CRC, which covers all bytes before it but the first."""
        return self.header_bytes + self.payload_length

    @property
    def signature(self) -> bytes:
        """The 13 bytes of MAVLink signature after the CRC; empty if the frame is not signed."""
        return self.data[self.crc_at + CRC_BYTES :]

    @property
    def content_length(self) -> int:
        """Length of a broadcast message's content, including zeros that were cut; KeyError for any other message."""
        head_bytes, is_packed = _LAYOUTS[self.message_id]
        if not is_packed or self.payload_length < head_bytes:
            return head_bytes
        return head_bytes + self.data[self.header_bytes + head_bytes - 1]

    @property
    def signed_content(self) -> bytes:
        """System, component, message id and content of a broadcast message, with the content's cut zeros restored."""
        length = self.content_length
        end = HEADER_V2_BYTES + min(length, self.payload_length)
        return self.data[SYSTEM_AT:end].ljust(HEADER_V2_BYTES - SYSTEM_AT + length, b"\0")

    @property
    def stamp(self) -> FrameStamp:
        """Epoch, time and sequence of a broadcast message."""
        if self.payload_length < _STAMP.size:
            return FrameStamp(*_STAMP.unpack(self.payload.ljust(_STAMP.size, b"\0")))
        return FrameStamp(*_STAMP.unpack_from(self.data, self.header_bytes))

    def head_for(self, payload_length: int) -> bytes:
        """Return the header of this MAVLink 2 frame for a payload of another length."""
        return bytes((MARKER_V2, payload_length)) + self.data[FLAGS_AT:HEADER_V2_BYTES]


def raw_frame(data: bytes) -> RawFrame:
    """Return the parsed frame; the caller must know that the bytes are exactly one whole frame (`frame_length`)."""
    if data[0] == MARKER_V2:
        message_id = data[MESSAGE_ID_AT] | data[MESSAGE_ID_AT + 1] << 8 | data[MESSAGE_ID_AT + 2] << 16
        signed = data[FLAGS_AT] & SIGNED_FLAG != 0
        system, component = data[SYSTEM_AT], data[COMPONENT_AT]
        return RawFrame(data, 2, system, component, message_id, HEADER_V2_BYTES, data[LENGTH_AT], signed)
    system, component = data[SYSTEM_V1_AT], data[COMPONENT_V1_AT]
    return RawFrame(data, 1, system, component, data[MESSAGE_ID_V1_AT], HEADER_V1_BYTES, data[LENGTH_AT], False)


def raw_frames(datagram: bytes) -> Iterator[RawFrame]:
    """Yield the whole frames that a datagram consists of, up to the first bytes that begin no frame."""
    return map(raw_frame, whole_frames(datagram))


def head_v2(payload_length: int, sequence: int, sender: tuple[int, int], message_id: int) -> bytes:
    """Return the header of a MAVLink 2 frame without a signature; `sender` is system and component."""
    return bytes((MARKER_V2, payload_length, 0, 0, sequence, *sender)) + message_id.to_bytes(3, "little")


def crc_bytes(head_and_payload: bytes, crc_extra: bytes) -> bytes:
    """Return the two CRC bytes of a frame, given its bytes up to its payload's end and its message's CRC_EXTRA."""
    crc: int = oneway.x25crc(head_and_payload[1:] + crc_extra).crc
    return crc.to_bytes(CRC_BYTES, "little")


def crc_holds(data: bytes, at: int, crc_at: int, crc_extra: bytes) -> bool:
    """Return whether the CRC at `crc_at` is that of the frame that begins at `at`; `data` reaches to the CRC's end."""
    return bool(data[crc_at] | data[crc_at + 1] << 8 == oneway.x25crc(data[at + 1 : crc_at] + crc_extra).crc)


class _Layout(NamedTuple):
    """End of a message's content: at `head_bytes` or, if packed, after the data whose size the last head byte gives."""

    head_bytes: int
    is_packed: bool


def _layout(kind: type[oneway.MAVLink_message]) -> _Layout | None:
    """Return the layout of a broadcast message, None for any other message."""
    fields = kind.ordered_fieldnames
    if fields[-1] == "ed25519_signature":
        return _Layout(kind.unpacker.size - ED25519_BYTES, False)
    if fields[-2:] == ["size", "data"]:
        return _Layout(kind.unpacker.size - kind.array_lengths[-1], True)
    return None


_LAYOUTS: dict[int, _Layout] = {
    number: layout for number, kind in oneway.mavlink_map.items() if (layout := _layout(kind)) is not None
}
BROADCAST_IDS = frozenset(_LAYOUTS)
"""Ids of the messages that the ground station broadcasts; each begins with epoch, time and sequence and has room for
an Ed25519 signature."""
