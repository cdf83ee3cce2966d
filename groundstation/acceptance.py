"""Whether a command of an operator or a source is accepted, and the event that it then makes.

A pure function of the operations, the command and the time: what is refused says why, and what is allowed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from companion.errors import InputError
from companion.files.yaml import validated
from companion.geo.polygon import inside_polygon
from companion.mission.model import Mission, TargetSpec, ThreatSpec
from companion.mission.places import Plane, Position
from companion.mission.values import MAX_ID, MAX_ITEMS, RADII
from companion.mission.written import radii_m
from companion.protocol.messages import Kind
from groundstation.broadcast import MOST_FRAMES, frames_for
from groundstation.events import (
    AddTarget,
    AddThreat,
    Change,
    Command,
    Direct,
    Directed,
    Event,
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
    TakenOut,
    TakeOut,
    TargetAdded,
    TargetChanged,
    Telling,
    ThingKind,
    ThingState,
    ThreatAdded,
    ThreatChanged,
    Undo,
    WasPutBack,
    Who,
)
from groundstation.operations import DIRECTIVE_NAMES, DIRECTIVES, MOST_UNDOS, Operations, applied, ids_in_words


def event_of(operations: Operations, command: Command, who: Who, now_s: float) -> Event:
    """Return the event that a command makes at a Unix time.

    Raises:
        InputError: it cannot be accepted; the message says why and what is allowed.

    """
    head: dict[str, Any] = {"number": operations.next_number, "unix_s": now_s, "who": who}
    if isinstance(command, Undo):
        by = _undo(operations, command.number)
        head["undoes"] = command.number
        match by:
            case ThingState():
                event: Event = Restored(**head, state=by)
            case Telling():
                event = Directed(**head, **by.model_dump())
            case _:
                event = _event(operations, by, head)
    else:
        event = _event(operations, command, head)
    _check_sendable(operations, event)
    return event


def _check_sendable(operations: Operations, event: Event) -> None:
    """Raise InputError if an event adds what would not fit into a broadcast any more."""
    before, after = operations.mission, applied(operations, event).mission
    if len(after.targets) + len(after.threats) <= len(before.targets) + len(before.threats):
        return
    frames = frames_for(after)
    if frames > max(MOST_FRAMES, frames_for(before)):
        raise InputError(
            f"{event.event}: {len(after.targets)} targets and {len(after.threats)} threats take {frames} frames; "
            f"allowed: at most {MOST_FRAMES} in a broadcast, by retiring others"
        )


def _undo(operations: Operations, number: int) -> Command | ThingState | Telling:
    for undone in operations.undos:
        if undone.number == number:
            return undone.by
    known = ", ".join(str(undone.number) for undone in operations.undos) or "none"
    raise InputError(f"undo: number: {number}; allowed: the number of one of the last {MOST_UNDOS} commands: {known}")


def _event(operations: Operations, command: Command, head: dict[str, Any]) -> Event:
    """Return the event of a command that is no undo; `head` holds what all events have."""
    match command:
        case AddTarget():
            return TargetAdded(**head, target=_new_target(operations, command), name=command.name)
        case AddThreat():
            return ThreatAdded(**head, threat=_new_threat(operations, command), name=command.name)
        case Change(kind="target"):
            name = command.name or operations.names.get((Kind.TARGET, command.id))
            target = _changed_target(operations, command)
            return TargetChanged(**head, target=target, name=name, moved=command.is_placed)
        case Change():
            name = command.name or operations.names.get((Kind.THREAT, command.id))
            threat = _changed_threat(operations, command)
            return ThreatChanged(**head, threat=threat, name=name, moved=command.is_placed)
        case Retire():
            _thing(operations.mission, command.kind, command.id, "retire")
            if command.kind == "target" and len(operations.mission.targets) == 1:
                raise InputError(
                    f"retire: target {command.id} is the last one; allowed: to retire it after adding another"
                )
            return Retired(**head, kind=command.kind, id=command.id)
        case Pin():
            _check_pin(operations, command)
            return Pinned(**head, agent=command.agent, target=command.target)
        case TakeOut() | PutBack():
            return _out_or_back(operations, command, head)
        case Direct():
            _check_direct(operations, command)
            return Directed(**head, directive=command.directive, agent=command.agent)
        case Pause():
            if operations.orders.paused:
                raise InputError("pause: paused already; allowed: resume")
            return Paused(**head)
        case Resume():
            if not operations.orders.paused:
                raise InputError("resume: not paused; allowed: only in a pause")
            return Resumed(**head)
    raise AssertionError(command)


def _new_target(operations: Operations, command: AddTarget) -> TargetSpec:
    mission = operations.mission
    if len(mission.targets) >= MAX_ITEMS:
        raise InputError(f"add-target: {len(mission.targets)} targets are there; allowed: at most {MAX_ITEMS}")
    waiting = [agent.id for agent in mission.agents if agent.id not in operations.reached.arrived]
    if not mission.queue and len(operations.open_targets) >= len(waiting):
        raise InputError(
            f"add-target: {len(operations.open_targets)} open targets for {len(waiting)} agents that have not arrived; "
            "allowed: no more targets than agents, or `queue: true` in the mission"
        )
    place_ned_m = _place(mission, command, "add-target")
    _check_goal(mission, place_ned_m, "add-target")
    identity = _new_id(operations.used[Kind.TARGET], command.id, "add-target")
    return TargetSpec(
        id=identity, north_m=place_ned_m[0], east_m=place_ned_m[1], speed_bound_m_s=command.speed_bound_m_s
    )


def _new_threat(operations: Operations, command: AddThreat) -> ThreatSpec:
    mission = operations.mission
    if len(mission.threats) >= MAX_ITEMS:
        raise InputError(f"add-threat: {len(mission.threats)} threats are there; allowed: at most {MAX_ITEMS}")
    north_m, east_m = _place(mission, command, "add-threat")
    identity = _new_id(operations.used[Kind.THREAT], command.id, "add-threat")
    given = command.model_dump(
        include={"speed_bound_m_s", "floor_m", "ceiling_m", *_radii_keys(command)}, exclude_none=True
    )
    return _threat({"id": identity, "north_m": north_m, "east_m": east_m, **given}, "add-threat")


def _changed_target(operations: Operations, command: Change) -> TargetSpec:
    mission = operations.mission
    target = _thing(mission, "target", command.id, "change")
    assert isinstance(target, TargetSpec)
    update = command.model_dump(include={"speed_bound_m_s"}, exclude_none=True)
    if command.is_placed:
        place_ned_m = _place(mission, command, "change")
        _check_goal(mission, place_ned_m, "change")
        update |= {"north_m": place_ned_m[0], "east_m": place_ned_m[1]}
    return validated(TargetSpec, {**_free(target, update), **update}, "change")


def _changed_threat(operations: Operations, command: Change) -> ThreatSpec:
    mission = operations.mission
    threat = _thing(mission, "threat", command.id, "change")
    if command.speed_bound_m_s == 0.0 < threat.speed_bound_m_s and not command.is_placed:
        raise InputError(
            "change: speed_bound_m_s: 0 for a threat that may have moved; allowed: with the place where it stands"
        )
    keys = {"speed_bound_m_s", "floor_m", "ceiling_m", *_radii_keys(command)}
    update = command.model_dump(include=keys, exclude_none=True)
    if command.is_placed:
        north_m, east_m = _place(mission, command, "change")
        update |= {"north_m": north_m, "east_m": east_m}
    return _threat({**_free(threat, update), **update}, "change")


def _free(thing: TargetSpec | ThreatSpec, update: Mapping[str, Any]) -> dict[str, Any]:
    """Return a thing's values; one that is moved or has another bound is not bound to the mission's motion any more."""
    values = thing.model_dump()
    if update.keys() & {"north_m", "speed_bound_m_s"}:
        values["motion"] = "static"
    return values


def _threat(values: Mapping[str, Any], source: str) -> ThreatSpec:
    given = dict(values)
    if "radius_m" in given:
        given |= dict(zip(RADII, radii_m(given.pop("radius_m")), strict=True))
    return validated(ThreatSpec, given, source)


def _radii_keys(command: AddThreat | Change) -> tuple[str, ...]:
    return ("radius_m",) if command.radius_m is not None else RADII


def _place(mission: Mission, command: AddTarget | AddThreat | Change, what: str) -> tuple[float, float]:
    """Return the place of a command in m (north, east) on the mission's plane."""
    if command.north_m is not None and command.east_m is not None:
        return command.north_m, command.east_m
    assert command.lat_deg is not None and command.lon_deg is not None
    try:
        return Plane(mission.origin).place_m(Position(command.lat_deg, command.lon_deg), what)
    except ValueError as error:
        raise InputError(str(error)) from error


def _check_goal(mission: Mission, place_ned_m: tuple[float, float], what: str) -> None:
    """Raise InputError where no agent may go."""
    if mission.fence is not None and not inside_polygon(place_ned_m, mission.fence):
        raise InputError(f"{what}: target at {_words(place_ned_m)} is outside the fence; allowed: inside")
    for index, exclusion in enumerate(mission.exclusions):
        if inside_polygon(place_ned_m, exclusion):
            raise InputError(f"{what}: target at {_words(place_ned_m)} is inside exclusions[{index}]; allowed: outside")


def _words(place_ned_m: tuple[float, float]) -> str:
    return f"{place_ned_m[0]:.0f} m north, {place_ned_m[1]:.0f} m east"


def _thing(mission: Mission, kind: ThingKind, identity: int, what: str) -> TargetSpec | ThreatSpec:
    things: tuple[TargetSpec | ThreatSpec, ...] = mission.targets if kind == "target" else mission.threats
    for thing in things:
        if thing.id == identity:
            return thing
    raise InputError(f"{what}: id: no {kind} {identity}; allowed: {ids_in_words(thing.id for thing in things)}")


def _check_agent(mission: Mission, identity: int, what: str) -> None:
    if all(agent.id != identity for agent in mission.agents):
        raise InputError(
            f"{what}: agent: no agent {identity}; allowed: {ids_in_words(agent.id for agent in mission.agents)}"
        )


def _check_pin(operations: Operations, pin: Pin) -> None:
    _check_agent(operations.mission, pin.agent, "pin")
    if pin.target is None:
        if pin.agent not in operations.orders.pins:
            raise InputError(f"pin: agent {pin.agent} is not pinned; allowed: a target to pin it to")
        return
    _thing(operations.mission, "target", pin.target, "pin")
    if pin.target in operations.reached.completed:
        raise InputError(f"pin: target {pin.target} was reached; allowed: {ids_in_words(operations.open_targets)}")


def _check_direct(operations: Operations, direct: Direct) -> None:
    """Raise InputError where a directive for one agent would not be what it does: all are told something stronger."""
    if direct.agent is None:
        return
    _check_agent(operations.mission, direct.agent, "direct")
    orders = operations.orders
    if DIRECTIVES[direct.directive] >= orders.told:
        return
    told = DIRECTIVE_NAMES[orders.told]
    first = "resume" if orders.told > orders.directive else "another directive for all"
    raise InputError(
        f"direct: {direct.directive} for agent {direct.agent}: all agents are told to {told}, which is stronger; "
        f"allowed: first {first}"
    )


def _out_or_back(operations: Operations, command: TakeOut | PutBack, head: dict[str, Any]) -> TakenOut | WasPutBack:
    agent_id, what = command.agent, command.do
    _check_agent(operations.mission, agent_id, what)
    is_out = agent_id in operations.orders.out
    if isinstance(command, TakeOut):
        if is_out:
            raise InputError(f"{what}: agent {agent_id} is taken out already; allowed: to put it back")
        return TakenOut(**head, agent=agent_id)
    if not is_out:
        raise InputError(f"{what}: agent {agent_id} is not taken out; allowed: only after take-out")
    return WasPutBack(**head, agent=agent_id)


def _new_id(used: int, wanted: int | None, what: str) -> int:
    """Return an id that was never used: the one that is wanted, or the next one."""
    if wanted is not None:
        if used >> wanted & 1:
            raise InputError(f"{what}: id: {wanted} was used already; allowed: one never used, or none given")
        return wanted
    following = max(1, used.bit_length())
    if following > MAX_ID:
        free = ~(used | 1)
        following = (free & -free).bit_length() - 1
    if following > MAX_ID:
        raise InputError(f"{what}: all {MAX_ID} ids were used; allowed: a new run with a new store")
    return following
