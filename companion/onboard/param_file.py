"""Parameter files that ground-control programs load into an autopilot: what `companion check --param` writes.

ArduPilot's programs (Mission Planner, MAVProxy) read lines NAME,VALUE; for PX4 QGroundControl reads five columns with
tabs between them (docs.qgroundcontrol.com, "Parameter File Format").
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from pymavlink.dialects.v20 import common

from companion.autopilot.firmware import known
from companion.errors import InputError


def check_new(path: Path) -> None:
    """Check that a file does not exist yet and that there is a folder for it.

    Raises:
        InputError: the file exists, or its folder does not.

    """
    if path.exists() or path.is_symlink():
        raise InputError(f"--param: {path} exists; allowed: a new file, for nothing is overwritten")
    if not path.parent.is_dir():
        raise InputError(f"--param: {path}: no folder {path.parent}; allowed: a new file in an existing folder")


def write_param_file(path: Path, kind: str, system_id: int, values: Mapping[str, float]) -> None:
    """Write parameters by name into a new file, in the form of the kind's ground-control programs.

    Raises:
        InputError: the file exists, or cannot be written.

    """
    lines = _px4_lines(kind, system_id, values) if kind.startswith("px4") else _ardupilot_lines(values)
    try:
        with path.open("x", encoding="ascii") as file:
            file.writelines(f"{line}\n" for line in lines)
    except OSError as error:
        raise InputError(f"--param: {path}: cannot be written: {error.strerror}; allowed: a new file") from error


def _ardupilot_lines(values: Mapping[str, float]) -> Iterator[str]:
    for name, value in values.items():
        yield f"{name},{_number(value)}"


def _px4_lines(kind: str, system_id: int, values: Mapping[str, float]) -> Iterator[str]:
    yield f"# Onboard parameters for Vehicle {system_id}"
    yield "#"
    yield "# Vehicle-Id\tComponent-Id\tName\tValue\tType"
    for name, value in values.items():
        row = known(kind, name)
        # What has no unit is a choice or a set of bits, which PX4 keeps as an integer.
        integer = row is not None and not row.unit
        number = f"{value:.0f}" if integer else f"{value:.9f}"
        form = common.MAV_PARAM_TYPE_INT32 if integer else common.MAV_PARAM_TYPE_REAL32
        yield f"{system_id}\t{common.MAV_COMP_ID_AUTOPILOT1}\t{name}\t{number}\t{form}"


def _number(value: float) -> str:
    """Return a value as short as 32 bits allow, without an exponent."""
    return f"{value:.7f}".rstrip("0").rstrip(".")
