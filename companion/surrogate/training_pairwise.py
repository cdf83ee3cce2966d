"""Trains the pairwise network, the one that flies, on the polygon F~ of the unit disc.

The network must not only fit: a slope of the wrong sign would attract agents to threats, and a ripple far outside would
outweigh the attraction (docs/method.md section 2, point 2). The parametrisation excludes both. In
`mu + sum lambda_j sigma(w_j r + theta_j)` every lambda_j is positive and they sum to 1 (softmax), every steepness -w_j
lies between STEEPNESS_MIN and STEEPNESS_MAX, every centre theta_j / -w_j within CENTRE_REACH of the edge, and mu = 0.
So f falls monotonically from 1 to 0, and beyond the centres |df/dr| is less than
STEEPNESS_MAX exp(-STEEPNESS_MIN (r - 1 - CENTRE_REACH)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from companion.surrogate.cost import unit_disc_indicator
from companion.surrogate.profiles import HALF_WIDTH, PairwiseNetwork
from companion.surrogate.training import (
    Course,
    OnEpoch,
    Parameters,
    Recipe,
    TrainingRecord,
    fit,
    record_of,
    seeded,
    split,
)

NEURONS = 8
"""Number of neurons, J. The bound on the steepness, not J, limits the fit: the test MSE is 4.1e-5 with 3 neurons,
4.0e-5 with 4, 3.93e-5 with 8 and 3.94e-5 with the paper's 75, which would cost the vehicle nine times the
exponentials."""
STEEPNESS_MIN = 2.0 / HALF_WIDTH
"""Least steepness of a neuron per unit of r, the analytic profile's: it bounds how slowly the far field decays."""
STEEPNESS_MAX = 200.0
"""Greatest steepness of a neuron per unit of r. A sharper network fits better but repels too late for a step of 0.03
radii (the paper's 300 m against 10 km): in 40 random scenes with threats at 10 m/s the least clearance was 250 m with
200 and 80 m with 400, and with 800 one agent of 400 entered."""
CENTRE_REACH = 3.0 * HALF_WIDTH
"""Greatest distance of a neuron's centre from the edge, in r."""
SAMPLED_RANGE = 3.0
"""Greatest r of the half of the samples that is uniform from 0; beyond, the slope is below 1e-60 by construction."""
EDGE_REACH = 4.0 * HALF_WIDTH
"""Greatest distance from the edge, in r, of the other half of the samples: only there does the target change."""
FAR_FIELD = 1.5
"""Scaled distance r at which the record's far field begins."""
LEARNING_RATE = 0.03
"""Learning rate of Adam with full batches."""
CHECK_POINTS = 300_001
"""Points of an even grid on [0, SAMPLED_RANGE] for the worst error and the slopes: 2500 lie inside half a band."""


@dataclass(frozen=True)
class PairwiseRecord(TrainingRecord):
    """Record with the checks that only the pairwise network must pass."""

    worst_error: float  # over [0, SAMPLED_RANGE]
    far_slope_max: float  # largest |df/dr| beyond FAR_FIELD
    wrong_sign_slope_max: float  # largest df/dr anywhere, 0 if none is positive

    def findings(self) -> dict[str, str]:
        """Return the results that only this kind of network has; see TrainingRecord."""
        return {
            "worst error": f"{self.worst_error:.4e}",
            f"largest |slope| beyond r = {FAR_FIELD}": f"{self.far_slope_max:.4e}",
            "largest slope of the wrong sign": f"{self.wrong_sign_slope_max:.4e}",
        }


def draw_samples(samples: int, generator: torch.Generator) -> np.ndarray:
    """Return scaled distances r, (samples,), in random order: half from the whole range, half from near the edge."""
    uniform = torch.rand(samples, generator=generator, dtype=torch.float64)
    everywhere = SAMPLED_RANGE * uniform
    at_edge = 1.0 + EDGE_REACH * (2.0 * uniform - 1.0)
    r = torch.where(torch.arange(samples) % 2 == 0, everywhere, at_edge)
    shuffled: np.ndarray = r[torch.randperm(samples, generator=generator)].numpy()
    return shuffled


def train_pairwise(
    seed: int,
    samples: int,
    epochs: int,
    on_epoch: OnEpoch = lambda epoch, validation_mse: None,
) -> tuple[PairwiseNetwork, PairwiseRecord]:
    """Return the network of the best validation error, and the record of its training.

    Sets torch's global thread count and determinism. Source: docs/method.md section 1, point 2 and section 2, point 2;
    paper: aprfun.
    """
    generator = seeded(seed)
    r = draw_samples(samples, generator)
    parts = list(zip(split(r), split(unit_disc_indicator(r, HALF_WIDTH)), strict=True))
    recipe = Recipe(NEURONS, LEARNING_RATE, batch=None)
    fitted = fit(_forward, _initial_parameters(generator), parts, recipe, Course(epochs, generator, on_epoch))
    network = _network(fitted.parameters)
    grid = np.linspace(0.0, SAMPLED_RANGE, CHECK_POINTS)
    slope = network.slope(grid)
    record = PairwiseRecord(
        **vars(record_of(seed, epochs, recipe, fitted, parts, network.value)),
        worst_error=float(np.max(np.abs(network.value(grid) - unit_disc_indicator(grid, HALF_WIDTH)))),
        far_slope_max=float(np.max(np.abs(slope[grid > FAR_FIELD]))),
        wrong_sign_slope_max=float(max(np.max(slope), 0.0)),
    )
    return network, record


def _initial_parameters(generator: torch.Generator) -> Parameters:
    """Return the free parameters, each (NEURONS,): of steepness, of centre, of output weight."""
    # Centres spread over the ramp and nearly the greatest steepness: from flat neurons the descent stalls.
    steepness = 2.0 + 0.1 * torch.randn(NEURONS, generator=generator, dtype=torch.float64)
    in_band = HALF_WIDTH * (2.0 * torch.rand(NEURONS, generator=generator, dtype=torch.float64) - 1.0)
    centre = torch.atanh(in_band / CENTRE_REACH)
    weight = torch.zeros(NEURONS, dtype=torch.float64)
    return [parameter.requires_grad_() for parameter in (steepness, centre, weight)]


def _constrained(parameters: Parameters) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the neurons' steepness, centre and output weight, each (NEURONS,), within the module's bounds."""
    free_steepness, free_centre, free_weight = parameters
    steepness = STEEPNESS_MIN + (STEEPNESS_MAX - STEEPNESS_MIN) * torch.sigmoid(free_steepness)
    centre = 1.0 + CENTRE_REACH * torch.tanh(free_centre)
    return steepness, centre, torch.softmax(free_weight, dim=0)


def _forward(parameters: Parameters, r: torch.Tensor) -> torch.Tensor:
    steepness, centre, output_weight = _constrained(parameters)
    return torch.sigmoid(steepness * (centre - r[:, None])) @ output_weight


def _network(parameters: Parameters) -> PairwiseNetwork:
    steepness, centre, output_weight = (tensor.detach().numpy() for tensor in _constrained(parameters))
    return PairwiseNetwork(-steepness, steepness * centre, output_weight, output_bias=0.0)
