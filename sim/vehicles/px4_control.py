"""PX4's velocity control of a copter and its airframe, read in v1.16.1 (PositionControl.cpp, simulator_sih/sih.cpp).

A velocity is followed by a PID; the drag is learnt by its integrator alone, with a time constant of seconds. So the
more drag an airframe has, the longer it takes to turn and to stop: with SIH_KDV 1 the integrator still pushes forward
while the copter brakes. Gains and filters have their defaults.

Horizontal vectors are complex numbers here: north + 1j east, along the grid.
"""

from __future__ import annotations

from sim.vehicles.setpoint import followed_share

_GAIN_1_S, _INTEGRAL_GAIN_1_S2, _DERIVATIVE_GAIN = 1.8, 0.4, 0.2
"""MPC_XY_VEL_P_ACC, MPC_XY_VEL_I_ACC and MPC_XY_VEL_D_ACC (code, defaults)."""
_UNWINDING_GAIN_S = 2.0 / _GAIN_1_S
"""Gain by which the integrator unwinds while the lean is limited (code)."""
_ATTITUDE_LAG_S = 1.0 / 6.5
"""Time constant with which the lean follows its demand: the reciprocal of MC_ROLL_P (code, default)."""
_MOTOR_LAG_S = 0.05
"""SIH_T_TAU, the time constant of the motors (code, default)."""
_RATE_LAG_S = 0.05
"""Time constant of the acceleration that is measured for the derivative (chosen)."""


class Px4Control:
    """The state of the controller, and the lean of the airframe that follows it."""

    def __init__(self, lean_m_s2: complex) -> None:
        """Begin with what is learnt of the drag, and the lean that balances it."""
        self.lean_m_s2 = lean_m_s2
        """Acceleration by the present lean."""
        self._attitude_m_s2 = lean_m_s2
        self._integral_m_s2 = lean_m_s2
        self._measured_m_s2 = 0j

    def demand(self, error_m_s: complex, ahead_m_s2: complex, lean_max_m_s2: float, dt_s: float) -> complex:
        """Return the acceleration for an error of the velocity, with the setpoint's own acceleration `ahead_m_s2`."""
        demanded_m_s2 = (
            _GAIN_1_S * error_m_s + self._integral_m_s2 - _DERIVATIVE_GAIN * self._measured_m_s2 + ahead_m_s2
        )
        length_m_s2 = abs(demanded_m_s2)
        if length_m_s2 > lean_max_m_s2:
            limited_m_s2 = demanded_m_s2 * (lean_max_m_s2 / length_m_s2)
            error_m_s -= _UNWINDING_GAIN_S * (demanded_m_s2 - limited_m_s2)
            demanded_m_s2 = limited_m_s2
        self._integral_m_s2 += error_m_s * (_INTEGRAL_GAIN_1_S2 * dt_s)
        return demanded_m_s2

    def lean(self, demanded_m_s2: complex, velocity_m_s: complex, drag_m_s2: complex, dt_s: float) -> complex:
        """Lean towards a demanded acceleration for `dt_s` against a drag; return the velocity after it."""
        self._attitude_m_s2 += (demanded_m_s2 - self._attitude_m_s2) * followed_share(dt_s, _ATTITUDE_LAG_S)
        self.lean_m_s2 += (self._attitude_m_s2 - self.lean_m_s2) * followed_share(dt_s, _MOTOR_LAG_S)
        change_m_s2 = self.lean_m_s2 - drag_m_s2
        self._measured_m_s2 += (change_m_s2 - self._measured_m_s2) * followed_share(dt_s, _RATE_LAG_S)
        return velocity_m_s + change_m_s2 * dt_s
