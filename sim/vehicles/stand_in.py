"""The stand-in autopilot: MAVLink `common` in and out on a given clock, without sockets.

The companion must be tested against an autopilot that says no, brakes on silence and lies late, long before a real one
is at hand. This one behaves as the real ones were measured to (docs/autopilots.md): what they share on the wire is
here, what differs is the craft's. The truth lives in the mission's plane; whatever goes over the wire is relative to
local true north, so everything is turned by the plane's convergence on its way in and out.

Wind is what the owner sets before each step and stays constant within it.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from companion.geo.local_frame import LocalFrame
from sim.vehicles.craft import Answer, Body, Command, Craft, Home, Message, Parameter, Start, Surroundings
from sim.vehicles.sensors import Belief, Sensors
from sim.vehicles.setpoint import clip, rotated

_AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
)
_FULL_CELL_MV, _EMPTY_CELL_MV, _CELLS = 4200, 3500, 3
_SILENT_AFTER_REBOOT_S = 2.0
"""Chosen: a real one is as long without a word, or longer."""
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_VERSION = (4 << 24) | (7 << 16)
"""Of ArduPilot's development tree of October 2025, which was measured."""
_PX4_VERSION = (1 << 24) | (16 << 16) | (1 << 8) | 255
_INT16_MAX, _INT32_MAX, _UINT16_MAX = 2**15 - 1, 2**31 - 1, 2**16 - 1
_NO_DILUTION = _UINT16_MAX
_DUE_TOLERANCE_S = 1e-6
_SHORTEST_INTERVAL_S = 0.02
_TEXT_BYTES = 50

DEFAULT_RATES_HZ: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 4.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 4.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 2.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.2,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.2,
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

_SETPOINTS = frozenset({"SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT", "SET_ATTITUDE_TARGET"})


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


@dataclass(slots=True)
class _Stream:
    period_s: float
    due_s: float


@dataclass(frozen=True, slots=True)
class _Seen:
    """What is told at one moment: what the autopilot believes, where that is on the earth, by which clock."""

    belief: Belief
    lat_deg: float
    lon_deg: float
    convergence_rad: float
    boot_ms: int


def parse(datagram: bytes) -> list[Message]:
    """Return the MAVLink messages of one datagram, damaged and unknown ones included as the parser names them."""
    # A parser of its own for each datagram: a damaged one must not swallow the next.
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    return list(parser.parse_buffer(datagram) or ())


class StandIn:
    """One stand-in autopilot. Deterministic: its state follows from what it was given and when."""

    def __init__(
        self,
        build: Callable[[Start], Craft],
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
        seed: int = 1,
    ) -> None:
        """Place a vehicle of a kind: plane metres, altitude above sea level, heading from grid north.

        No `home` means here; in the air and not guided it holds where it is. The speed of what flies through the air
        is through the air. The clock of `time_boot_ms` begins at `start_s`; `seed` draws the receiver's noise. Raises
        ValueError for a point on the ground: it cannot stop.
        """
        self.system_id = system_id
        self._frame = frame
        self._home = home if home is not None else Home(north_m, east_m, altitude_m)
        home_lat_deg, home_lon_deg = frame.to_global(self._home.north_m, self._home.east_m)
        self._home_frame = LocalFrame(home_lat_deg, home_lon_deg)
        self._start_s = start_s
        self._now_s = start_s
        body = Body(
            north_m=north_m,
            east_m=east_m,
            altitude_m=altitude_m,
            heading_rad=heading_rad,
            velocity_north_m_s=speed_m_s * math.cos(heading_rad),
            velocity_east_m_s=speed_m_s * math.sin(heading_rad),
            airspeed_m_s=speed_m_s,
        )
        self.craft = build(Start(body, self._home, in_air=in_air, armed=armed, guided=guided))
        self.sensors = Sensors(seed, system_id)
        self.battery_percent = 100.0
        self.battery_drain_percent_s = 0.0
        """Of the time that it is armed."""
        self._wind_m_s = (0.0, 0.0)
        self._ranges = {parameter.name: parameter for parameter in self.craft.parameters}
        self._geodetic: tuple[float, float, float] | None = None
        self._silent_until_s = -math.inf
        self._frozen: _Seen | None = None
        self._corrupt = False
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=_AUTOPILOT_COMPONENT)
        self._packers: dict[int, Callable[[float], Message]] = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._extended_sys_state,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw_int,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position_int,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position_ned,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: self._vfr_hud,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self._home_position,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: self._battery_status,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._autopilot_version,
        }
        self._default_rates_hz = dict(rates_hz)
        self._streams: dict[int, _Stream] = {}
        self._begin_streams(start_s)
        self._handlers: dict[str, Callable[[Message, float], list[bytes]]] = {
            "COMMAND_LONG": self._on_command_long,
            "COMMAND_INT": self._on_command_int,
            "SET_MODE": self._on_set_mode,
            "PARAM_SET": self._on_param_set,
            "PARAM_REQUEST_READ": self._on_param_request_read,
            "PARAM_REQUEST_LIST": self._on_param_request_list,
            "MISSION_REQUEST_LIST": self._on_mission_request_list,
            **dict.fromkeys(_SETPOINTS, self._on_setpoint),
        }

    # What it is and does

    @property
    def kind(self) -> str:
        """Which autopilot it stands in for."""
        return self.craft.kind

    @property
    def mode(self) -> int:
        """As in HEARTBEAT.custom_mode."""
        return self.craft.mode

    @property
    def armed(self) -> bool:
        """Whether its motors may run."""
        return self.craft.armed

    @property
    def in_air(self) -> bool:
        """Whether it flies."""
        return self.craft.in_air

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters as they are now, by name; the owner may write into them."""
        return self.craft.values

    @property
    def truth(self) -> Truth:
        """Where the vehicle really is after the last step."""
        body = self.craft.body
        speed_m_s = math.hypot(*self.ground_velocity_m_s)
        return Truth(body.north_m, body.east_m, body.altitude_m, body.heading_rad, speed_m_s)

    @property
    def ground_velocity_m_s(self) -> tuple[float, float]:
        """Velocity (north, east) over the ground along the grid, in the wind as it is set now."""
        return self.craft.body.velocity_north_m_s, self.craft.body.velocity_east_m_s

    @property
    def wind_m_s(self) -> tuple[float, float]:
        """North and east along the grid: where the air moves to, not where it comes from. The owner's to set."""
        return self._wind_m_s

    @wind_m_s.setter
    def wind_m_s(self, wind_m_s: tuple[float, float]) -> None:
        self._wind_m_s = wind_m_s
        if self.craft.in_air:
            self.craft.blow(wind_m_s)

    # Faults, for tests

    def freeze_telemetry(self, frozen: bool) -> None:
        """Let positions and attitude repeat what they are now, clock included, while heartbeats go on; or end that."""
        self._frozen = self._look(self._now_s) if frozen else None

    def corrupt_telemetry(self, corrupt: bool) -> None:
        """Let the floats of ATTITUDE, LOCAL_POSITION_NED and VFR_HUD be NaN."""
        self._corrupt = corrupt

    def lose_gps(self, lost: bool) -> None:
        """Let the receiver lose its fix: positions go on and leave the truth slowly; or find it again."""
        self.sensors.lose_fix(lost, self._now_s)

    def reboot(self, t_s: float) -> None:
        """Start the autopilot anew: a while without a word, the clock from 0, what was asked forgotten."""
        self.step_to(t_s)
        self.craft.reboot(t_s)
        self._start_s = t_s
        self._silent_until_s = t_s + _SILENT_AFTER_REBOOT_S
        self._begin_streams(self._silent_until_s)

    # In

    def receive(self, datagram: bytes, t_s: float) -> list[bytes]:
        """Take one datagram at the time `t_s` and return the replies as frames. Never raises, whatever the bytes."""
        return self.take(parse(datagram), t_s)

    def take(self, messages: Sequence[Message], t_s: float) -> list[bytes]:
        """Take parsed messages at the time `t_s` and return the replies, for the link they came from, as frames."""
        if t_s < self._silent_until_s:
            return []
        replies: list[bytes] = []
        for message in messages:
            name = message.get_type()
            if name == "HEARTBEAT":
                self.craft.heartbeat_heard(message.get_srcSystem(), message.get_srcComponent(), message.type, t_s)
                continue
            # Bad data and unknown messages, which the parser returns unchecked, have no handler.
            handler = self._handlers.get(name)
            if (
                handler is not None
                and message.target_system in (0, self.system_id)
                and getattr(message, "target_component", 0) in (0, _AUTOPILOT_COMPONENT)
            ):
                replies += handler(message, t_s)
        return replies

    def _on_command_long(self, message: Message, t_s: float) -> list[bytes]:
        command = Command(
            message.command,
            *(message.param1, message.param2, message.param3, message.param4),
            *(message.param5, message.param6, message.param7),
            int_frame=False,
        )
        return self._answer(command, message, t_s)

    def _on_command_int(self, message: Message, t_s: float) -> list[bytes]:
        command = Command(
            message.command,
            *(message.param1, message.param2, message.param3, message.param4),
            *(message.x, message.y, message.z),
            int_frame=True,
            frame=message.frame,
        )
        return self._answer(command, message, t_s)

    def _answer(self, command: Command, message: Message, t_s: float) -> list[bytes]:
        answer, told = self._obey(command, t_s)
        frames: list[bytes] = []
        if answer is None:
            result, requested = self._serve(command, t_s)
            answer, told = Answer((result,)), requested
        for result in answer.results:
            ack = self._mav.command_ack_encode(
                command.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
            )
            frames.append(self._pack(ack))
        frames += [self._status_text(text, mavlink.MAV_SEVERITY_CRITICAL) for text in answer.texts]
        return frames + told

    def _obey(self, command: Command, t_s: float) -> tuple[Answer | None, list[bytes]]:
        """Let the craft answer; return that and what a change has to be told by at once."""
        before = self._standing()
        answer = self.craft.command(command, self._around(), t_s)
        return answer, self._announced(before, t_s)

    def _serve(self, command: Command, t_s: float) -> tuple[int, list[bytes]]:
        """Answer what every autopilot answers."""
        if command.command == mavlink.MAV_CMD_REQUEST_MESSAGE:
            packer = self._packers.get(int(command.param1)) if math.isfinite(command.param1) else None
            if packer is None:
                return mavlink.MAV_RESULT_UNSUPPORTED, []
            return mavlink.MAV_RESULT_ACCEPTED, [self._pack(packer(t_s))]
        if command.command == mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
            return mavlink.MAV_RESULT_ACCEPTED, [self._pack(self._autopilot_version(t_s))]
        if command.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return self._set_message_interval(command, t_s), []
        return mavlink.MAV_RESULT_UNSUPPORTED, []

    def _set_message_interval(self, command: Command, t_s: float) -> int:
        message_id, interval_us = command.param1, command.param2
        if not (math.isfinite(message_id) and math.isfinite(interval_us)):
            return int(mavlink.MAV_RESULT_DENIED)
        # An unknown message is accepted too: a ground station asks for much that it can do without.
        if message_id in self._packers:
            rate_hz = 1e6 / interval_us if interval_us > 0.0 else 0.0
            if interval_us == 0.0:
                rate_hz = self._default_rates_hz.get(int(message_id), 0.0)
            self._streams.pop(int(message_id), None)
            if rate_hz > 0.0:
                self._streams[int(message_id)] = _Stream(max(1.0 / rate_hz, _SHORTEST_INTERVAL_S), t_s)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _on_set_mode(self, message: Message, t_s: float) -> list[bytes]:
        if not message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return []
        mode, sub_mode = message.custom_mode, 0
        if self.craft.mav_autopilot == mavlink.MAV_AUTOPILOT_PX4:
            mode, sub_mode = message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24
        parameters = (mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, mode, sub_mode, 0.0, 0.0, 0.0, 0.0)
        return self._obey(Command(mavlink.MAV_CMD_DO_SET_MODE, *parameters, int_frame=False), t_s)[1]

    def _on_setpoint(self, message: Message, t_s: float) -> list[bytes]:
        self.craft.setpoint(message, self._around(), t_s)
        return []

    def _on_mission_request_list(self, message: Message, t_s: float) -> list[bytes]:
        asker = message.get_srcSystem(), message.get_srcComponent()
        return [self._pack(self._mav.mission_count_encode(*asker, 0, message.mission_type))]

    def _on_param_set(self, message: Message, t_s: float) -> list[bytes]:
        allowed = self._ranges.get(message.param_id)
        if allowed is None:
            return []
        value = message.param_value
        if self._bytewise(allowed):
            value = float(struct.unpack("<i", struct.pack("<f", value))[0])
        # A refusal shows, as on the real one, in the old value coming back.
        if allowed.least <= value <= allowed.greatest:
            self.craft.values[allowed.name] = value
        return [self._param_value(allowed.name)]

    def _on_param_request_read(self, message: Message, t_s: float) -> list[bytes]:
        names = list(self.craft.values)
        name = message.param_id
        if 0 <= message.param_index < len(names):
            name = names[message.param_index]
        return [self._param_value(name)] if name in self.craft.values else []

    def _on_param_request_list(self, message: Message, t_s: float) -> list[bytes]:
        return [self._param_value(name) for name in self.craft.values]

    # Motion

    def step_to(self, t_s: float) -> None:
        """Advance the truth to the time `t_s`; an earlier time than the last changes nothing."""
        if t_s <= self._now_s:
            return
        before = self._standing()
        around = self._around()
        if self.craft.armed:
            drained = self.battery_drain_percent_s * (t_s - self._now_s)
            self.battery_percent = max(0.0, self.battery_percent - drained)
        while self._now_s < t_s:
            until_s = min(t_s, self._now_s + self.craft.longest_step_s)
            self.craft.step(self._now_s, until_s - self._now_s, around)
            self._now_s = until_s
            self.sensors.remember(self.craft.body, until_s)
        self._geodetic = None
        self._announced(before, t_s)

    def _around(self) -> Surroundings:
        return Surroundings(self._wind_m_s, self._home, self._geo()[2], self._frame.to_local, self._local_to_plane)

    def _local_to_plane(self, north_m: float, east_m: float) -> tuple[float, float]:
        return self._frame.to_local(*self._home_frame.to_global(north_m, east_m))

    # Out

    def telemetry(self, t_s: float) -> list[bytes]:
        """Return every frame that is due at `t_s`."""
        if t_s < self._silent_until_s - _DUE_TOLERANCE_S:
            return []
        frames = [self._status_text(text, mavlink.MAV_SEVERITY_INFO) for text in self.craft.texts]
        self.craft.texts.clear()
        horizon_s = t_s + _DUE_TOLERANCE_S
        for message_id, stream in self._streams.items():
            # There is no home before the autopilot has come up.
            if stream.due_s <= horizon_s and (self._ready or message_id != mavlink.MAVLINK_MSG_ID_HOME_POSITION):
                frames.append(self._pack(self._packers[message_id](t_s)))
                stream.due_s += stream.period_s
                if stream.due_s <= t_s:
                    stream.due_s = t_s + stream.period_s
        return frames

    @property
    def _ready(self) -> bool:
        # Only the ArduPilot kinds take their time to come up.
        return bool(getattr(self.craft, "ready", True))

    def _begin_streams(self, t_s: float) -> None:
        self._streams = {
            message_id: _Stream(1.0 / rate_hz, t_s)
            for message_id, rate_hz in self._default_rates_hz.items()
            if rate_hz > 0.0
        }

    def _standing(self) -> tuple[int, bool, bool]:
        return self.craft.mode, self.craft.armed, self.craft.failsafe

    def _announced(self, before: tuple[int, bool, bool], t_s: float) -> list[bytes]:
        """Return a heartbeat for whoever changed something, and make one due for everybody else."""
        if before == self._standing() or not self.craft.announces:
            return []
        heartbeat = self._streams.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
        if heartbeat is not None:
            heartbeat.due_s = t_s
        return [self._pack(self._heartbeat(t_s))]

    def _pack(self, message: Message) -> bytes:
        frame: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame

    def _geo(self) -> tuple[float, float, float]:
        """Return (lat_deg, lon_deg, convergence_rad) of where the vehicle is."""
        if self._geodetic is None:
            body = self.craft.body
            self._geodetic = self._frame.to_global_with_convergence(body.north_m, body.east_m)
        return self._geodetic

    def _look(self, t_s: float) -> _Seen:
        if self._frozen is not None:
            return self._frozen
        belief = self.sensors.believe(self.craft.body, t_s)
        if self.sensors.perfect:
            place = self._geo()
        else:
            place = self._frame.to_global_with_convergence(belief.body.north_m, belief.body.east_m)
        return _Seen(belief, *place, round((t_s - self._start_s) * 1000.0) % 2**32)

    def _float(self, value: float) -> float:
        return math.nan if self._corrupt else value

    def _heartbeat(self, t_s: float) -> Message:
        state = mavlink.MAV_STATE_ACTIVE if self.craft.in_air else mavlink.MAV_STATE_STANDBY
        if self.craft.failsafe:
            state = mavlink.MAV_STATE_CRITICAL
        return self._mav.heartbeat_encode(
            self.craft.mav_type, self.craft.mav_autopilot, self.craft.base_mode(), self.craft.mode, state
        )

    def _sys_status(self, t_s: float) -> Message:
        health = _SENSORS
        if not self._ready:
            health &= ~(mavlink.MAV_SYS_STATUS_PREARM_CHECK | mavlink.MAV_SYS_STATUS_SENSOR_GPS)
        if not self._look(t_s).belief.has_fix:
            health &= ~mavlink.MAV_SYS_STATUS_SENSOR_GPS
        no_current, no_errors = -1, 0
        return self._mav.sys_status_encode(
            *(_SENSORS, _SENSORS, health, 0, self._battery_mv(), no_current, round(self.battery_percent)),
            *(no_errors, no_errors, no_errors, no_errors, no_errors, no_errors),
        )

    def _battery_mv(self) -> int:
        cell_mv = _EMPTY_CELL_MV + (_FULL_CELL_MV - _EMPTY_CELL_MV) * clip(self.battery_percent, 0.0, 100.0) / 100.0
        return round(_CELLS * cell_mv)

    def _battery_status(self, t_s: float) -> Message:
        cells_mv = [self._battery_mv() // _CELLS] * _CELLS + [_UINT16_MAX] * (10 - _CELLS)
        unknown_temperature, unknown = _INT16_MAX, -1
        return self._mav.battery_status_encode(
            *(0, mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_TYPE_LIPO, unknown_temperature, cells_mv),
            *(unknown, unknown, unknown, round(self.battery_percent)),
        )

    def _autopilot_version(self, t_s: float) -> Message:
        is_px4 = self.craft.mav_autopilot == mavlink.MAV_AUTOPILOT_PX4
        version = _PX4_VERSION if is_px4 else _VERSION
        no_hash = (0,) * 8
        return self._mav.autopilot_version_encode(
            _CAPABILITIES, version, 0, 0, 0, no_hash, no_hash, no_hash, 0, 0, self.system_id
        )

    def _extended_sys_state(self, t_s: float) -> Message:
        return self._mav.extended_sys_state_encode(mavlink.MAV_VTOL_STATE_UNDEFINED, self.craft.landed_state())

    def _height_mm(self, body: Body) -> tuple[int, int]:
        """Return (above sea level, above home) as the wire counts them."""
        above_home_m = body.altitude_m - self._home.altitude_m
        return (
            round(clip(body.altitude_m * 1000.0, -_INT32_MAX, _INT32_MAX)),
            round(clip(above_home_m * 1000.0, -_INT32_MAX, _INT32_MAX)),
        )

    def _global_position_int(self, t_s: float) -> Message:
        seen = self._look(t_s)
        body = seen.belief.body
        north_m_s, east_m_s = _true_velocity_m_s(seen)
        return self._mav.global_position_int_encode(
            seen.boot_ms,
            round(seen.lat_deg * 1e7),
            round(seen.lon_deg * 1e7),
            *self._height_mm(body),
            _centimetres_s(north_m_s),
            _centimetres_s(east_m_s),
            _centimetres_s(-body.climb_m_s),
            round(math.degrees(body.heading_rad + seen.convergence_rad) * 100.0) % 36000,
        )

    def _local_position_ned(self, t_s: float) -> Message:
        seen = self._look(t_s)
        body = seen.belief.body
        x_m, y_m = self._home_frame.to_local(seen.lat_deg, seen.lon_deg)
        z_m = self._home.altitude_m - body.altitude_m
        values = (x_m, y_m, z_m, *_true_velocity_m_s(seen), -body.climb_m_s)
        return self._mav.local_position_ned_encode(seen.boot_ms, *map(self._float, values))

    def _attitude(self, t_s: float) -> Message:
        seen = self._look(t_s)
        body = seen.belief.body
        yaw_rad = math.remainder(body.heading_rad + seen.convergence_rad, math.tau)
        values = (body.roll_rad, 0.0, yaw_rad, 0.0, 0.0, body.turn_rate_rad_s)
        return self._mav.attitude_encode(seen.boot_ms, *map(self._float, values))

    def _vfr_hud(self, t_s: float) -> Message:
        seen = self._look(t_s)
        body = seen.belief.body
        ground_m_s = math.hypot(body.velocity_north_m_s, body.velocity_east_m_s)
        heading_deg = round(math.degrees(body.heading_rad + seen.convergence_rad)) % 360
        unknown_throttle = 0
        return self._mav.vfr_hud_encode(
            self._float(body.airspeed_m_s),
            self._float(ground_m_s),
            heading_deg,
            unknown_throttle,
            self._float(body.altitude_m),
            self._float(body.climb_m_s),
        )

    def _gps_raw_int(self, t_s: float) -> Message:
        seen = self._look(t_s)
        north_m_s, east_m_s = _true_velocity_m_s(seen)
        has_fix = seen.belief.has_fix
        accuracy_mm = round(clip(seen.belief.accuracy_m * 1000.0, 0.0, _INT32_MAX))
        altitude_mm = self._height_mm(seen.belief.body)[0]
        dilution = 80 if has_fix else _NO_DILUTION
        return self._mav.gps_raw_int_encode(
            seen.boot_ms * 1000,
            mavlink.GPS_FIX_TYPE_3D_FIX if has_fix else mavlink.GPS_FIX_TYPE_NO_FIX,
            round(seen.lat_deg * 1e7),
            round(seen.lon_deg * 1e7),
            altitude_mm,
            dilution,
            dilution,
            min(round(math.hypot(north_m_s, east_m_s) * 100.0), _UINT16_MAX),
            round(math.degrees(math.atan2(east_m_s, north_m_s)) * 100.0) % 36000,
            14 if has_fix else 0,
            alt_ellipsoid=altitude_mm,
            h_acc=accuracy_mm,
            v_acc=accuracy_mm,
        )

    def _home_position(self, t_s: float) -> Message:
        level = (1.0, 0.0, 0.0, 0.0)
        return self._mav.home_position_encode(
            round(self._home_frame.lat_deg * 1e7),
            round(self._home_frame.lon_deg * 1e7),
            round(clip(self._home.altitude_m * 1000.0, -_INT32_MAX, _INT32_MAX)),
            *(0.0, 0.0, 0.0),
            level,
            *(0.0, 0.0, 0.0),
        )

    def _bytewise(self, parameter: Parameter) -> bool:
        """Whether the value's bytes travel as an integer's: PX4's way; ArduPilot sends every number as a float."""
        return parameter.integer and self.craft.mav_autopilot == mavlink.MAV_AUTOPILOT_PX4

    def _param_value(self, name: str) -> bytes:
        names = list(self.craft.values)
        value, kind = self.craft.values[name], mavlink.MAV_PARAM_TYPE_REAL32
        if self._bytewise(self._ranges[name]):
            value, kind = struct.unpack("<f", struct.pack("<i", round(value)))[0], mavlink.MAV_PARAM_TYPE_INT32
        return self._pack(self._mav.param_value_encode(name.encode(), value, kind, len(names), names.index(name)))

    def _status_text(self, text: str, severity: int) -> bytes:
        return self._pack(self._mav.statustext_encode(severity, text.encode()[:_TEXT_BYTES]))


def _true_velocity_m_s(seen: _Seen) -> tuple[float, float]:
    body = seen.belief.body
    return rotated(body.velocity_north_m_s, body.velocity_east_m_s, seen.convergence_rad)


def _centimetres_s(speed_m_s: float) -> int:
    return round(clip(speed_m_s * 100.0, -_INT16_MAX, _INT16_MAX))
