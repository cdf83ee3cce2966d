"""The one loop of every simulated flight whose companions are the real ones: its clock and its order of events.

In each tick the vehicles fly to its time, the world moves, the wind turns and vehicles are lost; the truth is recorded;
the centre looks and broadcasts; then the companions decide, or repeat what they decided. What differs between flights
is handed in: how a vehicle is coupled to its companion (by frames through a stand-in, or directly), how the centre is
shown the truth, what is transmitted, what is recorded. The flight on the pure core (sim/reproduction/core_flight.py)
has a loop of its own, because it checks this one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from companion.mission.model import AgentSpec, Mission
from companion.onboard.decision import Decision
from companion.protocol.codec import Detection
from groundstation.ground_station import GroundStation
from sim.sensor import LOOK_PERIOD_S, world_detections
from sim.wind import WindField
from sim.world import World

START_S = 1_767_225_600.0
"""Unix time at which every flight begins: 2026-01-01T00:00:00Z, so that logs are the same each time."""
TOLERANCE_S = 1e-6
"""By which something may be early and still counts as due."""

SnapshotT = TypeVar("SnapshotT")
SnapshotT_contra = TypeVar("SnapshotT_contra", contravariant=True)

Watch = Callable[[float, GroundStation, np.ndarray], None]
"""Called at every step with the virtual time in seconds, the ground station, and the agents' true rows (N, 4)."""


@dataclass(frozen=True)
class Outcome:
    """What one turn of a companion came to."""

    decision: Decision
    decision_us: float
    """Wall-clock time of the decision."""


class Vehicle(Protocol[SnapshotT_contra]):
    """One vehicle with its companion and its end of the broadcast link, as the loop sees them."""

    spec: AgentSpec
    alive: bool

    def row(self) -> tuple[float, float, float, float]:
        """Return north m, east m, heading deg, speed m/s; a lost vehicle stands where it was lost."""
        ...

    def detection(self) -> Detection:
        """Return what the centre's sensor sees of it."""
        ...

    def set_wind(self, wind_m_s: tuple[float, float]) -> None:
        """Let the air move (north, east) from now on."""
        ...

    def move(self, t_s: float) -> None:
        """Fly on to a time of the flight."""
        ...

    def transmitted(self, datagram: bytes, t_s: float) -> None:
        """Take a datagram that was sent to it at a time; when it arrives, if it does, is up to its link."""
        ...

    def guide(self, t_s: float, snapshot: SnapshotT_contra) -> Outcome | None:
        """Let the companion hear, see its neighbours and decide; None where there is none that does."""
        ...

    def repeat(self, t_s: float) -> None:
        """Let the companion keep its last decision standing."""
        ...

    def report(self, now_s: float) -> list[bytes]:
        """Return what the companion reports to the centre at a Unix time."""
        ...


class Recorder(Protocol):
    """What is written down of a flight, and by what it ends."""

    def record(
        self, t_s: float, agents: np.ndarray, alive: Sequence[bool], things: tuple[np.ndarray, np.ndarray]
    ) -> bool:
        """Take the true rows of agents (N, 4), targets (K, 4) and threats (M, 4); return whether the flight is over."""
        ...

    def decided(self, agent_id: int, outcome: Outcome) -> None:
        """Take note of a companion's turn."""
        ...


@dataclass(frozen=True)
class Parts(Generic[SnapshotT]):
    """What a loop is put together from."""

    mission: Mission
    world: World
    vehicles: Sequence[Vehicle[SnapshotT]]
    snapshot: Callable[[float], SnapshotT]
    """Returns what the vehicles see of one another at a Unix time; called before any of them is steered."""
    ground: GroundStation
    look: Callable[[list[Detection], float], None]
    """Shows the ground station what the centre's sensor sees at a Unix time."""
    transmit: Callable[[float], Iterable[tuple[float, bytes]]]
    """Returns what is broadcast from a time of the flight on, until the next tick, each with its own time."""
    recorder: Recorder
    repeat_period_s: float = math.inf
    """How often a companion repeats its setpoint between two decisions."""
    wind: WindField | None = None
    """None: nobody but the owner of the vehicles sets their wind."""
    watch: Watch | None = None


class Loop(Generic[SnapshotT]):
    """A flight under way, one tick after the other."""

    def __init__(self, parts: Parts[SnapshotT]) -> None:
        """Stand at the first tick, which is at time 0."""
        mission = parts.mission
        self._parts = parts
        self._losses_s = {loss.agent: loss.t_s for loss in mission.losses}
        self._guide_every = round(mission.guidance_step_s / mission.integration_step_s)
        self._last_tick = int(mission.max_time_s / mission.integration_step_s + TOLERANCE_S)
        self._next_look_s = 0.0
        self._next_repeat_s = 0.0
        self.tick = 0
        """Ticks that are done."""
        self.guided = 0
        """Ticks of the mission's guidance step that are done."""

    @property
    def t_s(self) -> float:
        """Time of the flight at the next tick."""
        return self.tick * self._parts.mission.integration_step_s

    def step(self) -> bool:
        """Do one tick; return whether the flight goes on. The last tick of a flight is only recorded."""
        parts, t_s = self._parts, self.t_s
        if self.tick:
            for vehicle in parts.vehicles:
                if vehicle.alive:
                    vehicle.move(t_s)
        parts.world.advance(t_s, self._alive_ned_m())
        self._blow(t_s)
        self._lose(t_s)
        agents = np.array([vehicle.row() for vehicle in parts.vehicles])
        things = parts.world.rows()
        alive = [vehicle.alive for vehicle in parts.vehicles]
        if parts.recorder.record(t_s, agents, alive, things) or self.tick == self._last_tick:
            return False
        if t_s >= self._next_look_s - TOLERANCE_S:
            self._look(t_s, things)
            self._next_look_s += LOOK_PERIOD_S
        for at_s, datagram in parts.transmit(t_s):
            for vehicle in parts.vehicles:
                vehicle.transmitted(datagram, at_s)
        if parts.watch is not None:
            parts.watch(t_s, parts.ground, agents)
        self._take_turns(t_s)
        self.tick += 1
        return True

    def _take_turns(self, t_s: float) -> None:
        """Let the companions decide where it is time for it, else repeat where that is due."""
        parts = self._parts
        if self.tick % self._guide_every == 0:
            self._guide(t_s)
            self.guided += 1
            self._next_repeat_s = t_s + parts.repeat_period_s
        elif t_s >= self._next_repeat_s - TOLERANCE_S:
            for vehicle in parts.vehicles:
                if vehicle.alive:
                    vehicle.repeat(t_s)
            self._next_repeat_s += parts.repeat_period_s

    def _guide(self, t_s: float) -> None:
        parts, now_s = self._parts, START_S + t_s
        snapshot = parts.snapshot(now_s)
        for vehicle in parts.vehicles:
            if not vehicle.alive:
                continue
            outcome = vehicle.guide(t_s, snapshot)
            if outcome is not None:
                parts.recorder.decided(vehicle.spec.id, outcome)
            for report in vehicle.report(now_s):
                parts.ground.hear_report(report, now_s)

    def _alive_ned_m(self) -> np.ndarray:  # (A, 2) m
        return np.array([vehicle.row()[:2] for vehicle in self._parts.vehicles if vehicle.alive]).reshape(-1, 2)

    def _blow(self, t_s: float) -> None:
        if self._parts.wind is not None:
            wind_m_s = self._parts.wind.at(t_s)
            for vehicle in self._parts.vehicles:
                vehicle.set_wind(wind_m_s)

    def _lose(self, t_s: float) -> None:
        for vehicle in self._parts.vehicles:
            if vehicle.alive and t_s >= self._losses_s.get(vehicle.spec.id, math.inf):
                vehicle.alive = False

    def _look(self, t_s: float, things: tuple[np.ndarray, np.ndarray]) -> None:
        """Show the centre the targets (K, 4), the threats (M, 4) and, but for Case II, its agents."""
        mission, (targets, threats) = self._parts.mission, things
        visible = self._parts.vehicles if mission.case == "I" else ()
        detections = [vehicle.detection() for vehicle in visible if vehicle.alive]
        detections += world_detections(mission, targets, threats)
        self._parts.look(detections, START_S + t_s)
