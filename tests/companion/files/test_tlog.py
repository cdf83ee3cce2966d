"""A log must open in everybody's tools and survive a crash."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavutil
from pymavlink.dialects.v20 import common

from companion.errors import InputError
from companion.files.tlog import TlogWriter, read_tlog, whole_frames

T0_UNIX_S = 1_790_000_000.25


def heartbeats(count: int) -> list[bytes]:
    mav = common.MAVLink(None, srcSystem=7, srcComponent=1)
    frames = []
    for sequence in range(count):
        mav.seq = sequence
        frames.append(mav.heartbeat_encode(2, 3, 81, sequence, 4).pack(mav))
    return frames


def signed_frame() -> bytes:
    mav = common.MAVLink(None, srcSystem=7, srcComponent=1)
    mav.signing.secret_key = bytes(32)
    mav.signing.sign_outgoing = True
    return bytes(mav.heartbeat_encode(2, 3, 81, 0, 4).pack(mav))


def write(path: Path, frames: list[bytes]) -> Path:
    with TlogWriter(path) as log:
        for index, frame in enumerate(frames):
            log.write(T0_UNIX_S + index * 0.5, frame)
    return path


@given(st.lists(st.tuples(st.integers(0, 2**52), st.binary(max_size=255), st.sampled_from([0, 1])), max_size=20))
def test_a_record_is_big_endian_microseconds_and_the_frame(records: list[tuple[int, bytes, int]]) -> None:
    frames = [
        bytes([0xFD, len(payload), signed]) + bytes(7) + payload + bytes(2 + 13 * signed)
        for _, payload, signed in records
    ]
    file = io.BytesIO()
    with TlogWriter(file) as log:
        for (stamp_us, _, _), frame in zip(records, frames, strict=True):
            log.write(stamp_us / 1e6, frame)
    expected = b"".join(
        struct.pack(">Q", stamp_us) + frame for (stamp_us, _, _), frame in zip(records, frames, strict=True)
    )
    assert file.getvalue() == expected


def test_frames_of_both_versions_and_signed_ones_are_read_back(tmp_path: Path) -> None:
    mav = common.MAVLink(None, srcSystem=7, srcComponent=1)
    version_1 = bytes(mav.heartbeat_encode(2, 3, 81, 0, 4).pack(mav, force_mavlink1=True))
    frames = [version_1, *heartbeats(2), signed_frame()]
    records = list(read_tlog(write(tmp_path / "a.tlog", frames)))
    assert records == [(T0_UNIX_S + index * 0.5, frame) for index, frame in enumerate(frames)]


@pytest.mark.parametrize("cut_bytes", range(1, 29))
def test_a_truncated_last_record_ends_the_log_quietly(tmp_path: Path, cut_bytes: int) -> None:
    path = write(tmp_path / "a.tlog", heartbeats(3))
    path.write_bytes(path.read_bytes()[:-cut_bytes])
    assert [frame for _, frame in read_tlog(path)] == heartbeats(2)


def test_a_log_longer_than_a_read_block_is_read_whole(tmp_path: Path) -> None:
    frames = heartbeats(200) * 200
    assert [frame for _, frame in read_tlog(write(tmp_path / "long.tlog", frames))] == frames


def test_a_missing_file_is_named_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.tlog: cannot read the log: No such file"):
        read_tlog(tmp_path / "nowhere.tlog")


def test_a_file_that_is_no_log_is_named(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("these are only words, not telemetry")
    with pytest.raises(InputError, match=r"no MAVLink frame in 35 bytes; is it a \.tlog\?"):
        list(read_tlog(path))


def test_a_log_that_cannot_be_written_is_named_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot write the log"):
        TlogWriter(tmp_path / "no folder" / "a.tlog")


@pytest.mark.parametrize("junk", [b"", b"\xfd", b"hello world", heartbeats(1)[0][:-1], heartbeats(1)[0] * 2])
def test_only_one_whole_frame_makes_a_record(junk: bytes) -> None:
    with pytest.raises(ValueError, match="exactly one whole"):
        TlogWriter(io.BytesIO()).write(0.0, junk)


def test_a_file_of_the_callers_stays_open() -> None:
    file = io.BytesIO()
    with TlogWriter(file) as log:
        log.write(1.0, heartbeats(1)[0])
    assert not file.closed


def test_pymavlink_reads_the_frames_and_their_times(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tlog", heartbeats(3))
    reader = mavutil.mavlink_connection(str(path))
    seen = []
    while (message := reader.recv_match(type="HEARTBEAT")) is not None:
        seen.append((message._timestamp, message.custom_mode))
    reader.close()
    assert seen == [(T0_UNIX_S + index * 0.5, index) for index in range(3)]


@pytest.mark.slow
def test_mavlogdump_prints_every_frame(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tlog", heartbeats(3))
    done = subprocess.run(
        [sys.executable, "-m", "pymavlink.tools.mavlogdump", "--types", "HEARTBEAT", str(path)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout.count("HEARTBEAT {") == 3


def test_a_datagram_is_taken_apart_into_its_whole_frames_and_junk_ends_it() -> None:
    frame = bytes([0xFD, 1, 0, 0, 0, 1, 1, 0, 0, 0, 7, 0xAA, 0xBB])
    assert list(whole_frames(frame + frame)) == [frame, frame]
    assert list(whole_frames(frame + b"junk" + frame)) == [frame]
    assert list(whole_frames(frame[:-1])) == []
    assert list(whole_frames(b"")) == []
