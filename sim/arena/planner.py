"""The arena's yardstick: the shortest path that an agent could have flown, or the proof that there is none.

The planner knows everything, including the true motion of every threat to the end of the run, and plans for one agent
alone: other agents are not in its way, and a chasing threat chases only this agent. It shares no code with the
companion's route. Every path (a `way` in the code) comes with a lower bound of the length that any path needs, and
`plan_check.verify` checks the path numerically.

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

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from companion.mission.model import Mission
from sim.arena.plan_search import Search
from sim.arena.plan_task import (
    MARGIN_M,
    NEEDS,
    Motion,
    Needs,
    Task,
    at_steps,
    moved,
    slack_m,
    task_of,
    turn_and_line,
    way_length_m,
)
from sim.shortest_path import (
    Departure,
    PathPiece,
    shortest_path_length,
    turning_path,
    wall_distance_m,
)

GOOD_GAP = 0.05
"""Excess over the lower bound, as a share of it, up to which no better path is searched for."""
REPAIRS = 20
"""Rounds in which copies of moving discs are added to one plan before it is given up."""
SEARCHES = ((2.0, 3_000), (1.2, 2_500))
"""Weight of the remaining distance and greatest number of poses opened, for each of the two searches: the first finds a
path soon, the second a short one. A thousand poses take 0.3 to 0.8 s."""
NEAR_SHARE = 0.5
"""Distance from a moving threat's edge, as a share of its radius, within which a path found by search is pulled tight
around the threat."""
WAY_TURN_RAD = 0.2
"""Greatest turn between two consecutive points of a path."""
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
    task = task_of(mission, agent_id, target_ned_m, until_s, needs)
    motion = Motion(mission, seed, task)
    bound_m = _lower_bound_m(task, motion.places_m[0])
    best: list[PathPiece] | None = None
    method: Method = "impossible"
    if bound_m <= task.speed_m_s * until_s:
        planned = _planned_statically if motion.still else _repaired
        method = "tangents" if motion.still else "repaired"
        best = planned(task, motion)
        if best is None or (needs.short and way_length_m(best) > (1.0 + GOOD_GAP) * bound_m):
            found = _searched(task, motion, way_length_m(best) if best is not None else math.inf)
            best, method = (found, "search") if found is not None else (best, method if best is not None else "none")
    if best is None:
        bound_m = bound_m if method == "none" else math.inf
        return Plan(math.inf, bound_m, np.empty((0, 3)), method, time.perf_counter() - began_s)
    return Plan(way_length_m(best), bound_m, _way(task.pose, best), method, time.perf_counter() - began_s)


def leads_on(mission: Mission, agent_id: int, planned: Plan, needs: Needs) -> bool:
    """Return whether the end of a plan among threats that stand still has a turning circle, to one side, that is clear.

    From an end without one the agent might not be able to fly on.
    """
    heading_rad = float(planned.way[-1, 2])
    task = task_of(mission, agent_id, planned.way[-1, :2], 0.0, needs)
    places_m = np.array([threat.position_ned_m for threat in mission.threats]).reshape(-1, 2)
    to_right = np.array([-math.sin(heading_rad), math.cos(heading_rad)])
    centres_m = planned.way[-1, :2] + task.turn_radius_m * np.outer((1.0, -1.0), to_right)
    disc_m = np.linalg.norm(centres_m[:, None] - places_m, axis=-1) - task.radii_m
    wall_m = wall_distance_m(centres_m, task.walls) - task.walls.clearance_m
    room_m = np.minimum(disc_m.min(axis=1, initial=math.inf), wall_m.min(axis=1, initial=math.inf))
    return bool((room_m >= task.turn_radius_m).any())


def target_stays_clear(mission: Mission, target_ned_m: Sequence[float] | np.ndarray, until_s: float) -> bool:
    """Return whether a place (2,) in m stays clear of every threat until `until_s`, wherever the threats go.

    It does if it lies outside every disc of radius R_d + MARGIN_M + w until_s about a threat's start, where w is the
    threat's speed bound.
    """
    places_m = np.array([threat.position_ned_m for threat in mission.threats]).reshape(-1, 2)
    radii_m = np.array([t.detection_radius_m + MARGIN_M + t.speed_bound_m_s * until_s for t in mission.threats])
    return bool((np.linalg.norm(places_m - np.asarray(target_ned_m), axis=-1) > radii_m).all())


def _lower_bound_m(task: Task, places_m: np.ndarray) -> float:  # (M, 2) m at the start
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
    sides = [turn_and_line(task, task.pose, side) for side in (1.0, -1.0)]
    if all(pieces is not None for pieces in sides):
        bound_m = max(bound_m, min(way_length_m(pieces) for pieces in sides if pieces is not None))
    return max(bound_m, 0.0)


def _planned_statically(task: Task, motion: Motion) -> list[PathPiece] | None:
    return _around(task, motion.places_m[0], task.radii_m)


def _around(task: Task, places_m: np.ndarray, radii_m: np.ndarray) -> list[PathPiece] | None:
    pieces = turning_path(
        Departure(task.start_ned_m, task.heading_rad, task.turn_radius_m),
        task.target_ned_m,
        task.arrival_m,
        places_m,
        radii_m,
        task.walls,
    )
    return pieces if pieces is not None and way_length_m(pieces) <= task.speed_m_s * task.until_s else None


def _repaired(task: Task, motion: Motion) -> list[PathPiece] | None:
    """Return the shortest clear path around copies of the discs that move, or None if no rule for copying finds one."""
    best: list[PathPiece] | None = None
    for rule in _RULES:
        pieces = _repaired_by(rule, task, motion)
        if pieces is not None and (best is None or way_length_m(pieces) < way_length_m(best)):
            best = pieces
    return best


def _repaired_by(rule: _Rule, task: Task, motion: Motion, first: Sequence[_Copy] = ()) -> list[PathPiece] | None:
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
            pieces = min(pieces, shorter, key=way_length_m)
    return pieces


def _around_copies(task: Task, motion: Motion, copies: Sequence[_Copy]) -> list[PathPiece] | None:
    rows = np.array(copies).reshape(-1, 3)
    still = ~task.moves
    places_m = np.vstack((motion.places_m[0][still], rows[:, :2]))
    return _around(task, places_m, np.concatenate((task.radii_m[still], rows[:, 2])))


def _copies(
    task: Task, motion: Motion, threats_m: np.ndarray, entries: Sequence[tuple[int, int]]
) -> list[_Copy]:  # (S, M, 2) m
    """Return copies of the discs at (step, threat) pairs, enlarged so that a path that touches one passes the check."""
    wider_m = 2 * slack_m(task, motion)
    return [
        (float(threats_m[step, threat, 0]), float(threats_m[step, threat, 1]), float(task.radii_m[threat]) + wider_m)
        for step, threat in entries
    ]


def _depths_m(
    task: Task, motion: Motion, pieces: Sequence[PathPiece]
) -> tuple[np.ndarray, np.ndarray]:  # (S, M) m, (S, M, 2) m
    """Return how deep a path is inside each threat at every step after the first, and where the threats are then."""
    points_m = at_steps(task, task.pose, pieces, motion.step_s)[1:]
    threats_m = motion.along(0, motion.start_m, points_m[None])[0][0]
    depth_m = task.radii_m + slack_m(task, motion) - np.linalg.norm(threats_m - points_m[:, None], axis=-1)
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


def _searched(task: Task, motion: Motion, known_m: float) -> list[PathPiece] | None:
    """Return a path shorter than `known_m`, found by search and pulled tight around the moving threats, or None."""
    best: list[PathPiece] | None = None
    for weight, steps in SEARCHES:
        found = Search(task, motion, weight, min(known_m, task.speed_m_s * task.until_s)).run(steps)
        if found is not None:
            best, known_m = found, way_length_m(found)
    if best is None or motion.still:
        return best
    depth_m, threats_m = _depths_m(task, motion, best)
    near = np.flatnonzero(task.moves & (depth_m > -NEAR_SHARE * task.radii_m).any(axis=0))
    copies = _copies(task, motion, threats_m, [(int(depth_m[:, threat].argmax()), int(threat)) for threat in near])
    tight = [_repaired_by(rule, task, motion, copies) for rule in _RULES]
    return min((best, *(pieces for pieces in tight if pieces is not None)), key=way_length_m)


def _way(pose: tuple[float, float, float], pieces: Sequence[PathPiece]) -> np.ndarray:  # (W, 3)
    points = [pose]
    for piece in pieces:
        if piece.length_m == 0.0:
            continue
        parts = max(1, math.ceil(abs(piece.turn_rad) / WAY_TURN_RAD))
        begin = points[-1]
        for part in range(1, parts + 1):
            points.append(moved(begin, PathPiece(piece.length_m * part / parts, piece.turn_rad * part / parts)))
    return np.array(points)
