"""What the lane's wire and flood put between a companion and the world."""

from __future__ import annotations

import random

from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v10 import common as mavlink_1
from pymavlink.dialects.v20 import common as mavlink

from companion.protocol.authenticator import Authenticator
from companion.protocol.deframer import crc_of
from companion.protocol.frame import raw_frame
from tests.companion.protocol.hostile import START_S, Ground
from tests.real.flood import forged_frames
from tests.real.wire import whole_frames


def _telemetry() -> list[bytes]:
    """Return frames of an autopilot: MAVLink 2, MAVLink 2 signed, and MAVLink 1."""
    plain, signed, old = mavlink.MAVLink(None, 1, 1), mavlink.MAVLink(None, 1, 1), mavlink_1.MAVLink(None, 1, 1)
    signed.signing.secret_key, signed.signing.sign_outgoing = bytes(32), True
    heartbeat = (2, 3, 81, 4, 4, 3)
    position = mavlink.MAVLink_global_position_int_message(1000, 1, 2, 3, 4, 5, 6, 7, 8)
    return [
        bytes(mavlink.MAVLink_heartbeat_message(*heartbeat).pack(plain)),
        bytes(mavlink.MAVLink_heartbeat_message(*heartbeat).pack(signed)),
        bytes(mavlink_1.MAVLink_heartbeat_message(*heartbeat).pack(old)),
        bytes(position.pack(plain)),
    ]


@given(st.lists(st.integers(0, 3), min_size=1, max_size=20), st.lists(st.integers(1, 40), min_size=1))
def test_frames_come_out_whole_however_the_stream_is_cut(numbers: list[int], cuts: list[int]) -> None:
    frames = [_telemetry()[number] for number in numbers]
    found: list[bytes] = []
    stream, received, cut = b"".join(frames), bytearray(), 0
    while stream:
        received += stream[: cuts[cut % len(cuts)]]
        stream = stream[cuts[cut % len(cuts)] :]
        cut += 1
        found += whole_frames(received)
    assert found == frames
    assert not received


def test_what_floods_is_whole_and_is_not_believed() -> None:
    trust = Ground("both", random.Random(1)).trust
    for frame in forged_frames(20):
        raw = raw_frame(frame)
        assert frame[raw.crc_at : raw.crc_at + 2] == crc_of(frame[: raw.crc_at], raw.message_id)
        assert list(Authenticator(trust).admit(frame, START_S)) == []


def test_a_first_byte_that_begins_no_frame_is_passed_over() -> None:
    received = bytearray(b"\x00\x01" + _telemetry()[0])
    assert list(whole_frames(received)) == _telemetry()[:1]
