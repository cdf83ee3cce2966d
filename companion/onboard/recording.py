"""The companion with its flight log: every input of the companion is logged with the time that it was given at.

So `companion replay` can give the same inputs to another companion. The shell reaches the companion's inputs only
through this module.
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
"""The mark that a log begins with, by the state that the companion before left; none after State.WAITING."""


class RecordedCompanion:
    """A companion in flight, its clock, and the log of its inputs and decisions."""

    def __init__(self, companion: Companion, clock: SteadyClock, log: FlightLog) -> None:
        self.companion = companion
        self.clock = clock
        self._log = log
        self._decision_writer = FrameWriter()

    def begin(self, authority_before: State) -> None:
        """Log who controlled the vehicle when the companion before this one ended."""
        if authority_before in BEGINNINGS:
            self._mark(BEGINNINGS[authority_before], self.clock.now_s())

    def hear(self, datagram: bytes) -> None:
        """Take in bytes from the broadcast link, and log the accepted frames."""
        self._believe(lambda now_s: self.companion.hear(datagram, now_s))

    def hear_frames(self, frames: Sequence[RawFrame]) -> None:
        """Take in frames of the broadcast link that the authenticator has deframed, and log the accepted ones."""
        self._believe(lambda now_s: self.companion.hear_frames(frames, now_s))

    def hear_waiting(self) -> float:
        """Take in frames that waited in a flood for the check of their signature, and log the accepted ones.

        Return after how many seconds more of them are due: 0 at once, inf if none waits.
        """
        self._believe(self.companion.hear_waiting)
        return max(0.0, self.companion.authenticator.due_s() - self.clock.now_s())

    def receive(self, frames: Sequence[RawFrame]) -> int:
        """Take in frames from the autopilot, and log them; return how many were its own, and newer than before."""
        now_s = self.clock.now_s()
        believed = sum(self.companion.receive(frame.data, now_s) for frame in frames)
        for frame in frames:
            self._log.record_frame(now_s, frame)
        return believed

    def note_signed(self) -> None:
        """Pass on that the autopilot signs its frames, and log it the first time: the log has no signatures."""
        if self.companion.adapter.note_signed():
            self._mark(Mark.SIGNED, self.clock.now_s())

    def note_clock(self, now_s: float) -> None:
        """Pass on the offset of the computer's system clock from the flight's clock, and log it if it changed."""
        offset_s = time.time() - now_s
        if self.companion.note_clock(offset_s):
            self._log.record(now_s, clock_frame(self._system_id, now_s, offset_s))

    def note_stream_gap(self) -> bool:
        """Pass on that MAVSDK's stream had a gap; log it if that locks the companion. Return whether it may resume."""
        authority = self.companion.authority
        may_go_on = not authority.locked
        authority.note_gap(MAVSDK_SILENT)
        if may_go_on and authority.locked:
            self._mark(Mark.GAP, self.clock.now_s())
        return not authority.locked

    def clear(self) -> None:
        """Clear a take-over, and log that: the vehicle may be handed over again."""
        now_s = self.clock.now_s()
        self.companion.clear(now_s)
        self._mark(Mark.CLEARED, now_s)

    def decide(self, now_s: float) -> tuple[Decision, list[bytes]]:
        """Decide for the next guidance step, and log that; return the decision and the frames for the autopilot."""
        decision, frames = self.companion.tick(now_s)
        self._log.record(now_s, self._decision_writer.encode(decision_frame(decision)))
        return decision, frames

    def repeat(self, now_s: float) -> list[bytes]:
        """Return the frames that repeat the last setpoint between guidance steps; log if it was withdrawn."""
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
