"""What the autopilot says of its own estimate of place and height, and of the receivers that it is made from.

An autopilot flies by its estimate, not by one sensor: with two receivers it flies on when the first dies, and without
any for as long as its estimate holds. So its estimate decides whether it can be steered; a receiver decides only where
no estimate is told (EKF_STATUS_REPORT of ArduPilot, ESTIMATOR_STATUS of PX4).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega, common

from companion.autopilot.intake import Message

ESTIMATE_MAX_AGE_S = 3.5
"""Age from which what the autopilot said of its estimate no longer counts: of the one report a second that is asked
for, three in a row may be lost."""
RECEIVER_MAX_AGE_S = 10.0
"""Age from which a receiver that is no longer told of does not count while another one is."""
REJECTED_RATIO = 1.0
"""Innovation test ratio from which an estimator rejects what a sensor measures (ArduPilot's EKF_STATUS_REPORT: "above
1"; PX4's ESTIMATOR_STATUS: "greater than 1")."""
REJECTED_REPORTS = 2
"""Number of reports in a row that must say so: a single gust, or one bad sample, does it too."""
_KNOWS_PLACE = int(common.ESTIMATOR_POS_HORIZ_ABS)
"""The flag of an absolute horizontal position; EKF_POS_HORIZ_ABS is the same bit."""
_STANDS_STILL = int(common.ESTIMATOR_CONST_POS_MODE)
"""The flag of an estimator that assumes to stand still; EKF_CONST_POS_MODE is the same bit."""
_EKF_GLITCH = int(ardupilotmega.EKF_GPS_GLITCHING)
_PX4_GLITCH = int(common.ESTIMATOR_GPS_GLITCH)


class Estimate(NamedTuple):
    """What the autopilot last said of its own estimate."""

    at_s: float
    absolute: bool
    """Whether it knows an absolute horizontal position."""
    doubt: str | None = None
    """Why that position is not to be trusted, in words; None: nothing is said against it."""
    accuracy_m: float = math.nan
    """Its horizontal accuracy; NaN: not told."""
    rejections: int = 0
    """Number of reports in a row by which it rejects the position that is measured."""


class Receiver(NamedTuple):
    """What one GPS receiver last said."""

    at_s: float
    fix: int
    """Its GPS_FIX_TYPE."""
    accuracy_m: float
    """Its horizontal accuracy; NaN: not told."""


def ekf_status(message: Message, before: Estimate | None, now_s: float) -> Estimate:
    """Return what ArduPilot's EKF_STATUS_REPORT says; `before`: the report before it."""
    return _estimate(message.flags & _EKF_GLITCH, message, message.pos_horiz_variance, before, now_s)


def estimator_status(message: Message, before: Estimate | None, now_s: float) -> Estimate:
    """Return what PX4's ESTIMATOR_STATUS says; `before`: the report before it."""
    estimate = _estimate(message.flags & _PX4_GLITCH, message, message.pos_horiz_ratio, before, now_s)
    return estimate._replace(accuracy_m=message.pos_horiz_accuracy)


def fresh(estimate: Estimate | None, now_s: float) -> Estimate | None:
    """Return what the autopilot said of its estimate, unless that is too old to count."""
    return estimate if estimate is not None and now_s - estimate.at_s <= ESTIMATE_MAX_AGE_S else None


def better(receivers: Mapping[str, Receiver], now_s: float) -> Receiver:
    """Return the receiver that counts: of those heard lately the one with the better fix, then the better accuracy.

    `receivers` has at least one. If none was heard lately, all of them count.
    """
    heard = [one for one in receivers.values() if now_s - one.at_s <= RECEIVER_MAX_AGE_S]
    return max(heard or receivers.values(), key=_goodness)


def _estimate(glitches: int, message: Message, ratio: float, before: Estimate | None, now_s: float) -> Estimate:
    # A ratio that is not a number is none: nothing was measured.
    rejections = 0 if before is None else before.rejections
    rejections = rejections + 1 if ratio >= REJECTED_RATIO else 0
    doubt = None
    if glitches:
        doubt = "the autopilot's estimate says GPS glitch"
    elif rejections >= REJECTED_REPORTS:
        doubt = f"the autopilot's estimate rejects the position it measures (test ratio {ratio:.1f})"
    absolute = bool(message.flags & _KNOWS_PLACE) and not message.flags & _STANDS_STILL
    return Estimate(now_s, absolute, doubt, rejections=rejections)


def _goodness(receiver: Receiver) -> tuple[int, float]:
    return receiver.fix, -math.inf if math.isnan(receiver.accuracy_m) else -receiver.accuracy_m
