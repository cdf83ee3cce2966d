"""BaseStation's text (SBS-1), which dump1090, readsb and others serve on TCP port 30003: aircraft by their ADS-B.

A line of the type MSG has 22 fields, of which most are empty; positions, velocities and names come in lines of their
own, so that the newest velocity of an aircraft is kept for its next position. Its times are by the clock and in the
time zone of the receiver's computer, so that they only order a recording: what comes over a link is as old as it says
nothing of, less than a second where the receiver serves it itself.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Hashable, Sequence
from datetime import UTC, datetime
from typing import NamedTuple

from groundstation.sources.lines import Lines
from groundstation.sources.sighting import (
    FOOT_M,
    KNOT_M_S,
    NO_PLACE,
    NOT_WHOLE,
    Category,
    Datum,
    Sighting,
    altitude_of,
    count,
    is_place,
    number_from,
    short,
    velocity_of,
)

MOST_LINE_BYTES = 512
"""Greatest length of a line; those of dump1090 have 120 bytes at most."""
MOST_REMEMBERED = 4_096
"""Greatest number of aircraft whose velocity and name are kept: many times what one receiver hears."""
VELOCITY_S = 10.0
"""Time for which a velocity goes with later positions of the aircraft; they come twice a second."""
ON_GROUND = "on the ground"
_FIELDS = 22
_HEX = frozenset("0123456789ABCDEF")


class _Fields(NamedTuple):
    """The fields of a line that are read."""

    address: str
    callsign: str
    altitude_ft: float | None
    speed_kt: float | None
    track_deg: float | None
    lat_deg: float | None
    lon_deg: float | None
    is_on_ground: bool


class _Last(NamedTuple):
    """What the newest lines said of an aircraft beside its position."""

    velocity: complex | None = None
    velocity_at_s: float = 0.0
    name: str = ""
    altitude_ft: float | None = None


class BaseStationParser:
    """Makes sightings of aircraft from BaseStation's text."""

    def __init__(self, takes_grounded: bool = False) -> None:
        """Leave out aircraft on the ground unless `takes_grounded`, as of one's own."""
        self._takes_grounded = takes_grounded
        self.refused: Counter[str] = Counter()
        self._lines = Lines(MOST_LINE_BYTES, self.refused)
        self._last: OrderedDict[str, _Last] = OrderedDict()

    def feed(self, data: bytes, now_s: float, peer: Hashable = None) -> list[Sighting]:
        """Return the sightings in the lines that bytes of one sender complete."""
        found = (self._sighting(line, now_s) for line in self._lines.feed(data, peer))
        return [one for one in found if one is not None]

    def _sighting(self, line: bytes, at_s: float) -> Sighting | None:
        parts = line.decode("ascii", "replace").split(",")
        if parts[0] != "MSG":
            # SEL, ID, AIR, STA and CLK are of BaseStation's own screen.
            if parts[0] not in ("SEL", "ID", "AIR", "STA", "CLK"):
                count(self.refused, NOT_WHOLE)
            return None
        fields = _fields(parts)
        if fields is None:
            count(self.refused, NOT_WHOLE)
            return None
        last = self._remembered(fields, at_s)
        if fields.lat_deg is None or fields.lon_deg is None:
            return None
        if not is_place(fields.lat_deg, fields.lon_deg):
            count(self.refused, NO_PLACE)
            return None
        if fields.is_on_ground and not self._takes_grounded:
            count(self.refused, ON_GROUND)
            return None
        return Sighting(
            key=fields.address,
            lat_deg=fields.lat_deg,
            lon_deg=fields.lon_deg,
            at_s=at_s,
            velocity=last.velocity if at_s - last.velocity_at_s <= VELOCITY_S else None,
            altitude_m=None if last.altitude_ft is None else altitude_of(last.altitude_ft * FOOT_M),
            datum=Datum.PRESSURE,
            category=Category.AIRCRAFT,
            name=last.name,
        )

    def _remembered(self, fields: _Fields, at_s: float) -> _Last:
        """Return what is known of an aircraft beside its position, with what a line says of it."""
        last = self._last.pop(fields.address, _Last())
        speed_m_s = None if fields.speed_kt is None else fields.speed_kt * KNOT_M_S
        velocity = velocity_of(speed_m_s, fields.track_deg)
        if velocity is not None:
            last = last._replace(velocity=velocity, velocity_at_s=at_s)
        if fields.callsign:
            last = last._replace(name=fields.callsign)
        if fields.altitude_ft is not None:
            last = last._replace(altitude_ft=fields.altitude_ft)
        self._last[fields.address] = last
        if len(self._last) > MOST_REMEMBERED:
            self._last.popitem(last=False)
        return last


def time_in(line: bytes) -> float | None:
    """Return the seconds since 1970 that a line's time of generation would be in UTC; None if it has none."""
    parts = line.decode("ascii", "replace").split(",")
    if parts[0] != "MSG" or len(parts) < _FIELDS:
        return None
    try:
        read = datetime.strptime(f"{parts[6].strip()} {parts[7].strip()}", "%Y/%m/%d %H:%M:%S.%f")
    except ValueError:
        return None
    return read.replace(tzinfo=UTC).timestamp()


def _fields(parts: Sequence[str]) -> _Fields | None:
    """Return the fields of a line; None if it is none that BaseStation makes."""
    if len(parts) < _FIELDS or parts[1] not in tuple("12345678"):
        return None
    address = parts[4].strip().upper()
    if not 1 <= len(address) <= 6 or not _HEX.issuperset(address):
        return None
    altitude_ft, speed_kt, track_deg, lat_deg, lon_deg = (number_from(parts[k]) for k in (11, 12, 13, 14, 15))
    is_on_ground = parts[21].strip() in ("-1", "1")
    return _Fields(
        address.rjust(6, "0"), short(parts[10], 8), altitude_ft, speed_kt, track_deg, lat_deg, lon_deg, is_on_ground
    )
