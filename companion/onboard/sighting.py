"""What one tick sees of how the vehicle has answered the setpoint in force, on the picture's plane."""

from __future__ import annotations

import math

from companion.autopilot.telemetry import Telemetry
from companion.onboard.engagement import Engagement
from companion.onboard.navigation import Located
from companion.onboard.obedience import Seen


def seen_of(located: Located, telemetry: Telemetry, before: Engagement) -> Seen:
    """Return what the telemetry says of the vehicle under the setpoint that the last tick left in force."""
    motion, turned_rad = located.motion, located.convergence_rad
    wind_ned_m_s = None
    if telemetry.wind_ned_m_s is not None:
        north_m_s, east_m_s = telemetry.wind_ned_m_s
        speed_m_s, to_rad = math.hypot(north_m_s, east_m_s), math.atan2(east_m_s, north_m_s) - turned_rad
        wind_ned_m_s = (speed_m_s * math.cos(to_rad), speed_m_s * math.sin(to_rad))
    return Seen(
        at_s=located.fix.at_s,
        course_rad=motion.heading_rad,
        speed_m_s=motion.speed_m_s,
        asked=None if before.setpoint is None else before.setpoint.setpoint,
        yaw_rad=None if telemetry.yaw_rad is None else telemetry.yaw_rad - turned_rad,
        airspeed_m_s=telemetry.airspeed_m_s,
        wind_ned_m_s=wind_ned_m_s,
    )
