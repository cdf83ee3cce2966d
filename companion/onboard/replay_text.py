"""What `companion replay` prints: the decisions made again, those that differ, and what was left out of the log."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from companion.errors import InputError
from companion.onboard.config import Config
from companion.onboard.flight_log import summary_line
from companion.onboard.log_files import LogFiles
from companion.onboard.replay import replay


def replayed_lines(log: str, parts: list[Path], config: Config, say: Callable[[str], None]) -> int:
    """Replay a log and say each decision that differs or whose words are new; return the number of those that differ.

    `parts`: the files that the log consists of. Decisions behind a gap in it do not count as different.

    Raises:
        InputError: the log cannot be read, or there are no decisions in it.

    """
    records = LogFiles(parts)
    said, decisions, different = "", 0, 0
    behind, different_behind = 0, 0
    for replayed in replay(records, config, lambda: not records.whole or records.begins_late):
        decision = replayed.decision
        if replayed.begins:
            say(f"{decision.t_s:.3f} another flight begins in the log: all from here on counts as behind a gap")
        decisions += 1
        behind += replayed.behind_gap
        different += not replayed.same and not replayed.behind_gap
        different_behind += not replayed.same and replayed.behind_gap
        line = summary_line(decision)
        if line != said or not replayed.same:
            gap = ", behind a gap" if replayed.behind_gap else ""
            say(f"{decision.t_s:.3f} {line}{'' if replayed.same else f'  <- differs from the flight{gap}'}")
        said = line
    records.tell()
    if decisions == 0:
        raise InputError(f"{log}: no decisions in it; allowed: vehicle-N.tlog of `companion run` or `sim fly --out`")
    if behind == 0:
        say(f"{decisions} decisions, {different or 'none'} different from those in flight")
        return different
    before = f", {different or 'none'} different from those in flight" if behind < decisions else ""
    say(
        f"{decisions} decisions: {decisions - behind or 'none'} before any gap in the log{before}; {behind} behind "
        f"one, {different_behind or 'none'} different, which does not count: inputs of theirs are missing"
    )
    return different
