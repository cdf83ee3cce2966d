"""The vehicle of a flight with faults: its autopilot, a second one with its system id, its pilot, another vehicle."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from companion.autopilot.kinds import CRUISE_M_S
from companion.geo.local_frame import LocalFrame
from companion.mission.model import AgentSpec
from companion.protocol.codec import Detection, Kind
from sim.detector import Detector, Fleet
from sim.faults.process import CompanionProcess
from sim.faults.scene import (
    AGENT_ID,
    DEMANDED,
    HOLDING_MODES,
    LOOP_PERIOD_S,
    SYSTEM_ID,
    Setting,
    fault_config,
    fault_stand_in,
)
from sim.loop import START_S
from sim.mavlink_sender import MavlinkSender
from sim.safety_pilot import SafetyPilot
from sim.scaling import PAPER_SPEED_M_S
from sim.sensor import LOOK_PERIOD_S
from sim.vehicles import StandIn

_GROUND_CONTROL_SYSTEM = 255
_TWIN_AHEAD_S = 500.0
"""Seconds by which the second autopilot with our system id was started earlier than ours."""
_TWIN_AWAY_M = 600.0
"""Distance to the east at which the second autopilot joins, for a vehicle of 60 m/s."""
_DETECTOR_ID = 60_000
"""Agent id of the vehicle as its detector knows it, because its real id may be that of the vehicle it meets."""

Track = Callable[[float], tuple[tuple[float, float], tuple[float, float]]]
"""Function from the time of the flight to a vehicle's place (m) and velocity (m/s), each north and east."""


class Autopilots:
    """The autopilots on the companion's link: the vehicle's own, and at times a second one with its system id."""

    def __init__(self, setting: Setting) -> None:
        """Begin with the vehicle's own autopilot, in the air and in its holding mode."""
        self._setting = setting
        self.vehicle = fault_stand_in(setting, setting.start_ned_m, START_S)
        parameters = DEMANDED[setting.kind] if setting.parameters is None else setting.parameters
        own = self.vehicle.parameters
        own.update({name: value for name, value in parameters.items() if name in own})
        self._twin: StandIn | None = None

    def join_twin(self, joined: bool, t_s: float) -> None:
        """Let a second autopilot with the same system id, in the guided mode, join the link; or let it leave."""
        here = self.vehicle.truth
        away_m = _TWIN_AWAY_M * CRUISE_M_S[self._setting.kind] / PAPER_SPEED_M_S
        place_m = (here.north_m, here.east_m + away_m)
        self._twin = fault_stand_in(self._setting, place_m, START_S - _TWIN_AHEAD_S, guided=True) if joined else None
        self.step_twin(t_s)

    def step_to(self, t_s: float) -> None:
        """Fly on to a time of the flight."""
        self.vehicle.step_to(START_S + t_s)
        self.step_twin(t_s)

    def step_twin(self, t_s: float) -> None:
        """Let the second autopilot, if there is one, fly on to a time of the flight."""
        if self._twin is not None:
            self._twin.step_to(START_S + t_s)

    def telemetry(self, t_s: float) -> list[bytes]:
        """Return the telemetry frames of all autopilots that are due at a time of the flight."""
        frames = self.vehicle.telemetry(START_S + t_s)
        return frames if self._twin is None else frames + self._twin.telemetry(START_S + t_s)

    def receive(self, frame: bytes, t_s: float) -> list[bytes]:
        """Take a frame of the companion at a time of the flight; return the replies of all autopilots."""
        replies = self.vehicle.receive(frame, START_S + t_s)
        return replies if self._twin is None else replies + self._twin.receive(frame, START_S + t_s)


class PilotStation:
    """The safety pilot with a ground-control program, on a link of its own to the autopilot."""

    def __init__(self, kind: str) -> None:
        """Begin with a pilot who hands the vehicle over to the companion, as `SafetyPilot` does."""
        self._kind = kind
        self._pilot = SafetyPilot(kind, SYSTEM_ID)
        self._sender = MavlinkSender(_GROUND_CONTROL_SYSTEM, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._orders: list[bytes] = []
        self._is_silent = False

    @property
    def guided_mode(self) -> int:
        """The custom_mode in which the vehicle obeys the companion."""
        return self._pilot.guided_mode

    def take_over(self, mode: int | None = None) -> None:
        """Take the vehicle from the companion by choosing a custom_mode; None: the holding mode."""
        mode = HOLDING_MODES[self._kind] if mode is None else mode
        numbers = (float(mode >> 16 & 0xFF), float(mode >> 24)) if mode >= 1 << 16 else (float(mode), 0.0)
        order = self._sender.mav.command_long_encode(
            *(SYSTEM_ID, mavlink.MAV_COMP_ID_AUTOPILOT1, mavlink.MAV_CMD_DO_SET_MODE, 0),
            *(float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), *numbers, 0.0, 0.0, 0.0, 0.0),
        )
        self._orders.append(self._sender.pack(order))

    def give_back(self) -> None:
        """Hand the vehicle back: choose the guided mode until the vehicle's HEARTBEAT shows it."""
        self._pilot = SafetyPilot(self._kind, SYSTEM_ID)

    def silence(self, silent: bool) -> None:
        """Stop the ground-control program's heartbeats, or let them go on."""
        self._is_silent = silent

    def frames(self, t_s: float, mode: int) -> list[bytes]:
        """Return the frames to send at a time of the flight to the vehicle, whose custom_mode is `mode`."""
        frames = [*self._orders, *self._pilot.orders(t_s, mode)]
        self._orders.clear()
        if not self._is_silent and _is_every(1.0, t_s):
            frames.append(self._pilot.heartbeat())
        return frames


class Encounter:
    """The vehicle's own detector, and the one other vehicle that it may see."""

    def __init__(self, setting: Setting) -> None:
        """Begin without another vehicle."""
        origin = setting.mission.origin
        frame = LocalFrame(origin.lat_deg, origin.lon_deg)
        self._detector = Detector(_DETECTOR_ID, SYSTEM_ID, frame, setting.mission.detector_range_m)
        self._stranger: Track | None = None
        self._agent_id = AGENT_ID

    def meet(self, stranger: Track | None, agent_id: int = AGENT_ID) -> None:
        """Let the detector see a vehicle with a track and an agent id, by default our own; None ends that."""
        self._stranger, self._agent_id = stranger, agent_id

    def look(self, vehicle: StandIn, t_s: float) -> list[bytes]:
        """Return the detector's frames at a time of the flight; it looks every LOOK_PERIOD_S."""
        if self._stranger is None or not _is_every(LOOK_PERIOD_S, t_s):
            return []
        here, (place_m, velocity_m_s) = vehicle.truth, self._stranger(t_s)
        fleet = Fleet(
            np.array([_DETECTOR_ID, self._agent_id]),
            np.array([(here.north_m, here.east_m), place_m]),
            np.array([vehicle.ground_velocity_m_s, velocity_m_s]),
            np.array([here.altitude_m, here.altitude_m]),
        )
        return self._detector.look(fleet)

    def distance_m(self, place_m: tuple[float, float], t_s: float) -> float:
        """Return the distance from a place (north, east) to the other vehicle; infinity if there is none."""
        return math.inf if self._stranger is None else math.dist(place_m, self._stranger(t_s)[0])


class FaultyVehicle:
    """One vehicle and its companion's process, in the form that `Loop` needs; a dead or hung process does nothing."""

    def __init__(self, setting: Setting, spec: AgentSpec, t_s: Callable[[], float]) -> None:
        """Begin in the air; `t_s` returns the time of the flight."""
        self.spec = spec
        self.alive = True
        self.config = fault_config(setting)
        self.autopilots = Autopilots(setting)
        self.process = CompanionProcess(setting, self.config, t_s, lambda frame: self.autopilots.receive(frame, t_s()))
        self.pilot = PilotStation(setting.kind)
        self.encounter = Encounter(setting)
        self._broadcasts: list[bytes] = []

    @property
    def stand_in(self) -> StandIn:
        """The vehicle's own autopilot."""
        return self.autopilots.vehicle

    def row(self) -> tuple[float, float, float, float]:
        """Return the true north m, east m, heading deg and speed m/s."""
        truth = self.stand_in.truth
        return truth.north_m, truth.east_m, math.degrees(truth.heading_rad) % 360.0, truth.speed_m_s

    def detection(self) -> Detection:
        """Return what the ground station's sensor sees of the vehicle: its true position and velocity."""
        here = self.stand_in.truth
        return Detection(Kind.AGENT, self.spec.id, here.north_m, here.east_m, *self.stand_in.ground_velocity_m_s)

    def set_wind(self, wind_m_s: tuple[float, float]) -> None:
        """Set the velocity of the air (north, east) from now on."""
        self.stand_in.wind_m_s = wind_m_s

    def move(self, t_s: float) -> None:
        """Fly on to a time of the flight."""
        self.autopilots.step_to(t_s)

    def transmitted(self, datagram: bytes, t_s: float) -> None:
        """Receive a datagram of the broadcast without delay or loss, at the next turn."""
        self._broadcasts.append(datagram)

    def guide(self, t_s: float, snapshot: None) -> None:
        """Give the process a turn like any other: it decides on its own schedule, which begins at its start."""
        self.repeat(t_s)

    def repeat(self, t_s: float) -> None:
        """Let the pilot act, then give the companion's process a turn."""
        for order in self.pilot.frames(t_s, self.stand_in.mode):
            self.stand_in.receive(order, START_S + t_s)
        passed_on = self.stand_in.hear_adsb(self.encounter.look(self.stand_in, t_s), START_S + t_s)
        frames = self.autopilots.telemetry(t_s)
        if self.process.listens:
            frames += passed_on
        broadcasts, self._broadcasts = self._broadcasts, []
        self.process.turn(broadcasts, frames)

    def report(self, now_s: float) -> list[bytes]:
        """Return no reports: the vehicle has no uplink."""
        return []


def _is_every(period_s: float, t_s: float) -> bool:
    """Return whether a time of the flight is a multiple of a period; both are multiples of LOOP_PERIOD_S."""
    return round(t_s / LOOP_PERIOD_S) % round(period_s / LOOP_PERIOD_S) == 0
