"""How a plane moves: bank with a lag, a turn that the bank makes, airspeed and climb with lags, wind that carries it.

Shared by the ArduPlane and PX4 planes, whose autopilots differ in what they ask of it. What is not modelled: pitch,
throttle, angle of attack, the speed lost in a turn, and what the ground does to a plane that flies into it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.geo.kinematics import GRAVITY_M_S2, advance
from sim.vehicles.craft import Body


@dataclass(frozen=True, slots=True)
class Airframe:
    """What one airframe with its inner loops does."""

    roll_lag_s: float
    """Time constant of the bank."""
    roll_rate_rad_s: float
    """Greatest rate of roll."""
    turn_share: float
    """The turn rate it sustains as a share of g tan(bank) / V, that of a level coordinated turn."""
    acceleration_m_s2: float
    """Greatest change of airspeed."""
    airspeed_lag_s: float
    climb_lag_s: float


class FixedWing:
    """Moves a body that flies through the air. The body's velocity over the ground follows from it and the wind."""

    def __init__(self, airframe: Airframe, body: Body) -> None:
        """Take the body as it is; its airspeed is along its heading."""
        self.airframe = airframe
        self.body = body

    def fly(
        self, bank_rad: float, airspeed_m_s: float, climb_m_s: float, wind_m_s: tuple[float, float], dt_s: float
    ) -> None:
        """Advance by `dt_s` towards a bank, an airspeed (positive) and a climb, in a wind along the grid."""
        airframe, body = self.airframe, self.body
        roll_rad = (bank_rad - body.roll_rad) * _share(dt_s, airframe.roll_lag_s)
        limit_rad = airframe.roll_rate_rad_s * dt_s
        roll_rad = body.roll_rad + min(max(roll_rad, -limit_rad), limit_rad)
        faster_m_s = (airspeed_m_s - body.airspeed_m_s) * _share(dt_s, airframe.airspeed_lag_s)
        limit_m_s = airframe.acceleration_m_s2 * dt_s
        speed_m_s = body.airspeed_m_s + min(max(faster_m_s, -limit_m_s), limit_m_s)
        rising_m_s = body.climb_m_s + (climb_m_s - body.climb_m_s) * _share(dt_s, airframe.climb_lag_s)
        rate_rad_s = self.turn_rate_rad_s(0.5 * (body.roll_rad + roll_rad), 0.5 * (body.airspeed_m_s + speed_m_s))
        north_m, east_m, heading_rad = advance(
            body.north_m, body.east_m, body.heading_rad, 0.5 * (body.airspeed_m_s + speed_m_s), rate_rad_s, dt_s
        )
        body.north_m = north_m + wind_m_s[0] * dt_s
        body.east_m = east_m + wind_m_s[1] * dt_s
        body.altitude_m += 0.5 * (body.climb_m_s + rising_m_s) * dt_s
        body.heading_rad, body.roll_rad, body.airspeed_m_s = heading_rad, roll_rad, speed_m_s
        body.climb_m_s, body.turn_rate_rad_s = rising_m_s, rate_rad_s
        self.blow(wind_m_s)

    def turn_rate_rad_s(self, bank_rad: float, airspeed_m_s: float) -> float:
        """Return the turn rate that a bank sustains."""
        return self.airframe.turn_share * GRAVITY_M_S2 * math.tan(bank_rad) / airspeed_m_s

    def bank_rad(self, turn_rate_rad_s: float, airspeed_m_s: float) -> float:
        """Return the bank that sustains a turn rate."""
        return math.atan(turn_rate_rad_s * airspeed_m_s / (self.airframe.turn_share * GRAVITY_M_S2))

    def blow(self, wind_m_s: tuple[float, float]) -> None:
        """Let the velocity over the ground be the one through the air and the wind's."""
        body = self.body
        body.velocity_north_m_s = body.airspeed_m_s * math.cos(body.heading_rad) + wind_m_s[0]
        body.velocity_east_m_s = body.airspeed_m_s * math.sin(body.heading_rad) + wind_m_s[1]

    def course_rad(self) -> float:
        """Return where it moves to over the ground, from grid north; its heading where it hardly moves."""
        body = self.body
        if math.hypot(body.velocity_north_m_s, body.velocity_east_m_s) < 1.0:
            return body.heading_rad
        return math.atan2(body.velocity_east_m_s, body.velocity_north_m_s)


def climb_towards_m_s(away_m: float, gain_1_s: float, climb_m_s: float, sink_m_s: float) -> float:
    """Return the climb that takes an altitude error away: proportional to it, within the greatest climb and sink."""
    return min(max(gain_1_s * away_m, -sink_m_s), climb_m_s)


def loiter_course_rad(north_m: float, east_m: float, radius_m: float, right: bool) -> float:
    """Return the course (from grid north) onto a circle about a point that lies (north, east) metres away.

    From afar towards the circle's near side, on the circle along it, from within outwards again.
    """
    outside = (math.hypot(north_m, east_m) - radius_m) / radius_m
    away_rad = math.pi / 2.0 - math.atan(outside)
    return math.atan2(east_m, north_m) - (away_rad if right else -away_rad)


def _share(dt_s: float, lag_s: float) -> float:
    return -math.expm1(-dt_s / lag_s)
