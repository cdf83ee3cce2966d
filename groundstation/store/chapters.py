"""Chapters of a store: the runs of one mission, whose events a restart goes on from.

A chapter begins with the first run of a mission, when another mission or one with other things is run with the same
store, or when a new flight is asked for. Events of earlier chapters stay, and count for numbers only.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from pydantic import ValidationError

from companion.errors import InputError
from companion.mission.model import Mission
from companion.protocol.messages import Directive, Kind
from groundstation.events import Command, Direct, Event, Pause, TakeOut, event_from_json
from groundstation.operations import DIRECTIVE_NAMES, Operations, Orders, folded, ids_in_words
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
    orders: tuple[Command, ...] | None = None
    """What gives the orders at the end of the chapter before again; None: there is none before this one, or this goes
    on."""

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
        begun = replace(Operations.begun(mission), next_number=number + 1)
        if last is None or anew:
            words = f"a new flight: {len(events)} events are kept, and nothing of them is carried over"
            orders = None if last is None else ()
            return Beginning(fresh, begun, words if events else "", is_fresh=True, orders=orders)
        before = folded(last.mission(), events)
        words = _fresh_words(mission, differs, len(events), last.mission(), before)
        return Beginning(fresh, begun, words, is_fresh=True, orders=_carried(before.orders, mission))
    operations = replace(folded(mission, events), next_number=number + 1)
    return Beginning(last, operations, f"goes on after event {number}" if events else "")


def _carried(before: Orders, mission: Mission) -> tuple[Command, ...]:
    """Return the commands that give the orders again, as far as a mission has the agents; pins are left behind.

    Those for one agent come first, when nothing stronger is told to all.
    """
    there = {agent.id for agent in mission.agents}
    own = {agent: DIRECTIVE_NAMES[given] for agent, given in sorted(before.own.items()) if agent in there}
    return (
        *(TakeOut(do="take-out", agent=agent) for agent in sorted(before.out & there)),
        *(Direct(do="direct", directive=given, agent=agent) for agent, given in own.items()),
        *([] if before.directive is Directive.NORMAL else [_to_all(before.directive)]),
        *([Pause(do="pause")] if before.paused else []),
    )


def _to_all(directive: Directive) -> Direct:
    return Direct(do="direct", directive=DIRECTIVE_NAMES[directive])


def event_of_row(row: EventRow) -> Event:
    """Return the event of a row; raises InputError if a store of another release has one that is not understood."""
    try:
        return event_from_json(row.body)
    except ValueError as error:
        raise InputError(f"event {row.number}, '{row.event}', is not understood by this release") from error


def _fresh_words(mission: Mission, differs: tuple[str, ...], count: int, was: Mission, before: Operations) -> str:
    """Return what is told of a chapter of another mission: what goes on, and all that is left behind.

    `was` is the mission of the chapter before, which had made `before` of it by its `count` events.
    """
    if not count:
        return ""
    on = ", ".join(_words_of(order) for order in _carried(before.orders, mission)) or "no order was in force"
    return (
        f"{', '.join(differs)} of {mission.name} differ from the last run's: {count} events are kept but not carried "
        f"over; left behind: {'; '.join(_left_behind(mission, was, before))}; goes on: {on}"
    )


def _words_of(order: Command) -> str:
    match order:
        case TakeOut():
            return f"agent {order.agent} taken out"
        case Direct(agent=None):
            return f"directive {order.directive} for all"
        case Direct():
            return f"directive {order.directive} for agent {order.agent}"
    return "the pause"


def _left_behind(mission: Mission, was: Mission, before: Operations) -> list[str]:
    """Return in words what a chapter had made of its mission and another mission begins without."""
    gone = sorted((before.orders.out | before.orders.own.keys()) - {agent.id for agent in mission.agents})
    now = before.mission
    targets = _changed({one.id: one for one in was.targets}, {one.id: one for one in now.targets})
    threats = _changed({one.id: one for one in was.threats}, {one.id: one for one in now.threats})
    targets |= {identity for kind, identity in before.names if kind is Kind.TARGET}
    threats |= {identity for kind, identity in before.names if kind is Kind.THREAT}
    found = [
        ("what was ordered of agents that are gone: ", gone),
        ("the pins of agents ", before.orders.pins),
        ("what was added, changed or retired: targets ", targets),
        ("what was added, changed or retired: threats ", threats),
        ("arrivals at targets ", before.reached.by),
        ("that agents are lost: ", before.reached.lost),
    ]
    return [*(f"{words}{ids_in_words(ids)}" for words, ids in found if ids), "the places of the last picture"]


def _changed(was: Mapping[int, object], now: Mapping[int, object]) -> set[int]:
    return {identity for identity in was.keys() | now.keys() if was.get(identity) != now.get(identity)}
