"""What the autopilot estimates: the truth, made worse by its satellite receiver as far as its owner asks for.

Attitude, airspeed and climb come from other sensors and stay true.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from companion.mission.random_streams import random_stream
from sim.vehicles.craft import Body

GPS_STREAM = 12
"""The seed's random stream for the receiver's noise."""
_ACCURACY_M = 0.8
"""Said of a receiver without noise."""
_KNOT_S = 1.0
_CORRELATION_S = 10.0
"""A receiver's error wanders: chosen, as a first-order process with this time constant."""
_DRIFT_M_S = 1.0
"""How fast the estimate leaves the truth once there is no fix; chosen."""
_DRIFT_ACCURACY_M = 2.0


@dataclass(frozen=True, slots=True)
class Estimate:
    """What telemetry is made of at one moment."""

    body: Body
    accuracy_m: float
    """Horizontal, as the receiver or the estimator says."""
    has_fix: bool


class Sensors:
    """One vehicle's receiver. Deterministic by its seed; times must not run backwards."""

    def __init__(self, seed: int, system_id: int) -> None:
        """Begin perfect: no noise, no delay, a fix."""
        self.noise_m = 0.0
        """Standard deviation of north and of east."""
        self.delay_s = 0.0
        self._stream = random_stream(seed, GPS_STREAM, system_id)
        self._knots = self._stream.standard_normal((2, 2))  # (2 knots, north and east) of unit variance
        self._knot = 0
        self._began_s: float | None = None
        self._past: deque[tuple[float, Body]] = deque()
        self._lost_at_s: float | None = None
        angle_rad = float(self._stream.uniform(0.0, math.tau))
        self._drift = math.cos(angle_rad), math.sin(angle_rad)

    @property
    def perfect(self) -> bool:
        """Whether telemetry is the truth."""
        return self.noise_m == 0.0 and self.delay_s == 0.0 and self._lost_at_s is None

    def lose_fix(self, lost: bool, now_s: float) -> None:
        """Let the receiver lose its fix, or find it again."""
        if lost != (self._lost_at_s is not None):
            self._lost_at_s = now_s if lost else None

    def remember(self, body: Body, now_s: float) -> None:
        """Note where the vehicle is now, for who asks later."""
        if self.delay_s <= 0.0:
            return
        self._past.append((now_s, replace(body)))
        while len(self._past) > 2 and self._past[1][0] <= now_s - self.delay_s:
            self._past.popleft()

    def estimate(self, body: Body, now_s: float) -> Estimate:
        """Return the autopilot's estimate."""
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
        if self._lost_at_s is not None:
            away_m = _DRIFT_M_S * (now_s - self._lost_at_s)
            estimated.north_m += away_m * self._drift[0]
            estimated.east_m += away_m * self._drift[1]
            accuracy_m += _DRIFT_ACCURACY_M * (now_s - self._lost_at_s)
        return Estimate(estimated, accuracy_m, self._lost_at_s is None)

    def _at(self, t_s: float) -> Body:
        """Return the remembered body at a time, linear in between."""
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
        """Return the receiver's error in standard deviations, linear between knots."""
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
