"""The route past discs that are smaller than a turn, whose wide arcs would close the gaps between them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.guidance.route.plan import Plan, Way
from companion.guidance.route.router import Departure, Reach, Route, Router, shortest_route
from companion.guidance.route.walls import NO_WALLS, Walls
from tests.companion.guidance.test_route import arrival, depth_m, flown, scenes, unit

TURN_M = 155.0
RADIUS_M = 113.0


def barrier(gap_m: float, slant: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return centres and radii of overlapping discs in a line across the way, with a gap at its middle."""
    half_m = RADIUS_M + 0.5 * gap_m
    aside_m = half_m + 150.0 * np.arange(8)
    east_m = np.concatenate((-aside_m[::-1], aside_m))
    return np.stack((1000.0 + slant * east_m, east_m), axis=-1), np.full(16, RADIUS_M)


def without_touching(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Plan, "_tighter", lambda *_: None)


@pytest.mark.parametrize("gap_m", [1.0, 20.0, 49.0, 120.0])
@pytest.mark.parametrize("slant", [0.0, 0.2])
def test_a_gap_between_discs_smaller_than_a_turn_is_flown_through(gap_m: float, slant: float) -> None:
    centres, radii = barrier(gap_m, slant)
    route = shortest_route((0.0, 60.0), (2000.0, 90.0), centres, radii, 0.3, TURN_M)
    assert route.length_m < 1.02 * math.hypot(2000.0, 30.0)
    assert depth_m(flown(route), centres, radii) < 1e-6 * RADIUS_M
    assert max(abs(piece.curvature_1_m) for piece in route.pieces) <= (1.0 + 1e-9) / TURN_M


def test_the_gap_is_taken_where_it_is_the_only_way() -> None:
    angles = np.arange(12) * math.tau / 12 + 0.2
    ring = 500.0 * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    radii = np.full(12, 140.0)
    radii[3] = radii[4] = 110.0  # the neighbours leave a gap of 38 m
    route = shortest_route((0.0, 1500.0), (0.0, 0.0), ring, radii, -math.pi / 2.0, 150.0)
    assert route.reach is Reach.TARGET
    assert depth_m(flown(route), ring, radii) < 1e-4
    assert max(abs(piece.curvature_1_m) for piece in route.pieces) <= (1.0 + 1e-9) / 150.0


def test_corners_of_an_exclusion_are_passed_close_by() -> None:
    box = ((900.0, -200.0), (1100.0, -200.0), (1100.0, 200.0), (900.0, 200.0))
    route = shortest_route(
        (0.0, 0.0), (2000.0, 0.0), np.zeros((0, 2)), np.zeros(0), 0.0, 150.0, Walls((), (box,), 10.0)
    )
    unlimited = shortest_route((0.0, 0.0), (2000.0, 0.0), np.zeros((0, 2)), np.zeros(0), walls=Walls((), (box,), 10.0))
    assert route.length_m < 1.01 * unlimited.length_m


def small_discs(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """Return start, goal, centres, radii and heading of a scene whose discs are smaller than a turn of 120 m."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 40))
    centres, radii = rng.uniform(0.0, 2000.0, (count, 2)), 120.0 * rng.uniform(0.1, 1.0, count)
    start, goal = rng.uniform((-300.0, 0.0), (100.0, 2000.0)), rng.uniform((1900.0, 0.0), (2300.0, 2000.0))
    assume((np.linalg.norm(centres - start, axis=-1) > radii + 250.0).all())
    assume((np.linalg.norm(centres - goal, axis=-1) > 130.0).all())
    return start, goal, centres, radii, float(rng.uniform(0.0, math.tau))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 1_000_000))
def test_past_small_discs_it_turns_within_the_limit_enters_nothing_and_is_no_longer(seed: int) -> None:
    start, goal, centres, radii, heading_rad = small_discs(seed)
    route = shortest_route(start, goal, centres, radii, heading_rad, 120.0)
    with pytest.MonkeyPatch.context() as patch:
        without_touching(patch)
        around = shortest_route(start, goal, centres, radii, heading_rad, 120.0)
    assert route.reach is around.reach
    assert route.length_m <= around.length_m
    if route.reach is Reach.TARGET:
        assert route.length_m >= shortest_route(start, goal, centres, radii).length_m * (1.0 - 1e-9)
        points = flown(route)  # asserts that each piece begins where the one before ended, with its heading
        assert depth_m(points, centres, radii) < 1e-5
        assert math.dist(points[-1], goal) < 1e-4
        assert max(abs(piece.curvature_1_m) for piece in route.pieces) <= (1.0 + 1e-9) / 120.0


@pytest.mark.parametrize("turn_radius_m", [0.0, 1.5])
def test_past_discs_no_smaller_than_a_turn_nothing_changes(
    turn_radius_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = list(scenes("random", 30, seed=4))
    found = [shortest_route(*scene, 0.4, turn_radius_m) for scene in drawn]
    without_touching(monkeypatch)
    assert found == [shortest_route(*scene, 0.4, turn_radius_m) for scene in drawn]


def steps(ids: list[np.ndarray], drift_m: float = 0.0) -> list[Route]:
    """Return the routes of steps towards a gap, with the discs in the order of `ids` at each."""
    centres, radii = barrier(20.0)
    router, routes = Router(), []
    place, heading_rad = np.array([0.0, 60.0]), 0.0
    for number, order in enumerate(ids):
        moved = (centres + (number * drift_m, 0.0))[order]
        departure = Departure(place, heading_rad, TURN_M)
        routes.append(router.route(departure, (2000.0, 90.0), moved, radii[order], order, NO_WALLS))
        place, heading_rad = place + 10.0 * unit(routes[-1].heading_rad), routes[-1].heading_rad
    return routes


def test_a_way_through_a_gap_is_kept_from_step_to_step() -> None:
    order = np.arange(16)
    routes = steps([order] * 12)
    for before, after in zip(routes[1:], routes[2:], strict=False):
        assert after.via == before.via != ()
        assert after.length_m == pytest.approx(before.length_m - 10.0, abs=1e-3)


def test_a_way_through_a_gap_is_kept_when_the_discs_are_renumbered(monkeypatch: pytest.MonkeyPatch) -> None:
    order, touched, along = np.arange(16), [], Plan.along

    def seen(
        self: Plan, way: Way, via: tuple[tuple[int, int], ...], touch: dict[int, complex], legs: int | None = None
    ) -> Way | None:
        touched.append(touch)
        return along(self, way, via, touch, legs)

    monkeypatch.setattr(Plan, "along", seen)
    routes = steps([order, order, order, order[::-1], order[::-1]])
    assert routes[4].length_m == pytest.approx(routes[2].length_m - 20.0, abs=1e-3)
    assert routes[3].via == tuple((15 - disc, side) for disc, side in routes[2].via) != ()
    assert touched[2] == {15 - disc: towards for disc, towards in touched[1].items()} != {}


def test_a_way_through_a_gap_is_kept_while_the_discs_drift() -> None:
    routes = steps([np.arange(16)] * 12, drift_m=0.5)
    assert all(route.via == routes[1].via for route in routes[1:])
    assert all(route.length_m < 2020.0 for route in routes)


@pytest.mark.parametrize("step_m", [3.0, 10.0])
def test_a_gap_is_flown_through_step_by_step(step_m: float) -> None:
    centres, radii = barrier(20.0)
    scene = (np.array([0.0, 400.0]), np.array([2000.0, 500.0]), centres, radii)
    arrived, flown_m, deepest_m, first = arrival(scene[0], 0.0, scene, TURN_M, step_m)
    assert arrived
    assert flown_m < 1.01 * first.length_m < 1.2 * 2000.0
    assert deepest_m <= 1e-3 * step_m
