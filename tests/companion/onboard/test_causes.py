"""Every known cause of a broadcast that is not believed is told in words with its number, and the words do not flap."""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.onboard.broadcast_causes import CauseWatch
from companion.onboard.causes import END_S, Cause, Causes, followed, news
from companion.onboard.world_model import WorldModel
from companion.protocol.authenticator import Authenticator, Trust
from companion.protocol.codec import AgentEntry, Directive, FrameWriter, Stamp, StateFrame
from companion.protocol.deframer import crc_of
from companion.protocol.frame import crc_bytes, raw_frame
from companion.protocol.link_quality import LinkMonitor
from companion.protocol.mavlink_signing import MavlinkSigner
from companion.protocol.other_dialect import other_dialect
from companion.transport import silence
from companion.transport.link import parse_link
from companion.transport.silence import why_silent
from tests.companion.protocol.hostile import AUTHENTICATIONS, START_S, Ground

EPOCH_S = int(START_S)
ME = 7
KEYS = Ground("both", random.Random(21))
OTHERS = Ground("both", random.Random(22))
LINK = parse_link("udpin:127.0.0.1:14600")


def trust_of(word: str) -> Trust:
    return Trust(
        KEYS.mavlink_key if word in ("mavlink", "both") else None,
        KEYS.private_key.public_key() if word in ("ed25519", "both") else None,
    )


def frame(number: int, at_s: float, *, epoch_s: int = EPOCH_S, agents: tuple[int, ...] = (1, ME)) -> bytes:
    stamp = Stamp(epoch_s, round((at_s - epoch_s) * 1000), number)
    entries = tuple(AgentEntry(identity, 0.0, 0.0, None) for identity in agents)
    return FrameWriter().encode(StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, entries, (), ()))


def signed(word: str, raw: bytes, at_s: float, keys: Ground = KEYS) -> bytes:
    ground = Ground(word, random.Random(0))
    return ground.sealer_with(keys.private_key, keys.mavlink_key).sign(raw, at_s)


class Listener:
    """A vehicle's gate, picture and watch, that hears a datagram each second."""

    def __init__(self, word: str, coasting_after_s: float = 15.0) -> None:
        self.gate = Authenticator(trust_of(word), rng=random.Random(1))
        self.world = WorldModel(ME)
        self.quality = LinkMonitor()
        self.watch = CauseWatch(self.gate, LINK, coasting_after_s)
        self.now_s = START_S
        self.lines: list[str] = []

    def hears(self, datagram_at: Callable[[float, int], bytes], seconds: int = 15) -> list[str]:
        """Hear for some seconds what `datagram_at` makes of the time and a number; return the new lines."""
        self.lines = []
        for _ in range(seconds):
            self.now_s += 1.0
            for _, each in self.gate.admit(datagram_at(self.now_s, round(self.now_s - START_S)), self.now_s):
                self.quality.note(each, self.now_s)
                self.world.take(each, self.now_s)
            self.lines += self.watch.news(self.world, self.quality, self.now_s)
        return self.lines


def only_line(lines: list[str]) -> str:
    (line,) = lines
    assert line.startswith("warning: ")
    return line.removeprefix("warning: ")


@pytest.mark.parametrize("word", AUTHENTICATIONS)
@pytest.mark.parametrize(
    ("off_s", "words"),
    [
        (18.0, "clocks differ by 18.0 s: this computer is behind the ground station (GPS time is 18 s ahead of UTC"),
        (-18.0, "clocks differ by 18.0 s: this computer is ahead of the ground station (GPS time"),
        (-100.0, "clocks differ by 100.0 s: this computer is ahead of the ground station, or a recording is played"),
        (7200.0, "clocks differ by 2.0 h: this computer is behind the ground station (whole hours: local time"),
        (1.2, "clocks differ by 1.2 s: this computer is behind"),
        (4e8, "clocks differ by 4629.6 days: this computer is behind the ground station (a clock that was never"),
    ],
)
def test_clocks_that_differ_are_told_with_by_how_much(word: str, off_s: float, words: str) -> None:
    vehicle = Listener(word)
    epoch_s = EPOCH_S + min(0, int(off_s)) - 1 + max(0, int(off_s) - 100)
    told = only_line(
        vehicle.hears(lambda now_s, n: signed(word, frame(n, now_s + off_s, epoch_s=epoch_s), now_s + off_s))
    )
    assert told.startswith(words)
    assert told.endswith("set the clocks of both from GNSS or NTP")
    stopping = vehicle.watch.stopping
    assert (stopping is None) == (vehicle.gate.accepted > 0)


def test_a_clock_is_not_called_wrong_by_frames_that_anybody_may_have_made() -> None:
    vehicle = Listener("ed25519")
    told = only_line(vehicle.hears(lambda now_s, n: signed("ed25519", frame(n, now_s + 50.0), now_s, OTHERS)))
    assert told.startswith("clocks may differ by 50.0 s: this computer is behind, by 4 frames that nobody has signed")


def test_a_forger_does_not_change_what_is_told_of_the_clocks() -> None:
    vehicle = Listener("ed25519")
    flood = [signed("ed25519", frame(90, START_S + 1e6), START_S, OTHERS)] * 3

    def both(now_s: float, n: int) -> bytes:
        genuine = signed("ed25519", frame(n, now_s - 40.0, epoch_s=EPOCH_S - 60), now_s)
        return b"".join((genuine, *flood) if n % 2 else (*flood, genuine))

    assert only_line(vehicle.hears(both)).startswith("clocks differ by 40.0 s: this computer is ahead")


@pytest.mark.parametrize(
    ("word", "made", "words"),
    [
        ("mavlink", lambda raw, now_s: raw, "frames without MAVLink signature in 10 s, trust is MAVLink signing"),
        ("both", lambda raw, now_s: raw, "frames without MAVLink signature in 10 s, trust is MAVLink signing and Ed"),
        ("ed25519", lambda raw, now_s: raw, "frames without Ed25519 signature in 10 s, trust is Ed25519"),
        ("both", lambda raw, now_s: signed("mavlink", raw, now_s), "frames without Ed25519 signature"),
        ("both", lambda raw, now_s: signed("both", raw, now_s, OTHERS), "with another MAVLink key than"),
        ("mavlink", lambda raw, now_s: signed("mavlink", raw, now_s, OTHERS), "with another MAVLink key than"),
        ("ed25519", lambda raw, now_s: signed("ed25519", raw, now_s, OTHERS), "of another private key than"),
    ],
)
def test_keys_and_signatures_that_do_not_fit_are_told(
    word: str, made: Callable[[bytes, float], bytes], words: str
) -> None:
    vehicle = Listener(word)
    told = only_line(vehicle.hears(lambda now_s, n: made(frame(n, now_s), now_s)))
    assert words in told
    assert told[0].isdigit() or told.startswith("wrong key: ")
    assert vehicle.watch.stopping is not None


@pytest.mark.parametrize(("word", "names"), [("mavlink", "MAVLink signing"), ("both", "MAVLink signing and Ed25519")])
def test_a_signature_that_is_not_asked_for_is_told_and_stops_nothing(word: str, names: str) -> None:
    vehicle = Listener("unsigned")
    told = only_line(vehicle.hears(lambda now_s, n: signed(word, frame(n, now_s), now_s)))
    assert told.startswith(f"the broadcast is signed ({names}), broadcast.trust is unsigned: anybody is believed")
    assert vehicle.watch.stopping is None


def test_an_agent_that_the_broadcast_does_not_tell_of_is_told() -> None:
    vehicle = Listener("unsigned")
    told = only_line(vehicle.hears(lambda now_s, n: frame(n, now_s, agents=(1, 2, 3))))
    assert told.startswith("agent 7 is not in the broadcast, which tells of 1, 2, 3: set agent_id")


def test_a_broadcast_that_comes_less_often_than_the_vehicle_waits_is_told() -> None:
    vehicle = Listener("unsigned", coasting_after_s=3.0)
    told = only_line(vehicle.hears(lambda now_s, n: frame(n // 4, now_s) if n % 4 == 0 else b"", 60))
    assert told.startswith("the broadcast comes every 4.0 s, staleness.coasting_after_s is 3 s: raise")


def test_two_ground_stations_are_told_with_how_much_is_heard_of_the_other() -> None:
    vehicle = Listener("both")

    def two(now_s: float, n: int) -> bytes:
        older = signed("both", frame(500 + n, now_s, epoch_s=EPOCH_S - 100), now_s)
        return older + signed("both", frame(n, now_s), now_s)

    told = only_line(vehicle.hears(two))
    assert told.startswith("two ground stations: ") and "frames of an older run in 10 s beside the one believed" in told


def test_an_old_dialect_is_told_by_its_crc_extra() -> None:
    def older(now_s: float, n: int) -> bytes:
        raw = frame(n, now_s)
        return raw[:-2] + _crc(raw[:-2], 17)

    told = only_line(Listener("unsigned").hears(older))
    assert "frames of another release's dialect: ONEWAY_STATE with CRC_EXTRA 17, here " in told
    assert "install the same release" in told


def test_damage_by_chance_is_no_other_dialect() -> None:
    rng = random.Random(5)

    def damaged(now_s: float, n: int) -> bytes:
        raw = bytearray(frame(n, now_s))
        raw[rng.randrange(12, len(raw))] ^= 1 + rng.randrange(255)
        return bytes(raw)

    told = only_line(Listener("unsigned").hears(damaged, 40))
    assert told.startswith("4 runs of damaged bytes in 10 s and no whole frame: look at the radio")


def test_where_nothing_arrives_it_is_told_after_a_while_and_what_this_computer_has() -> None:
    vehicle = Listener("both")
    assert vehicle.hears(lambda now_s, n: b"", 10) == []
    told = only_line(vehicle.hears(lambda now_s, n: b"", 5))
    assert told.startswith("nothing arrives on udpin:127.0.0.1:14600: this computer has ")


def test_frames_that_come_and_are_all_refused_are_never_told_as_nothing_that_arrives() -> None:
    vehicle = Listener("mavlink")
    first = signed("mavlink", frame(1, START_S + 20.0), START_S + 20.0)
    vehicle.hears(lambda now_s, n: signed("mavlink", frame(n, now_s), now_s), 25)
    told = only_line(vehicle.hears(lambda now_s, n: first, 25))
    assert told.startswith("all that comes is refused, most for 'MAVLink time not newer': ")


def test_a_stranger_on_the_port_is_told_as_what_it_is() -> None:
    autopilot = bytes.fromhex("fe09000101000000000002030d030c9c")
    told = only_line(Listener("both").hears(lambda now_s, n: autopilot))
    assert "MAVLink" in told and "look at" in told


def test_a_cause_that_is_gone_is_said_to_be_over() -> None:
    vehicle = Listener("both")
    vehicle.hears(lambda now_s, n: frame(n, now_s))
    lines = vehicle.hears(lambda now_s, n: signed("both", frame(n, now_s), now_s), 30)
    assert len(lines) == 1 and lines[0].startswith("over: ")
    assert vehicle.watch.causes == ()


def test_a_cause_for_which_nothing_was_believed_is_over_with_the_first_frame_that_is() -> None:
    vehicle = Listener("both")
    vehicle.hears(lambda _now_s, _n: b"", 20)
    assert vehicle.watch.stopping is not None
    assert vehicle.hears(lambda now_s, n: signed("both", frame(n, now_s), now_s), 1)[0].startswith("over: ")
    assert vehicle.watch.stopping is None


def _always(datagram: bytes, _now_s: float, _number: int) -> bytes:
    return datagram


@given(st.lists(st.sampled_from(["nothing", "late", "right"]), min_size=1, max_size=60))
@settings(max_examples=15, deadline=None)
def test_no_cause_for_which_nothing_is_believed_is_told_while_frames_are_believed(kinds: list[str]) -> None:
    vehicle = Listener("none")
    vehicle.now_s += 60.0
    for kind in (each for each in kinds for _ in range(5)):
        before, at_s = vehicle.gate.accepted, vehicle.now_s + 1.0 - (40.0 if kind == "late" else 0.0)
        datagram = b"" if kind == "nothing" else frame(round(vehicle.now_s - START_S), at_s)
        vehicle.hears(partial(_always, datagram), 1)
        assert vehicle.gate.accepted == before or vehicle.watch.stopping is None


@given(st.lists(st.tuples(st.booleans(), st.floats(0.99, 1.01)), min_size=1, max_size=60))
def test_words_neither_flicker_nor_follow_every_figure(looks: list[tuple[bool, float]]) -> None:
    causes: Causes = ()
    lines: list[str] = []
    for at_s, (is_seen, share) in enumerate(looks):
        seen = [Cause("clocks", 18.0 * share, f"by {18.0 * share}", "set it")] if is_seen else []
        before, causes = causes, followed(causes, seen, float(at_s))
        lines += news(before, causes)
    assert len(lines) <= 1 + 2 * len(looks) // END_S


def test_a_cause_is_over_only_when_it_has_not_been_seen_for_a_while() -> None:
    cause = Cause("clocks", 18.0, "by 18", "set it")
    causes: Causes = ()
    for at_s in range(6):
        causes = followed(causes, [cause], float(at_s))
    assert news(causes, followed(causes, [], 5.0 + END_S - 0.1)) == []
    assert news(causes, followed(causes, [], 5.0 + END_S)) == ["over: by 18"]


def test_a_number_that_changes_much_is_told_anew() -> None:
    first, second = Cause("clocks", 18.0, "by 18", "set it"), Cause("clocks", 90.0, "by 90", "set it")
    before: Causes = ()
    for at_s in range(6):
        before = followed(before, [first], float(at_s))
    after = followed(before, [second], 6.0)
    assert news(before, after) == ["warning: by 90: set it"]


# What this computer shows


def test_a_group_is_told_with_where_it_is_joined(tmp_path: Path) -> None:
    table = tmp_path / "igmp"
    table.write_text("Idx\tDevice    : Count Querier\n1\tlo        :     1      V3\n\t\t\t\t329110EF     1 0:0\t\t0\n")
    assert silence._joined("239.16.145.50", table) == "joined on lo (127.0.0.1)"
    assert silence._joined("239.16.145.51", table) == "joined on no interface"
    assert silence._joined("239.16.145.51", tmp_path / "none") == "joined on no interface"


@pytest.mark.parametrize(
    "link", ["mcast:239.255.1.2:14600", "udpbcast:255.255.255.255:14600", "serial:/dev/ttyX:57600", "file:a.tlog"]
)
def test_every_kind_of_link_has_words_for_silence(link: str) -> None:
    assert all(why_silent(parse_link(link)))


def _crc(body: bytes, extra: int) -> bytes:

    return crc_bytes(body, bytes((extra,)))


@given(st.integers(0, 255))
def test_any_other_crc_extra_is_recognised_and_ours_is_none(extra: int) -> None:
    raw = frame(1, START_S)
    ours = raw_frame(raw)
    found = other_dialect(b"\xfd\x00" + raw[:-2] + _crc(raw[:-2], extra))
    is_ours = _crc(raw[:-2], extra) == crc_of(raw[:-2], ours.message_id)
    assert (found is None) if is_ours else (found is not None and found.heard == extra)


def test_a_signed_frame_of_another_release_is_recognised() -> None:
    raw = frame(1, START_S)
    signed_raw = MavlinkSigner(bytes(32), 0).sign(raw, START_S)
    at = raw_frame(signed_raw).crc_at
    other = signed_raw[:at] + _crc(signed_raw[:at], 9) + signed_raw[at + 2 :]
    found = other_dialect(other)
    assert found is not None and found.heard == 9
