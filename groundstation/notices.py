"""What the ground station notices by itself, as events: arrivals, losses, other targets and why, new revisions.

The operations hold what events have told so far; what the station's facts have beyond that is news. So nothing is told
twice, and after a restart only what has happened since.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from groundstation.events import (
    STATION,
    ArrivalTakenBack,
    Arrived,
    Assigned,
    Event,
    HeardAgain,
    Lost,
    NewTarget,
    RevisionBegan,
    UnknownSeen,
)
from groundstation.operations import KIND_NAMES, Operations
from groundstation.origins import Unknown
from groundstation.sightings import Key


@dataclass(frozen=True)
class Facts:
    """What a ground station knows at a time."""

    been_at: Mapping[int, tuple[int, ...]]
    """Ids of the agents that have arrived at a target, by target id."""
    lost: frozenset[int]
    assignment: Mapping[int, int]
    """Id of the target by agent id."""
    revision: int
    unknown: Mapping[Key, Unknown] = field(default_factory=dict)
    """What the sensor sees and the mission does not have."""


MOST_TOLD = 256
"""Greatest number of unknown things that are told as events, which are kept for ever: a sensor may see anything."""


def noticed(operations: Operations, facts: Facts, unix_s: float) -> list[Event]:
    """Return what is new in the facts of a ground station, as the next events of its operations."""
    return [
        event.model_copy(update={"number": operations.next_number + index})
        for index, event in enumerate(_news(operations, facts, unix_s))
    ]


def _news(operations: Operations, facts: Facts, unix_s: float) -> Iterator[Event]:
    """Yield what is new; all events have the number of the first."""
    number, reached = operations.next_number, operations.reached
    if facts.lost != reached.lost:
        for agent in sorted(facts.lost - reached.lost):
            yield Lost(number=number, unix_s=unix_s, who=STATION, agent=agent)
        for agent in sorted(reached.lost - facts.lost):
            yield HeardAgain(number=number, unix_s=unix_s, who=STATION, agent=agent)
    if facts.been_at != reached.by:
        for agent, target in sorted(_pairs(reached.by) - _pairs(facts.been_at)):
            yield ArrivalTakenBack(number=number, unix_s=unix_s, who=STATION, agent=agent, target=target)
        for agent, target in sorted(_pairs(facts.been_at) - _pairs(reached.by)):
            yield Arrived(number=number, unix_s=unix_s, who=STATION, agent=agent, target=target)
    if facts.assignment != operations.assignment:
        changes = tuple(_changes(operations, facts))
        yield Assigned(number=number, unix_s=unix_s, who=STATION, changes=changes)
    if facts.revision != operations.revision:
        threats = len(operations.mission.threats)
        yield RevisionBegan(number=number, unix_s=unix_s, who=STATION, revision=facts.revision, threats=threats)
    room = max(0, MOST_TOLD - len(operations.unknown))
    for key in sorted(facts.unknown.keys() - operations.unknown)[:room]:
        thing = facts.unknown[key]
        north_m, east_m = thing.place.real, thing.place.imag
        yield UnknownSeen(
            number=number,
            unix_s=unix_s,
            who=STATION,
            source=thing.source,
            kind=KIND_NAMES[key[0]],
            id=key[1],
            north_m=north_m,
            east_m=east_m,
        )


def _pairs(been_at: Mapping[int, tuple[int, ...]]) -> set[tuple[int, int]]:
    """Return who has been where as pairs of an agent's and a target's id."""
    return {(agent, target) for target, agents in been_at.items() for agent in agents}


def _changes(operations: Operations, facts: Facts) -> Iterator[NewTarget]:
    before, after = operations.assignment, facts.assignment
    for agent in sorted(before.keys() | after.keys()):
        if before.get(agent) != after.get(agent):
            yield NewTarget(agent=agent, target=after.get(agent), reason=_reason(operations, facts, agent))


def _reason(operations: Operations, facts: Facts, agent: int) -> str:
    """Return why an agent has another target than events have told so far."""
    old, new = operations.assignment.get(agent), facts.assignment.get(agent)
    if agent in facts.lost:
        return "the agent is lost"
    if agent in operations.orders.out:
        return "the agent was taken out"
    if agent in operations.orders.away:
        return "recalled"
    if old is not None and agent in facts.been_at.get(old, ()):
        return f"arrived at target {old}" if new is None else f"arrived at target {old}: the next of the queue"
    if new is not None and operations.orders.pins.get(agent) == new:
        return "pinned by an operator"
    if old is None and not operations.assignment:
        return "the first assignment"
    if old is not None and all(target.id != old for target in operations.mission.targets):
        return f"target {old} was retired"
    if old is not None and facts.been_at.get(old):
        return f"agent {facts.been_at[old][0]} has arrived at target {old}"
    if new is None:
        return "no target left that it could reach"
    left = [one for one, target in operations.assignment.items() if target == new and one != agent]
    gone = [one for one in left if facts.assignment.get(one) != new]
    if gone and not set(left) - set(gone):
        return f"in the place of agent {gone[0]}"
    if agent in operations.reached.arrived:
        return "the next of the queue"
    if old is None:
        return "it had no target"
    return f"the assignment by {operations.mission.objective} is better by more than the share that keeps targets"
