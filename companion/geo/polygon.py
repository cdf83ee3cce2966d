"""Test whether a point of the mission's plane lies inside a polygon."""

from __future__ import annotations

from collections.abc import Sequence


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
