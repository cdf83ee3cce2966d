"""Ed25519 in the message: who holds the private key can speak for the centre, and nobody else."""

from __future__ import annotations

import random
from collections import Counter

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st

from companion.protocol import ed25519
from companion.protocol.codec import AgentEntry, Directive, FleetFrame, FrameWriter, MissionFrame, Stamp, decode_frame
from companion.protocol.deframer import crc_of, frames_in
from companion.protocol.dialect import oneway
from companion.protocol.ed25519 import (
    FrameSigner,
    sign,
    signature_of,
    signed_part,
    verify,
)
from companion.protocol.frame import BROADCAST_IDS, ED25519_BYTES, raw_frame
from companion.protocol.mavlink_signing import MavlinkSigner, MavlinkVerifier, strip_signature
from companion.protocol.messages import Grid
from tests.companion.protocol.hostile import START_S, Ground

PRIVATE = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
PUBLIC = PRIVATE.public_key()
STAMP = Stamp(int(START_S), 1000, 7)
STATE = Ground("unsigned", random.Random(1)).unsealed(START_S, 1)
MOTION = Ground("unsigned", random.Random(1)).unsealed(START_S, 4)
FLEET = FrameWriter().encode(
    FleetFrame(
        STAMP,
        Directive.HOLD,
        1,
        Grid(100, -1, -1),
        (AgentEntry(1, 10.0, -10.0, 3), AgentEntry(2, 0.0, 0.0, None)),
        (),
        (),
    )
)
MISSION = FrameWriter().encode(
    MissionFrame(STAMP, 1, 47.0, 8.0, 400.0, 50.0, 30.0, bytes(8), 2, 1, 0, "näher", bytes(8))
)
FRAMES = {"state": STATE, "motion": MOTION, "fleet": FLEET, "mission": MISSION}


def test_every_message_with_epoch_time_and_sequence_can_be_sealed() -> None:
    heads = {
        number
        for number, kind in oneway.mavlink_map.items()
        if kind.ordered_fieldnames[:3] == ["epoch", "time_ms", "sequence"]
    }
    assert heads == BROADCAST_IDS


@pytest.mark.parametrize("raw", FRAMES.values(), ids=FRAMES)
def test_a_sealed_frame_is_verified_and_says_the_same(raw: bytes) -> None:
    sealed = sign(raw, PRIVATE)
    assert verify(raw_frame(sealed), PUBLIC)
    assert decode_frame(raw_frame(sealed)) == decode_frame(raw_frame(raw))
    assert list(frames_in(sealed, Counter())) == [raw_frame(sealed)]
    assert len(sealed) == 12 + raw_frame(raw).content_length + ED25519_BYTES


@pytest.mark.parametrize("raw", FRAMES.values(), ids=FRAMES)
def test_an_unsealed_frame_and_one_of_another_key_are_not_verified(raw: bytes) -> None:
    assert signature_of(raw_frame(raw)) is None
    assert not verify(raw_frame(raw), PUBLIC)
    assert not verify(raw_frame(sign(raw, Ed25519PrivateKey.from_private_bytes(bytes(32)))), PUBLIC)


def test_what_is_signed_is_the_domain_the_sender_the_message_and_the_padded_content() -> None:
    part = signed_part(raw_frame(STATE))
    assert part[:17] == b"oneway-guidance/1"
    assert part[17:22] == bytes((254, 190)) + (0xA00100).to_bytes(3, "little")
    assert part[22:] == STATE[10:-2].ljust(163, b"\0")
    assert signed_part(raw_frame(FLEET))[22:] == FLEET[10:-2].ljust(raw_frame(FLEET).content_length, b"\0")


def test_a_sealed_state_has_these_bytes() -> None:
    sealed = sign(STATE, PRIVATE)
    assert sealed[10 + 163 : -2].hex() == (
        PRIVATE.sign(b"oneway-guidance/1" + STATE[5:10] + STATE[10:-2].ljust(163, b"\0")).hex()
    )
    assert len(sealed) == 239


@pytest.mark.slow
@given(name=st.sampled_from(sorted(FRAMES)), data=st.data())
def test_no_byte_of_sender_message_or_content_can_be_changed(name: str, data: st.DataObject) -> None:
    sealed = bytearray(sign(FRAMES[name], PRIVATE))
    at = data.draw(st.sampled_from([5, 6, *range(10, len(sealed) - 2)]))
    sealed[at] ^= data.draw(st.integers(1, 255))
    assert not verify(raw_frame(bytes(sealed)), PUBLIC)


def test_a_signature_is_worth_nothing_in_another_message() -> None:
    sealed = bytearray(sign(STATE, PRIVATE))
    sealed[7] = 0x01
    assert not verify(raw_frame(bytes(sealed)), PUBLIC)


def test_a_signature_that_ends_in_zeros_is_cut_on_the_wire_and_whole_again_when_checked() -> None:
    writer = Ground("unsigned", random.Random(1))
    for sequence in range(1, 4000):
        raw = writer.unsealed(START_S, sequence)
        sealed = sign(raw, PRIVATE)
        if len(sealed) < 12 + raw_frame(raw).content_length + ED25519_BYTES:
            break
    assert sealed[-3] != 0
    assert signature_of(raw_frame(sealed)) is not None
    assert verify(raw_frame(sealed), PUBLIC)


def test_both_strengths_together_are_undone_in_turn() -> None:
    frame_signer = FrameSigner(PRIVATE, MavlinkSigner(bytes(32), 1))
    both = frame_signer.sign(STATE, START_S)
    assert MavlinkVerifier(bytes(32)).check(raw_frame(both), START_S) is None
    assert verify(raw_frame(both), PUBLIC)
    assert strip_signature(raw_frame(both)) == sign(STATE, PRIVATE)
    assert frame_signer.overhead_bytes == len(both) - 12 - raw_frame(STATE).content_length == 77


@pytest.mark.parametrize(
    ("private_key", "signer", "overhead_bytes"),
    [(None, None, 0), (PRIVATE, None, 64), (None, MavlinkSigner(bytes(32), 1), 13)],
)
def test_a_sealer_signs_with_the_keys_it_has(
    private_key: Ed25519PrivateKey | None, signer: MavlinkSigner | None, overhead_bytes: int
) -> None:
    frame_signer = FrameSigner(private_key, signer)
    sealed = frame_signer.sign(STATE, START_S)
    assert frame_signer.overhead_bytes == overhead_bytes
    assert verify(raw_frame(sealed), PUBLIC) == (private_key is not None)
    assert (sealed[2] == 1) == (signer is not None)


def test_a_heartbeat_gets_a_mavlink_signature_only() -> None:
    heartbeat = bytes(
        oneway.MAVLink(None, 254, 190).heartbeat_encode(6, 8, 0, 0, 4).pack(oneway.MAVLink(None, 254, 190))
    )
    sealed = FrameSigner(PRIVATE, MavlinkSigner(bytes(32), 1)).sign(heartbeat, START_S)
    assert strip_signature(raw_frame(sealed)) == heartbeat


def test_a_copy_of_a_frame_costs_no_second_ed25519_signature() -> None:
    signed: list[bytes] = []

    class Counting:
        def sign(self, part: bytes) -> bytes:
            signed.append(part)
            return PRIVATE.sign(part)

    frame_signer = FrameSigner(Counting(), MavlinkSigner(bytes(32), 1))  # type: ignore[arg-type]
    first = frame_signer.sign(STATE, START_S)
    # A copy may have another MAVLink sequence number.
    head = STATE[:4] + bytes((STATE[4] + 9,)) + STATE[5:-2]
    copy = frame_signer.sign(head + crc_of(head, 0xA00100), START_S + 1)
    assert len(signed) == 1
    assert copy[4] == first[4] + 9
    assert verify(raw_frame(copy), PUBLIC)


def test_signatures_kept_for_copies_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ed25519, "REMEMBERED_SIGNATURES", 3)
    frame_signer = FrameSigner(PRIVATE, None)
    ground = Ground("unsigned", random.Random(1))
    for sequence in range(1, 10):
        frame_signer.sign(ground.unsealed(START_S, sequence), START_S)
    assert len(frame_signer._signatures) == 3


def test_a_frame_without_room_for_the_signature_is_refused() -> None:
    name = "n" * 200
    full = FrameWriter().encode(MissionFrame(STAMP, 1, 47.0, 8.0, 400.0, 50.0, 30.0, bytes(8), 2, 1, 0, name, bytes(8)))
    with pytest.raises(ValueError, match="leave no room for a signature of 64"):
        sign(full, PRIVATE)


def test_a_frame_with_a_mavlink_signature_is_not_sealed_any_more() -> None:
    with pytest.raises(ValueError, match="before it is given a MAVLink signature"):
        sign(MavlinkSigner(bytes(32), 1).sign(STATE, START_S), PRIVATE)


def test_the_private_key_is_in_no_words() -> None:
    secret = bytes(range(32))
    frame_signer = FrameSigner(PRIVATE, None)
    assert secret.hex() not in repr(frame_signer) + str(vars(frame_signer))
    assert repr(secret) not in repr(frame_signer) + str(vars(frame_signer))
