"""The loop of every simulated flight with real companions: its virtual clock and the order of events in a tick.

In each tick the vehicles fly to its time, targets and threats move, the wind changes and vehicles are lost; the truth
is recorded; the ground station's sensor looks and the ground station broadcasts; then the companions decide, or repeat
their last decision. `Parts` holds what differs between flights: how a vehicle is coupled to its companion (by frames
through a stand-in, or directly), how the ground station gets the truth, what is transmitted, what is recorded. The
flight on the pure core (sim/reproduction/core_flight.py) has a loop of its own, because it checks this one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from companion.mission.model import AgentSpec, Mission
from companion.onboard.decision import Decision
from companion.protocol.codec import Detection
from groundstation.ground_station import GroundStation
from groundstation.sightings import places_in
from sim.sensor import LOOK_PERIOD_S, world_detections
from sim.wind import WindField
from sim.world import World

START_S = 1_767_225_600.0
"""Unix time at which every flight begins: 2026-01-01T00:00:00Z, so that logs are the same each time."""
TOLERANCE_S = 1e-6
"""Time by which an event may be early and still counts as due."""

SnapshotT = TypeVar("SnapshotT")
SnapshotT_contra = TypeVar("SnapshotT_contra", contravariant=True)

Watch = Callable[[float, GroundStation, np.ndarray], None]
"""Function called at every tick with the virtual time in seconds, the ground station, and the agents' rows (N, 4)."""


class Outcome(NamedTuple):
    """A companion's decision in one tick, and how long it took."""

    decision: Decision
    decision_us: float
    """Wall-clock duration of the decision."""


class Vehicle(Protocol[SnapshotT_contra]):
    """One vehicle with its companion and its end of the broadcast link, as the loop sees them."""

    spec: AgentSpec
    alive: bool

    def row(self) -> tuple[float, float, float, float]:
        """Return the true north m, east m, heading deg and speed m/s; a lost vehicle stays where it was lost."""
        ...

    def detection(self) -> Detection:
        """Return what the ground station's sensor sees of the vehicle: its true position and velocity."""
        ...

    def set_wind(self, wind_m_s: tuple[float, float]) -> None:
        """Set the velocity of the air (north, east) from now on."""
        ...

    def move(self, t_s: float) -> None:
        """Fly on to a time of the flight."""
        ...

    def transmitted(self, datagram: bytes, t_s: float) -> None:
        """Take a datagram of the broadcast sent at `t_s`; the vehicle's link decides when it arrives, if at all."""
        ...

    def guide(self, t_s: float, snapshot: SnapshotT_contra) -> Outcome | None:
        """Give the companion its inputs and the neighbours' `snapshot`; return its decision, or None."""
        ...

    def repeat(self, t_s: float) -> None:
        """Let the companion repeat the setpoint of its last decision."""
        ...

    def report(self, now_s: float) -> list[bytes]:
        """Return the frames that the companion reports to the ground station at a Unix time."""
        ...


class Recorder(Protocol):
    """Takes samples and decisions of a flight, and decides when it is over."""

    def record(
        self, t_s: float, agents: np.ndarray, alive: Sequence[bool], things: tuple[np.ndarray, np.ndarray]
    ) -> bool:
        """Take the true rows of agents (N, 4), targets (K, 4), threats (M, 4); return whether the flight is over.

        A row is north m, east m, heading deg, speed m/s; `things` are the targets' and the threats' rows, and `alive`
        says which agents are not lost.
        """
        ...

    def decided(self, agent_id: int, outcome: Outcome) -> None:
        """Take a companion's decision."""
        ...


@dataclass(frozen=True)
class Parts(Generic[SnapshotT]):
    """The parts of which a `Loop` consists."""

    mission: Mission
    world: World
    vehicles: Sequence[Vehicle[SnapshotT]]
    snapshot: Callable[[float], SnapshotT]
    """Function that returns what the vehicles see of one another at a Unix time; called before they decide."""
    ground: GroundStation
    look: Callable[[list[Detection], float], None]
    """Function that gives the ground station the detections of its sensor at a Unix time."""
    transmit: Callable[[float], Iterable[tuple[float, bytes]]]
    """Function that returns the datagrams broadcast from a time until the next tick, each with its time."""
    recorder: Recorder
    repeat_period_s: float = math.inf
    """Time between two repetitions of a setpoint within a guidance step; infinity: setpoints are not repeated."""
    wind: WindField | None = None
    """The wind that the loop sets; None: it sets none."""
    watch: Watch | None = None


class Loop(Generic[SnapshotT]):
    """A flight under way; `step` does one tick."""

    def __init__(self, parts: Parts[SnapshotT]) -> None:
        """Begin before the first tick, which is at time 0."""
        mission = parts.mission
        self._parts = parts
        self._listed = frozenset(key for key, _ in places_in(mission))
        self._losses_s = {loss.agent: loss.t_s for loss in mission.losses}
        self._guide_every = round(mission.guidance_step_s / mission.integration_step_s)
        self._last_tick = int(mission.max_time_s / mission.integration_step_s + TOLERANCE_S)
        self._next_look_s = 0.0
        self._next_repeat_s = 0.0
        self.tick = 0
        """Number of ticks that are done."""
        self.guided = 0
        """Number of guidance steps that are done."""

    @property
    def t_s(self) -> float:
        """Time of the flight, in seconds, at the next tick."""
        return self.tick * self._parts.mission.integration_step_s

    def step(self) -> bool:
        """Do one tick; return whether the flight goes on. In the last tick of a flight the truth is only recorded."""
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
        """Let the companions decide if a guidance step is due, else repeat their setpoints if that is due."""
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
        """Give the ground station detections of the targets (K, 4), the threats (M, 4) and, in Case I, the agents."""
        mission = self._parts.world.mission
        visible = self._parts.vehicles if mission.case == "I" else ()
        detections = [vehicle.detection() for vehicle in visible if vehicle.alive]
        # What a live source has added is that source's to see: the sensor has no id for it.
        of_sources = set(self._parts.ground.operations.tracks.values()) - self._listed
        detections += [one for one in world_detections(mission, *things) if (one.kind, one.id) not in of_sources]
        self._parts.look(detections, START_S + t_s)
