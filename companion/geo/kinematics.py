"""Exact circular arcs, so that where a vehicle is does not depend on the length of the step.

The stand-in flies them, and the ground station that must reckon where its agents are flies the same ones.

A vehicle that turns at a constant rate flies a circle; stepping it along chords would shorten its path and widen its
turns. Angles are radians clockwise from north; a returned heading lies in [-pi, pi].
"""

from __future__ import annotations

import math

GRAVITY_M_S2 = 9.80665
"""Standard gravity (3rd CGPM, 1901; the paper writes 9.8): turns a load factor into a lateral acceleration."""

_OPPOSITE_TOLERANCE_RAD = 1e-9
"""A turn this near to half a circle counts as half a circle, so that rounding never chooses its side."""


def advance(
    north_m: float, east_m: float, heading_rad: float, speed_m_s: float, turn_rate_rad_s: float, dt_s: float
) -> tuple[float, float, float]:
    """Return (north_m, east_m, heading_rad) after an arc at constant speed and turn rate.

    The chord of an arc is its length times sin(x)/x of half the turn, along the middle heading: no division by the
    turn rate, so tiny rates lose no digits.
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
    """Return the signed turn by the shorter side; half a circle is always to the right (positive)."""
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
    """Return (north_m, east_m, heading_rad) after turning at the greatest rate until the wanted heading, then straight.

    The turn goes by the shorter side; half a circle goes to the right.
    """
    turn_rad = shorter_turn_rad(heading_rad, wanted_heading_rad)
    rate_rad_s = math.copysign(max_turn_rate_rad_s, turn_rad)
    if abs(turn_rad) > max_turn_rate_rad_s * dt_s:
        return advance(north_m, east_m, heading_rad, speed_m_s, rate_rad_s, dt_s)
    arc_s = abs(turn_rad) / max_turn_rate_rad_s if turn_rad else 0.0
    north_m, east_m, _ = advance(north_m, east_m, heading_rad, speed_m_s, rate_rad_s, arc_s)
    # The wanted heading itself, not the sum of the turn: it must not creep over thousands of steps.
    return advance(north_m, east_m, wanted_heading_rad, speed_m_s, 0.0, dt_s - arc_s)


PIVOT_SPEED_M_S = 0.5
"""A vehicle slower than this turns on the spot: its turn rate is that of this speed."""


def turn_rate_rad_s(speed_m_s: float, n_max: float) -> float:
    """Return omega = n_max g / v, the greatest turn rate (paper: constraint)."""
    return n_max * GRAVITY_M_S2 / max(speed_m_s, PIVOT_SPEED_M_S)


def limit_turn(
    heading_rad: float, wanted_rad: float, speed_m_s: float, n_max: float, dt_s: float
) -> tuple[float, bool]:
    """Return the heading reachable in a step towards the wanted one, and whether the limit was active.

    Turns by at most omega·dt, by the shorter side; opposite is always decided to the right (clockwise), and after a
    step to the right the right is the shorter side, so it is decided once (paper: unitdirect).
    """
    wanted_turn_rad = shorter_turn_rad(heading_rad, wanted_rad)
    greatest_turn_rad = turn_rate_rad_s(speed_m_s, n_max) * dt_s
    if abs(wanted_turn_rad) <= greatest_turn_rad:
        return wanted_rad % math.tau, False
    return (heading_rad + math.copysign(greatest_turn_rad, wanted_turn_rad)) % math.tau, True
