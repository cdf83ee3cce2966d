"""One vehicle, its companion and everything that can fail around them, on one virtual clock.

A flight shows what a fault does before it happens to a real vehicle: which failsafe stage the companion reaches and
when, how near a disc or the fence the vehicle comes, and what restores normal flight. The companion's core, the ground
station, the frames and the stand-in autopilots are those of the real programs. Of the process around the core only that
is modelled which a fault can affect: the queue of datagrams, the state files, the clock, and MAVSDK's child process,
which survives a hung parent for half a second.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from companion.autopilot.kinds import CRUISE_M_S
from companion.autopilot.kinds import KINDS as AUTOPILOTS
from companion.onboard.config import Config
from companion.onboard.decision import Decision, Purpose
from groundstation.agents import VehicleModel
from groundstation.ground_station import GroundStation
from sim.faults.broadcast import ContestedBroadcast
from sim.faults.log import Log, Moment
from sim.faults.scene import LOOP_PERIOD_S, SEED, Setting
from sim.faults.vehicle import FaultyVehicle
from sim.loop import START_S, TOLERANCE_S, Loop, Outcome, Parts
from sim.sensor import SensorChannel
from sim.vehicles import StandIn
from sim.world import World


class Flight:
    """A deterministic flight of one vehicle: `at` plans actions, such as faults, and `run` flies."""

    def __init__(self, setting: Setting) -> None:
        """Begin in the air, in the holding mode, with a safety pilot who hands the vehicle over to the companion."""
        mission = setting.mission
        self.setting = setting
        self.cruise_m_s = CRUISE_M_S[setting.kind]
        ground = GroundStation(mission, START_S, model=VehicleModel("routed", AUTOPILOTS[setting.kind].can_stop))
        (spec,) = mission.agents
        self.faulty = FaultyVehicle(setting, spec, lambda: self.t_s)
        self.broadcast = ContestedBroadcast(setting, ground)
        self._world = World(mission, SEED)
        self._loop: Loop[None] = Loop(
            Parts(
                mission=mission,
                world=self._world,
                vehicles=(self.faulty,),
                snapshot=lambda _now_s: None,
                ground=ground,
                look=SensorChannel(mission, START_S, ground).look,
                transmit=self.broadcast.transmit,
                recorder=_Endless(),
                repeat_period_s=LOOP_PERIOD_S,
            )
        )
        self._actions: list[tuple[float, Callable[[Flight], None]]] = []
        self._moments: list[Moment] = []

    def at(self, t_s: float, action: Callable[[Flight], None]) -> Flight:
        """Plan an action for a time of the flight; return the flight, so that calls can be chained."""
        self._actions.append((t_s, action))
        self._actions.sort(key=lambda planned: planned[0])
        return self

    @property
    def t_s(self) -> float:
        """The time of the flight, from its beginning."""
        return self._loop.t_s

    @property
    def vehicle(self) -> StandIn:
        """The stand-in of the vehicle's autopilot."""
        return self.faulty.stand_in

    @property
    def guided(self) -> bool:
        """Whether the autopilot is in its guided mode, in which it obeys the companion."""
        return self.vehicle.mode == self.faulty.pilot.guided_mode

    def run(self, until_s: float) -> Log:
        """Fly on until a time of the flight and return the log of the flight from its beginning."""
        while self.t_s < until_s - TOLERANCE_S:
            while self._actions and self._actions[0][0] <= self.t_s + TOLERANCE_S:
                self._actions.pop(0)[1](self)
            t_s = self.t_s
            self._loop.step()
            self._moments.append(self._moment(t_s))
        return Log(tuple(self._moments))

    def _moment(self, t_s: float) -> Moment:
        """Return the state of vehicle and companion at `t_s`, after the companion's turn."""
        truth, mission, faulty = self.vehicle.truth, self.setting.mission, self.faulty
        place_m = (truth.north_m, truth.east_m)
        _, threats = self._world.rows()
        discs_m = [
            math.dist(place_m, row[:2]) - spec.detection_radius_m
            for spec, row in zip(mission.threats, threats, strict=True)
        ]
        north_m_s, east_m_s = self.vehicle.ground_velocity_m_s
        decision = faulty.process.decision
        is_idle = decision is None or decision.purpose is Purpose.IDLE
        return Moment(
            t_s=t_s,
            north_m=truth.north_m,
            east_m=truth.east_m,
            height_m=truth.altitude_m - mission.origin.alt_m,
            course_rad=math.atan2(east_m_s, north_m_s),
            speed_m_s=truth.speed_m_s,
            guided=self.guided,
            stage=None if is_idle or decision is None else decision.stage,
            purpose=None if decision is None else decision.purpose,
            words=_words(faulty.process.is_dead, decision),
            setpoints=faulty.process.sent,
            disc_m=min(discs_m, default=math.inf),
            fence_m=_within_box_m(place_m, faulty.config),
            other_m=faulty.encounter.distance_m(place_m, t_s),
        )


class _Endless:
    """A recorder that records nothing and never ends the flight: `Flight.run` takes a `Moment` after each tick."""

    def record(
        self, t_s: float, agents: np.ndarray, alive: Sequence[bool], things: tuple[np.ndarray, np.ndarray]
    ) -> bool:
        """Ignore the sample; return False, so that the flight goes on."""
        return False

    def decided(self, agent_id: int, outcome: Outcome) -> None:
        """Ignore the decision."""


def _within_box_m(place_m: tuple[float, float], config: Config) -> float:
    """Return the distance of a place (north, east) to the vehicle's fence, a box along the axes; negative outside."""
    corners_m = np.array(config.limits.fence)
    (south_m, west_m), (north_m, east_m) = corners_m.min(axis=0).tolist(), corners_m.max(axis=0).tolist()
    return float(min(place_m[0] - south_m, north_m - place_m[0], place_m[1] - west_m, east_m - place_m[1]))


def _words(is_dead: bool, decision: Decision | None) -> str:
    """Return in a few words what the companion did and why, as docs/faults.md shows it."""
    if is_dead:
        return "dead"
    if decision is None:
        return "hung"
    if decision.purpose is Purpose.IDLE:
        return f"silent: {decision.reason}"
    why = decision.triggers or (f"{decision.purpose.value}, {decision.reason}",)
    gives_way = "; gives way" if decision.gave_way is not None else ""
    namesake = f"; {decision.note}" if decision.note is not None and "agent id" in decision.note else ""
    return f"{decision.stage.value}: {', '.join(why)}{gives_way}{namesake}"
