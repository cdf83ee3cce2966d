"""The stand-in autopilot: MAVLink `common` in and out on a given clock, without sockets.

The companion must be tested against an autopilot that refuses commands, brakes when setpoints stop and reports late,
long before it meets a real one. This one behaves as the real ones were measured to (docs/autopilots.md): what they
share on the MAVLink side is here, what differs is in the craft. The true state is in the mission's plane; MAVLink
messages are relative to true north, so everything is turned by the plane's convergence on its way in and out.

The owner sets the wind before each step; it stays constant within the step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import common as mavlink

from companion.autopilot.firmware import Version
from companion.geo.local_frame import LocalFrame
from sim.mavlink_sender import MavlinkSender
from sim.vehicles.commands import CommandProtocol
from sim.vehicles.craft import Body, Craft, Home, Message, Start
from sim.vehicles.dynamics import Battery, FlightDynamics, Truth
from sim.vehicles.messages import MessageEncoder
from sim.vehicles.named import firmware_of, named_parameters, version_number
from sim.vehicles.parameters import ParameterProtocol
from sim.vehicles.sensors import Sensors
from sim.vehicles.telemetry import DEFAULT_RATES_HZ, Streams, Telemetry

_AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
_SILENT_AFTER_REBOOT_S = 2.0
"""Time after a reboot in which nothing is sent or received (chosen: a real one takes at least this time)."""
_ESTIMATE_HOLDS_S = {"arducopter": 7.2, "arduplane": 10.4, "px4-copter": 5.6}
"""Time without GPS for which the estimate says that it knows its place, by kind (measured); of others for ever."""
_SETPOINTS = frozenset({"SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT", "SET_ATTITUDE_TARGET"})
"""Messages that the craft gets as setpoints."""


@dataclass(frozen=True)
class Setup:
    """How a stand-in begins: metres in the plane, altitude above sea level, heading from grid north.

    In the air and not guided it is in its kind's holding mode. The speed is relative to the air.
    """

    system_id: int
    frame: LocalFrame
    """The local frame of the mission's plane."""
    north_m: float = 0.0
    east_m: float = 0.0
    altitude_m: float = 0.0
    heading_rad: float = 0.0
    speed_m_s: float = 0.0
    home: Home | None = None
    """Home position; None: where the vehicle begins."""
    in_air: bool = False
    armed: bool = False
    guided: bool = False
    start_s: float = 0.0
    """Time at which the stand-in begins, and from which `time_boot_ms` counts."""
    rates_hz: Mapping[int, float] = field(default_factory=lambda: DEFAULT_RATES_HZ)
    """Stream rates by message id."""
    seed: int = 1
    """Seed of the GPS noise."""
    firmware: Version | None = None
    """Version of the autopilot's firmware, whose parameters it has; None: the kind's default."""

    def start(self) -> Start:
        """Return the part of this that the craft needs."""
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
    """Return the MAVLink messages of one datagram; damaged ones are of type BAD_DATA, unknown ones UNKNOWN_*."""
    # Each datagram has a parser of its own, so that a damaged one does not spoil the next.
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    return list(parser.parse_buffer(datagram) or ())


class StandIn:
    """One stand-in autopilot. Deterministic: the same inputs at the same times lead to the same state."""

    def __init__(self, build: Callable[[Start], Craft], setup: Setup) -> None:
        """Place a vehicle whose kind is that of the craft that `build` makes.

        Raises:
            ValueError: a kinematic vehicle, which cannot stop, would begin on the ground.

        """
        start = setup.start()
        sender = MavlinkSender(setup.system_id, _AUTOPILOT_COMPONENT)
        self.system_id = setup.system_id
        self.craft = build(start)
        firmware = firmware_of(self.craft.kind, setup.firmware)
        self.sensors = Sensors(setup.seed, setup.system_id)
        self.sensors.receivers.holds_s = _ESTIMATE_HOLDS_S.get(self.craft.kind, math.inf)
        self._dynamics = FlightDynamics(self.craft, start.home, setup.frame, self.sensors, setup.start_s)
        self._sender = sender
        self._telemetry = Telemetry(
            self.craft,
            MessageEncoder(self._dynamics, sender, setup.start_s, version_number(firmware)),
            Streams(setup.rates_hz, setup.start_s),
            sender,
        )
        commands = CommandProtocol(self._dynamics, self._telemetry, sender, self.move_home)
        self.named = named_parameters(self.craft, firmware)
        """The parameters by their names on the wire."""
        parameters = ParameterProtocol(self.craft, self.named, sender)
        self._handlers: dict[str, Callable[[Message, float], list[bytes]]] = {
            "COMMAND_LONG": commands.on_command_long,
            "COMMAND_INT": commands.on_command_int,
            "SET_MODE": commands.on_set_mode,
            "REQUEST_DATA_STREAM": commands.on_request_data_stream,
            "PARAM_SET": parameters.on_param_set,
            "PARAM_REQUEST_READ": parameters.on_param_request_read,
            "PARAM_REQUEST_LIST": parameters.on_param_request_list,
            "MISSION_REQUEST_LIST": self._on_mission_request_list,
            "SET_HOME_POSITION": self._on_set_home,
            "SET_GPS_GLOBAL_ORIGIN": self._on_set_origin,
            **dict.fromkeys(_SETPOINTS, self._on_setpoint),
        }

    # State

    @property
    def kind(self) -> str:
        """The kind of autopilot that it stands in for."""
        return self.craft.kind

    @property
    def mode(self) -> int:
        """The mode's number, as in HEARTBEAT.custom_mode."""
        return self.craft.mode

    @property
    def armed(self) -> bool:
        """Whether the vehicle is armed."""
        return self.craft.armed

    @property
    def in_air(self) -> bool:
        """Whether the vehicle is off the ground."""
        return self.craft.in_air

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters' present values, by the craft's names for them; the owner may write into them."""
        return self.craft.values

    @property
    def battery(self) -> Battery:
        """The battery; the owner may set its charge and drain."""
        return self._dynamics.battery

    @property
    def truth(self) -> Truth:
        """Where the vehicle really is, after the last step."""
        return self._dynamics.truth

    @property
    def ground_velocity_m_s(self) -> tuple[float, float]:
        """Velocity (north, east) over the ground along the grid, in the present wind."""
        return self.craft.body.velocity_north_m_s, self.craft.body.velocity_east_m_s

    @property
    def wind_m_s(self) -> tuple[float, float]:
        """Velocity of the air (north, east) along the grid: where the wind blows to. The owner sets it."""
        return self._dynamics.wind_m_s

    @wind_m_s.setter
    def wind_m_s(self, wind_m_s: tuple[float, float]) -> None:
        self._dynamics.wind_m_s = wind_m_s

    # Faults, for tests

    def freeze_telemetry(self, frozen: bool) -> None:
        """Make position and attitude messages repeat their present content while heartbeats go on; or end that."""
        self._telemetry.encoder.freeze(frozen)

    def corrupt_telemetry(self, corrupt: bool) -> None:
        """Make the floats of ATTITUDE, LOCAL_POSITION_NED and VFR_HUD NaN; or end that."""
        self._telemetry.encoder.corrupt(corrupt)

    def lose_gps(self, lost: bool, receiver: int | None = None) -> None:
        """Make a GPS receiver, counted from 0, lose its fix, or find it again; None stands for all of them.

        Without any fix positions drift away from the truth.
        """
        self.sensors.receivers.lose_fix(lost, self._dynamics.now_s, receiver)

    def move_home(self, home: Home) -> None:
        """Set home anew, as anybody on the autopilot's link may; it is told at once, by PX4 a moment later."""
        self._dynamics.references.move_home(home)
        self._telemetry.announce_home(self._dynamics.now_s)

    def move_origin(self, origin: Home) -> bool:
        """Move the origin of the local frame; return whether the autopilot obeyed: ArduPilot keeps its own."""
        if self.craft.mav_autopilot != mavlink.MAV_AUTOPILOT_PX4:
            return False
        self._dynamics.references.move_origin(origin)
        self._telemetry.announce_origin(self._dynamics.now_s)
        return True

    def move_sea_level(self, up_m: float) -> None:
        """Make the altitude above sea level too high by a length, which the height above home is not."""
        self._dynamics.references.sea_up_m = up_m

    def warn(self, text: str) -> None:
        """Latch a warning that changes no mode, as "Radio Failsafe - Continuing Guided Mode": HEARTBEAT is CRITICAL.

        It lasts until the autopilot is rebooted. `text` is sent as STATUSTEXT. PX4 has no such state, and ignores it.
        """
        if self.craft.mav_autopilot != mavlink.MAV_AUTOPILOT_PX4:
            self.craft.warned = True
            self.craft.texts.append(text)

    def reboot(self, t_s: float) -> None:
        """Reboot the autopilot: it is silent for a while, its clock restarts at 0, mode and setpoints are lost."""
        self.step_to(t_s)
        self.craft.reboot(t_s)
        self._telemetry.reboot(t_s, _SILENT_AFTER_REBOOT_S)

    # Input

    def receive(self, datagram: bytes, t_s: float) -> list[bytes]:
        """Take one datagram at the time `t_s` and return the replies as frames. No content makes it raise."""
        return self.take(parse(datagram), t_s)

    def take(self, messages: Sequence[Message], t_s: float) -> list[bytes]:
        """Take parsed messages at the time `t_s`; return the replies as frames, for the link that they came from."""
        if self._telemetry.is_silent(t_s):
            return []
        replies: list[bytes] = []
        for message in messages:
            name = message.get_type()
            if name == "HEARTBEAT":
                self.craft.heartbeat_heard(message.get_srcSystem(), message.get_srcComponent(), message.type, t_s)
                continue
            # BAD_DATA and UNKNOWN_* messages have no handler.
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

    def _on_set_home(self, message: Message, t_s: float) -> list[bytes]:
        place = self._place(message)
        if place is not None:
            self.move_home(place)
        return []

    def _on_set_origin(self, message: Message, t_s: float) -> list[bytes]:
        place = self._place(message)
        if place is not None:
            self.move_origin(place)
        return []

    def _place(self, message: Message) -> Home | None:
        """Return the place in a message with latitude, longitude and altitude; None if it is not on the Earth."""
        place_m = self._dynamics.place_on_earth(message.latitude / 1e7, message.longitude / 1e7)
        return None if place_m is None else Home(*place_m, message.altitude / 1000.0)

    def _on_mission_request_list(self, message: Message, t_s: float) -> list[bytes]:
        asker = message.get_srcSystem(), message.get_srcComponent()
        return [self._sender.pack(self._sender.mav.mission_count_encode(*asker, 0, message.mission_type))]

    # Motion and telemetry

    def step_to(self, t_s: float) -> None:
        """Advance the vehicle to the time `t_s`; a time that is not later than the last changes nothing."""
        if t_s <= self._dynamics.now_s:
            return
        before = self._telemetry.heartbeat_state()
        self._dynamics.step_to(t_s)
        self._telemetry.announce_change(before, t_s)

    def hear_adsb(self, frames: Sequence[bytes], t_s: float) -> list[bytes]:
        """Let the ADS-B receiver hear frames at the time `t_s`; return those that the autopilot passes on at once."""
        return [] if self._telemetry.is_silent(t_s) else self._telemetry.adsb.hear(frames, t_s)

    def telemetry(self, t_s: float) -> list[bytes]:
        """Return every frame that is due at `t_s`."""
        return self._telemetry.due(t_s)
