"""Small state files that survive a crash: each is replaced as a whole, so that it holds the old text or the new one."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from companion.errors import InputError

MAX_STATE_BYTES = 65_536
"""Greatest number of bytes that are read of a state file."""
CANNOT_SYNC = frozenset({errno.EACCES, errno.EINVAL, errno.ENOTSUP})
"""Errors of folders that nobody can sync: one that must not be read, or a file system that has no such call."""


def read_state_file(path: Path) -> str | None:
    """Return the text that was last written to a state file; None if there is no such file.

    Raises:
        InputError: the file cannot be read or is not text.

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
    """Check that a state file can be written, without touching it: a file beside it is made and removed.

    Raises:
        InputError: the file cannot be written.

    """
    fresh = path.with_name(f"{path.name}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        fresh.touch()
        fresh.unlink()
    except OSError as error:
        raise _unwritable(path, error) from error


def write_state_file(path: Path, text: str) -> None:
    """Replace a state file, making its folder if there is none; then the new text is safe from a crash of the machine.

    Raises:
        InputError: the file cannot be written.

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
    """Write a folder's entries to disk: without that, after a crash the name may still stand for the old file.

    A folder that cannot be synced at all is left: its state files are written, as safe as they can be there.
    """
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        if error.errno not in CANNOT_SYNC:
            raise


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(f"{path}: cannot write the state: {error.strerror}; allowed: a writable folder")
