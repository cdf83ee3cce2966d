"""Who goes where: targets are copied in turn until there is one for every agent, then the assignment problem is solved.

METHOD.md section 1 item 6. The paper maximises the sum of lambda/D and calls that minimising the total distance; it is
not (METHOD.md 2.3), so both objectives exist.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment

Objective = Literal["distance", "inverse-distance"]
OBJECTIVES: tuple[Objective, ...] = ("distance", "inverse-distance")
CLOSEST_M = 1.0
"""Distances below this count as this, so that 1/D stays finite."""


def assign(
    agents_ned_m: np.ndarray,  # (N, 2) m
    targets_ned_m: np.ndarray,  # (K, 2) m
    objective: Objective,
) -> np.ndarray:  # (N,) index of each agent's target, -1 for none
    """Return each agent's target.

    With N >= K every target has an agent: targets are copied in turn, so losing an agent deletes one copy. With N < K
    each agent gets one target and the others stay uncovered.
    """
    number_of_agents, number_of_targets = len(agents_ned_m), len(targets_ned_m)
    chosen = np.full(number_of_agents, -1)
    if number_of_agents == 0 or number_of_targets == 0:
        return chosen
    copies = np.arange(max(number_of_agents, number_of_targets)) % number_of_targets
    offset_m = agents_ned_m[:, None, :] - targets_ned_m[None, copies, :]  # (N, C, 2)
    distance_m = np.maximum(np.hypot(offset_m[..., 0], offset_m[..., 1]), CLOSEST_M)
    if objective == "distance":
        rows, columns = linear_sum_assignment(distance_m)
    else:
        rows, columns = linear_sum_assignment(1.0 / distance_m, maximize=True)
    chosen[rows] = copies[columns]
    return chosen
