"""The last thing every setpoint passes: it holds every limit and says what it changed and why (DESIGN.md, rule 2).

It trusts nothing it is given and imports nothing but numpy and the standard library, so that a fault in guidance,
surrogate or picture ends here.

Keep-out and fence rest on a back-up that every accepted step leaves behind: a turning circle (or, for a vehicle that
can stop, its braking path) that is clear of every disc and inside the fence. For discs that stand still and a fence
this is inductive: the circle that certified the last step is clear at the next one, so an allowed choice always exists
and a safe start stays safe. For moving discs it holds only over `horizon_s`, during which each disc is grown by its
speed; when nothing is certified the step that stays clear of discs and fence best is taken and the verdict says so.

What is assumed of the vehicle: it turns at the rate of the greater of its speeds before and after the step, by the
shorter side, until the heading is reached, then flies straight. A vehicle that can stop slows at `braking_m_s2` or
faster; any other obeys a speed at once or within the step.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

STANDARD_GRAVITY_M_S2 = 9.80665
"""CGPM 1901. Written here again on purpose: the guard shares no code with what it guards against."""
TURN_TOLERANCE_RAD = 1e-9
"""A setpoint at the turn limit must not be called over it for its rounding."""
GREATEST_TURN_RAD = 3.0
"""A step turns by no more, so that the vehicle takes the side that was checked."""
BACKUP_TURN_RAD = math.pi / 2.0
"""A back-up turns by no more in a step: where the turn rate allows more, it is a rounded square and not a circle."""
STEP_SAMPLES = 8
"""Points checked along a step; discs are grown by half their spacing, so nothing slips between."""
ROUNDING_M = 1e-6
"""A back-up keeps this much more clear than a step must, so that continuing it is never refused for rounding."""
PIVOT_SPEED_M_S = 0.5
"""A vehicle slower than this turns on the spot: its turn rate is that of this speed."""

NOT_FINITE = "not finite"
IMPOSSIBLE = "impossible"
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
    """What the vehicle may do; `braking_m_s2` is None for one that cannot stop. Raises ValueError for nonsense."""

    speed_min_m_s: float
    speed_max_m_s: float
    n_max: float
    altitude_min_m: float
    altitude_max_m: float
    braking_m_s2: float | None = None
    fence_ned_m: tuple[tuple[float, float], ...] | None = None
    horizon_s: float = 30.0

    def __post_init__(self) -> None:
        can_stop = self.braking_m_s2 is not None
        sound = (
            (0.0 == self.speed_min_m_s if can_stop else 0.0 < self.speed_min_m_s)
            and self.speed_min_m_s <= self.speed_max_m_s < math.inf
            and 0.0 < self.n_max < math.inf
            and -math.inf < self.altitude_min_m <= self.altitude_max_m < math.inf
            and (self.braking_m_s2 is None or 0.0 < self.braking_m_s2 < math.inf)
            and 0.0 <= self.horizon_s < math.inf
        )
        if not sound:
            raise ValueError(f"limits that nothing can hold: {self}")
        if self.fence_ned_m is not None and not (len(self.fence_ned_m) >= 3 and np.isfinite(self.fence_ned_m).all()):
            raise ValueError("a fence needs at least three corners, all of them finite")


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

    A motion, a disc or a step that is not finite, or that has a negative size, leaves nothing to decide on: the
    verdict holds no setpoint. A wanted setpoint that is not finite becomes "straight on at the present speed and the
    middle of the altitude band".
    """
    if not all(map(math.isfinite, (motion.north_m, motion.east_m, motion.heading_rad, motion.speed_m_s, dt_s))):
        return Verdict(None, (NOT_FINITE,))
    if not all(np.isfinite(part).all() for part in (discs.centres_ned_m, discs.radii_m, discs.speeds_m_s)):
        return Verdict(None, (NOT_FINITE,))
    if motion.speed_m_s < 0.0 or dt_s <= 0.0 or np.any(discs.radii_m < 0.0) or np.any(discs.speeds_m_s < 0.0):
        return Verdict(None, (IMPOSSIBLE,))
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
    turn_rad = math.remainder(heading_rad - motion.heading_rad, math.tau)
    greatest_turn_rad = min(
        _turn_rate_rad_s(max(allowed_m_s, motion.speed_m_s), limits) * dt_s,
        GREATEST_TURN_RAD,
    )
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
        backup_m = speed_m_s * speed_m_s / (2.0 * limits.braking_m_s2)
    # Seven steps: one for the way, two for the sides of a rounded square, more than four for the margins.
    reach_m = 7.0 * speed_m_s * dt_s + backup_m + ROUNDING_M
    grown_m = discs.radii_m + discs.speeds_m_s * (dt_s + limits.horizon_s)
    apart_m = np.hypot(discs.centres_ned_m[:, 0] - motion.north_m, discs.centres_ned_m[:, 1] - motion.east_m)
    return bool(np.all(apart_m > grown_m + reach_m))


def _kept_clear(wanted: _Step, motion: Motion, discs: Discs, limits: Limits, dt_s: float, changes: list[str]) -> _Step:
    broken = _broken(wanted, motion, discs, limits, dt_s, ROUNDING_M)
    if broken is None:
        return wanted
    changes.append(broken)
    side = math.copysign(1.0, math.remainder(wanted.heading_rad - motion.heading_rad, math.tau))
    # The back-up was certified for the speed flown, so continuing it is always among the choices.
    flown_m_s = min(max(motion.speed_m_s, limits.speed_min_m_s), limits.speed_max_m_s)
    choices = []
    for speed_m_s in (wanted.speed_m_s, flown_m_s):
        turn_rad = min(_turn_rate_rad_s(max(speed_m_s, motion.speed_m_s), limits) * dt_s, BACKUP_TURN_RAD)
        choices += [_Step(motion.heading_rad + sign * turn_rad, speed_m_s) for sign in (side, -side)]
    if limits.braking_m_s2 is not None:
        choices.append(_Step(motion.heading_rad, 0.0))
    for spare_m in (ROUNDING_M, 0.0):
        for choice in choices:
            if _broken(choice, motion, discs, limits, dt_s, spare_m) is None:
                return choice
    changes.append(NO_BACKUP)
    return max([wanted, *choices], key=lambda choice: _clearance_m(choice, motion, discs, limits, dt_s))


def _broken(step: _Step, motion: Motion, discs: Discs, limits: Limits, dt_s: float, spare_m: float) -> str | None:
    """Return what a step would break, during it or for want of a back-up after it; None if nothing."""
    path_ned_m, times_s = _path(step, motion, limits, dt_s)
    faster_m_s = max(motion.speed_m_s, step.speed_m_s)
    # How far off the path the vehicle can be while its speed is anywhere between the two: none of it straight ahead.
    change_m = abs(motion.speed_m_s - step.speed_m_s) * dt_s
    beside_m = change_m * abs(math.remainder(step.heading_rad - motion.heading_rad, math.tau))
    margin_m = faster_m_s * dt_s / STEP_SAMPLES / 2.0 + beside_m
    if _clearances_m(path_ned_m, times_s, discs).min() < margin_m:
        return KEEP_OUT
    if limits.fence_ned_m is not None and not _path_inside(path_ned_m, limits.fence_ned_m, margin_m):
        return FENCE
    end = (float(path_ned_m[-1, 0]), float(path_ned_m[-1, 1]))
    grown_m = discs.radii_m + discs.speeds_m_s * (dt_s + limits.horizon_s)
    after = replace(discs, radii_m=grown_m)
    if limits.braking_m_s2 is not None:
        length_m = _speed_after_m_s(step, motion, limits.braking_m_s2, dt_s) ** 2 / (2.0 * limits.braking_m_s2)
        return _broken_braking(end, step.heading_rad, length_m, after, limits.fence_ned_m, margin_m + spare_m)
    # A circle starts where the step ends, so being early or late counts too.
    return _broken_circles(end, step, after, limits, dt_s, margin_m + change_m + spare_m)


def _broken_circles(
    end_ned_m: tuple[float, float], step: _Step, discs: Discs, limits: Limits, dt_s: float, margin_m: float
) -> str | None:
    """Return what turning on, to either side, after a step would break; None if one side is clear.

    A step turns by at most `BACKUP_TURN_RAD`, then flies straight: a square with rounded corners, whose sides vanish
    where the turn takes the whole step. It lies in a ring about its centre.
    """
    rate_rad_s = _turn_rate_rad_s(step.speed_m_s, limits)
    half_side_m = step.speed_m_s * max(0.0, dt_s - BACKUP_TURN_RAD / rate_rad_s) / 2.0
    inner_m = step.speed_m_s / rate_rad_s + half_side_m
    outer_m = step.speed_m_s / rate_rad_s + half_side_m * math.sqrt(2.0)
    ahead = (math.cos(step.heading_rad), math.sin(step.heading_rad))
    for side in (1.0, -1.0):
        centre = (
            end_ned_m[0] - side * inner_m * ahead[1] - half_side_m * ahead[0],
            end_ned_m[1] + side * inner_m * ahead[0] - half_side_m * ahead[1],
        )
        apart_m = np.hypot(discs.centres_ned_m[:, 0] - centre[0], discs.centres_ned_m[:, 1] - centre[1])
        # Clear means wholly outside the ring, or (a small disc) wholly within it.
        grown_m = discs.radii_m + margin_m
        if np.any((apart_m - outer_m < grown_m) & (inner_m - apart_m < grown_m)):
            broken = KEEP_OUT
        elif limits.fence_ned_m is not None and not _disc_inside(centre, outer_m + margin_m, limits.fence_ned_m):
            broken = FENCE
        else:
            return None
    return broken


def _broken_braking(
    end_ned_m: tuple[float, float],
    heading_rad: float,
    length_m: float,
    discs: Discs,
    fence_ned_m: Sequence[tuple[float, float]] | None,
    margin_m: float,
) -> str | None:
    """Return what braking straight ahead after a step would break; None if it is clear."""
    stop = (end_ned_m[0] + length_m * math.cos(heading_rad), end_ned_m[1] + length_m * math.sin(heading_rad))
    for north_m, east_m, radius_m in np.column_stack([discs.centres_ned_m, discs.radii_m]).tolist():
        if _distance_to_segment_m((north_m, east_m), end_ned_m, stop) < radius_m + margin_m:
            return KEEP_OUT
    if fence_ned_m is not None and not _segment_inside(end_ned_m, stop, fence_ned_m, margin_m):
        return FENCE
    return None


def _speed_after_m_s(step: _Step, motion: Motion, braking_m_s2: float, dt_s: float) -> float:
    return max(step.speed_m_s, motion.speed_m_s - braking_m_s2 * dt_s)


def _clearance_m(step: _Step, motion: Motion, discs: Discs, limits: Limits, dt_s: float) -> tuple[float, float]:
    """Return the least clearance on the step and straight on for as long again, and that at the end of this.

    It is what to go by when nothing is sure. The first does not tell apart the ways out of a disc: the second does.
    """
    path_ned_m, times_s = _path(step, motion, limits, dt_s)
    beyond = path_ned_m[-1] + (path_ned_m[-1] - path_ned_m[0])
    path_ned_m, times_s = np.vstack([path_ned_m, beyond]), np.append(times_s, 2.0 * dt_s)
    clear_m = _clearances_m(path_ned_m, times_s, discs)
    if limits.fence_ned_m is not None:
        inside_m = [_depth_inside_m((north_m, east_m), limits.fence_ned_m) for north_m, east_m in path_ned_m.tolist()]
        clear_m = np.minimum(clear_m, inside_m)
    return float(clear_m.min()), float(clear_m[-1])


def _path(
    step: _Step, motion: Motion, limits: Limits, dt_s: float
) -> tuple[np.ndarray, np.ndarray]:  # (STEP_SAMPLES + 2, 2) m; (STEP_SAMPLES + 2,) s
    """Return points of the step and their times: an arc until the heading is reached, then straight.

    Between two of them the vehicle either turns all the time or not at all, so chords join them exactly.
    """
    turn_rad = math.remainder(step.heading_rad - motion.heading_rad, math.tau)
    faster_m_s = max(step.speed_m_s, motion.speed_m_s)
    rate_rad_s = _turn_rate_rad_s(faster_m_s, limits)
    turning_s = min(abs(turn_rad) / rate_rad_s, dt_s)
    times_s = np.sort(np.append(np.linspace(0.0, dt_s, STEP_SAMPLES + 1), turning_s))
    headings_rad = motion.heading_rad + math.copysign(rate_rad_s, turn_rad) * np.minimum(times_s, turning_s)
    flown_m = faster_m_s * times_s
    if limits.braking_m_s2 is not None:
        braking_s = np.minimum(times_s, (faster_m_s - step.speed_m_s) / limits.braking_m_s2)
        flown_m = (
            step.speed_m_s * times_s + (faster_m_s - step.speed_m_s - limits.braking_m_s2 * braking_s / 2.0) * braking_s
        )
    half_rad = np.diff(headings_rad) / 2.0
    chords_m = np.diff(flown_m) * np.sinc(half_rad / math.pi)
    middle_rad = headings_rad[:-1] + half_rad
    steps_m = np.column_stack([chords_m * np.cos(middle_rad), chords_m * np.sin(middle_rad)])
    start = np.array([[motion.north_m, motion.east_m]])
    return np.vstack([start, start + np.cumsum(steps_m, axis=0)]), times_s


def _clearances_m(
    path_ned_m: np.ndarray,  # (S, 2) m
    times_s: np.ndarray,  # (S,) s from now
    discs: Discs,
) -> np.ndarray:  # (S,) m
    apart_m = np.hypot(
        path_ned_m[:, None, 0] - discs.centres_ned_m[None, :, 0],
        path_ned_m[:, None, 1] - discs.centres_ned_m[None, :, 1],
    )
    grown_m = discs.radii_m + times_s[:, None] * discs.speeds_m_s
    clear_m: np.ndarray = np.min(apart_m - grown_m, axis=1, initial=math.inf)
    return clear_m


def _turn_rate_rad_s(speed_m_s: float, limits: Limits) -> float:
    """Return n_max g / v."""
    return limits.n_max * STANDARD_GRAVITY_M_S2 / max(speed_m_s, PIVOT_SPEED_M_S)


def _path_inside(path_ned_m: np.ndarray, fence_ned_m: Sequence[tuple[float, float]], margin_m: float) -> bool:
    return all(_disc_inside((north_m, east_m), margin_m, fence_ned_m) for north_m, east_m in path_ned_m.tolist())


def _disc_inside(centre: tuple[float, float], radius_m: float, fence_ned_m: Sequence[tuple[float, float]]) -> bool:
    return _depth_inside_m(centre, fence_ned_m) >= radius_m


def _depth_inside_m(point: tuple[float, float], fence_ned_m: Sequence[tuple[float, float]]) -> float:
    """Return the distance to the nearest edge of a simple polygon, negative outside of it (even-odd)."""
    sign = -1.0
    nearest_m = math.inf
    for start, end in _edges(fence_ned_m):
        if (end[0] > point[0]) != (start[0] > point[0]):
            share = (point[0] - start[0]) / (end[0] - start[0])
            if point[1] < start[1] + share * (end[1] - start[1]):
                sign = -sign
        nearest_m = min(nearest_m, _distance_to_segment_m(point, start, end))
    return sign * nearest_m


def _edges(
    fence_ned_m: Sequence[tuple[float, float]],
) -> Iterator[tuple[tuple[float, float], tuple[float, float]]]:
    start = fence_ned_m[-1]
    for end in fence_ned_m:
        yield start, end
        start = end


def _segment_inside(
    first: tuple[float, float], last: tuple[float, float], fence_ned_m: Sequence[tuple[float, float]], margin_m: float
) -> bool:
    """Return whether a segment lies inside a simple polygon and no edge comes nearer than the margin.

    Two segments that do not cross are nearest at an end of one of them; one that crosses an edge runs from inside to
    outside, or past a corner.
    """
    if not (_disc_inside(first, margin_m, fence_ned_m) and _disc_inside(last, margin_m, fence_ned_m)):
        return False
    return not any(
        _cross(first, last, start, end) or _distance_to_segment_m(end, first, last) < margin_m
        for start, end in _edges(fence_ned_m)
    )


def _cross(
    first: tuple[float, float], last: tuple[float, float], start: tuple[float, float], end: tuple[float, float]
) -> bool:
    """Return whether two segments cross, each with its ends on both sides of the other."""
    return (_side(first, last, start) > 0.0) != (_side(first, last, end) > 0.0) and (
        _side(start, end, first) > 0.0
    ) != (_side(start, end, last) > 0.0)


def _side(start: tuple[float, float], end: tuple[float, float], point: tuple[float, float]) -> float:
    """Return a number whose sign says on which side of a line a point lies."""
    return (end[0] - start[0]) * (point[1] - start[1]) - (end[1] - start[1]) * (point[0] - start[0])


def _distance_to_segment_m(point: tuple[float, float], start: tuple[float, float], end: tuple[float, float]) -> float:
    along = (end[0] - start[0], end[1] - start[1])
    length_2 = along[0] ** 2 + along[1] ** 2
    share = 0.0
    if length_2 > 0.0:
        share = ((point[0] - start[0]) * along[0] + (point[1] - start[1]) * along[1]) / length_2
        share = min(1.0, max(0.0, share))
    return math.hypot(point[0] - start[0] - share * along[0], point[1] - start[1] - share * along[1])
