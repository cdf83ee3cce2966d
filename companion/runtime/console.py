"""How the programs' messages reach the terminal: one logger per program, one line per message, nothing else in it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click

Job = Callable[[], None]


class ConsoleHandler(logging.Handler):
    """Writes information to standard output, warnings and errors to standard error, as `program: message`.

    What a terminal or pipe raises is raised where the message is given: a reader that has gone away ends a program.
    """

    def __init__(self) -> None:
        super().__init__()
        self.do: Callable[[Job], object] = _do_at_once
        """Does the writing of each message."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one message."""
        warning = "warning: " if record.levelno == logging.WARNING else ""
        line, is_error = f"{record.name}: {warning}{record.getMessage()}", record.levelno >= logging.WARNING
        self.do(lambda: click.echo(line, err=is_error))


def program_logger(program: str) -> logging.Logger:
    """Return the logger of a program, whose messages go to the terminal."""
    logger = logging.getLogger(program)
    if not logger.handlers:
        logger.addHandler(ConsoleHandler())
        logger.setLevel(logging.INFO)
        # Whatever a library does with the root logger, a message is told once.
        logger.propagate = False
    return logger


@contextmanager
def messages_written_by(program: str, do: Callable[[Job], object]) -> Iterator[None]:
    """Have another thread write a program's messages until the context ends: its loop never waits for the terminal.

    `do` is given the writing of each as a job (IoThread.do).
    """
    handlers = [handler for handler in program_logger(program).handlers if isinstance(handler, ConsoleHandler)]
    for handler in handlers:
        handler.do = do
    try:
        yield
    finally:
        for handler in handlers:
            handler.do = _do_at_once


def _do_at_once(job: Job) -> None:
    job()
