"""The programs' messages on the terminal: one logger per program, and one line `program: text` per message."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime

import click

from companion.errors import one_line, printable

Job = Callable[[], None]


class ConsoleHandler(logging.Handler):
    """Writes information to standard output, warnings and errors to standard error, as `program: message`.

    An error of the terminal or pipe is raised by the call that logs the message, unless `do` writes on another thread:
    a program whose reader has gone away ends.
    """

    def __init__(self) -> None:
        super().__init__()
        self.do: Callable[[Job], object] = _do_at_once
        """Callable that is given the writing of each message as a job, to run it now or on another thread."""
        self.as_json = False
        """Whether each line is a JSON object."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a message as one line."""
        line = printable(json_line(record) if self.as_json else _text_line(record))
        is_error = record.levelno >= logging.WARNING
        self.do(lambda: click.echo(line, err=is_error))


def program_logger(program: str) -> logging.Logger:
    """Return the logger of a program, whose messages go to the terminal."""
    logger = logging.getLogger(program)
    if not logger.handlers:
        logger.addHandler(ConsoleHandler())
        logger.setLevel(logging.INFO)
        # Each message is printed once, whatever handlers a library gives to the root logger.
        logger.propagate = False
    return logger


def _text_line(record: logging.LogRecord) -> str:
    warning = "warning: " if record.levelno == logging.WARNING else ""
    line = f"{record.name}: {warning}{record.getMessage()}"
    return one_line(line) if "\n" in line else line


def json_line(record: logging.LogRecord) -> str:
    """Return a message as a JSON object: time (ISO 8601, UTC), level, program, message and, of a failure, traceback."""
    at = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")
    values = {"time": at, "level": record.levelname.lower(), "program": record.name, "message": record.getMessage()}
    if record.exc_info and record.exc_info[0] is not None:
        values["traceback"] = logging.Formatter().formatException(record.exc_info)
    return json.dumps(values, ensure_ascii=False)


def messages_as_json(program: str) -> None:
    """Have a program's messages written as JSON objects, one a line."""
    for handler in program_logger(program).handlers:
        if isinstance(handler, ConsoleHandler):
            handler.as_json = True


@contextmanager
def messages_written_by(program: str, do: Callable[[Job], object]) -> Iterator[None]:
    """Have another thread write a program's messages until the context ends: its loop never waits for the terminal.

    `do` is given the writing of each message as a job, e.g. IoThread.do.
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
