"""What guidance and guard reckon with: the configured limits and the vehicle's abilities, whichever is less."""

from __future__ import annotations

from companion.autopilot.adapter import Abilities
from companion.onboard.config import LimitsSection


def within(configured: LimitsSection, abilities: Abilities) -> LimitsSection:
    """Return the more cautious of both; what the vehicle strays from its path adds to the position's error.

    A vehicle that flies no slower than its `speed_min_m_s` is reckoned with as flying that, whatever is configured.
    """
    speed_m_s = max(_least(configured.speed_m_s, abilities.speed_max_m_s), abilities.speed_min_m_s)
    # A copy is not validated anew: that the wind may now be too strong is for the core to say.
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
