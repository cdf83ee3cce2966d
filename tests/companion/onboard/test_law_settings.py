"""What a guidance law is told of a companion's configuration."""

from __future__ import annotations

from companion.guidance.settings import LawLimits, LawSettings
from companion.mission.model import CostWeights
from companion.onboard.config import Config, LimitsSection, StalenessSection
from companion.onboard.law_settings import law_settings
from companion.surrogate.cost import Weights

CONFIG = Config(
    agent_id=7,
    law="seed",
    surrogate="analytic",
    limits=LimitsSection(
        speed_m_s=20.0,
        n_max=1.5,
        range_m=9_000.0,
        reaction_s=0.3,
        rate_share=0.8,
        wind_m_s=4.0,
        position_error_m=2.0,
    ),
    weights=CostWeights(k_d=4.0, k_a=3.0, k_c=2.0, k_l=1.0),
    separation_m=60.0,
    guidance_step_s=0.25,
    staleness=StalenessSection(coasting_after_s=12.0),
)


def test_a_law_is_told_what_the_configuration_says() -> None:
    assert law_settings(CONFIG) == LawSettings(
        agent_id=7,
        law="seed",
        surrogate="analytic",
        weights=Weights(k_d=4.0, k_a=3.0, k_c=2.0, k_l=1.0),
        separation_m=60.0,
        guidance_step_s=0.25,
        coasting_after_s=12.0,
        limits=LawLimits(20.0, 1.5, 9_000.0, 0.3, 0.8, 4.0, 2.0),
    )


def test_a_law_is_told_the_limits_of_a_vehicle_that_can_do_less_than_configured() -> None:
    less = CONFIG.limits.model_copy(update={"speed_m_s": 15.0})
    assert law_settings(CONFIG, less).limits == LawLimits(15.0, 1.5, 9_000.0, 0.3, 0.8, 4.0, 2.0)
