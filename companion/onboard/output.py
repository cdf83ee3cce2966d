"""Output to the autopilot: setpoints go through MAVSDK where it is configured, all other frames directly."""

from __future__ import annotations

from companion.autopilot.adapter import SetpointFrame, Velocity
from companion.autopilot.offboard import Offboard, is_setpoint
from companion.onboard.companion import Companion
from companion.onboard.flight_log import FlightLog
from companion.runtime.clock import steady_s
from companion.runtime.rate import SetpointGaps
from companion.transport.endpoints import Duplex


class AutopilotOutput:
    """Logs and sends the companion's frames, and measures the gaps between the setpoints as they are sent."""

    def __init__(self, companion: Companion, link: Duplex, log: FlightLog, offboard: Offboard | None) -> None:
        self._companion = companion
        self._link = link
        self._log = log
        self._offboard = offboard
        self._wanted: Velocity | None = None
        """Velocity that MAVSDK sends as setpoint; None: it sends none."""
        self.gaps = SetpointGaps()
        """Gaps of the whole flight; the named values take the longest since they were last sent."""
        self.decision_gaps = SetpointGaps()
        """Gaps for the table of decisions, which takes the longest since the last decision."""

    @property
    def waits_for_mavsdk(self) -> bool:
        """Whether there is a setpoint that MAVSDK cannot send yet as it is still starting."""
        return self._offboard is not None and self._wanted is not None and not self._offboard.ready

    @property
    def is_silent(self) -> bool:
        """Whether MAVSDK's stream of setpoints has a gap."""
        return self._offboard is not None and self._offboard.silent

    def send(self, frames: list[bytes], now_s: float) -> None:
        """Log and send the frames of one slot of the setpoint loop, at `now_s` by the flight's clock."""
        self._wanted = None
        steers = False
        for frame in frames:
            self._log.record(now_s, frame)
            steers = steers or is_setpoint(frame)
            if self._offboard is not None and isinstance(frame, SetpointFrame):
                self._wanted = frame.velocity
            else:
                self.transmit(frame)
        if self._offboard is not None:
            self._offboard.tick(self._companion.adapter.telemetry.system_id, self._wanted)
        if not steers:
            for gaps in (self.gaps, self.decision_gaps):
                gaps.end(steady_s())

    def transmit(self, frame: bytes) -> None:
        """Send a frame on the link, and note the gap if it is a setpoint.

        MAVSDK's setpoints come between the slots, too: none passes once the autopilot has said that it was taken over.
        """
        if not is_setpoint(frame):
            self._link.send(frame)
        elif not self._companion.authority.locked:
            self._link.send(frame)
            for gaps in (self.gaps, self.decision_gaps):
                gaps.note(steady_s())

    def send_status(self, frame: bytes) -> None:
        """Send a status frame; it is no part of a decision and is not logged."""
        self._link.send(frame)
