"""What a guidance law is told of its vehicle before the flight: which law it is, and what it has to reckon with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from companion.surrogate.cost import Weights

LawName = Literal["routed", "seed", "ramp", "step"]
"""The shortest way around the discs; the paper's law on its surrogate, on the polygon F~, and on F itself, whose
gradient is nothing."""
LAWS: tuple[LawName, ...] = ("routed", "seed", "ramp", "step")
DEFAULT_LAW: LawName = "routed"
SurrogateName = Literal["pairwise", "analytic", "monolithic"]


@dataclass(frozen=True)
class LawLimits:
    """What the vehicle can do, as far as a law reckons with it."""

    speed_m_s: float
    n_max: float
    """Load factor of its greatest turn rate."""
    range_m: float
    reaction_s: float
    """From sending a setpoint to the vehicle beginning to obey it."""
    rate_share: float
    """How much of the turn rate n_max g/v the vehicle achieves."""
    wind_m_s: float
    """The strongest wind, gusts included."""
    position_error_m: float


@dataclass(frozen=True)
class LawSettings:
    """The settings of one vehicle's law."""

    agent_id: int
    law: LawName
    surrogate: SurrogateName
    weights: Weights
    separation_m: float
    guidance_step_s: float
    coasting_after_s: float
    """Age from which the picture counts as coasting."""
    limits: LawLimits
