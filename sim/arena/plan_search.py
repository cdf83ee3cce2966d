"""A search for a path over pieces of arcs and lines, with time as a part of the state."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from itertools import count

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from sim.arena.plan_task import Motion, Task, at_steps, slack_m, turn_and_line, way_length_m
from sim.shortest_path import (
    PathPiece,
    wall_distance_m,
)

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


@dataclass(frozen=True, slots=True)
class _Node:
    pose: tuple[float, float, float]
    step: int
    chasers_m: np.ndarray  # (C, 2) m
    parent: _Node | None
    piece: PathPiece | None


class Search:
    """Weighted A* over poses in time; pieces of equal length and five curvatures join the poses."""

    def __init__(self, task: Task, motion: Motion, weight: float, limit_m: float) -> None:
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
        self._clear_m2 = (task.radii_m + slack_m(task, motion)) ** 2
        self._walls_m = np.maximum(task.walls.clearance_m + slack_m(task, motion), 0.5 * step_m)
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
                    self._limit_m = way_length_m(best)
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
            pieces = turn_and_line(self._task, node.pose, side)
            if pieces is None or flown_m + way_length_m(pieces) >= self._limit_m:
                continue
            if found is not None and way_length_m(pieces) >= way_length_m(found):
                continue
            points_m = at_steps(self._task, node.pose, pieces, self._motion.step_s)
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

    def __init__(self, task: Task, motion: Motion, cell_m: float) -> None:
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
