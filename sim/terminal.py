"""Shared by the commands of `sim`: progress and tables on a terminal, and checks of output folders and names."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from companion.errors import InputError, nearest_hint

PIPE_COLUMNS = 200
"""Width in characters of a wide table in a pipe, so that no line of it is broken."""


def writable_folder(path: Path) -> Path:
    """Return the folder, after creating it if necessary and checking that it can be written to.

    Raises:
        InputError: the folder cannot be written to.

    """
    if str(path) == ".":
        raise InputError("--out: ''; allowed: the name of a folder (./NAME for one here)")
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / ".writable"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise InputError(f"--out: '{path}' cannot be written: {error.strerror}; allowed: a writable folder") from error
    return path


def chosen_names(option: str, given: Sequence[str], allowed: Sequence[str]) -> list[str]:
    """Return the given names in the order of `allowed`, or all of `allowed` if none was given.

    Raises:
        InputError: a name is not allowed; the error names `option`, with which it was given.

    """
    for name in given:
        if name not in allowed:
            raise InputError(f"{option}: '{name}'{nearest_hint(name, allowed)}; allowed: {', '.join(allowed)}")
    return [name for name in allowed if not given or name in given]


def rendered(before: Sequence[str], table: Table, after: Sequence[str], wide: bool = False) -> str:
    """Return the text of a table with lines before and after it; a `wide` one has PIPE_COLUMNS columns in a pipe."""
    width = PIPE_COLUMNS if wide and not sys.stdout.isatty() else None
    console = Console(soft_wrap=True, highlight=False, markup=False, width=width)
    with console.capture() as capture:
        for line in before:
            console.print(line)
        console.print(table, end="")
        for line in after:
            console.print(f"\n{line}", end="")
    return capture.get().rstrip("\n")


@contextmanager
def flight_progress(targets: int) -> Iterator[Callable[[float, int], None]]:
    """Show a flight's progress on a terminal, nothing in a pipe.

    Yield the function that updates it, with the virtual time in seconds and the number of targets reached.
    """
    columns = (
        SpinnerColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} targets"),
        BarColumn(),
        TextColumn("flown {task.fields[flown]}"),
        TimeElapsedColumn(),
    )
    with _progress(columns) as bar:
        task = bar.add_task("fly", total=targets, flown="0 s")
        yield lambda t_s, reached: bar.update(task, completed=reached, flown=f"{t_s:.0f} s")


@contextmanager
def job_progress(title: str, jobs: str) -> Iterator[Callable[[int, int], None]]:
    """Show on a terminal how many jobs are done, nothing in a pipe.

    Yield the function that updates it, with the numbers of jobs done and in all.
    """
    columns = (
        SpinnerColumn(),
        TextColumn(f"{{task.completed:.0f}}/{{task.total:.0f}} {jobs}"),
        BarColumn(),
        TimeElapsedColumn(),
    )
    with _progress(columns) as bar:
        task = bar.add_task(title, total=1)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _progress(columns: Sequence[ProgressColumn]) -> Progress:
    console = Console(stderr=True)
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
