"""The limits of speed, altitude and turn."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.guard.types import (
    ALTITUDE,
    KEEP_OUT,
    SPEED,
    TURN,
    Discs,
    Limits,
    Motion,
    Setpoint,
    Verdict,
)
from tests.companion.guard.guard_flight import (
    AHEAD,
    COPTER,
    DT_S,
    G_M_S2,
    NORTHWARD,
    NOTHING,
    PLANE,
    check,
    discs,
    turn_of,
    turn_rate_rad_s,
)


def test_a_setpoint_within_every_limit_passes_unchanged() -> None:
    wanted = Setpoint(0.2, 20.0, 100.0)
    assert check(wanted, NORTHWARD, NOTHING, PLANE, DT_S) == Verdict(wanted, (), certified_s=math.inf)


@pytest.mark.parametrize(
    ("wanted_m_s", "allowed_m_s", "changes"),
    [(9.9, 10.0, (SPEED,)), (10.0, 10.0, ()), (30.0, 30.0, ()), (30.1, 30.0, (SPEED,)), (-5.0, 10.0, (SPEED,))],
)
def test_speed_is_held_between_its_limits(wanted_m_s: float, allowed_m_s: float, changes: tuple[str, ...]) -> None:
    verdict = check(replace(AHEAD, speed_m_s=wanted_m_s), NORTHWARD, NOTHING, Limits(10, 30, 1, 50, 120), DT_S)
    assert verdict == Verdict(replace(AHEAD, speed_m_s=allowed_m_s), changes, certified_s=math.inf)


@pytest.mark.parametrize(
    ("wanted_m", "allowed_m", "changes"),
    [(49.9, 50.0, (ALTITUDE,)), (50.0, 50.0, ()), (120.0, 120.0, ()), (120.1, 120.0, (ALTITUDE,))],
)
def test_altitude_is_held_between_its_limits(wanted_m: float, allowed_m: float, changes: tuple[str, ...]) -> None:
    verdict = check(replace(AHEAD, altitude_m=wanted_m), NORTHWARD, NOTHING, PLANE, DT_S)
    assert verdict == Verdict(replace(AHEAD, altitude_m=allowed_m), changes, certified_s=math.inf)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_turn_at_the_limit_passes_and_one_beyond_is_cut_to_it(side: float) -> None:
    most_rad = G_M_S2 / 20.0 * DT_S
    at_limit = check(replace(AHEAD, heading_rad=side * most_rad), NORTHWARD, NOTHING, PLANE, DT_S)
    beyond = check(replace(AHEAD, heading_rad=side * (most_rad + 1e-6)), NORTHWARD, NOTHING, PLANE, DT_S)
    assert (at_limit.changes, beyond.changes) == ((), (TURN,))
    assert turn_of(at_limit, NORTHWARD) == pytest.approx(side * most_rad, abs=1e-12)
    assert turn_of(beyond, NORTHWARD) == pytest.approx(side * most_rad, abs=1e-12)


def test_rounding_at_the_turn_limit_is_not_called_a_change() -> None:
    most_rad = G_M_S2 / 20.0 * DT_S
    assert check(replace(AHEAD, heading_rad=most_rad + 1e-9), NORTHWARD, NOTHING, PLANE, DT_S).changes == ()
    assert check(replace(AHEAD, heading_rad=most_rad + 1.5e-9), NORTHWARD, NOTHING, PLANE, DT_S).changes == (TURN,)


def test_a_turn_across_north_goes_by_the_shorter_side() -> None:
    motion = replace(NORTHWARD, heading_rad=0.1)
    verdict = check(replace(AHEAD, heading_rad=math.tau - 0.1), motion, NOTHING, PLANE, DT_S)
    assert verdict.changes == ()
    assert turn_of(verdict, motion) == pytest.approx(-0.2)


@pytest.mark.parametrize(("flown_m_s", "wanted_m_s"), [(10.0, 20.0), (20.0, 10.0)])
def test_the_turn_limit_is_that_of_the_greater_of_both_speeds(flown_m_s: float, wanted_m_s: float) -> None:
    limits, motion = replace(PLANE, speed_min_m_s=10.0), replace(NORTHWARD, speed_m_s=flown_m_s)
    verdict = check(Setpoint(2.0, wanted_m_s, 100.0), motion, NOTHING, limits, DT_S)
    assert verdict.changes == (TURN,)
    assert turn_of(verdict, motion) == pytest.approx(G_M_S2 / 20.0 * DT_S)


@pytest.mark.parametrize("speed_m_s", [0.0, 0.4, 0.5])
def test_a_vehicle_that_hardly_moves_turns_as_at_half_a_metre_a_second(speed_m_s: float) -> None:
    still = replace(NORTHWARD, speed_m_s=speed_m_s)
    verdict = check(Setpoint(1.5, speed_m_s, 100.0), still, NOTHING, replace(COPTER, n_max=0.01), DT_S)
    assert turn_of(verdict, still) == pytest.approx(0.01 * G_M_S2 / 0.5 * DT_S)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_no_step_turns_so_far_that_its_side_is_in_doubt(side: float) -> None:
    verdict = check(replace(AHEAD, heading_rad=side * 3.1), NORTHWARD, NOTHING, replace(PLANE, n_max=50.0), DT_S)
    assert verdict.changes == (TURN,)
    assert turn_of(verdict, NORTHWARD) == pytest.approx(side * 3.0)


def test_every_change_is_named_in_order() -> None:
    verdict = check(Setpoint(2.0, 99.0, 999.0), NORTHWARD, discs((30.0, 0.0, 10.0)), PLANE, DT_S)
    assert verdict.changes[:4] == (SPEED, ALTITUDE, TURN, KEEP_OUT)


MAGNITUDES = st.floats(-1e12, 1e12) | st.floats(-1e3, 1e3)

ANYTHING = st.floats() | MAGNITUDES


@st.composite
def scenes(draw: st.DrawFn) -> tuple[Motion, Discs, Limits, float]:
    braking_m_s2 = draw(st.none() | st.floats(0.5, 10.0))
    slowest = draw(st.floats(1.0, 30.0)) if braking_m_s2 is None else 0.0
    fence = draw(st.none() | st.just(((-500.0, -500.0), (500.0, -500.0), (500.0, 500.0), (-500.0, 500.0))))
    limits = Limits(
        slowest,
        slowest + draw(st.floats(0.0, 50.0)),
        draw(st.floats(0.05, 20.0)),
        draw(st.floats(-100.0, 100.0)),
        draw(st.floats(100.0, 500.0)),
        braking_m_s2,
        fence,
        draw(st.floats(0.0, 60.0)),
    )
    count = draw(st.integers(0, 3))
    table = [[draw(st.floats(-1e3, 1e3)) for _ in range(2)] for _ in range(count)]
    around = Discs(
        np.array(table).reshape(-1, 2),
        np.array([draw(st.floats(0.0, 300.0)) for _ in range(count)]),
        np.array([draw(st.floats(0.0, 20.0)) for _ in range(count)]),
    )
    motion = Motion(draw(MAGNITUDES), draw(MAGNITUDES), draw(MAGNITUDES), abs(draw(MAGNITUDES)))
    return motion, around, limits, draw(st.floats(1e-3, 10.0))


@pytest.mark.slow
@settings(max_examples=150, derandomize=True)
@given(wanted=st.builds(Setpoint, ANYTHING, ANYTHING, ANYTHING), scene=scenes())
def test_whatever_is_wanted_the_setpoint_is_finite_and_inside_every_limit(
    wanted: Setpoint, scene: tuple[Motion, Discs, Limits, float]
) -> None:
    motion, around, limits, dt_s = scene
    verdict = check(wanted, motion, around, limits, dt_s)
    assert verdict.setpoint is not None
    heading_rad, speed_m_s = verdict.setpoint.heading_rad, verdict.setpoint.speed_m_s
    assert 0.0 <= heading_rad <= math.tau
    assert limits.speed_min_m_s <= speed_m_s <= limits.speed_max_m_s
    assert limits.altitude_min_m <= verdict.setpoint.altitude_m <= limits.altitude_max_m
    flown_m_s = motion.speed_m_s
    if limits.braking_m_s2 is None:
        flown_m_s = min(max(flown_m_s, limits.speed_min_m_s), limits.speed_max_m_s)
    most_rad = turn_rate_rad_s(max(speed_m_s, flown_m_s), limits) * dt_s
    rounding_rad = 4.0 * math.ulp(abs(motion.heading_rad))
    assert abs(turn_of(verdict, motion)) <= most_rad + 2e-9 + rounding_rad
