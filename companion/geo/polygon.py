"""Polygons on the mission's plane: whether a point lies inside one, and whether its edges cross."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def inside_polygon(point_ned_m: tuple[float, float], polygon_ned_m: Sequence[tuple[float, float]]) -> bool:
    """Return whether a point (north, east) lies inside a polygon without self-intersections (even-odd rule)."""
    north_m, east_m = point_ned_m
    inside = False
    previous_north_m, previous_east_m = polygon_ned_m[-1]
    for corner_north_m, corner_east_m in polygon_ned_m:
        if (corner_north_m > north_m) != (previous_north_m > north_m):
            share = (north_m - corner_north_m) / (previous_north_m - corner_north_m)
            if east_m < corner_east_m + share * (previous_east_m - corner_east_m):
                inside = not inside
        previous_north_m, previous_east_m = corner_north_m, corner_east_m
    return inside


def polygon_fault(corners_ned_m: Sequence[tuple[float, float]]) -> str | None:
    """Return why at least three corners (north, east) make no simple polygon, or None if they do.

    The edges of a simple polygon, of which the last joins the last corner to the first, meet at the corners and nowhere
    else, so that it has an inside, of some area. Corners are counted from 0.
    """
    seen: dict[tuple[float, float], int] = {}
    for index, corner in enumerate(corners_ned_m):
        if corner in seen:
            return f"corner {index} is corner {seen[corner]} again"
        seen[corner] = index
    starts_m = np.array(corners_ned_m, dtype=float)
    ends_m = np.roll(starts_m, -1, axis=0)
    if len(starts_m) == 3 and _cross(starts_m[1] - starts_m[0], starts_m[2] - starts_m[0]) == 0.0:
        return "its three corners are on one line"
    for index in range(len(starts_m) - 2):
        # An edge that runs back along its neighbour also touches the edge beyond it. The last one neighbours the first.
        others = slice(index + 2, -1 if index == 0 else None)
        meets = _meets(starts_m[index], ends_m[index], starts_m[others], ends_m[others])
        if meets.any():
            return f"the edges after corners {index} and {index + 2 + int(np.argmax(meets))} cross or touch"
    return None


def _cross(first_m: np.ndarray, second_m: np.ndarray) -> np.ndarray:
    return np.asarray(first_m[..., 0] * second_m[..., 1] - first_m[..., 1] * second_m[..., 0])


def _meets(start_m: np.ndarray, end_m: np.ndarray, starts_m: np.ndarray, ends_m: np.ndarray) -> np.ndarray:
    """Return whether an edge, (2,) each end, has a point in common with others, (K, 2) each end; (K,) bool."""
    sides = [
        np.sign(_cross(ends_m - starts_m, start_m - starts_m)),
        np.sign(_cross(ends_m - starts_m, end_m - starts_m)),
        np.sign(_cross(end_m - start_m, starts_m - start_m)),
        np.sign(_cross(end_m - start_m, ends_m - start_m)),
    ]
    low_m, high_m = np.minimum(starts_m, ends_m), np.maximum(starts_m, ends_m)
    overlap = np.all((low_m <= np.maximum(start_m, end_m)) & (np.minimum(start_m, end_m) <= high_m), axis=1)
    # Where all four are 0 the edges lie on one line, and the boxes about them overlap only where the edges do.
    return np.asarray(overlap & (sides[0] * sides[1] <= 0.0) & (sides[2] * sides[3] <= 0.0))
