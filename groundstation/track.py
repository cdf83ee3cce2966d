"""A track, and how near an agent passed a target between two sightings, which may be a second's flight apart."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

LONGEST_S = 10.0
"""Time between two sightings up to which the way between them counts as known. Chosen, not measured."""
_PARTS = 16
"""Number of straight pieces of a way: the sagitta of a piece is 1/256 of that of the whole."""
_LEAST_SHARE, _GREATEST_SHARE = 0.5, 1.5
"""Lengths, as shares of the straight way, between which speed times time must be for the velocities to be believed."""


@dataclass(frozen=True)
class Track:
    """Position and velocity of an agent, target or threat when it was last seen."""

    north_m: float
    east_m: float
    velocity_north_m_s: float
    velocity_east_m_s: float
    seen_at_s: float

    @property
    def position_ned_m(self) -> tuple[float, float]:
        """Position (north, east) in m at which it was seen."""
        return self.north_m, self.east_m

    def age_s(self, now_s: float) -> float:
        """Return the time since it was seen, at least 0."""
        return max(0.0, now_s - self.seen_at_s)

    def place_at(self, now_s: float) -> tuple[float, float]:
        """Return the position (north, east) in m at `now_s`, extrapolated by its velocity since it was seen."""
        age_s = self.age_s(now_s)
        return self.north_m + self.velocity_north_m_s * age_s, self.east_m + self.velocity_east_m_s * age_s

    def back_at(self, at_s: float) -> Track:
        """Return the track as it was at an earlier time, by its velocity."""
        since_s = self.seen_at_s - at_s
        north_m = self.north_m - self.velocity_north_m_s * since_s
        return replace(self, north_m=north_m, east_m=self.east_m - self.velocity_east_m_s * since_s, seen_at_s=at_s)


def passed_at_m(agent: tuple[Track, Track], target: tuple[Track, Track]) -> float:
    """Return the least distance in m of an agent from a target on the ways between two sightings of each.

    The agent's way is the cubic that has its positions and velocities at both sightings, and straight where those
    velocities do not fit it; the target's is straight. Infinite where the sightings are the same or LONGEST_S apart.
    """
    before, now = agent
    lasts_s = now.seen_at_s - before.seen_at_s
    if not 0.0 < lasts_s <= LONGEST_S:
        return math.inf
    share = np.linspace(0.0, 1.0, _PARTS + 1)
    way = _way(before, now, lasts_s, share)
    there = complex(target[0].north_m, target[0].east_m)
    offset = way - (there + share * (complex(target[1].north_m, target[1].east_m) - there))
    along = np.diff(offset)
    squared = np.maximum(np.abs(along) ** 2, np.finfo(float).tiny)
    nearest = np.clip(-(offset[:-1] * along.conj()).real / squared, 0.0, 1.0)
    return float(np.abs(offset[:-1] + nearest * along).min())


def _way(before: Track, now: Track, lasts_s: float, share: np.ndarray) -> np.ndarray:
    """Return places (north + i east, in m) on the way between two sightings at shares of its time."""
    start, end = complex(before.north_m, before.east_m), complex(now.north_m, now.east_m)
    first, last = (
        lasts_s * complex(one.velocity_north_m_s, one.velocity_east_m_s) - (end - start) for one in (before, now)
    )
    straight: np.ndarray = start + share * (end - start)
    straight_m = abs(end - start)
    lengths_m = (abs(first + end - start), abs(last + end - start))
    if not (_LEAST_SHARE * straight_m <= min(lengths_m) and max(lengths_m) <= _GREATEST_SHARE * straight_m):
        return straight
    # Hermite's cubic, as what it adds to the straight line.
    return straight + share * (1.0 - share) * ((1.0 - share) * first - share * last)
