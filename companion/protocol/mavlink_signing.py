"""MAVLink 2 signing on raw frames: the shared-key signature, made and checked without the stock parser's weaknesses.

The stock receiver stores a frame's time before it checks the hash, so that one forged frame deafens it for good, and a
stock sender's time falls behind the clock. Here nothing is stored until the caller says that the frame held in every
respect, times are bounded from above by the local clock, and the sender's time never lags.

The key is shared: whoever holds it can sign as anybody. Who must not be able to is kept out by `ed25519.py`.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Mapping

from companion.files.mavlink_layout import CRC_BYTES, FLAGS_AT, SIGNED_FLAG
from companion.protocol.deframer import crc_of
from companion.protocol.dialect import oneway
from companion.protocol.frame import RawFrame, raw_frame

KEY_BYTES = 32
EPOCH_UNIX_S = 1_420_070_400
"""2015-01-01 UTC, from which MAVLink counts its signing time."""
UNITS_PER_S = 100_000
"""Signing time counts in 10 us."""
MAX_STREAMS = 16
"""Streams remembered at most: we hear one sender, over as many links and restarts as it may have."""

UNSIGNED = "unsigned"
WRONG_HASH = "wrong MAVLink signature"
REPLAYED_TIME = "MAVLink time not newer"
FUTURE_TIME = "MAVLink time in the future"
PAST_TIME = "MAVLink time in the past"
TOO_MANY_STREAMS = "too many MAVLink streams"

StreamKey = tuple[int, int, int]
"""Link id, system, component."""

_TIME_AT = 1
"""In the signature, behind the link id."""
_TIME_BYTES = 6
_HASH_BYTES = 6
_TIME_MAX = (1 << 8 * _TIME_BYTES) - 1


def timestamp_of(unix_s: float) -> int:
    """Return the signing time of a moment, never below 0."""
    return max(0, round((unix_s - EPOCH_UNIX_S) * UNITS_PER_S))


def strip_signature(frame: RawFrame) -> bytes:
    """Return a frame of any dialect without its MAVLink signature, the flag cleared and the CRC mended; for logs.

    A CRC is linear: what clearing the flag changes in it does not depend on the message's CRC_EXTRA, which only its
    dialect knows.
    """
    if not frame.is_signed:
        return frame.data
    body, crc = frame.data[: frame.crc_at], frame.data[frame.crc_at : frame.crc_at + CRC_BYTES]
    # The CRC covers all but the marker, and CRC_EXTRA: as many bytes as the body has.
    flag = bytes((0, SIGNED_FLAG)).ljust(len(body), b"\0")
    changed: int = oneway.x25crc(flag).crc ^ oneway.x25crc(bytes(len(body))).crc
    cleared = body[:FLAGS_AT] + bytes((body[FLAGS_AT] & ~SIGNED_FLAG,)) + body[FLAGS_AT + 1 :]
    return cleared + (int.from_bytes(crc, "little") ^ changed).to_bytes(CRC_BYTES, "little")


class MavlinkSigner:
    """Signs frames as one stream; `last_timestamp` is to be kept over restarts."""

    def __init__(self, key: bytes, link_id: int, last_timestamp: int = 0) -> None:
        self._keyed = _keyed(key)
        self.link_id = link_id
        self.last_timestamp = last_timestamp
        """Of the newest frame signed; no later one is at or below it."""

    def sign(self, raw: bytes, now_s: float) -> bytes:
        """Return a frame with flag, CRC and signature; an earlier MAVLink signature is replaced.

        The time signed is that of the clock, or 10 us above the last one where the clock is not ahead of it.
        """
        frame = raw_frame(raw)
        body = bytearray(raw[: frame.crc_at])
        body[FLAGS_AT] |= SIGNED_FLAG
        self.last_timestamp = min(max(self.last_timestamp + 1, timestamp_of(now_s)), _TIME_MAX)
        signed = (
            bytes(body)
            + crc_of(bytes(body), frame.message_id)
            + bytes((self.link_id,))
            + self.last_timestamp.to_bytes(_TIME_BYTES, "little")
        )
        return signed + _hash(self._keyed, signed)


class MavlinkVerifier:
    """Checks signatures; remembers the newest time of each stream, of frames that held in every respect."""

    def __init__(
        self,
        key: bytes,
        streams: Mapping[StreamKey, int] | None = None,
        ahead_s: float = 5.0,
        behind_s: float = 60.0,
    ) -> None:
        """Allow times up to `ahead_s` after the local clock, and in a stream not known yet `behind_s` before it.

        Infinite values stand for a local clock that cannot be relied on.
        """
        self._keyed = _keyed(key)
        self._ahead_s = ahead_s
        self._behind_s = behind_s
        self._streams = dict(streams or {})

    @property
    def streams(self) -> dict[StreamKey, int]:
        """The newest signing time of each stream; to be kept over restarts."""
        return dict(self._streams)

    def holds(self, frame: RawFrame) -> bool:
        """Return whether a frame is signed with the key, whenever that was."""
        covered, carried = frame.data[:-_HASH_BYTES], frame.data[-_HASH_BYTES:]
        return frame.is_signed and hmac.compare_digest(_hash(self._keyed, covered), carried)

    def check(self, frame: RawFrame, now_s: float) -> str | None:
        """Return why a frame is refused, None if it is not. Remembers nothing."""
        if not frame.is_signed:
            return UNSIGNED
        if not self.holds(frame):
            return WRONG_HASH
        stream, timestamp = _stream_of(frame)
        since_s = (timestamp - timestamp_of(now_s)) / UNITS_PER_S
        if since_s > self._ahead_s:
            return FUTURE_TIME
        last = self._streams.get(stream)
        if last is not None:
            return None if timestamp > last else REPLAYED_TIME
        if since_s < -self._behind_s:
            return PAST_TIME
        return None if self._has_room(now_s) else TOO_MANY_STREAMS

    def commit(self, frame: RawFrame) -> None:
        """Remember the time of a frame that `check` let pass; only once everything else about it held too."""
        stream, timestamp = _stream_of(frame)
        if stream not in self._streams and len(self._streams) >= MAX_STREAMS:
            del self._streams[self._oldest()]
        self._streams[stream] = timestamp

    def _has_room(self, now_s: float) -> bool:
        """Return whether a stream can be added, if need be in place of the oldest.

        That one must be so old that as an unknown stream it would still be refused all it ever carried.
        """
        if len(self._streams) < MAX_STREAMS:
            return True
        return (timestamp_of(now_s) - self._streams[self._oldest()]) / UNITS_PER_S > self._behind_s

    def _oldest(self) -> StreamKey:
        return min(self._streams, key=self._streams.__getitem__)


def _keyed(key: bytes) -> hashlib._Hash:
    """Return the hash that has taken in the key: the key itself is kept nowhere."""
    if len(key) != KEY_BYTES:
        raise ValueError(f"a MAVLink key of {len(key)} bytes; allowed: {KEY_BYTES}")
    return hashlib.sha256(key)


def _hash(keyed: hashlib._Hash, signed: bytes) -> bytes:
    digest = keyed.copy()
    digest.update(signed)
    return digest.digest()[:_HASH_BYTES]


def _stream_of(frame: RawFrame) -> tuple[StreamKey, int]:
    """Return which stream a signed frame is of, and its time."""
    signature = frame.signature
    timestamp = int.from_bytes(signature[_TIME_AT : _TIME_AT + _TIME_BYTES], "little")
    return (signature[0], frame.system, frame.component), timestamp
