"""Interpolation of the headings that guidance decides each half second to a course that changes at a steady rate.

Guidance decides headings that the vehicle can reach within a step. Sent unchanged they would form a staircase, which an
autopilot follows with a jerk at each step and a lag between. The rate of the course lets an adapter lead it.
"""

from __future__ import annotations

import math

RAMP_S = 0.5
"""Time in which the course reaches a new heading if the greatest turn rate allows it: the default guidance step."""
GAP_S = 2.0
"""Time without a heading after which the course begins anew at the vehicle's present one."""


class CourseRamp:
    """The commanded course on its way to the newest heading. All its angles must be from the same north."""

    def __init__(self) -> None:
        self._course_rad: float | None = None
        self._wanted_rad = 0.0
        self._rate_rad_s = 0.0
        self._at_s = -math.inf

    def towards(
        self, wanted_rad: float, present_rad: float, rate_max_rad_s: float, now_s: float
    ) -> tuple[float, float]:
        """Return the course at `now_s` and its rate (rad/s) towards `wanted_rad`; the first one is `present_rad`."""
        elapsed_s = now_s - self._at_s
        self._at_s = now_s
        if self._course_rad is None or not 0.0 <= elapsed_s <= GAP_S:
            self._course_rad = present_rad
            self._aim(wanted_rad, rate_max_rad_s)
            return self._course_rad, self._rate_rad_s
        to_go_rad = math.remainder(self._wanted_rad - self._course_rad, math.tau)
        step_rad = self._rate_rad_s * elapsed_s
        if abs(step_rad) >= abs(to_go_rad):
            self._course_rad, self._rate_rad_s = self._wanted_rad, 0.0
        else:
            self._course_rad += step_rad
        if wanted_rad != self._wanted_rad:
            self._aim(wanted_rad, rate_max_rad_s)
        return self._course_rad, self._rate_rad_s

    def release(self) -> None:
        """Forget the course, so that the next one begins at the vehicle's present one."""
        self._course_rad = None

    def _aim(self, wanted_rad: float, rate_max_rad_s: float) -> None:
        to_go_rad = math.remainder(wanted_rad - (self._course_rad or 0.0), math.tau)
        self._wanted_rad = wanted_rad
        self._rate_rad_s = min(max(to_go_rad / RAMP_S, -rate_max_rad_s), rate_max_rad_s)
