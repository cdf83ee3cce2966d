"""Which adapter steers which kind of autopilot: one small module per kind, behind one protocol."""

from __future__ import annotations

from typing import Protocol

from companion.autopilot import kinds
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
    kinds.ARDUCOPTER.name: ArduCopterAdapter,
    kinds.ARDUPLANE.name: ArduPlaneAdapter,
    kinds.PX4_COPTER.name: Px4CopterAdapter,
    kinds.PX4_PLANE.name: Px4PlaneAdapter,
    kinds.ARDUROVER.name: ArduRoverAdapter,
    kinds.KINEMATIC.name: KinematicAdapter,
}
"""The adapter of each kind, by the kind's name."""
