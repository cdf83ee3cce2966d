"""How short a path around discs can be: the yardstick for the paths that were flown.

A shortest path around discs is made of straight segments that touch discs and of arcs along them. So the tangent points
are the nodes of a graph whose edges are the free tangent segments and the free arcs, and Dijkstra's method on it is
exact. Start and goal are discs of radius zero, which makes their tangents a case of the tangents between discs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

TOLERANCE = 1e-9
"""Of the scene's size: how deep a segment may seem to cut into a disc that it touches, for rounding."""

_START = 0
_GOAL = 1


@dataclass(frozen=True)
class _Tangents:
    """Segments that touch two discs, one row each; the indices count start and goal as discs 0 and 1."""

    disc: np.ndarray  # (T, 2) index of the disc at either end
    angle_rad: np.ndarray  # (T, 2) where on the disc, from the first axis towards the second
    point_m: np.ndarray  # (T, 2, 2) either end


def shortest_path_length(start_m: np.ndarray, goal_m: np.ndarray, centres_m: np.ndarray, radii_m: np.ndarray) -> float:
    """Return the length in metres of the shortest path from start (2,) to goal (2,) that enters none of M discs.

    Centres (M, 2) and radii (M,) are in metres; discs may overlap, and a path may run along their edges. Infinite where
    there is no way: start or goal inside a disc, or walled off.
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
    if _free(ends_m[None], centres_m, radii_m, tolerance_m)[0]:
        return direct_m

    kept = _not_inside_another(centres_m, radii_m)
    # About the start, so that large coordinates cost no digits.
    centres_m = np.vstack((np.zeros(2), goal_m - start_m, centres_m[kept] - start_m))
    radii_m = np.concatenate((np.zeros(2), radii_m[kept]))
    tangents = _free_tangents(centres_m, radii_m, tolerance_m)

    # Every end of a tangent is a node, but all ends at the start are one node, and so are all at the goal.
    disc = tangents.disc.ravel()
    node = np.where(disc < 2, disc, np.arange(disc.size) + 2)
    length_m = np.linalg.norm(tangents.point_m[:, 1] - tangents.point_m[:, 0], axis=-1)
    edges = [(node[0::2], node[1::2], length_m)]
    for index in range(2, len(radii_m)):
        on_disc = np.flatnonzero(disc == index)
        edges.append(
            _free_arcs(index, node[on_disc], tangents.angle_rad.ravel()[on_disc], centres_m, radii_m, tolerance_m)
        )
    begin, end, weight_m = (np.concatenate(column) for column in zip(*edges, strict=True))
    distance_m = _distance(disc.size + 2, begin, end, weight_m)
    return max(distance_m, direct_m)


def _not_inside_another(centres_m: np.ndarray, radii_m: np.ndarray) -> np.ndarray:
    """Return (M,) bool: discs of some size that no other disc covers (of equal discs the first stays)."""
    count = len(radii_m)
    gap_m = np.linalg.norm(centres_m[:, None] - centres_m, axis=-1)
    covers = gap_m + radii_m[None, :] <= radii_m[:, None]  # (M, M) row covers column
    np.fill_diagonal(covers, False)
    order = np.arange(count)
    covers &= ~(covers.T & (order[:, None] > order[None, :]))
    kept: np.ndarray = ~covers.any(axis=0) & (radii_m > 0)
    return kept


def _free(segments_m: np.ndarray, centres_m: np.ndarray, radii_m: np.ndarray, tolerance_m: float) -> np.ndarray:
    """Return (T,) bool: segments (T, 2, 2) that enter no disc by more than the tolerance."""
    begin = segments_m[:, None, 0]
    along = segments_m[:, None, 1] - begin  # (T, 1, 2)
    to_centre = centres_m - begin  # (T, M, 2)
    squared = np.maximum((along**2).sum(axis=-1), np.finfo(float).tiny)
    fraction = np.clip((to_centre * along).sum(axis=-1) / squared, 0.0, 1.0)
    miss_m = np.linalg.norm(to_centre - fraction[..., None] * along, axis=-1)
    free: np.ndarray = (miss_m >= radii_m - tolerance_m).all(axis=-1)
    return free


def _free_tangents(centres_m: np.ndarray, radii_m: np.ndarray, tolerance_m: float) -> _Tangents:
    """Return the segments between every two discs that touch both and enter no disc."""
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
    free = _free(point_m, centres_m, radii_m, tolerance_m)
    return _Tangents(disc[free], angle[free], point_m[free])


def _free_arcs(
    index: int,
    node: np.ndarray,
    angle_rad: np.ndarray,
    centres_m: np.ndarray,
    radii_m: np.ndarray,
    tolerance_m: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the arcs between neighbouring nodes of one disc that no other disc covers: begin, end, length (m)."""
    order = np.argsort(angle_rad % math.tau, kind="stable")
    node, begin_rad = node[order], (angle_rad % math.tau)[order]
    sweep_rad = np.diff(begin_rad, append=begin_rad[:1] + math.tau)

    offset = centres_m - centres_m[index]
    gap_m = np.linalg.norm(offset, axis=-1)
    radius_m = radii_m[index]
    # Discs that cross this one; none covers another here.
    crossing = (gap_m > 0) & (gap_m < radius_m + radii_m) & (gap_m > np.abs(radius_m - radii_m))
    gap_m, other_m, offset = gap_m[crossing], radii_m[crossing], offset[crossing]
    covered_half_rad = np.arccos(np.clip((radius_m**2 + gap_m**2 - other_m**2) / (2 * radius_m * gap_m), -1.0, 1.0))
    covered_mid_rad = np.arctan2(offset[:, 1], offset[:, 0])

    arc_mid_rad = begin_rad + sweep_rad / 2  # (A,)
    between = np.abs((covered_mid_rad - arc_mid_rad[:, None] + math.pi) % math.tau - math.pi)  # (A, crossing)
    overlap_rad = covered_half_rad + sweep_rad[:, None] / 2 - between
    free = (overlap_rad <= tolerance_m / radius_m).all(axis=-1)
    return node[free], np.roll(node, -1)[free], radius_m * sweep_rad[free]


def _distance(nodes: int, begin: np.ndarray, end: np.ndarray, weight_m: np.ndarray) -> float:
    """Return the distance in metres from start to goal over undirected edges; infinite where there is no way."""
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    # A sparse matrix adds up parallel edges (the two arcs between two nodes), so only the shortest of them may go in.
    order = np.lexsort((weight_m, high, low))
    low, high, weight_m = low[order], high[order], weight_m[order]
    first = np.ones(len(low), dtype=bool)
    first[1:] = (np.diff(low) != 0) | (np.diff(high) != 0)
    # Edges of length zero (a start on a disc's edge) are stored in it and count.
    edges = coo_array((weight_m[first], (low[first], high[first])), shape=(nodes, nodes)).tocsr()
    return float(dijkstra(edges, directed=False, indices=[_START])[0, _GOAL])
