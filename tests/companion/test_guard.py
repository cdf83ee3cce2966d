"""The guard: every limit, every reason, and its central claim, that a certified start never ends inside a disc."""

import ast
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion import guard
from companion.guard import (
    ALTITUDE,
    FENCE,
    IMPOSSIBLE,
    KEEP_OUT,
    NO_BACKUP,
    NOT_FINITE,
    SPEED,
    TURN,
    Discs,
    Limits,
    Motion,
    Setpoint,
    Verdict,
    check,
)
from companion.kinematics import turn_towards

G_M_S2 = 9.80665
BAD = [math.nan, math.inf, -math.inf]
HAIR = 1e-8
"""Far under the guard's own rounding allowance of 1e-6 m, far over what doubles lose here."""

PLANE = Limits(20.0, 20.0, 1.0, 50.0, 120.0)
"""Cannot stop; its turning circle is 40.8 m, its step 10 m, and its margin on a step at one speed 0.625 m."""
COPTER = Limits(0.0, 20.0, 1.0, 50.0, 120.0, braking_m_s2=2.0)
DT_S = 0.5
RHO_M = 400.0 / G_M_S2
NORTHWARD = Motion(0.0, 0.0, 0.0, 20.0)
AHEAD = Setpoint(0.0, 20.0, 100.0)
MARGIN_M = 0.625
"""Half the spacing of the points checked along a step of PLANE."""
SPARE_M = 1e-6


def discs(*entries: tuple[float, float, float], speed_m_s: float = 0.0) -> Discs:
    """Return discs of (north, east, radius), all with one speed."""
    table = np.array(entries, dtype=float).reshape(-1, 3)
    return Discs(table[:, :2], table[:, 2], np.full(len(table), speed_m_s))


NOTHING = discs()


def turn_rate_rad_s(speed_m_s: float, limits: Limits) -> float:
    return limits.n_max * G_M_S2 / max(speed_m_s, 0.5)


def turn_of(verdict: Verdict, motion: Motion) -> float:
    assert verdict.setpoint is not None
    return math.remainder(verdict.setpoint.heading_rad - motion.heading_rad, math.tau)


def assert_refused_from(
    edge_m: float,
    scene: Callable[[float], Verdict],
    reason: str = KEEP_OUT,
) -> None:
    """Assert that a scene of one growing length is accepted up to an edge and refused beyond it for the reason."""
    assert scene(edge_m - HAIR).changes == ()
    assert scene(edge_m + HAIR).changes[:1] == (reason,)


# --- what it may depend on


def test_the_guard_imports_nothing_but_numpy_and_the_standard_library() -> None:
    imported = set()
    for node in ast.walk(ast.parse(Path(guard.__file__).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module is not None
            imported.add(node.module.split(".")[0])
    assert imported - set(sys.stdlib_module_names) == {"numpy"}


# --- what leaves nothing to decide on


@pytest.mark.parametrize("value", BAD)
@pytest.mark.parametrize("field", ["north_m", "east_m", "heading_rad", "speed_m_s"])
def test_a_motion_that_is_not_finite_gets_no_setpoint(field: str, value: float) -> None:
    assert check(AHEAD, replace(NORTHWARD, **{field: value}), NOTHING, PLANE, DT_S) == Verdict(None, (NOT_FINITE,))


@pytest.mark.parametrize("value", BAD)
@pytest.mark.parametrize("part", ["centres_ned_m", "radii_m", "speeds_m_s"])
def test_one_disc_that_is_not_finite_gets_no_setpoint(part: str, value: float) -> None:
    scene = discs((5e3, 0.0, 10.0), (6e3, 0.0, 10.0))
    getattr(scene, part)[1] = value
    assert check(AHEAD, NORTHWARD, scene, PLANE, DT_S) == Verdict(None, (NOT_FINITE,))


@pytest.mark.parametrize("value", BAD)
def test_a_step_that_is_not_finite_gets_no_setpoint(value: float) -> None:
    assert check(AHEAD, NORTHWARD, NOTHING, PLANE, value) == Verdict(None, (NOT_FINITE,))


@pytest.mark.parametrize("dt_s", [0.0, -0.5])
def test_a_step_that_takes_no_time_gets_no_setpoint(dt_s: float) -> None:
    assert check(AHEAD, NORTHWARD, NOTHING, PLANE, dt_s) == Verdict(None, (IMPOSSIBLE,))


def test_a_negative_ground_speed_gets_no_setpoint() -> None:
    assert check(AHEAD, replace(NORTHWARD, speed_m_s=-1.0), NOTHING, PLANE, DT_S) == Verdict(None, (IMPOSSIBLE,))


@pytest.mark.parametrize("part", ["radii_m", "speeds_m_s"])
def test_one_disc_of_negative_size_or_speed_gets_no_setpoint(part: str) -> None:
    scene = discs((5e3, 0.0, 10.0), (6e3, 0.0, 10.0))
    getattr(scene, part)[1] = -1.0
    assert check(AHEAD, NORTHWARD, scene, PLANE, DT_S) == Verdict(None, (IMPOSSIBLE,))


def test_a_vehicle_at_rest_and_a_disc_of_no_size_are_possible() -> None:
    still = Motion(0.0, 0.0, 0.0, 0.0)
    assert check(replace(AHEAD, speed_m_s=0.0), still, discs((10.0, 0.0, 0.0)), COPTER, DT_S).changes == ()


@pytest.mark.parametrize("value", BAD)
@pytest.mark.parametrize("field", ["heading_rad", "speed_m_s", "altitude_m"])
def test_a_setpoint_that_is_not_finite_becomes_straight_on_at_the_middle_altitude(field: str, value: float) -> None:
    motion = Motion(0.0, 0.0, 1.25, 7.0)
    verdict = check(replace(AHEAD, **{field: value}), motion, NOTHING, COPTER, DT_S)
    assert verdict == Verdict(Setpoint(1.25, 7.0, 85.0), (NOT_FINITE,))


@pytest.mark.parametrize(
    "nonsense",
    [
        {"speed_min_m_s": 0.0},
        {"speed_min_m_s": -1.0},
        {"speed_min_m_s": math.nan},
        {"speed_min_m_s": 20.1},
        {"speed_max_m_s": math.nan},
        {"speed_max_m_s": math.inf},
        {"n_max": 0.0},
        {"n_max": math.nan},
        {"n_max": math.inf},
        {"altitude_min_m": math.nan},
        {"altitude_min_m": -math.inf},
        {"altitude_min_m": 121.0},
        {"altitude_max_m": math.inf},
        {"altitude_max_m": math.nan},
        {"braking_m_s2": 1.0},
        {"speed_min_m_s": 0.0, "braking_m_s2": 0.0},
        {"speed_min_m_s": 0.0, "braking_m_s2": math.nan},
        {"speed_min_m_s": 0.0, "braking_m_s2": math.inf},
        {"horizon_s": -1.0},
        {"horizon_s": math.nan},
        {"horizon_s": math.inf},
    ],
    ids=str,
)
def test_limits_that_nothing_can_hold_are_refused(nonsense: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"^limits that nothing can hold: Limits\("):
        replace(PLANE, **nonsense)


@pytest.mark.parametrize("last", [(), ((math.nan, 1.0),), ((0.0, math.inf),)])
def test_a_fence_without_three_finite_corners_is_refused(last: tuple[tuple[float, float], ...]) -> None:
    with pytest.raises(ValueError, match="^a fence needs at least three corners, all of them finite$"):
        replace(PLANE, fence_ned_m=((0.0, 0.0), (1.0, 0.0), *last))


def test_limits_at_the_edge_of_sense_are_taken() -> None:
    Limits(0.0, 0.0, 0.1, 50.0, 50.0, braking_m_s2=0.1, fence_ned_m=((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)), horizon_s=0.0)


def test_discs_are_kept_clear_of_for_half_a_minute_unless_told_otherwise() -> None:
    assert PLANE.horizon_s == 30.0


# --- speed, altitude, turn


def test_a_setpoint_within_every_limit_passes_unchanged() -> None:
    wanted = Setpoint(0.2, 20.0, 100.0)
    assert check(wanted, NORTHWARD, NOTHING, PLANE, DT_S) == Verdict(wanted, ())


@pytest.mark.parametrize(
    ("wanted_m_s", "allowed_m_s", "changes"),
    [(9.9, 10.0, (SPEED,)), (10.0, 10.0, ()), (30.0, 30.0, ()), (30.1, 30.0, (SPEED,)), (-5.0, 10.0, (SPEED,))],
)
def test_speed_is_held_between_its_limits(wanted_m_s: float, allowed_m_s: float, changes: tuple[str, ...]) -> None:
    verdict = check(replace(AHEAD, speed_m_s=wanted_m_s), NORTHWARD, NOTHING, Limits(10, 30, 1, 50, 120), DT_S)
    assert verdict == Verdict(replace(AHEAD, speed_m_s=allowed_m_s), changes)


@pytest.mark.parametrize(
    ("wanted_m", "allowed_m", "changes"),
    [(49.9, 50.0, (ALTITUDE,)), (50.0, 50.0, ()), (120.0, 120.0, ()), (120.1, 120.0, (ALTITUDE,))],
)
def test_altitude_is_held_between_its_limits(wanted_m: float, allowed_m: float, changes: tuple[str, ...]) -> None:
    verdict = check(replace(AHEAD, altitude_m=wanted_m), NORTHWARD, NOTHING, PLANE, DT_S)
    assert verdict == Verdict(replace(AHEAD, altitude_m=allowed_m), changes)


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


@settings(deadline=None, max_examples=150, derandomize=True)
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
    most_rad = turn_rate_rad_s(max(speed_m_s, motion.speed_m_s), limits) * dt_s
    rounding_rad = 4.0 * math.ulp(abs(motion.heading_rad))
    assert abs(turn_of(verdict, motion)) <= most_rad + 2e-9 + rounding_rad


# --- keep-out: where exactly a lone disc begins to matter


def lone(north_m: float, east_m: float, limits: Limits = PLANE, **wanted: float) -> Callable[[float], Verdict]:
    """Return the verdict on a step northward as a function of the radius of one still disc."""
    return lambda radius_m: check(replace(AHEAD, **wanted), NORTHWARD, discs((north_m, east_m, radius_m)), limits, DT_S)


def test_a_disc_beside_the_step_is_kept_clear_of_by_half_a_sample() -> None:
    assert_refused_from(30.0 - MARGIN_M, lone(5.0, 30.0))


def test_a_disc_ahead_is_kept_clear_of_by_a_turning_circle() -> None:
    assert_refused_from(math.hypot(50.0, RHO_M) - RHO_M - MARGIN_M - SPARE_M, lone(60.0, 0.0))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_one_clear_turning_circle_is_enough(side: float) -> None:
    edge_m = math.hypot(50.0, RHO_M + 30.0) - RHO_M - MARGIN_M - SPARE_M
    assert_refused_from(edge_m, lone(60.0, side * 30.0))


def test_a_turning_circle_may_run_around_a_small_disc() -> None:
    def scene(radius_m: float) -> Verdict:
        return check(AHEAD, NORTHWARD, discs((10.0, RHO_M, radius_m), (10.0, -RHO_M, radius_m)), PLANE, DT_S)

    assert_refused_from(RHO_M - MARGIN_M - SPARE_M, scene)


def test_a_slow_vehicle_that_cannot_stop_needs_only_its_own_circle() -> None:
    limits, motion = Limits(1.0, 1.0, 1.0, 50.0, 120.0), replace(NORTHWARD, speed_m_s=1.0)
    rate = G_M_S2
    half_side_m = (DT_S - math.pi / 2.0 / rate) / 2.0
    inner_m, outer_m = 1.0 / rate + half_side_m, 1.0 / rate + half_side_m * math.sqrt(2.0)
    apart_m = math.hypot(5.0 - 0.5 + half_side_m, inner_m)

    def scene(radius_m: float) -> Verdict:
        return check(Setpoint(0.0, 1.0, 100.0), motion, discs((5.0, 0.0, radius_m)), limits, DT_S)

    assert_refused_from(apart_m - outer_m - 1.0 * DT_S / 16.0 - SPARE_M, scene)


@pytest.mark.parametrize("braking_m_s2", [None, 2.0])
def test_a_disc_that_the_vehicle_just_touches_at_the_end_of_its_margin_is_allowed(braking_m_s2: float | None) -> None:
    limits = replace(PLANE, speed_min_m_s=20.0 if braking_m_s2 is None else 0.0, braking_m_s2=braking_m_s2)
    assert check(AHEAD, NORTHWARD, discs((0.0, 40.625, 40.0)), limits, DT_S).changes == ()


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
    limits = Limits(
        0.0 if can_stop else 5.0,
        40.0,
        draw(st.floats(0.5, 6.0)),
        50.0,
        120.0,
        draw(st.floats(1.0, 8.0)) if can_stop else None,
    )
    motion = Motion(
        draw(st.floats(-1e4, 1e4)),
        draw(st.floats(-1e4, 1e4)),
        draw(st.floats(0.0, 6.28)),
        draw(st.floats(limits.speed_min_m_s, 40.0)),
    )
    speed_m_s = draw(st.floats(limits.speed_min_m_s, 40.0) | st.just(motion.speed_m_s))
    most_rad = min(turn_rate_rad_s(max(speed_m_s, motion.speed_m_s), limits) * dt_s, 3.0)
    heading_rad = motion.heading_rad + draw(st.floats(-0.999, 0.999)) * most_rad
    bearing_rad, away_m = draw(st.floats(0.0, 6.28)), draw(st.floats(30.0, 400.0))
    centre = (motion.north_m + away_m * math.cos(bearing_rad), motion.east_m + away_m * math.sin(bearing_rad))
    return _Case(motion, Setpoint(heading_rad, speed_m_s, 100.0), limits, dt_s, centre)


def _edge_of_the_step_m(case: _Case) -> tuple[float, float, float, float]:
    """Return what the step itself leaves for a disc's radius, its margin, and where it ends; one speed throughout."""
    faster_m_s = max(case.motion.speed_m_s, case.wanted.speed_m_s)
    slower_m_s = min(case.motion.speed_m_s, case.wanted.speed_m_s)
    turn_rad = abs(math.remainder(case.wanted.heading_rad - case.motion.heading_rad, math.tau))
    rate_rad_s = turn_rate_rad_s(faster_m_s, case.limits)
    margin_m = faster_m_s * case.dt_s / 16.0 + (faster_m_s - slower_m_s) * case.dt_s * turn_rad
    places = [
        turn_towards(
            case.motion.north_m,
            case.motion.east_m,
            case.motion.heading_rad,
            faster_m_s,
            case.wanted.heading_rad,
            rate_rad_s,
            t_s,
        )
        for t_s in [*np.linspace(0.0, case.dt_s, 9), min(turn_rad / rate_rad_s, case.dt_s)]
    ]
    edge_m = min(math.dist(place[:2], case.centre) for place in places) - margin_m
    return edge_m, margin_m, places[8][0], places[8][1]


def _verdict(case: _Case, radius_m: float) -> Verdict:
    return check(case.wanted, case.motion, discs((*case.centre, radius_m)), case.limits, case.dt_s)


@settings(deadline=None, max_examples=150, derandomize=True)
@given(case=_cases(can_stop=False))
def test_a_vehicle_that_cannot_stop_keeps_exactly_its_margins_from_a_lone_disc(case: _Case) -> None:
    edge_m, margin_m, north_m, east_m = _edge_of_the_step_m(case)
    speed_m_s, heading_rad = case.wanted.speed_m_s, case.wanted.heading_rad
    rate_rad_s = turn_rate_rad_s(speed_m_s, case.limits)
    margin_m += abs(case.motion.speed_m_s - speed_m_s) * case.dt_s + SPARE_M
    half_m = max(0.0, speed_m_s * (case.dt_s - math.pi / 2.0 / rate_rad_s) / 2.0)
    ring_m = speed_m_s / rate_rad_s
    after = []
    for side in (1.0, -1.0):
        beside_rad = heading_rad + side * math.pi / 2.0
        centre = (
            north_m + (ring_m + half_m) * math.cos(beside_rad) - half_m * math.cos(heading_rad),
            east_m + (ring_m + half_m) * math.sin(beside_rad) - half_m * math.sin(heading_rad),
        )
        apart_m = math.dist(centre, case.centre)
        after.append(max(apart_m - ring_m - math.sqrt(2.0) * half_m, ring_m + half_m - apart_m) - margin_m)
    edge_m = min(edge_m, max(after))
    assume(edge_m > HAIR)
    assert_refused_from(edge_m, lambda radius_m: _verdict(case, radius_m))


@settings(deadline=None, max_examples=100, derandomize=True)
@given(case=_cases(can_stop=True))
def test_a_vehicle_that_can_stop_keeps_exactly_its_margins_from_a_lone_disc(case: _Case) -> None:
    assume(case.wanted.speed_m_s >= case.motion.speed_m_s)
    edge_m, margin_m, north_m, east_m = _edge_of_the_step_m(case)
    length_m = case.wanted.speed_m_s**2 / (2.0 * (case.limits.braking_m_s2 or math.nan))
    ahead = np.array([math.cos(case.wanted.heading_rad), math.sin(case.wanted.heading_rad)])
    away = np.array(case.centre) - (north_m, east_m)
    nearest = min(max(float(away @ ahead), 0.0), length_m)
    edge_m = min(edge_m, float(np.hypot(*(away - nearest * ahead))) - margin_m - SPARE_M)
    assume(edge_m > HAIR)
    assert_refused_from(edge_m, lambda radius_m: _verdict(case, radius_m))


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("bearing_rad", [0.0, 2.0, 3.1, 5.5])
def test_where_both_sides_are_clear_the_wanted_side_and_speed_are_kept(side: float, bearing_rad: float) -> None:
    limits, motion = replace(PLANE, speed_min_m_s=10.0), replace(NORTHWARD, heading_rad=bearing_rad)
    ahead = (70.0 * math.cos(bearing_rad), 70.0 * math.sin(bearing_rad))
    wanted = Setpoint(bearing_rad + side * 0.01, 15.0, 100.0)
    verdict = check(wanted, motion, discs((*ahead, 40.0)), limits, DT_S)
    assert verdict.changes == (KEEP_OUT,)
    assert verdict.setpoint is not None and verdict.setpoint.speed_m_s == 15.0
    assert turn_of(verdict, motion) == pytest.approx(side * G_M_S2 / 20.0 * DT_S)


def test_a_back_up_is_continued_even_where_rounding_has_used_up_its_spare_room() -> None:
    radius_m = RHO_M - MARGIN_M - SPARE_M / 2.0
    around = discs((0.0, RHO_M, radius_m), (0.0, -RHO_M, radius_m))
    verdict = check(replace(AHEAD, heading_rad=0.1), NORTHWARD, around, PLANE, DT_S)
    assert verdict.changes == (KEEP_OUT,)
    assert turn_of(verdict, NORTHWARD) == pytest.approx(G_M_S2 / 20.0 * DT_S)


def test_a_braking_path_may_just_touch_the_margin_of_a_disc() -> None:
    assert guard._broken_braking((0.0, 0.0), 0.0, 10.0, discs((5.0, 3.0, 2.0)), None, 1.0) is None
    assert guard._broken_braking((0.0, 0.0), 0.0, 10.0, discs((5.0, 3.0, 2.0)), None, 1.0 + 1e-12) == KEEP_OUT


# --- slowing and stopping


@pytest.mark.parametrize(
    ("wanted_m_s", "braking_m_s2", "stop_m"),
    [
        (20.0, 2.0, 110.0),  # the step at 20 m/s, then v^2 / 2a
        (10.0, 2.0, 100.0),  # all of it braking: v^2 / 2a from here
        (0.0, 2.0, 100.0),
        (10.0, 50.0, 7.0),  # braking 3 m in 0.2 s, 3 m at 10 m/s, and 1 m more
        (0.0, 100.0, 2.0),  # standing within the step
    ],
)
def test_stopping_ahead_of_a_disc_takes_the_braking_path_from_the_speed_flown(
    wanted_m_s: float, braking_m_s2: float, stop_m: float
) -> None:
    limits = replace(COPTER, braking_m_s2=braking_m_s2)
    assert_refused_from(200.0 - stop_m - MARGIN_M - SPARE_M, lone(200.0, 0.0, limits, speed_m_s=wanted_m_s))


def test_a_vehicle_that_cannot_brake_round_a_corner_is_not_allowed_to_try() -> None:
    wanted = Setpoint(0.245, 0.0, 100.0)
    beside_m = 20.0 * DT_S * 0.245
    end = turn_towards(0.0, 0.0, 0.0, 20.0, 0.245, G_M_S2 / 20.0, DT_S)
    assert check(wanted, NORTHWARD, discs((90.0, 22.0, 1.0)), COPTER, DT_S).changes == (KEEP_OUT,)
    assert math.dist(end[:2], (90.0, 22.0)) > 1.0 + 10.0 * (MARGIN_M + beside_m)


def test_a_vehicle_at_rest_may_stay_beside_a_disc() -> None:
    still = Motion(0.0, 0.0, 0.0, 0.0)
    assert check(Setpoint(0.0, 0.0, 100.0), still, discs((10.0, 0.0, 9.99)), COPTER, DT_S).changes == ()


def test_a_vehicle_that_can_stop_does_so_when_no_turn_is_clear() -> None:
    wall = discs((500.0, 0.0, 395.0))
    verdict = check(AHEAD, NORTHWARD, wall, COPTER, DT_S)
    assert verdict == Verdict(Setpoint(0.0, 0.0, 100.0), (KEEP_OUT,))


# --- moving discs


def test_a_moving_disc_counts_as_grown_over_step_and_horizon() -> None:
    limits = replace(PLANE, horizon_s=7.0)
    edge_m = math.hypot(490.0, RHO_M) - RHO_M - MARGIN_M - SPARE_M - 3.0 * (0.5 + 7.0)
    assert_refused_from(
        edge_m, lambda radius_m: check(AHEAD, NORTHWARD, discs((500.0, 0.0, radius_m), speed_m_s=3.0), limits, DT_S)
    )


def test_during_the_step_a_moving_disc_grows_with_time() -> None:
    limits = replace(PLANE, horizon_s=0.0)
    edge_m = min(math.hypot(1.25 * k - 5.0, 30.0) - 0.5 * 0.0625 * k for k in range(9)) - MARGIN_M
    assert_refused_from(
        edge_m, lambda radius_m: check(AHEAD, NORTHWARD, discs((5.0, 30.0, radius_m), speed_m_s=0.5), limits, DT_S)
    )


@pytest.mark.parametrize("limits", [PLANE, COPTER], ids=["plane", "copter"])
@pytest.mark.parametrize("seed", range(3))
def test_a_disc_that_approaches_at_its_bound_is_never_met_within_a_certified_horizon(limits: Limits, seed: int) -> None:
    """The pursuer always heads for the vehicle; from a certified step the back-up lasts as long as the horizon."""
    rng = np.random.default_rng(seed)
    limits = replace(limits, horizon_s=20.0)
    motion, disc_ned_m, radius_m, speed_m_s = NORTHWARD, np.array([600.0, rng.uniform(-50, 50)]), 80.0, 6.0
    for _ in range(40):
        verdict = check(AHEAD, motion, discs((*disc_ned_m, radius_m), speed_m_s=speed_m_s), limits, DT_S)
        assert verdict.setpoint is not None
        if NO_BACKUP in verdict.changes:
            break
        flown = fly_step(motion, verdict.setpoint, limits, DT_S)
        for one in flown:
            towards = np.array([one.north_m, one.east_m]) - disc_ned_m
            disc_ned_m = disc_ned_m + towards / np.hypot(*towards) * speed_m_s * DT_S / SUBSTEPS
            assert np.hypot(*(np.array([one.north_m, one.east_m]) - disc_ned_m)) > radius_m
        motion = flown[-1]
    else:
        pytest.fail("the pursuer never came near enough to matter")


# --- when nothing is certified


def test_inside_a_disc_the_wanted_way_straight_out_is_kept_and_the_loss_named() -> None:
    verdict = check(AHEAD, NORTHWARD, discs((-50.0, 0.0, 100.0)), PLANE, DT_S)
    assert verdict == Verdict(AHEAD, (KEEP_OUT, NO_BACKUP))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_with_nothing_certified_the_turn_away_from_the_disc_is_taken(side: float) -> None:
    verdict = check(AHEAD, NORTHWARD, discs((40.0, side * 10.0, 38.0)), PLANE, DT_S)
    assert verdict.changes == (KEEP_OUT, NO_BACKUP)
    assert turn_of(verdict, NORTHWARD) == pytest.approx(-side * G_M_S2 / 20.0 * DT_S)


def test_a_vehicle_that_can_stop_stops_before_a_disc_that_it_cannot_avoid() -> None:
    limits = replace(COPTER, braking_m_s2=15.0, n_max=0.01)
    verdict = check(AHEAD, NORTHWARD, discs((114.0, 0.0, 101.0)), limits, DT_S)
    assert verdict == Verdict(Setpoint(0.0, 0.0, 100.0), (KEEP_OUT, NO_BACKUP))


def test_what_is_met_after_the_step_counts_too_when_nothing_is_certified() -> None:
    scene = discs((19.8, 2.44, 1.0), (9.9, -6.0, 2.0), speed_m_s=0.1)
    verdict = check(AHEAD, NORTHWARD, scene, replace(PLANE, horizon_s=1e5), DT_S)
    assert verdict.changes == (KEEP_OUT, NO_BACKUP)
    assert turn_of(verdict, NORTHWARD) < 0.0


@pytest.mark.parametrize(
    ("disc", "fence_north_m", "expected_m"),
    [
        ((30.0, 0.0, 1.0), None, (7.0, 7.0)),  # nearest at the end, 1 s from now: 10 m less radius and growth
        ((-5.0, 0.0, 1.0), None, (4.0, 22.0)),  # nearest now
        ((-5.0, 0.0, 1.0), 22.0, (2.0, 2.0)),  # the fence is nearer than the disc
        ((-5.0, 0.0, 1.0), 15.0, (-5.0, -5.0)),
        ((-5.0, 0.0, 1.0), 100.0, (4.0, 22.0)),
    ],
)
def test_what_to_go_by_is_the_least_clearance_and_that_at_the_end_of_twice_the_step(
    disc: tuple[float, float, float], fence_north_m: float | None, expected_m: tuple[float, float]
) -> None:
    limits = PLANE if fence_north_m is None else replace(PLANE, fence_ned_m=box(fence_north_m))
    found = guard._clearance_m(guard._Step(0.0, 20.0), NORTHWARD, discs(disc, speed_m_s=2.0), limits, DT_S)
    assert found == pytest.approx(expected_m)


def test_outside_the_fence_the_wanted_way_straight_back_in_is_kept_and_the_loss_named() -> None:
    limits = replace(PLANE, fence_ned_m=((20.0, -500.0), (20.0, 500.0), (900.0, 500.0), (900.0, -500.0)))
    verdict = check(AHEAD, NORTHWARD, NOTHING, limits, DT_S)
    assert verdict == Verdict(AHEAD, (FENCE, NO_BACKUP))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_outside_the_fence_the_turn_back_is_taken(side: float) -> None:
    fence = ((-900.0, side * 30.0), (900.0, side * 30.0), (900.0, side * 900.0), (-900.0, side * 900.0))
    verdict = check(AHEAD, NORTHWARD, NOTHING, replace(PLANE, fence_ned_m=fence), DT_S)
    assert verdict.changes == (FENCE, NO_BACKUP)
    assert turn_of(verdict, NORTHWARD) == pytest.approx(side * G_M_S2 / 20.0 * DT_S)


@settings(deadline=None, max_examples=60, derandomize=True)
@given(case=_cases(can_stop=False), depth_m=st.floats(5.0, 80.0))
def test_with_nothing_certified_no_turn_would_keep_clearer_than_the_one_taken(case: _Case, depth_m: float) -> None:
    limits = replace(case.limits, speed_min_m_s=case.motion.speed_m_s, speed_max_m_s=case.motion.speed_m_s)
    inside = discs((*case.centre, math.dist(case.centre, (case.motion.north_m, case.motion.east_m)) + depth_m))
    verdict = check(case.wanted, case.motion, inside, limits, case.dt_s)
    assert verdict.setpoint is not None and verdict.changes[-1] == NO_BACKUP
    most_rad = min(turn_rate_rad_s(case.motion.speed_m_s, limits) * case.dt_s, math.pi / 2.0)

    def clearance_m(heading_rad: float) -> tuple[float, float]:
        steps = fly_step(case.motion, Setpoint(heading_rad, case.motion.speed_m_s, 100.0), limits, case.dt_s)
        places = np.array([(case.motion.north_m, case.motion.east_m)] + [(m.north_m, m.east_m) for m in steps])
        places = np.vstack([places, 2.0 * places[-1] - places[0]])
        clear_m = np.hypot(*(places - np.array(case.centre)).T) - inside.radii_m[0]
        return float(clear_m.min()), float(clear_m[-1])

    taken = clearance_m(verdict.setpoint.heading_rad)
    for turn_rad in (most_rad, -most_rad):
        other = clearance_m(case.motion.heading_rad + turn_rad)
        assert taken[0] >= other[0] - 0.1
        if abs(taken[0] - other[0]) < 1e-9:
            assert taken[1] >= other[1] - 1e-6


# --- the fence


def box(north_m: float, east_m: float = 1e3) -> tuple[tuple[float, float], ...]:
    """Return a box that ends this far ahead and to the right of the origin, and far off elsewhere."""
    return ((-1e3, -1e3), (north_m, -1e3), (north_m, east_m), (-1e3, east_m))


def fenced(
    limits: Limits, wanted: Setpoint, fence: Callable[[float], tuple[tuple[float, float], ...]]
) -> Callable[[float], Verdict]:
    """Return the verdict as a function of how far the fence has moved in."""
    return lambda inward_m: check(wanted, NORTHWARD, NOTHING, replace(limits, fence_ned_m=fence(inward_m)), DT_S)


def test_a_vehicle_that_cannot_stop_turns_before_the_fence() -> None:
    edge_m = 300.0 - 10.0 - RHO_M - MARGIN_M - SPARE_M
    assert_refused_from(edge_m, fenced(PLANE, AHEAD, lambda inward_m: box(300.0 - inward_m)), FENCE)


def test_a_vehicle_that_can_stop_stops_before_the_fence() -> None:
    edge_m = 300.0 - 110.0 - MARGIN_M - SPARE_M
    assert_refused_from(edge_m, fenced(COPTER, AHEAD, lambda inward_m: box(300.0 - inward_m)), FENCE)


def test_the_step_itself_keeps_half_a_sample_from_a_corner_of_the_fence() -> None:
    def notched(inward_m: float) -> tuple[tuple[float, float], ...]:
        return ((-1e3, -1e3), (1e3, -1e3), (1e3, 1e3), (6.0, 1e3), (5.0, 100.0 - inward_m), (4.0, 1e3), (-1e3, 1e3))

    assert_refused_from(100.0 - MARGIN_M, fenced(PLANE, AHEAD, notched), FENCE)


def test_the_braking_path_keeps_clear_of_a_corner_that_sticks_into_it() -> None:
    def notched(inward_m: float) -> tuple[tuple[float, float], ...]:
        return ((-1e3, -1e3), (1e3, -1e3), (1e3, 1e3), (61.0, 1e3), (60.0, 100.0 - inward_m), (59.0, 1e3), (-1e3, 1e3))

    assert_refused_from(100.0 - MARGIN_M - SPARE_M, fenced(COPTER, AHEAD, notched), FENCE)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_braking_path_may_not_cross_a_spit_of_outside(side: float) -> None:
    spit = ((1e3, -1e3), (1e3, 1e3), (61.0, 1e3), (60.0, -100.0), (59.0, 1e3), (-1e3, 1e3), (-1e3, -1e3))
    fence = tuple((north, side * east) for north, east in spit)
    assert check(AHEAD, NORTHWARD, NOTHING, replace(COPTER, fence_ned_m=fence), DT_S).changes[0] == FENCE
    assert check(AHEAD, NORTHWARD, NOTHING, replace(COPTER, fence_ned_m=fence[::-1]), DT_S).changes[0] == FENCE


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_turning_circle_to_the_free_side_serves_beside_the_fence(side: float) -> None:
    fence = tuple((north, side * east) for north, east in box(1e3, 5.0))
    assert check(AHEAD, NORTHWARD, NOTHING, replace(PLANE, fence_ned_m=fence), DT_S).changes == ()


def test_disc_on_one_side_and_fence_on_the_other_are_reported_and_turned_from() -> None:
    limits = replace(PLANE, fence_ned_m=box(70.0))
    assert check(AHEAD, NORTHWARD, discs((10.0, RHO_M + 60.0, 40.0)), limits, DT_S).changes == ()
    both = check(AHEAD, NORTHWARD, discs((20.0, RHO_M + 60.0, 58.0)), replace(limits, fence_ned_m=box(50.9)), DT_S)
    assert both.changes[0] == FENCE


@settings(deadline=None, max_examples=100, derandomize=True)
@given(north_m=st.floats(-60.0, 60.0), east_m=st.floats(-60.0, 60.0), turned=st.integers(0, 7), mirrored=st.booleans())
def test_a_still_vehicle_is_inside_a_fence_of_any_shape_exactly_when_it_is(
    north_m: float, east_m: float, turned: int, mirrored: bool
) -> None:
    """An L: easy to say of any point whether it is inside, and concave."""
    corners = [(-50.0, -50.0), (50.0, -50.0), (50.0, 0.0), (0.0, 0.0), (0.0, 50.0), (-50.0, 50.0)]
    inside = max(abs(north_m), abs(east_m)) < 50.0 and not (north_m > 0.0 and east_m > 0.0)
    edges = [abs(abs(north_m) - 50.0), abs(abs(east_m) - 50.0), abs(north_m), abs(east_m)]
    assume(min(edges) > 1e-3)
    fence = tuple((corners[turned % 6 :] + corners[: turned % 6])[:: -1 if mirrored else 1])
    still = Motion(north_m, east_m, 0.0, 0.0)
    verdict = check(Setpoint(0.0, 0.0, 100.0), still, NOTHING, replace(COPTER, fence_ned_m=fence), DT_S)
    assert verdict.changes == (() if inside else (FENCE, NO_BACKUP))


def test_a_fence_with_a_corner_given_twice_is_still_a_fence() -> None:
    fence = ((-1e3, -1e3), (300.0, -1e3), (300.0, -1e3), (300.0, 1e3), (-1e3, 1e3))
    assert check(AHEAD, NORTHWARD, NOTHING, replace(PLANE, fence_ned_m=fence), DT_S).changes == ()


# --- the plane geometry that the fence rests on

POINTS = st.tuples(st.integers(-6, 6), st.integers(-6, 6))


@settings(deadline=None, max_examples=300, derandomize=True)
@given(first=POINTS, last=POINTS, start=POINTS, end=POINTS)
def test_two_segments_cross_when_they_share_a_point_that_ends_neither(
    first: tuple[int, int], last: tuple[int, int], start: tuple[int, int], end: tuple[int, int]
) -> None:
    """Solve for the shared point in exact fractions, with segments small enough for every sign to matter."""
    along, across = ((last[0] - first[0], last[1] - first[1]), (end[0] - start[0], end[1] - start[1]))
    area = along[0] * across[1] - along[1] * across[0]
    assume(area != 0)
    away = (start[0] - first[0], start[1] - first[1])
    on_one = Fraction(away[0] * across[1] - away[1] * across[0], area)
    on_other = Fraction(away[0] * along[1] - away[1] * along[0], area)
    assume(not {on_one, on_other} & {0, 1})
    eighth = [tuple(value / 8.0 for value in point) for point in (first, last, start, end)]
    assert guard._cross(*eighth) == (0 < on_one < 1 and 0 < on_other < 1)


@pytest.mark.parametrize(
    ("segments", "crossing"),
    [
        (((0, 0), (4, 0), (2, 0), (2, 2)), True),  # an end on the line counts as on its right ...
        (((0, 0), (4, 0), (2, 0), (2, -2)), False),
        (((0, 0), (4, 0), (2, 2), (2, 0)), True),
        (((0, 0), (4, 0), (2, -2), (2, 0)), False),
        (((2, 0), (2, 2), (0, 0), (4, 0)), True),  # ... whichever segment it ends
        (((2, 0), (2, -2), (0, 0), (4, 0)), False),
        (((2, 2), (2, 0), (0, 0), (4, 0)), True),
        (((2, -2), (2, 0), (0, 0), (4, 0)), False),
    ],
)
def test_an_end_on_the_other_segment_belongs_to_one_side_of_it(
    segments: tuple[tuple[float, float], ...], crossing: bool
) -> None:
    assert guard._cross(*segments) is crossing


@pytest.mark.parametrize(
    ("point", "distance_m"),
    [
        ((5.0, 3.0), 2.0),
        ((3.0, 1.0), 0.0),
        ((-2.0, -3.0), 5.0),
        ((9.0, 5.0), 5.0),
        ((1.0, 4.0), 3.0),
    ],
)
def test_the_distance_to_a_segment_is_that_to_its_nearest_point(point: tuple[float, float], distance_m: float) -> None:
    assert guard._distance_to_segment_m(point, (1.0, 1.0), (6.0, 1.0)) == distance_m
    assert guard._distance_to_segment_m(point[::-1], (1.0, 6.0), (1.0, 1.0)) == distance_m


def test_the_distance_to_a_segment_without_length_is_that_to_a_point() -> None:
    assert guard._distance_to_segment_m((4.0, 6.0), (1.0, 2.0), (1.0, 2.0)) == 5.0


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
    assert guard._depth_inside_m(point, SQUARE) == depth_m
    assert guard._depth_inside_m(point, SQUARE[::-1]) == depth_m


def test_a_disc_that_touches_the_fence_from_inside_is_inside() -> None:
    assert guard._disc_inside((0.0, 0.0), 8.0, SQUARE)


def test_a_segment_that_keeps_just_the_margin_from_a_corner_is_inside() -> None:
    spit = ((-8.0, -8.0), (8.0, -8.0), (8.0, 8.0), (0.25, 8.0), (0.0, 3.0), (-0.25, 8.0), (-8.0, 8.0))
    assert guard._segment_inside((-4.0, 0.0), (4.0, 0.0), spit, 3.0)
    assert not guard._segment_inside((-4.0, 0.0), (4.0, 0.0), spit, 3.001)


def test_a_disc_that_touches_the_turning_circle_from_either_side_leaves_it_clear() -> None:
    limits = replace(PLANE, n_max=4.0 / G_M_S2)
    step = guard._Step(0.0, 2.0)
    assert 2.0 / turn_rate_rad_s(2.0, limits) == 1.0
    for touching in (discs((0.0, 3.0, 1.0), (0.0, -3.0, 1.0)), discs((0.0, 1.0, 1.0), (0.0, -1.0, 1.0))):
        assert guard._broken_circles((0.0, 0.0), step, touching, limits, 0.5, 0.0) is None
        assert guard._broken_circles((0.0, 0.0), step, touching, limits, 0.5, 1e-12) == KEEP_OUT


# --- the cheap way out


def test_the_shortcut_is_taken_just_beyond_seven_steps_and_a_turning_circle(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("the full check ran")

    monkeypatch.setattr(guard, "_kept_clear", refuse)
    for limits, backup_m in ((PLANE, 2.0 * RHO_M), (COPTER, 100.0)):
        for wanted, motion in ((replace(AHEAD, speed_m_s=1.0), NORTHWARD), (AHEAD, replace(NORTHWARD, speed_m_s=1.0))):
            reach_m = 70.0 + backup_m + SPARE_M + 50.0 + 3.0 * 30.5
            limits = replace(limits, speed_min_m_s=min(limits.speed_min_m_s, 1.0))
            check(wanted, motion, discs((0.0, -reach_m - HAIR, 50.0), speed_m_s=3.0), limits, DT_S)
            with pytest.raises(AssertionError, match="the full check ran"):
                check(wanted, motion, discs((0.0, -reach_m + HAIR, 50.0), speed_m_s=3.0), limits, DT_S)


@settings(deadline=None, max_examples=60, derandomize=True)
@given(
    case=st.one_of(_cases(can_stop=False), _cases(can_stop=True)), beyond_m=st.floats(0.0, 1.0), w=st.floats(0.0, 9.0)
)
def test_a_disc_called_far_by_the_shortcut_changes_nothing_in_the_full_check(
    case: _Case, beyond_m: float, w: float
) -> None:
    radius_m = max(0.0, math.dist(case.centre, (case.motion.north_m, case.motion.east_m)) - beyond_m)
    scene = discs((*case.centre, 0.0), speed_m_s=w)
    for share in np.linspace(0.2, 1.0, 4):
        scene.radii_m[0] = share * radius_m
        cheap = check(case.wanted, case.motion, scene, case.limits, case.dt_s)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(guard, "_is_far", lambda *_: False)
            assert check(case.wanted, case.motion, scene, case.limits, case.dt_s) == cheap


# --- the induction: a certified start never ends inside

SUBSTEPS = 32


def fly_step(motion: Motion, setpoint: Setpoint, limits: Limits, dt_s: float) -> list[Motion]:
    """Return the motion at many moments of a step as the guard assumes the vehicle to fly.

    One that cannot stop has its new speed, and the turn rate of that speed, at once. One that can has a greater speed
    at once, slows at its braking, and turns at the rate of the greater speed.
    """
    at = (motion.north_m, motion.east_m, motion.heading_rad)
    if limits.braking_m_s2 is None:
        speed_m_s = setpoint.speed_m_s
        rate_rad_s = turn_rate_rad_s(speed_m_s, limits)
        times_s = np.linspace(0.0, dt_s, SUBSTEPS + 1)[1:]
        return [
            Motion(*turn_towards(*at, speed_m_s, setpoint.heading_rad, rate_rad_s, float(t_s)), speed_m_s)
            for t_s in times_s
        ]
    rate_rad_s = turn_rate_rad_s(max(motion.speed_m_s, setpoint.speed_m_s), limits)
    speed_m_s, step_s, flown = max(motion.speed_m_s, setpoint.speed_m_s), dt_s / SUBSTEPS, []
    for _ in range(SUBSTEPS):
        slower_m_s = max(setpoint.speed_m_s, speed_m_s - limits.braking_m_s2 * step_s)
        braking_s = (speed_m_s - slower_m_s) / limits.braking_m_s2
        mean_m_s = slower_m_s + (speed_m_s - slower_m_s) * braking_s / step_s / 2.0
        at = turn_towards(*at, mean_m_s, setpoint.heading_rad, rate_rad_s, step_s)
        speed_m_s = slower_m_s
        flown.append(Motion(*at, speed_m_s))
    return flown


def wicked(rng: np.random.Generator, motion: Motion, scene: Discs, limits: Limits, at: np.ndarray) -> Setpoint:
    """Return a setpoint from an adversary that makes for a disc or a place, grazes it, or wants anything at all."""
    kind = rng.integers(6)
    away = at - (motion.north_m, motion.east_m)
    bearing_rad = math.atan2(away[1], away[0])
    heading_rad = {
        0: rng.uniform(-10.0, 10.0),
        1: motion.heading_rad,
        2: bearing_rad + rng.choice([-0.5, 0.5]) * math.pi,
    }.get(int(kind), bearing_rad)
    speed_m_s = rng.choice(
        [limits.speed_min_m_s, limits.speed_max_m_s, motion.speed_m_s, rng.uniform(-5.0, 1.2 * limits.speed_max_m_s)]
    )
    if rng.random() < 0.02:
        heading_rad = math.nan
    return Setpoint(float(heading_rad), float(speed_m_s), 100.0)


@dataclass(frozen=True)
class World:
    limits: Limits
    dt_s: float
    side_m: float
    discs: int
    radius_m: float
    """The greatest; the least is a tenth of it."""


FLAT_OUT = Limits(30.0, 30.0, 1.0, 50.0, 120.0)
STAR = ((-700.0, -700.0), (-100.0, 0.0), (-700.0, 700.0), (0.0, 150.0), (700.0, 700.0), (500.0, 0.0), (700.0, -700.0))
WORLDS = {
    "one speed": World(FLAT_OUT, 0.5, 1500.0, 25, 120.0),
    "many speeds": World(replace(FLAT_OUT, speed_min_m_s=12.0), 0.5, 1500.0, 25, 120.0),
    "quick turns": World(replace(FLAT_OUT, speed_min_m_s=5.0, n_max=3.0), 1.0, 700.0, 25, 60.0),
    "the paper's step": World(Limits(60.0, 60.0, 10.0, 50.0, 120.0), 5.0, 6000.0, 25, 500.0),
    "fence": World(replace(FLAT_OUT, fence_ned_m=STAR, speed_min_m_s=20.0), 0.5, 1400.0, 8, 80.0),
    "stops": World(Limits(0.0, 20.0, 0.5, 50.0, 120.0, 3.0), 0.5, 500.0, 25, 50.0),
    "stops at a fence": World(Limits(0.0, 20.0, 0.5, 50.0, 120.0, 3.0, STAR), 0.5, 1400.0, 8, 80.0),
    "stops dead": World(Limits(0.0, 10.0, 0.25, 50.0, 120.0, 50.0), 0.5, 150.0, 25, 15.0),
}


def inside_polygon(places: np.ndarray, fence: tuple[tuple[float, float], ...]) -> bool:
    """Return whether all places are inside, by winding number: not the guard's own way."""
    corners = np.array(fence)[None, :, :] - places[:, None, :]
    ahead = np.roll(corners, -1, axis=1)
    cross = corners[..., 0] * ahead[..., 1] - corners[..., 1] * ahead[..., 0]
    dot = np.sum(corners * ahead, axis=-1)
    return bool(np.all(np.abs(np.sum(np.arctan2(cross, dot), axis=1)) > 1.0))


def certified_start(rng: np.random.Generator, world: World, scene: Discs) -> Motion | None:
    """Return a start that the guard lets go straight on; None for one that it does not."""
    limits = world.limits
    place = rng.uniform(-world.side_m / 2.0, world.side_m / 2.0, 2)
    speed_m_s = rng.uniform(limits.speed_min_m_s, limits.speed_max_m_s)
    motion = Motion(float(place[0]), float(place[1]), float(rng.uniform(-4.0, 4.0)), float(speed_m_s))
    straight = Setpoint(motion.heading_rad, motion.speed_m_s, 100.0)
    return None if check(straight, motion, scene, limits, world.dt_s).changes else motion


def adversarial_flight(world: World, seed: int, steps: int) -> tuple[int, int]:
    """Fly steps against an adversary in one random scene; return how many were refused and how many flown.

    Asserts that a back-up is never lacking and that no moment of the flight is inside a disc or outside the fence.
    """
    rng = np.random.default_rng(seed)
    scene = Discs(
        rng.uniform(-world.side_m / 2.0, world.side_m / 2.0, (world.discs, 2)),
        world.radius_m * rng.uniform(0.1, 1.0, world.discs),
        np.zeros(world.discs),
    )
    motion, tries = None, 0
    while motion is None and tries < 100:
        motion, tries = certified_start(rng, world, scene), tries + 1
    if motion is None:
        return 0, 0
    refused, at = 0, np.zeros(2)
    for index in range(steps):
        if index % 25 == 0:
            at = (
                scene.centres_ned_m[rng.integers(world.discs)]
                if rng.random() < 0.7
                else rng.uniform(-1, 1, 2) * world.side_m
            )
        wanted = wicked(rng, motion, scene, world.limits, at)
        verdict = check(wanted, motion, scene, world.limits, world.dt_s)
        assert verdict.setpoint is not None
        assert NO_BACKUP not in verdict.changes
        refused += KEEP_OUT in verdict.changes or FENCE in verdict.changes
        flown = fly_step(motion, verdict.setpoint, world.limits, world.dt_s)
        places = np.array([(one.north_m, one.east_m) for one in flown])
        apart_m = np.hypot(
            places[:, None, 0] - scene.centres_ned_m[:, 0], places[:, None, 1] - scene.centres_ned_m[:, 1]
        )
        assert np.min(apart_m - scene.radii_m) > 0.0
        if world.limits.fence_ned_m is not None:
            assert inside_polygon(places, world.limits.fence_ned_m)
        motion = flown[-1]
    return refused, steps


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS.keys())
def test_a_certified_start_never_enters_whatever_the_adversary_wants(world: World) -> None:
    flights = [adversarial_flight(world, seed, steps=125) for seed in range(3)]
    refused, flown = (sum(column) for column in zip(*flights, strict=True))
    assert flown >= 250 and refused >= flown // 40, "the adversary never tried"
