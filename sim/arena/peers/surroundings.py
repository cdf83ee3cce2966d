"""The discs that the published methods steer among, from the picture that our laws have too (`guidance.view.View`).

None of the methods takes the age of a report into account: here a threat becomes a disc that holds it now, and another
agent becomes a disc of the separation to keep.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from companion.geo.kinematics import turn_rate_rad_s
from companion.guard.types import Motion
from companion.guidance.laws import LOOK_AHEAD_S, Task
from companion.guidance.settings import LawSettings
from companion.guidance.steering import SteeringVector
from companion.guidance.view import View

MARGIN_M = 2.0
"""Least margin outside the discs that every method is given."""
MARGIN_STEPS = 0.05
"""Margin as a share of the distance flown in a guidance step, used where that is more than MARGIN_M."""
_NEAREST_M = 1e-6
"""Least distance that is used in a division, so that nothing divides by zero."""


@dataclass(frozen=True)
class Discs:
    """Moving discs to keep out of, the margin included: first the threats, then the other agents."""

    centres_ned_m: np.ndarray  # (D, 2) m, now
    radius_m: np.ndarray  # (D,) m
    velocity_m_s: np.ndarray  # (D, 2) m/s
    threats: int
    """Number of the discs that are threats."""


@dataclass(frozen=True)
class Scale:
    """Lengths of a vehicle by which the methods' parameters are scaled."""

    speed_m_s: float
    step_m: float
    """Distance flown in a guidance step."""
    turn_radius_m: float
    """Turn radius at the least turn rate and the greatest ground speed that the configuration allows for, as in
    RoutedLaw."""
    margin_m: float
    """Margin outside the discs that every method is given."""
    separation_m: float


def scale_of(settings: LawSettings) -> Scale:
    """Return the lengths that a law's settings imply."""
    limits = settings.limits
    step_m = limits.speed_m_s * settings.guidance_step_s
    ground_m_s = limits.speed_m_s + limits.wind_m_s
    rate_rad_s = limits.rate_share * turn_rate_rad_s(limits.speed_m_s, limits.n_max)
    return Scale(
        speed_m_s=limits.speed_m_s,
        step_m=step_m,
        turn_radius_m=ground_m_s * ground_m_s / (limits.speed_m_s * rate_rad_s),
        margin_m=max(MARGIN_M, MARGIN_STEPS * step_m),
        separation_m=settings.separation_m,
    )


def discs_around(view: View, scale: Scale) -> Discs:
    """Return the discs that hold the threats now, and those of the other agents.

    A threat is taken to have flown on with its last reported velocity; how far it may be from there, within its speed
    bound, stays in the radius. Agents that the vehicle's own detector does not see are taken to stand still where dead
    reckoning has them.
    """
    heard_m_s = np.hypot(view.threat_velocity_m_s[:, 0], view.threat_velocity_m_s[:, 1])
    explained_m = np.minimum(heard_m_s, view.threat_speed_m_s) * view.threat_age_s
    seen = len(view.traffic_ned_m)
    agent_velocity_m_s = np.zeros_like(view.peers_ned_m)
    if seen:
        # The picture lists those that are seen last, in the detector's order.
        agent_velocity_m_s[-seen:] = view.traffic_velocity_m_s
    threats_ned_m = view.threats_ned_m + view.threat_velocity_m_s * view.threat_age_s[:, np.newaxis]
    return Discs(
        centres_ned_m=np.concatenate((threats_ned_m, view.peers_ned_m)),
        radius_m=np.concatenate(
            (view.detection_radius_m - explained_m, np.full(len(view.peers_ned_m), scale.separation_m))
        )
        + scale.margin_m,
        velocity_m_s=np.concatenate((view.threat_velocity_m_s, agent_velocity_m_s)),
        threats=len(threats_ned_m),
    )


def discs_foreseen(view: View, motion: Motion, scale: Scale) -> Discs:
    """Return each disc where it will be when the vehicle could be there.

    They are predicted as our route predicts them (`foreseen` in guidance/laws.py), for methods that know only of
    obstacles that stand still.
    """
    discs = discs_around(view, scale)
    gap_m = distances_m(discs, motion.position_ned_m)[1] - discs.radius_m
    ahead_s = np.clip(gap_m / scale.speed_m_s, 0.0, LOOK_AHEAD_S)
    return replace(discs, centres_ned_m=discs.centres_ned_m + discs.velocity_m_s * ahead_s[:, np.newaxis])


def distances_m(discs: Discs, position_ned_m: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the offsets (D, 2) m of the centres from a position, and their lengths (D,) m, never zero."""
    offset_m = discs.centres_ned_m - np.array(position_ned_m)
    return offset_m, np.maximum(np.hypot(offset_m[:, 0], offset_m[:, 1]), _NEAREST_M)


def goal_of(task: Task, motion: Motion) -> tuple[float, float]:
    """Return the distance in m and the bearing in rad to the place where the vehicle is to be."""
    north_m, east_m = task.place_ned_m[0] - motion.north_m, task.place_ned_m[1] - motion.east_m
    return math.hypot(north_m, east_m), math.atan2(east_m, north_m)


def heading_for(heading_rad: float, strength_m: float) -> SteeringVector:
    """Return the steering vector along a heading, with `strength_m` as its length."""
    return SteeringVector(strength_m * math.cos(heading_rad), strength_m * math.sin(heading_rad))


def wrapped(angle_rad: np.ndarray) -> np.ndarray:  # (...) rad
    """Return angles wrapped to [-pi, pi)."""
    turned: np.ndarray = (angle_rad + math.pi) % math.tau - math.pi
    return turned


def ray_margins_m(discs: Discs, begins_m: np.ndarray, ends_m: np.ndarray) -> np.ndarray:  # (S, 2), (S, 2) -> (S,) m
    """Return the least distance of each straight ray from the edges of the discs, negative inside; inf without any."""
    along_m = ends_m - begins_m
    length2_m2 = np.maximum(np.einsum("si,si->s", along_m, along_m), _NEAREST_M**2)
    north_m = discs.centres_ned_m[:, 0] - begins_m[:, :1]
    east_m = discs.centres_ned_m[:, 1] - begins_m[:, 1:]
    share = (north_m * along_m[:, :1] + east_m * along_m[:, 1:]) / length2_m2[:, np.newaxis]
    share = np.clip(share, 0.0, 1.0)
    apart_m = np.hypot(north_m - share * along_m[:, :1], east_m - share * along_m[:, 1:])
    margins_m: np.ndarray = (apart_m - discs.radius_m).min(axis=1, initial=math.inf)
    return margins_m
