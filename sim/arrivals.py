"""Which agents have arrived at which targets, found step by step by the rule that `sim.score` applies afterwards."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.mission.model import Mission
from sim.trajectory import POSITION_DECIMALS


class Arrivals:
    """The open targets and the arrived agents, by index, of one flight of a resolved mission."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self.open = list(range(len(mission.targets)))
        self._arrived: set[int] = set()

    def note(self, agents_ned_m: np.ndarray, alive: Sequence[bool], targets_ned_m: np.ndarray) -> bool:
        """Note the arrivals at this sample, targets in file order; return whether the flight is over.

        It is over when every target is reached, or every agent alive has arrived. Positions are (N, 2) and (K, 2) in m;
        they are rounded as in the trajectory.
        """
        agents_ned_m = np.round(agents_ned_m, POSITION_DECIMALS)
        targets_ned_m = np.round(targets_ned_m, POSITION_DECIMALS)
        flying = [index for index, living in enumerate(alive) if living and index not in self._arrived]
        for target in list(self.open):
            apart_m = np.hypot(*(agents_ned_m[flying] - targets_ned_m[target]).T)
            near = [flying[index] for index in np.flatnonzero(apart_m <= self._mission.arrival_radius_m)]
            target_id = self._mission.targets[target].id
            here = [index for index in near if self._mission.agents[index].only_target in (None, target_id)]
            if here:
                self._arrived.update(here)
                flying = [index for index in flying if index not in self._arrived]
                self.open.remove(target)
        return not self.open or not flying
