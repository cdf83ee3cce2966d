"""The pattern that is flown, as pure functions of its state: steps of course and speed, stops, a hold or a circle."""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

from companion.geo.kinematics import turn_rate_rad_s
from companion.guard.types import Motion
from companion.guidance.approach import GAIN_1_S
from companion.guidance.steering import attraction, loiter_attraction, loiter_radius_m
from companion.onboard.config import LimitsSection

LONGEST_TURN_S = 8.0
"""Longest time that a step of course takes at the greatest turn rate configured; slow turners get smaller steps."""
TURN_RAD = math.pi / 2.0
"""Step of course of a vehicle that turns by that within LONGEST_TURN_S."""
SETTLED_RAD = math.radians(6.0)
"""Distance from the course asked for within which it counts as reached."""
SETTLED_SHARE = 0.1
"""Share of its speed by which a vehicle that can stop may be off that and still count as having reached it."""
SETTLED_S = 2.5
"""Time for which course and speed must have been reached before the next step."""
STANDING_M_S = 0.5
"""Speed below which a vehicle stands."""
STANDING_S = 1.5
"""Time for which a vehicle must have stood before the next step."""
PATIENCE = 2.0
"""Time allowed for a step, in those that it takes with what is configured."""
PATIENCE_S = 4.0
"""Time that is always allowed for a step beyond that."""
HOLD_S = 15.0
"""Time for which a place is held."""
CIRCLES = 1.6
"""Number of times that a plane goes around its circle: until it is on it, and then once."""
SLOW_SHARE = 0.5
"""Lesser speed of a vehicle that can stop, as a share of its cruise speed."""
SLOW_AIRSPEED_SHARE = 0.85
"""Lesser speed of a plane, as a share of its cruise speed, if its autopilot lets it fly so slowly."""
SLOW_S = 8.0
"""Time of a plane's step of speed: ArduPlane takes 5.9 s for 3 m/s (docs/autopilots.md)."""
STANDING_WITHIN_M = 0.5
"""Distance from the place that is held within which a vehicle is not moved back."""


class Act(Enum):
    """What a leg of the pattern asks for."""

    COURSE = "course"
    """A course at a speed, until both are reached."""
    SPEED = "speed"
    """A speed, for a time: a plane's speed over ground does not say whether it has it."""
    STOP = "stop"
    """Standing still."""
    HOLD = "hold"
    """Standing at the place where the leg began."""
    CIRCLE = "circle"
    """Circling about the place to the right of where the leg began."""


class Leg(NamedTuple):
    """One step of the pattern."""

    act: Act
    words: str
    course_rad: float
    """Course, from the pattern's first one."""
    speed_m_s: float
    most_s: float
    """Longest time until the next leg begins."""


class Pattern(NamedTuple):
    """The legs in their order, the course of the first (rad from grid north) and the radius of the circle."""

    legs: tuple[Leg, ...]
    first_rad: float
    radius_m: float


class Progress(NamedTuple):
    """How far a pattern is flown: the leg, when and where it began, and since when what it asks for is reached."""

    leg: int
    since_s: float
    place_ned_m: tuple[float, float]
    reached_s: float | None = None


def pattern_of(
    limits: LimitsSection, can_stop: bool, slow_m_s: float | None, step_s: float, first_rad: float
) -> Pattern:
    """Return the pattern for a vehicle with these limits, which it can keep.

    Args:
        limits: What is configured, or less where the vehicle's parameters leave less.
        can_stop: Whether the vehicle can stop.
        slow_m_s: Lesser speed for steps of speed; None: the vehicle has one speed only.
        step_s: Time between two decisions.
        first_rad: Course of the first leg, from grid north.

    """
    speed_m_s = limits.speed_m_s
    rate_rad_s = turn_rate_rad_s(speed_m_s, limits.n_max)
    turn_rad = min(TURN_RAD, rate_rad_s * LONGEST_TURN_S)
    turn_s = PATIENCE * turn_rad / rate_rad_s + PATIENCE_S + SETTLED_S
    radius_m = loiter_radius_m(speed_m_s, limits.n_max, step_s)
    legs = [Leg(Act.COURSE, "straight on", 0.0, speed_m_s, _speed_s(limits, can_stop))]

    def turn(sides: int) -> None:
        for _ in range(abs(sides)):
            course_rad = legs[-1].course_rad + math.copysign(turn_rad, sides)
            words = f"{'right' if sides > 0 else 'left'} by {math.degrees(turn_rad):.0f} deg"
            legs.append(Leg(Act.COURSE, words, course_rad, speed_m_s, turn_s))

    def speed(act: Act, words: str, to_m_s: float, most_s: float) -> None:
        legs.append(Leg(act, words, legs[-1].course_rad, to_m_s, most_s))

    most_s = _speed_s(limits, can_stop)
    turn(2)
    if slow_m_s is not None:
        step = Act.COURSE if can_stop else Act.SPEED
        speed(step, f"slow to {slow_m_s:.3g} m/s", slow_m_s, most_s)
        speed(step, f"faster to {speed_m_s:.3g} m/s", speed_m_s, most_s)
    turn(-2)
    if can_stop:
        speed(Act.STOP, "stop", 0.0, most_s)
        speed(Act.COURSE, f"start to {speed_m_s:.3g} m/s", speed_m_s, most_s)
    turn(-1)
    turn(1)
    if can_stop:
        speed(Act.STOP, "stop", 0.0, most_s)
        speed(Act.HOLD, "hold the place", 0.0, HOLD_S)
    else:
        speed(Act.CIRCLE, "circle", speed_m_s, CIRCLES * math.tau * radius_m / speed_m_s)
    return Pattern(tuple(legs), first_rad, radius_m)


def _speed_s(limits: LimitsSection, can_stop: bool) -> float:
    """Return the time allowed for a step of speed."""
    return PATIENCE * limits.speed_m_s / limits.braking_m_s2 + PATIENCE_S if can_stop else SLOW_S


def begun(pattern: Pattern, motion: Motion, now_s: float) -> Progress:
    """Return the progress at the beginning of a pattern."""
    return _at_leg(pattern, 0, motion, now_s)


def advanced(pattern: Pattern, progress: Progress, motion: Motion, now_s: float) -> Progress | None:
    """Return the progress now; None once the pattern is flown."""
    leg = pattern.legs[progress.leg]
    reached_s = None
    if _is_reached(leg, pattern, motion):
        reached_s = now_s if progress.reached_s is None else progress.reached_s
    waits_s = STANDING_S if leg.act is Act.STOP else SETTLED_S
    done = reached_s is not None and now_s - reached_s >= waits_s
    if not done and now_s - progress.since_s < leg.most_s:
        return progress._replace(reached_s=reached_s)
    if progress.leg + 1 == len(pattern.legs):
        return None
    return _at_leg(pattern, progress.leg + 1, motion, now_s)


def wanted(pattern: Pattern, progress: Progress, motion: Motion) -> tuple[float, float]:
    """Return the heading (rad from grid north) and the speed (m/s) that the pattern wants now."""
    leg = pattern.legs[progress.leg]
    if leg.act is Act.CIRCLE:
        return loiter_attraction(
            motion.position_ned_m, progress.place_ned_m, pattern.radius_m
        ).heading_rad, leg.speed_m_s
    course_rad = (pattern.first_rad + leg.course_rad) % math.tau
    if leg.act is Act.HOLD:
        pull = attraction(motion.position_ned_m, progress.place_ned_m)
        if pull.strength_m > STANDING_WITHIN_M:
            return pull.heading_rad, min(GAIN_1_S * pull.strength_m, 1.0)
    return course_rad, leg.speed_m_s


def _is_reached(leg: Leg, pattern: Pattern, motion: Motion) -> bool:
    if leg.act is Act.STOP:
        return motion.speed_m_s < STANDING_M_S
    if leg.act is not Act.COURSE:
        return False
    off_rad = math.remainder(motion.heading_rad - pattern.first_rad - leg.course_rad, math.tau)
    # Over ground a plane's speed is the wind's as well.
    stops = any(one.act is Act.STOP for one in pattern.legs)
    off_m_s = abs(motion.speed_m_s - leg.speed_m_s) if stops else 0.0
    return abs(off_rad) <= SETTLED_RAD and off_m_s <= SETTLED_SHARE * leg.speed_m_s


def _at_leg(pattern: Pattern, leg: int, motion: Motion, now_s: float) -> Progress:
    place_ned_m = motion.position_ned_m
    if pattern.legs[leg].act is Act.CIRCLE:
        right_rad = motion.heading_rad + math.pi / 2.0
        place_ned_m = (
            motion.north_m + pattern.radius_m * math.cos(right_rad),
            motion.east_m + pattern.radius_m * math.sin(right_rad),
        )
    return Progress(leg, now_s, place_ned_m)
