"""What goes to the autopilot: the heartbeat, and the setpoints that must not stop."""

from __future__ import annotations

import math

from companion.autopilot.adapter import Adapter
from companion.autopilot.stream import STREAM_GAP_S
from companion.autopilot.telemetry import HEARTBEAT_PERIOD_S
from companion.onboard.engagement import GridSetpoint


class AutopilotStream:
    """Puts together what is sent to one autopilot, and knows whether it has missed setpoints."""

    def __init__(self, adapter: Adapter) -> None:
        self._adapter = adapter
        self._next_heartbeat_s = -math.inf
        self._setpoint_at_s: float | None = None
        """When a stream of setpoints last had one."""

    def ended(self, now_s: float) -> bool:
        """Return whether the autopilot may have stopped obeying because setpoints did not come for a while."""
        return (
            self._adapter.resumes_on_stream
            and self._setpoint_at_s is not None
            and now_s - self._setpoint_at_s > STREAM_GAP_S
        )

    def frames(self, requests: list[bytes], setpoint: GridSetpoint | None, hold: bool, now_s: float) -> list[bytes]:
        """Return the frames that are due now.

        Args:
            requests: What is asked of the autopilot, as frames.
            setpoint: The setpoint that stands.
            hold: Whether to ask the autopilot to stay as it is where no setpoint stands.
            now_s: This vehicle's clock.

        """
        datagrams = []
        if now_s >= self._next_heartbeat_s:
            datagrams.append(self._adapter.heartbeat())
            self._next_heartbeat_s = now_s + HEARTBEAT_PERIOD_S
        datagrams += requests
        stream: list[bytes] = []
        if setpoint is not None:
            stream = self._adapter.encode(setpoint.setpoint, setpoint.convergence_rad, now_s)
        elif hold:
            stream = self._adapter.hold(now_s)
        if stream and self._adapter.resumes_on_stream:
            self._setpoint_at_s = now_s
        return datagrams + stream
