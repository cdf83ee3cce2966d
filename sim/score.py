"""The score of a flight: every figure that follows from its trajectory and its mission alone.

Nothing here depends on the guidance's estimates or decisions. So the same figures can be computed again later from
`trajectory.csv` and `mission.yaml`, with a dozen plain loops.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from companion.mission.model import Mission, is_obstacle
from sim.approaches import (
    Nearest,
    PeerApproaches,
    ThreatApproaches,
    chunks,
    distances_m,
    least_possible_m,
    peer_approaches,
    threat_approaches,
)
from sim.arrivals import awaited
from sim.changes import Change, things_of
from sim.flown_path import crafts_of, first_within, flown_by, moved, nearest
from sim.shortest_path import shortest_path_length
from sim.trajectory import Trajectory

FIGURE_DECIMALS = 6
"""Decimals of lengths and times in `result.json`: micrometres and microseconds, finer than the trajectory's values."""


class Reached(NamedTuple):
    """One arrival of an agent at a target."""

    target_id: int
    t_s: float
    """Time at which it came within the arrival radius, on its path between two samples."""
    ned_m: tuple[float, float]
    """Where it was then."""


@dataclass(frozen=True)
class AgentScore:
    """One agent's figures. Lengths count until the agent's loss, if it was lost."""

    id: int
    reached: tuple[Reached, ...]
    """Its arrivals in order: one at most, unless the mission has a `queue`."""
    end_ned_m: tuple[float, float] | None
    """The place of its last arrival, else its last position alive; None if it was never alive."""
    lost_t_s: float | None
    """Time of the first sample at which it was lost; None if it was not."""
    path_length_m: float
    path_to_end_m: float
    """Length of the path up to `end_ned_m`, which leaves out the loiter after the last arrival."""
    shortest_path_m: float
    """Length of the shortest path from start by its arrivals to `end_ned_m` around static threats; see `score`."""
    threat_entries_detection: int
    threat_entries_attack: int
    nearest_detection: Nearest | None
    """Nearest approach to the detection circle of any threat; None if there was none at its height."""
    nearest_attack: Nearest | None
    nearest_agent: Nearest | None
    """Nearest approach to another agent at its height; None if there was none."""

    @property
    def arrived_t_s(self) -> float | None:
        """Time of its last arrival; None if it has not arrived."""
        return self.reached[-1].t_s if self.reached else None

    @property
    def target_id(self) -> int | None:
        """The target at which it arrived last."""
        return self.reached[-1].target_id if self.reached else None


@dataclass(frozen=True)
class TargetScore:
    """One target: when it was reached, and by which agent (the first of several); None: it was not."""

    id: int
    reached_t_s: float | None
    agent_id: int | None
    retired_t_s: float | None = None
    """Time of the first sample at which it was not there any more; None if it was there to the end."""

    @property
    def is_open(self) -> bool:
        """Whether it was still to be reached at the end."""
        return self.reached_t_s is None and self.retired_t_s is None


@dataclass(frozen=True, eq=False)
class History:
    """The least clearance to threats and separation of agents over time; NaN where there is none to measure."""

    t_s: np.ndarray  # (S,) s
    clearance_m: np.ndarray
    """(S,) m, least of distance less detection radius over agents alive and threats, over the path that ends there."""
    separation_m: np.ndarray  # (S,) m, least distance of two agents alive, over the path that ends at the sample


@dataclass(frozen=True)
class Score:
    """The figures of a flight; `score` explains each."""

    arrived: int
    targets_reached: int
    targets: int
    flight_time_s: float
    path_length_m: tuple[float, ...]
    shortest_path_m: tuple[float, ...]
    threat_entries_detection: int
    threat_entries_attack: int
    worst_depth_m: float
    separation_breaches: int
    min_separation_m: float | None
    per_agent: tuple[AgentScore, ...]
    per_target: tuple[TargetScore, ...]
    history: History = field(compare=False, repr=False)

    def to_dict(self) -> dict[str, int | float | None | list[float | None]]:
        """Return the figures by their names in `result.json`; an infinite shortest path becomes None."""
        return {
            "arrived": self.arrived,
            "targets_reached": self.targets_reached,
            "targets": self.targets,
            "flight_time_s": _figure(self.flight_time_s),
            "path_length_m": [_figure(length_m) for length_m in self.path_length_m],
            "shortest_path_m": [_figure(length_m) for length_m in self.shortest_path_m],
            "threat_entries_detection": self.threat_entries_detection,
            "threat_entries_attack": self.threat_entries_attack,
            "worst_depth_m": _figure(self.worst_depth_m),
            "separation_breaches": self.separation_breaches,
            "min_separation_m": None if self.min_separation_m is None else _figure(self.min_separation_m),
        }


@dataclass(frozen=True)
class _Arrivals:
    by_agent: tuple[list[Reached], ...]
    """The arrivals of each agent, in order."""
    by_target: dict[int, tuple[int, float]]
    """Index of the agent that reached a target first, and when, by index of the target."""


class _Around(NamedTuple):
    """What agents had to do with threats and with one another."""

    threats: ThreatApproaches
    peers: PeerApproaches
    stay: np.ndarray  # (M,) bool, which threats were there all the time as they were at the start


def score(trajectory: Trajectory, mission: Mission, changes: Sequence[Change] = ()) -> Score:
    """Return the figures of a flight, whose trajectory has the ids of its mission.

    Where things were added, changed or retired in flight, `mission` has all that ever were (`with_all_things`), and
    `changes` begin with what was there at the start. The rules:

    * A lost agent does not count from the first sample at or after its loss.
    * What happens between two samples is judged on the path that was flown (`sim.flown_path`).
    * Samples are taken in order of time, and at each the targets not yet reached in file order: every agent alive that
      has not yet arrived and was within `arrival_radius_m` on its path from the last sample arrives there, at the time
      when it came within it, and the target is reached and no longer open. An agent arrives once, unless the mission
      has a `queue`; one with an `only_target` arrives only there.
    * A threat counts for the agents whose height it reaches. Agents on different layers are separated by height.
    * An entry is a step from outside to inside a threat's radius (distance less than the radius) between two samples,
      or a path between two samples outside that dips into it by more than the rounding of the file; starting inside is
      no entry. Agents that have arrived still count. The worst depth is the greatest depth of any agent inside any
      detection radius, on its path.
    * A path is the sum of straight segments between samples. The shortest path runs from the agent's first position to
      the place of its arrival (else its last position alive) around the detection discs of the static threats; of
      several arrivals, from each place to the next. Moving threats and discs that contain either end are left out, so
      it is a lower bound. It is infinite where static discs close every way.
    * A target or threat counts while it is there. What appears, is moved by an operator or gets other radii between two
      samples was not flown into, and a target that was retired before anybody reached it does not count.
    * A breach of separation is a run of paths between samples in which one pair's closest approach is below
      `separation_m`. The least separation is None if no two agents were ever alive together.

    Source: docs/design.md and docs/method.md, section 1.

    Raises:
        ValueError: the trajectory's ids are not the mission's.

    """
    _check_ids(trajectory, mission)
    alive = _alive(trajectory, mission)
    things = things_of(trajectory, mission, changes)
    arrivals = _arrivals(trajectory, alive, mission, things.targets_anew)
    threats = threat_approaches(trajectory, alive, mission, things)
    peers = peer_approaches(trajectory, alive, mission)
    stay = ~things.threats_anew.any(axis=0) & ~np.isnan(trajectory.threats_ned_m[..., 0]).any(axis=0)
    per_agent = _agents(trajectory, mission, alive, arrivals, _Around(threats, peers, stay))
    per_target = tuple(
        _target_score(target, identity, arrivals.by_target.get(target), trajectory)
        for target, identity in enumerate(trajectory.target_ids)
    )
    return Score(
        arrived=sum(1 for reached in arrivals.by_agent if reached),
        targets_reached=len(arrivals.by_target),
        targets=sum(1 for target in per_target if target.is_open or target.reached_t_s is not None),
        flight_time_s=float(trajectory.t_s[-1] - trajectory.t_s[0]),
        path_length_m=tuple(agent.path_length_m for agent in per_agent),
        shortest_path_m=tuple(agent.shortest_path_m for agent in per_agent),
        threat_entries_detection=int(threats.entries_detection.sum()),
        threat_entries_attack=int(threats.entries_attack.sum()),
        worst_depth_m=0.0 - float(np.nanmin(threats.clearance_m, initial=0.0)),
        separation_breaches=peers.breaches,
        min_separation_m=None if np.isnan(peers.separation_m).all() else float(np.nanmin(peers.separation_m)),
        per_agent=per_agent,
        per_target=per_target,
        history=History(trajectory.t_s, threats.clearance_m, peers.separation_m),
    )


def _target_score(target: int, identity: int, first: tuple[int, float] | None, trajectory: Trajectory) -> TargetScore:
    there = np.flatnonzero(~np.isnan(trajectory.targets_ned_m[:, target, 0]))
    after = int(there[-1]) + 1 if len(there) else 0
    retired_t_s = float(trajectory.t_s[after]) if after < len(trajectory.t_s) else None
    if first is None:
        return TargetScore(identity, None, None, retired_t_s)
    agent, t_s = first
    return TargetScore(identity, t_s, trajectory.agent_ids[agent], retired_t_s)


def _figure(value: float) -> float | None:
    return round(value, FIGURE_DECIMALS) if math.isfinite(value) else None


def _check_ids(trajectory: Trajectory, mission: Mission) -> None:
    for kind, flown, listed in (
        ("agents", trajectory.agent_ids, tuple(agent.id for agent in mission.agents)),
        ("targets", trajectory.target_ids, tuple(target.id for target in mission.targets)),
        ("threats", trajectory.threat_ids, tuple(threat.id for threat in mission.threats)),
    ):
        if flown != listed:
            raise ValueError(f"{kind} of the trajectory {flown} are not those of the mission {listed}")


def _alive(trajectory: Trajectory, mission: Mission) -> np.ndarray:
    """Return (S, N) bool, whether each agent is alive at each sample; a lost one stays lost."""
    lost_s = np.full(len(trajectory.agent_ids), np.inf)
    for loss in mission.losses:
        agent = trajectory.agent_ids.index(loss.agent)
        lost_s[agent] = min(lost_s[agent], loss.t_s)
    alive: np.ndarray = trajectory.t_s[:, None] < lost_s
    return alive


def _arrivals(trajectory: Trajectory, alive: np.ndarray, mission: Mission, anew: np.ndarray) -> _Arrivals:
    """Return the arrivals; `anew` (S, K) says where a target appeared or jumped since the last sample."""
    samples, agents = alive.shape
    targets = len(trajectory.target_ids)
    allowed = awaited(mission)
    arrived, closed = np.zeros(agents, dtype=bool), np.zeros(targets, dtype=bool)
    found = _Arrivals(tuple([] for _ in range(agents)), {})
    for begin, end in chunks(samples, agents * targets):
        near = _near(trajectory, mission, anew, begin, end) & alive[begin:end, :, None] & allowed
        while True:
            # Once arrived agents and reached targets are left out, the first sample left has the next arrival.
            near[:, arrived] = False
            near[:, :, closed] = False
            anyone = np.flatnonzero(near.any(axis=(1, 2)))
            if anyone.size == 0:
                break
            here = begin + int(anyone[0])
            for target in range(targets):
                arriving = np.flatnonzero(near[anyone[0], :, target] & ~arrived)
                if arriving.size == 0:
                    continue
                if here == 0 or anew[here, target]:
                    at_s = np.full(len(arriving), trajectory.t_s[here])
                    ned_m = trajectory.agents_ned_m[here, arriving]
                else:
                    at_s, ned_m = _passages(trajectory, mission, here, arriving, target)
                for agent, t_s, (north_m, east_m) in zip(arriving, at_s, ned_m, strict=True):
                    place_ned_m = float(north_m), float(east_m)
                    found.by_agent[agent].append(Reached(trajectory.target_ids[target], float(t_s), place_ned_m))
                first = int(at_s.argmin())
                found.by_target[target] = int(arriving[first]), float(at_s[first])
                closed[target] = True
                arrived[arriving] = not mission.queue
    for reached in found.by_agent:
        reached.sort(key=lambda one: one.t_s)
    return found


def _near(trajectory: Trajectory, mission: Mission, anew: np.ndarray, begin: int, end: int) -> np.ndarray:
    """Return (C, N, K), which agents come within the arrival radius of which targets on the paths to C samples."""
    before = max(begin - 1, 0)
    crafts = crafts_of(mission)
    distance_m = distances_m(trajectory.agents_ned_m[before:end], trajectory.targets_ned_m[before:end])
    near: np.ndarray = distance_m <= mission.arrival_radius_m
    possible_m = least_possible_m(distance_m, trajectory, crafts, trajectory.targets_ned_m, before)
    may_pass = (possible_m <= mission.arrival_radius_m) & ~anew[before + 1 : end, None]
    path, agent, target = np.nonzero(~near[:-1] & ~near[1:] & may_pass)
    passes = nearest(
        flown_by(trajectory, crafts, path + before, agent),
        moved(trajectory, trajectory.targets_ned_m, path + before, target),
    )
    near[path + 1, agent, target] = passes[1] <= mission.arrival_radius_m
    return near[begin - before :]


def _passages(
    trajectory: Trajectory, mission: Mission, sample: int, agents: np.ndarray, target: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return when (A,) and where (A, 2) agents came within the arrival radius of a target on the path to a sample."""
    paths = np.full(len(agents), sample - 1)
    way = flown_by(trajectory, crafts_of(mission), paths, agents)
    targets = moved(trajectory, trajectory.targets_ned_m, paths, np.full(len(agents), target))
    # A sample may be inside by the rounding of the file alone, and its path then outside.
    since_s = np.minimum(first_within(way, targets, mission.arrival_radius_m), way.lasts_s)
    return np.round(trajectory.t_s[paths] + since_s, FIGURE_DECIMALS), way.at(since_s)


def _agents(
    trajectory: Trajectory,
    mission: Mission,
    alive: np.ndarray,
    arrivals: _Arrivals,
    around: _Around,
) -> tuple[AgentScore, ...]:
    threats, peers, stay = around
    step_m = np.diff(trajectory.agents_ned_m, axis=0)
    flown_m = np.zeros(alive.shape)
    flown_m[1:] = np.cumsum(np.hypot(step_m[..., 0], step_m[..., 1]) * alive[1:], axis=0)
    radii_m = np.array([threat.detection_radius_m for threat in mission.threats], dtype=float)
    scores = []
    for agent, identity in enumerate(trajectory.agent_ids):
        fixed = [threat.motion == "static" and is_obstacle(mission, identity, threat) for threat in mission.threats]
        walls = np.array(fixed, dtype=bool) & stay
        samples_alive = int(alive[:, agent].sum())
        reached = arrivals.by_agent[agent]
        stops_m = [trajectory.agents_ned_m[0, agent], *(np.array(one.ned_m) for one in reached)]
        to_end_m = float(flown_m[max(samples_alive - 1, 0), agent])
        if reached:
            to_end_m = float(np.interp(reached[-1].t_s, trajectory.t_s, flown_m[:, agent]))
        else:
            stops_m.append(trajectory.agents_ned_m[max(samples_alive - 1, 0), agent])
        scores.append(
            AgentScore(
                id=identity,
                reached=tuple(reached),
                end_ned_m=(float(stops_m[-1][0]), float(stops_m[-1][1])) if samples_alive else None,
                lost_t_s=float(trajectory.t_s[samples_alive]) if samples_alive < len(alive) else None,
                path_length_m=float(flown_m[-1, agent]),
                path_to_end_m=to_end_m,
                shortest_path_m=sum(
                    _shortest_m(from_m, to_m, trajectory.threats_ned_m[0, walls], radii_m[walls])
                    for from_m, to_m in itertools.pairwise(stops_m)
                ),
                threat_entries_detection=int(threats.entries_detection[agent]),
                threat_entries_attack=int(threats.entries_attack[agent]),
                nearest_detection=threats.detection[agent],
                nearest_attack=threats.attack[agent],
                nearest_agent=peers.nearest[agent],
            )
        )
    return tuple(scores)


def _shortest_m(start_m: np.ndarray, end_m: np.ndarray, centres_m: np.ndarray, radii_m: np.ndarray) -> float:
    """Return the length in metres of the shortest path around the discs (M, 2), (M,) that contain neither end (2,)."""
    ends_m = np.stack((start_m, end_m))
    distance_m = np.hypot(centres_m[:, 0] - ends_m[:, None, 0], centres_m[:, 1] - ends_m[:, None, 1])
    outside = (distance_m >= radii_m).all(axis=0)
    return shortest_path_length(start_m, end_m, centres_m[outside], radii_m[outside])
