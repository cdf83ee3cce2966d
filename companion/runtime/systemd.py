"""What systemd is told: that the service is ready, that its loop still runs, and what it does (sd_notify(3)).

The watchdog is fed by the setpoint loop alone, so that a hung loop is restarted even while other threads go on.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from contextlib import suppress


class Notifier:
    """Tells systemd, or nobody where the program was not started by it."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._socket: socket.socket | None = None
        if address.startswith(("/", "@")):
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            # An abstract name begins with a zero byte, which the environment cannot hold.
            self._address = address.replace("@", "\0", 1) if address[0] == "@" else address

    def ready(self) -> None:
        """Say that everything is open and the loop begins."""
        self._tell("READY=1")

    def alive(self) -> None:
        """Feed the watchdog."""
        self._tell("WATCHDOG=1")

    def status(self, line: str) -> None:
        """Say what the program does, for `systemctl status`."""
        self._tell(f"STATUS={line}")

    def close(self) -> None:
        """Say that the program is ending, and free the socket."""
        self._tell("STOPPING=1")
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _tell(self, message: str) -> None:
        if self._socket is not None:
            with suppress(OSError):
                self._socket.sendto(message.encode(), self._address)
