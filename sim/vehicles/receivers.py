"""A stand-in's GPS receivers: which have a fix, and how long the autopilot's estimate holds without any."""

from __future__ import annotations

import math

_BACK_S = 1.4
"""Time with a fix again after which an estimate that had ended knows its place again (measured: 0.4 s on ArduPilot, 1.4
s on PX4)."""


class Receivers:
    """The GPS receivers of one vehicle; with two the estimate holds while one of them has a fix."""

    def __init__(self) -> None:
        """Begin with one receiver that has a fix."""
        self.fixes = [True]
        """Whether each receiver has a fix; the owner may add a second one."""
        self.holds_s = math.inf
        """Time without any fix for which the estimate knows its place."""
        self.lost_at_s: float | None = None
        """When the last fix was lost; None: there is one."""
        self._blind_until_s = -math.inf

    def lose_fix(self, lost: bool, now_s: float, receiver: int | None = None) -> None:
        """Make a receiver, counted from 0, lose its fix at `now_s`, or find it again; None stands for all of them."""
        for number in range(len(self.fixes)) if receiver is None else (receiver,):
            self.fixes[number] = not lost
        if not any(self.fixes):
            self.lost_at_s = now_s if self.lost_at_s is None else self.lost_at_s
        elif self.lost_at_s is not None:
            self._blind_until_s = -math.inf if self.know_place(now_s) else now_s + _BACK_S
            self.lost_at_s = None

    def know_place(self, now_s: float) -> bool:
        """Return whether the estimate knows an absolute position."""
        held = self.lost_at_s is None or now_s - self.lost_at_s < self.holds_s
        return held and now_s >= self._blind_until_s
