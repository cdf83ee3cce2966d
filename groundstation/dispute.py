"""Sightings of one thing that contradict each other: neither is believed, and it is held where it was undisputed.

Two series that are both within the thing's bounds, but not within each other's, cannot both be true, and nothing tells
which is. So the track goes back to the last place that nothing contradicted for UNDISPUTED_S, and its age goes on: a
disc that grows by the bound from there holds the thing wherever it is. What all sightings of UNDISPUTED_S agree on is
believed again, within the bounds from that place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from groundstation.filter import LONGEST_S
from groundstation.plausibility import CONFIRMED_BY, Bound, Hypothesis, Known, Reach, Sample, Verdict, Weighed, weigh

UNDISPUTED_S = 3.0
"""Time for which nothing may contradict a place before it is sure, or a series before it is believed again; what looks
less often than that cannot contradict in time. Chosen: three looks of a sensor that looks once a second."""
_SURE_ERRORS = 3.0
"""Radius of a sure place in errors of a sighting: the middle of the reach may be off a true sighting by two before the
two contradict each other, and that sighting by one."""


@dataclass(frozen=True)
class Watched:
    """What is known of one thing, and where it was when that was not disputed."""

    known: Known
    sure: Reach
    """The disc in which it was when nothing had contradicted it for UNDISPUTED_S."""
    next_sure: Reach
    """The disc that is sure next if nothing contradicts it."""
    candidate: Hypothesis | None = None
    """While sightings contradict each other, what all agree on since the last that did; None: nothing is disputed."""

    @staticmethod
    def begun(known: Known, bound: Bound) -> Watched:
        """Return what a mission's word alone says of a thing."""
        sure = _sure(known.believed.reach, bound)
        return Watched(known, sure, sure)


def judge(watched: Watched, sample: Sample, bound: Bound, now_s: float) -> tuple[Watched, Weighed]:
    """Return what is known after a sighting that came at `now_s`, and what it is taken for.

    It is DISPUTED while sightings contradict each other; `off_m` is by how much, or 0 if this one agrees with the last.
    """
    if watched.candidate is not None:
        return _disputed(watched, watched.candidate, sample, bound, now_s)
    known, weighed = weigh(watched.known, sample, bound, now_s)
    if weighed.verdict is Verdict.BEYOND and _may_dispute(watched, sample, bound):
        off_m = known.believed.off_m(sample)
        return replace(watched, candidate=Hypothesis.begun(sample, bound, now_s)), Weighed(Verdict.DISPUTED, off_m)
    watched = replace(watched, known=known)
    if weighed.verdict is Verdict.BELIEVED and sample.at_s - watched.next_sure.at_s >= UNDISPUTED_S:
        watched = replace(watched, sure=watched.next_sure, next_sure=_sure(known.believed.reach, bound))
    return watched, weighed


def _may_dispute(watched: Watched, sample: Sample, bound: Bound) -> bool:
    """Return whether a sample that what is believed does not allow can be true all the same."""
    return not bound.stands and watched.known.is_seen and watched.sure.beyond_m(sample, bound) <= 0.0


def _disputed(
    watched: Watched, candidate: Hypothesis, sample: Sample, bound: Bound, now_s: float
) -> tuple[Watched, Weighed]:
    """Return what is known after one more sighting of a thing whose place is disputed."""
    beyond_m = watched.sure.beyond_m(sample, bound)
    if beyond_m > 0.0:
        return watched, Weighed(Verdict.BEYOND, beyond_m)
    if candidate.motion.at_s - sample.at_s > LONGEST_S:
        return watched, Weighed(Verdict.LATE)
    if candidate.beyond_m(sample, bound) > 0.0:
        off_m = candidate.off_m(sample)
        return replace(watched, candidate=Hypothesis.begun(sample, bound, now_s)), Weighed(Verdict.DISPUTED, off_m)
    if sample.at_s < candidate.motion.at_s:
        return replace(watched, candidate=candidate.supported(now_s)), Weighed(Verdict.DISPUTED)
    grown = candidate.with_sample(sample, bound, now_s)
    if grown.count < CONFIRMED_BY or now_s - grown.since_s < UNDISPUTED_S:
        return replace(watched, candidate=grown), Weighed(Verdict.DISPUTED)
    # The sure place stays: another sighting may still contradict this series.
    settled = Watched(Known(grown, True), watched.sure, _sure(grown.reach, bound))
    return settled, Weighed(Verdict.BELIEVED)


def _sure(reach: Reach, bound: Bound) -> Reach:
    return replace(reach, radius_m=_SURE_ERRORS * bound.noise.error_m)
