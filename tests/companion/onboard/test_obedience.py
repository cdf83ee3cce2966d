"""Whether the vehicle obeys: what is measured of it, what is reckoned with, and what becomes of one that does not."""

from __future__ import annotations

import math
import random
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geo.kinematics import GRAVITY_M_S2
from companion.guard.types import Setpoint
from companion.onboard.answer import Rung
from companion.onboard.config import LimitsSection
from companion.onboard.limits import within
from companion.onboard.obedience import (
    NOTHING,
    Expected,
    Measured,
    Obedience,
    Seen,
    in_words,
    watch,
)
from companion.autopilot.adapter import Abilities

COPTER = LimitsSection(speed_m_s=8.0, n_max=0.21, reaction_s=0.2, braking_m_s2=2.0, wind_m_s=3.0)
"""It turns at 15 degrees a second."""
PLANE = LimitsSection(speed_m_s=16.0, n_max=0.5, reaction_s=0.2, wind_m_s=4.0)
LEAD_RAD = math.radians(60.0)
"""Greatest lead of the commanded course over the flown one in these tests."""
NEVER = Setpoint(math.nan, 0.0, 30.0)


@dataclass
class Vehicle:
    """A small stand-in: it obeys each setpoint after a delay, at shares of the rates that it should have."""

    limits: LimitsSection = COPTER
    can_stop: bool = True
    share: float = 1.0
    delay_s: float = 0.2
    acceleration_m_s2: float = 2.0
    braking_m_s2: float = 2.0
    pace: float = 1.0
    """Airspeed over the asked one."""
    deaf: bool = False
    """Whether it ignores every setpoint."""
    airspeed_max_m_s: float = math.inf
    """Airspeed at which it is saturated: then it reaches no more, and does not turn to what is near its course."""
    wind_m_s: tuple[float, float] = (0.0, 0.0)
    course_rad: float = 0.0
    speed_m_s: float = 8.0
    heard: deque[tuple[float, Setpoint]] = field(default_factory=deque)

    def fly(self, setpoint: Setpoint, now_s: float, dt_s: float) -> None:
        """Fly for a time with a new setpoint."""
        self.heard.append((now_s, setpoint))
        for k in range(max(1, round(dt_s / 0.05))):
            self._step(now_s + k * 0.05, min(0.05, dt_s))

    def _step(self, at_s: float, step_s: float) -> None:
        while len(self.heard) > 1 and self.heard[1][0] + self.delay_s <= at_s + 1e-9:
            self.heard.popleft()
        since_s, obeyed = self.heard[0]
        if self.deaf or since_s + self.delay_s > at_s + 1e-9:
            return
        turn_rad = math.remainder(obeyed.heading_rad - self.course_rad, math.tau)
        wanted_m_s = obeyed.speed_m_s * self.pace
        needed_m_s = math.hypot(
            wanted_m_s * math.cos(obeyed.heading_rad) - self.wind_m_s[0],
            wanted_m_s * math.sin(obeyed.heading_rad) - self.wind_m_s[1],
        )
        if needed_m_s > self.airspeed_max_m_s:
            wanted_m_s *= max(0.3, 1.0 - (needed_m_s - self.airspeed_max_m_s) / max(wanted_m_s, 0.1))
            turn_rad = 0.0 if abs(turn_rad) < math.radians(70.0) else turn_rad
        load_m_s2 = self.share * self.limits.n_max * GRAVITY_M_S2
        most_rad = load_m_s2 / max(self.speed_m_s, 0.5) * step_s
        self.course_rad += min(max(turn_rad, -most_rad), most_rad)
        change_m_s = wanted_m_s - self.speed_m_s
        self.speed_m_s += min(max(change_m_s, -self.braking_m_s2 * step_s), self.acceleration_m_s2 * step_s)


@dataclass
class Loop:
    """A vehicle, the monitor, and a command that is walked as guidance and guard walk it."""

    vehicle: Vehicle
    dt_s: float = 0.5
    noise_m_s: float = 0.0
    tells_wind: bool = False
    told_airspeed_max_m_s: float = math.inf
    now_s: float = 1000.0
    state: Obedience = Obedience()
    setpoint: Setpoint | None = None
    random: random.Random = field(default_factory=lambda: random.Random(1))

    @property
    def expected(self) -> Expected:
        return Expected(self.vehicle.limits, self.vehicle.can_stop, self.told_airspeed_max_m_s, self.dt_s)

    def seen(self, **changes: Any) -> Seen:
        vehicle = self.vehicle
        off = [self.random.gauss(0.0, self.noise_m_s) if self.noise_m_s else 0.0 for _ in range(2)]
        north_m_s = vehicle.speed_m_s * math.cos(vehicle.course_rad) + off[0]
        east_m_s = vehicle.speed_m_s * math.sin(vehicle.course_rad) + off[1]
        air_m_s = (north_m_s - vehicle.wind_m_s[0], east_m_s - vehicle.wind_m_s[1])
        return Seen(
            at_s=self.now_s,
            course_rad=math.atan2(east_m_s, north_m_s),
            speed_m_s=math.hypot(north_m_s, east_m_s),
            asked=self.setpoint,
            yaw_rad=math.atan2(air_m_s[1], air_m_s[0]),
            airspeed_m_s=math.nan if vehicle.can_stop else math.hypot(*air_m_s),
            wind_ned_m_s=vehicle.wind_m_s if self.tells_wind else None,
        )._replace(**changes)

    def step(self, wanted_rad: float, speed_m_s: float | None = None, **changes: Any) -> Obedience:
        """Let the monitor look, walk the command towards a course, and fly one step."""
        vehicle = self.vehicle
        self.state = watch(self.state, self.seen(**changes), self.expected)
        limits = within(vehicle.limits, Abilities(), self.state.worse)
        asked_m_s = min(limits.speed_m_s, vehicle.limits.speed_m_s if speed_m_s is None else speed_m_s)
        asked_m_s *= self.state.answer.speed_share if vehicle.can_stop else 1.0
        before_rad = vehicle.course_rad if self.setpoint is None else self.setpoint.heading_rad
        most_rad = limits.n_max * GRAVITY_M_S2 / max(vehicle.speed_m_s, asked_m_s, 0.5) * self.dt_s
        turn_rad = math.remainder(wanted_rad - before_rad, math.tau)
        heading_rad = before_rad + min(max(turn_rad, -most_rad), most_rad)
        lead_rad = math.remainder(heading_rad - vehicle.course_rad, math.tau)
        heading_rad = vehicle.course_rad + min(max(lead_rad, -LEAD_RAD), LEAD_RAD)
        self.setpoint = Setpoint(heading_rad, asked_m_s, 30.0)
        vehicle.fly(self.setpoint, self.now_s, self.dt_s)
        self.now_s += self.dt_s
        return self.state

    def fly(self, wanted_rad: float, duration_s: float, speed_m_s: float | None = None) -> Obedience:
        for _ in range(round(duration_s / self.dt_s)):
            self.step(wanted_rad, speed_m_s)
        return self.state

    def zigzag(self, duration_s: float, leg_s: float = 10.0) -> Obedience:
        """Fly legs with turns of a right angle between them."""
        for leg in range(math.ceil(duration_s / leg_s)):
            self.fly((leg % 2) * math.pi / 2.0, leg_s)
        return self.state
