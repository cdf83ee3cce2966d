"""Runs independent jobs on several processes, in any order."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TypeVar

JobT = TypeVar("JobT")
OutcomeT = TypeVar("OutcomeT")


def outcomes(run: Callable[[JobT], OutcomeT], jobs: Sequence[JobT], workers: int) -> Iterator[tuple[JobT, OutcomeT]]:
    """Yield every job with its result, as they are done by `workers` processes; 0: in this process and in order.

    `run` and the jobs are pickled. An exception of a job is raised here, and the other jobs are cancelled.
    """
    if workers == 0:
        for job in jobs:
            yield job, run(job)
        return
    # Forking is unsafe once a library has started threads, so the processes are spawned.
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(workers, mp_context=context, initializer=_die_quietly)
    try:
        futures = {executor.submit(run, job): job for job in jobs}
        for future in as_completed(futures):
            yield futures[future], future.result()
    except BaseException:
        # Interrupted: a job under way would go on for minutes.
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


def _die_quietly() -> None:
    """Make a keyboard interrupt, which reaches every process, end this one without a traceback."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
