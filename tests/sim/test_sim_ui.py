"""The page of a simulated flight: what is asked there happens in the flight, in its score and in its folder."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import pytest

import sim.ui
from companion.mission.model import dump_mission, parse_mission
from companion.mission.resolve import resolve
from groundstation.web.bridge import Bridge
from groundstation.web.pipe import CLOCK, Request, Who
from sim.changes import with_all_things
from sim.lockstep import Flight, FlightOptions, fly
from sim.loop import START_S
from sim.pace import Pace
from sim.replayed import FlownFolder
from sim.score import Score, score
from sim.stop import Stop
from sim.trajectory import read_csv
from sim.ui import SimScreen

MISSION = """
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}, {id: 2, north_m: 0, east_m: 2000, heading_deg: 0}]
targets: [{id: 1, north_m: 4500, east_m: 0}]
broadcast_period_s: 1
assignment_period_s: 5
max_time_s: 100
guidance_step_s: 1
integration_step_s: 1
queue: true
"""
OPERATOR = Who("ada", "operator")


class Browser:
    """Stands in for the web process: asks at given times of the flight, and keeps what it is shown and answered."""

    def __init__(self, asks: Sequence[tuple[float, Mapping[str, Any]]], who: Who = OPERATOR) -> None:
        self._asks = [(t_s, Request(k, who, command)) for k, (t_s, command) in enumerate(asks)]
        self.t_s = 0.0
        self.shown: list[Mapping[str, Any]] = []
        self.answers: dict[int, Mapping[str, Any] | str] = {}
        self.frames_shown = 0

    def publish(self, message: Mapping[str, Any]) -> None:
        self.shown.append(message)
        if message["type"] == "playback":
            self.t_s = message["at_s"] - START_S

    def frames(self, _t_s: float, datagrams: Sequence[bytes]) -> None:
        self.frames_shown += len(datagrams)

    def reply(self, identity: int, event: Mapping[str, Any]) -> None:
        self.answers[identity] = event

    def refuse(self, identity: int, why: str) -> None:
        self.answers[identity] = why

    def pump(self) -> list[Request]:
        due = [request for t_s, request in self._asks if t_s <= self.t_s]
        self._asks = self._asks[len(due) :]
        return due

    def close(self) -> None:
        """End nothing."""

    def pictures(self) -> list[Mapping[str, Any]]:
        return [message for message in self.shown if message["type"] == "picture"]


@pytest.fixture
def looks_always(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the page be looked at in every tick, whatever the wall clock says."""
    monkeypatch.setattr(sim.ui, "SHOW_PERIOD_S", 0.0)


def flown(browser: Browser, out: Path | None = None, pace: Pace | None = None) -> tuple[Flight, Score]:
    mission = resolve(parse_mission(MISSION, "test"), 1)
    screen = SimScreen(cast(Bridge, browser), pace or Pace())
    flight = fly(mission, 1, FlightOptions(law="routed", out=out, screen=screen))
    flown_mission = with_all_things(flight.changes) if flight.changes else mission
    return flight, score(flight.trajectory, flown_mission, flight.changes)


def threat(north_m: float, east_m: float) -> dict[str, Any]:
    return {"do": "add-threat", "north_m": north_m, "east_m": east_m, "radius_m": 500.0}


def east_m(flight: Flight, t_s: float) -> float:
    sample = int(flight.trajectory.t_s.searchsorted(t_s))
    return float(flight.trajectory.agents_ned_m[sample, 0, 1])


@pytest.mark.usefixtures("looks_always")
def test_a_threat_dropped_on_a_route_is_flown_around_and_counts_in_the_score(tmp_path: Path) -> None:
    browser = Browser([(10.0, threat(3_000.0, 0.0))])
    flight, scored = flown(browser, tmp_path)
    assert (scored.targets_reached, scored.threat_entries_detection) == (1, 0)
    assert abs(east_m(flight, 9.0)) < 100.0
    assert max(abs(east_m(flight, t_s)) for t_s in range(40, 70)) > 400.0
    nearest = scored.per_agent[0].nearest_detection
    assert nearest is not None
    assert nearest.distance_m < 500.0
    rows = read_csv(tmp_path / "trajectory.csv", things_change=True)
    assert rows.threat_ids == (1,)
    events = [json.loads(line) for line in (tmp_path / "events.jsonl").read_text().splitlines()]
    added = [event for event in events if event["event"] == "threat-added"]
    assert [(event["unix_s"] - START_S, event["who"]["name"]) for event in added] == [(10.0, "ada")]
    assert [event["number"] for event in events] == list(range(1, len(events) + 1))
    assert browser.answers[0] == added[0]
    (tmp_path / "mission.yaml").write_text(dump_mission(resolve(parse_mission(MISSION, "test"), 1)))
    played = FlownFolder(tmp_path)
    pictures = [played.picture_at(START_S + t_s) for t_s in (9.0, 11.0)]
    assert [len(picture["threats"]) for picture in pictures if picture is not None] == [0, 1]
    assert [event["number"] for event in played.events(START_S + 9.0, START_S + 10.0)] == [added[0]["number"]]


@pytest.mark.usefixtures("looks_always")
def test_a_threat_that_is_retired_lets_the_agent_go_straight_again() -> None:
    browser = Browser([(10.0, threat(3_000.0, 0.0)), (20.0, {"do": "retire", "kind": "threat", "id": 1})])
    flight, scored = flown(browser)
    assert scored.targets_reached == 1
    assert 100.0 < max(abs(east_m(flight, t_s)) for t_s in range(70)) < 400.0


@pytest.mark.usefixtures("looks_always")
def test_a_target_added_in_flight_is_reached_too() -> None:
    browser = Browser([(10.0, {"do": "add-target", "north_m": 4_500.0, "east_m": 2_000.0})])
    _, scored = flown(browser)
    assert (scored.targets_reached, scored.targets) == (2, 2)


@pytest.mark.usefixtures("looks_always")
def test_the_picture_tells_certificate_and_reason_of_every_agent_as_decided_on_board() -> None:
    hold, out = {"do": "direct", "directive": "hold", "agent": 2}, {"do": "take-out", "agent": 1}
    browser = Browser([(20.0, hold), (30.0, out)])
    flown(browser)
    agents = {agent["id"]: agent for agent in browser.pictures()[-1]["agents"]}
    assert agents[2]["certificate"] == "for ever"
    assert agents[2]["reason"] == "loiter: directive hold, for this agent"
    assert agents[1]["state"] == "out"
    assert {picture["mode"] for picture in browser.pictures()} == {"sim"}
    assert browser.frames_shown > 80


@pytest.mark.usefixtures("looks_always")
def test_pause_and_speed_are_those_of_the_simulators_clock_and_only_an_operators() -> None:
    asks = [(20.0, {"do": CLOCK, "speed": 500.0, "playing": False}), (20.0, {"do": CLOCK, "playing": True})]
    browser = Browser([*asks, (25.0, {"do": CLOCK, "at_s": 0.0})])
    _, scored = flown(browser)
    assert scored.targets_reached == 1
    assert browser.answers[0] == {"at_s": START_S + 20.0, "speed": 500.0, "playing": False}
    assert browser.answers[1] == {"at_s": START_S + 20.0, "speed": 500.0, "playing": True}
    assert browser.answers[2] == "at_s: a flight under way cannot be wound; allowed: speed, playing"


@pytest.mark.usefixtures("looks_always")
def test_an_observer_changes_nothing() -> None:
    browser = Browser([(10.0, threat(3_000.0, 0.0)), (21.0, {"do": CLOCK, "playing": False})], Who("eve", "observer"))
    flight, scored = flown(browser)
    assert scored.targets_reached == 1
    assert flight.changes == ()
    assert all("operator only" in str(answer) for answer in browser.answers.values())
    assert len(browser.answers) == 2


@pytest.mark.usefixtures("looks_always")
def test_a_flight_that_is_only_looked_at_flies_as_one_that_is_not() -> None:
    looked_at, _ = flown(Browser([]))
    mission = resolve(parse_mission(MISSION, "test"), 1)
    alone = fly(mission, 1, FlightOptions(law="routed"))
    assert (looked_at.trajectory.agents_ned_m == alone.trajectory.agents_ned_m).all()


@pytest.mark.usefixtures("looks_always")
def test_a_flight_that_is_over_refuses_what_is_asked() -> None:
    browser = Browser([(0.0, threat(0.0, 0.0)), (0.0, {"do": CLOCK, "playing": True})])
    looks = iter([None, None, Stop("interrupted", 130)])
    sim.ui.linger(SimScreen(cast(Bridge, browser), Pace()), lambda: next(looks))
    assert set(browser.answers.values()) == {sim.ui.OVER}
