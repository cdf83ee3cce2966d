"""The telemetry messages of a stand-in autopilot, one by one, and the faults that telemetry can have."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega
from pymavlink.dialects.v20 import common as mavlink

from companion.geo.air_density import true_per_indicated
from sim.mavlink_sender import MavlinkSender
from sim.vehicles.craft import Body, Message
from sim.vehicles.dynamics import CELLS, FlightDynamics
from sim.vehicles.sensors import Estimate
from sim.vehicles.setpoint import clip, rotated

_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
)
"""Sensors that SYS_STATUS shows as present and enabled."""
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
"""Capabilities in AUTOPILOT_VERSION."""
_INT16_MAX, _INT32_MAX, _UINT16_MAX = 2**15 - 1, 2**31 - 1, 2**16 - 1
_KNOWS, _BLIND = 0x33F, 0x25
"""Flags of an estimate that knows its place, and of one that does not any more (measured, docs/autopilots.md)."""
_NO_DILUTION = _UINT16_MAX
"""Dilution of precision in GPS_RAW_INT without a fix: unknown."""


@dataclass(frozen=True, slots=True)
class _Report:
    """What position and attitude messages of one moment are made from: the estimate, its geodetic place, the clock."""

    estimate: Estimate
    lat_deg: float
    lon_deg: float
    convergence_rad: float
    boot_ms: int


class MessageEncoder:
    """Makes the messages that one autopilot streams or sends on request."""

    def __init__(self, dynamics: FlightDynamics, sender: MavlinkSender, boot_s: float, version: int) -> None:
        """Encode the state of the vehicle of `dynamics`; its `time_boot_ms` counts from `boot_s`.

        `version`: AUTOPILOT_VERSION's flight_sw_version.
        """
        self.boot_s = boot_s
        self._version = version
        self._dynamics = dynamics
        self._craft = dynamics.craft
        self._mav = sender.mav
        self._system_id = sender.mav.srcSystem
        self._frozen: _Report | None = None
        self._floats_are_nan = False
        self._encoders: dict[int, Callable[[float], Message]] = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._extended_sys_state,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw_int,
            mavlink.MAVLINK_MSG_ID_GPS2_RAW: self._gps2_raw,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._gps_global_origin,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position_int,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position_ned,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: self._vfr_hud,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self._home_position,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: self._battery_status,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._autopilot_version,
        }

        if self._craft.mav_autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA:
            self._encoders[ardupilotmega.MAVLINK_MSG_ID_EKF_STATUS_REPORT] = self._ekf_status_report
        elif self._craft.mav_autopilot == mavlink.MAV_AUTOPILOT_PX4:
            self._encoders[mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS] = self._estimator_status
        if self._craft.mav_type == mavlink.MAV_TYPE_FIXED_WING:
            # Copters estimate no airspeed unless they are set up for it, and tell no wind then.
            if self._craft.mav_autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA:
                self._encoders[ardupilotmega.MAVLINK_MSG_ID_WIND] = self._wind
            elif self._craft.mav_autopilot == mavlink.MAV_AUTOPILOT_PX4:
                self._encoders[mavlink.MAVLINK_MSG_ID_WIND_COV] = self._wind_cov

    @property
    def has_second_receiver(self) -> bool:
        """Whether there is a second GPS receiver to tell of."""
        return len(self._dynamics.sensors.receivers.fixes) > 1

    def knows(self, message_id: int) -> bool:
        """Return whether `encode` can make the message with this id."""
        return message_id in self._encoders

    def encode(self, message_id: int, t_s: float) -> Message:
        """Return the message with this id, as of the time `t_s`; raise KeyError for an unknown id."""
        return self._encoders[message_id](t_s)

    def freeze(self, frozen: bool) -> None:
        """Make position and attitude messages repeat their present content, `time_boot_ms` included; or end that."""
        self._frozen = self._reported(self._dynamics.now_s) if frozen else None

    def corrupt(self, corrupt: bool) -> None:
        """Make the floats of ATTITUDE, LOCAL_POSITION_NED and VFR_HUD NaN; or end that."""
        self._floats_are_nan = corrupt

    def _reported(self, t_s: float) -> _Report:
        if self._frozen is not None:
            return self._frozen
        dynamics = self._dynamics
        estimate = dynamics.sensors.estimate(self._craft.body, t_s)
        if dynamics.sensors.perfect:
            place = dynamics.geodetic()
        else:
            place = dynamics.geodetic_of(estimate.body.north_m, estimate.body.east_m)
        return _Report(estimate, *place, round((t_s - self.boot_s) * 1000.0) % 2**32)

    def _float(self, value: float) -> float:
        return math.nan if self._floats_are_nan else value

    def _heartbeat(self, t_s: float) -> Message:
        state = mavlink.MAV_STATE_ACTIVE if self._craft.in_air else mavlink.MAV_STATE_STANDBY
        if self._craft.failsafe or self._craft.warned:
            state = mavlink.MAV_STATE_CRITICAL
        return self._mav.heartbeat_encode(
            self._craft.mav_type, self._craft.mav_autopilot, self._craft.base_mode(), self._craft.mode, state
        )

    def _sys_status(self, t_s: float) -> Message:
        health = _SENSORS
        if not self._craft.ready:
            health &= ~(mavlink.MAV_SYS_STATUS_PREARM_CHECK | mavlink.MAV_SYS_STATUS_SENSOR_GPS)
        if not self._reported(t_s).estimate.has_fix:
            health &= ~mavlink.MAV_SYS_STATUS_SENSOR_GPS
        no_current, no_errors = -1, 0
        return self._mav.sys_status_encode(
            *(
                _SENSORS,
                _SENSORS,
                health,
                0,
                self._dynamics.battery.voltage_mv(),
                no_current,
                round(self._dynamics.battery.percent),
            ),
            *(no_errors, no_errors, no_errors, no_errors, no_errors, no_errors),
        )

    def _battery_status(self, t_s: float) -> Message:
        cells_mv = [self._dynamics.battery.voltage_mv() // CELLS] * CELLS + [_UINT16_MAX] * (10 - CELLS)
        unknown_temperature, unknown = _INT16_MAX, -1
        return self._mav.battery_status_encode(
            *(0, mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_TYPE_LIPO, unknown_temperature, cells_mv),
            *(unknown, unknown, unknown, round(self._dynamics.battery.percent)),
        )

    def _autopilot_version(self, t_s: float) -> Message:
        no_hash = (0,) * 8
        return self._mav.autopilot_version_encode(
            _CAPABILITIES, self._version, 0, 0, 0, no_hash, no_hash, no_hash, 0, 0, self._system_id
        )

    def _extended_sys_state(self, t_s: float) -> Message:
        return self._mav.extended_sys_state_encode(mavlink.MAV_VTOL_STATE_UNDEFINED, self._craft.landed_state())

    def _height_mm(self, body: Body) -> tuple[int, int]:
        """Return the heights above sea level and above home in millimetres, clipped to MAVLink's 32 bits."""
        references = self._dynamics.references
        above_home_m = body.altitude_m - references.home.altitude_m
        return _millimetres(body.altitude_m + references.sea_up_m), _millimetres(above_home_m)

    def _global_position_int(self, t_s: float) -> Message:
        report = self._reported(t_s)
        body = report.estimate.body
        north_m_s, east_m_s = _true_velocity_m_s(report)
        return self._mav.global_position_int_encode(
            report.boot_ms,
            round(report.lat_deg * 1e7),
            round(report.lon_deg * 1e7),
            *self._height_mm(body),
            _centimetres_s(north_m_s),
            _centimetres_s(east_m_s),
            _centimetres_s(-body.climb_m_s),
            round(math.degrees(body.heading_rad + report.convergence_rad) * 100.0) % 36000,
        )

    def _local_position_ned(self, t_s: float) -> Message:
        report = self._reported(t_s)
        body = report.estimate.body
        references = self._dynamics.references
        x_m, y_m = references.origin_frame.to_local(report.lat_deg, report.lon_deg)
        z_m = references.origin_altitude_m - body.altitude_m
        values = (x_m, y_m, z_m, *_true_velocity_m_s(report), -body.climb_m_s)
        return self._mav.local_position_ned_encode(report.boot_ms, *map(self._float, values))

    def _attitude(self, t_s: float) -> Message:
        report = self._reported(t_s)
        body = report.estimate.body
        yaw_rad = math.remainder(body.heading_rad + report.convergence_rad, math.tau)
        values = (body.roll_rad, 0.0, yaw_rad, 0.0, 0.0, body.turn_rate_rad_s)
        return self._mav.attitude_encode(report.boot_ms, *map(self._float, values))

    def _vfr_hud(self, t_s: float) -> Message:
        report = self._reported(t_s)
        body = report.estimate.body
        ground_m_s = math.hypot(body.velocity_north_m_s, body.velocity_east_m_s)
        heading_deg = round(math.degrees(body.heading_rad + report.convergence_rad)) % 360
        unknown_throttle = 0
        return self._mav.vfr_hud_encode(
            self._float(body.airspeed_m_s / true_per_indicated(body.altitude_m)),
            self._float(ground_m_s),
            heading_deg,
            unknown_throttle,
            self._float(body.altitude_m),
            self._float(body.climb_m_s),
        )

    def _wind_to(self, t_s: float) -> tuple[float, float]:
        """Return the velocity of the air along true north and east."""
        north_m_s, east_m_s = self._dynamics.wind_m_s
        return rotated(north_m_s, east_m_s, self._reported(t_s).convergence_rad)

    def _wind(self, t_s: float) -> Message:
        north_m_s, east_m_s = self._wind_to(t_s)
        from_deg = math.degrees(math.atan2(-east_m_s, -north_m_s))
        return ardupilotmega.MAVLink_wind_message(from_deg, math.hypot(north_m_s, east_m_s), 0.0)

    def _wind_cov(self, t_s: float) -> Message:
        variance, accuracy = 0.1, 1.0
        north_m_s, east_m_s = self._wind_to(t_s)
        values = (north_m_s, east_m_s, 0.0, variance, variance, 0.0, accuracy, accuracy)
        return self._mav.wind_cov_encode(round(t_s * 1e6), *values)

    def _fix(self, t_s: float, receiver: int) -> tuple[int, ...]:
        """Return what GPS_RAW_INT and GPS2_RAW have in common, and altitude and accuracy in millimetres."""
        report = self._reported(t_s)
        north_m_s, east_m_s = _true_velocity_m_s(report)
        has_fix = self._dynamics.sensors.receivers.fixes[receiver]
        accuracy_mm = round(clip(report.estimate.accuracy_m * 1000.0, 0.0, _INT32_MAX))
        altitude_mm = self._height_mm(report.estimate.body)[0]
        dilution = 80 if has_fix else _NO_DILUTION
        return (
            report.boot_ms * 1000,
            mavlink.GPS_FIX_TYPE_3D_FIX if has_fix else mavlink.GPS_FIX_TYPE_NO_FIX,
            round(report.lat_deg * 1e7),
            round(report.lon_deg * 1e7),
            altitude_mm,
            dilution,
            dilution,
            min(round(math.hypot(north_m_s, east_m_s) * 100.0), _UINT16_MAX),
            round(math.degrees(math.atan2(east_m_s, north_m_s)) * 100.0) % 36000,
            14 if has_fix else 0,
            altitude_mm,
            accuracy_mm,
        )

    def _gps_raw_int(self, t_s: float) -> Message:
        *fix, ellipsoid_mm, accuracy_mm = self._fix(t_s, 0)
        return self._mav.gps_raw_int_encode(*fix, alt_ellipsoid=ellipsoid_mm, h_acc=accuracy_mm, v_acc=accuracy_mm)

    def _gps2_raw(self, t_s: float) -> Message:
        *fix, ellipsoid_mm, accuracy_mm = self._fix(t_s, 1)
        no_correction = 0
        return self._mav.gps2_raw_encode(
            *fix,
            no_correction,
            no_correction,
            alt_ellipsoid=ellipsoid_mm,
            h_acc=accuracy_mm,
            v_acc=accuracy_mm,
        )

    def _ekf_status_report(self, t_s: float) -> Message:
        flags, ratio = self._estimator(t_s, ardupilotmega.EKF_GPS_GLITCHING)
        return ardupilotmega.MAVLink_ekf_status_report_message(flags, 0.01, ratio, 0.01, 0.01, 0.0)

    def _estimator_status(self, t_s: float) -> Message:
        flags, ratio = self._estimator(t_s, mavlink.ESTIMATOR_GPS_GLITCH)
        accuracy_m = self._reported(t_s).estimate.accuracy_m
        ratios = (0.01, ratio, 0.01, 0.01, 0.0, 0.0)
        return self._mav.estimator_status_encode(round(t_s * 1e6), flags, *ratios, accuracy_m, accuracy_m)

    def _estimator(self, t_s: float, glitch: int) -> tuple[int, float]:
        """Return the flags of the estimate, and the test ratio of its position."""
        sensors = self._dynamics.sensors
        flags = _KNOWS if sensors.receivers.know_place(t_s) else _BLIND
        return (flags | glitch, 20.0) if sensors.glitches else (flags, 0.01)

    def _gps_global_origin(self, t_s: float) -> Message:
        references = self._dynamics.references
        return self._mav.gps_global_origin_encode(
            round(references.origin_frame.lat_deg * 1e7),
            round(references.origin_frame.lon_deg * 1e7),
            _millimetres(references.origin_altitude_m),
        )

    def _home_position(self, t_s: float) -> Message:
        lat_deg, lon_deg = self._dynamics.references.home_deg
        level = (1.0, 0.0, 0.0, 0.0)
        return self._mav.home_position_encode(
            round(lat_deg * 1e7),
            round(lon_deg * 1e7),
            _millimetres(self._dynamics.references.home.altitude_m),
            *(0.0, 0.0, 0.0),
            level,
            *(0.0, 0.0, 0.0),
        )


def _true_velocity_m_s(report: _Report) -> tuple[float, float]:
    body = report.estimate.body
    return rotated(body.velocity_north_m_s, body.velocity_east_m_s, report.convergence_rad)


def _millimetres(metres: float) -> int:
    return round(clip(metres * 1000.0, -_INT32_MAX, _INT32_MAX))


def _centimetres_s(speed_m_s: float) -> int:
    return round(clip(speed_m_s * 100.0, -_INT16_MAX, _INT16_MAX))
