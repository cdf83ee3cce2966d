"""The shortest route around discs, planned on board: D_geo and its first direction (docs/method.md section 3).

A shortest path consists of arcs on discs and of segments that touch two of them, so it is a path in the graph of
tangents. The search builds that graph only where it must: it begins with the straight line and adds a disc when it is
found in the way. If the shortest path around some of the discs is free of all of them, it is the shortest of all. A
vehicle that cannot turn on the spot begins on one of its two turning circles, which are nodes like the discs.

Headings grow clockwise. A disc that is kept on the right is passed clockwise: side +1, like a turn to the right.
"""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from companion.guard.types import Piece
from companion.guidance.route.reachability import Shores
from companion.guidance.route.scene import HALF_PI, Scene, State, tolerance_m_of
from companion.guidance.route.search import Search, chain_free, chains

SWITCH_SHARE = 0.02
"""Share of the kept route's length that a new route on other sides of discs must save (docs/method.md section 3)."""
DEEP_SHARE = 0.05
"""Depth inside a disc, as a share of its radius, from which a vehicle heads straight out of it, and below it partly."""
PATIENCE = 48
"""Number of states after which the search checks whether there is a way at all; that costs as much as 20 states."""
MAX_STATES = 1500
"""Number of states after which the search for a path within the turn limit gives up; 100 discs take fewer than 300."""
NEAREST_TRIES = 8
"""Number of points nearest to the goal that are tried where it is not known which of them can be reached."""
REPLAN_STEPS = 10
"""Number of calls within which a kept route is compared with a new one at least once."""
REPLAN_SHARE = 0.05
"""Share of a disc's radius: when the disc's centre and radius together have changed by more, or the goal by more than
this share of the least radius, a kept route is compared with a new one."""


class Reach(Enum):
    """What a route leads to."""

    TARGET = "target"
    NEAREST = "nearest safe point"
    NONE = "no way"


class Route(NamedTuple):
    """A route around the discs: where it leads, its length, its first direction and its pieces."""

    reach: Reach
    goal_ned_m: tuple[float, float]
    """The target, or the safe point nearest to it."""
    length_m: float
    """D_geo, the length to `goal_ned_m`; infinite without a way."""
    heading_rad: float
    """The first direction, in [0, 2 pi); NaN without a way."""
    turn: int
    """+1 or -1 if the route begins with an arc of the vehicle's own turning circle, to the right or left, that ends on
    `heading_rad`; else 0."""
    via: tuple[tuple[int, int], ...]
    """The discs touched, in order: index in the given arrays, and side (+1: clockwise, with the disc on the right)."""
    pieces: tuple[Piece, ...]
    """The lines and arcs of the route, in order."""


class Departure(NamedTuple):
    """The position that a route begins at, and how the vehicle can turn there."""

    position_ned_m: Sequence[float] | np.ndarray
    heading_rad: float | None = None
    """The vehicle's heading; None if it may leave in any direction."""
    turn_radius_m: float = 0.0
    """The vehicle's turn radius; 0 if it can turn on the spot."""


def shortest_route(
    position_ned_m: Sequence[float] | np.ndarray,
    goal_ned_m: Sequence[float] | np.ndarray,
    centres_ned_m: np.ndarray,  # (M, 2) m
    radii_m: np.ndarray,  # (M,) m
    heading_rad: float | None = None,
    turn_radius_m: float = 0.0,
) -> Route:
    """Return the shortest route from a position to a goal that enters none of M discs, without an earlier route.

    With a turn radius and a heading the route begins on one of the two turning circles, and all its arcs are flyable
    unless start or goal is too near to a disc for that. docs/route.md says what is returned where start or goal is
    inside a disc or walled off. Raises ValueError for input that is not finite and for shapes that do not fit.
    """
    _check_finite(*position_ned_m, *goal_ned_m, heading_rad or 0.0, turn_radius_m)
    centres, radii_m = _checked(centres_ned_m, radii_m)
    start, goal = complex(*position_ned_m), complex(*goal_ned_m)
    return _Plan(start, goal, centres, radii_m, heading_rad, turn_radius_m).route()


class _Discs(NamedTuple):
    """The checked discs of a call; the next call reuses them if its input is the same, as with standing threats."""

    given: tuple[bytes, bytes, bytes]
    ids: np.ndarray  # (M,) int
    centres: np.ndarray  # (M,) complex, m
    radii_m: np.ndarray  # (M,)


@dataclass(frozen=True)
class _Memory:
    """What a router stores of its last plan."""

    via: tuple[tuple[int, int], ...]  # index of the disc in `discs`, and side
    reach: Reach
    goal: complex
    asked: complex  # the goal that was asked for, which `goal` differs from where it cannot be reached
    discs: _Discs
    limit_m: np.ndarray  # (M,) how far centre and radius together may change before `moved`
    goal_limit_m: float  # how far the goal asked for may change before `moved`

    def moved(self, asked: complex, discs: _Discs) -> bool:
        """Return whether the scene has changed by more than the limits, so that another route may be better."""
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
    """Plans the route of one vehicle step by step, adapting the route chosen before where it can.

    Between plans it keeps only on which side each disc is passed, and computes the tangents anew. If the kept route is
    no longer free, or the scene has changed, a new one is planned. A route on other sides replaces the kept one only if
    it saves enough, so that rounding and noise do not make the vehicle waver.
    """

    def __init__(self, switch_share: float = SWITCH_SHARE) -> None:
        """Keep a route unless another one saves more than `switch_share` of its length."""
        self._switch_share = switch_share
        self._memory: _Memory | None = None
        self._discs: _Discs | None = None
        self._calls = 0

    def route(
        self,
        departure: Departure,
        goal_ned_m: Sequence[float] | np.ndarray,
        centres_ned_m: np.ndarray,  # (M, 2) m
        radii_m: np.ndarray,  # (M,) m
        ids: np.ndarray,  # (M,) int
    ) -> Route:
        """Return the route as `shortest_route` does, but preferring the sides of the discs that were chosen before.

        `ids` identify the discs from call to call. Raises ValueError as `shortest_route` does.
        """
        position_ned_m, heading_rad, turn_radius_m = departure
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
        """Return the checked discs, those of the last call if the input has not changed."""
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
        """Return the kept route from the present position, None if it is not free or no longer leads to the goal."""
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
    """The planning of one route: from a start to a goal around given discs."""

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
        """Return the route to the goal, or else to the reachable point nearest to it."""
        centre, radii_m = self._centres - self._start, self._radii_m
        start_m = np.abs(centre)
        tolerance_m = tolerance_m_of(start_m, radii_m, self._goal - self._start)
        holding = start_m < radii_m - tolerance_m
        # Discs around the start may enclose it even when shrunk; then they are left out, so that it can leave.
        free = not holding.any()
        obstacles_m = [radii_m] if free else [radii_m, np.where(holding, 0.0, radii_m)]
        if not (np.abs(self._centres - self._goal) < radii_m - tolerance_m).any():
            for obstacle_m in obstacles_m:
                route = self._to(self._goal, Reach.TARGET, obstacle_m)
                if route is not None:
                    return route
        points = Shores(centre, radii_m, tolerance_m).nearest(self._goal - self._start, 0j if free else None)
        for obstacle_m in obstacles_m:
            for point in points[:NEAREST_TRIES]:
                route = self._to(self._start + point, Reach.NEAREST, obstacle_m)
                if route is not None:
                    return route
        return Route(Reach.NONE, _pair(self._goal), math.inf, math.nan, 0, (), ())

    def to(self, goal: complex) -> _Plan:
        """Return the same planning problem with another goal."""
        return _Plan(self._start, goal, self._centres, self._radii_m, self._heading_rad, self._turn_radius_m)

    def _to(self, goal: complex, reach: Reach, obstacle_m: np.ndarray) -> Route | None:
        """Return the shortest route within the turn limit, or else the shortest without it; None if there is no way."""
        limits_m = (self._turn_radius_m, 0.0) if self._heading_rad is not None and self._turn_radius_m > 0.0 else (0.0,)
        asked = reach is not Reach.TARGET
        for turn_radius_m in limits_m:
            scene = Scene(self._start, goal, self._centres, obstacle_m, self._heading_rad, turn_radius_m)
            if abs(scene.goal) <= scene.tolerance_m:
                return Route(reach, _pair(goal), 0.0, (self._heading_rad or 0.0) % math.tau, 0, (), ())
            search = Search(scene)
            found = search.run(PATIENCE)
            if found is None and not search.exhausted:
                if not asked and not Shores(scene.centre, scene.collide_m, scene.tolerance_m).joined(0j, scene.goal):
                    return None
                asked = True
                found = search.run(MAX_STATES)
            if found is not None:
                return _as_route(scene, search.chain(found), reach, self._radii_m)
        return None

    def along(self, via: tuple[tuple[int, int], ...], reach: Reach) -> Route | None:
        """Return the route along (disc, side) pairs, with the first disc or without it; None if it is not free."""
        scene = Scene(self._start, self._goal, self._centres, self._radii_m, self._heading_rad, self._turn_radius_m)
        if abs(scene.goal) <= scene.tolerance_m or (scene.goal_inside and reach is Reach.TARGET):
            return None
        for chain in chains(scene, via)[:2]:
            if chain_free(scene, chain):
                return _as_route(scene, chain, reach, self._radii_m)
        return None


def _as_route(scene: Scene, chain: list[State], reach: Reach, radii_m: np.ndarray) -> Route:
    """Return the route along states from the start to the goal; `radii_m`, (M,), are the radii before shrinking."""
    circles, start = scene.circles, scene.departure.place
    pieces: list[Piece] = []
    via: list[tuple[int, int]] = []
    for state, after in itertools.pairwise(chain):
        radius_m, side = circles.radius_m[state.circle], state.side
        arc_m = after.length_m - state.length_m - after.segment_m
        place = complex(circles.north_m[state.circle], circles.east_m[state.circle]) + start
        if state.circle < circles.goal_node:
            via.append((state.circle, side))
        if arc_m > scene.tolerance_m:
            begin = place + cmath.rect(radius_m, state.angle_rad)
            pieces.append(Piece(*_pair(begin), state.angle_rad + side * HALF_PI, side / radius_m, arc_m))
        if after.segment_m > 0.0:
            begin = place + cmath.rect(radius_m, after.heading_rad - side * HALF_PI)
            pieces.append(Piece(*_pair(begin), after.heading_rad, 0.0, after.segment_m))
    first, second = chain[0], chain[1]
    # Without any pieces the vehicle is at the goal, to rounding.
    turning = first.circle > circles.goal_node and bool(pieces) and pieces[0].curvature_1_m != 0.0
    if first.circle > circles.goal_node:
        heading_rad = second.heading_rad
    else:
        heading_rad = first.angle_rad + first.side * HALF_PI
    turn = first.side if turning else 0
    if np.count_nonzero(radii_m - scene.start_m > scene.tolerance_m):
        heading_rad, turn = _outwards(scene, radii_m, heading_rad, turn)
    return Route(
        reach,
        _pair(scene.goal + start),
        chain[-1].length_m,
        heading_rad % math.tau,
        turn,
        tuple(via),
        tuple(pieces),
    )


def _outwards(scene: Scene, radii_m: np.ndarray, heading_rad: float, turn: int) -> tuple[float, int]:
    """Return the first direction, turned out of the disc that the start is deepest inside, and the turn (0 if changed).

    The deeper the start is inside, the more directly the direction leads outwards: a vehicle slightly inside leaves
    gradually along its route instead of zigzagging, and one deep inside leaves by the shortest way.
    """
    depth_m = radii_m - scene.start_m
    disc = int(depth_m.argmax())
    least_rad = HALF_PI * min(1.0, float(depth_m[disc]) / (DEEP_SHARE * float(radii_m[disc])))
    outwards_rad = (
        math.atan2(-scene.circles.east_m[disc], -scene.circles.north_m[disc])
        if scene.start_m[disc] > 0.0
        else heading_rad
    )
    off_rad = math.remainder(heading_rad - outwards_rad, math.tau)
    if abs(off_rad) <= HALF_PI - least_rad:
        return heading_rad, turn
    return outwards_rad + math.copysign(HALF_PI - least_rad, off_rad), 0


def _pair(place: complex) -> tuple[float, float]:
    return place.real, place.imag


def _check_finite(*numbers: float) -> None:
    """Raise ValueError if any of the numbers is not finite."""
    # A sum is finite only if every term is; it costs a quarter of asking each one.
    if not math.isfinite(sum(numbers)):
        raise ValueError("position, goal, heading and turn radius must be finite")


def _checked(centres_ned_m: np.ndarray, radii_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # (M,) complex, (M,)
    """Return centres as complex numbers and radii of at least 0, or raise ValueError for unusable input."""
    table_m = np.asarray(centres_ned_m, dtype=float).reshape(-1, 2)
    radii_m = np.asarray(radii_m, dtype=float)
    if radii_m.shape != (len(table_m),):
        raise ValueError(f"{len(table_m)} centres, but radii of shape {radii_m.shape}")
    if not math.isfinite(np.add.reduce(table_m, None) + np.add.reduce(radii_m)):
        raise ValueError("centres and radii must be finite")
    return np.ascontiguousarray(table_m).view(complex)[:, 0], np.maximum(radii_m, 0.0)
