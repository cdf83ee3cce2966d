"""The score of a flight: every figure that follows from its trajectory and its mission alone.

Nothing here depends on the guidance's estimates or decisions. So the same figures can be computed again later from
`trajectory.csv` and `mission.yaml`, with a dozen plain loops.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from companion.mission.model import Mission, agent_height_m, is_obstacle
from sim.shortest_path import shortest_path_length
from sim.trajectory import Trajectory

_CHUNK_CELLS = 400_000
"""Number of distances computed at once: few enough for the processor's cache, enough to hide numpy's overhead."""
_FIGURE_DECIMALS = 6
"""Decimals of lengths and times in `result.json`: micrometres and microseconds, finer than the trajectory's values."""


@dataclass(frozen=True)
class AgentScore:
    """One agent's figures. Lengths count until the agent's loss, if it was lost."""

    id: int
    arrived_t_s: float | None
    target_id: int | None
    """The target at which it arrived."""
    end_ned_m: tuple[float, float] | None
    """The place of its arrival, else its last position alive; None if it was never alive."""
    lost_t_s: float | None
    """Time of the first sample at which it was lost; None if it was not."""
    path_length_m: float
    path_to_end_m: float
    """Length of the path up to `end_ned_m`, which leaves out the loiter after arrival."""
    shortest_path_m: float
    """Length of the shortest path from start to `end_ned_m` around static threats; see `score`."""
    threat_entries_detection: int
    threat_entries_attack: int


@dataclass(frozen=True)
class TargetScore:
    """One target: when it was reached, and by which agent (the nearest of several at that sample); None: it was not."""

    id: int
    reached_t_s: float | None
    agent_id: int | None


@dataclass(frozen=True, eq=False)
class History:
    """The least clearance to threats and separation of agents over time; NaN where there is none to measure."""

    t_s: np.ndarray  # (S,) s
    clearance_m: np.ndarray  # (S,) m, least of distance less detection radius over agents alive and threats
    separation_m: np.ndarray  # (S,) m, least distance of two agents alive, over the segment that ends at the sample


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
    sample: np.ndarray  # (N,) sample at which each agent arrived, -1 if it did not
    target: np.ndarray  # (N,) index of its target, -1 if it did not arrive
    reached_sample: np.ndarray  # (K,) sample at which each target was reached, -1 if it was not
    reached_by: np.ndarray  # (K,) index of the nearest agent then, -1 if it was not reached


@dataclass(frozen=True)
class _Threats:
    entries_detection: np.ndarray  # (N,)
    entries_attack: np.ndarray  # (N,)
    worst_depth_m: float
    clearance_m: np.ndarray  # (S,) m


def score(trajectory: Trajectory, mission: Mission) -> Score:
    """Return the figures of a flight, whose trajectory has the ids of its mission.

    The rules:

    * A lost agent does not count from the first sample at or after its loss.
    * Samples are taken in order of time, and at each the targets not yet reached in file order: every agent alive that
      has not yet arrived and is within `arrival_radius_m` arrives there, and the target is reached and no longer open.
      An agent arrives once; one with an `only_target` arrives only there.
    * A threat counts for the agents whose height it reaches. Agents on different layers are separated by height.
    * An entry is a step from outside to inside a threat's radius (distance less than the radius) between two samples;
      starting inside is no entry. Agents that have arrived still count. The worst depth is the greatest depth of any
      agent inside any detection radius.
    * A path is the sum of straight segments between samples. The shortest path runs from the agent's first position to
      the place of its arrival (else its last position alive) around the detection discs of the static threats. Moving
      threats and discs that contain either end are left out, so it is a lower bound. It is infinite where static
      discs close every way.
    * Separation is interpolated linearly between samples. A breach is a run of segments in which one pair's closest
      approach is below `separation_m`. The least separation is None if no two agents were ever alive together.

    Source: docs/design.md and docs/method.md, section 1.

    Raises:
        ValueError: the trajectory's ids are not the mission's.

    """
    _check_ids(trajectory, mission)
    alive = _alive(trajectory, mission)
    arrivals = _arrivals(trajectory, alive, mission)
    threats = _threats(trajectory, alive, mission)
    heights_m = np.array([agent_height_m(mission, agent.id) for agent in mission.agents])
    separation_m, breaches = _separation(
        trajectory, alive, mission.separation_m, heights_m, 0.5 * mission.layer_spacing_m
    )
    per_agent = _agents(trajectory, mission, alive, arrivals, threats)
    per_target = tuple(
        TargetScore(identity, float(trajectory.t_s[sample]), trajectory.agent_ids[agent])
        if sample >= 0
        else TargetScore(identity, None, None)
        for identity, sample, agent in zip(
            trajectory.target_ids, arrivals.reached_sample, arrivals.reached_by, strict=True
        )
    )
    return Score(
        arrived=int((arrivals.sample >= 0).sum()),
        targets_reached=int((arrivals.reached_sample >= 0).sum()),
        targets=len(trajectory.target_ids),
        flight_time_s=float(trajectory.t_s[-1] - trajectory.t_s[0]),
        path_length_m=tuple(agent.path_length_m for agent in per_agent),
        shortest_path_m=tuple(agent.shortest_path_m for agent in per_agent),
        threat_entries_detection=int(threats.entries_detection.sum()),
        threat_entries_attack=int(threats.entries_attack.sum()),
        worst_depth_m=threats.worst_depth_m,
        separation_breaches=breaches,
        min_separation_m=None if np.isnan(separation_m).all() else float(np.nanmin(separation_m)),
        per_agent=per_agent,
        per_target=per_target,
        history=History(trajectory.t_s, threats.clearance_m, separation_m),
    )


def _figure(value: float) -> float | None:
    return round(value, _FIGURE_DECIMALS) if math.isfinite(value) else None


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


def _chunks(samples: int, cells_per_sample: int) -> Iterator[tuple[int, int]]:
    """Yield ranges [begin, end) of samples, each of which has at most _CHUNK_CELLS distances (or one sample)."""
    length = max(1, _CHUNK_CELLS // max(1, cells_per_sample))
    for begin in range(0, samples, length):
        yield begin, min(begin + length, samples)


def _distances_m(first_m: np.ndarray, second_m: np.ndarray) -> np.ndarray:
    """Return the distances (S, A, B) in m between the positions (S, A, 2) and (S, B, 2)."""
    north_m = first_m[:, :, None, 0] - second_m[:, None, :, 0]
    east_m = first_m[:, :, None, 1] - second_m[:, None, :, 1]
    distance_m: np.ndarray = np.hypot(north_m, east_m)
    return distance_m


def _arrivals(trajectory: Trajectory, alive: np.ndarray, mission: Mission) -> _Arrivals:
    samples, agents = alive.shape
    targets = len(trajectory.target_ids)
    open_to = [[agent.only_target in (None, target.id) for target in mission.targets] for agent in mission.agents]
    allowed = np.array(open_to, dtype=bool).reshape(agents, targets)
    found = _Arrivals(np.full(agents, -1), np.full(agents, -1), np.full(targets, -1), np.full(targets, -1))
    for begin, end in _chunks(samples, agents * targets):
        distance_m = _distances_m(trajectory.agents_ned_m[begin:end], trajectory.targets_ned_m[begin:end])
        near = (distance_m <= mission.arrival_radius_m) & alive[begin:end, :, None] & allowed
        while True:
            # Once arrived agents and reached targets are left out, the first sample left has the next arrival.
            near[:, found.sample >= 0] = False
            near[:, :, found.reached_sample >= 0] = False
            anyone = np.flatnonzero(near.any(axis=(1, 2)))
            if anyone.size == 0:
                break
            for target in range(targets):
                arriving = np.flatnonzero(near[anyone[0], :, target] & (found.sample < 0))
                if arriving.size:
                    found.sample[arriving] = begin + anyone[0]
                    found.target[arriving] = target
                    found.reached_sample[target] = begin + anyone[0]
                    found.reached_by[target] = arriving[distance_m[anyone[0], arriving, target].argmin()]
    return found


def _threats(trajectory: Trajectory, alive: np.ndarray, mission: Mission) -> _Threats:
    samples, agents = alive.shape
    detection_m = np.array([threat.detection_radius_m for threat in mission.threats], dtype=float)
    attack_m = np.array([threat.attack_radius_m for threat in mission.threats], dtype=float)
    reaches = np.array([[is_obstacle(mission, a.id, threat) for threat in mission.threats] for a in mission.agents])
    entries_detection = np.zeros(agents, dtype=int)
    entries_attack = np.zeros(agents, dtype=int)
    clearance_m = np.full(samples, np.nan)
    if agents == 0 or len(detection_m) == 0:
        return _Threats(entries_detection, entries_attack, 0.0, clearance_m)
    for begin, end in _chunks(samples, agents * len(detection_m)):
        before = max(begin - 1, 0)  # one sample more, for the step into the chunk
        distance_m = _distances_m(trajectory.agents_ned_m[before:end], trajectory.threats_ned_m[before:end])
        counts = alive[before + 1 : end, :, None] & reaches
        for entries, radius_m in ((entries_detection, detection_m), (entries_attack, attack_m)):
            inside = distance_m < radius_m
            entries += (inside[1:] & ~inside[:-1] & counts).sum(axis=(0, 2))
        beyond_m = np.where(reaches, distance_m[begin - before :] - detection_m, np.inf).min(axis=-1)
        beyond_m[~alive[begin:end]] = np.inf
        clearance_m[begin:end] = beyond_m.min(axis=-1)
    worst_depth_m = 0.0 - float(np.nanmin(clearance_m, initial=0.0))
    clearance_m[np.isinf(clearance_m)] = np.nan
    return _Threats(entries_detection, entries_attack, worst_depth_m, clearance_m)


def _separation(
    trajectory: Trajectory, alive: np.ndarray, limit_m: float, heights_m: np.ndarray, vertical_m: float
) -> tuple[np.ndarray, int]:
    """Return the closest approach (S,) in m of any two agents alive, and the number of breaches of `limit_m`.

    A sample's closest approach is that over the segment that ends at it; the first sample has the distance at it. It is
    NaN where fewer than two agents are alive. Agents whose heights (N,) differ by `vertical_m` or more are left out, as
    separated by height; 0 means that heights do not separate.
    """
    samples, agents = alive.shape
    first, second = np.triu_indices(agents, k=1)
    level = np.abs(heights_m[first] - heights_m[second]) < vertical_m if vertical_m > 0.0 else first >= 0
    first, second = first[level], second[level]
    separation_m = np.full(samples, np.inf)
    if len(first) == 0:
        return np.full(samples, np.nan), 0
    together = alive[0, first] & alive[0, second]
    start_m = trajectory.agents_ned_m[0, first] - trajectory.agents_ned_m[0, second]
    separation_m[0] = np.hypot(start_m[:, 0], start_m[:, 1])[together].min(initial=np.inf)

    breaches = 0
    below_before = np.zeros((1, len(first)), dtype=bool)
    for begin, end in _chunks(samples - 1, len(first)):
        # Component by component: contiguous arrays are several times faster here than a last axis of two.
        north_m, east_m = (trajectory.agents_ned_m[begin : end + 1, :, axis] for axis in (0, 1))
        offset_north_m = north_m[:, first] - north_m[:, second]
        offset_east_m = east_m[:, first] - east_m[:, second]
        from_north_m, from_east_m = offset_north_m[:-1], offset_east_m[:-1]
        along_north_m, along_east_m = np.diff(offset_north_m, axis=0), np.diff(offset_east_m, axis=0)
        squared = np.maximum(along_north_m**2 + along_east_m**2, np.finfo(float).tiny)
        fraction = np.clip(-(from_north_m * along_north_m + from_east_m * along_east_m) / squared, 0.0, 1.0)
        closest_m = np.hypot(from_north_m + fraction * along_north_m, from_east_m + fraction * along_east_m)
        # An agent alive at the end of a segment was alive at its beginning.
        closest_m[~(alive[begin + 1 : end + 1, first] & alive[begin + 1 : end + 1, second])] = np.inf
        separation_m[begin + 1 : end + 1] = closest_m.min(axis=-1)
        below = np.concatenate((below_before, closest_m < limit_m))
        breaches += int((below[1:] & ~below[:-1]).sum())
        below_before = below[-1:]
    separation_m[np.isinf(separation_m)] = np.nan
    return separation_m, breaches


def _agents(
    trajectory: Trajectory, mission: Mission, alive: np.ndarray, arrivals: _Arrivals, threats: _Threats
) -> tuple[AgentScore, ...]:
    step_m = np.diff(trajectory.agents_ned_m, axis=0)
    flown_m = np.zeros(alive.shape)
    flown_m[1:] = np.cumsum(np.hypot(step_m[..., 0], step_m[..., 1]) * alive[1:], axis=0)
    radii_m = np.array([threat.detection_radius_m for threat in mission.threats], dtype=float)
    scores = []
    for agent, identity in enumerate(trajectory.agent_ids):
        fixed = [threat.motion == "static" and is_obstacle(mission, identity, threat) for threat in mission.threats]
        around = np.array(fixed, dtype=bool)
        samples_alive = int(alive[:, agent].sum())
        arrived = int(arrivals.sample[agent])
        end = arrived if arrived >= 0 else max(samples_alive - 1, 0)
        start_m, end_m = trajectory.agents_ned_m[0, agent], trajectory.agents_ned_m[end, agent]
        scores.append(
            AgentScore(
                id=identity,
                arrived_t_s=float(trajectory.t_s[arrived]) if arrived >= 0 else None,
                target_id=trajectory.target_ids[arrivals.target[agent]] if arrived >= 0 else None,
                end_ned_m=(float(end_m[0]), float(end_m[1])) if samples_alive else None,
                lost_t_s=float(trajectory.t_s[samples_alive]) if samples_alive < len(alive) else None,
                path_length_m=float(flown_m[-1, agent]),
                path_to_end_m=float(flown_m[end, agent]),
                shortest_path_m=_shortest_m(start_m, end_m, trajectory.threats_ned_m[0, around], radii_m[around]),
                threat_entries_detection=int(threats.entries_detection[agent]),
                threat_entries_attack=int(threats.entries_attack[agent]),
            )
        )
    return tuple(scores)


def _shortest_m(start_m: np.ndarray, end_m: np.ndarray, centres_m: np.ndarray, radii_m: np.ndarray) -> float:
    """Return the length in metres of the shortest path around the discs (M, 2), (M,) that contain neither end (2,)."""
    ends_m = np.stack((start_m, end_m))
    distance_m = np.hypot(centres_m[:, 0] - ends_m[:, None, 0], centres_m[:, 1] - ends_m[:, None, 1])
    outside = (distance_m >= radii_m).all(axis=0)
    return shortest_path_length(start_m, end_m, centres_m[outside], radii_m[outside])
