"""Monitor of the reported keep-out discs: whether a new report contradicts the speed bounds of earlier ones."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from companion.guard.types import NEW_THREAT, ROUNDING_M, THREAT_CHANGED, THREAT_FASTER, Discs

THREAT_TOLERANCE_M = 10.0
"""Least distance by which a reported disc may extend beyond the earlier report grown by its speed bound: a person who
types a place and a sensor that sees it differ by as much. Chosen, not measured."""
TOLERANCE_UNITS = 2.5
"""The same in units in which the discs are told, used where that is more: two centres are each up to sqrt(1/2) of a
unit off, and a radius is rounded up by up to one."""

TOLERANCE_S = 0.65
"""The same as the time in which a disc moves so far at its bound: an age of up to 10 s is told older by up to that."""


class Heard(NamedTuple):
    """The discs last reported: grown by their speed bounds, they must contain the next report."""

    ids: list[int]
    centres_ned_m: np.ndarray  # (M, 2) m
    radii_m: np.ndarray  # (M,) m
    speeds_m_s: np.ndarray  # (M,) m/s
    pictures: list[int]
    """Number of the picture that each is of."""

    @staticmethod
    def of(discs: Discs) -> Heard:
        """Return a report of discs, whose arrays are copied."""
        pictures = [0] * len(discs.radii_m) if discs.pictures is None else discs.pictures.tolist()
        parts = (discs.centres_ned_m.copy(), discs.radii_m.copy(), discs.speeds_m_s.copy())
        return Heard(ids_of(discs), *parts, pictures)


class ThreatMonitor:
    """Compares each report of the discs with the last one, grown by the speed bounds for the time between them."""

    def __init__(self) -> None:
        self._heard: Heard | None = None
        self._heard_s = 0.0
        self._far: Discs | None = None

    def elapse(self, elapsed_s: float) -> None:
        """Add to the time since the discs were last reported."""
        self._heard_s += elapsed_s

    def note_far(self, discs: Discs) -> None:
        """Store standing discs that are too far away to matter; they are compared once a disc comes near enough."""
        self._far, self._heard, self._heard_s = discs, None, 0.0

    def contradicted_by(self, discs: Discs) -> list[str]:
        """Return what (NEW_THREAT, THREAT_CHANGED, THREAT_FASTER) a new report of the discs contradicts, and store it.

        A disc that extends beyond its earlier report by at most the tolerance is not named; the earlier report, grown,
        stays in force for it, so that repeated small excesses add up and are noticed.
        """
        tolerance_m = max(THREAT_TOLERANCE_M, TOLERANCE_UNITS * discs.unit_m)
        now = Heard.of(discs)
        heard, since_s = self._heard, self._heard_s
        self._heard_s = 0.0
        if heard is None and self._far is not None:
            heard = Heard.of(self._far)
        if heard is not None and heard.ids == now.ids:
            north_m, east_m = (discs.centres_ned_m - heard.centres_ned_m).T
            grown_m = heard.radii_m + heard.speeds_m_s * since_s
            beyond_m = np.hypot(north_m, east_m) + discs.radii_m - grown_m
            if max(beyond_m.tolist(), default=0.0) <= ROUNDING_M:
                self._heard = now
                return []
            if (beyond_m <= np.maximum(tolerance_m, TOLERANCE_S * heard.speeds_m_s)).all():
                earlier = beyond_m > ROUNDING_M
                self._heard = Heard(
                    now.ids,
                    np.where(earlier[:, np.newaxis], heard.centres_ned_m, discs.centres_ned_m),
                    np.where(earlier, grown_m, discs.radii_m),
                    np.where(earlier, heard.speeds_m_s, discs.speeds_m_s),
                    now.pictures,
                )
                return []
        self._heard = now
        return [] if heard is None else contradictions(heard, now, since_s, tolerance_m)


def ids_of(discs: Discs) -> list[int]:
    """Return the ids that identify the discs from call to call; their indices where no ids are given."""
    ids: list[int] = list(range(len(discs.radii_m))) if discs.ids is None else discs.ids.tolist()
    return ids


def contradictions(before: Heard, now: Heard, elapsed_s: float, tolerance_m: float) -> list[str]:
    """Return what of NEW_THREAT, THREAT_CHANGED and THREAT_FASTER applies to a report, disc by disc, after `before`.

    Changes `now`: a disc that extends beyond its grown earlier report within the tolerance is replaced by the latter.
    """
    broken = []
    for row, key in enumerate(now.ids):
        if key not in before.ids:
            broken.append(NEW_THREAT)
            continue
        old = before.ids.index(key)
        grown_m = before.radii_m[old] + before.speeds_m_s[old] * elapsed_s
        beyond_m = math.dist(now.centres_ned_m[row], before.centres_ned_m[old]) + now.radii_m[row] - grown_m
        if beyond_m > max(tolerance_m, TOLERANCE_S * before.speeds_m_s[old]):
            broken.append(THREAT_FASTER if now.pictures[row] == before.pictures[old] else THREAT_CHANGED)
        elif beyond_m > ROUNDING_M:
            now.centres_ned_m[row], now.radii_m[row] = before.centres_ned_m[old], grown_m
            now.speeds_m_s[row] = before.speeds_m_s[old]
    return list(dict.fromkeys(broken))
