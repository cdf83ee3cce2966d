"""How the guard predicts that a vehicle follows a route."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.guard import arcs, follow
from companion.guard.arcs import Disc, Path, Pose
from companion.guard.types import Limits, Piece
from companion.guard.vehicle import VehicleModel
from tests.companion.guard.guard_flight import DT_S, PIECES, PLANE, RHO_M, along

MODEL = VehicleModel(PLANE)
STEP_M = 10.0

QUARTER_M = 100.0 * math.pi / 2.0
BENDS = Path(
    (
        Piece(0.0, 0.0, 0.0, 0.0, 50.0),
        Piece(50.0, 0.0, 0.0, 0.01, QUARTER_M),
        Piece(150.0, 100.0, math.pi / 2.0, 0.0, 80.0),
        Piece(150.0, 180.0, math.pi / 2.0, -0.02, 60.0),
    ),
    0,
    20.0,
    math.inf,
)
"""50 m north, a quarter of a circle of 100 m to the right, 80 m east, and an arc of 50 m radius to the left."""


def route(*pieces: Piece) -> Path:
    return Path(pieces, 0, 20.0, math.inf)


LINE = route(Piece(0.0, 0.0, 0.0, 0.0, 205.0))


@pytest.mark.parametrize(
    ("along_m", "index"), [(0.0, 0), (49.0, 0), (51.0, 1), (200.0, 1), (215.0, 2), (290.0, 3), (400.0, 3)]
)
def test_the_piece_at_a_place_is_the_one_it_falls_on_and_beyond_the_end_the_last(along_m: float, index: int) -> None:
    assert follow.piece_at(BENDS, along_m) == BENDS.pieces[index]


@pytest.mark.parametrize(
    ("along_m", "left_m"),
    [
        (0.0, 50.0),
        (20.0, 30.0),
        (51.0, 0.0),
        (60.0 + QUARTER_M, 70.0),
        (129.0 + QUARTER_M, 1.0),
        (150.0 + QUARTER_M, 0.0),
        (500.0, 0.0),
    ],
)
def test_of_a_straight_line_that_is_left_which_lies_ahead_and_of_an_arc_nothing(along_m: float, left_m: float) -> None:
    assert follow.straight_left_m(BENDS, along_m) == pytest.approx(left_m)


@pytest.mark.parametrize(("along_m", "ahead_m", "found_m"), [(20.0, 3.0, 23.0), (20.0, -3.0, 17.0), (2.0, -3.0, 0.0)])
def test_the_way_along_the_route_is_the_guess_corrected_by_what_is_ahead_of_it(
    along_m: float, ahead_m: float, found_m: float
) -> None:
    assert follow.progress_m(BENDS, along_m, Pose(along_m + ahead_m, 4.0, 0.3)) == pytest.approx(found_m)


@pytest.mark.parametrize("beside_m", [-2.0, 0.0, 1.0])
@pytest.mark.parametrize("off_rad", [-0.05, 0.02])
def test_on_a_straight_line_the_course_closes_what_is_beside_it_in_four_steps(beside_m: float, off_rad: float) -> None:
    turn_rad = follow.course_turn_rad(MODEL, LINE, 30.0, Pose(30.0, beside_m, off_rad), DT_S)
    assert turn_rad == pytest.approx(-off_rad - math.atan(beside_m / 40.0))


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("over", "lead_steps"), [(1.0, 1.0), (0.8, 1.0), (2.0, 0.75), (10.0, 0.55)])
def test_on_an_arc_the_heading_wanted_is_the_chords_and_on_the_least_radius_that_a_step_ahead(
    over: float, lead_steps: float, side: float
) -> None:
    bend_1_m = side / (over * RHO_M)
    bend = route(Piece(0.0, 0.0, 0.0, bend_1_m, 200.0))
    on_it = arcs.pose_at(bend, 40.0)
    turned_in = on_it._replace(heading_rad=on_it.heading_rad + side * 0.1)
    turn_rad = lead_steps * STEP_M / (over * RHO_M) - 0.1
    assert follow.course_turn_rad(MODEL, bend, 40.0, turned_in, DT_S) == pytest.approx(side * turn_rad)


@pytest.mark.parametrize(
    ("along_m", "turn_m"),
    [(32.0, 0.0), (42.0, 0.0), (48.0, 5.0 * (1.0 + RHO_M / 200.0) - 2.0), (343.0, 7.0), (355.0, 0.0)],
)
def test_the_piece_a_step_ahead_says_how_far_the_course_looks(along_m: float, turn_m: float) -> None:
    """A bend of 200 m radius begins after 50 m of straight line and ends after 350 m."""
    bend = Piece(50.0, 0.0, 0.0, 1.0 / 200.0, 300.0)
    way = route(Piece(0.0, 0.0, 0.0, 0.0, 50.0), bend, arcs.straight(arcs.end_of(bend), 100.0))
    turn_rad = follow.course_turn_rad(MODEL, way, along_m, arcs.pose_at(way, along_m), DT_S)
    assert turn_rad == pytest.approx(turn_m / 200.0)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("limits", "dt_s", "most_rad"), [(PLANE, DT_S, STEP_M / RHO_M), (Limits(60, 60, 10, 0, 9), 5, 3)]
)
def test_no_step_along_a_route_turns_farther_than_the_vehicle_can(
    limits: Limits, dt_s: float, most_rad: float, side: float
) -> None:
    speed_m_s = limits.speed_max_m_s
    line = Path((Piece(0.0, 0.0, 0.0, 0.0, 1e4),), 0, speed_m_s, math.inf)
    turn_rad = follow.course_turn_rad(VehicleModel(limits), line, 0.0, Pose(0.0, 0.0, -side * 3.1), dt_s)
    assert turn_rad == pytest.approx(side * most_rad)


def test_one_step_is_an_arc_of_the_least_radius_and_what_is_left_of_the_step_straight_on() -> None:
    pose = Pose(150.0, 4.0, 0.02)
    stretch = follow.next_stretch(MODEL, LINE, 150.0, pose, DT_S)
    turn_rad = follow.course_turn_rad(MODEL, LINE, 150.0, pose, DT_S)
    arc, line = stretch.pieces
    assert stretch.steps == 1
    assert arc == pytest.approx((*pose, -1.0 / RHO_M, -turn_rad * RHO_M))
    assert line == pytest.approx((*arcs.end_of(arc), 0.0, STEP_M - arc.length_m))
    end = arcs.end_of(line)
    assert (end.heading_rad, stretch.along_m) == pytest.approx((0.02 + turn_rad, end.north_m))


def test_a_straight_line_is_one_stretch_that_ends_on_it_at_the_last_whole_step() -> None:
    stretch = follow.next_stretch(MODEL, LINE, 2.0, Pose(2.0, 0.15, 0.001), DT_S)
    end = arcs.end_of(stretch.pieces[-1])
    assert stretch.steps == 20
    assert end == pytest.approx((202.0, 0.0, -0.15 / 200.0), abs=2e-3)
    assert stretch.along_m == pytest.approx(end.north_m)
    assert sum(piece.length_m for piece in stretch.pieces) == pytest.approx(200.0)


@pytest.mark.parametrize(("along_m", "steps"), [(174.0, 3), (176.0, 1)])
def test_a_line_of_three_steps_is_a_stretch_and_a_shorter_one_is_not(along_m: float, steps: int) -> None:
    assert follow.next_stretch(MODEL, LINE, along_m, Pose(along_m, 0.0, 0.0), DT_S).steps == steps


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("beside_m", "off_rad", "steps"),
    [
        (0.0, 0.0049, 20),
        (0.0, 0.0051, 1),
        (0.3, 0.0, 1),  # the way to the line's end is straight on, that back to the line is not
        (-0.4, 0.0095, 1),  # the other way round
    ],
)
def test_only_from_a_line_that_the_vehicle_is_on_and_flies_along_is_the_rest_of_it_one_stretch(
    beside_m: float, off_rad: float, steps: int, side: float
) -> None:
    assert follow.next_stretch(MODEL, LINE, 0.0, Pose(0.0, side * beside_m, side * off_rad), DT_S).steps == steps


def test_on_an_arc_there_is_no_whole_line_to_fly_and_a_step_leads_as_far_along_it_as_it_ends() -> None:
    bend = route(Piece(0.0, 0.0, 0.0, 1.0 / 45.0, 200.0))
    stretch = follow.next_stretch(MODEL, bend, 60.0, arcs.pose_at(bend, 60.0), DT_S)
    assert stretch.steps == 1
    nearest_m = arcs.nearest_along_m(bend, arcs.end_of(stretch.pieces[-1]))
    assert stretch.along_m == pytest.approx(nearest_m, abs=0.02)


@settings(max_examples=40, derandomize=True)
@given(
    bends=st.lists(
        st.tuples(st.floats(45.0, 500.0), st.floats(-3.0, 3.0), st.floats(0.0, 60.0)), min_size=1, max_size=5
    )
)
def test_the_stretches_of_a_route_hang_together_and_stay_near_it(bends: list[tuple[float, float, float]]) -> None:
    pieces = [Piece(0.0, 0.0, 0.0, 0.0, STEP_M)]
    for radius_m, turn_rad, line_m in bends:
        bend_1_m = math.copysign(1.0 / radius_m, turn_rad)
        pieces.append(Piece(*arcs.end_of(pieces[-1]), bend_1_m, abs(turn_rad) * radius_m))
        pieces.append(Piece(*arcs.end_of(pieces[-1]), 0.0, line_m))
    way, along_m, pose = route(*pieces), 0.0, Pose(0.0, 0.0, 0.0)
    flown: list[Piece] = []
    while along_m < sum(piece.length_m for piece in pieces) - STEP_M:
        stretch = follow.next_stretch(MODEL, way, along_m, pose, DT_S)
        flown += stretch.pieces
        along_m, pose = stretch.along_m, arcs.end_of(stretch.pieces[-1])
        assert math.dist(pose[:2], arcs.pose_at(way, along_m)[:2]) < 0.6 * STEP_M
    for piece, after in pairwise(flown):
        assert arcs.end_of(piece) == pytest.approx(after[:3], abs=1e-6)


@pytest.mark.parametrize(
    ("piece", "disc", "edge_m"),
    [
        (Piece(0.0, 0.0, 0.0, 0.0, 100.0), (50.0, 90.0, 10.0, 0.0), 30.0),  # its middle is 50 m north
        (Piece(0.0, 0.0, 0.0, 0.01, 100.0), None, 30.0),
        (Piece(0.0, 0.0, 0.0, -0.01, 300.0), (180.0, -100.0, 10.0, 0.0), 70.0),  # its circle is about 100 m west
        (Piece(0.0, 0.0, 0.0, 0.04, 60.0), (0.0, 115.0, 15.0, 0.0), 50.0),
    ],
)
def test_a_disc_is_near_a_piece_where_it_is_near_the_disc_that_contains_the_piece(
    piece: Piece, disc: Disc | None, edge_m: float
) -> None:
    """An arc of up to two radians is contained in the disc about its middle, a longer one in its circle."""
    if disc is None:
        middle = arcs.place_on(piece, 50.0)
        disc = (middle.north_m + 90.0, middle.east_m, 10.0, 0.0)
    assert follow.discs_near([piece], [disc], edge_m + 1e-6) == [disc]
    assert follow.discs_near([piece], [disc], edge_m - 1e-6) == []


def test_discs_are_near_a_route_if_they_are_near_any_piece_and_keep_their_order() -> None:
    far, first, last = (500.0, 500.0, 5.0, 0.0), (150.0, 200.0, 5.0, 0.0), (-20.0, 0.0, 5.0, 0.0)
    assert follow.discs_near(BENDS.pieces, [first, far, last], 20.0) == [first, last]
    assert follow.discs_near(BENDS.pieces, [], 20.0) == []


@settings(max_examples=100, derandomize=True)
@given(
    pieces=st.lists(PIECES, min_size=1, max_size=3),
    bearing_rad=st.floats(0.0, math.tau),
    apart_m=st.floats(0.0, 200.0),
    radius_m=st.floats(1.0, 60.0),
    reach_m=st.floats(0.0, 60.0),
)
def test_a_disc_that_is_not_near_a_route_is_out_of_reach_of_it(
    pieces: list[Piece], bearing_rad: float, apart_m: float, radius_m: float, reach_m: float
) -> None:
    disc = (apart_m * math.cos(bearing_rad), apart_m * math.sin(bearing_rad), radius_m, 0.0)
    least_m = min(float(np.hypot(*(along(piece, 201) - disc[:2]).T).min()) for piece in pieces)
    assert follow.discs_near(pieces, [disc], reach_m) == [disc] or least_m > radius_m + reach_m - 1e-6
