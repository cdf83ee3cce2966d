"""The ground station on its clock: what goes out when, and when it thinks again."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.drawing import resolve
from companion.errors import InputError
from companion.mission import Mission, parse_mission
from companion.wire import (
    Detection,
    DetectionsFrame,
    Directive,
    Frame,
    FrameReader,
    FrameWriter,
    Kind,
    MotionFrame,
    StateFrame,
)
from groundstation.core import MAX_EPOCH_S, GroundStation

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
    # The two outer agents change places: now each other's targets are nearer.
    run.see(1.0, Kind.AGENT, 1, 0.0, 9_000.0)
    run.see(1.0, Kind.AGENT, 3, 0.0, 0.0)
    assert run.to(24.9).station.assignment == {1: 1, 2: 1, 3: 2}
    assert run.to(25.0).station.assignment == {1: 2, 2: 1, 3: 1}


def test_it_assigns_anew_at_once_when_an_agent_is_lost() -> None:
    run = Run(sensed=True).to(26.0)
    run.see(26.0, Kind.AGENT, 1, 0.0, 0.0)
    run.see(26.0, Kind.AGENT, 2, 0.0, 5_000.0)
    assert run.to(30.0).station.assignment == {1: 1, 2: 1, 3: 2}
    assert run.to(30.1).station.assignment == {1: 1, 2: 2}


def test_it_assigns_anew_at_once_when_a_target_is_reached() -> None:
    run = Run(sensed=True).to(3.0)
    run.see(3.0, Kind.AGENT, 3, 19_800.0, 9_000.0)
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
    run.station.directive = directive
    run.to(5.0)
    assert [state.directive for state in run.states()] == [Directive.NORMAL, directive]


@given(st.binary(max_size=300) | st.binary(max_size=300).map(lambda data: b"\xfd" + data))
def test_random_bytes_on_the_sensors_channel_change_nothing(datagram: bytes) -> None:
    station = GroundStation(mission(), START_S)
    tracks = dict(station.picture.tracks)
    station.sense(datagram, START_S + 1.0)
    assert station.picture.tracks == tracks


def test_the_broadcast_itself_on_the_sensors_channel_changes_nothing() -> None:
    station = GroundStation(mission(), START_S)
    tracks = dict(station.picture.tracks)
    for datagram in station.tick(START_S):
        station.sense(datagram, START_S + 1.0)
    assert station.picture.tracks == tracks


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("objective: route", "test: objective: 'route' cannot be assigned; allowed: distance, inverse-distance"),
        ("case: II", "test: case: 'II' cannot be run; allowed: I"),
    ],
)
def test_what_it_cannot_do_is_refused_in_one_line(line: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        GroundStation(mission(f"name: test\n{line}\n"), START_S)
    assert str(caught.value) == said


@pytest.mark.parametrize(("objective", "chosen"), [("distance", {1: 1, 2: 2}), ("inverse-distance", {1: 2, 2: 1})])
def test_the_objective_of_the_mission_decides(objective: str, chosen: dict[int, int]) -> None:
    text = """
agents: [{id: 1, north_m: 0, east_m: 0}, {id: 2, north_m: 9000, east_m: 0}]
targets: [{id: 1, north_m: 8500, east_m: 0}, {id: 2, north_m: 50000, east_m: 0}]
"""
    station = GroundStation(parse_mission(f"{text}objective: {objective}\n", "test"), START_S)
    station.tick(START_S)
    assert station.assignment == chosen


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
    epochs = [FrameReader().read(data)[0].stamp.epoch_s for data in (first, second)]
    assert epochs == [1_000, int(later_s)]
