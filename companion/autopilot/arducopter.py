"""The ArduCopter adapter: velocity setpoints in GUIDED; the copter brakes GUID_TIMEOUT + 0.5 s after the last one.

Figures without another source are from docs/autopilots.md.
"""

from __future__ import annotations

import math

from companion.autopilot.adapter import Abilities
from companion.autopilot.ardupilot import RATES_HZ, RECEIVER, fence_checks, no_gcs_failsafe
from companion.autopilot.heartbeat import ARDUCOPTER
from companion.autopilot.parameter_checks import ParameterCheck
from companion.autopilot.parameters import Wanted
from companion.autopilot.velocity import VelocityAdapter
from companion.geo.kinematics import GRAVITY_M_S2

LEAD_S = 0.45
"""Time by which a turning velocity setpoint leads: most of the lag of 0.62 s on a steady turn."""
REACTION_S = 0.2
"""Part of the velocity's lag that LEAD_S leaves. Measured on the stand-in, on turns of 8 to 360 degrees at the greatest
rate (tests/benchmarks/lags.py)."""
TURN_SHARE = 0.7
"""Share of the acceleration WPNAV_ACCEL that turns may use; with nearly all of it the speed collapses in turns."""
BRAKING_SHARE = 0.8
"""Share of the acceleration WPNAV_ACCEL that braking is assumed to achieve."""
TOP_SPEED_AT_45_DEG_M_S = 15.0
"""Measured top speed at a lean angle (ANGLE_MAX) of 45 degrees."""
TOP_SPEED_AT_30_DEG_M_S = 10.3
"""Measured top speed at a lean angle (ANGLE_MAX) of 30 degrees."""
_TOP_SPEED_EXPONENT = math.log(TOP_SPEED_AT_45_DEG_M_S / TOP_SPEED_AT_30_DEG_M_S) / math.log(
    1.0 / math.tan(math.radians(30.0))
)
"""Exponent of the top speed's dependence on the tangent of the lean angle, through the two measured points."""
SPEED_SHARE = 0.85
"""Share of the top speed that is commanded at most: a speed beyond reach winds up the controller, and turns need some
of the lean angle."""
TRACKING_M = 1.6
"""Distance within which the vehicle stays of its path with REACTION_S, at 4 and 8 m/s; measured like REACTION_S."""
LEAN_MAX_CDEG = 4500.0
"""Greatest lean angle (ANGLE_MAX) that `companion check` allows: the greatest one that was measured."""

WANTED = (
    # Sane: half to four times what ArduPilot's parameter reference allows.
    Wanted("WPNAV_ACCEL", 250.0, (("WP_ACC", 100.0),), least=25.0, greatest=2000.0),
    Wanted("ANGLE_MAX", 3000.0, (("ATC_ANGLE_MAX", 100.0),), least=1000.0, greatest=8000.0),
    Wanted("GUID_TIMEOUT", 3.0),
    Wanted("FS_GCS_ENABLE", 0.0),
    Wanted("FENCE_ENABLE", 0.0),
    Wanted("FENCE_ACTION", 1.0),
    RECEIVER,
)
PARAMETER_CHECKS = (
    ParameterCheck(
        "GUID_TIMEOUT",
        "a copter whose companion died brakes so long after the last setpoint",
        1.0,
        0.5,
        1.0,
    ),
    no_gcs_failsafe("FS_GCS_ENABLE"),
    ParameterCheck("WPNAV_ACCEL", "it bounds how fast the copter turns and stops", 250.0, 100.0, 1000.0),
    ParameterCheck("ANGLE_MAX", "it bounds the speed that the copter reaches", 3000.0, 2000.0, LEAN_MAX_CDEG),
    *fence_checks((1.0, 2.0, 3.0, 4.0, 5.0)),
)


class ArduCopterAdapter(VelocityAdapter):
    """Steers by velocity setpoints; the copter itself yaws along its track."""

    identity = ARDUCOPTER
    wanted: tuple[Wanted, ...] = WANTED
    rates_hz = RATES_HZ
    parameter_checks = PARAMETER_CHECKS
    lead_s = LEAD_S

    @property
    def abilities(self) -> Abilities:
        """The performance limits that follow from WPNAV_ACCEL and ANGLE_MAX."""
        parameters = self.parameters
        acceleration_m_s2 = parameters.value("WPNAV_ACCEL") / 100.0
        lean_cdeg, lean = parameters.value("ANGLE_MAX"), parameters.told_as("ANGLE_MAX")
        top_speed_m_s = _top_speed_m_s(lean_cdeg)
        remedy = ""
        if lean_cdeg < LEAN_MAX_CDEG:
            most = lean._replace(value=lean.in_its_unit(LEAN_MAX_CDEG))
            remedy = f"{most.name} to {most.value:g} ({_top_speed_m_s(LEAN_MAX_CDEG):.3g} m/s)"
        return Abilities(
            speed_max_m_s=SPEED_SHARE * top_speed_m_s,
            airspeed_max_m_s=top_speed_m_s,
            airspeed_by=str(lean),
            airspeed_remedy=remedy,
            n_max=TURN_SHARE * acceleration_m_s2 / GRAVITY_M_S2,
            reaction_s=REACTION_S,
            braking_m_s2=BRAKING_SHARE * acceleration_m_s2,
            tracking_m=TRACKING_M,
            assumed=tuple(name for name in parameters.assumed if name in ("WPNAV_ACCEL", "ANGLE_MAX")),
            insane=parameters.insane,
        )


def _top_speed_m_s(lean_cdeg: float) -> float:
    """Return the greatest true airspeed at a lean angle in centidegrees: there the lean balances the drag."""
    return float(TOP_SPEED_AT_45_DEG_M_S * math.tan(math.radians(lean_cdeg / 100.0)) ** _TOP_SPEED_EXPONENT)
