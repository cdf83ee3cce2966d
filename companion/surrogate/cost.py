"""The paper's cost: what the guidance law is meant to minimise, and what the surrogate approximates.

The step penalties and their continuous polygon are one family: half-width 0 is the step (F), a positive one the polygon
(F~). Lost agents are simply not in the scene, so their terms vanish (docs/method.md section 1, point 8).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Weights:
    """Penalty weights in m^2; the defaults are the paper's 1e5 and 1e4 km^2 (docs/method.md section 1)."""

    k_d: float = 1e11
    """Detection: for each threat whose detection radius the agent is within."""
    k_a: float = 1e11
    """Attack: for each threat whose attack radius the agent is within."""
    k_c: float = 1e10
    """Collision: for each other agent within the separation."""
    k_l: float = 1e10
    """Length: for an agent whose flown and remaining distance exceed its range."""


@dataclass(frozen=True)
class Scene:
    """N agents with their assigned targets among M threats, at one instant.

    Raises ValueError if shapes do not agree, or if a radius, the separation or a range is not positive.
    """

    agents_ned_m: np.ndarray  # (N, 2)
    targets_ned_m: np.ndarray  # (N, 2), row i is the target assigned to agent i
    threats_ned_m: np.ndarray  # (M, 2)
    detection_radius_m: np.ndarray  # (M,)
    attack_radius_m: np.ndarray  # (M,)
    separation_m: float
    flown_m: np.ndarray  # (N,), distance flown so far
    range_m: np.ndarray  # (N,), range budget, may be infinite

    def __post_init__(self) -> None:
        agents, threats = len(self.agents_ned_m), len(self.threats_ned_m)
        expected = {
            "agents_ned_m": (agents, 2),
            "targets_ned_m": (agents, 2),
            "threats_ned_m": (threats, 2),
            "detection_radius_m": (threats,),
            "attack_radius_m": (threats,),
            "flown_m": (agents,),
            "range_m": (agents,),
        }
        for name, shape in expected.items():
            if np.shape(getattr(self, name)) != shape:
                raise ValueError(f"{name} has shape {np.shape(getattr(self, name))}, not {shape}")
        for name in ("detection_radius_m", "attack_radius_m", "separation_m", "range_m"):
            if not np.all(np.asarray(getattr(self, name)) > 0.0):
                raise ValueError(f"{name} must be positive")


def unit_disc_indicator(ratio: np.ndarray, half_width: float = 0.0) -> np.ndarray:
    """Return 1 inside the unit disc and 0 outside, for distance/radius `ratio`, any shape, dimensionless.

    With a positive `half_width` (a fraction of the radius) the step becomes the linear ramp from 1 - half_width to
    1 + half_width, the paper's g(x) moved from (-1, 1) to (0, 1). The edge itself counts as inside, as in fun2.
    """
    if half_width == 0.0:
        return np.where(ratio <= 1.0, 1.0, 0.0)
    ramp: np.ndarray = np.clip((1.0 + half_width - ratio) / (2.0 * half_width), 0.0, 1.0)
    return ramp


def distance_cost(scene: Scene) -> np.ndarray:
    """Return f1 = |U - T|^2 / 2 of each agent, (N,), m^2 (paper: fun1)."""
    offset_m = scene.agents_ned_m - scene.targets_ned_m  # (N, 2)
    half_squares: np.ndarray = 0.5 * np.sum(offset_m**2, axis=1)
    return half_squares


def threat_penalty(scene: Scene, weights: Weights, half_width: float = 0.0) -> np.ndarray:
    """Return f2 of each agent, (N,), m^2 (paper: fun2); `half_width` as in `unit_disc_indicator`."""
    distance_m = _distances(scene.agents_ned_m, scene.threats_ned_m)  # (N, M)
    detected = unit_disc_indicator(distance_m / scene.detection_radius_m, half_width)
    attacked = unit_disc_indicator(distance_m / scene.attack_radius_m, half_width)
    penalty: np.ndarray = np.sum(weights.k_d * detected + weights.k_a * attacked, axis=1)
    return penalty


def collision_penalty(scene: Scene, weights: Weights, half_width: float = 0.0) -> np.ndarray:
    """Return f3 of each agent, (N,), m^2 (paper: fun3); `half_width` as in `unit_disc_indicator`.

    The sum is over j != i, whereas the paper's counts the agent itself too (docs/method.md section 2, point 8).
    """
    ratio = _distances(scene.agents_ned_m, scene.agents_ned_m) / scene.separation_m  # (N, N)
    near = unit_disc_indicator(ratio, half_width)
    np.fill_diagonal(near, 0.0)
    penalty: np.ndarray = weights.k_c * np.sum(near, axis=1)
    return penalty


def range_penalty(scene: Scene, weights: Weights, half_width: float = 0.0) -> np.ndarray:
    """Return f4 of each agent, (N,), m^2 (paper: fun4); `half_width` is a fraction of the range."""
    needed_m = scene.flown_m + np.sqrt(2.0 * distance_cost(scene))
    penalty: np.ndarray = weights.k_l * (1.0 - unit_disc_indicator(needed_m / scene.range_m, half_width))
    return penalty


def penalty_sum(scene: Scene, weights: Weights, half_width: float = 0.0) -> float:
    """Return F = sum (f2 + f3 + f4), m^2 (paper: fun5), or with a positive `half_width` its polygon F~."""
    per_agent = (
        threat_penalty(scene, weights, half_width)
        + collision_penalty(scene, weights, half_width)
        + range_penalty(scene, weights, half_width)
    )
    return float(np.sum(per_agent))


def total_cost(scene: Scene, weights: Weights) -> float:
    """Return H = sum f1 + F, m^2 (paper: newobjfun)."""
    return float(np.sum(distance_cost(scene))) + penalty_sum(scene, weights)


def _distances(from_ned_m: np.ndarray, to_ned_m: np.ndarray) -> np.ndarray:
    """Return the distances between each of A points (A, 2) and each of B points (B, 2), (A, B), m."""
    offset_m = from_ned_m[:, np.newaxis, :] - to_ned_m[np.newaxis, :, :]
    distance_m: np.ndarray = np.sqrt(np.sum(offset_m**2, axis=2))
    return distance_m
