"""Flies real autopilot programs through the scenarios and writes the table: docs/real-autopilots.md.

`python -m tests.real list`, `python -m tests.real fly [PATTERN...] --out DIR`, `python -m tests.real table DIR`.
"""

from __future__ import annotations

import argparse
import fnmatch
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from companion.errors import InputError
from tests.real.beside import fly_beside
from tests.real.lane import Job, can_have_networks, fly_apart, fly_here, job_of, jobs, judge
from tests.real.programs import NOT_GIVEN
from tests.real.table import table


def main() -> int:
    """Do what the command line says; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.real", description="Fly real autopilot programs.")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="the flights, as SCENARIO:KIND")
    fly = commands.add_parser("fly", help="fly what matches the patterns, all that can be flown without one")
    fly.add_argument("patterns", nargs="*", default=["*"], metavar="PATTERN", help="of SCENARIO:KIND, such as wind*:*")
    fly.add_argument("--out", type=Path, required=True, help="a folder for each flight goes there")
    fly.add_argument("--jobs", type=int, default=1, help="how many flights at once, each in a network of its own")
    one = commands.add_parser("one", help="fly one in this network; what `fly` starts")
    one.add_argument("flight")
    one.add_argument("folder", type=Path)
    again = commands.add_parser("score", help="score the flights in a folder again")
    again.add_argument("folder", type=Path)
    beside = commands.add_parser("beside", help="fly the missions of the flights in a folder on the stand-ins, too")
    beside.add_argument("folder", type=Path)
    shown = commands.add_parser("table", help="the flights in a folder as a markdown table")
    shown.add_argument("folder", type=Path)
    options = parser.parse_args()
    try:
        if options.command == "list":
            print("\n".join(f"{job.name}: {job.scenario.shows}" for job in jobs()))
        elif options.command == "one":
            print(fly_here(Job.named(options.flight), options.folder))
        elif options.command == "score":
            for folder in _flown(options.folder):
                print(f"{folder.name}: {'; '.join(judge(job_of(folder), folder)) or 'as wanted'}")
        elif options.command == "beside":
            for folder in _flown(options.folder):
                job = job_of(folder)
                if not job.scenario.events and not job.scenario.refused:
                    fly_beside(folder, job)
        elif options.command == "table":
            print(table(options.folder), end="")
        else:
            return _fly(options.patterns, options.out, options.jobs)
    except InputError as error:
        print(f"tests.real: {error}", file=sys.stderr)
        return 2
    return 0


def _flown(out: Path) -> list[Path]:
    return sorted(path.parent for path in out.glob("*/flight.json"))


def _fly(patterns: list[str], out: Path, at_once: int) -> int:
    """Fly what matches, some at once if each can have a network of its own; return 1 if a bound was not kept."""
    chosen = [
        job for job in jobs() if job.can_be_flown and any(fnmatch.fnmatch(job.name, pattern) for pattern in patterns)
    ]
    if not chosen:
        raise InputError(f"nothing to fly: {NOT_GIVEN}")
    at_once = at_once if can_have_networks() else 1
    with ThreadPoolExecutor(at_once) as pool:
        wrong = [verdict.broken for verdict in pool.map(lambda job: fly_apart(job, out), chosen)]
    return 1 if any(wrong) else 0


if __name__ == "__main__":
    sys.exit(main())
