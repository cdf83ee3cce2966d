"""Records the truth of a flight step by step: the samples of its trajectory, and the arrivals that end it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.mission.model import Mission
from sim.arrivals import Arrivals
from sim.trajectory import Trajectory, TrajectoryBuilder


class FlightRecord:
    """Recorder of the trajectory and arrivals of one flight of a resolved mission; subclasses count more."""

    def __init__(self, mission: Mission) -> None:
        """Begin without samples and with every target open."""
        self._arrivals = Arrivals(mission)
        self._trajectory = TrajectoryBuilder(
            [agent.id for agent in mission.agents],
            [target.id for target in mission.targets],
            [threat.id for threat in mission.threats],
        )

    @property
    def open_targets(self) -> int:
        """Number of targets that no agent has reached yet."""
        return len(self._arrivals.open)

    def record(
        self, t_s: float, agents: np.ndarray, alive: Sequence[bool], things: tuple[np.ndarray, np.ndarray]
    ) -> bool:
        """Record the sample at `t_s`; return whether the flight is over.

        `agents` is (N, 4), `things` the targets (K, 4) and the threats (M, 4): north m, east m, heading deg, speed m/s.
        `alive` says which agents are not lost.
        """
        targets, threats = things
        self._trajectory.append(t_s, agents, targets, threats)
        return self._arrivals.note(t_s, agents, alive, targets)

    def trajectory(self) -> Trajectory:
        """Return the trajectory recorded so far."""
        return self._trajectory.build()
