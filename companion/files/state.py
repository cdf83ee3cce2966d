"""Small text that must survive a crash: replaced as a whole, so that a file is either the old or the new one."""

from __future__ import annotations

import os
from pathlib import Path

from companion.errors import InputError

MAX_STATE_BYTES = 65_536


def read_state_file(path: Path) -> str | None:
    """Return what was written last, None if nothing ever was.

    Raises:
        InputError: there is something that cannot be read.

    """
    try:
        with path.open("rb") as file:
            return file.read(MAX_STATE_BYTES).decode()
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        raise InputError(f"{path}: cannot read the state: {reason}; allowed: a file of this program's") from error


def check_state_file(path: Path) -> None:
    """Find out whether the file could be written, without touching it.

    Raises:
        InputError: it could not.

    """
    fresh = path.with_name(f"{path.name}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        fresh.touch()
        fresh.unlink()
    except OSError as error:
        raise _unwritable(path, error) from error


def write_state_file(path: Path, text: str) -> None:
    """Replace the file; its folder is made if there is none. A machine that dies after that finds the new text.

    Raises:
        InputError: it cannot be written.

    """
    fresh = path.with_name(f"{path.name}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with fresh.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        raise _unwritable(path, error) from error


def _sync_folder(folder: Path) -> None:
    """Have the disk keep which file a name stands for: without that, a crash may leave the name to the old file."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(f"{path}: cannot write the state: {error.strerror}; allowed: a writable folder")
