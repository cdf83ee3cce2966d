"""Recordings of sightings as CSV with a header, or one JSON object a line.

Columns or keys: `t_s` (seconds, of the recording or since 1970), `id`, a place as `lat_deg`, `lon_deg` or as `north_m`,
`east_m` on the mission's plane, and if known `heading_deg` with `speed_m_s` or `velocity_north_m_s` with
`velocity_east_m_s`, `altitude_m`, `name`, and `kind`. Others are not read, so that the trajectory.csv of a simulated
flight is a recording too.
"""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Hashable, Mapping

from companion.errors import one_line
from companion.geo.local_frame import LocalFrame, to_grid
from companion.mission.extent import FARTHEST_M
from companion.mission.sources import Role
from groundstation.sources.lines import Lines
from groundstation.sources.sighting import (
    FAST_M_S,
    NO_PLACE,
    NOT_WHOLE,
    Category,
    Sighting,
    altitude_of,
    count,
    is_place,
    number_from,
    short,
    velocity_of,
)

MOST_LINE_BYTES = 4_096
MOST_COLUMNS = 64
OTHER_KIND = "of another kind"
NO_TIME, NO_ID = "without t_s", "without id"
DELIMITERS = (",", ";", "\t")
"""What may stand between the columns of a CSV: in many languages a spreadsheet writes semicolons, and then decimal
commas."""
PLACES = (("lat_deg", "lon_deg"), ("north_m", "east_m"))
_WORDS = ("id", "kind", "name")
"""Columns that are no numbers."""
MOST_FOUND = 120
"""Greatest length of the columns found in a message."""
_CATEGORIES = {category.value: category for category in Category}


def header_of(line: bytes) -> tuple[list[str], str]:
    """Return the columns in the first line of a CSV, with or without a byte order mark, and what stands between them.

    Raises:
        ValueError: the line is no text in UTF-8.
        csv.Error: it is no CSV.

    """
    text = line.decode("utf-8-sig").strip()
    delimiter = max(DELIMITERS, key=text.count)
    (cells,) = csv.reader([text], delimiter=delimiter)
    return [cell.strip() for cell in cells[:MOST_COLUMNS]], delimiter


def header_fault(line: bytes) -> str | None:
    """Return what is missing in the first line of a CSV for any sighting to be read; None if nothing is."""
    try:
        columns, _ = header_of(line)
    except (csv.Error, ValueError):
        return "its first line is no text; allowed: CSV in UTF-8 with a header"
    missing = [column for column in ("t_s", "id") if column not in columns]
    if not any(set(place) <= set(columns) for place in PLACES):
        missing.append("lat_deg and lon_deg, or north_m and east_m")
    if not missing:
        return None
    found = ", ".join(short(column) for column in columns)
    return f"no column {'; '.join(missing)}; found: {one_line(found)[:MOST_FOUND]}; allowed: t_s, id and a place"


class RecordingParser:
    """Makes sightings of the lines of a recording; with a column `kind` only those of its own kind count."""

    def __init__(self, frame: LocalFrame, things: Role, is_json: bool) -> None:
        """Read CSV, or JSON if `is_json`; places in metres are on the plane of `frame`."""
        self.refused: Counter[str] = Counter()
        self._lines = Lines(MOST_LINE_BYTES, self.refused)
        self._frame = frame
        self._kind = things.removesuffix("s")
        self._is_json = is_json
        self._header: list[str] | None = None
        self._delimiter = ","

    def feed(self, data: bytes, now_s: float, peer: Hashable = None) -> list[Sighting]:
        """Return the sightings in the lines that bytes complete, at the recording's own times."""
        found = (self._sighting(line) for line in self._lines.feed(data, peer))
        return [one for one in found if one is not None]

    def _sighting(self, line: bytes) -> Sighting | None:
        row = self._json_row(line) if self._is_json else self._csv_row(line)
        if row is None:
            return None
        at_s, key = _number(row, "t_s"), short(row.get("id", ""), 80)
        if at_s is None or not key:
            count(self.refused, NO_TIME if at_s is None else NO_ID)
            return None
        kind = row.get("kind", "")
        if kind in ("agent", "target", "threat") and kind != self._kind:
            count(self.refused, OTHER_KIND)
            return None
        place = self._place(row)
        if place is None:
            count(self.refused, NO_PLACE)
            return None
        lat_deg, lon_deg, convergence_rad = place
        velocity = _velocity(row)
        if velocity is not None and "north_m" in row:
            # Told in the axes of the grid, from which true north is turned by the convergence.
            velocity = complex(*to_grid(velocity.real, velocity.imag, -convergence_rad))
        return Sighting(
            key=key,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            at_s=at_s,
            velocity=velocity,
            altitude_m=altitude_of(_number(row, "altitude_m")),
            category=_CATEGORIES.get(kind),
            name=short(row.get("name", "")),
        )

    def _csv_row(self, line: bytes) -> Mapping[str, str] | None:
        try:
            if self._header is None:
                self._header, self._delimiter = header_of(line)
                return None
            (cells,) = csv.reader([line.decode("utf-8")], delimiter=self._delimiter)
        except (csv.Error, ValueError):
            count(self.refused, NOT_WHOLE)
            return None
        row = dict(zip(self._header, cells, strict=False))
        if self._delimiter != ",":
            # Where commas separate no columns, they are decimal ones.
            row = {key: cell if key in _WORDS else cell.replace(",", ".") for key, cell in row.items()}
        return row

    def _json_row(self, line: bytes) -> Mapping[str, str] | None:
        try:
            row = json.loads(line)
        except (ValueError, RecursionError):
            row = None
        if not isinstance(row, dict):
            count(self.refused, NOT_WHOLE)
            return None
        return {key: str(value) for key, value in row.items() if isinstance(value, str | int | float)}

    def _place(self, row: Mapping[str, str]) -> tuple[float, float, float] | None:
        """Return latitude and longitude in degrees, and the convergence there (0 where the place is in degrees)."""
        lat_deg, lon_deg = _number(row, "lat_deg"), _number(row, "lon_deg")
        if lat_deg is not None and lon_deg is not None:
            return (lat_deg, lon_deg, 0.0) if is_place(lat_deg, lon_deg) else None
        north_m, east_m = _number(row, "north_m"), _number(row, "east_m")
        if north_m is None or east_m is None or max(abs(north_m), abs(east_m)) > FARTHEST_M:
            return None
        return self._frame.to_global_with_convergence(north_m, east_m)


def _velocity(row: Mapping[str, str]) -> complex | None:
    north_m_s, east_m_s = _number(row, "velocity_north_m_s"), _number(row, "velocity_east_m_s")
    if north_m_s is not None and east_m_s is not None:
        velocity = complex(north_m_s, east_m_s)
        return velocity if abs(velocity) <= FAST_M_S else None
    return velocity_of(_number(row, "speed_m_s"), _number(row, "heading_deg"))


def _number(row: Mapping[str, str], key: str) -> float | None:
    return number_from(row.get(key, ""))
