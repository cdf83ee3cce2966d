"""What to do now, by where the vehicle is, what it believes, and what it had begun."""

from __future__ import annotations

from dataclasses import replace

import pytest

from companion.guidance.view import View
from companion.onboard.config import Config
from companion.onboard.decision import Purpose
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
) -> Goal:
    situation = Situation((north_m, 0.0), HOME_NED_M, seen or view(), status or FailsafeStatus(), directive)
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


@pytest.mark.parametrize("had_arrived", [False, True])
def test_having_arrived_is_left_at_a_greater_distance_than_it_begins(had_arrived: bool) -> None:
    between_m = 1_000.0 - 0.5 * (1.0 + ARRIVAL_SHARE) * CONFIG.arrival_radius_m
    assert goal(between_m, before=Engagement(arrived=had_arrived)).arrived is had_arrived


def test_going_home_keeps_what_was_latched_of_the_target() -> None:
    chosen = goal(0.0, before=Engagement(arrived=True, giving_way=True), status=BLIND)
    assert chosen == Goal(Purpose.RETURN, "blind", HOME_NED_M, at_home=False, arrived=True, giving_way=True)


def test_whoever_is_home_loiters_there() -> None:
    chosen = goal(HOME_NED_M[0] + 10.0, directive=Directive.RETURN)
    assert (chosen.purpose, chosen.reason, chosen.at_home) == (Purpose.LOITER, "directive return: home", True)


@pytest.mark.parametrize(("rival", "rival_north_m", "first"), [(9, 950.0, True), (9, 830.0, False), (2, 830.0, True)])
def test_the_nearer_of_two_at_one_target_goes_first_and_of_two_abreast_the_lower_id(
    rival: int, rival_north_m: float, first: bool
) -> None:
    chosen = goal(830.0, view(rivals=((rival, (rival_north_m, 0.0)),)))
    assert (chosen.giving_way, chosen.purpose is Purpose.LOITER) == (first, first)
