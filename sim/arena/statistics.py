"""Rates and quantiles over many flights, with 95 % intervals that assume no distribution."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom

from sim.arena.run import TIME_BINS_US, Run

CONFIDENCE = 0.95
Z = 1.959964
"""Two-sided normal quantile of CONFIDENCE. It is rounded: with the exact value, as scipy has it, one interval in a
thousand would differ in its sixth decimal from those that were published."""


@dataclass(frozen=True)
class Estimate:
    """A figure and the ends of its interval; all three are NaN where there are no data."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Summary:
    """The figures of all flights of one law in one family."""

    family: str
    law: str
    flights: int
    feasible: int
    """Number of flights of feasible missions from starts certified for ever, which arrivals and path ratios are of."""
    arrivals: Estimate
    """Share of the feasible missions in which every target was reached."""
    entered: Estimate
    """Share of the flights from certified starts with an entry into any R_d."""
    entries: int
    """Number of entries into an R_d in flights from certified starts."""
    entries_until: int
    """Number of entries in flights from starts that the guard certified for a time only, at whatever time they were."""
    entries_uncertified: int
    """Number of entries in flights from starts that the guard could not certify, for which nothing is promised."""
    worst_depth_m: float
    breaches: int
    min_separation_m: float
    ratio_median: Estimate
    ratio_p95: Estimate
    ratio_p99: Estimate
    decision_median_us: float
    decision_p99_us: float


def summarise(runs: Sequence[Run]) -> Summary:
    """Return the summary of the runs, at least one, of one law over one family."""
    feasible = [run for run in runs if run.feasibility.feasible and run.certified]
    certified = [run for run in runs if run.certified]
    ratios = np.array([ratio for run in feasible for ratio in run.path_ratios])
    counts = np.sum([run.decision_counts for run in runs], axis=0)
    return Summary(
        family=runs[0].family,
        law=runs[0].law,
        flights=len(runs),
        feasible=len(feasible),
        arrivals=wilson(sum(run.complete for run in feasible), len(feasible)),
        entered=wilson(sum(run.entries > 0 for run in certified), len(certified)),
        entries=sum(run.entries for run in certified),
        entries_until=sum(run.entries for run in runs if run.until_s is not None),
        entries_uncertified=sum(run.entries for run in runs if not run.certified and run.until_s is None),
        worst_depth_m=max(run.worst_depth_m for run in runs),
        breaches=sum(run.breaches for run in runs),
        min_separation_m=min(
            (run.min_separation_m for run in runs if run.min_separation_m is not None), default=math.nan
        ),
        ratio_median=quantile(ratios, 0.5),
        ratio_p95=quantile(ratios, 0.95),
        ratio_p99=quantile(ratios, 0.99),
        decision_median_us=binned_quantile_us(counts, 0.5),
        decision_p99_us=binned_quantile_us(counts, 0.99),
    )


def wilson(successes: int, trials: int) -> Estimate:
    """Return a rate with Wilson's score interval."""
    if trials == 0:
        return Estimate(math.nan, math.nan, math.nan)
    rate = successes / trials
    denominator = 1.0 + Z * Z / trials
    middle = (rate + Z * Z / (2.0 * trials)) / denominator
    half = Z / denominator * math.sqrt(rate * (1.0 - rate) / trials + Z * Z / (4.0 * trials * trials))
    # Rounding must not put an end on the wrong side of the rate.
    return Estimate(rate, min(rate, max(0.0, middle - half)), max(rate, min(1.0, middle + half)))


def quantile(values: np.ndarray, share: float) -> Estimate:  # (V,)
    """Return a quantile with the interval between order statistics that the binomial distribution gives."""
    if len(values) == 0:
        return Estimate(math.nan, math.nan, math.nan)
    ordered = np.sort(values)
    tail = (1.0 - CONFIDENCE) / 2.0
    low = int(binom.ppf(tail, len(ordered), share))
    high = int(binom.ppf(1.0 - tail, len(ordered), share))
    last = len(ordered) - 1
    return Estimate(
        float(np.quantile(ordered, share)), float(ordered[min(max(low - 1, 0), last)]), float(ordered[min(high, last)])
    )


def binned_quantile_us(counts: np.ndarray, share: float) -> float:  # (bins,)
    """Return the upper edge of the bin of TIME_BINS_US that holds a quantile, us; NaN if nothing was counted."""
    total = int(counts.sum())
    if total == 0:
        return math.nan
    index = int(np.searchsorted(np.cumsum(counts), share * total))
    return float(TIME_BINS_US[min(index, len(counts) - 1) + 1])


def behind(one: Summary, other: Summary) -> list[str]:
    """Return the figures in which `one` is worse than another law over the same family, beyond both their intervals."""
    found = []
    if one.arrivals.high < other.arrivals.low:
        found.append("arrivals")
    if one.entered.low > other.entered.high:
        found.append("entries")
    if one.ratio_median.low > other.ratio_median.high:
        found.append("median path ratio")
    return found
