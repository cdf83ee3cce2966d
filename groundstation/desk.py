"""The desk of a run: what operators and sources ask becomes events, in order, each on disk before it is obeyed.

A command is answered with the event that it became once that is kept for good, or with why it is refused. What the
ground station itself notices is kept as well. Nothing here waits: what the disk has not taken yet is looked at again in
the next tick.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from companion.errors import InputError
from groundstation.acceptance import event_of
from groundstation.events import (
    STATION,
    Command,
    Event,
    Started,
    Stopped,
    Who,
    command_from,
    event_json,
)
from groundstation.ground_station import GroundStation
from groundstation.notices import noticed
from groundstation.operations import applied
from groundstation.store.rows import EventRow

TOLD = "told to stop; the last broadcast says so"
"""Why a run ended that was not killed."""
MOST_AT_ONCE = 4
"""Greatest number of commands that are obeyed in one tick: each may have the assignment solved anew, which with 500
agents takes up to 60 ms, and the broadcast goes on between ticks."""
MOST_WAITING = 200
"""Greatest number of commands that wait for the disk."""
ANSWER_S = 5.0
"""Time after which a command is refused that the disk has not taken: it must not come into force when nobody thinks of
it any more."""

_SILENT = "the disk does not answer; nothing was changed"

Fact = Callable[[int, float], Event]
"""Makes an event of its number and Unix time."""
Answer = Callable[[Event | InputError], None]
"""Takes the event that a command became, once it is obeyed, or why it is refused."""


class EventLog(Protocol):
    """Where events are kept: an EventStore, or one in memory."""

    def append(self, events: Iterable[EventRow]) -> Future[None]:
        """Keep events that were asked for; the future ends when they are kept, or with OSError if they are not."""

    def note(self, events: Iterable[EventRow]) -> None:
        """Keep events that have happened."""


class Asker(Protocol):
    """Where the answers go, and where every event is shown."""

    def publish(self, message: Mapping[str, Any]) -> None:
        """Show a message."""

    def reply(self, identity: int, event: Mapping[str, Any]) -> None:
        """Answer a request with its event."""

    def refuse(self, identity: int, why: str) -> None:
        """Answer a request that is refused."""


def _no_facts(event: Event) -> Sequence[Fact]:
    return ()


class _Asked(NamedTuple):
    """A command, who gave it, and the number under which it is answered; None if nobody waits for the answer."""

    command: Command
    who: Who
    request: int | None
    facts: Callable[[Event], Sequence[Fact]] = _no_facts
    """What follows from the event that the command becomes, and is kept with it or not at all."""
    answer: Answer | None = None


@dataclass(frozen=True)
class _Kept:
    """Events that are on their way to the disk, and what is asked with each; None: it follows from the one before."""

    asked: tuple[tuple[_Asked | None, Event], ...]
    written: Future[None]
    since_s: float


def row_of(event: Event) -> EventRow:
    """Return an event as it is stored."""
    return EventRow(event.number, event.unix_s, event.who.name, event.event, event_json(event).decode())


def begin_day(desk: Desk, station: GroundStation, orders: Sequence[Command], now_s: float) -> None:
    """Note that a run begins, and then orders that go on and that its events do not have."""
    unix_s = now_s + station.tracks.clock_ahead_s
    number = station.operations.next_number
    began = Started(number=number, unix_s=unix_s, who=STATION, mission=station.mission.name, epoch_s=station.epoch_s)
    desk.note([began], now_s)
    for order in orders:
        desk.note([event_of(station.operations, order, STATION, unix_s)], now_s)


def end_day(desk: Desk, station: GroundStation, now_s: float) -> None:
    """Note that a run ends; what was asked and is not on disk yet is not obeyed any more, but for what it takes now."""
    desk.tick(now_s)
    if desk.is_idle:
        unix_s = now_s + station.tracks.clock_ahead_s
        desk.note([Stopped(number=station.operations.next_number, unix_s=unix_s, who=STATION, reason=TOLD)], now_s)


class Desk:
    """Turns commands into events of one ground station."""

    def __init__(self, station: GroundStation, log: EventLog, asker: Asker | None = None) -> None:
        self._station = station
        self._log = log
        self._asker = asker
        self._waiting: deque[_Asked] = deque()
        self._facts: deque[Fact] = deque()
        self._kept: _Kept | None = None

    def ask(self, command: Command, who: Who, request: int | None = None) -> None:
        """Have a command obeyed by one of the next ticks."""
        self._ask(_Asked(command, who, request))

    def ask_with(self, command: Command, who: Who, facts: Callable[[Event], Sequence[Fact]], answer: Answer) -> None:
        """Have a command obeyed, and what follows from its event kept with it; `answer` is called with the outcome."""
        self._ask(_Asked(command, who, None, facts, answer))

    def note_facts(self, facts: Iterable[Fact]) -> None:
        """Adopt and keep what has happened, by one of the next ticks."""
        self._facts += facts

    def _ask(self, asked: _Asked) -> None:
        if len(self._waiting) >= MOST_WAITING:
            self._refuse(asked, f"{MOST_WAITING} commands wait for the disk; ask again later")
        else:
            self._waiting.append(asked)

    def ask_data(self, data: object, who: Who, request: int | None = None) -> None:
        """Have the command in parsed JSON obeyed; it is refused if it is none."""
        try:
            self.ask(command_from(data), who, request)
        except InputError as error:
            if self._asker is not None and request is not None:
                self._asker.refuse(request, str(error))

    @property
    def is_idle(self) -> bool:
        """Whether no event is on its way to the disk, so that one that happens now can have the next number."""
        return self._kept is None

    def note(self, events: Iterable[Event], now_s: float) -> None:
        """Adopt and keep what the ground station itself noticed; only while `is_idle`."""
        assert self.is_idle
        for event in events:
            self._station.adopt(event, now_s)
            self._log.note([row_of(event)])
            self._show(event)

    def notice(self, now_s: float) -> bool:
        """Adopt and keep what has happened by itself since the last call, as soon as events can have their numbers.

        Return whether anything has.
        """
        if not self.is_idle:
            return False
        unix_s = now_s + self._station.tracks.clock_ahead_s
        news = noticed(self._station.operations, self._station.facts(), unix_s)
        self.note(news, now_s)
        return bool(news)

    def tick(self, now_s: float) -> None:
        """Obey what the disk has taken, and hand it what was asked since."""
        if self._kept is not None and now_s - self._kept.since_s > ANSWER_S and not self._kept.written.cancel():
            # What is just being written cannot be taken back; it is obeyed if the disk takes it after all.
            while self._waiting:
                self._refuse(self._waiting.popleft(), _SILENT)
        self._obey(now_s)
        while self.is_idle and self._facts:
            unix_s = now_s + self._station.tracks.clock_ahead_s
            self.note([self._facts.popleft()(self._station.operations.next_number, unix_s)], now_s)
        if self.is_idle and self._waiting:
            self._kept = self._accepted(now_s)
            self._obey(now_s)

    def _accepted(self, now_s: float) -> _Kept | None:
        """Return the events that the next waiting commands become, on their way to the disk; refuse what cannot be."""
        operations = self._station.operations
        unix_s = now_s + self._station.tracks.clock_ahead_s
        accepted: list[tuple[_Asked | None, Event]] = []
        while self._waiting and len(accepted) < MOST_AT_ONCE:
            asked = self._waiting.popleft()
            try:
                event = event_of(operations, asked.command, asked.who, unix_s)
            except InputError as error:
                self._refuse(asked, str(error))
                continue
            operations = applied(operations, event)
            accepted.append((asked, event))
            for fact in asked.facts(event):
                following = fact(operations.next_number, unix_s)
                operations = applied(operations, following)
                accepted.append((None, following))
        if not accepted:
            return None
        return _Kept(tuple(accepted), self._log.append([row_of(event) for _, event in accepted]), now_s)

    def _obey(self, now_s: float) -> None:
        """Obey what was asked and is on disk by now, or refuse it if the disk does not take it."""
        kept = self._kept
        if kept is None or not kept.written.done():
            return
        self._kept = None
        try:
            kept.written.result()
        except (OSError, CancelledError) as error:
            why = _SILENT
            if isinstance(error, OSError):
                why = f"the disk does not take it: {error.strerror}; nothing was changed"
            for asked, _ in kept.asked:
                if asked is not None:
                    self._refuse(asked, why)
            return
        for asked, event in kept.asked:
            self._station.adopt(event, now_s)
            self._show(event)
            if asked is not None:
                self._reply(asked, event)

    def _reply(self, asked: _Asked, event: Event) -> None:
        if asked.answer is not None:
            asked.answer(event)
        if self._asker is not None and asked.request is not None:
            self._asker.reply(asked.request, _values(event))

    def _show(self, event: Event) -> None:
        if self._asker is not None:
            self._asker.publish({"type": "event", "event": _values(event)})

    def _refuse(self, asked: _Asked, why: str) -> None:
        if asked.answer is not None:
            asked.answer(InputError(why))
        if self._asker is not None and asked.request is not None:
            self._asker.refuse(asked.request, why)


def _values(event: Event) -> dict[str, Any]:
    return event.model_dump(mode="json")
