"""What the PX4 kinds share: modes, OFFBOARD and what follows when its stream is lost, arming, answers to commands.

As measured on PX4 v1.16.1 (docs/autopilots.md). "(code)" marks what was read in its source, "(chosen)" what was neither
measured nor read. As in PX4, the mode that the pilot chose (the intended mode) is kept apart from the mode that is
flown: a lost setpoint stream changes only the latter, so OFFBOARD resumes by itself when the stream returns.

Not modelled: radio control and its loss (the measurements were made without it), geofence, battery failsafe and data
link loss (their parameters have no effect), missions, attitude setpoints.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from sim.vehicles.craft import Answer, Body, Command, Message, Parameter, Start, Surroundings
from sim.vehicles.setpoint import SANE_POSITION_M, rotated

# custom_mode: main mode << 16 | sub mode << 24 (px4_custom_mode.h).
MANUAL, ALTITUDE, POSITION, OFFBOARD, STABILIZED = 1 << 16, 2 << 16, 3 << 16, 6 << 16, 7 << 16
_AUTO = 4 << 16
"""PX4's main mode AUTO, of which the next four are sub modes."""
TAKE_OFF, HOLD, RETURN, LAND = _AUTO | 2 << 24, _AUTO | 3 << 24, _AUTO | 5 << 24, _AUTO | 6 << 24
STICK_MODES = frozenset({MANUAL, ALTITUDE, POSITION, STABILIZED})
"""Modes that are flown by the pilot's sticks."""
MODES = STICK_MODES | {OFFBOARD, TAKE_OFF, HOLD, RETURN, LAND}
"""All modes, each by its custom_mode."""
_MAIN_MODE_FACTOR, _SUB_MODE_FACTOR = 1 << 16, 1 << 24

# The mode after a lost stream, by COM_OBL_RC_ACT (parameter reference). 6 (terminate) and 7 (disarm) are not modelled.
_LOSS_MODES = {0: POSITION, 1: ALTITUDE, 2: STABILIZED, 3: RETURN, 4: LAND, 5: HOLD}
_STICKLESS_LOSS_MODES = {0: LAND, 1: HOLD, 2: RETURN}
"""The mode after a lost stream without radio control, by COM_OBL_ACT, which PX4 until 1.13 has."""

STREAM_NEEDED_S = 1.0
"""Time for which setpoints must have come before OFFBOARD is entered. Asked for earlier, the mode is entered once this
time is over (chosen: that case was not measured); without any setpoint it is refused."""

_STREAM_TOLERANCE_S = 0.05
"""Time by which a stream may be younger than STREAM_NEEDED_S when OFFBOARD is entered."""
_FORCE = 21196.0
"""Second parameter of MAV_CMD_COMPONENT_ARM_DISARM that skips every check (as MAVLink defines it)."""
_CHANGE_MODE = 1
"""Value of DO_REPOSITION's second parameter (change the mode) without which the command is unsupported (code)."""
_COMING_MOST = 64
"""Greatest number of setpoints that wait to take effect; at 50 Hz there are five."""
_TIME_TOLERANCE_S = 1e-6
"""Time by which a setpoint may be early and still takes effect."""
LANDED_AFTER_S = 1.0
"""Time on the ground before the vehicle counts as landed (chosen; about what PX4's land detector takes)."""

# POSITION_TARGET_TYPEMASK: by field, the bit that says to ignore it.
_FIELDS = (
    *(("x", 0x001), ("y", 0x002), ("z", 0x004), ("vx", 0x008), ("vy", 0x010), ("vz", 0x020)),
    *(("afx", 0x040), ("afy", 0x080), ("afz", 0x100), ("yaw", 0x400), ("yaw_rate", 0x800)),
)
_LOCAL_FRAMES = frozenset({mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_NED})
_SEA_LEVEL_FRAMES = frozenset({mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT})
_HOME_FRAMES = frozenset({mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT})

ACCEPTED = Answer((mavlink.MAV_RESULT_ACCEPTED,))
REJECTED = Answer((mavlink.MAV_RESULT_TEMPORARILY_REJECTED,))
DENIED = Answer((mavlink.MAV_RESULT_DENIED,))
UNSUPPORTED = Answer((mavlink.MAV_RESULT_UNSUPPORTED,))

COMMON_PARAMETERS = (
    Parameter("BAT_LOW_THR", 0.15, 0.12, 0.5),
    Parameter("COM_DISARM_LAND", 2.0, -1.0, 20.0),
    Parameter("COM_DISARM_PRFLT", 10.0, -1.0, 3600.0),
    Parameter("COM_LOW_BAT_ACT", 0.0, 0.0, 3.0, True),
    Parameter("COM_OBL_RC_ACT", 0.0, 0.0, 7.0, True),
    Parameter("COM_OF_LOSS_T", 1.0, 0.0, 60.0),
    Parameter("COM_RCL_EXCEPT", 0.0, 0.0, 31.0, True),
    Parameter("COM_RC_IN_MODE", 3.0, 0.0, 8.0, True),
    Parameter("GF_ACTION", 2.0, 0.0, 5.0, True),
    Parameter("GF_MAX_HOR_DIST", 0.0, 0.0, 10000.0),
    Parameter("GF_MAX_VER_DIST", 0.0, 0.0, 10000.0),
    Parameter("MAV_SYS_ID", 1.0, 1.0, 250.0, True),
    Parameter("NAV_DLL_ACT", 0.0, 0.0, 6.0, True),
    Parameter("NAV_RCL_ACT", 2.0, 1.0, 6.0, True),
)
"""Parameters of both PX4 kinds, with defaults and ranges from PX4's parameter reference."""


@dataclass(frozen=True, slots=True)
class Offboard:
    """What a setpoint asks for, along the plane's grid; None stands for a field that it ignores or gives as NaN."""

    north_m: float | None = None
    east_m: float | None = None
    altitude_m: float | None = None
    """Altitude above sea level."""
    velocity_m_s: tuple[float, float] | None = None
    """Velocity (north, east) over the ground."""
    climb_m_s: float | None = None
    acceleration_m_s2: tuple[float, float] | None = None
    yaw_rad: float | None = None
    yaw_rate_rad_s: float | None = None


def understood(message: Message, body: Body, around: Surroundings) -> Offboard | None:
    """Return what a SET_POSITION_TARGET_* asks for; None if PX4 drops it, so that it does not count for the stream.

    PX4 drops unknown frames and setpoints with neither a position nor a velocity. (A real one accepts an acceleration
    alone, which is not modelled.)
    """
    given = {
        name: float(getattr(message, name))
        for name, bit in _FIELDS
        if not message.type_mask & bit and hasattr(message, name) and math.isfinite(getattr(message, name))
    }
    if any(abs(value) > SANE_POSITION_M for value in given.values()):
        return None
    frame = message.coordinate_frame
    if message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT":
        north_m, east_m, altitude_m = _global_place(message, around)
        if frame not in _SEA_LEVEL_FRAMES | _HOME_FRAMES:
            return None
    elif frame in _LOCAL_FRAMES:
        north_m, east_m, altitude_m = _local_place(given, frame, body, around)
    else:
        return None
    velocity = _pair(given, "vx", "vy")
    if (north_m is None or east_m is None) and altitude_m is None and velocity is None and "vz" not in given:
        return None
    # Body velocities are relative to the nose, the others to true north; here they become relative to the plane's grid.
    turn_rad = body.heading_rad if frame == mavlink.MAV_FRAME_BODY_NED else -around.convergence_rad
    acceleration = _pair(given, "afx", "afy")
    yaw_rad = given.get("yaw")
    return Offboard(
        north_m,
        east_m,
        altitude_m,
        None if velocity is None else rotated(*velocity, turn_rad),
        None if "vz" not in given else -given["vz"],
        None if acceleration is None else rotated(*acceleration, turn_rad),
        None if yaw_rad is None else math.remainder(yaw_rad - around.convergence_rad, math.tau),
        given.get("yaw_rate"),
    )


def _local_place(
    given: Mapping[str, float], frame: int, body: Body, around: Surroundings
) -> tuple[float | None, float | None, float | None]:
    """Return the plane's north and east and the altitude; all None in a body frame, whose place PX4 ignores (code)."""
    if frame != mavlink.MAV_FRAME_LOCAL_NED:
        return None, None, None
    altitude_m = None if "z" not in given else around.origin_altitude_m - given["z"]
    place = _pair(given, "x", "y")
    if place is None:
        return None, None, altitude_m
    return *around.local_to_plane(*place), altitude_m


def _global_place(message: Message, around: Surroundings) -> tuple[float | None, float | None, float | None]:
    altitude_m: float | None = None
    if not message.type_mask & 0x004 and math.isfinite(message.alt) and abs(message.alt) < SANE_POSITION_M:
        altitude_m = message.alt + (around.home.altitude_m if message.coordinate_frame in _HOME_FRAMES else 0.0)
    if message.type_mask & 0x003 or abs(message.lat_int) > 90e7 or abs(message.lon_int) > 180e7:
        return None, None, altitude_m
    return *around.to_plane(message.lat_int * 1e-7, message.lon_int * 1e-7), altitude_m


def _pair(given: Mapping[str, float], first: str, second: str) -> tuple[float, float] | None:
    return (given[first], given[second]) if first in given and second in given else None


@dataclass(frozen=True, slots=True)
class Reposition:
    """The place at which HOLD loiters: in the plane, with an altitude above sea level."""

    north_m: float
    east_m: float
    altitude_m: float
    radius_m: float | None = None
    """Loiter radius of a plane; None: NAV_LOITER_RAD."""


@dataclass(slots=True)
class Hold:
    """What the modes other than OFFBOARD fly to: a place, and at which speed."""

    place: Reposition
    is_repositioned: bool = False
    """Whether a DO_REPOSITION gave the place, rather than the vehicle's position when the mode began."""
    speed_m_s: float | None = None
    """Speed that a command asked for; None: the cruise speed."""


@dataclass(slots=True)
class _GroundTime:
    """Since when an armed vehicle stands on the ground, and whether it has flown since it was armed."""

    has_flown: bool
    since_s: float | None = None


class OffboardStream:
    """The stream of setpoints for OFFBOARD: when it began, when the last one came, and which one is flown."""

    def __init__(self, reaction_s: float, begins_streamed: bool) -> None:
        """Begin without a stream, or with one that is old enough; setpoints take effect after `reaction_s`."""
        self.asked: Offboard | None = None
        """The newest setpoint that has taken effect."""
        self.is_awaited = False
        """Whether OFFBOARD was asked for and will be entered once the stream is old enough."""
        self._reaction_s = reaction_s
        self._begins_streamed = begins_streamed
        self._coming: deque[tuple[float, Offboard]] = deque(maxlen=_COMING_MOST)
        self._began_s: float | None = None
        self._heard_s: float | None = None

    def take(self, asked: Offboard, now_s: float, loss_s: float) -> None:
        """Take a setpoint; it begins a new stream if the one before came more than `loss_s` ago."""
        if self._began_s is None or self.is_lost(now_s, loss_s):
            self._began_s = now_s
            # Setpoints of the stream before must not be flown while the new one's wait.
            self._coming.clear()
            self.asked = asked
        self._heard_s = now_s
        self._coming.append((now_s + self._reaction_s, asked))

    def step(self, now_s: float) -> None:
        """Let the setpoints that are due at `now_s` take effect."""
        while self._coming and self._coming[0][0] <= now_s + _TIME_TOLERANCE_S:
            self.asked = self._coming.popleft()[1]
        if self._begins_streamed:
            self._begins_streamed = False
            self._began_s = now_s - STREAM_NEEDED_S
            self._heard_s = now_s

    def is_lost(self, now_s: float, loss_s: float) -> bool:
        """Return whether no setpoint came for longer than `loss_s`."""
        return self._heard_s is None or now_s - self._heard_s > loss_s

    def is_old_enough(self) -> bool:
        """Return whether setpoints have come for STREAM_NEEDED_S, so that OFFBOARD can be entered."""
        if self._began_s is None or self._heard_s is None:
            return False
        return self._heard_s - self._began_s >= STREAM_NEEDED_S - _STREAM_TOLERANCE_S

    def forget(self) -> None:
        """Forget every setpoint, and that OFFBOARD was asked for."""
        self.asked = None
        self._coming.clear()
        self._began_s = self._heard_s = None
        self._begins_streamed = self.is_awaited = False


OnCommand = Callable[[Command, Surroundings, float], Answer]
"""Handler of a command, given the surroundings and the time in seconds."""


class Px4:
    """The base class of the PX4 crafts: a subclass adds its motion."""

    kind: str
    mav_type: int
    mav_autopilot: int = mavlink.MAV_AUTOPILOT_PX4
    announces = False
    lists_adsb = False
    """PX4 sends HEARTBEAT once a second in any case, so a changed mode shows up to a second late."""
    ready = True
    """Start-up is modelled for the ArduPilot kinds alone."""
    warned = False
    """PX4's warnings do not change HEARTBEAT's state."""
    longest_step_s: float
    reaction_s: float
    """Dead time from a setpoint to its first effect."""
    parameters: tuple[Parameter, ...]

    def __init__(self, start: Start) -> None:
        """Begin in OFFBOARD, as if setpoints had come until now, if `start` says guided; else in HOLD."""
        self.body: Body = start.body
        self.armed = start.armed
        self.in_air = start.in_air
        self.failsafe = False
        self.mode = self._intended = OFFBOARD if start.guided else HOLD
        self.values = {parameter.name: parameter.default for parameter in self.parameters}
        self.texts: list[str] = []
        self._stream = OffboardStream(self.reaction_s, begins_streamed=start.guided)
        self._ground = _GroundTime(has_flown=start.in_air)
        self._hold = Hold(self._here())
        self._commands: dict[int, OnCommand] = {
            mavlink.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._take_off,
            mavlink.MAV_CMD_NAV_LAND: lambda command, around, now_s: self._intend(LAND, now_s),
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda command, around, now_s: self._intend(RETURN, now_s),
            mavlink.MAV_CMD_NAV_LOITER_UNLIM: lambda command, around, now_s: self._intend(HOLD, now_s),
            mavlink.MAV_CMD_DO_REPOSITION: self._reposition,
            mavlink.MAV_CMD_DO_CHANGE_SPEED: self._change_speed,
        }

    def base_mode(self) -> int:
        """Return HEARTBEAT.base_mode, which follows from the mode that is flown (code)."""
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if self.mode in STICK_MODES:
            flags |= mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        else:
            flags |= mavlink.MAV_MODE_FLAG_AUTO_ENABLED | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        if self.mode != MANUAL:
            flags |= mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        if self.armed:
            flags |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        return int(flags)

    def landed_state(self) -> int:
        """Return EXTENDED_SYS_STATE.landed_state."""
        if not self.in_air:
            return int(mavlink.MAV_LANDED_STATE_ON_GROUND)
        if self.mode == TAKE_OFF:
            return int(mavlink.MAV_LANDED_STATE_TAKEOFF)
        return int(mavlink.MAV_LANDED_STATE_LANDING if self.mode == LAND else mavlink.MAV_LANDED_STATE_IN_AIR)

    def command(self, command: Command, around: Surroundings, now_s: float) -> Answer | None:
        """Answer a command; return None for a command that this kind does not handle."""
        handler = self._commands.get(command.command)
        return None if handler is None else handler(command, around, now_s)

    def setpoint(self, message: Message, around: Surroundings, now_s: float) -> None:
        """Take a setpoint in any mode: OFFBOARD needs a stream before it is entered, and resumes with it."""
        if message.get_type() == "SET_ATTITUDE_TARGET":
            return
        asked = understood(message, self.body, around)
        if asked is not None:
            self._stream.take(asked, now_s, self.values["COM_OF_LOSS_T"])

    def heartbeat_heard(self, system: int, component: int, mav_type: int, now_s: float) -> None:
        """Ignore a heartbeat: the data link loss failsafe (NAV_DLL_ACT) is off by default and not modelled."""

    def watch(self, now_s: float, has_fix: bool, battery_v: float, around: Surroundings) -> None:
        """Ignore fix and battery: a kind for which the failsafe was measured overrides this."""

    def reboot(self, now_s: float) -> None:
        """Restart in HOLD without setpoints; a vehicle in the air stays armed (chosen)."""
        self._stream.forget()
        self.failsafe = False
        self._intended = HOLD
        self._fly_mode(HOLD)

    # Modes

    def _mind_time(self, now_s: float) -> None:
        """Do what is due by time alone: enter OFFBOARD, its failsafe, disarming on the ground."""
        self._stream.step(now_s)
        if self._stream.is_awaited:
            if self._stream_lost(now_s):
                self._stream.is_awaited = False
            elif self._stream.is_old_enough():
                self._stream.is_awaited = False
                self._intended = OFFBOARD
        mode = self._intended
        self.failsafe = self.armed and self._intended == OFFBOARD and self._stream_lost(now_s)
        if self.failsafe:
            mode = _LOSS_MODES.get(int(self.values["COM_OBL_RC_ACT"]), HOLD)
            if "COM_OBL_ACT" in self.values:
                mode = _STICKLESS_LOSS_MODES.get(int(self.values["COM_OBL_ACT"]), HOLD)
        if self.armed and self._is_blind(now_s):
            self.failsafe, mode = True, LAND
        if mode != self.mode:
            self._fly_mode(mode)
        self._mind_ground(now_s)

    def _is_blind(self, now_s: float) -> bool:
        """Return whether the autopilot has no position to fly by; a kind for which it was measured overrides this."""
        return False

    def _mind_ground(self, now_s: float) -> None:
        if self.in_air or not self.armed:
            self._ground.since_s = None
            self._ground.has_flown = self.in_air
            return
        if self._ground.since_s is None:
            self._ground.since_s = now_s
        # As on the real one, neither landing nor disarming changes the mode.
        name = "COM_DISARM_LAND" if self._ground.has_flown else "COM_DISARM_PRFLT"
        waited_s = now_s - self._ground.since_s - (LANDED_AFTER_S if self._ground.has_flown else 0.0)
        if waited_s >= self.values[name] > 0.0 and self.mode != TAKE_OFF:
            self.armed = False

    def _stream_lost(self, now_s: float) -> bool:
        return self._stream.is_lost(now_s, self.values["COM_OF_LOSS_T"])

    def _here(self) -> Reposition:
        return Reposition(self.body.north_m, self.body.east_m, self.body.altitude_m)

    def _fly_mode(self, mode: int) -> None:
        """Fly another mode from now on; its hold position is the present one."""
        self.mode = mode
        self._hold = Hold(self._here())

    def _intend(self, mode: int, now_s: float) -> Answer:
        """Change the intended mode, the one that the pilot chose."""
        self._stream.is_awaited = False
        if mode == OFFBOARD and (self.armed or self.in_air):
            if self._stream_lost(now_s):
                return REJECTED
            if not self._stream.is_old_enough():
                self._stream.is_awaited = True
                return ACCEPTED
        if mode in STICK_MODES and self.armed:
            # There is no radio control to fly it by.
            return REJECTED
        self._intended = mode
        self.failsafe = False
        if mode != self.mode:
            self._fly_mode(mode)
        return ACCEPTED

    # Commands

    def _do_set_mode(self, command: Command, around: Surroundings, now_s: float) -> Answer:
        if not (math.isfinite(command.param1) and math.isfinite(command.param2)):
            return _twice(DENIED)
        if not int(command.param1) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return _twice(DENIED)
        sub_mode = command.param3 if math.isfinite(command.param3) else 0.0
        mode = int(command.param2) * _MAIN_MODE_FACTOR + int(sub_mode) * _SUB_MODE_FACTOR
        if mode not in MODES:
            return _twice(DENIED)
        if mode == TAKE_OFF:
            return _twice(self._take_off_to(around.home.altitude_m + self.values["MIS_TAKEOFF_ALT"], now_s))
        return _twice(self._intend(mode, now_s))

    def _arm_disarm(self, command: Command, around: Surroundings, now_s: float) -> Answer:
        if command.param1 not in (0.0, 1.0):
            return UNSUPPORTED
        arm = command.param1 == 1.0
        if arm == self.armed:
            return ACCEPTED
        forced = command.param2 == _FORCE
        if arm and not forced and not self._armable(now_s):
            return Answer(REJECTED.results, ("Arming denied: switch to another mode first",))
        if not arm and self.in_air and not forced:
            return Answer(REJECTED.results, ("Disarming denied: not landed",))
        self.armed = arm
        return ACCEPTED

    def _armable(self, now_s: float) -> bool:
        """Return whether the mode allows arming: not in LAND or RETURN, nor in OFFBOARD without a stream."""
        if self.mode == OFFBOARD:
            return not self._stream_lost(now_s)
        return self.mode not in (LAND, RETURN)

    def _take_off(self, command: Command, around: Surroundings, now_s: float) -> Answer:
        altitude_m = command.z
        if not math.isfinite(altitude_m):
            altitude_m = around.home.altitude_m + self.values["MIS_TAKEOFF_ALT"]
        return self._take_off_to(altitude_m, now_s)

    def _take_off_to(self, altitude_m: float, now_s: float) -> Answer:
        if abs(altitude_m) > SANE_POSITION_M or self.in_air:
            return REJECTED
        answer = self._intend(TAKE_OFF, now_s)
        here = self._here()
        self._hold.place = Reposition(here.north_m, here.east_m, max(altitude_m, here.altitude_m))
        return answer

    def _reposition(self, command: Command, around: Surroundings, now_s: float) -> Answer:
        """Fly to a place and hold there; a coordinate that is NaN stays as it is."""
        if not math.isfinite(command.param2) or int(command.param2) != _CHANGE_MODE:
            return UNSUPPORTED
        scale = 1e-7 if command.int_frame else 1.0
        lat_deg, lon_deg = command.x * scale, command.y * scale
        altitude_m = command.z + (around.home.altitude_m if command.frame in _HOME_FRAMES else 0.0)
        before = self._hold.place if self.mode == HOLD else self._here()
        self._intend(HOLD, now_s)
        north_m, east_m = before.north_m, before.east_m
        if abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0:
            north_m, east_m = around.to_plane(lat_deg, lon_deg)
        radius_m = abs(command.param3)
        self._hold.place = Reposition(
            north_m,
            east_m,
            altitude_m if abs(altitude_m) < SANE_POSITION_M else before.altitude_m,
            radius_m if 0.0 < radius_m < SANE_POSITION_M else None,
        )
        self._hold.is_repositioned = True
        if 0.0 < command.param1 < SANE_POSITION_M:
            self._hold.speed_m_s = command.param1
        return ACCEPTED

    def _change_speed(self, command: Command, around: Surroundings, now_s: float) -> Answer:
        """Acknowledge in every mode, and change the speed in HOLD alone."""
        if self.mode == HOLD:
            self._hold.speed_m_s = command.param2 if 0.0 < command.param2 < SANE_POSITION_M else None
        return ACCEPTED

    def _touch_down(self, ground_m: float) -> None:
        body = self.body
        body.altitude_m = ground_m
        body.velocity_north_m_s = body.velocity_east_m_s = body.climb_m_s = 0.0
        body.turn_rate_rad_s = body.roll_rad = body.airspeed_m_s = 0.0
        self.in_air = False


def _twice(answer: Answer) -> Answer:
    """Acknowledge a DO_SET_MODE twice, as PX4 does: the first answer confirms receipt, the second is the result."""
    return Answer((mavlink.MAV_RESULT_ACCEPTED, *answer.results), answer.texts)
