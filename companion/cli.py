"""The command line of the program on the vehicle."""

from __future__ import annotations

from pathlib import Path

import click
from rich.console import Console
from rich.progress import Progress

from companion.config import load_config
from companion.errors import InputError, run_program
from companion.process import run_until_signal
from companion.service import run_companion

MIN_SAMPLES = 100
"""Fewer leave no validation set worth the name."""


@click.group()
@click.version_option(package_name="oneway-guidance")
def cli() -> None:
    """Guidance on a vehicle that can hear but not answer.

    Example: companion run companion.yaml
    """


@cli.command()
@click.argument("config")
def run(config: str) -> None:
    """Steer the vehicle of CONFIG, a YAML file or a packaged name, by what the ground station broadcasts.

    It steers only a vehicle that a person has armed and put into the guided mode, and stops when the mode changes.

    Example: companion run copter-demo-1
    """
    loaded = load_config(config)
    run_until_signal(lambda stop: run_companion(loaded, stop))


@cli.command()
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("pairwise.json"),
    show_default=True,
    help="Weights file to write.",
)
@click.option(
    "--seed", type=click.IntRange(min=0, max=2**63 - 1), default=0, show_default=True, help="Decides the result."
)
@click.option("--samples", type=click.IntRange(min=MIN_SAMPLES), default=100_000, show_default=True, help="In all.")
@click.option("--epochs", type=click.IntRange(min=1), default=1000, show_default=True, help="At most this many.")
def train(out: Path, seed: int, samples: int, epochs: int) -> None:
    """Train the pairwise surrogate and write its weights (needs the extra `train`).

    Example: companion train --out pairwise.json
    """
    # Only here: the vehicle flies without torch.
    try:
        from companion import training
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise InputError("training needs torch, which is not installed: pip install '.[train]'") from error

    training.check_writable(out)
    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as progress:
        task = progress.add_task("training", total=epochs)

        def show(epoch: int, validation_mse: float) -> None:
            progress.update(task, completed=epoch, description=f"validation MSE {validation_mse:.3e}")

        network, record = training.train_pairwise(seed, samples, epochs, show)
    digest = training.write_weights(out, network, record)
    figures = {
        "train MSE": f"{record.train_mse:.4e}",
        "validation MSE": f"{record.validation_mse:.4e}",
        "test MSE": f"{record.test_mse:.4e}",
        "variance of the target (test)": f"{record.test_target_variance:.4e}",
        "worst error": f"{record.worst_error:.4e}",
        f"largest |slope| beyond r = {training.FAR_FIELD}": f"{record.far_slope_max:.4e}",
        "largest slope of the wrong sign": f"{record.wrong_sign_slope_max:.4e}",
        "epochs run": f"{record.epochs_run} of {record.epochs_allowed}, best {record.best_epoch}",
        "seed": str(record.seed),
        "digest": digest,
        "written": str(out),
    }
    for name, figure in figures.items():
        click.echo(f"{name}: {figure}")


def main() -> None:
    """Run the program and exit with its status."""
    run_program(cli, "companion")
