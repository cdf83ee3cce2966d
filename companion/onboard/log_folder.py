"""The folder of logs that one run of `companion run` writes."""

from __future__ import annotations

import shutil
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from companion.errors import InputError
from companion.files.tlog import TlogWriter
from companion.onboard.config import Config, dump_config
from companion.onboard.decision_table import DecisionTable
from companion.onboard.flight_log import FlightLog, unused
from companion.runtime.io_thread import IoThread, IoThreadFile

BROADCAST_LOG_BYTES_PER_S = 20_000.0
"""Greatest rate at which the broadcast is logged: several times that of any radio in use, and a bound in a flood."""


@dataclass(frozen=True)
class LogFolder:
    """The logs of a run; they write nothing where no folder is configured."""

    path: Path | None
    vehicle: FlightLog
    """Log of the companion's inputs, decisions and sent frames, which a replay needs."""
    broadcast: FlightLog
    """Log of all frames of the broadcast link, accepted or not."""
    decisions: DecisionTable | None

    def remove(self) -> None:
        """Remove the folder of a run that never began."""
        if self.path is not None:
            shutil.rmtree(self.path, ignore_errors=True)


def open_log_folder(config: Config, files: IoThread, stack: ExitStack) -> LogFolder:
    """Open the logs of a run in a new folder, so that a restart overwrites nothing; `stack` closes them.

    Raises:
        InputError: the folder cannot be written to.

    """
    if config.log_dir is None:
        return LogFolder(None, FlightLog(None), FlightLog(None), None)
    folder = unused(Path(config.log_dir) / time.strftime("%Y%m%dT%H%M%SZ", time.gmtime()))
    try:
        folder.mkdir(parents=True)
        (folder / f"companion-{config.agent_id}.yaml").write_text(dump_config(config), encoding="utf-8")
        vehicle, broadcast, decisions = (
            IoThreadFile(folder / f"{name}-{config.agent_id}.{suffix}", files)
            for name, suffix in (("vehicle", "tlog"), ("broadcast", "tlog"), ("decisions", "csv"))
        )
    except OSError as error:
        raise InputError(
            f"log_dir: '{config.log_dir}' cannot be used: {error.strerror}; allowed: a writable folder"
        ) from error
    broadcast_log = FlightLog(TlogWriter(broadcast), most_bytes_per_s=BROADCAST_LOG_BYTES_PER_S)
    logs = LogFolder(folder, FlightLog(TlogWriter(vehicle)), broadcast_log, DecisionTable(decisions))
    for closing in (vehicle.close, broadcast.close, decisions.close):
        stack.callback(closing)
    return logs
