"""Encoder and decoder of the private dialect's messages (`oneway.xml`), with every range check on what is received.

A frame is one MAVLink 2 message. Encoding rounds positions to the given resolution, which is one for all frames of a
revision, and radii up, so that a receiver's disc of a threat always contains the true one. Decoding trusts nothing:
counts, ids, indices or values that make no sense raise WireError, which `FrameReader` counts. Frames are encoded
without signatures, which are added to the finished bytes (companion/protocol/ed25519.py,
companion/protocol/mavlink_signing.py).
"""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from types import SimpleNamespace as Fields
from typing import Any

from companion.protocol.dialect import oneway
from companion.protocol.fields import (
    INT16_MAX,
    INT16_MIN,
    INT32_MAX,
    UINT8_MAX,
    UINT16_MAX,
    UINT32_MAX,
    UINT64_MAX,
    band_limits,
    band_of,
    bound_code,
    bound_of,
    ceiling,
    ceiling_units,
    degrees_of,
    on_earth_e7,
    rounded,
    whole,
)
from companion.protocol.fleet_codec import (
    FLEET_HEAD_BYTES,
    MISSION_HEAD_BYTES,
    PAYLOAD_BYTES,
    RADII_HEAD_BYTES,
    FleetEntry,
    directive_of,
    read_fleet,
    read_radii,
    write_fleet,
    write_radii,
)
from companion.protocol.frame import ED25519_BYTES, RawFrame, raw_frame
from companion.protocol.messages import (
    AgentEntry,
    AgentMotion,
    BandEntry,
    BandsFrame,
    DecisionFlag,
    DecisionFrame,
    Detection,
    DetectionsFrame,
    Directive,
    FleetFrame,
    Frame,
    Grid,
    Kind,
    MissionFrame,
    MotionFrame,
    PointMotion,
    RadiiEntry,
    RadiiFrame,
    ReportFrame,
    Stamp,
    StateFrame,
    TargetEntry,
    ThreatEntry,
    ThreatPlace,
    WireError,
)

__all__ = [
    "AGENTS_PER_FRAME",
    "BANDS_PER_FRAME",
    "DETECTIONS_PER_FRAME",
    "GROUND_COMPONENT",
    "GROUND_SYSTEM",
    "ID_SPAN",
    "SENSOR_COMPONENT",
    "TARGETS_PER_FRAME",
    "THREATS_PER_FRAME",
    "AgentEntry",
    "AgentMotion",
    "BandEntry",
    "BandsFrame",
    "DecisionFlag",
    "DecisionFrame",
    "Detection",
    "DetectionsFrame",
    "Directive",
    "FleetFrame",
    "Frame",
    "FrameReader",
    "FrameWriter",
    "Grid",
    "Kind",
    "MissionFrame",
    "MotionFrame",
    "PointMotion",
    "RadiiEntry",
    "RadiiFrame",
    "ReportFrame",
    "Stamp",
    "StateFrame",
    "TargetEntry",
    "ThreatEntry",
    "ThreatPlace",
    "WireError",
    "decode_frame",
    "frame_resolution_cm",
]

# The lengths of the arrays in ONEWAY_STATE and ONEWAY_MOTION, ONEWAY_DETECTIONS and ONEWAY_BANDS.
AGENTS_PER_FRAME = 10
TARGETS_PER_FRAME = 5
THREATS_PER_FRAME = 4
DETECTIONS_PER_FRAME = 14
BANDS_PER_FRAME = 20
ID_SPAN = 256
"""Bound on the span of a frame's ids of one kind: each is sent as 8 bits above a 16-bit base."""
GROUND_SYSTEM = 254
"""MAVLink system id of the ground station; 255/190 would be dropped by a receiver that is a ground station itself."""
GROUND_COMPONENT = 190
"""MAVLink component id of the ground station (MAV_COMP_ID_MISSIONPLANNER)."""
SENSOR_COMPONENT = 191
"""MAVLink component id of the ground station's sensor (docs/wire.md)."""

_UNKNOWN_POSITION = INT16_MIN
"""Value of north and east for an agent whose position the ground station does not know (Case II)."""
_UNKNOWN_HEADING = UINT16_MAX
"""Value of the heading of an agent whose heading is unknown."""
_MIN_RESOLUTION_CM = 1
DIGEST_BYTES = 8
_MISSION_NAME_BYTES = PAYLOAD_BYTES - MISSION_HEAD_BYTES
_DIRECTIVE_SHIFT = 6
"""Place of an agent's own directive in `agent_target`, whose lower bits say which of the frame's targets is its."""
_LAST = 0x80
"""Bit of `directive` that says that the broadcast is the last; programs that do not know it refuse the frame."""
_NO_SIGNATURE = [0] * ED25519_BYTES


class FrameWriter:
    """Encodes frames as one MAVLink component, numbered by MAVLink's own sequence byte."""

    def __init__(self, system: int = GROUND_SYSTEM, component: int = GROUND_COMPONENT) -> None:
        self._mav = oneway.MAVLink(None, srcSystem=system, srcComponent=component)

    def encode(self, frame: Frame) -> bytes:
        """Return the bytes of a frame, unsigned.

        Raises:
            WireError: the frame holds too many entries, or a value that does not fit its field.

        """
        data = bytes(_ENCODERS[type(frame)](frame).pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return data


class FrameReader:
    """Decodes datagrams of a trusted channel; what is no valid frame is dropped and counted by reason in `rejected`.

    Each datagram gets a new parser, so that junk in one cannot swallow a frame of the next.
    """

    def __init__(self) -> None:
        self.rejected: Counter[str] = Counter()

    def read(self, datagram: bytes) -> list[Frame]:
        """Return the valid frames in a datagram, in order; signatures are not checked. Never raises."""
        parser = oneway.MAVLink(None)
        parser.robust_parsing = True
        frames: list[Frame] = []
        messages = parser.parse_buffer(bytes(datagram)) or ()
        if not messages:
            self.rejected["incomplete"] += 1
        for message in messages:
            if message.get_type() == "BAD_DATA":
                self.rejected["damaged"] += 1
                continue
            try:
                frames.append(decode_frame(raw_frame(bytes(message.get_msgbuf()))))
            except WireError as error:
                self.rejected[str(error)] += 1
        return frames


def decode_frame(raw: RawFrame) -> Frame:
    """Return the decoded content of a MAVLink 2 frame whose checksum the caller has verified.

    Neither a MAVLink signature nor an Ed25519 signature is checked.

    Raises:
        WireError: the frame is not one of the dialect's own messages, or its fields make no sense; the text is fixed
            for each fault.

    """
    if raw.version != 2 or raw.message_id not in _DECODERS:
        raise WireError("foreign")
    return _DECODERS[raw.message_id](_fields(raw.message_id, raw.payload))


def _fields(number: int, payload: bytes) -> Fields:
    """Return a payload's fields by name, arrays as tuples, with the trailing zeros that MAVLink cut restored."""
    kind = oneway.mavlink_map[number]
    values = kind.unpacker.unpack(payload[: kind.unpacker.size].ljust(kind.unpacker.size, b"\0"))
    named: dict[str, object] = {}
    at = 0
    for name, length in zip(kind.ordered_fieldnames, kind.lengths, strict=True):
        named[name] = values[at] if length == 1 else values[at : at + length]
        at += length
    return Fields(**named)


def _state_message(frame: StateFrame) -> oneway.MAVLink_oneway_state_message:
    if any(not 0 < threat.attack_radius_m <= threat.detection_radius_m for threat in frame.threats):
        raise WireError("a threat's radii are not in order; allowed: 0 < attack radius <= detection radius")
    agents = [agent.position_ned_m for agent in frame.agents]
    targets = [(target.north_m, target.east_m) for target in frame.targets]
    threats = [(threat.north_m, threat.east_m) for threat in frame.threats]
    unit_m = whole(frame.resolution_cm, UINT16_MAX, "resolution") / 100.0
    if unit_m == 0.0:
        raise WireError("a resolution of 0 cm does not fit its field; allowed: 1 or more")
    origin_lat, origin_lon = on_earth_e7(frame.origin_lat_deg, frame.origin_lon_deg)
    frame_index, frame_count = _part(frame.stamp)
    agent_base, agent_ids = _based_ids([agent.id for agent in frame.agents], AGENTS_PER_FRAME, "agents")
    target_base, target_ids = _based_ids([target.id for target in frame.targets], TARGETS_PER_FRAME, "targets")
    threat_base, threat_ids = _based_ids([threat.id for threat in frame.threats], THREATS_PER_FRAME, "threats")
    agent_target = _padded(_assigned(frame), AGENTS_PER_FRAME)
    agent_north, agent_east = _coordinates(agents, unit_m, AGENTS_PER_FRAME)
    target_north, target_east = _coordinates(targets, unit_m, TARGETS_PER_FRAME)
    threat_north, threat_east = _coordinates(threats, unit_m, THREATS_PER_FRAME)
    return oneway.MAVLink_oneway_state_message(
        **_times(frame.stamp),
        origin_lat=origin_lat,
        origin_lon=origin_lon,
        agent_north=agent_north,
        agent_east=agent_east,
        target_north=target_north,
        target_east=target_east,
        threat_north=threat_north,
        threat_east=threat_east,
        threat_detection=_radii(frame.threats, [threat.detection_radius_m for threat in frame.threats], unit_m),
        threat_attack=_radii(frame.threats, [threat.attack_radius_m for threat in frame.threats], unit_m),
        resolution=frame.resolution_cm,
        agent_id_base=agent_base,
        target_id_base=target_base,
        threat_id_base=threat_base,
        revision=whole(frame.revision, UINT8_MAX, "revision"),
        picture_threats=whole(frame.picture_threats, UINT16_MAX, "picture_threats"),
        picture_targets=min(frame.picture_targets, UINT8_MAX),
        directive=_directive_code(frame),
        frame_index=frame_index,
        frame_count=frame_count,
        agent_count=len(frame.agents),
        target_count=len(frame.targets),
        threat_count=len(frame.threats),
        threat_speed_bound=_padded(
            [bound_code(threat.speed_bound_m_s) for threat in frame.threats],
            THREATS_PER_FRAME,
        ),
        threat_id=threat_ids,
        target_id=target_ids,
        agent_id=agent_ids,
        agent_target=agent_target,
        ed25519_signature=_NO_SIGNATURE,
    )


def _assigned(frame: StateFrame) -> list[int]:
    """Return for each agent its target's index in the frame, from 1 on (0: none), and above it its own directive."""
    place = {target.id: index + 1 for index, target in enumerate(frame.targets)}
    assigned = []
    for agent in frame.agents:
        if agent.target_id is not None and agent.target_id not in place:
            raise WireError(f"agent {agent.id} is assigned to target {agent.target_id}, which the frame lacks")
        index = 0 if agent.target_id is None else place[agent.target_id]
        assigned.append(index | agent.directive << _DIRECTIVE_SHIFT)
    return assigned


def _coordinates(
    points: Sequence[tuple[float, float] | None], unit_m: float, length: int
) -> tuple[list[int], list[int]]:
    """Return the north and the east of points in units, each padded to `length`; None is the unknown position."""
    north = [_UNKNOWN_POSITION if point is None else _position_units(point[0], unit_m) for point in points]
    east = [_UNKNOWN_POSITION if point is None else _position_units(point[1], unit_m) for point in points]
    return _padded(north, length), _padded(east, length)


def _position_units(coordinate_m: float, unit_m: float) -> int:
    units = rounded(coordinate_m / unit_m)
    if abs(units) > INT16_MAX:
        raise WireError(
            f"a position {abs(coordinate_m):.3g} m from the origin does not fit a frame in units of {unit_m:g} m"
        )
    return units


def _radii(threats: Sequence[ThreatEntry], radii_m: Sequence[float], unit_m: float) -> list[int]:
    """Return radii of threats in units, enlarged by how far rounding moves their centres and rounded up."""
    units = []
    for threat, radius_m in zip(threats, radii_m, strict=True):
        moved_m = math.hypot(
            threat.north_m - unit_m * rounded(threat.north_m / unit_m),
            threat.east_m - unit_m * rounded(threat.east_m / unit_m),
        )
        units.append(ceiling_units(radius_m + moved_m, unit_m, UINT16_MAX, "radius"))
    return _padded(units, THREATS_PER_FRAME)


def _motion_message(frame: MotionFrame) -> oneway.MAVLink_oneway_motion_message:
    agent_base, agent_ids = _based_ids([agent.id for agent in frame.agents], AGENTS_PER_FRAME, "agents")
    target_base, target_ids = _based_ids([target.id for target in frame.targets], TARGETS_PER_FRAME, "targets")
    threat_base, threat_ids = _based_ids([threat.id for threat in frame.threats], THREATS_PER_FRAME, "threats")

    def velocities(entries: Sequence[PointMotion], length: int) -> tuple[list[int], list[int], list[int]]:
        return (
            _padded([_speed_cm_s(entry.velocity_north_m_s) for entry in entries], length),
            _padded([_speed_cm_s(entry.velocity_east_m_s) for entry in entries], length),
            _padded([_age_ds(entry.age_s, UINT16_MAX) for entry in entries], length),
        )

    target_north, target_east, target_age = velocities(frame.targets, TARGETS_PER_FRAME)
    threat_north, threat_east, threat_age = velocities(frame.threats, THREATS_PER_FRAME)
    frame_index, frame_count = _part(frame.stamp)
    return oneway.MAVLink_oneway_motion_message(
        **_times(frame.stamp),
        agent_heading=_padded([_heading_cdeg(agent.heading_rad) for agent in frame.agents], AGENTS_PER_FRAME),
        agent_speed=_padded(
            [whole(rounded(agent.speed_m_s * 100), UINT16_MAX, "agent_speed") for agent in frame.agents],
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
        agent_age=_padded([_age_ds(agent.age_s, UINT8_MAX) for agent in frame.agents], AGENTS_PER_FRAME),
        threat_id=threat_ids,
        target_id=target_ids,
        agent_id=agent_ids,
        ed25519_signature=_NO_SIGNATURE,
    )


def _bands_message(frame: BandsFrame) -> oneway.MAVLink_oneway_bands_message:
    base, ids = _based_ids([threat.id for threat in frame.threats], BANDS_PER_FRAME, "threats")
    limits = [band_limits(threat.floor_m, threat.ceiling_m, threat.id) for threat in frame.threats]
    frame_index, frame_count = _part(frame.stamp)
    return oneway.MAVLink_oneway_bands_message(
        **_times(frame.stamp),
        threat_floor=_padded([floor for floor, _ in limits], BANDS_PER_FRAME),
        threat_ceiling=_padded([ceiling for _, ceiling in limits], BANDS_PER_FRAME),
        threat_id_base=base,
        frame_index=frame_index,
        frame_count=frame_count,
        threat_count=len(frame.threats),
        threat_id=ids,
        ed25519_signature=_NO_SIGNATURE,
    )


def _detections_message(frame: DetectionsFrame) -> oneway.MAVLink_oneway_detections_message:
    seen = frame.detections
    if len(seen) > DETECTIONS_PER_FRAME:
        raise WireError(f"{len(seen)} detections; a frame holds {DETECTIONS_PER_FRAME}")
    length = DETECTIONS_PER_FRAME
    origin_lat, origin_lon = on_earth_e7(frame.origin_lat_deg, frame.origin_lon_deg)
    return oneway.MAVLink_oneway_detections_message(
        epoch=whole(frame.epoch_s, UINT32_MAX, "epoch"),
        time_ms=whole(frame.time_ms, UINT32_MAX, "time_ms"),
        origin_lat=origin_lat,
        origin_lon=origin_lon,
        north=_padded([_coordinate_cm(item.north_m) for item in seen], length),
        east=_padded([_coordinate_cm(item.east_m) for item in seen], length),
        velocity_north=_padded([_speed_cm_s(item.velocity_north_m_s) for item in seen], length),
        velocity_east=_padded([_speed_cm_s(item.velocity_east_m_s) for item in seen], length),
        id=_padded([whole(item.id, UINT16_MAX, "id") for item in seen], length),
        count=len(seen),
        kind=_padded([int(item.kind) for item in seen], length),
    )


def _report_message(frame: ReportFrame) -> oneway.MAVLink_oneway_report_message:
    lat_e7, lon_e7 = on_earth_e7(frame.lat_deg, frame.lon_deg)
    return oneway.MAVLink_oneway_report_message(
        epoch=whole(frame.epoch_s, UINT32_MAX, "epoch"),
        time_ms=whole(frame.time_ms, UINT32_MAX, "time_ms"),
        lat=lat_e7,
        lon=lon_e7,
        flown=ceiling(frame.flown_m, UINT32_MAX, "flown"),
        velocity_north=_speed_cm_s(frame.velocity_north_m_s),
        velocity_east=_speed_cm_s(frame.velocity_east_m_s),
        agent_id=whole(frame.agent_id, UINT16_MAX, "agent_id"),
    )


def _state_frame(message: Fields) -> StateFrame:
    stamp = _stamp(message)
    origin_lat_deg, origin_lon_deg = degrees_of(message.origin_lat, message.origin_lon, "origin")
    directive, is_last = _directive(message)
    unit_m = message.resolution / 100.0
    if unit_m <= 0:
        raise WireError("resolution is zero")
    agent_ids = _ids(message.agent_id_base, message.agent_id, message.agent_count)
    target_ids = _ids(message.target_id_base, message.target_id, message.target_count)
    threat_ids = _ids(message.threat_id_base, message.threat_id, message.threat_count)
    assigned = [divmod(value, 1 << _DIRECTIVE_SHIFT) for value in message.agent_target[: len(agent_ids)]]
    if any(place > len(target_ids) for _, place in assigned):
        raise WireError("assigned to a target that is not there")
    return StateFrame(
        stamp=stamp,
        origin_lat_deg=origin_lat_deg,
        origin_lon_deg=origin_lon_deg,
        directive=directive,
        revision=message.revision,
        picture_threats=message.picture_threats,
        picture_targets=message.picture_targets,
        resolution_cm=message.resolution,
        agents=tuple(
            AgentEntry(
                identity,
                *_position_m(north, east, unit_m),
                target_ids[place - 1] if place else None,
                directive_of(directive),
            )
            for identity, north, east, (directive, place) in zip(
                agent_ids, message.agent_north, message.agent_east, assigned, strict=False
            )
        ),
        targets=tuple(
            TargetEntry(identity, north * unit_m, east * unit_m)
            for identity, north, east in zip(target_ids, message.target_north, message.target_east, strict=False)
        ),
        threats=tuple(_threat_entry(identity, message, index, unit_m) for index, identity in enumerate(threat_ids)),
        is_last=is_last,
    )


def _position_m(north: int, east: int, unit_m: float) -> tuple[float | None, float | None]:
    unknown = (north == _UNKNOWN_POSITION, east == _UNKNOWN_POSITION)
    if unknown == (True, True):
        return None, None
    if any(unknown):
        raise WireError("half a position")
    return north * unit_m, east * unit_m


def _threat_entry(identity: int, message: Fields, index: int, unit_m: float) -> ThreatEntry:
    detection_units, attack_units = message.threat_detection[index], message.threat_attack[index]
    if not 0 < attack_units <= detection_units:
        raise WireError("radii out of range")
    return ThreatEntry(
        id=identity,
        north_m=message.threat_north[index] * unit_m,
        east_m=message.threat_east[index] * unit_m,
        detection_radius_m=detection_units * unit_m,
        attack_radius_m=attack_units * unit_m,
        speed_bound_m_s=bound_of(message.threat_speed_bound[index]),
    )


def _motion_frame(message: Fields) -> MotionFrame:
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


def _bands_frame(message: Fields) -> BandsFrame:
    ids = _ids(message.threat_id_base, message.threat_id, message.threat_count)
    bands = [band_of(*limits) for limits in zip(message.threat_floor[: len(ids)], message.threat_ceiling, strict=False)]
    return BandsFrame(
        stamp=_stamp(message),
        threats=tuple(
            BandEntry(identity, band.floor_m, band.ceiling_m) for identity, band in zip(ids, bands, strict=True)
        ),
    )


def _detections_frame(message: Fields) -> DetectionsFrame:
    if message.count > DETECTIONS_PER_FRAME:
        raise WireError("count out of range")
    if any(kind > max(Kind) for kind in message.kind[: message.count]):
        raise WireError("unknown kind")
    origin_lat_deg, origin_lon_deg = degrees_of(message.origin_lat, message.origin_lon, "origin")
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


def _report_frame(message: Fields) -> ReportFrame:
    lat_deg, lon_deg = degrees_of(message.lat, message.lon, "position")
    return ReportFrame(
        epoch_s=message.epoch,
        time_ms=message.time_ms,
        agent_id=message.agent_id,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        velocity_north_m_s=message.velocity_north / 100.0,
        velocity_east_m_s=message.velocity_east / 100.0,
        flown_m=float(message.flown),
    )


def _fleet_message(frame: FleetFrame) -> oneway.MAVLink_oneway_fleet_message:
    entries: list[FleetEntry] = [*frame.agents, *frame.targets, *frame.threats]
    data = write_fleet(entries, frame.grid)
    frame_index, frame_count = _part(frame.stamp)
    return oneway.MAVLink_oneway_fleet_message(
        **_times(frame.stamp),
        north_base=frame.grid.north_base,
        east_base=frame.grid.east_base,
        resolution=frame.grid.resolution_cm,
        revision=whole(frame.revision, UINT8_MAX, "revision"),
        directive=_directive_code(frame),
        frame_index=frame_index,
        frame_count=frame_count,
        **_data(data, FLEET_HEAD_BYTES),
    )


def _radii_message(frame: RadiiFrame) -> oneway.MAVLink_oneway_radii_message:
    data = write_radii(frame.threats, frame.resolution_cm)
    frame_index, frame_count = _part(frame.stamp)
    return oneway.MAVLink_oneway_radii_message(
        **_times(frame.stamp),
        resolution=frame.resolution_cm,
        revision=whole(frame.revision, UINT8_MAX, "revision"),
        frame_index=frame_index,
        frame_count=frame_count,
        **_data(data, RADII_HEAD_BYTES),
    )


def _mission_message(frame: MissionFrame) -> oneway.MAVLink_oneway_mission_message:
    origin_lat, origin_lon = on_earth_e7(frame.origin_lat_deg, frame.origin_lon_deg)
    origin_alt = rounded(frame.origin_alt_m * 10)
    if abs(origin_alt) > INT32_MAX:
        raise WireError(f"an origin {frame.origin_alt_m} m above the sea does not fit a frame")
    for digest in (frame.surrogate_digest, frame.mission_digest):
        if len(digest) != DIGEST_BYTES:
            raise WireError(f"a digest of {len(digest)} bytes; allowed: {DIGEST_BYTES}")
    name = frame.name.encode()
    if len(name) > _MISSION_NAME_BYTES:
        raise WireError(f"a name of {len(name)} bytes; a frame holds {_MISSION_NAME_BYTES}")
    return oneway.MAVLink_oneway_mission_message(
        **_times(frame.stamp),
        origin_lat=origin_lat,
        origin_lon=origin_lon,
        origin_alt=origin_alt,
        separation=whole(rounded(frame.separation_m * 10), UINT16_MAX, "separation"),
        arrival_radius=whole(rounded(frame.arrival_radius_m * 10), UINT16_MAX, "arrival_radius"),
        agent_count=whole(frame.agents, UINT16_MAX, "agent_count"),
        target_count=whole(frame.targets, UINT16_MAX, "target_count"),
        threat_count=whole(frame.threats, UINT16_MAX, "threat_count"),
        revision=whole(frame.revision, UINT8_MAX, "revision"),
        surrogate_digest=list(frame.surrogate_digest),
        mission_digest=list(frame.mission_digest),
        **_data(name, MISSION_HEAD_BYTES),
    )


def _decision_message(frame: DecisionFrame) -> oneway.MAVLink_oneway_decision_message:
    return oneway.MAVLink_oneway_decision_message(
        time_usec=whole(frame.time_us, UINT64_MAX, "time_usec"),
        picture_age=_float(frame.picture_age_s),
        wanted_heading=_float(frame.wanted_heading_rad),
        heading=_float(frame.heading_rad),
        speed=_float(frame.speed_m_s),
        altitude=_float(frame.altitude_m),
        certified=_certified(frame.certified_s),
        words_crc=whole(frame.words_crc, UINT32_MAX, "words_crc"),
        target_id=0 if frame.target_id is None else whole(frame.target_id, UINT16_MAX, "target_id"),
        purpose=whole(frame.purpose, UINT8_MAX, "purpose"),
        stage=whole(frame.stage, UINT8_MAX, "stage"),
        flags=int(frame.flags),
    )


def _fleet_frame(message: Fields) -> FleetFrame:
    data = _data_of(message)
    grid = Grid(message.resolution, message.north_base, message.east_base)
    directive, is_last = _directive(message)
    return FleetFrame(_stamp(message), directive, message.revision, grid, *read_fleet(data, grid), is_last)


def _radii_frame(message: Fields) -> RadiiFrame:
    entries = read_radii(_data_of(message), message.resolution)
    return RadiiFrame(_stamp(message), message.revision, message.resolution, entries)


def _mission_frame(message: Fields) -> MissionFrame:
    origin_lat_deg, origin_lon_deg = degrees_of(message.origin_lat, message.origin_lon, "origin")
    try:
        name = _data_of(message).decode()
    except UnicodeDecodeError as error:
        raise WireError("name is not UTF-8") from error
    return MissionFrame(
        stamp=Stamp(message.epoch, message.time_ms, message.sequence),
        revision=message.revision,
        origin_lat_deg=origin_lat_deg,
        origin_lon_deg=origin_lon_deg,
        origin_alt_m=message.origin_alt / 10.0,
        separation_m=message.separation / 10.0,
        arrival_radius_m=message.arrival_radius / 10.0,
        surrogate_digest=bytes(message.surrogate_digest),
        agents=message.agent_count,
        targets=message.target_count,
        threats=message.threat_count,
        name=name,
        mission_digest=bytes(message.mission_digest),
    )


def _decision_frame(message: Fields) -> DecisionFrame:
    numbers = (message.picture_age, message.wanted_heading, message.heading, message.speed, message.altitude)
    if any(math.isinf(number) for number in numbers):
        raise WireError("number out of range")
    if message.flags & ~_ALL_FLAGS:
        raise WireError("unknown flag")
    if not message.certified >= 0.0:
        raise WireError("certified is no time")
    return DecisionFrame(
        time_us=message.time_usec,
        purpose=message.purpose,
        stage=message.stage,
        target_id=message.target_id or None,
        flags=DecisionFlag(message.flags),
        picture_age_s=message.picture_age,
        wanted_heading_rad=message.wanted_heading,
        heading_rad=message.heading,
        speed_m_s=message.speed,
        altitude_m=message.altitude,
        certified_s=message.certified,
        words_crc=message.words_crc,
    )


def _times(stamp: Stamp) -> dict[str, int]:
    return {
        "epoch": whole(stamp.epoch_s, UINT32_MAX, "epoch"),
        "time_ms": whole(stamp.time_ms, UINT32_MAX, "time_ms"),
        "sequence": whole(stamp.sequence, UINT32_MAX, "sequence"),
    }


def _data(data: bytes, head_bytes: int) -> dict[str, object]:
    """Return the fields `size` and `data` of a packed message whose payload has `head_bytes` before its data."""
    return {"size": len(data), "data": list(data.ljust(PAYLOAD_BYTES - head_bytes, b"\0"))}


def _data_of(message: Fields) -> bytes:
    if message.size > len(message.data):
        raise WireError("size out of range")
    return bytes(message.data[: message.size])


def _directive_code(frame: StateFrame | FleetFrame) -> int:
    """Return the field with the directive for all agents and whether the broadcast is the last."""
    return frame.directive | (_LAST if frame.is_last else 0)


def _directive(message: Fields) -> tuple[Directive, bool]:
    """Return the directive for all agents, and whether the broadcast is the last."""
    return directive_of(message.directive & ~_LAST), message.directive & _LAST != 0


def _float(value: float) -> float:
    """Return the value rounded to a 32-bit float; nan stays nan."""
    try:
        held: float = _FLOAT.unpack(_FLOAT.pack(value))[0]
    except OverflowError:
        held = math.inf
    if math.isinf(held):
        raise WireError(f"{value} does not fit its field; allowed: a 32-bit float")
    return held


def _certified(value: float) -> float:
    """Return a time of certificate rounded to a 32-bit float; infinite stays infinite."""
    if not value >= 0.0:
        raise WireError(f"certified {value}; allowed: a time from 0 on, or infinity")
    return value if math.isinf(value) else _float(value)


_FLOAT = struct.Struct("<f")
_ALL_FLAGS = int(~DecisionFlag(0))
_ENCODERS: dict[type[Frame], Callable[[Any], oneway.MAVLink_message]] = {
    StateFrame: _state_message,
    MotionFrame: _motion_message,
    BandsFrame: _bands_message,
    DetectionsFrame: _detections_message,
    ReportFrame: _report_message,
    FleetFrame: _fleet_message,
    RadiiFrame: _radii_message,
    MissionFrame: _mission_message,
    DecisionFrame: _decision_message,
}
_DECODERS: dict[int, Callable[[Fields], Frame]] = {
    oneway.MAVLINK_MSG_ID_ONEWAY_STATE: _state_frame,
    oneway.MAVLINK_MSG_ID_ONEWAY_MOTION: _motion_frame,
    oneway.MAVLINK_MSG_ID_ONEWAY_BANDS: _bands_frame,
    oneway.MAVLINK_MSG_ID_ONEWAY_DETECTIONS: _detections_frame,
    oneway.MAVLINK_MSG_ID_ONEWAY_REPORT: _report_frame,
    oneway.MAVLINK_MSG_ID_ONEWAY_FLEET: _fleet_frame,
    oneway.MAVLINK_MSG_ID_ONEWAY_RADII: _radii_frame,
    oneway.MAVLINK_MSG_ID_ONEWAY_MISSION: _mission_frame,
    oneway.MAVLINK_MSG_ID_ONEWAY_DECISION: _decision_frame,
}


def frame_resolution_cm(points: Sequence[tuple[float, float]], radii_m: Sequence[float]) -> int:
    """Return the finest resolution of state frames, in whole cm, at which positions (north, east) and radii in m fit.

    Raises:
        WireError: a position or radius is too great, or not finite.

    """
    reach_m = max((max(abs(north_m), abs(east_m)) for north_m, east_m in points), default=0.0)
    radius_m = max(radii_m, default=0.0)
    if not (math.isfinite(reach_m) and math.isfinite(radius_m)):
        raise WireError("a position or radius is not finite")
    # A radius gains up to sqrt(1/2) of a unit for the rounding of its centre and up to one for its own.
    needed_cm = max(100 * reach_m / INT16_MAX, 100 * radius_m / (UINT16_MAX - 2))
    if needed_cm > UINT16_MAX:
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
    whole(max(ids), UINT16_MAX, f"{what} id")
    return whole(base, UINT16_MAX, f"{what} id"), _padded([identity - base for identity in ids], length)


def _ids(base: int, offsets: Sequence[int], count: int) -> list[int]:
    if count > len(offsets):
        raise WireError("count out of range")
    ids = [base + offset for offset in offsets[:count]]
    if len(set(ids)) != count or any(identity > UINT16_MAX for identity in ids):
        raise WireError("ids out of range")
    return ids


def _stamp(message: Fields) -> Stamp:
    if message.frame_index >= message.frame_count:
        raise WireError("frame index out of range")
    return Stamp(message.epoch, message.time_ms, message.sequence, message.frame_index, message.frame_count)


def _padded(values: list[int], length: int) -> list[int]:
    return values + [0] * (length - len(values))


def _coordinate_cm(coordinate_m: float) -> int:
    value_cm = rounded(coordinate_m * 100)
    if abs(value_cm) > INT32_MAX:
        raise WireError(f"a position {coordinate_m:.0f} m from the origin does not fit a frame")
    return value_cm


def _part(stamp: Stamp) -> tuple[int, int]:
    """Return a stamp's frame index and frame count, each checked against its 8-bit field."""
    count = whole(stamp.frame_count, UINT8_MAX, "frame_count")
    return whole(stamp.frame_index, count - 1, "frame_index"), count


def _speed_cm_s(speed_m_s: float) -> int:
    return max(-INT16_MAX, min(INT16_MAX, rounded(speed_m_s * 100)))


def _age_ds(age_s: float, greatest: int) -> int:
    if not age_s >= 0:
        raise WireError(f"an age of {age_s} s does not fit its field; allowed: 0 or more")
    return math.ceil(min(round(age_s * 10, 6), greatest))


def _heading_cdeg(heading_rad: float | None) -> int:
    return _UNKNOWN_HEADING if heading_rad is None else rounded(math.degrees(heading_rad) * 100) % 36_000


def _heading_rad(value_cdeg: int) -> float | None:
    if value_cdeg == _UNKNOWN_HEADING:
        return None
    if value_cdeg >= 36_000:
        raise WireError("heading out of range")
    return math.radians(value_cdeg / 100.0)
