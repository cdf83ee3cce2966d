"""Geometry of paths made of straight lines and arcs: where they lead, and whether they stay clear of growing discs.

Everything here is a pure function of its arguments, and a closed form wherever there is one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from companion.guard.types import Motion, Piece

TURN_TOLERANCE_RAD = 1e-9
"""Difference up to which two turns count as equal, so that rounding never puts a setpoint over the turn limit."""
FAN_STEPS = 32
"""Number of headings tried to either side, evenly over a full turn, where none of the likely headings is clear."""
FAN_STEP_RAD = math.tau / FAN_STEPS
"""Angle between neighbouring headings of the fan: 11.25 degrees."""
SUB_ARC_RAD = math.pi / 4.0
"""Greatest part of an arc that is checked at once, with every moving disc as large as it is at the part's end. (The fan
checks parts of FAN_STEP_RAD instead.)"""


class Pose(NamedTuple):
    """A position on the mission's plane and a heading, clockwise from north."""

    north_m: float
    east_m: float
    heading_rad: float


class Path(NamedTuple):
    """A path flown at one speed: pieces in order, of which the last `loops` are repeated for ever.

    `lasts_s` is for how long after its start the path is certified to stay clear.
    """

    pieces: tuple[Piece, ...]
    loops: int
    speed_m_s: float
    lasts_s: float


Disc = tuple[float, float, float, float]
"""A keep-out disc (north_m, east_m, radius_m, speed_m_s). The radius is that at the time of the tip (the state at which
the next command begins to act), inflated by how far the vehicle may be off its path."""


def pose_of(motion: Motion) -> Pose:
    """Return the position and the heading of a motion."""
    return Pose(motion.north_m, motion.east_m, motion.heading_rad)


def straight(pose: Pose, length_m: float) -> Piece:
    """Return the straight piece of a given length that begins at a pose."""
    return Piece(pose.north_m, pose.east_m, pose.heading_rad, 0.0, length_m)


def turned(pose: Pose, turn_rad: float, curvature_1_m: float, length_m: float) -> tuple[Piece, ...]:
    """Return an arc, cut into equal parts of at most SUB_ARC_RAD, followed by a straight line of `length_m`."""
    parts = math.ceil(abs(turn_rad) / SUB_ARC_RAD)
    pieces = []
    for _ in range(parts):
        arc_m = abs(turn_rad) / parts / curvature_1_m
        pieces.append(Piece(*pose, math.copysign(curvature_1_m, turn_rad), arc_m))
        pose = end_of(pieces[-1])
    pieces.append(straight(pose, length_m))
    return tuple(pieces)


def place_on(piece: Piece, along_m: float) -> Pose:
    """Return the pose at a distance along a piece: exact, and without loss of digits at small curvature."""
    half_rad = 0.5 * piece.curvature_1_m * along_m
    chord_m = along_m * (math.sin(half_rad) / half_rad) if half_rad else along_m
    middle_rad = piece.heading_rad + half_rad
    return Pose(
        piece.north_m + chord_m * math.cos(middle_rad),
        piece.east_m + chord_m * math.sin(middle_rad),
        middle_rad + half_rad,
    )


def end_of(piece: Piece) -> Pose:
    """Return the pose at the end of a piece."""
    return place_on(piece, piece.length_m)


def pose_at(path: Path, along_m: float) -> Pose:
    """Return the pose at a distance along a path; beyond the end of a path without a loop, its end."""
    first = len(path.pieces) - path.loops
    for piece in path.pieces[:first]:
        if along_m <= piece.length_m:
            return place_on(piece, along_m)
        along_m -= piece.length_m
    if path.loops == 0:
        return end_of(path.pieces[-1])
    loop = path.pieces[first:]
    along_m %= sum(piece.length_m for piece in loop)
    for piece in loop[:-1]:
        if along_m <= piece.length_m:
            return place_on(piece, along_m)
        along_m -= piece.length_m
    return place_on(loop[-1], along_m)


def rest_of(path: Path, along_m: float) -> tuple[Piece, ...]:
    """Return the pieces that are left after a distance along a path; its loop is returned whole."""
    first = len(path.pieces) - path.loops
    rest: list[Piece] = []
    for piece in path.pieces[:first]:
        done_m = min(along_m, piece.length_m)
        along_m -= done_m
        if done_m < piece.length_m:
            rest.append(Piece(*place_on(piece, done_m), piece.curvature_1_m, piece.length_m - done_m))
    return (*rest, *path.pieces[first:])


def seen_from(pose: Pose, place: Pose) -> tuple[float, float]:
    """Return (ahead_m, right_m), the position of a place relative to a pose."""
    north_m, east_m = place.north_m - pose.north_m, place.east_m - pose.east_m
    cosine, sine = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    return north_m * cosine + east_m * sine, east_m * cosine - north_m * sine


def nearest_along_m(path: Path, pose: Pose) -> float:
    """Return the distance along a path to its point nearest to a pose."""
    best_m, best_along_m, before_m = math.inf, 0.0, 0.0
    for piece in path.pieces:
        along_m = nearest_on_m(piece, pose)
        place = place_on(piece, along_m)
        apart_m = math.hypot(place.north_m - pose.north_m, place.east_m - pose.east_m)
        if apart_m < best_m:
            best_m, best_along_m = apart_m, before_m + along_m
        before_m += piece.length_m
    return best_along_m


def nearest_on_m(piece: Piece, pose: Pose) -> float:
    """Return the distance along a piece to its point nearest to a pose."""
    if piece.curvature_1_m == 0.0:
        return min(max(seen_from(Pose(*piece[:3]), pose)[0], 0.0), piece.length_m)
    north_m, east_m, radius_m = circle_of(piece)
    phase_rad = phase_of_rad(piece, pose.north_m - north_m, pose.east_m - east_m)
    if phase_rad * radius_m <= piece.length_m:
        return phase_rad * radius_m
    end = end_of(piece)
    to_start_m = math.hypot(pose.north_m - piece.north_m, pose.east_m - piece.east_m)
    return 0.0 if to_start_m < math.hypot(pose.north_m - end.north_m, pose.east_m - end.east_m) else piece.length_m


def circle_of(piece: Piece) -> tuple[float, float, float]:
    """Return (north_m, east_m, radius_m) of the circle that an arc is part of."""
    signed_m = 1.0 / piece.curvature_1_m
    north_m = piece.north_m - signed_m * math.sin(piece.heading_rad)
    return north_m, piece.east_m + signed_m * math.cos(piece.heading_rad), abs(signed_m)


def phase_of_rad(piece: Piece, north_m: float, east_m: float) -> float:
    """Return the turn, 0 to 2 pi, after which an arc reaches a bearing; (north_m, east_m) is from the arc's centre."""
    side = math.copysign(1.0, piece.curvature_1_m)
    return (side * (math.atan2(east_m, north_m) - piece.heading_rad) + math.pi / 2.0) % math.tau


def distance_m(piece: Piece, north_m: float, east_m: float) -> float:
    """Return the least distance from a place to a piece, in closed form."""
    dn_m, de_m = north_m - piece.north_m, east_m - piece.east_m
    if piece.curvature_1_m == 0.0:
        cosine, sine = math.cos(piece.heading_rad), math.sin(piece.heading_rad)
        along_m = min(max(dn_m * cosine + de_m * sine, 0.0), piece.length_m)
        return math.hypot(dn_m - along_m * cosine, de_m - along_m * sine)
    centre_north_m, centre_east_m, radius_m = circle_of(piece)
    from_north_m, from_east_m = north_m - centre_north_m, east_m - centre_east_m
    turned_rad = piece.length_m / radius_m
    if turned_rad >= math.tau or phase_of_rad(piece, from_north_m, from_east_m) <= turned_rad:
        return abs(math.hypot(from_north_m, from_east_m) - radius_m)
    end = end_of(piece)
    return min(math.hypot(dn_m, de_m), math.hypot(north_m - end.north_m, east_m - end.east_m))


def distances_m(piece: Piece, norths_m: np.ndarray, easts_m: np.ndarray) -> np.ndarray:  # (P,) m each
    """Return the distance from each of P points to a piece; see `distance_m`."""
    dn_m, de_m = norths_m - piece.north_m, easts_m - piece.east_m
    if piece.curvature_1_m == 0.0:
        cosine, sine = math.cos(piece.heading_rad), math.sin(piece.heading_rad)
        along_m = np.clip(dn_m * cosine + de_m * sine, 0.0, piece.length_m)
        return np.hypot(dn_m - along_m * cosine, de_m - along_m * sine)
    centre_north_m, centre_east_m, radius_m = circle_of(piece)
    from_north_m, from_east_m = norths_m - centre_north_m, easts_m - centre_east_m
    rim_m = np.abs(np.hypot(from_north_m, from_east_m) - radius_m)
    turned_rad = piece.length_m / radius_m
    if turned_rad >= math.tau:
        return rim_m
    side = math.copysign(1.0, piece.curvature_1_m)
    bearings_rad = np.arctan2(from_east_m, from_north_m)
    phases_rad = np.mod(side * (bearings_rad - piece.heading_rad) + math.pi / 2.0, math.tau)
    end = end_of(piece)
    ends_m = np.minimum(np.hypot(dn_m, de_m), np.hypot(norths_m - end.north_m, easts_m - end.east_m))
    return np.where(phases_rad <= turned_rad, rim_m, ends_m)


def is_hit(piece: Piece, discs: Iterable[Disc], grown_s: float, spare_m: float) -> bool:
    """Return whether a piece comes within `spare_m` of a disc that has grown at its speed for `grown_s`."""
    start_north_m, start_east_m, _, _, length_m = piece
    for north_m, east_m, radius_m, speed_m_s in discs:
        kept_m = radius_m + speed_m_s * grown_s + spare_m
        reach_m = kept_m + length_m
        dn_m, de_m = north_m - start_north_m, east_m - start_east_m
        # Most discs are so far away that this coarse test settles them.
        if dn_m * dn_m + de_m * de_m < reach_m * reach_m and distance_m(piece, north_m, east_m) < kept_m:
            return True
    return False


def is_clear(pieces: Iterable[Piece], discs: Sequence[Disc], slow_m_s: float, at_s: float, spare_m: float) -> bool:
    """Return whether pieces flown one after the other from `at_s` on, at no less than `slow_m_s`, stay clear of discs.

    Discs grow at their speeds, and `spare_m` is kept in addition. A straight line is decided exactly; for an arc each
    disc counts as large as it is at the arc's end.
    """
    for piece in pieces:
        ends_s = at_s + piece.length_m / slow_m_s
        if piece.curvature_1_m == 0.0:
            if is_met(piece, discs, slow_m_s, at_s, ends_s - at_s, spare_m):
                return False
        elif is_hit(piece, discs, ends_s, spare_m):
            return False
        at_s = ends_s
    return True


def is_met(line: Piece, discs: Iterable[Disc], slow_m_s: float, at_s: float, lasts_s: float, spare_m: float) -> bool:
    """Return whether a growing disc reaches a vehicle that flies along a line from `at_s` on, for `lasts_s`.

    It does where the quadratic of the guard's proof (companion/guard/guard.py) is negative. For a disc at least as fast
    as the vehicle `lasts_s` must be finite: the quadratic is then least at one of the line's ends.
    """
    ahead_north_m_s, ahead_east_m_s = slow_m_s * math.cos(line.heading_rad), slow_m_s * math.sin(line.heading_rad)
    for north_m, east_m, radius_m, speed_m_s in discs:
        dn_m, de_m = line.north_m - north_m, line.east_m - east_m
        kept_m = radius_m + speed_m_s * at_s + spare_m
        now_m2 = dn_m * dn_m + de_m * de_m - kept_m * kept_m
        if now_m2 < 0.0:
            return True
        half = dn_m * ahead_north_m_s + de_m * ahead_east_m_s - speed_m_s * kept_m
        if half >= 0.0 and slow_m_s > speed_m_s:
            continue
        closing = slow_m_s * slow_m_s - speed_m_s * speed_m_s
        nearest_s = min(-half / closing, lasts_s) if closing > 0.0 else lasts_s
        if now_m2 + nearest_s * (2.0 * half + closing * nearest_s) < 0.0:
            return True
    return False


def fan_rad(
    pose: Pose,
    curvature_1_m: float,
    length_m: float,
    slow_m_s: float,
    discs: np.ndarray,  # (M, 4) m, m, m, m/s
    most_rad: float,
) -> list[float]:
    """Return the turns, positive to the right, after which a straight line stays clear of moving discs, mildest first.

    Tried are the multiples of FAN_STEP_RAD up to `most_rad` to either side. Each is decided as `is_clear` would decide
    it, but all at once.
    """
    count = math.floor(most_rad / FAN_STEP_RAD + TURN_TOLERANCE_RAD)
    turns_rad = FAN_STEP_RAD * np.arange(count + 1)
    disc_norths_m, disc_easts_m, radii_m, speeds_m_s = discs.T
    grown_m = radii_m + speeds_m_s * (turns_rad[:, None] / (curvature_1_m * slow_m_s))
    closing = slow_m_s * slow_m_s - speeds_m_s * speeds_m_s
    found: list[tuple[float, float]] = []
    for side in (1.0, -1.0):
        north_m, east_m, radius_m = circle_of(Piece(*pose, side * curvature_1_m, 0.0))
        headings_rad = (pose.heading_rad + side * turns_rad)[:, None]
        dn_m = north_m + side * radius_m * np.sin(headings_rad) - disc_norths_m
        de_m = east_m - side * radius_m * np.cos(headings_rad) - disc_easts_m
        now_m2 = dn_m * dn_m + de_m * de_m - grown_m * grown_m
        half = slow_m_s * (dn_m * np.cos(headings_rad) + de_m * np.sin(headings_rad)) - speeds_m_s * grown_m
        nearest_s = np.clip(-half / np.where(closing > 0.0, closing, 1.0), 0.0, length_m / slow_m_s)
        nearest_s = np.where(closing > 0.0, nearest_s, length_m / slow_m_s)
        clear = (np.minimum(now_m2, now_m2 + nearest_s * (2.0 * half + closing * nearest_s)) >= 0.0).all(axis=1)
        from_north_m, from_east_m = disc_norths_m - north_m, disc_easts_m - east_m
        bearings_rad = np.arctan2(from_east_m, from_north_m)
        phases_rad = np.mod(side * (bearings_rad - pose.heading_rad) + math.pi / 2.0, math.tau)
        facing = (phases_rad >= turns_rad[:-1, None]) & (phases_rad <= turns_rad[1:, None])
        ends_m = np.hypot(dn_m, de_m)
        rim_m = np.abs(np.hypot(from_north_m, from_east_m) - radius_m)
        swept = (np.where(facing, rim_m, np.minimum(ends_m[:-1], ends_m[1:])) >= grown_m[1:]).all(axis=1)
        clear[1:] &= np.logical_and.accumulate(swept)
        found += [(turn_rad, side * turn_rad) for turn_rad in turns_rad[clear].tolist()]
    return [turn_rad for _, turn_rad in sorted(found, key=lambda pair: pair[0])]
