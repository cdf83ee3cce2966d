"""Contents of the private dialect's messages as frozen values, which `codec.py` encodes and decodes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import NamedTuple

from companion.protocol.dialect import oneway

REVISIONS = 256
"""Number of revisions of the picture after which their 8-bit numbers begin anew."""


class Directive(IntEnum):
    """The command that the ground station gives to all agents at once, or to one (ONEWAY_DIRECTIVE).

    The greater is the stronger: of the word for all and an agent's own the stronger one is obeyed.
    """

    NORMAL = oneway.ONEWAY_DIRECTIVE_NORMAL
    HOLD = oneway.ONEWAY_DIRECTIVE_HOLD
    RETURN = oneway.ONEWAY_DIRECTIVE_RETURN


class Kind(IntEnum):
    """The kind of object that was detected (ONEWAY_KIND)."""

    AGENT = oneway.ONEWAY_KIND_AGENT
    TARGET = oneway.ONEWAY_KIND_TARGET
    THREAT = oneway.ONEWAY_KIND_THREAT


class WireError(ValueError):
    """A value does not fit into a frame, or the fields of a received frame make no sense."""


@dataclass(frozen=True)
class AgentEntry:
    """Position and assigned target of an agent, and the directive for it alone.

    Both coordinates are None if the position is not known; an agent without a target (None) loiters.
    """

    id: int
    north_m: float | None
    east_m: float | None
    target_id: int | None
    directive: Directive = Directive.NORMAL

    @property
    def position_ned_m(self) -> tuple[float, float] | None:
        """Position (north, east) in m, None if it is not known."""
        return None if self.north_m is None or self.east_m is None else (self.north_m, self.east_m)


@dataclass(frozen=True)
class TargetEntry:
    """Position of a target."""

    id: int
    north_m: float
    east_m: float


@dataclass(frozen=True)
class ThreatEntry:
    """Position and radii of a threat; the radii include the distance that it may have moved since it was seen."""

    id: int
    north_m: float
    east_m: float
    detection_radius_m: float
    attack_radius_m: float
    speed_bound_m_s: float


@dataclass(frozen=True)
class Stamp:
    """Place of a frame in the stream of broadcasts: the greater (epoch_s, sequence) is, the newer is the broadcast."""

    epoch_s: int
    time_ms: int
    sequence: int
    frame_index: int = 0
    frame_count: int = 1

    @property
    def unix_s(self) -> float:
        """Time of the frame by the sender's clock, in Unix seconds."""
        return self.epoch_s + self.time_ms / 1000.0


@dataclass(frozen=True)
class StateFrame:
    """ONEWAY_STATE: agents with their assigned targets, targets and threats, on the plane about the origin."""

    stamp: Stamp
    origin_lat_deg: float
    origin_lon_deg: float
    directive: Directive
    revision: int
    """Number of the picture that the frame is a part of."""
    picture_threats: int
    """Number of threats in that picture, in all its frames together."""
    picture_targets: int
    """Number of targets in it; 255 means 255 or more."""
    resolution_cm: int
    """Length of the unit of positions and radii, the same for all frames of a revision."""
    agents: tuple[AgentEntry, ...]
    targets: tuple[TargetEntry, ...]
    threats: tuple[ThreatEntry, ...]
    is_last: bool = False
    """Whether this broadcast is the last: the ground station stops."""


@dataclass(frozen=True)
class AgentMotion:
    """Motion of an agent and age of its position; `heading_rad` is from grid north, None if unknown."""

    id: int
    heading_rad: float | None
    speed_m_s: float
    age_s: float


@dataclass(frozen=True)
class PointMotion:
    """Motion of a target or threat and age of its position."""

    id: int
    velocity_north_m_s: float
    velocity_east_m_s: float
    age_s: float


@dataclass(frozen=True)
class MotionFrame:
    """ONEWAY_MOTION: how agents, targets and threats move, and how old their positions are."""

    stamp: Stamp
    agents: tuple[AgentMotion, ...]
    targets: tuple[PointMotion, ...]
    threats: tuple[PointMotion, ...]


@dataclass(frozen=True)
class BandEntry:
    """Altitude limits of a threat, above sea level; None: no limit on that side."""

    id: int
    floor_m: float | None
    ceiling_m: float | None


@dataclass(frozen=True)
class BandsFrame:
    """ONEWAY_BANDS: altitude limits of threats. A threat that was never listed counts as reaching every altitude."""

    stamp: Stamp
    threats: tuple[BandEntry, ...]


@dataclass(frozen=True)
class Detection:
    """One object that the ground station's sensor saw; `id` is within its kind."""

    kind: Kind
    id: int
    north_m: float
    east_m: float
    velocity_north_m_s: float
    velocity_east_m_s: float


@dataclass(frozen=True)
class DetectionsFrame:
    """ONEWAY_DETECTIONS: the objects of one scan of a sensor, or a part of them; `epoch_s` begins the sensor's run."""

    epoch_s: int
    time_ms: int
    origin_lat_deg: float
    origin_lon_deg: float
    detections: tuple[Detection, ...]

    @property
    def unix_s(self) -> float:
        """Time of the scan by the sensor's clock, in Unix seconds."""
        return self.epoch_s + self.time_ms / 1000.0


@dataclass(frozen=True)
class ReportFrame:
    """ONEWAY_REPORT: an agent's position report on the uplink, if there is one. Velocities are along true north, east.

    `flown_m` is the distance flown under guidance.
    """

    epoch_s: int
    time_ms: int
    agent_id: int
    lat_deg: float
    lon_deg: float
    velocity_north_m_s: float
    velocity_east_m_s: float
    flown_m: float

    @property
    def unix_s(self) -> float:
        """Time of the position by the vehicle's clock, in Unix seconds."""
        return self.epoch_s + self.time_ms / 1000.0


@dataclass(frozen=True)
class ThreatPlace:
    """Position at which a threat was seen, `age_s` before the frame's time. Its radii are in a RadiiFrame."""

    id: int
    north_m: float
    east_m: float
    age_s: float


class Grid(NamedTuple):
    """The grid on which fleet frames tell positions, the same for all frames of a revision."""

    resolution_cm: int
    """Length of the unit."""
    north_base: int
    """North of the point from which positions count, in steps of BASE_STEP_UNITS units."""
    east_base: int
    """East of that point, likewise."""


@dataclass(frozen=True)
class FleetFrame:
    """ONEWAY_FLEET: some agents with their assigned targets, targets and threats, packed.

    Positions are on the plane about the origin in ONEWAY_MISSION.
    """

    stamp: Stamp
    directive: Directive
    revision: int
    """Number of the picture that the frame is a part of."""
    grid: Grid
    agents: tuple[AgentEntry, ...]
    targets: tuple[TargetEntry, ...]
    threats: tuple[ThreatPlace, ...]
    is_last: bool = False
    """Whether this broadcast is the last: the ground station stops."""

    @property
    def rounding_m(self) -> float:
        """Greatest error of a position from rounding: half a unit on both axes."""
        return math.sqrt(0.5) * self.grid.resolution_cm / 100.0


@dataclass(frozen=True)
class RadiiEntry:
    """Constant properties of a threat: radii, greatest speed and altitude limits (None: no limit on that side)."""

    id: int
    detection_radius_m: float
    attack_radius_m: float
    speed_bound_m_s: float
    floor_m: float | None = None
    ceiling_m: float | None = None


@dataclass(frozen=True)
class RadiiFrame:
    """ONEWAY_RADII: constant properties of some threats; the radii are not enlarged for the age of a position."""

    stamp: Stamp
    revision: int
    """Number of the picture that the radii are of."""
    resolution_cm: int
    """Length of the unit of the radii, the same for all frames of a revision."""
    threats: tuple[RadiiEntry, ...]


@dataclass(frozen=True)
class MissionFrame:
    """ONEWAY_MISSION: values of the mission that hold for the whole epoch, and the number of threats of a revision."""

    stamp: Stamp
    revision: int
    """Number of the picture that has this number of threats."""
    origin_lat_deg: float
    origin_lon_deg: float
    origin_alt_m: float
    separation_m: float
    arrival_radius_m: float
    surrogate_digest: bytes
    """First 8 bytes of the SHA-256 of the surrogate's weights; all zero if the mission uses none."""
    agents: int
    """Number of agents in the mission."""
    targets: int
    """Number of targets in the mission."""
    threats: int
    """Number of threats in the picture."""
    name: str
    mission_digest: bytes
    """First 8 bytes of a SHA-256 of the mission's origin and targets and of the picture's threats."""


class DecisionFlag(IntFlag):
    """What limited or changed a decision (ONEWAY_DECISION_FLAGS)."""

    TURN_LIMITED = oneway.ONEWAY_DECISION_TURN_LIMITED
    GUARD_CHANGED = oneway.ONEWAY_DECISION_GUARD_CHANGED
    UNCERTIFIED = oneway.ONEWAY_DECISION_UNCERTIFIED
    BROKEN = oneway.ONEWAY_DECISION_BROKEN
    GAVE_WAY = oneway.ONEWAY_DECISION_GAVE_WAY
    STAY = oneway.ONEWAY_DECISION_STAY
    OPPOSED = oneway.ONEWAY_DECISION_OPPOSED


@dataclass(frozen=True)
class DecisionFrame:
    """ONEWAY_DECISION: one decision of a companion, written to its own log and never sent.

    A number that the decision does not have is nan; all are rounded to 32-bit floats.
    """

    time_us: int
    purpose: int
    """Index of the purpose in `companion.onboard.decision.Purpose`."""
    stage: int
    """Index of the stage in `companion.onboard.failsafe.Stage`."""
    target_id: int | None
    flags: DecisionFlag
    picture_age_s: float
    wanted_heading_rad: float
    heading_rad: float
    """Heading of the setpoint."""
    speed_m_s: float
    """Speed of the setpoint."""
    altitude_m: float
    """Altitude of the setpoint."""
    certified_s: float
    """For how long from now the flight is certified to stay clear: inf for ever, 0 not at all."""
    words_crc: int
    """CRC-32 of the decision's texts (reason, changes, notes), by which a replay compares them with its own."""


Frame = (
    StateFrame
    | MotionFrame
    | BandsFrame
    | DetectionsFrame
    | ReportFrame
    | FleetFrame
    | RadiiFrame
    | MissionFrame
    | DecisionFrame
)
