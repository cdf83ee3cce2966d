"""What `groundstation log` does: prints, exports or plays what a store holds."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

from companion.errors import InputError, tell
from companion.files.yaml import is_there
from groundstation.store.database import Database
from groundstation.store.export import Slice, event_line, events_in, export, iso_time
from groundstation.store.recordings import StoredRun

LATEST_S = 253_402_300_799.0
"""Greatest Unix time that can be written as a date: the last second of the year 9999."""


def time_of(text: str | None, option: str, otherwise: float) -> float:
    """Return the Unix time that a text names: seconds, or ISO 8601 (UTC unless it says otherwise).

    Raises:
        InputError: it names none.

    """
    if text is None:
        return otherwise
    try:
        at_s = _unix_s(text)
    except ValueError:
        at_s = math.nan
    if not 0.0 <= at_s <= LATEST_S:
        raise InputError(f"{option}: '{text}'; allowed: Unix seconds, or a time such as 2026-11-30T08:15:00Z")
    return at_s


def _unix_s(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        at = datetime.fromisoformat(text)
        return (at if at.tzinfo is not None else at.replace(tzinfo=UTC)).timestamp()


def log_store(path: Path, time: Slice, out: Path | None, places: bool) -> None:
    """Print the events of a time, or write the export that was asked for; raises InputError."""
    if time.from_s > time.to_s:
        raise InputError(f"--from: {iso_time(time.from_s)}, later than --to {iso_time(time.to_s)}; allowed: not later")
    if out is not None and is_there(out):
        raise InputError(f"--out: {out} is there already; allowed: the name of a new file")
    database = Database.read_only(path)
    try:
        if out is not None:
            tell(f"written to {out}: {export(database, out, time, places)}")
            return
        for row in events_in(database, time):
            tell(event_line(row))
    finally:
        database.close()


def play_store(path: Path, address: str) -> None:
    """Play a store on the page until interrupted; raises InputError."""
    from groundstation.store.playback_page import serve_playback

    run = StoredRun(path)
    try:
        serve_playback(run, address, "groundstation")
    finally:
        run.close()
