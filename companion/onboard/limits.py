"""The limits that guidance and guard use: what is configured, able and measured, whichever is the most cautious."""

from __future__ import annotations

from companion.autopilot.adapter import Abilities
from companion.onboard.config import LimitsSection
from companion.onboard.obedience import NOTHING, Measured

LEAST_SPEED_SHARE = 0.1
"""Share of the speed limit that a wind leaves at least: what is below that is no speed to fly anywhere with."""
WIND_SHARE = 0.9
"""Share of the speed up to which a measured wind is reckoned with; in a greater one there is nothing to reckon."""


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


def _least(configured: float, able: float) -> float:
    return able if able < configured else configured
