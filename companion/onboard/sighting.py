"""What one tick sees of how the vehicle has answered the setpoint in force, on the picture's plane."""

from __future__ import annotations

import math

from companion.autopilot.telemetry import Telemetry
from companion.geo.air_density import true_per_indicated
from companion.geo.local_frame import to_grid
from companion.onboard.engagement import Engagement
from companion.onboard.navigation import Located
from companion.onboard.obedience import Seen

TOLD_MAX_AGE_S = 5.0
"""Age from which a told airspeed or wind no longer counts; they are asked for once or twice a second."""


def seen_of(located: Located, telemetry: Telemetry, before: Engagement, now_s: float) -> Seen:
    """Return what the telemetry says at a time of the vehicle under the setpoint that the last tick left in force."""
    motion, turned_rad = located.motion, located.convergence_rad
    wind_ned_m_s = None
    if telemetry.wind_ned_m_s is not None and now_s - telemetry.wind_at_s <= TOLD_MAX_AGE_S:
        wind_ned_m_s = to_grid(*telemetry.wind_ned_m_s, turned_rad)
    airspeed_m_s = math.nan
    if now_s - telemetry.airspeed_at_s <= TOLD_MAX_AGE_S:
        airspeed_m_s = telemetry.airspeed_m_s * true_per_indicated(telemetry.altitude_m)
    return Seen(
        at_s=located.fix.at_s,
        course_rad=motion.heading_rad,
        speed_m_s=motion.speed_m_s,
        asked=None if before.setpoint is None else before.setpoint.setpoint,
        yaw_rad=None if telemetry.yaw_rad is None else telemetry.yaw_rad - turned_rad,
        airspeed_m_s=airspeed_m_s,
        wind_ned_m_s=wind_ned_m_s,
    )
