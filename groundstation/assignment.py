"""Target assignment: targets are copied in turn until every agent can have one, then the assignment problem is solved.

The source is docs/method.md section 1, point 6. The paper maximises the sum of lambda/D and calls that minimising the
total distance; it is not (docs/method.md section 2, point 3), so both objectives exist; `route_cost.py` has the costs
of pairs around the threats. The range budget takes part (docs/method.md section 2, point 8): an agent is sent only
where it can arrive, because one that turns home half-way leaves its target without an agent.

The assignment of every period must not send agents back and forth. So the costs of the present pairs are lowered by
`switching_share`: agents change only if that saves more than this share of the joint cost of those that change.
Positions that are wrong by e each move the difference of two assignments by at most 2 e per agent that changes. While
2 e is less than the share of the mean cost of those that change, every change lowers the cost at the true positions, so
none recurs.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

Objective = Literal["distance", "inverse-distance"]
OBJECTIVES: tuple[Objective, ...] = ("distance", "inverse-distance")
"""Objectives that use the straight distance; `route` and `latest` are in groundstation/route_cost.py."""
SWITCHING_SHARE = 0.02
"""Default `switching_share` of `route` and `latest`: twice the 1 % by which a flown path is longer than the shortest
(docs/method.md section 3), so that imperfect flying is no reason to change."""
CLOSEST_M = 1.0
"""Least distance that counts; shorter ones count as this one, so that 1/D stays finite."""


def assign(
    agents_ned_m: np.ndarray,  # (N, 2) m
    targets_ned_m: np.ndarray,  # (K, 2) m
    objective: Objective,
    reachable: np.ndarray | None = None,  # (N, K) bool, None: everything
    present: np.ndarray | None = None,  # (N,) index of each agent's present target, -1 for none
    switching_share: float = 0.0,
) -> np.ndarray:  # (N,) index of each agent's target, -1 for none
    """Return each agent's target (paper: subsection "The target assignment for the agents").

    Targets are copied in turn until there are N, so losing an agent deletes one copy; with N < K each agent gets one
    target. As many targets as possible have an agent, all of them if N >= K and everything is reachable; then as many
    agents as possible have a target; then the objective decides. An agent without a `reachable` target gets none. Among
    equals the choice is arbitrary but always the same.

    Raises ValueError if shapes do not agree.
    """
    number_of_agents, number_of_targets = len(agents_ned_m), len(targets_ned_m)
    _require_shape("agents_ned_m", agents_ned_m, (number_of_agents, 2))
    _require_shape("targets_ned_m", targets_ned_m, (number_of_targets, 2))
    distance_m = np.maximum(distances(agents_ned_m, targets_ned_m), CLOSEST_M)  # (N, K)
    cost = distance_m if objective == "distance" else -1.0 / distance_m
    return assign_least_total(cost, reachable, None, present, switching_share)


def assign_least_total(
    cost: np.ndarray,  # (N, K)
    reachable: np.ndarray | None = None,  # (N, K) bool, None: everything
    blocked: np.ndarray | None = None,  # (N, K) bool, None: nothing
    present: np.ndarray | None = None,  # (N,) index of each agent's present target, -1 for none
    switching_share: float = 0.0,
) -> np.ndarray:  # (N,) index of each agent's target, -1 for none
    """Return the assignment of least total cost among those that `assign` allows.

    In a `blocked` pair the agent would not arrive at the target: as few of these pairs as possible are used, before the
    cost decides.

    Raises ValueError if shapes do not agree, or the share is not in [0, 1).
    """
    cost, reachable, blocked = _tables(cost, reachable, blocked)
    worth = _blocked_last(_present_cheaper(cost, reachable, present, switching_share), blocked)
    return _solve(worth, reachable)


def assign_least_latest(
    arrival_s: np.ndarray,  # (N, K) s
    reachable: np.ndarray | None = None,  # (N, K) bool, None: everything
    blocked: np.ndarray | None = None,  # (N, K) bool, None: nothing
    present: np.ndarray | None = None,  # (N,) index of each agent's present target, -1 for none
    switching_share: float = 0.0,
) -> np.ndarray:  # (N,) index of each agent's target, -1 for none
    """Return the assignment whose latest arrival is least, and then its total time.

    The rest is as in `assign_least_total`; agents of blocked pairs never arrive, so that they do not count for the
    latest arrival. The present assignment's latest arrival stands unless it can fall by more than the share.

    Raises ValueError if shapes do not agree, or the share is not in [0, 1).
    """
    arrival_s, reachable, blocked = _tables(arrival_s, reachable, blocked)
    worth = _present_cheaper(arrival_s, reachable, present, switching_share)
    worth = _blocked_last(worth, blocked)
    latest_s = _least_latest(arrival_s, reachable, blocked, worth)
    if present is not None:
        pair = _present_pairs(reachable & ~blocked, present)
        present_s = float(np.max(arrival_s[pair], initial=-math.inf))
        if latest_s <= present_s and (1.0 - switching_share) * present_s <= latest_s:
            latest_s = present_s
    in_time = reachable & (blocked | (arrival_s <= latest_s))
    return _solve(worth, in_time)


def within_range(
    agents_ned_m: np.ndarray,  # (N, 2) m
    targets_ned_m: np.ndarray,  # (K, 2) m
    left_m: np.ndarray,  # (N,) m, range budget less distance flown, may be infinite
    home_ned_m: np.ndarray | None,  # (N, 2) m
    reserve: float,
    there_m: np.ndarray | None = None,  # (N, K) m, None: the straight distances
) -> np.ndarray:  # (N, K) bool
    """Return which agent can reach which target with the rest of its range (docs/method.md section 2, point 8).

    The path to the target must be within it. With homes (range policy `return`) it must also hold `reserve` times the
    path home, from the target after the path there, and from the present position: otherwise the companion turns home
    before it arrives. Once home is out of reach the companion flies on, so that the path to the target is enough.

    Raises ValueError if shapes do not agree.
    """
    number_of_agents = len(agents_ned_m)
    _require_shape("agents_ned_m", agents_ned_m, (number_of_agents, 2))
    _require_shape("targets_ned_m", targets_ned_m, (len(targets_ned_m), 2))
    _require_shape("left_m", left_m, (number_of_agents,))
    if there_m is None:
        there_m = distances(agents_ned_m, targets_ned_m)  # (N, K)
    _require_shape("there_m", there_m, (number_of_agents, len(targets_ned_m)))
    within: np.ndarray = there_m <= left_m[:, np.newaxis]
    if home_ned_m is not None:
        _require_shape("home_ned_m", home_ned_m, (number_of_agents, 2))
        home_m = np.hypot(*(agents_ned_m - home_ned_m).T)  # (N,)
        back_m = reserve * distances(home_ned_m, targets_ned_m)
        returns = (there_m + back_m <= left_m[:, np.newaxis]) & (reserve * home_m <= left_m)[:, np.newaxis]
        within &= returns | (home_m > left_m)[:, np.newaxis]
    return within


def _tables(
    cost: np.ndarray,  # (N, K)
    reachable: np.ndarray | None,  # (N, K) bool
    blocked: np.ndarray | None,  # (N, K) bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # (N, K) each
    """Return the three tables; where one is None, everything is reachable or nothing is blocked."""
    shape = np.shape(cost)
    if len(shape) != 2:
        raise ValueError(f"cost has shape {shape}, not (N, K)")
    reachable = np.ones(shape, dtype=bool) if reachable is None else reachable
    blocked = np.zeros(shape, dtype=bool) if blocked is None else blocked
    _require_shape("reachable", reachable, shape)
    _require_shape("blocked", blocked, shape)
    return cost, np.asarray(reachable, dtype=bool), np.asarray(blocked, dtype=bool)


def _present_pairs(
    possible: np.ndarray,  # (N, K) bool
    present: np.ndarray,  # (N,) index, -1 for none
) -> tuple[np.ndarray, np.ndarray]:  # rows and columns of the present pairs that are possible
    _require_shape("present", present, (len(possible),))
    rows = np.flatnonzero(present >= 0)
    rows = rows[possible[rows, present[rows]]]
    return rows, present[rows]


def _present_cheaper(
    cost: np.ndarray,  # (N, K)
    reachable: np.ndarray,  # (N, K) bool
    present: np.ndarray | None,  # (N,) index, -1 for none
    share: float,
) -> np.ndarray:  # (N, K)
    """Return the costs with those of the present pairs lowered by a share of their absolute values.

    Assignments are then ordered as if an agent that has a target paid that amount for any other, or for none.
    """
    if not 0.0 <= share < 1.0:
        raise ValueError(f"switching_share is {share}; allowed: 0 to less than 1")
    if present is None:
        return cost
    pair = _present_pairs(reachable, present)
    cheaper = np.array(cost, dtype=float)
    cheaper[pair] -= share * np.abs(cheaper[pair])
    return cheaper


def _blocked_last(cost: np.ndarray, blocked: np.ndarray) -> np.ndarray:  # (N, K) each
    """Return the costs with each blocked pair raised by more than its use could save in all other pairs."""
    if not blocked.any():
        return cost
    dearer: np.ndarray = cost + blocked * (1.0 + len(cost) * (np.max(cost) - np.min(cost)))
    return dearer


def _least_latest(
    arrival_s: np.ndarray,  # (N, K) s
    reachable: np.ndarray,  # (N, K) bool
    blocked: np.ndarray,  # (N, K) bool
    worth: np.ndarray,  # (N, K), blocked pairs last
) -> float:
    """Return the least latest arrival of the assignments that are best by `_best_rank`, s.

    It is found by bisection over the times that occur: with more time allowed, further assignments become possible.
    """
    best = _best_rank(reachable, blocked, worth)
    levels_s = np.unique(arrival_s[reachable & ~blocked])
    low, high = 0, len(levels_s) - 1
    while low < high:
        middle = (low + high) // 2
        if _best_rank(reachable & (blocked | (arrival_s <= levels_s[middle])), blocked, worth) == best:
            high = middle
        else:
            low = middle + 1
    return float(levels_s[low]) if len(levels_s) else -math.inf


def _best_rank(
    reachable: np.ndarray,  # (N, K) bool
    blocked: np.ndarray,  # (N, K) bool
    worth: np.ndarray,  # (N, K), blocked pairs last
) -> tuple[int, int, int]:
    """Return the most targets that can have an agent, then the most agents with a target, then the fewest blocked."""
    if not reachable.any():
        return 0, 0, 0
    if (blocked & reachable).any():
        chosen = _solve(worth, reachable)
        sent = np.flatnonzero(chosen >= 0)
        return len(np.unique(chosen[sent])), len(sent), int(np.count_nonzero(blocked[sent, chosen[sent]]))
    number_of_agents, number_of_targets = reachable.shape
    return _matching_size(reachable), _matching_size(reachable[:, _copies(number_of_agents, number_of_targets)]), 0


def _solve(cost: np.ndarray, reachable: np.ndarray) -> np.ndarray:
    """Return each agent's target (N,), -1 for none, from tables (N, K) of costs and of possible pairs."""
    number_of_agents, number_of_targets = cost.shape
    chosen = np.full(number_of_agents, -1)
    if number_of_agents == 0 or number_of_targets == 0:
        return chosen
    copies = _copies(number_of_agents, number_of_targets)
    if np.all(reachable):
        rows, columns = _cheapest_pairs(cost[:, copies])
    else:
        rows, columns = _solve_restricted(cost[:, copies], reachable[:, copies], number_of_targets)
    chosen[rows] = copies[columns]
    return chosen


def _copies(number_of_agents: int, number_of_targets: int) -> np.ndarray:  # (C,) target of each, the first K in order
    return np.arange(max(number_of_agents, number_of_targets)) % number_of_targets


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
    # Agents that reach no target and targets that no agent reaches take no part: the table would only grow.
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
    row, column = _cheapest_pairs(table)
    pair = (row < agents) & (column < columns)
    return able[row[pair]], open_to_some[column[pair]]


def _cheapest_pairs(cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns, (P,) each, of the pairs of a table (A, B) with the least total cost."""
    # Imported here: scipy takes longer to import than the rest of the ground station, and not every command assigns.
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(cost)
    return rows, columns


def _matching_size(allowed: np.ndarray) -> int:
    """Return the greatest number of disjoint pairs in a table of allowed pairs (A, B) bool."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import maximum_bipartite_matching

    partner = maximum_bipartite_matching(csr_array(allowed), perm_type="column")  # (A,), -1 for none
    return int(np.count_nonzero(partner >= 0))


def distances(from_ned_m: np.ndarray, to_ned_m: np.ndarray) -> np.ndarray:
    """Return the distances between each of A points (A, 2) and each of B points (B, 2), (A, B), m."""
    offset_m = from_ned_m[:, np.newaxis, :] - to_ned_m[np.newaxis, :, :]
    distance_m: np.ndarray = np.hypot(offset_m[..., 0], offset_m[..., 1])
    return distance_m


def _require_shape(name: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    if np.shape(array) != shape:
        raise ValueError(f"{name} has shape {np.shape(array)}, not {shape}")
