"""All live sources of a run: what they say becomes moves of the picture, commands, and the health that a page shows.

Each tick weighs a bounded number of sightings, from each source in turn, and asks for what the tracker wants in the
picture and out of it. A source asks as an operator does: it may be refused, and every event says who it was.
"""

from __future__ import annotations

import asyncio
import cmath
import importlib
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from typing import Any, NamedTuple, Protocol

from companion.errors import InputError
from companion.geo.local_frame import LocalFrame
from companion.mission.model import Mission
from companion.mission.sources import GIVEN_RADII, SourceKind, SourceSpec
from companion.protocol.codec import Kind
from groundstation.desk import Answer, Fact
from groundstation.events import Command, Event, Retire, ThingKind, TrackBegan, TrackEnded, Who, command_from
from groundstation.ground_station import GroundStation
from groundstation.operations import Operations
from groundstation.origins import SENSOR, Observation
from groundstation.sightings import words_of
from groundstation.sources.feed import SILENT_S, Feed, Health, Pulse
from groundstation.sources.links import run_source
from groundstation.sources.sighting import Sighting
from groundstation.sources.thing import SourceKey
from groundstation.sources.tracker import BATCH_S, Dropped, Taken, Tracker

MOST_PER_TICK = 40
"""Greatest number of sightings that are weighed in a tick, of all sources together: some 8 ms of work."""
MOST_ASKED = 10
"""Greatest number of commands that wait for their answers: each may solve the assignment anew when it is obeyed."""
TOLD_AGAIN_S = 10.0
"""Least time between two lines about how a source does."""
_LIBRARIES: dict[SourceKind, str] = {"ais": "pyais", "cot": "takproto"}
_WORDS: dict[Kind, ThingKind] = {Kind.TARGET: "target", Kind.THREAT: "threat"}


class Desk(Protocol):
    """Who obeys commands, and keeps events, in order (groundstation/desk.py)."""

    def ask_with(self, command: Command, who: Who, facts: Callable[[Event], Sequence[Fact]], answer: Answer) -> None:
        """Have a command obeyed, and what follows from its event kept with it; `answer` is called with the outcome."""

    def note_facts(self, facts: Iterable[Fact]) -> None:
        """Adopt and keep what has happened."""


class _Told(NamedTuple):
    """How a source did when that was last told, and when that was; empty: it was not told yet."""

    state: str
    at_s: float


class Sources:
    """The live sources of one run."""

    def __init__(self, mission: Mission, specs: Sequence[SourceSpec]) -> None:
        """Begin with nothing heard; `mission` is resolved."""
        self._frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        self.tracker = Tracker(mission, specs)
        self._specs = tuple(specs)
        self.feeds = {spec.name: Feed(spec, self._frame) for spec in specs if spec.kind != "sensor"}
        self._mission = mission
        self._reach_m = BATCH_S * max(agent.speed_m_s for agent in mission.agents)
        self._turn = 0
        self._wanted: deque[Taken | Dropped] = deque()
        """The rest of a batch."""
        self._asked: set[SourceKey] = set()
        """What was asked for and is not answered yet."""
        self._said: dict[str, _Told] = {}
        """How sources did when that was last told."""
        self.sensor: Pulse | None = None
        """The health of the sensor's link; None without one."""
        for module in {"filterpy.kalman"} | {_LIBRARIES.get(spec.kind, "math") for spec in specs} if specs else ():
            # Loaded now: at the first sighting they would keep the broadcast waiting for a second.
            importlib.import_module(module)

    def restore(self, station: GroundStation, now_s: float) -> None:
        """Take over from the last run which thing of a source has which id."""
        self.tracker.restore(station.operations.tracks, station.mission, now_s)
        self._mission = station.mission

    def listen(self, now_s: Callable[[], float], stack: ExitStack) -> None:
        """Begin to hear all sources on the running event loop; `stack` ends it."""
        for feed in self.feeds.values():
            stack.callback(asyncio.ensure_future(run_source(feed, now_s)).cancel)

    def tick(self, station: GroundStation, desk: Desk, now_s: float) -> None:
        """Move the picture by what was heard, and ask for what is wanted in it and out of it."""
        if not self._specs:
            return
        self.tracker.ahead_s = station.tracks.clock_ahead_s
        if station.mission is not self._mission:
            self._mission = station.mission
            self.tracker.follow(station.mission)
        for seen in [*self._observations(now_s), *self._strangers(station, now_s)]:
            station.observe(seen)
        for name, feed in self.feeds.items():
            if feed.dropped:
                self.tracker.doubts.overrun(name, feed.dropped)
                feed.dropped = 0
        if not self._wanted and self.tracker.is_due(now_s):
            tracks, present = station.tracks.tracks, station.tracks.present_agents
            agents = [complex(*tracks[Kind.AGENT, one].position_ned_m) for one in present]
            failed = [name for name, feed in self.feeds.items() if feed.link.fault is not None]
            self._wanted += self.tracker.due(agents, self._reach_m, now_s, failed)
        while self._wanted and len(self._asked) < MOST_ASKED:
            one = self._wanted.popleft()
            if one.key not in self._asked:
                self._ask(station, desk, one, now_s)

    def sensed(self, sense: Callable[[bytes, float], None], note: str) -> Callable[[bytes, float], None]:
        """Return what takes the sensor's datagrams, and notes that there was one; `note` names the link."""
        pulse = self.sensor = Pulse()
        pulse.link.note = note

        def take(datagram: bytes, now_s: float) -> None:
            pulse.note(1, now_s)
            sense(datagram, now_s)

        return take

    def view(self, station: GroundStation, now_s: float) -> list[dict[str, Any]]:
        """Return the sources as a page shows them."""
        unknown = self.tracker.unknown()
        rows = []
        for name, feed in self.feeds.items():
            refused = feed.refused + self.tracker.doubts.refused[name]
            health = feed.pulse.health(now_s)
            detail = feed.detail(health, self.tracker.doubts.reasons[name])
            row = _row(name, feed.spec.kind, health._replace(detail=detail))
            strangers = sum(1 for one in unknown if one.source == name)
            rows.append(row | {"things": self.tracker.things(name, now_s), "refused": refused, "unknown": strangers})
        if self.sensor is not None:
            name = next((spec.name for spec in self._specs if spec.kind == "sensor"), SENSOR)
            things = sum(1 for source in station.tracks.origins.by.values() if source == SENSOR)
            row = _row(name, "sensor", self.sensor.health(now_s))
            unknown_things = len(station.tracks.origins.unknown)
            rows.append(row | {"things": things, "refused": station.tracks.refusals.total, "unknown": unknown_things})
        return rows

    def unknown_view(self, now_s: float) -> list[dict[str, Any]]:
        """Return the agents that sources see and the mission does not have, as a page shows them."""
        return [
            {
                "source": one.source,
                "kind": "agent",
                "id": one.id,
                "north_m": round(one.place.real, 2),
                "east_m": round(one.place.imag, 2),
                "age_s": round(max(0.0, now_s - one.at_s), 2),
                "count": one.times,
            }
            for one in self.tracker.unknown()
        ]

    def news(self, now_s: float) -> tuple[list[str], list[str]]:
        """Return the lines that are due: of sources that do well again, and warnings of others and of what they say."""
        good: list[str] = []
        for name, feed in self.feeds.items():
            if (unread := feed.news()) is not None:
                self.tracker.doubts.unread(name, unread)
        warnings = self.tracker.doubts.news(now_s)
        for name, feed in self.feeds.items():
            health = feed.pulse.health(now_s)
            told = self._said.setdefault(name, _Told("", now_s))
            if health.state == told.state or feed.link.is_opening:
                continue
            is_new = health.state == "silent" and not feed.pulse.heard
            if now_s - told.at_s >= (SILENT_S if is_new else TOLD_AGAIN_S if told.state else 0.0):
                self._said[name] = _Told(health.state, now_s)
                lines = good if health.state == "good" else warnings
                lines.append(f"{name}: {health.state}: {feed.detail(health)}")
        return good, warnings

    def _strangers(self, station: GroundStation, now_s: float) -> list[Observation]:
        """Return the moves of things that the sensor sees, and that are in the picture though no mission lists them."""
        strangers = station.tracks.origins.strangers
        waiting = [strangers.popleft() for _ in range(min(len(strangers), MOST_PER_TICK))]
        spec = next((one for one in self._specs if one.kind == "sensor" and one.takes_in), None)
        if spec is None:
            return []
        seen = []
        for one in waiting:
            key = words_of(one.key)
            lat_deg, lon_deg, turn_rad = self._frame.to_global_with_convergence(one.place.real, one.place.imag)
            sighting = Sighting(key, lat_deg, lon_deg, one.at_s, one.velocity * cmath.rect(1.0, turn_rad))
            moved = self.tracker.take(spec.name, sighting, now_s)
            if moved is not None:
                seen.append(moved)
        return seen

    def _observations(self, now_s: float) -> list[Observation]:
        """Return the moves by the sightings that wait, from each source in turn."""
        seen = []
        feeds = list(self.feeds.values())
        left = MOST_PER_TICK
        while left and feeds:
            self._turn += 1
            feed = feeds[self._turn % len(feeds)]
            sighting = feed.next()
            if sighting is None:
                feeds.remove(feed)
                continue
            left -= 1
            moved = self.tracker.take(feed.spec.name, sighting, now_s)
            if moved is not None:
                seen.append(moved)
        return seen

    def _ask(self, station: GroundStation, desk: Desk, one: Taken | Dropped, now_s: float) -> None:
        who = Who(name=one.key.source, role="source")
        listed = station.mission.targets if one.kind is Kind.TARGET else station.mission.threats
        is_there = any(thing.id == one.id for thing in listed)
        if isinstance(one, Dropped) and (one.heir is not None or not is_there):
            desk.note_facts(_ended(one, who))
            self.tracker.dropped(one)
            return
        if isinstance(one, Taken) and one.is_new and is_there:
            assert one.id is not None
            desk.note_facts([_began(one.key, one.kind, one.id, who)])
            self.tracker.taken(one, one.id, is_listed=True)
            return
        self._asked.add(one.key)

        def facts(event: Event) -> Sequence[Fact]:
            if isinstance(one, Dropped):
                return _ended(one, who)
            return [_began(one.key, one.kind, _id_of(event), who)] if one.is_new else []

        def answer(outcome: Event | InputError) -> None:
            self._asked.discard(one.key)
            if isinstance(outcome, InputError):
                self.tracker.declined(one, str(outcome), now_s)
            elif isinstance(one, Dropped):
                self.tracker.dropped(one)
            else:
                self.tracker.taken(one, _id_of(outcome), is_listed=False)

        spec = next(spec for spec in self._specs if spec.name == one.key.source)
        try:
            command = _command(one, spec, station.operations)
        except InputError as error:
            answer(error)
            return
        desk.ask_with(command, who, facts, answer)


def _row(name: str, kind: SourceKind, health: Health) -> dict[str, Any]:
    """Return what a page shows of a source's health."""
    return {
        "name": name,
        "kind": kind,
        "state": health.state,
        "rate_hz": round(health.rate_hz, 1),
        "age_s": None if health.age_s is None else round(health.age_s, 1),
        "detail": health.detail,
    }


def _command(one: Taken | Dropped, spec: SourceSpec, operations: Operations) -> Command:
    """Return the command that a source gives; raises InputError if what it saw fits none."""
    kind = _WORDS[one.kind]
    if isinstance(one, Dropped):
        return Retire(do="retire", kind=kind, id=one.id)
    given: dict[str, Any] = {"speed_bound_m_s": one.bound_m_s}
    if not one.is_new:
        return command_from({"do": "change", "kind": kind, "id": one.id, **given})
    given |= {"name": one.name or one.key.key[:40], "north_m": one.place.real, "east_m": one.place.imag}
    if one.kind is Kind.THREAT:
        radii = {key: getattr(spec, key) for key in GIVEN_RADII}
        given |= {key: radius_m for key, radius_m in radii.items() if radius_m is not None}
        given |= {"floor_m": spec.floor_m, "ceiling_m": spec.ceiling_m}
    # No id is given twice: one that was retired comes back under another.
    is_used = one.id is not None and operations.used[one.kind] >> one.id & 1
    return command_from({"do": f"add-{kind}", "id": None if is_used else one.id, **given})


def _id_of(event: Event) -> int:
    """Return the id of the target or threat that was added or changed."""
    thing = getattr(event, "threat", None) or getattr(event, "target", None)
    assert thing is not None
    return int(thing.id)


def _began(key: SourceKey, kind: Kind, identity: int, who: Who) -> Fact:
    def fact(number: int, unix_s: float) -> Event:
        return TrackBegan(
            number=number, unix_s=unix_s, who=who, source=key.source, key=key.key, kind=_WORDS[kind], id=identity
        )

    return fact


def _ended(one: Dropped, who: Who) -> Sequence[Fact]:
    """Return that a source's key stands for nothing any more, and for what that of its heir stands."""

    def fact(number: int, unix_s: float) -> Event:
        return TrackEnded(number=number, unix_s=unix_s, who=who, source=one.key.source, key=one.key.key, reason=one.why)

    if one.heir is None:
        return [fact]
    return [fact, _began(one.heir, one.kind, one.id, Who(name=one.heir.source, role="source"))]
