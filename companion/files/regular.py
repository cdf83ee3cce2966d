"""Safe opening of small files that must be what they seem: no link is followed, no pipe waited for, no device read."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path

_WORDS = {
    stat.S_IFLNK: "it is a link",
    stat.S_IFIFO: "it is a pipe",
    stat.S_IFDIR: "it is a folder",
    stat.S_IFCHR: "it is a device",
    stat.S_IFBLK: "it is a device",
    stat.S_IFSOCK: "it is a socket",
}


def read_regular(path: Path, most_bytes: int) -> tuple[bytes, os.stat_result]:
    """Return the content of a regular file and its status; the two are of the same file, whatever happens to the name.

    Raises:
        OSError: the file cannot be read, is none (a link, a pipe, a device, a folder) or has more than `most_bytes`;
            `strerror` says which.

    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    except OSError:
        # Of a link the system says that it is too many links, of a socket that there is no such device.
        refuse_other(path)
        raise
    try:
        status = os.fstat(descriptor)
        _refuse(path, status.st_mode)
        content = b""
        while len(content) <= most_bytes and (block := os.read(descriptor, most_bytes + 1 - len(content))):
            content += block
    finally:
        os.close(descriptor)
    if len(content) > most_bytes:
        raise OSError(errno.EFBIG, f"more than {most_bytes} bytes", str(path))
    return content, status


def refuse_other(path: Path) -> None:
    """Raise OSError, whose `strerror` says what is there, if there is anything but a regular file at a path."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    _refuse(path, mode)


def places_to(path: Path) -> Iterator[tuple[Path, os.stat_result]]:
    """Yield a path, every folder above it, and the same of all links among these, each with its own status.

    Who may write to one of them, a sticky folder apart, or owns it, can have the path lead to something else.

    Raises:
        OSError: one of them is missing or must not be looked into.

    """
    ways, seen = [path.absolute()], set[Path]()
    while ways:
        way = ways.pop()
        for place in (way, *way.parents):
            if place in seen:
                continue
            seen.add(place)
            status = place.lstat()
            yield place, status
            if stat.S_ISLNK(status.st_mode):
                ways.append(place.parent / place.readlink())


def can_be_written(mode: int, by: int = stat.S_IWOTH) -> bool:
    """Return whether others may write to what has this mode: to a file, or names in a folder.

    `by`: the permission bits that say so, by default those of every user. A link has no mode of its own, and in a
    folder with the sticky bit, such as /tmp, nobody can replace another user's files.
    """
    is_sticky = stat.S_ISDIR(mode) and mode & stat.S_ISVTX
    return bool(mode & by) and not is_sticky and not stat.S_ISLNK(mode)


def _refuse(path: Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, _WORDS.get(stat.S_IFMT(mode), "it is no regular file"), str(path))
