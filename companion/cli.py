"""The command line of the program on the vehicle."""

from __future__ import annotations

import json
import math
import re
import shutil
import textwrap
from collections.abc import Iterable
from pathlib import Path

import click
from rich.console import Console
from rich.progress import Progress
from rich.table import Column, Table

from companion.certificate import Certificate, Finding, SpeedGroup, ThreatDistance, certify
from companion.config import load_config, parse_config
from companion.drawing import resolve
from companion.errors import EXIT_DONE, EXIT_FAILED, InputError, run_program, tell
from companion.flightlog import line_of
from companion.mission import load_mission
from companion.process import run_until_signal
from companion.replay import replay
from companion.service import run_companion
from companion.tlog import read_tlog
from companion.yamlfile import read_text_file

MIN_SAMPLES = 100
"""Fewer leave no validation set worth the name."""
MAX_SAMPLES = 10_000_000
"""More would not fit into the memory of a common machine."""
CERTIFICATE_COLUMNS = 140
"""Width of the certificate's tables, in a pipe too."""
TEXT_COLUMNS = 120
"""The text about them is wrapped at the console's width, and at this at most."""


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


@cli.command("replay")
@click.argument("log", metavar="FILE.tlog")
@click.option("--config", metavar="CONFIG", show_default="companion-N.yaml beside vehicle-N.tlog", help="Its settings.")
def replay_command(log: str, config: str | None) -> int:
    """Decide again what a flight decided, from its recording vehicle-N.tlog, and compare.

    Exit status 1 if a decision differs from the one made in flight.

    Example: companion replay runs/paper-dynamic/vehicle-1.tlog
    """
    records = read_tlog(log)
    settings = _settings_beside(log) if config is None else config
    loaded = parse_config(read_text_file(Path(settings)), settings)
    said, decisions, different = "", 0, 0
    for replayed in replay(records, loaded):
        decision = replayed.decision
        decisions += 1
        different += not replayed.same
        line = line_of(decision)
        if line != said or not replayed.same:
            click.echo(f"{decision.t_s:.3f} {line}{'' if replayed.same else '  <- differs from the flight'}")
        said = line
    if decisions == 0:
        raise InputError(f"{log}: no decisions in it; allowed: vehicle-N.tlog of `companion run` or `sim fly --out`")
    click.echo(f"{decisions} decisions, {different or 'none'} different from those in flight")
    return EXIT_FAILED if different else EXIT_DONE


def _settings_beside(log: str) -> str:
    path = Path(log)
    found = re.fullmatch(r"vehicle-(\d+)\.tlog", path.name)
    if found is None:
        raise InputError(f"{log}: not vehicle-N.tlog, so --config is needed; allowed: the configuration of the flight")
    return str(path.with_name(f"companion-{found[1]}.yaml"))


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

    Exit status 0 if at every speed one of them is satisfied somewhere, 1 if not, 2 for unusable input. 0 does not say
    that the bound stands in flight: an assumption marked NO voids the bounds that it names.

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
            _wrapped(
                f"{certificate.mission}, seed {certificate.seed}, surrogate {certificate.surrogate}; lengths in m, a "
                f"step is {certificate.guidance_step_s:g} s"
            )
        )
        for group in certificate.groups:
            console.print(f"\nagents at {group.speed_m_s:g} m/s: {len(group.agents)}")
            console.print(_findings_table(group))
            for finding in group.findings:
                if finding.why_not is not None:
                    console.print(_wrapped(f"{finding.title} does not hold: {finding.why_not}"))
        if certificate.sources:
            subject = (
                "The profile's steepness alone allows"
                if certificate.surrogate == "analytic"
                else "The network's weights alone allow"
            )
            bound = f"|dF*/dx| up to {certificate.corollary.component_bound_m:.4g} m"
            console.print("\n" + _wrapped(f"{subject} {bound}; the corollary asks for at most b."))
        console.print("\nAssumptions")
        for assumption in certificate.assumptions:
            answer = {True: "yes", False: "NO", None: "open"}[assumption.holds]
            console.print(_wrapped(f"  {answer:4}  {assumption.name}: {assumption.text}", 8 * " "))
        console.print("\n" + _wrapped(certificate.exclusion))
        if any(finding.holds for group in certificate.groups for finding in group.findings):
            console.print(
                "\n"
                + _wrapped(
                    f"Steps to within {certificate.arrival_radius_m:g} m, at most. Line clear: by which bounds the "
                    "straight way keeps its distance from every threat's start."
                )
            )
            for assumption in certificate.assumptions:
                if assumption.voids and any(
                    finding.somewhere for group in certificate.groups for finding in group.findings
                ):
                    console.print(
                        _wrapped(
                            f"Void in flight: {', '.join(assumption.voids)}. Their steps hold only with "
                            f"{assumption.name}, as the theorem assumes."
                        )
                    )
            console.print(_bounds_table(certificate), end="")
    return capture.get().rstrip("\n")


def _wrapped(text: str, indent: str = "") -> str:
    width = min(TEXT_COLUMNS, shutil.get_terminal_size((TEXT_COLUMNS, 24)).columns)
    return textwrap.fill(text, max(width, 2 * len(indent) + 20), subsequent_indent=indent, break_on_hyphens=False)


def _findings_table(group: SpeedGroup) -> Table:
    findings = group.findings
    table = Table(
        Column("figure", no_wrap=True), *(Column(finding.title, justify="right", no_wrap=True) for finding in findings)
    )

    def add(name: str, figures: Iterable[float | str | None], form: str = ".4g") -> None:
        cells = ("-" if at is None else at if isinstance(at, str) else f"{at:{form}}" for at in figures)
        table.add_row(name, *cells)

    add("v (m per step)", [group.step_m] * len(findings))
    add("delta (m per step)", [group.target_step_m] * len(findings))
    add("largest b", (finding.largest_b_m or None for finding in findings))
    add("stated at b", (finding.b_m or None for finding in findings))
    add("condition satisfied", ("yes" if finding.holds else "NO" for finding in findings))
    add("left of b after late targets", (finding.left_b_m for finding in findings))
    for unit, name in (("m^2", "least decrease of D^2 (m^2)"), ("m", "least decrease of D (m)")):
        add(name, (finding.decrease if finding.decrease_unit == unit else None for finding in findings))
    add("weights alone suffice (corollary)", ("yes" if finding.weights_suffice else "NO" for finding in findings))
    kinds = next((finding.threat_distances for finding in findings if finding.threat_distances), ())
    for index, kind in enumerate(kinds):
        ats = [finding.threat_distances[index] if finding.threat_distances else None for finding in findings]
        radii = f"R_d {kind.detection_radius_m:g}, R_a {kind.attack_radius_m:g}"
        threats = "1 threat" if kind.threats == 1 else f"{kind.threats} threats"
        add(f"holds beyond, from the centre ({radii}; {threats})", map(_from_centre, ats), ".0f")
        add("  from the edge of R_d", map(_from_edge, ats), ".0f")
        add("  from the centre, as heard", (None if at is None else at.as_heard_m for at in ats), ".0f")
    if any(finding.peer_distance_m is not None for finding in findings):
        add("holds beyond, from another agent", (finding.peer_distance_m for finding in findings), ".0f")
    elif not kinds:
        add("holds beyond, from threats and other agents", map(_anywhere, findings))
    add("turn needed per step (deg)", (finding.turn_needed_deg for finding in findings))
    add("turn allowed per step (deg)", [group.turn_limit_deg] * len(findings))
    add("most that F* turns the path at a disc's edge (deg)", (finding.bend_deg for finding in findings), ".2g")
    return table


def _from_centre(at: ThreatDistance | None) -> float | str | None:
    return None if at is None else at.from_centre_m or "everywhere"


def _from_edge(at: ThreatDistance | None) -> float | str | None:
    return None if at is None else at.from_edge_m if at.from_centre_m else "everywhere"


def _anywhere(finding: Finding) -> str | None:
    """Return where it holds if no distance can be told."""
    return None if not finding.holds else "everywhere" if finding.somewhere else "nowhere known"


def _bounds_table(certificate: Certificate) -> Table:
    titles = {finding.condition: finding.title for finding in certificate.groups[0].findings}
    table = Table("agent", "target", Column("distance", justify="right"))
    for title in titles.values():
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("line clear")
    for bound in certificate.agents:
        known = {
            titles[condition]: is_clear for condition, is_clear in bound.line_clear.items() if is_clear is not None
        }
        clear = [title for title, is_clear in known.items() if is_clear]
        table.add_row(
            str(bound.agent),
            f"{bound.target}, {bound.which}",
            f"{bound.distance_m:.0f}",
            # Digits in groups of three, as in docs/convergence.md.
            *("-" if steps is None else f"{steps:,}".replace(",", " ") for steps in bound.steps.values()),
            "-" if not known else "all" if len(clear) == len(titles) else ", ".join(clear) or "none",
        )
    return table


def main() -> None:
    """Run the program and exit with its status."""
    run_program(cli, "companion")
