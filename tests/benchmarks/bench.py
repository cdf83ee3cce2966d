"""What a decision, a frame and a flight cost beside a yardstick: `python tests/benchmarks/bench.py`.

Machines differ and are noisy. Each figure is therefore processor time, the median of interleaved rounds, and comes with
its ratio to a yardstick: packing and parsing one GLOBAL_POSITION_INT with pymavlink. Rows whose rounds differ widely
are marked.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from pymavlink.dialects.v20 import common

from companion.guard.guard import Guard
from companion.guard.types import Discs, Limits, Motion, Setpoint
from companion.mission.model import load_mission
from companion.mission.resolve import resolve
from companion.onboard.companion import Companion
from companion.onboard.decision import Decision
from companion.protocol.codec import FrameReader, FrameWriter, Stamp
from companion.surrogate.cost import Weights
from companion.surrogate.profiles import ThreatDiscs, gradient_for_agent, profile_by_name
from groundstation.broadcast import Broadcast, state_frames
from groundstation.ground_station import GroundStation
from groundstation.revision import first_revision
from sim.lockstep import fly
from sim.loop import START_S

YARDSTICK = "yardstick: pack and parse GLOBAL_POSITION_INT"
DECISION = "one decision of a companion, in that flight"
NOISY = 3.0
"""Ratio of a row's greatest round to its least above which the row is marked as noisy."""

Calls = dict[str, Callable[[], object]]


def yardstick() -> Calls:
    """Return the call that all others are compared with."""
    vehicle = common.MAVLink(None, srcSystem=1, srcComponent=1)
    where = common.MAVLink_global_position_int_message(0, 470000000, 80000000, 530000, 30000, 6000, 0, 0, 0)
    return {YARDSTICK: lambda: common.MAVLink(None).parse_buffer(where.pack(vehicle))}


def frame_calls() -> Calls:
    """Return the calls that encode, and that check and decode, the paper's whole mission in one frame."""
    mission = resolve(load_mission("paper-dynamic"), 1)
    station = GroundStation(mission, START_S)
    (datagram,) = station.tick(START_S)
    revision = first_revision(mission, station.tracks, 1)
    broadcast = Broadcast(Stamp(int(START_S), 0, 1), station.directive, revision)
    (frame,) = state_frames(station.tracks, mission, station.assignment, broadcast)
    writer, reader = FrameWriter(), FrameReader()
    return {
        "encode the paper's state frame": lambda: writer.encode(frame),
        "check and decode it": lambda: reader.read(datagram),
    }


def part_calls() -> Calls:
    """Return the calls of two parts of a decision, each by itself."""
    profile, rng = profile_by_name("pairwise"), np.random.default_rng(0)
    threats, peers = rng.uniform(0.0, 2e5, (4, 2)), rng.uniform(0.0, 2e5, (9, 2))
    detection_m, attack_m = np.full(4, 1e4), np.full(4, 5e3)
    near = Discs(np.array([[11_000.0, 0.0]]), np.array([1e4]), np.array([0.0]))
    limits = Limits(60.0, 60.0, 10.0, 0.0, 100.0)
    motion, wanted = Motion(0.0, 0.0, 0.0, 60.0), Setpoint(0.1, 60.0, 30.0)
    return {
        "gradient of F*, 4 threats, 9 peers": lambda: gradient_for_agent(
            profile, peers[0], ThreatDiscs(threats, detection_m, attack_m), peers[1:], 100.0, Weights()
        ),
        "guard beside a disc, from nothing": lambda: Guard(limits).check(wanted, motion, near, 0.0, 0.5),
    }


def flight_us(flight_s: float) -> dict[str, float]:
    """Fly `paper-dynamic` for some seconds; return the flight's processor time and the median decision's, in us."""
    mission = resolve(load_mission("paper-dynamic"), 1).model_copy(update={"max_time_s": flight_s})
    decisions_us: list[float] = []
    tick = Companion.tick

    def timed(self: Companion, now_s: float) -> tuple[Decision, list[bytes]]:
        began_s = time.thread_time()
        found = tick(self, now_s)
        decisions_us.append(1e6 * (time.thread_time() - began_s))
        return found

    Companion.tick = timed  # type: ignore[method-assign]
    began_s = time.process_time()
    try:
        fly(mission, 1)
    finally:
        Companion.tick = tick  # type: ignore[method-assign]
    spent_us = 1e6 * (time.process_time() - began_s)
    return {f"{flight_s:g} s of paper-dynamic, ten agents": spent_us, DECISION: float(np.median(decisions_us))}


def main() -> None:
    """Time all calls in rounds and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15, help="of which the median counts")
    parser.add_argument("--calls", type=int, default=200, help="in a round, of each row but the flight")
    parser.add_argument("--flights", type=int, default=3, help="one in each of the first rounds")
    parser.add_argument("--flight-s", type=float, default=200.0, help="how long each lasts on the virtual clock")
    options = parser.parse_args()
    calls = yardstick() | frame_calls() | part_calls()
    times_us: dict[str, list[float]] = {name: [] for name in calls}
    for number in range(options.rounds):
        for name, call in calls.items():
            began_s = time.process_time()
            for _ in range(options.calls):
                call()
            times_us[name].append(1e6 * (time.process_time() - began_s) / options.calls)
        if number < options.flights:
            for name, spent_us in flight_us(options.flight_s).items():
                times_us.setdefault(name, []).append(spent_us)
    base_us = np.array(times_us[YARDSTICK])
    print(f"{'':48s} {'median us':>12s} {'x yardstick':>12s}")
    for name, rounds_us in times_us.items():
        ratio = float(np.median(np.array(rounds_us) / base_us[: len(rounds_us)]))
        mark = "  noisy" if max(rounds_us) > NOISY * min(rounds_us) else ""
        print(f"{name:48s} {np.median(rounds_us):12.1f} {ratio:12.2f}{mark}")


if __name__ == "__main__":
    main()
