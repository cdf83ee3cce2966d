"""The planning problem of one agent: what its path must keep, where the threats truly are, and pieces of a path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.geo.kinematics import GRAVITY_M_S2, advance
from companion.geo.polygon import inside_polygon
from companion.mission.model import Mission, SteadyMotion, ThreatSpec
from sim.shortest_path import (
    PathPiece,
    Walls,
    wall_distance_m,
    walls_of,
)
from sim.world import World

MARGIN_M = 2.0
"""Distance that a path keeps from every R_d and every edge, unless another is asked for, so that none grazes what the
guard must keep out of."""
EDGE_SHARE = 1e-6
"""Share of the start's distance from an edge by which the edge's clearance is less, for rounding."""
LEAST_CLEARANCE_M = 1e-3
"""Least clearance from an edge: round a corner without any no path could turn."""
STILL_STEP_RAD = 0.2
"""Greatest turn between two points of a path among discs that stand still."""


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
class Task:
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
        """North m, east m and heading rad of the start."""
        return float(self.start_ned_m[0]), float(self.start_ned_m[1]), self.heading_rad


class Motion:
    """True positions of the threats at every multiple of the integration step; chasers are simulated along a path."""

    def __init__(self, mission: Mission, seed: int, task: Task) -> None:
        self.step_s = mission.integration_step_s
        self.still = not any(does_move(threat) for threat in mission.threats)
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


def ground_turn_radius_m(speed_m_s: float, n_max: float, wind_m_s: float) -> float:
    """Return the radius of the widest circle over ground at the load factor n_max (docs/method.md section 3, wind)."""
    return (speed_m_s + wind_m_s) ** 2 / (n_max * GRAVITY_M_S2)


def task_of(
    mission: Mission, agent_id: int, target_ned_m: Sequence[float] | np.ndarray, until_s: float, needs: Needs
) -> Task:
    """Return the problem of an agent that is to reach a place (2,) in m. Raise ValueError for an unknown agent."""
    agent = next((agent for agent in mission.agents if agent.id == agent_id), None)
    if agent is None:
        raise ValueError(f"{mission.name}: no agent {agent_id}")
    wind_m_s = mission.wind.speed_m_s + mission.wind.gust_m_s
    start_ned_m = np.array(agent.position_ned_m)
    places_m = np.array([threat.position_ned_m for threat in mission.threats]).reshape(-1, 2)
    radii_m = np.array([threat.detection_radius_m for threat in mission.threats])
    start_gap_m = np.linalg.norm(places_m - start_ned_m, axis=-1) - radii_m
    moves = np.array([does_move(threat) for threat in mission.threats], dtype=bool)
    # Beside a disc that stands still a path cannot begin with more room than the start has.
    margins_m = np.where(moves, needs.margin_m, np.clip(start_gap_m, 0.0, needs.margin_m))
    return Task(
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


def is_inside(mission: Mission, point_ned_m: tuple[float, float]) -> bool:
    """Return whether a point is inside the fence and outside the exclusions."""
    if any(inside_polygon(point_ned_m, exclusion) for exclusion in mission.exclusions):
        return False
    return mission.fence is None or inside_polygon(point_ned_m, mission.fence)


def does_move(threat: ThreatSpec) -> bool:
    """Return whether a threat ever moves."""
    if isinstance(threat.motion, SteadyMotion):
        return threat.motion.speed_m_s > 0.0
    return threat.motion != "static" and threat.speed_bound_m_s > 0.0


def slack_m(task: Task, motion: Motion) -> float:
    """Return how much nearer a disc may come between two steps than at both: the sagitta of the motions, and 0.1 m."""
    chord_m = 2 * task.speed_m_s * motion.step_s
    least_m = min(task.turn_radius_m, float(task.radii_m.min(initial=math.inf)))
    return chord_m**2 / (8 * least_m) + 0.1


def turn_and_line(task: Task, pose: tuple[float, float, float], side: float) -> list[PathPiece] | None:
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


def way_length_m(pieces: Sequence[PathPiece]) -> float:
    """Return the length of a path in m."""
    return math.fsum(piece.length_m for piece in pieces)


def at_steps(
    task: Task, pose: tuple[float, float, float], pieces: Sequence[PathPiece], step_s: float
) -> np.ndarray:  # (S, 2) m
    """Return the points of a path at every step, to the first at or after its end, past which it goes straight on."""
    step_m = task.speed_m_s * step_s
    ends_m = np.cumsum([piece.length_m for piece in pieces])
    total_m = float(ends_m[-1]) if len(pieces) else 0.0
    flown_m = np.arange(math.ceil(total_m / step_m - 1e-9) + 1) * step_m
    index = np.searchsorted(ends_m, flown_m, side="left") if len(pieces) else np.zeros(len(flown_m), dtype=int)
    poses = [pose]
    for piece in pieces:
        poses.append(moved(poses[-1], piece))
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


def moved(pose: tuple[float, float, float], piece: PathPiece) -> tuple[float, float, float]:
    """Return the pose at the end of a piece that begins at a pose."""
    north_m, east_m, _ = advance(*pose, piece.length_m, piece.turn_rad, 1.0)
    # Not wrapped, so that a turn between two poses is their difference.
    return north_m, east_m, pose[2] + piece.turn_rad
