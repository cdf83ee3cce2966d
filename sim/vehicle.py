"""The stand-in autopilot: MAVLink `common` in and out on a given clock, without sockets.

The companion must be tested against an autopilot that says no, brakes on silence and lies late, long before a real one
is at hand. This one behaves as ArduCopter was measured to (see the comments at the constants), or as the paper's point
mass that cannot stop. The truth lives in the mission's plane; whatever goes over the wire is relative to local true
north, so everything is turned by the plane's convergence on its way in and out.

Wind is what the owner sets before each step and stays constant within it. A point flies its speed and its turns through
the air, which carries it along: it crabs to hold the course asked for, and drifts with the wind where it only circles.
A copter holds its velocity over the ground as far as its top speed, which is one through the air, allows.

Not modelled: the drift of a copter's STABILIZE and ALT_HOLD (they hold their place), batteries, sensors' noise, the
ground station failsafe (FS_GCS_ENABLE is only a parameter here), and the disarming of a copter left armed on the
ground.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from companion.geodesy import LocalFrame
from companion.kinematics import GRAVITY_M_S2, advance, shorter_turn_rad, turn_towards
from sim.wind import crabbed

Message = Any
"""A message of the generated module, which carries no types."""

# Modes by ArduCopter's custom_mode numbers (ArduCopter/mode.h).
STABILIZE, ALT_HOLD, GUIDED, LOITER, RTL, LAND, BRAKE = 0, 2, 4, 5, 6, 9, 17
MODE_NAMES = {
    STABILIZE: "STABILIZE",
    ALT_HOLD: "ALT_HOLD",
    GUIDED: "GUIDED",
    LOITER: "LOITER",
    RTL: "RTL",
    LAND: "LAND",
    BRAKE: "BRAKE",
}
_ARMABLE_MODES = frozenset({STABILIZE, ALT_HOLD, GUIDED, LOITER})
_STICK_MODES = frozenset({STABILIZE, ALT_HOLD, LOITER})

# ArduCopter as measured in its own simulator with default parameters (V4.7.0-dev, October 2025).
_VELOCITY_LAG_S = 0.83
"""With the 2.5 m/s^2 of WPNAV_ACCEL a step to 5 m/s is 90 % done after 2.35 s, as measured."""
_TOP_SPEED_AT_45_DEG_M_S = 15.0
_TOP_SPEED_EXPONENT = math.log(_TOP_SPEED_AT_45_DEG_M_S / 10.3) / math.log(1.0 / math.tan(math.radians(30.0)))
"""Drag against lean angle, through the two measured points: 10.3 m/s at 30 degrees and 15.0 m/s at 45."""
_CLIMB_M_S = 2.5
_DESCENT_M_S = 1.5
_STICK_SINK_M_S = 2.5
"""LOITER and its like without a radio-control stick sink this fast."""
_VERTICAL_ACCELERATION_M_S2 = 1.0
_LAND_FINAL_M = 10.0
_LAND_FINAL_M_S = 0.5
_RTL_HEIGHT_M = 15.0
_RTL_ARRIVED_M = 0.5
_YAW_RATE_RAD_S = math.radians(60.0)
_YAW_TRACK_MIN_M_S = 0.5
"""Below this a velocity demand has no track to turn the nose to."""
_POSITION_GAIN_1_S = 0.5
_ALTITUDE_GAIN_1_S = 1.0
_TAKEOFF_DONE_M = 0.05
_COPTER_STEP_S = 0.1
"""Longest integration step of the copter: an eighth of its lag."""

# SET_POSITION_TARGET_LOCAL_NED (mavlink.io, POSITION_TARGET_TYPEMASK and MAV_FRAME).
_POSITION_IGNORED = 0x007
_VELOCITY_IGNORED = 0x038
_YAW_IGNORED = 0x400
_YAW_RATE_IGNORED = 0x800
_FRAME_LOCAL, _FRAME_LOCAL_OFFSET, _FRAME_BODY, _FRAME_BODY_OFFSET = 1, 7, 8, 9
_WORLD_FRAMES = frozenset({_FRAME_LOCAL, _FRAME_LOCAL_OFFSET})
_BODY_FRAMES = frozenset({_FRAME_BODY, _FRAME_BODY_OFFSET})
_SANE_VELOCITY_M_S = 1000.0
_SANE_POSITION_M = 1e6

_FORCE_DISARM = 21196.0
"""The magic second parameter of MAV_CMD_COMPONENT_ARM_DISARM that stops motors in flight."""
_AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
)
_BATTERY_MV, _BATTERY_PERCENT = 12600, 100
_INT16_MAX, _INT32_MAX = 2**15 - 1, 2**31 - 1
_DUE_TOLERANCE_S = 1e-6
_SHORTEST_INTERVAL_S = 0.02

DEFAULT_RATES_HZ: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 10.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.2,
}
"""What is streamed unless the owner or a SET_MESSAGE_INTERVAL says otherwise, by message id."""

LOCKSTEP_RATES_HZ: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 0.2,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 0.1,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.02,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 1.0,
}
"""What a companion lives on at a guidance step of 0.5 s and a log is read by: packing is most of a step's cost."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One entry of the parameter table."""

    name: str
    default: float
    least: float
    greatest: float


@dataclass(frozen=True, slots=True)
class PointLimits:
    """The paper's vehicle: it flies arcs at constant speed, turns at most at n_max g / v and cannot stop.

    Speeds and turns are through the air.
    """

    n_max: float
    min_speed_m_s: float
    max_speed_m_s: float


@dataclass(frozen=True, slots=True)
class Profile:
    """Which autopilot this is and how it moves; without `point` it is a copter."""

    name: str
    mav_type: int
    setpoint_grace_s: float
    """Added to GUID_TIMEOUT before a silent companion is given up."""
    parameters: tuple[Parameter, ...]
    point: PointLimits | None = None


# Ranges: ArduPilot's parameter reference; WPNAV_ACCEL reaches to 1000 because it was flown so.
_TIMEOUT = Parameter("GUID_TIMEOUT", 3.0, 0.1, 5.0)
_GCS_FAILSAFE = Parameter("FS_GCS_ENABLE", 0.0, 0.0, 7.0)

ARDUCOPTER = Profile(
    name="arducopter",
    mav_type=mavlink.MAV_TYPE_QUADROTOR,
    setpoint_grace_s=0.5,
    parameters=(
        _TIMEOUT,
        Parameter("WPNAV_ACCEL", 250.0, 50.0, 1000.0),
        Parameter("ANGLE_MAX", 3000.0, 1000.0, 8000.0),
        _GCS_FAILSAFE,
        Parameter("WPNAV_SPEED", 1000.0, 10.0, 2000.0),
    ),
)


def kinematic_profile(n_max: float, min_speed_m_s: float, max_speed_m_s: float) -> Profile:
    """Return the profile of a point that cannot stop, obeys speed at once and turns at most at n_max g / v.

    Raises ValueError unless n_max > 0 and 0 < min_speed_m_s <= max_speed_m_s.
    """
    if not (n_max > 0.0 and 0.0 < min_speed_m_s <= max_speed_m_s < math.inf):
        raise ValueError("a kinematic profile needs n_max > 0 and 0 < min_speed_m_s <= max_speed_m_s")
    return Profile(
        name="kinematic",
        mav_type=mavlink.MAV_TYPE_FIXED_WING,
        setpoint_grace_s=0.0,
        parameters=(_TIMEOUT, _GCS_FAILSAFE),
        point=PointLimits(n_max, min_speed_m_s, max_speed_m_s),
    )


@dataclass(frozen=True, slots=True)
class Home:
    """Where the vehicle was armed: a point of the plane and its height above sea level, which is also the ground."""

    north_m: float
    east_m: float
    altitude_m: float


@dataclass(frozen=True, slots=True)
class Truth:
    """Where the vehicle really is, in the mission's plane. The heading is the nose's, clockwise from grid north.

    The speed is over the ground, where the wind makes the course another than the nose's.
    """

    north_m: float
    east_m: float
    altitude_m: float
    heading_rad: float
    speed_m_s: float


@dataclass(frozen=True, slots=True)
class _Setpoint:
    """What the companion asked: a velocity along local true north (north, east, up), or a place in the plane."""

    t_s: float
    velocity_m_s: tuple[float, float, float]
    place_m: tuple[float, float, float] | None
    yaw_rad: float | None
    yaw_rate_rad_s: float | None


@dataclass(slots=True)
class _Stream:
    period_s: float
    due_s: float


class StandIn:
    """One stand-in autopilot. Deterministic: its state follows from what it was given and when."""

    def __init__(
        self,
        profile: Profile,
        system_id: int,
        frame: LocalFrame,
        *,
        north_m: float = 0.0,
        east_m: float = 0.0,
        altitude_m: float = 0.0,
        heading_rad: float = 0.0,
        speed_m_s: float = 0.0,
        home: Home | None = None,
        in_air: bool = False,
        armed: bool = False,
        guided: bool = False,
        start_s: float = 0.0,
        rates_hz: Mapping[int, float] = DEFAULT_RATES_HZ,
    ) -> None:
        """Place the vehicle: plane metres, altitude above sea level, heading from grid north; no `home` means here.

        A point's speed is through the air. The clock of `time_boot_ms` begins at `start_s`. Raises ValueError for a
        point on the ground: it cannot stop.
        """
        point = profile.point
        if point is not None and not in_air:
            raise ValueError("a kinematic vehicle cannot stop, so it begins in the air")
        self.profile = profile
        self.system_id = system_id
        self.mode = GUIDED if guided else STABILIZE
        self.armed = armed
        self.in_air = in_air
        self.parameters = {parameter.name: parameter.default for parameter in profile.parameters}
        self._ranges = {parameter.name: parameter for parameter in profile.parameters}
        self._frame = frame
        self._home = home if home is not None else Home(north_m, east_m, altitude_m)
        home_lat_deg, home_lon_deg = frame.to_global(self._home.north_m, self._home.east_m)
        self._home_frame = LocalFrame(home_lat_deg, home_lon_deg)
        self._start_s = start_s
        self._now_s = start_s
        self._north_m = north_m
        self._east_m = east_m
        self._altitude_m = altitude_m
        self._heading_rad = heading_rad
        # North and east along the grid: where the air moves to, not where it comes from. The owner's to set.
        self.wind_m_s: tuple[float, float] = (0.0, 0.0)
        # What the vehicle keeps when the wind changes: a point's velocity is through the air, a copter's over ground.
        speed_m_s = speed_m_s if point is None else _clip(speed_m_s, point.min_speed_m_s, point.max_speed_m_s)
        self._velocity_north_m_s = speed_m_s * math.cos(heading_rad)
        self._velocity_east_m_s = speed_m_s * math.sin(heading_rad)
        self._climb_m_s = 0.0
        self._turn_rate_rad_s = 0.0
        self._setpoint: _Setpoint | None = None
        self._takeoff_altitude_m: float | None = None
        self._geodetic: tuple[float, float, float] | None = None
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=_AUTOPILOT_COMPONENT)
        self._packers: dict[int, Callable[[float], bytes]] = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._extended_sys_state,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw_int,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position_int,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position_ned,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self._home_position,
        }
        self._default_rates_hz = dict(rates_hz)
        self._streams = {
            message_id: _Stream(1.0 / rate_hz, start_s) for message_id, rate_hz in rates_hz.items() if rate_hz > 0.0
        }
        self._handlers: dict[str, Callable[[Message, float], list[bytes]]] = {
            "COMMAND_LONG": self._on_command_long,
            "COMMAND_INT": self._on_command_int,
            "SET_MODE": self._on_set_mode,
            "SET_POSITION_TARGET_LOCAL_NED": self._on_setpoint,
            "PARAM_SET": self._on_param_set,
            "PARAM_REQUEST_READ": self._on_param_request_read,
            "PARAM_REQUEST_LIST": self._on_param_request_list,
        }
        self._commands: dict[int, Callable[[Message, float], tuple[int, list[bytes]]]] = {
            mavlink.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._take_off,
            mavlink.MAV_CMD_NAV_LAND: lambda _command, t_s: self._change_mode(LAND, t_s),
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _command, t_s: self._change_mode(RTL, t_s),
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_message_interval,
        }

    @property
    def truth(self) -> Truth:
        """Where the vehicle really is after the last step."""
        speed_m_s = math.hypot(*self.ground_velocity_m_s)
        return Truth(self._north_m, self._east_m, self._altitude_m, self._heading_rad, speed_m_s)

    @property
    def ground_velocity_m_s(self) -> tuple[float, float]:
        """Velocity (north, east) over the ground along the grid, in the wind as it is set now."""
        if self.profile.point is None:
            return self._velocity_north_m_s, self._velocity_east_m_s
        return self._velocity_north_m_s + self.wind_m_s[0], self._velocity_east_m_s + self.wind_m_s[1]

    # In

    def receive(self, datagram: bytes, t_s: float) -> list[bytes]:
        """Take one datagram at the time `t_s` and return the replies as frames. Never raises, whatever the bytes."""
        # A parser of its own for each datagram: a damaged one must not swallow the next.
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        replies: list[bytes] = []
        for message in parser.parse_buffer(datagram) or ():
            # Bad data and unknown messages, which the parser returns unchecked, have no handler.
            handler = self._handlers.get(message.get_type())
            if (
                handler is not None
                and message.target_system in (0, self.system_id)
                and getattr(message, "target_component", 0) in (0, _AUTOPILOT_COMPONENT)
            ):
                replies += handler(message, t_s)
        return replies

    def _on_command_long(self, message: Message, t_s: float) -> list[bytes]:
        return self._answer_command(message, t_s)

    def _on_command_int(self, message: Message, t_s: float) -> list[bytes]:
        message.param7 = message.z
        return self._answer_command(message, t_s)

    def _answer_command(self, message: Message, t_s: float) -> list[bytes]:
        command = self._commands.get(message.command)
        result, frames = (mavlink.MAV_RESULT_UNSUPPORTED, []) if command is None else command(message, t_s)
        ack = self._mav.command_ack_encode(
            message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
        )
        return [self._pack(ack), *frames]

    def _on_set_mode(self, message: Message, t_s: float) -> list[bytes]:
        if not message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return []
        return self._change_mode(message.custom_mode, t_s)[1]

    def _do_set_mode(self, command: Message, t_s: float) -> tuple[int, list[bytes]]:
        if not (math.isfinite(command.param1) and math.isfinite(command.param2)):
            return mavlink.MAV_RESULT_DENIED, []
        if not int(command.param1) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return mavlink.MAV_RESULT_DENIED, []
        return self._change_mode(int(command.param2), t_s)

    def _change_mode(self, mode: int, t_s: float) -> tuple[int, list[bytes]]:
        if mode not in MODE_NAMES:
            return mavlink.MAV_RESULT_FAILED, [self._status_text(f"No such mode {mode}")]
        # Entering any mode, GUIDED again included, forgets the setpoint and a take-off under way.
        self._setpoint = None
        self._takeoff_altitude_m = None
        if mode == self.mode:
            return mavlink.MAV_RESULT_ACCEPTED, []
        self.mode = mode
        return mavlink.MAV_RESULT_ACCEPTED, [self._announce(t_s)]

    def _arm_disarm(self, command: Message, t_s: float) -> tuple[int, list[bytes]]:
        if command.param1 not in (0.0, 1.0):
            return mavlink.MAV_RESULT_UNSUPPORTED, []
        arm = command.param1 == 1.0
        if arm == self.armed:
            return mavlink.MAV_RESULT_ACCEPTED, []
        if arm and self.mode not in _ARMABLE_MODES:
            return mavlink.MAV_RESULT_DENIED, [self._status_text(f"Arm: {MODE_NAMES[self.mode]} mode not armable")]
        # A point has no fall to fly, so only a copter can be cut off in the air.
        forced = command.param2 == _FORCE_DISARM and self.profile.point is None
        if not arm and self.in_air and not forced:
            return mavlink.MAV_RESULT_DENIED, [self._status_text("Disarm: flying")]
        self.armed = arm
        self._takeoff_altitude_m = None
        return mavlink.MAV_RESULT_ACCEPTED, [self._announce(t_s)]

    def _take_off(self, command: Message, t_s: float) -> tuple[int, list[bytes]]:
        ready = self.mode == GUIDED and self.armed and not self.in_air
        if not (ready and 0.0 < command.param7 < _SANE_POSITION_M):
            return mavlink.MAV_RESULT_FAILED, []
        self._takeoff_altitude_m = self._home.altitude_m + command.param7
        return mavlink.MAV_RESULT_ACCEPTED, []

    def _request_message(self, command: Message, t_s: float) -> tuple[int, list[bytes]]:
        packer = self._packers.get(command.param1)
        if packer is None:
            return mavlink.MAV_RESULT_UNSUPPORTED, []
        return mavlink.MAV_RESULT_ACCEPTED, [packer(t_s)]

    def _set_message_interval(self, command: Message, t_s: float) -> tuple[int, list[bytes]]:
        message_id, interval_us = command.param1, command.param2
        if not (math.isfinite(message_id) and math.isfinite(interval_us)):
            return mavlink.MAV_RESULT_DENIED, []
        # An unknown message is accepted too: a ground station asks for much that it can do without.
        if message_id in self._packers:
            rate_hz = 1e6 / interval_us if interval_us > 0.0 else 0.0
            if interval_us == 0.0:
                rate_hz = self._default_rates_hz.get(int(message_id), 0.0)
            self._streams.pop(int(message_id), None)
            if rate_hz > 0.0:
                self._streams[int(message_id)] = _Stream(max(1.0 / rate_hz, _SHORTEST_INTERVAL_S), t_s)
        return mavlink.MAV_RESULT_ACCEPTED, []

    def _on_setpoint(self, message: Message, t_s: float) -> list[bytes]:
        if self.mode != GUIDED or not self.in_air or not self.armed:
            return []
        # As measured and in ArduCopter's source: a setpoint replaces a take-off, and one that makes no sense stops.
        self._takeoff_altitude_m = None
        self._setpoint = self._understood(message, t_s) or _Setpoint(t_s, (0.0, 0.0, 0.0), None, None, None)
        return []

    def _understood(self, message: Message, t_s: float) -> _Setpoint | None:
        frame, mask = message.coordinate_frame, message.type_mask
        if frame not in _WORLD_FRAMES and frame not in _BODY_FRAMES:
            return None
        place_m, velocity_m_s = None, (0.0, 0.0, 0.0)
        if not mask & _POSITION_IGNORED:
            place_m = self._place(frame, message.x, message.y, message.z)
            if place_m is None:
                return None
        elif not mask & _VELOCITY_IGNORED:
            north_m_s, east_m_s, down_m_s = message.vx, message.vy, message.vz
            # Comparisons with NaN are false, so this also refuses NaN.
            if not all(abs(speed_m_s) < _SANE_VELOCITY_M_S for speed_m_s in (north_m_s, east_m_s, down_m_s)):
                return None
            if frame in _BODY_FRAMES:
                north_m_s, east_m_s = _rotated(north_m_s, east_m_s, self._true_heading_rad())
            velocity_m_s = (north_m_s, east_m_s, -down_m_s)
        else:
            return None
        return _Setpoint(
            t_s,
            velocity_m_s,
            place_m,
            None if mask & _YAW_IGNORED or not math.isfinite(message.yaw) else message.yaw,
            None if mask & _YAW_RATE_IGNORED or not math.isfinite(message.yaw_rate) else message.yaw_rate,
        )

    def _place(self, frame: int, x_m: float, y_m: float, z_m: float) -> tuple[float, float, float] | None:
        """Return the plane's (north, east, altitude) of a position: from home in frame 1, else from the vehicle."""
        if not all(abs(metres) < _SANE_POSITION_M for metres in (x_m, y_m, z_m)):
            return None
        if frame == _FRAME_LOCAL:
            lat_deg, lon_deg = self._home_frame.to_global(x_m, y_m)
            north_m, east_m = self._frame.to_local(lat_deg, lon_deg)
            return north_m, east_m, self._home.altitude_m - z_m
        if frame in _BODY_FRAMES:
            x_m, y_m = _rotated(x_m, y_m, self._true_heading_rad())
        north_m, east_m = _rotated(x_m, y_m, -self._geo()[2])
        return self._north_m + north_m, self._east_m + east_m, self._altitude_m - z_m

    def _on_param_set(self, message: Message, t_s: float) -> list[bytes]:
        allowed = self._ranges.get(message.param_id)
        if allowed is None:
            return []
        # A refusal shows, as on the real one, in the old value coming back.
        if allowed.least <= message.param_value <= allowed.greatest:
            self.parameters[allowed.name] = message.param_value
        return [self._param_value(allowed.name)]

    def _on_param_request_read(self, message: Message, t_s: float) -> list[bytes]:
        names = list(self.parameters)
        name = message.param_id
        if 0 <= message.param_index < len(names):
            name = names[message.param_index]
        return [self._param_value(name)] if name in self.parameters else []

    def _on_param_request_list(self, message: Message, t_s: float) -> list[bytes]:
        return [self._param_value(name) for name in self.parameters]

    # Motion

    def step_to(self, t_s: float) -> None:
        """Advance the truth to the time `t_s`; an earlier time than the last changes nothing."""
        if t_s <= self._now_s:
            return
        point = self.profile.point
        convergence_rad = self._geo()[2]
        top_m_s = 0.0 if point is not None else self._top_speed_m_s()
        while self._now_s < t_s:
            fresh = self._setpoint_is_fresh()
            until_s = t_s
            if fresh and self._setpoint is not None and self._setpoint.place_m is None:
                # The step ends where the setpoint's time does.
                until_s = min(t_s, self._setpoint.t_s + self._setpoint_life_s())
            if point is not None:
                self._fly_point(point, fresh, convergence_rad, until_s - self._now_s)
            else:
                until_s = min(until_s, self._now_s + _COPTER_STEP_S)
                self._fly_copter(fresh, convergence_rad, top_m_s, until_s - self._now_s)
            self._now_s = until_s
        self._geodetic = None

    def _setpoint_life_s(self) -> float:
        return self.parameters["GUID_TIMEOUT"] + self.profile.setpoint_grace_s

    def _setpoint_is_fresh(self) -> bool:
        if self._setpoint is None:
            return False
        # A place to fly to does not go stale on ArduCopter; a velocity does.
        return self._setpoint.place_m is not None or self._now_s < self._setpoint.t_s + self._setpoint_life_s()

    def _fly_point(self, point: PointLimits, fresh: bool, convergence_rad: float, dt_s: float) -> None:
        speed_m_s = math.hypot(self._velocity_north_m_s, self._velocity_east_m_s)
        heading_before_rad = self._heading_rad
        wanted_rad: float | None = None
        self._climb_m_s = 0.0
        if fresh and self._setpoint is not None:
            north_m_s, east_m_s, up_m_s = self._setpoint.velocity_m_s
            if north_m_s or east_m_s:
                speed_m_s = _clip(math.hypot(north_m_s, east_m_s), point.min_speed_m_s, point.max_speed_m_s)
                wanted_rad = crabbed(math.atan2(east_m_s, north_m_s) - convergence_rad, speed_m_s, self.wind_m_s)
                self._climb_m_s = _clip(up_m_s, -_DESCENT_M_S, _CLIMB_M_S)
        rate_rad_s = point.n_max * GRAVITY_M_S2 / speed_m_s
        if wanted_rad is None:
            # Nobody says where to: the tightest circle to the right keeps it near, but for the wind.
            self._north_m, self._east_m, self._heading_rad = advance(
                self._north_m, self._east_m, self._heading_rad, speed_m_s, rate_rad_s, dt_s
            )
            self._turn_rate_rad_s = rate_rad_s
        else:
            self._north_m, self._east_m, self._heading_rad = turn_towards(
                self._north_m, self._east_m, self._heading_rad, speed_m_s, wanted_rad, rate_rad_s, dt_s
            )
            self._turn_rate_rad_s = shorter_turn_rad(heading_before_rad, self._heading_rad) / dt_s
        self._velocity_north_m_s = speed_m_s * math.cos(self._heading_rad)
        self._velocity_east_m_s = speed_m_s * math.sin(self._heading_rad)
        self._north_m += self.wind_m_s[0] * dt_s
        self._east_m += self.wind_m_s[1] * dt_s
        self._altitude_m = max(self._altitude_m + self._climb_m_s * dt_s, self._home.altitude_m)

    def _fly_copter(self, fresh: bool, convergence_rad: float, top_m_s: float, dt_s: float) -> None:
        if not self.in_air and self._takeoff_altitude_m is None:
            return
        if not self.armed:
            self._climb_m_s -= GRAVITY_M_S2 * dt_s
            self._move(self._velocity_north_m_s, self._velocity_east_m_s, self._climb_m_s, dt_s)
            return
        wanted_north_m_s, wanted_east_m_s, wanted_climb_m_s = self._wanted_velocity(fresh, convergence_rad)
        wanted_speed_m_s = math.hypot(wanted_north_m_s, wanted_east_m_s)
        # The lean works against the drag of the air, so a wind above the top speed carries the copter off.
        wind_north_m_s, wind_east_m_s = self.wind_m_s
        air_north_m_s, air_east_m_s = wanted_north_m_s - wind_north_m_s, wanted_east_m_s - wind_east_m_s
        airspeed_m_s = math.hypot(air_north_m_s, air_east_m_s)
        if airspeed_m_s > top_m_s:
            wanted_north_m_s = wind_north_m_s + air_north_m_s * (top_m_s / airspeed_m_s)
            wanted_east_m_s = wind_east_m_s + air_east_m_s * (top_m_s / airspeed_m_s)
        # A first-order lag whose acceleration is limited as a vector.
        gain = -math.expm1(-dt_s / _VELOCITY_LAG_S)
        change_north_m_s = (wanted_north_m_s - self._velocity_north_m_s) * gain
        change_east_m_s = (wanted_east_m_s - self._velocity_east_m_s) * gain
        change_m_s = math.hypot(change_north_m_s, change_east_m_s)
        limit_m_s = self.parameters["WPNAV_ACCEL"] / 100.0 * dt_s
        scale = limit_m_s / change_m_s if change_m_s > limit_m_s else 1.0
        vertical_limit_m_s = _VERTICAL_ACCELERATION_M_S2 * dt_s
        self._turn_nose(fresh, convergence_rad, wanted_north_m_s, wanted_east_m_s, wanted_speed_m_s, dt_s)
        self._move(
            self._velocity_north_m_s + change_north_m_s * scale,
            self._velocity_east_m_s + change_east_m_s * scale,
            self._climb_m_s + _clip(wanted_climb_m_s - self._climb_m_s, -vertical_limit_m_s, vertical_limit_m_s),
            dt_s,
        )

    def _top_speed_m_s(self) -> float:
        lean_rad = math.radians(self.parameters["ANGLE_MAX"] / 100.0)
        return float(_TOP_SPEED_AT_45_DEG_M_S * math.tan(lean_rad) ** _TOP_SPEED_EXPONENT)

    def _wanted_velocity(self, fresh: bool, convergence_rad: float) -> tuple[float, float, float]:
        """Return what the mode wants: (north, east) along the grid and up, m/s."""
        height_m = self._altitude_m - self._home.altitude_m
        if self.mode in _STICK_MODES:
            return 0.0, 0.0, -_STICK_SINK_M_S
        if self.mode == LAND:
            return 0.0, 0.0, _landing_climb_m_s(height_m)
        if self.mode == RTL:
            distance_m = math.hypot(self._home.north_m - self._north_m, self._home.east_m - self._east_m)
            if distance_m <= _RTL_ARRIVED_M:
                return 0.0, 0.0, _landing_climb_m_s(height_m)
            if height_m < _RTL_HEIGHT_M - _RTL_ARRIVED_M:
                return 0.0, 0.0, self._climb_towards_m_s(self._home.altitude_m + _RTL_HEIGHT_M)
            return self._velocity_towards(self._home.north_m, self._home.east_m, self._altitude_m)
        if self.mode == GUIDED:
            if self._takeoff_altitude_m is not None:
                if self._takeoff_altitude_m - self._altitude_m > _TAKEOFF_DONE_M:
                    return 0.0, 0.0, self._climb_towards_m_s(self._takeoff_altitude_m)
                self._takeoff_altitude_m = None
            elif fresh and self._setpoint is not None:
                if self._setpoint.place_m is not None:
                    return self._velocity_towards(*self._setpoint.place_m)
                north_m_s, east_m_s, up_m_s = self._setpoint.velocity_m_s
                north_m_s, east_m_s = _rotated(north_m_s, east_m_s, -convergence_rad)
                return north_m_s, east_m_s, _clip(up_m_s, -_DESCENT_M_S, _CLIMB_M_S)
        return 0.0, 0.0, 0.0

    def _velocity_towards(self, north_m: float, east_m: float, altitude_m: float) -> tuple[float, float, float]:
        away_north_m, away_east_m = north_m - self._north_m, east_m - self._east_m
        distance_m = math.hypot(away_north_m, away_east_m)
        speed_m_s = _approach_speed_m_s(
            distance_m,
            self.parameters["WPNAV_SPEED"] / 100.0,
            self.parameters["WPNAV_ACCEL"] / 100.0,
            _POSITION_GAIN_1_S,
        )
        share_1_s = speed_m_s / distance_m if distance_m else 0.0
        return away_north_m * share_1_s, away_east_m * share_1_s, self._climb_towards_m_s(altitude_m)

    def _climb_towards_m_s(self, altitude_m: float) -> float:
        away_m = altitude_m - self._altitude_m
        top_m_s = _CLIMB_M_S if away_m > 0.0 else _DESCENT_M_S
        speed_m_s = _approach_speed_m_s(abs(away_m), top_m_s, _VERTICAL_ACCELERATION_M_S2, _ALTITUDE_GAIN_1_S)
        return math.copysign(speed_m_s, away_m)

    def _turn_nose(
        self,
        fresh: bool,
        convergence_rad: float,
        wanted_north_m_s: float,
        wanted_east_m_s: float,
        wanted_speed_m_s: float,
        dt_s: float,
    ) -> None:
        """Turn to the yaw asked for, at the rate asked for, or along the wanted track."""
        limit_rad = _YAW_RATE_RAD_S * dt_s
        turn_rad = 0.0
        if fresh and self._setpoint is not None and self._setpoint.yaw_rad is not None:
            turn_rad = shorter_turn_rad(self._heading_rad, self._setpoint.yaw_rad - convergence_rad)
        elif fresh and self._setpoint is not None and self._setpoint.yaw_rate_rad_s is not None:
            turn_rad = self._setpoint.yaw_rate_rad_s * dt_s
        elif wanted_speed_m_s > _YAW_TRACK_MIN_M_S:
            turn_rad = shorter_turn_rad(self._heading_rad, math.atan2(wanted_east_m_s, wanted_north_m_s))
        turn_rad = _clip(turn_rad, -limit_rad, limit_rad)
        self._heading_rad = math.remainder(self._heading_rad + turn_rad, math.tau)
        self._turn_rate_rad_s = turn_rad / dt_s

    def _move(self, velocity_north_m_s: float, velocity_east_m_s: float, climb_m_s: float, dt_s: float) -> None:
        self._north_m += 0.5 * (self._velocity_north_m_s + velocity_north_m_s) * dt_s
        self._east_m += 0.5 * (self._velocity_east_m_s + velocity_east_m_s) * dt_s
        self._altitude_m += climb_m_s * dt_s
        self._velocity_north_m_s, self._velocity_east_m_s = velocity_north_m_s, velocity_east_m_s
        self._climb_m_s = climb_m_s
        if self._altitude_m > self._home.altitude_m:
            self.in_air = True
        elif climb_m_s < 0.0:
            self._touch_down()

    def _touch_down(self) -> None:
        self._altitude_m = self._home.altitude_m
        self._velocity_north_m_s = self._velocity_east_m_s = self._climb_m_s = self._turn_rate_rad_s = 0.0
        self.in_air = False
        self._setpoint = None
        if self.mode in (LAND, RTL) and self.armed:
            self.armed = False
            self._announce(self._now_s)

    # Out

    def telemetry(self, t_s: float) -> list[bytes]:
        """Return every frame that is due at `t_s`."""
        frames: list[bytes] = []
        horizon_s = t_s + _DUE_TOLERANCE_S
        for message_id, stream in self._streams.items():
            if stream.due_s <= horizon_s:
                frames.append(self._packers[message_id](t_s))
                stream.due_s += stream.period_s
                if stream.due_s <= t_s:
                    stream.due_s = t_s + stream.period_s
        return frames

    def _announce(self, t_s: float) -> bytes:
        """Return a heartbeat for whoever asked, and make one due for everybody else."""
        heartbeat = self._streams.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
        if heartbeat is not None:
            heartbeat.due_s = t_s
        return self._heartbeat(t_s)

    def _pack(self, message: Message) -> bytes:
        frame: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame

    def _geo(self) -> tuple[float, float, float]:
        """Return (lat_deg, lon_deg, convergence_rad) of where the vehicle is."""
        if self._geodetic is None:
            self._geodetic = self._frame.to_global_with_convergence(self._north_m, self._east_m)
        return self._geodetic

    def _true_heading_rad(self) -> float:
        return self._heading_rad + self._geo()[2]

    def _boot_ms(self, t_s: float) -> int:
        return round((t_s - self._start_s) * 1000.0) % 2**32

    def _heartbeat(self, t_s: float) -> bytes:
        base_mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        if self.mode in _STICK_MODES:
            base_mode |= mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        else:
            base_mode |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        if self.armed:
            base_mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        state = mavlink.MAV_STATE_ACTIVE if self.in_air else mavlink.MAV_STATE_STANDBY
        return self._pack(
            self._mav.heartbeat_encode(
                self.profile.mav_type, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, base_mode, self.mode, state
            )
        )

    def _sys_status(self, t_s: float) -> bytes:
        no_current, no_errors = -1, 0
        return self._pack(
            self._mav.sys_status_encode(
                *(_SENSORS, _SENSORS, _SENSORS, 0, _BATTERY_MV, no_current, _BATTERY_PERCENT),
                *(no_errors, no_errors, no_errors, no_errors, no_errors, no_errors),
            )
        )

    def _extended_sys_state(self, t_s: float) -> bytes:
        if self._takeoff_altitude_m is not None:
            landed = mavlink.MAV_LANDED_STATE_TAKEOFF
        elif not self.in_air:
            landed = mavlink.MAV_LANDED_STATE_ON_GROUND
        elif self.mode == LAND:
            landed = mavlink.MAV_LANDED_STATE_LANDING
        else:
            landed = mavlink.MAV_LANDED_STATE_IN_AIR
        return self._pack(self._mav.extended_sys_state_encode(mavlink.MAV_VTOL_STATE_UNDEFINED, landed))

    def _true_velocity_m_s(self) -> tuple[float, float]:
        return _rotated(*self.ground_velocity_m_s, self._geo()[2])

    def _height_mm(self) -> tuple[int, int]:
        """Return (above sea level, above home) as the wire counts them."""
        above_home_m = self._altitude_m - self._home.altitude_m
        return (
            round(_clip(self._altitude_m * 1000.0, -_INT32_MAX, _INT32_MAX)),
            round(_clip(above_home_m * 1000.0, -_INT32_MAX, _INT32_MAX)),
        )

    def _global_position_int(self, t_s: float) -> bytes:
        lat_deg, lon_deg, _ = self._geo()
        north_m_s, east_m_s = self._true_velocity_m_s()
        altitude_mm, height_mm = self._height_mm()
        return self._pack(
            self._mav.global_position_int_encode(
                self._boot_ms(t_s),
                round(lat_deg * 1e7),
                round(lon_deg * 1e7),
                altitude_mm,
                height_mm,
                _centimetres_s(north_m_s),
                _centimetres_s(east_m_s),
                _centimetres_s(-self._climb_m_s),
                round(math.degrees(self._true_heading_rad()) * 100.0) % 36000,
            )
        )

    def _local_position_ned(self, t_s: float) -> bytes:
        lat_deg, lon_deg, _ = self._geo()
        x_m, y_m = self._home_frame.to_local(lat_deg, lon_deg)
        north_m_s, east_m_s = self._true_velocity_m_s()
        z_m = self._home.altitude_m - self._altitude_m
        return self._pack(
            self._mav.local_position_ned_encode(
                self._boot_ms(t_s), x_m, y_m, z_m, north_m_s, east_m_s, -self._climb_m_s
            )
        )

    def _attitude(self, t_s: float) -> bytes:
        speed_m_s = math.hypot(self._velocity_north_m_s, self._velocity_east_m_s)
        # A coordinated turn through the air; the copter's lean is not modelled.
        roll_rad = math.atan(speed_m_s * self._turn_rate_rad_s / GRAVITY_M_S2) if self.profile.point else 0.0
        yaw_rad = math.remainder(self._true_heading_rad(), math.tau)
        return self._pack(
            self._mav.attitude_encode(self._boot_ms(t_s), roll_rad, 0.0, yaw_rad, 0.0, 0.0, self._turn_rate_rad_s)
        )

    def _gps_raw_int(self, t_s: float) -> bytes:
        lat_deg, lon_deg, _ = self._geo()
        north_m_s, east_m_s = self._true_velocity_m_s()
        speed_cm_s = min(round(math.hypot(north_m_s, east_m_s) * 100.0), 2**16 - 1)
        course_cdeg = round(math.degrees(math.atan2(east_m_s, north_m_s)) * 100.0) % 36000
        dilution, satellites = 80, 14
        return self._pack(
            self._mav.gps_raw_int_encode(
                self._boot_ms(t_s) * 1000,
                mavlink.GPS_FIX_TYPE_3D_FIX,
                round(lat_deg * 1e7),
                round(lon_deg * 1e7),
                self._height_mm()[0],
                dilution,
                dilution,
                speed_cm_s,
                course_cdeg,
                satellites,
            )
        )

    def _home_position(self, t_s: float) -> bytes:
        level = (1.0, 0.0, 0.0, 0.0)
        return self._pack(
            self._mav.home_position_encode(
                round(self._home_frame.lat_deg * 1e7),
                round(self._home_frame.lon_deg * 1e7),
                round(_clip(self._home.altitude_m * 1000.0, -_INT32_MAX, _INT32_MAX)),
                *(0.0, 0.0, 0.0),
                level,
                *(0.0, 0.0, 0.0),
            )
        )

    def _param_value(self, name: str) -> bytes:
        names = list(self.parameters)
        return self._pack(
            self._mav.param_value_encode(
                name.encode(),
                self.parameters[name],
                mavlink.MAV_PARAM_TYPE_REAL32,
                len(names),
                names.index(name),
            )
        )

    def _status_text(self, text: str) -> bytes:
        return self._pack(self._mav.statustext_encode(mavlink.MAV_SEVERITY_CRITICAL, text.encode()[:50]))


def _clip(value: float, least: float, greatest: float) -> float:
    return min(max(value, least), greatest)


def _centimetres_s(speed_m_s: float) -> int:
    return round(_clip(speed_m_s * 100.0, -_INT16_MAX, _INT16_MAX))


def _rotated(north: float, east: float, angle_rad: float) -> tuple[float, float]:
    """Return a horizontal vector turned clockwise."""
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return north * cosine - east * sine, north * sine + east * cosine


def _landing_climb_m_s(height_m: float) -> float:
    return -_DESCENT_M_S if height_m > _LAND_FINAL_M else -_LAND_FINAL_M_S


def _approach_speed_m_s(distance_m: float, top_m_s: float, acceleration_m_s2: float, gain_1_s: float) -> float:
    """Return the speed from which the vehicle can still stop at the place: proportional near it, a root further out."""
    near_m = acceleration_m_s2 / gain_1_s**2
    if distance_m <= near_m:
        return min(top_m_s, gain_1_s * distance_m)
    return min(top_m_s, math.sqrt(2.0 * acceleration_m_s2 * (distance_m - 0.5 * near_m)))
