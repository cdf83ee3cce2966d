"""Who has arrived where, judged from tracks: and what is taken back because later sightings speak against it.

An agent arrives that comes within the arrival radius of a target, which it completes. Its tracks are believed samples
only, but any of them may still be off by what its bounds leave; so the next sighting is asked whether the way without
the one in question passes the target too, and a later report whether the agent can have been there. Where not, the
arrival is taken back, and the target is open again.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

from companion.mission.model import Mission
from companion.protocol.codec import Kind
from groundstation.filter import LONGEST_S
from groundstation.plausibility import Bound
from groundstation.sightings import Key
from groundstation.track import Track, passed_at_m

TAKE_BACK_S = 150.0
"""Time after an arrival in which it may be taken back."""


@dataclass(frozen=True)
class Arrival:
    """An arrival that the next sighting or a report may take back."""

    target_id: int
    at_s: float
    """Time of the sighting that showed it; by dead reckoning, the earliest time of the arrival."""
    before: Track | None
    """Sighting before that; None by dead reckoning."""


@dataclass(frozen=True)
class MissionProgress:
    """Arrived and lost agents and completed targets, by id."""

    arrived: frozenset[int] = frozenset()
    lost: frozenset[int] = frozenset()
    completed: frozenset[int] = frozenset()
    """Ids of the completed targets."""
    reached_by: Mapping[int, int] = field(default_factory=dict)
    """Id of the target that an arrived agent completed, by agent id."""
    been_at: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    """Ids of the agents that have arrived at a target, in order, by target id."""
    near_since: Mapping[int, tuple[int, float]] = field(default_factory=dict)
    """Id of the target that an agent with an uncertain position came near, and the time of that, by agent id."""
    unproven: Mapping[int, Arrival] = field(default_factory=dict)
    """Arrivals that may still be taken back, by agent id."""
    out: frozenset[int] = frozenset()
    """Ids of the agents that are out of the assignment by an operator's word: taken out, or recalled alone."""

    def without_target(self, target_id: int) -> MissionProgress:
        """Return the progress after a target was retired: who has arrived there stays."""
        return replace(
            self,
            completed=self.completed - {target_id},
            been_at={one: agents for one, agents in self.been_at.items() if one != target_id},
            reached_by={one: there for one, there in self.reached_by.items() if there != target_id},
            near_since={one: near for one, near in self.near_since.items() if near[0] != target_id},
            unproven={one: arrival for one, arrival in self.unproven.items() if arrival.target_id != target_id},
        )

    def with_reached(self, been_at: Mapping[int, tuple[int, ...]]) -> MissionProgress:
        """Return the progress with targets that were retired, and are back as what they were: reached."""
        return replace(
            self,
            completed=self.completed | been_at.keys(),
            been_at={**been_at, **self.been_at},
            reached_by={**first_at(been_at), **self.reached_by},
        )

    def sent_on(self, agent_ids: Collection[int]) -> MissionProgress:
        """Return the progress after agents that had arrived were given other targets; what they reached stays."""
        return replace(self, arrived=self.arrived.difference(agent_ids))

    def without(self, agent_id: int) -> MissionProgress:
        """Return the progress without what an agent has reached; its target stays completed if another one was there.

        The others that arrived at the same target are those whose arrival it is, too.
        """
        target_id = self.unproven[agent_id].target_id
        left = tuple(one for one in self.been_at.get(target_id, ()) if one != agent_id)
        others = {target: agents for target, agents in self.been_at.items() if target != target_id}
        return replace(
            self,
            arrived=self.arrived - {agent_id},
            been_at={**others, target_id: left} if left else others,
            completed=self.completed if left else self.completed - {target_id},
            reached_by={one: there for one, there in self.reached_by.items() if one != agent_id},
            unproven={one: arrival for one, arrival in self.unproven.items() if one != agent_id},
        )


def first_at(been_at: Mapping[int, tuple[int, ...]]) -> dict[int, int]:
    """Return the id of the target that an agent completed, by its id, from those who have been at targets, in order."""
    return {agents[0]: target for target, agents in been_at.items() if agents}


def disproved(
    progress: MissionProgress,
    mission: Mission,
    tracks: Mapping[Key, Track],
    bounds: Mapping[int, Bound],
    now_s: float,
) -> tuple[list[int], list[int]]:
    """Return the agents whose arrivals their next sightings disprove, and those whose arrivals are settled.

    `bounds` are the agents' bounds by id. What nothing disproves within TAKE_BACK_S is settled.
    """
    false: list[int] = []
    settled: list[int] = []
    for agent_id, arrival in progress.unproven.items():
        now, target = tracks[Kind.AGENT, agent_id], tracks[Kind.TARGET, arrival.target_id]
        if now_s - arrival.at_s > TAKE_BACK_S:
            settled.append(agent_id)
            continue
        # The sighting that showed it may be the agent's or the target's.
        if arrival.before is None or now.seen_at_s <= arrival.at_s or target.seen_at_s == arrival.at_s:
            continue
        lasts_s = now.seen_at_s - arrival.before.seen_at_s
        bound = bounds[agent_id]
        if 0.0 < lasts_s <= LONGEST_S:
            # The way may bend between two sightings, and the target may have moved.
            aside_m = _bends_m(arrival.before, now, bound) + _moves_m(mission, arrival.target_id, lasts_s)
            missed_m = passed_at_m((arrival.before, now), (target, target)) - aside_m
        else:
            flown_m = bound.speed_m_s * (now.seen_at_s - arrival.at_s)
            missed_m = math.dist(now.position_ned_m, target.position_ned_m) - flown_m
        (false if missed_m > mission.arrival_radius_m + bound.noise.error_m else settled).append(agent_id)
    return false, settled


def cannot_have_arrived(
    mission: Mission, arrival: Arrival, target: Track, place_ned_m: tuple[float, float], at_s: float, bound: Bound
) -> bool:
    """Return whether an agent that is at a place at a time cannot have been at the target since its arrival there."""
    since_s = max(0.0, at_s - arrival.at_s)
    off_m = math.dist(place_ned_m, target.position_ned_m) - _moves_m(mission, arrival.target_id, since_s)
    return off_m > mission.arrival_radius_m + bound.noise.error_m + bound.speed_m_s * since_s


def _bends_m(before: Track, now: Track, bound: Bound) -> float:
    """Return how far aside of the way between two sightings an agent can have been, by acceleration and speed."""
    lasts_s = now.seen_at_s - before.seen_at_s
    straight_m = math.dist(before.position_ned_m, now.position_ned_m)
    by_speed_m = math.sqrt(max(0.0, (bound.speed_m_s * lasts_s) ** 2 - straight_m**2)) / 2.0
    return min(bound.noise.acceleration_m_s2 * lasts_s**2 / 8.0, by_speed_m)


def _moves_m(mission: Mission, target_id: int, lasts_s: float) -> float:
    """Return how far a target may move in a time."""
    return lasts_s * next(target.speed_bound_m_s for target in mission.targets if target.id == target_id)
