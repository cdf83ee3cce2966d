"""Training code of both networks: the split of the samples, the fit with early stopping, the record, the weights file.

`training_pairwise` and `training_monolithic` define each network and its samples. Only these three modules need torch.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from companion.errors import InputError
from companion.files.weights import DIGEST_KEY, content_digest
from companion.surrogate.networks import MonolithicNetwork
from companion.surrogate.profiles import HALF_WIDTH, PairwiseNetwork

TRAIN_SHARE, VALIDATION_SHARE = 0.70, 0.15
"""Shares of the samples for training and validation; the rest is for the test (the paper's 70/15/15 split)."""
PATIENCE_EPOCHS = 100
"""Number of epochs without a better validation error after which the training stops early."""
CURVE_POINTS = 100
"""Greatest number of points of the learning curve that are written."""

Part = tuple[np.ndarray, np.ndarray]
"""Part of the samples: inputs (S,) or (S, inputs), and their targets (S,)."""
Parameters = list[torch.Tensor]
"""Free parameters of a network."""
Forward = Callable[[Parameters, torch.Tensor], torch.Tensor]
"""Maps parameters and inputs to outputs."""
OnEpoch = Callable[[int, float], None]
"""Callback after each epoch, with (epoch, validation MSE)."""
Network = PairwiseNetwork | MonolithicNetwork


@dataclass(frozen=True)
class Recipe:
    """Settings with which Adam fits a network."""

    neurons: int
    learning_rate: float
    batch: int | None
    """Samples per step; None: all samples, the full batch."""

    def __str__(self) -> str:
        """Return the description of the optimiser for the record."""
        batch = "full batch" if self.batch is None else f"batches of {self.batch}"
        return f"Adam, {batch}, learning rate {self.learning_rate}"


@dataclass(frozen=True)
class Course:
    """Length, random generator and progress callback of a fit."""

    epochs: int
    """Greatest number of epochs."""
    generator: torch.Generator
    """Random generator that shuffles the batches."""
    on_epoch: OnEpoch


@dataclass(frozen=True)
class TrainingRecord:
    """Settings and results of a training run; the errors are those of the numpy network that is written."""

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
    learning_curve: list[tuple[int, float, float]]  # (epoch, train MSE, validation MSE), thinned

    def findings(self) -> dict[str, str]:
        """Return the results that only this kind of network has, name to text."""
        return {}


Training = Callable[[int, int, int, OnEpoch], tuple[Network, TrainingRecord]]
"""Maps seed, samples, epochs allowed and `on_epoch` to the network of the best validation error and its record."""


@dataclass(frozen=True)
class Fit:
    """The outcome of `fit`."""

    parameters: Parameters
    """The parameters with the best validation error."""
    best_epoch: int
    curve: list[tuple[int, float, float]]  # (epoch, train MSE, validation MSE)


def seeded(seed: int) -> torch.Generator:
    """Return the random generator of a training, and make torch deterministic and single-threaded in this process.

    So the result depends on the arguments alone (on one machine with one version of torch).
    """
    torch.use_deterministic_algorithms(True)
    torch.set_num_threads(1)
    return torch.Generator().manual_seed(seed)


def split(values: np.ndarray) -> list[np.ndarray]:
    """Return the training, validation and test part of values in random order, (S, ...) each."""
    cuts = [round(TRAIN_SHARE * len(values)), round((TRAIN_SHARE + VALIDATION_SHARE) * len(values))]
    return np.split(values, cuts)


def fit(
    forward: Forward,
    parameters: Parameters,
    parts: Sequence[Part],
    recipe: Recipe,
    course: Course,
) -> Fit:
    """Fit the parameters, in place, to the first of the `parts` and return those with the least error on the second.

    The training errors of the curve are those before each step, so that they cost no pass of their own.
    """
    (inputs, targets), (validation_inputs, validation_targets) = (
        (torch.from_numpy(x), torch.from_numpy(y)) for x, y in parts[:2]
    )
    optimiser = torch.optim.Adam(parameters, lr=recipe.learning_rate)
    best_mse, best_epoch, best = np.inf, 0, [parameter.detach().clone() for parameter in parameters]
    curve: list[tuple[int, float, float]] = []
    for epoch in range(1, course.epochs + 1):
        train_mse = 0.0
        for batch_inputs, batch_targets in _batches(inputs, targets, recipe.batch, course.generator):
            optimiser.zero_grad()
            error = torch.mean((forward(parameters, batch_inputs) - batch_targets) ** 2)
            error.backward()
            optimiser.step()
            train_mse += float(error.detach()) * (len(batch_targets) / len(targets))
        with torch.no_grad():
            validation_mse = float(torch.mean((forward(parameters, validation_inputs) - validation_targets) ** 2))
        curve.append((epoch, train_mse, validation_mse))
        course.on_epoch(epoch, validation_mse)
        if validation_mse < best_mse:
            best_mse, best_epoch = validation_mse, epoch
            best = [parameter.detach().clone() for parameter in parameters]
        elif epoch - best_epoch >= PATIENCE_EPOCHS:
            break
    return Fit(best, best_epoch, curve)


def record_of(
    seed: int,
    epochs: int,
    recipe: Recipe,
    fitted: Fit,
    parts: Sequence[Part],
    predict: Callable[[np.ndarray], np.ndarray],
) -> TrainingRecord:
    """Return the record of a fit; `predict` maps inputs to outputs by the numpy network."""
    train_mse, validation_mse, test_mse = (float(np.mean((predict(x) - y) ** 2)) for x, y in parts)
    return TrainingRecord(
        seed=seed,
        samples=sum(len(targets) for _, targets in parts),
        neurons=recipe.neurons,
        half_width=HALF_WIDTH,
        epochs_allowed=epochs,
        epochs_run=len(fitted.curve),
        best_epoch=fitted.best_epoch,
        optimiser=str(recipe),
        torch_version=torch.__version__,
        train_mse=train_mse,
        validation_mse=validation_mse,
        test_mse=test_mse,
        test_target_variance=float(np.var(parts[2][1])),
        learning_curve=fitted.curve[:: -(-len(fitted.curve) // CURVE_POINTS)],
    )


def check_writable(path: Path) -> None:
    """Raise InputError if a weights file cannot be written to the path, before minutes are spent on training."""
    if path.is_dir():
        raise InputError(f"--out {path}: is a directory, allowed: a file name")
    if not path.parent.is_dir():
        raise InputError(f"--out {path}: directory {path.parent} does not exist, allowed: a file in one that does")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise InputError(f"--out {path}: not writable, allowed: a file that may be written")


def write_weights(path: Path, network: Network, record: TrainingRecord) -> str:
    """Write the weights file that `load_pairwise` or `load_monolithic` reads, and return its digest.

    Raises InputError if it cannot be written.
    """
    training = asdict(record)
    training["learning_curve"] = training.pop("learning_curve")  # last: it is long, and the figures are short
    content: dict[str, Any] = {
        "network": {key: np.asarray(value).tolist() for key, value in vars(network).items()},
        "training": training,
    }
    digest = content_digest(content)
    content[DIGEST_KEY] = digest
    try:
        path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"--out {path}: cannot write: {error.strerror}") from error
    return digest


def _batches(
    inputs: torch.Tensor, targets: torch.Tensor, size: int | None, generator: torch.Generator
) -> list[tuple[torch.Tensor, torch.Tensor]]:
    if size is None:
        return [(inputs, targets)]
    order = torch.randperm(len(targets), generator=generator)
    return [(inputs[part], targets[part]) for part in order.split(size)]
