"""Discs, start and goal as one search sees them: circles to go along, the tangents between them, what covers them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

TOLERANCE = 1e-9
"""Of the scene's size: how deep a path may seem to cut into a disc that it touches, for rounding."""
TURN_SLACK = 1.02
"""Arcs are this much wider than the turning circle: a vehicle a little outside an arc can still turn back onto it."""
SNAP_SHARE = 1e-6
"""Of the radius: a vehicle or a goal this near to a disc's edge is on it."""
SNAP_RAD = 1e-3
"""A vehicle on an edge goes along it if its heading is this near to the edge's."""
FULL_TURN_RAD = 1e-7
"""An arc that lacks less than this to a full turn is no arc: the rounding of a zero."""
HALF_PI = math.pi / 2.0
NO_PARENT = -1
NOTHING = -1


class State(NamedTuple):
    """A way that has arrived on a circle: how long it is, where it is now and where it came from."""

    length_m: float
    circle: int
    side: int
    angle_rad: float  # where on the circle, from north towards east
    free_rad: float  # how far along the circle, in its direction, until a disc covers it
    blocker: int  # that disc, or NOTHING
    parent: int  # state before it; NO_PARENT at the start
    heading_rad: float  # of the segment by which it came
    segment_m: float


class _Departure(NamedTuple):
    """Where a path begins and how."""

    place: complex  # north + i east, m
    heading_rad: float
    turn_radius_m: float  # 0: it may turn on the spot

    @property
    def limited(self) -> bool:
        """Whether it begins on one of two turning circles."""
        return self.turn_radius_m > 0.0

    @property
    def right(self) -> complex:
        """Centre of the right turning circle from the place; that of the left one is opposite."""
        return self.turn_radius_m * complex(-math.sin(self.heading_rad), math.cos(self.heading_rad))


class _Circles:
    """The circles that a path goes along, by index.

    First M discs, then the goal, the right turning circle (or the start itself) and the left one.
    """

    def __init__(
        self, north_m: list[float], east_m: list[float], radius_m: list[float], goal_node: int, tolerance_m: float
    ) -> None:
        self.north_m, self.east_m, self.radius_m = north_m, east_m, radius_m
        self.goal_node, self.right_node, self.left_node = goal_node, goal_node + 1, goal_node + 2
        self._tolerance_m = tolerance_m

    def tangent(self, circle: int, side: int, to: int, to_side: int) -> tuple[float, float] | None:
        """Return heading (rad) and length (m) of the segment that leaves one circle and joins another; None if none."""
        north_m = self.north_m[to] - self.north_m[circle]
        east_m = self.east_m[to] - self.east_m[circle]
        across_m = to_side * self.radius_m[to] - side * self.radius_m[circle]
        gap_m2 = north_m * north_m + east_m * east_m
        along_m2 = gap_m2 - across_m * across_m
        if along_m2 <= 0.0:
            gap_m = math.sqrt(gap_m2)
            if gap_m == 0.0 or abs(across_m) > gap_m + self._tolerance_m:
                return None
            along_m2 = 0.0
        along_m = math.sqrt(along_m2)
        return math.atan2(east_m, north_m) - math.atan2(across_m, along_m), along_m


class Scene:
    """Discs as one search sees them: about the start, shrunk where start or goal demand it, arcs wide enough to fly.

    `collide_m` is what no path may enter; the arcs around it, the radii of the discs' circles, are no narrower.
    """

    def __init__(
        self,
        start: complex,
        goal: complex,
        centres: np.ndarray,  # (M,) complex, north + i east, m
        radii_m: np.ndarray,  # (M,) m
        heading_rad: float | None,
        turn_radius_m: float,
    ) -> None:
        limited = turn_radius_m > 0.0 and heading_rad is not None
        self.departure = _Departure(start, heading_rad or 0.0, turn_radius_m if limited else 0.0)
        turn_radius_m = self.departure.turn_radius_m
        self.centre = centres - start  # about the start, so that large coordinates cost no digits
        self.goal = goal - start
        self.start_m = np.abs(self.centre)  # (M,) from the start to the centres
        self.tolerance_m = tolerance_m_of(self.start_m, radii_m, self.goal)
        wide_m = np.maximum(radii_m, TURN_SLACK * turn_radius_m) if limited else radii_m
        arc_m = np.minimum(wide_m, self.start_m)
        self.near: list[int] = []  # discs that a turning circle may meet
        if limited:
            self.near = (self.start_m < arc_m + 2.0 * turn_radius_m).nonzero()[0].tolist()
            if self.near:
                self._shrink_to_avoidable(arc_m, radii_m)
        goal_m = np.abs(self.centre - self.goal)  # (M,)
        about_goal = goal_m < wide_m
        self.goal_inside = False
        if np.count_nonzero(about_goal):
            self.goal_inside = bool((goal_m < radii_m - self.tolerance_m).any())
            # A goal on an edge, or among arcs that are wider than their disc, must not lie inside a disc.
            at_goal = about_goal & (goal_m < arc_m) & (goal_m >= (1.0 - SNAP_SHARE) * radii_m - self.tolerance_m)
            arc_m = np.where(at_goal, goal_m, arc_m)
        self.collide_m = np.minimum(radii_m, arc_m)
        entered_m = np.maximum(self.collide_m - self.tolerance_m, 0.0)
        self.entered_m2 = entered_m * entered_m
        self.circles = _circles(self.centre, arc_m, self.goal, self.departure, self.tolerance_m)
        self._covers: dict[int, list[tuple[float, float, int]]] = {}

    def _shrink_to_avoidable(self, arc_m: np.ndarray, radii_m: np.ndarray) -> None:  # (M,) m, (M,) m
        """Let each disc that neither turning circle keeps out of reach only as far as the better one passes it.

        A disc ahead that both turning circles enter before half a turn cannot be avoided whole: convex as it is,
        nothing between the two sharpest turns passes it either.
        """
        radius_m, right = self.departure.turn_radius_m, self.departure.right
        for disc in self.near:
            place = complex(self.centre[disc])
            avoidable_m = 0.0
            for side in (1, -1):
                offset = (place - side * right) / (-side * right)  # in turning circles, the vehicle at 1
                passes_m = abs(abs(offset) - 1.0) * radius_m * (1.0 - TOLERANCE)
                avoidable_m = max(avoidable_m, passes_m if side * offset.imag >= 0.0 else math.inf)
            wanted_m = float(arc_m[disc])
            if avoidable_m >= radii_m[disc]:
                # What leaves the true disc avoidable is not worth an arc that cannot be flown.
                avoidable_m = max(avoidable_m, min(wanted_m, radius_m))
            if avoidable_m < wanted_m:
                arc_m[disc] = avoidable_m

    def blockers(self, north_m: float, east_m: float, heading_rad: float, length_m: float) -> np.ndarray:
        """Return the indices of the discs that a segment enters."""
        unit = complex(math.cos(heading_rad), -math.sin(heading_rad))
        offset = (self.centre - complex(north_m, east_m)) * unit
        along_m, aside_m = offset.real, offset.imag
        beyond_m = along_m - np.minimum(np.maximum(along_m, 0.0), length_m)
        entered: np.ndarray = (beyond_m * beyond_m + aside_m * aside_m < self.entered_m2).nonzero()[0]
        return entered

    def covered(self, circle: int) -> list[tuple[float, float, int]]:
        """Return the stretches of a circle that discs cover: middle and half width in radians, and the disc."""
        known = self._covers.get(circle)
        if known is None:
            circles = self.circles
            place = complex(circles.north_m[circle], circles.east_m[circle])
            own = circle if circle < circles.goal_node else None
            known = covered_stretches(
                place, circles.radius_m[circle], self.centre, self.collide_m - self.tolerance_m, own
            )
            self._covers[circle] = known
        return known

    def free_rad(self, circle: int, side: int, angle_rad: float) -> tuple[float, int]:
        """Return how far (rad) one can go along a circle from an angle until a disc covers it, and which disc."""
        free_rad, blocker = math.tau, NOTHING
        for middle_rad, half_rad, disc in self.covered(circle):
            until_rad = (side * (middle_rad - angle_rad)) % math.tau - half_rad
            if until_rad < free_rad:
                free_rad, blocker = until_rad, disc
        return free_rad, blocker

    def starts(self) -> list[State]:
        """Return where a path can begin: at the start, or on a turning circle, or on the edge that is flown along.

        How far it may go along these circles is left open.
        """
        circles, heading_rad = self.circles, self.departure.heading_rad
        if not self.departure.limited:
            return [State(0.0, circles.right_node, 1, 0.0, math.tau, NOTHING, NO_PARENT, 0.0, 0.0)]
        states = []
        for node, side in ((circles.right_node, 1), (circles.left_node, -1)):
            angle_rad = heading_rad - side * HALF_PI
            states.append(State(0.0, node, side, angle_rad, math.tau, NOTHING, NO_PARENT, heading_rad, 0.0))
        for disc in self.near:
            start_m, radius_m = float(self.start_m[disc]), circles.radius_m[disc]
            if abs(start_m - radius_m) > SNAP_SHARE * radius_m or radius_m == 0.0:
                continue
            angle_rad = math.atan2(-circles.east_m[disc], -circles.north_m[disc])
            for side in (1, -1):
                if abs(math.remainder(angle_rad + side * HALF_PI - heading_rad, math.tau)) <= SNAP_RAD:
                    states.append(State(0.0, disc, side, angle_rad, math.tau, NOTHING, NO_PARENT, heading_rad, 0.0))
        return states


def _circles(
    centre: np.ndarray,  # (M,) complex, m, from the start
    arc_m: np.ndarray,  # (M,) m
    goal: complex,
    departure: _Departure,
    tolerance_m: float,
) -> _Circles:
    """Return the circles of discs with arcs of a radius, of a goal and of a departure."""
    right, turn_radius_m = departure.right, departure.turn_radius_m
    return _Circles(
        [*centre.real.tolist(), goal.real, right.real, -right.real],
        [*centre.imag.tolist(), goal.imag, right.imag, -right.imag],
        [*arc_m.tolist(), 0.0, turn_radius_m, turn_radius_m],
        len(arc_m),
        tolerance_m,
    )


def sweep_rad_of(state: State, heading_rad: float) -> float:
    """Return how far a way goes along its circle until it heads so."""
    sweep_rad = (state.side * (heading_rad - state.angle_rad) - HALF_PI) % math.tau
    return 0.0 if sweep_rad > math.tau - FULL_TURN_RAD else sweep_rad


def covered_stretches(
    place: complex,
    radius_m: float,
    centre: np.ndarray,  # (M,) complex, m
    other_m: np.ndarray,  # (M,) m
    own: int | None,
) -> list[tuple[float, float, int]]:
    """Return the stretches of a circle that other discs cover: middle and half width in radians, and the disc."""
    offset = centre - place
    gap_m = np.abs(offset)
    crossing = (gap_m < radius_m + other_m) & (gap_m > radius_m - other_m)
    if own is not None:
        crossing[own] = False
    intervals = []
    for index in crossing.nonzero()[0].tolist():
        gap, other = float(gap_m[index]), float(other_m[index])
        if gap <= other - radius_m:
            return [(0.0, math.pi, index)]
        cosine = (radius_m * radius_m + gap * gap - other * other) / (2.0 * radius_m * gap)
        half_rad = math.acos(min(max(cosine, -1.0), 1.0))
        intervals.append((math.atan2(offset[index].imag, offset[index].real), half_rad, index))
    return intervals


def tolerance_m_of(start_m: np.ndarray, radii_m: np.ndarray, goal: complex) -> float:
    """Return how deep rounding may seem to cut, m: in proportion to the scene as seen from the start."""
    reach_m = start_m.item(start_m.argmax()) + radii_m.item(radii_m.argmax()) if len(radii_m) else 0.0
    return TOLERANCE * max(reach_m, abs(goal))
