"""What every autopilot adapter offers the core, and the telemetry that all of them read the same way."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace
from typing import Protocol

from pymavlink.dialects.v20 import common

from companion.guard import Setpoint

COMPANION_COMPONENT = common.MAV_COMP_ID_ONBOARD_COMPUTER
_MESSAGE_IDS = frozenset(
    {
        common.MAVLINK_MSG_ID_HEARTBEAT,
        common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        common.MAVLINK_MSG_ID_HOME_POSITION,
    }
)
_HEADER_BYTES = 10
_MARKER = 0xFD


@dataclass(frozen=True)
class Telemetry:
    """The newest of what the autopilot said; None until it said it. Headings are from local true north."""

    system_id: int | None = None
    armed: bool = False
    custom_mode: int | None = None
    position_at_s: float | None = None
    lat_deg: float = math.nan
    lon_deg: float = math.nan
    height_m: float = math.nan
    """Above home."""
    velocity_north_m_s: float = math.nan
    velocity_east_m_s: float = math.nan
    yaw_rad: float | None = None
    home_deg: tuple[float, float] | None = None
    """Latitude and longitude."""


class Adapter(Protocol):
    """One autopilot kind: its telemetry, its steering, its abilities."""

    can_stop: bool
    """Whether the vehicle can stand still in the air."""

    @property
    def telemetry(self) -> Telemetry:
        """The newest of what the autopilot said."""
        ...

    @property
    def steerable(self) -> bool:
        """Whether a person has armed the vehicle and put it into the mode that obeys setpoints."""
        ...

    def receive(self, datagram: bytes, now_s: float) -> None:
        """Take in bytes from the autopilot link; never raises, whatever the bytes."""
        ...

    def encode(self, setpoint: Setpoint, convergence_rad: float, now_s: float) -> bytes:
        """Return the frame that asks for a setpoint whose heading is from grid north."""
        ...

    def heartbeat(self) -> bytes:
        """Return the companion's heartbeat, as an onboard controller."""
        ...


class TelemetryReader:
    """Reads the telemetry of any MAVLink autopilot: HEARTBEAT, GLOBAL_POSITION_INT, HOME_POSITION."""

    def __init__(self) -> None:
        self.telemetry = Telemetry()
        self.rejected: Counter[str] = Counter()

    def receive(self, datagram: bytes, now_s: float) -> None:
        """Take in a datagram; anything damaged or not finite is counted and dropped."""
        if _is_one_other_message(datagram):
            return
        parser = common.MAVLink(None)
        parser.robust_parsing = True
        for message in parser.parse_buffer(bytes(datagram)) or ():
            name = message.get_type()
            if name == "BAD_DATA":
                self.rejected["damaged"] += 1
            elif name == "HEARTBEAT":
                self._heartbeat(message)
            elif message.get_srcSystem() != self.telemetry.system_id:
                self.rejected["other system"] += 1
            elif name == "GLOBAL_POSITION_INT":
                self.telemetry = replace(
                    self.telemetry,
                    position_at_s=now_s,
                    lat_deg=message.lat / 1e7,
                    lon_deg=message.lon / 1e7,
                    height_m=message.relative_alt / 1000.0,
                    velocity_north_m_s=message.vx / 100.0,
                    velocity_east_m_s=message.vy / 100.0,
                    yaw_rad=None if message.hdg == 65_535 else math.radians(message.hdg / 100.0),
                )
            elif name == "HOME_POSITION":
                home_deg = (message.latitude / 1e7, message.longitude / 1e7)
                self.telemetry = replace(self.telemetry, home_deg=home_deg)

    def _heartbeat(self, message: common.MAVLink_heartbeat_message) -> None:
        if message.autopilot == common.MAV_AUTOPILOT_INVALID:
            return  # a ground station or another companion
        if self.telemetry.system_id not in (None, message.get_srcSystem()):
            self.rejected["other system"] += 1
            return
        self.telemetry = replace(
            self.telemetry,
            system_id=message.get_srcSystem(),
            armed=bool(message.base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED),
            custom_mode=message.custom_mode if message.base_mode & common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED else None,
        )


def _is_one_other_message(datagram: bytes) -> bool:
    """Return whether a datagram is a single MAVLink 2 message that nobody here reads: a cheap check before parsing."""
    if len(datagram) < _HEADER_BYTES or datagram[0] != _MARKER:
        return False
    unsigned_bytes = datagram[1] + 12
    return (
        unsigned_bytes <= len(datagram) <= unsigned_bytes + 13
        and int.from_bytes(datagram[7:10], "little") not in _MESSAGE_IDS
    )
