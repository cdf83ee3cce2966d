"""Writes the files that `sim fly` leaves in its folder at the end of a flight; `sim.flight_files` writes the others."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sim.agent_log import AgentLog
from sim.figures import clearance_png, plot_paths
from sim.flight_files import EVENTS_NAME, RESULT_NAME
from sim.flown import FlownMission
from sim.player import player_data
from sim.report import Pictures, write_report

_PATHS_NAME, _REPORT_NAME = "paths.png", "report.html"


def clear_folder(folder: Path) -> None:
    """Remove what an earlier flight wrote at its end, or only it did: no flight must leave that beside its own files.

    Raises:
        OSError: a file cannot be removed.

    """
    for name in (RESULT_NAME, _PATHS_NAME, _REPORT_NAME, EVENTS_NAME):
        (folder / name).unlink(missing_ok=True)


def write_folder(
    folder: Path, flown: FlownMission, result: Mapping[str, Any], logs: Mapping[int, AgentLog], command: str
) -> None:
    """Write `result.json`, `paths.png` and `report.html`, each whole or not at all.

    `logs` are those of the companions by id; `command` is the command line that repeats the flight, for the report.

    Raises:
        OSError: a file cannot be written.

    """
    part = folder / f".{RESULT_NAME}"
    part.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    part.replace(folder / RESULT_NAME)
    paths_png = plot_paths(flown, folder / _PATHS_NAME, flown.mission.name)
    pictures = Pictures(paths_png, clearance_png(flown.score, flown.mission), player_data(flown, logs))
    write_report(folder / _REPORT_NAME, flown, result, pictures, command)
