"""The companion with its flight log: all that it is told stands in the log with the time it was told at.

So `companion replay` can tell another companion the same. The shell tells the companion nothing but through this.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from companion.autopilot.offboard import MAVSDK_SILENT
from companion.onboard.authority import State
from companion.onboard.companion import Companion
from companion.onboard.decision import Decision
from companion.onboard.flight_log import FlightLog, Mark, clock_frame, decision_frame, mark_frame
from companion.protocol.codec import FrameWriter
from companion.protocol.frame import RawFrame
from companion.runtime.clock import SteadyClock

BEGINNINGS = {State.ENGAGED: Mark.RESUMED, State.LOCKED: Mark.LOCKED}
"""What a log begins with after a companion that left the vehicle so."""


class RecordedCompanion:
    """A companion that flies, the clock it flies by, and the log of what it was told, decided and wanted sent."""

    def __init__(self, companion: Companion, clock: SteadyClock, log: FlightLog) -> None:
        self.companion = companion
        self.clock = clock
        self._log = log
        self._decision_writer = FrameWriter()

    def begin(self, authority_before: State) -> None:
        """Log who had the vehicle when the companion before this one ended."""
        if authority_before in BEGINNINGS:
            self._mark(BEGINNINGS[authority_before], self.clock.now_s())

    def hear(self, datagram: bytes) -> None:
        """Take in bytes from the broadcast link; what of them is believed is logged."""
        self._believe(lambda now_s: self.companion.hear(datagram, now_s))

    def hear_frames(self, frames: Sequence[RawFrame]) -> None:
        """Take in frames of the broadcast link that the authenticator has deframed; what is believed is logged."""
        self._believe(lambda now_s: self.companion.hear_frames(frames, now_s))

    def hear_waiting(self) -> None:
        """Take in what waited for the check of its signature in a flood."""
        self._believe(self.companion.hear_waiting)

    def receive(self, frames: Sequence[RawFrame]) -> None:
        """Take in frames of the autopilot's."""
        now_s = self.clock.now_s()
        for frame in frames:
            self.companion.receive(frame.data, now_s)
        for frame in frames:
            self._log.record_frame(now_s, frame)

    def note_clock(self, now_s: float) -> None:
        """Tell how far the computer's clock is from the one that times are told by."""
        offset_s = time.time() - now_s
        if self.companion.note_clock(offset_s):
            self._log.record(now_s, clock_frame(self._system_id, now_s, offset_s))

    def note_stream_gap(self) -> bool:
        """Tell that MAVSDK's stream had a gap; return whether it may begin again, as it may while a person flies."""
        authority = self.companion.authority
        may_go_on = not authority.locked
        authority.note_gap(MAVSDK_SILENT)
        if may_go_on and authority.locked:
            self._mark(Mark.GAP, self.clock.now_s())
        return not authority.locked

    def clear(self) -> None:
        """Let a vehicle that was taken over be handed over again."""
        now_s = self.clock.now_s()
        self.companion.clear(now_s)
        self._mark(Mark.CLEARED, now_s)

    def decide(self, now_s: float) -> tuple[Decision, list[bytes]]:
        """Decide for the next guidance step; return the decision and the frames for the autopilot."""
        decision, frames = self.companion.tick(now_s)
        self._log.record(now_s, self._decision_writer.encode(decision_frame(decision)))
        return decision, frames

    def repeat(self, now_s: float) -> list[bytes]:
        """Return the frames that keep the last decision standing between guidance steps."""
        steered = self.companion.steers
        frames = self.companion.repeat(now_s)
        if steered and not self.companion.steers:
            self._mark(Mark.WITHDRAWN, now_s)
        return frames

    def _believe(self, take: Callable[[float], list[RawFrame]]) -> None:
        now_s = self.clock.now_s()
        for frame in take(now_s):
            self._log.record_frame(now_s, frame)

    def _mark(self, mark: Mark, now_s: float) -> None:
        self._log.record(now_s, mark_frame(mark, self._system_id))

    @property
    def _system_id(self) -> int:
        return self.companion.adapter.telemetry.system_id or 1
