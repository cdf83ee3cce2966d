"""Finds the lines of a text in bytes that come cut anywhere; a line that is too long is passed over and counted."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Hashable

from groundstation.sources.sighting import count

MOST_SENDERS = 16
"""Greatest number of senders whose unfinished lines are kept."""
TOO_LONG = "line too long"


class Lines:
    """Finds lines in the bytes of each sender; keeps at most `most_bytes` of each."""

    def __init__(self, most_bytes: int, refused: Counter[str]) -> None:
        self._most_bytes = most_bytes
        self._refused = refused
        self._kept: OrderedDict[Hashable, bytes | None] = OrderedDict()
        """The beginning of each sender's next line; None while one that is too long is passed over."""

    def feed(self, data: bytes, sender: Hashable = None) -> list[bytes]:
        """Return the lines that are complete, without their ends and without empty ones."""
        kept = self._kept.pop(sender, b"")
        first, *rest = data.split(b"\n")
        parts: list[bytes | None] = [None if kept is None else kept + first, *rest]
        lines = []
        for part in parts[:-1]:
            if part is None:
                continue
            if len(part) > self._most_bytes:
                count(self._refused, TOO_LONG)
            elif line := part.strip():
                lines.append(line)
        last = parts[-1]
        if last is not None and len(last) > self._most_bytes:
            count(self._refused, TOO_LONG)
            last = None
        if last != b"":
            self._kept[sender] = last
        while len(self._kept) > MOST_SENDERS:
            self._kept.popitem(last=False)
        return lines
