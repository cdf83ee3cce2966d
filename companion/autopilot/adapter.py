"""The protocol that every autopilot adapter implements for the companion, and the values in it."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple, Protocol, Self

from companion.autopilot.aircraft import Neighbour
from companion.autopilot.streams import Shortfall
from companion.autopilot.telemetry import Telemetry
from companion.guard.types import Setpoint


@dataclass(frozen=True)
class Abilities:
    """The vehicle's performance limits for guidance and guard, derived from its autopilot's parameters."""

    speed_min_m_s: float = 0.0
    speed_max_m_s: float = math.inf
    airspeed_max_m_s: float = math.inf
    """Greatest true airspeed that the vehicle's controller reaches; inf where no parameter tells it."""
    airspeed_by: str = ""
    """What that airspeed follows from, as the vehicle calls it ("ANGLE_MAX 3000"); empty if the air bounds nothing."""
    airspeed_remedy: str = ""
    """What a person can set for a greater airspeed ("ANGLE_MAX to 4500 (15 m/s)"); empty if nothing is known."""
    n_max: float = math.inf
    """Load factor of the turn rate n_max g / v that its turns achieve."""
    reaction_s: float = 0.0
    """Time from sending a setpoint until the vehicle obeys it: a pure delay that stands for its lag."""
    braking_m_s2: float = math.inf
    """Deceleration that a vehicle that can stop achieves."""
    tracking_m: float = 0.0
    """Greatest distance of the vehicle from the path of arcs and straight lines that guidance and guard assume."""
    assumed: tuple[str, ...] = ()
    """Names of the parameters that the autopilot did not send, for which documented defaults are assumed."""
    insane: tuple[str, ...] = ()
    """What is wrong with the parameters that no vehicle can have: with these it is not steered."""


class Velocity(NamedTuple):
    """The content of a velocity setpoint, in the local frame of true north."""

    north_m_s: float
    east_m_s: float
    down_m_s: float
    yaw_rad: float


class SetpointFrame(bytes):
    """A setpoint frame with the velocity in it, so that MAVSDK's child process can be given that without decoding."""

    velocity: Velocity

    def __new__(cls, data: bytes, velocity: Velocity) -> Self:
        """Return the bytes of a SET_POSITION_TARGET_LOCAL_NED with the velocity that they encode attached."""
        frame = super().__new__(cls, data)
        frame.velocity = velocity
        return frame


class Adapter(Protocol):
    """The companion's interface to one autopilot: its telemetry, its abilities and the frames that steer it."""

    kind: str
    """The name of the autopilot's kind, as in configurations."""

    steers_in_local_frame: bool
    """Whether its setpoints hold places in the autopilot's local frame."""

    @property
    def can_stop(self) -> bool:
        """Whether the vehicle can stop and hold its position."""
        ...

    @property
    def resumes_on_stream(self) -> bool:
        """Whether the autopilot re-enters its guided mode by itself when a stream of setpoints comes back."""
        ...

    @property
    def neighbours(self) -> Collection[Neighbour]:
        """The aircraft that the vehicle's own detector has seen; they may be old: see `Neighbour.seen_at_s`."""
        ...

    @property
    def sees_others(self) -> bool | None:
        """Whether the vehicle has a detector: True once it showed anybody, False if it has none, None if not known."""
        ...

    @property
    def asks_for_others(self) -> bool:
        """Whether the autopilot sends what its detector shows only when it is asked."""
        ...

    @property
    def telemetry(self) -> Telemetry:
        """The newest telemetry of the autopilot."""
        ...

    @property
    def steerable(self) -> bool:
        """Whether a safety pilot has armed the vehicle and put it into the mode that obeys setpoints."""
        ...

    @property
    def refusal(self) -> str | None:
        """The reason why this autopilot is not steered at all (for example, it is another kind), and the remedy."""
        ...

    @property
    def missing_telemetry(self) -> str | None:
        """The telemetry that this kind needs for steering and does not have now; None if nothing is missing."""
        ...

    @property
    def abilities(self) -> Abilities:
        """The vehicle's performance limits, by the parameters read so far."""
        ...

    @property
    def parameters_known(self) -> bool:
        """Whether each parameter that the adapter reads was received, or requested in vain for the last time."""
        ...

    def receive(self, datagram: bytes, now_s: float) -> int:
        """Process whole frames from the autopilot link; never raises, whatever they are.

        Returns how many of them were the autopilot's own, and newer than what it said before.
        """
        ...

    def shortfalls(self, now_s: float) -> tuple[Shortfall, ...]:
        """Return what safety rests on and arrives much more seldom than it was asked for."""
        ...

    def too_seldom(self, timeout_s: float, now_s: float) -> str | None:
        """Return which message comes too seldom to steer by, with its rates; None if none does.

        `timeout_s`: the age beyond which a position is not steered by.
        """
        ...

    def requests(self, now_s: float) -> list[bytes]:
        """Return the frames that request message rates and parameters, as far as they are due now."""
        ...

    def silence(self, now_s: float) -> str | None:
        """Return in words that the autopilot is heard and answers nothing, and the remedy; None if it answers."""
        ...

    @property
    def unusual(self) -> str | None:
        """What is unusual of the frames that the autopilot sends, in words; None if nothing is."""
        ...

    def note_signed(self) -> bool:
        """Note that the autopilot signs its frames; return whether that is new."""
        ...

    def encode(self, setpoint: Setpoint, convergence_rad: float, now_s: float) -> list[bytes]:
        """Return the frames that command a setpoint, whose heading is from grid north."""
        ...

    def hold(self, now_s: float) -> list[bytes]:
        """Return the frames of a neutral setpoint stream, which PX4 needs before a safety pilot can choose OFFBOARD."""
        ...

    def release(self) -> None:
        """Forget all state of the engagement that ended: the companion no longer steers the vehicle."""
        ...

    def heartbeat(self) -> bytes:
        """Return the frame of the companion's own HEARTBEAT, as an onboard controller."""
        ...
