"""The last thing every setpoint passes: it holds every limit and says what it changed and why (DESIGN.md, rule 2).

It trusts nothing it is given and imports nothing but numpy and the standard library, so that a fault in guidance,
surrogate or picture ends here.

Keep-out and fence rest on a back-up that every accepted step leaves behind: a turning circle (or, for a vehicle that
can stop, its braking path) that is clear of every disc and inside the fence. For discs that stand still and a fence
this is inductive: the circle that certified the last step is clear at the next one, so an allowed choice always exists
and a safe start stays safe. For moving discs it holds only over `horizon_s`, during which each disc is grown by its
speed; when nothing is certified the step that stays clear of the discs longest is taken and the verdict says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

STANDARD_GRAVITY_M_S2 = 9.80665
"""CGPM 1901. Written here again on purpose: the guard shares no code with what it guards against."""
TURN_TOLERANCE_RAD = 1e-9
"""A setpoint at the turn limit must not be called over it for its rounding."""
STEP_SAMPLES = 8
"""Points checked along a step; discs are grown by half their spacing, so nothing slips between."""
ROUNDING_M = 1e-6
"""A back-up keeps this much more clear than a step must, so that continuing it is never refused for rounding."""
PIVOT_SPEED_M_S = 0.5
"""A vehicle slower than this turns on the spot: its turn rate is that of this speed."""

NOT_FINITE = "not finite"
SPEED = "speed"
ALTITUDE = "altitude"
TURN = "turn rate"
KEEP_OUT = "keep-out"
FENCE = "fence"
NO_BACKUP = "no certified back-up"


@dataclass(frozen=True)
class Setpoint:
    """Heading in radians clockwise from grid north, speed and altitude."""

    heading_rad: float
    speed_m_s: float
    altitude_m: float


@dataclass(frozen=True)
class Motion:
    """Where the vehicle is and how it moves."""

    north_m: float
    east_m: float
    heading_rad: float
    speed_m_s: float


@dataclass(frozen=True)
class Limits:
    """What the vehicle may do; `braking_m_s2` is None for one that cannot stop."""

    speed_min_m_s: float
    speed_max_m_s: float
    n_max: float
    altitude_min_m: float
    altitude_max_m: float
    braking_m_s2: float | None = None
    fence_ned_m: tuple[tuple[float, float], ...] | None = None
    horizon_s: float = 30.0


@dataclass(frozen=True)
class Discs:
    """Keep-out discs as they are now, and the greatest speed of each."""

    centres_ned_m: np.ndarray  # (M, 2) m
    radii_m: np.ndarray  # (M,) m
    speeds_m_s: np.ndarray  # (M,) m/s


@dataclass(frozen=True)
class Verdict:
    """The setpoint that may be sent (None: send nothing), and why it differs from the one wanted."""

    setpoint: Setpoint | None
    changes: tuple[str, ...]


@dataclass(frozen=True)
class _Step:
    """One way of flying the next step: a turn to a heading, then straight, at a speed."""

    heading_rad: float
    speed_m_s: float


def check(wanted: Setpoint, motion: Motion, discs: Discs, limits: Limits, dt_s: float) -> Verdict:
    """Return the setpoint nearest to the wanted one that every limit allows for the next `dt_s` seconds.

    A motion that is not finite leaves nothing to decide on: the verdict holds no setpoint. A wanted setpoint that is
    not finite becomes "straight on at the present speed and the middle of the altitude band".
    """
    if not all(map(math.isfinite, (motion.north_m, motion.east_m, motion.heading_rad, motion.speed_m_s, dt_s))):
        return Verdict(None, (NOT_FINITE,))
    if not (np.isfinite(discs.centres_ned_m).all() and np.isfinite(discs.radii_m).all()):
        return Verdict(None, (NOT_FINITE,))
    changes: list[str] = []
    heading_rad, speed_m_s, altitude_m = wanted.heading_rad, wanted.speed_m_s, wanted.altitude_m
    if not all(map(math.isfinite, (heading_rad, speed_m_s, altitude_m))):
        changes.append(NOT_FINITE)
        heading_rad, speed_m_s = motion.heading_rad, motion.speed_m_s
        altitude_m = (limits.altitude_min_m + limits.altitude_max_m) / 2.0
    allowed_m_s = min(max(speed_m_s, limits.speed_min_m_s), limits.speed_max_m_s)
    if allowed_m_s != speed_m_s:
        changes.append(SPEED)
    allowed_altitude_m = min(max(altitude_m, limits.altitude_min_m), limits.altitude_max_m)
    if allowed_altitude_m != altitude_m:
        changes.append(ALTITUDE)
    rate_rad_s = _turn_rate_rad_s(max(allowed_m_s, motion.speed_m_s), limits)
    turn_rad = math.remainder(heading_rad - motion.heading_rad, math.tau)
    greatest_turn_rad = rate_rad_s * dt_s
    if abs(turn_rad) > greatest_turn_rad + TURN_TOLERANCE_RAD:
        changes.append(TURN)
        turn_rad = math.copysign(greatest_turn_rad, turn_rad)
    step = _Step(motion.heading_rad + turn_rad, allowed_m_s)
    if limits.fence_ned_m is not None or not _is_far(motion, allowed_m_s, discs, limits, dt_s):
        step = _kept_clear(step, motion, discs, limits, dt_s, changes)
    return Verdict(Setpoint(step.heading_rad % math.tau, step.speed_m_s, allowed_altitude_m), tuple(changes))


def _is_far(motion: Motion, speed_m_s: float, discs: Discs, limits: Limits, dt_s: float) -> bool:
    """Return whether no disc can matter to a step or to any back-up after it: the usual case, decided cheaply."""
    speed_m_s = max(speed_m_s, motion.speed_m_s)
    backup_m = 2.0 * speed_m_s / _turn_rate_rad_s(speed_m_s, limits)
    if limits.braking_m_s2 is not None:
        backup_m = speed_m_s**2 / (2.0 * limits.braking_m_s2)
    # Twice the step: once for the way, and more than enough for its margins.
    reach_m = 2.0 * speed_m_s * dt_s + backup_m + ROUNDING_M
    grown_m = discs.radii_m + discs.speeds_m_s * (dt_s + limits.horizon_s)
    apart_m = np.hypot(discs.centres_ned_m[:, 0] - motion.north_m, discs.centres_ned_m[:, 1] - motion.east_m)
    return bool(np.all(apart_m > grown_m + reach_m))


def _kept_clear(wanted: _Step, motion: Motion, discs: Discs, limits: Limits, dt_s: float, changes: list[str]) -> _Step:
    broken = _broken(wanted, motion, discs, limits, dt_s)
    if broken is None:
        return wanted
    changes.append(broken)
    turn_rad = min(_turn_rate_rad_s(wanted.speed_m_s, limits) * dt_s, math.pi)
    wanted_turn_rad = math.remainder(wanted.heading_rad - motion.heading_rad, math.tau)
    first = math.copysign(turn_rad, wanted_turn_rad)
    choices = [_Step(motion.heading_rad + turn, wanted.speed_m_s) for turn in (first, -first)]
    if limits.braking_m_s2 is not None:
        choices.append(_Step(motion.heading_rad, 0.0))
    for choice in choices:
        if _broken(choice, motion, discs, limits, dt_s) is None:
            return choice
    changes.append(NO_BACKUP)
    return max(choices, key=lambda choice: _clearance_m(choice, motion, discs, limits, dt_s))


def _broken(step: _Step, motion: Motion, discs: Discs, limits: Limits, dt_s: float) -> str | None:
    """Return what a step would break, during it or for want of a back-up after it; None if nothing."""
    path_ned_m = _path(step, motion, limits, dt_s)
    margin_m = max(motion.speed_m_s, step.speed_m_s) * dt_s / STEP_SAMPLES / 2.0
    times_s = np.linspace(0.0, dt_s, STEP_SAMPLES + 1)
    if _least_clearance_m(path_ned_m, times_s, discs) < margin_m:
        return KEEP_OUT
    if limits.fence_ned_m is not None and not _path_inside(path_ned_m, limits.fence_ned_m, margin_m):
        return FENCE
    end = (float(path_ned_m[-1, 0]), float(path_ned_m[-1, 1]))
    after = Discs(
        discs.centres_ned_m,
        discs.radii_m + discs.speeds_m_s * (dt_s + limits.horizon_s) + margin_m + ROUNDING_M,
        discs.speeds_m_s,
    )
    if limits.braking_m_s2 is not None:
        return _broken_braking(end, step, after, limits.fence_ned_m, margin_m, limits.braking_m_s2)
    return _broken_circles(end, step, after, limits, margin_m)


def _broken_circles(
    end_ned_m: tuple[float, float], step: _Step, discs: Discs, limits: Limits, margin_m: float
) -> str | None:
    """Return what both turning circles after a step would break; None if either is clear."""
    radius_m = step.speed_m_s / _turn_rate_rad_s(step.speed_m_s, limits)
    broken = None
    for side in (1.0, -1.0):
        bearing_rad = step.heading_rad + side * math.pi / 2.0
        centre = (end_ned_m[0] + radius_m * math.cos(bearing_rad), end_ned_m[1] + radius_m * math.sin(bearing_rad))
        apart_m = np.hypot(discs.centres_ned_m[:, 0] - centre[0], discs.centres_ned_m[:, 1] - centre[1])
        # Clear means wholly outside the circle, or (a small disc) wholly within it.
        if np.any(np.abs(apart_m - radius_m) < discs.radii_m):
            broken = KEEP_OUT
        elif limits.fence_ned_m is not None and not _disc_inside(
            centre, radius_m + margin_m + ROUNDING_M, limits.fence_ned_m
        ):
            broken = FENCE
        else:
            return None
    return broken


def _broken_braking(
    end_ned_m: tuple[float, float],
    step: _Step,
    discs: Discs,
    fence_ned_m: Sequence[tuple[float, float]] | None,
    margin_m: float,
    braking_m_s2: float,
) -> str | None:
    """Return what braking straight ahead after a step would break; None if it is clear."""
    length_m = step.speed_m_s**2 / (2.0 * braking_m_s2)
    stop = (
        end_ned_m[0] + length_m * math.cos(step.heading_rad),
        end_ned_m[1] + length_m * math.sin(step.heading_rad),
    )
    for centre, radius_m in zip(discs.centres_ned_m, discs.radii_m, strict=True):
        if _distance_to_segment_m((float(centre[0]), float(centre[1])), end_ned_m, stop) < radius_m:
            return KEEP_OUT
    if fence_ned_m is not None:
        spacing_m = length_m / STEP_SAMPLES
        share = np.linspace(0.0, 1.0, STEP_SAMPLES + 1)[:, None]
        path_ned_m = np.array(end_ned_m) + share * (np.array(stop) - np.array(end_ned_m))
        if not _path_inside(path_ned_m, fence_ned_m, margin_m + spacing_m / 2.0):
            return FENCE
    return None


def _clearance_m(step: _Step, motion: Motion, discs: Discs, limits: Limits, dt_s: float) -> float:
    """Return the least clearance on the step and straight on for as long again: what is left when nothing is sure."""
    path_ned_m = _path(step, motion, limits, dt_s)
    beyond = path_ned_m[-1] + (path_ned_m[-1] - path_ned_m[0])
    times_s = np.append(np.linspace(0.0, dt_s, STEP_SAMPLES + 1), 2.0 * dt_s)
    return _least_clearance_m(np.vstack([path_ned_m, beyond]), times_s, discs)


def _path(step: _Step, motion: Motion, limits: Limits, dt_s: float) -> np.ndarray:  # (STEP_SAMPLES + 1, 2) m
    """Return points of the step: an arc at the greatest rate until the heading is reached, then straight."""
    turn_rad = math.remainder(step.heading_rad - motion.heading_rad, math.tau)
    speed_m_s = max(step.speed_m_s, motion.speed_m_s)
    rate_rad_s = _turn_rate_rad_s(speed_m_s, limits)
    turning_s = min(abs(turn_rad) / rate_rad_s, dt_s)
    times_s = np.linspace(0.0, dt_s, STEP_SAMPLES + 1)
    on_arc_s = np.minimum(times_s, turning_s)
    half_rad = math.copysign(rate_rad_s, turn_rad) * on_arc_s / 2.0
    chord_m = speed_m_s * on_arc_s * np.sinc(half_rad / math.pi)
    straight_m = speed_m_s * (times_s - on_arc_s)
    north_m = motion.north_m + chord_m * np.cos(motion.heading_rad + half_rad)
    east_m = motion.east_m + chord_m * np.sin(motion.heading_rad + half_rad)
    north_m += straight_m * math.cos(step.heading_rad)
    east_m += straight_m * math.sin(step.heading_rad)
    return np.column_stack([north_m, east_m])


def _least_clearance_m(
    path_ned_m: np.ndarray,  # (S, 2) m
    times_s: np.ndarray,  # (S,) s from now
    discs: Discs,
) -> float:
    apart_m = np.hypot(
        path_ned_m[:, None, 0] - discs.centres_ned_m[None, :, 0],
        path_ned_m[:, None, 1] - discs.centres_ned_m[None, :, 1],
    )
    return float(np.min(apart_m - discs.radii_m - times_s[:, None] * discs.speeds_m_s, initial=math.inf))


def _turn_rate_rad_s(speed_m_s: float, limits: Limits) -> float:
    """Return n_max g / v."""
    return limits.n_max * STANDARD_GRAVITY_M_S2 / max(speed_m_s, PIVOT_SPEED_M_S)


def _path_inside(path_ned_m: np.ndarray, fence_ned_m: Sequence[tuple[float, float]], margin_m: float) -> bool:
    return all(_disc_inside((float(north), float(east)), margin_m, fence_ned_m) for north, east in path_ned_m)


def _disc_inside(centre: tuple[float, float], radius_m: float, fence_ned_m: Sequence[tuple[float, float]]) -> bool:
    """Return whether a disc lies inside a simple polygon: its centre does (even-odd), and no edge comes nearer."""
    inside = False
    start = fence_ned_m[-1]
    for end in fence_ned_m:
        if (end[0] > centre[0]) != (start[0] > centre[0]):
            share = (centre[0] - start[0]) / (end[0] - start[0])
            if centre[1] < start[1] + share * (end[1] - start[1]):
                inside = not inside
        if _distance_to_segment_m(centre, start, end) < radius_m:
            return False
        start = end
    return inside


def _distance_to_segment_m(point: tuple[float, float], start: tuple[float, float], end: tuple[float, float]) -> float:
    along = (end[0] - start[0], end[1] - start[1])
    length_2 = along[0] ** 2 + along[1] ** 2
    share = 0.0
    if length_2 > 0.0:
        share = ((point[0] - start[0]) * along[0] + (point[1] - start[1]) * along[1]) / length_2
        share = min(1.0, max(0.0, share))
    return math.hypot(point[0] - start[0] - share * along[0], point[1] - start[1] - share * along[1])
