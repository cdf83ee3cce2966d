"""The three programs as processes over UDP in real time: armed and put into GUIDED by a client, the copter arrives."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.tlog import read_tlog

PILOT = Path(__file__).parents[2] / "docs" / "examples" / "pilot.py"
PATIENCE_S = 90.0
MISSION = """
name: short-hop
agents: [{id: 1, north_m: 0, east_m: 0}]
targets: [{id: 1, north_m: 60, east_m: 20}]
defaults: {agent: {speed_m_s: 5, n_max: 0.25}, target: {speed_bound_m_s: 0}}
broadcast_period_s: 0.5
assignment_period_s: 2
arrival_radius_m: 10
separation_m: 10
"""
CONFIG = """
agent_id: 1
autopilot: {{kind: arducopter, link: "udpin:127.0.0.1:{autopilot}"}}
broadcast: {{link: "udpin:127.0.0.1:{broadcast}"}}
limits: {{speed_m_s: 5, n_max: 0.25, height_min_m: 3, height_max_m: 50}}
height_m: 8
separation_m: 10
arrival_radius_m: 10
guidance_step_s: 0.1
log_dir: {logs}
"""


def free_ports(count: int) -> list[int]:
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    try:
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [int(one.getsockname()[1]) for one in sockets]
    finally:
        for one in sockets:
            one.close()


class Program:
    """One of the programs as a process of its own, its lines gathered in a file."""

    def __init__(self, folder: Path, name: str, *arguments: str) -> None:
        self.output = folder / f"{name}.txt"
        with self.output.open("w") as file:
            self.process = subprocess.Popen(
                [sys.executable, "-m", name, *arguments],
                stdout=file,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PYTHONUNBUFFERED": "1"},
            )

    def says(self, text: str) -> bool:
        return text in self.output.read_text()

    def wait_for(self, text: str) -> None:
        patience_ends_s = time.monotonic() + PATIENCE_S
        while not self.says(text):
            assert self.process.poll() is None, f"ended early: {self.output.read_text()}"
            assert time.monotonic() < patience_ends_s, f"never said '{text}': {self.output.read_text()}"
            time.sleep(0.1)

    def end(self) -> int:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.process.wait(timeout=20)


@pytest.fixture
def programs(tmp_path: Path) -> Iterator[dict[str, Program]]:
    autopilot, pilot, broadcast, sensor = free_ports(4)
    (tmp_path / "mission.yaml").write_text(MISSION)
    logs = tmp_path / "logs"
    (tmp_path / "companion.yaml").write_text(CONFIG.format(autopilot=autopilot, broadcast=broadcast, logs=logs))
    running = {
        "sim": Program(
            tmp_path, "sim", "vehicle", "--autopilot", "arducopter", "--sensor", f"udpout:127.0.0.1:{sensor}",
            "--connect", f"udpout:127.0.0.1:{autopilot}", "--connect", f"udpin:127.0.0.1:{pilot}",
        ),
        "groundstation": Program(
            tmp_path, "groundstation", "run", str(tmp_path / "mission.yaml"),
            "--link", f"udpout:127.0.0.1:{broadcast}", "--sensor", f"udpin:127.0.0.1:{sensor}",
        ),
        "companion": Program(tmp_path, "companion", "run", str(tmp_path / "companion.yaml")),
    }  # fmt: skip
    try:
        running["companion"].wait_for("idle (not armed and in the guided mode), picture fresh")
        subprocess.run([sys.executable, str(PILOT), f"udpout:127.0.0.1:{pilot}", "8"], check=True, timeout=60)
        yield running
    finally:
        for program in running.values():
            if program.process.poll() is None:
                program.process.kill()
                program.process.wait(timeout=20)


def test_the_armed_copter_flies_to_its_target_and_the_ground_station_sees_it(
    programs: dict[str, Program], tmp_path: Path
) -> None:
    companion = programs["companion"]
    companion.wait_for("not in the air yet")
    companion.wait_for("target 1 (assigned)")
    programs["groundstation"].wait_for("reached [1], arrived [1]")
    companion.wait_for("loiter (no target)")
    assert [program.end() for program in programs.values()] == [0, 0, 0]
    assert sum(1 for _ in read_tlog(tmp_path / "logs" / "vehicle-1.tlog")) > 100
    assert sum(1 for _ in read_tlog(tmp_path / "logs" / "broadcast-1.tlog")) > 10
