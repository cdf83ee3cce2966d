"""The route as back-up."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geo.kinematics import turn_towards
from companion.guard import arcs
from companion.guard.arcs import Disc, Path, Pose
from companion.guard.backup import BackupSearch, Flight
from companion.guard.guard import Guard
from companion.guard.types import (
    BACKUP,
    KEEP_OUT,
    Discs,
    Hints,
    Limits,
    Motion,
    Piece,
)
from companion.guard.vehicle import Step
from tests.companion.guard.guard_flight import (
    AHEAD,
    BAD,
    COPTER,
    DT_S,
    G_M_S2,
    HAIR,
    NORTHWARD,
    NOTHING,
    PLANE,
    RHO_M,
    SPARE_M,
    Vehicle,
    apart_m,
    assert_hangs_together,
    box,
    check,
    discs,
    sent,
)

GATE = discs((100.0, 60.0, 50.0), (100.0, -60.0, 50.0), (20.0, 60.0, 50.0), (20.0, -60.0, 50.0))
"""A corridor 20 m wide, too narrow for a turning circle; the vehicle is in it and must get through it."""

THROUGH = (Piece(0.0, 0.0, 0.0, 0.0, 400.0),)


def along_route(guarded: Guard, flight: Flight, pose: Pose, spare_m: float) -> Path | None:
    return guarded._search(flight, math.inf).along_route(pose, Step(0.0, 20.0), flight.dt_s, spare_m)


def test_through_a_gap_too_narrow_for_a_circle_the_route_serves() -> None:
    motion = replace(NORTHWARD, north_m=60.0)
    assert check(AHEAD, motion, GATE, PLANE).changes[0] == KEEP_OUT
    guarded = Guard(PLANE)
    verdict = guarded.check(AHEAD, motion, GATE, 0.0, DT_S, Hints(THROUGH))
    assert verdict.changes == () and verdict.certified_s == math.inf
    vehicle = Vehicle(motion, PLANE)
    vehicle.obey(sent(verdict))
    for step in range(1, 40):
        vehicle.fly(DT_S)
        vehicle.obey(sent(guarded.check(replace(AHEAD, heading_rad=2.0), vehicle.motion, GATE, step * DT_S, DT_S)))
        assert apart_m(np.array([[vehicle.motion.north_m, vehicle.motion.east_m]]), GATE) > 0.0


def test_a_curved_route_is_followed_from_where_the_vehicle_meets_it() -> None:
    ring_m = 200.0
    walls = [(ring_m + out, k) for out in (-60.0, 60.0) for k in range(12)]
    rows = [(r * math.sin(k * math.tau / 24.0), ring_m - r * math.cos(k * math.tau / 24.0), 48.0) for r, k in walls]
    route = (Piece(0.0, 0.0, 0.0, 1.0 / ring_m, ring_m * math.pi), Piece(0.0, 2.0 * ring_m, math.pi, 0.0, 300.0))
    at = turn_towards(0.0, 0.0, 0.0, 20.0, 3.0, 0.1, 18.0)
    motion = Motion(at[0] + 1.0, at[1], at[2], 20.0)
    wanted = replace(AHEAD, heading_rad=motion.heading_rad)
    assert check(wanted, motion, discs(*rows), PLANE).changes != ()
    assert Guard(PLANE).check(wanted, motion, discs(*rows), 0.0, DT_S, Hints(route)).changes == ()


@pytest.mark.parametrize("value", BAD)
def test_a_route_that_is_not_finite_is_no_route(value: float) -> None:
    motion = replace(NORTHWARD, north_m=60.0)
    bad = (Piece(value, 0.0, 0.0, 0.0, 400.0),)
    assert Guard(PLANE).check(AHEAD, motion, GATE, 0.0, DT_S, Hints(bad)).changes[0] == KEEP_OUT


def test_a_route_into_a_disc_is_no_back_up() -> None:
    motion = replace(NORTHWARD, north_m=60.0)
    blocked = Discs(np.vstack([GATE.centres_ned_m, [130.0, 0.0]]), np.append(GATE.radii_m, 10.0), np.zeros(5))
    assert Guard(PLANE).check(AHEAD, motion, blocked, 0.0, DT_S, Hints(THROUGH)).changes[0] == KEEP_OUT


def test_a_route_that_ends_in_the_gap_is_a_back_up_only_if_straight_on_from_there_is_clear() -> None:
    motion = replace(NORTHWARD, north_m=60.0)
    short = (Piece(0.0, 0.0, 0.0, 0.0, 90.0),)
    assert Guard(PLANE).check(AHEAD, motion, GATE, 0.0, DT_S, Hints(short)).changes == ()
    closed = Discs(np.vstack([GATE.centres_ned_m, [150.0, 0.0]]), np.append(GATE.radii_m, 10.0), np.zeros(5))
    assert Guard(PLANE).check(AHEAD, motion, closed, 0.0, DT_S, Hints(short)).changes[0] == KEEP_OUT


def test_a_path_in_hand_that_leads_nearly_where_it_is_wanted_is_flown() -> None:
    motion = replace(NORTHWARD, north_m=60.0)
    guard = Guard(PLANE)
    assert guard.check(AHEAD, motion, GATE, 0.0, DT_S, Hints(THROUGH)).changes == ()
    on = replace(motion, north_m=60.0 + motion.speed_m_s * DT_S)
    nearly = replace(AHEAD, heading_rad=0.005)
    verdict = guard.check(nearly, on, GATE, DT_S, DT_S, Hints(THROUGH))
    assert verdict.changes == (BACKUP,)
    assert verdict.setpoint is not None
    assert verdict.setpoint.heading_rad == pytest.approx(0.0, abs=1e-9)


def test_with_keep_right_only_the_circle_to_the_right_takes_the_place_of_a_step_that_would_close_it() -> None:
    closing = discs((60.0, 110.0, 48.0))
    assert Guard(PLANE).check(AHEAD, NORTHWARD, closing, 0.0, DT_S).changes == ()
    guarded = Guard(PLANE)
    verdict = guarded.check(AHEAD, NORTHWARD, closing, 0.0, DT_S, Hints(keep_right=True))
    assert (verdict.changes, verdict.certified_s) == ((KEEP_OUT,), math.inf)
    assert guarded._path is not None and all(piece.curvature_1_m > 0.0 for piece in guarded._path.pieces)
    assert verdict.setpoint is not None
    assert verdict.setpoint.heading_rad == pytest.approx(G_M_S2 / 20.0 * DT_S)


def test_with_keep_right_what_leaves_the_circle_to_the_right_clear_is_let_through() -> None:
    away = discs((60.0, -110.0, 60.0))
    verdict = Guard(PLANE).check(AHEAD, NORTHWARD, away, 0.0, DT_S, Hints(keep_right=True))
    assert (verdict.changes, verdict.certified_s) == ((), math.inf)


def test_with_keep_right_where_no_circle_to_the_right_is_clear_any_other_back_up_serves() -> None:
    closed = discs((0.0, 95.0, 50.0))
    wanted = replace(AHEAD, heading_rad=math.tau - 0.1)
    assert Guard(PLANE).check(wanted, NORTHWARD, closed, 0.0, DT_S, Hints(keep_right=True)).changes == ()


def test_who_can_stop_keeps_no_circle() -> None:
    closing = discs((60.0, 110.0, 48.0))
    assert Guard(COPTER).check(AHEAD, NORTHWARD, closing, 0.0, DT_S, Hints(keep_right=True)).changes == ()


def test_with_short_steps_a_circle_is_looked_for_only_now_and_then_along_the_route() -> None:
    motion = replace(NORTHWARD, north_m=60.0)
    assert Guard(PLANE).check(AHEAD, motion, GATE, 0.0, DT_S / 10.0, Hints(THROUGH)).changes == ()


@pytest.mark.parametrize(("dt_s", "every"), [(0.0525, 10), (0.5, 1), (1.0, 1)])
def test_along_an_arc_of_the_route_a_way_on_is_looked_for_at_each_24th_of_a_circle(dt_s: float, every: int) -> None:
    route = (Piece(0.0, 0.0, 0.0, 1e-3, 1e3),)
    guarded, looked = Guard(PLANE), []

    def nowhere(_self: BackupSearch, pose: Pose, *_: object) -> str:
        looked.append(1e3 * math.asin(pose.north_m / 1e3))
        return KEEP_OUT

    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, dt_s, route)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "to_rest", nowhere)
        along_route(guarded, flight, Pose(0.0, 0.0, 0.0), 0.0)
    step_m = 20.0 * dt_s
    most = 400 if dt_s < 0.1 else math.ceil(1e3 / step_m)
    assert looked[: most // every] == pytest.approx(
        [every * (count + 1) * step_m for count in range(most // every)], abs=0.3
    )


def test_a_whole_straight_line_of_the_route_is_one_stretch_and_a_way_on_is_looked_for_at_its_end() -> None:
    route = (Piece(0.0, 0.0, 0.0, 0.0, 1_004.0),)
    guarded, looked = Guard(PLANE), []

    def nowhere(_self: BackupSearch, pose: Pose, *_: object) -> str:
        looked.append(pose.north_m)
        return KEEP_OUT

    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, DT_S, route)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "to_rest", nowhere)
        assert along_route(guarded, flight, Pose(0.0, 0.0, 0.0), 0.0) is None
    # Straight on from its end for as long as a circle is, 256.3 m.
    assert looked == pytest.approx([1_000.0, 1_010.0, 1_260.0, 1_270.0])


def test_along_the_route_no_more_than_400_stretches_are_looked_at() -> None:
    route = (Piece(0.0, 0.0, 0.0, 1e-5, 1e5),)
    guarded = Guard(PLANE)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, DT_S, route)
    looked = []

    def nowhere(_self: BackupSearch, pose: Pose, *_: object) -> str:
        looked.append(pose)
        return KEEP_OUT

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "to_rest", nowhere)
        assert along_route(guarded, flight, Pose(0.0, 0.0, 0.0), 0.0) is None
    assert len(looked) == 400


@pytest.mark.parametrize("bend_1_m", [0.0, 1.0 / 300.0, -1.0 / 300.0])
def test_the_path_along_the_route_hangs_together_and_its_circle_begins_where_it_was_found_clear(
    bend_1_m: float,
) -> None:
    """The vehicle is a little off the route and closes in on it."""
    route = (Piece(0.0, 0.0, 0.0, 0.0, 150.0), Piece(150.0, 0.0, 0.0, bend_1_m, 400.0))
    guarded, looked = Guard(PLANE), []
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, DT_S, route)
    to_rest = BackupSearch.to_rest

    def late(self: BackupSearch, pose: Pose, *rest: object) -> Path | str:
        looked.append(pose)
        return to_rest(self, pose, *rest) if pose.north_m > 290.0 else KEEP_OUT  # type: ignore[arg-type]

    begin = Pose(10.0, 2.0, 0.02)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "to_rest", late)
        path = along_route(guarded, flight, begin, 0.0)
    assert path is not None and path.loops == 1 and path.pieces[0][:3] == begin
    assert_hangs_together(path)
    assert path.pieces[-1][:3] == looked[-1]
    along_it = Path(route, 0, 20.0, math.inf)
    meets = arcs.pose_at(along_it, arcs.nearest_along_m(along_it, looked[-1]))
    assert math.dist(meets[:2], looked[-1][:2]) < 0.5


@pytest.mark.parametrize(("spare_m", "clear"), [(2.99, True), (3.01, False)])
def test_what_a_change_of_speed_costs_is_kept_clear_along_the_route_too(spare_m: float, clear: bool) -> None:
    guarded = Guard(PLANE)
    beside = discs((100.0, 60.0, 57.0))
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, beside, DT_S, THROUGH)
    circle = Path((Piece(0.0, 0.0, 0.0, 0.02, math.tau / 0.02),), 1, 20.0, math.inf)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "to_rest", lambda _, pose, *__: circle if pose[0] > 150.0 else KEEP_OUT)
        path = along_route(guarded, flight, Pose(0.0, 0.0, 0.0), spare_m)
    assert (path is not None) is clear


@pytest.mark.parametrize("east_m", [200.0, 1_000.0, 5_000.0])
def test_a_route_far_away_is_no_back_up_through_the_discs_on_the_way_to_it(east_m: float) -> None:
    motion = replace(NORTHWARD, north_m=60.0)
    beside = (Piece(0.0, east_m, 0.0, 0.0, 4_000.0),)
    assert Guard(PLANE).check(AHEAD, motion, GATE, 0.0, DT_S, Hints(beside)).changes[0] == KEEP_OUT


ANY_ROUTE = st.lists(
    st.builds(
        Piece,
        st.floats(-600.0, 600.0),
        st.floats(-600.0, 600.0),
        st.floats(-4.0, 4.0),
        st.floats(-0.2, 0.2) | st.just(0.0),
        st.floats(0.0, 400.0),
    ),
    min_size=1,
    max_size=4,
)
"""Pieces that need not hang together, nor be wide enough for the vehicle to follow."""

ANY_DISCS = st.lists(
    st.tuples(st.floats(-600.0, 600.0), st.floats(-600.0, 600.0), st.floats(5.0, 120.0)), min_size=1, max_size=12
)


@settings(max_examples=80, derandomize=True)
@given(route=ANY_ROUTE, rows=ANY_DISCS)
def test_a_path_along_whatever_is_called_a_route_enters_no_disc(
    route: list[Piece], rows: list[tuple[float, float, float]]
) -> None:
    guarded = Guard(PLANE)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, discs(*rows), DT_S, tuple(route))
    path = along_route(guarded, flight, Pose(0.0, 0.0, 0.0), 0.5)
    assert path is None or not any(arcs.is_hit(piece, flight.discs, 0.0, 0.5) for piece in path.pieces)


@settings(max_examples=60, derandomize=True)
@given(route=ANY_ROUTE, rows=ANY_DISCS, disc_m_s=st.floats(0.1, 8.0), wind_m_s=st.just(0.0) | st.floats(0.1, 8.0))
def test_a_path_along_whatever_is_called_a_route_enters_no_moving_disc_at_the_least_speed_over_the_ground(
    route: list[Piece], rows: list[tuple[float, float, float]], disc_m_s: float, wind_m_s: float
) -> None:
    guarded = Guard(replace(PLANE, wind_m_s=wind_m_s))
    scene = discs(*rows, speed_m_s=disc_m_s)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, scene, DT_S, tuple(route))
    path = along_route(guarded, flight, Pose(0.0, 0.0, 0.0), 0.5)
    assert path is None or arcs.is_clear(path.pieces, flight.discs, 20.0 - wind_m_s, DT_S - 1e-6, 0.5 - 1e-6)


def stretches_of(
    limits: Limits, around: Discs, begin: Pose, dt_s: float, horizon_s: float = math.inf
) -> tuple[list[tuple[int, float]], list[Pose]]:
    """Return the number of discs that each stretch is compared with and its time, and where a way on is looked for.

    The route leads 205 m north and turns left; no way on is found.
    """
    guarded, entered, looked = Guard(limits), [], []
    route = (Piece(0.0, 0.0, 0.0, 0.0, 205.0), Piece(205.0, 0.0, 0.0, -0.005, 50.0))
    flight = guarded._flight(begin, 20.0, NORTHWARD, around, dt_s, route)

    def enters(_self: BackupSearch, _pieces: object, near: list[Disc], _step: Step, at_s: float, _: float) -> bool:
        entered.append((len(near), at_s))
        return False

    def way_on(_self: BackupSearch, pose: Pose, *_: object) -> None:
        looked.append(pose)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "_enters", enters)
        patch.setattr(BackupSearch, "_way_on", way_on)
        path = guarded._search(flight, horizon_s).along_route(begin, Step(0.0, 20.0), 0.75, 0.25)
    assert path is None
    return entered, looked


def test_along_the_route_the_time_goes_on_with_every_step() -> None:
    """20 steps of straight line at once, six into the bend and out of it, 25 of the line after it, and one."""
    entered, looked = stretches_of(PLANE, discs((0.0, 900.0, 10.0), speed_m_s=1.0), Pose(0.0, 0.0, 0.0), DT_S)
    times_s = [0.75, 10.75, 11.25, 11.75, 12.25, 12.75, 13.25, 13.75, 26.25]
    assert [at_s for _, at_s in entered] == pytest.approx(times_s)
    assert len(looked) == len(entered)


def test_from_a_place_on_the_route_what_is_left_of_it_is_looked_at() -> None:
    entered, _ = stretches_of(PLANE, discs((0.0, 900.0, 10.0), speed_m_s=1.0), Pose(105.0, 0.0, 0.0), DT_S)
    assert entered[-1][1] == pytest.approx(0.75 + 40 * DT_S)


def test_with_short_steps_a_way_on_is_looked_for_after_the_last_one_and_not_half_a_metre_before_the_end() -> None:
    """The vehicle begins two steps of 1.05 m and half a metre before the end, straight on included."""
    guarded, looked = Guard(PLANE), []
    route = (Piece(0.0, 0.0, 0.0, 0.0, 300.0 * 1.05 + 0.5 - math.tau * RHO_M),)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, 0.0525, route)

    def nowhere(_self: BackupSearch, pose: Pose, *_: object) -> str:
        looked.append(pose.north_m / 1.05)
        return KEEP_OUT

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "to_rest", nowhere)
        assert along_route(guarded, flight, Pose(298.0 * 1.05, 0.0, 0.0), 0.0) is None
    assert looked == pytest.approx([301.0])


def test_along_the_route_the_time_goes_on_as_slowly_as_the_wind_may_blow_the_vehicle() -> None:
    """A step of 10 m may take 10 m / 16 m/s."""
    scene = discs((0.0, 900.0, 10.0), speed_m_s=1.0)
    entered, _ = stretches_of(replace(PLANE, wind_m_s=4.0), scene, Pose(0.0, 0.0, 0.0), DT_S)
    assert [at_s for _, at_s in entered][:3] == pytest.approx([0.75, 0.75 + 20 * 0.625, 0.75 + 21 * 0.625])


@pytest.mark.parametrize(("off_m", "both"), [(29.0, False), (31.0, True)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_disc_far_from_the_route_matters_from_three_steps_off_it_on(off_m: float, both: bool, side: float) -> None:
    near, far = (100.0, 60.0, 10.0), (100.0, 2_000.0, 10.0)
    entered, _ = stretches_of(PLANE, discs(near, far), Pose(40.0, side * off_m, 0.0), DT_S)
    assert entered[0] == (2 if both else 1, 0.75)
    assert entered[20][0] == 1


def test_on_the_route_what_is_within_a_circle_and_six_steps_and_what_a_change_of_speed_costs_matters() -> None:
    reach_m = 2.0 * RHO_M + 60.0 + 0.25
    for hair_m, count in ((-HAIR, 1), (HAIR, 0)):
        north_m = -10.0 - reach_m - SPARE_M - hair_m
        entered, _ = stretches_of(PLANE, discs((north_m, 0.0, 10.0)), Pose(0.0, 0.0, 0.0), DT_S)
        assert entered[0][0] == count


def test_among_moving_discs_all_of_them_matter_along_the_route() -> None:
    entered, _ = stretches_of(PLANE, discs((9e3, 0.0, 10.0), speed_m_s=1.0), Pose(0.0, 0.0, 0.0), DT_S)
    assert {count for count, _ in entered} == {1}


@pytest.mark.parametrize(("wind_m_s", "disc_m_s"), [(0.0, 3.0), (4.0, 3.0), (0.0, 25.0)])
def test_along_the_route_a_moving_disc_is_as_large_as_when_the_vehicle_passes_it(
    wind_m_s: float, disc_m_s: float
) -> None:
    guarded = Guard(replace(PLANE, wind_m_s=wind_m_s))
    line, slow_m_s = Piece(0.0, 0.0, 0.0, 0.0, 100.0), 20.0 - wind_m_s
    t_s = np.linspace(0.0, 100.0 / slow_m_s, 100_001)
    edge_m = float(np.min(np.hypot(slow_m_s * t_s - 70.0, 200.0) - disc_m_s * (2.0 + t_s))) - 0.5
    for hair_m, enters in ((-1e-6, False), (1e-6, True)):
        scene = discs((70.0, 200.0, 10.0), speed_m_s=disc_m_s)
        flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, scene, DT_S, ())
        disc = (70.0, 200.0, edge_m + hair_m, disc_m_s)
        assert guarded._search(flight, math.inf)._enters([line], [disc], Step(0.0, 20.0), 2.0, 0.5) is enters


def test_along_the_route_a_vehicle_that_the_wind_may_hold_in_place_passes_no_moving_disc() -> None:
    guarded = Guard(Limits(8.5, 20.0, 1.0, 50.0, 120.0, wind_m_s=8.2))
    scene = discs((-900.0, 0.0, 10.0), speed_m_s=1.0)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 8.5, NORTHWARD, scene, DT_S, ())
    line = Piece(0.0, 0.0, 0.0, 0.0, 1.0)
    for speed_m_s, enters in ((8.5, True), (8.8, False)):
        step = Step(0.0, speed_m_s)
        assert guarded._search(flight, math.inf)._enters([line], flight.discs, step, 0.0, 0.0) is enters


@pytest.mark.parametrize("disc_m_s", [0.0, 1.0])
@pytest.mark.parametrize(("north_m", "enters"), [(100.6, False), (100.4, True)])
def test_along_the_route_the_fence_is_kept_clear_of_whether_discs_move_or_not(
    disc_m_s: float, north_m: float, enters: bool
) -> None:
    guarded = Guard(replace(PLANE, fence_ned_m=box(north_m)))
    scene = discs((-900.0, 0.0, 10.0), speed_m_s=disc_m_s)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, scene, DT_S, ())
    line = Piece(0.0, 0.0, 0.0, 0.0, 100.0)
    assert guarded._search(flight, math.inf)._enters([line], flight.discs, Step(0.0, 20.0), 0.0, 0.5) is enters


@pytest.mark.parametrize("grown_m", [0.4, 0.6])
def test_along_the_route_discs_that_stand_still_are_kept_clear_of_at_any_time(grown_m: float) -> None:
    guarded = Guard(PLANE)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, DT_S, ())
    line, disc = Piece(0.0, 0.0, 0.0, 0.0, 100.0), (50.0, 20.0, 19.0 + grown_m, 0.0)
    enters = guarded._search(flight, math.inf)._enters([line], [disc], Step(0.0, 20.0), 9.0, 0.5)
    assert enters is (grown_m > 0.5)


@pytest.mark.parametrize("horizon_s", [math.inf, 7.0])
@pytest.mark.parametrize("thorough", [False, True])
def test_among_moving_discs_the_way_on_from_the_route_is_a_ray_clear_from_then_on(
    horizon_s: float, thorough: bool
) -> None:
    guarded, asked = Guard(PLANE), []
    scene = discs((900.0, 0.0, 10.0), speed_m_s=1.0)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, scene, DT_S, ())
    line, at = (Piece(80.0, 0.0, 0.2, 0.0, 140.0),), Pose(80.0, 0.0, 0.2)

    def ray(_self: BackupSearch, *arguments: object) -> tuple[Piece, ...] | None:
        asked.append(arguments)
        return line if len(asked) == 1 else None

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "ray", ray)
        search = guarded._search(flight, horizon_s)
        onward = [search._way_on(at, Step(0.1, 20.0), flight.discs, 4.5, 0.25, thorough) for _ in range(2)]
    assert onward == [Path(line, 0, 20.0, 4.5 + horizon_s), None]
    assert asked == [(at, 20.0, 4.5, 0.25, thorough)] * 2


def test_only_where_the_route_ends_are_all_headings_of_a_ray_tried() -> None:
    guarded, asked = Guard(PLANE), []
    scene = discs((9e3, 0.0, 10.0), speed_m_s=1.0)
    route = (Piece(0.0, 0.0, 0.0, 0.0, 100.0), Piece(100.0, 0.0, 0.0, 0.005, 350.5 - math.tau * RHO_M))
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, scene, DT_S, route)

    def ray(_self: BackupSearch, pose: Pose, _m_s: float, at_s: float, spare_m: float, thorough: bool) -> None:
        asked.append((at_s, spare_m, thorough))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "ray", ray)
        path = guarded._search(flight, math.inf).along_route(Pose(0.0, 0.0, 0.0), Step(0.0, 20.0), 0.5, 0.25)
    assert path is None
    assert {thorough for _, _, thorough in asked[:-1]} == {False} and asked[-1][2]
    assert {spare_m for _, spare_m, _ in asked} == {0.25}
    # With straight on for the length of a circle it is 450.5 m: a step is looked at beyond the 45 whole ones.
    assert [at_s for at_s, _, _ in asked[-2:]] == pytest.approx([0.5 + 45 * DT_S, 0.5 + 46 * DT_S])


def test_among_moving_discs_the_route_serves_through_a_gap_too_narrow_to_turn_in() -> None:
    """A disc shuts the way straight on, so that nothing but the route leads out; one far behind moves."""
    guarded, motion = Guard(PLANE), replace(NORTHWARD, north_m=10.0)
    bent = (Piece(0.0, 0.0, 0.0, 0.0, 140.0), Piece(140.0, 0.0, 0.0, 1.0 / 60.0, 94.0))
    shut = Discs(
        np.vstack([GATE.centres_ned_m, [400.0, 0.0], [-500.0, 0.0]]),
        np.append(GATE.radii_m, [200.0, 20.0]),
        np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.0]),
    )
    assert check(AHEAD, motion, shut, PLANE).changes[0] == KEEP_OUT
    verdict = guarded.check(AHEAD, motion, shut, 0.0, DT_S, Hints(bent))
    assert (verdict.changes, verdict.certified_s) == ((), math.inf)
    assert_hangs_together(guarded._path)


def test_a_corridor_without_an_end_in_sight_is_not_entered() -> None:
    walls = [(80.0 * k - 60.0, side * 60.0, 50.0) for k in range(30) for side in (1.0, -1.0)]
    route = (Piece(0.0, 0.0, 0.0, 0.0, 2_000.0),)
    assert Guard(PLANE).check(AHEAD, NORTHWARD, discs(*walls), 0.0, DT_S, Hints(route)).changes[0] == KEEP_OUT


def test_a_vehicle_that_can_stop_needs_no_route() -> None:
    blocked = discs((200.0, 0.0, 95.0))
    assert Guard(COPTER).check(AHEAD, NORTHWARD, blocked, 0.0, DT_S, Hints(THROUGH)).changes == (KEEP_OUT,)
