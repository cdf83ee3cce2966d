"""The stages of one tick from the goal to the setpoint: law, right of way, turn limit, guard."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from companion.autopilot.adapter import Abilities
from companion.geo.kinematics import limit_turn, shorter_turn_rad
from companion.geo.right_of_way import Rules, interaction_radius_m
from companion.guard.guard import Guard
from companion.guard.lead import MOST_LEAD_RAD
from companion.guard.types import Discs, Hints, Limits, Motion, Setpoint, Verdict
from companion.guidance.approach import (
    STANDING_M_S,
    STANDING_WITHIN_M,
    STAYING_WITHIN_M,
    Flown,
    approach_speed_m_s,
    bounded,
    towards,
)
from companion.guidance.laws import SteeringDemand, SteeringLaw, Task, law_of
from companion.guidance.resolution import AtEffect
from companion.guidance.separation import give_way
from companion.guidance.steering import (
    Occupied,
    SteeringVector,
    attraction,
    circling,
    claim_m,
    loiter_place,
    loiter_radius_m,
    loiter_spacing_m,
)
from companion.guidance.view import View
from companion.onboard.config import Config, LimitsSection
from companion.onboard.decision import Purpose
from companion.onboard.engagement import Engagement
from companion.onboard.goal import ARRIVAL_SHARE, Goal, LoiterGeometry
from companion.onboard.law_settings import law_settings
from companion.onboard.limits import unable, within
from companion.onboard.navigation import COURSE_SPEED_M_S
from companion.onboard.neighbours import Neighbours, neighbours_of
from companion.onboard.obedience import Expected, Measured
from companion.onboard.standing import flown_of, pace_of, standing_place


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
    expected: Expected
    """What the vehicle is taken for as long as nothing worse is measured."""
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
    speed_share: float = 1.0
    """Share of its speed limit that is asked of a vehicle that can stop: less than 1 for one that does not answer."""
    flown: Flown | None = None
    """The velocity from which the next one is commanded, for a vehicle that can stop; None for another."""


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
    loiter_about_ned_m: tuple[float, float] | None
    """The target or home that this place was chosen for; None if it was chosen for where the vehicle was."""
    wanted_heading_rad: float
    """Heading that the law wants, before the right of way."""
    gave_way: str | None
    """Why the right of way changed heading or speed; None if it did not."""
    unseparated: str | None
    """From which agents no separation can be promised, because too little is known of them; None: from nobody."""
    turn_limited: bool
    verdict: Verdict
    """The guard's verdict, with the setpoint that may be sent."""


class _Demanded(NamedTuple):
    """The law's demand for going to a place or loitering at it."""

    demand: SteeringDemand
    speed_m_s: float
    """The speed to fly at: of a vehicle that can stop, the one from which it comes to stand there."""
    to_go_m: float
    """Length of the way to the place."""


class _Intent(NamedTuple):
    """The law's demand for a goal; the other fields are as in Steered."""

    purpose: Purpose
    reason: str
    demanded: _Demanded
    stay: str | None
    note: str | None
    loiter_place_ned_m: tuple[float, float] | None
    loiter_about_ned_m: tuple[float, float] | None


def steering_of(config: Config, can_stop: bool, law: SteeringLaw | None = None) -> Steering:
    """Return the steering by a configuration's limits, with the configured law unless the caller gives one.

    Raises:
        ValueError: the guard cannot hold these limits.

    """
    limits = config.limits
    guard = Guard(guard_limits(limits, can_stop))
    rules = _rules(config, can_stop) if config.law == "routed" else None
    n_max = limits.rate_share * limits.n_max
    radius_m = loiter_radius_m(limits.speed_m_s, n_max, config.guidance_step_s, limits.wind_m_s)
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
        expected=Expected(limits, can_stop, math.inf, config.guidance_step_s),
    )


def adapted(steering: Steering, configured: LimitsSection, abilities: Abilities) -> Steering:
    """Return the steering for a vehicle of these abilities; if they are not enough, the old one with the reason."""
    if abilities == steering.abilities:
        return steering
    limits = within(configured, abilities)
    why_not = unable(configured, abilities, can_stop=steering.can_stop)
    if why_not is None and limits != steering.config.limits:
        config = steering.config.model_copy(update={"limits": limits})
        try:
            steering = steering_of(config, steering.can_stop, steering.law if steering.own_law else None)
        except ValueError:
            why_not = f"its parameters leave {limits.speed_m_s:.3g} m/s and n_max {limits.n_max:.3g}: nothing to fly by"
    reached_m_s = min(abilities.airspeed_max_m_s, configured.airspeed_max_m_s or math.inf)
    expected = steering.expected._replace(airspeed_max_m_s=reached_m_s)
    return replace(steering, abilities=abilities, unable=why_not, expected=expected)


def outgrown(steering: Steering, configured: LimitsSection, abilities: Abilities) -> bool:
    """Return whether the vehicle's abilities now give other limits than those that were adopted, or are too few."""
    if abilities == steering.abilities:
        return False
    if within(configured, abilities) != steering.expected.limits:
        return True
    return unable(configured, abilities, can_stop=steering.can_stop) is not None


def reckoning(steering: Steering, configured: LimitsSection, found: Measured) -> Steering:
    """Return the steering for a vehicle that was measured to do worse than its abilities; unchanged if it is made so.

    The new guard keeps the commands in flight, and certifies anew from the present state. Limits that no guard can hold
    leave the steering as it was.
    """
    limits = within(configured, steering.abilities or Abilities(), found)
    if limits == steering.config.limits:
        return steering
    config = steering.config.model_copy(update={"limits": limits})
    try:
        remade = steering_of(config, steering.can_stop, steering.law if steering.own_law else None)
    except ValueError:
        return steering
    remade.guard.succeed(steering.guard)
    return replace(remade, abilities=steering.abilities, unable=steering.unable, expected=steering.expected)


def steer(steering: Steering, goal: Goal, moment: Moment, before: Engagement) -> Steered:
    """Pass the stages from the goal to the guarded setpoint; `before` holds the latches of the last tick."""
    limits, dt_s = steering.config.limits, steering.config.guidance_step_s
    in_force = None if before.setpoint is None else before.setpoint.setpoint
    motion = _as_commanded(steering, moment.motion, in_force)
    flown = flown_of(steering.config, motion, in_force) if steering.can_stop else None
    moment = moment._replace(motion=motion, flown=flown)
    around = None if steering.rules is None else neighbours_of(moment.view, motion, steering.rules, steering.config)
    crowded = not steering.can_stop and around is not None and around.within(motion, steering.interaction_m)
    intent = _intent(steering, goal, moment, before, crowded)
    wanted = turned = _wanted(intent.demanded, moment)
    if flown is not None and not goal.climbs:
        turned = bounded(flown, wanted, intent.demanded.to_go_m, pace_of(steering.config))
    last = None if limits.reaction_s == 0.0 else in_force
    # When this decision begins to act, the vehicle has turned by the last setpoint for the reaction time.
    from_rad = steering.guard.tip(motion, moment.now_s, dt_s)[0].heading_rad
    at_effect = None if last is None else AtEffect(from_rad % math.tau, last.speed_m_s)
    steered_rad, speed_m_s, gave_way = _right_of_way(steering, *turned, motion, (around, at_effect))
    if steering.can_stop:
        speed_m_s = min(speed_m_s, moment.speed_share * limits.speed_m_s)
    # The turn is limited at the greatest of the speeds until the end of the step, as the guard does.
    faster_m_s = max(motion.speed_m_s, speed_m_s)
    if last is not None and steering.can_stop:
        faster_m_s = max(faster_m_s, last.speed_m_s)
    aim_rad = steered_rad if in_force is None else _by_the_side_begun(from_rad, steered_rad, in_force.heading_rad)
    heading_rad, limited = limit_turn(from_rad, aim_rad, faster_m_s, limits.n_max, dt_s)
    setpoint = Setpoint(heading_rad, speed_m_s, steering.config.height_m)
    towards_rad = wanted.heading_rad if gave_way is None else steered_rad
    return Steered(
        purpose=intent.purpose,
        reason=intent.reason,
        demand=intent.demanded.demand,
        stay=intent.stay,
        note=intent.note,
        loiter_place_ned_m=intent.loiter_place_ned_m,
        loiter_about_ned_m=intent.loiter_about_ned_m,
        wanted_heading_rad=wanted.heading_rad,
        gave_way=gave_way,
        unseparated=None if around is None else around.unseparated,
        turn_limited=limited or turned.heading_rad != wanted.heading_rad,
        verdict=_guarded(steering, setpoint, moment, intent.demanded.demand, crowded, towards_rad),
    )


def _as_commanded(steering: Steering, motion: Motion, in_force: Setpoint | None) -> Motion:
    """Return the motion; a vehicle that can stop and hardly moves has the heading that it was commanded to fly on.

    Its yaw says nothing about that: a copter starts in any direction, and not all turn their nose while they stand.
    """
    if not steering.can_stop or in_force is None or motion.speed_m_s >= COURSE_SPEED_M_S:
        return motion
    return replace(motion, heading_rad=in_force.heading_rad)


def _intent(steering: Steering, goal: Goal, moment: Moment, before: Engagement, crowded: bool) -> _Intent:
    """Return the law's demand for the goal; if the law stays, its demand for loitering.

    The place where the vehicle has loitered up to now is kept, unless it is now to loiter at something else.
    """
    purpose, reason = goal.purpose, goal.reason
    place_ned_m = before.loiter_place_ned_m
    if goal.place_ned_m is None:
        if steering.can_stop and goal.about_ned_m not in (None, before.loiter_about_ned_m):
            place_ned_m = None
        if goal.climbs and moment.motion.speed_m_s >= STANDING_M_S:
            # Below its least height nothing but braking moves it: where it then stands is its place.
            place_ned_m = moment.motion.position_ned_m
        place_ned_m = _place_to_loiter(steering, moment, place_ned_m, goal.about_ned_m)
        demanded = _loiter(steering, place_ned_m, moment, crowded)
    else:
        demanded = _go(steering, goal.place_ned_m, purpose, moment, crowded)
    stay, note = demanded.demand.stay, demanded.demand.note
    if stay is not None:
        purpose, reason = Purpose.LOITER, stay
        place_ned_m = _place_to_loiter(steering, moment, place_ned_m, None)
        demanded = _loiter(steering, place_ned_m, moment, crowded)
    if purpose is not Purpose.LOITER:
        return _Intent(purpose, reason, demanded, stay, note, None, None)
    # Who must only wait keeps the place that it has, and what that was chosen for.
    about_ned_m = before.loiter_about_ned_m if goal.about_ned_m is None else goal.about_ned_m
    return _Intent(purpose, reason, demanded, stay, note, place_ned_m, about_ned_m)


def _place_to_loiter(
    steering: Steering,
    moment: Moment,
    before_ned_m: tuple[float, float] | None,
    about_ned_m: tuple[float, float] | None,
) -> tuple[float, float]:
    """Return the present loiter place, or a new one that leaves room to those that go first or are on their way.

    A vehicle that can stop does so as near to what it is to loiter at as it can stand soon, else where it comes to a
    stop; one that cannot circles about where it is.
    """
    view, loiter = moment.view, steering.loiter
    occupied = Occupied(view.loitering_ned_m, loiter.spacing_m, view.claimed_ned_m, loiter.claim_m)
    here_ned_m = moment.motion.position_ned_m
    if moment.flown is not None and before_ned_m is None:
        here_ned_m = standing_place(steering.config, view, here_ned_m, moment.flown, about_ned_m)
    return loiter_place(here_ned_m, occupied, before_ned_m)


def _go(
    steering: Steering, place_ned_m: tuple[float, float], purpose: Purpose, moment: Moment, crowded: bool
) -> _Demanded:
    """Return the law's demand for going to a place."""
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
    demand = steering.law.steer(task, moment.motion, moment.view, moment.now_s)
    to_go_m = pull.strength_m if demand.route is None or not demand.route.pieces else demand.route.length_m
    if moment.flown is None:
        return _Demanded(demand, steering.config.limits.speed_m_s, to_go_m)
    pace = pace_of(steering.config)
    to_go_m = max(0.0, to_go_m - moment.flown.speed_m_s * pace.delay_s)
    return _Demanded(demand, approach_speed_m_s(to_go_m, pace), to_go_m)


def _loiter(steering: Steering, place_ned_m: tuple[float, float], moment: Moment, crowded: bool) -> _Demanded:
    """Return the law's demand for loitering at a place."""
    here_ned_m = moment.motion.position_ned_m
    if moment.flown is None:
        config, motion = steering.config, moment.motion
        pose = (motion.north_m, motion.east_m, motion.heading_rad)
        lead_s = config.limits.reaction_s + 0.5 * config.guidance_step_s
        pull = circling(pose, motion.speed_m_s, lead_s, place_ned_m, steering.loiter.radius_m)
    else:
        way = towards(complex(*place_ned_m), complex(*here_ned_m), moment.flown, pace_of(steering.config))
        pull = SteeringVector(way.real, way.imag)
    task = Task(
        place_ned_m=place_ned_m,
        pull=pull,
        loitering=True,
        to_target=False,
        flown_m=moment.flown_m,
        arrival_m=ARRIVAL_SHARE * steering.config.arrival_radius_m,
        crowded=crowded,
    )
    demand = steering.law.steer(task, moment.motion, moment.view, moment.now_s)
    if moment.flown is None:
        return _Demanded(demand, steering.config.limits.speed_m_s, pull.strength_m)
    stands = moment.flown.speed_m_s == 0.0
    if math.dist(here_ned_m, place_ned_m) <= (STAYING_WITHIN_M if stands else STANDING_WITHIN_M):
        return _Demanded(demand, 0.0, 0.0)
    # The repulsion of a disc is far greater than the way to the place: it turns the vehicle, and does not chase it.
    away_m = min(demand.pull.strength_m, pull.strength_m + STAYING_WITHIN_M)
    return _Demanded(demand, approach_speed_m_s(away_m, pace_of(steering.config)), away_m)


def _wanted(demanded: _Demanded, moment: Moment) -> Flown:
    """Return the velocity that follows from the law's demand."""
    pull, speed_m_s = demanded.demand.pull, demanded.speed_m_s
    if pull.strength_m == 0.0 or (moment.flown is not None and speed_m_s == 0.0):
        return Flown(moment.motion.heading_rad, speed_m_s)
    return Flown(pull.heading_rad, speed_m_s)


def _right_of_way(
    steering: Steering,
    wanted_rad: float,
    speed_m_s: float,
    motion: Motion,
    among: tuple[Neighbours | None, AtEffect | None],
) -> tuple[float, float, str | None]:
    """Return heading (rad) and speed (m/s) by the right of way, and why it changed them, or None."""
    # Standing still is always allowed to one that can stop.
    around, at_effect = among
    if steering.rules is None or around is None or (steering.can_stop and speed_m_s == 0.0):
        return wanted_rad, speed_m_s, None
    given = give_way(wanted_rad, motion, around.peers, steering.rules, steering.config.guidance_step_s, at_effect)
    if given.reason is None:
        return given.heading_rad, speed_m_s, None
    if steering.can_stop:
        speed_m_s = min(speed_m_s, given.speed_m_s)
    return given.heading_rad, speed_m_s, f"{given.reason} ({around.name(given.peer)})"


def _by_the_side_begun(from_rad: float, wanted_rad: float, commanded_rad: float) -> float:
    """Return the heading to turn to: the wanted one or, if that is by the other side than was begun, a quarter turn.

    A vehicle that hardly answers stays opposite to what it wants, where the shorter side changes with every report.
    """
    turn_rad, begun_rad = shorter_turn_rad(from_rad, wanted_rad), shorter_turn_rad(commanded_rad, wanted_rad)
    if abs(turn_rad) <= MOST_LEAD_RAD or turn_rad * begun_rad >= 0.0:
        return wanted_rad
    return from_rad + math.copysign(MOST_LEAD_RAD, begun_rad)


def discs_of(view: View, keep_out: Literal["attack", "detection"]) -> Discs:
    """Return the keep-out discs of a view: those of the threats' attack or of their detection radii."""
    return Discs(
        centres_ned_m=view.threats_ned_m,
        radii_m=view.keep_out_m(keep_out),
        speeds_m_s=view.threat_speed_m_s,
        attack_m=view.attack_radius_m,
        ids=view.threat_ids,
        unit_m=view.unit_m,
        pictures=view.threat_pictures,
    )


def _guarded(
    steering: Steering, wanted: Setpoint, moment: Moment, demand: SteeringDemand, crowded: bool, towards_rad: float
) -> Verdict:
    view = moment.view
    discs = discs_of(view, steering.config.keep_out)
    route = () if demand.route is None else demand.route.pieces
    dt_s = steering.config.guidance_step_s
    hints = Hints(route, keep_right=crowded, towards_rad=towards_rad)
    verdict = steering.guard.check(wanted, moment.motion, discs, moment.now_s, dt_s, hints)
    # A path that is clear of all discs heard of is certified only if no other is still to be heard of.
    return verdict if view.whole else replace(verdict, certified_s=0.0)


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


def guard_limits(limits: LimitsSection, can_stop: bool) -> Limits:
    """Return the guard's limits for a vehicle that can keep the given ones."""
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
