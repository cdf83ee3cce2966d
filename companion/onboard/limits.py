"""The limits that guidance and guard use: of configured limits and the vehicle's abilities the more cautious."""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.autopilot.adapter import Abilities
from companion.onboard.config import LimitsSection

ROUNDING_M_S = 1e-6
"""Difference of two speeds that is none: that of a sum of decimal fractions."""


def within(configured: LimitsSection, abilities: Abilities) -> LimitsSection:
    """Return the more cautious of configured limits and abilities, with the tracking error added to the position error.

    A configured speed below the least one that the vehicle can fly is raised to that.
    """
    speed_m_s = max(_least(configured.speed_m_s, abilities.speed_max_m_s), abilities.speed_min_m_s)
    # A copy is not validated anew: `steering.adapted` checks whether the wind is now too strong.
    return configured.model_copy(
        update={
            "speed_m_s": speed_m_s,
            "n_max": _least(configured.n_max, abilities.n_max),
            "braking_m_s2": _least(configured.braking_m_s2, abilities.braking_m_s2),
            "reaction_s": max(configured.reaction_s, abilities.reaction_s),
            "position_error_m": configured.position_error_m + abilities.tracking_m,
        }
    )


def unable(configured: LimitsSection, abilities: Abilities, *, can_stop: bool) -> str | None:
    """Return why a vehicle of these abilities cannot be steered, with the remedy; None if nothing speaks against it.

    `can_stop`: whether it is steered over the ground and can stop; a plane flies at its airspeed, whatever the wind.
    """
    limits = within(configured, abilities)
    if abilities.insane:
        return f"{'; '.join(abilities.insane)}: correct it on the autopilot"
    if limits.wind_m_s >= limits.speed_m_s:
        return f"limits.wind_m_s {limits.wind_m_s:g} is not below the {limits.speed_m_s:.3g} m/s that it can fly"
    if can_stop and (shortage := beyond_airspeed(configured, abilities)) is not None:
        return f"{shortage.words}: {shortage.remedy}"
    return None


class Shortage(NamedTuple):
    """Why a vehicle cannot fly its speed against its wind, and what a person can do."""

    words: str
    remedy: str
    reach: str
    """The airspeed that it reaches and what that follows from: "10.3 (ANGLE_MAX 3000)"."""


def beyond_airspeed(configured: LimitsSection, abilities: Abilities) -> Shortage | None:
    """Return why a vehicle that is steered over the ground cannot fly its speed against its wind; None if it can.

    Against the wind it flies through the air by its speed and the wind's together. Beyond what its lean yields it is
    saturated, and keeps a course that nobody asked for (docs/autopilots.md).
    """
    limits, stated_m_s = within(configured, abilities), configured.airspeed_max_m_s
    needed_m_s, most_m_s, by = limits.speed_m_s + limits.wind_m_s, abilities.airspeed_max_m_s, abilities.airspeed_by
    if stated_m_s is not None and stated_m_s < most_m_s:
        most_m_s, by = stated_m_s, "limits.airspeed_max_m_s"
    if needed_m_s <= most_m_s + ROUNDING_M_S:
        return None
    ways = []
    # The wind is below the speed in any configuration, so that a slower vehicle may have to bear less wind, too.
    if most_m_s - limits.wind_m_s > limits.wind_m_s:
        ways.append(f"speed_m_s to {_inwards(most_m_s - limits.wind_m_s)}")
    if most_m_s > limits.speed_m_s:
        ways.append(f"wind_m_s to {_inwards(most_m_s - limits.speed_m_s)}")
    if not ways:
        ways.append(f"speed_m_s and wind_m_s to {_inwards(most_m_s)} together")
    if abilities.airspeed_remedy and by == abilities.airspeed_by:
        ways.append(abilities.airspeed_remedy)
    reach = f"{_inwards(most_m_s)} ({by})"
    return Shortage(
        f"limits.speed_m_s {limits.speed_m_s:.4g} + wind_m_s {limits.wind_m_s:.4g} = {needed_m_s:.4g} m/s through the "
        f"air; it reaches {reach}",
        f"set {' or '.join(ways)}",
        reach,
    )


def _inwards(value: float) -> str:
    """Return a greatest value in words, rounded down so that what is said is possible."""
    return f"{math.floor((value + ROUNDING_M_S) * 100.0) / 100.0:g}"


def _least(configured: float, able: float) -> float:
    return able if able < configured else configured
