"""What steers: from where a vehicle is to be and what it knows, to a wanted heading (docs/method.md sections 1 and 3).

A law says where it would like to head. The right of way, the turn limit and the guard come after it, whatever the law.
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
"""The route keeps at least this far outside what the guard keeps (docs/method.md section 3: margins nest)."""
ROUTE_MARGIN_STEPS = 0.05
"""Share of the way flown in a step that the route keeps instead where it is more: a step cuts its corners."""
WALL_SHARE = 22.0
"""Half-width of F*'s edge is the route's margin over this: at the route it weighs less than any attraction."""
ONWARD_CIRCLES = 3
"""A way on from the route's end is kept ready once the end is this many turning circles' lengths away: the guard
looks so far along a route."""
ONWARD_RAD = 0.05
"""And until the route arrives on a heading that differs by more than this."""
OPPOSED_SHARE = 0.01
"""A component against the route is worth counting from this share of the attraction."""
COASTING_PERIODS = 3.0
"""Broadcast periods after which a picture counts as coasting: the settings say no more of the period."""
LOOK_AHEAD_S = 30.0
"""A broadcast velocity is believed for this time; after that the threat may be anywhere its bound allows."""


@dataclass(frozen=True)
class Task:
    """What the vehicle is to do now: go to a place, or keep a place that it loiters at."""

    place_ned_m: tuple[float, float]
    pull: SteeringVector
    """What would attract it if there were nothing else."""
    loitering: bool
    to_target: bool
    flown_m: float
    arrival_m: float
    """As near as this is there."""
    crowded: bool = False
    """Others are so near that the right of way may ask for a circle to the right at any time."""


class SteeringDemand(NamedTuple):
    """Where a law wants to go, as strongly as the gradient of its cost."""

    pull: SteeringVector
    stay: str | None = None
    """Why the vehicle can do no better than to loiter here; None while it can."""
    note: str | None = None
    """What else is worth knowing of this decision."""
    opposed: bool = False
    """The surrogate's component against the route was dropped."""
    route: Route | None = None
    onward: tuple[Piece, ...] = ()
    """A way on from where the route ends, for a vehicle that cannot stop there."""


class SteeringLaw(Protocol):
    """A guidance law of one vehicle; it may remember, but time and inputs are given to it."""

    def steer(self, task: Task, motion: Motion, view: View, now_s: float) -> SteeringDemand:
        """Return what it wants; `now_s` is this vehicle's clock."""
        ...


@dataclass(frozen=True)
class _OnwardFor:
    """What a way on was found for."""

    from_ned_m: tuple[float, float]
    threat_ids: tuple[int, ...]
    heading_rad: float

    def serves(self, other: _OnwardFor) -> bool:
        """Return whether it will do for another as well."""
        same = self.from_ned_m == other.from_ned_m and self.threat_ids == other.threat_ids
        return same and abs(math.remainder(self.heading_rad - other.heading_rad, math.tau)) <= ONWARD_RAD


SteeringOf = Callable[[LawSettings], SteeringLaw]
"""Makes a vehicle's law from its settings."""


class GradientLaw:
    """The paper's laws: the attraction less the gradient of the surrogate (paper: direct1)."""

    def __init__(self, settings: LawSettings) -> None:
        self._settings = settings
        self._surrogate = _surrogate(settings)

    def steer(self, task: Task, motion: Motion, view: View, now_s: float) -> SteeringDemand:
        """See SteeringLaw."""
        gradient_m = self._surrogate.gradient_m(motion.position_ned_m, view)
        if task.to_target and self._settings.law == "seed":
            gradient_m = gradient_m + _range_gradient(task, motion, self._settings)
        return SteeringDemand(direction(task.pull, gradient_m))


class RoutedLaw:
    """H* = F* + 1/2 D_geo^2: the attraction follows the shortest path around the discs (docs/method.md section 3)."""

    def __init__(self, settings: LawSettings) -> None:
        limits = settings.limits
        self._settings = settings
        self._margin_m = max(ROUTE_MARGIN_M, ROUTE_MARGIN_STEPS * limits.speed_m_s * settings.guidance_step_s)
        # What the guard adds to every disc, so that the route lies outside what it keeps.
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
        """See SteeringLaw."""
        self._began_ned_m = self._began_ned_m or motion.position_ned_m
        wall_m = self._wall_gradient(motion, view)
        if task.loitering:
            return SteeringDemand(direction(task.pull, wall_m))
        centres_ned_m, radii_m = foreseen(view, motion, self._settings.limits.speed_m_s, self._period_s)
        radii_m = radii_m + self._clearance_m
        route = self._route(task, motion, centres_ned_m, radii_m, view)
        if route.reach is Reach.NONE:
            return SteeringDemand(direction(task.pull, wall_m), stay="no way to the target", route=route)
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
            # The shorter side of a long turn may be the other one: then the side is wanted, not the end of it.
            wanted = _on_side(wanted, motion.heading_rad, route.turn)
        onward = self._way_on(route, self._began_ned_m, centres_ned_m, radii_m, view)
        return SteeringDemand(wanted, note=note, opposed=opposed, route=route, onward=onward)

    def _route(
        self, task: Task, motion: Motion, centres_ned_m: np.ndarray, radii_m: np.ndarray, view: View
    ) -> Route:  # (M, 2) m, (M,) m
        """Return the way to the place; with others near, where there is one, the way that leaves room for a circle."""
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
        """Return the way from the end of a route back to where guidance began, among discs that stand still.

        A place is worth going to only if there is a way on from it; the guard looks along it for room to circle.
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
    """Return discs that hold each threat when the vehicle could be at it: what a route must go around.

    A broadcast velocity is believed for LOOK_AHEAD_S and only as far as the announced bound; what a threat may have
    done beyond it since it was heard of stays in the radius. That counts as if a broadcast period had gone by: discs
    that grow and shrink with every broadcast would open and close gaps, and the route would go to and fro.
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
    """Return the law that the settings name."""
    return RoutedLaw(settings) if settings.law == "routed" else GradientLaw(settings)


def _unopposed(pull: SteeringVector, gradient_m: np.ndarray) -> tuple[SteeringVector, bool]:
    """Return the direction without what the surrogate puts against the route, and whether there was any."""
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
    """Return the wanted direction, or a right angle to the side if it would be turned to by the other one."""
    if side * shorter_turn_rad(heading_rad, wanted.heading_rad) >= 0.0:
        return wanted
    turned_rad = heading_rad + side * math.pi / 2.0
    return SteeringVector(wanted.strength_m * math.cos(turned_rad), wanted.strength_m * math.sin(turned_rad))


def _range_gradient(task: Task, motion: Motion, settings: LawSettings) -> np.ndarray:  # (2,) m
    """Return the gradient of the smooth f4 (paper: fun4)."""
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
