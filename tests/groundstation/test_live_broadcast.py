"""Whatever is added, changed and retired while a radio broadcasts: frames go on, and who hears them knows it all."""

from __future__ import annotations

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from companion.errors import InputError
from companion.mission.model import Mission
from companion.onboard.world_model import WorldModel
from companion.protocol.codec import FrameReader, MissionFrame, RadiiFrame
from groundstation.events import Who, command_from
from groundstation.ground_station import GroundStation
from groundstation.radio import parse_radio
from groundstation.schedule import LEAST_REVISION_S, TICK_S, Broadcaster

START_S = 1_790_000_000.0
PERSON = Who(name="anna", role="operator")


def mission(agents: int) -> Mission:
    return Mission.model_validate(
        {
            "queue": True,
            "agents": [
                {"id": 3 * k + 1, "north_m": 500.0 * k, "east_m": 0.0, "heading_deg": 0.0} for k in range(agents)
            ],
            "targets": [{"id": k + 1, "north_m": 500.0 * k, "east_m": 30000.0} for k in range(3)],
            "threats": [
                {
                    "id": k + 1,
                    "north_m": 9000.0 * k,
                    "east_m": 9000.0,
                    "detection_radius_m": 400.0,
                    "attack_radius_m": 200.0,
                    "speed_bound_m_s": 5.0 * (k % 2),
                }
                for k in range(3)
            ],
        }
    )


class Air:
    """A ground station on a radio, and the world model of its first agent, which hears every frame."""

    def __init__(self, agents: int, radio: str) -> None:
        self.station = GroundStation(mission(agents), START_S, sensed=False)
        self.broadcaster = Broadcaster(self.station, parse_radio(radio, 1.0))
        self.broadcaster.begin(START_S)
        self.on_board = WorldModel(1)
        self.ticks = 0

    @property
    def now_s(self) -> float:
        return START_S + self.ticks * TICK_S

    def fly(self, for_s: float) -> Air:
        reader = FrameReader()
        for _ in range(round(for_s / TICK_S)):
            for datagram in self.broadcaster.tick(self.now_s):
                for frame in reader.read(datagram):
                    self.on_board.take(frame, self.now_s)
            self.ticks += 1
        return self

    def does(self, command: dict[str, Any]) -> None:
        try:
            self.station.command(command_from(command), PERSON, self.now_s)
        except InputError:
            pass


PLACE = st.integers(-40_000, 40_000).map(float)
COMMANDS = st.one_of(
    st.builds(
        lambda north, east, radius: {"do": "add-threat", "north_m": north, "east_m": east, "radius_m": radius},
        PLACE,
        PLACE,
        st.sampled_from([1.0, 300.0, 90_000.0]),
    ),
    st.builds(lambda north, east: {"do": "add-target", "north_m": north, "east_m": east}, PLACE, PLACE),
    st.builds(
        lambda kind, one: {"do": "retire", "kind": kind, "id": one},
        st.sampled_from(["target", "threat"]),
        st.integers(1, 6),
    ),
    st.builds(
        lambda one, north: {"do": "change", "kind": "threat", "id": one, "north_m": north, "east_m": 0.0},
        st.integers(1, 5),
        PLACE,
    ),
    st.builds(lambda one: {"do": "direct", "directive": "hold", "agent": one}, st.sampled_from([1, 4])),
    st.sampled_from([{"do": "pause"}, {"do": "resume"}, {"do": "undo", "number": 1}]),
)


@settings(max_examples=12)
@given(
    st.lists(st.tuples(COMMANDS, st.sampled_from([0.0, 0.3, 2.0])), max_size=10),
    st.sampled_from([(2, "sik-57600"), (14, "sik-57600")]),
)
def test_who_hears_the_broadcast_knows_what_was_done_whatever_came_when(
    steps: list[tuple[dict[str, Any], float]], kind: tuple[int, str]
) -> None:
    air = Air(*kind).fly(1.5)
    for command, wait_s in steps:
        air.does(command)
        air.fly(wait_s)
    air.fly(LEAST_REVISION_S + 3.0)
    station, view = air.station, air.on_board.view(air.now_s)
    assert view.whole
    assert sorted(view.threat_ids) == sorted(threat.id for threat in station.mission.threats)
    assert air.on_board.target_id == station.assignment.get(1)
    assert air.on_board.directives.in_force is station.operations.orders.of(1)
    assert station.unsendable.count == air.broadcaster.unsendable.count == 0


def test_until_the_next_broadcast_of_the_state_the_carousel_tells_the_threats_of_the_last() -> None:
    station = GroundStation(mission(14), START_S, sensed=False)
    station.refresh(START_S, 200)
    station.command(command_from({"do": "add-threat", "north_m": 1.0, "east_m": 1.0, "radius_m": 9.0}), PERSON, START_S)
    station.command(command_from({"do": "retire", "kind": "threat", "id": 1}), PERSON, START_S)

    def told() -> tuple[int, int, set[int]]:
        head, *radii = station.carousel(START_S + 0.5, 200)
        assert isinstance(head, MissionFrame)
        ids = {threat.id for frame in radii if isinstance(frame, RadiiFrame) for threat in frame.threats}
        return head.revision, head.threats, ids

    assert told() == (1, 3, {1, 2, 3})
    station.refresh(START_S + 1.0, 200)
    assert told() == (2, 3, {2, 3, 4})
