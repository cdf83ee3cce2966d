"""Whether the right of way can keep a mission's vehicles apart: spacing of starts, detectors, one turn limit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from companion.geo.right_of_way import Rules, least_detector_range_m, least_spacing_m, reserved_gap_m
from companion.guard.types import Motion
from companion.mission.model import Mission
from companion.onboard.lint.fleet import Flyer

SPACING_STEP_M = 0.1
"""Accuracy of a least spacing that a warning names."""


def _motion(flyer: Flyer) -> Motion:
    speed_m_s = 0.0 if flyer.steering.can_stop else flyer.steering.config.limits.speed_m_s
    return Motion(*flyer.spec.position_ned_m, math.radians(flyer.spec.heading_deg or 0.0), speed_m_s)


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
    """Return the pairs whose reserved room overlaps at the start, so that the right of way promises them nothing."""
    concerns = []
    for group in _together(mission, fleet):
        places_m = np.array([flyer.spec.position_ned_m for flyer in group])
        within_m = max(least_spacing_m(_rules(flyer), mission.guidance_step_s) for flyer in group)
        for index, flyer in enumerate(group):
            apart_m = np.hypot(*(places_m[:index] - places_m[index]).T)
            for other in np.flatnonzero(apart_m < within_m).tolist():
                needed_m = _needed_spacing_m(
                    _motion(group[other]), _motion(flyer), _rules(flyer), mission.guidance_step_s
                )
                if apart_m[other] < needed_m:
                    concerns.append(
                        f"id {flyer.spec.id} starts {apart_m[other]:.0f} m from agent {group[other].spec.id}: at these "
                        f"headings the right of way needs {needed_m:.0f} m to promise separation_m "
                        f"{mission.separation_m:g}"
                    )
    return concerns


def _needed_spacing_m(first: Motion, second: Motion, rules: Rules, dt_s: float) -> float:
    """Return the distance from which two vehicles reserve separate room, moved apart on the line between them, m."""
    apart_m = math.dist(first.position_ned_m, second.position_ned_m)
    if reserved_gap_m(first, second, rules, dt_s) >= 0.0:
        return apart_m
    along = (second.north_m - first.north_m) / apart_m, (second.east_m - first.east_m) / apart_m
    low_m, high_m = apart_m, least_spacing_m(rules, dt_s)
    while high_m - low_m > SPACING_STEP_M:
        middle_m = 0.5 * (low_m + high_m)
        place_m = first.north_m + middle_m * along[0], first.east_m + middle_m * along[1]
        moved = Motion(*place_m, second.heading_rad, second.speed_m_s)
        if reserved_gap_m(first, moved, rules, dt_s) < 0.0:
            low_m = middle_m
        else:
            high_m = middle_m
    return high_m


def _rules(flyer: Flyer) -> Rules:
    rules = flyer.steering.rules
    assert rules is not None
    return rules


def too_short_a_detector(mission: Mission, fleet: Sequence[Flyer]) -> list[str]:
    """Return for each group of vehicles at one height why the detector's range is too short for it, if it is."""
    concerns = []
    for group in _together(mission, fleet):
        flyer = max(group, key=lambda one: least_detector_range_m(_rules(one), mission.guidance_step_s))
        needed_m = least_detector_range_m(_rules(flyer), mission.guidance_step_s)
        if mission.detector_range_m < needed_m:
            concerns.append(
                f"{mission.detector_range_m:g}: the right of way needs {needed_m:.0f} m to promise separation_m "
                f"{mission.separation_m:g} at agent {flyer.spec.id}'s {_rules(flyer).speed_m_s:g} m/s and n_max "
                f"{_rules(flyer).n_max:g}"
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
                f"{_rules(most).n_max:g}: the right of way promises separation_m {mission.separation_m:g} only between "
                "vehicles of one n_max"
            )
    return concerns
