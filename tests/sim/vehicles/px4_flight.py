"""Flies a PX4 stand-in with MAVLink messages alone, as any client could, and keeps what it answers."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common

from companion.geo.local_frame import LocalFrame
from sim.vehicles import Craft, Home, Setup, StandIn, Start

Message = Any
"""Message of pymavlink's generated module, which carries no types."""

OFFBOARD, POSITION, ALTITUDE, STABILIZED = (6, 0), (3, 0), (2, 0), (7, 0)
TAKE_OFF, HOLD, RETURN, LAND = (4, 2), (4, 3), (4, 5), (4, 6)
ACCEPTED, REJECTED = common.MAV_RESULT_ACCEPTED, common.MAV_RESULT_TEMPORARILY_REJECTED
UNSUPPORTED = common.MAV_RESULT_UNSUPPORTED
NAN = math.nan

_GROUND_M = 500.0
_TICK_S = 0.1
_RATES_HZ = {
    common.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    common.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 20.0,
    common.MAVLINK_MSG_ID_ATTITUDE: 20.0,
    common.MAVLINK_MSG_ID_VFR_HUD: 10.0,
    common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
}

Make = Callable[["Flight"], Message]


class Flight:
    """One vehicle with a client that keeps the newest message of each type and every text."""

    def __init__(self, build: Callable[[Start], Craft], height_m: float = 100.0, speed_m_s: float = 0.0) -> None:
        """Begin in HOLD at a height (m), flying north at a speed; with height 0 begin disarmed on the ground."""
        flies = height_m > 0.0
        self.vehicle = StandIn(
            build,
            Setup(
                1,
                LocalFrame(47.0, 8.0),
                altitude_m=_GROUND_M + height_m,
                speed_m_s=speed_m_s,
                home=Home(0.0, 0.0, _GROUND_M),
                in_air=flies,
                armed=flies,
                rates_hz=_RATES_HZ,
            ),
        )
        self.now_s = 0.0
        self.heard: dict[str, Message] = {}
        self.texts: list[str] = []
        self._ticks = 0
        self._client = common.MAVLink(None, srcSystem=1, srcComponent=191)
        self._listen(self.vehicle.telemetry(0.0))

    def _listen(self, frames: list[bytes]) -> list[Message]:
        messages = [message for frame in frames for message in common.MAVLink(None).parse_buffer(frame) or ()]
        for message in messages:
            self.heard[message.get_type()] = message
            if message.get_type() == "STATUSTEXT":
                self.texts.append(message.text)
        return messages

    def send(self, message: Message) -> list[Message]:
        """Send one message now and return what comes back at once."""
        return self._listen(self.vehicle.receive(bytes(message.pack(self._client)), self.now_s))

    def command(self, number: int, *parameters: float) -> list[int]:
        """Send a COMMAND_LONG and return the results of its acknowledgements."""
        seven = (*parameters, *(0.0,) * (7 - len(parameters)))
        return self._results(common.MAVLink_command_long_message(1, 1, number, 0, *seven))

    def command_int(self, number: int, *parameters: float, x: int, y: int, z: float) -> list[int]:
        """Send a COMMAND_INT in the frame of heights above home and return its results."""
        frame = common.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
        four = (*parameters, *(0.0,) * (4 - len(parameters)))
        return self._results(common.MAVLink_command_int_message(1, 1, frame, number, 0, 0, *four, x, y, z))

    def _results(self, message: Message) -> list[int]:
        return [answer.result for answer in self.send(message) if answer.get_type() == "COMMAND_ACK"]

    def set_mode(self, mode: tuple[int, int]) -> list[int]:
        """Ask for a (main, sub) mode and return the results of the acknowledgements."""
        return self.command(common.MAV_CMD_DO_SET_MODE, common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, *mode)

    def set_parameter(self, name: str, value: float) -> None:
        """Change a parameter of the vehicle directly, without a message."""
        self.vehicle.parameters[name] = value

    def run(
        self,
        duration_s: float,
        make: Make | None = None,
        rate_hz: float = 10.0,
        watch: Callable[[], None] = lambda: None,
    ) -> None:
        """Let time pass while a setpoint goes out at a rate; `watch` is called each tenth of a second."""
        every = round(1.0 / (rate_hz * _TICK_S))
        for tick in range(round(duration_s / _TICK_S)):
            if make is not None and tick % every == 0:
                self.send(make(self))
            self._ticks += 1
            self.now_s = self._ticks * _TICK_S
            self.vehicle.step_to(self.now_s)
            self._listen(self.vehicle.telemetry(self.now_s))
            watch()

    def engage(self, make: Make) -> None:
        """Stream a setpoint, set OFFBOARD after 1.2 s, and wait as long again for the heartbeat to show it."""
        self.run(1.2, make)
        assert self.set_mode(OFFBOARD)[-1] == ACCEPTED
        self.run(1.2, make)
        assert self.mode == OFFBOARD

    @property
    def mode(self) -> tuple[int, int]:
        """Mode as (main, sub) according to the newest heartbeat."""
        custom_mode = self.heard["HEARTBEAT"].custom_mode
        return custom_mode >> 16 & 0xFF, custom_mode >> 24

    @property
    def armed(self) -> bool:
        return bool(self.heard["HEARTBEAT"].base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def critical(self) -> bool:
        return bool(self.heard["HEARTBEAT"].system_status == common.MAV_STATE_CRITICAL)

    @property
    def landed(self) -> bool:
        return bool(self.heard["EXTENDED_SYS_STATE"].landed_state == common.MAV_LANDED_STATE_ON_GROUND)

    @property
    def place_m(self) -> tuple[float, float]:
        """North and east of home."""
        position = self.heard["LOCAL_POSITION_NED"]
        return position.x, position.y

    @property
    def height_m(self) -> float:
        return -float(self.heard["LOCAL_POSITION_NED"].z)

    @property
    def velocity_m_s(self) -> tuple[float, float]:
        position = self.heard["LOCAL_POSITION_NED"]
        return position.vx, position.vy

    @property
    def speed_m_s(self) -> float:
        return math.hypot(*self.velocity_m_s)

    @property
    def climb_m_s(self) -> float:
        return -float(self.heard["LOCAL_POSITION_NED"].vz)

    @property
    def course_deg(self) -> float:
        north_m_s, east_m_s = self.velocity_m_s
        return math.degrees(math.atan2(east_m_s, north_m_s))

    @property
    def bank_deg(self) -> float:
        return math.degrees(self.heard["ATTITUDE"].roll)

    @property
    def airspeed_m_s(self) -> float:
        return float(self.heard["VFR_HUD"].airspeed)

    def offset_deg(self, course_deg: float) -> float:
        """Return the signed angle from a course to the one flown."""
        return math.degrees(math.remainder(math.radians(self.course_deg - course_deg), math.tau))


def local(mask: int, frame: int = common.MAV_FRAME_LOCAL_NED, /, **fields: float) -> Message:
    """Return a SET_POSITION_TARGET_LOCAL_NED whose fields are 0 unless given."""
    names = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
    assert set(fields) <= set(names)
    values = (fields.get(name, 0.0) for name in names)
    return common.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *values)
