"""Frames are found whole in anything that arrives, and nothing that is none is ever given."""

from __future__ import annotations

import random
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.files.mavlink_layout import MARKER_V2, MAX_FRAME_BYTES
from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM, FrameWriter, RadiiFrame, Stamp
from companion.protocol.deframer import (
    DAMAGED,
    FOREIGN,
    INCOMPLETE,
    JUNK,
    MAVLINK_1,
    MAX_FALSE_STARTS,
    StreamFramer,
    crc_of,
    frames_in,
)
from companion.protocol.frame import raw_frame
from companion.protocol.mavlink_signing import MavlinkSigner
from companion.protocol.v2_extension import wrap
from tests.companion.protocol.hostile import START_S, Ground

GROUND = Ground("both", random.Random(5))
PLAIN = [GROUND.unsealed(START_S + index) for index in range(4)]
SEALED = [GROUND.frame(START_S + index) for index in range(4)]
JUNK_DATAGRAM = b"\xfd\xff\x01"
"""Three bytes that make a persistent stock parser swallow the ten messages that follow."""


def found(datagram: bytes) -> tuple[list[bytes], Counter[str]]:
    skipped: Counter[str] = Counter()
    return [frame.data for frame in frames_in(datagram, skipped)], skipped


def fed(chunks: list[bytes]) -> tuple[list[bytes], StreamFramer]:
    framer = StreamFramer()
    return [frame.data for chunk in chunks for frame in framer.feed(chunk)], framer


def test_the_frames_of_a_datagram_come_in_order_and_nothing_is_skipped() -> None:
    assert found(b"".join(PLAIN + SEALED)) == (PLAIN + SEALED, Counter())


def test_the_header_says_who_sent_what() -> None:
    (header,) = frames_in(SEALED[0], Counter())
    assert (header.system, header.component, header.message_id) == (GROUND_SYSTEM, GROUND_COMPONENT, 0xA00100)
    assert header.payload_length == len(header.payload) == SEALED[0][1]
    assert header.is_signed
    assert not raw_frame(PLAIN[0]).is_signed


def test_the_crc_is_that_of_pymavlink() -> None:
    assert crc_of(PLAIN[0][:-2], 0xA00100) == PLAIN[0][-2:]


@pytest.mark.parametrize(
    ("junk", "reason"),
    [
        (b"noise", JUNK),
        (b"\xfe\x09" + bytes(15), MAVLINK_1),
        (PLAIN[1][:-1] + b"\x00", DAMAGED),
        (PLAIN[1][:30], DAMAGED),
        (bytes((MARKER_V2, 9, 2)) + bytes(20), DAMAGED),
        (bytes((MARKER_V2, 9, 0, 0, 0, 1, 1)) + (30).to_bytes(3, "little") + bytes(11), FOREIGN),
        (JUNK_DATAGRAM, FOREIGN),
    ],
)
def test_junk_before_a_frame_costs_one_count_and_no_frame(junk: bytes, reason: str) -> None:
    frames, skipped = found(junk + SEALED[0])
    assert frames == [SEALED[0]]
    assert skipped == Counter({reason: 1})


def test_a_datagram_that_ends_within_a_frame_counts_as_incomplete() -> None:
    assert found(SEALED[0] + SEALED[1][:-1]) == ([SEALED[0]], Counter({INCOMPLETE: 1}))


def test_the_junk_datagram_swallows_nothing() -> None:
    datagrams = [JUNK_DATAGRAM, *SEALED]
    assert [frame for datagram in datagrams for frame in found(datagram)[0]] == SEALED
    frames, framer = fed(datagrams)
    assert frames == SEALED
    assert framer.skipped.total() == 1


def test_a_frame_whose_signature_was_cut_off_takes_nothing_from_the_next() -> None:
    # The signature is not under the CRC: with the next frame's first bytes for its end, the frame looks whole.
    cut = SEALED[0][:-5]
    frames, _ = found(cut + SEALED[1])
    assert frames[-1] == SEALED[1]
    frames, _ = fed([cut, SEALED[1]])
    assert frames[-1] == SEALED[1]


def test_the_work_for_one_datagram_is_bounded() -> None:
    false_starts = bytes((MARKER_V2,)) * MAX_FALSE_STARTS
    assert found(false_starts[:-1] + SEALED[0])[0] == [SEALED[0]]
    assert found(false_starts + SEALED[0])[0] == []


@given(data=st.binary(max_size=600))
def test_no_bytes_raise_and_what_is_found_is_a_part_of_them(data: bytes) -> None:
    frames, _ = found(data)
    assert all(frame in data for frame in frames)


@given(
    pieces=st.lists(
        st.one_of(
            st.sampled_from(PLAIN + SEALED),
            st.binary(min_size=1, max_size=40).filter(lambda junk: MARKER_V2 not in junk),
        ),
        max_size=8,
    ),
    cuts=st.lists(st.integers(1, 90), min_size=1, max_size=20),
)
def test_a_stream_gives_every_frame_however_it_is_cut(pieces: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(pieces)
    chunks = []
    for cut in cuts:
        chunks.append(stream[:cut])
        stream = stream[cut:]
    frames, _ = fed([*chunks, stream])
    assert frames == [piece for piece in pieces if piece in PLAIN + SEALED]


def test_a_frame_in_a_stream_is_given_with_its_last_byte_though_a_longer_one_seems_to_have_begun() -> None:
    false_start = bytes((MARKER_V2, 255, 0, 0, 0)) + PLAIN[0][5:10]
    framer = StreamFramer()
    assert framer.feed(false_start) == []
    assert framer.feed(SEALED[0][:-1]) == []
    assert framer.feed(SEALED[0][-1:]) == [raw_frame(SEALED[0])]
    assert framer.feed(SEALED[1]) == [raw_frame(SEALED[1])]
    assert framer.skipped == Counter({DAMAGED: 1})


@pytest.mark.parametrize("noise", [bytes((MARKER_V2,)), bytes((MARKER_V2, 255, 0, 0, 0)) + PLAIN[0][5:10], b"\x00"])
def test_a_stream_keeps_less_than_a_frame_whatever_it_is_fed(noise: bytes) -> None:
    framer = StreamFramer()
    for _ in range(500):
        framer.feed(noise * 7)
        assert len(framer._kept) < MAX_FRAME_BYTES


def test_a_run_of_junk_in_a_stream_counts_once_however_many_chunks_it_takes() -> None:
    frames, framer = fed([b"noise", b"more noise", SEALED[0], b"x"])
    assert frames == [SEALED[0]]
    assert framer.skipped == Counter({JUNK: 2})


def test_a_signed_frame_with_a_marker_in_its_signature_counts_nothing() -> None:
    signer = MavlinkSigner(bytes(32), link_id=MARKER_V2)
    raw = signer.sign(PLAIN[0], START_S)
    assert found(raw + SEALED[0]) == ([raw, SEALED[0]], Counter())


SEALED_ONCE = [Ground("ed25519", random.Random(5)).frame(START_S + index) for index in range(4)]
"""Frames that fit into a V2_EXTENSION, as a state with both signatures does not."""
WRAPPED = [wrap(raw, number) for number, raw in enumerate(PLAIN + SEALED_ONCE)]


def test_frames_inside_v2_extensions_come_out_of_a_datagram_as_if_they_had_come_alone() -> None:
    assert found(b"".join(WRAPPED)) == (PLAIN + SEALED_ONCE, Counter())
    assert found(WRAPPED[0]) == ([PLAIN[0]], Counter())


@pytest.mark.parametrize("size", [1, 7, 300])
def test_frames_inside_v2_extensions_come_out_of_a_stream(size: int) -> None:
    data = b"".join([*WRAPPED, SEALED[0]])
    frames, framer = fed([data[at : at + size] for at in range(0, len(data), size)])
    assert frames == [*PLAIN, *SEALED_ONCE, SEALED[0]]
    assert framer.skipped == Counter()


def test_a_wrapped_frame_whose_last_zeros_were_cut_comes_out_whole() -> None:
    writer = FrameWriter()
    stamps = (Stamp(1_790_000_000, 0, sequence) for sequence in range(70_000))
    frames = (writer.encode(RadiiFrame(stamp, 1, 100, ())) for stamp in stamps)
    raw = next(frame for frame in frames if frame[-1] == 0)
    assert found(wrap(raw, 0)) == ([raw], Counter())


def test_a_damaged_frame_inside_a_sound_v2_extension_is_damaged() -> None:
    assert found(wrap(PLAIN[0][:-1] + bytes([PLAIN[0][-1] ^ 1]), 0)) == ([], Counter({DAMAGED: 1}))


def test_what_comes_out_of_nested_v2_extensions_is_a_frame_of_ours_or_nothing() -> None:
    assert found(wrap(wrap(PLAIN[0], 0), 1))[0] == [PLAIN[0]]
    assert found(wrap(wrap(wrap(b"\xfd" + bytes(11), 0), 0), 0))[0] == []


def test_a_v2_extension_of_others_is_foreign_and_hides_nothing() -> None:
    other = common.MAVLink_v2_extension_message(0, 0, 0, 40_000, [*PLAIN[0], *bytes(249 - len(PLAIN[0]))])
    raw = bytes(other.pack(common.MAVLink(None)))
    frames, skipped = found(raw + PLAIN[1])
    assert frames == [PLAIN[0], PLAIN[1]]
    assert skipped[FOREIGN] == 1
