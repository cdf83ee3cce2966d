"""All live sources of a run: what they say becomes moves of the picture, commands, and the health that a page shows.

Each tick weighs a bounded number of sightings, from each source in turn, and asks for what the tracker wants in the
picture and out of it. A source asks as an operator does: it may be refused, and every event says who it was.
"""

from __future__ import annotations

import asyncio
import importlib
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from typing import Any, Protocol

from companion.errors import InputError
from companion.geo.local_frame import LocalFrame
from companion.mission.model import Mission
from companion.mission.sources import SourceSpec
from companion.protocol.codec import Kind
from groundstation.desk import Answer, Fact
from groundstation.events import (
    AddTarget,
    AddThreat,
    Change,
    Command,
    Event,
    Retire,
    ThingKind,
    TrackBegan,
    TrackEnded,
    Who,
)
from groundstation.ground_station import GroundStation
from groundstation.origins import Observation
from groundstation.sources.feed import Feed
from groundstation.sources.links import run_source
from groundstation.sources.thing import SourceKey
from groundstation.sources.tracker import BATCH_S, Dropped, Taken, Tracker

MOST_PER_TICK = 40
"""Greatest number of sightings that are weighed in a tick, of all sources together: some 8 ms of work."""
MOST_ASKED = 20
"""Greatest number of commands of a tick, each of which may solve the assignment anew."""
_WORDS: dict[Kind, ThingKind] = {Kind.TARGET: "target", Kind.THREAT: "threat"}


class Desk(Protocol):
    """Who obeys commands, and keeps events, in order (groundstation/desk.py)."""

    def ask_with(self, command: Command, who: Who, facts: Callable[[Event], Sequence[Fact]], answer: Answer) -> None:
        """Have a command obeyed, and what follows from its event kept with it; `answer` is called with the outcome."""

    def note_facts(self, facts: Iterable[Fact]) -> None:
        """Adopt and keep what has happened."""


class Sources:
    """The live sources of one run."""

    def __init__(self, mission: Mission, specs: Sequence[SourceSpec]) -> None:
        """Begin with nothing heard; `mission` is resolved."""
        frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        self.tracker = Tracker(mission, specs)
        self._specs = tuple(specs)
        self.feeds = {spec.name: Feed(spec, frame) for spec in specs if spec.kind != "sensor"}
        self._mission = mission
        self._reach_m = BATCH_S * max(agent.speed_m_s for agent in mission.agents)
        self._turn = 0
        self._asked: set[SourceKey] = set()
        """What was asked for and is not answered yet."""
        if self.feeds:
            # Loaded now, as it takes a second and would keep the broadcast waiting at the first sighting.
            importlib.import_module("filterpy.kalman")

    def listen(self, now_s: Callable[[], float], stack: ExitStack) -> None:
        """Begin to hear all sources on the running event loop; `stack` ends it."""
        for feed in self.feeds.values():
            stack.callback(asyncio.ensure_future(run_source(feed, now_s)).cancel)

    def tick(self, station: GroundStation, desk: Desk, now_s: float) -> None:
        """Move the picture by what was heard, and ask for what is wanted in it and out of it."""
        self.tracker.ahead_s = station.tracks.clock_ahead_s
        if station.mission is not self._mission:
            self._mission = station.mission
            self.tracker.follow(station.mission)
        for seen in self._observations(now_s):
            station.observe(seen)
        agents = [
            complex(*station.tracks.tracks[Kind.AGENT, one].position_ned_m) for one in station.tracks.present_agents
        ]
        failed = [name for name, feed in self.feeds.items() if feed.link.fault is not None]
        for one in self.tracker.due(agents, self._reach_m, now_s, failed):
            if one.key not in self._asked and len(self._asked) < MOST_ASKED:
                self._ask(station, desk, one, now_s)

    def view(self, now_s: float) -> list[dict[str, Any]]:
        """Return the sources as a page shows them."""
        unknown = self.tracker.unknown()
        rows = []
        for name, feed in self.feeds.items():
            health = feed.health(now_s)
            rows.append(
                {
                    "name": name,
                    "kind": feed.spec.kind,
                    "state": health.state,
                    "rate_hz": round(health.rate_hz, 1),
                    "age_s": None if health.age_s is None else round(health.age_s, 1),
                    "things": self.tracker.things(name),
                    "refused": feed.refused + feed.dropped + self.tracker.refused[name],
                    "unknown": sum(1 for one in unknown if one.source == name),
                    "detail": health.detail,
                }
            )
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

    def news(self, now_s: float) -> list[str]:
        """Return the lines about what is not believed that are due."""
        return self.tracker.refusals.news(now_s)

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

        spec = self.feeds[one.key.source].spec
        desk.ask_with(_command(one, spec), who, facts, answer)


def _command(one: Taken | Dropped, spec: SourceSpec) -> Command:
    if isinstance(one, Dropped):
        return Retire(do="retire", kind=_WORDS[one.kind], id=one.id)
    radii: dict[str, Any] = _radii(spec, one.wire.wider_m) if one.kind is Kind.THREAT else {}
    if not one.is_new:
        assert one.id is not None
        bound_m_s = one.wire.speed_bound_m_s
        return Change(do="change", kind=_WORDS[one.kind], id=one.id, speed_bound_m_s=bound_m_s, **radii)
    common: dict[str, Any] = {
        "id": one.id,
        "name": one.name or one.key.key[:40],
        "north_m": one.place.real,
        "east_m": one.place.imag,
        "speed_bound_m_s": one.wire.speed_bound_m_s,
    }
    if one.kind is Kind.TARGET:
        return AddTarget(do="add-target", **common)
    return AddThreat(do="add-threat", floor_m=spec.floor_m, ceiling_m=spec.ceiling_m, **radii, **common)


def _radii(spec: SourceSpec, wider_m: float) -> dict[str, float]:
    """Return a threat's radii, wider by what its speed bound does not tell."""
    keys = ("radius_m", "detection_radius_m", "attack_radius_m")
    return {key: given + wider_m for key in keys if (given := getattr(spec, key)) is not None}


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
