"""The ground station's picture of the world: one track per agent, target and threat, with ages.

It begins with what the mission says and lives on the detections of a sensor. An agent not detected for `lost_after_s`
is lost (METHOD.md section 1 item 7, Case I); one that comes within the arrival radius of a target completes it, and
both leave the problem. Times are Unix seconds given by the caller.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.geodesy import LocalFrame
from companion.mission import Mission
from companion.wire import DetectionsFrame, Kind


@dataclass(frozen=True)
class Track:
    """Where a thing was last seen and how it moved."""

    north_m: float
    east_m: float
    velocity_north_m_s: float
    velocity_east_m_s: float
    seen_at_s: float

    @property
    def position_ned_m(self) -> tuple[float, float]:
        """(north, east) where it was seen."""
        return self.north_m, self.east_m

    def age_s(self, now_s: float) -> float:
        """Return how long ago that was."""
        return max(0.0, now_s - self.seen_at_s)


class GroundPicture:
    """Tracks by kind and id, and what has become of agents and targets."""

    def __init__(self, mission: Mission, now_s: float, sensed: bool) -> None:
        """Begin with a resolved mission's positions; without a sensor (`sensed` false) nobody can be known lost."""
        self._mission = mission
        self._frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        self._sensed = sensed
        self.tracks: dict[tuple[Kind, int], Track] = {}
        for kind, items in (
            (Kind.AGENT, mission.agents),
            (Kind.TARGET, mission.targets),
            (Kind.THREAT, mission.threats),
        ):
            for item in items:
                self.tracks[kind, item.id] = Track(*item.position_ned_m, 0.0, 0.0, now_s)
        self.arrived: set[int] = set()
        self.lost: set[int] = set()
        self.completed: set[int] = set()

    @property
    def active_agents(self) -> list[int]:
        """Agents still on their way, in file order."""
        return [agent.id for agent in self._mission.agents if agent.id not in self.arrived | self.lost]

    @property
    def present_agents(self) -> list[int]:
        """Agents in the air as far as is known: on their way or arrived."""
        return [agent.id for agent in self._mission.agents if agent.id not in self.lost]

    @property
    def open_targets(self) -> list[int]:
        """Targets not reached yet, in file order."""
        return [target.id for target in self._mission.targets if target.id not in self.completed]

    def take(self, frame: DetectionsFrame, now_s: float) -> None:
        """Merge one look of a sensor; detections of unknown things, and older ones than the track, are ignored."""
        seen_at_s = min(now_s, frame.unix_s)
        same_plane = (frame.origin_lat_deg, frame.origin_lon_deg) == (self._frame.lat_deg, self._frame.lon_deg)
        sensor_frame = None if same_plane else LocalFrame(frame.origin_lat_deg, frame.origin_lon_deg)
        for detection in frame.detections:
            key = (detection.kind, detection.id)
            track = self.tracks.get(key)
            if track is None or seen_at_s < track.seen_at_s:
                continue
            north_m, east_m = detection.north_m, detection.east_m
            if sensor_frame is not None:
                north_m, east_m = self._frame.to_local(*sensor_frame.to_global(north_m, east_m))
            self.tracks[key] = Track(
                north_m, east_m, detection.velocity_north_m_s, detection.velocity_east_m_s, seen_at_s
            )

    def update(self, now_s: float) -> bool:
        """Find who is lost and who has arrived by `now_s`; return whether anything changed."""
        before = (set(self.arrived), set(self.lost), set(self.completed))
        if self._sensed:
            self.lost = {
                agent.id
                for agent in self._mission.agents
                if self.tracks[Kind.AGENT, agent.id].age_s(now_s) > self._mission.lost_after_s
            }
        for target_id in self.open_targets:
            target = self.tracks[Kind.TARGET, target_id]
            for agent_id in self.active_agents:
                agent = self.tracks[Kind.AGENT, agent_id]
                if math.dist(agent.position_ned_m, target.position_ned_m) <= self._mission.arrival_radius_m:
                    self.arrived.add(agent_id)
                    self.completed.add(target_id)
        return before != (self.arrived, self.lost, self.completed)
