"""Slowing and stopping, for who can."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.geo.kinematics import turn_towards
from companion.guard.arcs import Path, Pose
from companion.guard.backup import BackupSearch
from companion.guard.guard import Guard
from companion.guard.types import (
    BACKUP,
    KEEP_OUT,
    Hints,
    Motion,
    Piece,
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
    SPARE_M,
    Vehicle,
    apart_m,
    assert_refused_from,
    check,
    discs,
    lone,
    sent,
)


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


def test_a_vehicle_that_can_stop_slows_down_on_the_wanted_course_before_it_turns_away() -> None:
    verdict = check(AHEAD, NORTHWARD, discs((500.0, 0.0, 395.0)), COPTER)
    assert verdict == Verdict(Setpoint(0.0, 10.0, 100.0), (KEEP_OUT,), certified_s=math.inf)


@pytest.mark.parametrize(("speed_m_s", "slower_m_s"), [(4.0, 2.0), (2.0, 1.0), (1.0, 0.5), (0.5, 0.0)])
def test_the_slower_speeds_are_halves_and_the_last_one_is_a_stop(speed_m_s: float, slower_m_s: float) -> None:
    """From rest the disc is as far away as the vehicle gets at the lower speed, and then stops."""
    braking_m_s2 = COPTER.braking_m_s2
    assert braking_m_s2 is not None
    reach_m = slower_m_s * DT_S + slower_m_s**2 / (2.0 * braking_m_s2)
    still, wanted = Motion(0.0, 0.0, 0.0, 0.0), Setpoint(0.0, 4.0, 100.0)
    verdict = check(wanted, still, discs((500.0, 0.0, 500.0 - reach_m - 0.01)), COPTER)
    assert verdict.setpoint is not None and verdict.setpoint.speed_m_s == slower_m_s
    assert speed_m_s > slower_m_s


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
        patch.setattr(BackupSearch, "accepted", lambda *_: KEEP_OUT)
        verdict = guarded.check(AHEAD, vehicle.motion, scene, DT_S, DT_S)
    assert verdict == Verdict(Setpoint(0.0, 0.0, 100.0), (KEEP_OUT, BACKUP), certified_s=math.inf)


def test_a_start_whose_every_step_is_refused_brakes_straight_ahead() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "accepted", lambda *_: KEEP_OUT)
        verdict = check(replace(AHEAD, heading_rad=0.2), NORTHWARD, discs((150.0, 0.0, 20.0)), COPTER)
    assert verdict == Verdict(Setpoint(0.0, 0.0, 100.0), (KEEP_OUT, BACKUP), certified_s=math.inf)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("speed_m_s", "turning_m_s"), [(0.3, 0.5), (0.8, 0.8), (5.0, 5.0)])
def test_who_brakes_turns_back_to_its_line_as_the_speed_flown_allows(
    speed_m_s: float, turning_m_s: float, side: float
) -> None:
    guarded = Guard(replace(COPTER, n_max=0.01))
    guarded._path = Path((Piece(0.0, 0.0, side, 0.0, 10.0),), 0, 0.0, math.inf)
    motion = replace(NORTHWARD, speed_m_s=speed_m_s)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), speed_m_s, motion, NOTHING, DT_S, ())
    assert guarded._search(flight, math.inf).continued() == pytest.approx(
        (side * 0.01 * G_M_S2 / turning_m_s * DT_S, 0.0)
    )


def test_who_wants_to_stand_beside_a_disc_that_may_be_faster_gets_an_answer_whatever_its_route() -> None:
    limits = replace(COPTER, speed_max_m_s=8.0)
    route = (Piece(0.0, 0.0, 0.0, 0.0, 500.0),)
    verdict = Guard(limits).check(
        Setpoint(0.0, 0.0, 100.0),
        replace(NORTHWARD, speed_m_s=0.0),
        discs((100.0, 0.0, 90.0), speed_m_s=10.0),
        0.0,
        DT_S,
        Hints(route),
    )
    assert verdict.setpoint is not None
