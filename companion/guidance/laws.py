"""The guidance laws: from a vehicle's task and world model to a wanted heading (docs/method.md sections 1 and 3).

A law returns a steering demand. Right of way, turn limit and guard are applied to the demand of every law.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from companion.geo.kinematics import turn_rate_rad_s
from companion.guard.types import Motion, Piece
from companion.guidance.course import at, course_rad, following_m, held_m, left_of, nearest
from companion.guidance.progress import Closed, Progress, after_closing, is_same, patience_s, watched
from companion.guidance.route.router import Departure, Goal, Reach, Route, Router
from companion.guidance.route.walls import NO_WALLS, Walls
from companion.guidance.settings import LawSettings
from companion.guidance.steering import MonolithicSurrogate, PairSurrogate, SteeringVector, Surrogate, direction
from companion.guidance.turning_place import Room, TurningPlace, is_clear, is_open, turning_place
from companion.guidance.view import View
from companion.surrogate.networks import load_monolithic
from companion.surrogate.profiles import (
    HALF_WIDTH,
    PolygonProfile,
    RadialProfile,
    StepProfile,
    ThreatDiscs,
    profile_by_name,
    range_gradient,
    wall_gradient,
)

LEAST_CLEARANCE_M = 0.05
"""Distance that the route keeps from the discs as the guard inflates them, in addition to what following it in steps
costs: for rounding."""
FOLLOWING_SHARES = (1.0, 0.4)
"""Shares of what following may cost that the route keeps from discs and walls, the first that leaves a way. On arcs of
one radius the vehicle cuts in by 0.28 of it; the rest is for changes from arc to arc."""
GREATEST_STEP_TURN_RAD = 1.0
"""Greatest turn of one guidance step along a circle to arrive on."""
CIRCLE_SLACK = 1.05
"""Radius of a circle to arrive on, in turn radii, so that a vehicle a little outside it can turn back onto it."""
FOLLOWED_STEPS = 4.0
"""Number of guidance steps ahead on the route within which the vehicle is looked for."""
OFF_ROUTE_M = 0.5
"""Distance beside the route beyond what following it costs, up to which it is followed instead of planned anew."""
OFF_ROUTE_RAD = 0.5 * math.pi
"""Difference of headings up to which a route is followed."""
TIGHTEST_SHARE = 0.999
"""Share of the least turn radius from which an arc counts as the tightest."""
LONGEST_TURN_RAD = 3.0
"""Greatest turn whose end is demanded at once: less than pi, so that the turn goes by its own side."""
SAID_SHARE = 1.0 / 3.0
"""Share of the patience after which it is said that the vehicle comes no nearer."""
PLANNING_STEPS = 10.0
"""Number of guidance steps for which a vehicle without a route makes straight for its place while one is planned."""
STAYING_RADII = 20.0
"""Distance from the nearest safe point, in radii of the circle to arrive on, up to which the vehicle stays there: among
discs the guard may lead it far around before it is back."""
STANDING_M = 1.0
"""Distance from the nearest safe point within which a vehicle that can stop stays."""
WALL_SHARE = 22.0
"""Ratio of the route's clearance to the half-width of F*'s edge: at this one the repulsion at the route is weaker than
any attraction."""
NEAREST_NOTE = "target out of reach: to the nearest safe point"
OPPOSED_SHARE = 0.01
"""Share of the attraction from which a dropped surrogate component against the route is reported."""
COASTING_PERIODS = 3.0
"""Number of broadcast periods in `LawSettings.coasting_after_s`; the law derives the broadcast period from it."""
LOOK_AHEAD_S = 30.0
"""Time for which a threat is assumed to keep its broadcast velocity; after it only its speed bound is used."""


@dataclass(frozen=True)
class Task:
    """The vehicle's task at one step: to fly to a place, or to loiter at it."""

    place_ned_m: tuple[float, float]
    pull: SteeringVector
    """The attraction towards the place, or onto its loiter circle, without regard to discs."""
    loitering: bool
    to_target: bool
    """Whether the place is the target that the vehicle is assigned."""
    flown_m: float
    """Distance flown so far, for the penalty of the range."""
    arrival_m: float
    """Distance from the place at which the vehicle has arrived."""
    crowded: bool = False
    """Whether others are so near that the right of way may demand a circle to the right at any time."""
    refused: bool = False
    """Whether the guard refused the last step, or let the vehicle only continue its back-up."""


class SteeringDemand(NamedTuple):
    """The direction that a law demands, and what it reports with it."""

    pull: SteeringVector
    """The demanded direction; its length is that of the law's gradient."""
    stay: str | None = None
    """The reason to loiter here, where the law has no better place to go; else None."""
    note: str | None = None
    """A remark on the decision for logs and messages."""
    opposed: bool = False
    """Whether a component of the surrogate's gradient that opposed the route was dropped."""
    route: Route | None = None


class SteeringLaw(Protocol):
    """A guidance law of one vehicle; it may store state, but reads no clock and no inputs other than its arguments."""

    def steer(self, task: Task, motion: Motion, view: View, now_s: float) -> SteeringDemand:
        """Return the steering demand of one guidance step; `now_s` is the time of this vehicle's clock."""
        ...


SteeringOf = Callable[[LawSettings], SteeringLaw]
"""A function that makes the law of one vehicle from its settings."""


class GradientLaw:
    """The paper's law: the attraction minus the gradient of the surrogate (paper: direct1)."""

    def __init__(self, settings: LawSettings) -> None:
        self._settings = settings
        self._surrogate = _surrogate(settings)

    def steer(self, task: Task, motion: Motion, view: View, now_s: float) -> SteeringDemand:
        """Return the attraction minus the gradient of the surrogate at the vehicle's position."""
        gradient_m = self._surrogate.gradient_m(motion.position_ned_m, view)
        if task.to_target and self._settings.law == "seed":
            gradient_m = gradient_m + _range_gradient(task, motion, self._settings)
        return SteeringDemand(direction(task.pull, gradient_m))


class _Asked(NamedTuple):
    """The question that a planned route answers; equal for the same place among the same standing discs."""

    place_ned_m: tuple[float, float]
    centres: bytes
    radii: bytes
    ids: bytes
    crowded: bool
    closed: tuple[Closed, ...]


class _Obstacles(NamedTuple):
    """The discs that a route is planned around: threats, and what closes passages, whose ids are negative."""

    centres_ned_m: np.ndarray  # (M, 2) m
    radii_m: np.ndarray  # (M,) m
    ids: np.ndarray  # (M,) int


class _Planned(NamedTuple):
    """A route to follow: what it answers, and its pieces from where the vehicle was at the last step."""

    asked: _Asked
    route: Route
    obstacles: _Obstacles
    short: bool
    """Whether it leads only to the nearest safe point."""
    circle_m: float = 0.0
    """Length of the circle at its end, on which the vehicle may stay; 0 where it ends at a place."""

    @property
    def to_go_m(self) -> float:
        """Length of the way to the place, or to the circle."""
        return self.route.length_m - self.circle_m


class _Stay(NamedTuple):
    """A nearest safe point at which the vehicle stays, and the plan that led there."""

    planned: _Planned
    at_ned_m: tuple[float, float]


class RoutedLaw:
    """The gradient law of H* = F* + 1/2 D_geo^2, attracted along the shortest route (docs/method.md section 3).

    Among discs that stand still a route is followed as planned, as the guard certified it, until the vehicle leaves it
    or the question changes; among moving ones it is planned anew at each step.
    """

    def __init__(self, settings: LawSettings) -> None:
        limits = settings.limits
        self._settings = settings
        # So that the route lies outside the guard's discs.
        self._held_m = held_m(limits.position_error_m, limits.wind_m_s, limits.reaction_s, settings.guidance_step_s)
        ground_m_s = limits.speed_m_s + limits.wind_m_s
        rate_rad_s = limits.rate_share * turn_rate_rad_s(limits.speed_m_s, limits.n_max)
        self._step_m = ground_m_s * settings.guidance_step_s
        # Their product may be too small for a float.
        self._turn_radius_m = ground_m_s * ground_m_s / max(limits.speed_m_s * rate_rad_s, sys.float_info.min)
        # A circle of which a step is much more than a radian could not be told from its chords.
        self._circle_m = CIRCLE_SLACK * max(self._turn_radius_m, self._step_m / GREATEST_STEP_TURN_RAD)
        self._period_s = settings.coasting_after_s / COASTING_PERIODS
        self._routers: dict[tuple[bool, float, bool], Router] = {}
        self._planned: _Planned | None = None
        self._circle: tuple[tuple[float, float], TurningPlace] | None = None
        self._stay: _Stay | None = None
        self._progress: Progress | None = None
        self._planning_from_s: float | None = None

    def steer(self, task: Task, motion: Motion, view: View, now_s: float) -> SteeringDemand:
        """Return the direction of the route, bent by the surrogate's gradient where it does not oppose the route."""
        if task.loitering:
            return SteeringDemand(direction(task.pull, self._wall_gradient(motion, view)))
        planned, beside_m = self._followed(task, motion, view, now_s)
        route = planned.route
        if route.pieces:
            self._planned = planned
        if route.reach in (Reach.NONE, Reach.PLANNING):
            return self._without_route(task, motion, view, route, now_s)
        self._planning_from_s = None
        note = NEAREST_NOTE if planned.short else None
        self._stay = self._staying(planned, task, motion)
        if self._stay is not None:
            return SteeringDemand(SteeringVector(0.0, 0.0), stay="at the nearest safe point", note=note, route=route)
        course_rad = self._course_rad(route, motion, view, beside_m)
        self._progress = watched(self._progress, task.place_ned_m, planned.to_go_m, task.refused, self._gain_m, now_s)
        strength_m = max(planned.to_go_m, self._step_m)
        pull = SteeringVector(strength_m * math.cos(course_rad), strength_m * math.sin(course_rad))
        wanted, opposed = _unopposed(pull, self._wall_gradient(motion, view))
        waited_s = now_s - self._progress.since_s
        if note is None and waited_s > SAID_SHARE * self._patience_s():
            note = f"no nearer to its goal for {waited_s:.0f} s"
        return SteeringDemand(wanted, note=note, opposed=opposed, route=route)

    def _without_route(self, task: Task, motion: Motion, view: View, route: Route, now_s: float) -> SteeringDemand:
        """Return the demand while there is no route: straight for the place, but only for a while if one is planned.

        A plan that is made while the vehicle moves on may be out of date when it is done: then it waits for it.
        """
        pull = direction(task.pull, self._wall_gradient(motion, view))
        if route.reach is Reach.NONE:
            return SteeringDemand(pull, stay="no way to the target", route=route)
        self._progress = watched(self._progress, task.place_ned_m, math.inf, task.refused, self._gain_m, now_s)
        self._planning_from_s = now_s if self._planning_from_s is None else self._planning_from_s
        waits = now_s - self._planning_from_s > PLANNING_STEPS * self._settings.guidance_step_s
        return SteeringDemand(pull, route.reach.value if waits else None, route.reach.value, route=route)

    @property
    def _gain_m(self) -> float:
        """Least shortening of the way that is progress: circling brings a vehicle a little nearer by chance."""
        return 0.5 * self._step_m

    def _patience_s(self) -> float:
        limits = self._settings.limits
        return patience_s(self._turn_radius_m, limits.speed_m_s, self._settings.guidance_step_s)

    def _staying(self, planned: _Planned, task: Task, motion: Motion) -> _Stay | None:
        """Return where the vehicle stays if its way leads only to the nearest safe point and it is there, else None."""
        if not planned.short:
            return None
        stay = self._stay
        if stay is not None and stay.planned.asked.place_ned_m == task.place_ned_m and self._is_at(stay, motion):
            return stay._replace(planned=planned)
        if planned.to_go_m > (STANDING_M if self._settings.limits.can_stop else self._step_m):
            return None
        return _Stay(planned, motion.position_ned_m)

    def _is_at(self, stay: _Stay, motion: Motion) -> bool:
        return math.dist(stay.at_ned_m, motion.position_ned_m) <= STAYING_RADII * self._circle_m

    def _followed(self, task: Task, motion: Motion, view: View, now_s: float) -> tuple[_Planned, float]:
        """Return the route to follow from here, and how far to the right of it the vehicle is, m."""
        standing = not np.count_nonzero(view.threat_speed_m_s)
        closed = self._closed(task, now_s)
        centres_ned_m, radii_m = foreseen(view, motion, self._settings.limits.speed_m_s, self._period_s)
        asked = _Asked(
            task.place_ned_m,
            centres_ned_m.tobytes(),
            radii_m.tobytes(),
            view.threat_ids.tobytes(),
            task.crowded,
            closed,
        )
        before, stay = self._planned, self._stay
        if standing and stay is not None and stay.planned.asked == asked and self._is_at(stay, motion):
            return stay.planned, 0.0
        if standing and before is not None and before.asked == asked and before.route.pieces:
            along_m, beside_m = nearest(before.route.pieces, motion.position_ned_m, FOLLOWED_STEPS * self._step_m)
            pieces = left_of(before.route.pieces, along_m)
            off_rad = abs(math.remainder(pieces[0].heading_rad - motion.heading_rad, math.tau))
            off_m = following_m(self._step_m, self._circle_m) + self._held_m + OFF_ROUTE_M
            left_m = before.route.length_m - along_m
            if abs(beside_m) <= off_m and off_rad <= OFF_ROUTE_RAD and left_m > 0.0:
                return before._replace(route=before.route._replace(pieces=pieces, length_m=left_m)), beside_m
        if closed:
            centres_ned_m = np.vstack([centres_ned_m, [passage.centre_ned_m for passage in closed]])
            radii_m = np.append(radii_m, [passage.radius_m for passage in closed])
        ids = np.append(view.threat_ids, -1 - np.arange(len(closed)))
        return self._new_plan(asked, task, motion, _Obstacles(centres_ned_m, radii_m, ids)), 0.0

    def _closed(self, task: Task, now_s: float) -> tuple[Closed, ...]:
        """Return the passages that are closed, one more if the guard has refused the vehicle's way for too long."""
        progress, before = self._progress, self._planned
        if progress is None or not is_same(progress.place_ned_m, task.place_ned_m, self._gain_m):
            return ()
        waited = progress.refused and now_s - progress.since_s > self._patience_s()
        if waited and before is not None and is_same(before.asked.place_ned_m, task.place_ned_m, self._gain_m):
            kept_m = before.obstacles.radii_m + self._held_m
            room = self._room(before.obstacles.centres_ned_m, kept_m, 0.0)
            self._progress = progress = after_closing(progress, before.route.pieces, room, self._circle_m, now_s)
        return progress.closed

    def _new_plan(self, asked: _Asked, task: Task, motion: Motion, obstacles: _Obstacles) -> _Planned:
        """Return a new route to the task's place or, if that cannot be reached, to the safe place nearest to it."""
        limits = self._settings.limits
        kept_m = obstacles.radii_m + self._held_m
        if limits.can_stop:
            route = self._route(task, motion, Goal(task.place_ned_m), obstacles)
            return _Planned(asked, route, obstacles, route.reach is Reach.NEAREST)
        circle_off_m = following_m(self._step_m, self._circle_m)
        room = self._room(obstacles.centres_ned_m, kept_m, circle_off_m)
        within_m = max(0.0, task.arrival_m - circle_off_m)
        goal, short = self._goal(room, task.place_ned_m, within_m, motion)
        route = self._route(task, motion, goal or Goal(task.place_ned_m), obstacles)
        if route.reach in (Reach.NEAREST, Reach.NONE):
            # As near as it gets, where there is room to turn; from where nothing is safe, to the first such place.
            near_ned_m = route.goal_ned_m if route.reach is Reach.NEAREST else motion.position_ned_m
            goal, short = self._goal(room, near_ned_m, within_m, motion)[0], True
            if goal is not None:
                route = self._route(task, motion, goal, obstacles, instead=True)
        if route.end_side and goal is not None:
            return _Planned(asked, _with_circle(route, goal, motion), obstacles, short, math.tau * goal.radius_m)
        return _Planned(asked, route, obstacles, short)

    def _goal(
        self, room: Room, place_ned_m: tuple[float, float], within_m: float, motion: Motion
    ) -> tuple[Goal | None, bool]:
        """Return what a route to a place must lead to, and whether that passes farther from it than `within_m`."""
        if is_open(room, place_ned_m, self._circle_m):
            return Goal(place_ned_m), False
        found = self._circle
        if found is None or found[0] != place_ned_m or not is_clear(room, found[1].centre_ned_m, self._circle_m):
            place = turning_place(room, place_ned_m, self._circle_m, within_m, motion.position_ned_m)
            if place is None:
                return None, True
            found = self._circle = (place_ned_m, place)
        return Goal(found[1].centre_ned_m, self._circle_m), found[1].passes_m > within_m

    def _room(self, centres_ned_m: np.ndarray, kept_m: np.ndarray, off_m: float) -> Room:  # (M, 2) m, (M,) m
        limits = self._settings.limits
        clearance_m = off_m + LEAST_CLEARANCE_M
        return Room(
            centres_ned_m,
            kept_m + clearance_m,
            np.array(limits.fence).reshape(-1, 2),
            tuple(np.array(corners) for corners in limits.exclusions),
            self._held_m + clearance_m,
        )

    def _route(self, task: Task, motion: Motion, goal: Goal, obstacles: _Obstacles, *, instead: bool = False) -> Route:
        """Return the route to a goal; with `instead` that is the nearest safe place.

        With others near, one that leaves room for a circle is taken, if there is one. What following costs is kept from
        the discs if there is such a way, else a part of it: the guard, which predicts how the vehicle follows, decides.
        """
        roomy_m = 2.0 * self._turn_radius_m
        for room_m in (roomy_m, 0.0) if task.crowded and len(obstacles.radii_m) else (0.0,):
            for share in FOLLOWING_SHARES:
                route = self._route_with((instead, share, room_m > 0.0), motion, goal, obstacles, room_m)
                if route.reach in (Reach.TARGET, Reach.PLANNING):
                    return route
        return route

    def _route_with(
        self, question: tuple[bool, float, bool], motion: Motion, goal: Goal, obstacles: _Obstacles, room_m: float
    ) -> Route:
        """Return the route with a share of what following costs, and more room, kept from the discs.

        Each question that is asked from step to step has a router of its own, which goes on planning where it was.
        """
        limits, share = self._settings.limits, question[1]
        kept_m = obstacles.radii_m + self._held_m
        off_m = share * following_m(self._step_m, np.maximum(kept_m, self._circle_m))
        walls = NO_WALLS
        if limits.fence or limits.exclusions:
            clearance_m = self._held_m + LEAST_CLEARANCE_M + share * following_m(self._step_m, self._circle_m)
            walls = Walls(limits.fence, limits.exclusions, clearance_m)
        return self._routers.setdefault(question, Router()).route(
            Departure(motion.position_ned_m, motion.heading_rad, 0.0 if limits.can_stop else self._turn_radius_m),
            goal,
            obstacles.centres_ned_m,
            kept_m + off_m + LEAST_CLEARANCE_M + room_m,
            obstacles.ids,
            walls,
        )

    def _course_rad(self, route: Route, motion: Motion, view: View, beside_m: float) -> float:
        """Return the heading that follows a route; from inside a disc the route's first direction, which leads out."""
        if not route.pieces:
            return motion.heading_rad
        offset_m = view.threats_ned_m - np.array(motion.position_ned_m)
        if (_lengths(offset_m) < view.detection_radius_m + self._held_m).any():
            return route.heading_rad
        first = route.pieces[0]
        if abs(first.curvature_1_m) * self._turn_radius_m >= TIGHTEST_SHARE and first.length_m > self._step_m:
            # The turn limit makes the tightest circle of it. Others may know where the turn leads to.
            return first.heading_rad + _shortened_rad(first.curvature_1_m * first.length_m)
        ahead_m = self._settings.limits.speed_m_s * self._settings.limits.reaction_s
        pieces = left_of(route.pieces, ahead_m) if ahead_m else route.pieces
        return course_rad(pieces, beside_m, self._step_m, self._turn_radius_m)

    def _wall_gradient(self, motion: Motion, view: View) -> np.ndarray:  # (2,) m
        margin_m = LEAST_CLEARANCE_M + self._held_m
        return wall_gradient(
            np.array(motion.position_ned_m),
            ThreatDiscs(view.threats_ned_m, view.detection_radius_m, view.attack_radius_m),
            view.peers_ned_m,
            self._settings.separation_m,
            self._settings.weights,
            margin_m / WALL_SHARE,
        )


def _with_circle(route: Route, goal: Goal, motion: Motion) -> Route:
    """Return a route that ends along a circle with one turn of that circle behind it."""
    if route.pieces:
        last = route.pieces[-1]
        north_m, east_m, heading_rad = at((last,), last.length_m)
    else:
        north_m, east_m, heading_rad = motion.north_m, motion.east_m, motion.heading_rad
    turn_m = math.tau * goal.radius_m
    circle = Piece(north_m, east_m, heading_rad, route.end_side / goal.radius_m, turn_m)
    return route._replace(pieces=(*route.pieces, circle), length_m=route.length_m + turn_m)


def foreseen(
    view: View, motion: Motion, speed_m_s: float, period_s: float
) -> tuple[np.ndarray, np.ndarray]:  # (M, 2) m, (M,) m
    """Return centres and radii of discs that contain each threat at the time the vehicle could reach it.

    A threat is moved at its broadcast velocity for at most LOOK_AHEAD_S. The part of its speed bound that this velocity
    does not use up grows the radius, for the age of the report but at least for one broadcast period: discs that grow
    and shrink with every broadcast would open and close gaps, and the route would go to and fro.
    """
    if not np.count_nonzero(view.threat_speed_m_s):
        return view.threats_ned_m, view.detection_radius_m
    offset_m = view.threats_ned_m - np.array(motion.position_ned_m)
    apart_m = _lengths(offset_m) - view.detection_radius_m
    ahead_s = np.minimum(np.maximum(apart_m / speed_m_s, 0.0), LOOK_AHEAD_S)
    moved_m = view.threat_velocity_m_s * (view.threat_age_s + ahead_s)[:, np.newaxis]
    known_m_s = _lengths(view.threat_velocity_m_s)
    unexplained_m_s = view.threat_speed_m_s - np.minimum(known_m_s, view.threat_speed_m_s)
    heard_m = view.detection_radius_m - view.threat_speed_m_s * view.threat_age_s
    grown_m = unexplained_m_s * np.maximum(view.threat_age_s, period_s)
    return view.threats_ned_m + moved_m, heard_m + grown_m


def _lengths(vectors: np.ndarray) -> np.ndarray:  # (M, 2) -> (M,)
    squares = vectors * vectors
    lengths: np.ndarray = np.sqrt(squares[:, 0] + squares[:, 1])
    return lengths


def law_of(settings: LawSettings) -> SteeringLaw:
    """Return a new law of the kind that the settings name."""
    return RoutedLaw(settings) if settings.law == "routed" else GradientLaw(settings)


def _unopposed(pull: SteeringVector, gradient_m: np.ndarray) -> tuple[SteeringVector, bool]:
    """Return the direction without the gradient's component against the route, and whether that is worth reporting."""
    strength_m = pull.strength_m
    if strength_m == 0.0:
        return direction(pull, gradient_m), False
    ahead = (pull.north_m / strength_m, pull.east_m / strength_m)
    against_m = float(gradient_m[0]) * ahead[0] + float(gradient_m[1]) * ahead[1]
    if against_m <= 0.0:
        return direction(pull, gradient_m), False
    sideways_m = gradient_m - against_m * np.array(ahead)
    return direction(pull, sideways_m), against_m > OPPOSED_SHARE * strength_m


def _shortened_rad(turn_rad: float) -> float:
    """Return a turn, or a right angle to its side where the shorter turn to its end is to the other side."""
    return turn_rad if abs(turn_rad) <= LONGEST_TURN_RAD else math.copysign(math.pi / 2.0, turn_rad)


def _range_gradient(task: Task, motion: Motion, settings: LawSettings) -> np.ndarray:  # (2,) m
    """Return the gradient of the smooth f4, the penalty of the range (paper: fun4)."""
    return range_gradient(
        np.array(motion.position_ned_m),
        np.array(task.place_ned_m),
        task.flown_m,
        settings.limits.range_m,
        settings.weights.k_l,
    )


def _surrogate(settings: LawSettings) -> Surrogate:
    if settings.law == "seed" and settings.surrogate == "monolithic":
        return MonolithicSurrogate(load_monolithic(), settings.agent_id)
    return PairSurrogate(_profile(settings), settings.separation_m, settings.weights)


def _profile(settings: LawSettings) -> RadialProfile:
    if settings.law == "ramp":
        return PolygonProfile(HALF_WIDTH)
    if settings.law == "step":
        return StepProfile()
    return profile_by_name(settings.surrogate)
