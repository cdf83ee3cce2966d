"""Families of one agent among threats that move: moving and stale."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from companion.mission.model import (
    Burst,
    LinkSpec,
    Mission,
    PathMotion,
    SteadyMotion,
    ThreatMotion,
)
from sim.arena.families.drawing import (
    CLEARANCE_SHARE,
    N_MAX,
    SPEED_M_S,
    TIME_SHARE,
    TRIES,
    Disc,
    NoRoomError,
    Pose,
    degrees,
    mission_of,
    rounded,
    turn_radius_at_m,
)

LEAST_TIME_SHARE = 1.3
"""Least time limit, as a multiple of the straight line's time, of a flight whose limit is lowered so that fast threats
do not come to the target before the end; an agent that loses time there arrives too late."""
GROWTH_SHARE = 0.55
"""Greatest distance that a threat may cover in a flight, as a share of the straight line; the time limit is lowered for
it, but not below LEAST_TIME_SHARE. All threats begin farther from the target than they can come, so that with a greater
share none could be in the agent's way."""


def moving(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    """Draw a mission of the family `moving`; raise NoRoomError if it has no room."""
    share = round(generator.uniform(0.1, 0.7), 2)
    kind = str(generator.choice(["straight", "circling", "random", "chasing"]))
    count = int(generator.integers(3, 9))
    return _among_movers(generator, f"{name}-{kind}-{share:.2f}v", [kind] * count, [share * SPEED_M_S] * count)


def stale(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    """Draw a mission of the family `stale`; raise NoRoomError if it has no room."""
    period_s = round(generator.uniform(5.0, 30.0), 1)
    count = int(generator.integers(4, 11))
    kinds = [str(kind) for kind in generator.choice(["static", "straight", "circling", "random"], count)]
    speeds_m_s = [0.0 if kind == "static" else generator.uniform(0.02, 0.2) * SPEED_M_S for kind in kinds]
    burst = Burst(
        enter=rounded(generator.uniform(0.02, 0.2), 3),
        leave=rounded(generator.uniform(0.2, 0.6), 3),
        loss=rounded(generator.uniform(0.7, 1.0), 3),
    )
    mission = _among_movers(generator, f"{name}-{period_s:g}s", kinds, speeds_m_s)
    return mission.model_copy(update={"broadcast_period_s": period_s, "link": LinkSpec(burst=burst)})


def _among_movers(
    generator: np.random.Generator, name: str, kinds: Sequence[str], speeds_m_s: Sequence[float]
) -> Mission:
    """Return a single agent's mission among threats of the given kinds, none of which can reach the target in time."""
    n_max = generator.uniform(0.8, N_MAX[1])
    length_m = generator.uniform(3000.0, 4500.0)
    bearing_rad = generator.uniform(0.0, math.tau)
    line_m = length_m * np.array([math.cos(bearing_rad), math.sin(bearing_rad)])
    fastest_share = max(speeds_m_s) / SPEED_M_S
    time_share = max(LEAST_TIME_SHARE, min(TIME_SHARE, GROWTH_SHARE / max(fastest_share, 1e-9)))
    max_time_s = rounded(time_share * length_m / SPEED_M_S)
    discs = []
    for kind, speed_m_s in zip(kinds, speeds_m_s, strict=True):
        radius_m = rounded(generator.uniform(200.0, 450.0))
        clear_of_start_m = radius_m * (1 + CLEARANCE_SHARE) + 2 * turn_radius_at_m(n_max) + 5.0 * speed_m_s
        clear_of_target_m = radius_m * (1 + CLEARANCE_SHARE) + 100.0 + speed_m_s * max_time_s
        for attempt in range(TRIES):
            # Where a threat cannot begin in the way, as among the fastest, it begins anywhere.
            spread = 0.8 if attempt < TRIES // 4 else 10.0
            place_m, course_rad = _in_the_way(generator, kind, speed_m_s, radius_m, spread, line_m)
            if np.hypot(*place_m) >= clear_of_start_m and np.hypot(*(place_m - line_m)) >= clear_of_target_m:
                break
        else:
            raise NoRoomError
        place = rounded(place_m[0]), rounded(place_m[1])
        motion = _motion(generator, kind, place, course_rad, speed_m_s, max_time_s)
        discs.append(Disc(*place, radius_m, motion, rounded(speed_m_s, 3)))
    pose = Pose(0.0, 0.0, degrees(bearing_rad + generator.uniform(-1.0, 1.0)))
    mission = mission_of(name, [pose], [(rounded(line_m[0]), rounded(line_m[1]))], discs, n_max)
    return mission.model_copy(update={"max_time_s": max_time_s})


def _in_the_way(
    generator: np.random.Generator, kind: str, speed_m_s: float, radius_m: float, spread: float, line_m: np.ndarray
) -> tuple[np.ndarray, float]:  # (2,) m, rad
    """Return where a threat begins and its course, such that it is in the way of an agent on a line from the origin.

    One that flies straight is at a point of the line when the agent comes there; one of another kind begins at that
    point. The point lies up to `spread` radii aside of the line; a chasing threat begins up to 3 radii farther aside.
    """
    share, aside = generator.uniform((0.1, -spread), (0.9, spread))
    across = np.array([-line_m[1], line_m[0]]) / np.hypot(*line_m)
    point_m = share * line_m + aside * radius_m * across
    course_rad = generator.uniform(0.0, math.tau)
    if kind == "straight":
        way_m = speed_m_s * share * np.hypot(*line_m) / SPEED_M_S
        point_m = point_m - way_m * np.array([math.cos(course_rad), math.sin(course_rad)])
    elif kind == "chasing":
        point_m = point_m + generator.uniform(-3.0, 3.0) * radius_m * across
    return point_m, course_rad


def _motion(
    generator: np.random.Generator,
    kind: str,
    place_m: tuple[float, float],
    course_rad: float,
    speed_m_s: float,
    until_s: float,
) -> ThreatMotion:
    if kind == "straight":
        return SteadyMotion(heading_deg=degrees(course_rad), speed_m_s=math.floor(1000 * speed_m_s) / 1000)
    if kind == "circling":
        return _circling(generator, place_m, speed_m_s, until_s)
    return "random" if kind == "random" else "chase" if kind == "chasing" else "static"


def _circling(
    generator: np.random.Generator, place_m: tuple[float, float], speed_m_s: float, until_s: float
) -> PathMotion:
    """Return a circle as a polygon of 24 chords a turn, flown just below the speed bound to the end of the run."""
    bow_m = generator.uniform(200.0, 700.0)
    chord_rad = math.copysign(math.tau / 24, generator.uniform(-1.0, 1.0))
    first_rad = generator.uniform(0.0, math.tau)
    chord_s = 2 * bow_m * abs(math.sin(chord_rad / 2)) / (0.99 * speed_m_s)
    points = [(0.0, *place_m)]
    for index in range(1, math.ceil(until_s / chord_s) + 1):
        angle_rad = first_rad + index * chord_rad
        points.append(
            (
                rounded(index * chord_s, 3),
                rounded(place_m[0] + bow_m * (math.cos(angle_rad) - math.cos(first_rad)), 3),
                rounded(place_m[1] + bow_m * (math.sin(angle_rad) - math.sin(first_rad)), 3),
            )
        )
    return PathMotion(path=tuple(points))
