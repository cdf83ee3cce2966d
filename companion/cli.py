"""The command line of the program on the vehicle."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path

import click
from rich.console import Console
from rich.progress import Progress
from rich.table import Column, Table

from companion.certificate import Certificate, SpeedGroup, certify
from companion.config import load_config
from companion.drawing import resolve
from companion.errors import EXIT_DONE, EXIT_FAILED, InputError, run_program, tell
from companion.mission import load_mission
from companion.process import run_until_signal
from companion.service import run_companion

MIN_SAMPLES = 100
"""Fewer leave no validation set worth the name."""
CERTIFICATE_COLUMNS = 140
"""Width of the certificate's tables, in a pipe too."""


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
@click.option("--samples", type=click.IntRange(min=MIN_SAMPLES), default=100_000, show_default=True, help="In all.")
@click.option("--epochs", type=click.IntRange(min=1), default=1000, show_default=True, help="At most this many.")
def train(surrogate: str, out: Path | None, seed: int, samples: int, epochs: int) -> None:
    """Train a surrogate and write its weights (needs the extra `train`).

    Example: companion train --out pairwise.json
    """
    # Only here: the vehicle flies without torch.
    try:
        from companion import training, training_monolithic, training_pairwise
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise InputError("training needs torch, which is not installed: pip install '.[train]'") from error

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

    Exit status 0 if at every speed one of them holds somewhere, 1 if not, 2 for unusable input.

    Example: companion certify paper-dynamic --seed 1
    """
    if b_m is not None and not (b_m > 0.0 and math.isfinite(b_m)):
        raise InputError(f"--b: {b_m:g}; allowed: a positive number of metres")
    certificate = certify(resolve(load_mission(mission), seed, mission), seed, b_m)
    tell(json.dumps(certificate.to_dict(), allow_nan=False) if as_json else _certificate_text(certificate))
    return EXIT_DONE if certificate.certified else EXIT_FAILED


def _certificate_text(certificate: Certificate) -> str:
    console = Console(soft_wrap=True, highlight=False, markup=False, width=CERTIFICATE_COLUMNS)
    with console.capture() as capture:
        console.print(
            f"{certificate.mission}, seed {certificate.seed}, surrogate {certificate.surrogate}; lengths in m, v and "
            f"delta per step of {certificate.guidance_step_s:g} s"
        )
        for group in certificate.groups:
            console.print(f"\nagents at {group.speed_m_s:g} m/s: {len(group.agents)}")
            console.print(_findings_table(group))
            for finding in group.findings:
                if finding.why_not is not None:
                    console.print(f"{finding.title} does not hold: {finding.why_not}")
        console.print(
            f"\nThe network's weights alone allow |dF*/dx| up to {certificate.corollary.component_bound_m:.4g} m; the "
            "corollary asks for at most b."
        )
        console.print("\nAssumptions")
        for assumption in certificate.assumptions:
            answer = {True: "yes", False: "NO", None: "open"}[assumption.holds]
            console.print(f"  {answer:4}  {assumption.name}: {assumption.text}")
        console.print(f"\n{certificate.exclusion}")
        console.print(
            f"\nSteps to within {certificate.arrival_radius_m:g} m, at most. Line clear: by which bounds the straight "
            "way keeps its distance from every threat's start"
        )
        console.print(_bounds_table(certificate), end="")
    return capture.get().rstrip("\n")


def _findings_table(group: SpeedGroup) -> Table:
    findings = group.findings
    table = Table("figure", *(Column(finding.title, justify="right") for finding in findings))

    def add(name: str, figures: Iterable[float | None], form: str = ".4g") -> None:
        table.add_row(name, *("-" if figure is None else f"{figure:{form}}" for figure in figures))

    add("v", [group.step_m] * len(findings))
    add("delta", [group.target_step_m] * len(findings))
    add("largest b", (finding.largest_b_m for finding in findings))
    add("b used", (finding.b_m for finding in findings))
    table.add_row("holds at it", *("yes" if finding.holds else "NO" for finding in findings))
    for unit, name in (("m^2", "least decrease of D^2 (m^2)"), ("m", "least decrease of D (m)")):
        add(name, (finding.decrease if finding.decrease_unit == unit else None for finding in findings))
    table.add_row("corollary holds", *("yes" if finding.weights_suffice else "NO" for finding in findings))
    kinds = next((finding.threat_distances for finding in findings if finding.threat_distances), ())
    for index, kind in enumerate(kinds):
        about = f"R_d/R_a {kind.detection_radius_m:g}/{kind.attack_radius_m:g} (x{kind.threats})"
        distances = [finding.threat_distances[index] if finding.threat_distances else None for finding in findings]
        add(f"from the centre of {about}", (None if at is None else at.from_centre_m for at in distances), ".0f")
        add("  from the edge of R_d", (None if at is None else at.from_edge_m for at in distances), ".0f")
        add("  from the centre, as heard", (None if at is None else at.as_heard_m for at in distances), ".0f")
    add("from peers", (finding.peer_distance_m for finding in findings), ".0f")
    add("turn needed per step (deg)", (finding.turn_needed_deg for finding in findings))
    add("turn allowed per step (deg)", [group.turn_limit_deg] * len(findings))
    add("bend at a detection edge (deg)", (finding.bend_deg for finding in findings), ".2g")
    return table


def _bounds_table(certificate: Certificate) -> Table:
    titles = {finding.condition: finding.title for finding in certificate.groups[0].findings}
    table = Table("agent", "target", Column("distance", justify="right"))
    for title in titles.values():
        table.add_column(title, justify="right")
    table.add_column("line clear")
    for bound in certificate.agents:
        clear = [titles[condition] for condition, is_clear in bound.line_clear.items() if is_clear]
        table.add_row(
            str(bound.agent),
            f"{bound.target}, {bound.which}",
            f"{bound.distance_m:.0f}",
            *("-" if steps is None else str(steps) for steps in bound.steps.values()),
            "all" if len(clear) == len(titles) else ", ".join(clear) or "none",
        )
    return table


def main() -> None:
    """Run the program and exit with its status."""
    run_program(cli, "companion")
