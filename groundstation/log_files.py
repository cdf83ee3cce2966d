"""Where the ground station's log goes: to the name of --log, or that name with a number, never over another log."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from companion.files.log_series import file_bytes, remove_oldest
from companion.onboard.flight_log import unused


def log_place(path: Path, most_bytes: int) -> Callable[[int], Path]:
    """Return the function that gives the path of each file of this run's log, and makes the room for it.

    All logs of this name and the same with a number, of this run and of earlier ones, have at most `most_bytes`
    together; the oldest of them make room.
    """
    chosen: dict[int, Path] = {}
    family = re.compile(re.escape(path.stem) + r"(-\d+)?" + re.escape(path.suffix))

    def path_of(number: int) -> Path:
        logs = [one for one in path.parent.iterdir() if family.fullmatch(one.name) and not one.is_symlink()]
        remove_oldest(sorted(logs, key=lambda log: log.stat().st_mtime), most_bytes - file_bytes(most_bytes))
        if number not in chosen:
            chosen[number] = unused(path)
        return chosen[number]

    return path_of
