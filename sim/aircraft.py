"""A vehicle that its companion reaches by encoded frames alone: a stand-in autopilot and the links between them."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from companion.files.tlog import TlogWriter
from companion.mission.model import AgentSpec
from companion.onboard.companion import Companion
from companion.onboard.flight_log import Mark, decision_frame, mark_frame
from companion.protocol.codec import Detection, FrameWriter, Kind
from companion.runtime.clock import logged_s
from sim.air_link import LossyLink
from sim.detector import Detector, Fleet
from sim.loop import START_S, Outcome
from sim.safety_pilot import SafetyPilot
from sim.vehicles import StandIn
from sim.vehicles.routing import Router
from sim.vehicles.stand_in import parse

_COMPANION_LINK, _RADIO_LINK = 0, 1
"""An autopilot's links where the broadcast comes through it."""


@dataclass
class AutopilotLink:
    """What passes between a companion and its autopilot, all of it logged."""

    companion: Companion
    vehicle: StandIn
    log: TlogWriter | None = None
    router: Router | None = None
    """Where the autopilot passes the broadcast on; None: the companion has a radio of its own."""

    def send(self, frames: Iterable[bytes], now_s: float) -> None:
        """Let the autopilot hear the companion, and the companion its answers."""
        for frame in frames:
            self.write(frame, now_s)
            if self.router is not None:
                self.router.route(_COMPANION_LINK, parse(frame))
            for reply in self.vehicle.receive(frame, now_s):
                self.deliver(reply, now_s)

    def deliver(self, frame: bytes, now_s: float) -> None:
        """Let the companion hear a frame of the autopilot or of what is plugged into it."""
        self.write(frame, now_s)
        self.companion.receive(frame, now_s)

    def passed_on(self, datagram: bytes) -> list[bytes]:
        """Return what the companion gets of the broadcast: all, or what the autopilot that hears it passes on."""
        if self.router is None:
            return [datagram]
        return [frame for link, frame in self.router.route(_RADIO_LINK, parse(datagram)) if link == _COMPANION_LINK]

    def write(self, frame: bytes, now_s: float) -> None:
        """Log a frame."""
        if self.log is not None:
            self.log.write(now_s, frame)


@dataclass
class Aircraft:
    """A stand-in with its companion, its end of the broadcast link, and who and what else is on board or minds it."""

    spec: AgentSpec
    autopilot: AutopilotLink
    air: LossyLink
    loop_s: tuple[float, ...]
    """When the companion's loop runs, from the beginning of a tick, the tick's end last."""
    detector: Detector | None = None
    safety_pilot: SafetyPilot | None = None
    """Who hands it over on a link of his own; None: it obeys its companion from the start."""
    alive: bool = True
    _t_s: float = 0.0
    _marks: FrameWriter = field(default_factory=FrameWriter)

    @property
    def vehicle(self) -> StandIn:
        """The stand-in."""
        return self.autopilot.vehicle

    @property
    def companion(self) -> Companion:
        """What steers it."""
        return self.autopilot.companion

    def row(self) -> tuple[float, float, float, float]:
        """Return north m, east m, heading deg, speed m/s; a lost vehicle stands where it was lost."""
        truth = self.vehicle.truth
        heading_deg = float(np.degrees(truth.heading_rad)) % 360.0
        return truth.north_m, truth.east_m, heading_deg, truth.speed_m_s if self.alive else 0.0

    def detection(self) -> Detection:
        """Return what the centre's sensor sees of it."""
        truth = self.vehicle.truth
        return Detection(Kind.AGENT, self.spec.id, truth.north_m, truth.east_m, *self.vehicle.ground_velocity_m_s)

    def set_wind(self, wind_m_s: tuple[float, float]) -> None:
        """Let the air move (north, east) from now on."""
        self.vehicle.wind_m_s = wind_m_s

    def move(self, t_s: float) -> None:
        """Fly on to a time of the flight, with the companion's loop on the way where there is an autopilot."""
        from_s, self._t_s = self._t_s, t_s
        *within_s, whole_s = self.loop_s
        vehicle = self.autopilot.vehicle
        for loop_s in within_s:
            at_s = from_s + loop_s
            vehicle.step_to(START_S + at_s)
            self._hand_over(at_s)
            self.repeat(at_s)
        vehicle.step_to(START_S + from_s + whole_s)
        self._hand_over(from_s + whole_s)

    def transmitted(self, datagram: bytes, t_s: float) -> None:
        """Put a datagram on its way through the air."""
        self.air.send(datagram, t_s)

    def guide(self, t_s: float, snapshot: Fleet) -> Outcome:
        """Let the companion hear, see its neighbours and decide, and the autopilot hear what comes of it."""
        now_s = START_S + t_s
        self._hear(t_s)
        self._exchange_telemetry(now_s)
        for frame in [] if self.detector is None else self.detector.look(snapshot):
            self.autopilot.deliver(frame, now_s)
        companion = self.autopilot.companion
        began_ns = time.perf_counter_ns()
        decision, frames = companion.tick(now_s)
        decision_us = (time.perf_counter_ns() - began_ns) / 1000.0
        if self.autopilot.log is not None:
            self.autopilot.write(self._marks.encode(decision_frame(decision)), now_s)
        self.autopilot.send(frames, now_s)
        return Outcome(decision, decision_us)

    def repeat(self, t_s: float) -> None:
        """Let the companion hear its autopilot and keep its last decision standing."""
        now_s, companion = START_S + t_s, self.autopilot.companion
        self._exchange_telemetry(now_s)
        steered = companion.steers
        frames = companion.repeat(now_s)
        if steered and not companion.steers:
            self.autopilot.write(mark_frame(Mark.WITHDRAWN, self.spec.id), now_s)
        self.autopilot.send(frames, now_s)

    def report(self, now_s: float) -> list[bytes]:
        """Return what the companion reports to the centre."""
        return self.companion.report(now_s)

    def _hear(self, t_s: float) -> None:
        """Let the companion hear what the air has delivered by now."""
        for arrival_s, datagram in self.air.deliver(t_s):
            heard_s = logged_s(START_S + arrival_s)
            for passed_on in self.autopilot.passed_on(datagram):
                for frame in self.companion.hear(passed_on, heard_s):
                    self.autopilot.write(frame.data, heard_s)

    def _exchange_telemetry(self, now_s: float) -> None:
        deliver = self.autopilot.deliver
        for frame in self.autopilot.vehicle.telemetry(now_s):
            deliver(frame, now_s)

    def _hand_over(self, t_s: float) -> None:
        """Let the safety pilot do to the vehicle what there is to do."""
        for order in [] if self.safety_pilot is None else self.safety_pilot.orders(t_s, self.vehicle.mode):
            self.vehicle.receive(order, START_S + t_s)
