"""What leaves the guard nothing to decide on."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from companion.guard.types import (
    IMPOSSIBLE,
    NOT_FINITE,
    Limits,
    Motion,
    Setpoint,
    Verdict,
)
from tests.companion.guard.guard_flight import (
    AHEAD,
    BAD,
    COPTER,
    DT_S,
    NORTHWARD,
    NOTHING,
    PLANE,
    check,
    discs,
)


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
def test_limits_that_nothing_can_hold_are_refused(nonsense: dict[str, Any]) -> None:
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
    triangle = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
    Limits(0.0, 0.0, 0.1, 50.0, 50.0, braking_m_s2=0.1, fence_ned_m=triangle, horizon_s=0.0)
    replace(PLANE, exclusions_ned_m=(triangle,))


@pytest.mark.parametrize("last", [(), ((math.nan, 1.0),), ((0.0, math.inf),)])
def test_an_exclusion_without_three_finite_corners_is_refused(last: tuple[tuple[float, float], ...]) -> None:
    sound, faulty = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)), ((0.0, 0.0), (1.0, 0.0), *last)
    with pytest.raises(ValueError, match="^an exclusion needs at least three corners, all of them finite$"):
        replace(PLANE, exclusions_ned_m=(sound, faulty))
