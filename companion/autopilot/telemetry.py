"""The telemetry that all autopilots tell alike, read from MAVLink `common`."""

from __future__ import annotations

import math
import re
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from pymavlink.dialects.v20 import common

from companion.files.mavlink_layout import HEADER_V2_BYTES, MARKER_V2, frame_parts

Message = Any
"""A message of the generated module, which carries no types."""

COMPANION_COMPONENT = common.MAV_COMP_ID_ONBOARD_COMPUTER
HEARTBEAT_PERIOD_S = 1.0
HEARTBEAT_TIMEOUT_S = 3.5
"""An autopilot's heartbeat comes once a second; three may be lost."""
_MESSAGE_IDS = frozenset(
    {
        common.MAVLINK_MSG_ID_HEARTBEAT,
        common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        common.MAVLINK_MSG_ID_HOME_POSITION,
        common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
        common.MAVLINK_MSG_ID_ADSB_VEHICLE,
        common.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        common.MAVLINK_MSG_ID_ATTITUDE,
        common.MAVLINK_MSG_ID_VFR_HUD,
        common.MAVLINK_MSG_ID_GPS_RAW_INT,
        common.MAVLINK_MSG_ID_ESTIMATOR_STATUS,
        common.MAVLINK_MSG_ID_SYS_STATUS,
        common.MAVLINK_MSG_ID_PARAM_VALUE,
        common.MAVLINK_MSG_ID_COMMAND_ACK,
    }
)
CALLSIGN_PATTERN = r"OW(\d{5})"
"""How the fleet's aircraft call themselves to each other's detectors; anybody else is a stranger."""
NEIGHBOUR_MEMORY_S = 5.0
"""A neighbour not seen for this long is elsewhere by now."""
MAX_NEIGHBOURS = 100
RESTART_MS = 1_000
"""An autopilot's clock that goes back by more was set to zero; less is a datagram that came late."""
SHARED_ID_STEPS = 2
"""Two autopilots share a system id if the clock went back this often within SHARED_ID_WITHIN_S."""
SHARED_ID_WITHIN_S = 10.0
"""An autopilot takes longer than this to start twice."""
SHARED_ID_CONTRADICTIONS = 20
"""Two autopilots with like clocks share a system id if within SHARED_ID_WITHIN_S this many positions come late, or are
elsewhere at the same moment. A link that puts a fifth of its datagrams out of order would look so too, and is unfit."""
SHARED_ID_MEMORY_S = 30.0
"""Two autopilots are taken to share an id for this time after the last sign of it."""
LOCAL_POSITION_MAX_AGE_S = 2.0
"""A local position older than this is none."""
METRES_PER_HDOP = 2.5
"""Accuracy where a receiver tells only its dilution of precision. Chosen: typical of one without corrections."""
_EPH_UNKNOWN = 65_535
_LAT_MAX_E7 = 900_000_000
_LON_MAX_E7 = 1_800_000_000
_NO_FIX = (0, 0)
"""What autopilots send as latitude and longitude before they know them."""


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


class _SharedIdWatch:
    """Notices two autopilots that answer to one system id, by what one alone seldom does."""

    def __init__(self) -> None:
        self.noticed_s = -math.inf
        self._clock_steps_s: deque[float] = deque(maxlen=SHARED_ID_STEPS)
        self._contradictions_s: deque[float] = deque(maxlen=SHARED_ID_CONTRADICTIONS)

    def note_clock_step(self, now_s: float) -> None:
        """Note that the clock went back far."""
        self._note(self._clock_steps_s, now_s)

    def note_contradiction(self, now_s: float) -> None:
        """Note a position that came late, or one elsewhere at the same moment."""
        self._note(self._contradictions_s, now_s)

    def _note(self, times_s: deque[float], now_s: float) -> None:
        """Note one more; often enough within a while, there are two autopilots."""
        times_s.append(now_s)
        if len(times_s) == times_s.maxlen and now_s - times_s[0] <= SHARED_ID_WITHIN_S:
            self.noticed_s = now_s


class TelemetryReader:
    """Reads the telemetry of one MAVLink autopilot; whatever is damaged, not finite or out of range is dropped."""

    def __init__(self, system_id: int | None = None) -> None:
        """Listen to the autopilot of this system id; None for whichever speaks first."""
        self.telemetry = Telemetry()
        self.neighbours: dict[int, Neighbour] = {}
        """By the address that each is known by (ICAO)."""
        self.rejected: Counter[str] = Counter()
        self.system_id = system_id
        self.foreign_ids: set[int] = set()
        """System ids of other autopilots on the same link."""
        self._heard_s = -math.inf
        self._place_e7 = _NO_FIX
        self._shared_id = _SharedIdWatch()
        self._local_at_s = -math.inf
        self._accuracies_m: dict[str, float] = {}
        self._readers: dict[str, Callable[[Message, float], None]] = {
            "GLOBAL_POSITION_INT": self._position,
            "HOME_POSITION": self._home,
            "EXTENDED_SYS_STATE": self._landed_state,
            "LOCAL_POSITION_NED": self._local_position,
            "ATTITUDE": self._attitude,
            "VFR_HUD": self._airspeed,
            "GPS_RAW_INT": self._gps,
            "ESTIMATOR_STATUS": self._estimator,
            "SYS_STATUS": self._battery,
        }

    @property
    def shared_system_id(self) -> bool:
        """Whether two autopilots answer to one system id: their clocks alternated not long ago."""
        return self._heard_s - self._shared_id.noticed_s <= SHARED_ID_MEMORY_S

    def receive(self, datagram: bytes, now_s: float) -> None:
        """Take in a datagram; never raises, whatever the bytes."""
        for message in messages_in(datagram):
            self.take(message, now_s)

    def take(self, message: Message, now_s: float) -> bool:
        """Take in a parsed message; return whether it is one of the autopilot that this reader listens to."""
        name = message.get_type()
        self._heard_s = now_s
        if name == "BAD_DATA":
            self.rejected["damaged"] += 1
        elif name == "HEARTBEAT":
            return self._heartbeat(message, now_s)
        elif message.get_srcSystem() != self.telemetry.system_id:
            self.rejected["other system"] += 1
        elif name == "ADSB_VEHICLE":
            # The autopilot passes these on, or the detector beside it sends them itself.
            self._neighbour(message, now_s)
        elif message.get_srcComponent() != common.MAV_COMP_ID_AUTOPILOT1:
            self.rejected["other component"] += 1
        else:
            if name in self._readers:
                self._readers[name](message, now_s)
            return True
        return False

    def _update(self, **values: object) -> None:
        self.telemetry = replace(self.telemetry, **values)  # type: ignore[arg-type]

    def _heartbeat(self, message: Message, now_s: float) -> bool:
        if (
            message.autopilot == common.MAV_AUTOPILOT_INVALID
            or message.get_srcComponent() != common.MAV_COMP_ID_AUTOPILOT1
        ):
            return False  # a ground station, another companion, a gimbal
        system_id = message.get_srcSystem()
        listened_to = self.telemetry.system_id if self.system_id is None else self.system_id
        if listened_to not in (None, system_id):
            self.rejected["other system"] += 1
            self.foreign_ids.add(system_id)
            return False
        self._update(
            system_id=system_id,
            heartbeat_at_s=now_s,
            autopilot=message.autopilot,
            mav_type=message.type,
            system_status=message.system_status,
            armed=bool(message.base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED),
            custom_mode=message.custom_mode if message.base_mode & common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED else None,
        )
        return True

    def _position(self, message: Message, now_s: float) -> None:
        if (message.lat, message.lon) == _NO_FIX or not _is_on_earth(message.lat, message.lon):
            self.rejected["out of range"] += 1
            return
        place_e7 = message.lat, message.lon
        if not self._advances(message.time_boot_ms, place_e7, now_s):
            # Its clock stands still: what it repeats is as old as when it was first told.
            self.rejected["clock stands still"] += 1
            return
        self._place_e7 = place_e7
        self._update(
            position_at_s=now_s,
            lat_deg=message.lat / 1e7,
            lon_deg=message.lon / 1e7,
            height_m=message.relative_alt / 1000.0,
            altitude_m=message.alt / 1000.0,
            velocity_north_m_s=message.vx / 100.0,
            velocity_east_m_s=message.vy / 100.0,
            yaw_rad=None if message.hdg == 65_535 else math.radians(message.hdg / 100.0),
        )
        if now_s - self._local_at_s > LOCAL_POSITION_MAX_AGE_S:
            self._update(local_ned_m=None)

    def _advances(self, boot_ms: int, place_e7: tuple[int, int], now_s: float) -> bool:
        """Note the autopilot's clock; return whether what comes with it is newer than what came before."""
        before_ms = self.telemetry.boot_ms
        restarted = before_ms is not None and boot_ms < before_ms - RESTART_MS
        if before_ms is not None and boot_ms <= before_ms and not restarted:
            if boot_ms < before_ms or place_e7 != self._place_e7:
                self._shared_id.note_contradiction(now_s)
            return False
        self._update(boot_ms=boot_ms, restarts=self.telemetry.restarts + restarted)
        if restarted:
            self._shared_id.note_clock_step(now_s)
        return True

    def _home(self, message: Message, now_s: float) -> None:
        if (message.latitude, message.longitude) == _NO_FIX or not _is_on_earth(message.latitude, message.longitude):
            self.rejected["out of range"] += 1
            return
        self._update(home_deg=(message.latitude / 1e7, message.longitude / 1e7))

    def _landed_state(self, message: Message, now_s: float) -> None:
        known = message.landed_state != common.MAV_LANDED_STATE_UNDEFINED
        self._update(in_air=message.landed_state == common.MAV_LANDED_STATE_IN_AIR if known else None)

    def _local_position(self, message: Message, now_s: float) -> None:
        if self._finite(message.x, message.y, message.z):
            self._local_at_s = now_s
            self._update(local_ned_m=(message.x, message.y, message.z))

    def _attitude(self, message: Message, now_s: float) -> None:
        if self._finite(message.roll, message.pitch, message.yaw):
            self._update(roll_rad=message.roll, attitude_at_s=now_s)

    def _airspeed(self, message: Message, now_s: float) -> None:
        if self._finite(message.airspeed):
            self._update(airspeed_m_s=message.airspeed)

    def _gps(self, message: Message, now_s: float) -> None:
        if message.h_acc > 0:
            accuracy_m = message.h_acc / 1000.0
        else:
            accuracy_m = math.nan if message.eph == _EPH_UNKNOWN else message.eph / 100.0 * METRES_PER_HDOP
        self._update(gps_fix=message.fix_type)
        self._accuracy("receiver", accuracy_m)

    def _estimator(self, message: Message, now_s: float) -> None:
        if self._finite(message.pos_horiz_accuracy):
            self._accuracy("estimator", message.pos_horiz_accuracy)

    def _accuracy(self, source: str, accuracy_m: float) -> None:
        """Keep the worse of what receiver and estimator say."""
        self._accuracies_m[source] = accuracy_m
        known = [value for value in self._accuracies_m.values() if math.isfinite(value)]
        self._update(position_accuracy_m=max(known, default=math.nan))

    def _battery(self, message: Message, now_s: float) -> None:
        remaining = message.battery_remaining
        self._update(battery_percent=float(remaining) if 0 <= remaining <= 100 else None)

    def _finite(self, *values: float) -> bool:
        if all(map(math.isfinite, values)):
            return True
        self.rejected["not finite"] += 1
        return False

    def _neighbour(self, message: Message, now_s: float) -> None:
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


def messages_in(datagram: bytes) -> Iterator[Message]:
    """Yield the MAVLink messages of a datagram, damaged ones as BAD_DATA; nothing for one message nobody here reads.

    Each datagram gets a parser of its own, so that a damaged one does not swallow the next.
    """
    if _is_one_other_message(datagram):
        return
    parser = common.MAVLink(None)
    parser.robust_parsing = True
    yield from parser.parse_buffer(bytes(datagram)) or ()


def _agent_id(callsign: str) -> int | None:
    """Return the agent that a callsign of the fleet names: OW and its id in five digits."""
    match = re.fullmatch(CALLSIGN_PATTERN, callsign.rstrip())
    identity = int(match.group(1)) if match else 0
    return identity or None


def _is_on_earth(lat_e7: int, lon_e7: int) -> bool:
    return abs(lat_e7) <= _LAT_MAX_E7 and abs(lon_e7) <= _LON_MAX_E7


def _is_one_other_message(datagram: bytes) -> bool:
    """Return whether a datagram is a single MAVLink 2 message that nobody here reads: a cheap check before parsing."""
    if len(datagram) < HEADER_V2_BYTES or datagram[0] != MARKER_V2:
        return False
    message_id, _, _, end = frame_parts(datagram)
    return end == len(datagram) and message_id not in _MESSAGE_IDS
