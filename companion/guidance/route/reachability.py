"""Whether there is a way between two points at all, and which points on the edges of obstacles are nearest to a place.

Discs and bands are convex. So what they cover has a hole with one of two points in it, and not the other, if and only
if some closed chain of overlapping obstacles winds about one of the two an odd number of times more than about the
other. It is enough to look at the chains that one more overlap closes in a tree of overlaps.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from companion.guidance.route.scene import Obstacles
from companion.guidance.route.walls import Bands

BATCH = 64
"""Number of points looked at together, nearest first."""


class Shores:
    """The obstacles of a scene, to tell whether points outside all of them are in the same water.

    Water is a connected part of what is outside. Whether points are in the same takes as many operations as there are
    overlaps; a search would have to try everything to find that there is no way.
    """

    def __init__(self, obstacles: Obstacles, tolerance_m: float) -> None:
        """Find what overlaps, by more than twice the tolerance in metres."""
        entered_m = np.maximum(obstacles.radius_m - tolerance_m, 0.0)
        discs = (entered_m > 0.0).nonzero()[0]
        bands = obstacles.bands
        self._count = len(discs) + len(bands.half_m)
        self._legs = _links(obstacles.centre[discs], entered_m[discs], obstacles)
        first, second = self._legs[0], self._legs[1]
        self._tree = _forest(self._count, first.tolist(), second.tolist())

    @property
    def overlaps(self) -> int:
        """Number of overlaps."""
        return len(self._legs[0])

    def joined(self, start: complex, points: np.ndarray) -> np.ndarray:  # (P,) complex -> (P,) bool
        """Return which points are in the same water as the start; all of them must be outside all obstacles."""
        odd = self._odd(np.append(points, start))
        found: np.ndarray = ~(odd[:, :-1] != odd[:, -1:]).any(axis=0)
        return found

    def _odd(self, points: np.ndarray) -> np.ndarray:  # (P,) complex -> (L, P) bool
        """Return whether the chain that each overlap closes winds about each point an odd number of times."""
        first, second, *places = self._legs
        crossed = np.zeros((len(first), len(points)), dtype=bool)
        for begin, end in zip(places, places[1:], strict=False):
            crossed ^= _crosses_north_of(begin[:, np.newaxis], end[:, np.newaxis], points)
        potential = np.zeros((self._count, len(points)), dtype=bool)
        for node, parent, link in self._tree:
            np.logical_xor(potential[parent], crossed[link], out=potential[node])
        odd: np.ndarray = crossed ^ potential[first] ^ potential[second]
        return odd


def _links(
    centre: np.ndarray,  # (M,) complex
    entered_m: np.ndarray,  # (M,)
    obstacles: Obstacles,
) -> list[np.ndarray]:
    """Return the overlaps of M discs and of bands: first, second, and places along a line from one to the other.

    The line lies in the two obstacles; each begins or ends at the same place of an obstacle.
    """
    bands, count = obstacles.bands, len(centre)
    # Half of the pairs each way, so that no array is larger than it must be.
    first, second = np.triu_indices(count, 1)
    offset = centre[first] - centre[second]
    reach_m = entered_m[first] + entered_m[second]
    close = (offset.real * offset.real + offset.imag * offset.imag < reach_m * reach_m).nonzero()[0]
    first, second = first[close], second[close]
    columns = [[first, second, centre[first], centre[second], centre[second], centre[second]]]
    if len(bands.half_m):
        nearest = bands.nearest(centre[:, np.newaxis])  # (M, E)
        disc, band = (np.abs(nearest - centre[:, np.newaxis]) < entered_m[:, np.newaxis] + bands.half_m).nonzero()
        place = nearest[disc, band]
        columns.append([disc, count + band, centre[disc], place, place, bands.begin[band]])
        columns.append(_crossings(obstacles, count))
    return [np.concatenate(column) for column in zip(*columns, strict=True)]


def _crossings(obstacles: Obstacles, from_index: int) -> list[np.ndarray]:
    """Return the overlaps of bands as `_links` does; their indices begin at `from_index`."""
    bands = obstacles.bands
    first, second = np.triu_indices(len(bands.half_m), 1)
    one, two = bands.take(first), bands.take(second)
    one_end, two_end = one.begin + one.length_m * one.ahead, two.begin + two.length_m * two.ahead
    # The least distance of two edges is at an end of one of them, unless they cross.
    on_one = np.stack((one.begin, one_end, one.nearest(two.begin), one.nearest(two_end)))
    on_two = np.stack((two.nearest(one.begin), two.nearest(one_end), two.begin, two_end))
    best = np.abs(on_one - on_two).argmin(axis=0)
    rows = np.arange(len(first))
    from_place, to_place = on_one[best, rows], on_two[best, rows]
    along_m, crossing = _cut(one, two)
    cut = one.begin + along_m * one.ahead
    from_place, to_place = np.where(crossing, cut, from_place), np.where(crossing, cut, to_place)
    close = crossing | (np.abs(from_place - to_place) < one.half_m + two.half_m)
    columns = [first + from_index, second + from_index, one.begin, from_place, to_place, two.begin]
    return [column[close] for column in columns]


def _forest(count: int, first: list[int], second: list[int]) -> list[tuple[int, int, int]]:
    """Return trees of overlaps that span all obstacles: obstacle, the one before it, and overlap, from the roots on."""
    overlaps: list[list[tuple[int, int]]] = [[] for _ in range(count)]
    for link, (one, two) in enumerate(zip(first, second, strict=True)):
        overlaps[one].append((two, link))
        overlaps[two].append((one, link))
    reached = [False] * count
    tree: list[tuple[int, int, int]] = []
    for root in range(count):
        if reached[root]:
            continue
        reached[root] = True
        nodes = [root]
        for node in nodes:
            for other, link in overlaps[node]:
                if not reached[other]:
                    reached[other] = True
                    nodes.append(other)
                    tree.append((other, node, link))
    return tree


def _crosses_north_of(begin: np.ndarray, end: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return whether lines from `begin` to `end` cross the line from each point to the north; the arrays broadcast."""
    straddles = (begin.imag > points.imag) != (end.imag > points.imag)
    rise_m = end.imag - begin.imag
    slope = (end.real - begin.real) / np.where(rise_m == 0.0, 1.0, rise_m)
    found: np.ndarray = straddles & (begin.real + (points.imag - begin.imag) * slope > points.real)
    return found


def nearest_points(place: complex, obstacles: Obstacles) -> np.ndarray:  # (P,) complex
    """Return the points on edges of obstacles that may be the nearest free one to a place, nearest first.

    They are where the edge of an obstacle is nearest to the place, and where two edges meet. Many are not free.
    """
    centre, radius_m, bands = obstacles.centre, obstacles.radius_m, obstacles.bands
    real = radius_m > 0.0
    centre, radius_m = centre[real], radius_m[real]
    offset = place - centre
    gap_m = np.abs(offset)
    towards = np.where(gap_m > 0.0, offset / np.where(gap_m > 0.0, gap_m, 1.0), 1.0)
    found = [centre + radius_m * towards, _meetings(centre, radius_m)]
    if len(bands.half_m):
        sides = bands.take(np.tile(np.arange(len(bands.half_m)), 2))
        shift = np.repeat((1j, -1j), len(bands.half_m)) * sides.half_m
        sides = sides._replace(begin=sides.begin + shift * sides.ahead)
        found += [sides.nearest(place), _on_sides(sides, centre, radius_m), _side_meetings(sides)]
    points = np.concatenate(found)
    return points[np.argsort(np.abs(points - place), kind="stable")]


def _meetings(centre: np.ndarray, radius_m: np.ndarray) -> np.ndarray:  # (M,) complex, (M,) -> (P,) complex
    """Return where the edges of discs meet."""
    first, second = np.triu_indices(len(centre), 1)
    offset = centre[second] - centre[first]
    gap_m2 = offset.real * offset.real + offset.imag * offset.imag
    one_m, two_m = radius_m[first], radius_m[second]
    meets = (gap_m2 <= (one_m + two_m) ** 2) & (gap_m2 >= (one_m - two_m) ** 2) & (gap_m2 > 0.0)
    first, offset, gap_m2, one_m, two_m = first[meets], offset[meets], gap_m2[meets], one_m[meets], two_m[meets]
    share = 0.5 + 0.5 * (one_m * one_m - two_m * two_m) / gap_m2
    aside = 1j * np.sqrt(np.maximum(one_m * one_m / gap_m2 - share * share, 0.0))
    return np.concatenate((centre[first] + offset * (share + aside), centre[first] + offset * (share - aside)))


def _on_sides(sides: Bands, centre: np.ndarray, radius_m: np.ndarray) -> np.ndarray:
    """Return where the sides of bands meet the edges of discs, (M,) complex and (M,) m."""
    inwards = (centre[:, np.newaxis] - sides.begin) * sides.ahead.conj()  # (M, E)
    chord_m2 = (radius_m**2)[:, np.newaxis] - inwards.imag**2
    disc, side = (chord_m2 >= 0.0).nonzero()
    chord_m = np.sqrt(chord_m2[disc, side])
    found = []
    for along_m in (inwards.real[disc, side] - chord_m, inwards.real[disc, side] + chord_m):
        on = (along_m >= 0.0) & (along_m <= sides.length_m[side])
        found.append((sides.begin[side] + along_m * sides.ahead[side])[on])
    return np.concatenate(found)


def _side_meetings(sides: Bands) -> np.ndarray:
    """Return where the sides of bands meet each other."""
    first, second = np.triu_indices(len(sides.begin), 1)
    one = sides.take(first)
    along_m, meets = _cut(one, sides.take(second))
    found: np.ndarray = (one.begin + along_m * one.ahead)[meets]
    return found


def _cut(one: Bands, two: Bands) -> tuple[np.ndarray, np.ndarray]:  # (P,) m, (P,) bool
    """Return for pairs of edges how far along the first one the lines of both meet, and whether the edges do."""
    sine = (one.ahead.conj() * two.ahead).imag
    offset = (two.begin - one.begin).conj()
    nonzero = np.where(sine == 0.0, 1.0, sine)
    along_m, other_m = (offset * two.ahead).imag / nonzero, (offset * one.ahead).imag / nonzero
    meets = (sine != 0.0) & (along_m >= 0.0) & (along_m <= one.length_m)
    return along_m, meets & (other_m >= 0.0) & (other_m <= two.length_m)


def free_of(points: np.ndarray, obstacles: Obstacles, tolerance_m: float) -> np.ndarray:  # (P,) complex -> (P,) bool
    """Return which points are inside no obstacle by more than the tolerance, in metres."""
    offset = obstacles.centre - points[:, np.newaxis]
    entered_m = np.maximum(obstacles.radius_m - tolerance_m, 0.0)
    free: np.ndarray = ~(offset.real**2 + offset.imag**2 < entered_m**2).any(axis=1)
    bands = obstacles.bands
    if len(bands.half_m):
        apart_m = np.abs(bands.nearest(points[:, np.newaxis]) - points[:, np.newaxis])
        free &= ~(apart_m < bands.half_m - tolerance_m).any(axis=1)
    return free


def batches(points: np.ndarray) -> Iterator[np.ndarray]:
    """Yield points in batches that are looked at together."""
    for begin in range(0, len(points), BATCH):
        yield points[begin : begin + BATCH]
