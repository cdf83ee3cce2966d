"""Routes that end on a circle about the goal, for vehicles that cannot stop."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from companion.guidance.route.router import Departure, Goal, Reach, Route, Router, shortest_route
from companion.guidance.route.walls import Walls
from tests.companion.guidance.test_route import NO_DISCS, depth_m, flown, unit


def end_of(route: Route) -> tuple[np.ndarray, float]:
    """Return the place and the heading at the end of a route."""
    last = route.pieces[-1]
    return flown(route)[-1], last.heading_rad + last.curvature_1_m * last.length_m


def off_the_circle(route: Route, radius_m: float) -> tuple[float, float]:
    """Return how far the end of a route is from the circle about its goal, and its heading from the tangent."""
    place, heading_rad = end_of(route)
    offset = place - np.array(route.goal_ned_m)
    tangent_rad = math.atan2(offset[1], offset[0]) + route.end_side * 0.5 * math.pi
    return abs(math.hypot(*offset) - radius_m), abs(math.remainder(heading_rad - tangent_rad, math.tau))


@pytest.mark.parametrize("heading_rad", [-3.0, -2.0, -0.3, 0.1, 0.3, 1.5, 3.0])
def test_the_route_ends_on_the_circle_on_the_side_that_is_shorter(heading_rad: float) -> None:
    lengths_m = {}
    for turn in (1, -1):
        centre = 10.0 * unit(heading_rad + turn * 0.5 * math.pi)
        gap_m, bearing_rad = math.dist(centre, (100.0, 0.0)), math.atan2(-centre[1], 100.0 - centre[0])
        for side in (1, -1):
            course_rad = bearing_rad - math.asin((20.0 * side - 10.0 * turn) / gap_m)
            line_m = math.sqrt(gap_m**2 - (20.0 * side - 10.0 * turn) ** 2)
            lengths_m[turn, side] = 10.0 * ((turn * (course_rad - heading_rad)) % math.tau) + line_m
    turn, side = min(lengths_m, key=lengths_m.__getitem__)
    route = shortest_route((0.0, 0.0), Goal((100.0, 0.0), 20.0), *NO_DISCS, heading_rad, 10.0)
    assert (route.reach, route.goal_ned_m, route.turn, route.end_side) == (Reach.TARGET, (100.0, 0.0), turn, side)
    assert route.length_m == pytest.approx(lengths_m[turn, side])
    assert off_the_circle(route, 20.0) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_without_discs_the_length_is_that_of_the_tangent() -> None:
    route = shortest_route((0.0, 0.0), Goal((100.0, 0.0), 60.0), *NO_DISCS)
    assert route.length_m == pytest.approx(80.0)
    assert abs(route.end_side) == 1
    assert route.via == ()


def test_a_place_as_goal_has_no_side_at_the_end() -> None:
    assert shortest_route((0.0, 0.0), (100.0, 0.0), *NO_DISCS).end_side == 0
    assert shortest_route((0.0, 0.0), Goal((100.0, 0.0)), *NO_DISCS).end_side == 0


@pytest.mark.parametrize("side", [1, -1])
def test_on_the_circle_along_it_there_is_nothing_left_to_fly(side: int) -> None:
    goal, heading_rad = (0.0, 0.0), 1.0
    place = 50.0 * unit(heading_rad - side * 0.5 * math.pi)
    route = shortest_route(place, Goal(goal, 50.0), *NO_DISCS, heading_rad, 20.0)
    assert (route.reach, route.end_side) == (Reach.TARGET, side)
    assert route.length_m == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("inside_m", [0.5, 20.0, 49.0, 50.0])
@pytest.mark.parametrize("heading_rad", [None, 0.3, 2.0, 4.0])
def test_from_inside_the_circle_it_ends_on_a_smaller_one_that_can_be_flown(
    inside_m: float, heading_rad: float | None
) -> None:
    goal = Goal((0.0, 0.0), 50.0)
    route = shortest_route((50.0 - inside_m, 0.0), goal, *NO_DISCS, heading_rad, 20.0)
    assert route.reach is Reach.TARGET
    assert math.isfinite(route.heading_rad)
    if heading_rad is not None:
        radius_m = math.hypot(*end_of(route)[0])
        assert 20.0 - 1e-6 <= radius_m <= 50.0 + 1e-6
        assert off_the_circle(route, radius_m) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_a_circle_about_a_place_inside_a_disc_is_reached_if_it_is_clear_itself() -> None:
    centres, radii = np.array([[100.0, 0.0]]), np.array([15.0])
    assert shortest_route((0.0, 0.0), (100.0, 0.0), centres, radii).reach is Reach.NEAREST
    assert shortest_route((0.0, 0.0), Goal((100.0, 0.0), 20.0), centres, radii).reach is Reach.TARGET


def test_a_circle_behind_closed_walls_is_replaced_by_the_nearest_place() -> None:
    box = ((70.0, -40.0), (150.0, -40.0), (150.0, 40.0), (70.0, 40.0))
    route = shortest_route((0.0, 0.0), Goal((100.0, 0.0), 20.0), *NO_DISCS, walls=Walls((), (box,), 2.0))
    assert (route.reach, route.end_side) == (Reach.NEAREST, 0)
    assert route.goal_ned_m == pytest.approx((68.0, 0.0))


def test_a_router_keeps_the_side_of_the_circle_while_the_other_is_hardly_shorter() -> None:
    router, ids = Router(), np.array([1])
    centres, radii = np.array([[60.0, 0.0]]), np.array([10.0])
    sides = [
        router.route(Departure((0.0, east_m)), Goal((100.0, 0.0), 20.0), centres, radii, ids).end_side
        for east_m in (-0.2, 0.2, 0.3, 0.1)
    ]
    assert len(set(sides)) == 1


@pytest.mark.slow
@settings(max_examples=60, suppress_health_check=[HealthCheck.filter_too_much])
@given(seed=st.integers(0, 100_000), turn_radius_m=st.sampled_from([1.0, 4.0]), radius_m=st.sampled_from([5.0, 12.0]))
def test_among_discs_the_end_is_tangent_and_no_way_to_a_place_on_the_circle_is_much_shorter(
    seed: int, turn_radius_m: float, radius_m: float
) -> None:
    rng = np.random.default_rng(seed)
    centres, radii = rng.uniform(0.0, 100.0, (10, 2)), rng.uniform(3.0, 14.0, 10)
    start, goal = rng.uniform(0.0, 100.0, (2, 2))
    room_m = np.linalg.norm(centres - goal, axis=-1) - radii
    assume((room_m > radius_m + 2.0 * turn_radius_m).all() and math.dist(start, goal) > radius_m)
    assume((np.linalg.norm(centres - start, axis=-1) > radii + 2.0 * turn_radius_m).all())
    heading_rad = rng.uniform(0.0, math.tau)
    route = shortest_route(start, Goal(goal, radius_m), centres, radii, heading_rad, turn_radius_m)
    places = [goal + radius_m * unit(angle_rad) for angle_rad in np.linspace(0.0, math.tau, 24, endpoint=False)]
    if route.reach is Reach.NEAREST:
        assert all(shortest_route(start, place, centres, radii).reach is Reach.NEAREST for place in places)
        return
    assert off_the_circle(route, radius_m) == pytest.approx((0.0, 0.0), abs=1e-4)
    assert depth_m(flown(route), centres, radii) < 1e-4
    assert max(abs(piece.curvature_1_m) for piece in route.pieces) <= (1.0 + 1e-9) / turn_radius_m
    free = [shortest_route(start, place, centres, radii).length_m for place in places]
    # From where a way meets the circle, half a turn along it and a turning circle come to its tangent.
    assert min(free) - 0.3 * radius_m <= route.length_m
    assert route.length_m <= min(free) + math.pi * radius_m + 2.0 * math.tau * turn_radius_m
