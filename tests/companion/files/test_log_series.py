"""Logs take no more of a disk than they may, go on in a next file, and come back when the disk does."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from companion.files import log_series
from companion.files.log_series import LogSeries, file_bytes, part_of, parts_of, remove_oldest


def series(folder: Path, most_bytes: int = 1_000, head: bytes = b"") -> LogSeries:
    def place(number: int) -> Path:
        folder.mkdir(parents=True, exist_ok=True)
        return part_of(folder / "vehicle-1.tlog", number)

    return LogSeries(place, most_bytes, head)


def test_a_log_that_is_full_goes_on_in_a_next_file(tmp_path: Path) -> None:
    log = series(tmp_path, 100, head=b"head\n")
    for number in range(10):
        log.append(bytes([number]) * 30)
    log.close()
    parts = parts_of(tmp_path / "vehicle-1.tlog")
    assert [path.name for path in parts] == ["vehicle-1.tlog", *(f"vehicle-1-{n}.tlog" for n in range(2, 5))]
    contents = [path.read_bytes() for path in parts]
    assert all(content.startswith(b"head\n") and len(content) <= 100 for content in contents)
    assert b"".join(content[5:] for content in contents) == b"".join(bytes([number]) * 30 for number in range(10))


def test_a_record_longer_than_a_file_is_written_all_the_same(tmp_path: Path) -> None:
    log = series(tmp_path, 10)
    log.append(bytes(30))
    assert (tmp_path / "vehicle-1.tlog").stat().st_size == 30


def test_nothing_is_written_where_the_state_would_have_no_room_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = series(tmp_path)
    log.append(b"before")
    free = os.statvfs(tmp_path).f_bavail * os.statvfs(tmp_path).f_frsize
    monkeypatch.setattr(log_series, "LEAST_FREE_BYTES", free + 2**30)
    with pytest.raises(OSError, match="No space left on device"):
        log.append(b"missing")
    monkeypatch.setattr(log_series, "LEAST_FREE_BYTES", 0)
    log.append(b", after")
    assert (tmp_path / "vehicle-1.tlog").read_bytes() == b"before, after"


def test_what_a_full_disk_took_of_a_record_is_cut_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = series(tmp_path)
    log.append(b"whole, ")
    write, left = os.write, 3

    def nearly_full(descriptor: int, content: bytes) -> int:
        nonlocal left
        if left == 0:
            raise OSError(28, "No space left on device")
        taken, left = min(left, len(content)), left - min(left, len(content))
        return write(descriptor, content[:taken])

    with monkeypatch.context() as full:
        full.setattr(os, "write", nearly_full)
        with pytest.raises(OSError, match="No space left"):
            log.append(b"torn")
    assert (tmp_path / "vehicle-1.tlog").read_bytes() == b"whole, "
    log.append(b"whole again")
    assert (tmp_path / "vehicle-1.tlog").read_bytes() == b"whole, whole again"


@pytest.mark.parametrize("how", ["removed", "renamed"])
def test_a_log_whose_folder_is_taken_away_is_told_and_begun_anew(tmp_path: Path, how: str) -> None:
    folder = tmp_path / "run"
    log = series(folder)
    log.append(b"before")
    if how == "removed":
        shutil.rmtree(folder)
    else:
        folder.rename(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="taken away|No such file"):
        log.append(b"missing")
    log.append(b"after")
    assert (folder / "vehicle-1.tlog").read_bytes() == b"after"


def test_no_link_is_written_through(tmp_path: Path) -> None:
    (tmp_path / "victim").write_text("precious")
    (tmp_path / "vehicle-1.tlog").symlink_to(tmp_path / "victim")
    with pytest.raises(OSError, match="symbolic links"):
        series(tmp_path).append(b"log")
    assert (tmp_path / "victim").read_text() == "precious"


def test_the_oldest_logs_make_room(tmp_path: Path) -> None:
    paths = [tmp_path / f"{number}.tlog" for number in range(5)]
    for path in paths:
        path.write_bytes(bytes(100))
    remove_oldest(paths, 250)
    assert [path.exists() for path in paths] == [False, False, False, True, True]


def test_all_logs_together_have_room_for_many_files() -> None:
    assert file_bytes(20_000_000) == 1_000_000
    assert file_bytes(10**12) == log_series.MOST_FILE_BYTES


def test_a_file_that_begins_behind_records_that_were_taken_away_says_so(tmp_path: Path) -> None:
    folder = tmp_path / "logs"

    def place(number: int) -> Path:
        folder.mkdir(parents=True, exist_ok=True)
        return part_of(folder / "vehicle-1.tlog", number)

    def gap_before(records: bytes) -> bytes:
        return b"gap before " + records

    log = LogSeries(place, 60, gap_before=gap_before)
    log.append(b"first;")
    shutil.rmtree(folder)
    with pytest.raises(OSError, match="taken away|No such file"):
        log.append(b"second;")
    log.append(b"second;")
    assert (folder / "vehicle-1.tlog").read_bytes() == b"gap before second;second;"
    # The next file goes on behind one that is there, and says so only if that one is gone.
    log.append(b"3" * 59)
    assert (folder / "vehicle-1-2.tlog").read_bytes() == b"3" * 59
    (folder / "vehicle-1-2.tlog").unlink()
    with pytest.raises(OSError, match="taken away|No such file"):
        log.append(b"4")
    log.append(b"4" * 59)
    log.close()
    assert (folder / "vehicle-1-2.tlog").read_bytes() == b"gap before " + b"4" * 118
