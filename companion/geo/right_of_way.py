"""Sizes of the right of way: what each vehicle reserves, and how far off another must be to matter.

The rule itself is companion/guidance/separation.py; the sizes stand here because the lint of a mission needs them, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.geo.kinematics import GRAVITY_M_S2, turn_rate_rad_s
from companion.guard.types import Motion

GREATEST_STEP_TURN_RAD = 2.8
"""Greatest heading change by which a circle to the right is commanded: beyond pi it would be a turn to the left."""
UNEVENNESS = 0.5
"""Greatest part of its half of a gap that a vehicle leaves unused, depending on its position: vehicles in an exactly
symmetric situation would block each other for ever."""
LEAST_PART = 0.5 * (1.0 - UNEVENNESS)
"""The least part of a gap that a vehicle uses."""
SPEED_UP_SHARE = 1.25
"""Acceleration of a vehicle that can stop, as a multiple of the deceleration that it is counted on to brake with: the
copters' adapters count on 0.8 of the acceleration that is set in the vehicle."""


@dataclass(frozen=True)
class Rules:
    """The parameters of the rule, equal for all vehicles of an airspace: it is safe between those that share them."""

    separation_m: float  # D_safe, between centres
    n_max: float  # load factor of the circle that each reserves
    speed_m_s: float  # cruise speed
    reaction_s: float = 0.0  # from a decision to its effect, beyond the decision's own step
    can_stop: bool = False
    braking_m_s2: float | None = None  # needed if can_stop
    position_error_m: float = 0.0  # greatest error of any position that is used, own or a neighbour's


def circle(speed_m_s: float, rules: Rules, dt_s: float) -> tuple[float, float]:
    """Return turn rate, rad/s, and radius, m, of the circle to the right.

    It is the tightest circle, unless one step of that would turn by more than GREATEST_STEP_TURN_RAD.
    """
    rate_rad_s = turn_rate_rad_s(speed_m_s, rules.n_max)
    most_rad_s = GREATEST_STEP_TURN_RAD / dt_s
    if rate_rad_s <= most_rad_s:
        return rate_rad_s, speed_m_s / rate_rad_s
    # The vehicle turns faster than along the circle and flies a polygon, which leaves the circle by less than a step.
    return most_rad_s, speed_m_s / most_rad_s + speed_m_s * dt_s


def braking_m_s2(rules: Rules) -> float:
    """Return the deceleration that the rules give; raise ValueError if it is not positive."""
    if rules.braking_m_s2 is None or rules.braking_m_s2 <= 0.0:
        raise ValueError(f"rules.braking_m_s2 is {rules.braking_m_s2}, a vehicle that can stop needs a positive one")
    return rules.braking_m_s2


def quickest_m_s(speed_m_s: float, rules: Rules) -> float:
    """Return the greatest speed that a vehicle seen at `speed_m_s` has when a decision made now takes effect."""
    gained_m_s = SPEED_UP_SHARE * braking_m_s2(rules) * rules.reaction_s
    return max(speed_m_s, min(speed_m_s + gained_m_s, rules.speed_m_s))


def way_to_stop_m(speed_m_s: float, rules: Rules) -> float:
    """Return the length of the straight line on which a vehicle that decides now to brake comes to a stop, m.

    What a vehicle that seems to stand may still fly, in any direction, is part of `way_width_m`, not of this.
    """
    return _stopping_m(speed_m_s, rules) - _stopping_m(0.0, rules)


def way_width_m(speed_m_s: float, rules: Rules) -> float:
    """Return how far off its straight line a vehicle may stop, by a command that it obeyed until it braked, m.

    That command may still have turned it, or set it in motion from a standstill in any direction.
    """
    sideways_m_s = rules.n_max * GRAVITY_M_S2 * rules.reaction_s
    turned_m = sideways_m_s * (0.5 * rules.reaction_s + quickest_m_s(speed_m_s, rules) / (2.0 * braking_m_s2(rules)))
    return _stopping_m(0.0, rules) + turned_m


def _stopping_m(speed_m_s: float, rules: Rules) -> float:
    quickest = quickest_m_s(speed_m_s, rules)
    return quickest * rules.reaction_s + quickest**2 / (2.0 * braking_m_s2(rules))


def reserved_radius_m(speed_m_s: float, rules: Rules, dt_s: float) -> float:
    """Return the radius of the disc that holds what a vehicle reserves, with half D_safe and the position error, m.

    The disc is that of the circle to the right or, for a vehicle that can stop, of its way to a stop in any direction.
    """
    margin_m = 0.5 * rules.separation_m + rules.position_error_m
    if rules.can_stop:
        return way_to_stop_m(speed_m_s, rules) + way_width_m(speed_m_s, rules) + margin_m
    return circle(speed_m_s, rules, dt_s)[1] + margin_m


def interaction_radius_m(rules: Rules, dt_s: float) -> float:
    """Return the distance between two vehicles at cruise speed beyond which neither constrains the other, m.

    For vehicles that cannot stop it is the distance in the worst geometry, each with the other abeam to its right. The
    rule guarantees separation only if the detector sees at least this far.
    """
    cruise_m_s = rules.speed_m_s
    discs_m = 2.0 * reserved_radius_m(cruise_m_s, rules, dt_s)
    rate_rad_s, _ = circle(cruise_m_s, rules, dt_s)
    if rules.can_stop:
        decided_s = dt_s + rules.reaction_s
        # What a step adds to the way to a stop: the distance flown, and the turn of the whole way.
        turned_m = min(1.0, rate_rad_s * decided_s) * way_to_stop_m(cruise_m_s, rules)
        return discs_m + (cruise_m_s * decided_s + turned_m) / LEAST_PART
    fits_m = cruise_m_s * dt_s / LEAST_PART
    return discs_m + 2.0 * (fits_m + cruise_m_s / rate_rad_s) + 4.0 * cruise_m_s * rules.reaction_s


def least_spacing_m(rules: Rules, dt_s: float) -> float:
    """Return the distance from which the rule keeps two vehicles apart, whatever their headings, m.

    That is where nothing that they reserve can overlap: at cruise speed, or at rest for vehicles that can stop.
    """
    if rules.can_stop:
        return 2.0 * reserved_radius_m(0.0, rules, dt_s)
    cruise_m_s = rules.speed_m_s
    rate_rad_s, _ = circle(cruise_m_s, rules, dt_s)
    to_centre_m = cruise_m_s / rate_rad_s
    return 2.0 * (reserved_radius_m(cruise_m_s, rules, dt_s) + to_centre_m + 2.0 * cruise_m_s * rules.reaction_s)


def least_detector_range_m(rules: Rules, dt_s: float) -> float:
    """Return the range from which a detector shows every neighbour before anything that two reserve overlaps, m.

    In the worst geometry a neighbour crosses this distance just after a look, and comes nearer until the next.
    """
    cruise_m_s = rules.speed_m_s
    if rules.can_stop:
        return 2.0 * (reserved_radius_m(cruise_m_s, rules, dt_s) + cruise_m_s * dt_s)
    return least_spacing_m(rules, dt_s) + 2.0 * cruise_m_s * dt_s


def growth_m(speed_m_s: float, age_s: float, moving_told: bool, rules: Rules, dt_s: float) -> float:
    """Return how far what a vehicle reserves may lie off where a word of an age puts it, m (docs/separation.md).

    The word puts a vehicle that can stop on the way that it flew at `speed_m_s` for its age, and then to a stop; any
    other on the circle to the right at the end of that way. Without a told velocity (`moving_told`) it stands there. A
    word of now needs no growth.
    """
    if age_s <= 0.0:
        return 0.0
    quickest = max(speed_m_s, rules.speed_m_s)
    sideways = rules.n_max * GRAVITY_M_S2
    if not rules.can_stop:
        if not moving_told:
            return quickest * age_s + 2.0 * circle(quickest, rules, dt_s)[1]
        # A circle's centre moves at up to twice the speed, to a left turn; where it is carried on, at the speed.
        return speed_m_s * age_s + min(0.5 * sideways * age_s, 2.0 * speed_m_s) * age_s
    most_m = quickest * age_s + way_to_stop_m(quickest, rules)
    if not moving_told:
        return most_m
    braking = braking_m_s2(rules)
    gained_m_s = min(quickest - speed_m_s, SPEED_UP_SHARE * braking * age_s)
    gaining_s = gained_m_s / (SPEED_UP_SHARE * braking)
    ahead_m = gained_m_s * (age_s - 0.5 * gaining_s)
    ahead_m += way_to_stop_m(speed_m_s + gained_m_s, rules) - way_to_stop_m(speed_m_s, rules)
    aside_m = 0.5 * sideways * age_s * (age_s + (speed_m_s + gained_m_s) / braking)
    return min(ahead_m + aside_m, most_m)


def greatest_growth_m(rules: Rules, dt_s: float) -> float:
    """Return the growth from which on a word of another vehicle is too old to promise anything by, m.

    It is the interaction radius: beyond that a word would forbid more than the other vehicle itself could.
    """
    return interaction_radius_m(rules, dt_s)


def reserved_gap_m(first: Motion, second: Motion, rules: Rules, dt_s: float) -> float:
    """Return the distance between what two vehicles reserve, m; below 0 the rule cannot promise to keep them apart.

    For vehicles that can stop it is a lower bound, as if each braked towards the other.
    """
    radii_m = sum(reserved_radius_m(each.speed_m_s, rules, dt_s) for each in (first, second))
    if rules.can_stop:
        return math.dist(first.position_ned_m, second.position_ned_m) - radii_m
    in_flight_m = 2.0 * rules.reaction_s * (first.speed_m_s + second.speed_m_s)
    return math.dist(centre_ned_m(first, rules, dt_s), centre_ned_m(second, rules, dt_s)) - radii_m - in_flight_m


def centre_ned_m(motion: Motion, rules: Rules, dt_s: float) -> tuple[float, float]:
    """Return the centre of a vehicle's circle to the right, m."""
    rate_rad_s, _ = circle(motion.speed_m_s, rules, dt_s)
    radius_m = motion.speed_m_s / rate_rad_s
    return (
        motion.north_m - radius_m * math.sin(motion.heading_rad),
        motion.east_m + radius_m * math.cos(motion.heading_rad),
    )
