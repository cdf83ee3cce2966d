"""Following a route: where on it the vehicle is, what is left of it, and how far off it following leads."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geo.kinematics import turn_rate_rad_s, turn_towards
from companion.guard.arcs import Path, Pose
from companion.guard.follow import course_turn_rad, next_stretch
from companion.guard.types import Limits, Piece
from companion.guard.vehicle import VehicleModel
from companion.guidance.course import at, course_rad, following_m, left_of, nearest

RADIUS_M = 100.0
BEND = (
    Piece(0.0, 0.0, 0.0, 0.0, 50.0),
    Piece(50.0, 0.0, 0.0, 1.0 / RADIUS_M, RADIUS_M * math.pi / 2.0),
    Piece(150.0, 100.0, math.pi / 2.0, 0.0, 80.0),
)
"""50 m north, a quarter of a circle to the right, 80 m east."""
LENGTH_M = 130.0 + RADIUS_M * math.pi / 2.0

Turns = list[tuple[float, float, float]]
"""Arcs of a route: radius over the least, signed turn in radians, and the straight line behind it in steps."""

turns = st.lists(
    st.tuples(
        st.floats(1.0, 12.0),
        st.floats(0.02, 3.5).flatmap(lambda turn: st.sampled_from((turn, -turn))),
        st.floats(0.0, 4.0),
    ),
    min_size=1,
    max_size=6,
)
vehicles = st.tuples(st.floats(3.0, 250.0), st.floats(0.2, 12.0), st.sampled_from((0.1, 0.5, 1.0, 2.0, 5.0)))
"""Speed in m/s, load factor and guidance step in s."""


def route_of(arcs: Turns, least_m: float, step_m: float) -> tuple[Piece, ...]:
    """Return the route that begins at the origin, northwards, and consists of arcs with straight lines between them."""
    pieces: list[Piece] = [Piece(0.0, 0.0, 0.0, 0.0, step_m)]
    for over, turn_rad, steps in arcs:
        radius_m = over * least_m
        pieces.append(
            Piece(
                *at(pieces[-1:], pieces[-1].length_m), math.copysign(1.0 / radius_m, turn_rad), abs(turn_rad) * radius_m
            )
        )
        pieces.append(Piece(*at(pieces[-1:], pieces[-1].length_m), 0.0, steps * step_m))
    return tuple(pieces)


@pytest.mark.parametrize(
    ("along_m", "place"),
    [
        (0.0, (0.0, 0.0, 0.0)),
        (50.0, (50.0, 0.0, 0.0)),
        (
            50.0 + RADIUS_M * math.pi / 4.0,
            (50.0 + RADIUS_M * math.sqrt(0.5), RADIUS_M * (1.0 - math.sqrt(0.5)), math.pi / 4.0),
        ),
        (LENGTH_M, (150.0, 180.0, math.pi / 2.0)),
        (LENGTH_M + 30.0, (150.0, 210.0, math.pi / 2.0)),
    ],
)
def test_a_place_on_the_route_and_straight_on_beyond_its_end(along_m: float, place: tuple[float, float, float]) -> None:
    assert at(BEND, along_m) == pytest.approx(place, abs=1e-9)


@given(st.floats(0.0, LENGTH_M), st.floats(0.0, 1.0))
def test_what_is_left_of_a_route_leads_where_the_route_does(along_m: float, share: float) -> None:
    rest = left_of(BEND, along_m)
    assert sum(piece.length_m for piece in rest) == pytest.approx(LENGTH_M - along_m, abs=1e-6)
    on_m = share * (LENGTH_M - along_m)
    assert at(rest, on_m) == pytest.approx(at(BEND, along_m + on_m), abs=1e-6)


@given(st.floats(0.0, LENGTH_M), st.floats(-40.0, 40.0))
def test_the_nearest_point_of_a_route_is_found_and_the_side_on_which_the_vehicle_is(
    along_m: float, right_m: float
) -> None:
    north_m, east_m, heading_rad = at(BEND, along_m)
    beside = (north_m - right_m * math.sin(heading_rad), east_m + right_m * math.cos(heading_rad))
    found_m, apart_m = nearest(BEND, beside, 1_000.0)
    assert apart_m == pytest.approx(right_m, abs=1e-6)
    assert found_m == pytest.approx(along_m, abs=1e-3 + 1e-3 * abs(right_m))


def test_only_pieces_that_begin_near_are_looked_at() -> None:
    assert nearest(BEND, (150.0, 180.0), 10.0)[0] == 50.0


@pytest.mark.parametrize(("beside_m", "side"), [(5.0, -1.0), (-5.0, 1.0)])
def test_beside_the_route_the_course_closes_in(beside_m: float, side: float) -> None:
    assert math.copysign(1.0, course_rad(BEND, beside_m, 10.0, 20.0)) == side


@settings(max_examples=60)
@given(turns, vehicles)
def test_a_vehicle_that_is_steered_along_a_route_stays_within_what_following_costs(
    arcs: Turns, vehicle: tuple[float, float, float]
) -> None:
    speed_m_s, n_max, step_s = vehicle
    step_m, rate_rad_s = speed_m_s * step_s, turn_rate_rad_s(speed_m_s, n_max)
    least_m = max(1.05 * speed_m_s / rate_rad_s, step_m)
    pieces, pose, beside_m = route_of(arcs, least_m, step_m), (0.0, 0.0, 0.0), 0.0
    # At this bound and not below: the route itself is longer than a step wherever its arcs are.
    bound_m = following_m(step_m, least_m) + 1e-6 * step_m
    left_m = sum(piece.length_m for piece in pieces)
    while left_m > 2.0 * step_m:
        wanted_rad = course_rad(pieces, beside_m, step_m, speed_m_s / rate_rad_s)
        for part in range(1, 9):
            north_m, east_m, _ = turn_towards(*pose, speed_m_s, wanted_rad, rate_rad_s, step_s * part / 8.0)
            assert abs(nearest(pieces, (north_m, east_m), 4.0 * step_m)[1]) <= bound_m
        pose = turn_towards(*pose, speed_m_s, wanted_rad, rate_rad_s, step_s)
        along_m, beside_m = nearest(pieces, pose[:2], 4.0 * step_m)
        pieces, left_m = left_of(pieces, along_m), left_m - along_m


@settings(max_examples=60)
@given(turns, vehicles, st.floats(-1.0, 1.0))
def test_guard_and_guidance_follow_a_route_alike_though_they_share_no_code(
    arcs: Turns, vehicle: tuple[float, float, float], aside: float
) -> None:
    speed_m_s, n_max, step_s = vehicle
    step_m, radius_m = speed_m_s * step_s, speed_m_s / turn_rate_rad_s(speed_m_s, n_max)
    pieces = route_of(arcs, max(1.05 * radius_m, step_m), step_m)
    model = VehicleModel(Limits(speed_m_s, speed_m_s, n_max, 0.0, 100.0))
    beside_m, pose = 0.1 * aside * step_m, Pose(0.0, 0.1 * aside * step_m, 0.0)
    most_rad = min(step_m / radius_m, 3.0)
    wanted_rad = math.remainder(course_rad(pieces, beside_m, step_m, radius_m), math.tau)
    turn_rad = course_turn_rad(model, Path(pieces, 0, speed_m_s, math.inf), 0.0, pose, step_s)
    assert turn_rad == pytest.approx(min(max(wanted_rad, -most_rad), most_rad), abs=1e-6)


def test_a_straight_line_is_flown_as_one_stretch_that_ends_on_it() -> None:
    model = VehicleModel(Limits(20.0, 20.0, 1.0, 0.0, 100.0))
    line = Path((Piece(0.0, 0.0, 0.0, 0.0, 205.0),), 0, 20.0, math.inf)
    stretch = next_stretch(model, line, 0.0, Pose(0.0, 0.05, 0.0), 0.5)
    assert stretch.steps == 20 and stretch.along_m == pytest.approx(200.0, abs=1e-3)
    assert stretch.pieces[-1].heading_rad == pytest.approx(-math.atan2(0.05, 200.0))
    one = next_stretch(model, line, 0.0, Pose(0.0, 4.0, 0.0), 0.5)
    assert one.steps == 1


@given(turns)
def test_the_stretches_of_a_route_hang_together(arcs: Turns) -> None:
    model = VehicleModel(Limits(20.0, 20.0, 1.0, 0.0, 100.0))
    pieces = route_of(arcs, 45.0, 10.0)
    route, along_m, pose, flown = Path(pieces, 0, 20.0, math.inf), 0.0, Pose(0.0, 0.0, 0.0), []
    while along_m < sum(piece.length_m for piece in pieces):
        stretch = next_stretch(model, route, along_m, pose, 0.5)
        flown += [piece for piece in stretch.pieces if piece.length_m > 0.0]
        along_m, pose = stretch.along_m, Pose(*at(stretch.pieces[-1:], stretch.pieces[-1].length_m))
    for piece, after in pairwise(flown):
        assert at((piece,), piece.length_m) == pytest.approx(after[:3], abs=1e-6)
