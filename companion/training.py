"""Trains the pairwise network on the polygon F~ of the unit disc; the only module that needs torch.

The network must not only fit: a slope of the wrong sign would attract agents to threats, and a ripple far outside would
outweigh the attraction (METHOD.md section 2, point 2). Both are excluded by parametrisation, not by hope. In
`mu + sum lambda_j sigma(w_j r + theta_j)` every lambda_j is positive and they sum to 1 (softmax), every steepness -w_j
lies between STEEPNESS_MIN and STEEPNESS_MAX, every centre theta_j / -w_j within CENTRE_REACH of the edge, and mu = 0.
So f falls monotonically from 1 to 0, and beyond the centres |df/dr| is less than
STEEPNESS_MAX exp(-STEEPNESS_MIN (r - 1 - CENTRE_REACH)).
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from companion.cost import unit_disc_indicator
from companion.errors import InputError
from companion.surrogate import HALF_WIDTH, PairwiseNetwork, content_digest

NEURONS = 8
"""J. The bound on the steepness, not J, limits the fit: the test MSE is 4.1e-5 with 3 neurons, 4.0e-5 with 4, 3.93e-5
with 8 and 3.94e-5 with the paper's 75, which would cost the vehicle nine times the exponentials."""
STEEPNESS_MIN = 2.0 / HALF_WIDTH
"""Per unit of r: the analytic profile's. It bounds how slowly the far field decays."""
STEEPNESS_MAX = 200.0
"""Per unit of r. A sharper network fits better but repels too late for a step of 0.03 radii (the paper's 300 m against
10 km): in 40 random scenes with threats at 10 m/s the least clearance was 250 m with 200 and 80 m with 400, and with
800 one agent of 400 entered."""
CENTRE_REACH = 3.0 * HALF_WIDTH
"""Greatest distance of a neuron's centre from the edge, in r."""
SAMPLED_RANGE = 3.0
"""Half of the samples are uniform in r on [0, SAMPLED_RANGE]; beyond, the slope is below 1e-60 by construction."""
EDGE_REACH = 4.0 * HALF_WIDTH
"""The other half is uniform within this distance of the edge, where alone the target changes."""
FAR_FIELD = 1.5
"""The far field of the record begins at this r."""
TRAIN_SHARE, VALIDATION_SHARE = 0.70, 0.15
"""The paper's 70/15/15 split."""
LEARNING_RATE = 0.03
PATIENCE_EPOCHS = 100
"""Early stopping: this many epochs without a better validation error end the training."""
CURVE_POINTS = 100
"""At most this many points of the learning curve are written."""
CHECK_POINTS = 300_001
"""Even grid on [0, SAMPLED_RANGE] for the worst error and the slopes: 2500 points inside half a band."""


@dataclass(frozen=True)
class TrainingRecord:
    """What a training run was and what it reached; the errors are those of the numpy network that flies."""

    seed: int
    samples: int
    neurons: int
    half_width: float  # fraction of the radius
    epochs_allowed: int
    epochs_run: int
    best_epoch: int
    optimiser: str
    torch_version: str
    train_mse: float
    validation_mse: float
    test_mse: float
    test_target_variance: float
    worst_error: float  # over [0, SAMPLED_RANGE]
    far_slope_max: float  # largest |df/dr| beyond FAR_FIELD
    wrong_sign_slope_max: float  # largest df/dr anywhere, 0 if none is positive
    learning_curve: list[tuple[int, float, float]]  # (epoch, train MSE, validation MSE), thinned


def draw_samples(samples: int, generator: torch.Generator) -> np.ndarray:
    """Return scaled distances r, (samples,), in random order: half over the whole range, half at the edge."""
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
    on_epoch: Callable[[int, float], None] = lambda epoch, validation_mse: None,
) -> tuple[PairwiseNetwork, TrainingRecord]:
    """Return the network of the best validation error, and the record of its training.

    Full batches in double precision on one thread: the result depends on the arguments alone (on one machine with one
    torch). Sets torch's global thread count and determinism. `on_epoch` is called with (epoch, validation MSE).
    Source: METHOD.md section 1, point 2 and section 2, point 2; paper: aprfun.
    """
    torch.use_deterministic_algorithms(True)
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(seed)
    r = draw_samples(samples, generator)
    target = unit_disc_indicator(r, HALF_WIDTH)
    cuts = [round(TRAIN_SHARE * samples), round((TRAIN_SHARE + VALIDATION_SHARE) * samples)]
    r_train, r_validation, _ = (torch.from_numpy(part) for part in np.split(r, cuts))
    y_train, y_validation, _ = (torch.from_numpy(part) for part in np.split(target, cuts))

    parameters = _initial_parameters(generator)
    optimiser = torch.optim.Adam(parameters, lr=LEARNING_RATE)
    best_mse, best_epoch, best = np.inf, 0, [parameter.detach().clone() for parameter in parameters]
    curve: list[tuple[int, float, float]] = []
    for epoch in range(1, epochs + 1):
        optimiser.zero_grad()
        train_error = torch.mean((_forward(parameters, r_train) - y_train) ** 2)
        train_error.backward()
        optimiser.step()
        with torch.no_grad():
            validation_mse = float(torch.mean((_forward(parameters, r_validation) - y_validation) ** 2))
        curve.append((epoch, float(train_error.detach()), validation_mse))
        on_epoch(epoch, validation_mse)
        if validation_mse < best_mse:
            best_mse, best_epoch = validation_mse, epoch
            best = [parameter.detach().clone() for parameter in parameters]
        elif epoch - best_epoch >= PATIENCE_EPOCHS:
            break

    network = _network(best)
    train_mse, validation_mse, test_mse = (
        float(np.mean((network.value(part_r) - part_y) ** 2))
        for part_r, part_y in zip(np.split(r, cuts), np.split(target, cuts), strict=True)
    )
    grid = np.linspace(0.0, SAMPLED_RANGE, CHECK_POINTS)
    slope = network.slope(grid)
    record = TrainingRecord(
        seed=seed,
        samples=samples,
        neurons=NEURONS,
        half_width=HALF_WIDTH,
        epochs_allowed=epochs,
        epochs_run=len(curve),
        best_epoch=best_epoch,
        optimiser=f"Adam, full batch, learning rate {LEARNING_RATE}",
        torch_version=torch.__version__,
        train_mse=train_mse,
        validation_mse=validation_mse,
        test_mse=test_mse,
        test_target_variance=float(np.var(np.split(target, cuts)[2])),
        worst_error=float(np.max(np.abs(network.value(grid) - unit_disc_indicator(grid, HALF_WIDTH)))),
        far_slope_max=float(np.max(np.abs(slope[grid > FAR_FIELD]))),
        wrong_sign_slope_max=float(max(np.max(slope), 0.0)),
        learning_curve=curve[:: -(-len(curve) // CURVE_POINTS)],
    )
    return network, record


def check_writable(path: Path) -> None:
    """Raise InputError if the weights cannot be written there, before minutes are spent on them."""
    if path.is_dir():
        raise InputError(f"--out {path}: is a directory, allowed: a file name")
    if not path.parent.is_dir():
        raise InputError(f"--out {path}: directory {path.parent} does not exist, allowed: a file in one that does")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise InputError(f"--out {path}: not writable, allowed: a file that may be written")


def write_weights(path: Path, network: PairwiseNetwork, record: TrainingRecord) -> str:
    """Write the weights file that `companion.surrogate.load_pairwise` reads, and return its digest.

    Raises InputError if it cannot be written.
    """
    content: dict[str, Any] = {
        "network": {
            "input_weight": network.input_weight.tolist(),
            "input_bias": network.input_bias.tolist(),
            "output_weight": network.output_weight.tolist(),
            "output_bias": network.output_bias,
        },
        "training": asdict(record),
    }
    digest = content_digest(content)
    content["sha256"] = digest
    try:
        path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"--out {path}: cannot write: {error.strerror}") from error
    return digest


def _initial_parameters(generator: torch.Generator) -> list[torch.Tensor]:
    """Return the free parameters, each (NEURONS,): of steepness, of centre, of output weight."""
    # Centres spread over the ramp and nearly the greatest steepness: from flat neurons the descent stalls.
    steepness = 2.0 + 0.1 * torch.randn(NEURONS, generator=generator, dtype=torch.float64)
    in_band = HALF_WIDTH * (2.0 * torch.rand(NEURONS, generator=generator, dtype=torch.float64) - 1.0)
    centre = torch.atanh(in_band / CENTRE_REACH)
    weight = torch.zeros(NEURONS, dtype=torch.float64)
    return [parameter.requires_grad_() for parameter in (steepness, centre, weight)]


def _constrained(parameters: list[torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the neurons' steepness, centre and output weight, each (NEURONS,), within the module's bounds."""
    free_steepness, free_centre, free_weight = parameters
    steepness = STEEPNESS_MIN + (STEEPNESS_MAX - STEEPNESS_MIN) * torch.sigmoid(free_steepness)
    centre = 1.0 + CENTRE_REACH * torch.tanh(free_centre)
    return steepness, centre, torch.softmax(free_weight, dim=0)


def _forward(parameters: list[torch.Tensor], r: torch.Tensor) -> torch.Tensor:
    steepness, centre, output_weight = _constrained(parameters)
    return torch.sigmoid(steepness * (centre - r[:, None])) @ output_weight


def _network(parameters: list[torch.Tensor]) -> PairwiseNetwork:
    steepness, centre, output_weight = (tensor.detach().numpy() for tensor in _constrained(parameters))
    return PairwiseNetwork(-steepness, steepness * centre, output_weight, output_bias=0.0)
