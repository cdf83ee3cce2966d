"""Frames inside V2_EXTENSION: what comes out is what went in, and nothing else comes out."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.protocol.codec import FrameWriter
from companion.protocol.dialect import oneway
from companion.protocol.frame import raw_frame, raw_frames
from companion.protocol.mavlink_signing import MavlinkSigner
from companion.protocol.messages import Directive, Stamp, StateFrame
from companion.protocol.v2_extension import WRAP_BYTES, unwrap, wrap

FRAME = FrameWriter().encode(
    StateFrame(Stamp(1_790_000_000, 250, 7), 47.0, 8.0, Directive.HOLD, 1, 0, 0, 100, (), (), ())
)
KEY = bytes(range(32))
NOW_S = 1_790_000_000.0


def test_a_wrapped_frame_is_unwrapped_unchanged() -> None:
    assert unwrap(raw_frame(wrap(FRAME, 0))) == FRAME


def test_a_signed_frame_is_unwrapped_with_its_signature() -> None:
    signed = MavlinkSigner(KEY, 0).sign(FRAME, NOW_S)
    assert unwrap(raw_frame(wrap(signed, 255))) == signed


def test_wrapping_adds_what_a_radio_reckons_with() -> None:
    signed = MavlinkSigner(KEY, 0).sign(FRAME, NOW_S)
    assert signed[-1] != 0
    assert len(wrap(signed, 1)) == len(signed) + WRAP_BYTES


@given(st.binary(min_size=1, max_size=100), st.integers(0, 40))
def test_zeros_cut_at_the_end_are_put_back_by_the_inner_length(body: bytes, zeros: int) -> None:
    inner = bytes([0xFD, len(body) + zeros, 0]) + bytes(7) + body + bytes(zeros) + b"\0\0"
    assert unwrap(raw_frame(wrap(inner, 3))) == inner


def test_the_field_reads_it_as_a_v2_extension_of_the_ground_station() -> None:
    (message,) = common.MAVLink(None).parse_buffer(wrap(FRAME, 9))
    assert message.get_type() == "V2_EXTENSION"
    assert (message.get_srcSystem(), message.get_srcComponent(), message.get_seq()) == (254, 190, 9)
    assert (message.target_network, message.target_system, message.target_component) == (0, 0, 0)
    assert bytes(message.payload[: len(FRAME)]) == FRAME


def test_an_autopilot_may_pass_it_on_re_packed_and_signed() -> None:
    (message,) = common.MAVLink(None).parse_buffer(wrap(FRAME, 9))
    autopilot = common.MAVLink(None, srcSystem=1, srcComponent=1)
    autopilot.signing.secret_key = KEY
    autopilot.signing.sign_outgoing = True
    passed_on = bytes(message.pack(autopilot))
    assert len(passed_on) == len(FRAME) + WRAP_BYTES + 13
    assert unwrap(raw_frame(passed_on)) == FRAME


def test_what_does_not_fit_the_payload_area_is_refused() -> None:
    assert unwrap(raw_frame(wrap(bytes([0xFD, 237, 0]) + b"x" * 246, 0))) is not None
    with pytest.raises(ValueError, match="250 bytes in a V2_EXTENSION; allowed: at most 249"):
        wrap(bytes([0xFD, 238, 0]) + b"x" * 247, 0)


def test_another_v2_extension_is_not_ours() -> None:
    other = common.MAVLink_v2_extension_message(0, 0, 0, 40_000, [*FRAME, *bytes(249 - len(FRAME))])
    assert unwrap(raw_frame(bytes(other.pack(common.MAVLink(None))))) is None


def test_a_frame_that_is_not_wrapped_is_not_unwrapped() -> None:
    assert unwrap(raw_frame(FRAME)) is None


def test_an_inner_frame_longer_than_it_says_is_refused() -> None:
    assert unwrap(raw_frame(wrap(FRAME + b"x", 0))) is None


@given(st.integers(0, len(wrap(FRAME, 0)) - 1), st.integers(1, 255))
def test_a_damaged_wrapping_gives_nothing(at: int, flip: int) -> None:
    damaged = bytearray(wrap(FRAME, 0))
    damaged[at] ^= flip
    assert [inner for frame in raw_frames(bytes(damaged)) if (inner := unwrap(frame)) is not None] == []


@given(st.binary(max_size=300))
def test_nothing_received_raises(junk: bytes) -> None:
    for datagram in (junk, b"\xfd" + junk, wrap(FRAME, 0)[: len(junk)]):
        for frame in raw_frames(datagram):
            unwrap(frame)


def test_the_checks_of_both_dialects_agree() -> None:
    assert common.mavlink_map[248].crc_extra == 8
    assert 248 not in oneway.mavlink_map
