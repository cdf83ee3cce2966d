"""What the families of scenes share: their types, the vehicle of most of them, and helpers that draw places."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.geo.kinematics import GRAVITY_M_S2, turn_rate_rad_s
from companion.geo.right_of_way import Rules, interaction_radius_m
from companion.mission.model import (
    AgentSpec,
    CostWeights,
    Mission,
    TargetSpec,
    ThreatMotion,
    ThreatSpec,
)
from sim.arena.plan_task import ground_turn_radius_m

SPEED_M_S = 25.0
GUIDANCE_STEP_S = 0.5
GREATEST_TURN_RAD = 0.25
"""Greatest turn in one guidance step: a law that decides once a step must be able to follow an arc."""
N_MAX = (0.5, 1.25)
"""Least and greatest load factor: turn radii of 127 to 51 m at 25 m/s, which steps of 0.5 s can follow."""
RANGE_M = 500_000.0
"""Range of every agent, so great that no flight ends because it is used up."""
TIME_SHARE = 2.5
"""Time limit of a flight, as a multiple of the time that the straight line to the target takes."""
ATTACK_SHARE = 0.5
"""R_a / R_d, as in the paper."""
CLEARANCE_SHARE = 0.1
"""Distance, as a share of R_d, that starts, targets and the turning circles beside them keep from every disc."""
PAPER_RADIUS_M = 10_000.0
"""The paper's R_d. The paper's weights are areas and are scaled by the square of the scene's radius over this one."""
SEPARATION_M = 40.0
"""Separation of the scenes, for 25 m/s; the paper has 100 m for 60 m/s."""
START_GAP = 1.05
"""Least distance between two agents' starts, as a multiple of the interaction radius of the right-of-way rule."""
TRIES = 2_000
"""Draws of one place, or of one scene, before giving up."""
DECIMALS = 1
"""Positions are rounded to 0.1 m and headings to 0.1 degrees, so that a mission file reads well."""


@dataclass(frozen=True)
class Family:
    """A family of scenes: how its missions are drawn, and what they test."""

    title: str
    description: str
    knowledge: str
    """What a law must know or do to succeed in this family, and what simpler laws leave out."""
    count: int
    """Missions of the family in a full arena."""
    static: bool
    """Whether no threat moves in any mission of the family."""
    single: bool
    """Whether every mission of the family has a single agent."""
    draw: Callable[[np.random.Generator, str, float | None], Mission]
    """Function that draws a mission from a generator, the mission's name and the least distance between starts in m
    (None: the interaction radius of the right-of-way rule)."""
    dear: bool
    """Whether a flight costs so much that only a share of the missions asked for are flown."""


@dataclass(frozen=True)
class Disc:
    """A threat before it becomes part of a mission: where it starts, its radius R_d and how it moves."""

    north_m: float
    east_m: float
    radius_m: float
    motion: ThreatMotion = "static"
    speed_bound_m_s: float = 0.0


@dataclass(frozen=True)
class Pose:
    """Where an agent begins, and its heading clockwise from north."""

    north_m: float
    east_m: float
    heading_deg: float


class NoRoomError(Exception):
    """Raised where a scene has no room for another place; another draw of the scene may have it."""


def scattered(generator: np.random.Generator, count: int, coverage: float, limits_m: tuple[float, float]) -> list[Disc]:
    """Return static discs that cover about the share `coverage` of a box of 5 km, overlaps counted twice."""
    side_m = 5000.0
    mean_m = math.sqrt(coverage * side_m**2 / (count * math.pi))
    radii_m = np.clip(mean_m * generator.uniform(0.6, 1.4, count), *limits_m)
    centres_m = generator.uniform(0.0, side_m, (count, 2))
    return [Disc(rounded(n), rounded(e), rounded(r)) for (n, e), r in zip(centres_m, radii_m, strict=True)]


def single(generator: np.random.Generator, name: str, discs: Sequence[Disc], turn_radius_m: float) -> Mission:
    """Return one agent's mission among static discs, start and target 2800 to 4500 m apart in the box of the discs.

    Beside the start, on one side, and somewhere beside the target there is a turning circle clear of all discs.
    """
    centres_m = np.array([(disc.north_m, disc.east_m) for disc in discs])
    radii_m = np.array([disc.radius_m for disc in discs])
    clear_m = CLEARANCE_SHARE * radii_m
    low_m, high_m = centres_m.min(axis=0), centres_m.max(axis=0)

    def clear(points_m: np.ndarray, reach_m: float) -> np.ndarray:  # (P, 2) m -> (P,)
        gap_m = np.linalg.norm(points_m[:, None] - centres_m, axis=-1) - radii_m - clear_m
        free: np.ndarray = (gap_m >= reach_m).all(axis=-1)
        return free

    bearings_rad = np.arange(16) * math.tau / 16
    around = np.column_stack([np.cos(bearings_rad), np.sin(bearings_rad)])
    for _ in range(TRIES):
        start_m, target_m = generator.uniform(low_m, high_m, (2, 2))
        heading_rad = generator.uniform(0.0, math.tau)
        to_right = np.array([-math.sin(heading_rad), math.cos(heading_rad)])
        beside_m = start_m + turn_radius_m * np.outer([1.0, -1.0], to_right)
        if not 2800.0 <= np.hypot(*(target_m - start_m)) <= 4500.0:
            continue
        if not (clear(np.vstack([start_m, target_m]), 50.0).all() and clear(beside_m, turn_radius_m).any()):
            continue
        if clear(target_m + turn_radius_m * around, turn_radius_m).any():
            pose = Pose(rounded(start_m[0]), rounded(start_m[1]), degrees(heading_rad))
            target = (rounded(target_m[0]), rounded(target_m[1]))
            return mission_of(name, [pose], [target], discs, SPEED_M_S**2 / (turn_radius_m * GRAVITY_M_S2))
    raise NoRoomError


def mission_of(
    name: str,
    poses: Sequence[Pose],
    targets_m: Sequence[tuple[float, float]],
    discs: Sequence[Disc],
    n_max: float,
    crossing: bool = False,
) -> Mission:
    """Return a mission; if `crossing`, agent i must fly to target i, which no assignment of least sum would choose."""
    radius_m = float(np.median([disc.radius_m for disc in discs])) if discs else 300.0
    scale = (radius_m / PAPER_RADIUS_M) ** 2
    paper = CostWeights()
    straight_m = max(
        math.hypot(target[0] - pose.north_m, target[1] - pose.east_m)
        for index, pose in enumerate(poses)
        for target in (targets_m if len(targets_m) < len(poses) else [targets_m[index]])
    )
    if turn_rate_rad_s(SPEED_M_S, n_max) * GUIDANCE_STEP_S > GREATEST_TURN_RAD + 1e-3:
        raise ValueError(f"{name}: n_max {n_max:g} turns too much in a guidance step")
    return Mission(
        name=name,
        agents=tuple(
            AgentSpec(
                id=index + 1,
                north_m=pose.north_m,
                east_m=pose.east_m,
                heading_deg=pose.heading_deg,
                speed_m_s=SPEED_M_S,
                n_max=rounded(n_max, 4),
                range_m=RANGE_M,
                only_target=index + 1 if crossing else None,
            )
            for index, pose in enumerate(poses)
        ),
        targets=tuple(
            TargetSpec(id=index + 1, north_m=north_m, east_m=east_m, speed_bound_m_s=0.0)
            for index, (north_m, east_m) in enumerate(targets_m)
        ),
        threats=tuple(
            ThreatSpec(
                id=index + 1,
                north_m=disc.north_m,
                east_m=disc.east_m,
                detection_radius_m=disc.radius_m,
                attack_radius_m=ATTACK_SHARE * disc.radius_m,
                speed_bound_m_s=disc.speed_bound_m_s,
                motion=disc.motion,
            )
            for index, disc in enumerate(discs)
        ),
        weights=CostWeights(k_d=scale * paper.k_d, k_a=scale * paper.k_a, k_c=scale * paper.k_c, k_l=scale * paper.k_l),
        guidance_step_s=GUIDANCE_STEP_S,
        integration_step_s=GUIDANCE_STEP_S,
        arrival_radius_m=3.0 * SPEED_M_S * GUIDANCE_STEP_S,
        separation_m=SEPARATION_M,
        detector_range_m=800.0,
        range_policy="arrive",
        max_time_s=rounded(TIME_SHARE * straight_m / SPEED_M_S),
    )


def covers(disc: Disc, points_m: np.ndarray, clear_m: float) -> bool:
    """Return whether any point (P, 2) is within a disc widened by CLEARANCE_SHARE of its radius and by `clear_m`."""
    gap_m = np.hypot(points_m[:, 0] - disc.north_m, points_m[:, 1] - disc.east_m)
    return bool((gap_m < (1.0 + CLEARANCE_SHARE) * disc.radius_m + clear_m).any())


def apart(
    generator: np.random.Generator, count: int, box_m: float | tuple[float, float], gap_m: float
) -> np.ndarray:  # (N, 2) m
    """Return `count` places in a box with a corner at the origin, at least `gap_m` from each other."""
    size_m = np.broadcast_to(np.asarray(box_m, dtype=float), 2)
    places_m = np.empty((0, 2))
    for _ in range(TRIES):
        place_m = generator.uniform(0.0, size_m)
        if (np.linalg.norm(places_m - place_m, axis=-1) >= gap_m).all():
            places_m = np.vstack([places_m, place_m])
        if len(places_m) == count:
            return places_m
    raise NoRoomError


def least_gap_m(places_m: np.ndarray) -> float:
    """Return the least distance between two of N places (N, 2) in m; infinite for a single one."""
    first, second = np.triu_indices(len(places_m), k=1)
    return float(np.linalg.norm(places_m[first] - places_m[second], axis=-1).min(initial=math.inf))


def with_radius(centres_m: np.ndarray, radius_m: float) -> np.ndarray:  # (M, 3) m
    """Return centres (M, 2) in m with one radius for all: north, east, radius."""
    return np.column_stack([centres_m, np.full(len(centres_m), radius_m)])


def interaction_m(separation_m: float, n_max: float, speed_m_s: float, step_s: float) -> float:
    """Return the distance in m within which the right of way counts another vehicle."""
    return interaction_radius_m(Rules(separation_m=separation_m, n_max=n_max, speed_m_s=speed_m_s), step_s)


def turn_radius_at_m(n_max: float) -> float:
    """Return the turn radius in m of a vehicle of SPEED_M_S in calm air."""
    return ground_turn_radius_m(SPEED_M_S, n_max, 0.0)


def rounded(value: float, decimals: int = DECIMALS) -> float:
    """Return a number as it is written into a mission: with DECIMALS unless told otherwise."""
    return round(float(value), decimals)


def degrees(angle_rad: float) -> float:
    """Return an angle in degrees from 0 to 360, as it is written into a mission."""
    return rounded(math.degrees(angle_rad) % 360.0)
