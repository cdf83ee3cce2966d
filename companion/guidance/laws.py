"""The guidance laws: from a vehicle's task and world model to a wanted heading (docs/method.md sections 1 and 3).

A law returns a steering demand. Right of way, turn limit and guard are applied to the demand of every law.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from companion.geo.kinematics import shorter_turn_rad, turn_rate_rad_s
from companion.guard.types import TRACKING_REACTIONS, TRACKING_STEPS, Motion, Piece
from companion.guidance.route.router import Departure, Reach, Route, Router, shortest_route
from companion.guidance.settings import LawSettings
from companion.guidance.steering import MonolithicSurrogate, PairSurrogate, SteeringVector, Surrogate, direction
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

ROUTE_MARGIN_M = 2.0
"""Least margin between the route and the discs as the guard inflates them (docs/method.md section 3: margins nest)."""
ROUTE_MARGIN_STEPS = 0.05
"""Margin of the route as a share of the distance flown in a guidance step, used where that is more than
ROUTE_MARGIN_M: a vehicle that is steered in steps cuts corners."""
WALL_SHARE = 22.0
"""Ratio of the route's margin to the half-width of F*'s edge: at this one the repulsion at the route is weaker than
any attraction."""
ONWARD_CIRCLES = 3
"""Length of the rest of the route, in circumferences of the turning circle, from which the way on from its end is
planned: the guard looks that far along a route."""
ONWARD_RAD = 0.05
"""Change of the heading on which the route arrives, above which the way on from its end is planned again."""
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
    onward: tuple[Piece, ...] = ()
    """The way on from the end of the route, which the guard may follow if the vehicle cannot stop there."""


class SteeringLaw(Protocol):
    """A guidance law of one vehicle; it may store state, but reads no clock and no inputs other than its arguments."""

    def steer(self, task: Task, motion: Motion, view: View, now_s: float) -> SteeringDemand:
        """Return the steering demand of one guidance step; `now_s` is the time of this vehicle's clock."""
        ...


@dataclass(frozen=True)
class _OnwardFor:
    """The question that a way on from the route's end answers: from where, on which heading, among which threats."""

    from_ned_m: tuple[float, float]
    threat_ids: tuple[int, ...]
    heading_rad: float

    def serves(self, other: _OnwardFor) -> bool:
        """Return whether the way on that was found for this question also answers the other one."""
        same = self.from_ned_m == other.from_ned_m and self.threat_ids == other.threat_ids
        return same and abs(math.remainder(self.heading_rad - other.heading_rad, math.tau)) <= ONWARD_RAD


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


class RoutedLaw:
    """The gradient law of H* = F* + 1/2 D_geo^2, attracted along the shortest route (docs/method.md section 3)."""

    def __init__(self, settings: LawSettings) -> None:
        limits = settings.limits
        self._settings = settings
        self._margin_m = max(ROUTE_MARGIN_M, ROUTE_MARGIN_STEPS * limits.speed_m_s * settings.guidance_step_s)
        # The margin on top of what the guard adds to every disc, so that the route lies outside the guard's discs.
        held_s = TRACKING_STEPS * settings.guidance_step_s + TRACKING_REACTIONS * limits.reaction_s
        self._clearance_m = self._margin_m + limits.position_error_m + limits.wind_m_s * held_s
        ground_m_s = limits.speed_m_s + limits.wind_m_s
        rate_rad_s = limits.rate_share * turn_rate_rad_s(limits.speed_m_s, limits.n_max)
        self._turn_radius_m = ground_m_s * ground_m_s / (limits.speed_m_s * rate_rad_s)
        self._period_s = settings.coasting_after_s / COASTING_PERIODS
        self._router = Router()
        self._began_ned_m: tuple[float, float] | None = None
        self._onward: tuple[_OnwardFor, tuple[Piece, ...]] | None = None

    def steer(self, task: Task, motion: Motion, view: View, now_s: float) -> SteeringDemand:
        """Return the direction of the route, bent by the surrogate's gradient where it does not oppose the route."""
        self._began_ned_m = self._began_ned_m or motion.position_ned_m
        wall_m = self._wall_gradient(motion, view)
        if task.loitering:
            return SteeringDemand(direction(task.pull, wall_m))
        centres_ned_m, radii_m = foreseen(view, motion, self._settings.limits.speed_m_s, self._period_s)
        radii_m = radii_m + self._clearance_m
        route = self._route(task, motion, centres_ned_m, radii_m, view)
        if route.reach is Reach.NONE:
            return SteeringDemand(direction(task.pull, wall_m), stay="no way to the target", route=route)
        if route.reach is Reach.PLANNING:
            return SteeringDemand(direction(task.pull, wall_m), stay="the way is still being planned", route=route)
        note = None
        if route.reach is Reach.NEAREST:
            note = "target out of reach: to the nearest safe point"
            if route.length_m <= max(task.arrival_m, 2.0 * self._turn_radius_m):
                return SteeringDemand(
                    SteeringVector(0.0, 0.0), stay="at the nearest safe point", note=note, route=route
                )
        pull = SteeringVector(
            route.length_m * math.cos(route.heading_rad), route.length_m * math.sin(route.heading_rad)
        )
        wanted, opposed = _unopposed(pull, wall_m)
        if route.turn != 0:
            # The vehicle turns by the shorter side: if the route turns by the longer one, demand a turn to that side.
            wanted = _on_side(wanted, motion.heading_rad, route.turn)
        onward = self._way_on(route, self._began_ned_m, centres_ned_m, radii_m, view)
        return SteeringDemand(wanted, note=note, opposed=opposed, route=route, onward=onward)

    def _route(
        self, task: Task, motion: Motion, centres_ned_m: np.ndarray, radii_m: np.ndarray, view: View
    ) -> Route:  # (M, 2) m, (M,) m
        """Return the route to the place; with others near, one that leaves room for a circle, if there is one."""
        for room_m in (2.0 * self._turn_radius_m, 0.0) if task.crowded and len(radii_m) else (0.0,):
            route = self._router.route(
                Departure(motion.position_ned_m, motion.heading_rad, self._turn_radius_m),
                task.place_ned_m,
                centres_ned_m,
                radii_m + room_m,
                view.threat_ids,
            )
            if route.reach is Reach.TARGET:
                break
        return route

    def _way_on(
        self, route: Route, back_ned_m: tuple[float, float], centres_ned_m: np.ndarray, radii_m: np.ndarray, view: View
    ) -> tuple[Piece, ...]:  # (M, 2) m, (M,) m
        """Return the way from the end of a route back to where guidance began; () where any threat moves.

        The guard looks along it for room to circle: a place that the vehicle cannot leave again must not be approached.
        """
        near = route.length_m <= ONWARD_CIRCLES * math.tau * self._turn_radius_m
        if not near or not route.pieces or np.count_nonzero(view.threat_speed_m_s):
            return ()
        last = route.pieces[-1]
        arrival_rad = (last.heading_rad + last.curvature_1_m * last.length_m) % math.tau
        wanted_for = _OnwardFor(route.goal_ned_m, tuple(view.threat_ids.tolist()), arrival_rad)
        if self._onward is None or not self._onward[0].serves(wanted_for):
            found = shortest_route(
                route.goal_ned_m, back_ned_m, centres_ned_m, radii_m, arrival_rad, self._turn_radius_m
            )
            self._onward = (wanted_for, found.pieces)
        return self._onward[1]

    def _wall_gradient(self, motion: Motion, view: View) -> np.ndarray:  # (2,) m
        return wall_gradient(
            np.array(motion.position_ned_m),
            ThreatDiscs(view.threats_ned_m, view.detection_radius_m, view.attack_radius_m),
            view.peers_ned_m,
            self._settings.separation_m,
            self._settings.weights,
            self._margin_m / WALL_SHARE,
        )


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


def _on_side(wanted: SteeringVector, heading_rad: float, side: int) -> SteeringVector:
    """Return the wanted direction, or a right angle to the given side where the shorter turn is to the other side."""
    if side * shorter_turn_rad(heading_rad, wanted.heading_rad) >= 0.0:
        return wanted
    turned_rad = heading_rad + side * math.pi / 2.0
    return SteeringVector(wanted.strength_m * math.cos(turned_rad), wanted.strength_m * math.sin(turned_rad))


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
