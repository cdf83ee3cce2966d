"""What the vehicle believes: the newest of each thing heard, with ages.

State frames are self-contained, idempotent and newest-wins. A thing is forgotten only when a broadcast that was heard
whole no longer holds it; a threat not heard of again is never dropped, its disc only grows.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from companion.guidance.view import NOBODY, Traffic, View
from companion.protocol.codec import (
    AgentEntry,
    BandEntry,
    BandsFrame,
    Directive,
    FleetFrame,
    Frame,
    MissionFrame,
    MotionFrame,
    RadiiEntry,
    RadiiFrame,
    Stamp,
    StateFrame,
    TargetEntry,
    ThreatEntry,
    ThreatPlace,
)
from companion.protocol.freshness import RESTART_AFTER_S, SenderClock


@dataclass(frozen=True)
class Heard:
    """When the things of one broadcast were true, by this vehicle's clock, and which broadcast it was."""

    true_at_s: float
    broadcast: tuple[int, int]
    """Epoch and sequence."""


@dataclass(frozen=True)
class _Placed:
    """Where a threat was heard to be, its radii being told elsewhere."""

    place: ThreatPlace
    rounding_m: float
    heard: Heard


@dataclass(frozen=True)
class _ThreatTable:
    """The threats as last heard, by rising id."""

    centres_ned_m: np.ndarray  # (M, 2) m
    detection_m: np.ndarray  # (M,) m
    attack_m: np.ndarray  # (M,) m
    speed_m_s: np.ndarray  # (M,) m/s, bounds
    velocity_m_s: np.ndarray  # (M, 2) m/s
    true_at_s: np.ndarray  # (M,) s
    ids: np.ndarray  # (M,) int
    floor_m: np.ndarray  # (M,) m above sea level, -inf: none heard of
    ceiling_m: np.ndarray  # (M,) m above sea level, inf: none heard of


@dataclass(frozen=True)
class _PeerTable:
    """The other agents as last heard, by rising id; those whose place was not broadcast are not in it."""

    ids: np.ndarray  # (P,) int
    traffic_ned_m: np.ndarray  # (P, 2) m
    velocity_m_s: np.ndarray  # (P, 2) m/s
    true_at_s: np.ndarray  # (P,) s
    settled: np.ndarray  # (P,) bool


class WorldModel:
    """Merges frames for one agent; all times are this vehicle's clock in seconds, given by the caller."""

    def __init__(self, agent_id: int, peer_memory_s: float = 30.0, *, clocks_agree: bool = True) -> None:
        """`clocks_agree`: the sender's clock shows the same time as this vehicle's."""
        self.agent_id = agent_id
        self._sender_clock = SenderClock(agrees=clocks_agree)
        self.peer_memory_s = peer_memory_s
        """A peer heard of longer ago than this is somewhere else by now and is left out."""
        self.rejected: Counter[str] = Counter()
        self.origin_deg: tuple[float, float] | None = None
        self.directive = Directive.NORMAL
        self.target_id: int | None = None
        self.epoch_s: int | None = None
        self.sequence = -1
        self._received_s = -math.inf
        self._state_true_at_s: float | None = None
        self._agents: dict[int, tuple[AgentEntry, Heard]] = {}
        self._targets: dict[int, tuple[TargetEntry, Heard]] = {}
        self._threats: dict[int, tuple[ThreatEntry, Heard]] = {}
        self._velocities: dict[int, tuple[float, float]] = {}
        self._threat_velocities: dict[int, tuple[float, float]] = {}
        self._bands: dict[int, BandEntry] = {}
        self._placed: dict[int, _Placed] = {}
        """Threats of fleet frames of this epoch; in `_threats` too once their radii are known."""
        self._radii: dict[int, RadiiEntry] = {}
        """Of radii frames of this epoch."""
        self._origin_told = False
        """Whether the origin was told in this epoch: until then nobody can say where a fleet frame's places are."""
        self._mission_digest: bytes | None = None
        """Of the last mission frame, of any epoch."""
        self._mission_epochs: set[int] = set()
        """Epochs that told this digest: what was heard in them, and in no others, is of that mission."""
        self._threats_told = 0
        """How many threats that mission has, 0 once a state frame told of what may be another."""
        self._waiting: dict[int, tuple[FleetFrame, float]] = {}
        """The newest fleet frame of each index, and when it came, until the origin is told."""
        self._parts: set[int] = set()
        self._motion_order = (-1, -1)
        self._bands_order = (-1, -1)
        self._cached: tuple[_ThreatTable, _PeerTable] | None = None

    def age_s(self, now_s: float) -> float | None:
        """Return the age of the newest state heard, None if none ever was."""
        return None if self._state_true_at_s is None else max(0.0, now_s - self._state_true_at_s)

    def take(self, frame: Frame, now_s: float) -> bool:
        """Merge a frame received at `now_s`; return whether it was one of a broadcast's, and new."""
        if isinstance(frame, StateFrame):
            return self.take_state(frame, now_s)
        if isinstance(frame, FleetFrame):
            return self.take_fleet(frame, now_s)
        if isinstance(frame, RadiiFrame):
            return self.take_radii(frame, now_s)
        if isinstance(frame, MissionFrame):
            return self.take_mission(frame, now_s)
        if isinstance(frame, MotionFrame):
            return self.take_motion(frame, now_s)
        return isinstance(frame, BandsFrame) and self.take_bands(frame)

    def take_state(self, frame: StateFrame, now_s: float) -> bool:
        """Merge a state frame received at `now_s`; return whether it was new."""
        if not self._accept_part(frame.stamp, now_s):
            return False
        self.directive = frame.directive
        self._take_origin((frame.origin_lat_deg, frame.origin_lon_deg))
        if frame.stamp.epoch_s not in self._mission_epochs:
            self._threats_told = 0
        heard = self._merge(frame, now_s)
        for threat in frame.threats:
            self._threats[threat.id] = (threat, heard)
            self._placed.pop(threat.id, None)
        if len(self._parts) == frame.stamp.frame_count:
            self._forget_absent()
        return True

    def take_fleet(self, frame: FleetFrame, now_s: float) -> bool:
        """Merge a fleet frame received at `now_s`; return whether it was new.

        A threat is believed once its radii are known as well. Until the epoch's origin is known only the directive is
        obeyed and the frame waits: what was believed of an epoch before stands.
        """
        if not self._accept_part(frame.stamp, now_s):
            return False
        self.directive = frame.directive
        if self._origin_told:
            self._merge_fleet([(frame, now_s)])
        else:
            self._waiting[frame.stamp.frame_index] = (frame, now_s)
        return True

    def take_radii(self, frame: RadiiFrame, now_s: float) -> bool:
        """Merge the radii of some threats; return whether the frame was of the newest epoch."""
        if not self._accept_beside(frame.stamp, now_s):
            return False
        for entry in frame.threats:
            self._radii[entry.id] = entry
            self._join(entry.id)
        self._cached = None
        return True

    def take_mission(self, frame: MissionFrame, now_s: float) -> bool:
        """Take what holds for this epoch; return whether the frame was of the newest epoch."""
        if not self._accept_beside(frame.stamp, now_s):
            return False
        self._take_origin((frame.origin_lat_deg, frame.origin_lon_deg))
        if frame.mission_digest != self._mission_digest:
            self._forget_mission()
            self._mission_digest = frame.mission_digest
        self._mission_epochs.add(frame.stamp.epoch_s)
        self._threats_told = frame.threats
        waiting, self._waiting = self._waiting, {}
        self._merge_fleet(sorted(waiting.values(), key=lambda item: item[0].stamp.sequence))
        return True

    def take_motion(self, frame: MotionFrame, now_s: float) -> bool:
        """Merge a motion frame; return whether it belonged to the broadcasts of this epoch."""
        if frame.stamp.epoch_s != self.epoch_s:
            self.rejected["other epoch"] += 1
            return False
        order = (frame.stamp.sequence, frame.stamp.time_ms)
        if frame.stamp.sequence < self.sequence or order < self._motion_order:
            self.rejected["old"] += 1
            return False
        self._motion_order = order
        self._cached = None
        for agent in frame.agents:
            if agent.heading_rad is None:
                # It stands still, or nobody knows where it is going: what it did before is no better guess.
                self._velocities.pop(agent.id, None)
            else:
                self._velocities[agent.id] = (
                    agent.speed_m_s * math.cos(agent.heading_rad),
                    agent.speed_m_s * math.sin(agent.heading_rad),
                )
        for threat in frame.threats:
            self._threat_velocities[threat.id] = (threat.velocity_north_m_s, threat.velocity_east_m_s)
        return True

    def take_bands(self, frame: BandsFrame) -> bool:
        """Merge the heights that threats reach; return whether the frame belonged to this epoch and was not overtaken.

        A threat keeps its band until a newer frame names it anew, or it leaves the picture.
        """
        if frame.stamp.epoch_s != self.epoch_s:
            self.rejected["other epoch"] += 1
            return False
        order = (frame.stamp.sequence, frame.stamp.time_ms)
        if frame.stamp.sequence < self.sequence or order < self._bands_order:
            self.rejected["old"] += 1
            return False
        self._bands_order = order
        self._cached = None
        self._bands.update((threat.id, threat) for threat in frame.threats)
        return True

    def view(self, now_s: float, band_m: tuple[float, float] | None = None) -> View:
        """Return the picture as it must be believed at `now_s`.

        With a band, least and greatest height above sea level that the vehicle may be at, threats known to reach no
        height of it are left out; one whose floor and ceiling were never heard of is not.
        """
        if self._cached is None:
            self._cached = (self._threat_table(), self._peer_table())
        threats, peers = self._cached
        if band_m is not None:
            threats = _reaching(threats, *band_m)
        threat_age_s = np.maximum(0.0, now_s - threats.true_at_s)
        growth_m = threats.speed_m_s * threat_age_s
        age_s = np.maximum(0.0, now_s - peers.true_at_s)
        peers_ned_m = peers.traffic_ned_m + peers.velocity_m_s * age_s[:, None]
        remembered = age_s <= self.peer_memory_s
        # Who does not know of all threats yet cannot go past them: it has nowhere to go.
        known = sum(heard.broadcast[0] in self._mission_epochs for _, heard in self._threats.values())
        lacking = known < self._threats_told
        assigned = None if self.target_id is None or lacking else self._targets.get(self.target_id)
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
            peers_ned_m=peers_ned_m[remembered],
            peer_ids=peers.ids[remembered],
            loitering_ned_m=peers_ned_m[remembered & peers.settled],
        )

    def with_traffic(self, view: View, seen: Sequence[Traffic]) -> View:
        """Return the view with what the vehicle's own detector sees.

        A peer that is seen needs no word of the broadcast's about where it is.
        """
        if not seen:
            return view
        seen_ids = np.array([other.agent_id or NOBODY for other in seen], dtype=int)
        traffic_ned_m = np.array([other.position_ned_m for other in seen])
        before = np.array([self._goes_before(other.agent_id) for other in seen], dtype=bool)
        unseen = ~np.isin(view.peer_ids, seen_ids)
        heard_before = [self._goes_before(int(identity)) for identity in view.peer_ids[unseen]]
        return replace(
            view,
            peers_ned_m=np.concatenate((view.peers_ned_m[unseen], traffic_ned_m)),
            peer_ids=np.concatenate((view.peer_ids[unseen], seen_ids)),
            rivals=tuple(
                (other.agent_id, other.position_ned_m)
                for other in seen
                if other.agent_id is not None and self._is_rival(other.agent_id)
            ),
            traffic_ned_m=traffic_ned_m,
            traffic_velocity_m_s=np.array([other.velocity_m_s for other in seen]),
            loitering_ned_m=np.concatenate(
                (view.peers_ned_m[unseen][np.array(heard_before, dtype=bool)], traffic_ned_m[before])
            ),
        )

    def _is_rival(self, peer_id: int) -> bool:
        """Return whether a peer was sent to the target that we were sent to."""
        known = self._agents.get(peer_id)
        return known is not None and self.target_id is not None and known[0].target_id == self.target_id

    def _threat_table(self) -> _ThreatTable:
        entries = [self._threats[identity] for identity in sorted(self._threats)]
        return _ThreatTable(
            centres_ned_m=np.array([(threat.north_m, threat.east_m) for threat, _ in entries]).reshape(-1, 2),
            detection_m=np.array([threat.detection_radius_m for threat, _ in entries]),
            attack_m=np.array([threat.attack_radius_m for threat, _ in entries]),
            speed_m_s=np.array([threat.speed_bound_m_s for threat, _ in entries]),
            velocity_m_s=np.array(
                [self._threat_velocities.get(threat.id, (0.0, 0.0)) for threat, _ in entries]
            ).reshape(-1, 2),
            true_at_s=np.array([heard.true_at_s for _, heard in entries]),
            ids=np.array([threat.id for threat, _ in entries], dtype=int),
            floor_m=np.array([_floor_m(self._bands.get(threat.id)) for threat, _ in entries]),
            ceiling_m=np.array([_ceiling_m(self._bands.get(threat.id)) for threat, _ in entries]),
        )

    def _peer_table(self) -> _PeerTable:
        others = sorted(self._agents.keys() - {self.agent_id})
        ids = [identity for identity in others if self._agents[identity][0].position_ned_m is not None]
        entries = [self._agents[identity] for identity in ids]
        velocities = [self._velocities.get(identity, (0.0, 0.0)) for identity in ids]
        return _PeerTable(
            ids=np.array(ids, dtype=int),
            traffic_ned_m=np.array([agent.position_ned_m for agent, _ in entries]).reshape(-1, 2),
            velocity_m_s=np.array(velocities).reshape(-1, 2),
            true_at_s=np.array([heard.true_at_s for _, heard in entries]),
            settled=np.array([self._goes_before(identity) for identity in ids], dtype=bool),
        )

    def _goes_before(self, peer_id: int | None) -> bool:
        """Return whether a peer's loiter place goes before ours.

        Of two that arrive together the lower id stays where it is: both know this without a word. Strangers do not.
        """
        if peer_id is None or peer_id not in self._agents:
            return True
        return self._agents[peer_id][0].target_id is None or peer_id < self.agent_id

    def _merge(self, frame: StateFrame | FleetFrame, received_s: float) -> Heard:
        """Take what state and fleet frames tell alike; return when it was true."""
        true_at_s = self._sender_clock.true_at_s(frame.stamp, received_s)
        heard = Heard(true_at_s, (frame.stamp.epoch_s, frame.stamp.sequence))
        self._state_true_at_s = true_at_s
        for agent in frame.agents:
            self._agents[agent.id] = (agent, heard)
            if agent.id == self.agent_id:
                self.target_id = agent.target_id
        for target in frame.targets:
            self._targets[target.id] = (target, heard)
        self._cached = None
        return heard

    def _merge_fleet(self, frames: Sequence[tuple[FleetFrame, float]]) -> None:
        """Merge fleet frames, each with the time when it came, the oldest first."""
        for frame, received_s in frames:
            heard = self._merge(frame, received_s)
            for place in frame.threats:
                self._placed[place.id] = _Placed(place, frame.rounding_m, heard)
                self._join(place.id)
        if frames and len(self._parts) == frames[-1][0].stamp.frame_count:
            self._forget_absent()

    def _join(self, identity: int) -> None:
        """Believe a threat whose place and radii are both known, grown by what it moved before it was told of."""
        placed, radii = self._placed.get(identity), self._radii.get(identity)
        if placed is None or radii is None:
            return
        place, growth_m = placed.place, placed.rounding_m + radii.speed_bound_m_s * placed.place.age_s
        threat = ThreatEntry(
            id=identity,
            north_m=place.north_m,
            east_m=place.east_m,
            detection_radius_m=radii.detection_radius_m + growth_m,
            attack_radius_m=radii.attack_radius_m + growth_m,
            speed_bound_m_s=radii.speed_bound_m_s,
        )
        self._threats[identity] = (threat, placed.heard)
        if radii.floor_m is not None or radii.ceiling_m is not None:
            self._bands[identity] = BandEntry(identity, radii.floor_m, radii.ceiling_m)

    def _take_origin(self, origin_deg: tuple[float, float]) -> None:
        self._origin_told = True
        if self.origin_deg != origin_deg:
            self._forget_all()
            self.origin_deg = origin_deg

    def _accept_part(self, stamp: Stamp, now_s: float) -> bool:
        """Return whether a state or fleet frame is new, and count it among the parts of its broadcast."""
        if not self._accept(stamp, now_s):
            return False
        if stamp.sequence > self.sequence:
            self._parts = set()
        elif stamp.frame_index in self._parts:
            self.rejected["repeated"] += 1
            return False
        self.sequence = stamp.sequence
        self._parts.add(stamp.frame_index)
        self._received_s = now_s
        return True

    def _accept_beside(self, stamp: Stamp, now_s: float) -> bool:
        """Return whether a frame that tells what does not change is of the newest epoch, or begins one."""
        if stamp.epoch_s == self.epoch_s:
            return True
        if not self._accept(stamp, now_s):
            return False
        self._received_s = now_s
        return True

    def _accept(self, stamp: Stamp, now_s: float) -> bool:
        if self.epoch_s is not None and now_s - self._received_s < RESTART_AFTER_S:
            if stamp.epoch_s < self.epoch_s:
                self.rejected["old epoch"] += 1
                return False
            if stamp.epoch_s == self.epoch_s and stamp.sequence < self.sequence:
                self.rejected["old"] += 1
                return False
        if stamp.epoch_s == self.epoch_s and stamp.sequence >= self.sequence:
            return True
        self.epoch_s = stamp.epoch_s
        self.sequence = -1
        self._parts = set()
        self._motion_order = self._bands_order = (-1, -1)
        self._bands.clear()
        self._placed.clear()
        self._radii.clear()
        self._waiting.clear()
        self._origin_told = False
        return True

    def _forget_absent(self) -> None:
        newest = (self.epoch_s, self.sequence)
        for identity in [key for key, placed in self._placed.items() if placed.heard.broadcast != newest]:
            del self._placed[identity]
        for known in (self._agents, self._targets, self._threats):
            for identity in [key for key, (_, heard) in known.items() if heard.broadcast != newest]:
                # A threat whose new radii are still to come is believed where and as large as it was before.
                if known is not self._threats or identity not in self._placed:
                    del known[identity]
        self._forget_loose_ends()

    def _forget_mission(self) -> None:
        """Forget what was heard in the epochs that told of the last mission."""
        gone = self._mission_epochs
        self._placed = {key: placed for key, placed in self._placed.items() if placed.heard.broadcast[0] not in gone}
        for known in (self._agents, self._targets, self._threats):
            for identity in [key for key, (_, heard) in known.items() if heard.broadcast[0] in gone]:
                del known[identity]
        self._mission_epochs = set()
        self._forget_loose_ends()
        self._cached = None

    def _forget_loose_ends(self) -> None:
        """Forget what was told of things that are not known any more."""
        for velocities, things in ((self._velocities, self._agents), (self._threat_velocities, self._threats)):
            for identity in velocities.keys() - things.keys():
                del velocities[identity]
        for identity in self._bands.keys() - self._threats.keys():
            del self._bands[identity]
        if self.agent_id not in self._agents:
            self.target_id = None

    def _forget_all(self) -> None:
        for known in (self._agents, self._targets, self._threats, self._velocities, self._threat_velocities):
            known.clear()
        self._bands.clear()
        self._placed.clear()
        self.target_id = None
        self._cached = None


def _floor_m(band: BandEntry | None) -> float:
    return -math.inf if band is None or band.floor_m is None else band.floor_m


def _ceiling_m(band: BandEntry | None) -> float:
    return math.inf if band is None or band.ceiling_m is None else band.ceiling_m


def _reaching(threats: _ThreatTable, low_m: float, high_m: float) -> _ThreatTable:
    """Return the threats that may reach a height between two; unless that is known not to be, they do."""
    kept = ~((threats.ceiling_m < low_m) | (threats.floor_m > high_m))
    if kept.all():
        return threats
    return _ThreatTable(**{part.name: getattr(threats, part.name)[kept] for part in fields(threats)})
