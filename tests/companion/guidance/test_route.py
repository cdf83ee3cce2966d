"""The route against independent planners, against brute force, and flown from step to step."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import dijkstra

from companion.geo.kinematics import advance, shorter_turn_rad, turn_towards
from companion.guidance.route.plan import DEEP_SHARE
from companion.guidance.route.router import Departure, Reach, Route, Router, shortest_route
from companion.guidance.route.scene import TURN_SLACK
from sim.shortest_path import shortest_path_length

FAMILIES = ("random", "dense", "grid", "nested", "duplicate", "tangent", "edge")
Scene = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Start (2,), goal (2,), centres (M, 2), radii (M,), all in metres."""

NO_DISCS = (np.zeros((0, 2)), np.zeros(0))
RING = (  # eight discs that overlap their neighbours about a free middle
    np.array([(40.0 * math.cos(k * math.pi / 4), 40.0 * math.sin(k * math.pi / 4)) for k in range(8)]),
    np.full(8, 17.0),
)


def unit(angle_rad: float) -> np.ndarray:
    return np.array([math.cos(angle_rad), math.sin(angle_rad)])


def scenes(family: str, count: int, seed: int = 7) -> Iterator[Scene]:
    """Yield scenes in a box of 100 m whose start and goal are inside no disc."""
    rng = np.random.default_rng(seed)
    while count:
        centres, radii = discs_of(family, rng)
        start, goal = rng.uniform(-10.0, 110.0, (2, 2))
        if family == "grid":
            start, goal = np.round(start / 10.0) * 10.0, np.round(goal / 10.0) * 10.0
        if family == "edge":
            for place in (start, goal):
                if rng.random() < 0.7:
                    disc = rng.integers(len(radii))
                    place[:] = centres[disc] + radii[disc] * unit(rng.uniform(0.0, math.tau))
        gap = np.linalg.norm(np.stack((start, goal))[:, None] - centres, axis=-1) - radii
        if (gap >= -1e-9).all() and not np.array_equal(start, goal):
            count -= 1
            yield start, goal, centres, radii


def discs_of(family: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return centres and radii of one scene of a family."""
    count = int(rng.integers(1, 16))
    centres, radii = rng.uniform(0.0, 100.0, (count, 2)), rng.uniform(2.0, 16.0, count)
    if family == "dense":
        centres, radii = rng.uniform(0.0, 100.0, (30, 2)), rng.uniform(6.0, 14.0, 30)
    if family == "grid":
        side = int(rng.integers(2, 5))
        centres = np.array([(20.0 * i + 20.0, 20.0 * j + 20.0) for i in range(side) for j in range(side)])
        radii = np.full(side * side, float(rng.choice([8, 10, 12])))
        kept = rng.random(len(radii)) < 0.8
        kept[0] = True
        centres, radii = centres[kept], radii[kept]
    if family == "nested":
        centres = np.vstack((centres, centres + rng.uniform(-2.0, 2.0, centres.shape)))
        radii = np.concatenate((radii, radii * rng.choice([0.3, 0.5, 1.0], count)))
    if family == "duplicate":
        centres, radii = np.vstack((centres, centres[::-1])), np.concatenate((radii, radii[::-1]))
    if family == "tangent":
        for disc in range(1, count):
            centres[disc] = centres[disc - 1] + (radii[disc] + radii[disc - 1]) * unit(rng.uniform(0.0, math.tau))
    return centres, radii


def disagreement(scene: Scene) -> str | None:
    """Say how D_geo differs from the independent planner's; None if it does not.

    A gap of no width at all between discs that touch may count as open or as closed, as rounding has it.
    """
    start, goal, centres, radii = scene
    route = shortest_route(start, goal, centres, radii)
    shortest, longest = (shortest_path_length(start, goal, centres, radii * share) for share in (1.0 - 1e-8, 1.0))
    if route.reach is not Reach.TARGET:
        return None if math.isinf(longest) else f"{route.reach.value}, but there is a way of {longest}"
    if shortest * (1.0 - 1e-6) <= route.length_m <= longest * (1.0 + 1e-6):
        return None
    return f"{route.length_m} is not in [{shortest}, {longest}]"


def misdirection(scene: Scene, step_m: float = 1e-3) -> float:
    """Return by what share a step along the first direction misses to shorten the way by its length."""
    start, goal, centres, radii = scene
    route = shortest_route(start, goal, centres, radii)
    if route.reach is not Reach.TARGET or route.length_m < 10.0 * step_m:
        return 0.0
    after = shortest_route(start + step_m * unit(route.heading_rad), goal, centres, radii)
    return abs(route.length_m - after.length_m - step_m) / step_m


def polygon_length_m(scene: Scene, corners: int = 100) -> float:
    """Return the shortest way over corners of polygons drawn about the discs: legal, hence never too short."""
    start, goal, centres, radii = scene
    turns = np.arange(corners) * math.tau / corners
    ring = np.stack((np.cos(turns), np.sin(turns)), axis=-1) / math.cos(math.pi / corners)
    points = np.vstack((start[None], goal[None], (centres[:, None] + radii[:, None, None] * ring).reshape(-1, 2)))
    outside = (np.linalg.norm(points[:, None] - centres, axis=-1) >= radii - 1e-9).all(axis=1)
    points = points[outside]
    along = points[None, :] - points[:, None]
    gap: np.ndarray = np.linalg.norm(along, axis=-1)
    for centre, radius in zip(centres, radii, strict=True):
        fraction = np.clip(((centre - points)[:, None] * along).sum(-1) / np.maximum(gap**2, 1e-12), 0.0, 1.0)
        miss = np.linalg.norm(points[:, None] + fraction[..., None] * along - centre, axis=-1)
        gap[miss < radius - 1e-6] = 0.0  # no edge
    return float(dijkstra(gap, indices=[0])[0, 1])


def flown(route: Route, per_piece: int = 200) -> np.ndarray:
    """Return (P, 2) points along the pieces, flown with the vehicle's kinematics; each must begin where one ended."""
    points, end = [], None
    for piece in route.pieces:
        if end is not None:
            assert math.dist(end[:2], piece[:2]) < 1e-4
            assert abs(math.remainder(end[2] - piece.heading_rad, math.tau)) < 1e-3
        for share in np.linspace(0.0, 1.0, per_piece + 1):
            end = advance(*piece[:3], 1.0, piece.curvature_1_m, piece.length_m * float(share))
            points.append(end[:2])
    return np.array(points)


def depth_m(points: np.ndarray, centres: np.ndarray, radii: np.ndarray) -> float:
    """Return how deep points (P, 2) lie in discs at most."""
    return float((radii - np.linalg.norm(points[:, None] - centres, axis=-1)).max(initial=-math.inf))


def test_without_discs_the_route_is_the_straight_line() -> None:
    route = shortest_route((0.0, 0.0), (3.0, 4.0), *NO_DISCS)
    assert (route.reach, route.length_m, route.turn, route.via) == (Reach.TARGET, 5.0, 0, ())
    assert route.heading_rad == pytest.approx(math.atan2(4.0, 3.0))


def test_one_disc_in_the_way_costs_two_tangents_and_an_arc() -> None:
    route = shortest_route((0.0, 0.0), (100.0, 0.0), np.array([[50.0, 1.0]]), np.array([10.0]))
    reach = math.hypot(50.0, 1.0)
    arc_rad = math.pi - 2.0 * math.atan2(1.0, 50.0) - 2.0 * math.acos(10.0 / reach)
    assert route.length_m == pytest.approx(2.0 * math.sqrt(reach**2 - 100.0) + 10.0 * arc_rad, rel=1e-12)
    assert route.via == ((0, 1),)  # the disc lies a little to the right and stays there


def test_a_disc_to_the_left_is_passed_with_side_minus_one() -> None:
    route = shortest_route((0.0, 0.0), (100.0, 0.0), np.array([[50.0, -1.0]]), np.array([10.0]))
    assert route.via == ((0, -1),)
    assert [math.copysign(1.0, piece.curvature_1_m) for piece in route.pieces if piece.curvature_1_m] == [-1.0]


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_the_length_is_the_one_of_an_independent_planner(family: str) -> None:
    assert [fault for fault in map(disagreement, scenes(family, 25)) if fault] == []


def test_a_disc_that_covers_an_arc_but_no_straight_line_is_gone_around() -> None:
    scene = (np.array([-30.0, 4.0]), np.array([30.0, 4.0]), np.array([[0.0, 0.0], [2.0, 10.0]]), np.array([10.0, 4.0]))
    assert shortest_route(*scene).via == ((1, -1),)
    assert disagreement(scene) is None


@pytest.mark.parametrize("family", FAMILIES)
def test_a_step_along_the_first_direction_shortens_the_way_by_its_length(family: str) -> None:
    assert max(map(misdirection, scenes(family, 25, seed=8))) < 0.02


@pytest.mark.slow
def test_no_way_over_densely_sampled_edges_is_shorter_and_the_best_is_hardly_longer() -> None:
    for scene in [*scenes("random", 3, seed=3), *scenes("grid", 2, seed=3)]:
        route = shortest_route(*scene)
        brute_m = polygon_length_m(scene)
        assert route.length_m <= brute_m * (1.0 + 1e-9)
        assert brute_m <= route.length_m * (1.0 + 1e-3)


@pytest.mark.parametrize("family", FAMILIES)
def test_the_pieces_lead_to_the_goal_and_enter_no_disc(family: str) -> None:
    for scene in scenes(family, 15, seed=9):
        route = shortest_route(*scene)
        if route.reach is Reach.TARGET:
            points = flown(route)
            assert math.dist(points[-1], scene[1]) < 1e-4
            assert sum(piece.length_m for piece in route.pieces) == pytest.approx(route.length_m, rel=1e-9)
            assert depth_m(points, *scene[2:]) < 1e-6 * scene[3].max()


@pytest.mark.parametrize("turn_radius_m", [1.0, 4.0, 12.0])
def test_a_route_with_a_turn_limit_can_be_flown(turn_radius_m: float) -> None:
    rng = np.random.default_rng(1)
    checked = 0
    for start, goal, centres, radii in scenes("random", 60, seed=10):
        wide = np.maximum(radii, TURN_SLACK * turn_radius_m)
        start_m, goal_m = (np.linalg.norm(centres - place, axis=-1) for place in (start, goal))
        if (start_m < wide + 2.0 * turn_radius_m).any() or (goal_m < wide).any():
            continue
        checked += 1
        heading_rad = rng.uniform(0.0, math.tau)
        route = shortest_route(start, goal, centres, radii, heading_rad, turn_radius_m)
        points = flown(route)
        assert math.remainder(route.pieces[0].heading_rad - heading_rad, math.tau) == pytest.approx(0.0, abs=1e-9)
        assert max(abs(piece.curvature_1_m) for piece in route.pieces) <= (1.0 + 1e-9) / turn_radius_m
        assert depth_m(points, centres, radii) < 1e-6 * radii.max()
        assert math.dist(points[-1], goal) < 1e-4
        assert route.length_m >= shortest_route(start, goal, centres, radii).length_m * (1.0 - 1e-9)
        if route.turn:
            assert math.copysign(1, route.pieces[0].curvature_1_m) == route.turn
            first = route.pieces[0]
            end_rad = first.heading_rad + first.curvature_1_m * first.length_m
            assert math.remainder(end_rad - route.heading_rad, math.tau) == pytest.approx(0.0, abs=1e-6)
    assert checked >= 8


def lattice_length_m(start: np.ndarray, heading_rad: float, scene: Scene, radius_m: float, within_m: float) -> float:
    """Return the length of the best way over short arcs and segments that comes within a distance of the goal.

    States are exact; of those that fall into one cell only the first to be reached goes on.
    """
    goal, centres, radii = scene[1:]
    step_m, cell_m, cell_rad = 0.4 * radius_m, 0.2 * radius_m, math.tau / 36
    layers: list[list[tuple[float, float, float]]] = [[(float(start[0]), float(start[1]), heading_rad)]]
    seen: set[tuple[int, int, int]] = set()
    while layers[-1] and len(layers) < 200:
        reached = []
        for state in layers[-1]:
            for curvature_1_m in (0.0, 1.0 / radius_m, -1.0 / radius_m):
                north_m, east_m, turned_rad = advance(*state, 1.0, curvature_1_m, step_m)
                middle = advance(*state, 1.0, curvature_1_m, 0.5 * step_m)
                if not (-3.0 < north_m / radius_m < 10.0 and -5.0 < east_m / radius_m < 5.0):
                    continue
                cell = (round(north_m / cell_m), round(east_m / cell_m), round(turned_rad % math.tau / cell_rad))
                if cell in seen or depth_m(np.array([(north_m, east_m), middle[:2]]), centres, radii) > 0.0:
                    continue
                if math.dist((north_m, east_m), goal) <= within_m:
                    return len(layers) * step_m
                seen.add(cell)
                reached.append((north_m, east_m, turned_rad))
        layers.append(reached)
    return math.inf


@pytest.mark.slow
@pytest.mark.parametrize("heading_rad", [0.0, 2.5])
def test_no_way_over_a_lattice_of_arcs_is_shorter(heading_rad: float) -> None:
    start, goal = np.array([0.0, 0.0]), np.array([7.0, 0.5])
    centres, radii = np.array([[3.5, 0.3], [3.0, -2.2]]), np.array([1.2, 0.9])
    route = shortest_route(start, goal, centres, radii, heading_rad, 1.0)
    within_m = 0.5
    brute_m = lattice_length_m(start, heading_rad, (start, goal, centres, radii), 1.0, within_m)
    assert route.length_m <= brute_m + within_m + 0.05
    assert brute_m <= 1.1 * route.length_m


def test_a_goal_inside_one_turning_circle_is_reached_over_the_other() -> None:
    route = shortest_route((0.0, 0.0), (0.0, 5.0), *NO_DISCS, 0.0, 10.0)
    assert route.turn == -1
    assert math.dist(flown(route)[-1], (0.0, 5.0)) < 1e-6


def test_a_disc_on_the_initial_arc_sends_the_vehicle_the_other_way_around() -> None:
    goal, heading_rad = (-100.0, 1.0), 0.0
    assert shortest_route((0.0, 0.0), goal, *NO_DISCS, heading_rad, 10.0).turn == 1
    blocked = shortest_route((0.0, 0.0), goal, np.array([[0.0, 20.0]]), np.array([3.0]), heading_rad, 10.0)
    assert blocked.turn == -1


@pytest.mark.parametrize("off_m", [-1e-6, -1e-9, 0.0, 1e-9, 1e-6])
@pytest.mark.parametrize("side", [1, -1])
def test_a_vehicle_on_an_edge_goes_on_along_it(off_m: float, side: int) -> None:
    start = (100.0 + off_m, 0.0)
    centres, radii = np.zeros((1, 2)), np.array([100.0])
    heading_rad = side * math.pi / 2.0
    route = shortest_route(start, (-300.0, side * 1.0), centres, radii, heading_rad, 20.0)
    assert route.via == ((0, side),)
    assert abs(math.remainder(route.heading_rad - heading_rad, math.tau)) < 0.01
    assert route.length_m < 520.0


@pytest.mark.parametrize("radius_m", [20.0, 20.4, 25.0, 100.0])
@pytest.mark.parametrize("off_rad", [-0.02, -1e-6, 1e-6, 0.02])
def test_a_heading_a_little_off_the_edge_costs_no_loop(radius_m: float, off_rad: float) -> None:
    start = np.array([radius_m, 0.0])
    goal = np.array([-5.0 * radius_m, 1.0])
    centres, radii = np.zeros((1, 2)), np.array([radius_m])
    limited = shortest_route(start, goal, centres, radii, math.pi / 2.0 + off_rad, 20.0)
    assert limited.length_m <= 1.05 * shortest_route(start, goal, centres, radii).length_m


def test_a_disc_that_cannot_be_avoided_is_entered_no_deeper_than_a_turn_must() -> None:
    centres, radii = np.array([[53.0, 1.0]]), np.array([50.0])
    route = shortest_route((0.0, 0.0), (200.0, 0.0), centres, radii, 0.0, 10.0)
    assert route.turn == -1
    assert route.pieces[0].heading_rad == pytest.approx(0.0)
    assert depth_m(flown(route), centres, radii) == pytest.approx(50.0 - (math.hypot(53.0, 11.0) - 10.0), abs=1e-3)


def test_hemmed_in_against_every_turn_it_still_gives_a_direction() -> None:
    centres, radii = np.array([[10.0, 28.0], [10.0, -28.0], [58.0, 0.0]]), np.array([20.0, 20.0, 50.0])
    route = shortest_route((0.0, 0.0), (-100.0, 0.0), centres, radii, 0.0, 20.0)
    assert (route.reach, route.turn) == (Reach.TARGET, 0)
    assert route.heading_rad == pytest.approx(math.pi)


def test_a_little_inside_a_disc_the_first_direction_leads_on_and_outwards() -> None:
    centres, radii = np.zeros((1, 2)), np.array([100.0])
    start = (100.0 * (1.0 - 0.2 * DEEP_SHARE), 0.0)
    route = shortest_route(start, (-300.0, 1.0), centres, radii)
    assert route.reach is Reach.TARGET
    assert route.heading_rad == pytest.approx(math.pi / 2.0 - 0.2 * math.pi / 2.0, abs=0.02)


def test_deep_inside_a_disc_the_first_direction_leads_straight_out() -> None:
    centres, radii = np.zeros((1, 2)), np.array([100.0])
    route = shortest_route((30.0, 30.0), (-300.0, 1.0), centres, radii)
    assert route.heading_rad == pytest.approx(math.pi / 4.0)


def test_a_start_held_by_three_discs_still_finds_a_way_out() -> None:
    centres = np.array([unit(k * math.tau / 3.0) for k in range(3)]) * 5.0
    route = shortest_route((0.0, 0.0), (100.0, 0.0), centres, np.full(3, 10.0))
    assert route.reach is Reach.TARGET
    assert math.isfinite(route.heading_rad)


def test_a_goal_inside_overlapping_discs_is_replaced_by_the_nearest_free_point() -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        centres, radii = rng.uniform(-10.0, 10.0, (5, 2)), rng.uniform(8.0, 14.0, 5)
        goal = centres[0] + 1.0
        route = shortest_route((80.0, 0.0), goal, centres, radii)
        grid = np.stack(np.meshgrid(*[np.linspace(-40.0, 40.0, 401)] * 2), axis=-1).reshape(-1, 2)
        free = grid[(np.linalg.norm(grid[:, None] - centres, axis=-1) >= radii).all(axis=1)]
        nearest_m = np.linalg.norm(free - goal, axis=1).min()
        assert route.reach is Reach.NEAREST
        assert depth_m(np.array([route.goal_ned_m]), centres, radii) < 1e-6
        assert nearest_m - 0.3 <= math.dist(route.goal_ned_m, goal) <= nearest_m + 1e-6


def test_a_goal_walled_off_from_outside_is_replaced_by_the_nearest_point_before_the_wall() -> None:
    route = shortest_route((200.0, 0.0), (1.0, 0.0), *RING)
    # The corners between two discs of the ring reach further in than its crests do.
    corner_m = 40.0 * math.cos(math.pi / 8) + math.sqrt(17.0**2 - (40.0 * math.sin(math.pi / 8)) ** 2)
    assert route.reach is Reach.NEAREST
    assert math.hypot(*route.goal_ned_m) == pytest.approx(corner_m)


def test_from_inside_a_wall_the_nearest_point_is_on_its_inside() -> None:
    route = shortest_route((0.0, 0.0), (200.0, 0.0), *RING)
    assert route.reach is Reach.NEAREST
    assert math.hypot(*route.goal_ned_m) < 40.0
    assert route.goal_ned_m[0] > 20.0


def test_an_island_inside_a_wall_does_not_hide_that_start_and_goal_are_in_the_same_water() -> None:
    centres, radii = np.vstack((RING[0], [[0.0, 0.0]])), np.append(RING[1], 5.0)
    route = shortest_route((-12.0, 0.0), (12.0, 0.0), centres, radii)
    assert route.reach is Reach.TARGET


def test_at_the_goal_there_is_nothing_left_to_fly() -> None:
    route = shortest_route((3.0, 4.0), (3.0, 4.0), *RING, 1.0, 2.0)
    assert (route.reach, route.length_m, route.pieces) == (Reach.TARGET, 0.0, ())


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("where", range(6))
def test_what_is_not_finite_is_refused(bad: float, where: int) -> None:
    numbers = [0.0, 10.0, 5.0, 1.0, 0.5, 2.0]
    numbers[where] = bad
    position, goal, centre, radius, heading, turn = numbers
    with pytest.raises(ValueError, match="finite"):
        shortest_route((position, 0.0), (goal, 0.0), np.array([[centre, 3.0]]), np.array([radius]), heading, turn)


def test_radii_of_another_number_than_centres_are_refused() -> None:
    with pytest.raises(ValueError, match="radii"):
        shortest_route((0.0, 0.0), (1.0, 0.0), np.zeros((2, 2)), np.ones(3))


whole = st.integers(-6, 6).map(float)


@pytest.mark.slow
@settings(max_examples=150)
@given(
    place=st.tuples(whole, whole),
    goal=st.tuples(whole, whole),
    discs=st.lists(st.tuples(whole, whole, st.sampled_from([0.0, 1.0, 2.0, 3.0, 5.0])), max_size=8),
    heading_rad=st.sampled_from([0.0, math.pi / 2, math.pi, 1.0]),
    turn_radius_m=st.sampled_from([0.0, 0.5, 1.0, 2.0]),
)
def test_every_finite_scene_is_decided(
    place: tuple[float, float],
    goal: tuple[float, float],
    discs: list[tuple[float, float, float]],
    heading_rad: float,
    turn_radius_m: float,
) -> None:
    table = np.array(discs, dtype=float).reshape(-1, 3)
    route = shortest_route(place, goal, table[:, :2], table[:, 2], heading_rad, turn_radius_m)
    inside = depth_m(np.array([goal]), table[:, :2], table[:, 2]) > 1e-6
    assert not (inside and route.reach is Reach.TARGET)
    if route.reach is not Reach.NONE:
        assert math.isfinite(route.heading_rad)
        assert route.length_m >= math.dist(place, route.goal_ned_m) * (1.0 - 1e-9) - 1e-9
        assert sum(piece.length_m for piece in route.pieces) == pytest.approx(route.length_m, rel=1e-6, abs=1e-6)


def test_a_router_stays_on_its_side_while_the_other_is_hardly_shorter() -> None:
    centres, radii, ids = np.array([[50.0, 0.0]]), np.array([10.0]), np.array([7])
    router = Router()
    sides = []
    for east_m in (-0.2, 0.2, 0.3):
        for _ in range(12):
            sides += [side for _, side in router.route(Departure((0.0, east_m)), (100.0, 0.0), centres, radii, ids).via]
    assert shortest_route((0.0, 0.3), (100.0, 0.0), centres, radii).via == ((0, -1),)
    assert set(sides) == {1}


def test_a_router_changes_sides_when_that_saves_more_than_its_share() -> None:
    centres, radii, ids = np.array([[50.0, 0.0]]), np.array([20.0]), np.array([7])
    router = Router()
    assert router.route(Departure((0.0, -0.1)), (100.0, 0.0), centres, radii, ids).via == ((0, 1),)
    last = [router.route(Departure((0.0, 20.0)), (100.0, 0.0), centres, radii, ids).via for _ in range(12)][-1]
    assert last == ((0, -1),)


def test_a_router_leaves_a_way_that_a_disc_has_closed() -> None:
    ids, router = np.array([1, 2]), Router()
    open_radii, closed_radii = np.array([20.0, 20.0]), np.array([20.0, 21.5])
    centres = np.array([[50.0, 5.0], [50.0, -36.0]])
    assert router.route(Departure((0.0, 0.0)), (100.0, 0.0), centres, open_radii, ids).via == ((0, 1),)
    route = router.route(Departure((0.0, 0.0)), (100.0, 0.0), centres, closed_radii, ids)
    assert depth_m(flown(route), centres, closed_radii) < 1e-6
    assert route.length_m == pytest.approx(shortest_route((0.0, 0.0), (100.0, 0.0), centres, closed_radii).length_m)


def test_a_router_knows_discs_by_their_ids() -> None:
    centres, radii, ids = np.array([[50.0, 0.3], [50.0, 80.0]]), np.array([10.0, 3.0]), np.array([4, 9])
    router = Router()
    assert router.route(Departure((0.0, 0.0)), (100.0, 0.0), centres, radii, ids).via == ((0, 1),)
    # The same disc, now second and a little to the other side: within the share it stays on the right.
    moved = np.array([[50.0, 80.0], [50.0, -0.3]])
    route = router.route(Departure((0.0, 0.0)), (100.0, 0.0), moved, radii[::-1], ids[::-1])
    assert route.via == ((1, 1),)


@pytest.mark.parametrize("written_to", ["centres", "radii", "ids"])
def test_a_router_goes_by_what_it_is_given_though_the_arrays_of_the_last_call_were_written_to(written_to: str) -> None:
    given = {"centres": np.array([[50.0, 0.3]]), "radii": np.array([10.0]), "ids": np.array([4])}
    same = {name: array.copy() for name, array in given.items()}
    router = Router()

    def via(discs: dict[str, np.ndarray]) -> tuple[tuple[int, int], ...]:
        return router.route(Departure((0.0, 0.0)), (100.0, 0.0), discs["centres"], discs["radii"], discs["ids"]).via

    assert via(given) == ((0, 1),)
    given[written_to][...] = 0
    assert via(same) == ((0, 1),)
    assert via(given) == (((0, 1),) if written_to == "ids" else ())


def test_a_router_refuses_discs_that_are_no_longer_finite() -> None:
    centres, radii, ids = np.array([[50.0, 0.3]]), np.array([10.0]), np.array([4])
    router = Router()
    router.route(Departure((0.0, 0.0)), (100.0, 0.0), centres, radii, ids)
    radii[0] = math.nan
    with pytest.raises(ValueError, match="finite"):
        router.route(Departure((0.0, 0.0)), (100.0, 0.0), centres, radii, ids)


def test_a_kept_way_has_the_length_of_a_fresh_one_on_the_same_sides() -> None:
    for start, goal, centres, radii in scenes("random", 20, seed=12):
        router, ids = Router(), np.arange(len(radii))
        first = router.route(Departure(start), goal, centres, radii, ids)
        place = start + 0.01 * unit(first.heading_rad)
        kept = router.route(Departure(place), goal, centres, radii, ids)
        assert kept.length_m == pytest.approx(shortest_route(place, goal, centres, radii).length_m, rel=1e-6)


def arrival(
    start: np.ndarray, heading_rad: float, scene: Scene, turn_radius_m: float, step_m: float
) -> tuple[bool, float, float, Route]:
    """Fly by a router until a step from the goal; return whether it arrived, flown length, depth, first route."""
    goal, centres, radii = scene[1:]
    router, ids = Router(), np.arange(len(radii))
    state = (float(start[0]), float(start[1]), heading_rad)
    first = router.route(Departure(state[:2], heading_rad, turn_radius_m), goal, centres, radii, ids)
    flown_m, deepest_m = 0.0, 0.0
    while flown_m < 3.0 * first.length_m + 100.0 * step_m:
        if math.dist(state[:2], goal) <= 2.0 * step_m:
            return True, flown_m, deepest_m, first
        route = router.route(Departure(state[:2], state[2], turn_radius_m), goal, centres, radii, ids)
        wanted_rad = route.heading_rad
        if route.turn * shorter_turn_rad(state[2], wanted_rad) < 0.0:
            wanted_rad = state[2] + route.turn * math.pi / 2.0
        points = []
        for _ in range(4):
            state = turn_towards(*state[:2], state[2], 1.0, wanted_rad, 1.0 / turn_radius_m, step_m / 4.0)
            points.append(state[:2])
        deepest_m = max(deepest_m, depth_m(np.array(points), centres, radii))
        flown_m += step_m
    return False, flown_m, deepest_m, first


def check_arrival(scene: Scene, heading_rad: float, turn_radius_m: float, step_m: float) -> None:
    arrived, flown_m, deepest_m, first = arrival(scene[0], heading_rad, scene, turn_radius_m, step_m)
    assert first.reach is Reach.TARGET
    assert arrived
    assert deepest_m <= 1e-3 * step_m
    assert flown_m <= 1.01 * first.length_m + step_m


# Most scenes so dense have their start or goal inside a disc, or no way.
@pytest.mark.slow
@settings(max_examples=20, suppress_health_check=[HealthCheck.filter_too_much])
@given(
    seed=st.integers(0, 10_000),
    heading_rad=st.floats(0.0, math.tau),
    turn_share=st.floats(0.05, 1.0),
)
def test_flown_step_by_step_in_a_dense_scene_it_arrives_and_never_enters(
    seed: int, heading_rad: float, turn_share: float
) -> None:
    rng = np.random.default_rng(seed)
    centres, radii = rng.uniform(0.0, 10_000.0, (25, 2)), rng.uniform(300.0, 900.0, 25)
    start, goal = rng.uniform(0.0, 10_000.0, (2, 2))
    turn_radius_m = 600.0 * turn_share
    free_m = np.linalg.norm(centres - start, axis=-1) - radii
    assume((free_m > 2.0 * turn_radius_m).all() and (np.linalg.norm(centres - goal, axis=-1) > radii + 600.0).all())
    assume(math.dist(start, goal) > 3_000.0)
    assume(shortest_route(start, goal, centres, radii).reach is Reach.TARGET)
    check_arrival((start, goal, centres, radii), heading_rad, turn_radius_m, 25.0)


U_OF_SEVEN = (np.array([3.0 * unit(math.radians(k)) for k in (-130, -85, -40, 0, 40, 85, 130)]), np.full(7, 1.1))
SPIRAL = (np.array([(3.0 + 0.34 * k) * unit(0.45 * k) for k in range(22)]), np.full(22, 1.15))


@pytest.mark.parametrize("turn_share", [0.05, 0.4, 1.0])
@pytest.mark.parametrize("trap, goal", [(U_OF_SEVEN, (7.0, 0.2)), (SPIRAL, (16.0, 0.0))], ids=["U", "spiral"])
def test_flown_step_by_step_it_leaves_a_trap(
    trap: tuple[np.ndarray, np.ndarray], goal: tuple[float, float], turn_share: float
) -> None:
    scene = (np.zeros(2), 600.0 * np.array(goal), 600.0 * trap[0], 600.0 * trap[1])
    check_arrival(scene, 0.3, 600.0 * turn_share, 25.0)


@pytest.mark.parametrize("goal_ned_m", [(1e-15, 0.0), (0.0, -1e-15), (-1e-7, 0.0), (0.0, 0.0)])
def test_a_goal_at_the_vehicle_is_no_way_at_all(goal_ned_m: tuple[float, float]) -> None:
    found = shortest_route((0.0, 0.0), goal_ned_m, np.zeros((0, 2)), np.zeros(0), 0.0, 40.8)
    assert found.reach is Reach.TARGET
    assert math.isfinite(found.heading_rad)
