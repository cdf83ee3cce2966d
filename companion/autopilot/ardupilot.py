"""The parameter checks common to all ArduPilot vehicles: no ground-station failsafe, and the autopilot's own fence."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega, common

from companion.autopilot.linked import ADSB_RATE_HZ, ADSB_TYPE, COMMON_RATES_HZ, NO_RECEIVER, WIND_RATE_HZ
from companion.autopilot.parameter_checks import ParameterCheck
from companion.autopilot.parameters import Wanted

EKF_RATE_HZ = 1.0
"""Rate of EKF_STATUS_REPORT, which says whether the autopilot knows where it is."""
RATES_HZ = {
    **COMMON_RATES_HZ,
    common.MAVLINK_MSG_ID_ADSB_VEHICLE: ADSB_RATE_HZ,
    ardupilotmega.MAVLINK_MSG_ID_WIND: WIND_RATE_HZ,
    ardupilotmega.MAVLINK_MSG_ID_EKF_STATUS_REPORT: EKF_RATE_HZ,
}
"""Rates of the messages that ArduPilot is asked for: unlike PX4 it sends ADSB_VEHICLE to nobody who did not ask. A
copter sends WIND only if it has an estimate of its airspeed."""
RECEIVER = Wanted(ADSB_TYPE, NO_RECEIVER, optional=True)
"""The parameter that says whether there is an ADS-B receiver; a small board has neither."""


def fence_checks(actions: tuple[float, ...]) -> tuple[ParameterCheck, ...]:
    """Return the checks of the fence parameters; `actions`: the values of FENCE_ACTION that bring the vehicle back."""
    return (
        ParameterCheck(
            "FENCE_ENABLE",
            "the autopilot's own fence holds when the companion is dead",
            1.0,
            allowed=(1.0,),
            when_fenced=True,
            further=" and upload the fence",
        ),
        ParameterCheck(
            "FENCE_ACTION",
            "a fence that only reports, or that leaves the vehicle in GUIDED, holds nobody",
            actions[0],
            allowed=actions,
            when_fenced=True,
        ),
    )


def no_gcs_failsafe(name: str) -> ParameterCheck:
    """Return the check that the ground-station failsafe is off; its parameter's name differs from kind to kind."""
    return ParameterCheck(
        name,
        "a vehicle that only listens is out of its ground station's reach by design",
        0.0,
        allowed=(0.0,),
    )
