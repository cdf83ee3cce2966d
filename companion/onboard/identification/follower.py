"""Least squares for a vehicle that follows a command: its delay and its greatest rate, each with a 95 % interval.

The model is the guard's: a command begins to act a pure delay after it was given; then the vehicle's value (course or
speed) moves to it at a greatest rate and stays there. The fit is a grid, refined about its best cell, so that it needs
no start value and cannot run into a local minimum. An interval holds every value that fits nearly as well for some
value of the other parameter (profile likelihood); neighbouring residuals that are alike count as fewer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

LONGEST_DELAY_S = 3.0
"""Greatest delay that is looked for: no vehicle of docs/autopilots.md lags by half of it."""
STEP_S = 0.05
"""Longest step of the model's motion: half the period of the fastest telemetry that is asked for."""
CELLS = 20
"""Cells of the grid along each parameter."""
REFINEMENTS = 8
"""Greatest number of grids, each about the best cells of the one before."""
LEAST_GRIDS = 3
"""Least number of grids: the value itself is known to a cell of the last."""
ENOUGH_CELLS = 12
"""Number of cells within the interval from which it is resolved."""
KEPT_CELLS = 0.05
"""Share of a grid's cells about which the next grid is laid."""
DEVIATIONS = 2.3
"""Half the width of an interval in standard deviations: more than the 1.96 of a normal distribution, for the levels and
the autocorrelation that are estimated first. With it 91 to 98 % of the intervals held the truth, of 120 vehicles."""
LEAST_FREE = 3.0
"""Least number of independent residuals that is reckoned with, however alike neighbouring ones are."""
ASKED_S = 2.0
"""Time over which a rate that is asked for must last to count: single commands come in steps."""
FOLLOWED_SHARE = 0.85
"""Share of the rate that is asked for from which the vehicle counts as following: a greater one is then not known."""
MOST_ALIKE = 0.95
"""Greatest likeness (autocorrelation) of neighbouring residuals that is reckoned with: at 10 Hz a memory of 2 s. What
is alike for longer is no noise but what the model cannot do, and must not hide a vehicle that does not obey."""
DELAY_RESOLUTION_S = 0.05
"""Half the least width of a delay's interval: half the period of telemetry at 10 Hz, the age of its newest."""
RATE_RESOLUTION = 0.02
"""Half the least width of a rate's interval, as a share of the rate: what the model leaves out. Chosen."""


class Estimate(NamedTuple):
    """A measured value and its 95 % interval; `high` is infinite where the value is only known to be at least `low`."""

    value: float
    low: float
    high: float


class Span(NamedTuple):
    """The command and the reply of one value over a part of a flight."""

    command_s: np.ndarray  # (K,) s, increasing
    command: np.ndarray  # (K,)
    reply_s: np.ndarray  # (N,) s, increasing
    reply: np.ndarray  # (N,)
    rate_1_s: np.ndarray  # (N,) the rate of change that a rate of 1 stands for, per second
    offset_free: bool
    """Whether a constant difference between command and reply is no fault (a course that is held a little beside)."""


class Followed(NamedTuple):
    """The delay in seconds and the greatest rate of a follower."""

    delay_s: Estimate
    rate: Estimate
    denied: bool
    """Whether what was reckoned with, delay and rate together, fits worse than what the intervals allow."""


class _Steps(NamedTuple):
    """The model's steps over a span: the time of each step's middle, its length, and the reply that it leads to."""

    at_s: np.ndarray  # (M,)
    long_s: np.ndarray  # (M,)
    reply: np.ndarray  # (M,) index of the reply at the step's end, or -1


def followed(
    spans: Sequence[Span], slowest: float, fastest: float, reckoned: tuple[float, float] | None = None
) -> Followed | None:
    """Return delay and greatest rate (`slowest` to `fastest`) that fit best over all spans; None without any span.

    `reckoned`: the delay (s) and the rate that the vehicle is reckoned with, if the flight is to say whether it is so.
    A rate whose interval reaches `fastest` is only known to be at least its low end.
    """
    spans = [span for span in spans if len(span.reply) > CELLS and len(span.command)]
    if not spans:
        return None
    steps = [_steps(span) for span in spans]
    delays_s = np.linspace(0.0, LONGEST_DELAY_S, CELLS + 1)
    rates = np.geomspace(slowest, fastest, CELLS + 1)
    for grid in range(1, REFINEMENTS + 1):
        squares = np.zeros((CELLS + 1, CELLS + 1))
        for each in zip(spans, steps, strict=True):
            squares += _squares(*each, delays_s, rates)
        at = np.unravel_index(int(np.argmin(squares)), squares.shape)
        best = (float(delays_s[at[0]]), float(rates[at[1]]))
        most = float(squares[at]) * (1.0 + _slack(spans, steps, best)) + np.finfo(float).tiny
        near = np.less_equal(squares, most)
        found = (delays_s[near.max(axis=1)], rates[near.max(axis=0)])
        if grid >= LEAST_GRIDS and np.count_nonzero(near) >= ENOUGH_CELLS:
            break
        # Delay and rate make up for each other: on a coarse grid the best cell need not be next to the best value.
        near = np.less_equal(squares, max(most, float(np.quantile(squares, KEPT_CELLS))))
        low_s, high_s = _about(delays_s, near.max(axis=1), 0.0, LONGEST_DELAY_S)
        low, high = _about(rates, near.max(axis=0), slowest, fastest)
        delays_s, rates = np.linspace(low_s, high_s, CELLS + 1), np.geomspace(low, high, CELLS + 1)
    # What is asked for slowly is followed slowly: that says nothing of what the vehicle can do.
    asked_enough = best[1] < FOLLOWED_SHARE * asked_rate(spans)
    denied = reckoned is not None and asked_enough and _square(spans, steps, reckoned) > most
    return Followed(
        Estimate(
            best[0],
            max(0.0, min(float(found[0][0]), best[0] - DELAY_RESOLUTION_S)),
            max(float(found[0][-1]), best[0] + DELAY_RESOLUTION_S),
        ),
        Estimate(
            best[1],
            min(float(found[1][0]), best[1] * (1.0 - RATE_RESOLUTION)),
            # A rate beyond what the commands ask for fits as well as any greater one.
            math.inf
            if not asked_enough or found[1][-1] >= fastest * (1.0 - 1e-9)
            else max(float(found[1][-1]), best[1] * (1.0 + RATE_RESOLUTION)),
        ),
        bool(denied),
    )


def asked_rate(spans: Sequence[Span]) -> float:
    """Return the greatest rate that the commands ask for over ASKED_S, or over all of a span that has fewer of them."""
    rates = []
    for span in spans:
        within = (span.command_s >= span.reply_s[0] - ASKED_S) & (span.command_s <= span.reply_s[-1])
        times_s, command = span.command_s[within], span.command[within]
        if len(times_s) < 2:
            continue
        later = np.searchsorted(times_s, times_s + min(ASKED_S, float(times_s[-1] - times_s[0])) - STEP_S)
        first = np.nonzero(later < len(times_s))[0]
        later = later[first]
        passed_s = np.maximum(times_s[later] - times_s[first], STEP_S)
        rates.append(
            float(np.max(np.abs(command[later] - command[first]) / passed_s)) / float(np.median(span.rate_1_s))
        )
    return max(rates, default=0.0)


def _about(grid: np.ndarray, near: np.ndarray, least: float, greatest: float) -> tuple[float, float]:
    """Return the ends of the cells that are near enough, with one more on each side, within the whole range."""
    (index,) = np.nonzero(near)
    first, last = max(int(index[0]) - 1, 0), min(int(index[-1]) + 1, len(grid) - 1)
    return max(float(grid[first]), least), min(float(grid[last]), greatest)


def _slack(spans: Sequence[Span], steps: Sequence[_Steps], best: tuple[float, float]) -> float:
    """Return the share by which the sum of squares may exceed its least for a value within the 95 % interval."""
    count, free = 0, 0.0
    for span, step in zip(spans, steps, strict=True):
        off = _residuals(span, step, *best)
        alike = float(off[1:] @ off[:-1] / max(off @ off, np.finfo(float).tiny))
        alike = min(max(alike, 0.0), MOST_ALIKE)
        count += len(off)
        free += len(off) * (1.0 - alike) / (1.0 + alike)
    return DEVIATIONS**2 / max(min(free, count) - 2.0, LEAST_FREE)


def _steps(span: Span) -> _Steps:
    gaps_s = np.diff(span.reply_s)
    counts = np.maximum(np.ceil(gaps_s / STEP_S - 1e-9).astype(int), 1)
    long_s = np.repeat(gaps_s / counts, counts)
    ends = np.cumsum(counts) - 1
    reply = np.full(len(long_s), -1)
    reply[ends] = np.arange(1, len(span.reply))
    at_s = span.reply_s[0] + np.cumsum(long_s) - long_s / 2.0
    return _Steps(at_s, long_s, reply)


def _commanded(span: Span, at_s: np.ndarray) -> np.ndarray:
    """Return the command in force at each time; before the first command, that one."""
    index = np.searchsorted(span.command_s, at_s, side="right") - 1
    commanded: np.ndarray = span.command[np.maximum(index, 0)]
    return commanded


def _squares(span: Span, steps: _Steps, delays_s: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return the sum of squared residuals for each delay and rate, (D, R)."""
    commands = _commanded(span, steps.at_s[:, None] - delays_s[None])  # (M, D)
    limits = span.rate_1_s[np.maximum(np.searchsorted(span.reply_s, steps.at_s) - 1, 0)] * steps.long_s  # (M,)
    state = np.full((len(delays_s), len(rates)), float(span.reply[0]))
    total, squares = np.zeros_like(state), np.zeros_like(state)
    for command, limit, index in zip(commands[:, :, None], limits, steps.reply.tolist(), strict=True):
        most = rates * limit
        state += np.clip(command - state, -most, most)
        if index >= 0:
            off = span.reply[index] - state
            total += off
            squares += off * off
    if span.offset_free:
        squares -= total * total / max(len(span.reply) - 1, 1)
    return squares


def _square(spans: Sequence[Span], steps: Sequence[_Steps], at: tuple[float, float]) -> float:
    """Return the sum of squared residuals over all spans at one delay and rate."""
    point = np.array(at)
    return sum(float(_squares(*each, point[:1], point[1:])[0, 0]) for each in zip(spans, steps, strict=True))


def _residuals(span: Span, steps: _Steps, delay_s: float, rate: float) -> np.ndarray:
    """Return the residuals (N - 1,) of one delay and rate, without a constant offset where that is free."""
    commands = _commanded(span, steps.at_s - delay_s).tolist()
    limits = (
        span.rate_1_s[np.maximum(np.searchsorted(span.reply_s, steps.at_s) - 1, 0)] * steps.long_s * rate
    ).tolist()
    state = float(span.reply[0])
    modelled = []
    for command, limit, index in zip(commands, limits, steps.reply.tolist(), strict=True):
        state += min(max(command - state, -limit), limit)
        if index >= 0:
            modelled.append(state)
    off: np.ndarray = span.reply[1:] - np.array(modelled)
    return off - off.mean() if span.offset_free else off
