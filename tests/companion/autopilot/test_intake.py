"""The intake of an autopilot's link: whole frames out of pieces of any size, of any sender, and nothing else."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega, common

from companion.autopilot.intake import DAMAGED, JUNK, MAX_SOURCES, UNKNOWN, Deframer, Intake, decode
from companion.files.mavlink_layout import MAX_FRAME_BYTES
from companion.protocol.frame import raw_frame
from companion.protocol.v2_extension import wrap

_MAV = common.MAVLink(None, srcSystem=1, srcComponent=1)
HEARTBEAT = bytes(common.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3).pack(_MAV))
OLD_HEARTBEAT = bytes(common.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3).pack(_MAV, force_mavlink1=True))
LONG_TEXT = bytes(common.MAVLink_statustext_message(6, b"x" * 50, 1, 0).pack(_MAV))
WRAPPED = wrap(HEARTBEAT, 7)
"""A frame that carries another one as its content."""
WIND = bytes(ardupilotmega.MAVLink_wind_message(90.0, 5.0, 0.0).pack(_MAV))
FRAMES = (HEARTBEAT, OLD_HEARTBEAT, LONG_TEXT, WRAPPED, WIND)
UNKNOWN_FRAME = HEARTBEAT[:7] + b"\xff\xff\xff" + HEARTBEAT[10:]


def pieces(stream: bytes, sizes: list[int]) -> list[bytes]:
    cut = []
    for size in [*sizes, len(stream) + 1]:
        cut.append(stream[:size])
        stream = stream[size:]
    return cut


def found(*chunks: bytes) -> list[bytes]:
    deframer = Deframer(Counter())
    return [frame.data for chunk in chunks for frame in deframer.feed(chunk)]


@given(st.lists(st.sampled_from(FRAMES), max_size=8), st.lists(st.integers(1, 40), max_size=60))
def test_the_same_frames_are_found_wherever_a_stream_is_cut(frames: list[bytes], sizes: list[int]) -> None:
    assert found(*pieces(b"".join(frames), sizes)) == frames


@given(st.binary(max_size=200), st.sampled_from(FRAMES))
def test_no_noise_before_a_frame_costs_the_frame(noise: bytes, frame: bytes) -> None:
    assert frame in found(noise + frame)


def test_a_false_start_does_not_hold_back_what_follows_it() -> None:
    assert found(HEARTBEAT[:1] + b"\xff\x00" + HEARTBEAT) == [HEARTBEAT]


@given(st.integers(1, len(WRAPPED) - 1))
def test_what_a_frame_carries_is_not_taken_for_a_frame_of_its_sender(cut: int) -> None:
    assert found(WRAPPED[:cut], WRAPPED[cut:]) == [WRAPPED]


def test_a_damaged_frame_and_an_unknown_message_are_passed_over_and_counted() -> None:
    damaged = HEARTBEAT[:12] + bytes([HEARTBEAT[12] ^ 1]) + HEARTBEAT[13:]
    intake = Intake()
    assert [
        frame.data for frame in intake.feed(damaged + LONG_TEXT + b"junk" + LONG_TEXT + UNKNOWN_FRAME + HEARTBEAT)
    ] == [
        LONG_TEXT,
        LONG_TEXT,
        HEARTBEAT,
    ]
    assert intake.skipped == {DAMAGED: 1, UNKNOWN: 1, JUNK: 1}


def test_an_unknown_message_is_skipped_whole_with_what_it_carries() -> None:
    head = UNKNOWN_FRAME[:1] + bytes([len(HEARTBEAT)]) + UNKNOWN_FRAME[2:10]
    carrier = head + HEARTBEAT + b"\0\0"
    assert found(LONG_TEXT + carrier + LONG_TEXT) == [LONG_TEXT, LONG_TEXT]
    # Its length may be noise: then what follows does not begin a frame, and every frame is looked for.
    assert found(LONG_TEXT + carrier[:-1] + LONG_TEXT) == [LONG_TEXT, HEARTBEAT, LONG_TEXT]


@given(st.lists(st.tuples(st.integers(0, 2), st.integers(1, 30)), max_size=80))
def test_the_pieces_of_one_sender_do_not_disturb_those_of_another(turns: list[tuple[int, int]]) -> None:
    streams = [b"".join(FRAMES), b"".join(reversed(FRAMES)), b"\xfd\x09\x00" * 30]
    intake, heard = Intake(), Counter[int]()
    for source, size in [*turns, (0, 10_000), (1, 10_000), (2, 10_000)]:
        chunk, streams[source] = streams[source][:size], streams[source][size:]
        heard[source] += len(intake.feed(chunk, source))
    assert heard == {0: len(FRAMES), 1: len(FRAMES), 2: 0}


@given(st.lists(st.binary(max_size=400), max_size=20))
def test_any_bytes_are_survived_and_little_is_kept(chunks: list[bytes]) -> None:
    deframer = Deframer(Counter())
    for chunk in chunks:
        deframer.feed(chunk)
        assert len(deframer._kept) < MAX_FRAME_BYTES


def test_any_number_of_senders_is_survived_and_few_are_kept() -> None:
    intake = Intake()
    for port in range(1_000):
        intake.feed(HEARTBEAT[:10], ("127.0.0.1", port))
    assert len(intake._streams) == MAX_SOURCES


@pytest.mark.parametrize("data", [HEARTBEAT, OLD_HEARTBEAT], ids=["MAVLink 2", "MAVLink 1"])
def test_both_versions_are_decoded_alike(data: bytes) -> None:
    message = decode(raw_frame(data))
    assert message is not None
    assert (message.get_type(), message.custom_mode, message.get_srcSystem()) == ("HEARTBEAT", 4, 1)
