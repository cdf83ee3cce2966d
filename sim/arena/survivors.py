"""Runs independent jobs on processes of which any may hang or die: then its job is lost and the others go on."""

from __future__ import annotations

import multiprocessing
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Generic, TypeVar

JobT = TypeVar("JobT")
OutcomeT = TypeVar("OutcomeT")

POLL_S = 1.0
"""Longest time between two looks at the clock."""


@dataclass
class _Worker(Generic[JobT]):
    process: BaseProcess
    pipe: Connection
    job: JobT
    began_s: float


def survivors(
    run: Callable[[JobT], OutcomeT], jobs: Sequence[JobT], workers: int, limit_s: float
) -> Iterator[tuple[JobT, OutcomeT | str]]:
    """Yield every job with its result, or in a text why it has none, as they are done by `workers` processes.

    A job that raises gives its traceback, one that takes longer than `limit_s` or ends its process says so.
    """
    context = multiprocessing.get_context("spawn")
    waiting = list(reversed(jobs))
    busy: list[_Worker[JobT]] = []
    idle: list[tuple[BaseProcess, Connection]] = []
    try:
        while waiting or busy:
            while waiting and len(busy) < workers:
                process, pipe = idle.pop() if idle else _started(context, run)
                pipe.send(waiting[-1])
                busy.append(_Worker(process, pipe, waiting.pop(), time.monotonic()))
            ready = wait([worker.pipe for worker in busy], POLL_S)
            for worker in list(busy):
                late = time.monotonic() - worker.began_s > limit_s
                if worker.pipe not in ready and not late:
                    continue
                busy.remove(worker)
                ended = False
                try:
                    found = worker.pipe.recv() if worker.pipe in ready else f"took longer than {limit_s:g} s"
                except (EOFError, ConnectionResetError):
                    # A process that has just ended may still count as alive.
                    found, ended = "its process ended", True
                if worker.pipe in ready and not ended and worker.process.is_alive():
                    idle.append((worker.process, worker.pipe))
                else:
                    worker.process.kill()
                yield worker.job, found
    finally:
        for process, pipe in [*idle, *((worker.process, worker.pipe) for worker in busy)]:
            pipe.close()
            process.kill()


def _started(
    context: multiprocessing.context.SpawnContext, run: Callable[[JobT], OutcomeT]
) -> tuple[BaseProcess, Connection]:
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(run, theirs), daemon=True)
    process.start()
    theirs.close()
    return process, ours


def _serve(run: Callable[[JobT], OutcomeT], pipe: Connection) -> None:
    """Run the jobs that come through a pipe until it is closed; send each one's result, or its traceback."""
    while True:
        try:
            job = pipe.recv()
        except EOFError:
            return
        try:
            pipe.send(run(job))
        except Exception:  # noqa: BLE001 whatever a job raises is its result
            pipe.send(traceback.format_exc())
