"""Logs that grow: each goes on in a next file when one is full, after an error of the disk, or when its file is gone.

A program that logs must not fill the disk that keeps its state: nothing is written where less than LEAST_FREE_BYTES
would be left, and the oldest logs make room for the newest.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

LEAST_FREE_BYTES = 4 * 2**20
"""Room that logs leave on their disk, for state files and for whoever looks after the disk."""
MOST_FILE_BYTES = 100 * 2**20
"""Greatest size of one file."""
FILES_IN_ALL = 20
"""Number of files, at least, that the bound of all logs together is divided into."""
_FLAGS = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


def file_bytes(most_bytes: int) -> int:
    """Return the size at which a log goes on in a next file, if all logs together may have `most_bytes`."""
    return min(MOST_FILE_BYTES, most_bytes // FILES_IN_ALL)


def part_of(path: Path, number: int) -> Path:
    """Return the name of a log's file of this number, from 1: vehicle-1.tlog, vehicle-1-2.tlog and so on."""
    return path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")


def parts_of(path: Path, number: int = 1) -> list[Path]:
    """Return the files of a log from a number on: that one, whether it is there or not, and those that follow it."""
    parts = [part_of(path, number)]
    while (following := part_of(path, number + len(parts))).exists():
        parts.append(following)
    return parts


def remove_oldest(oldest_first: Iterable[Path], most_bytes: int) -> None:
    """Remove files, the oldest first, until those that remain have at most `most_bytes`; raises OSError."""
    sizes = [(path, path.lstat().st_size) for path in oldest_first if path.is_file() and not path.is_symlink()]
    in_all = sum(size for _, size in sizes)
    for path, size in sizes:
        if in_all <= most_bytes:
            return
        path.unlink(missing_ok=True)
        in_all -= size


def unsaid(_records: bytes) -> bytes:
    """Return nothing: a file whose records before these are gone says nothing of it."""
    return b""


class LogSeries:
    """One log in files that follow each other. It belongs to one thread, which waits for the disk."""

    def __init__(
        self,
        place: Callable[[int], Path],
        most_file_bytes: int,
        head: bytes = b"",
        gap_before: Callable[[bytes], bytes] = unsaid,
    ) -> None:
        """Write nothing yet; every file begins with `head`.

        `gap_before` returns what stands before the first records in a file that begins without those before them,
        because the file that had them was taken away.

        `place` returns the path of the file of a number, from 1, and makes its folder and the room for it; it may raise
        OSError.
        """
        self._place = place
        self._most_file_bytes = most_file_bytes
        self._head = head
        self._gap_before = gap_before
        self._newest: Path | None = None
        """The newest file that took records."""
        self._number = 1
        self._path: Path | None = None
        self._descriptor: int | None = None
        self._size = 0

    def append(self, content: bytes) -> None:
        """Append records; either all of them are written or, as far as the disk allows, none of them.

        Raises OSError; the next call tries again, in the same file if it is still there.
        """
        try:
            if self._descriptor is not None and self._size + len(content) > max(self._most_file_bytes, len(content)):
                self.close()
                self._number += 1
            if self._descriptor is None:
                self._open(content)
            self._check_room(len(content))
            self._write(content)
        except OSError:
            self._give_back()
            raise
        self._size += len(content)
        self._newest = self._path

    def close(self) -> None:
        """Close the file; raises OSError."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is not None:
            os.close(descriptor)

    def _open(self, content: bytes) -> None:
        self._path = self._place(self._number)
        self._descriptor = os.open(self._path, _FLAGS, 0o644)
        self._size = os.fstat(self._descriptor).st_size
        head = self._head if self._size == 0 else b""
        taken_away = self._newest is not None and (self._newest == self._path or not self._newest.exists())
        if self._size == 0 and taken_away:
            head += self._gap_before(content)
        if head:
            self._check_room(len(head))
            self._write(head)
            self._size = len(head)

    def _check_room(self, count: int) -> None:
        """Raise OSError if the file is not the one of its name any more, or the disk would be too full."""
        assert self._path is not None and self._descriptor is not None
        if not os.path.samestat(self._path.lstat(), os.fstat(self._descriptor)):
            raise OSError(errno.ENOENT, "its file was taken away")
        disk = os.fstatvfs(self._descriptor)
        # Some network disks do not tell their size.
        if disk.f_blocks and disk.f_bavail * disk.f_frsize < LEAST_FREE_BYTES + count:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _write(self, content: bytes) -> None:
        assert self._descriptor is not None
        while content:
            content = content[os.write(self._descriptor, content) :]

    def _give_back(self) -> None:
        """Cut off what was written of a record, and close the file."""
        if self._descriptor is not None:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self._size)
            with suppress(OSError):
                self.close()
