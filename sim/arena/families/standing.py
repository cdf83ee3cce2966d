"""Families of one agent among discs that stand still: dense, tight, traps and wind."""

from __future__ import annotations

import math

import numpy as np

from companion.mission.model import (
    Mission,
    Wind,
)
from sim.arena.families.drawing import (
    GREATEST_TURN_RAD,
    GUIDANCE_STEP_S,
    N_MAX,
    SPEED_M_S,
    TIME_SHARE,
    Disc,
    Pose,
    degrees,
    mission_of,
    rounded,
    scattered,
    single,
    turn_radius_at_m,
    with_radius,
)
from sim.arena.plan_task import ground_turn_radius_m

TRAP_TIME_SHARE = 5.0
"""Time limit among traps, as a multiple of the straight line's time: the way out of a spiral alone takes more than
twice that time."""


def dense(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    """Draw a mission of the family `dense`; raise NoRoomError if it has no room."""
    discs = scattered(generator, int(generator.integers(10, 61)), generator.uniform(0.15, 0.6), (200.0, 1000.0))
    return single(generator, f"{name}-{len(discs)}", discs, turn_radius_at_m(generator.uniform(*N_MAX)))


def tight(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    """Draw a mission of the family `tight`; raise NoRoomError if it has no room."""
    share = math.exp(generator.uniform(math.log(0.05), math.log(1.0)))
    # A turn radius below this cannot be followed at the guidance step.
    least_m = SPEED_M_S * GUIDANCE_STEP_S / GREATEST_TURN_RAD
    disc_m = generator.uniform(max(200.0, least_m / share), 1000.0 + 1e-6)
    count = int(generator.integers(8, 26))
    side_m = max(5000.0, disc_m * math.sqrt(count * math.pi / 0.45))
    centres_m = generator.uniform(0.0, side_m, (count, 2))
    discs = [Disc(rounded(n), rounded(e), rounded(disc_m)) for n, e in centres_m]
    return single(generator, f"{name}-{share:.2f}R", discs, share * disc_m)


def traps(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    """Draw a mission of the family `traps`; raise NoRoomError if it has no room."""
    n_max = generator.uniform(0.8, N_MAX[1])
    kind = str(generator.choice(["u", "spiral", "corridor"]))
    trap = {"u": _u_trap, "spiral": _spiral_trap, "corridor": _corridor_trap}[kind]
    discs_m, start_m, target_m, heading_rad = trap(generator, turn_radius_at_m(n_max))
    # Turned to a random side, and mirrored in half of the draws.
    turn_rad, mirror = generator.uniform(0.0, math.tau), generator.choice([-1.0, 1.0])

    def placed(point_m: np.ndarray) -> tuple[float, float]:
        north_m, east_m = float(point_m[0]), mirror * float(point_m[1])
        cosine, sine = math.cos(turn_rad), math.sin(turn_rad)
        return rounded(cosine * north_m - sine * east_m), rounded(sine * north_m + cosine * east_m)

    discs = [Disc(*placed(row[:2]), rounded(row[2])) for row in discs_m]
    heading_deg = degrees(turn_rad + mirror * heading_rad)
    pose = Pose(*placed(start_m), heading_deg)
    mission = mission_of(f"{name}-{kind}", [pose], [placed(target_m)], discs, n_max)
    return mission.model_copy(update={"max_time_s": rounded(TRAP_TIME_SHARE / TIME_SHARE * mission.max_time_s)})


def _u_trap(
    generator: np.random.Generator, turn_radius_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:  # (M, 3) m, (2,) m, (2,) m
    """Return discs on an arc open to the south, with a start, a target and a heading in rad.

    The start lies within the arc or south of it, the target north of it.
    """
    radius_m = generator.uniform(200.0, 300.0)
    bow_m = radius_m * generator.uniform(2.6, 3.4)
    half_rad = generator.uniform(math.radians(100), math.radians(140))
    count = math.ceil(2 * half_rad * bow_m / (1.5 * radius_m)) + 1
    angles_rad = np.linspace(-half_rad, half_rad, count)
    centres_m = bow_m * np.column_stack([np.cos(angles_rad), np.sin(angles_rad)])
    start_m = np.array([generator.choice([0.0, -2.0, -4.0]) * bow_m, 0.0])
    target_m = np.array([bow_m + radius_m + generator.uniform(600.0, 1500.0), generator.uniform(-400.0, 400.0)])
    return with_radius(centres_m, radius_m), start_m, target_m, generator.uniform(-0.5, 0.5)


def _spiral_trap(
    generator: np.random.Generator, turn_radius_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:  # (M, 3) m, (2,) m, (2,) m
    """Return discs along a spiral of more than one turn, with a start, a target and a heading in rad.

    The start is the spiral's centre; the target lies outside, on another side than the spiral's mouth.
    """
    radius_m = 200.0
    lane_m = 5.0 * turn_radius_m + generator.uniform(0.0, 100.0)
    pitch_m = lane_m + 2 * radius_m
    turns = generator.uniform(1.15, 1.4)
    inner_m = lane_m / 2 + radius_m + 100.0
    angles_rad = [0.0]
    while angles_rad[-1] < turns * math.tau:
        bow_m = inner_m + pitch_m * angles_rad[-1] / math.tau
        angles_rad.append(angles_rad[-1] + 1.4 * radius_m / bow_m)
    angle_rad = np.array(angles_rad)
    bows_m = inner_m + pitch_m * angle_rad / math.tau
    centres_m = bows_m[:, None] * np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])
    bearing_rad = angle_rad[-1] + generator.uniform(0.6, 1.4) * math.pi
    distance_m = bows_m[-1] + radius_m + generator.uniform(300.0, 800.0)
    target_m = distance_m * np.array([math.cos(bearing_rad), math.sin(bearing_rad)])
    return with_radius(centres_m, radius_m), np.zeros(2), target_m, generator.uniform(0.0, math.tau)


def _corridor_trap(
    generator: np.random.Generator, turn_radius_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:  # (M, 3) m, (2,) m, (2,) m
    """Return discs along two walls and the end that closes them, with a start, a target and a heading in rad.

    In half of the draws one wall has a door. The start lies between or before the walls, the target behind the end.
    """
    radius_m = generator.uniform(200.0, 260.0)
    half_m = 2.6 * turn_radius_m + radius_m + generator.uniform(0.0, 150.0)
    depth_m = generator.uniform(1000.0, 1700.0)
    along_m = np.linspace(0.0, depth_m, math.ceil(depth_m / (1.4 * radius_m)) + 1)
    across_m = np.linspace(-half_m, half_m, math.ceil(2 * half_m / (1.4 * radius_m)) + 1)[1:-1]
    left_m = np.column_stack([along_m, np.full(along_m.size, -half_m)])
    right_m = np.column_stack([along_m, np.full(along_m.size, half_m)])
    if generator.random() < 0.5:
        # A door: without its discs the gap is wider than two turn circles.
        door = len(along_m) // 2
        right_m = np.delete(right_m, [door - 1, door, door + 1], axis=0)
    end_m = np.column_stack([np.full(across_m.size, depth_m), across_m])
    start_m = np.array([generator.choice([-600.0, 0.2 * depth_m, 0.5 * depth_m]), 0.0])
    target_m = np.array([depth_m + radius_m + generator.uniform(600.0, 1200.0), generator.uniform(-400.0, 400.0)])
    return with_radius(np.vstack([left_m, right_m, end_m]), radius_m), start_m, target_m, generator.uniform(-0.4, 0.4)


def wind(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    """Draw a mission of the family `wind`; raise NoRoomError if it has no room."""
    total_m_s = generator.uniform(0.1, 1.0 / 3.0) * SPEED_M_S
    gust_m_s = rounded(generator.uniform(0.1, 0.5) * total_m_s)
    wind = Wind(
        from_deg=degrees(generator.uniform(0.0, math.tau)), speed_m_s=rounded(total_m_s - gust_m_s), gust_m_s=gust_m_s
    )
    discs = scattered(generator, int(generator.integers(8, 21)), generator.uniform(0.1, 0.4), (200.0, 800.0))
    n_max = generator.uniform(*N_MAX)
    # The circle over the ground, at the speed with the wind behind.
    widest_m = ground_turn_radius_m(SPEED_M_S, n_max, wind.speed_m_s + wind.gust_m_s)
    mission = single(generator, f"{name}-{total_m_s / SPEED_M_S:.2f}v", discs, widest_m)
    agent = mission.agents[0].model_copy(update={"n_max": rounded(n_max, 4)})
    # Against the wind the straight line takes longer.
    slowest_share = 1.0 - total_m_s / SPEED_M_S
    return mission.model_copy(
        update={"agents": (agent,), "wind": wind, "max_time_s": rounded(mission.max_time_s / slowest_share)}
    )
