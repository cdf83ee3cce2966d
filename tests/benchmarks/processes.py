"""Flies a mission in real time with every program as a process of its own, and judges the result.

The ground station, and one companion and one stand-in per agent, talk over the loopback interface, with the broadcast
by multicast. This program plays everything around them: the world, the ground station's sensor, the ADS-B receivers on
board, the safety pilot who hands the vehicles over, and the judge, who knows about the vehicles only what their
autopilots send.

Run: python tests/benchmarks/processes.py paper-dynamic arduplane --scale --seed 1 --out DIR
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from companion.autopilot.kinds import CRUISE_M_S
from companion.files.tlog import read_tlog
from companion.files.yaml import dump_yaml
from companion.geo.local_frame import LocalFrame, to_grid
from companion.mission.model import Mission, dump_mission, load_mission
from companion.mission.resolve import resolve
from companion.onboard.config import config_for_agent
from companion.protocol.codec import Detection, Kind
from sim.arrivals import Arrivals
from sim.detector import Detector, Fleet
from sim.safety_pilot import SafetyPilot
from sim.scaling import scaled
from sim.score import score
from sim.sensor import LOOK_PERIOD_S, mission_sensor, world_detections
from sim.trajectory import TrajectoryBuilder
from sim.world import World

GROUP = "239.255.77.66"
TICK_S = 0.02
READY_S = 240.0
"""Longest time that the programs may take to start, all at once on a small machine."""
HEARTBEAT_PERIOD_S = 1.0
GAP_S = 0.5
"""Longest gap between two setpoints that passes."""
ENGAGED_GAP_S = 5.0
"""Least gap between two setpoints that counts as the end of one engagement and the start of another."""
_SETPOINTS = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
        mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
        mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
    }
)
_HEARD = frozenset({mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT})
_CLOCK_TICKS = os.sysconf("SC_CLK_TCK")


def free_ports(count: int) -> list[int]:
    """Return UDP ports that were free a moment ago."""
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    for one in sockets:
        one.bind(("127.0.0.1", 0))
    ports = [int(one.getsockname()[1]) for one in sockets]
    for one in sockets:
        one.close()
    return ports


class Program:
    """One child process, with its output in a file."""

    def __init__(self, folder: Path, name: str, *arguments: str) -> None:
        self.output = folder / f"{name}.txt"
        with self.output.open("w") as file:
            self.process = subprocess.Popen(
                [sys.executable, "-m", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PYTHONUNBUFFERED": "1"},
            )

    def cpu_s(self) -> float:
        """Return the CPU time that the process and the children it waited for have used."""
        text = Path(f"/proc/{self.process.pid}/stat").read_text()
        return sum(map(int, text.rsplit(")", 1)[1].split()[11:15])) / _CLOCK_TICKS

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)

    def gone(self) -> int:
        try:
            return self.process.wait(timeout=20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()


@dataclass
class Vehicle:
    """What the judge knows about one vehicle, from what its autopilot sends on the second link."""

    socket: socket.socket
    safety_pilot: SafetyPilot
    detector: Detector
    frame: LocalFrame
    mode: int | None = None
    row: tuple[float, float, float, float] | None = None
    """Position, heading and speed: north m, east m, heading deg, speed m/s; None before the first position."""
    velocity_m_s: tuple[float, float] = (0.0, 0.0)
    altitude_m: float = 0.0
    _parser: Any = field(default_factory=lambda: mavlink.MAVLink(None))

    def listen(self) -> None:
        """Read all messages that have arrived."""
        self._parser.robust_parsing = True
        while True:
            try:
                datagram = self.socket.recv(2048)
            except OSError:
                return
            if len(datagram) < 10 or int.from_bytes(datagram[7:10], "little") not in _HEARD:
                continue
            for message in self._parser.parse_buffer(datagram) or ():
                if message.get_srcComponent() != mavlink.MAV_COMP_ID_AUTOPILOT1:
                    continue
                if message.get_type() == "HEARTBEAT":
                    self.mode = message.custom_mode
                elif message.get_type() == "GLOBAL_POSITION_INT":
                    self._place(message)

    def _place(self, message: Any) -> None:  # noqa: ANN401 - of the generated module, which carries no types
        north_m, east_m, convergence_rad = self.frame.to_local_with_convergence(message.lat / 1e7, message.lon / 1e7)
        self.velocity_m_s = to_grid(message.vx / 100.0, message.vy / 100.0, convergence_rad)
        heading_deg = (message.hdg / 100.0 - math.degrees(convergence_rad)) % 360.0
        self.row = (north_m, east_m, heading_deg, math.hypot(*self.velocity_m_s))
        self.altitude_m = message.alt / 1000.0

    def send(self, frames: list[bytes]) -> None:
        for frame in frames:
            try:
                self.socket.send(frame)
            except OSError:
                return


def start(
    mission: Mission, kind: str, folder: Path, offboard: str
) -> tuple[dict[str, Program], list[Vehicle], tuple[str, int]]:
    """Start every program; return them by name, the judge's vehicles, and the address of the sensor's reports."""
    frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
    count = len(mission.agents)
    broadcast_port, sensor_port, *ports = free_ports(2 + 2 * count)
    (folder / "mission.yaml").write_text(dump_mission(mission), encoding="utf-8")
    broadcast = f"mcast:{GROUP}:{broadcast_port}@127.0.0.1"
    programs = {
        "groundstation": Program(
            folder, "groundstation", "groundstation", "run", str(folder / "mission.yaml"), "--unsigned",
            "--link", broadcast, "--sensor", f"udpin:127.0.0.1:{sensor_port}",
        )
    }  # fmt: skip
    vehicles = []
    for index, spec in enumerate(mission.agents):
        companion_port, judge_port = ports[2 * index : 2 * index + 2]
        config = config_for_agent(mission, spec.id, "routed")
        data = config.model_dump(mode="json", exclude_none=True)
        data["autopilot"] = {"kind": kind, "link": f"udpin:127.0.0.1:{companion_port}"}
        if kind.startswith("px4"):
            data["autopilot"]["state_file"] = str(folder / f"engaged-{spec.id}.json")
        if kind == "px4-copter":
            data["autopilot"]["offboard"] = offboard
        data["broadcast"] = {"link": broadcast, "trust": "unsigned"}
        data["log_dir"] = str(folder / "logs")
        path = folder / f"companion-{spec.id}.yaml"
        path.write_text(dump_yaml(data), encoding="utf-8")
        programs[f"companion-{spec.id}"] = Program(folder, f"companion-{spec.id}", "companion", "run", str(path))
        lat_deg, lon_deg, convergence_rad = frame.to_global_with_convergence(*spec.position_ned_m)
        heading_deg = (spec.heading_deg or 0.0) + math.degrees(convergence_rad)
        programs[f"vehicle-{spec.id}"] = Program(
            folder, f"vehicle-{spec.id}", "sim", "vehicle", "--autopilot", kind, "--system-id", str(index + 1),
            "--lat", f"{lat_deg:.8f}", "--lon", f"{lon_deg:.8f}", "--alt", str(mission.origin.alt_m),
            "--heading", f"{heading_deg % 360.0:.4f}", "--in-air", str(config.height_m),
            "--wind-from", str(mission.wind.from_deg), "--wind-speed", str(mission.wind.speed_m_s),
            "--connect", f"udpout:127.0.0.1:{companion_port}", "--connect", f"udpin:127.0.0.1:{judge_port}",
        )  # fmt: skip
        end_point = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        end_point.setblocking(False)
        end_point.connect(("127.0.0.1", judge_port))
        vehicles.append(
            Vehicle(
                end_point,
                SafetyPilot(kind, index + 1),
                Detector(spec.id, index + 1, frame, mission.detector_range_m),
                frame,
            )
        )
    return programs, vehicles, ("127.0.0.1", sensor_port)


def wait_until_heard(vehicles: list[Vehicle], programs: dict[str, Program]) -> None:
    """Wait until every autopilot has sent its position."""
    gives_up_s = time.monotonic() + READY_S
    while any(vehicle.row is None for vehicle in vehicles):
        ended = [name for name, program in programs.items() if program.process.poll() is not None]
        if ended or time.monotonic() > gives_up_s:
            said = "; ".join(programs[name].output.read_text().strip() for name in ended[:2])
            raise SystemExit(f"not started: {ended or 'no telemetry'} {said}")
        for vehicle in vehicles:
            vehicle.send([vehicle.safety_pilot.heartbeat()])
            vehicle.listen()
        time.sleep(0.2)


def fly(
    mission: Mission, seed: int, vehicles: list[Vehicle], sensor_at: tuple[str, int], limit_s: float
) -> TrajectoryBuilder:
    """Play the world until every target is reached or time is up; return the true trajectory."""
    world, arrivals = World(mission, seed), Arrivals(mission)
    sensor = mission_sensor(mission, int(time.time()))
    to_ground = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ids = np.array([agent.id for agent in mission.agents])
    builder = TrajectoryBuilder(
        ids.tolist(), [target.id for target in mission.targets], [threat.id for threat in mission.threats]
    )
    alive = [True] * len(vehicles)
    due_s = {"record": 0.0, "look": 0.0, "see": 0.0, "heartbeat": 0.0}

    def is_due(what: str, period_s: float, t_s: float) -> bool:
        if t_s < due_s[what]:
            return False
        due_s[what] += period_s
        return True

    began_s = time.monotonic()
    while (t_s := time.monotonic() - began_s) < limit_s:
        for vehicle in vehicles:
            vehicle.listen()
            vehicle.send(vehicle.safety_pilot.orders(t_s, vehicle.mode))
        rows = np.array([vehicle.row for vehicle in vehicles])
        world.advance(t_s, rows[:, :2])
        targets, threats = world.rows()
        if is_due("record", mission.integration_step_s, t_s):
            builder.append(t_s, rows, targets, threats)
            if arrivals.note(t_s, rows, alive, targets):
                break
        if is_due("look", LOOK_PERIOD_S, t_s):
            detections = [
                Detection(Kind.AGENT, int(identity), float(row[0]), float(row[1]), *vehicle.velocity_m_s)
                for identity, row, vehicle in zip(ids, rows, vehicles, strict=True)
            ]
            detections += world_detections(mission, targets, threats)
            for datagram in sensor.look(detections, time.time()):
                to_ground.sendto(datagram, sensor_at)
        if is_due("see", mission.guidance_step_s, t_s):
            fleet = Fleet(
                ids,
                rows[:, :2],
                np.array([vehicle.velocity_m_s for vehicle in vehicles]),
                np.array([vehicle.altitude_m for vehicle in vehicles]),
            )
            for vehicle in vehicles:
                vehicle.send(vehicle.detector.look(fleet))
        if is_due("heartbeat", HEARTBEAT_PERIOD_S, t_s):
            for vehicle in vehicles:
                vehicle.send([vehicle.safety_pilot.heartbeat()])
        time.sleep(TICK_S)
    to_ground.close()
    return builder


def setpoint_gaps_s(folder: Path) -> np.ndarray:  # (G,) s
    """Return the gaps between the setpoints that the companions logged as sent, within each engagement."""
    gaps: list[float] = []
    for path in sorted((folder / "logs").rglob("vehicle-*.tlog")):
        times_s = [t_s for t_s, raw in read_tlog(path) if int.from_bytes(raw[7:10], "little") in _SETPOINTS]
        gaps += [gap_s for gap_s in np.diff(times_s).tolist() if gap_s < ENGAGED_GAP_S]
    return np.array(gaps)


def cpu_shares(programs: dict[str, Program], wall_s: float) -> dict[str, float]:
    """Return the share of one core that each kind of program used, all its processes together."""
    shares: dict[str, float] = {}
    for name, program in programs.items():
        sort = name.split("-")[0]
        shares[sort] = shares.get(sort, 0.0) + program.cpu_s() / wall_s
    shares["this judge"] = time.process_time() / wall_s
    return {sort: round(share, 3) for sort, share in shares.items()}


def run(mission: Mission, kind: str, seed: int, folder: Path, limit_s: float, offboard: str) -> dict[str, Any]:
    """Fly a resolved mission; return the figures."""
    began_s = time.monotonic()
    programs, vehicles, sensor_at = start(mission, kind, folder, offboard)
    try:
        wait_until_heard(vehicles, programs)
        builder = fly(mission, seed, vehicles, sensor_at, limit_s)
        shares = cpu_shares(programs, time.monotonic() - began_s)
    finally:
        for program in programs.values():
            program.end()
        statuses = {name: program.gone() for name, program in programs.items()}
        for vehicle in vehicles:
            vehicle.socket.close()
    trajectory = builder.build()
    trajectory.write_csv(folder / "trajectory.csv")
    figures = score(trajectory, mission).to_dict()
    gaps_s = setpoint_gaps_s(folder)
    kept = (
        "targets_reached", "targets", "arrived", "flight_time_s", "threat_entries_detection", "threat_entries_attack",
        "worst_depth_m", "separation_breaches", "min_separation_m",
    )  # fmt: skip
    return {
        "kind": kind,
        "seed": seed,
        "scale": None if mission.scale is None else mission.scale.factor,
        **{key: figures[key] for key in kept},
        "setpoint_gaps": len(gaps_s),
        "setpoint_gap_p99_s": round(float(np.percentile(gaps_s, 99)), 4) if len(gaps_s) else None,
        "setpoint_gap_max_s": round(float(gaps_s.max()), 4) if len(gaps_s) else None,
        "setpoint_gaps_over_limit": int(np.count_nonzero(gaps_s > GAP_S)),
        "cpu_shares_of_a_core": shares,
        "ended_badly": {name: status for name, status in statuses.items() if status != 0},
    }


def main() -> int:
    """Fly what the command line asks; return 0 if all targets were reached without entry, breach or long gap."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mission")
    parser.add_argument("kind", choices=CRUISE_M_S)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scale", action="store_true")
    parser.add_argument("--offboard", choices=("direct", "mavsdk"), default="direct", help="of px4-copter")
    parser.add_argument("--limit", type=float, default=3600.0, help="s")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    mission = resolve(load_mission(given.mission), given.seed, given.mission)
    if given.scale:
        mission = scaled(mission, given.kind, given.mission)
    given.out.mkdir(parents=True)
    figures = run(mission, given.kind, given.seed, given.out, given.limit, given.offboard)
    (given.out / "result.json").write_text(json.dumps(figures, indent=2) + "\n")
    print(json.dumps(figures, indent=2))
    good = figures["targets_reached"] == figures["targets"] and not figures["setpoint_gaps_over_limit"]
    return 0 if good and not figures["threat_entries_detection"] and not figures["separation_breaches"] else 1


if __name__ == "__main__":
    sys.exit(main())
