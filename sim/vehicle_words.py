"""What a vehicle of a recorded flight knew, and when: read from its log, as its companion itself merged the broadcast.

The log holds the broadcast's frames that were believed, each decision, and what was said of it. They are merged by the
companion's own world model, so that "3 of 5 threats heard" is what it knew, not what was sent.
"""

from __future__ import annotations

import math
import struct
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from companion.files.tlog import read_tlog
from companion.onboard.decision import Purpose, certificate_in_words
from companion.onboard.failsafe import Stage
from companion.onboard.flight_log import STATUSTEXT_CHARACTERS, STATUSTEXT_ID
from companion.onboard.world_model import WorldModel
from companion.protocol.codec import decode_frame
from companion.protocol.dialect import oneway
from companion.protocol.frame import BROADCAST_IDS, RawFrame, raw_frame
from companion.protocol.messages import DecisionFrame, WireError

_CHUNK = struct.Struct("<HB")
"""Id and number of a chunk, which follow the text of a STATUSTEXT."""
STEP_S = 0.9
"""Least time between two decisions that are kept: pictures of a playback are a second apart."""


class Knowledge(NamedTuple):
    """What a vehicle knew, and did, at a time."""

    at_s: float
    """Unix time."""
    picture_s: float | None
    """Unix time of its newest picture; None: it had heard nothing."""
    missing: str | None
    """What it still waited for, such as "3 of 5 threats heard"; None: nothing."""
    target_id: int | None
    purpose: str
    stage: str
    certificate: str
    words: str
    """What its companion said of it."""


@dataclass(frozen=True)
class VehicleWords:
    """What one vehicle knew in the course of a flight."""

    known: tuple[Knowledge, ...]
    times_s: tuple[float, ...]

    def at(self, at_s: float) -> Knowledge | None:
        """Return what it knew at a Unix time; None before its first decision."""
        index = bisect_right(self.times_s, at_s)
        return self.known[index - 1] if index else None


def read_words(path: Path, agent_id: int) -> VehicleWords:
    """Read what the vehicle of an agent knew from its log; raises InputError if there is none that can be read."""
    known = tuple(_known(path, agent_id))
    return VehicleWords(known, tuple(one.at_s for one in known))


def _known(path: Path, agent_id: int) -> Iterator[Knowledge]:
    world = WorldModel(agent_id)
    words, next_s = "", -math.inf
    waiting: Knowledge | None = None
    """A decision whose words may still come."""
    for at_s, data in read_tlog(path):
        frame = raw_frame(data)
        if frame.message_id == STATUSTEXT_ID:
            words = _text(frame, words)
            waiting = None if waiting is None else waiting._replace(words=words)
        elif frame.message_id in BROADCAST_IDS or frame.message_id == oneway.MAVLINK_MSG_ID_ONEWAY_DECISION:
            try:
                content = decode_frame(frame)
            except WireError:
                continue
            if not isinstance(content, DecisionFrame):
                world.take(content, at_s)
                continue
            if waiting is not None and waiting.at_s >= next_s:
                yield waiting
                next_s = waiting.at_s + STEP_S
            waiting = _knowledge(at_s, content, world, words)
    if waiting is not None:
        yield waiting


def _knowledge(at_s: float, decision: DecisionFrame, world: WorldModel, words: str) -> Knowledge:
    picture_s = None if math.isnan(decision.picture_age_s) else at_s - decision.picture_age_s
    return Knowledge(
        at_s,
        picture_s,
        world.missing,
        decision.target_id,
        list(Purpose)[decision.purpose].value,
        list(Stage)[decision.stage].value,
        certificate_in_words(decision.certified_s),
        words,
    )


def _text(frame: RawFrame, before: str) -> str:
    """Return what a companion says, whose first chunks were in `before`; the length of a frame is its text's."""
    values = frame.payload[1:].ljust(STATUSTEXT_CHARACTERS + _CHUNK.size, b"\0")
    text = values[:STATUSTEXT_CHARACTERS].rstrip(b"\0").decode(errors="replace")
    _, chunk = _CHUNK.unpack_from(values, STATUSTEXT_CHARACTERS)
    return before + text if chunk else text
