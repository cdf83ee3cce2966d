"""What the trainings of both networks share: the split, the fit with early stopping, the record, the weights file.

`training_pairwise` and `training_monolithic` say what is fitted to what. These three modules alone need torch.
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
"""The paper's 70/15/15 split."""
PATIENCE_EPOCHS = 100
"""Early stopping: this many epochs without a better validation error end the training."""
CURVE_POINTS = 100
"""At most this many points of the learning curve are written."""

Part = tuple[np.ndarray, np.ndarray]
"""Inputs (S,) or (S, inputs), and their targets (S,)."""
Parameters = list[torch.Tensor]
Forward = Callable[[Parameters, torch.Tensor], torch.Tensor]
OnEpoch = Callable[[int, float], None]
"""Called after each epoch with (epoch, validation MSE)."""
Network = PairwiseNetwork | MonolithicNetwork


@dataclass(frozen=True)
class Recipe:
    """How Adam is to fit a network."""

    neurons: int
    learning_rate: float
    batch: int | None
    """Samples per step; None: all of them, the full batch."""

    def __str__(self) -> str:
        """Return what the record calls the optimiser."""
        batch = "full batch" if self.batch is None else f"batches of {self.batch}"
        return f"Adam, {batch}, learning rate {self.learning_rate}"


@dataclass(frozen=True)
class Course:
    """How long a fit may last, what its chance is drawn from and who hears of it."""

    epochs: int
    """At most."""
    generator: torch.Generator
    """Shuffles the batches."""
    on_epoch: OnEpoch


@dataclass(frozen=True)
class TrainingRecord:
    """What a training run was and what it reached; the errors are those of the numpy network that is written."""

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
        """Return what is to be told of this network beside what every training tells, name to text."""
        return {}


Training = Callable[[int, int, int, OnEpoch], tuple[Network, TrainingRecord]]
"""From seed, samples, epochs allowed and `on_epoch` to the network of the best validation error and its record."""


@dataclass(frozen=True)
class Fit:
    """The outcome of `fit`."""

    parameters: Parameters
    """Those of the best validation error."""
    best_epoch: int
    curve: list[tuple[int, float, float]]  # (epoch, train MSE, validation MSE)


def seeded(seed: int) -> torch.Generator:
    """Return the source of all chance in a training, and make torch deterministic: one thread, for the whole process.

    So the result depends on the arguments alone (on one machine with one torch).
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
    """Fit the parameters to the first of the `parts`, in place, and return those that suit the second best.

    `forward` maps parameters and inputs to outputs. The training error of the curve is that before each step, as no
    pass is spent on it.
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
    """Raise InputError if the weights cannot be written there, before minutes are spent on them."""
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
