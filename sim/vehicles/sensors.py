"""What the autopilot estimates: the truth, degraded by the GPS noise, delay, jump and loss of fix that the owner sets.

Attitude, airspeed and climb come from other sensors and are exact.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from companion.mission.random_streams import random_stream
from sim.vehicles.craft import Body
from sim.vehicles.receivers import Receivers

GPS_STREAM = 12
"""Number of the seed's random stream from which the GPS noise is drawn."""
_ACCURACY_M = 0.8
"""Horizontal accuracy in metres that a receiver without noise reports."""
_KNOT_S = 1.0
"""Time between two drawn noise values; the noise is linear in between."""
_CORRELATION_S = 10.0
"""Time constant of the GPS error, a first-order Gauss-Markov process (chosen)."""
_DRIFT_M_S = 1.0
"""Speed at which the estimate drifts away from the truth without a fix (chosen)."""
_DRIFT_ACCURACY_M = 2.0
"""Metres by which the reported accuracy grows per second without a fix."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """The autopilot's estimate of the vehicle at one moment, of which telemetry is made."""

    body: Body
    accuracy_m: float
    """Horizontal accuracy that is reported with the position."""
    has_fix: bool


class Sensors:
    """One vehicle's GPS receivers. The seed determines their errors; the times that are given must not decrease."""

    def __init__(self, seed: int, system_id: int) -> None:
        """Begin without noise or delay and with a fix."""
        self.noise_m = 0.0
        """Standard deviation of the position error, north and east each."""
        self.delay_s = 0.0
        """Age of the reported position and velocity."""
        self.jump_m = (0.0, 0.0)
        """How far (north, east) the estimate is off: a glitch that it has given in to, while the velocity is right."""
        self.glitches = False
        """Whether the estimate says that it rejects what the receivers measure."""
        self.receivers = Receivers()
        self._stream = random_stream(seed, GPS_STREAM, system_id)
        self._knots = self._stream.standard_normal((2, 2))  # (2 knots, north and east) of unit variance
        self._knot = 0
        self._began_s: float | None = None
        self._past: deque[tuple[float, Body]] = deque()
        angle_rad = float(self._stream.uniform(0.0, math.tau))
        self._drift = math.cos(angle_rad), math.sin(angle_rad)

    @property
    def perfect(self) -> bool:
        """Whether the estimate equals the truth: no noise, no delay, no jump, and a fix."""
        moved = self.noise_m != 0.0 or self.delay_s != 0.0 or self.jump_m != (0.0, 0.0)
        return not moved and self.has_fix

    @property
    def has_fix(self) -> bool:
        """Whether any receiver has a fix."""
        return self.receivers.lost_at_s is None

    def remember(self, body: Body, now_s: float) -> None:
        """Keep the vehicle's present state for later delayed estimates."""
        if self.delay_s <= 0.0:
            return
        self._past.append((now_s, replace(body)))
        while len(self._past) > 2 and self._past[1][0] <= now_s - self.delay_s:
            self._past.popleft()

    def estimate(self, body: Body, now_s: float) -> Estimate:
        """Return the autopilot's estimate at `now_s` of the true state `body`."""
        if self.perfect:
            return Estimate(body, _ACCURACY_M, True)
        estimated = replace(body)
        if self.delay_s > 0.0 and self._past:
            old = self._at(now_s - self.delay_s)
            estimated.north_m, estimated.east_m, estimated.altitude_m = old.north_m, old.east_m, old.altitude_m
            estimated.velocity_north_m_s, estimated.velocity_east_m_s = old.velocity_north_m_s, old.velocity_east_m_s
        accuracy_m = max(_ACCURACY_M, self.noise_m * math.sqrt(2.0))
        if self.noise_m > 0.0:
            north, east = self._noise(now_s)
            estimated.north_m += self.noise_m * north
            estimated.east_m += self.noise_m * east
        estimated.north_m += self.jump_m[0]
        estimated.east_m += self.jump_m[1]
        lost_at_s = self.receivers.lost_at_s
        if lost_at_s is not None:
            away_m = _DRIFT_M_S * (now_s - lost_at_s)
            estimated.north_m += away_m * self._drift[0]
            estimated.east_m += away_m * self._drift[1]
            accuracy_m += _DRIFT_ACCURACY_M * (now_s - lost_at_s)
        return Estimate(estimated, accuracy_m, lost_at_s is None)

    def _at(self, t_s: float) -> Body:
        """Return the remembered state at a time, interpolated linearly."""
        for (early_s, early), (late_s, late) in zip(self._past, list(self._past)[1:], strict=False):
            if early_s <= t_s <= late_s and late_s > early_s:
                share = (t_s - early_s) / (late_s - early_s)
                between = replace(early)
                for name in ("north_m", "east_m", "altitude_m", "velocity_north_m_s", "velocity_east_m_s"):
                    first, second = getattr(early, name), getattr(late, name)
                    setattr(between, name, first + share * (second - first))
                return between
        return self._past[0][1] if t_s < self._past[0][0] else self._past[-1][1]

    def _noise(self, now_s: float) -> tuple[float, float]:
        """Return the receiver's error (north, east) in standard deviations, linear between the values drawn."""
        if self._began_s is None:
            self._began_s = now_s
        keep = math.exp(-_KNOT_S / _CORRELATION_S)
        knots = (now_s - self._began_s) / _KNOT_S
        while knots >= self._knot + 1:
            fresh = self._stream.standard_normal(2)
            self._knots = np.array([self._knots[1], keep * self._knots[1] + math.sqrt(1.0 - keep**2) * fresh])
            self._knot += 1
        share = knots - self._knot
        north, east = ((1.0 - share) * self._knots[0] + share * self._knots[1]).tolist()
        return north, east
