"""The PX4 plane adapter: in OFFBOARD, position and velocity (mask 0xDC0).

The position is the plane's own with the wanted height; the velocity gives the course. docs/autopilots.md: velocity
alone is ignored and freezes the attitude, an acceleration acts with the wrong sign, and the speed is FW_AIRSPD_TRIM
whatever is commanded. PX4 limits only the bank, so this adapter limits the course's rate to n_max g / v.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import common

from companion.autopilot import px4
from companion.autopilot.adapter import Abilities
from companion.autopilot.air import AirDensity
from companion.autopilot.course import CourseRamp
from companion.autopilot.heartbeat import PX4_PLANE
from companion.autopilot.linked import AIRSPEED_RATE_HZ, LinkedAdapter, is_usable
from companion.autopilot.parameter_checks import ParameterCheck
from companion.autopilot.parameters import Wanted
from companion.autopilot.streams import RESTS_ON
from companion.autopilot.telemetry import LOCAL_POSITION_MAX_AGE_S
from companion.geo.kinematics import turn_rate_rad_s
from companion.guard.types import Setpoint

POSITION_AND_VELOCITY = 0x0DC0
"""type_mask of SET_POSITION_TARGET_LOCAL_NED: ignore acceleration, yaw and yaw rate."""
LEAD_S = 0.9
"""Time by which a turning course leads: most of the course's lag of 1.17 s on a steady turn. With 1.15 s a steady turn
was followed within 0.7 degrees, but the stand-in then begins and ends turns too early and strays 6.7 m."""
VECTOR_M_S = 15.0
"""Length of the velocity vector that gives the course; PX4 uses only its direction."""
HEIGHT_STEP_M = 8.0
"""Greatest height difference that is commanded: with one over 10 m the plane loiters instead of holding its course."""
REACTION_S = 0.2
"""Part of the course's lag that LEAD_S leaves. Measured on the stand-in, on turns of 8 to 360 degrees at the greatest
rate (tests/benchmarks/lags.py)."""
PLANE_LAG_S = 1.17
"""Lag of the course on a steady turn: to turn at a rate, command a course that is ahead of the present one by that rate
times this lag (docs/autopilots.md)."""
CIRCLE_SHARE = 0.8
"""Share of the greatest turn rate at which the plane circles in OFFBOARD while it has no setpoint."""
N_MAX = 0.4
"""Greatest load factor of turns: a turn rate of 15 deg/s at 15 m/s was followed within 0.7 degrees."""
BANK_SHARE = 0.7
"""Share of the load factor of the greatest bank (FW_R_LIM) that turns may use."""
TRACKING_M = 2.0
"""Distance within which the vehicle stays of its path with REACTION_S; measured like REACTION_S."""

WANTED = (
    *px4.WANTED,
    Wanted("FW_AIRSPD_TRIM", 15.0, least=5.0, greatest=60.0),
    Wanted("FW_R_LIM", 50.0, least=10.0, greatest=85.0),
)
PARAMETER_CHECKS = (
    *px4.PARAMETER_CHECKS,
    ParameterCheck("FW_AIRSPD_TRIM", "it is the speed, whatever is asked for", 15.0, 8.0, 40.0),
    ParameterCheck("FW_R_LIM", "it bounds how fast the plane turns", 50.0, 30.0, 65.0),
)


class Px4PlaneAdapter(LinkedAdapter):
    """Steers by a commanded course that leads the wanted one to compensate for the plane's lag."""

    identity = PX4_PLANE
    steers_in_local_frame = True
    wanted = WANTED
    parameter_checks = PARAMETER_CHECKS
    rates_hz = {**px4.RATES_HZ, common.MAVLINK_MSG_ID_VFR_HUD: AIRSPEED_RATE_HZ}
    rests_on = {**RESTS_ON, common.MAVLINK_MSG_ID_LOCAL_POSITION_NED: "the position in every setpoint"}

    def __init__(self, system_id: int | None = None) -> None:
        """Listen to the autopilot of this system id; None for whichever is heard first."""
        super().__init__(system_id)
        self._ramp = CourseRamp()
        self._air = AirDensity()

    @property
    def abilities(self) -> Abilities:
        """The performance limits that follow from FW_AIRSPD_TRIM, a calibrated airspeed, and FW_R_LIM."""
        speed_m_s = self._air.ratio * self.parameters.value("FW_AIRSPD_TRIM")
        bank_rad = math.radians(min(self.parameters.value("FW_R_LIM"), 65.0))
        return Abilities(
            speed_min_m_s=speed_m_s,
            speed_max_m_s=speed_m_s,
            airspeed_max_m_s=speed_m_s,
            airspeed_by=str(self.parameters.told_as("FW_AIRSPD_TRIM")),
            n_max=min(N_MAX, BANK_SHARE * math.tan(bank_rad)),
            reaction_s=REACTION_S,
            tracking_m=TRACKING_M,
            assumed=tuple(name for name in self.parameters.assumed if name.startswith("FW_")),
            insane=self.parameters.insane,
        )

    @property
    def missing_telemetry(self) -> str | None:
        """The local position, which every setpoint contains, if the autopilot does not send it; else None."""
        return "no local position" if self.telemetry.local_ned_m is None else None

    def encode(self, setpoint: Setpoint, convergence_rad: float, now_s: float) -> list[bytes]:
        """Return SET_POSITION_TARGET_LOCAL_NED with the course, turned from grid to local north, and the height."""
        present_rad = self._course_rad()
        if present_rad is None or not is_usable(setpoint, convergence_rad):
            return []
        self._air.engage()
        abilities = self.abilities
        course_rad, rate_rad_s = self._ramp.towards(
            setpoint.heading_rad + convergence_rad,
            present_rad,
            turn_rate_rad_s(abilities.speed_max_m_s, abilities.n_max),
            now_s,
        )
        return self._course(course_rad + LEAD_S * rate_rad_s, setpoint.altitude_m, now_s)

    def hold(self, now_s: float) -> list[bytes]:
        """Return a setpoint of the present course and height; in OFFBOARD one that circles, to stay near."""
        course_rad = self._course_rad()
        if course_rad is None:
            return []
        if self.steerable:
            abilities = self.abilities
            rate_rad_s = turn_rate_rad_s(abilities.speed_max_m_s, CIRCLE_SHARE * abilities.n_max)
            course_rad += PLANE_LAG_S * rate_rad_s
        return self._course(course_rad, self.telemetry.height_m, now_s)

    def release(self) -> None:
        """Forget the course of the engagement that ended."""
        super().release()
        self._ramp.release()
        self._air.release()

    def receive(self, datagram: bytes, now_s: float) -> int:
        """Process whole frames from the autopilot link, and note how dense the air is where the plane flies."""
        believed = super().receive(datagram, now_s)
        self._air.note(self.telemetry.altitude_m)
        return believed

    def _ages_s(self, timeout_s: float) -> dict[int, float]:
        local = {common.MAVLINK_MSG_ID_LOCAL_POSITION_NED: LOCAL_POSITION_MAX_AGE_S}
        return super()._ages_s(timeout_s) | local

    def _course(self, course_rad: float, height_m: float, now_s: float) -> list[bytes]:
        telemetry = self.telemetry
        if telemetry.local_ned_m is None:
            return []
        north_m, east_m, down_m = telemetry.local_ned_m
        up_m = min(max(height_m - telemetry.height_m, -HEIGHT_STEP_M), HEIGHT_STEP_M)
        velocity_m_s = (VECTOR_M_S * math.cos(course_rad), VECTOR_M_S * math.sin(course_rad), 0.0)
        return self._local_target(POSITION_AND_VELOCITY, now_s, velocity_m_s, (north_m, east_m, down_m - up_m))
