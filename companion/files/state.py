"""Small state files that survive a crash: each is replaced as a whole, so that it holds the old text or the new one."""

from __future__ import annotations

import errno
import os
import stat
from contextlib import suppress
from pathlib import Path

from companion.errors import InputError
from companion.files.regular import can_be_written, places_to, read_regular, refuse_other

MAX_STATE_BYTES = 65_536
"""Greatest size of a state file."""
CANNOT_SYNC = frozenset({errno.EACCES, errno.EINVAL, errno.ENOTSUP})
"""Errors of folders that nobody can sync: one that must not be read, or a file system that has no such call."""
_MODE = 0o644
"""Mode of a new file: a state holds no secret."""


def read_state_file(path: Path) -> str | None:
    """Return the text that was last written to a state file; None if there is no such file.

    Raises:
        InputError: the file cannot be read, is a link, a pipe or a device, is too large or is not text.

    """
    try:
        return read_regular(path, MAX_STATE_BYTES)[0].decode()
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
    fresh = _fresh(path)
    try:
        refuse_other(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = _made(fresh)
        try:
            # A full disk often takes a name, but no byte.
            os.write(descriptor, b"\n")
        finally:
            os.close(descriptor)
            fresh.unlink()
    except OSError as error:
        raise _unwritable(path, error) from error


def warnings_of(path: Path) -> list[str]:
    """Return warnings about a state file that any user of the computer could replace, or a folder on the way to it."""
    # The file itself may not be there yet.
    start = path if path.exists() else path.parent
    with suppress(OSError):
        for place, status in places_to(start):
            # A link has no mode of its own; what it leads to comes later.
            if can_be_written(status.st_mode):
                what = (
                    "others can replace the state" if place == path.absolute() else "others can replace the state in it"
                )
                return [f"{place}: {what} (mode {stat.S_IMODE(status.st_mode):03o}); chmod o-w {place}"]
    return []


def write_state_file(path: Path, text: str) -> None:
    """Replace a state file, making its folder if there is none; then the new text is safe from a crash of the machine.

    Raises:
        InputError: the file cannot be written, or a link, a pipe, a device or a folder is in its place.

    """
    fresh = _fresh(path)
    try:
        refuse_other(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        mode = stat.S_IMODE(path.stat().st_mode) if path.exists() else None
        with os.fdopen(_made(fresh), "w", encoding="utf-8") as file:
            if mode is not None:
                os.fchmod(file.fileno(), mode)
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        raise _unwritable(path, error) from error


def overwrite_state_file(path: Path, text: str) -> None:
    """Overwrite a state file in its place by a text of the same length, for which a full disk still has room.

    A crash meanwhile may leave a mixture of the two: it is for states whose reader takes such a file for the worst.

    Raises:
        InputError: there is no file of this length, or it cannot be written.

    """
    content = text.encode()
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode) or status.st_size != len(content):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.pwrite(descriptor, content, 0)
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise _unwritable(path, error) from error


def _fresh(path: Path) -> Path:
    return path.with_name(f"{path.name}.new")


def _made(fresh: Path) -> int:
    """Return the descriptor of a file that was made anew; one that a crash left is removed, or a link, not followed."""
    with suppress(FileNotFoundError):
        fresh.unlink()
    return os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, _MODE)


def sync_folder(folder: Path) -> None:
    """Write a folder's entries to disk: without that, after a crash the name may still stand for the old file.

    A folder that cannot be synced at all is left: its files are written, as safe as they can be there.
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
