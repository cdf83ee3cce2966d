"""The reaction time, and the commands in flight."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from companion.geo.kinematics import turn_towards
from companion.guard.guard import Guard
from companion.guard.types import (
    Setpoint,
)
from companion.guard.vehicle import Command
from tests.companion.guard.guard_flight import (
    AHEAD,
    DT_S,
    G_M_S2,
    HAIR,
    NORTHWARD,
    NOTHING,
    PLANE,
    SPARE_M,
    Vehicle,
    discs,
    sent,
)


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
        assert verdict.changes == ()
        assert sent(verdict).heading_rad == pytest.approx(heading_rad)
        vehicle.obey(sent(verdict))
    tip, _ = guarded._vehicle.flown(vehicle.motion, guarded._commands, 1.5)
    expected = turn_towards(20.0, 0.0, 0.0, 20.0, 2.0 * most_rad, G_M_S2 / 20.0, 1.5)
    vehicle.fly(1.5)
    assert math.dist(tip[:2], (vehicle.motion.north_m, vehicle.motion.east_m)) < 1e-9
    assert math.dist(tip[:2], expected[:2]) < 1e-9


def test_of_two_commands_that_act_at_the_same_time_the_later_one_is_flown() -> None:
    guarded = Guard(replace(PLANE, speed_min_m_s=10.0, speed_max_m_s=30.0))
    commands = [Command(0.5, 0.3, 30.0), Command(0.5, 0.1, 10.0)]
    pose, speed_m_s = guarded._vehicle.flown(replace(NORTHWARD, speed_m_s=10.0), commands, 1.5)
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
    assert Guard(replace(PLANE, reaction_s=2.0)).certify(NORTHWARD, around, DT_S) == (math.inf if certified else 0.0)


def test_with_a_disc_that_nothing_is_clear_of_for_ever_a_start_is_certified_for_the_horizon() -> None:
    for north_m, certified in ((1300.0, True), (600.0, False)):
        hunter = discs((north_m, 0.0, 50.0), speed_m_s=40.0)
        assert Guard(PLANE).certify(replace(NORTHWARD, heading_rad=math.pi / 2.0), hunter, DT_S) == (
            30.0 if certified else 0.0
        )


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
    before = (guarded._path, guarded._commands[:], guarded._left_s, guarded._called_s, guarded._threats._heard)
    guarded.certify(replace(NORTHWARD, heading_rad=2.0), discs((500.0, 0.0, 30.0)), DT_S)
    assert before == (guarded._path, guarded._commands, guarded._left_s, guarded._called_s, guarded._threats._heard)
