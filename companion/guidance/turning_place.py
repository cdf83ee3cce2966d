"""Where a vehicle that cannot stop can arrive: a clear turning circle that passes a place.

A route may end anywhere in open water, because there the vehicle can turn away wherever it likes. Beside discs and
walls it must end on a circle that is clear of them, or the guard will not let the vehicle in (docs/guard.md).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

ANGLES = 72
"""Number of directions from the place in which the circle's centre is looked for."""
RINGS = 40
"""Number of rings about the place on which the centre is looked for, where no circle passes it near enough."""
RING_SHARE = 0.5
"""Distance between two of those rings, as a share of the circle's radius."""
PASSES = (0.0, 0.3, -0.3, 0.6, -0.6, 0.9, -0.9)
"""Distances at which a circle may pass the place, as shares of the arrival radius, the best first."""


class Room(NamedTuple):
    """What a turning circle must be clear of: discs, and walls that are polygons."""

    centres_ned_m: np.ndarray  # (M, 2) m
    radii_m: np.ndarray  # (M,) m, with the clearance
    fence_ned_m: np.ndarray  # (C, 2) m, corners; (0, 2) without a fence
    exclusions_ned_m: tuple[np.ndarray, ...]  # each (C, 2) m
    clearance_m: float
    """What is kept from walls."""


class TurningPlace(NamedTuple):
    """A clear turning circle, and how near to the place it passes."""

    centre_ned_m: tuple[float, float]
    passes_m: float


def is_open(room: Room, place_ned_m: tuple[float, float], radius_m: float) -> bool:
    """Return whether every turning circle of this radius that passes a place is clear."""
    return bool(room_m(room, np.array([place_ned_m]))[0] >= 2.0 * radius_m)


def is_clear(room: Room, centre_ned_m: tuple[float, float], radius_m: float) -> bool:
    """Return whether a circle is clear."""
    return bool(room_m(room, np.array([centre_ned_m]))[0] >= radius_m)


def turning_place(
    room: Room, place_ned_m: tuple[float, float], radius_m: float, within_m: float, near_ned_m: tuple[float, float]
) -> TurningPlace | None:
    """Return a clear circle that passes a place within a distance, or else the nearest clear one; None: there is none.

    Of circles that pass equally near, the one whose centre is nearest to `near_ned_m` is taken.
    """
    for share in PASSES:
        found = _on_ring(room, place_ned_m, radius_m, radius_m + share * within_m, near_ned_m)
        if found is not None:
            return found
    for ring in range(RINGS):
        out_m = radius_m + within_m + ring * RING_SHARE * radius_m
        found = _on_ring(room, place_ned_m, radius_m, out_m, near_ned_m)
        if found is not None:
            return found
    return None


def _on_ring(
    room: Room, place_ned_m: tuple[float, float], radius_m: float, out_m: float, near_ned_m: tuple[float, float]
) -> TurningPlace | None:
    """Return the clear circle whose centre is on a ring about a place, nearest to `near_ned_m`; None if none is."""
    if out_m < 0.0:
        return None
    angles_rad = np.arange(ANGLES) * (math.tau / ANGLES)
    centres_m = np.array(place_ned_m) + out_m * np.column_stack((np.cos(angles_rad), np.sin(angles_rad)))
    clear = room_m(room, centres_m) >= radius_m
    if not clear.any():
        return None
    apart_m = np.hypot(centres_m[:, 0] - near_ned_m[0], centres_m[:, 1] - near_ned_m[1])
    best = int(np.where(clear, apart_m, math.inf).argmin())
    return TurningPlace((float(centres_m[best, 0]), float(centres_m[best, 1])), abs(out_m - radius_m))


def room_m(room: Room, places_m: np.ndarray) -> np.ndarray:  # (P, 2) m -> (P,) m
    """Return the radius of the greatest clear circle about each place, negative inside of a disc or behind a wall."""
    clear_m = np.full(len(places_m), math.inf)
    if len(room.radii_m):
        offset_m = places_m[:, None, :] - room.centres_ned_m
        clear_m = (np.hypot(offset_m[..., 0], offset_m[..., 1]) - room.radii_m).min(axis=1)
    walls = [(room.fence_ned_m, True)] if len(room.fence_ned_m) else []
    for corners_m, inside in [*walls, *((corners_m, False) for corners_m in room.exclusions_ned_m)]:
        apart_m, within = _to_polygon(corners_m, places_m)
        clear_m = np.minimum(clear_m, np.where(within == inside, apart_m, -apart_m) - room.clearance_m)
    return clear_m


def _to_polygon(corners_m: np.ndarray, places_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # (C, 2), (P, 2)
    """Return each place's distance to the nearest edge of a polygon, (P,) m, and whether it is inside, (P,) bool."""
    starts_m, along_m = corners_m, np.roll(corners_m, -1, axis=0) - corners_m
    squares_m2 = np.maximum((along_m**2).sum(axis=1), 1e-12)
    offset_m = places_m[:, None, :] - starts_m
    shares = np.clip((offset_m * along_m).sum(axis=2) / squares_m2, 0.0, 1.0)
    away_m = offset_m - shares[..., None] * along_m
    ends_m = starts_m + along_m
    spans = (starts_m[:, 0] > places_m[:, :1]) != (ends_m[:, 0] > places_m[:, :1])
    rise_m = np.where(along_m[:, 0] == 0.0, 1.0, along_m[:, 0])
    crossing_m = starts_m[:, 1] + (places_m[:, :1] - starts_m[:, 0]) / rise_m * along_m[:, 1]
    inside = (spans & (crossing_m > places_m[:, 1:])).sum(axis=1) % 2 == 1
    return np.hypot(away_m[..., 0], away_m[..., 1]).min(axis=1), inside
