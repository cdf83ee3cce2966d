"""The vehicles of a mission as they will fly, and the refusal of what only their guard would refuse."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from companion.autopilot.adapter import Abilities
from companion.autopilot.kinds import KINDS
from companion.autopilot.registry import ADAPTERS
from companion.errors import InputError, one_line
from companion.geo.kinematics import turn_rate_rad_s
from companion.guidance.settings import LawName
from companion.mission.model import AgentSpec, Mission, TargetSpec
from companion.onboard.config import config_for_agent, fast_enough
from companion.onboard.limits import beyond_airspeed, within
from companion.onboard.steering import Steering, steering_of

SPEED_TOLERANCE = 1e-6
"""Share of a speed by which it may miss what a vehicle flies: the rounding of a product."""


class Flyer(NamedTuple):
    """One vehicle of a mission with the steering that it will fly by."""

    spec: AgentSpec
    height_m: float
    altitude_m: float
    """Height above sea level."""
    steering: Steering

    @property
    def turn_radius_m(self) -> float:
        """Radius of the turning circle over the ground, flown down the greatest wind; 0 for a vehicle that can stop."""
        limits = self.steering.config.limits
        if self.steering.can_stop:
            return 0.0
        ground_m_s = limits.speed_m_s + limits.wind_m_s
        rate_rad_s = limits.rate_share * turn_rate_rad_s(limits.speed_m_s, limits.n_max)
        return ground_m_s * ground_m_s / (limits.speed_m_s * rate_rad_s)


def abilities_of(kind: str, parameters: Sequence[tuple[str, float]]) -> Abilities:
    """Return what a kind of autopilot can do with parameters, by name, that differ from its defaults."""
    adapter = ADAPTERS[kind]()
    for name, value in parameters:
        adapter.parameters.tell(name, value)
    return adapter.abilities


def speeds_instead(speed_m_s: float, abilities: Abilities) -> str | None:
    """Return which speeds a vehicle of these abilities flies instead of one that it does not; None if it flies it."""
    least_m_s, most_m_s = abilities.speed_min_m_s, abilities.speed_max_m_s
    if least_m_s * (1.0 - SPEED_TOLERANCE) <= speed_m_s <= most_m_s * (1.0 + SPEED_TOLERANCE):
        return None
    return f"{least_m_s:.4g} m/s" if least_m_s == most_m_s else f"{least_m_s:.4g} to {most_m_s:.4g} m/s"


def fleet_of(mission: Mission, law: LawName, kind: str, abilities: Abilities, source: str) -> list[Flyer]:
    """Return the vehicles of a resolved mission as an autopilot kind flies them; errors name `source`.

    Raises:
        InputError: guard or law cannot hold the limits of an agent.

    """
    can_stop = KINDS[kind].can_stop
    fleet = []
    for index, spec in enumerate(mission.agents):
        where = f"{source}: agents[{index}]"
        allowed = fast_enough(spec.speed_m_s, can_stop)
        if allowed is not None:
            raise InputError(f"{where}.speed_m_s: {spec.speed_m_s:g} m/s; allowed: {allowed}")
        config = config_for_agent(mission, spec.id, law)
        config = config.model_copy(update={"limits": within(config.limits, abilities)})
        try:
            steering = steering_of(config, can_stop)
        except ValueError as error:
            raise InputError(f"{where}: {one_line(str(error))}") from error
        fleet.append(Flyer(spec, config.height_m, mission.origin.alt_m + config.height_m, steering))
    return fleet


def beyond_airspeed_in_wind(fleet: Sequence[Flyer], kind: str, abilities: Abilities) -> list[str]:
    """Return the agents whose companion would not begin to steer: their speed and the wind are beyond their reach."""
    if not KINDS[kind].can_stop:
        return []  # A plane flies at its airspeed, whatever the wind.
    concerns = []
    for flyer in fleet:
        limits = flyer.steering.config.limits
        shortage = beyond_airspeed(limits, abilities)
        if shortage is not None:
            concerns.append(
                f"{limits.wind_m_s:g} m/s, gusts included, against the {limits.speed_m_s:.3g} m/s of agent "
                f"{flyer.spec.id}: {kind} reaches {shortage.reach} through the air, so that its companion does not "
                "begin to steer"
            )
    return concerns


def nearest_target(mission: Mission, spec: AgentSpec) -> TargetSpec:
    """Return the target that an agent is kept for, or the one nearest to its start."""
    allowed = [target for target in mission.targets if spec.only_target in (None, target.id)]
    return min(allowed, key=lambda target: math.dist(target.position_ned_m, spec.position_ned_m))
