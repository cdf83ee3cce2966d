"""Random missions over everything that a mission may have: `python -m tests.benchmarks.missions [N] [SEED]`.

Flies N missions of `sim.arena.missions`, on as many processes as there are cores. Each flight's figures are written as
they come, and a call that is repeated goes on where the last one ended. A mission that broke a promise is kept as a
file that `sim fly` flies, with what went wrong and the call in its first lines. The simulator is kinematic.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np

from companion.mission.model import dump_mission
from sim.arena.missions import random_mission
from sim.arena.survivors import survivors
from sim.arena.trial import LIMITS_MS, RATIO_LIMIT, Trial, fly_trial

LIMIT_S = 600.0
"""Longest time for one mission, after which its process is ended."""
ERROR = "error"


class Job(NamedTuple):
    """One random mission to fly."""

    seed: int
    number: int
    small: bool


def flown(job: Job) -> Trial:
    """Draw and fly one random mission."""
    return fly_trial(random_mission(*job))


def main() -> int:
    """Fly what is not flown yet, and print the figures of all; return 1 if a promise was broken."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int, nargs="?", default=200, metavar="N")
    parser.add_argument("seed", type=int, nargs="?", default=1, metavar="SEED")
    parser.add_argument("--out", type=Path, default=Path("runs/missions"))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--small", action="store_true", help="the small missions that the tests fly")
    options = parser.parse_args()
    folder = options.out / f"seed-{options.seed}{'-small' if options.small else ''}"
    (folder / "exceptions").mkdir(parents=True, exist_ok=True)
    log = folder / "flights.jsonl"
    done = {row["index"]: row for row in map(json.loads, log.read_text().splitlines())} if log.exists() else {}
    jobs = [Job(options.seed, index, options.small) for index in range(options.count) if index not in done]
    with log.open("a") as file:
        for job, found in survivors(flown, jobs, options.workers, LIMIT_S):
            row = {"index": job.number, **({ERROR: found} if isinstance(found, str) else asdict(found))}
            done[job.number] = row
            file.write(json.dumps(row) + "\n")
            file.flush()
            keep(folder / "exceptions", job, found)
    rows = [row for index, row in sorted(done.items()) if index < options.count]
    trials = [Trial(**{key: value for key, value in row.items() if key != "index"}) for row in rows if ERROR not in row]
    print(table([judged(trial) for trial in trials], [row[ERROR] for row in rows if ERROR in row]))
    return int(any(judged(trial).faults for trial in trials) or len(trials) < len(rows))


def judged(trial: Trial) -> Trial:
    """Return a trial whose lists from a file are tuples again."""
    return Trial(**{**asdict(trial), "certificates": tuple(trial.certificates), "why_not": tuple(trial.why_not)})


def keep(folder: Path, job: Job, found: Trial | str) -> None:
    """Write the mission of a flight that broke a promise, or that has no figures, into a folder."""
    wrong = (found.strip().splitlines()[-1],) if isinstance(found, str) else found.faults
    if isinstance(found, Trial) and found.slow:
        wrong = (*wrong, f"a decision of {found.decision_ms:.0f} ms")
    if isinstance(found, Trial) and found.path_ratio is not None and found.path_ratio > RATIO_LIMIT:
        wrong = (*wrong, f"path ratio {found.path_ratio:.3f}")
    if wrong:
        given = random_mission(*job)
        head = f"# {'; '.join(wrong)}\n# {given.call}\n"
        (folder / f"{given.mission.name}.yaml").write_text(head + dump_mission(given.mission), encoding="utf-8")


def table(trials: Sequence[Trial], errors: Sequence[str]) -> str:
    """Return the figures of all flights as text."""
    feasible = [t for t in trials if t.feasible and t.certificates == ("for ever",)]
    ratios = [t.path_ratio for t in feasible if t.path_ratio is not None]
    certificates = Counter(certificate for t in trials for certificate in t.certificates)
    lines = [
        f"{len(trials) + len(errors)} missions, {sum(t.packed for t in trials)} with packed frames, "
        f"{sum(t.agents for t in trials)} agents; kinematic simulator, {sum(t.cpu_s for t in trials):.0f} s of CPU",
        f"certificates at the start: {', '.join(f'{word} {number}' for word, number in certificates.most_common())}",
        f"entries of agents certified for ever before: {sum(t.entries_for_ever for t in trials)}"
        f" (of others: {sum(t.entries - t.entries_for_ever for t in trials)})",
        f"arrivals of feasible static single-agent missions certified for ever: "
        f"{sum(t.arrived == t.targets for t in feasible)} of {len(feasible)}",
        f"missions with a flight without a reason: {sum('no reason' in t.faults for t in trials)}",
        f"separation breaches: {sum(t.breaches for t in trials)}",
        f"tracebacks, hangs and dead processes: {len(errors)}",
    ]
    if ratios:
        lines.append(f"path ratio: median {np.median(ratios):.4f}, 99 % {np.quantile(ratios, 0.99):.4f}")
    at_least = -1
    for discs, limit_ms in LIMITS_MS:
        times_ms = [t.decision_ms for t in trials if at_least < t.discs <= discs]
        if times_ms:
            slow = sum(time_ms > limit_ms for time_ms in times_ms)
            lines.append(
                f"worst decision up to {discs} discs: {max(times_ms):.1f} ms of CPU, over {limit_ms:g} ms in {slow} of "
                f"{len(times_ms)} flights; 99 % of flights {np.quantile(times_ms, 0.99):.1f} ms"
            )
        at_least = discs
    faults = Counter((fault, t.recipe) for t in trials for fault in t.faults)
    lines += [f"{fault}, {recipe}: {number}" for (fault, recipe), number in faults.most_common()]
    return "\n".join(lines + [error.strip().splitlines()[-1] for error in errors[:20]])


if __name__ == "__main__":
    sys.exit(main())
