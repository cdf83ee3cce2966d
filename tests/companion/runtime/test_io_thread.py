"""Slow disks and pipes are waited for elsewhere, and what goes wrong there is told."""

from __future__ import annotations

import io
import threading
from pathlib import Path

import pytest

from companion.files.tlog import TlogWriter, read_tlog
from companion.onboard.flight_log import FlightLog
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


def test_a_log_is_whole_on_disk_after_the_end(tmp_path: Path) -> None:
    working = IoThread("test")
    file = IoThreadFile(tmp_path / "flight.tlog", working)
    writer = TlogWriter(file)
    for second in range(10_000):
        writer.write(float(second), FRAME)
    file.close()
    working.close()
    assert [time_s for time_s, _ in read_tlog(tmp_path / "flight.tlog")] == [float(second) for second in range(10_000)]


def test_a_full_disk_ends_the_log_and_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    working = IoThread("test")
    file = IoThreadFile(tmp_path / "flight.tlog", working)

    class Full(io.RawIOBase):
        def write(self, _: object) -> int:
            raise OSError(28, "No space left on device")

    file._file = Full()  # type: ignore[assignment]
    log = FlightLog(TlogWriter(file))
    log.record(0.0, FRAME)
    working.close()
    log.record(5.0, FRAME)
    assert "no longer logging: No space left on device" in capsys.readouterr().err


def test_a_disk_that_hangs_ends_the_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(background, "MAX_WAITING_JOBS", 1)
    working, hung, began = IoThread("test"), threading.Event(), threading.Event()
    file = IoThreadFile(tmp_path / "flight.tlog", working)

    def hang() -> None:
        began.set()
        hung.wait()

    working.do(hang)
    began.wait()
    file.write(b"a")
    file.flush()
    file.write(b"b")
    with pytest.raises(OSError, match="too slow"):
        file.flush()
    hung.set()
    working.close()
