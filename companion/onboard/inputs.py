"""Input from the vehicle's links: frames are sorted by their sender and handed to the companion and its logs."""

from __future__ import annotations

from companion.autopilot.offboard import Offboard
from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.onboard.flight_log import FlightLog
from companion.onboard.recording import RecordedCompanion
from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM
from companion.protocol.dialect import oneway
from companion.protocol.frame import RawFrame, raw_frames
from companion.protocol.v2_extension import unwrap
from companion.transport.endpoints import OnDatagram

ONEWAY_IDS = frozenset(oneway.mavlink_map) - {oneway.MAVLINK_MSG_ID_HEARTBEAT}
"""Message ids of the project's dialect; HEARTBEAT, which it includes, is not among them."""


class BroadcastInput:
    """Receives from the broadcast link, and logs every frame, accepted or not."""

    def __init__(self, flight: RecordedCompanion, log: FlightLog, is_stream: bool) -> None:
        """Receive for a flight; `is_stream`: the link delivers a stream of bytes (a serial port), not datagrams."""
        self._flight = flight
        self._log = log
        self._is_stream = is_stream

    def receive(self, datagram: bytes) -> None:
        """Take in bytes from the link."""
        if not self._is_stream:
            self._log.record(self._flight.clock.now_s(), datagram)
            self._flight.hear(datagram)
            return
        frames = list(self._flight.companion.authenticator.deframed(datagram))
        for frame in frames:
            self._log.record_frame(self._flight.clock.now_s(), frame)
        self._flight.hear_frames(frames)


class AutopilotInput:
    """Receives from the autopilot's link, which may also carry frames of a ground station or this companion's own.

    Such frames are dropped: a replay would take them in the log for the broadcast and for the companion's own records.
    """

    def __init__(self, flight: RecordedCompanion, broadcast: OnDatagram | None, offboard: Offboard | None) -> None:
        """Receive for a flight; `broadcast`, if given, takes the broadcast frames that come wrapped in V2_EXTENSION."""
        self._flight = flight
        self._broadcast = broadcast
        self._offboard = offboard

    def receive(self, datagram: bytes) -> None:
        """Take in bytes from the link."""
        frames = [frame for frame in raw_frames(datagram) if not self._is_others(frame)]
        if not frames:
            return
        self._flight.receive(frames)
        if self._offboard is not None:
            self._offboard.receive(b"".join(frame.data for frame in frames))

    def _is_others(self, frame: RawFrame) -> bool:
        """Return whether a frame is not the autopilot's; pass it on if it wraps a frame of the broadcast."""
        if self._broadcast is not None and (inner := unwrap(frame)) is not None:
            self._broadcast(inner)
            return True
        if frame.version == 1:
            return False
        ours = frame.component == COMPANION_COMPONENT or frame.message_id in ONEWAY_IDS
        return ours or frame.sender == (GROUND_SYSTEM, GROUND_COMPONENT)
