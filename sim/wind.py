"""The wind in which the stand-ins fly: a constant mean and gusts that are drawn from the seed.

It is the same everywhere and at every height. `from_deg` is relative to the plane's north. The wind at a time depends
on the mission, the seed and that time alone, not on the steps of the flight.
"""

from __future__ import annotations

import math

from companion.mission.model import Wind
from companion.mission.random_streams import random_stream

WIND_STREAM = 4
"""Number of the seed's random stream for wind; each gust has its own stream within it."""
GUST_HOLD_S = 10.0
"""Time between two drawn gusts; the wind is linear in between, so it changes by at most twice `gust_m_s` in this time.
Chosen, not measured: long enough for a gust to affect guidance, too long for turbulence, which is not modelled."""


def crabbed(course_rad: float, airspeed_m_s: float, wind_m_s: tuple[float, float]) -> float:
    """Return the heading that holds a course over the ground in a wind (north, east), as far as the airspeed suffices.

    The airspeed's part across the course cancels the wind's. A head wind above the airspeed drives the vehicle
    backwards along the course, with its nose into the wind.
    """
    across_m_s = wind_m_s[1] * math.cos(course_rad) - wind_m_s[0] * math.sin(course_rad)
    return course_rad - math.asin(min(max(across_m_s / airspeed_m_s, -1.0), 1.0))


class WindField:
    """A mission's wind as a function of time, from time 0 on.

    Gusts are vectors drawn uniformly from a disc of radius `gust_m_s`; the values between two of them are in it too.
    """

    def __init__(self, wind: Wind, seed: int) -> None:
        from_rad = math.radians(wind.from_deg)
        self._mean_north_m_s = -wind.speed_m_s * math.cos(from_rad)
        self._mean_east_m_s = -wind.speed_m_s * math.sin(from_rad)
        self._gust_m_s = wind.gust_m_s
        self._seed = seed
        self._interval = 0
        self._gusts_m_s = self._gust(0), self._gust(1)

    def at(self, t_s: float) -> tuple[float, float]:
        """Return the velocity of the air (north, east) in m/s at a time of the flight, which is not negative."""
        intervals = t_s / GUST_HOLD_S
        interval = math.floor(intervals)
        if interval != self._interval:
            self._gusts_m_s = self._gust(interval), self._gust(interval + 1)
            self._interval = interval
        (north_m_s, east_m_s), (next_north_m_s, next_east_m_s) = self._gusts_m_s
        share = intervals - interval
        return (
            self._mean_north_m_s + (1.0 - share) * north_m_s + share * next_north_m_s,
            self._mean_east_m_s + (1.0 - share) * east_m_s + share * next_east_m_s,
        )

    def _gust(self, index: int) -> tuple[float, float]:
        area_share, turn_share = random_stream(self._seed, WIND_STREAM, index).random(2).tolist()
        # The square root makes equal areas of the disc equally likely.
        gust_m_s = self._gust_m_s * math.sqrt(area_share)
        return gust_m_s * math.cos(math.tau * turn_share), gust_m_s * math.sin(math.tau * turn_share)
