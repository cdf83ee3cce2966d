"""What must survive a crash is written so that it does."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import pytest

from companion.errors import InputError
from companion.files.state import MAX_STATE_BYTES, check_state_file, read_state_file, warnings_of, write_state_file


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
    opens = os.open

    def opens_no_folder(path: Path, flags: int, mode: int = 0o777) -> int:
        if flags & os.O_DIRECTORY:
            raise OSError(number, os.strerror(number))
        return opens(path, flags, mode)

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


@pytest.mark.parametrize("kind", ["link", "dangling link", "pipe", "folder", "socket"])
def test_what_is_no_regular_file_is_neither_followed_nor_waited_for_nor_replaced(tmp_path: Path, kind: str) -> None:
    path, other = tmp_path / "flight.state", tmp_path / "other"
    if kind.endswith("link"):
        path.symlink_to(other)
    elif kind == "folder":
        path.mkdir()
    else:
        os.mknod(path, 0o600 | (stat.S_IFIFO if kind == "pipe" else stat.S_IFSOCK))
    if kind == "link":
        other.write_text("other")
    for use in (read_state_file, check_state_file, lambda path: write_state_file(path, "text")):
        with pytest.raises(InputError, match=rf"flight.state: cannot .* the state: it is a {kind.split()[-1]}; "):
            use(path)
    assert [one.read_text() for one in (other,) if one.exists()] == ["other"] * (kind == "link")


def test_a_device_is_no_state() -> None:
    with pytest.raises(InputError, match="cannot read the state: it is a device"):
        read_state_file(Path("/dev/zero"))


def test_a_link_in_the_place_of_the_fresh_file_is_not_written_through(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / "flight.state.new").symlink_to(victim)
    check_state_file(tmp_path / "flight.state")
    (tmp_path / "flight.state.new").symlink_to(victim)
    write_state_file(tmp_path / "flight.state", "text")
    assert (victim.read_text(), read_state_file(tmp_path / "flight.state")) == ("precious", "text")


def test_what_a_crash_left_of_a_fresh_file_is_written_anew(tmp_path: Path) -> None:
    (tmp_path / "flight.state.new").write_text("half a st")
    write_state_file(tmp_path / "flight.state", "text")
    assert [path.name for path in tmp_path.iterdir()] == ["flight.state"]
    assert read_state_file(tmp_path / "flight.state") == "text"


def test_a_state_that_is_too_large_is_refused_and_not_read_whole(tmp_path: Path) -> None:
    (tmp_path / "flight.state").write_bytes(b" " * (MAX_STATE_BYTES + 1))
    with pytest.raises(InputError, match="more than 65536 bytes"):
        read_state_file(tmp_path / "flight.state")


def test_a_file_keeps_its_mode_when_it_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "flight.state"
    write_state_file(path, "first")
    path.chmod(0o640)
    write_state_file(path, "second")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_state_that_anybody_could_replace_is_warned_of(tmp_path: Path) -> None:
    path = tmp_path / "flight.state"
    write_state_file(path, "text")
    assert warnings_of(path) == []
    path.chmod(0o666)
    assert warnings_of(path) == [f"{path}: others can replace the state (mode 666); chmod o-w {path}"]
    path.chmod(0o600)
    tmp_path.chmod(0o777)
    assert warnings_of(path) == [f"{tmp_path}: others can replace the state in it (mode 777); chmod o-w {tmp_path}"]
    tmp_path.chmod(0o1777)
    assert warnings_of(path) == []


def test_a_warning_about_a_state_behind_a_link_names_the_folder_whose_mode_can_be_mended(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(folder)
    path = tmp_path / "link" / "flight.state"
    assert warnings_of(path) == []
    folder.chmod(0o777)
    assert warnings_of(path) == [f"{folder}: others can replace the state in it (mode 777); chmod o-w {folder}"]


def test_a_folder_above_a_state_that_anybody_could_replace_is_warned_of(tmp_path: Path) -> None:
    path = tmp_path / "above" / "folder" / "flight.state"
    write_state_file(path, "text\n")
    (tmp_path / "above").chmod(0o777)
    (warning,) = warnings_of(path)
    assert warning.startswith(f"{tmp_path / 'above'}: others can replace the state in it (mode 777)")
