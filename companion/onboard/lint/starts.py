"""Whether the guard certifies a vehicle at its start, on the first picture that the vehicle hears."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from companion.autopilot.kinds import KINEMATIC
from companion.geo.kinematics import advance, turn_rate_rad_s
from companion.geo.polygon import inside_polygon
from companion.guard.fence import Fence
from companion.guard.types import Motion
from companion.guidance.view import View
from companion.mission.extent import mission_extent
from companion.mission.model import Mission, ThreatSpec, reaches
from companion.onboard.decision import Purpose
from companion.onboard.engagement import Engagement
from companion.onboard.goal import Goal
from companion.onboard.lint.fleet import Flyer, nearest_target
from companion.onboard.steering import Moment, steer
from companion.protocol.codec import frame_resolution_cm

GREATEST_PART_RAD = 0.2
"""Greatest turn between two places at which the circle before the first picture is compared with discs and fence."""


class Start(NamedTuple):
    """The state of a vehicle when it has heard the first broadcast."""

    motion: Motion
    circled_m: tuple[tuple[float, float], ...]
    """Places (north, east) on the way there: a point that cannot stop circles until then."""
    heard_s: float


def uncertified_starts(mission: Mission, fleet: Sequence[Flyer], kind: str) -> list[str]:
    """Return the agents for which the guard has no path that stays clear for ever on the first picture they hear.

    `kind` is the kind of autopilot: the simulator's point circles until it hears a picture, others hold their place.
    """
    concerns, unit_m = [], _unit_m(mission)
    for flyer in fleet:
        threats = [threat for threat in mission.threats if reaches(threat, flyer.altitude_m)]
        start = start_of(mission, flyer, kind)
        view = _view(threats, start.heard_s, unit_m)
        entered = _enters(mission, flyer, view, start.circled_m)
        certified_s = 0.0 if entered else _certified_s(mission, flyer, view, start)
        if certified_s == 0.0:
            still = view if entered else replace(view, threat_speed_m_s=np.zeros(len(threats)))
            moves = not entered and _certified_s(mission, flyer, still, start) > 0.0
            why = _fastest(flyer, threats) if moves else _why_uncertified(mission, flyer, threats, start)
            concerns.append(f"id {flyer.spec.id} has no certified back-up at its start, {why}")
        elif certified_s < mission.max_time_s:
            concerns.append(
                f"id {flyer.spec.id} is certified at its start for {certified_s:.0f} s only, not for ever, "
                f"{_fastest(flyer, threats)}"
            )
    return concerns


def start_of(mission: Mission, flyer: Flyer, kind: str) -> Start:
    """Return the state in which a vehicle, flown by a kind of autopilot, hears the first broadcast."""
    north_m, east_m = flyer.spec.position_ned_m
    heading_rad = math.radians(flyer.spec.heading_deg or 0.0)
    if flyer.steering.can_stop:
        return Start(Motion(north_m, east_m, heading_rad, 0.0), (), mission.link.delay_s)
    limits = flyer.steering.config.limits
    speed_m_s, step_s = limits.speed_m_s, mission.guidance_step_s
    if kind != KINEMATIC.name:
        return Start(Motion(north_m, east_m, heading_rad, speed_m_s), (), mission.link.delay_s)
    heard_s = step_s * math.ceil(min(mission.link.delay_s, mission.max_time_s) / step_s)
    rate_rad_s = turn_rate_rad_s(speed_m_s, limits.n_max)
    # Whole circles before that change nothing, but for one.
    circling_s = (
        heard_s if heard_s * rate_rad_s < math.tau else math.tau / rate_rad_s + heard_s % (math.tau / rate_rad_s)
    )
    parts = math.ceil(circling_s * rate_rad_s / GREATEST_PART_RAD)
    poses = [(north_m, east_m, heading_rad)]
    for _ in range(parts):
        poses.append(advance(*poses[-1], speed_m_s, rate_rad_s, circling_s / parts))
    return Start(Motion(*poses[-1], speed_m_s), tuple((pose[0], pose[1]) for pose in poses), heard_s)


def _unit_m(mission: Mission) -> float:
    """Return the resolution of the mission's state frames."""
    extent = mission_extent(mission)
    return frame_resolution_cm([extent.low_ned_m, extent.high_ned_m], [extent.radius_m]) / 100.0


def _view(threats: Sequence[ThreatSpec], age_s: float, unit_m: float) -> View:
    """Return the picture of the threats as a vehicle has it when it hears of them `age_s` after they were seen.

    Places are rounded to `unit_m`; radii gain what that moves them and are rounded up, as in a state frame.
    """
    speed_m_s = np.array([threat.speed_bound_m_s for threat in threats])
    places_m = np.array([threat.position_ned_m for threat in threats]).reshape(-1, 2)
    told_m = unit_m * np.round(places_m / unit_m)
    moved_m = np.hypot(*(told_m - places_m).T)
    radii_m = np.array([(threat.detection_radius_m, threat.attack_radius_m) for threat in threats]).reshape(-1, 2)
    believed_m = unit_m * np.ceil((radii_m + moved_m[:, np.newaxis]) / unit_m) + (speed_m_s * age_s)[:, np.newaxis]
    return View(
        target_ned_m=None,
        target_age_s=age_s,
        threats_ned_m=told_m,
        detection_radius_m=believed_m[:, 0],
        attack_radius_m=believed_m[:, 1],
        threat_speed_m_s=speed_m_s,
        threat_ids=np.array([threat.id for threat in threats], dtype=int),
        threat_velocity_m_s=np.zeros((len(threats), 2)),
        threat_age_s=np.full(len(threats), age_s),
        peers_ned_m=np.zeros((0, 2)),
        peer_ids=np.zeros(0, dtype=int),
        loitering_ned_m=np.zeros((0, 2)),
    )


def _enters(mission: Mission, flyer: Flyer, view: View, places_m: Sequence[tuple[float, float]]) -> bool:
    """Return whether any of the places is inside a disc, outside the fence or inside an exclusion."""
    radii_m = view.keep_out_m(flyer.steering.config.keep_out)
    table_m = np.array(places_m).reshape(-1, 1, 2) - view.threats_ned_m
    if bool((np.hypot(table_m[..., 0], table_m[..., 1]) < radii_m).any()):
        return True
    if mission.fence is not None and not all(inside_polygon(place, mission.fence) for place in places_m):
        return True
    return any(inside_polygon(place, exclusion) for exclusion in mission.exclusions for place in places_m)


def _certified_s(mission: Mission, flyer: Flyer, view: View, start: Start) -> float:
    """Return for how long the guard's first verdict is certified, in seconds; 0 without a certified back-up.

    Where no circle or stop is clear for ever, a route may be: the one to the nearest target is tried.
    """
    steering = flyer.steering
    moment = Moment(start.motion, view, 0.0, start.heard_s)
    certified_s = steer(steering, Goal(Purpose.LOITER, ""), moment, Engagement()).verdict.certified_s
    if math.isfinite(certified_s) and steering.rules is not None:
        steering.guard.reset()
        goal = Goal(Purpose.TARGET, "", nearest_target(mission, flyer.spec).position_ned_m)
        certified_s = max(certified_s, steer(steering, goal, moment, Engagement()).verdict.certified_s)
    steering.guard.reset()
    return certified_s


def _fastest(flyer: Flyer, threats: Sequence[ThreatSpec]) -> str:
    """Return which threat may move fastest, and how fast the vehicle itself is."""
    fastest = max(threats, key=lambda threat: threat.speed_bound_m_s)
    return (
        f"as threat {fastest.id} may move at {fastest.speed_bound_m_s:g} m/s, against its own "
        f"{flyer.steering.config.limits.speed_m_s:g} m/s"
    )


class _Edge(NamedTuple):
    """The keep-out edge nearest to a place, and how far outside of it the place is, m; negative: behind it."""

    name: str
    clear_m: float


def _nearest_edge(mission: Mission, flyer: Flyer, threats: Sequence[ThreatSpec], place: tuple[float, float]) -> _Edge:
    attack = flyer.steering.config.keep_out == "attack"
    edges = [
        _Edge(
            f"threat {threat.id}",
            math.dist(place, threat.position_ned_m) - (threat.attack_radius_m if attack else threat.detection_radius_m),
        )
        for threat in threats
    ]
    if mission.fence is not None:
        edges.append(_Edge("the fence", Fence(mission.fence).depth_m(*place)))
    edges += [
        _Edge(f"exclusions[{index}]", -Fence(exclusion).depth_m(*place))
        for index, exclusion in enumerate(mission.exclusions)
    ]
    return min(edges, key=lambda edge: edge.clear_m, default=_Edge("everything", math.inf))


def _why_uncertified(mission: Mission, flyer: Flyer, threats: Sequence[ThreatSpec], start: Start) -> str:
    edge = _nearest_edge(mission, flyer, threats, flyer.spec.position_ned_m)
    limits = flyer.steering.config.limits
    if flyer.steering.can_stop:
        needs_m = limits.speed_m_s**2 / (2.0 * limits.braking_m_s2)
        needs = f"stopping takes it {needs_m:.0f} m"
    else:
        needs = f"its turning circle has a radius of {flyer.turn_radius_m:.0f} m"
        if start.circled_m:
            needs += f", and it flies that to the right until it hears the broadcast, {start.heard_s:g} s on"
    return f"{edge.clear_m:.0f} m from {edge.name}, heading {flyer.spec.heading_deg or 0.0:.0f} deg; {needs}"
