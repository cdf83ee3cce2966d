"""Recognises frames of another release of the dialect: their CRC holds, but with another CRC_EXTRA than ours.

CRC_EXTRA is computed from a message's fields, so that sender and receiver with different fields do not understand each
other by mistake: to each the other's frames look damaged, every one of them.
"""

from __future__ import annotations

from typing import NamedTuple

from companion.files.mavlink_layout import (
    FLAGS_AT,
    HEADER_V2_BYTES,
    MARKER_V2,
    SIGNED_FLAG,
    crc_extra_of,
    frame_parts,
)
from companion.protocol.dialect import oneway
from companion.protocol.frame import BROADCAST_IDS

MOST_TRIES = 16
"""Greatest number of places in a sample where a frame is looked for."""


class OtherDialect(NamedTuple):
    """A message that came with another CRC_EXTRA than this program's."""

    name: str
    heard: int
    ours: int


def other_dialect(sample: bytes) -> OtherDialect | None:
    """Return the first message of the broadcast in received bytes that another release may have made; None without one.

    Of frames that are merely damaged one in 256 looks like that, so that it must be found twice.
    """
    at = -1
    for _ in range(MOST_TRIES):
        at = sample.find(MARKER_V2, at + 1)
        if at < 0 or len(sample) - at < HEADER_V2_BYTES:
            return None
        number, _, _, end = frame_parts(sample, at)
        if number not in BROADCAST_IDS or end > len(sample) or sample[at + FLAGS_AT] & ~SIGNED_FLAG:
            continue
        kind = oneway.mavlink_map[number]
        heard = crc_extra_of(sample[at:end])
        if heard is not None and heard != kind.crc_extra:
            return OtherDialect(kind.msgname, heard, kind.crc_extra)
    return None
