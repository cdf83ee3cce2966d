"""Does the vehicle obey? Compares its track with what its model does under the setpoints that were sent.

Each tick adds one sample to a bounded window. From it follow what the vehicle achieves (`Measured`), what of that is
worse than configured for long enough to be reckoned with (`Obedience.worse`), and whether it answers at all
(`companion.onboard.answer`). Everything is a function of logged inputs, so that a replay decides the same.

The tolerances (docs/obedience.md) hold whatever an obedient vehicle does with the lag that
its adapter leaves, with gusts up to the configured wind, and with the noise of its receiver.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median
from typing import NamedTuple

from companion.geo.kinematics import GRAVITY_M_S2
from companion.guard.types import PIVOT_SPEED_M_S, Setpoint
from companion.onboard.answer import Answer, better, worse
from companion.onboard.config import LimitsSection
from companion.onboard.response import Fit, Point, fitted

WINDOW_S = 12.0
"""Length of the window of samples: two turns of a radian of a vehicle that turns at 10 degrees a second."""
MOST_SAMPLES = 32
"""Most samples in the window."""
LEAST_STEP_S = 0.35
"""Time within which a second sample tells nothing new: telemetry comes ten times a second, a decision each half."""
GAP_S = 3.0
"""Time between two samples, or three guidance steps if that is longer, after which the window begins anew."""
LAG_S = 0.6
"""Lag that an obedient vehicle may have beyond its reaction time. Measured on the stand-ins (tests/benchmarks/lags.py):
what an adapter's lead leaves of a lag is up to 0.6 s at the beginning of a turn."""
NOISE_M_S = 0.3
"""Error of a reported velocity, which turns a course by this over the speed. Typical of a receiver in the open."""
COURSE_TOLERANCE_RAD = math.radians(5.0)
"""Difference from the model's course that is nothing, beside lag, noise and gusts: a course wanders by some degrees."""
GUST_SHARE = 0.25
"""Share of the configured wind by which a gust may change the velocity for the time of a window."""
LEAST_SPEED_SHARE = 0.4
"""Share of the speed limit below which the course tells nothing: a copter that starts or stops points anywhere."""
LEAK_S = 20.0
"""Time constant with which the model forgets what it should have done, so that an old difference does not last."""
WORSE_AFTER_S = 1.5
"""Time of consistent evidence after which the vehicle is reckoned to be worse than so far."""
WORSE_SHARE = 0.85
"""Share of what is reckoned with above which a measurement is not worse: SHARES of the fit are that far apart."""
LATER_S = 0.4
"""Delay beyond the reaction time that is not worse: LAG_S is within the tolerance, and this is half of it."""
SURE_SHARE = 0.5
"""A fit counts if its model is at most this share as far from the track as the model that is reckoned with."""
TURNED_RAD = math.radians(12.0)
"""Turn from which a fit counts: a vehicle that has not turned at all may be late or may be stuck."""
BETTER_AFTER_S = 180.0
"""Time without evidence after which turns and braking are reckoned a step better; doubled by every time they were
worse. A vehicle that is asked for less than it can shows nothing, so that this is a guess, made seldom."""
SPEED_BETTER_AFTER_S = 60.0
"""The same for wind and reachable speed, which change with the wind."""
BETTER_TURN_RAD = math.pi / 2.0
"""Turn in that time without which nothing is known of turns."""
BETTER_FACTOR = 1.5
"""Factor of a step by which a share gets better."""
FULL_SHARE = 0.9
"""Share from which the vehicle counts as it was configured."""
MOST_DOUBLINGS = 4
"""Number of times that these times are doubled."""
ANSWER_S = 4.0
"""Time, beyond the reaction time, within which a vehicle must begin to do what it is asked."""
PLANE_ANSWER_S = 6.0
"""The same of a vehicle that cannot be slowed and is left to its autopilot next."""
ANSWER_SHARE = 0.2
"""Share of what was asked for below which a vehicle did not answer."""
DEAD_RAD = math.radians(6.0)
"""Difference between asked and flown course that asks for nothing."""
ASKED_RAD = math.radians(15.0)
"""Turn that must have been asked for to say that it was not answered."""
OPPOSITE_RAD = math.radians(150.0)
"""Difference of courses from which the side to turn to is no matter."""
SPEED_SHARE = 0.25
"""Share of the speed limit by which a speed may be off for whatever reason: turns and gusts cost speed."""
STANDING_SHARE = 0.4
"""Share of the asked speed below which a vehicle does not move, rather than not reach its speed."""
WIND_AFTER_S = 5.0
"""Time for which a wind must be told or estimated before it counts."""
WIND_TOLERANCE_M_S = 1.0
"""Error of a wind that the autopilot tells."""
WIND_ERROR_SHARE = 0.12
"""Error of a wind that is estimated, as a share of the airspeed: indicated and true differ (docs/autopilots.md)."""
WIND_STEP_M_S = 0.5
"""Change of the wind from which it is reckoned with anew."""
PACE_SHARE = 1.15
"""Airspeed over the asked one from which a vehicle that cannot stop is reckoned to turn wider for it."""
MOST_DRIFT = 0.9
"""Greatest wind over the speed for which the drift is counted: beyond it the course over ground turns by itself."""
DIGITS = 2
"""Decimals to which what is reckoned with is rounded: nothing is measured better."""


class Measured(NamedTuple):
    """What a vehicle achieves; each is None while it is not known."""

    rate_share: float | None = None
    """Share of the turn rate by its limits that its turns achieve."""
    reaction_s: float | None = None
    acceleration_m_s2: float | None = None
    braking_m_s2: float | None = None
    airspeed_max_m_s: float | None = None
    """Greatest airspeed that it reaches."""
    wind_ned_m_s: tuple[float, float] | None = None
    """Velocity of the air (north, east)."""

    @property
    def wind_m_s(self) -> float | None:
        """The speed of the wind."""
        return None if self.wind_ned_m_s is None else math.hypot(*self.wind_ned_m_s)


NOTHING = Measured()


class Expected(NamedTuple):
    """What the vehicle was taken for before anything was measured."""

    limits: LimitsSection
    can_stop: bool
    airspeed_max_m_s: float
    step_s: float
    """Guidance step."""


class Seen(NamedTuple):
    """What one tick sees of the vehicle, on the picture's plane."""

    at_s: float
    """Time of the telemetry."""
    course_rad: float
    speed_m_s: float
    asked: Setpoint | None
    """The setpoint in force up to now."""
    yaw_rad: float | None = None
    airspeed_m_s: float = math.nan
    """Airspeed of a vehicle that has a sensor for it or estimates it."""
    wind_ned_m_s: tuple[float, float] | None = None
    """Wind that the autopilot tells."""


class Sample(NamedTuple):
    """One sample of the window."""

    at_s: float
    course_rad: float
    """Course over ground without steps of a whole turn."""
    speed_m_s: float
    asked_rad: float
    """Course of the setpoint that was in force before, within half a turn of `course_rad`."""
    asked_m_s: float
    airspeed_m_s: float
    wind_ned_m_s: tuple[float, float] | None


class Doubts(NamedTuple):
    """Since when the evidence against what is reckoned with has been consistent; None where there is none."""

    turn_s: float | None = None
    braking_s: float | None = None
    wind_s: float | None = None
    pace_s: float | None = None


class Obedience(NamedTuple):
    """What the monitor leaves from one tick to the next; a new engagement begins with a new one."""

    samples: tuple[Sample, ...] = ()
    model_rad: float = math.nan
    """Course that the model has, as `Sample.course_rad`."""
    model_m_s: float = math.nan
    """Speed that the model has while it brakes."""
    doubts: Doubts = Doubts()
    fit: Fit | None = None
    """The last fit of turns, which the next must confirm."""
    measured: Measured = NOTHING
    worse: Measured = NOTHING
    """What is reckoned with because it is worse than configured."""
    quiet_since_s: float = -math.inf
    """Time since which nothing spoke against what is reckoned with."""
    quiet_turn_rad: float = 0.0
    """Turn that was asked for since then."""
    worsenings: int = 0
    answer: Answer = Answer()


def watch(before: Obedience, seen: Seen, expected: Expected) -> Obedience:
    """Return what is known of the vehicle's obedience after one more look at it."""
    last = before.samples[-1] if before.samples else None
    elapsed_s = math.inf if last is None else seen.at_s - last.at_s
    if 0.0 <= elapsed_s < LEAST_STEP_S:
        return before
    sample = _sample_of(seen, last, expected)
    if sample is None or last is None or not 0.0 < elapsed_s <= max(GAP_S, 3.0 * expected.step_s):
        return _restarted(before, sample)
    samples = _windowed((*before.samples, sample))
    now = before._replace(samples=samples, measured=_wind(before.measured, samples))
    now = _turns(now, expected)
    if expected.can_stop:
        now = _braking(now, expected)
    else:
        now = _pace(now, expected)
    now = _reach(now, expected)
    return _answers(_eased(now, expected), expected)


def in_words(obedience: Obedience) -> str | None:
    """Return what is reckoned with because it is worse than configured, and why it is; None if nothing is."""
    found = obedience.worse
    parts = []
    if found.rate_share is not None:
        parts.append(f"turn rate share {found.rate_share:.2f}")
    if found.reaction_s is not None:
        parts.append(f"reaction {found.reaction_s:.1f} s")
    if found.braking_m_s2 is not None:
        parts.append(f"braking {found.braking_m_s2:.1f} m/s^2")
    wind_m_s = found.wind_m_s
    if found.airspeed_max_m_s is not None:
        # Without a wind it is the speed over the ground.
        air, told = ("", "") if wind_m_s is None else ("air", f" in {wind_m_s:.1f} m/s of wind")
        parts.append(f"{air}speed {found.airspeed_max_m_s:.1f} m/s{told}")
    elif wind_m_s is not None:
        parts.append(f"wind {wind_m_s:.1f} m/s")
    return None if not parts else f"reckons with {', '.join(parts)} measured"


def _sample_of(seen: Seen, last: Sample | None, expected: Expected) -> Sample | None:
    """Return the sample of what was seen; None if nothing is asked of the vehicle or a value is not finite."""
    asked = seen.asked
    if asked is None:
        return None
    finite = (seen.at_s, seen.course_rad, seen.speed_m_s, asked.heading_rad, asked.speed_m_s)
    if not all(map(math.isfinite, finite)) or seen.speed_m_s < 0.0:
        return None
    course_rad = seen.course_rad
    if last is not None:
        course_rad = last.course_rad + math.remainder(course_rad - last.course_rad, math.tau)
    asked_rad = course_rad + math.remainder(asked.heading_rad - course_rad, math.tau)
    airspeed_m_s, wind_ned_m_s = seen.airspeed_m_s, seen.wind_ned_m_s
    velocity_m_s = (seen.speed_m_s * math.cos(course_rad), seen.speed_m_s * math.sin(course_rad))
    if wind_ned_m_s is not None and expected.can_stop:
        # A copter has no sensor of its airspeed: without a wind it tells its ground speed instead.
        airspeed_m_s = math.dist(velocity_m_s, wind_ned_m_s)
    elif expected.can_stop:
        airspeed_m_s = math.nan
    elif wind_ned_m_s is None and seen.yaw_rad is not None and airspeed_m_s > 0.0:
        air_m_s = (airspeed_m_s * math.cos(seen.yaw_rad), airspeed_m_s * math.sin(seen.yaw_rad))
        wind_ned_m_s = (velocity_m_s[0] - air_m_s[0], velocity_m_s[1] - air_m_s[1])
    return Sample(seen.at_s, course_rad, seen.speed_m_s, asked_rad, asked.speed_m_s, airspeed_m_s, wind_ned_m_s)


def _windowed(samples: tuple[Sample, ...]) -> tuple[Sample, ...]:
    """Return the newest samples that make up the window; of long steps there are always four."""
    begins_s = samples[-1].at_s - WINDOW_S
    first = max(0, len(samples) - MOST_SAMPLES)
    while samples[first].at_s < begins_s and len(samples) - first > 4:
        first += 1
    return samples[first:]


def _restarted(before: Obedience, sample: Sample | None) -> Obedience:
    """Return the monitor with a new window; what is reckoned with, and how far it is slowed, stays."""
    samples = () if sample is None else (sample,)
    course_rad = math.nan if sample is None else sample.course_rad
    speed_m_s = math.nan if sample is None else sample.speed_m_s
    return before._replace(samples=samples, model_rad=course_rad, model_m_s=speed_m_s, doubts=Doubts(), fit=None)


# What is reckoned with, and the model


def _share(found: Measured) -> float:
    return 1.0 if found.rate_share is None else found.rate_share


def _reaction_s(found: Measured, limits: LimitsSection) -> float:
    return limits.reaction_s if found.reaction_s is None else found.reaction_s


def _rate_rad_s(before: Sample, after: Sample, expected: Expected, wind_m_s: float) -> float:
    """Return the least turn rate of the course that a vehicle of these limits has between two samples.

    A bank turns the course over ground at n g cos(drift) / v, where the drift is the angle between nose and course.
    """
    limits = expected.limits
    load_m_s2 = limits.rate_share * limits.n_max * GRAVITY_M_S2
    if not expected.can_stop:
        load_m_s2 *= math.sqrt(1.0 - min(wind_m_s / limits.speed_m_s, MOST_DRIFT) ** 2)
    return min(load_m_s2 / max(before.speed_m_s, after.speed_m_s, PIVOT_SPEED_M_S), math.pi / 2.0)


def _asked_at(samples: Sequence[Sample], at_s: float) -> Sample | None:
    """Return the sample with the setpoint that was in force at a time; None before the window."""
    for index in range(len(samples) - 1, 0, -1):
        if samples[index - 1].at_s < at_s:
            return samples[index]
    return None


def _tells_course(before: Sample, after: Sample, expected: Expected) -> bool:
    least_m_s = max(LEAST_SPEED_SHARE * min(expected.limits.speed_m_s, after.asked_m_s), PIVOT_SPEED_M_S)
    return min(before.speed_m_s, after.speed_m_s) >= least_m_s and after.asked_m_s >= PIVOT_SPEED_M_S


def _wind_m_s(obedience: Obedience, expected: Expected) -> float:
    known = obedience.measured.wind_m_s
    return expected.limits.wind_m_s if known is None else max(known, expected.limits.wind_m_s)


# Turns


def _turns(now: Obedience, expected: Expected) -> Obedience:
    """Return the monitor after it has compared the last turn with the model's."""
    samples, limits = now.samples, expected.limits
    before, after = samples[-2:]
    if not _tells_course(before, after, expected):
        return now._replace(model_rad=after.course_rad, doubts=now.doubts._replace(turn_s=None), fit=None)
    wind_m_s = _wind_m_s(now, expected)
    rate_rad_s = _rate_rad_s(before, after, expected, wind_m_s)
    reckoned_rad_s, reaction_s = rate_rad_s * _share(now.worse), _reaction_s(now.worse, limits)
    elapsed_s = after.at_s - before.at_s
    count = math.ceil(elapsed_s / 0.5)
    model_rad, asked = now.model_rad, after
    for k in range(count):
        found = _asked_at(samples, before.at_s + elapsed_s * (k + 1) / count - reaction_s)
        if found is None:
            continue
        asked = found
        to_go_rad = math.remainder(asked.asked_rad - model_rad, math.tau)
        most_rad = reckoned_rad_s * elapsed_s / count
        model_rad += min(max(to_go_rad, -most_rad), most_rad)
    left_rad = math.remainder(asked.asked_rad - after.course_rad, math.tau)
    behind_rad = abs(left_rad) - abs(math.remainder(asked.asked_rad - model_rad, math.tau))
    model_rad += -math.expm1(-elapsed_s / LEAK_S) * math.remainder(after.course_rad - model_rad, math.tau)
    tolerance_rad = COURSE_TOLERANCE_RAD + LAG_S * reckoned_rad_s
    tolerance_rad += (NOISE_M_S + GUST_SHARE * wind_m_s) / max(after.speed_m_s, PIVOT_SPEED_M_S)
    turned_rad = now.quiet_turn_rad + abs(after.course_rad - before.course_rad)
    now = now._replace(model_rad=model_rad, quiet_turn_rad=turned_rad)
    if behind_rad <= tolerance_rad:
        return now._replace(doubts=now.doubts._replace(turn_s=None), fit=None)
    since_s = before.at_s if now.doubts.turn_s is None else now.doubts.turn_s
    now = now._replace(doubts=now.doubts._replace(turn_s=since_s), quiet_since_s=after.at_s, quiet_turn_rad=0.0)
    return now if after.at_s - since_s < WORSE_AFTER_S else _turns_fitted(now, expected, wind_m_s)


def _turns_fitted(now: Obedience, expected: Expected, wind_m_s: float) -> Obedience:
    """Return the monitor after it has looked for the share and the reaction that explain the window."""
    samples = now.samples
    points = [Point(samples[0].at_s, samples[0].course_rad, samples[0].asked_rad, 0.0)]
    points += [
        Point(b.at_s, b.course_rad, b.asked_rad, _rate_rad_s(a, b, expected, wind_m_s))
        for a, b in zip(samples, samples[1:], strict=False)
    ]
    share, reaction_s = _share(now.worse), _reaction_s(now.worse, expected.limits)
    fit, before = fitted(points, share, reaction_s), now.fit
    turned_rad = max(point.value for point in points) - min(point.value for point in points)
    sure = fit.cost <= SURE_SHARE * fit.as_reckoned and turned_rad >= TURNED_RAD
    now = now._replace(fit=fit if sure else None)
    if not sure or before is None or not _alike(fit, before):
        return now
    worse_share = round(max(fit.share, 0.1), DIGITS) if fit.share <= WORSE_SHARE * share else now.worse.rate_share
    later_s = round(fit.delay_s, DIGITS) if fit.delay_s >= reaction_s + LATER_S else now.worse.reaction_s
    found = now.worse._replace(rate_share=worse_share, reaction_s=later_s)
    now = now._replace(measured=now.measured._replace(rate_share=fit.share, reaction_s=fit.delay_s))
    return now if found == now.worse else _worsened(now, found)


def _alike(one: Fit, other: Fit) -> bool:
    """Return whether two fits of successive ticks say the same."""
    return 0.7 <= one.share / other.share <= 1.4 and abs(one.delay_s - other.delay_s) <= 0.5


def _worsened(now: Obedience, found: Measured) -> Obedience:
    """Return the monitor that reckons with something worse from now on; the window begins anew for it."""
    last = now.samples[-1]
    now = now._replace(worse=found, worsenings=now.worsenings + 1, quiet_since_s=last.at_s, quiet_turn_rad=0.0)
    return now._replace(model_rad=last.course_rad, model_m_s=last.speed_m_s, doubts=Doubts(), fit=None)


# Speeds


def _braking(now: Obedience, expected: Expected) -> Obedience:
    """Return the monitor after it has compared a change of speed with the model's; for a vehicle that can stop."""
    samples, limits = now.samples, expected.limits
    before, after = samples[-2:]
    reaction_s = _reaction_s(now.worse, limits)
    asked = _asked_at(samples, after.at_s - reaction_s)
    braking_m_s2 = limits.braking_m_s2 if now.worse.braking_m_s2 is None else now.worse.braking_m_s2
    off_m_s = _off_m_s(expected)
    now = now._replace(measured=_accelerated(now.measured, samples, off_m_s))
    if asked is None or asked.asked_m_s >= min(before.speed_m_s, after.speed_m_s) - NOISE_M_S:
        return now._replace(model_m_s=after.speed_m_s, doubts=now.doubts._replace(braking_s=None))
    elapsed_s = after.at_s - before.at_s
    model_m_s = max(asked.asked_m_s, now.model_m_s - braking_m_s2 * elapsed_s)
    now = now._replace(model_m_s=model_m_s)
    tolerance_m_s = NOISE_M_S + LAG_S * braking_m_s2 + GUST_SHARE * limits.wind_m_s
    if after.speed_m_s - model_m_s <= tolerance_m_s:
        return now._replace(doubts=now.doubts._replace(braking_s=None))
    since_s = before.at_s if now.doubts.braking_s is None else now.doubts.braking_s
    now = now._replace(doubts=now.doubts._replace(braking_s=since_s), quiet_since_s=after.at_s)
    if after.at_s - since_s < WORSE_AFTER_S:
        return now
    first = len(samples) - 1
    while first > 0 and samples[first].asked_m_s < samples[first].speed_m_s - NOISE_M_S:
        first -= 1
    points = [Point(one.at_s, one.speed_m_s, one.asked_m_s, braking_m_s2) for one in samples[first:]]
    if len(points) < 3:
        return now
    fit = fitted(points, 1.0, reaction_s)
    slowed_m_s = points[0].value - points[-1].value
    if fit.cost > SURE_SHARE * fit.as_reckoned or slowed_m_s < off_m_s / 2.0:
        return now
    found = now.worse
    if fit.share <= WORSE_SHARE:
        found = found._replace(braking_m_s2=round(fit.share * braking_m_s2, DIGITS))
    if fit.delay_s >= reaction_s + LATER_S:
        found = found._replace(reaction_s=round(fit.delay_s, DIGITS))
    braked_m_s2 = round(fit.share * braking_m_s2, DIGITS)
    now = now._replace(measured=now.measured._replace(braking_m_s2=braked_m_s2, reaction_s=fit.delay_s))
    return now if found == now.worse else _worsened(now, found)


def _off_m_s(expected: Expected) -> float:
    """Return how far a speed may be off the asked one for whatever reason."""
    return max(SPEED_SHARE * expected.limits.speed_m_s, 2.0 * NOISE_M_S)


def _accelerated(measured: Measured, samples: Sequence[Sample], off_m_s: float) -> Measured:
    """Return what was measured, with the mean acceleration or braking of the stretch that the newest samples are in."""
    last = samples[-1]
    side = math.copysign(1.0, last.asked_m_s - last.speed_m_s)
    first = len(samples) - 1
    while first > 0 and side * (samples[first].asked_m_s - samples[first].speed_m_s) >= off_m_s:
        first -= 1
    began = samples[first]
    if last.at_s - began.at_s < WORSE_AFTER_S:
        return measured
    change_m_s2 = round(side * (last.speed_m_s - began.speed_m_s) / (last.at_s - began.at_s), DIGITS)
    if change_m_s2 <= 0.0:
        return measured
    if side > 0.0:
        return measured._replace(acceleration_m_s2=change_m_s2)
    return measured._replace(braking_m_s2=change_m_s2)


def _pace(now: Obedience, expected: Expected) -> Obedience:
    """Return the monitor after it has compared airspeed and asked speed of a vehicle that cannot stop.

    One that is faster flies the same bank as a wider turn: as the square of the speed.
    """
    samples = now.samples
    shares = [one.airspeed_m_s / one.asked_m_s for one in samples if one.asked_m_s > 0.0]
    pace = median(shares) if len(shares) >= 4 else math.nan
    last = samples[-1]
    if not pace > PACE_SHARE or not last.airspeed_m_s > PACE_SHARE * last.asked_m_s:
        return now._replace(doubts=now.doubts._replace(pace_s=None))
    since_s = last.at_s if now.doubts.pace_s is None else now.doubts.pace_s
    now = now._replace(doubts=now.doubts._replace(pace_s=since_s), quiet_since_s=last.at_s)
    share = round(1.0 / (pace * pace), DIGITS)
    if last.at_s - since_s < WIND_AFTER_S or share > WORSE_SHARE * _share(now.worse):
        return now
    return _worsened(now, now.worse._replace(rate_share=share))


# Wind, and what can be reached against it


def _wind(measured: Measured, samples: Sequence[Sample]) -> Measured:
    """Return what was measured with the wind: the median of those in the window, if they span WIND_AFTER_S."""
    known = [one for one in samples if one.wind_ned_m_s is not None]
    if len(known) < 4 or known[-1].at_s - known[0].at_s < WIND_AFTER_S:
        return measured
    winds = [one.wind_ned_m_s for one in known if one.wind_ned_m_s is not None]
    return measured._replace(wind_ned_m_s=(median(one[0] for one in winds), median(one[1] for one in winds)))


def _reach(now: Obedience, expected: Expected) -> Obedience:
    """Return the monitor after it has compared the wind, and what is needed against it, with what can be flown."""
    limits, last = expected.limits, now.samples[-1]
    wind_m_s, wind_ned_m_s = now.measured.wind_m_s, now.measured.wind_ned_m_s
    reached_m_s = _unreached_m_s(now, expected)
    if reached_m_s is not None:
        before_m_s = now.worse.airspeed_max_m_s
        if before_m_s is None or reached_m_s < WORSE_SHARE * before_m_s:
            found = now.worse._replace(airspeed_max_m_s=round(reached_m_s, 1), wind_ned_m_s=wind_ned_m_s)
            measured = now.measured._replace(airspeed_max_m_s=round(reached_m_s, 1))
            return _worsened(now._replace(measured=measured), found)
    if wind_m_s is None or wind_ned_m_s is None:
        return now
    tolerance_m_s = WIND_TOLERANCE_M_S
    if not expected.can_stop:
        tolerance_m_s += WIND_ERROR_SHARE * limits.speed_m_s
    saturated = expected.can_stop and limits.speed_m_s + wind_m_s > expected.airspeed_max_m_s + NOISE_M_S
    if wind_m_s <= limits.wind_m_s + tolerance_m_s and not saturated:
        return now._replace(doubts=now.doubts._replace(wind_s=None))
    since_s = last.at_s if now.doubts.wind_s is None else now.doubts.wind_s
    now = now._replace(doubts=now.doubts._replace(wind_s=since_s), quiet_since_s=last.at_s)
    before_m_s = now.worse.wind_m_s
    news = before_m_s is None or wind_m_s > before_m_s + WIND_STEP_M_S
    if last.at_s - since_s < WIND_AFTER_S or not news:
        return now
    found = now.worse._replace(wind_ned_m_s=(round(wind_ned_m_s[0], 1), round(wind_ned_m_s[1], 1)))
    if saturated and found.airspeed_max_m_s is None:
        found = found._replace(airspeed_max_m_s=round(expected.airspeed_max_m_s, 1))
    return _worsened(now, found)


def _unreached_m_s(now: Obedience, expected: Expected) -> float | None:
    """Return the airspeed (without a wind, the ground speed) of a vehicle that stays slower than asked; else None."""
    limits, samples = expected.limits, now.samples
    last = samples[-1]
    begins_s = last.at_s - ANSWER_S - _reaction_s(now.worse, limits)
    if not expected.can_stop or samples[0].at_s > begins_s:
        return None
    late = [one for one in samples if one.at_s >= begins_s]
    asked_m_s = min(one.asked_m_s for one in late)
    fastest_m_s = max(one.speed_m_s for one in late)
    astray_rad = max(abs(one.asked_rad - one.course_rad) for one in late)
    slow = fastest_m_s < asked_m_s - _off_m_s(expected) and fastest_m_s >= STANDING_SHARE * asked_m_s
    gained_m_s = last.speed_m_s - late[0].speed_m_s
    if not slow or astray_rad > ASKED_RAD or gained_m_s > NOISE_M_S:
        return None
    airspeeds_m_s = [one.airspeed_m_s for one in late if math.isfinite(one.airspeed_m_s)]
    return median(airspeeds_m_s) if airspeeds_m_s else fastest_m_s


# Better again


def _eased(now: Obedience, expected: Expected) -> Obedience:
    """Return the monitor that reckons with something better, if nothing has spoken against it for long enough."""
    last, found = now.samples[-1], now.worse
    quiet_s = (last.at_s - now.quiet_since_s) / 2 ** min(max(now.worsenings - 1, 0), MOST_DOUBLINGS)
    if found == NOTHING or quiet_s < SPEED_BETTER_AFTER_S:
        return now
    if quiet_s < BETTER_AFTER_S:
        return now._replace(worse=found._replace(airspeed_max_m_s=None, wind_ned_m_s=None))
    eased = Measured(found.rate_share, found.reaction_s, None, found.braking_m_s2)
    if now.quiet_turn_rad >= BETTER_TURN_RAD:
        share = BETTER_FACTOR * _share(found)
        reaction_s = expected.limits.reaction_s
        later_s = (_reaction_s(found, expected.limits) - reaction_s) / BETTER_FACTOR
        eased = eased._replace(
            rate_share=None if share >= FULL_SHARE else round(share, DIGITS),
            reaction_s=None if later_s <= LATER_S else round(reaction_s + later_s, DIGITS),
        )
    if found.braking_m_s2 is not None:
        braking_m_s2 = BETTER_FACTOR * found.braking_m_s2
        full = braking_m_s2 >= FULL_SHARE * expected.limits.braking_m_s2
        eased = eased._replace(braking_m_s2=None if full else round(braking_m_s2, DIGITS))
    if eased == found:
        return now
    return now._replace(worse=eased, quiet_since_s=last.at_s, quiet_turn_rad=0.0)


# Whether it answers at all


def _answers(now: Obedience, expected: Expected) -> Obedience:
    """Return the monitor one step further down the ladder if the vehicle did not answer, or up if it has for long."""
    last, answer = now.samples[-1], now.answer
    words = _unanswered(now, expected)
    if words is None:
        standing = last.speed_m_s <= _off_m_s(expected)
        return now._replace(answer=better(answer, standing, last.at_s))
    wind_m_s = now.measured.wind_m_s
    if wind_m_s is not None:
        words += f"; wind {wind_m_s:.1f} m/s measured"
        if expected.can_stop and expected.limits.speed_m_s + wind_m_s > expected.airspeed_max_m_s:
            needed = f"{expected.limits.speed_m_s:g} + {wind_m_s:.1f}"
            words += f", {needed} above the reachable {expected.airspeed_max_m_s:.1f} m/s"
    now = now._replace(answer=worse(answer, words, expected.can_stop, last.at_s), quiet_since_s=last.at_s)
    # What follows the step down is judged by itself.
    return _restarted(now, last)


def _unanswered(now: Obedience, expected: Expected) -> str | None:
    """Return what was asked and not done over the last seconds, in words with numbers; None if the vehicle answers."""
    samples, reaction_s = now.samples, _reaction_s(now.worse, expected.limits)
    answer_s = ANSWER_S if expected.can_stop else PLANE_ANSWER_S
    begins_s = samples[-1].at_s - answer_s
    if samples[0].at_s > begins_s - reaction_s or len(samples) < 4:
        return None
    pairs = []
    for before, after in zip(reversed(samples[:-1]), reversed(samples[1:]), strict=True):
        asked = _asked_at(samples, after.at_s - reaction_s)
        if asked is None:
            return None
        pairs.append((before, after, asked))
        if before.at_s <= begins_s and len(pairs) >= 3:
            break
    pairs.reverse()
    return _no_turn(now, pairs, expected) or (_no_speed(pairs, expected) if expected.can_stop else None)


def _no_turn(now: Obedience, pairs: Sequence[tuple[Sample, Sample, Sample]], expected: Expected) -> str | None:
    asked_rad, side, greatest_rad = 0.0, 0.0, 0.0
    wind_m_s = _wind_m_s(now, expected)
    for before, after, asked in pairs:
        if not _tells_course(before, after, expected):
            return None
        off_rad = math.remainder(asked.asked_rad - before.course_rad, math.tau)
        if side and abs(off_rad) >= OPPOSITE_RAD:
            off_rad = math.copysign(off_rad, side)
        beyond_rad = abs(off_rad) - DEAD_RAD
        if beyond_rad <= 0.0 or off_rad * side < 0.0:
            return None
        side = math.copysign(1.0, off_rad)
        rate_rad_s = _share(now.worse) * _rate_rad_s(before, after, expected, wind_m_s)
        asked_rad += min(beyond_rad, rate_rad_s * (after.at_s - before.at_s))
        greatest_rad = max(greatest_rad, beyond_rad)
    # A turn that is not made stays asked for, and is one turn however often. The real PX4 plane keeps a course up to
    # ten degrees beside the asked one in a wind of half its airspeed.
    asked_rad = min(asked_rad, greatest_rad)
    began, ended = pairs[0][0], pairs[-1][1]
    turned_rad = side * (ended.course_rad - began.course_rad)
    if asked_rad < ASKED_RAD or turned_rad >= ANSWER_SHARE * asked_rad:
        return None
    span_s = ended.at_s - began.at_s
    done, wanted = (math.degrees(one) / span_s for one in (turned_rad, asked_rad))
    return f"does not turn: {done:.1f} of {wanted:.1f} deg/s asked for {span_s:.0f} s"


def _no_speed(pairs: Sequence[tuple[Sample, Sample, Sample]], expected: Expected) -> str | None:
    asked_m_s, side = 0.0, 0.0
    off_m_s = _off_m_s(expected)
    for before, after, asked in pairs:
        change_m_s = asked.asked_m_s - before.speed_m_s
        beyond_m_s = abs(change_m_s) - off_m_s
        if beyond_m_s <= 0.0 or change_m_s * side < 0.0:
            return None
        side = math.copysign(1.0, change_m_s)
        if side > 0.0 and before.speed_m_s >= STANDING_SHARE * asked.asked_m_s:
            return None
        asked_m_s += min(beyond_m_s, expected.limits.braking_m_s2 * (after.at_s - before.at_s))
    began, ended = pairs[0][0], pairs[-1][1]
    changed_m_s = side * (ended.speed_m_s - began.speed_m_s)
    if changed_m_s >= ANSWER_SHARE * asked_m_s:
        return None
    span_s = ended.at_s - began.at_s
    verb = "gain speed" if side > 0.0 else "slow down"
    return f"does not {verb}: {ended.speed_m_s:.1f} m/s where {pairs[-1][2].asked_m_s:.1f} are asked for {span_s:.0f} s"
