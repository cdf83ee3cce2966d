"""Writes the files of a flight that `sim fly` leaves in its folder, except the logs, which are written in flight."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sim.figures import clearance_png, plot_paths
from sim.flown import FlownMission
from sim.report import Pictures, write_report


def write_folder(folder: Path, flown: FlownMission, result: Mapping[str, Any], command: str) -> None:
    """Write `trajectory.csv`, `result.json`, `paths.png` and `report.html`.

    `command` is the command line that repeats the flight, for the report.

    Raises:
        OSError: a file cannot be written.

    """
    flown.trajectory.write_csv(folder / "trajectory.csv")
    (folder / "result.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    paths_png = plot_paths(flown, folder / "paths.png", flown.mission.name)
    pictures = Pictures(paths_png, clearance_png(flown.score, flown.mission))
    write_report(folder / "report.html", flown, result, pictures, command)
