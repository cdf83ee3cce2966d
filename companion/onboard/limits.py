"""The limits that guidance and guard use: of configured limits and the vehicle's abilities the more cautious."""

from __future__ import annotations

from companion.autopilot.adapter import Abilities
from companion.onboard.config import LimitsSection


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


def _least(configured: float, able: float) -> float:
    return able if able < configured else configured
