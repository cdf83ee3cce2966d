"""F*, the differentiable surrogate of the step penalties, and its closed-form gradient, which steers the vehicle.

Every penalty that depends on positions is a function of one distance over one radius, so a single network f(r) serves
all pairs, any number of agents and threats, and mixed radii (docs/method.md section 2, point 2). The vehicle evaluates
this with numpy alone; torch is needed only to train. f4 depends on the distance flown as well and is not part of F*:
it has a closed form of its own (docs/method.md section 2, point 8).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from companion.errors import InputError, nearest_hint
from companion.files.weights import read_weights
from companion.surrogate.cost import Weights, unit_disc_indicator

HALF_WIDTH = 0.025
"""Half-width of the polygon, as a fraction of the radius, in law `seed` (docs/method.md section 2, point 2)."""
PROFILE_NAMES = ("pairwise", "analytic")
_FLAT = 50.0
"""Distance outside the edge, in half-widths, where a logistic's slope is exp(-100) of its greatest: negligible."""
_PACKAGED = "pairwise.json"


class RadialProfile(Protocol):
    """A function f of the scaled distance r = distance / radius that stands for the unit disc's indicator."""

    def value(self, r: np.ndarray) -> np.ndarray:
        """Return f(r), about 1 inside and 0 outside, same shape as `r`, dimensionless."""
        ...

    def slope(self, r: np.ndarray) -> np.ndarray:
        """Return df/dr, never positive, same shape as `r`, dimensionless."""
        ...


@dataclass(frozen=True)
class PairwiseNetwork:
    """The network mu + sum_j lambda_j sigma(w_j r + theta_j) of the scaled distance (paper: aprfun, one input)."""

    input_weight: np.ndarray  # (J,), w
    input_bias: np.ndarray  # (J,), theta
    output_weight: np.ndarray  # (J,), lambda
    output_bias: float  # mu

    def value(self, r: np.ndarray) -> np.ndarray:
        """Return f(r); see RadialProfile."""
        hidden = sigmoid(np.asarray(r)[..., np.newaxis] * self.input_weight + self.input_bias)
        output: np.ndarray = hidden @ self.output_weight + self.output_bias
        return output

    def slope(self, r: np.ndarray) -> np.ndarray:
        """Return df/dr; see RadialProfile."""
        hidden_slope = sigmoid_slope(np.asarray(r)[..., np.newaxis] * self.input_weight + self.input_bias)
        slope: np.ndarray = hidden_slope @ (self.output_weight * self.input_weight)
        return slope


@dataclass(frozen=True)
class AnalyticProfile:
    """A logistic of the signed distance 1 - r; its slope at the edge is the polygon's, -1 / (2 half_width)."""

    half_width: float = HALF_WIDTH  # fraction of the radius

    def value(self, r: np.ndarray) -> np.ndarray:
        """Return f(r); see RadialProfile."""
        return sigmoid((1.0 - r) * (2.0 / self.half_width))

    def slope(self, r: np.ndarray) -> np.ndarray:
        """Return df/dr; see RadialProfile."""
        steepness = 2.0 / self.half_width
        return -steepness * sigmoid_slope((1.0 - r) * steepness)


@dataclass(frozen=True)
class PolygonProfile:
    """The continuous polygon F~ of the unit disc (paper: g(x)); its gradient acts inside the edge band only."""

    half_width: float = HALF_WIDTH  # fraction of the radius

    def value(self, r: np.ndarray) -> np.ndarray:
        """Return f(r); see RadialProfile."""
        return unit_disc_indicator(r, self.half_width)

    def slope(self, r: np.ndarray) -> np.ndarray:
        """Return df/dr; see RadialProfile."""
        return np.where(np.abs(r - 1.0) < self.half_width, -0.5 / self.half_width, 0.0)


@dataclass(frozen=True)
class StepProfile:
    """The indicator itself, for the law that the paper compares with; its gradient is zero wherever it exists."""

    def value(self, r: np.ndarray) -> np.ndarray:
        """Return f(r); see RadialProfile."""
        return unit_disc_indicator(r)

    def slope(self, r: np.ndarray) -> np.ndarray:
        """Return df/dr; see RadialProfile."""
        return np.zeros_like(r, dtype=float)


@dataclass(frozen=True, slots=True)
class ThreatDiscs:
    """The discs of M threats; M may be 0."""

    centres_ned_m: np.ndarray  # (M, 2) m
    detection_radius_m: np.ndarray  # (M,) m
    attack_radius_m: np.ndarray  # (M,) m


def surrogate_cost(
    profile: RadialProfile,
    agents_ned_m: np.ndarray,  # (N, 2) m
    threats: ThreatDiscs,
    separation_m: float,
    weights: Weights,
) -> float:
    """Return F*, m^2 (docs/method.md section 2, point 2; the f2 and f3 of fun5, each pair of agents counted twice)."""
    _, to_threat_m = _offsets(agents_ned_m, threats.centres_ned_m)  # (N, M)
    _, to_peer_m = _offsets(agents_ned_m, agents_ned_m)  # (N, N)
    near = profile.value(to_peer_m / separation_m)
    np.fill_diagonal(near, 0.0)
    detected = np.sum(profile.value(to_threat_m / threats.detection_radius_m))
    attacked = np.sum(profile.value(to_threat_m / threats.attack_radius_m))
    return float(weights.k_d * detected + weights.k_a * attacked + weights.k_c * np.sum(near))


def surrogate_gradient(
    profile: RadialProfile,
    agents_ned_m: np.ndarray,  # (N, 2) m
    threats: ThreatDiscs,
    separation_m: float,
    weights: Weights,
) -> np.ndarray:
    """Return dF*/dU of all agents, (N, 2), m (paper: direct1, without the attraction).

    Coincident positions have no direction and contribute zero.
    """
    detection_radius_m, attack_radius_m = threats.detection_radius_m, threats.attack_radius_m
    threat_offset_m, to_threat_m = _offsets(agents_ned_m, threats.centres_ned_m)
    peer_offset_m, to_peer_m = _offsets(agents_ned_m, agents_ned_m)
    threat_slope_m = profile.slope(to_threat_m / detection_radius_m) * (
        weights.k_d / detection_radius_m
    ) + profile.slope(to_threat_m / attack_radius_m) * (weights.k_a / attack_radius_m)  # (N, M)
    # Both ordered pairs of two agents depend on each one's position, hence the factor 2.
    peer_slope_m = profile.slope(to_peer_m / separation_m) * (2.0 * weights.k_c / separation_m)  # (N, N)
    gradient_m: np.ndarray = np.einsum("ij,ijk->ik", threat_slope_m / _nonzero(to_threat_m), threat_offset_m)
    gradient_m += np.einsum("ij,ijk->ik", peer_slope_m / _nonzero(to_peer_m), peer_offset_m)
    return gradient_m


def gradient_for_agent(
    profile: RadialProfile,
    position_ned_m: np.ndarray,  # (2,) m
    threats: ThreatDiscs,
    peers_ned_m: np.ndarray,  # (P, 2) m, P may be 0
    separation_m: float,
    weights: Weights,
) -> np.ndarray:
    """Return dF*/dU_i of one agent, (2,), m: its row of `surrogate_gradient`, as the vehicle computes it."""
    detection_radius_m, attack_radius_m = threats.detection_radius_m, threats.attack_radius_m
    count = len(detection_radius_m)
    offset_m = position_ned_m - np.concatenate((threats.centres_ned_m, peers_ned_m))  # (M + P, 2)
    distance_m = np.sqrt(np.einsum("ij,ij->i", offset_m, offset_m))
    # One evaluation of the profile on every ratio: the call, not the arithmetic, is what costs on the vehicle.
    radius_m = np.concatenate((detection_radius_m, attack_radius_m, np.full(len(peers_ned_m), separation_m)))
    ratio = np.concatenate((distance_m[:count], distance_m)) / radius_m  # (M + M + P,)
    slope_per_m = profile.slope(ratio) / radius_m
    slope_m = 2.0 * weights.k_c * slope_per_m[count:]  # (M + P,), right for the peers, replaced for the threats
    slope_m[:count] = weights.k_d * slope_per_m[:count] + weights.k_a * slope_per_m[count : 2 * count]
    gradient_m: np.ndarray = (slope_m / _nonzero(distance_m)) @ offset_m
    return gradient_m


def wall_gradient(
    position_ned_m: np.ndarray,  # (2,) m
    threats: ThreatDiscs,
    peers_ned_m: np.ndarray,  # (P, 2) m, P may be 0
    separation_m: float,
    weights: Weights,
    half_width_m: float,
) -> np.ndarray:
    """Return dF*/dU_i of one agent, (2,), m, for logistic edges of the same half-width in metres at every radius.

    The law that follows the route uses it with edges so sharp that they do not reach the route (docs/method.md section
    3).
    """
    count = len(threats.detection_radius_m)
    others_ned_m, outer_m = threats.centres_ned_m, threats.detection_radius_m
    if len(peers_ned_m):
        others_ned_m = np.concatenate((threats.centres_ned_m, peers_ned_m))  # (M + P, 2)
        outer_m = np.concatenate((threats.detection_radius_m, np.full(len(peers_ned_m), separation_m)))
    offset_m = position_ned_m - others_ned_m
    square_m2 = offset_m * offset_m
    distance_m = np.sqrt(square_m2[:, 0] + square_m2[:, 1])
    if not np.count_nonzero(distance_m < outer_m + _FLAT * half_width_m):
        return np.zeros(2)
    steepness_1_m = 2.0 / half_width_m
    slope_m = np.full(len(distance_m), 2.0 * weights.k_c)
    slope_m[:count] = weights.k_d
    slope_m *= sigmoid_slope((outer_m - distance_m) * steepness_1_m)
    slope_m[:count] += weights.k_a * sigmoid_slope((threats.attack_radius_m - distance_m[:count]) * steepness_1_m)
    gradient_m: np.ndarray = (-steepness_1_m * slope_m / _nonzero(distance_m)) @ offset_m
    return gradient_m


def range_cost(
    position_ned_m: np.ndarray,
    target_ned_m: np.ndarray,
    flown_m: float,
    range_m: float,
    k_l: float,
    half_width: float = HALF_WIDTH,
) -> float:
    """Return the smooth f4 of one agent, m^2 (paper: fun4): k_l times a logistic of (flown + remaining) / range.

    Shapes: position (2,), target (2,). `range_m` is positive and may be infinite: then the cost is zero. `half_width`
    is a fraction of the range; the slope at the edge is the polygon's, as in AnalyticProfile.
    """
    if math.isinf(range_m):
        return 0.0
    ratio = (flown_m + math.dist(position_ned_m, target_ned_m)) / range_m
    return k_l * float(sigmoid(np.asarray((ratio - 1.0) * (2.0 / half_width))))


def range_gradient(
    position_ned_m: np.ndarray,
    target_ned_m: np.ndarray,
    flown_m: float,
    range_m: float,
    k_l: float,
    half_width: float = HALF_WIDTH,
) -> np.ndarray:
    """Return the gradient of `range_cost` with respect to the position, (2,), m; arguments as there.

    It points away from the target, so that descent shortens the path; at the target, where there is no direction, it is
    zero.
    """
    distance_m = math.dist(position_ned_m, target_ned_m)
    if distance_m == 0.0 or math.isinf(range_m):
        return np.zeros(2)
    steepness = 2.0 / half_width
    ratio = (flown_m + distance_m) / range_m
    slope_m = k_l * steepness * float(sigmoid_slope(np.asarray((ratio - 1.0) * steepness))) / range_m
    gradient_m: np.ndarray = (position_ned_m - target_ned_m) / distance_m * slope_m
    return gradient_m


def profile_by_name(name: str) -> RadialProfile:
    """Return the profile of a name in PROFILE_NAMES, for HALF_WIDTH; raises InputError for any other name."""
    if name == "pairwise":
        return load_pairwise()
    if name == "analytic":
        return AnalyticProfile(HALF_WIDTH)
    allowed = ", ".join(PROFILE_NAMES)
    raise InputError(f"surrogate '{name}' is unknown, allowed: {allowed}{nearest_hint(name, PROFILE_NAMES)}")


def load_pairwise(path: Path | None = None) -> PairwiseNetwork:
    """Return the pairwise network of a weights file, by default the packaged one.

    Raises InputError if the file is missing, is not JSON, fails its digest, or holds anything but finite numbers of
    agreeing shapes.
    """
    weights = read_weights(path, _PACKAGED)
    vectors = weights.per_neuron(("input_weight", "input_bias", "output_weight"))
    return PairwiseNetwork(**vectors, output_bias=weights.number("output_bias"))


def sigmoid(x: np.ndarray) -> np.ndarray:
    """Return 1 / (1 + exp(-x)), same shape."""
    # The exponential of a negative number only: it cannot overflow, and the far tail keeps its relative precision.
    decay = np.exp(-np.abs(x))
    value: np.ndarray = np.where(x >= 0.0, 1.0, decay) / (1.0 + decay)
    return value


def sigmoid_slope(x: np.ndarray) -> np.ndarray:
    """Return the slope of `sigmoid`, 1/4 at 0, same shape."""
    decay = np.exp(-np.abs(x))
    slope: np.ndarray = decay / (1.0 + decay) ** 2
    return slope


def _offsets(agents_ned_m: np.ndarray, others_ned_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the vectors to each agent from each of B other positions, (N, B, 2), and their lengths, (N, B), m."""
    offset_m = agents_ned_m[:, np.newaxis, :] - others_ned_m[np.newaxis, :, :]
    return offset_m, np.sqrt(np.sum(offset_m**2, axis=2))


def _nonzero(distance_m: np.ndarray) -> np.ndarray:
    """Return the distances with 1 in place of 0, so that a zero offset divided by them stays zero."""
    nonzero: np.ndarray = distance_m + (distance_m == 0.0)
    return nonzero
