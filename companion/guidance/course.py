"""The course along a planned route: where on it the vehicle is, what is left of it, and the heading that follows it.

A vehicle turns at the beginning of a guidance step and then flies straight, so the heading that keeps it on a wide arc
is that of the chord, not the tangent (docs/route.md, Following).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from companion.guard.types import ROUNDING_M, TRACKING_REACTIONS, TRACKING_STEPS, Piece

FOLLOWING_SHARE = 0.45
"""A vehicle steered by `course_rad` stays within this share of (v dt)^2 / R of an arc of radius R (measured over random
routes at steps of 0.1 to 5 s: tests/companion/guidance/test_course.py)."""
CLOSING_STEPS = 4.0
"""Number of guidance steps in which a distance beside the route is closed."""


RadiusT = TypeVar("RadiusT", float, np.ndarray)


def following_m(step_m: float, radius_m: RadiusT) -> RadiusT:
    """Return how far a vehicle that flies `step_m` in a guidance step may be off an arc of a given radius, or radii."""
    return FOLLOWING_SHARE * step_m * step_m / radius_m


def held_m(position_error_m: float, wind_m_s: float, reaction_s: float, step_s: float) -> float:
    """Return what the guard adds to every disc: rounding, the position's error, and the wind's drift (docs/guard.md).

    Guidance reckons it by itself, from the guard's constants: what is kept beyond it lies outside the guard's discs.
    """
    return ROUNDING_M + position_error_m + wind_m_s * (TRACKING_STEPS * step_s + TRACKING_REACTIONS * reaction_s)


def at(pieces: Sequence[Piece], along_m: float) -> tuple[float, float, float]:
    """Return north (m), east (m) and heading (rad) at a distance along pieces; beyond their end, straight on."""
    for piece in pieces[:-1]:
        if along_m <= piece.length_m:
            return _on(piece, along_m)
        along_m -= piece.length_m
    last = pieces[-1]
    north_m, east_m, heading_rad = _on(last, min(along_m, last.length_m))
    beyond_m = max(0.0, along_m - last.length_m)
    return north_m + beyond_m * math.cos(heading_rad), east_m + beyond_m * math.sin(heading_rad), heading_rad


def left_of(pieces: Sequence[Piece], along_m: float) -> tuple[Piece, ...]:
    """Return what is left of pieces after a distance along them; at least a piece of no length at their end."""
    for index, piece in enumerate(pieces):
        if along_m < piece.length_m or index + 1 == len(pieces):
            done_m = min(along_m, piece.length_m)
            rest = Piece(*_on(piece, done_m), piece.curvature_1_m, piece.length_m - done_m)
            return (rest, *pieces[index + 1 :])
        along_m -= piece.length_m
    return ()


def nearest(pieces: Sequence[Piece], position_ned_m: tuple[float, float], within_m: float) -> tuple[float, float]:
    """Return the distance along pieces of the point nearest to a position, and how far the position is from it, m.

    Only pieces that begin within `within_m` are looked at. The second number is positive right of the route.
    """
    best = (0.0, math.inf)
    before_m = 0.0
    for piece in pieces:
        along_m = _nearest_on_m(piece, position_ned_m)
        north_m, east_m, heading_rad = _on(piece, along_m)
        off_north_m, off_east_m = position_ned_m[0] - north_m, position_ned_m[1] - east_m
        apart_m = math.hypot(off_north_m, off_east_m)
        if apart_m < abs(best[1]):
            right_m = off_east_m * math.cos(heading_rad) - off_north_m * math.sin(heading_rad)
            best = (before_m + along_m, math.copysign(apart_m, right_m))
        before_m += piece.length_m
        if before_m > within_m:
            break
    return best


def course_rad(pieces: Sequence[Piece], beside_m: float, step_m: float, turn_radius_m: float) -> float:
    """Return the heading that keeps a vehicle at the beginning of pieces on them, in (-pi, pi] about the route's own.

    Args:
        pieces: The route from where the vehicle is.
        beside_m: How far the vehicle is to the right of it.
        step_m: Length flown in a guidance step.
        turn_radius_m: The vehicle's turn radius, 0 if it turns on the spot.

    """
    curvature_1_m = abs(_piece_at(pieces, step_m).curvature_1_m)
    share = 1.0 if curvature_1_m == 0.0 else (1.0 + min(1.0, turn_radius_m * curvature_1_m)) / 2.0
    return at(pieces, share * step_m)[2] - math.atan(beside_m / (CLOSING_STEPS * step_m))


def _piece_at(pieces: Sequence[Piece], along_m: float) -> Piece:
    for piece in pieces:
        if along_m <= piece.length_m:
            return piece
        along_m -= piece.length_m
    return pieces[-1]


def _on(piece: Piece, along_m: float) -> tuple[float, float, float]:
    """Return north, east and heading at a distance along a piece: a chord along the middle heading."""
    half_rad = 0.5 * piece.curvature_1_m * along_m
    chord_m = along_m * (math.sin(half_rad) / half_rad) if half_rad else along_m
    middle_rad = piece.heading_rad + half_rad
    return (
        piece.north_m + chord_m * math.cos(middle_rad),
        piece.east_m + chord_m * math.sin(middle_rad),
        middle_rad + half_rad,
    )


def _nearest_on_m(piece: Piece, position_ned_m: tuple[float, float]) -> float:
    """Return the distance along a piece of its point nearest to a position."""
    north_m, east_m = position_ned_m[0] - piece.north_m, position_ned_m[1] - piece.east_m
    ahead_m = north_m * math.cos(piece.heading_rad) + east_m * math.sin(piece.heading_rad)
    if piece.curvature_1_m == 0.0:
        return min(max(ahead_m, 0.0), piece.length_m)
    side = math.copysign(1.0, piece.curvature_1_m)
    radius_m = 1.0 / abs(piece.curvature_1_m)
    inwards_m = side * (east_m * math.cos(piece.heading_rad) - north_m * math.sin(piece.heading_rad))
    turned_rad = math.atan2(ahead_m, radius_m - inwards_m) % math.tau
    sweep_rad = piece.length_m / radius_m
    if turned_rad <= sweep_rad:
        return turned_rad * radius_m
    return 0.0 if math.tau - turned_rad < turned_rad - sweep_rad else piece.length_m
