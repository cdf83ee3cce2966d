"""Plays a recording of a source's text back: sightings at the pace of the recording, or at its own Unix times.

The file is read and parsed in blocks by a thread, so that a slow disk keeps nothing waiting.
"""

from __future__ import annotations

import gzip
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple, cast

from companion.errors import InputError
from companion.mission.sources import SourceKind
from groundstation.sources import ais, basestation
from groundstation.sources.sighting import Sighting

BLOCK_LINES = 200
"""Number of lines that are parsed at once."""
MOST_LINE_BYTES = 65_536
UNTIMED_LINE_S = 0.1
"""Time that a line of AIS without a tag block is taken to last, as nothing tells when it was heard."""
_TIMES: dict[SourceKind, Callable[[bytes], float | None]] = {
    "basestation": basestation.time_in,
    "ais": ais.time_in,
}
"""Kinds whose lines tell when they were heard; in those of others each sighting tells it."""


Parse = Callable[[bytes, float], list[Sighting]]
"""Makes sightings of bytes that came at a time; raises nothing."""


class Due(NamedTuple):
    """A sighting of a recording, and when it is due by the clock of the recording."""

    at_s: float
    sighting: Sighting


def open_recording(name: str) -> BinaryIO:
    """Open a recording, of which one that ends in .gz is unpacked; raises InputError if it cannot be read."""
    try:
        if name.endswith(".gz"):
            return cast(BinaryIO, gzip.open(name, "rb"))
        return Path(name).open("rb")
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else "no file can have that name"
        raise InputError(f"file: '{name}': {reason}; allowed: a file that can be read") from error


def sightings_in(file: BinaryIO, kind: SourceKind, parse: Parse) -> Iterator[list[Due]]:
    """Yield the sightings in a recording, a block of lines at a time, with times that never go back.

    Raises:
        OSError: the file cannot be read further, as one that is no gzip.
        EOFError: a gzip ends too early.

    """
    time_in = _TIMES.get(kind)
    newest_s = 0.0
    while True:
        lines = [line for _ in range(BLOCK_LINES) if (line := file.readline(MOST_LINE_BYTES))]
        if not lines:
            return
        found: list[Due] = []
        for line in lines:
            at_s = time_in(line) if time_in is not None else None
            if at_s is not None:
                newest_s = max(newest_s, at_s)
            elif time_in is not None:
                newest_s += UNTIMED_LINE_S if kind == "ais" else 0.0
            is_timed = time_in is None or at_s is not None
            for sighting in parse(line if line.endswith(b"\n") else line + b"\n", newest_s):
                newest_s = newest_s if time_in is not None else max(newest_s, sighting.at_s)
                # The second of a minute says nothing where the minute is made up.
                found.append(Due(newest_s, sighting if is_timed else sighting._replace(at_s=newest_s)))
        yield found


def replayed(due: Due, shift_s: float, speed: float) -> Sighting:
    """Return a sighting as it is told when a recording is played: later by `shift_s`, and faster."""
    sighting = due.sighting
    velocity = None if sighting.velocity is None else sighting.velocity * speed
    # It was as old then as it is told to be now.
    old_s = (due.at_s - sighting.at_s) / speed
    until_s = None if sighting.until_s is None else due.at_s + shift_s + (sighting.until_s - due.at_s) / speed
    return sighting._replace(at_s=due.at_s + shift_s - old_s, velocity=velocity, until_s=until_s)
