"""ArduPilot rovers and boats in GUIDED: velocity setpoints, as the copter's. Unmeasured.

Nothing here was tried on ArduPilot's rover: the modes, the mask and the parameters are its documentation's, the lags
are guesses on the side of caution. A rover has no height; its configuration says `height_min_m: 0`.
"""

from __future__ import annotations

from companion.autopilot.adapter import Abilities
from companion.autopilot.ardupilot import fence_checks, no_gcs_failsafe
from companion.autopilot.heartbeat import ARDUROVER
from companion.autopilot.parameter_checks import ParameterCheck
from companion.autopilot.parameters import Wanted
from companion.autopilot.velocity import VelocityAdapter

LEAD_S = 0.5
REACTION_S = 1.0
TURN_SHARE = 0.7
"""Of ATC_TURN_MAX_G."""
BRAKING_SHARE = 0.5
TRACKING_M = 3.0

WANTED = (
    Wanted("CRUISE_SPEED", 2.0),
    Wanted("WP_SPEED", 2.0),
    Wanted("ATC_TURN_MAX_G", 0.6),
    Wanted("ATC_ACCEL_MAX", 1.0),
    Wanted("FS_GCS_ENABLE", 0.0),
    Wanted("FENCE_ENABLE", 0.0),
    Wanted("FENCE_ACTION", 1.0),
)
PARAMETER_CHECKS = (
    no_gcs_failsafe("FS_GCS_ENABLE"),
    ParameterCheck("ATC_TURN_MAX_G", "it bounds how fast the rover turns", "set ATC_TURN_MAX_G to 0.6", 0.1, 1.0),
    *fence_checks((1.0, 2.0, 3.0, 4.0)),
)


class ArduRoverAdapter(VelocityAdapter):
    """Velocity over the ground; the climb of a setpoint means nothing to a rover."""

    identity = ARDUROVER
    wanted = WANTED
    parameter_checks = PARAMETER_CHECKS
    lead_s = LEAD_S

    @property
    def abilities(self) -> Abilities:
        """What the speeds and ATC_TURN_MAX_G leave."""
        acceleration_m_s2 = max(self.parameters.value("ATC_ACCEL_MAX"), 0.1)
        speed_m_s = self.parameters.value("WP_SPEED") or self.parameters.value("CRUISE_SPEED")
        return Abilities(
            speed_max_m_s=max(speed_m_s, 0.1),
            n_max=TURN_SHARE * max(self.parameters.value("ATC_TURN_MAX_G"), 0.01),
            reaction_s=REACTION_S,
            braking_m_s2=BRAKING_SHARE * acceleration_m_s2,
            tracking_m=TRACKING_M,
            assumed=tuple(name for name in self.parameters.assumed if not name.startswith(("FS_", "FENCE_"))),
        )

    def _climb_m_s(self, height_m: float) -> float:
        return 0.0
