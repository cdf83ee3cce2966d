"""One-line errors for bad input, and the exit statuses that all three programs share.

A user's mistake (a bad file, a wrong key, an unknown name) must never end in a traceback: the code that finds it raises
InputError with a message naming file, key, value and what is allowed, and `run_program` prints that one line.
"""

from __future__ import annotations

import difflib
import os
import sys
from collections.abc import Iterable

import click

EXIT_DONE = 0
EXIT_FAILED = 1
"""Exit status of a program that ran to its end with a bad result, e.g. a mission or a check that failed."""
EXIT_UNUSABLE = 2
"""Exit status for input that cannot be used, such as a wrong option, file, key or value."""
EXIT_SIGNALLED = 128
"""Exit status of a program that a signal stopped, less the signal's number, as shells count it."""
EXIT_INTERRUPTED = EXIT_SIGNALLED + 2
"""Exit status of a program that was stopped from the keyboard, by SIGINT."""
EXTRAS = {"companion": "ground", "groundstation": "ground", "sim": "sim"}
"""By program, the extra in `pip install '.[EXTRA]'` that installs what its commands need beside the base libraries."""
_OPTIONAL = (
    "defusedxml", "fastapi", "foxglove_schemas_protobuf", "geojson_pydantic", "jinja2", "kml2geojson", "matplotlib",
    "mcap_protobuf", "orjson", "prometheus_client", "rich", "scipy", "uvicorn", "websockets", "xstatic",
)  # fmt: skip
"""Libraries that these extras install; a program imports them only in the commands that use them."""
_PICTURES, _PICTURES_EXTRA = ("jinja2", "matplotlib"), "sim"
"""Libraries for pictures and reports, and the extra that alone installs them, for any program."""


class InputError(Exception):
    """Unusable input; the message is one line for the user."""


def nearest_hint(word: str, known: Iterable[str]) -> str:
    """Return "; did you mean 'x'?" for the known word nearest to `word`, or an empty string."""
    matches = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f"; did you mean '{matches[0]}'?" if matches else ""


def some_of(things: Iterable[object], most: int) -> str:
    """Return things in words, "1, 2, 3 and 4 more": the first `most` if there are more; empty if there are none."""
    words = [str(thing) for thing in things]
    return ", ".join(words[:most]) + (f" and {len(words) - most} more" if len(words) > most else "")


def one_line(text: str) -> str:
    """Return the text with every run of white space made one blank, so that a library's message stays on one line."""
    return " ".join(text.split())


def printable(text: str) -> str:
    """Return a text of one line that a terminal only shows: each character that cannot be printed is a question mark.

    A name from outside may hold line ends, the escapes that steer a terminal, or marks that turn the direction of what
    follows; none of them may look like a word of the program.
    """
    return text if text.isprintable() else "".join(one if one.isprintable() else "?" for one in text)


def tell(text: str) -> None:
    """Print lines to standard output; a reader that has closed the pipe (`| head`) is no failure of the program."""
    try:
        print("\n".join(map(printable, text.split("\n"))), flush=True)
    except BrokenPipeError:
        # What is still buffered has nowhere to go either, and must not fail at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def run_program(command: click.Command, name: str) -> None:
    """Run a command line and exit with its status; an error of the user or the machine prints one line on stderr.

    A command returns its exit status (None counts as 0).
    """
    try:
        status = command.main(prog_name=name, standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError:
        message, status = f"Missing command; see '{name} --help'", EXIT_UNUSABLE
    except click.UsageError as error:
        message, status = error.format_message(), EXIT_UNUSABLE
    except click.ClickException as error:
        message, status = error.format_message(), EXIT_UNUSABLE
    except InputError as error:
        message, status = str(error), EXIT_UNUSABLE
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library not in _OPTIONAL or name not in EXTRAS:
            raise
        extra = _PICTURES_EXTRA if library in _PICTURES else EXTRAS[name]
        message, status = f"needs {library}, which is not installed: pip install '.[{extra}]'", EXIT_UNUSABLE
    except OSError as error:
        # A full disk, a vanished folder: the machine's fault, not the mission's, and no reason for a traceback.
        where = f"{error.filename}: " if error.filename else ""
        message, status = f"{where}{error.strerror or error}", EXIT_UNUSABLE
    except click.Abort:
        message, status = "interrupted", EXIT_INTERRUPTED
    else:
        sys.exit(status if isinstance(status, int) else EXIT_DONE)
    print(f"{name}: {printable(one_line(message))}", file=sys.stderr)
    sys.exit(status)
