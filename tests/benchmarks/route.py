"""The route over a thousand scenes, flown, and timed: `python -m tests.benchmarks.route [--scenes 1000]`.

It repeats the correctness checks of test_route.py over many more scenes. Times are processor time of one thread, and
each stands beside a yardstick: the independent planner of sim/shortest_path.py, run on the same scenes in turn.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable

import numpy as np

from companion.guidance.route.router import Departure, Reach, Router, shortest_route
from sim.shortest_path import shortest_path_length
from tests.companion.guidance.test_route import FAMILIES, Scene, arrival, disagreement, misdirection, scenes

SIDE_M = 200_000.0
"""Side of the paper's square, which the timed scenes fill with discs of 0.5 to 1.5 times the paper's radius."""
RADIUS_M = 10_000.0
SHARES = (0.05, 0.2, 0.5, 0.75, 1.0)
"""Turn radii of the flights, as shares of the discs' median radius."""


def timed_scene(count: int, rng: np.random.Generator) -> Scene:
    """Return a scene whose discs have the same expected area in total whatever their number."""
    while True:
        centres = rng.uniform(0.0, SIDE_M, (count, 2))
        radii = RADIUS_M * rng.uniform(0.5, 1.5, count) * math.sqrt(25.0 / count)
        start, goal = rng.uniform(0.0, SIDE_M, (2, 2))
        gap_m = np.linalg.norm(np.stack((start, goal))[:, None] - centres, axis=-1) - radii
        if (gap_m > 0.0).all() and math.dist(start, goal) > 0.5 * SIDE_M:
            return start, goal, centres, radii


def spent_us(call: Callable[[], object], repeat: int) -> float:
    """Return the processor time of a call in us, the least of `repeat` tries."""
    best_s = math.inf
    for _ in range(repeat):
        begin_s = time.thread_time()
        call()
        best_s = min(best_s, time.thread_time() - begin_s)
    return 1e6 * best_s


def quantiles(values: list[float]) -> str:
    """Return the median, 99th percentile and maximum of times in us as text."""
    return "median {:7.0f}  p99 {:7.0f}  max {:7.0f} us".format(*np.quantile(values, (0.5, 0.99, 1.0)))


def report_correctness(count: int) -> None:
    """Print the lengths that differ from the independent planner's, and how many first directions are wrong."""
    for family in FAMILIES:
        share = -(-count // len(FAMILIES))
        drawn = list(scenes(family, share, seed=100))
        faults = [fault for fault in map(disagreement, drawn) if fault]
        wrong = [off for off in map(misdirection, drawn) if off > 0.02]
        unreached = sum(shortest_route(*scene).reach is not Reach.TARGET for scene in drawn)
        print(f"{family:10} {share} scenes: {len(faults)} lengths and {len(wrong)} directions wrong, {unreached} shut")
        for fault in faults:
            print("   ", fault)


def report_flights(count: int) -> None:
    """Print how flights from step to step through dense scenes end."""
    for share in SHARES:
        arrived, longest, deepest_m, entered, flights = 0, 0.0, 0.0, 0, 0
        rng = np.random.default_rng(5)
        while flights < count:
            start, goal, centres, radii = timed_scene(25, rng)
            scene = (start / 20.0, goal / 20.0, centres / 20.0, radii / 20.0)  # a flight of some hundred steps
            turn_radius_m, step_m = share * 500.0, 12.5
            if (np.linalg.norm(scene[2] - scene[0], axis=-1) - scene[3] < 2.0 * turn_radius_m).any():
                continue
            flights += 1
            got_there, flown_m, depth_m, first = arrival(
                scene[0], rng.uniform(0.0, math.tau), scene, turn_radius_m, step_m
            )
            arrived += got_there
            longest = max(longest, flown_m / first.length_m)
            entered += depth_m > 1e-3 * step_m
            deepest_m = max(deepest_m, depth_m)
        print(
            f"turn radius {share:4.2f} R: {arrived} of {flights} arrive, longest {longest:.4f} of the first route, "
            f"{entered} enter, deepest {deepest_m:.2g} m"
        )


def report_times(count: int, repeat: int) -> None:
    """Print the times of a route from nothing, of routes from step to step, and of the yardstick."""
    for discs, many in ((25, count), (100, count // 4)):
        rng = np.random.default_rng(discs)
        fresh, limited, kept, moving, yardstick = [], [], [], [], []
        for _ in range(many):
            start, goal, centres, radii = timed_scene(discs, rng)
            heading_rad, ids = rng.uniform(0.0, math.tau), np.arange(discs)
            fresh.append(spent_us(lambda: shortest_route(start, goal, centres, radii), repeat))  # noqa: B023
            limited.append(
                spent_us(lambda: shortest_route(start, goal, centres, radii, heading_rad, 1000.0), repeat)  # noqa: B023
            )
            yardstick.append(spent_us(lambda: shortest_path_length(start, goal, centres, radii), 1))  # noqa: B023
            kept += steps_us((start, goal, centres, radii), heading_rad, ids, 0.0)
            moving += steps_us((start, goal, centres, radii), heading_rad, ids, 5.0)
        print(f"{discs} discs, {many} scenes")
        print(f"  yardstick                    {quantiles(yardstick)}")
        print(f"  from nothing                 {quantiles(fresh)}")
        print(f"  from nothing, turn limit     {quantiles(limited)}")
        print(f"  step to step, still discs    {quantiles(kept)}")
        print(f"  step to step, growing discs  {quantiles(moving)}")
        print(f"  yardstick over from nothing: {np.median(yardstick) / np.median(fresh):.0f} times")


def steps_us(scene: Scene, heading_rad: float, ids: np.ndarray, growth_m: float) -> list[float]:
    """Return the times in us of 20 steps of 30 m by one router.

    The discs grow for ten steps and fall back, as those of threats do with the age of a broadcast.
    """
    start, goal, centres, radii = scene
    router, place, times = Router(), np.array(start), []
    for step in range(21):
        grown_m = radii + growth_m * (step % 10)
        begin_s = time.thread_time()
        route = router.route(Departure(place, heading_rad, 1000.0), goal, centres, grown_m, ids)
        if step:
            times.append(1e6 * (time.thread_time() - begin_s))
        if math.isnan(route.heading_rad):
            break
        heading_rad = route.heading_rad
        place = place + 30.0 * np.array([math.cos(heading_rad), math.sin(heading_rad)])
    return times


def main() -> None:
    """Print the report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=1000)
    parser.add_argument("--flights", type=int, default=50, help="for each turn radius")
    parser.add_argument("--timed", type=int, default=200)
    parser.add_argument("--repeat", type=int, default=3, help="of which the least time counts")
    options = parser.parse_args()
    report_correctness(options.scenes)
    report_flights(options.flights)
    report_times(options.timed, options.repeat)


if __name__ == "__main__":
    main()
