"""The routes that agents should be flying: from where each is, around the threats, to its target.

They are the shortest ways of companion/guidance/route around the discs as they are told, grown by their age, without
the surrogate's pull: the way that a vehicle means to fly, not the turn that it makes in this second. Pictures in,
routes out, with bounded work for each.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from companion.geo.kinematics import turn_rate_rad_s
from companion.guard.types import Piece
from companion.guidance.course import at, left_of, nearest
from companion.guidance.route.router import Goal, shortest_route
from companion.guidance.route.walls import NO_WALLS, Walls
from companion.mission.model import AgentSpec, Mission, agent_height_m

Picture = Mapping[str, Any]
"""A picture as groundstation/view.py makes it, or one of the things in it."""
WORK_S = 0.25
"""Time for the routes of one picture: a quarter of a core, at the lowest priority, however many agents there are."""
KEPT_S = 10.0
"""Age of a route, by the pictures' time, at which it is searched again though nothing has changed."""
OFF_ROUTE_M = 30.0
"""Distance of an agent from its route at which that is searched again."""
GRID_M = 10.0
"""What moves or grows by less changes no route before KEPT_S."""
CLEARANCE_M = 1.0
"""Distance that a route keeps from discs and walls, so that it does not touch them."""
ARC_RAD = math.radians(10.0)
"""Greatest turn between two points of a route."""
MOST_POINTS = 200
"""Greatest number of points of one route."""


class _Kept(NamedTuple):
    """A route that was found: for which question, when, and its pieces, none if no way leads to the target."""

    question: object
    found_at_s: float
    pieces: tuple[Piece, ...]


class Routes:
    """Keeps the routes of one mission's agents, and searches those that a picture has made stale."""

    def __init__(self, mission: Mission, clock_s: Callable[[], float] = time.monotonic) -> None:
        """Begin without routes; `clock_s` measures the work."""
        self._specs = {agent.id: agent for agent in mission.agents}
        self._altitudes_m = {one: mission.origin.alt_m + agent_height_m(mission, one) for one in self._specs}
        self._walls = NO_WALLS
        if mission.fence is not None or mission.exclusions:
            self._walls = Walls(mission.fence or (), mission.exclusions, CLEARANCE_M)
        self._clock_s = clock_s
        self._kept: dict[int, _Kept] = {}

    def update(self, picture: Picture) -> dict[str, list[tuple[float, float]]]:
        """Return the routes for a picture as points (north, east) in m, by agent id.

        Those that are stale are searched, the oldest first, for WORK_S; the others are those of before.
        """
        began_s, now_s = self._clock_s(), float(picture["t_s"])
        targets = {target["id"]: target for target in picture["targets"]}
        scene = tuple(_disc(threat) for threat in picture["threats"])
        flying = {
            agent["id"]: agent
            for agent in picture["agents"]
            if agent["id"] in self._specs and agent["target"] in targets and agent["state"] == "under way"
        }
        self._kept = {identity: kept for identity, kept in self._kept.items() if identity in flying}
        questions = {one: (_disc(targets[agent["target"]]), scene) for one, agent in flying.items()}
        for identity in sorted(flying, key=self._found_at_s):
            if self._clock_s() - began_s > WORK_S:
                break
            agent = flying[identity]
            if self._is_stale(agent, questions[identity], now_s):
                pieces = self._searched(agent, targets[agent["target"]], picture["threats"])
                self._kept[identity] = _Kept(questions[identity], now_s, pieces)
        return {
            str(identity): points_of(_ahead(kept.pieces, _place(flying[identity])))
            for identity, kept in self._kept.items()
            if kept.pieces
        }

    def _found_at_s(self, identity: int) -> float:
        kept = self._kept.get(identity)
        return -math.inf if kept is None else kept.found_at_s

    def _is_stale(self, agent: Picture, question: object, now_s: float) -> bool:
        kept = self._kept.get(agent["id"])
        if kept is None or kept.question != question or not 0.0 <= now_s - kept.found_at_s <= KEPT_S:
            return True
        return bool(kept.pieces) and abs(nearest(kept.pieces, _place(agent), math.inf)[1]) > OFF_ROUTE_M

    def _searched(self, agent: Picture, target: Picture, threats: Sequence[Picture]) -> tuple[Piece, ...]:
        spec, altitude_m = self._specs[agent["id"]], self._altitudes_m[agent["id"]]
        there = [threat for threat in threats if _reaches(threat, altitude_m)]
        heading_deg = agent["heading_deg"]
        return shortest_route(
            _place(agent),
            Goal(_place(target)),
            np.array([_place(threat) for threat in there]).reshape(-1, 2),
            np.array([threat["detection_radius_m"] + threat["growth_m"] + CLEARANCE_M for threat in there]),
            None if heading_deg is None else math.radians(heading_deg),
            turn_radius_m(spec),
            self._walls,
        ).pieces


def turn_radius_m(spec: AgentSpec) -> float:
    """Return the turn radius of an agent at its speed and greatest load factor."""
    return spec.speed_m_s / turn_rate_rad_s(spec.speed_m_s, spec.n_max)


def points_of(pieces: Sequence[Piece]) -> list[tuple[float, float]]:
    """Return points (north, east) in m along a route, rounded to 0.1 m: enough to draw its arcs by."""
    points: list[tuple[float, float]] = []
    for piece in pieces:
        turn_rad = abs(piece.curvature_1_m) * piece.length_m
        steps = max(1, min(MOST_POINTS, math.ceil(turn_rad / ARC_RAD)))
        points += [at((piece,), piece.length_m * step / steps)[:2] for step in range(steps)]
    if pieces:
        points.append(at(pieces[-1:], pieces[-1].length_m)[:2])
    return [(round(north_m, 1), round(east_m, 1)) for north_m, east_m in points[:MOST_POINTS]]


def _ahead(pieces: Sequence[Piece], place: tuple[float, float]) -> Sequence[Piece]:
    """Return what is left of a route for an agent at a place."""
    return left_of(pieces, nearest(pieces, place, math.inf)[0])


def _place(thing: Picture) -> tuple[float, float]:
    return float(thing["north_m"]), float(thing["east_m"])


def _disc(thing: Picture) -> tuple[object, ...]:
    """Return what a route depends on, on a grid: what changes by less than GRID_M is mostly the same."""
    sizes = (thing["north_m"], thing["east_m"], thing.get("detection_radius_m", 0.0) + thing.get("growth_m", 0.0))
    return (thing["id"], thing.get("floor_m"), thing.get("ceiling_m"), *(round(size / GRID_M) for size in sizes))


def _reaches(threat: Picture, altitude_m: float) -> bool:
    """Return whether a threat reaches an altitude above sea level."""
    floor_m, ceiling_m = threat["floor_m"], threat["ceiling_m"]
    return (floor_m is None or floor_m <= altitude_m) and (ceiling_m is None or altitude_m <= ceiling_m)
