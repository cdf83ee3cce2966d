"""What arrives on the vehicle's links, sorted by whose it is, and handed to the companion and its logs."""

from __future__ import annotations

from companion.autopilot.offboard import Offboard
from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.onboard.flight_log import FlightLog
from companion.onboard.recording import RecordedCompanion
from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM
from companion.protocol.dialect import oneway
from companion.protocol.frame import RawFrame, raw_frames
from companion.protocol.v2_extension import unwrap

ONEWAY_IDS = frozenset(oneway.mavlink_map) - {oneway.MAVLINK_MSG_ID_HEARTBEAT}
"""Messages of our own dialect."""


class BroadcastInput:
    """Hears the broadcast link, and logs all of it, believed or not."""

    def __init__(self, flight: RecordedCompanion, log: FlightLog, is_stream: bool) -> None:
        """Hear for a flight; `is_stream` of a link that hands over bytes, such as a serial port's, not datagrams."""
        self._flight = flight
        self._log = log
        self._is_stream = is_stream

    def receive(self, datagram: bytes) -> None:
        """Take in what the link hands over."""
        if not self._is_stream:
            self._log.record(self._flight.clock.now_s(), datagram)
            self._flight.hear(datagram)
            return
        frames = list(self._flight.companion.authenticator.deframed(datagram))
        for frame in frames:
            self._log.record_frame(self._flight.clock.now_s(), frame)
        self._flight.hear_frames(frames)


class AutopilotInput:
    """Hears the autopilot's link, on which others may speak too: a ground station, this companion's own echo.

    What the log keeps for the ground station's and for our own must not come from this link, or a replay would believe
    it.
    """

    def __init__(self, flight: RecordedCompanion, broadcast: BroadcastInput | None, offboard: Offboard | None) -> None:
        """Hear for a flight; `broadcast` takes what one radio carries for both, inside V2_EXTENSION."""
        self._flight = flight
        self._broadcast = broadcast
        self._offboard = offboard

    def receive(self, datagram: bytes) -> None:
        """Take in what the link hands over."""
        frames = [frame for frame in raw_frames(datagram) if not self._is_others(frame)]
        if not frames:
            return
        self._flight.receive(frames)
        if self._offboard is not None:
            self._offboard.receive(b"".join(frame.data for frame in frames))

    def _is_others(self, frame: RawFrame) -> bool:
        """Return whether a frame is none of the autopilot's; hear it if it is the broadcast's."""
        if self._broadcast is not None and (inner := unwrap(frame)) is not None:
            self._broadcast.receive(inner)
            return True
        if frame.version == 1:
            return False
        ours = frame.component == COMPANION_COMPONENT or frame.message_id in ONEWAY_IDS
        return ours or frame.sender == (GROUND_SYSTEM, GROUND_COMPONENT)
