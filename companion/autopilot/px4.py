"""The message rates, parameters and checks of both PX4 kinds, which are steered in OFFBOARD.

docs/autopilots.md: setpoints must flow before a safety pilot can choose OFFBOARD. When the stream stops, PX4 does what
COM_OBL_RC_ACT says COM_OF_LOSS_T later; when it comes back, PX4 re-enters OFFBOARD whatever happened since.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import common

from companion.autopilot.linked import COMMON_RATES_HZ, WIND_RATE_HZ
from companion.autopilot.parameter_checks import ParameterCheck
from companion.autopilot.parameters import Wanted

RATES_HZ = {
    **COMMON_RATES_HZ,
    common.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    common.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
    common.MAVLINK_MSG_ID_WIND_COV: WIND_RATE_HZ,
}
WANTED = (
    Wanted("COM_OF_LOSS_T", 1.0),
    Wanted("COM_OBL_RC_ACT", 0.0),
    Wanted("GF_ACTION", 2.0),
    # In PX4 1.12 and 1.13 alone, beside COM_OBL_RC_ACT.
    Wanted("COM_OBL_ACT", 0.0, optional=True),
)
PARAMETER_CHECKS = (
    ParameterCheck(
        "COM_OF_LOSS_T",
        "so long after its companion died the vehicle flies on by the last setpoint",
        1.0,
        # Longer than STREAM_GAP_S, the gap after which the companion itself counts its stream as ended.
        0.8,
        1.0,
    ),
    ParameterCheck(
        "COM_OBL_RC_ACT",
        "only 5 (Hold) keeps place and height when the stream ends; 0 drifts and sinks, or flies straight on",
        5.0,
        allowed=(5.0,),
    ),
    ParameterCheck(
        "COM_OBL_ACT",
        "without radio control it counts instead of COM_OBL_RC_ACT, and only 1 (Hold) keeps place and height",
        1.0,
        allowed=(1.0,),
        when_told=True,
    ),
    ParameterCheck(
        "GF_ACTION",
        "the autopilot's own fence holds when the companion is dead",
        2.0,
        allowed=(2.0, 3.0, 5.0),
        when_fenced=True,
        further=" (Hold) or 3 (Return) and upload the fence",
    ),
)
