"""Missions as programs load them: one that was scaled must have been scaled for a kind of autopilot that there is."""

from __future__ import annotations

from pathlib import Path

from companion.autopilot.kinds import KINDS
from companion.errors import InputError, nearest_hint, one_line
from companion.mission.model import Mission, load_mission


def load_mission_to_fly(name_or_path: str | Path) -> Mission:
    """Load a mission by its packaged name or from a YAML file.

    Raises:
        InputError: as `load_mission` does, or for a `scale.autopilot` that is no kind.

    """
    mission = load_mission(name_or_path)
    if mission.scale is not None and mission.scale.autopilot not in KINDS:
        name = mission.scale.autopilot
        hint = nearest_hint(name, KINDS)
        raise InputError(one_line(f"{name_or_path}: scale: autopilot: '{name}'{hint}; allowed: {', '.join(KINDS)}"))
    return mission
