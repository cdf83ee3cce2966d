"""The adapter of ArduPilot rovers and boats: velocity setpoints in GUIDED, as for the copter. Not measured.

Nothing here was tried on ArduPilot's rover: modes, mask and parameters are from its documentation, and the lags are
cautious guesses. A rover has no height; its configuration has `height_min_m: 0`.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega

from companion.autopilot.adapter import Abilities
from companion.autopilot.ardupilot import EKF_RATE_HZ, fence_checks, no_gcs_failsafe
from companion.autopilot.heartbeat import ARDUROVER
from companion.autopilot.linked import COMMON_RATES_HZ
from companion.autopilot.parameter_checks import ParameterCheck
from companion.autopilot.parameters import Wanted
from companion.autopilot.velocity import VelocityAdapter

LEAD_S = 0.5
"""Time by which a turning velocity setpoint leads. Guessed."""
REACTION_S = 1.0
"""Time from a setpoint to its effect. Guessed."""
TURN_SHARE = 0.7
"""Share of ATC_TURN_MAX_G that turns are assumed to achieve. Guessed."""
BRAKING_SHARE = 0.5
"""Share of ATC_ACCEL_MAX that braking is assumed to achieve. Guessed."""
TRACKING_M = 3.0
"""Distance within which the rover is assumed to stay of its path. Guessed."""

WANTED = (
    # WP_SPEED 0 stands for CRUISE_SPEED.
    Wanted("CRUISE_SPEED", 2.0, least=0.1, greatest=50.0),
    Wanted("WP_SPEED", 2.0, least=0.0, greatest=50.0),
    Wanted("ATC_TURN_MAX_G", 0.6, least=0.05, greatest=10.0),
    Wanted("ATC_ACCEL_MAX", 1.0, least=0.0, greatest=20.0),
    Wanted("FS_GCS_ENABLE", 0.0),
    Wanted("FENCE_ENABLE", 0.0),
    Wanted("FENCE_ACTION", 1.0),
)
PARAMETER_CHECKS = (
    no_gcs_failsafe("FS_GCS_ENABLE"),
    ParameterCheck("ATC_TURN_MAX_G", "it bounds how fast the rover turns", 0.6, 0.1, 1.0),
    *fence_checks((1.0, 2.0, 3.0, 4.0)),
)


class ArduRoverAdapter(VelocityAdapter):
    """Steers by velocity setpoints over the ground; the height of a setpoint is ignored."""

    identity = ARDUROVER
    wanted = WANTED
    rates_hz = {**COMMON_RATES_HZ, ardupilotmega.MAVLINK_MSG_ID_EKF_STATUS_REPORT: EKF_RATE_HZ}
    parameter_checks = PARAMETER_CHECKS
    lead_s = LEAD_S

    @property
    def abilities(self) -> Abilities:
        """The performance limits that follow from the rover's speed, turn and acceleration parameters."""
        acceleration_m_s2 = max(self.parameters.value("ATC_ACCEL_MAX"), 0.1)
        speed_m_s = self.parameters.value("WP_SPEED") or self.parameters.value("CRUISE_SPEED")
        return Abilities(
            speed_max_m_s=max(speed_m_s, 0.1),
            n_max=TURN_SHARE * self.parameters.value("ATC_TURN_MAX_G"),
            reaction_s=REACTION_S,
            braking_m_s2=BRAKING_SHARE * acceleration_m_s2,
            tracking_m=TRACKING_M,
            assumed=tuple(name for name in self.parameters.assumed if not name.startswith(("FS_", "FENCE_"))),
            insane=self.parameters.insane,
        )

    def _climb_m_s(self, height_m: float) -> float:
        return 0.0
