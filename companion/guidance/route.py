"""The shortest way around discs, for the vehicle's computer: D_geo and its first direction (docs/method.md section 3).

A shortest path is made of arcs on discs and of segments that touch two of them, so it is a path in the graph of
tangents. The search builds that graph only where it must: it begins with the straight line and takes a disc in when
that disc is found in the way. A shortest path around some of the discs that happens to be free of all is the shortest
of all. A vehicle that cannot turn on the spot begins on one of its two turning circles, which are nodes like a disc's.

Headings grow clockwise and a disc kept on the right is gone around clockwise: side +1, as a turn to the right.
"""

from __future__ import annotations

import cmath
import heapq
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from companion.guard.types import Piece

TOLERANCE = 1e-9
"""Of the scene's size: how deep a path may seem to cut into a disc that it touches, for rounding."""
SWITCH_SHARE = 0.02
"""A fresh way around other sides must save more than this share of the kept one's length (docs/method.md section 3)."""
TURN_SLACK = 1.02
"""Arcs are this much wider than the turning circle: a vehicle a little outside an arc can still turn back onto it."""
DEEP_SHARE = 0.05
"""A vehicle this share of the radius inside a disc heads straight out of it; less deep, partly outwards."""
SNAP_SHARE = 1e-6
"""Of the radius: a vehicle or a goal this near to a disc's edge is on it..."""
SNAP_RAD = 1e-3
"""...and a vehicle goes along it if its heading is this near to the edge's."""
FULL_TURN_RAD = 1e-7
"""An arc that lacks less than this to a full turn is no arc: the rounding of a zero."""
PATIENCE = 48
"""After so many states the search asks whether there is a way at all; that costs as much as about twenty states."""
MAX_STATES = 1500
"""And after so many it gives up a path that keeps the turn limit; scenes of 100 discs need fewer than 300."""
NEAREST_TRIES = 8
"""So many of the nearest points are tried where it is not known which of them there is a way to."""
REPLAN_STEPS = 10
"""A kept way is compared with a fresh one at least every so many calls..."""
REPLAN_SHARE = 0.05
"""...and when a disc's centre and radius together, or the goal, have changed by this share of a radius since then."""

_HALF_PI = math.pi / 2.0


class Reach(Enum):
    """Where a route leads."""

    TARGET = "target"
    NEAREST = "nearest safe point"
    NONE = "no way"


class Route(NamedTuple):
    """A way, its length and where to head now."""

    reach: Reach
    goal_ned_m: tuple[float, float]
    """The target, or the nearest safe point to it."""
    length_m: float
    """D_geo to `goal_ned_m`; infinite without a way."""
    heading_rad: float
    """First direction, in [0, 2 pi); not a number without a way."""
    turn: int
    """+1 or -1: it begins with an arc of the vehicle's own turning circle to the right or left that ends at
    `heading_rad`; 0: it does not."""
    via: tuple[tuple[int, int], ...]
    """Discs touched in order: index in the given arrays, and side, +1 clockwise (disc on the right)."""
    pieces: tuple[Piece, ...]
    """The path in order."""


class _State(NamedTuple):
    """A way that has arrived on a circle: how long it is, where it is now and where it came from."""

    length_m: float
    circle: int
    side: int
    angle_rad: float  # where on the circle, from north towards east
    free_rad: float  # how far along the circle, in its direction, until a disc covers it
    blocker: int  # that disc, or _NOTHING
    parent: int  # state before it; _NO_PARENT at the start
    heading_rad: float  # of the segment by which it came
    segment_m: float


_NO_PARENT = -1
_NOTHING = -1


class _Scene:
    """Discs as one search sees them: about the start, shrunk where start or goal demand it, arcs wide enough to fly.

    `collide_m` is what no path may enter, `arc_m >= collide_m` the radius of the arcs around it.
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
        self.start, self.heading_rad = start, heading_rad or 0.0
        self.limited = turn_radius_m > 0.0 and heading_rad is not None
        self.turn_radius_m = turn_radius_m if self.limited else 0.0
        self.centre = centres - start  # about the start, so that large coordinates cost no digits
        self.goal = goal - start
        count = len(radii_m)
        self.start_m = np.abs(self.centre)  # (M,) from the start to the centres
        self.tolerance_m = _tolerance_m(self.start_m, radii_m, self.goal)
        wide_m = np.maximum(radii_m, TURN_SLACK * self.turn_radius_m) if self.limited else radii_m
        self.arc_m = np.minimum(wide_m, self.start_m)
        self.near: list[int] = []  # discs that a turning circle may meet
        if self.limited:
            self.near = (self.start_m < self.arc_m + 2.0 * self.turn_radius_m).nonzero()[0].tolist()
            if self.near:
                self._shrink_to_avoidable(radii_m)
        goal_m = np.abs(self.centre - self.goal)  # (M,)
        about_goal = goal_m < wide_m
        self.goal_inside = False
        if np.count_nonzero(about_goal):
            self.goal_inside = bool((goal_m < radii_m - self.tolerance_m).any())
            # A goal on an edge, or among arcs that are wider than their disc, must not lie inside a disc.
            at_goal = about_goal & (goal_m < self.arc_m) & (goal_m >= (1.0 - SNAP_SHARE) * radii_m - self.tolerance_m)
            self.arc_m = np.where(at_goal, goal_m, self.arc_m)
        self.collide_m = np.minimum(radii_m, self.arc_m)
        entered_m = np.maximum(self.collide_m - self.tolerance_m, 0.0)
        self.entered_m2 = entered_m * entered_m

        right = self.turn_radius_m * complex(-math.sin(self.heading_rad), math.cos(self.heading_rad))
        # Nodes by index: M discs, the goal, the right turning circle (or the start itself), the left one.
        self.north_m = [*self.centre.real.tolist(), self.goal.real, right.real, -right.real]
        self.east_m = [*self.centre.imag.tolist(), self.goal.imag, right.imag, -right.imag]
        self.radius_m = [*self.arc_m.tolist(), 0.0, self.turn_radius_m, self.turn_radius_m]
        self.goal_node, self.right_node, self.left_node = count, count + 1, count + 2
        self._covers: dict[int, list[tuple[float, float, int]]] = {}

    def _shrink_to_avoidable(self, radii_m: np.ndarray) -> None:
        """Let each disc that neither turning circle keeps out of reach only as far as the better one passes it.

        A disc ahead that both turning circles enter before half a turn cannot be avoided whole: convex as it is,
        nothing between the two sharpest turns passes it either.
        """
        radius_m = self.turn_radius_m
        right = radius_m * complex(-math.sin(self.heading_rad), math.cos(self.heading_rad))
        for disc in self.near:
            place = complex(self.centre[disc])
            avoidable_m = 0.0
            for side in (1, -1):
                offset = (place - side * right) / (-side * right)  # in turning circles, the vehicle at 1
                passes_m = abs(abs(offset) - 1.0) * radius_m * (1.0 - TOLERANCE)
                avoidable_m = max(avoidable_m, passes_m if side * offset.imag >= 0.0 else math.inf)
            arc_m = float(self.arc_m[disc])
            if avoidable_m >= radii_m[disc]:
                # What leaves the true disc avoidable is not worth an arc that cannot be flown.
                avoidable_m = max(avoidable_m, min(arc_m, radius_m))
            if avoidable_m < arc_m:
                self.arc_m[disc] = avoidable_m

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
            place = complex(self.north_m[circle], self.east_m[circle])
            own = circle if circle < self.goal_node else None
            known = _covered(place, self.radius_m[circle], self.centre, self.collide_m - self.tolerance_m, own)
            self._covers[circle] = known
        return known

    def free_rad(self, circle: int, side: int, angle_rad: float) -> tuple[float, int]:
        """Return how far (rad) one can go along a circle from an angle until a disc covers it, and which disc."""
        free_rad, blocker = math.tau, _NOTHING
        for middle_rad, half_rad, disc in self.covered(circle):
            until_rad = (side * (middle_rad - angle_rad)) % math.tau - half_rad
            if until_rad < free_rad:
                free_rad, blocker = until_rad, disc
        return free_rad, blocker

    def starts(self) -> list[_State]:
        """Return where a path can begin: at the start, or on a turning circle, or on the edge that is flown along.

        How far it may go along these circles is left open.
        """
        if not self.limited:
            return [_State(0.0, self.right_node, 1, 0.0, math.tau, _NOTHING, _NO_PARENT, 0.0, 0.0)]
        states = []
        for node, side in ((self.right_node, 1), (self.left_node, -1)):
            angle_rad = self.heading_rad - side * _HALF_PI
            states.append(_State(0.0, node, side, angle_rad, math.tau, _NOTHING, _NO_PARENT, self.heading_rad, 0.0))
        for disc in self.near:
            start_m, radius_m = float(self.start_m[disc]), self.radius_m[disc]
            if abs(start_m - radius_m) > SNAP_SHARE * radius_m or radius_m == 0.0:
                continue
            angle_rad = math.atan2(-self.east_m[disc], -self.north_m[disc])
            for side in (1, -1):
                if abs(math.remainder(angle_rad + side * _HALF_PI - self.heading_rad, math.tau)) <= SNAP_RAD:
                    states.append(
                        _State(0.0, disc, side, angle_rad, math.tau, _NOTHING, _NO_PARENT, self.heading_rad, 0.0)
                    )
        return states

    def tangent(self, circle: int, side: int, to: int, to_side: int) -> tuple[float, float] | None:
        """Return heading (rad) and length (m) of the segment that leaves one circle and joins another; None if none."""
        north_m = self.north_m[to] - self.north_m[circle]
        east_m = self.east_m[to] - self.east_m[circle]
        across_m = to_side * self.radius_m[to] - side * self.radius_m[circle]
        gap_m2 = north_m * north_m + east_m * east_m
        along_m2 = gap_m2 - across_m * across_m
        if along_m2 <= 0.0:
            gap_m = math.sqrt(gap_m2)
            if gap_m == 0.0 or abs(across_m) > gap_m + self.tolerance_m:
                return None
            along_m2 = 0.0
        along_m = math.sqrt(along_m2)
        return math.atan2(east_m, north_m) - math.atan2(across_m, along_m), along_m


def _sweep_rad(state: _State, heading_rad: float) -> float:
    """Return how far a way goes along its circle until it heads so."""
    sweep_rad = (state.side * (heading_rad - state.angle_rad) - _HALF_PI) % math.tau
    return 0.0 if sweep_rad > math.tau - FULL_TURN_RAD else sweep_rad


class _Search:
    """A* over states on circles, from the start to the goal, with discs taken in as they are found in the way."""

    def __init__(self, scene: _Scene) -> None:
        self.scene = scene
        self.states: list[_State] = []
        self._open: list[tuple[float, float, int, int, int, float, float]] = []
        self._discs: list[int] = []
        self._known = [False] * scene.goal_node
        self._on: dict[tuple[int, int], list[_State]] = {}
        self._free: dict[tuple[int, int, int, int], bool] = {}
        for state in scene.starts():
            if scene.limited:
                free_rad, blocker = scene.free_rad(state.circle, state.side, state.angle_rad)
                state = state._replace(free_rad=free_rad, blocker=blocker)
            self._enter(state)

    def run(self, max_states: int) -> int | None:
        """Return the index of the state that stands at the goal, or None; `exhausted` says whether there is no way."""
        scene, goal_node = self.scene, self.scene.goal_node
        while self._open and len(self.states) < max_states:
            _, length_m, parent, to, side, heading_rad, segment_m = heapq.heappop(self._open)
            begin = self.states[parent]
            if _sweep_rad(begin, heading_rad) > begin.free_rad:
                self._take_in(begin.blocker)
                continue
            angle_rad = heading_rad - side * _HALF_PI
            if to != goal_node and self._dominated(to, side, angle_rad, length_m):
                continue
            if not self._segment_free(begin, to, side, heading_rad, segment_m):
                continue
            if to == goal_node:
                self.states.append(_State(length_m, to, side, angle_rad, 0.0, _NOTHING, parent, heading_rad, segment_m))
                return len(self.states) - 1
            free = scene.free_rad(to, side, angle_rad)
            self._enter(_State(length_m, to, side, angle_rad, *free, parent, heading_rad, segment_m))
        return None

    @property
    def exhausted(self) -> bool:
        """Nothing is left to try."""
        return not self._open

    def chain(self, state: int) -> list[_State]:
        """Return the states from the start to one of them."""
        chain = []
        while state != _NO_PARENT:
            chain.append(self.states[state])
            state = self.states[state].parent
        return chain[::-1]

    def _enter(self, state: _State) -> None:
        index = len(self.states)
        self.states.append(state)
        self._on.setdefault((state.circle, state.side), []).append(state)
        self._push(index, state, self.scene.goal_node, 1)
        for disc in self._discs:
            if disc != state.circle:
                self._push(index, state, disc, 1)
                self._push(index, state, disc, -1)

    def _push(self, index: int, state: _State, to: int, to_side: int) -> None:
        scene = self.scene
        tangent = scene.tangent(state.circle, state.side, to, to_side)
        if tangent is None:
            return
        heading_rad, segment_m = tangent
        sweep_rad = _sweep_rad(state, heading_rad)
        if sweep_rad > state.free_rad and self._known[state.blocker]:
            return
        length_m = state.length_m + scene.radius_m[state.circle] * sweep_rad + segment_m
        reach_m = to_side * scene.radius_m[to]
        rest_m = math.hypot(
            scene.north_m[to] + reach_m * math.sin(heading_rad) - scene.goal.real,
            scene.east_m[to] - reach_m * math.cos(heading_rad) - scene.goal.imag,
        )
        heapq.heappush(self._open, (length_m + rest_m, length_m, index, to, to_side, heading_rad, segment_m))

    def _dominated(self, circle: int, side: int, angle_rad: float, length_m: float) -> bool:
        """Whether an earlier way stands on the same circle and can go along it to here without being longer."""
        for other in self._on.get((circle, side), ()):
            sweep_rad = (side * (angle_rad - other.angle_rad)) % math.tau
            if sweep_rad > math.tau - FULL_TURN_RAD:
                sweep_rad = 0.0
            along_m = other.length_m + self.scene.radius_m[circle] * sweep_rad
            if sweep_rad <= other.free_rad and along_m <= length_m + self.scene.tolerance_m:
                return True
        return False

    def _segment_free(self, state: _State, to: int, side: int, heading_rad: float, segment_m: float) -> bool:
        key = (state.circle, state.side, to, side)
        free = self._free.get(key)
        if free is None:
            scene = self.scene
            reach_m = state.side * scene.radius_m[state.circle]
            north_m = scene.north_m[state.circle] + reach_m * math.sin(heading_rad)
            east_m = scene.east_m[state.circle] - reach_m * math.cos(heading_rad)
            blockers = scene.blockers(north_m, east_m, heading_rad, segment_m)
            free = self._free[key] = not len(blockers)
            for disc in blockers.tolist():
                self._take_in(disc)
        return free

    def _take_in(self, disc: int) -> None:
        if self._known[disc]:
            return
        self._known[disc] = True
        self._discs.append(disc)
        for index, state in enumerate(self.states):
            if state.circle != disc:
                self._push(index, state, disc, 1)
                self._push(index, state, disc, -1)


class _Shores:
    """The edges of all discs together: which of their free arcs bound the same water, and which point is nearest.

    Says in M^2 operations what a search could only say after trying everything: that there is no way.
    """

    def __init__(self, centre: np.ndarray, radius_m: np.ndarray, tolerance_m: float) -> None:
        """Trace the edges of M discs: centres (M,) complex, radii (M,), both in metres."""
        self._centre, self._radius_m = centre, radius_m
        self._entered_m = np.maximum(radius_m - tolerance_m, 0.0)
        self._arcs: list[tuple[int, float, float]] = []  # disc, begin and sweep in radians, from north towards east
        for disc in (self._entered_m > 0.0).nonzero()[0].tolist():
            covered = _covered(complex(centre[disc]), float(radius_m[disc]), centre, self._entered_m, disc)
            self._arcs.extend((disc, begin_rad, sweep_rad) for begin_rad, sweep_rad in _gaps(covered))
        self._sea = len(self._arcs)  # the face without an outer edge
        self._parent = list(range(self._sea + 1))  # a union-find over the arcs and the sea
        self._join_at_corners()
        for index, (disc, begin_rad, sweep_rad) in enumerate(self._arcs):
            if (-begin_rad) % math.tau <= sweep_rad:  # the disc's northernmost point looks north over open water
                self._join(index, self._first_north_of(self._point(disc, 0.0), disc))

    def joined(self, first: complex, second: complex) -> bool:
        """Whether two points outside all discs lie in the same water."""
        return self._face(self._first_north_of(first, None)) == self._face(self._first_north_of(second, None))

    def nearest(self, place: complex, start: complex | None) -> list[complex]:
        """Return each arc's point nearest to a place, the nearest first; with a start, only of its water."""
        face = None if start is None else self._face(self._first_north_of(start, None))
        points = []
        for index, (disc, begin_rad, sweep_rad) in enumerate(self._arcs):
            if face is not None and self._face(index) != face:
                continue
            offset = place - complex(self._centre[disc])
            beyond_rad = (math.atan2(offset.imag, offset.real) - begin_rad) % math.tau
            if beyond_rad > sweep_rad:
                beyond_rad = sweep_rad if beyond_rad - sweep_rad < math.tau - beyond_rad else 0.0
            points.append(self._point(disc, begin_rad + beyond_rad))
        return sorted(points, key=lambda point: abs(point - place))

    def _point(self, disc: int, angle_rad: float) -> complex:
        return complex(self._centre[disc]) + float(self._radius_m[disc]) * complex(
            math.cos(angle_rad), math.sin(angle_rad)
        )

    def _join_at_corners(self) -> None:
        """Join each arc with the one that begins where it ends."""
        if not self._arcs:
            return
        begin = np.array([self._point(disc, begin_rad) for disc, begin_rad, _ in self._arcs])
        end = np.array([self._point(disc, begin_rad + sweep_rad) for disc, begin_rad, sweep_rad in self._arcs])
        for index, after in enumerate(np.abs(end[:, np.newaxis] - begin).argmin(axis=1).tolist()):
            self._join(index, after)

    def _first_north_of(self, point: complex, without: int | None) -> int:
        """Return the arc that a line from a point to the north meets first, or the sea."""
        offset = self._centre - point
        half_m2 = self._entered_m**2 - offset.imag**2
        meets = (half_m2 > 0.0) & (offset.real > 0.0)
        if without is not None:
            meets[without] = False
        if not meets.any():
            return self._sea
        half_m = np.sqrt(np.maximum(half_m2, 0.0))
        disc = int(np.where(meets, offset.real - half_m, math.inf).argmin())
        angle_rad = math.atan2(-offset[disc].imag, -half_m[disc])
        best, found = math.inf, self._sea
        for index, (other, begin_rad, sweep_rad) in enumerate(self._arcs):
            if other == disc:
                beyond_rad = (angle_rad - begin_rad) % math.tau
                outside_rad = max(0.0, min(beyond_rad - sweep_rad, math.tau - beyond_rad))
                if outside_rad < best:
                    best, found = outside_rad, index
        return found

    def _face(self, index: int) -> int:
        while self._parent[index] != index:
            self._parent[index] = self._parent[self._parent[index]]
            index = self._parent[index]
        return index

    def _join(self, first: int, second: int) -> None:
        self._parent[self._face(first)] = self._face(second)


def shortest_route(
    position_ned_m: Sequence[float] | np.ndarray,
    goal_ned_m: Sequence[float] | np.ndarray,
    centres_ned_m: np.ndarray,  # (M, 2) m
    radii_m: np.ndarray,  # (M,) m
    heading_rad: float | None = None,
    turn_radius_m: float = 0.0,
) -> Route:
    """Return the shortest route from a position to a goal that enters none of M discs, planned from nothing.

    With a turn radius and a heading it begins on one of the two turning circles, and all its arcs are flyable unless
    start or goal lies nearer to a disc than that. docs/route.md says what is decided where start or goal is inside a
    disc or walled off. Raises ValueError for what is not finite or shapes that do not fit.
    """
    _check_finite(*position_ned_m, *goal_ned_m, heading_rad or 0.0, turn_radius_m)
    centres, radii_m = _checked(centres_ned_m, radii_m)
    start, goal = complex(*position_ned_m), complex(*goal_ned_m)
    return _Plan(start, goal, centres, radii_m, heading_rad, turn_radius_m).route()


class _Discs(NamedTuple):
    """Discs of a call, known again in the next one by what was given: threats that stand still are checked once."""

    given: tuple[bytes, bytes, bytes]
    ids: np.ndarray  # (M,) int
    centres: np.ndarray  # (M,) complex, m
    radii_m: np.ndarray  # (M,)


@dataclass(frozen=True)
class _Memory:
    """What a router keeps of its last plan."""

    via: tuple[tuple[int, int], ...]  # index of the disc in `discs`, and side
    reach: Reach
    goal: complex
    asked: complex  # the goal it was asked for; it is another one if that cannot be reached
    discs: _Discs
    limit_m: np.ndarray  # (M,) how far centre and radius together may change
    goal_limit_m: float

    def moved(self, asked: complex, discs: _Discs) -> bool:
        """Whether the scene differs so much from the one of the plan that another way may be the better one."""
        before = self.discs
        if discs is not before and (discs.ids.shape != before.ids.shape or np.count_nonzero(discs.ids != before.ids)):
            return True
        if abs(asked - self.asked) > self.goal_limit_m:
            return True
        if discs is before:
            return False
        change_m = np.abs(discs.centres - before.centres) + np.abs(discs.radii_m - before.radii_m)
        return bool(np.count_nonzero(change_m > self.limit_m))


class Router:
    """The route of one vehicle from step to step: the way once chosen is mended, not sought again.

    Between plans only the sides at which the discs are passed are kept and the tangents taken anew. A kept way that is
    no longer free, or a scene that has changed, is planned from nothing; a way around other sides is taken only if it
    is enough shorter, so that rounding and noise do not make the vehicle waver.
    """

    def __init__(self, switch_share: float = SWITCH_SHARE) -> None:
        """Keep a way unless another saves more than this share of its length."""
        self._switch_share = switch_share
        self._memory: _Memory | None = None
        self._discs: _Discs | None = None
        self._calls = 0

    def route(
        self,
        position_ned_m: Sequence[float] | np.ndarray,
        heading_rad: float | None,
        turn_radius_m: float,
        goal_ned_m: Sequence[float] | np.ndarray,
        centres_ned_m: np.ndarray,  # (M, 2) m
        radii_m: np.ndarray,  # (M,) m
        ids: np.ndarray,  # (M,) int
    ) -> Route:
        """Return the route from here; as `shortest_route`, but faithful to the side that was chosen before.

        `ids` name the discs from call to call. Raises ValueError as `shortest_route` does.
        """
        _check_finite(*position_ned_m, *goal_ned_m, heading_rad or 0.0, turn_radius_m)
        discs = self._discs = self._known_discs(centres_ned_m, radii_m, ids)
        start, goal = complex(*position_ned_m), complex(*goal_ned_m)
        plan = _Plan(start, goal, discs.centres, discs.radii_m, heading_rad, turn_radius_m)
        kept, moved = None, True
        memory = self._memory
        if memory is not None:
            moved = memory.moved(goal, discs)
            kept = self._kept(memory, plan, moved, discs.ids)
        self._calls += 1
        if kept is not None and not moved and self._calls < REPLAN_STEPS:
            return kept
        route = plan.route()
        if kept is not None and route.reach is kept.reach:
            if kept.length_m - route.length_m <= self._switch_share * kept.length_m:
                route = kept
        self._calls = 0
        self._memory = None
        if route.reach is not Reach.NONE:
            limit_m = discs.radii_m * (REPLAN_SHARE if route.reach is Reach.TARGET else 0.0)
            self._memory = _Memory(
                route.via,
                route.reach,
                complex(*route.goal_ned_m),
                goal,
                discs,
                limit_m,
                float(limit_m.min()) if len(limit_m) else 0.0,
            )
        return route

    def _known_discs(self, centres_ned_m: np.ndarray, radii_m: np.ndarray, ids: np.ndarray) -> _Discs:
        """Return discs as the plan takes them, the last call's if nothing about them has changed."""
        table_m, radii_m = np.asarray(centres_ned_m, dtype=float), np.asarray(radii_m, dtype=float)
        ids = np.asarray(ids)
        if ids.shape != radii_m.shape:
            raise ValueError(f"{len(radii_m)} discs, but ids of shape {ids.shape}")
        given = table_m.tobytes(), radii_m.tobytes(), ids.tobytes()
        if self._discs is not None and self._discs.given == given:
            return self._discs
        centres, radii_m = _checked(table_m, radii_m)
        # The caller may write to its arrays, of which the centres are a view.
        return _Discs(given, ids.copy(), centres.copy(), radii_m)

    @staticmethod
    def _kept(memory: _Memory, plan: _Plan, moved: bool, ids: np.ndarray) -> Route | None:
        """Return the kept way as it is now, None if it is not free or no longer leads where it should."""
        if memory.reach is not Reach.TARGET:
            if moved:
                return None
            plan = plan.to(memory.goal)
        via = memory.via
        if moved:
            index_of = {identity: index for index, identity in enumerate(ids.tolist())}
            touched = [(index_of.get(int(memory.discs.ids[index])), side) for index, side in via]
            via = tuple((index, side) for index, side in touched if index is not None)
        return plan.along(via, memory.reach)


class _Plan:
    """One question: from here to there, around these discs."""

    def __init__(
        self,
        start: complex,
        goal: complex,
        centres: np.ndarray,  # (M,) complex, m
        radii_m: np.ndarray,  # (M,) m
        heading_rad: float | None,
        turn_radius_m: float,
    ) -> None:
        self._start, self._goal, self._centres, self._radii_m = start, goal, centres, radii_m
        self._heading_rad, self._turn_radius_m = heading_rad, turn_radius_m

    def route(self) -> Route:
        """Return the route to the goal, else to the nearest point there is a way to."""
        centre, radii_m = self._centres - self._start, self._radii_m
        start_m = np.abs(centre)
        tolerance_m = _tolerance_m(start_m, radii_m, self._goal - self._start)
        holding = start_m < radii_m - tolerance_m
        # Discs that hold the start may close around it, shrunk as they are; to leave them is better than to stay.
        free = not holding.any()
        obstacles_m = [radii_m] if free else [radii_m, np.where(holding, 0.0, radii_m)]
        if not (np.abs(self._centres - self._goal) < radii_m - tolerance_m).any():
            for obstacle_m in obstacles_m:
                route = self._to(self._goal, Reach.TARGET, obstacle_m)
                if route is not None:
                    return route
        points = _Shores(centre, radii_m, tolerance_m).nearest(self._goal - self._start, 0j if free else None)
        for obstacle_m in obstacles_m:
            for point in points[:NEAREST_TRIES]:
                route = self._to(self._start + point, Reach.NEAREST, obstacle_m)
                if route is not None:
                    return route
        return Route(Reach.NONE, _pair(self._goal), math.inf, math.nan, 0, (), ())

    def to(self, goal: complex) -> _Plan:
        """Return the same question with another goal."""
        return _Plan(self._start, goal, self._centres, self._radii_m, self._heading_rad, self._turn_radius_m)

    def _to(self, goal: complex, reach: Reach, obstacle_m: np.ndarray) -> Route | None:
        """Return the shortest route that keeps the turn limit, else the shortest, else None."""
        limits_m = (self._turn_radius_m, 0.0) if self._heading_rad is not None and self._turn_radius_m > 0.0 else (0.0,)
        asked = reach is not Reach.TARGET
        for turn_radius_m in limits_m:
            scene = _Scene(self._start, goal, self._centres, obstacle_m, self._heading_rad, turn_radius_m)
            if abs(scene.goal) <= scene.tolerance_m:
                return Route(reach, _pair(goal), 0.0, (self._heading_rad or 0.0) % math.tau, 0, (), ())
            search = _Search(scene)
            found = search.run(PATIENCE)
            if found is None and not search.exhausted:
                if not asked and not _Shores(scene.centre, scene.collide_m, scene.tolerance_m).joined(0j, scene.goal):
                    return None
                asked = True
                found = search.run(MAX_STATES)
            if found is not None:
                return _as_route(scene, search.chain(found), reach, self._radii_m)
        return None

    def along(self, via: tuple[tuple[int, int], ...], reach: Reach) -> Route | None:
        """Return the route that touches these discs on these sides, the first perhaps no more; None if not free."""
        scene = _Scene(self._start, self._goal, self._centres, self._radii_m, self._heading_rad, self._turn_radius_m)
        if abs(scene.goal) <= scene.tolerance_m or (scene.goal_inside and reach is Reach.TARGET):
            return None
        for chain in _chains(scene, via)[:2]:
            if _chain_free(scene, chain):
                return _as_route(scene, chain, reach, self._radii_m)
        return None


def _chains(scene: _Scene, via: tuple[tuple[int, int], ...]) -> list[list[_State]]:
    """Return the ways over given circles, from each start, with the first of them or without; the shortest first."""
    nodes = [*via, (scene.goal_node, 1)]
    between = [scene.tangent(*first, *second) for first, second in itertools.pairwise(nodes)]
    ways = []
    for start in scene.starts():
        whole = _chain(scene, start, nodes, between)
        if whole is not None:
            ways.append(whole)
        # A first disc that would be gone around by more than half has most likely been passed.
        if via and (whole is None or _arc_rad(whole, via[0]) > math.pi):
            less = _chain(scene, start, nodes[1:], between[1:])
            if less is not None:
                ways.append(less)
    return sorted(ways, key=_length_m)


def _length_m(chain: list[_State]) -> float:
    return chain[-1].length_m


def _arc_rad(chain: list[_State], node: tuple[int, int]) -> float:
    """Return how far a way goes along a circle that is its first or second."""
    index = 0 if (chain[0].circle, chain[0].side) == node else 1
    return _sweep_rad(chain[index], chain[index + 1].heading_rad)


def _chain(
    scene: _Scene, start: _State, nodes: list[tuple[int, int]], between: list[tuple[float, float] | None]
) -> list[_State] | None:
    """Return the states of the way from a start over circles, given the tangents between these; None if one lacks."""
    if nodes[0] == (start.circle, start.side):
        nodes, legs = nodes[1:], between
    else:
        legs = [scene.tangent(start.circle, start.side, *nodes[0]), *between]
    chain = [start]
    before = start
    for (circle, side), leg in zip(nodes, legs, strict=True):
        if leg is None:
            return None
        heading_rad, segment_m = leg
        length_m = before.length_m + scene.radius_m[before.circle] * _sweep_rad(before, heading_rad) + segment_m
        angle_rad = heading_rad - side * _HALF_PI
        before = _State(length_m, circle, side, angle_rad, 0.0, _NOTHING, _NO_PARENT, heading_rad, segment_m)
        chain.append(before)
    return chain


def _chain_free(scene: _Scene, chain: list[_State]) -> bool:
    """Whether no disc is entered on a way: every segment and every arc against every disc at once."""
    if not scene.goal_node:
        return True
    base: list[complex] = []  # beginnings of segments, then centres of arcs
    ahead: list[complex] = []  # conjugate directions: of the segments, then to the middles of the arcs
    length_m: list[float] = []
    centre, middle, reach_m, cosine = [], [], [], []
    for state, after in itertools.pairwise(chain):
        place = complex(scene.north_m[state.circle], scene.east_m[state.circle])
        radius_m, heading_rad = scene.radius_m[state.circle], after.heading_rad
        base.append(place + cmath.rect(radius_m, heading_rad - state.side * _HALF_PI))
        ahead.append(cmath.rect(1.0, -heading_rad))
        length_m.append(after.segment_m)
        half_rad = 0.5 * _sweep_rad(state, heading_rad)
        if radius_m > 0.0 and half_rad > 0.0:
            centre.append(place)
            middle.append(cmath.rect(1.0, -state.angle_rad - state.side * half_rad))
            reach_m.append(radius_m)
            cosine.append(math.cos(half_rad))
    segments = len(base)
    rows = np.array([base + centre, ahead + middle])[:, :, np.newaxis]
    offset = (scene.centre - rows[0]) * rows[1]  # (segments + arcs, M)
    along_m, aside_m = offset.real[:segments], offset.imag[:segments]
    beyond_m = along_m - np.minimum(np.maximum(along_m, 0.0), np.array(length_m)[:, np.newaxis])
    if np.count_nonzero(beyond_m * beyond_m + aside_m * aside_m < scene.entered_m2):
        return False
    if not centre:
        return True
    # A disc is nearest to an arc on its own bearing, or else at an end of the arc, where a segment was looked at.
    gap_m = np.abs(offset[segments:])
    off_m = gap_m - np.array(reach_m)[:, np.newaxis]
    near = off_m * off_m < scene.entered_m2
    if not np.count_nonzero(near):
        return True
    return not np.count_nonzero(near & (offset.real[segments:] >= gap_m * np.array(cosine)[:, np.newaxis]))


def _as_route(scene: _Scene, chain: list[_State], reach: Reach, radii_m: np.ndarray) -> Route:
    """Return the route along states from the start to the goal; `radii_m`, (M,), as they were given."""
    pieces: list[Piece] = []
    via: list[tuple[int, int]] = []
    for state, after in itertools.pairwise(chain):
        radius_m, side = scene.radius_m[state.circle], state.side
        arc_m = after.length_m - state.length_m - after.segment_m
        place = complex(scene.north_m[state.circle], scene.east_m[state.circle]) + scene.start
        if state.circle < scene.goal_node:
            via.append((state.circle, side))
        if arc_m > scene.tolerance_m:
            begin = place + cmath.rect(radius_m, state.angle_rad)
            pieces.append(Piece(*_pair(begin), state.angle_rad + side * _HALF_PI, side / radius_m, arc_m))
        if after.segment_m > 0.0:
            begin = place + cmath.rect(radius_m, after.heading_rad - side * _HALF_PI)
            pieces.append(Piece(*_pair(begin), after.heading_rad, 0.0, after.segment_m))
    first, second = chain[0], chain[1]
    # Without any pieces the vehicle is at the goal, to rounding.
    turning = first.circle > scene.goal_node and bool(pieces) and pieces[0].curvature_1_m != 0.0
    if first.circle > scene.goal_node:
        heading_rad = second.heading_rad
    else:
        heading_rad = first.angle_rad + first.side * _HALF_PI
    turn = first.side if turning else 0
    if np.count_nonzero(radii_m - scene.start_m > scene.tolerance_m):
        heading_rad, turn = _outwards(scene, radii_m, heading_rad, turn)
    return Route(
        reach,
        _pair(scene.goal + scene.start),
        chain[-1].length_m,
        heading_rad % math.tau,
        turn,
        tuple(via),
        tuple(pieces),
    )


def _outwards(scene: _Scene, radii_m: np.ndarray, heading_rad: float, turn: int) -> tuple[float, int]:
    """Return the first direction turned out of the disc that the start lies deepest in, and the turn if it still holds.

    The deeper, the more directly outwards, so that a vehicle a little inside glides out along its way instead of
    zigzagging, and one deep inside leaves by the shortest way.
    """
    depth_m = radii_m - scene.start_m
    disc = int(depth_m.argmax())
    least_rad = _HALF_PI * min(1.0, float(depth_m[disc]) / (DEEP_SHARE * float(radii_m[disc])))
    outwards_rad = math.atan2(-scene.east_m[disc], -scene.north_m[disc]) if scene.start_m[disc] > 0.0 else heading_rad
    off_rad = math.remainder(heading_rad - outwards_rad, math.tau)
    if abs(off_rad) <= _HALF_PI - least_rad:
        return heading_rad, turn
    return outwards_rad + math.copysign(_HALF_PI - least_rad, off_rad), 0


def _covered(
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


def _gaps(covered: list[tuple[float, float, int]]) -> list[tuple[float, float]]:
    """Return the stretches of a circle between covered ones: where each begins and how far it sweeps, radians."""
    if not covered:
        return [(0.0, math.tau)]
    spans = sorted(((middle_rad - half_rad) % math.tau, 2.0 * half_rad) for middle_rad, half_rad, _ in covered)
    first_rad = spans[0][0]
    gaps, reached_rad = [], first_rad
    for begin_rad, width_rad in [*spans, (first_rad + math.tau, 0.0)]:
        if begin_rad > reached_rad:
            gaps.append((reached_rad, begin_rad - reached_rad))
        reached_rad = max(reached_rad, begin_rad + width_rad)
    # What reaches over north covers the beginning as well.
    over_rad = max(begin_rad + width_rad for begin_rad, width_rad in spans) - math.tau
    return [
        (max(begin_rad, over_rad), begin_rad + sweep_rad - max(begin_rad, over_rad))
        for begin_rad, sweep_rad in gaps
        if begin_rad + sweep_rad > over_rad
    ]


def _tolerance_m(start_m: np.ndarray, radii_m: np.ndarray, goal: complex) -> float:
    """Return how deep rounding may seem to cut, m: in proportion to the scene as seen from the start."""
    reach_m = start_m.item(start_m.argmax()) + radii_m.item(radii_m.argmax()) if len(radii_m) else 0.0
    return TOLERANCE * max(reach_m, abs(goal))


def _pair(place: complex) -> tuple[float, float]:
    return place.real, place.imag


def _check_finite(*numbers: float) -> None:
    """Raise ValueError for numbers of a question that are not finite."""
    # A sum is finite only if every term is; it costs a quarter of asking each one.
    if not math.isfinite(sum(numbers)):
        raise ValueError("position, goal, heading and turn radius must be finite")


def _checked(centres_ned_m: np.ndarray, radii_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # (M,) complex, (M,)
    """Return centres and radii as the plan takes them, or raise ValueError."""
    table_m = np.asarray(centres_ned_m, dtype=float).reshape(-1, 2)
    radii_m = np.asarray(radii_m, dtype=float)
    if radii_m.shape != (len(table_m),):
        raise ValueError(f"{len(table_m)} centres, but radii of shape {radii_m.shape}")
    if not math.isfinite(np.add.reduce(table_m, None) + np.add.reduce(radii_m)):
        raise ValueError("centres and radii must be finite")
    return np.ascontiguousarray(table_m).view(complex)[:, 0], np.maximum(radii_m, 0.0)
