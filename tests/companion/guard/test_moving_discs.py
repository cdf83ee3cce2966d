"""Discs that move."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.guard import arcs, backup
from companion.guard.arcs import Path, Pose
from companion.guard.backup import BackupSearch
from companion.guard.guard import Guard
from companion.guard.types import (
    BACKUP,
    KEEP_OUT,
    NO_BACKUP,
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
    COPTER,
    DT_S,
    G_M_S2,
    NORTHWARD,
    NOTHING,
    PLANE,
    SPARE_M,
    Vehicle,
    apart_m,
    assert_refused_from,
    box,
    check,
    discs,
    sent,
)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_straight_away_from_a_slower_disc_is_clear_for_ever(share: float, side: float) -> None:
    verdict = check(AHEAD, NORTHWARD, discs((-30.0, side * 5.0, 20.0), speed_m_s=share * 20.0), PLANE)
    assert (verdict.changes, verdict.certified_s) == ((), math.inf)


def test_during_the_step_a_moving_disc_grows_with_time() -> None:
    """Flown north at 20 m/s past a disc at the side that grows at 4: nearest where the ray leans back by a fifth."""
    scene = lambda radius_m: check(AHEAD, NORTHWARD, discs((3.0, 60.0, radius_m), speed_m_s=4.0), PLANE)  # noqa: E731
    t_s = np.linspace(0.0, 30.0, 600_001)
    edge_m = float(np.min(np.hypot(20.0 * t_s - 3.0, 60.0) - 4.0 * t_s)) - SPARE_M
    assert_refused_straight_on(edge_m, scene)


def assert_refused_straight_on(edge_m: float, scene: Callable[[float], Verdict]) -> None:
    """Assert that straight on for ever is clear up to an edge only; beyond it another heading may still serve."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "likely_headings_rad", lambda _self, pose, _discs: iter([pose.heading_rad]))
        patch.setattr(backup, "fan_rad", lambda *_: [])
        assert_refused_from(edge_m, scene, hair_m=1e-6)


@pytest.mark.slow
@settings(max_examples=150, derandomize=True)
@given(
    north_m=st.floats(-300.0, 300.0),
    east_m=st.floats(-300.0, 300.0),
    share=st.floats(0.0, 0.95),
    lasts_s=st.floats(1.0, 60.0) | st.just(math.inf),
)
def test_a_line_is_met_exactly_when_some_moment_of_it_is_inside(
    north_m: float, east_m: float, share: float, lasts_s: float
) -> None:
    t_s = np.linspace(0.0, min(lasts_s, 800.0), 200_001)
    room_m = np.hypot(10.0 * t_s - north_m, east_m) - 10.0 * share * t_s
    edge_m = float(room_m.min())
    assume(edge_m > 1.0)
    line = Piece(0.0, 0.0, 0.0, 0.0, 10.0 * lasts_s)
    for radius_m, met in ((edge_m - 0.01, False), (edge_m + 0.01, True)):
        disc = (north_m, east_m, radius_m - 0.5 - 2.0 * 10.0 * share, 10.0 * share)
        assert arcs.is_met(line, [disc], 10.0, 2.0, lasts_s, 0.5) is met


@pytest.mark.parametrize("share", [1.0, 1.5])
def test_a_disc_as_fast_as_the_vehicle_is_judged_at_the_end_of_its_time(share: float) -> None:
    line = Piece(0.0, 0.0, 0.0, 0.0, 100.0)
    edge_m = math.hypot(100.0 - 30.0, 400.0) - 10.0 * share * 10.0
    disc = (30.0, 400.0, edge_m, 10.0 * share)
    assert not arcs.is_met(line, [disc], 10.0, 0.0, 10.0, -1e-9)
    assert arcs.is_met(line, [disc], 10.0, 0.0, 10.0, 1e-9)


@pytest.mark.parametrize(("spare_m", "met"), [(0.0, True), (-1.0, False)])
def test_a_disc_that_is_hardly_slower_may_reach_a_line_in_between(spare_m: float, met: bool) -> None:
    """Inside from 78 to 122 s, clear again long before the end."""
    line, disc = Piece(97.9, 48.12, 0.0, 0.0, 10_000.0), (0.0, 0.0, 100.0, 9.99)
    t_s = np.linspace(0.0, 1000.0, 10_001)
    room_m = np.hypot(97.9 + 10.0 * t_s, 48.12) - 100.0 - spare_m - 9.99 * t_s
    assert bool((room_m < 0.0).any()) is met and room_m[0] > 0.0 and room_m[-1] > 0.0
    assert arcs.is_met(line, [disc], 10.0, 0.0, 1000.0, spare_m) is met


def test_a_disc_that_is_hardly_slower_does_not_reach_a_line_that_leads_away_from_it() -> None:
    """Half a centimetre clear at the start, and more and more from then on."""
    line, disc = Piece(99.99, math.sqrt(10_001.0 - 99.99**2), 0.0, 0.0, math.inf), (0.0, 0.0, 100.0, 9.99)
    assert not arcs.is_met(line, [disc], 10.0, 0.0, math.inf, 0.0)


def test_inside_a_disc_a_line_is_met_even_straight_away() -> None:
    assert arcs.is_met(Piece(0.0, 0.0, 0.0, 0.0, math.inf), [(-1.0, 0.0, 2.0, 1.0)], 10.0, 0.0, math.inf, 0.0)


@settings(max_examples=60, derandomize=True)
@given(seed=st.integers(0, 10_000), endless=st.booleans(), coarse=st.booleans())
def test_the_fan_offers_exactly_the_turns_that_are_clear_one_by_one(seed: int, endless: bool, coarse: bool) -> None:
    rng = np.random.default_rng(seed)
    table = np.column_stack(
        [rng.uniform(-600, 600, (6, 2)), rng.uniform(5, 90, 6), rng.choice([0.0, 3.0, 9.0, 20.0, 21.0], 6)]
    )
    if endless:
        table[:, 3] = np.minimum(table[:, 3], 9.0)
    pose = Pose(0.0, 0.0, float(rng.uniform(-4, 4)))
    length_m = math.inf if endless else 500.0
    most_rad = 3.0 if coarse else math.tau
    offered = arcs.fan_rad(pose, 0.02, length_m, 20.0, table, most_rad)
    rows = [tuple(row) for row in table.tolist()]
    one_by_one = []
    for steps in range(-32, 33):
        turn_rad = steps * math.tau / 32
        if abs(turn_rad) > most_rad + 1e-9:
            continue
        pieces = arcs.turned(pose, turn_rad, 0.02, length_m)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(arcs, "SUB_ARC_RAD", math.tau / 32 + 1e-9)
            pieces = arcs.turned(pose, turn_rad, 0.02, length_m)
        if arcs.is_clear(pieces, rows, 20.0, 0.0, 0.0):
            one_by_one.append(turn_rad)
    assert sorted({round(turn_rad, 9) for turn_rad in offered}) == [round(turn_rad, 9) for turn_rad in one_by_one]
    assert [abs(turn_rad) for turn_rad in offered] == sorted(abs(turn_rad) for turn_rad in offered)


@pytest.mark.parametrize(
    ("north_m", "disc_m_s"),
    [(300.0, 0.0), (300.0, 4.0), (10.0, 0.0), (800.0, 20.0), (-7699.5, 20.0), (-2644.5, 19.99)],
)
def test_the_fan_offers_a_line_up_to_the_disc_it_grazes(north_m: float, disc_m_s: float) -> None:
    t_s = np.linspace(0.0, 25.0, 250_001)
    edge_m = float(np.min(np.hypot(20.0 * t_s - north_m, 90.0) - disc_m_s * t_s))
    for radius_m, offered in ((edge_m - 1e-4, [0.0, 0.0]), (edge_m + 1e-4, [])):
        table = np.array([[north_m, 90.0, radius_m, disc_m_s], [-1e4, 0.0, 1.0, 0.0]])
        assert arcs.fan_rad(Pose(0.0, 0.0, 0.0), 0.02, 500.0, 20.0, table, 0.1) == offered


def test_the_fan_offers_the_mildest_turn_first_and_of_two_the_one_to_the_right() -> None:
    far = np.array([[-1e5, 0.0, 1.0, 3.0]])
    step_rad = math.tau / 32.0
    offered = arcs.fan_rad(Pose(0.0, 0.0, 0.3), 0.02, 500.0, 20.0, far, 3.0)
    assert len(offered) == 2 * 16
    assert offered[:5] == pytest.approx([0.0, 0.0, step_rad, -step_rad, 2.0 * step_rad])
    assert offered[-1] == pytest.approx(-15.0 * step_rad)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("heading_rad", [0.4, -2.5])
def test_the_fan_offers_no_turn_past_a_disc_on_its_arc(heading_rad: float, side: float) -> None:
    """The disc is 1.03 rad along the arc, between the fifth step and the sixth; the line after the fifth meets it."""
    pose = Pose(30.0, -20.0, heading_rad)
    on_arc = arcs.place_on(Piece(*pose, side * 0.02, 0.0), 50.0 * 1.03)
    table = np.array([[*on_arc[:2], 1.0, 0.0]])
    offered = arcs.fan_rad(pose, 0.02, math.inf, 20.0, table, 3.0)
    passed = sorted(abs(turn_rad) for turn_rad in offered if side * turn_rad > 0.0)
    assert passed == pytest.approx([count * math.tau / 32.0 for count in range(1, 5)])


def test_the_fan_offers_a_turn_away_from_a_disc_that_grows_over_where_the_turn_began() -> None:
    """After a quarter of a circle, 3.9 s, the disc behind has a radius of 37 m; the turn began 30 m from its centre."""
    behind = np.array([[-30.0, 0.0, 25.0, 3.0]])
    assert math.pi / 2.0 in arcs.fan_rad(Pose(0.0, 0.0, 0.0), 0.02, math.inf, 20.0, behind, 3.0)


def test_on_an_arc_a_moving_disc_counts_as_large_as_at_its_end() -> None:
    arc = Piece(0.0, 0.0, 0.0, 0.02, 25.0)
    far_m = math.dist(
        (50.0 * math.sin(0.25), 50.0 - 50.0 * math.cos(0.25)), (200.0 * math.sin(0.25), 50.0 - 200.0 * math.cos(0.25))
    )
    disc = (200.0 * math.sin(0.25), 50.0 - 200.0 * math.cos(0.25), far_m - 3.0 * (25.0 / 20.0 + 1.0), 3.0)
    assert arcs.is_clear([arc], [disc], 20.0, 1.0, -1e-9)
    assert not arcs.is_clear([arc], [disc], 20.0, 1.0, 1e-9)


def test_in_coarse_steps_no_arc_to_a_ray_turns_so_far_that_its_side_is_in_doubt() -> None:
    """Straight away from the disc ahead would be half a circle."""
    limits = Limits(60.0, 60.0, 10.0, 50.0, 120.0)
    motion, wanted = replace(NORTHWARD, speed_m_s=60.0), replace(AHEAD, speed_m_s=60.0)
    guarded = Guard(limits)
    verdict = guarded.check(wanted, motion, discs((900.0, 0.0, 300.0), speed_m_s=20.0), 0.0, 5.0)
    assert (verdict.changes, verdict.certified_s) == ((), math.inf)
    assert guarded._path is not None
    turns_rad = [piece.curvature_1_m * piece.length_m for piece in guarded._path.pieces if piece.curvature_1_m]
    assert 1.0 < abs(sum(turns_rad)) <= 3.0


@pytest.mark.parametrize("slow_m_s", [0.1, 5.0])
@pytest.mark.parametrize("order", [1, -1])
def test_one_moving_disc_is_enough_for_a_turning_circle_not_to_serve(order: int, slow_m_s: float) -> None:
    """Turning for ever in front of a growing disc is no path; nor is it past a standing one that is listed before."""
    speeds_m_s = np.array([0.0, slow_m_s])[::order]
    scene = Discs(np.array([[130.0, 60.0], [130.0, -60.0]]), np.array([40.0, 40.0]), speeds_m_s)
    guarded = Guard(PLANE)
    guarded.check(replace(AHEAD, heading_rad=0.2), NORTHWARD, scene, 0.0, DT_S)
    assert guarded._path is not None and math.isinf(guarded._path.pieces[-1].length_m)


def test_a_disc_as_fast_as_the_vehicle_is_kept_clear_of_for_the_horizon_and_no_longer() -> None:
    limits = replace(PLANE, horizon_s=7.0)
    verdict = check(AHEAD, NORTHWARD, discs((500.0, 0.0, 50.0), speed_m_s=20.0), limits)
    assert (verdict.changes, verdict.certified_s) == ((), 7.5)


@pytest.mark.parametrize(("disc_m_s", "certified_s"), [(15.9, math.inf), (16.0, 30.5), (17.0, 30.5)])
def test_in_wind_as_fast_as_the_vehicle_means_as_fast_as_it_is_up_wind(disc_m_s: float, certified_s: float) -> None:
    scene = discs((5000.0, 0.0, 50.0), speed_m_s=disc_m_s)
    assert check(AHEAD, NORTHWARD, scene, replace(PLANE, wind_m_s=4.0)).certified_s == certified_s


@pytest.mark.parametrize(
    ("limits", "unit_s"),
    [
        (Limits(20.0, 20.0, 1.0, 50.0, 120.0, reaction_s=0.7, wind_m_s=4.0), 0.7 + math.tau * 24.0 / G_M_S2),
        (Limits(0.0, 20.0, 1.0, 50.0, 120.0, braking_m_s2=4.0), math.tau * 20.0 / G_M_S2 + 5.0),
    ],
)
def test_unless_it_is_given_the_horizon_is_64_8_or_1_times_the_time_to_react_turn_around_and_stop(
    limits: Limits, unit_s: float
) -> None:
    assert VehicleModel(limits).horizons_s() == pytest.approx((64.0 * unit_s, 8.0 * unit_s, 1.0 * unit_s))


@pytest.mark.parametrize(("north_m", "count"), [(9_000.0, 64.0), (2_000.0, 8.0), (400.0, 1.0), (100.0, None)])
def test_of_the_horizons_the_longest_that_is_clear_is_certified(north_m: float, count: float | None) -> None:
    limits = replace(PLANE, horizon_s=None)
    scene = discs((north_m, 0.0, 50.0), speed_m_s=25.0)
    unit_s = math.tau * 20.0 / G_M_S2
    assert Guard(limits).certify(NORTHWARD, scene, DT_S) == pytest.approx(0.0 if count is None else count * unit_s)
    certified_s = 0.0 if count is None else DT_S + count * unit_s
    assert check(AHEAD, NORTHWARD, scene, limits).certified_s == pytest.approx(certified_s)


def test_among_slower_discs_only_the_longest_horizon_takes_the_place_of_for_ever() -> None:
    guarded = Guard(replace(PLANE, horizon_s=None))
    longest_s = 64.0 * math.tau * 20.0 / G_M_S2
    assert guarded._horizons_s(discs((0.0, 0.0, 1.0), speed_m_s=19.9), 20.0) == pytest.approx((math.inf, longest_s))
    assert len(guarded._horizons_s(discs((0.0, 0.0, 1.0), speed_m_s=20.0), 20.0)) == 3


@pytest.mark.parametrize(("nth", "found"), [(8, True), (9, False)])
def test_of_the_headings_that_the_fan_offers_the_first_eight_are_compared_with_the_fence(nth: int, found: bool) -> None:
    """The fence is 200 m north and far elsewhere; all headings but the one at nth place lead out of it."""
    guarded = Guard(replace(PLANE, fence_ned_m=((-5e3, -5e3), (200.0, -5e3), (200.0, 5e3), (-5e3, 5e3))))
    scene = discs((-900.0, 0.0, 50.0), speed_m_s=2.0)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, scene, DT_S, ())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(backup, "fan_rad", lambda *_: [0.0] * (nth - 1) + [math.pi / 2.0])
        ray = guarded._search(flight, 30.0).ray(flight.tip, 20.0, 0.0, 0.0, True)
    assert (ray is not None) is found


@pytest.mark.parametrize(("horizon_s", "looked_for"), [(9.9, True), (10.1, False)])
def test_a_ray_longer_than_the_fence_is_not_looked_for(horizon_s: float, looked_for: bool) -> None:
    guarded = Guard(replace(PLANE, fence_ned_m=((-60.0, -80.0), (60.0, -80.0), (60.0, 80.0), (-60.0, 80.0))))
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, discs((0.0, 900.0, 5.0), speed_m_s=2.0), DT_S, ())
    looked: list[Pose] = []

    def headings_rad(_self: BackupSearch, pose: Pose, _discs: object) -> Iterator[float]:
        looked.append(pose)
        return iter(())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "likely_headings_rad", headings_rad)
        guarded._search(flight, horizon_s).ray(flight.tip, 20.0, 0.0, 0.0, False)
    assert looked == [flight.tip] * looked_for


def test_moving_discs_inside_a_fence_are_kept_clear_of_for_the_horizon() -> None:
    limits = replace(PLANE, fence_ned_m=box(1e3), horizon_s=7.0)
    verdict = check(AHEAD, NORTHWARD, discs((500.0, 0.0, 50.0), speed_m_s=1.0), limits)
    assert (verdict.changes, verdict.certified_s) == ((), 7.5)


def test_a_vehicle_that_can_stop_stands_clear_of_moving_discs_for_the_horizon() -> None:
    limits = replace(COPTER, horizon_s=7.0)
    edge_m = 500.0 - 110.0 - SPARE_M - 3.0 * 7.5
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "ray", lambda *_: None)
        assert_refused_from(
            edge_m, lambda radius_m: check(AHEAD, NORTHWARD, discs((500.0, 0.0, radius_m), speed_m_s=3.0), limits)
        )


def test_a_vehicle_that_can_stop_is_not_made_to_flee_from_a_slow_disc_for_ever() -> None:
    """It may slow down to a hover for as long as the horizon, rather than keep its speed to be clear for ever."""
    verdict = check(replace(AHEAD, speed_m_s=1.0), NORTHWARD, discs((500.0, 0.0, 50.0), speed_m_s=3.0), COPTER)
    assert (verdict.changes, verdict.certified_s) == ((), 30.5)
    for slow_m_s in (0.5, 3.0):
        assert check(AHEAD, NORTHWARD, discs((500.0, 0.0, 50.0), speed_m_s=slow_m_s), COPTER).certified_s == 30.5


def test_a_vehicle_that_hovers_beside_a_moving_disc_cannot_fly_from_it_at_no_speed() -> None:
    still = Motion(0.0, 0.0, 0.0, 0.0)
    verdict = check(Setpoint(0.0, 0.0, 100.0), still, discs((50.0, 0.0, 20.0), speed_m_s=3.0), COPTER)
    assert verdict.changes == (KEEP_OUT, NO_BACKUP)


def test_where_nothing_is_clear_for_ever_the_horizon_is_what_is_certified() -> None:
    """Surrounded by slow discs whose growth closes every gap at last."""
    ring = [(800.0 * math.cos(a), 800.0 * math.sin(a), 190.0) for a in np.linspace(0.0, math.tau, 13)[:-1]]
    verdict = check(AHEAD, NORTHWARD, discs(*ring, speed_m_s=2.0), PLANE)
    assert verdict.changes == ()
    assert verdict.certified_s == 30.5


def test_where_no_disc_was_near_before_the_horizon_is_certified_as_well() -> None:
    ring = [(800.0 * math.cos(a), 800.0 * math.sin(a), 190.0) for a in np.linspace(0.0, math.tau, 13)[:-1]]
    guarded = Guard(PLANE)
    assert guarded.check(AHEAD, NORTHWARD, NOTHING, 0.0, DT_S).certified_s == math.inf
    verdict = guarded.check(AHEAD, replace(NORTHWARD, north_m=10.0), discs(*ring, speed_m_s=2.0), DT_S, DT_S)
    assert (verdict.changes, verdict.certified_s) == ((), 30.5)


@pytest.mark.parametrize("disc_m_s", [20.0, 30.0])
def test_a_ray_that_is_clear_for_the_horizon_is_certified_for_no_longer(disc_m_s: float) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "to_rest", lambda *_: KEEP_OUT)
        verdict = check(AHEAD, NORTHWARD, discs((900.0, 0.0, 50.0), speed_m_s=disc_m_s), replace(PLANE, horizon_s=7.0))
    assert (verdict.changes, verdict.certified_s) == ((), 7.5)


def test_on_the_arc_to_a_ray_a_disc_is_as_large_as_while_the_arc_is_flown() -> None:
    """At the end of the arc, after 1.4 s, the disc behind is 6 m off it; it would be in it 1.4 s later."""
    guarded = Guard(PLANE)
    scene = Discs(np.array([[-60.0, 0.0], [100.0, -20.0]]), np.array([40.0, 22.0]), np.array([10.0, 0.0]))
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, scene, DT_S, ())
    guarded._path = Path((Piece(0.0, 0.0, 0.7, 0.0, math.inf),), 0, 20.0, math.inf)
    ray = guarded._search(flight, math.inf).ray(flight.tip, 20.0, 0.0, 0.0, False)
    assert ray is not None and ray[-1].heading_rad == pytest.approx(0.7)


def test_only_the_wanted_step_and_the_way_from_the_tip_are_worth_a_look_at_all_headings() -> None:
    thoroughly: list[object] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "ray", lambda *arguments: thoroughly.append(arguments[-1]))
        check(AHEAD, NORTHWARD, discs((900.0, 0.0, 50.0), speed_m_s=2.0), PLANE)
    assert thoroughly[:6] == [True, False, False, False, False, True]


def test_what_is_certified_for_the_horizon_runs_out() -> None:
    """The one path of a guard that is refused everything else: its time goes by and is gone."""
    ring = [(800.0 * math.cos(a), 800.0 * math.sin(a), 190.0) for a in np.linspace(0.0, math.tau, 13)[:-1]]
    guarded, vehicle = Guard(replace(PLANE, horizon_s=1.0)), Vehicle(NORTHWARD, PLANE)
    left_s = []
    scene = discs(*ring, speed_m_s=2.0)
    vehicle.obey(sent(guarded.check(AHEAD, NORTHWARD, scene, 0.0, DT_S)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "accepted", lambda *_: KEEP_OUT)
        patch.setattr(BackupSearch, "from_tip", lambda *_: KEEP_OUT)
        for step in range(1, 4):
            vehicle.fly(DT_S)
            verdict = guarded.check(AHEAD, vehicle.motion, scene, step * DT_S, DT_S)
            vehicle.obey(sent(verdict))
            left_s.append(verdict.certified_s)
    assert left_s == [1.0, 0.5, 0.0]
    assert verdict.changes[-2:] == (KEEP_OUT, NO_BACKUP)


@pytest.mark.parametrize(("off", "left_s"), [(0.0, 1.0), (4e-4, 1.0), (-4e-4, 1.0), (6e-4, 0.9994)])
def test_two_calls_a_thousandth_of_a_step_off_it_count_as_one_step_apart(off: float, left_s: float) -> None:
    ring = [(800.0 * math.cos(a), 800.0 * math.sin(a), 190.0) for a in np.linspace(0.0, math.tau, 13)[:-1]]
    guarded, vehicle = Guard(replace(PLANE, horizon_s=1.0)), Vehicle(NORTHWARD, PLANE)
    scene = discs(*ring, speed_m_s=2.0)
    vehicle.obey(sent(guarded.check(AHEAD, NORTHWARD, scene, 0.0, DT_S)))
    vehicle.fly(DT_S)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "accepted", lambda *_: KEEP_OUT)
        patch.setattr(BackupSearch, "from_tip", lambda *_: KEEP_OUT)
        verdict = guarded.check(AHEAD, vehicle.motion, scene, DT_S + off, DT_S)
    assert verdict.certified_s == pytest.approx(left_s, abs=1e-12)


def test_what_is_clear_for_ever_is_not_given_up_for_what_is_clear_for_the_horizon() -> None:
    scene = discs((-60.0, 0.0, 20.0), speed_m_s=4.0)
    guarded, vehicle = Guard(PLANE), Vehicle(NORTHWARD, PLANE)
    vehicle.obey(sent(guarded.check(AHEAD, NORTHWARD, scene, 0.0, DT_S)))
    vehicle.fly(DT_S)
    horizon = Path((Piece(20.0, 0.0, 0.0, 0.0, 600.0),), 0, 20.0, 30.5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            BackupSearch, "accepted", lambda search, _step, _: horizon if math.isfinite(search._horizon_s) else KEEP_OUT
        )
        patch.setattr(BackupSearch, "continues", lambda *_: False)
        verdict = guarded.check(AHEAD, vehicle.motion, scene, DT_S, DT_S)
    assert (verdict.changes, verdict.certified_s) == ((KEEP_OUT, BACKUP), math.inf)


def test_a_disc_that_moves_is_looked_at_however_slow_and_far_it_is() -> None:
    guarded = Guard(PLANE)
    guarded.check(AHEAD, NORTHWARD, discs((5e4, 0.0, 50.0), speed_m_s=0.1), 0.0, DT_S)
    assert guarded._path is not None and guarded._path.loops == 0


@pytest.mark.parametrize("heading_rad", [0.0, 2.1])
@pytest.mark.parametrize("wind_m_s", [0.0, 4.0])
@pytest.mark.parametrize("ahead_m", [-10.0, 5.0, 40.0])
def test_beside_a_moving_disc_the_way_straight_on_is_timed_at_the_speed_less_the_wind(
    ahead_m: float, wind_m_s: float, heading_rad: float
) -> None:
    limits, slow_m_s = replace(PLANE, wind_m_s=wind_m_s), 20.0 - wind_m_s
    t_s = np.linspace(0.0, 10.0, 100_001)
    step_s = t_s[t_s <= 10.0 / slow_m_s]
    step_m = np.hypot(slow_m_s * step_s - ahead_m, 60.0) - 4.0 * step_s
    after_m = np.hypot(10.0 + slow_m_s * t_s - ahead_m, 60.0) - 4.0 * (t_s + DT_S)
    edge_m = float(min(step_m.min(), after_m.min())) - wind_m_s * 1.5 * DT_S - SPARE_M
    cosine, sine = math.cos(heading_rad), math.sin(heading_rad)
    centre = (ahead_m * cosine - 60.0 * sine, ahead_m * sine + 60.0 * cosine)
    motion, wanted = replace(NORTHWARD, heading_rad=heading_rad), replace(AHEAD, heading_rad=heading_rad)
    assert_refused_straight_on(
        edge_m, lambda radius_m: check(wanted, motion, discs((*centre, radius_m), speed_m_s=4.0), limits)
    )


def test_the_headings_tried_first_are_straight_on_that_of_the_ray_in_hand_and_away_from_the_nearest_edge() -> None:
    guarded, pose = Guard(PLANE), Pose(1.0, 2.0, 0.3)
    flight = guarded._flight(pose, 20.0, NORTHWARD, NOTHING, DT_S, ())
    around = [(101.0, 2.0, 90.0, 1.0), (1.0, 52.0, 10.0, 1.0)]
    assert list(guarded._search(flight, math.inf).likely_headings_rad(pose, around)) == [0.3, math.pi]
    ray = (Piece(0.0, 0.0, 0.0, 0.1, 5.0), Piece(0.0, 0.0, 0.7, 0.0, math.inf))
    guarded._path = Path(ray, 0, 20.0, math.inf)
    assert list(guarded._search(flight, math.inf).likely_headings_rad(pose, around)) == [0.3, 0.7, math.pi]
    guarded._path = guarded._path._replace(loops=1)
    assert list(guarded._search(flight, math.inf).likely_headings_rad(pose, around)) == [0.3, math.pi]


def test_in_coarse_steps_a_ray_in_hand_that_is_too_far_round_does_not_hide_the_way_from_the_disc() -> None:
    guarded = Guard(Limits(60.0, 60.0, 10.0, 50.0, 120.0))
    scene = discs((400.0, 200.0, 300.0), speed_m_s=20.0)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 60.0, replace(NORTHWARD, speed_m_s=60.0), scene, 5.0, ())
    guarded._path = Path((Piece(0.0, 0.0, 3.1, 0.0, math.inf),), 0, 60.0, math.inf)
    ray = guarded._search(flight, math.inf).ray(flight.tip, 60.0, 0.0, 0.0, False)
    assert ray is not None
    assert math.remainder(ray[-1].heading_rad, math.tau) == pytest.approx(math.atan2(-200.0, -400.0))


@pytest.mark.parametrize(("dt_s", "most_rad"), [(0.5, math.tau), (5.0, 3.0)])
def test_the_fan_is_asked_for_turns_all_round_from_discs_as_they_are_when_the_step_ends(
    dt_s: float, most_rad: float
) -> None:
    guarded = Guard(Limits(60.0, 60.0, 10.0, 50.0, 120.0, wind_m_s=5.0))
    asked: list[tuple[Any, ...]] = []
    scene = discs((100.0, 0.0, 300.0), (-100.0, 20.0, 300.0), speed_m_s=2.0)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 60.0, replace(NORTHWARD, speed_m_s=60.0), scene, dt_s, ())

    def fan(*arguments: object) -> list[float]:
        asked.append(arguments)
        return [0.5, 1.0]

    for horizon_s, length_m in ((math.inf, math.inf), (30.0, 55.0 * 30.0)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(backup, "fan_rad", fan)
            ray = guarded._search(flight, horizon_s).ray(flight.tip, 60.0, dt_s, 0.25, True)
            assert guarded._search(flight, horizon_s).ray(flight.tip, 60.0, dt_s, 0.25, False) is None
        pose, curvature_1_m, line_m, slow_m_s, table, turn_rad = asked.pop()
        assert not asked
        assert (pose, line_m, slow_m_s, turn_rad) == (flight.tip, length_m, 55.0, most_rad)
        assert curvature_1_m == pytest.approx(10.0 * G_M_S2 / 65.0**2)
        assert table == pytest.approx(np.array(flight.discs) + [0.0, 0.0, 2.0 * dt_s + 0.25, 0.0])
        assert ray is not None and ray[-1][2:] == pytest.approx((0.5, 0.0, length_m))


def test_the_ray_in_hand_serves_again_after_a_turn_off_it() -> None:
    scene = Discs(np.array([[-60.0, 0.0], [400.0, 80.0]]), np.array([40.0, 300.0]), np.array([8.0, 0.0]))
    guarded, vehicle = Guard(PLANE), Vehicle(replace(NORTHWARD, heading_rad=-0.5), PLANE)
    refused = 0
    for step in range(40):
        verdict = guarded.check(replace(AHEAD, heading_rad=0.2), vehicle.motion, scene, step * DT_S, DT_S)
        refused += KEEP_OUT in verdict.changes
        assert verdict.certified_s == math.inf
        vehicle.obey(sent(verdict))
        assert apart_m(vehicle.fly(DT_S), scene) > 0.0
    assert refused > 5


@pytest.mark.parametrize(("disc_m_s", "north_m", "turns"), [(1.0, 150.0, 1.0), (1.0, 400.0, 8.0), (1.0, 1_200.0, 64.0)])
def test_in_a_fence_what_is_wanted_goes_first_for_the_longest_time_that_it_is_certified(
    disc_m_s: float, north_m: float, turns: float
) -> None:
    limits = replace(PLANE, fence_ned_m=box(3e3), horizon_s=None)
    verdict = check(AHEAD, NORTHWARD, discs((north_m, 0.0, 50.0), speed_m_s=disc_m_s), limits)
    around_s = math.tau * 20.0 / G_M_S2
    assert verdict.changes == ()
    assert verdict.certified_s == pytest.approx(turns * around_s + DT_S)
