"""What the vehicle believes: the newest of each thing heard, with ages.

State frames are self-contained, idempotent and newest-wins. A thing is forgotten only when a broadcast that was heard
whole no longer holds it; a threat not heard of again is never dropped, its disc only grows.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from companion.wire import AgentEntry, Directive, MotionFrame, Stamp, StateFrame, TargetEntry, ThreatEntry

RESTART_AFTER_S = 30.0
"""A lower epoch than the last is an old run replayed, unless nothing was heard for this long: a ground station whose
clock was set back."""


@dataclass(frozen=True)
class Heard:
    """When the things of one broadcast were true, by this vehicle's clock, and which broadcast it was."""

    true_at_s: float
    broadcast: tuple[int, int]
    """Epoch and sequence."""


@dataclass(frozen=True)
class View:
    """The picture at one moment, ready for the guidance law."""

    target_ned_m: tuple[float, float] | None
    target_age_s: float
    threats_ned_m: np.ndarray  # (M, 2) m, where each was last heard
    detection_radius_m: np.ndarray  # (M,) m, grown by what the threat may have moved since
    attack_radius_m: np.ndarray  # (M,) m, grown likewise
    threat_speed_m_s: np.ndarray  # (M,) m/s, bounds
    peers_ned_m: np.ndarray  # (P, 2) m, extrapolated to now
    settled_ned_m: np.ndarray  # (Q, 2) m, those of the peers whose loiter place goes before ours


@dataclass(frozen=True)
class _ThreatTable:
    """The threats as last heard, by rising id."""

    centres_ned_m: np.ndarray  # (M, 2) m
    detection_m: np.ndarray  # (M,) m
    attack_m: np.ndarray  # (M,) m
    speed_m_s: np.ndarray  # (M,) m/s, bounds
    true_at_s: np.ndarray  # (M,) s


@dataclass(frozen=True)
class _PeerTable:
    """The other agents as last heard, by rising id."""

    seen_ned_m: np.ndarray  # (P, 2) m
    velocity_m_s: np.ndarray  # (P, 2) m/s
    true_at_s: np.ndarray  # (P,) s
    settled: np.ndarray  # (P,) bool


class Picture:
    """Merges frames for one agent; all times are this vehicle's clock in seconds, given by the caller."""

    def __init__(self, agent_id: int, peer_memory_s: float = 30.0) -> None:
        self.agent_id = agent_id
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
        self._parts: set[int] = set()
        self._motion_order = (-1, -1)
        self._cached: tuple[_ThreatTable, _PeerTable] | None = None

    def age_s(self, now_s: float) -> float | None:
        """Return the age of the newest state heard, None if none ever was."""
        return None if self._state_true_at_s is None else max(0.0, now_s - self._state_true_at_s)

    def take_state(self, frame: StateFrame, now_s: float) -> bool:
        """Merge a state frame received at `now_s`; return whether it was new."""
        if not self._accept(frame.stamp, now_s):
            return False
        if frame.stamp.sequence > self.sequence:
            self._parts = set()
        elif frame.stamp.frame_index in self._parts:
            self.rejected["repeated"] += 1
            return False
        origin_deg = (frame.origin_lat_deg, frame.origin_lon_deg)
        if self.origin_deg != origin_deg:
            self._forget_all()
            self.origin_deg = origin_deg
        self.sequence = frame.stamp.sequence
        self._parts.add(frame.stamp.frame_index)
        # A sender's clock behind ours means an old frame; ahead of ours, only the time of receipt can be believed.
        true_at_s = min(now_s, frame.stamp.unix_s)
        heard = Heard(true_at_s, (frame.stamp.epoch_s, frame.stamp.sequence))
        self._received_s = now_s
        self._state_true_at_s = true_at_s
        self.directive = frame.directive
        for agent in frame.agents:
            self._agents[agent.id] = (agent, heard)
            if agent.id == self.agent_id:
                self.target_id = agent.target_id
        for target in frame.targets:
            self._targets[target.id] = (target, heard)
        for threat in frame.threats:
            self._threats[threat.id] = (threat, heard)
        if len(self._parts) == frame.stamp.frame_count:
            self._forget_absent()
        self._cached = None
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
        return True

    def view(self, now_s: float) -> View:
        """Return the picture as it must be believed at `now_s`."""
        if self._cached is None:
            self._cached = (self._threat_table(), self._peer_table())
        threats, peers = self._cached
        growth_m = threats.speed_m_s * np.maximum(0.0, now_s - threats.true_at_s)
        age_s = np.maximum(0.0, now_s - peers.true_at_s)
        peers_ned_m = peers.seen_ned_m + peers.velocity_m_s * age_s[:, None]
        remembered = age_s <= self.peer_memory_s
        assigned = None if self.target_id is None else self._targets.get(self.target_id)
        return View(
            target_ned_m=None if assigned is None else (assigned[0].north_m, assigned[0].east_m),
            target_age_s=math.inf if assigned is None else max(0.0, now_s - assigned[1].true_at_s),
            threats_ned_m=threats.centres_ned_m,
            detection_radius_m=threats.detection_m + growth_m,
            attack_radius_m=threats.attack_m + growth_m,
            threat_speed_m_s=threats.speed_m_s,
            peers_ned_m=peers_ned_m[remembered],
            settled_ned_m=peers_ned_m[remembered & peers.settled],
        )

    def _threat_table(self) -> _ThreatTable:
        entries = [self._threats[identity] for identity in sorted(self._threats)]
        return _ThreatTable(
            centres_ned_m=np.array([(threat.north_m, threat.east_m) for threat, _ in entries]).reshape(-1, 2),
            detection_m=np.array([threat.detection_radius_m for threat, _ in entries]),
            attack_m=np.array([threat.attack_radius_m for threat, _ in entries]),
            speed_m_s=np.array([threat.speed_bound_m_s for threat, _ in entries]),
            true_at_s=np.array([heard.true_at_s for _, heard in entries]),
        )

    def _peer_table(self) -> _PeerTable:
        ids = sorted(self._agents.keys() - {self.agent_id})
        entries = [self._agents[identity] for identity in ids]
        velocities = [self._velocities.get(identity, (0.0, 0.0)) for identity in ids]
        # Of two that arrive together the lower id stays where it is: both know this without a word.
        settled = [agent.target_id is None or agent.id < self.agent_id for agent, _ in entries]
        return _PeerTable(
            seen_ned_m=np.array([(agent.north_m, agent.east_m) for agent, _ in entries]).reshape(-1, 2),
            velocity_m_s=np.array(velocities).reshape(-1, 2),
            true_at_s=np.array([heard.true_at_s for _, heard in entries]),
            settled=np.array(settled, dtype=bool),
        )

    def _accept(self, stamp: Stamp, now_s: float) -> bool:
        if self.epoch_s is not None and stamp.epoch_s < self.epoch_s and now_s - self._received_s < RESTART_AFTER_S:
            self.rejected["old epoch"] += 1
            return False
        if stamp.epoch_s == self.epoch_s:
            if stamp.sequence < self.sequence:
                self.rejected["old"] += 1
                return False
            return True
        self.epoch_s = stamp.epoch_s
        self.sequence = -1
        self._parts = set()
        self._motion_order = (-1, -1)
        return True

    def _forget_absent(self) -> None:
        newest = (self.epoch_s, self.sequence)
        for known in (self._agents, self._targets, self._threats):
            for identity in [key for key, (_, heard) in known.items() if heard.broadcast != newest]:
                del known[identity]
        for identity in self._velocities.keys() - self._agents.keys():
            del self._velocities[identity]
        if self.agent_id not in self._agents:
            self.target_id = None

    def _forget_all(self) -> None:
        for known in (self._agents, self._targets, self._threats, self._velocities):
            known.clear()
        self.target_id = None
