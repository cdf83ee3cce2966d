"""Flies a mission in lockstep: ground station, companions and vehicles on one virtual clock.

Ground station, companions, sensor and stand-ins are those of the real programs and exchange nothing but encoded frames.
Kinematic vehicles are points that turn at a bounded rate, and obey their companion from the start. The stand-ins of
real autopilots move, receive setpoints and send telemetry ten times a second, and a safety pilot hands them over
(sim/safety_pilot.py). The same mission and seed give the same trajectory, bit for bit.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pymavlink.dialects.v20 import common

from companion.autopilot.kinds import CRUISE_M_S, KINDS
from companion.autopilot.registry import ADAPTERS
from companion.errors import InputError
from companion.files.tlog import TlogWriter
from companion.geo.local_frame import LocalFrame
from companion.guidance.settings import LawName
from companion.mission.model import AgentSpec, Mission
from companion.mission.random_streams import random_stream
from companion.mission.sources import SourceSpec
from companion.onboard.companion import Companion
from companion.onboard.config import AutopilotSection, config_for_agent, dump_config
from companion.surrogate.networks import load_monolithic
from groundstation.agents import VehicleModel
from groundstation.ground_station import GroundStation, check_runnable
from groundstation.radio import Radio
from groundstation.schedule import Broadcaster
from sim.agent_log import AgentLog
from sim.air_link import LINK_STREAM, LossyLink, Tamper
from sim.aircraft import Aircraft, AutopilotLink
from sim.changes import Change
from sim.detector import Detector, Fleet
from sim.flight_files import BROADCAST_NAME, FlightFiles, vehicle_log_name
from sim.flight_record import FlightRecord
from sim.holding import holding_side
from sim.loop import START_S, TOLERANCE_S, Loop, Outcome, Parts, Watch
from sim.pace import Pace
from sim.safety_pilot import SafetyPilot
from sim.sensor import SensorChannel
from sim.stop import Stop, disk_stop
from sim.trajectory import Trajectory
from sim.transmitter import RADIO_TICK_S, Transmitter
from sim.vehicles import CRAFTS, LOCKSTEP_RATES_HZ, Craft, Home, Setup, StandIn, Start, kinematic_profile
from sim.vehicles.adsb import ADSB_TYPE
from sim.vehicles.parameters import set_parameters
from sim.vehicles.routing import Router
from sim.wind import WindField
from sim.world import World

if TYPE_CHECKING:
    from sim.ui import LiveFlight, SimScreen

AUTOPILOTS = ("kinematic", *CRUISE_M_S)
"""Autopilot kinds with which a mission can be flown."""
KINEMATIC_REPEAT_S = 1.0
"""Greatest time between two sendings of a kinematic vehicle's setpoint, below GUID_TIMEOUT, and between two positions
of any vehicle, below `telemetry_timeout_s`: guidance and integration steps may be longer than either."""
LOOP_PERIOD_S = 0.1
"""Period of the companion's loop with the stand-in of a real autopilot: 10 Hz, as in `companion run`."""
WHY_NOT_MONOLITHIC = "trained as the paper says it explains one percent of the penalties, so its gradient is noise"
"""Reason, in messages, why missions with the surrogate `monolithic` are refused or warned of."""
_PROGRESS_TICKS = 100
"""Number of ticks between two calls of a flight's `progress`."""
_POSITION = common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
_MAX_SYSTEM_ID = 250
"""Greatest MAVLink system id given to a vehicle; higher ones are by custom those of ground stations."""

Progress = Callable[[float, int], None]
"""Function called every _PROGRESS_TICKS ticks with the virtual time in seconds and the number of targets reached."""


@dataclass(frozen=True)
class FlightOptions:
    """The options with which a mission is flown."""

    law: LawName = "seed"
    autopilot: str = "kinematic"
    out: Path | None = None
    """Folder for the `.tlog` files and the companions' configurations; None: they are not written."""
    speed: float | None = None
    """Virtual seconds in one of the wall clock; None: as many as the computer manages. A screen has its own."""
    progress: Progress | None = None
    tamper: Tamper | None = None
    """Function that changes frames on the broadcast link, for tests and measurements."""
    watch: Watch | None = None
    """Observer that is called at every tick, for tests and measurements."""
    allow_monolithic: bool = False
    """Whether a mission with the surrogate `monolithic`, which steers by noise, is flown rather than refused."""
    radio: Radio | None = None
    """Radio whose byte budget the broadcast keeps to; None: the mission's periods alone decide what is broadcast."""
    one_radio: bool = False
    """Whether the broadcast reaches each companion through its autopilot, inside V2_EXTENSION."""
    parameters: tuple[tuple[str, float], ...] = ()
    """Names and values of autopilot parameters that differ from the stand-ins' defaults."""
    stop: Callable[[], Stop | None] = lambda: None
    """Function that is asked at every tick whether to end the flight early, and why."""
    screen: SimScreen | None = None
    """Page that shows the flight and is asked for changes; None: nobody is shown anything."""
    tracks: tuple[SourceSpec, ...] = ()
    """Recorded tracks that the ground station hears as live sources."""


@dataclass(frozen=True)
class Flight:
    """The results of a flight, except its logs."""

    trajectory: Trajectory
    steps: int
    """Number of guidance steps."""
    decision_us: np.ndarray  # (D,) us, wall-clock time of each companion's decision
    turn_limited_steps: int
    guard_interventions: int
    broadcast_frames: int
    broadcast_bytes: int
    frames_lost: int
    """Number of broadcast frames lost, summed over the receivers."""
    speedup: float
    """Virtual time divided by wall-clock time."""
    companions: dict[int, Companion]
    logs: dict[int, AgentLog]
    """What each companion decided, by agent id."""
    stop: Stop | None
    """Why the flight was ended early; None if it flew to its end."""
    changes: tuple[Change, ...] = ()
    """What was there from when on, from the start, if anything was added, changed or retired."""


def check_flyable(mission: Mission, source: str | None = None, allow_monolithic: bool = False) -> None:
    """Check that the simulator can fly a resolved mission as it is; `source` names its file in errors.

    Raises:
        InputError: the mission asks for something that is not flown; ignoring it would give a wrong result.

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
    """Raise InputError unless the id of every agent and threat is among the inputs of the monolithic network."""
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


def fly(mission: Mission, seed: int, options: FlightOptions | None = None) -> Flight:
    """Fly a resolved mission until every target is reached, no agent flies on, or its time is up.

    Raises:
        InputError: the mission asks for something that is not flown, or a parameter is unknown or out of its range.

    """
    options = options or FlightOptions()
    check_flyable(mission, allow_monolithic=options.allow_monolithic)
    if mission.surrogate == "monolithic" and options.law != "seed":
        raise InputError(f"--law: '{options.law}' has no use for surrogate 'monolithic'; allowed: seed")
    record = _Record(mission, options.progress)
    files = FlightFiles(options.out, record.builder)
    with ExitStack() as stack:
        stack.callback(files.close)
        broadcast_log = files.log(BROADCAST_NAME)
        frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        hangar = _Hangar(mission, seed, options, frame)
        fleet = [
            hangar.aircraft(spec, index, files.log(vehicle_log_name(spec.id)))
            for index, spec in enumerate(mission.agents)
        ]
        if options.out is not None:
            _write_configs(fleet, options.out, options.autopilot)
        return _fly(hangar, fleet, broadcast_log, record, files, stack)


def _fly(
    hangar: _Hangar,
    fleet: Sequence[Aircraft],
    broadcast_log: TlogWriter | None,
    record: _Record,
    files: FlightFiles,
    stack: ExitStack,
) -> Flight:
    """Fly the fleet to the end of the mission, or until it is to be ended early, and return the results."""
    mission, options = hangar.mission, hangar.options
    is_point = options.autopilot == "kinematic"
    ground = GroundStation(mission, START_S, model=VehicleModel(options.law, KINDS[options.autopilot].can_stop))
    world = World(mission, hangar.seed)
    live = _live(options, ground, world, record, stack) if options.screen or options.tracks else None
    transmitter = Transmitter(
        Broadcaster(ground if live is None else live.overheard, options.radio),
        mission.integration_step_s if options.radio else RADIO_TICK_S,
        wraps=options.one_radio and options.radio is None,
        log=broadcast_log,
    )
    loop = Loop(
        Parts(
            mission=mission,
            world=world,
            vehicles=fleet,
            snapshot=lambda _now_s: Fleet.of({one.spec.id: one.vehicle for one in fleet if one.alive}),
            ground=ground,
            look=SensorChannel(mission, START_S, ground).look,
            transmit=transmitter.transmit,
            recorder=record,
            repeat_period_s=KINEMATIC_REPEAT_S if is_point else LOOP_PERIOD_S,
            wind=WindField(mission.wind, hangar.seed),
            watch=options.watch,
        )
    )
    began_s = time.perf_counter()
    stop = _run(loop, options, files, live)
    elapsed_s = time.perf_counter() - began_s
    refused = files.close()
    stop = stop or refused
    trajectory = record.trajectory(files.steps_written(len(record.builder)))
    return Flight(
        trajectory=trajectory,
        steps=loop.guided,
        decision_us=np.array(record.decision_us),
        turn_limited_steps=record.turn_limited,
        guard_interventions=record.guarded,
        broadcast_frames=transmitter.frames,
        broadcast_bytes=transmitter.bytes,
        frames_lost=sum(one.air.lost for one in fleet),
        speedup=float(trajectory.t_s[-1]) / elapsed_s if elapsed_s > 0.0 else 0.0,
        companions={one.spec.id: one.companion for one in fleet},
        logs=record.logs,
        stop=stop,
        changes=tuple(record.changes),
    )


def _live(options: FlightOptions, ground: GroundStation, world: World, record: _Record, stack: ExitStack) -> LiveFlight:
    """Return what changes a flight while it flies, begun."""
    # Only who looks needs the libraries of the page, and only who plays tracks those of the sources.
    from sim.tracks import Tracks
    from sim.ui import EventFile, LiveFlight, Stage

    budget_bytes_per_s = None if options.radio is None else options.radio.budget_bytes_per_s
    stage = Stage(ground, record, world, budget_bytes_per_s, KINDS[options.autopilot].can_stop)
    tracks = Tracks(ground.mission, options.tracks, stack) if options.tracks else None
    events = EventFile(options.out)
    stack.callback(events.close)
    return LiveFlight(options.screen, tracks, stage, events)


def _run(loop: Loop[Fleet], options: FlightOptions, files: FlightFiles, live: LiveFlight | None) -> Stop | None:
    """Step to the end of a flight; return why it was ended early, None if it was not."""
    pace = Pace(options.speed, wall_s=time.monotonic())
    try:
        if live is not None:
            pace = live.rest(0.0, pace, options.stop)
        while loop.step():
            files.keep_up()
            stop = options.stop()
            if stop is not None:
                return stop
            if live is not None:
                pace = live.rest(loop.t_s, pace, options.stop)
            elif options.speed is not None:
                pace = pace.kept(loop.t_s, time.monotonic())
                time.sleep(pace.wait_s(loop.t_s, time.monotonic()) or 0.0)
        if live is not None:
            live.look(loop.t_s)
    except OSError as error:
        return disk_stop(error, options.out)
    return None


class _Record(FlightRecord):
    """The recorder of a flight in lockstep: its trajectory, arrivals, and counts and times of its decisions."""

    def __init__(self, mission: Mission, progress: Progress | None) -> None:
        super().__init__(mission)
        self._targets = len(mission.targets)
        self._progress = progress
        self._samples = 0
        self.decision_us: list[float] = []
        self.turn_limited = 0
        self.guarded = 0

    def record(
        self, t_s: float, agents: np.ndarray, alive: Sequence[bool], things: tuple[np.ndarray, np.ndarray]
    ) -> bool:
        """Record the sample as `FlightRecord.record` does, and report progress every _PROGRESS_TICKS ticks."""
        over = super().record(t_s, agents, alive, things)
        if self._progress is not None and self._samples % _PROGRESS_TICKS == 0:
            self._progress(t_s, self._targets - self.open_targets)
        self._samples += 1
        return over

    def decided(self, agent_id: int, outcome: Outcome) -> None:
        """Take in a companion's decision; count its duration and whether the turn limit or the guard changed it."""
        super().decided(agent_id, outcome)
        self.decision_us.append(outcome.decision_us)
        self.turn_limited += outcome.decision.turn_limited
        self.guarded += bool(outcome.decision.guard_changes)


@dataclass(frozen=True)
class _Hangar:
    """Builds the aircraft of a flight from the mission, the seed and the options."""

    mission: Mission
    seed: int
    options: FlightOptions
    frame: LocalFrame

    def aircraft(self, spec: AgentSpec, index: int, log: TlogWriter | None) -> Aircraft:
        """Return the aircraft of an agent, whose index in the mission is `index`; `log` records its autopilot link."""
        mission, options = self.mission, self.options
        config = config_for_agent(mission, spec.id, options.law)
        system_id = index % _MAX_SYSTEM_ID + 1
        is_point = options.autopilot == "kinematic"
        # The paper's laws look at nobody in Case I, and would only be slowed by it.
        has_detector = mission.detector == "adsb" and (mission.case == "II" or options.law == "routed")
        step_s = mission.integration_step_s
        loops = _parts(step_s, KINEMATIC_REPEAT_S) if is_point else max(1, round(step_s / LOOP_PERIOD_S))
        return Aircraft(
            spec,
            AutopilotLink(
                Companion(config, ADAPTERS[options.autopilot](system_id)),
                self._stand_in(spec, system_id, config.height_m, has_detector),
                log,
                Router(system_id) if options.one_radio else None,
            ),
            LossyLink(
                mission.link,
                random_stream(self.seed, LINK_STREAM, index),
                mission.broadcast_period_s,
                options.tamper,
            ),
            (*(loop * step_s / loops for loop in range(1, loops)), step_s),
            Detector(spec.id, system_id, self.frame, mission.detector_range_m) if has_detector else None,
            None if is_point else SafetyPilot(options.autopilot, system_id),
        )

    def _stand_in(self, spec: AgentSpec, system_id: int, height_m: float, has_detector: bool) -> StandIn:
        mission, autopilot = self.mission, self.options.autopilot
        north_m, east_m = spec.position_ned_m
        vehicle = StandIn(
            _build(autopilot, mission, spec),
            Setup(
                system_id,
                self.frame,
                north_m=north_m,
                east_m=east_m,
                altitude_m=mission.origin.alt_m + height_m,
                heading_rad=float(np.radians(spec.heading_deg or 0.0)),
                speed_m_s=0.0 if KINDS[autopilot].can_stop else spec.speed_m_s,
                home=Home(north_m, east_m, mission.origin.alt_m),
                in_air=True,
                armed=True,
                guided=autopilot == "kinematic",
                start_s=START_S,
                # A position is due at every guidance step: the companion decides on where the vehicle is now.
                rates_hz={
                    **LOCKSTEP_RATES_HZ,
                    _POSITION: _parts(mission.guidance_step_s, KINEMATIC_REPEAT_S) / mission.guidance_step_s,
                },
            ),
        )
        if has_detector and ADSB_TYPE in vehicle.parameters:
            vehicle.parameters[ADSB_TYPE] = 1.0
        set_parameters(vehicle, self.options.parameters)
        return vehicle


def _parts(whole_s: float, longest_s: float) -> int:
    """Return into how few equal parts a time is divided so that none is longer than `longest_s`."""
    return math.ceil(whole_s / longest_s - TOLERANCE_S)


def _write_configs(fleet: Sequence[Aircraft], folder: Path, autopilot: str) -> None:
    """Write each companion's configuration for a replay, with its log in the place of its autopilot's link."""
    for aircraft in fleet:
        link, system_id = f"file:vehicle-{aircraft.spec.id}.tlog", aircraft.vehicle.system_id
        # As in the flight: a companion that is told no id listens for a while whether there are several.
        recorded = AutopilotSection(kind=autopilot, link=link, system_id=system_id)
        config = aircraft.companion.config.model_copy(update={"autopilot": recorded})
        (folder / f"companion-{aircraft.spec.id}.yaml").write_text(dump_config(config), encoding="utf-8")


def _build(autopilot: str, mission: Mission, spec: AgentSpec) -> Callable[[Start], Craft]:
    if autopilot == "kinematic":
        return kinematic_profile(spec.n_max, spec.speed_m_s, spec.speed_m_s, holding_side(mission, spec))
    return CRAFTS[autopilot]
