"""Records a flight step by step: the samples of its trajectory, the arrivals that end it, and what was decided."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.mission.model import Mission
from sim.agent_log import AgentLog
from sim.arrivals import Arrivals
from sim.changes import Change
from sim.loop import START_S, Outcome
from sim.trajectory import Trajectory, TrajectoryBuilder


class FlightRecord:
    """Recorder of trajectory, arrivals and decisions of one flight of a resolved mission; subclasses count more."""

    def __init__(self, mission: Mission) -> None:
        """Begin without samples and with every target open."""
        self._arrivals = Arrivals(mission)
        self.changes: list[Change] = []
        """What was there from when on, from the start, if anything was added, changed or retired."""
        self._mission = mission
        self.logs = {agent.id: AgentLog() for agent in mission.agents}
        """What each companion decided, by agent id."""
        self.builder = TrajectoryBuilder(
            [agent.id for agent in mission.agents],
            [target.id for target in mission.targets],
            [threat.id for threat in mission.threats],
        )

    @property
    def open_targets(self) -> int:
        """Number of targets that no agent has reached yet."""
        return len(self._arrivals.open)

    def follow(self, mission: Mission, t_s: float) -> None:
        """Record the targets and threats of a mission from the next sample on, which is at `t_s`."""
        if not self.changes:
            self.changes.append(Change(0.0, self._mission))
        self.changes.append(Change(t_s, mission))
        self._arrivals.follow(mission)
        self.builder.follow([target.id for target in mission.targets], [threat.id for threat in mission.threats])

    def record(
        self, t_s: float, agents: np.ndarray, alive: Sequence[bool], things: tuple[np.ndarray, np.ndarray]
    ) -> bool:
        """Record the sample at `t_s`; return whether the flight is over.

        `agents` is (N, 4), `things` the targets (K, 4) and the threats (M, 4): north m, east m, heading deg, speed m/s.
        `alive` says which agents are not lost.
        """
        targets, threats = things
        self.builder.append(t_s, agents, targets, threats)
        return self._arrivals.note(t_s, agents, alive, targets)

    def decided(self, agent_id: int, outcome: Outcome) -> None:
        """Take in a companion's decision."""
        self.logs[agent_id].note(outcome.decision, outcome.decision.t_s - START_S)

    def trajectory(self, steps: int | None = None) -> Trajectory:
        """Return the trajectory of the first `steps` steps, of all that were recorded if it is None."""
        return self.builder.build(0, steps)
