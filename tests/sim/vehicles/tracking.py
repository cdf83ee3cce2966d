"""A stand-in flown by its adapter, and how far it strays from the path that guidance and guard assume.

They assume a vehicle that begins to obey `reaction_s` after a decision, turns at n_max g / v and then flies straight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from pymavlink.dialects.v20 import common

from companion.autopilot.registry import ADAPTERS
from companion.geo.kinematics import GRAVITY_M_S2, turn_towards
from companion.geo.local_frame import LocalFrame
from companion.guard.types import Setpoint
from sim.vehicles import CRAFTS, Home, Setup, StandIn

HEIGHT_M = 100.0
STEP_S = 0.1
"""Time between two setpoints."""
SUBSTEPS = 5
"""Number of positions recorded in each STEP_S."""
DECISION_STEPS = 5
"""Number of setpoints sent for each decision."""
SETTLING_S = 12.0
"""Time at which the turns begin."""
TAIL_S = 6.0
"""Time flown after the turns."""
LONGEST_S = 400.0
"""Time at which the turns are broken off."""
EIGHT_RAD = math.radians(8.0)
TURNS_RAD = {
    "90": (math.pi / 2,),
    "360": (math.tau,),
    "S": (math.pi / 2, -math.pi / 2),
    "wiggle": (EIGHT_RAD, -EIGHT_RAD, EIGHT_RAD, 0.0),
}


class Place(NamedTuple):
    """Position of the vehicle at a time, and its course over the ground."""

    t_s: float
    north_m: float
    east_m: float
    course_rad: float


class Off(NamedTuple):
    """The greatest distance and the greatest angle between the flown and the assumed path."""

    place_m: float
    course_deg: float


@dataclass
class Flight:
    """A stand-in steered directly by its adapter, without companion or link."""

    kind: str
    speed_m_s: float
    wind_m_s: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Begin in the air, flying north, with the parameters read and the guided mode set by the safety pilot."""
        self.adapter = ADAPTERS[self.kind](1)
        self.vehicle = StandIn(
            CRAFTS[self.kind],
            Setup(
                1,
                LocalFrame(47.0, 8.0),
                altitude_m=HEIGHT_M,
                speed_m_s=self.speed_m_s,
                home=Home(0.0, 0.0, 0.0),
                in_air=True,
                armed=True,
            ),
        )
        self.vehicle.wind_m_s = self.wind_m_s
        self.now_s = 0.0
        self.decided: list[tuple[float, float]] = []
        self.flown: list[Place] = []
        for step in range(30):
            self._step(self.adapter.hold(self.now_s))
            if step == 20:
                self._hand_over()

    def decide(self, heading_rad: float, height_m: float = HEIGHT_M) -> None:
        """Set a heading as a decision, and fly until the next decision is due."""
        self.decided.append((self.now_s, heading_rad))
        for _ in range(DECISION_STEPS):
            self._step(self.adapter.encode(Setpoint(heading_rad, self.speed_m_s, height_m), 0.0, self.now_s))

    def _step(self, frames: list[bytes]) -> None:
        for frame in frames + self.adapter.requests(self.now_s):
            for reply in self.vehicle.receive(frame, self.now_s):
                self.adapter.receive(reply, self.now_s)
        for part in range(SUBSTEPS):
            truth, (north_m_s, east_m_s) = self.vehicle.truth, self.vehicle.ground_velocity_m_s
            at_s = self.now_s + part * STEP_S / SUBSTEPS
            self.flown.append(Place(at_s, truth.north_m, truth.east_m, math.atan2(east_m_s, north_m_s)))
            self.vehicle.step_to(at_s + STEP_S / SUBSTEPS)
        self.now_s += STEP_S
        for datagram in self.vehicle.telemetry(self.now_s):
            self.adapter.receive(datagram, self.now_s)

    def _hand_over(self) -> None:
        mode = self.adapter.identity.guided_mode
        # PX4 takes its main mode as a parameter of its own.
        modes = (mode >> 16, 0.0) if mode >= 1 << 16 else (mode, 0.0)
        command = common.MAVLink_command_long_message(
            1, 1, common.MAV_CMD_DO_SET_MODE, 0, common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, *modes, 0.0, 0.0, 0.0, 0.0
        )
        safety_pilot = common.MAVLink(None, srcSystem=255, srcComponent=190)
        self.vehicle.receive(bytes(command.pack(safety_pilot)), self.now_s)


def turned(flight: Flight, turns_rad: tuple[float, ...]) -> tuple[float, float]:
    """Fly north and then the turns, each at the greatest rate; return their starting time (s) and the rate (rad/s)."""
    if not flight.adapter.steerable:
        raise RuntimeError(f"{flight.kind} was not handed over")
    rate_rad_s = flight.adapter.abilities.n_max * GRAVITY_M_S2 / flight.speed_m_s
    step_rad = rate_rad_s * DECISION_STEPS * STEP_S
    while flight.now_s < SETTLING_S:
        flight.decide(0.0)
    start_s, heading_rad = flight.now_s, 0.0
    for turn_rad in turns_rad:
        while heading_rad != turn_rad and flight.now_s < LONGEST_S:
            heading_rad += min(max(turn_rad - heading_rad, -step_rad), step_rad)
            flight.decide(heading_rad)
    ended_s = flight.now_s
    while flight.now_s < ended_s + TAIL_S:
        flight.decide(heading_rad)
    return start_s, rate_rad_s


def off(flight: Flight, start_s: float, rate_rad_s: float, reaction_s: float) -> Off:
    """Return how far the path flown since `start_s` is off the path assumed with a reaction of `reaction_s`."""
    flown = [place for place in flight.flown if place.t_s >= start_s - 1e-9]
    north_m, east_m, heading_rad = flown[0].north_m, flown[0].east_m, flown[0].course_rad
    decided, wanted_rad = list(flight.decided), heading_rad
    worst_m = worst_rad = 0.0
    step_s = STEP_S / SUBSTEPS
    for place in flown:
        worst_m = max(worst_m, math.hypot(place.north_m - north_m, place.east_m - east_m))
        worst_rad = max(worst_rad, abs(math.remainder(place.course_rad - heading_rad, math.tau)))
        while decided and decided[0][0] + reaction_s <= place.t_s + 1e-9:
            wanted_rad = decided.pop(0)[1]
        north_m, east_m, heading_rad = turn_towards(
            north_m, east_m, heading_rad, flight.speed_m_s, wanted_rad, rate_rad_s, step_s
        )
    return Off(worst_m, math.degrees(worst_rad))
