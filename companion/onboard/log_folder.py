"""The folder of logs that one run of `companion run` writes, and the room that it has among those of earlier runs."""

from __future__ import annotations

import errno
import re
import shutil
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from companion.files.log_series import LogSeries, file_bytes, part_of, remove_oldest, unsaid
from companion.files.tlog import Sink, TlogWriter
from companion.onboard.config import Config, dump_config
from companion.onboard.decision_table import HEAD, DecisionTable
from companion.onboard.flight_log import FlightLog, gap_before, unused
from companion.runtime.io_thread import IoThread, IoThreadFile

BROADCAST_LOG_BYTES_PER_S = 20_000.0
"""Greatest rate at which the broadcast is logged: several times that of any radio in use, and a bound in a flood."""
OPEN_LOGS = 3
"""Number of logs of a run, each of which may grow to a file's size before the room is looked at again."""
_RUN = re.compile(r"\d{8}T\d{6}Z(-\d+)?")
_LOG = re.compile(r"(vehicle|broadcast|identify|decisions|companion)-.*\.(tlog|csv|yaml)")


@dataclass(frozen=True)
class VehicleLog:
    """How the log of the vehicle's inputs and decisions is kept."""

    name: str = "vehicle"
    copy: BinaryIO | None = None
    """A file in memory that gets the same, whether or not there is a folder that can be written."""


class RunFolder:
    """The folder of one run. It is made when the first log is opened, and again if it is taken away.

    It belongs to the thread that writes the logs.
    """

    def __init__(self, config: Config, parent: Path) -> None:
        self._config = config
        self._parent = parent
        self._name = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        self.most_bytes = int(config.logs.most_mb * 1e6)
        self._discarded = False
        self.path: Path | None = None
        """The folder; None before it was made."""

    def place(self, name: str) -> Callable[[int], Path]:
        """Return the function that gives the path of each file of a log, and makes folder and room for it."""

        def path_of(number: int) -> Path:
            folder = self._made()
            self._make_room()
            return part_of(folder / name, number)

        return path_of

    def discard(self) -> None:
        """Remove the folder, and make none any more: the run never began."""
        self._discarded = True
        if self.path is not None:
            shutil.rmtree(self.path, ignore_errors=True)

    def _made(self) -> Path:
        if self._discarded:
            raise OSError(errno.ECANCELED, "the run never began")
        folder = self.path or unused(self._parent / self._name)
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder
        settings = folder / f"companion-{self._config.agent_id}.yaml"
        if not settings.exists():
            settings.write_text(dump_config(self._config), encoding="utf-8")
        return folder

    def _make_room(self) -> None:
        """Remove the oldest logs of earlier runs, then of this one, until all together have room for new files."""
        runs = sorted(one for one in self._parent.iterdir() if _RUN.fullmatch(one.name) and not one.is_symlink())
        logs = [log for run in runs if run.is_dir() for log in _oldest_first(run)]
        remove_oldest(logs, self.most_bytes - OPEN_LOGS * file_bytes(self.most_bytes))
        for run in runs:
            if run != self.path and run.is_dir() and not any(run.iterdir()):
                run.rmdir()


@dataclass(frozen=True)
class LogFolder:
    """The logs of a run; they write nothing where no folder is configured."""

    folder: RunFolder | None
    files: IoThread
    vehicle: FlightLog
    """Log of the companion's inputs, decisions and sent frames, which a replay needs."""
    broadcast: FlightLog
    """Log of all frames of the broadcast link, accepted or not."""
    decisions: DecisionTable | None

    @property
    def path(self) -> Path | None:
        """The folder, once it was made."""
        return None if self.folder is None else self.folder.path

    def discard(self) -> None:
        """Have the folder of a run that never began removed."""
        if self.folder is not None:
            self.files.do(self.folder.discard)


def open_log_folder(config: Config, files: IoThread, stack: ExitStack, vehicle: VehicleLog) -> LogFolder:
    """Open the logs of a run in a new folder, so that a restart overwrites nothing; `stack` closes them.

    Nothing waits for the disk here, and nothing fails: the thread makes the folder when there is something to write,
    and a log that cannot be written says so and tries again.
    """
    copy = [] if vehicle.copy is None else [vehicle.copy]
    if config.log_dir is None:
        return LogFolder(None, files, FlightLog(TlogWriter(copy[0]) if copy else None), FlightLog(None), None)
    folder = RunFolder(config, Path(config.log_dir))

    def opened(name: str, head: bytes = b"") -> IoThreadFile:
        series = LogSeries(folder.place(name), file_bytes(folder.most_bytes), head, unsaid if head else gap_before)
        file = IoThreadFile(series, files)
        stack.callback(file.close)
        return file

    agent = config.agent_id
    vehicle_sink: Sink = opened(f"{vehicle.name}-{agent}.tlog")
    broadcast = TlogWriter(opened(f"broadcast-{agent}.tlog"))
    return LogFolder(
        folder,
        files,
        FlightLog(TlogWriter(_Doubled(copy[0], vehicle_sink) if copy else vehicle_sink)),
        # The vehicle's log tells for all of them.
        FlightLog(broadcast, program=None, most_bytes_per_s=BROADCAST_LOG_BYTES_PER_S),
        DecisionTable(opened(f"decisions-{agent}.csv", HEAD)),
    )


class _Doubled:
    """A sink that writes everything twice, first where nothing can fail."""

    def __init__(self, copy: BinaryIO, sink: Sink) -> None:
        self._copy = copy
        self._sink = sink

    def write(self, content: bytes) -> None:
        self._copy.write(content)
        self._sink.write(content)

    def flush(self) -> None:
        self._sink.flush()

    def close(self) -> None:
        self._sink.close()


def _oldest_first(run: Path) -> list[Path]:
    """Return the logs in a run's folder, those written last at the end; files that no run wrote are not among them."""
    logs = [one for one in run.iterdir() if _LOG.fullmatch(one.name) and not one.is_symlink()]
    return sorted(logs, key=lambda log: log.stat().st_mtime)
