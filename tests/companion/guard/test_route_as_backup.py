"""The route as back-up."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.geo.kinematics import turn_towards
from companion.guard import arcs
from companion.guard.arcs import Path, Pose
from companion.guard.backup import BackupSearch
from companion.guard.guard import Guard
from companion.guard.types import (
    BACKUP,
    KEEP_OUT,
    Discs,
    Hints,
    Motion,
    Piece,
)
from companion.guard.vehicle import Step, VehicleModel
from tests.companion.guard.guard_flight import (
    AHEAD,
    BAD,
    COPTER,
    DT_S,
    G_M_S2,
    NORTHWARD,
    NOTHING,
    PLANE,
    RHO_M,
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


@pytest.mark.parametrize(
    ("dt_s", "places"),
    [
        (0.0525, [1.05 * (count + 1) for count in (*range(10, 731, 10), 735)]),  # 245 a circle: every tenth of 735
        (0.5, [10.0 * (count + 1) for count in range(1, 79)]),  # 26 steps a circle: every one of 78
        (1.0, [20.0 * (count + 1) for count in range(1, 61)]),  # 13 steps a circle: every one of 60
    ],
)
def test_along_the_route_a_circle_is_looked_for_over_three_circles_or_sixty_steps(
    dt_s: float, places: list[float]
) -> None:
    route = (Piece(0.0, 0.0, 0.0, 0.0, 1e4),)
    guarded, looked = Guard(PLANE), []

    def nowhere(_self: BackupSearch, pose: Pose, *_: object) -> str:
        looked.append(pose.north_m)
        return KEEP_OUT

    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, dt_s, route)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "to_rest", nowhere)
        begin = Pose(20.0 * dt_s, 0.0, 0.0)
        assert guarded._search(flight, False).along_route(begin, Step(0.0, 20.0), 0.0) is None
    assert looked == pytest.approx(places)


def test_along_the_route_no_more_than_what_is_left_of_it_is_looked_at() -> None:
    route = (Piece(-300.0, 0.0, 0.0, 0.0, 300.0),)
    guarded, looked = Guard(PLANE), []

    def nowhere(_self: BackupSearch, pose: Pose, *_: object) -> str:
        looked.append(pose.north_m)
        return KEEP_OUT

    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, DT_S, route)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "to_rest", nowhere)
        assert guarded._search(flight, False).along_route(Pose(0.0, 0.0, 0.0), Step(0.0, 20.0), 0.0) is None
    # Straight on from its end for as long as a circle is, 256.3 m.
    assert looked == pytest.approx([10.0 * count for count in range(1, 27)])


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
        return to_rest(self, pose, *rest) if len(looked) == 30 else KEEP_OUT  # type: ignore[arg-type]

    begin = Pose(10.0, 2.0, 0.02)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "to_rest", late)
        path = guarded._search(flight, False).along_route(begin, Step(0.0, 20.0), 0.0)
    assert path is not None and path.loops == 1 and path.pieces[0][:3] == begin
    assert_hangs_together(path)
    assert path.pieces[-1][:3] == looked[-1]
    assert sum(piece.length_m for piece in path.pieces[:-1]) == pytest.approx(300.0)
    along_it = Path(route, 0, 20.0, math.inf)
    meets = arcs.pose_at(along_it, arcs.nearest_along_m(along_it, looked[-1]))
    assert math.dist(meets[:2], looked[-1][:2]) < 0.5


def test_straight_steps_along_the_route_are_one_line() -> None:
    turns_rad = iter([0.1, 0.0, 0.0, -0.2, 0.0, 0.0, 0.0])
    guarded = Guard(PLANE)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, DT_S, THROUGH)
    circle = guarded._search(flight, False).to_rest
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(VehicleModel, "steered_rad", lambda *_: next(turns_rad))
        patch.setattr(
            BackupSearch, "to_rest", lambda _, pose, *rest: circle(pose, *rest) if pose[0] > 69.0 else KEEP_OUT
        )
        path = guarded._search(flight, False).along_route(Pose(0.0, 0.0, 0.0), Step(0.0, 20.0), 0.0)
    assert path is not None
    assert_hangs_together(path)
    arcs_m = [0.1 * RHO_M, 0.2 * RHO_M]
    lengths_m = [arcs_m[0], 30.0 - arcs_m[0], arcs_m[1], 40.0 - arcs_m[1], math.tau * RHO_M]
    assert [piece.length_m for piece in path.pieces] == pytest.approx(lengths_m)


@pytest.mark.parametrize(("spare_m", "clear"), [(2.99, True), (3.01, False)])
def test_what_a_change_of_speed_costs_is_kept_clear_along_the_route_too(spare_m: float, clear: bool) -> None:
    guarded = Guard(PLANE)
    beside = discs((100.0, 60.0, 57.0))
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, beside, DT_S, THROUGH)
    circle = Path((Piece(0.0, 0.0, 0.0, 0.02, math.tau / 0.02),), 1, 20.0, math.inf)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "to_rest", lambda _, pose, *__: circle if pose[0] > 150.0 else KEEP_OUT)
        path = guarded._search(flight, False).along_route(Pose(0.0, 0.0, 0.0), Step(0.0, 20.0), spare_m)
    assert (path is not None) is clear


def test_a_corridor_without_an_end_in_sight_is_not_entered() -> None:
    walls = [(80.0 * k - 60.0, side * 60.0, 50.0) for k in range(30) for side in (1.0, -1.0)]
    route = (Piece(0.0, 0.0, 0.0, 0.0, 2_000.0),)
    assert Guard(PLANE).check(AHEAD, NORTHWARD, discs(*walls), 0.0, DT_S, Hints(route)).changes[0] == KEEP_OUT


def test_a_vehicle_that_can_stop_needs_no_route() -> None:
    blocked = discs((200.0, 0.0, 95.0))
    assert Guard(COPTER).check(AHEAD, NORTHWARD, blocked, 0.0, DT_S, Hints(THROUGH)).changes == (KEEP_OUT,)
