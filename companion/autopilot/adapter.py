"""What every autopilot adapter offers the companion."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple, Protocol, Self

from companion.autopilot.telemetry import Neighbour, Telemetry
from companion.guard.types import Setpoint


@dataclass(frozen=True)
class Abilities:
    """What guidance and guard must assume of the vehicle, as its autopilot's parameters make it."""

    speed_min_m_s: float = 0.0
    speed_max_m_s: float = math.inf
    n_max: float = math.inf
    """Load factor of the turn rate n_max g / v that its turns achieve."""
    reaction_s: float = 0.0
    """From sending a setpoint to the vehicle beginning to obey it: the pure delay that stands for its lag."""
    braking_m_s2: float = math.inf
    """Of one that can stop."""
    tracking_m: float = 0.0
    """How far it strays from the path of arcs and straight lines that guidance and guard reckon with."""
    assumed: tuple[str, ...] = ()
    """Parameters that the autopilot did not tell: their documented defaults are assumed."""


class Velocity(NamedTuple):
    """What a velocity setpoint asks for, from local true north."""

    north_m_s: float
    east_m_s: float
    down_m_s: float
    yaw_rad: float


class SetpointFrame(bytes):
    """A frame that asks for a velocity, and still knows which: who passes that on need not read it off the frame."""

    velocity: Velocity

    def __new__(cls, data: bytes, velocity: Velocity) -> Self:
        """Return the bytes of a SET_POSITION_TARGET_LOCAL_NED and the velocity in it."""
        frame = super().__new__(cls, data)
        frame.velocity = velocity
        return frame


class Adapter(Protocol):
    """One autopilot kind: its telemetry, its steering, its abilities."""

    kind: str
    """As configurations name it."""

    @property
    def can_stop(self) -> bool:
        """Whether the vehicle can stand still in the air."""
        ...

    @property
    def resumes_on_stream(self) -> bool:
        """Whether the autopilot obeys again by itself when a stream of setpoints comes back, whatever happened."""
        ...

    @property
    def neighbours(self) -> Collection[Neighbour]:
        """What the vehicle's own detector has seen; who reads them minds their age."""
        ...

    @property
    def telemetry(self) -> Telemetry:
        """The newest of what the autopilot said."""
        ...

    @property
    def steerable(self) -> bool:
        """Whether a safety pilot has armed the vehicle and put it into the mode that obeys setpoints."""
        ...

    @property
    def refusal(self) -> str | None:
        """Why this autopilot is not steered at all, and what to do about it: for one, that it is another kind."""
        ...

    @property
    def missing_telemetry(self) -> str | None:
        """What the autopilot does not tell now, without which this kind cannot be steered."""
        ...

    @property
    def abilities(self) -> Abilities:
        """What the vehicle can do, by the parameters read so far."""
        ...

    @property
    def parameters_known(self) -> bool:
        """Whether every parameter that the abilities rest on was told, or asked for in vain as often as it is worth."""
        ...

    def receive(self, datagram: bytes, now_s: float) -> None:
        """Take in bytes from the autopilot link; never raises, whatever the bytes."""
        ...

    def requests(self, now_s: float) -> list[bytes]:
        """Return what is due to be asked of the autopilot: message rates, parameters; bounded in number and rate."""
        ...

    def encode(self, setpoint: Setpoint, convergence_rad: float, now_s: float) -> list[bytes]:
        """Return the frames that ask for a setpoint whose heading is from grid north."""
        ...

    def hold(self, now_s: float) -> list[bytes]:
        """Return the frames that ask to stay as it is, where a stream must flow before a safety pilot can hand over."""
        ...

    def release(self) -> None:
        """Forget what belongs to the steering that ended: somebody else has the vehicle."""
        ...

    def heartbeat(self) -> bytes:
        """Return the companion's heartbeat, as an onboard controller."""
        ...
