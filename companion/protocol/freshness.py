"""Which of two broadcasts is the newer one, and how old one is: the rules that every receiver goes by.

A broadcast is known by its epoch (one run of a ground station) and, within it, its sequence; newest wins.
"""

from __future__ import annotations

import math

from companion.protocol.frame import FrameStamp
from companion.protocol.messages import Stamp

AnyStamp = FrameStamp | Stamp
"""As read off a raw frame, or of a decoded one."""
RESTART_AFTER_S = 30.0
"""After a silence of this length an older stamp may begin anew: a sender whose clock was set back, or one whom a single
frame of somebody else's, stamped ahead, had shut out."""

FUTURE_STAMP = "stamped in the future"
PAST_STAMP = "stamped too long ago"
OLD_EPOCH = "old epoch"
OLD_SEQUENCE = "old sequence"


def off_the_clock(stamp: AnyStamp, now_s: float, ahead_s: float, max_age_s: float) -> str | None:
    """Return why a stamp is refused by a clock that agrees with the sender's, None if it is of now."""
    age_s = now_s - stamp.epoch_s - stamp.time_ms / 1000.0
    if age_s < -ahead_s:
        return FUTURE_STAMP
    return PAST_STAMP if age_s > max_age_s else None


def overtaken(stamp: AnyStamp, newest: tuple[int, int], silent_s: float) -> str | None:
    """Return why a stamp is older than the newest broadcast, given by epoch and sequence; None if it is not.

    After `silent_s` of at least RESTART_AFTER_S no stamp is too old.
    """
    if (stamp.epoch_s, stamp.sequence) >= newest or silent_s >= RESTART_AFTER_S:
        return None
    return OLD_EPOCH if stamp.epoch_s < newest[0] else OLD_SEQUENCE


class SenderClock:
    """Says when what a frame tells was true, by the vehicle's clock."""

    def __init__(self, *, agrees: bool = True) -> None:
        """`agrees`: the two clocks show the same time; if not, only differences on the sender's are believed."""
        self._agrees = agrees
        self._epoch_s: int | None = None
        self._least_s = math.inf
        """Least time of arrival less stamp in this epoch: of the frame that was on its way for the shortest time."""

    def true_at_s(self, stamp: Stamp, received_s: float) -> float:
        """Return when a frame that came at `received_s` was true, at most that.

        Where clocks do not agree, what the quickest frame of the epoch took on its way is not known and taken as none.
        """
        if self._agrees:
            # A sender's clock behind ours means an old frame; ahead of ours, only the arrival can be believed.
            return min(received_s, stamp.unix_s)
        if stamp.epoch_s != self._epoch_s:
            self._epoch_s, self._least_s = stamp.epoch_s, math.inf
        self._least_s = min(self._least_s, received_s - stamp.unix_s)
        return stamp.unix_s + self._least_s
