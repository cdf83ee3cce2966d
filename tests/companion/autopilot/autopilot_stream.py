"""What one autopilot sends over a link, frame by frame, as the tests of the identity need it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from pymavlink.dialects.v20 import common

from companion.autopilot.linked import LinkedAdapter

SYSTEM = 7
START_S = 1_000.0
ARMED = common.MAV_MODE_FLAG_SAFETY_ARMED | common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
DISARMED = common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
GUIDED, LOITER = 4, 5
"""Modes of ArduCopter."""
FRAMES_PER_S = 24


class Sent(NamedTuple):
    """A frame and when it comes."""

    at_s: float
    frame: bytes


class Autopilot:
    """An ArduCopter that flies north at 5 m/s and sends 24 frames a second; each number and each time are its own."""

    def __init__(
        self, *, system: int = SYSTEM, up_ms: int = 60_000, number: int = 0, east_e7: int = 80_000_000
    ) -> None:
        self.base_mode, self.custom_mode = ARMED, GUIDED
        self._mav = common.MAVLink(None, srcSystem=system, srcComponent=common.MAV_COMP_ID_AUTOPILOT1)
        self._mav.seq = number
        self._booted_s = START_S - up_ms / 1e3
        self._east_e7 = east_e7

    def reboot(self, at_s: float) -> None:
        """Begin anew: the clock and the numbers start at 0."""
        self._booted_s, self._mav.seq = at_s, 0

    def sends(self, message: common.MAVLink_message, at_s: float, *, force_mavlink1: bool = False) -> Sent:
        """Return a message as the next frame."""
        frame = bytes(message.pack(self._mav, force_mavlink1=force_mavlink1))
        self._mav.seq = (self._mav.seq + 1) % 256
        return Sent(at_s, frame)

    def heartbeat(self, at_s: float) -> Sent:
        """Return the heartbeat of the present mode."""
        quad, autopilot = common.MAV_TYPE_QUADROTOR, common.MAV_AUTOPILOT_ARDUPILOTMEGA
        return self.sends(
            common.MAVLink_heartbeat_message(quad, autopilot, self.base_mode, self.custom_mode, 4, 3), at_s
        )

    def position(self, at_s: float) -> Sent:
        """Return the position, where the vehicle is by then."""
        north_e7 = 470_000_000 + round((at_s - START_S) * 5.0 * 89.83)
        place = (self.boot_ms(at_s), north_e7, self._east_e7, 530_000, 30_000, 500, 0, 0, 0)
        return self.sends(common.MAVLink_global_position_int_message(*place), at_s)

    def attitude(self, at_s: float) -> Sent:
        """Return the attitude."""
        roll = (at_s * 10.0 % 1.0) / 10.0
        return self.sends(common.MAVLink_attitude_message(self.boot_ms(at_s), roll, 0, 0, 0, 0, 0), at_s)

    def boot_ms(self, at_s: float) -> int:
        """Return the clock."""
        return round((at_s - self._booted_s) * 1e3) % 2**32

    def second(self, from_s: float) -> list[Sent]:
        """Return what is sent in a second."""
        battery = common.MAVLink_sys_status_message(0, 0, 0, 500, 12_000, -1, int(from_s) % 50, 0, 0, 0, 0, 0, 0)
        sent = [self.heartbeat(from_s), self.sends(battery, from_s)]
        sent.append(self.sends(common.MAVLink_extended_sys_state_message(0, 2), from_s))
        sent.append(self.sends(common.MAVLink_vfr_hud_message(5.0, 5.0, 0, 0, 0.0, 0.0), from_s))
        for step in range(10):
            at_s = from_s + 0.1 * step + 0.01
            sent += [self.attitude(at_s), self.position(at_s)]
        return sent

    def seconds(self, number: int, from_s: float = START_S) -> list[Sent]:
        """Return what is sent in some seconds."""
        return [one for step in range(number) for one in self.second(from_s + step)]


def heard(adapter: LinkedAdapter, sent: Iterable[Sent]) -> LinkedAdapter:
    """Give an adapter what was sent, in the order in which it comes; return the adapter."""
    for at_s, frame in sorted(sent, key=lambda one: one.at_s):
        adapter.receive(frame, at_s)
    return adapter
