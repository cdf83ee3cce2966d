"""Writes a fleet's folder: each vehicle's configuration and keys, and the list of what goes where."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from companion.errors import InputError
from companion.mission.model import Mission
from companion.onboard.config import dump_config, load_config
from companion.protocol.keys import (
    MAVLINK_NAME,
    PUBLIC_NAME,
    add_mavlink_keys,
    add_public,
    load_mavlink_key,
    load_public,
)
from groundstation.fleet.configs import Equipped
from groundstation.input_keys import UPLINK_NAME, vehicle_key, vehicle_name

LIST_NAME = "README.md"
KEYS_NAME = "keys"
CONFIG_FOLDER = "/etc/oneway-guidance"
"""Folder of the configurations on a vehicle's computer (docs/deploy.md)."""
_FOLDER_MODE = 0o700


@dataclass(frozen=True)
class Sources:
    """From what a fleet's folder was made, as its user named it."""

    mission: str
    fleet: str | None
    keys: str | None


def write_fleet(folder: Path, mission: Mission, fleet: Sequence[Equipped], sources: Sources) -> list[Path]:
    """Write the folder of a fleet and return the paths of its configurations and its list.

    Configurations and list replace earlier ones. A key is never replaced.

    Raises:
        InputError: a key cannot be used, or another one is there, or a file cannot be written.

    """
    written = []
    try:
        folder.mkdir(mode=_FOLDER_MODE, parents=True, exist_ok=True)
        for one in fleet:
            home = folder / f"vehicle-{one.vehicle.id}"
            home.mkdir(mode=_FOLDER_MODE, exist_ok=True)
            if sources.keys is not None and one.keys:
                _write_keys(home / KEYS_NAME, one, Path(sources.keys))
            path = home / f"{one.vehicle.id}.yaml"
            path.write_text(_heading(one, sources) + dump_config(one.config), encoding="utf-8")
            load_config(str(path))
            written.append(path)
        listed = folder / LIST_NAME
        listed.write_text(_list(mission, fleet, sources), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{error.filename or folder}: cannot be written: {error.strerror}") from error
    return [*written, listed]


def _write_keys(folder: Path, one: Equipped, source: Path) -> None:
    folder.mkdir(mode=_FOLDER_MODE, exist_ok=True)
    if PUBLIC_NAME in one.keys:
        public = load_public(source / PUBLIC_NAME)
        add_public(folder, public)
        _refuse_another(folder / PUBLIC_NAME, load_public(folder / PUBLIC_NAME) == public)
    secret = {MAVLINK_NAME: load_mavlink_key(source / MAVLINK_NAME)} if MAVLINK_NAME in one.keys else {}
    own_name = vehicle_name(one.vehicle.id)
    if own_name in one.keys:
        secret[own_name] = vehicle_key(load_mavlink_key(source / UPLINK_NAME), one.vehicle.id)
    add_mavlink_keys(folder, secret)
    for name, key in secret.items():
        _refuse_another(folder / name, load_mavlink_key(folder / name) == key)


def _refuse_another(path: Path, is_same: bool) -> None:
    if not is_same:
        raise InputError(f"{path}: is there already, with another key; a key is never overwritten: name another folder")


def _heading(one: Equipped, sources: Sources) -> str:
    made_from = " and ".join(os.path.basename(name) for name in (sources.mission, sources.fleet) if name is not None)
    return (
        f"# Vehicle {one.vehicle.id}, written by `groundstation fleet` from {made_from}.\n"
        "# Change those and write it again: what is changed here alone, the ground station does not know.\n"
    )


def _list(mission: Mission, fleet: Sequence[Equipped], sources: Sources) -> str:
    lines = [
        f"# The fleet of {mission.name}",
        "",
        f"Written by `groundstation fleet {sources.mission}`. Each vehicle's computer gets what is in its folder here:",
        "",
        "| vehicle | kind | autopilot | hears the broadcast on | speed, n_max | height | files |",
        "|---|---|---|---|---|---|---|",
        *map(_row, fleet),
        "",
        "As root on the vehicle's computer, from its folder (docs/deploy.md installs the program):",
        "",
        "```sh",
    ]
    for one in fleet:
        lines += _commands(one)
    lines += [
        "```",
        "",
        "Before each flight `companion check` must pass on every vehicle, and the ground station must broadcast this",
        "very mission. After a change of mission or fleet this folder is written, and copied, again.",
        "",
    ]
    return "\n".join(lines)


def _row(one: Equipped) -> str:
    config, number = one.config, one.vehicle.id
    assert config.autopilot is not None and config.broadcast is not None
    files = f"{number}.yaml" + "".join(f", {KEYS_NAME}/{name}" for name in one.keys)
    return (
        f"| {number} | {config.autopilot.kind} | `{config.autopilot.link}` | `{config.broadcast.link}` | "
        f"{config.limits.speed_m_s:g} m/s, {config.limits.n_max:g} g | {config.height_m:g} m | {files} |"
    )


def _commands(one: Equipped) -> list[str]:
    config, number = one.config, one.vehicle.id
    path = f"{CONFIG_FOLDER}/{number}.yaml"
    lines = [f"# vehicle {number}", f"install -m 644 {number}.yaml {path}"]
    if one.keys:
        assert config.broadcast is not None
        at = next(
            (PurePosixPath(key).parent for key in (config.broadcast.mavlink_key, config.broadcast.public_key) if key),
            PurePosixPath(CONFIG_FOLDER),
        )
        names = " ".join(f"{KEYS_NAME}/{name}" for name in one.keys)
        lines += [f"install -d -o oneway -m 700 {at}", f"install -o oneway -m 600 {names} {at}/"]
    return [*lines, f"sudo -u oneway companion check {path}"]
