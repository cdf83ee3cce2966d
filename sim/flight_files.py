"""The files of a flight that grow with it, and room on the disk for those that are written at its end.

What a program that is killed leaves behind is what it has passed on to the operating system: `FlightFiles` does that
once a second of wall-clock time.
"""

from __future__ import annotations

import errno
import os
import tempfile
import time
from pathlib import Path
from typing import IO

from companion.files.tlog import TlogWriter
from sim.stop import Stop, disk_stop
from sim.trajectory import TrajectoryBuilder, TrajectoryFile

MISSION_NAME = "mission.yaml"
TRAJECTORY_NAME = "trajectory.csv"
BROADCAST_NAME = "broadcast.tlog"
RESULT_NAME = "result.json"
EVENTS_NAME = "events.jsonl"
"""What was asked and noticed in a flight that a page, or recorded tracks, could change."""
RESERVE_BYTES = 4 * 2**20
"""Room that is kept free until the end of a flight for its result, its pictures and its report: several times of what
they take."""
_LEAST_RESERVE_BYTES = 2**16
_PERIOD_S = 1.0
"""Wall-clock time between two writings, and so the most that is lost if the program is killed."""


def vehicle_log_name(agent_id: int) -> str:
    """Return the name of the log of an agent's vehicle."""
    return f"vehicle-{agent_id}.tlog"


class FlightFiles:
    """Trajectory and logs of a flight under way; without a folder nothing is written."""

    def __init__(self, folder: Path | None, builder: TrajectoryBuilder) -> None:
        """Begin the trajectory, whose steps `builder` collects.

        Raises:
            OSError: the folder cannot be written.

        """
        self._folder = folder
        self._logs: list[TlogWriter] = []
        self._next_s = time.monotonic() + _PERIOD_S
        self._reserve = None if folder is None else _reserve(folder)
        self._trajectory = None if folder is None else TrajectoryFile(folder / TRAJECTORY_NAME, builder)

    def log(self, name: str) -> TlogWriter | None:
        """Begin a log of this name; None if nothing is written."""
        if self._folder is None:
            return None
        self._logs.append(TlogWriter(self._folder / name))
        return self._logs[-1]

    def keep_up(self) -> None:
        """Write what the flight has added, if the last time was a while ago.

        Raises:
            OSError: the disk takes no more.

        """
        now_s = time.monotonic()
        if self._trajectory is None or now_s < self._next_s:
            return
        self._next_s = now_s + _PERIOD_S
        self._trajectory.catch_up()
        for log in self._logs:
            log.flush()

    def close(self) -> Stop | None:
        """Write the rest and close everything; return what the disk refused, None if nothing."""
        refused: Stop | None = None
        if self._reserve is not None:
            self._reserve.close()
        try:
            if self._trajectory is not None:
                self._trajectory.close()
        except OSError as error:
            refused = disk_stop(error, self._folder)
        for log in self._logs:
            try:
                log.close()
            except OSError as error:
                refused = refused or disk_stop(error, self._folder)
        self._logs.clear()
        return refused

    def steps_written(self, steps: int) -> int:
        """Return how many of a flight's steps are in its file, all of them if there is none."""
        return steps if self._trajectory is None else self._trajectory.steps


def _reserve(folder: Path) -> IO[bytes] | None:
    """Return a nameless file in the folder that takes RESERVE_BYTES of its disk, or less if there are not as many."""
    count = RESERVE_BYTES
    while count >= _LEAST_RESERVE_BYTES:
        file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 it is closed with the flight's files
        try:
            os.posix_fallocate(file.fileno(), 0, count)
        except OSError as error:
            file.close()
            if error.errno not in (errno.ENOSPC, errno.EFBIG, errno.EDQUOT):
                return None
            count //= 2
        else:
            return file
    return None
