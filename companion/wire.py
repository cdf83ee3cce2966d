"""Values <-> frames of the private dialect, and the checked reader of everything received.

A frame is one MAVLink 2 message. Encoding chooses the resolution of positions per frame and rounds radii up, so that a
receiver's disc always holds the true one; decoding trusts nothing: a message whose counts, ids, indices or ranges do
not make sense is dropped and counted, never raised.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from companion.dialect import oneway

AGENTS_PER_FRAME = 10
TARGETS_PER_FRAME = 5
THREATS_PER_FRAME = 4
DETECTIONS_PER_FRAME = 14
BANDS_PER_FRAME = 20
ID_SPAN = 256
"""Ids in one frame lie within this of the least one: they travel as 8 bits above a 16-bit base."""
SIGNATURE_BYTES = 64
GROUND_SYSTEM = 254
"""MAVLink system id of the ground station; 255/190 would be dropped by a receiver that is a ground station itself."""
GROUND_COMPONENT = 190
SENSOR_COMPONENT = 191

_INT16_MAX = 32_767
_INT16_MIN = -32_768
_UNKNOWN_POSITION = -32_768
"""INT16_MIN as north and east of an agent: nobody on the ground knows where it is (Case II)."""
_UINT16_MAX = 65_535
_UINT8_MAX = 255
_UINT32_MAX = 4_294_967_295
_INT32_MAX = 2_147_483_647
_LAT_MAX_E7 = 900_000_000
_LON_MAX_E7 = 1_800_000_000
_UNKNOWN_HEADING = 65_535
_MIN_RESOLUTION_CM = 1


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


Frame = StateFrame | MotionFrame | BandsFrame | DetectionsFrame | ReportFrame


class FrameWriter:
    """Encodes frames as one MAVLink component, numbering them as MAVLink does."""

    def __init__(self, system: int = GROUND_SYSTEM, component: int = GROUND_COMPONENT) -> None:
        self._mav = oneway.MAVLink(None, srcSystem=system, srcComponent=component)

    def encode(self, frame: Frame, signature: bytes = bytes(SIGNATURE_BYTES)) -> bytes:
        """Return the bytes of a frame; `signature` goes into its ed25519_signature field.

        Raises:
            WireError: the frame holds too many entries, or a value that does not fit its field.

        """
        if isinstance(frame, StateFrame):
            message = _state_message(frame, signature)
        elif isinstance(frame, MotionFrame):
            message = _motion_message(frame, signature)
        elif isinstance(frame, BandsFrame):
            message = _bands_message(frame, signature)
        elif isinstance(frame, DetectionsFrame):
            message = _detections_message(frame)
        else:
            message = _report_message(frame)
        data = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return data


class FrameReader:
    """Decodes datagrams into frames; anything else is dropped and counted by reason in `rejected`.

    The parser starts afresh with every datagram, so that junk in one cannot swallow the next.
    """

    def __init__(self) -> None:
        self.rejected: Counter[str] = Counter()
        self.accepted = 0

    def read(self, datagram: bytes) -> list[Frame]:
        """Return the genuine frames in a datagram, in order. Never raises, whatever the bytes."""
        parser = oneway.MAVLink(None)
        parser.robust_parsing = True
        frames: list[Frame] = []
        messages = parser.parse_buffer(bytes(datagram)) or ()
        if not messages:
            self.rejected["incomplete"] += 1
        for message in messages:
            name = message.get_type()
            if name == "BAD_DATA":
                self.rejected["damaged"] += 1
            elif name not in _DECODERS:
                self.rejected["foreign"] += 1
            else:
                try:
                    frames.append(_DECODERS[name](message))
                except WireError as error:
                    self.rejected[str(error)] += 1
        self.accepted += len(frames)
        return frames


def _state_message(frame: StateFrame, signature: bytes) -> oneway.MAVLink_oneway_state_message:
    located = [agent.position_ned_m for agent in frame.agents]
    points = [point for point in located if point is not None]
    points += [(target.north_m, target.east_m) for target in frame.targets]
    points += [(threat.north_m, threat.east_m) for threat in frame.threats]
    radii_m = [threat.detection_radius_m for threat in frame.threats]
    if any(not 0 < threat.attack_radius_m <= threat.detection_radius_m for threat in frame.threats):
        raise WireError("a threat's radii are not in order; allowed: 0 < attack radius <= detection radius")
    resolution_cm = frame_resolution_cm(points, radii_m)
    unit_m = resolution_cm / 100.0
    origin_lat, origin_lon = _on_earth_e7(frame.origin_lat_deg, frame.origin_lon_deg)
    frame_index, frame_count = _part(frame.stamp)
    agent_base, agent_ids = _based_ids([agent.id for agent in frame.agents], AGENTS_PER_FRAME, "agents")
    target_base, target_ids = _based_ids([target.id for target in frame.targets], TARGETS_PER_FRAME, "targets")
    threat_base, threat_ids = _based_ids([threat.id for threat in frame.threats], THREATS_PER_FRAME, "threats")
    place = {target.id: index + 1 for index, target in enumerate(frame.targets)}
    assigned = []
    for agent in frame.agents:
        if agent.target_id is not None and agent.target_id not in place:
            raise WireError(f"agent {agent.id} is assigned to target {agent.target_id}, which the frame lacks")
        assigned.append(0 if agent.target_id is None else place[agent.target_id])

    def coordinates(points: Sequence[tuple[float, float] | None], length: int) -> tuple[list[int], ...]:
        north = [_UNKNOWN_POSITION if point is None else round(point[0] / unit_m) for point in points]
        east = [_UNKNOWN_POSITION if point is None else round(point[1] / unit_m) for point in points]
        return _padded(north, length), _padded(east, length)

    agent_north, agent_east = coordinates(located, AGENTS_PER_FRAME)
    target_north, target_east = coordinates([(t.north_m, t.east_m) for t in frame.targets], TARGETS_PER_FRAME)
    threat_north, threat_east = coordinates([(t.north_m, t.east_m) for t in frame.threats], THREATS_PER_FRAME)
    rounding_m = unit_m * math.sqrt(0.5)

    def radius_units(radius_m: float) -> int:
        return math.ceil((radius_m + rounding_m) / unit_m)

    return oneway.MAVLink_oneway_state_message(
        epoch=_whole(frame.stamp.epoch_s, _UINT32_MAX, "epoch"),
        time_ms=_whole(frame.stamp.time_ms, _UINT32_MAX, "time_ms"),
        sequence=_whole(frame.stamp.sequence, _UINT32_MAX, "sequence"),
        origin_lat=origin_lat,
        origin_lon=origin_lon,
        agent_north=agent_north,
        agent_east=agent_east,
        target_north=target_north,
        target_east=target_east,
        threat_north=threat_north,
        threat_east=threat_east,
        threat_detection=_padded([radius_units(t.detection_radius_m) for t in frame.threats], THREATS_PER_FRAME),
        threat_attack=_padded([radius_units(t.attack_radius_m) for t in frame.threats], THREATS_PER_FRAME),
        resolution=resolution_cm,
        agent_id_base=agent_base,
        target_id_base=target_base,
        threat_id_base=threat_base,
        directive=int(frame.directive),
        frame_index=frame_index,
        frame_count=frame_count,
        agent_count=len(frame.agents),
        target_count=len(frame.targets),
        threat_count=len(frame.threats),
        threat_speed_bound=_padded(
            [_ceiling(t.speed_bound_m_s, _UINT8_MAX, "threat_speed_bound") for t in frame.threats],
            THREATS_PER_FRAME,
        ),
        threat_id=threat_ids,
        target_id=target_ids,
        agent_id=agent_ids,
        agent_target=_padded(assigned, AGENTS_PER_FRAME),
        ed25519_signature=_signature(signature),
    )


def _motion_message(frame: MotionFrame, signature: bytes) -> oneway.MAVLink_oneway_motion_message:
    agent_base, agent_ids = _based_ids([agent.id for agent in frame.agents], AGENTS_PER_FRAME, "agents")
    target_base, target_ids = _based_ids([target.id for target in frame.targets], TARGETS_PER_FRAME, "targets")
    threat_base, threat_ids = _based_ids([threat.id for threat in frame.threats], THREATS_PER_FRAME, "threats")

    def velocities(entries: Sequence[PointMotion], length: int) -> tuple[list[int], list[int], list[int]]:
        return (
            _padded([_speed_cm_s(entry.velocity_north_m_s) for entry in entries], length),
            _padded([_speed_cm_s(entry.velocity_east_m_s) for entry in entries], length),
            _padded([_age_ds(entry.age_s, _UINT16_MAX) for entry in entries], length),
        )

    target_north, target_east, target_age = velocities(frame.targets, TARGETS_PER_FRAME)
    threat_north, threat_east, threat_age = velocities(frame.threats, THREATS_PER_FRAME)
    frame_index, frame_count = _part(frame.stamp)
    return oneway.MAVLink_oneway_motion_message(
        epoch=_whole(frame.stamp.epoch_s, _UINT32_MAX, "epoch"),
        time_ms=_whole(frame.stamp.time_ms, _UINT32_MAX, "time_ms"),
        sequence=_whole(frame.stamp.sequence, _UINT32_MAX, "sequence"),
        agent_heading=_padded([_heading_cdeg(agent.heading_rad) for agent in frame.agents], AGENTS_PER_FRAME),
        agent_speed=_padded(
            [_whole(_rounded(agent.speed_m_s * 100), _UINT16_MAX, "agent_speed") for agent in frame.agents],
            AGENTS_PER_FRAME,
        ),
        target_velocity_north=target_north,
        target_velocity_east=target_east,
        threat_velocity_north=threat_north,
        threat_velocity_east=threat_east,
        target_age=target_age,
        threat_age=threat_age,
        agent_id_base=agent_base,
        target_id_base=target_base,
        threat_id_base=threat_base,
        frame_index=frame_index,
        frame_count=frame_count,
        agent_count=len(frame.agents),
        target_count=len(frame.targets),
        threat_count=len(frame.threats),
        agent_age=_padded([_age_ds(agent.age_s, _UINT8_MAX) for agent in frame.agents], AGENTS_PER_FRAME),
        threat_id=threat_ids,
        target_id=target_ids,
        agent_id=agent_ids,
        ed25519_signature=_signature(signature),
    )


def _bands_message(frame: BandsFrame, signature: bytes) -> oneway.MAVLink_oneway_bands_message:
    base, ids = _based_ids([threat.id for threat in frame.threats], BANDS_PER_FRAME, "threats")
    limits = [_band_limits(threat) for threat in frame.threats]
    frame_index, frame_count = _part(frame.stamp)
    return oneway.MAVLink_oneway_bands_message(
        epoch=_whole(frame.stamp.epoch_s, _UINT32_MAX, "epoch"),
        time_ms=_whole(frame.stamp.time_ms, _UINT32_MAX, "time_ms"),
        sequence=_whole(frame.stamp.sequence, _UINT32_MAX, "sequence"),
        threat_floor=_padded([floor for floor, _ in limits], BANDS_PER_FRAME),
        threat_ceiling=_padded([ceiling for _, ceiling in limits], BANDS_PER_FRAME),
        threat_id_base=base,
        frame_index=frame_index,
        frame_count=frame_count,
        threat_count=len(frame.threats),
        threat_id=ids,
        ed25519_signature=_signature(signature),
    )


def _band_limits(threat: BandEntry) -> tuple[int, int]:
    """Return floor and ceiling in whole metres, never a narrower band than the true one."""
    floor = _INT16_MIN if threat.floor_m is None else _height_m(threat.floor_m, math.floor)
    ceiling = _INT16_MAX if threat.ceiling_m is None else _height_m(threat.ceiling_m, math.ceil)
    if threat.floor_m is not None and threat.ceiling_m is not None and threat.floor_m >= threat.ceiling_m:
        raise WireError(f"threat {threat.id} has its floor at or above its ceiling")
    return floor, ceiling


def _height_m(height_m: float, rounded: Callable[[float], int]) -> int:
    if not _INT16_MIN + 1 <= height_m <= _INT16_MAX - 1:
        raise WireError(f"a height of {height_m} m does not fit a frame")
    return rounded(height_m)


def _detections_message(frame: DetectionsFrame) -> oneway.MAVLink_oneway_detections_message:
    seen = frame.detections
    if len(seen) > DETECTIONS_PER_FRAME:
        raise WireError(f"{len(seen)} detections; a frame holds {DETECTIONS_PER_FRAME}")
    length = DETECTIONS_PER_FRAME
    origin_lat, origin_lon = _on_earth_e7(frame.origin_lat_deg, frame.origin_lon_deg)
    return oneway.MAVLink_oneway_detections_message(
        epoch=_whole(frame.epoch_s, _UINT32_MAX, "epoch"),
        time_ms=_whole(frame.time_ms, _UINT32_MAX, "time_ms"),
        origin_lat=origin_lat,
        origin_lon=origin_lon,
        north=_padded([_coordinate_cm(item.north_m) for item in seen], length),
        east=_padded([_coordinate_cm(item.east_m) for item in seen], length),
        velocity_north=_padded([_speed_cm_s(item.velocity_north_m_s) for item in seen], length),
        velocity_east=_padded([_speed_cm_s(item.velocity_east_m_s) for item in seen], length),
        id=_padded([_whole(item.id, _UINT16_MAX, "id") for item in seen], length),
        count=len(seen),
        kind=_padded([int(item.kind) for item in seen], length),
    )


def _report_message(frame: ReportFrame) -> oneway.MAVLink_oneway_report_message:
    lat_e7, lon_e7 = _on_earth_e7(frame.lat_deg, frame.lon_deg)
    return oneway.MAVLink_oneway_report_message(
        epoch=_whole(frame.epoch_s, _UINT32_MAX, "epoch"),
        time_ms=_whole(frame.time_ms, _UINT32_MAX, "time_ms"),
        lat=lat_e7,
        lon=lon_e7,
        flown=_ceiling(frame.flown_m, _UINT32_MAX, "flown"),
        velocity_north=_speed_cm_s(frame.velocity_north_m_s),
        velocity_east=_speed_cm_s(frame.velocity_east_m_s),
        agent_id=_whole(frame.agent_id, _UINT16_MAX, "agent_id"),
    )


def _state_frame(message: oneway.MAVLink_oneway_state_message) -> StateFrame:
    stamp = _stamp(message)
    origin_lat_deg, origin_lon_deg = _origin(message)
    if message.directive > max(Directive):
        raise WireError("unknown directive")
    unit_m = message.resolution / 100.0
    if unit_m <= 0:
        raise WireError("resolution is zero")
    agent_ids = _ids(message.agent_id_base, message.agent_id, message.agent_count)
    target_ids = _ids(message.target_id_base, message.target_id, message.target_count)
    threat_ids = _ids(message.threat_id_base, message.threat_id, message.threat_count)
    assigned = message.agent_target[: len(agent_ids)]
    if any(place > len(target_ids) for place in assigned):
        raise WireError("assigned to a target that is not there")
    return StateFrame(
        stamp=stamp,
        origin_lat_deg=origin_lat_deg,
        origin_lon_deg=origin_lon_deg,
        directive=Directive(message.directive),
        agents=tuple(
            AgentEntry(identity, *_position_m(north, east, unit_m), target_ids[place - 1] if place else None)
            for identity, north, east, place in zip(
                agent_ids, message.agent_north, message.agent_east, assigned, strict=False
            )
        ),
        targets=tuple(
            TargetEntry(identity, north * unit_m, east * unit_m)
            for identity, north, east in zip(target_ids, message.target_north, message.target_east, strict=False)
        ),
        threats=tuple(_threat_entry(identity, message, index, unit_m) for index, identity in enumerate(threat_ids)),
    )


def _position_m(north: int, east: int, unit_m: float) -> tuple[float | None, float | None]:
    unknown = (north == _UNKNOWN_POSITION, east == _UNKNOWN_POSITION)
    if unknown == (True, True):
        return None, None
    if any(unknown):
        raise WireError("half a position")
    return north * unit_m, east * unit_m


def _threat_entry(
    identity: int, message: oneway.MAVLink_oneway_state_message, index: int, unit_m: float
) -> ThreatEntry:
    detection_units, attack_units = message.threat_detection[index], message.threat_attack[index]
    if not 0 < attack_units <= detection_units:
        raise WireError("radii out of range")
    return ThreatEntry(
        id=identity,
        north_m=message.threat_north[index] * unit_m,
        east_m=message.threat_east[index] * unit_m,
        detection_radius_m=detection_units * unit_m,
        attack_radius_m=attack_units * unit_m,
        speed_bound_m_s=float(message.threat_speed_bound[index]),
    )


def _motion_frame(message: oneway.MAVLink_oneway_motion_message) -> MotionFrame:
    agent_ids = _ids(message.agent_id_base, message.agent_id, message.agent_count)
    target_ids = _ids(message.target_id_base, message.target_id, message.target_count)
    threat_ids = _ids(message.threat_id_base, message.threat_id, message.threat_count)
    headings_rad = [_heading_rad(value) for value in message.agent_heading[: len(agent_ids)]]
    return MotionFrame(
        stamp=_stamp(message),
        agents=tuple(
            AgentMotion(identity, heading_rad, speed / 100.0, age / 10.0)
            for identity, heading_rad, speed, age in zip(
                agent_ids, headings_rad, message.agent_speed, message.agent_age, strict=False
            )
        ),
        targets=_point_motions(
            target_ids, message.target_velocity_north, message.target_velocity_east, message.target_age
        ),
        threats=_point_motions(
            threat_ids, message.threat_velocity_north, message.threat_velocity_east, message.threat_age
        ),
    )


def _point_motions(
    ids: Iterable[int], north: Iterable[int], east: Iterable[int], age: Iterable[int]
) -> tuple[PointMotion, ...]:
    return tuple(
        PointMotion(identity, north_cm_s / 100.0, east_cm_s / 100.0, age_ds / 10.0)
        for identity, north_cm_s, east_cm_s, age_ds in zip(ids, north, east, age, strict=False)
    )


def _bands_frame(message: oneway.MAVLink_oneway_bands_message) -> BandsFrame:
    ids = _ids(message.threat_id_base, message.threat_id, message.threat_count)
    limits = list(zip(message.threat_floor, message.threat_ceiling, strict=True))[: len(ids)]
    if any(floor >= ceiling for floor, ceiling in limits):
        raise WireError("band out of range")
    return BandsFrame(
        stamp=_stamp(message),
        threats=tuple(
            BandEntry(
                identity,
                None if floor == _INT16_MIN else float(floor),
                None if ceiling == _INT16_MAX else float(ceiling),
            )
            for identity, (floor, ceiling) in zip(ids, limits, strict=True)
        ),
    )


def _detections_frame(message: oneway.MAVLink_oneway_detections_message) -> DetectionsFrame:
    if message.count > DETECTIONS_PER_FRAME:
        raise WireError("count out of range")
    if any(kind > max(Kind) for kind in message.kind[: message.count]):
        raise WireError("unknown kind")
    origin_lat_deg, origin_lon_deg = _origin(message)
    return DetectionsFrame(
        epoch_s=message.epoch,
        time_ms=message.time_ms,
        origin_lat_deg=origin_lat_deg,
        origin_lon_deg=origin_lon_deg,
        detections=tuple(
            Detection(
                Kind(message.kind[index]),
                message.id[index],
                message.north[index] / 100.0,
                message.east[index] / 100.0,
                message.velocity_north[index] / 100.0,
                message.velocity_east[index] / 100.0,
            )
            for index in range(message.count)
        ),
    )


def _report_frame(message: oneway.MAVLink_oneway_report_message) -> ReportFrame:
    if abs(message.lat) > _LAT_MAX_E7 or abs(message.lon) > _LON_MAX_E7:
        raise WireError("position out of range")
    return ReportFrame(
        epoch_s=message.epoch,
        time_ms=message.time_ms,
        agent_id=message.agent_id,
        lat_deg=message.lat / 1e7,
        lon_deg=message.lon / 1e7,
        velocity_north_m_s=message.velocity_north / 100.0,
        velocity_east_m_s=message.velocity_east / 100.0,
        flown_m=float(message.flown),
    )


_DECODERS: dict[str, Callable[[Any], Frame]] = {
    "ONEWAY_STATE": _state_frame,
    "ONEWAY_MOTION": _motion_frame,
    "ONEWAY_BANDS": _bands_frame,
    "ONEWAY_DETECTIONS": _detections_frame,
    "ONEWAY_REPORT": _report_frame,
}


def frame_resolution_cm(points: Sequence[tuple[float, float]], radii_m: Sequence[float]) -> int:
    """Return the finest resolution, in whole cm, at which every position and radius fits its 16 bits."""
    reach_m = max((max(abs(north_m), abs(east_m)) for north_m, east_m in points), default=0.0)
    radius_m = max(radii_m, default=0.0)
    if not (math.isfinite(reach_m) and math.isfinite(radius_m)):
        raise WireError("a position or radius is not finite")
    # A radius gains up to sqrt(1/2) of a unit for the rounding of its centre and up to one for its own.
    needed_cm = max(100 * reach_m / _INT16_MAX, 100 * radius_m / (_UINT16_MAX - 2))
    if needed_cm > _UINT16_MAX:
        raise WireError(
            f"a position {reach_m:.3g} m from the origin or a radius of {radius_m:.3g} m does not fit a frame"
        )
    return max(_MIN_RESOLUTION_CM, math.ceil(needed_cm))


def _based_ids(ids: Sequence[int], length: int, what: str) -> tuple[int, list[int]]:
    if len(ids) > length:
        raise WireError(f"{len(ids)} {what}; a frame holds {length}")
    if not ids:
        return 0, [0] * length
    base = min(ids)
    if max(ids) - base >= ID_SPAN:
        raise WireError(f"{what}: ids {base} and {max(ids)} are too far apart for one frame")
    if len(set(ids)) != len(ids):
        raise WireError(f"{what}: an id is given twice")
    _whole(max(ids), _UINT16_MAX, f"{what} id")
    return _whole(base, _UINT16_MAX, f"{what} id"), _padded([identity - base for identity in ids], length)


def _ids(base: int, offsets: Sequence[int], count: int) -> list[int]:
    if count > len(offsets):
        raise WireError("count out of range")
    ids = [base + offset for offset in offsets[:count]]
    if len(set(ids)) != count or any(identity > _UINT16_MAX for identity in ids):
        raise WireError("ids out of range")
    return ids


def _stamp(
    message: oneway.MAVLink_oneway_state_message
    | oneway.MAVLink_oneway_motion_message
    | oneway.MAVLink_oneway_bands_message,
) -> Stamp:
    if message.frame_index >= message.frame_count:
        raise WireError("frame index out of range")
    return Stamp(message.epoch, message.time_ms, message.sequence, message.frame_index, message.frame_count)


def _origin(
    message: oneway.MAVLink_oneway_state_message | oneway.MAVLink_oneway_detections_message,
) -> tuple[float, float]:
    if abs(message.origin_lat) > _LAT_MAX_E7 or abs(message.origin_lon) > _LON_MAX_E7:
        raise WireError("origin out of range")
    return message.origin_lat / 1e7, message.origin_lon / 1e7


def _padded(values: list[int], length: int) -> list[int]:
    return values + [0] * (length - len(values))


def _whole(value: int, greatest: int, what: str) -> int:
    if not 0 <= value <= greatest:
        raise WireError(f"{what} {value} does not fit its field; allowed: 0 to {greatest}")
    return value


def _rounded(value: float) -> int:
    if not math.isfinite(value):
        raise WireError(f"{value} does not fit any field; allowed: a finite number")
    return round(value)


def _ceiling(value: float, greatest: int, what: str) -> int:
    _rounded(value)
    return _whole(math.ceil(value), greatest, what)


def _coordinate_cm(coordinate_m: float) -> int:
    value_cm = _rounded(coordinate_m * 100)
    if abs(value_cm) > _INT32_MAX:
        raise WireError(f"a position {coordinate_m:.0f} m from the origin does not fit a frame")
    return value_cm


def _on_earth_e7(lat_deg: float, lon_deg: float) -> tuple[int, int]:
    lat_e7, lon_e7 = _rounded(lat_deg * 1e7), _rounded(lon_deg * 1e7)
    if abs(lat_e7) > _LAT_MAX_E7 or abs(lon_e7) > _LON_MAX_E7:
        raise WireError(f"{lat_deg}, {lon_deg} is not on Earth")
    return lat_e7, lon_e7


def _part(stamp: Stamp) -> tuple[int, int]:
    """Return frame index and count."""
    count = _whole(stamp.frame_count, _UINT8_MAX, "frame_count")
    return _whole(stamp.frame_index, count - 1, "frame_index"), count


def _speed_cm_s(speed_m_s: float) -> int:
    return max(-_INT16_MAX, min(_INT16_MAX, _rounded(speed_m_s * 100)))


def _age_ds(age_s: float, greatest: int) -> int:
    if not age_s >= 0:
        raise WireError(f"an age of {age_s} s does not fit its field; allowed: 0 or more")
    return math.ceil(min(round(age_s * 10, 6), greatest))


def _heading_cdeg(heading_rad: float | None) -> int:
    return _UNKNOWN_HEADING if heading_rad is None else _rounded(math.degrees(heading_rad) * 100) % 36_000


def _heading_rad(value_cdeg: int) -> float | None:
    if value_cdeg == _UNKNOWN_HEADING:
        return None
    if value_cdeg >= 36_000:
        raise WireError("heading out of range")
    return math.radians(value_cdeg / 100.0)


def _signature(signature: bytes) -> list[int]:
    if len(signature) != SIGNATURE_BYTES:
        raise WireError(f"a signature of {len(signature)} bytes; allowed: {SIGNATURE_BYTES}")
    return list(signature)
