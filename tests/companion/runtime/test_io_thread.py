"""Slow disks and pipes are waited for elsewhere, and what goes wrong there is told."""

from __future__ import annotations

import io
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from companion.files.log_series import LogSeries
from companion.files.tlog import Tlog, TlogWriter, read_tlog
from companion.onboard.flight_log import FlightLog, Mark, mark_of
from companion.protocol.frame import raw_frame
from companion.runtime import io_thread as background
from companion.runtime.io_thread import IoThread, IoThreadFile

FRAME = bytes.fromhex("fe00000101000000")


def test_jobs_are_done_in_order_and_all_before_the_end() -> None:
    done: list[int] = []
    working = IoThread("test")
    for number in range(50):
        assert working.do(lambda number=number: done.append(number))  # type: ignore[misc]
    working.close()
    assert done == list(range(50))


def test_whoever_gives_a_job_does_not_wait_for_the_one_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(background, "MAX_WAITING_JOBS", 2)
    working, hung = IoThread("test"), threading.Event()
    began = threading.Event()

    def hang() -> None:
        began.set()
        hung.wait()

    working.do(hang)
    began.wait()
    assert [working.do(lambda: None) for _ in range(3)] == [True, True, False]
    hung.set()
    working.close()


def test_a_failed_job_does_not_end_the_thread() -> None:
    done: list[str] = []
    working = IoThread("test")

    def fail() -> None:
        raise OSError("no space")

    working.do(fail)
    working.do(lambda: done.append("later"))
    working.close()
    assert done == ["later"]


class Disk:
    """A target in memory that takes bytes while it works."""

    def __init__(self) -> None:
        self.content = b""
        self.error: OSError | None = None

    def append(self, content: bytes) -> None:
        if self.error is not None:
            raise self.error
        self.content += content

    def close(self) -> None:
        pass


def done_by(working: IoThread) -> None:
    """Wait until a thread has done all that it was given."""
    done = threading.Event()
    working.do(done.set)
    assert done.wait(10.0)


def test_a_log_is_whole_on_disk_after_the_end(tmp_path: Path) -> None:
    working = IoThread("test")
    file = IoThreadFile(LogSeries(lambda number: tmp_path / "flight.tlog", 10**9), working)
    writer = TlogWriter(file)
    for second in range(10_000):
        writer.write(float(second), FRAME)
    file.close()
    working.close()
    assert [time_s for time_s, _ in read_tlog(tmp_path / "flight.tlog")] == [float(second) for second in range(10_000)]


def test_a_full_disk_is_told_once_and_the_log_goes_on_with_a_mark_when_there_is_room(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(background, "FIRST_RETRY_S", 0.0)
    working, disk = IoThread("test"), Disk()
    file = IoThreadFile(disk, working)
    log = FlightLog(TlogWriter(file))

    def record(t_s: float) -> None:
        log.record(t_s, FRAME)
        done_by(working)

    record(0.0)
    disk.error = OSError(28, "No space left on device")
    for second in range(1, 8):
        record(float(second))
    said = capsys.readouterr()
    assert said.err == "companion: warning: no logs: No space left on device; flying without them\n"
    disk.error = None
    file._retry_at_s = 0.0
    for second in range(8, 12):
        record(float(second))
    log.close()
    done_by(working)
    frames = [frame for _, frame in read_records(disk.content)]
    marks = [number for number, frame in enumerate(frames) if frame != FRAME]
    # What was to be written when the error came is written first, and the mark stands where records are missing.
    assert [mark_of(raw_frame(frames[number])) for number in marks] == [Mark.LOST]
    assert frames.index(frames[marks[0]]) == 2
    assert capsys.readouterr().out.startswith("companion: logging again after 7 s; at least ")
    working.close()


def test_a_disk_that_hangs_is_told_and_keeps_nobody_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(background, "SLOW_S", 0.0)
    working, disk, hung, began = IoThread("test"), Disk(), threading.Event(), threading.Event()
    file = IoThreadFile(disk, working)

    def hang() -> None:
        began.set()
        hung.wait()

    working.do(hang)
    began.wait()
    for content in (b"a", b"b"):
        file.write(content)
        file.flush()
    with pytest.raises(OSError, match="too slow"):
        file.write(b"c")
    hung.set()
    done_by(working)
    file._retry_at_s = 0.0
    with pytest.raises(OSError, match="too slow"):
        file.write(b"d")
    done_by(working)
    file.write(b"e")
    file.close()
    working.close()
    # What was handed over before the error is dropped, as it would come after what is missing.
    assert disk.content == b"be"


def test_a_queue_that_is_full_counts_as_a_disk_that_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(background, "MAX_WAITING_JOBS", 1)
    working, hung, began = IoThread("test"), threading.Event(), threading.Event()
    file = IoThreadFile(Disk(), working)

    def hang() -> None:
        began.set()
        hung.wait()

    working.do(hang)
    began.wait()
    for content in (b"a", b"b"):
        file.write(content)
        file.flush()
    with pytest.raises(OSError, match="too slow"):
        file.write(b"c")
    hung.set()
    working.close()


def test_each_time_that_a_disk_still_fails_it_is_tried_more_seldom(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 1_000.0
    monkeypatch.setattr("companion.runtime.io_thread.time.monotonic", lambda: now_s)
    working, disk = IoThread("test"), Disk()
    disk.error = OSError(28, "No space left on device")
    file = IoThreadFile(disk, working)
    file.write(b"a")
    file.flush()
    done_by(working)
    waits_s = []
    for _ in range(8):
        waits_s.append(file._retry_at_s - now_s)
        now_s = file._retry_at_s
        with pytest.raises(OSError, match="No space left"):
            file.write(b"b")
        done_by(working)
    working.close()
    assert waits_s == [1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0, 30.0]


def read_records(content: bytes) -> list[tuple[float, bytes]]:
    return list(Tlog(io.BytesIO(content), "log"))


class AtOnce(IoThread):
    """A thread that is faster than whoever gives it a job."""

    def do(self, job: Callable[[], None]) -> bool:
        job()
        return True


def test_a_thread_that_writes_before_its_giver_goes_on_is_no_slow_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(background, "SLOW_S", 0.0)
    disk, working = Disk(), AtOnce("test")
    file = IoThreadFile(disk, working)
    for number in range(20):
        file.write(bytes([number]))
        file.flush()
    assert disk.content == bytes(range(20))
    IoThread.do(working, lambda: None)
    working.close()
