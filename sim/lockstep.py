"""Flies a mission with everything on one virtual clock.

Ground station, companions, sensor and vehicles are those of the real programs and exchange nothing but encoded frames.
Kinematic: the vehicles are points that turn at a bounded rate, not aircraft, and obey their companion from the start.
The stand-ins of real autopilots fly, are told setpoints and tell telemetry ten times a second, and a person hands them
over (sim/safety_pilot.py). The same mission and seed give the same trajectory, bit for bit.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import common

from companion.autopilot.registry import ADAPTERS
from companion.errors import InputError
from companion.files.tlog import TlogWriter
from companion.geo.local_frame import LocalFrame
from companion.mission.model import AgentSpec, Mission
from companion.mission.random_streams import random_stream
from companion.onboard.companion import Companion, Decision
from companion.onboard.config import AutopilotSection, Law, config_for_agent, dump_config
from companion.onboard.flight_log import Mark, decision_frame, mark_frame
from companion.protocol.codec import Detection, FrameWriter, Kind
from companion.protocol.v2_extension import wrap
from companion.runtime.clock import logged_s
from companion.surrogate.networks import load_monolithic
from groundstation.ground_station import GroundStation, check_runnable
from groundstation.radio import Radio
from groundstation.schedule import Broadcaster
from sim.air_link import LINK_STREAM, LossyLink, Tamper
from sim.arrivals import Arrivals
from sim.detector import Detector, Fleet
from sim.safety_pilot import SafetyPilot
from sim.scaling import CRUISE_M_S
from sim.sensor import LOOK_PERIOD_S, mission_sensor, seen
from sim.trajectory import Trajectory, TrajectoryBuilder
from sim.vehicles import CRAFTS, LOCKSTEP_RATES_HZ, Craft, Home, StandIn, Start, kinematic_profile
from sim.vehicles.routing import Router
from sim.vehicles.stand_in import parse
from sim.wind import WindField
from sim.world import World

START_S = 1_767_225_600.0
"""Unix time at which every flight begins: 2026-01-01T00:00:00Z, so that logs are the same each time."""
AUTOPILOTS = ("kinematic", *CRUISE_M_S)
"""Kinds that missions are flown with."""
KINEMATIC_REPEAT_S = 1.0
"""A point's setpoint is repeated so often between guidance steps; it obeys the last one for longer."""
LOOP_PERIOD_S = 0.1
"""Of the stand-ins of real autopilots: setpoints and telemetry at 10 Hz, as `companion run` does."""
RADIO_TICK_S = 0.05
"""How often a radio is asked what goes out: as the ground station's shell does."""
WHY_NOT_MONOLITHIC = "trained as the paper says it explains one percent of the penalties, so its gradient is noise"
_COMPANION_LINK, _RADIO_LINK = 0, 1
"""An autopilot's links where the broadcast comes through it."""
_TOLERANCE_S = 1e-6
_POSITION = common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
_MAX_SYSTEM_ID = 250
"""Greatest MAVLink system id given to a vehicle; above it ids are habitually ground stations'."""

Progress = Callable[[float, int], None]
"""Called now and then with the virtual time in seconds and the number of targets reached."""
Watch = Callable[[float, GroundStation, np.ndarray], None]
"""Called at every step with the virtual time in seconds, the ground station, and the agents' true rows (N, 4)."""


@dataclass(frozen=True)
class Flight:
    """What a flight left behind, beside its logs."""

    trajectory: Trajectory
    steps: int
    """Guidance steps of the mission's clock."""
    decision_us: np.ndarray  # (D,) us, wall-clock time of each companion's decision
    turn_limited_steps: int
    guard_interventions: int
    broadcast_frames: int
    broadcast_bytes: int
    frames_lost: int
    """Summed over receivers."""
    speedup: float
    """Virtual over wall-clock time."""
    companions: dict[int, Companion]


class _Aircraft:
    """A vehicle, its companion and its end of the link."""

    def __init__(
        self,
        spec: AgentSpec,
        companion: Companion,
        vehicle: StandIn,
        detector: Detector | None,
        link: LossyLink,
        log: TlogWriter | None,
        person: SafetyPilot | None,
        router: Router | None,
    ) -> None:
        self.spec = spec
        self.companion = companion
        self.vehicle = vehicle
        self.detector = detector
        self.link = link
        self.log = log
        self.person = person
        self._router = router
        self.alive = True
        self._marks = FrameWriter()

    def row(self) -> tuple[float, float, float, float]:
        """Return north m, east m, heading deg, speed m/s; a lost vehicle stands where it was lost."""
        truth = self.vehicle.truth
        heading_deg = float(np.degrees(truth.heading_rad)) % 360.0
        return truth.north_m, truth.east_m, heading_deg, truth.speed_m_s if self.alive else 0.0

    def seen(self) -> Detection:
        """Return what the centre's sensor sees of it."""
        truth = self.vehicle.truth
        return Detection(Kind.AGENT, self.spec.id, truth.north_m, truth.east_m, *self.vehicle.ground_velocity_m_s)

    def hear(self, t_s: float) -> None:
        """Let the companion hear what the air has delivered by now."""
        for arrival_s, datagram in self.link.deliver(t_s):
            heard_s = logged_s(START_S + arrival_s)
            for passed_on in self._passed_on(datagram):
                for frame in self.companion.hear(passed_on, heard_s):
                    self._log(frame.data, heard_s)

    def _passed_on(self, datagram: bytes) -> list[bytes]:
        """Return what the companion gets of the broadcast: all, or what the autopilot that hears it passes on."""
        if self._router is None:
            return [datagram]
        return [frame for link, frame in self._router.route(_RADIO_LINK, parse(datagram)) if link == _COMPANION_LINK]

    def exchange_telemetry(self, now_s: float) -> None:
        """Let the companion hear what the autopilot says by itself."""
        for frame in self.vehicle.telemetry(now_s):
            self._log(frame, now_s)
            self.companion.receive(frame, now_s)

    def look(self, fleet: Fleet, now_s: float) -> None:
        """Let the companion know whom the vehicle's own detector sees."""
        for frame in [] if self.detector is None else self.detector.look(fleet):
            self._log(frame, now_s)
            self.companion.receive(frame, now_s)

    def steer(self, now_s: float) -> tuple[Decision, float]:
        """Let the companion decide and the vehicle hear it; return the decision and its wall-clock time in us."""
        began_ns = time.perf_counter_ns()
        decision, frames = self.companion.tick(now_s)
        decision_us = (time.perf_counter_ns() - began_ns) / 1000.0
        if self.log is not None:
            self._log(self._marks.encode(decision_frame(decision)), now_s)
        self._send(frames, now_s)
        return decision, decision_us

    def repeat(self, now_s: float) -> None:
        """Let the companion keep its last decision standing."""
        stood = self.companion.steers
        frames = self.companion.repeat(now_s)
        if stood and not self.companion.steers:
            self._log(mark_frame(Mark.WITHDRAWN, self.spec.id), now_s)
        self._send(frames, now_s)

    def mind_person(self, t_s: float) -> None:
        """Let the person do to the vehicle, on a link of his own, what there is to do."""
        for order in [] if self.person is None else self.person.orders(t_s, self.vehicle.mode):
            self.vehicle.receive(order, START_S + t_s)

    def _send(self, frames: list[bytes], now_s: float) -> None:
        for frame in frames:
            self._log(frame, now_s)
            if self._router is not None:
                self._router.route(_COMPANION_LINK, parse(frame))
            for reply in self.vehicle.receive(frame, now_s):
                self._log(reply, now_s)
                self.companion.receive(reply, now_s)

    def _log(self, frame: bytes, now_s: float) -> None:
        if self.log is not None:
            self.log.write(now_s, frame)


def check_flyable(mission: Mission, source: str | None = None, allow_monolithic: bool = False) -> None:
    """Raise InputError if a resolved mission asks for what is not flown; silence would be a wrong answer.

    `source` names the file in errors.
    """
    source = source or mission.name
    check_runnable(mission, source)
    if mission.surrogate == "monolithic":
        if not allow_monolithic:
            raise InputError(
                f"{source}: surrogate: 'monolithic' is not flown: {WHY_NOT_MONOLITHIC}; allowed: pairwise, analytic, "
                "or --allow-monolithic to see it"
            )
        _check_slots(mission, source)


def _check_slots(mission: Mission, source: str) -> None:
    """Raise InputError unless everything has a place among the inputs of the one network, which are numbered."""
    network = load_monolithic()
    for key, ids, places in (
        ("agents", [agent.id for agent in mission.agents], network.agents),
        ("threats", [threat.id for threat in mission.threats], network.threats),
    ):
        for index, identity in enumerate(ids):
            if identity > places:
                raise InputError(
                    f"{source}: {key}[{index}].id: {identity}; allowed: 1 to {places}, the inputs of the monolithic "
                    "network"
                )


def fly(
    mission: Mission,
    seed: int,
    law: Law = "seed",
    autopilot: str = "kinematic",
    out: Path | None = None,
    realtime: bool = False,
    progress: Progress | None = None,
    tamper: Tamper | None = None,
    watch: Watch | None = None,
    allow_monolithic: bool = False,
    radio: Radio | None = None,
    one_radio: bool = False,
) -> Flight:
    """Fly a resolved mission until every target is reached, nobody is left, or its time is up.

    `out` is a folder for the `.tlog` files and the companions' configurations. `tamper` changes frames in the air,
    `watch` looks on: for tests and measurements. `allow_monolithic` flies with the paper's one network, which steers by
    noise. Over a `radio` the broadcast is what fits it; without one, what the mission's periods say. With `one_radio`
    it reaches each companion through its autopilot, inside V2_EXTENSION.

    Raises:
        InputError: the mission asks for something that is not flown.

    """
    check_flyable(mission, allow_monolithic=allow_monolithic)
    if mission.surrogate == "monolithic" and law != "seed":
        raise InputError(f"--law: '{law}' has no use for surrogate 'monolithic'; allowed: seed")
    with ExitStack() as stack:

        def log(name: str) -> TlogWriter | None:
            return None if out is None else stack.enter_context(TlogWriter(out / name))

        flying = _Flying(mission, seed, law, autopilot, log, tamper, radio, one_radio)
        if out is not None:
            flying.write_configs(out, autopilot)
        return flying.run(realtime, progress, watch)


class _Flying:
    """A flight under way."""

    def __init__(
        self,
        mission: Mission,
        seed: int,
        law: Law,
        autopilot: str,
        log: Callable[[str], TlogWriter | None],
        tamper: Tamper | None,
        radio: Radio | None,
        one_radio: bool,
    ) -> None:
        self._mission = mission
        self._one_radio = one_radio
        self._wraps = one_radio and radio is None
        self._frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        self._is_point = autopilot == "kinematic"
        can_stop = ADAPTERS[autopilot]().can_stop
        self._ground = GroundStation(mission, START_S, law=law, can_stop=can_stop)
        self._broadcaster = Broadcaster(self._ground, radio)
        # A radio's frames leave one after the other within a step, not all at its beginning.
        self._radio_ticks_s = np.arange(0.0, mission.integration_step_s if radio else RADIO_TICK_S, RADIO_TICK_S)
        self._sensor = mission_sensor(mission, int(START_S))
        self._world = World(mission, seed)
        self._wind = WindField(mission.wind, seed)
        self._broadcast_log = log("broadcast.tlog")
        self._fleet = [
            self._aircraft(spec, index, seed, law, autopilot, log(f"vehicle-{spec.id}.tlog"), tamper)
            for index, spec in enumerate(mission.agents)
        ]
        self._losses_s = {loss.agent: loss.t_s for loss in mission.losses}
        self._trajectory = TrajectoryBuilder(
            [agent.id for agent in mission.agents],
            [target.id for target in mission.targets],
            [threat.id for threat in mission.threats],
        )
        self._arrivals = Arrivals(mission)
        self._decision_us: list[float] = []
        self._turn_limited = self._guarded = self._frames = self._bytes = 0

    def _aircraft(
        self,
        spec: AgentSpec,
        index: int,
        seed: int,
        law: Law,
        autopilot: str,
        log: TlogWriter | None,
        tamper: Tamper | None,
    ) -> _Aircraft:
        config = config_for_agent(self._mission, spec.id, law)
        north_m, east_m = spec.position_ned_m
        system_id = index % _MAX_SYSTEM_ID + 1
        vehicle = StandIn(
            _build(autopilot, spec),
            system_id,
            self._frame,
            north_m=north_m,
            east_m=east_m,
            altitude_m=self._mission.origin.alt_m + config.height_m,
            heading_rad=float(np.radians(spec.heading_deg or 0.0)),
            speed_m_s=0.0 if ADAPTERS[autopilot]().can_stop else spec.speed_m_s,
            home=Home(north_m, east_m, self._mission.origin.alt_m),
            in_air=True,
            armed=True,
            guided=self._is_point,
            start_s=START_S,
            rates_hz={**LOCKSTEP_RATES_HZ, _POSITION: 1.0 / self._mission.guidance_step_s},
        )
        link = LossyLink(
            self._mission.link,
            random_stream(seed, LINK_STREAM, index),
            self._mission.broadcast_period_s,
            tamper,
        )
        detector = None
        if self._mission.case == "II" or law == "routed":
            detector = Detector(spec.id, system_id, self._frame, self._mission.detector_range_m)
        person = None if self._is_point else SafetyPilot(autopilot, system_id)
        router = Router(system_id) if self._one_radio else None
        return _Aircraft(spec, Companion(config, ADAPTERS[autopilot]()), vehicle, detector, link, log, person, router)

    def write_configs(self, folder: Path, autopilot: str) -> None:
        """Write what each companion flies by, for a replay: there its autopilot is the log."""
        for aircraft in self._fleet:
            heard = AutopilotSection(kind=autopilot, link=f"file:vehicle-{aircraft.spec.id}.tlog")
            config = aircraft.companion.config.model_copy(update={"autopilot": heard})
            (folder / f"companion-{aircraft.spec.id}.yaml").write_text(dump_config(config), encoding="utf-8")

    def run(self, realtime: bool, progress: Progress | None, watch: Watch | None) -> Flight:
        """Fly to the end."""
        mission = self._mission
        step_s = mission.integration_step_s
        guide_every = round(mission.guidance_step_s / step_s)
        last_tick = int(mission.max_time_s / step_s + _TOLERANCE_S)
        next_look_s = next_repeat_s = 0.0
        repeat_s = KINEMATIC_REPEAT_S if self._is_point else LOOP_PERIOD_S
        steps = 0
        began_s = time.perf_counter()
        for tick in range(last_tick + 1):
            t_s = tick * step_s
            self._world.advance(t_s, self._alive_ned_m())
            wind_m_s = self._wind.at(t_s)
            for aircraft in self._fleet:
                aircraft.vehicle.wind_m_s = wind_m_s
            self._lose(t_s)
            agents, over = self._record(t_s)
            if progress is not None and tick % 100 == 0:
                progress(t_s, len(mission.targets) - len(self._arrivals.open))
            if over or tick == last_tick:
                break
            if t_s >= next_look_s - _TOLERANCE_S:
                self._look(t_s)
                next_look_s += LOOK_PERIOD_S
            self._broadcast(t_s)
            if watch is not None:
                watch(t_s, self._ground, agents)
            if tick % guide_every == 0:
                self._guide(t_s)
                steps += 1
                next_repeat_s = t_s + repeat_s
            elif t_s >= next_repeat_s - _TOLERANCE_S:
                self._repeat(t_s)
                next_repeat_s += repeat_s
            self._fly_on(t_s, step_s)
            if realtime:
                time.sleep(max(0.0, began_s + t_s + step_s - time.perf_counter()))
        elapsed_s = time.perf_counter() - began_s
        trajectory = self._trajectory.build()
        return Flight(
            trajectory=trajectory,
            steps=steps,
            decision_us=np.array(self._decision_us),
            turn_limited_steps=self._turn_limited,
            guard_interventions=self._guarded,
            broadcast_frames=self._frames,
            broadcast_bytes=self._bytes,
            frames_lost=sum(aircraft.link.lost for aircraft in self._fleet),
            speedup=float(trajectory.t_s[-1]) / elapsed_s if elapsed_s > 0.0 else 0.0,
            companions={aircraft.spec.id: aircraft.companion for aircraft in self._fleet},
        )

    def _fly_on(self, t_s: float, step_s: float) -> None:
        """Let everybody fly one step, with the companion's loop within it where there is an autopilot."""
        loops = 1 if self._is_point else max(1, round(step_s / LOOP_PERIOD_S))
        for aircraft in self._fleet:
            if not aircraft.alive:
                continue
            for loop in range(1, loops):
                at_s = t_s + loop * step_s / loops
                aircraft.vehicle.step_to(START_S + at_s)
                aircraft.mind_person(at_s)
                aircraft.exchange_telemetry(START_S + at_s)
                aircraft.repeat(START_S + at_s)
            aircraft.vehicle.step_to(START_S + t_s + step_s)
            aircraft.mind_person(t_s + step_s)

    def _alive_ned_m(self) -> np.ndarray:  # (A, 2) m
        return np.array([aircraft.row()[:2] for aircraft in self._fleet if aircraft.alive]).reshape(-1, 2)

    def _lose(self, t_s: float) -> None:
        for aircraft in self._fleet:
            if aircraft.alive and t_s >= self._losses_s.get(aircraft.spec.id, np.inf):
                aircraft.alive = False

    def _record(self, t_s: float) -> tuple[np.ndarray, bool]:  # (N, 4)
        """Log the truth and note arrivals; return the agents and whether it is over."""
        agents = np.array([aircraft.row() for aircraft in self._fleet])
        targets, threats = self._world.rows()
        self._trajectory.append(t_s, agents, targets, threats)
        over = self._arrivals.note(agents[:, :2], [aircraft.alive for aircraft in self._fleet], targets[:, :2])
        return agents, over

    def _look(self, t_s: float) -> None:
        mission = self._mission
        targets, threats = self._world.rows()
        # In Case II the centre cannot see its agents.
        visible = self._fleet if mission.case == "I" else []
        detections = [aircraft.seen() for aircraft in visible if aircraft.alive]
        detections += [seen(Kind.TARGET, spec.id, row) for spec, row in zip(mission.targets, targets, strict=True)]
        detections += [seen(Kind.THREAT, spec.id, row) for spec, row in zip(mission.threats, threats, strict=True)]
        for datagram in self._sensor.look(detections, START_S + t_s):
            self._ground.sense(datagram, START_S + t_s)

    def _broadcast(self, t_s: float) -> None:
        for at_s in t_s + self._radio_ticks_s:
            for sent in self._broadcaster.tick(START_S + at_s):
                datagram = wrap(sent, self._frames) if self._wraps else sent
                self._frames += 1
                self._bytes += len(datagram)
                if self._broadcast_log is not None:
                    self._broadcast_log.write(START_S + at_s, datagram)
                for aircraft in self._fleet:
                    aircraft.link.send(datagram, at_s)

    def _repeat(self, t_s: float) -> None:
        for aircraft in self._fleet:
            if aircraft.alive:
                aircraft.exchange_telemetry(START_S + t_s)
                aircraft.repeat(START_S + t_s)

    def _guide(self, t_s: float) -> None:
        now_s = START_S + t_s
        flying = [aircraft for aircraft in self._fleet if aircraft.alive]
        # Before anyone is steered: all see the same moment.
        fleet = Fleet.of({aircraft.spec.id: aircraft.vehicle for aircraft in flying})
        for aircraft in flying:
            aircraft.hear(t_s)
            aircraft.exchange_telemetry(now_s)
            aircraft.look(fleet, now_s)
            decision, decision_us = aircraft.steer(now_s)
            self._decision_us.append(decision_us)
            self._turn_limited += decision.turn_limited
            self._guarded += bool(decision.guard_changes)
            for report in aircraft.companion.report(now_s):
                self._ground.hear_report(report, now_s)


def _build(autopilot: str, spec: AgentSpec) -> Callable[[Start], Craft]:
    if autopilot == "kinematic":
        return kinematic_profile(spec.n_max, spec.speed_m_s, spec.speed_m_s)
    return CRAFTS[autopilot]
