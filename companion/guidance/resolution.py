"""What the rules of the right of way share: the others, the headings that they forbid, and what a rule decides."""

from __future__ import annotations

import math
from collections.abc import Sequence
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
    """The other aircraft that the vehicle's own detector shows."""

    places_ned_m: np.ndarray  # (P, 2) m
    velocities_m_s: np.ndarray  # (P, 2) m/s, over ground
    strangers: np.ndarray | None = None  # (P,) bool, who is not of the fleet and keeps to no rule; None: nobody


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
