"""Flies a mission with any law on the programs' own decisions, without frames between companion and autopilot.

Ground station, broadcast frames, lossy links and companions are those of `sim.lockstep`. Between a companion and its
vehicle no bytes are packed, and the sensor's detections reach the ground station's tracks directly: this saves three
quarters of a flight's cost, which matters for thousands of flights. The flights differ from lockstep's only by the
rounding of telemetry, which is centimetres. The simulator is kinematic: the vehicles are points that turn at a bounded
rate and crab in the wind.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from dataclasses import dataclass

import numpy as np

from companion.autopilot.aircraft import Neighbour
from companion.autopilot.point import PointAdapter
from companion.geo.kinematics import advance, turn_rate_rad_s, turn_towards
from companion.geo.local_frame import LocalFrame
from companion.guidance.laws import SteeringLaw, SteeringOf
from companion.guidance.settings import LawName
from companion.mission.model import AgentSpec, Mission
from companion.mission.random_streams import random_stream
from companion.onboard.companion import Companion
from companion.onboard.config import Config, config_for_agent
from companion.onboard.decision import Certificate, Decision
from companion.onboard.law_settings import law_settings
from companion.protocol.codec import Detection, DetectionsFrame, Kind
from groundstation.agents import VehicleModel
from groundstation.ground_station import GroundStation
from groundstation.radio import Radio
from groundstation.schedule import Broadcaster
from sim.air_link import LINK_STREAM, LossyLink
from sim.flight_record import FlightRecord
from sim.holding import holding_side
from sim.loop import START_S, Loop, Outcome, Parts
from sim.trajectory import Trajectory
from sim.transmitter import RADIO_TICK_S, Transmitter
from sim.wind import WindField, crabbed
from sim.world import World


@dataclass
class AgentFlight:
    """What one agent's companion decided first and last."""

    engaged_t_s: float = math.inf
    """Time of the flight at which it first steered; infinite if it never did."""
    certified_s: float = 0.0
    """For how long the guard certified it then: infinite for ever, 0 not at all."""
    for_ever_t_s: float = math.inf
    """Time of the flight from which on it had been certified for ever at least once; infinite if it never was."""
    last: Decision | None = None


@dataclass(frozen=True)
class ArenaFlight:
    """The trajectory of a flight, and figures of its decisions."""

    trajectory: Trajectory
    decision_us: np.ndarray
    """(D,) us, processor time of each decision: the companion's whole tick, with the frames that came in before it."""
    agents: tuple[AgentFlight, ...]
    """What each agent's companion decided first and last, in the mission's order."""
    guarded: int
    """Number of decisions that the guard changed."""
    certified_s: float
    """For how long the guard certified the agents at their first decision on a picture, the least of them: infinite for
    ever, 0 not at all."""
    uncertified: int
    """Number of decisions for which the guard had no certified back-up."""
    broken: dict[str, int]
    """How often the guard found each of its assumptions broken, by the assumption's name."""
    stays: dict[str, int]
    """How often the law could only loiter, by reason."""
    gave_way: int
    """Number of decisions that the right of way changed."""
    opposed: int
    """Number of decisions for which the part of the surrogate against the route was dropped."""


@dataclass(frozen=True)
class _Snapshot:
    """All vehicles alive at one moment, as their detectors see one another."""

    neighbours: list[Neighbour]
    places_m: np.ndarray  # (A, 2) north, east


class _PointVehicle:
    """A point in the wind that is coupled to its companion directly: telemetry and setpoints cross no wire."""

    def __init__(
        self,
        spec: AgentSpec,
        mission: Mission,
        frame: LocalFrame,
        air: LossyLink,
        config: Config,
        law: SteeringLaw | None,
    ) -> None:
        self.spec = spec
        self.alive = True
        self.north_m, self.east_m = spec.position_ned_m
        self.heading_rad = math.radians(spec.heading_deg or 0.0)
        self._adapter = PointAdapter(False, frame.to_global(self.north_m, self.east_m), config.height_m)
        self._companion = Companion(config, self._adapter, law)
        self._wind_m_s = (0.0, 0.0)
        self._hold_side = holding_side(mission, spec)
        self._mission = mission
        self._frame = frame
        self._air = air

    def row(self) -> tuple[float, float, float, float]:
        """Return north m, east m, heading deg, speed m/s; a lost vehicle stands still where it was lost."""
        heading_deg = math.degrees(self.heading_rad) % 360.0
        return self.north_m, self.east_m, heading_deg, self.spec.speed_m_s if self.alive else 0.0

    def detection(self) -> Detection:
        """Return the vehicle as the ground station's sensor detects it."""
        return Detection(Kind.AGENT, self.spec.id, self.north_m, self.east_m, *self._velocity_m_s())

    def set_wind(self, wind_m_s: tuple[float, float]) -> None:
        """Set the wind (north, east) in m/s from now on."""
        self._wind_m_s = wind_m_s

    def move(self, t_s: float) -> None:
        """Fly for one integration step towards the heading of the last setpoint."""
        dt_s = self._mission.integration_step_s
        pose = (self.north_m, self.east_m, self.heading_rad, self.spec.speed_m_s)
        rate_rad_s = turn_rate_rad_s(self.spec.speed_m_s, self.spec.n_max)
        if self._adapter.setpoint is None:
            # Until its companion has a picture it circles where it is.
            rate_rad_s *= self._hold_side
            self.north_m, self.east_m, self.heading_rad = advance(*pose, rate_rad_s, dt_s)
        else:
            heading_rad = crabbed(self._adapter.setpoint.heading_rad, self.spec.speed_m_s, self._wind_m_s)
            self.north_m, self.east_m, self.heading_rad = turn_towards(*pose, heading_rad, rate_rad_s, dt_s)
        self.north_m += self._wind_m_s[0] * dt_s
        self.east_m += self._wind_m_s[1] * dt_s

    def transmitted(self, datagram: bytes, t_s: float) -> None:
        """Send a datagram of the broadcast on its way through the air to this vehicle."""
        self._air.send(datagram, t_s)

    def observe(self, now_s: float) -> Neighbour:
        """Pass fresh telemetry to the companion; return the vehicle as a neighbour's detector sees it."""
        lat_deg, lon_deg, convergence_rad = self._frame.to_global_with_convergence(self.north_m, self.east_m)
        north_m_s, east_m_s = self._velocity_m_s()
        cosine, sine = math.cos(convergence_rad), math.sin(convergence_rad)
        true_m_s = (north_m_s * cosine - east_m_s * sine, north_m_s * sine + east_m_s * cosine)
        altitude_m = self._mission.origin.alt_m + self._companion.config.height_m
        here = Neighbour(self.spec.id, lat_deg, lon_deg, *true_m_s, now_s, altitude_m)
        self._adapter.tell(here, self.heading_rad + convergence_rad, now_s)
        return here

    def guide(self, t_s: float, snapshot: _Snapshot) -> Outcome:
        """Let the companion detect its neighbours, receive what has arrived, and decide; return the decision."""
        places_m = snapshot.places_m
        apart_m = np.hypot(places_m[:, 0] - self.north_m, places_m[:, 1] - self.east_m)
        range_m = self._mission.detector_range_m if self._mission.detector == "adsb" else -1.0
        near = [snapshot.neighbours[index] for index in np.flatnonzero(apart_m <= range_m)]
        self._adapter.neighbours = [other for other in near if other.agent_id != self.spec.id]
        arrived = list(self._air.deliver(t_s))
        began_ns = time.thread_time_ns()
        for arrival_s, datagram in arrived:
            self._companion.hear(datagram, START_S + arrival_s)
        decision, _ = self._companion.tick(START_S + t_s)
        return Outcome(decision, (time.thread_time_ns() - began_ns) / 1000.0)

    def repeat(self, t_s: float) -> None:
        """Do nothing: a point flies by its last setpoint until the next."""

    def report(self, now_s: float) -> list[bytes]:
        """Return the datagrams of the companion's position report, none if none is due."""
        return self._companion.report(now_s)

    def _velocity_m_s(self) -> tuple[float, float]:
        """Return the velocity (north, east) over the ground in m/s, along the axes of the mission's plane."""
        speed_m_s = self.spec.speed_m_s
        return (
            speed_m_s * math.cos(self.heading_rad) + self._wind_m_s[0],
            speed_m_s * math.sin(self.heading_rad) + self._wind_m_s[1],
        )


class _Record(FlightRecord):
    """Records the true trajectory of a flight, and counts what its companions decided."""

    def __init__(self, mission: Mission) -> None:
        super().__init__(mission)
        self.decision_us: list[float] = []
        self.guarded = self.uncertified = self.gave_way = self.opposed = 0
        self.agents = {agent.id: AgentFlight() for agent in mission.agents}
        self.broken: Counter[str] = Counter()
        self.stays: Counter[str] = Counter()

    def decided(self, agent_id: int, outcome: Outcome) -> None:
        """Add a companion's decision to the counts."""
        super().decided(agent_id, outcome)
        decision = outcome.decision
        self.decision_us.append(outcome.decision_us)
        self._note(self.agents[agent_id], decision)
        self.guarded += bool(decision.guard_changes)
        self.uncertified += decision.uncertified
        self.gave_way += decision.gave_way is not None
        self.opposed += decision.opposed
        self.broken.update(decision.broken)
        if decision.stay is not None:
            self.stays[decision.stay] += 1

    @staticmethod
    def _note(agent: AgentFlight, decision: Decision) -> None:
        t_s = decision.t_s - START_S
        agent.last = decision
        if decision.setpoint is None:
            return
        if math.isinf(agent.engaged_t_s):
            agent.engaged_t_s, agent.certified_s = t_s, decision.certified_s
        if decision.certificate is Certificate.FOR_EVER:
            agent.for_ever_t_s = min(agent.for_ever_t_s, t_s)

    def flight(self) -> ArenaFlight:
        """Return the flight as it was recorded."""
        return ArenaFlight(
            trajectory=self.trajectory(),
            decision_us=np.array(self.decision_us),
            agents=tuple(self.agents.values()),
            guarded=self.guarded,
            certified_s=min(
                (log.start.certified_s for log in self.logs.values() if log.start is not None), default=math.inf
            ),
            uncertified=self.uncertified,
            broken=dict(self.broken),
            stays=dict(self.stays),
            gave_way=self.gave_way,
            opposed=self.opposed,
        )


def fly_arena(
    mission: Mission,
    seed: int,
    law: LawName = "routed",
    steering: SteeringOf | None = None,
    radio: Radio | None = None,
) -> ArenaFlight:
    """Fly a resolved mission until every target is reached, nobody is left, or its time is up.

    `law` configures the companions; `steering`, if given, makes another law for each of them, which flies in its place.
    With a `radio` the broadcast is packed into what that carries.
    """
    frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
    fleet = [_point(mission, index, seed, frame, law, steering) for index in range(len(mission.agents))]
    ground = GroundStation(mission, START_S, model=VehicleModel(law, steering=steering))
    record = _Record(mission)

    def snapshot(now_s: float) -> _Snapshot:
        flying = [vehicle for vehicle in fleet if vehicle.alive]
        places_m = np.array([(vehicle.north_m, vehicle.east_m) for vehicle in flying]).reshape(-1, 2)
        return _Snapshot([vehicle.observe(now_s) for vehicle in flying], places_m)

    def look(detections: list[Detection], now_s: float) -> None:
        origin, time_ms = mission.origin, round(now_s % 1.0 * 1000.0)
        ground.tracks.take(
            DetectionsFrame(int(now_s), time_ms, origin.lat_deg, origin.lon_deg, tuple(detections)), now_s
        )

    loop = Loop(
        Parts(
            mission=mission,
            world=World(mission, seed),
            vehicles=fleet,
            snapshot=snapshot,
            ground=ground,
            look=look,
            transmit=Transmitter(
                Broadcaster(ground, radio), RADIO_TICK_S if radio is None else mission.integration_step_s
            ).transmit,
            recorder=record,
            wind=WindField(mission.wind, seed),
        )
    )
    while loop.step():
        pass
    return record.flight()


def _point(
    mission: Mission, index: int, seed: int, frame: LocalFrame, law: LawName, steering: SteeringOf | None
) -> _PointVehicle:
    """Return the vehicle of the mission's `index`th agent."""
    spec = mission.agents[index]
    config = config_for_agent(mission, spec.id, law)
    air = LossyLink(mission.link, random_stream(seed, LINK_STREAM, index), mission.broadcast_period_s)
    return _PointVehicle(
        spec, mission, frame, air, config, None if steering is None else steering(law_settings(config))
    )
