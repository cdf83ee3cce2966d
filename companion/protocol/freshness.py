"""Order and age of broadcasts: the rules that every receiver applies.

A broadcast is identified by its epoch (one run of a ground station) and, within it, its sequence; the newest wins.
"""

from __future__ import annotations

import math

from companion.protocol.frame import FrameStamp
from companion.protocol.messages import Stamp

AnyStamp = FrameStamp | Stamp
"""Stamp of a raw frame or of a decoded one."""
RESTART_AFTER_S = 30.0
"""Length of a silence after which an older stamp is accepted: of a sender whose clock was set back, or that another
sender's single frame, stamped ahead, had shut out."""
LEAP_S = 60.0
"""Least difference between stamps that no delay explains: the sender's clock was set, or is wrong."""

FUTURE_STAMP = "stamped in the future"
PAST_STAMP = "stamped too long ago"
OLD_EPOCH = "old epoch"
OLD_SEQUENCE = "old sequence"


def off_the_clock(stamp: AnyStamp, now_s: float, ahead_s: float, max_age_s: float) -> str | None:
    """Return the reason why a stamp is refused by a clock that agrees with the sender's, None if it is accepted."""
    age_s = now_s - stamp.epoch_s - stamp.time_ms / 1000.0
    if age_s < -ahead_s:
        return FUTURE_STAMP
    return PAST_STAMP if age_s > max_age_s else None


class Lateness:
    """The least lateness of frames, by the vehicle's clock, within a window of time: what no slow link explains."""

    def __init__(self, window_s: float = 30.0) -> None:
        self.window_s = window_s
        self._began_s = -math.inf
        self._least_s = self._before_s = math.inf

    def note(self, late_s: float, now_s: float) -> None:
        """Note how late a frame came: the time since its stamp, negative for one that is stamped ahead."""
        self._turn(now_s)
        self._least_s = min(self._least_s, late_s)

    def least_s(self, now_s: float) -> float | None:
        """Return the least lateness in the window, which is one to two times `window_s` long; None without a frame."""
        self._turn(now_s)
        least_s = min(self._least_s, self._before_s)
        return None if math.isinf(least_s) else least_s

    def _turn(self, now_s: float) -> None:
        passed_s = now_s - self._began_s
        if 0.0 <= passed_s < self.window_s:
            return
        self._before_s = self._least_s if 0.0 <= passed_s < 2.0 * self.window_s else math.inf
        self._began_s, self._least_s = now_s, math.inf


def overtaken(stamp: AnyStamp, newest: tuple[int, int], silent_s: float) -> str | None:
    """Return the reason why a stamp is refused as older than the newest (epoch, sequence), None if it is accepted.

    After a silence of at least RESTART_AFTER_S no stamp is too old.
    """
    if (stamp.epoch_s, stamp.sequence) >= newest or silent_s >= RESTART_AFTER_S:
        return None
    return OLD_EPOCH if stamp.epoch_s < newest[0] else OLD_SEQUENCE


class SenderClock:
    """Converts the times of frames from the sender's clock to the vehicle's."""

    def __init__(self, *, agrees: bool = True) -> None:
        """Set `agrees` if both clocks show the same time; if not, only time differences by the sender's are used."""
        self._agrees = agrees
        self._epoch_s: int | None = None
        self._least_s = math.inf
        """Least difference between arrival and stamp in this epoch: that of the frame with the shortest delay."""
        self._newest_s = -math.inf
        """Stamp of the frame before, by the sender's clock."""

    def true_at_s(self, stamp: Stamp, received_s: float) -> float:
        """Return the time by the vehicle's clock at which a frame's content was true, at most `received_s`.

        If the clocks do not agree, the delay of the epoch's quickest frame is unknown and taken as zero.
        """
        if self._agrees:
            # A stamp before the arrival means an old frame; a stamp after it is wrong, so the arrival counts.
            return min(received_s, stamp.unix_s)
        if stamp.epoch_s != self._epoch_s or stamp.unix_s < self._newest_s - LEAP_S:
            # A stamp far before the last one: the sender's clock was ahead and has been set right.
            self._epoch_s, self._least_s = stamp.epoch_s, math.inf
        self._newest_s = stamp.unix_s
        self._least_s = min(self._least_s, received_s - stamp.unix_s)
        return stamp.unix_s + self._least_s
