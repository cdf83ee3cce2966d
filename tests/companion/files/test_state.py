"""What must survive a crash is written so that it does."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import pytest

from companion.errors import InputError
from companion.files.state import check_state_file, read_state_file, write_state_file


def test_what_was_written_last_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "flight.state"
    for text in ("first", "second"):
        write_state_file(path, text)
    assert read_state_file(path) == "second"
    assert list(tmp_path.iterdir()) == [path]


def test_nothing_is_read_where_nothing_was_written(tmp_path: Path) -> None:
    assert read_state_file(tmp_path / "flight.state") is None


def test_the_folder_of_a_state_is_made(tmp_path: Path) -> None:
    path = tmp_path / "var" / "lib" / "flight.state"
    write_state_file(path, "text")
    assert path.read_text() == "text"


def test_the_bytes_are_on_disk_before_the_name_is_theirs_and_the_name_is_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # rename(2), fsync(2): a folder is a file of its own.
    path = tmp_path / "flight.state"
    steps: list[str] = []
    replace = Path.replace

    def synced(descriptor: int) -> None:
        steps.append("folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file")

    def replaced(fresh: Path, target: Path) -> Path:
        steps.append("replaced")
        return replace(fresh, target)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(Path, "replace", replaced)
    write_state_file(path, "text")
    assert steps == ["file", "replaced", "folder"]


def test_no_file_stays_open_after_a_write(tmp_path: Path) -> None:
    before = len(os.listdir("/proc/self/fd"))
    write_state_file(tmp_path / "flight.state", "text")
    assert len(os.listdir("/proc/self/fd")) == before


def test_a_folder_that_cannot_be_synced_is_told_as_one_that_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", fails)
    with pytest.raises(InputError, match="flight.state: cannot write the state: Input/output error"):
        write_state_file(tmp_path / "flight.state", "text")


@pytest.mark.parametrize("number", [errno.EACCES, errno.EINVAL, errno.ENOTSUP])
def test_where_folders_cannot_be_synced_a_state_is_written_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def opens_no_folder(path: Path, flags: int) -> int:
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patched:
        patched.setattr(os, "open", opens_no_folder)
        write_state_file(tmp_path / "flight.state", "text")
    assert read_state_file(tmp_path / "flight.state") == "text"


def test_a_state_that_could_not_be_written_is_found_before_the_flight(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot write the state: .*; allowed: a writable folder"):
        check_state_file(tmp_path / "file" / "flight.state")


def test_a_state_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "flight.state"
    path.write_bytes(b"\xff")
    with pytest.raises(InputError, match="cannot read the state: not text"):
        read_state_file(path)
