"""The three programs as processes over UDP in real time: armed and put into GUIDED by a client, the copter arrives."""

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
from click.testing import CliRunner
from pymavlink.dialects.v20 import common

from companion.files.tlog import read_tlog
from companion.geo.local_frame import LocalFrame
from companion.onboard.config import parse_config
from companion.onboard.replay import replay
from groundstation.cli import cli
from tests.ports import free_ports

pytestmark = pytest.mark.slow

PILOT = Path(__file__).parents[2] / "docs" / "examples" / "pilot.py"
PATIENCE_S = 90.0
MISSION = """
name: short-hop
agents: [{id: 1, north_m: 0, east_m: 0}]
targets: [{id: 1, north_m: 60, east_m: 20}]
defaults: {agent: {speed_m_s: 5, n_max: 0.25, height_m: 8}, target: {speed_bound_m_s: 0}}
broadcast_period_s: 0.5
assignment_period_s: 2
arrival_radius_m: 10
separation_m: 10
guidance_step_s: 0.1
integration_step_s: 0.1
"""
CONFIG = """
agent_id: 1
autopilot: {{kind: arducopter, link: "udpin:127.0.0.1:{autopilot}"}}
broadcast: {{link: "udpin:127.0.0.1:{broadcast}", trust: unsigned}}
limits: {{speed_m_s: 5, n_max: 0.25, height_min_m: 3, height_max_m: 50}}
height_m: 8
separation_m: 10
arrival_radius_m: 10
guidance_step_s: 0.1
log_dir: {logs}
"""


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

    def wait_for(self, text: str, meanwhile: Callable[[], None] = lambda: None) -> None:
        patience_ends_s = time.monotonic() + PATIENCE_S
        while not self.says(text):
            assert self.process.poll() is None, f"ended early: {self.output.read_text()}"
            assert time.monotonic() < patience_ends_s, f"never said '{text}': {self.output.read_text()}"
            meanwhile()
            time.sleep(0.1)

    def end(self) -> int:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.process.wait(timeout=20)


FLEET = """
vehicles:
  - id: 1
    kind: arducopter
    home: {{lat_deg: 47.0, lon_deg: 8.0}}
    speed_m_s: 5
    autopilot_link: "udpin:127.0.0.1:{autopilot}"
    broadcast_link: "udpin:127.0.0.1:{broadcast}"
    logs: {logs}
    config: {{limits: {{height_min_m: 3, height_max_m: 50}}}}
"""
REPORTING = """
uplink: {{link: "udpout:127.0.0.1:{uplink}"}}
report_period_s: 0.2
"""


def put_to_rest(running: dict[str, Program]) -> None:
    """Kill whatever of the programs still runs."""
    for program in running.values():
        if program.process.poll() is None:
            program.process.kill()
            program.process.wait(timeout=20)


@pytest.fixture
def programs(tmp_path: Path) -> Iterator[dict[str, Program]]:
    autopilot, pilot, broadcast, sensor = free_ports(4)
    (tmp_path / "mission.yaml").write_text(MISSION)
    logs = tmp_path / "logs"
    (tmp_path / "fleet.yaml").write_text(FLEET.format(autopilot=autopilot, broadcast=broadcast, logs=logs))
    fleet = ["fleet", str(tmp_path / "mission.yaml"), "--fleet", str(tmp_path / "fleet.yaml"), "--unsigned"]
    CliRunner().invoke(cli, [*fleet, "--out", str(tmp_path / "fleet")], catch_exceptions=False)
    running = {
        "sim": Program(
            tmp_path, "sim", "vehicle", "--autopilot", "arducopter", "--sensor", f"udpout:127.0.0.1:{sensor}",
            "--connect", f"udpout:127.0.0.1:{autopilot}", "--connect", f"udpin:127.0.0.1:{pilot}",
        ),
        "groundstation": Program(
            tmp_path, "groundstation", "run", str(tmp_path / "mission.yaml"), "--unsigned",
            "--link", f"udpout:127.0.0.1:{broadcast}", "--sensor", f"udpin:127.0.0.1:{sensor}",
        ),
        "companion": Program(tmp_path, "companion", "run", str(tmp_path / "fleet" / "vehicle-1" / "1.yaml")),
    }  # fmt: skip
    try:
        running["companion"].wait_for("idle (not armed and in the guided mode), picture fresh")
        subprocess.run([sys.executable, str(PILOT), f"udpout:127.0.0.1:{pilot}", "8"], check=True, timeout=60)
        yield running
    finally:
        put_to_rest(running)


@pytest.fixture
def unseen(tmp_path: Path) -> Iterator[tuple[dict[str, Program], int]]:
    """Start ground station and companion of a Case II mission, an uplink between them; give the autopilot's port."""
    autopilot, broadcast, uplink = free_ports(3)
    # So far that without a report nobody could be reckoned to be there.
    far_away = MISSION.replace("north_m: 60,", "north_m: 6000,")
    (tmp_path / "mission.yaml").write_text(f"{far_away}case: II\nreport_period_s: 0.2\n")
    config = CONFIG.format(autopilot=autopilot, broadcast=broadcast, logs=tmp_path / "logs")
    (tmp_path / "companion.yaml").write_text(config + REPORTING.format(uplink=uplink))
    running = {
        "groundstation": Program(
            tmp_path, "groundstation", "run", str(tmp_path / "mission.yaml"), "--unsigned", "--autopilot", "arducopter",
            "--link", f"udpout:127.0.0.1:{broadcast}", "--uplink", f"udpin:127.0.0.1:{uplink}",
        ),
        "companion": Program(tmp_path, "companion", "run", str(tmp_path / "companion.yaml")),
    }  # fmt: skip
    try:
        yield running, autopilot
    finally:
        put_to_rest(running)


class Autopilot:
    """An autopilot that is somewhere and says so, in the hands of a person."""

    def __init__(self, port: int, north_m: float, east_m: float) -> None:
        self._peer = ("127.0.0.1", port)
        self._place_deg = LocalFrame(47.0, 8.0).to_global(north_m, east_m)
        self._booted_s = time.monotonic()
        self._mav = common.MAVLink(None, srcSystem=1, srcComponent=common.MAV_COMP_ID_AUTOPILOT1)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def speak(self) -> None:
        lat_e7, lon_e7 = (round(degrees * 1e7) for degrees in self._place_deg)
        boot_ms = round(1000.0 * (time.monotonic() - self._booted_s))
        for message in (
            common.MAVLink_heartbeat_message(2, common.MAV_AUTOPILOT_ARDUPILOTMEGA, 1, 0, 4, 3),
            common.MAVLink_global_position_int_message(boot_ms, lat_e7, lon_e7, 508_000, 8_000, 0, 0, 0, 0),
        ):
            self._socket.sendto(bytes(message.pack(self._mav)), self._peer)

    def close(self) -> None:
        self._socket.close()


def test_an_agent_that_nobody_sees_reports_that_it_has_arrived(unseen: tuple[dict[str, Program], int]) -> None:
    running, port = unseen
    autopilot, ground = Autopilot(port, 6_000.0, 20.0), running["groundstation"]
    try:
        ground.wait_for("case II, sensor none, uplink udpin:127.0.0.1:")
        assert not ground.says("reached [1]")
        ground.wait_for("reached [1], arrived [1]", autopilot.speak)
        assert not ground.says("lost [1]")
    finally:
        autopilot.close()
    assert [program.end() for program in running.values()] == [0, 0]


def test_the_armed_copter_flies_to_its_target_and_the_ground_station_sees_it(
    programs: dict[str, Program], tmp_path: Path
) -> None:
    companion = programs["companion"]
    companion.wait_for("not in the air yet")
    companion.wait_for("target 1 (assigned)")
    programs["groundstation"].wait_for("reached [1], arrived [1]")
    companion.wait_for("loiter (no target)")
    assert [program.end() for program in programs.values()] == [0, 0, 0]
    (folder,) = (tmp_path / "logs").iterdir()
    assert sum(1 for _ in read_tlog(folder / "broadcast-1.tlog")) > 10
    config = parse_config((folder / "companion-1.yaml").read_text(), "companion-1.yaml")
    again = list(replay(read_tlog(folder / "vehicle-1.tlog"), config))
    assert len(again) > 100
    assert all(one.same for one in again)
