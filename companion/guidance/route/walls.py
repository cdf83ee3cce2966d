"""Walls of a scene: fence and exclusion polygons as corners and as bands that no path may enter."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

Polygon = tuple[tuple[float, float], ...]
"""The corners of a closed polygon, (north, east) in m; the last is joined with the first."""


class Walls(NamedTuple):
    """The polygons whose edges no path may cross or come nearer to than a clearance."""

    fence: Polygon = ()
    """The polygon to stay inside; () if there is none."""
    exclusions: tuple[Polygon, ...] = ()
    """The polygons to stay outside."""
    clearance_m: float = 0.0


NO_WALLS = Walls()


class Bands(NamedTuple):
    """Edges of polygons, each with half a width: together with discs about their ends they are what may not be entered.

    `first` and `second` are the indices of the discs about its ends.
    """

    begin: np.ndarray  # (E,) complex, north + i east, m
    ahead: np.ndarray  # (E,) complex, of length 1
    length_m: np.ndarray  # (E,)
    half_m: np.ndarray  # (E,) half widths
    first: np.ndarray  # (E,) int
    second: np.ndarray  # (E,) int

    def take(self, rows: np.ndarray) -> Bands:
        """Return the bands with the given indices."""
        return Bands(*(column[rows] for column in self))

    def distance_m(self, point: complex) -> np.ndarray:  # (E,)
        """Return the distance of a point to each edge, m."""
        return np.abs(point - self.nearest(point))

    def nearest(self, points: np.ndarray | complex) -> np.ndarray:
        """Return the point of each edge nearest to a point, or to points in an array that broadcasts to (E,)."""
        along_m = ((points - self.begin) * self.ahead.conj()).real
        found: np.ndarray = self.begin + np.minimum(np.maximum(along_m, 0.0), self.length_m) * self.ahead
        return found

    def entered(self, begin: np.ndarray, end: np.ndarray, tolerance_m: float) -> np.ndarray:
        """Return which segments, arrays that broadcast to (E,), enter which band; its ends' discs do not count.

        A band of no width is entered by what crosses it.
        """
        turn = self.ahead.conj()
        first, last = (begin - self.begin) * turn, (end - self.begin) * turn
        aside_m, change_m = first.imag, last.imag - first.imag
        across_m = np.where(change_m == 0.0, 1.0, change_m)
        half_m = np.where(change_m < 0.0, -self.half_m, self.half_m)
        enters, leaves = (-half_m - aside_m) / across_m, (half_m - aside_m) / across_m
        level = change_m == 0.0
        within = level & (np.abs(aside_m) < self.half_m)
        enters = np.where(level, 0.0, np.maximum(enters, 0.0))
        leaves = np.where(level, np.where(within, 1.0, -1.0), np.minimum(leaves, 1.0))
        along_m = last.real - first.real
        from_m, to_m = first.real + enters * along_m, first.real + leaves * along_m
        crossed = (self.half_m <= 0.0) & (np.abs(aside_m) > tolerance_m) & (np.abs(last.imag) > tolerance_m)
        inside = (enters < leaves) | (crossed & (enters == leaves))
        beside = (np.maximum(from_m, to_m) > tolerance_m) & (np.minimum(from_m, to_m) < self.length_m - tolerance_m)
        found: np.ndarray = inside & beside
        return found

    def stretches(self, place: complex, radius_m: float, tolerance_m: float) -> Iterator[tuple[float, float, int]]:
        """Yield the stretches of a circle within each band: middle and half width in radians, and the band's index.

        Where a band of no width is crossed the stretch is a point, unless that is the origin.
        """
        nearest = self.nearest(place)
        crossing = np.abs(place - nearest) < radius_m + self.half_m
        for band in crossing.nonzero()[0].tolist():
            ahead, half_m = complex(self.ahead[band]), float(self.half_m[band])
            within = _in_rectangle(
                (place - complex(self.begin[band])) * ahead.conjugate(), radius_m, float(self.length_m[band]), half_m
            )
            for middle_rad, half_rad in within:
                angle_rad = middle_rad + cmath.phase(ahead)
                if half_m > 0.0 or abs(place + cmath.rect(radius_m, angle_rad)) > tolerance_m:
                    yield angle_rad, half_rad, band

    def avoidable_m(self, right: complex, radius_m: float) -> np.ndarray:  # (E,)
        """Return how wide each band may be for the first half of one of two turning circles not to enter it, m.

        `right` is the centre of the right one, of radius `radius_m`, of a vehicle at the origin.
        """
        if not np.count_nonzero(self.distance_m(0j) < self.half_m + 2.0 * radius_m):
            return np.full(len(self.half_m), math.inf)
        heading = right / complex(0.0, radius_m)
        ends = np.stack((self.begin, self.begin + self.length_m * self.ahead))
        found = np.zeros(len(self.half_m))
        for centre in (right, -right):
            inwards = (centre - self.begin) * self.ahead.conj()
            chord_m = np.sqrt(np.maximum(radius_m * radius_m - inwards.imag**2, 0.0))
            across_m = np.stack((inwards.real - chord_m, inwards.real, inwards.real + chord_m))
            points = self.begin + across_m * self.ahead  # where the circle meets the edge, and where it is nearest
            meets = (np.abs(inwards.imag) < radius_m) | np.array([[False], [True], [False]])
            meets &= (across_m >= 0.0) & (across_m <= self.length_m)
            points = np.concatenate((points, ends))
            counts = np.concatenate((meets, np.ones(ends.shape, dtype=bool)))
            ahead = ((points - centre) * heading.conjugate()).real >= 0.0
            apart_m = np.where(counts & ahead, np.abs(np.abs(points - centre) - radius_m), math.inf).min(axis=0)
            for end in (0j, 2.0 * centre):
                apart_m = np.minimum(apart_m, self.distance_m(end))
            found = np.maximum(found, apart_m)
        return found


NO_BANDS = Bands(*(np.zeros(0, dtype) for dtype in (complex, complex, float, float, int, int)))


class WallSet:
    """The walls of a mission prepared: corners and edges, and on which side of them a place is allowed."""

    def __init__(self, walls: Walls) -> None:
        """Prepare walls; raises ValueError for what is not finite."""
        self.given = walls
        polygons = [_corners(polygon) for polygon in (walls.fence, *walls.exclusions)]
        if not (math.isfinite(walls.clearance_m) and all(np.isfinite(polygon).all() for polygon in polygons)):
            raise ValueError("corners of walls and their clearance must be finite")
        self.count = len(polygons)
        self.corner = np.concatenate([*polygons, np.zeros(0, complex)])
        self.corner_of = np.repeat(np.arange(self.count), [len(polygon) for polygon in polygons])
        first, second, begin = [], [], 0
        for polygon in polygons:
            count = len(polygon)
            edges = count if count > 2 else count - 1
            first += [begin + index for index in range(edges)]
            second += [begin + (index + 1) % count for index in range(edges)]
            begin += count
        from_corner, to_corner = np.array(first, dtype=int), np.array(second, dtype=int)
        along = self.corner[to_corner] - self.corner[from_corner]
        length_m = np.abs(along)
        self._edges = Bands(
            self.corner[from_corner], along / length_m, length_m, np.zeros(len(along)), from_corner, to_corner
        )
        # What has no area has no inside; the column of a polygon tells which edges are its own.
        area = np.array([len(polygon) > 2 for polygon in polygons])
        self._own = ((self.corner_of[from_corner][:, np.newaxis] == np.arange(self.count)) & area).astype(int)
        self._wanted = (np.arange(self.count) == 0) & area

    def bands(self, half_m: float, from_index: int, without: list[int]) -> Bands:
        """Return the bands of all polygons but some; their corners have the indices from `from_index` on."""
        edges = self._edges
        if without:
            edges = edges.take(~np.isin(self.corner_of[edges.first], without))
        return edges._replace(
            half_m=np.full(len(edges.half_m), half_m), first=edges.first + from_index, second=edges.second + from_index
        )

    def forbidding(self, point: complex, tolerance_m: float) -> list[int]:
        """Return the indices of the polygons on whose wrong side a point is: outside the fence, inside an exclusion."""
        wrong = self._inside(np.array([point]))[0] != self._wanted
        if not np.count_nonzero(wrong):
            return []
        apart_m = np.where(self._own > 0, self._edges.distance_m(point)[:, np.newaxis], math.inf).min(axis=0)
        found: list[int] = (wrong & (apart_m > tolerance_m)).nonzero()[0].tolist()
        return found

    def allowed(self, points: np.ndarray) -> np.ndarray:  # (P,) complex -> (P,) bool
        """Return which points are inside the fence and outside all exclusions."""
        found: np.ndarray = ~(self._inside(points) != self._wanted).any(axis=1)
        return found

    def _inside(self, points: np.ndarray) -> np.ndarray:  # (P,) complex -> (P, polygons) bool
        """Return which points an even-odd count of the edges north of them puts inside each polygon."""
        begin = self.corner[self._edges.first] - points[:, np.newaxis]
        end = self.corner[self._edges.second] - points[:, np.newaxis]
        straddles = (begin.imag > 0.0) != (end.imag > 0.0)
        across_m = np.where(straddles, end.imag - begin.imag, 1.0)
        north_m = begin.real - begin.imag * (end.real - begin.real) / across_m
        found: np.ndarray = (straddles & (north_m > 0.0)) @ self._own % 2 == 1
        return found


def _corners(polygon: Polygon) -> np.ndarray:  # (V,) complex
    """Return the corners of a polygon without those that repeat the one before."""
    table = np.array(polygon, dtype=float).reshape(-1, 2)
    places = table[:, 0] + 1j * table[:, 1]
    return places[places != np.roll(places, 1)] if len(set(places.tolist())) > 1 else places[:1]


def _in_rectangle(
    place: complex,  # centre of the circle, in a frame whose first axis lies along the rectangle's middle
    radius_m: float,
    length_m: float,
    half_m: float,
) -> list[tuple[float, float]]:
    """Return the stretches of a circle inside a rectangle of 0 to `length_m` and of both sides to `half_m`, radians."""
    along_m, aside_m = place.real, place.imag
    corners = []
    for side_m in (half_m, -half_m):
        offset_m = side_m - aside_m
        if abs(offset_m) < radius_m:
            chord_m = math.sqrt(radius_m * radius_m - offset_m * offset_m)
            corners += [
                math.atan2(offset_m, sign * chord_m)
                for sign in (1.0, -1.0)
                if 0.0 <= along_m + sign * chord_m <= length_m
            ]
    for end_m in (0.0, length_m):
        offset_m = end_m - along_m
        if abs(offset_m) < radius_m:
            chord_m = math.sqrt(radius_m * radius_m - offset_m * offset_m)
            corners += [
                math.atan2(sign * chord_m, offset_m) for sign in (1.0, -1.0) if abs(aside_m + sign * chord_m) <= half_m
            ]
    if half_m <= 0.0:
        return [(angle_rad, 0.0) for angle_rad in corners]
    corners.sort()
    found = []
    for index, begin_rad in enumerate(corners or [0.0]):
        end_rad = corners[index + 1] if index + 1 < len(corners) else (corners or [0.0])[0] + math.tau
        middle_rad = 0.5 * (begin_rad + end_rad)
        middle = place + cmath.rect(radius_m, middle_rad)
        if 0.0 < middle.real < length_m and abs(middle.imag) < half_m:
            found.append((middle_rad, 0.5 * (end_rad - begin_rad)))
    return found
