"""The ground station's clock: time that never steps, and what the computer's own clock does meanwhile.

Inside, times come from a clock that goes on while the computer sleeps (CLOCK_BOOTTIME) and never steps, so that ages
and due times stay true. Stamps and signing times must agree with the vehicles' clocks, which GNSS or NTP set; so they
follow the computer's clock (CLOCK_REALTIME), which is compared with the first all the time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from companion.protocol.mavlink_signing import MavlinkSigner, timestamp_of
from companion.runtime.clock import logged_s

STEP_S = 0.5
"""Least difference between both clocks that counts as a step: receivers allow 2 s, and NTP slews less."""
SLEPT_S = 0.5
"""Least time for which the computer stood still that counts as sleep."""
MOST_AHEAD_S = 1.5
"""Greatest time by which an epoch or a signing time may be ahead of the clock: receivers refuse frames more than 2 s
ahead of their clocks (companion/protocol/authenticator.py), which may be behind. A restart within the second needs 1 s.
"""
WAITED_FOR_S = 30.0
"""Greatest time by which, after a step back, an epoch or a signing time is ahead of the clock: so long vehicles refuse
it, but those that believed the last one would refuse an earlier one for ever."""
_READ_WITHIN_S = 0.1
"""Time within which both clocks must have been read to be compared."""


def _wall_s() -> float:
    return time.time()


def _monotonic_s() -> float:
    return time.monotonic()


def _boottime_s() -> float:
    # Only Linux has it; elsewhere sleep shows as a step.
    return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()


@dataclass(frozen=True)
class Sources:
    """The clocks of the computer, as functions that return seconds."""

    wall_s: Callable[[], float] = _wall_s
    """Unix time; it may be set."""
    monotonic_s: Callable[[], float] = _monotonic_s
    """Time that stands still while the computer sleeps."""
    boottime_s: Callable[[], float] = _boottime_s
    """The same, but it goes on meanwhile."""


class ClockChange(NamedTuple):
    """What happened to the computer's clocks since they were last compared."""

    slept_s: float = 0.0
    """Time for which the computer slept."""
    stepped_s: float = 0.0
    """Time by which its clock was set forward, negative if back."""

    def __bool__(self) -> bool:
        """Return whether anything happened."""
        return self.slept_s != 0.0 or self.stepped_s != 0.0

    def words(self) -> list[str]:
        """Return the lines about it."""
        lines = []
        if self.slept_s:
            lines.append(
                f"this computer slept {self.slept_s:.0f} s: nothing was broadcast or heard meanwhile; the broadcast "
                "goes on, stamped with the present time"
            )
        if self.stepped_s:
            way = "forward, or it stood still as a paused virtual machine does" if self.stepped_s > 0.0 else "back"
            lines.append(
                f"this computer's clock was set {abs(self.stepped_s):.1f} s {way}: stamps follow it, in a new epoch; a "
                "vehicle whose clock differs from it by more than 2 s refuses them"
            )
        return lines


class GroundClock:
    """A clock of Unix time that never steps, in whole microseconds (see `logged_s`), and a watch on the computer's."""

    def __init__(self, sources: Sources | None = None) -> None:
        self._sources = sources or Sources()
        boottime_s = self._sources.boottime_s()
        self._offset_s = self._sources.wall_s() - boottime_s
        self._asleep_s = boottime_s - self._sources.monotonic_s()
        self.ahead_s = 0.0
        """Time by which the computer's clock is ahead of this one."""

    def now_s(self) -> float:
        """Return seconds since 1970: the computer's clock at the start, carried on while it sleeps or is set."""
        return logged_s(self._offset_s + self._sources.boottime_s())

    def watch(self) -> ClockChange:
        """Compare the clocks, and return what has happened; call it often."""
        sources = self._sources
        monotonic_s = sources.monotonic_s()
        boottime_s, wall_s = sources.boottime_s(), sources.wall_s()
        if sources.monotonic_s() - monotonic_s > _READ_WITHIN_S:
            # The program hung between two readings, which cannot be compared then.
            return ClockChange()
        slept_s = boottime_s - monotonic_s - self._asleep_s
        if slept_s < SLEPT_S:
            slept_s = 0.0
        self._asleep_s += slept_s
        stepped_s = wall_s - self._offset_s - boottime_s - self.ahead_s
        if abs(stepped_s) < STEP_S:
            stepped_s = 0.0
        self.ahead_s += stepped_s
        return ClockChange(slept_s, stepped_s)


class WallSigner(MavlinkSigner):
    """Signs with times of the computer's clock, which is `ahead_s` ahead of the times that it is given."""

    ahead_s = 0.0

    def sign(self, raw: bytes, now_s: float) -> bytes:
        """Return a frame with a MAVLink signature; `now_s` is of the ground station's clock."""
        return super().sign(raw, now_s + self.ahead_s)

    def follow(self, ahead_s: float, now_s: float) -> None:
        """Take the computer's clock as `ahead_s` ahead from now on.

        Where it was set back by more than can be waited for, signing times begin anew.
        """
        self.ahead_s = ahead_s
        if self.last_timestamp > timestamp_of(now_s + ahead_s + WAITED_FOR_S):
            self.last_timestamp = timestamp_of(now_s + ahead_s)


def next_epoch_s(last_s: int, wall_s: float) -> int:
    """Return the epoch that begins where the computer's clock has stepped to `wall_s`: later than the last if possible.

    A vehicle that believed the last one believes only a later one, and only once its clock has come near it. If the
    clock was set back by more than can be waited for, the epoch goes back with it: for those that could not believe the
    last one, because their clocks were right.
    """
    later_s = max(int(wall_s), last_s + 1)
    return later_s if later_s - wall_s <= WAITED_FOR_S else int(wall_s)
