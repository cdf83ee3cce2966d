"""The polygons that a vehicle must stay inside and outside of."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from companion.guard.arcs import circle_of, distances_m, end_of
from companion.guard.types import Piece


class Fence:
    """Polygons without self-intersections: one that the vehicle must stay inside, and others to stay outside of."""

    def __init__(
        self,
        corners_ned_m: Sequence[tuple[float, float]] | None,
        exclusions_ned_m: Sequence[Sequence[tuple[float, float]]] = (),
    ) -> None:
        """Take the corners, north and east in m, of the polygon to stay inside (None: none) and those of exclusions."""
        polygons = [np.array(corners, dtype=float) for corners in exclusions_ned_m]
        if corners_ned_m is not None:
            polygons.insert(0, np.array(corners_ned_m, dtype=float))
        self._ends_m = np.vstack(polygons)
        self._starts_m = np.vstack([np.roll(corners_m, 1, axis=0) for corners_m in polygons])
        self._along_m = self._ends_m - self._starts_m
        squares = (self._along_m**2).sum(axis=1)
        self._lengths_m2 = np.where(squares > 0.0, squares, 1.0)
        sizes = [len(corners_m) for corners_m in polygons]
        self._first = np.cumsum([0, *sizes[:-1]])
        self._polygon = np.repeat(np.arange(len(sizes)), sizes)
        self._inside = np.arange(len(sizes)) < (corners_ned_m is not None)
        self.longest_m = math.inf
        """Length that no straight line inside the polygons has: infinite without one to stay inside."""
        if corners_ned_m is not None:
            self.longest_m = float(np.hypot(*np.ptp(polygons[0], axis=0)))

    def depth_m(self, north_m: float, east_m: float) -> float:
        """Return the distance from a place to the nearest edge, negative where it must not be (even-odd rule)."""
        norths_m, easts_m = north_m - self._starts_m[:, 0], east_m - self._starts_m[:, 1]
        upward = self._along_m[:, 0] > 0.0
        spans = (self._ends_m[:, 0] > north_m) != (self._starts_m[:, 0] > north_m)
        to_the_east = self._along_m[:, 1] * norths_m > easts_m * self._along_m[:, 0]
        crosses = spans & (to_the_east == upward)
        near_norths_m, near_easts_m = self._nearest_m(north_m, east_m)
        apart_m = np.hypot(near_norths_m - north_m, near_easts_m - east_m)
        if len(self._first) == 1:
            right = (np.count_nonzero(crosses) % 2 == 1) == self._inside[0]
            return float(apart_m.min()) if right else -float(apart_m.min())
        wrong = (np.add.reduceat(crosses.astype(int), self._first) % 2 == 1) != self._inside
        if wrong.any():
            return -float(apart_m[wrong[self._polygon]].min())
        return float(apart_m.min())

    def holds(self, pieces: Iterable[Piece], margin_m: float) -> bool:
        """Return whether connected pieces stay where they may and at least the margin away from every edge."""
        first = True
        for piece in pieces:
            reach_m = min(piece.length_m, 2.0 / abs(piece.curvature_1_m) if piece.curvature_1_m else math.inf)
            if first:
                depth_m = self.depth_m(piece.north_m, piece.east_m)
                if depth_m < margin_m:
                    return False
                first = False
                room_m = depth_m - margin_m
            if reach_m <= room_m:
                room_m -= reach_m
                continue
            room_m = 0.0
            if (distances_m(piece, *self._touching_m(piece)) < margin_m).any():
                return False
            # What never ends and crosses nothing stays where its beginning is.
            if math.isfinite(piece.length_m) and self.depth_m(*end_of(piece)[:2]) < margin_m:
                return False
        return True

    def _nearest_m(self, north_m: float, east_m: float) -> tuple[np.ndarray, np.ndarray]:
        """Return north and east, (E,) each, of the point on each edge that is nearest to a point."""
        along = (north_m - self._starts_m[:, 0]) * self._along_m[:, 0]
        along += (east_m - self._starts_m[:, 1]) * self._along_m[:, 1]
        return self._points(along / self._lengths_m2)

    def _points(self, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shares = np.clip(shares, 0.0, 1.0)
        return self._starts_m[:, 0] + shares * self._along_m[:, 0], self._starts_m[:, 1] + shares * self._along_m[:, 1]

    def _touching_m(self, piece: Piece) -> tuple[np.ndarray, np.ndarray]:  # (P,) m, (P,) m
        """Return north and east of the points of the edges of which one is nearest to the interior of a piece.

        They are the corners, the points where an edge crosses the piece's line or circle, and the points where an edge
        comes nearest to the circle's centre. An end of the piece may be nearer to an edge still: the caller checks it.
        """
        starts, along = self._starts_m, self._along_m
        if piece.curvature_1_m == 0.0:
            ahead = (math.cos(piece.heading_rad), math.sin(piece.heading_rad))
            away = (starts[:, 0] - piece.north_m) * ahead[1] - (starts[:, 1] - piece.east_m) * ahead[0]
            slope = along[:, 1] * ahead[0] - along[:, 0] * ahead[1]
            shares = away / np.where(slope == 0.0, 1.0, slope)
            points = [self._points(shares)]
        else:
            centre_north_m, centre_east_m, radius_m = circle_of(piece)
            foot = (
                (centre_north_m - starts[:, 0]) * along[:, 0] + (centre_east_m - starts[:, 1]) * along[:, 1]
            ) / self._lengths_m2
            off_m2 = (starts[:, 0] + foot * along[:, 0] - centre_north_m) ** 2 + (
                starts[:, 1] + foot * along[:, 1] - centre_east_m
            ) ** 2
            half = np.sqrt(np.maximum(radius_m**2 - off_m2, 0.0) / self._lengths_m2)
            points = [self._points(foot), self._points(foot - half), self._points(foot + half)]
        norths_m = np.concatenate([starts[:, 0], *(point[0] for point in points)])
        easts_m = np.concatenate([starts[:, 1], *(point[1] for point in points)])
        return norths_m, easts_m
