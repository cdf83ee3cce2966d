"""What was heard of the discs, and what new reports of them contradict."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from companion.guard.types import NEW_THREAT, ROUNDING_M, THREAT_FASTER, Discs

THREAT_TOLERANCE_M = 10.0
"""A disc may stick out of its earlier self, grown, by this: the broadcast rounds a 200 km picture to 3 m, thrice."""


class Heard(NamedTuple):
    """The discs that the next ones must lie in, once grown."""

    ids: list[int]
    centres_ned_m: np.ndarray  # (M, 2) m
    radii_m: np.ndarray  # (M,) m
    speeds_m_s: np.ndarray  # (M,) m/s


class ThreatMonitor:
    """Holds the discs that the next ones must lie in, once grown by their bounds."""

    def __init__(self) -> None:
        self._heard: Heard | None = None
        self._heard_s = 0.0
        self._far: Discs | None = None

    def elapse(self, elapsed_s: float) -> None:
        """Let time pass since the discs were heard of."""
        self._heard_s += elapsed_s

    def note_far(self, discs: Discs) -> None:
        """Keep discs that stand still and are too far to matter: they are compared with only when one matters."""
        self._far, self._heard, self._heard_s = discs, None, 0.0

    def contradicted_by(self, discs: Discs) -> list[str]:
        """Return what the discs contradict of what was heard of them before, each grown by its bound since.

        One that sticks out by no more than rounding explains leaves its earlier self in force, so that small excesses
        add up.
        """
        ids = ids_of(discs)
        heard, since_s = self._heard, self._heard_s
        self._heard_s = 0.0
        if heard is None and self._far is not None:
            far = self._far
            heard = Heard(ids_of(far), far.centres_ned_m, far.radii_m, far.speeds_m_s)
        if heard is not None and heard.ids == ids:
            north_m, east_m = (discs.centres_ned_m - heard.centres_ned_m).T
            grown_m = heard.radii_m + heard.speeds_m_s * since_s
            beyond_m = np.hypot(north_m, east_m) + discs.radii_m - grown_m
            worst_m = max(beyond_m.tolist(), default=0.0)
            if worst_m <= ROUNDING_M:
                self._heard = Heard(ids, discs.centres_ned_m, discs.radii_m, discs.speeds_m_s)
                return []
            if worst_m <= THREAT_TOLERANCE_M:
                earlier = beyond_m > ROUNDING_M
                self._heard = Heard(
                    ids,
                    np.where(earlier[:, np.newaxis], heard.centres_ned_m, discs.centres_ned_m),
                    np.where(earlier, grown_m, discs.radii_m),
                    np.where(earlier, heard.speeds_m_s, discs.speeds_m_s),
                )
                return []
        self._heard = Heard(ids, discs.centres_ned_m.copy(), discs.radii_m.copy(), discs.speeds_m_s.copy())
        return [] if heard is None else contradictions(heard, self._heard, since_s)


def ids_of(discs: Discs) -> list[int]:
    """Return what tells the discs apart: their ids, or else their places."""
    ids: list[int] = list(range(len(discs.radii_m))) if discs.ids is None else discs.ids.tolist()
    return ids


def contradictions(before: Heard, now: Heard, elapsed_s: float) -> list[str]:
    """Return what is new or was faster than its bound; put earlier discs back in force where they exclude more."""
    broken = []
    for row, key in enumerate(now.ids):
        if key not in before.ids:
            broken.append(NEW_THREAT)
            continue
        old = before.ids.index(key)
        grown_m = before.radii_m[old] + before.speeds_m_s[old] * elapsed_s
        beyond_m = math.dist(now.centres_ned_m[row], before.centres_ned_m[old]) + now.radii_m[row] - grown_m
        if beyond_m > THREAT_TOLERANCE_M:
            broken.append(THREAT_FASTER)
        elif beyond_m > ROUNDING_M:
            now.centres_ned_m[row], now.radii_m[row] = before.centres_ned_m[old], grown_m
            now.speeds_m_s[row] = before.speeds_m_s[old]
    return list(dict.fromkeys(broken))
