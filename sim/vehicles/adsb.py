"""A vehicle's ADS-B receiver: what its autopilot passes on of the aircraft that it hears (docs/autopilots.md).

PX4 passes on each at once. ArduPilot keeps a list, and sends it only on links that ask for ADSB_VEHICLE: one entry each
time that the message is due, and the list again after a second at the earliest.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from typing import NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from sim.mavlink_sender import MavlinkSender
from sim.vehicles.craft import Craft, Message

LIST_PERIOD_S = 1.0
"""Least time between two beginnings of ArduPilot's list (ArduPilot's source)."""
FORGOTTEN_AFTER_S = 5.0
"""Time after which ArduPilot drops an aircraft that is not heard any more (ArduPilot's source)."""
ADSB_TYPE = "ADSB_TYPE"
"""ArduPilot's parameter that says which receiver is mounted; 0: none."""


class _Contact(NamedTuple):
    message: Message
    heard_s: float


class AdsbReceiver:
    """The receiver of one vehicle and its autopilot's list."""

    def __init__(self, craft: Craft, sender: MavlinkSender) -> None:
        """Hear for the vehicle of `craft`, and pack what is listed by `sender`."""
        self._craft = craft
        self._sender = sender
        self._contacts: dict[int, _Contact] = {}
        """By ICAO address, in the order in which they were first heard."""
        self._waiting: list[int] = []
        self._began_s = -math.inf

    def hear(self, frames: Sequence[bytes], t_s: float) -> list[bytes]:
        """Hear ADSB_VEHICLE frames at a time; return those that the autopilot passes on at once."""
        if not self._craft.lists_adsb:
            own = self._sender.mav.srcSystem
            return [out for frame in frames for out in ([frame] if _system(frame) == own else self._packed(frame))]
        if self._craft.values.get(ADSB_TYPE, 0.0) == 0.0:
            return []
        for frame in frames:
            for message in _contacts_in(frame):
                self._contacts[message.ICAO_address] = _Contact(message, t_s)
        return []

    def _packed(self, frame: bytes) -> list[bytes]:
        return [self._sender.pack(message) for message in _contacts_in(frame)]

    def next_listed(self, t_s: float) -> bytes | None:
        """Return the frame of the list's next entry, None if nothing is due: the message is due on a link."""
        if not self._waiting:
            if t_s - self._began_s < LIST_PERIOD_S:
                return None
            known = self._contacts.items()
            self._contacts = {key: one for key, one in known if t_s - one.heard_s <= FORGOTTEN_AFTER_S}
            self._waiting = list(reversed(self._contacts))
            self._began_s = t_s
        if not self._waiting:
            return None
        contact = self._contacts.get(self._waiting.pop())
        if contact is None:
            return None
        message = copy.copy(contact.message)
        message.tslc = int(t_s - contact.heard_s)
        return self._sender.pack(message)


def _system(frame: bytes) -> int | None:
    """Return the system id of a MAVLink 2 frame; None if it is shorter than its header."""
    return frame[5] if len(frame) > 5 else None


def _contacts_in(frame: bytes) -> list[Message]:
    """Return the ADSB_VEHICLE messages in bytes of any kind."""
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    return [message for message in parser.parse_buffer(frame) or () if message.get_type() == "ADSB_VEHICLE"]
