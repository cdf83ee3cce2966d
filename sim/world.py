"""The true motion of targets and threats, which the ground station gets only through its sensor."""

from __future__ import annotations

import math

import numpy as np

from companion.mission.model import Mission, PathMotion, SteadyMotion, TargetSpec, ThreatSpec
from companion.mission.random_streams import random_stream

MOTION_STREAM = 2
"""Number of the seed's random stream for the motion of targets and threats."""


class World:
    """The targets and threats of a resolved mission, in file order, which move from time 0 on by their `motion`."""

    def __init__(self, mission: Mission, seed: int) -> None:
        things: list[TargetSpec | ThreatSpec] = [*mission.targets, *mission.threats]
        self._targets = len(mission.targets)
        self._hold_s = mission.heading_hold_s
        self._generator = random_stream(seed, MOTION_STREAM)
        self._t_s = 0.0
        self._holds = 0
        self._north_m = np.array([thing.position_ned_m[0] for thing in things])
        self._east_m = np.array([thing.position_ned_m[1] for thing in things])
        self._heading_rad = np.zeros(len(things))
        self._speed_m_s = np.zeros(len(things))
        self._wanders = np.array([thing.motion == "random" for thing in things], dtype=bool)
        for index, thing in enumerate(things):
            if isinstance(thing.motion, SteadyMotion):
                self._heading_rad[index] = math.radians(thing.motion.heading_deg) % math.tau
                self._speed_m_s[index] = thing.motion.speed_m_s
            elif thing.motion in ("random", "chase"):
                self._speed_m_s[index] = thing.speed_bound_m_s
        self._paths = [
            (index, _way_points(thing.position_ned_m, thing.motion))
            for index, thing in enumerate(things)
            if isinstance(thing.motion, PathMotion)
        ]
        self._chasers = [index for index, thing in enumerate(things) if thing.motion == "chase"]
        self._turn_wanderers()
        self._follow_paths(0.0)

    def advance(self, t_s: float, agents_ned_m: np.ndarray | None = None) -> None:  # (N, 2) m
        """Move everything to the time `t_s`, which is not before the last.

        Objects with the motion `chase` head for the nearest of the agents; without any they keep their heading.
        """
        if agents_ned_m is not None and len(agents_ned_m):
            self._turn_chasers(agents_ned_m)
        while self._t_s < t_s:
            next_turn_s = (self._holds + 1) * self._hold_s
            until_s = min(t_s, next_turn_s)
            length_m = self._speed_m_s * (until_s - self._t_s)
            self._north_m += length_m * np.cos(self._heading_rad)
            self._east_m += length_m * np.sin(self._heading_rad)
            self._t_s = until_s
            if until_s == next_turn_s:
                self._holds += 1
                self._turn_wanderers()
        self._follow_paths(t_s)

    def rows(self) -> tuple[np.ndarray, np.ndarray]:  # (K, 4), (M, 4)
        """Return the rows of the targets and of the threats: north m, east m, heading deg, speed m/s."""
        table = np.column_stack([self._north_m, self._east_m, np.degrees(self._heading_rad) % 360.0, self._speed_m_s])
        return table[: self._targets], table[self._targets :]

    def _turn_wanderers(self) -> None:
        count = int(self._wanders.sum())
        self._heading_rad[self._wanders] = self._generator.uniform(0.0, math.tau, count)

    def _turn_chasers(self, agents_ned_m: np.ndarray) -> None:
        for index in self._chasers:
            offset_m = agents_ned_m - (self._north_m[index], self._east_m[index])
            north_m, east_m = offset_m[np.argmin(offset_m[:, 0] ** 2 + offset_m[:, 1] ** 2)]
            self._heading_rad[index] = math.atan2(east_m, north_m)

    def _follow_paths(self, t_s: float) -> None:
        for index, (times_s, north_m, east_m) in self._paths:
            self._north_m[index] = np.interp(t_s, times_s, north_m)
            self._east_m[index] = np.interp(t_s, times_s, east_m)
            leg = int(np.searchsorted(times_s, t_s, side="right"))
            self._speed_m_s[index] = 0.0
            if 0 < leg < len(times_s):
                along = (north_m[leg] - north_m[leg - 1], east_m[leg] - east_m[leg - 1])
                self._heading_rad[index] = math.atan2(along[1], along[0]) % math.tau
                # The path gives the position above; speed and heading are only for `rows`.
                self._speed_m_s[index] = math.hypot(*along) / (times_s[leg] - times_s[leg - 1])


def _way_points(start_ned_m: tuple[float, float], motion: PathMotion) -> np.ndarray:  # (3, W) s, m, m
    """Return times, norths and easts of a path's points, with the start at time 0 added if the path begins later."""
    points = [*motion.path]
    if points[0][0] > 0.0:
        points.insert(0, (0.0, *start_ned_m))
    return np.array(points).T
