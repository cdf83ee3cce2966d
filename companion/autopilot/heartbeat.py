"""The HEARTBEAT fields that identify each autopilot kind, among them the mode by which a safety pilot hands over."""

from __future__ import annotations

from dataclasses import dataclass

from pymavlink.dialects.v20 import common

from companion.autopilot import kinds
from companion.autopilot.kinds import AutopilotKind

COPTER_TYPES = frozenset(
    {
        common.MAV_TYPE_QUADROTOR,
        common.MAV_TYPE_COAXIAL,
        common.MAV_TYPE_HELICOPTER,
        common.MAV_TYPE_HEXAROTOR,
        common.MAV_TYPE_OCTOROTOR,
        common.MAV_TYPE_TRICOPTER,
        common.MAV_TYPE_DODECAROTOR,
        common.MAV_TYPE_DECAROTOR,
    }
)
PLANE_TYPES = frozenset({common.MAV_TYPE_FIXED_WING})
ROVER_TYPES = frozenset({common.MAV_TYPE_GROUND_ROVER, common.MAV_TYPE_SURFACE_BOAT})


@dataclass(frozen=True)
class HeartbeatIdentity:
    """The HEARTBEAT fields of one autopilot kind."""

    kind: AutopilotKind
    autopilot: int
    """The kind's MAV_AUTOPILOT."""
    types: frozenset[int] | None
    """The MAV_TYPEs of the kind; None for any."""
    guided_mode: int
    """The custom_mode in which the autopilot obeys setpoints."""


ARDUCOPTER = HeartbeatIdentity(kinds.ARDUCOPTER, common.MAV_AUTOPILOT_ARDUPILOTMEGA, COPTER_TYPES, 4)
ARDUPLANE = HeartbeatIdentity(kinds.ARDUPLANE, common.MAV_AUTOPILOT_ARDUPILOTMEGA, PLANE_TYPES, 15)
ARDUROVER = HeartbeatIdentity(kinds.ARDUROVER, common.MAV_AUTOPILOT_ARDUPILOTMEGA, ROVER_TYPES, 15)
PX4_COPTER = HeartbeatIdentity(kinds.PX4_COPTER, common.MAV_AUTOPILOT_PX4, COPTER_TYPES, 6 << 16)
PX4_PLANE = HeartbeatIdentity(kinds.PX4_PLANE, common.MAV_AUTOPILOT_PX4, PLANE_TYPES, 6 << 16)
KINEMATIC = HeartbeatIdentity(kinds.KINEMATIC, common.MAV_AUTOPILOT_GENERIC, None, 4)
IDENTITIES = (ARDUCOPTER, ARDUPLANE, PX4_COPTER, PX4_PLANE, ARDUROVER, KINEMATIC)


def identified(autopilot: int | None, mav_type: int | None) -> HeartbeatIdentity | None:
    """Return the identity with this MAV_AUTOPILOT and MAV_TYPE; None for an autopilot that cannot be steered."""
    for identity in IDENTITIES:
        if identity.autopilot == autopilot and (identity.types is None or mav_type in identity.types):
            return identity
    return None
