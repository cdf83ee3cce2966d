"""The programs of a flight as processes: the user's own autopilots, the ground station and the companions."""

from __future__ import annotations

import fcntl
import itertools
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from companion.errors import InputError
from companion.mission.places import Origin

ARDUPILOT = "ARDUPILOT_SITL"
PX4 = "PX4_SITL"
NOT_GIVEN = f"real autopilots: set {ARDUPILOT} or {PX4} to your own build (docs/real-autopilots.md)"
_END_PATIENCE_S = 5.0
_HELD: list[IO[str]] = []
"""Locks of the instances that this process flies."""


class Program:
    """A process whose lines are kept with the time at which they came; it can be killed and started again."""

    def __init__(self, command: Sequence[str], folder: Path, name: str, more: Mapping[str, str] | None = None) -> None:
        """Start a command in a folder, which gets its output as NAME.log; `more` are environment variables."""
        self._command, self._folder, self._name = list(command), folder, name
        self._environment = {**os.environ, "PYTHONUNBUFFERED": "1", **(more or {})}
        self.said: list[tuple[float, str]] = []
        self.start()

    def start(self) -> None:
        """Start, or start again after it was killed."""
        self._process = subprocess.Popen(
            self._command,
            cwd=self._folder,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        )
        self._listening = threading.Thread(target=self._listen, args=(self._process,), daemon=True)
        self._listening.start()

    def _listen(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        with (self._folder / f"{self._name}.log").open("a", encoding="utf-8") as log, process.stdout:
            for line in process.stdout:
                self.said.append((time.time(), line.rstrip()))
                log.write(f"{time.time():.3f} {line.rstrip()}\n")
                log.flush()

    @property
    def runs(self) -> bool:
        """Whether the process has not ended."""
        return self._process.poll() is None

    def signal(self, number: int) -> None:
        """Send a signal to the process; one that has ended gets none."""
        if self.runs:
            self._process.send_signal(number)

    def has_said(self, text: str, after_unix_s: float = 0.0) -> bool:
        """Return whether a line with this text came after a time."""
        return any(text in line for said_s, line in list(self.said) if said_s >= after_unix_s)

    def end(self) -> None:
        """End the process, first asking it to, and wait for it."""
        self.signal(signal.SIGCONT)
        self.signal(signal.SIGTERM)
        try:
            self._process.wait(_END_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._listening.join(_END_PATIENCE_S)


def module(name: str, *arguments: str) -> list[str]:
    """Return the command that runs one of the project's programs."""
    return [sys.executable, "-m", name, *arguments]


@dataclass(frozen=True)
class Place:
    """The place and the identity with which an autopilot starts."""

    agent_id: int
    origin: Origin
    """Where it stands, its ground's height above sea level in metres included."""
    heading_deg: float
    parameters: Mapping[str, float]
    """Parameters that it has from its start on, beside those of its own defaults."""
    instance: int
    """Number of the instance, which shifts its ports; its system id is one more."""

    @property
    def system_id(self) -> int:
        """Its MAVLink system id."""
        return self.instance + 1


def _folder_of(variable: str) -> Path:
    """Return the folder that an environment variable names, or that holds the program it names."""
    given = os.environ.get(variable)
    if not given:
        raise InputError(f"{variable}: not set; allowed: the folder of your own build (docs/real-autopilots.md)")
    path = Path(given).resolve()
    return path.parent if path.is_file() else path


def is_given(firmware: str) -> bool:
    """Return whether the user named a build of `ArduPilot` or `PX4`."""
    return bool(os.environ.get(ARDUPILOT if firmware == "ArduPilot" else PX4))


def _defaults(folder: Path, name: str) -> Path:
    """Return a parameter file of ArduPilot's autotest from the tree that holds the build.

    Raises:
        InputError: the tree has no such file.

    """
    for above in (folder, *folder.parents):
        found = above / "Tools" / "autotest" / name
        if found.is_file():
            return found
    raise InputError(f"{ARDUPILOT}: {folder} is not inside an ArduPilot tree with Tools/autotest/{name}")


def first_instance() -> int:
    """Return the first of three instances of PX4 that no other flight on this computer has, waiting until there are.

    PX4's instances meet in files of /tmp, whatever network they are in, and there are ten of them on a computer.
    """
    for first in itertools.cycle((0, 3, 6)):
        lock = Path(tempfile.gettempdir(), f"tests-real-px4-{first}.lock").open("w")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            time.sleep(0.5)
        else:
            _HELD.append(lock)
            return first
    raise AssertionError("itertools.cycle never ends")


def start_ardupilot(vehicle: str, place: Place, folder: Path) -> Program:
    """Start ArduCopter (`copter`) or ArduPlane (`plane`) in an empty folder of its own, at its own speed.

    Raises:
        InputError: the environment does not name a build with that program.

    """
    built = _folder_of(ARDUPILOT)
    binary = built / f"ardu{vehicle}"
    if not os.access(binary, os.X_OK):
        raise InputError(f"{ARDUPILOT}: {built} has no program ardu{vehicle}")
    defaults = {"copter": ("default_params/copter.parm", "+"), "plane": ("models/plane.parm", "plane")}
    file, model = defaults[vehicle]
    own = folder / "own.parm"
    own.write_text("".join(f"{name} {value:g}\n" for name, value in place.parameters.items()), encoding="ascii")
    at = place.origin
    return Program(
        [
            str(binary), "--model", model, "--speedup", "1", f"-I{place.instance}", "--sysid", str(place.system_id),
            "--serial0", "tcp:0", "--defaults", f"{_defaults(built, file)},{own}",
            "--home", f"{at.lat_deg:.8f},{at.lon_deg:.8f},{at.alt_m:g},{place.heading_deg:g}",
        ],
        folder,
        "autopilot",
    )  # fmt: skip


def start_px4(model: str, place: Place, folder: Path) -> Program:
    """Start PX4 with its own simulator SIH (`sihsim_quadx` or `sihsim_airplane`) in an empty folder of its own.

    Raises:
        InputError: the environment does not name a build with that program.

    """
    built = _folder_of(PX4)
    built = built.parent if built.name == "bin" else built
    binary = built / "bin" / "px4"
    if not os.access(binary, os.X_OK):
        raise InputError(f"{PX4}: {built} has no program bin/px4")
    at = place.origin
    environment = {
        "PX4_SIMULATOR": "sihsim",
        "PX4_SIM_MODEL": model,
        "PX4_HOME_LAT": f"{at.lat_deg:.8f}",
        "PX4_HOME_LON": f"{at.lon_deg:.8f}",
        "PX4_HOME_ALT": f"{at.alt_m:g}",
        **{f"PX4_PARAM_{name}": f"{value:g}" for name, value in place.parameters.items()},
    }
    command = [str(binary), "-d", "-i", str(place.instance), str(built / "etc")]
    return Program(command, folder, "autopilot", environment)
