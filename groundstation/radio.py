"""Capacity of a radio for the broadcast: a share of its bytes per second, and the longest frame that it sends whole.

A radio is named or given as a number of bytes per second. If the broadcast goes through an autopilot, which forwards
only messages that it knows, every frame is wrapped in a V2_EXTENSION, which costs bytes
(companion/protocol/v2_extension.py).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from companion.errors import InputError, nearest_hint
from companion.files.mavlink_layout import SIGNATURE_BYTES
from companion.protocol.v2_extension import WRAP_BYTES
from groundstation.choices import RADIOS_BYTES_PER_S

LONGEST_FRAME_BYTES = 252
"""The longest packet that SiK firmware sends in one piece; a LoRa modem's is 255."""

LEAST_BYTES_PER_S = 10.0
MOST_BYTES_PER_S = 1.0e8

_WRAPPED_BYTES = {"v2ext": WRAP_BYTES, "v2ext-signed": WRAP_BYTES + SIGNATURE_BYTES}
"""Bytes that wrapping adds, by the suffix of the radio's name; `v2ext-signed`: the outer frame is signed on its way."""
_NUMBER = re.compile(r"(\d+(?:\.\d+)?) ?(?:B/s)?")


@dataclass(frozen=True)
class Radio:
    """A radio, and how the broadcast may use it."""

    name: str
    bytes_per_s: float
    max_frame_bytes: int
    """Greatest length of a frame with its signatures, before it is wrapped."""
    share: float
    """Share of the radio's bytes for the broadcast, in (0, 1]."""
    wrapped: bool = False
    """Whether every frame is wrapped in a V2_EXTENSION."""
    outer_bytes: int = 0
    """Number of bytes that wrapping adds to each frame on the air."""
    heartbeats: bool = False
    """Whether a MAVLink heartbeat is sent every second: SiK firmware reports its buffer only once it has seen one. Not
    if frames are wrapped: the radio would not find it inside, and the autopilot before it sends its own."""

    @property
    def budget_bytes_per_s(self) -> float:
        """Bytes per second that the broadcast may send."""
        return self.bytes_per_s * self.share

    @property
    def added_bytes(self) -> int:
        """Number of bytes added to each sent frame on its way: those of the outer frame's signature, if it gets one."""
        return self.outer_bytes - WRAP_BYTES if self.wrapped else 0


def parse_radio(text: str, share: float) -> Radio:
    """Return the radio for `NAME`, `N` or `N B/s`, each also with `/v2ext` or `/v2ext-signed` after it.

    Raises:
        InputError: there is no such radio, its rate is out of bounds, or the share is not in (0, 1].

    """
    if not 0.0 < share <= 1.0:
        raise InputError(f"share: {share:g}; allowed: more than 0, at most 1")
    name, _, path = text.partition("/v2ext")
    path = text[len(name) + 1 :]
    rate_bytes_per_s = RADIOS_BYTES_PER_S.get(name)
    if rate_bytes_per_s is None and (number := _NUMBER.fullmatch(name)) is not None:
        rate_bytes_per_s = float(number[1])
    if rate_bytes_per_s is None or path not in ("", *_WRAPPED_BYTES):
        hint = nearest_hint(
            text, [*RADIOS_BYTES_PER_S, *(f"{n}/{p}" for n in RADIOS_BYTES_PER_S for p in _WRAPPED_BYTES)]
        )
        raise InputError(
            f"radio '{text}'{hint}; allowed: {', '.join(RADIOS_BYTES_PER_S)} or a number of bytes per second, "
            "each also with /v2ext or /v2ext-signed after it"
        )
    if not LEAST_BYTES_PER_S <= rate_bytes_per_s <= MOST_BYTES_PER_S:
        raise InputError(
            f"radio '{text}': {rate_bytes_per_s:g} B/s; allowed: {LEAST_BYTES_PER_S:g} to {MOST_BYTES_PER_S:g}"
        )
    outer_bytes = _WRAPPED_BYTES.get(path, 0)
    longest_bytes = LONGEST_FRAME_BYTES - outer_bytes
    is_wrapped = path != ""
    heartbeats = name.startswith("sik-") and not is_wrapped
    return Radio(text, rate_bytes_per_s, longest_bytes, share, is_wrapped, outer_bytes, heartbeats)
