"""What travels between ground station, vehicles and logs, as values; `codec.py` makes bytes of them and back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from companion.protocol.dialect import oneway


class Directive(IntEnum):
    """What the ground station wants of every agent at once (ONEWAY_DIRECTIVE)."""

    NORMAL = oneway.ONEWAY_DIRECTIVE_NORMAL
    HOLD = oneway.ONEWAY_DIRECTIVE_HOLD
    RETURN = oneway.ONEWAY_DIRECTIVE_RETURN


class Kind(IntEnum):
    """What a detection is of (ONEWAY_KIND)."""

    AGENT = oneway.ONEWAY_KIND_AGENT
    TARGET = oneway.ONEWAY_KIND_TARGET
    THREAT = oneway.ONEWAY_KIND_THREAT


class WireError(ValueError):
    """Values that no frame can carry."""


@dataclass(frozen=True)
class AgentEntry:
    """Which target an agent goes to (None: loiter), and where it is; both coordinates are None if that is not known."""

    id: int
    north_m: float | None
    east_m: float | None
    target_id: int | None

    @property
    def position_ned_m(self) -> tuple[float, float] | None:
        """(north, east), None if not known."""
        return None if self.north_m is None or self.east_m is None else (self.north_m, self.east_m)


@dataclass(frozen=True)
class TargetEntry:
    """Where a target is."""

    id: int
    north_m: float
    east_m: float


@dataclass(frozen=True)
class ThreatEntry:
    """Where a threat is. The radii already hold what it may have moved since it was seen."""

    id: int
    north_m: float
    east_m: float
    detection_radius_m: float
    attack_radius_m: float
    speed_bound_m_s: float


@dataclass(frozen=True)
class Stamp:
    """Which broadcast a frame belongs to; the order of (epoch, sequence) is the order of age."""

    epoch_s: int
    time_ms: int
    sequence: int
    frame_index: int = 0
    frame_count: int = 1

    @property
    def unix_s(self) -> float:
        """Time of the frame as the sender's clock had it."""
        return self.epoch_s + self.time_ms / 1000.0


@dataclass(frozen=True)
class StateFrame:
    """ONEWAY_STATE: who goes where and where the threats are, on the plane about the origin."""

    stamp: Stamp
    origin_lat_deg: float
    origin_lon_deg: float
    directive: Directive
    agents: tuple[AgentEntry, ...]
    targets: tuple[TargetEntry, ...]
    threats: tuple[ThreatEntry, ...]


@dataclass(frozen=True)
class AgentMotion:
    """How an agent moves; heading_rad is None if unknown."""

    id: int
    heading_rad: float | None
    speed_m_s: float
    age_s: float


@dataclass(frozen=True)
class PointMotion:
    """How a target or threat moves."""

    id: int
    velocity_north_m_s: float
    velocity_east_m_s: float
    age_s: float


@dataclass(frozen=True)
class MotionFrame:
    """ONEWAY_MOTION: velocities, headings and ages."""

    stamp: Stamp
    agents: tuple[AgentMotion, ...]
    targets: tuple[PointMotion, ...]
    threats: tuple[PointMotion, ...]


@dataclass(frozen=True)
class BandEntry:
    """Between which heights above sea level a threat reaches; None: no limit on that side."""

    id: int
    floor_m: float | None
    ceiling_m: float | None


@dataclass(frozen=True)
class BandsFrame:
    """ONEWAY_BANDS: the heights that threats reach. Who is not in it may reach everywhere."""

    stamp: Stamp
    threats: tuple[BandEntry, ...]


@dataclass(frozen=True)
class Detection:
    """Something the centre's sensor saw."""

    kind: Kind
    id: int
    north_m: float
    east_m: float
    velocity_north_m_s: float
    velocity_east_m_s: float


@dataclass(frozen=True)
class DetectionsFrame:
    """ONEWAY_DETECTIONS: one look of a sensor, or a part of one."""

    epoch_s: int
    time_ms: int
    origin_lat_deg: float
    origin_lon_deg: float
    detections: tuple[Detection, ...]

    @property
    def unix_s(self) -> float:
        """Time of the look as the sensor's clock had it."""
        return self.epoch_s + self.time_ms / 1000.0


@dataclass(frozen=True)
class ReportFrame:
    """ONEWAY_REPORT: where an agent is, on the uplink where there is one. Velocities are from true north."""

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
        """Time of the position as the vehicle's clock had it."""
        return self.epoch_s + self.time_ms / 1000.0


@dataclass(frozen=True)
class ThreatPlace:
    """Where a threat was seen, `age_s` before the frame's time. Its radii travel in another frame."""

    id: int
    north_m: float
    east_m: float
    age_s: float


@dataclass(frozen=True)
class FleetFrame:
    """ONEWAY_FLEET: a part of who goes where and where the threats are, packed; the origin is in ONEWAY_MISSION."""

    stamp: Stamp
    directive: Directive
    resolution_cm: int
    """One unit of every position."""
    agents: tuple[AgentEntry, ...]
    targets: tuple[TargetEntry, ...]
    threats: tuple[ThreatPlace, ...]

    @property
    def rounding_m(self) -> float:
        """How far a position may be from the true one: half a unit on both axes."""
        return math.sqrt(0.5) * self.resolution_cm / 100.0


@dataclass(frozen=True)
class RadiiEntry:
    """What of a threat does not change: its radii, greatest speed and, where it has any, least and greatest height."""

    id: int
    detection_radius_m: float
    attack_radius_m: float
    speed_bound_m_s: float
    floor_m: float | None = None
    ceiling_m: float | None = None


@dataclass(frozen=True)
class RadiiFrame:
    """ONEWAY_RADII: the radii of some threats, when they were just seen."""

    stamp: Stamp
    threats: tuple[RadiiEntry, ...]


@dataclass(frozen=True)
class MissionFrame:
    """ONEWAY_MISSION: what holds for the whole epoch."""

    stamp: Stamp
    origin_lat_deg: float
    origin_lon_deg: float
    origin_alt_m: float
    separation_m: float
    arrival_radius_m: float
    surrogate_digest: bytes
    """The first 8 bytes of the SHA-256 of the weights; all zero where the mission uses none."""
    agents: int
    """How many the mission has."""
    targets: int
    threats: int
    name: str
    mission_digest: bytes
    """8 bytes that are others when the origin, a target or a threat of the mission is another."""


class DecisionFlag(IntFlag):
    """What else is true of a decision (ONEWAY_DECISION_FLAGS)."""

    TURN_LIMITED = oneway.ONEWAY_DECISION_TURN_LIMITED
    GUARD_CHANGED = oneway.ONEWAY_DECISION_GUARD_CHANGED
    UNCERTIFIED = oneway.ONEWAY_DECISION_UNCERTIFIED
    BROKEN = oneway.ONEWAY_DECISION_BROKEN
    GAVE_WAY = oneway.ONEWAY_DECISION_GAVE_WAY
    STAY = oneway.ONEWAY_DECISION_STAY
    OPPOSED = oneway.ONEWAY_DECISION_OPPOSED


@dataclass(frozen=True)
class DecisionFrame:
    """ONEWAY_DECISION: what a companion decided, in its own log only. nan: there is none.

    Numbers are held as 32-bit floats.
    """

    time_us: int
    purpose: int
    """Place of the purpose in `companion.onboard.decision.Purpose`."""
    stage: int
    """Place of the stage in `companion.onboard.failsafe.Stage`."""
    target_id: int | None
    flags: DecisionFlag
    picture_age_s: float
    wanted_heading_rad: float
    heading_rad: float
    """The setpoint's, like speed and altitude."""
    speed_m_s: float
    altitude_m: float
    words_crc: int
    """CRC-32 of the decision's words: a replay that decides the same says the same."""


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
