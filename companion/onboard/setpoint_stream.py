"""The frames for the autopilot: heartbeat, requests, and the stream of setpoints, which must not stop."""

from __future__ import annotations

import math

from companion.autopilot.adapter import Adapter
from companion.autopilot.stream import STREAM_GAP_S
from companion.autopilot.telemetry import HEARTBEAT_PERIOD_S
from companion.onboard.engagement import GridSetpoint


class AutopilotStream:
    """Makes the frames for one autopilot, and knows whether its stream of setpoints had a gap."""

    def __init__(self, adapter: Adapter) -> None:
        self._adapter = adapter
        self._next_heartbeat_s = -math.inf
        self._setpoint_at_s: float | None = None
        """Time of the last setpoint to an autopilot that resumes on a stream; None before the first."""

    def ended(self, now_s: float) -> bool:
        """Return whether an autopilot that wants a stream may have stopped obeying as no setpoint came for a while."""
        return (
            self._adapter.resumes_on_stream
            and self._setpoint_at_s is not None
            and now_s - self._setpoint_at_s > STREAM_GAP_S
        )

    def frames(self, requests: list[bytes], setpoint: GridSetpoint | None, hold: bool, now_s: float) -> list[bytes]:
        """Return the frames that are due now.

        Args:
            requests: Frames that request parameters or messages of the autopilot.
            setpoint: The setpoint in force, if any.
            hold: Whether to stream setpoints that hold the vehicle where no setpoint is in force.
            now_s: Time by this vehicle's clock.

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
