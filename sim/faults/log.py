"""What was so during a flight with faults, moment by moment, and what can be asked of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from companion.onboard.decision import Purpose
from companion.onboard.failsafe import Stage
from sim.loop import TOLERANCE_S


@dataclass(frozen=True)
class Moment:
    """What was so at one time of the flight, after the companion's turn."""

    t_s: float
    north_m: float
    east_m: float
    height_m: float
    course_rad: float
    speed_m_s: float
    guided: bool
    """Whether the autopilot was in the mode that obeys setpoints."""
    stage: Stage | None
    """None: no companion, or one that is hung or silent."""
    purpose: Purpose | None
    words: str
    """What the companion did and why, in a few words."""
    setpoints: int
    """Of the companion, that reached the autopilot since the moment before."""
    disc_m: float
    """To the nearest detection disc's edge."""
    fence_m: float
    """To the fence, negative outside."""
    other_m: float
    """To the one that the vehicle meets."""


@dataclass(frozen=True)
class Log:
    """A flight, one moment each LOOP_PERIOD_S, and what was done to it."""

    moments: tuple[Moment, ...]

    def between(self, from_s: float, until_s: float = math.inf) -> tuple[Moment, ...]:
        """Return the moments from a time on and before another."""
        return tuple(m for m in self.moments if from_s - TOLERANCE_S <= m.t_s < until_s - TOLERANCE_S)

    def first(self, holds: Callable[[Moment], bool], from_s: float = 0.0) -> float | None:
        """Return when something held for the first time from a time on; None for never."""
        return next((m.t_s for m in self.between(from_s) if holds(m)), None)

    def course_of_events(self, from_s: float = 0.0) -> tuple[tuple[float, str], ...]:
        """Return what the companion did, each with the time at which it began."""
        events: list[tuple[float, str]] = []
        for moment in self.between(from_s):
            if not events or events[-1][1] != moment.words:
                events.append((moment.t_s, moment.words))
        return tuple(events)

    def nearest_disc_m(self, from_s: float = 0.0, until_s: float = math.inf) -> float:
        """Return how near the vehicle came to a detection disc; negative within."""
        return min(m.disc_m for m in self.between(from_s, until_s))

    def nearest_fence_m(self, from_s: float = 0.0, until_s: float = math.inf) -> float:
        """Return how near the vehicle came to the fence; negative outside."""
        return min(m.fence_m for m in self.between(from_s, until_s))

    def normal_from_s(self, from_s: float) -> float | None:
        """Return from when on the companion steered to its target on a fresh picture; None: not to the end."""
        normal = [is_normal(m) for m in self.moments]
        if not normal[-1]:
            return None
        last_bad = max((index for index, good in enumerate(normal) if not good), default=-1)
        return max(from_s, self.moments[last_bad + 1].t_s)


def is_normal(moment: Moment) -> bool:
    """Return whether the companion steered towards its target with nothing amiss."""
    return moment.guided and moment.stage is Stage.FRESH and moment.purpose is Purpose.TARGET
