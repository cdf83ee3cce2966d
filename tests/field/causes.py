"""Situations in which the broadcast is not believed, or less than it should be: the cause is said, with its number."""

from __future__ import annotations

import random
from collections.abc import Callable

from companion.onboard.broadcast_monitor import BroadcastMonitor
from companion.onboard.companion import Companion
from companion.onboard.config import parse_config
from companion.protocol.authenticator import Authenticator, Trust
from companion.protocol.codec import AgentEntry, Directive, FrameWriter, Stamp, StateFrame
from companion.protocol.frame import crc_bytes
from tests.companion.protocol.hostile import START_S, Ground
from tests.field.situation import Situation

EPOCH_S = int(START_S) - 200_000
"""Before any of the stamps, so that a clock may be behind by days."""
LISTENS_S = 16
CONFIG = parse_config(
    "agent_id: 7\nautopilot: {kind: arducopter, link: 'udpin:127.0.0.1:14550'}\n"
    "broadcast: {link: 'mcast:239.255.145.50:14600@127.0.0.1', trust: unsigned}\n",
    "field.yaml",
)
OURS = Ground("both", random.Random(31))
OTHERS = Ground("both", random.Random(32))


def frame(number: int, at_s: float, *, epoch_s: int = EPOCH_S, agents: tuple[int, ...] = (1, 7)) -> bytes:
    """Return one broadcast that tells of agents."""
    stamp = Stamp(epoch_s, round((at_s - epoch_s) * 1000), number)
    entries = tuple(AgentEntry(identity, 0.0, 0.0, None) for identity in agents)
    return FrameWriter().encode(StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, entries, (), ()))


def signed(word: str, raw: bytes, at_s: float, keys: Ground = OURS) -> bytes:
    """Return a broadcast, signed."""
    return Ground(word, random.Random(0)).sealer_with(keys.private_key, keys.mavlink_key).sign(raw, at_s)


def trust_of(word: str) -> Trust:
    """Return the trust of a vehicle with the right keys."""
    return Trust(
        OURS.mavlink_key if word in ("mavlink", "both") else None,
        OURS.private_key.public_key() if word in ("ed25519", "both") else None,
    )


def said(word: str, heard: Callable[[float, int], bytes], *parts: str) -> str:
    """Return the line, said while a vehicle listens, that holds all parts; `heard` makes what it hears each second."""
    companion = Companion(CONFIG, authenticator=Authenticator(trust_of(word), rng=random.Random(1)))
    monitor = BroadcastMonitor(companion)
    lines: list[str] = []
    for second in range(1, LISTENS_S):
        now_s = START_S + second
        companion.hear(heard(now_s, second), now_s)
        lines += monitor.news(now_s)
    found = [line for line in lines if all(part in line for part in parts)]
    assert found, f"said only: {'; '.join(lines) or 'nothing'}"
    assert len(found) == 1, f"said {len(found)} times"
    return found[0].removeprefix("warning: ").partition(": set ")[0]


def _ahead(off_s: float, *parts: str) -> str:
    return said("both", lambda now_s, n: signed("both", frame(n, now_s + off_s), now_s), *parts)


def _two_stations() -> str:
    def both(now_s: float, n: int) -> bytes:
        older = signed("both", frame(900 + n, now_s, epoch_s=EPOCH_S - 1000), now_s)
        return older + signed("both", frame(n, now_s), now_s)

    return said("both", both, "two ground stations: ", "frames of an older run in 10 s")


def _old_dialect() -> str:
    def older(now_s: float, n: int) -> bytes:
        body = frame(n, now_s)[:-2]
        return body + crc_bytes(body, b"\x11")

    return said("unsigned", older, "another release's dialect: ONEWAY_STATE with CRC_EXTRA 17")


def _forger() -> str:
    flood = b"".join(signed("ed25519", frame(k, START_S + 1e6), START_S, OTHERS) for k in range(3))

    def both(now_s: float, n: int) -> bytes:
        genuine = signed("ed25519", frame(n, now_s - 40.0), now_s)
        return genuine + flood if n % 2 else flood + genuine

    return said("ed25519", both, "clocks differ by 40.0 s: this computer is ahead")


def _of(word: str, made: Callable[[bytes, float], bytes], *parts: str) -> Callable[[], str]:
    return lambda: said(word, lambda now_s, n: made(frame(n, now_s), now_s), *parts)


COUNTS_ONLY = "a count of refusals, no cause"

SITUATIONS: tuple[Situation, ...] = (
    Situation(
        "the vehicle's computer is 18 s ahead (leap seconds): every broadcast is 18 s old and coasting begins for good",
        'says "clocks differ by 18.0 s", which is ahead, and why it may be',
        '"coasting: picture late"',
        lambda: _ahead(-18.0, "clocks differ by 18.0 s: this computer is ahead", "leap seconds"),
    ),
    Situation(
        "it is 18 s behind: everything is refused as stamped in the future",
        "the same, behind",
        COUNTS_ONLY,
        lambda: _ahead(18.0, "clocks differ by 18.0 s: this computer is behind", "leap seconds"),
    ),
    Situation(
        "local time was taken for UTC: two hours",
        "says by how many hours, and that it is a time zone",
        COUNTS_ONLY,
        lambda: _ahead(7200.0, "clocks differ by 2.0 h", "local time"),
    ),
    Situation(
        "frames of another key are stamped days ahead among genuine ones that are 40 s late",
        "only frames of the right signature set the words: 40 s",
        COUNTS_ONLY,
        _forger,
    ),
    Situation(
        "the ground station signs with another MAVLink key",
        "says that the key is wrong, with the number of frames",
        COUNTS_ONLY,
        _of("both", lambda raw, now_s: signed("both", raw, now_s, OTHERS), "wrong key: ", "another MAVLink key"),
    ),
    Situation(
        "... with another private key",
        "the same of broadcast.public_key",
        COUNTS_ONLY,
        _of("ed25519", lambda raw, now_s: signed("ed25519", raw, now_s, OTHERS), "wrong key: ", "public_key"),
    ),
    Situation(
        "the ground station does not sign though the vehicle demands both signatures",
        "says so, and how many frames came",
        COUNTS_ONLY,
        _of("both", lambda raw, now_s: raw, "frames without MAVLink signature in 10 s, trust is "),
    ),
    Situation(
        "the ground station signs though the vehicle's trust is `unsigned`",
        "says that anybody is believed all the same",
        "nothing",
        _of("unsigned", lambda raw, now_s: signed("both", raw, now_s), "the broadcast is signed (MAVLink signing and"),
    ),
    Situation(
        "the ground station is of an older release with another field in ONEWAY_STATE",
        "says that old and new do not hear each other",
        '"damaged"',
        _old_dialect,
    ),
    Situation(
        "the broadcast does not tell of this vehicle's agent",
        "says so, and of whom it tells",
        "idle without a word",
        lambda: said("unsigned", lambda now_s, n: frame(n, now_s, agents=(1, 2)), "agent 7 is not", "tells of 1, 2"),
    ),
    Situation(
        "two ground stations broadcast with the same keys",
        "says so with the number of frames of the older one",
        "a question, without a number",
        _two_stations,
    ),
    Situation(
        "nothing arrives on a multicast link",
        "says so, and on which interface the group is joined",
        "nothing",
        lambda: said("both", lambda now_s, n: b"", "nothing arrives on mcast:239.255.145.50", "joined on"),
    ),
)
