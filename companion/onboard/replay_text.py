"""What `companion replay` prints: the decisions made again, those that differ, and what was left out of the log."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from companion.errors import InputError
from companion.files.tlog import Tlog, read_tlog
from companion.onboard.config import Config
from companion.onboard.flight_log import summary_line
from companion.onboard.replay import replay
from companion.runtime.console import program_logger


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
    def troubles(self) -> list[str]:
        """A line for each file of which something was left out, once all are read."""
        return [f"{path}: {log.words}" for path, log in self._read_before if not log.whole]

    def __next__(self) -> tuple[float, bytes]:
        return next(self._records)

    def _read(self) -> Iterator[tuple[float, bytes]]:
        for number, path in enumerate(self._paths):
            if number > 0:
                self._log = read_tlog(path)
            yield from self._log
            self._read_before.append((path, self._log))


def replayed_lines(log: str, parts: list[Path], config: Config, say: Callable[[str], None]) -> int:
    """Replay a log and say each decision that differs or whose words are new; return the number of those that differ.

    `parts`: the files that the log consists of. Decisions behind a gap in it do not count as different.

    Raises:
        InputError: the log cannot be read, or there are no decisions in it.

    """
    records = LogFiles(parts)
    said, decisions, different = "", 0, 0
    behind, different_behind = 0, 0
    for replayed in replay(records, config, lambda: not records.whole):
        decision = replayed.decision
        decisions += 1
        behind += replayed.behind_gap
        different += not replayed.same and not replayed.behind_gap
        different_behind += not replayed.same and replayed.behind_gap
        line = summary_line(decision)
        if line != said or not replayed.same:
            gap = ", behind a gap" if replayed.behind_gap else ""
            say(f"{decision.t_s:.3f} {line}{'' if replayed.same else f'  <- differs from the flight{gap}'}")
        said = line
    for trouble in records.troubles:
        program_logger("companion").warning("%s", trouble)
    if decisions == 0:
        raise InputError(f"{log}: no decisions in it; allowed: vehicle-N.tlog of `companion run` or `sim fly --out`")
    tail = f"; {behind} of them behind a gap in the log, where {different_behind or 'none'} differ" if behind else ""
    say(f"{decisions} decisions, {different or 'none'} different from those in flight{tail}")
    return different
