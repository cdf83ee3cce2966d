"""Optimal reciprocal collision avoidance, ORCA (van den Berg, Guy, Lin & Manocha 2011, Robotics Research, STAR 70).

Every other agent and every threat permits a half plane of velocities. Towards an agent the vehicle makes half of the
change of velocity that is needed, towards a threat the whole. The vehicle keeps its speed, so the velocities to choose
from are a circle, not the paper's disc.
"""

from __future__ import annotations

import math

import numpy as np

from companion.guard.types import Motion
from companion.guidance.laws import SteeringDemand, Task
from companion.guidance.settings import LawSettings
from companion.guidance.view import View
from sim.arena.peers.surroundings import (
    Discs,
    Scale,
    discs_around,
    distances_m,
    goal_of,
    heading_for,
    scale_of,
    wrapped,
)

AGENT_HORIZON_S = 10.0
"""Time horizon tau towards other agents."""
THREAT_HORIZON_TURN_RADII = 3.0
"""Time horizon tau towards threats, as the number of turn radii flown in it."""
TRACKING_SHARE = 0.1
"""Share of the turn radius that is added to every disc's radius, because a course is not changed at once (NH-ORCA adds
a tracking error)."""
RECIPROCAL_SHARE, WHOLE_SHARE = 0.5, 1.0
"""Shares of the needed change of velocity that the vehicle makes: towards agents, which make the rest, and towards
threats."""
_TOLERANCE_M_S = 1e-6
_LENGTH_M_S = 1e-9
_GRID_RAD = np.radians(np.arange(360.0))


class ReciprocalAvoidance:
    """Steers by the present positions and velocities alone, without memory."""

    def __init__(
        self,
        settings: LawSettings,
        agent_horizon_s: float = AGENT_HORIZON_S,
        threat_horizon_turn_radii: float = THREAT_HORIZON_TURN_RADII,
        tracking_share: float = TRACKING_SHARE,
    ) -> None:
        self._scale = scale_of(settings)
        self._step_s = settings.guidance_step_s
        self._agent_horizon_s = max(agent_horizon_s, 2.0 * self._step_s)
        threat_horizon_s = threat_horizon_turn_radii * self._scale.turn_radius_m / self._scale.speed_m_s
        self._threat_horizon_s = max(threat_horizon_s, 2.0 * self._step_s)
        self._tracking_m = tracking_share * self._scale.turn_radius_m

    def steer(self, task: Task, motion: Motion, view: View, now_s: float) -> SteeringDemand:
        """Return the steering demand of this method, as SteeringLaw defines it."""
        if task.loitering:
            return SteeringDemand(task.pull)
        distance_m, goal_rad = goal_of(task, motion)
        normals, least_m_s = self._half_planes(discs_around(view, self._scale), motion)
        return SteeringDemand(heading_for(nearest_heading_rad(goal_rad, normals, least_m_s, self._scale), distance_m))

    def _half_planes(self, discs: Discs, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Return the half planes of permitted velocities: normals (D, 2) and least components along them (D,) m/s."""
        ours_m_s = motion.speed_m_s * np.array([math.cos(motion.heading_rad), math.sin(motion.heading_rad)])
        is_threat = np.arange(len(discs.radius_m)) < discs.threats
        horizon_s = np.where(is_threat, self._threat_horizon_s, self._agent_horizon_s)
        offset_m, apart_m = distances_m(discs, motion.position_ned_m)
        normals, change_m_s = leave_velocity_obstacle(
            offset_m, apart_m, discs.radius_m + self._tracking_m, ours_m_s - discs.velocity_m_s, horizon_s, self._step_s
        )
        share = np.where(is_threat, WHOLE_SHARE, RECIPROCAL_SHARE)
        return normals, normals @ ours_m_s + share * change_m_s


def leave_velocity_obstacle(
    offset_m: np.ndarray,  # (D, 2) m
    apart_m: np.ndarray,  # (D,) m
    radius_m: np.ndarray,  # (D,) m
    relative_m_s: np.ndarray,  # (D, 2) m/s
    horizon_s: np.ndarray,  # (D,) s
    step_s: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the outward normals (D, 2) of the velocity obstacles at their edges' nearest points, and distances.

    The distance (D,) to that point in m/s is positive where the relative velocity lies in the obstacle (u of the paper,
    along n). An obstacle whose disc the vehicle is already in is to be left within a step.
    """
    inside = apart_m <= radius_m
    cut_s = np.where(inside, step_s, horizon_s)
    from_cut_m_s = relative_m_s - offset_m / cut_s[:, np.newaxis]
    length_m_s = np.maximum(np.hypot(from_cut_m_s[:, 0], from_cut_m_s[:, 1]), _LENGTH_M_S)
    toward = np.einsum("di,di->d", from_cut_m_s, offset_m)
    on_circle = inside | ((toward < 0.0) & (toward**2 > (radius_m * length_m_s) ** 2))
    # The legs are tangents from the origin: their outward normals are the offset's direction turned by the angle
    # between the leg and the offset, and a right angle more.
    ahead = offset_m / apart_m[:, np.newaxis]
    side = np.where(ahead[:, 0] * from_cut_m_s[:, 1] - ahead[:, 1] * from_cut_m_s[:, 0] >= 0.0, 1.0, -1.0)
    sine = np.minimum(1.0, radius_m / apart_m)
    cosine = np.sqrt(1.0 - sine**2)
    across = side[:, np.newaxis] * np.column_stack((-ahead[:, 1], ahead[:, 0]))
    leg_normals = cosine[:, np.newaxis] * across - sine[:, np.newaxis] * ahead
    normals = np.where(on_circle[:, np.newaxis], from_cut_m_s / length_m_s[:, np.newaxis], leg_normals)
    change_m_s = np.where(on_circle, radius_m / cut_s - length_m_s, -np.einsum("di,di->d", leg_normals, relative_m_s))
    return normals, change_m_s


def nearest_heading_rad(
    goal_rad: float,
    normals: np.ndarray,  # (D, 2)
    least_m_s: np.ndarray,  # (D,) m/s
    scale: Scale,
) -> float:
    """Return the heading nearest to the goal's whose velocity every half plane permits.

    If there is none, it is the heading whose greatest violation is least (the paper's "safest possible" velocity).
    """
    normal_rad = np.arctan2(normals[:, 1], normals[:, 0])
    cuts = np.abs(least_m_s) < scale.speed_m_s
    half_rad = np.arccos(least_m_s[cuts] / scale.speed_m_s)
    headings_rad = np.concatenate(([goal_rad], normal_rad[cuts] - half_rad, normal_rad[cuts] + half_rad))
    permitted = _violation_m_s(headings_rad, normal_rad, least_m_s, scale) <= _TOLERANCE_M_S
    if not permitted.any():
        violation_m_s = _violation_m_s(_GRID_RAD, normal_rad, least_m_s, scale)
        return float(_GRID_RAD[int(np.argmin(violation_m_s))])
    off_rad = np.where(permitted, np.abs(wrapped(headings_rad - goal_rad)), math.inf)
    return float(headings_rad[int(np.argmin(off_rad))])


def _violation_m_s(
    headings_rad: np.ndarray,  # (H,) rad
    normal_rad: np.ndarray,  # (D,) rad
    least_m_s: np.ndarray,  # (D,) m/s
    scale: Scale,
) -> np.ndarray:  # (H,) m/s
    """Return by how much the velocity of each heading misses the half plane that it misses most."""
    reached_m_s = scale.speed_m_s * np.cos(headings_rad[:, np.newaxis] - normal_rad)
    worst_m_s: np.ndarray = (least_m_s - reached_m_s).max(axis=1, initial=-math.inf)
    return worst_m_s
