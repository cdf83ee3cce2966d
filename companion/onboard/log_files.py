"""The files that a run's log consists of, read one after the other, and the configuration beside them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from companion.files.log_series import parts_of
from companion.files.tlog import Tlog, read_tlog
from companion.runtime.console import program_logger

_NAME = re.compile(r"((?:vehicle|identify)-(\d+))(?:-(\d+))?\.tlog")
"""Name of the log of an agent, and of a file that it goes on in."""


def files_of(log: str) -> list[Path]:
    """Return the file of a log, and those that follow it if its name is that of a run's log."""
    path = Path(log)
    found = _NAME.fullmatch(path.name)
    return [path] if found is None else parts_of(path.with_name(f"{found[1]}.tlog"), int(found[3] or 1))


def settings_of(log: str) -> str | None:
    """Return the path of the configuration beside a log; None if its name does not tell the agent's id."""
    path = Path(log)
    found = _NAME.fullmatch(path.name)
    return None if found is None else str(path.with_name(f"companion-{found[2]}.yaml"))


class LogFiles(Iterator[tuple[float, bytes]]):
    """The records of a log in several files, one after the other."""

    def __init__(self, paths: list[Path]) -> None:
        """Open the first file; raises InputError if that is not possible."""
        self._paths = paths
        self._log = read_tlog(paths[0])
        self._records = self._read()
        self._read_before: list[tuple[Path, Tlog]] = []

    @property
    def whole(self) -> bool:
        """Whether nothing was left out so far."""
        return self._log.whole and all(log.whole for _, log in self._read_before)

    @property
    def begins_late(self) -> bool:
        """Whether the files before the first one are missing, by its name."""
        found = _NAME.fullmatch(self._paths[0].name)
        return found is not None and found[3] is not None

    def tell(self) -> None:
        """Warn of each file of which something was left out; call it once all are read."""
        for path, log in self._read_before:
            if not log.whole:
                program_logger("companion").warning("%s: %s", path, log.words)

    def __next__(self) -> tuple[float, bytes]:
        return next(self._records)

    def _read(self) -> Iterator[tuple[float, bytes]]:
        for number, path in enumerate(self._paths):
            if number > 0:
                self._log = read_tlog(path)
            yield from self._log
            self._read_before.append((path, self._log))
