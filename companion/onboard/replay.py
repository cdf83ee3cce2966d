"""The on-board decisions again, from a recording: `companion replay`.

A flight's log holds what the on-board code was told, in order and with its times, and what it decided. The same code
fed with the same decides the same, to the bit; where it does not, the recording says where.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
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

_GROUND = (GROUND_SYSTEM, GROUND_COMPONENT)


@dataclass(frozen=True)
class Replayed:
    """A decision made again, and whether it is the one that was made in flight."""

    decision: Decision
    same: bool


def replay(records: Iterable[tuple[float, bytes]], config: Config) -> Iterator[Replayed]:
    """Return the decisions of a companion that is told what a flight's log says, (t_unix_s, frame) each.

    What the log holds of the broadcast was believed in flight, so it is not asked for signatures again.
    """
    companion = _told(config)
    writer = FrameWriter()
    decided_s: float | None = None
    for t_s, data in records:
        frame = raw_frame(data)
        if frame.version == 1:
            companion.receive(data, t_s)
        elif frame.message_id == oneway.MAVLINK_MSG_ID_ONEWAY_DECISION:
            decision, _ = companion.tick(t_s)
            decided_s = t_s
            again = raw_frame(writer.encode(decision_frame(decision)))
            yield Replayed(decision, again.payload == frame.payload)
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
            elif mark is Mark.GAP:
                companion.authority.note_gap(MAVSDK_SILENT)
            else:
                companion.clear(t_s)
        elif (offset_s := clock_offset_s(frame, t_s)) is not None:
            companion.note_clock(offset_s)
        elif t_s != decided_s and frame.message_id != STATUSTEXT_ID:
            # Sent between two decisions: the last one was repeated, or withdrawn.
            companion.repeat(t_s)
            decided_s = t_s


def _told(config: Config, was: State = State.WAITING) -> Companion:
    agreed = config.broadcast is None or config.broadcast.clock == "checked"
    # Whatever is in the log was in time by the settings of the flight.
    authenticator = Authenticator(Trust(max_age_s=math.inf, ahead_s=math.inf, clock_checked=agreed))
    return Companion(config, authenticator=authenticator, was=was)
