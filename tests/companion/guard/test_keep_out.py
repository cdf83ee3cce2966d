"""Keep-out: where exactly a lone disc begins to matter."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.geo.kinematics import turn_towards
from companion.guard.arcs import Path, Pose
from companion.guard.guard import Guard
from companion.guard.types import (
    KEEP_OUT,
    Limits,
    Motion,
    Setpoint,
    Verdict,
)
from companion.guard.vehicle import Step, VehicleModel
from tests.companion.guard.guard_flight import (
    AHEAD,
    COPTER,
    DT_S,
    G_M_S2,
    HAIR,
    NORTHWARD,
    NOTHING,
    PLANE,
    RHO_M,
    SPARE_M,
    assert_hangs_together,
    assert_refused_from,
    check,
    discs,
    lone,
    turn_rate_rad_s,
)


def test_a_disc_beside_the_step_is_kept_clear_of() -> None:
    assert_refused_from(30.0 - SPARE_M, lone(5.0, 30.0))


def test_a_disc_ahead_is_kept_clear_of_by_a_turning_circle() -> None:
    assert_refused_from(math.hypot(50.0, RHO_M) - RHO_M - SPARE_M, lone(60.0, 0.0))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_one_clear_turning_circle_is_enough(side: float) -> None:
    assert_refused_from(math.hypot(50.0, RHO_M + 30.0) - RHO_M - SPARE_M, lone(60.0, side * 30.0))


def test_a_turning_circle_may_run_around_a_small_disc() -> None:
    assert_refused_from(
        RHO_M - SPARE_M,
        lambda radius_m: check(AHEAD, NORTHWARD, discs((10.0, RHO_M, radius_m), (10.0, -RHO_M, radius_m)), PLANE),
    )


def test_the_bulge_of_a_turn_within_the_step_counts() -> None:
    """Both ends of the quarter circle are clear of a disc that its middle touches."""
    limits = replace(PLANE, n_max=math.pi * 20.0 / G_M_S2)
    radius_m = 20.0 / math.pi
    middle = (radius_m * math.sin(math.pi / 4.0), radius_m * (1.0 - math.cos(math.pi / 4.0)))
    beyond = (middle[0] + 5.0 * math.sin(math.pi / 4.0), middle[1] - 5.0 * math.cos(math.pi / 4.0))
    around = discs((*beyond, 5.0 - 1e-3)), discs((*beyond, 5.0 + 1e-3))
    wanted = replace(AHEAD, heading_rad=math.pi / 2.0)
    assert [check(wanted, NORTHWARD, scene, limits).changes[:1] for scene in around] == [(), (KEEP_OUT,)]


def test_a_step_that_may_turn_by_more_than_half_a_circle_falls_back_on_a_rounded_square() -> None:
    limits = Limits(60.0, 60.0, 10.0, 50.0, 120.0)
    rho_m = 3600.0 / 10.0 / G_M_S2
    side_m = 300.0 - rho_m * math.pi / 2.0
    motion, wanted = replace(NORTHWARD, speed_m_s=60.0), replace(AHEAD, speed_m_s=60.0)
    # The first straight side after the turn at the end of the step runs east, or west, at north 300 + rho.
    edge_m = 200.0
    north_m = 300.0 + rho_m + edge_m
    mirrored = ((north_m, rho_m + side_m / 2.0), (north_m, -rho_m - side_m / 2.0))

    def scene(radius_m: float) -> Verdict:
        return check(wanted, motion, discs(*((*centre, radius_m) for centre in mirrored)), limits, 5.0)

    assert_refused_from(edge_m - SPARE_M, scene)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_rounded_square_has_a_corner_and_a_line_in_each_step_and_closes(side: float) -> None:
    loop = VehicleModel(Limits(60.0, 60.0, 10.0, 50.0, 120.0)).circle(Pose(1.0, 2.0, 0.3), side, 60.0, 5.0)
    turns_rad = [piece.curvature_1_m * piece.length_m for piece in loop]
    assert turns_rad == pytest.approx([side * math.pi / 2.0, 0.0] * 4)
    assert [corner.length_m + line.length_m for corner, line in zip(loop[::2], loop[1::2], strict=True)] == [300.0] * 4
    assert_hangs_together(Path(loop, len(loop), 60.0, math.inf))


def test_a_position_error_is_kept_clear_of_as_well() -> None:
    assert_refused_from(30.0 - 2.5 - SPARE_M, lone(5.0, 30.0, replace(PLANE, position_error_m=2.5)))


def test_a_vehicle_that_turns_at_half_its_rate_needs_twice_the_circle() -> None:
    edge_m = math.hypot(50.0, 2.0 * RHO_M) - 2.0 * RHO_M - SPARE_M
    assert_refused_from(edge_m, lone(60.0, 0.0, replace(PLANE, rate_share=0.5)))


def test_in_wind_the_circle_is_that_flown_down_wind_and_the_tracking_is_allowed_for() -> None:
    rho_m = 24.0**2 / G_M_S2
    allowance_m = 4.0 * (1.5 * DT_S + 0.75 * 1.0) + SPARE_M
    edge_m = math.hypot(50.0, rho_m) - rho_m - allowance_m
    assert_refused_from(edge_m, lone(80.0, 0.0, replace(PLANE, wind_m_s=4.0, reaction_s=1.0)))


@dataclass(frozen=True)
class _Case:
    motion: Motion
    wanted: Setpoint
    limits: Limits
    dt_s: float
    centre: tuple[float, float]


@st.composite
def _cases(draw: st.DrawFn, can_stop: bool) -> _Case:
    dt_s = draw(st.floats(0.2, 1.0))
    braking_m_s2 = draw(st.floats(1.0, 8.0)) if can_stop else None
    limits = Limits(0.0 if can_stop else 5.0, 40.0, draw(st.floats(0.5, 6.0)), 50.0, 120.0, braking_m_s2)
    motion = Motion(
        draw(st.floats(-1e4, 1e4)),
        draw(st.floats(-1e4, 1e4)),
        draw(st.floats(0.0, 6.28)),
        draw(st.floats(max(1.0, limits.speed_min_m_s), 40.0)),
    )
    speed_m_s = draw(st.floats(max(1.0, limits.speed_min_m_s), 40.0) | st.just(motion.speed_m_s))
    most_rad = min(turn_rate_rad_s(max(speed_m_s, motion.speed_m_s), limits) * dt_s, 3.0)
    heading_rad = motion.heading_rad + draw(st.floats(-0.999, 0.999)) * most_rad
    bearing_rad, away_m = draw(st.floats(0.0, 6.28)), draw(st.floats(30.0, 400.0))
    centre = (motion.north_m + away_m * math.cos(bearing_rad), motion.east_m + away_m * math.sin(bearing_rad))
    return _Case(motion, Setpoint(heading_rad, speed_m_s, 100.0), limits, dt_s, centre)


def _at(case: _Case, t_s: float) -> tuple[float, float, float]:
    """Return where the vehicle is in its step, at the greater of both speeds throughout."""
    faster_m_s = max(case.motion.speed_m_s, case.wanted.speed_m_s)
    at = (case.motion.north_m, case.motion.east_m, case.motion.heading_rad)
    rate_rad_s = turn_rate_rad_s(faster_m_s, case.limits)
    return turn_towards(*at, faster_m_s, case.wanted.heading_rad, rate_rad_s, t_s)


def _clear_in_step_m(case: _Case) -> float:
    return min(math.dist(_at(case, float(t_s))[:2], case.centre) for t_s in np.linspace(0.0, case.dt_s, 801))


@settings(max_examples=60, derandomize=True)
@given(case=_cases(can_stop=False))
def test_a_vehicle_that_cannot_stop_keeps_exactly_clear_of_a_lone_disc(case: _Case) -> None:
    north_m, east_m, heading_rad = _at(case, case.dt_s)
    speed_m_s = case.wanted.speed_m_s
    rho_m = speed_m_s / turn_rate_rad_s(speed_m_s, case.limits)
    assume(speed_m_s * case.dt_s <= 3.0 * rho_m)
    after = []
    for side in (1.0, -1.0):
        beside_rad = heading_rad + side * math.pi / 2.0
        centre = (north_m + rho_m * math.cos(beside_rad), east_m + rho_m * math.sin(beside_rad))
        after.append(abs(math.dist(centre, case.centre) - rho_m))
    change_m = abs(case.motion.speed_m_s - speed_m_s) * case.dt_s
    edge_m = min(_clear_in_step_m(case), max(after)) - SPARE_M - change_m
    assume(edge_m > 0.01)
    assert_refused_from(
        edge_m,
        lambda radius_m: check(case.wanted, case.motion, discs((*case.centre, radius_m)), case.limits, case.dt_s),
        hair_m=1e-3,
    )


@settings(max_examples=60, derandomize=True)
@given(case=_cases(can_stop=True))
def test_a_vehicle_that_can_stop_keeps_exactly_clear_of_a_lone_disc(case: _Case) -> None:
    assume(case.wanted.speed_m_s >= case.motion.speed_m_s)
    north_m, east_m, heading_rad = _at(case, case.dt_s)
    length_m = case.wanted.speed_m_s**2 / (2.0 * (case.limits.braking_m_s2 or math.nan))
    ahead = np.array([math.cos(heading_rad), math.sin(heading_rad)])
    away = np.array(case.centre) - (north_m, east_m)
    nearest = min(max(float(away @ ahead), 0.0), length_m)
    turn_rad = abs(math.remainder(case.wanted.heading_rad - case.motion.heading_rad, math.tau))
    beside_m = (case.wanted.speed_m_s - case.motion.speed_m_s) * case.dt_s * turn_rad
    edge_m = min(_clear_in_step_m(case), float(np.hypot(*(away - nearest * ahead)))) - SPARE_M - beside_m
    assume(edge_m > 0.01)
    assert_refused_from(
        edge_m,
        lambda radius_m: check(case.wanted, case.motion, discs((*case.centre, radius_m)), case.limits, case.dt_s),
        hair_m=1e-3,
    )


@settings(max_examples=60, derandomize=True)
@given(case=st.one_of(_cases(can_stop=False), _cases(can_stop=True)), beyond_m=st.floats(0.0, 1.0))
def test_a_disc_called_far_changes_nothing_in_the_full_check(case: _Case, beyond_m: float) -> None:
    radius_m = max(0.0, math.dist(case.centre, (case.motion.north_m, case.motion.east_m)) - beyond_m)
    for share in (0.2, 0.5, 0.8, 1.0):
        scene = discs((*case.centre, share * radius_m))
        cheap = check(case.wanted, case.motion, scene, case.limits, case.dt_s)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(VehicleModel, "reach_m", lambda *_: math.inf)
            assert check(case.wanted, case.motion, scene, case.limits, case.dt_s) == cheap


@pytest.mark.parametrize(("limits", "backup_m"), [(PLANE, 2.0 * RHO_M), (COPTER, 100.0)], ids=["plane", "copter"])
def test_a_disc_is_far_beyond_six_steps_the_reaction_and_a_back_up(
    limits: Limits, backup_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits = replace(limits, speed_min_m_s=min(limits.speed_min_m_s, 1.0), reaction_s=0.25)
    looked: list[object] = []
    monkeypatch.setattr(Guard, "_rejoin", lambda *_: looked.append(1))
    for wanted, motion in ((replace(AHEAD, speed_m_s=1.0), NORTHWARD), (AHEAD, replace(NORTHWARD, speed_m_s=1.0))):
        looked.clear()
        for beyond_m, times in ((HAIR, 0), (-HAIR, 1)):
            reach_m = 60.0 + 5.0 + backup_m + SPARE_M + 50.0
            check(wanted, motion, discs((0.0, -reach_m - beyond_m, 50.0)), limits)
            assert len(looked) == times


@pytest.mark.parametrize(("braking_m_s2", "backup_m"), [(None, 2.0 * 28.0**2 / G_M_S2), (2.0, 24.0**2 / 4.0)])
def test_in_wind_a_disc_is_far_beyond_what_is_flown_down_wind(braking_m_s2: float | None, backup_m: float) -> None:
    slowest_m_s = 10.0 if braking_m_s2 is None else 0.0
    limits = Limits(slowest_m_s, 20.0, 1.0, 50.0, 120.0, braking_m_s2)
    guarded = Guard(replace(limits, wind_m_s=4.0, reaction_s=1.0, position_error_m=2.0))
    guarded.check(AHEAD, NORTHWARD, NOTHING, 0.0, DT_S)
    inflation_m = SPARE_M + 2.0 + 4.0 * (1.5 * DT_S + 0.75)
    for speeds_m_s in ((20.0, 10.0, 10.0), (10.0, 20.0, 10.0), (10.0, 10.0, 20.0)):
        before_m_s, wanted_m_s, ground_m_s = speeds_m_s
        motion = replace(NORTHWARD, speed_m_s=ground_m_s)
        reach_m = guarded._vehicle.reach_m(motion, before_m_s, Step(0.0, wanted_m_s), DT_S)
        assert reach_m == pytest.approx(24.0 * (6.0 * DT_S + 1.0) + backup_m + inflation_m)
