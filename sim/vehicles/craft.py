"""What a stand-in autopilot's kind is made of: the part that differs between ArduCopter, ArduPlane, PX4 and a point.

`StandIn` speaks MAVLink for all of them; a craft answers commands, minds setpoints and moves. It knows no clock and no
sockets: the time is an argument, and what it was given determines where it is.

Positions are the mission's plane, headings and velocities are along its grid; what comes from the wire is along local
true north, so a craft turns it by the convergence that it is told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

Message = Any
"""A message of the generated module, which carries no types."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One entry of the parameter table. PX4 sends its integers' bytes in the place of the float."""

    name: str
    default: float
    least: float
    greatest: float
    integer: bool = False


@dataclass(frozen=True, slots=True)
class Home:
    """Where the vehicle was armed: a point of the plane and its height above sea level, which is also the ground."""

    north_m: float
    east_m: float
    altitude_m: float


@dataclass(slots=True)
class Body:
    """Where the vehicle is and how it moves. The heading is the nose's, clockwise from grid north."""

    north_m: float = 0.0
    east_m: float = 0.0
    altitude_m: float = 0.0
    """Above sea level."""
    heading_rad: float = 0.0
    velocity_north_m_s: float = 0.0
    """Over the ground, along the grid."""
    velocity_east_m_s: float = 0.0
    climb_m_s: float = 0.0
    roll_rad: float = 0.0
    """To the right."""
    turn_rate_rad_s: float = 0.0
    airspeed_m_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a craft must know of the world at one moment."""

    wind_m_s: tuple[float, float]
    """North and east along the grid: where the air moves to, not where it comes from."""
    home: Home
    convergence_rad: float
    """Add it to a grid heading to get the heading from local true north, where the vehicle is."""
    to_plane: Callable[[float, float], tuple[float, float]]
    """From latitude and longitude in degrees to the plane's north and east in metres."""
    local_to_plane: Callable[[float, float], tuple[float, float]]
    """From the autopilot's own local frame (metres true north and east of home) to the plane's north and east."""


@dataclass(frozen=True, slots=True)
class Start:
    """How a vehicle begins. In the air and not guided it is in the mode that holds it there."""

    body: Body
    """Its velocity is as its heading and speed say, without wind."""
    home: Home
    in_air: bool = False
    armed: bool = False
    guided: bool = False


@dataclass(frozen=True, slots=True)
class Command:
    """A COMMAND_LONG or COMMAND_INT that is for this vehicle; anything in it may be NaN or out of range."""

    command: int
    param1: float
    param2: float
    param3: float
    param4: float
    x: float
    """The fifth parameter: a float of COMMAND_LONG; latitude in degE7 (frames global) of COMMAND_INT."""
    y: float
    """The sixth parameter, likewise: longitude in degE7 of COMMAND_INT."""
    z: float
    """The seventh parameter."""
    int_frame: bool
    """Whether it came as COMMAND_INT."""
    frame: int = 0
    """MAV_FRAME of a COMMAND_INT."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What the autopilot says to a command."""

    results: tuple[int, ...]
    """MAV_RESULT, one acknowledgement each: PX4 sends two for DO_SET_MODE."""
    texts: tuple[str, ...] = ()
    """Sent as STATUSTEXT to who asked, critical."""


class Craft(Protocol):
    """One kind of vehicle with its autopilot: modes, answers and motion. Nothing that it is given makes it raise."""

    kind: str
    mav_type: int
    """MAV_TYPE."""
    mav_autopilot: int
    """MAV_AUTOPILOT."""
    values: dict[str, float]
    """The parameters as they are now, by name; the stand-in writes what is set over the wire into it."""
    announces: bool
    """Whether a changed mode or arming is told by a HEARTBEAT at once, and not only when the next is due."""
    longest_step_s: float
    """The stand-in cuts longer steps into pieces; infinity where the motion does not depend on the step."""
    body: Body
    mode: int
    """As in HEARTBEAT.custom_mode."""
    armed: bool
    in_air: bool
    failsafe: bool
    """Whether HEARTBEAT says critical."""
    texts: list[str]
    """What it has to say by itself; the stand-in takes it and sends it to everybody as STATUSTEXT, informational."""

    @property
    def ready(self) -> bool:
        """Whether the autopilot has come up, and would arm."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameter table."""
        ...

    def base_mode(self) -> int:
        """Return HEARTBEAT.base_mode."""
        ...

    def landed_state(self) -> int:
        """Return EXTENDED_SYS_STATE.landed_state."""
        ...

    def command(self, command: Command, around: Surroundings, now_s: float) -> Answer | None:
        """Answer a command; None if it is none of this kind's: the stand-in then answers it."""
        ...

    def setpoint(self, message: Message, around: Surroundings, now_s: float) -> None:
        """Mind a SET_POSITION_TARGET_LOCAL_NED, SET_POSITION_TARGET_GLOBAL_INT or SET_ATTITUDE_TARGET."""
        ...

    def heartbeat_heard(self, system: int, component: int, mav_type: int, now_s: float) -> None:
        """Mind a heartbeat of another: a ground station's, a companion's."""
        ...

    def blow(self, wind_m_s: tuple[float, float]) -> None:
        """Feel another wind from now on: what flies through the air moves over the ground with it at once."""
        ...

    def step(self, now_s: float, dt_s: float, around: Surroundings) -> None:
        """Advance from `now_s` to `now_s + dt_s`, at most `longest_step_s`; mode logic included."""
        ...

    def reboot(self, now_s: float) -> None:
        """Start the autopilot anew, in flight or not: parameters stay, mode and setpoints are lost."""
        ...
