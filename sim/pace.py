"""The pace of a flight's virtual clock by the wall clock: as fast as it can, some times as fast, or not at all."""

from __future__ import annotations

from dataclasses import dataclass, replace

SLOWEST, FASTEST = 0.1, 1_000.0
"""Least and greatest number of virtual seconds in one of the wall clock."""
LATE_S = 0.05
"""Greatest lateness by the wall clock that is made up for by going faster than asked: that of a sleep, not of work."""


@dataclass(frozen=True)
class Pace:
    """From a moment on, at which both clocks are known; times in seconds."""

    speed: float | None = None
    """Virtual seconds in one of the wall clock; None: as many as the computer manages."""
    playing: bool = True
    """Whether the virtual clock goes on."""
    t_s: float = 0.0
    wall_s: float = 0.0

    def wait_s(self, t_s: float, wall_s: float) -> float | None:
        """Return how long to wait until a time of the flight is reached, 0 if it is; None while the clock stands."""
        if not self.playing:
            return None
        if self.speed is None:
            return 0.0
        return max(0.0, self.wall_s + (t_s - self.t_s) / self.speed - wall_s)

    def kept(self, t_s: float, wall_s: float) -> Pace:
        """Return the pace with which to go on at a time: one that is late goes on from there, and makes up LATE_S."""
        if self.speed is None or not self.playing:
            return self
        due_s = self.wall_s + (t_s - self.t_s) / self.speed
        return self if wall_s - due_s <= LATE_S else replace(self, t_s=t_s, wall_s=wall_s - LATE_S)

    def changed(self, t_s: float, wall_s: float, *, speed: float | None = None, playing: bool | None = None) -> Pace:
        """Return the pace from now on with another speed, or another state of the clock; None leaves either."""
        return replace(
            self,
            speed=self.speed if speed is None else speed,
            playing=self.playing if playing is None else playing,
            t_s=t_s,
            wall_s=wall_s,
        )
