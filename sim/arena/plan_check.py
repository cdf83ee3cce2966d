"""The check of a planned path: its faults, found numerically from mission and path alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from companion.mission.model import Mission
from sim.arena.plan_task import MARGIN_M, NEEDS, Task, is_inside, task_of
from sim.arena.planner import WAY_TURN_RAD, Plan
from sim.world import World

TOLERANCE_M = 0.05
"""Part of MARGIN_M that the check of a path forgives, for the interpolation between its samples."""
CHECK_STEP_M = 2.0
"""Greatest distance between two samples of the check; over such a chord an arc of 10 m radius rises by 0.05 m."""


def verify(
    mission: Mission,
    agent_id: int,
    target_ned_m: Sequence[float] | np.ndarray,
    until_s: float,
    seed: int,
    planned: Plan,
) -> list[str]:
    """Return the faults of a plan's path, found numerically from mission and path alone; none where it is legal.

    Checked are where it begins and ends, its length and time, the curvature and smoothness of each piece, that it is
    inside the fence and outside the exclusions, and the clearance from every threat at its position in `sim.world` at
    that moment, between samples of CHECK_STEP_M.
    """
    task = task_of(mission, agent_id, target_ned_m, until_s, NEEDS)
    way = planned.way
    if math.isinf(planned.length_m):
        return [] if way.size == 0 else ["a way without a length"]
    faults = _shape_faults(task, way, planned.length_m)
    if faults:
        return faults
    samples = _samples(way)
    times_s = samples[:, 0] / task.speed_m_s
    if times_s[-1] > until_s + 1e-6:
        faults.append(f"arrives after {times_s[-1]:.1f} s; allowed: {until_s:g} s")
    clearance_m, allowed_m = _clearance_m(mission, seed, times_s, samples[:, 1:]), _least_clearance_m(mission, task)
    if clearance_m < allowed_m - TOLERANCE_M:
        faults.append(f"comes within {clearance_m:.2f} m of a detection disc; allowed: {allowed_m:g} m")
    outside = [point for point in samples[:, 1:] if not is_inside(mission, (float(point[0]), float(point[1])))]
    if outside:
        faults.append(f"is outside the fence or inside an exclusion at {len(outside)} points, first at {outside[0]}")
    return faults


def _least_clearance_m(mission: Mission, task: Task) -> float:
    """Return the least distance that a path of a task keeps from any R_d."""
    radii_m = np.array([threat.detection_radius_m for threat in mission.threats])
    return float((task.radii_m - radii_m).min(initial=MARGIN_M))


def _shape_faults(task: Task, way: np.ndarray, length_m: float) -> list[str]:
    faults = []
    if way.ndim != 2 or way.shape[1:] != (3,) or not len(way) or not np.isfinite(way).all():
        return ["not a way"]
    turn_rad = np.remainder(way[0, 2] - task.heading_rad + math.pi, math.tau) - math.pi
    if np.linalg.norm(way[0, :2] - task.start_ned_m) > 1e-3 or abs(turn_rad) > 1e-6:
        faults.append("begins elsewhere than the agent")
    miss_m = float(np.linalg.norm(way[-1, :2] - task.target_ned_m)) - task.arrival_m
    if miss_m > 1e-3:
        faults.append(f"ends {miss_m:.1f} m outside the arrival circle")
    lengths_m, turns_rad, kinks_rad = _measured(way)
    if (np.abs(turns_rad) > 1.01 * WAY_TURN_RAD + 1e-9).any():
        faults.append("points too far apart to say how it turns")
    if (kinks_rad > 1e-4).any():
        faults.append(f"bends by {kinks_rad.max():.4f} rad at a point")
    if (np.abs(turns_rad) * task.turn_radius_m > lengths_m * (1 + 1e-4) + 1e-6).any():
        faults.append("turns tighter than the turn radius")
    if abs(float(lengths_m.sum()) - length_m) > 1e-3 + 1e-6 * length_m:
        faults.append(f"is {lengths_m.sum():.1f} m long and said to be {length_m:.1f} m")
    return faults


def _measured(way: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # (W, 3) -> (W - 1,) each
    """Return each piece's length m and turn rad, and by how much its chord is off the middle heading, in rad."""
    offset_m = np.diff(way[:, :2], axis=0)
    chord_m = np.linalg.norm(offset_m, axis=-1)
    turn_rad = np.remainder(np.diff(way[:, 2]) + math.pi, math.tau) - math.pi
    lengths_m = chord_m / np.sinc(0.5 * turn_rad / math.pi)
    course_rad = np.arctan2(offset_m[:, 1], offset_m[:, 0])
    kink_rad = np.abs(np.remainder(course_rad - way[:-1, 2] - 0.5 * turn_rad + math.pi, math.tau) - math.pi)
    # The direction of a chord of millimetres is rounding.
    return lengths_m, turn_rad, np.where(chord_m > 1e-3, kink_rad, 0.0)


def _samples(way: np.ndarray) -> np.ndarray:  # (S, 3) flown m, north m, east m
    """Return points of a path at most CHECK_STEP_M apart, both ends included."""
    lengths_m, turns_rad, _ = _measured(way)
    rows = [np.array([[0.0, *way[0, :2]]])]
    flown_m = 0.0
    for begin, length_m, turn_rad in zip(way[:-1], lengths_m, turns_rad, strict=True):
        share = np.arange(1, math.ceil(length_m / CHECK_STEP_M) + 1) / max(1, math.ceil(length_m / CHECK_STEP_M))
        half_rad = 0.5 * turn_rad * share
        chord_m = length_m * share * np.sinc(half_rad / math.pi)
        course_rad = begin[2] + half_rad
        rows.append(
            np.column_stack(
                (
                    flown_m + length_m * share,
                    begin[0] + chord_m * np.cos(course_rad),
                    begin[1] + chord_m * np.sin(course_rad),
                )
            )
        )
        flown_m += length_m
    return np.vstack(rows)


def _clearance_m(mission: Mission, seed: int, times_s: np.ndarray, points_m: np.ndarray) -> float:  # (S,) s, (S, 2) m
    """Return the least distance in m from points of a path to the edges of the discs, negative inside.

    The threats are where `sim.world` has them, interpolated linearly between its steps.
    """
    if not mission.threats:
        return math.inf
    radii_m = np.array([threat.detection_radius_m for threat in mission.threats])  # (M,) m
    world, step_s = World(mission, seed), mission.integration_step_s
    ticks_s = np.arange(math.ceil(times_s[-1] / step_s - 1e-9) + 2) * step_s
    agent_m = np.column_stack([np.interp(ticks_s, times_s, points_m[:, axis]) for axis in (0, 1)])
    table = []
    for tick_s, place_m in zip(ticks_s, agent_m, strict=True):
        world.advance(float(tick_s), place_m[None] if tick_s > 0.0 else None)
        table.append(world.rows()[1][:, :2])
    threats_m = np.array(table)  # (T, M, 2)
    index = np.minimum((times_s / step_s).astype(int), len(ticks_s) - 2)
    share = (times_s / step_s - index)[:, None, None]
    there_m = (1.0 - share) * threats_m[index] + share * threats_m[index + 1]  # (S, M, 2)
    return float((np.linalg.norm(there_m - points_m[:, None], axis=-1) - radii_m).min())
