"""What a page shows of a run: plain values that JSON can hold, made from the ground station and its surroundings.

A picture is everything, for whoever begins to look; moves are the places alone, several times a second. Lengths are
rounded to centimetres and angles to tenths of a degree, so that what is the same is the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np

from companion.errors import some_of
from companion.mission.model import AgentSpec, Mission, TargetSpec, ThreatSpec, agent_height_m
from companion.protocol.codec import Directive, Kind, ThreatEntry
from groundstation.broadcast import MOVING_M_S, grown
from groundstation.ground_station import GroundStation
from groundstation.operations import DIRECTIVE_NAMES, KIND_NAMES
from groundstation.origins import MISSION, REPORT, SEEN_S, SENSOR
from groundstation.plausibility import SENSOR_ERROR_M
from groundstation.sightings import words_of
from groundstation.target_assignment import out_of_reach
from groundstation.track import Track

MOST_LISTED = 10
"""Greatest number of things that a warning names."""
SMALLEST_M = 1.0
"""Least detection radius of a threat that is taken to be meant. Chosen: no place is known better by satellites."""
View = dict[str, Any]
"""Values that JSON can hold."""
AgentSource = Literal["mission", "sensor", "telemetry", "report", "reckoned"]
_SEEN_BY: dict[str, AgentSource] = {SENSOR: "sensor", REPORT: "report"}
Mode = Literal["live", "sim", "playback"]


@dataclass(frozen=True)
class Surroundings:
    """What a page shows beside the ground station's own picture."""

    mode: Mode = "live"
    broadcast: Mapping[str, Any] = field(default_factory=dict)
    """Rate, budget, items and authentication of the broadcast."""
    sources: Sequence[Mapping[str, Any]] = ()
    unknown: Sequence[Mapping[str, Any]] = ()
    """What live sources see and the mission does not have, beside what the sensor sees."""
    warnings: Sequence[str] = ()


def picture(station: GroundStation, now_s: float, around: Surroundings) -> View:
    """Return everything that a page shows at `now_s`, times of the ground station's clock."""
    mission, operations = station.mission, station.operations
    sent: dict[int, list[int]] = {}
    for agent_id, target_id in station.sent.items():
        sent.setdefault(target_id, []).append(agent_id)
    agents = [_agent(station, agent, now_s) for agent in mission.agents]
    return {
        "type": "picture",
        "t_s": round(now_s + station.tracks.clock_ahead_s, 3),
        "mode": around.mode,
        **mission_picture(mission),
        "paused": operations.orders.paused,
        "directive": DIRECTIVE_NAMES[station.directive],
        "epoch_s": station.epoch_s,
        "revision": station.revision,
        "event": operations.next_number - 1,
        "undoable": operations.undoable,
        "agents": agents,
        "targets": [_target(station, target, sent.get(target.id, []), now_s) for target in mission.targets],
        "threats": [_threat(station, threat, now_s) for threat in mission.threats],
        "unknown": [*_unknown(station, now_s), *(dict(one) for one in around.unknown)],
        "broadcast": dict(around.broadcast),
        "sources": [dict(source) for source in around.sources],
        "warnings": [*_warnings(station, agents, now_s), *around.warnings],
    }


def mission_picture(mission: Mission) -> View:
    """Return what a picture has of the mission alone, whoever makes it."""
    origin = mission.origin
    return {
        "mission": mission.name,
        "case": mission.case,
        "origin": {"lat_deg": origin.lat_deg, "lon_deg": origin.lon_deg, "alt_m": origin.alt_m},
        "fence": None if mission.fence is None else [list(corner) for corner in mission.fence],
        "exclusions": [[list(corner) for corner in polygon] for polygon in mission.exclusions],
        "arrival_radius_m": mission.arrival_radius_m,
        "separation_m": mission.separation_m,
    }


def _warnings(station: GroundStation, agents: Sequence[View], now_s: float) -> list[str]:
    """Return what an operator should know of the picture itself."""
    tracks, mission = station.tracks.tracks, station.mission
    words = []
    recalled = station.directive is Directive.RETURN
    uncovered = station.uncovered
    if mission.queue and not recalled:
        # The others wait for an agent that has arrived.
        uncovered = out_of_reach(mission, station.tracks, uncovered)
    if uncovered:
        why = "all agents are told to return" if recalled else "none is free, or none has the range"
        words.append(f"no agent goes to {_listed('target', uncovered)}: {why}")
    discs = [grown(threat, tracks[Kind.THREAT, threat.id], now_s) for threat in mission.threats]
    centres = np.array([complex(disc.north_m, disc.east_m) for disc in discs])
    radii_m = np.array([disc.detection_radius_m for disc in discs])
    places = [complex(*tracks[Kind.TARGET, target].position_ned_m) for target in station.tracks.open_targets]
    inside = [
        target
        for target, place in zip(station.tracks.open_targets, places, strict=True)
        if np.any(np.abs(centres - place) < radii_m)
    ]
    if inside:
        words.append(f"inside a threat's detection radius, where agents keep out: {_listed('target', inside)}")
    words += _disc_warnings(station, agents, discs)
    if station.unsendable.count:
        words.append(f"{station.unsendable.count} frames could not be sent: {station.unsendable.first}")
    return words


def _disc_warnings(station: GroundStation, agents: Sequence[View], discs: Sequence[ThreatEntry]) -> list[str]:
    """Return what is doubtful of the threats' discs: agents inside, radii too small, or too great, to be meant."""
    mission = station.mission
    here = np.array([complex(agent["north_m"], agent["east_m"]) for agent in agents])
    levels_m = np.array([mission.origin.alt_m + agent_height_m(mission, agent.id) for agent in mission.agents])
    counts = np.array([agent["state"] != "lost" for agent in agents])
    inside = np.zeros(len(agents), dtype=bool)
    tiny, holding_all = [], []
    goals = [station.tracks.tracks[Kind.TARGET, target.id].position_ned_m for target in mission.targets]
    for threat, disc in zip(mission.threats, discs, strict=True):
        floor_m = -math.inf if threat.floor_m is None else threat.floor_m
        ceiling_m = math.inf if threat.ceiling_m is None else threat.ceiling_m
        within = np.abs(here - complex(disc.north_m, disc.east_m)) < disc.detection_radius_m
        within &= (floor_m <= levels_m) & (levels_m <= ceiling_m)
        inside |= within & counts
        centre = disc.north_m, disc.east_m
        if within.all() and all(math.dist(goal, centre) < disc.detection_radius_m for goal in goals):
            holding_all.append(threat.id)
        if threat.detection_radius_m < SMALLEST_M:
            tiny.append(threat.id)
    words = []
    if inside.any():
        ids = [agent.id for agent, is_inside in zip(mission.agents, inside, strict=True) if is_inside]
        words.append(f"inside a threat's detection radius now: {_listed('agent', ids)}")
    if holding_all:
        words.append(f"every agent and target is inside the detection radius of {_listed('threat', holding_all)}")
    if tiny:
        words.append(f"detection radius under {SMALLEST_M:g} m: {_listed('threat', tiny)}; is it in metres?")
    return words


def _listed(kind: str, ids: Sequence[int]) -> str:
    """Return things in words."""
    return f"{kind}{'s' if len(ids) > 1 else ''} {some_of(ids, MOST_LISTED)}"


def moves(station: GroundStation, now_s: float) -> View:
    """Return the places of everything at `now_s`: [id, north, east, ...] in m, degrees, m/s and s."""
    tracks, mission = station.tracks.tracks, station.mission
    agents = []
    for agent in mission.agents:
        at = _where(station, agent, now_s)
        agents.append([agent.id, at.north_m, at.east_m, at.heading_deg, at.speed_m_s, at.age_s])
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
    at = _where(station, agent, now_s)
    target_id = station.sent.get(agent.id)
    orders = station.operations.orders
    pinned = orders.pins.get(agent.id)
    return {
        "id": agent.id,
        "north_m": at.north_m,
        "east_m": at.east_m,
        "heading_deg": at.heading_deg,
        "speed_m_s": at.speed_m_s,
        "age_s": at.age_s,
        "source": at.source,
        "ellipse": _ellipse(station, agent, at, now_s),
        "state": _state(station, agent.id),
        "target": target_id,
        "pinned": None if pinned is None or pinned not in station.tracks.open_targets else pinned,
        "directive": DIRECTIVE_NAMES[orders.of(agent.id)],
        "range_left_m": round(max(0.0, agent.range_m - station.tracks.flown_m[agent.id]), 1),
        "eta_s": _eta_s(station, agent, at, target_id),
        "link": _link(station, agent, now_s),
        "certificate": None,
        "reason": None,
    }


class _At(NamedTuple):
    """Where an agent is now, as far as is known."""

    north_m: float
    east_m: float
    heading_deg: float | None
    speed_m_s: float
    age_s: float
    """Time since somebody saw it or it reported, or since the mission's word."""
    source: AgentSource


def _where(station: GroundStation, agent: AgentSpec, now_s: float) -> _At:
    """Return where an agent is: seen, dead-reckoned by its companion, or flying straight on since it was seen."""
    key = Kind.AGENT, agent.id
    track, origins = station.tracks.tracks[key], station.tracks.origins
    speed_m_s = math.hypot(track.velocity_north_m_s, track.velocity_east_m_s)
    heading_deg = agent.heading_deg
    if speed_m_s >= MOVING_M_S:
        heading_deg = round(math.degrees(math.atan2(track.velocity_east_m_s, track.velocity_north_m_s)) % 360.0, 1)
    seen_by, is_seen = origins.by.get(key), origins.is_seen(agent.id, now_s)
    age_s = track.age_s(now_s)
    if is_seen and seen_by is not None:
        source: AgentSource = _SEEN_BY.get(seen_by, "telemetry")
    elif station.reckoner is not None:
        age_s = max(0.0, now_s - station.reckoner.fixed_at_s(agent.id))
        source = "report" if age_s <= SEEN_S and agent.id in origins.reported else "reckoned"
    else:
        source = "mission" if seen_by is None else "reckoned"
    north_m, east_m = track.place_at(now_s)
    return _At(round(north_m, 2), round(east_m, 2), heading_deg, round(speed_m_s, 2), round(age_s, 2), source)


def _ellipse(station: GroundStation, agent: AgentSpec, at: _At, now_s: float) -> View | None:
    """Return the ellipse in which an agent that is not seen is taken to be; None for one that is."""
    if at.source != "reckoned":
        return None
    if station.reckoner is not None:
        estimate = station.reckoner.estimate(agent.id, now_s)
        along_m, across_m = estimate.uncertainty_m, estimate.across_m
    else:
        # It may have turned at once.
        along_m = across_m = SENSOR_ERROR_M + at.speed_m_s * at.age_s
    return {
        "semi_major_m": round(along_m, 1),
        "semi_minor_m": round(across_m, 1),
        "heading_deg": at.heading_deg or 0.0,
    }


def _state(station: GroundStation, agent_id: int) -> str:
    progress, orders = station.tracks.progress, station.operations.orders
    if agent_id in progress.lost:
        return "lost"
    if agent_id in orders.out:
        return "out"
    if orders.of(agent_id) is Directive.RETURN:
        return "recalled"
    if agent_id in progress.arrived:
        return "arrived"
    return "under way" if agent_id in station.sent else "no target"


def _link(station: GroundStation, agent: AgentSpec, now_s: float) -> View | None:
    """Return how much of what is sent an agent is taken to hear: as much as is heard of its reports, or as declared.

    A link that is heard both ways fades both ways; a vehicle that only listens cannot be asked.
    """
    mission = station.mission
    if mission.case == "II" and mission.report_period_s > 0.0:
        share = station.tracks.origins.heard_share(agent.id, mission.report_period_s, now_s)
        return None if share is None else {"heard": round(share, 2), "by": "reports"}
    return {"heard": round(1.0 - mission.link.loss, 2), "by": "mission"} if mission.link.loss > 0.0 else None


def _eta_s(station: GroundStation, agent: AgentSpec, at: _At, target_id: int | None) -> float | None:
    """Return the time to the target by the straight line at the agent's speed; None without a target."""
    if target_id is None:
        return None
    target = station.tracks.tracks[Kind.TARGET, target_id]
    away_m = math.dist((at.north_m, at.east_m), target.position_ned_m) - station.mission.arrival_radius_m
    return round(max(0.0, away_m) / agent.speed_m_s, 1)


def _target(station: GroundStation, target: TargetSpec, agents: list[int], now_s: float) -> View:
    track = station.tracks.tracks[Kind.TARGET, target.id]
    name = station.operations.names.get((Kind.TARGET, target.id))
    return {
        **_moving(target.id, name, track, now_s),
        "speed_bound_m_s": target.speed_bound_m_s,
        "reached_by": list(station.operations.reached.by.get(target.id, ())),
        "agents": agents,
        "source": station.tracks.origins.by.get((Kind.TARGET, target.id), MISSION),
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
        "source": station.tracks.origins.by.get((Kind.THREAT, threat.id), MISSION),
    }


def _unknown(station: GroundStation, now_s: float) -> list[View]:
    """Return what the sensor sees, and neither the mission has nor a rule has taken in."""
    known = {key for _, key in station.operations.tracks}
    return [
        {
            "source": thing.source,
            "kind": KIND_NAMES[kind],
            "id": identity,
            "north_m": round(thing.place.real, 2),
            "east_m": round(thing.place.imag, 2),
            "age_s": round(max(0.0, now_s - thing.at_s), 2),
            "count": thing.times,
        }
        for (kind, identity), thing in station.tracks.origins.unknown.items()
        if words_of((kind, identity)) not in known
    ]


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


def _growth_m(station: GroundStation, threat: ThreatSpec, now_s: float) -> float:
    """Return by how much a threat's radii are greater because its position is old."""
    track = station.tracks.tracks[Kind.THREAT, threat.id]
    return round(threat.speed_bound_m_s * track.age_s(now_s), 2)
