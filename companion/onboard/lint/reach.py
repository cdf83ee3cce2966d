"""Whether a mission's vehicles can come within the arrival radius of its targets, under the law that flies them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from companion.geo.kinematics import turn_rate_rad_s
from companion.guard.fence import Fence
from companion.guidance.route.reachability import Shores
from companion.guidance.route.router import Reach, shortest_route
from companion.mission.model import Mission, TargetSpec, is_obstacle
from companion.onboard.lint.fleet import Flyer, nearest_target

APPROACH_SHARE = 0.1
"""Distance outside a detection disc, as a share of R_d, within which the surrogate's repulsion outweighs attraction.
Measured: 0.09 R_d for pairwise at the paper's numbers, more for analytic."""
ROOM_BEARINGS = 24
"""Number of bearings from a target at which a turning circle that passes it is looked for."""
ROOM_SHARES = (-0.9, 0.0, 0.9)
"""How near such a circle passes the target: distances of its edge, as shares of the arrival radius."""
LEAVING_HEADINGS = 8
"""Number of headings at a target on which a way on is looked for, where there is no room for a circle; it is even."""
TOLERANCE_M = 1e-3
"""Depth up to which a place inside a disc counts as on its edge: overlaps of less close no way."""
MOST_SEARCHES = 24
"""Most searches of a way on in one mission: with 400 discs one may take 50 ms."""


class _Waters(NamedTuple):
    """The free region around the standing discs that some of the vehicles avoid."""

    fleet: tuple[Flyer, ...]
    centres_m: np.ndarray  # (M, 2)
    radii_m: np.ndarray  # (M,)
    ids: tuple[int, ...]
    shores: Shores

    def depth_m(self, place: complex) -> tuple[float, int]:
        """Return how deep a place (north + i east) is inside a disc, negative outside of all, and the disc's index."""
        if not self.ids:
            return -math.inf, 0
        depths_m = self.radii_m - np.hypot(self.centres_m[:, 0] - place.real, self.centres_m[:, 1] - place.imag)
        index = int(np.argmax(depths_m))
        return float(depths_m[index]), index


def out_of_reach(mission: Mission, fleet: Sequence[Flyer]) -> list[str]:
    """Return the standing targets that no vehicle on a route comes within the arrival radius of, and why.

    Threats that may move are left out: where they will be is not known.
    """
    waters = _waters(mission, fleet)
    concerns, searches = [], MOST_SEARCHES
    for target in mission.targets:
        if target.motion != "static":
            continue
        reasons = []
        for water in waters:
            flyers = [flyer for flyer in water.fleet if flyer.spec.only_target in (None, target.id)]
            if not flyers:
                continue
            reason = _walled_off(mission, water, flyers, target)
            if reason is None and not _has_room(mission, water, flyers, target) and searches > 0:
                searches -= LEAVING_HEADINGS
                reason = _dead_end(mission, water, flyers, target)
            reasons.append(reason)
        if reasons and None not in reasons:
            concerns.append(f"id {target.id} {reasons[0]}")
    return concerns


def repelled(mission: Mission) -> list[str]:
    """Return the targets so near to a threat that the surrogate's repulsion keeps vehicles away from them."""
    return [
        f"id {target.id} is {distance_m:.0f} m from threat {threat.id}, whose detection_radius_m is "
        f"{threat.detection_radius_m:g}: this law keeps agents farther off than it can be approached"
        for target in mission.targets
        for threat in mission.threats
        if any(is_obstacle(mission, agent.id, threat) for agent in mission.agents)
        and (distance_m := math.dist(target.position_ned_m, threat.position_ned_m)) - mission.arrival_radius_m
        < threat.detection_radius_m * (1 + APPROACH_SHARE)
    ]


def circled_targets(mission: Mission, fleet: Sequence[Flyer]) -> list[str]:
    """Return the agents that may circle their target for ever, as they fly at it without a route.

    A vehicle that turns towards a target inside its turning circle stays on that circle.
    """
    concerns = []
    for flyer in fleet:
        if flyer.steering.can_stop:
            continue
        target = nearest_target(mission, flyer.spec)
        limits = flyer.steering.config.limits
        radius_m = limits.speed_m_s / turn_rate_rad_s(limits.speed_m_s, limits.n_max)
        north_m, east_m = (
            there - here for there, here in zip(target.position_ned_m, flyer.spec.position_ned_m, strict=True)
        )
        heading_rad = math.radians(flyer.spec.heading_deg or 0.0)
        ahead_m = north_m * math.cos(heading_rad) + east_m * math.sin(heading_rad)
        beside_m = abs(east_m * math.cos(heading_rad) - north_m * math.sin(heading_rad))
        if math.hypot(ahead_m, beside_m - radius_m) < radius_m - mission.arrival_radius_m:
            concerns.append(
                f"id {flyer.spec.id} starts {math.hypot(north_m, east_m):.0f} m from target {target.id}, inside its "
                f"own turning circle of {radius_m:.0f} m radius, with arrival_radius_m {mission.arrival_radius_m:g}: "
                "without a route it may circle its target for ever"
            )
    return concerns


def _waters(mission: Mission, fleet: Sequence[Flyer]) -> list[_Waters]:
    """Return the free regions, one for each set of standing threats that reach the heights of the same vehicles."""
    standing = [threat for threat in mission.threats if threat.speed_bound_m_s == 0.0]
    groups: dict[tuple[int, ...], list[Flyer]] = {}
    for flyer in fleet:
        reaching = tuple(i for i, threat in enumerate(standing) if is_obstacle(mission, flyer.spec.id, threat))
        groups.setdefault(reaching, []).append(flyer)
    found = []
    for reaching, flyers in groups.items():
        threats = [standing[index] for index in reaching]
        centres_m = np.array([threat.position_ned_m for threat in threats]).reshape(-1, 2)
        radii_m = np.array([threat.detection_radius_m for threat in threats])
        places = centres_m[:, 0] + 1j * centres_m[:, 1]
        shores = Shores(places, radii_m, TOLERANCE_M)
        found.append(_Waters(tuple(flyers), centres_m, radii_m, tuple(threat.id for threat in threats), shores))
    return found


def _walled_off(mission: Mission, water: _Waters, flyers: Sequence[Flyer], target: TargetSpec) -> str | None:
    """Return why no place near a target can be flown to, however narrow the turns, or None if one can."""
    place = complex(*target.position_ned_m)
    depth_m, index = water.depth_m(place)
    if depth_m > 0.0:
        safe = water.shores.nearest(place, None)
        off_m = abs(safe[0] - place) if safe else math.inf
        if off_m > mission.arrival_radius_m:
            return (
                f"is {depth_m:.0f} m inside threat {water.ids[index]}: the nearest place outside all discs is "
                f"{off_m:.0f} m from it, arrival_radius_m is {mission.arrival_radius_m:g}"
            )
    nearest_m = math.inf
    for flyer in flyers:
        start = complex(*flyer.spec.position_ned_m)
        if water.depth_m(start)[0] > 0.0 or (depth_m <= 0.0 and water.shores.joined(start, place)):
            return None
        reached = water.shores.nearest(place, start)
        nearest_m = min(nearest_m, abs(reached[0] - place) if reached else math.inf)
        if nearest_m <= mission.arrival_radius_m:
            return None
    return (
        f"is walled off by discs that overlap: the nearest place that a way leads to is {nearest_m:.0f} m from it, "
        f"arrival_radius_m is {mission.arrival_radius_m:g}"
    )


def _has_room(mission: Mission, water: _Waters, flyers: Sequence[Flyer], target: TargetSpec) -> bool:
    """Return whether some turning circle within the arrival radius of a target is clear of discs and fence."""
    radius_m = min(flyer.turn_radius_m for flyer in flyers)
    if radius_m == 0.0:
        return True
    bearings_rad = np.arange(ROOM_BEARINGS) * (math.tau / ROOM_BEARINGS)
    away_m = np.maximum(radius_m + mission.arrival_radius_m * np.array(ROOM_SHARES), 0.0)
    norths_m = (target.position_ned_m[0] + np.outer(np.cos(bearings_rad), away_m)).ravel()
    easts_m = (target.position_ned_m[1] + np.outer(np.sin(bearings_rad), away_m)).ravel()
    apart_m = np.hypot(norths_m[:, None] - water.centres_m[:, 0], easts_m[:, None] - water.centres_m[:, 1])
    clear = np.all(apart_m >= water.radii_m + radius_m, axis=1)
    fence = None if mission.fence is None else Fence(mission.fence)
    exclusions = [Fence(exclusion) for exclusion in mission.exclusions]
    return any(
        (fence is None or fence.depth_m(north_m, east_m) >= radius_m)
        and all(-exclusion.depth_m(north_m, east_m) >= radius_m for exclusion in exclusions)
        for north_m, east_m in zip(norths_m[clear].tolist(), easts_m[clear].tolist(), strict=True)
    )


def _dead_end(mission: Mission, water: _Waters, flyers: Sequence[Flyer], target: TargetSpec) -> str | None:
    """Return why nobody can leave a target again that has no room for a circle, or None if somebody can."""
    flyer = min(flyers, key=lambda one: one.turn_radius_m)
    radius_m = flyer.turn_radius_m
    if mission.fence is None and not mission.exclusions:
        # Who can leave on a heading can, the other way round, arrive on the opposite one.
        half = LEAVING_HEADINGS // 2
        leaves = [
            shortest_route(
                target.position_ned_m,
                flyer.spec.position_ned_m,
                water.centres_m,
                water.radii_m,
                math.tau * index / LEAVING_HEADINGS,
                radius_m,
            ).reach
            is Reach.TARGET
            for index in range(LEAVING_HEADINGS)
        ]
        if any(leaves[index] and leaves[index + half] for index in range(half)):
            return None
    return (
        f"has no room about it: agent {flyer.spec.id} turns with a radius of {radius_m:.0f} m, and every such circle "
        f"that passes within arrival_radius_m {mission.arrival_radius_m:g} of it meets a threat or the fence"
    )
