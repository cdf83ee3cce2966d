"""The truth of a flight as it goes on: every sample of its trajectory, and whether everybody has arrived."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.mission.model import Mission
from sim.arrivals import Arrivals
from sim.trajectory import Trajectory, TrajectoryBuilder


class FlightRecord:
    """Trajectory and arrivals of one flight of a resolved mission; a kind of flight adds what it counts."""

    def __init__(self, mission: Mission) -> None:
        """Begin empty, every target open."""
        self._arrivals = Arrivals(mission)
        self._trajectory = TrajectoryBuilder(
            [agent.id for agent in mission.agents],
            [target.id for target in mission.targets],
            [threat.id for threat in mission.threats],
        )

    @property
    def open_targets(self) -> int:
        """How many targets nobody has reached yet."""
        return len(self._arrivals.open)

    def record(
        self, t_s: float, agents: np.ndarray, alive: Sequence[bool], things: tuple[np.ndarray, np.ndarray]
    ) -> bool:
        """Take the rows of agents (N, 4), targets (K, 4) and threats (M, 4); return whether the flight is over."""
        targets, threats = things
        self._trajectory.append(t_s, agents, targets, threats)
        return self._arrivals.note(agents[:, :2], alive, targets[:, :2])

    def trajectory(self) -> Trajectory:
        """Return what was recorded."""
        return self._trajectory.build()
