"""The density of the air by which a plane's indicated airspeeds are true ones, the same throughout an engagement."""

from __future__ import annotations

import math

from companion.geo.air_density import true_per_indicated

ALTITUDE_STEP_M = 100.0
"""Change of altitude up to which the limits of the speed stay as they are: half a percent of the airspeed."""
REACH_M = 500.0
"""Greatest change of altitude in an engagement that changes the speed: a told one beyond it is no climb."""


class AirDensity:
    """True airspeed per indicated airspeed where the plane is.

    Guard and guidance keep the limits with which an engagement began, so that the ratio of these does not change in it.
    """

    def __init__(self) -> None:
        self.ratio = 1.0
        """True airspeed per indicated airspeed, for the limits of the speed; 1 before an altitude is known."""
        self._altitude_m = math.nan
        self._engaged = False

    def note(self, altitude_m: float) -> None:
        """Note the altitude above sea level; NaN: not known."""
        if self._engaged or math.isnan(altitude_m) or abs(altitude_m - self._altitude_m) <= ALTITUDE_STEP_M:
            return
        self._altitude_m = altitude_m
        self.ratio = true_per_indicated(altitude_m)

    def ratio_at(self, altitude_m: float) -> float:
        """Return true airspeed per indicated airspeed at an altitude above sea level, near the one noted last."""
        if math.isnan(self._altitude_m):
            return true_per_indicated(altitude_m)
        return true_per_indicated(min(max(altitude_m, self._altitude_m - REACH_M), self._altitude_m + REACH_M))

    def engage(self) -> None:
        """Keep the ratio from now on: the plane is steered."""
        self._engaged = True

    def release(self) -> None:
        """Follow the altitude again: the plane is no longer steered."""
        self._engaged = False
