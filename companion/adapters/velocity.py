"""Autopilots that obey SET_POSITION_TARGET_LOCAL_NED with a velocity: ArduCopter in GUIDED, and the kinematic stand-in.

AUTOPILOT_FACTS: mask 0x0DC7 (velocity; yaw follows the track), frame 1, only in GUIDED (4), never acknowledged; the
vehicle brakes by itself GUID_TIMEOUT after the last setpoint.
"""

from __future__ import annotations

import math
from collections.abc import Collection

from pymavlink.dialects.v20 import common

from companion.adapters.base import COMPANION_COMPONENT, Abilities, Neighbour, Telemetry, TelemetryReader
from companion.guard import Setpoint

GUIDED_MODE = 4
"""custom_mode of ArduCopter's GUIDED."""
VELOCITY_ONLY = 0x0DC7
"""type_mask: ignore position, acceleration, yaw and yaw rate."""
HEIGHT_GAIN_1_S = 0.5
"""Vertical speed asked for per metre of height error."""
VERTICAL_SPEED_M_S = 2.0
"""Greatest vertical speed asked for."""
_UINT32 = 2**32


class VelocityAdapter:
    """Steers by velocity setpoints in the local NED frame."""

    resumes = False
    refusal: str | None = None
    settled = True
    abilities = Abilities()

    def __init__(self, kind: str, can_stop: bool) -> None:
        self.kind = kind
        self.can_stop = can_stop
        self._reader = TelemetryReader()
        self._mav: common.MAVLink | None = None

    @property
    def telemetry(self) -> Telemetry:
        """The newest of what the autopilot said."""
        return self._reader.telemetry

    @property
    def neighbours(self) -> Collection[Neighbour]:
        """What the vehicle's own detector has seen."""
        return self._reader.neighbours.values()

    @property
    def steerable(self) -> bool:
        """Armed and in GUIDED: both are a person's doing."""
        return self.telemetry.armed and self.telemetry.custom_mode == GUIDED_MODE

    def receive(self, datagram: bytes, now_s: float) -> None:
        """Take in bytes from the autopilot link."""
        self._reader.receive(datagram, now_s)

    def requests(self, now_s: float) -> list[bytes]:
        """Ask for nothing: the streams of the autopilot suffice."""
        return []

    def hold(self, now_s: float) -> list[bytes]:
        """Send nothing: the mode alone decides."""
        return []

    def release(self) -> None:
        """Forget nothing: each setpoint stands for itself."""

    def encode(self, setpoint: Setpoint, convergence_rad: float, now_s: float) -> list[bytes]:
        """Return SET_POSITION_TARGET_LOCAL_NED with the velocity, turned from grid to local north."""
        heading_rad = setpoint.heading_rad + convergence_rad
        climb_m_s = HEIGHT_GAIN_1_S * (setpoint.altitude_m - self.telemetry.height_m)
        climb_m_s = min(max(climb_m_s, -VERTICAL_SPEED_M_S), VERTICAL_SPEED_M_S)
        frame = self._pack(
            common.MAVLink_set_position_target_local_ned_message(
                time_boot_ms=int(now_s * 1000.0) % _UINT32,
                target_system=self.telemetry.system_id or 0,
                target_component=common.MAV_COMP_ID_AUTOPILOT1,
                coordinate_frame=common.MAV_FRAME_LOCAL_NED,
                type_mask=VELOCITY_ONLY,
                x=0.0,
                y=0.0,
                z=0.0,
                vx=setpoint.speed_m_s * math.cos(heading_rad),
                vy=setpoint.speed_m_s * math.sin(heading_rad),
                vz=-climb_m_s,
                afx=0.0,
                afy=0.0,
                afz=0.0,
                yaw=0.0,
                yaw_rate=0.0,
            )
        )
        return [frame]

    def heartbeat(self) -> bytes:
        """Return the companion's heartbeat: an onboard controller, never a ground station (it would mask its loss)."""
        return self._pack(
            common.MAVLink_heartbeat_message(
                type=common.MAV_TYPE_ONBOARD_CONTROLLER,
                autopilot=common.MAV_AUTOPILOT_INVALID,
                base_mode=0,
                custom_mode=0,
                system_status=common.MAV_STATE_ACTIVE,
                mavlink_version=3,
            )
        )

    def _pack(self, message: common.MAVLink_message) -> bytes:
        # A companion shares its autopilot's system id, which is known once it was heard.
        system_id = self.telemetry.system_id or 1
        if self._mav is None or self._mav.srcSystem != system_id:
            self._mav = common.MAVLink(None, srcSystem=system_id, srcComponent=COMPANION_COMPONENT)
        data = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return data
