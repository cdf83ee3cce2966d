"""ArduCopter as measured in its own simulator with default parameters (docs/autopilots.md; V4.7.0-dev, October 2025).

A wanted velocity passes through the autopilot's own horizontal controller (`copter_control.py`), whose lean works
against the drag. In a wind that takes more lean than ANGLE_MAX allows, it keeps its course whatever is asked for.

Not modelled: the drift of STABILIZE and ALT_HOLD (here they hold their horizontal position), and the automatic
disarming of a copter that stays armed on the ground.
"""

from __future__ import annotations

import math
from functools import partial

from pymavlink.dialects.v20 import common as mavlink

from companion.geo.kinematics import GRAVITY_M_S2, shorter_turn_rad
from sim.vehicles.ardupilot import ACCEPTED, BATTERY_PARAMETERS, DENIED, FAILED, UNSUPPORTED, ArduPilot, changes_mode
from sim.vehicles.copter_control import Bounds, CopterControl, drag_m_s2, lean_m_s2
from sim.vehicles.craft import Answer, Command, Message, Parameter, Start, Surroundings
from sim.vehicles.modes import ARMABLE_MODES, BRAKE, COPTER_MODES, GUIDED, LAND, LOITER, RTL, STABILIZE, STICK_MODES
from sim.vehicles.setpoint import SANE_POSITION_M, Setpoint, clip, global_place_m, rotated, understood

_JERK_M_S3 = 5.0
"""PSC_JERK_XY's default (code)."""
_BRAKE_M_S2 = 7.5
"""Greatest acceleration in BRAKE (BRAKE_MODE_DECEL_RATE in the source)."""
_CONTROL_STEP_S = 0.01
"""Greatest time between two turns of the horizontal controller. The autopilot takes 400 a second; with steps of 0.01 s
the figures are within 2 % of those."""
_EKF_FAILSAFE_S = 8.0
"""Time without a GPS fix after which the EKF failsafe lands the copter (measured)."""
_EKF_LANDS = frozenset({1.0, 3.0})
"""Values of FS_EKF_ACTION that land (parameter reference)."""
_POSITION_MODES = frozenset({GUIDED, LOITER, RTL, BRAKE})
"""Modes that need a position."""
_CLIMB_M_S = 2.5
_DESCENT_M_S = 1.5
"""Greatest climb and descent rate, except in the modes that are flown by sticks."""
_STICK_SINK_M_S = 2.5
"""Sink rate of the modes that are flown by sticks (LOITER and others) when there is no radio control (measured)."""
_VERTICAL_ACCELERATION_M_S2 = 1.0
"""Greatest vertical acceleration."""
_LAND_FINAL_M = 10.0
"""Height above home below which a landing descends at _LAND_FINAL_M_S."""
_LAND_FINAL_M_S = 0.5
_RTL_HEIGHT_M = 15.0
"""Height above home to which RTL climbs before it flies home."""
_RTL_ARRIVED_M = 0.5
"""Distance from home at which RTL begins to land, and by which its height may be too low."""
_YAW_RATE_RAD_S = math.radians(60.0)
"""Greatest yaw rate."""
_YAW_TRACK_MIN_M_S = 0.5
"""Wanted horizontal speed below which the nose does not turn to the track."""
_POSITION_GAIN_1_S = 0.5
"""Gain from a small distance to the speed towards the place."""
_ALTITUDE_GAIN_1_S = 1.0
"""Gain from a small altitude error to the climb rate."""
_TAKEOFF_DONE_M = 0.05
"""Height below the take-off altitude at which a take-off is complete."""
_TOLERANCE = 1e-9
_STEP_S = 0.1
"""Longest step of the motion."""


class ArduCopter(ArduPilot):
    """A copter with ArduCopter: its modes, commands, setpoints and motion."""

    kind = "arducopter"
    mav_type = mavlink.MAV_TYPE_QUADROTOR
    longest_step_s = _STEP_S
    # Ranges: ArduPilot's parameter reference; WPNAV_ACCEL and PSC_JERK_XY reach as far as they were flown.
    parameters = (
        Parameter("GUID_TIMEOUT", 3.0, 0.1, 5.0),
        Parameter("WPNAV_ACCEL", 250.0, 50.0, 1000.0),
        Parameter("ANGLE_MAX", 3000.0, 1000.0, 8000.0),
        Parameter("FS_GCS_ENABLE", 0.0, 0.0, 7.0),
        Parameter("WPNAV_SPEED", 1000.0, 10.0, 2000.0),
        Parameter("PSC_JERK_XY", _JERK_M_S3, 1.0, 20.0),
        *BATTERY_PARAMETERS,
        Parameter("FS_EKF_ACTION", 1.0, 0.0, 3.0),
        Parameter("FENCE_ENABLE", 0.0, 0.0, 1.0),
        Parameter("FENCE_ACTION", 1.0, 0.0, 5.0),
        Parameter("ADSB_TYPE", 0.0, 0.0, 4.0),
    )
    modes = COPTER_MODES
    first_mode = STABILIZE
    guided_mode = GUIDED
    holding_mode = BRAKE
    stick_modes = STICK_MODES
    return_mode = RTL
    armable = ARMABLE_MODES
    battery_modes = {1: LAND, 2: RTL, 3: RTL, 4: LAND}
    gcs_failsafe = "FS_GCS_ENABLE"

    def __init__(self, start: Start) -> None:
        """Begin with the position, velocity and mode of `start`."""
        super().__init__(start)
        self._setpoint: Setpoint | None = None
        self._takeoff_altitude_m: float | None = None
        self._control: CopterControl | None = None
        """The horizontal controller; None until the first step in the air, and on the ground."""
        self._fix_lost_at_s: float | None = None
        self._commands |= {
            mavlink.MAV_CMD_NAV_TAKEOFF: self._take_off,
            mavlink.MAV_CMD_NAV_LAND: partial(self._change, LAND),
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: partial(self._change, RTL),
            mavlink.MAV_CMD_DO_REPOSITION: self._reposition,
            # Accepted without effect: a velocity setpoint has its own speed.
            mavlink.MAV_CMD_DO_CHANGE_SPEED: lambda _command, _around, _now_s: ACCEPTED,
        }

    def landed_state(self) -> int:
        """Return EXTENDED_SYS_STATE.landed_state."""
        if self._takeoff_altitude_m is not None:
            return int(mavlink.MAV_LANDED_STATE_TAKEOFF)
        if not self.in_air:
            return int(mavlink.MAV_LANDED_STATE_ON_GROUND)
        return int(mavlink.MAV_LANDED_STATE_LANDING if self.mode == LAND else mavlink.MAV_LANDED_STATE_IN_AIR)

    def setpoint(self, message: Message, around: Surroundings, now_s: float) -> None:
        """Obey a velocity or a position in GUIDED; an invalid setpoint brakes the copter to a stop."""
        if self.mode != GUIDED or not self.in_air or not self.armed:
            return
        if message.get_type() != "SET_POSITION_TARGET_LOCAL_NED":
            return
        # As measured and in ArduCopter's source: a setpoint replaces a take-off.
        self._takeoff_altitude_m = None
        self._setpoint = understood(message, self.body, around, now_s) or Setpoint(now_s, (0.0, 0.0, 0.0))

    def blow(self, wind_m_s: tuple[float, float]) -> None:
        """Change the airspeed only: the velocity over the ground changes as the drag acts."""
        self._note_airspeed(wind_m_s)

    def step(self, now_s: float, dt_s: float, around: Surroundings) -> None:
        """Advance by `dt_s` as the mode demands; a setpoint that expires within the step counts until then."""
        self._mind_time(now_s, around)
        expires_s = self._expires_s()
        if now_s < expires_s < now_s + dt_s:
            self._fly(True, around, expires_s - now_s)
            self._fly(False, around, now_s + dt_s - expires_s)
        else:
            self._fly(now_s < expires_s, around, dt_s)

    def watch(self, now_s: float, has_fix: bool, battery_v: float, around: Surroundings) -> None:
        """Do what the battery's failsafe says; without a GPS fix for _EKF_FAILSAFE_S land, in a mode that needs it."""
        super().watch(now_s, has_fix, battery_v, around)
        if has_fix:
            self._fix_lost_at_s = None
            return
        if self._fix_lost_at_s is None:
            self._fix_lost_at_s = now_s
        acts = self.values["FS_EKF_ACTION"] in _EKF_LANDS and self.mode in _POSITION_MODES
        if acts and self.armed and self.in_air and now_s - self._fix_lost_at_s >= _EKF_FAILSAFE_S:
            self._enter(LAND, around)
            self.failsafe = True
            self.texts.append("EKF Failsafe: changed to LAND Mode")

    def _expires_s(self) -> float:
        if self._setpoint is None:
            return -math.inf
        # A position setpoint does not expire on ArduCopter; a velocity does.
        if self._setpoint.place_m is not None:
            return math.inf
        return self._setpoint.t_s + self.values["GUID_TIMEOUT"]

    def _fly(self, fresh: bool, around: Surroundings, dt_s: float) -> None:
        body = self.body
        if not self.in_air and self._takeoff_altitude_m is None:
            return
        if not self.armed:
            body.north_m += body.velocity_north_m_s * dt_s
            body.east_m += body.velocity_east_m_s * dt_s
            self._rise(body.climb_m_s - GRAVITY_M_S2 * dt_s, around, dt_s)
            return
        asked = self._setpoint if fresh else None
        wanted_m_s = self._wanted_velocity(asked, around)
        self._turn_nose(asked, around, wanted_m_s, dt_s)
        self._move(complex(wanted_m_s[0], wanted_m_s[1]), complex(*around.wind_m_s), dt_s)
        limit_m_s = _VERTICAL_ACCELERATION_M_S2 * dt_s
        self._rise(body.climb_m_s + clip(wanted_m_s[2] - body.climb_m_s, -limit_m_s, limit_m_s), around, dt_s)

    def _move(self, wanted_m_s: complex, wind_m_s: complex, dt_s: float) -> None:
        """Move the copter for `dt_s` as its horizontal controller leads it to the wanted velocity over the ground."""
        body = self.body
        velocity_m_s = complex(body.velocity_north_m_s, body.velocity_east_m_s)
        if self._control is None:
            self._control = CopterControl(velocity_m_s, drag_m_s2(velocity_m_s - wind_m_s))
        bounds = Bounds(
            _BRAKE_M_S2 if self.mode == BRAKE else self.values["WPNAV_ACCEL"] / 100.0,
            self.values["PSC_JERK_XY"],
            lean_m_s2(math.radians(self.values["ANGLE_MAX"] / 100.0)),
            self.values["WPNAV_SPEED"] / 100.0,
        )
        turns = math.ceil(dt_s / _CONTROL_STEP_S - _TOLERANCE)
        moved_m = 0j
        for _ in range(turns):
            after_m_s = self._control.step(wanted_m_s, velocity_m_s, wind_m_s, bounds, dt_s / turns)
            moved_m += 0.5 * (velocity_m_s + after_m_s) * (dt_s / turns)
            velocity_m_s = after_m_s
        body.north_m += moved_m.real
        body.east_m += moved_m.imag
        body.velocity_north_m_s, body.velocity_east_m_s = velocity_m_s.real, velocity_m_s.imag

    def _wanted_velocity(self, asked: Setpoint | None, around: Surroundings) -> tuple[float, float, float]:
        """Return the velocity that the mode demands: (north, east) along the grid and up, m/s."""
        body, home = self.body, around.home
        height_m = body.altitude_m - home.altitude_m
        if self.mode in STICK_MODES:
            return 0.0, 0.0, -_STICK_SINK_M_S
        if self.mode == LAND:
            return 0.0, 0.0, _landing_climb_m_s(height_m)
        if self.mode == RTL:
            distance_m = math.hypot(home.north_m - body.north_m, home.east_m - body.east_m)
            if distance_m <= _RTL_ARRIVED_M:
                return 0.0, 0.0, _landing_climb_m_s(height_m)
            if height_m < _RTL_HEIGHT_M - _RTL_ARRIVED_M:
                return 0.0, 0.0, self._climb_towards_m_s(home.altitude_m + _RTL_HEIGHT_M)
            return self._velocity_towards(home.north_m, home.east_m, body.altitude_m)
        if self.mode == GUIDED:
            if self._takeoff_altitude_m is not None:
                if self._takeoff_altitude_m - body.altitude_m > _TAKEOFF_DONE_M:
                    return 0.0, 0.0, self._climb_towards_m_s(self._takeoff_altitude_m)
                self._takeoff_altitude_m = None
            elif asked is not None:
                if asked.place_m is not None:
                    return self._velocity_towards(*asked.place_m)
                north_m_s, east_m_s, up_m_s = asked.velocity_m_s
                north_m_s, east_m_s = rotated(north_m_s, east_m_s, -around.convergence_rad)
                return north_m_s, east_m_s, clip(up_m_s, -_DESCENT_M_S, _CLIMB_M_S)
        return 0.0, 0.0, 0.0

    def _velocity_towards(self, north_m: float, east_m: float, altitude_m: float) -> tuple[float, float, float]:
        away_north_m, away_east_m = north_m - self.body.north_m, east_m - self.body.east_m
        distance_m = math.hypot(away_north_m, away_east_m)
        speed_m_s = _approach_speed_m_s(
            distance_m, self.values["WPNAV_SPEED"] / 100.0, self.values["WPNAV_ACCEL"] / 100.0, _POSITION_GAIN_1_S
        )
        share_1_s = speed_m_s / distance_m if distance_m else 0.0
        return away_north_m * share_1_s, away_east_m * share_1_s, self._climb_towards_m_s(altitude_m)

    def _climb_towards_m_s(self, altitude_m: float) -> float:
        away_m = altitude_m - self.body.altitude_m
        top_m_s = _CLIMB_M_S if away_m > 0.0 else _DESCENT_M_S
        speed_m_s = _approach_speed_m_s(abs(away_m), top_m_s, _VERTICAL_ACCELERATION_M_S2, _ALTITUDE_GAIN_1_S)
        return math.copysign(speed_m_s, away_m)

    def _turn_nose(
        self, asked: Setpoint | None, around: Surroundings, wanted_m_s: tuple[float, float, float], dt_s: float
    ) -> None:
        """Turn the nose to the setpoint's yaw, else at its yaw rate, else along the wanted track."""
        limit_rad = _YAW_RATE_RAD_S * dt_s
        turn_rad = 0.0
        if asked is not None and asked.yaw_rad is not None:
            turn_rad = shorter_turn_rad(self.body.heading_rad, asked.yaw_rad - around.convergence_rad)
        elif asked is not None and asked.yaw_rate_rad_s is not None:
            turn_rad = asked.yaw_rate_rad_s * dt_s
        elif math.hypot(wanted_m_s[0], wanted_m_s[1]) > _YAW_TRACK_MIN_M_S:
            turn_rad = shorter_turn_rad(self.body.heading_rad, math.atan2(wanted_m_s[1], wanted_m_s[0]))
        turn_rad = clip(turn_rad, -limit_rad, limit_rad)
        self.body.heading_rad = math.remainder(self.body.heading_rad + turn_rad, math.tau)
        self.body.turn_rate_rad_s = turn_rad / dt_s

    def _rise(self, climb_m_s: float, around: Surroundings, dt_s: float) -> None:
        body = self.body
        body.altitude_m += climb_m_s * dt_s
        body.climb_m_s = climb_m_s
        if body.altitude_m > around.ground_m:
            self.in_air = True
        elif climb_m_s < 0.0:
            self._touch_down(around)
        self._note_airspeed(around.wind_m_s)

    def _note_airspeed(self, wind_m_s: tuple[float, float]) -> None:
        body = self.body
        body.airspeed_m_s = math.hypot(body.velocity_north_m_s - wind_m_s[0], body.velocity_east_m_s - wind_m_s[1])

    def _touch_down(self, around: Surroundings) -> None:
        body = self.body
        body.altitude_m = around.ground_m
        body.velocity_north_m_s = body.velocity_east_m_s = body.climb_m_s = body.turn_rate_rad_s = 0.0
        self._control = None
        self.in_air = False
        self._setpoint = None
        if self.mode in (LAND, RTL):
            self.armed = False

    def _can_fall(self) -> bool:
        return True

    def _forget(self) -> None:
        self._setpoint = None
        self._takeoff_altitude_m = None
        # The next mode's controllers begin from the present velocity.
        if self._control is not None:
            velocity_m_s = complex(self.body.velocity_north_m_s, self.body.velocity_east_m_s)
            self._control = CopterControl(velocity_m_s, self._control.lean_m_s2)

    def _on_armed(self, around: Surroundings) -> None:
        self._takeoff_altitude_m = None

    def _take_off(self, command: Command, around: Surroundings, now_s: float) -> Answer:
        ready = self.mode == GUIDED and self.armed and not self.in_air
        if not (ready and 0.0 < command.z < SANE_POSITION_M):
            return FAILED
        self._takeoff_altitude_m = around.home.altitude_m + command.z
        return ACCEPTED

    def _change(self, mode: int, _command: Command, around: Surroundings, _now_s: float) -> Answer:
        self._enter(mode, around)
        return ACCEPTED

    def _reposition(self, command: Command, around: Surroundings, now_s: float) -> Answer:
        """Fly to a place, as a map's "go to" asks.

        Not measured on the copter: COMMAND_LONG is refused because ArduPlane refuses it.
        """
        if not command.int_frame:
            return UNSUPPORTED
        place_m = global_place_m(command, around)
        if place_m is None:
            return DENIED
        if not self.in_air:
            return FAILED
        if self.mode != GUIDED:
            if not changes_mode(command):
                return DENIED
            self._enter(GUIDED, around)
        self._takeoff_altitude_m = None
        self._setpoint = Setpoint(now_s, (0.0, 0.0, 0.0), place_m)
        return ACCEPTED


def _landing_climb_m_s(height_m: float) -> float:
    return -_DESCENT_M_S if height_m > _LAND_FINAL_M else -_LAND_FINAL_M_S


def _approach_speed_m_s(distance_m: float, top_m_s: float, acceleration_m_s2: float, gain_1_s: float) -> float:
    """Return the speed from which the vehicle can still stop at a place at this distance.

    It is proportional to the distance near the place, and grows with its square root further out.
    """
    near_m = acceleration_m_s2 / gain_1_s**2
    if distance_m <= near_m:
        return min(top_m_s, gain_1_s * distance_m)
    return min(top_m_s, math.sqrt(2.0 * acceleration_m_s2 * (distance_m - 0.5 * near_m)))
