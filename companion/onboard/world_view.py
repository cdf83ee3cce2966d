"""The view of the picture that a guidance law gets, made by pure functions of tables and time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from companion.guidance.view import NOBODY, Others, Traffic, View
from companion.onboard.beliefs import Beliefs, Heard
from companion.protocol.codec import BandEntry, TargetEntry

IDENTITY_SLACK_M = 20.0
"""Distance between the places that the broadcast and a transponder tell of one agent which needs no explanation: the
errors of two GPS receivers, and of two clocks."""


@dataclass(frozen=True)
class ThreatTable:
    """The M threats as last heard, in order of their ids."""

    centres_ned_m: np.ndarray  # (M, 2) m
    detection_m: np.ndarray  # (M,) m
    attack_m: np.ndarray  # (M,) m
    speed_m_s: np.ndarray  # (M,) m/s, bounds on the speeds
    velocity_m_s: np.ndarray  # (M, 2) m/s, zero where not heard
    true_at_s: np.ndarray  # (M,) s, when the entry was true
    ids: np.ndarray  # (M,) int
    pictures: np.ndarray  # (M,) int, see Beliefs.threat_pictures
    floor_m: np.ndarray  # (M,) m above sea level, -inf where none was heard
    ceiling_m: np.ndarray  # (M,) m above sea level, inf where none was heard
    unit_m: float
    """Unit of the places as they were told, m."""


@dataclass(frozen=True)
class PeerTable:
    """The P other agents whose positions were broadcast, as last heard, in order of their ids."""

    ids: np.ndarray  # (P,) int
    traffic_ned_m: np.ndarray  # (P, 2) m, positions as broadcast
    velocity_m_s: np.ndarray  # (P, 2) m/s, zero where not heard
    moving_told: np.ndarray  # (P,) bool, whether a velocity was heard
    true_at_s: np.ndarray  # (P,) s, when the entry was true
    known_at_s: np.ndarray  # (P,) s, when the older of position and velocity was true
    rounding_m: float
    """Greatest error of a position by the rounding on the wire."""
    loiters_first: np.ndarray  # (P,) bool, see Beliefs.loiters_first
    claimed_ned_m: np.ndarray  # (C, 2) m, targets of any other agents, but not this vehicle's own


def threat_table(beliefs: Beliefs) -> ThreatTable:
    """Return the table of all threats in the picture."""
    entries = [beliefs.threats[identity] for identity in sorted(beliefs.threats)]
    velocities = [beliefs.threat_velocities_m_s.get(threat.id, (0.0, 0.0)) for threat, _ in entries]
    bands = [beliefs.bands.get(threat.id) for threat, _ in entries]
    return ThreatTable(
        centres_ned_m=np.array([(threat.north_m, threat.east_m) for threat, _ in entries]).reshape(-1, 2),
        detection_m=np.array([threat.detection_radius_m for threat, _ in entries]),
        attack_m=np.array([threat.attack_radius_m for threat, _ in entries]),
        speed_m_s=np.array([threat.speed_bound_m_s for threat, _ in entries]),
        velocity_m_s=np.array(velocities).reshape(-1, 2),
        true_at_s=np.array([heard.true_at_s for _, heard in entries]),
        ids=np.array([threat.id for threat, _ in entries], dtype=int),
        pictures=np.array([beliefs.threat_pictures.get(threat.id, 0) for threat, _ in entries], dtype=int),
        floor_m=np.array([_floor_m(band) for band in bands]),
        ceiling_m=np.array([_ceiling_m(band) for band in bands]),
        unit_m=beliefs.unit_m,
    )


def peer_table(beliefs: Beliefs, agent_id: int) -> PeerTable:
    """Return the table of all agents in the picture but `agent_id`, the vehicle's own."""
    others = sorted(beliefs.agents.keys() - {agent_id})
    ids = [identity for identity in others if beliefs.agents[identity][0].position_ned_m is not None]
    entries = [beliefs.agents[identity] for identity in ids]
    claims = {beliefs.target_of(identity) for identity in others} - {beliefs.target_of(agent_id)}
    claimed = [beliefs.targets[target_id][0] for target_id in sorted(beliefs.targets.keys() & claims)]
    motions = [beliefs.agent_motions.get(identity) for identity in ids]
    velocities = [(0.0, 0.0) if told is None else told.velocity_m_s for told in motions]
    true_at_s = np.array([heard.true_at_s for _, heard in entries])
    moving_at_s = np.array([math.inf if told is None else told.true_at_s for told in motions])
    return PeerTable(
        ids=np.array(ids, dtype=int),
        traffic_ned_m=np.array([agent.position_ned_m for agent, _ in entries]).reshape(-1, 2),
        velocity_m_s=np.array(velocities).reshape(-1, 2),
        moving_told=np.array([told is not None for told in motions], dtype=bool),
        true_at_s=true_at_s,
        known_at_s=np.minimum(true_at_s, moving_at_s),
        rounding_m=math.sqrt(0.5) * beliefs.unit_m,
        loiters_first=np.array([beliefs.loiters_first(identity, agent_id) for identity in ids], dtype=bool),
        claimed_ned_m=np.array([(target.north_m, target.east_m) for target in claimed]).reshape(-1, 2),
    )


def view_of(
    threats: ThreatTable,
    peers: PeerTable,
    assigned: tuple[TargetEntry, Heard] | None,
    peer_memory_s: float,
    now_s: float,
) -> View:
    """Return the view at a time: discs grown by their age times the speed bound, peers carried on by their velocity.

    Args:
        threats: The threats that reach the vehicle's height.
        peers: The other agents.
        assigned: The target assigned to the vehicle, if any.
        peer_memory_s: Age above which a peer is left out, except of those that may count to the right of way.
        now_s: Time by this vehicle's clock.

    """
    threat_age_s = np.maximum(0.0, now_s - threats.true_at_s)
    growth_m = threats.speed_m_s * threat_age_s
    age_s = np.maximum(0.0, now_s - peers.true_at_s)
    peers_ned_m = peers.traffic_ned_m + peers.velocity_m_s * age_s[:, None]
    remembered = age_s <= peer_memory_s
    return View(
        target_ned_m=None if assigned is None else (assigned[0].north_m, assigned[0].east_m),
        target_age_s=math.inf if assigned is None else max(0.0, now_s - assigned[1].true_at_s),
        threats_ned_m=threats.centres_ned_m,
        detection_radius_m=threats.detection_m + growth_m,
        attack_radius_m=threats.attack_m + growth_m,
        threat_speed_m_s=threats.speed_m_s,
        threat_ids=threats.ids,
        threat_velocity_m_s=threats.velocity_m_s,
        threat_age_s=threat_age_s,
        threat_pictures=threats.pictures,
        unit_m=threats.unit_m,
        peers_ned_m=peers_ned_m[remembered],
        peer_ids=peers.ids[remembered],
        loitering_ned_m=peers_ned_m[remembered & peers.loiters_first],
        claimed_ned_m=peers.claimed_ned_m,
        others=_told(peers, now_s),
    )


def _told(peers: PeerTable, now_s: float) -> Others:
    """Return the agents whose positions were broadcast, each at the time when position and velocity were both true."""
    if len(peers.ids) == 0:
        return Others()
    # An older velocity than the position: it flew by that to where it was told to be, or nearly so.
    carried_s = peers.true_at_s - peers.known_at_s
    return Others(
        ids=peers.ids,
        places_ned_m=peers.traffic_ned_m - peers.velocity_m_s * carried_s[:, None],
        velocities_m_s=peers.velocity_m_s,
        ages_s=np.maximum(0.0, now_s - peers.known_at_s),
        moving_told=peers.moving_told,
        rounding_m=np.full(len(peers.ids), peers.rounding_m),
    )


class Shown(NamedTuple):
    """What the own detector shows, after a look at who can be who it claims to be."""

    seen: tuple[Traffic, ...]
    """All that is near; whoever cannot be the agent that it claims to be is nobody known."""
    placed: frozenset[int]
    """Ids of the agents whose place the detector tells, so that the one told counts no more."""


def checked_identities(
    told: Others, seen: Sequence[Traffic], elsewhere: Sequence[Traffic], fastest_m_s: float
) -> Shown:
    """Return what the detector shows, with the ids of those only that are where the broadcast lets them be.

    Anybody can send a transponder's message, so that it must not move an agent from where the broadcast says it is: who
    claims an id at a place that ages and speeds do not explain is a stranger, and the agent itself counts as told.

    Args:
        told: The agents whose places were broadcast.
        seen: The traffic near the vehicle.
        elsewhere: Agents that are seen where they do not matter to the right of way.
        fastest_m_s: Greatest speed over ground of an agent.

    """
    rows = {int(identity): row for row, identity in enumerate(told.ids)}

    def fits(other: Traffic) -> bool:
        row = rows.get(other.agent_id or NOBODY)
        return row is None or math.isinf(fastest_m_s) or _explained(other, told, row, fastest_m_s)

    checked = tuple(other if fits(other) else replace(other, agent_id=None) for other in seen)
    placed = [other.agent_id for other in (*checked, *filter(fits, elsewhere)) if other.agent_id is not None]
    return Shown(checked, frozenset(placed))


def _explained(seen: Traffic, told: Others, row: int, fastest_m_s: float) -> bool:
    """Return whether an agent that was told to be at a place may be where it is seen."""
    velocity_m_s = told.velocities_m_s[row]
    now_ned_m = told.places_ned_m[row] + velocity_m_s * told.ages_s[row]
    fastest_m_s = max(fastest_m_s, float(np.hypot(*velocity_m_s)))
    # At most, each was carried on at full speed one way while the agent flew the other.
    flown_m = 2.0 * fastest_m_s * (float(told.ages_s[row]) + seen.age_s)
    return math.dist(now_ned_m, seen.position_ned_m) <= float(told.rounding_m[row]) + IDENTITY_SLACK_M + flown_m


def with_traffic(view: View, shown: Shown, beliefs: Beliefs, agent_id: int) -> View:
    """Return a view with the traffic that the vehicle's own detector shows.

    An agent that is detected takes its position from the detector, not from the broadcast.
    """
    seen = shown.seen
    others = _with_seen(view.others, shown)
    if not seen:
        return view if others is view.others else replace(view, others=others)
    seen_ids = np.array([other.agent_id or NOBODY for other in seen], dtype=int)
    traffic_ned_m = np.array([other.position_ned_m for other in seen])
    first = np.array([beliefs.loiters_first(other.agent_id, agent_id) for other in seen], dtype=bool)
    unseen = ~np.isin(view.peer_ids, seen_ids)
    heard_first = [beliefs.loiters_first(int(identity), agent_id) for identity in view.peer_ids[unseen]]
    return replace(
        view,
        peers_ned_m=np.concatenate((view.peers_ned_m[unseen], traffic_ned_m)),
        peer_ids=np.concatenate((view.peer_ids[unseen], seen_ids)),
        rivals=tuple(
            (other.agent_id, other.position_ned_m)
            for other in seen
            if other.agent_id is not None and beliefs.are_rivals(agent_id, other.agent_id)
        ),
        traffic_ned_m=traffic_ned_m,
        traffic_velocity_m_s=np.array([other.velocity_m_s for other in seen]),
        loitering_ned_m=np.concatenate(
            (view.peers_ned_m[unseen][np.array(heard_first, dtype=bool)], traffic_ned_m[first])
        ),
        others=others,
    )


def _with_seen(told: Others, shown: Shown) -> Others:
    """Return those seen, then those told who are not seen."""
    seen = shown.seen
    if not seen and not shown.placed:
        return told
    seen_ids = [other.agent_id or NOBODY for other in seen]
    unseen = ~np.isin(told.ids, list(shown.placed))
    ages_s = np.array([other.age_s for other in seen])
    velocities_m_s = np.array([other.velocity_m_s for other in seen]).reshape(-1, 2)
    now_ned_m = np.array([other.position_ned_m for other in seen]).reshape(-1, 2)
    return Others(
        ids=np.concatenate((np.array(seen_ids, dtype=int), told.ids[unseen])),
        places_ned_m=np.concatenate((now_ned_m - velocities_m_s * ages_s[:, None], told.places_ned_m[unseen])),
        velocities_m_s=np.concatenate((velocities_m_s, told.velocities_m_s[unseen])),
        ages_s=np.concatenate((ages_s, told.ages_s[unseen])),
        moving_told=np.concatenate((np.ones(len(seen), dtype=bool), told.moving_told[unseen])).astype(bool),
        rounding_m=np.concatenate((np.zeros(len(seen)), told.rounding_m[unseen])),
        seen=len(seen),
    )


def reaching(threats: ThreatTable, low_m: float, high_m: float) -> ThreatTable:
    """Return the threats that may reach an altitude between two above sea level; an unknown band reaches all."""
    kept = ~((threats.ceiling_m < low_m) | (threats.floor_m > high_m))
    if kept.all():
        return threats
    rows = {part.name: getattr(threats, part.name)[kept] for part in fields(threats) if part.name != "unit_m"}
    return ThreatTable(**rows, unit_m=threats.unit_m)


def _floor_m(band: BandEntry | None) -> float:
    return -math.inf if band is None or band.floor_m is None else band.floor_m


def _ceiling_m(band: BandEntry | None) -> float:
    return math.inf if band is None or band.ceiling_m is None else band.ceiling_m
