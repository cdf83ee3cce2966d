"""Packs MAVLink messages into frames of one system and component."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink


class MavlinkSender:
    """A sender of MAVLink frames: each one has the sender's ids and its next sequence number."""

    def __init__(self, system_id: int, component_id: int) -> None:
        """Begin at sequence number 0."""
        self.mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        """pymavlink's encoder, whose `*_encode` methods make the messages to pack."""

    def pack(self, message: Any) -> bytes:  # noqa: ANN401 - of the generated module, which carries no types
        """Return a message as a frame, with the next sequence number."""
        frame: bytes = message.pack(self.mav)
        self.mav.seq = (self.mav.seq + 1) % 256
        return frame
