"""The arguments of `groundstation check`, and the picture's file."""

from __future__ import annotations

from pathlib import Path
from typing import TypedDict

from companion.autopilot.kinds import KINDS
from companion.autopilot.missions import load_mission_to_fly
from companion.errors import InputError
from companion.mission.resolve import resolve
from groundstation.check.overview import Overview, overview
from groundstation.choices import one_of, without_null
from groundstation.ground_station import check_runnable
from groundstation.options import refuse_monolithic

FORMS = ("png", "svg")
"""Formats of the picture."""


class CheckArguments(TypedDict):
    """Arguments of the command line as they were typed; None for one that was left out."""

    mission: str
    autopilot: str | None
    out: str | None
    as_json: bool
    seed: int


def checked(given: CheckArguments) -> Overview:
    """Return a mission in view; with `--out` draw it, too.

    Raises:
        InputError: an argument or the mission cannot be used, or the picture cannot be written.

    """
    name, out = given["mission"], given["out"]
    without_null({"MISSION": name, "--out": out})
    if given["autopilot"] is not None:
        one_of("--autopilot", given["autopilot"], tuple(KINDS))
    form = None if out is None else _form(out)
    mission = resolve(load_mission_to_fly(name), given["seed"], name)
    check_runnable(mission, name)
    refuse_monolithic(mission, name)
    found = overview(mission, given["seed"], given["autopilot"], name)
    if out is not None and form is not None:
        from groundstation.check.picture import mission_picture

        picture = mission_picture(mission, form)
        try:
            Path(out).write_bytes(picture)
        except OSError as error:
            raise InputError(f"--out: {out}: cannot be written: {error.strerror}") from error
    return found


def _form(out: str) -> str:
    form = Path(out).suffix.removeprefix(".").lower()
    if form not in FORMS:
        raise InputError(f"--out: '{out}'; allowed: a name that ends in .png or .svg")
    return form
