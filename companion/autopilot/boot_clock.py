"""One autopilot's clock, `time_boot_ms`: what is newer, what comes late, what is a restart, and what somebody else's.

A frame is late if a newer one is there already. Nothing follows from one frame that does not fit: a restart begins near
0 and stays there, and a clock that leaps is believed once the one before it is silent.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

from companion.geo.degrees import metres_between

WRAP_MS = 2**32
"""The clock begins again at 0 after this time, 49.7 days."""
AHEAD_MS = 1_000
"""How far a clock may be ahead of what has passed since its last frame."""
CLOCK_RATE = 2.0
"""Greatest rate at which an autopilot's clock runs against this computer's; beyond it frames must confirm a leap. A
simulator that is sped up stays within AHEAD_MS from frame to frame."""
LATE_MS = 30_000
"""Longest time by which a frame may come late: one that is older is of another clock. A modem keeps no more."""
RESTART_SLACK_MS = 300
"""How much older a clock may be than the time since the clock before it was last heard, to be that of a restart."""
RESTART_FRAMES = 3
"""Number of frames near 0, each later than the one before, that make a restart."""
RESTART_QUIET_S = 0.5
"""Time for which the clock before a restart must have been silent: an autopilot takes longer to start."""
LEAP_FRAMES = 5
"""Number of frames, each later than the one before, that make a leap of the clock that is no restart."""
LEAP_QUIET_S = 1.0
"""Time for which the clock before a leap must have been silent."""
SHARED_TURNS = 3
"""Number of times within SHARED_WITHIN_S that each of two clocks went on after the other: two autopilots."""
SHARED_CONTRADICTIONS = 20
"""Number of positions within SHARED_WITHIN_S where the vehicle cannot have been then: two autopilots."""
SHARED_WITHIN_S = 10.0
"""Time within which signs of two autopilots are counted."""
SHARED_MEMORY_S = 30.0
"""Time after the last sign of two autopilots for which they are still assumed."""
FASTEST_M_S = 100.0
"""Speed that no vehicle here has."""
PLACE_TOLERANCE_M = 3.0
"""Distance between a late position and the vehicle's place at that time that is none: rounding and interpolation."""
ACCELERATION_M_S2 = 10.0
"""Acceleration of a vehicle between two positions, for the tolerance of a place between them."""
MAX_PLACES = 1_000
"""Greatest number of positions that are kept for the comparison with late ones."""


class Clocked(Enum):
    """What the time of a frame says of it."""

    NEWER = "newer"
    """The clock went on."""
    SAME = "same"
    """The clock stands where it stood."""
    LATE = "late"
    """A newer frame of the autopilot is there already; of its kind this one may still be the newest."""
    BEFORE = "late, from before the restart"
    UNCONFIRMED = "clock not confirmed"
    """The time does not follow on the times before; nothing is believed until further frames confirm it."""


class _Place(NamedTuple):
    """A position, and the autopilot's clock then, unwrapped."""

    boot_ms: int
    lat_e7: float
    lon_e7: float


@dataclass(frozen=True)
class _Run:
    """A clock as it went on: its newest time, unwrapped, when that came, and the number of frames."""

    newest_ms: int
    at_s: float
    frames: int = 1
    near_zero: bool = False
    """Whether every frame so far may be of an autopilot that has restarted."""

    def ahead_ms(self, boot_ms: int) -> int:
        """Return how far a time of 32 bits is ahead of the newest one; negative: behind."""
        return (boot_ms - self.newest_ms + WRAP_MS // 2) % WRAP_MS - WRAP_MS // 2

    def most_ahead_ms(self, now_s: float) -> float:
        """Return how far ahead of the newest time the clock may be by now."""
        return AHEAD_MS + CLOCK_RATE * 1e3 * max(0.0, now_s - self.at_s)

    def went_on(self, ahead_ms: int, now_s: float, near_zero: bool) -> _Run:
        """Return the clock after a further frame."""
        return replace(
            self,
            newest_ms=self.newest_ms + ahead_ms,
            at_s=now_s,
            frames=self.frames + 1,
            near_zero=self.near_zero and near_zero,
        )


class TwoAutopilots:
    """The signs within a time that two autopilots share a system id."""

    def __init__(self) -> None:
        self.noticed_s = -math.inf
        """When the signs were last enough."""
        self._turns_s: deque[float] = deque(maxlen=SHARED_TURNS)
        self._contradictions_s: deque[float] = deque(maxlen=SHARED_CONTRADICTIONS)

    def note_turn(self, now_s: float) -> None:
        """Count a time that one clock went on after another one did."""
        self._note(self._turns_s, now_s)

    def note_contradiction(self, now_s: float) -> None:
        """Count a position where the vehicle cannot have been then."""
        self._note(self._contradictions_s, now_s)

    def _note(self, times_s: deque[float], now_s: float) -> None:
        times_s.append(now_s)
        if len(times_s) == times_s.maxlen and now_s - times_s[0] <= SHARED_WITHIN_S:
            self.noticed_s = now_s


class BootClock:
    """Judges the times of an autopilot's frames. Times of arrival are the caller's, in seconds of one clock."""

    def __init__(self) -> None:
        self.restarts = 0
        """Number of times that the clock began anew: the autopilot restarted, or another one took its place."""
        self.two = TwoAutopilots()
        self._run: _Run | None = None
        self._other: _Run | None = None
        self._retired: _Run | None = None
        self._places: deque[_Place] = deque(maxlen=MAX_PLACES)
        self._other_went_on = False

    def late_by_s(self, boot_ms: int) -> float:
        """Return by how much a time is behind the newest one."""
        return 0.0 if self._run is None else max(0.0, -self._run.ahead_ms(boot_ms) / 1e3)

    def take(self, boot_ms: int, now_s: float) -> Clocked:
        """Judge the time of one of the autopilot's frames, and go on with it if it is newer."""
        run = self._run
        if run is None:
            self._run = _Run(boot_ms, now_s)
            return Clocked.NEWER
        ahead_ms = run.ahead_ms(boot_ms)
        if 0 < ahead_ms <= run.most_ahead_ms(now_s):
            self._run = run.went_on(ahead_ms, now_s, False)
            self._note_turn(now_s)
            return Clocked.NEWER
        if ahead_ms == 0:
            return Clocked.SAME
        near_zero = boot_ms <= 1e3 * (now_s - run.at_s) + RESTART_SLACK_MS
        if not near_zero and self._is_of_the_one_before(boot_ms, now_s):
            return Clocked.BEFORE
        if not near_zero and -LATE_MS <= ahead_ms < 0:
            return Clocked.LATE
        return self._take_other(boot_ms, near_zero, now_s)

    def note_place(self, boot_ms: int, lat_e7: int, lon_e7: int, now_s: float) -> None:
        """Keep a position that is newer than all before; a sign of two autopilots, if no vehicle is as fast."""
        place = _Place(self._unwrapped(boot_ms), lat_e7, lon_e7)
        if self._places:
            last = self._places[-1]
            if _metres(last, place) > PLACE_TOLERANCE_M + FASTEST_M_S * (place.boot_ms - last.boot_ms) / 1e3:
                self.two.note_contradiction(now_s)
        self._places.append(place)

    def compare_place(self, boot_ms: int, lat_e7: int, lon_e7: int, now_s: float) -> None:
        """Count a position that is not newer as a sign of two autopilots, unless the vehicle was there at that time."""
        places, place = self._places, _Place(self._unwrapped(boot_ms), lat_e7, lon_e7)
        after = next((k for k in range(len(places) - 1, -1, -1) if places[k].boot_ms <= place.boot_ms), -1) + 1
        if after == 0:
            return
        start, end = places[after - 1], places[min(after, len(places) - 1)]
        gap_ms = end.boot_ms - start.boot_ms
        share = (place.boot_ms - start.boot_ms) / gap_ms if gap_ms else 0.0
        lat, lon = (start[k] + share * (end[k] - start[k]) for k in (1, 2))
        if _metres(_Place(0, lat, lon), place) > PLACE_TOLERANCE_M + ACCELERATION_M_S2 * (gap_ms / 1e3) ** 2:
            self.two.note_contradiction(now_s)

    def _take_other(self, boot_ms: int, near_zero: bool, now_s: float) -> Clocked:
        """Judge a time that does not follow: a clock of its own, which takes the place of a silent one in the end."""
        other = self._other
        ahead_ms = 0 if other is None else other.ahead_ms(boot_ms)
        if other is not None and -LATE_MS <= ahead_ms <= 0:
            return Clocked.UNCONFIRMED
        if other is None or ahead_ms > other.most_ahead_ms(now_s) or ahead_ms < 0:
            self._other = _Run(boot_ms, now_s, near_zero=near_zero)
            self._other_went_on = False
            return Clocked.UNCONFIRMED
        self._other = other = other.went_on(ahead_ms, now_s, near_zero)
        self._other_went_on = True
        run = self._run
        assert run is not None
        frames, quiet_s = (RESTART_FRAMES, RESTART_QUIET_S) if other.near_zero else (LEAP_FRAMES, LEAP_QUIET_S)
        if not other.near_zero and 0 < run.ahead_ms(other.newest_ms) <= LATE_MS:
            # The one so far is what comes late, by a second way; were it another vehicle, the places would tell.
            quiet_s = 0.0
        if other.frames < frames or now_s - run.at_s < quiet_s:
            return Clocked.UNCONFIRMED
        self._run, self._other, self._other_went_on = other, None, False
        if other.near_zero or run.ahead_ms(boot_ms) < 0:
            self.restarts += 1
            self._retired = replace(run, at_s=now_s)
            self._places.clear()
        return Clocked.NEWER

    def _note_turn(self, now_s: float) -> None:
        """Count that the clock went on after another one did, which is no other one where it may be late or early."""
        run, other = self._run, self._other
        if run is None or other is None:
            return
        ahead_ms = run.ahead_ms(other.newest_ms)
        if -LATE_MS <= ahead_ms < 0:
            self._other = None
        elif self._other_went_on and abs(ahead_ms) > LATE_MS:
            self.two.note_turn(now_s)
        self._other_went_on = False

    def _unwrapped(self, boot_ms: int) -> int:
        return boot_ms if self._run is None else self._run.newest_ms + self._run.ahead_ms(boot_ms)

    def _is_of_the_one_before(self, boot_ms: int, now_s: float) -> bool:
        """Return whether a time is a late one of the clock before the last restart."""
        before = self._retired
        if before is None or 1e3 * (now_s - before.at_s) > LATE_MS:
            return False
        return -LATE_MS <= before.ahead_ms(boot_ms) <= 0


def _metres(one: _Place, other: _Place) -> float:
    """Return the distance of two places."""
    return math.hypot(*metres_between((one.lat_e7 / 1e7, one.lon_e7 / 1e7), (other.lat_e7 / 1e7, other.lon_e7 / 1e7)))
