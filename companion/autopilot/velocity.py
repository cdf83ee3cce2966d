"""Steering by velocity setpoints in the local NED frame, which copters, rovers and the kinematic point obey.

docs/autopilots.md: the setpoints use MAV_FRAME_LOCAL_NED (1), are never acknowledged, and are ignored silently outside
the guided mode.
"""

from __future__ import annotations

import math

from companion.autopilot.course import CourseRamp
from companion.autopilot.linked import LinkedAdapter, is_usable
from companion.geo.kinematics import turn_rate_rad_s
from companion.guard.types import Setpoint

VELOCITY_ONLY = 0x0DC7
"""type_mask of SET_POSITION_TARGET_LOCAL_NED: ignore position, acceleration, yaw and yaw rate."""
VELOCITY_AND_YAW = 0x09C7
"""type_mask of SET_POSITION_TARGET_LOCAL_NED: ignore position, acceleration and yaw rate."""
TURN_RATE_MAX_RAD_S = math.pi / 2.0
"""Greatest rate at which the commanded velocity turns: no vehicle follows one that turns faster."""


class VelocityAdapter(LinkedAdapter):
    """Steers by a velocity over the ground that leads a turning course to compensate for the vehicle's lag."""

    type_mask = VELOCITY_ONLY
    lead_s = 0.0
    """Time by which a turning velocity setpoint leads the course."""

    def __init__(self, system_id: int | None = None) -> None:
        """Listen to the autopilot of this system id; None for whichever is heard first."""
        super().__init__(system_id)
        self._ramp = CourseRamp()

    def encode(self, setpoint: Setpoint, convergence_rad: float, now_s: float) -> list[bytes]:
        """Return SET_POSITION_TARGET_LOCAL_NED with the velocity, turned from grid north to local true north."""
        if not is_usable(setpoint, convergence_rad):
            return []
        heading_rad = self._heading_rad(setpoint.heading_rad + convergence_rad, setpoint.speed_m_s, now_s)
        velocity_m_s = (
            setpoint.speed_m_s * math.cos(heading_rad),
            setpoint.speed_m_s * math.sin(heading_rad),
            -self._climb_m_s(setpoint.altitude_m),
        )
        yaw_rad = 0.0 if self.type_mask == VELOCITY_ONLY else math.remainder(heading_rad, math.tau)
        return self._local_target(self.type_mask, now_s, velocity_m_s, yaw_rad=yaw_rad)

    def release(self) -> None:
        """Forget the course of the engagement that ended."""
        super().release()
        self._ramp.release()

    def _heading_rad(self, wanted_rad: float, speed_m_s: float, now_s: float) -> float:
        """Return the heading of the velocity to command now, from local true north."""
        rate_max_rad_s = turn_rate_rad_s(speed_m_s, self.abilities.n_max)
        present_rad = self._course_rad()
        course_rad, rate_rad_s = self._ramp.towards(
            wanted_rad,
            wanted_rad if present_rad is None else present_rad,
            min(rate_max_rad_s, TURN_RATE_MAX_RAD_S),
            now_s,
        )
        return course_rad + self.lead_s * rate_rad_s
