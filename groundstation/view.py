"""What a page shows of a run: plain values that JSON can hold, made from the ground station and its surroundings.

A picture is everything, for whoever begins to look; moves are the places alone, several times a second. Lengths are
rounded to centimetres and angles to tenths of a degree, so that what is the same is the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from companion.mission.model import AgentSpec, TargetSpec, ThreatSpec
from companion.protocol.codec import Kind
from groundstation.broadcast import MOVING_M_S
from groundstation.ground_station import GroundStation
from groundstation.operations import directive_name
from groundstation.track import Track

View = dict[str, Any]
"""Values that JSON can hold."""
Mode = Literal["live", "sim", "playback"]


@dataclass(frozen=True)
class Surroundings:
    """What a page shows beside the ground station's own picture."""

    mode: Mode = "live"
    broadcast: Mapping[str, Any] = field(default_factory=dict)
    """Rate, budget, items and authentication of the broadcast."""
    sources: Sequence[Mapping[str, Any]] = ()
    warnings: Sequence[str] = ()


def picture(station: GroundStation, now_s: float, around: Surroundings) -> View:
    """Return everything that a page shows at `now_s`, times of the ground station's clock."""
    mission, operations = station.mission, station.operations
    origin = mission.origin
    return {
        "type": "picture",
        "t_s": round(now_s + station.tracks.clock_ahead_s, 3),
        "mode": around.mode,
        "mission": mission.name,
        "case": mission.case,
        "paused": operations.orders.paused,
        "directive": directive_name(station.directive),
        "epoch_s": station.epoch_s,
        "revision": station.revision,
        "event": operations.next_number - 1,
        "undoable": [undone.number for undone in operations.undos],
        "origin": {"lat_deg": origin.lat_deg, "lon_deg": origin.lon_deg, "alt_m": origin.alt_m},
        "fence": None if mission.fence is None else [list(corner) for corner in mission.fence],
        "exclusions": [[list(corner) for corner in polygon] for polygon in mission.exclusions],
        "arrival_radius_m": mission.arrival_radius_m,
        "separation_m": mission.separation_m,
        "agents": [_agent(station, agent, now_s) for agent in mission.agents],
        "targets": [_target(station, target, now_s) for target in mission.targets],
        "threats": [_threat(station, threat, now_s) for threat in mission.threats],
        "unknown": [],
        "broadcast": dict(around.broadcast),
        "sources": [dict(source) for source in around.sources],
        "warnings": list(around.warnings),
    }


def moves(station: GroundStation, now_s: float) -> View:
    """Return the places of everything at `now_s`: [id, north, east, ...] in m, degrees, m/s and s."""
    tracks, mission = station.tracks.tracks, station.mission
    agents = []
    for agent in mission.agents:
        track = tracks[Kind.AGENT, agent.id]
        agents.append([agent.id, *_place(track), _heading_deg(track, agent), _speed_m_s(track), _age_s(track, now_s)])
    return {
        "type": "moves",
        "t_s": round(now_s + station.tracks.clock_ahead_s, 3),
        "agents": agents,
        "targets": [_point(target.id, tracks[Kind.TARGET, target.id], now_s) for target in mission.targets],
        "threats": [
            [*_point(threat.id, tracks[Kind.THREAT, threat.id], now_s), _growth_m(station, threat, now_s)]
            for threat in mission.threats
        ],
    }


def _agent(station: GroundStation, agent: AgentSpec, now_s: float) -> View:
    track = station.tracks.tracks[Kind.AGENT, agent.id]
    target_id = station.assignment.get(agent.id)
    north_m, east_m = _place(track)
    orders = station.operations.orders
    return {
        "id": agent.id,
        "north_m": north_m,
        "east_m": east_m,
        "heading_deg": _heading_deg(track, agent),
        "speed_m_s": _speed_m_s(track),
        "age_s": _age_s(track, now_s),
        "source": "reckoned" if station.mission.case == "II" else "sensor",
        "ellipse": None,
        "state": _state(station, agent.id),
        "target": target_id,
        "pinned": orders.pins.get(agent.id),
        "directive": directive_name(orders.of(agent.id)),
        "range_left_m": round(max(0.0, agent.range_m - station.tracks.flown_m[agent.id]), 1),
        "eta_s": _eta_s(station, agent, track, target_id),
        "link": None,
        "certificate": None,
    }


def _state(station: GroundStation, agent_id: int) -> str:
    progress = station.tracks.progress
    if agent_id in progress.lost:
        return "lost"
    if agent_id in progress.out:
        return "out"
    if agent_id in progress.arrived:
        return "arrived"
    return "under way" if agent_id in station.assignment else "no target"


def _eta_s(station: GroundStation, agent: AgentSpec, track: Track, target_id: int | None) -> float | None:
    """Return the time to the target by the straight line at the agent's speed; None without a target."""
    if target_id is None:
        return None
    target = station.tracks.tracks[Kind.TARGET, target_id]
    away_m = math.dist(track.position_ned_m, target.position_ned_m) - station.mission.arrival_radius_m
    return round(max(0.0, away_m) / agent.speed_m_s, 1)


def _target(station: GroundStation, target: TargetSpec, now_s: float) -> View:
    track = station.tracks.tracks[Kind.TARGET, target.id]
    name = station.operations.names.get((Kind.TARGET, target.id))
    return {
        **_moving(target.id, name, track, now_s),
        "speed_bound_m_s": target.speed_bound_m_s,
        "reached_by": list(station.operations.reached.by.get(target.id, ())),
        "agents": [agent for agent, sent_to in station.assignment.items() if sent_to == target.id],
        "source": "mission",
    }


def _threat(station: GroundStation, threat: ThreatSpec, now_s: float) -> View:
    track = station.tracks.tracks[Kind.THREAT, threat.id]
    name = station.operations.names.get((Kind.THREAT, threat.id))
    return {
        **_moving(threat.id, name, track, now_s),
        "detection_radius_m": threat.detection_radius_m,
        "attack_radius_m": threat.attack_radius_m,
        "growth_m": _growth_m(station, threat, now_s),
        "speed_bound_m_s": threat.speed_bound_m_s,
        "floor_m": threat.floor_m,
        "ceiling_m": threat.ceiling_m,
        "source": "mission",
    }


def _moving(identity: int, name: str | None, track: Track, now_s: float) -> View:
    north_m, east_m = _place(track)
    return {
        "id": identity,
        "name": name,
        "north_m": north_m,
        "east_m": east_m,
        "velocity_north_m_s": round(track.velocity_north_m_s, 2),
        "velocity_east_m_s": round(track.velocity_east_m_s, 2),
        "age_s": _age_s(track, now_s),
    }


def _point(identity: int, track: Track, now_s: float) -> list[float]:
    velocity = [round(track.velocity_north_m_s, 2), round(track.velocity_east_m_s, 2)]
    return [identity, *_place(track), *velocity, _age_s(track, now_s)]


def _place(track: Track) -> tuple[float, float]:
    return round(track.north_m, 2), round(track.east_m, 2)


def _age_s(track: Track, now_s: float) -> float:
    return round(track.age_s(now_s), 2)


def _speed_m_s(track: Track) -> float:
    return round(math.hypot(track.velocity_north_m_s, track.velocity_east_m_s), 2)


def _heading_deg(track: Track, agent: AgentSpec) -> float | None:
    """Return an agent's heading; where it has not been seen to move, the mission's."""
    if _speed_m_s(track) < MOVING_M_S:
        return agent.heading_deg
    return round(math.degrees(math.atan2(track.velocity_east_m_s, track.velocity_north_m_s)) % 360.0, 1)


def _growth_m(station: GroundStation, threat: ThreatSpec, now_s: float) -> float:
    """Return by how much a threat's radii are greater because its position is old."""
    track = station.tracks.tracks[Kind.THREAT, threat.id]
    return round(threat.speed_bound_m_s * track.age_s(now_s), 2)
