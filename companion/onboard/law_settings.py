"""The settings of the guidance law, made from a companion's configuration."""

from __future__ import annotations

from companion.guidance.settings import LawLimits, LawSettings
from companion.onboard.config import Config, LimitsSection
from companion.surrogate.cost import Weights


def law_settings(config: Config, limits: LimitsSection | None = None, *, can_stop: bool = False) -> LawSettings:
    """Return the settings of the configured law, with `limits` in place of the configured ones if given."""
    limits = limits or config.limits
    return LawSettings(
        agent_id=config.agent_id,
        law=config.law,
        surrogate=config.surrogate,
        weights=Weights(**config.weights.model_dump()),
        separation_m=config.separation_m,
        guidance_step_s=config.guidance_step_s,
        coasting_after_s=config.staleness.coasting_after_s,
        limits=LawLimits(
            speed_m_s=limits.speed_m_s,
            n_max=limits.n_max,
            range_m=limits.range_m,
            reaction_s=limits.reaction_s,
            rate_share=limits.rate_share,
            wind_m_s=limits.wind_m_s,
            position_error_m=limits.position_error_m,
            can_stop=can_stop,
            fence=limits.fence or (),
            exclusions=limits.exclusions,
        ),
    )
