"""A stand-in autopilot, its companion, and the links that carry encoded frames between them."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from companion.files.tlog import TlogWriter
from companion.mission.model import AgentSpec
from companion.onboard.companion import Companion
from companion.onboard.flight_log import MOST_TEXT_ID, Mark, decision_frame, mark_frame, summary_line, text_frames
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
"""Numbers of the autopilot's links where the broadcast reaches the companion through it."""


@dataclass
class AutopilotLink:
    """The link between a companion and its autopilot, with a log of every frame on it."""

    companion: Companion
    vehicle: StandIn
    log: TlogWriter | None = None
    router: Router | None = None
    """Router of an autopilot that forwards the broadcast; None: the companion has a radio of its own."""

    def send(self, frames: Iterable[bytes], now_s: float) -> None:
        """Send frames from the companion to the autopilot, and the autopilot's replies to the companion."""
        for frame in frames:
            self.write(frame, now_s)
            if self.router is not None:
                self.router.route(_COMPANION_LINK, parse(frame))
            for reply in self.vehicle.receive(frame, now_s):
                self.deliver(reply, now_s)

    def deliver(self, frame: bytes, now_s: float) -> None:
        """Log a frame of the autopilot, or of a device on its link, and give it to the companion."""
        self.write(frame, now_s)
        self.companion.receive(frame, now_s)

    def passed_on(self, datagram: bytes) -> list[bytes]:
        """Return what reaches the companion of a broadcast datagram: all, or the frames that the autopilot forwards."""
        if self.router is None:
            return [datagram]
        return [frame for link, frame in self.router.route(_RADIO_LINK, parse(datagram)) if link == _COMPANION_LINK]

    def write(self, frame: bytes, now_s: float) -> None:
        """Log a frame, if there is a log."""
        if self.log is not None:
            self.log.write(now_s, frame)


@dataclass
class Aircraft:
    """A stand-in with its companion, its end of the broadcast link, its detector and its safety pilot."""

    spec: AgentSpec
    autopilot: AutopilotLink
    air: LossyLink
    loop_s: tuple[float, ...]
    """Times from the beginning of a tick at which the companion's loop runs; the last one is the tick's end."""
    detector: Detector | None = None
    safety_pilot: SafetyPilot | None = None
    """The pilot who hands the vehicle over, on a separate link; None: it obeys its companion from the start."""
    alive: bool = True
    _t_s: float = 0.0
    _marks: FrameWriter = field(default_factory=FrameWriter)
    _said: str = ""
    _told: int = 0

    @property
    def vehicle(self) -> StandIn:
        """The stand-in of the vehicle's autopilot."""
        return self.autopilot.vehicle

    @property
    def companion(self) -> Companion:
        """The companion that steers the vehicle."""
        return self.autopilot.companion

    def row(self) -> tuple[float, float, float, float]:
        """Return the true north m, east m, heading deg, speed m/s; a lost vehicle stays where it was lost, at 0 m/s."""
        truth = self.vehicle.truth
        heading_deg = float(np.degrees(truth.heading_rad)) % 360.0
        return truth.north_m, truth.east_m, heading_deg, truth.speed_m_s if self.alive else 0.0

    def detection(self) -> Detection:
        """Return what the ground station's sensor sees of the vehicle: its true position and velocity."""
        truth = self.vehicle.truth
        return Detection(Kind.AGENT, self.spec.id, truth.north_m, truth.east_m, *self.vehicle.ground_velocity_m_s)

    def set_wind(self, wind_m_s: tuple[float, float]) -> None:
        """Set the velocity of the air (north, east) from now on."""
        self.vehicle.wind_m_s = wind_m_s

    def move(self, t_s: float) -> None:
        """Fly on to a time of the flight, one tick later; the companion's loop runs at the times of `loop_s`."""
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
        """Send a datagram of the broadcast over the lossy link at a time of the flight."""
        self.air.send(datagram, t_s)

    def guide(self, t_s: float, snapshot: Fleet) -> Outcome:
        """Give the companion broadcasts, telemetry and detections, let it decide, and send what it has to send."""
        now_s = START_S + t_s
        self._hear(t_s)
        passed_on = [] if self.detector is None else self.vehicle.hear_adsb(self.detector.look(snapshot), now_s)
        self._exchange_telemetry(now_s)
        for frame in passed_on:
            self.autopilot.deliver(frame, now_s)
        companion = self.autopilot.companion
        began_ns = time.perf_counter_ns()
        decision, frames = companion.tick(now_s)
        decision_us = (time.perf_counter_ns() - began_ns) / 1000.0
        if self.autopilot.log is not None:
            self.autopilot.write(self._marks.encode(decision_frame(decision)), now_s)
            self._say(summary_line(decision), now_s)
        self.autopilot.send(frames, now_s)
        return Outcome(decision, decision_us)

    def _say(self, line: str, now_s: float) -> None:
        """Log what the companion says of a decision, if it is something else than before."""
        if line == self._said:
            return
        self._said, self._told = line, self._told % MOST_TEXT_ID + 1
        for frame in text_frames(line, self._told):
            self.autopilot.write(frame, now_s)

    def repeat(self, t_s: float) -> None:
        """Give the companion the telemetry, and send its last decision's setpoint again."""
        now_s, companion = START_S + t_s, self.autopilot.companion
        self._exchange_telemetry(now_s)
        steered = companion.steers
        frames = companion.repeat(now_s)
        if steered and not companion.steers:
            self.autopilot.write(mark_frame(Mark.WITHDRAWN, self.spec.id), now_s)
        self.autopilot.send(frames, now_s)

    def report(self, now_s: float) -> list[bytes]:
        """Return the frames that the companion reports to the ground station."""
        return self.companion.report(now_s)

    def _hear(self, t_s: float) -> None:
        """Give the companion the broadcasts that have arrived by now."""
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
        """Send the safety pilot's commands that are due to the vehicle."""
        for order in [] if self.safety_pilot is None else self.safety_pilot.orders(t_s, self.vehicle.mode):
            self.vehicle.receive(order, START_S + t_s)
