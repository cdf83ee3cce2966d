"""Which agents have arrived at which targets, found step by step by the rule that `sim.score` applies afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from companion.mission.model import Mission
from sim.flown_path import Crafts, Pose, crafts_of, flown, nearest, straight
from sim.trajectory import TIME_DECIMALS, rounded_rows


class Sample(NamedTuple):
    """The agents' and the targets' rows at one time, rounded as in the trajectory."""

    t_s: float
    agents: np.ndarray  # (N, 3) north m, east m, heading deg
    targets: np.ndarray  # (K, 3)
    apart_m: np.ndarray  # (N, K)


class Passages:
    """Which agents come within the arrival radius of which targets, from sample to sample."""

    def __init__(self, mission: Mission) -> None:
        self._radius_m = mission.arrival_radius_m
        self._crafts = crafts_of(mission)
        self._last: Sample | None = None

    def near(self, t_s: float, agents: np.ndarray, targets: np.ndarray, matter: np.ndarray | bool = True) -> np.ndarray:
        """Return (N, K) bool, who comes near what on the path from the last sample to this, or is near at this.

        `agents` (N, 4) and `targets` (K, 4) hold north m, east m, heading deg, speed m/s; `matter` (N, K) says of whom
        and what it is asked.
        """
        agents, targets = rounded_rows(agents), rounded_rows(targets)
        offset_m = agents[:, None, :2] - targets[:, :2]
        now = Sample(round(t_s, TIME_DECIMALS), agents, targets, np.hypot(offset_m[..., 0], offset_m[..., 1]))
        near: np.ndarray = (now.apart_m <= self._radius_m) & matter
        if self._last is not None:
            self._look_between(self._last, now, near, matter)
        self._last = now
        return near

    def follow(self, places: Sequence[int | None]) -> None:
        """Have other targets from the next sample on: for each its place among the last ones, None if it is anew."""
        if self._last is None:
            return
        rows = np.array([-1 if place is None else place for place in places], dtype=int)
        targets = np.concatenate((self._last.targets, np.full((1, 3), np.nan)))[rows]
        nowhere = np.full((len(self._last.agents), 1), np.nan)
        self._last = self._last._replace(
            targets=targets, apart_m=np.concatenate((self._last.apart_m, nowhere), axis=1)[:, rows]
        )

    def _look_between(self, last: Sample, now: Sample, near: np.ndarray, matter: np.ndarray | bool) -> None:
        """Set in `near` who comes near what between two samples, at which it is not near."""
        lasts_s = np.array([now.t_s - last.t_s])
        agents_m, targets_m = now.agents[:, :2] - last.agents[:, :2], now.targets[:, :2] - last.targets[:, :2]
        moves_m = np.hypot(targets_m[:, 0], targets_m[:, 1])
        ways_m = self._crafts.reach_m(np.hypot(agents_m[:, 0], agents_m[:, 1]), lasts_s)[:, None] + moves_m
        agent, target = np.nonzero(matter & ~near & (last.apart_m + now.apart_m - ways_m <= 2.0 * self._radius_m))
        if agent.size == 0:
            return
        lasts_s = np.repeat(lasts_s, len(agent))
        own = Crafts(self._crafts.speed_m_s[agent], self._crafts.rate_rad_s[agent], self._crafts.wind_m_s)
        before, after = (Pose(rows[agent, :2], rows[agent, 2]) for rows in (last.agents, now.agents))
        way = flown(before, after, lasts_s, own)
        there = straight(last.targets[target, :2], now.targets[target, :2], lasts_s)
        near[agent, target] = nearest(way, there)[1] <= self._radius_m


class Arrivals:
    """The open targets and the arrived agents of one flight of a resolved mission."""

    def __init__(self, mission: Mission) -> None:
        self._passages = Passages(mission)
        self._mission = mission
        self.reached: set[int] = set()
        """Ids of the targets that were reached."""
        self._awaited = awaited(mission)
        """(N, K) bool, which agents may still arrive at which targets."""
        self._on_their_way = np.ones(len(mission.agents), dtype=bool)

    @property
    def open(self) -> list[int]:
        """Ids of the targets that nobody has reached, in file order."""
        return [target.id for target in self._mission.targets if target.id not in self.reached]

    def follow(self, mission: Mission) -> None:
        """Have the targets of a mission from the next sample on: some were added, moved or retired."""
        before = {target.id: (index, target.position_ned_m) for index, target in enumerate(self._mission.targets)}
        places = [before.get(target.id, (None, None)) for target in mission.targets]
        self._passages.follow(
            [
                index if place_ned_m == target.position_ned_m else None
                for (index, place_ned_m), target in zip(places, mission.targets, strict=True)
            ]
        )
        self._mission, self._awaited = mission, awaited(mission)
        self._awaited[~self._on_their_way] = False
        self._awaited[:, [target.id in self.reached for target in mission.targets]] = False

    def note(self, t_s: float, agents: np.ndarray, alive: Sequence[bool], targets: np.ndarray) -> bool:
        """Note the arrivals up to this sample, targets in file order; return whether the flight is over.

        It is over when every target is reached, or nobody is left on its way: no agent alive that has not arrived, or
        in a mission with a `queue` no agent alive at all. `agents` (N, 4) and `targets` (K, 4)
        are rows of north m, east m, heading deg, speed m/s.
        """
        living = np.asarray(alive, dtype=bool)
        near = self._passages.near(t_s, agents, targets, self._awaited & living[:, None])
        for target in np.flatnonzero(near.any(axis=0)).tolist():
            here = near[:, target] & self._on_their_way
            if here.any():
                if not self._mission.queue:
                    self._on_their_way &= ~here
                    self._awaited[here] = False
                self._awaited[:, target] = False
                self.reached.add(self._mission.targets[target].id)
        return not self.open or not (self._on_their_way & living).any()


def awaited(mission: Mission) -> np.ndarray:  # (N, K) bool
    """Return which agents may arrive at which targets."""
    rows = [[agent.only_target in (None, target.id) for target in mission.targets] for agent in mission.agents]
    return np.array(rows, dtype=bool).reshape(len(mission.agents), len(mission.targets))
