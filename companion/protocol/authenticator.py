"""Which of the frames that arrive are the ground station's, new and sane: the only way into the picture.

Checks run cheapest first, so that a flood without the key costs little, and nothing is remembered of a frame until all
of it held, so that no forgery can push genuine frames out. What is refused is counted by reason, never raised.

Under Ed25519 the MAVLink signature only keeps outsiders from the costlier check. Its time is then not looked at: it
would be in the hand of any vehicle that holds the shared key, while the stamp is under the centre's own signature.
"""

from __future__ import annotations

import json
import math
import random
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from companion.errors import InputError
from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM, Frame, WireError, decode_frame
from companion.protocol.deframer import MAX_DATAGRAM_BYTES, StreamFramer, frames_in
from companion.protocol.dialect import oneway
from companion.protocol.ed25519 import signed_part, verify
from companion.protocol.frame import BROADCAST_IDS, ED25519_BYTES, RawFrame
from companion.protocol.freshness import off_the_clock, overtaken
from companion.protocol.mavlink_signing import UNSIGNED, WRONG_HASH, MavlinkVerifier, StreamKey

TOO_LARGE = "datagram too large"
OTHER_SENDER = "other sender"
OTHER_MESSAGE = "not a broadcast"
HEARTBEAT = "heartbeat"
TRAILING_BYTES = "bytes behind the content"
NO_ED25519 = "no Ed25519 signature"
WRONG_ED25519 = "wrong Ed25519 signature"
REPEATED = "repeated"
UNCHECKED = "unchecked in a flood"
EXPECTED = (HEARTBEAT, REPEATED)
"""What a ground station sends on purpose, for its radio and as copies, though nothing is to be believed of it."""

BURST_CHECKS = 400
"""Ed25519 checks saved up in quiet times: a whole broadcast of the greatest length, 255 frames, may come at once."""
WINDOW_S = 0.05
"""Time that frames wait in a flood, so that the front of a burst has no better chance than its end."""
REMEMBERED_FRAMES = 1024
"""Newest frames remembered to tell repeats; a broadcast has at most 255 of each kind."""
MAX_REASONS = 64
"""Kinds of reasons counted apart at most."""
OTHER_REASONS = "other reasons"

_UINT32_MAX = 0xFFFF_FFFF

OfferedT = TypeVar("OfferedT")


@dataclass(frozen=True)
class Trust:
    """Whom to believe, and how far clocks may differ. Without a key everybody is believed."""

    mavlink_key: bytes | None = field(default=None, repr=False)
    """The shared key, 32 bytes."""
    public_key: Ed25519PublicKey | None = field(default=None, repr=False)
    max_age_s: float = 30.0
    ahead_s: float = 2.0
    checks_per_s: float = 1000.0
    """Bound on Ed25519 checks, in the mean over a few seconds: an eighth of a core at 0.13 ms each."""
    clock_checked: bool = True
    """Whether frames must be of now by our clock; False where the vehicle has no clock that can be relied on."""

    @property
    def words(self) -> str:
        """What authenticates frames, for status lines."""
        keys = {"MAVLink signing": self.mavlink_key, "Ed25519": self.public_key}
        names = [name for name, key in keys.items() if key is not None]
        return " and ".join(names) or "unsigned"


@dataclass(frozen=True)
class AuthenticatorState:
    """What must survive a restart, so that nothing already accepted is accepted again."""

    epoch_s: int | None = None
    sequence: int = -1
    streams: tuple[tuple[StreamKey, int], ...] = ()
    """Newest MAVLink signing time of each stream."""

    def to_json(self) -> str:
        """Return the state as one line of JSON; no key is in it."""
        streams = [[*stream, timestamp] for stream, timestamp in self.streams]
        return json.dumps({"epoch_s": self.epoch_s, "sequence": self.sequence, "streams": streams})

    @classmethod
    def from_json(cls, text: str) -> AuthenticatorState:
        """Return the state that `to_json` wrote; raises InputError if it is none."""
        try:
            values = json.loads(text)
            epoch_s = values["epoch_s"]
            state = cls(
                None if epoch_s is None else int(epoch_s),
                int(values["sequence"]),
                tuple(((int(a), int(b), int(c)), int(t)) for a, b, c, t in values["streams"]),
            )
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
            raise InputError(
                "the state of the broadcast is not readable; allowed: what companion wrote, or no file, after which "
                "what was sent within the last seconds could be replayed once"
            ) from error
        if not (0 <= (state.epoch_s or 0) <= _UINT32_MAX and -1 <= state.sequence <= _UINT32_MAX):
            raise InputError(f"the state of the broadcast has epoch {state.epoch_s}, sequence {state.sequence}")
        return state


class Authenticated(NamedTuple):
    """A frame that held in every respect, as it came and decoded."""

    raw: RawFrame
    frame: Frame


class Authenticator:
    """Lets genuine, new and sane frames in. All times are this vehicle's clock in Unix seconds."""

    def __init__(
        self,
        trust: Trust,
        state: AuthenticatorState | None = None,
        *,
        is_stream: bool = False,
        rng: random.Random | None = None,
    ) -> None:
        """With `is_stream`, what arrives are the chunks of a byte stream, such as a serial radio's.

        `rng` chooses what is checked in a flood; an unpredictable one by default.
        """
        state = state or AuthenticatorState()
        self.trust = trust
        self._rejected: Counter[str] = Counter()
        self._framer = StreamFramer() if is_stream else None
        self._epoch_s = state.epoch_s
        self._sequence = state.sequence
        self._heard: dict[bytes, None] = {}
        self._quiet_since_s: float | None = None
        """When the last frame was accepted; before there was one, when the first datagram came."""
        ahead_s, behind_s = (trust.ahead_s, 60.0) if trust.clock_checked else (math.inf, math.inf)
        self._verifier = (
            None
            if trust.mavlink_key is None
            else MavlinkVerifier(trust.mavlink_key, dict(state.streams), ahead_s, behind_s)
        )
        self._gate = (
            None if trust.public_key is None else CheckLimiter[RawFrame](trust.checks_per_s, rng or random.Random())
        )

    @property
    def rejected(self) -> Counter[str]:
        """How many frames, or runs of bytes that are none, were refused, by reason."""
        counts = Counter(self._rejected)
        if self._framer is not None:
            counts.update(self._framer.skipped)
        if self._gate is not None and self._gate.dropped:
            counts[UNCHECKED] = self._gate.dropped
        return counts

    @property
    def state(self) -> AuthenticatorState:
        """What is to be kept over a restart."""
        streams = {} if self._verifier is None else self._verifier.streams
        return AuthenticatorState(self._epoch_s, self._sequence, tuple(sorted(streams.items())))

    def admit(self, datagram: bytes, now_s: float) -> list[Authenticated]:
        """Return the frames to be believed by now, mostly those of this datagram. Never raises, whatever the bytes.

        In a flood under Ed25519 a frame may come out of a later call, WINDOW_S or a little more after it arrived.
        """
        return self.admit_frames(self.deframed(datagram), now_s)

    def deframed(self, datagram: bytes) -> Iterator[RawFrame]:
        """Return the whole frames in a datagram, or completed by a chunk of a stream; what is none is counted."""
        if self._framer is not None:
            return iter(self._framer.feed(datagram))
        if len(datagram) > MAX_DATAGRAM_BYTES:
            self._rejected[TOO_LARGE] += 1
            return iter(())
        return frames_in(datagram, self._rejected)

    def admit_frames(self, frames: Iterable[RawFrame], now_s: float) -> list[Authenticated]:
        """Return the frames to be believed by now, mostly of these, which `deframed` gave; see `admit`."""
        if self._quiet_since_s is None:
            self._quiet_since_s = now_s
        admitted = self.due(now_s)
        for raw in frames:
            reason = self._refused(raw, now_s)
            if reason is not None:
                self._rejected[reason] += 1
            elif self._gate is None:
                self._take(raw, now_s, admitted)
            elif self._gate.offer(raw, now_s):
                self._check(raw, now_s, admitted)
        return admitted

    def due(self, now_s: float) -> list[Authenticated]:
        """Return what waited for its check and held; to be called now and then where datagrams may cease."""
        admitted: list[Authenticated] = []
        if self._gate is not None:
            for raw in self._gate.due(now_s):
                self._check(raw, now_s, admitted)
        return admitted

    def _refused(self, raw: RawFrame, now_s: float) -> str | None:
        """Return why a whole frame is refused before any costly check, None if it is not."""
        if raw.system != GROUND_SYSTEM or raw.component != GROUND_COMPONENT:
            return OTHER_SENDER
        if raw.message_id not in BROADCAST_IDS:
            return HEARTBEAT if raw.message_id == oneway.MAVLINK_MSG_ID_HEARTBEAT else OTHER_MESSAGE
        if self._verifier is not None:
            reason = self._unsigned(raw, now_s, self._verifier)
            if reason is not None:
                return reason
        behind_bytes = raw.payload_length - raw.content_length
        if behind_bytes > ED25519_BYTES:
            return TRAILING_BYTES
        if behind_bytes <= 0 and self.trust.public_key is not None:
            return NO_ED25519
        return self._stale(raw, now_s)

    def _unsigned(self, raw: RawFrame, now_s: float, verifier: MavlinkVerifier) -> str | None:
        """Return why a frame's MAVLink signature is refused, None if it is not."""
        if self.trust.public_key is None:
            return verifier.check(raw, now_s)
        if verifier.holds(raw):
            return None
        return WRONG_HASH if raw.is_signed else UNSIGNED

    def _stale(self, raw: RawFrame, now_s: float) -> str | None:
        """Return why a frame's stamp is refused, None if it is not."""
        stamp = raw.stamp
        if self.trust.clock_checked:
            reason = off_the_clock(stamp, now_s, self.trust.ahead_s, self.trust.max_age_s)
            if reason is not None:
                return reason
        if self._epoch_s is None or stamp.epoch_s > self._epoch_s:
            return None
        silent_s = 0.0
        if self.trust.public_key is None and self._quiet_since_s is not None:
            # Others can make a frame too: one of theirs, stamped ahead, must not shut the centre out for good.
            silent_s = now_s - self._quiet_since_s
        reason = overtaken(stamp, (self._epoch_s, self._sequence), silent_s)
        if reason is not None:
            return reason
        return REPEATED if signed_part(raw) in self._heard else None

    def _check(self, raw: RawFrame, now_s: float, admitted: list[Authenticated]) -> None:
        # Between a frame's arrival and its turn a newer one may have been accepted.
        reason = self._stale(raw, now_s)
        if reason is None and self.trust.public_key is not None and not verify(raw, self.trust.public_key):
            reason = WRONG_ED25519
        if reason is None:
            self._take(raw, now_s, admitted)
        else:
            self._rejected[reason] += 1

    def _take(self, raw: RawFrame, now_s: float, admitted: list[Authenticated]) -> None:
        """Decode an authentic frame; remember it if it makes sense."""
        try:
            frame = decode_frame(raw)
        except WireError as error:
            reason = str(error)
            known = reason in self._rejected or len(self._rejected) < MAX_REASONS
            self._rejected[reason if known else OTHER_REASONS] += 1
            return
        self._quiet_since_s = now_s
        self._epoch_s, _, self._sequence = raw.stamp
        self._heard[signed_part(raw)] = None
        if len(self._heard) > REMEMBERED_FRAMES:
            del self._heard[next(iter(self._heard))]
        if self._verifier is not None and self.trust.public_key is None:
            self._verifier.commit(raw)
        admitted.append(Authenticated(raw, frame))


class CheckLimiter(Generic[OfferedT]):
    """Bounds costly checks, and lets chance decide which frames get one when there are too many.

    In quiet times a frame is checked at once. Once half of the saved checks are used up, frames are gathered for
    WINDOW_S and as many as there are checks for are drawn from them, each with the same chance (reservoir sampling), so
    that to come first, or last, is of no use to a forger. With F forged frames in a window a genuine one is checked
    with a chance of at least checks_per_s * WINDOW_S / (F + 1).
    """

    def __init__(self, checks_per_s: float, rng: random.Random) -> None:
        self.dropped = 0
        """Frames that got no check."""
        self._rate_per_s = checks_per_s
        self._window_s = max(WINDOW_S, 1.0 / checks_per_s)
        self._rng = rng
        self._saved = float(BURST_CHECKS)
        self._saved_at_s: float | None = None
        self._closes_s: float | None = None
        self._places = 0
        self._offered = 0
        self._waiting: list[tuple[int, OfferedT]] = []

    def offer(self, raw: OfferedT, now_s: float) -> bool:
        """Return whether to check a frame at once; if not, it may be given by `due`, or never."""
        self._save(now_s)
        if self._closes_s is None:
            if self._saved >= BURST_CHECKS / 2:
                self._saved -= 1
                return True
            self._closes_s = now_s + self._window_s
            self._places = max(1, int(self._saved + self._rate_per_s * self._window_s))
            self._offered = 0
        self._offered += 1
        if len(self._waiting) < self._places:
            self._waiting.append((self._offered, raw))
            return False
        self.dropped += 1
        place = self._rng.randrange(self._offered)
        if place < self._places:
            self._waiting[place] = (self._offered, raw)
        return False

    def due(self, now_s: float) -> list[OfferedT]:
        """Return the frames drawn from a window that is over, in the order in which they came."""
        if self._closes_s is None or now_s < self._closes_s:
            return []
        self._save(now_s)
        drawn = [raw for _, raw in sorted(self._waiting)]
        self._saved -= len(drawn)
        self._waiting = []
        self._closes_s = None
        return drawn

    def _save(self, now_s: float) -> None:
        if self._saved_at_s is not None:
            passed_s = max(0.0, now_s - self._saved_at_s)
            self._saved = min(float(BURST_CHECKS), self._saved + passed_s * self._rate_per_s)
        self._saved_at_s = now_s
