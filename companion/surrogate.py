"""F*, the differentiable stand-in for the step penalties, and the closed-form gradient that flies.

Every penalty that depends on positions is a function of one distance over one radius, so a single network f(r) serves
all pairs, any number of agents and threats, and mixed radii (METHOD.md section 2, point 2). The vehicle evaluates
this with numpy alone; torch is needed only to train. f4 depends on history, not on positions, and is not part of F*.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Protocol, TypeGuard

import numpy as np

from companion.cost import Weights, unit_disc_indicator
from companion.errors import InputError, nearest_hint

HALF_WIDTH = 0.025
"""Half-width of the polygon, as a fraction of the radius: law `seed` (METHOD.md section 2, point 2)."""
PROFILE_NAMES = ("pairwise", "analytic")
_WEIGHTS_FILE = "weights/pairwise.json"
_DIGEST_KEY = "sha256"
_VECTOR_KEYS = ("input_weight", "input_bias", "output_weight")


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
        """See RadialProfile."""
        hidden = _sigmoid(np.asarray(r)[..., np.newaxis] * self.input_weight + self.input_bias)
        output: np.ndarray = hidden @ self.output_weight + self.output_bias
        return output

    def slope(self, r: np.ndarray) -> np.ndarray:
        """See RadialProfile."""
        hidden_slope = _sigmoid_slope(np.asarray(r)[..., np.newaxis] * self.input_weight + self.input_bias)
        slope: np.ndarray = hidden_slope @ (self.output_weight * self.input_weight)
        return slope


@dataclass(frozen=True)
class AnalyticProfile:
    """A logistic of the signed distance 1 - r; its slope at the edge is the polygon's, -1 / (2 half_width)."""

    half_width: float = HALF_WIDTH  # fraction of the radius

    def value(self, r: np.ndarray) -> np.ndarray:
        """See RadialProfile."""
        return _sigmoid((1.0 - r) * (2.0 / self.half_width))

    def slope(self, r: np.ndarray) -> np.ndarray:
        """See RadialProfile."""
        steepness = 2.0 / self.half_width
        return -steepness * _sigmoid_slope((1.0 - r) * steepness)


@dataclass(frozen=True)
class PolygonProfile:
    """The continuous polygon F~ of the unit disc (paper: g(x)); its gradient acts inside the edge band only."""

    half_width: float = HALF_WIDTH  # fraction of the radius

    def value(self, r: np.ndarray) -> np.ndarray:
        """See RadialProfile."""
        return unit_disc_indicator(r, self.half_width)

    def slope(self, r: np.ndarray) -> np.ndarray:
        """See RadialProfile."""
        return np.where(np.abs(r - 1.0) < self.half_width, -0.5 / self.half_width, 0.0)


@dataclass(frozen=True)
class StepProfile:
    """The indicator itself, the law that the paper compares with: its gradient is zero wherever it exists."""

    def value(self, r: np.ndarray) -> np.ndarray:
        """See RadialProfile."""
        return unit_disc_indicator(r)

    def slope(self, r: np.ndarray) -> np.ndarray:
        """See RadialProfile."""
        return np.zeros_like(r, dtype=float)


def surrogate_cost(
    profile: RadialProfile,
    agents_ned_m: np.ndarray,
    threats_ned_m: np.ndarray,
    detection_radius_m: np.ndarray,
    attack_radius_m: np.ndarray,
    separation_m: float,
    weights: Weights,
) -> float:
    """Return F* in m^2 (METHOD.md section 2, point 2; the f2 and f3 of fun5, each pair of agents counted twice).

    Shapes: agents (N, 2), threats (M, 2), both radii (M,); M may be 0 and N may be 1.
    """
    _, to_threat_m = _offsets(agents_ned_m, threats_ned_m)  # (N, M)
    _, to_peer_m = _offsets(agents_ned_m, agents_ned_m)  # (N, N)
    near = profile.value(to_peer_m / separation_m)
    np.fill_diagonal(near, 0.0)
    detected = np.sum(profile.value(to_threat_m / detection_radius_m))
    attacked = np.sum(profile.value(to_threat_m / attack_radius_m))
    return float(weights.k_d * detected + weights.k_a * attacked + weights.k_c * np.sum(near))


def surrogate_gradient(
    profile: RadialProfile,
    agents_ned_m: np.ndarray,
    threats_ned_m: np.ndarray,
    detection_radius_m: np.ndarray,
    attack_radius_m: np.ndarray,
    separation_m: float,
    weights: Weights,
) -> np.ndarray:
    """Return dF*/dU of all agents, (N, 2), m (paper: direct1, without the attraction); shapes as `surrogate_cost`.

    Coincident positions have no direction and contribute zero.
    """
    threat_offset_m, to_threat_m = _offsets(agents_ned_m, threats_ned_m)
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
    position_ned_m: np.ndarray,
    threats_ned_m: np.ndarray,
    detection_radius_m: np.ndarray,
    attack_radius_m: np.ndarray,
    peers_ned_m: np.ndarray,
    separation_m: float,
    weights: Weights,
) -> np.ndarray:
    """Return dF*/dU_i of one agent, (2,), m: its row of `surrogate_gradient`, as the vehicle computes it.

    Shapes: position (2,), threats (M, 2), both radii (M,), peers (P, 2); M and P may be 0.
    """
    threats = len(detection_radius_m)
    offset_m = position_ned_m - np.concatenate((threats_ned_m, peers_ned_m))  # (M + P, 2)
    distance_m = np.sqrt(np.einsum("ij,ij->i", offset_m, offset_m))
    # One evaluation of the profile on every ratio: the call, not the arithmetic, is what costs on the vehicle.
    radius_m = np.concatenate((detection_radius_m, attack_radius_m, np.full(len(peers_ned_m), separation_m)))
    ratio = np.concatenate((distance_m[:threats], distance_m)) / radius_m  # (M + M + P,)
    slope_per_m = profile.slope(ratio) / radius_m
    slope_m = 2.0 * weights.k_c * slope_per_m[threats:]  # (M + P,), right for the peers, replaced for the threats
    slope_m[:threats] = weights.k_d * slope_per_m[:threats] + weights.k_a * slope_per_m[threats : 2 * threats]
    gradient_m: np.ndarray = (slope_m / _nonzero(distance_m)) @ offset_m
    return gradient_m


def profile_by_name(name: str) -> RadialProfile:
    """Return the flying profile of that name at HALF_WIDTH; raise InputError if there is none."""
    if name == "pairwise":
        return load_pairwise()
    if name == "analytic":
        return AnalyticProfile(HALF_WIDTH)
    allowed = ", ".join(PROFILE_NAMES)
    raise InputError(f"surrogate '{name}' is unknown, allowed: {allowed}{nearest_hint(name, PROFILE_NAMES)}")


def content_digest(content: dict[str, Any]) -> str:
    """Return the SHA-256 in hex of a weights file's content less its digest, as canonical JSON.

    Canonical: keys sorted, no white space, numbers as Python writes them. So a reformatted file keeps its digest.
    """
    body = {key: value for key, value in content.items() if key != _DIGEST_KEY}
    return hashlib.sha256(json.dumps(body, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def load_pairwise(path: Path | None = None) -> PairwiseNetwork:
    """Return the pairwise network of a weights file, by default the packaged one.

    Raises InputError if the file is missing, is not JSON, fails its digest, or holds anything but finite numbers of
    agreeing shapes: wrong weights would steer silently.
    """
    source = resources.files("companion").joinpath(_WEIGHTS_FILE) if path is None else path
    try:
        content = json.loads(source.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{source}: cannot read the weights: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{source}: not a JSON file: {error}") from error
    if not isinstance(content, dict) or not isinstance(content.get("network"), dict):
        raise InputError(f"{source}: key 'network' is missing, allowed: an object as `companion train` writes it")
    digest = content_digest(content)
    if content.get(_DIGEST_KEY) != digest:
        raise InputError(
            f"{source}: key '{_DIGEST_KEY}' is {content.get(_DIGEST_KEY)!r}, allowed: the digest of the content, "
            f"{digest}; the file is damaged or was edited"
        )
    network = content["network"]
    vectors = {key: _numbers(network, key, source) for key in _VECTOR_KEYS}
    neurons = len(vectors[_VECTOR_KEYS[0]])
    for key, vector in vectors.items():
        if len(vector) != neurons or neurons == 0:
            raise InputError(
                f"{source}: key 'network.{key}' has {len(vector)} numbers, allowed: one per hidden neuron, "
                f"as many as '{_VECTOR_KEYS[0]}' ({neurons}), at least 1"
            )
    bias = network.get("output_bias")
    if not _is_finite_number(bias):
        raise InputError(f"{source}: key 'network.output_bias' is {bias!r}, allowed: a finite number")
    return PairwiseNetwork(**vectors, output_bias=bias)


def _numbers(network: dict[str, Any], key: str, source: object) -> np.ndarray:
    """Return a list of finite numbers as an array (J,), or raise InputError."""
    values = network.get(key)
    if not isinstance(values, list) or not all(_is_finite_number(value) for value in values):
        raise InputError(f"{source}: key 'network.{key}' is damaged, allowed: a list of finite numbers")
    return np.array(values, dtype=float)


def _is_finite_number(value: object) -> TypeGuard[float]:
    return isinstance(value, float) and math.isfinite(value)


def _sigmoid(x: np.ndarray) -> np.ndarray:
    # The exponential of a negative number only: it cannot overflow, and the far tail keeps its relative precision.
    decay = np.exp(-np.abs(x))
    value: np.ndarray = np.where(x >= 0.0, 1.0, decay) / (1.0 + decay)
    return value


def _sigmoid_slope(x: np.ndarray) -> np.ndarray:
    decay = np.exp(-np.abs(x))
    slope: np.ndarray = decay / (1.0 + decay) ** 2
    return slope


def _offsets(agents_ned_m: np.ndarray, others_ned_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the vectors from each other to each agent, (N, B, 2), and their lengths, (N, B), m."""
    offset_m = agents_ned_m[:, np.newaxis, :] - others_ned_m[np.newaxis, :, :]
    return offset_m, np.sqrt(np.sum(offset_m**2, axis=2))


def _nonzero(distance_m: np.ndarray) -> np.ndarray:
    """Return the distances with 1 for 0: the offset is zero there, and zero is the direction we want."""
    nonzero: np.ndarray = distance_m + (distance_m == 0.0)
    return nonzero
