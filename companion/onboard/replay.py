"""Replay of a recorded flight (`companion replay`): the on-board code makes its decisions again.

A flight's log holds the inputs of the on-board code, in order and with their times, and its decisions. The same code
with the same inputs decides the same, to the bit; a replay shows every decision that differs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from companion.autopilot.offboard import MAVSDK_SILENT
from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.onboard.authority import State
from companion.onboard.companion import Companion
from companion.onboard.config import Config
from companion.onboard.decision import Decision
from companion.onboard.flight_log import STATUSTEXT_ID, Mark, clock_offset_s, decision_frame, mark_of
from companion.protocol.authenticator import Authenticator, Trust
from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM, FrameWriter
from companion.protocol.dialect import oneway
from companion.protocol.frame import raw_frame

FLIGHT_BACK_S = 1.0
"""Time by which a log's times go back where another flight begins: those of one flight only go on."""
FLIGHT_APART_S = 60.0
"""Time without any record from which another flight begins: a companion that runs logs each decision."""
_GROUND = (GROUND_SYSTEM, GROUND_COMPONENT)


@dataclass(frozen=True)
class Replayed:
    """A decision made again, and whether it is the same as the one made in flight."""

    decision: Decision
    same: bool
    behind_gap: bool
    """Whether inputs before it are missing in the log, so that it may differ."""
    begins: bool
    """Whether it is the first of another flight behind the one that the log begins with."""


def replay(
    records: Iterable[tuple[float, bytes]], config: Config, has_gap: Callable[[], bool] = lambda: False
) -> Iterator[Replayed]:
    """Yield the decisions of a new companion that is given the inputs in a flight's log.

    `records`: the log's (t_unix_s, frame). Its broadcast frames were accepted in flight and are not checked again.
    `has_gap` returns whether something is missing in the records so far; the log itself may say so, too (Mark.LOST).
    Where another flight begins in the records, a new companion decides, and all from there on is behind a gap.
    """
    companion = _told(config)
    writer = FrameWriter()
    decided_s: float | None = None
    lost = begins = False
    last_s: float | None = None
    for t_s, data in records:
        frame = raw_frame(data)
        jumps = last_s is not None and not -FLIGHT_BACK_S <= t_s - last_s <= FLIGHT_APART_S
        # Behind a long outage of the disk the same flight goes on, with its mark.
        if jumps and mark_of(frame) is not Mark.LOST:
            companion, decided_s = _told(config), None
            lost = begins = True
        last_s = t_s
        if frame.version == 1 and frame.component != COMPANION_COMPONENT:
            companion.receive(data, t_s)
        elif frame.message_id == oneway.MAVLINK_MSG_ID_ONEWAY_DECISION:
            decision, _ = companion.tick(t_s)
            decided_s = t_s
            again = raw_frame(writer.encode(decision_frame(decision)))
            yield Replayed(decision, again.payload == frame.payload, lost or has_gap(), begins)
            begins = False
        elif frame.sender == _GROUND:
            companion.hear(data, t_s)
        elif frame.component != COMPANION_COMPONENT:
            companion.receive(data, t_s)
        elif (mark := mark_of(frame)) is not None:
            if mark is Mark.RESUMED:
                companion = _told(config, State.ENGAGED)
            elif mark is Mark.LOCKED:
                companion = _told(config, State.LOCKED)
            elif mark is Mark.WITHDRAWN:
                companion.repeat(t_s)
                decided_s = t_s
            elif mark is Mark.SIGNED:
                companion.adapter.note_signed()
            elif mark is Mark.GAP:
                companion.authority.note_gap(MAVSDK_SILENT)
            elif mark is Mark.LOST:
                lost = True
            else:
                companion.clear(t_s)
        elif (offset_s := clock_offset_s(frame, t_s)) is not None:
            companion.note_clock(offset_s)
        elif t_s != decided_s and frame.message_id != STATUSTEXT_ID:
            # A frame that was sent between two decisions: the last decision was repeated, or withdrawn.
            companion.repeat(t_s)
            decided_s = t_s


def _told(config: Config, was: State = State.WAITING) -> Companion:
    agreed = config.broadcast is None or config.broadcast.clock == "checked"
    # Every broadcast frame in the log was in time by the settings of the flight, so its age is not checked again.
    authenticator = Authenticator(Trust(max_age_s=math.inf, ahead_s=math.inf, clock_checked=agreed))
    return Companion(config, authenticator=authenticator, was=was)
