"""The simulator's point that turns on arcs and cannot stop: it obeys velocity setpoints at once and exactly.

Its stand-in says MAV_AUTOPILOT_GENERIC, which no ArduPilot or PX4 does, so that a real plane is never taken for it.
"""

from __future__ import annotations

from companion.autopilot.heartbeat import KINEMATIC
from companion.autopilot.velocity import VelocityAdapter


class KinematicAdapter(VelocityAdapter):
    """Asks for nothing and knows of no lag."""

    identity = KINEMATIC
    rates_hz: dict[int, float] = {}

    def _heading_rad(self, wanted_rad: float, speed_m_s: float, now_s: float) -> float:
        return wanted_rad
