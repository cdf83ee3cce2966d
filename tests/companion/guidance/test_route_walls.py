"""The route inside a fence and around exclusion polygons: against a yardstick of its own, and flown along."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from companion.guidance.route.router import Reach, Route, shortest_route
from companion.guidance.route.walls import Polygon, Walls
from tests.companion.guidance.test_route import NO_DISCS, depth_m, flown, unit

SQUARE = ((-100.0, -100.0), (100.0, -100.0), (100.0, 100.0), (-100.0, 100.0))
L_SHAPE = ((0.0, 0.0), (100.0, 0.0), (100.0, 30.0), (30.0, 30.0), (30.0, 100.0), (0.0, 100.0))


def edges_of(walls: Walls) -> np.ndarray:
    """Return the edges (E, 2, 2) of all polygons, m."""
    polygons = [np.array(polygon, dtype=float) for polygon in (walls.fence, *walls.exclusions) if polygon]
    stacked: np.ndarray = np.concatenate(
        [np.stack((polygon, np.roll(polygon, -1, axis=0)), axis=1) for polygon in polygons]
    )
    return stacked


def apart_m(points: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return the distances (P, E) of points (P, 2) to edges (E, 2, 2), m."""
    along = edges[:, 1] - edges[:, 0]
    offset = points[:, None] - edges[:, 0]
    share = np.clip((offset * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-30), 0.0, 1.0)
    found: np.ndarray = np.linalg.norm(offset - share[..., None] * along, axis=-1)
    return found


def crosses(begin: np.ndarray, end: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return (P, P, E), whether segments from each point to each point cross edges."""

    def turn(one: np.ndarray, two: np.ndarray, three: np.ndarray) -> np.ndarray:
        found: np.ndarray = (two[..., 0] - one[..., 0]) * (three[..., 1] - one[..., 1])
        found -= (two[..., 1] - one[..., 1]) * (three[..., 0] - one[..., 0])
        return found

    begin, end = begin[:, None, None], end[None, :, None]
    sides = turn(edges[:, 0], edges[:, 1], begin) * turn(edges[:, 0], edges[:, 1], end)
    found: np.ndarray = (sides < 0.0) & (turn(begin, end, edges[:, 0]) * turn(begin, end, edges[:, 1]) < 0.0)
    return found


def yardstick_m(start: np.ndarray, goal: np.ndarray, discs: tuple[np.ndarray, np.ndarray], walls: Walls) -> float:
    """Return the shortest way over points drawn about discs and corners: legal, hence never too short."""
    count, edges = 48, edges_of(walls)
    centres = np.vstack((discs[0], edges[:, 0]))
    radii = np.append(discs[1], np.full(len(edges), walls.clearance_m))
    turns = np.arange(count) * math.tau / count
    ring = np.stack((np.cos(turns), np.sin(turns)), axis=-1) / math.cos(math.pi / count)
    points = np.vstack((start[None], goal[None], (centres[:, None] + radii[:, None, None] * ring).reshape(-1, 2)))
    free = (np.linalg.norm(points[:, None] - discs[0], axis=-1) >= discs[1] - 1e-9).all(axis=1)
    free &= (apart_m(points, edges) >= walls.clearance_m - 1e-9).all(axis=1)
    points = points[free]
    along = points[None, :] - points[:, None]
    gap: np.ndarray = np.linalg.norm(along, axis=-1)
    for centre, radius in zip(centres, radii, strict=True):
        fraction = np.clip(((centre - points)[:, None] * along).sum(-1) / np.maximum(gap**2, 1e-12), 0.0, 1.0)
        miss = np.linalg.norm(points[:, None] + fraction[..., None] * along - centre, axis=-1)
        gap[miss < radius - 1e-6] = 0.0  # no edge
    gap[crosses(points, points, edges).any(axis=-1)] = 0.0
    return float(dijkstra(gap, indices=[0])[0, 1])


def clearance_m(route: Route, walls: Walls) -> float:
    return float(apart_m(flown(route), edges_of(walls)).min())


def inside(point: tuple[float, float], polygon: Polygon) -> bool:
    winding_rad = 0.0
    for one, two in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        first = math.atan2(one[1] - point[1], one[0] - point[0])
        second = math.atan2(two[1] - point[1], two[0] - point[0])
        winding_rad += math.remainder(second - first, math.tau)
    return abs(winding_rad) > 1.0


def star(rng: np.random.Generator, centre: np.ndarray, reach_m: float) -> Polygon:
    """Return a polygon about a centre, concave as often as not."""
    count = int(rng.integers(3, 9))
    angles = (np.arange(count) + rng.uniform(0.2, 0.8, count)) * math.tau / count
    return tuple(
        (float(place[0]), float(place[1]))
        for place in (centre + reach_m * rng.uniform(0.3, 1.0) * unit(angle) for angle in angles)
    )


def test_an_inner_corner_of_the_fence_is_gone_around_at_the_clearance() -> None:
    walls = Walls(L_SHAPE, (), 5.0)
    route = shortest_route((80.0, 15.0), (15.0, 80.0), *NO_DISCS, walls=walls)
    assert route.reach is Reach.TARGET
    assert clearance_m(route, walls) == pytest.approx(5.0, abs=1e-6)
    # Two tangents of the corner's circle, seen from 50 m north and 15 m west of it, and the arc between them.
    tangent_m = math.sqrt(50.0**2 + 15.0**2 - 5.0**2)
    bend_rad = 0.5 * math.pi - 2.0 * (math.atan2(15.0, 50.0) - math.asin(5.0 / math.hypot(50.0, 15.0)))
    assert route.length_m == pytest.approx(2.0 * tangent_m + 5.0 * bend_rad)


def test_an_exclusion_is_gone_around_on_the_shorter_side() -> None:
    walls = Walls((), (((40.0, -10.0), (60.0, -10.0), (60.0, 30.0), (40.0, 30.0)),), 3.0)
    route = shortest_route((0.0, 0.0), (100.0, 0.0), *NO_DISCS, walls=walls)
    assert [side for _, side in route.via] == [1, 1]
    assert route.length_m == pytest.approx(yardstick_m(np.zeros(2), np.array([100.0, 0.0]), NO_DISCS, walls), rel=1e-3)


@pytest.mark.parametrize("seed", range(12))
def test_the_length_around_discs_and_walls_is_the_yardsticks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    fence = star(rng, np.zeros(2), 200.0) if seed % 2 else ()
    exclusions = tuple(star(rng, rng.uniform(-80.0, 80.0, 2), 40.0) for _ in range(3))
    walls = Walls(fence, exclusions, float(rng.uniform(1.0, 6.0)))
    centres, radii = rng.uniform(-100.0, 100.0, (4, 2)), rng.uniform(5.0, 20.0, 4)
    checked = 0
    for _ in range(40):
        start, goal = rng.uniform(-100.0, 100.0, (2, 2))
        ends = np.stack((start, goal))
        legal = (apart_m(ends, edges_of(walls)) > walls.clearance_m).all()
        legal &= depth_m(ends, centres, radii) < 0.0
        for end in ends:
            place = (float(end[0]), float(end[1]))
            legal &= not fence or inside(place, fence)
            legal &= not any(inside(place, polygon) for polygon in exclusions)
        if not legal or checked == 4:
            continue
        checked += 1
        route = shortest_route(start, goal, centres, radii, walls=walls)
        wanted_m = yardstick_m(start, goal, (centres, radii), walls)
        if math.isinf(wanted_m):
            assert route.reach is Reach.NEAREST
            continue
        assert route.reach is Reach.TARGET
        assert route.length_m <= wanted_m * (1.0 + 1e-9)
        assert wanted_m <= route.length_m * (1.0 + 3e-3)
        assert clearance_m(route, walls) > walls.clearance_m - 1e-6
        assert depth_m(flown(route), centres, radii) < 1e-6
    assert checked
