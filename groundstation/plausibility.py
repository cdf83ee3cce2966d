"""Whether a sighting can be true, by the mission's own bounds and by what was seen before.

Each thing has a reach: the disc in which it can be by everything that was believed, grown by its speed bound. A
sighting whose error does not touch the reach is beyond the bounds and never moves the track. One that touches it but is
not where the constant-velocity filter expects the thing is a jump: it is believed when CONFIRMED_BY sightings agree and
nothing speaks for the old track any more. A thing that cannot move stands where the mission says, whatever is seen.

Places are complex numbers, north + i east, in m; times are Unix seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

from groundstation.filter import LONGEST_S, Motion, Noise

SENSOR_ERROR_M = 30.0
"""Greatest error of a sighting or report unless another is given: three times that of a satellite fix (FIX_ERROR_M)."""
CONFIRMED_BY = 3
"""Number of sightings that agree before a jump is believed."""
CONFIRMED_IN_S = 1.5
"""Least time by this computer's clock between the first and the last of them; sensors look about once a second."""
SILENT_PERIODS = 2.5
"""Number of its own periods for which the old track must be without a sighting before a jump replaces it."""
LONGEST_PERIOD_S = 60.0
"""Greatest period of a track that is waited for."""
RIVAL_COUNT = 2
"""Number of samples after which a place beside the track also takes a sample that fits it better than the track."""
SUSPECTS = 4
"""Greatest number of places, beside the track, that are remembered of one thing until they are confirmed."""
SUSPECT_S = 150.0
"""Time after which an unconfirmed place is forgotten."""
SLACK_S = 10.0
"""Time in which a reach grows by the error of a sighting even if the thing stands, as no bound in a mission is exact;
and the age of the reach that many samples together must not leave."""


class Bound(NamedTuple):
    """How fast a thing may be, and how well it is seen."""

    speed_m_s: float
    noise: Noise
    is_gated: bool = True
    """Whether sightings must be where the filter expects them; not for reports, which come too rarely."""
    period_s: float = 0.0
    """Time between two of its sightings, if that is known beforehand."""

    @property
    def stands(self) -> bool:
        """Whether the thing cannot move."""
        return self.speed_m_s == 0.0


class Sample(NamedTuple):
    """Where something was seen, or reported to be."""

    place: complex
    at_s: float
    """Time at which it was there."""


class Verdict(Enum):
    """What a sample is taken for."""

    BELIEVED = "believed"
    """It moves the track."""
    SUPPORT = "support"
    """It is a little older than the track and agrees with it."""
    LATE = "late"
    """It is too old to say anything."""
    JUMP = "jump"
    """It is within the bounds, but not where the thing is expected, and is not confirmed yet."""
    BEYOND = "beyond"
    """It is where the thing cannot be."""
    DISPUTED = "disputed"
    """It, or another one of late, is where the thing can only be if what was believed was wrong (dispute.py)."""


class Weighed(NamedTuple):
    """A verdict, and how far off the sample is."""

    verdict: Verdict
    off_m: float = 0.0
    """Distance from what the bounds allow (BEYOND), or from where it was expected (JUMP, DISPUTED)."""
    replaced: bool = False
    """Whether a confirmed jump has replaced the track."""


@dataclass(frozen=True)
class Reach:
    """The disc in which a thing was at a time, as far as is known."""

    place: complex
    radius_m: float
    at_s: float

    def radius_at_m(self, at_s: float, bound: Bound) -> float:
        """Return the radius of the disc in which the thing can be at another time, earlier or later."""
        return self.radius_m + (bound.speed_m_s + bound.noise.error_m / SLACK_S) * abs(at_s - self.at_s)

    def beyond_m(self, sample: Sample, bound: Bound) -> float:
        """Return how far a sample is from every place that the bounds allow; 0 or less: they allow it."""
        reach_m = self.radius_at_m(sample.at_s, bound) + bound.noise.error_m
        return abs(sample.place - self.place) - reach_m

    def narrowed(self, sample: Sample, bound: Bound) -> Reach:
        """Return the least disc that contains all places within this reach and within the error of a sample."""
        radius_m, error_m = self.radius_at_m(sample.at_s, bound), bound.noise.error_m
        at_s = max(self.at_s, sample.at_s)
        apart = sample.place - self.place
        apart_m = abs(apart)
        if apart_m <= abs(radius_m - error_m):
            return Reach(self.place, radius_m, at_s) if radius_m < error_m else Reach(sample.place, error_m, at_s)
        # The two circles cross on a line at this distance from the reach's middle; the disc has their chord across it
        # unless the smaller circle has its middle on the far side.
        along_m = (apart_m**2 + radius_m**2 - error_m**2) / (2.0 * apart_m)
        if along_m <= 0.0:
            return Reach(self.place, radius_m, at_s)
        if along_m >= apart_m:
            return Reach(sample.place, error_m, at_s)
        half_chord_m = math.sqrt(max(0.0, radius_m**2 - along_m**2))
        return Reach(self.place + along_m * apart / apart_m, half_chord_m, at_s)


@dataclass(frozen=True)
class Hypothesis:
    """Where a thing may be: its motion and reach by the samples that agree, and when these came."""

    motion: Motion
    reach: Reach
    anchor: Reach
    """The reach as it was some seconds ago: many samples, each a little off, must not creep away from it."""
    count: int
    """Number of samples that agree."""
    since_s: float
    """Time of receipt of the first."""
    last_s: float
    """Time of receipt of the last."""
    intervals_s: tuple[float, float] = (LONGEST_PERIOD_S, LONGEST_PERIOD_S)
    """Times between the receipts of the last three."""

    @staticmethod
    def begun(sample: Sample, bound: Bound, now_s: float) -> Hypothesis:
        """Return the hypothesis of one sample alone."""
        motion = Motion.begun(sample.place, sample.at_s, bound.noise, bound.speed_m_s)
        reach = Reach(sample.place, bound.noise.error_m, sample.at_s)
        return Hypothesis(motion, reach, reach, 1, now_s, now_s)

    def beyond_m(self, sample: Sample, bound: Bound) -> float:
        """Return how far a sample is from every place that the bounds allow; 0 or less: they allow it."""
        return max(self.reach.beyond_m(sample, bound), self.anchor.beyond_m(sample, bound))

    def unexpected_m(self, sample: Sample, bound: Bound) -> float:
        """Return by how much a sample is farther from where the thing is expected than the filter allows."""
        if not bound.is_gated:
            return 0.0
        carried_s = min(max(0.0, sample.at_s - self.motion.at_s), LONGEST_S)
        # No motion within the speed bound is farther from the expected one.
        most_m = 2.0 * bound.speed_m_s * carried_s + 2.0 * bound.noise.error_m
        gate_m = min(self.motion.gate_m(sample.at_s, bound.noise), most_m)
        return abs(sample.place - self.motion.expected(sample.at_s)) - gate_m

    def allows(self, sample: Sample, bound: Bound) -> bool:
        """Return whether a sample agrees with the hypothesis."""
        return self.beyond_m(sample, bound) <= 0.0 and self.unexpected_m(sample, bound) <= 0.0

    def with_sample(self, sample: Sample, bound: Bound, now_s: float) -> Hypothesis:
        """Return the hypothesis with a sample that agrees and is not older than the last."""
        motion = self.motion.updated(sample.place, sample.at_s, bound.noise)
        if sample.at_s - self.motion.at_s > LONGEST_S:
            # Too long ago for the way between to tell a velocity.
            motion = Motion.begun(sample.place, sample.at_s, bound.noise, bound.speed_m_s)
        reach = self.reach.narrowed(sample, bound)
        anchor = reach if sample.at_s - self.anchor.at_s >= SLACK_S else self.anchor
        return replace(self.supported(now_s), motion=motion, reach=reach, anchor=anchor, count=self.count + 1)

    def supported(self, now_s: float) -> Hypothesis:
        """Return the hypothesis with the time of a sample that agrees but is older than the last."""
        return replace(self, last_s=now_s, intervals_s=(self.intervals_s[1], now_s - self.last_s))

    def period_s(self) -> float:
        """Return how often samples come; one gap alone is no new period."""
        return min(*self.intervals_s, LONGEST_PERIOD_S)

    def off_m(self, sample: Sample) -> float:
        """Return how far a sample is from where the thing is expected."""
        return abs(sample.place - self.motion.expected(sample.at_s))


@dataclass(frozen=True)
class Known:
    """What is believed of one thing, and the places where it was seen but is not believed to be."""

    believed: Hypothesis
    is_seen: bool = False
    """Whether it was seen in this run; before that its place is the mission's word."""
    suspects: tuple[Hypothesis, ...] = ()

    @staticmethod
    def placed(place: complex, at_s: float, bound: Bound, now_s: float) -> Known:
        """Return what a mission says of a thing: that it was at a place at a time."""
        return Known(Hypothesis.begun(Sample(place, at_s), bound, now_s))

    def agreed(self, believed: Hypothesis, now_s: float) -> Known:
        """Return what is known after a sample that agrees with what is believed: suspects must be confirmed anew."""
        return Known(believed, True, tuple(replace(one, count=0, since_s=now_s) for one in self.suspects))


def weigh(known: Known, sample: Sample, bound: Bound, now_s: float, astray_m: float = 0.0) -> tuple[Known, Weighed]:
    """Return what is known after a sample that came at `now_s`, and what the sample is taken for.

    `astray_m` is by how much more it is off than anything else that the caller knows allows; 0 or less: not at all.
    """
    believed = known.believed
    if bound.stands:
        off_m = abs(sample.place - believed.motion.place) - bound.noise.error_m
        if off_m > 0.0:
            return known, Weighed(Verdict.BEYOND, off_m)
        return replace(known, believed=believed.supported(now_s), is_seen=True), Weighed(Verdict.BELIEVED)
    since_s = believed.motion.at_s - sample.at_s
    if since_s > LONGEST_S:
        return known, Weighed(Verdict.LATE)
    beyond_m = believed.beyond_m(sample, bound)
    if since_s > 0.0:
        if beyond_m <= 0.0:
            return known.agreed(believed.supported(now_s), now_s), Weighed(Verdict.SUPPORT)
    elif max(beyond_m, astray_m, believed.unexpected_m(sample, bound)) <= 0.0 and not _fits_better(
        known, sample, bound
    ):
        return known.agreed(believed.with_sample(sample, bound, now_s), now_s), Weighed(Verdict.BELIEVED)
    return _suspected(known, sample, bound, now_s, beyond_m)


def _fits_better(known: Known, sample: Sample, bound: Bound) -> bool:
    """Return whether a sample fits another place better than the track, for which several spoke since its last one."""
    return any(
        one.count >= RIVAL_COUNT
        and sample.at_s >= one.motion.at_s
        and one.off_m(sample) < known.believed.off_m(sample)
        and one.allows(sample, bound)
        for one in known.suspects
    )


def _suspected(known: Known, sample: Sample, bound: Bound, now_s: float, beyond_m: float) -> tuple[Known, Weighed]:
    """Return what is known after a sample that does not agree with what is believed."""
    suspects = [one for one in known.suspects if now_s - one.last_s <= SUSPECT_S]
    agreeing = [one for one in suspects if sample.at_s >= one.motion.at_s and one.allows(sample, bound)]
    if agreeing:
        best = max(agreeing, key=lambda one: one.count)
        suspects.remove(best)
        grown = best.with_sample(sample, bound, now_s)
    else:
        grown = Hypothesis.begun(sample, bound, now_s)
        if len(suspects) >= SUSPECTS:
            suspects.remove(min(suspects, key=lambda one: (one.count, one.last_s)))
    believed = known.believed
    # Before a thing was seen only the mission, which may be of another day, says where it is.
    may_be = beyond_m <= 0.0 or not known.is_seen
    if may_be and _is_confirmed(grown, known, bound) and sample.at_s >= believed.motion.at_s:
        return Known(grown, True, tuple(suspects)), Weighed(Verdict.BELIEVED, replaced=True)
    weighed = Weighed(Verdict.BEYOND, beyond_m) if beyond_m > 0.0 else Weighed(Verdict.JUMP, believed.off_m(sample))
    return replace(known, suspects=(*suspects, grown)), weighed


def _is_confirmed(suspect: Hypothesis, known: Known, bound: Bound) -> bool:
    """Return whether enough samples speak for a suspect, while what is believed is silent for longer than it should."""
    silent_s = suspect.last_s - known.believed.last_s
    # Before it was seen there is no period.
    wanted_s = SILENT_PERIODS * max(known.believed.period_s() if known.is_seen else 0.0, bound.period_s)
    return suspect.count >= CONFIRMED_BY and suspect.last_s - suspect.since_s >= CONFIRMED_IN_S and silent_s >= wanted_s
