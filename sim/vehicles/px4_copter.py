"""A copter with PX4: its response to OFFBOARD setpoints, and what it does when they stop.

As measured on PX4 v1.16.1 in its simulator SIH (docs/autopilots.md). "(code)" marks what was read in its source,
"(chosen)" what was neither measured nor read. The parameter SIH_KDV is the airframe's drag: 0.2 is that of a copter of
this size, 1 is what the simulator comes with, and makes the copter turn and stop sluggishly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from companion.geo.kinematics import GRAVITY_M_S2, shorter_turn_rad
from sim.vehicles import px4
from sim.vehicles.craft import Parameter, Start, Surroundings
from sim.vehicles.px4 import Offboard, Px4
from sim.vehicles.px4_control import Px4Control
from sim.vehicles.setpoint import clip, followed_share, rotated

_REACTION_S = 0.1
"""Dead time of a setpoint. With it, SIH_KDV 0.2 and the controller's own gains the measured steps (0 to 5 m/s, 0 to 10
m/s and back) hold within 0.2 m/s."""
_SINK_WITHOUT_STICK_M_S = 0.7
"""Sink rate in POSITION, the mode that COM_OBL_RC_ACT 0 chooses, without radio control."""
_POSITION_GAIN_1_S = 0.95
"""Gain from a position error to a velocity: MPC_XY_P (code, default)."""
_ALTITUDE_GAIN_1_S = 1.0
"""Gain from an altitude error to a climb rate: MPC_Z_P (code, default)."""
_VERTICAL_LAG_S = 0.5
"""Time constant with which the climb rate follows its demand (chosen)."""
_STOP_DELAY_S = 0.6
"""Time by which the place of a stop is further ahead than braking at MPC_ACC_HOR needs (code)."""
_LAND_FINAL_M, _RETURN_ARRIVED_M = 10.0, 1.0
"""Height above home below which a landing slows down; distance within which RETURN has reached home, or its height."""
_TAKE_OFF_DONE_M = 0.1
"""Height below the take-off altitude at which a take-off is complete."""
_STEP_S = 0.05
"""Longest step of the motion."""
_BLIND_AFTER_S, _SEES_AFTER_S = 6.0, 3.0
"""Time without a GPS fix after which it lands, and with one again after which it goes back to its mode (measured)."""
_CONTROL_STEPS = 2
"""Number of turns of the velocity controller in each step of the motion."""

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
    Parameter("SIH_KDV", 0.2, 0.0, 10.0),
    Parameter("SIH_MASS", 1.0, 0.1, 100.0),
)


class _Fix(NamedTuple):
    """Whether there is a GPS fix, and since when."""

    is_there: bool = True
    since_s: float = -math.inf


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
        self._control: Px4Control | None = None
        """The velocity controller; None until the first step in the air, and on the ground."""
        self._wanted_m_s = (start.body.velocity_north_m_s, start.body.velocity_east_m_s)
        self._stop_m: tuple[float, float] | None = None
        """Place at which a stop ends; None: no stop is under way."""
        self._fix = _Fix()
        self._has_climbed = False
        """Whether RETURN has climbed to the height at which it flies home."""

    def watch(self, now_s: float, has_fix: bool, battery_v: float, around: Surroundings) -> None:
        """Note since when there is a GPS fix, or none."""
        if has_fix != self._fix.is_there:
            # A gap that was too short to blind it leaves nothing to wait for.
            was_blind = self._is_blind(now_s)
            self._fix = _Fix(has_fix, now_s if was_blind or not has_fix else -math.inf)

    def _is_blind(self, now_s: float) -> bool:
        elapsed_s = now_s - self._fix.since_s
        return elapsed_s < _SEES_AFTER_S if self._fix.is_there else elapsed_s >= _BLIND_AFTER_S

    def blow(self, wind_m_s: tuple[float, float]) -> None:
        """Change nothing at once: the velocity over the ground changes only as the drag acts."""

    def step(self, now_s: float, dt_s: float, around: Surroundings) -> None:
        """Advance by `dt_s` as the mode demands."""
        self._mind_time(now_s)
        body = self.body
        if not self.in_air and not (self.armed and self._wants_up(around)):
            return
        if not self.armed:
            velocity_m_s = complex(body.velocity_north_m_s, body.velocity_east_m_s)
            self._move(velocity_m_s * dt_s, velocity_m_s, body.climb_m_s - GRAVITY_M_S2 * dt_s, dt_s)
        else:
            self._fly(dt_s, around)
        body.airspeed_m_s = math.hypot(
            body.velocity_north_m_s - around.wind_m_s[0], body.velocity_east_m_s - around.wind_m_s[1]
        )
        if body.altitude_m > around.ground_m:
            self.in_air = True
        elif body.climb_m_s <= 0.0:
            self._touch_down(around.ground_m)
            self._control = None
            self._wanted_m_s = (0.0, 0.0)

    def _wants_up(self, around: Surroundings) -> bool:
        if self.mode == px4.TAKE_OFF:
            return True
        asked = self._stream.asked
        if self.mode != px4.OFFBOARD or asked is None:
            return False
        return (asked.climb_m_s or 0.0) > 0.0 or (asked.altitude_m or -math.inf) > around.ground_m

    def _fly(self, dt_s: float, around: Surroundings) -> None:
        velocity, wind = complex(self.body.velocity_north_m_s, self.body.velocity_east_m_s), complex(*around.wind_m_s)
        drag_1_s = self.values["SIH_KDV"] / self.values["SIH_MASS"]
        if self._control is None:
            self._control = Px4Control((velocity - wind) * drag_1_s)
        before, asked = self._wanted_m_s, None
        if self.mode in px4.STICK_MODES:
            # Without radio control it flies level, and drag alone changes its velocity.
            climb_m_s = -_SINK_WITHOUT_STICK_M_S if self.mode == px4.POSITION else 0.0
        else:
            velocity_m_s, climb_m_s = self._wanted(around, dt_s)
            asked = complex(*velocity_m_s)
        ahead = complex(self._wanted_m_s[0] - before[0], self._wanted_m_s[1] - before[1]) / dt_s
        self._turn_nose(dt_s)
        part_s, moved = dt_s / _CONTROL_STEPS, 0j
        for _ in range(_CONTROL_STEPS):
            demand = 0j
            if asked is not None:
                demand = self._control.demand(asked - velocity, ahead, self._tilt_m_s2(), part_s)
            after = self._control.lean(demand, velocity, (velocity - wind) * drag_1_s, part_s)
            moved += 0.5 * (velocity + after) * part_s
            velocity = after
        pull = self._control.lean_m_s2
        self.body.roll_rad = math.atan2(rotated(pull.real, pull.imag, -self.body.heading_rad)[1], GRAVITY_M_S2)
        rising_m_s = self.body.climb_m_s + (climb_m_s - self.body.climb_m_s) * followed_share(dt_s, _VERTICAL_LAG_S)
        self._move(moved, velocity, rising_m_s, dt_s)

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
        self._stop_m = None
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
        """Return the velocity towards the place of a stop, which is as far ahead as braking takes."""
        body = self.body
        north_m_s, east_m_s = body.velocity_north_m_s, body.velocity_east_m_s
        if self._stop_m is None:
            ahead_s = 0.5 * math.hypot(north_m_s, east_m_s) / self.values["MPC_ACC_HOR"] + _STOP_DELAY_S
            self._stop_m = body.north_m + north_m_s * ahead_s, body.east_m + east_m_s * ahead_s
        return self._towards(*self._stop_m, self.values["MPC_XY_VEL_MAX"], dt_s)

    def _towards(self, north_m: float, east_m: float, top_m_s: float, dt_s: float) -> tuple[float, float]:
        """Return the velocity towards a place, from which the copter can still stop there, limited in acceleration."""
        away_north_m, away_east_m = north_m - self.body.north_m, east_m - self.body.east_m
        distance_m = math.hypot(away_north_m, away_east_m)
        braking_m_s2 = self.values["MPC_ACC_HOR"]
        # The speed from which MPC_ACC_HOR and MPC_JERK_AUTO stop within the distance (code).
        jerk_m_s = 4.0 * braking_m_s2**2 / self.values["MPC_JERK_AUTO"]
        speed_m_s = 0.5 * (math.sqrt(jerk_m_s**2 + 8.0 * braking_m_s2 * distance_m) - jerk_m_s)
        share_1_s = min(top_m_s, speed_m_s) / distance_m if distance_m else 0.0
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

    def _move(self, moved_m: complex, velocity_m_s: complex, climb_m_s: float, dt_s: float) -> None:
        body = self.body
        body.north_m += moved_m.real
        body.east_m += moved_m.imag
        body.altitude_m += climb_m_s * dt_s
        body.velocity_north_m_s, body.velocity_east_m_s = velocity_m_s.real, velocity_m_s.imag
        body.climb_m_s = climb_m_s


def _within(north: float, east: float, greatest: float) -> tuple[float, float]:
    """Return a horizontal vector (north, east), shortened to the length `greatest` if it is longer."""
    length = math.hypot(north, east)
    share = greatest / length if length > greatest else 1.0
    return north * share, east * share
