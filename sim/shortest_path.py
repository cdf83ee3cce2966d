"""Shortest paths around discs and walls, with which the paths that were flown are compared.

A shortest path around discs consists of straight segments that touch discs and of arcs along discs. So a search over
the free tangent segments, joined by the free arcs between them, is exact. Start and goal are discs of radius zero, so
that their tangents need no special case. A wall is kept away from by a clearance: it counts as a disc of that radius
about each of its ends, and nothing comes nearer to what lies between them.

A vehicle with a least turn radius leaves along one of its two turning circles, so its path starts on these circles
instead, and passes every disc at the turn radius or more (docs/method.md section 3, routed attraction).

Tangents are computed circle by circle as the search comes to them (A*, with the straight line as the estimate), so
that hundreds of discs cost little where only a few of them are in the way.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np

TOLERANCE = 1e-9
"""Depth, as a share of the scene's size, to which a segment may enter a disc that it touches, for rounding."""
_FIRST_DISC = 2
"""Index of the first circle about a disc; those before it are the start's turning circles."""


@dataclass(frozen=True)
class PathPiece:
    """A piece of a path with constant curvature; its turn is positive to the right, and 0 on a straight line."""

    length_m: float
    turn_rad: float


@dataclass(frozen=True)
class Departure:
    """The start of a vehicle with a least turn radius."""

    start_m: np.ndarray  # (2,) m
    heading_rad: float
    """Heading, clockwise from the first axis (north)."""
    turn_radius_m: float


@dataclass(frozen=True)
class Walls:
    """Straight walls of a fence or of polygons to keep out of; an end at which two of them meet is an end of both."""

    begin_m: np.ndarray  # (W, 2) m
    end_m: np.ndarray  # (W, 2) m
    clearance_m: np.ndarray  # (W,) m

    def relative_to(self, origin_m: np.ndarray) -> Walls:  # (2,) m
        """Return the same walls in coordinates about another origin."""
        return Walls(self.begin_m - origin_m, self.end_m - origin_m, self.clearance_m)


NO_WALLS = Walls(np.empty((0, 2)), np.empty((0, 2)), np.empty(0))


@dataclass(frozen=True)
class _Obstacles:
    """Discs and walls that no path may enter by more than `tolerance_m`."""

    centre_m: np.ndarray  # (M, 2) m, discs and ends of walls
    radius_m: np.ndarray  # (M,) m
    walls: Walls
    tolerance_m: float


@dataclass(frozen=True)
class _Circles:
    """Circles with a direction of travel, one row each; the first two are the start's turning circles: right, left."""

    centre_m: np.ndarray  # (C, 2) m
    radius_m: np.ndarray  # (C,) m
    side: np.ndarray  # (C,) 1 where they are travelled turning right, -1 left


@dataclass(frozen=True)
class _Leaving:
    """The free tangents that leave one circle."""

    onward_rad: np.ndarray  # (T,) where they leave it, in the direction of travel, in [0, tau)
    end: np.ndarray  # (T,) index of the circle that they lead to; -1: the goal
    arrival_rad: np.ndarray  # (T,) where they reach it, in its direction of travel
    length_m: np.ndarray  # (T,) m
    estimate_m: np.ndarray  # (T,) m, straight from their end to the goal


@dataclass(frozen=True)
class _Step:
    """An arc along a circle and the tangent that follows it, and the step that leads to them."""

    before: _Step | None
    circle: int
    arrival_rad: float
    """Where the tangent ends on `circle`, in its direction of travel."""
    pieces: tuple[PathPiece, ...]


def shortest_path_length(
    start_m: np.ndarray, goal_m: np.ndarray, centres_m: np.ndarray, radii_m: np.ndarray, walls: Walls = NO_WALLS
) -> float:
    """Return the length in metres of the shortest path from start (2,) to goal (2,) that enters none of M discs.

    Centres (M, 2) and radii (M,) are in metres; discs may overlap, and a path may run along their edges. The length is
    infinite if there is no path, because start or goal is inside a disc or discs enclose one of them.
    """
    start_m, goal_m = np.asarray(start_m, dtype=float), np.asarray(goal_m, dtype=float)
    obstacles = _obstacles(start_m, goal_m, centres_m, radii_m, walls, 0.0)
    ends_m = np.stack((np.zeros(2), goal_m - start_m))
    apart_m = np.linalg.norm(ends_m[:, None] - obstacles.centre_m, axis=-1)
    if (apart_m < obstacles.radius_m - obstacles.tolerance_m).any():
        return math.inf
    direct_m = float(np.linalg.norm(goal_m - start_m))
    if _free(ends_m[None], obstacles)[0]:
        return direct_m
    pieces = _Search(_circles(0.0, 0.0, ends_m[1], obstacles), ends_m[1], 0.0, obstacles).run(0.0)
    return math.inf if pieces is None else max(math.fsum(piece.length_m for piece in pieces), direct_m)


def turning_path(
    departure: Departure,
    goal_m: np.ndarray,  # (2,) m
    goal_radius_m: float,
    centres_m: np.ndarray,  # (M, 2) m
    radii_m: np.ndarray,  # (M,) m
    walls: Walls = NO_WALLS,
) -> list[PathPiece] | None:
    """Return a short path to within `goal_radius_m` of a goal that respects the vehicle's turn radius.

    The path enters none of the M discs. It is the shortest of the paths of one kind: they leave along a turning circle,
    then follow straight lines and circles about discs and corners, each with the greater of its own radius and the turn
    radius, and end on a straight line towards the goal. None if there is no such path. A path of another kind may then
    exist, and may be shorter where discs are smaller than the turn radius.
    """
    heading_rad, turn_radius_m = departure.heading_rad, departure.turn_radius_m
    start_m, goal_m = np.asarray(departure.start_m, dtype=float), np.asarray(goal_m, dtype=float)
    if np.linalg.norm(goal_m - start_m) <= goal_radius_m:
        return []
    obstacles = _obstacles(start_m, goal_m, centres_m, radii_m, walls, turn_radius_m)
    circles = _circles(heading_rad, turn_radius_m, goal_m - start_m, obstacles)
    return _Search(circles, goal_m - start_m, goal_radius_m, obstacles).run(heading_rad)


def walls_of(polygons_m: list[np.ndarray], clearance_m: np.ndarray | float) -> Walls:
    """Return the edges of polygons, (V, 2) m each, as walls with one clearance for all of them or one for each edge."""
    if not polygons_m:
        return NO_WALLS
    begin_m = np.vstack(polygons_m)
    end_m = np.vstack([np.roll(polygon_m, -1, axis=0) for polygon_m in polygons_m])
    return Walls(begin_m, end_m, np.broadcast_to(np.asarray(clearance_m, dtype=float), len(begin_m)))


def wall_distance_m(points_m: np.ndarray, walls: Walls) -> np.ndarray:  # (P, 2) m -> (P, W) m
    """Return the distance of each point from each wall."""
    along_m = walls.end_m - walls.begin_m
    squared = np.maximum((along_m**2).sum(axis=-1), np.finfo(float).tiny)
    to_point_m = points_m[:, None] - walls.begin_m
    share = np.clip((to_point_m * along_m).sum(axis=-1) / squared, 0.0, 1.0)
    distance_m: np.ndarray = np.linalg.norm(to_point_m - share[..., None] * along_m, axis=-1)
    return distance_m


def _obstacles(
    start_m: np.ndarray,
    goal_m: np.ndarray,
    centres_m: np.ndarray,
    radii_m: np.ndarray,
    walls: Walls,
    turn_radius_m: float,
) -> _Obstacles:
    """Return discs and walls relative to the start, so that large coordinates lose no precision."""
    centres_m = np.asarray(centres_m, dtype=float).reshape(-1, 2)
    radii_m = np.asarray(radii_m, dtype=float)
    far_m = np.abs(np.vstack((goal_m, centres_m, walls.begin_m)) - start_m).max(initial=0.0)
    size_m = float(far_m + radii_m.max(initial=0.0))
    kept = _not_inside_another(centres_m, radii_m)
    corners_m, corner_radii_m = _corners(walls)
    return _Obstacles(
        np.vstack((centres_m[kept], corners_m)) - start_m,
        np.concatenate((radii_m[kept], corner_radii_m)),
        walls.relative_to(start_m),
        TOLERANCE * (size_m + turn_radius_m),
    )


def _corners(walls: Walls) -> tuple[np.ndarray, np.ndarray]:  # (E, 2) m, (E,) m
    """Return every end of a wall once, with the clearance that all walls there keep."""
    ends_m = np.vstack((walls.begin_m, walls.end_m))
    if not len(ends_m):
        return ends_m, np.empty(0)
    corners_m, which = np.unique(ends_m, axis=0, return_inverse=True)
    clearance_m = np.full(len(corners_m), math.inf)
    np.minimum.at(clearance_m, which.ravel(), np.tile(walls.clearance_m, 2))
    return corners_m, clearance_m


def _not_inside_another(centres_m: np.ndarray, radii_m: np.ndarray) -> np.ndarray:
    """Return (M,) bool, whether a disc has a radius and no other covers it; of equal discs the first is kept."""
    count = len(radii_m)
    gap_m = np.linalg.norm(centres_m[:, None] - centres_m, axis=-1)
    covers = gap_m + radii_m[None, :] <= radii_m[:, None]  # (M, M) row covers column
    np.fill_diagonal(covers, False)
    order = np.arange(count)
    covers &= ~(covers.T & (order[:, None] > order[None, :]))
    kept: np.ndarray = ~covers.any(axis=0) & (radii_m > 0)
    return kept


def _free(segments_m: np.ndarray, obstacles: _Obstacles) -> np.ndarray:
    """Return (T,) bool, whether each of the segments (T, 2, 2) enters no disc by more than the tolerance, nor a wall.

    For walls this is asked of what lies between their ends; about their ends there are discs.
    """
    begin_m, along_m = segments_m[:, 0], segments_m[:, 1] - segments_m[:, 0]
    length_m = np.linalg.norm(along_m, axis=-1)
    unit = np.where(length_m[:, None] > 0.0, along_m, (1.0, 0.0)) / np.where(length_m > 0.0, length_m, 1.0)[:, None]
    # Where the centre is along the segment, and how far aside.
    ahead_m = unit @ obstacles.centre_m.T - (unit * begin_m).sum(axis=-1)[:, None]  # (T, M)
    aside_m = np.column_stack((-unit[:, 1], unit[:, 0]))
    aside_m = aside_m @ obstacles.centre_m.T - (aside_m * begin_m).sum(axis=-1)[:, None]
    ahead_m -= np.clip(ahead_m, 0.0, length_m[:, None])
    allowed_m = np.maximum(obstacles.radius_m - obstacles.tolerance_m, 0.0)
    free: np.ndarray = (ahead_m**2 + aside_m**2 >= allowed_m**2).all(axis=-1)
    walls = obstacles.walls
    if len(walls.begin_m) and free.any():
        kept = np.flatnonzero(free)
        near = wall_distance_m(segments_m[kept].reshape(-1, 2), walls) < walls.clearance_m - obstacles.tolerance_m
        near_either = near.reshape(len(kept), 2, -1).any(axis=1)
        free[kept] = ~(near_either | _cross(segments_m[kept], walls)).any(axis=-1)
    return free


def _cross(segments_m: np.ndarray, walls: Walls) -> np.ndarray:  # (T, 2, 2) m -> (T, W) bool
    """Return which segments cross which walls."""
    begin_m, along_m = segments_m[:, None, 0], (segments_m[:, 1] - segments_m[:, 0])[:, None]
    wall_m = walls.end_m - walls.begin_m

    def side(vector: np.ndarray, to_point_m: np.ndarray) -> np.ndarray:
        product: np.ndarray = vector[..., 0] * to_point_m[..., 1] - vector[..., 1] * to_point_m[..., 0]
        return product

    parted = side(along_m, walls.begin_m - begin_m) * side(along_m, walls.end_m - begin_m) < 0.0
    parts = side(wall_m, begin_m - walls.begin_m) * side(wall_m, begin_m + along_m - walls.begin_m) < 0.0
    crosses: np.ndarray = parted & parts
    return crosses


def _circles(heading_rad: float, turn_radius_m: float, goal_m: np.ndarray, obstacles: _Obstacles) -> _Circles:
    """Return the two turning circles of a start at (0, 0), then every disc's circle in both directions.

    A disc smaller than the turn radius has a circle of that radius, unless the circle would contain start or goal.
    """
    centres_m, radii_m = obstacles.centre_m, obstacles.radius_m
    to_right = np.array([-math.sin(heading_rad), math.cos(heading_rad)])
    routed_m = np.maximum(radii_m, turn_radius_m)
    nearest_m = np.minimum(np.linalg.norm(centres_m, axis=-1), np.linalg.norm(centres_m - goal_m, axis=-1))
    usable = ((routed_m <= nearest_m) | (radii_m >= turn_radius_m)) & (routed_m > 0.0)
    number = int(usable.sum())
    return _Circles(
        np.vstack((turn_radius_m * np.outer((1.0, -1.0), to_right), np.repeat(centres_m[usable], 2, axis=0))),
        np.concatenate(((turn_radius_m, turn_radius_m), np.repeat(routed_m[usable], 2))),
        np.tile((1.0, -1.0), number + 1),
    )


class _Search:
    """A* over tangents, from the start's turning circles at (0, 0) to a goal."""

    def __init__(self, circles: _Circles, goal_m: np.ndarray, goal_radius_m: float, obstacles: _Obstacles) -> None:
        self._circles, self._goal_m, self._goal_radius_m = circles, goal_m, goal_radius_m
        self._obstacles = obstacles
        self._leaving: dict[int, _Leaving] = {}
        self._blocked: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def run(self, heading_rad: float) -> list[PathPiece] | None:
        """Return the shortest path for a start that heads there; None if there is none."""
        side = self._circles.side
        queue: list[tuple[float, int, float, _Step]] = []
        for circle in range(_FIRST_DISC):
            # Away from a turning circle's centre, a quarter turn behind the heading.
            away_rad = float(side[circle] * heading_rad - math.pi / 2) % math.tau
            queue.append((0.0, circle, 0.0, _Step(None, circle, away_rad, ())))
        heapq.heapify(queue)
        best_m: dict[tuple[int, int], float] = {}
        count = len(queue)
        while queue:
            _, _, flown_m, step = heapq.heappop(queue)
            if step.circle < 0:
                return _pieces_to(step)
            leaving, sweep_rad = self._reachable(step)
            there_m = flown_m + self._circles.radius_m[step.circle] * sweep_rad + leaving.length_m
            for index in np.flatnonzero(np.isfinite(there_m)):
                end, total_m = int(leaving.end[index]), float(there_m[index])
                if total_m >= best_m.get((step.circle, end), math.inf):
                    continue
                best_m[step.circle, end] = total_m
                pieces = self._pieces(step.circle, float(sweep_rad[index]), float(leaving.length_m[index]))
                after = _Step(step, end, float(leaving.arrival_rad[index]), pieces)
                heapq.heappush(queue, (total_m + float(leaving.estimate_m[index]), count, total_m, after))
                count += 1
        return None

    def _pieces(self, circle: int, sweep_rad: float, length_m: float) -> tuple[PathPiece, ...]:
        arc_m = float(self._circles.radius_m[circle]) * sweep_rad
        arc = PathPiece(arc_m, float(self._circles.side[circle]) * sweep_rad)
        return tuple(piece for piece in (arc, PathPiece(length_m, 0.0)) if piece.length_m > 0.0)

    def _reachable(self, step: _Step) -> tuple[_Leaving, np.ndarray]:  # (T,) rad
        """Return the tangents that leave the circle on which a step ends, and the arc to each; infinite: blocked."""
        circle = step.circle
        if circle not in self._leaving:
            self._leaving[circle] = self._leaving_from(circle)
            self._blocked[circle] = self._blocked_on(circle)
        leaving, (begin_rad, width_rad) = self._leaving[circle], self._blocked[circle]
        slack_rad = 2 * self._obstacles.tolerance_m / max(float(self._circles.radius_m[circle]), 1e-300)
        sweep_rad = (leaving.onward_rad - step.arrival_rad) % math.tau
        # A tangent that leaves where the step ends, but for rounding.
        sweep_rad = np.where(math.tau - sweep_rad < 1e-9, 0.0, sweep_rad)
        if not len(begin_rad):
            return leaving, sweep_rad
        past_rad = (step.arrival_rad - begin_rad) % math.tau
        if ((past_rad > slack_rad) & (past_rad < width_rad - slack_rad)).any():
            return leaving, np.full(len(sweep_rad), math.inf)
        # A blocked arc that begins here, but for rounding, is ahead by nothing.
        room_rad = float(np.where(past_rad <= np.minimum(slack_rad, width_rad), 0.0, math.tau - past_rad).min())
        return leaving, np.where(sweep_rad <= room_rad + slack_rad, sweep_rad, math.inf)

    def _leaving_from(self, circle: int) -> _Leaving:
        """Return the free tangents from a circle to all others and to the goal."""
        circles = self._circles
        side, radius_m = float(circles.side[circle]), float(circles.radius_m[circle])
        ends = np.append(np.arange(_FIRST_DISC, len(circles.side)), -1)
        # Signed radii: a circle that is travelled turning right is to the right of its tangents.
        end_side = np.append(circles.side[_FIRST_DISC:], 0.0)
        end_signed_m = np.append((circles.side * circles.radius_m)[_FIRST_DISC:], 0.0)
        offset_m = np.vstack((circles.centre_m[_FIRST_DISC:], self._goal_m)) - circles.centre_m[circle]
        gap_m = np.linalg.norm(offset_m, axis=-1)
        difference_m = side * radius_m - end_signed_m
        # Circles that touch have a tangent of no length.
        apart = (gap_m >= np.abs(difference_m) - self._obstacles.tolerance_m) & (gap_m > self._obstacles.tolerance_m)
        ends, end_side, offset_m, gap_m, difference_m = (
            column[apart] for column in (ends, end_side, offset_m, gap_m, difference_m)
        )
        course_rad = np.arctan2(offset_m[:, 1], offset_m[:, 0]) + np.arcsin(np.clip(difference_m / gap_m, -1.0, 1.0))
        length_m = np.sqrt(np.maximum(gap_m**2 - difference_m**2, 0.0))
        length_m = np.where(ends < 0, np.maximum(length_m - self._goal_radius_m, 0.0), length_m)
        along = np.column_stack((np.cos(course_rad), np.sin(course_rad)))
        begin_m = circles.centre_m[circle] + side * radius_m * np.column_stack((along[:, 1], -along[:, 0]))
        end_m = begin_m + length_m[:, None] * along
        free = _free(np.stack((begin_m, end_m), axis=1), self._obstacles)
        estimate_m = np.maximum(np.linalg.norm(end_m - self._goal_m, axis=-1) - self._goal_radius_m, 0.0)
        return _Leaving(
            ((side * course_rad - math.pi / 2) % math.tau)[free],
            ends[free],
            ((end_side * course_rad - math.pi / 2) % math.tau)[free],
            length_m[free],
            np.where(ends < 0, 0.0, estimate_m)[free],
        )

    def _blocked_on(self, circle: int) -> tuple[np.ndarray, np.ndarray]:  # (B,) rad, (B,) rad
        """Return the arcs of a circle that discs and walls cover: where they begin, in travel direction, and widths."""
        obstacles, side = self._obstacles, float(self._circles.side[circle])
        centre_m, radius_m = self._circles.centre_m[circle], float(self._circles.radius_m[circle])
        if radius_m == 0.0:
            return np.empty(0), np.empty(0)
        offset_m = obstacles.centre_m - centre_m
        gap_m = np.linalg.norm(offset_m, axis=-1)
        touching = gap_m < radius_m + obstacles.radius_m
        touching &= gap_m + obstacles.radius_m > radius_m + obstacles.tolerance_m
        gap_m, other_m, offset_m = gap_m[touching], obstacles.radius_m[touching], offset_m[touching]
        ratio = (radius_m**2 + gap_m**2 - other_m**2) / np.maximum(2 * radius_m * gap_m, np.finfo(float).tiny)
        half_rad = np.arccos(np.clip(ratio, -1.0, 1.0))
        middle_rad = side * np.arctan2(offset_m[:, 1], offset_m[:, 0])
        begin_rad, width_rad = middle_rad - half_rad, 2 * half_rad
        if len(obstacles.walls.begin_m):
            from_rad, wide_rad = _covered_by_walls(centre_m, radius_m, obstacles)
            from_rad = from_rad if side > 0.0 else -(from_rad + wide_rad)
            begin_rad, width_rad = np.concatenate((begin_rad, from_rad)), np.concatenate((width_rad, wide_rad))
        return begin_rad % math.tau, width_rad


def _covered_by_walls(
    centre_m: np.ndarray, radius_m: float, obstacles: _Obstacles
) -> tuple[np.ndarray, np.ndarray]:  # (B,) rad, (B,) rad
    """Return the arcs of a circle that lie beside a wall within its clearance: where they begin, and their widths."""
    walls = obstacles.walls
    along_m = walls.end_m - walls.begin_m
    length_m = np.linalg.norm(along_m, axis=-1)
    unit = along_m / np.maximum(length_m, np.finfo(float).tiny)[:, None]
    to_centre_m = centre_m - walls.begin_m
    ahead_m = (to_centre_m * unit).sum(axis=-1)
    aside_m = unit[:, 0] * to_centre_m[:, 1] - unit[:, 1] * to_centre_m[:, 0]
    clearance_m = np.maximum(walls.clearance_m - obstacles.tolerance_m, obstacles.tolerance_m)
    course_rad = np.arctan2(unit[:, 1], unit[:, 0])
    # The circle crosses the four edges of the wall's rectangle at these angles from the wall's course; NaN: nowhere.
    with np.errstate(invalid="ignore"):
        along_rad = np.arccos(np.stack((-ahead_m, length_m - ahead_m)) / radius_m)
        across_rad = np.arcsin(np.stack((-clearance_m - aside_m, clearance_m - aside_m)) / radius_m)
    angles_rad = np.vstack((along_rad, -along_rad, across_rad, math.pi - across_rad)) % math.tau  # (8, W)
    angles_rad = np.sort(angles_rad, axis=0)
    begin_rad = np.where(np.isnan(angles_rad), 0.0, angles_rad)
    end_rad = np.vstack((angles_rad[1:], np.full(len(length_m), np.nan)))
    first_rad = np.where(np.isnan(angles_rad[0]), 0.0, angles_rad[0]) + math.tau
    end_rad = np.where(np.isnan(end_rad), first_rad, end_rad)
    # Crossed nowhere: the whole circle, in the first row.
    kept = ~np.isnan(angles_rad)
    kept[0] = True
    middle_rad = 0.5 * (begin_rad + end_rad)
    along = ahead_m + radius_m * np.cos(middle_rad)
    across = aside_m + radius_m * np.sin(middle_rad)
    covered = kept & (along > 0.0) & (along < length_m) & (np.abs(across) < clearance_m)
    return (begin_rad + course_rad)[covered], (end_rad - begin_rad)[covered]


def _pieces_to(step: _Step) -> list[PathPiece]:
    pieces: list[PathPiece] = []
    here: _Step | None = step
    while here is not None:
        pieces += here.pieces[::-1]
        here = here.before
    return pieces[::-1]
