"""The ground station's picture of the world: one track per agent, target and threat, with ages.

The tracks begin at the mission's positions and are updated by a sensor's detections, as far as these can be true
(sightings.py), and by live sources, which judge theirs themselves; in Case II agents that nobody sees are placed by
dead reckoning. An agent without detection or report for too long is lost (docs/method.md section 1, point 7); one that
comes within the arrival radius of a target completes it, and both leave the assignment (progress.py). If an agent's
position is uncertain, it counts as arrived later, by the time that it takes to fly the uncertainty. Times are Unix
seconds given by the caller.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

import numpy as np

from companion.geo.local_frame import LocalFrame, to_grid
from companion.mission.extent import FARTHEST_M, Point
from companion.mission.model import AgentSpec, Mission, TargetSpec, ThreatSpec
from companion.protocol.codec import Detection, DetectionsFrame, Kind, ReportFrame
from groundstation.agents import Estimate, Fix
from groundstation.operations import Operations
from groundstation.origins import LAST_RUN, MISSION, REPORT, SENSOR, Observation, Origins, Stranger
from groundstation.places import Places
from groundstation.plausibility import SENSOR_ERROR_M, Bound, Sample, Verdict
from groundstation.progress import Arrival, MissionProgress, cannot_have_arrived, disproved, first_at
from groundstation.refusals import Refusals
from groundstation.sightings import Key, Sightings, places_in
from groundstation.track import Track, passed_at_m

TOO_FAR = "too far"
"""Cause of refusals of detections that are farther away than FARTHEST_M."""
_ROUNDED_M_S = 0.02
"""Speed by which a velocity may exceed its bound because it was sent in whole cm/s."""
ROUNDED_M = 0.02
"""Greatest distance by which a place in a picture is off because it is rounded."""
_ERRORS = 2.0
"""Greatest ratio to a sighting's error of what the errors of two sightings, before and now, add to a way."""
_FASTEST = 2.0
"""Greatest ratio of the speed of a sighting's way to the agent's, which wind and errors of the sensor may explain."""


class TrackTable:
    """Tracks by kind and id, and the progress of agents and targets."""

    def __init__(
        self,
        mission: Mission,
        now_s: float,
        silent_after_s: float | None,
        began_s: float | None = None,
        sensor_error_m: float = SENSOR_ERROR_M,
    ) -> None:
        """Begin with a resolved mission's positions, which were true at `began_s`, by default `now_s`.

        An agent without detection or report for `silent_after_s` is lost; None: agents are neither detected nor report,
        so that none ever counts as lost. `sensor_error_m` is the greatest error of a detection.
        """
        self._mission = mission
        self._frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        self._silent_after_s = silent_after_s
        placed_at_s = now_s if began_s is None else min(began_s, now_s)
        self._sightings = Sightings(mission, placed_at_s, now_s, sensor_error_m)
        self.tracks = {key: Track(*place_ned_m, 0.0, 0.0, placed_at_s) for key, place_ned_m in places_in(mission)}
        self.heard_at_s = {agent.id: now_s for agent in mission.agents}
        """Time at which each agent was last detected (Case I) or reported (Case II), by id."""
        self.flown_m = {agent.id: 0.0 for agent in mission.agents}
        self.uncertainty_m = {agent.id: 0.0 for agent in mission.agents}
        self.progress = MissionProgress()
        self.origins = Origins()
        """Who has seen things where they are."""
        self._told = self.progress
        """The progress as of the last update."""
        self._judged = dict(self.tracks)
        """The tracks as of the last update: arrivals are judged on the ways from there."""

    @property
    def mission(self) -> Mission:
        """The mission that is followed."""
        return self._mission

    @property
    def clock_ahead_s(self) -> float:
        """Time by which the clock that stamps frames is ahead of the times given; see groundstation/clock.py."""
        return self._sightings.ahead_s

    @clock_ahead_s.setter
    def clock_ahead_s(self, ahead_s: float) -> None:
        self._sightings.ahead_s = ahead_s

    @property
    def refusals(self) -> Refusals:
        """Sightings and reports that were not believed."""
        return self._sightings.refusals

    @property
    def active_agents(self) -> list[int]:
        """Ids of the agents still on their way, in file order."""
        gone = self.progress.arrived | self.progress.lost | self.progress.out
        return [agent.id for agent in self._mission.agents if agent.id not in gone]

    @property
    def present_agents(self) -> list[int]:
        """Ids of the agents that are not lost: on their way or arrived."""
        return [agent.id for agent in self._mission.agents if agent.id not in self.progress.lost]

    @property
    def open_targets(self) -> list[int]:
        """Ids of the targets not reached yet, in file order."""
        return [target.id for target in self._mission.targets if target.id not in self.progress.completed]

    @property
    def idle_agents(self) -> list[int]:
        """Ids of the agents that have arrived and may be sent on to another target, in file order."""
        gone = self.progress.lost | self.progress.out
        return [one.id for one in self._mission.agents if one.id in self.progress.arrived and one.id not in gone]

    def told_agents(self, now_s: float) -> list[int]:
        """Return the ids of the agents whose positions are told: in Case II of those that somebody sees."""
        if self._mission.case == "I":
            return self.present_agents
        return [agent_id for agent_id in self.present_agents if self.origins.is_seen(agent_id, now_s)]

    def observe(self, seen: Observation) -> bool:
        """Move a thing to where a live source has it; return whether that is news of a thing that is there."""
        key = seen.kind, seen.id
        track = self.tracks.get(key)
        if track is None or seen.at_s < track.seen_at_s:
            return False
        bound = self._sightings.bound(key)
        lasts_s = seen.at_s - track.seen_at_s
        before, reach_m = complex(*track.position_ned_m), bound.speed_m_s * lasts_s
        moved_m = abs(seen.place - before)
        if bound.stands and moved_m <= seen.error_m:
            # What stands is not moved about by the errors of its source.
            self.tracks[key] = replace(track, seen_at_s=seen.at_s)
        else:
            velocity = _bounded(seen.velocity, bound)
            place = seen.place
            beyond_m = moved_m - reach_m
            if seen.kind is Kind.THREAT and not bound.stands and beyond_m > 0.0:
                # Vehicles take it to move as far as its bound allows, so that what errors add to its way is left out.
                if beyond_m > _ERRORS * seen.error_m:
                    self.origins.jumps += 1
                else:
                    place = before + (place - before) * (reach_m / moved_m)
            self.tracks[key] = Track(place.real, place.imag, velocity.real, velocity.imag, seen.at_s)
        if seen.kind is Kind.AGENT:
            # The errors of places that come ten times a second are no way flown.
            way_m = abs(seen.velocity) * lasts_s if seen.velocity else moved_m
            self.flown_m[seen.id] += min(way_m, reach_m)
            self.uncertainty_m[seen.id] = 0.0
            self.heard_at_s[seen.id] = max(self.heard_at_s[seen.id], seen.at_s)
        self._sightings.begin(key, self.tracks[key].position_ned_m, seen.at_s, seen.at_s)
        self.origins.note(key, seen.source, seen.at_s, seen.error_m)
        return True

    def follow(self, mission: Mission, placed_s: Mapping[Key, float], anew: Collection[Key], now_s: float) -> None:
        """Follow a mission whose targets and threats have changed.

        A thing that is new, or in `anew` as one that was placed, begins at its place, where it was at its time in
        `placed_s`, by default now.
        """
        before, self._mission = self._mission, mission
        known = {(kind, thing.id): thing for kind, thing in _things_of(before)}
        now = {(kind, thing.id): thing for kind, thing in _things_of(mission)}
        for key in known.keys() - now.keys():
            self._sightings.end(key)
            self.origins.forget(key)
            del self.tracks[key], self._judged[key]
            if key[0] is Kind.TARGET:
                self.progress = self.progress.without_target(key[1])
        for key, thing in now.items():
            one = known.get(key)
            if thing is one:
                continue
            self._sightings.limit(key, thing.speed_bound_m_s)
            if one is None or key in anew or thing.position_ned_m != one.position_ned_m:
                self._begin(key, thing.position_ned_m, min(now_s, placed_s.get(key, now_s)), now_s)
            elif thing.speed_bound_m_s not in (0.0, one.speed_bound_m_s):
                # How far it may have come until now does not change by what it may do from now on.
                track = self.tracks[key]
                age_s = track.age_s(now_s) * one.speed_bound_m_s / thing.speed_bound_m_s
                self.tracks[key] = replace(track, seen_at_s=now_s - age_s)

    def resume(self, operations: Operations, places: Places | None, now_s: float) -> None:
        """Go on where the run before ended: with its progress, and with its places as far as they are known."""
        reached = operations.reached
        self.progress = self._told = MissionProgress(
            arrived=frozenset(reached.arrived),
            lost=reached.lost,
            completed=reached.completed,
            reached_by=first_at(reached.by),
            been_at=reached.by,
            out=operations.orders.away,
        )
        for agent_id in reached.lost:
            # Until it is heard.
            self.heard_at_s[agent_id] = -math.inf
        for key, placed_s in operations.placed_s.items():
            if key in self.tracks:
                self._begin(key, self.tracks[key].position_ned_m, min(placed_s, now_s), now_s)
        if places is None:
            return
        for key, track in places.tracks.items():
            # What a command has placed since then is there.
            if key in self.tracks and operations.placed_s.get(key, -math.inf) <= places.at_s:
                if key[0] is Kind.AGENT and self._mission.case == "I":
                    track = track.back_at(min(track.seen_at_s, places.known_at_s[key[1]]))
                self._continue(key, replace(track, seen_at_s=min(track.seen_at_s, now_s)), now_s)
                self.origins.by[key] = places.sources.get(key, LAST_RUN)
                if key[0] is Kind.AGENT and self.origins.by[key] == MISSION:
                    self.origins.forget(key)
        self._stay_silent(places, now_s)
        for agent in self._mission.agents:
            left_m = places.range_left_m.get(agent.id, agent.range_m)
            self.flown_m[agent.id] = max(0.0, agent.range_m - left_m)

    def _stay_silent(self, places: Places, now_s: float) -> None:
        """Let the agents that were silent when the run before ended have been so for as long now.

        The time in which nobody could hear them does not count, and who would be lost by that begins anew.
        """
        for agent_id, known_at_s in places.known_at_s.items():
            silent_s = max(0.0, places.at_s - known_at_s)
            is_present = agent_id in self.heard_at_s and agent_id not in self.progress.lost
            if is_present and self._silent_after_s is not None and silent_s < self._silent_after_s:
                self.heard_at_s[agent_id] = now_s - silent_s

    def _continue(self, key: Key, track: Track, now_s: float) -> None:
        """Go on with a track of the run before."""
        off_m = math.dist(track.position_ned_m, self.tracks[key].position_ned_m)
        if key[0] is not Kind.AGENT and self._sightings.bound(key).stands and 0.0 < off_m <= ROUNDED_M:
            # A picture is rounded; only what was found elsewhere is elsewhere.
            return
        self._sightings.begin(key, track.position_ned_m, track.seen_at_s, now_s)
        self.tracks[key] = self._judged[key] = track

    def _begin(self, key: Key, place_ned_m: Point, placed_at_s: float, now_s: float) -> None:
        """Begin a target's or threat's track where a command has put it."""
        self._sightings.begin(key, place_ned_m, placed_at_s, now_s)
        self.origins.forget(key)
        self.tracks[key] = Track(*place_ned_m, 0.0, 0.0, placed_at_s)
        self.origins.jumps += key[0] is Kind.THREAT
        self._begin_anew(key)

    def take(self, frame: DetectionsFrame, now_s: float, others: Collection[Key] = ()) -> None:
        """Merge one scan of a sensor, as far as it can be true; what cannot is counted in `refusals` by its cause.

        `others` are things whose ids are none of the sensor's: what it calls so is something else.
        """
        seen_at_s = self._sightings.time_of("sensor", frame.unix_s, now_s)
        if seen_at_s is None:
            return
        same_plane = (frame.origin_lat_deg, frame.origin_lon_deg) == (self._frame.lat_deg, self._frame.lon_deg)
        sensor_frame = None if same_plane else LocalFrame(frame.origin_lat_deg, frame.origin_lon_deg)
        for detection in frame.detections:
            place_ned_m = self._place_of(detection, sensor_frame)
            if place_ned_m is None:
                self.refusals.add(TOO_FAR, "sensor: {} detections refused as too far")
                continue
            key = (detection.kind, detection.id)
            if key not in self.tracks or key in others:
                velocity = complex(detection.velocity_north_m_s, detection.velocity_east_m_s)
                self.origins.meet(Stranger(key, complex(*place_ned_m), velocity, seen_at_s))
            if key in others:
                continue
            weighed = self._sightings.sighted(key, Sample(complex(*place_ned_m), seen_at_s), now_s)
            if weighed is not None and weighed.verdict is Verdict.BELIEVED:
                self._move(key, detection, place_ned_m, seen_at_s)
                if weighed.replaced:
                    self._begin_anew(key)
            if weighed is not None and weighed.verdict is Verdict.DISPUTED:
                self._hold(key)
            if weighed is not None and weighed.verdict in (Verdict.BELIEVED, Verdict.SUPPORT, Verdict.DISPUTED):
                if detection.kind is Kind.AGENT:
                    self.heard_at_s[detection.id] = max(self.heard_at_s[detection.id], seen_at_s)

    def _place_of(self, detection: Detection, sensor_frame: LocalFrame | None) -> Point | None:
        """Return the position (north, east) of a detection in m; None if that is farther than a frame can carry."""
        place_ned_m = detection.north_m, detection.east_m
        # Tested before the conversion too, which would map a farther point to another place on the Earth.
        if math.hypot(*place_ned_m) <= FARTHEST_M and sensor_frame is not None:
            place_ned_m = self._frame.to_local(*sensor_frame.to_global(*place_ned_m))
        return place_ned_m if math.hypot(*place_ned_m) <= FARTHEST_M else None

    def _move(self, key: Key, detection: Detection, place_ned_m: Point, seen_at_s: float) -> None:
        """Move a track to where the thing was seen, at no more than its greatest speed."""
        track, bound = self.tracks[key], self._sightings.bound(key)
        if bound.stands:
            place_ned_m = track.position_ned_m
        velocity = _bounded(complex(detection.velocity_north_m_s, detection.velocity_east_m_s), bound)
        self.origins.note(key, SENSOR, seen_at_s, bound.noise.error_m)
        if detection.kind is Kind.AGENT:
            self.uncertainty_m[detection.id] = 0.0
            flown_m = math.dist(track.position_ned_m, place_ned_m)
            self.flown_m[detection.id] += min(flown_m, bound.speed_m_s * max(0.0, seen_at_s - track.seen_at_s))
        self.tracks[key] = Track(*place_ned_m, velocity.real, velocity.imag, max(seen_at_s, track.seen_at_s))

    def _hold(self, key: Key) -> None:
        """Take a track whose place is disputed back to the last that was not, and let its age go on from there."""
        held = self._sightings.held(key)
        if held is None:
            return
        track = Track(held.place.real, held.place.imag, 0.0, 0.0, held.at_s)
        if track != self.tracks[key]:
            self.tracks[key] = track
            self._begin_anew(key, held.at_s)

    def excuse(self, silent_s: float) -> None:
        """Count no agent as silent for a time in which nobody could be heard."""
        self.heard_at_s = {agent_id: at_s + silent_s for agent_id, at_s in self.heard_at_s.items()}

    def place(self, agent_id: int, estimate: Estimate, now_s: float) -> None:
        """Set an agent's track to its dead-reckoned state (Case II)."""
        self.origins.forget((Kind.AGENT, agent_id))
        self.tracks[Kind.AGENT, agent_id] = Track(
            estimate.north_m,
            estimate.east_m,
            estimate.speed_m_s * math.cos(estimate.heading_rad),
            estimate.speed_m_s * math.sin(estimate.heading_rad),
            now_s,
        )
        self.flown_m[agent_id] = estimate.flown_m
        self.uncertainty_m[agent_id] = estimate.uncertainty_m

    def move_to(self, agent_id: int, fix: Fix) -> None:
        """Move an agent's track to where it reports to be, if nobody has seen it since (Case I)."""
        key = Kind.AGENT, agent_id
        if fix.fixed_at_s >= self.tracks[key].seen_at_s:
            self.tracks[key] = Track(*fix.position_ned_m, *fix.velocity_m_s, fix.fixed_at_s)
            self.uncertainty_m[agent_id] = 0.0
            self.flown_m[agent_id] = self.flown_m[agent_id] if fix.flown_m is None else fix.flown_m
            self.origins.note(key, REPORT, fix.fixed_at_s, SENSOR_ERROR_M)

    def fix_of(self, agent_id: int) -> Fix:
        """Return where and when an agent was last seen, and how far it has flown."""
        track = self.tracks[Kind.AGENT, agent_id]
        velocity_m_s = track.velocity_north_m_s, track.velocity_east_m_s
        return Fix(track.position_ned_m, velocity_m_s, track.seen_at_s, self.flown_m[agent_id])

    def take_report(self, report: ReportFrame, now_s: float) -> Fix | None:
        """Note that an agent reported and return its fix; None if that cannot be true, which `refusals` counts."""
        agent_id = report.agent_id
        fixed_at_s = self._sightings.time_of("uplink", report.unix_s, now_s)
        if fixed_at_s is None:
            return None
        north_m, east_m, convergence_rad = self._frame.to_local_with_convergence(report.lat_deg, report.lon_deg)
        reckoned = self._reckoned(agent_id, fixed_at_s)
        weighed = self._sightings.reported(agent_id, Sample(complex(north_m, east_m), fixed_at_s), *reckoned, now_s)
        if weighed is None or weighed.verdict not in (Verdict.BELIEVED, Verdict.SUPPORT):
            return None
        is_newest = weighed.verdict is Verdict.BELIEVED and fixed_at_s >= self.heard_at_s[agent_id]
        self.heard_at_s[agent_id] = max(self.heard_at_s[agent_id], fixed_at_s)
        if not is_newest:
            return None
        self.origins.report(agent_id, fixed_at_s)
        self._disprove((north_m, east_m), agent_id, fixed_at_s)
        velocity = _bounded(
            complex(*to_grid(report.velocity_north_m_s, report.velocity_east_m_s, convergence_rad)),
            self._sightings.bound((Kind.AGENT, agent_id)),
        )
        flown_m = self._sightings.flown(agent_id, report.flown_m, fixed_at_s, now_s)
        return Fix((north_m, east_m), (velocity.real, velocity.imag), fixed_at_s, flown_m)

    def _reckoned(self, agent_id: int, at_s: float) -> tuple[complex, float]:
        """Return where an agent is by its track at a time, and how uncertain that is; anything for an unknown one."""
        track = self.tracks.get((Kind.AGENT, agent_id))
        if track is None or self._mission.case == "I":
            return 0j, math.inf
        velocity = complex(track.velocity_north_m_s, track.velocity_east_m_s)
        since_s = at_s - track.seen_at_s
        return complex(*track.position_ned_m) + velocity * since_s, self.uncertainty_m[agent_id]

    def _disprove(self, place_ned_m: Point, agent_id: int, at_s: float) -> None:
        """Take back what an agent has reached, or come near to, where it cannot have been by its report."""
        bound = self._sightings.bound((Kind.AGENT, agent_id))

        def is_wrong(arrival: Arrival) -> bool:
            target = self.tracks[Kind.TARGET, arrival.target_id]
            return cannot_have_arrived(self._mission, arrival, target, place_ned_m, at_s, bound)

        arrival = self.progress.unproven.get(agent_id)
        if arrival is not None and is_wrong(arrival):
            self._take_back(agent_id, arrival)
        near = self.progress.near_since.get(agent_id)
        if near is not None and is_wrong(Arrival(*near, None)):
            others = {one: since for one, since in self.progress.near_since.items() if one != agent_id}
            self.progress = replace(self.progress, near_since=others)

    def _begin_anew(self, key: Key, since_s: float = -math.inf) -> None:
        """Forget the way to an agent's or a target's new place, and the arrivals that only its old place showed.

        Arrivals before `since_s` stay: its place was not disputed then.
        """
        self._judged[key] = self.tracks[key]
        kind, identity = key
        for agent_id, arrival in list(self.progress.unproven.items()):
            is_meant = (kind, identity) in ((Kind.AGENT, agent_id), (Kind.TARGET, arrival.target_id))
            if is_meant and arrival.at_s >= since_s:
                self._take_back(agent_id, arrival)

    def _take_back(self, agent_id: int, arrival: Arrival) -> None:
        self.progress = self.progress.without(agent_id)
        self.refusals.add(
            ("taken back", agent_id),
            f"agent {agent_id}: not at target {arrival.target_id} after all, as its later positions show; taken back, "
            "{} times",
        )

    def update(self, now_s: float, assignment: Mapping[int, int]) -> bool:
        """Update which agents are lost or have arrived by `now_s`; return whether anything changed.

        `assignment` is target id by agent id: an agent whose position is uncertain arrives only at its assigned target.
        """
        before = self._told
        if self._silent_after_s is not None:
            silent = (key for key, at_s in self.heard_at_s.items() if now_s - at_s > self._silent_after_s)
            self.progress = replace(self.progress, lost=frozenset(silent))
        self.progress = self._after_arrivals(now_s, assignment, self._judge_again(now_s))
        self._judged = dict(self.tracks)
        after = self._told = self.progress
        return (before.arrived, before.lost, before.completed) != (after.arrived, after.lost, after.completed)

    def _judge_again(self, now_s: float) -> list[int]:
        """Take back the arrivals that later sightings disprove, and return the agents whose these were."""
        bounds = {one: self._sightings.bound((Kind.AGENT, one)) for one in self.progress.unproven}
        false, settled = disproved(self.progress, self._mission, self.tracks, bounds, now_s)
        for agent_id in false:
            self._take_back(agent_id, self.progress.unproven[agent_id])
        if settled:
            left = {one: arrival for one, arrival in self.progress.unproven.items() if one not in settled}
            self.progress = replace(self.progress, unproven=left)
        return false

    def _after_arrivals(self, now_s: float, assignment: Mapping[int, int], but: Collection[int]) -> MissionProgress:
        """Return the progress with the arrivals of the agents that are near enough to a target, for long enough.

        Those in `but` are left for the next time.
        """
        progress = self.progress
        agents = {agent.id: agent for agent in self._mission.agents}
        arrived, completed = set(progress.arrived), set(progress.completed)
        reached_by, unproven = dict(progress.reached_by), dict(progress.unproven)
        been_at = dict(progress.been_at)
        near_since = {key: near for key, near in progress.near_since.items() if assignment.get(key) == near[0]}
        for target_id, agent_id in self._candidates(assignment):
            if agent_id in arrived or agent_id in but or agents[agent_id].only_target not in (None, target_id):
                continue
            # The mission's word is where an agent is to begin, not that it is there.
            if self._mission.case == "I" and (Kind.AGENT, agent_id) not in self.origins.by:
                continue
            # Where a thing is disputed, nothing shows that it was reached.
            if any(self._sightings.held(key) for key in ((Kind.AGENT, agent_id), (Kind.TARGET, target_id))):
                continue
            is_near = self._came_near(agents[agent_id], target_id)
            wait_s = self.uncertainty_m[agent_id] / agents[agent_id].speed_m_s
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
                been_at[target_id] = (*been_at.get(target_id, ()), agent_id)
                unproven[agent_id] = self._arrival(agent_id, target_id, near_since)
                if target_id not in reached_by.values():
                    reached_by[agent_id] = target_id
        return replace(
            progress,
            arrived=frozenset(arrived),
            completed=frozenset(completed),
            reached_by=reached_by,
            been_at=been_at,
            near_since=near_since,
            unproven=unproven,
        )

    def _arrival(self, agent_id: int, target_id: int, near_since: Mapping[int, tuple[int, float]]) -> Arrival:
        """Return an arrival with what showed it."""
        if agent_id in near_since:
            return Arrival(target_id, near_since[agent_id][1], None)
        agent, target = self.tracks[Kind.AGENT, agent_id], self.tracks[Kind.TARGET, target_id]
        return Arrival(target_id, max(agent.seen_at_s, target.seen_at_s), self._judged[Kind.AGENT, agent_id])

    def _came_near(self, spec: AgentSpec, target_id: int) -> bool:
        """Return whether an agent is within the arrival radius of a target, or was since the last update."""
        agent, target = self.tracks[Kind.AGENT, spec.id], self.tracks[Kind.TARGET, target_id]
        radius_m = self._mission.arrival_radius_m
        if math.dist(agent.position_ned_m, target.position_ned_m) <= radius_m:
            return True
        before = self._judged[Kind.AGENT, spec.id]
        flown_m = math.dist(before.position_ned_m, agent.position_ned_m)
        lasts_s = agent.seen_at_s - before.seen_at_s
        # A sighting that no flight explains is no way along which targets are reached.
        if flown_m == 0.0 or flown_m > _FASTEST * spec.speed_m_s * lasts_s:
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


def _things_of(mission: Mission) -> Iterator[tuple[Kind, TargetSpec | ThreatSpec]]:
    """Yield the targets and threats of a mission with their kinds."""
    for target in mission.targets:
        yield Kind.TARGET, target
    for threat in mission.threats:
        yield Kind.THREAT, threat


def _bounded(velocity: complex, bound: Bound) -> complex:
    """Return a velocity (north + i east, in m/s), made as slow as its bound."""
    speed_m_s = abs(velocity)
    return velocity if speed_m_s <= bound.speed_m_s + _ROUNDED_M_S else velocity * (bound.speed_m_s / speed_m_s)
