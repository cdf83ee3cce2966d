"""A restart: what a run finds in its store, from the events and the last picture that the run before left."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from companion.errors import InputError
from companion.mission.model import parse_mission
from companion.protocol.messages import Directive, Kind
from groundstation.desk import Desk as DeskOf
from groundstation.desk import begin_day, row_of
from groundstation.events import Command, Direct, Pause, Pin, Resume, Retire, TakeOut, Who
from groundstation.ground_station import GroundStation, Resumed
from groundstation.notices import noticed
from groundstation.resumption import resumption
from groundstation.saved_state import KEPT_AS, SavedState, text_of
from groundstation.store.chapters import event_of_row
from groundstation.store.database import Database
from groundstation.store.event_store import EventStore
from groundstation.store.recorder import Recorder
from groundstation.store.rows import Batch, EventRow
from groundstation.view import Surroundings, picture
from tests.groundstation.store.recorded import MISSION, NOW_S, mission
from tests.groundstation.store.test_event_store import Disk

ANNA = Who(name="anna", role="operator")


class Run:
    """One run of a ground station with its store, whose disk works at once."""

    def __init__(self, path: Path, start_s: float, text: str = MISSION, new_flight: bool = False) -> None:
        flown = parse_mission(text, "kept")
        self.found = resumption(path, flown, new_flight)
        self.disk = Disk()
        self.store = EventStore(path, self.found.database, self.disk, 1_000_000)
        resumed = Resumed(int(start_s), operations=self.found.begun.operations, places=self.found.places)
        self.station = GroundStation(flown, start_s, resumed=resumed)
        self.desk = DeskOf(self.station, self.store)
        self.store.keep(*self.found.begun.chapter.kept)
        begin_day(self.desk, self.station, self.found.orders, start_s)
        self.tick(start_s)

    def tick(self, now_s: float) -> None:
        self.desk.tick(now_s)
        self.disk.work()
        self.desk.tick(now_s)
        self.station.advance(now_s)
        self.desk.note(noticed(self.station.operations, self.station.facts(), now_s), now_s)
        Recorder(self.store, None).publish(picture(self.station, now_s, Surroundings()))
        self.disk.work()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return a store whose run was killed 20 s after its start: pinned, and a threat retired."""
    run = Run(tmp_path / "x.state", NOW_S)
    run.desk.ask(Pin(do="pin", agent=2, target=7), ANNA)
    run.desk.ask(Retire(do="retire", kind="threat", id=4), ANNA)
    run.tick(NOW_S + 10.0)
    run.tick(NOW_S + 20.0)
    return tmp_path / "x.state"


def kinds(path: Path) -> list[str]:
    reader = Database.read_only(path)
    found = [row.event for row in reader.events()]
    reader.close()
    return found


def test_after_a_kill_nobody_has_another_target_and_nothing_is_told_twice(path: Path) -> None:
    before = kinds(path)
    assert before[:2] == ["started", "assigned"]
    again = Run(path, NOW_S + 30.0)
    assert again.station.operations.orders.pins == {2: 7}
    assert again.station.mission.threats == ()
    again.tick(NOW_S + 31.0)
    assert kinds(path)[len(before) :] == ["started"]


def test_the_assignment_before_the_kill_is_the_one_after_it(path: Path) -> None:
    again = Run(path, NOW_S + 30.0)
    assert dict(again.station.assignment) == dict(again.found.begun.operations.assignment)
    assert again.station.assignment[2] == 7


def test_places_go_on_from_the_last_picture(path: Path) -> None:
    places = resumption(path, mission()).places
    assert places is not None
    assert places.at_s == NOW_S + 20.0
    assert (Kind.AGENT, 1) in places.tracks


def test_another_mission_begins_at_its_own_places_and_says_what_is_left_behind(path: Path) -> None:
    other = Run(path, NOW_S + 30.0, MISSION.replace("12000, east_m: 0", "11000, east_m: 0"))
    assert other.found.places is None
    assert other.station.operations.orders.pins == {}
    (warning,) = other.found.begun.warnings
    assert warning.startswith("targets of kept differ from the last run's: ")
    numbers = [int(row.number) for row in Database.read_only(path).events()]
    assert numbers == sorted(set(numbers))


def test_a_new_flight_forgets_the_directive_and_when_threats_were_where_but_no_epoch(path: Path) -> None:
    state = SavedState(int(NOW_S), 7, "digest", NOW_S, Directive.HOLD, 3)
    database = Database.opened(path)
    database.write(Batch(kept={KEPT_AS: text_of(state)}))
    database.close()
    anew = Run(path, NOW_S + 30.0, new_flight=True)
    assert anew.found.last is not None
    assert (anew.found.last.epoch_s, anew.found.last.signing_timestamp) == (int(NOW_S), 7)
    assert (anew.found.last.threats, anew.station.directive) == ("", Directive.NORMAL)
    assert anew.station.operations.orders.pins == {}


@pytest.mark.parametrize("command", [Direct(do="direct", directive="hold"), Pause(do="pause")])
def test_an_order_that_was_acknowledged_holds_though_the_kept_state_is_older(path: Path, command: Command) -> None:
    database = Database.opened(path)
    state = SavedState(int(NOW_S), 0, "", NOW_S, Directive.NORMAL, 1)
    database.write(Batch(kept={KEPT_AS: text_of(state)}))
    database.close()
    run = Run(path, NOW_S + 30.0)
    run.desk.ask(command, ANNA)
    run.tick(NOW_S + 31.0)
    before = kinds(path)
    assert Run(path, NOW_S + 40.0).station.directive is Directive.HOLD
    assert kinds(path)[len(before) :] == ["started"]
    other = MISSION.replace("12000, east_m: 0", "11000, east_m: 0")
    assert Run(path, NOW_S + 50.0, other).station.directive is Directive.HOLD
    assert Run(path, NOW_S + 60.0, other, new_flight=True).station.directive is Directive.NORMAL


def test_a_pause_over_a_restart_ends_as_it_would_have(path: Path) -> None:
    run = Run(path, NOW_S + 30.0)
    run.desk.ask(Pause(do="pause"), ANNA)
    run.tick(NOW_S + 31.0)
    again = Run(path, NOW_S + 40.0)
    again.desk.ask(Resume(do="resume"), ANNA)
    again.tick(NOW_S + 41.0)
    assert again.station.directive is Directive.NORMAL


def test_orders_for_agents_that_are_still_there_go_on_over_an_edited_mission_and_the_rest_is_named(path: Path) -> None:
    run = Run(path, NOW_S + 30.0)
    run.desk.ask(TakeOut(do="take-out", agent=1), ANNA)
    run.desk.ask(Direct(do="direct", directive="hold", agent=2), ANNA)
    run.desk.ask(Direct(do="direct", directive="return"), ANNA)
    run.desk.ask(Pause(do="pause"), ANNA)
    run.tick(NOW_S + 31.0)
    run.tick(NOW_S + 32.0)
    before = run.station.operations.orders
    edited = MISSION.replace("12000, east_m: 0", "11000, east_m: 0")
    other = Run(path, NOW_S + 40.0, edited)
    assert other.station.operations.orders == replace(before, pins={})
    (warning,) = other.found.begun.warnings
    for words in (
        "left behind: the pins of agents 2; what was added, changed or retired: threats 4; the places",
        "goes on: agent 1 taken out, directive hold for agent 2, directive return for all, the pause",
    ):
        assert words in warning
    # Another restart goes on with what this one has kept, and a pause is one that can be ended.
    again = Run(path, NOW_S + 50.0, edited)
    assert again.station.operations.orders == other.station.operations.orders
    again.desk.ask(Resume(do="resume"), ANNA)
    again.tick(NOW_S + 51.0)
    assert not again.station.operations.orders.paused
    alone = edited.replace("{id: 1, north_m: 0, east_m: 0}, ", "")
    assert Run(path, NOW_S + 60.0, alone).found.begun.warnings[0].count("of agents that are gone: 1;") == 1


def test_a_store_with_an_event_of_a_later_release_is_refused_in_one_line(path: Path) -> None:
    database = Database.opened(path)
    database.write(Batch((EventRow(99, NOW_S, "x", "unheard-of", "{}"),)))
    database.close()
    with pytest.raises(
        InputError, match="x.state: event 99, 'unheard-of', is not understood by this release; allowed: "
    ):
        resumption(path, mission())


def test_the_rows_of_a_run_are_its_events(path: Path) -> None:
    reader = Database.read_only(path)
    rows = list(reader.events())
    reader.close()
    assert [row_of(event_of_row(row)) for row in rows] == rows


def test_a_page_is_given_the_events_of_the_flight_that_goes_on(path: Path) -> None:
    found = resumption(path, mission())
    assert [row.number for row in found.told] == list(range(1, found.begun.operations.next_number))
    assert resumption(path, mission(), new_flight=True).told == ()
