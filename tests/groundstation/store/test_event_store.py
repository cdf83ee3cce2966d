"""Events on their way to disk: acknowledged when they are there, refused with the reason, never half of both."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from companion.runtime.io_thread import IoThread
from groundstation.store import event_store
from groundstation.store.database import Database
from groundstation.store.event_store import EventStore
from groundstation.store.rows import Batch, EventRow, Recorded


class Disk(IoThread):
    """A thread that works only when it is told to, so that a test decides what comes first."""

    def __init__(self) -> None:
        self.jobs: list[Callable[[], None]] = []

    def do(self, job: Callable[[], None]) -> bool:
        self.jobs.append(job)
        return True

    def work(self) -> None:
        while self.jobs:
            self.jobs.pop(0)()


class Clock:
    """Time that passes when it is told to, or when somebody sleeps."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, pause_s: float) -> None:
        self.now_s += pause_s


def row(number: int) -> EventRow:
    return EventRow(number, 1_790_000_000.0 + number, "anna", "pinned", "{}")


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(event_store, "time", clock)
    return clock


@pytest.fixture
def disk() -> Disk:
    return Disk()


@pytest.fixture
def store(tmp_path: Path, disk: Disk, clock: Clock) -> Iterator[EventStore]:
    store = EventStore(tmp_path / "x.state", None, disk, 1_000_000)
    yield store
    store.close()
    disk.work()


def numbers_in(path: Path) -> list[int]:
    reader = Database.read_only(path)
    numbers = [event.number for event in reader.events()]
    reader.close()
    return numbers


def refuse_writes(monkeypatch: pytest.MonkeyPatch, times: int) -> None:
    left = [times]
    write = Database.write

    def refused(database: Database, batch: Batch) -> None:
        if left[0] > 0:
            left[0] -= 1
            raise OSError(28, "database or disk is full")
        write(database, batch)

    monkeypatch.setattr(Database, "write", refused)


def test_an_event_is_acknowledged_once_it_is_on_disk_and_not_before(store: EventStore, disk: Disk) -> None:
    asked = store.append([row(1)])
    assert not asked.done()
    disk.work()
    assert asked.result(0) is None
    assert store.path is not None and numbers_in(store.path) == [1]


def test_a_fault_that_passes_is_tried_again_and_told_to_nobody(
    store: EventStore, disk: Disk, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    refuse_writes(monkeypatch, 2)
    asked = store.append([row(1)])
    disk.work()
    assert asked.result(0) is None
    assert capsys.readouterr().err == ""


def test_a_full_disk_refuses_commands_with_the_reason_and_keeps_what_has_happened(
    store: EventStore, disk: Disk, clock: Clock, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    refuse_writes(monkeypatch, 6)
    asked = store.append([row(1)])
    store.note([row(2)])
    disk.work()
    with pytest.raises(OSError, match="database or disk is full"):
        asked.result(0)
    with pytest.raises(OSError, match="database or disk is full"):
        store.append([row(3)]).result(0)
    for _ in range(4):
        clock.now_s += 1.1
        store.retry_if_due()
        disk.work()
    assert store.trouble is None
    assert store.path is not None and numbers_in(store.path) == [2]
    said = capsys.readouterr()
    assert said.err.count("cannot write the store: database or disk is full; it is tried again") == 1
    assert said.out.count("the store is written again") == 1


def test_what_is_given_up_before_its_turn_leaves_nothing_on_disk(store: EventStore, disk: Disk) -> None:
    given_up, other = store.append([row(1)]), store.append([row(2)])
    assert given_up.cancel()
    disk.work()
    assert other.result(0) is None
    assert store.path is not None and numbers_in(store.path) == [2]


def test_a_disk_that_hangs_is_told_and_refuses_commands_at_once(
    store: EventStore, disk: Disk, clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    store.note([row(1)])
    assert store.is_awaited
    clock.now_s += 11.0
    store.retry_if_due()
    assert not store.is_awaited
    with pytest.raises(OSError, match="the disk is too slow"):
        store.append([row(2)]).result(0)
    assert "cannot write the store: the disk is too slow" in capsys.readouterr().err
    disk.work()
    assert store.append([row(3)]).exception is not None


def test_a_store_that_is_taken_away_is_made_anew_with_all_events_and_kept_values(store: EventStore, disk: Disk) -> None:
    assert store.path is not None
    store.note([row(1)])
    store.keep("run", "1")
    disk.work()
    store.path.rename(store.path.with_name("gone"))
    store.note([row(2)])
    disk.work()
    assert numbers_in(store.path) == [1, 2]
    reader = Database.read_only(store.path)
    assert reader.kept("run") == "1"
    reader.close()


def test_the_newest_kept_value_is_written_and_the_same_one_only_once(
    store: EventStore, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[Batch] = []
    monkeypatch.setattr(Database, "write", lambda _, batch: written.append(batch))
    for value in ("1", "2", "2"):
        store.keep("run", value)
    disk.work()
    store.keep("run", "2")
    disk.work()
    assert [dict(batch.kept) for batch in written] == [{"run": "2"}]


def test_pictures_that_a_full_disk_does_not_take_keep_no_event_from_being_written(
    store: EventStore, disk: Disk, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Database, "record", full)
    for number in (1, 2):
        store.record([Recorded("picture", float(number), b"{}")])
        asked = store.append([row(number)])
        disk.work()
        assert asked.result(0) is None
    assert capsys.readouterr().err.count("pictures and frames are left out: No space left on device") == 1
