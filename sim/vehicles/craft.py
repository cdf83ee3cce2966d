"""The interface of a craft: the part of a stand-in that differs between ArduCopter, ArduPlane, PX4 and a point.

`StandIn` speaks MAVLink for all of them; a craft answers commands, obeys setpoints and moves. It has no clock and no
sockets: the time is an argument, so that the same inputs lead to the same motion.

Positions are in the mission's plane. Headings and velocities are along its axes, the grid, whose north differs from
true north by an angle that grows with the distance from the origin. What comes over MAVLink is relative to true north
where the vehicle is, so a craft turns it by `Surroundings.convergence_rad`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

Message = Any
"""A message of pymavlink's generated module, which has no type annotations."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One entry of the autopilot's parameter table, with its allowed range."""

    name: str
    default: float
    least: float
    greatest: float
    integer: bool = False
    """Whether PX4 has it as an integer, whose bytes it sends in the place of the float."""


@dataclass(frozen=True, slots=True)
class Home:
    """A place in the mission's plane with an altitude above sea level, such as home."""

    north_m: float
    east_m: float
    altitude_m: float


@dataclass(slots=True)
class Body:
    """Where the vehicle is and how it moves, in the mission's plane.

    The heading is the nose's, clockwise from grid north; positive roll and turn rate are to the right.
    """

    north_m: float = 0.0
    east_m: float = 0.0
    altitude_m: float = 0.0
    """Altitude above sea level."""
    heading_rad: float = 0.0
    velocity_north_m_s: float = 0.0
    """Velocity over the ground along grid north."""
    velocity_east_m_s: float = 0.0
    """Velocity over the ground along grid east."""
    climb_m_s: float = 0.0
    roll_rad: float = 0.0
    turn_rate_rad_s: float = 0.0
    airspeed_m_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a craft needs from the world around it at one moment."""

    wind_m_s: tuple[float, float]
    """Velocity of the air (north, east) along the grid: where the wind blows to, not where it comes from."""
    home: Home
    ground_m: float
    """Altitude of the ground above sea level."""
    origin_altitude_m: float
    """Altitude above sea level of the origin of the autopilot's local frame."""
    convergence_rad: float
    """Angle to add to a grid heading to get the heading from true north where the vehicle is."""
    to_plane: Callable[[float, float], tuple[float, float]]
    """Function from latitude and longitude in degrees to the plane's north and east in metres."""
    local_to_plane: Callable[[float, float], tuple[float, float]]
    """Function from the autopilot's local frame (metres true north and east of its origin) to the plane's."""


@dataclass(frozen=True, slots=True)
class Start:
    """The state in which a vehicle begins. In the air and not guided it is in its kind's holding mode."""

    body: Body
    """Position and motion; the velocity is along the heading, without wind."""
    home: Home
    in_air: bool = False
    armed: bool = False
    guided: bool = False


@dataclass(frozen=True, slots=True)
class Command:
    """A COMMAND_LONG or COMMAND_INT for this vehicle, unchecked: any of its numbers may be NaN or out of range."""

    command: int
    param1: float
    param2: float
    param3: float
    param4: float
    x: float
    """The fifth parameter: param5 of COMMAND_LONG; of COMMAND_INT the latitude in degE7 in a global frame."""
    y: float
    """The sixth parameter: param6 of COMMAND_LONG; of COMMAND_INT the longitude in degE7 in a global frame."""
    z: float
    """The seventh parameter, usually an altitude in metres: param7 of COMMAND_LONG, z of COMMAND_INT."""
    int_frame: bool
    """Whether the command came as COMMAND_INT."""
    frame: int = 0
    """MAV_FRAME of a COMMAND_INT; 0 for a COMMAND_LONG."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The autopilot's answer to a command."""

    results: tuple[int, ...]
    """A MAV_RESULT for each COMMAND_ACK that is sent: PX4 sends two for DO_SET_MODE."""
    texts: tuple[str, ...] = ()
    """Texts that go to the sender of the command as STATUSTEXT of severity critical."""


class Craft(Protocol):
    """One kind of vehicle with its autopilot: modes, answers and motion. No message makes it raise."""

    kind: str
    mav_type: int
    """MAV_TYPE in HEARTBEAT."""
    mav_autopilot: int
    """MAV_AUTOPILOT in HEARTBEAT."""
    values: dict[str, float]
    """The parameters' present values, by name; the stand-in writes into it what a PARAM_SET sets."""
    announces: bool
    """Whether a changed mode or arming is announced by a HEARTBEAT at once, rather than by the next one due."""
    lists_adsb: bool
    """Whether it sends the aircraft that its ADS-B receiver hears only when asked, one by one; else each at once."""
    longest_step_s: float
    """Longest `dt_s` that `step` takes: the caller cuts longer ones. Infinity if the motion is exact for any step."""
    body: Body
    mode: int
    """The mode's number, as in HEARTBEAT.custom_mode."""
    armed: bool
    in_air: bool
    failsafe: bool
    """Whether a failsafe is active: HEARTBEAT's state is then MAV_STATE_CRITICAL."""
    warned: bool
    """Whether a warning that changes no mode is latched: HEARTBEAT's state is then MAV_STATE_CRITICAL too."""
    texts: list[str]
    """Texts that wait to be sent to everybody as STATUSTEXT of severity info; the stand-in sends and removes them."""

    @property
    def ready(self) -> bool:
        """Whether the autopilot's start-up has ended, so that the vehicle can be armed."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The autopilot's parameters with their defaults and ranges."""
        ...

    def base_mode(self) -> int:
        """Return HEARTBEAT.base_mode."""
        ...

    def landed_state(self) -> int:
        """Return EXTENDED_SYS_STATE.landed_state."""
        ...

    def command(self, command: Command, around: Surroundings, now_s: float) -> Answer | None:
        """Answer a command; return None for a command that the kind does not handle: the stand-in then answers it."""
        ...

    def setpoint(self, message: Message, around: Surroundings, now_s: float) -> None:
        """Take a SET_POSITION_TARGET_LOCAL_NED, SET_POSITION_TARGET_GLOBAL_INT or SET_ATTITUDE_TARGET."""
        ...

    def heartbeat_heard(self, system: int, component: int, mav_type: int, now_s: float) -> None:
        """Note the heartbeat of another MAVLink component, such as a ground station or a companion."""
        ...

    def blow(self, wind_m_s: tuple[float, float]) -> None:
        """Adapt the motion to a new wind: a craft that flies through the air changes its ground velocity at once."""
        ...

    def step(self, now_s: float, dt_s: float, around: Surroundings) -> None:
        """Advance motion and mode logic from `now_s` to `now_s + dt_s`; `dt_s` is at most `longest_step_s`."""
        ...

    def watch(self, now_s: float, has_fix: bool, battery_v: float, around: Surroundings) -> None:
        """Take what the autopilot's failsafes watch: whether the GPS receiver has a fix, and the battery's voltage."""
        ...

    def reboot(self, now_s: float) -> None:
        """Restart the autopilot, in flight or on the ground: parameters stay, mode and setpoints are lost."""
        ...
