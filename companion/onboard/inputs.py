"""Input from the vehicle's links: frames are sorted by their sender and handed to the companion and its logs."""

from __future__ import annotations

from collections.abc import Mapping

from companion.autopilot.identity import AUTOPILOT_COMPONENT
from companion.autopilot.intake import Intake
from companion.autopilot.offboard import Offboard
from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.onboard.flight_log import FlightLog
from companion.onboard.peer import Peer
from companion.onboard.recording import RecordedCompanion
from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM
from companion.protocol.dialect import oneway
from companion.protocol.frame import RawFrame
from companion.protocol.mavlink_signing import without_signature
from companion.protocol.v2_extension import unwrap
from companion.transport.endpoints import Address, OnDatagram

ONEWAY_IDS = frozenset(oneway.mavlink_map) - {oneway.MAVLINK_MSG_ID_HEARTBEAT}
"""Message ids of the project's dialect; HEARTBEAT, which it includes, is not among them."""
STRANGER = "from another address"
"""Reason for a frame in the autopilot's name from an address that is not known to be the autopilot's."""


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
        self.peer = Peer()
        self._flight = flight
        self._broadcast = broadcast
        self._offboard = offboard
        self._intake = Intake()

    @property
    def skipped(self) -> Mapping[str, int]:
        """The number of frames, and of runs of bytes that are none, that were left out, by reason."""
        return self._intake.skipped

    def receive(self, chunk: bytes, address: Address | None = None) -> None:
        """Take in bytes from the link, cut anywhere; `address` is the sender's, where the link has several."""
        frames = [
            frame
            for frame in self._intake.feed(chunk, address)
            if not self._is_others(frame) and not self._is_strangers(frame, address)
        ]
        if not frames:
            return
        signed, frames = any(map(self._is_signed, frames)), [without_signature(frame) for frame in frames]
        believed = self._flight.receive(frames)
        if signed:
            self._flight.note_signed()
        if address is not None:
            if believed:
                self.peer.note_believed(address, believed, self._flight.clock.now_s())
            elif any(frame.component == AUTOPILOT_COMPONENT for frame in frames):
                self.peer.note_speaker(address)
        if self._offboard is not None:
            self._offboard.receive(b"".join(frame.data for frame in frames))

    def _is_others(self, frame: RawFrame) -> bool:
        """Return whether a frame is not the autopilot's; pass it on if it wraps a frame of the broadcast."""
        if self._broadcast is not None and (inner := unwrap(frame)) is not None:
            self._broadcast(inner)
            return True
        if frame.component == COMPANION_COMPONENT:
            return True
        return frame.version == 2 and (
            frame.message_id in ONEWAY_IDS or frame.sender == (GROUND_SYSTEM, GROUND_COMPONENT)
        )

    def _is_signed(self, frame: RawFrame) -> bool:
        """Return whether a frame is the autopilot's and has a MAVLink signature."""
        system_id = self._flight.companion.adapter.telemetry.system_id
        return frame.is_signed and frame.sender == (system_id, AUTOPILOT_COMPONENT)

    def _is_strangers(self, frame: RawFrame, address: Address | None) -> bool:
        """Return whether a frame in flight is in the autopilot's name, but from an address that is not its own."""
        telemetry = self._flight.companion.adapter.telemetry
        if address is None or not telemetry.armed:
            # Before the flight a second autopilot with the same id must be found, wherever it is.
            return False
        is_stranger = self.peer.is_stranger(address, frame, telemetry.system_id, self._flight.clock.now_s())
        self._intake.skipped[STRANGER] += is_stranger
        return is_stranger
