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

LEAST_DRAG = 1e-3
"""Drag of PX4's simulator (SIH_KDV), N per m/s, below which there is none to reckon with."""
DRAG_UNKNOWN = "not told by its parameters"
"""Why a vehicle's greatest airspeed is not known: PX4 has no parameter of a real vehicle's drag."""

WANTED = (
    *px4.WANTED,
    Wanted("MPC_ACC_HOR", 3.0, least=0.3, greatest=30.0),
    Wanted("MPC_XY_VEL_MAX", 12.0, least=0.5, greatest=60.0),
    Wanted("MPC_TILTMAX_AIR", 45.0, least=5.0, greatest=89.0, optional=True),
    # Of PX4's own simulator alone: the drag, N per m/s, and the mass, kg.
    Wanted("SIH_KDV", 1.0, least=0.0, greatest=100.0, optional=True),
    Wanted("SIH_MASS", 1.0, least=0.01, greatest=1000.0, optional=True),
)
PARAMETER_CHECKS = (
    *px4.PARAMETER_CHECKS,
    ParameterCheck("MPC_ACC_HOR", "it bounds how fast the copter turns and stops", 3.0, 1.0, 10.0),
    ParameterCheck("MPC_XY_VEL_MAX", "it bounds the speed of the copter", 12.0, 2.0, 20.0),
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
        """The performance limits that follow from MPC_ACC_HOR and MPC_XY_VEL_MAX; the airspeed in PX4's simulator."""
        acceleration_m_s2 = self.parameters.value("MPC_ACC_HOR")
        airspeed_m_s, by = self._airspeed()
        return Abilities(
            speed_max_m_s=SPEED_SHARE * self.parameters.value("MPC_XY_VEL_MAX"),
            airspeed_max_m_s=airspeed_m_s,
            airspeed_by=by,
            n_max=TURN_SHARE * acceleration_m_s2 / GRAVITY_M_S2,
            reaction_s=REACTION_S,
            braking_m_s2=BRAKING_SHARE * acceleration_m_s2,
            tracking_m=TRACKING_M,
            assumed=tuple(name for name in self.parameters.assumed if name.startswith("MPC_")),
            insane=self.parameters.insane,
        )

    def _airspeed(self) -> tuple[float, str]:
        """Return the greatest airspeed and what it follows from; inf for a vehicle whose drag is not known.

        MPC_XY_VEL_MAX does not bound it: that limits the speed over the ground, whatever the wind.
        """
        parameters = self.parameters
        drag = parameters.value("SIH_KDV")
        if not parameters.heard("SIH_KDV") or drag < LEAST_DRAG:
            return math.inf, DRAG_UNKNOWN
        tilt_rad = math.radians(parameters.value("MPC_TILTMAX_AIR"))
        names = (parameters.told_as(name) for name in ("MPC_TILTMAX_AIR", "SIH_KDV", "SIH_MASS"))
        return parameters.value("SIH_MASS") * GRAVITY_M_S2 * math.tan(tilt_rad) / drag, ", ".join(map(str, names))

    def hold(self, now_s: float) -> list[bytes]:
        """Return a setpoint of zero velocity with the present yaw; no frames until the yaw is known."""
        yaw_rad = self.telemetry.yaw_rad
        if yaw_rad is None:
            return []
        return self._local_target(self.type_mask, now_s, yaw_rad=math.remainder(yaw_rad, math.tau))
