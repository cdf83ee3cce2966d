"""What a flight says of its vehicle: reaction, turn rate, acceleration, braking, top speed, hold accuracy and wind.

All are pure functions of a track (`track.py`). None stands for what the flight does not show.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from companion.geo.kinematics import GRAVITY_M_S2
from companion.guard.types import PIVOT_SPEED_M_S
from companion.onboard.config import LimitsSection
from companion.onboard.identification.follower import DEVIATIONS, Estimate, Followed, Span, asked_rate, followed
from companion.onboard.identification.pattern import STANDING_M_S
from companion.onboard.identification.track import Stretch, Track, stretches

COURSE_SPEED_M_S = 1.0
"""Speed below which the course over ground is noise."""
COURSE_SHARE = 0.4
"""Share of the greatest commanded speed below which a course is not counted: the vehicle stops or starts there."""
LEAST_COURSE_S = 4.0
"""Shortest piece of flight from which a course is counted."""
LEAST_TURNS_RAD = math.radians(70.0)
"""Least sum of such turns: less than the first turn of the pattern, of a plane too."""
LEAST_TURN_RAD = math.radians(20.0)
"""Least turn that is commanded in a piece from which reaction and turn rate are read."""
ASKED_SHARE = 0.5
"""Share of n_max g/v that must be asked for in a piece from which reaction and turn rate are read. To the small steps
of a gentle turn no vehicle answers by a pure delay and a rate: stand-ins, which turn at 1, seemed to turn at 0.3."""
SAME_SPEED_SHARE = 0.1
"""Change of the commanded speed up to which it hardly changes, as a share of the greatest commanded speed."""
LONGEST_SILENCE_S = 1.0
"""Time without a position over which a course is not followed."""
OBSERVED_S = 1.0
"""Time over which it is observed whether the speed still changes."""
CALM_M_S2 = 0.5
"""Change of the speed up to which it counts as not changing: a fifth of what a copter has for speed and turn."""
ANSWERED_AFTER_S = 2.0
"""Time after which a vehicle that is told another speed has at any rate begun to take it, and is seen to: the sluggish
one of docs/identify.md begins after 1.5 s."""
RATE_SHARES = (0.04, 1.5)
"""Least and greatest share of n_max g/v that is looked for."""
ACCELERATIONS_M_S2 = (0.05, 15.0)
"""Least and greatest acceleration that is looked for."""
LEAST_STEP_M_S = 1.0
"""Least step of the commanded speed that counts."""
LEAST_STEP_SHARE = 0.25
"""Least step of the commanded speed that counts, as a share of the greatest commanded speed: in a smaller one a copter
is still tilting."""
LEAST_PLANE_STEP_SHARE = 0.12
"""The same for a plane, whose pattern asks for 0.15 of its speed."""
ANSWERED_SHARE = 0.4
"""Share of a step of speed that the vehicle must have made for the step to count: some ignore the speed asked for."""
LEAST_STEP_S = 1.5
"""Least time after a step of speed that must be seen."""
LONGEST_RAMP_S = 0.3
"""Longest time in which a step of speed is commanded: one command. A ramp, such as an approach, shows how fast it was
asked for and not what the vehicle can: stand-ins, which brake after 0.3 s, seemed to react after 0.45 s."""
BEFORE_STEP_S = 1.0
"""Time before a step of speed that is counted with it."""
SLOWEST_M_S2 = 0.5
"""Acceleration by which it is reckoned how long a step of speed takes at most."""
SETTLING_S = 3.0
"""Time after that which is counted with the step."""
STEADY_S = 3.0
"""Least time for which course and speed must be commanded alike; at its end, in half that time, a speed is reached."""
ON_SPEED_S = 4.0
"""Time after a step of speed from which a plane counts as flying at the speed asked for."""
SAME_COURSE_RAD = math.radians(2.0)
"""Difference of commanded courses up to which they count as one."""
SECTORS = 4
"""Number of sectors of the course of which the slowest says which speed is reached, whatever the wind."""
REACHED_SHARE = 0.97
"""Share of the speed asked for from which it counts as reached."""
HOLDING_M_S = 1.0
"""Greatest speed that is commanded while a vehicle holds its place."""
CREEPING_M_S = 0.1
"""Median of the commanded speed above which a vehicle is perhaps not told to hold its place but to go, slowly."""
CREPT_SHARE = 0.5
"""Share of the way that it is told to go from which it goes: one that is off its place does not get away from there."""
LEAST_HOLD_S = 6.0
"""Shortest time of holding from which its accuracy is told."""
LEAST_CIRCLE_RAD = math.radians(300.0)
"""Shortest turn to one side that counts as a circle that was held."""
ONTO_CIRCLE_RAD = math.radians(120.0)
"""First part of such a turn, in which the vehicle comes onto the circle."""
HELD_SHARE = 0.95
"""Share of the time that the vehicle is within its hold accuracy."""
BLOCK_S = 2.0
"""Length of the blocks of time in which errors are counted as independent of each other."""
RESAMPLES = 400
"""Number of resamples of a bootstrap."""
BLOCKS = 10
"""Number of parts of a flight of which each is left out once (jackknife)."""
STUDENT_9 = 2.262
"""Half the width of a 95 % interval with BLOCKS - 1 degrees of freedom (Student's t)."""
LEAST_WIND_COURSES_RAD = math.radians(200.0)
"""Least spread of courses from which wind and airspeed can be told apart."""


class Identified(NamedTuple):
    """What a flight says of its vehicle; None where it does not show it."""

    reaction_s: Estimate | None = None
    """Time from a setpoint until the course begins to obey it."""
    speed_reaction_s: Estimate | None = None
    """Time from a setpoint until the speed begins to obey it: of braking, or else of speeding up."""
    rate_share: Estimate | None = None
    """Turn rate, as a share of n_max g/v."""
    turns_denied: bool = False
    """Whether reaction and turn rate together are not those that the vehicle is reckoned with."""
    acceleration_m_s2: Estimate | None = None
    braking_m_s2: Estimate | None = None
    top_speed_m_s: Estimate | None = None
    """Speed that is reached of the greatest one asked for: over ground where the vehicle can stop, else airspeed."""
    asked_m_s: float = math.nan
    """Greatest speed asked for."""
    hold_m: Estimate | None = None
    """Distance from its place, or from its circle, within which the vehicle is for 95 % of the time."""
    wind_m_s: Estimate | None = None
    wind_ned_m_s: tuple[float, float] | None = None
    """Velocity of the air, north and east."""


def identify(track: Track, limits: LimitsSection, can_stop: bool) -> Identified:
    """Return what a track says of its vehicle, which is reckoned with by `limits`."""
    parts = list(stretches(track))
    turns = [span for part in parts for span in _courses(part, limits.n_max, can_stop)]
    enough = (
        sum(float(np.ptp(_in_force(turn.command_s, turn.command, turn.reply_s))) for turn in turns) >= LEAST_TURNS_RAD
    )
    turning = followed(turns if enough else [], *RATE_SHARES, (limits.reaction_s, limits.rate_share))
    faster, slower = (_stepped(parts, sign, can_stop) for sign in (1.0, -1.0))
    air = _from_circle(parts) if not can_stop else None
    told = _told_wind(track)
    wind = told if air is None else air[0]
    asked_m_s = max((float(part.speed_m_s.max()) for part in parts), default=math.nan)
    answering = slower if slower is not None else faster
    return Identified(
        reaction_s=_delay(turning),
        speed_reaction_s=_delay(answering) if can_stop else None,
        rate_share=None if turning is None else _asked_for(turning.rate),
        turns_denied=turning is not None and turning.denied,
        acceleration_m_s2=None if faster is None else faster.rate,
        braking_m_s2=None if slower is None else slower.rate,
        top_speed_m_s=_reached(parts, asked_m_s) if can_stop else None if air is None else air[1],
        asked_m_s=asked_m_s,
        hold_m=_held(parts) if can_stop else _circled(parts),
        wind_m_s=None if wind is None else wind[0],
        wind_ned_m_s=None if wind is None else wind[1],
    )


def _stepped(parts: Sequence[Stretch], sign: float, can_stop: bool) -> Followed | None:
    """Return how the steps of the speed to one side are followed; None without any."""
    share = LEAST_STEP_SHARE if can_stop else LEAST_PLANE_STEP_SHARE
    return followed([span for part in parts for span in _speed_steps(part, sign, share)], *ACCELERATIONS_M_S2)


def _asked_for(share: Estimate) -> Estimate:
    """Return the share of the turn rate; the setpoints ask for no more than 1, so more than that is not known."""
    if share.high < 1.0:
        return share
    return Estimate(min(share.value, 1.0), min(share.low, 1.0), math.inf)


def _delay(found: Followed | None) -> Estimate | None:
    return None if found is None else found.delay_s


# Course and speed


def _in_force(times_s: np.ndarray, values: np.ndarray, at_s: np.ndarray) -> np.ndarray:
    """Return the value that is in force at each time: that of the last time at or before it."""
    chosen: np.ndarray = values[np.maximum(np.searchsorted(times_s, at_s, side="right") - 1, 0)]
    return chosen


def _runs(mask: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yield the beginning and the end of each run of true values."""
    edges = np.nonzero(np.diff(np.concatenate(([0], mask.astype(int), [0]))))[0]
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _courses(part: Stretch, n_max: float, can_stop: bool) -> Iterator[Span]:
    """Yield course and commanded course of each piece in which the guard's model of a turn holds and is put to a test.

    The vehicle neither stops nor starts there, is seen without a gap, and is asked to turn faster than ASKED_SHARE.
    """
    speed_m_s = np.hypot(*part.velocity_m_s.T)
    least_m_s = max(COURSE_SPEED_M_S, COURSE_SHARE * float(part.speed_m_s.max()))
    asked_m_s = _in_force(part.command_s, part.speed_m_s, part.reply_s)
    fits = (speed_m_s >= least_m_s) & (asked_m_s >= least_m_s)
    # What a copter needs to change its speed is missing in its turn; a plane turns by its wings.
    levels = _levels(part, least_m_s) if can_stop else np.cumsum(_turns_true(part.speed_m_s >= least_m_s))
    level = _in_force(part.command_s, levels, part.reply_s)
    if can_stop:
        fits &= _on_speed(part, level, speed_m_s)
    fits[1:] &= (np.diff(part.reply_s) <= LONGEST_SILENCE_S) & (level[1:] == level[:-1])
    for first, end in _runs(fits):
        times_s = part.reply_s[first:end]
        if end - first < 2 or times_s[-1] - times_s[0] < LEAST_COURSE_S:
            continue
        course_rad = np.unwrap(np.arctan2(part.velocity_m_s[first:end, 1], part.velocity_m_s[first:end, 0]))
        commanded_rad = _in_force(part.command_s, part.heading_rad, times_s)
        if np.ptp(commanded_rad) < LEAST_TURN_RAD:
            continue
        turns = round(float(commanded_rad[0] - course_rad[0]) / math.tau)
        fastest_m_s = np.maximum(speed_m_s[first:end], asked_m_s[first:end])
        # A standing vehicle is told any heading: that asks for no turn of its course.
        since = int(np.argmax(levels == level[first]))
        span = Span(
            part.command_s[since:],
            part.heading_rad[since:] - turns * math.tau,
            times_s,
            course_rad,
            n_max * GRAVITY_M_S2 / np.maximum(fastest_m_s, PIVOT_SPEED_M_S),
            offset_free=True,
        )
        if asked_rate([span]) >= ASKED_SHARE:
            yield span


def _turns_true(mask: np.ndarray) -> np.ndarray:
    """Return where values become true."""
    turns: np.ndarray = mask & ~np.concatenate(([False], mask[:-1]))
    return turns


def _levels(part: Stretch, least_m_s: float) -> np.ndarray:
    """Return for each command the number of the level of speed that it belongs to: one that hardly changes."""
    same_m_s = SAME_SPEED_SHARE * float(part.speed_m_s.max())
    level, at_m_s, levels = 0, math.inf, []
    for asked_m_s in part.speed_m_s.tolist():
        if abs(asked_m_s - at_m_s) > same_m_s or (asked_m_s < least_m_s) != (at_m_s < least_m_s):
            level, at_m_s = level + 1, asked_m_s
        levels.append(level)
    return np.array(levels)


def _on_speed(part: Stretch, level: np.ndarray, speed_m_s: np.ndarray) -> np.ndarray:
    """Return where the speed has once stopped changing since another level of it was commanded, of each reply."""
    earlier_m_s = np.interp(part.reply_s - OBSERVED_S, part.reply_s, speed_m_s)
    calm = np.abs(speed_m_s - earlier_m_s) <= CALM_M_S2 * OBSERVED_S
    on = np.zeros(len(level), dtype=bool)
    for number in np.unique(level).tolist():
        within = level == number
        times_s = part.reply_s[within]
        on[within] = np.logical_or.accumulate(calm[within] & (times_s - times_s[0] >= ANSWERED_AFTER_S))
    return on


def _speed_steps(part: Stretch, sign: float, share: float) -> Iterator[Span]:
    """Yield speed and commanded speed about each step to a greater (sign 1) or a lesser (-1) commanded speed.

    A step must be at least `share` of the greatest commanded speed.
    """
    speed_m_s = np.hypot(*part.velocity_m_s.T)
    steps = _steps_of(part, share)
    for index, (first, last) in enumerate(steps):
        from_m_s, to_m_s = float(part.speed_m_s[first - 1]), float(part.speed_m_s[last])
        if (to_m_s - from_m_s) * sign <= 0.0:
            continue
        begins_s, stepped_s = float(part.command_s[first]), float(part.command_s[last])
        if stepped_s - begins_s > LONGEST_RAMP_S:
            continue
        ends_s = stepped_s + abs(to_m_s - from_m_s) / SLOWEST_M_S2 + SETTLING_S
        if index + 1 < len(steps):
            ends_s = min(ends_s, float(part.command_s[steps[index + 1][0]]))
        # A turn costs a copter speed, and in wind it changes what any speed is over ground.
        turned = np.nonzero(np.abs(part.heading_rad[last:] - part.heading_rad[last]) > SAME_COURSE_RAD)[0]
        if len(turned):
            ends_s = min(ends_s, float(part.command_s[last + int(turned[0])]))
        within = (part.reply_s >= begins_s - BEFORE_STEP_S) & (part.reply_s <= ends_s)
        before = within & (part.reply_s <= begins_s)
        times_s, flown_m_s = part.reply_s[within], speed_m_s[within]
        if not before.any() or times_s[-1] < stepped_s + LEAST_STEP_S:
            continue
        starts_m_s = float(np.median(speed_m_s[before]))
        settles_m_s = _settled(times_s, flown_m_s, starts_m_s + to_m_s - from_m_s)
        if (settles_m_s - starts_m_s) * sign < ANSWERED_SHARE * abs(to_m_s - from_m_s):
            continue
        # The vehicle's own levels count: in wind, or beyond what it reaches, they are not the ones asked for.
        command_m_s = starts_m_s + (part.speed_m_s - from_m_s) * (settles_m_s - starts_m_s) / (to_m_s - from_m_s)
        lies = slice(first - 1, last + 1)
        yield Span(part.command_s[lies], command_m_s[lies], times_s, flown_m_s, np.ones(len(times_s)), False)


def _settled(times_s: np.ndarray, speed_m_s: np.ndarray, otherwise_m_s: float) -> float:
    """Return the speed at the end of a step if it does not change any more, or else the one asked for."""
    last = times_s >= times_s[-1] - 1.5
    if np.count_nonzero(last) < 4:
        return otherwise_m_s
    slope_m_s2 = float(np.polyfit(times_s[last] - times_s[-1], speed_m_s[last], 1)[0])
    return float(np.median(speed_m_s[last])) if abs(slope_m_s2) < 0.2 else otherwise_m_s


def _steps_of(part: Stretch, share: float) -> list[tuple[int, int]]:
    """Return the first and the last command of each step of the commanded speed; a ramp to one side is one step."""
    changes_m_s = np.diff(part.speed_m_s)
    least_m_s = max(LEAST_STEP_M_S, share * float(part.speed_m_s.max()))
    found: list[tuple[int, int]] = []
    for index in np.nonzero(changes_m_s)[0].tolist():
        follows = bool(found) and found[-1][1] == index and changes_m_s[index] * changes_m_s[index - 1] > 0.0
        if follows:
            found[-1] = (found[-1][0], index + 1)
        else:
            found.append((index + 1, index + 1))
    return [(one, end) for one, end in found if abs(part.speed_m_s[end] - part.speed_m_s[one - 1]) >= least_m_s]


def _reached(parts: Sequence[Stretch], asked_m_s: float) -> Estimate | None:
    """Return the speed over ground that is reached, on the course on which it is least."""
    sectors: dict[int, list[tuple[float, float]]] = {}
    for part in parts:
        alike = np.zeros(len(part.command_s), dtype=bool)
        fast = part.speed_m_s >= 0.99 * asked_m_s
        alike[1:] = (np.abs(np.diff(part.heading_rad)) < SAME_COURSE_RAD) & fast[1:] & fast[:-1]
        speed_m_s = np.hypot(*part.velocity_m_s.T)
        for first, end in _runs(alike):
            begins_s, ends_s = float(part.command_s[first - 1]), float(part.command_s[end - 1])
            if ends_s - begins_s < STEADY_S:
                continue
            sector = round(float(part.heading_rad[first]) / math.tau * SECTORS) % SECTORS
            chosen = (part.reply_s >= ends_s - STEADY_S / 2.0) & (part.reply_s <= ends_s)
            samples = zip(part.reply_s[chosen].tolist(), speed_m_s[chosen].tolist(), strict=True)
            sectors.setdefault(sector, []).extend(samples)
    means = [found for samples in sectors.values() if (found := _mean(np.array(samples))) is not None]
    if not means:
        return None
    slowest = min(means, key=lambda one: one.value)
    reached = slowest.high >= REACHED_SHARE * asked_m_s
    return slowest._replace(high=math.inf) if reached else slowest


def _mean(samples: np.ndarray) -> Estimate | None:
    """Return the mean of samples (N, 2) of time and value, of which those within a BLOCK_S count as one."""
    if len(samples) < 5:
        return None
    value, spread = float(samples[:, 1].mean()), float(samples[:, 1].std(ddof=1))
    blocks = max(len(np.unique(np.floor(samples[:, 0] / BLOCK_S))), 2)
    half = (DEVIATIONS + 4.0 / blocks) * spread / math.sqrt(blocks)
    return Estimate(value, value - half, value + half)


# Place


def _held(parts: Sequence[Stretch]) -> Estimate | None:
    """Return the distance from the places at which the vehicle came to stand that it keeps within for 95 % of it."""
    errors: list[tuple[float, float]] = []
    for part in parts:
        asked_m_s = _in_force(part.command_s, part.speed_m_s, part.reply_s)
        speed_m_s = np.hypot(*part.velocity_m_s.T)
        for first, end in _runs(asked_m_s <= HOLDING_M_S):
            standing = np.nonzero(speed_m_s[first:end] <= STANDING_M_S)[0]
            if not len(standing):
                continue
            first += int(standing[0])
            if part.reply_s[end - 1] - part.reply_s[first] < LEAST_HOLD_S:
                continue
            off_m = np.hypot(*(part.place_ned_m[first:end] - part.place_ned_m[first]).T)
            told_m = float(asked_m_s[first:end].mean() * (part.reply_s[end - 1] - part.reply_s[first]))
            if float(np.median(asked_m_s[first:end])) > CREEPING_M_S and off_m[-1] > CREPT_SHARE * told_m:
                continue
            errors += zip(part.reply_s[first:end].tolist(), off_m.tolist(), strict=True)
    return _quantile(np.array(errors)) if errors else None


def _circled(parts: Sequence[Stretch]) -> Estimate | None:
    """Return the distance from the circle that fits best within which the vehicle is for 95 % of the time on it."""
    errors: list[tuple[float, float]] = []
    for part in parts:
        turns_rad = np.diff(part.heading_rad)
        for sign in (1.0, -1.0):
            for first, end in _runs(turns_rad * sign > -SAME_COURSE_RAD):
                turned_rad = np.abs(part.heading_rad[first : end + 1] - part.heading_rad[first])
                if turned_rad[-1] < LEAST_CIRCLE_RAD:
                    continue
                begins_s = part.command_s[first + int(np.argmax(turned_rad >= ONTO_CIRCLE_RAD))]
                on = (part.reply_s >= begins_s) & (part.reply_s <= part.command_s[end])
                if np.count_nonzero(on) < 10:
                    continue
                north_m, east_m, radius_m = circle_of(part.place_ned_m[on])
                off_m = np.abs(np.hypot(*(part.place_ned_m[on] - (north_m, east_m)).T) - radius_m)
                errors += zip(part.reply_s[on].tolist(), off_m.tolist(), strict=True)
    return _quantile(np.array(errors)) if errors else None


def _quantile(errors: np.ndarray) -> Estimate:
    """Return the quantile HELD_SHARE of errors (N, 2) of time and value; its interval is that of a block bootstrap."""
    value = float(np.quantile(errors[:, 1], HELD_SHARE))
    blocks = np.unique(np.floor(errors[:, 0] / BLOCK_S), return_inverse=True)[1]
    parts = [errors[blocks == block, 1] for block in range(int(blocks.max()) + 1)]
    draws = np.random.default_rng(0).integers(0, len(parts), size=(RESAMPLES, len(parts)))
    found = [float(np.quantile(np.concatenate([parts[k] for k in draw]), HELD_SHARE)) for draw in draws.tolist()]
    low, high = np.quantile(found, (0.025, 0.975)).tolist()
    return Estimate(value, min(low, value), max(high, value))


# Wind


def circle_of(points: np.ndarray) -> tuple[float, float, float]:
    """Return centre and radius of the circle through points (N, 2), by linear least squares (Kasa 1976)."""
    about = points.mean(axis=0)
    centred = points - about
    design = np.column_stack((2.0 * centred, np.ones(len(points))))
    north, east, rest = np.linalg.lstsq(design, (centred**2).sum(axis=1), rcond=None)[0].tolist()
    radius = math.sqrt(max(rest + north * north + east * east, 0.0))
    return north + float(about[0]), east + float(about[1]), radius


_Wind = tuple[Estimate, tuple[float, float]]
"""Strength of the wind, and the velocity of the air (north, east)."""


def _from_circle(parts: Sequence[Stretch]) -> tuple[_Wind, Estimate] | None:
    """Return the wind and the airspeed of a plane: centre and radius of the circle of its ground velocities.

    Only what it flies at the greatest speed asked for counts, once it has that speed.
    """
    asked_m_s = max((float(part.speed_m_s.max()) for part in parts), default=math.nan)
    found = []
    for part in parts:
        fast = part.speed_m_s >= 0.99 * asked_m_s
        changed = np.ones(len(fast), dtype=bool)
        changed[1:] = fast[1:] != fast[:-1]
        since_s = part.command_s[np.maximum.accumulate(np.where(changed, np.arange(len(fast)), 0))]
        steady_s = part.reply_s - _in_force(part.command_s, since_s, part.reply_s)
        found.append(part.velocity_m_s[_in_force(part.command_s, fast, part.reply_s) & (steady_s >= ON_SPEED_S)])
    velocities_m_s = np.concatenate(found) if found else np.zeros((0, 2))
    if len(velocities_m_s) < 5 * BLOCKS:
        return None
    if np.ptp(np.unwrap(np.arctan2(velocities_m_s[:, 1], velocities_m_s[:, 0]))) < LEAST_WIND_COURSES_RAD:
        return None
    north_m_s, east_m_s, airspeed_m_s = circle_of(velocities_m_s)

    def strength_m_s(samples: np.ndarray) -> float:
        return math.hypot(*circle_of(samples)[:2])

    wind_m_s = _jackknifed(velocities_m_s, strength_m_s)
    airspeed = _jackknifed(velocities_m_s, lambda samples: circle_of(samples)[2])
    assert math.isfinite(airspeed_m_s)
    return (wind_m_s, (north_m_s, east_m_s)), airspeed


def _jackknifed(samples: np.ndarray, estimate: Callable[[np.ndarray], float]) -> Estimate:
    """Return an estimate from samples and its interval, by leaving out one after the other of BLOCKS parts of them."""
    value = estimate(samples)
    bounds = np.linspace(0, len(samples), BLOCKS + 1).astype(int).tolist()
    without = [estimate(np.concatenate((samples[:first], samples[end:]))) for first, end in pairwise(bounds)]
    spread = math.sqrt((BLOCKS - 1) * float(np.var(without)))
    return Estimate(value, max(0.0, value - STUDENT_9 * spread), value + STUDENT_9 * spread)


def _told_wind(track: Track) -> _Wind | None:
    """Return the wind that the autopilot told, with the spread of what it told."""
    if len(track.winds) < 2:
        return None
    strengths_m_s = np.hypot(track.winds[:, 1], track.winds[:, 2])
    low, high = np.quantile(strengths_m_s, (0.025, 0.975)).tolist()
    north_m_s, east_m_s = track.winds[:, 1:].mean(axis=0).tolist()
    return Estimate(float(strengths_m_s.mean()), low, high), (north_m_s, east_m_s)
