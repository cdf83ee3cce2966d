"""Whether there is a way between two points at all: the free region around all discs, split into connected waters."""

from __future__ import annotations

import math

import numpy as np

from companion.guidance.route.scene import covered_stretches


class Shores:
    """The free arcs of all discs' edges, grouped by the water (connected free region) that they bound.

    Whether two points lie in the same water takes M^2 operations; a search would have to try everything to find that
    there is no way.
    """

    def __init__(self, centre: np.ndarray, radius_m: np.ndarray, tolerance_m: float) -> None:
        """Trace the edges of M discs: centres (M,) complex, north + i east, and radii (M,), both in metres."""
        self._centre, self._radius_m = centre, radius_m
        self._entered_m = np.maximum(radius_m - tolerance_m, 0.0)
        self._arcs: list[tuple[int, float, float]] = []  # disc, begin and sweep in radians, from north towards east
        for disc in (self._entered_m > 0.0).nonzero()[0].tolist():
            covered = covered_stretches(complex(centre[disc]), float(radius_m[disc]), centre, self._entered_m, disc)
            self._arcs.extend((disc, begin_rad, sweep_rad) for begin_rad, sweep_rad in _gaps(covered))
        self._sea = len(self._arcs)  # the face without an outer edge
        self._parent = list(range(self._sea + 1))  # a union-find over the arcs and the sea
        self._join_at_corners()
        for index, (disc, begin_rad, sweep_rad) in enumerate(self._arcs):
            if (-begin_rad) % math.tau <= sweep_rad:  # the disc's northernmost point lies on this arc
                self._join(index, self._first_north_of(self._point(disc, 0.0), disc))

    def joined(self, first: complex, second: complex) -> bool:
        """Return whether two points outside all discs lie in the same water, so that there is a way between them."""
        return self._face(self._first_north_of(first, None)) == self._face(self._first_north_of(second, None))

    def nearest(self, place: complex, start: complex | None) -> list[complex]:
        """Return each arc's point nearest to a place, nearest first; with a start, only those of arcs in its water."""
        face = None if start is None else self._face(self._first_north_of(start, None))
        points = []
        for index, (disc, begin_rad, sweep_rad) in enumerate(self._arcs):
            if face is not None and self._face(index) != face:
                continue
            offset = place - complex(self._centre[disc])
            beyond_rad = (math.atan2(offset.imag, offset.real) - begin_rad) % math.tau
            if beyond_rad > sweep_rad:
                beyond_rad = sweep_rad if beyond_rad - sweep_rad < math.tau - beyond_rad else 0.0
            points.append(self._point(disc, begin_rad + beyond_rad))
        return sorted(points, key=lambda point: abs(point - place))

    def _point(self, disc: int, angle_rad: float) -> complex:
        return complex(self._centre[disc]) + float(self._radius_m[disc]) * complex(
            math.cos(angle_rad), math.sin(angle_rad)
        )

    def _join_at_corners(self) -> None:
        """Join each arc with the one that begins where it ends."""
        if not self._arcs:
            return
        begin = np.array([self._point(disc, begin_rad) for disc, begin_rad, _ in self._arcs])
        end = np.array([self._point(disc, begin_rad + sweep_rad) for disc, begin_rad, sweep_rad in self._arcs])
        for index, after in enumerate(np.abs(end[:, np.newaxis] - begin).argmin(axis=1).tolist()):
            self._join(index, after)

    def _first_north_of(self, point: complex, without: int | None) -> int:
        """Return the index of the arc that a line from a point to the north meets first; that of the sea if none."""
        offset = self._centre - point
        half_m2 = self._entered_m**2 - offset.imag**2
        meets = (half_m2 > 0.0) & (offset.real > 0.0)
        if without is not None:
            meets[without] = False
        if not meets.any():
            return self._sea
        half_m = np.sqrt(np.maximum(half_m2, 0.0))
        disc = int(np.where(meets, offset.real - half_m, math.inf).argmin())
        angle_rad = math.atan2(-offset[disc].imag, -half_m[disc])
        best, found = math.inf, self._sea
        for index, (other, begin_rad, sweep_rad) in enumerate(self._arcs):
            if other == disc:
                beyond_rad = (angle_rad - begin_rad) % math.tau
                outside_rad = max(0.0, min(beyond_rad - sweep_rad, math.tau - beyond_rad))
                if outside_rad < best:
                    best, found = outside_rad, index
        return found

    def _face(self, index: int) -> int:
        while self._parent[index] != index:
            self._parent[index] = self._parent[self._parent[index]]
            index = self._parent[index]
        return index

    def _join(self, first: int, second: int) -> None:
        self._parent[self._face(first)] = self._face(second)


def _gaps(covered: list[tuple[float, float, int]]) -> list[tuple[float, float]]:
    """Return the free stretches of a circle between the covered ones, as (angle of its beginning, sweep) in radians."""
    if not covered:
        return [(0.0, math.tau)]
    spans = sorted(((middle_rad - half_rad) % math.tau, 2.0 * half_rad) for middle_rad, half_rad, _ in covered)
    first_rad = spans[0][0]
    gaps, reached_rad = [], first_rad
    for begin_rad, width_rad in [*spans, (first_rad + math.tau, 0.0)]:
        if begin_rad > reached_rad:
            gaps.append((reached_rad, begin_rad - reached_rad))
        reached_rad = max(reached_rad, begin_rad + width_rad)
    # A stretch that extends over north also covers the beginning.
    over_rad = max(begin_rad + width_rad for begin_rad, width_rad in spans) - math.tau
    return [
        (max(begin_rad, over_rad), begin_rad + sweep_rad - max(begin_rad, over_rad))
        for begin_rad, sweep_rad in gaps
        if begin_rad + sweep_rad > over_rad
    ]
