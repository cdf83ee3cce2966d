"""The stand-in autopilot: MAVLink `common` in and out on a given clock, without sockets.

The companion must be tested against an autopilot that says no, brakes on silence and lies late, long before a real one
is at hand. This one behaves as the real ones were measured to (docs/autopilots.md): what they share on the wire is
here, what differs is the craft's. The truth lives in the mission's plane; whatever goes over the wire is relative to
local true north, so everything is turned by the plane's convergence on its way in and out.

Wind is what the owner sets before each step and stays constant within it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import common as mavlink

from companion.geo.local_frame import LocalFrame
from sim.mavlink_sender import MavlinkSender
from sim.vehicles.commands import CommandProtocol
from sim.vehicles.craft import Body, Craft, Home, Message, Start
from sim.vehicles.dynamics import Battery, FlightDynamics, Truth
from sim.vehicles.messages import MessageEncoder
from sim.vehicles.parameters import ParameterProtocol
from sim.vehicles.sensors import Sensors
from sim.vehicles.telemetry import DEFAULT_RATES_HZ, Streams, Telemetry

_AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
_SILENT_AFTER_REBOOT_S = 2.0
"""Chosen: a real one is as long without a word, or longer."""
_SETPOINTS = frozenset({"SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT", "SET_ATTITUDE_TARGET"})


@dataclass(frozen=True)
class Setup:
    """How a stand-in begins: plane metres, altitude above sea level, heading from grid north.

    In the air and not guided it holds where it is. The speed of what flies through the air is through the air.
    """

    system_id: int
    frame: LocalFrame
    """The mission's plane."""
    north_m: float = 0.0
    east_m: float = 0.0
    altitude_m: float = 0.0
    heading_rad: float = 0.0
    speed_m_s: float = 0.0
    home: Home | None = None
    """None: where it begins."""
    in_air: bool = False
    armed: bool = False
    guided: bool = False
    start_s: float = 0.0
    """When its clock begins, that of `time_boot_ms` too."""
    rates_hz: Mapping[int, float] = field(default_factory=lambda: DEFAULT_RATES_HZ)
    seed: int = 1
    """Draws the receiver's noise."""

    def start(self) -> Start:
        """Return what the craft is told."""
        body = Body(
            north_m=self.north_m,
            east_m=self.east_m,
            altitude_m=self.altitude_m,
            heading_rad=self.heading_rad,
            velocity_north_m_s=self.speed_m_s * math.cos(self.heading_rad),
            velocity_east_m_s=self.speed_m_s * math.sin(self.heading_rad),
            airspeed_m_s=self.speed_m_s,
        )
        home = self.home if self.home is not None else Home(self.north_m, self.east_m, self.altitude_m)
        return Start(body, home, in_air=self.in_air, armed=self.armed, guided=self.guided)


def parse(datagram: bytes) -> list[Message]:
    """Return the MAVLink messages of one datagram, damaged and unknown ones included as the parser names them."""
    # A parser of its own for each datagram: a damaged one must not swallow the next.
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    return list(parser.parse_buffer(datagram) or ())


class StandIn:
    """One stand-in autopilot. Deterministic: its state follows from what it was given and when."""

    def __init__(self, build: Callable[[Start], Craft], setup: Setup) -> None:
        """Place a vehicle of a kind. Raises ValueError for a point on the ground: it cannot stop."""
        start = setup.start()
        sender = MavlinkSender(setup.system_id, _AUTOPILOT_COMPONENT)
        self.system_id = setup.system_id
        self.craft = build(start)
        self.sensors = Sensors(setup.seed, setup.system_id)
        self._dynamics = FlightDynamics(self.craft, start.home, setup.frame, self.sensors, setup.start_s)
        self._sender = sender
        self._telemetry = Telemetry(
            self.craft,
            MessageEncoder(self._dynamics, sender, setup.start_s),
            Streams(setup.rates_hz, setup.start_s),
            sender,
        )
        commands = CommandProtocol(self._dynamics, self._telemetry, sender)
        parameters = ParameterProtocol(self.craft, sender)
        self._handlers: dict[str, Callable[[Message, float], list[bytes]]] = {
            "COMMAND_LONG": commands.on_command_long,
            "COMMAND_INT": commands.on_command_int,
            "SET_MODE": commands.on_set_mode,
            "PARAM_SET": parameters.on_param_set,
            "PARAM_REQUEST_READ": parameters.on_param_request_read,
            "PARAM_REQUEST_LIST": parameters.on_param_request_list,
            "MISSION_REQUEST_LIST": self._on_mission_request_list,
            **dict.fromkeys(_SETPOINTS, self._on_setpoint),
        }

    # What it is and does

    @property
    def kind(self) -> str:
        """Which autopilot it stands in for."""
        return self.craft.kind

    @property
    def mode(self) -> int:
        """As in HEARTBEAT.custom_mode."""
        return self.craft.mode

    @property
    def armed(self) -> bool:
        """Whether its motors may run."""
        return self.craft.armed

    @property
    def in_air(self) -> bool:
        """Whether it flies."""
        return self.craft.in_air

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters as they are now, by name; the owner may write into them."""
        return self.craft.values

    @property
    def battery(self) -> Battery:
        """The battery, whose charge and drain are the owner's to set."""
        return self._dynamics.battery

    @property
    def truth(self) -> Truth:
        """Where the vehicle really is after the last step."""
        return self._dynamics.truth

    @property
    def ground_velocity_m_s(self) -> tuple[float, float]:
        """Velocity (north, east) over the ground along the grid, in the wind as it is set now."""
        return self.craft.body.velocity_north_m_s, self.craft.body.velocity_east_m_s

    @property
    def wind_m_s(self) -> tuple[float, float]:
        """North and east along the grid: where the air moves to, not where it comes from. The owner's to set."""
        return self._dynamics.wind_m_s

    @wind_m_s.setter
    def wind_m_s(self, wind_m_s: tuple[float, float]) -> None:
        self._dynamics.wind_m_s = wind_m_s

    # Faults, for tests

    def freeze_telemetry(self, frozen: bool) -> None:
        """Let positions and attitude repeat what they are now, clock included, while heartbeats go on; or end that."""
        self._telemetry.encoder.freeze(frozen)

    def corrupt_telemetry(self, corrupt: bool) -> None:
        """Let the floats of ATTITUDE, LOCAL_POSITION_NED and VFR_HUD be NaN."""
        self._telemetry.encoder.corrupt(corrupt)

    def lose_gps(self, lost: bool) -> None:
        """Let the receiver lose its fix: positions go on and leave the truth slowly; or find it again."""
        self.sensors.lose_fix(lost, self._dynamics.now_s)

    def reboot(self, t_s: float) -> None:
        """Start the autopilot anew: a while without a word, the clock from 0, what was asked forgotten."""
        self.step_to(t_s)
        self.craft.reboot(t_s)
        self._telemetry.reboot(t_s, _SILENT_AFTER_REBOOT_S)

    # In

    def receive(self, datagram: bytes, t_s: float) -> list[bytes]:
        """Take one datagram at the time `t_s` and return the replies as frames. Never raises, whatever the bytes."""
        return self.take(parse(datagram), t_s)

    def take(self, messages: Sequence[Message], t_s: float) -> list[bytes]:
        """Take parsed messages at the time `t_s` and return the replies, for the link they came from, as frames."""
        if self._telemetry.is_silent(t_s):
            return []
        replies: list[bytes] = []
        for message in messages:
            name = message.get_type()
            if name == "HEARTBEAT":
                self.craft.heartbeat_heard(message.get_srcSystem(), message.get_srcComponent(), message.type, t_s)
                continue
            # Bad data and unknown messages, which the parser returns unchecked, have no handler.
            handler = self._handlers.get(name)
            if (
                handler is not None
                and message.target_system in (0, self.system_id)
                and getattr(message, "target_component", 0) in (0, _AUTOPILOT_COMPONENT)
            ):
                replies += handler(message, t_s)
        return replies

    def _on_setpoint(self, message: Message, t_s: float) -> list[bytes]:
        self.craft.setpoint(message, self._dynamics.surroundings(), t_s)
        return []

    def _on_mission_request_list(self, message: Message, t_s: float) -> list[bytes]:
        asker = message.get_srcSystem(), message.get_srcComponent()
        return [self._sender.pack(self._sender.mav.mission_count_encode(*asker, 0, message.mission_type))]

    # Motion and telemetry

    def step_to(self, t_s: float) -> None:
        """Advance the truth to the time `t_s`; an earlier time than the last changes nothing."""
        if t_s <= self._dynamics.now_s:
            return
        before = self._telemetry.heartbeat_state()
        self._dynamics.step_to(t_s)
        self._telemetry.announce_change(before, t_s)

    def telemetry(self, t_s: float) -> list[bytes]:
        """Return every frame that is due at `t_s`."""
        return self._telemetry.due(t_s)
