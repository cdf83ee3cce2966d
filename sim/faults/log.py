"""The log of a flight with faults, moment by moment, and the figures that follow from it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from companion.onboard.decision import Purpose
from companion.onboard.failsafe import Stage
from sim.loop import TOLERANCE_S


@dataclass(frozen=True)
class Moment:
    """The state of vehicle and companion at one time of the flight, after the companion's turn."""

    t_s: float
    north_m: float
    east_m: float
    height_m: float
    course_rad: float
    speed_m_s: float
    guided: bool
    """Whether the autopilot was in its guided mode, in which it obeys setpoints."""
    stage: Stage | None
    """The companion's failsafe stage; None: there is no companion, or it is hung or sends nothing."""
    purpose: Purpose | None
    """What the companion steered for; None: there is no companion, or it is hung."""
    words: str
    """What the companion did and why, in a few words."""
    setpoints: int
    """Number of the companion's setpoints that reached the autopilot since the moment before."""
    disc_m: float
    """Distance to the edge of the nearest detection disc; negative inside."""
    fence_m: float
    """Distance to the fence; negative outside."""
    other_m: float
    """Distance to the other vehicle that this one meets; infinity if there is none."""


@dataclass(frozen=True)
class Log:
    """A flight, as one moment every LOOP_PERIOD_S."""

    moments: tuple[Moment, ...]

    def between(self, from_s: float, until_s: float = math.inf) -> tuple[Moment, ...]:
        """Return the moments from the time `from_s` on and before `until_s`."""
        return tuple(m for m in self.moments if from_s - TOLERANCE_S <= m.t_s < until_s - TOLERANCE_S)

    def first(self, holds: Callable[[Moment], bool], from_s: float = 0.0) -> float | None:
        """Return the first time from `from_s` on at which a condition holds; None if it never does."""
        return next((m.t_s for m in self.between(from_s) if holds(m)), None)

    def course_of_events(self, from_s: float = 0.0) -> tuple[tuple[float, str], ...]:
        """Return what the companion did in words, each with the time at which it began."""
        events: list[tuple[float, str]] = []
        for moment in self.between(from_s):
            if not events or events[-1][1] != moment.words:
                events.append((moment.t_s, moment.words))
        return tuple(events)

    def nearest_disc_m(self, from_s: float = 0.0, until_s: float = math.inf) -> float:
        """Return the least distance to a detection disc's edge within a time; negative if the vehicle was inside."""
        return min(m.disc_m for m in self.between(from_s, until_s))

    def nearest_fence_m(self, from_s: float = 0.0, until_s: float = math.inf) -> float:
        """Return the least distance to the fence within a time; negative if the vehicle was outside."""
        return min(m.fence_m for m in self.between(from_s, until_s))

    def normal_from_s(self, from_s: float) -> float | None:
        """Return when the normal flight that lasts to the end began, at least `from_s`; None without such a stretch."""
        normal = [is_normal(m) for m in self.moments]
        if not normal[-1]:
            return None
        last_bad = max((index for index, good in enumerate(normal) if not good), default=-1)
        return max(from_s, self.moments[last_bad + 1].t_s)


def is_normal(moment: Moment) -> bool:
    """Return whether the companion steered to its target, in the failsafe stage `fresh` and the guided mode."""
    return moment.guided and moment.stage is Stage.FRESH and moment.purpose is Purpose.TARGET
