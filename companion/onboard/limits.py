"""The limits that guidance and guard use: what is configured, able and measured, whichever is the most cautious."""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.autopilot.adapter import Abilities
from companion.onboard.config import LimitsSection
from companion.onboard.obedience import NOTHING, Measured

LEAST_SPEED_SHARE = 0.1
"""Share of the speed limit that a wind leaves at least: what is below that is no speed to fly anywhere with."""
WIND_SHARE = 0.9
"""Share of the speed up to which a measured wind is reckoned with; in a greater one there is nothing to reckon."""

ROUNDING_M_S = 1e-6
"""Difference of two speeds that is none: that of a sum of decimal fractions."""


def within(configured: LimitsSection, abilities: Abilities, found: Measured = NOTHING) -> LimitsSection:
    """Return the more cautious of configured limits and abilities, with the tracking error added to the position error.

    A configured speed below the least one that the vehicle can fly is raised to that. `found` is what was measured to
    be worse than both.
    """
    speed_m_s = max(_least(configured.speed_m_s, abilities.speed_max_m_s), abilities.speed_min_m_s)
    # A copy is not validated anew: `steering.adapted` checks whether the wind is now too strong.
    able = configured.model_copy(
        update={
            "speed_m_s": speed_m_s,
            "n_max": _least(configured.n_max, abilities.n_max),
            "braking_m_s2": _least(configured.braking_m_s2, abilities.braking_m_s2),
            "reaction_s": max(configured.reaction_s, abilities.reaction_s),
            "position_error_m": configured.position_error_m + abilities.tracking_m,
        }
    )
    return able if found == NOTHING else _measured(able, found)


def _measured(able: LimitsSection, found: Measured) -> LimitsSection:
    """Return the more cautious of limits and what was measured.

    Turns are limited by n_max, which guidance, right of way and guard share, so that the command turns as slowly as the
    vehicle.
    """
    wind_m_s, speed_m_s = found.wind_m_s or 0.0, able.speed_m_s
    if found.airspeed_max_m_s is not None:
        speed_m_s = _least(speed_m_s, max(found.airspeed_max_m_s - wind_m_s, LEAST_SPEED_SHARE * speed_m_s))
    return able.model_copy(
        update={
            "speed_m_s": speed_m_s,
            "n_max": able.n_max * (1.0 if found.rate_share is None else found.rate_share),
            "braking_m_s2": able.braking_m_s2 if found.braking_m_s2 is None else found.braking_m_s2,
            "reaction_s": able.reaction_s if found.reaction_s is None else found.reaction_s,
            "wind_m_s": min(max(able.wind_m_s, wind_m_s), WIND_SHARE * speed_m_s),
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
