"""AIS sentences (NMEA 0183: !AIVDM), decoded by pyais: ships, and search-and-rescue aircraft, by their MMSI.

Position reports come in one sentence each, so that sentences of several parts, which carry names and voyages, are left
out. A report tells only the second of the minute at which its position was true; the minute is the one of arrival.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable
from typing import Any, NamedTuple

from groundstation.sources.lines import Lines
from groundstation.sources.sighting import (
    KNOT_M_S,
    NO_PLACE,
    NOT_WHOLE,
    Category,
    Sighting,
    altitude_of,
    count,
    is_place,
    velocity_of,
)

MOST_LINE_BYTES = 1_024
"""Greatest length of a line: a sentence has 82 characters, and tag blocks before it as many more."""
FROM_FUTURE_S = 5.0
"""Time by which a report's second may be ahead of this computer's clock before it counts as of the minute before."""
ACCURATE_M, COARSE_M = 10.0, 100.0
"""Greatest error with the position accuracy flag set, and assumed without it (ITU-R M.1371: over 10 m)."""
LONG_RANGE_M = 200.0
"""The same of a long-range report, whose positions are in tenths of a minute of arc: half of one is 93 m."""
_NO_SPEED_KT, _NO_COURSE_DEG = 102.3, 360.0
_LONG_RANGE_NO_SPEED_KT, _LONG_RANGE_NO_COURSE_DEG = 63.0, 511.0
_AIRCRAFT_NO_SPEED_KT, _AIRCRAFT_NO_ALTITUDE_M = 1_023.0, 4_095.0
_AIRCRAFT, _LONG_RANGE = 9, 27
_REPORTS = {1: 24, 2: 24, 3: 24, _AIRCRAFT: 23, 18: 24, 19: 24, _LONG_RANGE: 16}
"""Types of message that tell where a ship or aircraft is, with the number of characters of 6 bits that hold what is
read of it (ITU-R M.1371). Base stations and buoys stand, and are in charts."""
_PAYLOAD = 5
"""Number of the sentence's field with the message."""


class _Sentence(NamedTuple):
    """One sentence, and the Unix time in the tag block before it, if there is one."""

    data: bytes
    tagged_s: float | None


class AisParser:
    """Makes sightings of ships from AIS sentences."""

    def __init__(self) -> None:
        self.refused: Counter[str] = Counter()
        self._lines = Lines(MOST_LINE_BYTES, self.refused)

    def feed(self, data: bytes, now_s: float, peer: Hashable = None) -> list[Sighting]:
        """Return the sightings in the lines that bytes of one sender complete."""
        found = (self._sighting(line, now_s) for line in self._lines.feed(data, peer))
        return [one for one in found if one is not None]

    def _sighting(self, line: bytes, now_s: float) -> Sighting | None:
        from pyais import decode
        from pyais.exceptions import AISBaseException

        sentence = _sentence(line)
        if sentence is None:
            count(self.refused, NOT_WHOLE)
            return None
        parts = sentence.data.split(b",")
        if len(parts) <= _PAYLOAD:
            count(self.refused, NOT_WHOLE)
            return None
        if parts[1] != b"1":
            return None
        try:
            report: Any = decode(sentence.data, error_if_checksum_invalid=True)
        except (AISBaseException, ValueError, LookupError, TypeError, ArithmeticError):
            # What pyais raises for bits that make no message, found by feeding it with damaged sentences.
            count(self.refused, NOT_WHOLE)
            return None
        length = _REPORTS.get(report.msg_type)
        if length is None:
            return None
        if len(parts[_PAYLOAD]) < length:
            # pyais reads what is there of a message that was cut off, and makes up numbers of half their bits.
            count(self.refused, NOT_WHOLE)
            return None
        lat_deg, lon_deg = report.lat, report.lon
        if lat_deg is None or lon_deg is None or not is_place(lat_deg, lon_deg):
            # 91 and 181 degrees mean that the ship does not know where it is.
            count(self.refused, NO_PLACE)
            return None
        return _report_sighting(report, now_s)


def _report_sighting(report: Any, now_s: float) -> Sighting:  # noqa: ANN401 - pyais' messages have no common type
    is_aircraft, is_long_range = report.msg_type == _AIRCRAFT, report.msg_type == _LONG_RANGE
    no_speed_kt, no_course_deg = _NO_SPEED_KT, _NO_COURSE_DEG
    if is_aircraft:
        no_speed_kt = _AIRCRAFT_NO_SPEED_KT
    elif is_long_range:
        no_speed_kt, no_course_deg = _LONG_RANGE_NO_SPEED_KT, _LONG_RANGE_NO_COURSE_DEG
    speed_m_s = None if report.speed is None or report.speed >= no_speed_kt else report.speed * KNOT_M_S
    course_deg = None if report.course is None or report.course >= no_course_deg else report.course
    altitude_m = float(report.alt) if is_aircraft and report.alt < _AIRCRAFT_NO_ALTITUDE_M else None
    error_m = LONG_RANGE_M if is_long_range else ACCURATE_M if report.accuracy else COARSE_M
    return Sighting(
        key=f"{report.mmsi:09d}" if isinstance(report.mmsi, int) else str(report.mmsi),
        lat_deg=report.lat,
        lon_deg=report.lon,
        at_s=now_s if is_long_range else _time_of(report.second, now_s),
        velocity=velocity_of(speed_m_s, course_deg),
        altitude_m=altitude_of(altitude_m),
        category=Category.AIRCRAFT if is_aircraft else Category.SHIP,
        error_m=error_m,
    )


def _time_of(second: int, now_s: float) -> float:
    """Return the last time at which the minute had a second; `now_s` if the report does not know it (60 and above)."""
    if not 0 <= second < 60:
        return now_s
    ago_s = (now_s - second) % 60.0
    return now_s - (0.0 if ago_s > 60.0 - FROM_FUTURE_S else ago_s)


def time_in(line: bytes) -> float | None:
    """Return the Unix time in the tag block of a line; None if there is none."""
    sentence = _sentence(line)
    return None if sentence is None else sentence.tagged_s


def _sentence(line: bytes) -> _Sentence | None:
    """Return the sentence of a line without the tag block before it; None if there is none."""
    tagged_s = None
    if line.startswith(b"\\"):
        block, _, line = line[1:].partition(b"\\")
        for part in block.split(b"*")[0].split(b","):
            if part.startswith(b"c:") and part[2:].isdigit() and len(part) <= 15:
                seconds = int(part[2:])
                # Some write milliseconds.
                tagged_s = seconds / 1_000.0 if seconds > 1e11 else float(seconds)
    return _Sentence(line, tagged_s) if line.startswith(b"!") else None
