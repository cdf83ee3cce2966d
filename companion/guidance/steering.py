"""From the picture to a wanted heading: direction, turn limit, loiter (docs/method.md section 1, points 3 to 5)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from companion.geo.kinematics import turn_rate_rad_s
from companion.guidance.view import NOBODY, View
from companion.surrogate.cost import Weights
from companion.surrogate.networks import MonolithicNetwork, slots
from companion.surrogate.profiles import RadialProfile, ThreatDiscs, gradient_for_agent

LOITER_RADII = 1.5
"""A loiter circle is this many least turn radii wide, so that the turn limit leaves something to correct with."""
LOITER_STEPS = 2.0
"""And at least this many guidance steps long, so that a step's chord does not leave the circle."""
LOITER_CAPTURE = 2.0
"""Gain of the pull onto the loiter circle, per radius of error."""
APPROACH_GAIN_1_S = 0.5
"""A vehicle that can stop nears its loiter place at this fraction of the distance per second."""


@dataclass(frozen=True)
class SteeringVector:
    """A wanted direction and how strongly it is wanted, in metres as the gradient of f1 counts them."""

    north_m: float
    east_m: float

    @property
    def heading_rad(self) -> float:
        """Heading of the pull, clockwise from north, in [0, 2 pi)."""
        return math.atan2(self.east_m, self.north_m) % math.tau

    @property
    def strength_m(self) -> float:
        """Length of the pull."""
        return math.hypot(self.north_m, self.east_m)


class Surrogate(Protocol):
    """F* as one vehicle has it: the stand-in for the penalties that depend on positions."""

    def gradient_m(self, position_ned_m: tuple[float, float], view: View) -> np.ndarray:  # (2,)
        """Return dF*/dU of this vehicle at a position in what it sees, m."""
        ...


@dataclass(frozen=True)
class PairSurrogate:
    """F* as a sum over pairs, each a radial profile of one distance (docs/method.md section 2, point 2)."""

    profile: RadialProfile
    separation_m: float
    weights: Weights

    def gradient_m(self, position_ned_m: tuple[float, float], view: View) -> np.ndarray:
        """See Surrogate."""
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
    """F* as the paper's one network of all positions; who is not known of is padded with zeros."""

    network: MonolithicNetwork
    agent_id: int

    def gradient_m(self, position_ned_m: tuple[float, float], view: View) -> np.ndarray:
        """See Surrogate."""
        known = view.peer_ids != NOBODY
        ids = np.append(view.peer_ids[known], self.agent_id)
        places_ned_m = np.vstack((view.peers_ned_m[known], position_ned_m))
        gradient_m: np.ndarray = self.network.gradient(
            slots(ids, places_ned_m, self.network.agents),
            slots(view.threat_ids, view.threats_ned_m, self.network.threats),
        )[self.agent_id - 1]
        return gradient_m


def attraction(position_ned_m: tuple[float, float], target_ned_m: tuple[float, float]) -> SteeringVector:
    """Return -(U - T), the negative gradient of f1 (paper: fun1, direct1)."""
    return SteeringVector(target_ned_m[0] - position_ned_m[0], target_ned_m[1] - position_ned_m[1])


def loiter_radius_m(speed_m_s: float, n_max: float, dt_s: float) -> float:
    """Return the radius at which a vehicle that cannot stop circles its loiter place."""
    turn_radius_m = speed_m_s / turn_rate_rad_s(speed_m_s, n_max)
    return max(LOITER_RADII * turn_radius_m, LOITER_STEPS * speed_m_s * dt_s)


def loiter_attraction(
    position_ned_m: tuple[float, float], place_ned_m: tuple[float, float], radius_m: float
) -> SteeringVector:
    """Return the pull that leads onto a clockwise circle about a place; as strong as the distance to the place.

    On the circle it points along it; far outside, at the place; inside, outwards.
    """
    north_m, east_m = position_ned_m[0] - place_ned_m[0], position_ned_m[1] - place_ned_m[1]
    distance_m = math.hypot(north_m, east_m)
    bearing_rad = math.atan2(east_m, north_m)
    excess = (distance_m - radius_m) / radius_m
    course_rad = bearing_rad + math.pi / 2 + math.atan(LOITER_CAPTURE * excess)
    strength_m = max(distance_m, radius_m)
    return SteeringVector(strength_m * math.cos(course_rad), strength_m * math.sin(course_rad))


def loiter_spacing_m(separation_m: float, radius_m: float) -> float:
    """Return how far apart loiter places must be: 2 D_safe, or more if the circles themselves would come closer."""
    return max(2.0 * separation_m, separation_m + 2.0 * radius_m)


def loiter_place(
    position_ned_m: tuple[float, float],
    peers_ned_m: np.ndarray,  # (P, 2) m
    spacing_m: float,
) -> tuple[float, float]:
    """Return a place near a position that keeps the spacing from every one of the peers.

    Candidates are the position itself and points of rings about it, the nearest first; if none is free, the position.
    """
    north_m, east_m = position_ned_m
    rings = [(0.0, 1)] + [(spacing_m * k / 2, 12) for k in range(1, 9)]
    for ring_m, count in rings:
        for index in range(count):
            angle_rad = math.tau * index / count
            place = (north_m + ring_m * math.cos(angle_rad), east_m + ring_m * math.sin(angle_rad))
            apart_m = np.hypot(peers_ned_m[:, 0] - place[0], peers_ned_m[:, 1] - place[1])
            if np.all(apart_m >= spacing_m):
                return place
    return position_ned_m


def direction(pull: SteeringVector, gradient_m: np.ndarray) -> SteeringVector:
    """Return d = -dF*/dU + attraction (paper: direct1); `gradient_m` is the surrogate's, (2,)."""
    return SteeringVector(pull.north_m - float(gradient_m[0]), pull.east_m - float(gradient_m[1]))
