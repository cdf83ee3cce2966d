"""BendyRuler, ArduPilot's path planning around obstacles, after the description that its wiki publishes.

It probes straight rays in many directions, and takes the one nearest to the target's bearing that is open over the
look-ahead and from whose end a second ray is open too. It resists large changes of a bearing once chosen. The code is
written anew, for pictures of one-way broadcasts. The original is a planner for copters and rovers, which can stop.
"""

from __future__ import annotations

import math

import numpy as np

from companion.guard.types import Motion
from companion.guidance.laws import SteeringDemand, Task
from companion.guidance.settings import LawSettings
from companion.guidance.view import View
from sim.arena.peers.surroundings import Discs, discs_foreseen, goal_of, heading_for, ray_margins_m, scale_of

BEARING_STEP_RAD = math.radians(5.0)
GREATEST_BEARING_RAD = math.radians(170.0)
SECOND_BEARINGS_RAD = np.radians([0.0, 45.0, -45.0])
"""Bearings of the second ray, relative to the bearing of the target from the end of the first ray."""
LOOK_AHEAD_TURN_RADII = 8.0
"""ArduPilot's OA_BR_LOOKAHEAD in turn radii: it must show obstacles early enough to turn away from them."""
MARGIN_TURN_RADII = 0.0
"""ArduPilot's OA_MARGIN_MAX in turn radii, added to the margin common to all methods."""
CHANGE_RAD = math.radians(75.0)
"""ArduPilot's OA_BR_CONT_ANGLE: a change of bearing by more than this must be justified by CHANGE_RATIO."""
CHANGE_RATIO = 1.5
"""ArduPilot's OA_BR_CONT_RATIO: a new bearing after a large change needs this many times the margin of the held one."""
SHRINK, GROW, LEAST_SHARE = 0.9, 1.1, 0.5
"""Factors of the look-ahead per step: SHRINK while no ray is open, down to LEAST_SHARE of its full length, else GROW,
up to the full length."""
_TIE_M = 1e-6


def _offsets_rad() -> np.ndarray:  # (B,) rad
    """Return the bearings to try, relative to the target's: the nearest first, left before right."""
    sides = BEARING_STEP_RAD * np.arange(1, round(GREATEST_BEARING_RAD / BEARING_STEP_RAD) + 1)
    return np.concatenate(([0.0], np.column_stack((-sides, sides)).ravel()))


OFFSETS_RAD = _offsets_rad()


class BendyRuler:
    """Chooses a bearing at every guidance step; ArduPilot does so once a second."""

    def __init__(
        self,
        settings: LawSettings,
        look_ahead_turn_radii: float = LOOK_AHEAD_TURN_RADII,
        margin_turn_radii: float = MARGIN_TURN_RADII,
    ) -> None:
        self._scale = scale_of(settings)
        self._full_m = max(look_ahead_turn_radii * self._scale.turn_radius_m, 4.0 * self._scale.step_m)
        self._margin_m = margin_turn_radii * self._scale.turn_radius_m
        self._look_ahead_m = self._full_m
        self._held_rad: float | None = None
        self._held_for: tuple[float, float] | None = None

    def steer(self, task: Task, motion: Motion, view: View, now_s: float) -> SteeringDemand:
        """Return the steering demand of this method, as SteeringLaw defines it."""
        if task.loitering:
            self._held_rad = None
            return SteeringDemand(task.pull)
        if task.place_ned_m != self._held_for:
            self._held_rad, self._held_for = None, task.place_ned_m
        discs = discs_foreseen(view, motion, self._scale)
        distance_m, goal_rad = goal_of(task, motion)
        ahead_m = min(self._look_ahead_m, distance_m)
        bearing_rad, margin_m, resistible = self._choose(discs, task, motion, goal_rad, ahead_m)
        if resistible:
            bearing_rad = self._resist(discs, motion, bearing_rad, margin_m, ahead_m)
        self._held_rad = bearing_rad
        return SteeringDemand(heading_for(bearing_rad, distance_m))

    def _choose(
        self, discs: Discs, task: Task, motion: Motion, goal_rad: float, ahead_m: float
    ) -> tuple[float, float, bool]:
        """Return the bearing, the margin on its first ray in m, and whether it differs from the target's bearing."""
        bearings_rad = goal_rad + OFFSETS_RAD
        here = np.array(motion.position_ned_m)
        ends_m = here + ahead_m * np.column_stack((np.cos(bearings_rad), np.sin(bearings_rad)))
        margins_m = ray_margins_m(discs, np.broadcast_to(here, ends_m.shape), ends_m)
        onward = (margins_m > self._margin_m) & self._second_open(discs, task, ends_m)
        if onward.any():
            self._look_ahead_m = min(self._full_m, GROW * self._look_ahead_m)
            first = int(np.argmax(onward))
        else:
            self._look_ahead_m = max(LEAST_SHARE * self._full_m, SHRINK * self._look_ahead_m)
            first = int(np.argmax(margins_m >= margins_m.max() - _TIE_M))
        return float(bearings_rad[first]), float(margins_m[first]), first != 0

    def _second_open(self, discs: Discs, task: Task, ends_m: np.ndarray) -> np.ndarray:  # (B, 2) m -> (B,)
        left_m = np.array(task.place_ned_m) - ends_m
        length_m = np.minimum(self._look_ahead_m, np.hypot(left_m[:, 0], left_m[:, 1]))
        bearings_rad = np.arctan2(left_m[:, 1], left_m[:, 0])[:, np.newaxis] + SECOND_BEARINGS_RAD
        along = np.stack((np.cos(bearings_rad), np.sin(bearings_rad)), axis=-1)
        begins_m = np.repeat(ends_m, len(SECOND_BEARINGS_RAD), axis=0)
        seconds_m = begins_m + (length_m[:, np.newaxis, np.newaxis] * along).reshape(-1, 2)
        margins_m = ray_margins_m(discs, begins_m, seconds_m).reshape(len(ends_m), -1)
        opened: np.ndarray = margins_m.max(axis=1) > self._margin_m
        return opened

    def _resist(self, discs: Discs, motion: Motion, bearing_rad: float, margin_m: float, ahead_m: float) -> float:
        """Return the bearing held so far in place of a very different one that is not much more open."""
        if self._held_rad is None or abs(math.remainder(bearing_rad - self._held_rad, math.tau)) <= CHANGE_RAD:
            return bearing_rad
        here = np.array([motion.position_ned_m])
        end_m = here + ahead_m * np.array([[math.cos(self._held_rad), math.sin(self._held_rad)]])
        held_m = float(ray_margins_m(discs, here, end_m)[0])
        return bearing_rad if margin_m > CHANGE_RATIO * held_m else self._held_rad
