"""Which things the sources see, which of these the picture has, and which commands that takes.

A thing is known by its source's key for it. Its sightings pass the gate of a constant-velocity filter
(groundstation/plausibility.py); once enough agree, and it is near enough to the mission, it is wanted in the picture,
and when it was not seen for too long, or is far away, out of it. What is wanted goes out in batches: every change of
the threats is a new revision, which each vehicle must hear whole before it is certified again. Only a threat that could
reach an agent before the next batch does not wait for it. Everything is bounded: things, and the words about them.

Times are Unix seconds given by the caller, places complex numbers, north + i east, in m on the mission's plane.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from companion.geo.local_frame import LocalFrame, to_grid
from companion.mission.model import Mission, TargetSpec, ThreatSpec
from companion.mission.sources import SourceSpec
from companion.protocol.codec import Kind
from groundstation.origins import Observation
from groundstation.plausibility import Known, Sample, Verdict
from groundstation.sources.box import Box
from groundstation.sources.doubts import Doubts
from groundstation.sources.rules import AHEAD_S, Rules
from groundstation.sources.sighting import Sighting
from groundstation.sources.thing import SourceKey, Thing, begun, placed, sighted, told

BATCH_S = 20.0
"""Least time between two batches of commands, but for threats that cannot wait."""
RETIRED_WITHIN_S = 30.0
"""Time within which a thing that is not wanted any more is retired; earlier with a batch that goes out anyway."""
LOOK_S = 0.5
"""Period at which the whole table is looked through."""
SILENT_SOURCE = 3.0
"""Factor on a thing's time-out while its whole source is silent: that a receiver hears nothing says nothing of it."""
QUIET_S = 10.0
"""Time without any sighting after which a source counts as silent for that."""
OWNED_S = 5.0
"""Time without a sighting after which another source may go on with a thing."""
WATCHED = 4
"""Greatest number of things that are watched, as a multiple of those that a source may have in the picture."""
MOST_UNKNOWN = 64
"""Greatest number of unknown agents that are remembered."""
REPLACED_AT = 0.7
"""Ratio of distances at which a nearer thing takes the place of the farthest in a picture that is full."""
AGAIN_S = 30.0
"""Time after which what was refused by the ground station is asked for again."""
KINDS = {"agents": Kind.AGENT, "targets": Kind.TARGET, "threats": Kind.THREAT}


class Taken(NamedTuple):
    """A thing that is wanted in the picture, or with another bound."""

    key: SourceKey
    kind: Kind
    id: int | None
    """Id that it has or should have in the picture; None: any that is free."""
    name: str
    place: complex
    at_s: float
    bound_m_s: float
    """Greatest speed that it is told with."""
    is_new: bool
    """Whether the picture does not have it from this source yet; otherwise only its bound changes."""
    is_urgent: bool = False


class Dropped(NamedTuple):
    """A thing that is not wanted in the picture any more."""

    key: SourceKey
    kind: Kind
    id: int
    why: str
    heir: SourceKey | None = None
    """What another source calls the same thing, which stays in the picture under its id."""


class Unknown(NamedTuple):
    """An agent that a source sees and the mission does not have."""

    source: str
    id: int
    key: str
    place: complex
    at_s: float
    times: int


class Tracker:
    """The things that all sources of one mission see."""

    def __init__(self, mission: Mission, specs: Sequence[SourceSpec]) -> None:
        """Begin with nothing seen, for some sources."""
        self.doubts = Doubts()
        """What is not believed or not taken in."""
        self.ahead_s = 0.0
        """Time by which the clock that stamps sightings is ahead of the times given (groundstation/clock.py)."""
        self._rules = {spec.name: Rules(spec) for spec in specs if spec.takes_in}
        self._frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        self._mission = mission
        self._box = Box.around(mission)
        self._tables: dict[str, OrderedDict[str, Thing]] = {name: OrderedDict() for name in self._rules}
        self._claims: dict[tuple[str, str], SourceKey] = {}
        """Which thing is meant by what the picture has, by what it is the same as for other sources."""
        self._unknown: OrderedDict[tuple[str, str], Unknown] = OrderedDict()
        self._look_s = self._batch_s = -math.inf

    def follow(self, mission: Mission) -> None:
        """Follow a mission whose things changed; what somebody else retired is not taken in again until it ends."""
        self._mission = mission
        present = {kind: {one.id for one in there} for kind, there in _by_kind(mission).items()}
        ours = {one.id for one in self._things() if self._kind(one.key) is Kind.TARGET and not one.is_listed}
        self._box = Box.around(mission, [one for one in ours if one is not None])
        for thing in list(self._things()):
            kind = self._kind(thing.key)
            if thing.id is None or kind is Kind.AGENT or thing.id in present[kind]:
                continue
            self._put(replace(thing, id=None, bound_m_s=None, waits_until_s=math.inf))
            self._release(thing.key)

    def restore(self, identities: Mapping[tuple[str, str], tuple[Kind, int]], mission: Mission, now_s: float) -> None:
        """Take over from the last run which thing of a source has which id.

        `mission` is what that run has left of the mission's file; what is gone was retired by hand.
        """
        listed = {kind: {one.id for one in there} for kind, there in _by_kind(self._mission).items()}
        present = {kind: {one.id: one for one in there} for kind, there in _by_kind(mission).items()}
        for (source, key), (kind, identity) in identities.items():
            rules = self._rules.get(source)
            if rules is None or kind is not KINDS[rules.spec.things] or kind is Kind.AGENT:
                continue
            there = present[kind].get(identity)
            place = 0j if there is None else complex(*there.position_ned_m)
            thing = begun(SourceKey(source, key), rules, Sighting(key, 0.0, 0.0, now_s), Sample(place, now_s), now_s)
            # Until it is seen, the place is that of the last run.
            thing = replace(thing, known=Known(thing.known.believed))
            if there is None:
                self._put(replace(thing, waits_until_s=math.inf))
                continue
            bound_m_s = None if identity in listed[kind] else there.speed_bound_m_s
            self._put(replace(thing, id=identity, bound_m_s=bound_m_s))
            self._claims[self._claim(thing.key)] = thing.key
        self.follow(mission)

    def things(self, source: str, now_s: float) -> int:
        """Return the number of things of a source that the picture has; of agents, those that it has not lost."""
        rules = self._rules[source]
        is_agents = KINDS[rules.spec.things] is Kind.AGENT
        there = (one for one in self._tables[source].values() if one.id is not None)
        return sum(1 for one in there if not is_agents or now_s <= one.ends_s(rules, 1.0))

    def unknown(self) -> list[Unknown]:
        """Return the agents that sources see and the mission does not have."""
        return list(self._unknown.values())

    def take(self, source: str, sighting: Sighting, now_s: float) -> Observation | None:
        """Weigh a sighting; return the new place of its thing if the picture has that."""
        rules = self._rules[source]
        at_s = self._time_of(rules, sighting, now_s)
        if at_s is None or sighting.key in rules.ignored:
            return None
        north_m, east_m, convergence_rad = self._frame.to_local_with_convergence(sighting.lat_deg, sighting.lon_deg)
        sample = Sample(complex(north_m, east_m), at_s)
        key, kind = SourceKey(source, sighting.key), KINDS[rules.spec.things]
        if kind is Kind.AGENT and not self._is_agent(key, sample):
            return None
        if not self._can_be(rules, key, sighting, sample):
            return None
        before = self._tables[source].get(sighting.key)
        if before is None or not before.known.is_seen:
            thing = begun(key, rules, sighting, sample, now_s)
            if before is None:
                self._make_room(rules)
            else:
                # Of the last run: it may be anywhere by now.
                thing = replace(thing, id=before.id, bound_m_s=before.bound_m_s, waits_until_s=before.waits_until_s)
        else:
            thing, weighed, bound = sighted(before, rules, sighting, sample, now_s)
            if weighed.verdict is not Verdict.BELIEVED:
                self._put(thing)
                self.doubts.unlikely(key, weighed, bound.speed_m_s)
                return None
        velocity = sighting.velocity
        if velocity is not None:
            velocity = complex(*to_grid(velocity.real, velocity.imag, convergence_rad))
        thing = told(thing, sighting, velocity, self.ahead_s if rules.is_stamped else 0.0)
        if kind is Kind.AGENT:
            thing = replace(thing, id=self._agent_id(key))
        else:
            thing = placed(thing, rules, sighting, self._box.distance_m(sample.place), now_s)
        self._put(thing)
        if thing.id is None or not self._owns(thing, now_s):
            return None
        error_m = rules.bound(sighting, 0.0).noise.error_m
        return Observation(kind, thing.id, thing.place, thing.velocity or 0j, at_s, error_m, source)

    def is_due(self, now_s: float) -> bool:
        """Return whether the table is to be looked through again."""
        return now_s >= self._look_s

    def due(
        self, agents: Sequence[complex], reach_m: float, now_s: float, failed: Collection[str] = ()
    ) -> list[Taken | Dropped]:
        """Return what is wanted in the picture and out of it by now.

        `agents` are where agents are, `reach_m` is how far one flies until the next batch, and `failed` are the sources
        whose links have failed. What is returned is answered by `taken`, `dropped` or `declined`.
        """
        if not self.is_due(now_s):
            return []
        self._look_s = now_s + LOOK_S
        drops: list[tuple[Dropped, float]] = []
        wanted: list[Taken] = []
        for source, rules in self._rules.items():
            if KINDS[rules.spec.things] is Kind.AGENT:
                continue
            factor = SILENT_SOURCE if source in failed or self._is_silent(source, now_s) else 1.0
            drops += self._forgotten(source, factor, now_s)
            drops += self._drops(source, factor, now_s)
            more, instead = self._wanted(source, np.array(agents, dtype=complex), reach_m, now_s)
            wanted += more
            drops += [(one, now_s) for one in instead]
        waited_s = max((now_s - since_s for _, since_s in drops), default=0.0)
        is_batch = now_s >= self._batch_s and (wanted or waited_s >= RETIRED_WITHIN_S)
        if not is_batch and not any(one.is_urgent for one in wanted):
            return []
        self._batch_s = now_s + BATCH_S
        # Whoever asks first has it, so that no other source asks for the same meanwhile.
        firsts = [one for one in wanted if self._claims.setdefault(self._claim(one.key), one.key) == one.key]
        return [*(drop for drop, _ in drops), *firsts]

    def taken(self, taken: Taken, identity: int, is_listed: bool) -> None:
        """Note that a thing is in the picture as was asked for; `is_listed`: as one that the mission's file has."""
        thing = self._tables[taken.key.source].get(taken.key.key)
        if thing is not None:
            self._put(replace(thing, id=identity, bound_m_s=None if is_listed else taken.bound_m_s))
            self._claims[self._claim(taken.key)] = taken.key

    def dropped(self, dropped: Dropped) -> None:
        """Note that a thing is out of the picture, or is its heir's."""
        thing = self._tables[dropped.key.source].get(dropped.key.key)
        if thing is not None and thing.waits_until_s == math.inf:
            del self._tables[dropped.key.source][dropped.key.key]
            return
        bound_m_s = None if thing is None else thing.bound_m_s
        if thing is not None:
            self._put(replace(thing, id=None, bound_m_s=None))
        self._release(dropped.key)
        heir = dropped.heir and self._tables[dropped.heir.source].get(dropped.heir.key)
        if heir:
            self._put(replace(heir, id=dropped.id, bound_m_s=bound_m_s))
            self._claims[self._claim(heir.key)] = heir.key

    def declined(self, wanted: Taken | Dropped, why: str, now_s: float) -> None:
        """Note that the ground station refused something, which is not asked for again at once."""
        thing = self._tables[wanted.key.source].get(wanted.key.key)
        if thing is not None:
            self._put(replace(thing, waits_until_s=now_s + AGAIN_S))
            if thing.id is None:
                self._release(wanted.key)
        self.doubts.declined(wanted.key.source, why)

    def _things(self) -> Iterator[Thing]:
        for table in self._tables.values():
            yield from table.values()

    def _put(self, thing: Thing) -> None:
        """Keep a thing; the one that was put for the longest time stands first in its table."""
        table = self._tables[thing.key.source]
        table[thing.key.key] = thing
        table.move_to_end(thing.key.key)

    def _kind(self, key: SourceKey) -> Kind:
        return KINDS[self._rules[key.source].spec.things]

    def _agent_id(self, key: SourceKey) -> int | None:
        """Return the id of the agent that a source's key stands for: the given one, or the key where it is a number."""
        given = self._rules[key.source].ids.get(key.key)
        return int(key.key) if given is None and key.key.isdecimal() and len(key.key) <= 5 else given

    def _claim(self, key: SourceKey) -> tuple[str, str]:
        """Return by what a thing is known to be the same one that another source sees."""
        rules, kind = self._rules[key.source], self._kind(key)
        identity = self._agent_id(key) if kind is Kind.AGENT else rules.ids.get(key.key)
        return rules.claim(key.key) if identity is None else (kind.name, str(identity))

    def _release(self, key: SourceKey) -> None:
        claim = self._claim(key)
        if self._claims.get(claim) == key:
            del self._claims[claim]

    def _owns(self, thing: Thing, now_s: float) -> bool:
        """Return whether a thing's place is its source's to say; another may go on where one has fallen silent."""
        claim = self._claim(thing.key)
        owner = self._claims.setdefault(claim, thing.key)
        if owner == thing.key:
            return True
        other = self._tables[owner.source].get(owner.key)
        if other is None or now_s - other.seen_at_s > OWNED_S:
            self._claims[claim] = thing.key
            return True
        gone = (other.velocity or 0j) * (thing.seen_at_s - other.seen_at_s)
        self.doubts.claimed(thing.key, owner.source, abs(thing.place - other.place - gone))
        return False

    def _is_agent(self, key: SourceKey, sample: Sample) -> bool:
        """Return whether the mission has the agent that was sighted; note it if not."""
        identity = self._agent_id(key)
        if any(agent.id == identity for agent in self._mission.agents):
            return True
        before = self._unknown.pop(key, None)
        times = 1 if before is None else before.times + 1
        self._unknown[key] = Unknown(key.source, identity or 0, key.key, sample.place, sample.at_s, times)
        if len(self._unknown) > MOST_UNKNOWN:
            self._unknown.popitem(last=False)
        self.doubts.stranger(key)
        return False

    def _can_be(self, rules: Rules, key: SourceKey, sighting: Sighting, sample: Sample) -> bool:
        """Return whether a sighting's velocity is one of its category's, and an agent's place is near the mission."""
        fastest_m_s = rules.bound(sighting, 0.0).speed_m_s
        if sighting.velocity is not None and abs(sighting.velocity) > fastest_m_s:
            self.doubts.too_fast(key, abs(sighting.velocity), fastest_m_s)
            return False
        away_m = self._box.distance_m(sample.place)
        if self._kind(key) is Kind.AGENT and away_m > rules.spec.within_m:
            self.doubts.too_far(key, away_m, rules.spec.within_m)
            return False
        return True

    def _time_of(self, rules: Rules, sighting: Sighting, now_s: float) -> float | None:
        """Return when a sighting was made that comes in now; None if its stamp cannot be true."""
        at_s = sighting.at_s - (self.ahead_s if rules.is_stamped else 0.0)
        if not at_s - now_s <= AHEAD_S:
            self.doubts.ahead(rules.spec.name, at_s - now_s, AHEAD_S)
            return None
        if now_s - at_s > rules.behind_s:
            self.doubts.behind(rules.spec.name, now_s - at_s, rules.behind_s)
            return None
        return min(now_s, at_s)

    def _make_room(self, rules: Rules) -> None:
        """Forget, of too many things that a source sees, the one that is not in the picture and oldest."""
        table = self._tables[rules.spec.name]
        if len(table) >= WATCHED * rules.spec.most:
            oldest = next((key for key, thing in table.items() if self._is_out(thing)), None)
            if oldest is not None:
                del table[oldest]
                self.doubts.flooded(rules.spec.name, WATCHED * rules.spec.most)

    def _is_out(self, thing: Thing) -> bool:
        """Return whether the picture does not have a thing, nor was asked to take it in."""
        return thing.id is None and self._claims.get(self._claim(thing.key)) != thing.key

    def _is_silent(self, source: str, now_s: float) -> bool:
        """Return whether a source that sees several things has seen none of late."""
        table = self._tables[source]
        return len(table) > 1 and all(now_s - thing.seen_at_s > QUIET_S for thing in table.values())

    def _forgotten(self, source: str, factor: float, now_s: float) -> list[tuple[Dropped, float]]:
        """Forget what is not in the picture and was not seen for too long; return what somebody else has retired."""
        table, rules = self._tables[source], self._rules[source]
        ended = [thing for thing in table.values() if self._is_out(thing) and now_s > thing.ends_s(rules, factor)]
        for thing in ended:
            if thing.waits_until_s != math.inf:
                del table[thing.key.key]
        kind = KINDS[rules.spec.things]
        return [
            (Dropped(thing.key, kind, 0, "not seen any more"), -math.inf)
            for thing in ended
            if thing.waits_until_s == math.inf
        ]

    def _drops(self, source: str, factor: float, now_s: float) -> list[tuple[Dropped, float]]:
        """Return the things of a source that are not wanted any more, each with the time since which."""
        drops = []
        rules = self._rules[source]
        for thing in self._tables[source].values():
            if thing.id is None or thing.is_listed or now_s < thing.waits_until_s:
                continue
            ends_s = thing.ends_s(rules, factor)
            if now_s > ends_s:
                why, since_s = f"not seen for {now_s - thing.seen_at_s:.0f} s", ends_s
            elif thing.leaves_since_s is not None:
                why, since_s = "too far away, too high or too low", thing.leaves_since_s
            else:
                continue
            heir = self._heir(thing, now_s) if now_s > ends_s else None
            drops.append((Dropped(thing.key, self._kind(thing.key), thing.id, why, heir), since_s))
        return drops

    def _heir(self, thing: Thing, now_s: float) -> SourceKey | None:
        """Return what another source that still sees a thing calls it."""
        claim = self._claim(thing.key)
        for source, table in self._tables.items():
            other = table.get(thing.key.key)
            if source != thing.key.source and other is not None and self._claim(other.key) == claim:
                if other.id is None and now_s - other.seen_at_s <= OWNED_S:
                    return other.key
        return None

    def _wanted(
        self, source: str, agents: np.ndarray, reach_m: float, now_s: float
    ) -> tuple[list[Taken], list[Dropped]]:
        """Return what a source sees that is wanted in the picture, and what gives way to it in one that is full."""
        rules, table = self._rules[source], self._tables[source]
        changes = [thing for thing in table.values() if thing.outgrows(rules) and now_s >= thing.waits_until_s]
        new = [thing for thing in table.values() if self._is_wanted(thing, rules, now_s)]
        if not changes and not new:
            return [], []
        inside = [thing for thing in table.values() if thing.id is not None]
        near_m = _nearest_m(new, agents)
        order = sorted(range(len(new)), key=lambda k: near_m[k])
        room = max(0, rules.spec.most - len(inside))
        chosen, dropped = order[:room], []
        far = sorted(zip(_nearest_m(inside, agents), inside, strict=True), key=lambda one: one[0])
        for k in order[room:]:
            # A listed thing stays.
            while far and far[-1][1].is_listed:
                far.pop()
            if not far or near_m[k] >= REPLACED_AT * far[-1][0]:
                self.doubts.full(source, len(order) - len(chosen), rules.spec.most)
                break
            _, thing = far.pop()
            assert thing.id is not None
            dropped.append(Dropped(thing.key, self._kind(thing.key), thing.id, "nearer ones take its place"))
            chosen.append(k)
        # What reaches an agent before the next batch goes out now.
        radius_m = (rules.spec.radius_m or rules.spec.detection_radius_m or 0.0) + reach_m
        wanted = [self._taken_of(new[k], rules, near_m[k] - radius_m) for k in chosen]
        return [*(self._taken_of(one, rules, math.inf) for one in changes), *wanted], dropped

    def _is_wanted(self, thing: Thing, rules: Rules, now_s: float) -> bool:
        is_new = thing.id is None and thing.is_confirmed(rules) and thing.leaves_since_s is None
        return is_new and now_s >= thing.waits_until_s and self._claim(thing.key) not in self._claims

    def _taken_of(self, thing: Thing, rules: Rules, room_m: float) -> Taken:
        """Return what a thing is to be taken in with; `room_m` is how far it is from what it must not reach."""
        bound_m_s = thing.bound_wanted_m_s(rules)
        speed_m_s = bound_m_s if thing.speed_m_s is None else thing.speed_m_s
        is_urgent = thing.outruns() or room_m <= speed_m_s * BATCH_S
        identity = rules.ids.get(thing.key.key) if thing.id is None else thing.id
        motion = thing.known.believed.motion
        kind = self._kind(thing.key)
        return Taken(
            thing.key, kind, identity, thing.name, motion.place, motion.at_s, bound_m_s, thing.id is None, is_urgent
        )


def _nearest_m(things: Sequence[Thing], agents: np.ndarray) -> list[float]:
    """Return how far each thing is from the nearest agent; 0 without agents."""
    places = np.array([thing.place for thing in things], dtype=complex)
    if not len(agents):
        return [0.0] * len(things)
    apart_m = np.abs(places[:, np.newaxis] - agents[np.newaxis, :])
    return [float(one) for one in apart_m.min(axis=1)]


def _by_kind(mission: Mission) -> dict[Kind, tuple[TargetSpec, ...] | tuple[ThreatSpec, ...]]:
    return {Kind.TARGET: mission.targets, Kind.THREAT: mission.threats}
