"""The tables of a store, and what is refused to everybody who writes to them, this program included."""

from __future__ import annotations

APPLICATION_ID = 0x4F57_4753
"""What a store's header says beside being SQLite: "OWGS"."""
VERSION = 1
"""Version of these tables; a store of a later one is refused, and an earlier one will be brought up to it."""

TABLES = """
CREATE TABLE events (
    number INTEGER PRIMARY KEY,
    unix_s REAL NOT NULL,
    who TEXT NOT NULL,
    event TEXT NOT NULL,
    body TEXT NOT NULL
) STRICT;
CREATE TRIGGER events_are_never_changed BEFORE UPDATE ON events
BEGIN SELECT RAISE(ABORT, 'events are never changed'); END;
CREATE TRIGGER events_are_never_removed BEFORE DELETE ON events
BEGIN SELECT RAISE(ABORT, 'events are never removed'); END;
CREATE TRIGGER events_have_rising_numbers BEFORE INSERT ON events
WHEN NEW.number <= (SELECT max(number) FROM events)
BEGIN SELECT RAISE(ABORT, 'events have rising numbers'); END;
CREATE TABLE kept (name TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE recorded (
    id INTEGER PRIMARY KEY,
    kind TEXT NOT NULL CHECK (kind IN ('picture', 'frames')),
    unix_s REAL NOT NULL,
    body BLOB NOT NULL
) STRICT;
CREATE INDEX recorded_by_time ON recorded (kind, unix_s);
"""
"""`events` is append-only: without the last trigger `INSERT OR REPLACE` would remove a row and fire no other.
`recorded` holds pictures (JSON) and the frames of about a second (records of a .tlog), each compressed by zlib.
"""
