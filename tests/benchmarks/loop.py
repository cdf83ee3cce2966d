"""How evenly setpoints leave `companion run` beside a busy core, seen from the receiving side, and how soon it starts.

    python tests/benchmarks/loop.py --autopilot arducopter --seconds 300

This script stands between the companion and `sim vehicle`, passes everything on, and notes when setpoints pass. It also
plays the safety pilot who chooses the guided mode, and it keeps one core busy. With --restart it kills the companion
once in flight and times how long the next one takes from its start to its first setpoint; with --stop SECONDS it
suspends the companion for that time instead.
"""

from __future__ import annotations

import argparse
import csv
import os
import selectors
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import numpy as np

from companion.autopilot.offboard import SETPOINT_IDS
from companion.protocol.frame import raw_frames
from sim.safety_pilot import SafetyPilot

HERE = "127.0.0.1"
NICED = "import os, sys; os.nice(%d); os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
BUSY = "import os\nos.sched_setaffinity(0, {%d})\nwhile True:\n    pass"
MISSION = """
name: loop
agents: [{id: 1, north_m: 0, east_m: 0}]
targets: [{id: 1, north_m: 4000, east_m: 500}]
threats:
  - {id: 1, north_m: 300, east_m: 0, detection_radius_m: 60, attack_radius_m: 20}
  - {id: 2, north_m: 700, east_m: 60, detection_radius_m: 80, attack_radius_m: 20}
  - {id: 3, north_m: 1300, east_m: 100, detection_radius_m: 60, attack_radius_m: 20}
defaults:
  agent: {speed_m_s: 8, n_max: 0.17, range_m: 20000}
  target: {speed_bound_m_s: 0}
  threat: {speed_bound_m_s: 0}
broadcast_period_s: 1
assignment_period_s: 4
arrival_radius_m: 30
separation_m: 15
"""
CONFIG = """
agent_id: 1
autopilot: {{kind: {kind}, link: "udpin:{here}:{autopilot}"{state}}}
broadcast: {{link: "udpin:{here}:{broadcast}", trust: unsigned}}
limits: {{speed_m_s: {speed}, n_max: 0.17, range_m: 20000, height_min_m: 3, height_max_m: 100}}
height_m: 30
separation_m: 15
arrival_radius_m: 30
log_dir: {logs}
"""
SPEEDS_M_S = {"arducopter": 8.0, "arduplane": 20.0, "px4-copter": 10.0, "px4-plane": 15.0}


def free_port() -> int:
    """Return a UDP port that was free a moment ago."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind((HERE, 0))
        return int(one.getsockname()[1])


class Between:
    """Passes datagrams between companion and vehicle, and notes when setpoints pass."""

    def __init__(self, companion_port: int, safety_pilot_port: int) -> None:
        self.vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.vehicle.bind((HERE, 0))
        self.companion = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.companion.connect((HERE, companion_port))
        self.safety_pilot = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.safety_pilot.connect((HERE, safety_pilot_port))
        self.vehicle_address: tuple[str, int] | None = None
        self.setpoints_s: list[float] = []
        self.custom_mode: int | None = None
        self._selector = selectors.DefaultSelector()
        for one in (self.vehicle, self.companion):
            one.setblocking(False)
            self._selector.register(one, selectors.EVENT_READ)

    @property
    def port(self) -> int:
        """UDP port that the vehicle sends to."""
        return int(self.vehicle.getsockname()[1])

    def pass_on(self, until_s: float) -> None:
        """Pass on all datagrams until `until_s` on the monotonic clock."""
        while (left_s := until_s - time.monotonic()) > 0.0:
            for key, _ in self._selector.select(left_s):
                try:
                    if key.fileobj is self.vehicle:
                        datagram, self.vehicle_address = self.vehicle.recvfrom(65_536)
                        self._note_mode(datagram)
                        self.companion.send(datagram)
                    else:
                        datagram = self.companion.recv(65_536)
                        self._note_setpoints(datagram)
                        if self.vehicle_address is not None:
                            self.vehicle.sendto(datagram, self.vehicle_address)
                except (BlockingIOError, ConnectionRefusedError):
                    continue

    def hand_over(self, safety_pilot: SafetyPilot, t_s: float) -> None:
        """Send the heartbeat and the orders of the safety pilot that are due."""
        for frame in [safety_pilot.heartbeat(), *safety_pilot.orders(t_s, self.custom_mode)]:
            with suppress(ConnectionRefusedError):
                self.safety_pilot.send(frame)

    def _note_setpoints(self, datagram: bytes) -> None:
        now_s = time.monotonic()
        for frame in raw_frames(datagram):
            if frame.version == 2 and frame.message_id in SETPOINT_IDS:
                self.setpoints_s.append(now_s)

    def _note_mode(self, datagram: bytes) -> None:
        for frame in raw_frames(datagram):
            if frame.version == 2 and frame.message_id == 0 and frame.component == 1:
                self.custom_mode = int.from_bytes(frame.payload[:4], "little")


def start(log: Path, *arguments: str, nice: int = 0) -> subprocess.Popen[bytes]:
    """Start one of the programs, with its output in a file."""
    if nice:
        arguments = ("-c", NICED % nice, *arguments)
    with log.open("ab") as file:
        environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
        return subprocess.Popen([sys.executable, *arguments], stdout=file, stderr=subprocess.STDOUT, env=environment)


def told(times_s: list[float], since_s: float) -> str:
    """Return statistics of the gaps between setpoints as text."""
    gaps_ms = 1e3 * np.diff(np.array([time_s for time_s in times_s if time_s >= since_s]))
    if not len(gaps_ms):
        return "no setpoints"
    p50, p99, p999 = np.percentile(gaps_ms, [50.0, 99.0, 99.9])
    return (
        f"{len(gaps_ms)} gaps: median {p50:.1f} ms, p99 {p99:.1f} ms, p99.9 {p999:.1f} ms, "
        f"max {gaps_ms.max():.1f} ms, over 500 ms: {int(np.sum(gaps_ms > 500.0))}"
    )


def main() -> None:
    """Run the programs and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--autopilot", choices=sorted(SPEEDS_M_S), default="arducopter")
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--idle", action="store_true", help="without the busy core")
    parser.add_argument("--restart", action="store_true")
    parser.add_argument("--stop", type=float, metavar="SECONDS")
    parser.add_argument("--nice", type=int, default=0, help="of the companion; the unit's is -10, which needs root")
    options = parser.parse_args()
    if options.nice:
        # The vehicle and this script stand for other computers.
        os.nice(options.nice - 1)
    kind = options.autopilot
    safety_pilot = SafetyPilot(kind, 1)
    companion_port, broadcast, safety_pilot_port, sensor = (free_port() for _ in range(4))
    between = Between(companion_port, safety_pilot_port)
    running: list[subprocess.Popen[bytes]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "mission.yaml").write_text(MISSION)
        state = f", state_file: {folder}/engaged.json" if kind.startswith("px4") else ""
        fields = {"kind": kind, "here": HERE, "autopilot": companion_port, "broadcast": broadcast, "state": state}
        (folder / "c.yaml").write_text(CONFIG.format(**fields, speed=SPEEDS_M_S[kind], logs=folder / "logs"))
        try:
            vehicle = start(
                folder / "vehicle.txt", "-m", "sim", "vehicle", "--autopilot", kind, "--in-air", "30",
                "--connect", f"udpout:{HERE}:{between.port}", "--connect", f"udpin:{HERE}:{safety_pilot_port}",
                "--sensor", f"udpout:{HERE}:{sensor}",
            )  # fmt: skip
            running.append(vehicle)
            running.append(
                start(
                    folder / "ground.txt",
                    "-m",
                    "groundstation",
                    "run",
                    str(folder / "mission.yaml"),
                    "--unsigned",
                    "--link",
                    f"udpout:{HERE}:{broadcast}",
                    "--sensor",
                    f"udpin:{HERE}:{sensor}",
                )  # fmt: skip
            )
            if not options.idle:
                running.append(
                    start(
                        folder / "busy.txt",
                        "-c",
                        BUSY % ((os.cpu_count() or 1) - 1),
                        nice=1 - options.nice if options.nice else 0,
                    )
                )
            companion = start(
                folder / "companion.txt",
                "-m",
                "companion",
                "run",
                str(folder / "c.yaml"),
                nice=1 if options.nice else 0,
            )
            running.append(companion)
            began_s = time.monotonic()
            while not (between.setpoints_s and safety_pilot.done and "target 1" in said(folder)):
                between.hand_over(safety_pilot, time.monotonic() - began_s)
                between.pass_on(time.monotonic() + 1.0)
                if time.monotonic() - began_s > 60.0:
                    raise SystemExit(f"never steered: {said(folder)}")
            steered_s = time.monotonic()
            between.pass_on(steered_s + options.seconds)
            print(f"{kind}, {'one idle' if options.idle else 'one busy'} core: {told(between.setpoints_s, steered_s)}")
            if options.stop is not None:
                stopped_s = time.monotonic()
                companion.send_signal(signal.SIGSTOP)
                between.pass_on(stopped_s + options.stop)
                last_s = between.setpoints_s[-1]
                companion.send_signal(signal.SIGCONT)
                between.pass_on(time.monotonic() + 3.0)
                after = [time_s for time_s in between.setpoints_s if time_s > stopped_s + options.stop]
                next_ms = f"{1e3 * (after[0] - stopped_s - options.stop):.0f} ms" if after else "never"
                print(
                    f"stopped for {options.stop:g} s: last setpoint {1e3 * (last_s - stopped_s):.0f} ms after, ", end=""
                )
                print(f"next {next_ms} after it went on")
            if options.restart:
                companion.kill()
                companion.wait()
                between.pass_on(time.monotonic() + 0.1)
                count, started_s, started_unix_s = len(between.setpoints_s), time.monotonic(), time.time()
                companion = start(
                    folder / "companion.txt",
                    "-m",
                    "companion",
                    "run",
                    str(folder / "c.yaml"),
                    nice=1 if options.nice else 0,
                )
                running.append(companion)
                while len(between.setpoints_s) == count and time.monotonic() - started_s < 10.0:
                    between.pass_on(time.monotonic() + 0.02)
                if len(between.setpoints_s) > count:
                    print(f"restarted: first setpoint {between.setpoints_s[count] - started_s:.2f} s after its start")
                between.pass_on(time.monotonic() + 2.0)
                print(f"decisions after its start: {reasons(folder, started_unix_s)}")
            companion.send_signal(signal.SIGINT)
            companion.wait(20.0)
            print(said(folder))
        finally:
            for process in running:
                process.kill()
                process.wait()


def reasons(folder: Path, since_unix_s: float) -> str:
    """Return when the newest run first decided for each reason, in seconds since a time."""
    newest = max((folder / "logs").iterdir())
    with (newest / "decisions-1.csv").open() as file:
        firsts = {row["reason"]: row["time_unix_s"] for row in reversed(list(csv.DictReader(file)))}
    ordered = sorted((float(time_s) - since_unix_s, reason) for reason, time_s in firsts.items())
    return ", ".join(f"{after_s:.2f} s {reason}" for after_s, reason in ordered)


def said(folder: Path) -> str:
    """Return the companion's output."""
    return (folder / "companion.txt").read_text()


if __name__ == "__main__":
    main()
