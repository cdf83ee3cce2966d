"""Loading of missions for a flight, with the check that a scaled mission is scaled for an existing autopilot kind."""

from __future__ import annotations

from pathlib import Path

from companion.autopilot.kinds import KINDS
from companion.errors import InputError, nearest_hint, one_line
from companion.mission.model import Mission, load_mission


def load_mission_to_fly(name_or_path: str | Path) -> Mission:
    """Load a mission by its packaged name or from a YAML file.

    Raises:
        InputError: as `load_mission` does, and for a `scale.autopilot` that is not the name of an autopilot kind.

    """
    mission = load_mission(name_or_path)
    if mission.scale is not None and mission.scale.autopilot not in KINDS:
        name = mission.scale.autopilot
        hint = nearest_hint(name, KINDS)
        raise InputError(one_line(f"{name_or_path}: scale: autopilot: '{name}'{hint}; allowed: {', '.join(KINDS)}"))
    return mission
