"""Where a vehicle that can stop stands to loiter, and how fast it may change its velocity, by its configuration."""

from __future__ import annotations

import cmath
import math

import numpy as np

from companion.geo.kinematics import GRAVITY_M_S2
from companion.guard.types import Motion, Setpoint
from companion.guidance.approach import (
    STANDING_M_S,
    STANDS_WITHIN_S,
    STAYING_WITHIN_M,
    Flown,
    Pace,
    approach_m,
    led,
    time_to_stand_s,
)
from companion.guidance.course import held_m
from companion.guidance.turning_place import Room, room_m
from companion.guidance.view import View
from companion.onboard.config import Config

PLACES_ON_THE_WAY = 12
"""Number of places, evenly from a target to where the vehicle can stop, of which the first that will do is taken."""


def pace_of(config: Config) -> Pace:
    """Return how fast a vehicle that can stop flies and changes its velocity by its limits."""
    limits = config.limits
    return Pace(
        cruise_m_s=limits.speed_m_s,
        braking_m_s2=limits.braking_m_s2,
        sideways_m_s2=limits.rate_share * limits.n_max * GRAVITY_M_S2,
        reaction_s=limits.reaction_s,
        dt_s=config.guidance_step_s,
    )


def flown_of(config: Config, motion: Motion, in_force: Setpoint | None) -> Flown:
    """Return the velocity from which the next one is commanded: the last command, or the motion before the first."""
    measured = Flown(motion.heading_rad, motion.speed_m_s)
    if in_force is None:
        return measured
    return led(Flown(in_force.heading_rad, in_force.speed_m_s), measured, pace_of(config))


def standing_place(
    config: Config,
    view: View,
    position_ned_m: tuple[float, float],
    flown: Flown,
    about_ned_m: tuple[float, float] | None,
) -> tuple[float, float]:
    """Return the place nearest to what to loiter at where the vehicle can stand soon, clear of discs and walls.

    Looked at are places on the straight line from there to where the vehicle comes to a stop or, if there is nothing to
    loiter at, from where it comes to a stop to where it is; the rest of the line must be clear as well. If none will
    do, it is the end of the line.
    """
    pace = pace_of(config)
    here = complex(*position_ned_m)
    ahead_m = approach_m(flown.speed_m_s, pace) if flown.speed_m_s >= STANDING_M_S else 0.0
    stop = here + cmath.rect(ahead_m, flown.heading_rad)
    first, last = (stop, here) if about_ned_m is None else (complex(*about_ned_m), stop)
    steps = 1 if first == last else PLACES_ON_THE_WAY
    places = [first + (last - first) * (index / steps) for index in range(steps)]
    clear = _clear(config, view, places)
    for index, place in enumerate(places):
        if all(clear[index:]) and time_to_stand_s(place, here, flown, pace, STANDS_WITHIN_S) < math.inf:
            return place.real, place.imag
    return last.real, last.imag


def _clear(config: Config, view: View, places: list[complex]) -> list[bool]:
    """Return for each place whether the guard lets a vehicle stand there, with what it may drift."""
    limits = config.limits
    kept_m = held_m(limits.position_error_m, limits.wind_m_s, limits.reaction_s, config.guidance_step_s)
    kept_m += STAYING_WITHIN_M
    room = Room(
        view.threats_ned_m,
        view.keep_out_m(config.keep_out) + kept_m,
        np.array(limits.fence or ()).reshape(-1, 2),
        tuple(np.array(corners) for corners in limits.exclusions),
        kept_m,
    )
    clear: list[bool] = (room_m(room, np.array([(place.real, place.imag) for place in places])) >= 0.0).tolist()
    return clear
