"""A log gives away no signature and no key, however deep they are wrapped."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.files.mavlink_layout import SIGNATURE_BYTES, crc_extra_of
from companion.protocol.frame import raw_frame
from companion.protocol.log_secrets import without_secrets
from companion.protocol.mavlink_signing import MavlinkSigner
from companion.protocol.v2_extension import wrap

KEY = bytes(range(32))
FRAME = bytes(
    common.MAVLink_heartbeat_message(6, 8, 0, 0xFD01FD, 4, 3).pack(common.MAVLink(None, srcSystem=255, srcComponent=1))
)
SETUP = bytes(
    common.MAVLink_setup_signing_message(1, 1, list(range(1, 33)), 1).pack(
        common.MAVLink(None, srcSystem=255, srcComponent=190)
    )
)


def tunnelled(inner: bytes) -> bytes:
    sender = common.MAVLink(None, srcSystem=1, srcComponent=1)
    payload = list(inner.ljust(128, b"\0"))
    return bytes(common.MAVLink_tunnel_message(1, 1, 40_000, len(inner), payload).pack(sender))


def signed(frame: bytes) -> bytes:
    return MavlinkSigner(KEY, 0).sign(frame, 1.8e9)


def kept(frame: bytes) -> bytes:
    harmless = without_secrets(raw_frame(frame))
    assert harmless is not None
    return harmless


def test_a_signature_is_cut_off_and_a_frame_without_one_is_kept_as_it_is() -> None:
    assert kept(signed(FRAME)) == FRAME
    for frame in (FRAME, bytes([0xFE, 1, 0, 1, 1, 0, 9, 0, 0]), wrap(FRAME, 0), tunnelled(FRAME)):
        assert kept(frame) == frame


@pytest.mark.parametrize("carry", [lambda frame: wrap(frame, 7), tunnelled, lambda frame: wrap(wrap(frame, 1), 2)])
def test_the_signature_of_a_frame_in_another_one_is_overwritten(carry: object) -> None:
    assert callable(carry)
    inner = signed(FRAME)
    harmless = kept(carry(inner))
    assert inner[-SIGNATURE_BYTES:] not in harmless and inner[-6:] not in harmless
    # What is left are whole frames, the inner one with zeros for its signature.
    assert inner[:-SIGNATURE_BYTES] + bytes(6) in harmless + bytes(SIGNATURE_BYTES)
    assert crc_extra_of(harmless) == crc_extra_of(carry(inner))


@given(st.lists(st.sampled_from(["wrap", "sign"]), max_size=8), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_no_hash_is_left_at_any_depth(steps: list[str], mode: int) -> None:
    sender = common.MAVLink(None, srcSystem=1, srcComponent=1)
    frame = signed(bytes(common.MAVLink_heartbeat_message(6, 8, 0, mode, 4, 3).pack(sender)))
    hashes = [frame[-6:]]
    for step in steps:
        if step == "wrap" and len(frame) <= 249:
            frame = wrap(frame, 0)
        elif step == "sign":
            frame = signed(frame[: raw_frame(frame).crc_at + 2])
            hashes.append(frame[-6:])
    harmless = kept(frame)
    assert not any(each in harmless for each in hashes)
    assert kept(harmless) == harmless


@pytest.mark.parametrize("frame", [SETUP, wrap(SETUP, 0), tunnelled(SETUP), wrap(wrap(SETUP, 0), 0)])
def test_a_frame_that_carries_a_key_is_never_kept(frame: bytes) -> None:
    assert without_secrets(raw_frame(frame)) is None


@given(st.binary(max_size=255))
@settings(max_examples=200, deadline=None)
def test_any_bytes_in_a_frame_are_kept_or_the_frame_is_left_out(payload: bytes) -> None:
    frame = bytes([0xFD, len(payload), 0, 0, 1, 1, 1, 248, 0, 0]) + payload + b"\1\2"
    harmless = without_secrets(raw_frame(frame))
    assert harmless is None or len(harmless) == len(frame)
