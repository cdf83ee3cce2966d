"""The values that a store holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

Kind = Literal["picture", "frames"]
"""What is recorded: the picture that the ground station had, or the frames that it sent and heard."""


class EventRow(NamedTuple):
    """One event as it stands on disk."""

    number: int
    """Greater than that of every event before."""
    unix_s: float
    who: str
    """Who decided it: an operator or a source, or the ground station itself."""
    event: str
    """What kind of event it is."""
    body: str
    """The whole event as JSON, from which it is read back."""


class Recorded(NamedTuple):
    """A picture or the frames of about a second."""

    kind: Kind
    unix_s: float
    body: bytes
    """JSON of a picture, or records of a .tlog, one after another."""


@dataclass(frozen=True)
class Batch:
    """What is written in one transaction: all of it or nothing."""

    events: tuple[EventRow, ...] = ()
    kept: Mapping[str, str] = field(default_factory=dict)
    """Kept values by name: each replaces the one before."""
