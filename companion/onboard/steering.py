"""The stages of one tick from the goal to the setpoint: law, right of way, turn limit, guard."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from companion.autopilot.adapter import Abilities
from companion.geo.kinematics import limit_turn, shorter_turn_rad
from companion.geo.right_of_way import Rules, interaction_radius_m
from companion.guard.guard import Guard
from companion.guard.lead import MOST_LEAD_RAD
from companion.guard.types import Discs, Hints, Limits, Motion, Setpoint, Verdict
from companion.guidance.laws import SteeringDemand, SteeringLaw, Task, law_of
from companion.guidance.resolution import AtEffect, Peers
from companion.guidance.separation import give_way
from companion.guidance.steering import (
    APPROACH_GAIN_1_S,
    Occupied,
    attraction,
    claim_m,
    loiter_attraction,
    loiter_place,
    loiter_radius_m,
    loiter_spacing_m,
)
from companion.guidance.stopping import STANDING_M_S
from companion.guidance.view import NOBODY, View
from companion.onboard.config import Config, LimitsSection
from companion.onboard.decision import Purpose
from companion.onboard.engagement import Engagement
from companion.onboard.goal import ARRIVAL_SHARE, Goal, LoiterGeometry
from companion.onboard.law_settings import law_settings
from companion.onboard.limits import within

STANDING_WITHIN_M = 1.0
"""Distance from its loiter place within which a vehicle that can stop stands still."""


@dataclass(frozen=True)
class Steering:
    """Law, right of way and guard of one vehicle, made for its limits.

    Guard and law have a state of their own; when the limits change, a new Steering is made (`adapted`).
    """

    config: Config
    """The configuration, with limits that the vehicle can keep."""
    can_stop: bool
    """Whether the vehicle can stand still in the air."""
    guard: Guard
    law: SteeringLaw
    own_law: bool
    """Whether the caller gave the law, which then stays when the limits change."""
    rules: Rules | None
    """Rules of the right of way; None for a law that flies without it."""
    interaction_m: float
    """Distance within which another vehicle matters to the right of way."""
    loiter: LoiterGeometry
    abilities: Abilities | None = None
    """Abilities that the limits were adapted to; None while they are not known."""
    unable: str | None = None
    """Why these abilities are not enough to be steered, while the limits stay as before; None if they are enough."""


class Moment(NamedTuple):
    """The situation of one tick, which all stages of the steering share."""

    motion: Motion
    view: View
    flown_m: float
    now_s: float
    refused: bool = False
    """Whether the guard refused the last step, or let the vehicle only continue its back-up."""


class Steered(NamedTuple):
    """The result of one tick's steering."""

    purpose: Purpose
    """Purpose of the goal, or LOITER if the law cannot bring the vehicle nearer to the goal's place."""
    reason: str
    demand: SteeringDemand
    stay: str | None
    """Why the law loiters instead of going to the goal's place; None if it does not."""
    note: str | None
    """Remark of the law on its demand, if any."""
    loiter_place_ned_m: tuple[float, float] | None
    """Where the vehicle loiters; None for any other purpose."""
    wanted_heading_rad: float
    """Heading that the law wants, before the right of way."""
    gave_way: str | None
    """Why the right of way changed heading or speed; None if it did not."""
    turn_limited: bool
    verdict: Verdict
    """The guard's verdict, with the setpoint that may be sent."""


class _Intent(NamedTuple):
    """The law's demand for a goal, with the speed to fly at; the fields are as in Steered."""

    purpose: Purpose
    reason: str
    demand: SteeringDemand
    speed_m_s: float
    stay: str | None
    note: str | None
    loiter_place_ned_m: tuple[float, float] | None


def steering_of(config: Config, can_stop: bool, law: SteeringLaw | None = None) -> Steering:
    """Return the steering by a configuration's limits, with the configured law unless the caller gives one.

    Raises:
        ValueError: the guard cannot hold these limits.

    """
    limits = config.limits
    guard = Guard(_guard_limits(limits, can_stop))
    rules = _rules(config, can_stop) if config.law == "routed" else None
    radius_m = loiter_radius_m(limits.speed_m_s, limits.n_max, config.guidance_step_s)
    circle_m = 0.0 if can_stop else radius_m
    return Steering(
        config=config,
        can_stop=can_stop,
        guard=guard,
        law=law or law_of(law_settings(config, can_stop=can_stop)),
        own_law=law is not None,
        rules=rules,
        interaction_m=0.0 if rules is None else interaction_radius_m(rules, config.guidance_step_s),
        loiter=LoiterGeometry(
            radius_m,
            loiter_spacing_m(config.separation_m, circle_m) + circle_m,
            claim_m(config.separation_m, circle_m),
        ),
    )


def adapted(steering: Steering, configured: LimitsSection, abilities: Abilities) -> Steering:
    """Return the steering for a vehicle of these abilities; if they are not enough, the old one with the reason."""
    if abilities == steering.abilities:
        return steering
    limits = within(configured, abilities)
    unable = None
    if limits.wind_m_s >= limits.speed_m_s:
        unable = f"limits.wind_m_s {limits.wind_m_s:g} is not below the {limits.speed_m_s:.3g} m/s that it can fly"
    elif limits != steering.config.limits:
        config = steering.config.model_copy(update={"limits": limits})
        try:
            steering = steering_of(config, steering.can_stop, steering.law if steering.own_law else None)
        except ValueError:
            unable = f"its parameters leave {limits.speed_m_s:.3g} m/s and n_max {limits.n_max:.3g}: nothing to fly by"
    return replace(steering, abilities=abilities, unable=unable)


def outgrown(steering: Steering, configured: LimitsSection, abilities: Abilities) -> bool:
    """Return whether the vehicle's abilities now give other limits than those that it is steered by."""
    return abilities != steering.abilities and within(configured, abilities) != steering.config.limits


def steer(steering: Steering, goal: Goal, moment: Moment, before: Engagement) -> Steered:
    """Pass the stages from the goal to the guarded setpoint; `before` holds the latches of the last tick."""
    limits, dt_s = steering.config.limits, steering.config.guidance_step_s
    in_force = None if before.setpoint is None else before.setpoint.setpoint
    moment = moment._replace(motion=_as_commanded(steering, moment.motion, in_force))
    motion = moment.motion
    crowded = not steering.can_stop and _is_crowded(motion, moment.view, steering.interaction_m)
    intent = _intent(steering, goal, moment, before.loiter_place_ned_m, crowded)
    wanted_rad, speed_m_s = _wanted(steering, intent, motion)
    last = None if limits.reaction_s == 0.0 else in_force
    # When this decision begins to act, the vehicle has turned by the last setpoint for the reaction time.
    from_rad = steering.guard.tip(motion, moment.now_s, dt_s)[0].heading_rad
    at_effect = None if last is None else AtEffect(from_rad % math.tau, last.speed_m_s)
    steered_rad, speed_m_s, gave_way = _right_of_way(steering, wanted_rad, speed_m_s, moment, at_effect)
    # The turn is limited at the greatest of the speeds until the end of the step, as the guard does.
    faster_m_s = max(motion.speed_m_s, speed_m_s)
    if last is not None and steering.can_stop:
        faster_m_s = max(faster_m_s, last.speed_m_s)
    aim_rad = steered_rad if in_force is None else _by_the_side_begun(from_rad, steered_rad, in_force.heading_rad)
    heading_rad, limited = limit_turn(from_rad, aim_rad, faster_m_s, limits.n_max, dt_s)
    setpoint = Setpoint(heading_rad, speed_m_s, steering.config.height_m)
    return Steered(
        purpose=intent.purpose,
        reason=intent.reason,
        demand=intent.demand,
        stay=intent.stay,
        note=intent.note,
        loiter_place_ned_m=intent.loiter_place_ned_m,
        wanted_heading_rad=wanted_rad,
        gave_way=gave_way,
        turn_limited=limited,
        verdict=_guarded(steering, setpoint, moment, intent.demand, crowded, steered_rad),
    )


def _as_commanded(steering: Steering, motion: Motion, in_force: Setpoint | None) -> Motion:
    """Return the motion; a vehicle that can stop and stands has the heading that it was commanded to start on.

    Its yaw says nothing about that: a copter starts in any direction, and not all turn their nose while they stand.
    """
    if not steering.can_stop or in_force is None or max(motion.speed_m_s, in_force.speed_m_s) >= STANDING_M_S:
        return motion
    return replace(motion, heading_rad=in_force.heading_rad)


def _intent(
    steering: Steering, goal: Goal, moment: Moment, place_ned_m: tuple[float, float] | None, crowded: bool
) -> _Intent:
    """Return the law's demand for the goal; if the law stays, its demand for loitering.

    `place_ned_m`: where the vehicle has loitered up to now, if it has; otherwise a loiter place is chosen.
    """
    purpose, reason = goal.purpose, goal.reason
    if goal.place_ned_m is None:
        place_ned_m = _place_to_loiter(steering, moment, place_ned_m)
        demand, speed_m_s = _loiter(steering, place_ned_m, moment, crowded)
    else:
        demand, speed_m_s = _go(steering, goal.place_ned_m, purpose, moment, crowded)
    stay, note = demand.stay, demand.note
    if stay is not None:
        purpose, reason = Purpose.LOITER, stay
        place_ned_m = _place_to_loiter(steering, moment, place_ned_m)
        demand, speed_m_s = _loiter(steering, place_ned_m, moment, crowded)
    kept_ned_m = place_ned_m if purpose is Purpose.LOITER else None
    return _Intent(purpose, reason, demand, speed_m_s, stay, note, kept_ned_m)


def _place_to_loiter(
    steering: Steering, moment: Moment, before_ned_m: tuple[float, float] | None
) -> tuple[float, float]:
    """Return the present loiter place, or a new one that leaves room to those that go first or are on their way."""
    view, loiter = moment.view, steering.loiter
    occupied = Occupied(view.loitering_ned_m, loiter.spacing_m, view.claimed_ned_m, loiter.claim_m)
    return loiter_place(moment.motion.position_ned_m, occupied, before_ned_m)


def _go(
    steering: Steering, place_ned_m: tuple[float, float], purpose: Purpose, moment: Moment, crowded: bool
) -> tuple[SteeringDemand, float]:
    """Return the law's demand for going to a place, and the speed to fly at in m/s."""
    pull = attraction(moment.motion.position_ned_m, place_ned_m)
    task = Task(
        place_ned_m=place_ned_m,
        pull=pull,
        loitering=False,
        to_target=purpose is Purpose.TARGET,
        flown_m=moment.flown_m,
        arrival_m=ARRIVAL_SHARE * steering.config.arrival_radius_m,
        refused=moment.refused,
        crowded=crowded,
    )
    return steering.law.steer(task, moment.motion, moment.view, moment.now_s), steering.config.limits.speed_m_s


def _loiter(
    steering: Steering, place_ned_m: tuple[float, float], moment: Moment, crowded: bool
) -> tuple[SteeringDemand, float]:
    """Return the law's demand for loitering at a place, and the speed to fly at in m/s."""
    here_ned_m = moment.motion.position_ned_m
    speed_m_s = steering.config.limits.speed_m_s
    if steering.can_stop:
        pull = attraction(here_ned_m, place_ned_m)
        speed_m_s = 0.0 if pull.strength_m <= STANDING_WITHIN_M else speed_m_s
    else:
        pull = loiter_attraction(here_ned_m, place_ned_m, steering.loiter.radius_m)
    task = Task(
        place_ned_m=place_ned_m,
        pull=pull,
        loitering=True,
        to_target=False,
        flown_m=moment.flown_m,
        arrival_m=ARRIVAL_SHARE * steering.config.arrival_radius_m,
        crowded=crowded,
    )
    return steering.law.steer(task, moment.motion, moment.view, moment.now_s), speed_m_s


def _wanted(steering: Steering, intent: _Intent, motion: Motion) -> tuple[float, float]:
    """Return the heading (rad) and speed (m/s) that follow from the law's demand."""
    pull, speed_m_s = intent.demand.pull, intent.speed_m_s
    strength_m = pull.strength_m
    stands = steering.can_stop and speed_m_s == 0.0 and strength_m <= STANDING_WITHIN_M
    if steering.can_stop and intent.purpose is not Purpose.TARGET and not stands:
        speed_m_s = min(steering.config.limits.speed_m_s, APPROACH_GAIN_1_S * strength_m)
    if stands or strength_m == 0.0:
        return motion.heading_rad, speed_m_s
    return pull.heading_rad, speed_m_s


def _right_of_way(
    steering: Steering, wanted_rad: float, speed_m_s: float, moment: Moment, at_effect: AtEffect | None
) -> tuple[float, float, str | None]:
    """Return heading (rad) and speed (m/s) by the right of way, and why it changed them, or None."""
    # Standing still is always allowed to one that can stop.
    if steering.rules is None or (steering.can_stop and speed_m_s == 0.0):
        return wanted_rad, speed_m_s, None
    given = give_way(
        wanted_rad,
        moment.motion,
        Peers(moment.view.traffic_ned_m, moment.view.traffic_velocity_m_s, moment.view.traffic_ids == NOBODY),
        steering.rules,
        steering.config.guidance_step_s,
        at_effect,
    )
    if given.reason is None:
        return given.heading_rad, speed_m_s, None
    if steering.can_stop:
        speed_m_s = min(speed_m_s, given.speed_m_s)
    return given.heading_rad, speed_m_s, f"{given.reason} ({_named(given.peer, moment.view)})"


def _named(peer: int | None, view: View) -> str:
    """Return the words for a neighbour, given by its index among the detected traffic."""
    identity = NOBODY if peer is None else int(view.traffic_ids[peer])
    return "not of the fleet" if identity == NOBODY else f"agent {identity}"


def _by_the_side_begun(from_rad: float, wanted_rad: float, commanded_rad: float) -> float:
    """Return the heading to turn to: the wanted one or, where that is behind, a quarter turn to the commanded side.

    A vehicle that hardly answers stays opposite to what it wants, where the shorter side changes with every report.
    """
    if abs(shorter_turn_rad(from_rad, wanted_rad)) <= MOST_LEAD_RAD:
        return wanted_rad
    return from_rad + math.copysign(MOST_LEAD_RAD, shorter_turn_rad(commanded_rad, wanted_rad))


def _guarded(
    steering: Steering, wanted: Setpoint, moment: Moment, demand: SteeringDemand, crowded: bool, towards_rad: float
) -> Verdict:
    view = moment.view
    discs = Discs(
        centres_ned_m=view.threats_ned_m,
        radii_m=view.attack_radius_m if steering.config.keep_out == "attack" else view.detection_radius_m,
        speeds_m_s=view.threat_speed_m_s,
        attack_m=view.attack_radius_m,
        ids=view.threat_ids,
        unit_m=view.unit_m,
    )
    route = () if demand.route is None else demand.route.pieces
    dt_s = steering.config.guidance_step_s
    hints = Hints(route, keep_right=crowded, towards_rad=towards_rad)
    verdict = steering.guard.check(wanted, moment.motion, discs, moment.now_s, dt_s, hints)
    # A path that is clear of all discs heard of is certified only if no other is still to be heard of.
    return verdict if view.whole else replace(verdict, certified_s=0.0)


def _is_crowded(motion: Motion, view: View, interaction_m: float) -> bool:
    """Return whether another vehicle is within the interaction radius."""
    if len(view.traffic_ned_m) == 0:
        return False
    apart_m = np.hypot(view.traffic_ned_m[:, 0] - motion.north_m, view.traffic_ned_m[:, 1] - motion.east_m)
    return bool(np.any(apart_m <= interaction_m))


def _rules(config: Config, can_stop: bool) -> Rules:
    limits = config.limits
    return Rules(
        separation_m=config.separation_m,
        n_max=limits.n_max,
        speed_m_s=limits.speed_m_s,
        reaction_s=limits.reaction_s,
        can_stop=can_stop,
        braking_m_s2=limits.braking_m_s2 if can_stop else None,
        position_error_m=limits.position_error_m,
    )


def _guard_limits(limits: LimitsSection, can_stop: bool) -> Limits:
    return Limits(
        speed_min_m_s=0.0 if can_stop else limits.speed_m_s,
        speed_max_m_s=limits.speed_m_s,
        n_max=limits.n_max,
        altitude_min_m=limits.height_min_m,
        altitude_max_m=limits.height_max_m,
        braking_m_s2=limits.braking_m_s2 if can_stop else None,
        fence_ned_m=limits.fence,
        exclusions_ned_m=limits.exclusions,
        reaction_s=limits.reaction_s,
        rate_share=limits.rate_share,
        wind_m_s=limits.wind_m_s,
        position_error_m=limits.position_error_m,
    )
