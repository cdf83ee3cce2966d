"""The route inside a fence and around exclusion polygons: against a yardstick of its own, and flown along."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import dijkstra

from companion.geo.kinematics import shorter_turn_rad, turn_towards
from companion.guidance.route.router import Departure, Goal, Reach, Route, Router, shortest_route
from companion.guidance.route.walls import Polygon, Walls
from sim.shortest_path import shortest_path_length, walls_of
from tests.companion.guidance.test_route import NO_DISCS, Scene, depth_m, flown, unit

SQUARE = ((-100.0, -100.0), (100.0, -100.0), (100.0, 100.0), (-100.0, 100.0))
L_SHAPE = ((0.0, 0.0), (100.0, 0.0), (100.0, 30.0), (30.0, 30.0), (30.0, 100.0), (0.0, 100.0))


def polygons_of(walls: Walls) -> list[np.ndarray]:
    """Return the corners (V, 2) of each polygon, m."""
    return [np.array(polygon, dtype=float) for polygon in (walls.fence, *walls.exclusions) if polygon]


def edges_of(walls: Walls) -> np.ndarray:
    """Return the edges (E, 2, 2) of all polygons, m."""
    stacked: np.ndarray = np.concatenate(
        [np.stack((polygon, np.roll(polygon, -1, axis=0)), axis=1) for polygon in polygons_of(walls)]
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
    count, edges = 32, edges_of(walls)
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


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
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
        if not legal or checked == 3:
            continue
        checked += 1
        route = shortest_route(start, goal, centres, radii, walls=walls)
        wanted_m = yardstick_m(start, goal, (centres, radii), walls)
        if math.isinf(wanted_m):
            assert route.reach is Reach.NEAREST
            continue
        assert route.reach is Reach.TARGET
        assert route.length_m <= wanted_m * (1.0 + 1e-9)
        assert wanted_m <= route.length_m * (1.0 + 6e-3)
        assert clearance_m(route, walls) > walls.clearance_m - 1e-6
        assert depth_m(flown(route), centres, radii) < 1e-6
    assert checked


@pytest.mark.parametrize("goal", [(130.0, 20.0), (98.0, 20.0), (100.0, 20.0)])
def test_a_goal_beyond_the_fence_or_at_it_is_replaced_by_the_nearest_place_inside(goal: tuple[float, float]) -> None:
    route = shortest_route((0.0, 0.0), goal, *NO_DISCS, walls=Walls(SQUARE, (), 5.0))
    assert route.reach is Reach.NEAREST
    assert route.goal_ned_m == pytest.approx((95.0, 20.0))


def test_a_goal_in_a_corner_of_the_fence_is_replaced_by_the_place_at_the_clearance_from_both_edges() -> None:
    route = shortest_route((0.0, 0.0), (99.0, 98.0), *NO_DISCS, walls=Walls(SQUARE, (), 5.0))
    assert route.goal_ned_m == pytest.approx((95.0, 95.0))


def test_a_goal_inside_an_exclusion_is_replaced_by_the_nearest_place_outside() -> None:
    route = shortest_route((0.0, 0.0), (60.0, 5.0), *NO_DISCS, walls=Walls((), (SQUARE,), 5.0))
    assert route.reach is Reach.NEAREST
    assert route.goal_ned_m == pytest.approx((105.0, 5.0))


@pytest.mark.parametrize("as_fence", [True, False])
def test_from_the_wrong_side_of_a_wall_the_first_direction_leads_straight_across_it(as_fence: bool) -> None:
    start, goal = ((130.0, 20.0), (-50.0, 90.0)) if as_fence else ((70.0, 20.0), (0.0, 190.0))
    walls = Walls(SQUARE, (), 5.0) if as_fence else Walls((), (SQUARE,), 5.0)
    route = shortest_route(start, goal, *NO_DISCS, 2.0, 10.0, walls)
    assert route.reach is Reach.TARGET
    assert math.cos(route.heading_rad) == pytest.approx(-1.0 if as_fence else 1.0)


@pytest.mark.parametrize("depth_m", [0.1, 1.0, 4.9, 5.0])
def test_within_the_clearance_of_a_wall_the_first_direction_leads_away_from_it(depth_m: float) -> None:
    route = shortest_route((-95.0 - depth_m, 0.0), (-95.0, 80.0), *NO_DISCS, 1.5, 10.0, Walls(SQUARE, (), 5.0))
    assert route.reach is Reach.TARGET
    least = min(1.0, depth_m / 2.5)
    assert math.sin(0.5 * math.pi * least) - 1e-6 <= math.cos(route.heading_rad) <= 1.0


def test_discs_that_reach_to_the_fence_leave_only_the_way_past_their_other_end() -> None:
    walls = Walls(((-300.0, -300.0), (1300.0, -300.0), (1300.0, 300.0), (-300.0, 300.0)), (), 10.0)
    centres, radii = np.array([[500.0, 260.0], [500.0, 120.0], [500.0, -20.0]]), np.full(3, 80.0)
    route = shortest_route((0.0, 200.0), (1000.0, 200.0), centres, radii, walls=walls)
    assert (route.reach, route.via[0][0]) == (Reach.TARGET, 2)
    assert clearance_m(route, walls) > 10.0 - 1e-6
    closed = shortest_route((0.0, 200.0), (1000.0, 200.0), centres, np.array([80.0, 80.0, 280.0]), walls=walls)
    assert closed.reach is Reach.NEAREST


@pytest.mark.parametrize("gap_m, reach", [(9.0, Reach.NEAREST), (11.0, Reach.TARGET)])
def test_a_gap_between_walls_is_open_from_twice_the_clearance(gap_m: float, reach: Reach) -> None:
    left = ((0.0, -60.0), (0.0, -0.5 * gap_m), (10.0, -0.5 * gap_m), (10.0, -60.0))
    right = tuple((north_m, -east_m) for north_m, east_m in left)
    fence = ((-50.0, -40.0), (60.0, -40.0), (60.0, 40.0), (-50.0, 40.0))
    route = shortest_route((-30.0, 0.0), (40.0, 0.0), *NO_DISCS, walls=Walls(fence, (left, right), 5.0))
    assert route.reach is reach


@pytest.mark.parametrize(
    "polygon",
    [
        ((50.0, 0.0), (50.0, 0.0), (50.0, 0.0)),
        ((50.0, -5.0), (50.0, 5.0)),
        ((50.0, -5.0), (50.0, -5.0), (50.0, 5.0), (50.0, 5.0), (50.0, -5.0)),
        ((50.0, 0.0), (50.0, 5.0), (50.0, 0.0), (50.0, -5.0)),
    ],
)
def test_polygons_of_no_area_are_gone_around_like_others(polygon: Polygon) -> None:
    walls = Walls((), (polygon,), 3.0)
    route = shortest_route((0.0, 0.0), (100.0, 0.0), *NO_DISCS, walls=walls)
    assert route.reach is Reach.TARGET
    assert clearance_m(route, walls) == pytest.approx(3.0, abs=1e-6)


@pytest.mark.parametrize("clearance_m", [0.0, -1.0])
def test_walls_without_a_clearance_are_not_crossed(clearance_m: float) -> None:
    route = shortest_route((0.0, 0.0), (200.0, 0.0), *NO_DISCS, walls=Walls(SQUARE, (), clearance_m))
    assert route.reach is Reach.NEAREST
    assert route.goal_ned_m == pytest.approx((100.0, 0.0), abs=1e-2)


@pytest.mark.parametrize("walls", [Walls(((math.nan, 0.0), (1.0, 0.0), (0.0, 1.0))), Walls(SQUARE, (), math.inf)])
def test_walls_that_are_not_finite_are_refused(walls: Walls) -> None:
    with pytest.raises(ValueError, match="finite"):
        shortest_route((0.0, 0.0), (1.0, 0.0), *NO_DISCS, walls=walls)


def test_a_router_plans_again_when_the_walls_change() -> None:
    router, ids = Router(), np.zeros(0, dtype=int)
    box = ((40.0, -10.0), (60.0, -10.0), (60.0, 30.0), (40.0, 30.0))
    goal, at = (100.0, 0.0), Departure((0.0, 0.0))
    assert router.route(at, goal, *NO_DISCS, ids).length_m == pytest.approx(100.0)
    walls = Walls((), (box,), 3.0)
    around = router.route(at, goal, *NO_DISCS, ids, walls)
    assert clearance_m(around, walls) > 3.0 - 1e-6
    assert router.route(at, goal, *NO_DISCS, ids, walls) == around
    assert router.route(at, goal, *NO_DISCS, ids).length_m == pytest.approx(100.0)


@pytest.mark.parametrize("heading_rad", [0.0, 2.0, 4.0])
def test_flown_step_by_step_between_walls_it_arrives_and_keeps_the_clearance(heading_rad: float) -> None:
    walls = Walls(tuple((30.0 * north_m, 30.0 * east_m) for north_m, east_m in L_SHAPE), (), 150.0)
    router, ids, goal = Router(), np.zeros(0, dtype=int), (450.0, 2_700.0)
    state, nearest_m, calls = (2_500.0, 450.0, heading_rad), math.inf, 0
    while math.dist(state[:2], goal) > 50.0:
        calls += 1
        assert calls < 400
        route = router.route(Departure(state[:2], state[2], 100.0), goal, *NO_DISCS, ids, walls)
        wanted_rad = route.heading_rad
        if route.turn * shorter_turn_rad(state[2], wanted_rad) < 0.0:
            wanted_rad = state[2] + route.turn * math.pi / 2.0
        for _ in range(4):
            state = turn_towards(*state[:2], state[2], 1.0, wanted_rad, 0.01, 5.0)
            nearest_m = min(nearest_m, float(apart_m(np.array([state[:2]]), edges_of(walls)).min()))
    assert nearest_m > 150.0 - 0.5


@pytest.mark.slow
@settings(max_examples=300)
@given(seed=st.integers(0, 1_000_000))
def test_the_length_is_that_of_the_planner_of_the_arena(seed: int) -> None:
    rng = np.random.default_rng(seed)
    fence = star(rng, np.zeros(2), 250.0) if rng.random() < 0.6 else ()
    exclusions = tuple(star(rng, rng.uniform(-150.0, 150.0, 2), 50.0) for _ in range(int(rng.integers(1, 4))))
    walls = Walls(fence, exclusions, float(rng.choice([0.5, 2.0, 6.0])))
    centres, radii = rng.uniform(-150.0, 150.0, (9, 2)), 10.0 ** rng.uniform(0.0, 1.7, 9)
    start, goal = rng.uniform(-180.0, 180.0, (2, 2))
    wanted_m = shortest_path_length(start, goal, centres, radii, walls_of(polygons_of(walls), walls.clearance_m))
    route = shortest_route(start, goal, centres, radii, walls=walls)
    if math.isfinite(wanted_m) and route.reach is Reach.TARGET:
        assert route.length_m == pytest.approx(wanted_m, rel=1e-6)
    elif depth_m(np.array([start, goal]), centres, radii) < 0.0:
        # What is outside the fence or too near to a wall the planner of the arena judges otherwise.
        ends_m = apart_m(np.array([start, goal]), edges_of(walls)).min()
        outside = [not inside((float(end[0]), float(end[1])), fence) for end in (start, goal)] if fence else [False]
        within = [inside((float(end[0]), float(end[1])), box) for box in exclusions for end in (start, goal)]
        assert (ends_m < walls.clearance_m) or any(outside + within) or math.isinf(wanted_m)


corner = st.tuples(st.integers(-8, 8).map(float), st.integers(-8, 8).map(float))


@st.composite
def walled_scenes(draw: st.DrawFn) -> tuple[Scene, Walls]:
    """Draw discs and polygons at corners of a grid, so that they often touch, overlap and coincide."""
    discs = draw(st.lists(st.tuples(corner, st.sampled_from([0.0, 1.0, 2.0, 4.0])), max_size=5))
    fence = draw(st.one_of(st.just(()), st.lists(corner, min_size=3, max_size=6).map(tuple)))
    exclusions = draw(st.lists(st.lists(corner, min_size=1, max_size=5).map(tuple), max_size=3))
    walls = Walls(fence, tuple(exclusions), draw(st.sampled_from([0.0, 0.25, 1.0])))
    centres = np.array([centre for centre, _ in discs], dtype=float).reshape(-1, 2)
    ends = np.array([draw(corner), draw(corner)])
    return (ends[0], ends[1], centres, np.array([radius for _, radius in discs], dtype=float)), walls


@pytest.mark.slow
@settings(max_examples=300)
@given(
    drawn=walled_scenes(),
    heading_rad=st.sampled_from([None, 0.0, 1.0, math.pi]),
    turn_radius_m=st.sampled_from([0.5, 2.0]),
    goal_radius_m=st.sampled_from([0.0, 1.0, 3.0]),
)
def test_every_finite_scene_with_walls_is_decided(
    drawn: tuple[Scene, Walls], heading_rad: float | None, turn_radius_m: float, goal_radius_m: float
) -> None:
    (start, goal, centres, radii), walls = drawn
    aim = Goal(goal, goal_radius_m)
    route = shortest_route(start, aim, centres, radii, heading_rad, turn_radius_m, walls)
    if route.reach is Reach.NONE:
        return
    assert math.isfinite(route.heading_rad)
    assert route.length_m >= math.dist(start, route.goal_ned_m) - goal_radius_m - 1e-6
    assert sum(piece.length_m for piece in route.pieces) == pytest.approx(route.length_m, rel=1e-6, abs=1e-6)
    if route.reach is Reach.NEAREST and (walls.fence or walls.exclusions):
        assert float(apart_m(np.array([route.goal_ned_m]), edges_of(walls)).min()) >= walls.clearance_m - 1e-6


@pytest.mark.slow
@settings(max_examples=60)
@given(
    seed=st.integers(0, 10_000),
    angle_rad=st.floats(0.1, 6.0),
    mirrored=st.booleans(),
    shift_m=st.sampled_from([0.0, 1e3, 1e6]),
)
def test_a_scene_turned_moved_or_mirrored_has_a_way_of_the_same_length(
    seed: int, angle_rad: float, mirrored: bool, shift_m: float
) -> None:
    rng = np.random.default_rng(seed)
    exclusions = [star(rng, rng.uniform(-80.0, 80.0, 2), 40.0) for _ in range(3)]
    fence = star(rng, np.zeros(2), 300.0)
    centres, radii = rng.uniform(-100.0, 100.0, (5, 2)), rng.uniform(5.0, 25.0, 5)
    start, goal = rng.uniform(-120.0, 120.0, (2, 2))
    flip = np.array([1.0, -1.0]) if mirrored else np.ones(2)
    turn = np.array([[math.cos(angle_rad), math.sin(angle_rad)], [-math.sin(angle_rad), math.cos(angle_rad)]])

    def moved(places: np.ndarray) -> np.ndarray:
        found: np.ndarray = (places * flip) @ turn + shift_m
        return found

    def polygon(places: Polygon) -> Polygon:
        return tuple((float(place[0]), float(place[1])) for place in moved(np.array(places)))

    plain = shortest_route(start, goal, centres, radii, walls=Walls(fence, tuple(exclusions), 4.0))
    walls = Walls(polygon(fence), tuple(map(polygon, exclusions)), 4.0)
    other = shortest_route(moved(start), moved(goal), moved(centres), radii, walls=walls)
    assert other.reach is plain.reach
    assert other.length_m == pytest.approx(plain.length_m, rel=1e-5, abs=1e-3)


def test_a_wall_ahead_that_cannot_be_avoided_is_approached_no_nearer_than_a_turn_must() -> None:
    walls = Walls(SQUARE, (), 5.0)
    route = shortest_route((85.0, 0.0), (-50.0, 3.0), *NO_DISCS, 0.0, 12.0, walls)
    assert (route.reach, route.turn) == (Reach.TARGET, 1)
    assert clearance_m(route, walls) == pytest.approx(3.0, abs=1e-2)


def test_on_the_fence_and_heading_out_no_arc_beyond_it_counts() -> None:
    route = shortest_route((-100.0, 0.0), (0.0, -50.0), *NO_DISCS, 0.5 * math.pi + 0.2, 10.0, Walls(SQUARE))
    assert route.reach is Reach.TARGET
    assert math.cos(route.heading_rad) > 0.0
    assert flown(route)[:, 0].min() > -100.0 - 1e-3
