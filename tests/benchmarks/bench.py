"""What a decision, a frame and a flight cost beside a yardstick: `python tests/benchmarks/bench.py`.

Machines differ and are noisy, so each figure is the median of interleaved rounds and comes with its ratio to a
yardstick: packing and parsing one GLOBAL_POSITION_INT with pymavlink. Rounds that spread widely are marked.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from pymavlink.dialects.v20 import common

from companion.guard.guard import check
from companion.guard.types import Discs, Limits, Motion, Setpoint
from companion.mission.model import load_mission
from companion.mission.resolve import resolve
from companion.onboard.companion import Companion
from companion.onboard.config import Config
from companion.protocol.codec import FrameReader, FrameWriter, Stamp
from companion.surrogate.cost import Weights
from companion.surrogate.profiles import ThreatDiscs, gradient_for_agent, profile_by_name
from groundstation.broadcast import state_frames
from groundstation.ground_station import GroundStation
from sim.lockstep import fly
from sim.loop import START_S

ROUNDS = 15
CALLS = 200
NOISY = 3.0
"""Greatest over least round; above it a row is marked."""


def main() -> None:
    """Print the table."""
    mission = resolve(load_mission("paper-dynamic"), 1)
    station = GroundStation(mission, START_S)
    (datagram,) = station.tick(START_S)
    (frame,) = state_frames(station.picture, mission, station.assignment, station.directive, Stamp(int(START_S), 0, 1))
    writer, reader = FrameWriter(), FrameReader()
    vehicle = common.MAVLink(None, srcSystem=1, srcComponent=1)
    where = common.MAVLink_global_position_int_message(0, 470000000, 80000000, 530000, 30000, 6000, 0, 0, 0)
    companion = Companion(Config(agent_id=1))
    companion.hear(datagram, START_S)
    companion.receive(vehicle.heartbeat_encode(1, 0, 1 | 128, 4, 4).pack(vehicle), START_S)
    companion.receive(where.pack(vehicle), START_S)
    profile, rng = profile_by_name("pairwise"), np.random.default_rng(0)
    threats, peers = rng.uniform(0.0, 2e5, (4, 2)), rng.uniform(0.0, 2e5, (9, 2))
    detection_m, attack_m = np.full(4, 1e4), np.full(4, 5e3)
    near = Discs(np.array([[11_000.0, 0.0]]), np.array([1e4]), np.array([0.0]))
    limits = Limits(60.0, 60.0, 10.0, 0.0, 100.0)
    motion, wanted = Motion(0.0, 0.0, 0.0, 60.0), Setpoint(0.1, 60.0, 30.0)

    def yardstick() -> None:
        parser = common.MAVLink(None)
        parser.parse_buffer(where.pack(vehicle))

    rows: dict[str, Callable[[], object]] = {
        "yardstick: pack and parse GLOBAL_POSITION_INT": yardstick,
        "gradient of F*, 4 threats, 9 peers": lambda: gradient_for_agent(
            profile, peers[0], ThreatDiscs(threats, detection_m, attack_m), peers[1:], 100.0, Weights()
        ),
        "guard beside a disc": lambda: check(wanted, motion, near, limits, 0.5),
        "one decision of a companion": lambda: companion.tick(START_S),
        "encode the paper's state frame": lambda: writer.encode(frame),
        "check and decode it": lambda: reader.read(datagram),
    }
    times_us: dict[str, list[float]] = {name: [] for name in rows}
    for _ in range(ROUNDS):
        for name, call in rows.items():
            began_s = time.perf_counter()
            for _ in range(CALLS):
                call()
            times_us[name].append((time.perf_counter() - began_s) / CALLS * 1e6)
    base_us = np.array(times_us["yardstick: pack and parse GLOBAL_POSITION_INT"])
    print(f"{'':48s} {'median us':>10s} {'x yardstick':>12s}")
    for name, rounds_us in times_us.items():
        ratio = float(np.median(np.array(rounds_us) / base_us))
        mark = "  noisy" if max(rounds_us) > NOISY * min(rounds_us) else ""
        print(f"{name:48s} {np.median(rounds_us):10.1f} {ratio:12.2f}{mark}")
    flight = fly(mission.model_copy(update={"max_time_s": 200.0}), 1)
    print(f"\n200 s of paper-dynamic in lockstep: {flight.speedup:.0f} x real time for all ten agents together")


if __name__ == "__main__":
    main()
