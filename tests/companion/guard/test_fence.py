"""The fence."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.guard import arcs
from companion.guard.arcs import Pose
from companion.guard.fence import Fence
from companion.guard.guard import Guard
from companion.guard.types import (
    FENCE,
    NO_BACKUP,
    Limits,
    Motion,
    Piece,
    Setpoint,
    Verdict,
)
from tests.companion.guard.guard_flight import (
    AHEAD,
    COPTER,
    DT_S,
    NORTHWARD,
    NOTHING,
    PIECES,
    PLANE,
    RHO_M,
    SPARE_M,
    Vehicle,
    along,
    assert_refused_from,
    box,
    check,
    discs,
    inside_polygon,
    sent,
)


def fenced(
    limits: Limits, wanted: Setpoint, fence: Callable[[float], tuple[tuple[float, float], ...]]
) -> Callable[[float], Verdict]:
    """Return the verdict as a function of how far the fence has moved in."""
    return lambda inward_m: check(wanted, NORTHWARD, NOTHING, replace(limits, fence_ned_m=fence(inward_m)))


def test_a_vehicle_that_cannot_stop_turns_before_the_fence() -> None:
    edge_m = 300.0 - 10.0 - RHO_M - SPARE_M
    assert_refused_from(edge_m, fenced(PLANE, AHEAD, lambda inward_m: box(300.0 - inward_m)), FENCE)


def test_a_vehicle_that_can_stop_stops_before_the_fence() -> None:
    assert_refused_from(300.0 - 110.0 - SPARE_M, fenced(COPTER, AHEAD, lambda inward_m: box(300.0 - inward_m)), FENCE)


@pytest.mark.parametrize(("limits", "corner_north_m"), [(PLANE, 5.0), (COPTER, 5.0), (COPTER, 60.0)])
def test_step_and_braking_path_keep_clear_of_a_corner_that_sticks_in(limits: Limits, corner_north_m: float) -> None:
    def notched(inward_m: float) -> tuple[tuple[float, float], ...]:
        spit = ((corner_north_m + 1.0, 1e3), (corner_north_m, 100.0 - inward_m), (corner_north_m - 1.0, 1e3))
        return ((-1e3, -1e3), (1e3, -1e3), (1e3, 1e3), *spit, (-1e3, 1e3))

    assert_refused_from(100.0 - SPARE_M, fenced(limits, AHEAD, notched), FENCE)


def test_among_moving_discs_too_the_step_keeps_clear_of_a_corner_that_sticks_in() -> None:
    slow = discs((900.0, -900.0, 10.0), speed_m_s=0.1)

    def notched(inward_m: float) -> Verdict:
        spit = ((6.0, 1e3), (5.0, 100.0 - inward_m), (4.0, 1e3))
        fence = ((-1e3, -1e3), (1e3, -1e3), (1e3, 1e3), *spit, (-1e3, 1e3))
        return check(AHEAD, NORTHWARD, slow, replace(PLANE, fence_ned_m=fence))

    assert_refused_from(100.0 - SPARE_M, notched, FENCE)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_braking_path_may_not_cross_a_spit_of_outside(side: float) -> None:
    spit = ((1e3, -1e3), (1e3, 1e3), (61.0, 1e3), (60.0, -100.0), (59.0, 1e3), (-1e3, 1e3), (-1e3, -1e3))
    fence = tuple((north, side * east) for north, east in spit)
    assert check(AHEAD, NORTHWARD, NOTHING, replace(COPTER, fence_ned_m=fence)).changes[0] == FENCE
    assert check(AHEAD, NORTHWARD, NOTHING, replace(COPTER, fence_ned_m=fence[::-1])).changes[0] == FENCE


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_turning_circle_to_the_free_side_serves_beside_the_fence(side: float) -> None:
    fence = tuple((north, side * east) for north, east in box(1e3, 5.0))
    assert check(AHEAD, NORTHWARD, NOTHING, replace(PLANE, fence_ned_m=fence)).changes == ()


def test_disc_on_one_side_and_fence_on_the_other_are_reported_and_turned_from() -> None:
    limits = replace(PLANE, fence_ned_m=box(70.0))
    assert check(AHEAD, NORTHWARD, discs((10.0, RHO_M + 60.0, 40.0)), limits).changes == ()
    both = check(AHEAD, NORTHWARD, discs((20.0, RHO_M + 60.0, 58.0)), replace(limits, fence_ned_m=box(50.7)))
    assert both.changes[0] == FENCE


def test_a_fence_with_a_corner_given_twice_is_still_a_fence() -> None:
    fence = ((-1e3, -1e3), (300.0, -1e3), (300.0, -1e3), (300.0, 1e3), (-1e3, 1e3))
    assert check(AHEAD, NORTHWARD, NOTHING, replace(PLANE, fence_ned_m=fence)).changes == ()


def test_inside_a_fence_without_any_disc_call_follows_call() -> None:
    guarded, vehicle = Guard(replace(PLANE, fence_ned_m=box(300.0))), Vehicle(NORTHWARD, PLANE)
    for step in range(3):
        verdict = guarded.check(AHEAD, vehicle.motion, NOTHING, step * DT_S, DT_S)
        assert verdict == Verdict(AHEAD, (), certified_s=math.inf)
        vehicle.obey(sent(verdict))
        vehicle.fly(DT_S)


@pytest.mark.slow
@settings(max_examples=100, derandomize=True)
@given(north_m=st.floats(-60.0, 60.0), east_m=st.floats(-60.0, 60.0), turned=st.integers(0, 5), mirrored=st.booleans())
def test_a_still_vehicle_is_inside_a_fence_of_any_shape_exactly_when_it_is(
    north_m: float, east_m: float, turned: int, mirrored: bool
) -> None:
    """An L: easy to say of any point whether it is inside, and concave."""
    corners = [(-50.0, -50.0), (50.0, -50.0), (50.0, 0.0), (0.0, 0.0), (0.0, 50.0), (-50.0, 50.0)]
    inside = max(abs(north_m), abs(east_m)) < 50.0 and not (north_m > 0.0 and east_m > 0.0)
    edges = [abs(abs(north_m) - 50.0), abs(abs(east_m) - 50.0), abs(north_m), abs(east_m)]
    assume(min(edges) > 1e-3)
    fence = tuple((corners[turned:] + corners[:turned])[:: -1 if mirrored else 1])
    still = Motion(north_m, east_m, 0.0, 0.0)
    verdict = check(Setpoint(0.0, 0.0, 100.0), still, NOTHING, replace(COPTER, fence_ned_m=fence))
    assert verdict.changes == (() if inside else (FENCE, NO_BACKUP))


SQUARE = ((-8.0, -8.0), (8.0, -8.0), (8.0, 8.0), (-8.0, 8.0))


@pytest.mark.parametrize(
    ("point", "depth_m"),
    [
        ((0.0, 0.0), 8.0),
        ((7.0, 0.0), 1.0),
        ((0.0, -6.0), 2.0),
        ((9.0, 0.0), -1.0),
        ((-8.0, 11.0), -3.0),
        ((11.0, 12.0), -5.0),
        ((0.0, -12.0), -4.0),
    ],
)
def test_depth_is_the_distance_to_the_fence_negative_outside(point: tuple[float, float], depth_m: float) -> None:
    assert Fence(SQUARE).depth_m(*point) == depth_m
    assert Fence(SQUARE[::-1]).depth_m(*point) == depth_m


def test_an_edge_of_half_a_metre_is_an_edge_like_any_other() -> None:
    spit = ((-8.0, -8.0), (8.0, -8.0), (8.0, 8.0), (0.25, 8.0), (0.25, 2.0), (-0.25, 2.0), (-0.25, 8.0), (-8.0, 8.0))
    assert Fence(spit).depth_m(0.0, 0.0) == 2.0
    assert Fence(spit[::-1]).depth_m(0.1, 0.0) == 2.0


@pytest.mark.slow
@settings(max_examples=300, derandomize=True)
@given(piece=PIECES, north_m=st.floats(-90.0, 90.0), east_m=st.floats(-90.0, 90.0))
def test_the_distance_from_a_piece_is_that_from_its_nearest_point(piece: Piece, north_m: float, east_m: float) -> None:
    nearest_m = float(np.hypot(*(along(piece) - (north_m, east_m)).T).min())
    assert arcs.distance_m(piece, north_m, east_m) == pytest.approx(nearest_m, abs=0.02)
    on_it = arcs.place_on(piece, arcs.nearest_on_m(piece, Pose(north_m, east_m, 0.0)))
    assert math.dist(on_it[:2], (north_m, east_m)) == pytest.approx(nearest_m, abs=0.02)


@pytest.mark.slow
@settings(max_examples=300, derandomize=True)
@given(piece=PIECES, margin_m=st.floats(0.0, 10.0))
def test_a_fence_holds_a_piece_exactly_when_all_of_it_keeps_the_margin(piece: Piece, margin_m: float) -> None:
    corners = ((-60.0, -50.0), (-10.0, 0.0), (-50.0, 60.0), (0.0, 10.0), (55.0, 60.0), (45.0, 0.0), (60.0, -55.0))
    fence = Fence(corners)
    places = along(piece)
    edges = np.array(corners), np.roll(np.array(corners), -1, axis=0) - np.array(corners)
    offset = places[:, None, :] - edges[0]
    shares = np.clip((offset * edges[1]).sum(axis=-1) / (edges[1] ** 2).sum(axis=-1), 0.0, 1.0)
    apart = float(np.hypot(*(offset - shares[..., None] * edges[1]).transpose(2, 0, 1)).min())
    inside = inside_polygon(places, corners)
    assume(abs(apart - margin_m) > 0.05 and apart > 0.05)
    assert fence.holds([piece], margin_m) == (inside and apart >= margin_m)


@settings(max_examples=60, derandomize=True)
@given(
    share=st.floats(0.3, 0.7),
    curvature_1_m=st.just(0.0) | st.floats(1 / 300, 1 / 30) | st.floats(-1 / 30, -1 / 300),
    heading_rad=st.floats(-7.0, 7.0).map(lambda heading_rad: round(heading_rad, 9)),
    tip_m=st.floats(3.0, 25.0),
    mirrored=st.booleans(),
)
def test_a_fence_with_a_spit_of_outside_across_a_piece_does_not_hold_it(
    share: float, curvature_1_m: float, heading_rad: float, tip_m: float, mirrored: bool
) -> None:
    """The ends of the piece are well inside, and so is all of it as soon as the spit ends before it."""
    length_m = min(200.0, 2.0 / abs(curvature_1_m) if curvature_1_m else math.inf)
    piece = Piece(700.0, -300.0, heading_rad, curvature_1_m, length_m)
    at = arcs.place_on(piece, share * length_m)
    cosine, sine = math.cos(at.heading_rad), math.sin(at.heading_rad)
    for reach_m, held in ((tip_m, False), (-5.0, True)):
        corners = [(-1e3, -1e3), (1e3, -1e3), (1e3, 1e3), (0.3, 1e3), (0.0, -reach_m), (-0.3, 1e3), (-1e3, 1e3)]
        fence = [(at.north_m + x * cosine - y * sine, at.east_m + x * sine + y * cosine) for x, y in corners]
        assert Fence(fence[:: -1 if mirrored else 1]).holds([piece], 1.0) is held


@settings(max_examples=150, derandomize=True)
@given(
    piece=PIECES | st.builds(Piece, st.just(3.0), st.just(-5.0), st.floats(-7.0, 7.0), st.just(-0.2), st.just(40.0)),
    places=st.lists(st.tuples(st.floats(-90.0, 90.0), st.floats(-90.0, 90.0)), max_size=5),
)
def test_the_distances_from_a_piece_are_those_of_each_place(piece: Piece, places: list[tuple[float, float]]) -> None:
    norths_m, easts_m = np.array(places).reshape(-1, 2).T
    one_by_one = [arcs.distance_m(piece, *place) for place in places]
    assert arcs.distances_m(piece, norths_m, easts_m).tolist() == pytest.approx(one_by_one, abs=1e-9)


HOUSE = ((-2.0, -2.0), (1.0, -2.0), (1.0, 3.0), (-2.0, 3.0))
"""A polygon to stay outside of, within SQUARE."""


@pytest.mark.parametrize(
    ("point", "depth_m"),
    [
        ((0.0, 0.0), -1.0),
        ((0.0, 2.5), -0.5),
        ((3.0, 0.0), 2.0),
        ((6.5, 0.0), 1.5),
        ((-5.0, 7.0), 1.0),
        ((9.0, 0.0), -1.0),
        ((0.0, 20.0), -12.0),
    ],
)
def test_depth_is_negative_in_an_exclusion_too_and_there_the_distance_out_of_it(
    point: tuple[float, float], depth_m: float
) -> None:
    assert Fence(SQUARE, [HOUSE]).depth_m(*point) == depth_m
    assert Fence(SQUARE[::-1], [HOUSE[::-1]]).depth_m(*point) == depth_m


@pytest.mark.parametrize(("point", "depth_m"), [((0.0, 0.0), -1.0), ((4.0, 0.0), 3.0), ((-40.0, 2.0), 38.0)])
def test_an_exclusion_needs_no_fence(point: tuple[float, float], depth_m: float) -> None:
    assert Fence(None, [HOUSE]).depth_m(*point) == depth_m


@pytest.mark.parametrize(
    ("point", "depth_m"),
    [((9.5, 0.0), -1.5), ((7.5, 0.0), -1.5), ((10.5, 0.0), -1.5), ((4.0, 0.0), 2.0), ((9.5, -6.0), -1.5)],
)
def test_outside_the_fence_and_in_an_exclusion_at_once_is_not_inside(
    point: tuple[float, float], depth_m: float
) -> None:
    """The exclusion reaches over the fence; where both are violated the nearer of their edges counts."""
    gate = ((6.0, -3.0), (12.0, -3.0), (12.0, 3.0), (6.0, 3.0))
    assert Fence(SQUARE, [gate]).depth_m(*point) == depth_m


@pytest.mark.parametrize(
    ("east_m", "depth_m"), [(-7.0, 1.0), (-5.0, -1.0), (-2.5, 1.5), (0.0, -1.0), (2.0, 1.0), (7.0, 1.0)]
)
def test_between_the_teeth_of_an_exclusion_is_outside_of_it(east_m: float, depth_m: float) -> None:
    """A comb with its back in the north and three teeth, each 2 m wide and 3 m from the next."""
    comb = [(4.0, -6.0), (-6.0, -6.0), (-6.0, -4.0), (3.0, -4.0), (3.0, -1.0), (-6.0, -1.0), (-6.0, 1.0), (3.0, 1.0)]
    comb += [(3.0, 4.0), (-6.0, 4.0), (-6.0, 6.0), (4.0, 6.0)]
    assert Fence(SQUARE, [comb]).depth_m(0.0, east_m) == depth_m
    assert Fence(SQUARE, [comb[::-1]]).depth_m(0.0, east_m) == depth_m


def test_the_end_of_a_piece_that_comes_near_an_edge_aslant_keeps_the_margin_too() -> None:
    """The line would reach the edge at 20 m north 0.71 m after the piece ends, which is half a metre from it."""
    aslant = Piece(0.0, 0.0, math.pi / 4.0, 0.0, 19.5 * math.sqrt(2.0))
    assert [Fence(box(20.0)).holds([aslant], margin_m) for margin_m in (0.4, 0.6)] == [True, False]


YARDS = (((-10.0, 0.0), (-50.0, 60.0), (-60.0, -50.0)), ((30.0, -10.0), (5.0, 25.0), (20.0, -5.0), (5.0, -20.0)))


@settings(max_examples=100, derandomize=True)
@given(
    corners=st.none() | st.just(((70.0, -70.0), (40.0, 70.0), (-70.0, 70.0), (-70.0, -70.0))),
    yards=st.lists(st.sampled_from(YARDS), min_size=1, max_size=2, unique=True),
    piece=PIECES,
    margin_m=st.floats(0.0, 5.0),
)
def test_all_polygons_hold_a_piece_exactly_when_each_of_them_does(
    corners: tuple[tuple[float, float], ...] | None,
    yards: list[tuple[tuple[float, float], ...]],
    piece: Piece,
    margin_m: float,
) -> None:
    each = [Fence(None, [yard]) for yard in yards] + ([] if corners is None else [Fence(corners)])
    fence = Fence(corners, yards)
    depths_m = [polygon.depth_m(piece.north_m, piece.east_m) for polygon in each]
    inside_m = [-depth_m for depth_m in depths_m if depth_m < 0.0]
    assert fence.depth_m(piece.north_m, piece.east_m) == (-min(inside_m) if inside_m else min(depths_m))
    assert fence.holds([piece], margin_m) == all(polygon.holds([piece], margin_m) for polygon in each)


@pytest.mark.parametrize("heading_rad", [0.3, 3.5])
def test_a_line_without_end_is_held_unless_it_crosses_something(heading_rad: float) -> None:
    """It begins 10 m south of an exclusion."""
    yard = [(10.0, -100.0), (20.0, -100.0), (20.0, 100.0), (10.0, 100.0)]
    line = Piece(0.0, 0.0, heading_rad, 0.0, math.inf)
    assert Fence(None, [yard]).holds([line], 1.0) is (heading_rad == 3.5)


def test_no_line_in_a_fence_is_longer_than_from_corner_to_corner_of_its_box_and_without_a_fence_any_may_be() -> None:
    fence = ((-3.0, -100.0), (27.0, -80.0), (10.0, -60.0))
    assert Fence(fence, [SQUARE]).longest_m == 50.0
    assert Fence(None, [fence]).longest_m == math.inf


def excluded(limits: Limits) -> Callable[[float], Verdict]:
    """Return the verdict as a function of how far an exclusion ahead has moved in from 300 m."""

    def verdict(inward_m: float) -> Verdict:
        north_m = 300.0 - inward_m
        yard = ((north_m, -500.0), (north_m + 50.0, -500.0), (north_m + 50.0, 500.0), (north_m, 500.0))
        return check(AHEAD, NORTHWARD, NOTHING, replace(limits, exclusions_ned_m=(yard,)))

    return verdict


@pytest.mark.parametrize(("limits", "room_m"), [(PLANE, 10.0 + RHO_M), (COPTER, 110.0)])
def test_without_any_fence_an_exclusion_is_turned_or_stopped_before(limits: Limits, room_m: float) -> None:
    assert_refused_from(300.0 - room_m - SPARE_M, excluded(limits), FENCE)


@pytest.mark.parametrize("over_m", [1e-5, 1e-3, 0.1, 1.0, 10.0])
def test_a_piece_that_leaves_the_fence_and_comes_back_is_not_held(over_m: float) -> None:
    arc = Piece(0.0, 0.0, 0.0, 0.05, 0.05**-1 * math.pi)
    assert not Fence(box(20.0 - over_m)).holds([arc], 1e-6)
    assert Fence(box(20.0 + over_m)).holds([arc], 1e-6)


def test_every_one_of_many_pieces_is_held_or_none_is() -> None:
    """Each alone is shorter than what is left to the fence at the start."""
    row = [Piece(north_m, 0.0, 0.0, 0.0, 6.0) for north_m in (0.0, 6.0, 12.0, 18.0)]
    fences = [Fence(box(north_m)) for north_m in (10.0, 16.0, 22.0, 25.0)]
    assert [fence.holds(row, 0.5) for fence in fences] == [False, False, False, True]
    at_last = [Piece(0.0, 0.0, math.pi / 2.0, 0.0, 20.0), Piece(0.0, 20.0, 0.0, 0.0, 0.9)]
    assert [Fence(box(north_m)).holds(at_last, 1.5) for north_m in (2.0, 2.5)] == [False, True]
    turned = [Piece(0.0, 0.0, 0.0, 0.5, math.tau * 2.0), Piece(0.0, 0.0, 0.0, 0.0, 6.0)]
    assert [Fence(box(north_m)).holds(turned, 0.5) for north_m in (5.0, 7.0)] == [False, True]
