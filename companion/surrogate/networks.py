"""The paper's own surrogate: one network of the absolute positions of all agents and threats. It does not fly.

It is kept for the record and the reproduction: trained properly on the paper's own case it explains about one percent
of its target (docs/method.md section 2, point 1; docs/surrogate.md has the numbers), so its gradient is noise.
`pairwise` flies instead. Evaluated with numpy alone, as on the vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.files.weights import read_weights
from companion.surrogate.profiles import sigmoid, sigmoid_slope

SIGMOID_SLOPE_MAX = 0.25
"""Greatest slope of the logistic function (paper: proof of the corollary)."""
_PACKAGED = "monolithic.json"


@dataclass(frozen=True)
class MonolithicNetwork:
    """F* = mu + sum_j lambda_j sigma(X . omega_j + theta_j), its inputs and its output scaled (paper: aprfun).

    X is x_1, y_1, ... of the agents, then of the threats, each coordinate (north, east) from [0, area_m] to [-1, 1];
    -1 and 1 of the output stand for target_low_m2 and target_high_m2.
    """

    agents: int
    """N, the number of agents; their order among the inputs is that of their ids, 1 to N."""
    threats: int
    """M, the number of threats; their order among the inputs is that of their ids, 1 to M."""
    area_m: float
    """Side of the square in which the training positions were drawn."""
    target_low_m2: float
    """Least value of F~ to which the network was trained."""
    target_high_m2: float
    """Greatest value of F~ to which the network was trained."""
    input_weight: np.ndarray  # (J, 2 (N + M)), omega
    input_bias: np.ndarray  # (J,), theta
    output_weight: np.ndarray  # (J,), lambda
    output_bias: float  # mu

    def value(self, agents_ned_m: np.ndarray, threats_ned_m: np.ndarray) -> float:
        """Return F*, m^2. Shapes: agents (N, 2), threats (M, 2), as `slots` arranges them; else raises ValueError."""
        return float(self._to_m2(self.scaled_value(self._inputs(agents_ned_m, threats_ned_m))))

    def gradient(self, agents_ned_m: np.ndarray, threats_ned_m: np.ndarray) -> np.ndarray:
        """Return dF*/dU of all agents, (N, 2), m (paper: the equations after direct1); arguments as `value`.

        The row of an absent agent, whose position `slots` padded, means nothing.
        """
        inputs = self._inputs(agents_ned_m, threats_ned_m)
        hidden_slope = sigmoid_slope(self.input_weight @ inputs + self.input_bias)  # (J,)
        scaled = (hidden_slope * self.output_weight) @ self.input_weight[:, : 2 * self.agents]  # (2 N,)
        gradient_m: np.ndarray = self._m_per_scaled_slope * scaled.reshape(self.agents, 2)
        return gradient_m

    def component_bound_m(self) -> float:
        """Return a bound on every component of the gradient at any positions, m (paper: coro_condi, divided by 4).

        The paper sums over the threats' coordinates as well, and prints one of the two sums twice; the proof needs only
        the agents' coordinates.
        """
        sums = np.abs(self.output_weight) @ np.abs(self.input_weight[:, : 2 * self.agents])  # (2 N,)
        return SIGMOID_SLOPE_MAX * self._m_per_scaled_slope * float(np.max(sums))

    def scaled_value(self, inputs: np.ndarray) -> np.ndarray:
        """Return the scaled output, (...,), of scaled inputs, (..., 2 (N + M)), dimensionless."""
        output: np.ndarray = sigmoid(inputs @ self.input_weight.T + self.input_bias) @ self.output_weight
        return output + self.output_bias

    @property
    def _m_per_scaled_slope(self) -> float:
        """Factor that converts a slope of the scaled output by a scaled input to m^2 per m."""
        return (self.target_high_m2 - self.target_low_m2) / self.area_m

    def _to_m2(self, scaled: np.ndarray) -> np.ndarray:
        return self.target_low_m2 + (scaled + 1.0) * (0.5 * (self.target_high_m2 - self.target_low_m2))

    def _inputs(self, agents_ned_m: np.ndarray, threats_ned_m: np.ndarray) -> np.ndarray:  # (2 (N + M),)
        shapes = (np.shape(agents_ned_m), np.shape(threats_ned_m))
        if shapes != ((self.agents, 2), (self.threats, 2)):
            raise ValueError(f"agents and threats have shapes {shapes}, not {((self.agents, 2), (self.threats, 2))}")
        return scaled_inputs(agents_ned_m, threats_ned_m, self.area_m)


def scaled_inputs(agents_ned_m: np.ndarray, threats_ned_m: np.ndarray, area_m: float) -> np.ndarray:
    """Return the network's inputs, (..., 2 (N + M)), of agents (..., N, 2) and threats (..., M, 2)."""
    positions_m = np.concatenate((agents_ned_m, threats_ned_m), axis=-2)
    inputs: np.ndarray = positions_m.reshape(*positions_m.shape[:-2], -1) * (2.0 / area_m) - 1.0
    return inputs


def slots(ids: Sequence[int] | np.ndarray, positions_ned_m: np.ndarray, count: int) -> np.ndarray:
    """Return the positions (B, 2) of `ids` arranged as a fixed input, (count, 2), m: id k in row k - 1.

    The rows of absent ids are padded with zeros, as the paper pads lost agents: to the network they are in the area's
    south-west corner. Raises ValueError for an id outside 1 to `count`.
    """
    places = np.asarray(ids, dtype=int)  # (B,)
    if np.any((places < 1) | (places > count)):
        raise ValueError(f"ids {places.tolist()} are not all within 1 to {count}")
    padded_m = np.zeros((count, 2))
    padded_m[places - 1] = positions_ned_m
    return padded_m


def load_monolithic(path: Path | None = None) -> MonolithicNetwork:
    """Return the monolithic network of a weights file, by default the packaged one.

    Raises InputError if the file is missing, is not JSON, fails its digest, or holds anything but finite numbers of
    agreeing shapes.
    """
    weights = read_weights(path, _PACKAGED)
    agents, threats = weights.count("agents"), weights.count("threats")
    vectors = weights.per_neuron(("input_bias", "output_weight"))
    return MonolithicNetwork(
        agents=agents,
        threats=threats,
        area_m=weights.number("area_m"),
        target_low_m2=weights.number("target_low_m2"),
        target_high_m2=weights.number("target_high_m2"),
        input_weight=weights.matrix("input_weight", len(vectors["input_bias"]), 2 * (agents + threats)),
        **vectors,
        output_bias=weights.number("output_bias"),
    )
