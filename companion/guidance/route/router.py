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
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from companion.guard.types import Piece
from companion.guidance.route.plan import Plan, Way
from companion.guidance.route.scene import HALF_PI, Aim, Pose, Scene, State
from companion.guidance.route.search import Effort
from companion.guidance.route.walls import NO_WALLS, Walls, WallSet

SWITCH_SHARE = 0.02
"""Share of the kept route's length that a new route on other sides of discs must save (docs/method.md section 3)."""
BASE_WORK_US = 7000.0
"""Work of one call of a router until it pauses, in nominal microseconds, without any discs."""
DISC_WORK_US = 100.0
"""The same for each disc and each corner of a wall."""
REPLAN_STEPS = 10
"""Number of calls within which a kept route is compared with a new one at least once while anything changes."""
REPLAN_SHARE = 0.05
"""Share of a disc's radius: when the disc's centre and radius together have changed by more, or the goal by more than
this share of the least radius, a kept route is compared with a new one."""

MOST_TRACKS = 4
"""Number of questions that a router may be asked in turn."""
CHANGED_LEGS = 5
"""Number of lines at the beginning of a kept route that are checked again if only the vehicle has moved."""


class Reach(Enum):
    """What a route leads to."""

    TARGET = "target"
    NEAREST = "nearest safe point"
    NONE = "no way"
    PLANNING = "way still being planned"


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
    """The discs touched, in order: index in the given arrays, and side (+1: clockwise, with the disc on the right).

    Greater indices are corners of walls: those of the fence, then those of the exclusions.
    """
    pieces: tuple[Piece, ...]
    """The lines and arcs of the route, in order."""
    end_side: int = 0
    """+1 or -1 if the route ends on the goal's circle, to be flown clockwise or counterclockwise; else 0."""


class Goal(NamedTuple):
    """What a route leads to: a place, or with a radius a circle about it, on which the route ends along the circle."""

    position_ned_m: Sequence[float] | np.ndarray
    radius_m: float = 0.0


class Departure(NamedTuple):
    """The position that a route begins at, and how the vehicle can turn there."""

    position_ned_m: Sequence[float] | np.ndarray
    heading_rad: float | None = None
    """The vehicle's heading; None if it may leave in any direction."""
    turn_radius_m: float = 0.0
    """The vehicle's turn radius; 0 if it can turn on the spot."""


def shortest_route(
    position_ned_m: Sequence[float] | np.ndarray,
    goal: Goal | Sequence[float] | np.ndarray,
    centres_ned_m: np.ndarray,  # (M, 2) m
    radii_m: np.ndarray,  # (M,) m
    heading_rad: float | None = None,
    turn_radius_m: float = 0.0,
    walls: Walls = NO_WALLS,
) -> Route:
    """Return the shortest route from a position to a goal that enters none of M discs, without an earlier route.

    With a turn radius and a heading the route begins on one of the two turning circles, and all its arcs are flyable
    unless start or goal is too near to a disc or a wall for that. docs/route.md says what is returned where start or
    goal is inside a disc, on the wrong side of a wall or walled off. Raises ValueError for input that is not finite and
    for shapes that do not fit.
    """
    aim = _aim(goal)
    pose = _pose(Departure(position_ned_m, heading_rad, turn_radius_m))
    plan = Plan(pose, aim, *_checked(centres_ned_m, radii_m), WallSet(walls) if walls != NO_WALLS else None)
    work = plan.way(Effort())
    while True:
        try:
            next(work)
        except StopIteration as stop:
            return _as_route(plan, stop.value)


class _Discs(NamedTuple):
    """The checked discs of a call; the next call reuses them if its input is the same, as with standing threats."""

    given: tuple[bytes, bytes, bytes]
    ids: np.ndarray  # (M,) int
    centres: np.ndarray  # (M,) complex, m
    radii_m: np.ndarray  # (M,)

    def changed(self, before: _Discs, share: float) -> bool:
        """Return whether these are other discs, or one has changed by more than a share of its radius."""
        if self is before:
            return False
        if self.ids.shape != before.ids.shape or np.count_nonzero(self.ids != before.ids):
            return True
        change_m = np.abs(self.centres - before.centres) + np.abs(self.radii_m - before.radii_m)
        return bool(np.count_nonzero(change_m > share * before.radii_m))


class _Question(NamedTuple):
    """What a plan answers: which goal, among which discs and walls."""

    goal: Aim
    discs: _Discs
    walls: WallSet | None


def _differ(question: _Question, before: _Question, share: float) -> bool:
    """Return whether two questions differ so much that another route may be better: by a share of the discs' radii."""
    radii_m = before.discs.radii_m
    limit_m = share * float(radii_m.min()) if len(radii_m) else 0.0
    return (
        question.walls is not before.walls
        or question.goal.radius_m != before.goal.radius_m
        or abs(question.goal.place - before.goal.place) > limit_m
        or question.discs.changed(before.discs, share)
    )


@dataclass
class _Memory:
    """What a router stores of its last plan, and of the calls since."""

    question: _Question
    way: Way | None
    discs: _Discs  # that the indices of the way mean
    planned_m: float  # length of the way when it was planned
    place: complex  # of the vehicle at the last call
    flown_m: float = 0.0  # since the plan
    calls: int = 0  # since the plan

    def step(self, place: complex) -> None:
        """Count a call, with the vehicle at a place."""
        self.flown_m += abs(place - self.place)
        self.place = place
        self.calls += 1

    def along(self, plan: Plan, question: _Question, effort: Effort) -> Way | None:
        """Return the stored way from the present pose, None if it is not free or no longer leads to the goal."""
        way, before = self.way, self.question
        if way is None or question.walls is not before.walls:
            return None
        if not way.to_target and _differ(question, before, 0.0):
            return None
        via, touch = way.via, way.touch
        if self.discs is not question.discs:
            old, new = self.discs.ids.tolist(), question.discs.ids.tolist()
            index_of = {identity: index for index, identity in enumerate(new)}
            now = {
                index: index_of.get(old[index]) if index < len(old) else index - len(old) + len(new) for index, _ in via
            }
            via = tuple((index, side) for was, side in via if (index := now[was]) is not None)
            touch = {index: towards for disc, towards in touch.items() if (index := now.get(disc)) is not None}
        standing = question.discs is self.discs and question.goal == before.goal
        found = plan.along(way, via, touch, CHANGED_LEGS if standing else None)
        if found is None and via:
            found = plan.rejoining(way, via, touch, effort)
        if found is not None:
            self.way, self.discs = found, question.discs
        return found

    def is_due(self, kept: Way, plan: Plan, question: _Question, switch_share: float) -> bool:
        """Return whether the stored way must be compared with a new one.

        If nothing has changed, no way can be shorter than the planned one less what was flown since.
        """
        if _differ(question, self.question, REPLAN_SHARE):
            return True
        changes = question.discs is not self.question.discs or question.goal != self.question.goal
        if self.calls >= REPLAN_STEPS and (changes or plan.pose.limited != kept.scene.pose.limited):
            return True
        return self.flown_m + kept.length_m - self.planned_m > switch_share * kept.length_m


@dataclass(frozen=True)
class _Pending:
    """A plan that is being made: its question, the plan, its work, and what effort it has left in this call."""

    question: _Question
    plan: Plan
    work: Generator[None, None, Way | None]
    effort: Effort


@dataclass
class _Track:
    """One of the questions that a router is asked in turn, as it was asked last, and what is stored for it."""

    question: _Question
    memory: _Memory | None = None
    pending: _Pending | None = None


class Router:
    """Plans the route of one vehicle step by step, adapting the route chosen before where it can.

    Between plans it keeps only on which side each disc is passed, and computes the tangents anew. If the kept route is
    no longer free, has been left, or the scene has changed, a new one is planned, over several calls if it must. A
    route on other sides replaces the kept one only if it saves enough, so that rounding and noise do not make the
    vehicle waver. A few questions may be asked in turn; each is answered by its own route.
    """

    def __init__(self, switch_share: float = SWITCH_SHARE) -> None:
        """Keep a route unless another one saves more than `switch_share` of its length."""
        self._switch_share = switch_share
        self._tracks: list[_Track] = []  # the last one asked for first

    def route(
        self,
        departure: Departure,
        goal: Goal | Sequence[float] | np.ndarray,
        centres_ned_m: np.ndarray,  # (M, 2) m
        radii_m: np.ndarray,  # (M,) m
        ids: np.ndarray,  # (M,) int
        walls: Walls = NO_WALLS,
    ) -> Route:
        """Return the route as `shortest_route` does, but preferring the sides of the discs that were chosen before.

        `ids` identify the discs from call to call. A plan that takes more work than one call may do is continued at the
        next ones; until it is made the kept route is returned while it is free, else one that leads nowhere
        (`Reach.PLANNING`). Raises ValueError as `shortest_route` does.
        """
        pose, aim = _pose(departure), _aim(goal)
        question = _Question(aim, self._known_discs(centres_ned_m, radii_m, ids), self._known_walls(walls))
        track = self._track(question)
        plan = Plan(pose, aim, question.discs.centres, question.discs.radii_m, question.walls)
        kept = None
        effort = Effort(BASE_WORK_US + DISC_WORK_US * len(plan.obstacles.centre))
        memory = track.memory
        if memory is not None:
            memory.step(pose.place)
            if memory.way is None and memory.calls < REPLAN_STEPS and not _differ(question, memory.question, 0.0):
                return _as_route(plan, None)
            kept = memory.along(plan, question, effort)
            if kept is not None and not memory.is_due(kept, plan, question, self._switch_share):
                track.pending = None
                return _as_route(plan, kept)
        done, way = _planned(track, plan, effort.left_us)
        if not done:
            if kept is not None:
                return _as_route(plan, kept)
            return Route(Reach.PLANNING, _pair(aim.place), math.inf, math.nan, 0, (), ())
        if kept is not None and way is not None and way.to_target is kept.to_target:
            if kept.length_m - way.length_m <= self._switch_share * kept.length_m:
                way = kept
        track.memory = _Memory(question, way, question.discs, 0.0 if way is None else way.length_m, pose.place)
        return _as_route(plan, way)

    def _track(self, question: _Question) -> _Track:
        """Return the track of a question that hardly differs, or a new one that knows the last way of the last one."""
        for index, track in enumerate(self._tracks):
            if not _differ(question, track.question, REPLAN_SHARE):
                del self._tracks[index]
                track.question = question
                break
        else:
            before = self._tracks[0].memory if self._tracks else None
            track = _Track(question, None if before is None else replace(before))
        self._tracks = [track, *self._tracks[: MOST_TRACKS - 1]]
        return track

    def _known_walls(self, walls: Walls) -> WallSet | None:
        """Return the walls prepared, those of an earlier call if they are the same; None if there are none."""
        if walls == NO_WALLS:
            return None
        for track in self._tracks:
            known = track.question.walls
            if known is not None and known.given == walls:
                return known
        return WallSet(walls)

    def _known_discs(self, centres_ned_m: np.ndarray, radii_m: np.ndarray, ids: np.ndarray) -> _Discs:
        """Return the checked discs, those of an earlier call if the input is the same."""
        table_m, radii_m = np.asarray(centres_ned_m, dtype=float), np.asarray(radii_m, dtype=float)
        ids = np.asarray(ids)
        if ids.shape != radii_m.shape:
            raise ValueError(f"{len(radii_m)} discs, but ids of shape {ids.shape}")
        given = table_m.tobytes(), radii_m.tobytes(), ids.tobytes()
        for track in self._tracks:
            if track.question.discs.given == given:
                return track.question.discs
        centres, radii_m = _checked(table_m, radii_m)
        # The caller may write to its arrays, of which the centres are a view.
        return _Discs(given, ids.copy(), centres.copy(), radii_m)


def _planned(track: _Track, plan: Plan, left_us: float) -> tuple[bool, Way | None]:
    """Return whether a plan is made, and its way (None: there is none); makes as much of it as one call may.

    A plan that was begun at an earlier call is the answer if its way is free from where the vehicle is now.
    """
    question, pending = track.question, track.pending
    while left_us > 0.0:
        if pending is None or _differ(question, pending.question, REPLAN_SHARE):
            effort = Effort()
            pending = _Pending(question, plan, plan.way(effort), effort)
        pending.effort.left_us = left_us
        track.pending = pending
        try:
            next(pending.work)
        except StopIteration as stop:
            track.pending = None
            way: Way | None = stop.value
            if pending.plan is plan or way is None:
                return True, way
            memory = _Memory(pending.question, way, pending.question.discs, 0.0, plan.pose.place)
            again = memory.along(plan, question, pending.effort)
            if again is not None:
                return True, again
            left_us, pending = pending.effort.left_us, None
        else:
            return False, None
    return False, None


def _as_route(plan: Plan, way: Way | None) -> Route:
    """Return the route of a plan along a way; None means that there is no way."""
    start = plan.pose.place
    if way is None:
        return Route(Reach.NONE, _pair(plan.goal.place), math.inf, math.nan, 0, (), ())
    reach = Reach.TARGET if way.to_target else Reach.NEAREST
    scene, chain = way.scene, way.chain
    goal_ned_m = _pair(plan.goal.place if way.to_target else scene.goal + start)
    if not chain:
        return Route(reach, goal_ned_m, 0.0, plan.pose.heading_rad % math.tau, 0, (), ())
    pieces = _pieces(scene, chain)
    first, second = chain[0], chain[1]
    # Without any pieces the vehicle is at the goal, to rounding.
    turning = first.circle > scene.circles.goal_node and bool(pieces) and pieces[0].curvature_1_m != 0.0
    if first.circle > scene.circles.goal_node:
        heading_rad = second.heading_rad
    else:
        heading_rad = first.angle_rad + first.side * HALF_PI
    turn = first.side if turning else 0
    heading_rad, turn = _outwards(plan, heading_rad, turn)
    return Route(reach, goal_ned_m, way.length_m, heading_rad % math.tau, turn, way.via, tuple(pieces), way.end_side)


def _pieces(scene: Scene, chain: list[State]) -> list[Piece]:
    """Return the arcs and lines along states from the start to the goal."""
    circles, start = scene.circles, scene.pose.place
    pieces: list[Piece] = []
    for state, after in itertools.pairwise(chain):
        radius_m, side = circles.radius_m[state.circle], state.side
        arc_m = after.length_m - state.length_m - after.segment_m
        place = complex(circles.north_m[state.circle], circles.east_m[state.circle]) + start
        if arc_m > scene.tolerance_m:
            begin = place + cmath.rect(radius_m, state.angle_rad)
            pieces.append(Piece(*_pair(begin), state.angle_rad + side * HALF_PI, side / radius_m, arc_m))
        if after.segment_m > 0.0:
            begin = place + cmath.rect(radius_m, after.heading_rad - side * HALF_PI)
            pieces.append(Piece(*_pair(begin), after.heading_rad, 0.0, after.segment_m))
    return pieces


def _outwards(plan: Plan, heading_rad: float, turn: int) -> tuple[float, int]:
    """Return the first direction, turned out of what the start is deepest inside, and the turn (0 if changed).

    The deeper the start is inside, the more directly the direction leads outwards: a vehicle slightly inside leaves
    gradually along its route instead of zigzagging, and one deep inside leaves by the shortest way.
    """
    found = plan.way_out()
    if found is None:
        return heading_rad, turn
    deep, direction = found
    least_rad = HALF_PI * min(1.0, deep)
    outwards_rad = cmath.phase(direction) if direction else heading_rad
    off_rad = math.remainder(heading_rad - outwards_rad, math.tau)
    if abs(off_rad) <= HALF_PI - least_rad:
        return heading_rad, turn
    return outwards_rad + math.copysign(HALF_PI - least_rad, off_rad), 0


def _pair(place: complex) -> tuple[float, float]:
    return place.real, place.imag


def _aim(goal: Goal | Sequence[float] | np.ndarray) -> Aim:
    position_ned_m, radius_m = goal if isinstance(goal, Goal) else (goal, 0.0)
    _check_finite(*position_ned_m, radius_m)
    return Aim(complex(*position_ned_m), float(max(radius_m, 0.0)))


def _pose(departure: Departure) -> Pose:
    position_ned_m, heading_rad, turn_radius_m = departure
    _check_finite(*position_ned_m, heading_rad or 0.0, turn_radius_m)
    limited = heading_rad is not None and turn_radius_m > 0.0
    return Pose(complex(*position_ned_m), float(heading_rad or 0.0), float(turn_radius_m) if limited else 0.0)


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
