"""Packs MAVLink messages as one system and component."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink


class MavlinkSender:
    """One sender: every message that it packs carries its ids and the next sequence number."""

    def __init__(self, system_id: int, component_id: int) -> None:
        """Begin at sequence number 0."""
        self.mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        """Whose `*_encode` methods make the messages."""

    def pack(self, message: Any) -> bytes:  # noqa: ANN401 - of the generated module, which carries no types
        """Return a message as a frame."""
        frame: bytes = message.pack(self.mav)
        self.mav.seq = (self.mav.seq + 1) % 256
        return frame
