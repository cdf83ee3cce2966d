"""What `companion check` finds wrong with the disks that a flight's state and logs go to: in flight it is not fatal."""

from __future__ import annotations

import os
from pathlib import Path

from companion.errors import InputError
from companion.files.log_series import LEAST_FREE_BYTES
from companion.onboard.config import Config
from companion.onboard.state_files import saved_authenticator_state, saved_authority

DISK_REMEDY = "give it a folder that can be written; remove a damaged file while the vehicle is disarmed"


def disk_troubles(config: Config, resumes_on_stream: bool) -> tuple[str, ...]:
    """Return what is wrong with the state files and the folder of the logs; nothing is changed.

    `resumes_on_stream`: the autopilot is one for which it matters who had the vehicle.
    """
    troubles: list[str] = []
    if config.broadcast is not None:
        try:
            troubles += saved_authenticator_state(config.broadcast).warnings
        except InputError as error:
            troubles.append(str(error))
    if config.autopilot is not None and resumes_on_stream:
        troubles += saved_authority(config.autopilot).warnings
    if config.log_dir is not None:
        troubles += _log_troubles(Path(config.log_dir))
    return tuple(troubles)


def _log_troubles(folder: Path) -> list[str]:
    """Return why no logs could be written in a folder, which need not be there yet."""
    nearest = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
        return [f"log_dir: {folder}: no logs can be written there; the vehicle would fly without them"]
    disk = os.statvfs(nearest)
    free = disk.f_bavail * disk.f_frsize
    if disk.f_blocks and free < LEAST_FREE_BYTES:
        return [f"log_dir: {folder}: {free / 1e6:.1f} MB free, {LEAST_FREE_BYTES / 1e6:.1f} needed for any logs"]
    return []
