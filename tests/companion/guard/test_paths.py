"""Paths, and how they are steered along."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.guard import arcs
from companion.guard.arcs import Path, Pose
from companion.guard.guard import Guard
from companion.guard.types import (
    Limits,
    Piece,
)
from companion.guard.vehicle import VehicleModel
from tests.companion.guard.guard_flight import (
    DT_S,
    NORTHWARD,
    NOTHING,
    PIECES,
    PLANE,
    RHO_M,
    along,
    assert_hangs_together,
)


@settings(max_examples=100, derandomize=True)
@given(pieces=st.lists(PIECES, min_size=1, max_size=4), share=st.floats(0.0, 1.2))
def test_a_place_along_a_path_is_that_on_the_piece_it_falls_on(pieces: list[Piece], share: float) -> None:
    lengths_m = [piece.length_m for piece in pieces]
    along_m = share * sum(lengths_m)
    path = Path(tuple(pieces), 0, 10.0, math.inf)
    index, left_m = 0, along_m
    while index + 1 < len(pieces) and left_m > lengths_m[index]:
        left_m, index = left_m - lengths_m[index], index + 1
    expected = arcs.place_on(pieces[index], min(left_m, lengths_m[index]))
    assert arcs.pose_at(path, along_m) == pytest.approx(expected, abs=1e-9)
    rest_m = sum(piece.length_m for piece in arcs.rest_of(path, along_m))
    assert rest_m == pytest.approx(max(0.0, sum(lengths_m) - along_m), abs=1e-9)


@settings(max_examples=60, derandomize=True)
@given(pieces=st.lists(PIECES, min_size=1, max_size=3), north_m=st.floats(-90.0, 90.0), east_m=st.floats(-90.0, 90.0))
def test_the_nearest_place_of_a_path_is_that_of_its_nearest_piece(
    pieces: list[Piece], north_m: float, east_m: float
) -> None:
    path = Path(tuple(pieces), 0, 10.0, math.inf)
    along_m = arcs.nearest_along_m(path, Pose(north_m, east_m, 0.0))
    nearest_m = min(float(np.hypot(*(along(piece, 501) - (north_m, east_m)).T).min()) for piece in pieces)
    before_m = [sum(piece.length_m for piece in pieces[:count]) for count in range(len(pieces))]
    places = [
        arcs.place_on(piece, along_m - start_m)
        for piece, start_m in zip(pieces, before_m, strict=True)
        if -1e-9 <= along_m - start_m <= piece.length_m + 1e-9
    ]
    assert min(math.dist(place[:2], (north_m, east_m)) for place in places) == pytest.approx(nearest_m, abs=0.08)


def test_a_loop_is_flown_again_and_again() -> None:
    first = Piece(0.0, 0.0, 0.0, 0.0, 10.0)
    circle = Piece(10.0, 0.0, 0.0, 0.1, math.tau * 10.0)
    path = Path((first, circle), 1, 10.0, math.inf)
    for turns in range(3):
        place = arcs.pose_at(path, 10.0 + (turns + 0.25) * circle.length_m)
        assert place[:2] == pytest.approx((20.0, 10.0))
    assert arcs.rest_of(path, 1000.0) == (circle,)


@pytest.mark.parametrize("share", np.linspace(0.0, 2.5, 26).tolist())
def test_a_place_on_a_loop_of_several_pieces_is_that_on_the_path_unrolled(share: float) -> None:
    limits = Limits(60.0, 60.0, 10.0, 50.0, 120.0)
    loop = VehicleModel(limits).circle(Pose(10.0, 0.0, 0.0), 1.0, 60.0, 5.0)
    first = Piece(0.0, 0.0, 0.0, 0.0, 10.0)
    along_m = share * sum(piece.length_m for piece in loop) + 1.0
    unrolled = arcs.pose_at(Path((first, *loop, *loop, *loop), 0, 60.0, math.inf), along_m)
    place = arcs.pose_at(Path((first, *loop), len(loop), 60.0, math.inf), along_m)
    assert place[:2] == pytest.approx(unrolled[:2], abs=1e-6)
    assert math.remainder(place.heading_rad - unrolled.heading_rad, math.tau) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("heading_rad", [-2.0, 0.0, 0.7, 2.5])
def test_a_place_is_seen_so_far_ahead_and_to_the_right(heading_rad: float) -> None:
    cosine, sine = math.cos(heading_rad), math.sin(heading_rad)
    place = Pose(5.0 + 3.0 * cosine - 2.0 * sine, 6.0 + 3.0 * sine + 2.0 * cosine, 1.0)
    assert arcs.seen_from(Pose(5.0, 6.0, heading_rad), place) == pytest.approx((3.0, 2.0))


def test_a_path_is_steered_to_by_the_heading_a_step_ahead_and_by_what_it_is_off_where_asked_to() -> None:
    """On a circle to the right that begins at the origin, and off a line northward."""
    circle = Path((Piece(0.0, 0.0, 0.0, 1.0 / RHO_M, math.tau * RHO_M),), 1, 20.0, math.inf)
    line = Path((Piece(0.0, 0.0, 0.0, 0.0, math.inf),), 0, 20.0, math.inf)
    guarded = Guard(replace(PLANE, reaction_s=0.25))
    on_it = arcs.pose_at(circle, 15.0)
    assert guarded._vehicle.steered_rad(circle, 15.0, on_it, 20.0, DT_S, 0.0) == pytest.approx(10.0 / RHO_M)
    assert guarded._vehicle.steered_rad(circle, 15.0, on_it, 20.0, DT_S, DT_S) == pytest.approx(10.0 / RHO_M)
    for beside_m in (-4.0, 4.0):
        pose = Pose(30.0, beside_m, 0.01)
        turn_rad = -math.atan(beside_m / (2.0 * 20.0 * 0.75)) - 0.01
        assert guarded._vehicle.steered_rad(line, 30.0, pose, 20.0, DT_S, DT_S) == pytest.approx(turn_rad)
        assert guarded._vehicle.steered_rad(line, 30.0, pose, 20.0, DT_S, 0.0) == pytest.approx(-0.01)
        far_off = Pose(30.0, 20.0 * beside_m, 0.0)
        most_rad = math.copysign(10.0 / RHO_M, -beside_m)
        assert guarded._vehicle.steered_rad(line, 30.0, far_off, 20.0, DT_S, DT_S) == pytest.approx(most_rad)
        for wind_m_s in (0.5, 5.0):
            windy = Guard(replace(PLANE, wind_m_s=wind_m_s))
            assert windy._vehicle.steered_rad(line, 30.0, far_off, 16.0, DT_S, DT_S) == pytest.approx(most_rad)


def test_no_path_is_steered_to_by_so_much_that_the_side_is_in_doubt() -> None:
    back = Path((Piece(0.0, 0.0, 3.1, 0.0, math.inf),), 0, 60.0, math.inf)
    guarded = Guard(Limits(60.0, 60.0, 10.0, 50.0, 120.0))
    assert guarded._vehicle.steered_rad(back, 0.0, Pose(0.0, 0.0, 0.0), 60.0, 5.0, 0.0) == 3.0


@pytest.mark.parametrize(("wind_m_s", "ground_m_s", "gain_s"), [(0.0, 20.0, 0.0), (0.5, 20.4, DT_S)])
def test_in_any_wind_the_path_in_hand_is_followed_at_the_ground_speed_and_closed_in_on(
    wind_m_s: float, ground_m_s: float, gain_s: float
) -> None:
    guarded = Guard(replace(PLANE, wind_m_s=wind_m_s))
    guarded._path = Path((Piece(0.0, 0.0, 0.0, 0.02, math.tau / 0.02),), 1, 20.0, math.inf)
    guarded._along_m = 7.0
    tip = Pose(7.0, 0.3, 0.2)
    flight = guarded._flight(tip, 20.0, replace(NORTHWARD, speed_m_s=20.4), NOTHING, DT_S, ())
    turn_rad = guarded._vehicle.steered_rad(guarded._path, 7.0, tip, ground_m_s, DT_S, gain_s)
    assert guarded._search(flight, math.inf).continued() == (turn_rad, 20.0)


@pytest.mark.parametrize(("turn_rad", "parts"), [(0.0, 0), (0.78, 1), (-0.79, 2), (-3.0, 4), (6.2, 8)])
def test_a_turn_to_a_ray_comes_in_arcs_of_an_eighth_of_a_circle_at_most(turn_rad: float, parts: int) -> None:
    pieces = arcs.turned(Pose(1.0, 2.0, 0.3), turn_rad, 0.02, 100.0)
    assert len(pieces) == parts + 1
    assert all(abs(piece.curvature_1_m * piece.length_m) <= math.pi / 4.0 for piece in pieces)
    assert pieces[-1][2:] == pytest.approx((0.3 + turn_rad, 0.0, 100.0))
    assert_hangs_together(Path(pieces, 0, 20.0, math.inf))
