"""Who goes where: targets are copied in turn until there is one for every agent, then the assignment problem is solved.

METHOD.md section 1 item 6. The paper maximises the sum of lambda/D and calls that minimising the total distance; it is
not (METHOD.md 2.3), so both objectives exist. The range budget takes part (METHOD.md 2.8): an agent is sent only where
it can arrive, because one that turns home half-way leaves its target without anybody.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

Objective = Literal["distance", "inverse-distance"]
OBJECTIVES: tuple[Objective, ...] = ("distance", "inverse-distance")
CLOSEST_M = 1.0
"""Distances below this count as this, so that 1/D stays finite."""


def assign(
    agents_ned_m: np.ndarray,  # (N, 2) m
    targets_ned_m: np.ndarray,  # (K, 2) m
    objective: Objective,
    reachable: np.ndarray | None = None,  # (N, K) bool, None: everything
) -> np.ndarray:  # (N,) index of each agent's target, -1 for none
    """Return each agent's target (paper: subsection "The target assignment for the agents").

    Targets are copied in turn until there are N, so losing an agent deletes one copy; with N < K each agent gets one
    target. As many targets as possible have an agent, all of them if N >= K and everything is reachable; then as many
    agents as possible have a target; then the objective decides. An agent is never sent where it is not `reachable`,
    rather nowhere. Among equals the choice is arbitrary but always the same.

    Raises ValueError if shapes do not agree.
    """
    number_of_agents, number_of_targets = len(agents_ned_m), len(targets_ned_m)
    _require_shape("agents_ned_m", agents_ned_m, (number_of_agents, 2))
    _require_shape("targets_ned_m", targets_ned_m, (number_of_targets, 2))
    if reachable is not None:
        _require_shape("reachable", reachable, (number_of_agents, number_of_targets))
    chosen = np.full(number_of_agents, -1)
    if number_of_agents == 0 or number_of_targets == 0:
        return chosen
    copies = np.arange(max(number_of_agents, number_of_targets)) % number_of_targets  # (C,), the first K in order
    distance_m = np.maximum(_distances(agents_ned_m, targets_ned_m[copies]), CLOSEST_M)  # (N, C)
    cost = distance_m if objective == "distance" else -1.0 / distance_m
    if reachable is None or np.all(reachable):
        rows, columns = linear_sum_assignment(cost)
    else:
        rows, columns = _solve_restricted(cost, np.asarray(reachable, dtype=bool)[:, copies], number_of_targets)
    chosen[rows] = copies[columns]
    return chosen


def within_range(
    agents_ned_m: np.ndarray,  # (N, 2) m
    targets_ned_m: np.ndarray,  # (K, 2) m
    left_m: np.ndarray,  # (N,) m, range budget less distance flown, may be infinite
    home_ned_m: np.ndarray | None,  # (N, 2) m
    reserve: float,
) -> np.ndarray:  # (N, K) bool
    """Return which agent can go to which target on what is left of its range (METHOD.md 2.8).

    The straight way there must be in it. With homes (range policy `return`) the way home must be too, times `reserve`,
    from the target and from here: otherwise the companion turns home before it arrives. Once home is out of reach it
    flies on, so then the way there is enough.

    Raises ValueError if shapes do not agree.
    """
    number_of_agents = len(agents_ned_m)
    _require_shape("agents_ned_m", agents_ned_m, (number_of_agents, 2))
    _require_shape("targets_ned_m", targets_ned_m, (len(targets_ned_m), 2))
    _require_shape("left_m", left_m, (number_of_agents,))
    there_m = _distances(agents_ned_m, targets_ned_m)  # (N, K)
    within: np.ndarray = there_m <= left_m[:, np.newaxis]
    if home_ned_m is not None:
        _require_shape("home_ned_m", home_ned_m, (number_of_agents, 2))
        home_m = np.hypot(*(agents_ned_m - home_ned_m).T)  # (N,)
        back_m = reserve * _distances(home_ned_m, targets_ned_m)
        returns = (there_m + back_m <= left_m[:, np.newaxis]) & (reserve * home_m <= left_m)[:, np.newaxis]
        within &= returns | (home_m > left_m)[:, np.newaxis]
    return within


def _solve_restricted(
    cost: np.ndarray,  # (N, C), C >= N
    reachable: np.ndarray,  # (N, C) bool
    number_of_targets: int,  # K; the first K columns are the targets themselves, the others their copies
) -> tuple[np.ndarray, np.ndarray]:  # rows and columns of the pairs, (P,) each
    """Return the cheapest pairs among those that cover most targets and use most agents.

    How many targets can be covered and how many agents used are two matchings counted in whole numbers; both are
    reached at once, since augmenting a matching never uncovers a column. The cost is then least over a square table
    that has exactly those numbers built in, so no great penalty can drown the differences between costs:

    - as many extra columns as agents stay without a target, free, for agents only;
    - as many extra rows as columns stay without an agent, free, for those columns only: the uncovered targets may be
      any column, the others further copies only. So no fewer targets are covered, and they cannot be more.
    """
    # Agents that reach nothing and targets that nobody reaches take no part: the table would only grow.
    able, open_to_some = np.flatnonzero(reachable.any(axis=1)), np.flatnonzero(reachable.any(axis=0))
    agents, columns = len(able), len(open_to_some)
    targets = int(np.count_nonzero(open_to_some < number_of_targets))
    possible = reachable[np.ix_(able, open_to_some)]
    covered = _matching_size(possible[:, :targets])
    used = _matching_size(possible)
    table = np.full((agents + columns - used, agents + columns - used), np.inf)
    table[:agents, :columns] = np.where(possible, cost[np.ix_(able, open_to_some)], np.inf)
    table[:agents, columns:] = 0.0
    table[agents : agents + targets - covered, :columns] = 0.0
    table[agents:, targets:columns] = 0.0
    row, column = linear_sum_assignment(table)
    pair = (row < agents) & (column < columns)
    return able[row[pair]], open_to_some[column[pair]]


def _matching_size(allowed: np.ndarray) -> int:
    """Return how many disjoint pairs a table of allowed pairs (A, B) bool has at most."""
    partner = maximum_bipartite_matching(csr_array(allowed), perm_type="column")  # (A,), -1 for none
    return int(np.count_nonzero(partner >= 0))


def _distances(from_ned_m: np.ndarray, to_ned_m: np.ndarray) -> np.ndarray:
    """Return the distances between each of A points (A, 2) and each of B points (B, 2), (A, B), m."""
    offset_m = from_ned_m[:, np.newaxis, :] - to_ned_m[np.newaxis, :, :]
    distance_m: np.ndarray = np.hypot(offset_m[..., 0], offset_m[..., 1])
    return distance_m


def _require_shape(name: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    if np.shape(array) != shape:
        raise ValueError(f"{name} has shape {np.shape(array)}, not {shape}")
