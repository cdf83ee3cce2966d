"""A client of one stand-in, for the tests of docs/autopilots.md: sends messages to it and reads what it does."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common

from companion.geo.local_frame import LocalFrame
from sim.vehicles import CRAFTS, Home, Setup, StandIn

Message = Any
"""Message of pymavlink's generated module, which carries no types."""

FRAME = LocalFrame(47.0, 8.0)
GROUND_M = 500.0
HEIGHT_M = 100.0
NAN = math.nan


class Pilot:
    """A client that sends messages to one stand-in and lets the stand-in's clock run."""

    def __init__(
        self, kind: str, *, flying: bool = True, guided: bool = True, speed_m_s: float = 0.0, seed: int = 1
    ) -> None:
        """Put the vehicle at the plane's origin, heading north."""
        self.vehicle = StandIn(
            CRAFTS[kind],
            Setup(
                1,
                FRAME,
                altitude_m=GROUND_M + (HEIGHT_M if flying else 0.0),
                home=Home(0.0, 0.0, GROUND_M),
                in_air=flying,
                armed=flying,
                guided=guided,
                speed_m_s=speed_m_s,
                seed=seed,
            ),
        )
        self.t_s = 0.0
        self.told: list[Any] = []
        """Every message that the vehicle has sent, in reply or by itself."""
        self._mav = common.MAVLink(None, srcSystem=255, srcComponent=190)

    def say(self, message: Message) -> list[Any]:
        """Send a message and return the vehicle's answers."""
        answers = [_parsed(frame) for frame in self.vehicle.receive(message.pack(self._mav), self.t_s)]
        self.told += answers
        return answers

    def results(self, message: Message) -> list[int]:
        """Send a command and return the results in its acknowledgements."""
        return [answer.result for answer in self.say(message) if answer.get_type() == "COMMAND_ACK"]

    def command(self, command: int, *parameters: float) -> list[int]:
        """Send a COMMAND_LONG and return the results in its acknowledgements."""
        padded = [*parameters, *[0.0] * (7 - len(parameters))]
        return self.results(common.MAVLink_command_long_message(1, 1, command, 0, *padded))

    def command_int(
        self,
        command: int,
        *parameters: float,
        place: tuple[float, float] | None = None,
        height_m: float = 0.0,
        frame: int = 6,
    ) -> list[int]:
        """Send a COMMAND_INT, at a place (north, east) in m if given one, and return the results."""
        padded = [*parameters, *[0.0] * (4 - len(parameters))]
        lat_deg, lon_deg = (0.0, 0.0) if place is None else FRAME.to_global(*place)
        place_e7 = round(lat_deg * 1e7), round(lon_deg * 1e7)
        return self.results(
            common.MAVLink_command_int_message(1, 1, frame, command, 0, 0, *padded, *place_e7, height_m)
        )

    def velocity(
        self,
        north_m_s: float,
        east_m_s: float,
        down_m_s: float = 0.0,
        mask: int = 0x0DC7,
        frame: int = 1,
        z: float = 0.0,
    ) -> None:
        """Send a SET_POSITION_TARGET_LOCAL_NED whose yaw, unless the mask ignores it, points along the velocity."""
        yaw_rad = math.atan2(east_m_s, north_m_s) if math.isfinite(north_m_s) else 0.0
        self.say(
            common.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, frame, mask, 0.0, 0.0, z, north_m_s, east_m_s, down_m_s, 0.0, 0.0, 0.0, yaw_rad, 0.0
            )
        )

    def roll(self, roll_deg: float, mask: int = 0xC6) -> None:
        """Send a SET_ATTITUDE_TARGET with a roll angle."""
        half_rad = math.radians(roll_deg) / 2.0
        q = [math.cos(half_rad), math.sin(half_rad), 0.0, 0.0]
        self.say(common.MAVLink_set_attitude_target_message(0, 1, 1, mask, q, 0.0, 0.0, 0.0, 0.0))

    def set(self, name: str, value: float) -> None:
        """Set a parameter with a PARAM_SET, and check the value in the reply."""
        (told,) = self.say(common.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
        assert told.param_value == value, f"{name} refused {value}"

    def wait(self, duration_s: float, each: Callable[[], None] | None = None, period_s: float = 0.1) -> None:
        """Let time pass, calling `each` every `period_s`, and keep the telemetry."""
        for _ in range(round(duration_s / period_s)):
            if each is not None:
                each()
            self.t_s += period_s
            self.vehicle.step_to(self.t_s)
            self.told += [_parsed(frame) for frame in self.vehicle.telemetry(self.t_s)]

    def until(
        self, condition: Callable[[], bool], each: Callable[[], None] | None = None, within_s: float = 60.0
    ) -> float:
        """Let time pass until the condition holds; return how long it took, infinity if longer than `within_s`."""
        began_s = self.t_s
        while not condition():
            if self.t_s - began_s > within_s:
                return math.inf
            self.wait(0.05, each, 0.05)
        return self.t_s - began_s

    @property
    def heading_deg(self) -> float:
        """Heading of the nose, clockwise from north."""
        return math.degrees(self.vehicle.truth.heading_rad)

    @property
    def speed_m_s(self) -> float:
        """Speed over the ground."""
        return self.vehicle.truth.speed_m_s

    @property
    def course_deg(self) -> float:
        """Course over the ground, clockwise from north, between -180 and 180."""
        north_m_s, east_m_s = self.vehicle.ground_velocity_m_s
        return math.degrees(math.atan2(east_m_s, north_m_s))

    @property
    def height_m(self) -> float:
        """Height above home."""
        return self.vehicle.truth.altitude_m - GROUND_M

    @property
    def place_m(self) -> tuple[float, float]:
        """North and east of the plane's origin."""
        return self.vehicle.truth.north_m, self.vehicle.truth.east_m

    def off_deg(self, heading_deg: float) -> float:
        """Return the signed angle from the nose to a heading, positive if the heading lies to the right."""
        return math.degrees(math.remainder(math.radians(heading_deg - self.heading_deg), math.tau))

    def texts(self) -> list[str]:
        """Return the texts of the STATUSTEXT messages that it has sent."""
        return [message.text for message in self.told if message.get_type() == "STATUSTEXT"]


def _parsed(frame: bytes) -> Message:
    (message,) = common.MAVLink(None).parse_buffer(frame) or []
    return message
