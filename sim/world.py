"""The true motion of targets and threats, which the ground station gets only through its sensor.

What is added, moved or retired in flight is so in truth as well.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.mission.model import Mission, PathMotion, SteadyMotion, TargetSpec, ThreatSpec
from companion.mission.random_streams import random_stream
from companion.protocol.codec import Kind

MOTION_STREAM = 2
"""Number of the seed's random stream for the motion of targets and threats."""

Thing = TargetSpec | ThreatSpec


class World:
    """The targets and threats of a resolved mission, in file order, which move from time 0 on by their `motion`."""

    def __init__(self, mission: Mission, seed: int) -> None:
        self.mission = mission
        """The mission whose targets and threats there are in truth."""
        self._hold_s = mission.heading_hold_s
        self._generator = random_stream(seed, MOTION_STREAM)
        self.t_s = 0.0
        """Time of the flight up to which everything has moved."""
        self._holds = 0
        self._targets = len(mission.targets)
        self._things = _things_of(mission)
        self._states = _States.begun(self._things)
        self._turn_wanderers()
        self._follow_paths(0.0)

    def follow(self, mission: Mission) -> None:
        """Have the targets and threats of a mission from now on: what was added, moved or retired is so in truth.

        A thing that was given another place begins there, with its motion; any other goes on as it did, whatever else
        was changed of it.
        """
        self.mission = mission
        rows = {_key(thing): row for row, thing in enumerate(self._things)}
        states, things, before = self._states, _things_of(mission), self._things
        on = {new: rows[_key(thing)] for new, thing in enumerate(things) if _key(thing) in rows}
        on = {new: old for new, old in on.items() if before[old].position_ned_m == things[new].position_ned_m}
        self._things = [before[on[new]] if new in on else thing for new, thing in enumerate(things)]
        self._targets = len(mission.targets)
        self._states = _States.begun(self._things)
        for new, old in on.items():
            self._states.copy(new, states, old)
        self._follow_paths(self.t_s)

    def place(self, kind: Kind, identity: int, place: complex, velocity: complex) -> None:
        """Put a target or threat to a place (north + i east, m) from where it moves with a velocity in m/s."""
        for row, thing in enumerate(self._things):
            if (isinstance(thing, ThreatSpec), thing.id) == (kind is Kind.THREAT, identity):
                states = self._states
                states.north_m[row], states.east_m[row] = place.real, place.imag
                states.heading_rad[row], states.speed_m_s[row] = cmath.phase(velocity), abs(velocity)

    def advance(self, t_s: float, agents_ned_m: np.ndarray | None = None) -> None:  # (N, 2) m
        """Move everything to the time `t_s`, which is not before the last.

        Objects with the motion `chase` head for the nearest of the agents; without any they keep their heading.
        """
        if agents_ned_m is not None and len(agents_ned_m):
            self._turn_chasers(agents_ned_m)
        while self.t_s < t_s:
            next_turn_s = (self._holds + 1) * self._hold_s
            until_s = min(t_s, next_turn_s)
            self._states.move(until_s - self.t_s)
            self.t_s = until_s
            if until_s == next_turn_s:
                self._holds += 1
                self._turn_wanderers()
        self._follow_paths(t_s)

    def rows(self) -> tuple[np.ndarray, np.ndarray]:  # (K, 4), (M, 4)
        """Return the rows of the targets and of the threats: north m, east m, heading deg, speed m/s."""
        states, targets = self._states, self._targets
        heading_deg = np.degrees(states.heading_rad) % 360.0
        table = np.column_stack([states.north_m, states.east_m, heading_deg, states.speed_m_s])
        return table[:targets], table[targets:]

    def _turn_wanderers(self) -> None:
        wanders = self._states.wanders
        self._states.heading_rad[wanders] = self._generator.uniform(0.0, math.tau, int(wanders.sum()))

    def _turn_chasers(self, agents_ned_m: np.ndarray) -> None:
        states = self._states
        for index in states.chasers:
            offset_m = agents_ned_m - (states.north_m[index], states.east_m[index])
            north_m, east_m = offset_m[np.argmin(offset_m[:, 0] ** 2 + offset_m[:, 1] ** 2)]
            states.heading_rad[index] = math.atan2(east_m, north_m)

    def _follow_paths(self, t_s: float) -> None:
        states = self._states
        for index, (times_s, north_m, east_m) in states.paths:
            states.north_m[index] = np.interp(t_s, times_s, north_m)
            states.east_m[index] = np.interp(t_s, times_s, east_m)
            leg = int(np.searchsorted(times_s, t_s, side="right"))
            states.speed_m_s[index] = 0.0
            if 0 < leg < len(times_s):
                along = (north_m[leg] - north_m[leg - 1], east_m[leg] - east_m[leg - 1])
                states.heading_rad[index] = math.atan2(along[1], along[0]) % math.tau
                # The path gives the position above; speed and heading are only for `rows`.
                states.speed_m_s[index] = math.hypot(*along) / (times_s[leg] - times_s[leg - 1])


@dataclass
class _States:
    """Where the things of a mission are and how they move, by their place in its lists."""

    north_m: np.ndarray
    east_m: np.ndarray
    heading_rad: np.ndarray
    speed_m_s: np.ndarray
    wanders: np.ndarray
    """Which of them move at random."""
    chasers: list[int]
    paths: list[tuple[int, np.ndarray]]
    """Those that follow a path, with its times, norths and easts."""

    @classmethod
    def begun(cls, things: Sequence[Thing]) -> _States:
        """Return the states of things that begin where they are placed."""
        states = cls(
            north_m=np.array([thing.position_ned_m[0] for thing in things]),
            east_m=np.array([thing.position_ned_m[1] for thing in things]),
            heading_rad=np.zeros(len(things)),
            speed_m_s=np.zeros(len(things)),
            wanders=np.array([thing.motion == "random" for thing in things], dtype=bool),
            chasers=[index for index, thing in enumerate(things) if thing.motion == "chase"],
            paths=[
                (index, _way_points(thing.position_ned_m, thing.motion))
                for index, thing in enumerate(things)
                if isinstance(thing.motion, PathMotion)
            ],
        )
        for index, thing in enumerate(things):
            if isinstance(thing.motion, SteadyMotion):
                states.heading_rad[index] = math.radians(thing.motion.heading_deg) % math.tau
                states.speed_m_s[index] = thing.motion.speed_m_s
            elif thing.motion in ("random", "chase"):
                states.speed_m_s[index] = thing.speed_bound_m_s
        return states

    def move(self, lasts_s: float) -> None:
        """Move everything along its heading for a time."""
        length_m = self.speed_m_s * lasts_s
        self.north_m += length_m * np.cos(self.heading_rad)
        self.east_m += length_m * np.sin(self.heading_rad)

    def copy(self, index: int, other: _States, there: int) -> None:
        """Let a thing go on from where it is in other states."""
        for mine, its in (
            (self.north_m, other.north_m),
            (self.east_m, other.east_m),
            (self.heading_rad, other.heading_rad),
            (self.speed_m_s, other.speed_m_s),
        ):
            mine[index] = its[there]


def _things_of(mission: Mission) -> list[Thing]:
    return [*mission.targets, *mission.threats]


def _key(thing: Thing) -> tuple[bool, int]:
    return isinstance(thing, ThreatSpec), thing.id


def _way_points(start_ned_m: tuple[float, float], motion: PathMotion) -> np.ndarray:  # (3, W) s, m, m
    """Return times, norths and easts of a path's points, with the start at time 0 added if the path begins later."""
    points = [*motion.path]
    if points[0][0] > 0.0:
        points.insert(0, (0.0, *start_ned_m))
    return np.array(points).T
