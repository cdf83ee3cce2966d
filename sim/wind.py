"""The wind the stand-ins fly in: a mean and gusts that follow from the seed alone.

Uniform over the plane: at one time it blows the same everywhere and at every height. `from_deg` counts from the plane's
north. What it is at a time depends on nothing but mission, seed and that time, whatever the steps of the flight.
"""

from __future__ import annotations

import math

from companion.mission.model import Wind
from companion.mission.random_streams import random_stream

WIND_STREAM = 4
"""The seed's random stream for wind; each gust has its own within it."""
GUST_HOLD_S = 10.0
"""Time from one drawn gust to the next, linear in between, so that no gust changes faster than by its diameter in this
time. Chosen, not measured: long enough for guidance to feel a gust, too long for turbulence, which is not modelled."""


def crabbed(course_rad: float, airspeed_m_s: float, wind_m_s: tuple[float, float]) -> float:
    """Return the heading whose sideways airspeed cancels the wind across a course: all of it, or as much as there is.

    A head wind above the airspeed drives the vehicle backwards along the course, its nose still into the wind.
    """
    across_m_s = wind_m_s[1] * math.cos(course_rad) - wind_m_s[0] * math.sin(course_rad)
    return course_rad - math.asin(min(max(across_m_s / airspeed_m_s, -1.0), 1.0))


class WindField:
    """A mission's wind from time 0 on.

    Gusts are vectors drawn uniformly from the disc of radius `gust_m_s`; what lies between two of them lies in it too.
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
        """Return the air's velocity (north, east) in m/s at a time of the mission, which is not negative."""
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
        # The root makes equal areas of the disc equally likely.
        gust_m_s = self._gust_m_s * math.sqrt(area_share)
        return gust_m_s * math.cos(math.tau * turn_share), gust_m_s * math.sin(math.tau * turn_share)
