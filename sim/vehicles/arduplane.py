"""ArduPlane as measured in its own simulator with default parameters (docs/autopilots.md; V4.7.0-dev, October 2025).

It has no velocity setpoint. In GUIDED it circles a place, holds a course or heading that a command gave, or holds a
bank while setpoints for it come; it keeps its altitude and airspeed by itself.

"(code)" marks what was read in its source, "(chosen)" what was neither measured nor read. Not modelled: radio control
and its loss (modes flown by sticks fly straight and level), the seconds of oscillation on entering 65 degrees of bank,
landing, missions, damage on hitting the ground.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from companion.geo.air_density import true_per_indicated
from companion.geo.kinematics import GRAVITY_M_S2, shorter_turn_rad
from sim.vehicles.ardupilot import ACCEPTED, BATTERY_PARAMETERS, DENIED, FAILED, UNSUPPORTED, ArduPilot, changes_mode
from sim.vehicles.craft import Answer, Command, Message, Parameter, Start, Surroundings
from sim.vehicles.fixed_wing import Airframe, FixedWing, climb_towards_m_s, loiter_course_rad
from sim.vehicles.setpoint import ABSOLUTE_FRAMES, RELATIVE_FRAMES, SANE_POSITION_M, clip, global_place_m

MANUAL, STABILIZE, FBWA, FBWB, CRUISE, RTL, LOITER, TAKEOFF, GUIDED = 0, 2, 5, 6, 7, 11, 12, 13, 15
MODES: Mapping[int, str] = {
    MANUAL: "MANUAL",
    STABILIZE: "STABILIZE",
    FBWA: "FBWA",
    FBWB: "FBWB",
    CRUISE: "CRUISE",
    RTL: "RTL",
    LOITER: "LOITER",
    TAKEOFF: "TAKEOFF",
    GUIDED: "GUIDED",
}
"""The modes' names, by ArduPlane's custom_mode numbers (ArduPlane/mode.h)."""
_STICK_MODES = frozenset({MANUAL, STABILIZE, FBWA, FBWB, CRUISE})
"""Modes that are flown by the pilot's sticks."""

AIRFRAME = Airframe(
    # On the way from 0 to 45 degrees of bank it reached 40 degrees in 0.7 s (measured).
    roll_lag_s=0.32,
    roll_rate_rad_s=math.radians(180.0),
    # Measured: 0.73 to 0.76 of g tan(bank) / V.
    turn_share=0.745,
    # Measured: from 22 to 25 m/s in 5.9 s.
    acceleration_m_s2=0.6,
    airspeed_lag_s=1.0,
    climb_lag_s=1.0,
)
_ATTITUDE_LIFE_S = 3.0
"""Time for which the bank of the last SET_ATTITUDE_TARGET is held (measured)."""
_ALTITUDE_GAIN_1_S = 0.3
"""Gain from an altitude error to the climb rate."""
_CLIMB_M_S, _SINK_M_S = 5.0, 5.0
"""Greatest climb and sink rate: TECS_CLMB_MAX and TECS_SINK_MAX (code, defaults)."""
_CLIMB_SHARE_S = 0.03
"""Climb rate in m/s per unit of the third parameter of GUIDED_CHANGE_ALTITUDE (measured)."""
_HEADING_GAIN_DEG = 0.01
"""Degrees of bank per unit of GUIDED_P and radian of heading error: GUIDED_P counts centidegrees (code)."""
_L1_DAMPING = 0.75
"""Damping of the L1 controller: NAVL1_DAMPING (code, default)."""
_TAKEOFF_CLIMB_M_S = 3.0
"""Climb rate in TAKEOFF; the same number of metres below its altitude, the climb ends and the plane circles."""
_TAKEOFF_SPEED_M_S = 12.0
"""Airspeed at which TAKEOFF leaves the ground."""
_RADIUS_MAX_M = 32767.0
"""Greatest loiter radius, of either sign."""
_STEP_S = 0.1
"""Longest step of the motion."""
# SET_ATTITUDE_TARGET's type_mask: of the measured 0xC6 only the roll is taken.
_ROLL_ONLY = 0xC6
# SET_POSITION_TARGET_GLOBAL_INT's type_mask: altitude only.
_ALTITUDE_ONLY = 0x0DFB
_ALTITUDE_IGNORED = 0x004
_OFFSET_FRAME = 7
"""MAV_FRAME_LOCAL_OFFSET_NED, in which a setpoint's z is a step of the altitude (measured)."""
_AIRSPEED = 0
"""SPEED_TYPE_AIRSPEED, the first parameter of a speed command that is obeyed."""


@dataclass(frozen=True, slots=True)
class _Course:
    """The demand of a GUIDED_CHANGE_HEADING, which never expires; its angle is from true north."""

    angle_rad: float
    is_course: bool
    """Whether the angle is the course over the ground, rather than the nose's heading."""
    bank_rad: float
    """Greatest bank on the way to the angle."""


@dataclass(frozen=True, slots=True)
class _Bank:
    """The roll that a SET_ATTITUDE_TARGET asked for, and when it came."""

    t_s: float
    roll_rad: float


class ArduPlane(ArduPilot):
    """A plane with ArduPlane: its modes, commands, setpoints and motion."""

    kind = "arduplane"
    mav_type = mavlink.MAV_TYPE_FIXED_WING
    longest_step_s = _STEP_S
    # Ranges: ArduPilot's parameter reference, GUIDED_P as far as it was flown.
    parameters = (
        Parameter("ROLL_LIMIT_DEG", 65.0, 0.0, 90.0),
        Parameter("WP_LOITER_RAD", 60.0, -_RADIUS_MAX_M, _RADIUS_MAX_M),
        Parameter("RTL_RADIUS", 0.0, -_RADIUS_MAX_M, _RADIUS_MAX_M),
        Parameter("RTL_ALTITUDE", 100.0, -1.0, 1000.0),
        Parameter("AIRSPEED_CRUISE", 22.0, 5.0, 100.0),
        Parameter("AIRSPEED_MIN", 9.0, 5.0, 100.0),
        Parameter("AIRSPEED_MAX", 30.0, 5.0, 100.0),
        Parameter("GUIDED_P", 5000.0, 0.0, 40000.0),
        Parameter("NAVL1_PERIOD", 17.0, 1.0, 60.0),
        Parameter("TKOFF_ALT", 50.0, 0.0, 200.0),
        Parameter("FS_GCS_ENABL", 0.0, 0.0, 3.0),
        Parameter("FS_LONG_ACTN", 0.0, 0.0, 4.0),
        *BATTERY_PARAMETERS,
        Parameter("FENCE_ENABLE", 0.0, 0.0, 1.0),
        Parameter("FENCE_ACTION", 0.0, 0.0, 6.0),
        Parameter("ADSB_TYPE", 0.0, 0.0, 4.0),
    )
    modes = MODES
    first_mode = MANUAL
    guided_mode = GUIDED
    holding_mode = LOITER
    stick_modes = _STICK_MODES
    return_mode = RTL
    armable = frozenset({MANUAL, STABILIZE, FBWA, FBWB, CRUISE, TAKEOFF, GUIDED})
    battery_modes = {1: RTL}
    gcs_failsafe = "FS_GCS_ENABL"

    def __init__(self, start: Start) -> None:
        """Begin as `start` says; a plane in the air without airspeed gets AIRSPEED_CRUISE and circles where it is."""
        super().__init__(start)
        body = self.body
        if start.in_air and body.airspeed_m_s <= 0.0:
            body.airspeed_m_s = self.values["AIRSPEED_CRUISE"] * true_per_indicated(body.altitude_m)
        self._wing = FixedWing(AIRFRAME, body)
        indicated_m_s = body.airspeed_m_s / true_per_indicated(body.altitude_m)
        self._indicated_m_s = indicated_m_s if start.in_air else self.values["AIRSPEED_CRUISE"]
        self._altitude_m = body.altitude_m
        self._climb_m_s = _CLIMB_M_S
        self._centre_m = body.north_m, body.east_m
        self._radius_m = 0.0
        """Radius of the circle in GUIDED, signed like WP_LOITER_RAD; 0 stands for WP_LOITER_RAD itself."""
        self._course: _Course | None = None
        self._bank: _Bank | None = None
        self._altitude_commanded = False
        """Whether GUIDED_CHANGE_ALTITUDE set the altitude: a DO_REPOSITION then no longer changes it."""
        self._commands |= {
            mavlink.MAV_CMD_NAV_TAKEOFF: lambda _command, _around, _now_s: FAILED,
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: self._return,
            mavlink.MAV_CMD_NAV_LOITER_UNLIM: self._loiter,
            mavlink.MAV_CMD_DO_REPOSITION: self._reposition,
            mavlink.MAV_CMD_DO_CHANGE_SPEED: self._change_speed,
            mavlink.MAV_CMD_GUIDED_CHANGE_SPEED: self._guided_speed,
            mavlink.MAV_CMD_GUIDED_CHANGE_ALTITUDE: self._guided_altitude,
            mavlink.MAV_CMD_GUIDED_CHANGE_HEADING: self._guided_heading,
        }
        if start.in_air:
            self._wing.blow((0.0, 0.0))

    def landed_state(self) -> int:
        """Return EXTENDED_SYS_STATE.landed_state."""
        if not self.in_air:
            return int(mavlink.MAV_LANDED_STATE_ON_GROUND)
        if self.mode == TAKEOFF and self._altitude_m - self.body.altitude_m > _TAKEOFF_CLIMB_M_S:
            return int(mavlink.MAV_LANDED_STATE_TAKEOFF)
        return int(mavlink.MAV_LANDED_STATE_IN_AIR)

    def setpoint(self, message: Message, around: Surroundings, now_s: float) -> None:
        """Obey a bank or an altitude in GUIDED; ignore velocities and positions without an answer."""
        if self.mode != GUIDED or not self.armed or not self.in_air:
            return
        name = message.get_type()
        if name == "SET_ATTITUDE_TARGET":
            roll_rad = _roll_rad(message.q) if message.type_mask == _ROLL_ONLY else math.nan
            if math.isfinite(roll_rad):
                self._bank = _Bank(now_s, roll_rad)
        elif name == "SET_POSITION_TARGET_GLOBAL_INT":
            if message.type_mask == _ALTITUDE_ONLY and abs(message.alt) < SANE_POSITION_M:
                if message.coordinate_frame in RELATIVE_FRAMES:
                    self._altitude_m = around.home.altitude_m + message.alt
                elif message.coordinate_frame in ABSOLUTE_FRAMES:
                    self._altitude_m = message.alt
        elif message.coordinate_frame == _OFFSET_FRAME and not message.type_mask & _ALTITUDE_IGNORED:
            # Each message steps the altitude once, whatever else it asks for.
            if abs(message.z) < SANE_POSITION_M:
                self._altitude_m = clip(self._altitude_m - message.z, -SANE_POSITION_M, SANE_POSITION_M)

    def blow(self, wind_m_s: tuple[float, float]) -> None:
        """Change the velocity over the ground at once: the air carries the plane."""
        self._wing.blow(wind_m_s)

    def step(self, now_s: float, dt_s: float, around: Surroundings) -> None:
        """Advance by `dt_s` as the mode demands."""
        self._mind_time(now_s, around)
        if not self.in_air:
            if not (self.armed and self.mode == TAKEOFF):
                return
            self._run_up()
        body = self.body
        altitude_m, climb_m_s = self._altitude_m, self._climb_m_s
        if not self.armed:
            # A disarmed plane glides down straight ahead.
            altitude_m, climb_m_s = around.ground_m, _CLIMB_M_S
        climb_m_s = climb_towards_m_s(altitude_m - body.altitude_m, _ALTITUDE_GAIN_1_S, climb_m_s, _SINK_M_S)
        self._wing.fly(self._wanted_bank_rad(now_s, around), self._indicated_m_s, climb_m_s, around.wind_m_s, dt_s)
        if body.altitude_m <= around.ground_m and body.climb_m_s < 0.0:
            self._touch_down(around)

    def _run_up(self) -> None:
        """Leave the ground at once along the heading: the take-off run is not modelled."""
        self.in_air = True
        self.body.airspeed_m_s = _TAKEOFF_SPEED_M_S
        self.body.climb_m_s = _TAKEOFF_CLIMB_M_S
        self._altitude_m = self.body.altitude_m + self.values["TKOFF_ALT"]
        self._indicated_m_s = self.values["AIRSPEED_CRUISE"]
        self._climb_m_s = _TAKEOFF_CLIMB_M_S

    def _touch_down(self, around: Surroundings) -> None:
        body = self.body
        body.altitude_m = around.ground_m
        body.velocity_north_m_s = body.velocity_east_m_s = body.climb_m_s = body.turn_rate_rad_s = 0.0
        body.airspeed_m_s = body.roll_rad = 0.0
        self.in_air = self.armed = False

    def _wanted_bank_rad(self, now_s: float, around: Surroundings) -> float:
        limit_rad = math.radians(min(self.values["ROLL_LIMIT_DEG"], 80.0))
        if not self.armed or self.mode in _STICK_MODES:
            return 0.0
        if self.mode == TAKEOFF:
            if self._altitude_m - self.body.altitude_m > _TAKEOFF_CLIMB_M_S:
                self._centre_m = self.body.north_m, self.body.east_m
                return 0.0
            return self._circling_bank_rad(self.values["WP_LOITER_RAD"], limit_rad)
        if self.mode == GUIDED:
            if self._bank is not None and now_s < self._bank.t_s + _ATTITUDE_LIFE_S:
                return clip(self._bank.roll_rad, -limit_rad, limit_rad)
            if self._course is not None:
                return self._course_bank_rad(self._course, around, limit_rad)
            return self._circling_bank_rad(self._radius_m or self.values["WP_LOITER_RAD"], limit_rad)
        if self.mode == RTL:
            return self._circling_bank_rad(self.values["RTL_RADIUS"] or self.values["WP_LOITER_RAD"], limit_rad)
        return self._circling_bank_rad(self.values["WP_LOITER_RAD"], limit_rad)

    def _course_bank_rad(self, course: _Course, around: Surroundings, limit_rad: float) -> float:
        is_rad = self._wing.course_rad() if course.is_course else self.body.heading_rad
        error_rad = shorter_turn_rad(is_rad, course.angle_rad - around.convergence_rad)
        bank_rad = math.radians(self.values["GUIDED_P"] * _HEADING_GAIN_DEG) * error_rad
        limit_rad = min(limit_rad, course.bank_rad)
        return clip(bank_rad, -limit_rad, limit_rad)

    def _circling_bank_rad(self, radius_m: float, limit_rad: float) -> float:
        """Return the bank that leads onto a circle about the centre, clockwise if the radius is positive."""
        body = self.body
        north_m, east_m = self._centre_m[0] - body.north_m, self._centre_m[1] - body.east_m
        right = radius_m >= 0.0
        radius_m = max(abs(radius_m), 1.0)
        wanted_rad = loiter_course_rad(north_m, east_m, radius_m, right)
        speed_m_s = max(math.hypot(body.velocity_north_m_s, body.velocity_east_m_s), 1.0)
        error_rad = shorter_turn_rad(self._wing.course_rad(), wanted_rad)
        # L1's lateral acceleration (code): 4 damping^2 V^2 / L1, with L1 = damping period V / pi.
        l1_m = _L1_DAMPING * self.values["NAVL1_PERIOD"] * speed_m_s / math.pi
        push_m_s2 = 4.0 * _L1_DAMPING**2 * speed_m_s**2 / l1_m * math.sin(clip(error_rad, -math.pi / 2, math.pi / 2))
        distance_m = math.hypot(north_m, east_m)
        if distance_m < 2.0 * radius_m:
            turn_m_s2 = speed_m_s**2 / max(distance_m, radius_m) / AIRFRAME.turn_share
            push_m_s2 += turn_m_s2 if right else -turn_m_s2
        return clip(math.atan(push_m_s2 / GRAVITY_M_S2), -limit_rad, limit_rad)

    def _forget(self) -> None:
        self._course = self._bank = None
        self._altitude_commanded = False
        self._radius_m = 0.0
        self._climb_m_s = _CLIMB_M_S

    def _enter(self, mode: int, around: Surroundings) -> None:
        again = mode == self.mode
        super()._enter(mode, around)
        if again and mode != GUIDED:
            return
        self._altitude_m = self.body.altitude_m
        self._centre_m = self.body.north_m, self.body.east_m
        if mode == RTL:
            self._centre_m = around.home.north_m, around.home.east_m
            if self.values["RTL_ALTITUDE"] >= 0.0:
                self._altitude_m = around.home.altitude_m + self.values["RTL_ALTITUDE"]

    def _gcs_failsafe_acts(self) -> bool:
        # FS_LONG_ACTN 0 goes on in GUIDED (code); every other value is taken to return, as 1 does.
        return super()._gcs_failsafe_acts() and self.values["FS_LONG_ACTN"] != 0.0

    def _return(self, _command: Command, around: Surroundings, _now_s: float) -> Answer:
        self._enter(RTL, around)
        return ACCEPTED

    def _loiter(self, _command: Command, around: Surroundings, _now_s: float) -> Answer:
        self._enter(LOITER, around)
        return ACCEPTED

    def _reposition(self, command: Command, around: Surroundings, now_s: float) -> Answer:
        """Circle about a place. Of this and a heading command, the later one counts (chosen)."""
        if not command.int_frame:
            return UNSUPPORTED
        place_m = global_place_m(command, around)
        if place_m is None or not self.in_air:
            return DENIED
        if self.mode != GUIDED:
            if not changes_mode(command):
                return DENIED
            self._enter(GUIDED, around)
        self._course = None
        self._centre_m = place_m[0], place_m[1]
        radius_m = command.param3
        self._radius_m = radius_m if math.isfinite(radius_m) and abs(radius_m) <= _RADIUS_MAX_M else 0.0
        # As measured it climbs to the place's altitude, but does not descend to it.
        if not self._altitude_commanded:
            self._altitude_m = max(self._altitude_m, place_m[2])
        return ACCEPTED

    def _change_speed(self, command: Command, around: Surroundings, now_s: float) -> Answer:
        if command.param1 != _AIRSPEED:
            return DENIED
        return self._fly_at(command.param2)

    def _guided_speed(self, command: Command, around: Surroundings, now_s: float) -> Answer:
        if not command.int_frame:
            return UNSUPPORTED
        if self.mode != GUIDED:
            return FAILED
        if command.param1 != _AIRSPEED:
            return DENIED
        return self._fly_at(command.param2)

    def _fly_at(self, airspeed_m_s: float) -> Answer:
        if not self.values["AIRSPEED_MIN"] <= airspeed_m_s <= self.values["AIRSPEED_MAX"]:
            return FAILED
        self._indicated_m_s = airspeed_m_s
        return ACCEPTED

    def _guided_altitude(self, command: Command, around: Surroundings, now_s: float) -> Answer:
        if not command.int_frame:
            return UNSUPPORTED
        if self.mode != GUIDED:
            return FAILED
        rate = command.param3
        if not (abs(command.z) < SANE_POSITION_M and math.isfinite(rate) and rate >= 0.0):
            return DENIED
        if command.frame in RELATIVE_FRAMES:
            self._altitude_m = around.home.altitude_m + command.z
        elif command.frame in ABSOLUTE_FRAMES:
            self._altitude_m = command.z
        else:
            return DENIED
        self._climb_m_s = min(_CLIMB_SHARE_S * rate, _CLIMB_M_S) if rate > 0.0 else _CLIMB_M_S
        self._altitude_commanded = True
        return ACCEPTED

    def _guided_heading(self, command: Command, around: Surroundings, now_s: float) -> Answer:
        if not command.int_frame:
            return UNSUPPORTED
        if self.mode != GUIDED:
            return FAILED
        if command.param1 not in (0.0, 1.0) or not 0.0 <= command.param2 < 360.0:
            return DENIED
        if not (math.isfinite(command.param3) and command.param3 >= 0.0):
            return DENIED
        self._course = _Course(
            math.radians(command.param2), command.param1 == 0.0, math.atan(command.param3 / GRAVITY_M_S2)
        )
        return ACCEPTED


def _roll_rad(q: list[float]) -> float:
    """Return the roll of an attitude quaternion (w, x, y, z); NaN if it does not have unit length."""
    w, x, y, z = q
    if not abs(w * w + x * x + y * y + z * z - 1.0) < 0.1:
        return math.nan
    return math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
