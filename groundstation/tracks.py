"""The ground station's picture of the world: one track per agent, target and threat, with ages.

The tracks begin at the mission's positions and are updated by a sensor's detections; in Case II agents are not detected
but placed by dead reckoning. An agent without detection or report for too long is lost (docs/method.md section 1, point
7); one that comes within the arrival radius of a target completes it, and both leave the assignment. If an agent's
position is uncertain, it counts as arrived later, by the time that it takes to fly the uncertainty. Times are Unix
seconds given by the caller.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from companion.geo.local_frame import LocalFrame, to_grid
from companion.mission.extent import FARTHEST_M
from companion.mission.model import Mission
from companion.protocol.codec import DetectionsFrame, Kind, ReportFrame
from groundstation.agents import Estimate, Fix
from groundstation.track import Track, passed_at_m

STANDING_M = 1.0
"""Distance within which something that cannot move is detected where it is: a sensor's positions are rounded to 1 cm,
and one with another origin has another plane."""

_FASTEST = 2.0
"""Greatest ratio of the speed of a sighting's way to the agent's, which wind and errors of the sensor may explain."""


@dataclass(frozen=True)
class MissionProgress:
    """Arrived and lost agents and completed targets, by id."""

    arrived: frozenset[int] = frozenset()
    lost: frozenset[int] = frozenset()
    completed: frozenset[int] = frozenset()
    """Ids of the completed targets."""
    reached_by: Mapping[int, int] = field(default_factory=dict)
    """Id of the target that an arrived agent completed, by agent id."""
    near_since: Mapping[int, tuple[int, float]] = field(default_factory=dict)
    """Id of the target that an agent with an uncertain position came near, and the time of that, by agent id."""


class TrackTable:
    """Tracks by kind and id, and the progress of agents and targets."""

    def __init__(
        self, mission: Mission, now_s: float, silent_after_s: float | None, began_s: float | None = None
    ) -> None:
        """Begin with a resolved mission's positions, which were true at `began_s`, by default `now_s`.

        An agent without detection or report for `silent_after_s` is lost; None: agents are neither detected nor report,
        so that none ever counts as lost.
        """
        self._mission = mission
        self._frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        self._silent_after_s = silent_after_s
        self._agents = {agent.id: agent for agent in mission.agents}
        placed_at_s = now_s if began_s is None else min(began_s, now_s)
        self._standing = {
            (kind, item.id)
            for kind, items in ((Kind.TARGET, mission.targets), (Kind.THREAT, mission.threats))
            for item in items
            if item.speed_bound_m_s == 0.0
        }
        self.too_far = 0
        """Number of detections refused as farther away than FARTHEST_M."""
        self.tracks: dict[tuple[Kind, int], Track] = {}
        for kind, items in (
            (Kind.AGENT, mission.agents),
            (Kind.TARGET, mission.targets),
            (Kind.THREAT, mission.threats),
        ):
            for item in items:
                self.tracks[kind, item.id] = Track(*item.position_ned_m, 0.0, 0.0, placed_at_s)
        self.heard_at_s = {agent.id: now_s for agent in mission.agents}
        """Time at which each agent was last detected (Case I) or reported (Case II), by id."""
        self.flown_m = {agent.id: 0.0 for agent in mission.agents}
        self.uncertainty_m = {agent.id: 0.0 for agent in mission.agents}
        self.progress = MissionProgress()
        self._judged = dict(self.tracks)
        """The tracks as of the last update: arrivals are judged on the ways from there."""

    @property
    def active_agents(self) -> list[int]:
        """Ids of the agents still on their way, in file order."""
        gone = self.progress.arrived | self.progress.lost
        return [agent.id for agent in self._mission.agents if agent.id not in gone]

    @property
    def present_agents(self) -> list[int]:
        """Ids of the agents that are not lost: on their way or arrived."""
        return [agent.id for agent in self._mission.agents if agent.id not in self.progress.lost]

    @property
    def open_targets(self) -> list[int]:
        """Ids of the targets not reached yet, in file order."""
        return [target.id for target in self._mission.targets if target.id not in self.progress.completed]

    def take(self, frame: DetectionsFrame, now_s: float) -> None:
        """Merge one scan of a sensor; detections of unknown ids, and those older than the track, are ignored.

        Detections beyond FARTHEST_M are counted in `too_far` and ignored.
        """
        seen_at_s = min(now_s, frame.unix_s)
        same_plane = (frame.origin_lat_deg, frame.origin_lon_deg) == (self._frame.lat_deg, self._frame.lon_deg)
        sensor_frame = None if same_plane else LocalFrame(frame.origin_lat_deg, frame.origin_lon_deg)
        for detection in frame.detections:
            key = (detection.kind, detection.id)
            track = self.tracks.get(key)
            if track is None or seen_at_s < track.seen_at_s:
                continue
            if detection.kind is Kind.AGENT and self._mission.case == "II":
                continue  # agents are dead-reckoned, and a stray detection of one is ignored
            north_m, east_m = detection.north_m, detection.east_m
            # Tested before the conversion too, which would map a farther point to another place on the Earth.
            is_near = math.hypot(north_m, east_m) <= FARTHEST_M
            if is_near and sensor_frame is not None:
                north_m, east_m = self._frame.to_local(*sensor_frame.to_global(north_m, east_m))
                is_near = math.hypot(north_m, east_m) <= FARTHEST_M
            if not is_near:
                self.too_far += 1
                continue
            if key in self._standing and math.dist(track.position_ned_m, (north_m, east_m)) <= STANDING_M:
                north_m, east_m = track.position_ned_m
            if detection.kind is Kind.AGENT:
                self.flown_m[detection.id] += math.dist(track.position_ned_m, (north_m, east_m))
                self.heard_at_s[detection.id] = seen_at_s
            self.tracks[key] = Track(
                north_m, east_m, detection.velocity_north_m_s, detection.velocity_east_m_s, seen_at_s
            )

    def place(self, agent_id: int, estimate: Estimate, now_s: float) -> None:
        """Set an agent's track to its dead-reckoned state (Case II)."""
        self.tracks[Kind.AGENT, agent_id] = Track(
            estimate.north_m,
            estimate.east_m,
            estimate.speed_m_s * math.cos(estimate.heading_rad),
            estimate.speed_m_s * math.sin(estimate.heading_rad),
            now_s,
        )
        self.flown_m[agent_id] = estimate.flown_m
        self.uncertainty_m[agent_id] = estimate.uncertainty_m

    def take_report(self, report: ReportFrame, now_s: float) -> Fix | None:
        """Note that an agent reported and return its fix; None if its id is unknown or the report is an old one."""
        heard_at_s = self.heard_at_s.get(report.agent_id)
        fixed_at_s = min(now_s, report.unix_s)
        if heard_at_s is None or fixed_at_s < heard_at_s:
            return None
        self.heard_at_s[report.agent_id] = fixed_at_s
        north_m, east_m, convergence_rad = self._frame.to_local_with_convergence(report.lat_deg, report.lon_deg)
        velocity_m_s = to_grid(report.velocity_north_m_s, report.velocity_east_m_s, convergence_rad)
        return Fix((north_m, east_m), velocity_m_s, fixed_at_s, report.flown_m)

    def update(self, now_s: float, assignment: Mapping[int, int]) -> bool:
        """Update which agents are lost or have arrived by `now_s`; return whether anything changed.

        `assignment` is target id by agent id: an agent whose position is uncertain arrives only at its assigned target.
        """
        before = self.progress
        if self._silent_after_s is not None:
            silent = (key for key, at_s in self.heard_at_s.items() if now_s - at_s > self._silent_after_s)
            self.progress = replace(before, lost=frozenset(silent))
        self.progress = self._after_arrivals(now_s, assignment)
        self._judged = dict(self.tracks)
        after = self.progress
        return (before.arrived, before.lost, before.completed) != (after.arrived, after.lost, after.completed)

    def _after_arrivals(self, now_s: float, assignment: Mapping[int, int]) -> MissionProgress:
        """Return the progress with the arrivals of the agents that are near enough to a target, for long enough."""
        progress = self.progress
        arrived, completed = set(progress.arrived), set(progress.completed)
        reached_by = dict(progress.reached_by)
        near_since = {key: near for key, near in progress.near_since.items() if assignment.get(key) == near[0]}
        for target_id, agent_id in self._candidates(assignment):
            if agent_id in arrived or self._agents[agent_id].only_target not in (None, target_id):
                continue
            is_near = self._came_near(agent_id, target_id)
            wait_s = self.uncertainty_m[agent_id] / self._agents[agent_id].speed_m_s
            if wait_s != 0.0:
                if assignment.get(agent_id) != target_id:
                    continue
                # Once near, it loiters there by its own position; by ours it need not stay near.
                if is_near:
                    near_since.setdefault(agent_id, (target_id, now_s))
                is_near = agent_id in near_since and now_s - near_since[agent_id][1] >= wait_s
            if is_near:
                arrived.add(agent_id)
                completed.add(target_id)
                if target_id not in reached_by.values():
                    reached_by[agent_id] = target_id
        return MissionProgress(frozenset(arrived), progress.lost, frozenset(completed), reached_by, near_since)

    def _came_near(self, agent_id: int, target_id: int) -> bool:
        """Return whether an agent is within the arrival radius of a target, or was since the last update."""
        agent, target = self.tracks[Kind.AGENT, agent_id], self.tracks[Kind.TARGET, target_id]
        radius_m = self._mission.arrival_radius_m
        if math.dist(agent.position_ned_m, target.position_ned_m) <= radius_m:
            return True
        before = self._judged[Kind.AGENT, agent_id]
        flown_m = math.dist(before.position_ned_m, agent.position_ned_m)
        lasts_s = agent.seen_at_s - before.seen_at_s
        # A sighting that no flight explains is no way along which targets are reached.
        if flown_m == 0.0 or flown_m > _FASTEST * self._agents[agent_id].speed_m_s * lasts_s:
            return False
        return passed_at_m((before, agent), (self._judged[Kind.TARGET, target_id], target)) <= radius_m

    def _candidates(self, assignment: Mapping[int, int]) -> list[tuple[int, int]]:
        """Return the pairs (target id, agent id) that can have met: the agent is near the target or was sent to it."""
        agents, targets = self.active_agents, self.open_targets
        agents_ned_m = np.array([self.tracks[Kind.AGENT, one].position_ned_m for one in agents]).reshape(-1, 2)
        targets_ned_m = np.array([self.tracks[Kind.TARGET, one].position_ned_m for one in targets]).reshape(-1, 2)
        apart_m = targets_ned_m[:, np.newaxis] - agents_ned_m  # (K, N, 2)
        before_ned_m = np.array([self._judged[Kind.AGENT, one].position_ned_m for one in agents]).reshape(-1, 2)
        flown_m = np.hypot(*(agents_ned_m - before_ned_m).T)
        # More than the arrival radius and the way since the last update, so that only the exact test decides.
        reach_m = self._mission.arrival_radius_m * (1.0 + 1e-9) + _FASTEST * flown_m
        close = np.hypot(apart_m[..., 0], apart_m[..., 1]) <= reach_m
        sent = np.array(targets, dtype=int)[:, np.newaxis] == np.array([assignment.get(one, 0) for one in agents])
        return [(targets[row], agents[column]) for row, column in np.argwhere(close | sent)]
