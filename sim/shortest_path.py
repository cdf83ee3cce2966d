"""Shortest paths around discs, with which the paths that were flown are compared.

A shortest path around discs consists of straight segments that touch discs and of arcs along discs. So Dijkstra's
algorithm is exact on the graph whose nodes are the tangent points and whose edges are the free tangent segments and
the free arcs. Start and goal are discs of radius zero, so that their tangents need no special case.

A vehicle with a least turn radius leaves along one of its two turning circles, so its path starts on these circles
instead, and passes every disc at the turn radius or more (docs/method.md section 3, routed attraction).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

TOLERANCE = 1e-9
"""Depth, as a share of the scene's size, to which a segment may enter a disc that it touches, for rounding."""

_START = 0
_GOAL = 1


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
class _Discs:
    """Discs that no path may enter by more than `tolerance_m`."""

    centre_m: np.ndarray  # (M, 2) m
    radius_m: np.ndarray  # (M,) m
    tolerance_m: float


@dataclass(frozen=True)
class _Circles:
    """Circles with a direction of travel, one row each; the first two are the start's turning circles: right, left."""

    centre_m: np.ndarray  # (C, 2) m
    radius_m: np.ndarray  # (C,) m
    side: np.ndarray  # (C,) 1 where they are travelled turning right, -1 left


@dataclass(frozen=True)
class _Tangents:
    """Segments that touch two discs, one row each; start and goal are the discs 0 and 1."""

    disc: np.ndarray  # (T, 2) index of the disc at either end
    angle_rad: np.ndarray  # (T, 2) where on the disc, from the first axis towards the second
    point_m: np.ndarray  # (T, 2, 2) either end


def shortest_path_length(start_m: np.ndarray, goal_m: np.ndarray, centres_m: np.ndarray, radii_m: np.ndarray) -> float:
    """Return the length in metres of the shortest path from start (2,) to goal (2,) that enters none of M discs.

    Centres (M, 2) and radii (M,) are in metres; discs may overlap, and a path may run along their edges. The length is
    infinite if there is no path, because start or goal is inside a disc or discs enclose one of them.
    """
    start_m, goal_m = np.asarray(start_m, dtype=float), np.asarray(goal_m, dtype=float)
    centres_m = np.asarray(centres_m, dtype=float).reshape(-1, 2)
    radii_m = np.asarray(radii_m, dtype=float)
    size_m = float(np.abs(np.vstack((goal_m, centres_m)) - start_m).max(initial=0.0) + radii_m.max(initial=0.0))
    tolerance_m = TOLERANCE * size_m

    ends_m = np.stack((start_m, goal_m))
    if (np.linalg.norm(ends_m[:, None] - centres_m, axis=-1) < radii_m - tolerance_m).any():
        return math.inf
    direct_m = float(np.linalg.norm(goal_m - start_m))
    if _free(ends_m[None], _Discs(centres_m, radii_m, tolerance_m))[0]:
        return direct_m

    kept = _not_inside_another(centres_m, radii_m)
    # Relative to the start, so that large coordinates lose no precision.
    centres_m = np.vstack((np.zeros(2), goal_m - start_m, centres_m[kept] - start_m))
    discs = _Discs(centres_m, np.concatenate((np.zeros(2), radii_m[kept])), tolerance_m)
    tangents = _free_tangents(discs)

    # Every end of a tangent is a node; all ends at the start are one node, and all ends at the goal are one.
    disc = tangents.disc.ravel()
    node = np.where(disc < 2, disc, np.arange(disc.size) + 2)
    length_m = np.linalg.norm(tangents.point_m[:, 1] - tangents.point_m[:, 0], axis=-1)
    edges = [(node[0::2], node[1::2], length_m)]
    for index in range(2, len(discs.radius_m)):
        on_disc = np.flatnonzero(disc == index)
        edges.append(_free_arcs(index, node[on_disc], tangents.angle_rad.ravel()[on_disc], discs))
    begin, end, weight_m = (np.concatenate(column) for column in zip(*edges, strict=True))
    distance_m = _distance(disc.size + 2, begin, end, weight_m)
    return max(distance_m, direct_m)


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


def _free(segments_m: np.ndarray, discs: _Discs) -> np.ndarray:
    """Return (T,) bool, whether each of the segments (T, 2, 2) enters no disc by more than the tolerance."""
    begin = segments_m[:, None, 0]
    along = segments_m[:, None, 1] - begin  # (T, 1, 2)
    to_centre = discs.centre_m - begin  # (T, M, 2)
    squared = np.maximum((along**2).sum(axis=-1), np.finfo(float).tiny)
    fraction = np.clip((to_centre * along).sum(axis=-1) / squared, 0.0, 1.0)
    miss_m = np.linalg.norm(to_centre - fraction[..., None] * along, axis=-1)
    free: np.ndarray = (miss_m >= discs.radius_m - discs.tolerance_m).all(axis=-1)
    return free


def _free_tangents(discs: _Discs) -> _Tangents:
    """Return, for every two discs, the segments that touch both and enter no disc."""
    centres_m, radii_m = discs.centre_m, discs.radius_m
    first, second = np.triu_indices(len(radii_m), k=1)
    offset = centres_m[second] - centres_m[first]
    gap_m = np.linalg.norm(offset, axis=-1)
    bearing = np.arctan2(offset[:, 1], offset[:, 0])
    apart = (gap_m >= radii_m[first] + radii_m[second]) & (radii_m[first] > 0)

    # The tangent's normal makes this angle with the line of centres; an outer tangent touches both discs on the same
    # side of that normal, an inner one (only between discs apart) on opposite sides.
    outer = np.arccos(np.clip((radii_m[first] - radii_m[second]) / gap_m, -1.0, 1.0))
    inner = np.arccos(np.clip((radii_m[first] + radii_m[second]) / gap_m, -1.0, 1.0))[apart]
    normal = np.concatenate((bearing + outer, bearing - outer, bearing[apart] + inner, bearing[apart] - inner))
    crosses = np.repeat((0.0, math.pi), (2 * len(first), 2 * len(inner)))
    disc = np.stack(
        (
            np.concatenate((first, first, first[apart], first[apart])),
            np.concatenate((second, second, second[apart], second[apart])),
        ),
        axis=-1,
    )
    angle = np.stack((normal, normal + crosses), axis=-1)
    unit = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    point_m = centres_m[disc] + radii_m[disc][..., None] * unit
    free = _free(point_m, discs)
    return _Tangents(disc[free], angle[free], point_m[free])


def _free_arcs(
    index: int, node: np.ndarray, angle_rad: np.ndarray, discs: _Discs
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the arcs between neighbouring nodes of one disc that no other disc covers, as columns.

    The columns are the nodes at the beginning and end, and the length in metres.
    """
    centres_m, radii_m = discs.centre_m, discs.radius_m
    order = np.argsort(angle_rad % math.tau, kind="stable")
    node, begin_rad = node[order], (angle_rad % math.tau)[order]
    sweep_rad = np.diff(begin_rad, append=begin_rad[:1] + math.tau)

    offset = centres_m - centres_m[index]
    gap_m = np.linalg.norm(offset, axis=-1)
    radius_m = radii_m[index]
    # The discs that cross this one; discs that another covers were left out before.
    crossing = (gap_m > 0) & (gap_m < radius_m + radii_m) & (gap_m > np.abs(radius_m - radii_m))
    gap_m, other_m, offset = gap_m[crossing], radii_m[crossing], offset[crossing]
    covered_half_rad = np.arccos(np.clip((radius_m**2 + gap_m**2 - other_m**2) / (2 * radius_m * gap_m), -1.0, 1.0))
    covered_mid_rad = np.arctan2(offset[:, 1], offset[:, 0])

    arc_mid_rad = begin_rad + sweep_rad / 2  # (A,)
    between = np.abs((covered_mid_rad - arc_mid_rad[:, None] + math.pi) % math.tau - math.pi)  # (A, crossing)
    overlap_rad = covered_half_rad + sweep_rad[:, None] / 2 - between
    free = (overlap_rad <= discs.tolerance_m / radius_m).all(axis=-1)
    return node[free], np.roll(node, -1)[free], radius_m * sweep_rad[free]


def _distance(nodes: int, begin: np.ndarray, end: np.ndarray, weight_m: np.ndarray) -> float:
    """Return the least distance in metres from start to goal over undirected edges; infinite if there is no path."""
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    # A sparse matrix adds up parallel edges (the two arcs between two nodes), so only the shortest of them may go in.
    order = np.lexsort((weight_m, high, low))
    low, high, weight_m = low[order], high[order], weight_m[order]
    first = np.ones(len(low), dtype=bool)
    first[1:] = (np.diff(low) != 0) | (np.diff(high) != 0)
    # Edges of length zero (a start on a disc's edge) are stored in it and count.
    edges = coo_array((weight_m[first], (low[first], high[first])), shape=(nodes, nodes)).tocsr()
    return float(dijkstra(edges, directed=False, indices=[_START])[0, _GOAL])


def turning_path(
    departure: Departure,
    goal_m: np.ndarray,  # (2,) m
    goal_radius_m: float,
    centres_m: np.ndarray,  # (M, 2) m
    radii_m: np.ndarray,  # (M,) m
) -> list[PathPiece] | None:
    """Return a short path to within `goal_radius_m` of a goal that respects the vehicle's turn radius.

    The path enters none of the M discs. It is the shortest of the paths of one kind: they leave along a turning circle,
    then follow straight lines and circles about discs, each with the greater of the disc's radius and the turn radius,
    and end on a straight line towards the goal. None if there is no such path. A path of another kind may then exist,
    and may be shorter where discs are smaller than the turn radius.
    """
    heading_rad, turn_radius_m = departure.heading_rad, departure.turn_radius_m
    start_m, goal_m = np.asarray(departure.start_m, dtype=float), np.asarray(goal_m, dtype=float)
    centres_m = np.asarray(centres_m, dtype=float).reshape(-1, 2)
    radii_m = np.asarray(radii_m, dtype=float)
    if np.linalg.norm(goal_m - start_m) <= goal_radius_m:
        return []
    size_m = float(np.abs(np.vstack((goal_m, centres_m)) - start_m).max(initial=0.0) + radii_m.max(initial=0.0))
    tolerance_m = TOLERANCE * (size_m + turn_radius_m)
    kept = _not_inside_another(centres_m, radii_m)
    # Relative to the start, so that large coordinates lose no precision.
    discs, goal_m = _Discs(centres_m[kept] - start_m, radii_m[kept], tolerance_m), goal_m - start_m
    circles = _directed_circles(heading_rad, turn_radius_m, goal_m, discs)
    begin, end, course_rad, length_m = _directed_tangents(circles, goal_m, goal_radius_m, discs)

    # A node is an end of a tangent on a circle; nodes 0 to 2 are the goal and the start on its two turning circles.
    tangents = len(begin)
    circle = np.concatenate(([-1, 0, 1], begin, end))
    angle_rad = course_rad - circles.side[begin] * math.pi / 2
    end_angle_rad = course_rad - np.where(end >= 0, circles.side[end], 0.0) * math.pi / 2
    away_rad = heading_rad - circles.side[:2] * math.pi / 2
    angle_rad = np.concatenate(([0.0], away_rad, angle_rad, end_angle_rad))
    ids = np.arange(tangents)
    edges = [(3 + ids, np.where(end >= 0, 3 + tangents + ids, 0), length_m, np.zeros(tangents))]
    for index in range(len(circles.side)):
        on_circle = np.flatnonzero(circle == index)
        if len(on_circle) > 1:
            edges.append(_directed_arcs(index, on_circle, angle_rad[on_circle], circles, discs))
    return _pieces(3 + 2 * tangents, *(np.concatenate(column) for column in zip(*edges, strict=True)))


def _directed_circles(heading_rad: float, turn_radius_m: float, goal_m: np.ndarray, discs: _Discs) -> _Circles:
    """Return the two turning circles of a start at (0, 0), then every disc's circle in both directions.

    A disc smaller than the turn radius has a circle of that radius, unless the circle would contain start or goal.
    """
    centres_m, radii_m = discs.centre_m, discs.radius_m
    to_right = np.array([-math.sin(heading_rad), math.cos(heading_rad)])
    routed_m = np.maximum(radii_m, turn_radius_m)
    nearest_m = np.minimum(np.linalg.norm(centres_m, axis=-1), np.linalg.norm(centres_m - goal_m, axis=-1))
    usable = (routed_m <= nearest_m) | (radii_m >= turn_radius_m)
    number = int(usable.sum())
    return _Circles(
        np.vstack((turn_radius_m * np.outer((1.0, -1.0), to_right), np.repeat(centres_m[usable], 2, axis=0))),
        np.concatenate(((turn_radius_m, turn_radius_m), np.repeat(routed_m[usable], 2))),
        np.tile((1.0, -1.0), number + 1),
    )


def _directed_tangents(
    circles: _Circles, goal_m: np.ndarray, goal_radius_m: float, discs: _Discs
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the free tangents from circle to circle and to the goal, as columns.

    The columns are the circles at the beginning and end (-1: the goal), the course in rad and the length in m.
    """
    count = len(circles.side)
    first = np.repeat(np.arange(count), count + 1)
    second = np.tile(np.arange(count + 1), count)
    centre_m = np.vstack((circles.centre_m, goal_m))
    # Signed radii: a circle that is travelled turning right is to the right of its tangents.
    signed_m = np.append(circles.side * circles.radius_m, 0.0)
    offset_m = centre_m[second] - centre_m[first]
    gap_m = np.linalg.norm(offset_m, axis=-1)
    difference_m = signed_m[first] - signed_m[second]
    # No tangent leads back to a circle of the start.
    apart = (gap_m > np.abs(difference_m)) & (gap_m > discs.tolerance_m) & (second >= 2)
    first, second, offset_m, gap_m, difference_m = (
        column[apart] for column in (first, second, offset_m, gap_m, difference_m)
    )
    course_rad = np.arctan2(offset_m[:, 1], offset_m[:, 0]) + np.arcsin(difference_m / gap_m)
    length_m = np.sqrt(gap_m**2 - difference_m**2)
    along = np.column_stack((np.cos(course_rad), np.sin(course_rad)))
    begin_m = centre_m[first] + signed_m[first, None] * np.column_stack((along[:, 1], -along[:, 0]))
    length_m = np.where(second == count, np.maximum(length_m - goal_radius_m, 0.0), length_m)
    segments_m = np.stack((begin_m, begin_m + length_m[:, None] * along), axis=1)
    free = _free(segments_m, discs)
    return first[free], np.where(second == count, -1, second)[free], course_rad[free], length_m[free]


def _directed_arcs(
    index: int, node: np.ndarray, angle_rad: np.ndarray, circles: _Circles, discs: _Discs
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the free arcs from each node of a circle to the next one on it, as columns.

    The columns are the nodes at the beginning and end, the length in m and the turn in rad.
    """
    centres_m, radii_m, tolerance_m = discs.centre_m, discs.radius_m, discs.tolerance_m
    side, radius_m = circles.side[index], circles.radius_m[index]
    onward_rad = (side * angle_rad) % math.tau
    order = np.argsort(onward_rad, kind="stable")
    node, onward_rad = node[order], onward_rad[order]
    sweep_rad = np.diff(onward_rad, append=onward_rad[:1] + math.tau)
    middle_rad = side * (onward_rad + sweep_rad / 2)  # (A,)

    offset_m = centres_m - circles.centre_m[index]
    gap_m = np.linalg.norm(offset_m, axis=-1)
    touching = (gap_m < radius_m + radii_m) & (gap_m + radii_m > radius_m + tolerance_m)
    gap_m, other_m, offset_m = gap_m[touching], radii_m[touching], offset_m[touching]
    ratio = (radius_m**2 + gap_m**2 - other_m**2) / np.maximum(2 * radius_m * gap_m, np.finfo(float).tiny)
    covered_half_rad = np.arccos(np.clip(ratio, -1.0, 1.0))
    covered_rad = np.arctan2(offset_m[:, 1], offset_m[:, 0])
    between = np.abs((covered_rad - middle_rad[:, None] + math.pi) % math.tau - math.pi)  # (A, touching)
    free = (covered_half_rad + sweep_rad[:, None] / 2 - between <= 2 * tolerance_m / radius_m).all(axis=-1)
    return node[free], np.roll(node, -1)[free], radius_m * sweep_rad[free], side * sweep_rad[free]


def _pieces(
    nodes: int, begin: np.ndarray, end: np.ndarray, length_m: np.ndarray, turn_rad: np.ndarray
) -> list[PathPiece] | None:
    """Return the shortest path from node 1 or 2 to node 0 over directed edges; None if there is none.

    Consecutive arcs are one piece.
    """
    # Edges of length zero are stored and count. No two edges have the same beginning and end.
    edges = coo_array((length_m, (begin, end)), shape=(nodes, nodes)).tocsr()
    turns = {(int(b), int(e)): (float(m), float(t)) for b, e, m, t in zip(begin, end, length_m, turn_rad, strict=True)}
    distance_m, before, _ = dijkstra(edges, indices=[1, 2], min_only=True, return_predecessors=True)
    if math.isinf(distance_m[0]):
        return None
    found: list[PathPiece] = []
    node = 0
    while before[node] >= 0:
        length, turn = turns[int(before[node]), node]
        node = int(before[node])
        if found and turn and found[-1].turn_rad:
            found[-1] = PathPiece(length + found[-1].length_m, turn + found[-1].turn_rad)
        else:
            found.append(PathPiece(length, turn))
    return found[::-1]
