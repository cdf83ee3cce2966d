"""The longest call of the router along flights through hard scenes: `python -m tests.benchmarks.route_time`.

Times are processor time of one thread. A call may take 8 ms among 25 discs, 25 ms among 100 and 50 ms among 400.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from companion.geo.kinematics import shorter_turn_rad, turn_towards
from companion.guidance.route.router import Departure, Reach, Router
from companion.guidance.route.walls import NO_WALLS, Polygon, Walls

COUNTS = (25, 100, 400)
STEPS = 2_000
"""Greatest number of steps of a flight."""


class Flown(NamedTuple):
    """A scene to fly through: start, goal, discs, walls, turn radius and step in metres."""

    start: np.ndarray  # (2,) m
    goal: np.ndarray  # (2,) m
    centres: np.ndarray  # (M, 2) m
    radii: np.ndarray  # (M,) m
    walls: Walls = NO_WALLS
    turn_radius_m: float = 40.0
    step_m: float = 30.0


def lattice(count: int, rng: np.random.Generator) -> Flown:
    """Return a honeycomb with gaps of 10 m, with a target behind it."""
    side = round(math.sqrt(count))
    pitch_m = 310.0
    centres = np.array([(pitch_m * 0.866 * i, pitch_m * (j + 0.5 * (i % 2))) for i in range(side) for j in range(side)])
    middle_m = 0.5 * pitch_m * side
    start = np.array([-1_000.0, middle_m + rng.uniform(-200.0, 200.0)])
    goal = np.array([centres[:, 0].max() + 1_000.0, middle_m])
    return Flown(start, goal, centres, np.full(len(centres), 150.0))


def rooms(count: int, rng: np.random.Generator) -> Flown:
    """Return two rooms of overlapping discs that a corridor joins, with start and goal inside."""
    per_room = (count - 10) // 2
    room_m = per_room * 280.0 / math.tau
    length_m = 5 * 280.0
    walls = [(280.0 * k, side * 300.0) for k in range(5) for side in (1.0, -1.0)]
    opening = math.asin(min(1.0, 320.0 / room_m))
    for centre_m, facing in ((-room_m - 100.0, 0.0), (length_m - 180.0 + room_m, math.pi)):
        for k in range(per_room):
            angle = facing + opening + (math.tau - 2.0 * opening) * k / (per_room - 1)
            walls.append((centre_m + room_m * math.cos(angle), room_m * math.sin(angle)))
    start = np.array([-room_m, rng.uniform(-50.0, 50.0)])
    return Flown(start, np.array([length_m + room_m, 0.0]), np.array(walls), np.full(len(walls), 200.0))


def ring(count: int, rng: np.random.Generator) -> Flown:
    """Return a ring of overlapping discs about the goal, whose only gap is on the far side."""
    around_m = count * 400.0 / math.tau
    angles = math.pi + rng.uniform(-0.5, 0.5) + math.tau * (np.arange(count - 1) - 0.5 * (count - 2)) / count
    centres = around_m * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    return Flown(np.array([-2.0 * around_m, 0.0]), np.zeros(2), centres, np.full(count - 1, 300.0), NO_WALLS, 100.0)


def shut(count: int, rng: np.random.Generator) -> Flown:
    """Return a closed ring about the goal, among other discs."""
    scene = ring(count // 2 + 1, rng)
    around_m = float(np.linalg.norm(scene.centres[0]))
    gap = -scene.centres.mean(axis=0)
    closing = around_m * gap / np.linalg.norm(gap)
    angles = rng.uniform(0.0, math.tau, count - len(scene.centres) - 1)
    others = 1.6 * around_m * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    centres = np.vstack((scene.centres, closing[None], others))
    return Flown(np.array([-2.2 * around_m, 0.0]), np.zeros(2), centres, np.full(len(centres), 300.0))


def small(count: int, rng: np.random.Generator) -> Flown:
    """Return many small discs, of 20 to 60 m, in a square of 6 km."""
    return scattered(count, rng, 6_000.0, lambda: rng.uniform(20.0, 60.0, count))


def mixed(count: int, rng: np.random.Generator) -> Flown:
    """Return discs of 20 m to 20 km in a square of 400 km."""
    return scattered(count, rng, 400_000.0, lambda: 20.0 * 1000.0 ** rng.beta(1.0, 1.0, count))


def dense(count: int, rng: np.random.Generator) -> Flown:
    """Return discs of the paper's square that cover much of it."""
    return scattered(count, rng, 200_000.0, lambda: 1.4e4 * rng.uniform(0.5, 1.5, count) * math.sqrt(25.0 / count))


def scattered(count: int, rng: np.random.Generator, side_m: float, radii_of: Callable[[], np.ndarray]) -> Flown:
    """Return discs anywhere in a square, with free places at opposite corners for start and goal."""
    centres, radii = rng.uniform(0.0, side_m, (count, 2)), radii_of()
    ends = []
    for corner in (0.1, 0.9):
        for _ in range(1000):
            place = side_m * (corner + rng.uniform(-0.1, 0.1, 2))
            if (np.linalg.norm(centres - place, axis=-1) > radii + 0.002 * side_m).all():
                break
        ends.append(place)
    return Flown(ends[0], ends[1], centres, radii, NO_WALLS, 0.0005 * side_m, 0.0012 * side_m)


def walled(count: int, rng: np.random.Generator) -> Flown:
    """Return a fence with a comb of inner walls, exclusions and discs in it."""
    size_m, teeth = 12_000.0, max(2, min(20, count // 16))
    pitch_m = size_m / (teeth + 1)
    fence: list[tuple[float, float]] = [(0.0, 0.0)]
    for tooth in range(teeth):
        north_m = pitch_m * (tooth + 1)
        fence += [(north_m - 20.0, 0.0), (north_m - 20.0, 8_000.0), (north_m + 20.0, 8_000.0), (north_m + 20.0, 0.0)]
    fence += [(size_m, 0.0), (size_m, 12_000.0), (0.0, 12_000.0)]
    boxes: list[Polygon] = []
    for tooth in range(teeth):
        north_m, east_m = pitch_m * (tooth + 0.5), rng.uniform(2_000.0, 10_000.0)
        boxes.append(tuple((north_m + a * 60.0, east_m + b * 300.0) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))))
    left = max(count - len(fence) - 4 * teeth, 5)
    centres = np.stack((rng.uniform(600.0, size_m - 600.0, left), rng.uniform(8_400.0, 11_600.0, left)), axis=-1)
    walls = Walls(tuple(fence), tuple(boxes), 20.0)
    return Flown(np.array([100.0, 400.0]), np.array([size_m - 100.0, 400.0]), centres, np.full(left, 100.0), walls)


FAMILIES = {family.__name__: family for family in (lattice, rooms, ring, shut, small, mixed, dense, walled)}


class Result(NamedTuple):
    """What a flight gave: times of its calls, how many had no way yet, how it ended, and how deep it was in a disc."""

    times_ms: list[float]
    planning: int
    end: str
    depth_m: float


def flight(scene: Flown) -> Result:
    """Fly a scene by a router until the goal, or the nearest safe point, is reached."""
    router, ids, times_ms = Router(), np.arange(len(scene.radii)), []
    state = (float(scene.start[0]), float(scene.start[1]), 0.3)
    planning, depth_m = 0, -math.inf
    for _ in range(STEPS):
        begin_s = time.thread_time()
        route = router.route(
            Departure(state[:2], state[2], scene.turn_radius_m),
            scene.goal,
            scene.centres,
            scene.radii,
            ids,
            scene.walls,
        )
        times_ms.append(1e3 * (time.thread_time() - begin_s))
        wanted_rad = route.heading_rad
        if math.isnan(wanted_rad):
            planning += route.reach is Reach.PLANNING
            wanted_rad = state[2] + 0.5 * math.pi
        elif route.length_m <= max(2.0 * scene.turn_radius_m, scene.step_m):
            return Result(times_ms, planning, route.reach.value, depth_m)
        if route.turn * shorter_turn_rad(state[2], wanted_rad) < 0.0:
            wanted_rad = state[2] + route.turn * math.pi / 2.0
        for _ in range(4):
            state = turn_towards(*state[:2], state[2], 1.0, wanted_rad, 1.0 / scene.turn_radius_m, 0.25 * scene.step_m)
            gap_m = np.linalg.norm(scene.centres - np.array(state[:2]), axis=-1) - scene.radii
            depth_m = max(depth_m, -float(gap_m.min()))
    return Result(times_ms, planning, "still flying", depth_m)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("families", nargs="*", default=list(FAMILIES), help=", ".join(FAMILIES))
    parser.add_argument("--counts", type=int, nargs="*", default=list(COUNTS))
    parser.add_argument("--flights", type=int, default=3, help="of each family and number of discs")
    options = parser.parse_args()
    print(
        f"{'family':8s} {'discs':>5s} {'calls':>6s} {'median ms':>9s} {'worst ms':>8s} {'planning':>8s} {'depth m':>8s}"
    )
    for name in options.families:
        for count in options.counts:
            rng = np.random.default_rng(count)
            results = [flight(FAMILIES[name](count, rng)) for _ in range(options.flights)]
            times_ms = [spent_ms for result in results for spent_ms in result.times_ms]
            print(
                f"{name:8s} {count:5d} {len(times_ms):6d} {np.median(times_ms):9.2f} {max(times_ms):8.1f} "
                f"{sum(result.planning for result in results):8d} {max(result.depth_m for result in results):8.2g} "
                f" {', '.join(result.end for result in results)}"
            )


if __name__ == "__main__":
    main()
