"""A run's log is read whole, in however many files it lies and whatever became of one of them."""

from __future__ import annotations

import shutil
import threading
from contextlib import ExitStack
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common

from companion.files.log_series import LogSeries, part_of
from companion.files.tlog import TlogWriter
from companion.onboard.config import Config
from companion.onboard.flight_log import FlightLog, Mark, mark_of
from companion.onboard.log_files import LogFiles, files_of, settings_of
from companion.onboard.log_folder import RunFolder, VehicleLog, open_log_folder
from companion.protocol.frame import raw_frame
from companion.runtime import io_thread
from companion.runtime.io_thread import IoThread, IoThreadFile

MAV = common.MAVLink(None, srcSystem=1, srcComponent=1)
FRAMES = [bytes(common.MAVLink_heartbeat_message(2, 3, 81, number, 4, 3).pack(MAV)) for number in range(1, 60)]


def written(folder: Path) -> list[Path]:
    """Write a log as a run does, and return its files."""
    files = IoThread("logs")
    series = LogSeries(lambda number: part_of(folder / "vehicle-7.tlog", number), 400)
    file = IoThreadFile(series, files)
    log = FlightLog(TlogWriter(file))
    for number, frame in enumerate(FRAMES):
        log.record(float(number), frame)
    log.close()
    file.close()
    files.close()
    return files_of(str(folder / "vehicle-7.tlog"))


def test_a_log_in_several_files_is_read_as_one(tmp_path: Path) -> None:
    paths = written(tmp_path)
    assert len(paths) > 3
    records = LogFiles(paths)
    assert list(records) == [(float(number), frame) for number, frame in enumerate(FRAMES)]
    assert records.whole


def test_it_can_be_read_from_a_later_file_on(tmp_path: Path) -> None:
    paths = written(tmp_path)
    assert files_of(str(paths[1])) == paths[1:]
    assert settings_of(str(paths[1])) == str(tmp_path / "companion-7.yaml")


def test_a_log_of_another_name_is_one_file(tmp_path: Path) -> None:
    for name in ("broadcast.tlog", "broadcast-2.tlog"):
        (tmp_path / name).touch()
    assert files_of(str(tmp_path / "broadcast.tlog")) == [tmp_path / "broadcast.tlog"]
    assert settings_of(str(tmp_path / "broadcast.tlog")) is None


def test_the_damaged_file_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = written(tmp_path)
    paths[1].write_bytes(bytes(50) + paths[1].read_bytes())
    records = LogFiles(paths)
    assert [frame for _, frame in records] == FRAMES
    assert not records.whole
    records.tell()
    assert capsys.readouterr().err == f"companion: warning: {paths[1]}: left out 50 bytes at 0\n"


def test_the_oldest_runs_make_room_and_nothing_else_is_touched(tmp_path: Path) -> None:
    names = [f"2026010{day}T000000Z" for day in range(1, 5)]
    for name in names:
        (tmp_path / name).mkdir()
        with (tmp_path / name / "vehicle-1.tlog").open("wb") as file:
            file.truncate(8_000_000)
    (tmp_path / names[0] / "notes.txt").write_text("mine")
    (tmp_path / "photographs").mkdir()
    (tmp_path / "photographs" / "vehicle-1.tlog").write_bytes(bytes(100))
    (tmp_path / "20250101T000000Z").symlink_to(tmp_path / "photographs")
    config = Config.model_validate({"agent_id": 1, "log_dir": str(tmp_path), "logs": {"most_mb": 20.0}})
    folder = RunFolder(config, tmp_path)
    path = folder.place("vehicle-1.tlog")(1)
    assert path.parent == folder.path
    # 20 MB less three files of 1 MB: two runs of 8 MB have room.
    kept = [name for name in names if (tmp_path / name / "vehicle-1.tlog").exists()]
    assert kept == names[2:]
    assert (tmp_path / names[0] / "notes.txt").exists() and not (tmp_path / names[1]).exists()
    assert (tmp_path / "photographs" / "vehicle-1.tlog").exists()


def test_a_log_whose_folder_was_taken_away_in_flight_begins_anew_with_a_gap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(io_thread, "FIRST_RETRY_S", 0.0)
    files, config = IoThread("logs"), Config(agent_id=7, log_dir=str(tmp_path / "logs"))

    def record(number: int) -> None:
        done = threading.Event()
        logs.vehicle.record(float(number), FRAMES[number])
        files.do(done.set)
        assert done.wait(10.0)

    with ExitStack() as stack:
        logs = open_log_folder(config, files, stack, VehicleLog())
        for number in range(5):
            record(number)
        assert logs.path is not None
        shutil.rmtree(tmp_path / "logs")
        for number in range(5, 20):
            record(number)
    files.close()
    records = list(LogFiles(files_of(str(logs.path / "vehicle-7.tlog"))))
    assert mark_of(raw_frame(records[0][1])) is Mark.LOST
    assert records[-1][1] == FRAMES[19]
