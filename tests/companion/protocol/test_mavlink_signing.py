"""MAVLink signing as pymavlink does it, without the stock receiver's and sender's faults."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.protocol.dialect import oneway
from companion.protocol.frame import raw_frame
from companion.protocol.mavlink_signing import (
    FUTURE_TIME,
    MAX_STREAMS,
    PAST_TIME,
    REPLAYED_TIME,
    TOO_MANY_STREAMS,
    UNSIGNED,
    WRONG_HASH,
    MavlinkSigner,
    MavlinkVerifier,
    strip_signature,
    timestamp_of,
)
from tests.companion.protocol.hostile import START_S, Ground

KEY = bytes(range(32))
FRAME = Ground("unsigned", random.Random(1)).unsealed(START_S)
TIME_MAX = (1 << 48) - 1


def forged(raw: bytes, timestamp: int) -> bytes:
    """Return a signed frame with another time and the old hash, as one without the key can make it."""
    return raw[:-12] + timestamp.to_bytes(6, "little") + raw[-6:]


def stock_receiver() -> oneway.MAVLink:
    receiver = oneway.MAVLink(None)
    receiver.robust_parsing = True
    receiver.signing.secret_key = bytearray(KEY)
    receiver.signing.timestamp = timestamp_of(START_S)
    return receiver


def test_a_signed_frame_has_these_bytes() -> None:
    raw = MavlinkSigner(KEY, link_id=7).sign(FRAME, START_S)
    assert raw[:2] == FRAME[:2]
    assert raw[2] == 1
    assert raw[10 : 10 + FRAME[1]] == FRAME[10:-2]
    assert len(raw) == len(FRAME) + 13
    # Link id, then 37 992 960 000 000 times 10 us since 2015.
    assert raw[-13:-6] == bytes.fromhex("070080e2ec8d22")


def test_pymavlink_accepts_what_is_signed_here() -> None:
    (message,) = stock_receiver().parse_buffer(MavlinkSigner(KEY, 1).sign(FRAME, START_S))
    assert message.get_type() == "ONEWAY_STATE"
    assert message.get_signed()


def test_what_pymavlink_signs_is_accepted_here() -> None:
    sender = oneway.MAVLink(None, srcSystem=254, srcComponent=190)
    sender.signing.secret_key = bytearray(KEY)
    sender.signing.sign_outgoing = True
    sender.signing.timestamp = timestamp_of(START_S)
    (message,) = oneway.MAVLink(None).parse_buffer(FRAME)
    assert MavlinkVerifier(KEY).check(raw_frame(bytes(message.pack(sender))), START_S) is None


def test_stripping_a_signature_gives_the_frame_as_it_was() -> None:
    assert strip_signature(raw_frame(MavlinkSigner(KEY, 1).sign(FRAME, START_S))) == FRAME
    assert strip_signature(raw_frame(FRAME)) == FRAME


def test_a_signature_of_another_dialects_frame_is_stripped_too() -> None:
    message = common.MAVLink_setup_signing_message(1, 1, list(range(32)), 2**40 + 7)
    plain, signing = common.MAVLink(None, 7, 8), common.MAVLink(None, 7, 8)
    signing.signing.secret_key, signing.signing.sign_outgoing = KEY, True
    unsigned = bytes(message.pack(plain))
    assert strip_signature(raw_frame(bytes(message.pack(signing)))) == unsigned


def test_signing_a_signed_frame_replaces_the_signature() -> None:
    signer = MavlinkSigner(KEY, 1)
    again = signer.sign(signer.sign(FRAME, START_S), START_S + 1)
    assert len(again) == len(FRAME) + 13
    assert MavlinkVerifier(KEY).check(raw_frame(again), START_S + 1) is None


def test_the_time_signed_follows_the_clock_and_never_falls_back() -> None:
    signer = MavlinkSigner(KEY, 1)
    times = []
    for now_s in (START_S, START_S, START_S + 3600, START_S - 3600):
        signer.sign(FRAME, now_s)
        times.append(signer.last_timestamp)
    start = timestamp_of(START_S)
    assert times == [start, start + 1, start + 360_000_000, start + 360_000_001]


def test_the_drifting_clock_a_sender_up_for_an_hour_is_heard_by_a_vehicle_that_starts_now() -> None:
    signer = MavlinkSigner(KEY, 1)
    for second in range(3600):
        raw = signer.sign(FRAME, START_S + second)
    assert MavlinkVerifier(KEY).check(raw_frame(raw), START_S + 3599) is None
    # The stock sender's time advances by 10 us per frame only.
    stock = MavlinkSigner(KEY, 1)
    for _ in range(3600):
        raw = stock.sign(FRAME, START_S)
    assert MavlinkVerifier(KEY).check(raw_frame(raw), START_S + 3599) == PAST_TIME


def test_a_restarted_sender_with_its_clock_set_back_goes_on_where_it_was() -> None:
    verifier = MavlinkVerifier(KEY)
    signer = MavlinkSigner(KEY, 1)
    verifier.commit(raw_frame(signer.sign(FRAME, START_S)))
    restarted = MavlinkSigner(KEY, 1, signer.last_timestamp)
    assert verifier.check(raw_frame(restarted.sign(FRAME, START_S - 3600)), START_S) is None


def test_the_one_forged_frame_attack_deafens_the_stock_receiver_and_not_ours() -> None:
    signer = MavlinkSigner(KEY, 1)
    bad = forged(signer.sign(FRAME, START_S), TIME_MAX - 1)
    good = signer.sign(FRAME, START_S + 1)
    stock = stock_receiver()
    assert [message.get_type() for message in stock.parse_buffer(bad)] == ["BAD_DATA"]
    assert [message.get_type() for message in stock.parse_buffer(good)] == ["BAD_DATA"]
    verifier = MavlinkVerifier(KEY)
    assert verifier.check(raw_frame(bad), START_S) == WRONG_HASH
    assert verifier.streams == {}
    assert verifier.check(raw_frame(good), START_S + 1) is None


def test_checking_alone_remembers_nothing() -> None:
    verifier = MavlinkVerifier(KEY)
    raw = MavlinkSigner(KEY, 1).sign(FRAME, START_S)
    assert verifier.check(raw_frame(raw), START_S) is None
    assert verifier.check(raw_frame(raw), START_S) is None
    verifier.commit(raw_frame(raw))
    assert verifier.check(raw_frame(raw), START_S) == REPLAYED_TIME


def test_an_unsigned_frame_and_one_with_another_key_are_told_apart() -> None:
    verifier = MavlinkVerifier(KEY)
    assert verifier.check(raw_frame(FRAME), START_S) == UNSIGNED
    assert verifier.check(raw_frame(MavlinkSigner(bytes(32), 1).sign(FRAME, START_S)), START_S) == WRONG_HASH


@pytest.mark.slow
@given(at=st.integers(0, len(FRAME) + 12), mask=st.integers(1, 255))
def test_no_byte_of_a_signed_frame_can_be_changed(at: int, mask: int) -> None:
    raw = bytearray(MavlinkSigner(KEY, 1).sign(FRAME, START_S))
    raw[at] ^= mask
    assert MavlinkVerifier(KEY).check(raw_frame(bytes(raw)), START_S) in (UNSIGNED, WRONG_HASH)


@pytest.mark.parametrize(
    ("sent_after_s", "reason"),
    [(4.9, None), (5.1, FUTURE_TIME), (86_400.0, FUTURE_TIME), (-59.0, None), (-61, PAST_TIME)],
)
def test_an_unknown_stream_must_be_of_now(sent_after_s: float, reason: str | None) -> None:
    raw = MavlinkSigner(KEY, 1).sign(FRAME, START_S + sent_after_s)
    assert MavlinkVerifier(KEY).check(raw_frame(raw), START_S) == reason


def test_without_a_clock_only_the_order_counts() -> None:
    infinite = float("inf")
    verifier = MavlinkVerifier(KEY, ahead_s=infinite, behind_s=infinite)
    raw = MavlinkSigner(KEY, 1).sign(FRAME, START_S + 1e6)
    assert verifier.check(raw_frame(raw), START_S) is None
    verifier.commit(raw_frame(raw))
    assert verifier.check(raw_frame(MavlinkSigner(KEY, 1).sign(FRAME, START_S)), START_S) == REPLAYED_TIME


def test_streams_kept_over_a_restart_refuse_a_recording() -> None:
    verifier = MavlinkVerifier(KEY)
    raw = MavlinkSigner(KEY, 3).sign(FRAME, START_S)
    verifier.commit(raw_frame(raw))
    assert verifier.streams == {(3, 254, 190): timestamp_of(START_S)}
    assert MavlinkVerifier(KEY, verifier.streams).check(raw_frame(raw), START_S + 1) == REPLAYED_TIME


def test_streams_are_bounded_and_only_one_too_old_to_matter_makes_room() -> None:
    verifier = MavlinkVerifier(KEY)
    for link_id in range(MAX_STREAMS):
        verifier.commit(raw_frame(MavlinkSigner(KEY, link_id).sign(FRAME, START_S + link_id)))
    other = MavlinkSigner(KEY, 200)
    assert verifier.check(raw_frame(other.sign(FRAME, START_S + 30)), START_S + 30) == TOO_MANY_STREAMS
    late = other.sign(FRAME, START_S + 60.5)
    assert verifier.check(raw_frame(late), START_S + 60.5) is None
    verifier.commit(raw_frame(late))
    assert len(verifier.streams) == MAX_STREAMS
    assert (0, 254, 190) not in verifier.streams
    # What the forgotten stream carried is refused all the same.
    assert verifier.check(raw_frame(MavlinkSigner(KEY, 0).sign(FRAME, START_S)), START_S + 60.5) == PAST_TIME


@pytest.mark.parametrize("length", [0, 1, 31, 33])
def test_a_key_of_another_length_is_refused(length: int) -> None:
    with pytest.raises(ValueError, match=f"a MAVLink key of {length} bytes; allowed: 32"):
        MavlinkSigner(bytes(length), 0)


def test_the_key_is_in_no_words() -> None:
    for holder in (MavlinkSigner(KEY, 1), MavlinkVerifier(KEY)):
        assert KEY.hex() not in repr(holder) + str(vars(holder))
        assert repr(KEY) not in repr(holder) + str(vars(holder))
