"""Exports a store piece by piece, whatever its size: events and places as CSV or JSON, frames as a .tlog."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any, NamedTuple

from companion.errors import InputError, printable
from groundstation.store.database import Database
from groundstation.store.rows import EventRow

EVENT_COLUMNS = ("number", "time", "unix_s", "who", "role", "event", "details")
PLACE_COLUMNS = ("unix_s", "kind", "id", "north_m", "east_m", "heading_deg", "speed_m_s", "age_s")
_HEAD = ("number", "unix_s", "who", "event")
"""Keys of an event that have columns of their own."""


class Slice(NamedTuple):
    """The time that is exported, Unix seconds."""

    from_s: float = 0.0
    to_s: float = 1e12

    def holds(self, at_s: float) -> bool:
        """Return whether a time is in it."""
        return self.from_s <= at_s <= self.to_s


def export(database: Database, path: Path, time: Slice, places: bool = False) -> int:
    """Write an export in the form that the name's ending says; return the number of rows, frames or messages.

    `places` asks for where everything was instead of the events, in .csv and .json.

    Raises:
        InputError: the ending is none of FORMS, or `places` does not fit it.
        OSError: a file cannot be read or written.

    """
    form = FORMS.get(path.suffix)
    if form is None:
        raise InputError(f"--out: '{path}'; allowed: a name that ends in {', '.join(FORMS)}")
    if places and path.suffix not in (".csv", ".json"):
        raise InputError(f"--places: with --out {path}; allowed: with .csv and .json, {path.suffix} has them anyway")
    part = path.with_name(f".{path.name}.part")
    try:
        count = form(database, part, time, places)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return count


def _csv(database: Database, path: Path, time: Slice, places: bool) -> int:
    count = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(PLACE_COLUMNS if places else EVENT_COLUMNS)
        rows = place_rows(database, time) if places else map(_event_cells, events_in(database, time))
        for row in rows:
            writer.writerow(row)
            count += 1
    return count


def _json(database: Database, path: Path, time: Slice, places: bool) -> int:
    with path.open("w", encoding="utf-8") as file:
        if places:
            return _array(
                file, "places", (dict(zip(PLACE_COLUMNS, row, strict=True)) for row in place_rows(database, time))
            )
        return _array(file, "events", (json.loads(row.body) for row in events_in(database, time)))


def _array(file: IO[str], name: str, values: Iterator[Mapping[str, Any]]) -> int:
    """Write an object with one list, a line for each entry, as it comes."""
    count = 0
    file.write(f'{{"{name}": [')
    for value in values:
        file.write(("," if count else "") + "\n" + json.dumps(value, allow_nan=False))
        count += 1
    file.write("\n]}\n")
    return count


def _tlog(database: Database, path: Path, time: Slice, _places: bool) -> int:
    from groundstation.store.recordings import records_in

    count = 0
    with path.open("wb") as file:
        for recorded in database.recorded("frames", time.from_s, time.to_s):
            file.write(recorded.body)
            count += sum(1 for _ in records_in(recorded.body))
    return count


def _mcap(database: Database, path: Path, time: Slice, _places: bool) -> int:
    from groundstation.store.mcap_export import write_mcap

    return write_mcap(database, path, time)


FORMS: dict[str, Callable[[Database, Path, Slice, bool], int]] = {
    ".csv": _csv,
    ".json": _json,
    ".tlog": _tlog,
    ".mcap": _mcap,
}
"""Forms of an export by the ending of its name."""


def events_in(database: Database, time: Slice) -> Iterator[EventRow]:
    """Yield the events of a time, one by one."""
    return (row for row in database.events() if time.holds(row.unix_s))


def place_rows(database: Database, time: Slice) -> Iterator[Sequence[object]]:
    """Yield where everything was in each picture of a time, in the columns of PLACE_COLUMNS."""
    for recorded in database.recorded("picture", time.from_s, time.to_s):
        picture = json.loads(recorded.body)
        for kind in ("agent", "target", "threat"):
            for one in picture[f"{kind}s"]:
                heading_deg, speed_m_s = one.get("heading_deg"), one.get("speed_m_s")
                yield (
                    round(recorded.unix_s, 3), kind, one["id"], one["north_m"], one["east_m"], heading_deg, speed_m_s,
                    one["age_s"],
                )  # fmt: skip


def details_of(row: EventRow) -> dict[str, Any]:
    """Return what an event says beside its number, time, kind and who; nothing that is left out."""
    values = json.loads(row.body)
    return {key: value for key, value in values.items() if key not in _HEAD and value is not None}


def iso_time(unix_s: float) -> str:
    """Return a time in UTC to the millisecond, such as 2026-11-30T08:15:00.250Z."""
    return datetime.fromtimestamp(unix_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def event_line(row: EventRow) -> str:
    """Return an event as a line for people."""
    details = ", ".join(f"{key} {_word(value)}" for key, value in details_of(row).items())
    line = f"{row.number:6d} {iso_time(row.unix_s)} {row.who}: {row.event}{': ' if details else ''}{details}"
    return printable(line)


def _event_cells(row: EventRow) -> Sequence[object]:
    who = json.loads(row.body).get("who") or {}
    role = who.get("role", "") if isinstance(who, Mapping) else ""
    details = json.dumps(details_of(row), allow_nan=False)
    return row.number, iso_time(row.unix_s), row.unix_s, row.who, role, row.event, details


def _word(value: object) -> str:
    return json.dumps(value, allow_nan=False) if isinstance(value, Mapping | list) else str(value)
