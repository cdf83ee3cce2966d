"""How near agents came to threats and to one another, on the paths between the samples of a trajectory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.mission.model import Mission, agent_height_m, is_obstacle
from sim.changes import Things
from sim.flown_path import ROUNDING_M, Crafts, crafts_of, flown_by, moved, nearest
from sim.trajectory import Trajectory

_CHUNK_CELLS = 400_000
"""Number of distances computed at once: few enough for the processor's cache, enough to hide numpy's overhead."""
_ARC_SHARE = 0.25
"""A path leaves the straight line between its ends by less than its length times this and its turn in radians."""


class Nearest(NamedTuple):
    """The nearest that an agent came to a threat's circle or to another agent."""

    distance_m: float
    """Distance from the circle, negative inside it, or from the other agent."""
    id: int
    """Id of the threat or of the other agent."""
    t_s: float


@dataclass(frozen=True)
class ThreatApproaches:
    """Entries of each agent into threats' circles, and how near it came to them."""

    entries_detection: np.ndarray  # (N,)
    entries_attack: np.ndarray  # (N,)
    clearance_m: (
        np.ndarray
    )  # (S,) m to any detection circle, on the path that ends at each sample; NaN: none to measure
    detection: tuple[Nearest | None, ...]
    """Nearest approach of each agent to a detection circle; None if there was nothing to approach."""
    attack: tuple[Nearest | None, ...]


@dataclass(frozen=True)
class PeerApproaches:
    """How near agents came to one another."""

    separation_m: np.ndarray  # (S,) m, on the paths that end at each sample; NaN where no two were alive
    breaches: int
    nearest: tuple[Nearest | None, ...]
    """Nearest approach of each agent to another; None if it was never alive with another at its height."""


class _Least:
    """The least distance of each agent found so far, to which other index, and when."""

    def __init__(self, agents: int) -> None:
        self.distance_m = np.full(agents, np.inf)
        self.other = np.full(agents, -1)
        self.t_s = np.zeros(agents)

    def note(self, agents: np.ndarray, distance_m: np.ndarray, others: np.ndarray, t_s: np.ndarray) -> None:
        """Note distances (L,) of agents by index; of equal ones the first noted counts, then the earliest."""
        less = np.flatnonzero(distance_m < self.distance_m[agents])
        # The least comes last, so that it is the one that stays.
        less = less[np.lexsort((t_s[less], distance_m[less]))[::-1]]
        who = agents[less]
        self.distance_m[who], self.other[who], self.t_s[who] = distance_m[less], others[less], t_s[less]

    def found(self, ids: tuple[int, ...]) -> tuple[Nearest | None, ...]:
        """Return what was found for each agent; `ids` are those of the others."""
        return tuple(
            Nearest(float(distance_m), ids[other], float(t_s)) if other >= 0 else None
            for distance_m, other, t_s in zip(self.distance_m, self.other, self.t_s, strict=True)
        )


def chunks(samples: int, cells_per_sample: int) -> Iterator[tuple[int, int]]:
    """Yield ranges [begin, end) of samples, each of which has at most _CHUNK_CELLS distances (or one sample)."""
    length = max(1, _CHUNK_CELLS // max(1, cells_per_sample))
    for begin in range(0, samples, length):
        yield begin, min(begin + length, samples)


def distances_m(first_m: np.ndarray, second_m: np.ndarray) -> np.ndarray:
    """Return the distances (S, A, B) in m between the positions (S, A, 2) and (S, B, 2)."""
    north_m = first_m[:, :, None, 0] - second_m[:, None, :, 0]
    east_m = first_m[:, :, None, 1] - second_m[:, None, :, 1]
    distance_m: np.ndarray = np.hypot(north_m, east_m)
    return distance_m


def least_possible_m(
    distance_m: np.ndarray, trajectory: Trajectory, crafts: Crafts, things_ned_m: np.ndarray, begin: int
) -> np.ndarray:
    """Return (C - 1, N, K) distances that the paths between C samples from `begin` on cannot fall below.

    `distance_m` (C, N, K) holds the distances at the samples, `things_ned_m` (S, K, 2) the positions of the things.
    """
    end = begin + len(distance_m)
    lasts_s = np.diff(trajectory.t_s[begin:end])[:, None]
    chord_m = _steps_m(trajectory.agents_ned_m[begin:end])
    way_m = crafts.reach_m(chord_m, lasts_s)[:, :, None] + _steps_m(things_ned_m[begin:end])[:, None, :]
    least_m: np.ndarray = 0.5 * (distance_m[:-1] + distance_m[1:] - way_m)
    return least_m


class _Chunk(NamedTuple):
    """Some samples, and how far apart agents and threats are at them."""

    t_s: np.ndarray  # (C,) s
    distance_m: np.ndarray  # (C, N, M) m
    counts: np.ndarray  # (C, N, M) bool, whether both are there
    flown: np.ndarray  # (C - 1, N, M) bool, whether the path between two samples leads past the threat


class _Passing(NamedTuple):
    """Where L paths pass nearest to a threat."""

    distance_m: np.ndarray  # (L,) m
    t_s: np.ndarray  # (L,) s


class _Circles:
    """The circles of one kind about all threats, and what agents had to do with them."""

    def __init__(self, agents: int) -> None:
        self.entries = np.zeros(agents, dtype=int)
        self.least = _Least(agents)

    def note_samples(self, chunk: _Chunk, radii_m: np.ndarray, possible_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Note the distances at samples from circles with radii (C, M).

        Return how far beyond the circles these are, and which paths between samples (C - 1, N, M) matter, as nothing
        shows that they are farther than `possible_m`.
        """
        beyond_m = np.where(chunk.counts, chunk.distance_m - radii_m[:, None], np.inf)
        by_agent_m = beyond_m.swapaxes(0, 1).reshape(beyond_m.shape[1], -1)
        sample, threat = np.divmod(by_agent_m.argmin(axis=1), beyond_m.shape[2])
        self.least.note(np.arange(len(by_agent_m)), by_agent_m.min(axis=1), threat, chunk.t_s[sample])
        outside = beyond_m >= 0.0
        self.entries += (outside[:-1] & ~outside[1:] & chunk.flown).sum(axis=(0, 2))
        may_dip = outside[:-1] & outside[1:] & (possible_m < radii_m[1:, None])
        may_be_least = possible_m - radii_m[1:, None] < self.least.distance_m[:, None]
        return beyond_m, chunk.flown & (may_dip | may_be_least)

    def note_paths(
        self, pairs: tuple[np.ndarray, np.ndarray], radii_m: np.ndarray, ends_m: np.ndarray, nearest: _Passing
    ) -> np.ndarray:
        """Note the nearest places of L paths of agents to threats (`pairs`, by index); return how far beyond they are.

        `radii_m` (L,) are those of the circles, `ends_m` is the lesser distance at the path's ends.
        """
        agent, threat = pairs
        beyond_m: np.ndarray = nearest.distance_m - radii_m
        outside = ends_m >= radii_m
        # What the file's rounding makes of a path along the circle is no depth.
        beyond_m = np.where(outside & (beyond_m > -ROUNDING_M), np.maximum(beyond_m, 0.0), beyond_m)
        np.add.at(self.entries, agent, outside & (beyond_m < 0.0))
        self.least.note(agent, beyond_m, threat, nearest.t_s)
        return beyond_m


def threat_approaches(trajectory: Trajectory, alive: np.ndarray, mission: Mission, things: Things) -> ThreatApproaches:
    """Return entries and approaches of agents alive (S, N) to the threats that reach their height."""
    samples, agents = alive.shape
    detection, attack = _Circles(agents), _Circles(agents)
    there = ~np.isnan(trajectory.threats_ned_m[..., 0])
    reaches = np.array([[is_obstacle(mission, a.id, threat) for threat in mission.threats] for a in mission.agents])
    clearance_m = np.full(samples, np.inf)
    crafts = crafts_of(mission)
    cells = agents * len(mission.threats)
    for begin, end in chunks(samples, cells) if cells else ():
        before = max(begin - 1, 0)  # one sample more, for the path into the chunk
        t_s = trajectory.t_s[before:end]
        distance_m = distances_m(trajectory.agents_ned_m[before:end], trajectory.threats_ned_m[before:end])
        counts = alive[before:end, :, None] & there[before:end, None] & reaches
        led = there[before : end - 1] & ~things.threats_anew[before + 1 : end]
        flown = counts[1:] & led[:, None]
        chunk = _Chunk(t_s, distance_m, counts, flown)
        detection_m, attack_m = things.detection_m[before:end], things.attack_m[before:end]
        possible_m = least_possible_m(distance_m, trajectory, crafts, trajectory.threats_ned_m, before)
        beyond_m, matter = detection.note_samples(chunk, detection_m, possible_m)
        clearance_m[before:end] = np.minimum(clearance_m[before:end], beyond_m.min(axis=(1, 2)))
        matter |= attack.note_samples(chunk, attack_m, possible_m)[1]
        path, agent, threat = np.nonzero(matter)
        since_s, nearest_m = nearest(
            flown_by(trajectory, crafts, path + before, agent),
            moved(trajectory, trajectory.threats_ned_m, path + before, threat),
        )
        ends_m = np.minimum(distance_m[path, agent, threat], distance_m[path + 1, agent, threat])
        passing = _Passing(nearest_m, t_s[path] + since_s)
        attack.note_paths((agent, threat), attack_m[path + 1, threat], ends_m, passing)
        beyond_m = detection.note_paths((agent, threat), detection_m[path + 1, threat], ends_m, passing)
        np.minimum.at(clearance_m, path + before + 1, beyond_m)
    clearance_m[np.isinf(clearance_m)] = np.nan
    ids = trajectory.threat_ids
    return ThreatApproaches(
        detection.entries, attack.entries, clearance_m, detection.least.found(ids), attack.least.found(ids)
    )


def peer_approaches(trajectory: Trajectory, alive: np.ndarray, mission: Mission) -> PeerApproaches:
    """Return how near agents alive (S, N) came to one another.

    Agents whose heights differ by half the mission's layer spacing or more are left out, as separated by height; a
    spacing of 0 means that heights do not separate. The first sample has the distance at it.
    """
    samples, agents = alive.shape
    first, second = _level_pairs(mission)
    separation_m = np.full(samples, np.inf)
    least = _Least(agents)
    if len(first) == 0:
        return PeerApproaches(np.full(samples, np.nan), 0, least.found(()))
    together = alive[0, first] & alive[0, second]
    start_m = trajectory.agents_ned_m[0, first] - trajectory.agents_ned_m[0, second]
    start_m = np.where(together, np.hypot(start_m[:, 0], start_m[:, 1]), np.inf)
    separation_m[0] = start_m.min()
    at_s = np.full(len(first), trajectory.t_s[0])
    least.note(first, start_m, second, at_s)
    least.note(second, start_m, first, at_s)
    breaches = 0
    below_before = np.zeros((1, len(first)), dtype=bool)
    for begin, end in chunks(samples - 1, len(first)):
        # An agent alive at the end of a path was alive at its beginning.
        lives = alive[begin + 1 : end + 1, first] & alive[begin + 1 : end + 1, second]
        closest_m, at_s = _closest(trajectory, mission, (first, second), lives, begin)
        separation_m[begin + 1 : end + 1] = closest_m.min(axis=-1)
        path = closest_m.argmin(axis=0)
        pair = np.arange(len(first))
        least.note(first, closest_m[path, pair], second, at_s[path, pair])
        least.note(second, closest_m[path, pair], first, at_s[path, pair])
        below = np.concatenate((below_before, closest_m < mission.separation_m))
        breaches += int((below[1:] & ~below[:-1]).sum())
        below_before = below[-1:]
    separation_m[np.isinf(separation_m)] = np.nan
    return PeerApproaches(separation_m, breaches, least.found(trajectory.agent_ids))


def _level_pairs(mission: Mission) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of all pairs of agents that heights do not separate."""
    heights_m = np.array([agent_height_m(mission, agent.id) for agent in mission.agents])
    vertical_m = 0.5 * mission.layer_spacing_m
    first, second = np.triu_indices(len(heights_m), k=1)
    level = np.abs(heights_m[first] - heights_m[second]) < vertical_m if vertical_m > 0.0 else first >= 0
    return first[level], second[level]


def _closest(
    trajectory: Trajectory,
    mission: Mission,
    pairs: tuple[np.ndarray, np.ndarray],
    lives: np.ndarray,
    begin: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return how near pairs come on the paths from C samples on (C, P), inf where not both are alive, and when.

    The paths count as straight, except where the arcs may matter: near the mission's separation or the least distance.
    """
    first, second = pairs
    count = len(lives)
    # Component by component: contiguous arrays are several times faster here than a last axis of two.
    north_m, east_m = (trajectory.agents_ned_m[begin : begin + count + 1, :, axis] for axis in (0, 1))
    offset_north_m = north_m[:, first] - north_m[:, second]
    offset_east_m = east_m[:, first] - east_m[:, second]
    from_north_m, from_east_m = offset_north_m[:-1], offset_east_m[:-1]
    along_north_m, along_east_m = np.diff(offset_north_m, axis=0), np.diff(offset_east_m, axis=0)
    squared = np.maximum(along_north_m**2 + along_east_m**2, np.finfo(float).tiny)
    fraction = np.clip(-(from_north_m * along_north_m + from_east_m * along_east_m) / squared, 0.0, 1.0)
    closest_m = np.hypot(from_north_m + fraction * along_north_m, from_east_m + fraction * along_east_m)
    closest_m[~lives] = np.inf
    lasts_s = np.diff(trajectory.t_s[begin : begin + count + 1])[:, None]
    at_s = trajectory.t_s[begin : begin + count, None] + fraction * lasts_s
    crafts = crafts_of(mission)
    bulge_m = _bulges_m(trajectory, crafts, begin, count)
    matter = np.abs(closest_m - mission.separation_m) <= bulge_m
    matter |= closest_m <= closest_m.min() + 2.0 * bulge_m
    path, pair = np.nonzero(matter & lives & (bulge_m > 0.0))
    since_s, nearest_m = nearest(
        flown_by(trajectory, crafts, path + begin, first[pair]),
        flown_by(trajectory, crafts, path + begin, second[pair]),
    )
    closest_m[path, pair], at_s[path, pair] = nearest_m, trajectory.t_s[path + begin] + since_s
    return closest_m, at_s


def _bulges_m(trajectory: Trajectory, crafts: Crafts, begin: int, count: int) -> np.ndarray:
    """Return (C, 1) bounds in m of how far two paths each may leave the straight lines between their ends."""
    turn_deg = np.diff(trajectory.agents_heading_deg[begin : begin + count + 1], axis=0)
    turn_rad = np.radians(np.abs((turn_deg + 180.0) % 360.0 - 180.0))
    lasts_s = np.diff(trajectory.t_s[begin : begin + count + 1])[:, None]
    way_m = crafts.reach_m(_steps_m(trajectory.agents_ned_m[begin : begin + count + 1]), lasts_s)
    bulge_m: np.ndarray = 2.0 * (way_m * np.minimum(0.5, _ARC_SHARE * turn_rad)).max(axis=1, keepdims=True)
    return bulge_m


def _steps_m(places_m: np.ndarray) -> np.ndarray:  # (S, A, 2) -> (S - 1, A)
    """Return the distances between successive positions in m."""
    steps = np.diff(places_m, axis=0)
    step_m: np.ndarray = np.hypot(steps[..., 0], steps[..., 1])
    return step_m
