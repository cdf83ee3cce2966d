"""The SQLite file of a store: made, opened, checked, read and written, by one thread at a time.

Write-ahead logging with every commit synced: what was committed survives a crash of the program and of the machine.
"""

from __future__ import annotations

import errno
import os
import sqlite3
import zlib
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Self
from urllib.parse import quote

from companion.errors import InputError, one_line
from companion.files.log_series import LEAST_FREE_BYTES
from companion.files.regular import refuse_other
from companion.files.state import sync_folder
from groundstation.store.rows import Batch, EventRow, Kind, Recorded
from groundstation.store.schema import APPLICATION_ID, TABLES, VERSION

HEADER = b"SQLite format 3\0"
"""First bytes of every SQLite file."""
BUSY_S = 2.0
"""Time for which a write waits for another program that holds the file, such as a backup."""
TRIM_SHARE = 0.05
"""Share of the bound that is removed at once when pictures and frames are more than it."""
_LAST = 2**63 - 1
"""Greatest number that SQLite can hold."""
_COMPRESSION = 3
"""Level of zlib: pictures become a tenth of their size, as at the highest, in a third of its time."""
_ERRORS = (OSError, sqlite3.Error, UnicodeError)
"""What a damaged file or a disk makes of a call; SQLite's own messages may hold bytes of the file."""
_ALLOWED = "allowed: a store that `groundstation run --state` wrote, or a name that is not there yet"


class Database:
    """One open store. Its methods raise `OSError` where the disk does not do what is asked."""

    def __init__(self, path: Path | None, connection: sqlite3.Connection, writes: bool) -> None:
        """Hold a connection to a checked store; `create`, `opened` and `read_only` make one."""
        self.path = path
        self._connection = connection
        self._status = None if path is None else path.stat()
        self._recorded_bytes = 0
        if writes:
            query = "SELECT coalesce(sum(length(body)), 0) FROM recorded"
            self._recorded_bytes = int(connection.execute(query).fetchone()[0])

    @classmethod
    def in_memory(cls) -> Self:
        """Return a store that nobody finds again."""
        connection = _connected(":memory:")
        _fill(connection)
        return cls(None, connection, writes=True)

    @classmethod
    def create(cls, path: Path, batch: Batch) -> Self:
        """Make a store with this content, replacing what is there in one step, and open it; raises OSError."""
        fresh = path.with_name(f"{path.name}.new")
        with _disk_errors():
            refuse_other(path)
            path.parent.mkdir(parents=True, exist_ok=True)
            for old in (fresh, *_beside(fresh)):
                with suppress(FileNotFoundError):
                    old.unlink()
            os.close(os.open(fresh, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644))
            with closing(_connected(str(fresh))) as connection:
                _fill(connection)
                _insert(connection, batch)
            for old in _beside(path):
                with suppress(FileNotFoundError):
                    old.unlink()
            with fresh.open("rb") as file:
                os.fsync(file.fileno())
            fresh.replace(path)
            sync_folder(path.parent)
            return cls(path, _connected(str(path)), writes=True)

    @classmethod
    def opened(cls, path: Path) -> Self:
        """Open the store of an earlier run to go on with it.

        Raises:
            InputError: there is none, it is damaged, or it is another program's file.

        """
        try:
            refuse_other(path)
            _check_header(path)
            connection = _connected(str(path))
        except _ERRORS as error:
            raise _unusable(path, error) from error
        return cls._checked(path, connection, writes=True)

    @classmethod
    def read_only(cls, path: Path) -> Self:
        """Open a store to read it, also while a ground station writes to it.

        Raises:
            InputError: there is none, it is damaged, or it is another program's file.

        """
        try:
            _check_header(path)
            uri = f"file:{quote(str(path.absolute()))}?mode=ro"
            if not _beside(path)[0].exists():
                # Nobody writes; SQLite would still make files beside it, which a read-only disk refuses.
                uri += "&immutable=1"
            connection = sqlite3.connect(uri, uri=True, check_same_thread=False, isolation_level=None)
        except _ERRORS as error:
            raise _unusable(path, error) from error
        return cls._checked(path, connection, writes=False)

    @classmethod
    def _checked(cls, path: Path, connection: sqlite3.Connection, writes: bool) -> Self:
        try:
            (application,) = connection.execute("PRAGMA application_id").fetchone()
            (version,) = connection.execute("PRAGMA user_version").fetchone()
            if application != APPLICATION_ID:
                raise InputError(f"{path}: a database of another program; {_ALLOWED}")
            if version > VERSION:
                raise InputError(f"{path}: a store of version {version}, of a later release; allowed: up to {VERSION}")
            # Not the whole file, which may be large: what a run goes on from.
            for table in ("events", "kept"):
                (found,) = connection.execute(f"PRAGMA quick_check({table})").fetchone()
                if found != "ok":
                    raise sqlite3.DatabaseError(found)
            return cls(path, connection, writes)
        except _ERRORS as error:
            connection.close()
            raise _unusable(path, error) from error
        except InputError:
            connection.close()
            raise

    def is_in_place(self) -> bool:
        """Return whether the file is still the one of its name: what is written to another is lost."""
        if self.path is None or self._status is None:
            return True
        try:
            return os.path.samestat(self.path.lstat(), self._status)
        except OSError:
            return False

    def close(self) -> None:
        """Close the file; what was committed is in it."""
        with suppress(sqlite3.Error):
            self._connection.close()

    def write(self, batch: Batch) -> None:
        """Commit a batch; it is on disk when this returns."""
        with _disk_errors():
            _insert(self._connection, batch)

    def record(self, things: Sequence[Recorded], most_bytes: int) -> None:
        """Add pictures and frames; the oldest make room, so that all of them have at most `most_bytes`."""
        packed = [(one.kind, one.unix_s, zlib.compress(one.body, _COMPRESSION)) for one in things]
        added_bytes = sum(len(body) for _, _, body in packed)
        with _disk_errors():
            self._check_room(added_bytes)
            with _transaction(self._connection):
                self._connection.executemany("INSERT INTO recorded (kind, unix_s, body) VALUES (?, ?, ?)", packed)
                removed_bytes = self._trim(self._recorded_bytes + added_bytes, most_bytes)
            self._recorded_bytes += added_bytes - removed_bytes

    def moved_to(self, path: Path) -> Database:
        """Return a new store at a path with the events and kept values of this one, whose file was taken away."""
        with _disk_errors():
            batch = Batch(tuple(self.events()), self.all_kept())
        return Database.create(path, batch)

    def events(self, after: int = 0, to: int = _LAST) -> Iterator[EventRow]:
        """Yield the events whose numbers are greater than `after` and at most `to`, one by one, in their order."""
        query = "SELECT number, unix_s, who, event, body FROM events WHERE number > ? AND number <= ? ORDER BY number"
        with _disk_errors():
            yield from map(EventRow._make, self._connection.execute(query, (after, to)))

    def kept(self, name: str) -> str | None:
        """Return the kept value of a name; None if there is none."""
        with _disk_errors():
            row = self._connection.execute("SELECT value FROM kept WHERE name = ?", (name,)).fetchone()
        return None if row is None else str(row[0])

    def all_kept(self) -> dict[str, str]:
        """Return all kept values by name."""
        with _disk_errors():
            return dict(self._connection.execute("SELECT name, value FROM kept"))

    def recorded(self, kind: Kind, from_s: float = 0.0, to_s: float = 1e12) -> Iterator[Recorded]:
        """Yield what was recorded in a time, one by one, the oldest first; what cannot be read is left out."""
        query = "SELECT unix_s, body FROM recorded WHERE kind = ? AND unix_s BETWEEN ? AND ? ORDER BY unix_s, id"
        with _disk_errors():
            for unix_s, body in self._connection.execute(query, (kind, from_s, to_s)):
                with suppress(zlib.error):
                    yield Recorded(kind, unix_s, zlib.decompress(body))

    def last_picture(self, at_s: float) -> Recorded | None:
        """Return the picture that was the newest at a time; None before the first."""
        query = "SELECT unix_s, body FROM recorded WHERE kind = 'picture' AND unix_s <= ? ORDER BY unix_s DESC LIMIT 1"
        with _disk_errors(), suppress(zlib.error):
            row = self._connection.execute(query, (at_s,)).fetchone()
            return None if row is None else Recorded("picture", row[0], zlib.decompress(row[1]))
        return None

    def span_s(self, kind: Kind) -> tuple[float, float] | None:
        """Return the times of the first and last thing recorded of a kind; None if there is nothing."""
        query = "SELECT min(unix_s), max(unix_s) FROM recorded WHERE kind = ?"
        with _disk_errors():
            first_s, last_s = self._connection.execute(query, (kind,)).fetchone()
        return None if first_s is None else (float(first_s), float(last_s))

    def _trim(self, in_all_bytes: int, most_bytes: int) -> int:
        """Remove the oldest of what is recorded if there is too much; return the bytes that are gone."""
        if in_all_bytes <= most_bytes:
            return 0
        want_bytes = in_all_bytes - most_bytes + int(TRIM_SHARE * most_bytes)
        gone_bytes, last_id = 0, 0
        for row_id, size in self._connection.execute("SELECT id, length(body) FROM recorded ORDER BY id"):
            if gone_bytes >= want_bytes:
                break
            gone_bytes, last_id = gone_bytes + size, row_id
        self._connection.execute("DELETE FROM recorded WHERE id <= ?", (last_id,))
        return gone_bytes

    def _check_room(self, added_bytes: int) -> None:
        """Raise OSError if pictures and frames would fill the disk that events need."""
        if self.path is None:
            return
        disk = os.statvfs(self.path)
        # Some network disks do not tell their size.
        if disk.f_blocks and disk.f_bavail * disk.f_frsize < LEAST_FREE_BYTES + added_bytes:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def is_store(path: Path) -> bool:
    """Return whether a file begins as an SQLite file does; raises OSError if it cannot be read."""
    with path.open("rb") as file:
        return file.read(len(HEADER)) == HEADER


@contextmanager
def _transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """Begin a transaction, and commit it, or roll it back after an error."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    finally:
        if connection.in_transaction:
            connection.execute("ROLLBACK")


@contextmanager
def _disk_errors() -> Iterator[None]:
    """Turn an error of SQLite into the OSError that callers know."""
    try:
        yield
    except (sqlite3.Error, UnicodeError) as error:
        raise OSError(errno.EIO, _words(error)) from error


def _connected(name: str) -> sqlite3.Connection:
    connection = sqlite3.connect(name, timeout=BUSY_S, check_same_thread=False, isolation_level=None)
    try:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
    except sqlite3.Error:
        connection.close()
        raise
    return connection


def _fill(connection: sqlite3.Connection) -> None:
    connection.executescript(f"BEGIN; {TABLES} COMMIT;")
    connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    connection.execute(f"PRAGMA user_version = {VERSION}")


def _insert(connection: sqlite3.Connection, batch: Batch) -> None:
    with _transaction(connection):
        connection.executemany("INSERT INTO events VALUES (?, ?, ?, ?, ?)", batch.events)
        connection.executemany("INSERT OR REPLACE INTO kept VALUES (?, ?)", batch.kept.items())


def _check_header(path: Path) -> None:
    if not is_store(path):
        raise sqlite3.DatabaseError("file is not a database")


def _beside(path: Path) -> tuple[Path, Path]:
    """Return the files that SQLite keeps beside a store while it is open, or after a crash."""
    return path.with_name(f"{path.name}-wal"), path.with_name(f"{path.name}-shm")


def _words(error: Exception) -> str:
    return one_line(str(error.strerror) if isinstance(error, OSError) else str(error))


def _unusable(path: Path, error: Exception) -> InputError:
    return InputError(f"{path}: no store of a ground station that can be read: {_words(error)}; {_ALLOWED}")
