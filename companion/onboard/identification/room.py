"""The room that a pattern needs, and whether the vehicle has it inside fence and discs: known before it is flown."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from companion.geo.kinematics import advance, shorter_turn_rad, turn_rate_rad_s
from companion.guard.fence import Fence
from companion.guard.types import Discs, Motion
from companion.onboard.config import LimitsSection
from companion.onboard.identification.pattern import Pattern, advanced, begun, wanted

SLUGGISH_S = 1.5
"""Reaction of the worst vehicle that there must be room for: PX4's plane without a lead has 1.17 s."""
SLUGGISH_SHARE = 0.35
"""Turn rate of that vehicle, as a share of n_max g/v: PX4's quadrotor with its own drag has 0.33."""
LOITER_S = 9.0
"""Time in which a plane whose setpoints end flies as far as it gets: ArduPlane 192 m at 22 m/s (docs/autopilots.md)."""
STOPPING_S = 1.0
"""Time until a vehicle that can stop begins to brake: ArduCopter at 8 m/s stood 24 m after its companion died."""
COURSES = 8
"""Number of courses on which a pattern may begin, of which the first with enough room is taken."""
LONGEST_S = 400.0
"""Time after which a pattern's path is not followed further: no pattern lasts half as long."""


class Room(NamedTuple):
    """A pattern's extent, and the least distance of its path from fence and discs."""

    across_m: float
    """Greatest distance between two points of the path along north or east."""
    clear_m: float
    """Least distance to fence and discs, negative outside the fence or in a disc; infinite where there is neither."""
    reach_m: float
    """Greatest distance of the path from where it begins."""
    lasts_s: float


def stopping_m(limits: LimitsSection, can_stop: bool, speed_m_s: float) -> float:
    """Return how far from fence and discs the pattern must be ended for the vehicle to be safe by itself."""
    if can_stop:
        way_m = STOPPING_S * speed_m_s + speed_m_s * speed_m_s / (2.0 * limits.braking_m_s2)
    else:
        way_m = LOITER_S * speed_m_s
    return way_m + limits.position_error_m


def clearance_m(place_ned_m: tuple[float, float], fence: Fence | None, discs: Discs, after_s: float = 0.0) -> float:
    """Return the distance of a place from the fence and from the discs as they may be `after_s` from now."""
    clear_m = math.inf if fence is None else fence.depth_m(*place_ned_m)
    if len(discs.radii_m):
        away_m = np.hypot(*(discs.centres_ned_m - np.array(place_ned_m)).T)
        clear_m = min(clear_m, float(np.min(away_m - discs.radii_m - discs.speeds_m_s * after_s)))
    return clear_m


def room_of(
    pattern: Pattern, motion: Motion, limits: LimitsSection, step_s: float, fence: Fence | None, discs: Discs
) -> Room:
    """Return the room that a pattern takes, flown by the vehicle as it is reckoned with and by a sluggish one."""
    places: list[tuple[float, float]] = []
    clear_m, lasts_s = math.inf, 0.0
    for reaction_s, share in ((limits.reaction_s, limits.rate_share), (SLUGGISH_S, SLUGGISH_SHARE)):
        flown = list(_flown(pattern, motion, limits, step_s, (reaction_s, share)))
        lasts_s = max(lasts_s, len(flown) * step_s)
        places += flown
    if fence is not None or len(discs.radii_m):
        clear_m = min(clearance_m(place, fence, discs, lasts_s) for place in places[:: max(1, round(1.0 / step_s))])
    away_m = np.array(places) - np.array(motion.position_ned_m)
    return Room(float(np.ptp(away_m, axis=0).max()), clear_m, float(np.hypot(*away_m.T).max()), lasts_s)


def _flown(
    pattern: Pattern, motion: Motion, limits: LimitsSection, step_s: float, obeys: tuple[float, float]
) -> Iterator[tuple[float, float]]:
    """Yield the places of a vehicle that flies the pattern; `obeys`: its reaction in s and its share of the turn rate.

    It changes its speed by `braking_m_s2`.
    """
    reaction_s, share = obeys
    progress, t_s = begun(pattern, motion, 0.0), 0.0
    delayed = deque([(motion.heading_rad, motion.speed_m_s)] * round(reaction_s / step_s))
    while t_s < LONGEST_S:
        delayed.append(wanted(pattern, progress, motion))
        heading_rad, speed_m_s = delayed.popleft()
        most_m_s = limits.braking_m_s2 * step_s
        flown_m_s = motion.speed_m_s + min(max(speed_m_s - motion.speed_m_s, -most_m_s), most_m_s)
        rate_rad_s = share * turn_rate_rad_s(flown_m_s, limits.n_max)
        turn_rad = shorter_turn_rad(motion.heading_rad, heading_rad)
        turn_rad = min(max(turn_rad, -rate_rad_s * step_s), rate_rad_s * step_s)
        place = advance(motion.north_m, motion.east_m, motion.heading_rad, flown_m_s, turn_rad / step_s, step_s)
        motion = Motion(*place, flown_m_s)
        t_s += step_s
        yield motion.position_ned_m
        following = advanced(pattern, progress, motion, t_s)
        if following is None:
            return
        progress = following
