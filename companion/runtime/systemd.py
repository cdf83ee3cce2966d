"""Notifications to systemd (sd_notify(3)): that the service is ready, that its loop still runs, and what it does.

Only the setpoint loop feeds the watchdog, so that systemd restarts a program whose loop hangs while its threads go on.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from contextlib import suppress


class Notifier:
    """Sends notifications to systemd; does nothing in a program that systemd did not start."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._socket: socket.socket | None = None
        if address.startswith(("/", "@")):
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            # An abstract name begins with a zero byte, which the environment cannot hold.
            self._address = address.replace("@", "\0", 1) if address[0] == "@" else address

    def ready(self) -> None:
        """Tell systemd that links and files are open and the loop begins."""
        self._tell("READY=1")

    def alive(self) -> None:
        """Feed systemd's watchdog: the loop still runs."""
        self._tell("WATCHDOG=1")

    def status(self, line: str) -> None:
        """Tell systemd what the program does, in the line that `systemctl status` shows."""
        self._tell(f"STATUS={line}")

    def close(self) -> None:
        """Tell systemd that the program is ending, and close the socket."""
        self._tell("STOPPING=1")
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _tell(self, message: str) -> None:
        if self._socket is not None:
            with suppress(OSError):
                self._socket.sendto(message.encode(), self._address)
