"""Indicated against true airspeed: the thinner the air, the faster a vehicle flies at the same indicated airspeed.

By the standard atmosphere up to 11 km, as ArduPilot's EAS2TAS and PX4's conversion of calibrated airspeed have it.
Temperature and weather are not known: a day 20 degrees warmer than standard is 3.5 % more true airspeed.
"""

from __future__ import annotations

import math

ALTITUDE_MIN_M, ALTITUDE_MAX_M = -1_000.0, 11_000.0
"""Altitudes above sea level between which the formula holds; beyond them it is that of the nearer one."""
_LAPSE_SHARE_1_M = 0.0065 / 288.15
"""Decrease of the temperature with height, as a share of that at sea level, 288.15 K (ISA)."""
_DENSITY_EXPONENT = 9.80665 / (287.053 * 0.0065) - 1.0
"""Exponent of the temperature's share with which the density falls (ISA): g / (R L) - 1."""


def true_per_indicated(altitude_m: float) -> float:
    """Return the true airspeed per indicated airspeed, sqrt(rho_0 / rho), at an altitude above sea level.

    It is 1 at sea level and where the altitude is not known (NaN).
    """
    if math.isnan(altitude_m):
        return 1.0
    altitude_m = min(max(altitude_m, ALTITUDE_MIN_M), ALTITUDE_MAX_M)
    return float((1.0 - _LAPSE_SHARE_1_M * altitude_m) ** (-0.5 * _DENSITY_EXPONENT))
