"""Stand-in autopilots: simulated ArduPilot and PX4 vehicles that speak MAVLink to a companion."""

from __future__ import annotations

from collections.abc import Callable

from sim.vehicles.arducopter import ArduCopter
from sim.vehicles.arduplane import ArduPlane
from sim.vehicles.craft import Craft, Home, Start
from sim.vehicles.dynamics import Truth
from sim.vehicles.kinematic import kinematic_profile
from sim.vehicles.px4_copter import Px4Copter
from sim.vehicles.px4_plane import Px4Plane
from sim.vehicles.stand_in import Setup, StandIn
from sim.vehicles.telemetry import DEFAULT_RATES_HZ, LOCKSTEP_RATES_HZ

__all__ = [
    "CRAFTS",
    "DEFAULT_RATES_HZ",
    "LOCKSTEP_RATES_HZ",
    "ArduCopter",
    "ArduPlane",
    "Craft",
    "Home",
    "Setup",
    "StandIn",
    "Start",
    "Truth",
    "kinematic_profile",
]

CRAFTS: dict[str, Callable[[Start], Craft]] = {
    "arducopter": ArduCopter,
    "arduplane": ArduPlane,
    "px4-copter": Px4Copter,
    "px4-plane": Px4Plane,
}
"""The constructor of the craft of each autopilot kind, by the kind's name."""
