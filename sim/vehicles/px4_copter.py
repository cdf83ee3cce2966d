"""A copter with PX4: its response to OFFBOARD setpoints, and what it does when they stop.

As measured on PX4 v1.16.1 with realistic drag (docs/autopilots.md). "(code)" marks what was read in its source,
"(chosen)" what was neither measured nor read.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import common as mavlink

from companion.geo.kinematics import GRAVITY_M_S2, shorter_turn_rad
from sim.vehicles import px4
from sim.vehicles.craft import Parameter, Start, Surroundings
from sim.vehicles.px4 import Offboard, Px4
from sim.vehicles.setpoint import clip, rotated

# These five are fitted to the measured steps from 0 to 5 m/s (3.9 m/s after 1 s, 5.1 after 2 s), from 0 to 10 m/s (6.3,
# 9.4 and 9.95 m/s after 1, 2 and 3 s) and from 10 m/s to 0 (3.0 and 0.4 m/s after 1 and 2 s) within 0.25 m/s, and to
# the first motion after 0.2 s.
_REACTION_S = 0.1
_VELOCITY_GAIN_1_S = 1.481
_ACCELERATION_LAG_S = 0.103
_ACCELERATION_M_S2 = 8.155
_DRAG_1_M = 0.0228

_SINK_WITHOUT_STICK_M_S = 0.7
"""Sink rate in POSITION, the mode that COM_OBL_RC_ACT 0 chooses, without radio control."""
_POSITION_GAIN_1_S = 0.95
"""Gain from a position error to a velocity: MPC_XY_P (code, default)."""
_ALTITUDE_GAIN_1_S = 1.0
"""Gain from an altitude error to a climb rate: MPC_Z_P (code, default)."""
_VERTICAL_LAG_S = 0.5
"""Time constant with which the climb rate follows its demand (chosen)."""
_BRAKING_M_S2 = 5.0
"""Deceleration in HOLD: from 10 m/s the copter stops in 3 s, as measured."""
_LAND_FINAL_M, _RETURN_ARRIVED_M = 10.0, 1.0
"""Height above home below which a landing slows down; distance within which RETURN has reached home, or its height."""
_TAKE_OFF_DONE_M = 0.1
"""Height below the take-off altitude at which a take-off is complete."""
_STOPPED_M_S = 0.3
"""Speed below which a braking copter counts as stopped and holds its place."""
_STEP_S = 0.05
"""Longest step of the motion."""

_PARAMETERS = (
    *px4.COMMON_PARAMETERS,
    Parameter("MIS_TAKEOFF_ALT", 2.5, 0.0, 1000.0),
    Parameter("MPC_ACC_DOWN_MAX", 3.0, 2.0, 15.0),
    Parameter("MPC_ACC_HOR", 3.0, 2.0, 15.0),
    Parameter("MPC_ACC_HOR_MAX", 5.0, 2.0, 15.0),
    Parameter("MPC_ACC_UP_MAX", 4.0, 2.0, 15.0),
    Parameter("MPC_JERK_AUTO", 4.0, 1.0, 80.0),
    Parameter("MPC_JERK_MAX", 8.0, 0.5, 500.0),
    Parameter("MPC_LAND_SPEED", 0.7, 0.6, 20.0),
    Parameter("MPC_TILTMAX_AIR", 45.0, 20.0, 89.0),
    Parameter("MPC_TKO_SPEED", 1.5, 1.0, 5.0),
    Parameter("MPC_XY_CRUISE", 5.0, 3.0, 20.0),
    Parameter("MPC_XY_VEL_MAX", 12.0, 0.0, 20.0),
    Parameter("MPC_YAWRAUTO_MAX", 60.0, 5.0, 360.0),
    Parameter("MPC_Z_VEL_MAX_DN", 1.5, 0.5, 4.0),
    Parameter("MPC_Z_VEL_MAX_UP", 3.0, 0.5, 8.0),
    Parameter("RTL_DESCEND_ALT", 30.0, 0.0, 100.0),
    Parameter("RTL_RETURN_ALT", 60.0, 0.0, 150.0),
)


class Px4Copter(Px4):
    """A quadrotor with PX4: it leans to reach the velocity over the ground that its mode demands, against the drag."""

    kind = "px4-copter"
    mav_type = mavlink.MAV_TYPE_QUADROTOR
    longest_step_s = _STEP_S
    reaction_s = _REACTION_S
    parameters = _PARAMETERS

    def __init__(self, start: Start) -> None:
        """Begin on the ground, or flying with the velocity of `start`."""
        super().__init__(start)
        self._acceleration_m_s2 = (0.0, 0.0)
        self._wanted_m_s = (start.body.velocity_north_m_s, start.body.velocity_east_m_s)
        self._stopped_at_m: tuple[float, float] | None = None
        self._has_climbed = False
        """Whether RETURN has climbed to the height at which it flies home."""

    def blow(self, wind_m_s: tuple[float, float]) -> None:
        """Change nothing at once: the velocity over the ground changes only as the drag acts."""

    def step(self, now_s: float, dt_s: float, around: Surroundings) -> None:
        """Advance by `dt_s` as the mode demands."""
        self._mind_time(now_s)
        body = self.body
        if not self.in_air and not (self.armed and self._wants_up(around)):
            return
        if not self.armed:
            self._move(body.velocity_north_m_s, body.velocity_east_m_s, body.climb_m_s - GRAVITY_M_S2 * dt_s, dt_s)
        else:
            self._fly(dt_s, around)
        body.airspeed_m_s = math.hypot(
            body.velocity_north_m_s - around.wind_m_s[0], body.velocity_east_m_s - around.wind_m_s[1]
        )
        if body.altitude_m > around.home.altitude_m:
            self.in_air = True
        elif body.climb_m_s <= 0.0:
            self._touch_down(around.home)
            self._acceleration_m_s2 = self._wanted_m_s = (0.0, 0.0)

    def _wants_up(self, around: Surroundings) -> bool:
        if self.mode == px4.TAKE_OFF:
            return True
        asked = self._stream.asked
        if self.mode != px4.OFFBOARD or asked is None:
            return False
        return (asked.climb_m_s or 0.0) > 0.0 or (asked.altitude_m or -math.inf) > around.home.altitude_m

    def _fly(self, dt_s: float, around: Surroundings) -> None:
        if self.mode in px4.STICK_MODES:
            # Without radio control it flies level, and drag alone changes its velocity.
            wanted_m_s2 = 0.0, 0.0
            climb_m_s = -_SINK_WITHOUT_STICK_M_S if self.mode == px4.POSITION else 0.0
        else:
            (north_m_s, east_m_s), climb_m_s = self._wanted(around, dt_s)
            wanted_m_s2 = self._leaning(north_m_s, east_m_s, around.wind_m_s)
        self._turn_nose(dt_s)
        share = -math.expm1(-dt_s / _ACCELERATION_LAG_S)
        pull_north, pull_east = self._acceleration_m_s2
        pull_north += (wanted_m_s2[0] - pull_north) * share
        pull_east += (wanted_m_s2[1] - pull_east) * share
        self._acceleration_m_s2 = pull_north, pull_east
        body = self.body
        drag_north, drag_east = _drag(body.velocity_north_m_s, body.velocity_east_m_s, around.wind_m_s)
        body.roll_rad = math.atan2(rotated(pull_north, pull_east, -body.heading_rad)[1], GRAVITY_M_S2)
        rising_m_s = body.climb_m_s + (climb_m_s - body.climb_m_s) * -math.expm1(-dt_s / _VERTICAL_LAG_S)
        self._move(
            body.velocity_north_m_s + (pull_north - drag_north) * dt_s,
            body.velocity_east_m_s + (pull_east - drag_east) * dt_s,
            rising_m_s,
            dt_s,
        )

    def _leaning(self, north_m_s: float, east_m_s: float, wind_m_s: tuple[float, float]) -> tuple[float, float]:
        """Return the acceleration (north, east; m/s^2) towards a velocity, with the drag at that velocity added."""
        body = self.body
        drag_north, drag_east = _drag(north_m_s, east_m_s, wind_m_s)
        pull_north = _VELOCITY_GAIN_1_S * (north_m_s - body.velocity_north_m_s) + drag_north
        pull_east = _VELOCITY_GAIN_1_S * (east_m_s - body.velocity_east_m_s) + drag_east
        return _within(pull_north, pull_east, min(_ACCELERATION_M_S2, self._tilt_m_s2()))

    def _tilt_m_s2(self) -> float:
        return GRAVITY_M_S2 * math.tan(math.radians(self.values["MPC_TILTMAX_AIR"]))

    def _wanted(self, around: Surroundings, dt_s: float) -> tuple[tuple[float, float], float]:
        """Return the velocity over the ground (north, east) and the climb rate that the mode demands, in m/s."""
        home, body, mode = around.home, self.body, self.mode
        height_m = body.altitude_m - home.altitude_m
        if mode == px4.OFFBOARD:
            return self._asked_velocity()
        if mode == px4.TAKE_OFF:
            if self._hold.place.altitude_m - body.altitude_m <= _TAKE_OFF_DONE_M:
                altitude_m = self._hold.place.altitude_m
                self._intended = px4.HOLD
                self._fly_mode(px4.HOLD)
                self._hold.place = px4.Reposition(self._hold.place.north_m, self._hold.place.east_m, altitude_m)
            climb_m_s = self._climb_towards_m_s(self._hold.place.altitude_m)
            return self._halting(dt_s), min(climb_m_s, self.values["MPC_TKO_SPEED"])
        if mode == px4.LAND:
            return self._halting(dt_s), self._landing_climb_m_s(height_m)
        if mode == px4.RETURN:
            return self._returning(around, dt_s, height_m)
        if not self._hold.is_repositioned:
            return self._halting(dt_s), self._climb_towards_m_s(self._hold.place.altitude_m)
        speed_m_s = self._hold.speed_m_s or self.values["MPC_XY_CRUISE"]
        velocity = self._towards(self._hold.place.north_m, self._hold.place.east_m, speed_m_s, dt_s)
        return velocity, self._climb_towards_m_s(self._hold.place.altitude_m)

    def _fly_mode(self, mode: int) -> None:
        super()._fly_mode(mode)
        self._wanted_m_s = self.body.velocity_north_m_s, self.body.velocity_east_m_s
        self._stopped_at_m = None
        self._has_climbed = False

    def _asked_velocity(self) -> tuple[tuple[float, float], float]:
        """Return the newest setpoint's velocity and climb rate, 0 unless it has a horizontal and a vertical part."""
        asked = self._stream.asked
        if asked is None:
            return (0.0, 0.0), 0.0
        horizontal, climb_m_s = self._asked_horizontal(asked), asked.climb_m_s
        if asked.altitude_m is not None:
            climb_m_s = (climb_m_s or 0.0) + self._climb_towards_m_s(asked.altitude_m)
        if horizontal is None or climb_m_s is None:
            return (0.0, 0.0), 0.0
        return _within(*horizontal, self.values["MPC_XY_VEL_MAX"]), self._climb_within(climb_m_s)

    def _asked_horizontal(self, asked: Offboard) -> tuple[float, float] | None:
        """Return the velocity (north, east) for a setpoint's position, velocity or both; None if it has neither."""
        if asked.north_m is None or asked.east_m is None:
            return asked.velocity_m_s
        ahead_m_s = asked.velocity_m_s or (0.0, 0.0)
        return (
            ahead_m_s[0] + _POSITION_GAIN_1_S * (asked.north_m - self.body.north_m),
            ahead_m_s[1] + _POSITION_GAIN_1_S * (asked.east_m - self.body.east_m),
        )

    def _halting(self, dt_s: float) -> tuple[float, float]:
        """Return a velocity that falls evenly to 0, and then the one that holds the place of the stop."""
        if self._stopped_at_m is not None:
            north_m, east_m = self._stopped_at_m
            return (
                _POSITION_GAIN_1_S * (north_m - self.body.north_m),
                _POSITION_GAIN_1_S * (east_m - self.body.east_m),
            )
        speed_m_s = math.hypot(*self._wanted_m_s)
        less_m_s = _BRAKING_M_S2 * dt_s
        share = max(1.0 - less_m_s / speed_m_s, 0.0) if speed_m_s else 0.0
        self._wanted_m_s = self._wanted_m_s[0] * share, self._wanted_m_s[1] * share
        if not share and math.hypot(self.body.velocity_north_m_s, self.body.velocity_east_m_s) < _STOPPED_M_S:
            self._stopped_at_m = self.body.north_m, self.body.east_m
        return self._wanted_m_s

    def _towards(self, north_m: float, east_m: float, top_m_s: float, dt_s: float) -> tuple[float, float]:
        """Return the velocity towards a place, from which the copter can still stop there, limited in acceleration."""
        away_north_m, away_east_m = north_m - self.body.north_m, east_m - self.body.east_m
        distance_m = math.hypot(away_north_m, away_east_m)
        braking_m_s2 = self.values["MPC_ACC_HOR"]
        speed_m_s = min(top_m_s, _POSITION_GAIN_1_S * distance_m, math.sqrt(2.0 * braking_m_s2 * distance_m))
        share_1_s = speed_m_s / distance_m if distance_m else 0.0
        change = _within(
            away_north_m * share_1_s - self._wanted_m_s[0],
            away_east_m * share_1_s - self._wanted_m_s[1],
            braking_m_s2 * dt_s,
        )
        self._wanted_m_s = self._wanted_m_s[0] + change[0], self._wanted_m_s[1] + change[1]
        return self._wanted_m_s

    def _returning(self, around: Surroundings, dt_s: float, height_m: float) -> tuple[tuple[float, float], float]:
        """Return the velocity and climb rate of RETURN: up, home, down (code: no cone, no delay before landing)."""
        home, body = around.home, self.body
        if math.hypot(home.north_m - body.north_m, home.east_m - body.east_m) <= _RETURN_ARRIVED_M:
            return self._towards(home.north_m, home.east_m, 1.0, dt_s), self._landing_climb_m_s(height_m)
        return_m = max(self.values["RTL_RETURN_ALT"], self._hold.place.altitude_m - home.altitude_m)
        self._has_climbed |= height_m >= return_m - _RETURN_ARRIVED_M
        if not self._has_climbed:
            return self._halting(dt_s), self._climb_towards_m_s(home.altitude_m + return_m)
        velocity = self._towards(home.north_m, home.east_m, self.values["MPC_XY_CRUISE"], dt_s)
        return velocity, self._climb_towards_m_s(home.altitude_m + return_m)

    def _landing_climb_m_s(self, height_m: float) -> float:
        return -self.values["MPC_Z_VEL_MAX_DN" if height_m > _LAND_FINAL_M else "MPC_LAND_SPEED"]

    def _climb_towards_m_s(self, altitude_m: float) -> float:
        return self._climb_within(_ALTITUDE_GAIN_1_S * (altitude_m - self.body.altitude_m))

    def _climb_within(self, climb_m_s: float) -> float:
        return clip(climb_m_s, -self.values["MPC_Z_VEL_MAX_DN"], self.values["MPC_Z_VEL_MAX_UP"])

    def _turn_nose(self, dt_s: float) -> None:
        """Turn the nose to the yaw, else at the yaw rate, of the OFFBOARD setpoint; otherwise leave it."""
        asked = self._stream.asked if self.mode == px4.OFFBOARD else None
        limit_rad = math.radians(self.values["MPC_YAWRAUTO_MAX"]) * dt_s
        turn_rad = 0.0
        if asked is not None and asked.yaw_rad is not None:
            turn_rad = clip(shorter_turn_rad(self.body.heading_rad, asked.yaw_rad), -limit_rad, limit_rad)
        elif asked is not None and asked.yaw_rate_rad_s is not None:
            turn_rad = clip(asked.yaw_rate_rad_s * dt_s, -limit_rad, limit_rad)
        self.body.heading_rad = math.remainder(self.body.heading_rad + turn_rad, math.tau)
        self.body.turn_rate_rad_s = turn_rad / dt_s

    def _move(self, north_m_s: float, east_m_s: float, climb_m_s: float, dt_s: float) -> None:
        body = self.body
        body.north_m += 0.5 * (body.velocity_north_m_s + north_m_s) * dt_s
        body.east_m += 0.5 * (body.velocity_east_m_s + east_m_s) * dt_s
        body.altitude_m += climb_m_s * dt_s
        body.velocity_north_m_s, body.velocity_east_m_s, body.climb_m_s = north_m_s, east_m_s, climb_m_s


def _drag(north_m_s: float, east_m_s: float, wind_m_s: tuple[float, float]) -> tuple[float, float]:
    """Return the acceleration (north, east; m/s^2) that balances the drag at a velocity over the ground."""
    air_north_m_s, air_east_m_s = north_m_s - wind_m_s[0], east_m_s - wind_m_s[1]
    share_1_s = _DRAG_1_M * math.hypot(air_north_m_s, air_east_m_s)
    return air_north_m_s * share_1_s, air_east_m_s * share_1_s


def _within(north: float, east: float, greatest: float) -> tuple[float, float]:
    """Return a horizontal vector (north, east), shortened to the length `greatest` if it is longer."""
    length = math.hypot(north, east)
    share = greatest / length if length > greatest else 1.0
    return north * share, east * share
