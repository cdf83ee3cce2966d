"""The paper's steering: attraction, surrogate gradient, loiter circles (docs/method.md section 1, points 3 to 5)."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from companion.geo.kinematics import advance, turn_rate_rad_s
from companion.guidance.view import NOBODY, View
from companion.surrogate.cost import Weights
from companion.surrogate.networks import MonolithicNetwork, slots
from companion.surrogate.profiles import RadialProfile, ThreatDiscs, gradient_for_agent

LOITER_RADII = 1.5
"""Radius of a loiter circle in least turn radii, so that the turn limit leaves room for corrections."""
LOITER_STEPS = 2.0
"""Least radius of a loiter circle in the lengths flown in a guidance step, so that a step's chord stays near it."""
LOITER_CAPTURE = 2.0
"""Gain that steers onto the loiter circle: tangent of the course correction per radius of distance from the circle."""
LOITER_WIND_RADII = 1.2
"""Least radius of a loiter circle in turn radii down the greatest wind: over the ground no tighter circle can be flown.
"""
_RINGS = np.array(
    [(0.0, 0.0)]
    + [
        (0.5 * ring * math.cos(math.tau * k / 12), 0.5 * ring * math.sin(math.tau * k / 12))
        for ring in range(1, 9)
        for k in range(12)
    ]
)
"""Candidates for a loiter place, in spacings from the position (north, east), nearest first."""


@dataclass(frozen=True)
class SteeringVector:
    """A wanted direction; its length, in metres like the gradient of f1, is its weight against other directions."""

    north_m: float
    east_m: float

    @property
    def heading_rad(self) -> float:
        """Heading of the vector, clockwise from north, in [0, 2 pi)."""
        return math.atan2(self.east_m, self.north_m) % math.tau

    @property
    def strength_m(self) -> float:
        """Length of the vector."""
        return math.hypot(self.north_m, self.east_m)


class Surrogate(Protocol):
    """F*, the smooth surrogate of the penalties that depend on positions, for one vehicle."""

    def gradient_m(self, position_ned_m: tuple[float, float], view: View) -> np.ndarray:  # (2,)
        """Return dF*/dU, in metres, with respect to this vehicle's position, among the threats and peers of a view."""
        ...


@dataclass(frozen=True)
class PairSurrogate:
    """F* as a sum over pairs, each a radial profile of one distance (docs/method.md section 2, point 2)."""

    profile: RadialProfile
    separation_m: float
    weights: Weights

    def gradient_m(self, position_ned_m: tuple[float, float], view: View) -> np.ndarray:
        """Return dF*/dU, (2,) m, summed over the threats' two radii and the peers of the view."""
        return gradient_for_agent(
            self.profile,
            np.array(position_ned_m),
            ThreatDiscs(view.threats_ned_m, view.detection_radius_m, view.attack_radius_m),
            view.peers_ned_m,
            self.separation_m,
            self.weights,
        )


@dataclass(frozen=True)
class MonolithicSurrogate:
    """F* as the paper's single network of all positions; the inputs of unknown agents and threats are zero."""

    network: MonolithicNetwork
    agent_id: int

    def gradient_m(self, position_ned_m: tuple[float, float], view: View) -> np.ndarray:
        """Return dF*/dU, (2,) m, as the network gives it for this agent among all those of the view."""
        known = view.peer_ids != NOBODY
        ids = np.append(view.peer_ids[known], self.agent_id)
        places_ned_m = np.vstack((view.peers_ned_m[known], position_ned_m))
        gradient_m: np.ndarray = self.network.gradient(
            slots(ids, places_ned_m, self.network.agents),
            slots(view.threat_ids, view.threats_ned_m, self.network.threats),
        )[self.agent_id - 1]
        return gradient_m


def attraction(position_ned_m: tuple[float, float], target_ned_m: tuple[float, float]) -> SteeringVector:
    """Return the attraction -(U - T), the negative gradient of f1 (paper: fun1, direct1)."""
    return SteeringVector(target_ned_m[0] - position_ned_m[0], target_ned_m[1] - position_ned_m[1])


def loiter_radius_m(speed_m_s: float, n_max: float, dt_s: float, wind_m_s: float = 0.0) -> float:
    """Return the radius at which a vehicle that cannot stop circles its loiter place, in a wind of up to `wind_m_s`."""
    rate_rad_s = turn_rate_rad_s(speed_m_s, n_max)
    windward = 1.0 + wind_m_s / speed_m_s
    radii = max(LOITER_RADII, LOITER_WIND_RADII * windward * windward if wind_m_s else 0.0)
    return max(radii * speed_m_s / max(rate_rad_s, sys.float_info.min), LOITER_STEPS * speed_m_s * windward * dt_s)


def loiter_attraction(
    position_ned_m: tuple[float, float], place_ned_m: tuple[float, float], radius_m: float
) -> SteeringVector:
    """Return the steering vector that leads onto a clockwise circle about a place.

    On the circle the vector is tangent to it, far outside it points towards the place, and inside it points outwards.
    Its length is the distance to the place, but at least the circle's radius.
    """
    north_m, east_m = position_ned_m[0] - place_ned_m[0], position_ned_m[1] - place_ned_m[1]
    distance_m = math.hypot(north_m, east_m)
    bearing_rad = math.atan2(east_m, north_m)
    excess = (distance_m - radius_m) / radius_m
    course_rad = bearing_rad + math.pi / 2 + math.atan(LOITER_CAPTURE * excess)
    strength_m = max(distance_m, radius_m)
    return SteeringVector(strength_m * math.cos(course_rad), strength_m * math.sin(course_rad))


def circling(
    pose: tuple[float, float, float], speed_m_s: float, lead_s: float, place_ned_m: tuple[float, float], radius_m: float
) -> SteeringVector:
    """Return the steering vector of a vehicle that circles a place, from its north (m), east (m) and heading (rad).

    A heading is flown from the reaction time on and for a step: what counts is where the vehicle is `lead_s` later.
    """
    north_m, east_m, _ = advance(*pose, speed_m_s, 0.0, lead_s)
    return loiter_attraction((north_m, east_m), place_ned_m, radius_m)


def loiter_spacing_m(separation_m: float, radius_m: float) -> float:
    """Return the least distance between loiter places: 2 D_safe, or more to keep the loiter circles D_safe apart."""
    return max(2.0 * separation_m, separation_m + 2.0 * radius_m)


def claim_m(separation_m: float, radius_m: float) -> float:
    """Return how far off a target a vehicle must loiter so that another can reach it by the right of way, m.

    The vehicle's reserved disc wanders with its loiter circle, whose radius is given (0 for one that can stop), and
    that of the other lies to the right of its target, whichever way it comes.
    """
    return max(2.0 * separation_m, separation_m + (2.0 / LOITER_RADII + 1.0) * radius_m)


class Occupied(NamedTuple):
    """Where others will be who need room, and how much of it each."""

    places_ned_m: np.ndarray  # (Q, 2) m, vehicles that loiter
    spacing_m: float
    claimed_ned_m: np.ndarray  # (C, 2) m, targets that others are on their way to
    claim_m: float


def loiter_place(
    position_ned_m: tuple[float, float], occupied: Occupied, before_ned_m: tuple[float, float] | None = None
) -> tuple[float, float]:
    """Return the place to loiter at: that of before unless it lies on another's way, or one near the position.

    A place must keep the spacing from every vehicle that loiters, and from every target that others are on their way
    to. The candidates are the position itself and points on rings about it, nearest first. If none is free, it is the
    place of before, or the position itself.
    """
    if before_ned_m is not None:
        to_claims_m = occupied.claimed_ned_m - np.array(before_ned_m)
        if np.all(np.hypot(to_claims_m[:, 0], to_claims_m[:, 1]) >= occupied.claim_m):
            return before_ned_m
    candidates_ned_m = np.array(position_ned_m) + max(occupied.spacing_m, occupied.claim_m) * _RINGS  # (K, 2)
    free = np.ones(len(_RINGS), dtype=bool)
    for others_ned_m, spacing_m in (occupied[:2], occupied[2:]):
        apart_m = candidates_ned_m[:, None] - others_ned_m[None]  # (K, Q, 2)
        free &= np.all(np.hypot(apart_m[..., 0], apart_m[..., 1]) >= spacing_m, axis=1)
    if not free.any():
        return before_ned_m or position_ned_m
    north_m, east_m = candidates_ned_m[int(np.argmax(free))].tolist()
    return north_m, east_m


def direction(pull: SteeringVector, gradient_m: np.ndarray) -> SteeringVector:
    """Return the direction d = -dF*/dU + attraction (paper: direct1); `gradient_m`, (2,), is the surrogate's."""
    return SteeringVector(pull.north_m - float(gradient_m[0]), pull.east_m - float(gradient_m[1]))
