"""What to do now, by where the vehicle is, what it believes, and what it had begun."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from companion.guidance.view import View
from companion.onboard.config import Config
from companion.onboard.decision import Purpose
from companion.onboard.directives import Directives
from companion.onboard.engagement import Engagement
from companion.onboard.failsafe import Cause, FailsafeStatus, Stage, Trigger
from companion.onboard.goal import ARRIVAL_SHARE, Goal, LoiterGeometry, Situation, choose_goal
from companion.onboard.world_model import WorldModel
from companion.protocol.codec import Directive

ME = 3
CONFIG = Config(agent_id=ME, arrival_radius_m=100.0)
LOITER = LoiterGeometry(radius_m=20.0, spacing_m=50.0, claim_m=60.0)
HOME_NED_M = (-1_000.0, 0.0)
LATE = FailsafeStatus(Stage.LOITERING, (Trigger(Cause.BROADCAST, Stage.LOITERING, "picture too old", 0.0),))
BLIND = FailsafeStatus(Stage.RETURNING, (Trigger(Cause.BROADCAST, Stage.RETURNING, "blind", 0.0),))


def view(target_ned_m: tuple[float, float] | None = (1_000.0, 0.0), **changed: object) -> View:
    return replace(WorldModel(ME).view(0.0), target_ned_m=target_ned_m, **changed)  # type: ignore[arg-type]


def goal(
    north_m: float,
    seen: View | None = None,
    before: Engagement | None = None,
    status: FailsafeStatus | None = None,
    directive: Directive = Directive.NORMAL,
    came_from_ned_m: tuple[float, float] | None = None,
) -> Goal:
    situation = Situation(
        (north_m, 0.0), HOME_NED_M, seen or view(), status or FailsafeStatus(), Directives(directive), came_from_ned_m
    )
    return choose_goal(situation, before or Engagement(), CONFIG, LOITER)


def test_a_vehicle_goes_to_the_target_that_it_was_assigned() -> None:
    chosen = goal(0.0)
    assert (chosen.purpose, chosen.reason, chosen.place_ned_m) == (Purpose.TARGET, "assigned", (1_000.0, 0.0))


@pytest.mark.parametrize(
    ("status", "directive", "target_ned_m", "reason"),
    [
        (LATE, Directive.HOLD, (1_000.0, 0.0), "picture too old"),
        (FailsafeStatus(), Directive.HOLD, (1_000.0, 0.0), "directive hold"),
        (FailsafeStatus(), Directive.NORMAL, None, "no target"),
    ],
)
def test_a_vehicle_without_somewhere_to_go_loiters(
    status: FailsafeStatus, directive: Directive, target_ned_m: tuple[float, float] | None, reason: str
) -> None:
    chosen = goal(0.0, view(target_ned_m), status=status, directive=directive)
    assert (chosen.purpose, chosen.reason, chosen.place_ned_m) == (Purpose.LOITER, reason, None)


def test_a_vehicle_that_flew_through_the_arrival_circle_between_two_ticks_has_arrived() -> None:
    within_m = ARRIVAL_SHARE * CONFIG.arrival_radius_m
    assert goal(1_000.0 + 2.0 * within_m).arrived_ned_m is None
    passed = goal(1_000.0 + 2.0 * within_m, came_from_ned_m=(1_000.0 - 3.0 * within_m, 0.0))
    assert (passed.purpose, passed.reason, passed.arrived_ned_m) == (Purpose.LOITER, "arrived", (1_000.0, 0.0))


@given(
    st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)),
    st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)),
)
def test_arriving_is_judged_by_the_nearest_point_of_the_way_between_two_ticks(
    here: tuple[float, float], there: tuple[float, float]
) -> None:
    within_m = ARRIVAL_SHARE * CONFIG.arrival_radius_m
    ends = [(1_000.0 + place[0] * within_m, place[1] * within_m) for place in (there, here)]
    shares = [k / 2_000.0 for k in range(2_001)]
    way = [(ends[0][0] + s * (ends[1][0] - ends[0][0]), ends[0][1] + s * (ends[1][1] - ends[0][1])) for s in shares]
    nearest_m = min(math.dist(place, (1_000.0, 0.0)) for place in way)
    assume(abs(nearest_m - within_m) > 0.01 * within_m)
    situation = Situation(ends[1], HOME_NED_M, view(), FailsafeStatus(), Directives(), ends[0])
    chosen = choose_goal(situation, Engagement(), CONFIG, LOITER)
    assert (chosen.arrived_ned_m is not None) is (nearest_m < within_m)


@pytest.mark.parametrize(("moved", "stays"), [(0.9, True), (1.1, False)])
def test_a_vehicle_stays_arrived_until_its_target_has_moved_by_what_the_arrival_radius_leaves(
    moved: float, stays: bool
) -> None:
    spare_m = (1.0 - ARRIVAL_SHARE) * CONFIG.arrival_radius_m
    before = Engagement(arrived_ned_m=(1_000.0 - moved * spare_m, 0.0))
    assert (goal(0.0, before=before).arrived_ned_m is not None) is stays


def test_going_home_keeps_what_was_latched_of_the_target() -> None:
    chosen = goal(0.0, before=Engagement(arrived_ned_m=(1.0, 2.0), giving_way=True), status=BLIND)
    assert chosen == Goal(Purpose.RETURN, "blind", HOME_NED_M, at_home=False, arrived_ned_m=(1.0, 2.0), giving_way=True)


def test_whoever_is_home_loiters_there() -> None:
    chosen = goal(HOME_NED_M[0] + 10.0, directive=Directive.RETURN)
    assert (chosen.purpose, chosen.reason, chosen.at_home) == (Purpose.LOITER, "directive return: home", True)


@pytest.mark.parametrize(("rival", "rival_north_m", "first"), [(9, 950.0, True), (9, 830.0, False), (2, 830.0, True)])
def test_the_nearer_of_two_at_one_target_goes_first_and_of_two_abreast_the_lower_id(
    rival: int, rival_north_m: float, first: bool
) -> None:
    chosen = goal(830.0, view(rivals=((rival, (rival_north_m, 0.0)),)))
    assert (chosen.giving_way, chosen.purpose is Purpose.LOITER) == (first, first)
