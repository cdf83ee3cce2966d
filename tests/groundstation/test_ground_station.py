"""The ground station on its clock: what goes out when, and when it thinks again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TypeVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.errors import InputError
from companion.files.yaml import dump_yaml
from companion.mission.extent import WHOLE_PLANE_M
from companion.mission.model import Mission, parse_mission
from companion.mission.resolve import resolve
from companion.mission.values import RANGE_RESERVE
from companion.protocol.codec import (
    BandsFrame,
    Detection,
    DetectionsFrame,
    Directive,
    FleetFrame,
    Frame,
    FrameReader,
    FrameWriter,
    Kind,
    MotionFrame,
    RadiiFrame,
    Stamp,
    StateFrame,
)
from groundstation.events import STATION, Direct
from groundstation.ground_station import MAX_EPOCH_S, GroundStation, Resumed
from groundstation.operations import DIRECTIVE_NAMES
from groundstation.track import Track

START_S = 1_790_000_000.0
TICK_S = 0.1
TEXT = """
agents: [{id: 1, north_m: 0, east_m: 0}, {id: 2, north_m: 0, east_m: 5000}, {id: 3, north_m: 0, east_m: 9000}]
targets: [{id: 1, north_m: 20000, east_m: 0}, {id: 2, north_m: 20000, east_m: 9000}]
threats: [{id: 1, north_m: 10000, east_m: 0, detection_radius_m: 3000, attack_radius_m: 1000, speed_bound_m_s: 0}]
broadcast_period_s: 5
assignment_period_s: 25
arrival_radius_m: 300
lost_after_s: 30
"""


def mission(extra: str = "") -> Mission:
    return parse_mission(TEXT + extra, "test")


def stamp_of(datagram: bytes) -> Stamp:
    """Return the stamp of a broadcast frame."""
    (frame,) = FrameReader().read(datagram)
    assert isinstance(frame, StateFrame | MotionFrame)
    return frame.stamp


class Run:
    """A ground station ticking on a virtual clock."""

    def __init__(self, sensed: bool = False, start_s: float = START_S) -> None:
        self.station = GroundStation(mission(), start_s, sensed)
        self.start_s = start_s
        self.sent: list[tuple[float, Frame]] = []
        self._steps = 0
        self._sensor = FrameWriter()

    def to(self, t_s: float) -> Run:
        """Tick up to a time since the start."""
        reader = FrameReader()
        while self._steps * TICK_S <= t_s + 1e-9:
            at_s = self._steps * TICK_S
            for datagram in self.station.tick(self.start_s + at_s):
                (frame,) = reader.read(datagram)
                self.sent.append((round(at_s, 3), frame))
            self._steps += 1
        assert reader.rejected.total() == 0
        return self

    def see(self, t_s: float, kind: Kind, identity: int, north_m: float, east_m: float) -> None:
        detection = Detection(kind, identity, north_m, east_m, 0.0, 0.0)
        frame = DetectionsFrame(int(START_S), round(t_s * 1000), 47.0, 8.0, (detection,))
        self.station.sense(self._sensor.encode(frame), START_S + t_s)

    def times(self, kind: type[Frame]) -> list[float]:
        return [t_s for t_s, frame in self.sent if isinstance(frame, kind)]

    def states(self) -> list[StateFrame]:
        return [frame for _, frame in self.sent if isinstance(frame, StateFrame)]


def test_states_and_motions_alternate_half_a_period_apart() -> None:
    run = Run().to(20.0)
    assert run.times(StateFrame) == [0.0, 5.0, 10.0, 15.0, 20.0]
    assert run.times(MotionFrame) == [2.5, 7.5, 12.5, 17.5]


def test_a_late_tick_sends_each_kind_once_and_keeps_the_grid() -> None:
    run = Run().to(0.0)
    late = [type(frame) for d in run.station.tick(START_S + 17.2) for frame in FrameReader().read(d)]
    assert sorted(kind.__name__ for kind in late) == ["MotionFrame", "StateFrame"]
    assert run.station.tick(START_S + 17.4) == []
    assert len(run.station.tick(START_S + 17.5)) == 1
    assert len(run.station.tick(START_S + 20.0)) == 1


def test_a_state_is_stamped_with_its_epoch_its_time_and_a_rising_sequence() -> None:
    run = Run(start_s=START_S + 0.25).to(10.0)
    stamps = [state.stamp for state in run.states()]
    assert {stamp.epoch_s for stamp in stamps} == {int(START_S)}
    assert [stamp.time_ms for stamp in stamps] == [250, 5_250, 10_250]
    assert [stamp.sequence for stamp in stamps] == [1, 2, 3]


def test_a_motion_names_the_state_before_it() -> None:
    run = Run().to(10.0)
    sequences = [frame.stamp.sequence for _, frame in run.sent if isinstance(frame, StateFrame | MotionFrame)]
    assert sequences == [1, 1, 2, 2, 3]


def test_everybody_has_a_target_from_the_first_broadcast() -> None:
    (state,) = Run().to(0.0).states()
    assert {agent.id: agent.target_id for agent in state.agents} == {1: 1, 2: 1, 3: 2}


def test_it_assigns_anew_every_period_and_not_in_between() -> None:
    run = Run(sensed=True).to(1.0)
    # The two outer agents are found in each other's places, where each other's targets are nearer.
    for t_s in (1.0, 2.0, 3.0):
        run.see(t_s, Kind.AGENT, 1, 0.0, 9_000.0)
        run.see(t_s, Kind.AGENT, 3, 0.0, 0.0)
    assert run.to(24.9).station.assignment == {1: 1, 2: 1, 3: 2}
    assert run.to(25.0).station.assignment == {1: 2, 2: 1, 3: 1}


def test_it_assigns_anew_at_once_when_an_agent_is_lost() -> None:
    run = Run(sensed=True).to(26.0)
    run.see(26.0, Kind.AGENT, 1, 0.0, 0.0)
    run.see(26.0, Kind.AGENT, 2, 0.0, 5_000.0)
    assert run.to(30.0).station.assignment == {1: 1, 2: 1, 3: 2}
    assert run.to(30.1).station.assignment == {1: 1, 2: 2}


def test_it_assigns_anew_at_once_when_a_target_is_reached() -> None:
    run = Run(sensed=True).to(0.9)
    for t_s in (1.0, 2.0, 3.0):
        run.see(t_s, Kind.AGENT, 3, 19_800.0, 9_000.0)
        run.to(t_s)
    run.to(3.1)
    assert run.station.assignment == {1: 1, 2: 1}
    (state,) = [frame for t_s, frame in run.to(5.0).sent if t_s == 5.0]
    assert isinstance(state, StateFrame)
    assert {agent.id: agent.target_id for agent in state.agents} == {1: 1, 2: 1, 3: None}
    assert [target.id for target in state.targets] == [1]


def test_targets_nobody_is_left_for_are_named() -> None:
    run = Run(sensed=True).to(29.0)
    run.see(29.0, Kind.AGENT, 2, 0.0, 5_000.0)
    run.to(31.0)
    assert run.station.assignment == {2: 1} or run.station.assignment == {2: 2}
    assert set(run.station.uncovered) | set(run.station.assignment.values()) == {1, 2}
    assert len(run.station.uncovered) == 1


def test_with_nobody_left_it_still_broadcasts() -> None:
    run = Run(sensed=True).to(40.0)
    assert run.station.assignment == {}
    assert run.states()[-1].agents == ()
    assert run.times(StateFrame)[-1] == 40.0


@pytest.mark.parametrize("directive", Directive)
def test_the_directive_goes_out_with_the_next_state(directive: Directive) -> None:
    run = Run().to(1.0)
    run.station.command(Direct(do="direct", directive=DIRECTIVE_NAMES[directive]), STATION, START_S + 1.0)
    run.to(5.0)
    assert [state.directive for state in run.states()] == [Directive.NORMAL, directive]


@pytest.mark.slow
@given(st.binary(max_size=300) | st.binary(max_size=300).map(lambda data: b"\xfd" + data))
def test_random_bytes_on_the_sensors_channel_change_nothing(datagram: bytes) -> None:
    station = GroundStation(mission(), START_S)
    tracks = dict(station.tracks.tracks)
    station.sense(datagram, START_S + 1.0)
    assert station.tracks.tracks == tracks


def test_the_broadcast_itself_on_the_sensors_channel_changes_nothing() -> None:
    station = GroundStation(mission(), START_S)
    tracks = dict(station.tracks.tracks)
    for datagram in station.tick(START_S):
        station.sense(datagram, START_S + 1.0)
    assert station.tracks.tracks == tracks


def test_what_it_cannot_do_is_refused_in_one_line() -> None:
    with pytest.raises(InputError) as caught:
        GroundStation(mission("name: test\nwind: {speed_m_s: 50, gust_m_s: 10}\n"), START_S)
    assert str(caught.value).startswith("test: wind: speed_m_s and gust_m_s together 60 m/s; allowed: less than ")


@pytest.mark.parametrize(("objective", "chosen"), [("distance", {1: 1, 2: 2}), ("inverse-distance", {1: 2, 2: 1})])
def test_the_objective_of_the_mission_decides(objective: str, chosen: dict[int, int]) -> None:
    text = """
agents: [{id: 1, north_m: 0, east_m: 0}, {id: 2, north_m: 9000, east_m: 0}]
targets: [{id: 1, north_m: 8500, east_m: 0}, {id: 2, north_m: 50000, east_m: 0}]
"""
    station = GroundStation(parse_mission(f"{text}objective: {objective}\n", "test"), START_S)
    station.tick(START_S)
    assert station.assignment == chosen


@pytest.mark.parametrize("objective", ["distance", "inverse-distance", "route", "latest"])
def test_an_agent_that_is_kept_for_a_target_is_sent_there_or_nowhere(objective: str) -> None:
    text = f"""
agents: [{{id: 1, north_m: 0, east_m: 0, only_target: 2}}, {{id: 2, north_m: 9000, east_m: 0}}]
targets: [{{id: 1, north_m: 1000, east_m: 0}}, {{id: 2, north_m: 9900, east_m: 0}}]
objective: {objective}
"""
    assert GroundStation(parse_mission(text, "kept"), START_S).assignment == {1: 2, 2: 1}
    both = text.replace("east_m: 0}]\ntargets", "east_m: 0, only_target: 2}]\ntargets")
    station = GroundStation(parse_mission(both, "kept"), START_S)
    assert (set(station.assignment.values()), station.uncovered) == ({2}, (1,))


BEHIND = """
agents: [{id: 1, north_m: 0, east_m: -2000}, {id: 2, north_m: 12000, east_m: 0}]
targets: [{id: 1, north_m: 0, east_m: 2000}, {id: 2, north_m: 7000, east_m: -4500}]
defaults: {threat: {detection_radius_m: 1500, attack_radius_m: 500, speed_bound_m_s: 0}}
threats: [{id: 1, north_m: -8000, east_m: 0}, {id: 2, north_m: -6000, east_m: 0}, {id: 3, north_m: -4000, east_m: 0},
  {id: 4, north_m: -2000, east_m: 0}, {id: 5, north_m: 0, east_m: 0}, {id: 6, north_m: 2000, east_m: 0},
  {id: 7, north_m: 4000, east_m: 0}, {id: 8, north_m: 6000, east_m: 0}, {id: 9, north_m: 8000, east_m: 0}]
arrival_radius_m: 300
"""
SWAPPED, STRAIGHT = {1: 2, 2: 1}, {1: 1, 2: 2}


@pytest.mark.parametrize(
    ("lines", "chosen"),
    [
        ("objective: distance", STRAIGHT),
        ("objective: route", SWAPPED),
        ("objective: latest", SWAPPED),
    ],
)
def test_by_the_way_nobody_is_sent_through_a_wall_of_threats(lines: str, chosen: dict[int, int]) -> None:
    assert GroundStation(parse_mission(f"{BEHIND}{lines}\n", "behind"), START_S).assignment == chosen


@pytest.mark.parametrize(
    ("alt_m", "height_m", "chosen"), [(500, 30, SWAPPED), (500, 120, STRAIGHT), (600, 30, STRAIGHT)]
)
def test_a_wall_below_the_agents_is_in_nobodys_way(alt_m: int, height_m: int, chosen: dict[int, int]) -> None:
    text = BEHIND.replace(
        "defaults: {threat: {", f"defaults: {{agent: {{height_m: {height_m}}}, threat: {{ceiling_m: 600, "
    )
    station = GroundStation(parse_mission(f"{text}objective: route\norigin: {{alt_m: {alt_m}}}\n", "below"), START_S)
    assert station.assignment == chosen


def seen_at(station: GroundStation, t_s: float, *agents: tuple[float, float, float, float]) -> None:
    """Detect the agents, each (north_m, east_m, velocity north and east m/s), and let the time come."""
    detections = tuple(Detection(Kind.AGENT, k, *agent) for k, agent in enumerate(agents, 1))
    frame = DetectionsFrame(int(START_S), round(1000 * t_s), 47.0, 8.0, detections)
    station.sense(FrameWriter().encode(frame), START_S + t_s)
    station.tick(START_S + t_s)


ABREAST = """
agents: [{id: 1, north_m: 0, east_m: 0, n_max: 0.5}, {id: 2, north_m: 0, east_m: 200, n_max: 0.5}]
targets: [{id: 1, north_m: 9000, east_m: 0}, {id: 2, north_m: 9000, east_m: 200}]
assignment_period_s: 5
"""


@pytest.mark.parametrize(
    ("lines", "changes"),
    [("objective: distance", True), ("objective: route", False), ("objective: route\nswitching_share: 0", True)],
)
def test_agents_that_stray_across_each_other_keep_their_targets_where_a_share_is_set(lines: str, changes: bool) -> None:
    station = GroundStation(parse_mission(f"{ABREAST}{lines}\n", "abreast"), START_S)
    found = []
    for step in range(1, 7):
        off_m = 20.0 * (-1) ** step
        seen_at(station, 5.0 * step, (300.0, 100.0 + off_m, 60.0, 0.0), (300.0, 100.0 - off_m, 60.0, 0.0))
        found.append(station.assignment)
    assert (len({tuple(sorted(each.items())) for each in found}) > 1) is changes


@pytest.mark.parametrize(("heading", "chosen"), [(1.0, STRAIGHT), (-1.0, SWAPPED)])
def test_the_way_begins_as_the_agent_flies(heading: float, chosen: dict[int, int]) -> None:
    """Agent 1 is between a target ahead and one behind it; agent 2 stands still abeam of both."""
    text = """
agents: [{id: 1, north_m: 0, east_m: 0, n_max: 0.5}, {id: 2, north_m: 0, east_m: -8000}]
targets: [{id: 1, north_m: 4000, east_m: 0}, {id: 2, north_m: -4000, east_m: 0}]
assignment_period_s: 5
objective: route
switching_share: 0
"""
    station = GroundStation(parse_mission(text, "ways"), START_S)
    seen_at(station, 5.0, (0.0, 0.0, 60.0 * heading, 0.0), (0.0, -8_000.0, 0.0, 0.0))
    assert station.assignment == chosen


def test_by_the_way_the_range_must_be_enough_for_the_way() -> None:
    text = """
agents: [{id: 1, north_m: 0, east_m: -5000, range_m: RANGE}]
targets: [{id: 1, north_m: 0, east_m: 5000}]
threats: [{id: 1, north_m: 0, east_m: 0, detection_radius_m: 3000, attack_radius_m: 500, speed_bound_m_s: 0}]
range_policy: arrive
"""
    found = {}
    for objective in ("distance", "route", "latest"):
        for range_m in (11_000, 12_500):
            lines = f"{text.replace('RANGE', str(range_m))}objective: {objective}\n"
            found[objective, range_m] = GroundStation(parse_mission(lines, "range"), START_S).uncovered == ()
    assert found == {
        ("distance", 11_000): True,
        ("distance", 12_500): True,
        ("route", 11_000): False,
        ("route", 12_500): True,
        ("latest", 11_000): False,
        ("latest", 12_500): True,
    }


def test_where_threats_have_bands_they_go_out_with_every_state() -> None:
    text = TEXT.replace("attack_radius_m: 1000", "attack_radius_m: 1000, floor_m: 100.5, ceiling_m: 900")
    station, reader = GroundStation(parse_mission(text, "bands"), START_S), FrameReader()
    plain = GroundStation(mission("name: bands\n"), START_S)
    sent = [[type(f) for d in station.tick(START_S + t_s) for f in reader.read(d)] for t_s in (0.0, 2.5, 5.0)]
    assert sent == [[StateFrame, BandsFrame], [MotionFrame], [StateFrame, BandsFrame]]
    assert plain.tick(START_S)[0][7:-2] == GroundStation(parse_mission(text, "b"), START_S).tick(START_S)[0][7:-2]


def test_where_no_threat_has_a_band_none_go_out() -> None:
    assert Run().to(20.0).times(BandsFrame) == []


@pytest.mark.slow
def test_a_mission_of_more_frames_than_can_be_numbered_is_refused() -> None:
    mission = resolve(
        parse_mission(
            "draw: {agents: 1400, targets: 1400}\ndefaults: {target: {speed_bound_m_s: 0}}\nseparation_m: 1", "huge"
        ),
        1,
    )
    with pytest.raises(InputError, match="cannot be broadcast"):
        GroundStation(mission, 1_000.0)


def test_a_new_epoch_begins_before_the_time_in_it_overflows() -> None:
    mission = resolve(parse_mission("draw: {agents: 1, targets: 1}", "small"), 1)
    station = GroundStation(mission, 1_000.0, sensed=False)
    (first,) = station.tick(1_000.0)
    later_s = 1_000.0 + MAX_EPOCH_S + 5.0
    second = station.tick(later_s)[0]
    epochs = [stamp_of(data).epoch_s for data in (first, second)]
    assert epochs == [1_000, int(later_s)]


# The range budget


def ranged(ranges_m: dict[int, float], *lines: str) -> GroundStation:
    """Return a station with agents 1 km apart at the start and targets 20 km ahead, one for each of the first two."""
    agents = ", ".join(
        f"{{id: {k}, north_m: 0, east_m: {1000 * k}, range_m: {range_m}}}" for k, range_m in ranges_m.items()
    )
    targets = "{id: 1, north_m: 20000, east_m: 1000}, {id: 2, north_m: 20000, east_m: 2000}"
    text = f"agents: [{agents}]\ntargets: [{targets}]\n"
    return GroundStation(parse_mission("\n".join([text, *lines]), "ranged"), START_S)


FAR, SHORT = 100_000.0, 10_000.0


def test_an_agent_that_cannot_arrive_gets_no_target() -> None:
    station = ranged({1: FAR, 2: FAR, 3: SHORT})
    assert (station.assignment, station.uncovered) == ({1: 1, 2: 2}, ())


def test_the_target_of_an_agent_that_cannot_arrive_goes_to_one_that_can() -> None:
    assert ranged({1: SHORT, 2: FAR, 3: FAR}).assignment == {2: 1, 3: 2}


def test_a_target_that_nobody_can_reach_is_named() -> None:
    station = ranged({1: FAR, 2: SHORT, 3: SHORT})
    assert len(station.assignment) == 1
    assert set(station.assignment.values()) | set(station.uncovered) == {1, 2}


def test_where_nobody_can_arrive_anywhere_all_targets_are_named_and_it_still_broadcasts() -> None:
    station = ranged({1: SHORT, 2: SHORT})
    assert (station.assignment, station.uncovered) == ({}, (1, 2))
    (frame,) = FrameReader().read(station.tick(START_S)[0])
    assert isinstance(frame, StateFrame)
    assert {agent.target_id for agent in frame.agents} == {None}


@pytest.mark.parametrize(
    ("policy", "range_m", "sent"),
    [
        ("arrive", 19_900.0, False),
        ("arrive", 20_100.0, True),
        ("return", 20_100.0, False),
        ("return", 40_100.0, False),
        ("return", 20_000.0 * (1.0 + RANGE_RESERVE) - 100.0, False),
        ("return", 20_000.0 * (1.0 + RANGE_RESERVE) + 100.0, True),
    ],
)
def test_under_the_policy_to_return_the_way_home_must_be_within_range_too(
    policy: str, range_m: float, sent: bool
) -> None:
    station = ranged({1: range_m, 2: FAR}, f"range_policy: {policy}")
    assert (1 in station.assignment) is sent
    assert station.uncovered == (() if sent else (1,))


def test_the_way_flown_counts_against_the_range() -> None:
    station, sensor = ranged({1: 21_000.0, 2: FAR}, "range_policy: arrive", "assignment_period_s: 5"), FrameWriter()
    assert station.assignment == {1: 1, 2: 2}
    for t_s, east_m in ((20.0, 2_000.0), (40.0, 1_000.0)):
        seen = DetectionsFrame(
            int(START_S),
            round(1000 * t_s),
            47.0,
            8.0,
            (Detection(Kind.AGENT, 1, 0.0, east_m, 0.0, 0.0), Detection(Kind.AGENT, 2, 0.0, 2_000.0, 0.0, 0.0)),
        )
        station.sense(sensor.encode(seen), START_S + t_s)
        station.tick(START_S + t_s)
    assert (list(station.assignment), len(station.uncovered)) == ([2], 1)


# Coverage: docs/method.md section 1, point 6


NUMBER_OF_AGENTS, NUMBER_OF_TARGETS = 10, 5


@pytest.mark.slow
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32), number_of_losses=st.integers(1, 6))
def test_no_target_is_left_without_an_agent_while_there_are_as_many_agents_whoever_is_lost(
    seed: int, number_of_losses: int
) -> None:
    generator = np.random.default_rng(seed)
    places = generator.uniform(0.0, 40_000.0, (NUMBER_OF_AGENTS + NUMBER_OF_TARGETS, 2)).tolist()
    agents, targets = places[:NUMBER_OF_AGENTS], places[NUMBER_OF_AGENTS:]
    losers = generator.choice(NUMBER_OF_AGENTS, number_of_losses, replace=False) + 1
    losses_s = {int(k): float(generator.uniform(0.0, 150.0)) for k in losers}
    listed = {
        "agents": [{"id": k, "north_m": n, "east_m": e} for k, (n, e) in enumerate(agents, 1)],
        "targets": [{"id": k, "north_m": n, "east_m": e} for k, (n, e) in enumerate(targets, 1)],
        "lost_after_s": 10,
        "defaults": {"agent": {"speed_m_s": 200}},
        "assignment_period_s": 1_000,
    }
    station = GroundStation(parse_mission(dump_yaml(listed), "cover"), START_S)
    flying, reader, sensor = Toy(agents, targets), FrameReader(), FrameWriter()
    for t_s in range(200):
        alive = [k for k in flying.places if t_s < losses_s.get(k, 1e9)]
        station.sense(sensor.encode(flying.seen(alive, t_s)), START_S + t_s)
        for datagram in station.tick(START_S + t_s):
            (frame,) = reader.read(datagram)
            if isinstance(frame, StateFrame):
                goals = {agent.id: agent.target_id for agent in frame.agents if agent.target_id is not None}
                assert set(goals) <= set(station.tracks.active_agents)
                covered, wanted = set(goals.values()), set(station.tracks.open_targets)
                assert covered <= wanted
                assert set(station.uncovered) == wanted - covered
                assert len(covered) == min(len(station.tracks.active_agents), len(wanted))
        flying.move(alive, station.assignment)
    overdue = {k for k, t_s in losses_s.items() if k not in station.tracks.progress.arrived}
    assert station.tracks.progress.lost - station.tracks.progress.arrived == overdue


class Toy:
    """Agents that fly straight to where they are sent, 200 m each second."""

    def __init__(self, agents: list[list[float]], targets: list[list[float]]) -> None:
        self.places = dict(enumerate(agents, 1))
        self._targets = dict(enumerate(targets, 1))

    def seen(self, alive: list[int], t_s: float) -> DetectionsFrame:
        detections = tuple(
            Detection(Kind.AGENT, k, north_m, east_m, 0.0, 0.0) for k in alive for north_m, east_m in [self.places[k]]
        )
        return DetectionsFrame(int(START_S), round(1000 * t_s), 47.0, 8.0, detections)

    def move(self, alive: list[int], assignment: Mapping[int, int]) -> None:
        for k in set(alive) & set(assignment):
            goal, here = self._targets[assignment[k]], self.places[k]
            share = min(1.0, 200.0 / max(math.dist(goal, here), 1e-9))
            self.places[k] = [here[0] + share * (goal[0] - here[0]), here[1] + share * (goal[1] - here[1])]


def test_while_the_epoch_is_ahead_of_the_clock_frames_are_stamped_with_its_beginning() -> None:
    station = GroundStation(mission(), START_S + 0.5, resumed=Resumed(epoch_s=int(START_S) + 3))
    stamps = []
    for step in range(5):
        for raw in station.tick(START_S + 0.5 + 2.5 * step):
            stamp = stamp_of(raw)
            stamps.append((stamp.epoch_s, stamp.time_ms))
    assert stamps == [(int(START_S) + 3, time_ms) for time_ms in (0, 0, 2_500, 5_000, 7_500)]


@pytest.mark.parametrize("position_m", [21_474_836.0, -21_474_836.0, 2.0e7, -2.0e7])
@pytest.mark.parametrize("kind", list(Kind))
def test_no_detection_keeps_it_from_broadcasting(kind: Kind, position_m: float) -> None:
    run = Run(sensed=True).to(1.0)
    run.see(1.0, kind, 1, position_m, 0.0)
    run.to(11.0)
    assert len(run.states()) == 3
    assert run.station.unsendable.count == 0
    assert len(run.station.refresh(START_S + 12.0, 0x80)) > 0


def test_a_frame_that_cannot_be_made_is_counted_and_the_rest_goes_out() -> None:
    run = Run().to(1.0)
    run.station.tracks.tracks[Kind.THREAT, 1] = Track(1e9, 0.0, 0.0, 0.0, START_S)
    run.to(11.0)
    assert len(run.states()) == 1
    assert len(run.times(MotionFrame)) == 2
    assert run.station.unsendable.count == 2
    assert "does not fit a frame" in run.station.unsendable.first


@pytest.mark.parametrize("unseen_days", [30.0, 59.0, 1_000.0])
@pytest.mark.parametrize("speed_m_s", [0.01, 30.0])
def test_a_threat_unseen_for_months_is_told_as_large_as_it_may_be(unseen_days: float, speed_m_s: float) -> None:
    text = TEXT.replace("speed_bound_m_s: 0", f"speed_bound_m_s: {speed_m_s}")
    unseen_s = unseen_days * 86_400.0
    station = GroundStation(
        parse_mission(text, "test"), START_S, sensed=False, resumed=Resumed(began_s=START_S - unseen_s)
    )
    true_m = min(3_000.0 + speed_m_s * unseen_s, WHOLE_PLANE_M)
    states = [frame for raw in station.tick(START_S) for frame in FrameReader().read(raw)]
    assert isinstance(states[0], StateFrame)
    assert states[0].threats[0].detection_radius_m >= true_m
    fleet = [frame for frame in station.refresh(START_S, 120) if isinstance(frame, FleetFrame)]
    (age_s,) = [threat.age_s for frame in fleet for threat in _read(frame).threats]
    (radii,) = [_read(frame) for frame in station.carousel(START_S, 120) if isinstance(frame, RadiiFrame)]
    told_m = radii.threats[0].detection_radius_m + speed_m_s * age_s
    assert told_m >= true_m


FrameT = TypeVar("FrameT", bound=Frame)


def _read(frame: FrameT) -> FrameT:
    """Return a frame as it is received."""
    (read,) = FrameReader().read(FrameWriter().encode(frame))
    assert isinstance(read, type(frame))
    return read
