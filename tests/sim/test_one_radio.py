"""One radio, in real time: the broadcast reaches the companion through its autopilot, inside V2_EXTENSION."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from sim.safety_pilot import HAND_OVER_S, SafetyPilot
from tests.ports import free_ports

pytestmark = pytest.mark.slow

PATIENCE_S = 60.0
MISSION = """
name: one-radio
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}]
targets: [{id: 1, north_m: 300, east_m: 0}]
defaults: {agent: {speed_m_s: 5, n_max: 0.15}, target: {speed_bound_m_s: 0}}
arrival_radius_m: 20
separation_m: 10
"""
CONFIG = """
agent_id: 1
autopilot: {{kind: arducopter, link: "udpin:127.0.0.1:{autopilot}"}}
broadcast: {{link: autopilot, trust: unsigned}}
limits: {{speed_m_s: 5, n_max: 0.15}}
height_m: 20
arrival_radius_m: 20
log_dir: {logs}
"""


def start(folder: Path, name: str, *arguments: str) -> subprocess.Popen[bytes]:
    with (folder / f"{name}.txt").open("w") as file:
        return subprocess.Popen(
            [sys.executable, "-m", name, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )


@pytest.fixture
def programs(tmp_path: Path) -> Iterator[tuple[Path, int]]:
    """Start the three programs; give the folder of what they say, and the port of the person's link."""
    autopilot, radio, pilot = free_ports(3)
    (tmp_path / "mission.yaml").write_text(MISSION)
    (tmp_path / "companion.yaml").write_text(CONFIG.format(autopilot=autopilot, logs=tmp_path / "logs"))
    running = [
        start(
            tmp_path, "sim", "vehicle", "--autopilot", "arducopter", "--in-air", "20",
            "--connect", f"udpout:127.0.0.1:{autopilot}", "--connect", f"udpin:127.0.0.1:{radio}",
            "--connect", f"udpin:127.0.0.1:{pilot}",
        ),
        start(tmp_path, "companion", "run", str(tmp_path / "companion.yaml")),
        start(
            tmp_path, "groundstation", "run", str(tmp_path / "mission.yaml"), "--unsigned",
            "--link", f"udpout:127.0.0.1:{radio}", "--radio", "sik-57600/v2ext",
        ),
    ]  # fmt: skip
    try:
        yield tmp_path, pilot
    finally:
        for process in running:
            process.send_signal(signal.SIGINT)
        for process in running:
            try:
                process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def wait_for(path: Path, text: str, meanwhile: Callable[[], None]) -> None:
    ends_s = time.monotonic() + PATIENCE_S
    while text not in path.read_text():
        assert time.monotonic() < ends_s, f"never said '{text}': {path.read_text()}"
        meanwhile()
        time.sleep(0.1)


def test_the_companion_steers_by_a_broadcast_that_only_its_autopilot_hears(programs: tuple[Path, int]) -> None:
    folder, port = programs
    safety_pilot, began_s = SafetyPilot("arducopter", 1), time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as pilot:
        pilot.connect(("127.0.0.1", port))

        def hand_over() -> None:
            # Its HEARTBEAT is not looked at: a mode change that was obeyed is only asked for again.
            for order in safety_pilot.orders(HAND_OVER_S + time.monotonic() - began_s, None):
                try:
                    pilot.send(order)
                except OSError:
                    return

        wait_for(folder / "companion.txt", "target 1 (assigned)", hand_over)
