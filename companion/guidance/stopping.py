"""Right of way between vehicles that can stop: each keeps its way to a stop on its own side of a band between them.

The *way to a stop* of a vehicle is the straight line that it flies if it brakes now. The ways of two vehicles are
convex, so they lie on either side of a band as wide as their distance from each other, and both vehicles compute the
same band from what each detects of the other. Of what that band is wider than the separation, each uses at most its
half. Braking and flying away need none of it, so a vehicle may always stop, and two that stand may always move apart.
docs/separation.md has the proof.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from companion.geo.kinematics import limit_turn, nearest_on_way, shorter_turn_rad
from companion.geo.right_of_way import (
    LEAST_PART,
    Rules,
    braking_m_s2,
    interaction_radius_m,
    quickest_m_s,
    way_to_stop_m,
    way_width_m,
)
from companion.guard.types import Motion
from companion.guidance.resolution import (
    EVADING,
    PASSING,
    PIVOTING,
    SLOWING,
    STOPPING,
    Arc,
    AtEffect,
    Peers,
    Resolution,
    first_clockwise,
)

SPEED_FRACTIONS = (1.0, 0.75, 0.5, 0.35, 0.2, 0.1, 0.05)
"""Fractions of the cruise speed that are tried for a heading before the vehicle stops."""
BACK_RAD = 1.9
"""Turn to the right from the wanted heading from which a shorter one to the left is taken instead: a single neighbour
straight ahead asks for a little more than a right angle, and two can ask for a way back."""
EVADING_SHARE = 2.0
"""Distance from a stranger's course, in separations, up to which a vehicle makes way."""
STANDING_M_S = 0.2
"""Speed below which a vehicle stands: the way on which it comes to a stop is shorter than a few centimetres."""
PARALLEL = 1e-9
"""Sine of the angle between two ways up to which they are parallel: rounding decides where they would cross."""
OPENING_RAD = 0.2
"""Angle by which forbidden arcs are widened: at their very edge the vehicle could only creep."""


class _Band(NamedTuple):
    """The band between our way to a stop and that of a neighbour."""

    bearing_rad: float  # across the band, from us to the neighbour
    ahead_m: float  # how far our way to a stop leads towards the neighbour already
    share_m: float  # how much farther it may lead after a step
    peer: int  # index of the neighbour


class Start(NamedTuple):
    """What the choices of a vehicle begin from; `motion` is its motion now, as neighbours detect it."""

    motion: Motion
    at_effect: AtEffect
    rules: Rules
    dt_s: float

    @property
    def stands(self) -> bool:
        """Whether the vehicle stands, so that it may turn on the spot."""
        return max(self.motion.speed_m_s, self.at_effect.speed_m_s) < STANDING_M_S


def keep_apart(wanted_rad: float, start: Start, peers: Peers, part: float) -> Resolution:
    """Return the wanted heading, or the first clockwise, at the greatest speed that every band allows; else a stop.

    `part` is the part of what a band is wider than the separation that this vehicle uses, at most a half. The heading
    is limited to what the vehicle can turn in a step; see separation.give_way for the rest.
    """
    wanted_rad %= math.tau
    cruise_m_s = start.rules.speed_m_s
    bands = _bands(start, peers, part)
    if not bands:
        return Resolution(wanted_rad, cruise_m_s, None)
    step_m = cruise_m_s * (start.dt_s + start.rules.reaction_s)
    narrow = [band for band in bands if band.share_m < step_m]
    arcs = [(band.bearing_rad, math.acos(band.share_m / step_m)) for band in narrow]
    chosen_rad = _first_free(wanted_rad, [(middle, half + OPENING_RAD) for middle, half in arcs])
    if chosen_rad is None:
        chosen_rad = _first_free(wanted_rad, arcs)
    if chosen_rad is None:
        return Resolution(start.at_effect.heading_rad % math.tau, 0.0, STOPPING, _in_the_way(wanted_rad, bands))
    for fraction in SPEED_FRACTIONS:
        speed_m_s = fraction * cruise_m_s
        turned_rad = _turned_rad(start, chosen_rad, speed_m_s)
        if _is_allowed(start, turned_rad, speed_m_s, bands):
            if fraction == 1.0 and chosen_rad == wanted_rad:
                return Resolution(wanted_rad, speed_m_s, None)
            reason = PASSING if fraction == 1.0 else SLOWING
            return Resolution(turned_rad, speed_m_s, reason, _in_the_way(wanted_rad, bands))
    if start.stands:
        return Resolution(_turned_rad(start, chosen_rad, 0.0), 0.0, PIVOTING, _in_the_way(wanted_rad, bands))
    # Who brakes keeps its heading, and with it the way to a stop that the others reckon with.
    return Resolution(start.at_effect.heading_rad % math.tau, 0.0, STOPPING, _in_the_way(wanted_rad, bands))


def evading(start: Start, peers: Peers) -> Resolution | None:
    """Return the way across the course of a stranger that flies at this vehicle; None if none does.

    Half of the gap is enough only if the other one keeps the other half, and who is not of the fleet may not.
    """
    if peers.strangers is None:
        return None
    motion, rules = start.motion, start.rules
    kept_m = EVADING_SHARE * (rules.separation_m + 2.0 * rules.position_error_m)
    for peer in np.flatnonzero(peers.strangers).tolist():
        north_m_s, east_m_s = peers.velocities_m_s[peer].tolist()
        age_s = 0.0 if peers.ages_s is None else float(peers.ages_s[peer])
        speed_m_s = math.hypot(north_m_s, east_m_s)
        if speed_m_s < STANDING_M_S:
            continue
        ahead = (north_m_s / speed_m_s, east_m_s / speed_m_s)
        north_m = motion.north_m - float(peers.places_ned_m[peer, 0]) - north_m_s * age_s
        east_m = motion.east_m - float(peers.places_ned_m[peer, 1]) - east_m_s * age_s
        along_m = north_m * ahead[0] + east_m * ahead[1]
        right_m = east_m * ahead[0] - north_m * ahead[1]
        # To get out of the way takes the time to gather speed, which is about that to a stop, and the way itself.
        takes_s = start.dt_s + rules.reaction_s + 2.0 * rules.speed_m_s / braking_m_s2(rules)
        takes_s += (kept_m - abs(right_m)) / rules.speed_m_s
        if along_m <= 0.0 or abs(right_m) >= kept_m or along_m > takes_s * speed_m_s:
            continue
        # Head-on both turn right: this vehicle's right is the other one's left.
        side = -1.0 if right_m <= 0.0 else 1.0
        heading_rad = (math.atan2(ahead[1], ahead[0]) + side * math.pi / 2.0) % math.tau
        return Resolution(heading_rad, rules.speed_m_s, EVADING, peer)
    return None


def _first_free(wanted_rad: float, arcs: Sequence[Arc]) -> float | None:
    """Return the first free heading clockwise or, where that leads back and is the longer turn, counterclockwise."""
    right_rad = first_clockwise(wanted_rad, arcs)
    if right_rad is None:
        return None
    turned_rad = (right_rad - wanted_rad) % math.tau
    if turned_rad <= BACK_RAD:
        return right_rad
    mirrored_rad = first_clockwise(-wanted_rad % math.tau, [(-middle, half) for middle, half in arcs])
    if mirrored_rad is None or (mirrored_rad + wanted_rad) % math.tau >= turned_rad:
        return right_rad
    return -mirrored_rad % math.tau


def _bands(start: Start, peers: Peers, part: float) -> list[_Band]:
    """Return the bands to all neighbours that are near enough to forbid anything."""
    motion, rules, dt_s = start.motion, start.rules, start.dt_s
    if len(peers.places_ned_m) == 0:
        return []
    reach_m = interaction_radius_m(rules, dt_s) + way_to_stop_m(rules.speed_m_s, rules) / LEAST_PART
    here = complex(motion.north_m, motion.east_m)
    ours = _way(motion.speed_m_s, complex(math.cos(motion.heading_rad), math.sin(motion.heading_rad)), rules)
    kept_m = rules.separation_m + 2.0 * rules.position_error_m + way_width_m(motion.speed_m_s, rules)
    bands = []
    for peer, (there, velocity, age_s, growth_m) in enumerate(peers.rows()):
        place = there - here
        speed_m_s = abs(velocity)
        if abs(place) >= reach_m + speed_m_s * age_s + growth_m:
            continue
        # It may have braked since, or flown on and not brake before now.
        theirs = _way(speed_m_s, velocity / speed_m_s if speed_m_s > 0.0 else 1.0 + 0.0j, rules) + velocity * age_s
        across = _between(ours, place, theirs) or place
        gap_m = abs(across) - kept_m - growth_m - way_width_m(speed_m_s, rules)
        axis = across / (abs(across) or 1.0)
        ahead_m = max(0.0, ours.real * axis.real + ours.imag * axis.imag)
        bands.append(_Band(math.atan2(axis.imag, axis.real), ahead_m, max(part * gap_m, 0.0), peer))
    return bands


def _way(speed_m_s: float, along: complex, rules: Rules) -> complex:
    """Return the straight way to a stop, m, as a complex number: north is the real part, east the imaginary one."""
    return way_to_stop_m(speed_m_s, rules) * along


def _between(ours: complex, place: complex, theirs: complex) -> complex:
    """Return the shortest vector from our way, which begins at 0, to theirs, which begins at `place`; 0 if they cross.

    It is unique, because the ways are convex: both vehicles compute the same one.
    """
    if _cross(ours, place, theirs):
        return 0.0j
    vectors = (
        place - nearest_on_way(place, ours),
        place + theirs - nearest_on_way(place + theirs, ours),
        place + nearest_on_way(-place, theirs),
        place + nearest_on_way(ours - place, theirs) - ours,
    )
    return min(vectors, key=abs)


def _cross(ours: complex, place: complex, theirs: complex) -> bool:
    """Return whether the two ways cross; where they are parallel but for rounding, they meet at an end if at all."""
    turned = ours.real * theirs.imag - ours.imag * theirs.real
    if abs(turned) <= PARALLEL * abs(ours) * abs(theirs):
        return False
    along_ours = (place.real * theirs.imag - place.imag * theirs.real) / turned
    along_theirs = (place.real * ours.imag - place.imag * ours.real) / turned
    return 0.0 <= along_ours <= 1.0 and 0.0 <= along_theirs <= 1.0


def _turned_rad(start: Start, heading_rad: float, speed_m_s: float) -> float:
    """Return the heading that a step towards a heading at a speed reaches."""
    faster_m_s = max(start.motion.speed_m_s, start.at_effect.speed_m_s, speed_m_s)
    return limit_turn(start.at_effect.heading_rad, heading_rad, faster_m_s, start.rules.n_max, start.dt_s)[0]


def _is_allowed(start: Start, heading_rad: float, speed_m_s: float, bands: Sequence[_Band]) -> bool:
    """Return whether every band allows to turn to a heading and fly a step at a speed.

    Counted are the way flown until the next decision takes effect and the way to a stop after it, all of it along the
    swept heading that is nearest to the neighbour. Flying away is always allowed.
    """
    motion, rules = start.motion, start.rules
    flown_m, after_m_s = _flown(start, speed_m_s)
    stopping_m = way_to_stop_m(after_m_s, rules)
    wider_m = max(way_width_m(after_m_s, rules) - way_width_m(motion.speed_m_s, rules), 0.0)
    for band in bands:
        towards = _towards(start, heading_rad, band.bearing_rad)
        if towards > 0.0 and towards * (flown_m + stopping_m) + wider_m > band.ahead_m + band.share_m:
            return False
    return True


def _flown(start: Start, speed_m_s: float) -> tuple[float, float]:
    """Return the way flown until the next decision takes effect, m, and the speed then, m/s.

    A vehicle gathers speed at once, at most, and brakes as the rules say.
    """
    rules, dt_s = start.rules, start.dt_s
    quickest = quickest_m_s(start.motion.speed_m_s, rules)
    braking = braking_m_s2(rules)
    braking_s = min(max(quickest - speed_m_s, 0.0) / braking, dt_s)
    after_m_s = max(speed_m_s, quickest - braking * braking_s)
    if quickest <= speed_m_s:
        return quickest * rules.reaction_s + speed_m_s * dt_s, speed_m_s
    way_m = 0.5 * (quickest + after_m_s) * braking_s + after_m_s * (dt_s - braking_s)
    return quickest * rules.reaction_s + way_m, after_m_s


def _towards(start: Start, heading_rad: float, bearing_rad: float) -> float:
    """Return the cosine of the least angle from a bearing to the headings that a turn sweeps."""
    least_rad = math.pi
    headings_rad = (start.motion.heading_rad, start.at_effect.heading_rad, heading_rad)
    for from_rad, to_rad in itertools.pairwise(headings_rad):
        half_rad = 0.5 * shorter_turn_rad(from_rad, to_rad)
        off_rad = abs(math.remainder(from_rad + half_rad - bearing_rad, math.tau)) - abs(half_rad)
        least_rad = min(least_rad, max(off_rad, 0.0))
    return math.cos(least_rad)


def _in_the_way(wanted_rad: float, bands: Sequence[_Band]) -> int:
    """Return the index of the neighbour that the vehicle gives way to: the nearest of those in the wanted direction."""
    ahead = [band for band in bands if math.cos(wanted_rad - band.bearing_rad) > 0.0]
    return min(ahead or bands, key=lambda band: band.share_m).peer
