"""How a vehicle is steered along a route of arcs and straight lines, step by step, as the guard predicts it.

A step turns first and then flies straight (companion/guard/vehicle.py), so it cannot follow a wide arc exactly: with
the heading of `course_turn_rad` it stays within a share of (v dt)^2 / R of an arc of radius R (docs/guard.md, Route).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from companion.guard.arcs import Disc, Path, Pose, circle_of, end_of, pose_at, seen_from, straight
from companion.guard.types import Piece
from companion.guard.vehicle import GREATEST_TURN_RAD, VehicleModel

CLOSING_STEPS = 4.0
"""Number of steps in which a distance beside the route is closed. Measured: with 2 and 3 the follower leaves random
routes of arcs no less, and with fewer it swings."""
ON_LINE_RAD = 0.005
"""Greatest turn onto a straight line from which the rest of the line is flown as one stretch."""
LEAST_STRETCH_STEPS = 3
"""Number of steps that are left on a straight line from which they are flown as one stretch."""


class Stretch(NamedTuple):
    """What is flown by one or more steps along a route: the pieces, the number of steps, the way along the route."""

    pieces: tuple[Piece, ...]
    steps: int
    along_m: float


def course_turn_rad(vehicle: VehicleModel, route: Path, along_m: float, pose: Pose, dt_s: float) -> float:
    """Return the turn of one step that follows a route from a pose at a distance along it.

    On a straight line or an arc of the least radius the heading wanted is that of the route a step ahead; on a wider
    arc, where the turn ends before the step does, it is that of the chord: between half a step and a step ahead.
    """
    step_m = route.speed_m_s * dt_s
    rate_1_m = vehicle.curvature_1_m(route.speed_m_s)
    curvature_1_m = abs(piece_at(route, along_m + step_m).curvature_1_m)
    lead_m = step_m * (1.0 + min(1.0, curvature_1_m / rate_1_m)) / 2.0 if curvature_1_m else step_m
    beside_m = seen_from(pose_at(route, along_m), pose)[1]
    heading_rad = pose_at(route, along_m + lead_m).heading_rad - math.atan(beside_m / (CLOSING_STEPS * step_m))
    most_rad = min(step_m * rate_1_m, GREATEST_TURN_RAD)
    return min(max(math.remainder(heading_rad - pose.heading_rad, math.tau), -most_rad), most_rad)


def next_stretch(vehicle: VehicleModel, route: Path, along_m: float, pose: Pose, dt_s: float) -> Stretch:
    """Return what is flown next along a route: one step, or all whole steps that are left on a straight line."""
    step_m = route.speed_m_s * dt_s
    turn_rad, steps = course_turn_rad(vehicle, route, along_m, pose, dt_s), 1
    whole = math.floor(straight_left_m(route, along_m) / step_m)
    if whole >= LEAST_STRETCH_STEPS:
        ahead = pose_at(route, along_m + whole * step_m)
        bearing_rad = math.atan2(ahead.east_m - pose.east_m, ahead.north_m - pose.north_m)
        onto_rad = math.remainder(bearing_rad - pose.heading_rad, math.tau)
        if abs(onto_rad) <= ON_LINE_RAD and abs(turn_rad) <= ON_LINE_RAD:
            turn_rad, steps = onto_rad, whole
    rate_1_m = vehicle.curvature_1_m(route.speed_m_s)
    arc = Piece(*pose, math.copysign(rate_1_m, turn_rad), abs(turn_rad) / rate_1_m)
    line = straight(end_of(arc)._replace(heading_rad=pose.heading_rad + turn_rad), steps * step_m - arc.length_m)
    return Stretch((arc, line), steps, progress_m(route, along_m + steps * step_m, end_of(line)))


def progress_m(route: Path, along_m: float, pose: Pose) -> float:
    """Return the distance along a route at which a pose is, from a first guess: the guess, corrected by what is ahead.

    The tangent at the guess is near enough to the route to correct by it once.
    """
    return max(0.0, along_m + seen_from(pose_at(route, along_m), pose)[0])


def piece_at(route: Path, along_m: float) -> Piece:
    """Return the piece of a route at a distance along it; beyond its end, the last one."""
    for piece in route.pieces:
        if along_m <= piece.length_m:
            return piece
        along_m -= piece.length_m
    return route.pieces[-1]


def straight_left_m(route: Path, along_m: float) -> float:
    """Return how much of the straight line at a distance along a route is left; 0 on an arc and beyond the end."""
    for piece in route.pieces:
        if along_m < piece.length_m:
            return piece.length_m - along_m if piece.curvature_1_m == 0.0 else 0.0
        along_m -= piece.length_m
    return 0.0


def discs_near(route: Iterable[Piece], discs: Sequence[Disc], reach_m: float) -> list[Disc]:
    """Return the discs whose edge may be within a distance of a route.

    A piece counts as the disc about its middle that contains it; a disc that is left out is farther away than that.
    """
    middles_m, halves_m = [], []
    for piece in route:
        half_m = 0.5 * piece.length_m
        if abs(piece.curvature_1_m) * half_m > 1.0:
            north_m, east_m, half_m = circle_of(piece)
            middles_m.append((north_m, east_m))
        else:
            middles_m.append(pose_at(Path((piece,), 0, 0.0, math.inf), half_m)[:2])
        halves_m.append(half_m)
    table, middles = np.array(discs).reshape(-1, 4), np.array(middles_m)
    apart_m = np.hypot(table[:, None, 0] - middles[:, 0], table[:, None, 1] - middles[:, 1]) - np.array(halves_m)
    near = (apart_m <= (table[:, 2] + reach_m)[:, None]).any(axis=1)
    return [disc for disc, is_near in zip(discs, near.tolist(), strict=True) if is_near]
