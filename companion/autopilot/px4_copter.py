"""The PX4 copter adapter: in OFFBOARD, the same frames as MAVSDK's set_velocity_ned (velocity and yaw, mask 0x9C7).

Figures without another source are from docs/autopilots.md.
"""

from __future__ import annotations

import math

from companion.autopilot import px4
from companion.autopilot.adapter import Abilities
from companion.autopilot.heartbeat import PX4_COPTER
from companion.autopilot.parameter_checks import ParameterCheck
from companion.autopilot.parameters import Wanted
from companion.autopilot.velocity import VELOCITY_AND_YAW, VelocityAdapter
from companion.geo.kinematics import GRAVITY_M_S2

LEAD_S = 0.5
"""Time by which a turning velocity setpoint leads: most of the velocity's lag on a steady turn."""
REACTION_S = 0.2
"""Part of the velocity's lag that LEAD_S leaves. Measured on the stand-in, on turns of 8 to 360 degrees at the greatest
rate (tests/benchmarks/lags.py)."""
TURN_SHARE = 0.7
"""Share of the acceleration MPC_ACC_HOR that turns may use."""
BRAKING_SHARE = 0.8
"""Share of the acceleration MPC_ACC_HOR that braking is assumed to achieve."""
SPEED_SHARE = 0.85
"""Share of the speed MPC_XY_VEL_MAX that is commanded at most."""
TRACKING_M = 1.5
"""Distance within which the vehicle stays of its path with REACTION_S, at 5 and 10 m/s; measured like REACTION_S."""

WANTED = (*px4.WANTED, Wanted("MPC_ACC_HOR", 3.0), Wanted("MPC_XY_VEL_MAX", 12.0))
PARAMETER_CHECKS = (
    *px4.PARAMETER_CHECKS,
    ParameterCheck("MPC_ACC_HOR", "it bounds how fast the copter turns and stops", "set MPC_ACC_HOR to 3", 1.0, 10.0),
    ParameterCheck("MPC_XY_VEL_MAX", "it bounds the speed of the copter", "set MPC_XY_VEL_MAX to 12", 2.0, 20.0),
)


class Px4CopterAdapter(VelocityAdapter):
    """Steers by velocity setpoints with the yaw along the track."""

    identity = PX4_COPTER
    wanted: tuple[Wanted, ...] = WANTED
    parameter_checks = PARAMETER_CHECKS
    rates_hz = px4.RATES_HZ
    type_mask = VELOCITY_AND_YAW
    lead_s = LEAD_S

    @property
    def abilities(self) -> Abilities:
        """The performance limits that follow from MPC_ACC_HOR and MPC_XY_VEL_MAX."""
        acceleration_m_s2 = max(self.parameters.value("MPC_ACC_HOR"), 0.1)
        return Abilities(
            speed_max_m_s=SPEED_SHARE * max(self.parameters.value("MPC_XY_VEL_MAX"), 0.1),
            n_max=TURN_SHARE * acceleration_m_s2 / GRAVITY_M_S2,
            reaction_s=REACTION_S,
            braking_m_s2=BRAKING_SHARE * acceleration_m_s2,
            tracking_m=TRACKING_M,
            assumed=tuple(name for name in self.parameters.assumed if name.startswith("MPC_")),
        )

    def hold(self, now_s: float) -> list[bytes]:
        """Return a setpoint of zero velocity with the present yaw; no frames until the yaw is known."""
        yaw_rad = self.telemetry.yaw_rad
        if yaw_rad is None:
            return []
        return self._local_target(self.type_mask, now_s, yaw_rad=math.remainder(yaw_rad, math.tau))
