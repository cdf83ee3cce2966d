"""What is joined and which points are nearest, against the filling of a grid."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from companion.guidance.route.reachability import Shores, free_of, nearest_points
from companion.guidance.route.scene import Obstacles
from companion.guidance.route.walls import Walls, WallSet
from tests.companion.guidance.test_route import RING
from tests.companion.guidance.test_route_walls import apart_m, edges_of, star

SIDE_M = 100.0
CELLS = 201


def obstacles_of(centres: np.ndarray, radii: np.ndarray, walls: Walls) -> Obstacles:
    """Return discs (M, 2), (M,) and walls as obstacles."""
    prepared = WallSet(walls)
    return Obstacles(
        np.concatenate((centres[:, 0] + 1j * centres[:, 1], prepared.corner)),
        np.append(radii, np.full(len(prepared.corner), walls.clearance_m)),
        prepared.bands(walls.clearance_m, len(radii), []),
    )


def waters(centres: np.ndarray, radii: np.ndarray, walls: Walls) -> tuple[np.ndarray, np.ndarray]:
    """Return grid points (P, 2) and the number of the connected free region of each; 0 in an obstacle."""
    axis = np.linspace(-SIDE_M, SIDE_M, CELLS)
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    free = (np.linalg.norm(points[:, None] - centres, axis=-1) >= radii).all(axis=1)
    free &= (apart_m(points, edges_of(walls)) >= walls.clearance_m).all(axis=1)
    labels, _ = ndimage.label(free.reshape(CELLS, CELLS))
    return points, labels.ravel()


def scene_of(seed: int) -> tuple[np.ndarray, np.ndarray, Walls]:
    """Return discs and walls that part a square, all of them a grid's cell and more away from touching or not."""
    rng = np.random.default_rng(seed)
    exclusions = tuple(star(rng, rng.uniform(-60.0, 60.0, 2), 50.0) for _ in range(3))
    return rng.uniform(-80.0, 80.0, (14, 2)), rng.uniform(6.0, 22.0, 14), Walls((), exclusions, 2.0)


@pytest.mark.parametrize("seed", range(8))
def test_points_are_joined_as_a_flood_between_them_says(seed: int) -> None:
    centres, radii, walls = scene_of(seed)
    # A flood over cells flows through no gap that is narrower than a cell; so two scenes bound what is joined.
    points, narrow = waters(centres, radii + 0.8, walls._replace(clearance_m=2.8))
    _, wide = waters(centres, radii - 0.8, walls._replace(clearance_m=1.2))
    free = np.random.default_rng(seed).choice(np.flatnonzero(narrow), 40, replace=False)
    shores = Shores(obstacles_of(centres, radii, walls), 1e-9)
    places = points[free] @ np.array([1.0, 1j])
    for start, place in zip(free.tolist(), places.tolist(), strict=True):
        joined = shores.joined(place, places)
        assert joined[narrow[free] == narrow[start]].all()
        assert not joined[wide[free] != wide[start]].any()


def test_an_open_ring_is_joined_with_its_inside_and_a_closed_one_is_not() -> None:
    inside, outside = 0j, np.array([100.0 + 0j, 3.0 + 60j, 5j])
    closed = Obstacles(RING[0] @ np.array([1.0, 1j]), RING[1])
    assert Shores(closed, 1e-9).joined(inside, outside).tolist() == [False, False, True]
    opened = Obstacles(closed.centre[1:], closed.radius_m[1:])
    assert Shores(opened, 1e-9).joined(inside, outside).all()


def test_a_ring_within_a_ring_parts_the_water_in_three() -> None:
    inner = RING[0] @ np.array([1.0, 1j])
    rings = Obstacles(np.concatenate((inner, 3.0 * inner)), np.concatenate((RING[1], 3.0 * RING[1])))
    places = np.array([0j, 62j, 300j])
    assert [Shores(rings, 1e-9).joined(place, places).tolist() for place in places] == np.eye(3, dtype=bool).tolist()


@pytest.mark.parametrize("gap_m, joined", [(1e-3, True), (-1e-3, False)])
def test_a_millimetre_decides_between_discs_of_twenty_kilometres(gap_m: float, joined: bool) -> None:
    walls = Walls(((-3e4, -1e5), (3e4, -1e5), (3e4, 1e5), (-3e4, 1e5)), (), 10.0)
    radius_m = 2e4
    centres = np.array([[-3e4 + 10.0 + gap_m + radius_m, 0.0], [3e4 - 10.0 - radius_m + 1.0, 0.0]])
    shores = Shores(obstacles_of(centres, np.full(2, radius_m), walls), 1e-9 * 1e5)
    assert shores.joined(complex(0.0, -9e4), np.array([complex(0.0, 9e4)]))[0] == joined


@pytest.mark.slow
@settings(max_examples=30)
@given(seed=st.integers(0, 10_000))
def test_no_free_point_of_a_grid_is_nearer_than_the_nearest_free_candidate(seed: int) -> None:
    centres, radii, walls = scene_of(seed)
    obstacles = obstacles_of(centres, radii, walls)
    points, water = waters(centres, radii, walls)
    place = points[np.random.default_rng(seed).choice(np.flatnonzero(water == 0))]
    candidates = nearest_points(complex(*place), obstacles)
    nearest = candidates[free_of(candidates, obstacles, 1e-6)][0]
    nearest_m = np.linalg.norm(points[water > 0] - place, axis=1).min()
    assert abs(nearest - complex(*place)) <= nearest_m + 1e-6
    assert nearest_m <= abs(nearest - complex(*place)) + 20.0 * SIDE_M / CELLS or math.isinf(nearest_m)
