"""Where things have been: the track behind each agent, target and threat, bounded however long the day is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

KINDS = ("agents", "targets", "threats")
LEAST_S = 1.0
"""Least time between two points of a new trail."""
LEAST_M = 1.0
"""Least distance between two points of a trail."""
MOST_POINTS = 240
"""Greatest number of points of one trail; then every second one is left out, and points are taken half as often."""

Point = tuple[float, float, float]
"""Time in Unix seconds, north and east in m."""


class _Trail:
    def __init__(self) -> None:
        self.points: list[Point] = []
        self._least_s = LEAST_S

    def add(self, t_s: float, north_m: float, east_m: float) -> None:
        if self.points:
            last_s, last_north_m, last_east_m = self.points[-1]
            if t_s - last_s < self._least_s or math.hypot(north_m - last_north_m, east_m - last_east_m) < LEAST_M:
                return
        self.points.append((t_s, north_m, east_m))
        if len(self.points) > MOST_POINTS:
            self.points = self.points[::2]
            self._least_s *= 2.0


class Trails:
    """The trails of all things of a run."""

    def __init__(self) -> None:
        self._trails: dict[str, dict[int, _Trail]] = {kind: {} for kind in KINDS}

    def add(self, moves: Mapping[str, Any]) -> None:
        """Take in the places of a `moves` message; the trail of what is not there any more is forgotten."""
        t_s = float(moves["t_s"])
        for kind in KINDS:
            before, entries = self._trails[kind], moves[kind]
            after = {entry[0]: before.get(entry[0]) or _Trail() for entry in entries}
            for entry in entries:
                after[entry[0]].add(t_s, entry[1], entry[2])
            self._trails[kind] = after

    def to_dict(self) -> dict[str, dict[str, list[Point]]]:
        """Return the trails by kind and id, each as points [time, north, east]."""
        return {
            kind: {str(identity): trail.points for identity, trail in trails.items()}
            for kind, trails in self._trails.items()
        }
