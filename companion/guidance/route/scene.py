"""Obstacles, start and goal prepared for one search: circles to fly along, their tangents, and what covers them."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from companion.guidance.route.walls import NO_BANDS, Bands

TOLERANCE = 1e-9
"""Share of the scene's size by which, from rounding, a path may seem to cut into a disc that it touches."""
TURN_SLACK = 1.02
"""Least radius of an arc in turn radii; over 1, so that a vehicle a little outside an arc can turn back onto it."""
SNAP_SHARE = 1e-6
"""Share of a disc's radius up to which a vehicle or a goal near the disc's edge counts as being on it."""
SNAP_RAD = 1e-3
"""Angle up to which a vehicle on an edge counts as flying along it."""
FULL_TURN_RAD = 1e-7
"""Angle by which a computed arc may fall short of a full turn and still counts as no arc: a zero, rounded down."""
HALF_PI = math.pi / 2.0
NO_PARENT = -1
"""Parent of a state at the start."""
NOTHING = -1
"""Blocker of a circle that no disc covers."""


class State(NamedTuple):
    """A way from the start that has arrived on a circle."""

    length_m: float  # of the way
    circle: int  # index of the circle
    side: int  # direction along the circle: +1 clockwise, -1 counterclockwise
    angle_rad: float  # of the arrival, seen from the circle's centre, from north towards east
    free_rad: float  # sweep along the circle, in its direction, until a disc covers it
    blocker: int  # index of that disc, or NOTHING
    parent: int  # index of the state before it; NO_PARENT at the start
    heading_rad: float  # of the segment by which the way arrived
    segment_m: float  # length of that segment


class Obstacles(NamedTuple):
    """What no path may enter: discs, of which the last ones are the corners of walls, and the bands between those."""

    centre: np.ndarray  # (M,) complex, north + i east, m
    radius_m: np.ndarray  # (M,)
    bands: Bands = NO_BANDS


class Aim(NamedTuple):
    """What a path leads to: a place, or with a radius a circle that it ends on."""

    place: complex  # north + i east, m
    radius_m: float = 0.0
    side: int = 0  # on which the circle is flown: 1 clockwise, -1 counterclockwise, 0 as is shorter


class Pose(NamedTuple):
    """The pose that a path begins with, and the vehicle's turn radius."""

    place: complex  # north + i east, m
    heading_rad: float = 0.0
    turn_radius_m: float = 0.0  # 0: the vehicle may turn on the spot

    @property
    def limited(self) -> bool:
        """Whether the path must begin on one of the two turning circles."""
        return self.turn_radius_m > 0.0

    @property
    def right(self) -> complex:
        """Centre of the right turning circle, relative to the place; that of the left one is its negative."""
        return self.turn_radius_m * complex(-math.sin(self.heading_rad), math.cos(self.heading_rad))


class _Circles:
    """The circles that a path may consist of, by index.

    The first M are the discs; then come the goal (radius 0 if it is a place), the right turning circle (or the start
    itself, radius 0) and the left one. From `first_band` on, indices mean bands of walls.
    """

    def __init__(self, centre: np.ndarray, arc_m: np.ndarray, goal: Aim, pose: Pose, tolerance_m: float) -> None:
        right, turn_radius_m = pose.right, pose.turn_radius_m
        self.north_m = [*centre.real.tolist(), goal.place.real, right.real, -right.real]
        self.east_m = [*centre.imag.tolist(), goal.place.imag, right.imag, -right.imag]
        self.radius_m = [*arc_m.tolist(), goal.radius_m, turn_radius_m, turn_radius_m]
        self.goal_node = len(arc_m)
        self.right_node, self.left_node = self.goal_node + 1, self.goal_node + 2
        self.first_band = self.goal_node + 3
        # The sides on which a way may arrive at the goal: of its own choice if it is a circle, 1 if it is a place.
        self.goal_sides = (goal.side,) if goal.side else (1, -1) if goal.radius_m else (1,)
        self.touch: dict[int, complex] = {}
        """The direction, of length 1, from a disc's centre to where an arc that is no circle about it touches it."""
        self._tolerance_m = tolerance_m

    def moved(self, places: dict[int, tuple[complex, float]]) -> _Circles:
        """Return the same circles, some of them with another centre and radius, in m."""
        circles = copy.copy(self)
        circles.north_m, circles.east_m, circles.radius_m = self.north_m[:], self.east_m[:], self.radius_m[:]
        for index, (centre, radius_m) in places.items():
            circles.north_m[index], circles.east_m[index] = centre.real, centre.imag
            circles.radius_m[index] = radius_m
        return circles

    def tangent(self, circle: int, side: int, to: int, to_side: int) -> tuple[float, float] | None:
        """Return heading (rad) and length (m) of the tangent from one circle to another; None if there is none.

        A side of +1 is clockwise along the circle, -1 counterclockwise.
        """
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
    """The obstacles prepared for one search, with coordinates relative to the start.

    `collide_m`, (M,), are the radii that no path may enter: those given, shrunk where start or goal would lie inside.
    The arcs around a disc, whose radii are in `circles`, are at least as wide, and wide enough to fly. `bands` are the
    walls' bands, shrunk likewise and by the tolerance.
    """

    def __init__(self, pose: Pose, goal: Aim, obstacles: Obstacles, rough: np.ndarray | None = None) -> None:
        """Prepare a search; `rough`, (M,) bool, are discs whose arcs have their own radius though too small to fly."""
        self.pose = pose
        radii_m, turn_radius_m = obstacles.radius_m, pose.turn_radius_m
        self.centre = obstacles.centre - pose.place  # about the start, so that large coordinates cost no digits
        self.goal = goal.place - pose.place
        self.start_m = np.abs(self.centre)  # (M,) from the start to the centres
        self.tolerance_m = tolerance_m_of(self.start_m, radii_m, self.goal)
        wide_m = np.maximum(radii_m, TURN_SLACK * turn_radius_m) if pose.limited else radii_m
        if rough is not None:
            wide_m = np.where(rough, radii_m, wide_m)
        arc_m = np.minimum(wide_m, self.start_m)
        self.near: list[int] = []  # discs that a turning circle may meet
        if pose.limited:
            self.near = (self.start_m < arc_m + 2.0 * turn_radius_m).nonzero()[0].tolist()
            if self.near:
                self._shrink_to_avoidable(arc_m, radii_m)
        goal_m = np.abs(self.centre - self.goal)  # (M,)
        about_goal = goal_m < wide_m
        if not goal.radius_m and np.count_nonzero(about_goal):
            # A goal on an edge, or among arcs that are wider than their disc, must not lie inside a disc.
            at_goal = about_goal & (goal_m < arc_m) & (goal_m >= (1.0 - SNAP_SHARE) * radii_m - self.tolerance_m)
            arc_m = np.where(at_goal, goal_m, arc_m)
        self.collide_m = np.minimum(radii_m, arc_m)
        entered_m = np.maximum(self.collide_m - self.tolerance_m, 0.0)
        self.entered_m2 = entered_m * entered_m
        self.bands = NO_BANDS
        self.edges: list[tuple[complex, complex]] = []  # beginning and length of each band's middle, m
        if len(obstacles.bands.half_m):
            self.bands = self._shrunk(obstacles.bands, goal)
            edge = self.bands.length_m * self.bands.ahead
            self.edges = list(zip(self.bands.begin.tolist(), edge.tolist(), strict=True))
        goal_radius_m = goal.radius_m
        if goal_radius_m > abs(self.goal):
            # From inside a circle no path ends on it; it ends on a smaller one about the same place.
            goal_radius_m = max(abs(self.goal), min(goal_radius_m, turn_radius_m))
        aim = Aim(self.goal, goal_radius_m, goal.side)
        self.circles = _Circles(self.centre, arc_m, aim, pose, self.tolerance_m)
        self._covers: dict[int, list[tuple[float, float, int]]] = {}

    def touching(self, touch: dict[int, complex]) -> Scene:
        """Return the scene with arcs that touch discs smaller than a turn in given directions, of length 1.

        An arc is narrower if the start or a goal's place is inside it; where it could not be flown then, it stays as it
        is. For checks of a way only, since a search looks for a disc where its circle is.
        """
        if not touch:
            return self
        turn_m, places = self.pose.turn_radius_m, {}
        ends = (0j,) if self.circles.radius_m[self.circles.goal_node] else (0j, self.goal)
        for disc, towards in touch.items():
            collide_m = float(self.collide_m[disc])
            centre, at = complex(self.centre[disc]), collide_m * towards
            radius_m = TURN_SLACK * turn_m
            for end in ends:
                # The circle through a place that touches a line at a point of it.
                before_m = collide_m - ((end - centre) * towards.conjugate()).real
                if before_m > 0.0:
                    radius_m = min(radius_m, abs(end - centre - at) ** 2 / (2.0 * before_m))
            if radius_m >= turn_m and collide_m < radius_m:
                places[disc] = centre + at - radius_m * towards, radius_m
        scene = copy.copy(self)
        scene.circles = self.circles.moved(places)
        scene.circles.touch = {disc: touch[disc] for disc in places}
        scene._covers = {}
        return scene

    def _shrunk(self, bands: Bands, goal: Aim) -> Bands:
        """Return the bands about the start, shrunk to pass at start and goal and by the tolerance."""
        bands = bands._replace(begin=bands.begin - self.pose.place)
        half_m = np.minimum(bands.half_m, bands.distance_m(0j))
        if self.pose.limited:
            half_m = np.minimum(half_m, bands.avoidable_m(self.pose.right, self.pose.turn_radius_m))
        if not goal.radius_m:
            goal_m = bands.distance_m(self.goal)
            at_goal = goal_m >= (1.0 - SNAP_SHARE) * bands.half_m - self.tolerance_m
            half_m = np.where(at_goal, np.minimum(half_m, goal_m), half_m)
        return bands._replace(half_m=np.maximum(half_m - self.tolerance_m, 0.0))

    def _shrink_to_avoidable(self, arc_m: np.ndarray, radii_m: np.ndarray) -> None:  # (M,) m, (M,) m
        """Shrink each disc that both turning circles enter until the better one of them just passes it.

        A disc ahead that both turning circles enter before half a turn cannot be avoided whole: it is convex, so no
        path between the two sharpest turns avoids it either.
        """
        radius_m, right = self.pose.turn_radius_m, self.pose.right
        for disc in self.near:
            place = complex(self.centre[disc])
            avoidable_m = 0.0
            for side in (1, -1):
                offset = (place - side * right) / (-side * right)  # in turning circles, the vehicle at 1
                passes_m = abs(abs(offset) - 1.0) * radius_m * (1.0 - TOLERANCE)
                avoidable_m = max(avoidable_m, passes_m if side * offset.imag >= 0.0 else math.inf)
            wanted_m = float(arc_m[disc])
            if avoidable_m >= radii_m[disc]:
                # The disc itself can be avoided: then only its arc shrinks, and not to less than can be flown.
                avoidable_m = max(avoidable_m, min(wanted_m, radius_m))
            if avoidable_m < wanted_m:
                arc_m[disc] = avoidable_m

    @property
    def is_there(self) -> bool:
        """Whether the start is at the goal."""
        return abs(self.goal) <= self.tolerance_m and not self.circles.radius_m[self.circles.goal_node]

    def blockers(self, north_m: float, east_m: float, heading_rad: float, length_m: float) -> np.ndarray:
        """Return the indices of the discs and bands that a segment enters."""
        unit = complex(math.cos(heading_rad), -math.sin(heading_rad))
        begin = complex(north_m, east_m)
        offset = (self.centre - begin) * unit
        along_m, aside_m = offset.real, offset.imag
        beyond_m = along_m - np.minimum(np.maximum(along_m, 0.0), length_m)
        entered: np.ndarray = (beyond_m * beyond_m + aside_m * aside_m < self.entered_m2).nonzero()[0]
        if len(self.bands.half_m):
            end = np.array(begin + length_m * unit.conjugate())
            crossed = self.bands.entered(np.array(begin), end, self.tolerance_m).nonzero()[0]
            entered = np.concatenate((entered, crossed + self.circles.first_band))
        return entered

    def enters_any(self, segment: tuple[float, float, float, float], suspects: Iterable[int]) -> bool:
        """Return whether a segment enters a disc or crosses the middle of a band of a few; all with their indices.

        The segment is given by its beginning in m, its heading in rad and its length in m.
        """
        begin_north_m, begin_east_m, heading_rad, length_m = segment
        ahead_north, ahead_east = math.cos(heading_rad), math.sin(heading_rad)
        first_band = self.circles.first_band
        for suspect in suspects:
            if suspect >= first_band:
                begin, edge = self.edges[suspect - first_band]
                north_m, east_m = begin.real - begin_north_m, begin.imag - begin_east_m
                aside_m = east_m * ahead_north - north_m * ahead_east
                change_m = edge.imag * ahead_north - edge.real * ahead_east
                if aside_m * (aside_m + change_m) < 0.0:
                    share = -aside_m / change_m
                    along_m = (north_m + share * edge.real) * ahead_north + (east_m + share * edge.imag) * ahead_east
                    if 0.0 < along_m < length_m:
                        return True
                continue
            north_m = self.circles.north_m[suspect] - begin_north_m
            east_m = self.circles.east_m[suspect] - begin_east_m
            aside_m = east_m * ahead_north - north_m * ahead_east
            if aside_m * aside_m < self.entered_m2[suspect]:
                along_m = north_m * ahead_north + east_m * ahead_east
                if 0.0 < along_m < length_m:
                    return True
        return False

    def covered(self, circle: int) -> list[tuple[float, float, int]]:
        """Return the covered stretches of a circle: middle and half width in radians, and what covers it."""
        known = self._covers.get(circle)
        if known is None:
            circles = self.circles
            place = complex(circles.north_m[circle], circles.east_m[circle])
            own = circle if circle < circles.goal_node else None
            known = covered_stretches(
                place, circles.radius_m[circle], self.centre, self.collide_m - self.tolerance_m, own
            )
            if len(self.bands.half_m):
                first_band = circles.first_band
                known.extend(
                    (middle_rad, half_rad, first_band + band)
                    for middle_rad, half_rad, band in self.bands.stretches(
                        place, circles.radius_m[circle], self.tolerance_m
                    )
                )
            self._covers[circle] = known
        return known

    def free_rad(self, circle: int, side: int, angle_rad: float, least: int = 0) -> tuple[float, int]:
        """Return the sweep (rad) along a circle from an angle until something covers it, and its index.

        The index is NOTHING where none does. Only what has an index of at least `least` counts.
        """
        free_rad, blocker = math.tau, NOTHING
        for middle_rad, half_rad, disc in self.covered(circle):
            if disc < least:
                continue
            until_rad = (side * (middle_rad - angle_rad)) % math.tau - half_rad
            if until_rad < free_rad:
                free_rad, blocker = until_rad, disc
        return free_rad, blocker

    def starts(self) -> list[State]:
        """Return the states that a path can begin with: the start, or the turning circles and an edge flown along.

        Their `free_rad` is not computed yet: it is a full turn.
        """
        circles, heading_rad = self.circles, self.pose.heading_rad
        if not self.pose.limited:
            return [State(0.0, circles.right_node, 1, 0.0, math.tau, NOTHING, NO_PARENT, 0.0, 0.0)]
        states = []
        for node, side in ((circles.right_node, 1), (circles.left_node, -1)):
            angle_rad = heading_rad - side * HALF_PI
            states.append(State(0.0, node, side, angle_rad, math.tau, NOTHING, NO_PARENT, heading_rad, 0.0))
        for disc in self.near:
            start_m, radius_m = math.hypot(circles.north_m[disc], circles.east_m[disc]), circles.radius_m[disc]
            if abs(start_m - radius_m) > SNAP_SHARE * radius_m or radius_m == 0.0:
                continue
            angle_rad = math.atan2(-circles.east_m[disc], -circles.north_m[disc])
            for side in (1, -1):
                if abs(math.remainder(angle_rad + side * HALF_PI - heading_rad, math.tau)) <= SNAP_RAD:
                    states.append(State(0.0, disc, side, angle_rad, math.tau, NOTHING, NO_PARENT, heading_rad, 0.0))
        return states


def sweep_rad_of(state: State, heading_rad: float) -> float:
    """Return the sweep (rad) along a state's circle until the way has the given heading."""
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
    """Return the depth, m, to which a path may seem to cut from rounding: TOLERANCE times the scene's size."""
    reach_m = start_m.item(start_m.argmax()) + radii_m.item(radii_m.argmax()) if len(radii_m) else 0.0
    return TOLERANCE * max(reach_m, abs(goal))
