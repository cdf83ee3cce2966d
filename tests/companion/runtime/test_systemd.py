"""What systemd is told, on a socket as systemd gives it."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from companion.runtime.systemd import Notifier


@pytest.mark.parametrize("abstract", [False, True])
def test_systemd_is_told_of_readiness_life_and_what_is_done(tmp_path: Path, abstract: bool) -> None:
    path = f"@oneway-{tmp_path.name}-{tmp_path.parent.name}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(path.replace("@", "\0"))
        systemd.settimeout(5.0)
        notifier = Notifier({"NOTIFY_SOCKET": path})
        notifier.ready()
        notifier.alive()
        notifier.status("idle")
        notifier.close()
        said = [systemd.recv(100) for _ in range(4)]
    assert said == [b"READY=1", b"WATCHDOG=1", b"STATUS=idle", b"STOPPING=1"]


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": ""}, {"NOTIFY_SOCKET": "/nowhere/at/all"}])
def test_without_systemd_nothing_happens(environment: dict[str, str]) -> None:
    notifier = Notifier(environment)
    notifier.ready()
    notifier.alive()
    notifier.close()
