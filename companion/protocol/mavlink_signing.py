"""MAVLink 2 signing on raw frames: the shared-key signature, made and checked without the stock parser's weaknesses.

The stock receiver stores a frame's time before it checks the hash, so that one forged frame makes it refuse all later
ones, and a stock sender's time falls behind the clock. Here nothing is stored until the caller confirms that the frame
passed every check, times are bounded from above by the local clock, and the sender's time never lags behind it.

The key is shared: whoever holds it can sign as any sender. `ed25519.py` protects against a holder who does.
"""

from __future__ import annotations

import hashlib
import hmac
import math
from collections.abc import Mapping

from companion.files.mavlink_layout import CRC_BYTES, FLAGS_AT, SIGNED_FLAG
from companion.protocol.deframer import crc_of
from companion.protocol.dialect import oneway
from companion.protocol.frame import RawFrame, raw_frame
from companion.protocol.freshness import LEAP_S

KEY_BYTES = 32
EPOCH_UNIX_S = 1_420_070_400
"""2015-01-01 00:00 UTC, from which MAVLink counts its signing time."""
UNITS_PER_S = 100_000
"""Units of signing time in a second: MAVLink counts it in 10 us."""
MAX_STREAMS = 16
"""Greatest number of streams remembered, unless another is given; the one sender may send on several links."""

UNSIGNED = "unsigned"
WRONG_HASH = "wrong MAVLink signature"
REPLAYED_TIME = "MAVLink time not newer"
FUTURE_TIME = "MAVLink time in the future"
PAST_TIME = "MAVLink time in the past"
TOO_MANY_STREAMS = "too many MAVLink streams"

StreamKey = tuple[int, int, int]
"""A stream of signed frames: its link id, system id and component id."""

_TIME_AT = 1
"""Offset of the signing time in the signature, after the link id."""
_TIME_BYTES = 6
_HASH_BYTES = 6
_TIME_MAX = (1 << 8 * _TIME_BYTES) - 1


def timestamp_of(unix_s: float) -> int:
    """Return the signing time, in units of 10 us since EPOCH_UNIX_S, of a Unix time in seconds; at least 0."""
    return max(0, round((unix_s - EPOCH_UNIX_S) * UNITS_PER_S))


def without_signature(frame: RawFrame) -> RawFrame:
    """Return a frame of any dialect without its MAVLink signature; see `strip_signature`."""
    return raw_frame(strip_signature(frame)) if frame.is_signed else frame


def strip_signature(frame: RawFrame) -> bytes:
    """Return a frame of any dialect without its MAVLink signature, the flag cleared and the CRC corrected; for logs.

    A CRC is linear, so the change from clearing the flag does not depend on the message's CRC_EXTRA, which only its
    dialect knows.
    """
    if not frame.is_signed:
        return frame.data
    body, crc = frame.data[: frame.crc_at], frame.data[frame.crc_at : frame.crc_at + CRC_BYTES]
    # The CRC covers the body without its marker, then CRC_EXTRA: in all the number of bytes that the body has.
    flag = bytes((0, SIGNED_FLAG)).ljust(len(body), b"\0")
    changed: int = oneway.x25crc(flag).crc ^ oneway.x25crc(bytes(len(body))).crc
    cleared = body[:FLAGS_AT] + bytes((body[FLAGS_AT] & ~SIGNED_FLAG,)) + body[FLAGS_AT + 1 :]
    return cleared + (int.from_bytes(crc, "little") ^ changed).to_bytes(CRC_BYTES, "little")


class MavlinkSigner:
    """Signs frames as one stream; the caller must save `last_timestamp` over restarts."""

    def __init__(self, key: bytes, link_id: int, last_timestamp: int = 0) -> None:
        self._keyed = _keyed(key)
        self.link_id = link_id
        self.last_timestamp = last_timestamp
        """Signing time of the newest frame signed; every later frame gets a greater one."""

    def sign(self, raw: bytes, now_s: float) -> bytes:
        """Return a frame with a MAVLink signature, flag and CRC set to match; an earlier signature is replaced.

        The signing time is `now_s` (Unix), or 10 us after the last one if `now_s` is not later than that.
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

    def holds(self, frame: RawFrame) -> bool:
        """Return whether a frame is signed with the key, by whomever and at any time."""
        return _holds(self._keyed, frame)


class MavlinkVerifier:
    """Checks MAVLink signatures; remembers each stream's newest signing time, of frames that passed every check."""

    def __init__(
        self,
        key: bytes,
        streams: Mapping[StreamKey, int] | None = None,
        ahead_s: float = 5.0,
        behind_s: float = 60.0,
        most_streams: int = MAX_STREAMS,
    ) -> None:
        """Allow signing times up to `ahead_s` after the local clock and, in a new stream, up to `behind_s` before it.

        Both are infinite if the local clock is not reliable. At most `most_streams` are remembered.
        """
        self._keyed = _keyed(key)
        self._ahead_s = ahead_s
        self._behind_s = behind_s
        self._streams = dict(streams or {})
        self._most_streams = most_streams

    @property
    def streams(self) -> dict[StreamKey, int]:
        """Newest signing time of each stream, which the caller must save over restarts."""
        return dict(self._streams)

    def holds(self, frame: RawFrame) -> bool:
        """Return whether a frame is signed with the key; the signing time is not checked."""
        return _holds(self._keyed, frame)

    def check(self, frame: RawFrame, now_s: float, *, silent: bool = False) -> str | None:
        """Return the reason why a frame is refused, None if it is accepted; nothing is remembered.

        `silent`: nothing was accepted for long. Where no clock bounds the times, one frame's that is far ahead must not
        shut out its stream, nor a full table a new stream, for good: the caller must know old frames by their stamps.
        """
        if not frame.is_signed:
            return UNSIGNED
        if not self.holds(frame):
            return WRONG_HASH
        stream, timestamp = _stream_of(frame)
        since_s = (timestamp - timestamp_of(now_s)) / UNITS_PER_S
        if since_s > self._ahead_s:
            return FUTURE_TIME
        last = self._streams.get(stream)
        may_leap_back = silent and math.isinf(self._ahead_s)
        if last is not None:
            leaps_back = may_leap_back and timestamp < last - LEAP_S * UNITS_PER_S
            return None if timestamp > last or leaps_back else REPLAYED_TIME
        if since_s < -self._behind_s:
            return PAST_TIME
        return None if may_leap_back or self._has_room(now_s) else TOO_MANY_STREAMS

    def commit(self, frame: RawFrame) -> None:
        """Remember the signing time of a frame that `check` accepted; call this only after every other check passed."""
        stream, timestamp = _stream_of(frame)
        if stream not in self._streams and len(self._streams) >= self._most_streams:
            del self._streams[self._oldest()]
        self._streams[stream] = timestamp

    def _has_room(self, now_s: float) -> bool:
        """Return whether a stream can be added, if necessary in place of the oldest one.

        The oldest may be forgotten once its newest time is more than `behind_s` ago: if its frames were replayed as a
        new stream, each would be refused as too old.
        """
        if len(self._streams) < self._most_streams:
            return True
        return (timestamp_of(now_s) - self._streams[self._oldest()]) / UNITS_PER_S > self._behind_s

    def _oldest(self) -> StreamKey:
        return min(self._streams, key=self._streams.__getitem__)


def _keyed(key: bytes) -> hashlib._Hash:
    """Return the SHA-256 state after the key, so that the key itself need not be stored."""
    if len(key) != KEY_BYTES:
        raise ValueError(f"a MAVLink key of {len(key)} bytes; allowed: {KEY_BYTES}")
    return hashlib.sha256(key)


def _holds(keyed: hashlib._Hash, frame: RawFrame) -> bool:
    covered, carried = frame.data[:-_HASH_BYTES], frame.data[-_HASH_BYTES:]
    return frame.is_signed and hmac.compare_digest(_hash(keyed, covered), carried)


def _hash(keyed: hashlib._Hash, signed: bytes) -> bytes:
    digest = keyed.copy()
    digest.update(signed)
    return digest.digest()[:_HASH_BYTES]


def signing_time_s(frame: RawFrame) -> float:
    """Return the signing time of a signed frame in Unix seconds."""
    return EPOCH_UNIX_S + _stream_of(frame)[1] / UNITS_PER_S


def _stream_of(frame: RawFrame) -> tuple[StreamKey, int]:
    """Return the stream and the signing time of a signed frame."""
    signature = frame.signature
    timestamp = int.from_bytes(signature[_TIME_AT : _TIME_AT + _TIME_BYTES], "little")
    return (signature[0], frame.system, frame.component), timestamp
