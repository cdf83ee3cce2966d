"""What every autopilot adapter offers the core, and the telemetry that all of them read the same way."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Collection
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
        common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
        common.MAVLINK_MSG_ID_ADSB_VEHICLE,
    }
)
CALLSIGN_PATTERN = r"OW(\d{5})"
"""How the fleet's aircraft call themselves to each other's detectors; anybody else is a stranger."""
NEIGHBOUR_MEMORY_S = 5.0
"""A neighbour not seen for this long is elsewhere by now."""
MAX_NEIGHBOURS = 100
_LAT_MAX_E7 = 900_000_000
_LON_MAX_E7 = 1_800_000_000
_HEADER_BYTES = 10
_NO_FIX = (0, 0)
"""What autopilots send as latitude and longitude before they know them."""
_FLAG_SIGNED = 0x01
_SIGNATURE_BYTES = 13
_MARKER = 0xFD


@dataclass(frozen=True)
class Telemetry:
    """The newest of what the autopilot said; None until it said it. Headings are from local true north."""

    system_id: int | None = None
    heartbeat_at_s: float | None = None
    autopilot: int | None = None
    """MAV_AUTOPILOT."""
    mav_type: int | None = None
    system_status: int | None = None
    """MAV_STATE; critical and emergency are the autopilot's own failsafes."""
    armed: bool = False
    custom_mode: int | None = None
    boot_ms: int | None = None
    """The autopilot's clock, since it started."""
    restarts: int = 0
    """How often that clock went back: it was rebooted in flight, or two autopilots answer to one system id."""
    position_at_s: float | None = None
    lat_deg: float = math.nan
    lon_deg: float = math.nan
    height_m: float = math.nan
    """Above home."""
    altitude_m: float = math.nan
    """Above sea level."""
    velocity_north_m_s: float = math.nan
    velocity_east_m_s: float = math.nan
    yaw_rad: float | None = None
    home_deg: tuple[float, float] | None = None
    """Latitude and longitude."""
    in_air: bool | None = None
    """Airborne and neither taking off nor landing; None where the autopilot does not say."""
    local_ned_m: tuple[float, float, float] | None = None
    """Of the autopilot's own local frame, as it came with the newest position."""
    roll_rad: float = math.nan
    attitude_at_s: float | None = None
    airspeed_m_s: float = math.nan
    gps_fix: int | None = None
    """GPS_FIX_TYPE."""
    position_accuracy_m: float = math.nan
    """Horizontal, as the autopilot's estimator or receiver says; NaN if neither does."""
    battery_percent: float | None = None


@dataclass(frozen=True)
class Neighbour:
    """Another aircraft as the vehicle's own detector saw it. Velocities are from local true north."""

    agent_id: int | None
    """None for one that is not of the fleet."""
    lat_deg: float
    lon_deg: float
    velocity_north_m_s: float
    velocity_east_m_s: float
    seen_at_s: float
    altitude_m: float = math.nan
    """Above sea level; NaN if it did not say."""


@dataclass(frozen=True)
class Abilities:
    """What guidance and guard must assume of the vehicle, as its autopilot's parameters make it."""

    speed_min_m_s: float = 0.0
    speed_max_m_s: float = math.inf
    n_max: float = math.inf
    """Load factor of the turn rate n_max g / v that its turns achieve."""
    reaction_s: float = 0.0
    """From sending a setpoint to the vehicle beginning to obey it: the pure delay that stands for its lag."""
    braking_m_s2: float = math.inf
    """Of one that can stop."""
    tracking_m: float = 0.0
    """How far it strays from the path of arcs and straight lines that guidance and guard reckon with."""
    assumed: tuple[str, ...] = ()
    """Parameters that the autopilot did not tell: their documented defaults are assumed."""


class Adapter(Protocol):
    """One autopilot kind: its telemetry, its steering, its abilities."""

    kind: str
    """As configurations name it."""
    can_stop: bool
    """Whether the vehicle can stand still in the air."""
    resumes: bool
    """Whether the autopilot obeys again by itself when a stream of setpoints comes back, whatever happened since."""

    @property
    def neighbours(self) -> Collection[Neighbour]:
        """What the vehicle's own detector has seen; who reads them minds their age."""
        ...

    @property
    def telemetry(self) -> Telemetry:
        """The newest of what the autopilot said."""
        ...

    @property
    def steerable(self) -> bool:
        """Whether a person has armed the vehicle and put it into the mode that obeys setpoints."""
        ...

    @property
    def refusal(self) -> str | None:
        """Why this autopilot is not steered at all, and what to do about it: another kind than configured, ..."""
        ...

    @property
    def abilities(self) -> Abilities:
        """What the vehicle can do, by the parameters read so far."""
        ...

    @property
    def settled(self) -> bool:
        """Whether every parameter that the abilities rest on was told, or asked for in vain as often as it is worth."""
        ...

    def receive(self, datagram: bytes, now_s: float) -> None:
        """Take in bytes from the autopilot link; never raises, whatever the bytes."""
        ...

    def requests(self, now_s: float) -> list[bytes]:
        """Return what is due to be asked of the autopilot: message rates, parameters; bounded in number and rate."""
        ...

    def encode(self, setpoint: Setpoint, convergence_rad: float, now_s: float) -> list[bytes]:
        """Return the frames that ask for a setpoint whose heading is from grid north."""
        ...

    def hold(self, now_s: float) -> list[bytes]:
        """Return the frames that ask to stay as it is, where a stream must flow before a person can hand over."""
        ...

    def release(self) -> None:
        """Forget what belongs to the steering that ended: somebody else has the vehicle."""
        ...

    def heartbeat(self) -> bytes:
        """Return the companion's heartbeat, as an onboard controller."""
        ...


class NoAutopilot:
    """What a point that stands for a vehicle need not say for itself: it hears no bytes and obeys at once, exactly."""

    kind = "kinematic"
    resumes = False
    steerable = True
    refusal: str | None = None
    abilities = Abilities()
    settled = True

    def receive(self, datagram: bytes, now_s: float) -> None:
        """There is no autopilot to hear."""

    def requests(self, now_s: float) -> list[bytes]:
        """There is nobody to ask."""
        return []

    def hold(self, now_s: float) -> list[bytes]:
        """Nothing need flow before it is steered."""
        return []

    def release(self) -> None:
        """Nothing is kept of a steering that ended."""

    def heartbeat(self) -> bytes:
        """Nobody listens to it."""
        return b""


class TelemetryReader:
    """Reads the telemetry of any MAVLink autopilot: HEARTBEAT, positions, landed state."""

    def __init__(self) -> None:
        self.telemetry = Telemetry()
        self.neighbours: dict[int, Neighbour] = {}
        """By the address that each is known by (ICAO)."""
        self.rejected: Counter[str] = Counter()

    def receive(self, datagram: bytes, now_s: float) -> None:
        """Take in a datagram; anything damaged or out of range is counted and dropped."""
        if _is_one_other_message(datagram):
            return
        parser = common.MAVLink(None)
        parser.robust_parsing = True
        for message in parser.parse_buffer(bytes(datagram)) or ():
            name = message.get_type()
            if name == "BAD_DATA":
                self.rejected["damaged"] += 1
            elif name == "HEARTBEAT":
                self._heartbeat(message, now_s)
            elif message.get_srcSystem() != self.telemetry.system_id:
                self.rejected["other system"] += 1
            elif name == "ADSB_VEHICLE":
                # The autopilot passes these on, or the detector beside it sends them itself.
                self._neighbour(message, now_s)
            elif message.get_srcComponent() != common.MAV_COMP_ID_AUTOPILOT1:
                self.rejected["other component"] += 1
            elif name == "GLOBAL_POSITION_INT":
                if (message.lat, message.lon) == _NO_FIX or not _is_on_earth(message.lat, message.lon):
                    self.rejected["out of range"] += 1
                    continue
                self.telemetry = replace(
                    self.telemetry,
                    position_at_s=now_s,
                    lat_deg=message.lat / 1e7,
                    lon_deg=message.lon / 1e7,
                    height_m=message.relative_alt / 1000.0,
                    altitude_m=message.alt / 1000.0,
                    velocity_north_m_s=message.vx / 100.0,
                    velocity_east_m_s=message.vy / 100.0,
                    yaw_rad=None if message.hdg == 65_535 else math.radians(message.hdg / 100.0),
                )
            elif name == "HOME_POSITION":
                if not _is_on_earth(message.latitude, message.longitude):
                    self.rejected["out of range"] += 1
                    continue
                home_deg = (message.latitude / 1e7, message.longitude / 1e7)
                self.telemetry = replace(self.telemetry, home_deg=home_deg)
            elif name == "EXTENDED_SYS_STATE":
                known = message.landed_state != common.MAV_LANDED_STATE_UNDEFINED
                in_air = message.landed_state == common.MAV_LANDED_STATE_IN_AIR
                self.telemetry = replace(self.telemetry, in_air=in_air if known else None)

    def _heartbeat(self, message: common.MAVLink_heartbeat_message, now_s: float) -> None:
        if (
            message.autopilot == common.MAV_AUTOPILOT_INVALID
            or message.get_srcComponent() != common.MAV_COMP_ID_AUTOPILOT1
        ):
            return  # a ground station, another companion, a gimbal
        if self.telemetry.system_id not in (None, message.get_srcSystem()):
            self.rejected["other system"] += 1
            return
        self.telemetry = replace(
            self.telemetry,
            system_id=message.get_srcSystem(),
            heartbeat_at_s=now_s,
            armed=bool(message.base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED),
            custom_mode=message.custom_mode if message.base_mode & common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED else None,
        )

    def _neighbour(self, message: common.MAVLink_adsb_vehicle_message, now_s: float) -> None:
        flags = message.flags
        if not flags & common.ADSB_FLAGS_VALID_COORDS:
            self.rejected["no coordinates"] += 1
            return
        if not _is_on_earth(message.lat, message.lon):
            self.rejected["out of range"] += 1
            return
        moves = flags & common.ADSB_FLAGS_VALID_HEADING and flags & common.ADSB_FLAGS_VALID_VELOCITY
        speed_m_s = message.hor_velocity / 100.0 if moves else 0.0
        course_rad = math.radians(message.heading / 100.0)
        forgotten = [key for key, known in self.neighbours.items() if now_s - known.seen_at_s > NEIGHBOUR_MEMORY_S]
        for key in forgotten:
            del self.neighbours[key]
        if message.ICAO_address not in self.neighbours and len(self.neighbours) >= MAX_NEIGHBOURS:
            self.rejected["too many neighbours"] += 1
            return
        self.neighbours[message.ICAO_address] = Neighbour(
            agent_id=_agent_id(message.callsign) if flags & common.ADSB_FLAGS_VALID_CALLSIGN else None,
            lat_deg=message.lat / 1e7,
            lon_deg=message.lon / 1e7,
            velocity_north_m_s=speed_m_s * math.cos(course_rad),
            velocity_east_m_s=speed_m_s * math.sin(course_rad),
            seen_at_s=now_s - message.tslc,
            altitude_m=message.altitude / 1000.0 if flags & common.ADSB_FLAGS_VALID_ALTITUDE else math.nan,
        )


def _agent_id(callsign: str) -> int | None:
    """Return the agent that a callsign of the fleet names: OW and its id in five digits."""
    match = re.fullmatch(CALLSIGN_PATTERN, callsign.rstrip())
    identity = int(match.group(1)) if match else 0
    return identity or None


def _is_on_earth(lat_e7: int, lon_e7: int) -> bool:
    return abs(lat_e7) <= _LAT_MAX_E7 and abs(lon_e7) <= _LON_MAX_E7


def _is_one_other_message(datagram: bytes) -> bool:
    """Return whether a datagram is a single MAVLink 2 message that nobody here reads: a cheap check before parsing."""
    if len(datagram) < _HEADER_BYTES or datagram[0] != _MARKER:
        return False
    length = datagram[1] + 12 + (_SIGNATURE_BYTES if datagram[2] & _FLAG_SIGNED else 0)
    return len(datagram) == length and int.from_bytes(datagram[7:10], "little") not in _MESSAGE_IDS
