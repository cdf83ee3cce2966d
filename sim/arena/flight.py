"""Flies a mission with any law, on the programs' own decisions but without the autopilot's frames.

Ground station, broadcast frames, lossy links and companions are those of `sim.lockstep`; between a companion and its
vehicle no bytes are packed, and the sensor's looks reach the centre's picture directly. That is three quarters of a
flight's cost, and thousands of flights need it. What differs is the rounding of telemetry, centimetres. Kinematic:
the vehicles are points that turn at a bounded rate and crab in the wind.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from companion.autopilot.adapter import NoAutopilot
from companion.autopilot.telemetry import Neighbour, Telemetry
from companion.geo.kinematics import advance, turn_rate_rad_s, turn_towards
from companion.geo.local_frame import LocalFrame
from companion.guard.types import Setpoint
from companion.guidance.laws import SteeringOf
from companion.guidance.settings import LawName
from companion.mission.model import AgentSpec, Mission
from companion.mission.random_streams import random_stream
from companion.onboard.companion import Companion
from companion.onboard.config import config_for_agent
from companion.onboard.decision import Decision
from companion.onboard.law_settings import law_settings
from companion.protocol.codec import Detection, DetectionsFrame, Kind
from groundstation.ground_station import GroundStation
from sim.air_link import LINK_STREAM, LossyLink
from sim.arrivals import Arrivals
from sim.lockstep import START_S
from sim.sensor import LOOK_PERIOD_S, seen
from sim.trajectory import Trajectory, TrajectoryBuilder
from sim.wind import WindField, crabbed
from sim.world import World

_TOLERANCE_S = 1e-6


@dataclass(frozen=True)
class ArenaFlight:
    """What a flight left behind."""

    trajectory: Trajectory
    decision_us: np.ndarray  # (D,) us, wall-clock time of each companion's whole decision
    guarded: int
    """Decisions that the guard changed."""
    certified: bool
    """Whether the guard had a certified back-up for every agent's first decision on a picture."""
    uncertified: int
    """Decisions for which the guard had no certified back-up."""
    broken: dict[str, int]
    """How often the guard named which of its assumptions."""
    stays: dict[str, int]
    """How often the law could do no better than to loiter, by why."""
    gave_way: int
    opposed: int


class _Vehicle(NoAutopilot):
    """A point in the wind; to its companion it is what an adapter would be."""

    can_stop = False

    def __init__(
        self, spec: AgentSpec, mission: Mission, frame: LocalFrame, law: LawName, steering: SteeringOf | None
    ) -> None:
        config = config_for_agent(mission, spec.id, law)
        self.spec = spec
        self.companion = Companion(config, self, None if steering is None else steering(law_settings(config)))
        self.neighbours: list[Neighbour] = []
        self.telemetry = Telemetry()
        self.north_m, self.east_m = spec.position_ned_m
        self.heading_rad = math.radians(spec.heading_deg or 0.0)
        self.wind_m_s = (0.0, 0.0)
        self.alive = True
        self._rate_rad_s = turn_rate_rad_s(spec.speed_m_s, spec.n_max)
        self._wanted_rad: float | None = None
        self._frame = frame
        self._home_deg = frame.to_global(self.north_m, self.east_m)
        self._height_m = config.height_m
        self._altitude_m = mission.origin.alt_m + config.height_m

    def encode(self, setpoint: Setpoint, convergence_rad: float, now_s: float) -> list[bytes]:
        """Take the setpoint: the vehicle is right here."""
        self._wanted_rad = setpoint.heading_rad
        return []

    @property
    def velocity_m_s(self) -> tuple[float, float]:
        """(north, east) over the ground, along the grid."""
        speed_m_s = self.spec.speed_m_s
        return (
            speed_m_s * math.cos(self.heading_rad) + self.wind_m_s[0],
            speed_m_s * math.sin(self.heading_rad) + self.wind_m_s[1],
        )

    def row(self) -> tuple[float, float, float, float]:
        """Return north m, east m, heading deg, speed m/s; a lost vehicle stands where it was lost."""
        heading_deg = math.degrees(self.heading_rad) % 360.0
        return self.north_m, self.east_m, heading_deg, self.spec.speed_m_s if self.alive else 0.0

    def observe(self, now_s: float) -> Neighbour:
        """Refresh the telemetry; return the vehicle as a neighbour's detector sees it."""
        lat_deg, lon_deg, convergence_rad = self._frame.to_global_with_convergence(self.north_m, self.east_m)
        north_m_s, east_m_s = self.velocity_m_s
        cosine, sine = math.cos(convergence_rad), math.sin(convergence_rad)
        true_m_s = (north_m_s * cosine - east_m_s * sine, north_m_s * sine + east_m_s * cosine)
        self.telemetry = Telemetry(
            system_id=1,
            heartbeat_at_s=now_s,
            armed=True,
            position_at_s=now_s,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            height_m=self._height_m,
            altitude_m=self._altitude_m,
            velocity_north_m_s=true_m_s[0],
            velocity_east_m_s=true_m_s[1],
            yaw_rad=self.heading_rad + convergence_rad,
            home_deg=self._home_deg,
            in_air=True,
        )
        return Neighbour(self.spec.id, lat_deg, lon_deg, *true_m_s, now_s, self._altitude_m)

    def move(self, dt_s: float) -> None:
        """Fly on by the last setpoint for a step."""
        pose = (self.north_m, self.east_m, self.heading_rad, self.spec.speed_m_s)
        if self._wanted_rad is None:
            # Until its companion has a picture it circles where it is.
            self.north_m, self.east_m, self.heading_rad = advance(*pose, self._rate_rad_s, dt_s)
        else:
            heading_rad = crabbed(self._wanted_rad, self.spec.speed_m_s, self.wind_m_s)
            self.north_m, self.east_m, self.heading_rad = turn_towards(*pose, heading_rad, self._rate_rad_s, dt_s)
        self.north_m += self.wind_m_s[0] * dt_s
        self.east_m += self.wind_m_s[1] * dt_s


class _Flying:
    """A flight under way."""

    def __init__(self, mission: Mission, seed: int, law: LawName, steering: SteeringOf | None) -> None:
        frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        self._mission = mission
        self._ground = GroundStation(mission, START_S, law=law, steering=steering)
        self._world = World(mission, seed)
        self._wind = WindField(mission.wind, seed)
        self._fleet = [_Vehicle(spec, mission, frame, law, steering) for spec in mission.agents]
        self._links = [
            LossyLink(mission.link, random_stream(seed, LINK_STREAM, index), mission.broadcast_period_s)
            for index in range(len(self._fleet))
        ]
        self._losses_s = {loss.agent: loss.t_s for loss in mission.losses}
        self._arrivals = Arrivals(mission)
        self._trajectory = TrajectoryBuilder(
            [agent.id for agent in mission.agents],
            [target.id for target in mission.targets],
            [threat.id for threat in mission.threats],
        )
        self._decision_us: list[float] = []
        self._guarded = self._uncertified = self._gave_way = self._opposed = 0
        self._first: dict[int, bool] = {}
        """Agents that have a picture, and whether they were certified on the first."""
        self._broken: dict[str, int] = {}
        self._stays: dict[str, int] = {}

    def run(self) -> ArenaFlight:
        """Fly to the end."""
        mission, step_s = self._mission, self._mission.integration_step_s
        guide_every = round(mission.guidance_step_s / step_s)
        last_tick = int(mission.max_time_s / step_s + _TOLERANCE_S)
        next_look_s = 0.0
        for tick in range(last_tick + 1):
            t_s = tick * step_s
            alive = [vehicle for vehicle in self._fleet if vehicle.alive]
            self._world.advance(t_s, np.array([(v.north_m, v.east_m) for v in alive]).reshape(-1, 2))
            wind_m_s = self._wind.at(t_s)
            for vehicle in self._fleet:
                vehicle.wind_m_s = wind_m_s
                vehicle.alive = t_s < self._losses_s.get(vehicle.spec.id, math.inf)
            if self._record(t_s) or tick == last_tick:
                break
            if t_s >= next_look_s - _TOLERANCE_S:
                self._look(t_s)
                next_look_s += LOOK_PERIOD_S
            for datagram in self._ground.tick(START_S + t_s):
                for link in self._links:
                    link.send(datagram, t_s)
            if tick % guide_every == 0:
                self._guide(t_s)
            for vehicle in self._fleet:
                if vehicle.alive:
                    vehicle.move(step_s)
        return ArenaFlight(
            trajectory=self._trajectory.build(),
            decision_us=np.array(self._decision_us),
            guarded=self._guarded,
            certified=all(self._first.values()),
            uncertified=self._uncertified,
            broken=self._broken,
            stays=self._stays,
            gave_way=self._gave_way,
            opposed=self._opposed,
        )

    def _record(self, t_s: float) -> bool:
        """Log the truth and note arrivals; return whether the flight is over."""
        agents = np.array([vehicle.row() for vehicle in self._fleet])
        targets, threats = self._world.rows()
        self._trajectory.append(t_s, agents, targets, threats)
        return self._arrivals.note(agents[:, :2], [vehicle.alive for vehicle in self._fleet], targets[:, :2])

    def _look(self, t_s: float) -> None:
        mission, now_s = self._mission, START_S + t_s
        targets, threats = self._world.rows()
        detections = [
            Detection(Kind.AGENT, v.spec.id, v.north_m, v.east_m, *v.velocity_m_s)
            for v in self._fleet
            if v.alive and mission.case == "I"
        ]
        detections += [seen(Kind.TARGET, spec.id, row) for spec, row in zip(mission.targets, targets, strict=True)]
        detections += [seen(Kind.THREAT, spec.id, row) for spec, row in zip(mission.threats, threats, strict=True)]
        origin = mission.origin
        look = DetectionsFrame(
            int(now_s), round(now_s % 1.0 * 1000.0), origin.lat_deg, origin.lon_deg, tuple(detections)
        )
        self._ground.tracks.take(look, now_s)

    def _guide(self, t_s: float) -> None:
        """Let everybody see the same moment, then decide."""
        now_s = START_S + t_s
        flying = [(vehicle, link) for vehicle, link in zip(self._fleet, self._links, strict=True) if vehicle.alive]
        echoes = [vehicle.observe(now_s) for vehicle, _ in flying]
        places = np.array([(vehicle.north_m, vehicle.east_m) for vehicle, _ in flying]).reshape(-1, 2)
        for index, (vehicle, link) in enumerate(flying):
            apart_m = np.hypot(places[:, 0] - vehicle.north_m, places[:, 1] - vehicle.east_m)
            near = np.flatnonzero(apart_m <= self._mission.detector_range_m)
            vehicle.neighbours = [echoes[other] for other in near.tolist() if other != index]
            for arrival_s, datagram in link.deliver(t_s):
                vehicle.companion.hear(datagram, START_S + arrival_s)
            began_ns = time.perf_counter_ns()
            decision, _ = vehicle.companion.tick(now_s)
            self._decision_us.append((time.perf_counter_ns() - began_ns) / 1000.0)
            self._count(vehicle.spec.id, decision)
            for report in vehicle.companion.report(now_s):
                self._ground.hear_report(report, now_s)

    def _count(self, agent_id: int, decision: Decision) -> None:
        if decision.picture_age_s is not None:
            self._first.setdefault(agent_id, not decision.uncertified)
        self._guarded += bool(decision.guard_changes)
        self._uncertified += decision.uncertified
        self._gave_way += decision.gave_way is not None
        self._opposed += decision.opposed
        for name in decision.broken:
            self._broken[name] = self._broken.get(name, 0) + 1
        if decision.stay is not None:
            self._stays[decision.stay] = self._stays.get(decision.stay, 0) + 1


def fly_arena(mission: Mission, seed: int, law: LawName = "routed", steering: SteeringOf | None = None) -> ArenaFlight:
    """Fly a resolved mission until every target is reached, nobody is left, or its time is up.

    `law` configures the companions; `steering` makes another law for each of them in its place.
    """
    return _Flying(mission, seed, law, steering).run()
