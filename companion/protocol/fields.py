"""Conversion of numbers to message fields and back: a value that does not fit raises WireError, never wraps."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from companion.geo.degrees import is_on_earth
from companion.protocol.messages import WireError

INT16_MIN, INT16_MAX = -32_768, 32_767
UINT8_MAX = 255
UINT16_MAX = 65_535
UINT32_MAX = 4_294_967_295
UINT64_MAX = 2**64 - 1
INT32_MAX = 2_147_483_647
FINE_BOUND_M_S = 230
"""Greatest speed bound that is told to 1 m/s: an aircraft may be faster than 255 m/s, and all has 8 bits."""
BOUND_STEP_M_S = 25
"""Step of the speed bounds above that: 255 m/s is one of them, and the greatest is 855 m/s."""
NO_FLOOR, NO_CEILING = INT16_MIN, INT16_MAX
"""Field values in m that mean no floor and no ceiling."""
_WHOLE = 1.0e-12
"""Relative tolerance within which a quotient counts as a whole number, so that rounding error does not round it up."""


@dataclass(frozen=True)
class Band:
    """Altitude limits of a threat, above sea level; None: no limit on that side."""

    floor_m: float | None
    ceiling_m: float | None


def whole(value: int, greatest: int, what: str) -> int:
    """Return a value that fits an unsigned field; `what` names the field in the error.

    Raises:
        WireError: the value is negative or greater than `greatest`.

    """
    if not 0 <= value <= greatest:
        raise WireError(f"{what} {value} does not fit its field; allowed: 0 to {greatest}")
    return value


def rounded(value: float) -> int:
    """Return the nearest whole number.

    Raises:
        WireError: the value is not finite.

    """
    if not math.isfinite(value):
        raise WireError(f"{value} does not fit any field; allowed: a finite number")
    return round(value)


def ceiling(value: float, greatest: int, what: str) -> int:
    """Return the least whole number that is not less than a value, for an unsigned field.

    Raises:
        WireError: the value is not finite, negative or greater than `greatest`.

    """
    rounded(value)
    return whole(math.ceil(value), greatest, what)


def ceiling_units(value: float, unit: float, greatest: int, what: str) -> int:
    """Return the least number of units whose sum is not less than a value, for an unsigned field.

    Raises:
        WireError: the value is not finite, negative or too great for the field.

    """
    units = value / unit
    nearest = rounded(units)
    return (
        whole(nearest, greatest, what)
        if math.isclose(units, nearest, rel_tol=_WHOLE)
        else ceiling(units, greatest, what)
    )


def bound_code(bound_m_s: float) -> int:
    """Return the least code that means at least a speed bound.

    Raises:
        WireError: the bound is not finite, negative or too great for the field.

    """
    rounded(bound_m_s)
    if bound_m_s <= FINE_BOUND_M_S:
        return ceiling(bound_m_s, UINT8_MAX, "speed bound")
    return ceiling(FINE_BOUND_M_S + (bound_m_s - FINE_BOUND_M_S) / BOUND_STEP_M_S, UINT8_MAX, "code of a speed bound")


def bound_of(code: int) -> float:
    """Return the speed bound in m/s that a code means."""
    return float(code + max(0, code - FINE_BOUND_M_S) * (BOUND_STEP_M_S - 1))


def on_earth_e7(lat_deg: float, lon_deg: float) -> tuple[int, int]:
    """Return latitude and longitude in 1e-7 degrees.

    Raises:
        WireError: the latitude or longitude is out of range or not finite.

    """
    lat_e7, lon_e7 = rounded(lat_deg * 1e7), rounded(lon_deg * 1e7)
    if not is_on_earth(lat_e7, lon_e7):
        raise WireError(f"{lat_deg}, {lon_deg} is not on Earth")
    return lat_e7, lon_e7


def degrees_of(lat_e7: int, lon_e7: int, what: str) -> tuple[float, float]:
    """Return latitude and longitude in degrees.

    Raises:
        WireError: the latitude or longitude is out of range; the text is "`what` out of range".

    """
    if not is_on_earth(lat_e7, lon_e7):
        raise WireError(f"{what} out of range")
    return lat_e7 / 1e7, lon_e7 / 1e7


def band_limits(floor_m: float | None, ceiling_m: float | None, threat_id: int) -> tuple[int, int]:
    """Return the field values of floor and ceiling in whole metres, rounded outwards.

    Raises:
        WireError: a height does not fit, or the floor is not below the ceiling.

    """
    if floor_m is not None and ceiling_m is not None and floor_m >= ceiling_m:
        raise WireError(f"threat {threat_id} has its floor at or above its ceiling")
    floor = NO_FLOOR if floor_m is None else _height_m(floor_m, math.floor)
    return floor, NO_CEILING if ceiling_m is None else _height_m(ceiling_m, math.ceil)


def band_of(floor: int, ceiling: int) -> Band:
    """Return the altitude limits that the field values of floor and ceiling mean.

    Raises:
        WireError: the floor is not below the ceiling.

    """
    if floor >= ceiling:
        raise WireError("band out of range")
    return Band(None if floor == NO_FLOOR else float(floor), None if ceiling == NO_CEILING else float(ceiling))


def _height_m(height_m: float, rounding: Callable[[float], int]) -> int:
    if not INT16_MIN + 1 <= height_m <= INT16_MAX - 1:
        raise WireError(f"a height of {height_m} m does not fit a frame")
    return rounding(height_m)
