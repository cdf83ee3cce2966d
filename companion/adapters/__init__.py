"""One small module per autopilot kind behind one protocol: telemetry in, setpoint out, what the vehicle can do."""

from __future__ import annotations

from collections.abc import Callable

from companion.adapters.base import Adapter
from companion.adapters.velocity import VelocityAdapter

ADAPTERS: dict[str, Callable[[], Adapter]] = {
    "arducopter": lambda: VelocityAdapter("arducopter", can_stop=True),
    "kinematic": lambda: VelocityAdapter("kinematic", can_stop=False),
}
"""Autopilot kinds that can be steered, by the name used in configurations and on command lines."""
