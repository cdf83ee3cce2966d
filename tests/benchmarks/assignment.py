"""How long an assignment around threats takes: `python tests/benchmarks/assignment.py [--scenes 20]`.

The scenes are random: 25 discs, and agents in flight with random headings, at the paper's speed and load factor 1. For
each size it prints the median and greatest time of one assignment, and how many paths were searched, of how many pairs.
"""

from __future__ import annotations

import argparse
import math
import time
from functools import partial

import numpy as np

from groundstation.assignment import SWITCHING_SHARE
from groundstation.route_cost import MAX_ROUTES, AssignmentRule, RouteCosts, RouteObjective, Scene, assign_by_route_cost

SIDE_M = 200_000.0
SPEED_M_S, TURN_RADIUS_M = 60.0, 367.0
RADII_M = (5_000.0, 20_000.0)


def scene(rng: np.random.Generator, agents: int, targets: int, discs: int) -> Scene:
    """Return a scene whose targets and agents lie outside all discs."""
    centres_ned_m = rng.uniform(0.0, SIDE_M, (discs, 2))
    radii_m = rng.uniform(*RADII_M, discs)

    def free(count: int) -> np.ndarray:
        points: list[np.ndarray] = []
        while len(points) < count:
            point = rng.uniform(0.0, SIDE_M, 2)
            if np.all(np.hypot(*(centres_ned_m - point).T) > 1.1 * radii_m):
                points.append(point)
        return np.array(points)

    return Scene(
        free(agents),
        rng.uniform(0.0, math.tau, agents),
        np.full(agents, TURN_RADIUS_M),
        free(targets),
        centres_ned_m,
        radii_m,
        np.ones((agents, discs), dtype=bool),
    )


def everything(there_m: np.ndarray) -> np.ndarray:
    """Return that every target is within range."""
    reachable: np.ndarray = np.isfinite(there_m)
    return reachable


def measure(agents: int, targets: int, discs: int, objective: RouteObjective, again: bool, scenes: int) -> str:
    """Return a line on assignments of one kind.

    Measured is the first assignment of a flight, or if `again` the second, with the first as the present one.
    """
    rng = np.random.default_rng(7)
    speeds_m_s = np.full(agents, SPEED_M_S)
    rule = AssignmentRule(objective, SWITCHING_SHARE)
    settle = partial(assign_by_route_cost, speeds_m_s=speeds_m_s, rule=rule, in_range=everything)
    took_ms, searched = [], []
    for _ in range(scenes):
        drawn = scene(rng, agents, targets, discs)
        present = np.full(agents, -1)
        if again:
            present = settle(RouteCosts(drawn), present=present)
        started_s = time.perf_counter()
        costs = RouteCosts(drawn)
        settle(costs, present=present)
        took_ms.append(1e3 * (time.perf_counter() - started_s))
        searched.append(costs.searched)
    return (
        f"{agents} x {targets}, {discs} discs, {objective}, {'again' if again else 'first'}: "
        f"{np.median(took_ms):.0f} ms median, {max(took_ms):.0f} ms at most; "
        f"{np.median(searched):.0f} paths median, {max(searched)} at most (bound {MAX_ROUTES}), of {agents * targets}"
    )


def main() -> None:
    """Print a line for every size, objective and stage of a flight."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=20, help="of each kind")
    scenes = parser.parse_args().scenes
    objectives: tuple[RouteObjective, ...] = ("route", "latest")
    for agents, targets in ((10, 5), (50, 20)):
        for objective in objectives:
            for again in (False, True):
                print(measure(agents, targets, 25, objective, again, scenes), flush=True)


if __name__ == "__main__":
    main()
