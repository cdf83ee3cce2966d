"""Whether the right of way can keep a mission's vehicles apart: spacing of starts, detectors, one turn limit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from companion.geo.right_of_way import (
    Rules,
    centre_ned_m,
    circle,
    greatest_growth_m,
    growth_m,
    least_detector_range_m,
    least_spacing_m,
)
from companion.guard.types import Motion
from companion.mission.model import Mission
from companion.onboard.lint.fleet import Flyer

MOST_GROWN = 0.5
"""Growth of a word, in separations, up to which vehicles that can stop and only hear of one another kept their
separation in every flight of docs/separation.md ("What is told grows with its age")."""


def _motion(flyer: Flyer) -> Motion:
    heading_rad = math.radians(flyer.spec.heading_deg or 0.0)
    return Motion(*flyer.spec.position_ned_m, heading_rad, flyer.steering.config.limits.speed_m_s)


def _together(mission: Mission, fleet: Sequence[Flyer]) -> list[list[Flyer]]:
    """Return the vehicles that follow the right of way, in groups that meet at one height; () for a lonely one."""
    apart_m = 0.5 * mission.layer_spacing_m
    groups: list[list[Flyer]] = []
    for flyer in sorted((one for one in fleet if one.steering.rules is not None), key=lambda one: one.height_m):
        if groups and (apart_m == 0.0 or flyer.height_m - groups[-1][-1].height_m < apart_m):
            groups[-1].append(flyer)
        else:
            groups.append([flyer])
    return [group for group in groups if len(group) > 1]


def starts_too_near(mission: Mission, fleet: Sequence[Flyer]) -> list[str]:
    """Return the pairs that start nearer to each other than the right of way can keep them apart."""
    concerns = []
    for group in _together(mission, fleet):
        places_m = np.array([flyer.spec.position_ned_m for flyer in group])
        within_m = max(least_spacing_m(_rules(flyer), mission.guidance_step_s) for flyer in group)
        for index, flyer in enumerate(group):
            apart_m = np.hypot(*(places_m[:index] - places_m[index]).T)
            for other in np.flatnonzero(apart_m < within_m).tolist():
                concern = _conflict(mission, group[other], flyer)
                if concern is not None:
                    concerns.append(
                        f"id {flyer.spec.id} starts {apart_m[other]:.0f} m from agent {group[other].spec.id}: {concern}"
                    )
    return concerns


def _conflict(mission: Mission, first: Flyer, second: Flyer) -> str | None:
    """Return why the right of way cannot keep two vehicles apart from their starts on, or None if it can.

    Vehicles that can stop stand at their starts, and go one after the other. Those that cannot stop can always circle
    to the right. That is enough where they do not come nearer than the separation while both do (measured on 230 pairs
    whose reserved discs overlap: 25 of 75 breached where they do, and 1 of 155, by less than a metre, where not).
    """
    rules, dt_s = _rules(first), mission.guidance_step_s
    one, two = _motion(first), _motion(second)
    if rules.can_stop:
        return None
    centres_m = [centre_ned_m(one, rules, dt_s), centre_ned_m(two, _rules(second), dt_s)]
    apart_m = math.dist(*centres_m)
    least_m = abs(apart_m - _spread_m(first, second, dt_s))
    if least_m >= mission.separation_m:
        return None
    return (
        f"if both circle to the right, as the right of way has them do at worst, they come within {least_m:.0f} m; at "
        f"these headings {_needed_m(mission, first, second):.0f} m keep separation_m {mission.separation_m:g} m"
    )


def _spread_m(first: Flyer, second: Flyer, dt_s: float) -> float:
    """Return by how much two circling vehicles are nearer to each other at most than their circles' centres, m.

    At one turn rate they stay at the same angle to each other; at different rates they come to every angle.
    """
    circles = [circle(_rules(flyer).speed_m_s, _rules(flyer), dt_s) for flyer in (first, second)]
    (rate_rad_s, radius_m), (other_rad_s, other_m) = circles
    if rate_rad_s != other_rad_s:
        return radius_m + other_m
    turn_rad = _motion(second).heading_rad - _motion(first).heading_rad
    return math.hypot(radius_m - other_m * math.cos(turn_rad), other_m * math.sin(turn_rad))


def _needed_m(mission: Mission, first: Flyer, second: Flyer) -> float:
    """Return from which distance on, along the line between two starts, both may circle to the right, m."""
    dt_s = mission.guidance_step_s
    one, two = _motion(first), _motion(second)
    start_m = math.dist(one.position_ned_m, two.position_ned_m)
    ahead = ((two.north_m - one.north_m) / start_m, (two.east_m - one.east_m) / start_m)
    centres_m = [centre_ned_m(one, _rules(first), dt_s), centre_ned_m(two, _rules(second), dt_s)]
    beside_m = [centres_m[1][k] - centres_m[0][k] - start_m * ahead[k] for k in (0, 1)]
    along_m = beside_m[0] * ahead[0] + beside_m[1] * ahead[1]
    across_m = abs(beside_m[0] * ahead[1] - beside_m[1] * ahead[0])
    wanted_m = mission.separation_m + _spread_m(first, second, dt_s)
    return math.sqrt(max(0.0, (wanted_m - across_m) * (wanted_m + across_m))) - along_m


def _rules(flyer: Flyer) -> Rules:
    rules = flyer.steering.rules
    assert rules is not None
    return rules


def too_short_a_detector(mission: Mission, fleet: Sequence[Flyer]) -> list[str]:
    """Return for each group of vehicles at one height why the detector's range is too short for it, if it is."""
    concerns = []
    for group in _together(mission, fleet) if mission.detector == "adsb" else []:
        flyer = max(group, key=lambda one: least_detector_range_m(_rules(one), mission.guidance_step_s))
        needed_m = least_detector_range_m(_rules(flyer), mission.guidance_step_s)
        if mission.detector_range_m < needed_m:
            concerns.append(
                f"{mission.detector_range_m:g} m: the right of way needs {needed_m:.0f} m to promise separation_m "
                f"{mission.separation_m:g} m at agent {flyer.spec.id}'s {_rules(flyer).speed_m_s:g} m/s and n_max "
                f"{_rules(flyer).n_max:g}"
            )
    return concerns


def too_little_known(mission: Mission, fleet: Sequence[Flyer]) -> list[str]:
    """Return for each group of vehicles at one height why the broadcast alone cannot keep it apart, if that is so."""
    concerns = []
    for group in _together(mission, fleet) if mission.detector != "adsb" else []:
        if mission.detector == "none" or mission.case == "II":
            concerns.append(
                f"'{mission.detector}'{' in Case II' * (mission.detector != 'none')}: agents know nothing of one "
                f"another, so nothing keeps separation_m {mission.separation_m:g} m"
            )
            continue
        # At worst a place is told anew just after a step, on a velocity that is half a period older.
        age_s = (
            1.5 * mission.broadcast_period_s + mission.link.delay_s + mission.link.jitter_s + mission.guidance_step_s
        )
        rules = _rules(max(group, key=lambda one: _rules(one).speed_m_s))
        grown_m = growth_m(rules.speed_m_s, age_s, True, rules, mission.guidance_step_s)
        most_m = greatest_growth_m(rules, mission.guidance_step_s)
        if rules.can_stop:
            most_m = min(most_m, MOST_GROWN * mission.separation_m)
        if grown_m > most_m:
            concerns.append(
                f"'broadcast': with broadcast_period_s {mission.broadcast_period_s:g} s a word of another agent is up "
                f"to {age_s:.3g} s old and {grown_m:.0f} m off at {rules.speed_m_s:g} m/s: too much to promise "
                f"separation_m {mission.separation_m:g} m by"
            )
    return concerns


def mixed_turn_limits(mission: Mission, fleet: Sequence[Flyer]) -> list[str]:
    """Return for each group of vehicles at one height two of them whose turn limits differ, if any do."""
    concerns = []
    for group in _together(mission, fleet):
        least, most = (pick(group, key=lambda one: _rules(one).n_max) for pick in (min, max))
        if _rules(least).n_max < _rules(most).n_max and not least.steering.can_stop:
            concerns.append(
                f"id {least.spec.id} has n_max {_rules(least).n_max:g} and id {most.spec.id} "
                f"{_rules(most).n_max:g}: the right of way promises separation_m {mission.separation_m:g} m only "
                "between vehicles of one n_max"
            )
    return concerns
