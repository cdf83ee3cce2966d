"""VFH+ (Ulrich & Borenstein 1998, ICRA): the vector field histogram with the vehicle's size and turning circles.

The discs block sectors of direction about the vehicle. Sectors that it cannot turn to before its turning circle meets a
disc are blocked too. Among the openings that are left, the candidate direction of least cost is taken.
"""

from __future__ import annotations

import math

import numpy as np

from companion.guard.types import Motion
from companion.guidance.laws import SteeringDemand, Task
from companion.guidance.settings import LawSettings
from companion.guidance.view import View
from sim.arena.peers.surroundings import Discs, discs_foreseen, distances_m, goal_of, heading_for, scale_of, wrapped

SECTORS = 72
"""Number of sectors, at the paper's angular resolution of 5 degrees."""
SECTOR_RAD = math.tau / SECTORS
WIDE_SECTORS = 8
"""The paper's s_max: an opening of more sectors is wide, and both its sides give candidates."""
GOAL_COST, HEADING_COST, PREVIOUS_COST = 5.0, 2.0, 2.0
"""The paper's mu_1, mu_2, mu_3, for a robot that is to reach a goal."""
BLOCKED_ABOVE, FREE_BELOW = 0.10, 0.05
"""The paper's tau_high and tau_low, for magnitudes that fall from 1 at a disc's edge to 0 at the window's."""
WINDOW_TURN_RADII = 8.0
"""Radius of the active window, in turn radii."""
_ARC_RAD = math.radians(5.0) * np.arange(1, 37)
"""Turns at which the turning circles are tested for a disc, up to half a circle."""


class VectorFieldHistogram:
    """Steers by VFH+, whose memory is the binary histogram and the direction chosen last."""

    def __init__(
        self, settings: LawSettings, window_turn_radii: float = WINDOW_TURN_RADII, wide_sectors: int = WIDE_SECTORS
    ) -> None:
        self._scale = scale_of(settings)
        self._window_m = max(window_turn_radii * self._scale.turn_radius_m, 8.0 * self._scale.step_m)
        self._wide = wide_sectors
        self._blocked = np.zeros(SECTORS, dtype=bool)
        self._previous_rad: float | None = None

    def steer(self, task: Task, motion: Motion, view: View, now_s: float) -> SteeringDemand:
        """Return the steering demand of this method, as SteeringLaw defines it."""
        if task.loitering:
            self._previous_rad = None
            return SteeringDemand(task.pull)
        distance_m, goal_rad = goal_of(task, motion)
        discs = discs_foreseen(view, motion, self._scale)
        self._blocked = self._binary(discs, motion, min(self._window_m, distance_m))
        left_rad, right_rad = self._reach(discs, motion)
        turn_rad = wrapped(sector_headings_rad() - motion.heading_rad)
        half_rad = SECTOR_RAD / 2.0  # the sector of the heading itself is always within reach
        masked = self._blocked | (turn_rad > right_rad + half_rad) | (turn_rad < -left_rad - half_rad)
        chosen_rad = self._cheapest(masked, goal_rad, motion.heading_rad)
        if chosen_rad is None:
            # The paper's robot would stop: go on turning to the side where the turning circle is clear for longer.
            side = 1.0 if right_rad >= left_rad else -1.0
            chosen_rad = motion.heading_rad + side * math.pi / 2.0
        self._previous_rad = chosen_rad
        return SteeringDemand(heading_for(chosen_rad, distance_m))

    def _binary(self, discs: Discs, motion: Motion, window_m: float) -> np.ndarray:  # (SECTORS,)
        """Return the binary polar histogram: True where blocked; between the thresholds a sector stays as it was."""
        offset_m, apart_m = distances_m(discs, motion.position_ned_m)
        edge_m = np.maximum(apart_m - discs.radius_m, 0.0)
        magnitude = np.maximum(0.0, 1.0 - (edge_m / window_m) ** 2)
        bearing_rad = np.arctan2(offset_m[:, 1], offset_m[:, 0])
        # Inside a disc the half plane towards its centre is blocked, so that the vehicle leaves.
        half_rad = np.arcsin(np.minimum(1.0, discs.radius_m / apart_m))
        covered = np.abs(wrapped(sector_headings_rad() - bearing_rad[:, np.newaxis])) <= half_rad[:, np.newaxis]
        density = magnitude @ covered
        held: np.ndarray = (density > BLOCKED_ABOVE) | (self._blocked & (density >= FREE_BELOW))
        return held

    def _reach(self, discs: Discs, motion: Motion) -> tuple[float, float]:
        """Return how far in rad the vehicle can turn left and right before its turning circle meets a disc."""
        radius_m = self._scale.turn_radius_m
        ahead_m, aside_m = radius_m * np.sin(_ARC_RAD), radius_m * (1.0 - np.cos(_ARC_RAD))
        reach_rad = []
        for side in (-1.0, 1.0):
            cosine, sine = math.cos(motion.heading_rad), math.sin(motion.heading_rad)
            north_m = motion.north_m + ahead_m * cosine - side * aside_m * sine
            east_m = motion.east_m + ahead_m * sine + side * aside_m * cosine
            apart_m = np.hypot(
                discs.centres_ned_m[:, :1] - north_m, discs.centres_ned_m[:, 1:] - east_m
            )  # (D, turns) m
            hit = (apart_m < discs.radius_m[:, np.newaxis]).any(axis=0)
            first = int(np.argmax(hit)) if hit.any() else len(_ARC_RAD)
            reach_rad.append(math.pi if first == len(_ARC_RAD) else float(_ARC_RAD[first] - _ARC_RAD[0]))
        return reach_rad[0], reach_rad[1]

    def _cheapest(self, masked: np.ndarray, goal_rad: float, heading_rad: float) -> float | None:
        """Return the candidate direction of least cost, None if no sector is free."""
        candidates = np.array(candidates_rad(masked, goal_rad, self._wide))
        if not candidates.size:
            return None
        previous_rad = heading_rad if self._previous_rad is None else self._previous_rad
        cost = (
            GOAL_COST * np.abs(wrapped(candidates - goal_rad))
            + HEADING_COST * np.abs(wrapped(candidates - heading_rad))
            + PREVIOUS_COST * np.abs(wrapped(candidates - previous_rad))
        )
        return float(candidates[int(np.argmin(cost))])


def sector_headings_rad() -> np.ndarray:  # (SECTORS,) rad
    """Return the headings of the middles of the sectors."""
    return SECTOR_RAD * np.arange(SECTORS)


def candidates_rad(masked: np.ndarray, goal_rad: float, wide_sectors: int) -> list[float]:
    """Return the candidate directions in rad of the openings between masked sectors (SECTORS,).

    A narrow opening gives its middle; a wide one gives a direction half of `wide_sectors` inside each edge, and the
    goal's own if it lies between them.
    """
    if masked.all():
        return []
    if not masked.any():
        return [goal_rad]
    begins = np.flatnonzero(~masked & np.roll(masked, 1))
    found: list[float] = []
    for begin in begins:
        beyond = np.flatnonzero(np.roll(masked, -int(begin)))
        width = int(beyond[0])
        if width <= wide_sectors:
            found.append(SECTOR_RAD * (begin + (width - 1) / 2.0))
            continue
        first_rad = SECTOR_RAD * (begin + wide_sectors / 2.0)
        span_rad = SECTOR_RAD * (width - 1 - wide_sectors)
        found += [first_rad, first_rad + span_rad]
        if (goal_rad - first_rad) % math.tau <= span_rad:
            found.append(goal_rad)
    return found
