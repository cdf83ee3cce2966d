"""Flight logs: every frame heard, accepted and sent, and every decision, as tlogs that any MAVLink tool opens.

`vehicle-<id>.tlog` holds, in order, all inputs of the on-board code and its decisions, so that `companion replay` can
make the decisions again. Nothing in it can be used against the fleet: MAVLink signatures are cut off, those of frames
in other frames too, and frames that carry a key are left out.
"""

from __future__ import annotations

import itertools
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum, unique
from pathlib import Path

from pymavlink.dialects.v20 import common

from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.files.records import STAMP
from companion.files.tlog import TlogWriter
from companion.onboard.decision import Certificate, Decision, Purpose
from companion.onboard.failsafe import CLOCK_DIGITS, Stage
from companion.protocol.frame import RawFrame, raw_frames
from companion.protocol.log_secrets import without_secrets
from companion.protocol.messages import DecisionFlag, DecisionFrame
from companion.runtime.console import program_logger

STATUSTEXT_ID = common.MAVLINK_MSG_ID_STATUSTEXT
STATUSTEXT_CHARACTERS = 50
MOST_TEXT_ID = 65_535
"""Greatest id of a STATUSTEXT."""
FLUSH_PERIOD_S = 1.0
"""Time between two flushes of a log, and so the most of it that is lost if the machine dies."""
LOG_BURST_S = 10.0
"""Burst of a log with a limited rate: after a pause it takes at once the bytes that the limit allows in this time."""
GOES_ON = {"companion": "flying", "groundstation": "broadcasting"}
"""What a program goes on with where it cannot log."""
_MICROSECONDS = 1e6
_CERTIFIED = {
    Certificate.NONE: "not certified",
    Certificate.UNTIL: "certified for a time only",
    Certificate.FOR_EVER: "certified for ever",
}
"""The certificates as a summary line tells them: without the seconds, so that the line changes only with the kind."""


@unique
class Mark(IntEnum):
    """Events that a log records beside frames and decisions, each as a MAV_CMD that is written but never sent."""

    CLEARED = common.MAV_CMD_USER_1
    """The safety pilot cleared a take-over: Companion.clear() was called."""
    RESUMED = common.MAV_CMD_USER_2
    """First in a log: the companion that ran before was in control of the vehicle (State.ENGAGED)."""
    WITHDRAWN = common.MAV_CMD_USER_4
    """Between two decisions Companion.repeat() withdrew the setpoint, and may have sent nothing."""
    LOCKED = common.MAV_CMD_USER_5
    """First in a log: the companion that ran before was locked by a take-over that was not cleared (State.LOCKED)."""
    LOST = common.MAV_CMD_WAYPOINT_USER_1
    """Records are missing before this one: the disk took none for a while."""
    SIGNED = common.MAV_CMD_WAYPOINT_USER_2
    """The autopilot was first seen to sign its frames, whose signatures the log leaves out."""
    GAP = common.MAV_CMD_USER_3
    """MAVSDK's stream of setpoints had a gap: Authority.note_gap() was called."""


@dataclass
class _Outage:
    """A time in which the disk takes nothing."""

    since_s: float
    missing: int = 0
    """Number of records that are not in the log."""


class FlightLog:
    """A tlog that goes on after an error of the disk, with a mark where records are missing; nothing waits for it."""

    def __init__(
        self, writer: TlogWriter | None, program: str | None = "companion", most_bytes_per_s: float = math.inf
    ) -> None:
        """Log with a writer, or log nothing if that is None; `program` is the one that tells of errors, None: nobody.

        Frames that come faster than `most_bytes_per_s` are left out and counted: a flood on a link must not fill the
        disk.
        """
        self._writer = writer
        self._program = program
        self._most_bytes_per_s = most_bytes_per_s
        self._allowance_bytes = most_bytes_per_s * LOG_BURST_S
        self._last_s: float | None = None
        self._flush_due_s = -math.inf
        self._told = 0
        self._outage: _Outage | None = None
        self.left_out = 0

    def record(self, t_unix_s: float, datagram: bytes) -> None:
        """Log the frames of a datagram; other bytes cannot be stored in a tlog and are left out."""
        for frame in () if self._writer is None else raw_frames(datagram):
            self.record_frame(t_unix_s, frame)

    def record_frame(self, t_unix_s: float, frame: RawFrame) -> None:
        """Log a frame without its MAVLink signature; leave it out if it carries a key."""
        harmless = None if self._writer is None else without_secrets(frame)
        if harmless is not None:
            self._write(t_unix_s, harmless)

    def close(self) -> None:
        """Write out buffered records, and close the log unless its writer's sink is the caller's to close."""
        if self._writer is not None:
            try:
                self._writer.close()
            except OSError as error:
                self._lose(0.0 if self._last_s is None else self._last_s, error)

    def tell(self, t_unix_s: float, text: str) -> None:
        """Log a line of text as STATUSTEXT, the MAVLink message that ground-control programs show."""
        self._told = self._told % MOST_TEXT_ID + 1
        for frame in text_frames(text, self._told):
            self._write(t_unix_s, frame)

    def _write(self, t_unix_s: float, frame: bytes) -> None:
        if self._writer is None or not self._allowed(t_unix_s, len(frame)):
            return
        try:
            if self._outage is not None:
                self._writer.write(t_unix_s, mark_frame(Mark.LOST, 1))
                self._say_again(t_unix_s, self._outage)
                self._outage = None
            self._writer.write(t_unix_s, frame)
            if t_unix_s >= self._flush_due_s:
                self._writer.flush()
                self._flush_due_s = t_unix_s + FLUSH_PERIOD_S
        except OSError as error:
            self._lose(t_unix_s, error)

    def _allowed(self, t_unix_s: float, count: int) -> bool:
        if math.isinf(self._most_bytes_per_s):
            return True
        passed_s = 0.0 if self._last_s is None else max(0.0, t_unix_s - self._last_s)
        self._last_s = t_unix_s
        most_bytes = self._most_bytes_per_s * LOG_BURST_S
        self._allowance_bytes = min(most_bytes, self._allowance_bytes + passed_s * self._most_bytes_per_s)
        if count > self._allowance_bytes:
            self.left_out += 1
            return False
        self._allowance_bytes -= count
        return True

    def _lose(self, t_unix_s: float, error: OSError) -> None:
        if self._outage is None:
            self._outage = _Outage(t_unix_s)
            if self._program is not None:
                words = f"no logs: {error.strerror}; {GOES_ON.get(self._program, 'going on')} without them"
                program_logger(self._program).warning("%s", words)
        self._outage.missing += 1

    def _say_again(self, t_unix_s: float, outage: _Outage) -> None:
        if self._program is not None:
            passed_s = max(0.0, t_unix_s - outage.since_s)
            words = f"logging again after {passed_s:.0f} s; at least {outage.missing} records are missing"
            program_logger(self._program).info("%s", words)


def unused(path: Path) -> Path:
    """Return the path, with -2, -3 and so on before its suffix if it is taken: no run overwrites another's log."""
    if not path.exists():
        return path
    numbered = (path.with_name(f"{path.stem}-{number}{path.suffix}") for number in itertools.count(2))
    return next(one for one in numbered if not one.exists())


def text_frames(text: str, identity: int) -> Iterator[bytes]:
    """Yield a line of text as STATUSTEXT frames of a companion; `identity` (1 to MOST_TEXT_ID) joins its chunks."""
    teller = common.MAVLink(None, srcSystem=1, srcComponent=COMPANION_COMPONENT)
    for number, start in enumerate(range(0, len(text), STATUSTEXT_CHARACTERS)):
        part = text[start : start + STATUSTEXT_CHARACTERS].encode(errors="replace")
        message = common.MAVLink_statustext_message(common.MAV_SEVERITY_INFO, part, identity, number)
        yield bytes(message.pack(teller))


def decision_frame(decision: Decision) -> DecisionFrame:
    """Return the ONEWAY_DECISION frame that stands in a log for a decision."""
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
    told = (decision.gave_way, decision.note, decision.reckons, *decision.triggers)
    words = (decision.reason, *decision.guard_changes, *decision.broken, *told)
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
        certified_s=decision.certified_s,
        words_crc=zlib.crc32("; ".join(str(word) for word in words).encode()),
    )


def mark_frame(mark: Mark, system_id: int) -> bytes:
    """Return the COMMAND_LONG frame that stands in a log for a mark."""
    teller = common.MAVLink(None, srcSystem=system_id, srcComponent=COMPANION_COMPONENT)
    order = (system_id, COMPANION_COMPONENT, mark, 0, *[0.0] * 7)
    return bytes(common.MAVLink_command_long_message(*order).pack(teller))


def gap_before(records: bytes) -> bytes:
    """Return the record that stands before the first records of a log's file if those before them are gone."""
    return records[: STAMP.size] + mark_frame(Mark.LOST, 1)


def mark_of(frame: RawFrame) -> Mark | None:
    """Return the mark that a MAVLink 2 frame of the companion stands for; None if it is no mark."""
    if frame.message_id != common.MAVLINK_MSG_ID_COMMAND_LONG:
        return None
    message = _parsed(frame)
    if message is None or message.target_component != COMPANION_COMPONENT or message.command not in list(Mark):
        return None
    return Mark(message.command)


def clock_frame(system_id: int, t_unix_s: float, offset_s: float) -> bytes:
    """Return the SYSTEM_TIME frame that stands in a log for a changed clock offset (Companion.note_clock())."""
    teller = common.MAVLink(None, srcSystem=system_id, srcComponent=COMPANION_COMPONENT)
    wall_us = round(t_unix_s * _MICROSECONDS) + round(round(offset_s, CLOCK_DIGITS) * _MICROSECONDS)
    return bytes(common.MAVLink_system_time_message(max(0, wall_us), 0).pack(teller))


def clock_offset_s(frame: RawFrame, t_unix_s: float) -> float | None:
    """Return the clock offset in a MAVLink 2 frame of the companion; None if it is no `clock_frame`."""
    if frame.message_id != common.MAVLINK_MSG_ID_SYSTEM_TIME:
        return None
    message = _parsed(frame)
    return None if message is None else (message.time_unix_usec - round(t_unix_s * _MICROSECONDS)) / _MICROSECONDS


def _parsed(frame: RawFrame) -> common.MAVLink_message | None:
    """Return the message in a frame of a log, None if it is damaged."""
    try:
        (message,) = common.MAVLink(None).parse_buffer(bytearray(frame.data)) or (None,)
    except common.MAVError:
        return None
    return message


def summary_line(decision: Decision) -> str:
    """Return a decision as one line of text: purpose, reason, state of the picture, and what changed the setpoint."""
    target = f" {decision.target_id}" if decision.target_id is not None else ""
    changes = f", guard: {', '.join(decision.guard_changes)}" if decision.guard_changes else ""
    changes += "".join(f", {said}" for said in (decision.note, decision.reckons, decision.gave_way) if said is not None)
    changes += f", broken: {', '.join(decision.broken)}" if decision.broken else ""
    trusted = "picture none" if decision.picture_age_s is None else "picture fresh"
    if decision.picture_age_s is not None and decision.stage is not Stage.FRESH:
        trusted = f"{decision.stage.value}: {', '.join(decision.triggers)}"
    certified = "" if decision.purpose is Purpose.IDLE else f", {_CERTIFIED[decision.certificate]}"
    return f"{decision.purpose.value}{target} ({decision.reason}), {trusted}{certified}{changes}"
