"""`sim reproduce`: runs the paper's experiments again and sets what is measured beside what the paper claims."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path

import click
from rich.table import Table

from companion.errors import EXIT_DONE, EXIT_FAILED, tell
from sim.reproduction.claims import Claim, all_claims
from sim.reproduction.experiments import MIN_SEEDS, Settings, run_all
from sim.reproduction.figures import draw_all
from sim.reproduction.report import JSON_NAME, MARKDOWN_NAME, is_paper_sized, write_report
from sim.terminal import job_progress, rendered, writable_folder

MAX_WORKERS = 8
"""Greatest number of worker processes; more would cost memory and save only seconds."""
MIN_SAMPLES = 100
"""Least number of training samples; fewer leave too small a validation set."""


@click.command("reproduce")
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
    folder = writable_folder(out)
    began_s = time.perf_counter()
    with job_progress("reproduce", "flights and trainings") as progress:
        results = run_all(settings, min(os.cpu_count() or 1, MAX_WORKERS), progress)
        figures = draw_all(results, folder)
    claims = all_claims(results)
    write_report(folder, results, claims, figures, time.perf_counter() - began_s)
    tell(_claims_table(claims, settings, folder))
    apart = [comparison.seed for comparison in results.wire if not comparison.agrees]
    if apart:
        click.echo(f"sim: the wire disagrees with the pure core: seeds {', '.join(map(str, apart))}", err=True)
    return EXIT_FAILED if apart else EXIT_DONE


def _claims_table(claims: Sequence[Claim], settings: Settings, folder: Path) -> str:
    table = Table()
    for column in ("claim", "paper", "here", "verdict"):
        table.add_column(column)
    last_of_paper = [claim for claim in claims if not claim.ours][-1]
    for claim in claims:
        table.add_row(claim.claim, claim.paper, claim.here, claim.verdict.value, end_section=claim is last_of_paper)
    before = ["The paper's claims, then this project's of the paper; kinematic simulator"]
    if not is_paper_sized(settings):
        before.append("Smaller than the paper's: no more than a trial of the program")
    after = [f"written to {folder}: {MARKDOWN_NAME} (with the reasons), {JSON_NAME}, figures"]
    return rendered(before, table, after, wide=True)
