"""The guard: every limit, every reason, every assumption, and its theorem: a certified start is never inside a disc."""

import ast
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.geo.kinematics import turn_towards
from companion.guard import guard
from companion.guard.guard import Guard
from companion.guard.types import (
    ALTITUDE,
    BACKUP,
    FENCE,
    IMPOSSIBLE,
    KEEP_OUT,
    LATE,
    NEW_THREAT,
    NO_BACKUP,
    NOT_FINITE,
    POSITION,
    RATE,
    SPEED,
    THREAT_FASTER,
    TURN,
    WIND,
    Discs,
    Limits,
    Motion,
    Piece,
    Setpoint,
    Verdict,
)

G_M_S2 = 9.80665
BAD = [math.nan, math.inf, -math.inf]
HAIR = 1e-8
"""Far under the guard's own rounding allowance of 1e-6 m, far over what doubles lose here."""

PLANE = Limits(20.0, 20.0, 1.0, 50.0, 120.0)
"""Cannot stop; its turning circle is 40.8 m, its step 10 m."""
COPTER = Limits(0.0, 20.0, 1.0, 50.0, 120.0, braking_m_s2=2.0)
DT_S = 0.5
RHO_M = 400.0 / G_M_S2
NORTHWARD = Motion(0.0, 0.0, 0.0, 20.0)
AHEAD = Setpoint(0.0, 20.0, 100.0)
SPARE_M = 1e-6


def discs(*entries: tuple[float, float, float], speed_m_s: float = 0.0) -> Discs:
    """Return discs of (north, east, radius), all with one speed."""
    table = np.array(entries, dtype=float).reshape(-1, 3)
    return Discs(table[:, :2], table[:, 2], np.full(len(table), speed_m_s))


NOTHING = discs()


def check(wanted: Setpoint, motion: Motion, around: Discs, limits: Limits, dt_s: float = DT_S) -> Verdict:
    """Return what a guard that was asked nothing before says."""
    return Guard(limits).check(wanted, motion, around, 0.0, dt_s)


def turn_rate_rad_s(speed_m_s: float, limits: Limits) -> float:
    return limits.rate_share * limits.n_max * G_M_S2 / max(speed_m_s, 0.5)


def turn_of(verdict: Verdict, motion: Motion) -> float:
    assert verdict.setpoint is not None
    return math.remainder(verdict.setpoint.heading_rad - motion.heading_rad, math.tau)


# --- what it may depend on


def test_the_guard_imports_nothing_but_numpy_and_the_standard_library() -> None:
    for module in Path(guard.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or "companion"]
            for name in names:
                own = name.startswith("companion.guard.")
                assert own or name.split(".")[0] in {"numpy", *sys.stdlib_module_names}, (module.name, name)


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
    assert verdict == Verdict(Setpoint(1.25, 7.0, 85.0), (NOT_FINITE,), certified_s=math.inf)


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
        {"reaction_s": -0.1},
        {"reaction_s": math.nan},
        {"reaction_s": math.inf},
        {"rate_share": 0.0},
        {"rate_share": 1.1},
        {"rate_share": math.nan},
        {"wind_m_s": -1.0},
        {"wind_m_s": 20.0},
        {"speed_min_m_s": 10.0, "wind_m_s": 15.0},
        {"wind_m_s": math.nan},
        {"speed_min_m_s": 0.0, "braking_m_s2": 1.0, "wind_m_s": 20.0},
        {"position_error_m": -1.0},
        {"position_error_m": math.inf},
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
    replace(PLANE, wind_m_s=19.9)
    replace(PLANE, speed_min_m_s=0.5)
    replace(COPTER, wind_m_s=19.9)
    Limits(0.0, 0.0, 0.1, 50.0, 50.0, braking_m_s2=0.1, fence_ned_m=((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)), horizon_s=0.0)


def test_discs_are_kept_clear_of_for_half_a_minute_unless_told_otherwise() -> None:
    assert PLANE.horizon_s == 30.0


# --- speed, altitude, turn


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
    flown_m_s = motion.speed_m_s
    if limits.braking_m_s2 is None:
        flown_m_s = min(max(flown_m_s, limits.speed_min_m_s), limits.speed_max_m_s)
    most_rad = turn_rate_rad_s(max(speed_m_s, flown_m_s), limits) * dt_s
    rounding_rad = 4.0 * math.ulp(abs(motion.heading_rad))
    assert abs(turn_of(verdict, motion)) <= most_rad + 2e-9 + rounding_rad


# --- a vehicle as the guard assumes it, reaction and wind included

MOMENTS = 16


def sent(verdict: Verdict) -> Setpoint:
    assert verdict.setpoint is not None
    return verdict.setpoint


def calm(_t_s: float) -> tuple[float, float]:
    return 0.0, 0.0


@dataclass
class Vehicle:
    """Obeys a setpoint after the reaction time; the air carries it, and it crabs to hold its course against that.

    It turns at the rate of the greater of its speeds before and after. One that can stop slows at its braking; any
    other speed is there at once.
    """

    start: Motion
    limits: Limits
    wind: Callable[[float], tuple[float, float]] = calm
    share: float = 1.0
    """Of the turn rate that the guard was told."""
    t_s: float = 0.0
    coming: list[tuple[float, Setpoint]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.north_m, self.east_m, self.speed_m_s = self.start.north_m, self.start.east_m, self.start.speed_m_s
        self.now: Setpoint | None = None
        self.nose_rad = self.crabbed(self.start.heading_rad)
        self.rate_rad_s = self.share * turn_rate_rad_s(self.speed_m_s, self.limits)

    def crabbed(self, course_rad: float) -> float:
        wind = self.wind(self.t_s)
        across_m_s = wind[1] * math.cos(course_rad) - wind[0] * math.sin(course_rad)
        return course_rad - math.asin(across_m_s / self.speed_m_s) if across_m_s else course_rad

    @property
    def motion(self) -> Motion:
        wind = self.wind(self.t_s)
        if wind == (0.0, 0.0):
            return Motion(self.north_m, self.east_m, self.nose_rad, self.speed_m_s)
        north_m_s = self.speed_m_s * math.cos(self.nose_rad) + wind[0]
        east_m_s = self.speed_m_s * math.sin(self.nose_rad) + wind[1]
        return Motion(self.north_m, self.east_m, math.atan2(east_m_s, north_m_s), math.hypot(north_m_s, east_m_s))

    def obey(self, setpoint: Setpoint) -> None:
        self.coming.append((self.limits.reaction_s, setpoint))

    def fly(self, dt_s: float) -> np.ndarray:  # (MOMENTS, 2) m
        """Fly on, and return where it was at evenly spaced moments."""
        places = []
        for _ in range(MOMENTS):
            left_s = dt_s / MOMENTS
            while left_s > 1e-12:
                while self.coming and self.coming[0][0] <= 1e-9:
                    self.take(self.coming.pop(0)[1])
                part_s = min([left_s, *(starts_s for starts_s, _ in self.coming[:1])])
                self.move(part_s)
                self.coming = [(starts_s - part_s, setpoint) for starts_s, setpoint in self.coming]
                left_s -= part_s
            places.append((self.north_m, self.east_m))
        return np.array(places)

    def take(self, setpoint: Setpoint) -> None:
        self.now = setpoint
        faster_m_s = max(self.speed_m_s, setpoint.speed_m_s)
        self.rate_rad_s = self.share * turn_rate_rad_s(faster_m_s, self.limits)
        self.speed_m_s = setpoint.speed_m_s if self.limits.braking_m_s2 is None else faster_m_s

    def move(self, dt_s: float) -> None:
        wanted_rad, mean_m_s = self.nose_rad, self.speed_m_s
        if self.now is not None:
            wanted_rad = self.crabbed(self.now.heading_rad)
            slowing_m_s2 = self.limits.braking_m_s2 or 0.0
            slower_m_s = max(self.now.speed_m_s, self.speed_m_s - slowing_m_s2 * dt_s)
            lost_m_s = self.speed_m_s - slower_m_s
            mean_m_s = slower_m_s + (lost_m_s * lost_m_s / slowing_m_s2 / dt_s / 2.0 if lost_m_s else 0.0)
            self.speed_m_s = slower_m_s
        at = (self.north_m, self.east_m, self.nose_rad)
        self.north_m, self.east_m, self.nose_rad = turn_towards(*at, mean_m_s, wanted_rad, self.rate_rad_s, dt_s)
        wind = self.wind(self.t_s)
        self.north_m, self.east_m, self.t_s = (
            self.north_m + wind[0] * dt_s,
            self.east_m + wind[1] * dt_s,
            self.t_s + dt_s,
        )


def gusts(rng: np.random.Generator, bound_m_s: float) -> Callable[[float], tuple[float, float]]:
    """Return a wind that never exceeds a bound: a mean, and gusts that change over ten seconds."""
    share, turned_rad = rng.uniform(), rng.uniform(0.0, math.tau)
    mean = bound_m_s * share * np.array([math.cos(turned_rad), math.sin(turned_rad)])
    bearings_rad = rng.uniform(0.0, math.tau, 200)
    drawn = bound_m_s * (1.0 - share) * np.sqrt(rng.uniform(size=(200, 1)))
    drawn = drawn * np.column_stack([np.cos(bearings_rad), np.sin(bearings_rad)])

    def at(t_s: float) -> tuple[float, float]:
        index, part = int(t_s // 10.0) % 199, t_s / 10.0 % 1.0
        wind = mean + (1.0 - part) * drawn[index] + part * drawn[index + 1]
        return float(wind[0]), float(wind[1])

    return at


def apart_m(places: np.ndarray, scene: Discs) -> float:
    """Return the least distance from the edge of a disc."""
    away = places[:, None, :] - scene.centres_ned_m
    return float(np.min(np.hypot(away[..., 0], away[..., 1]) - scene.radii_m, initial=math.inf))


# --- keep-out: where exactly a lone disc begins to matter


def assert_refused_from(
    edge_m: float, scene: Callable[[float], Verdict], reason: str = KEEP_OUT, hair_m: float = HAIR
) -> None:
    """Assert that a scene of one growing length is accepted up to an edge and refused beyond it for the reason."""
    assert scene(edge_m - hair_m).changes == ()
    assert scene(edge_m + hair_m).changes[:1] == (reason,)


def lone(north_m: float, east_m: float, limits: Limits = PLANE, **wanted: float) -> Callable[[float], Verdict]:
    """Return the verdict on a step northward as a function of the radius of one still disc."""
    return lambda radius_m: check(replace(AHEAD, **wanted), NORTHWARD, discs((north_m, east_m, radius_m)), limits)


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
    loop = Guard(Limits(60.0, 60.0, 10.0, 50.0, 120.0))._loop(guard._Pose(1.0, 2.0, 0.3), side, 60.0, 5.0)
    turns_rad = [piece.curvature_1_m * piece.length_m for piece in loop]
    assert turns_rad == pytest.approx([side * math.pi / 2.0, 0.0] * 4)
    assert [corner.length_m + line.length_m for corner, line in zip(loop[::2], loop[1::2], strict=True)] == [300.0] * 4
    assert_hangs_together(guard._Path(loop, len(loop), 60.0, math.inf))


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


@settings(deadline=None, max_examples=60, derandomize=True)
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


@settings(deadline=None, max_examples=60, derandomize=True)
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


@settings(deadline=None, max_examples=60, derandomize=True)
@given(case=st.one_of(_cases(can_stop=False), _cases(can_stop=True)), beyond_m=st.floats(0.0, 1.0))
def test_a_disc_called_far_changes_nothing_in_the_full_check(case: _Case, beyond_m: float) -> None:
    radius_m = max(0.0, math.dist(case.centre, (case.motion.north_m, case.motion.east_m)) - beyond_m)
    for share in (0.2, 0.5, 0.8, 1.0):
        scene = discs((*case.centre, share * radius_m))
        cheap = check(case.wanted, case.motion, scene, case.limits, case.dt_s)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Guard, "_reach_m", lambda *_: math.inf)
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
        reach_m = guarded._reach_m(motion, before_m_s, guard._Step(0.0, wanted_m_s), DT_S)
        assert reach_m == pytest.approx(24.0 * (6.0 * DT_S + 1.0) + backup_m + inflation_m)


# --- which step is taken instead


def test_a_milder_turn_is_taken_where_the_wanted_one_is_refused() -> None:
    """A disc on the right: half the turn still clears it, the whole does not."""
    most_rad = G_M_S2 / 20.0 * DT_S
    end = turn_towards(0.0, 0.0, 0.0, 20.0, most_rad, G_M_S2 / 20.0, DT_S)
    scene = discs((end[0] - 2.0 * math.sin(end[2]), end[1] + 2.0 * math.cos(end[2]), 2.05))
    verdict = check(replace(AHEAD, heading_rad=most_rad), NORTHWARD, scene, PLANE)
    assert verdict.changes == (KEEP_OUT,)
    assert turn_of(verdict, NORTHWARD) == pytest.approx(most_rad / 2.0)
    assert verdict.certified_s == math.inf


def test_after_the_wanted_step_come_half_the_turn_none_and_full_turns_nearest_first_then_at_the_speed_flown() -> None:
    limits = replace(PLANE, speed_min_m_s=10.0)
    guarded, step = Guard(limits), guard._Step(-0.2, 15.0)
    flight = guarded._flight(guard._Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, DT_S, ())
    most_rad = G_M_S2 / 20.0 * DT_S
    turns_rad = [-most_rad, -0.1, 0.0, most_rad]
    expected = [(-0.2, 15.0), *((turn_rad, speed_m_s) for speed_m_s in (15.0, 20.0) for turn_rad in turns_rad)]
    assert list(guarded._choices(step, flight)) == expected
    assert list(guarded._choices(guard._Step(0.0, 20.0), flight)) == [
        (0.0, 20.0),
        *((turn_rad, 20.0) for turn_rad in (0.0, 0.0, most_rad, -most_rad)),
    ]
    stopping = Guard(COPTER)
    last = list(stopping._choices(guard._Step(0.0, 20.0), flight))[-1]
    assert last == (0.0, 0.0)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("bearing_rad", [0.0, 2.0, 3.1, 5.5])
def test_where_both_sides_are_clear_the_wanted_side_and_speed_are_kept(side: float, bearing_rad: float) -> None:
    limits, motion = replace(PLANE, speed_min_m_s=10.0), replace(NORTHWARD, heading_rad=bearing_rad, speed_m_s=15.0)
    ahead = (68.0 * math.cos(bearing_rad), 68.0 * math.sin(bearing_rad))
    wanted = Setpoint(bearing_rad + side * 0.01, 15.0, 100.0)
    verdict = check(wanted, motion, discs((*ahead, 46.0)), limits)
    assert verdict.changes == (KEEP_OUT,)
    assert verdict.setpoint is not None and verdict.setpoint.speed_m_s == 15.0
    assert turn_of(verdict, motion) == pytest.approx(side * G_M_S2 / 15.0 * DT_S)


def test_the_right_circle_is_the_back_up_where_both_are_clear() -> None:
    """Asked for nothing that is allowed any more, the vehicle turns right."""
    guarded, vehicle = Guard(PLANE), Vehicle(NORTHWARD, PLANE)
    vehicle.obey(sent(guarded.check(AHEAD, NORTHWARD, discs((60.0, 0.0, 23.0)), 0.0, DT_S)))
    vehicle.fly(DT_S)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_accepted", lambda *_: KEEP_OUT)
        verdict = guarded.check(AHEAD, vehicle.motion, discs((60.0, 0.0, 23.0)), DT_S, DT_S)
    assert verdict.changes == (KEEP_OUT, BACKUP)
    assert turn_of(verdict, vehicle.motion) == pytest.approx(G_M_S2 / 20.0 * DT_S)


def test_a_step_that_continues_the_path_in_hand_is_let_through_without_a_circle() -> None:
    scene = discs((60.0, 0.0, 23.0))
    guarded, vehicle = Guard(PLANE), Vehicle(NORTHWARD, PLANE)
    vehicle.obey(sent(guarded.check(AHEAD, NORTHWARD, scene, 0.0, DT_S)))
    vehicle.fly(DT_S)
    onward = replace(AHEAD, heading_rad=G_M_S2 / 20.0 * DT_S)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_to_rest", lambda *_: KEEP_OUT)
        assert guarded.check(onward, vehicle.motion, scene, DT_S, DT_S).changes == ()


def test_a_start_whose_every_step_is_refused_flies_the_path_that_certified_it() -> None:
    """The arc to the escape turns by more than a step: no step is accepted by the cheap headings, the fan finds it."""
    scene = Discs(np.array([[-150.0, 0.0], [320.0, 0.0]]), np.array([100.0, 100.0]), np.array([6.0, 6.0]))
    guarded = Guard(PLANE)
    assert guarded.certify(NORTHWARD, scene, DT_S)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_accepted", lambda *_: KEEP_OUT)
        verdict = guarded.check(AHEAD, NORTHWARD, scene, 0.0, DT_S)
    assert verdict.changes == (KEEP_OUT, BACKUP)
    assert verdict.certified_s == math.inf


def test_a_path_from_where_the_next_command_acts_is_clear_for_the_horizon_from_there() -> None:
    limits = replace(PLANE, fence_ned_m=box(1e3), horizon_s=7.0)
    edge_m = math.hypot(150.0, RHO_M) - RHO_M - 7.0 * 3.0 - SPARE_M
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_accepted", lambda *_: KEEP_OUT)
        patch.setattr(Guard, "_ray", lambda *_: None)
        for hair_m, said in ((-HAIR, ((KEEP_OUT, BACKUP), 7.0)), (HAIR, ((KEEP_OUT, NO_BACKUP), 0.0))):
            verdict = check(AHEAD, NORTHWARD, discs((150.0, 0.0, edge_m + hair_m), speed_m_s=3.0), limits)
            assert (verdict.changes, verdict.certified_s) == said


# --- the route as back-up

GATE = discs((100.0, 60.0, 50.0), (100.0, -60.0, 50.0), (20.0, 60.0, 50.0), (20.0, -60.0, 50.0))
"""A corridor 20 m wide, too narrow for a turning circle; the vehicle is in it and must get through it."""
THROUGH = (Piece(0.0, 0.0, 0.0, 0.0, 400.0),)


def test_through_a_gap_too_narrow_for_a_circle_the_route_serves() -> None:
    motion = replace(NORTHWARD, north_m=60.0)
    assert check(AHEAD, motion, GATE, PLANE).changes[0] == KEEP_OUT
    guarded = Guard(PLANE)
    verdict = guarded.check(AHEAD, motion, GATE, 0.0, DT_S, THROUGH)
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
    assert Guard(PLANE).check(wanted, motion, discs(*rows), 0.0, DT_S, route).changes == ()


@pytest.mark.parametrize("value", BAD)
def test_a_route_that_is_not_finite_is_no_route(value: float) -> None:
    motion = replace(NORTHWARD, north_m=60.0)
    bad = (Piece(value, 0.0, 0.0, 0.0, 400.0),)
    assert Guard(PLANE).check(AHEAD, motion, GATE, 0.0, DT_S, bad).changes[0] == KEEP_OUT


def test_a_route_into_a_disc_is_no_back_up() -> None:
    motion = replace(NORTHWARD, north_m=60.0)
    blocked = Discs(np.vstack([GATE.centres_ned_m, [130.0, 0.0]]), np.append(GATE.radii_m, 10.0), np.zeros(5))
    assert Guard(PLANE).check(AHEAD, motion, blocked, 0.0, DT_S, THROUGH).changes[0] == KEEP_OUT


def test_a_route_that_ends_in_the_gap_is_a_back_up_only_if_straight_on_from_there_is_clear() -> None:
    motion = replace(NORTHWARD, north_m=60.0)
    short = (Piece(0.0, 0.0, 0.0, 0.0, 90.0),)
    assert Guard(PLANE).check(AHEAD, motion, GATE, 0.0, DT_S, short).changes == ()
    closed = Discs(np.vstack([GATE.centres_ned_m, [150.0, 0.0]]), np.append(GATE.radii_m, 10.0), np.zeros(5))
    assert Guard(PLANE).check(AHEAD, motion, closed, 0.0, DT_S, short).changes[0] == KEEP_OUT


def test_a_path_in_hand_that_leads_nearly_where_it_is_wanted_is_flown() -> None:
    motion = replace(NORTHWARD, north_m=60.0)
    guard = Guard(PLANE)
    assert guard.check(AHEAD, motion, GATE, 0.0, DT_S, THROUGH).changes == ()
    on = replace(motion, north_m=60.0 + motion.speed_m_s * DT_S)
    nearly = replace(AHEAD, heading_rad=0.005)
    verdict = guard.check(nearly, on, GATE, DT_S, DT_S, THROUGH)
    assert verdict.changes == (BACKUP,)
    assert verdict.setpoint is not None
    assert verdict.setpoint.heading_rad == pytest.approx(0.0, abs=1e-9)


def test_with_keep_right_only_the_circle_to_the_right_takes_the_place_of_a_step_that_would_close_it() -> None:
    closing = discs((60.0, 110.0, 48.0))
    assert Guard(PLANE).check(AHEAD, NORTHWARD, closing, 0.0, DT_S).changes == ()
    guarded = Guard(PLANE)
    verdict = guarded.check(AHEAD, NORTHWARD, closing, 0.0, DT_S, (), True)
    assert (verdict.changes, verdict.certified_s) == ((KEEP_OUT,), math.inf)
    assert guarded._path is not None and all(piece.curvature_1_m > 0.0 for piece in guarded._path.pieces)
    assert verdict.setpoint is not None
    assert verdict.setpoint.heading_rad == pytest.approx(G_M_S2 / 20.0 * DT_S)


def test_with_keep_right_what_leaves_the_circle_to_the_right_clear_is_let_through() -> None:
    away = discs((60.0, -110.0, 60.0))
    verdict = Guard(PLANE).check(AHEAD, NORTHWARD, away, 0.0, DT_S, (), True)
    assert (verdict.changes, verdict.certified_s) == ((), math.inf)


def test_with_keep_right_where_no_circle_to_the_right_is_clear_any_other_back_up_serves() -> None:
    closed = discs((0.0, 95.0, 50.0))
    wanted = replace(AHEAD, heading_rad=math.tau - 0.1)
    assert Guard(PLANE).check(wanted, NORTHWARD, closed, 0.0, DT_S, (), True).changes == ()


def test_who_can_stop_keeps_no_circle() -> None:
    closing = discs((60.0, 110.0, 48.0))
    assert Guard(COPTER).check(AHEAD, NORTHWARD, closing, 0.0, DT_S, (), True).changes == ()


def test_with_short_steps_a_circle_is_looked_for_only_now_and_then_along_the_route() -> None:
    motion = replace(NORTHWARD, north_m=60.0)
    assert Guard(PLANE).check(AHEAD, motion, GATE, 0.0, DT_S / 10.0, THROUGH).changes == ()


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

    def nowhere(_self: Guard, pose: guard._Pose, *_: object) -> str:
        looked.append(pose.north_m)
        return KEEP_OUT

    flight = guarded._flight(guard._Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, dt_s, route)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_to_rest", nowhere)
        begin = guard._Pose(20.0 * dt_s, 0.0, 0.0)
        assert guarded._along_route(begin, guard._Step(0.0, 20.0), 0.0, flight) is None
    assert looked == pytest.approx(places)


def test_along_the_route_no_more_than_what_is_left_of_it_is_looked_at() -> None:
    route = (Piece(-300.0, 0.0, 0.0, 0.0, 300.0),)
    guarded, looked = Guard(PLANE), []

    def nowhere(_self: Guard, pose: guard._Pose, *_: object) -> str:
        looked.append(pose.north_m)
        return KEEP_OUT

    flight = guarded._flight(guard._Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, DT_S, route)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_to_rest", nowhere)
        assert guarded._along_route(guard._Pose(0.0, 0.0, 0.0), guard._Step(0.0, 20.0), 0.0, flight) is None
    # Straight on from its end for as long as a circle is, 256.3 m.
    assert looked == pytest.approx([10.0 * count for count in range(1, 27)])


@pytest.mark.parametrize("bend_1_m", [0.0, 1.0 / 300.0, -1.0 / 300.0])
def test_the_path_along_the_route_hangs_together_and_its_circle_begins_where_it_was_found_clear(
    bend_1_m: float,
) -> None:
    """The vehicle is a little off the route and closes in on it."""
    route = (Piece(0.0, 0.0, 0.0, 0.0, 150.0), Piece(150.0, 0.0, 0.0, bend_1_m, 400.0))
    guarded, looked = Guard(PLANE), []
    flight = guarded._flight(guard._Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, DT_S, route)
    to_rest = Guard._to_rest

    def late(self: Guard, pose: guard._Pose, *rest: object) -> guard._Path | str:
        looked.append(pose)
        return to_rest(self, pose, *rest) if len(looked) == 30 else KEEP_OUT  # type: ignore[arg-type]

    begin = guard._Pose(10.0, 2.0, 0.02)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_to_rest", late)
        path = guarded._along_route(begin, guard._Step(0.0, 20.0), 0.0, flight)
    assert path is not None and path.loops == 1 and path.pieces[0][:3] == begin
    assert_hangs_together(path)
    assert path.pieces[-1][:3] == looked[-1]
    assert sum(piece.length_m for piece in path.pieces[:-1]) == pytest.approx(300.0)
    along_it = guard._Path(route, 0, 20.0, math.inf)
    meets = guard._at(along_it, guard._nearest_along_m(along_it, looked[-1]))
    assert math.dist(meets[:2], looked[-1][:2]) < 0.5


def test_straight_steps_along_the_route_are_one_line() -> None:
    turns_rad = iter([0.1, 0.0, 0.0, -0.2, 0.0, 0.0, 0.0])
    guarded = Guard(PLANE)
    flight = guarded._flight(guard._Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, DT_S, THROUGH)
    circle = guarded._to_rest
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_steered_rad", lambda *_: next(turns_rad))
        patch.setattr(Guard, "_to_rest", lambda _, pose, *rest: circle(pose, *rest) if pose[0] > 69.0 else KEEP_OUT)
        path = guarded._along_route(guard._Pose(0.0, 0.0, 0.0), guard._Step(0.0, 20.0), 0.0, flight)
    assert path is not None
    assert_hangs_together(path)
    arcs_m = [0.1 * RHO_M, 0.2 * RHO_M]
    lengths_m = [arcs_m[0], 30.0 - arcs_m[0], arcs_m[1], 40.0 - arcs_m[1], math.tau * RHO_M]
    assert [piece.length_m for piece in path.pieces] == pytest.approx(lengths_m)


@pytest.mark.parametrize(("spare_m", "clear"), [(2.99, True), (3.01, False)])
def test_what_a_change_of_speed_costs_is_kept_clear_along_the_route_too(spare_m: float, clear: bool) -> None:
    guarded = Guard(PLANE)
    beside = discs((100.0, 60.0, 57.0))
    flight = guarded._flight(guard._Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, beside, DT_S, THROUGH)
    circle = guard._Path((Piece(0.0, 0.0, 0.0, 0.02, math.tau / 0.02),), 1, 20.0, math.inf)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_to_rest", lambda _, pose, *__: circle if pose[0] > 150.0 else KEEP_OUT)
        path = guarded._along_route(guard._Pose(0.0, 0.0, 0.0), guard._Step(0.0, 20.0), spare_m, flight)
    assert (path is not None) is clear


def test_a_corridor_without_an_end_in_sight_is_not_entered() -> None:
    walls = [(80.0 * k - 60.0, side * 60.0, 50.0) for k in range(30) for side in (1.0, -1.0)]
    route = (Piece(0.0, 0.0, 0.0, 0.0, 2_000.0),)
    assert Guard(PLANE).check(AHEAD, NORTHWARD, discs(*walls), 0.0, DT_S, route).changes[0] == KEEP_OUT


def test_a_vehicle_that_can_stop_needs_no_route() -> None:
    blocked = discs((200.0, 0.0, 95.0))
    assert Guard(COPTER).check(AHEAD, NORTHWARD, blocked, 0.0, DT_S, THROUGH).changes == (KEEP_OUT,)


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
    assert_refused_from(200.0 - stop_m - SPARE_M, lone(200.0, 0.0, limits, speed_m_s=wanted_m_s))


def test_a_vehicle_that_cannot_brake_round_a_corner_is_not_allowed_to_try() -> None:
    """Wherever between the two speeds its speed is, it may be beside the path by change times turn."""
    wanted = Setpoint(0.245, 0.0, 100.0)
    end = turn_towards(0.0, 0.0, 0.0, 20.0, 0.245, G_M_S2 / 20.0, DT_S)
    ahead = np.array([math.cos(0.245), math.sin(0.245)])
    beside = np.array([-ahead[1], ahead[0]])
    centre = np.array(end[:2]) + 30.0 * ahead + 12.0 * beside
    edge_m = 12.0 - 20.0 * DT_S * 0.245 - SPARE_M
    assert check(wanted, NORTHWARD, discs((*centre, edge_m - 0.1)), COPTER).changes == ()
    assert check(wanted, NORTHWARD, discs((*centre, edge_m + 0.1)), COPTER).changes == (KEEP_OUT,)


def test_a_vehicle_at_rest_may_stay_beside_a_disc() -> None:
    still = Motion(0.0, 0.0, 0.0, 0.0)
    assert check(Setpoint(0.0, 0.0, 100.0), still, discs((10.0, 0.0, 9.99)), COPTER).changes == ()


def test_a_vehicle_that_can_stop_does_so_when_no_turn_is_clear() -> None:
    verdict = check(AHEAD, NORTHWARD, discs((500.0, 0.0, 395.0)), COPTER)
    assert verdict == Verdict(Setpoint(0.0, 0.0, 100.0), (KEEP_OUT,), certified_s=math.inf)


def test_braking_goes_on_along_its_line_until_the_vehicle_stands() -> None:
    scene, limits = discs((500.0, 0.0, 395.0)), replace(COPTER, n_max=0.01)
    guarded, vehicle = Guard(limits), Vehicle(NORTHWARD, limits)
    for step in range(30):
        vehicle.obey(sent(guarded.check(AHEAD, vehicle.motion, scene, step * DT_S, DT_S)))
        assert apart_m(vehicle.fly(DT_S), scene) > 0.0
    assert vehicle.motion.speed_m_s < 5.0


def test_who_brakes_and_may_do_nothing_else_goes_on_braking() -> None:
    scene = discs((500.0, 0.0, 395.0))
    guarded, vehicle = Guard(COPTER), Vehicle(NORTHWARD, COPTER)
    vehicle.obey(sent(guarded.check(AHEAD, NORTHWARD, scene, 0.0, DT_S)))
    vehicle.fly(DT_S)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_accepted", lambda *_: KEEP_OUT)
        verdict = guarded.check(AHEAD, vehicle.motion, scene, DT_S, DT_S)
    assert verdict == Verdict(Setpoint(0.0, 0.0, 100.0), (KEEP_OUT, BACKUP), certified_s=math.inf)


def test_a_start_whose_every_step_is_refused_brakes_straight_ahead() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_accepted", lambda *_: KEEP_OUT)
        verdict = check(replace(AHEAD, heading_rad=0.2), NORTHWARD, discs((150.0, 0.0, 20.0)), COPTER)
    assert verdict == Verdict(Setpoint(0.0, 0.0, 100.0), (KEEP_OUT, BACKUP), certified_s=math.inf)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("speed_m_s", "turning_m_s"), [(0.3, 0.5), (0.8, 0.8), (5.0, 5.0)])
def test_who_brakes_turns_back_to_its_line_as_the_speed_flown_allows(
    speed_m_s: float, turning_m_s: float, side: float
) -> None:
    guarded = Guard(replace(COPTER, n_max=0.01))
    guarded._path = guard._Path((Piece(0.0, 0.0, side, 0.0, 10.0),), 0, 0.0, math.inf)
    motion = replace(NORTHWARD, speed_m_s=speed_m_s)
    flight = guarded._flight(guard._Pose(0.0, 0.0, 0.0), speed_m_s, motion, NOTHING, DT_S, ())
    assert guarded._continued(flight) == pytest.approx((side * 0.01 * G_M_S2 / turning_m_s * DT_S, 0.0))


# --- moving discs


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
        patch.setattr(Guard, "_likely_headings_rad", lambda _self, pose, _discs: iter([pose.heading_rad]))
        patch.setattr(guard, "_fan_rad", lambda *_: [])
        assert_refused_from(edge_m, scene, hair_m=1e-6)


@settings(deadline=None, max_examples=150, derandomize=True)
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
        assert guard._met(line, [disc], 10.0, 2.0, lasts_s, 0.5) is met


@pytest.mark.parametrize("share", [1.0, 1.5])
def test_a_disc_as_fast_as_the_vehicle_is_judged_at_the_end_of_its_time(share: float) -> None:
    line = Piece(0.0, 0.0, 0.0, 0.0, 100.0)
    edge_m = math.hypot(100.0 - 30.0, 400.0) - 10.0 * share * 10.0
    disc = (30.0, 400.0, edge_m, 10.0 * share)
    assert not guard._met(line, [disc], 10.0, 0.0, 10.0, -1e-9)
    assert guard._met(line, [disc], 10.0, 0.0, 10.0, 1e-9)


@pytest.mark.parametrize(("spare_m", "met"), [(0.0, True), (-1.0, False)])
def test_a_disc_that_is_hardly_slower_may_reach_a_line_in_between(spare_m: float, met: bool) -> None:
    """Inside from 78 to 122 s, clear again long before the end."""
    line, disc = Piece(97.9, 48.12, 0.0, 0.0, 10_000.0), (0.0, 0.0, 100.0, 9.99)
    t_s = np.linspace(0.0, 1000.0, 10_001)
    room_m = np.hypot(97.9 + 10.0 * t_s, 48.12) - 100.0 - spare_m - 9.99 * t_s
    assert bool((room_m < 0.0).any()) is met and room_m[0] > 0.0 and room_m[-1] > 0.0
    assert guard._met(line, [disc], 10.0, 0.0, 1000.0, spare_m) is met


def test_a_disc_that_is_hardly_slower_does_not_reach_a_line_that_leads_away_from_it() -> None:
    """Half a centimetre clear at the start, and more and more from then on."""
    line, disc = Piece(99.99, math.sqrt(10_001.0 - 99.99**2), 0.0, 0.0, math.inf), (0.0, 0.0, 100.0, 9.99)
    assert not guard._met(line, [disc], 10.0, 0.0, math.inf, 0.0)


def test_inside_a_disc_a_line_is_met_even_straight_away() -> None:
    assert guard._met(Piece(0.0, 0.0, 0.0, 0.0, math.inf), [(-1.0, 0.0, 2.0, 1.0)], 10.0, 0.0, math.inf, 0.0)


@settings(deadline=None, max_examples=60, derandomize=True)
@given(seed=st.integers(0, 10_000), endless=st.booleans(), coarse=st.booleans())
def test_the_fan_offers_exactly_the_turns_that_are_clear_one_by_one(seed: int, endless: bool, coarse: bool) -> None:
    rng = np.random.default_rng(seed)
    table = np.column_stack(
        [rng.uniform(-600, 600, (6, 2)), rng.uniform(5, 90, 6), rng.choice([0.0, 3.0, 9.0, 20.0, 21.0], 6)]
    )
    if endless:
        table[:, 3] = np.minimum(table[:, 3], 9.0)
    pose = guard._Pose(0.0, 0.0, float(rng.uniform(-4, 4)))
    length_m = math.inf if endless else 500.0
    most_rad = 3.0 if coarse else math.tau
    offered = guard._fan_rad(pose, 0.02, length_m, 20.0, table, most_rad)
    rows = [tuple(row) for row in table.tolist()]
    one_by_one = []
    for steps in range(-32, 33):
        turn_rad = steps * math.tau / 32
        if abs(turn_rad) > most_rad + 1e-9:
            continue
        pieces = guard._turned(pose, turn_rad, 0.02, length_m)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(guard, "SUB_ARC_RAD", math.tau / 32 + 1e-9)
            pieces = guard._turned(pose, turn_rad, 0.02, length_m)
        if guard._clear(pieces, rows, 20.0, 0.0, 0.0):
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
        assert guard._fan_rad(guard._Pose(0.0, 0.0, 0.0), 0.02, 500.0, 20.0, table, 0.1) == offered


def test_the_fan_offers_the_mildest_turn_first_and_of_two_the_one_to_the_right() -> None:
    far = np.array([[-1e5, 0.0, 1.0, 3.0]])
    step_rad = math.tau / 32.0
    offered = guard._fan_rad(guard._Pose(0.0, 0.0, 0.3), 0.02, 500.0, 20.0, far, 3.0)
    assert len(offered) == 2 * 16
    assert offered[:5] == pytest.approx([0.0, 0.0, step_rad, -step_rad, 2.0 * step_rad])
    assert offered[-1] == pytest.approx(-15.0 * step_rad)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("heading_rad", [0.4, -2.5])
def test_the_fan_offers_no_turn_past_a_disc_on_its_arc(heading_rad: float, side: float) -> None:
    """The disc is 1.03 rad along the arc, between the fifth step and the sixth; the line after the fifth meets it."""
    pose = guard._Pose(30.0, -20.0, heading_rad)
    on_arc = guard._place_on(Piece(*pose, side * 0.02, 0.0), 50.0 * 1.03)
    table = np.array([[*on_arc[:2], 1.0, 0.0]])
    offered = guard._fan_rad(pose, 0.02, math.inf, 20.0, table, 3.0)
    passed = sorted(abs(turn_rad) for turn_rad in offered if side * turn_rad > 0.0)
    assert passed == pytest.approx([count * math.tau / 32.0 for count in range(1, 5)])


def test_on_an_arc_a_moving_disc_counts_as_large_as_at_its_end() -> None:
    arc = Piece(0.0, 0.0, 0.0, 0.02, 25.0)
    far_m = math.dist(
        (50.0 * math.sin(0.25), 50.0 - 50.0 * math.cos(0.25)), (200.0 * math.sin(0.25), 50.0 - 200.0 * math.cos(0.25))
    )
    disc = (200.0 * math.sin(0.25), 50.0 - 200.0 * math.cos(0.25), far_m - 3.0 * (25.0 / 20.0 + 1.0), 3.0)
    assert guard._clear([arc], [disc], 20.0, 1.0, -1e-9)
    assert not guard._clear([arc], [disc], 20.0, 1.0, 1e-9)


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


def test_moving_discs_inside_a_fence_are_kept_clear_of_for_the_horizon() -> None:
    limits = replace(PLANE, fence_ned_m=box(1e3), horizon_s=7.0)
    verdict = check(AHEAD, NORTHWARD, discs((500.0, 0.0, 50.0), speed_m_s=1.0), limits)
    assert (verdict.changes, verdict.certified_s) == ((), 7.5)


def test_a_vehicle_that_can_stop_stands_clear_of_moving_discs_for_the_horizon() -> None:
    limits = replace(COPTER, horizon_s=7.0)
    edge_m = 500.0 - 110.0 - SPARE_M - 3.0 * 7.5
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_ray", lambda *_: None)
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
        patch.setattr(Guard, "_to_rest", lambda *_: KEEP_OUT)
        verdict = check(AHEAD, NORTHWARD, discs((900.0, 0.0, 50.0), speed_m_s=disc_m_s), replace(PLANE, horizon_s=7.0))
    assert (verdict.changes, verdict.certified_s) == ((), 7.5)


def test_on_the_arc_to_a_ray_a_disc_is_as_large_as_while_the_arc_is_flown() -> None:
    """At the end of the arc, after 1.4 s, the disc behind is 6 m off it; it would be in it 1.4 s later."""
    guarded = Guard(PLANE)
    scene = Discs(np.array([[-60.0, 0.0], [100.0, -20.0]]), np.array([40.0, 22.0]), np.array([10.0, 0.0]))
    flight = guarded._flight(guard._Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, scene, DT_S, ())
    guarded._path = guard._Path((Piece(0.0, 0.0, 0.7, 0.0, math.inf),), 0, 20.0, math.inf)
    ray = guarded._ray(flight.tip, 20.0, 0.0, 0.0, flight, False, False)
    assert ray is not None and ray[-1].heading_rad == pytest.approx(0.7)


def test_only_the_wanted_step_and_the_way_from_the_tip_are_worth_a_look_at_all_headings() -> None:
    thoroughly: list[object] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_ray", lambda *arguments: thoroughly.append(arguments[-1]))
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
        patch.setattr(Guard, "_accepted", lambda *_: KEEP_OUT)
        patch.setattr(Guard, "_from_tip", lambda *_: KEEP_OUT)
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
        patch.setattr(Guard, "_accepted", lambda *_: KEEP_OUT)
        patch.setattr(Guard, "_from_tip", lambda *_: KEEP_OUT)
        verdict = guarded.check(AHEAD, vehicle.motion, scene, DT_S + off, DT_S)
    assert verdict.certified_s == pytest.approx(left_s, abs=1e-12)


def test_what_is_clear_for_ever_is_not_given_up_for_what_is_clear_for_the_horizon() -> None:
    scene = discs((-60.0, 0.0, 20.0), speed_m_s=4.0)
    guarded, vehicle = Guard(PLANE), Vehicle(NORTHWARD, PLANE)
    vehicle.obey(sent(guarded.check(AHEAD, NORTHWARD, scene, 0.0, DT_S)))
    vehicle.fly(DT_S)
    horizon = guard._Path((Piece(20.0, 0.0, 0.0, 0.0, 600.0),), 0, 20.0, 30.5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_accepted", lambda _self, _step, _flight, limited, _: horizon if limited else KEEP_OUT)
        patch.setattr(Guard, "_continues", lambda *_: False)
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
    guarded, pose = Guard(PLANE), guard._Pose(1.0, 2.0, 0.3)
    around = [(101.0, 2.0, 90.0, 1.0), (1.0, 52.0, 10.0, 1.0)]
    assert list(guarded._likely_headings_rad(pose, around)) == [0.3, math.pi]
    ray = (Piece(0.0, 0.0, 0.0, 0.1, 5.0), Piece(0.0, 0.0, 0.7, 0.0, math.inf))
    guarded._path = guard._Path(ray, 0, 20.0, math.inf)
    assert list(guarded._likely_headings_rad(pose, around)) == [0.3, 0.7, math.pi]
    guarded._path = guarded._path._replace(loops=1)
    assert list(guarded._likely_headings_rad(pose, around)) == [0.3, math.pi]


def test_in_coarse_steps_a_ray_in_hand_that_is_too_far_round_does_not_hide_the_way_from_the_disc() -> None:
    guarded = Guard(Limits(60.0, 60.0, 10.0, 50.0, 120.0))
    scene = discs((400.0, 200.0, 300.0), speed_m_s=20.0)
    flight = guarded._flight(guard._Pose(0.0, 0.0, 0.0), 60.0, replace(NORTHWARD, speed_m_s=60.0), scene, 5.0, ())
    guarded._path = guard._Path((Piece(0.0, 0.0, 3.1, 0.0, math.inf),), 0, 60.0, math.inf)
    ray = guarded._ray(flight.tip, 60.0, 0.0, 0.0, flight, False, False)
    assert ray is not None
    assert math.remainder(ray[-1].heading_rad, math.tau) == pytest.approx(math.atan2(-200.0, -400.0))


@pytest.mark.parametrize(("dt_s", "most_rad"), [(0.5, math.tau), (5.0, 3.0)])
def test_the_fan_is_asked_for_turns_all_round_from_discs_as_they_are_when_the_step_ends(
    dt_s: float, most_rad: float
) -> None:
    guarded = Guard(Limits(60.0, 60.0, 10.0, 50.0, 120.0, wind_m_s=5.0))
    asked: list[tuple[Any, ...]] = []
    scene = discs((100.0, 0.0, 300.0), (-100.0, 20.0, 300.0), speed_m_s=2.0)
    flight = guarded._flight(guard._Pose(0.0, 0.0, 0.0), 60.0, replace(NORTHWARD, speed_m_s=60.0), scene, dt_s, ())

    def fan(*arguments: object) -> list[float]:
        asked.append(arguments)
        return [0.5, 1.0]

    for limited, length_m in ((False, math.inf), (True, 55.0 * 30.0)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(guard, "_fan_rad", fan)
            ray = guarded._ray(flight.tip, 60.0, dt_s, 0.25, flight, limited, True)
            assert guarded._ray(flight.tip, 60.0, dt_s, 0.25, flight, limited, False) is None
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


# --- the reaction time


def test_a_step_begins_where_the_commands_in_flight_take_the_vehicle() -> None:
    """Two steps of reaction: the turn that was asked for a step ago acts a step from now."""
    limits = replace(PLANE, reaction_s=1.0)
    guarded, vehicle = Guard(limits), Vehicle(NORTHWARD, limits)
    most_rad = G_M_S2 / 20.0 * DT_S
    wanted = [most_rad, 2.0 * most_rad, 2.0 * most_rad]
    for step, heading_rad in enumerate(wanted):
        if step:
            vehicle.fly(DT_S)
        verdict = guarded.check(replace(AHEAD, heading_rad=heading_rad), vehicle.motion, NOTHING, step * DT_S, DT_S)
        assert (verdict.changes, sent(verdict).heading_rad) == ((), pytest.approx(heading_rad))
        vehicle.obey(sent(verdict))
    tip, _ = guarded._flown(vehicle.motion, guarded._commands, 1.5)
    expected = turn_towards(20.0, 0.0, 0.0, 20.0, 2.0 * most_rad, G_M_S2 / 20.0, 1.5)
    vehicle.fly(1.5)
    assert math.dist(tip[:2], (vehicle.motion.north_m, vehicle.motion.east_m)) < 1e-9
    assert math.dist(tip[:2], expected[:2]) < 1e-9


def test_of_two_commands_that_act_at_the_same_time_the_later_one_is_flown() -> None:
    guarded = Guard(replace(PLANE, speed_min_m_s=10.0, speed_max_m_s=30.0))
    commands = [guard._Command(0.5, 0.3, 30.0), guard._Command(0.5, 0.1, 10.0)]
    pose, speed_m_s = guarded._flown(replace(NORTHWARD, speed_m_s=10.0), commands, 1.5)
    assert pose == pytest.approx(turn_towards(5.0, 0.0, 0.0, 10.0, 0.1, G_M_S2 / 10.0, 1.0))
    assert speed_m_s == 10.0


def test_the_turn_limit_counts_from_the_heading_that_will_be_flown_by_then() -> None:
    limits = replace(PLANE, reaction_s=0.25)
    guarded = Guard(limits)
    most_rad = G_M_S2 / 20.0 * DT_S
    guarded.check(replace(AHEAD, heading_rad=2.0), NORTHWARD, NOTHING, 0.0, DT_S)
    vehicle = Vehicle(NORTHWARD, limits)
    vehicle.obey(Setpoint(most_rad, 20.0, 100.0))
    vehicle.fly(DT_S)
    second = guarded.check(replace(AHEAD, heading_rad=2.0), vehicle.motion, NOTHING, DT_S, DT_S)
    assert sent(second).heading_rad == pytest.approx(2.0 * most_rad)


def test_a_start_whose_reaction_runs_into_a_disc_is_not_certified() -> None:
    limits, far = replace(PLANE, reaction_s=5.0), discs((100.0, 99.0, 100.0))
    assert not Guard(limits).certify(NORTHWARD, far, DT_S)
    assert Guard(replace(limits, reaction_s=0.0)).certify(NORTHWARD, far, DT_S)


@pytest.mark.parametrize(("hair_m", "certified"), [(-HAIR, True), (HAIR, False)])
def test_during_the_reaction_a_moving_disc_counts_as_large_as_at_its_end(hair_m: float, certified: bool) -> None:
    around = discs((5.0, 60.0, 60.0 - 3.0 * 2.0 - SPARE_M + hair_m), speed_m_s=3.0)
    assert Guard(replace(PLANE, reaction_s=2.0)).certify(NORTHWARD, around, DT_S) is certified


def test_with_a_disc_that_nothing_is_clear_of_for_ever_a_start_is_certified_for_the_horizon() -> None:
    for north_m, certified in ((1300.0, True), (600.0, False)):
        hunter = discs((north_m, 0.0, 50.0), speed_m_s=40.0)
        assert Guard(PLANE).certify(replace(NORTHWARD, heading_rad=math.pi / 2.0), hunter, DT_S) is certified


def test_a_start_without_a_path_after_the_reaction_is_not_certified() -> None:
    limits, wall = replace(PLANE, reaction_s=1.0), discs((360.0, 0.0, 310.0))
    assert not Guard(limits).certify(NORTHWARD, wall, DT_S)
    assert Guard(limits).certify(replace(NORTHWARD, heading_rad=math.pi / 2.0), wall, DT_S)


def test_a_start_that_nothing_can_be_said_of_is_not_certified() -> None:
    assert not Guard(PLANE).certify(replace(NORTHWARD, north_m=math.nan), NOTHING, DT_S)


def test_to_certify_changes_nothing_in_the_guard() -> None:
    scene = discs((60.0, 0.0, 23.0))
    guarded = Guard(PLANE)
    guarded.check(AHEAD, NORTHWARD, scene, 0.0, DT_S)
    before = (guarded._path, guarded._commands[:], guarded._left_s, guarded._called_s, guarded._heard)
    guarded.certify(replace(NORTHWARD, heading_rad=2.0), discs((500.0, 0.0, 30.0)), DT_S)
    assert before == (guarded._path, guarded._commands, guarded._left_s, guarded._called_s, guarded._heard)


# --- assumptions, each broken in turn


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


@pytest.mark.parametrize(("wind_m_s", "from_rad"), [(0.0, 0.2), (5.0, 0.215)])
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
        patch.setattr(Guard, "_accepted", lambda *_: KEEP_OUT)
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
        assert guarded._heard is not None
        kept = guarded._heard.centres_ned_m, guarded._heard.radii_m, guarded._heard.speeds_m_s
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
        assert guarded._heard is not None and guarded._heard.centres_ned_m.tolist() == [[north_m - step, 4.0]]
        assert guarded._heard.radii_m.tolist() == [2.0]


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
            patch.setattr(Guard, "_accepted", lambda *_: KEEP_OUT)
            patch.setattr(Guard, "_from_tip", lambda *_: KEEP_OUT)
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
        patch.setattr(Guard, "_ray", lambda *_: None)
        vehicle.obey(sent(guarded.check(AHEAD, NORTHWARD, first, 0.0, DT_S)))
        vehicle.fly(DT_S)
        later = discs((600.0, 0.0, 20.5), (10.0, 300.0, 300.0 - 2.0 * RHO_M - room_m - 0.5), speed_m_s=1.0)
        patch.setattr(Guard, "_accepted", lambda *_: KEEP_OUT)
        patch.setattr(Guard, "_from_tip", lambda *_: KEEP_OUT)
        verdict = guarded.check(AHEAD, vehicle.motion, later, DT_S, DT_S)
    assert verdict.broken == (NEW_THREAT,)
    assert verdict.changes[-1] == (BACKUP if kept else NO_BACKUP)


@pytest.mark.parametrize("wind_m_s", [0.0, 4.0])
def test_a_ray_in_hand_is_still_clear_up_to_the_new_disc_that_it_grazes(wind_m_s: float) -> None:
    guarded, slow_m_s = Guard(replace(PLANE, wind_m_s=wind_m_s)), 20.0 - wind_m_s
    guarded._path, guarded._left_s = guard._Path((Piece(0.0, 0.0, 0.0, 0.0, math.inf),), 0, 20.0, math.inf), math.inf
    t_s = np.linspace(0.0, 10.0, 100_001)
    edge_m = float(np.min(np.hypot(slow_m_s * t_s - 40.0, 60.0) - 4.0 * t_s)) - guarded._inflation_m()
    for hair_m, clear in ((-1e-5, True), (1e-5, False)):
        scene = discs((40.0, 60.0, edge_m + hair_m), speed_m_s=4.0)
        flight = guarded._flight(guard._Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, scene, DT_S, ())
        assert guarded._still_clear(flight) is clear


@pytest.mark.parametrize("ahead", [False, True])
@pytest.mark.parametrize("off_m", [0.0, 0.09, 0.11, 1.0])
def test_a_vehicle_off_the_path_in_hand_does_not_continue_it(off_m: float, ahead: bool) -> None:
    scene = discs((60.0, 0.0, 23.0))
    guarded, vehicle = Guard(PLANE), Vehicle(NORTHWARD, PLANE)
    vehicle.obey(sent(guarded.check(AHEAD, NORTHWARD, scene, 0.0, DT_S)))
    vehicle.fly(DT_S)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_accepted", lambda *_: KEEP_OUT)
        patch.setattr(Guard, "_from_tip", lambda *_: KEEP_OUT)
        at = vehicle.motion
        moved = replace(at, north_m=at.north_m + ahead * off_m, east_m=at.east_m + (not ahead) * off_m)
        verdict = guarded.check(AHEAD, moved, scene, DT_S, DT_S)
    assert verdict.changes[-1] == (NO_BACKUP if off_m > 0.1 else BACKUP)


def test_a_vehicle_off_the_path_in_hand_does_not_continue_it_though_a_new_disc_leaves_that_clear() -> None:
    guarded, scene = Guard(PLANE), discs((60.0, 0.0, 23.0))
    guarded.check(AHEAD, NORTHWARD, scene, 0.0, DT_S)
    later = discs((60.0, 0.0, 23.0), (-600.0, 0.0, 20.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Guard, "_accepted", lambda *_: KEEP_OUT)
        patch.setattr(Guard, "_from_tip", lambda *_: KEEP_OUT)
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
        patch.setattr(Guard, "_reach_m", lambda *_: math.inf)
        guarded.check(wanted, motion, scene, 0.0, DT_S)
        patch.setattr(Guard, "_accepted", lambda *_: KEEP_OUT)
        patch.setattr(Guard, "_from_tip", lambda *_: KEEP_OUT)
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
        patch.setattr(Guard, "_accepted", lambda *_: KEEP_OUT)
        patch.setattr(Guard, "_from_tip", lambda *_: KEEP_OUT)
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


# --- when nothing is certified


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
    flight = guarded._flight(guard._Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, scene, DT_S, ())
    assert guarded._violation(guard._Step(0.0, 20.0), flight) == pytest.approx(expected, abs=1e-5)


def test_without_any_disc_only_the_fence_counts() -> None:
    limits = replace(PLANE, fence_ned_m=box(15.0))
    guarded = Guard(limits)
    flight = guarded._flight(guard._Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, DT_S, ())
    assert guarded._violation(guard._Step(0.0, 20.0), flight) == pytest.approx((0.0, 5.0, -math.inf) * 2)


def test_what_a_vehicle_may_be_off_its_path_counts_in_attack_discs_too() -> None:
    guarded = Guard(replace(PLANE, position_error_m=2.0))
    scene = replace(discs((24.0, 0.0, 9.0), speed_m_s=2.0), attack_m=np.array([6.0]))
    flight = guarded._flight(guard._Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, scene, DT_S, ())
    assert guarded._violation(guard._Step(0.0, 20.0), flight) == pytest.approx((6.0, 0.0, 9.0) * 2, abs=1e-5)


def test_in_wind_what_to_make_least_is_looked_for_along_the_ground_speed_reported() -> None:
    """Twelve metres in the step at 24 m/s over the ground, then ten at the airspeed."""
    guarded = Guard(replace(PLANE, wind_m_s=4.0))
    motion = replace(NORTHWARD, speed_m_s=24.0)
    flight = guarded._flight(guard._Pose(0.0, 0.0, 0.0), 20.0, motion, discs((30.0, 0.0, 1.0)), DT_S, ())
    assert guarded._violation(guard._Step(0.0, 20.0), flight) == pytest.approx((0.0, 0.0, 1.0 - 8.0) * 2, abs=1e-5)


@pytest.mark.parametrize(("wind_m_s", "ground_m_s"), [(0.0, 20.0), (0.5, 20.4)])
def test_a_step_is_flown_at_the_ground_speed_reported_in_any_wind(wind_m_s: float, ground_m_s: float) -> None:
    guarded = Guard(replace(PLANE, wind_m_s=wind_m_s))
    pieces, after_m_s = guarded._step_pieces(guard._Pose(0.0, 0.0, 0.5), guard._Step(-0.2, 20.0), 20.0, 20.4, DT_S)
    arc_m = ground_m_s * 0.2 / (G_M_S2 / 20.0)
    assert [piece.length_m for piece in pieces] == pytest.approx([arc_m, ground_m_s * DT_S - arc_m])
    assert (pieces[0].heading_rad, pieces[1].heading_rad, after_m_s) == pytest.approx((0.5, 0.3, 20.0))
    assert_hangs_together(guard._Path(pieces, 0, 20.0, math.inf))


def test_outside_the_fence_the_wanted_way_straight_back_in_is_kept_and_the_loss_named() -> None:
    limits = replace(PLANE, fence_ned_m=((20.0, -500.0), (20.0, 500.0), (900.0, 500.0), (900.0, -500.0)))
    assert check(AHEAD, NORTHWARD, NOTHING, limits) == Verdict(AHEAD, (FENCE, NO_BACKUP))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_outside_the_fence_the_turn_back_is_taken(side: float) -> None:
    fence = ((-900.0, side * 30.0), (900.0, side * 30.0), (900.0, side * 900.0), (-900.0, side * 900.0))
    verdict = check(AHEAD, NORTHWARD, NOTHING, replace(PLANE, fence_ned_m=fence))
    assert verdict.changes == (FENCE, NO_BACKUP)
    assert turn_of(verdict, NORTHWARD) == pytest.approx(side * G_M_S2 / 20.0 * DT_S)


# --- the fence


def box(north_m: float, east_m: float = 1e3) -> tuple[tuple[float, float], ...]:
    """Return a box that ends this far ahead and to the right of the origin, and far off elsewhere."""
    return ((-1e3, -1e3), (north_m, -1e3), (north_m, east_m), (-1e3, east_m))


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


@settings(deadline=None, max_examples=100, derandomize=True)
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
    assert guard._Fence(SQUARE).depth_m(*point) == depth_m
    assert guard._Fence(SQUARE[::-1]).depth_m(*point) == depth_m


def test_an_edge_of_half_a_metre_is_an_edge_like_any_other() -> None:
    spit = ((-8.0, -8.0), (8.0, -8.0), (8.0, 8.0), (0.25, 8.0), (0.25, 2.0), (-0.25, 2.0), (-0.25, 8.0), (-8.0, 8.0))
    assert guard._Fence(spit).depth_m(0.0, 0.0) == 2.0
    assert guard._Fence(spit[::-1]).depth_m(0.1, 0.0) == 2.0


PIECES = st.builds(
    Piece,
    st.floats(-40.0, 40.0),
    st.floats(-40.0, 40.0),
    st.floats(-7.0, 7.0),
    st.just(0.0) | st.floats(0.01, 0.5) | st.floats(-0.5, -0.01),
    st.floats(0.1, 60.0),
)


def along(piece: Piece, count: int = 2001) -> np.ndarray:
    """Return points of a piece by summing its chords: not the guard's own way."""
    shares = (np.arange(count - 1) + 0.5) / (count - 1)
    headings_rad = piece.heading_rad + piece.curvature_1_m * piece.length_m * shares
    steps = np.column_stack([np.cos(headings_rad), np.sin(headings_rad)]) * piece.length_m / (count - 1)
    return np.vstack([np.zeros(2), np.cumsum(steps, axis=0)]) + (piece.north_m, piece.east_m)


@settings(deadline=None, max_examples=300, derandomize=True)
@given(piece=PIECES, north_m=st.floats(-90.0, 90.0), east_m=st.floats(-90.0, 90.0))
def test_the_distance_from_a_piece_is_that_from_its_nearest_point(piece: Piece, north_m: float, east_m: float) -> None:
    nearest_m = float(np.hypot(*(along(piece) - (north_m, east_m)).T).min())
    assert guard._distance_m(piece, north_m, east_m) == pytest.approx(nearest_m, abs=0.02)
    on_it = guard._place_on(piece, guard._nearest_on_m(piece, guard._Pose(north_m, east_m, 0.0)))
    assert math.dist(on_it[:2], (north_m, east_m)) == pytest.approx(nearest_m, abs=0.02)


@settings(deadline=None, max_examples=300, derandomize=True)
@given(piece=PIECES, margin_m=st.floats(0.0, 10.0))
def test_a_fence_holds_a_piece_exactly_when_all_of_it_keeps_the_margin(piece: Piece, margin_m: float) -> None:
    corners = ((-60.0, -50.0), (-10.0, 0.0), (-50.0, 60.0), (0.0, 10.0), (55.0, 60.0), (45.0, 0.0), (60.0, -55.0))
    fence = guard._Fence(corners)
    places = along(piece)
    edges = np.array(corners), np.roll(np.array(corners), -1, axis=0) - np.array(corners)
    offset = places[:, None, :] - edges[0]
    shares = np.clip((offset * edges[1]).sum(axis=-1) / (edges[1] ** 2).sum(axis=-1), 0.0, 1.0)
    apart = float(np.hypot(*(offset - shares[..., None] * edges[1]).transpose(2, 0, 1)).min())
    inside = inside_polygon(places, corners)
    assume(abs(apart - margin_m) > 0.05 and apart > 0.05)
    assert fence.holds([piece], margin_m) == (inside and apart >= margin_m)


@settings(deadline=None, max_examples=60, derandomize=True)
@given(
    share=st.floats(0.3, 0.7),
    curvature_1_m=st.just(0.0) | st.floats(1 / 300, 1 / 30) | st.floats(-1 / 30, -1 / 300),
    heading_rad=st.floats(-7.0, 7.0),
    tip_m=st.floats(3.0, 25.0),
    mirrored=st.booleans(),
)
def test_a_fence_with_a_spit_of_outside_across_a_piece_does_not_hold_it(
    share: float, curvature_1_m: float, heading_rad: float, tip_m: float, mirrored: bool
) -> None:
    """The ends of the piece are well inside, and so is all of it as soon as the spit ends before it."""
    length_m = min(200.0, 2.0 / abs(curvature_1_m) if curvature_1_m else math.inf)
    piece = Piece(700.0, -300.0, heading_rad, curvature_1_m, length_m)
    at = guard._place_on(piece, share * length_m)
    cosine, sine = math.cos(at.heading_rad), math.sin(at.heading_rad)
    for reach_m, held in ((tip_m, False), (-5.0, True)):
        corners = [(-1e3, -1e3), (1e3, -1e3), (1e3, 1e3), (0.3, 1e3), (0.0, -reach_m), (-0.3, 1e3), (-1e3, 1e3)]
        fence = [(at.north_m + x * cosine - y * sine, at.east_m + x * sine + y * cosine) for x, y in corners]
        assert guard._Fence(fence[:: -1 if mirrored else 1]).holds([piece], 1.0) is held


@pytest.mark.parametrize("over_m", [1e-5, 1e-3, 0.1, 1.0, 10.0])
def test_a_piece_that_leaves_the_fence_and_comes_back_is_not_held(over_m: float) -> None:
    arc = Piece(0.0, 0.0, 0.0, 0.05, 0.05**-1 * math.pi)
    assert not guard._Fence(box(20.0 - over_m)).holds([arc], 1e-6)
    assert guard._Fence(box(20.0 + over_m)).holds([arc], 1e-6)


def test_every_one_of_many_pieces_is_held_or_none_is() -> None:
    """Each alone is shorter than what is left to the fence at the start."""
    row = [Piece(north_m, 0.0, 0.0, 0.0, 6.0) for north_m in (0.0, 6.0, 12.0, 18.0)]
    fences = [guard._Fence(box(north_m)) for north_m in (10.0, 16.0, 22.0, 25.0)]
    assert [fence.holds(row, 0.5) for fence in fences] == [False, False, False, True]
    at_last = [Piece(0.0, 0.0, math.pi / 2.0, 0.0, 20.0), Piece(0.0, 20.0, 0.0, 0.0, 0.9)]
    assert [guard._Fence(box(north_m)).holds(at_last, 1.5) for north_m in (2.0, 2.5)] == [False, True]
    turned = [Piece(0.0, 0.0, 0.0, 0.5, math.tau * 2.0), Piece(0.0, 0.0, 0.0, 0.0, 6.0)]
    assert [guard._Fence(box(north_m)).holds(turned, 0.5) for north_m in (5.0, 7.0)] == [False, True]


def inside_polygon(places: np.ndarray, fence: Sequence[tuple[float, float]]) -> bool:
    """Return whether all places are inside, by winding number: not the guard's own way."""
    corners = np.array(fence)[None, :, :] - places[:, None, :]
    ahead = np.roll(corners, -1, axis=1)
    cross = corners[..., 0] * ahead[..., 1] - corners[..., 1] * ahead[..., 0]
    dot = np.sum(corners * ahead, axis=-1)
    return bool(np.all(np.abs(np.sum(np.arctan2(cross, dot), axis=1)) > 1.0))


# --- paths


@settings(deadline=None, max_examples=100, derandomize=True)
@given(pieces=st.lists(PIECES, min_size=1, max_size=4), share=st.floats(0.0, 1.2))
def test_a_place_along_a_path_is_that_on_the_piece_it_falls_on(pieces: list[Piece], share: float) -> None:
    lengths_m = [piece.length_m for piece in pieces]
    along_m = share * sum(lengths_m)
    path = guard._Path(tuple(pieces), 0, 10.0, math.inf)
    index, left_m = 0, along_m
    while index + 1 < len(pieces) and left_m > lengths_m[index]:
        left_m, index = left_m - lengths_m[index], index + 1
    expected = guard._place_on(pieces[index], min(left_m, lengths_m[index]))
    assert guard._at(path, along_m) == pytest.approx(expected, abs=1e-9)
    rest_m = sum(piece.length_m for piece in guard._rest_of(path, along_m))
    assert rest_m == pytest.approx(max(0.0, sum(lengths_m) - along_m), abs=1e-9)


@settings(deadline=None, max_examples=60, derandomize=True)
@given(pieces=st.lists(PIECES, min_size=1, max_size=3), north_m=st.floats(-90.0, 90.0), east_m=st.floats(-90.0, 90.0))
def test_the_nearest_place_of_a_path_is_that_of_its_nearest_piece(
    pieces: list[Piece], north_m: float, east_m: float
) -> None:
    path = guard._Path(tuple(pieces), 0, 10.0, math.inf)
    along_m = guard._nearest_along_m(path, guard._Pose(north_m, east_m, 0.0))
    nearest_m = min(float(np.hypot(*(along(piece, 501) - (north_m, east_m)).T).min()) for piece in pieces)
    before_m = [sum(piece.length_m for piece in pieces[:count]) for count in range(len(pieces))]
    places = [
        guard._place_on(piece, along_m - start_m)
        for piece, start_m in zip(pieces, before_m, strict=True)
        if -1e-9 <= along_m - start_m <= piece.length_m + 1e-9
    ]
    assert min(math.dist(place[:2], (north_m, east_m)) for place in places) == pytest.approx(nearest_m, abs=0.08)


def test_a_loop_is_flown_again_and_again() -> None:
    first = Piece(0.0, 0.0, 0.0, 0.0, 10.0)
    circle = Piece(10.0, 0.0, 0.0, 0.1, math.tau * 10.0)
    path = guard._Path((first, circle), 1, 10.0, math.inf)
    for turns in range(3):
        place = guard._at(path, 10.0 + (turns + 0.25) * circle.length_m)
        assert place[:2] == pytest.approx((20.0, 10.0))
    assert guard._rest_of(path, 1000.0) == (circle,)


@pytest.mark.parametrize("share", np.linspace(0.0, 2.5, 26).tolist())
def test_a_place_on_a_loop_of_several_pieces_is_that_on_the_path_unrolled(share: float) -> None:
    limits = Limits(60.0, 60.0, 10.0, 50.0, 120.0)
    loop = Guard(limits)._loop(guard._Pose(10.0, 0.0, 0.0), 1.0, 60.0, 5.0)
    first = Piece(0.0, 0.0, 0.0, 0.0, 10.0)
    along_m = share * sum(piece.length_m for piece in loop) + 1.0
    unrolled = guard._at(guard._Path((first, *loop, *loop, *loop), 0, 60.0, math.inf), along_m)
    place = guard._at(guard._Path((first, *loop), len(loop), 60.0, math.inf), along_m)
    assert place[:2] == pytest.approx(unrolled[:2], abs=1e-6)
    assert math.remainder(place.heading_rad - unrolled.heading_rad, math.tau) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("heading_rad", [-2.0, 0.0, 0.7, 2.5])
def test_a_place_is_seen_so_far_ahead_and_to_the_right(heading_rad: float) -> None:
    cosine, sine = math.cos(heading_rad), math.sin(heading_rad)
    place = guard._Pose(5.0 + 3.0 * cosine - 2.0 * sine, 6.0 + 3.0 * sine + 2.0 * cosine, 1.0)
    assert guard._seen_from(guard._Pose(5.0, 6.0, heading_rad), place) == pytest.approx((3.0, 2.0))


def test_a_path_is_steered_to_by_the_heading_a_step_ahead_and_by_what_it_is_off_where_asked_to() -> None:
    """On a circle to the right that begins at the origin, and off a line northward."""
    circle = guard._Path((Piece(0.0, 0.0, 0.0, 1.0 / RHO_M, math.tau * RHO_M),), 1, 20.0, math.inf)
    line = guard._Path((Piece(0.0, 0.0, 0.0, 0.0, math.inf),), 0, 20.0, math.inf)
    guarded = Guard(replace(PLANE, reaction_s=0.25))
    on_it = guard._at(circle, 15.0)
    assert guarded._steered_rad(circle, 15.0, on_it, 20.0, DT_S, 0.0) == pytest.approx(10.0 / RHO_M)
    assert guarded._steered_rad(circle, 15.0, on_it, 20.0, DT_S, DT_S) == pytest.approx(10.0 / RHO_M)
    for beside_m in (-4.0, 4.0):
        pose = guard._Pose(30.0, beside_m, 0.01)
        turn_rad = -math.atan(beside_m / (2.0 * 20.0 * 0.75)) - 0.01
        assert guarded._steered_rad(line, 30.0, pose, 20.0, DT_S, DT_S) == pytest.approx(turn_rad)
        assert guarded._steered_rad(line, 30.0, pose, 20.0, DT_S, 0.0) == pytest.approx(-0.01)
        far_off = guard._Pose(30.0, 20.0 * beside_m, 0.0)
        most_rad = math.copysign(10.0 / RHO_M, -beside_m)
        assert guarded._steered_rad(line, 30.0, far_off, 20.0, DT_S, DT_S) == pytest.approx(most_rad)
        for wind_m_s in (0.5, 5.0):
            windy = Guard(replace(PLANE, wind_m_s=wind_m_s))
            assert windy._steered_rad(line, 30.0, far_off, 16.0, DT_S, DT_S) == pytest.approx(most_rad)


def test_no_path_is_steered_to_by_so_much_that_the_side_is_in_doubt() -> None:
    back = guard._Path((Piece(0.0, 0.0, 3.1, 0.0, math.inf),), 0, 60.0, math.inf)
    guarded = Guard(Limits(60.0, 60.0, 10.0, 50.0, 120.0))
    assert guarded._steered_rad(back, 0.0, guard._Pose(0.0, 0.0, 0.0), 60.0, 5.0, 0.0) == 3.0


@pytest.mark.parametrize(("wind_m_s", "ground_m_s", "gain_s"), [(0.0, 20.0, 0.0), (0.5, 20.4, DT_S)])
def test_in_any_wind_the_path_in_hand_is_followed_at_the_ground_speed_and_closed_in_on(
    wind_m_s: float, ground_m_s: float, gain_s: float
) -> None:
    guarded = Guard(replace(PLANE, wind_m_s=wind_m_s))
    guarded._path = guard._Path((Piece(0.0, 0.0, 0.0, 0.02, math.tau / 0.02),), 1, 20.0, math.inf)
    guarded._along_m = 7.0
    tip = guard._Pose(7.0, 0.3, 0.2)
    flight = guarded._flight(tip, 20.0, replace(NORTHWARD, speed_m_s=20.4), NOTHING, DT_S, ())
    turn_rad = guarded._steered_rad(guarded._path, 7.0, tip, ground_m_s, DT_S, gain_s)
    assert guarded._continued(flight) == (turn_rad, 20.0)


@pytest.mark.parametrize(("turn_rad", "arcs"), [(0.0, 0), (0.78, 1), (-0.79, 2), (-3.0, 4), (6.2, 8)])
def test_a_turn_to_a_ray_comes_in_arcs_of_an_eighth_of_a_circle_at_most(turn_rad: float, arcs: int) -> None:
    pieces = guard._turned(guard._Pose(1.0, 2.0, 0.3), turn_rad, 0.02, 100.0)
    assert len(pieces) == arcs + 1
    assert all(abs(piece.curvature_1_m * piece.length_m) <= math.pi / 4.0 for piece in pieces)
    assert pieces[-1][2:] == pytest.approx((0.3 + turn_rad, 0.0, 100.0))
    assert_hangs_together(guard._Path(pieces, 0, 20.0, math.inf))


# --- the theorem: a certified start never ends inside


def wicked(rng: np.random.Generator, motion: Motion, limits: Limits, at: np.ndarray) -> Setpoint:
    """Return a setpoint from an adversary that makes for a disc or a place, grazes it, or wants anything at all."""
    kind = rng.integers(7)
    away = at - (motion.north_m, motion.east_m)
    bearing_rad = math.atan2(away[1], away[0])
    heading_rad = {
        0: rng.uniform(-10.0, 10.0),
        1: motion.heading_rad,
        2: bearing_rad + rng.choice([-0.5, 0.5]) * math.pi,
        3: motion.heading_rad + rng.choice([-2.5, 2.5]),
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
    threat_share: float = 0.0
    """Of the vehicle's speed, at which each disc flies straight at the vehicle."""
    standing: int = 0
    """So many of the discs stand still all the same."""


FLAT_OUT = Limits(30.0, 30.0, 1.0, 50.0, 120.0)
RHO_S = 30.0 / G_M_S2
"""Radius over speed of FLAT_OUT: how long it takes to turn by a radian."""
STAR = ((-700.0, -700.0), (-100.0, 0.0), (-700.0, 700.0), (0.0, 150.0), (700.0, 700.0), (500.0, 0.0), (700.0, -700.0))
WORLDS = {
    "one speed": World(FLAT_OUT, 0.5, 1500.0, 25, 120.0),
    "reaction": World(replace(FLAT_OUT, reaction_s=0.1 * RHO_S), 0.5, 1500.0, 25, 120.0),
    "slow reaction": World(replace(FLAT_OUT, reaction_s=0.3 * RHO_S), 0.5, 1500.0, 16, 120.0),
    "very slow reaction": World(replace(FLAT_OUT, reaction_s=RHO_S), 0.5, 1800.0, 8, 200.0),
    "poor turns": World(replace(FLAT_OUT, rate_share=0.6), 0.5, 1500.0, 16, 120.0),
    "many speeds": World(replace(FLAT_OUT, speed_min_m_s=12.0), 0.5, 1500.0, 25, 120.0),
    "quick turns": World(replace(FLAT_OUT, speed_min_m_s=5.0, n_max=3.0), 1.0, 700.0, 25, 60.0),
    "the paper's step": World(Limits(60.0, 60.0, 10.0, 50.0, 120.0), 5.0, 6000.0, 25, 500.0),
    "the paper's step with a reaction": World(
        Limits(60.0, 60.0, 10, 50.0, 120.0, reaction_s=0.6), 5.0, 6000.0, 12, 500.0
    ),
    "fence": World(replace(FLAT_OUT, fence_ned_m=STAR, speed_min_m_s=20.0), 0.5, 1400.0, 8, 80.0),
    "stops": World(Limits(0.0, 20.0, 0.5, 50.0, 120.0, 3.0), 0.5, 500.0, 25, 50.0),
    "stops at a fence": World(Limits(0.0, 20.0, 0.5, 50.0, 120.0, 3.0, STAR), 0.5, 1400.0, 8, 80.0),
    "stops dead": World(Limits(0.0, 10.0, 0.25, 50.0, 120.0, 50.0), 0.5, 150.0, 25, 15.0),
    "wind": World(replace(FLAT_OUT, wind_m_s=10.0), 0.5, 2000.0, 12, 150.0),
    "wind and reaction": World(replace(FLAT_OUT, wind_m_s=10.0, reaction_s=0.8), 0.5, 2000.0, 12, 150.0),
    "chased": World(FLAT_OUT, 0.5, 1500.0, 10, 80.0, threat_share=0.2),
    "chased among standing discs": World(FLAT_OUT, 0.5, 1200.0, 12, 120.0, threat_share=0.2, standing=9),
    "hunted": World(replace(FLAT_OUT, reaction_s=0.3 * RHO_S), 0.5, 3000.0, 3, 200.0, threat_share=0.5),
    "hunted closely": World(FLAT_OUT, 0.5, 3000.0, 1, 300.0, threat_share=0.7),
    "chased in wind": World(replace(FLAT_OUT, wind_m_s=6.0), 0.5, 1200.0, 3, 100.0, threat_share=0.3),
}


def flown_against(world: World, seed: int, steps: int) -> tuple[int, int, float]:
    """Fly steps against an adversary in one random scene; return how many were refused, flown, and the least room.

    Asserts that a path is never lacking, that no assumption is called broken, and that no moment of the flight is
    inside a disc or outside the fence. None are flown where twenty random starts were not certified.
    """
    rng = np.random.default_rng(seed)
    limits = world.limits
    wind = gusts(rng, limits.wind_m_s) if limits.wind_m_s else calm
    speeds_m_s = np.full(world.discs, world.threat_share * limits.speed_max_m_s)
    speeds_m_s[: world.standing] = 0.0
    for _ in range(20):
        centres = rng.uniform(-world.side_m / 2.0, world.side_m / 2.0, (world.discs, 2))
        scene = Discs(centres, world.radius_m * rng.uniform(0.1, 1.0, world.discs), speeds_m_s)
        place = rng.uniform(-world.side_m / 2.0, world.side_m / 2.0, 2)
        speed_m_s = float(rng.uniform(limits.speed_min_m_s, limits.speed_max_m_s))
        vehicle = Vehicle(Motion(float(place[0]), float(place[1]), float(rng.uniform(-4, 4)), speed_m_s), limits, wind)
        if Guard(limits).certify(vehicle.motion, scene, world.dt_s):
            break
    else:
        return 0, 0, math.inf
    guarded, refused, at, room_m = Guard(limits), 0, np.zeros(2), math.inf
    for step in range(steps):
        if step % 25 == 0:
            aimed = rng.random() < 0.7
            at = scene.centres_ned_m[rng.integers(world.discs)] if aimed else rng.uniform(-1, 1, 2) * world.side_m
        wanted = wicked(rng, vehicle.motion, limits, at)
        verdict = guarded.check(wanted, vehicle.motion, scene, step * world.dt_s, world.dt_s)
        assert NO_BACKUP not in verdict.changes and verdict.certified_s == math.inf
        assert verdict.broken == ()
        assert_hangs_together(guarded._path)
        refused += KEEP_OUT in verdict.changes or FENCE in verdict.changes
        vehicle.obey(sent(verdict))
        places = vehicle.fly(world.dt_s)
        scene, moment_m = chased(scene, places, world.dt_s)
        room_m = min(room_m, moment_m)
        assert room_m > 0.0
        assert limits.fence_ned_m is None or inside_polygon(places, limits.fence_ned_m)
    return refused, steps, room_m


def chased(scene: Discs, places: np.ndarray, dt_s: float) -> tuple[Discs, float]:
    """Return the discs after each flew at the vehicle all the while, and how near the nearest edge came."""
    centres, room_m = scene.centres_ned_m, math.inf
    for place in places:
        towards = place - centres
        far_m = np.hypot(towards[:, 0], towards[:, 1])
        flown_m = np.minimum(scene.speeds_m_s * dt_s / len(places), far_m)
        centres = centres + towards * (flown_m / np.maximum(far_m, 1e-9))[:, None]
        room_m = min(room_m, float(np.min(np.hypot(*(place - centres).T) - scene.radii_m)))
    return replace(scene, centres_ned_m=centres), room_m


def assert_hangs_together(path: guard._Path | None) -> None:
    """Assert that each piece of a path begins where the one before it ends, and its loop where the loop ends."""
    if path is None:
        return
    after = [*path.pieces[1:], *path.pieces[len(path.pieces) - path.loops :][: path.loops and 1]]
    for piece, following in zip(path.pieces, after, strict=False):
        north_m, east_m, heading_rad = guard._end_of(piece)
        assert math.dist((north_m, east_m), following[:2]) < 1e-6
        assert abs(math.remainder(heading_rad - following.heading_rad, math.tau)) < 1e-6


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS.keys())
def test_a_certified_start_never_enters_whatever_the_adversary_wants(world: World) -> None:
    flights = [flown_against(world, seed, steps=100) for seed in range(3)]
    assert sum(steps for _, steps, _ in flights) >= 200
    assert sum(refused for refused, _, _ in flights) >= 10, "the adversary never tried"
