"""Choosing the goal of a tick: fly to the target, loiter, or return home."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from companion.geo.kinematics import nearest_on_way
from companion.guidance.view import View
from companion.onboard.config import Config
from companion.onboard.decision import Purpose
from companion.onboard.directives import Directives
from companion.onboard.engagement import Engagement
from companion.onboard.failsafe import FailsafeStatus, Stage
from companion.protocol.codec import Directive

ARRIVAL_SHARE = 0.8
"""Share of the arrival radius within which a vehicle arrives. The rest is for a target that has moved since it was
heard of: the vehicle stays arrived until the target has moved by more than that."""
WAITING_SPACINGS = 2.0
"""Distance outside the arrival radius, in loiter spacings, from which a vehicle waits while another arrives first."""
WAITING_LEAVE = 1.5
"""Hysteresis: a vehicle goes on waiting until it is this many times as far from the target as where it began to, so
that its own loiter circle does not end the waiting."""


@dataclass(frozen=True)
class LoiterGeometry:
    """Size of a vehicle's loiter circle and its distance from those of others."""

    radius_m: float
    spacing_m: float
    """Least distance between this vehicle's loiter place and a peer's, which may be anywhere on its own circle."""
    claim_m: float
    """Least distance between this vehicle's loiter place and a target that a peer is on its way to."""


class Situation(NamedTuple):
    """Everything that the goal of one tick is chosen by, beside what was latched before."""

    position_ned_m: tuple[float, float]
    home_ned_m: tuple[float, float]
    view: View
    status: FailsafeStatus
    directives: Directives
    came_from_ned_m: tuple[float, float] | None = None
    """Where the vehicle was at the last tick, if it was steered: it may have passed its target between two ticks."""
    below: str | None = None
    """That the vehicle was handed over below the height where steering begins, and still is; None if not."""


class Goal(NamedTuple):
    """What to do now and why, and the latches that the next tick needs (see Engagement)."""

    purpose: Purpose
    reason: str
    place_ned_m: tuple[float, float] | None = None
    """Where to go; None to loiter."""
    at_home: bool = False
    arrived_ned_m: tuple[float, float] | None = None
    """Where the target was when the vehicle arrived at it; None before that."""
    giving_way: bool = False
    """Whether the vehicle waits because another agent arrives at the target first."""
    about_ned_m: tuple[float, float] | None = None
    """What to loiter at: the target that the vehicle has reached, or its home; None to loiter where it is."""
    climbs: bool = False
    """Whether the vehicle climbs at its place before anything else."""


def choose_goal(situation: Situation, before: Engagement, config: Config, loiter: LoiterGeometry) -> Goal:
    """Return what to do now; `before` holds the latches of the last tick."""
    arrived, giving_way = before.arrived_ned_m, before.giving_way
    if situation.below is not None:
        return Goal(Purpose.LOITER, f"{situation.below}: climbs", None, False, arrived, giving_way, climbs=True)
    homing = _why_home(situation)
    if homing is not None:
        # A loiter circle begun just inside reaches out by its width: that is still being home.
        leaving_m = config.arrival_radius_m + 2.0 * loiter.radius_m
        home_m = math.dist(situation.position_ned_m, situation.home_ned_m)
        at_home = home_m <= (leaving_m if before.at_home else ARRIVAL_SHARE * config.arrival_radius_m)
        if at_home:
            home_ned_m = situation.home_ned_m
            return Goal(Purpose.LOITER, f"{homing}: home", None, at_home, arrived, giving_way, home_ned_m)
        return Goal(Purpose.RETURN, homing, situation.home_ned_m, at_home, arrived, giving_way)
    reason = _why_wait(situation)
    target_ned_m = situation.view.target_ned_m
    if reason is not None or target_ned_m is None:
        # The ground station may know that a target is reached before the vehicle has decided so.
        about = None if reason is not None else _if_near(arrived or before.target_ned_m, situation, config)
        words = "no target" if reason is None else reason
        return Goal(Purpose.LOITER, words, None, False, arrived, giving_way, about)
    target_m = math.dist(situation.position_ned_m, target_ned_m)
    if arrived is not None and math.dist(arrived, target_ned_m) > (1.0 - ARRIVAL_SHARE) * config.arrival_radius_m:
        arrived = None
    if arrived is None and _passing_m(situation, target_ned_m) <= ARRIVAL_SHARE * config.arrival_radius_m:
        arrived = target_ned_m
    if arrived is not None:
        return Goal(Purpose.LOITER, "arrived", None, False, arrived, giving_way, _if_near(arrived, situation, config))
    # Two cannot both keep their separation within one arrival radius, and one arrival is enough.
    waiting_m = config.arrival_radius_m + WAITING_SPACINGS * loiter.spacing_m
    waiting_m *= 1.0 if not giving_way else WAITING_LEAVE
    first = None
    if target_m <= waiting_m:
        first = _first_to_arrive(target_m, target_ned_m, situation.view, config.agent_id, loiter.spacing_m)
    if first is not None:
        return Goal(Purpose.LOITER, f"agent {first} arrives first", None, False, arrived, True)
    return Goal(Purpose.TARGET, "assigned", target_ned_m, False, arrived, False)


def _if_near(
    place_ned_m: tuple[float, float] | None, situation: Situation, config: Config
) -> tuple[float, float] | None:
    """Return a place that the vehicle is within the arrival radius of, or has just passed so; else None."""
    near = place_ned_m is not None and _passing_m(situation, place_ned_m) <= config.arrival_radius_m
    return place_ned_m if near else None


def _passing_m(situation: Situation, target_ned_m: tuple[float, float]) -> float:
    """Return the least distance from the target on the straight way from the last tick's position to this one."""
    began = complex(*(situation.came_from_ned_m or situation.position_ned_m))
    to_target = complex(*target_ned_m) - began
    return abs(to_target - nearest_on_way(to_target, complex(*situation.position_ned_m) - began))


def _why_home(situation: Situation) -> str | None:
    if situation.status.stage is Stage.RETURNING:
        return situation.status.words
    return situation.directives.words if situation.directives.in_force is Directive.RETURN else None


def _why_wait(situation: Situation) -> str | None:
    if situation.status.stage is Stage.LOITERING:
        return situation.status.words
    return situation.directives.words if situation.directives.in_force is Directive.HOLD else None


def _first_to_arrive(
    to_target_m: float, target_ned_m: tuple[float, float], view: View, agent_id: int, spacing_m: float
) -> int | None:
    """Return the id of a rival that goes first: it is nearer to the target, or about as near and has the lower id."""
    for identity, place in view.rivals:
        behind_m = to_target_m - math.dist(place, target_ned_m)
        abreast = abs(behind_m) <= spacing_m
        if (abreast and identity < agent_id) or (not abreast and behind_m > 0.0):
            return identity
    return None
