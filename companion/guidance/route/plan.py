"""The planning of one route: which goal can be reached, around which obstacles, within the turn limit or without it."""

from __future__ import annotations

import math
from collections.abc import Generator
from typing import NamedTuple

import numpy as np

from companion.guidance.route.passing import tightened
from companion.guidance.route.reachability import Shores, batches, free_of, nearest_points
from companion.guidance.route.scene import Aim, Obstacles, Pose, Scene, State, covered_stretches, tolerance_m_of
from companion.guidance.route.search import Effort, Search, chain_free, chains
from companion.guidance.route.walls import WallSet

PATIENCE = 48
"""Number of states after which the search checks whether there is a way at all; that costs as much as 20 states."""
MAX_STATES = 3000
"""Number of states after which the search for a path gives up; 400 discs in a lattice take about 300."""
NEAREST_TRIES = 8
"""Number of points nearest to the goal that are tried."""
LEAST_CLEARANCE = 1000.0
"""Least clearance of walls in tolerances of the scene: a wall without any width has corners that leak."""

LEAST_SAVING = 0.01
"""Share of a way's length that one along arcs which touch small discs must save to be taken instead of it."""
TIGHT_TRIES = 5
"""Number of rough ways that are tried to be made flyable."""
TIGHTENING_US = 400.0
"""Work of making a rough way flyable, in nominal microseconds."""
TIGHT_STATES = 600
"""Number of states after which the search for a rough way gives up."""

DEEP_SHARE = 0.05
"""Depth inside a disc, as a share of its radius, from which a vehicle heads straight out of it, and below it partly."""
DEEP_CLEARANCE = 0.5
"""The same for a wall, as a share of its clearance."""
MOST_CHAINS = 4
"""Number of ways along the circles of an earlier one that are tried, the shortest first."""
REJOIN_AT = (0, 1, 3)
"""Circles of an earlier way that a way back to it is sought to, by their order on it."""
REJOIN_STATES = 40
"""Number of states after which the search for a way back gives up."""


class Way(NamedTuple):
    """A way that a plan has found."""

    to_target: bool
    """Whether it leads to the goal, and not to the safe point nearest to it."""
    scene: Scene
    chain: list[State]
    """From the start to the goal; empty where the start is there."""

    @property
    def length_m(self) -> float:
        """Length of the way."""
        return self.chain[-1].length_m if self.chain else 0.0

    @property
    def via(self) -> tuple[tuple[int, int], ...]:
        """The circles of obstacles on the way: index and side."""
        goal_node = self.scene.circles.goal_node
        return tuple((state.circle, state.side) for state in self.chain[:-1] if state.circle < goal_node)

    @property
    def touch(self) -> dict[int, complex]:
        """The discs smaller than a turn that its arcs touch, and in which directions from their centres."""
        return self.scene.circles.touch

    @property
    def end_side(self) -> int:
        """The side on which the way ends on the goal's circle; 0 where the goal is a place."""
        circle = self.scene.circles.radius_m[self.scene.circles.goal_node] > 0.0
        return self.chain[-1].side if circle and self.chain else 0


class Plan:
    """The planning of one route: from a pose to a goal around discs and walls."""

    def __init__(
        self,
        pose: Pose,
        goal: Aim,
        centres: np.ndarray,  # (M,) complex, m
        radii_m: np.ndarray,  # (M,) m
        walls: WallSet | None,
    ) -> None:
        self.pose, self.goal = pose, goal
        self.walls = walls
        self.everything = Obstacles(centres, radii_m)
        """The discs and all walls, of which a place is safe outside."""
        self.obstacles = self.everything
        """What may not be entered on the way: those without the polygons on whose wrong side the start is."""
        self.tolerance_m = tolerance_m_of(np.abs(centres - pose.place), radii_m, goal.place - pose.place)
        self.discs = len(radii_m)
        """Number of obstacles that are discs, and no corners of walls."""
        self.wrong_side: list[int] = []
        """The polygons on whose wrong side the start is; the way leads across their edges."""
        if walls is not None and len(walls.corner):
            self._add(walls)

    def _add(self, walls: WallSet) -> None:
        discs, place = self.everything, self.pose.place
        corner_m = np.abs(walls.corner - place)
        centre = np.concatenate((discs.centre, walls.corner))
        clearance_m = walls.given.clearance_m
        radius_m = np.concatenate((discs.radius_m, np.full(len(corner_m), clearance_m)))
        self.tolerance_m = tolerance_m_of(np.abs(centre - place), radius_m, self.goal.place - place)
        self.wrong_side = walls.forbidding(place, self.tolerance_m)
        clearance_m = max(clearance_m, LEAST_CLEARANCE * self.tolerance_m)
        left_out = np.isin(walls.corner_of, self.wrong_side)
        radius_m[self.discs :] = clearance_m
        self.obstacles = self.everything = Obstacles(centre, radius_m, walls.bands(clearance_m, self.discs, []))
        if self.wrong_side:
            radius_m = radius_m.copy()
            radius_m[self.discs :] = np.where(left_out, 0.0, clearance_m)
            self.obstacles = Obstacles(centre, radius_m, walls.bands(clearance_m, self.discs, self.wrong_side))

    def way(self, effort: Effort) -> Generator[None, None, Way | None]:
        """Return the way to the goal, or else to the reachable point nearest to it; None if there is neither.

        It pauses whenever no effort is left.
        """
        tried = self._tried()
        beside = self._beside(effort) if len(tried) > 1 else None
        shores = None
        if beside is not None:
            effort.left_us -= _shores_us(self.everything)
            shores = Shores(self.everything, self.tolerance_m)
        points = self._safe_points()
        if len(points) and (beside is None or shores is None or shores.joined(beside, points).any()):
            for obstacles in tried:
                way = yield from self._to(self.goal, True, obstacles, effort)
                if way is not None:
                    return way
        for obstacles in tried:
            if shores is None or beside is None:
                effort.left_us -= _shores_us(obstacles)
                nearest = yield from self._nearest(self._shores_of(obstacles), self.pose.place, effort)
            else:
                nearest = yield from self._nearest(shores, beside, effort)
            for point in nearest:
                way = yield from self._to(Aim(point), False, obstacles, effort)
                if way is not None:
                    return way
        return None

    def along(
        self, way: Way, via: tuple[tuple[int, int], ...], touch: dict[int, complex], legs: int | None = None
    ) -> Way | None:
        """Return the way from this plan's pose along circles, (index, side) in order; None if it is not free.

        `touch` are those that its arcs touch, and where. Like the earlier `way` it leads to the plan's goal or to the
        same point, and keeps the turn limit or not. If only the vehicle has moved since that way was checked, it is
        enough to check the first few `legs`.
        """
        scene = self._scene_like(way).touching(touch)
        if way.to_target and not len(self._safe_points()):
            return None
        if scene.is_there:
            return Way(way.to_target, scene, [])
        if not way.chain:
            return None
        for chain in chains(scene, via, way.chain[-1].side)[:MOST_CHAINS]:
            if chain_free(scene, chain if legs is None else chain[: legs + 1]):
                return Way(way.to_target, scene, chain)
        return None

    def rejoining(
        self, way: Way, via: tuple[tuple[int, int], ...], touch: dict[int, complex], effort: Effort
    ) -> Way | None:
        """Return the shortest free way from this plan's pose to one of the next circles and on along the others.

        It is what `along` finds if another obstacle is between the vehicle and its way. None if there is none nearby.
        """
        scene = self._scene_like(way).touching(touch)
        circles, best = scene.circles, None
        for index in REJOIN_AT:
            if index >= len(via):
                break
            circle, side = via[index]
            place = complex(circles.north_m[circle], circles.east_m[circle]) + self.pose.place
            search = Search(Scene(scene.pose, Aim(place, circles.radius_m[circle], side), self.obstacles))
            try:
                next(search.run(REJOIN_STATES, effort))
            except StopIteration as stop:
                if stop.value is None:
                    continue
                head = Way(True, search.scene, search.chain(stop.value))
                found = self.along(way, (*head.via, *via[index:]), touch)
                if found is not None and (best is None or found.length_m < best.length_m):
                    best = found
            else:
                break
        return best

    def _scene_like(self, way: Way) -> Scene:
        """Return the scene of an earlier way, with the start and the obstacles of this plan."""
        before = way.scene
        goal = self.goal if way.to_target else Aim(before.goal + before.pose.place)
        pose = self.pose if before.pose.limited else self.pose._replace(turn_radius_m=0.0)
        return Scene(pose, goal, self.obstacles)

    def way_out(self) -> tuple[float, complex] | None:
        """Return the way out of what the start is deepest inside: how deep, and in which direction; None if it is free.

        A depth of 1 or more is deep: that share of a disc's radius, or of a wall's clearance. The direction is 0 where
        there is none.
        """
        obstacles, place, bands = self.obstacles, self.pose.place, self.obstacles.bands
        found = None
        depth_m = obstacles.radius_m - np.abs(obstacles.centre - place)
        if len(depth_m):
            share = np.full(len(depth_m), DEEP_SHARE)
            share[self.discs :] = DEEP_CLEARANCE
            depth_m = np.where(depth_m > self.tolerance_m, depth_m, 0.0)
            disc = int(depth_m.argmax())
            if depth_m[disc] > 0.0:
                found = float(depth_m[disc] / (share[disc] * obstacles.radius_m[disc])), place - obstacles.centre[disc]
        if len(bands.half_m) or self.wrong_side:
            beside = self._way_from_wall()
            if beside is not None and (found is None or beside[0] > found[0]):
                found = beside
        return found

    def _way_from_wall(self) -> tuple[float, complex] | None:
        """Return how deep the start is within the nearest wall's clearance and the direction out, as `way_out` does."""
        walls, place = self.walls, self.pose.place
        if walls is None:
            return None
        if self.wrong_side:
            edges = walls.bands(0.0, 0, [index for index in range(walls.count) if index not in self.wrong_side])
            nearest = edges.nearest(place)
            return 2.0, complex(nearest[np.abs(nearest - place).argmin()]) - place
        bands = self.obstacles.bands
        nearest = bands.nearest(place)
        apart_m = np.abs(nearest - place)
        band = int(apart_m.argmin())
        deep_m = float(bands.half_m[band] - apart_m[band])
        if deep_m <= self.tolerance_m:
            return None
        direction = place - complex(nearest[band])
        if abs(direction) <= self.tolerance_m:
            direction = 1j * complex(bands.ahead[band])
            if not walls.allowed(np.array([place + 2.0 * self.tolerance_m * direction]))[0]:
                direction = -direction
        return deep_m / (DEEP_CLEARANCE * float(bands.half_m[band])), direction

    def _tried(self) -> list[Obstacles]:
        """Return the obstacles; then, if the start is inside some, those without them.

        Obstacles about the start may enclose it even when shrunk; then they are left out, so that it can leave.
        """
        obstacles, place = self.obstacles, self.pose.place
        holding = np.abs(obstacles.centre - place) < obstacles.radius_m - self.tolerance_m
        bands = obstacles.bands
        beside = bands.distance_m(place) < bands.half_m - self.tolerance_m
        if not (np.count_nonzero(holding) or np.count_nonzero(beside)):
            return [obstacles]
        bands = bands._replace(half_m=np.where(beside, 0.0, bands.half_m))
        return [obstacles, Obstacles(obstacles.centre, np.where(holding, 0.0, obstacles.radius_m), bands)]

    def _beside(self, effort: Effort) -> complex | None:
        """Return the safe point nearest to a start that is inside an obstacle; None if it is deep inside or lost.

        From a little inside, that point says where one can go: shrunk obstacles may leave a gap between them.
        """
        found = self.way_out()
        if self.wrong_side or (found is not None and found[0] > 1.0):
            return None
        effort.left_us -= _shores_us(self.everything)
        for points in batches(nearest_points(self.pose.place, self.everything)):
            effort.left_us -= 0.1 * len(points) * len(self.everything.centre)
            safe = points[self._are_safe(points)]
            if len(safe):
                return complex(safe[0])
        return None

    def _shores_of(self, obstacles: Obstacles) -> Shores:
        """Return the shores of obstacles that are shrunk to pass at the start."""
        place, bands = self.pose.place, obstacles.bands
        bands = bands._replace(half_m=np.minimum(bands.half_m, bands.distance_m(place)))
        radius_m = np.minimum(obstacles.radius_m, np.abs(obstacles.centre - place))
        return Shores(Obstacles(obstacles.centre, radius_m, bands), self.tolerance_m)

    def _safe_points(self) -> np.ndarray:  # (P,) complex
        """Return the goal's place, or one point of each free stretch of its circle, where that is safe."""
        points = self._points(self.goal)
        safe: np.ndarray = points[self._are_safe(points)]
        return safe

    def _are_safe(self, points: np.ndarray) -> np.ndarray:  # (P,) complex -> (P,) bool
        safe = free_of(points, self.everything, self.tolerance_m)
        if self.walls is not None:
            safe &= self.walls.allowed(points)
        return safe

    def _points(self, goal: Aim) -> np.ndarray:  # (P,) complex
        """Return the goal's place, or one point of each free stretch of its circle."""
        if not goal.radius_m:
            return np.array([goal.place])
        centre, radius_m, bands = self.everything
        covered = covered_stretches(goal.place, goal.radius_m, centre, radius_m - self.tolerance_m, None)
        covered += list(bands.stretches(goal.place, goal.radius_m, self.tolerance_m))
        ends_rad = sorted(
            (middle_rad + sign * half_rad) % math.tau for middle_rad, half_rad, _ in covered for sign in (1.0, -1.0)
        ) or [0.0]
        ends_rad.append(ends_rad[0] + math.tau)
        middles_rad = 0.5 * (np.array(ends_rad[1:]) + np.array(ends_rad[:-1]))
        points: np.ndarray = goal.place + goal.radius_m * np.exp(1j * middles_rad)
        return points

    def _nearest(self, shores: Shores, place: complex, effort: Effort) -> Generator[None, None, list[complex]]:
        """Return the safe points nearest to the goal that are in the same water as a place, nearest first."""
        effort.left_us -= _shores_us(self.everything)
        found: list[complex] = []
        for points in batches(nearest_points(self.goal.place, self.everything)):
            if effort.left_us <= 0.0:
                yield
            effort.left_us -= 0.1 * len(points) * len(self.everything.centre)
            points = points[self._are_safe(points)]
            if len(points):
                effort.left_us -= 0.02 * len(points) * shores.overlaps
                found += points[shores.joined(place, points)].tolist()
            if len(found) >= NEAREST_TRIES:
                break
        return found[:NEAREST_TRIES]

    def _to(
        self, goal: Aim, to_target: bool, obstacles: Obstacles, effort: Effort
    ) -> Generator[None, None, Way | None]:
        """Return the shortest way within the turn limit, or else the shortest without it; None if there is no way."""
        poses = [self.pose, self.pose._replace(turn_radius_m=0.0)] if self.pose.limited else [self.pose]
        asked = not to_target
        for pose in poses:
            scene = Scene(pose, goal, obstacles)
            if scene.is_there:
                return Way(to_target, scene, [])
            search = Search(scene)
            found = yield from search.run(PATIENCE, effort)
            if found is None and not asked:
                effort.left_us -= _shores_us(obstacles)
                if not self._is_joined(scene):
                    return None
                asked = True
            if found is None:
                found = yield from search.run(MAX_STATES, effort)
            way = None if found is None else Way(to_target, scene, search.chain(found))
            tighter = self._tighter(search, way, goal, obstacles, effort)
            if tighter is not None:
                return tighter._replace(to_target=to_target)
            if way is not None:
                return way
        return None

    def _tighter(self, search: Search, way: Way | None, goal: Aim, obstacles: Obstacles, effort: Effort) -> Way | None:
        """Return a way with arcs that touch discs smaller than a turn, if that saves enough of the way around those.

        A rough way, with arcs of the discs' own radii, is never longer. It is made flyable; the discs at which that
        fails are gone around with wide arcs, and another rough way is sought. Nothing waits for it: it is given up when
        no effort is left.
        """
        scene = search.scene
        arc_m = np.array(scene.circles.radius_m[: scene.circles.goal_node])
        small = arc_m > scene.collide_m
        if not scene.pose.limited or not any(small[disc] for disc in search.discs):
            return None
        below_m = math.inf if way is None else (1.0 - LEAST_SAVING) * way.length_m
        for _ in range(TIGHT_TRIES):
            rough = Search(Scene(scene.pose, goal, obstacles, small))
            found = _at_once(rough.run(TIGHT_STATES, effort, below_m))
            if found is None:
                return None
            effort.left_us -= TIGHTENING_US
            chain = rough.chain(found)
            tight = {state.circle for state in chain[:-1] if state.circle < len(small) and small[state.circle]}
            made = tightened(rough.scene, chain, scene, tight)
            if made.chain and made.chain[-1].length_m < below_m:
                return Way(True, made.scene, made.chain)
            blamed = list(made.blamed or tight)
            if not blamed:
                return None
            small[blamed] = False
        return None

    def _is_joined(self, scene: Scene) -> bool:
        """Return whether there is a way to the goal at all, without the turn limit."""
        shores = Shores(Obstacles(scene.centre, scene.collide_m, scene.bands), scene.tolerance_m)
        return bool(shores.joined(0j, self._safe_points() - scene.pose.place).any())


def _at_once(work: Generator[None, None, int | None]) -> int | None:
    """Return what a search finds before it pauses, None if that is nothing."""
    try:
        next(work)
    except StopIteration as stop:
        found: int | None = stop.value
        return found
    return None


def _shores_us(obstacles: Obstacles) -> float:
    """Return how much work it is to find what overlaps, in us."""
    count = len(obstacles.centre) + len(obstacles.bands.half_m)
    return 150.0 + 2.0 * count + 0.03 * count * count
