"""What was added, moved, resized and retired in a flight, as its score needs it.

A thing that appears, jumps or gets other radii between two samples has not been flown into: no path leads there.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from companion.mission.model import Mission, TargetSpec, ThreatSpec
from sim.trajectory import Trajectory

_TOLERANCE_S = 1e-6


class Change(NamedTuple):
    """What a mission has from a time of the flight on."""

    t_s: float
    mission: Mission


class Things(NamedTuple):
    """The targets and threats of a flight over its S samples, K and M of them in the trajectory's order."""

    detection_m: np.ndarray  # (S, M) m
    attack_m: np.ndarray  # (S, M) m
    threats_anew: np.ndarray
    """(S, M) bool, where a threat appeared, jumped or got other radii since the last sample."""
    targets_anew: np.ndarray  # (S, K) bool, where a target appeared or jumped since the last sample


def with_all_things(changes: Sequence[Change]) -> Mission:
    """Return the mission with every target and threat that it ever had, as it was last.

    They are in the order in which they appeared, which is that of a trajectory; there is at least one change.
    """
    targets: dict[int, TargetSpec] = {}
    threats: dict[int, ThreatSpec] = {}
    for change in changes:
        targets |= {target.id: target for target in change.mission.targets}
        threats |= {threat.id: threat for threat in change.mission.threats}
    return changes[-1].mission.model_copy(
        update={"targets": tuple(targets.values()), "threats": tuple(threats.values())}
    )


def things_of(trajectory: Trajectory, mission: Mission, changes: Sequence[Change]) -> Things:
    """Return the things of a flight; `mission` has all of them, and `changes`, if any, begin with the start."""
    specs = {threat.id: threat for threat in mission.threats}
    samples, threats = trajectory.threats_ned_m.shape[:2]
    detection_m, attack_m = (np.empty((samples, threats)) for _ in range(2))
    latest = np.array([(specs[k].detection_radius_m, specs[k].attack_radius_m) for k in trajectory.threat_ids])
    detection_m[:], attack_m[:] = latest.reshape(-1, 2).T
    threats_anew, targets_anew = _appeared(trajectory.threats_ned_m), _appeared(trajectory.targets_ned_m)
    first = [int(np.searchsorted(trajectory.t_s, change.t_s - _TOLERANCE_S)) for change in changes]
    for change, begin, end in zip(changes, first, [*first[1:], samples][: len(first)], strict=True):
        for threat in change.mission.threats:
            if threat.id in trajectory.threat_ids:
                column = trajectory.threat_ids.index(threat.id)
                detection_m[begin:end, column] = threat.detection_radius_m
                attack_m[begin:end, column] = threat.attack_radius_m
    for (before, after), begin in zip(itertools.pairwise(changes), first[1:], strict=True):
        if begin < samples:
            threats_anew[begin] |= _changed(before.mission.threats, after.mission.threats, trajectory.threat_ids)
            targets_anew[begin] |= _changed(before.mission.targets, after.mission.targets, trajectory.target_ids)
    return Things(detection_m, attack_m, threats_anew, targets_anew)


def _appeared(ned_m: np.ndarray) -> np.ndarray:  # (S, M, 2) -> (S, M)
    there = ~np.isnan(ned_m[..., 0])
    appeared = np.zeros(there.shape, dtype=bool)
    appeared[1:] = there[1:] & ~there[:-1]
    return appeared


def _changed(
    before: Sequence[TargetSpec | ThreatSpec], after: Sequence[TargetSpec | ThreatSpec], ids: Sequence[int]
) -> np.ndarray:  # (len(ids),) bool
    """Return which things were given another place or other radii."""
    old = {thing.id: _shape(thing) for thing in before}
    new: Mapping[int, object] = {thing.id: _shape(thing) for thing in after}
    return np.array([k in old and k in new and old[k] != new[k] for k in ids], dtype=bool)


def _shape(thing: TargetSpec | ThreatSpec) -> tuple[float, ...]:
    radii_m = (thing.detection_radius_m, thing.attack_radius_m) if isinstance(thing, ThreatSpec) else ()
    return (*thing.position_ned_m, *radii_m)
