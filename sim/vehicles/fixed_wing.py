"""How a plane moves: bank, airspeed and climb follow their demands with lags, the bank makes the turn, the wind drifts.

The ArduPlane and the PX4 plane share it; they differ in the bank, airspeed and climb that they demand. Not modelled:
pitch, throttle, angle of attack, the speed lost in a turn, and damage when the plane flies into the ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.geo.air_density import true_per_indicated
from companion.geo.kinematics import GRAVITY_M_S2, advance
from sim.vehicles.craft import Body
from sim.vehicles.setpoint import followed_share


@dataclass(frozen=True, slots=True)
class Airframe:
    """How an airframe with its inner control loops responds."""

    roll_lag_s: float
    """Time constant with which the bank follows its demand."""
    roll_rate_rad_s: float
    """Greatest roll rate."""
    turn_share: float
    """Sustained turn rate as a share of g tan(bank) / V, the rate of a level coordinated turn."""
    acceleration_m_s2: float
    """Greatest rate of change of the airspeed."""
    airspeed_lag_s: float
    """Time constant with which the airspeed follows its demand."""
    climb_lag_s: float
    """Time constant with which the climb rate follows its demand."""


class FixedWing:
    """Moves a `Body` through the air; its velocity over the ground is that through the air plus the wind."""

    def __init__(self, airframe: Airframe, body: Body) -> None:
        """Move `body`, in place, as `airframe` responds; the body's airspeed is along its heading."""
        self.airframe = airframe
        self.body = body

    def fly(
        self, bank_rad: float, indicated_m_s: float, climb_m_s: float, wind_m_s: tuple[float, float], dt_s: float
    ) -> None:
        """Advance by `dt_s` towards a demanded bank, indicated airspeed (positive) and climb, in a wind (grid)."""
        airframe, body = self.airframe, self.body
        airspeed_m_s = indicated_m_s * true_per_indicated(body.altitude_m)
        roll_rad = (bank_rad - body.roll_rad) * followed_share(dt_s, airframe.roll_lag_s)
        limit_rad = airframe.roll_rate_rad_s * dt_s
        roll_rad = body.roll_rad + min(max(roll_rad, -limit_rad), limit_rad)
        faster_m_s = (airspeed_m_s - body.airspeed_m_s) * followed_share(dt_s, airframe.airspeed_lag_s)
        limit_m_s = airframe.acceleration_m_s2 * dt_s
        speed_m_s = body.airspeed_m_s + min(max(faster_m_s, -limit_m_s), limit_m_s)
        rising_m_s = body.climb_m_s + (climb_m_s - body.climb_m_s) * followed_share(dt_s, airframe.climb_lag_s)
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
        """Return the turn rate that a bank sustains at an airspeed."""
        return self.airframe.turn_share * GRAVITY_M_S2 * math.tan(bank_rad) / airspeed_m_s

    def bank_rad(self, turn_rate_rad_s: float, airspeed_m_s: float) -> float:
        """Return the bank that sustains a turn rate at an airspeed."""
        return math.atan(turn_rate_rad_s * airspeed_m_s / (self.airframe.turn_share * GRAVITY_M_S2))

    def blow(self, wind_m_s: tuple[float, float]) -> None:
        """Set the velocity over the ground to that through the air plus the wind."""
        body = self.body
        body.velocity_north_m_s = body.airspeed_m_s * math.cos(body.heading_rad) + wind_m_s[0]
        body.velocity_east_m_s = body.airspeed_m_s * math.sin(body.heading_rad) + wind_m_s[1]

    def course_rad(self) -> float:
        """Return the course over the ground, from grid north; below a ground speed of 1 m/s return the heading."""
        body = self.body
        if math.hypot(body.velocity_north_m_s, body.velocity_east_m_s) < 1.0:
            return body.heading_rad
        return math.atan2(body.velocity_east_m_s, body.velocity_north_m_s)


def climb_towards_m_s(away_m: float, gain_1_s: float, climb_m_s: float, sink_m_s: float) -> float:
    """Return the climb rate that removes an altitude error `away_m`.

    It is proportional to the error, and at most `climb_m_s` up and `sink_m_s` (positive) down.
    """
    return min(max(gain_1_s * away_m, -sink_m_s), climb_m_s)


def loiter_course_rad(north_m: float, east_m: float, radius_m: float, right: bool) -> float:
    """Return the course (from grid north) onto a circle about a point (north, east) metres away from the vehicle.

    From far away it leads towards the centre, on the circle along the tangent, from within outwards. `right` means
    clockwise.
    """
    outside = (math.hypot(north_m, east_m) - radius_m) / radius_m
    away_rad = math.pi / 2.0 - math.atan(outside)
    return math.atan2(east_m, north_m) - (away_rad if right else -away_rad)
