"""One thing as its source sees it, and what becomes of it with a further sighting."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

from groundstation.plausibility import Bound, Hypothesis, Known, Sample, Verdict, Weighed, weigh
from groundstation.sources.rules import Rules
from groundstation.sources.sighting import Category, Sighting

OUTSIDE = 1.2
"""Ratio of the distance at which things leave the picture to that at which they enter it."""
HEIGHT_MARGIN_M = 100.0
"""Height by which a thing in the picture must be above the ceiling or below the floor to leave it."""
LONGEST_KEPT_S = 86_400.0
"""Longest time for which a thing counts by its source's word alone: a day's flying."""
_SOON = 1.1
"""Ratio to its speed that a thing's bound must have; with less it is made greater with the next batch."""


class SourceKey(NamedTuple):
    """A thing, by its source's name and that source's key for it."""

    source: str
    key: str


@dataclass(frozen=True)
class Thing:
    """What is known of one thing."""

    key: SourceKey
    known: Known
    category: Category
    seen_at_s: float
    """Time of the newest sighting that was believed."""
    velocity: complex | None = None
    """Velocity that it tells, along the axes of the grid."""
    name: str = ""
    until_s: float | None = None
    """Time until which it counts without another sighting."""
    id: int | None = None
    """Id in the picture; None: it is not there."""
    bound_m_s: float | None = None
    """Speed bound as it was last told; None: it was not, or the mission's file has the thing."""
    leaves_since_s: float | None = None
    """Time since which it is too far away, too high or too low; None: it is not."""
    waits_until_s: float = -math.inf
    """Time until which it is not asked for, because it was refused."""

    @property
    def place(self) -> complex:
        """Where it is by the filter."""
        return self.known.believed.motion.place

    @property
    def speed_m_s(self) -> float | None:
        """Speed that it tells."""
        return None if self.velocity is None else abs(self.velocity)

    @property
    def is_listed(self) -> bool:
        """Whether it is a thing of the mission's file, which is never retired."""
        return self.id is not None and self.bound_m_s is None

    def ends_s(self, rules: Rules, factor: float) -> float:
        """Return when it times out, with a factor on the time-out of its category."""
        timed_s = self.seen_at_s + factor * rules.timeout_s(self.category)
        return timed_s if self.until_s is None else max(self.until_s, timed_s)

    def is_confirmed(self, rules: Rules) -> bool:
        """Return whether enough sightings agree."""
        return self.known.is_seen and self.known.believed.count >= rules.confirmed_by

    def bound_wanted_m_s(self, rules: Rules) -> float:
        """Return the bound that it should be told with."""
        return rules.speed_bound_m_s(self.category, self.speed_m_s)

    def outruns(self, ratio: float = 1.0) -> bool:
        """Return whether its speed times a ratio is more than the bound that was told."""
        return self.bound_m_s is not None and self.speed_m_s is not None and ratio * self.speed_m_s > self.bound_m_s

    def outgrows(self, rules: Rules) -> bool:
        """Return whether the bound that was told must be greater, before it is wrong."""
        bound_m_s = self.bound_m_s
        return bound_m_s is not None and self.outruns(_SOON) and self.bound_wanted_m_s(rules) > bound_m_s


def begun(key: SourceKey, rules: Rules, sighting: Sighting, sample: Sample, now_s: float) -> Thing:
    """Return a thing at its first sighting."""
    bound = rules.bound(sighting, 0.0)
    known = Known(Hypothesis.begun(sample, bound, now_s), is_seen=True)
    return Thing(key, known, rules.category(sighting), sample.at_s)


def sighted(
    thing: Thing, rules: Rules, sighting: Sighting, sample: Sample, now_s: float
) -> tuple[Thing, Weighed, Bound]:
    """Return a thing after a further sighting, what that is taken for, and by which bound."""
    bound = rules.bound(sighting, sample.at_s - thing.known.believed.motion.at_s)
    known, weighed = weigh(thing.known, sample, bound, now_s)
    thing = replace(thing, known=known, category=rules.category(sighting))
    if weighed.verdict is Verdict.BELIEVED:
        thing = replace(thing, seen_at_s=max(thing.seen_at_s, sample.at_s))
    return thing, weighed, bound


def told(thing: Thing, sighting: Sighting, velocity: complex | None, ahead_s: float) -> Thing:
    """Return a thing with what a believed sighting tells beside its place.

    `velocity` is along the grid's axes, and `ahead_s` by how much the clock of its stamps is ahead of the times here.
    """
    until_s = None
    if sighting.until_s is not None:
        until_s = min(sighting.until_s, sighting.at_s + LONGEST_KEPT_S) - ahead_s
    return replace(
        thing,
        velocity=thing.velocity if velocity is None else velocity,
        name=sighting.name or thing.name,
        until_s=until_s,
    )


def placed(thing: Thing, rules: Rules, sighting: Sighting, distance_m: float, now_s: float) -> Thing:
    """Return a thing with whether it is near the mission and at a height that counts; what is inside leaves later."""
    is_inside = thing.id is not None
    most_m = rules.spec.within_m * (OUTSIDE if is_inside else 1.0)
    leaves = distance_m > most_m or rules.is_high_or_low(sighting, HEIGHT_MARGIN_M if is_inside else 0.0)
    if not leaves:
        return replace(thing, leaves_since_s=None)
    return thing if thing.leaves_since_s is not None else replace(thing, leaves_since_s=now_s)
