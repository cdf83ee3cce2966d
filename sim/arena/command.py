"""`sim arena`: flies our laws and published methods side by side, and writes a folder of results."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Sequence
from pathlib import Path

import click
from rich.table import Table

from companion.errors import EXIT_DONE, EXIT_FAILED, tell
from sim.arena.families import FAMILIES
from sim.arena.peers import PEERS
from sim.arena.plots import PLOT_NAMES, draw_plots
from sim.arena.report import (
    JSON_NAME,
    MARKDOWN_NAME,
    ArenaOutcome,
    broken_promise,
    failures,
    summaries,
    write_arena,
    write_worst,
)
from sim.arena.run import OWN_LAWS, Run, check_installed, fly_all, jobs_of
from sim.terminal import chosen_names, job_progress, rendered, writable_folder

MAX_WORKERS = 8
"""Greatest number of worker processes; more would cost memory and save only seconds."""


@click.command("arena")
@click.option(
    "--runs",
    type=click.IntRange(1, 10_000),
    default=None,
    help="Missions a family, a quarter of it for fleets and the field; default: a full arena.",
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
    chosen_families = chosen_names("--family", families, tuple(FAMILIES))
    chosen_laws = chosen_names("--law", laws, (*OWN_LAWS, *PEERS))
    jobs = jobs_of(seed, runs, chosen_families, chosen_laws)
    check_installed(jobs)
    folder = writable_folder(out)
    began_s = time.perf_counter()
    with job_progress("arena", "missions") as progress:
        flown = fly_all(jobs, min(os.cpu_count() or 1, MAX_WORKERS), progress)
    # The figures first: half an hour of flights must not hang on a picture.
    saved = write_worst(folder, flown, seed)
    write_arena(folder, ArenaOutcome(flown, seed, time.perf_counter() - began_s, saved), PLOT_NAMES)
    draw_plots(folder, summaries(flown), flown)
    tell(_arena_table(flown, folder))
    return EXIT_FAILED if any(run.law == "routed" and broken_promise(run) for run in flown) else EXIT_DONE


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
            "-" if math.isnan(summary.arrivals.value) else f"{100.0 * summary.arrivals.value:.1f} %",
            str(summary.entries),
            str(summary.breaches),
            "-" if math.isnan(summary.ratio_median.value) else f"{summary.ratio_median.value:.4f}",
            f"{summary.decision_median_us:.0f}",
            end_section=place + 1 == len(found) or found[place + 1].family != summary.family,
        )
    before = ["Arrivals of feasible missions, entries from starts certified for ever; kinematic simulator"]
    after = [f"{run.family} {run.index}: {why}" for run, why in failures(runs)]
    after.append(f"written to {folder}: {MARKDOWN_NAME}, {JSON_NAME}, plots, worst/*.yaml")
    return rendered(before, table, after, wide=True)
