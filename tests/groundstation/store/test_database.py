"""The file of a store: what is written is there, and nobody changes an event."""

from __future__ import annotations

import errno
import os
import sqlite3
import zlib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.errors import InputError
from groundstation.store.database import Database
from groundstation.store.rows import Batch, EventRow, Recorded


def row(number: int) -> EventRow:
    return EventRow(number, 1_790_000_000.0 + number, "anna", "pinned", f'{{"number":{number}}}')


def made(path: Path, *numbers: int) -> Database:
    return Database.create(path, Batch(tuple(map(row, numbers)), {"run": "{}"}))


def test_what_was_written_is_there_when_it_is_opened_again(tmp_path: Path) -> None:
    database = made(tmp_path / "x.state", 1)
    database.write(Batch((row(2), row(5)), {"run": "1", "mission": "m"}))
    database.close()
    again = Database.opened(tmp_path / "x.state")
    assert list(again.events()) == [row(1), row(2), row(5)]
    assert list(again.events(after=2)) == [row(5)]
    assert (again.kept("run"), again.kept("mission"), again.kept("other")) == ("1", "m", None)
    again.close()


@pytest.mark.parametrize(
    "sql",
    [
        "UPDATE events SET who = 'eve'",
        "DELETE FROM events WHERE number = 1",
        "INSERT OR REPLACE INTO events VALUES (1, 0, 'eve', 'x', '{}')",
        "INSERT INTO events VALUES (1, 0, 'eve', 'x', '{}')",
    ],
)
def test_an_event_is_never_changed_removed_or_replaced_by_whoever_writes_to_the_file(tmp_path: Path, sql: str) -> None:
    made(tmp_path / "x.state", 1, 2).close()
    other = sqlite3.connect(tmp_path / "x.state")
    with pytest.raises(sqlite3.IntegrityError, match="events (are never|have rising)"):
        other.execute(sql)
    other.close()
    assert list(Database.read_only(tmp_path / "x.state").events()) == [row(1), row(2)]


def test_a_batch_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    database = made(tmp_path / "x.state", 3)
    with pytest.raises(OSError, match="events have rising numbers"):
        database.write(Batch((row(4), row(3)), {"run": "new"}))
    assert (list(database.events()), database.kept("run")) == ([row(3)], "{}")
    database.close()


@pytest.mark.parametrize("content", [b"", b"hello", b"SQLite format 3\0", b"SQLite format 3\0" + bytes(4096)])
def test_a_file_that_is_none_or_broken_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.state"
    path.write_bytes(content)
    with pytest.raises(InputError, match="x.state: no store of a ground station that can be read: .*; allowed: a st"):
        Database.opened(path)
    assert path.read_bytes() == content


def test_another_programs_database_is_refused(tmp_path: Path) -> None:
    other = sqlite3.connect(tmp_path / "x.db")
    other.execute("CREATE TABLE places (url TEXT)")
    other.close()
    for way in (Database.opened, Database.read_only):
        with pytest.raises(InputError, match="x.db: a database of another program; allowed: "):
            way(tmp_path / "x.db")


def test_a_store_of_a_later_release_is_refused(tmp_path: Path) -> None:
    made(tmp_path / "x.state").close()
    other = sqlite3.connect(tmp_path / "x.state")
    other.execute("PRAGMA user_version = 99")
    other.close()
    with pytest.raises(InputError, match="a store of version 99, of a later release; allowed: up to 1"):
        Database.opened(tmp_path / "x.state")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "x.state"
    made(path, *range(1, 40)).close()
    return path


@settings(max_examples=30)
@given(st.integers(100, 20_000), st.binary(min_size=1, max_size=64))
def test_damage_anywhere_ends_in_one_line_or_in_what_was_written(whole: Path, at: int, junk: bytes) -> None:
    content = bytearray(whole.read_bytes())
    content[at : at + len(junk)] = junk
    path = whole.with_name("damaged.state")
    path.write_bytes(content)
    try:
        database = Database.read_only(path)
        numbers = [event.number for event in database.events()]
        assert numbers == sorted(set(numbers))
        database.close()
    except (InputError, OSError) as error:
        assert "\n" not in str(error)


def test_pictures_and_frames_have_a_bound_and_events_none(tmp_path: Path) -> None:
    database = made(tmp_path / "x.state", *range(1, 100))
    for second in range(60):
        database.record([Recorded("picture", second, os.urandom(1_000))], 20_000)
    kept = list(database.recorded("picture"))
    assert 15 <= len(kept) <= 20
    assert kept[-1].unix_s == 59.0
    assert len(list(database.events())) == 99
    database.close()


def test_the_bound_counts_what_an_earlier_run_recorded(tmp_path: Path) -> None:
    database = made(tmp_path / "x.state")
    database.record([Recorded("frames", 1.0, os.urandom(5_000))], 8_000)
    database.close()
    again = Database.opened(tmp_path / "x.state")
    again.record([Recorded("frames", 2.0, os.urandom(5_000))], 8_000)
    assert [one.unix_s for one in again.recorded("frames")] == [2.0]
    again.close()


def test_the_picture_of_a_time_is_the_newest_up_to_it(tmp_path: Path) -> None:
    database = made(tmp_path / "x.state")
    database.record([Recorded("picture", at_s, f"{at_s}".encode()) for at_s in (10.0, 11.0, 12.0)], 10_000)
    assert database.last_picture(11.9) == Recorded("picture", 11.0, b"11.0")
    assert database.last_picture(9.9) is None
    assert database.span_s("picture") == (10.0, 12.0)
    assert database.span_s("frames") is None
    database.close()


def test_a_store_is_read_while_another_program_writes_to_it(tmp_path: Path) -> None:
    database = made(tmp_path / "x.state", 1)
    reader = Database.read_only(tmp_path / "x.state")
    database.write(Batch((row(2),)))
    assert list(reader.events()) == [row(1), row(2)]
    reader.close()
    database.close()


def test_a_store_on_a_disk_that_takes_nothing_is_read(tmp_path: Path) -> None:
    folder = tmp_path / "disk"
    folder.mkdir()
    made(folder / "x.state", 1).close()
    folder.chmod(0o500)
    (folder / "x.state").chmod(0o400)
    try:
        reader = Database.read_only(folder / "x.state")
        assert list(reader.events()) == [row(1)]
        reader.close()
        assert [one.name for one in folder.iterdir()] == ["x.state"]
    finally:
        folder.chmod(0o700)


def test_a_picture_that_is_damaged_is_left_out(tmp_path: Path) -> None:
    database = made(tmp_path / "x.state")
    database.record([Recorded("picture", 1.0, b"one"), Recorded("picture", 2.0, b"two")], 10_000)
    database.close()
    path = tmp_path / "x.state"
    path.write_bytes(path.read_bytes().replace(zlib.compress(b"one", 3), bytes(11)))
    reader = Database.read_only(path)
    assert [one.body for one in reader.recorded("picture")] == [b"two"]
    reader.close()


def test_a_folder_that_must_not_be_read_holds_a_store_and_one_that_the_disk_does_not_sync_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = os.open

    def fails(number: int) -> None:
        def one(path: str | Path, flags: int, *more: int) -> int:
            if flags & os.O_DIRECTORY:
                raise OSError(number, os.strerror(number))
            return opened(path, flags, *more)

        monkeypatch.setattr(os, "open", one)

    fails(errno.EACCES)
    made(tmp_path / "x.state", 1).close()
    fails(errno.EIO)
    with pytest.raises(OSError, match="Input/output error"):
        made(tmp_path / "y.state", 1)
