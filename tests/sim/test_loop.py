"""The loop of all simulated flights: its order of events, and who takes part in which."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from companion.mission.model import AgentSpec, Loss, Mission, TargetSpec
from companion.protocol.codec import Detection, Kind
from groundstation.ground_station import GroundStation
from sim.loop import START_S, Loop, Outcome, Parts
from sim.world import World


class Told:
    """A vehicle, a transmitter, a sensor and a recorder that write down in what order they were called."""

    def __init__(self, **changes: object) -> None:
        self.events: list[tuple[str, float]] = []
        self.spec = AgentSpec(id=1, north_m=0.0, east_m=0.0, heading_deg=0.0, speed_m_s=25.0, n_max=1.0)
        self.alive = True
        self.seen: list[Detection] = []
        given = {
            "name": "told",
            "agents": (self.spec,),
            "targets": (TargetSpec(id=7, north_m=3_000.0, east_m=0.0, speed_bound_m_s=0.0),),
            "guidance_step_s": 1.0,
            "integration_step_s": 0.5,
            "max_time_s": 2.0,
        }
        mission = Mission(**{**given, **changes})  # type: ignore[arg-type]
        self.loop: Loop[None] = Loop(
            Parts(
                mission=mission,
                world=World(mission, 1),
                vehicles=(self,),
                snapshot=self.snapshot,
                ground=GroundStation(mission, START_S),
                look=self.look,
                transmit=self.transmit,
                recorder=self,
                repeat_period_s=0.5,
            )
        )

    def fly(self) -> list[str]:
        while self.loop.step():
            pass
        return [f"{name} {t_s:g}" for name, t_s in self.events]

    def row(self) -> tuple[float, float, float, float]:
        return 0.0, 0.0, 0.0, 25.0

    def detection(self) -> Detection:
        return Detection(Kind.AGENT, 1, 0.0, 0.0, 25.0, 0.0)

    def set_wind(self, wind_m_s: tuple[float, float]) -> None:
        self.events.append(("wind", 0.0))

    def move(self, t_s: float) -> None:
        self.events.append(("move", t_s))

    def transmitted(self, datagram: bytes, t_s: float) -> None:
        self.events.append(("hear", t_s))

    def guide(self, t_s: float, snapshot: None) -> None:
        self.events.append(("guide", t_s))

    def repeat(self, t_s: float) -> None:
        self.events.append(("repeat", t_s))

    def report(self, now_s: float) -> list[bytes]:
        return []

    def snapshot(self, now_s: float) -> None:
        self.events.append(("snapshot", now_s - START_S))

    def look(self, detections: list[Detection], now_s: float) -> None:
        self.events.append(("look", now_s - START_S))
        self.seen += detections

    def transmit(self, t_s: float) -> Iterator[tuple[float, bytes]]:
        yield t_s, b"state"

    def record(
        self, t_s: float, agents: np.ndarray, alive: Sequence[bool], things: tuple[np.ndarray, np.ndarray]
    ) -> bool:
        self.events.append(("record", t_s))
        return False

    def decided(self, agent_id: int, outcome: Outcome) -> None:
        raise AssertionError("nobody decided")


def test_within_a_tick_everything_happens_in_one_order() -> None:
    first = ["record 0", "look 0", "hear 0", "snapshot 0", "guide 0"]
    second = ["move 0.5", "record 0.5", "hear 0.5", "repeat 0.5"]
    third = ["move 1", "record 1", "look 1", "hear 1", "snapshot 1", "guide 1"]
    assert Told().fly()[: len(first + second + third)] == first + second + third


def test_the_last_tick_is_only_recorded() -> None:
    assert Told().fly()[-2:] == ["move 2", "record 2"]


def test_a_lost_vehicle_is_sent_to_and_neither_moved_nor_guided() -> None:
    told = Told(losses=(Loss(agent=1, t_s=0.5),))
    assert told.fly()[5:] == [
        *("move 0.5", "record 0.5", "hear 0.5"),
        *("record 1", "look 1", "hear 1", "snapshot 1", "record 1.5", "hear 1.5", "record 2"),
    ]


def test_in_case_ii_the_centre_is_not_shown_its_agents() -> None:
    kinds = []
    for case in ("I", "II"):
        told = Told(case=case)
        told.loop.step()
        kinds.append([detection.kind for detection in told.seen])
    assert kinds == [[Kind.AGENT, Kind.TARGET], [Kind.TARGET]]
