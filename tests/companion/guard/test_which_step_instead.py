"""Which step is taken instead of one that is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.geo.kinematics import turn_towards
from companion.guard.arcs import Pose
from companion.guard.backup import BackupSearch
from companion.guard.guard import Guard
from companion.guard.types import (
    BACKUP,
    KEEP_OUT,
    NO_BACKUP,
    Discs,
    Setpoint,
)
from companion.guard.vehicle import Step
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
    Vehicle,
    box,
    check,
    discs,
    sent,
    turn_of,
)


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
    guarded, step = Guard(limits), Step(-0.2, 15.0)
    flight = guarded._flight(Pose(0.0, 0.0, 0.0), 20.0, NORTHWARD, NOTHING, DT_S, ())
    most_rad = G_M_S2 / 20.0 * DT_S
    turns_rad = [-most_rad, -0.1, 0.0, most_rad]
    expected = [(-0.2, 15.0), *((turn_rad, speed_m_s) for speed_m_s in (15.0, 20.0) for turn_rad in turns_rad)]
    assert list(guarded._search(flight, math.inf).choices(step)) == expected
    assert list(guarded._search(flight, math.inf).choices(Step(0.0, 20.0))) == [
        (0.0, 20.0),
        *((turn_rad, 20.0) for turn_rad in (0.0, 0.0, most_rad, -most_rad)),
    ]
    stopping = Guard(COPTER)
    last = list(stopping._search(flight, math.inf).choices(Step(0.0, 20.0)))[-1]
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
        patch.setattr(BackupSearch, "accepted", lambda *_: KEEP_OUT)
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
        patch.setattr(BackupSearch, "to_rest", lambda *_: KEEP_OUT)
        assert guarded.check(onward, vehicle.motion, scene, DT_S, DT_S).changes == ()


def test_a_start_whose_every_step_is_refused_flies_the_path_that_certified_it() -> None:
    """The arc to the escape turns by more than a step: no step is accepted by the cheap headings, the fan finds it."""
    scene = Discs(np.array([[-150.0, 0.0], [320.0, 0.0]]), np.array([100.0, 100.0]), np.array([6.0, 6.0]))
    guarded = Guard(PLANE)
    assert guarded.certify(NORTHWARD, scene, DT_S)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "accepted", lambda *_: KEEP_OUT)
        verdict = guarded.check(AHEAD, NORTHWARD, scene, 0.0, DT_S)
    assert verdict.changes == (KEEP_OUT, BACKUP)
    assert verdict.certified_s == math.inf


def test_a_path_from_where_the_next_command_acts_is_clear_for_the_horizon_from_there() -> None:
    limits = replace(PLANE, fence_ned_m=box(1e3), horizon_s=7.0)
    edge_m = math.hypot(150.0, RHO_M) - RHO_M - 7.0 * 3.0 - SPARE_M
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BackupSearch, "accepted", lambda *_: KEEP_OUT)
        patch.setattr(BackupSearch, "ray", lambda *_: None)
        for hair_m, said in ((-HAIR, ((KEEP_OUT, BACKUP), 7.0)), (HAIR, ((KEEP_OUT, NO_BACKUP), 0.0))):
            verdict = check(AHEAD, NORTHWARD, discs((150.0, 0.0, edge_m + hair_m), speed_m_s=3.0), limits)
            assert (verdict.changes, verdict.certified_s) == said
