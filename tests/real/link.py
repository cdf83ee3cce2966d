"""A MAVLink link of the test pilot: a socket to one autopilot that is polled, never waited for."""

from __future__ import annotations

import select
import socket
import time
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

GROUND_CONTROL_SYSTEM = 255
HEARTBEAT_PERIOD_S = 0.5
_READ_BYTES = 65_536


class Link:
    """A link to one autopilot: what is heard is parsed, what is said carries the ids of a ground-control program."""

    def __init__(self, opened: socket.socket, component_id: int) -> None:
        """Speak on an open, connected or bound, socket."""
        opened.setblocking(False)
        self._socket = opened
        self._mav = mavlink.MAVLink(None, srcSystem=GROUND_CONTROL_SYSTEM, srcComponent=component_id)
        self._mav.robust_parsing = True
        self._next_heartbeat_s = 0.0
        self.encoder = self._mav
        """pymavlink's encoder, whose `*_encode` methods make the messages to say."""

    def poll(self) -> list[Any]:
        """Return the messages that have come, and say a heartbeat when it is due."""
        messages: list[Any] = []
        while select.select([self._socket], [], [], 0.0)[0]:
            try:
                data = self._socket.recv(_READ_BYTES)
            except OSError:
                break
            if not data:
                break
            messages += self._mav.parse_buffer(bytearray(data)) or []
        if time.monotonic() >= self._next_heartbeat_s:
            self._next_heartbeat_s = time.monotonic() + HEARTBEAT_PERIOD_S
            self.say(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
                )
            )
        return messages

    def say(self, message: Any) -> None:  # noqa: ANN401 - of the generated module, which carries no types
        """Send a message; where nobody listens yet it is lost."""
        frame = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        try:
            self._socket.send(frame)
        except OSError:
            return

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def tcp_link(port: int, component_id: int, patience_s: float = 30.0) -> Link:
    """Connect to a server on this computer, waiting until it listens; raise TimeoutError if it never does."""
    ends_s = time.monotonic() + patience_s
    while time.monotonic() < ends_s:
        try:
            return Link(socket.create_connection(("127.0.0.1", port), timeout=1.0), component_id)
        except OSError:
            time.sleep(0.2)
    raise TimeoutError(f"nobody listens on port {port}")


def udp_link_to(port: int, component_id: int) -> Link:
    """Return a link to a UDP port of this computer, which answers to where it is spoken to from."""
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.connect(("127.0.0.1", port))
    return Link(opened, component_id)


def udp_link_at(port: int, component_id: int) -> Link:
    """Return a link that hears what is sent to a UDP port of this computer; what it says goes nowhere."""
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind(("127.0.0.1", port))
    return Link(opened, component_id)
