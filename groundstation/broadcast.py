"""Cuts the picture into frames that are each useful alone.

A state frame holds up to 10 agents with the (up to 5) targets they go to and the 4 threats nearest to them; whatever
did not fit anywhere travels in frames of its own, so that a whole broadcast holds everything. The paper's mission fits
one frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

from companion.mission import Mission, ThreatSpec
from companion.wire import (
    AGENTS_PER_FRAME,
    BANDS_PER_FRAME,
    ID_SPAN,
    TARGETS_PER_FRAME,
    THREATS_PER_FRAME,
    AgentEntry,
    AgentMotion,
    BandEntry,
    BandsFrame,
    Directive,
    Kind,
    MotionFrame,
    PointMotion,
    Stamp,
    StateFrame,
    TargetEntry,
    ThreatEntry,
)
from groundstation.picture import GroundPicture, Track

EntryT = TypeVar("EntryT", AgentEntry, TargetEntry, ThreatEntry, AgentMotion, PointMotion, BandEntry)
_UNTOLD: tuple[float | None, float | None] = (None, None)
MOVING_M_S = 0.1
"""Below this speed a heading means nothing."""


def state_frames(
    picture: GroundPicture,
    mission: Mission,
    assignment: dict[int, int],  # agent id -> target id
    directive: Directive,
    stamp: Stamp,
) -> list[StateFrame]:
    """Return the state frames of one broadcast; `stamp` gives epoch, time and sequence.

    In Case II the agents' places only decide which threats travel with whom: what is reckoned is not broadcast. An
    agent that has arrived by reckoning keeps its target: only it knows whether it is there.
    """
    now_s = stamp.unix_s
    if mission.case == "II":
        assignment = {**picture.reached_by, **assignment}
    here = {identity: _here(picture.tracks[Kind.AGENT, identity], now_s) for identity in picture.present_agents}
    targets = {
        identity: TargetEntry(identity, *picture.tracks[Kind.TARGET, identity].position_ned_m)
        for identity in [*picture.open_targets, *sorted(picture.completed & set(assignment.values()))]
    }
    agents = [
        AgentEntry(identity, *(place if mission.case == "I" else _UNTOLD), target_id=assignment.get(identity))
        for identity, place in here.items()
    ]
    threats = [grown(threat, picture.tracks[Kind.THREAT, threat.id], now_s) for threat in mission.threats]
    contents = []
    for group in _agent_groups(agents):
        wanted = sorted({agent.target_id for agent in group if agent.target_id is not None})
        contents.append(
            (
                group,
                [targets[identity] for identity in wanted],
                _nearest_threats([here[agent.id] for agent in group], threats),
            )
        )
    sent_targets = {target.id for _, chosen, _ in contents for target in chosen}
    sent_threats = {threat.id for _, _, chosen in contents for threat in chosen}
    rest_targets = _chunks([t for t in targets.values() if t.id not in sent_targets], TARGETS_PER_FRAME)
    rest_threats = _chunks([t for t in threats if t.id not in sent_threats], THREATS_PER_FRAME)
    for content in contents:
        # What is left over first fills frames that have room for all of a chunk.
        if rest_targets and _fits(content[1], rest_targets[0], TARGETS_PER_FRAME):
            content[1].extend(rest_targets.pop(0))
    for index in range(max(len(rest_targets), len(rest_threats))):
        contents.append(([], _at(rest_targets, index), _at(rest_threats, index)))
    contents = contents or [([], [], [])]
    return [
        StateFrame(
            stamp=replace(stamp, frame_index=index, frame_count=len(contents)),
            origin_lat_deg=mission.origin.lat_deg,
            origin_lon_deg=mission.origin.lon_deg,
            directive=directive,
            agents=tuple(group),
            targets=tuple(chosen_targets),
            threats=tuple(chosen_threats),
        )
        for index, (group, chosen_targets, chosen_threats) in enumerate(contents)
    ]


def motion_frames(picture: GroundPicture, mission: Mission, stamp: Stamp) -> list[MotionFrame]:
    """Return the motion frames that go with the last state broadcast."""
    now_s = stamp.unix_s
    moving = picture.present_agents if mission.case == "I" else []
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
    """Return the frames that go with a state broadcast and tell which heights threats reach, none if all reach all."""
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


def _here(track: Track, now_s: float) -> tuple[float, float]:
    """Return where an agent must be by now, its track extrapolated: the vehicles themselves never say."""
    age_s = track.age_s(now_s)
    return track.north_m + track.velocity_north_m_s * age_s, track.east_m + track.velocity_east_m_s * age_s


def grown(threat: ThreatSpec, track: Track, now_s: float) -> ThreatEntry:
    """Return a threat where it was seen, its discs grown by what it may have moved since."""
    growth_m = threat.speed_bound_m_s * track.age_s(now_s)
    return ThreatEntry(
        id=threat.id,
        north_m=track.north_m,
        east_m=track.east_m,
        detection_radius_m=threat.detection_radius_m + growth_m,
        attack_radius_m=threat.attack_radius_m + growth_m,
        speed_bound_m_s=threat.speed_bound_m_s,
    )


def _agent_groups(agents: Sequence[AgentEntry]) -> Iterator[list[AgentEntry]]:
    """Yield the agents in groups that fit a frame with their targets; ids rise, so that a frame's span is small."""
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
    """Return up to four threats with the least clearance to any agent of the group, as far as their ids fit."""

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
