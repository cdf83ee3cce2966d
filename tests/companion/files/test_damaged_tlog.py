"""A damaged log is read up to the damage and beyond it, and what was left out is said."""

from __future__ import annotations

import errno
import io
import os
import random
import struct
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.files import tlog
from companion.files.mavlink_layout import crc_extra_of
from companion.files.tlog import LeftOut, TlogWriter, read_tlog

T0_UNIX_S = 1_790_000_000.25
Record = tuple[float, bytes]


def frames(count: int) -> list[bytes]:
    """Frames of both versions, signed and not, of several lengths."""
    mav = common.MAVLink(None, srcSystem=7, srcComponent=1)
    made = []
    for number in range(count):
        mav.seq = number % 256
        mav.signing.secret_key = bytes(32)
        mav.signing.sign_outgoing = number % 5 == 4
        message = (
            mav.heartbeat_encode(2, 3, 81, number, 4),
            mav.attitude_encode(number * 100, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
            mav.statustext_encode(6, b"words that a person reads, \xfe\xfd among them"),
        )[number % 3]
        made.append(bytes(message.pack(mav, force_mavlink1=number % 7 == 3)))
    return made


RECORDS: list[Record] = [(T0_UNIX_S + 0.5 * number, frame) for number, frame in enumerate(frames(60))]


def content(records: list[Record] = RECORDS) -> bytes:
    file = io.BytesIO()
    with TlogWriter(file) as log:
        for t_unix_s, frame in records:
            log.write(t_unix_s, frame)
    return file.getvalue()


WHOLE = content()
STARTS = [len(content(RECORDS[:number])) for number in range(len(RECORDS) + 1)]
"""Offsets of the records, and of the end."""


def read(folder: Path, data: bytes) -> tuple[list[Record], tlog.Tlog]:
    path = folder / "a.tlog"
    path.write_bytes(data)
    log = read_tlog(path)
    return list(log), log


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("logs")


def test_a_whole_log_is_said_to_be_whole(folder: Path) -> None:
    records, log = read(folder, WHOLE)
    assert (records, log.whole, log.words) == (RECORDS, True, "")


def test_zeros_at_the_start_are_passed_over_and_said(folder: Path) -> None:
    records, log = read(folder, bytes(4096) + WHOLE)
    assert (records, log.left_out, log.whole) == (RECORDS, [LeftOut(0, 4096)], False)
    assert log.words == "left out 4 096 bytes at 0"


@given(
    st.integers(0, len(RECORDS) - 1),
    st.integers(0, 400),
    st.one_of(st.binary(max_size=400), st.integers(1, 400).map(bytes), st.integers(1, 400).map(lambda n: b"\xfe" * n)),
)
@settings(max_examples=150, deadline=None)
def test_bytes_put_in_the_place_of_others_cost_at_most_the_records_that_they_touch(
    folder: Path, first: int, removed: int, junk: bytes
) -> None:
    # At any place of a record, or between two; nothing removed, nothing put in, or both.
    at = STARTS[first] + (removed * 7 + len(junk)) % (STARTS[first + 1] - STARTS[first])
    removed = min(removed, len(WHOLE) - at)
    records, log = read(folder, WHOLE[:at] + junk + WHOLE[at + removed :])
    untouched = [
        record
        for record, start, end in zip(RECORDS, STARTS, STARTS[1:], strict=False)
        if end <= at or start >= at + removed
    ]
    # What else is delivered lies where the damage is.
    delivered = iter(records)
    assert all(record in delivered for record in untouched)
    assert len(WHOLE) - removed + len(junk) == log.bytes_left_out + sum(8 + len(frame) for _, frame in records)


@pytest.mark.parametrize("number", [0, 29, 30])
def test_a_damaged_length_that_reaches_to_a_later_record_hides_none_between(folder: Path, number: int) -> None:
    data = bytearray(WHOLE)
    for later in range(number + 2, number + 5):
        length = STARTS[later] - STARTS[number] - (len(RECORDS[number][1]) - data[STARTS[number] + 9]) - 8
        data[STARTS[number] + 9] = length
        records, log = read(folder, bytes(data))
        assert records == RECORDS[:number] + RECORDS[number + 1 :]
        assert log.left_out == [LeftOut(STARTS[number], STARTS[number + 1] - STARTS[number])]
        data[:] = WHOLE


@given(st.integers(0, 2**32), st.lists(st.integers(1, 60), min_size=1, max_size=6))
@settings(max_examples=100, deadline=None)
def test_several_places_of_junk_between_records_cost_no_record(folder: Path, seed: int, at_records: list[int]) -> None:
    drawn = random.Random(seed)
    data = WHOLE
    for start in sorted({STARTS[number] for number in at_records}, reverse=True):
        data = data[:start] + drawn.randbytes(drawn.randint(1, 5_000)) + data[start:]
    records, log = read(folder, data)
    assert records == RECORDS
    assert log.places == len(set(at_records))


@given(st.integers(0, len(WHOLE)))
@settings(max_examples=60, deadline=None)
def test_a_log_that_is_cut_anywhere_delivers_the_records_before_the_cut(folder: Path, at: int) -> None:
    path = folder / "cut.tlog"
    path.write_bytes(WHOLE[:at])
    whole = [record for record, end in zip(RECORDS, STARTS[1:], strict=True) if end <= at]
    if not whole and at:
        return
    assert list(read_tlog(path)) == whole


def test_damage_longer_than_a_read_block_is_passed_over(folder: Path) -> None:
    junk = random.Random(1).randbytes(2 * tlog._READ_BLOCK_BYTES + 17)
    records, log = read(folder, WHOLE[: STARTS[30]] + junk + WHOLE[STARTS[30] :])
    assert (records, log.left_out) == (RECORDS, [LeftOut(STARTS[30], len(junk))])


def test_many_places_are_counted_and_a_few_are_named(folder: Path) -> None:
    data = b"".join(WHOLE[a:b] + b"\0\0\0" for a, b in zip(STARTS, STARTS[1:], strict=False))
    records, log = read(folder, data)
    assert records == RECORDS
    assert log.words.startswith(f"left out 3 bytes at {STARTS[1]}, 3 at ")
    assert log.words.endswith(", 180 at 60 places in all"), log.words


@pytest.mark.parametrize("absurd_us", [0, 2**53, 2**64 - 1])
@pytest.mark.parametrize("number", [0, 1, 30, 31, len(RECORDS) - 1])
def test_an_absurd_time_is_replaced_by_a_neighbours(folder: Path, number: int, absurd_us: int) -> None:
    data = bytearray(WHOLE)
    data[STARTS[number] : STARTS[number] + 8] = struct.pack(">Q", absurd_us)
    records, log = read(folder, bytes(data))
    assert [frame for _, frame in records] == [frame for _, frame in RECORDS]
    assert all(abs(t_s - T0_UNIX_S) < 60.0 for t_s, _ in records)
    assert (log.restamped, log.words) == (1, "1 absurd times replaced by their neighbours'")


def test_a_step_of_the_clock_that_stays_is_kept(folder: Path) -> None:
    stepped = [(t_s if number >= 20 else 0.5 * number, frame) for number, (t_s, frame) in enumerate(RECORDS)]
    records, log = read(folder, content(stepped))
    assert (records, log.whole) == (stepped, True)


def test_times_that_go_back_a_little_are_kept(folder: Path) -> None:
    swapped = [(RECORDS[number ^ 1][0], frame) for number, (_, frame) in enumerate(RECORDS)]
    records, log = read(folder, content(swapped))
    assert (records, log.whole) == (swapped, True)


def test_damaged_frames_that_a_log_holds_on_purpose_are_delivered(folder: Path) -> None:
    # The broadcast's log holds what came, believed or not.
    forged = [(t_s, frame[:-1] + bytes([frame[-1] ^ 1])) for t_s, frame in RECORDS]
    records, log = read(folder, content(forged))
    assert (records, log.whole) == (forged, True)


def test_a_block_that_the_disk_cannot_read_is_passed_over(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "bad.tlog"
    path.write_bytes(WHOLE[: STARTS[20]] + bytes(4096) + WHOLE[STARTS[20] :])
    bad = STARTS[20]

    class BadDisk(io.FileIO):
        def read(self, count: int | None = -1, /) -> bytes:
            if self.tell() == bad:
                raise OSError(errno.EIO, "Input/output error")
            return super().read(bad - self.tell() if self.tell() < bad else count)

    monkeypatch.setattr(tlog, "FileIO", BadDisk)
    log = read_tlog(path)
    assert list(log) == RECORDS
    assert log.left_out == [LeftOut(bad, 4096)]


def test_the_crc_of_any_message_can_be_checked_without_a_table() -> None:
    for frame in frames(10):
        assert (
            crc_extra_of(frame)
            == common.mavlink_map[common.MAVLink(None).decode(bytearray(frame)).get_msgId()].crc_extra
        )
    drawn = random.Random(2)
    junk = (b"\xfe\x08" + drawn.randbytes(14) for _ in range(4_000))
    assert sum(crc_extra_of(frame) is not None for frame in junk) < 60


def test_a_disk_that_is_gone_ends_the_reading_with_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "gone.tlog"
    path.write_bytes(WHOLE)

    class Gone(io.FileIO):
        def read(self, count: int | None = -1, /) -> bytes:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))

    monkeypatch.setattr(tlog, "FileIO", Gone)
    with pytest.raises(Exception, match=r"gone\.tlog: cannot read the log: No such device"):
        list(read_tlog(path))
