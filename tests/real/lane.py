"""The lane: which flights there are, and how each is flown in a network of its own, scored and judged."""

from __future__ import annotations

import fcntl
import json
import shutil
import socket
import struct
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from companion.errors import InputError, nearest_hint
from sim.terminal import writable_folder
from tests.real.flight import Flight, GroundFailure
from tests.real.kinds import KINDS, Kind
from tests.real.programs import is_given
from tests.real.scenarios import SCENARIOS, Figure, Scenario
from tests.real.score import Figures, figures_of

_SIOCSIFFLAGS = 0x8914
_IFF_UP_RUNNING = 0x41
_PROJECT = Path(__file__).parents[2]
LONGEST_S = 1200.0
LEAST_TRUTH_SHARE = 0.5
"""Share of its simulator's samples below which a flight shows the computer, and nothing of the companion."""


@dataclass(frozen=True)
class Job:
    """One scenario with one kind."""

    scenario: Scenario
    kind_name: str

    @property
    def name(self) -> str:
        """SCENARIO:KIND."""
        return f"{self.scenario.name}:{self.kind_name}"

    @property
    def kind(self) -> Kind:
        """The kind of vehicle."""
        return KINDS[self.kind_name]

    @property
    def can_be_flown(self) -> bool:
        """Whether the user named a build of its firmware."""
        return is_given(self.kind.firmware)

    @classmethod
    def named(cls, name: str) -> Job:
        """Return the job of a name; raise InputError if there is none."""
        for job in jobs():
            if job.name == name:
                return job
        raise InputError(f"'{name}'{nearest_hint(name, [job.name for job in jobs()])}; allowed: see `list`")


@dataclass(frozen=True)
class Verdict:
    """What became of a flight: the bounds that it broke, in words; none if it kept them all."""

    job: Job
    broken: tuple[str, ...]


def jobs() -> list[Job]:
    """Return all flights, in the table's order."""
    return [Job(scenario, kind) for scenario in SCENARIOS for kind in scenario.kinds]


def job_of(folder: Path) -> Job:
    """Return the job that was flown into a folder."""
    record = json.loads((folder / "flight.json").read_text(encoding="utf-8"))
    return Job.named(f"{record['scenario']}:{record['kind']}")


def can_have_networks() -> bool:
    """Return whether this user may give a process a network of its own."""
    if shutil.which("unshare") is None:
        return False
    return subprocess.run(_apart("true"), capture_output=True, check=False).returncode == 0


def _apart(*command: str) -> list[str]:
    # Whatever ends a flight early, its programs end with it: the first process of the processes' own name space dies.
    return ["unshare", "--net", "--pid", "--fork", "--kill-child", "--map-root-user", *command]


def fly_apart(job: Job, out: Path) -> Verdict:
    """Fly in a process of its own, in a network of its own if that is permitted; say and return what became of it."""
    folder = out / job.name.replace(":", "-")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    command = [sys.executable, "-m", "tests.real", "one", job.name, str(folder.resolve())]
    done = subprocess.run(
        _apart(*command) if can_have_networks() else command,
        cwd=_PROJECT, capture_output=True, text=True, timeout=LONGEST_S, check=False,
    )  # fmt: skip
    (folder / "flown.log").write_text(done.stdout + done.stderr, encoding="utf-8")
    if done.returncode:
        broken: tuple[str, ...] = ((done.stderr.strip().splitlines() or ["ended without a word"])[-1],)
    else:
        broken = tuple(json.loads((folder / "figures.json").read_text(encoding="utf-8"))["broken"])
    print(f"{job.name}: {'; '.join(broken) or 'as wanted'}", flush=True)
    return Verdict(job, broken)


def fly_here(job: Job, folder: Path) -> str:
    """Fly in this process's network, and write figures and broken bounds into the folder; return these in words.

    Raises:
        InputError: the build is not named, or the flight did not come about.

    """
    bring_up_loopback()
    flight = Flight(job.scenario, job.kind, writable_folder(folder))
    try:
        flight.write(flight.fly())
    except GroundFailure as failure:
        raise InputError(f"{job.name}: {failure}") from failure
    return f"{job.name}: {'; '.join(judge(job, folder)) or 'as wanted'}"


def judge(job: Job, folder: Path) -> list[str]:
    """Score the flight in a folder, write its figures there, and return the bounds that it broke, in words."""
    figures = figures_of(folder)
    broken = broken_bounds(figures, job)
    judged = {**figures.to_dict(), "broken": broken}
    (folder / "figures.json").write_text(json.dumps(judged, indent=1), encoding="utf-8")
    return broken


def bring_up_loopback() -> None:
    """Bring up 127.0.0.1, which is down in a new network; where it is up, or may not be touched, leave it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        try:
            fcntl.ioctl(any_socket, _SIOCSIFFLAGS, struct.pack("16sh14x", b"lo", _IFF_UP_RUNNING))
        except PermissionError:
            return


def broken_bounds(figures: Figures, job: Job) -> list[str]:
    """Return the bounds of its scenario that a flight broke, in words."""
    broken = []
    if figures.truth_share < LEAST_TRUTH_SHARE:
        broken.append(f"no flight: simulator starved, {100 * figures.truth_share:.0f} % of its samples came")
    if job.scenario.refused and figures.agents[0].gap_s is not None:
        broken.append("it was steered, and should have been refused")
    for figure, bound in job.scenario.bounds(job.kind).items():
        # A companion cannot send while nothing on the computer runs.
        bound += figures.pause_s if figure == "gap_s" else 0.0
        for value in _values(figures, figure):
            if value is None or value > bound:
                broken.append(f"{figure} {'unknown' if value is None else f'{value:g}'}, at most {bound:g}")
    return broken


def _values(figures: Figures, figure: Figure) -> list[float | None]:
    if figure in ("last_after_told_s", "delivered_after_told_s"):
        taken = [event for event in figures.events if event.what in ("mode wait", "mode return_home")]
        return [getattr(event, figure) for event in taken]
    if figure in ("entries", "breaches", "open_targets"):
        return [getattr(figures, figure)]
    return [getattr(agent, figure) for agent in figures.agents]
