"""The arena's yardstick: the shortest path that an agent could have flown, or the proof that there is none.

The planner knows everything, including the true motion of every threat to the end of the run, and plans for one agent
alone: other agents are not in its way, and a chasing threat chases only this agent. It shares no code with the
companion's route. Every path (a `way` in the code) comes with a lower bound of the length that any path needs, and
`verify` checks the path numerically.

A path is legal if it keeps the agent's constant speed v over the ground and a turn radius of at least (v + W)^2/(n_max
g), that of the widest circle over the ground in the strongest wind W, gusts included; if it stays MARGIN_M outside
every R_d at every moment, inside the fence and outside the exclusions; and if it arrives in time. It begins at the
agent's pose and ends, at any heading, within the arrival radius. Of a disc or an edge that the agent starts beside it
keeps as far away as the start does.

Three methods are tried, the cheapest first. Among discs that stand still: lines and circles (`sim.shortest_path`).
Among discs that move: lines and circles around copies of the discs, each where its disc was when an earlier path
entered it; every path is tried against the true motion, and copies are added until one is clear. Where that fails, or
the path is more than GOOD_GAP longer than the lower bound: a search over pieces of arcs and lines with time as a part
of the state, which also tries a turn and a line to the target from the poses that it opens. The search is neither
exhaustive nor optimal. It is bounded in steps, not in seconds, so that plans do not depend on the machine.
"""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Literal

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from companion.geo.kinematics import GRAVITY_M_S2, advance
from companion.geo.polygon import inside_polygon
from companion.mission.model import Mission, SteadyMotion, ThreatSpec
from sim.shortest_path import (
    Departure,
    PathPiece,
    Walls,
    shortest_path_length,
    turning_path,
    wall_distance_m,
    walls_of,
)
from sim.world import World

MARGIN_M = 2.0
"""Distance that a path keeps from every R_d and every edge, unless another is asked for, so that none grazes what the
guard must keep out of."""
TOLERANCE_M = 0.05
"""Part of MARGIN_M that the check of a path forgives, for the interpolation between its samples."""
GOOD_GAP = 0.05
"""Excess over the lower bound, as a share of it, up to which no better path is searched for."""
EDGE_SHARE = 1e-6
"""Share of the start's distance from an edge by which the edge's clearance is less, for rounding."""
LEAST_CLEARANCE_M = 1e-3
"""Least clearance from an edge: round a corner without any no path could turn."""
STILL_STEP_RAD = 0.2
"""Greatest turn between two points of a path among discs that stand still."""
REPAIRS = 20
"""Rounds in which copies of moving discs are added to one plan before it is given up."""
SEARCHES = ((2.0, 3_000), (1.2, 2_500))
"""Weight of the remaining distance and greatest number of poses opened, for each of the two searches: the first finds a
path soon, the second a short one. A thousand poses take 0.3 to 0.8 s."""
NEAR_SHARE = 0.5
"""Distance from a moving threat's edge, as a share of its radius, within which a path found by search is pulled tight
around the threat."""
SHOT_EVERY = 20
"""Where threats chase, a turn and a line to the target are tried from only one of this many opened poses, because the
chase must be simulated all along the try."""
PIECE_TURN_RAD = 0.8
"""Turn of the sharpest piece of the search; where a hundredth of the distance to the target makes the pieces longer,
they turn by more, at most 1.2 rad."""
HEADING_BINS = 24
"""Number of heading bins: poses at the same place whose headings fall into one bin count as the same."""
TIME_BIN_S = 8.0
"""Width of a bin in time: where threats move, poses at the same place in different bins count as different."""
WAY_TURN_RAD = 0.2
"""Greatest turn between two consecutive points of a path."""
CHECK_STEP_M = 2.0
"""Greatest distance between two samples of the check; over such a chord an arc of 10 m radius rises by 0.05 m."""

Method = Literal["tangents", "repaired", "search", "none", "impossible"]


@dataclass(frozen=True)
class Plan:
    """A path for one agent, or the reason why there is none."""

    length_m: float
    """Length of the path; infinite where none was found."""
    lower_bound_m: float
    """Length that no path undercuts; infinite where it is proven that none arrives in time."""
    way: np.ndarray  # (W, 3) north m, east m, heading rad; arcs of constant curvature join them
    method: Method
    """How the path was found: by lines and circles (`tangents`), around copies of moving discs (`repaired`), or by
    `search`. Without a path: `none`, which proves nothing, or `impossible`, which is proven."""
    seconds: float
    """Wall-clock time that the planning took."""

    @property
    def gap(self) -> float:
        """Excess of the length over the lower bound, as a share of that bound; infinite where no path was found."""
        if math.isinf(self.length_m):
            return math.inf
        return self.length_m / self.lower_bound_m - 1.0 if self.lower_bound_m > 0.0 else 0.0


@dataclass(frozen=True)
class Needs:
    """What a path needs beside being legal: more room than MARGIN_M, wider turns, and no search for a better one."""

    margin_m: float = MARGIN_M
    turn_radius_m: float = 0.0
    """Least turn radius, where it is greater than the vehicle's own."""
    short: bool = True
    """Whether a better path is searched for where one is found that may not be the shortest."""


NEEDS = Needs()


@dataclass(frozen=True)
class _Task:
    """One agent's planning problem, taken from a mission."""

    start_ned_m: np.ndarray  # (2,) m
    heading_rad: float
    speed_m_s: float
    turn_radius_m: float
    target_ned_m: np.ndarray  # (2,) m
    arrival_m: float
    until_s: float
    radii_m: np.ndarray  # (M,) m, the margin included
    moves: np.ndarray  # (M,) bool
    walls: Walls

    @property
    def pose(self) -> tuple[float, float, float]:
        return float(self.start_ned_m[0]), float(self.start_ned_m[1]), self.heading_rad


def plan(
    mission: Mission,
    agent_id: int,
    target_ned_m: Sequence[float] | np.ndarray,
    until_s: float,
    seed: int,
    needs: Needs = NEEDS,
) -> Plan:
    """Return the shortest path found that takes an agent of a resolved mission to a place (2,) in m before `until_s`.

    The seed is that of the flight, because the threats that move at random move by it.

    Raises ValueError for an unknown agent.
    """
    began_s = time.perf_counter()
    task = _task(mission, agent_id, target_ned_m, until_s, needs)
    motion = _Motion(mission, seed, task)
    bound_m = _lower_bound_m(task, motion.places_m[0])
    best: list[PathPiece] | None = None
    method: Method = "impossible"
    if bound_m <= task.speed_m_s * until_s:
        planned = _planned_statically if motion.still else _repaired
        method = "tangents" if motion.still else "repaired"
        best = planned(task, motion)
        if best is None or (needs.short and _length_m(best) > (1.0 + GOOD_GAP) * bound_m):
            found = _searched(task, motion, _length_m(best) if best is not None else math.inf)
            best, method = (found, "search") if found is not None else (best, method if best is not None else "none")
    if best is None:
        bound_m = bound_m if method == "none" else math.inf
        return Plan(math.inf, bound_m, np.empty((0, 3)), method, time.perf_counter() - began_s)
    return Plan(_length_m(best), bound_m, _way(task.pose, best), method, time.perf_counter() - began_s)


def target_stays_clear(mission: Mission, target_ned_m: Sequence[float] | np.ndarray, until_s: float) -> bool:
    """Return whether a place (2,) in m stays clear of every threat until `until_s`, wherever the threats go.

    It does if it lies outside every disc of radius R_d + MARGIN_M + w until_s about a threat's start, where w is the
    threat's speed bound.
    """
    places_m = np.array([threat.position_ned_m for threat in mission.threats]).reshape(-1, 2)
    radii_m = np.array([t.detection_radius_m + MARGIN_M + t.speed_bound_m_s * until_s for t in mission.threats])
    return bool((np.linalg.norm(places_m - np.asarray(target_ned_m), axis=-1) > radii_m).all())


def ground_turn_radius_m(speed_m_s: float, n_max: float, wind_m_s: float) -> float:
    """Return the radius of the widest circle over ground at the load factor n_max (docs/method.md section 3, wind)."""
    return (speed_m_s + wind_m_s) ** 2 / (n_max * GRAVITY_M_S2)


def verify(
    mission: Mission,
    agent_id: int,
    target_ned_m: Sequence[float] | np.ndarray,
    until_s: float,
    seed: int,
    planned: Plan,
) -> list[str]:
    """Return the faults of a plan's path, found numerically from mission and path alone; none where it is legal.

    Checked are where it begins and ends, its length and time, the curvature and smoothness of each piece, that it is
    inside the fence and outside the exclusions, and the clearance from every threat at its position in `sim.world` at
    that moment, between samples of CHECK_STEP_M.
    """
    task = _task(mission, agent_id, target_ned_m, until_s, NEEDS)
    way = planned.way
    if math.isinf(planned.length_m):
        return [] if way.size == 0 else ["a way without a length"]
    faults = _shape_faults(task, way, planned.length_m)
    if faults:
        return faults
    samples = _samples(way)
    times_s = samples[:, 0] / task.speed_m_s
    if times_s[-1] > until_s + 1e-6:
        faults.append(f"arrives after {times_s[-1]:.1f} s; allowed: {until_s:g} s")
    clearance_m, allowed_m = _clearance_m(mission, seed, times_s, samples[:, 1:]), _least_clearance_m(mission, task)
    if clearance_m < allowed_m - TOLERANCE_M:
        faults.append(f"comes within {clearance_m:.2f} m of a detection disc; allowed: {allowed_m:g} m")
    outside = [point for point in samples[:, 1:] if not _inside(mission, (float(point[0]), float(point[1])))]
    if outside:
        faults.append(f"is outside the fence or inside an exclusion at {len(outside)} points, first at {outside[0]}")
    return faults


def _task(
    mission: Mission, agent_id: int, target_ned_m: Sequence[float] | np.ndarray, until_s: float, needs: Needs
) -> _Task:
    agent = next((agent for agent in mission.agents if agent.id == agent_id), None)
    if agent is None:
        raise ValueError(f"{mission.name}: no agent {agent_id}")
    wind_m_s = mission.wind.speed_m_s + mission.wind.gust_m_s
    start_ned_m = np.array(agent.position_ned_m)
    places_m = np.array([threat.position_ned_m for threat in mission.threats]).reshape(-1, 2)
    radii_m = np.array([threat.detection_radius_m for threat in mission.threats])
    start_gap_m = np.linalg.norm(places_m - start_ned_m, axis=-1) - radii_m
    moves = np.array([_does_move(threat) for threat in mission.threats], dtype=bool)
    # Beside a disc that stands still a path cannot begin with more room than the start has.
    margins_m = np.where(moves, needs.margin_m, np.clip(start_gap_m, 0.0, needs.margin_m))
    return _Task(
        start_ned_m=start_ned_m,
        heading_rad=math.radians(agent.heading_deg or 0.0),
        speed_m_s=agent.speed_m_s,
        turn_radius_m=max(ground_turn_radius_m(agent.speed_m_s, agent.n_max, wind_m_s), needs.turn_radius_m),
        target_ned_m=np.asarray(target_ned_m, dtype=float),
        arrival_m=mission.arrival_radius_m,
        until_s=until_s,
        radii_m=radii_m + margins_m,
        moves=moves,
        walls=_walls(mission, start_ned_m, needs.margin_m),
    )


def _walls(mission: Mission, start_ned_m: np.ndarray, margin_m: float) -> Walls:
    """Return the edges of fence and exclusions; one that the start lies beside keeps as much clearance as that has."""
    edges = walls_of(_polygons(mission), margin_m)
    apart_m = wall_distance_m(start_ned_m[None], edges)[0]
    return Walls(edges.begin_m, edges.end_m, np.clip((1.0 - EDGE_SHARE) * apart_m, LEAST_CLEARANCE_M, margin_m))


def _polygons(mission: Mission) -> list[np.ndarray]:
    fences = [] if mission.fence is None else [mission.fence]
    return [np.array(polygon) for polygon in (*fences, *mission.exclusions)]


def _inside(mission: Mission, point_ned_m: tuple[float, float]) -> bool:
    if any(inside_polygon(point_ned_m, exclusion) for exclusion in mission.exclusions):
        return False
    return mission.fence is None or inside_polygon(point_ned_m, mission.fence)


def _least_clearance_m(mission: Mission, task: _Task) -> float:
    """Return the least distance that a path of a task keeps from any R_d."""
    radii_m = np.array([threat.detection_radius_m for threat in mission.threats])
    return float((task.radii_m - radii_m).min(initial=MARGIN_M))


def _does_move(threat: ThreatSpec) -> bool:
    if isinstance(threat.motion, SteadyMotion):
        return threat.motion.speed_m_s > 0.0
    return threat.motion != "static" and threat.speed_bound_m_s > 0.0


class _Motion:
    """True positions of the threats at every multiple of the integration step; chasers are simulated along a path."""

    def __init__(self, mission: Mission, seed: int, task: _Task) -> None:
        self.step_s = mission.integration_step_s
        self.still = not any(_does_move(threat) for threat in mission.threats)
        if self.still:
            # Where nothing moves, a step is only the distance of two points of a path.
            self.step_s = min(self.step_s, STILL_STEP_RAD * task.turn_radius_m / task.speed_m_s)
        steps = 0 if self.still else math.ceil(task.until_s / self.step_s - 1e-9)
        world = World(mission, seed)
        table = []
        for step in range(steps + 1):
            world.advance(step * self.step_s)
            table.append(world.rows()[1][:, :2])
        self.places_m = np.array(table).reshape(steps + 1, -1, 2)  # (T, M, 2) m; a chaser's rows are not used
        chasers = [index for index, threat in enumerate(mission.threats) if threat.motion == "chase"]
        self.chasers = np.array([index for index in chasers if mission.threats[index].speed_bound_m_s > 0.0], dtype=int)
        self._chase_m = np.array([mission.threats[index].speed_bound_m_s * self.step_s for index in self.chasers])
        self.start_m = self.places_m[0, self.chasers]  # (C, 2) m

    def along(
        self, first: int, chasers_m: np.ndarray, points_m: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:  # (C, 2) m, (B, S, 2) m -> (B or 1, S or 1, M, 2) m, (B, C, 2) m
        """Return where the threats are at the steps after `first` while the agent flies each of B paths.

        The second array holds where the chasing threats are at the end of each path.
        """
        steps = points_m.shape[1]
        if self.still:
            return self.places_m[None], np.empty((len(points_m), 0, 2))
        rows = np.minimum(np.arange(first + 1, first + 1 + steps), len(self.places_m) - 1)
        threats_m = self.places_m[rows][None]
        if not len(self.chasers):
            return threats_m, np.empty((len(points_m), 0, 2))
        threats_m = np.repeat(threats_m, len(points_m), axis=0)
        now_m = np.repeat(chasers_m[None], len(points_m), axis=0)
        for step in range(steps):
            # As in sim.world: straight at where the agent is at the step's end.
            offset_m = points_m[:, step, None] - now_m
            gap_m = np.sqrt((offset_m**2).sum(axis=-1, keepdims=True))
            now_m = now_m + self._chase_m[:, None] * offset_m / np.maximum(gap_m, 1e-9)
            threats_m[:, step, self.chasers] = now_m
        return threats_m, now_m


def _lower_bound_m(task: _Task, places_m: np.ndarray) -> float:  # (M, 2) m at the start
    """Return a length that no path undercuts.

    It is the greater of two lengths: the shortest path without turn limit around the discs that stand still, and the
    shortest path with turn limit without any disc.
    """
    straight_m = float(np.linalg.norm(task.target_ned_m - task.start_ned_m))
    still = ~task.moves
    gap_m = np.linalg.norm(places_m[still] - task.target_ned_m, axis=-1) - task.radii_m[still]
    wall_m = wall_distance_m(task.target_ned_m[None], task.walls)[0] - task.walls.clearance_m
    bound_m = straight_m - task.arrival_m
    # If the arrival circle is free of discs and walls, an agent that reaches it can fly on to its centre.
    if (gap_m >= task.arrival_m).all() and (wall_m >= task.arrival_m).all():
        around_m = shortest_path_length(
            task.start_ned_m, task.target_ned_m, places_m[still], task.radii_m[still], task.walls
        )
        bound_m = around_m - task.arrival_m
    sides = [_turn_and_line(task, task.pose, side) for side in (1.0, -1.0)]
    if all(pieces is not None for pieces in sides):
        bound_m = max(bound_m, min(_length_m(pieces) for pieces in sides if pieces is not None))
    return max(bound_m, 0.0)


def _turn_and_line(task: _Task, pose: tuple[float, float, float], side: float) -> list[PathPiece] | None:
    """Return the turn to one side and the line to the arrival circle, or None if that circle meets the turning circle.

    If the arrival circle meets neither of a vehicle's turning circles, the shortest path of limited turn to it is one
    of these two (relaxed Dubins problem, whose last line points at the centre).
    """
    north_m, east_m, heading_rad = pose
    radius_m = task.turn_radius_m
    to_target_n = float(task.target_ned_m[0]) - (north_m - side * radius_m * math.sin(heading_rad))
    to_target_e = float(task.target_ned_m[1]) - (east_m + side * radius_m * math.cos(heading_rad))
    gap_m = math.hypot(to_target_n, to_target_e)
    if gap_m <= radius_m + task.arrival_m:
        return None
    course_rad = math.atan2(to_target_e, to_target_n) + side * math.asin(radius_m / gap_m)
    turn_rad = side * ((side * (course_rad - heading_rad)) % math.tau)
    line_m = math.sqrt(gap_m**2 - radius_m**2) - task.arrival_m
    if math.tau - abs(turn_rad) < 1e-9:
        turn_rad = 0.0
    return [PathPiece(radius_m * abs(turn_rad), turn_rad), PathPiece(max(line_m, 0.0), 0.0)]


def _planned_statically(task: _Task, motion: _Motion) -> list[PathPiece] | None:
    return _around(task, motion.places_m[0], task.radii_m)


def _around(task: _Task, places_m: np.ndarray, radii_m: np.ndarray) -> list[PathPiece] | None:
    pieces = turning_path(
        Departure(task.start_ned_m, task.heading_rad, task.turn_radius_m),
        task.target_ned_m,
        task.arrival_m,
        places_m,
        radii_m,
        task.walls,
    )
    return pieces if pieces is not None and _length_m(pieces) <= task.speed_m_s * task.until_s else None


def _repaired(task: _Task, motion: _Motion) -> list[PathPiece] | None:
    """Return the shortest clear path around copies of the discs that move, or None if no rule for copying finds one."""
    best: list[PathPiece] | None = None
    for rule in _RULES:
        pieces = _repaired_by(rule, task, motion)
        if pieces is not None and (best is None or _length_m(pieces) < _length_m(best)):
            best = pieces
    return best


def _repaired_by(rule: _Rule, task: _Task, motion: _Motion, first: Sequence[_Copy] = ()) -> list[PathPiece] | None:
    """Return a clear path around copies of the discs that move, or None if REPAIRS rounds of copying find none.

    It begins with the copies `first`; each round adds copies of the discs that the path enters, chosen by the rule. A
    copy that holds the start or the target cannot be planned around: then the function gives up. Copies that the clear
    path does not need are removed again, the oldest first: they were made for paths given up since.
    """
    copies = list(first)
    for _ in range(REPAIRS):
        pieces = _around_copies(task, motion, copies)
        if pieces is None:
            return None
        depth_m, threats_m = _depths_m(task, motion, pieces)
        if depth_m.max(initial=-1.0) <= 0.0:
            break
        copies += _copies(task, motion, threats_m, rule(depth_m))
    else:
        return None
    for copy in list(copies):
        fewer = [other for other in copies if other is not copy]
        shorter = _around_copies(task, motion, fewer)
        if shorter is not None and _depths_m(task, motion, shorter)[0].max(initial=-1.0) <= 0.0:
            copies = fewer
            pieces = min(pieces, shorter, key=_length_m)
    return pieces


def _around_copies(task: _Task, motion: _Motion, copies: Sequence[_Copy]) -> list[PathPiece] | None:
    rows = np.array(copies).reshape(-1, 3)
    still = ~task.moves
    places_m = np.vstack((motion.places_m[0][still], rows[:, :2]))
    return _around(task, places_m, np.concatenate((task.radii_m[still], rows[:, 2])))


def _copies(
    task: _Task, motion: _Motion, threats_m: np.ndarray, entries: Sequence[tuple[int, int]]
) -> list[_Copy]:  # (S, M, 2) m
    """Return copies of the discs at (step, threat) pairs, enlarged so that a path that touches one passes the check."""
    wider_m = 2 * _slack_m(task, motion)
    return [
        (float(threats_m[step, threat, 0]), float(threats_m[step, threat, 1]), float(task.radii_m[threat]) + wider_m)
        for step, threat in entries
    ]


def _depths_m(
    task: _Task, motion: _Motion, pieces: Sequence[PathPiece]
) -> tuple[np.ndarray, np.ndarray]:  # (S, M) m, (S, M, 2) m
    """Return how deep a path is inside each threat at every step after the first, and where the threats are then."""
    points_m = _at_steps(task, task.pose, pieces, motion.step_s)[1:]
    threats_m = motion.along(0, motion.start_m, points_m[None])[0][0]
    depth_m = task.radii_m + _slack_m(task, motion) - np.linalg.norm(threats_m - points_m[:, None], axis=-1)
    return depth_m, threats_m


def _deepest_of_each(depth_m: np.ndarray) -> list[tuple[int, int]]:  # (S, M) m
    """Return the (step, threat) of the deepest place in each threat that is entered."""
    return [(int(depth_m[:, threat].argmax()), int(threat)) for threat in _entered(depth_m)]


def _first_of_each(depth_m: np.ndarray) -> list[tuple[int, int]]:  # (S, M) m
    """Return the (step, threat) of the first moment in each threat that is entered."""
    return [(int((depth_m[:, threat] > 0.0).argmax()), int(threat)) for threat in _entered(depth_m)]


def _deepest_of_first(depth_m: np.ndarray) -> list[tuple[int, int]]:  # (S, M) m
    """Return the (step, threat) of the deepest place in the threat that is entered first."""
    _, threat = min(_first_of_each(depth_m))
    return [(int(depth_m[:, threat].argmax()), threat)]


def _entered(depth_m: np.ndarray) -> np.ndarray:  # (S, M) m -> (E,)
    return np.flatnonzero((depth_m > 0.0).any(axis=0))


_Copy = tuple[float, float, float]
"""Copy of a moving disc as it is at one moment: north m, east m and radius m."""
_Rule = Callable[[np.ndarray], list[tuple[int, int]]]
"""Rule for copying: from the depths (S, M) of a path inside each threat at each step to the (step, threat) to copy."""
_RULES: tuple[_Rule, ...] = (_deepest_of_each, _first_of_each, _deepest_of_first)


def _slack_m(task: _Task, motion: _Motion) -> float:
    """Return how much nearer a disc may come between two steps than at both: the sagitta of the motions, and 0.1 m."""
    chord_m = 2 * task.speed_m_s * motion.step_s
    least_m = min(task.turn_radius_m, float(task.radii_m.min(initial=math.inf)))
    return chord_m**2 / (8 * least_m) + 0.1


def _searched(task: _Task, motion: _Motion, known_m: float) -> list[PathPiece] | None:
    """Return a path shorter than `known_m`, found by search and pulled tight around the moving threats, or None."""
    best: list[PathPiece] | None = None
    for weight, steps in SEARCHES:
        found = _Search(task, motion, weight, min(known_m, task.speed_m_s * task.until_s)).run(steps)
        if found is not None:
            best, known_m = found, _length_m(found)
    if best is None or motion.still:
        return best
    depth_m, threats_m = _depths_m(task, motion, best)
    near = np.flatnonzero(task.moves & (depth_m > -NEAR_SHARE * task.radii_m).any(axis=0))
    copies = _copies(task, motion, threats_m, [(int(depth_m[:, threat].argmax()), int(threat)) for threat in near])
    tight = [_repaired_by(rule, task, motion, copies) for rule in _RULES]
    return min((best, *(pieces for pieces in tight if pieces is not None)), key=_length_m)


@dataclass(frozen=True, slots=True)
class _Node:
    pose: tuple[float, float, float]
    step: int
    chasers_m: np.ndarray  # (C, 2) m
    parent: _Node | None
    piece: PathPiece | None


class _Search:
    """Weighted A* over poses in time; pieces of equal length and five curvatures join the poses."""

    def __init__(self, task: _Task, motion: _Motion, weight: float, limit_m: float) -> None:
        self._task, self._motion, self._weight, self._limit_m = task, motion, weight, limit_m
        step_m = task.speed_m_s * motion.step_s
        reach_m = float(np.linalg.norm(task.target_ned_m - task.start_ned_m))
        piece_m = max(PIECE_TURN_RAD * task.turn_radius_m, reach_m / 100.0)
        self._steps = max(2, round(piece_m / step_m))
        self._length_m = self._steps * step_m
        sharpest_rad = min(self._length_m / task.turn_radius_m, 1.2)
        self._turns_rad = sharpest_rad * np.array([0.0, 0.5, -0.5, 1.0, -1.0])
        share = np.arange(1, self._steps + 1) / self._steps
        half_rad = 0.5 * self._turns_rad[:, None] * share
        chord_m = self._length_m * share * np.sinc(half_rad / math.pi)
        self._ahead_m, self._right_m = chord_m * np.cos(half_rad), chord_m * np.sin(half_rad)  # (5, S) m
        # What no point comes nearer to: discs, and walls, across which no step leads.
        self._clear_m2 = (task.radii_m + _slack_m(task, motion)) ** 2
        self._walls_m = np.maximum(task.walls.clearance_m + _slack_m(task, motion), 0.5 * step_m)
        self._far = _Far(task, motion, self._length_m / 2)

    def run(self, steps: int) -> list[PathPiece] | None:
        """Return a path shorter than the limit, improved as far as `steps` opened poses allow, or None."""
        task, order = self._task, count()
        root = _Node(task.pose, 0, self._motion.start_m, None, None)
        queue = [(0.0, next(order), root)]
        closed: set[tuple[int, ...]] = set()
        best: list[PathPiece] | None = None
        tries = SHOT_EVERY if len(self._motion.chasers) else 1
        for opened in range(steps):
            if not queue:
                break
            _, _, node = heapq.heappop(queue)
            key = self._key(node)
            if key in closed or node.step * self._length_per_step_m + self._far.at_m(node.pose) >= self._limit_m:
                continue
            closed.add(key)
            if opened % tries == 0:
                shot = self._shot(node)
                if shot is not None:
                    best = [*_pieces_to(node), *shot]
                    self._limit_m = _length_m(best)
            for child in self._children(node):
                flown_m = child.step * self._length_per_step_m
                far_m = self._far.at_m(child.pose)
                if flown_m + far_m < self._limit_m and self._key(child) not in closed:
                    heapq.heappush(queue, (flown_m + self._weight * far_m, next(order), child))
        return best

    @property
    def _length_per_step_m(self) -> float:
        return self._task.speed_m_s * self._motion.step_s

    def _key(self, node: _Node) -> tuple[int, ...]:
        north_m, east_m, heading_rad = node.pose
        late = 0 if self._motion.still else int(node.step * self._motion.step_s / TIME_BIN_S)
        heading = int((heading_rad % math.tau) / math.tau * HEADING_BINS)
        cell_m = self._length_m / 2
        return math.floor(north_m / cell_m), math.floor(east_m / cell_m), heading, late

    def _children(self, node: _Node) -> list[_Node]:
        north_m, east_m, heading_rad = node.pose
        cosine, sine = math.cos(heading_rad), math.sin(heading_rad)
        points_m = np.stack(
            (
                north_m + cosine * self._ahead_m - sine * self._right_m,
                east_m + sine * self._ahead_m + cosine * self._right_m,
            ),
            axis=-1,
        )
        clear, chasers_m = self._clear(node, points_m)
        children = []
        for index in np.flatnonzero(clear):
            turn_rad = float(self._turns_rad[index])
            end = points_m[index, -1]
            pose = (float(end[0]), float(end[1]), heading_rad + turn_rad)
            chased_m = chasers_m[index]
            children.append(_Node(pose, node.step + self._steps, chased_m, node, PathPiece(self._length_m, turn_rad)))
        return children

    def _shot(self, node: _Node) -> list[PathPiece] | None:
        """Return the shorter clear turn and line from a node to the target that keeps to the length limit, or None."""
        flown_m = node.step * self._length_per_step_m
        found: list[PathPiece] | None = None
        for side in (1.0, -1.0):
            pieces = _turn_and_line(self._task, node.pose, side)
            if pieces is None or flown_m + _length_m(pieces) >= self._limit_m:
                continue
            if found is not None and _length_m(pieces) >= _length_m(found):
                continue
            points_m = _at_steps(self._task, node.pose, pieces, self._motion.step_s)
            if self._clear(node, points_m[None, 1:])[0][0]:
                found = pieces
        return found

    def _clear(self, node: _Node, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # (B, S, 2) m
        threats_m, chasers_m = self._motion.along(node.step, node.chasers_m, points_m)
        offset_m = threats_m - points_m[:, :, None]
        apart_m2 = offset_m[..., 0] ** 2 + offset_m[..., 1] ** 2
        clear = (apart_m2 >= self._clear_m2).all(axis=(1, 2))
        if len(self._task.walls.begin_m):
            wall_m = wall_distance_m(points_m.reshape(-1, 2), self._task.walls)
            clear &= (wall_m >= self._walls_m).reshape(len(points_m), -1).all(axis=1)
        return clear, chasers_m


class _Far:
    """Estimate of the distance to the target: the straight line, or a walk on a grid around discs that stand still."""

    def __init__(self, task: _Task, motion: _Motion, cell_m: float) -> None:
        self._task = task
        self._grid: np.ndarray | None = None
        still = ~task.moves
        if still.any():
            self._build(motion.places_m[0][still], task.radii_m[still], cell_m)

    def at_m(self, pose: tuple[float, float, float]) -> float:
        """Return the estimate in m from a pose to the arrival circle; infinite where no walk on the grid leads on."""
        north_m, east_m = pose[0] - self._task.target_ned_m[0], pose[1] - self._task.target_ned_m[1]
        straight_m = max(0.0, math.hypot(north_m, east_m) - self._task.arrival_m)
        if self._grid is None:
            return straight_m
        row = int((pose[0] - self._low_m[0]) / self._cell_m)
        column = int((pose[1] - self._low_m[1]) / self._cell_m)
        if not (0 <= row < self._grid.shape[0] and 0 <= column < self._grid.shape[1]):
            return straight_m
        return max(straight_m, float(self._grid[row, column]))

    def _build(self, places_m: np.ndarray, radii_m: np.ndarray, cell_m: float) -> None:
        ends_m = np.vstack((self._task.start_ned_m, self._task.target_ned_m))
        low_m = np.minimum(ends_m.min(axis=0), (places_m - radii_m[:, None]).min(axis=0)) - 6 * cell_m
        high_m = np.maximum(ends_m.max(axis=0), (places_m + radii_m[:, None]).max(axis=0)) + 6 * cell_m
        # At most a hundred thousand cells.
        cell_m = max(cell_m, math.sqrt(float(np.prod(high_m - low_m)) / 1e5))
        shape = tuple(int(size) for size in np.ceil((high_m - low_m) / cell_m))
        north_m = low_m[0] + (np.arange(shape[0]) + 0.5) * cell_m
        east_m = low_m[1] + (np.arange(shape[1]) + 0.5) * cell_m
        free = np.ones(shape, dtype=bool)
        for place_m, radius_m in zip(places_m, radii_m, strict=True):
            # A cell is closed when it lies wholly within a disc, so that no gap is closed.
            reach_m = radius_m - cell_m * math.sqrt(0.5)
            if reach_m > 0.0:
                free &= np.hypot(north_m[:, None] - place_m[0], east_m - place_m[1]) > reach_m
        goal = tuple(((self._task.target_ned_m - low_m) / cell_m).astype(int))
        self._low_m, self._cell_m = low_m, cell_m
        # A walk in eight directions is up to 8 % too long and joins centres of cells; both are subtracted.
        walk_m = _grid_distance(free, (int(goal[0]), int(goal[1]))) * cell_m
        self._grid = np.maximum(walk_m / 1.083 - cell_m * math.sqrt(2.0) - self._task.arrival_m, 0.0)


def _grid_distance(free: np.ndarray, goal: tuple[int, int]) -> np.ndarray:  # (R, C) bool -> (R, C) cells
    """Return the length of the eight-direction walk from each free cell to the goal; infinite if none exists."""
    ids = np.arange(free.size).reshape(free.shape)
    begin, end, length = [], [], []
    height, width = free.shape
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = (slice(0, height - down), slice(max(0, -right), width - max(0, right)))
        there = (slice(down, height), slice(max(0, right), width - max(0, -right)))
        open_ = free[here] & free[there]
        begin.append(ids[here][open_])
        end.append(ids[there][open_])
        length.append(np.full(int(open_.sum()), math.hypot(down, right)))
    columns = (np.concatenate(length), (np.concatenate(begin), np.concatenate(end)))
    edges = coo_array(columns, shape=(free.size, free.size)).tocsr()
    distance: np.ndarray = dijkstra(edges, directed=False, indices=[int(ids[goal])]).reshape(free.shape)
    return distance


def _pieces_to(node: _Node) -> list[PathPiece]:
    pieces: list[PathPiece] = []
    while node.parent is not None and node.piece is not None:
        pieces.append(node.piece)
        node = node.parent
    return pieces[::-1]


def _length_m(pieces: Sequence[PathPiece]) -> float:
    return math.fsum(piece.length_m for piece in pieces)


def _at_steps(
    task: _Task, pose: tuple[float, float, float], pieces: Sequence[PathPiece], step_s: float
) -> np.ndarray:  # (S, 2) m
    """Return the points of a path at every step, to the first at or after its end, past which it goes straight on."""
    step_m = task.speed_m_s * step_s
    ends_m = np.cumsum([piece.length_m for piece in pieces])
    total_m = float(ends_m[-1]) if len(pieces) else 0.0
    flown_m = np.arange(math.ceil(total_m / step_m - 1e-9) + 1) * step_m
    index = np.searchsorted(ends_m, flown_m, side="left") if len(pieces) else np.zeros(len(flown_m), dtype=int)
    poses = [pose]
    for piece in pieces:
        poses.append(_moved(poses[-1], piece))
    begins = np.array(poses)  # (P + 1, 3)
    lengths_m = np.array([piece.length_m for piece in pieces] + [math.inf])
    turns_rad = np.array([piece.turn_rad for piece in pieces] + [0.0])
    into_m = flown_m - np.concatenate(([0.0], ends_m))[index]
    half_rad = 0.5 * turns_rad[index] * into_m / np.maximum(lengths_m[index], 1e-12)
    chord_m = into_m * np.sinc(half_rad / math.pi)
    course_rad = begins[index, 2] + half_rad
    points_m: np.ndarray = begins[index, :2] + chord_m[:, None] * np.column_stack(
        (np.cos(course_rad), np.sin(course_rad))
    )
    return points_m


def _moved(pose: tuple[float, float, float], piece: PathPiece) -> tuple[float, float, float]:
    north_m, east_m, _ = advance(*pose, piece.length_m, piece.turn_rad, 1.0)
    # Not wrapped, so that a turn between two poses is their difference.
    return north_m, east_m, pose[2] + piece.turn_rad


def _way(pose: tuple[float, float, float], pieces: Sequence[PathPiece]) -> np.ndarray:  # (W, 3)
    points = [pose]
    for piece in pieces:
        if piece.length_m == 0.0:
            continue
        parts = max(1, math.ceil(abs(piece.turn_rad) / WAY_TURN_RAD))
        begin = points[-1]
        for part in range(1, parts + 1):
            points.append(_moved(begin, PathPiece(piece.length_m * part / parts, piece.turn_rad * part / parts)))
    return np.array(points)


def _shape_faults(task: _Task, way: np.ndarray, length_m: float) -> list[str]:
    faults = []
    if way.ndim != 2 or way.shape[1:] != (3,) or not len(way) or not np.isfinite(way).all():
        return ["not a way"]
    turn_rad = np.remainder(way[0, 2] - task.heading_rad + math.pi, math.tau) - math.pi
    if np.linalg.norm(way[0, :2] - task.start_ned_m) > 1e-3 or abs(turn_rad) > 1e-6:
        faults.append("begins elsewhere than the agent")
    miss_m = float(np.linalg.norm(way[-1, :2] - task.target_ned_m)) - task.arrival_m
    if miss_m > 1e-3:
        faults.append(f"ends {miss_m:.1f} m outside the arrival circle")
    lengths_m, turns_rad, kinks_rad = _measured(way)
    if (np.abs(turns_rad) > 1.01 * WAY_TURN_RAD + 1e-9).any():
        faults.append("points too far apart to say how it turns")
    if (kinks_rad > 1e-4).any():
        faults.append(f"bends by {kinks_rad.max():.4f} rad at a point")
    if (np.abs(turns_rad) * task.turn_radius_m > lengths_m * (1 + 1e-4) + 1e-6).any():
        faults.append("turns tighter than the turn radius")
    if abs(float(lengths_m.sum()) - length_m) > 1e-3 + 1e-6 * length_m:
        faults.append(f"is {lengths_m.sum():.1f} m long and said to be {length_m:.1f} m")
    return faults


def _measured(way: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # (W, 3) -> (W - 1,) each
    """Return each piece's length m and turn rad, and by how much its chord is off the middle heading, in rad."""
    offset_m = np.diff(way[:, :2], axis=0)
    chord_m = np.linalg.norm(offset_m, axis=-1)
    turn_rad = np.remainder(np.diff(way[:, 2]) + math.pi, math.tau) - math.pi
    lengths_m = chord_m / np.sinc(0.5 * turn_rad / math.pi)
    course_rad = np.arctan2(offset_m[:, 1], offset_m[:, 0])
    kink_rad = np.abs(np.remainder(course_rad - way[:-1, 2] - 0.5 * turn_rad + math.pi, math.tau) - math.pi)
    # The direction of a chord of millimetres is rounding.
    return lengths_m, turn_rad, np.where(chord_m > 1e-3, kink_rad, 0.0)


def _samples(way: np.ndarray) -> np.ndarray:  # (S, 3) flown m, north m, east m
    """Return points of a path at most CHECK_STEP_M apart, both ends included."""
    lengths_m, turns_rad, _ = _measured(way)
    rows = [np.array([[0.0, *way[0, :2]]])]
    flown_m = 0.0
    for begin, length_m, turn_rad in zip(way[:-1], lengths_m, turns_rad, strict=True):
        share = np.arange(1, math.ceil(length_m / CHECK_STEP_M) + 1) / max(1, math.ceil(length_m / CHECK_STEP_M))
        half_rad = 0.5 * turn_rad * share
        chord_m = length_m * share * np.sinc(half_rad / math.pi)
        course_rad = begin[2] + half_rad
        rows.append(
            np.column_stack(
                (
                    flown_m + length_m * share,
                    begin[0] + chord_m * np.cos(course_rad),
                    begin[1] + chord_m * np.sin(course_rad),
                )
            )
        )
        flown_m += length_m
    return np.vstack(rows)


def _clearance_m(mission: Mission, seed: int, times_s: np.ndarray, points_m: np.ndarray) -> float:  # (S,) s, (S, 2) m
    """Return the least distance in m from points of a path to the edges of the discs, negative inside.

    The threats are where `sim.world` has them, interpolated linearly between its steps.
    """
    if not mission.threats:
        return math.inf
    radii_m = np.array([threat.detection_radius_m for threat in mission.threats])  # (M,) m
    world, step_s = World(mission, seed), mission.integration_step_s
    ticks_s = np.arange(math.ceil(times_s[-1] / step_s - 1e-9) + 2) * step_s
    agent_m = np.column_stack([np.interp(ticks_s, times_s, points_m[:, axis]) for axis in (0, 1)])
    table = []
    for tick_s, place_m in zip(ticks_s, agent_m, strict=True):
        world.advance(float(tick_s), place_m[None] if tick_s > 0.0 else None)
        table.append(world.rows()[1][:, :2])
    threats_m = np.array(table)  # (T, M, 2)
    index = np.minimum((times_s / step_s).astype(int), len(ticks_s) - 2)
    share = (times_s / step_s - index)[:, None, None]
    there_m = (1.0 - share) * threats_m[index] + share * threats_m[index + 1]  # (S, M, 2)
    return float((np.linalg.norm(there_m - points_m[:, None], axis=-1) - radii_m).min())
