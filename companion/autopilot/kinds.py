"""The kinds of autopilot that can be steered, as data that is needed before an autopilot is connected."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AutopilotKind:
    """One kind of autopilot that the companion can steer."""

    name: str
    """The kind's name in configurations and on command lines."""
    can_stop: bool
    """Whether the vehicle can stop and hold its position."""
    resumes_on_stream: bool = False
    """Whether the autopilot re-enters its guided mode by itself when a stream of setpoints comes back."""


ARDUCOPTER = AutopilotKind("arducopter", can_stop=True)
ARDUPLANE = AutopilotKind("arduplane", can_stop=False)
PX4_COPTER = AutopilotKind("px4-copter", can_stop=True, resumes_on_stream=True)
PX4_PLANE = AutopilotKind("px4-plane", can_stop=False, resumes_on_stream=True)
ARDUROVER = AutopilotKind("ardurover", can_stop=True)
KINEMATIC = AutopilotKind("kinematic", can_stop=False)

CRUISE_M_S = {"arducopter": 8.0, "arduplane": 22.0, "px4-copter": 10.0, "px4-plane": 15.0}
"""Cruise speed by autopilot kind (docs/autopilots.md). ArduCopter follows turns only below the 10.3 m/s that 30 degrees
of lean give; ArduPlane's simulator cruises at 22 m/s; a PX4 copter reaches 10 m/s; a PX4 plane always flies
FW_AIRSPD_TRIM, 15 m/s."""

KINDS: dict[str, AutopilotKind] = {
    kind.name: kind for kind in (ARDUCOPTER, ARDUPLANE, PX4_COPTER, PX4_PLANE, ARDUROVER, KINEMATIC)
}
"""All kinds by name."""
