"""Divides the tracks and the assignment into frames, each of which is useful alone.

A state frame holds up to 10 agents with the (up to 5) targets assigned to them and the 4 threats nearest to them;
entries that fit none of these are sent in further frames, so that a whole broadcast holds everything. The paper's
mission fits one frame. A larger mission is sent packed: positions and assignments in fleet frames, constant values in
radii and mission frames beside them.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from importlib import resources
from types import MappingProxyType
from typing import NamedTuple, TypeVar

from companion.files.weights import content_digest
from companion.mission.extent import WHOLE_PLANE_M, Point
from companion.mission.model import Mission, ThreatSpec
from companion.protocol.codec import (
    AGENTS_PER_FRAME,
    BANDS_PER_FRAME,
    DIGEST_BYTES,
    ID_SPAN,
    TARGETS_PER_FRAME,
    THREATS_PER_FRAME,
    AgentEntry,
    AgentMotion,
    BandEntry,
    BandsFrame,
    Directive,
    FleetFrame,
    Kind,
    MissionFrame,
    MotionFrame,
    PointMotion,
    RadiiEntry,
    RadiiFrame,
    Stamp,
    StateFrame,
    TargetEntry,
    ThreatEntry,
    ThreatPlace,
    WireError,
)
from companion.protocol.fleet_codec import GREATEST_AGE_S, Entry, FleetEntry, Layout
from groundstation.revision import Revision
from groundstation.track import Track
from groundstation.tracks import TrackTable

EntryT = TypeVar("EntryT", AgentEntry, TargetEntry, ThreatEntry, AgentMotion, PointMotion, BandEntry)
PackedT = TypeVar("PackedT", bound=Entry)
MOST_FRAMES = 255
"""Greatest number of frames of one broadcast: they are numbered with 8 bits."""
MOVING_M_S = 0.1
"""Speed below which a heading means nothing."""
NOWHERE = (None, None)
"""Place of an agent whose position is not told."""


class Broadcast(NamedTuple):
    """Values that all frames of one broadcast of the state have in common."""

    stamp: Stamp
    """Epoch, time and sequence."""
    directive: Directive
    revision: Revision
    """Revision of the picture that is told, with its grid."""
    directives: Mapping[int, Directive] = MappingProxyType({})
    """The directives for single agents, by id of the agent; those that have none are left out."""
    is_last: bool = False
    """Whether the ground station stops after this broadcast."""


@dataclass
class Unsendable:
    """Count of the frames that could not be encoded, whose content was therefore not sent."""

    count: int = 0
    first: str = ""
    """Reason of the first failure."""

    def add(self, error: WireError) -> None:
        """Count one frame that could not be encoded."""
        self.count += 1
        self.first = self.first or str(error)


def state_frames(
    picture: TrackTable,
    mission: Mission,
    assignment: Mapping[int, int],  # agent id -> target id
    broadcast: Broadcast,
) -> list[StateFrame]:
    """Return the state frames of one broadcast.

    An agent off the grid has no position in them. In Case II the agents' positions only decide which threats are sent
    with which agents: dead-reckoned positions are not broadcast. An agent that has arrived by dead reckoning keeps its
    target, as only the agent itself knows whether it is there.
    """
    stamp, revision = broadcast.stamp, broadcast.revision
    now_s = stamp.unix_s - picture.clock_ahead_s
    here = _places(picture, mission, broadcast)
    agents, targets = _agents_and_targets(picture, mission, assignment, broadcast, here)
    threats = [grown(threat, picture.tracks[Kind.THREAT, threat.id], now_s) for threat in mission.threats]
    contents = _state_contents(agents, targets, threats, here)
    return [
        StateFrame(
            stamp=replace(stamp, frame_index=index, frame_count=len(contents)),
            origin_lat_deg=mission.origin.lat_deg,
            origin_lon_deg=mission.origin.lon_deg,
            directive=broadcast.directive,
            is_last=broadcast.is_last,
            revision=revision.number,
            picture_threats=len(threats),
            picture_targets=len(targets),
            resolution_cm=revision.state_cm,
            agents=tuple(content.agents),
            targets=tuple(content.targets),
            threats=tuple(content.threats),
        )
        for index, content in enumerate(contents)
    ]


@dataclass
class _StateContent:
    """Entries of one state frame."""

    agents: list[AgentEntry] = field(default_factory=list)
    targets: list[TargetEntry] = field(default_factory=list)
    threats: list[ThreatEntry] = field(default_factory=list)


def _state_contents(
    agents: Sequence[AgentEntry],
    targets: Mapping[int, TargetEntry],  # by id
    threats: Sequence[ThreatEntry],
    here: Mapping[int, tuple[float, float]],  # agent id -> m
) -> list[_StateContent]:
    """Return the entries of each state frame of a broadcast, which together are all entries; at least one frame."""
    contents = []
    for group in _agent_groups(agents):
        wanted = sorted({agent.target_id for agent in group if agent.target_id is not None})
        nearest = _nearest_threats([here[agent.id] for agent in group], threats)
        contents.append(_StateContent(group, [targets[identity] for identity in wanted], nearest))
    sent_targets = {target.id for content in contents for target in content.targets}
    sent_threats = {threat.id for content in contents for threat in content.threats}
    rest_targets = _chunks([t for t in targets.values() if t.id not in sent_targets], TARGETS_PER_FRAME)
    rest_threats = _chunks([t for t in threats if t.id not in sent_threats], THREATS_PER_FRAME)
    for content in contents:
        # Targets that are left over first fill frames that have room for a whole chunk.
        if rest_targets and _fits(content.targets, rest_targets[0], TARGETS_PER_FRAME):
            content.targets.extend(rest_targets.pop(0))
    for index in range(max(len(rest_targets), len(rest_threats))):
        contents.append(_StateContent([], _at(rest_targets, index), _at(rest_threats, index)))
    return contents or [_StateContent()]


def fits_one_frame(mission: Mission) -> bool:
    """Return whether one state frame holds everything that a mission has."""
    return all(
        len(things) <= most and _span(thing.id for thing in things) < ID_SPAN
        for things, most in (
            (mission.agents, AGENTS_PER_FRAME),
            (mission.targets, TARGETS_PER_FRAME),
            (mission.threats, THREATS_PER_FRAME),
        )
    )


def frames_for(mission: Mission) -> int:
    """Return about how many state frames a mission takes: one for every five agents, which may have as many targets."""
    targets = len(_chunks([TargetEntry(one.id, 0.0, 0.0) for one in mission.targets], TARGETS_PER_FRAME))
    radii_m = 1.0, 0.5, 0.0
    threats = len(_chunks([ThreatEntry(one.id, 0.0, 0.0, *radii_m) for one in mission.threats], THREATS_PER_FRAME))
    return math.ceil(len(mission.agents) / TARGETS_PER_FRAME) + max(targets, threats)


def motion_frames(picture: TrackTable, mission: Mission, stamp: Stamp) -> list[MotionFrame]:
    """Return the motion frames that go with the last state broadcast."""
    now_s = stamp.unix_s - picture.clock_ahead_s
    moving = picture.told_agents(now_s)
    agents = [_agent_motion(identity, picture.tracks[Kind.AGENT, identity], now_s) for identity in moving]
    targets = [_point_motion(i, picture.tracks[Kind.TARGET, i], now_s) for i in picture.open_targets]
    threats = [_point_motion(t.id, picture.tracks[Kind.THREAT, t.id], now_s) for t in mission.threats]
    agent_chunks = _chunks(agents, AGENTS_PER_FRAME)
    target_chunks = _chunks(targets, TARGETS_PER_FRAME)
    threat_chunks = _chunks(threats, THREATS_PER_FRAME)
    count = max(len(agent_chunks), len(target_chunks), len(threat_chunks))
    return [
        MotionFrame(
            stamp=replace(stamp, frame_index=index, frame_count=count),
            agents=tuple(_at(agent_chunks, index)),
            targets=tuple(_at(target_chunks, index)),
            threats=tuple(_at(threat_chunks, index)),
        )
        for index in range(count)
    ]


def band_frames(mission: Mission, stamp: Stamp) -> list[BandsFrame]:
    """Return the frames with the altitude limits of threats, sent with a state broadcast; none if no threat has any."""
    entries = [
        BandEntry(threat.id, threat.floor_m, threat.ceiling_m)
        for threat in mission.threats
        if threat.floor_m is not None or threat.ceiling_m is not None
    ]
    chunks = _chunks(entries, BANDS_PER_FRAME)
    return [
        BandsFrame(replace(stamp, frame_index=index, frame_count=len(chunks)), tuple(chunk))
        for index, chunk in enumerate(chunks)
    ]


def fleet_frames(
    picture: TrackTable,
    mission: Mission,
    assignment: Mapping[int, int],  # agent id -> target id
    broadcast: Broadcast,
    data_bytes: int,
) -> list[FleetFrame]:
    """Return the fleet frames of one broadcast, each with at most `data_bytes` of data (fleet_codec.data_bytes).

    Agents in Case II and those off the grid have no positions in them, as in state frames.

    Raises:
        WireError: a frame has no room for one entry, or there would be too many frames.

    """
    stamp, revision = broadcast.stamp, broadcast.revision
    now_s = stamp.unix_s - picture.clock_ahead_s
    here = _places(picture, mission, broadcast)
    agents, targets = _agents_and_targets(picture, mission, assignment, broadcast, here)
    entries: list[FleetEntry] = [*_by_id(agents), *_by_id(targets.values())]
    entries += _by_id(
        _threat_place(threat, picture.tracks[Kind.THREAT, threat.id], now_s) for threat in mission.threats
    )
    contents = _filled(entries, data_bytes)
    return [
        FleetFrame(
            stamp=replace(stamp, frame_index=index, frame_count=len(contents)),
            directive=broadcast.directive,
            is_last=broadcast.is_last,
            revision=revision.number,
            grid=revision.grid,
            agents=tuple(_by_id(entry for entry in content if isinstance(entry, AgentEntry))),
            targets=tuple(_by_id(entry for entry in content if isinstance(entry, TargetEntry))),
            threats=tuple(_by_id(entry for entry in content if isinstance(entry, ThreatPlace))),
        )
        for index, content in enumerate(contents)
    ]


def radii_frames(
    mission: Mission,
    revision: Revision,
    stamp: Stamp,
    data_bytes: int,
    growth_m: Mapping[int, float] | None = None,  # threat id -> m, 0 where it is not there
) -> list[RadiiFrame]:
    """Return the frames with the radii of all threats, none if there are no threats.

    `growth_m` is the result of `untold_growth_m`, added to the radii.

    Raises:
        WireError: a frame has no room for one entry.

    """
    growths_m = growth_m or {}
    entries = [
        RadiiEntry(
            id=threat.id,
            detection_radius_m=min(threat.detection_radius_m + growths_m.get(threat.id, 0.0), WHOLE_PLANE_M),
            attack_radius_m=min(threat.attack_radius_m + growths_m.get(threat.id, 0.0), WHOLE_PLANE_M),
            speed_bound_m_s=threat.speed_bound_m_s,
            floor_m=threat.floor_m,
            ceiling_m=threat.ceiling_m,
        )
        for threat in mission.threats
    ]
    contents = _filled(_by_id(entries), data_bytes) if entries else []
    return [
        RadiiFrame(
            replace(stamp, frame_index=index, frame_count=len(contents)),
            revision.number,
            revision.radii_cm,
            tuple(content),
        )
        for index, content in enumerate(contents)
    ]


def mission_frame(
    mission: Mission, revision: Revision, surrogate_digest: bytes, stamp: Stamp, data_bytes: int
) -> MissionFrame:
    """Return the frame with the values that hold for the whole revision; the name is cut to `data_bytes` of UTF-8.

    `surrogate_digest` is the first 8 bytes of the SHA-256 of the weights, all zero if there are none.
    """
    return MissionFrame(
        stamp=stamp,
        revision=revision.number,
        origin_lat_deg=mission.origin.lat_deg,
        origin_lon_deg=mission.origin.lon_deg,
        origin_alt_m=mission.origin.alt_m,
        separation_m=mission.separation_m,
        arrival_radius_m=mission.arrival_radius_m,
        surrogate_digest=surrogate_digest,
        agents=len(mission.agents),
        targets=len(mission.targets),
        threats=len(mission.threats),
        name=mission.name.encode()[:data_bytes].decode(errors="ignore"),
        mission_digest=mission_digest(mission, revision.moved),
    )


def mission_digest(mission: Mission, moved: Mapping[int, Point] | None = None) -> bytes:
    """Return 8 bytes that differ between missions with different origins, targets or threats, as from other seeds.

    `moved`: by id the places of the threats that should stand but do not stand where the mission says (Revision.moved).
    """
    told = mission.model_dump(mode="json", include={"origin", "targets", "threats"})
    if moved:
        told["moved"] = dict(moved)
    return sha256(json.dumps(told, sort_keys=True).encode()).digest()[:DIGEST_BYTES]


def surrogate_digest(mission: Mission) -> bytes:
    """Return the first 8 bytes of the SHA-256 of the weights of a mission's surrogate, all zero if it has none."""
    if mission.surrogate == "analytic":
        return bytes(DIGEST_BYTES)
    return _weights_digest(mission.surrogate)


@functools.cache
def _weights_digest(surrogate: str) -> bytes:
    weights = resources.files("companion.surrogate").joinpath("weights", f"{surrogate}.json")
    return bytes.fromhex(content_digest(json.loads(weights.read_text(encoding="utf-8"))))[:DIGEST_BYTES]


def grown(threat: ThreatSpec, track: Track, now_s: float) -> ThreatEntry:
    """Return a threat at its last seen position, its radii grown by the distance that it may have moved since."""
    growth_m = threat.speed_bound_m_s * track.age_s(now_s)
    return ThreatEntry(
        id=threat.id,
        north_m=track.north_m,
        east_m=track.east_m,
        detection_radius_m=min(threat.detection_radius_m + growth_m, WHOLE_PLANE_M),
        attack_radius_m=min(threat.attack_radius_m + growth_m, WHOLE_PLANE_M),
        speed_bound_m_s=threat.speed_bound_m_s,
    )


def untold_growth_m(picture: TrackTable, threats: Sequence[ThreatSpec], until_s: float) -> dict[int, float]:
    """Return by threat id the growth of its radii until `until_s` from age beyond GREATEST_AGE_S, m.

    A fleet frame cannot hold a greater age than that, 58 days; the result is empty while no track is older.
    """
    ages_s = {threat.id: picture.tracks[Kind.THREAT, threat.id].age_s(until_s) for threat in threats}
    return {
        threat.id: threat.speed_bound_m_s * (ages_s[threat.id] - GREATEST_AGE_S)
        for threat in threats
        if ages_s[threat.id] > GREATEST_AGE_S
    }


def _places(picture: TrackTable, mission: Mission, broadcast: Broadcast) -> dict[int, Point]:
    """Return by id where the agents are that a broadcast names: those present, and the lost ones that have a directive.

    A vehicle may be lost to the ground station only, and obeys its own directive for as long as it is named with it.
    """
    now_s = broadcast.stamp.unix_s - picture.clock_ahead_s
    lost = picture.progress.lost - broadcast.directives.keys()
    named = [agent.id for agent in mission.agents if agent.id not in lost]
    return {identity: picture.tracks[Kind.AGENT, identity].place_at(now_s) for identity in named}


def _agents_and_targets(
    picture: TrackTable,
    mission: Mission,
    assignment: Mapping[int, int],  # agent id -> target id
    broadcast: Broadcast,
    here: Mapping[int, Point],  # agent id -> m, of the agents that are named
) -> tuple[list[AgentEntry], dict[int, TargetEntry]]:
    """Return the agents as they are broadcast, and by id the targets that are open or still assigned to an agent.

    An agent has no position in it whose position is not told, or is off the grid.
    """
    if mission.case == "II":
        assignment = {**picture.progress.reached_by, **assignment}
    targets = {
        identity: TargetEntry(identity, *picture.tracks[Kind.TARGET, identity].position_ned_m)
        for identity in [*picture.open_targets, *sorted(picture.progress.completed & set(assignment.values()))]
    }
    now_s = broadcast.stamp.unix_s - picture.clock_ahead_s
    told = {one for one in picture.told_agents(now_s) if broadcast.revision.extent.holds(here[one])}
    agents = []
    for identity, place in here.items():
        north_m, east_m = place if identity in told else NOWHERE
        directive = broadcast.directives.get(identity, Directive.NORMAL)
        agents.append(AgentEntry(identity, north_m, east_m, assignment.get(identity), directive))
    return agents, targets


def _threat_place(threat: ThreatSpec, track: Track, now_s: float) -> ThreatPlace:
    # An age beyond the greatest one enlarges the radii instead (`untold_growth_m`).
    return ThreatPlace(threat.id, track.north_m, track.east_m, min(track.age_s(now_s), GREATEST_AGE_S))


def _filled(entries: Iterable[PackedT], data_bytes: int) -> list[list[PackedT]]:
    """Return the entries of each frame, filled one after the other in the order given; at least one frame."""
    contents: list[list[PackedT]] = [[]]
    layout = Layout[PackedT]()
    for entry in entries:
        if contents[-1] and layout.size + layout.cost(entry) > data_bytes:
            contents.append([])
            layout = Layout[PackedT]()
        layout.add(entry)
        contents[-1].append(entry)
        if layout.size > data_bytes:
            raise WireError(f"{data_bytes} bytes of data; allowed: at least {layout.size}, for one entry")
    return contents


def _by_id(entries: Iterable[PackedT]) -> list[PackedT]:
    return sorted(entries, key=lambda entry: entry.id)


def _agent_groups(agents: Sequence[AgentEntry]) -> Iterator[list[AgentEntry]]:
    """Yield groups of agents that fit a frame with their targets; ids rise, so that the span in a frame is small."""
    group: list[AgentEntry] = []
    for agent in sorted(agents, key=lambda agent: agent.id):
        together = {other.target_id for other in (*group, agent)} - {None}
        if group and (
            len(group) == AGENTS_PER_FRAME
            or len(together) > TARGETS_PER_FRAME
            or agent.id - group[0].id >= ID_SPAN
            or _span(together) >= ID_SPAN
        ):
            yield group
            group = []
        group.append(agent)
    if group:
        yield group


def _nearest_threats(group_ned_m: Sequence[tuple[float, float]], threats: Sequence[ThreatEntry]) -> list[ThreatEntry]:
    """Return the threats of a frame: those with the least clearance to any agent of the group whose ids fit."""

    def clearance_m(threat: ThreatEntry) -> float:
        return min(
            math.dist(point, (threat.north_m, threat.east_m)) - threat.detection_radius_m for point in group_ned_m
        )

    chosen: list[ThreatEntry] = []
    for threat in sorted(threats, key=clearance_m):
        if _fits(chosen, [threat], THREATS_PER_FRAME):
            chosen.append(threat)
    return sorted(chosen, key=lambda threat: threat.id)


def _agent_motion(identity: int, track: Track, now_s: float) -> AgentMotion:
    speed_m_s = math.hypot(track.velocity_north_m_s, track.velocity_east_m_s)
    heading_rad = math.atan2(track.velocity_east_m_s, track.velocity_north_m_s) if speed_m_s >= MOVING_M_S else None
    return AgentMotion(identity, heading_rad, speed_m_s, track.age_s(now_s))


def _point_motion(identity: int, track: Track, now_s: float) -> PointMotion:
    return PointMotion(identity, track.velocity_north_m_s, track.velocity_east_m_s, track.age_s(now_s))


def _chunks(entries: Iterable[EntryT], length: int) -> list[list[EntryT]]:
    """Return the entries by rising id, cut so that each chunk fits a frame."""
    chunks: list[list[EntryT]] = []
    for entry in sorted(entries, key=lambda entry: entry.id):
        if not chunks or not _fits(chunks[-1], [entry], length):
            chunks.append([])
        chunks[-1].append(entry)
    return chunks


def _fits(present: Sequence[EntryT], more: Sequence[EntryT], length: int) -> bool:
    ids = {entry.id for entry in (*present, *more)}
    return len(present) + len(more) <= length and _span(ids) < ID_SPAN


def _span(ids: Iterable[int | None]) -> int:
    known = [identity for identity in ids if identity is not None]
    return max(known) - min(known) if known else 0


def _at(chunks: Sequence[list[EntryT]], index: int) -> list[EntryT]:
    return chunks[index] if index < len(chunks) else []
