"""The fields of the telemetry that all autopilots send in the same messages of the MAVLink dialect `common`.

Which messages are the autopilot's, and newer than those before, is decided before (`identity.py`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega, common

from companion.autopilot.aircraft import Neighbour, entered, neighbour_of
from companion.autopilot.estimate import Estimate, Receiver, better, ekf_status, estimator_status
from companion.autopilot.intake import Message
from companion.geo.degrees import is_on_earth

COMPANION_COMPONENT = common.MAV_COMP_ID_ONBOARD_COMPUTER
"""The component id that the companion sends with."""
HEARTBEAT_PERIOD_S = 1.0
"""Time between two heartbeats of an autopilot, and of the companion."""
HEARTBEAT_TIMEOUT_S = 3.5
"""Time without a heartbeat after which the autopilot counts as lost: three heartbeats in a row may be lost."""
LOCAL_POSITION_MAX_AGE_S = 2.0
"""Age beyond which a local position is discarded."""
METRES_PER_HDOP = 2.5
"""Assumed position error per unit of HDOP, for a receiver that gives no accuracy in metres. Chosen: typical of one
without corrections."""
_EPH_UNKNOWN = 65_535
"""Value of GPS_RAW_INT.eph that means unknown."""
_NO_FIX = (0, 0)
"""Latitude and longitude that autopilots send before they know them."""


@dataclass(frozen=True)
class Telemetry:
    """The newest telemetry of the autopilot. Headings are from local true north; None or NaN means not received yet."""

    system_id: int | None = None
    heartbeat_at_s: float | None = None
    autopilot: int | None = None
    """The autopilot's MAV_AUTOPILOT."""
    mav_type: int | None = None
    """The vehicle's MAV_TYPE."""
    system_status: int | None = None
    """The autopilot's MAV_STATE; critical and emergency mean that one of its own failsafes acts."""
    armed: bool = False
    custom_mode: int | None = None
    boot_ms: int | None = None
    """The autopilot's time_boot_ms: milliseconds since it started."""
    restarts: int = 0
    """Number of times that `boot_ms` began anew: the autopilot restarted, or another one took its place."""
    position_at_s: float | None = None
    lat_deg: float = math.nan
    lon_deg: float = math.nan
    height_m: float = math.nan
    """Height above home."""
    altitude_m: float = math.nan
    """Altitude above mean sea level."""
    velocity_north_m_s: float = math.nan
    velocity_east_m_s: float = math.nan
    climb_m_s: float = 0.0
    """Vertical velocity, positive upwards."""
    yaw_rad: float | None = None
    home_deg: tuple[float, float] | None = None
    """Latitude and longitude of home."""
    home_altitude_m: float = math.nan
    """Altitude of home above mean sea level."""
    home_boot_ms: int | None = None
    """The autopilot's clock, by its newest position, when home was last told."""
    origin: tuple[float, float, float] | None = None
    """Origin of the autopilot's local frame: latitude and longitude in degrees, altitude above mean sea level."""
    in_air: bool | None = None
    """Whether the vehicle flies and neither takes off nor lands; None where the autopilot does not say."""
    local_ned_m: tuple[float, float, float] | None = None
    """Position (north, east, down) in the autopilot's own local frame; None where it is missing or too old."""
    local_boot_ms: int = 0
    """The autopilot's time_boot_ms of that position."""
    roll_rad: float = math.nan
    attitude_at_s: float | None = None
    airspeed_m_s: float = math.nan
    """Indicated airspeed."""
    airspeed_at_s: float = -math.inf
    wind_ned_m_s: tuple[float, float] | None = None
    """Velocity of the air (true north, east) as the autopilot estimates it; None where it tells none."""
    wind_at_s: float = -math.inf
    gps_fix: int | None = None
    """GPS_FIX_TYPE of the better receiver."""
    estimate: Estimate | None = None
    """What the autopilot last said of its own estimate; None before it said anything."""
    position_accuracy_m: float = math.nan
    """Horizontal accuracy, the worse of the receiver's and the estimator's; NaN if neither reports one."""
    battery_percent: float | None = None


class TelemetryReader:
    """Reads the autopilot's messages; drops values that are not finite or out of range."""

    def __init__(self, rejected: Counter[str]) -> None:
        """Count in `rejected` what is dropped, by reason."""
        self.telemetry = Telemetry()
        self.neighbours: dict[int, Neighbour] = {}
        """The detected aircraft by their ICAO address."""
        self.rejected = rejected
        self.seen_s = -math.inf
        """Time of the newest detection of any other aircraft."""
        self._local_at_s = -math.inf
        self._receivers: dict[str, Receiver] = {}
        self._readers: dict[int, Callable[[Message, float], None]] = {
            common.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._position,
            common.MAVLINK_MSG_ID_HOME_POSITION: self._home,
            common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._landed_state,
            common.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position,
            common.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            common.MAVLINK_MSG_ID_VFR_HUD: self._airspeed,
            ardupilotmega.MAVLINK_MSG_ID_WIND: self._wind,
            common.MAVLINK_MSG_ID_WIND_COV: self._wind_cov,
            common.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps,
            common.MAVLINK_MSG_ID_GPS2_RAW: self._gps,
            common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._origin,
            ardupilotmega.MAVLINK_MSG_ID_EKF_STATUS_REPORT: self._ekf,
            common.MAVLINK_MSG_ID_ESTIMATOR_STATUS: self._estimator,
            common.MAVLINK_MSG_ID_SYS_STATUS: self._battery,
            common.MAVLINK_MSG_ID_ADSB_VEHICLE: self._neighbour,
        }
        self.message_ids = frozenset(self._readers)
        """Ids of the messages that are read."""

    def take(self, message: Message, at_s: float) -> None:
        """Read a message of the autopilot that is newer than those before; `at_s` is the time that it counts from."""
        read = self._readers.get(message.get_msgId())
        if read is not None:
            read(message, at_s)

    def note_restarts(self, restarts: int) -> None:
        """Store how often the autopilot has restarted."""
        if restarts != self.telemetry.restarts:
            self._update(restarts=restarts)

    def _update(self, **values: object) -> None:
        # As dataclasses.replace does it, at a third of its cost: this is done for every message.
        self.telemetry = Telemetry(**(vars(self.telemetry) | values))

    def _heartbeat(self, message: Message, now_s: float) -> None:
        self._update(
            system_id=message.get_srcSystem(),
            heartbeat_at_s=now_s,
            autopilot=message.autopilot,
            mav_type=message.type,
            system_status=message.system_status,
            armed=bool(message.base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED),
            custom_mode=message.custom_mode if message.base_mode & common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED else None,
        )

    def _position(self, message: Message, now_s: float) -> None:
        if (message.lat, message.lon) == _NO_FIX or not is_on_earth(message.lat, message.lon):
            self.rejected["out of range"] += 1
            return
        self._update(
            boot_ms=message.time_boot_ms,
            position_at_s=now_s,
            lat_deg=message.lat / 1e7,
            lon_deg=message.lon / 1e7,
            height_m=message.relative_alt / 1000.0,
            altitude_m=message.alt / 1000.0,
            velocity_north_m_s=message.vx / 100.0,
            velocity_east_m_s=message.vy / 100.0,
            climb_m_s=-message.vz / 100.0,
            yaw_rad=None if message.hdg == 65_535 else math.radians(message.hdg / 100.0),
        )
        if now_s - self._local_at_s > LOCAL_POSITION_MAX_AGE_S:
            self._update(local_ned_m=None)

    def _home(self, message: Message, now_s: float) -> None:
        if (message.latitude, message.longitude) == _NO_FIX or not is_on_earth(message.latitude, message.longitude):
            self.rejected["out of range"] += 1
            return
        self._update(
            home_deg=(message.latitude / 1e7, message.longitude / 1e7),
            home_altitude_m=message.altitude / 1000.0,
            home_boot_ms=self.telemetry.boot_ms,
        )

    def _origin(self, message: Message, now_s: float) -> None:
        if not is_on_earth(message.latitude, message.longitude):
            self.rejected["out of range"] += 1
            return
        self._update(origin=(message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1000.0))

    def _landed_state(self, message: Message, now_s: float) -> None:
        known = message.landed_state != common.MAV_LANDED_STATE_UNDEFINED
        self._update(in_air=message.landed_state == common.MAV_LANDED_STATE_IN_AIR if known else None)

    def _local_position(self, message: Message, now_s: float) -> None:
        if self._finite(message.x, message.y, message.z):
            self._local_at_s = now_s
            self._update(local_ned_m=(message.x, message.y, message.z), local_boot_ms=message.time_boot_ms)

    def _attitude(self, message: Message, now_s: float) -> None:
        if self._finite(message.roll, message.pitch, message.yaw):
            self._update(roll_rad=message.roll, attitude_at_s=now_s)

    def _airspeed(self, message: Message, now_s: float) -> None:
        if self._finite(message.airspeed):
            self._update(airspeed_m_s=message.airspeed, airspeed_at_s=now_s)

    def _wind(self, message: Message, now_s: float) -> None:
        """Take ArduPilot's WIND, which tells where the wind comes from."""
        if self._finite(message.direction, message.speed):
            to_rad = math.radians(message.direction + 180.0)
            wind_ned_m_s = (message.speed * math.cos(to_rad), message.speed * math.sin(to_rad))
            self._update(wind_ned_m_s=wind_ned_m_s, wind_at_s=now_s)

    def _wind_cov(self, message: Message, now_s: float) -> None:
        """Take PX4's WIND_COV, which tells the velocity of the air."""
        if self._finite(message.wind_x, message.wind_y):
            self._update(wind_ned_m_s=(message.wind_x, message.wind_y), wind_at_s=now_s)

    def _gps(self, message: Message, now_s: float) -> None:
        if message.h_acc > 0:
            accuracy_m = message.h_acc / 1000.0
        else:
            accuracy_m = math.nan if message.eph == _EPH_UNKNOWN else message.eph / 100.0 * METRES_PER_HDOP
        self._receivers[message.get_type()] = Receiver(now_s, message.fix_type, accuracy_m)
        self._update(gps_fix=better(self._receivers, now_s).fix)
        self._accuracy(now_s)

    def _ekf(self, message: Message, now_s: float) -> None:
        self._update(estimate=ekf_status(message, self.telemetry.estimate, now_s))

    def _estimator(self, message: Message, now_s: float) -> None:
        if self._finite(message.pos_horiz_accuracy):
            self._update(estimate=estimator_status(message, self.telemetry.estimate, now_s))
            self._accuracy(now_s)

    def _accuracy(self, now_s: float) -> None:
        """Keep the worse of the estimator's accuracy and the better receiver's."""
        told_m = [] if self.telemetry.estimate is None else [self.telemetry.estimate.accuracy_m]
        if self._receivers:
            told_m.append(better(self._receivers, now_s).accuracy_m)
        self._update(position_accuracy_m=max((one for one in told_m if math.isfinite(one)), default=math.nan))

    def _battery(self, message: Message, now_s: float) -> None:
        remaining = message.battery_remaining
        self._update(battery_percent=float(remaining) if 0 <= remaining <= 100 else None)

    def _finite(self, *values: float) -> bool:
        if all(map(math.isfinite, values)):
            return True
        self.rejected["not finite"] += 1
        return False

    def _neighbour(self, message: Message, now_s: float) -> None:
        seen = neighbour_of(message, now_s)
        if isinstance(seen, str):
            self.rejected[seen] += 1
            return
        # A detector that shows anybody is there, whether or not the table has room.
        self.seen_s = now_s
        here_deg = self.telemetry.lat_deg, self.telemetry.lon_deg
        if not entered(self.neighbours, message.ICAO_address, seen, here_deg, now_s):
            self.rejected["too many neighbours"] += 1
