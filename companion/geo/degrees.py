"""Places in degrees: whether one is on the Earth, and how far two that are near each other are apart."""

from __future__ import annotations

import math

LAT_MAX_E7 = 900_000_000
"""Greatest latitude in units of 1e-7 degrees, as MAVLink has it."""
LON_MAX_E7 = 1_800_000_000
"""Greatest longitude in units of 1e-7 degrees."""
EARTH_RADIUS_M = 6_371_000.0
"""Mean radius of the Earth: between places near each other its flattening is half a percent."""


def is_on_earth(lat_e7: float, lon_e7: float) -> bool:
    """Return whether latitude and longitude, in units of 1e-7 degrees, are those of a place on the Earth."""
    return abs(lat_e7) <= LAT_MAX_E7 and abs(lon_e7) <= LON_MAX_E7


def metres_between(first_deg: tuple[float, float], second_deg: tuple[float, float]) -> tuple[float, float]:
    """Return how far a place is (north, east) of another one near it, in metres; both are latitude and longitude."""
    north_rad = math.radians(second_deg[0] - first_deg[0])
    east_rad = math.remainder(math.radians(second_deg[1] - first_deg[1]), math.tau)
    return EARTH_RADIUS_M * north_rad, EARTH_RADIUS_M * math.cos(math.radians(first_deg[0])) * east_rad
