"""One small module per autopilot kind behind one protocol: telemetry in, setpoint out, what the vehicle can do."""

from __future__ import annotations

from typing import Protocol

from companion.autopilot.arducopter import ArduCopterAdapter
from companion.autopilot.arduplane import ArduPlaneAdapter
from companion.autopilot.ardurover import ArduRoverAdapter
from companion.autopilot.kinematic import KinematicAdapter
from companion.autopilot.linked import LinkedAdapter
from companion.autopilot.px4_copter import Px4CopterAdapter
from companion.autopilot.px4_plane import Px4PlaneAdapter


class MakesAdapter(Protocol):
    """Makes an adapter that listens to the autopilot of one system id, or to whichever it hears first."""

    def __call__(self, system_id: int | None = None) -> LinkedAdapter:
        """Return a new adapter."""
        ...


ADAPTERS: dict[str, MakesAdapter] = {
    "arducopter": ArduCopterAdapter,
    "arduplane": ArduPlaneAdapter,
    "px4-copter": Px4CopterAdapter,
    "px4-plane": Px4PlaneAdapter,
    "ardurover": ArduRoverAdapter,
    "kinematic": KinematicAdapter,
}
"""Autopilot kinds that can be steered, by the name used in configurations and on command lines."""
