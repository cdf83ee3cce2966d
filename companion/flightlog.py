"""What a flight leaves behind: every frame heard, sent and believed, and every decision, as tlogs that any tool opens.

`vehicle-<id>.tlog` holds, in order, all that the on-board code was told and what it decided, so that `companion replay`
can decide it all again. Nothing in it can be used against the fleet: MAVLink signatures are cut off, and frames that
carry a key are left out.
"""

from __future__ import annotations

import math
import zlib

import click

from companion.core import Decision, Purpose
from companion.frames import DecisionFlag, DecisionFrame
from companion.framing import header_of
from companion.signing import strip_signature
from companion.staleness import Stage
from companion.tlog import TlogWriter, whole_frames

SETUP_SIGNING_ID = 256
"""The MAVLink message that carries a secret key."""
_MARKER_V2 = 0xFD
_MICROSECONDS = 1e6


class FlightLog:
    """A tlog that gives up, with a word, rather than disturb a flight: a full disk is no reason to stop steering."""

    def __init__(self, writer: TlogWriter | None, program: str = "companion") -> None:
        """Log with a writer, or nothing; `program` is who says that it gave up."""
        self._writer = writer
        self._program = program

    def record(self, t_unix_s: float, datagram: bytes) -> None:
        """Log the frames of a datagram; what is not a frame has no place in a tlog."""
        for frame in () if self._writer is None else whole_frames(datagram):
            harmless = without_secrets(frame)
            if harmless is not None:
                self._write(t_unix_s, harmless)

    def close(self) -> None:
        """Write out what is buffered."""
        if self._writer is not None:
            try:
                self._writer.close()
            except OSError as error:
                self._give_up(error)

    def _write(self, t_unix_s: float, frame: bytes) -> None:
        if self._writer is not None:
            try:
                self._writer.write(t_unix_s, frame)
            except OSError as error:
                self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        self._writer = None
        click.echo(f"{self._program}: warning: no longer logging: {error.strerror}", err=True)


def without_secrets(frame: bytes) -> bytes | None:
    """Return a whole frame as it may be kept: without MAVLink's signature; None for one that carries a key."""
    if frame[0] != _MARKER_V2:
        return frame
    return None if header_of(frame).message_id == SETUP_SIGNING_ID else strip_signature(frame)


def decision_frame(decision: Decision) -> DecisionFrame:
    """Return a decision as it is logged."""
    setpoint = decision.setpoint
    facts = {
        DecisionFlag.TURN_LIMITED: decision.turn_limited,
        DecisionFlag.GUARD_CHANGED: bool(decision.guard_changes),
        DecisionFlag.UNCERTIFIED: decision.uncertified,
        DecisionFlag.BROKEN: bool(decision.broken),
        DecisionFlag.GAVE_WAY: decision.gave_way is not None,
        DecisionFlag.STAY: decision.stay is not None,
        DecisionFlag.OPPOSED: decision.opposed,
    }
    words = (decision.reason, *decision.guard_changes, *decision.broken, decision.gave_way, decision.note)
    return DecisionFrame(
        time_us=round(decision.t_s * _MICROSECONDS),
        purpose=list(Purpose).index(decision.purpose),
        stage=list(Stage).index(decision.stage),
        target_id=decision.target_id,
        flags=DecisionFlag(sum(flag for flag, holds in facts.items() if holds)),
        picture_age_s=math.nan if decision.picture_age_s is None else decision.picture_age_s,
        wanted_heading_rad=decision.wanted_heading_rad,
        heading_rad=math.nan if setpoint is None else setpoint.heading_rad,
        speed_m_s=math.nan if setpoint is None else setpoint.speed_m_s,
        altitude_m=math.nan if setpoint is None else setpoint.altitude_m,
        words_crc=zlib.crc32("; ".join(str(word) for word in words).encode()),
    )


def line_of(decision: Decision) -> str:
    """Return a decision in a line: what, why, on which picture, and what changed it."""
    target = f" {decision.target_id}" if decision.target_id is not None else ""
    changes = f", guard: {', '.join(decision.guard_changes)}" if decision.guard_changes else ""
    changes += "".join(f", {said}" for said in (decision.note, decision.gave_way) if said is not None)
    changes += f", broken: {', '.join(decision.broken)}" if decision.broken else ""
    picture = "none" if decision.picture_age_s is None else decision.stage.value
    return f"{decision.purpose.value}{target} ({decision.reason}), picture {picture}{changes}"
