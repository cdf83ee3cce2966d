"""The adapter of the simulator's kinematic point, which flies arcs, cannot stop and obeys setpoints at once, exactly.

Its stand-in's HEARTBEAT has MAV_AUTOPILOT_GENERIC, unlike ArduPilot's and PX4's, so that no real plane is taken for it.
"""

from __future__ import annotations

from companion.autopilot.heartbeat import KINEMATIC
from companion.autopilot.velocity import VelocityAdapter


class KinematicAdapter(VelocityAdapter):
    """Steers by velocity setpoints; requests no messages or parameters and compensates no lag."""

    identity = KINEMATIC
    rates_hz: dict[int, float] = {}

    def _heading_rad(self, wanted_rad: float, speed_m_s: float, now_s: float) -> float:
        return wanted_rad
