"""A restart folds the stored events and goes on; what the ground station notices is told once, with its reasons."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.errors import InputError
from companion.mission.model import Mission, parse_mission
from companion.protocol.codec import Detection, DetectionsFrame, FrameWriter, Kind
from groundstation.acceptance import event_of
from groundstation.events import STATION, Assigned, Event, NewTarget, Who, command_from, event_from_json, event_json
from groundstation.ground_station import GroundStation, Resumed
from groundstation.notices import noticed
from groundstation.operations import folded
from groundstation.origins import Observation
from groundstation.places import Places, kept_places
from groundstation.view import Surroundings, picture

TEXT = """
agents:
  - {id: 1, north_m: 0, east_m: 0, heading_deg: 0, speed_m_s: 50}
  - {id: 2, north_m: 0, east_m: 3000, heading_deg: 0, speed_m_s: 50}
  - {id: 3, north_m: 0, east_m: 6000, heading_deg: 0, speed_m_s: 50}
targets: [{id: 1, north_m: 2000, east_m: 0}, {id: 2, north_m: 4000, east_m: 3000}, {id: 3, north_m: 4000, east_m: 6000}]
threats:
  - {id: 1, north_m: 10000, east_m: 4000, detection_radius_m: 900, attack_radius_m: 500, speed_bound_m_s: 10}
  - {id: 2, north_m: -9000, east_m: 4000, detection_radius_m: 900, attack_radius_m: 500}
broadcast_period_s: 1
assignment_period_s: 1
lost_after_s: 8
"""
START_S = 1_790_000_000.0
PERSON = Who(name="anna", role="operator")


def mission(extra: str = "") -> Mission:
    return parse_mission(TEXT + extra, "test")


class Shell:
    """Runs a ground station as the service does: events and pictures are kept, and it may be started again."""

    def __init__(self, given: Mission, sensed: bool = True) -> None:
        self.mission = given
        self.sensed = sensed
        self.stored: list[bytes] = []
        self.kept: bytes = b""
        self.t_s = 0.0
        self.station = self._started()

    def _started(self) -> GroundStation:
        operations = folded(self.mission, map(event_from_json, self.stored)) if self.stored else None
        places: Places | None = kept_places(json.loads(self.kept)) if self.kept else None
        number = 1 if operations is None else (operations.revision or 0) + 1
        resumed = Resumed(revision=number, operations=operations, places=places, began_s=START_S)
        return GroundStation(self.mission, START_S + self.t_s, self.sensed, resumed=resumed)

    def restart(self, after_s: float = 1.0) -> Shell:
        """Kill the ground station and start it again."""
        self.t_s += after_s
        self.station = self._started()
        return self

    def keep(self, event: Event) -> None:
        self.stored.append(event_json(event))
        self.station.adopt(event, START_S + self.t_s)

    def does(self, command: dict[str, Any]) -> bool:
        """Do what a command asks; return whether it was accepted."""
        try:
            event = event_of(self.station.operations, command_from(command), PERSON, START_S + self.t_s)
        except InputError:
            return False
        self.keep(event)
        return True

    def to(self, t_s: float, blind: frozenset[int] = frozenset(), speed_m_s: float = 50.0) -> Shell:
        """Run until a time; the sensor sees all agents on their way north but those in `blind`."""
        while self.t_s < t_s:
            self.t_s += 1.0
            self.see(blind, speed_m_s)
            self.station.tick(START_S + self.t_s)
            for event in noticed(self.station.operations, self.station.facts(), START_S + self.t_s):
                self.keep(event)
            self.kept = json.dumps(picture(self.station, START_S + self.t_s, Surroundings())).encode()
        return self

    def see(self, blind: frozenset[int], speed_m_s: float) -> None:
        seen = tuple(
            Detection(Kind.AGENT, one, speed_m_s * self.t_s, 3000.0 * (one - 1), speed_m_s, 0.0)
            for one in (1, 2, 3)
            if one not in blind
        )
        frame = DetectionsFrame(int(START_S), round(1000 * self.t_s), 47.0, 8.0, seen)
        if self.sensed:
            self.station.sense(FrameWriter().encode(frame), START_S + self.t_s)

    @property
    def events(self) -> list[Event]:
        return [event_from_json(line) for line in self.stored]

    def words(self) -> list[str]:
        """Return the events without their numbers and times, in words."""
        words = []
        for event in self.events:
            if isinstance(event, Assigned):
                words += [f"{one.agent} to {one.target}: {one.reason}" for one in event.changes]
            elif event.event in ("arrived", "arrival-taken-back"):
                words.append(f"{event.event} {event.agent} {event.target}")
            elif event.event in ("lost", "heard-again"):
                words.append(f"{event.event} {event.agent}")
        return words


def test_the_first_assignment_arrivals_and_losses_are_told_once_with_their_reasons() -> None:
    shell = Shell(mission()).to(20.0).to(80.0, blind=frozenset({3}))
    assert shell.words()[:3] == [f"{one} to {one}: the first assignment" for one in (1, 2, 3)]
    assert shell.words()[3:] == [
        "lost 3",
        "3 to None: the agent is lost",
        "arrived 1 1",
        "1 to None: arrived at target 1",
        "arrived 2 2",
        "2 to None: arrived at target 2",
    ]


def test_a_lost_agent_that_is_seen_again_gets_its_target_back() -> None:
    shell = Shell(mission()).to(3.0).to(20.0, blind=frozenset({3})).to(25.0)
    assert shell.words()[3:] == [
        "lost 3",
        "3 to None: the agent is lost",
        "heard-again 3",
        "3 to 3: it had no target",
    ]


@pytest.mark.parametrize("extra", ["", "case: II\n"])
def test_a_restart_goes_on_with_who_has_arrived_who_is_lost_and_every_target(extra: str) -> None:
    shell = Shell(mission(extra), sensed=not extra)
    shell.to(30.0).does({"do": "pin", "agent": 3, "target": 2})
    shell.to(45.0)
    before = shell.station
    after = shell.restart().station
    assert after.operations == before.operations
    assert after.assignment == before.assignment
    assert after.tracks.progress.arrived == before.tracks.progress.arrived != frozenset()
    count = len(shell.stored)
    shell.to(shell.t_s + 3.0)
    assert [event.event for event in shell.events[count:]] == ["revision-began"]


def test_after_a_restart_a_lost_agent_stays_lost_until_it_is_seen() -> None:
    shell = Shell(mission()).to(3.0).to(20.0, blind=frozenset({3})).restart()
    assert shell.station.tracks.progress.lost == {3}
    assert 3 not in shell.to(25.0, blind=frozenset({3})).station.assignment
    assert shell.to(27.0).station.assignment[3] == 3


def test_a_threat_that_a_source_moved_is_after_a_restart_where_it_was_last_seen() -> None:
    shell = Shell(mission()).to(5.0)
    shell.station.observe(Observation(Kind.THREAT, 1, 10080.0 + 4000j, 9 + 0j, START_S + 8.0, 5.0, "adsb"))
    shell.to(10.0).restart(5.0)
    track = shell.station.tracks.tracks[Kind.THREAT, 1]
    assert track.position_ned_m == (10080.0, 4000.0)
    assert track.seen_at_s == START_S + 8.0


def test_a_ghost_goes_on_from_where_it_was_and_its_doubt_from_when_it_was_known() -> None:
    shell = Shell(mission("case: II\n"), sensed=False).to(20.0)
    before = picture(shell.station, START_S + shell.t_s, Surroundings())["agents"][0]
    shown = picture(shell.restart(2.0).station, START_S + shell.t_s, Surroundings())["agents"][0]
    assert shown["north_m"] == pytest.approx(before["north_m"] + 100.0, abs=10.0) != 0.0
    assert shown["age_s"] == pytest.approx(22.0)


def test_who_has_arrived_takes_the_next_target_of_the_queue() -> None:
    given = mission("queue: true\n").model_copy(update={"agents": mission().agents[:1]})
    shell = Shell(given).to(45.0)
    assert shell.words() == [
        "1 to 1: the first assignment",
        "arrived 1 1",
        "1 to 2: arrived at target 1: the next of the queue",
    ]
    assert shell.restart().station.assignment == {1: 2}
    assert shell.station.operations.reached.by == {1: (1,)}


def test_with_a_queue_nobody_who_has_arrived_follows_another_to_the_last_target() -> None:
    shell = Shell(mission("queue: true\n")).to(45.0)
    assert shell.station.tracks.progress.arrived == {1}
    assert shell.station.assignment == {2: 2, 3: 3}
    assert shell.does({"do": "add-target", "north_m": 9000.0, "east_m": 0.0})
    assert shell.station.assignment == {1: 4, 2: 2, 3: 3}


def test_a_reached_target_that_was_retired_by_mistake_is_reached_when_it_is_back() -> None:
    shell = Shell(mission()).to(45.0)
    assert shell.does({"do": "retire", "kind": "target", "id": 1})
    assert shell.does({"do": "undo", "number": shell.events[-1].number})
    count = len(shell.stored)
    shell.to(50.0)
    assert shell.station.tracks.progress.completed == {1}
    assert len(shell.stored) == count


COMMANDS = st.one_of(
    st.builds(
        lambda north, east: {"do": "add-threat", "north_m": north, "east_m": east, "radius_m": 300.0},
        st.floats(-9e3, 9e3),
        st.floats(-9e3, 9e3),
    ),
    st.builds(lambda east: {"do": "add-target", "north_m": 9000.0, "east_m": east}, st.floats(-9e3, 9e3)),
    st.builds(lambda one: {"do": "retire", "kind": "target", "id": one}, st.integers(1, 6)),
    st.builds(lambda one: {"do": "retire", "kind": "threat", "id": one}, st.integers(1, 6)),
    st.builds(lambda a, t: {"do": "pin", "agent": a, "target": t}, st.integers(1, 3), st.none() | st.integers(1, 5)),
    st.builds(lambda a: {"do": "take-out", "agent": a}, st.integers(1, 3)),
    st.builds(lambda a: {"do": "put-back", "agent": a}, st.integers(1, 3)),
    st.sampled_from([{"do": "pause"}, {"do": "resume"}, {"do": "direct", "directive": "hold", "agent": 2}]),
    st.builds(lambda one: {"do": "undo", "number": one}, st.integers(1, 40)),
)


@settings(max_examples=12)
@given(st.lists(COMMANDS | st.just("restart") | st.integers(1, 6), max_size=14), st.sampled_from(["", "case: II\n"]))
def test_whatever_is_done_a_restart_changes_nobodys_target_and_every_change_has_a_reason(
    steps: list[Any], extra: str
) -> None:
    shell = Shell(mission(f"queue: true\n{extra}"), sensed=not extra).to(1.0)
    for step in steps:
        if step == "restart":
            before = shell.station
            after = shell.restart().station
            assert after.operations == before.operations
            assert dict(after.assignment) == dict(after.operations.assignment)
        elif isinstance(step, int):
            shell.to(shell.t_s + step)
        else:
            shell.does(step)
            shell.to(shell.t_s + 1.0)
    assert shell.station.unsendable.count == 0
    targets: dict[int, int | None] = {}
    for event in shell.events:
        if isinstance(event, Assigned):
            targets |= {change.agent: change.target for change in event.changes}
    assert {agent: target for agent, target in targets.items() if target} == shell.station.operations.assignment
    assert [event.number for event in shell.events] == list(range(1, len(shell.stored) + 1))


def test_one_new_target_sends_one_of_those_who_have_arrived() -> None:
    shell = Shell(mission("queue: true\n")).to(90.0)
    assert shell.station.tracks.progress.arrived == {1, 2, 3}
    assert shell.does({"do": "add-target", "north_m": 4500.0, "east_m": 6000.0})
    assert list(shell.station.assignment.values()) == [4]


def test_until_an_agent_is_seen_after_a_restart_nobody_gets_another_target() -> None:
    swapped = tuple(NewTarget(agent=one, target=target, reason="as it was") for one, target in ((1, 3), (2, 2), (3, 1)))
    shell = Shell(mission())
    shell.keep(Assigned(number=1, unix_s=START_S, who=STATION, changes=swapped))
    shell.restart().to(6.0, blind=frozenset({2}))
    assert shell.station.assignment == {1: 3, 2: 2, 3: 1}
    assert shell.to(7.0).station.assignment == {1: 1, 2: 2, 3: 3}


@pytest.mark.parametrize("sensed", [False, True])
def test_nobody_that_was_never_seen_arrives_where_the_mission_has_it(sensed: bool) -> None:
    shell = Shell(mission("queue: true\n"), sensed=sensed)
    nobody = frozenset({1, 2, 3})
    shell.to(2.0, blind=nobody)
    assert shell.does({"do": "add-target", "north_m": 0.0, "east_m": 6000.0})
    shell.to(4.0, blind=nobody)
    assert not any(words.startswith("arrived") for words in shell.words())
    assert not any(words.startswith("arrived") for words in shell.restart().to(7.0, blind=nobody).words())


def agents_of(shell: Shell) -> list[tuple[float, str]]:
    """Return age and source of each agent in the picture."""
    shown = picture(shell.station, START_S + shell.t_s, Surroundings())
    return [(agent["age_s"], agent["source"]) for agent in shown["agents"]]


def test_the_ages_of_agents_that_nobody_sees_go_on_over_restarts() -> None:
    shell = Shell(mission())
    shell.to(1.0, blind=frozenset({1})).to(7.0, blind=frozenset({1, 2}))
    assert agents_of(shell) == [(7.0, "mission"), (6.0, "reckoned"), (0.0, "sensor")]
    shell.restart(after_s=4.0)
    assert agents_of(shell) == [(11.0, "mission"), (10.0, "reckoned"), (4.0, "reckoned")]
    assert agents_of(shell.restart(after_s=1.0)) == [(12.0, "mission"), (11.0, "reckoned"), (5.0, "reckoned")]


def test_an_agent_is_lost_after_the_same_silence_whether_the_station_was_restarted_or_not() -> None:
    shell = Shell(mission()).to(5.0)
    for _ in range(2):
        shell.to(shell.t_s + 3.0, blind=frozenset({3}))
        shell.restart(after_s=0.0)
    assert "lost 3" not in shell.words()
    assert "lost 3" in shell.to(14.0, blind=frozenset({3})).words()
