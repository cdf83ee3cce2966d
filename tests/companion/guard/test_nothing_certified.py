"""What is done when nothing is certified."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.guard.arcs import Path, Pose
from companion.guard.guard import Guard
from companion.guard.types import (
    FENCE,
    KEEP_OUT,
    NO_BACKUP,
    Setpoint,
    Verdict,
)
from companion.guard.vehicle import Step
from tests.companion.guard.guard_flight import (
    AHEAD,
    COPTER,
    DT_S,
    G_M_S2,
    NORTHWARD,
    NOTHING,
    PLANE,
    assert_hangs_together,
    box,
    check,
    discs,
    turn_of,
)


def test_inside_a_disc_the_wanted_way_straight_out_is_kept_and_the_loss_named() -> None:
    verdict = check(AHEAD, NORTHWARD, discs((-50.0, 0.0, 100.0)), PLANE)
    assert verdict == Verdict(AHEAD, (KEEP_OUT, NO_BACKUP))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_with_nothing_certified_the_turn_away_from_the_disc_is_taken(side: float) -> None:
    verdict = check(AHEAD, NORTHWARD, discs((40.0, side * 10.0, 38.0)), PLANE)
    assert verdict.changes == (KEEP_OUT, NO_BACKUP)
    assert turn_of(verdict, NORTHWARD) == pytest.approx(-side * G_M_S2 / 20.0 * DT_S)


def test_a_vehicle_that_can_stop_stops_before_a_disc_that_it_cannot_avoid() -> None:
    limits = replace(COPTER, braking_m_s2=15.0, n_max=0.01)
    verdict = check(AHEAD, NORTHWARD, discs((113.0, 0.0, 101.0)), limits)
    assert verdict == Verdict(Setpoint(0.0, 0.0, 100.0), (KEEP_OUT, NO_BACKUP))


def test_the_attack_disc_is_avoided_even_at_the_price_of_the_fence_and_of_detection() -> None:
    """Ahead a small disc whose attack radius is all of it; to the right the fence, to the left a wide outer disc."""
    left = (15.0, -30.0, 29.5)
    ahead = (22.0, 0.0, 5.0)
    scene = replace(discs(ahead, left), attack_m=np.array([5.0, 0.0]))
    fence = ((-900.0, -900.0), (900.0, -900.0), (900.0, 1.0), (-900.0, 1.0))
    limits = replace(PLANE, fence_ned_m=fence)
    verdict = check(AHEAD, NORTHWARD, scene, limits)
    assert verdict.changes[-1] == NO_BACKUP
    assert turn_of(verdict, NORTHWARD) != 0.0
    assert turn_of(check(AHEAD, NORTHWARD, replace(scene, attack_m=np.array([5.0, 29.5])), limits), NORTHWARD) > 0.0
    assert turn_of(verdict, NORTHWARD) < 0.0


@pytest.mark.parametrize(
    ("disc", "attack_m", "fence_north_m", "expected"),
    [
        ((30.0, 0.0, 1.0), None, None, (0.0, 0.0, -7.0, 0.0, 0.0, -7.0)),  # nearest at the end, a second from now
        ((-5.0, 0.0, 1.0), None, None, (0.0, 0.0, -4.0, 0.0, 0.0, -22.0)),  # nearest now
        ((-5.0, 0.0, 1.0), 0.5, 15.0, (0.0, 5.0, -4.0, 0.0, 5.0, -22.0)),
        ((-5.0, 0.0, 9.0), 6.0, 100.0, (1.0, 0.0, 4.0, 0.0, 0.0, -14.0)),
        ((24.0, 0.0, 9.0), 6.0, 15.0, (4.0, 5.0, 7.0, 4.0, 5.0, 7.0)),
        ((6.25, 5.0, 1.0), None, None, (0.0, 0.0, -3.375, 0.0, 0.0, -11.63087)),  # at the fifth of sixteen parts
    ],
)
def test_what_to_make_least_is_attack_depth_then_fence_then_depth_then_that_at_the_end(
    disc: tuple[float, float, float], attack_m: float | None, fence_north_m: float | None, expected: tuple[float, ...]
) -> None:
    limits = PLANE if fence_north_m is None else replace(PLANE, fence_ned_m=box(fence_north_m))
    scene = discs(disc, speed_m_s=2.0)
    scene = scene if attack_m is None else replace(scene, attack_m=np.array([attack_m]))
    guarded = Guard(limits)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, scene, DT_S, ())
    assert guarded._search(flight, math.inf).violation(Step(0.0, 20.0)) == pytest.approx(expected, abs=1e-5)


def test_without_any_disc_only_the_fence_counts() -> None:
    limits = replace(PLANE, fence_ned_m=box(15.0))
    guarded = Guard(limits)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, DT_S, ())
    assert guarded._search(flight, math.inf).violation(Step(0.0, 20.0)) == pytest.approx((0.0, 5.0, -math.inf) * 2)


def test_what_a_vehicle_may_be_off_its_path_counts_in_attack_discs_too() -> None:
    guarded = Guard(replace(PLANE, position_error_m=2.0))
    scene = replace(discs((24.0, 0.0, 9.0), speed_m_s=2.0), attack_m=np.array([6.0]))
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, scene, DT_S, ())
    assert guarded._search(flight, math.inf).violation(Step(0.0, 20.0)) == pytest.approx((6.0, 0.0, 9.0) * 2, abs=1e-5)


def test_in_wind_what_to_make_least_is_looked_for_along_the_ground_speed_reported() -> None:
    """Twelve metres in the step at 24 m/s over the ground, then ten at the airspeed; the wind may blow it 3 m off."""
    guarded = Guard(replace(PLANE, wind_m_s=4.0))
    motion = replace(NORTHWARD, speed_m_s=24.0)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, motion, discs((30.0, 0.0, 1.0)), DT_S, ())
    assert guarded._search(flight, math.inf).violation(Step(0.0, 20.0)) == pytest.approx(
        (0.0, 0.0, 1.0 + 4.0 * 1.5 * DT_S - 8.0) * 2, abs=1e-5
    )


@pytest.mark.parametrize(("wind_m_s", "ground_m_s"), [(0.0, 20.0), (0.5, 20.4)])
def test_a_step_is_flown_at_the_ground_speed_reported_in_any_wind(wind_m_s: float, ground_m_s: float) -> None:
    guarded = Guard(replace(PLANE, wind_m_s=wind_m_s))
    pieces, after_m_s = guarded._vehicle.step_pieces(Pose(0.0, 0.0, 0.5), Step(-0.2, 20.0), 20.0, 20.4, DT_S)
    arc_m = ground_m_s * 0.2 / (G_M_S2 / 20.0)
    assert [piece.length_m for piece in pieces] == pytest.approx([arc_m, ground_m_s * DT_S - arc_m])
    assert (pieces[0].heading_rad, pieces[1].heading_rad, after_m_s) == pytest.approx((0.5, 0.3, 20.0))
    assert_hangs_together(Path(pieces, 0, 20.0, math.inf))


def test_outside_the_fence_the_wanted_way_straight_back_in_is_kept_and_the_loss_named() -> None:
    limits = replace(PLANE, fence_ned_m=((20.0, -500.0), (20.0, 500.0), (900.0, 500.0), (900.0, -500.0)))
    assert check(AHEAD, NORTHWARD, NOTHING, limits) == Verdict(AHEAD, (FENCE, NO_BACKUP))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_outside_the_fence_the_turn_back_is_taken(side: float) -> None:
    fence = ((-900.0, side * 30.0), (900.0, side * 30.0), (900.0, side * 900.0), (-900.0, side * 900.0))
    verdict = check(AHEAD, NORTHWARD, NOTHING, replace(PLANE, fence_ned_m=fence))
    assert verdict.changes == (FENCE, NO_BACKUP)
    assert turn_of(verdict, NORTHWARD) == pytest.approx(side * G_M_S2 / 20.0 * DT_S)
