"""What every source's parser makes of its bytes: sightings of things, each with the source's own key for it.

A parser takes bytes as they come, cut anywhere, and counts what it cannot use by its reason. Only a fault of a library
may raise, which the feed counts (feed.py). Times are Unix seconds given by the caller; of a sighting they are when the
thing was there, as far as the source tells.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable
from enum import Enum
from typing import NamedTuple, Protocol

from companion.mission.places import MOST_DEG

KNOT_M_S = 1_852.0 / 3_600.0
"""Speed of one knot (exact)."""
FOOT_M = 0.3048
"""Length of one foot (exact)."""
FAST_M_S = 2_000.0
"""Speed above which a velocity is no vehicle's and is left out."""
HIGHEST_M = 100_000.0
"""Height above which an altitude is no vehicle's and is left out."""
MOST_REASONS = 32
"""Greatest number of reasons that a parser counts by themselves."""

NO_PLACE = "not a place on the Earth"
NOT_WHOLE = "not readable"


class Category(Enum):
    """What a thing is, as far as its source tells."""

    AIRCRAFT = "aircraft"
    SHIP = "ship"
    VEHICLE = "vehicle"


class Datum(Enum):
    """What an altitude counts from, and by how many metres at most it differs from that above mean sea level."""

    MEAN_SEA_LEVEL = 10.0
    ELLIPSOID = 110.0
    """WGS84's: the geoid is 107 m below it to 86 m above it (EGM96)."""
    PRESSURE = 400.0
    """The standard atmosphere's: 1 hPa off 1013.25 is 8 m, and weather is within 50 hPa."""


class Sighting(NamedTuple):
    """Where and when a source saw something."""

    key: str
    lat_deg: float
    lon_deg: float
    at_s: float
    velocity: complex | None = None
    """Velocity over ground, true north + i east, in m/s; None if it is not told."""
    altitude_m: float | None = None
    datum: Datum = Datum.MEAN_SEA_LEVEL
    category: Category | None = None
    error_m: float | None = None
    """Greatest error of the place, as its source tells."""
    name: str = ""
    until_s: float | None = None
    """Time until which the source lets it count without another word."""


class Parser(Protocol):
    """Makes sightings of a source's bytes."""

    refused: Counter[str]
    """Number of messages that could not be used, by reason."""

    def feed(self, data: bytes, now_s: float, peer: Hashable = None) -> list[Sighting]:
        """Return the sightings that bytes of one sender complete."""


def is_place(lat_deg: float, lon_deg: float) -> bool:
    """Return whether latitude and longitude are numbers and those of a place on the Earth."""
    return abs(lat_deg) <= MOST_DEG[0] and abs(lon_deg) <= MOST_DEG[1]


def velocity_of(speed_m_s: float | None, course_deg: float | None) -> complex | None:
    """Return a velocity, true north + i east in m/s; None if a part is missing or is no vehicle's."""
    if speed_m_s is None or not 0.0 <= speed_m_s <= FAST_M_S:
        return None
    if course_deg is None:
        # What stands has no course.
        return 0j if speed_m_s == 0.0 else None
    if not -360.0 <= course_deg <= 360.0:
        return None
    course_rad = math.radians(course_deg)
    return speed_m_s * complex(math.cos(course_rad), math.sin(course_rad))


def altitude_of(altitude_m: float | None) -> float | None:
    """Return an altitude, or None if it is missing or no vehicle's."""
    return altitude_m if altitude_m is not None and abs(altitude_m) <= HIGHEST_M else None


def number_from(text: str) -> float | None:
    """Return the finite number in a text, or None."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def short(text: str, most: int = 40) -> str:
    """Return a text from outside as printable ASCII of at most `most` characters, for names and keys."""
    return "".join(one for one in text.strip() if one.isascii() and one.isprintable())[:most].strip()


def count(refused: Counter[str], reason: str) -> None:
    """Count a refusal; of reasons from outside there may be many, so that further ones count together."""
    refused[reason if reason in refused or len(refused) < MOST_REASONS else "other"] += 1
