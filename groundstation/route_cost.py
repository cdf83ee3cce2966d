"""Route costs: the lengths of all agents' paths to all targets around the threats, and the assignment by them.

An agent that is nearest to a target may have the longest path there, so the objectives `route` and `latest` count the
turn-limited shortest paths around the discs (docs/method.md section 3), grown by their age as they are broadcast. The
search of such a path takes a millisecond or two, and there is one for every pair; so a pair is first given a lower
bound, the length of the path around the worst single disc, and a path is only searched if an assignment would use the
pair. Once all pairs that the best assignment uses are known, no other assignment can be better.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from companion.guidance.route.router import Reach, shortest_route
from groundstation.assignment import assign_least_latest, assign_least_total

RouteObjective = Literal["route", "latest"]
UNREACHED_PENALTY = 10.0
"""Cost, in metres flown, of each metre that remains to a target that no path leads to."""
MAX_ROUTES = 150
"""Greatest number of paths searched for one assignment, to bound the delay of a broadcast; further pairs count with
their lower bounds."""
_TOUCH_SHARE = 1e-9
"""Depth, as a share of a disc's radius, up to which a path that cuts the disc only touches it."""
_FULL_TURN_RAD = math.tau - 1e-9
"""Angle above which an arc counts as zero, because it is a zero with a rounding error."""


@dataclass(frozen=True)
class Scene:
    """The agents, the targets and the discs that obstruct their paths, at one moment."""

    agents_ned_m: np.ndarray  # (N, 2) m
    headings_rad: np.ndarray  # (N,) rad, nan: not known
    turn_radii_m: np.ndarray  # (N,) m
    targets_ned_m: np.ndarray  # (K, 2) m
    centres_ned_m: np.ndarray  # (M, 2) m
    radii_m: np.ndarray  # (M,) m
    obstructs: np.ndarray  # (N, M) bool, which threats reach the height of which agent


class RouteCosts:
    """The lengths of the paths of all pairs of a scene, searched or bounded from below.

    `length_m` (N, K) m is the length of the path to the target, or to the nearest safe point to it, and `rest_m` (N, K)
    m the straight distance from there to the target; `blocked` (N, K) bool is true where the path does not end at the
    target. Where `known` (N, K) bool is false, the length is at most the true one, and the pair is not blocked.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        shape = (len(scene.agents_ned_m), len(scene.targets_ned_m))
        self.length_m = np.zeros(shape)
        self.rest_m = np.zeros(shape)
        self.blocked = np.zeros(shape, dtype=bool)
        self.known = np.zeros(shape, dtype=bool)
        self.searched = 0
        """Number of paths searched so far."""
        for agent in range(shape[0]):
            self.length_m[agent], self.known[agent] = _unobstructed(scene, agent)
            around_m = np.where(self.known[agent], 0.0, _around_the_worst(scene, agent))
            self.length_m[agent] = np.maximum(self.length_m[agent], around_m)

    @property
    def cost_m(self) -> np.ndarray:  # (N, K) m
        """Cost of each pair by its path."""
        return self.length_m + UNREACHED_PENALTY * self.rest_m

    def search(self, agent: int, target: int) -> None:
        """Search the path of one pair and store its length."""
        scene, there = self._scene, self._scene.obstructs[agent]
        heading_rad = float(scene.headings_rad[agent])
        goal_ned_m = scene.targets_ned_m[target]
        route = shortest_route(
            _point(scene.agents_ned_m[agent]),
            _point(goal_ned_m),
            scene.centres_ned_m[there],
            scene.radii_m[there],
            None if math.isnan(heading_rad) else heading_rad,
            float(scene.turn_radii_m[agent]),
        )
        self.searched += 1
        pair = (agent, target)
        self.known[pair] = True
        self.blocked[pair] = route.reach is not Reach.TARGET
        if route.reach is Reach.TARGET:
            # A path may cut through a disc that the vehicle can no longer avoid; it still counts as going around it.
            self.length_m[pair] = max(route.length_m, float(self.length_m[pair]))
        elif route.reach is Reach.NEAREST:
            self.length_m[pair] = route.length_m
            self.rest_m[pair] = math.dist(route.goal_ned_m, goal_ned_m)
        else:
            self.length_m[pair] = 0.0
            self.rest_m[pair] = math.dist(scene.agents_ned_m[agent], goal_ned_m)


@dataclass(frozen=True)
class AssignmentRule:
    """Objective of an assignment by route costs, and the saving for which agents change targets."""

    objective: RouteObjective
    """What is minimised; `route`: the total length, `latest`: the latest arrival, then the total time."""
    switching_share: float
    """Share of the joint cost of the agents that change which their change must save."""
    max_routes: int = MAX_ROUTES
    """Greatest number of paths searched."""


def assign_by_route_cost(
    costs: RouteCosts,
    speeds_m_s: np.ndarray,  # (N,) m/s
    rule: AssignmentRule,
    in_range: Callable[[np.ndarray], np.ndarray],
    present: np.ndarray,  # (N,) index of each agent's present target, -1 for none
) -> np.ndarray:  # (N,) index of each agent's target, -1 for none
    """Return each agent's target by the paths around the threats, as `assign` does by the straight distance.

    A target that no path leads to gets agents too, but none that could arrive at another target instead. `in_range`
    maps the lengths of all paths (N, K) m to those within range (N, K) bool.

    Raises ValueError as the assignments do.
    """
    # The latest arrival of the present assignment decides whether it stands, so its paths are searched first.
    wanted = _pairs(present) if rule.objective == "latest" else set()
    while True:
        for pair in sorted(pair for pair in wanted if not costs.known[pair]):
            if costs.searched >= rule.max_routes:
                break
            costs.search(*pair)
        reachable = in_range(costs.length_m + costs.rest_m)
        if rule.objective == "route":
            chosen = assign_least_total(costs.cost_m, reachable, costs.blocked, present, rule.switching_share)
        else:
            arrival_s = costs.cost_m / speeds_m_s[:, np.newaxis]
            chosen = assign_least_latest(arrival_s, reachable, costs.blocked, present, rule.switching_share)
        wanted = _pairs(chosen)
        if costs.searched >= rule.max_routes or all(costs.known[pair] for pair in wanted):
            return chosen


def _unobstructed(scene: Scene, agent: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the length of an agent's path to each target without discs (K,) m, and which are unobstructed (K,) bool.

    A vehicle that cannot turn on the spot flies an arc of its turning circle and then straight, the shortest path to a
    point outside both circles whatever the heading there. For other targets the length is that of the straight line.
    """
    start_ned_m, heading_rad = scene.agents_ned_m[agent], scene.headings_rad[agent]
    offset_m = scene.targets_ned_m - start_ned_m  # (K, 2)
    direct_m = np.hypot(offset_m[:, 0], offset_m[:, 1])  # (K,)
    radius_m = scene.turn_radii_m[agent]
    there = scene.obstructs[agent]
    discs_ned_m, discs_m = scene.centres_ned_m[there], scene.radii_m[there] * (1.0 - _TOUCH_SHARE)
    if radius_m == 0.0 or math.isnan(heading_rad):
        return direct_m, _segments_free(
            np.tile(start_ned_m, (len(offset_m), 1)), scene.targets_ned_m, discs_ned_m, discs_m
        )
    right, left = (_arc_and_line(offset_m, heading_rad, radius_m, side) for side in (1, -1))
    shorter = right.length_m <= left.length_m
    inside = ~np.isfinite(right.length_m) | ~np.isfinite(left.length_m)
    arc_m = np.where(shorter, right.arc_m, left.arc_m)
    leaves_ned_m = start_ned_m + np.where(shorter[:, np.newaxis], right.leaves_m, left.leaves_m)
    # No point of the arc is farther from the start than the arc's length or the circle's diameter.
    apart_m = np.hypot(*(discs_ned_m - start_ned_m).T)  # (M,)
    free = np.all(apart_m >= discs_m + np.minimum(arc_m, 2.0 * radius_m)[:, np.newaxis], axis=1) | (arc_m == 0.0)
    free &= _segments_free(leaves_ned_m, scene.targets_ned_m, discs_ned_m, discs_m) & ~inside
    return np.where(free, np.minimum(right.length_m, left.length_m), direct_m), free


def _around_the_worst(scene: Scene, agent: int) -> np.ndarray:  # (K,) m
    """Return for each target the longest of the shortest paths around each single disc, m; 0 if no disc is in between.

    The path around one disc is two tangents and the arc between their points of contact.
    """
    there = scene.obstructs[agent]
    from_m = scene.agents_ned_m[agent] - scene.centres_ned_m[there]  # (M, 2), from the centres
    to_m = scene.targets_ned_m[:, np.newaxis, :] - scene.centres_ned_m[there]  # (K, M, 2)
    radii_m, start_m, goal_m = scene.radii_m[there], np.hypot(*from_m.T), np.hypot(to_m[..., 0], to_m[..., 1])
    # A point inside a disc has no path around it; routes out of a disc and into one are not bounded by this.
    outside = (start_m > radii_m) & (goal_m > radii_m)
    cross_m2 = from_m[:, 0] * to_m[..., 1] - from_m[:, 1] * to_m[..., 0]
    between_rad = np.abs(np.arctan2(cross_m2, np.einsum("mi,kmi->km", from_m, to_m)))
    arc_rad = between_rad - np.arccos(np.where(outside, radii_m / np.maximum(start_m, radii_m), 1.0))
    arc_rad -= np.arccos(np.where(outside, radii_m / np.maximum(goal_m, radii_m), 1.0))
    tangents_m = np.sqrt(np.maximum(start_m**2 - radii_m**2, 0.0)) + np.sqrt(np.maximum(goal_m**2 - radii_m**2, 0.0))
    around_m = np.where(outside & (arc_rad > 0.0), tangents_m + radii_m * arc_rad, 0.0)
    worst_m: np.ndarray = np.max(around_m, axis=1, initial=0.0)
    return worst_m


@dataclass(frozen=True)
class _ArcAndLine:
    """Paths to K points, each an arc of one turning circle and then a line; infinite to points inside that circle."""

    length_m: np.ndarray  # (K,) m
    arc_m: np.ndarray  # (K,) m, how much of it is on the circle
    leaves_m: np.ndarray  # (K, 2) m, where it leaves the circle, from the start


def _arc_and_line(
    offset_m: np.ndarray,  # (K, 2) m, the points from the start
    heading_rad: float,
    radius_m: float,
    side: int,  # 1: to the right, -1: to the left
) -> _ArcAndLine:
    centre_m = side * radius_m * np.array((-math.sin(heading_rad), math.cos(heading_rad)))
    from_centre_m = offset_m - centre_m
    squared_m2 = np.sum(from_centre_m**2, axis=1) - radius_m**2
    line_m = np.sqrt(np.maximum(squared_m2, 0.0))
    leaving_rad = np.arctan2(from_centre_m[:, 1], from_centre_m[:, 0]) + side * np.arctan2(radius_m, line_m)
    turn_rad = (side * (leaving_rad - heading_rad)) % math.tau
    turn_rad = np.where(turn_rad > _FULL_TURN_RAD, 0.0, turn_rad)
    leaves_m = centre_m + side * radius_m * np.stack((np.sin(leaving_rad), -np.cos(leaving_rad)), axis=1)
    length_m = np.where(squared_m2 >= 0.0, radius_m * turn_rad + line_m, np.inf)
    return _ArcAndLine(length_m, radius_m * turn_rad, leaves_m)


def _segments_free(
    from_ned_m: np.ndarray,  # (K, 2) m
    to_ned_m: np.ndarray,  # (K, 2) m
    centres_ned_m: np.ndarray,  # (M, 2) m
    radii_m: np.ndarray,  # (M,) m
) -> np.ndarray:  # (K,) bool
    """Return which of K segments stay out of all discs."""
    along_m = to_ned_m - from_ned_m
    squared_m2 = np.maximum(np.sum(along_m**2, axis=1), 1e-12)  # a segment of no length is its beginning
    to_centre_m = centres_ned_m - from_ned_m[:, np.newaxis, :]  # (K, M, 2)
    share = np.clip(np.einsum("kmi,ki->km", to_centre_m, along_m) / squared_m2[:, np.newaxis], 0.0, 1.0)
    nearest_m = to_centre_m - share[..., np.newaxis] * along_m[:, np.newaxis, :]
    free: np.ndarray = np.all(np.hypot(nearest_m[..., 0], nearest_m[..., 1]) >= radii_m, axis=1)
    return free


def _pairs(chosen: np.ndarray) -> set[tuple[int, int]]:
    return {(agent, int(target)) for agent, target in enumerate(chosen) if target >= 0}


def _point(ned_m: np.ndarray) -> tuple[float, float]:
    return float(ned_m[0]), float(ned_m[1])
