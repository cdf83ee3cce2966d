"""ArduCopter's horizontal controller and its airframe: why a copter at its lean limit goes on instead of turning.

Read in ArduPilot's source (AC_PosControl.cpp, AC_PID_2D.cpp and AP_Math/control.cpp of V4.7.0-dev), gains and filters
with their defaults. A wanted velocity shapes a desired one, limited in acceleration and jerk. Errors of place and
velocity correct the vehicle, an integrator learns the drag. The sum is limited to the lean of ANGLE_MAX, and what lies
across the desired velocity comes first. While the limit acts, the desired velocity stays as it is if its change points
the way of the limit: a setpoint that asks for a little more of what cannot be had is not followed at all, one far from
the course is. That is how a real copter flies away in a wind that it cannot fly against.

Horizontal vectors are complex numbers here: north + 1j east, along the grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.geo.kinematics import GRAVITY_M_S2
from sim.vehicles.setpoint import followed_share

_PLACE_GAIN_1_S = 1.0
"""PSC_POSXY_P (code, default)."""
_GAIN_1_S, _INTEGRAL_GAIN_1_S2, _DERIVATIVE_GAIN = 2.0, 1.0, 0.25
"""PSC_VELXY_P, PSC_VELXY_I and PSC_VELXY_D (code, defaults)."""
_INTEGRAL_MAX_M_S2 = 10.0
"""PSC_VELXY_IMAX (code, default)."""
_FILTER_S = 1.0 / (math.tau * 5.0)
"""Time constant of PSC_VELXY_FLTE and PSC_VELXY_FLTD, 5 Hz (code, defaults)."""
_CORNER_SHARE = math.sqrt(0.5)
"""Share of the acceleration that is kept for the way across the wanted velocity (code)."""
_LEAN_LAG_S = 0.15
"""Time constant with which the lean follows its demand. A step to 5 m/s is then 90 % done after 2.35 s, as measured."""
_DRAG_1_S, _DRAG_1_M = 0.3208, 0.0222
"""Drag per mass, linear and quadratic in the airspeed, as in the simulator's frame (momentum of the rotors, area). Both
are fitted to the measured top speeds, 10.3 m/s at a lean of 30 degrees and 15.0 m/s at 45 degrees."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """What limits the controller in the present mode, by the autopilot's parameters."""

    acceleration_m_s2: float
    jerk_m_s3: float
    lean_m_s2: float
    """Acceleration at the greatest lean."""
    correction_m_s: float
    """Greatest speed with which an error of the place is corrected."""


class CopterControl:
    """The state of the controller and the lean of the airframe that follows it."""

    def __init__(self, velocity_m_s: complex, lean_m_s2: complex) -> None:
        """Begin as a mode does when it is entered: at the present velocity, with the present lean as what is learnt."""
        self.lean_m_s2 = lean_m_s2
        """Acceleration by the present lean."""
        self._behind_m = 0j
        """Desired place less the true one."""
        self._velocity_m_s = velocity_m_s
        self._acceleration_m_s2 = 0j
        self._integral_m_s2 = lean_m_s2
        self._error_m_s = 0j
        self._derivative_m_s2 = 0j
        self._limit_m_s2 = 0j
        """What was demanded beyond the greatest lean; 0 while the lean is not limited."""

    def step(
        self, wanted_m_s: complex, velocity_m_s: complex, wind_m_s: complex, bounds: Bounds, dt_s: float
    ) -> complex:
        """Return the velocity over the ground after `dt_s`, on the way from the present one to the wanted one."""
        self._shape(wanted_m_s, bounds, dt_s)
        demanded_m_s2 = self._demand(velocity_m_s, bounds, dt_s)
        leaning_m_s2 = _leaning(demanded_m_s2, self._velocity_m_s, bounds.lean_m_s2)
        self._limit_m_s2 = demanded_m_s2 if abs(demanded_m_s2) > bounds.lean_m_s2 else 0j
        self.lean_m_s2 += (leaning_m_s2 - self.lean_m_s2) * followed_share(dt_s, _LEAN_LAG_S)
        after_m_s = velocity_m_s + (self.lean_m_s2 - drag_m_s2(velocity_m_s - wind_m_s)) * dt_s
        self._advance(0.5 * (velocity_m_s + after_m_s) * dt_s, bounds, dt_s)
        return after_m_s

    def _shape(self, wanted_m_s: complex, bounds: Bounds, dt_s: float) -> None:
        """Change the desired acceleration towards what leads to the wanted velocity (shape_vel_accel_xy)."""
        most_m_s2 = bounds.acceleration_m_s2
        away_m_s = wanted_m_s - self._velocity_m_s
        push_m_s2 = _rooted(away_m_s, bounds.jerk_m_s3 / most_m_s2, bounds.jerk_m_s3)
        push_m_s2 = _within(push_m_s2, abs(away_m_s) / dt_s)
        along = wanted_m_s / abs(wanted_m_s) if wanted_m_s else 0j
        ahead_m_s2 = _dot(along, push_m_s2)
        across_m_s2 = push_m_s2 - along * ahead_m_s2
        if not along or abs(ahead_m_s2) <= abs(across_m_s2):
            push_m_s2 = _within(push_m_s2, most_m_s2)
        else:
            across_m_s2 = _within(across_m_s2, _CORNER_SHARE * most_m_s2)
            push_m_s2 = across_m_s2 + along * _left(ahead_m_s2, across_m_s2, most_m_s2)
        self._acceleration_m_s2 += _within(push_m_s2 - self._acceleration_m_s2, bounds.jerk_m_s3 * dt_s)

    def _demand(self, velocity_m_s: complex, bounds: Bounds, dt_s: float) -> complex:
        """Return the acceleration that place and velocity demand, not yet limited to the lean (AC_PID_2D)."""
        correction_m_s = _rooted(self._behind_m, _PLACE_GAIN_1_S, bounds.acceleration_m_s2)
        share = followed_share(dt_s, _FILTER_S)
        change_m_s = (self._velocity_m_s + correction_m_s - velocity_m_s - self._error_m_s) * share
        self._error_m_s += change_m_s
        self._derivative_m_s2 += (change_m_s / dt_s - self._derivative_m_s2) * share
        more_m_s2 = self._error_m_s * (_INTEGRAL_GAIN_1_S2 * dt_s)
        longest_m_s2 = _INTEGRAL_MAX_M_S2
        if _dot(more_m_s2, self._limit_m_s2) > 0.0:
            longest_m_s2 = min(longest_m_s2, abs(self._integral_m_s2))
        self._integral_m_s2 = _within(self._integral_m_s2 + more_m_s2, longest_m_s2)
        correction_m_s2 = _GAIN_1_S * self._error_m_s + _DERIVATIVE_GAIN * self._derivative_m_s2
        return correction_m_s2 + self._integral_m_s2 + self._acceleration_m_s2

    def _advance(self, moved_m: complex, bounds: Bounds, dt_s: float) -> None:
        """Move the desired place and velocity on, unless the limit forbids it (update_pos_vel_accel_xy)."""
        limit_m_s2 = self._limit_m_s2
        forward_m = (self._velocity_m_s + 0.5 * self._acceleration_m_s2 * dt_s) * dt_s
        if _dot(forward_m, limit_m_s2) > 0.0 and _dot(self._behind_m, limit_m_s2) > 0.0:
            forward_m = 0j
        near_m = bounds.acceleration_m_s2 / _PLACE_GAIN_1_S**2
        longest_m = 0.5 * near_m + 0.5 * bounds.correction_m_s**2 / bounds.acceleration_m_s2
        if bounds.correction_m_s < near_m * _PLACE_GAIN_1_S:
            longest_m = bounds.correction_m_s / _PLACE_GAIN_1_S
        self._behind_m = _within(self._behind_m + forward_m - moved_m, longest_m)
        change_m_s = self._acceleration_m_s2 * dt_s
        worse = _dot(change_m_s, limit_m_s2) > 0.0 and _dot(self._error_m_s, limit_m_s2) > 0.0
        if not (worse and _dot(self._velocity_m_s, limit_m_s2) >= 0.0):
            self._velocity_m_s += change_m_s


def lean_m_s2(angle_rad: float) -> float:
    """Return the horizontal acceleration that a lean gives to a copter that keeps its height."""
    return GRAVITY_M_S2 * math.tan(angle_rad)


def drag_m_s2(air_m_s: complex) -> complex:
    """Return the lean (as an acceleration) that balances the drag at a velocity through the air."""
    return air_m_s * (_DRAG_1_S + _DRAG_1_M * abs(air_m_s))


def _leaning(demanded_m_s2: complex, velocity_m_s: complex, most_m_s2: float) -> complex:
    """Return the demand within the greatest lean, what lies across the desired velocity first (limit_accel_xy)."""
    if abs(demanded_m_s2) <= most_m_s2:
        return demanded_m_s2
    if not velocity_m_s:
        return _within(demanded_m_s2, most_m_s2)
    along = velocity_m_s / abs(velocity_m_s)
    ahead_m_s2 = _dot(along, demanded_m_s2)
    across_m_s2 = _within(demanded_m_s2 - along * ahead_m_s2, most_m_s2)
    return across_m_s2 + along * _left(ahead_m_s2, across_m_s2, most_m_s2)


def _left(ahead: float, across: complex, most: float) -> float:
    """Return as much of a component as a vector across it leaves of a greatest length."""
    left = math.sqrt(max(most**2 - abs(across) ** 2, 0.0))
    return min(max(ahead, -left), left)


def _rooted(error: complex, gain: float, second_limit: float) -> complex:
    """Return the correction of an error: proportional while small, its root further out (sqrt_controller)."""
    length = abs(error)
    near = second_limit / gain**2
    if length <= near:
        return error * gain
    return error * (math.sqrt(2.0 * second_limit * (length - 0.5 * near)) / length)


def _dot(one: complex, other: complex) -> float:
    return one.real * other.real + one.imag * other.imag


def _within(vector: complex, longest: float) -> complex:
    length = abs(vector)
    return vector if length <= longest else vector * (longest / length)
