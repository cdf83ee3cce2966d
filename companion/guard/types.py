"""The values that go into the guard and come out of it, and the words in which it says what it changed and why."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

PIVOT_SPEED_M_S = 0.5
"""A vehicle slower than this turns on the spot, at the rate of this speed, and flies away from nothing. Only one that
can stop may be."""
ROUNDING_M = 1e-6
"""A new path keeps this much clear, so that nothing is lost to rounding while it is flown."""
TRACKING_STEPS = 1.5
TRACKING_REACTIONS = 0.75
"""Steps and reaction times of the greatest wind that a vehicle may be blown off its path: docs/guard.md has what was
measured."""

NOT_FINITE = "not finite"
IMPOSSIBLE = "impossible"
SPEED = "speed"
ALTITUDE = "altitude"
TURN = "turn rate"
KEEP_OUT = "keep-out"
FENCE = "fence"
BACKUP = "back-up continued"
NO_BACKUP = "no certified back-up"

NEW_THREAT = "new threat"
THREAT_FASTER = "threat faster than its bound"
POSITION = "position"
RATE = "turn rate not achieved"
WIND = "wind"
LATE = "called late"


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Heading in radians clockwise from grid north, speed and altitude."""

    heading_rad: float
    speed_m_s: float
    altitude_m: float


@dataclass(frozen=True, slots=True)
class Motion:
    """Where the vehicle is and how it moves over the ground."""

    north_m: float
    east_m: float
    heading_rad: float
    speed_m_s: float

    @property
    def position_ned_m(self) -> tuple[float, float]:
        """(north, east)."""
        return self.north_m, self.east_m


@dataclass(frozen=True)
class Limits:
    """What the vehicle may do; `braking_m_s2` is None for one that cannot stop. Raises ValueError for nonsense.

    `rate_share` is the share of n_max g / v that its turns achieve, `wind_m_s` the greatest wind, `position_error_m`
    the greatest error of a reported position, `horizon_s` how long moving discs are kept clear of where no path is
    clear of them for ever.
    """

    speed_min_m_s: float
    speed_max_m_s: float
    n_max: float
    altitude_min_m: float
    altitude_max_m: float
    braking_m_s2: float | None = None
    fence_ned_m: tuple[tuple[float, float], ...] | None = None
    horizon_s: float = 30.0
    reaction_s: float = 0.0
    rate_share: float = 1.0
    wind_m_s: float = 0.0
    position_error_m: float = 0.0

    def __post_init__(self) -> None:
        can_stop = self.braking_m_s2 is not None
        sound = (
            (0.0 == self.speed_min_m_s if can_stop else PIVOT_SPEED_M_S <= self.speed_min_m_s)
            and self.speed_min_m_s <= self.speed_max_m_s < math.inf
            and 0.0 < self.n_max < math.inf
            and -math.inf < self.altitude_min_m <= self.altitude_max_m < math.inf
            and (self.braking_m_s2 is None or 0.0 < self.braking_m_s2 < math.inf)
            and 0.0 <= self.horizon_s < math.inf
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


@dataclass(frozen=True, slots=True)
class Discs:
    """Keep-out discs as they are now, and the greatest speed of each.

    `attack_m` are the radii that are never given up for anything else; `ids` tell discs apart from call to call (None:
    by their order).
    """

    centres_ned_m: np.ndarray  # (M, 2) m
    radii_m: np.ndarray  # (M,) m
    speeds_m_s: np.ndarray  # (M,) m/s
    attack_m: np.ndarray | None = None  # (M,) m
    ids: np.ndarray | None = None  # (M,)


@dataclass(frozen=True, slots=True)
class Verdict:
    """The setpoint that may be sent (None: send nothing), and why it differs from the one wanted.

    `broken` names the assumptions that did not hold since the last call. `certified_s` is how long the path in hand
    stays clear: inf, the horizon, or 0 for "nothing is certified".
    """

    setpoint: Setpoint | None
    changes: tuple[str, ...]
    broken: tuple[str, ...] = ()
    certified_s: float = 0.0


class Piece(NamedTuple):
    """A stretch of a path with one curvature, positive to the right."""

    north_m: float
    east_m: float
    heading_rad: float
    curvature_1_m: float
    length_m: float


@dataclass(frozen=True, slots=True)
class Hints:
    """What guidance knows beside the setpoint that it wants."""

    route: Sequence[Piece] = ()
    """A way that may serve as back-up where no turning circle does: its stretches in order."""
    keep_right: bool = False
    """The circle to the right is kept clear while it is, and nothing else takes the place of a wanted setpoint: the
    right of way between vehicles rests on that circle."""


NO_HINTS = Hints()
