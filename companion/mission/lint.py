"""Warnings before a flight about a mission that is legal but will probably not end as its author hopes."""

from __future__ import annotations

import math

from companion.geo.kinematics import turn_rate_rad_s
from companion.mission.model import RANGE_RESERVE, Mission, is_obstacle

APPROACH_SHARE = 0.1
"""Distance outside a detection disc, as a share of R_d, within which the surrogate's repulsion outweighs attraction.
Measured: 0.09 R_d for pairwise at the paper's numbers, more for analytic."""


def lint(mission: Mission) -> list[str]:
    """Return the warnings about a resolved mission, one line per kind, which names the first item that it concerns."""
    found = [
        _first("targets", _unapproachable(mission)),
        _first("targets", _too_fast(mission)),
        _first("agents", _starts_inside(mission)),
        _first("threats", _reaches_nobody(mission)),
        _first("agents", _too_wide_a_turn(mission)),
        _first("agents", _too_short_a_range(mission)),
    ]
    if mission.link.loss == 1.0:
        found.append("link.loss: 1: no vehicle will hear anything")
    if mission.case == "II" and mission.losses and mission.report_period_s == 0.0:
        found.append("losses: nobody reports in this Case II, so no loss can be known: its target may stay uncovered")
    if mission.case == "I" and mission.report_period_s > 0.0:
        found.append(f"report_period_s: {mission.report_period_s:g}: no effect in Case I, where agents are detected")
    if mission.case == "II" and mission.detector_range_m <= mission.separation_m:
        found.append(
            f"detector_range_m: {mission.detector_range_m:g}: in Case II agents then see each other only when they are "
            f"already within separation_m {mission.separation_m:g}, or not at all"
        )
    return [warning for warning in found if warning is not None]


def _first(key: str, concerns: list[str]) -> str | None:
    if not concerns:
        return None
    more = f" (and {len(concerns) - 1} more like it)" if len(concerns) > 1 else ""
    return f"{key}: {concerns[0]}{more}"


def _unapproachable(mission: Mission) -> list[str]:
    return [
        f"id {target.id} is {distance_m:.0f} m from threat {threat.id}, whose detection_radius_m is "
        f"{threat.detection_radius_m:g}: the law keeps agents farther off than it can be approached"
        for target in mission.targets
        for threat in mission.threats
        if any(is_obstacle(mission, agent.id, threat) for agent in mission.agents)
        and (distance_m := math.dist(target.position_ned_m, threat.position_ned_m)) - mission.arrival_radius_m
        < threat.detection_radius_m * (1 + APPROACH_SHARE)
    ]


def _too_fast(mission: Mission) -> list[str]:
    fastest_m_s = max(agent.speed_m_s for agent in mission.agents)
    return [
        f"id {target.id} has speed_bound_m_s {target.speed_bound_m_s:g} and moves: it may outrun every agent, whose "
        f"speed_m_s is at most {fastest_m_s:g}"
        for target in mission.targets
        if target.motion != "static" and target.speed_bound_m_s >= fastest_m_s
    ]


def _starts_inside(mission: Mission) -> list[str]:
    return [
        f"id {agent.id} starts inside detection_radius_m of threat {threat.id}; that is a depth, but no entry"
        for agent in mission.agents
        for threat in mission.threats
        if is_obstacle(mission, agent.id, threat)
        and math.dist(agent.position_ned_m, threat.position_ned_m) < threat.detection_radius_m
    ]


def _reaches_nobody(mission: Mission) -> list[str]:
    return [
        f"id {threat.id} reaches no agent's height with its floor_m and ceiling_m, which count from sea level, so "
        "nobody keeps clear of it"
        for threat in mission.threats
        if not any(is_obstacle(mission, agent.id, threat) for agent in mission.agents)
    ]


def _too_wide_a_turn(mission: Mission) -> list[str]:
    return [
        f"id {agent.id} turns with a radius of {radius_m:.0f} m, more than arrival_radius_m "
        f"{mission.arrival_radius_m:g}: it may circle its target for ever"
        for agent in mission.agents
        if (radius_m := agent.speed_m_s / turn_rate_rad_s(agent.speed_m_s, agent.n_max)) > mission.arrival_radius_m
    ]


def _too_short_a_range(mission: Mission) -> list[str]:
    # With the policy to return, the way back must fit too.
    ways = 1.0 + RANGE_RESERVE if mission.range_policy == "return" else 1.0
    concerns = []
    for agent in mission.agents:
        nearest_m = min(math.dist(agent.position_ned_m, target.position_ned_m) for target in mission.targets)
        if ways * nearest_m > agent.range_m:
            concerns.append(
                f"id {agent.id} has range_m {agent.range_m:g}, too little for its nearest target, {nearest_m:.0f} m "
                f"away, under range_policy {mission.range_policy}"
            )
    return concerns
