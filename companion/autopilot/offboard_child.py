"""The process that holds MAVSDK: it steers by what its parent tells it, and ends when the parent stops ticking.

MAVSDK repeats the last setpoint for ever if the program around it hangs. So it lives in a process of its own, with an
alarm clock of the kernel's that every tick sets anew: when it rings the process is ended, whatever its threads do.
Every byte goes through the parent, which owns the one link to the autopilot. `offboard.py` beside this file is the
parent's side; this file imports nothing else of the companion, so that it is ready soon, and MAVSDK only in the child.
"""

from __future__ import annotations

import math
import os
import signal
import socket
import struct
import sys
from contextlib import suppress
from typing import Any

TICK_TIMEOUT_S = 0.5
"""Without a tick for this time nobody is at the controls."""
MESSAGE_BYTES = 65_536

# The first byte of each message between the two says what it is.
IDENTITY = b"I"
"""To the child: system and component id to speak as."""
RECEIVED = b"B"
"""To the child: bytes that the autopilot sent."""
TICK = b"T"
"""To the child: the parent is alive."""
SETPOINT = b"S"
"""To the child: velocity north, east, down in m/s, and yaw in rad."""
UP = b"U"
"""To the parent: MAVSDK is imported, what comes now is read."""
READY = b"R"
"""To the parent: the autopilot is known, setpoints can be sent."""
FRAME = b"F"
"""To the parent: bytes for the autopilot."""
IDENTITY_FIELDS = struct.Struct("<BB")
SETPOINT_FIELDS = struct.Struct("<4f")


class _Child:
    def __init__(self, parent: socket.socket) -> None:
        self._parent = parent
        self._mavsdk: Any = None
        self._offboard: Any = None

    def take(self, kind: bytes, content: bytes) -> None:
        if kind in (TICK, SETPOINT):
            signal.setitimer(signal.ITIMER_REAL, TICK_TIMEOUT_S)
        if kind == IDENTITY:
            self._begin(*IDENTITY_FIELDS.unpack(content))
        elif kind == RECEIVED and self._mavsdk is not None:
            self._mavsdk.pass_received_raw_bytes(content)
            self._look_for_autopilot()
        elif kind == SETPOINT and self._offboard is not None:
            north_m_s, east_m_s, down_m_s, yaw_rad = SETPOINT_FIELDS.unpack(content)
            velocity = offboard.VelocityNedYaw(north_m_s, east_m_s, down_m_s, math.degrees(yaw_rad))
            self._offboard.set_velocity_ned(velocity)

    def _begin(self, system_id: int, component_id: int) -> None:
        self._mavsdk = mavsdk.Mavsdk(mavsdk.Configuration.create_manual(system_id, component_id, False))
        self._mavsdk.add_any_connection("raw://")
        self._mavsdk.subscribe_raw_bytes_to_be_sent(lambda sent: self.tell(FRAME + sent))

    def _look_for_autopilot(self) -> None:
        if self._offboard is not None:
            return
        for system in self._mavsdk.get_systems():
            if system.has_autopilot():
                self._offboard = offboard.Offboard(system)
                self.tell(READY)
                return

    def tell(self, message: bytes) -> None:
        try:
            self._parent.send(message)
        except OSError:
            os._exit(1)


def main() -> None:
    """Serve the parent on the socket whose descriptor is the first argument, until it has gone."""
    # The default action ends the process within the kernel; a handler in Python would need a thread that runs.
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    # Ctrl-C at a terminal reaches the whole group, but the parent decides when this one ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.log_subscribe(lambda *_: True)
    parent = socket.socket(fileno=int(sys.argv[1]))
    child = _Child(parent)
    child.tell(UP)
    # Reset: the parent ended before it had read everything.
    with suppress(ConnectionResetError):
        while message := parent.recv(MESSAGE_BYTES):
            child.take(message[:1], message[1:])
    # Past MAVSDK's own ending, which waits for its threads.
    os._exit(0)


if __name__ == "__main__":
    import mavsdk
    from mavsdk import logging
    from mavsdk.plugins import offboard

    main()
