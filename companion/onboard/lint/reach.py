"""Whether a mission's vehicles can come within the arrival radius of its targets, under the law that flies them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from companion.geo.kinematics import turn_rate_rad_s
from companion.guard.fence import Fence
from companion.guidance.route.plan import Plan
from companion.guidance.route.reachability import Shores, batches, free_of, nearest_points
from companion.guidance.route.router import Reach, shortest_route
from companion.guidance.route.scene import Aim, Pose
from companion.guidance.route.walls import NO_WALLS, Walls, WallSet
from companion.mission.model import Mission, TargetSpec, reaches
from companion.onboard.lint.fleet import Flyer, nearest_target
from companion.onboard.lint.starts import start_of

APPROACH_SHARE = 0.1
"""Distance outside a detection disc, as a share of R_d, within which the surrogate's repulsion outweighs attraction.
Measured: 0.09 R_d for pairwise at the paper's numbers, more for analytic."""
ROOM_BEARINGS = 24
"""Number of bearings from a target at which a turning circle that passes it is looked for."""
ROOM_SHARES = (-0.9, 0.0, 0.9)
"""How near such a circle passes the target: distances of its edge, as shares of the arrival radius."""
LEAVING_HEADINGS = 8
"""Number of headings at a target on which a way on is looked for, where there is no room for a circle; it is even."""
MOST_DEAD_ENDS = 5
"""Most targets of one mission for which that is done: with 400 discs it may take half a second each."""
AHEAD_RAD = 0.01
"""Difference of headings up to which a route begins with the vehicle's heading, and not with a turn on the spot."""


class _Scene(NamedTuple):
    """What some of the vehicles avoid: the standing threats that reach their height, fence and exclusions."""

    fleet: tuple[Flyer, ...]
    centres_m: np.ndarray  # (M, 2)
    radii_m: np.ndarray  # (M,)
    ids: tuple[int, ...]
    walls: Walls
    plan: Plan
    """A plan from the first vehicle's start, for the obstacles in it."""
    shores: Shores

    def disc_about(self, place_ned_m: tuple[float, float]) -> str | None:
        """Return how deep a place is inside which threat; None if it is outside all."""
        depths_m = self.radii_m - np.hypot(*(self.centres_m - place_ned_m).T)
        if depths_m.max(initial=0.0) <= 0.0:
            return None
        index = int(np.argmax(depths_m))
        return f"{depths_m[index]:.0f} m inside threat {self.ids[index]}"

    def are_safe(self, points: np.ndarray) -> np.ndarray:  # (P,) complex -> (P,) bool
        """Return which points (north + i east) are outside all obstacles and on the right side of walls."""
        safe = free_of(points, self.plan.obstacles, self.plan.tolerance_m)
        return safe if self.plan.walls is None else safe & self.plan.walls.allowed(points)


def out_of_reach(mission: Mission, fleet: Sequence[Flyer]) -> list[str]:
    """Return the standing targets that no vehicle on a route comes within the arrival radius of, and why.

    Threats that may move are left out: where they will be is not known.
    """
    scenes = _scenes(mission, fleet)
    concerns, dead_ends = [], 0
    for target in mission.targets:
        if target.motion != "static":
            continue
        reasons = []
        for scene in scenes:
            flyers = [flyer for flyer in scene.fleet if flyer.spec.only_target in (None, target.id)]
            if not flyers:
                continue
            reason = _walled_off(mission, scene, flyers, target)
            if reason is None and dead_ends < MOST_DEAD_ENDS and not _has_room(mission, scene, flyers, target):
                reason = _dead_end(mission, scene, flyers, target)
                dead_ends += 1
            reasons.append(reason)
        if reasons and None not in reasons:
            concerns.append(f"id {target.id} {reasons[0]}")
    return concerns


def repelled(mission: Mission, fleet: Sequence[Flyer]) -> list[str]:
    """Return the targets so near to a threat that the surrogate's repulsion keeps vehicles away from them."""
    return [
        f"id {target.id} is {distance_m:.0f} m from threat {threat.id}, whose detection_radius_m is "
        f"{threat.detection_radius_m:g} m: this law keeps agents farther off than it can be approached"
        for target in mission.targets
        for threat in mission.threats
        if any(reaches(threat, flyer.altitude_m) for flyer in fleet)
        and (distance_m := math.dist(target.position_ned_m, threat.position_ned_m)) - mission.arrival_radius_m
        < threat.detection_radius_m * (1 + APPROACH_SHARE)
    ]


def circled_targets(mission: Mission, fleet: Sequence[Flyer], kind: str) -> list[str]:
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
        heard = start_of(mission, flyer, kind).motion
        north_m, east_m = target.position_ned_m[0] - heard.north_m, target.position_ned_m[1] - heard.east_m
        ahead_m = north_m * math.cos(heard.heading_rad) + east_m * math.sin(heard.heading_rad)
        beside_m = abs(east_m * math.cos(heard.heading_rad) - north_m * math.sin(heard.heading_rad))
        if math.hypot(ahead_m, beside_m - radius_m) < radius_m - mission.arrival_radius_m:
            concerns.append(
                f"id {flyer.spec.id} begins to be steered {math.hypot(north_m, east_m):.0f} m from target {target.id}, "
                f"inside its own turning circle of {radius_m:.0f} m radius, with arrival_radius_m "
                f"{mission.arrival_radius_m:g} m: without a route it may circle its target for ever"
            )
    return concerns


def _scenes(mission: Mission, fleet: Sequence[Flyer]) -> list[_Scene]:
    """Return what is avoided, once for each set of standing threats that reach the heights of the same vehicles."""
    standing = [threat for threat in mission.threats if threat.speed_bound_m_s == 0.0]
    groups: dict[tuple[int, ...], list[Flyer]] = {}
    for flyer in fleet:
        reaching = tuple(i for i, threat in enumerate(standing) if reaches(threat, flyer.altitude_m))
        groups.setdefault(reaching, []).append(flyer)
    walls = Walls(mission.fence or (), mission.exclusions)
    found = []
    for reaching, flyers in groups.items():
        threats = [standing[index] for index in reaching]
        centres_m = np.array([threat.position_ned_m for threat in threats]).reshape(-1, 2)
        radii_m = np.array([threat.detection_radius_m for threat in threats])
        start, goal = complex(*flyers[0].spec.position_ned_m), complex(*mission.targets[0].position_ned_m)
        places = centres_m[:, 0] + 1j * centres_m[:, 1]
        plan = Plan(Pose(start), Aim(goal), places, radii_m, WallSet(walls) if walls != NO_WALLS else None)
        shores = Shores(plan.obstacles, plan.tolerance_m)
        ids = tuple(threat.id for threat in threats)
        found.append(_Scene(tuple(flyers), centres_m, radii_m, ids, walls, plan, shores))
    return found


def _walled_off(mission: Mission, scene: _Scene, flyers: Sequence[Flyer], target: TargetSpec) -> str | None:
    """Return why no place near a target can be flown to, however narrow the turns, or None if one can."""
    place = np.array([complex(*target.position_ned_m)])
    starts = np.array([complex(*flyer.spec.position_ned_m) for flyer in flyers])
    free = scene.are_safe(starts)
    if not free.all():
        return None  # who starts inside an obstacle leaves it somewhere
    if scene.are_safe(place)[0] and scene.shores.joined(place.item(), starts).any():
        return None
    nearest_m = math.inf
    for points in batches(nearest_points(place.item(), scene.plan.obstacles)):
        safe = points[scene.are_safe(points)]
        reached = [point for point in safe.tolist() if scene.shores.joined(point, starts).any()]
        if reached:
            nearest_m = abs(reached[0] - place.item())
            break
    if nearest_m <= mission.arrival_radius_m:
        return None
    inside = scene.disc_about(target.position_ned_m)
    return (
        f"is {inside or 'walled off by threats, fence or exclusions'}: the nearest place that a way leads to is "
        f"{nearest_m:.0f} m from it, arrival_radius_m is {mission.arrival_radius_m:g} m"
    )


def _has_room(mission: Mission, scene: _Scene, flyers: Sequence[Flyer], target: TargetSpec) -> bool:
    """Return whether some turning circle within the arrival radius of a target is clear of discs and fence."""
    radius_m = min(flyer.turn_radius_m for flyer in flyers)
    if radius_m == 0.0:
        return True
    bearings_rad = np.arange(ROOM_BEARINGS) * (math.tau / ROOM_BEARINGS)
    away_m = np.maximum(radius_m + mission.arrival_radius_m * np.array(ROOM_SHARES), 0.0)
    norths_m = (target.position_ned_m[0] + np.outer(np.cos(bearings_rad), away_m)).ravel()
    easts_m = (target.position_ned_m[1] + np.outer(np.sin(bearings_rad), away_m)).ravel()
    apart_m = np.hypot(norths_m[:, None] - scene.centres_m[:, 0], easts_m[:, None] - scene.centres_m[:, 1])
    clear = np.all(apart_m >= scene.radii_m + radius_m, axis=1)
    fence = None if mission.fence is None else Fence(mission.fence)
    exclusions = [Fence(exclusion) for exclusion in mission.exclusions]
    return any(
        (fence is None or fence.depth_m(north_m, east_m) >= radius_m)
        and all(-exclusion.depth_m(north_m, east_m) >= radius_m for exclusion in exclusions)
        for north_m, east_m in zip(norths_m[clear].tolist(), easts_m[clear].tolist(), strict=True)
    )


def _dead_end(mission: Mission, scene: _Scene, flyers: Sequence[Flyer], target: TargetSpec) -> str | None:
    """Return why nobody can leave a target again that has no room for a circle, or None if somebody can."""
    flyer = min(flyers, key=lambda one: one.turn_radius_m)
    # Who can leave on a heading can, the other way round, arrive on the opposite one.
    half = LEAVING_HEADINGS // 2
    leaves = [_leaves(scene, flyer, target, math.tau * index / LEAVING_HEADINGS) for index in range(LEAVING_HEADINGS)]
    if any(leaves[index] and leaves[index + half] for index in range(half)):
        return None
    return (
        f"has no room about it: agent {flyer.spec.id} turns with a radius of {flyer.turn_radius_m:.0f} m, and every "
        f"such circle within arrival_radius_m {mission.arrival_radius_m:g} m of it meets a threat or the fence"
    )


def _leaves(scene: _Scene, flyer: Flyer, target: TargetSpec, heading_rad: float) -> bool:
    """Return whether a way within the turn limit leads from a target, on a heading, to where a vehicle starts."""
    way = shortest_route(
        target.position_ned_m,
        flyer.spec.position_ned_m,
        scene.centres_m,
        scene.radii_m,
        heading_rad,
        flyer.turn_radius_m,
        scene.walls,
    )
    if way.reach is not Reach.TARGET or not way.pieces:
        return False
    return abs(math.remainder(way.pieces[0].heading_rad - heading_rad, math.tau)) <= AHEAD_RAD
