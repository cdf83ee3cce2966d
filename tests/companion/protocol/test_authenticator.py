"""Authenticator: genuine, new and sane frames get in; everything else is counted and forgotten."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.errors import InputError
from companion.protocol.authenticator import (
    BURST_CHECKS,
    HEARTBEAT,
    MAX_REASONS,
    NO_ED25519,
    OTHER_SENDER,
    REMEMBERED_FRAMES,
    REPEATED,
    TOO_LARGE,
    TRAILING_BYTES,
    UNCHECKED,
    WRONG_ED25519,
    Authenticator,
    AuthenticatorState,
    Trust,
)
from companion.protocol.codec import Directive, FrameWriter, MotionFrame, Stamp, StateFrame, decode_frame
from companion.protocol.deframer import crc_of
from companion.protocol.dialect import oneway
from companion.protocol.ed25519 import FrameSigner
from companion.protocol.frame import ED25519_BYTES, raw_frame
from companion.protocol.freshness import FUTURE_STAMP, OLD_EPOCH, OLD_SEQUENCE, PAST_STAMP
from companion.protocol.mavlink_signing import (
    FUTURE_TIME,
    REPLAYED_TIME,
    UNSIGNED,
    WRONG_HASH,
    MavlinkSigner,
    strip_signature,
)
from companion.protocol.v2_extension import wrap
from companion.runtime.fair_share import WINDOW_S
from tests.companion.protocol.hostile import AUTHENTICATIONS, NONSENSE, START_S, Ground, forged_seal

KEYS = Ground("both", random.Random(11))
OTHER_KEYS = Ground("both", random.Random(12))
EPOCH_S = int(START_S)
TIME_MAX = (1 << 48) - 1


def trust_of(authentication: str) -> Trust:
    return Trust(
        KEYS.mavlink_key if authentication in ("mavlink", "both") else None,
        KEYS.private_key.public_key() if authentication in ("ed25519", "both") else None,
    )


def sealer_of(authentication: str, keys: Ground = KEYS) -> FrameSigner:
    return FrameSigner(
        keys.private_key if authentication in ("ed25519", "both") else None,
        MavlinkSigner(keys.mavlink_key, 0) if authentication in ("mavlink", "both") else None,
    )


def unsealed(sequence: int, at_s: float, *, epoch_s: int = EPOCH_S, index: int = 0, count: int = 1) -> bytes:
    stamp = Stamp(epoch_s, round((at_s - epoch_s) * 1000), sequence, index, count)
    return FrameWriter().encode(StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, (), (), ()))


class Link:
    """A ground station and a vehicle, with one strength between them."""

    def __init__(
        self, authentication: str, trust: Trust | None = None, state: AuthenticatorState | None = None
    ) -> None:
        self.frame_signer = sealer_of(authentication)
        self.authenticator = Authenticator(trust or trust_of(authentication), state, rng=random.Random(1))

    def sealed(self, sequence: int, at_s: float, *, epoch_s: int = EPOCH_S, index: int = 0, count: int = 1) -> bytes:
        return self.frame_signer.sign(unsealed(sequence, at_s, epoch_s=epoch_s, index=index, count=count), at_s)

    def hears(self, datagram: bytes, at_s: float) -> bool:
        """Return whether anything of a datagram is accepted."""
        return bool(self.authenticator.admit(datagram, at_s))

    @property
    def reason(self) -> str:
        """The one reason for which anything was refused so far."""
        (reason,) = self.authenticator.rejected
        return reason


@pytest.fixture(params=AUTHENTICATIONS)
def link(request: pytest.FixtureRequest) -> Link:
    return Link(request.param)


@pytest.mark.parametrize("authentication", [*AUTHENTICATIONS, "unsigned"])
def test_a_genuine_frame_is_admitted_as_it_came_and_decoded(authentication: str) -> None:
    link = Link(authentication)
    raw = link.sealed(1, START_S)
    assert link.authenticator.admit(raw, START_S) == [(raw_frame(raw), decode_frame(raw_frame(raw)))]
    assert link.authenticator.rejected.total() == 0


def test_the_words_for_the_status_say_what_authenticates() -> None:
    words = [trust_of(authentication).words for authentication in (*AUTHENTICATIONS, "unsigned")]
    assert words == ["MAVLink signing", "Ed25519", "MAVLink signing and Ed25519", "unsigned"]


def test_several_frames_in_one_datagram_are_all_admitted(link: Link) -> None:
    parts = [link.sealed(1, START_S, index=index, count=3) for index in range(3)]
    assert [raw.data for raw, _ in link.authenticator.admit(b"".join(parts), START_S)] == parts


@pytest.mark.parametrize("authentication", ["mavlink", "both"])
def test_the_one_forged_frame_attack_deafens_nobody(authentication: str) -> None:
    link = Link(authentication)
    raw = link.sealed(1, START_S)
    forged = raw[:-12] + (TIME_MAX - 1).to_bytes(6, "little") + raw[-6:]
    assert not link.hears(forged, START_S)
    assert link.reason == WRONG_HASH
    assert link.hears(link.sealed(2, START_S + 1), START_S + 1)


def test_the_junk_datagram_swallows_nothing(link: Link) -> None:
    assert not link.hears(b"\xfd\xff\x01", START_S)
    for sequence in range(1, 11):
        assert link.hears(link.sealed(sequence, START_S + sequence), START_S + sequence)


def test_the_drifting_clock_a_vehicle_that_starts_late_hears_at_once(link: Link) -> None:
    for second in range(3600):
        raw = link.sealed(second, START_S + second) if second % 600 == 599 else b""
    assert link.hears(raw, START_S + 3599)


def test_another_key_is_refused(link: Link) -> None:
    strength = {"MAVLink signing": "mavlink", "Ed25519": "ed25519"}.get(link.authenticator.trust.words, "both")
    raw = sealer_of(strength, OTHER_KEYS).sign(unsealed(1, START_S), START_S)
    assert not link.hears(raw, START_S)
    assert link.reason == (WRONG_ED25519 if strength == "ed25519" else WRONG_HASH)


def test_an_unsigned_frame_is_refused(link: Link) -> None:
    assert not link.hears(unsealed(1, START_S), START_S)
    assert link.reason in (UNSIGNED, NO_ED25519)


def test_under_both_strengths_neither_key_alone_is_enough() -> None:
    link = Link("both")
    assert not link.hears(sealer_of("mavlink").sign(unsealed(1, START_S), START_S), START_S)
    assert link.reason == NO_ED25519
    link = Link("both")
    assert not link.hears(sealer_of("ed25519").sign(unsealed(1, START_S), START_S), START_S)
    assert link.reason == UNSIGNED


def test_a_captured_vehicle_cannot_speak_for_the_centre() -> None:
    link = Link("both")
    captured = MavlinkSigner(KEYS.mavlink_key, 0)
    forged = captured.sign(forged_seal(unsealed(1, START_S), bytes(range(ED25519_BYTES))), START_S)
    assert not link.hears(forged, START_S)
    assert link.reason == WRONG_ED25519
    assert link.authenticator.state == AuthenticatorState()


def test_a_captured_vehicle_that_relays_a_frame_with_its_mavlink_time_ahead_deafens_nobody() -> None:
    link = Link("both")
    captured = MavlinkSigner(KEYS.mavlink_key, 0)
    relayed = captured.sign(strip_signature(raw_frame(link.sealed(1, START_S))), START_S + 4.9)
    # Its content is the centre's, so it is believed; what it says of MAVLink's time is not.
    assert link.hears(relayed, START_S)
    assert link.hears(link.sealed(2, START_S + 0.1), START_S + 0.1)
    assert link.authenticator.state.streams == ()


def test_a_replayed_frame_is_refused_at_once_and_later(link: Link) -> None:
    raw = link.sealed(1, START_S)
    assert link.hears(raw, START_S)
    assert not link.hears(raw, START_S + 0.1)
    assert link.reason in (REPEATED, REPLAYED_TIME)
    assert link.hears(link.sealed(2, START_S + 1), START_S + 1)
    for later_s in (1.1, 20.0, 1000.0):
        assert not link.hears(raw, START_S + later_s)


def test_a_time_spread_copy_counts_as_repeated(link: Link) -> None:
    raw = unsealed(1, START_S)
    assert link.hears(link.frame_signer.sign(raw, START_S), START_S)
    assert not link.hears(link.frame_signer.sign(raw, START_S + 0.3), START_S + 0.3)
    assert link.reason == REPEATED


def test_a_frame_of_an_older_broadcast_is_refused_and_another_part_of_the_newest_is_not(link: Link) -> None:
    late = link.sealed(1, START_S)
    parts = [link.sealed(2, START_S + 1, index=index, count=2) for index in range(2)]
    assert link.hears(parts[0], START_S + 1)
    assert link.hears(parts[1], START_S + 1)
    assert not link.hears(late, START_S + 1)
    assert link.reason in (OLD_SEQUENCE, REPLAYED_TIME)


@pytest.mark.parametrize(
    ("ahead_s", "reason"),
    [(-30.5, PAST_STAMP), (-29.5, None), (1.5, None), (2.5, FUTURE_STAMP), (86_400.0, FUTURE_STAMP)],
)
def test_a_frame_must_be_of_now(link: Link, ahead_s: float, reason: str | None) -> None:
    raw = link.frame_signer.sign(unsealed(1, START_S + 100 + ahead_s), START_S + 100)
    assert link.hears(raw, START_S + 100) == (reason is None)
    assert list(link.authenticator.rejected) == ([] if reason is None else [reason])


def test_a_mavlink_time_in_the_future_is_refused() -> None:
    link = Link("mavlink")
    assert not link.hears(link.frame_signer.sign(unsealed(1, START_S), START_S + 6), START_S)
    assert link.reason == FUTURE_TIME


def test_a_refused_future_frame_keeps_out_no_later_one(link: Link) -> None:
    assert not link.hears(link.frame_signer.sign(unsealed(1000, START_S + 1000), START_S), START_S)
    assert link.hears(link.sealed(1, START_S + 1), START_S + 1)


def test_a_vehicle_without_a_clock_goes_by_the_order_alone(link: Link) -> None:
    blind = Link("both", replace(link.authenticator.trust, clock_checked=False))
    blind.frame_signer = link.frame_signer
    assert blind.hears(link.sealed(5, START_S), START_S - 1e6)
    assert not blind.hears(link.sealed(4, START_S), START_S - 1e6)
    assert blind.hears(link.sealed(6, START_S), START_S + 1e6)


def test_a_step_of_the_ground_stations_clock_is_survived(link: Link) -> None:
    assert link.hears(link.sealed(1, START_S), START_S)
    # An hour ahead, its frames are of the future; once it is mended they are heard again.
    assert not link.hears(link.frame_signer.sign(unsealed(2, START_S + 3600), START_S + 1), START_S + 1)
    assert link.hears(link.sealed(3, START_S + 2), START_S + 2)


def test_a_step_of_the_vehicles_clock_is_survived(link: Link) -> None:
    assert link.hears(link.sealed(1, START_S), START_S)
    assert not link.hears(link.sealed(2, START_S + 1), START_S + 3601)
    assert not link.hears(link.sealed(3, START_S + 2), START_S - 3598)
    assert link.hears(link.sealed(4, START_S + 3), START_S + 3)


def test_a_leap_of_the_sequence_is_accepted(link: Link) -> None:
    assert link.hears(link.sealed(1, START_S), START_S)
    assert link.hears(link.sealed(4_000_000_000, START_S + 1), START_S + 1)
    assert link.hears(link.sealed(4_294_967_295, START_S + 2), START_S + 2)


def test_a_restarted_ground_station_is_heard_from_its_first_frame(link: Link) -> None:
    assert link.hears(link.sealed(900, START_S + 10), START_S + 10)
    assert link.hears(link.sealed(1, START_S + 20, epoch_s=EPOCH_S + 19), START_S + 20)


def test_frames_of_an_older_epoch_are_refused_for_good(link: Link) -> None:
    old = link.sealed(901, START_S + 20)
    assert link.hears(link.sealed(1, START_S + 20, epoch_s=EPOCH_S + 19), START_S + 20)
    assert not link.hears(old, START_S + 20)
    blind = Link("ed25519", Trust(None, KEYS.private_key.public_key(), clock_checked=False))
    assert blind.hears(blind.sealed(1, START_S + 20, epoch_s=EPOCH_S + 19), START_S + 20)
    assert not blind.hears(blind.sealed(902, START_S + 21), START_S + 1000)
    assert blind.reason == OLD_EPOCH


@pytest.mark.parametrize("trust_word", ["unsigned", "mavlink"])
@pytest.mark.parametrize(("epoch_ahead_s", "sequence"), [(1, 0), (0, 4_294_967_295)])
def test_one_frame_stamped_ahead_shuts_the_centre_out_for_no_longer_than_a_silence(
    trust_word: str, epoch_ahead_s: int, sequence: int
) -> None:
    link = Link(trust_word)
    key_holder = MavlinkSigner(KEYS.mavlink_key, 9)
    evil = unsealed(sequence, START_S + 1, epoch_s=EPOCH_S + epoch_ahead_s)
    assert link.hears(link.sealed(1, START_S), START_S)
    assert link.hears(key_holder.sign(evil, START_S) if trust_word == "mavlink" else evil, START_S)
    heard = [
        second for second in range(1, 60) if link.hears(link.sealed(1 + second, START_S + second), START_S + second)
    ]
    assert heard == list(range(30, 60))


@pytest.mark.parametrize("authentication", ["ed25519", "both"])
def test_no_silence_lets_an_older_epoch_in_where_only_the_centre_can_make_frames(authentication: str) -> None:
    link = Link(authentication)
    assert link.hears(link.sealed(1, START_S + 2, epoch_s=EPOCH_S + 1), START_S + 2)
    assert not link.hears(link.sealed(900, START_S + 3600), START_S + 3600)
    assert link.reason == OLD_EPOCH


def test_a_silence_lets_no_recording_in_under_mavlink_signing() -> None:
    link = Link("mavlink", replace(trust_of("mavlink"), clock_checked=False))
    old = link.sealed(900, START_S)
    assert link.hears(link.sealed(1, START_S + 2, epoch_s=EPOCH_S + 1), START_S + 2)
    assert not link.hears(old, START_S + 3600)
    assert link.reason == REPLAYED_TIME


def test_after_a_restart_an_older_epoch_waits_for_a_silence_as_well() -> None:
    link = Link("unsigned", state=AuthenticatorState(EPOCH_S + 1, 5))
    assert not link.hears(link.sealed(1, START_S), START_S)
    assert not link.hears(link.sealed(2, START_S + 29.9), START_S + 29.9)
    assert link.hears(link.sealed(3, START_S + 30), START_S + 30)


def test_frames_through_an_autopilot_are_admitted_as_they_were_sent(link: Link) -> None:
    link.hears(link.sealed(0, START_S), START_S)
    # A state frame with both signatures is too long for a V2_EXTENSION.
    motion = FrameWriter().encode(MotionFrame(Stamp(EPOCH_S, 0, 1), (), (), ()))
    raw = link.frame_signer.sign(motion, START_S)
    assert [admitted.raw for admitted in link.authenticator.admit(wrap(raw, 0), START_S)] == [raw_frame(raw)]
    assert link.authenticator.rejected.total() == 0


def test_a_restarted_vehicle_refuses_what_it_had_accepted_and_hears_on(link: Link) -> None:
    old, new = link.sealed(7, START_S), link.sealed(8, START_S + 1)
    assert link.hears(old, START_S)
    assert link.hears(new, START_S + 1)
    kept = AuthenticatorState.from_json(link.authenticator.state.to_json())
    assert kept == link.authenticator.state
    restarted = Authenticator(link.authenticator.trust, kept)
    assert restarted.admit(old, START_S + 2) == []
    assert restarted.admit(link.sealed(9, START_S + 2), START_S + 2) != []


def test_the_state_kept_is_these_bytes() -> None:
    link = Link("mavlink")
    link.hears(link.sealed(7, START_S), START_S)
    text = '{"epoch_s": 1800000000, "sequence": 7, "streams": [[0, 254, 190, 37992960000000]]}'
    assert link.authenticator.state.to_json() == text


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[]",
        "null",
        '{"epoch_s": "x", "sequence": 1, "streams": []}',
        '{"epoch_s": 1, "sequence": 1, "streams": [[1, 2]]}',
        '{"epoch_s": Infinity, "sequence": 1, "streams": []}',
        '{"epoch_s": -1, "sequence": 1, "streams": []}',
        '{"epoch_s": 1, "sequence": 99999999999, "streams": []}',
    ],
)
def test_a_damaged_state_is_named_in_one_line(text: str) -> None:
    with pytest.raises(InputError, match="the state of the broadcast"):
        AuthenticatorState.from_json(text)


@pytest.mark.parametrize("text", ["", "[" * 60_000])
def test_a_state_that_is_none_is_refused_with_the_remedy(text: str) -> None:
    with pytest.raises(InputError, match="allowed: what companion wrote, or no file"):
        AuthenticatorState.from_json(text)


def test_only_the_ground_stations_component_is_heard() -> None:
    link = Link("unsigned")
    stranger = FrameWriter(system=1).encode(
        StateFrame(Stamp(EPOCH_S, 0, 1), 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, (), (), ())
    )
    assert not link.hears(stranger, START_S)
    assert link.reason == OTHER_SENDER


def test_a_heartbeat_is_no_broadcast() -> None:
    link = Link("unsigned")
    ground = oneway.MAVLink(None, 254, 190)
    assert not link.hears(bytes(ground.heartbeat_encode(6, 8, 0, 0, 4).pack(ground)), START_S)
    assert link.reason == HEARTBEAT


def test_bytes_behind_the_content_are_refused() -> None:
    link = Link("unsigned")
    fleet = 0xA00105
    head = bytes((0xFD, 200, 0, 0, 0, 254, 190)) + fleet.to_bytes(3, "little") + bytes(199) + b"\x01"
    assert not link.hears(head + crc_of(head, fleet), START_S)
    assert link.reason == TRAILING_BYTES


def test_a_datagram_longer_than_any_link_hands_over_is_dropped_whole() -> None:
    link = Link("unsigned")
    assert not link.hears(link.sealed(1, START_S).ljust(2049, b"\0"), START_S)
    assert link.reason == TOO_LARGE
    assert link.hears(link.sealed(1, START_S).ljust(2048, b"\0"), START_S)


@pytest.mark.parametrize("case", range(len(NONSENSE)))
def test_fields_out_of_range_are_refused_and_not_remembered_even_with_the_right_keys(link: Link, case: int) -> None:
    number, payload = NONSENSE[case]
    stamped = (EPOCH_S).to_bytes(4, "little") + bytes(4) + (9).to_bytes(4, "little") + payload[12:]
    head = bytes((0xFD, len(stamped), 0, 0, 0, 254, 190)) + number.to_bytes(3, "little") + stamped
    assert not link.hears(link.frame_signer.sign(head + crc_of(head, number), START_S), START_S)
    assert link.authenticator.rejected.total() == 1
    assert link.hears(link.sealed(1, START_S), START_S)


def test_kinds_of_reasons_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    from companion.protocol import authenticator as authenticator
    from companion.protocol.codec import WireError

    counter = iter(range(10_000))

    def refuse(raw: bytes) -> None:
        raise WireError(f"reason {next(counter)}")

    monkeypatch.setattr(authenticator, "decode_frame", refuse)
    link = Link("unsigned")
    for sequence in range(500):
        link.hears(link.sealed(sequence, START_S), START_S)
    assert len(link.authenticator.rejected) <= MAX_REASONS + 1
    assert link.authenticator.rejected.total() == 500


def test_frames_remembered_to_tell_repeats_are_bounded() -> None:
    link = Link("unsigned")
    for index in range(REMEMBERED_FRAMES + 100):
        assert link.hears(link.sealed(1, START_S + index / 1000), START_S + 1)
    assert len(link.authenticator._heard) == REMEMBERED_FRAMES


def test_chunks_of_a_byte_stream_are_put_together(link: Link) -> None:
    vehicle = Authenticator(link.authenticator.trust, is_stream=True)
    frames = [link.sealed(sequence, START_S) for sequence in range(1, 6)]
    stream = b"noise" + b"".join(frames)
    heard = [raw.data for at in range(0, len(stream), 7) for raw, _ in vehicle.admit(stream[at : at + 7], START_S)]
    assert heard == frames
    assert vehicle.rejected == {"junk": 1}


@settings(max_examples=200)
@given(data=st.binary(max_size=300), is_stream=st.booleans(), now_s=st.floats(-1e12, 1e12))
def test_no_bytes_raise_and_none_are_believed(data: bytes, is_stream: bool, now_s: float) -> None:
    assert Authenticator(trust_of("both"), is_stream=is_stream).admit(data, now_s) == []


def test_a_whole_broadcast_of_the_greatest_length_may_come_at_once() -> None:
    link = Link("ed25519")
    frames = [link.sealed(1, START_S, index=index, count=255) for index in range(255)]
    heard = [raw.data for frame in frames for raw, _ in link.authenticator.admit(frame, START_S)]
    heard += [raw.data for raw, _ in link.authenticator.due(START_S + WINDOW_S)]
    assert heard == frames


def test_in_a_flood_with_the_shared_key_checks_are_bounded_and_genuine_frames_still_get_in() -> None:
    link = Link("both", replace(trust_of("both"), checks_per_s=500.0))
    captured = MavlinkSigner(KEYS.mavlink_key, 0)
    forged = [
        captured.sign(forged_seal(unsealed(1000 + i, START_S), bytes([i]) * ED25519_BYTES), START_S) for i in range(50)
    ]
    heard_s: list[float] = []
    for step in range(20_000):
        now_s = START_S + step / 10_000
        datagram = forged[step % 50]
        if step % 200 == 0:
            datagram = link.sealed(1 + step // 200, now_s)
        heard_s += [now_s for _ in link.authenticator.admit(datagram, now_s)]
    checked = link.authenticator.rejected[WRONG_ED25519] + len(heard_s)
    assert checked <= 2 * 500 + BURST_CHECKS
    assert link.authenticator.rejected[UNCHECKED] > 15_000
    assert any(moment > START_S + 1 for moment in heard_s)


def test_of_two_copies_that_wait_together_one_is_believed() -> None:
    link = Link("ed25519")
    for sequence in range(BURST_CHECKS // 2 + 1):
        link.hears(link.sealed(sequence, START_S), START_S)
    raw = link.sealed(1000, START_S)
    assert not link.hears(raw, START_S)
    assert not link.hears(raw, START_S)
    admitted = link.authenticator.due(START_S + WINDOW_S)
    assert [one.raw.data for one in admitted].count(raw) == 1
    assert link.authenticator.rejected == {REPEATED: 1}
