"""Artificial potential field (Khatib 1986, Int. J. Robotics Research 5(1)): the oldest reactive method, as a baseline.

The target attracts the vehicle, every disc nearer than an influence distance d0 repels it, and it heads along the sum.
"""

from __future__ import annotations

import math

import numpy as np

from companion.guard.types import Motion
from companion.guidance.laws import SteeringDemand, Task
from companion.guidance.settings import LawSettings
from companion.guidance.steering import SteeringVector
from companion.guidance.view import View
from sim.arena.peers.surroundings import discs_foreseen, distances_m, goal_of, scale_of

INFLUENCE_TURN_RADII = 2.0
"""Influence distance d0 in turn radii: a vehicle turned back at d0 has room for its half circle."""
BALANCE_SHARE = 0.5
"""Distance, as a share of d0, at which the repulsion of one disc equals the attraction; it gives the gain eta."""
NEAREST_SHARE = 0.01
"""Least distance from a disc's edge that counts, as a share of d0: nearer, and inside the disc, the repulsion grows no
further."""


class PotentialField:
    """Conic attraction, quadratic near the target, and Khatib's repulsion from the edge of every disc."""

    def __init__(
        self,
        settings: LawSettings,
        influence_turn_radii: float = INFLUENCE_TURN_RADII,
        balance_share: float = BALANCE_SHARE,
    ) -> None:
        self._scale = scale_of(settings)
        self._influence_m = max(influence_turn_radii * self._scale.turn_radius_m, 2.0 * self._scale.step_m)
        balance_m = balance_share * self._influence_m
        self._gain = balance_m**2 / (1.0 / balance_m - 1.0 / self._influence_m)

    def steer(self, task: Task, motion: Motion, view: View, now_s: float) -> SteeringDemand:
        """Return the steering demand of this method, as SteeringLaw defines it."""
        if task.loitering:
            return SteeringDemand(task.pull)
        distance_m, bearing_rad = goal_of(task, motion)
        attraction = min(1.0, distance_m / task.arrival_m)
        repulsion = self._repulsion(motion, view)
        return SteeringDemand(
            SteeringVector(
                distance_m * (attraction * math.cos(bearing_rad) + float(repulsion[0])),
                distance_m * (attraction * math.sin(bearing_rad) + float(repulsion[1])),
            )
        )

    def _repulsion(self, motion: Motion, view: View) -> np.ndarray:  # (2,), attraction = 1
        """Return the sum of eta (1/rho - 1/d0) / rho^2 away from each disc, where rho is the distance to its edge."""
        discs = discs_foreseen(view, motion, self._scale)
        offset_m, apart_m = distances_m(discs, motion.position_ned_m)
        edge_m = np.maximum(apart_m - discs.radius_m, NEAREST_SHARE * self._influence_m)
        strength = self._gain * np.maximum(0.0, 1.0 / edge_m - 1.0 / self._influence_m) / edge_m**2
        total: np.ndarray = -(strength / apart_m) @ offset_m
        return total
