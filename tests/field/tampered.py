"""A rig on whose autopilot's link the test moves home, loses receivers, and changes what a message says."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.onboard.config import Config
from companion.onboard.decision import Purpose
from sim.vehicles import Home
from tests.field.rig import GROUND_M, HEIGHT_M, ORIGIN_DEG, Rig

Message = Any
M_PER_DEG = math.radians(1.0) * 6_371_000.0
STEERS_S = 9.0
"""Time by which a vehicle of a rig is steered."""


class TamperedRig(Rig):
    """A rig whose autopilot says what `edits` make of its messages, by their names."""

    def __init__(self, kind: str = "arducopter", config: Config | None = None, **parameters: float) -> None:
        """Begin with an autopilot that says what it knows."""
        super().__init__(kind, config, **parameters)
        self.edits: dict[str, Callable[[Message], Message | None]] = {}
        """What each message becomes; None: it is not sent."""
        self.also: Callable[[], list[Message]] = list
        """What the autopilot says beside, once a second."""
        self._telemetry = self.vehicle.telemetry
        self.vehicle.telemetry = self._said  # type: ignore[method-assign]
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self.come_m = 0.0
        """How far north of the vehicle an aircraft is that comes head-on."""

    def steered(self) -> TamperedRig:
        """Fly until the vehicle is steered to its target."""
        self.run(STEERS_S)
        assert self.last.purpose is Purpose.TARGET, self.words()
        return self

    def assert_does(self, purpose: Purpose) -> None:
        """Assert what the companion does now."""
        assert self.last.purpose is purpose, self.words()

    def set_mode(self, mode: int) -> None:
        """Let a person choose a mode of ArduPilot's."""
        values = (float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), float(mode), 0.0, 0.0, 0.0, 0.0, 0.0)
        self.say(mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, *values))

    def move_home(self, up_m: float = 0.0, north_m: float = 0.0) -> None:
        """Let somebody set home anew: so far above the ground, and so far north of where the flight began."""
        home = Home(north_m, 0.0, GROUND_M + up_m)
        move = getattr(self.vehicle, "move_home", None)
        if move is not None:
            move(home)
            return
        # A stand-in of before: its local frame went with home.
        dynamics, frame = self.vehicle._dynamics, "home_frame"
        setattr(dynamics, "home", home)  # noqa: B010 - a name that this version does not have
        if north_m:
            local = type(getattr(dynamics, frame))(*dynamics._frame.to_global(north_m, 0.0))
            setattr(dynamics, frame, local)

    def move_position(self, north_m: float, east_m: float = 0.0) -> None:
        """Let the autopilot be wrong by so much about where it is."""

        def edit(message: Message) -> Message:
            message.lat += round(1e7 * north_m / M_PER_DEG)
            message.lon += round(1e7 * east_m / M_PER_DEG / math.cos(math.radians(ORIGIN_DEG[0])))
            return message

        self.edits["GLOBAL_POSITION_INT"] = edit

    def meet(self, north_m: float, *, address: int = 0xABC, **fields: int) -> Message:
        """Return an aircraft so far north of the vehicle, at its height, that flies south at 20 m/s."""
        truth = self.vehicle.truth
        lat_e7 = round(1e7 * (ORIGIN_DEG[0] + (truth.north_m + north_m) / M_PER_DEG))
        altitude = fields.get("altitude_mm", round(1e3 * truth.altitude_m))
        east = fields.get("east_m", 0) / M_PER_DEG / math.cos(math.radians(ORIGIN_DEG[0]))
        return mavlink.MAVLink_adsb_vehicle_message(
            *(address, lat_e7, round(1e7 * (ORIGIN_DEG[1] + east)), fields.get("altitude_type", 1), altitude),
            *(18_000, 2_000, 0, b"STRANGER", 1, fields.get("tslc", 0), 0x1F, 0),
        )

    def hear(self, *messages: Message) -> None:
        """Let the companion hear messages of its autopilot now."""
        for message in messages:
            self.companion.receive(self._packed(message), self.now_s)

    @property
    def height_m(self) -> float:
        """The true height above the ground."""
        return self.vehicle.truth.altitude_m - GROUND_M

    @property
    def off_height_m(self) -> float:
        """How far the vehicle is from the height that it is to fly at."""
        return self.height_m - HEIGHT_M

    def _said(self, t_s: float) -> list[bytes]:
        frames = []
        for frame in self._telemetry(t_s):
            for message in mavlink.MAVLink(None).parse_buffer(bytearray(frame)) or ():
                edit = self.edits.get(message.get_type())
                told = message if edit is None else edit(message)
                if told is not None:
                    frames.append(self._packed(told))
        if round(10 * (t_s - math.floor(t_s))) == 0:
            frames += [self._packed(message) for message in self.also()]
        return frames

    def _packed(self, message: Message) -> bytes:
        frame = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame
