"""The `sim` command line."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from companion.autopilot.missions import load_mission_to_fly
from companion.errors import EXIT_DONE, EXIT_FAILED, InputError, nearest_hint, run_program, tell
from companion.guidance.settings import DEFAULT_LAW, LAWS, LawName
from companion.mission.lint import lint
from companion.mission.model import Mission, dump_mission
from companion.mission.resolve import resolve
from groundstation.radio import RADIOS_BYTES_PER_S, parse_radio
from sim.arena.families import FAMILIES
from sim.arena.peers import PEERS
from sim.arena.plots import PLOT_NAMES, draw_plots
from sim.arena.report import JSON_NAME as ARENA_JSON_NAME
from sim.arena.report import MARKDOWN_NAME as ARENA_MARKDOWN_NAME
from sim.arena.report import broken_promise, failures, summaries, write_arena, write_worst
from sim.arena.run import OWN_LAWS, Run, fly_all, jobs_of
from sim.figures import clearance_png, plot_paths
from sim.lockstep import AUTOPILOTS, WHY_NOT_MONOLITHIC, Flight, check_flyable, fly
from sim.report import KINEMATIC, write_report
from sim.reproduction.claims import Claim, all_claims
from sim.reproduction.experiments import MIN_SEEDS, Settings, run_all
from sim.reproduction.figures import draw_all
from sim.reproduction.report import JSON_NAME, MARKDOWN_NAME, is_paper_sized
from sim.reproduction.report import write_report as write_reproduction
from sim.scaling import scaled
from sim.score import Score, score
from sim.vehicle_service import vehicle

MAX_SEED = 2**63 - 1
MAX_WORKERS = 8
"""Processes of `sim reproduce`; more would cost their memory and save seconds."""
PIPE_COLUMNS = 200
"""Width of the table of claims where there is no terminal: no claim is broken over lines."""
MIN_SAMPLES = 100
"""Fewer leave no validation set worth the name."""


@click.group()
@click.version_option(package_name="oneway-guidance")
def cli() -> None:
    """Fly missions in lockstep, or be one autopilot in real time: the stand-in world.

    Example: sim fly paper-dynamic --seed 1 --out runs/1
    """


cli.add_command(vehicle)


@cli.command("fly")
@click.argument("mission")
@click.option(
    "--seed", type=click.IntRange(0, MAX_SEED), default=1, show_default=True, help="What is drawn, and moves."
)
@click.option("--law", default=DEFAULT_LAW, show_default=True, help=f"Guidance law: {', '.join(LAWS)}.")
@click.option("--autopilot", default="kinematic", show_default=True, help=f"Stand-in: {', '.join(AUTOPILOTS)}.")
@click.option("--vehicles", type=click.IntRange(1, 2_000), help="Fly this many agents instead of the mission's number.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for trajectory, logs, pictures and report.")
@click.option("--json", "as_json", is_flag=True, help="Print result.json instead of the table.")
@click.option(
    "--radio", metavar="NAME", help=f"Broadcast over a radio's budget: {', '.join(RADIOS_BYTES_PER_S)}, or B/s."
)
@click.option("--share", type=float, help="Of the radio's bytes, for the broadcast; all unless said otherwise.")
@click.option("--one-radio", is_flag=True, help="The broadcast reaches each companion through its autopilot.")
@click.option("--no-scale", is_flag=True, help="Fly the mission as it is: it was made for the autopilot's vehicle.")
@click.option("--realtime", is_flag=True, help="Pace the virtual clock by the wall clock.")
@click.option("--allow-monolithic", is_flag=True, help="Fly `surrogate: monolithic` all the same, to see it fail.")
def fly_command(
    mission: str,
    seed: int,
    law: str,
    autopilot: str,
    vehicles: int | None,
    out: Path | None,
    as_json: bool,
    radio: str | None,
    share: float | None,
    one_radio: bool,
    no_scale: bool,
    realtime: bool,
    allow_monolithic: bool,
) -> int:
    """Fly MISSION, a YAML file or a packaged name, over real frames on a virtual clock.

    Missions are written for the paper's 60 m/s: for an autopilot's stand-in every length and speed is multiplied by
    its cruise speed over that, and mission.yaml says by how much.

    Exit status 0 if every target was reached, 1 if not, 2 for unusable input or a folder that cannot be written.

    Example: sim fly paper-dynamic --seed 1 --out runs/1

    Example: sim fly paper-dynamic --autopilot arduplane --seed 1 --out runs/2
    """
    chosen = _law(law)
    if radio is None and share is not None:
        raise InputError(f"--share: {share:g} without --radio; allowed: with --radio NAME")
    over = None if radio is None else parse_radio(radio, 1.0 if share is None else share)
    if over is not None and one_radio and not over.wrapped:
        raise InputError(f"--one-radio: with --radio {radio}; allowed: --radio {radio}/v2ext, as the autopilot needs")
    if autopilot not in AUTOPILOTS:
        hint = nearest_hint(autopilot, AUTOPILOTS)
        raise InputError(f"--autopilot: '{autopilot}'{hint}; allowed: {', '.join(AUTOPILOTS)}")
    loaded = load_mission_to_fly(mission)
    if vehicles is not None:
        loaded = _with_vehicles(loaded, vehicles, mission)
    resolved = resolve(loaded, seed, mission)
    resolved = resolved if no_scale else scaled(resolved, autopilot, mission)
    check_flyable(resolved, mission, allow_monolithic)
    if resolved.surrogate == "monolithic":
        click.echo(f"sim: warning: {mission}: surrogate: 'monolithic' should not fly: {WHY_NOT_MONOLITHIC}", err=True)
    for warning in lint(resolved):
        click.echo(f"sim: warning: {mission}: {warning}", err=True)
    folder = None if out is None else _writable_folder(out)
    if folder is not None:
        # First, so that an interrupted flight leaves what it was.
        (folder / "mission.yaml").write_text(dump_mission(resolved), encoding="utf-8")
    with _progress(len(resolved.targets)) as progress:
        flight = fly(
            resolved,
            seed,
            chosen,
            autopilot,
            folder,
            realtime,
            progress,
            allow_monolithic=allow_monolithic,
            radio=over,
            one_radio=one_radio,
        )
    scored = score(flight.trajectory, resolved)
    result = result_of(scored, flight, seed, chosen)
    stand_in = _stand_in(resolved, autopilot)
    if folder is not None:
        again = f"sim fly {mission} --seed {seed} --law {law} --autopilot {autopilot}"
        again += "" if vehicles is None else f" --vehicles {vehicles}"
        again += "" if over is None else f" --radio '{radio}' --share {over.share:g}"
        again += " --one-radio" * one_radio + " --no-scale" * no_scale
        _write(folder, resolved, scored, flight, result, again, stand_in)
    tell(json.dumps(result) if as_json else _table(resolved, result, folder, stand_in))
    return EXIT_DONE if scored.targets_reached == scored.targets else EXIT_FAILED


@cli.command("reproduce")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("reproduce"),
    show_default=True,
    help="Folder for reproduce.md, reproduce.json and the figures.",
)
@click.option(
    "--seeds",
    type=click.IntRange(MIN_SEEDS, 100_000),
    default=Settings.seeds,
    show_default=True,
    help="Flights of each experiment.",
)
@click.option(
    "--samples", type=click.IntRange(MIN_SAMPLES), default=Settings.samples, show_default=True, help="For training."
)
@click.option(
    "--epochs", type=click.IntRange(1), default=Settings.epochs, show_default=True, help="At most; for training."
)
def reproduce_command(out: Path, seeds: int, samples: int, epochs: int) -> int:
    """Run the paper's experiments again and set what is measured beside what it claims (needs the extra `train`).

    Exit status 0 whatever the verdicts, 1 if the flights over the wire disagree with those on the pure core, 2 for
    unusable input or a folder that cannot be written.

    Example: sim reproduce --out runs/reproduce
    """
    settings = Settings(seeds=seeds, samples=samples, epochs=epochs)
    folder = _writable_folder(out)
    began_s = time.perf_counter()
    with _job_progress("reproduce", "flights and trainings") as progress:
        results = run_all(settings, min(os.cpu_count() or 1, MAX_WORKERS), progress)
        figures = draw_all(results, folder)
    claims = all_claims(results)
    write_reproduction(folder, results, claims, figures, time.perf_counter() - began_s)
    tell(_claims_table(claims, settings, folder))
    apart = [comparison.seed for comparison in results.wire if not comparison.agrees]
    if apart:
        click.echo(f"sim: the wire disagrees with the pure core: seeds {', '.join(map(str, apart))}", err=True)
    return EXIT_FAILED if apart else EXIT_DONE


@cli.command("arena")
@click.option(
    "--runs",
    type=click.IntRange(1, 10_000),
    default=None,
    help="Missions a family, a quarter of it for fleets; default: a full arena.",
)
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=1, show_default=True, help="Draws the missions.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("arena"),
    show_default=True,
    help="Folder for arena.md, arena.json, the plots and the worst runs.",
)
@click.option("--family", "families", multiple=True, help="Only this family; may be given several times.")
@click.option("--law", "laws", multiple=True, help="Only this law or method; may be given several times.")
def arena_command(runs: int | None, seed: int, out: Path, families: tuple[str, ...], laws: tuple[str, ...]) -> int:
    """Fly our laws and published methods side by side over families of scenes (needs the extra `arena`).

    Exit status 0 if `routed` kept its promises in every family: no entry from a certified start, no breach of
    separation. 1 if it did not, 2 for unusable input or a folder that cannot be written.

    Example: sim arena --runs 20 --seed 1 --out runs/arena
    """
    chosen_families = _chosen("--family", families, tuple(FAMILIES))
    chosen_laws = _chosen("--law", laws, (*OWN_LAWS, *PEERS))
    folder = _writable_folder(out)
    began_s = time.perf_counter()
    with _job_progress("arena", "missions") as progress:
        flown = fly_all(
            jobs_of(seed, runs, chosen_families, chosen_laws), min(os.cpu_count() or 1, MAX_WORKERS), progress
        )
    # The figures first: half an hour of flights must not hang on a picture.
    saved = write_worst(folder, flown, seed)
    write_arena(folder, flown, seed, time.perf_counter() - began_s, saved, PLOT_NAMES)
    draw_plots(folder, summaries(flown), flown)
    tell(_arena_table(flown, folder))
    return EXIT_FAILED if any(run.law == "routed" and broken_promise(run) for run in flown) else EXIT_DONE


def result_of(scored: Score, flight: Flight, seed: int, law: LawName) -> dict[str, Any]:
    """Return the content of `result.json` (docs/outputs.md explains each figure)."""
    figures: dict[str, Any] = scored.to_dict()
    quantiles = np.percentile(flight.decision_us, [50, 99, 99.9, 100]) if flight.decision_us.size else [0.0] * 4
    return {
        "seed": seed,
        "law": law,
        **figures,
        "steps": flight.steps,
        "guard_interventions": flight.guard_interventions,
        "turn_limited_steps": flight.turn_limited_steps,
        "decision_us": {
            name: round(float(value), 1)
            for name, value in zip(("median", "p99", "p999", "max"), quantiles, strict=True)
        },
        "broadcast_bytes": flight.broadcast_bytes,
        "broadcast_frames": flight.broadcast_frames,
        "frames_lost": flight.frames_lost,
        "speedup": round(flight.speedup, 1),
    }


def _law(name: str) -> LawName:
    chosen = next((law for law in LAWS if law == name), None)
    if chosen is not None:
        return chosen
    raise InputError(f"--law: '{name}'{nearest_hint(name, LAWS)}; allowed: {', '.join(LAWS)}")


def _with_vehicles(mission: Mission, count: int, source: str) -> Mission:
    listed = mission.agents[:count]
    draw = mission.draw.model_copy(update={"agents": count - len(listed)})
    targets = len(mission.targets) + mission.draw.targets
    if count < targets:
        raise InputError(f"{source}: --vehicles: {count}; allowed: at least as many as its {targets} targets")
    return mission.model_copy(update={"agents": listed, "draw": draw})


def _writable_folder(path: Path) -> Path:
    if str(path) == ".":
        raise InputError("--out: ''; allowed: the name of a folder (./NAME for one here)")
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / ".writable"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise InputError(f"--out: '{path}' cannot be written: {error.strerror}; allowed: a writable folder") from error
    return path


@contextmanager
def _progress(targets: int) -> Iterator[Callable[[float, int], None]]:
    """Show targets reached and virtual time on a terminal; nothing in a pipe."""
    console = Console(stderr=True)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} targets"),
        BarColumn(),
        TextColumn("flown {task.fields[flown]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("fly", total=targets, flown="0 s")

        def show(t_s: float, reached: int) -> None:
            bar.update(task, completed=reached, flown=f"{t_s:.0f} s")

        yield show


@contextmanager
def _job_progress(title: str, jobs: str) -> Iterator[Callable[[int, int], None]]:
    """Show jobs done on a terminal; nothing in a pipe."""
    console = Console(stderr=True)
    columns = (
        SpinnerColumn(),
        TextColumn(f"{{task.completed:.0f}}/{{task.total:.0f}} {jobs}"),
        BarColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=1)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _chosen(option: str, given: Sequence[str], allowed: Sequence[str]) -> list[str]:
    """Return what was asked for in the order of what is allowed; everything if nothing was."""
    for name in given:
        if name not in allowed:
            raise InputError(f"{option}: '{name}'{nearest_hint(name, allowed)}; allowed: {', '.join(allowed)}")
    return [name for name in allowed if not given or name in given]


def _arena_table(runs: Sequence[Run], folder: Path) -> str:
    table = Table()
    for column in ("family", "law", "feasible", "arrivals", "entries", "breaches", "path ratio", "decision us"):
        table.add_column(column)
    found = summaries(runs)
    for place, summary in enumerate(found):
        table.add_row(
            summary.family,
            summary.law,
            f"{summary.feasible} of {summary.flights}",
            f"{100.0 * summary.arrivals.value:.1f} %",
            str(summary.entries),
            str(summary.breaches),
            f"{summary.ratio_median.value:.4f}",
            f"{summary.decision_median_us:.0f}",
            end_section=place + 1 == len(found) or found[place + 1].family != summary.family,
        )
    width = None if sys.stdout.isatty() else PIPE_COLUMNS
    console = Console(soft_wrap=True, highlight=False, markup=False, width=width)
    with console.capture() as capture:
        console.print("Arrivals of feasible missions, entries from certified starts; kinematic simulator")
        console.print(table, end="")
        for run, why in failures(runs):
            console.print(f"\n{run.family} {run.index}: {why}", end="")
        console.print(f"\nwritten to {folder}: {ARENA_MARKDOWN_NAME}, {ARENA_JSON_NAME}, plots, worst/*.yaml")
    return capture.get().rstrip("\n")


def _claims_table(claims: Sequence[Claim], settings: Settings, folder: Path) -> str:
    table = Table()
    for column in ("claim", "paper", "here", "verdict"):
        table.add_column(column)
    for claim in claims:
        table.add_row(
            claim.claim, claim.paper, claim.here, claim.verdict.value, end_section=claim is _last_of_paper(claims)
        )
    width = None if sys.stdout.isatty() else PIPE_COLUMNS
    console = Console(soft_wrap=True, highlight=False, markup=False, width=width)
    with console.capture() as capture:
        console.print("The paper's claims, then this project's of the paper; kinematic simulator")
        if not is_paper_sized(settings):
            console.print("Smaller than the paper's: no more than a trial of the program")
        console.print(table, end="")
        console.print(f"\nwritten to {folder}: {MARKDOWN_NAME} (with the reasons), {JSON_NAME}, figures")
    return capture.get().rstrip("\n")


def _last_of_paper(claims: Sequence[Claim]) -> Claim:
    return [claim for claim in claims if not claim.ours][-1]


def _write(
    folder: Path,
    mission: Mission,
    scored: Score,
    flight: Flight,
    result: dict[str, Any],
    command: str,
    stand_in: str,
) -> None:
    flight.trajectory.write_csv(folder / "trajectory.csv")
    (folder / "result.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    paths_png = plot_paths(
        flight.trajectory,
        mission,
        scored,
        folder / "paths.png",
        mission.name,
        seed=result["seed"],
        law=result["law"],
        stand_in=stand_in,
    )
    write_report(
        folder / "report.html",
        mission,
        result,
        scored,
        flight.trajectory,
        paths_png,
        clearance_png(scored, mission),
        command,
        stand_in,
    )


def _stand_in(mission: Mission, autopilot: str) -> str:
    """Return what flew, as a line under figures says it."""
    if autopilot == "kinematic":
        return KINEMATIC
    return f"{autopilot} stand-ins" + ("" if mission.scale is None else f", scale {mission.scale.factor:.4g}")


def _table(mission: Mission, result: dict[str, Any], folder: Path | None, stand_in: str) -> str:
    table = Table()
    table.add_column("figure")
    table.add_column("value", justify="right")
    for name, value in _summary(result):
        table.add_row(name, value)
    console = Console(soft_wrap=True, highlight=False, markup=False)
    with console.capture() as capture:
        console.print(f"{mission.name}, seed {result['seed']}, law {result['law']}; {stand_in}")
        console.print(table, end="")
        if folder is not None:
            console.print(
                f"\nwritten to {folder}: report.html, paths.png, result.json, trajectory.csv, mission.yaml, *.tlog, "
                "companion-*.yaml"
            )
    return capture.get().rstrip("\n")


def _summary(result: dict[str, Any]) -> list[tuple[str, str]]:
    separation_m = result["min_separation_m"]
    return [
        ("targets reached", f"{result['targets_reached']} of {result['targets']}"),
        ("agents arrived", str(result["arrived"])),
        ("flight time", f"{result['flight_time_s']:.1f} s"),
        ("entries into R_d / R_a", f"{result['threat_entries_detection']} / {result['threat_entries_attack']}"),
        ("worst depth in R_d", f"{result['worst_depth_m']:.1f} m"),
        ("separation breaches", str(result["separation_breaches"])),
        ("least separation", "-" if separation_m is None else f"{separation_m:.1f} m"),
        ("turn-limited steps", str(result["turn_limited_steps"])),
        ("guard interventions", str(result["guard_interventions"])),
        ("decision median / p99", f"{result['decision_us']['median']:.0f} / {result['decision_us']['p99']:.0f} us"),
        ("broadcast", f"{result['broadcast_frames']} frames, {result['broadcast_bytes']} bytes"),
        ("frames lost, over all agents", str(result["frames_lost"])),
        ("speed", f"{result['speedup']:.0f} x real time"),
    ]


def main() -> None:
    """Run the `sim` program."""
    run_program(cli, "sim")
