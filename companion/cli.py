"""The command line of the program on the vehicle.

Each command imports its own modules, so that a companion that is restarted in flight loads no more than it needs and
soon runs again. It also loads them only after `main` has set SIGUSR1 to be ignored: that signal, with which the safety
pilot clears a take-over, ends a process that has not set up a handler yet.
"""

from __future__ import annotations

import json
import math
import signal
from pathlib import Path

import click

from companion.errors import EXIT_DONE, EXIT_FAILED, InputError, run_program, tell

MIN_SAMPLES = 100
"""Smallest number of training samples; fewer leave too small a validation set."""
MAX_SAMPLES = 10_000_000
"""Greatest number of training samples; more would not fit into the memory of a common machine."""


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
    from companion.onboard.config import load_config
    from companion.onboard.service import run_companion
    from companion.runtime.clock import run_until_signal

    loaded = load_config(config)
    run_until_signal(lambda stop: run_companion(loaded, stop))


@cli.command()
@click.argument("config")
@click.option(
    "--wait",
    "wait_s",
    type=click.FloatRange(1.0, 600.0),
    default=20.0,
    show_default=True,
    help="Listen for so many seconds at most.",
)
@click.option("--strict", is_flag=True, help="A warning fails, too.")
@click.option(
    "--param",
    "param",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Write the parameters that are demanded into this new file, as ground-control programs load them.",
)
def check(config: str, wait_s: float, strict: bool, param: Path | None) -> int:
    """Say whether the vehicle of CONFIG is fit to be steered, and to be left safe by a companion that dies.

    It listens on the links and reads the autopilot's parameters; a line for everything looked at, with what to do about
    what fails. It changes nothing and sends no setpoint. Do it before every flight, with the vehicle as it will fly.

    Exit status 0 if nothing fails, 1 if something does, 2 for an unusable configuration, key, file or link.

    Example: companion check companion.yaml --param demanded.param
    """
    from companion.onboard.config import load_config
    from companion.onboard.preflight_service import check_vehicle
    from companion.runtime.clock import run_until_signal

    loaded = load_config(config)
    return run_until_signal(lambda stop: check_vehicle(loaded, wait_s, stop, strict=strict, param=param))


@cli.command("identify")
@click.argument("config")
@click.option("--log", "log", metavar="FILE.tlog", help="Read this log of a flight instead of flying.")
@click.option("--write", "writes", is_flag=True, help="Write the limits that proved too good into CONFIG.")
def identify_command(config: str, log: str | None, writes: bool) -> int:
    """Measure how well the vehicle of CONFIG obeys, and compare that with what is reckoned with.

    Hand the vehicle over in the air. It then flies a pattern of one to two minutes at its height, inside the fence:
    steps of course and speed, stops and a hold, or a circle. A change of the mode ends it at once.

    Exit status 0 if nothing is worse than reckoned with, 1 if something is, nothing was measured, or the pattern was
    not flown to its end, 2 for unusable input.

    Example: companion identify companion.yaml --write
    """
    from companion.onboard.config import load_config
    from companion.onboard.identification.service import check_writable, fly_pattern, report, table_of_log, write_limits
    from companion.runtime.clock import run_until_signal

    if writes:
        check_writable(config)
    if log is not None:
        end, table = None, table_of_log(log, config)
    else:
        loaded = load_config(config)
        end, table = run_until_signal(lambda stop: fly_pattern(loaded, stop))
    status = report(end, table)
    if writes:
        write_limits(config, end, table)
    return status


@cli.command("replay")
@click.argument("log", metavar="FILE.tlog")
@click.option("--config", metavar="CONFIG", show_default="companion-N.yaml beside vehicle-N.tlog", help="Its settings.")
def replay_command(log: str, config: str | None) -> int:
    """Decide again what a flight decided, from its recording vehicle-N.tlog, and compare.

    The files that follow it (vehicle-N-2.tlog and so on) are read with it. Of a damaged log all that can be read is; a
    decision behind a gap may differ.

    Exit status 1 if a decision before any gap differs from the one made in flight.

    Example: companion replay runs/paper-dynamic/vehicle-1.tlog
    """
    from companion.files.yaml import read_text_file
    from companion.onboard.config import parse_config
    from companion.onboard.log_files import files_of, settings_of
    from companion.onboard.replay_text import replayed_lines

    settings = settings_of(log) if config is None else config
    if settings is None:
        raise InputError(f"{log}: not vehicle-N.tlog, so --config is needed; allowed: the configuration of the flight")
    loaded = parse_config(read_text_file(Path(settings)), settings)
    return EXIT_FAILED if replayed_lines(log, files_of(log), loaded, click.echo) else EXIT_DONE


@cli.command()
@click.option(
    "--surrogate",
    type=click.Choice(("pairwise", "monolithic")),
    default="pairwise",
    show_default=True,
    help="The network that flies, or the paper's, which does not.",
)
@click.option("--out", type=click.Path(path_type=Path), show_default="SURROGATE.json", help="Weights file to write.")
@click.option(
    "--seed", type=click.IntRange(min=0, max=2**63 - 1), default=0, show_default=True, help="Decides the result."
)
@click.option(
    "--samples", type=click.IntRange(MIN_SAMPLES, MAX_SAMPLES), default=100_000, show_default=True, help="In all."
)
@click.option("--epochs", type=click.IntRange(min=1), default=1000, show_default=True, help="At most this many.")
def train(surrogate: str, out: Path | None, seed: int, samples: int, epochs: int) -> None:
    """Train a surrogate and write its weights (needs the extra `train`).

    Example: companion train --out pairwise.json
    """
    # The vehicle flies without torch, and without rich.
    try:
        from companion.surrogate import training, training_monolithic, training_pairwise
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise InputError("training needs torch, which is not installed: pip install '.[train]'") from error

    from rich.console import Console
    from rich.progress import Progress

    out = Path(f"{surrogate}.json") if out is None else out
    training.check_writable(out)
    trainings: dict[str, training.Training] = {
        "pairwise": training_pairwise.train_pairwise,
        "monolithic": training_monolithic.train_monolithic,
    }
    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as progress:
        task = progress.add_task("training", total=epochs)

        def show(epoch: int, validation_mse: float) -> None:
            progress.update(task, completed=epoch, description=f"validation MSE {validation_mse:.3e}")

        network, record = trainings[surrogate](seed, samples, epochs, show)
    digest = training.write_weights(out, network, record)
    figures = {
        "train MSE": f"{record.train_mse:.4e}",
        "validation MSE": f"{record.validation_mse:.4e}",
        "test MSE": f"{record.test_mse:.4e}",
        "variance of the target (test)": f"{record.test_target_variance:.4e}",
        **record.findings(),
        "epochs run": f"{record.epochs_run} of {record.epochs_allowed}, best {record.best_epoch}",
        "seed": str(record.seed),
        "digest": digest,
        "written": str(out),
    }
    for name, figure in figures.items():
        click.echo(f"{name}: {figure}")


@cli.command("certify")
@click.argument("mission")
@click.option(
    "--seed", type=click.IntRange(min=0, max=2**63 - 1), default=1, show_default=True, help="What the mission draws."
)
@click.option("--b", "b_m", type=float, metavar="METRES", help="State every bound at this b, not at half its largest.")
@click.option("--json", "as_json", is_flag=True, help="Print the certificate as JSON instead of tables.")
def certify_command(mission: str, seed: int, b_m: float | None, as_json: bool) -> int:
    """Say what the convergence theorem promises for MISSION, a YAML file or a packaged name, and where.

    The condition as printed, the corrected one, its sharp form and the tight bound, each with its numbers, the distance
    from the threats beyond which it holds, and the steps it promises each agent. docs/convergence.md has the proofs.

    Exit status 0 if at every speed one of them is satisfied somewhere, 1 if not, 2 for unusable input. 0 does not say
    that the bound stands in flight: an assumption marked NO voids the bounds that it names.

    Example: companion certify paper-dynamic --seed 1
    """
    if b_m is not None and not (b_m > 0.0 and math.isfinite(b_m)):
        raise InputError(f"--b: {b_m:g}; allowed: a positive number of metres")
    from companion.autopilot.missions import load_mission_to_fly
    from companion.mission.resolve import resolve
    from companion.surrogate.certificate_text import certificate_text
    from companion.surrogate.certificates import certify

    certificate = certify(resolve(load_mission_to_fly(mission), seed, mission), seed, b_m)
    tell(json.dumps(certificate.to_dict(), allow_nan=False) if as_json else certificate_text(certificate))
    return EXIT_DONE if certificate.certified else EXIT_FAILED


def main() -> None:
    """Run the program and exit with its status."""
    signal.signal(signal.SIGUSR1, signal.SIG_IGN)
    run_program(cli, "companion")
