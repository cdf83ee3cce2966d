"""Tables of agents, targets and threats as last heard in the broadcast, each with the time when that was true."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

from companion.mission.values import MAX_ITEMS
from companion.protocol.codec import (
    AgentEntry,
    BandEntry,
    BandsFrame,
    FleetFrame,
    MotionFrame,
    StateFrame,
    TargetEntry,
    ThreatEntry,
)

MOST_KNOWN = MAX_ITEMS
"""Greatest number of agents, of targets and of threats that are known: no mission has more."""
STANDING_M_S = 0.5
"""Speed below which an agent that is told without a heading stands still (on the wire 0, or hardly more)."""


KnownT = TypeVar("KnownT")


def put(table: dict[int, KnownT], identity: int, known: KnownT) -> None:
    """Put an entry into a table as its newest; of more than MOST_KNOWN the one that was not told for longest goes."""
    table.pop(identity, None)
    table[identity] = known
    if len(table) > MOST_KNOWN:
        del table[next(iter(table))]


@dataclass(frozen=True)
class Heard:
    """When the content of one broadcast was true, by this vehicle's clock, and which broadcast that was."""

    true_at_s: float
    broadcast: tuple[int, int]
    """Epoch and sequence of the broadcast."""


class ToldMotion(NamedTuple):
    """The velocity of an agent as told, and when that was true by this vehicle's clock."""

    velocity_m_s: tuple[float, float]
    true_at_s: float


class Beliefs:
    """The newest entry heard of each agent, target and threat, by id; velocities and bands are told by other frames."""

    def __init__(self) -> None:
        self.agents: dict[int, tuple[AgentEntry, Heard]] = {}
        self.targets: dict[int, tuple[TargetEntry, Heard]] = {}
        self.threats: dict[int, tuple[ThreatEntry, Heard]] = {}
        self.agent_motions: dict[int, ToldMotion] = {}
        self.threat_velocities_m_s: dict[int, tuple[float, float]] = {}
        self.threat_pictures: dict[int, int] = {}
        """Number, with that of its epoch, of the picture that the last word on each threat was of, by its id."""
        self.unit_m = 0.0
        """Unit of the places in the newest frame."""
        self.bands: dict[int, BandEntry] = {}
        """Floors and ceilings of threats, by id of the threat."""

    def target_of(self, agent_id: int) -> int | None:
        """Return the id of an agent's target; None if it has none or the agent is not known."""
        known = self.agents.get(agent_id)
        return None if known is None else known[0].target_id

    def are_rivals(self, agent_id: int, peer_id: int) -> bool:
        """Return whether two agents have the same target."""
        target_id = self.target_of(agent_id)
        return target_id is not None and self.target_of(peer_id) == target_id

    def loiters_first(self, peer_id: int | None, agent_id: int) -> bool:
        """Return whether an agent must keep its loiter place clear of a peer's.

        It must if the peer has no target or the lower id: both vehicles know that without talking to each other. It
        must also if the peer is not one of the fleet, as a stranger does not know the rule.
        """
        if peer_id is None or peer_id not in self.agents:
            return True
        return self.agents[peer_id][0].target_id is None or peer_id < agent_id

    def take(self, frame: StateFrame | FleetFrame, heard: Heard) -> None:
        """Take agents and targets from a state or fleet frame, and the unit of its places."""
        self.unit_m = (frame.resolution_cm if isinstance(frame, StateFrame) else frame.grid.resolution_cm) / 100.0
        for agent in frame.agents:
            put(self.agents, agent.id, (agent, heard))
        for target in frame.targets:
            put(self.targets, target.id, (target, heard))

    def take_threat(self, threat: ThreatEntry, heard: Heard, same_picture: bool) -> None:
        """Take the newest word on a threat; `same_picture`: the word before was of the same picture.

        Of a threat that stands both words are discs that contain it, and the one heard first is kept unless the other
        lies inside it: so its disc never grows, whatever grid the newer word was told on.
        """
        known = self.threats.get(threat.id)
        if known is not None and same_picture and _stand(known[0], threat) and not _is_inside(threat, known[0]):
            threat = known[0]
        self.threats[threat.id] = (threat, heard)

    def take_motion(self, frame: MotionFrame, true_at_s: float) -> None:
        """Take the velocities of agents and threats from a frame that was true at a time by this vehicle's clock."""
        for agent in frame.agents:
            if agent.heading_rad is None and agent.speed_m_s >= STANDING_M_S:
                # It goes anywhere: its velocity of before is no better guess than none.
                self.agent_motions.pop(agent.id, None)
                continue
            heading_rad = agent.heading_rad or 0.0
            velocity_m_s = (agent.speed_m_s * math.cos(heading_rad), agent.speed_m_s * math.sin(heading_rad))
            put(self.agent_motions, agent.id, ToldMotion(velocity_m_s, true_at_s - agent.age_s))
        for threat in frame.threats:
            put(self.threat_velocities_m_s, threat.id, (threat.velocity_north_m_s, threat.velocity_east_m_s))

    def take_bands(self, frame: BandsFrame) -> None:
        """Take the floors and ceilings of some threats; one that is forgotten makes a threat reach every altitude."""
        for threat in frame.threats:
            put(self.bands, threat.id, threat)

    def make_room(self, is_needed: Callable[[int], bool]) -> bool:
        """Return whether another threat can be known; if necessary forget one that is not needed, by its id."""
        if len(self.threats) < MOST_KNOWN:
            return True
        spare = next((identity for identity in self.threats if not is_needed(identity)), None)
        if spare is not None:
            del self.threats[spare]
        return spare is not None

    def forget(self, is_gone: Callable[[Heard], bool]) -> None:
        """Forget agents and targets of broadcasts that are gone, and the velocities of agents not known any more."""
        for known in (self.agents, self.targets):
            for identity in [key for key, (_, heard) in known.items() if is_gone(heard)]:
                del known[identity]
        for identity in self.agent_motions.keys() - self.agents.keys():
            del self.agent_motions[identity]

    def forget_threats(self, stays: Callable[[int], bool]) -> None:
        """Forget the threats that do not stay, by id, and velocities and bands of those not known any more."""
        for identity in [key for key in self.threats if not stays(key)]:
            del self.threats[identity]
        for identity in self.threat_pictures.keys() - self.threats.keys():
            del self.threat_pictures[identity]
        for identity in self.threat_velocities_m_s.keys() - self.threats.keys():
            del self.threat_velocities_m_s[identity]
        for identity in self.bands.keys() - self.threats.keys():
            del self.bands[identity]


def _stand(old: ThreatEntry, new: ThreatEntry) -> bool:
    return old.speed_bound_m_s == new.speed_bound_m_s == 0.0


def _is_inside(new: ThreatEntry, old: ThreatEntry) -> bool:
    """Return whether both discs of a threat lie inside those of an older word on it."""
    moved_m = math.dist((new.north_m, new.east_m), (old.north_m, old.east_m))
    return (
        moved_m + new.detection_radius_m <= old.detection_radius_m
        and moved_m + new.attack_radius_m <= old.attack_radius_m
    )
