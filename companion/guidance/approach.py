"""How a vehicle that can stop flies to a place and stands there: by velocities whose change is bounded.

A vehicle that slows down can turn faster, so a change of velocity towards the wanted one never ends in a circle about
the place: the difference of the two only shrinks (docs/method.md section 3, "Vehicles that can stop"). Velocities and
places are complex numbers where they are added: north is the real part, east the imaginary one.
"""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

from companion.geo.kinematics import PIVOT_SPEED_M_S
from companion.geo.right_of_way import SPEED_UP_SHARE

GAIN_1_S = 0.5
"""Greatest speed near a place, per metre of distance from it: with twice as much copters, which follow a velocity late,
swing about the place."""
GAIN_DELAYS = 0.6
"""Bound of the gain for slower vehicles: its product with the time until a decision acts."""
SPEED_LAG_S = 0.4
"""Lag of a speed beyond the reaction: copters follow a velocity 0.5 to 0.62 s late (docs/autopilots.md), of which the
adapters' reaction of 0.2 s holds what their lead in turns leaves, and a speed has no lead."""
BRAKING_SHARE = 0.8
"""Share of the braking that an approach uses: the rest is for the lag that follows a speed."""
TURNING_AROUND_RAD = 0.5 * math.pi
"""Difference of headings from which a vehicle at cruise speed slows down to turn."""
CRUISING_SHARE = 0.9
"""Share of the cruise speed from which a vehicle that flies on keeps its speed in turns."""
STANDING_WITHIN_M = 0.5
"""Distance from its place within which a vehicle stops."""
STAYING_WITHIN_M = 1.0
"""Distance from its place within which a vehicle that stands stays standing."""
STANDS_WITHIN_S = 11.0
"""Time in which a vehicle is to stand at a place that it chooses on its way: 15 s, less what lags and steps may add."""
STANDING_M_S = 0.3
"""Speed below which a vehicle stands."""
LEAD_S = 1.0
"""Time, beyond the reaction and a step, in which a commanded velocity may be ahead of the flown one: copters lag behind
a velocity by up to 0.62 s (docs/autopilots.md)."""


class Pace(NamedTuple):
    """How fast a vehicle that can stop flies, and how it changes that."""

    cruise_m_s: float
    braking_m_s2: float
    sideways_m_s2: float
    """Greatest acceleration across the way: n_max g."""
    reaction_s: float
    dt_s: float
    """Length of a guidance step."""

    @property
    def delay_s(self) -> float:
        """Time from a decision on a speed to the middle of its effect."""
        return self.reaction_s + SPEED_LAG_S + 0.5 * self.dt_s

    @property
    def gain_1_s(self) -> float:
        """Speed near a place, per metre of distance from it."""
        return min(GAIN_1_S, GAIN_DELAYS / self.delay_s)


class Flown(NamedTuple):
    """A velocity as heading (rad, clockwise from north) and speed."""

    heading_rad: float
    speed_m_s: float

    @property
    def vector(self) -> complex:
        """The velocity, m/s."""
        return cmath.rect(self.speed_m_s, self.heading_rad)


def approach_speed_m_s(distance_m: float, pace: Pace) -> float:
    """Return the speed at which to approach a place at a distance, so as to stand there: 0 at the place itself."""
    gain_1_s, braking_m_s2 = pace.gain_1_s, BRAKING_SHARE * pace.braking_m_s2
    linear_m = braking_m_s2 / (gain_1_s * gain_1_s)
    if distance_m <= linear_m:
        return min(gain_1_s * distance_m, pace.cruise_m_s)
    return min(math.sqrt(2.0 * braking_m_s2 * (distance_m - 0.5 * linear_m)), pace.cruise_m_s)


def approach_m(speed_m_s: float, pace: Pace) -> float:
    """Return the distance before a place at which a vehicle at a speed decides to slow down for it."""
    gain_1_s, braking_m_s2 = pace.gain_1_s, BRAKING_SHARE * pace.braking_m_s2
    coming_m = speed_m_s * pace.delay_s
    if speed_m_s <= braking_m_s2 / gain_1_s:
        return coming_m + speed_m_s / gain_1_s
    return coming_m + speed_m_s * speed_m_s / (2.0 * braking_m_s2) + 0.5 * braking_m_s2 / (gain_1_s * gain_1_s)


def led(commanded: Flown, measured: Flown, pace: Pace) -> Flown:
    """Return the commanded velocity, brought back to where a vehicle that follows it may be behind it.

    It may always be a quarter turn ahead of the measured one, or a reversal that has passed through standing still: a
    vehicle that the wind carries along would otherwise be commanded on by what the wind does.
    """
    ahead = commanded.vector - measured.vector
    most_m_s = max(SPEED_UP_SHARE * pace.braking_m_s2, pace.sideways_m_s2) * (pace.reaction_s + pace.dt_s + LEAD_S)
    most_m_s = max(most_m_s, math.sqrt(2.0) * measured.speed_m_s)
    if abs(ahead) <= most_m_s:
        return commanded
    return _flown(measured.vector + ahead * (most_m_s / abs(ahead)), commanded.heading_rad)


def bounded(before: Flown, wanted: Flown, to_go_m: float, pace: Pace) -> Flown:
    """Return the velocity to command for a step on the way from the one before to the wanted one.

    Near its cruise speed a vehicle keeps its speed (the turn limit makes an arc of the turn) unless it is to turn
    around, or what it flies to, at a distance of `to_go_m`, lies inside the circle of that turn. Else the velocity goes
    straight towards the wanted one, by no more than braking, speeding up and turning allow together.
    """
    off_rad = abs(math.remainder(wanted.heading_rad - before.heading_rad, math.tau))
    if off_rad <= TURNING_AROUND_RAD and min(before.speed_m_s, wanted.speed_m_s) >= CRUISING_SHARE * pace.cruise_m_s:
        faster_m_s = max(before.speed_m_s, wanted.speed_m_s)
        chord_m = 2.0 * faster_m_s * faster_m_s / pace.sideways_m_s2 * math.sin(off_rad)
        if to_go_m >= chord_m:
            return wanted
    change = wanted.vector - before.vector
    if before.speed_m_s >= PIVOT_SPEED_M_S:
        change *= min(1.0, 1.0 / max(_effort(change * cmath.rect(1.0, -before.heading_rad), pace), 1e-12))
    else:
        most_m_s = SPEED_UP_SHARE * pace.braking_m_s2 * pace.dt_s
        change *= min(1.0, most_m_s / max(abs(change), 1e-12))
    after = _flown(before.vector + change, wanted.heading_rad)
    # What the turn of a step cannot reach is flown when it can: until then the vehicle only gets slower.
    short_rad = abs(math.remainder(after.heading_rad - _turned_rad(before, after, pace), math.tau))
    return Flown(after.heading_rad, after.speed_m_s * max(0.0, math.cos(short_rad)))


def towards(place: complex, here: complex, flown: Flown, pace: Pace) -> complex:
    """Return the way from where the vehicle will be when a decision acts to a place, m."""
    return place - here - flown.vector * pace.delay_s


def time_to_stand_s(place: complex, here: complex, flown: Flown, pace: Pace, longest_s: float) -> float:
    """Return how long a vehicle takes to stand at a place, in still air; infinity if longer than `longest_s`.

    Its velocity follows the commanded one with a lag of the reaction and SPEED_LAG_S.
    """
    velocity_m_s = flown.vector
    followed = -math.expm1(-pace.dt_s / (pace.reaction_s + SPEED_LAG_S))
    for step in range(math.ceil(longest_s / pace.dt_s)):
        away_m = abs(place - here)
        if away_m <= STAYING_WITHIN_M and abs(velocity_m_s) < STANDING_M_S:
            return step * pace.dt_s
        way = towards(place, here, flown, pace)
        wanted_m_s = approach_speed_m_s(abs(way), pace) if away_m > STANDING_WITHIN_M else 0.0
        after = bounded(flown, _flown(way * (wanted_m_s / (abs(way) or 1.0)), flown.heading_rad), abs(way), pace)
        flown = Flown(_turned_rad(flown, after, pace), after.speed_m_s)
        before_m_s, velocity_m_s = velocity_m_s, velocity_m_s + (flown.vector - velocity_m_s) * followed
        here += 0.5 * (before_m_s + velocity_m_s) * pace.dt_s
    return math.inf


def _flown(vector: complex, standing_rad: float) -> Flown:
    """Return a velocity vector as a heading and a speed; `standing_rad` is the heading of one that is zero."""
    if vector == 0.0:
        return Flown(standing_rad % math.tau, 0.0)
    return Flown(math.atan2(vector.imag, vector.real) % math.tau, abs(vector))


def _turned_rad(before: Flown, after: Flown, pace: Pace) -> float:
    """Return the heading that the turn of a step reaches, at the greater of the speeds before and after it."""
    faster_m_s = max(before.speed_m_s, after.speed_m_s, PIVOT_SPEED_M_S)
    most_rad = pace.sideways_m_s2 / faster_m_s * pace.dt_s
    turn_rad = math.remainder(after.heading_rad - before.heading_rad, math.tau)
    return (before.heading_rad + min(max(turn_rad, -most_rad), most_rad)) % math.tau


def _effort(change: complex, pace: Pace) -> float:
    """Return which part of what a step allows a change of velocity needs; the way flown is the real axis."""
    along_m_s2 = (SPEED_UP_SHARE if change.real > 0.0 else 1.0) * pace.braking_m_s2
    return math.hypot(change.real / along_m_s2, change.imag / pace.sideways_m_s2) / pace.dt_s
