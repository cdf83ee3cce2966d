"""Check that received frames are the ground station's, new and valid: the only way into the world model.

Checks run cheapest first, so that a flood without the key costs little. Nothing about a frame is remembered until it
passed all checks, so that no forged frame can displace genuine ones. Refused frames are counted by reason, not raised.

With Ed25519 the MAVLink signature only keeps outsiders' frames from the costlier check. Its signing time is then
ignored: any vehicle that holds the shared key could set it, whereas the stamp is under the ground station's own
Ed25519 signature.
"""

from __future__ import annotations

import json
import math
import random
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from companion.errors import InputError
from companion.protocol.believed import MOST_SPANS, BelievedBroadcasts, Kept, Rules, Span
from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM, Frame, WireError, decode_frame
from companion.protocol.deframer import MAX_DATAGRAM_BYTES, StreamFramer, frames_in
from companion.protocol.dialect import oneway
from companion.protocol.ed25519 import signed_part, verify
from companion.protocol.fields import UINT32_MAX
from companion.protocol.frame import BROADCAST_IDS, ED25519_BYTES, RawFrame
from companion.protocol.freshness import FUTURE_STAMP, PAST_STAMP, Lateness, off_the_clock
from companion.protocol.mavlink_signing import (
    FUTURE_TIME,
    MAX_STREAMS,
    PAST_TIME,
    UNSIGNED,
    WRONG_HASH,
    MavlinkVerifier,
    StreamKey,
)
from companion.runtime.fair_share import FairShare

TOO_LARGE = "datagram too large"
OTHER_SENDER = "other sender"
OTHER_MESSAGE = "not a broadcast"
HEARTBEAT = "heartbeat"
TRAILING_BYTES = "bytes behind the content"
NO_ED25519 = "no Ed25519 signature"
WRONG_ED25519 = "wrong Ed25519 signature"
REPEATED = "repeated"
UNCHECKED = "unchecked in a flood"
TOO_MANY_FRAMES = "more frames than a broadcast has"
OFF_THE_CLOCK = frozenset({FUTURE_STAMP, PAST_STAMP, FUTURE_TIME, PAST_TIME})
"""Reasons that an authentic frame is refused for if clocks differ."""
EXPECTED = (HEARTBEAT, REPEATED)
"""Reasons that are normal: a ground station sends heartbeats for its radio, and repeats its frames."""

BURST_CHECKS = 400
"""Greatest number of Ed25519 checks saved up in quiet times: the 255 frames of a longest broadcast may come at once."""
REMEMBERED_FRAMES = 1024
"""Greatest number of frames of the newest broadcast that are remembered to recognise repeats; it has at most 255 of
each kind. Beyond it none are believed; without a key, where repeats do no more harm than forgeries, the oldest goes."""
LATENESS_CHECK_S = 1.0
"""Time between two Ed25519 checks of frames that the clock refuses anyway: enough to say by how much clocks differ."""
SAMPLE_BYTES = 600
"""Length of the sample that is kept of a stream: two of the longest frames."""
MAX_REASONS = 64
"""Greatest number of reasons that are counted separately; any further one counts as OTHER_REASONS."""
OTHER_REASONS = "other reasons"


@dataclass(frozen=True)
class Trust:
    """Keys that authenticate the broadcast, and how far stamps may be off. Without a key every sender is accepted."""

    mavlink_key: bytes | None = field(default=None, repr=False)
    """The shared key, 32 bytes."""
    public_key: Ed25519PublicKey | None = field(default=None, repr=False)
    """The ground station's public key."""
    max_age_s: float = 30.0
    """Greatest age of a stamp by the vehicle's clock."""
    ahead_s: float = 2.0
    """Greatest time that a stamp may be ahead of the vehicle's clock."""
    checks_per_s: float = 1000.0
    """Greatest mean rate of Ed25519 checks over a few seconds; at 0.13 ms each, 1000 take an eighth of a core."""
    clock_checked: bool = True
    """Whether stamps are compared with the vehicle's clock; False if that clock is not reliable."""

    @property
    def keyed(self) -> bool:
        """Whether any key authenticates the broadcast."""
        return self.mavlink_key is not None or self.public_key is not None

    @property
    def words(self) -> str:
        """Names of the signatures that are checked, for status lines."""
        keys = {"MAVLink signing": self.mavlink_key, "Ed25519": self.public_key}
        names = [name for name, key in keys.items() if key is not None]
        return " and ".join(names) or "unsigned"


@dataclass(frozen=True)
class AuthenticatorState:
    """State saved over a restart, so that no frame that was accepted is accepted again."""

    epoch_s: int | None = None
    sequence: int = -1
    streams: tuple[tuple[StreamKey, int], ...] = ()
    """Newest MAVLink signing time of each stream."""
    newest_unix_s: float | None = None
    """Stamp of the frame accepted last; kept only where the clock is not checked, as the spans are."""
    spans: tuple[Span, ...] = ()
    is_open: bool = False
    """Whether the program ran on after this was saved, so that it may have accepted more."""

    def to_json(self) -> str:
        """Return the state as one line of JSON; it contains no key."""
        streams = [[*stream, timestamp] for stream, timestamp in self.streams]
        values: dict[str, object] = {"epoch_s": self.epoch_s, "sequence": self.sequence, "streams": streams}
        if self.newest_unix_s is not None:
            values |= {"newest_unix_s": self.newest_unix_s, "spans": [[*span.first, *span.last] for span in self.spans]}
        return json.dumps(values | ({"open": True} if self.is_open else {}))

    @classmethod
    def from_json(cls, text: str) -> AuthenticatorState:
        """Return the state in a text that `to_json` wrote; raises InputError for any other text."""
        try:
            values = json.loads(text)
            epoch_s, newest_unix_s = values["epoch_s"], values.get("newest_unix_s")
            state = cls(
                None if epoch_s is None else int(epoch_s),
                int(values["sequence"]),
                tuple(((int(a), int(b), int(c)), int(t)) for a, b, c, t in values["streams"]),
                None if newest_unix_s is None else float(newest_unix_s),
                tuple(Span((int(a), int(b)), (int(c), int(d))) for a, b, c, d in values.get("spans", ())),
                bool(values.get("open", False)),
            )
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
            raise InputError(
                "the state of the broadcast is not readable; allowed: what companion wrote, or no file, after which "
                "what was sent within the last seconds could be replayed once"
            ) from error
        if not (0 <= (state.epoch_s or 0) <= UINT32_MAX and -1 <= state.sequence <= UINT32_MAX):
            raise InputError(f"the state of the broadcast has epoch {state.epoch_s}, sequence {state.sequence}")
        if len(state.spans) > MOST_SPANS + 1 or len(state.streams) > MAX_STREAMS:
            raise InputError(f"the state of the broadcast has {len(state.spans)} spans, {len(state.streams)} streams")
        return state


class Authenticated(NamedTuple):
    """A frame that passed every check: as received, and decoded."""

    raw: RawFrame
    frame: Frame


class Authenticator:
    """Accepts the frames that are genuine, new and valid. All times are Unix seconds by this vehicle's clock."""

    def __init__(
        self,
        trust: Trust,
        state: AuthenticatorState | None = None,
        *,
        is_stream: bool = False,
        rng: random.Random | None = None,
        checks_at_once: int | None = None,
    ) -> None:
        """Start from a saved state; with `is_stream` the input is chunks of a byte stream, such as a serial radio's.

        `rng` draws the frames that are checked in a flood; by default it is seeded unpredictably. Of the frames drawn
        each call checks at most `checks_at_once`; None: all.
        """
        self.trust = trust
        self.accepted = 0
        """Number of accepted frames."""
        self.newest: RawFrame | None = None
        """The frame accepted last."""
        self.sample = b""
        """The newest datagram, or end of the stream, whatever was in it."""
        self.lateness = Latenesses()
        self._rejected: Counter[str] = Counter()
        self._framer = StreamFramer() if is_stream else None
        self._heard: dict[bytes, None] = {}
        self._order = BelievedBroadcasts(_order_rules(trust), None if state is None else _kept_of(state))
        ahead_s, behind_s = (trust.ahead_s, 60.0) if trust.clock_checked else (math.inf, math.inf)
        streams = () if state is None else state.streams
        self._verifier = (
            None if trust.mavlink_key is None else MavlinkVerifier(trust.mavlink_key, dict(streams), ahead_s, behind_s)
        )
        self._gate = (
            None
            if trust.public_key is None
            else FairShare[RawFrame](trust.checks_per_s, BURST_CHECKS, rng or random.Random())
        )
        self._checks_at_once = checks_at_once

    @property
    def rejected(self) -> Counter[str]:
        """Number of refused frames, and of runs of bytes that are no frame, by reason."""
        counts = Counter(self._rejected)
        if self._framer is not None:
            counts.update(self._framer.skipped)
        if self._gate is not None and self._gate.dropped:
            counts[UNCHECKED] = self._gate.dropped
        return counts

    @property
    def state(self) -> AuthenticatorState:
        """State to save over a restart."""
        streams = {} if self._verifier is None else self._verifier.streams
        kept = self._order.kept
        epoch_s, sequence = (None, -1) if kept.newest is None else kept.newest
        state = AuthenticatorState(epoch_s, sequence, tuple(sorted(streams.items())))
        if self.trust.clock_checked or not self.trust.keyed:
            return state
        return replace(state, newest_unix_s=kept.newest_unix_s, spans=kept.spans)

    def admit(self, datagram: bytes, now_s: float) -> list[Authenticated]:
        """Return the frames that are accepted now, usually those of this datagram. Never raises, whatever the bytes.

        In a flood, with Ed25519, a later call may return a frame, WINDOW_S or a little more after it arrived.
        """
        return self.admit_frames(self.deframed(datagram), now_s)

    def deframed(self, datagram: bytes) -> Iterator[RawFrame]:
        """Return the whole frames in a datagram, or those that a chunk of a stream completes; count all other bytes."""
        if self._framer is not None:
            self.sample = (self.sample + datagram)[-SAMPLE_BYTES:]
            return iter(self._framer.feed(datagram))
        self.sample = datagram
        if len(datagram) > MAX_DATAGRAM_BYTES:
            self._rejected[TOO_LARGE] += 1
            return iter(())
        return frames_in(datagram, self._rejected)

    def admit_frames(self, frames: Iterable[RawFrame], now_s: float) -> list[Authenticated]:
        """Return the frames that are accepted now, usually of `frames`, which `deframed` returned; see `admit`."""
        admitted = self.due(now_s)
        for raw in frames:
            reason = self._refused(raw, now_s)
            if reason is not None:
                self._rejected[reason] += 1
                if reason in OFF_THE_CLOCK:
                    self._note_off_the_clock(raw, now_s)
            elif self._gate is None:
                self._take(raw, now_s, admitted)
            elif self._gate.offer(raw, now_s):
                self._check(raw, now_s, admitted)
        return admitted

    def due_s(self) -> float:
        """Return the time from which `due` checks frames that waited: at once (-inf), or never (inf) if none waits."""
        return math.inf if self._gate is None else self._gate.due_s()

    def due(self, now_s: float) -> list[Authenticated]:
        """Return the frames that waited for an Ed25519 check and passed; call it regularly, as datagrams may cease."""
        self._order.begin(now_s)
        admitted: list[Authenticated] = []
        if self._gate is not None:
            for raw in self._gate.due(now_s, self._checks_at_once):
                self._check(raw, now_s, admitted)
        return admitted

    def _refused(self, raw: RawFrame, now_s: float) -> str | None:
        """Return the reason why a frame is refused before the costly check, None if it is not."""
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
        """Return the reason why a frame's MAVLink signature is refused, None if it is accepted."""
        if self.trust.public_key is None:
            return verifier.check(raw, now_s, silent=self._order.silent(now_s))
        if verifier.holds(raw):
            return None
        return WRONG_HASH if raw.is_signed else UNSIGNED

    def _stale(self, raw: RawFrame, now_s: float) -> str | None:
        """Return the reason why a frame's stamp is refused, None if it is accepted."""
        stamp = raw.stamp
        if self.trust.clock_checked:
            reason = off_the_clock(stamp, now_s, self.trust.ahead_s, self.trust.max_age_s)
            if reason is not None:
                return reason
        reason = self._order.refusal(stamp, now_s)
        if reason is not None or not self._order.is_newest(stamp):
            return reason
        if signed_part(raw) in self._heard:
            return REPEATED
        return TOO_MANY_FRAMES if self.trust.keyed and len(self._heard) >= REMEMBERED_FRAMES else None

    def _note_off_the_clock(self, raw: RawFrame, now_s: float) -> None:
        """Note how late a frame is that is refused by the clock; whether it is authentic is checked once a second."""
        late_s, trust = now_s - raw.stamp.unix_s, self.trust
        if trust.public_key is None:
            (self.lateness.refused if trust.keyed else self.lateness.other).note(late_s, now_s)
        elif self.lateness.may_check(now_s):
            is_genuine = verify(raw, trust.public_key)
            (self.lateness.refused if is_genuine else self.lateness.other).note(late_s, now_s)

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
        """Decode an authentic frame; if it is valid, remember it and append it to `admitted`."""
        try:
            frame = decode_frame(raw)
        except WireError as error:
            reason = str(error)
            known = reason in self._rejected or len(self._rejected) < MAX_REASONS
            self._rejected[reason if known else OTHER_REASONS] += 1
            return
        self.accepted += 1
        self.newest, stamp = raw, raw.stamp
        self.lateness.accepted.note(now_s - stamp.unix_s, now_s)
        if not self._order.is_newest(stamp):
            self._heard.clear()
        self._order.note(stamp, now_s)
        self._heard[signed_part(raw)] = None
        if len(self._heard) > REMEMBERED_FRAMES:
            del self._heard[next(iter(self._heard))]
        if self._verifier is not None and self.trust.public_key is None:
            self._verifier.commit(raw)
        admitted.append(Authenticated(raw, frame))


class Latenesses:
    """How late frames came by the vehicle's clock: those proven to be the ground station's, and all others apart."""

    def __init__(self) -> None:
        self.accepted = Lateness()
        """Of frames accepted."""
        self.refused = Lateness()
        """Of frames that are the ground station's and refused by the clock alone."""
        self.other = Lateness()
        """Of frames refused by the clock that anybody may have made."""
        self._checked_s = -math.inf

    def may_check(self, now_s: float) -> bool:
        """Return whether another frame refused by the clock gets the costly check: one in LATENESS_CHECK_S does."""
        if 0.0 <= now_s - self._checked_s < LATENESS_CHECK_S:
            return False
        self._checked_s = now_s
        return True


def _order_rules(trust: Trust) -> Rules:
    return Rules(trust.keyed, trust.public_key is not None, trust.clock_checked, trust.ahead_s)


def _kept_of(state: AuthenticatorState) -> Kept:
    newest = None if state.epoch_s is None else (state.epoch_s, state.sequence)
    return Kept(newest, state.newest_unix_s, state.spans, state.is_open)
