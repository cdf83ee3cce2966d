"""One raw frame, parsed once: who takes it from here on asks it, and measures no bytes again."""

from __future__ import annotations

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


class RawFrame(NamedTuple):
    """A whole MAVLink frame of either version: its bytes and what its header says. `raw_frame` makes it."""

    data: bytes
    """The whole frame, signature included."""
    version: int
    """1 or 2."""
    system: int
    component: int
    message_id: int
    header_bytes: int
    payload_length: int
    """Bytes of payload that are there: trailing zeros may have been cut."""
    is_signed: bool
    """Whether a MAVLink signature follows the CRC."""

    @property
    def sender(self) -> tuple[int, int]:
        """System and component."""
        return self.system, self.component

    @property
    def payload(self) -> bytes:
        """The payload, without the trailing zeros that were cut."""
        return self.data[self.header_bytes : self.header_bytes + self.payload_length]

    @property
    def signature(self) -> bytes:
        """The 13 bytes of MAVLink signature behind the CRC; empty without one."""
        return self.data[self.header_bytes + self.payload_length + CRC_BYTES :]


def raw_frame(data: bytes) -> RawFrame:
    """Return the value of a whole frame's bytes; what they are must be known to be one frame (`frame_length`)."""
    if data[0] == MARKER_V2:
        message_id = data[MESSAGE_ID_AT] | data[MESSAGE_ID_AT + 1] << 8 | data[MESSAGE_ID_AT + 2] << 16
        signed = bool(data[FLAGS_AT] & SIGNED_FLAG)
        system, component = data[SYSTEM_AT], data[COMPONENT_AT]
        return RawFrame(data, 2, system, component, message_id, HEADER_V2_BYTES, data[LENGTH_AT], signed)
    system, component = data[SYSTEM_V1_AT], data[COMPONENT_V1_AT]
    return RawFrame(data, 1, system, component, data[MESSAGE_ID_V1_AT], HEADER_V1_BYTES, data[LENGTH_AT], False)
