"""Warnings before a flight about a mission that is legal but will probably not end as its author hopes."""

from __future__ import annotations

import math
from collections.abc import Sequence

from companion.geo.polygon import inside_polygon
from companion.mission.model import Mission, PathMotion, TargetSpec, ThreatSpec, agent_height_m, reaches
from companion.mission.values import RANGE_RESERVE


def lint(mission: Mission) -> list[str]:
    """Return the warnings about a resolved mission, one line per kind, which names the first item that it concerns."""
    found = [
        first_of("targets", _too_fast(mission)),
        first_of("targets", _leaving(mission)),
        first_of("targets", _standing_with_a_bound(mission.targets)),
        first_of("threats", _standing_with_a_bound(mission.threats)),
        first_of("wind", _unseen_in_wind(mission)),
        first_of("agents", _starts_inside(mission)),
        first_of("threats", _reaches_nobody(mission)),
        first_of("agents", _too_short_a_range(mission)),
    ]
    if mission.link.loss == 1.0:
        found.append("link.loss: 1: no vehicle will hear anything")
    if mission.case == "II" and mission.losses and mission.report_period_s == 0.0:
        found.append("losses: nobody reports in this Case II, so no loss can be known: its target may stay uncovered")
    if mission.case == "I" and mission.report_period_s > 0.0:
        found.append(f"report_period_s: {mission.report_period_s:g} s: no effect in Case I, where agents are detected")
    if mission.case == "II" and mission.detector == "adsb" and mission.detector_range_m <= mission.separation_m:
        found.append(
            f"detector_range_m: {mission.detector_range_m:g} m: in Case II agents then see each other only when they "
            f"are already within separation_m {mission.separation_m:g} m, or not at all"
        )
    return [warning for warning in found if warning is not None]


def first_of(key: str, concerns: list[str]) -> str | None:
    """Return one line for concerns of one kind: the mission's key, the first of them, and how many more there are."""
    if not concerns:
        return None
    more = f" (and {len(concerns) - 1} more like it)" if len(concerns) > 1 else ""
    return f"{key}: {concerns[0]}{more}"


def _too_fast(mission: Mission) -> list[str]:
    fastest_m_s = max(agent.speed_m_s for agent in mission.agents)
    return [
        f"id {target.id} has speed_bound_m_s {target.speed_bound_m_s:g} m/s and moves: it may outrun every agent, "
        f"whose speed_m_s is at most {fastest_m_s:g} m/s"
        for target in mission.targets
        if target.motion != "static" and target.speed_bound_m_s >= fastest_m_s
    ]


def _leaving(mission: Mission) -> list[str]:
    """Return the targets whose paths lead to where no agent may follow."""
    concerns = []
    for target in mission.targets:
        if not isinstance(target.motion, PathMotion):
            continue
        for t_s, north_m, east_m in target.motion.path:
            inside = mission.fence is None or inside_polygon((north_m, east_m), mission.fence)
            if not inside or any(inside_polygon((north_m, east_m), exclusion) for exclusion in mission.exclusions):
                concerns.append(
                    f"id {target.id} is {north_m:g} m north, {east_m:g} m east at {t_s:g} s, outside the fence or "
                    "inside an exclusion: no agent follows it there"
                )
                break
    return concerns


def _standing_with_a_bound(items: Sequence[TargetSpec] | Sequence[ThreatSpec]) -> list[str]:
    return [
        f"id {item.id} stands still but has speed_bound_m_s {item.speed_bound_m_s:g} m/s: every vehicle must count on "
        "it moving so fast at any time; 0 says that it stands"
        for item in items
        if item.motion == "static" and item.speed_bound_m_s > 0.0
    ]


def _unseen_in_wind(mission: Mission) -> list[str]:
    """Return by how much the dead reckoning of Case II may be off before the first report or arrival."""
    wind_m_s = mission.wind.speed_m_s + mission.wind.gust_m_s
    if mission.case == "I" or wind_m_s == 0.0:
        return []
    unseen_s = mission.report_period_s or min(
        math.dist(agent.position_ned_m, target.position_ned_m) / agent.speed_m_s
        for agent in mission.agents
        for target in mission.targets
    )
    if wind_m_s * unseen_s <= mission.arrival_radius_m:
        return []
    until = "between two reports" if mission.report_period_s else "at the first arrival, without reports"
    return [
        f"{wind_m_s:g} m/s in Case II, where agents are reckoned without it: {until}, {unseen_s:.0f} s, the reckoning "
        f"by which it assigns targets may be {wind_m_s * unseen_s:.0f} m off, more than arrival_radius_m "
        f"{mission.arrival_radius_m:g} m"
    ]


def _starts_inside(mission: Mission) -> list[str]:
    return [
        f"id {agent.id} starts inside detection_radius_m of threat {threat.id}; that is a depth, but no entry"
        for agent, altitude_m in zip(mission.agents, _altitudes_m(mission), strict=True)
        for threat in mission.threats
        if math.dist(agent.position_ned_m, threat.position_ned_m) < threat.detection_radius_m
        and reaches(threat, altitude_m)
    ]


def _reaches_nobody(mission: Mission) -> list[str]:
    altitudes_m = _altitudes_m(mission)
    return [
        f"id {threat.id} reaches no agent's height with its floor_m and ceiling_m, which count from sea level, so "
        "nobody keeps clear of it"
        for threat in mission.threats
        if not any(reaches(threat, altitude_m) for altitude_m in altitudes_m)
    ]


def _altitudes_m(mission: Mission) -> list[float]:
    """Return the altitudes above sea level at which the agents fly."""
    return [mission.origin.alt_m + agent_height_m(mission, agent.id) for agent in mission.agents]


def _too_short_a_range(mission: Mission) -> list[str]:
    # With the policy to return, the way back must fit too.
    ways = 1.0 + RANGE_RESERVE if mission.range_policy == "return" else 1.0
    concerns = []
    for agent in mission.agents:
        nearest_m = min(math.dist(agent.position_ned_m, target.position_ned_m) for target in mission.targets)
        if ways * nearest_m > agent.range_m:
            concerns.append(
                f"id {agent.id} has range_m {agent.range_m:g} m, too little for its nearest target, {nearest_m:.0f} m "
                f"away, under range_policy {mission.range_policy}"
            )
    return concerns
