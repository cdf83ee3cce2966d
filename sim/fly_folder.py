"""The folder that `sim fly` leaves of a flight, beside the logs that are written while it flies."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sim.figures import clearance_png, plot_paths
from sim.flown import FlownMission
from sim.report import Pictures, write_report


def write_folder(folder: Path, flown: FlownMission, result: Mapping[str, Any], command: str) -> None:
    """Write `trajectory.csv`, `result.json`, `paths.png` and `report.html`; `command` is what repeats the flight.

    Raises OSError where a file cannot be written.
    """
    flown.trajectory.write_csv(folder / "trajectory.csv")
    (folder / "result.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    paths_png = plot_paths(flown, folder / "paths.png", flown.mission.name)
    pictures = Pictures(paths_png, clearance_png(flown.score, flown.mission))
    write_report(folder / "report.html", flown, result, pictures, command)
