"""The guard's input and output values, and the words in which it reports what it changed and which assumption broke."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

PIVOT_SPEED_M_S = 0.5
"""A vehicle below this speed is assumed to turn on the spot, at the turn rate that it has at this speed, and is never
counted on to outrun a moving disc. Only a vehicle that can stop may fly slower."""
ROUNDING_M = 1e-6
"""Extra distance that a new path keeps from discs and fence, so that rounding while it is flown cannot violate them."""
TRACKING_STEPS = 1.5
"""The greatest wind may blow a vehicle off its path by its speed times this many guidance steps, plus the share of
TRACKING_REACTIONS (measured: docs/guard.md, Wind)."""
TRACKING_REACTIONS = 0.75
"""The greatest wind may blow a vehicle off its path by its speed times this many reaction times, plus the share of
TRACKING_STEPS (measured: docs/guard.md, Wind)."""

# What was changed and why: Verdict.changes.
NOT_FINITE = "not finite"
IMPOSSIBLE = "impossible"
SPEED = "speed"
ALTITUDE = "altitude"
TURN = "turn rate"
KEEP_OUT = "keep-out"
FENCE = "fence"
BACKUP = "back-up continued"
NO_BACKUP = "no certified back-up"

# Which assumption did not hold: Verdict.broken.
NEW_THREAT = "new threat"
THREAT_FASTER = "threat faster than its bound"
THREAT_CHANGED = "threat changed"
POSITION = "position"
RATE = "turn rate not achieved"
WIND = "wind"
LATE = "called late"


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What the vehicle is asked to fly: a heading in radians clockwise from grid north, a speed and an altitude."""

    heading_rad: float
    speed_m_s: float
    altitude_m: float


@dataclass(frozen=True, slots=True)
class Motion:
    """The vehicle's position on the mission's plane, its course over ground (clockwise from north) and ground speed."""

    north_m: float
    east_m: float
    heading_rad: float
    speed_m_s: float

    @property
    def position_ned_m(self) -> tuple[float, float]:
        """The position as (north, east)."""
        return self.north_m, self.east_m


@dataclass(frozen=True)
class Limits:
    """The vehicle's limits and the bounds of what disturbs it; raises ValueError where no vehicle could hold them.

    `braking_m_s2` is None for a vehicle that cannot stop, `reaction_s` the time from a setpoint to its effect,
    `rate_share` the share of the turn rate n_max g / v that turns achieve, `wind_m_s` the greatest wind, and
    `position_error_m` the greatest error of a reported position. `exclusions_ned_m` are polygons to stay outside of, as
    `fence_ned_m` is one to stay inside. `horizon_s` is for how long a path must stay clear of moving discs where none
    stays clear of them for ever.
    """

    speed_min_m_s: float
    speed_max_m_s: float
    n_max: float
    altitude_min_m: float
    altitude_max_m: float
    braking_m_s2: float | None = None
    fence_ned_m: tuple[tuple[float, float], ...] | None = None
    horizon_s: float | None = None
    reaction_s: float = 0.0
    rate_share: float = 1.0
    wind_m_s: float = 0.0
    position_error_m: float = 0.0
    exclusions_ned_m: tuple[tuple[tuple[float, float], ...], ...] = ()

    def __post_init__(self) -> None:
        can_stop = self.braking_m_s2 is not None
        sound = (
            (0.0 == self.speed_min_m_s if can_stop else PIVOT_SPEED_M_S <= self.speed_min_m_s)
            and self.speed_min_m_s <= self.speed_max_m_s < math.inf
            and 0.0 < self.n_max < math.inf
            and -math.inf < self.altitude_min_m <= self.altitude_max_m < math.inf
            and (self.braking_m_s2 is None or 0.0 < self.braking_m_s2 < math.inf)
            and (self.horizon_s is None or 0.0 <= self.horizon_s < math.inf)
            and 0.0 <= self.reaction_s < math.inf
            and 0.0 < self.rate_share <= 1.0
            and 0.0 <= self.wind_m_s
            and (self.wind_m_s == 0.0 or self.wind_m_s < (self.speed_max_m_s if can_stop else self.speed_min_m_s))
            and 0.0 <= self.position_error_m < math.inf
        )
        if not sound:
            raise ValueError(f"limits that nothing can hold: {self}")
        if self.fence_ned_m is not None and not (len(self.fence_ned_m) >= 3 and np.isfinite(self.fence_ned_m).all()):
            raise ValueError("a fence needs at least three corners, all of them finite")
        if not all(len(corners) >= 3 and np.isfinite(corners).all() for corners in self.exclusions_ned_m):
            raise ValueError("an exclusion needs at least three corners, all of them finite")


@dataclass(frozen=True, slots=True)
class Discs:
    """The keep-out discs at the time of the call, and the greatest speed of each.

    `attack_m` holds the inner (attack) radii: where no path is certified, the guard first keeps out of those. `ids`
    identify the discs from call to call; None identifies them by their order. `unit_m` is the unit in which they were
    told: a later report may extend beyond an earlier one by a few of them. `pictures` number the
    picture that each was told in: one that another has elsewhere was changed by whoever tells it; None: all are of one.
    """

    centres_ned_m: np.ndarray  # (M, 2) m
    radii_m: np.ndarray  # (M,) m
    speeds_m_s: np.ndarray  # (M,) m/s
    attack_m: np.ndarray | None = None  # (M,) m
    ids: np.ndarray | None = None  # (M,)
    unit_m: float = 0.0
    pictures: np.ndarray | None = None  # (M,) int


@dataclass(frozen=True, slots=True)
class Verdict:
    """The setpoint that may be sent (None: send nothing), and in `changes` why it differs from the wanted one.

    `broken` names the assumptions that did not hold since the last call. `certified_s` is for how long the stored path
    stays clear: inf for ever, what is left of the horizon, or 0 where nothing is certified.
    """

    setpoint: Setpoint | None
    changes: tuple[str, ...]
    broken: tuple[str, ...] = ()
    certified_s: float = 0.0


class Piece(NamedTuple):
    """A straight line or arc: its start, its heading there, its curvature (positive: to the right) and its length."""

    north_m: float
    east_m: float
    heading_rad: float
    curvature_1_m: float
    length_m: float


@dataclass(frozen=True, slots=True)
class Hints:
    """What guidance tells the guard in addition to the wanted setpoint."""

    route: Sequence[Piece] = ()
    """The planned route, piece by piece in order; the back-up may follow it where no turning circle is clear."""
    keep_right: bool = False
    """Whether, as long as the right-hand turning circle is clear, only that circle serves as back-up and replaces a
    refused setpoint: the right of way between vehicles rests on it (docs/separation.md)."""
    towards_rad: float | None = None
    """The heading at which the wanted turn ends in later steps: the command does not lead beyond it."""


NO_HINTS = Hints()
