"""Whether a vehicle comes nearer to where it goes, and which passages are closed because the guard refuses them.

A route is planned with the clearances that following it needs, so the guard lets it pass, but for what the plan cannot
know. A passage that it refuses all the same is closed for a while, so that another way is taken or the reason is said.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from companion.guard.types import Piece
from companion.guidance.course import at
from companion.guidance.turning_place import Room, room_m

PATIENCE_CIRCLES = 3.0
"""Time without coming nearer after which a refused passage is closed, in times to turn once around."""
PATIENCE_STEPS = 20.0
"""Guidance steps that are added to that time."""
CLOSED_PATIENCES = 20.0
"""How long a passage stays closed, in times without coming nearer."""
CLOSED_M = 1.0
"""Width by which what closes a passage overlaps its sides."""
SAME_GAINS = 20.0
"""Distance that a goal may move from step to step and still be the same, in the least gain that is progress."""
PLACES = 200
"""Number of places along a route at which room to turn is looked for."""


class Closed(NamedTuple):
    """A passage that is closed: a disc that fills it, and until when."""

    centre_ned_m: tuple[float, float]
    radius_m: float
    until_s: float


class Progress(NamedTuple):
    """How near a vehicle has come to a place, and since when it has come no nearer."""

    place_ned_m: tuple[float, float]
    least_m: float
    """Least length of the way to the place."""
    since_s: float
    """Time when it was reached."""
    refused: bool = False
    """Whether the guard has refused a step since."""
    closed: tuple[Closed, ...] = ()


def watched(
    before: Progress | None,
    place_ned_m: tuple[float, float],
    to_go_m: float,
    refused: bool,
    gain_m: float,
    now_s: float,
) -> Progress:
    """Return the progress after a step, of which the last one may have been refused.

    A way that is shorter by less than `gain_m` is no progress, so that circling is none.
    """
    if before is None or not is_same(before.place_ned_m, place_ned_m, gain_m):
        return Progress(place_ned_m, to_go_m, now_s, refused)
    before = before._replace(place_ned_m=place_ned_m)
    closed = tuple(passage for passage in before.closed if passage.until_s > now_s)
    if to_go_m <= before.least_m - gain_m:
        return Progress(place_ned_m, to_go_m, now_s, refused, closed)
    return before._replace(refused=before.refused or refused, closed=closed)


def is_same(place_ned_m: tuple[float, float], other_ned_m: tuple[float, float], gain_m: float) -> bool:
    """Return whether two places are the same goal, which may have moved a little from one broadcast to the next."""
    return math.dist(place_ned_m, other_ned_m) <= SAME_GAINS * gain_m


def patience_s(turn_radius_m: float, speed_m_s: float, step_s: float) -> float:
    """Return the time without coming nearer after which something must change."""
    return PATIENCE_CIRCLES * math.tau * turn_radius_m / speed_m_s + PATIENCE_STEPS * step_s


def after_closing(progress: Progress, pieces: Sequence[Piece], room: Room, radius_m: float, now_s: float) -> Progress:
    """Return the progress with the first passage along a route closed where there is no room to turn, watched anew.

    Where there is room to turn everywhere, nothing is closed.
    """
    waited_s = now_s - progress.since_s
    begun = progress._replace(least_m=math.inf, since_s=now_s, refused=False)
    place_ned_m = _first_narrow(pieces, room, radius_m)
    if place_ned_m is None:
        return begun
    width_m = max(float(room_m(room, np.array([place_ned_m]))[0]), 0.0) + CLOSED_M
    passage = Closed(place_ned_m, width_m, now_s + CLOSED_PATIENCES * waited_s)
    return begun._replace(closed=(*begun.closed, passage))


def _first_narrow(pieces: Sequence[Piece], room: Room, radius_m: float) -> tuple[float, float] | None:
    """Return the first place along a route from which neither turning circle is clear; None if there is none."""
    if not pieces:
        return None
    length_m = sum(piece.length_m for piece in pieces)
    poses = np.array([at(pieces, length_m * count / PLACES) for count in range(PLACES + 1)])
    aside_m = radius_m * np.column_stack((-np.sin(poses[:, 2]), np.cos(poses[:, 2])))
    clear = np.zeros(len(poses), dtype=bool)
    for side in (1.0, -1.0):
        clear |= room_m(room, poses[:, :2] + side * aside_m) >= radius_m
    narrow = np.flatnonzero(~clear)
    if not len(narrow):
        return None
    first = poses[narrow[0]]
    return float(first[0]), float(first[1])
