"""Turn rates, and motion along exact circular arcs, so that a position does not depend on the length of the step.

The stand-in autopilots fly these arcs, and the ground station's dead reckoning of its agents uses the same ones.

A vehicle that turns at a constant rate flies a circle; stepping it along chords would shorten its path and widen its
turns. Angles are radians clockwise from north; a returned heading lies in [-pi, pi] unless stated otherwise.
"""

from __future__ import annotations

import math

GRAVITY_M_S2 = 9.80665
"""Standard gravity (3rd CGPM, 1901; the paper writes 9.8), which converts a load factor to a lateral acceleration."""

_OPPOSITE_TOLERANCE_RAD = 1e-9
"""A turn this close to half a circle counts as half a circle, so that rounding never decides its side."""


def advance(
    north_m: float, east_m: float, heading_rad: float, speed_m_s: float, turn_rate_rad_s: float, dt_s: float
) -> tuple[float, float, float]:
    """Return (north_m, east_m, heading_rad) after an arc at constant speed and turn rate.

    The chord of an arc is its length times sin(x)/x, where x is half the turn, and points along the middle heading.
    There is no division by the turn rate, so tiny rates lose no digits.
    """
    half_turn_rad = 0.5 * turn_rate_rad_s * dt_s
    chord_m = speed_m_s * dt_s
    if half_turn_rad != 0.0:
        chord_m *= math.sin(half_turn_rad) / half_turn_rad
    middle_rad = heading_rad + half_turn_rad
    return (
        north_m + chord_m * math.cos(middle_rad),
        east_m + chord_m * math.sin(middle_rad),
        math.remainder(middle_rad + half_turn_rad, math.tau),
    )


def shorter_turn_rad(heading_rad: float, wanted_heading_rad: float) -> float:
    """Return the turn by the shorter side, positive to the right; half a circle is always to the right."""
    turn_rad = math.remainder(wanted_heading_rad - heading_rad, math.tau)
    if turn_rad < -math.pi + _OPPOSITE_TOLERANCE_RAD:
        turn_rad += math.tau
    return turn_rad


def turn_towards(
    north_m: float,
    east_m: float,
    heading_rad: float,
    speed_m_s: float,
    wanted_heading_rad: float,
    max_turn_rate_rad_s: float,
    dt_s: float,
) -> tuple[float, float, float]:
    """Return (north_m, east_m, heading_rad) after a turn at the greatest rate to the wanted heading, then straight on.

    The turn goes by the shorter side; half a circle goes to the right.
    """
    turn_rad = shorter_turn_rad(heading_rad, wanted_heading_rad)
    rate_rad_s = math.copysign(max_turn_rate_rad_s, turn_rad)
    if abs(turn_rad) > max_turn_rate_rad_s * dt_s:
        return advance(north_m, east_m, heading_rad, speed_m_s, rate_rad_s, dt_s)
    arc_s = abs(turn_rad) / max_turn_rate_rad_s if turn_rad else 0.0
    north_m, east_m, _ = advance(north_m, east_m, heading_rad, speed_m_s, rate_rad_s, arc_s)
    # The wanted heading is used itself, not the sum of the turns, so that it does not creep over thousands of steps.
    return advance(north_m, east_m, wanted_heading_rad, speed_m_s, 0.0, dt_s - arc_s)


PIVOT_SPEED_M_S = 0.5
"""Speed below which a vehicle turns on the spot, with the turn rate that it has at this speed."""


def turn_rate_rad_s(speed_m_s: float, n_max: float) -> float:
    """Return the greatest turn rate omega = n_max g / v (paper: constraint)."""
    return n_max * GRAVITY_M_S2 / max(speed_m_s, PIVOT_SPEED_M_S)


def limit_turn(
    heading_rad: float, wanted_rad: float, speed_m_s: float, n_max: float, dt_s: float
) -> tuple[float, bool]:
    """Return the heading reachable in one step towards the wanted one, in [0, 2 pi), and whether the limit was active.

    The turn is at most omega·dt by the shorter side. For the opposite heading it is always to the right (clockwise);
    after one step the right is then the shorter side, so that the choice is made only once (paper: unitdirect).
    """
    wanted_turn_rad = shorter_turn_rad(heading_rad, wanted_rad)
    greatest_turn_rad = turn_rate_rad_s(speed_m_s, n_max) * dt_s
    if abs(wanted_turn_rad) <= greatest_turn_rad:
        return wanted_rad % math.tau, False
    return (heading_rad + math.copysign(greatest_turn_rad, wanted_turn_rad)) % math.tau, True


def nearest_on_way(point: complex, way: complex) -> complex:
    """Return the point of a straight way that begins at 0 that is nearest to a point; north is the real part, m."""
    length_m2 = way.real * way.real + way.imag * way.imag
    if length_m2 == 0.0:
        return 0.0j
    share = (point.real * way.real + point.imag * way.imag) / length_m2
    return min(max(share, 0.0), 1.0) * way
