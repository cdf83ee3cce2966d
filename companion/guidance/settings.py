"""The settings that a guidance law is made from before the flight: its name, its weights and the vehicle's limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from companion.surrogate.cost import Weights

LawName = Literal["routed", "seed", "ramp", "step"]
"""The laws: `routed` follows the shortest route around the discs; the others are the paper's gradient law, on the
surrogate F* (`seed`), on the polygon F~ (`ramp`) and on F itself, whose gradient is zero (`step`)."""
LAWS: tuple[LawName, ...] = ("routed", "seed", "ramp", "step")
DEFAULT_LAW: LawName = "routed"
SurrogateName = Literal["pairwise", "analytic", "monolithic"]


@dataclass(frozen=True)
class LawLimits:
    """The limits of the vehicle that a law takes into account."""

    speed_m_s: float
    """Cruise speed."""
    n_max: float
    """Load factor of the greatest turn rate, n_max g / v."""
    range_m: float
    """Distance that the vehicle can fly."""
    reaction_s: float
    """Time from sending a setpoint until the vehicle begins to obey it."""
    rate_share: float
    """Share of the turn rate n_max g / v that the vehicle achieves."""
    wind_m_s: float
    """The strongest wind to expect, gusts included."""
    position_error_m: float
    """Greatest error of a reported position."""
    can_stop: bool = False
    """Whether the vehicle can stand still in the air."""
    fence: tuple[tuple[float, float], ...] = ()
    """Corners (north, east), in m, of the polygon to stay inside; () if there is none."""
    exclusions: tuple[tuple[tuple[float, float], ...], ...] = ()
    """Corners of the polygons to stay outside."""


@dataclass(frozen=True)
class LawSettings:
    """The settings of the law of one vehicle."""

    agent_id: int
    law: LawName
    surrogate: SurrogateName
    weights: Weights
    separation_m: float
    guidance_step_s: float
    coasting_after_s: float
    """Age of the newest broadcast from which the failsafe stage is coasting."""
    limits: LawLimits
