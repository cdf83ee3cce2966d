"""What the rules of the right of way share: the others, the headings that they forbid, and what a rule decides."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

EDGE_RAD = 1e-6
"""Angle by which a heading taken at the edge of a forbidden arc lies outside it, against rounding."""

CIRCLING = "right of way: circling right until the way is free"
PASSING = "right of way: keeping a neighbour on the left"
TURNING_RIGHT = "right of way: turning to the right, because a neighbour is on the left"
SLOWING = "right of way: slowing down"
LATE = "right of way: keeping clear of a neighbour seen too late"
EVADING = "right of way: out of the way of a stranger"
PIVOTING = "right of way: turning on the spot to where the way is free"
STOPPING = "right of way: stopping until the way is free"

Arc = tuple[float, float]
"""Forbidden headings: their middle and half-width, rad."""


class Peers(NamedTuple):
    """The other aircraft, each as last seen or told, and how old and how uncertain that is."""

    places_ned_m: np.ndarray  # (P, 2) m
    velocities_m_s: np.ndarray  # (P, 2) m/s, over ground
    strangers: np.ndarray | None = None  # (P,) bool, who is not of the fleet and keeps to no rule; None: nobody
    ages_s: np.ndarray | None = None  # (P,) s, how long ago each was there; None: all are there now
    growths_m: np.ndarray | None = None  # (P,) m, how far what it reserves may lie off since; None: nowhere

    def rows(self) -> Iterator[tuple[complex, complex, float, float]]:
        """Yield the place, m, the velocity, m/s, the age, s, and the growth, m, of each; north is the real part."""
        count = len(self.places_ned_m)
        ages_s = [0.0] * count if self.ages_s is None else self.ages_s.tolist()
        growths_m = [0.0] * count if self.growths_m is None else self.growths_m.tolist()
        # Plain floats: for the dozens of peers that a detector shows this is faster than a dozen array operations.
        places, velocities = self.places_ned_m.tolist(), self.velocities_m_s.tolist()
        for place, velocity, age_s, growth_m in zip(places, velocities, ages_s, growths_m, strict=True):
            yield complex(*place), complex(*velocity), age_s, growth_m


class AtEffect(NamedTuple):
    """The heading and the speed that a vehicle has by its last command when a decision made now takes effect."""

    heading_rad: float
    speed_m_s: float


@dataclass(frozen=True)
class Resolution:
    """The rule's resolution of a wanted heading: the heading and speed to fly, and the reason for any change."""

    heading_rad: float  # clockwise from north, in [0, 2 pi)
    speed_m_s: float
    reason: str | None  # None: nothing was changed
    peer: int | None = None
    """Index of the neighbour that the vehicle gives way to; None if nothing was changed."""


def inside(heading_rad: float, arcs: Sequence[Arc]) -> bool:
    """Return whether a heading lies in any of the arcs."""
    return any(abs(math.remainder(heading_rad - middle, math.tau)) < half for middle, half in arcs)


def first_clockwise(wanted_rad: float, arcs: Sequence[Arc]) -> float | None:
    """Return the wanted heading if it is free, else the first free one clockwise from it; None if there is none."""
    free = [wanted_rad] + [(middle + half + EDGE_RAD) % math.tau for middle, half in arcs]
    for heading_rad in sorted(free, key=lambda each: (each - wanted_rad) % math.tau):
        if not inside(heading_rad, arcs):
            return heading_rad
    return None
