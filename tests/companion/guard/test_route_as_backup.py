"""The route as back-up."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.geo.kinematics import turn_towards
from companion.guard import arcs
from companion.guard.arcs import Path, Pose
from companion.guard.backup import BackupSearch, Flight
from companion.guard.guard import Guard
from companion.guard.types import (
    BACKUP,
    KEEP_OUT,
    Discs,
    Hints,
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
    NORTHWARD,
    NOTHING,
    PLANE,
    Vehicle,
    apart_m,
    assert_hangs_together,
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


def test_a_corridor_without_an_end_in_sight_is_not_entered() -> None:
    walls = [(80.0 * k - 60.0, side * 60.0, 50.0) for k in range(30) for side in (1.0, -1.0)]
    route = (Piece(0.0, 0.0, 0.0, 0.0, 2_000.0),)
    assert Guard(PLANE).check(AHEAD, NORTHWARD, discs(*walls), 0.0, DT_S, Hints(route)).changes[0] == KEEP_OUT


def test_a_vehicle_that_can_stop_needs_no_route() -> None:
    blocked = discs((200.0, 0.0, 95.0))
    assert Guard(COPTER).check(AHEAD, NORTHWARD, blocked, 0.0, DT_S, Hints(THROUGH)).changes == (KEEP_OUT,)
