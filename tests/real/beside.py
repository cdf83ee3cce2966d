"""The same mission on the stand-in, from the places and courses at which the real vehicles were handed over."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

from companion.errors import InputError
from companion.mission.model import load_mission
from sim.score import score
from sim.trajectory import read_csv
from tests.real.flight import HAND_OVER_AFTER_S, SEED
from tests.real.lane import Job
from tests.real.score import path_length_m

FOLDER = "stand-in"
LONGEST_S = 300.0


class Ratio(NamedTuple):
    """A real agent's time and path to its target, as multiples of its stand-in's."""

    agent_id: int
    time: float
    path: float


def fly_beside(folder: Path, job: Job) -> None:
    """Fly the mission of the flight in a folder with `sim fly`, into a folder below it.

    Raises:
        InputError: `sim fly` does not fly it.

    """
    command = [
        sys.executable, "-m", "sim", "fly", str(folder / "mission-begun.yaml"), "--autopilot", job.kind.name,
        "--seed", str(SEED), "--out", str(folder / FOLDER), "--json",
    ]  # fmt: skip
    for name, value in job.scenario.stand_in_parameters(job.kind).items():
        command += ["--param", f"{name}={value:g}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST_S, check=False)
    if not (folder / FOLDER / "result.json").is_file():
        raise InputError(f"{folder.name}: the stand-in was not flown: {done.stderr.strip()}")


def ratios(folder: Path) -> list[Ratio]:
    """Return how the agents compare that arrived in both flights; none if the stand-in was not flown."""
    below = folder / FOLDER
    if not (below / "trajectory.csv").is_file():
        return []
    trajectory = read_csv(below / "trajectory.csv")
    stand_ins = score(trajectory, load_mission(below / "mission.yaml"))
    real: list[dict[str, Any]] = json.loads((folder / "figures.json").read_text(encoding="utf-8"))["agents"]
    compared = []
    for index, (ours, theirs) in enumerate(zip(real, stand_ins.per_agent, strict=True)):
        if ours["arrived_s"] is None or theirs.arrived_t_s is None:
            continue
        flown = (trajectory.t_s >= HAND_OVER_AFTER_S) & (trajectory.t_s <= theirs.arrived_t_s)
        length_m = path_length_m(trajectory.agents_ned_m[flown, index])
        time_s = theirs.arrived_t_s - HAND_OVER_AFTER_S
        compared.append(Ratio(theirs.id, ours["arrived_s"] / time_s, ours["path_m"] / length_m))
    return compared
