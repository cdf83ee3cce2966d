"""A running ground station takes in events: tracks, assignment, directives and revision follow."""

from __future__ import annotations

import pytest

from companion.mission.model import parse_mission
from companion.onboard.world_model import WorldModel
from companion.protocol.codec import Directive, FrameReader
from groundstation.events import STATION, Assigned, Event, ThreatAdded, Who, command_from
from groundstation.ground_station import GroundStation
from groundstation.notices import noticed
from groundstation.view import Surroundings, picture

MISSION = parse_mission(
    """
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}, {id: 2, north_m: 0, east_m: 9000, heading_deg: 0}]
targets: [{id: 1, north_m: 20000, east_m: 0}, {id: 2, north_m: 20000, east_m: 9000}]
threats: [{id: 1, north_m: 10000, east_m: 0, detection_radius_m: 3000, attack_radius_m: 1000}]
broadcast_period_s: 1
""",
    "test",
)
START_S = 1_790_000_000.0
PERSON = Who(name="anna", role="operator")


class Day:
    """A ground station without a radio, and the world model of an agent that hears everything."""

    def __init__(self) -> None:
        self.station = GroundStation(MISSION, START_S, sensed=False)
        self.on_board = WorldModel(1)
        self.now_s = START_S
        self.to(START_S)

    def to(self, now_s: float) -> None:
        """Broadcast until a time."""
        reader = FrameReader()
        while self.now_s <= now_s:
            for datagram in self.station.tick(self.now_s):
                for frame in reader.read(datagram):
                    self.on_board.take(frame, self.now_s)
            self.now_s += 0.5

    def does(self, **command: object) -> Event:
        """Do what a command asks, and broadcast for two periods."""
        event = self.station.command(command_from(command), PERSON, self.now_s)
        self.to(self.now_s + 2.0)
        return event

    def told(self) -> Directive:
        """Return the directive on board."""
        return self.on_board.directives.in_force

    @property
    def threats(self) -> list[int]:
        """Ids of the threats that the agent knows, in a whole picture."""
        view = self.on_board.view(self.now_s)
        assert view.whole
        return list(view.threat_ids)


def test_a_threat_added_is_on_board_within_a_broadcast_and_gone_when_retired() -> None:
    day = Day()
    revision = day.station.revision
    day.does(do="add-threat", north_m=5000.0, east_m=100.0, radius_m=800.0)
    assert day.threats == [1, 2]
    day.does(do="retire", kind="threat", id=2)
    assert day.threats == [1]
    assert day.station.revision == revision + 2


def test_threats_added_together_begin_one_revision() -> None:
    day = Day()
    revision = day.station.revision
    for east_m in (1000.0, 2000.0, 3000.0):
        command = {"do": "add-threat", "north_m": 5000.0, "east_m": east_m, "radius_m": 100.0}
        day.station.command(command_from(command), PERSON, day.now_s)
    day.to(day.now_s + 2.0)
    assert day.threats == [1, 2, 3, 4]
    assert day.station.revision == revision + 1


def test_targets_and_orders_begin_no_revision() -> None:
    day = Day()
    revision = day.station.revision
    day.does(do="change", kind="target", id=1, north_m=15000.0, east_m=500.0)
    day.does(do="pin", agent=1, target=2)
    day.does(do="direct", directive="hold")
    assert day.station.revision == revision
    assert day.on_board.directives.in_force is Directive.HOLD


def test_a_target_that_was_moved_is_told_at_its_new_place() -> None:
    day = Day()
    day.does(do="change", kind="target", id=1, north_m=15000.0, east_m=500.0)
    assert day.on_board.target_ned_m is not None
    assert abs(day.on_board.target_ned_m[0] - 15000.0) < 10.0


def test_a_pinned_agent_goes_to_its_target_and_the_other_covers_the_rest() -> None:
    day = Day()
    assert day.station.assignment == {1: 1, 2: 2}
    day.does(do="pin", agent=1, target=2)
    assert day.station.assignment == {1: 2, 2: 1}
    day.does(do="pin", agent=1, target=None)
    assert day.station.assignment == {1: 1, 2: 2}


def test_the_target_of_an_agent_taken_out_goes_to_another() -> None:
    day = Day()
    day.does(do="retire", kind="target", id=2)
    day.does(do="take-out", agent=1)
    assert day.station.assignment == {2: 1}
    day.does(do="put-back", agent=1)
    assert set(day.station.assignment) == {1, 2}


def test_in_a_pause_nobody_gets_another_target() -> None:
    day = Day()
    day.does(do="pause")
    day.does(do="pin", agent=1, target=2)
    assert day.station.assignment == {1: 1, 2: 2}
    assert day.told() is Directive.HOLD
    day.does(do="resume")
    assert day.station.assignment == {1: 2, 2: 1}
    assert day.told() is Directive.NORMAL


def test_more_than_a_broadcast_can_tell_is_counted_and_the_directive_still_goes_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("groundstation.ground_station.MOST_FRAMES", 3)
    day = Day()
    template = MISSION.threats[0]
    for identity in range(2, 18):
        threat = template.model_copy(update={"id": identity})
        day.station.adopt(ThreatAdded(number=identity, unix_s=START_S, who=STATION, threat=threat), day.now_s)
    day.does(do="direct", directive="hold")
    assert day.told() is Directive.HOLD
    assert not day.on_board.view(day.now_s).whole
    assert day.station.unsendable.count > 0


def test_one_agent_alone_is_told_to_return() -> None:
    day = Day()
    day.does(do="direct", directive="return", agent=2)
    assert day.told() is Directive.NORMAL
    day.does(do="direct", directive="hold", agent=1)
    assert day.told() is Directive.HOLD


def test_a_threat_that_may_move_from_now_on_has_not_moved_before() -> None:
    day = Day()
    day.to(START_S + 60.0)
    day.does(do="change", kind="threat", id=1, speed_bound_m_s=10.0)
    growth_m = picture(day.station, day.now_s, Surroundings())["threats"][0]["growth_m"]
    assert 0.0 < growth_m <= 10.0 * 3.0
    day.does(do="change", kind="threat", id=1, speed_bound_m_s=20.0)
    later_m = picture(day.station, day.now_s, Surroundings())["threats"][0]["growth_m"]
    assert growth_m < later_m <= growth_m + 20.0 * 3.0


def test_with_a_queue_targets_wait_without_a_warning_but_those_that_nobody_has_the_range_for() -> None:
    text = """
queue: true
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0, range_m: 9000}]
targets: [{id: 1, north_m: 2000, east_m: 0}, {id: 2, north_m: 3000, east_m: 0}, {id: 3, north_m: 9999, east_m: 0}]
"""
    station = GroundStation(parse_mission(text, "test"), START_S)
    assert station.uncovered == (2, 3)
    warned = ["no agent goes to target 3: none is free, or none has the range"]
    assert picture(station, START_S, Surroundings())["warnings"] == warned
    station.command(command_from({"do": "take-out", "agent": 1}), PERSON, START_S)
    (words,) = picture(station, START_S, Surroundings())["warnings"]
    assert words.startswith("no agent goes to targets 1, 2, 3: ")


def test_the_view_warns_of_targets_in_threats_and_of_those_without_an_agent() -> None:
    day = Day()
    assert picture(day.station, day.now_s, Surroundings())["warnings"] == []
    day.does(do="add-threat", north_m=20000.0, east_m=0.0, radius_m=500.0)
    day.does(do="take-out", agent=1)
    assert picture(day.station, day.now_s, Surroundings())["warnings"] == [
        "no agent goes to target 1: none is free, or none has the range",
        "inside a threat's detection radius, where agents keep out: target 1",
    ]


def test_the_target_of_an_agent_recalled_alone_goes_to_another_until_the_recall_ends() -> None:
    day = Day()
    day.does(do="retire", kind="target", id=2)
    assert set(day.station.assignment.values()) == {1}
    day.does(do="direct", directive="return", agent=1)
    assert day.station.assignment == {2: 1}
    shown = picture(day.station, day.now_s, Surroundings())
    assert [(agent["state"], agent["target"]) for agent in shown["agents"]] == [("recalled", None), ("under way", 1)]
    assert day.on_board.target_ned_m is None
    day.does(do="direct", directive="normal", agent=1)
    assert set(day.station.assignment) == {1, 2}


def test_why_a_recalled_agent_has_no_target_is_told() -> None:
    day = Day()
    for event in noticed(day.station.operations, day.station.facts(), day.now_s):
        day.station.adopt(event, day.now_s)
    day.does(do="direct", directive="return", agent=1)
    (news,) = noticed(day.station.operations, day.station.facts(), day.now_s)
    assert isinstance(news, Assigned)
    assert [one.reason for one in news.changes if one.agent == 1] == ["recalled"]


def test_an_agent_that_holds_keeps_its_target() -> None:
    day = Day()
    day.does(do="direct", directive="hold", agent=1)
    assert day.station.assignment == {1: 1, 2: 2}


def test_while_all_are_recalled_no_target_counts_as_covered_and_then_all_go_on_as_before() -> None:
    day = Day()
    day.does(do="direct", directive="return")
    day.to(day.now_s + 60.0)
    shown = picture(day.station, day.now_s, Surroundings())
    assert [target["agents"] for target in shown["targets"]] == [[], []]
    assert {(agent["state"], agent["target"]) for agent in shown["agents"]} == {("recalled", None)}
    assert shown["warnings"] == ["no agent goes to targets 1, 2: all agents are told to return"]
    assert day.station.uncovered == (1, 2)
    assert day.station.assignment == {1: 1, 2: 2}
    day.does(do="direct", directive="normal")
    assert day.station.sent == {1: 1, 2: 2}


@pytest.mark.parametrize(
    ("threat", "words"),
    [
        ({"north_m": 0.0, "radius_m": 500.0}, "inside a threat's detection radius now: agent 1"),
        (
            {"north_m": 10000.0, "radius_m": 90000.0},
            "every agent and target is inside the detection radius of threat 2",
        ),
        ({"north_m": 10000.0, "radius_m": 0.0001}, "detection radius under 1 m: threat 2; is it in metres?"),
    ],
)
def test_the_view_warns_of_threats_over_agents_and_of_radii_that_are_hardly_meant(
    threat: dict[str, float], words: str
) -> None:
    day = Day()
    day.does(do="add-threat", east_m=0.0, **threat)
    assert words in picture(day.station, day.now_s, Surroundings())["warnings"]


def test_a_threat_above_all_agents_is_over_none_of_them() -> None:
    day = Day()
    day.does(do="add-threat", north_m=0.0, east_m=0.0, radius_m=500.0, floor_m=9000.0)
    assert picture(day.station, day.now_s, Surroundings())["warnings"] == []
