"""The desk: commands become events, in order, each kept before it is obeyed, and each answered."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from concurrent.futures import Future
from typing import Any

import pytest

from companion.mission.model import Mission, parse_mission
from companion.protocol.messages import Directive, Kind
from groundstation.desk import ANSWER_S, MOST_AT_ONCE, MOST_WAITING, Desk, Fact, begin_day
from groundstation.events import AddThreat, Direct, Event, Pause, TakeOut, ThreatAdded, TrackBegan, Undo, Who
from groundstation.ground_station import GroundStation, Resumed
from groundstation.store.chapters import beginning
from groundstation.store.rows import EventRow

START_S = 1_790_000_000.0
ANNA = Who(name="anna", role="operator")
SMALL = """
name: small
agents: [{id: 1, north_m: 0, east_m: 0}, {id: 2, north_m: 0, east_m: 5000}]
targets: [{id: 1, north_m: 20000, east_m: 0}, {id: 2, north_m: 20000, east_m: 9000}]
threats: [{id: 1, north_m: 10000, east_m: 0, detection_radius_m: 3000, attack_radius_m: 1000, speed_bound_m_s: 10}]
"""


class Disk:
    """Takes events when the test lets it."""

    def __init__(self) -> None:
        self.rows: list[EventRow] = []
        self.open = True
        self._waiting: list[tuple[list[EventRow], Future[None]]] = []

    def append(self, events: Iterable[EventRow]) -> Future[None]:
        future: Future[None] = Future()
        self._waiting.append((list(events), future))
        if self.open:
            self.take()
        return future

    def note(self, events: Iterable[EventRow]) -> None:
        self.rows += events

    def take(self) -> None:
        for rows, future in self._waiting:
            self.rows += rows
            future.set_result(None)
        self._waiting.clear()

    def fail(self) -> None:
        for _, future in self._waiting:
            future.set_exception(OSError(28, "No space left on device"))
        self._waiting.clear()


class Screen:
    """Keeps what was shown and answered."""

    def __init__(self) -> None:
        self.shown: list[int] = []
        self.answers: dict[int, Any] = {}

    def publish(self, message: Mapping[str, Any]) -> None:
        self.shown.append(message["event"]["number"])

    def reply(self, identity: int, event: Mapping[str, Any]) -> None:
        self.answers[identity] = event["event"]

    def refuse(self, identity: int, why: str) -> None:
        self.answers[identity] = why


class Day:
    """A ground station with a desk, and a disk of the test's."""

    def __init__(self) -> None:
        self.station = GroundStation(mission(), START_S)
        self.disk = Disk()
        self.screen = Screen()
        self.desk = Desk(self.station, self.disk, self.screen)


def mission() -> Mission:
    return parse_mission(SMALL, "small")


@pytest.fixture
def day() -> Day:
    return Day()


def test_a_command_is_kept_obeyed_shown_and_answered_in_one_tick_of_a_fast_disk(day: Day) -> None:
    day.desk.ask_data({"do": "take-out", "agent": 1}, ANNA, 7)
    day.desk.tick(START_S)
    assert day.screen.answers == {7: "taken-out"}
    assert day.screen.shown == [1]
    assert [row.event for row in day.disk.rows] == ["taken-out"]
    assert day.station.operations.orders.out == {1}


def test_nothing_is_obeyed_before_the_disk_has_it(day: Day) -> None:
    day.disk.open = False
    day.desk.ask(TakeOut(do="take-out", agent=1), ANNA, 1)
    for tick in range(3):
        day.desk.tick(START_S + tick)
    assert day.station.operations.orders.out == set()
    assert day.screen.answers == {}
    day.disk.take()
    day.desk.tick(START_S + 3.0)
    assert day.station.operations.orders.out == {1}


def test_what_the_disk_refuses_changes_nothing_and_its_number_is_given_again(day: Day) -> None:
    day.disk.open = False
    day.desk.ask(TakeOut(do="take-out", agent=1), ANNA, 1)
    day.desk.tick(START_S)
    day.disk.fail()
    day.desk.tick(START_S)
    assert day.screen.answers[1] == "the disk does not take it: No space left on device; nothing was changed"
    assert day.station.operations.orders.out == set()
    day.disk.open = True
    day.desk.ask(TakeOut(do="take-out", agent=2), ANNA, 2)
    day.desk.tick(START_S)
    assert day.disk.rows[-1].number == 1


def test_commands_of_one_tick_are_judged_one_after_the_other(day: Day) -> None:
    for request in (1, 2):
        day.desk.ask(TakeOut(do="take-out", agent=1), ANNA, request)
    day.desk.ask(Undo(do="undo", number=1), ANNA, 3)
    day.desk.tick(START_S)
    assert day.screen.answers[1] == "taken-out"
    assert "agent 1" in day.screen.answers[2]
    assert day.screen.answers[3] == "put-back"
    assert [row.number for row in day.disk.rows] == [1, 2]
    assert day.station.operations.orders.out == set()


@pytest.mark.parametrize("data", [None, [], {"do": "fly"}, {"do": "take-out", "agent": 99}])
def test_what_is_no_command_or_not_possible_is_refused_with_the_reason(day: Day, data: object) -> None:
    day.desk.ask_data(data, ANNA, 5)
    day.desk.tick(START_S)
    assert "allowed" in day.screen.answers[5]
    assert day.disk.rows == []


def test_more_commands_than_can_wait_are_refused(day: Day) -> None:
    day.disk.open = False
    for request in range(MOST_WAITING + 1):
        day.desk.ask(Pause(do="pause"), ANNA, request)
    assert list(day.screen.answers) == [MOST_WAITING]


def test_a_restart_goes_on_with_what_the_events_have_made_and_with_their_numbers(day: Day) -> None:
    begin_day(day.desk, day.station, (), START_S)
    day.desk.ask(TakeOut(do="take-out", agent=1), ANNA)
    day.desk.tick(START_S)
    kept = dict([beginning(mission(), {}, ()).chapter.kept])
    operations = beginning(mission(), kept, day.disk.rows).operations
    again = GroundStation(mission(), START_S + 9.0, resumed=Resumed(operations=operations))
    assert again.operations == day.station.operations
    assert again.assignment == {2: 2} == day.station.assignment


def test_a_disk_that_does_not_answer_refuses_a_command_that_it_has_not_begun_to_write(day: Day) -> None:
    day.disk.open = False
    day.desk.ask(Pause(do="pause"), ANNA, 1)
    day.desk.tick(START_S)
    day.desk.tick(START_S + ANSWER_S)
    assert 1 not in day.screen.answers
    day.desk.tick(START_S + ANSWER_S + 0.1)
    assert day.screen.answers[1] == "the disk does not answer; nothing was changed"
    assert day.desk.is_idle
    assert not day.station.operations.orders.paused


def test_a_directive_that_an_older_state_kept_becomes_an_event(day: Day) -> None:
    begin_day(day.desk, day.station, [Direct(do="direct", directive="hold")], START_S)
    assert day.station.directive is Directive.HOLD
    assert [row.event for row in day.disk.rows] == ["started", "directed"]


def test_what_happens_by_itself_is_kept_once_and_shown() -> None:
    day = Day()
    day.station.tick(START_S)
    for _ in range(3):
        day.desk.notice(START_S)
    assert [row.event for row in day.disk.rows] == ["assigned", "revision-began"]
    assert day.screen.shown == [1, 2]


def test_what_follows_from_a_sources_command_is_kept_with_it_or_not_at_all() -> None:
    disk = Disk()
    disk.open = False
    station = GroundStation(parse_mission(SMALL, "small"), START_S)
    desk = Desk(station, disk)
    radar, answers = Who(name="radar", role="source"), list[Any]()
    wanted = AddThreat(do="add-threat", north_m=9.0e4, east_m=0.0, radius_m=500.0)

    def facts(event: Event) -> list[Fact]:
        assert isinstance(event, ThreatAdded)
        identity = event.threat.id
        return [
            lambda number, unix_s: TrackBegan(
                number=number, unix_s=unix_s, who=radar, source="radar", key="A", kind="threat", id=identity
            )
        ]

    desk.ask_with(wanted, radar, facts, answers.append)
    desk.tick(START_S)
    disk.fail()
    desk.tick(START_S + 1.0)
    assert (disk.rows, station.operations.tracks) == ([], {})
    assert "No space left" in str(answers.pop())
    desk.ask_with(wanted, radar, facts, answers.append)
    desk.tick(START_S + 2.0)
    disk.take()
    desk.tick(START_S + 3.0)
    assert [row.event for row in disk.rows] == ["threat-added", "track-began"]
    assert station.operations.tracks == {("radar", "A"): (Kind.THREAT, 2)}
    assert answers == [answers[0]] and answers[0].event == "threat-added"


def test_a_flood_of_commands_is_obeyed_a_few_in_each_tick_and_in_order(day: Day) -> None:
    for request in range(2 * MOST_AT_ONCE + 1):
        day.desk.ask_data({"do": "pin", "agent": 1, "target": 1 + request % 2}, ANNA, request)
    obeyed = []
    for tick in range(3):
        day.desk.tick(START_S + tick)
        obeyed.append(len(day.screen.answers))
    assert obeyed == [MOST_AT_ONCE, 2 * MOST_AT_ONCE, 2 * MOST_AT_ONCE + 1]
    assert list(day.screen.answers) == list(range(2 * MOST_AT_ONCE + 1))
