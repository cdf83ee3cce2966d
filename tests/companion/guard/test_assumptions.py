"""The assumptions of the guard, each broken in turn."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from companion.guard.arcs import Path, Pose
from companion.guard.backup import BackupSearch
from companion.guard.guard import Guard
from companion.guard.types import (
    BACKUP,
    KEEP_OUT,
    LATE,
    NEW_THREAT,
    NO_BACKUP,
    NOT_FINITE,
    POSITION,
    RATE,
    THREAT_CHANGED,
    THREAT_FASTER,
    WIND,
    Discs,
    Limits,
    Motion,
    Piece,
    Setpoint,
    Verdict,
)
from companion.guard.vehicle import VehicleModel
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
    box,
    discs,
    sent,
    turn_of,
)


def broken_after(
    limits: Limits = PLANE,
    moved: Callable[[Motion], Motion] = lambda motion: motion,
    later: Discs | None = None,
    first: Discs | None = None,
    now_s: float = DT_S,
) -> tuple[str, ...]:
    """Return what the guard says is broken at its second call, half a second after a turn to the right."""
    first = discs((130.0, 0.0, 20.0)) if first is None else first
    guarded, vehicle = Guard(limits), Vehicle(NORTHWARD, limits)
    wanted = Setpoint(0.2, 20.0, 100.0)
    vehicle.obey(sent(guarded.check(wanted, NORTHWARD, first, 0.0, DT_S)))
    vehicle.fly(now_s)
    return guarded.check(wanted, moved(vehicle.motion), first if later is None else later, now_s, DT_S).broken


def test_where_everything_is_as_assumed_nothing_is_broken() -> None:
    assert broken_after() == ()


@pytest.mark.parametrize(("off_m", "broken"), [(0.099, ()), (0.101, (POSITION,))])
@pytest.mark.parametrize("error_m", [0.0, 3.0])
def test_a_vehicle_that_is_not_where_it_should_be_is_named(
    off_m: float, broken: tuple[str, ...], error_m: float
) -> None:
    limits = replace(PLANE, position_error_m=error_m)
    off_m += 2.0 * error_m
    assert broken_after(limits, lambda motion: replace(motion, north_m=motion.north_m - off_m)) == broken
    assert broken_after(limits, lambda motion: replace(motion, east_m=motion.east_m + off_m)) == broken


@pytest.mark.parametrize(("off_m", "broken"), [(5.09, ()), (5.11, (POSITION,))])
def test_in_wind_a_vehicle_may_be_off_by_what_a_wind_that_turns_right_round_does(
    off_m: float, broken: tuple[str, ...]
) -> None:
    limits = replace(PLANE, wind_m_s=5.0)
    assert broken_after(limits, lambda motion: replace(motion, east_m=motion.east_m - off_m)) == broken


@pytest.mark.parametrize(("off_rad", "broken"), [(0.0199, ()), (0.0201, (RATE,))])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_heading_that_was_not_reached_is_named(off_rad: float, broken: tuple[str, ...], side: float) -> None:
    assert broken_after(moved=lambda motion: replace(motion, heading_rad=motion.heading_rad + side * off_rad)) == broken


@pytest.mark.parametrize(("off_rad", "broken"), [(0.519, ()), (0.521, (RATE,))])
def test_in_wind_a_heading_may_be_off_by_twice_the_share_of_the_wind(off_rad: float, broken: tuple[str, ...]) -> None:
    limits = replace(PLANE, wind_m_s=5.0)
    assert broken_after(limits, lambda motion: replace(motion, heading_rad=motion.heading_rad + off_rad)) == broken


def test_a_vehicle_that_turns_at_half_the_rate_is_named() -> None:
    guarded, vehicle = Guard(PLANE), Vehicle(NORTHWARD, PLANE, share=0.5)
    vehicle.obey(sent(guarded.check(replace(AHEAD, heading_rad=1.0), NORTHWARD, discs((300.0, 0.0, 20.0)), 0.0, DT_S)))
    vehicle.fly(DT_S)
    assert RATE in guarded.check(AHEAD, vehicle.motion, discs((300.0, 0.0, 20.0)), DT_S, DT_S).broken


@pytest.mark.parametrize(("wind_m_s", "from_rad"), [(0.0, 0.2), (0.5, 0.215), (5.0, 0.215)])
def test_the_commanded_heading_is_believed_within_its_tolerance_where_there_is_no_wind(
    wind_m_s: float, from_rad: float
) -> None:
    limits = replace(PLANE, wind_m_s=wind_m_s)
    guarded, vehicle = Guard(limits), Vehicle(NORTHWARD, limits)
    vehicle.obey(sent(guarded.check(replace(AHEAD, heading_rad=0.2), NORTHWARD, NOTHING, 0.0, DT_S)))
    vehicle.fly(DT_S)
    reported = replace(vehicle.motion, heading_rad=vehicle.motion.heading_rad + 0.015)
    verdict = guarded.check(replace(AHEAD, heading_rad=math.nan), reported, NOTHING, DT_S, DT_S)
    assert sent(verdict).heading_rad == pytest.approx(from_rad, abs=1e-9)


def test_without_wind_a_reported_speed_that_is_a_little_off_changes_nothing_of_how_the_path_is_flown() -> None:
    scene = discs((60.0, 0.0, 23.0))
    guarded, vehicle = Guard(PLANE), Vehicle(NORTHWARD, PLANE)
    vehicle.obey(sent(guarded.check(AHEAD, NORTHWARD, scene, 0.0, DT_S)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "accepted", lambda *_: KEEP_OUT)
        vehicle.fly(DT_S)
        verdict = guarded.check(AHEAD, replace(vehicle.motion, speed_m_s=20.3), scene, DT_S, DT_S)
    assert (verdict.changes, verdict.broken) == ((KEEP_OUT, BACKUP), ())
    assert turn_of(verdict, vehicle.motion) == pytest.approx(G_M_S2 / 20.0 * DT_S, abs=1e-9)


@pytest.mark.parametrize(("wind_m_s", "along_m"), [(0.0, 10.0), (0.5, 10.2)])
def test_the_way_along_the_path_is_that_at_the_commanded_speed_or_in_wind_at_the_reported_one(
    wind_m_s: float, along_m: float
) -> None:
    guarded = Guard(replace(PLANE, wind_m_s=wind_m_s))
    guarded.check(AHEAD, NORTHWARD, discs((60.0, 0.0, 20.0)), 0.0, DT_S)
    assert guarded._monitored(replace(NORTHWARD, north_m=10.0, speed_m_s=20.4), DT_S, DT_S) == []
    assert guarded._along_m == pytest.approx(along_m)


@pytest.mark.parametrize(
    ("speed_m_s", "wind_m_s", "broken"),
    [
        (20.49, 0.0, ()),
        (20.51, 0.0, (WIND,)),
        (19.51, 0.0, ()),
        (19.49, 0.0, (WIND,)),
        (25.49, 5.0, ()),
        (25.51, 5.0, (WIND,)),
        (14.51, 5.0, ()),
        (14.49, 5.0, (WIND,)),
    ],
)
def test_a_ground_speed_that_the_bound_on_the_wind_excludes_is_named(
    speed_m_s: float, wind_m_s: float, broken: tuple[str, ...]
) -> None:
    limits = replace(PLANE, wind_m_s=wind_m_s)
    assert broken_after(limits, lambda motion: replace(motion, speed_m_s=speed_m_s)) == broken


@pytest.mark.parametrize(("now_s", "broken"), [(0.5, ()), (0.549, ()), (0.551, (LATE,)), (1.0, (LATE,))])
def test_a_call_that_comes_late_is_named(now_s: float, broken: tuple[str, ...]) -> None:
    assert broken_after(now_s=now_s) == broken


@pytest.mark.parametrize(("grown_m", "broken"), [(0.0, ()), (9.99, ()), (10.01, (THREAT_FASTER,))])
@pytest.mark.parametrize("ids", [None, np.array([7])])
def test_a_disc_outside_its_earlier_self_grown_is_named(
    grown_m: float, broken: tuple[str, ...], ids: np.ndarray | None
) -> None:
    first = replace(discs((130.0, 0.0, 20.0), speed_m_s=2.0), ids=ids)
    for row in ((130.0, 0.0, 21.0 + grown_m), (130.0, -1.0 - grown_m, 20.0), (129.0 - grown_m, 0.0, 20.0)):
        later = replace(discs(row, speed_m_s=2.0), ids=ids)
        assert broken_after(first=first, later=later) == broken


def test_a_disc_that_a_new_picture_has_elsewhere_was_changed_and_is_not_faster_than_its_bound() -> None:
    first = replace(discs((130.0, 0.0, 20.0)), pictures=np.array([1]))
    for later, broken in ((1, (THREAT_FASTER,)), (2, (THREAT_CHANGED,))):
        larger = replace(discs((130.0, 0.0, 60.0)), pictures=np.array([later]))
        assert broken_after(first=first, later=larger) == broken


def test_small_excesses_add_up_even_where_another_disc_is_not_heard_of_any_more() -> None:
    guarded, vehicle = Guard(PLANE), Vehicle(NORTHWARD, PLANE)
    two = replace(discs((130.0, 0.0, 20.0), (130.0, 90.0, 20.0)), ids=np.array([3, 4]))
    larger, larger_still = (replace(discs((130.0, 90.0, 20.0 + by_m)), ids=np.array([4])) for by_m in (8.0, 16.0))
    said = []
    for call, known in enumerate((two, larger, larger_still)):
        verdict = guarded.check(AHEAD, vehicle.motion, known, call * DT_S, DT_S)
        said.append(verdict.broken)
        vehicle.obey(sent(verdict))
        vehicle.fly(DT_S)
    assert said == [(), (), (THREAT_FASTER,)]


def test_a_disc_that_moved_within_its_bound_is_not_named_where_another_is_not_heard_of_any_more() -> None:
    first = replace(discs((330.0, 0.0, 20.0), (330.0, 90.0, 20.0), speed_m_s=15.0), ids=np.array([3, 4]))
    for moved, broken in ((7.4, ()), (17.6, (THREAT_FASTER,))):
        later = replace(discs((330.0, 90.0 + moved, 20.0), speed_m_s=15.0), ids=np.array([4]))
        assert broken_after(first=first, later=later) == broken


def test_small_excesses_add_up_to_a_threat_faster_than_its_bound() -> None:
    guarded, vehicle, named = Guard(PLANE), Vehicle(NORTHWARD, PLANE), []
    for step in range(10):
        scene = discs((300.0 - 3.0 * step, 200.0, 20.0), speed_m_s=2.0)
        verdict = guarded.check(AHEAD, vehicle.motion, scene, step * DT_S, DT_S)
        named.append(THREAT_FASTER in verdict.broken)
        vehicle.obey(sent(verdict))
        vehicle.fly(DT_S)
    # Two metres a step too many: eleven after six steps are above the tolerance of ten, then it counts anew.
    assert named == [False] * 6 + [True] + [False] * 3


def test_a_small_excess_of_one_disc_leaves_the_others_as_they_are_reported() -> None:
    guarded, vehicle, named = Guard(PLANE), Vehicle(NORTHWARD, PLANE), []
    for step in range(10):
        bound_m_s = 2.4 if step else 2.0
        rows = np.array(
            [[300.0 - 3.0 * step, 200.0, 20.0, bound_m_s], [300.0, -200.0 + 7.0 * step, 20.0 - 0.1 * step, 14.0]]
        )
        scene = Discs(rows[:, :2], rows[:, 2], rows[:, 3])
        verdict = guarded.check(AHEAD, vehicle.motion, scene, step * DT_S, DT_S)
        named.append(verdict.broken)
        assert guarded._threats._heard is not None
        kept = (
            guarded._threats._heard.centres_ned_m,
            guarded._threats._heard.radii_m,
            guarded._threats._heard.speeds_m_s,
        )
        assert [tuple(column[1].flat) for column in kept] == [tuple(rows[1, :2]), (rows[1, 2],), (14.0,)]
        earlier = [(300.0, 200.0), (20.0 + step,), (2.0,)] if step < 6 else [tuple(rows[0, :2]), (20.0,), (2.4,)]
        assert step > 6 or [tuple(column[0].flat) for column in kept] == earlier
        vehicle.obey(sent(verdict))
        vehicle.fly(DT_S)
    assert named == [()] * 6 + [(THREAT_FASTER,)] + [()] * 3


@pytest.mark.parametrize("north_m", [60.0, 1.5])
def test_a_small_disc_that_moves_within_its_bound_is_taken_as_it_is_reported(north_m: float) -> None:
    guarded = Guard(PLANE)
    for step in range(3):
        scene = discs((north_m - step, 4.0, 2.0), speed_m_s=2.0)
        guarded.check(AHEAD, replace(NORTHWARD, north_m=10.0 * step), scene, step * DT_S, DT_S)
        assert guarded._threats._heard is not None and guarded._threats._heard.centres_ned_m.tolist() == [
            [north_m - step, 4.0]
        ]
        assert guarded._threats._heard.radii_m.tolist() == [2.0]


def test_a_disc_never_heard_of_is_named() -> None:
    first = discs((130.0, 0.0, 20.0))
    assert broken_after(first=first, later=discs((130.0, 0.0, 20.0), (130.0, 50.0, 20.0))) == (NEW_THREAT,)
    old, other = (replace(first, ids=np.array([key])) for key in (3, 4))
    assert broken_after(first=old, later=other) == (NEW_THREAT,)


def test_a_new_disc_listed_before_one_that_is_too_fast_leaves_both_named_once() -> None:
    first = replace(discs((130.0, 0.0, 20.0), (330.0, 90.0, 20.0)), ids=np.array([3, 4]))
    rows = ((-300.0, 0.0, 20.0), (130.0, 0.0, 20.0), (-400.0, 0.0, 20.0), (330.0, 120.0, 20.0))
    later = replace(discs(*rows), ids=np.array([7, 3, 8, 4]))
    assert broken_after(first=first, later=later) == (NEW_THREAT, THREAT_FASTER)


def test_a_disc_that_appears_where_nothing_was_near_is_named() -> None:
    assert broken_after(first=discs(), later=discs((30.0, 0.0, 20.0))) == (NEW_THREAT,)


def test_a_disc_that_is_not_heard_of_any_more_is_not_named() -> None:
    first = replace(discs((130.0, 0.0, 20.0), (130.0, 90.0, 20.0)), ids=np.array([3, 4]))
    assert broken_after(first=first, later=replace(discs((130.0, 90.0, 20.0)), ids=np.array([4]))) == ()


@pytest.mark.parametrize("moving", [False, True])
def test_a_new_disc_in_the_way_of_the_path_in_hand_ends_it(moving: bool) -> None:
    """Nothing is clear of a disc that appears around the vehicle; one that appears elsewhere leaves the path."""
    speed_m_s = 2.0 if moving else 0.0
    first = discs((75.0, 0.0, 20.0), speed_m_s=speed_m_s)
    for place, certified_s in (((600.0, 0.0, 20.0), math.inf), ((0.0, 0.0, 30.0), 0.0)):
        guarded, vehicle = Guard(PLANE), Vehicle(NORTHWARD, PLANE)
        vehicle.obey(sent(guarded.check(AHEAD, NORTHWARD, first, 0.0, DT_S)))
        vehicle.fly(DT_S)
        later = discs((75.0, 0.0, 20.0 + DT_S * speed_m_s), place, speed_m_s=speed_m_s)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(BackupSearch, "accepted", lambda *_: KEEP_OUT)
            patch.setattr(BackupSearch, "from_tip", lambda *_: KEEP_OUT)
            verdict = guarded.check(AHEAD, vehicle.motion, later, DT_S, DT_S)
        assert verdict.broken == (NEW_THREAT,)
        assert verdict.certified_s == certified_s


def test_a_new_disc_in_the_way_ends_a_path_certified_for_the_horizon() -> None:
    limits, first = replace(PLANE, fence_ned_m=box(1e3)), discs((600.0, 0.0, 20.0), speed_m_s=1.0)
    guarded, vehicle = Guard(limits), Vehicle(NORTHWARD, limits)
    vehicle.obey(sent(guarded.check(AHEAD, NORTHWARD, first, 0.0, DT_S)))
    vehicle.fly(DT_S)
    later = discs((600.0, 0.0, 20.5), (130.0, RHO_M, 60.0), speed_m_s=1.0)
    assert guarded.check(AHEAD, vehicle.motion, later, DT_S, DT_S).broken == (NEW_THREAT,)
    assert guarded._path is None or guarded._along_m == 0.0


@pytest.mark.parametrize(("room_m", "kept"), [(20.0, False), (29.6, True)])
def test_a_circle_certified_for_the_horizon_is_held_only_if_a_new_disc_stays_out_of_it_all_that_time(
    room_m: float, kept: bool
) -> None:
    """Once round takes 13 s; what is left of the horizon after a step is 30 s."""
    limits, first = replace(PLANE, fence_ned_m=box(1e3)), discs((600.0, 0.0, 20.0), speed_m_s=1.0)
    guarded, vehicle = Guard(limits), Vehicle(NORTHWARD, limits)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "ray", lambda *_: None)
        vehicle.obey(sent(guarded.check(AHEAD, NORTHWARD, first, 0.0, DT_S)))
        vehicle.fly(DT_S)
        later = discs((600.0, 0.0, 20.5), (10.0, 300.0, 300.0 - 2.0 * RHO_M - room_m - 0.5), speed_m_s=1.0)
        patch.setattr(BackupSearch, "accepted", lambda *_: KEEP_OUT)
        patch.setattr(BackupSearch, "from_tip", lambda *_: KEEP_OUT)
        verdict = guarded.check(AHEAD, vehicle.motion, later, DT_S, DT_S)
    assert verdict.broken == (NEW_THREAT,)
    assert verdict.changes[-1] == (BACKUP if kept else NO_BACKUP)


@pytest.mark.parametrize("wind_m_s", [0.0, 4.0])
def test_a_ray_in_hand_is_still_clear_up_to_the_new_disc_that_it_grazes(wind_m_s: float) -> None:
    guarded, slow_m_s = Guard(replace(PLANE, wind_m_s=wind_m_s)), 20.0 - wind_m_s
    guarded._path, guarded._left_s = Path((Piece(0.0, 0.0, 0.0, 0.0, math.inf),), 0, 20.0, math.inf), math.inf
    t_s = np.linspace(0.0, 10.0, 100_001)
    edge_m = float(np.min(np.hypot(slow_m_s * t_s - 40.0, 60.0) - 4.0 * t_s)) - guarded._vehicle.inflation_m(DT_S)
    for hair_m, clear in ((-1e-5, True), (1e-5, False)):
        scene = discs((40.0, 60.0, edge_m + hair_m), speed_m_s=4.0)
        flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, scene, DT_S, ())
        assert guarded._still_clear(flight) is clear


@pytest.mark.parametrize("ahead", [False, True])
@pytest.mark.parametrize("off_m", [0.0, 0.09, 0.11, 1.0])
def test_a_vehicle_off_the_path_in_hand_does_not_continue_it(off_m: float, ahead: bool) -> None:
    scene = discs((60.0, 0.0, 23.0))
    guarded, vehicle = Guard(PLANE), Vehicle(NORTHWARD, PLANE)
    vehicle.obey(sent(guarded.check(AHEAD, NORTHWARD, scene, 0.0, DT_S)))
    vehicle.fly(DT_S)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "accepted", lambda *_: KEEP_OUT)
        patch.setattr(BackupSearch, "from_tip", lambda *_: KEEP_OUT)
        at = vehicle.motion
        moved = replace(at, north_m=at.north_m + ahead * off_m, east_m=at.east_m + (not ahead) * off_m)
        verdict = guarded.check(AHEAD, moved, scene, DT_S, DT_S)
    assert verdict.changes[-1] == (NO_BACKUP if off_m > 0.1 else BACKUP)


def test_a_vehicle_off_the_path_in_hand_does_not_continue_it_though_a_new_disc_leaves_that_clear() -> None:
    guarded, scene = Guard(PLANE), discs((60.0, 0.0, 23.0))
    guarded.check(AHEAD, NORTHWARD, scene, 0.0, DT_S)
    later = discs((60.0, 0.0, 23.0), (-600.0, 0.0, 20.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "accepted", lambda *_: KEEP_OUT)
        patch.setattr(BackupSearch, "from_tip", lambda *_: KEEP_OUT)
        verdict = guarded.check(AHEAD, replace(NORTHWARD, north_m=10.0, east_m=5.0), later, DT_S, DT_S)
    assert verdict.broken == (POSITION, NEW_THREAT)
    assert verdict.changes[-1] == NO_BACKUP


@pytest.mark.parametrize(
    "limits", [COPTER, replace(PLANE, wind_m_s=4.0), replace(PLANE, wind_m_s=0.5)], ids=["stops", "wind", "light wind"]
)
@pytest.mark.parametrize(
    ("ahead_m", "beside_m", "kept"), [(3.5, 0.0, True), (-3.5, 0.0, True), (-12.0, 0.0, True), (0.0, 3.5, False)]
)
def test_who_stops_or_flies_in_wind_may_be_farther_along_the_path_but_not_beside_it(
    ahead_m: float, beside_m: float, kept: bool, limits: Limits
) -> None:
    scene, heading_rad = discs((500.0, 0.0, 60.0)), 1.0
    guarded, motion = Guard(limits), replace(NORTHWARD, heading_rad=heading_rad)
    wanted = replace(AHEAD, heading_rad=heading_rad)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(VehicleModel, "reach_m", lambda *_: math.inf)
        guarded.check(wanted, motion, scene, 0.0, DT_S)
        patch.setattr(BackupSearch, "accepted", lambda *_: KEEP_OUT)
        patch.setattr(BackupSearch, "from_tip", lambda *_: KEEP_OUT)
        cosine, sine = math.cos(heading_rad), math.sin(heading_rad)
        along_m = 10.0 + ahead_m
        moved = replace(motion, north_m=along_m * cosine - beside_m * sine, east_m=along_m * sine + beside_m * cosine)
        verdict = guarded.check(wanted, moved, scene, DT_S, DT_S)
    assert verdict.changes[-1] == (BACKUP if kept else NO_BACKUP)
    assert not kept or guarded._along_m == pytest.approx(max(0.0, along_m))


@pytest.mark.parametrize(("beside_m", "kept"), [(3.09, True), (3.11, False)])
def test_in_wind_a_vehicle_may_be_off_the_path_by_what_it_is_tracked_to(beside_m: float, kept: bool) -> None:
    guarded, scene = Guard(replace(PLANE, wind_m_s=4.0)), discs((60.0, 0.0, 5.0))
    guarded.check(AHEAD, NORTHWARD, scene, 0.0, DT_S)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "accepted", lambda *_: KEEP_OUT)
        patch.setattr(BackupSearch, "from_tip", lambda *_: KEEP_OUT)
        verdict = guarded.check(AHEAD, replace(NORTHWARD, north_m=10.0, east_m=-beside_m), scene, DT_S, DT_S)
    assert verdict.changes[-1] == (BACKUP if kept else NO_BACKUP)


@pytest.mark.parametrize("now_s", [1.6, -0.1])
def test_after_a_gap_or_a_clock_that_ran_back_the_guard_begins_anew(now_s: float) -> None:
    guarded = Guard(PLANE)
    guarded.check(AHEAD, NORTHWARD, discs((60.0, 0.0, 23.0)), 0.0, DT_S)
    elsewhere = Motion(1000.0, 0.0, 1.0, 20.0)
    assert guarded.check(AHEAD, elsewhere, discs((960.0, 0.0, 3.0)), now_s, DT_S).broken == ()


def test_a_second_call_at_the_same_time_replaces_the_first() -> None:
    guarded = Guard(PLANE)
    for heading_rad in (0.2, -0.2):
        verdict = guarded.check(replace(AHEAD, heading_rad=heading_rad), NORTHWARD, NOTHING, 5.0, DT_S)
        assert (verdict.changes, verdict.broken) == ((), ())
    vehicle = Vehicle(NORTHWARD, PLANE)
    vehicle.obey(replace(AHEAD, heading_rad=-0.2))
    vehicle.fly(DT_S)
    assert guarded.check(AHEAD, vehicle.motion, NOTHING, 5.5, DT_S).broken == ()


def test_a_second_call_at_the_same_time_knows_what_is_in_flight() -> None:
    guarded, straight_on = Guard(replace(PLANE, reaction_s=1.0)), replace(AHEAD, heading_rad=math.nan)
    guarded.check(replace(AHEAD, heading_rad=0.2), NORTHWARD, NOTHING, 0.0, DT_S)
    on = replace(NORTHWARD, north_m=10.0)
    headings_rad = [sent(guarded.check(straight_on, on, NOTHING, DT_S, DT_S)).heading_rad for _ in range(2)]
    assert headings_rad == pytest.approx([0.2, 0.2])


def test_a_clock_that_is_rounded_to_microseconds_is_no_delay() -> None:
    """As Unix time is: over many steps on a held circle the rounding must not add up."""
    scene = discs((60.0, 0.0, 23.0))
    guarded, vehicle = Guard(PLANE), Vehicle(NORTHWARD, PLANE)
    for step in range(200):
        now_s = 1.7e9 + step * DT_S + (1e-4 if step % 2 else 0.0)
        verdict = guarded.check(replace(AHEAD, heading_rad=0.0), vehicle.motion, scene, now_s, DT_S)
        assert NO_BACKUP not in verdict.changes and verdict.broken == ()
        vehicle.obey(sent(verdict))
        assert apart_m(vehicle.fly(DT_S), scene) > 0.0


@pytest.mark.parametrize("value", BAD)
def test_a_time_that_is_not_finite_gets_no_setpoint(value: float) -> None:
    assert Guard(PLANE).check(AHEAD, NORTHWARD, NOTHING, value, DT_S) == Verdict(None, (NOT_FINITE,))


@pytest.mark.parametrize(("unit_m", "named"), [(0.0, True), (4.0, True), (4.9, False), (27.0, False)])
def test_a_moving_disc_that_is_told_in_coarse_units_may_jump_by_their_rounding(unit_m: float, named: bool) -> None:
    far = replace(discs((900.0, 0.0, 50.0), speed_m_s=5.0), unit_m=unit_m)
    guarded = Guard(PLANE)
    guarded.check(AHEAD, NORTHWARD, far, 0.0, DT_S)
    nearer = replace(far, centres_ned_m=far.centres_ned_m - np.array([[5.0 * DT_S + 12.0, 0.0]]))
    on = replace(NORTHWARD, north_m=20.0 * DT_S)
    assert (THREAT_FASTER in guarded.check(AHEAD, on, nearer, DT_S, DT_S).broken) is named
