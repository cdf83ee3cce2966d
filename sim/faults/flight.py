"""One vehicle, its companion and everything that can fail around them, on one virtual clock.

What a fault does must be seen before it happens to a real vehicle: at which stage the companion ends, when, how near a
disc or the fence it came, and what brings it back. The companion's core, the ground station, the frames and the
stand-in autopilots are those of the real programs; of the process around the core there is what a fault can reach: its
datagrams' queue, its state files, its clock, and MAVSDK's child, which outlives a hung parent for half a second.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from companion.autopilot.kinds import KINDS as AUTOPILOTS
from companion.autopilot.offboard import is_setpoint
from companion.autopilot.offboard_child import TICK_TIMEOUT_S
from companion.autopilot.registry import ADAPTERS
from companion.geo.local_frame import LocalFrame
from companion.mission.model import Mission
from companion.mission.resolve import resolve
from companion.onboard.authority import State
from companion.onboard.companion import Companion
from companion.onboard.config import AutopilotSection, Config, StalenessSection, config_for_agent
from companion.onboard.decision import Decision, Purpose
from companion.onboard.failsafe import Stage
from companion.protocol.authenticator import Authenticator, AuthenticatorState, Trust
from companion.protocol.codec import Detection, Kind
from companion.protocol.ed25519 import FrameSigner
from companion.protocol.mavlink_signing import MavlinkSigner
from groundstation.agents import VehicleModel
from groundstation.ground_station import GroundStation
from groundstation.schedule import Broadcaster
from sim.detector import Detector, Fleet
from sim.loop import START_S
from sim.safety_pilot import SafetyPilot
from sim.scaling import CRUISE_M_S, PAPER_SPEED_M_S, scaled
from sim.sensor import LOOK_PERIOD_S, mission_sensor, world_detections
from sim.vehicles import CRAFTS, DEFAULT_RATES_HZ, Home, StandIn
from sim.world import World

KINDS = tuple(CRUISE_M_S)
LOOP_PERIOD_S = 0.1
"""Of setpoints, telemetry and looks at the truth."""
AGENT_ID = 1
SYSTEM_ID = 1
SEED = 1
WAY_M = 3600.0
"""To the target, for 60 m/s."""
HEIGHT_M = 60.0
"""A plane that circles needs room below."""
FLEET_KEY = bytes(range(32))
"""Of a fleet that exists nowhere else."""
OTHER_KEY = bytes(range(1, 33))
HOLDING_MODES = {"arducopter": 17, "arduplane": 12, "px4-copter": 4 << 16 | 3 << 24, "px4-plane": 4 << 16 | 3 << 24}
"""What a person chooses who takes over: BRAKE (ArduCopter's LOITER without a stick sinks), LOITER, HOLD."""
DEMANDED: Mapping[str, Mapping[str, float]] = {
    "arducopter": {"GUID_TIMEOUT": 1.0},
    "arduplane": {},
    "px4-copter": {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 5.0},
    "px4-plane": {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 5.0},
}
"""What `companion check` has a person set (PARAMETER_CHECKS), where the default is another value."""
STALENESS = StalenessSection(coasting_after_s=3.0, loitering_after_s=6.0, blind_after_s=12.0, recover_after_s=1.0)
"""A broadcast a second; short, so that all stages fit into a short flight."""
_GROUND_CONTROL_SYSTEM = 255
_TWIN_AHEAD_S = 500.0
"""The other autopilot with our system id was started so much earlier."""
_TWIN_AWAY_M = 600.0
_TOLERANCE_S = 1e-6


def fault_mission(kind: str, target_deg: float = 0.0, discs: bool = True) -> Mission:
    """Return the scene of the fault table, scaled to a kind's cruise speed; lengths here are for 60 m/s.

    The target is 60 s away in the direction `target_deg` from the vehicle's heading, north. A standing disc lies on the
    way after 15 s, a moving one comes near it after 30 s. The fence leaves 15 s of room around way and vehicle, 20 s at
    the sides.
    """
    target_rad = math.radians(target_deg)
    target_m = (WAY_M * math.cos(target_rad), WAY_M * math.sin(target_rad))
    south_m, north_m = min(0.0, target_m[0]) - 900.0, max(0.0, target_m[0]) + 900.0
    west_m, east_m = min(0.0, target_m[1]) - 1200.0, max(0.0, target_m[1]) + 1200.0
    threats = [
        {"id": 1, "north_m": 1150.0, "east_m": 120.0, "detection_radius_m": 250.0, "attack_radius_m": 120.0}
        | {"speed_bound_m_s": 0.0},
        {"id": 2, "north_m": 2300.0, "east_m": -800.0, "detection_radius_m": 200.0, "attack_radius_m": 100.0}
        | {"speed_bound_m_s": 12.0, "motion": {"heading_deg": 120.0, "speed_m_s": 10.0}},
    ]
    mission = Mission.model_validate(
        {
            "name": "faults",
            "fence": [[south_m, west_m], [south_m, east_m], [north_m, east_m], [north_m, west_m]],
            "agents": [{"id": AGENT_ID, "north_m": 0.0, "east_m": 0.0, "heading_deg": 0.0, "height_m": HEIGHT_M}],
            "targets": [{"id": 1, "north_m": target_m[0], "east_m": target_m[1], "speed_bound_m_s": 0.0}],
            "threats": threats if discs else [],
            "broadcast_period_s": 1.0,
            "assignment_period_s": 5.0,
            "guidance_step_s": 0.5,
            "integration_step_s": LOOP_PERIOD_S,
        }
    )
    return resolve(scaled(mission, kind), SEED)


Track = Callable[[float], tuple[tuple[float, float], tuple[float, float]]]
"""Place and velocity, north and east in metres and m/s, by the time of the flight."""


@dataclass(frozen=True)
class Moment:
    """What was so at one time of the flight, after the companion's turn."""

    t_s: float
    north_m: float
    east_m: float
    height_m: float
    course_rad: float
    speed_m_s: float
    guided: bool
    """Whether the autopilot was in the mode that obeys setpoints."""
    stage: Stage | None
    """None: no companion, or one that is hung or silent."""
    purpose: Purpose | None
    words: str
    """What the companion did and why, in a few words."""
    setpoints: int
    """Of the companion, that reached the autopilot since the moment before."""
    disc_m: float
    """To the nearest detection disc's edge."""
    fence_m: float
    """To the fence, negative outside."""
    other_m: float
    """To the one that the vehicle meets."""


@dataclass(frozen=True)
class Log:
    """A flight, one moment each LOOP_PERIOD_S, and what was done to it."""

    moments: tuple[Moment, ...]

    def between(self, from_s: float, until_s: float = math.inf) -> tuple[Moment, ...]:
        """Return the moments from a time on and before another."""
        return tuple(m for m in self.moments if from_s - _TOLERANCE_S <= m.t_s < until_s - _TOLERANCE_S)

    def first(self, holds: Callable[[Moment], bool], from_s: float = 0.0) -> float | None:
        """Return when something held for the first time from a time on; None for never."""
        return next((m.t_s for m in self.between(from_s) if holds(m)), None)

    def course_of_events(self, from_s: float = 0.0) -> tuple[tuple[float, str], ...]:
        """Return what the companion did, each with the time at which it began."""
        events: list[tuple[float, str]] = []
        for moment in self.between(from_s):
            if not events or events[-1][1] != moment.words:
                events.append((moment.t_s, moment.words))
        return tuple(events)

    def nearest_disc_m(self, from_s: float = 0.0, until_s: float = math.inf) -> float:
        """Return how near the vehicle came to a detection disc; negative within."""
        return min(m.disc_m for m in self.between(from_s, until_s))

    def nearest_fence_m(self, from_s: float = 0.0, until_s: float = math.inf) -> float:
        """Return how near the vehicle came to the fence; negative outside."""
        return min(m.fence_m for m in self.between(from_s, until_s))

    def normal_from_s(self, from_s: float) -> float | None:
        """Return from when on the companion steered to its target on a fresh picture; None: not to the end."""
        normal = [is_normal(m) for m in self.moments]
        if not normal[-1]:
            return None
        last_bad = max((index for index, good in enumerate(normal) if not good), default=-1)
        return max(from_s, self.moments[last_bad + 1].t_s)


def is_normal(moment: Moment) -> bool:
    """Return whether the companion steered towards its target with nothing amiss."""
    return moment.guided and moment.stage is Stage.FRESH and moment.purpose is Purpose.TARGET


@dataclass
class _Program:
    """One run of `companion run` without its sockets: what a fault can do to a process."""

    companion: Companion
    clock_ahead_s: float
    """Of its clock over the true one: read once, at its start."""
    last: Decision | None = None
    setpoints: list[bytes] = field(default_factory=list)
    """The newest that it sent: what MAVSDK's child repeats."""
    waiting: list[bytes] = field(default_factory=list)
    """Datagrams of the autopilot that a hung program has not read yet."""
    waiting_broadcasts: list[bytes] = field(default_factory=list)
    due_s: float = -math.inf


@dataclass(frozen=True)
class Setting:
    """What a flight begins with."""

    kind: str
    mission: Mission
    signed: bool = True
    """Whether the broadcast is, and must be, signed by the fleet's key."""
    child: bool = False
    """Whether setpoints leave through MAVSDK's child process, which ends half a second after its parent's last tick."""
    range_m: float | None = None
    start_ned_m: tuple[float, float] = (0.0, 0.0)
    heading_deg: float = 0.0
    fence_ahead_s: float | None = None
    """So much flight ahead the vehicle's own fence ends; None: where the mission's does."""
    parameters: Mapping[str, float] | None = None
    """Of the autopilot, those that it has; None for those demanded."""


class Flight:
    """One vehicle in flight. Deterministic; `at` plans what is done to it, `run` flies."""

    def __init__(self, setting: Setting) -> None:
        """Put the vehicle into the air, in its holding mode, with a person who hands it over after two seconds."""
        self.setting = setting
        mission, kind = setting.mission, setting.kind
        self._frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        self.cruise_m_s = CRUISE_M_S[kind]
        self.config = _config(setting)
        self.vehicle = self._stand_in(setting.start_ned_m, START_S)
        parameters = DEMANDED[kind] if setting.parameters is None else setting.parameters
        self.vehicle.parameters.update(
            {name: parameters[name] for name in parameters if name in self.vehicle.parameters}
        )
        self._world = World(mission, SEED)
        self._sensor = mission_sensor(mission, int(START_S))
        can_stop = AUTOPILOTS[kind].can_stop
        self._ground = GroundStation(mission, START_S, model=VehicleModel("routed", can_stop))
        self._broadcaster = Broadcaster(self._ground, None, _sealer(FLEET_KEY if setting.signed else None))
        self._impostor: Broadcaster | None = None
        self._replayed: list[tuple[float, bytes]] | None = None
        self._on_air: list[tuple[float, bytes]] = []
        self._under_way: list[bytes] = []
        self._is_silent = False
        self._person = SafetyPilot(kind, SYSTEM_ID)
        self._ground_control = mavlink.MAVLink(None, srcSystem=_GROUND_CONTROL_SYSTEM, srcComponent=190)
        self._orders: list[bytes] = []
        self._ground_control_speaks = True
        self._twin: StandIn | None = None
        self._stranger: Track | None = None
        self._stranger_id = AGENT_ID
        self._detector = Detector(_DETECTOR_ID, SYSTEM_ID, self._frame, mission.detector_range_m)
        self._kept_state = State.WAITING
        self._kept_admission: AuthenticatorState | None = None
        self._clock_ahead_s = 0.0
        self._hung_since_s: float | None = None
        self._actions: list[tuple[float, Callable[[Flight], None]]] = []
        self._t_s = 0.0
        self._ticks = 0
        self._next_look_s = 0.0
        self._sent = 0
        self._moments: list[Moment] = []
        self._program: _Program | None = None
        self.start_companion()

    # What is done to it

    def at(self, t_s: float, action: Callable[[Flight], None]) -> Flight:
        """Plan an action; return the flight, so that plans can be written one behind the other."""
        self._actions.append((t_s, action))
        self._actions.sort(key=lambda planned: planned[0])
        return self

    def kill_companion(self) -> None:
        """End the companion's process, as a crash does, or its machine's death: what is not on disk is lost."""
        self._program = None
        self._hung_since_s = None

    def start_companion(self, with_state: bool = True) -> None:
        """Start the companion's process, with the state files of the one before or without any."""
        if not with_state:
            self._kept_state, self._kept_admission = State.WAITING, None
        trust = Trust(mavlink_key=FLEET_KEY if self.setting.signed else None)
        authenticator = Authenticator(trust, self._kept_admission)
        adapter = ADAPTERS[self.setting.kind]()
        companion = Companion(self.config, adapter, authenticator=authenticator, was=self._kept_state)
        self._program = _Program(companion, self._clock_ahead_s)

    def hang_companion(self, hung: bool) -> None:
        """Stop the companion's process where it is, with what arrives waiting in its sockets; or let it go on."""
        if hung:
            self._hung_since_s = self._t_s
            return
        self._hung_since_s = None
        self._catch_up()

    def step_clock(self, ahead_s: float) -> None:
        """Set the companion's computer's clock to another time; what is timed by the steady one goes on."""
        self._clock_ahead_s += ahead_s

    def silence(self, silent: bool) -> None:
        """Let the broadcast end, or begin again."""
        self._is_silent = silent

    def impostor(self, how: str | None) -> None:
        """Let another transmit in the ground station's place: `unsigned`, `of another key` or `replayed`; None ends it.

        The first two say that there are no discs and that the target is elsewhere.
        """
        self._is_silent = how is not None
        self._impostor, self._replayed = None, None
        if how == "replayed":
            self._replayed = list(self._on_air)
        elif how is not None:
            lured = self.setting.mission.model_copy(update={"threats": (), "targets": self._elsewhere()})
            station = GroundStation(lured, START_S + self._t_s, model=VehicleModel("routed", True))
            self._impostor = Broadcaster(station, None, _sealer(OTHER_KEY if how == "of another key" else None))

    def take_over(self, mode: int | None = None) -> None:
        """Let the person choose another mode: the one that holds the vehicle where it is, unless another is named."""
        mode = HOLDING_MODES[self.setting.kind] if mode is None else mode
        numbers = (float(mode >> 16 & 0xFF), float(mode >> 24)) if mode >= 1 << 16 else (float(mode), 0.0)
        order = self._ground_control.command_long_encode(
            *(SYSTEM_ID, mavlink.MAV_COMP_ID_AUTOPILOT1, mavlink.MAV_CMD_DO_SET_MODE, 0),
            *(float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), *numbers, 0.0, 0.0, 0.0, 0.0),
        )
        self._orders.append(order.pack(self._ground_control))

    def silence_ground_control(self, silent: bool) -> None:
        """Let the heartbeats of the person's ground-control program end, or begin again."""
        self._ground_control_speaks = not silent

    def give_back(self) -> None:
        """Let the person choose the mode that obeys the companion, until it is shown."""
        self._person = SafetyPilot(self.setting.kind, SYSTEM_ID)

    def clear(self) -> None:
        """Let the person tell the companion that its vehicle is its own again (a signal to the process)."""
        if self._program is not None:
            self._program.companion.clear(self._now_s())

    def join_twin(self, joined: bool) -> None:
        """Let another autopilot with the same system id and mode speak and listen on the link, or leave it."""
        here = self.vehicle.truth
        away = (here.north_m, here.east_m + _TWIN_AWAY_M * self.cruise_m_s / PAPER_SPEED_M_S)
        self._twin = self._stand_in(away, START_S - _TWIN_AHEAD_S, guided=True) if joined else None
        if self._twin is not None:
            self._twin.step_to(START_S + self._t_s)

    def meet(self, stranger: Track | None, agent_id: int = AGENT_ID) -> None:
        """Let the vehicle's detector see somebody, with our own agent id unless another is given."""
        self._stranger, self._stranger_id = stranger, agent_id

    def reboot_autopilot(self) -> None:
        """Start the autopilot anew."""
        self.vehicle.reboot(START_S + self._t_s)

    # The flight

    @property
    def t_s(self) -> float:
        """The time of the flight."""
        return self._t_s

    @property
    def guided(self) -> bool:
        """Whether the autopilot is in the mode that obeys the companion."""
        return self.vehicle.mode == self._person.guided_mode

    def run(self, until_s: float) -> Log:
        """Fly on until a time and return all of the flight so far."""
        while self._t_s < until_s - _TOLERANCE_S:
            while self._actions and self._actions[0][0] <= self._t_s + _TOLERANCE_S:
                self._actions.pop(0)[1](self)
            self._step()
            self._ticks += 1
            self._t_s = self._ticks * LOOP_PERIOD_S
        return Log(tuple(self._moments))

    def _step(self) -> None:
        t_s, true_s = self._t_s, START_S + self._t_s
        self._world.advance(t_s)
        self.vehicle.step_to(true_s)
        if self._twin is not None:
            self._twin.step_to(true_s)
        self._look(t_s)
        self._broadcast(true_s)
        for order in [*self._orders, *self._person.orders(t_s, self.vehicle.mode)]:
            self.vehicle.receive(order, true_s)
        self._orders.clear()
        if self._ground_control_speaks and self._ticks % round(1.0 / LOOP_PERIOD_S) == 0:
            self.vehicle.receive(self._person.heartbeat(), true_s)
        frames = self.vehicle.telemetry(true_s)
        if self._twin is not None:
            frames += self._twin.telemetry(true_s)
        self._sent = 0
        self._live(frames, true_s)
        self._note()

    def _live(self, frames: list[bytes], true_s: float) -> None:
        """Give the companion its turn, if there is one that lives."""
        program = self._program
        broadcasts, self._under_way = self._under_way, []
        if program is None:
            return
        if self._hung_since_s is not None:
            program.waiting += frames
            program.waiting_broadcasts += broadcasts
            if self.setting.child and self._t_s - self._hung_since_s < TICK_TIMEOUT_S - _TOLERANCE_S:
                self._deliver(program.setpoints, program)
            return
        now_s = self._now_s()
        for datagram in broadcasts:
            program.companion.hear(datagram, now_s)
        for frame in frames:
            program.companion.receive(frame, now_s)
        self._detect(program, now_s)
        self._act(program, now_s)

    def _act(self, program: _Program, now_s: float) -> None:
        companion = program.companion
        companion.note_clock(START_S + self._t_s + self._clock_ahead_s - now_s)
        if self._t_s >= program.due_s - _TOLERANCE_S:
            program.due_s = self._t_s + self.config.guidance_step_s
            program.last, frames = companion.tick(now_s)
        else:
            frames = companion.repeat(now_s)
        program.setpoints = [frame for frame in frames if is_setpoint(frame)]
        self._deliver(frames, program)
        self._kept_state = companion.authority.kept
        self._kept_admission = companion.authenticator.state

    def _catch_up(self) -> None:
        """Go on after a hang: the loop's turn comes before all but the first datagram that waits in the socket."""
        program = self._program
        if program is None:
            return
        now_s = self._now_s()
        for datagram in program.waiting[:1]:
            program.companion.receive(datagram, now_s)
        self._act(program, now_s)
        for datagram in program.waiting[1:]:
            program.companion.receive(datagram, now_s)
        for datagram in program.waiting_broadcasts:
            program.companion.hear(datagram, now_s)
        program.waiting.clear()
        program.waiting_broadcasts.clear()

    def _deliver(self, frames: Sequence[bytes], program: _Program) -> None:
        true_s, now_s = START_S + self._t_s, self._now_s()
        for frame in frames:
            self._sent += is_setpoint(frame)
            replies = self.vehicle.receive(frame, true_s)
            if self._twin is not None:
                replies += self._twin.receive(frame, true_s)
            for reply in replies:
                if self._hung_since_s is None:
                    program.companion.receive(reply, now_s)
                else:
                    program.waiting.append(reply)

    def _now_s(self) -> float:
        """Return the time by the companion's clock, which it reads once."""
        return START_S + self._t_s + (0.0 if self._program is None else self._program.clock_ahead_s)

    def _look(self, t_s: float) -> None:
        if t_s < self._next_look_s - _TOLERANCE_S:
            return
        self._next_look_s += LOOK_PERIOD_S
        mission = self.setting.mission
        targets, threats = self._world.rows()
        here = self.vehicle.truth
        detections = [Detection(Kind.AGENT, AGENT_ID, here.north_m, here.east_m, *self.vehicle.ground_velocity_m_s)]
        detections += world_detections(mission, targets, threats)
        for datagram in self._sensor.look(detections, START_S + t_s):
            self._ground.sense(datagram, START_S + t_s)

    def _broadcast(self, true_s: float) -> None:
        frames = self._broadcaster.tick(true_s)
        if not self._is_silent:
            self._on_air += [(self._t_s, frame) for frame in frames]
            self._under_way += frames
        if self._impostor is not None:
            self._under_way += self._impostor.tick(true_s)
        if self._replayed is not None and self._replayed:
            # In their own rhythm and over and over, as a recorder would.
            self._under_way.append(self._replayed[self._ticks % len(self._replayed)][1])

    def _detect(self, program: _Program, now_s: float) -> None:
        if self._stranger is None or self._ticks % round(LOOK_PERIOD_S / LOOP_PERIOD_S):
            return
        here, (place_m, velocity_m_s) = self.vehicle.truth, self._stranger(self._t_s)
        fleet = Fleet(
            np.array([_DETECTOR_ID, self._stranger_id]),
            np.array([(here.north_m, here.east_m), place_m]),
            np.array([self.vehicle.ground_velocity_m_s, velocity_m_s]),
            np.array([here.altitude_m, here.altitude_m]),
        )
        for frame in self._detector.look(fleet):
            program.companion.receive(frame, now_s)

    def _note(self) -> None:
        truth = self.vehicle.truth
        mission = self.setting.mission
        place_m = (truth.north_m, truth.east_m)
        _, threats = self._world.rows()
        discs_m = [
            math.dist(place_m, row[:2]) - spec.detection_radius_m
            for spec, row in zip(mission.threats, threats, strict=True)
        ]
        north_m_s, east_m_s = self.vehicle.ground_velocity_m_s
        decision = self._decision()
        is_idle = decision is None or decision.purpose is Purpose.IDLE
        self._moments.append(
            Moment(
                t_s=self._t_s,
                north_m=truth.north_m,
                east_m=truth.east_m,
                height_m=truth.altitude_m - mission.origin.alt_m,
                course_rad=math.atan2(east_m_s, north_m_s),
                speed_m_s=truth.speed_m_s,
                guided=self.guided,
                stage=None if is_idle or decision is None else decision.stage,
                purpose=None if decision is None else decision.purpose,
                words=self._words(decision),
                setpoints=self._sent,
                disc_m=min(discs_m, default=math.inf),
                fence_m=_within_box_m(place_m, self.config),
                other_m=math.inf if self._stranger is None else math.dist(place_m, self._stranger(self._t_s)[0]),
            )
        )

    def _decision(self) -> Decision | None:
        return None if self._program is None or self._hung_since_s is not None else self._program.last

    def _words(self, decision: Decision | None) -> str:
        if self._program is None:
            return "dead"
        if decision is None:
            return "hung"
        if decision.purpose is Purpose.IDLE:
            return f"silent: {decision.reason}"
        why = decision.triggers or (f"{decision.purpose.value}, {decision.reason}",)
        gives_way = "; gives way" if decision.gave_way is not None else ""
        namesake = f"; {decision.note}" if decision.note is not None and "agent id" in decision.note else ""
        return f"{decision.stage.value}: {', '.join(why)}{gives_way}{namesake}"

    def _stand_in(self, place_m: tuple[float, float], start_s: float, guided: bool = False) -> StandIn:
        mission, kind = self.setting.mission, self.setting.kind
        return StandIn(
            CRAFTS[kind],
            SYSTEM_ID,
            self._frame,
            north_m=place_m[0],
            east_m=place_m[1],
            altitude_m=mission.origin.alt_m + HEIGHT_M,
            heading_rad=math.radians(self.setting.heading_deg),
            speed_m_s=0.0 if AUTOPILOTS[kind].can_stop else self.cruise_m_s,
            home=Home(0.0, 0.0, mission.origin.alt_m),
            in_air=True,
            armed=True,
            guided=guided,
            start_s=start_s,
            rates_hz=DEFAULT_RATES_HZ,
        )

    def _elsewhere(self) -> tuple[object, ...]:
        (target,) = self.setting.mission.targets
        north_m, east_m = target.position_ned_m
        return (target.model_copy(update={"north_m": 0.3 * north_m, "east_m": east_m - 0.3 * north_m}),)


_DETECTOR_ID = 60_000
"""Whom the vehicle's detector takes itself for: its own agent id is the stranger's."""


def _config(setting: Setting) -> Config:
    mission, kind = setting.mission, setting.kind
    config = config_for_agent(mission, AGENT_ID, "routed")
    limits = config.limits
    if setting.range_m is not None:
        limits = limits.model_copy(update={"range_m": setting.range_m})
    if setting.fence_ahead_s is not None and limits.fence is not None:
        ahead_m = setting.fence_ahead_s * CRUISE_M_S[kind]
        limits = limits.model_copy(update={"fence": tuple((min(n, ahead_m), e) for n, e in limits.fence)})
    section = AutopilotSection(kind=kind, link="udpin:127.0.0.1:14540", clear="signal")
    return config.model_copy(update={"autopilot": section, "limits": limits, "staleness": STALENESS})


def _sealer(key: bytes | None) -> FrameSigner:
    return FrameSigner(None, None if key is None else MavlinkSigner(key, 0))


def _within_box_m(place_m: tuple[float, float], config: Config) -> float:
    """Return how far a place is from the vehicle's fence, a box along the axes; negative outside."""
    corners_m = np.array(config.limits.fence)
    (south_m, west_m), (north_m, east_m) = corners_m.min(axis=0).tolist(), corners_m.max(axis=0).tolist()
    return float(min(place_m[0] - south_m, north_m - place_m[0], place_m[1] - west_m, east_m - place_m[1]))
