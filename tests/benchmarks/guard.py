"""The guard's theorem at length, its tracking in wind and its speed: `python -m tests.benchmarks.guard` from the root.

pytest does not collect it: it flies the worlds of tests/companion/guard/guard_flight.py more often and a hundred times
as long. The exit status is 1 if any flight enters a disc, leaves the fence, lacks a path, or has an assumption reported
as broken that holds.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from contextlib import ExitStack
from unittest.mock import patch

import numpy as np

from companion.guard.arcs import distance_m
from companion.guard.backup import BackupSearch
from companion.guard.guard import Guard
from companion.guard.types import (
    KEEP_OUT,
    TRACKING_REACTIONS,
    TRACKING_STEPS,
    Discs,
    Limits,
    Motion,
    Setpoint,
)
from companion.guard.vehicle import VehicleModel
from tests.companion.guard.guard_flight import WORLDS, Vehicle, flown_against, gusts, sent

STEPS = 10_000
SEEDS = 10
WIND_CASES = [
    # airspeed m/s, load factor, step s, reaction s
    (25.0, 1.0, 0.5, 0.0),
    (25.0, 0.5, 0.5, 0.0),
    (25.0, 4.0, 0.5, 0.0),
    (25.0, 1.0, 0.2, 0.0),
    (25.0, 1.0, 1.0, 0.0),
    (60.0, 1.0, 0.5, 0.0),
    (60.0, 10.0, 0.5, 0.0),
    (25.0, 1.0, 0.5, 0.25),
    (25.0, 1.0, 0.5, 1.0),
    (60.0, 0.5, 0.5, 2.0),
    (60.0, 1.0, 1.0, 1.0),
    (60.0, 1.0, 0.5, 6.0),
]


def theorem(steps: int, seeds: int) -> int:
    """Fly every world and print the outcome; return how many flights failed."""
    failed = 0
    print(f"{'world':34}{'flights':>8}{'steps':>9}{'refused':>9}{'least room m':>14}{'failed':>8}")
    for name, world in WORLDS.items():
        flights, lost = [], 0
        for seed in range(seeds):
            try:
                flights.append(flown_against(world, 1000 + seed, steps))
            except AssertionError as error:
                lost += 1
                print(f"  seed {1000 + seed}: {str(error).splitlines()[:1]}", file=sys.stderr)
        flown = [flight for flight in flights if flight[1]]
        room_m = min((flight[2] for flight in flown), default=math.nan)
        totals = [sum(flight[index] for flight in flown) for index in (1, 0)]
        print(f"{name:34}{len(flown):8}{totals[0]:9}{totals[1]:9}{room_m:14.2e}{lost:8}", flush=True)
        failed += lost
    return failed


def off_path_m(airspeed_m_s: float, n_max: float, dt_s: float, reaction_s: float, seed: int) -> float:
    """Return how far (m) wind up to a third of its speed takes a vehicle off its back-up path within 60 steps of it."""
    rng = np.random.default_rng(seed)
    limits = Limits(airspeed_m_s, airspeed_m_s, n_max, 50.0, 120.0, reaction_s=reaction_s, wind_m_s=airspeed_m_s / 3.0)
    vehicle = Vehicle(Motion(0.0, 0.0, float(rng.uniform(0, 6.28)), airspeed_m_s), limits, gusts(rng, limits.wind_m_s))
    guarded, elsewhere = Guard(limits), Discs(np.array([[1e6, 1e6]]), np.array([1.0]), np.array([0.0]))
    free, worst_m = int(rng.integers(3, 15)), 0.0
    with ExitStack() as patched:
        # The disc is far away, and yet the guard must hold a path; later it keeps it, as no other is accepted.
        patched.enter_context(patch.object(VehicleModel, "reach_m", return_value=math.inf))
        for step in range(free + 60):
            if step == free:
                patched.enter_context(patch.object(BackupSearch, "accepted", return_value=KEEP_OUT))
            wanted = Setpoint(vehicle.motion.heading_rad + float(rng.uniform(-1, 1)), airspeed_m_s, 100.0)
            path = guarded._path
            vehicle.obey(sent(guarded.check(wanted, vehicle.motion, elsewhere, step * dt_s, dt_s)))
            if step > free and guarded._path is not path:
                raise AssertionError("the path in hand was lost")
            places = vehicle.fly(dt_s)
            if guarded._path is not None and step * dt_s >= free * dt_s + reaction_s:
                off_m = [min(distance_m(piece, *place) for piece in guarded._path.pieces) for place in places.tolist()]
                worst_m = max(worst_m, *off_m)
    return worst_m


def tracking(seeds: int) -> int:
    """Print how far wind took vehicles off their paths, beside the allowance; return how often it was more."""
    print("\nwind up to a third of the airspeed, gusts that change over 10 s:")
    print(f"{'v m/s':>6}{'n':>6}{'dt s':>6}{'reaction s':>12}{'off path m':>12}{'allowance m':>13}")
    more = 0
    for airspeed_m_s, n_max, dt_s, reaction_s in WIND_CASES:
        worst_m = max(off_path_m(airspeed_m_s, n_max, dt_s, reaction_s, seed) for seed in range(seeds))
        allowance_m = airspeed_m_s / 3.0 * (TRACKING_STEPS * dt_s + TRACKING_REACTIONS * reaction_s)
        more += worst_m > allowance_m
        print(
            f"{airspeed_m_s:6.0f}{n_max:6.1f}{dt_s:6.1f}{reaction_s:12.2f}{worst_m:12.2f}{allowance_m:13.2f}",
            flush=True,
        )
    return more


def speed(checks: int) -> None:
    """Print the processor time of a check; on a shared machine wall-clock time would say less."""
    rng = np.random.default_rng(1)
    bearings_rad, away_m = rng.uniform(0.0, math.tau, 25), rng.uniform(900.0, 2500.0, 25)
    around = np.column_stack([away_m * np.cos(bearings_rad), away_m * np.sin(bearings_rad)])
    limits, motion = Limits(60.0, 60.0, 1.0, 50.0, 120.0), Motion(0.0, 0.0, 0.0, 60.0)
    radii_m, still, slow = np.full(25, 100.0), np.zeros(25), np.full(25, 10.0)
    print(f"\n{'one check, 25 discs':34}{'median us':>11}{'p99 us':>9}")
    for name, scene, wanted_rad in (
        ("far", Discs(around + 1e5, radii_m, still), 0.05),
        ("near, standing", Discs(around, radii_m, still), 0.05),
        ("near, moving", Discs(2.0 * around, radii_m, slow), 0.05),
        ("refused, standing", Discs(np.vstack([around[:24], [330.0, 0.0]]), radii_m, still), 0.0),
        ("refused, moving", Discs(np.vstack([2.0 * around[:24], [250.0, 0.0]]), radii_m, slow), 0.0),
        ("nothing certified, moving", Discs(np.vstack([2.0 * around[:24], [170.0, 0.0]]), radii_m, slow), 0.0),
    ):
        guarded, times_us = Guard(limits), []
        for _ in range(checks):
            began_ns = time.thread_time_ns()
            guarded.check(Setpoint(wanted_rad, 60.0, 100.0), motion, scene, 0.0, 0.5)
            times_us.append((time.thread_time_ns() - began_ns) / 1e3)
            guarded._commands.clear()
        print(f"{name:34}{np.median(times_us):11.1f}{np.percentile(times_us, 99):9.1f}")


def main() -> int:
    """Run all three parts; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("steps", type=int, nargs="?", default=STEPS, help="of each of the theorem's flights")
    parser.add_argument("seeds", type=int, nargs="?", default=SEEDS, help="flights through each world")
    parser.add_argument("--gusts", type=int, default=40, help="flights in wind of each case")
    parser.add_argument("--checks", type=int, default=2000, help="timed, of each scene")
    options = parser.parse_args()
    speed(options.checks)
    more = tracking(options.gusts)
    return 1 if theorem(options.steps, options.seeds) or more else 0


if __name__ == "__main__":
    sys.exit(main())
