"""A raw frame says what its bytes say, of either version of MAVLink."""

from __future__ import annotations

import random

import pytest
from pymavlink.dialects.v20 import common

from companion.files.mavlink_layout import frame_length, frame_parts
from companion.protocol.frame import ED25519_BYTES, raw_frame, raw_frames
from tests.companion.protocol.hostile import START_S, Ground

MAV = common.MAVLink(None, srcSystem=7, srcComponent=8)
STATUS = common.MAVLink_radio_status_message(200, 200, 40, 30, 30, 1, 2)
VERSIONS = {version: bytes(STATUS.pack(MAV, force_mavlink1=version == 1)) for version in (1, 2)}
SIGNED = Ground("both", random.Random(3)).frame(START_S + 1.25)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_frame_of_either_version_says_who_sent_what(version: int) -> None:
    frame = raw_frame(VERSIONS[version])
    assert (frame.version, frame.sender, frame.message_id) == (version, (7, 8), common.MAVLINK_MSG_ID_RADIO_STATUS)
    assert (frame.payload_length, len(frame.payload)) == (9, 9)
    assert (frame.is_signed, frame.signature) == (False, b"")


@pytest.mark.parametrize("data", [*VERSIONS.values(), SIGNED], ids=["MAVLink 1", "MAVLink 2", "signed"])
def test_the_layout_agrees_with_the_frame(data: bytes) -> None:
    frame = raw_frame(data)
    assert frame_parts(data) == (frame.message_id, frame.header_bytes, frame.crc_at, len(data))
    assert frame_length(data) == len(data)
    assert frame_parts(b"junk" + data, 4)[3] == 4 + len(data)


def test_a_signed_broadcast_knows_its_stamp_its_content_and_its_signatures() -> None:
    frame = raw_frame(SIGNED)
    assert frame.stamp == (int(START_S), 1250, 1)
    # Zeros at the end of the Ed25519 signature are cut.
    assert 0 < frame.payload_length - frame.content_length <= ED25519_BYTES
    assert frame.signed_content == SIGNED[5 : 10 + frame.content_length]
    assert len(frame.signature) == 13


def test_a_datagram_is_taken_apart_into_raw_frames_up_to_the_first_junk() -> None:
    one, two = VERSIONS.values()
    assert [frame.data for frame in raw_frames(one + two + b"junk" + one)] == [one, two]
