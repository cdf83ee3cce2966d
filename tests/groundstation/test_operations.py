"""Commands, events and the operations that they fold to: the same live and after a restart."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.errors import InputError, printable
from companion.files.yaml import dump_yaml
from companion.mission.model import Mission, parse_mission
from companion.mission.sources import SourceSpec
from companion.protocol.messages import Directive, Kind
from groundstation.acceptance import event_of
from groundstation.broadcast import MOST_FRAMES
from groundstation.events import (
    STATION,
    Event,
    TargetAdded,
    ThreatAdded,
    Who,
    command_from,
    event_from_json,
    event_json,
)
from groundstation.operations import Operations, applied, folded

MISSION = parse_mission(
    """
name: fields
queue: true
fence: [[-20000, -20000], [-20000, 20000], [20000, 20000], [20000, -20000]]
agents:
  - {id: 1, north_m: 0, east_m: 0, heading_deg: 0}
  - {id: 2, north_m: 0, east_m: 500, heading_deg: 0}
targets:
  - {id: 1, north_m: 9000, east_m: 0}
  - {id: 3, north_m: 9000, east_m: 4000}
threats:
  - {id: 4, north_m: 4000, east_m: 4000, detection_radius_m: 900, attack_radius_m: 500, speed_bound_m_s: 5}
""",
    "test",
)
PERSON = Who(name="anna", role="operator")
START_S = 1.0e9


def does(operations: Operations, *commands: dict[str, Any]) -> Operations:
    """Return the operations after commands."""
    for data in commands:
        operations = applied(operations, event_of(operations, command_from(data), PERSON, START_S))
    return operations


def refusal(operations: Operations, command: dict[str, Any]) -> str:
    """Return why a command is refused."""
    with pytest.raises(InputError) as caught:
        event_of(operations, command_from(command), PERSON, START_S)
    return str(caught.value)


def test_a_threat_added_in_degrees_stands_on_the_missions_plane() -> None:
    operations = does(
        Operations.begun(MISSION),
        {"do": "add-threat", "lat_deg": 47.01, "lon_deg": 8.0, "radius_m": 300.0, "name": "crane"},
    )
    threat = operations.mission.threats[-1]
    assert threat.id == 5
    assert threat.position_ned_m == pytest.approx((1111.8, 0.0), abs=1.0)
    assert threat.detection_radius_m == 300.0
    assert operations.names == {(Kind.THREAT, 5): "crane"}


def test_an_id_is_never_used_twice() -> None:
    operations = does(Operations.begun(MISSION), {"do": "retire", "kind": "threat", "id": 4})
    add = {"do": "add-threat", "north_m": 0.0, "east_m": 0.0, "radius_m": 100.0}
    assert does(operations, add).mission.threats[-1].id == 5
    assert "used already" in refusal(operations, {**add, "id": 4})


def test_the_stricter_of_an_agents_own_directive_and_that_of_all_holds() -> None:
    operations = does(
        Operations.begun(MISSION),
        {"do": "direct", "directive": "hold"},
        {"do": "direct", "directive": "return", "agent": 2},
    )
    assert operations.orders.of(1) is Directive.HOLD
    assert operations.orders.of(2) is Directive.RETURN


def test_a_pause_lets_all_hold_and_resuming_gives_back_what_was_told() -> None:
    returning = does(Operations.begun(MISSION), {"do": "direct", "directive": "return", "agent": 1})
    paused = does(returning, {"do": "pause"})
    assert (paused.orders.of(1), paused.orders.of(2)) == (Directive.RETURN, Directive.HOLD)
    assert does(paused, {"do": "resume"}).orders == returning.orders


def test_normal_for_all_lets_every_agent_go_on_and_its_undo_gives_back_what_single_ones_were_told() -> None:
    alone = {"do": "direct", "directive": "return", "agent": 2}
    told = does(Operations.begun(MISSION), alone, {"do": "direct", "directive": "hold"})
    normal = does(told, {"do": "direct", "directive": "normal"})
    assert [normal.orders.of(one) for one in (1, 2)] == [Directive.NORMAL, Directive.NORMAL]
    assert does(normal, {"do": "undo", "number": 3}).orders == told.orders
    later = does(normal, {**alone, "directive": "hold"}, {"do": "undo", "number": 3})
    assert later.orders.own == {2: Directive.HOLD}


def test_undoing_a_hold_for_all_leaves_what_single_agents_were_told_since() -> None:
    operations = does(
        Operations.begun(MISSION),
        {"do": "direct", "directive": "hold"},
        {"do": "direct", "directive": "return", "agent": 2},
        {"do": "undo", "number": 1},
    )
    assert (operations.orders.of(1), operations.orders.of(2)) == (Directive.NORMAL, Directive.RETURN)


@pytest.mark.parametrize(
    ("first", "directive", "words"),
    [
        ({"do": "direct", "directive": "hold"}, "normal", "all agents are told to hold, which is stronger"),
        ({"do": "direct", "directive": "return"}, "hold", "all agents are told to return, which is stronger"),
        ({"do": "pause"}, "normal", "all agents are told to hold, which is stronger; allowed: first resume"),
    ],
)
def test_a_directive_for_one_agent_that_would_not_be_what_it_does_is_refused(
    first: dict[str, Any], directive: str, words: str
) -> None:
    operations = does(Operations.begun(MISSION), first)
    assert words in refusal(operations, {"do": "direct", "directive": directive, "agent": 1})
    # What was told to it alone is taken back all the same.
    alone = does(Operations.begun(MISSION), {"do": "direct", "directive": "return", "agent": 1}, first)
    assert does(alone, {"do": "undo", "number": 1}).orders == operations.orders


def test_undoing_the_last_again_and_again_walks_back_to_the_beginning() -> None:
    begun = Operations.begun(MISSION)
    operations = does(begun, *({"do": "direct", "directive": to} for to in ("hold", "return", "hold")), {"do": "pause"})
    for left in range(4, 0, -1):
        assert len(operations.undoable) == left
        operations = does(operations, {"do": "undo", "number": operations.undoable[-1]})
    assert operations.undoable == []
    assert operations.orders == begun.orders
    # By its number an undo is taken back as well, and what it took back is then in force and offered.
    again = does(operations, {"do": "undo", "number": 8})
    assert again.orders.told is Directive.HOLD
    assert again.undoable == [9]


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ({"do": "retire", "kind": "threat", "id": 9}, "no threat 9; allowed: 4"),
        ({"do": "pin", "agent": 7, "target": 1}, "no agent 7; allowed: 1, 2"),
        ({"do": "pin", "agent": 1, "target": None}, "not pinned"),
        ({"do": "put-back", "agent": 1}, "not taken out"),
        ({"do": "resume"}, "not paused"),
        ({"do": "undo", "number": 3}, "allowed: the number of one of the last 50 commands: none"),
        ({"do": "add-target", "north_m": 30000.0, "east_m": 0.0}, "outside the fence"),
        ({"do": "add-target", "lat_deg": -47.0, "lon_deg": 8.0}, "km from the origin"),
        ({"do": "change", "kind": "threat", "id": 4, "attack_radius_m": 950.0}, "less than detection_radius_m"),
        ({"do": "change", "kind": "threat", "id": 4, "speed_bound_m_s": 900.0}, "speed_bound_m_s: 900"),
        ({"do": "change", "kind": "threat", "id": 4, "speed_bound_m_s": 0.0}, "with the place where it stands"),
    ],
)
def test_what_cannot_be_is_refused_with_what_is_allowed(command: dict[str, Any], words: str) -> None:
    assert words in refusal(Operations.begun(MISSION), command)


def test_without_a_queue_no_target_is_added_that_nobody_could_go_to() -> None:
    operations = Operations.begun(MISSION.model_copy(update={"queue": False}))
    assert "2 open targets for 2 agents" in refusal(operations, {"do": "add-target", "north_m": 1.0, "east_m": 1.0})


def test_no_more_threats_are_added_than_a_broadcast_can_tell() -> None:
    operations = Operations.begun(MISSION)
    threats = tuple(
        MISSION.threats[0].model_copy(update={"id": identity}) for identity in range(1, 4 * (MOST_FRAMES - 1) + 1)
    )
    used = {**operations.used, Kind.THREAT: 1 << 1016}
    full = replace(operations, mission=MISSION.model_copy(update={"threats": threats}), used=used)
    add = {"do": "add-threat", "north_m": 0.0, "east_m": 0.0, "radius_m": 100.0}
    assert "take 256 frames; allowed: at most 255" in refusal(full, add)
    assert does(full, {"do": "retire", "kind": "threat", "id": 9}, add).mission.threats[-1].id == 1017


IDS = st.integers(1, 8)
PLACE = st.fixed_dictionaries({"north_m": st.floats(-1.9e4, 1.9e4), "east_m": st.floats(-1.9e4, 1.9e4)})
NAME = st.fixed_dictionaries({}, optional={"name": st.sampled_from(("a", "b"))})
RADII = st.fixed_dictionaries({"radius_m": st.floats(1.0, 1e4)})
THING = st.fixed_dictionaries({"kind": st.sampled_from(("target", "threat")), "id": IDS})
AGENT = st.fixed_dictionaries({"agent": IDS})


def _command(word: str, *parts: st.SearchStrategy[dict[str, Any]]) -> st.SearchStrategy[dict[str, Any]]:
    return st.tuples(*parts).map(lambda given: {"do": word} | {key: one[key] for one in given for key in one})


COMMANDS = st.one_of(
    _command("add-target", PLACE, NAME),
    _command("add-threat", PLACE, RADII, NAME),
    _command("change", THING, PLACE, NAME),
    _command("retire", THING),
    _command("pin", AGENT, st.fixed_dictionaries({"target": st.none() | IDS})),
    _command("take-out", AGENT),
    _command("put-back", AGENT),
    _command("direct", st.fixed_dictionaries({"directive": st.sampled_from(("normal", "hold", "return"))}), AGENT),
    _command("direct", st.fixed_dictionaries({"directive": st.sampled_from(("normal", "hold", "return"))})),
    _command("pause"),
    _command("resume"),
    _command("undo", st.fixed_dictionaries({"number": st.integers(1, 30)})),
)


def accepted(commands: list[dict[str, Any]], mission: Mission = MISSION) -> tuple[Operations, list[Event]]:
    """Return the operations after the commands that are accepted, and their events."""
    operations = Operations.begun(mission)
    events: list[Event] = []
    for data in commands:
        try:
            event = event_of(operations, command_from(data), PERSON, START_S + len(events))
        except InputError:
            continue
        operations = applied(operations, event)
        events.append(event)
    return operations, events


@settings(max_examples=40)
@given(st.lists(COMMANDS, max_size=30))
def test_stored_events_fold_to_what_the_run_had(commands: list[dict[str, Any]]) -> None:
    operations, events = accepted(commands)
    stored = [event_from_json(event_json(event)) for event in events]
    assert stored == events
    assert folded(MISSION, stored) == operations
    assert [event.number for event in events] == list(range(1, len(events) + 1))


@settings(max_examples=40)
@given(st.lists(COMMANDS, max_size=20), COMMANDS)
def test_undo_restores_what_was_before(commands: list[dict[str, Any]], last: dict[str, Any]) -> None:
    before, events = accepted(commands)
    after, more = accepted([*commands, last])
    if len(more) == len(events) or last["do"] == "undo":
        return
    undone = does(after, {"do": "undo", "number": more[-1].number})
    for things in ("targets", "threats"):
        had, has = (sorted(getattr(one.mission, things), key=lambda thing: thing.id) for one in (before, undone))
        assert has == had
    for part in ("names", "placed_s", "orders", "reached", "assignment", "tracks"):
        assert getattr(undone, part) == getattr(before, part), part


@settings(max_examples=40)
@given(st.lists(COMMANDS, max_size=30))
def test_no_thing_added_has_an_id_that_another_had(commands: list[dict[str, Any]]) -> None:
    ids = {Kind.TARGET: [1, 3], Kind.THREAT: [4]}
    for event in accepted(commands)[1]:
        if isinstance(event, TargetAdded):
            ids[Kind.TARGET].append(event.target.id)
        elif isinstance(event, ThreatAdded):
            ids[Kind.THREAT].append(event.threat.id)
    assert all(len(set(given)) == len(given) for given in ids.values())


def test_what_sources_do_is_not_undone_by_an_operator() -> None:
    operations = Operations.begun(MISSION)
    add = command_from({"do": "add-threat", "north_m": 0.0, "east_m": 0.0, "radius_m": 100.0})
    operations = applied(operations, event_of(operations, add, STATION, START_S))
    assert "none" in refusal(operations, {"do": "undo", "number": 1})


def test_a_target_that_was_retired_by_mistake_is_back_with_its_name_and_its_pins() -> None:
    before = does(
        Operations.begun(MISSION),
        {"do": "change", "kind": "target", "id": 3, "name": "mast"},
        {"do": "pin", "agent": 2, "target": 3},
    )
    retired = does(before, {"do": "retire", "kind": "target", "id": 3})
    assert retired.orders.pins == {}
    back = does(retired, {"do": "undo", "number": 3})
    assert back.orders.pins == {2: 3}
    assert back.names == {(Kind.TARGET, 3): "mast"}


@given(st.text(max_size=50))
def test_a_name_that_is_typed_is_taken_as_it_is_or_refused_where_a_terminal_would_show_another(name: str) -> None:
    is_plain = name.isprintable() and bool(name.strip()) and len(name) <= 40
    given = {"do": "add-threat", "north_m": 0, "east_m": 0, "radius_m": 5, "name": name}
    for refused in (
        lambda: command_from(given),
        lambda: parse_mission(dump_yaml({"name": name, "agents": [{"id": 1}], "targets": [{"id": 1}]}), "m"),
        lambda: SourceSpec(name=name, kind="ais", file="x", radius_m=5.0),
        lambda: SourceSpec(name="x", kind="ais", file="x", radius_m=5.0, ids={name: 1}),
    ):
        try:
            refused()
        except (InputError, ValueError) as error:
            assert not is_plain
            assert not isinstance(error, InputError) or printable(str(error)).startswith(("command", "m: "))
        else:
            assert name.isprintable() and name.strip()


@given(st.text(min_size=1, max_size=40))
def test_a_name_of_an_older_store_is_read_with_what_cannot_be_printed_replaced(name: str) -> None:
    line = json.dumps({"event": "retired", "number": 1, "unix_s": 0.0, "who": {"name": name, "role": "operator"},
                       "kind": "threat", "id": 1})  # fmt: skip
    read = event_from_json(line)
    assert read.who.name.isprintable()
    assert read.who.name == name or not name.isprintable() or not name.strip()


def test_the_number_of_an_event_is_one_that_every_json_reader_keeps() -> None:
    with pytest.raises(InputError, match="number: 18446744073709551616; allowed: less than or equal to"):
        command_from({"do": "undo", "number": 2**64})
