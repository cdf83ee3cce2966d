"""One small module per autopilot kind behind one protocol: telemetry in, setpoint out, what the vehicle can do."""

from __future__ import annotations

from typing import Protocol

from companion.adapters.arducopter import ArduCopterAdapter
from companion.adapters.arduplane import ArduPlaneAdapter
from companion.adapters.ardurover import ArduRoverAdapter
from companion.adapters.kinematic import KinematicAdapter
from companion.adapters.link import LinkedAdapter
from companion.adapters.px4_copter import Px4CopterAdapter
from companion.adapters.px4_plane import Px4PlaneAdapter


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
