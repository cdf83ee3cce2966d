"""Hostile traffic of every kind with genuine frames in between, as the CI test and the long benchmark send it.

The forger has received everything that was on the air. It has none of the keys, except where a kind of datagram says
otherwise: a captured vehicle holds the shared MAVLink key, and a faulty ground station signs nonsense with the right
keys.
"""

from __future__ import annotations

import random
import struct
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from companion.files.mavlink_layout import HEADER_V2_BYTES, MARKER_V2
from companion.protocol.authenticator import Authenticator, Trust
from companion.protocol.codec import (
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    AgentEntry,
    AgentMotion,
    Directive,
    FrameWriter,
    MotionFrame,
    Stamp,
    StateFrame,
    TargetEntry,
    ThreatEntry,
)
from companion.protocol.deframer import crc_of
from companion.protocol.dialect import oneway
from companion.protocol.ed25519 import FrameSigner
from companion.protocol.frame import ED25519_BYTES, raw_frame
from companion.protocol.mavlink_signing import MavlinkSigner, strip_signature

START_S = 1_800_000_000.0
STEP_S = 0.001
"""Time from one datagram to the next; short, but long enough that the rate of datagrams that need an Ed25519 check
stays below its bound."""
GENUINE_EVERY = 100
"""Of this many datagrams one is a genuine frame."""
LATE_EVERY = 20
"""Of this many genuine frames one is held back until the next one was sent."""
TWICE_EVERY = 20
"""Of this many genuine frames one is sent a second time at once."""
RECENT = 64
"""Number of the newest genuine frames from which the forger makes its own."""
ARCHIVE = 512
"""Number of old genuine frames that the forger keeps to replay them."""
AUTHENTICATIONS = ("mavlink", "ed25519", "both")
"""Kinds of trust that keep forgers out; the fourth, "unsigned", does not."""

_STAMP = struct.Struct("<III")


class Ground:
    """A ground station that signs its broadcasts, and with the right keys also what a faulty one might send."""

    def __init__(self, authentication: str, rng: random.Random, epoch_s: int = int(START_S)) -> None:
        self._epoch_s = epoch_s
        self.mavlink_key = rng.randbytes(32)
        self.private_key = Ed25519PrivateKey.from_private_bytes(rng.randbytes(32))
        self.has_mavlink = authentication in ("mavlink", "both")
        self.has_ed25519 = authentication in ("ed25519", "both")
        self.frame_signer = self.sealer_with(self.private_key, self.mavlink_key)
        self.trust = Trust(
            mavlink_key=self.mavlink_key if self.has_mavlink else None,
            public_key=self.private_key.public_key() if self.has_ed25519 else None,
        )
        self._writer = FrameWriter()
        self._sequence = 0

    def sealer_with(self, private_key: Ed25519PrivateKey, mavlink_key: bytes) -> FrameSigner:
        """Return a frame signer with the same kinds of signature and other keys."""
        return FrameSigner(
            private_key if self.has_ed25519 else None, MavlinkSigner(mavlink_key, 0) if self.has_mavlink else None
        )

    def unsealed(self, now_s: float, sequence: int | None = None) -> bytes:
        """Return the next broadcast frame, or that of a sequence, unsigned; every fourth is a motion frame."""
        if sequence is None:
            self._sequence += 1
            sequence = self._sequence
        stamp = Stamp(self._epoch_s, round((now_s - self._epoch_s) * 1000), sequence)
        place_m = float(sequence % 1000)
        if sequence % 4 == 0:
            return self._writer.encode(MotionFrame(stamp, (AgentMotion(1, 0.5, 20.0, 1.0),), (), ()))
        return self._writer.encode(
            StateFrame(
                stamp,
                47.0,
                8.0,
                Directive.NORMAL,
                revision=1,
                picture_threats=1,
                picture_targets=1,
                resolution_cm=16,
                agents=(AgentEntry(1, place_m, -place_m, 1),),
                targets=(TargetEntry(1, 5000.0, 100.0),),
                threats=(ThreatEntry(1, 2000.0, 0.0, 1000.0, 500.0, 10.0),),
            )
        )

    def frame(self, now_s: float) -> bytes:
        """Return the next genuine frame, signed and ready to be sent."""
        return self.frame_signer.sign(self.unsealed(now_s), now_s)


class Forger:
    """Makes hostile datagrams of every kind."""

    def __init__(self, ground: Ground, rng: random.Random) -> None:
        self._ground = ground
        self._rng = rng
        self._recent: deque[bytes] = deque(maxlen=RECENT)
        self._archive: list[bytes] = []
        self._stranger = Ed25519PrivateKey.from_private_bytes(rng.randbytes(32))
        self._right = ground.sealer_with(ground.private_key, ground.mavlink_key)
        self._wrong = ground.sealer_with(self._stranger, rng.randbytes(32))
        self._captured = MavlinkSigner(ground.mavlink_key, 0) if ground.has_mavlink else None
        self._kinds: dict[str, tuple[int, Callable[[float], bytes]]] = {
            # Weights: the kinds that cost an Ed25519 check stay below a tenth of the total.
            "random bytes": (12, lambda now_s: rng.randbytes(rng.randrange(1, 300))),
            "random payload, right CRC": (10, self._framed_noise),
            "mutated": (18, self._mutated),
            "truncated": (10, self._truncated),
            "mutated, CRC repaired": (3, self._repaired),
            "unsigned": (8, self._unsigned),
            "wrong key": (2, self._wrong_key),
            "captured MAVLink key": (2, self._captured_key),
            "replayed": (12, lambda now_s: rng.choice(self._archive)),
            "future-dated": (1, self._future),
            "unknown id": (7, self._unknown_id),
            "out of range": (1, self._out_of_range),
            "NaN": (1, self._nan),
            "MAVLink 1": (5, self._mavlink_1),
            "other sender": (1, self._other_sender),
            "junk behind a copy": (3, lambda now_s: rng.choice(self._recent) + rng.randbytes(rng.randrange(1, 40))),
            "false start before a copy": (3, lambda now_s: b"\xfd\xff\x01" + rng.choice(self._recent)),
            "too large": (1, lambda now_s: bytes((MARKER_V2,)) * 2100),
        }
        self.kinds = tuple(self._kinds)
        self._weights = [weight for weight, _ in self._kinds.values()]

    def hear(self, raw: bytes) -> None:
        """Remember a genuine frame that was on the air."""
        self._recent.append(raw)
        if len(self._archive) < ARCHIVE:
            self._archive.append(raw)
        else:
            self._archive[self._rng.randrange(ARCHIVE)] = raw

    def kinds_of(self, count: int) -> list[str]:
        """Return `count` kinds at random, by their weights."""
        return self._rng.choices(self.kinds, self._weights, k=count)

    def datagram(self, kind: str, now_s: float) -> bytes:
        """Return a hostile datagram of a kind."""
        return self._kinds[kind][1](now_s)

    def _bumped(self, now_s: float) -> bytes:
        """Return a recent frame with a newer stamp, without MAVLink signature and with a right CRC."""
        raw = bytearray(strip_signature(raw_frame(self._rng.choice(self._recent))))
        epoch_s, _, sequence = _STAMP.unpack_from(raw, HEADER_V2_BYTES)
        newer = sequence + self._rng.randrange(1, 1 << 20)
        _STAMP.pack_into(raw, HEADER_V2_BYTES, epoch_s, round((now_s - epoch_s) * 1000), newer)
        return _with_crc(raw)

    def _framed_noise(self, now_s: float) -> bytes:
        number = self._rng.choice(tuple(oneway.mavlink_map))
        return _frame(number, self._rng.randbytes(self._rng.randrange(1, 256)))

    def _mutated(self, now_s: float) -> bytes:
        raw = bytearray(self._rng.choice(self._recent))
        for _ in range(self._rng.randrange(1, 5)):
            raw[self._rng.randrange(len(raw))] ^= self._rng.randrange(1, 256)
        return bytes(raw)

    def _truncated(self, now_s: float) -> bytes:
        raw = self._rng.choice(self._recent)
        return raw[: self._rng.randrange(1, len(raw))]

    def _repaired(self, now_s: float) -> bytes:
        raw = bytearray(self._rng.choice(self._recent))
        end = HEADER_V2_BYTES + raw[1]
        for _ in range(self._rng.randrange(1, 4)):
            # The id stays ours: any other is "unknown id".
            raw[self._rng.choice((4, 5, 6, *range(HEADER_V2_BYTES, end)))] ^= self._rng.randrange(1, 256)
        raw[end : end + 2] = crc_of(bytes(raw[:end]), raw_frame(bytes(raw)).message_id)
        return bytes(raw)

    def _unsigned(self, now_s: float) -> bytes:
        raw = self._bumped(now_s)
        return _with_crc(bytearray(raw[: HEADER_V2_BYTES + raw_frame(raw).content_length] + b"\0\0"))

    def _wrong_key(self, now_s: float) -> bytes:
        return self._wrong.sign(self._unsigned(now_s), now_s)

    def _captured_key(self, now_s: float) -> bytes:
        """Return a frame that somebody who holds a captured vehicle's keys can make.

        Without Ed25519 such a frame would be genuine, and one with the wrong key is returned instead.
        """
        if not self._ground.has_ed25519:
            return self._wrong_key(now_s)
        raw = forged_seal(self._bumped(now_s), self._rng.randbytes(ED25519_BYTES))
        return raw if self._captured is None else self._captured.sign(raw, now_s)

    def _future(self, now_s: float) -> bytes:
        ahead_s = self._rng.uniform(10.0, 1e6)
        if self._captured is not None and self._rng.random() < 0.5:
            # The MAVLink time alone, where it counts; under Ed25519 the frame is a copy and its time says nothing.
            return self._right_now(strip_signature(raw_frame(self._rng.choice(self._recent))), now_s + ahead_s)
        return self._right.sign(self._ground.unsealed(now_s + ahead_s, self._rng.randrange(1 << 32)), now_s)

    def _right_now(self, raw: bytes, now_s: float) -> bytes:
        return MavlinkSigner(self._ground.mavlink_key, 0).sign(raw, now_s)

    def _unknown_id(self, now_s: float) -> bytes:
        raw = bytearray(self._rng.choice(self._recent))
        raw[7:HEADER_V2_BYTES] = self._rng.choice((0xF8, 0x1E, 0xA001FF, 0xFFFFFF)).to_bytes(3, "little")
        return bytes(raw)

    def _out_of_range(self, now_s: float) -> bytes:
        """Return a frame signed with the right keys whose fields no sound ground station would send."""
        number, nonsense = self._rng.choice(NONSENSE)
        payload = bytearray(nonsense)
        epoch_s = int(START_S)
        _STAMP.pack_into(payload, 0, epoch_s, round((now_s - epoch_s) * 1000), self._rng.randrange(1 << 31, 1 << 32))
        return self._right.sign(_frame(number, bytes(payload)), now_s)

    def _nan(self, now_s: float) -> bytes:
        """Return NaN as the payload of a message that has floats, or of one that has none."""
        nan = struct.pack("<f", float("nan"))
        number = self._rng.choice((oneway.MAVLINK_MSG_ID_ONEWAY_DECISION, oneway.MAVLINK_MSG_ID_ONEWAY_FLEET))
        raw = _frame(number, nan * self._rng.randrange(1, 16))
        return raw if self._captured is None else self._captured.sign(raw, now_s)

    def _mavlink_1(self, now_s: float) -> bytes:
        payload = self._rng.randbytes(9)
        body = bytes((9, self._rng.randrange(256), GROUND_SYSTEM, GROUND_COMPONENT, 0)) + payload
        crc = oneway.x25crc(body + bytes((oneway.MAVLink_heartbeat_message.crc_extra,))).crc
        return b"\xfe" + body + int(crc).to_bytes(2, "little")

    def _other_sender(self, now_s: float) -> bytes:
        raw = bytearray(self._unsigned(now_s))
        raw[5] = 1 + self._rng.randrange(100)
        return self._right.sign(_with_crc(raw), now_s)


@dataclass
class Outcome:
    """The counts of a run."""

    sent: Counter[str] = field(default_factory=Counter)
    """Hostile datagrams sent, by kind."""
    genuine: int = 0
    """Genuine frames sent in their order; a second copy is not counted."""
    accepted: int = 0
    """Genuine frames that were accepted."""
    forged: int = 0
    """Accepted frames that were not genuine; must be 0."""
    late: int = 0
    """Genuine frames held back until a newer one was sent; each must be refused."""
    twice: int = 0
    """Genuine frames sent a second time at once; each copy must be refused."""
    rejected: Counter[str] = field(default_factory=Counter)
    """Refused datagrams by reason, filled in at the end of the run."""


def run(count: int, authentication: str, seed: int, *, is_stream: bool = False) -> Iterator[Outcome]:
    """Send `count` datagrams to an authenticator; yield the same outcome after every thousandth and at the end."""
    rng = random.Random(seed)
    ground = Ground(authentication, rng)
    authenticator = Authenticator(ground.trust, is_stream=is_stream, rng=random.Random(seed))
    forger = Forger(ground, rng)
    outcome = Outcome()
    pending: deque[bytes] = deque()
    held: bytes | None = None
    kinds: list[str] = []

    def deliver(datagram: bytes, now_s: float) -> None:
        for raw, _ in authenticator.admit(datagram, now_s):
            if pending and raw.data == pending[0]:
                pending.popleft()
                outcome.accepted += 1
            else:
                outcome.forged += 1

    for step in range(count):
        now_s = START_S + 1.0 + step * STEP_S
        if step % GENUINE_EVERY == 0:
            raw = ground.frame(now_s)
            number = step // GENUINE_EVERY
            if number % LATE_EVERY == LATE_EVERY // 2:
                held = raw
                continue
            outcome.genuine += 1
            pending.append(raw)
            deliver(raw, now_s)
            forger.hear(raw)
            if number % TWICE_EVERY == 0:
                outcome.twice += 1
                deliver(raw, now_s)
            if held is not None:
                outcome.late += 1
                deliver(held, now_s)
                held = None
            continue
        if not outcome.genuine:
            continue
        kinds = kinds or forger.kinds_of(1000)
        kind = kinds.pop()
        outcome.sent[kind] += 1
        deliver(forger.datagram(kind, now_s), now_s)
        if step % 1000 == 999:
            yield outcome
    deliver(b"", START_S + 2.0 + count * STEP_S)
    outcome.rejected = authenticator.rejected
    yield outcome


def forged_seal(raw: bytes, signature: bytes) -> bytes:
    """Return an unsigned broadcast frame with the given bytes in place of its Ed25519 signature."""
    content = raw[HEADER_V2_BYTES:-2][: raw_frame(raw).content_length].ljust(raw_frame(raw).content_length, b"\0")
    return _frame(raw_frame(bytes(raw)).message_id, content + signature, raw[5], raw[6])


def _frame(number: int, payload: bytes, system: int = GROUND_SYSTEM, component: int = GROUND_COMPONENT) -> bytes:
    payload = payload[:1] + payload[1:].rstrip(b"\0")
    head = bytes((MARKER_V2, len(payload), 0, 0, 0, system, component)) + number.to_bytes(3, "little")
    return head + payload + crc_of(head + payload, number)


def _with_crc(raw: bytearray) -> bytes:
    """Return an unsigned frame with right length and CRC; the last two bytes given stand in for the CRC."""
    return _frame(raw_frame(bytes(raw)).message_id, bytes(raw[HEADER_V2_BYTES:-2]), raw[5], raw[6])


_STATE_NONSENSE: tuple[dict[str, object], ...] = (
    {"resolution": 0},
    {"directive": 9},
    {"agent_count": 255},
    {"target_count": 6},
    {"threat_count": 5},
    {"frame_count": 0},
    {"frame_index": 7},
    {"origin_lat": 900_000_001},
    {"origin_lon": -1_800_000_001},
    {"threat_attack": [0] * 4},
    {"threat_attack": [65_535] * 4},
    {"agent_target": [9] * 10},
    {"agent_target": [0xC0] * 10},
    {"agent_north": [-32_768] * 10},
    {"agent_count": 2},
    {"threat_id_base": 65_535, "threat_id": [255] * 4},
)
_MOTION_NONSENSE: tuple[dict[str, object], ...] = (
    {"agent_heading": [36_000] * 10},
    {"agent_heading": [65_534] * 10},
    {"agent_count": 11},
    {"frame_index": 1},
)
_FLEET_HEAD = struct.pack("<hhHBBBB", 0, 0, 100, 1, 0, 0, 1)
_FLEET_NONSENSE = (
    struct.pack("<hhHBBBB", 0, 0, 0, 1, 0, 0, 1) + b"\0",
    struct.pack("<hhHBBBB", 0, 0, 100, 1, 9, 0, 1) + b"\0",
    struct.pack("<hhHBBBB", 0, 0, 100, 1, 0, 1, 1) + b"\0",
    _FLEET_HEAD + b"\x01\xff",
    _FLEET_HEAD + b"\x04\xff\xff\xff\xff",
    _FLEET_HEAD + b"\xa0",
    struct.pack("<hhHBBBB", 0, 0, 100, 1, 0, 0, 1) + b"\x05\x07\x01\x01\x00\x02",
)
"""Payloads behind the stamp: resolution 0, an unknown directive, frame 1 of 1 counted from 0, sections that are cut
short or unknown, and a directive for an agent that is not there."""


def _nonsense() -> tuple[tuple[int, bytes], ...]:
    """Return message ids and payloads that no sound ground station would send; their stamps are still to be set."""
    ground = Ground("unsigned", random.Random(0))
    states = ((ground.unsealed(START_S, 1), changes) for changes in _STATE_NONSENSE)
    motions = ((ground.unsealed(START_S, 4), changes) for changes in _MOTION_NONSENSE)
    found = []
    for raw, changes in (*states, *motions):
        (message,) = oneway.MAVLink(None).parse_buffer(raw)
        for name, value in changes.items():
            setattr(message, name, value)
        packed = bytes(message.pack(oneway.MAVLink(None)))
        found.append((raw_frame(bytes(packed)).message_id, packed[HEADER_V2_BYTES:-2]))
    fleets = ((oneway.MAVLINK_MSG_ID_ONEWAY_FLEET, bytes(_STAMP.size) + rest) for rest in _FLEET_NONSENSE)
    return (*found, *fleets)


NONSENSE = _nonsense()
