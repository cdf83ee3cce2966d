"""Assignment of targets to agents from the present tracks.

The inputs of an assignment are gathered here: the agents and targets that take part, the pairs within range and the
threats in between. The assignment problems themselves are solved in assignment.py, by the straight distance, and in
route_cost.py, by the paths around the threats.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from companion.geo.kinematics import turn_rate_rad_s
from companion.mission.model import AgentSpec, Mission, agent_height_m
from companion.mission.values import RANGE_RESERVE
from companion.protocol.codec import Kind
from groundstation.assignment import SWITCHING_SHARE, assign, within_range
from groundstation.broadcast import MOVING_M_S, grown
from groundstation.route_cost import AssignmentRule, RouteCosts, Scene, assign_by_route_cost
from groundstation.track import Track
from groundstation.tracks import TrackTable


@dataclass(frozen=True)
class TargetAssignment:
    """Targets assigned to agents, and the targets that no agent is assigned to."""

    targets: Mapping[int, int] = field(default_factory=dict)
    """Id of the target by agent id; an agent without a target is not in it."""
    uncovered: tuple[int, ...] = ()
    """Ids of the targets without an agent, because none is left or none can arrive there."""


def assign_targets(
    mission: Mission,
    tracks: TrackTable,
    present: Mapping[int, int],  # agent id -> target id
    now_s: float,
    pins: Mapping[int, int] = MappingProxyType({}),  # agent id -> target id
) -> TargetAssignment:
    """Return the assignment of the agents on their way to the targets not reached yet.

    `present` is the assignment until now, which is changed only where that saves enough (assignment.py). An agent in
    `pins` goes to its target as long as that is open; the others cover the rest. With the mission's `queue` those that
    have arrived take part as far as there are targets for them.
    """
    targets = tracks.open_targets
    waiting = tracks.idle_agents if mission.queue else []
    able = [*tracks.active_agents, *waiting]
    pinned = {agent: pins[agent] for agent in able if pins.get(agent) in targets}
    free = [agent for agent in tracks.active_agents if agent not in pinned]
    left = [target for target in targets if target not in pinned.values()]
    # Who has arrived goes on to what would stay without an agent, never as one more to where another one goes.
    if len(left) > len(free):
        free += [agent for agent in waiting if agent not in pinned]
    assigned = _assigned(mission, tracks, free, left or targets, present, now_s) | pinned
    for agent in waiting:
        sent_to = assigned.get(agent)
        if sent_to is not None and agent not in pinned and list(assigned.values()).count(sent_to) > 1:
            del assigned[agent]
    covered = set(assigned.values())
    return TargetAssignment(assigned, tuple(target for target in targets if target not in covered))


def out_of_reach(mission: Mission, tracks: TrackTable, targets: Sequence[int]) -> tuple[int, ...]:
    """Return which of some targets no agent that is left may be sent to, now or after others, as far as ranges go."""
    left = {*tracks.active_agents, *tracks.idle_agents}
    problem = _Problem(mission, tracks, [agent for agent in mission.agents if agent.id in left], targets)
    reached: np.ndarray = np.any(problem.in_range(), axis=0)
    return tuple(target for target, is_reached in zip(targets, reached, strict=True) if not is_reached)


def _assigned(
    mission: Mission,
    tracks: TrackTable,
    agents: Sequence[int],
    targets: Sequence[int],
    present: Mapping[int, int],
    now_s: float,
) -> dict[int, int]:
    """Return the target of each of some agents, by id, where there is one."""
    specs = {agent.id: agent for agent in mission.agents}
    chosen = _Problem(mission, tracks, [specs[identity] for identity in agents], targets).solve(present, now_s)
    return {agent: targets[index] for agent, index in zip(agents, chosen, strict=True) if index >= 0}


@dataclass(frozen=True)
class _Problem:
    """The assignment problem of the agents on their way and the targets not reached yet."""

    mission: Mission
    tracks: TrackTable
    agents: Sequence[AgentSpec]
    targets: Sequence[int]

    def solve(self, present: Mapping[int, int], now_s: float) -> np.ndarray:  # (N,) index of a target, -1 for none
        """Return the target of each agent by the mission's objective."""
        mission = self.mission
        agents_ned_m = self._positions(Kind.AGENT, [agent.id for agent in self.agents])
        targets_ned_m = self._positions(Kind.TARGET, self.targets)
        places = {target: index for index, target in enumerate(self.targets)}
        held = np.array([places.get(present.get(agent.id, 0), -1) for agent in self.agents], dtype=int)
        share = mission.switching_share
        if mission.objective == "distance" or mission.objective == "inverse-distance":
            return assign(agents_ned_m, targets_ned_m, mission.objective, self.in_range(), held, share or 0.0)
        rule = AssignmentRule(mission.objective, SWITCHING_SHARE if share is None else share)
        speeds_m_s = np.array([agent.speed_m_s for agent in self.agents])
        costs = RouteCosts(self._scene(agents_ned_m, targets_ned_m, now_s))
        return assign_by_route_cost(costs, speeds_m_s, rule, self.in_range, held)

    def in_range(self, there_m: np.ndarray | None = None) -> np.ndarray:  # (N, K) m -> (N, K) bool
        """Return which agent may be sent to which target and has the range for it; None: by the straight way."""
        agents_ned_m = self._positions(Kind.AGENT, [agent.id for agent in self.agents])
        targets_ned_m = self._positions(Kind.TARGET, self.targets)
        left_m = np.array([agent.range_m - self.tracks.flown_m[agent.id] for agent in self.agents])
        homes_ned_m = np.array([agent.position_ned_m for agent in self.agents]).reshape(-1, 2)
        homes = homes_ned_m if self.mission.range_policy == "return" else None
        within = within_range(agents_ned_m, targets_ned_m, left_m, homes, RANGE_RESERVE, there_m)
        allowed: np.ndarray = self._allowed() & within
        return allowed

    def _allowed(self) -> np.ndarray:  # (N, K) bool
        """Return which agent may be sent to which target: an agent with `only_target` goes to no other."""
        kept_for = [agent.only_target for agent in self.agents]
        allowed = np.array([[only in (None, target) for target in self.targets] for only in kept_for], dtype=bool)
        return allowed.reshape(len(self.agents), len(self.targets))

    def _scene(
        self,
        agents_ned_m: np.ndarray,  # (N, 2) m
        targets_ned_m: np.ndarray,  # (K, 2) m
        now_s: float,
    ) -> Scene:
        """Return the scene for the route costs, with the threats' discs as they are broadcast."""
        mission, tracks = self.mission, self.tracks.tracks
        discs = [grown(threat, tracks[Kind.THREAT, threat.id], now_s) for threat in mission.threats]
        floors_m = np.array([-np.inf if threat.floor_m is None else threat.floor_m for threat in mission.threats])
        ceilings_m = np.array([np.inf if threat.ceiling_m is None else threat.ceiling_m for threat in mission.threats])
        heights_m = [agent_height_m(mission, agent.id) for agent in self.agents]
        levels_m = np.array([mission.origin.alt_m + height_m for height_m in heights_m])[:, np.newaxis]
        return Scene(
            agents_ned_m=agents_ned_m,
            headings_rad=np.array([_heading_rad(tracks[Kind.AGENT, agent.id]) for agent in self.agents]),
            turn_radii_m=np.array([_turn_radius_m(agent) for agent in self.agents]),
            targets_ned_m=targets_ned_m,
            centres_ned_m=np.array([(disc.north_m, disc.east_m) for disc in discs]).reshape(-1, 2),
            radii_m=np.array([disc.detection_radius_m for disc in discs]),
            obstructs=(floors_m <= levels_m) & (levels_m <= ceilings_m),
        )

    def _positions(self, kind: Kind, ids: Sequence[int]) -> np.ndarray:  # (len(ids), 2) m
        return np.array([self.tracks.tracks[kind, identity].position_ned_m for identity in ids]).reshape(-1, 2)


def _heading_rad(track: Track) -> float:
    """Return an agent's heading, nan if its track moves slower than MOVING_M_S or has not been seen to move."""
    speed_m_s = math.hypot(track.velocity_north_m_s, track.velocity_east_m_s)
    return math.atan2(track.velocity_east_m_s, track.velocity_north_m_s) if speed_m_s >= MOVING_M_S else math.nan


def _turn_radius_m(agent: AgentSpec) -> float:
    return agent.speed_m_s / turn_rate_rad_s(agent.speed_m_s, agent.n_max)
