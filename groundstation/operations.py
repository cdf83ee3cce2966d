"""The day's operations: what the mission file and all events since make of mission, orders and progress.

`applied` folds one event, so that a restart, which folds the stored ones, stands where the run before it ended: with
the same ids, pins, directives, arrivals and targets. `undo_of` says what takes an event back. Nothing here knows a
clock, a socket or a file.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

from companion.errors import some_of
from companion.mission.model import Mission, TargetSpec, ThreatSpec
from companion.protocol.messages import Directive, Kind
from groundstation.events import (
    ArrivalTakenBack,
    Arrived,
    Assigned,
    Command,
    Directed,
    DirectiveName,
    Event,
    HeardAgain,
    KindName,
    Lost,
    OwnDirective,
    Pause,
    Paused,
    Pin,
    Pinned,
    PutBack,
    Restored,
    Resume,
    Resumed,
    Retire,
    Retired,
    RevisionBegan,
    TakenOut,
    TakeOut,
    TargetAdded,
    TargetChanged,
    Telling,
    ThingKind,
    ThingState,
    ThreatAdded,
    ThreatChanged,
    TrackBegan,
    TrackEnded,
    UnknownSeen,
    WasPutBack,
)
from groundstation.sightings import Key

MOST_NAMED = 20
"""Greatest number of ids that a message names of one kind."""
MOST_UNDOS = 50
"""Number of the last commands that can be taken back."""
KINDS: dict[KindName, Kind] = {"agent": Kind.AGENT, "target": Kind.TARGET, "threat": Kind.THREAT}
"""Kinds of things by their words in commands, events and views."""
KIND_NAMES = {kind: name for name, kind in KINDS.items()}
DIRECTIVES: dict[DirectiveName, Directive] = {
    "normal": Directive.NORMAL,
    "hold": Directive.HOLD,
    "return": Directive.RETURN,
}
"""Directives by their words there."""
DIRECTIVE_NAMES = {directive: name for name, directive in DIRECTIVES.items()}

ThingEvent = TargetAdded | TargetChanged | ThreatAdded | ThreatChanged | Restored
KeyT = TypeVar("KeyT")
ValueT = TypeVar("ValueT")
ThingT = TypeVar("ThingT", TargetSpec, ThreatSpec)


@dataclass(frozen=True)
class Orders:
    """What operators want of the agents."""

    pins: Mapping[int, int] = field(default_factory=dict)
    """Id of the target that an agent is pinned to, by agent id."""
    out: frozenset[int] = frozenset()
    """Ids of the agents that were taken out of the assignment."""
    directive: Directive = Directive.NORMAL
    """What all agents are told, except in a pause."""
    own: Mapping[int, Directive] = field(default_factory=dict)
    """What single agents are told, by id; none is NORMAL."""
    paused: bool = False

    @property
    def told(self) -> Directive:
        """What all agents are told now: in a pause at least to hold."""
        return max(self.directive, Directive.HOLD) if self.paused else self.directive

    def of(self, agent_id: int) -> Directive:
        """Return what an agent is told: of its own directive and that of all, the stricter one."""
        return max(self.told, self.own.get(agent_id, Directive.NORMAL))

    @property
    def away(self) -> frozenset[int]:
        """Ids of the agents that get no target: taken out, or told to return though not all are."""
        return self.out | {agent for agent, given in self.own.items() if given is Directive.RETURN}


@dataclass(frozen=True)
class Reached:
    """Who has arrived where, and who is lost, as far as events tell."""

    arrived: Mapping[int, int] = field(default_factory=dict)
    """Id of the target at which an agent is, by agent id."""
    completed: frozenset[int] = frozenset()
    """Ids of the targets that were reached."""
    by: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    """Ids of the agents that have reached a target, in order, by target id."""
    lost: frozenset[int] = frozenset()


class Identity(NamedTuple):
    """What a source's track stands for."""

    kind: Kind
    id: int


class Undone(NamedTuple):
    """What takes an event back: a command, or what a thing or a directive was before."""

    number: int
    by: Command | ThingState | Telling
    is_undo: bool = False
    """Whether the event itself took another one back."""


@dataclass(frozen=True)
class Operations:
    """The state of a day's flying that events make; equal events make equal operations."""

    mission: Mission
    """The mission with what was added, changed and retired."""
    used: Mapping[Kind, int]
    """Ids of targets and threats that were ever used, as the bits of a number, by kind: none is given twice."""
    names: Mapping[Key, str] = field(default_factory=dict)
    placed_s: Mapping[Key, float] = field(default_factory=dict)
    """Unix time at which a thing was at the place that the mission has of it, where a command gave that place."""
    orders: Orders = Orders()
    reached: Reached = Reached()
    assignment: Mapping[int, int] = field(default_factory=dict)
    """Id of the target by agent id."""
    tracks: Mapping[tuple[str, str], Identity] = field(default_factory=dict)
    """What a source's tracks stand for, by the source's name and its key."""
    revision: int | None = None
    """Number of the last revision of the picture."""
    unknown: frozenset[Key] = frozenset()
    """What the sensor saw and the mission does not have, as far as events have told."""
    next_number: int = 1
    undos: tuple[Undone, ...] = ()
    """What takes the last commands back."""

    @staticmethod
    def begun(mission: Mission) -> Operations:
        """Return the operations of a resolved mission before any event."""
        used = {
            Kind.TARGET: _bits(target.id for target in mission.targets),
            Kind.THREAT: _bits(threat.id for threat in mission.threats),
        }
        return Operations(mission, used)

    @property
    def undoable(self) -> list[int]:
        """Numbers of the commands' events that can be taken back and are in force, in their order."""
        return [undone.number for undone in self.undos if not undone.is_undo]

    @property
    def open_targets(self) -> list[int]:
        """Ids of the targets not reached yet, in order of the mission."""
        return [target.id for target in self.mission.targets if target.id not in self.reached.completed]


def folded(mission: Mission, events: Iterable[Event]) -> Operations:
    """Return the operations that a resolved mission and all events of its runs make."""
    operations = Operations.begun(mission)
    for event in events:
        operations = applied(operations, event)
    return operations


def _bits(ids: Iterable[int]) -> int:
    bits = 0
    for identity in ids:
        bits |= 1 << identity
    return bits


def applied(operations: Operations, event: Event) -> Operations:
    """Return the operations after an event."""
    undo = undo_of(operations, event) if event.who.role == "operator" else None
    after = _applied(operations, event)
    undos = operations.undos
    if event.undoes is not None:
        undos = tuple(undone for undone in undos if undone.number != event.undoes)
    if undo is not None:
        # Taking back an undo is what was asked at first, done once more.
        again = any(undone.number == event.undoes and undone.is_undo for undone in operations.undos)
        undos = (*undos, Undone(event.number, undo, event.undoes is not None and not again))[-MOST_UNDOS:]
    return replace(after, next_number=event.number + 1, undos=undos)


def _applied(operations: Operations, event: Event) -> Operations:
    orders = operations.orders
    match event:
        case TargetAdded() | TargetChanged() | ThreatAdded() | ThreatChanged() | Restored():
            return _with_thing(operations, event)
        case Retired():
            return _without_thing(operations, (KINDS[event.kind], event.id))
        case Pinned():
            pins = {agent: target for agent, target in orders.pins.items() if agent != event.agent}
            pins |= {} if event.target is None else {event.agent: event.target}
            return replace(operations, orders=replace(orders, pins=pins))
        case TakenOut():
            return replace(operations, orders=replace(orders, out=orders.out | {event.agent}))
        case WasPutBack():
            return replace(operations, orders=replace(orders, out=orders.out - {event.agent}))
        case Directed():
            return replace(operations, orders=_directed(orders, event))
        case Paused() | Resumed():
            return replace(operations, orders=replace(orders, paused=isinstance(event, Paused)))
        case Arrived() | ArrivalTakenBack() | Lost() | HeardAgain():
            return replace(operations, reached=_progressed(operations.reached, event))
        case Assigned():
            return _assigned(operations, event)
        case RevisionBegan():
            return replace(operations, revision=event.revision)
        case UnknownSeen():
            return replace(operations, unknown=operations.unknown | {(KINDS[event.kind], event.id)})
        case TrackBegan():
            identity = Identity(KINDS[event.kind], event.id)
            return replace(operations, tracks={**operations.tracks, (event.source, event.key): identity})
        case TrackEnded():
            tracks = {key: known for key, known in operations.tracks.items() if key != (event.source, event.key)}
            return replace(operations, tracks=tracks)
    return operations


def _with_thing(operations: Operations, event: ThingEvent) -> Operations:
    """Return the operations with a thing that is new, or is not what it was."""
    if isinstance(event, Restored):
        return _with_state(operations, event.state)
    target, threat = _thing_of(event)
    key = _key_of(event)
    before = _state_of(operations, key)
    is_placed = isinstance(event, TargetAdded | ThreatAdded) or event.moved
    state = ThingState(
        target=target,
        threat=threat,
        name=event.name,
        placed_s=event.unix_s if is_placed or before is None else before.placed_s,
        pinned=() if before is None else before.pinned,
        reached_by=() if before is None else before.reached_by,
    )
    return _with_state(operations, state)


def _state_of(operations: Operations, key: Key) -> ThingState | None:
    """Return everything that commands have made of a thing; None if it is not there."""
    kind, identity = key
    mission = operations.mission
    name, placed_s = operations.names.get(key), operations.placed_s.get(key)
    if kind is Kind.THREAT:
        for threat in mission.threats:
            if threat.id == identity:
                return ThingState(threat=threat, name=name, placed_s=placed_s)
        return None
    pinned = tuple(sorted(agent for agent, target in operations.orders.pins.items() if target == identity))
    reached_by = operations.reached.by.get(identity, ())
    for target in mission.targets:
        if target.id == identity:
            return ThingState(target=target, name=name, placed_s=placed_s, pinned=pinned, reached_by=reached_by)
    return None


def _with_state(operations: Operations, state: ThingState) -> Operations:
    mission, orders, reached = operations.mission, operations.orders, operations.reached
    if state.target is not None:
        key = Kind.TARGET, state.target.id
        mission = mission.model_copy(update={"targets": _put(mission.targets, state.target)})
        # Who was pinned elsewhere in the meantime stays there.
        orders = replace(orders, pins={**dict.fromkeys(state.pinned, key[1]), **orders.pins})
        if state.reached_by:
            by = {**reached.by, key[1]: state.reached_by}
            reached = replace(reached, completed=reached.completed | {key[1]}, by=by)
    else:
        assert state.threat is not None
        key = Kind.THREAT, state.threat.id
        mission = mission.model_copy(update={"threats": _put(mission.threats, state.threat)})
    return replace(
        operations,
        mission=mission,
        orders=orders,
        reached=reached,
        names=_set(operations.names, key, state.name),
        placed_s=_set(operations.placed_s, key, state.placed_s),
        used={**operations.used, key[0]: operations.used[key[0]] | 1 << key[1]},
    )


def _set(table: Mapping[KeyT, ValueT], key: KeyT, value: ValueT | None) -> Mapping[KeyT, ValueT]:
    """Return a table with another value of a key; None: without it."""
    if table.get(key) == value:
        return table
    others = {one: known for one, known in table.items() if one != key}
    return others if value is None else {**others, key: value}


def _put(things: tuple[ThingT, ...], thing: ThingT) -> tuple[ThingT, ...]:
    """Return things with one of them in the place of that with its id, or at the end."""
    placed = [thing if one.id == thing.id else one for one in things]
    if all(one.id != thing.id for one in things):
        placed.append(thing)
    return tuple(placed)


def _without_thing(operations: Operations, key: Key) -> Operations:
    """Return the operations without a thing; what a source calls it stays known, so that it is not added anew."""
    kind, identity = key
    mission, orders, reached = operations.mission, operations.orders, operations.reached
    after = replace(operations, names=_set(operations.names, key, None), placed_s=_set(operations.placed_s, key, None))
    if kind is Kind.THREAT:
        threats = tuple(threat for threat in mission.threats if threat.id != identity)
        return replace(after, mission=mission.model_copy(update={"threats": threats}))
    targets = tuple(target for target in mission.targets if target.id != identity)
    pins = {agent: target for agent, target in orders.pins.items() if target != identity}
    by = {target: agents for target, agents in reached.by.items() if target != identity}
    return replace(
        after,
        mission=mission.model_copy(update={"targets": targets}),
        orders=replace(orders, pins=pins),
        reached=replace(reached, completed=reached.completed - {identity}, by=by),
    )


def _assigned(operations: Operations, event: Assigned) -> Operations:
    """Return the operations with other targets; who has arrived and is sent on is under way again."""
    assignment, arrived = dict(operations.assignment), dict(operations.reached.arrived)
    for change in event.changes:
        assignment.pop(change.agent, None)
        if change.target is not None:
            assignment[change.agent] = change.target
            arrived.pop(change.agent, None)
    return replace(operations, assignment=assignment, reached=replace(operations.reached, arrived=arrived))


def _directed(orders: Orders, event: Directed) -> Orders:
    directive = DIRECTIVES[event.directive]
    if event.agent is None:
        given = {one.agent: DIRECTIVES[one.directive] for one in event.own or ()}
        ends = directive is Directive.NORMAL and event.own is None
        return replace(orders, directive=directive, own={} if ends else {**given, **orders.own})
    own = {agent: given for agent, given in orders.own.items() if agent != event.agent}
    if directive is not Directive.NORMAL:
        own[event.agent] = directive
    return replace(orders, own=own)


def _progressed(reached: Reached, event: Arrived | ArrivalTakenBack | Lost | HeardAgain) -> Reached:
    match event:
        case Lost():
            return replace(reached, lost=reached.lost | {event.agent})
        case HeardAgain():
            return replace(reached, lost=reached.lost - {event.agent})
        case Arrived():
            here = (*(one for one in reached.by.get(event.target, ()) if one != event.agent), event.agent)
            return replace(
                reached,
                arrived={**reached.arrived, event.agent: event.target},
                completed=reached.completed | {event.target},
                by={**reached.by, event.target: here},
            )
    left = tuple(one for one in reached.by.get(event.target, ()) if one != event.agent)
    return replace(
        reached,
        arrived={one: there for one, there in reached.arrived.items() if (one, there) != (event.agent, event.target)},
        completed=reached.completed if left else reached.completed - {event.target},
        by=_set(reached.by, event.target, left or None),
    )


def undo_of(before: Operations, event: Event) -> Command | ThingState | Telling | None:
    """Return what takes an event back, from the operations before it; None if nothing does.

    What the ground station noticed itself is not taken back.
    """
    match event:
        case TargetAdded() | TargetChanged() | ThreatAdded() | ThreatChanged() | Restored() | Retired():
            key = _key_of(event)
            kind: ThingKind = "target" if key[0] is Kind.TARGET else "threat"
            state = _state_of(before, key)
            return Retire(do="retire", kind=kind, id=key[1]) if state is None else state
        case Pinned():
            return Pin(do="pin", agent=event.agent, target=before.orders.pins.get(event.agent))
        case TakenOut():
            return PutBack(do="put-back", agent=event.agent)
        case WasPutBack():
            return TakeOut(do="take-out", agent=event.agent)
        case Directed():
            return _telling(before.orders, event)
        case Paused():
            return Resume(do="resume")
        case Resumed():
            return Pause(do="pause")
    return None


def _telling(before: Orders, event: Directed) -> Telling:
    """Return what was told before a directive, from the orders before it."""
    if event.agent is not None:
        given = before.own.get(event.agent, Directive.NORMAL)
        return Telling(directive=DIRECTIVE_NAMES[given], agent=event.agent)
    ended = before.own.keys() - _directed(before, event).own.keys()
    own = tuple(OwnDirective(agent=one, directive=DIRECTIVE_NAMES[before.own[one]]) for one in sorted(ended))
    return Telling(directive=DIRECTIVE_NAMES[before.directive], own=own)


def _key_of(event: ThingEvent | Retired) -> Key:
    """Return which thing an event is about."""
    if isinstance(event, Retired):
        return KINDS[event.kind], event.id
    target, threat = _thing_of(event)
    if target is not None:
        return Kind.TARGET, target.id
    assert threat is not None
    return Kind.THREAT, threat.id


def _thing_of(event: ThingEvent) -> tuple[TargetSpec | None, ThreatSpec | None]:
    """Return the target, or the threat, that an event makes of a thing."""
    match event:
        case TargetAdded() | TargetChanged():
            return event.target, None
        case ThreatAdded() | ThreatChanged():
            return None, event.threat
    return event.state.target, event.state.threat


def ids_in_words(ids: Iterable[int]) -> str:
    """Return ids in words, "none" if there are none; the first ones only if there are many."""
    return some_of(sorted(ids), MOST_NAMED) or "none"
