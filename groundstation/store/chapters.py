"""Chapters of a store: the runs of one mission, whose events a restart goes on from.

A chapter begins with the first run of a mission, when another mission or one with other things is run with the same
store, or when a new flight is asked for. Events of earlier chapters stay, and count for numbers only.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from pydantic import ValidationError

from companion.errors import InputError
from companion.mission.model import Mission
from companion.protocol.messages import Directive
from groundstation.events import Event, event_from_json
from groundstation.operations import Operations, folded
from groundstation.store.rows import EventRow

MISSION_KEY = "mission:"
"""What the names of kept missions begin with; the number of their chapter's first event follows."""
THINGS = ("name", "origin", "fence", "exclusions", "agents", "targets", "threats", "case")
"""Keys of a mission that events are about: where they differ, a new chapter begins."""


@dataclass(frozen=True)
class Chapter:
    """The events since a number, and the resolved mission that they are about."""

    first: int
    mission_json: str

    @property
    def kept(self) -> tuple[str, str]:
        """Name and value by which a store keeps it."""
        return f"{MISSION_KEY}{self.first}", self.mission_json

    def differs_in(self, mission: Mission) -> tuple[str, ...]:
        """Return which of THINGS are others in a resolved mission."""
        before, now = json.loads(self.mission_json), json.loads(json_of(mission))
        return tuple(key for key in THINGS if before.get(key) != now.get(key))

    def mission(self) -> Mission:
        """Return the mission; raises InputError if a store of another release has one that is not understood."""
        try:
            return Mission.model_validate_json(self.mission_json)
        except ValidationError as error:
            raise InputError("the store's mission is not understood by this release") from error


@dataclass(frozen=True)
class Beginning:
    """What a run begins with."""

    chapter: Chapter
    operations: Operations
    words: str = ""
    """What is told of it; empty for a store that is new."""
    is_fresh: bool = False
    """Whether the chapter is a new one."""
    directive: Directive | None = None
    """What the chapter before had all agents told at its end; None: there is none before this one, or this goes on."""

    @property
    def warnings(self) -> list[str]:
        """What is told of a new chapter."""
        return [self.words] if self.is_fresh and self.words else []


def json_of(mission: Mission) -> str:
    """Return a resolved mission as JSON."""
    return mission.model_dump_json()


def chapters_in(kept: Mapping[str, str]) -> list[Chapter]:
    """Return the chapters among the kept values of a store, in their order."""
    found = [
        Chapter(int(name.removeprefix(MISSION_KEY)), value)
        for name, value in kept.items()
        if name.startswith(MISSION_KEY) and name.removeprefix(MISSION_KEY).isdecimal()
    ]
    return sorted(found, key=lambda chapter: chapter.first)


def beginning(mission: Mission, kept: Mapping[str, str], stored: Iterable[EventRow], anew: bool = False) -> Beginning:
    """Return what a run of a resolved mission begins with: the last chapter's operations, or a new chapter.

    `anew` asks for a new flight: a new chapter in any case.

    Raises:
        InputError: a stored event is not understood.

    """
    chapters = chapters_in(kept)
    last = chapters[-1] if chapters else None
    differs = () if last is None else last.differs_in(mission)
    number, events = 0, []
    for row in stored:
        number = row.number
        if last is not None and row.number >= last.first:
            events.append(event_of_row(row))
    if last is None or differs or anew:
        fresh = Chapter(number + 1, json_of(mission))
        words = _fresh_words(mission, differs, len(events))
        directive = None if last is None else _last_directive(last, events, anew)
        begun = replace(Operations.begun(mission), next_number=number + 1)
        return Beginning(fresh, begun, words, is_fresh=True, directive=directive)
    operations = replace(folded(mission, events), next_number=number + 1)
    return Beginning(last, operations, f"goes on after event {number}" if events else "")


def _last_directive(last: Chapter, events: Sequence[Event], anew: bool) -> Directive:
    return Directive.NORMAL if anew else folded(last.mission(), events).orders.told


def event_of_row(row: EventRow) -> Event:
    """Return the event of a row; raises InputError if a store of another release has one that is not understood."""
    try:
        return event_from_json(row.body)
    except ValueError as error:
        raise InputError(f"event {row.number}, '{row.event}', is not understood by this release") from error


def _fresh_words(mission: Mission, differs: tuple[str, ...], count: int) -> str:
    if not count:
        return ""
    if not differs:
        return f"a new flight: {count} events are kept, and nothing of them is carried over"
    return (
        f"{', '.join(differs)} of {mission.name} differ from the last run's: {count} events are kept but not carried "
        "over (pins, what was added or retired, arrivals); the directive is"
    )
