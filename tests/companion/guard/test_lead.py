"""How far the commanded heading leads the vehicle, and that the guard's prediction is what guidance starts from."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.guard.guard import Guard
from companion.guard.lead import MOST_LEAD_RAD, Turn, commanded_rad
from companion.guard.types import THREAT_FASTER, Hints, Limits, Motion, Setpoint
from tests.companion.guard.guard_flight import (
    AHEAD,
    COPTER,
    DT_S,
    G_M_S2,
    NORTHWARD,
    NOTHING,
    PLANE,
    discs,
    turn_rate_rad_s,
)

STEP_RAD = 0.1
TURNING = Turn(tip_rad=1.0, turn_rad=STEP_RAD, most_rad=STEP_RAD, measured_rad=1.0, last_rad=1.2, towards_rad=None)
"""A turn to the right at the limit by a vehicle that is 0.2 rad behind its last command."""


def mirrored(turn: Turn) -> Turn:
    return Turn(
        -turn.tip_rad,
        -turn.turn_rad,
        turn.most_rad,
        -turn.measured_rad,
        None if turn.last_rad is None else -turn.last_rad,
        None if turn.towards_rad is None else -turn.towards_rad,
    )


@pytest.mark.parametrize(
    ("turn", "commanded"),
    [
        # From the last command, one step on.
        (TURNING, 1.3),
        # No command yet, or one where the vehicle is, or one to the other side: from the tip.
        (TURNING._replace(last_rad=None), 1.1),
        (TURNING._replace(last_rad=1.0), 1.1),
        (TURNING._replace(last_rad=1.0 + 5e-7), 1.1),
        (TURNING._replace(last_rad=0.8), 1.1),
        # A turn that ends within the step ends there.
        (TURNING._replace(turn_rad=0.05), 1.05),
        (TURNING._replace(towards_rad=1.1), 1.1),
        # It goes on to where the turn is to end, and no farther, on the side that was begun.
        (TURNING._replace(towards_rad=1.25), 1.25),
        (TURNING._replace(towards_rad=2.0), 1.3),
        (TURNING._replace(towards_rad=0.9), 1.1),
        (TURNING._replace(towards_rad=1.0 + math.pi + 0.3), 1.3),
        (TURNING._replace(turn_rad=0.05, towards_rad=2.0), 1.25),
        # At most a quarter turn from the course that is measured, but never less than the step.
        (TURNING._replace(measured_rad=1.0, last_rad=1.0 + MOST_LEAD_RAD), 1.0 + MOST_LEAD_RAD),
        (TURNING._replace(measured_rad=0.7, last_rad=0.7 + MOST_LEAD_RAD), 0.7 + MOST_LEAD_RAD),
        (TURNING._replace(measured_rad=1.05 - MOST_LEAD_RAD), 1.1),
    ],
)
def test_the_command_goes_on_from_the_last_one_within_its_bounds(turn: Turn, commanded: float) -> None:
    assert commanded_rad(turn) == pytest.approx(commanded, abs=1e-12)
    assert commanded_rad(mirrored(turn)) == pytest.approx(-commanded % math.tau, abs=1e-12)


@given(*[st.floats(-10.0, 10.0)] * 3, st.none() | st.floats(-10.0, 10.0), st.floats(0.0, 3.0), st.booleans())
def test_no_command_is_short_of_its_step_or_leads_by_more_than_a_quarter_turn(
    tip_rad: float, lag_rad: float, last_rad: float, towards_rad: float | None, most_rad: float, right: bool
) -> None:
    turn_rad = most_rad if right else -most_rad
    measured_rad = tip_rad - math.copysign(min(abs(lag_rad), MOST_LEAD_RAD), turn_rad)
    commanded = commanded_rad(Turn(tip_rad, turn_rad, most_rad, measured_rad, last_rad, towards_rad))
    beyond_rad = math.copysign(1.0, turn_rad) * math.remainder(commanded - tip_rad - turn_rad, math.tau)
    assert beyond_rad >= -1e-9
    lead_rad = abs(math.remainder(commanded - measured_rad, math.tau))
    assert beyond_rad <= 1e-9 or lead_rad <= MOST_LEAD_RAD + 1e-9


def test_a_copter_that_keeps_its_course_is_commanded_farther_at_every_call() -> None:
    guard = Guard(replace(COPTER, reaction_s=0.2))
    most_rad = turn_rate_rad_s(20.0, COPTER) * DT_S
    turned_rad = []
    for index in range(4):
        wanted = Setpoint(guard.tip(NORTHWARD, index * DT_S, DT_S)[0].heading_rad + most_rad, 20.0, 100.0)
        verdict = guard.check(wanted, NORTHWARD, NOTHING, index * DT_S, DT_S, Hints(towards_rad=3.0))
        assert verdict.setpoint is not None and verdict.changes == ()
        turned_rad.append(verdict.setpoint.heading_rad)
    assert turned_rad == pytest.approx([most_rad * count for count in (1, 2, 3, 4)])


def test_a_copter_whose_wanted_turn_ends_is_commanded_to_where_it_ends() -> None:
    guard = Guard(COPTER)
    for index in range(3):
        wanted = Setpoint(turn_rate_rad_s(20.0, COPTER) * DT_S, 20.0, 100.0)
        verdict = guard.check(wanted, NORTHWARD, NOTHING, index * DT_S, DT_S, Hints(towards_rad=0.5))
    assert verdict.setpoint is not None and verdict.setpoint.heading_rad == pytest.approx(0.5)


@pytest.mark.parametrize("limits", [PLANE, COPTER, replace(PLANE, reaction_s=0.7), replace(PLANE, wind_m_s=3.0)])
@pytest.mark.parametrize("off_rad", [0.0, 0.01, 0.2])
@pytest.mark.parametrize("elapsed_s", [0.5, 0.5004, 0.3, 1.6])
def test_the_tip_is_where_the_guard_reckons_its_next_step_from(
    limits: Limits, off_rad: float, elapsed_s: float
) -> None:
    guard = Guard(limits)
    guard.check(replace(AHEAD, heading_rad=0.1), NORTHWARD, NOTHING, 0.0, DT_S)
    motion = Motion(10.0, 0.5, 0.1 + off_rad, 20.0)
    heading_rad = guard.tip(motion, elapsed_s, DT_S)[0].heading_rad
    assert guard.tip(motion, elapsed_s, DT_S)[0].heading_rad == heading_rad
    most_rad = turn_rate_rad_s(20.0, limits) * DT_S
    beyond = Setpoint(heading_rad + most_rad + 0.01, 20.0, 100.0)
    within = Setpoint(heading_rad + most_rad, 20.0, 100.0)
    assert guard.check(within, motion, NOTHING, elapsed_s, DT_S).changes == ()
    again = Guard(limits)
    again.check(replace(AHEAD, heading_rad=0.1), NORTHWARD, NOTHING, 0.0, DT_S)
    assert again.check(beyond, motion, NOTHING, elapsed_s, DT_S).changes == ("turn rate",)


def test_a_guard_that_succeeds_another_keeps_the_commands_in_flight_and_the_discs_heard() -> None:
    limits = replace(PLANE, reaction_s=0.7)
    first, second, fresh = Guard(limits), Guard(replace(limits, n_max=0.5)), Guard(limits)
    first.check(replace(AHEAD, heading_rad=0.24), NORTHWARD, discs((60.0, 90.0, 20.0)), 0.0, DT_S)
    second.succeed(first)
    motion = Motion(10.0, 0.0, 0.0, 20.0)
    later_rad = [guard.tip(motion, DT_S, DT_S)[0].heading_rad for guard in (first, second, fresh)]
    assert later_rad == pytest.approx([0.24, 0.5 * G_M_S2 / 20.0 * DT_S, 0.0])
    verdict = second.check(AHEAD, motion, discs((60.0, 50.0, 20.0)), DT_S, DT_S)
    assert THREAT_FASTER in verdict.broken
    # What the one is commanded from now on is nothing to the other.
    assert first.tip(motion, DT_S, DT_S)[0].heading_rad == later_rad[0]
