"""The test's own person: starts a simulator, arms, takes off, hands over and takes away. Only the tests have one."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from companion.geo.local_frame import LocalFrame
from tests.real.kinds import Kind
from tests.real.link import Link, tcp_link, udp_link_at, udp_link_to
from tests.real.programs import Place, start_ardupilot, start_px4
from tests.real.scenarios import MoveHome, MoveOrigin
from tests.real.truth import Sample, sample_of

AUTOPILOT = mavlink.MAV_COMP_ID_AUTOPILOT1
TRUTH_PERIOD_US = 50_000
REPEAT_S = 2.0
"""Time after which an order is given again: a simulator that has just started refuses for a while."""
NEARLY_M = 2.0
"""Distance below its height at which a vehicle has reached it."""
EMPTY_SHARE = 1.2
"""Capacity of a drained battery over what has been drawn from it: 17 % are left."""
_SIM_STATE = mavlink.MAVLINK_MSG_ID_SIM_STATE
_EMITTER_UAV, _ADSB_FLAGS = 14, 31
"""ADSB_EMITTER_TYPE_UAV; coordinates, altitude, heading, velocity and callsign are valid."""


class Vehicle:
    """One simulated vehicle: its program, its pilot's link, and the link on which its simulator tells the truth."""

    def __init__(self, kind: Kind, place: Place, folder: Path, frame: LocalFrame) -> None:
        """Start the program in its own empty folder."""
        self.kind, self.place, self._frame = kind, place, frame
        folder.mkdir()
        if kind.firmware == "PX4":
            self.program = start_px4(kind.model, place, folder)
            self._link = udp_link_to(18570 + place.instance, mavlink.MAV_COMP_ID_MISSIONPLANNER)
            self._truth = udp_link_at(19410 + place.instance, mavlink.MAV_COMP_ID_LOG)
        else:
            self.program = start_ardupilot(kind.model, place, folder)
            self._link = tcp_link(5762 + 10 * place.instance, mavlink.MAV_COMP_ID_MISSIONPLANNER)
            self._truth = tcp_link(5763 + 10 * place.instance, mavlink.MAV_COMP_ID_LOG)
        self.samples: list[Sample] = []
        """All that its simulator told, in order of time."""
        self.modes: list[tuple[float, int]] = []
        """Each change of its custom mode, with the time at which a HEARTBEAT told it."""
        self._armed = False
        self._drawn_mah = 0.0
        self._next_s: dict[str, float] = {}

    def poll(self) -> None:
        """Take in what has come on both links."""
        now_s = time.time()
        for message in self._truth.poll():
            sample = sample_of(message, now_s, self._frame)
            if sample is not None:
                self.samples.append(sample)
        for message in self._link.poll():
            self._hear(message, now_s)
        if self.kind.firmware == "ArduPilot" and not self.samples:
            self._now_and_then("truth", self._ask_for_truth)

    def _hear(self, message: Any, now_s: float) -> None:  # noqa: ANN401 - of pymavlink
        if message.get_type() == "HEARTBEAT" and message.get_srcComponent() == AUTOPILOT:
            self._armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            if not self.modes or self.modes[-1][1] != message.custom_mode:
                self.modes.append((now_s, message.custom_mode))
        elif message.get_type() == "BATTERY_STATUS":
            self._drawn_mah = max(0.0, message.current_consumed)

    def _ask_for_truth(self) -> None:
        self._order(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, _SIM_STATE, TRUTH_PERIOD_US, link=self._truth)
        self._order(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, 1_000_000)

    @property
    def height_m(self) -> float:
        """True height above its home; 0 before the simulator has said anything."""
        return self.samples[-1].altitude_m - self.place.origin.alt_m if self.samples else 0.0

    @property
    def mode(self) -> int | None:
        """Its custom mode; None before its first HEARTBEAT."""
        return self.modes[-1][1] if self.modes else None

    def climb(self) -> bool:
        """Give the next order that brings it to its height and has it wait there; return whether it does."""
        modes = self.kind.modes
        if self.height_m >= self.kind.height_m - NEARLY_M:
            if self.mode != modes.wait:
                self._now_and_then("wait", lambda: self.choose(modes.wait))
            return self.mode == modes.wait
        if not self._armed:
            self._now_and_then("arm", self._arm)
        elif self.kind.model == "copter" and self.height_m < 1.0:
            take_off = mavlink.MAV_CMD_NAV_TAKEOFF
            self._now_and_then("climb", lambda: self._order(take_off, 0, 0, 0, 0, 0, 0, self.kind.height_m))
        return False

    def _arm(self) -> None:
        self.choose(self.kind.modes.take_off)
        self._order(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def hand_over(self) -> bool:
        """Choose the guided mode until it is there; return whether it is."""
        guided = self.kind.modes.guided
        if self.mode != guided:
            self._now_and_then("guided", lambda: self.choose(guided))
        return self.mode == guided

    def choose(self, mode: int) -> None:
        """Choose a custom mode, once."""
        numbers = (mode >> 16 & 0xFF, mode >> 24) if self.kind.firmware == "PX4" else (mode, 0)
        self._order(mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, *numbers)

    def set_parameters(self, parameters: Mapping[str, float]) -> None:
        """Set parameters in flight; PX4's integers travel as the bytes of a float."""
        for name, value in parameters.items():
            kind = mavlink.MAV_PARAM_TYPE_REAL32
            if self.kind.firmware == "PX4" and isinstance(value, int):
                kind, value = mavlink.MAV_PARAM_TYPE_INT32, struct.unpack("<f", struct.pack("<i", value))[0]
            self._link.say(
                mavlink.MAVLink_param_set_message(self.place.system_id, AUTOPILOT, name.encode(), value, kind)
            )

    def move(self, move: MoveHome) -> None:
        """Set home, or the estimator's origin, beside the place where the vehicle's home is at the start."""
        origin = self.place.origin
        here_m = self._frame.to_local(origin.lat_deg, origin.lon_deg)
        lat_deg, lon_deg = self._frame.to_global(here_m[0] + move.north_m, here_m[1] + move.east_m)
        place, altitude_m = (round(lat_deg * 1e7), round(lon_deg * 1e7)), origin.alt_m + move.up_m
        system_id = self.place.system_id
        if isinstance(move, MoveOrigin):
            self._link.say(mavlink.MAVLink_set_gps_global_origin_message(system_id, *place, round(altitude_m * 1e3)))
            return
        self._link.say(
            mavlink.MAVLink_command_int_message(
                system_id, AUTOPILOT, mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_CMD_DO_SET_HOME, 0, 0, *[0.0] * 4,
                *place, altitude_m,
            )
        )  # fmt: skip

    def drain(self) -> None:
        """Leave little in the battery: ArduPilot's by its capacity, PX4's by how far its simulator lets it sink."""
        if self.kind.firmware == "PX4":
            self.set_parameters({"SIM_BAT_MIN_PCT": 15.0, "SIM_BAT_DRAIN": 5.0})
        else:
            self.set_parameters({"BATT_CAPACITY": max(1.0, self._drawn_mah * EMPTY_SHARE)})

    def tell_of(self, other: Vehicle) -> None:
        """Tell it by ADSB_VEHICLE where another one truly is."""
        seen = other.samples[-1]
        north_m, east_m, heading_deg, speed_m_s = seen.row
        lat_deg, lon_deg = self._frame.to_global(north_m, east_m)
        self._link.say(
            mavlink.MAVLink_adsb_vehicle_message(
                other.place.agent_id, round(lat_deg * 1e7), round(lon_deg * 1e7), 1, round(seen.altitude_m * 1e3),
                round(heading_deg * 100.0) % 36_000, round(speed_m_s * 100.0), 0,
                f"OW{other.place.agent_id:05d}".encode(), _EMITTER_UAV, 0, _ADSB_FLAGS, 0,
            )
        )  # fmt: skip

    def close(self) -> None:
        """End the program and close the links."""
        self._link.close()
        self._truth.close()
        self.program.end()

    def _order(self, command: int, *parameters: float, link: Link | None = None) -> None:
        values = [*map(float, parameters), *[0.0] * (7 - len(parameters))]
        (link or self._link).say(
            mavlink.MAVLink_command_long_message(self.place.system_id, AUTOPILOT, command, 0, *values)
        )

    def _now_and_then(self, what: str, order: Callable[[], None]) -> None:
        now_s = time.monotonic()
        if now_s >= self._next_s.get(what, 0.0):
            self._next_s[what] = now_s + REPEAT_S
            order()
