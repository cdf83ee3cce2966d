"""The shortest path around discs against closed forms and a visibility graph of polygons."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from sim.shortest_path import Departure, shortest_path_length, turning_path, walls_of

CORNERS = 24
"""Of the polygon about each disc in the visibility graph."""

coordinate = st.floats(0.0, 100.0).map(lambda value: round(value, 2))
point = st.tuples(coordinate, coordinate)
disc = st.tuples(coordinate, coordinate, st.floats(1.0, 25.0).map(lambda value: round(value, 2)))
scene = st.tuples(point, point, st.lists(disc, max_size=5))


def length_m(start: object, goal: object, discs: object) -> float:
    table = np.array(discs, dtype=float).reshape(-1, 3)
    return shortest_path_length(np.array(start, float), np.array(goal, float), table[:, :2], table[:, 2])


def visibility_length_m(start: object, goal: object, discs: list[tuple[float, float, float]]) -> float:
    """Return the shortest way over corners of polygons drawn about the discs: legal, hence never too short."""
    nodes = [np.array(start, float), np.array(goal, float)]
    for north, east, radius in discs:
        for corner in range(CORNERS):
            angle = math.tau * corner / CORNERS
            reach = radius / math.cos(math.pi / CORNERS)
            nodes.append(np.array([north + reach * math.cos(angle), east + reach * math.sin(angle)]))
    points = np.array(nodes)
    gap = np.linalg.norm(points[:, None] - points, axis=-1)
    for north, east, radius in discs:
        centre = np.array([north, east])
        along = points[None, :] - points[:, None]
        squared = np.maximum((along**2).sum(-1), 1e-12)
        fraction = np.clip(((centre - points)[:, None] * along).sum(-1) / squared, 0, 1)
        nearest = points[:, None] + fraction[..., None] * along
        gap[np.linalg.norm(nearest - centre, axis=-1) < radius - 1e-6] = math.inf
    best = np.full(len(points), math.inf)
    best[0] = 0.0
    waiting = np.ones(len(points), dtype=bool)
    while waiting.any():
        node = int(np.where(waiting, best, math.inf).argmin())
        if not waiting[node] or math.isinf(best[node]):
            break
        waiting[node] = False
        best = np.minimum(best, best[node] + gap[node])
    return float(best[1])


def test_without_discs_the_shortest_path_is_the_straight_line() -> None:
    assert length_m((0, 0), (30_000, 40_000), []) == 50_000


def test_a_disc_beside_the_straight_line_changes_nothing() -> None:
    assert length_m((0, 0), (100, 0), [(50, 20, 19)]) == 100


def test_a_path_may_touch_a_disc() -> None:
    assert length_m((0, 0), (100, 0), [(50, 20, 20)]) == 100


def test_one_disc_in_the_middle_costs_two_tangents_and_an_arc() -> None:
    radius, half = 10_000.0, 50_000.0
    expected = 2 * math.sqrt(half**2 - radius**2) + radius * (math.pi - 2 * math.acos(radius / half))
    assert length_m((0, 0), (0, 2 * half), [(0, half, radius)]) == pytest.approx(expected, rel=1e-12)


def test_the_path_takes_the_shorter_side_of_a_disc() -> None:
    start, goal, centre, radius = np.array([0.0, 0.0]), np.array([100.0, 0.0]), np.array([50.0, 5.0]), 10.0
    reach = math.hypot(50, 5)
    seen_from_centre = math.tau / 2 - 2 * math.atan2(5, 50)
    arc = seen_from_centre - 2 * math.acos(radius / reach)
    expected = 2 * math.sqrt(reach**2 - radius**2) + radius * arc
    found = shortest_path_length(start, goal, centre[None], np.array([radius]))
    assert found == pytest.approx(expected, rel=1e-12)


def test_the_path_slips_between_two_discs_that_stand_apart() -> None:
    assert length_m((0, 0), (100, 0), [(50, 21, 20), (50, -21, 20)]) == 100


def test_the_path_goes_around_two_discs_that_overlap_by_their_common_tangent() -> None:
    radius, half = 10.0, 60.0
    # Two equal discs one behind the other: as one disc, and the line of centres once more.
    one = 2 * math.sqrt((half - 5) ** 2 - radius**2) + radius * (math.pi - 2 * math.acos(radius / (half - 5)))
    assert length_m((0, 0), (120, 0), [(55, 0, radius), (65, 0, radius)]) == pytest.approx(one + 10, rel=1e-12)


def test_the_path_winds_between_two_discs_by_their_inner_tangent() -> None:
    # By symmetry the path crosses the middle: half of it is tangent, arc, half of the inner tangent.
    discs = [(30.0, 5.0, 10.0), (70.0, -5.0, 10.0)]
    mid = math.hypot(20, 5)
    first = math.hypot(30, 5)
    turn = math.pi - math.atan2(5, 30) - math.atan2(5, 20)
    tangents = math.sqrt(first**2 - 100) + math.sqrt(mid**2 - 100)
    arc = 10 * (turn - math.acos(10 / first) - math.acos(10 / mid))
    assert length_m((0, 0), (100, 0), discs) == pytest.approx(2 * (tangents + arc), rel=1e-9)


def test_a_disc_inside_another_changes_nothing() -> None:
    assert length_m((0, 0), (100, 1), [(50, 0, 20), (45, 3, 5)]) == length_m((0, 0), (100, 1), [(50, 0, 20)])


def test_the_same_disc_twice_changes_nothing() -> None:
    assert length_m((0, 0), (100, 1), [(50, 0, 20)] * 2) == length_m((0, 0), (100, 1), [(50, 0, 20)])


@pytest.mark.parametrize("start", [(0, 0), (30, 10), (-12, 25)])
def test_a_goal_behind_a_closed_ring_of_discs_cannot_be_reached(start: tuple[float, float]) -> None:
    ring = [(50 * math.cos(angle), 50 * math.sin(angle), 20) for angle in np.arange(8) * math.tau / 8]
    assert length_m(start, (200, 0), ring) == math.inf
    assert length_m((200, 0), start, ring) == math.inf


def test_a_ring_with_one_disc_missing_can_be_left() -> None:
    ring = [(50 * math.cos(angle), 50 * math.sin(angle), 20) for angle in np.arange(7) * math.tau / 8]
    assert 200 < length_m((0, 0), (200, 0), ring) < 400


@pytest.mark.parametrize("ends", [((50, 0), (200, 0)), ((200, 0), (50, 0))])
def test_an_end_inside_a_disc_cannot_be_reached(ends: tuple[tuple[int, int], tuple[int, int]]) -> None:
    assert length_m(*ends, [(50, 5, 20)]) == math.inf


def test_from_the_edge_of_a_disc_the_path_runs_along_it() -> None:
    assert length_m((-10, 0), (10, 0), [(0, 0, 10)]) == pytest.approx(10 * math.pi, rel=1e-9)


def test_no_distance_is_no_path() -> None:
    assert length_m((5, 5), (5, 5), [(50, 0, 20)]) == 0.0


def test_an_origin_far_away_does_not_change_the_length() -> None:
    discs = np.array([(30.0, 5.0, 10.0), (70.0, -5.0, 10.0)])
    near = length_m((0, 0), (100, 0), discs)
    far = length_m((1e6, 1e6), (1e6 + 100, 1e6), discs + (1e6, 1e6, 0))
    assert far == pytest.approx(near, rel=1e-8)


@pytest.mark.slow
@settings(max_examples=150)
@given(scene)
def test_the_length_lies_between_the_polygons_about_the_discs_and_slightly_larger_discs(
    drawn: tuple[tuple[float, float], tuple[float, float], list[tuple[float, float, float]]],
) -> None:
    start, goal, discs = drawn
    larger = [(north, east, radius / math.cos(math.pi / CORNERS)) for north, east, radius in discs]
    for north, east, radius in larger:
        assume(min(math.hypot(north - end[0], east - end[1]) for end in (start, goal)) > radius + 0.01)
    exact = length_m(start, goal, discs)
    by_corners = visibility_length_m(start, goal, discs)
    assert exact <= by_corners + 1e-4
    assert by_corners <= length_m(start, goal, larger) + 1e-4


@settings(max_examples=100)
@given(scene)
def test_the_way_back_is_as_long_and_never_shorter_than_the_straight_line(
    drawn: tuple[tuple[float, float], tuple[float, float], list[tuple[float, float, float]]],
) -> None:
    start, goal, discs = drawn
    there, back = length_m(start, goal, discs), length_m(goal, start, discs)
    assert there == back or there == pytest.approx(back, rel=1e-9)
    assert there >= math.dist(start, goal) * (1 - 1e-12)


@settings(max_examples=60)
@given(scene, disc)
def test_one_disc_more_never_makes_the_path_shorter(
    drawn: tuple[tuple[float, float], tuple[float, float], list[tuple[float, float, float]]],
    another: tuple[float, float, float],
) -> None:
    start, goal, discs = drawn
    assert length_m(start, goal, [*discs, another]) >= length_m(start, goal, discs) - 1e-6


def test_thirty_discs_take_every_one_into_account() -> None:
    # A slalom: each row of the wall is offset, so the straight line meets a disc in every row.
    discs = [
        (10.0 * row, 8.0 * column + 4.0 * (row % 2), 3.9)
        for row, column in itertools.product(range(1, 7), range(-2, 3))
    ]
    through = length_m((0, 0), (70, 0), discs)
    around_some = length_m((0, 0), (70, 0), discs[:15])
    assert 70 < around_some < through < 140


SPIT = np.array([(40.0, -50.0), (60.0, -50.0), (60.0, 10.0), (40.0, 10.0)])


def test_round_the_corners_of_a_polygon_the_path_is_a_taut_string_at_the_clearance() -> None:
    walls = walls_of([SPIT], 1e-9)
    found = shortest_path_length(np.zeros(2), np.array([100.0, 0.0]), np.empty((0, 2)), np.empty(0), walls)
    assert found == pytest.approx(2 * math.hypot(40, 10) + 20, abs=1e-6)


def test_with_a_clearance_the_path_rounds_the_corners_on_circles_of_that_radius() -> None:
    walls = walls_of([SPIT], 5.0)
    found = shortest_path_length(np.zeros(2), np.array([100.0, 0.0]), np.empty((0, 2)), np.empty(0), walls)
    discs = [(40.0, 10.0, 5.0), (60.0, 10.0, 5.0), (50.0, -50.0, 60.0)]
    around = [(40.0, 10.0, 5.0), (60.0, 10.0, 5.0)]
    assert found == pytest.approx(_one_side_m(around), rel=1e-9)
    assert found > length_m((0, 0), (100, 0), discs[:2])


def _one_side_m(discs: list[tuple[float, float, float]]) -> float:
    """Return the length of the path that passes two equal discs, symmetric about the middle, both on their east."""
    north, east, radius = discs[0]
    reach = math.hypot(north, east)
    turn = math.atan2(east, north) + math.asin(radius / reach)
    return 2 * (math.sqrt(reach**2 - radius**2) + radius * turn) + discs[1][0] - north


def test_a_gap_between_a_disc_and_a_wall_narrower_than_both_clearances_is_closed() -> None:
    wall = np.array([(30.0, 20.0), (70.0, 20.0), (70.0, 30.0), (30.0, 30.0)])
    disc_row = np.array([[50.0, 5.0]]), np.array([10.0])
    ends = np.array([0.0, 18.0]), np.array([100.0, 18.0])
    through = shortest_path_length(*ends, *disc_row, walls_of([wall], 2.0))
    closed = shortest_path_length(*ends, *disc_row, walls_of([wall], 5.5))
    assert through < 102.0 < closed


def test_a_closed_polygon_about_the_goal_leaves_no_path() -> None:
    walls = walls_of([np.array([(80.0, -20.0), (120.0, -20.0), (120.0, 20.0), (80.0, 20.0)])], 1.0)
    nothing = np.empty((0, 2)), np.empty(0)
    assert shortest_path_length(np.zeros(2), np.array([100.0, 0.0]), *nothing, walls) == math.inf
    assert turning_path(Departure(np.zeros(2), 0.0, 5.0), np.array([100.0, 0.0]), 10.0, *nothing, walls) is None


def test_a_turning_circle_that_would_cross_a_wall_is_not_flown() -> None:
    # The target is behind; to the left there is a wall within two turn radii.
    walls = walls_of([np.array([(-50.0, -30.0), (50.0, -30.0), (50.0, -29.0), (-50.0, -29.0)])], 1.0)
    nothing = np.empty((0, 2)), np.empty(0)
    start = Departure(np.zeros(2), 0.0, 20.0)
    free, walled = (turning_path(start, np.array([-200.0, -20.0]), 5.0, *nothing, *more) for more in ((), (walls,)))
    assert free is not None and walled is not None
    assert free[0].turn_rad < 0.0 < walled[0].turn_rad


def test_among_hundreds_of_discs_the_path_is_no_shorter_than_the_line_and_no_longer_than_round_all() -> None:
    generator = np.random.default_rng(4)
    centres, radii = generator.uniform(0.0, 1000.0, (300, 2)), np.full(300, 15.0)
    found = shortest_path_length(np.array([-50.0, 500.0]), np.array([1050.0, 500.0]), centres, radii)
    assert 1100.0 <= found <= 1300.0
