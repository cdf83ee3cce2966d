"""Who counts to the right of way, and how far off where they are known to be they may be by now.

The own detector's word is the best; of an agent that it does not show, the place that the broadcast told counts. Both
grow with their age (geo.right_of_way.growth_m).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from companion.geo.right_of_way import Rules, greatest_growth_m, growth_m, interaction_radius_m
from companion.guard.types import Motion
from companion.guidance.resolution import Peers
from companion.guidance.view import NOBODY, Others, View
from companion.onboard.config import Config

SAID_STEP_S = 5.0
"""Step by which the age of an unheard agent is said, so that the words do not change at every decision."""


class Neighbours(NamedTuple):
    """The neighbours of one tick."""

    peers: Peers
    ids: np.ndarray  # (P,) int, NOBODY for one that is not a known agent
    unseparated: str | None = None
    """From which agents no separation can be promised, in words; None if from all that matter it can."""

    def name(self, peer: int | None) -> str:
        """Return the words for a neighbour, given by its index."""
        identity = NOBODY if peer is None else int(self.ids[peer])
        return "not of the fleet" if identity == NOBODY else f"agent {identity}"

    def within(self, motion: Motion, radius_m: float) -> bool:
        """Return whether any of them may be within a radius of a vehicle."""
        here = complex(motion.north_m, motion.east_m)
        return any(
            abs(place + velocity * age_s - here) <= radius_m + growth_m
            for place, velocity, age_s, growth_m in self.peers.rows()
        )


def neighbours_of(view: View, motion: Motion, rules: Rules, config: Config) -> Neighbours:
    """Return the neighbours of a vehicle by its view.

    A word counts with its growth by age, at most `greatest_growth_m`, until it is older than `peer_memory_s`. Agents
    told to be beyond the detector's range are left out while the detector shows anybody: it would show them in time.
    """
    others = view.others
    if config.detector == "none" or len(others.ids) == 0:
        return Neighbours(Peers(np.zeros((0, 2)), np.zeros((0, 2))), np.zeros(0, dtype=int))
    dt_s = config.guidance_step_s
    most_m = greatest_growth_m(rules, dt_s)
    apart_m = np.hypot(others.places_ned_m[:, 0] - motion.north_m, others.places_ned_m[:, 1] - motion.east_m)
    told = np.arange(len(others.ids)) >= others.seen
    flown_m = np.hypot(others.velocities_m_s[:, 0], others.velocities_m_s[:, 1]) * others.ages_s
    # Whoever is farther off can neither matter nor be missed, wherever it went since.
    reach_m = 2.0 * interaction_radius_m(rules, dt_s) + 2.0 * rules.speed_m_s * others.ages_s
    near = ~told | (apart_m <= reach_m + flown_m)
    if others.seen:
        near &= ~told | (apart_m <= config.detector_range_m)
    grown_m = np.array([_growth_m(others, row, rules, dt_s) if near[row] else 0.0 for row in range(len(near))])
    remembered = ~told | (others.ages_s <= config.peer_memory_s)
    kept = near & remembered
    return Neighbours(
        Peers(
            others.places_ned_m[kept],
            others.velocities_m_s[kept],
            (others.ids == NOBODY)[kept],
            others.ages_s[kept],
            np.minimum(grown_m, most_m)[kept],
        ),
        others.ids[kept],
        _unseparated(others, np.flatnonzero(near & told & (~remembered | (grown_m > most_m)))),
    )


def _growth_m(others: Others, row: int, rules: Rules, dt_s: float) -> float:
    speed_m_s = math.hypot(*others.velocities_m_s[row].tolist())
    told = bool(others.moving_told[row])
    return float(others.rounding_m[row]) + growth_m(speed_m_s, float(others.ages_s[row]), told, rules, dt_s)


def _unseparated(others: Others, rows: np.ndarray) -> str | None:
    if len(rows) == 0:
        return None
    said = [
        f"agent {others.ids[row]} heard over {math.floor(others.ages_s[row] / SAID_STEP_S) * SAID_STEP_S:g} s ago"
        for row in rows.tolist()
    ]
    return f"{', '.join(said)}: no separation from {'it' if len(said) == 1 else 'them'}"
