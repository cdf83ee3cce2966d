"""How a vehicle answered its setpoints: the share of a rate, and the delay, that explain a stretch of its track best.

The vehicle's model is one number that follows what was asked of it (a course or a speed): from a delay after the
setpoint on it changes at no more than a share of a known rate until it is there. A fit is a comparison of many such
models, each over the whole stretch, so that no single sample decides anything.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

SHARES = (1.0, 0.85, 0.72, 0.61, 0.52, 0.44, 0.37, 0.32, 0.27, 0.23, 0.19, 0.16, 0.14, 0.12, 0.1)
"""Shares of the rate that are compared, the greatest first: neighbours differ by a sixth, as well as a turn tells."""
DELAYS_S = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5)
"""Delays that are compared, in addition to the one that is reckoned with."""
SUBSTEP_S = 0.25
"""Greatest step in which the models are followed."""
MOST_SUBSTEPS = 160
"""Most steps in which the models are followed, so that a long stretch costs no more than a short one."""
ALIKE = 1.05
"""Costs up to this factor apart count as the same; the mildest of such models is taken."""


class Point(NamedTuple):
    """One sample of a track: what was measured, what had been asked for up to then, and the rate of the model."""

    at_s: float
    value: float
    """The measured course (rad, without a step of a whole turn between two points) or speed (m/s)."""
    asked: float
    """The value of the setpoint that was in force before this sample; a course within half a turn of `value`."""
    rate: float
    """The greatest rate at which the model changes, before any share of it; in the unit of `value` per second."""


class Fit(NamedTuple):
    """The model that explains a track best, and the mean distance of track and model."""

    share: float
    delay_s: float
    cost: float
    as_reckoned: float
    """The mean distance of the track from the model that is reckoned with."""


def fitted(points: Sequence[Point], share: float, delay_s: float) -> Fit:
    """Return the model that explains the points best.

    Args:
        points: At least two samples in order of their times.
        share: The share of the rate that is reckoned with; no greater one is compared.
        delay_s: The delay in seconds that is reckoned with; no smaller one is compared.

    """
    shares = np.array([one for one in SHARES if one < share] + [share])
    delays_s = np.array([delay_s] + [delay_s + one for one in DELAYS_S if one > 0.0])
    at_s = np.array([point.at_s for point in points])
    values = np.array([point.value for point in points])
    span_s = float(at_s[-1] - at_s[0])
    count = min(max(math.ceil(span_s / SUBSTEP_S), 1), MOST_SUBSTEPS)
    times_s = np.linspace(at_s[0], at_s[-1], count + 1)
    step_s = span_s / count
    seen = np.interp(times_s, at_s, values)
    # A setpoint that was in force before sample k acted since sample k - 1.
    asked = np.array([point.asked for point in points])
    rates = np.array([point.rate for point in points])
    nearest = np.clip(np.searchsorted(at_s, times_s[1:] - 1e-9), 1, len(points) - 1)
    heard = np.searchsorted(at_s, times_s[1:, None] - 1e-9 - delays_s[None, :])
    targets = asked[np.clip(heard, 1, len(points) - 1)]
    # Before the first sample nothing is known of what was asked for: the vehicle was where it was wanted.
    targets = np.where(heard < 1, values[0], targets)
    model = np.full((len(delays_s), len(shares)), values[0])
    cost = np.zeros_like(model)
    for k in range(count):
        most = rates[nearest[k]] * step_s * shares[None, :]
        model = model + np.clip(targets[k][:, None] - model, -most, most)
        cost += np.abs(model - seen[k + 1])
    cost /= count
    as_reckoned = float(cost[0, -1])
    best = float(cost.min())
    # The mildest is the one that has turned a radian, or changed by a metre per second, first.
    typical = max(float(np.median(rates)), 1e-6)
    harm_s = delays_s[:, None] + 1.0 / (typical * shares[None, :])
    harm_s = np.where(cost <= ALIKE * best + 1e-9, harm_s, math.inf)
    row, column = np.unravel_index(int(np.argmin(harm_s)), harm_s.shape)
    return Fit(float(shares[column]), float(delays_s[row]), float(cost[row, column]), as_reckoned)
