"""The registry of adapters: the adapter class of each autopilot kind."""

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
    """A function or class that makes an adapter for one autopilot."""

    def __call__(self, system_id: int | None = None) -> LinkedAdapter:
        """Return a new adapter for the autopilot with this system id; None takes the one that is heard first."""
        ...


ADAPTERS: dict[str, MakesAdapter] = {
    kinds.ARDUCOPTER.name: ArduCopterAdapter,
    kinds.ARDUPLANE.name: ArduPlaneAdapter,
    kinds.PX4_COPTER.name: Px4CopterAdapter,
    kinds.PX4_PLANE.name: Px4PlaneAdapter,
    kinds.ARDUROVER.name: ArduRoverAdapter,
    kinds.KINEMATIC.name: KinematicAdapter,
}
"""The adapter class of each kind, by the kind's name."""
