"""The child process that runs MAVSDK: it sends the setpoints that its parent wants, and ends when the parent hangs.

MAVSDK repeats the last setpoint for ever if the program around it hangs. So it runs in a process of its own with a
kernel timer that every tick of the parent restarts: when the timer expires, the kernel ends the process, whatever its
threads do. All bytes go through the parent (`offboard.py`), which owns the only link to the autopilot. This file
imports nothing else of the companion, so that the child starts quickly, and imports MAVSDK only in the child.
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
"""Time without a tick after which the parent counts as hung: the child ends, and its setpoints are not passed on."""
MESSAGE_BYTES = 65_536
"""Greatest size of a message between parent and child."""

# The first byte of a message between parent and child is its type.
IDENTITY = b"I"
"""Type of the message to the child with the system and component id that it sends with."""
RECEIVED = b"B"
"""Type of the message to the child with bytes that the autopilot sent."""
TICK = b"T"
"""Type of the message to the child that says that the parent is alive."""
SETPOINT = b"S"
"""Type of the message to the child with the wanted velocity north, east, down in m/s and yaw in rad; also a tick."""
UP = b"U"
"""Type of the message to the parent that says that MAVSDK is imported and the child reads."""
READY = b"R"
"""Type of the message to the parent that says that the autopilot is found and setpoints can be sent."""
FRAME = b"F"
"""Type of the message to the parent with bytes for the autopilot."""
IDENTITY_FIELDS = struct.Struct("<BB")
"""Layout of IDENTITY after its type."""
SETPOINT_FIELDS = struct.Struct("<4f")
"""Layout of SETPOINT after its type."""


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
    """Serve the parent on the socket whose descriptor is the first argument, until the parent closes it."""
    # The default action ends the process in the kernel; a Python handler would need a running thread.
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    # Ctrl-C at a terminal reaches the whole process group, but the parent decides when this process ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.log_subscribe(lambda *_: True)
    parent = socket.socket(fileno=int(sys.argv[1]))
    child = _Child(parent)
    child.tell(UP)
    # The connection is reset when the parent ended before it had read everything.
    with suppress(ConnectionResetError):
        while message := parent.recv(MESSAGE_BYTES):
            child.take(message[:1], message[1:])
    # Exit without MAVSDK's own shutdown, which waits for its threads.
    os._exit(0)


if __name__ == "__main__":
    import mavsdk
    from mavsdk import logging
    from mavsdk.plugins import offboard

    main()
