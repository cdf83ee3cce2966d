"""Right of way: separation between vehicles that do not communicate, from detected positions and velocities alone.

Vehicles cannot agree on anything in flight, and peers are as fast as this vehicle, so no path is safe against whatever
a peer does. Instead every vehicle computes the same rule alone, from what its own detector shows; it is safe if all
follow it (docs/method.md section 3, "Peers"). The rule: each vehicle reserves the disc in which it can circle to the
right for ever, and moves the centre of that disc by at most its own half of the gap to any other disc. Circling leaves
the centre where it is, so an allowed decision always exists, and the discs never overlap. docs/separation.md has the
proof and the measurements.

Progress comes from keeping right: a vehicle that may not fly its wanted heading takes the first allowed heading
clockwise from it, so that whatever is in its way stays on its left, as in a roundabout.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.geo.kinematics import shorter_turn_rad
from companion.geo.right_of_way import LEAST_PART, UNEVENNESS, Rules, centre_ned_m, circle, reserved_radius_m
from companion.guard.types import Motion
from companion.guidance.resolution import (
    CIRCLING,
    EDGE_RAD,
    LATE,
    PASSING,
    TURNING_RIGHT,
    Arc,
    AtEffect,
    Peers,
    Resolution,
    first_clockwise,
    inside,
)
from companion.guidance.stopping import Start, evading, keep_apart

LEFT_FRACTIONS = (1.0, 0.5, 0.25, 0.125)
"""Fractions of a wanted turn to the left that are tried: a turn to the left moves the reserved disc twice as fast as
straight flight."""
UNEVEN_RADII = 5.0
"""Distance, in reserved radii, over which the unused part runs through its range: it then differs between neighbours,
and a difference lasts long enough to matter."""
RETREAT = 0.3
"""Least part of the distance flown in a step that must lead apart where discs overlap, by errors or late detection."""
LATE_PART = 0.25
"""Overlap of two discs, as a part of D_safe, beyond which the neighbour counts as seen too late; a smaller overlap is
taken for an error of position."""
LATE_HORIZON_S = 40.0
"""Time for which the paths of a vehicle and a neighbour that it has seen too late are predicted."""
LATE_CLEARANCE = 4.0
"""Predicted clearance, in units of D_safe, above which the rule's own choice stands although a neighbour is late."""


@dataclass(frozen=True)
class _Neighbour:
    """A neighbour whose reserved disc is near enough to forbid something."""

    peer: int  # its index among the peers
    bearing_rad: float  # from the centre of our reserved disc to the centre of the neighbour's
    share_m: float  # how far our centre may move towards it in a step; negative: how far it must move away
    # For a neighbour seen only when the discs overlapped already, against which the rule gives no guarantee: its north
    # and east from us, m, and its velocity, m/s.
    seen_late: tuple[float, float, float, float] | None = None


def give_way(
    wanted_rad: float,
    motion: Motion,
    peers: Peers,
    rules: Rules,
    dt_s: float,
    at_effect: AtEffect | None = None,
) -> Resolution:
    """Return the wanted heading, or the first clockwise that the rule allows, and the greatest speed allowed with it.

    `motion` is this vehicle's motion now, as neighbours detect it: its heading is the course over ground. The vehicle
    is assumed to turn to the returned heading by the shorter side at n_max and then to fly straight until the end of
    `dt_s`; it begins `reaction_s` from now, with the heading and the speed `at_effect` (default: those now). The
    speed of a vehicle that cannot stop is never changed. Raises ValueError if `rules.can_stop` is set without a
    positive `braking_m_s2`.
    """
    if rules.can_stop:
        start = Start(motion, at_effect or AtEffect(motion.heading_rad, motion.speed_m_s), rules, dt_s)
        return evading(start, peers) or keep_apart(wanted_rad, start, peers, _part(motion, rules, dt_s))
    wanted_rad %= math.tau
    neighbours = _neighbours(motion, peers, rules, dt_s)
    if not neighbours:
        return Resolution(wanted_rad, motion.speed_m_s, None)
    if at_effect is not None:
        motion = replace(motion, heading_rad=at_effect.heading_rad)
    chosen = _keep_right(wanted_rad, motion, neighbours, rules, dt_s)
    late = [each.seen_late for each in neighbours if each.seen_late is not None]
    if late:
        others = [each for each in neighbours if each.seen_late is None]
        chosen = _keep_clear(chosen, motion, late, others, rules, dt_s)
    if chosen.reason is None:
        return chosen
    return replace(chosen, peer=min(neighbours, key=lambda each: each.share_m).peer)


def _keep_right(
    wanted_rad: float,
    motion: Motion,
    neighbours: Sequence[_Neighbour],
    rules: Rules,
    dt_s: float,
) -> Resolution:
    """Return the wanted heading or the first free one clockwise, and turn there by a side that the shares allow."""
    rate_rad_s = _circle_rate_rad_s(motion.speed_m_s, rules, dt_s)
    step_turn_rad = rate_rad_s * dt_s
    arcs = _forbidden_arcs(neighbours, motion.speed_m_s * dt_s)
    chosen_rad = first_clockwise(wanted_rad, arcs)
    if chosen_rad is None:
        return Resolution((motion.heading_rad + step_turn_rad) % math.tau, motion.speed_m_s, CIRCLING)
    turn_rad = shorter_turn_rad(motion.heading_rad, chosen_rad)
    reason = None if chosen_rad == wanted_rad else PASSING
    if turn_rad >= 0.0:
        return Resolution(chosen_rad, motion.speed_m_s, reason)
    if not _sweeps(motion.heading_rad, turn_rad, arcs):
        for fraction in LEFT_FRACTIONS:
            part_rad = max(fraction * turn_rad, -step_turn_rad)
            if _left_turn_allowed(motion, part_rad, rate_rad_s, dt_s, neighbours):
                if fraction == 1.0:
                    return Resolution(chosen_rad, motion.speed_m_s, reason)
                return Resolution((motion.heading_rad + part_rad) % math.tau, motion.speed_m_s, PASSING)
        if not inside(motion.heading_rad, arcs):
            return Resolution(motion.heading_rad % math.tau, motion.speed_m_s, PASSING)
    # The long way round: a heading as far ahead as one step turns, or the vehicle would take the shorter side.
    ahead_rad = min(step_turn_rad, turn_rad + math.tau)
    return Resolution((motion.heading_rad + ahead_rad) % math.tau, motion.speed_m_s, TURNING_RIGHT)


def _keep_clear(
    chosen: Resolution,
    motion: Motion,
    late: Sequence[tuple[float, float, float, float]],
    others: Sequence[_Neighbour],
    rules: Rules,
    dt_s: float,
) -> Resolution:
    """Return the choice if it stays clear of those seen too late, else the clearest of circling right, straight, left.

    The clearance of each is the least over what a neighbour may do: fly on straight, or circle right. Straight flight
    and a turn to the left are candidates only if the shares with all other neighbours allow them. This is a precaution;
    nothing is proven about it.
    """
    rate_rad_s = _circle_rate_rad_s(motion.speed_m_s, rules, dt_s)
    step_turn_rad = rate_rad_s * dt_s
    to_choice_rad = shorter_turn_rad(motion.heading_rad, chosen.heading_rad)
    turns_rad = [math.inf if chosen.reason in (CIRCLING, TURNING_RIGHT) else to_choice_rad, math.inf]
    if not inside(motion.heading_rad, _forbidden_arcs(others, motion.speed_m_s * dt_s)):
        turns_rad.append(0.0)
    if _left_turn_allowed(motion, -step_turn_rad, rate_rad_s, dt_s, others):
        turns_rad.append(-math.inf)
    clear_m = _clearance_m(motion, np.array(turns_rad), np.array(late), rules, dt_s)
    if clear_m[0] >= LATE_CLEARANCE * rules.separation_m:
        return chosen
    best_rad = turns_rad[int(np.argmax(clear_m))]
    ahead_rad = max(-step_turn_rad, min(step_turn_rad, best_rad))
    return Resolution((motion.heading_rad + ahead_rad) % math.tau, motion.speed_m_s, LATE)


def _clearance_m(
    motion: Motion,
    turns_rad: np.ndarray,  # (C,) rad, to the right; infinite: a circle
    late: np.ndarray,  # (L, 4): north and east from us, m, and velocity, m/s
    rules: Rules,
    dt_s: float,
) -> np.ndarray:  # (C,) m
    """Return the least distance to any neighbour for each of our turns, if neighbours fly straight or circle right.

    Paths are predicted for LATE_HORIZON_S, in steps of 1 s.
    """
    time_s = np.arange(1.0, LATE_HORIZON_S + 1.0)  # (T,)
    rate_rad_s = _circle_rate_rad_s(motion.speed_m_s, rules, dt_s)
    ours_m = _path(motion.speed_m_s, motion.heading_rad, turns_rad[:, np.newaxis], rate_rad_s, time_s)  # (C, T)
    velocity = late[:, 2] + 1j * late[:, 3]
    speed_m_s = np.abs(velocity)[:, np.newaxis, np.newaxis]  # (L, 1, 1)
    course_rad = np.angle(velocity)[:, np.newaxis, np.newaxis]
    peer_rate_rad_s = np.array([_circle_rate_rad_s(each, rules, dt_s) for each in np.abs(velocity).tolist()])
    turns = np.array([[0.0], [math.inf]])  # (2, 1)
    theirs_m = _path(speed_m_s, course_rad, turns, peer_rate_rad_s[:, np.newaxis, np.newaxis], time_s)  # (L, 2, T)
    theirs_m = theirs_m + (late[:, 0] + 1j * late[:, 1])[:, np.newaxis, np.newaxis]
    clear_m: np.ndarray = np.abs(ours_m[:, np.newaxis, np.newaxis] - theirs_m).min(axis=(1, 2, 3))
    return clear_m


def _path(
    speed_m_s: float | np.ndarray,
    heading_rad: float | np.ndarray,
    turn_rad: np.ndarray,
    rate_rad_s: float | np.ndarray,
    time_s: np.ndarray,  # (T,)
) -> np.ndarray:
    """Return the positions, m from the start, at given times of a turn by an angle at a rate and straight flight after.

    North is the real part, east the imaginary one; the shapes are broadcast.
    """
    turned_rad = np.clip(turn_rad, -rate_rad_s * time_s, rate_rad_s * time_s)
    straight_m = speed_m_s * (time_s - np.abs(turned_rad) / rate_rad_s)
    chord_m = 2.0 * speed_m_s / rate_rad_s * np.sin(0.5 * np.abs(turned_rad))
    places_m: np.ndarray = np.exp(1j * (heading_rad + 0.5 * turned_rad)) * (
        chord_m + straight_m * np.exp(0.5j * turned_rad)
    )
    return places_m


def _circle_rate_rad_s(speed_m_s: float, rules: Rules, dt_s: float) -> float:
    """Return the turn rate of the circle to the right (see _circle)."""
    return circle(speed_m_s, rules, dt_s)[0]


def _neighbours(motion: Motion, peers: Peers, rules: Rules, dt_s: float) -> list[_Neighbour]:
    """Return the peers near enough for the two reserved discs to meet within a step, with our share of each gap."""
    speed_m_s = motion.speed_m_s
    north_m, east_m = centre_ned_m(motion, rules, dt_s)
    # Our disc, both margins, and how far commands that do not act yet may move a centre (leftwards at twice the speed).
    kept_m = 2.0 * reserved_radius_m(speed_m_s, rules, dt_s) - circle(speed_m_s, rules, dt_s)[1]
    kept_m += 2.0 * rules.reaction_s * speed_m_s
    part = _part(motion, rules, dt_s)
    reach_m = 2.0 * speed_m_s * dt_s / LEAST_PART
    neighbours = []
    for peer, (there, velocity, age_s, growth_m) in enumerate(peers.rows()):
        peer_m_s = abs(velocity)
        place = there + velocity * age_s
        rate_rad_s, peer_radius_m = circle(peer_m_s, rules, dt_s)
        to_north_m = place.real - velocity.imag / rate_rad_s - north_m
        to_east_m = place.imag + velocity.real / rate_rad_s - east_m
        certain_m = math.hypot(to_north_m, to_east_m) - kept_m - peer_radius_m - 2.0 * rules.reaction_s * peer_m_s
        gap_m = certain_m - growth_m
        if gap_m < reach_m:
            bearing_rad = math.atan2(to_east_m, to_north_m)
            in_flight_m = 2.0 * rules.reaction_s * (speed_m_s + peer_m_s)
            late = certain_m + in_flight_m < -LATE_PART * rules.separation_m
            from_us = place - complex(motion.north_m, motion.east_m)
            seen = (from_us.real, from_us.imag, velocity.real, velocity.imag) if late else None
            share_m = max(part * gap_m, -RETREAT * speed_m_s * dt_s)
            neighbours.append(_Neighbour(peer, bearing_rad, share_m, seen))
    return neighbours


def _part(motion: Motion, rules: Rules, dt_s: float) -> float:
    """Return the part of every gap that a vehicle uses where it is, from LEAST_PART to a half."""
    return 0.5 * (1.0 - UNEVENNESS * _uneven(motion, rules, dt_s))


def _uneven(motion: Motion, rules: Rules, dt_s: float) -> float:
    """Return a number in [0, 1) that differs between vehicles: a fold of the position that has no symmetry."""
    period_m = UNEVEN_RADII * reserved_radius_m(rules.speed_m_s, rules, dt_s)
    return math.modf(abs(motion.north_m * math.sqrt(2.0) + motion.east_m * math.sqrt(3.0)) / period_m)[0]


def _forbidden_arcs(neighbours: Sequence[_Neighbour], step_m: float) -> list[Arc]:
    """Return the forbidden headings as arcs (middle, half-width) in rad: a whole step along them exceeds a share."""
    return [
        (each.bearing_rad, math.acos(each.share_m / step_m) + EDGE_RAD) for each in neighbours if each.share_m < step_m
    ]


def _sweeps(heading_rad: float, turn_rad: float, arcs: Sequence[Arc]) -> bool:
    """Return whether a turn to the left (negative) passes any arc; an arc that contains the present heading counts."""
    middle_rad, half_rad = heading_rad + 0.5 * turn_rad, -0.5 * turn_rad - 2.0 * EDGE_RAD
    return any(abs(math.remainder(middle_rad - middle, math.tau)) < half_rad + half for middle, half in arcs)


def _left_turn_allowed(
    motion: Motion, turn_rad: float, rate_rad_s: float, dt_s: float, neighbours: Sequence[_Neighbour]
) -> bool:
    """Return whether our reserved disc's centre stays in our share if we turn left (negative), then fly straight.

    The centre moves along an arc of twice the turn radius. It is nearest to a neighbour at the end of the arc, at the
    end of the step, or where the heading becomes perpendicular to the neighbour's bearing on the way.
    """
    diameter_m = 2.0 * motion.speed_m_s / rate_rad_s
    straight_m = motion.speed_m_s * (dt_s + turn_rad / rate_rad_s)
    for each in neighbours:
        start_rad = math.remainder(motion.heading_rad - each.bearing_rad, math.tau)
        end_rad = start_rad + turn_rad
        arc_m = diameter_m * (math.sin(start_rad) - math.sin(end_rad))
        farthest_m = max(arc_m, arc_m + straight_m * math.cos(end_rad))
        if end_rad < -math.pi / 2 < start_rad:
            farthest_m = max(farthest_m, diameter_m * (math.sin(start_rad) + 1.0))
        if farthest_m > max(each.share_m, 0.0):
            return False
    return True
