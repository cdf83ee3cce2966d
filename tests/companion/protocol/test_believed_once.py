"""Whatever was recorded, whenever the vehicle is restarted, and however it ended: nothing is believed a second time."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.protocol.authenticator import TOO_MANY_FRAMES, Authenticator, AuthenticatorState, Trust
from companion.protocol.believed import BEFORE_START, LEAP_BROADCASTS, MOST_SPANS, UNSAVED_S, BelievedBroadcasts, Rules
from companion.protocol.codec import Directive, FrameWriter, Stamp, StateFrame
from companion.protocol.frame import FrameStamp
from companion.protocol.freshness import LEAP_S, OLD_EPOCH, OLD_SEQUENCE, RESTART_AFTER_S
from companion.protocol.mavlink_signing import REPLAYED_TIME, MavlinkSigner
from tests.companion.protocol.hostile import AUTHENTICATIONS, START_S, Ground

KEYS = {word: Ground(word, random.Random(5)) for word in AUTHENTICATIONS}
EPOCH_S = int(START_S)
DAY_S = 86_400
SAVED_S = 1.0
"""Time since the last save within which a killed program may have believed more."""


def trust_of(word: str, *, checked: bool) -> Trust:
    return replace(KEYS[word].trust, clock_checked=checked)


def signed(word: str, sequence: int, at_s: float, *, epoch_s: int = EPOCH_S, index: int = 0, count: int = 1) -> bytes:
    stamp = Stamp(epoch_s, round((at_s - epoch_s) * 1000), sequence, index, count)
    raw = FrameWriter().encode(StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, (), (), ()))
    # A signer of its own, so that its MAVLink time is that of the frame even where a frame before leapt ahead.
    signer = KEYS[word].sealer_with(KEYS[word].private_key, KEYS[word].mavlink_key)
    return signer.sign(raw, at_s)


def restarted(before: Authenticator, saved: AuthenticatorState | None = None) -> Authenticator:
    """Return the authenticator of the next program: after a clean end, or of one killed that had saved a state."""
    state = before.state if saved is None else replace(saved, is_open=True)
    return Authenticator(before.trust, AuthenticatorState.from_json(state.to_json()))


@pytest.fixture(params=AUTHENTICATIONS)
def word(request: pytest.FixtureRequest) -> str:
    return str(request.param)


# After a restart


@pytest.mark.parametrize("checked", [True, False])
def test_the_newest_broadcast_is_not_believed_again_after_a_restart(word: str, checked: bool) -> None:
    vehicle = Authenticator(trust_of(word, checked=checked))
    frame = signed(word, 7, START_S)
    assert vehicle.admit(frame, START_S)
    again = restarted(vehicle)
    assert not again.admit(frame, START_S + 1)
    assert again.admit(signed(word, 8, START_S + 1.1), START_S + 1.2)


def test_nor_if_the_ground_stations_clock_is_ahead(word: str) -> None:
    vehicle = Authenticator(trust_of(word, checked=True))
    frame = signed(word, 7, START_S + 1.5)
    assert vehicle.admit(frame, START_S)
    again = restarted(vehicle)
    assert not again.admit(frame, START_S + 1)
    assert again.admit(signed(word, 8, START_S + 2.5), START_S + 1.2)


def test_a_program_that_was_killed_is_followed_by_one_that_believes_nothing_from_before_it(word: str) -> None:
    vehicle = Authenticator(trust_of(word, checked=True))
    lost = signed(word, 7, START_S + 1.5)
    assert vehicle.admit(lost, START_S)
    again = restarted(vehicle, AuthenticatorState())
    assert not again.admit(lost, START_S + 1)
    assert again.rejected[BEFORE_START] == 1
    assert again.admit(signed(word, 9, START_S + 3.1), START_S + 3.1)


def test_without_a_clock_what_was_sent_just_after_the_last_save_is_left_out(word: str) -> None:
    vehicle = Authenticator(trust_of(word, checked=False))
    vehicle.admit(signed(word, 7, START_S), START_S)
    saved = vehicle.state
    lost = signed(word, 8, START_S + SAVED_S)
    assert vehicle.admit(lost, START_S + SAVED_S)
    again = restarted(vehicle, saved)
    assert not again.admit(lost, START_S + 100)
    assert again.admit(signed(word, 12, START_S + UNSAVED_S + 0.1), START_S + 101)


@settings(max_examples=30, deadline=None)
@given(data=st.data(), checked=st.booleans(), trust_word=st.sampled_from(AUTHENTICATIONS), killed=st.booleans())
def test_no_frame_is_believed_twice_whenever_the_vehicle_is_restarted(
    data: st.DataObject, checked: bool, trust_word: str, killed: bool
) -> None:
    vehicle = Authenticator(trust_of(trust_word, checked=checked))
    now_s, sequence, epoch_s = START_S, 0, EPOCH_S
    recorded: list[bytes] = []
    believed: set[bytes] = set()
    saved, saved_s = vehicle.state, 0.0
    for _ in range(data.draw(st.integers(1, 12))):
        step = data.draw(st.sampled_from(["next", "next", "part", "run", "ahead", "leap", "silence"]))
        passed_s = data.draw(st.sampled_from([0.05, 0.4, 1.0])) + (40.0 if step == "silence" else 0.0)
        # As AuthenticatorStateFile does: once a second, but the first change after a pause and a leap at once.
        if vehicle.state != saved and now_s + passed_s - saved_s >= SAVED_S:
            saved, saved_s = vehicle.state, max(now_s, saved_s + SAVED_S)
        now_s += passed_s
        sequence += step in ("next", "silence")
        if step == "run":
            epoch_s, sequence = max(epoch_s + 1, int(now_s)), 1
        stamped_s = max(now_s, float(epoch_s))
        if step == "ahead":
            stamped_s += data.draw(st.sampled_from([1.5, 3 * LEAP_S, DAY_S]))
        its_epoch_s = int(stamped_s) if step == "ahead" else epoch_s
        its_sequence = sequence + (10 * LEAP_BROADCASTS if step == "leap" else 0)
        frame = signed(trust_word, its_sequence, stamped_s, epoch_s=its_epoch_s)
        recorded.append(frame)
        believed |= {raw.data for raw, _ in vehicle.admit(frame, now_s)}
        due = now_s - saved_s >= SAVED_S or len(vehicle.state.spans) != len(saved.spans)
        if vehicle.state != saved and due:
            saved, saved_s = vehicle.state, now_s
    again = restarted(vehicle, saved if killed else None)
    now_s += data.draw(st.sampled_from([0.1, 1.0, 20.0, 50.0]))
    for frame in data.draw(st.permutations(recorded + recorded)):
        now_s += data.draw(st.sampled_from([0.01, 1.0, 31.0]))
        assert not {raw.data for raw, _ in again.admit(frame, now_s)} & believed


# A stamp far ahead, where no clock is compared


@pytest.mark.parametrize("epoch_ahead_s", [0, DAY_S])
def test_a_ground_station_whose_clock_was_a_day_ahead_is_heard_again_after_a_silence(
    word: str, epoch_ahead_s: int
) -> None:
    vehicle = Authenticator(trust_of(word, checked=False))
    assert vehicle.admit(signed(word, 1, START_S), START_S)
    wrong = signed(word, 2, START_S + DAY_S + 1, epoch_s=EPOCH_S + epoch_ahead_s)
    assert vehicle.admit(wrong, START_S + 1)
    heard = [
        second
        for second in range(2, 60)
        if vehicle.admit(signed(word, 1 + second, START_S + second, epoch_s=EPOCH_S), START_S + second)
    ]
    first = 2 if epoch_ahead_s == 0 and word != "mavlink" else round(RESTART_AFTER_S) + 1
    assert heard == list(range(first, 60))
    assert not vehicle.admit(wrong, START_S + 100)
    assert not vehicle.admit(wrong, START_S + 200)


def test_the_same_holds_if_the_wrong_run_was_the_first_ever_heard(word: str) -> None:
    vehicle = Authenticator(trust_of(word, checked=False))
    assert vehicle.admit(signed(word, 1, START_S + DAY_S, epoch_s=EPOCH_S + DAY_S), START_S)
    assert not vehicle.admit(signed(word, 2, START_S + 5), START_S + 5)
    assert vehicle.admit(signed(word, 3, START_S + 31), START_S + 31)


def test_and_over_a_restart(word: str) -> None:
    vehicle = Authenticator(trust_of(word, checked=False))
    vehicle.admit(signed(word, 1, START_S), START_S)
    wrong = signed(word, 1, START_S + DAY_S, epoch_s=EPOCH_S + DAY_S)
    assert vehicle.admit(wrong, START_S + 1)
    again = restarted(vehicle)
    assert not again.admit(signed(word, 5, START_S + 5), START_S + 5)
    right = signed(word, 40, START_S + 40)
    assert again.admit(right, START_S + 40)
    third = restarted(again)
    assert not third.admit(wrong, START_S + 41)
    assert not third.admit(right, START_S + 100)
    assert third.admit(signed(word, 101, START_S + 101), START_S + 101)


def test_a_sequence_far_ahead_by_a_holder_of_the_shared_key_deafens_for_a_silence_only() -> None:
    vehicle = Authenticator(trust_of("mavlink", checked=False))
    key_holder = MavlinkSigner(KEYS["mavlink"].mavlink_key, 9)
    stamp = Stamp(EPOCH_S, 1000, 4_294_967_295)
    raw = FrameWriter().encode(StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, (), (), ()))
    assert vehicle.admit(signed("mavlink", 1, START_S), START_S)
    assert vehicle.admit(key_holder.sign(raw, START_S + 1), START_S + 1)
    assert not vehicle.admit(signed("mavlink", 20, START_S + 20), START_S + 20)
    assert vehicle.admit(signed("mavlink", 40, START_S + 40), START_S + 40)


def test_a_mavlink_time_far_ahead_deafens_for_a_silence_only() -> None:
    vehicle = Authenticator(trust_of("mavlink", checked=False))
    key_holder = MavlinkSigner(KEYS["mavlink"].mavlink_key, 0)
    raw = FrameWriter().encode(
        StateFrame(Stamp(EPOCH_S, 1000, 2), 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, (), (), ())
    )
    assert vehicle.admit(key_holder.sign(raw, START_S + 30 * DAY_S), START_S + 1)
    assert not vehicle.admit(signed("mavlink", 20, START_S + 20), START_S + 20)
    assert vehicle.rejected[REPLAYED_TIME] == 1
    assert vehicle.admit(signed("mavlink", 40, START_S + 40), START_S + 40)


def test_after_a_silence_a_frame_a_little_older_is_still_refused_where_only_the_centre_can_make_one() -> None:
    vehicle = Authenticator(trust_of("ed25519", checked=False))
    missed = signed("ed25519", 6, START_S)
    assert vehicle.admit(signed("ed25519", 7, START_S + 1), START_S + 1)
    assert not vehicle.admit(missed, START_S + 600)
    assert vehicle.rejected[OLD_SEQUENCE] == 1


# Tables


def test_the_spans_kept_are_bounded_and_hold_all_that_was_believed() -> None:
    order = BelievedBroadcasts(Rules(keyed=True, centre_only=True, clock_checked=False, ahead_s=2.0), None)
    order.begin(0.0)
    keys = [(EPOCH_S + DAY_S * run, 1) for run in range(5 * MOST_SPANS)]
    random.Random(3).shuffle(keys)
    now_s = 0.0
    for epoch_s, sequence in keys:
        now_s += 100.0
        stamp = FrameStamp(epoch_s, 0, sequence)
        if order.refusal(stamp, now_s) is None:
            order.note(stamp, now_s)
        assert len(order.kept.spans) <= MOST_SPANS + 1
    held = order.kept.spans
    for epoch_s, sequence in keys:
        if order.refusal(FrameStamp(epoch_s, 0, sequence), now_s + 100.0) is None:
            assert not any(span.first <= (epoch_s, sequence) < span.last for span in held)


def test_more_frames_of_one_broadcast_than_can_be_told_apart_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("companion.protocol.authenticator.REMEMBERED_FRAMES", 3)
    vehicle = Authenticator(trust_of("ed25519", checked=True))
    for place in range(3):
        assert vehicle.admit(signed("ed25519", 1, START_S + place / 1000), START_S + 1)
    assert not vehicle.admit(signed("ed25519", 1, START_S + 0.5), START_S + 1)
    assert vehicle.rejected[TOO_MANY_FRAMES] == 1
    assert vehicle.admit(signed("ed25519", 2, START_S + 1), START_S + 1)


def test_an_older_run_is_named_as_one_after_a_restart() -> None:
    vehicle = Authenticator(trust_of("ed25519", checked=True), AuthenticatorState(EPOCH_S + 10, 5))
    assert not vehicle.admit(signed("ed25519", 9, START_S + 11), START_S + 10)
    assert vehicle.rejected[OLD_EPOCH] == 1
