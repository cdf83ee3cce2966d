"""The last thing a setpoint passes: it holds every limit and says what it changed and why (docs/method.md section 3).

It trusts nothing it is given and imports nothing but numpy and the standard library, so that a fault in guidance,
surrogate, route or picture ends here.

Assumptions, each monitored: a command begins to act `reaction_s` after it is given; the vehicle then turns by the
shorter side at rate_share n g / v until the heading is reached and flies straight; no disc moves faster than its bound;
the wind stays within its bound; reports are right within theirs; `check` is called every `dt_s`.
Theorem: from a certified state no disc is ever entered and no fence left, whatever is wanted.
Proof: the *tip* is the state at which the next command begins to act; it follows from the motion and the commands in
flight. Between calls the guard holds a path from the tip that is clear at all later times. A wanted step is let through
only if it and a new path from its end are clear: that path is held next. Otherwise the held path is continued; what is
left of a clear path is clear, so nothing needs to be certified again. A path ends on a turning circle or at rest,
which discs that stand still never reach, or (discs that move) on a ray u from p at speed v: with d = p - c, disc radius
R + w t, a = v^2 - w^2, b = 2 (v d.u - w R), c0 = |d|^2 - R^2 the squared distance less the squared radius is
a t^2 + b t + c0, which is never negative iff c0 >= 0 and (b >= 0 or b^2 <= 4 a c0). A later report of a disc within its
bound lies inside the earlier one grown, so it takes nothing away. By induction there is always a choice.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from companion.guard.types import (
    ALTITUDE,
    BACKUP,
    FENCE,
    IMPOSSIBLE,
    KEEP_OUT,
    LATE,
    NEW_THREAT,
    NO_BACKUP,
    NOT_FINITE,
    PIVOT_SPEED_M_S,
    POSITION,
    RATE,
    SPEED,
    THREAT_FASTER,
    TRACKING_REACTIONS,
    TRACKING_STEPS,
    TURN,
    WIND,
    Discs,
    Limits,
    Motion,
    Piece,
    Setpoint,
    Verdict,
)

STANDARD_GRAVITY_M_S2 = 9.80665
"""Standard gravity (3rd CGPM, 1901). companion/geo/kinematics.py has it too: the guard shares no code with what it
guards against."""
TURN_TOLERANCE_RAD = 1e-9
"""A setpoint at the turn limit must not be called over it for its rounding."""
GREATEST_TURN_RAD = 3.0
"""A step turns by no more, so that the vehicle takes the side that was checked."""
ROUNDING_M = 1e-6
"""A new path keeps this much clear, so that nothing is lost to rounding while it is flown."""
LEAST_ARC_M = 1e-9
"""A shorter arc is a turn on the spot."""
FAN_STEPS = 32
"""Headings tried to either side, evenly over a full turn, where no cheap one serves: 11.25 degrees apart."""
FAN_STEP_RAD = math.tau / FAN_STEPS
SUB_ARC_RAD = math.pi / 4.0
"""On an arc a moving disc counts as large as at the end of each part of this size; in the fan, of each of its steps."""
ROUTE_STEPS = 60
"""Steps along the route within which a turning circle must be clear..."""
ROUTE_CIRCLES = 3
"""...or those of so many turning circles, if they are more."""
CIRCLE_PARTS = 24
"""Along the route, a turning circle is looked for so many times in the length of one."""
FOLLOW_RAD = 0.01
"""A wanted turn this near to the path in hand is flown as that path: nothing need be looked for anew."""
CLOCK_TOLERANCE = 1e-3
"""Share of the step by which two calls may be off it and still count as one step apart: clocks are rounded."""
LATE_SHARE = 1.1
"""A call later than this many steps after the last is named."""
GAP_STEPS = 3.0
"""After so long without a call nothing is known of what the vehicle did: the guard begins anew."""
POSITION_TOLERANCE_M = 0.1
"""Where the vehicle is and where it should be may differ by this beyond their bounds: telemetry resolves 1 cm and
1 cm/s. Chosen, not measured."""
HEADING_TOLERANCE_RAD = 0.02
"""Likewise for headings, which reports give to 1 cm/s of the velocity; within it the commanded heading is believed."""
SPEED_TOLERANCE_M_S = 0.5
"""Likewise for the ground speed."""
THREAT_TOLERANCE_M = 10.0
"""A disc may stick out of its earlier self, grown, by this: the broadcast rounds a 200 km picture to 3 m, thrice."""
COURSE_SHARE = 2.0
"""A wind that changes turns the course by up to this much of its share of the speed, radians."""
CLOSING_STEPS = 2.0
"""In so many steps the vehicle closes in on the path that wind blew it off."""
SAMPLES = 8
"""Points of a step at which choices are compared when none is certified."""


class _Pose(NamedTuple):
    north_m: float
    east_m: float
    heading_rad: float


class _Command(NamedTuple):
    """A setpoint on its way to the vehicle, and in how long it begins to act (negative: it acts already)."""

    starts_s: float
    heading_rad: float
    speed_m_s: float


class _Step(NamedTuple):
    """One way of flying the next step: a turn, then straight, at a speed."""

    turn_rad: float
    speed_m_s: float


class _Path(NamedTuple):
    """What is flown from a tip on: pieces, of which the last `loops` are flown again and again."""

    pieces: tuple[Piece, ...]
    loops: int
    speed_m_s: float
    lasts_s: float


_Disc = tuple[float, float, float, float]
"""(north_m, east_m, radius_m, speed_m_s), at the tip and inflated by what the vehicle may be off its path."""


class _Heard(NamedTuple):
    """The discs that the next ones must lie in, once grown."""

    ids: list[int]
    centres_ned_m: np.ndarray  # (M, 2) m
    radii_m: np.ndarray  # (M,) m
    speeds_m_s: np.ndarray  # (M,) m/s


class _Flight(NamedTuple):
    """What one call decides on: the tip and the airspeed before it, the ground speed reported, the discs at the tip."""

    tip: _Pose
    before_m_s: float
    ground_m_s: float
    dt_s: float
    near: list[_Disc]
    """Those that can matter to a step and a turning circle after it, or that move."""
    discs: list[_Disc]
    moving: bool
    route: Sequence[Piece]
    attack_m: list[float] | None
    sides: tuple[float, ...] = (1.0, -1.0)
    """Of the turning circles that may be a back-up, the first preferred."""


class Guard:
    """Checks every setpoint of one vehicle; keeps the commands in flight and the path that is clear for all time."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._fence = None if limits.fence_ned_m is None else _Fence(limits.fence_ned_m)
        self._load_m_s2 = limits.rate_share * limits.n_max * STANDARD_GRAVITY_M_S2
        self.reset()

    def reset(self) -> None:
        """Forget commands, path and discs: somebody else steered, or positions have a new origin."""
        self._called_s: float | None = None
        self._dt_s = 0.0
        self._motion = Motion(0.0, 0.0, 0.0, 0.0)
        self._commands: list[_Command] = []
        self._path: _Path | None = None
        self._along_m = 0.0
        self._left_s = 0.0
        self._heard: _Heard | None = None
        self._heard_s = 0.0
        self._far: Discs | None = None

    def certify(self, motion: Motion, discs: Discs, dt_s: float) -> bool:
        """Return whether a start is certified: straight on for the reaction time, then a path that stays clear.

        With discs that nothing is clear of for ever, it is over `horizon_s`. Changes nothing in the guard.
        """
        if _unusable(motion, discs, dt_s, _slack_m(motion, discs, 0.0)) is not None:
            return False
        self._dt_s = dt_s
        reaction_s = self._limits.reaction_s
        tip, speed_m_s = self._flown(motion, [], reaction_s)
        committed = (_straight(_pose(motion), motion.speed_m_s * reaction_s),)
        flight = self._flight(tip, speed_m_s, motion, discs, dt_s, ())
        if self._blocked(committed, flight.discs, 0.0) is not None:
            return False
        limited = self._limited(discs, speed_m_s)
        return isinstance(self._backup(tip, _Step(0.0, speed_m_s), speed_m_s, 0.0, 0.0, flight, limited), _Path)

    def check(
        self,
        wanted: Setpoint,
        motion: Motion,
        discs: Discs,
        now_s: float,
        dt_s: float,
        route: Sequence[Piece] = (),
        keep_right: bool = False,
    ) -> Verdict:
        """Return the setpoint nearest to the wanted one that every limit allows for the next `dt_s` seconds.

        `now_s` is by any clock that does not step; `route` is a way that may serve as back-up where no turning circle
        does: its stretches in order. With `keep_right` the circle to the right is kept clear while it is, and nothing
        else takes the place of a wanted setpoint: the right of way between vehicles rests on that circle. A motion, a
        disc or a time that is not finite, or that has a negative size, leaves nothing to decide on: the verdict holds
        no setpoint. A wanted setpoint that is not finite becomes "straight on at the present speed and the middle of
        the altitude band".
        """
        slack_m = _slack_m(motion, discs, dt_s)
        reason = _unusable(motion, discs, dt_s, slack_m) if math.isfinite(now_s) else NOT_FINITE
        if reason is not None:
            return Verdict(None, (reason,))
        elapsed_s = self._elapsed_s(now_s, dt_s)
        self._dt_s = dt_s
        broken = self._monitored(motion, elapsed_s, dt_s)
        tip, before_m_s = self._flown(self._motion, self._commands, self._limits.reaction_s)
        if self._limits.braking_m_s2 is None:
            before_m_s = min(max(before_m_s, self._limits.speed_min_m_s), self._limits.speed_max_m_s)
        changes: list[str] = []
        step, altitude_m = self._within_limits(wanted, tip, before_m_s, dt_s, changes)
        near_m = self._reach_m(motion, before_m_s, step, dt_s)
        moving = max(discs.speeds_m_s.tolist(), default=0.0) > 0.0
        if self._fence is None and not moving and min(slack_m, default=math.inf) > near_m:
            self._path, self._left_s = None, math.inf
            self._far, self._heard, self._heard_s = discs, None, 0.0
        else:
            flight = self._flight(tip, before_m_s, motion, discs, dt_s, route)
            if not moving:
                near = [disc for disc, apart_m in zip(flight.discs, slack_m, strict=True) if apart_m <= near_m]
                flight = flight._replace(near=near)
            threats = self._threats(discs)
            broken += threats
            self._rejoin(flight, bool(threats))
            limited = self._limited(discs, step.speed_m_s)
            right = self._kept_right(step, flight, limited, changes) if keep_right and not moving else None
            step = right or self._kept_clear(step, flight, limited, changes)
        heading_rad = (tip.heading_rad + step.turn_rad) % math.tau
        self._commands.append(_Command(self._limits.reaction_s, heading_rad, step.speed_m_s))
        return Verdict(Setpoint(heading_rad, step.speed_m_s, altitude_m), tuple(changes), tuple(broken), self._left_s)

    # What is known of the vehicle and the discs

    def _elapsed_s(self, now_s: float, dt_s: float) -> float:
        """Return the time since the last call, beginning anew after a gap."""
        elapsed_s = math.inf if self._called_s is None else now_s - self._called_s
        if not 0.0 <= elapsed_s <= GAP_STEPS * dt_s:
            self.reset()
            elapsed_s = 0.0
        elif abs(elapsed_s - dt_s) <= CLOCK_TOLERANCE * dt_s:
            elapsed_s = dt_s
        self._called_s = now_s
        return elapsed_s

    def _monitored(self, motion: Motion, elapsed_s: float, dt_s: float) -> list[str]:
        """Return the assumptions that the vehicle's reports contradict; move what is kept on to now."""
        limits = self._limits
        broken = []
        spare_m_s = limits.wind_m_s + SPEED_TOLERANCE_M_S
        if not limits.speed_min_m_s - spare_m_s <= motion.speed_m_s <= limits.speed_max_m_s + spare_m_s:
            broken.append(WIND)
        if elapsed_s > LATE_SHARE * dt_s:
            broken.append(LATE)
        heading_rad = motion.heading_rad
        if self._commands:
            expected, speed_m_s = self._flown(self._motion, self._commands, elapsed_s)
            change_m_s = abs(speed_m_s - self._motion.speed_m_s)
            turning = limits.braking_m_s2 is None
            if not turning:
                change_m_s = max(speed_m_s, self._motion.speed_m_s)
            off_m = math.hypot(motion.north_m - expected.north_m, motion.east_m - expected.east_m)
            if off_m > self._tolerance_m() + (change_m_s + 2.0 * limits.wind_m_s) * elapsed_s:
                broken.append(POSITION)
            off_rad = abs(math.remainder(heading_rad - expected.heading_rad, math.tau))
            if turning and off_rad > HEADING_TOLERANCE_RAD + COURSE_SHARE * limits.wind_m_s / limits.speed_min_m_s:
                broken.append(RATE)
            if limits.wind_m_s == 0.0 and off_rad <= HEADING_TOLERANCE_RAD:
                heading_rad = expected.heading_rad
            self._along_m += (motion.speed_m_s if limits.wind_m_s > 0.0 else speed_m_s) * elapsed_s
            moved = [command._replace(starts_s=command.starts_s - elapsed_s) for command in self._commands]
            self._commands = [moved[i] for i in range(len(moved)) if i + 1 == len(moved) or moved[i + 1].starts_s > 0.0]
        self._left_s -= elapsed_s
        self._heard_s += elapsed_s
        self._motion = Motion(motion.north_m, motion.east_m, heading_rad, motion.speed_m_s)
        return broken

    def _tolerance_m(self) -> float:
        """Return how far apart two reports of one place may be."""
        return 2.0 * self._limits.position_error_m + POSITION_TOLERANCE_M

    def _threats(self, discs: Discs) -> list[str]:
        """Return what the discs contradict of what was heard of them before, each grown by its bound since.

        One that sticks out by no more than rounding explains leaves its earlier self in force, so that small excesses
        add up.
        """
        ids = _ids_of(discs)
        heard, since_s = self._heard, self._heard_s
        self._heard_s = 0.0
        if heard is None and self._far is not None:
            far = self._far
            heard = _Heard(_ids_of(far), far.centres_ned_m, far.radii_m, far.speeds_m_s)
        if heard is not None and heard.ids == ids:
            north_m, east_m = (discs.centres_ned_m - heard.centres_ned_m).T
            grown_m = heard.radii_m + heard.speeds_m_s * since_s
            beyond_m = np.hypot(north_m, east_m) + discs.radii_m - grown_m
            worst_m = max(beyond_m.tolist(), default=0.0)
            if worst_m <= ROUNDING_M:
                self._heard = _Heard(ids, discs.centres_ned_m, discs.radii_m, discs.speeds_m_s)
                return []
            if worst_m <= THREAT_TOLERANCE_M:
                earlier = beyond_m > ROUNDING_M
                self._heard = _Heard(
                    ids,
                    np.where(earlier[:, np.newaxis], heard.centres_ned_m, discs.centres_ned_m),
                    np.where(earlier, grown_m, discs.radii_m),
                    np.where(earlier, heard.speeds_m_s, discs.speeds_m_s),
                )
                return []
        self._heard = _Heard(ids, discs.centres_ned_m.copy(), discs.radii_m.copy(), discs.speeds_m_s.copy())
        return [] if heard is None else _contradictions(heard, self._heard, since_s)

    def _reach_m(self, motion: Motion, before_m_s: float, step: _Step, dt_s: float) -> float:
        """Return beyond which distance no standing disc can matter to a step or to a path after it."""
        faster_m_s = max(before_m_s, step.speed_m_s, motion.speed_m_s) + self._limits.wind_m_s
        if self._limits.braking_m_s2 is None:
            path_m = 2.0 / self._curvature_1_m(faster_m_s)
        else:
            path_m = faster_m_s * faster_m_s / (2.0 * self._limits.braking_m_s2)
        # One step for the way, up to four for the sides of a rounded square, one more for margins.
        return faster_m_s * (6.0 * dt_s + self._limits.reaction_s) + path_m + self._inflation_m()

    def _inflation_m(self) -> float:
        """Return how far the vehicle may be off the path it is held to."""
        limits = self._limits
        return ROUNDING_M + limits.position_error_m + self._tracking_m()

    def _tracking_m(self) -> float:
        """Return how far wind may blow the vehicle off its path."""
        return self._limits.wind_m_s * (TRACKING_STEPS * self._dt_s + TRACKING_REACTIONS * self._limits.reaction_s)

    def _limited(self, discs: Discs, speed_m_s: float) -> bool:
        """Return whether nothing is clear of the discs for ever, so that only the horizon can be certified."""
        fastest_m_s = max(discs.speeds_m_s.tolist(), default=0.0)
        endless = self._fence is None and self._limits.braking_m_s2 is None
        return fastest_m_s > 0.0 and not (endless and fastest_m_s < speed_m_s - self._limits.wind_m_s)

    def _flight(
        self, tip: _Pose, before_m_s: float, motion: Motion, discs: Discs, dt_s: float, route: Sequence[Piece]
    ) -> _Flight:
        inflated_m = discs.radii_m + (discs.speeds_m_s * self._limits.reaction_s + self._inflation_m())
        columns = (*discs.centres_ned_m.T.tolist(), inflated_m.tolist(), discs.speeds_m_s.tolist())
        rows = list(zip(*columns, strict=True))
        attack_m = None if discs.attack_m is None else (discs.attack_m + (inflated_m - discs.radii_m)).tolist()
        return _Flight(
            tip, before_m_s, motion.speed_m_s, dt_s, rows, rows, max(columns[3], default=0.0) > 0.0, route, attack_m
        )

    def _curvature_1_m(self, speed_m_s: float) -> float:
        """Return that of the turning circle over the ground, at worst down wind."""
        return self._load_m_s2 / (speed_m_s + self._limits.wind_m_s) ** 2

    def _rate_rad_s(self, speed_m_s: float) -> float:
        return self._load_m_s2 / max(speed_m_s, PIVOT_SPEED_M_S)

    def _flown(self, motion: Motion, commands: Sequence[_Command], duration_s: float) -> tuple[_Pose, float]:
        """Return where the commands take a motion in a while, and its airspeed then: straight on until the first."""
        pose, speed_m_s = _pose(motion), motion.speed_m_s
        at_s = 0.0
        for index, command in enumerate(commands):
            if command.starts_s >= duration_s:
                break
            if command.starts_s > at_s:
                pose = _end_of(_straight(pose, speed_m_s * (command.starts_s - at_s)))
                at_s = command.starts_s
            ends_s = min(commands[index + 1].starts_s, duration_s) if index + 1 < len(commands) else duration_s
            if ends_s <= at_s:
                continue
            turn_rad = math.remainder(command.heading_rad - pose.heading_rad, math.tau)
            pieces, speed_m_s = self._step_pieces(
                pose, _Step(turn_rad, command.speed_m_s), speed_m_s, motion.speed_m_s, ends_s - at_s
            )
            pose, at_s = _end_of(pieces[-1]), ends_s
        if at_s < duration_s:
            pose = _end_of(_straight(pose, speed_m_s * (duration_s - at_s)))
        return pose, speed_m_s

    # Paths

    def _step_pieces(
        self, pose: _Pose, step: _Step, before_m_s: float, ground_m_s: float, duration_s: float
    ) -> tuple[tuple[Piece, ...], float]:
        """Return what is flown in a step, an arc and a straight line, and the speed after it.

        Wind is taken to stay as it is: then the ground speed is the one reported.
        """
        faster_m_s, after_m_s = max(before_m_s, step.speed_m_s), step.speed_m_s
        flown_m = faster_m_s * duration_s
        rate_rad_s = self._rate_rad_s(faster_m_s)
        if self._limits.braking_m_s2 is not None:
            slowing_m_s = faster_m_s - step.speed_m_s
            braking_s = min(duration_s, slowing_m_s / self._limits.braking_m_s2)
            after_m_s = faster_m_s - self._limits.braking_m_s2 * braking_s
            lost_m_s = self._limits.braking_m_s2 * braking_s / 2.0
            flown_m = step.speed_m_s * duration_s + (slowing_m_s - lost_m_s) * braking_s
        elif self._limits.wind_m_s > 0.0:
            faster_m_s = ground_m_s
            flown_m = ground_m_s * duration_s
        turn_rad = math.copysign(min(abs(step.turn_rad), rate_rad_s * duration_s), step.turn_rad)
        arc_m = min(faster_m_s * abs(turn_rad) / rate_rad_s, flown_m)
        heading_rad = pose.heading_rad + turn_rad
        if arc_m <= LEAST_ARC_M:
            return (Piece(pose.north_m, pose.east_m, heading_rad, 0.0, flown_m),), after_m_s
        arc = Piece(*pose, turn_rad / arc_m, arc_m)
        end = _end_of(arc)
        rest_m = flown_m - arc_m
        if rest_m <= 0.0:
            return (arc,), after_m_s
        return (arc, Piece(end.north_m, end.east_m, heading_rad, 0.0, rest_m)), after_m_s

    def _within_limits(
        self, wanted: Setpoint, tip: _Pose, before_m_s: float, dt_s: float, changes: list[str]
    ) -> tuple[_Step, float]:
        """Return the wanted step held to speed, turn and altitude, and the altitude."""
        limits = self._limits
        heading_rad, speed_m_s, altitude_m = wanted.heading_rad, wanted.speed_m_s, wanted.altitude_m
        if not all(map(math.isfinite, (heading_rad, speed_m_s, altitude_m))):
            changes.append(NOT_FINITE)
            heading_rad, speed_m_s = tip.heading_rad, before_m_s
            altitude_m = (limits.altitude_min_m + limits.altitude_max_m) / 2.0
        allowed_m_s = min(max(speed_m_s, limits.speed_min_m_s), limits.speed_max_m_s)
        if allowed_m_s != speed_m_s:
            changes.append(SPEED)
        allowed_m = min(max(altitude_m, limits.altitude_min_m), limits.altitude_max_m)
        if allowed_m != altitude_m:
            changes.append(ALTITUDE)
        turn_rad = math.remainder(heading_rad - tip.heading_rad, math.tau)
        greatest_rad = self._greatest_turn_rad(allowed_m_s, before_m_s, dt_s)
        if abs(turn_rad) > greatest_rad + TURN_TOLERANCE_RAD:
            changes.append(TURN)
            turn_rad = math.copysign(greatest_rad, turn_rad)
        return _Step(turn_rad, allowed_m_s), allowed_m

    def _greatest_turn_rad(self, speed_m_s: float, before_m_s: float, dt_s: float) -> float:
        return min(self._rate_rad_s(max(speed_m_s, before_m_s)) * dt_s, GREATEST_TURN_RAD)

    def _rejoin(self, flight: _Flight, threats_broke: bool) -> None:
        """Drop the path in hand where it has run out, the vehicle is not on it, or a disc has come into it."""
        if self._path is None:
            return
        pose = _at(self._path, self._along_m)
        ahead_m, beside_m = _seen_from(pose, flight.tip)
        if self._limits.braking_m_s2 is not None or self._limits.wind_m_s > 0.0:
            # How far it has come is what the reports say; only being beside the path counts.
            self._along_m = max(0.0, self._along_m + ahead_m)
            ahead_m, beside_m = _seen_from(_at(self._path, self._along_m), flight.tip)
            ahead_m = 0.0
        lost = math.hypot(ahead_m, beside_m) > self._tolerance_m() + self._tracking_m() or self._left_s <= 0.0
        if not lost and threats_broke:
            lost = not self._still_clear(flight)
        if lost:
            self._path = None

    def _still_clear(self, flight: _Flight) -> bool:
        path = self._path
        assert path is not None
        rest = _rest_of(path, self._along_m)
        if flight.moving and math.isinf(self._left_s):
            return _clear(rest, flight.discs, flight.before_m_s - self._limits.wind_m_s, 0.0, 0.0)
        return self._blocked(rest, flight.discs, self._left_s if flight.moving else 0.0) is None

    def _kept_right(self, wanted: _Step, flight: _Flight, limited: bool, changes: list[str]) -> _Step | None:
        """Return the wanted step, or the circle to the right in its place; None where that is not clear."""
        if self._limits.braking_m_s2 is not None:
            return None
        only_right = flight._replace(sides=(1.0,), route=())
        circling = _Step(self._greatest_turn_rad(wanted.speed_m_s, flight.before_m_s, flight.dt_s), wanted.speed_m_s)
        for step in (wanted, circling):
            found = self._accepted(step, only_right, limited, False)
            if isinstance(found, _Path):
                if step is not wanted:
                    changes.append(KEEP_OUT)
                self._hold(found)
                return step
        return None

    def _kept_clear(self, wanted: _Step, flight: _Flight, limited: bool, changes: list[str]) -> _Step:
        """Return the step to take, put the path that goes with it in hand, and say what was changed."""
        reason = ""
        endless = self._path is not None and math.isinf(self._left_s)
        for only_horizon in (limited,) if limited or endless or not flight.moving else (False, True):
            for step in self._choices(wanted, flight):
                if step is wanted and self._follows(wanted, flight):
                    found = self._accepted(step, flight, only_horizon, False)
                    if isinstance(found, str):
                        changes.append(BACKUP)
                        return self._continued(flight)
                else:
                    found = self._accepted(step, flight, only_horizon, step is wanted)
                if isinstance(found, _Path):
                    if step is not wanted:
                        changes.append(reason)
                    self._hold(found)
                    return step
                reason = reason or found
            if self._path is None:
                found = self._from_tip(flight, only_horizon)
                if isinstance(found, _Path):
                    self._hold(found)
                    break
        changes.append(reason)
        if self._path is None:
            changes.append(NO_BACKUP)
            self._left_s = 0.0
            return min(self._choices(wanted, flight), key=lambda step: self._violation(step, flight))
        changes.append(BACKUP)
        return self._continued(flight)

    def _hold(self, path: _Path) -> None:
        if path is not self._path:
            self._path, self._along_m, self._left_s = path, 0.0, path.lasts_s

    def _from_tip(self, flight: _Flight, limited: bool) -> _Path | str:
        step = _Step(0.0, min(max(flight.before_m_s, self._limits.speed_min_m_s), self._limits.speed_max_m_s))
        return self._backup(flight.tip, step, flight.before_m_s, 0.0, 0.0, flight, limited)

    def _choices(self, wanted: _Step, flight: _Flight) -> Iterator[_Step]:
        """Yield the wanted step and milder ones, nearest first; then the same at the speed flown."""
        yield wanted
        flown_m_s = min(max(flight.before_m_s, self._limits.speed_min_m_s), self._limits.speed_max_m_s)
        for speed_m_s in dict.fromkeys((wanted.speed_m_s, flown_m_s)):
            most_rad = self._greatest_turn_rad(speed_m_s, flight.before_m_s, flight.dt_s)
            turns_rad = (0.5 * wanted.turn_rad, 0.0, most_rad, -most_rad)
            for turn_rad in sorted(turns_rad, key=lambda turn_rad: abs(turn_rad - wanted.turn_rad)):
                yield _Step(turn_rad, speed_m_s)
        if self._limits.braking_m_s2 is not None:
            yield _Step(0.0, 0.0)

    def _accepted(self, step: _Step, flight: _Flight, limited: bool, thorough: bool) -> _Path | str:
        """Return the path that begins with a step, if step and what follows are clear, or why there is none."""
        pieces, after_m_s = self._step_pieces(flight.tip, step, flight.before_m_s, flight.ground_m_s, flight.dt_s)
        spare_m = self._spare_m(step, flight)
        if not flight.moving or self._limits.braking_m_s2 is not None:
            blocked = self._blocked(pieces, flight.near, flight.dt_s, spare_m)
        elif not _clear(pieces, flight.near, step.speed_m_s - self._limits.wind_m_s, 0.0, spare_m):
            blocked = KEEP_OUT
        else:
            blocked = self._outside(pieces, spare_m)
        if blocked is not None:
            return blocked
        found = self._backup(_end_of(pieces[-1]), step, after_m_s, flight.dt_s, spare_m, flight, limited, thorough)
        if isinstance(found, str) and self._path is not None and self._continues(step, flight):
            return self._path
        if isinstance(found, str) and thorough and flight.route and not flight.moving:
            found = self._along_route(_end_of(pieces[-1]), step, spare_m, flight) or found
        if isinstance(found, str):
            return found
        return found._replace(pieces=pieces + found.pieces)

    def _follows(self, wanted: _Step, flight: _Flight) -> bool:
        """Return whether the path in hand leads nearly where the wanted step does, along discs that stand still."""
        if self._path is None or flight.moving:
            return False
        held = self._continued(flight)
        return abs(held.turn_rad - wanted.turn_rad) <= FOLLOW_RAD and held.speed_m_s == wanted.speed_m_s

    def _continues(self, step: _Step, flight: _Flight) -> bool:
        held = self._continued(flight)
        return abs(held.turn_rad - step.turn_rad) <= TURN_TOLERANCE_RAD and held.speed_m_s == step.speed_m_s

    def _spare_m(self, step: _Step, flight: _Flight) -> float:
        """Return how far off the path a change of speed may put the vehicle: none of it at one speed."""
        change_m = abs(flight.before_m_s - step.speed_m_s) * flight.dt_s
        return change_m if self._limits.braking_m_s2 is None else change_m * abs(step.turn_rad)

    def _backup(
        self,
        pose: _Pose,
        step: _Step,
        speed_m_s: float,
        after_s: float,
        spare_m: float,
        flight: _Flight,
        limited: bool,
        thorough: bool = True,
    ) -> _Path | str:
        """Return a certified path from a pose that is reached in a while, or what is in the way of one."""
        lasts_s = after_s + self._limits.horizon_s if flight.moving else math.inf
        reason = KEEP_OUT
        if limited or not flight.moving:
            grown_s = lasts_s if flight.moving else 0.0
            found = self._to_rest(pose, step, speed_m_s, flight.near, grown_s, spare_m, flight.dt_s, flight.sides)
            if isinstance(found, _Path):
                return found._replace(lasts_s=lasts_s)
            reason = found
        if flight.moving:
            ray = self._ray(pose, step.speed_m_s, after_s, spare_m, flight, limited, thorough)
            if ray is not None:
                return _Path(ray, 0, step.speed_m_s, lasts_s if limited else math.inf)
        return reason

    def _to_rest(
        self,
        pose: _Pose,
        step: _Step,
        speed_m_s: float,
        discs: list[_Disc],
        grown_s: float,
        spare_m: float,
        dt_s: float,
        sides: tuple[float, ...],
    ) -> _Path | str:
        """Return braking to a stand or, for who cannot, turning for ever, right before left; or what is in the way."""
        if self._limits.braking_m_s2 is not None:
            line = (_straight(pose, speed_m_s * speed_m_s / (2.0 * self._limits.braking_m_s2)),)
            return self._blocked(line, discs, grown_s, spare_m) or _Path(line, 0, 0.0, math.inf)
        blocked: str | None = None
        for side in sides:
            loop = self._loop(pose, side, step.speed_m_s, dt_s)
            blocked = self._blocked(loop, discs, grown_s, spare_m)
            if blocked is None:
                return _Path(loop, len(loop), step.speed_m_s, math.inf)
        return str(blocked)

    def _loop(self, pose: _Pose, side: float, speed_m_s: float, dt_s: float) -> tuple[Piece, ...]:
        """Return the turning circle: a rounded square where a step of it would turn too far for its side to be sure."""
        curvature_1_m = self._curvature_1_m(speed_m_s)
        if speed_m_s * dt_s * curvature_1_m <= GREATEST_TURN_RAD:
            return (Piece(*pose, side * curvature_1_m, math.tau / curvature_1_m),)
        arc_m = math.pi / 2.0 / curvature_1_m
        pieces: list[Piece] = []
        for _ in range(4):
            pieces.append(Piece(*pose, side * curvature_1_m, arc_m))
            pieces.append(_straight(_end_of(pieces[-1]), speed_m_s * dt_s - arc_m))
            pose = _end_of(pieces[-1])
        return tuple(pieces)

    def _along_route(self, pose: _Pose, step: _Step, spare_m: float, flight: _Flight) -> _Path | None:
        """Return a path along the route to where a turning circle is clear; None if it is too far or not clear."""
        pieces_of_route = tuple(flight.route)
        rate_1_m = self._curvature_1_m(step.speed_m_s)
        # Where the route ends nothing need be clear: straight on from there something may be.
        pieces_of_route += (_straight(_end_of(pieces_of_route[-1]), math.tau / rate_1_m),)
        if self._limits.braking_m_s2 is not None or not all(map(math.isfinite, itertools.chain(*pieces_of_route))):
            return None
        speed_m_s, dt_s = step.speed_m_s, flight.dt_s
        route = _Path(pieces_of_route, 0, speed_m_s, math.inf)
        along_m = _nearest_along_m(route, pose)
        left_m = sum(stretch.length_m for stretch in route.pieces) - along_m
        flown: list[Piece] = []
        around = math.ceil(math.tau / (rate_1_m * speed_m_s * dt_s))
        steps = min(max(ROUTE_STEPS, ROUTE_CIRCLES * around), math.ceil(left_m / (speed_m_s * dt_s)))
        every = max(1, around // CIRCLE_PARTS)
        for count in range(1, steps + 1):
            turn_rad = self._steered_rad(route, along_m, pose, speed_m_s, dt_s, dt_s)
            arc_m = abs(turn_rad) / rate_1_m
            arc = Piece(*pose, math.copysign(rate_1_m, turn_rad), arc_m)
            end = _end_of(arc)._replace(heading_rad=pose.heading_rad + turn_rad)
            pieces = (arc, _straight(end, speed_m_s * dt_s - arc_m))
            if self._blocked(pieces, flight.discs, 0.0, spare_m) is not None:
                return None
            if turn_rad == 0.0 and flown and flown[-1].curvature_1_m == 0.0:
                flown[-1] = flown[-1]._replace(length_m=flown[-1].length_m + speed_m_s * dt_s)
            else:
                flown += pieces
            along_m, pose = along_m + speed_m_s * dt_s, _end_of(pieces[-1])
            if count % every and count < steps:
                continue
            circle = self._to_rest(pose, step, speed_m_s, flight.discs, 0.0, spare_m, dt_s, flight.sides)
            if isinstance(circle, _Path):
                return circle._replace(pieces=(*flown, *circle.pieces))
        return None

    def _continued(self, flight: _Flight) -> _Step:
        """Return the step that continues the path in hand."""
        path = self._path
        assert path is not None
        if path.speed_m_s == 0.0:
            turn_rad = math.remainder(path.pieces[-1].heading_rad - flight.tip.heading_rad, math.tau)
            most_rad = self._greatest_turn_rad(0.0, flight.before_m_s, flight.dt_s)
            return _Step(min(max(turn_rad, -most_rad), most_rad), 0.0)
        ground_m_s = flight.ground_m_s if self._limits.wind_m_s > 0.0 else path.speed_m_s
        return _Step(
            self._steered_rad(
                path,
                self._along_m,
                flight.tip,
                ground_m_s,
                flight.dt_s,
                0.0 if self._limits.wind_m_s == 0.0 else flight.dt_s,
            ),
            path.speed_m_s,
        )

    def _steered_rad(
        self, path: _Path, along_m: float, pose: _Pose, ground_m_s: float, dt_s: float, gain_s: float
    ) -> float:
        """Return the turn that puts the heading of the path one step ahead on, and closes in on it where asked to."""
        ahead = _at(path, along_m + ground_m_s * dt_s)
        heading_rad = ahead.heading_rad
        if gain_s > 0.0:
            beside_m = _seen_from(_at(path, along_m), pose)[1]
            heading_rad -= math.atan(beside_m / (CLOSING_STEPS * ground_m_s * (dt_s + self._limits.reaction_s)))
        turn_rad = math.remainder(heading_rad - pose.heading_rad, math.tau)
        most_rad = min(ground_m_s * dt_s * self._curvature_1_m(path.speed_m_s), GREATEST_TURN_RAD)
        if self._limits.wind_m_s > 0.0:
            most_rad = self._greatest_turn_rad(path.speed_m_s, path.speed_m_s, dt_s)
        return min(max(turn_rad, -most_rad), most_rad)

    # What is clear

    def _blocked(
        self, pieces: Sequence[Piece], discs: Iterable[_Disc], grown_s: float, spare_m: float = 0.0
    ) -> str | None:
        """Return what pieces would break, among discs grown for a while and the fence; None if nothing."""
        if any(_hit(piece, discs, grown_s, spare_m) for piece in pieces):
            return KEEP_OUT
        return self._outside(pieces, spare_m)

    def _outside(self, pieces: Iterable[Piece], spare_m: float) -> str | None:
        if self._fence is None or self._fence.holds(pieces, self._inflation_m() + spare_m):
            return None
        return FENCE

    def _ray(
        self,
        pose: _Pose,
        speed_m_s: float,
        after_s: float,
        spare_m: float,
        flight: _Flight,
        limited: bool,
        thorough: bool,
    ) -> tuple[Piece, ...] | None:
        """Return an arc to a heading and straight on that no moving disc reaches; None if there is none."""
        slow_m_s = speed_m_s - self._limits.wind_m_s
        if slow_m_s < PIVOT_SPEED_M_S:
            return None
        curvature_1_m = self._curvature_1_m(speed_m_s)
        length_m = slow_m_s * self._limits.horizon_s if limited else math.inf
        coarse = speed_m_s * flight.dt_s * curvature_1_m > GREATEST_TURN_RAD
        for heading_rad in self._likely_headings_rad(pose, flight.discs):
            turn_rad = math.remainder(heading_rad - pose.heading_rad, math.tau)
            if coarse and abs(turn_rad) > GREATEST_TURN_RAD:
                continue
            pieces = _turned(pose, turn_rad, curvature_1_m, length_m)
            # The line is what most often fails: first.
            turned_s = after_s + abs(turn_rad) / (curvature_1_m * slow_m_s)
            clear = _clear(pieces[-1:], flight.discs, slow_m_s, turned_s, spare_m) and _clear(
                pieces[:-1], flight.discs, slow_m_s, after_s, spare_m
            )
            if clear and self._outside(pieces, spare_m) is None:
                return pieces
        if not thorough:
            return None
        most_rad = GREATEST_TURN_RAD if coarse else math.tau
        table = np.array(flight.discs)
        table[:, 2] += table[:, 3] * after_s + spare_m
        for turn_rad in _fan_rad(pose, curvature_1_m, length_m, slow_m_s, table, most_rad):
            pieces = _turned(pose, turn_rad, curvature_1_m, length_m)
            if self._outside(pieces, spare_m) is None:
                return pieces
        return None

    def _likely_headings_rad(self, pose: _Pose, discs: Iterable[_Disc]) -> Iterator[float]:
        """Yield straight on, the heading of the ray in hand, and away from the disc that is nearest."""
        yield pose.heading_rad
        if self._path is not None and self._path.loops == 0:
            yield self._path.pieces[-1].heading_rad
        north_m, east_m, _, _ = min(discs, key=lambda disc: math.dist(disc[:2], pose[:2]) - disc[2])
        yield math.atan2(pose.east_m - east_m, pose.north_m - north_m)

    def _violation(self, step: _Step, flight: _Flight) -> tuple[float, ...]:
        """Return what to make least when nothing is certified: depth in attack discs, beyond the fence, in discs.

        First the greatest during the step and straight on for as long again, then at the end of this, which tells
        apart the ways out.
        """
        pieces, _ = self._step_pieces(flight.tip, step, flight.before_m_s, flight.ground_m_s, flight.dt_s)
        path = _Path((*pieces, _straight(_end_of(pieces[-1]), step.speed_m_s * flight.dt_s)), 0, step.speed_m_s, 0.0)
        length_m = sum(piece.length_m for piece in path.pieces)
        shares = np.linspace(0.0, 1.0, 2 * SAMPLES + 1)
        places = np.array([_at(path, share * length_m)[:2] for share in shares.tolist()])
        table = np.array(flight.discs).reshape(-1, 4)
        apart_m = np.hypot(places[:, None, 0] - table[:, 0], places[:, None, 1] - table[:, 1])
        apart_m -= table[:, 3] * (2.0 * flight.dt_s * shares[:, None])
        depths_m = np.zeros((len(shares), 3))
        if flight.attack_m is not None:
            depths_m[:, 0] = np.max(np.array(flight.attack_m) - apart_m, axis=1, initial=0.0)
        if self._fence is not None:
            depths_m[:, 1] = [max(0.0, -self._fence.depth_m(*place)) for place in places.tolist()]
        depths_m[:, 2] = np.max(table[:, 2] - apart_m, axis=1, initial=-math.inf)
        return (*depths_m.max(axis=0).tolist(), *depths_m[-1].tolist())


class _Fence:
    """A simple polygon to stay inside."""

    def __init__(self, corners_ned_m: Sequence[tuple[float, float]]) -> None:
        self._ends_m = np.array(corners_ned_m, dtype=float)
        self._starts_m = np.roll(self._ends_m, 1, axis=0)
        self._along_m = self._ends_m - self._starts_m
        squares = (self._along_m**2).sum(axis=1)
        self._lengths_m2 = np.where(squares > 0.0, squares, 1.0)

    def depth_m(self, north_m: float, east_m: float) -> float:
        """Return the distance to the nearest edge, negative outside (even-odd)."""
        norths_m, easts_m = north_m - self._starts_m[:, 0], east_m - self._starts_m[:, 1]
        upward = self._along_m[:, 0] > 0.0
        spans = (self._ends_m[:, 0] > north_m) != (self._starts_m[:, 0] > north_m)
        to_the_east = self._along_m[:, 1] * norths_m > easts_m * self._along_m[:, 0]
        inside = np.count_nonzero(spans & (to_the_east == upward)) % 2 == 1
        near = self._nearest_m(np.array([north_m]), np.array([east_m]))
        apart_m = float(np.hypot(near[0] - north_m, near[1] - east_m).min())
        return apart_m if inside else -apart_m

    def holds(self, pieces: Iterable[Piece], margin_m: float) -> bool:
        """Return whether pieces that hang together stay inside, and no nearer to an edge than the margin."""
        first = True
        for piece in pieces:
            reach_m = min(piece.length_m, 2.0 / abs(piece.curvature_1_m) if piece.curvature_1_m else math.inf)
            if first:
                depth_m = self.depth_m(piece.north_m, piece.east_m)
                if depth_m < margin_m:
                    return False
                first = False
                room_m = depth_m - margin_m
            if reach_m <= room_m:
                room_m -= reach_m
                continue
            room_m = 0.0
            if any(_distance_m(piece, *place) < margin_m for place in self._touching_m(piece)):
                return False
            if self.depth_m(*_end_of(piece)[:2]) < margin_m:
                return False
        return True

    def _nearest_m(self, norths_m: np.ndarray, easts_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the point of each edge (E,) nearest to a point."""
        along = (norths_m - self._starts_m[:, 0]) * self._along_m[:, 0] + (
            easts_m - self._starts_m[:, 1]
        ) * self._along_m[:, 1]
        return self._points(along / self._lengths_m2)

    def _points(self, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shares = np.clip(shares, 0.0, 1.0)
        return self._starts_m[:, 0] + shares * self._along_m[:, 0], self._starts_m[:, 1] + shares * self._along_m[:, 1]

    def _touching_m(self, piece: Piece) -> Iterator[tuple[float, float]]:
        """Return the points of the edges among which is the one nearest to the inside of a piece.

        They are the corners, where an edge crosses the piece's line or circle, and where it comes nearest to the
        circle's centre. Ends of the piece may be nearer still.
        """
        starts, along = self._starts_m, self._along_m
        if piece.curvature_1_m == 0.0:
            ahead = (math.cos(piece.heading_rad), math.sin(piece.heading_rad))
            away = (starts[:, 0] - piece.north_m) * ahead[1] - (starts[:, 1] - piece.east_m) * ahead[0]
            slope = along[:, 1] * ahead[0] - along[:, 0] * ahead[1]
            shares = away / np.where(slope == 0.0, 1.0, slope)
            points = [self._points(shares)]
        else:
            centre_north_m, centre_east_m, radius_m = _circle(piece)
            foot = (
                (centre_north_m - starts[:, 0]) * along[:, 0] + (centre_east_m - starts[:, 1]) * along[:, 1]
            ) / self._lengths_m2
            off_m2 = (starts[:, 0] + foot * along[:, 0] - centre_north_m) ** 2 + (
                starts[:, 1] + foot * along[:, 1] - centre_east_m
            ) ** 2
            half = np.sqrt(np.maximum(radius_m**2 - off_m2, 0.0) / self._lengths_m2)
            points = [self._points(foot), self._points(foot - half), self._points(foot + half)]
        norths_m = np.concatenate([starts[:, 0], *(point[0] for point in points)])
        easts_m = np.concatenate([starts[:, 1], *(point[1] for point in points)])
        return zip(norths_m.tolist(), easts_m.tolist(), strict=True)


def _ids_of(discs: Discs) -> list[int]:
    """Return what tells the discs apart: their ids, or else their places."""
    ids: list[int] = list(range(len(discs.radii_m))) if discs.ids is None else discs.ids.tolist()
    return ids


def _contradictions(before: _Heard, now: _Heard, elapsed_s: float) -> list[str]:
    """Return what is new or was faster than its bound; put earlier discs back in force where they exclude more."""
    broken = []
    for row, key in enumerate(now.ids):
        if key not in before.ids:
            broken.append(NEW_THREAT)
            continue
        old = before.ids.index(key)
        grown_m = before.radii_m[old] + before.speeds_m_s[old] * elapsed_s
        beyond_m = math.dist(now.centres_ned_m[row], before.centres_ned_m[old]) + now.radii_m[row] - grown_m
        if beyond_m > THREAT_TOLERANCE_M:
            broken.append(THREAT_FASTER)
        elif beyond_m > ROUNDING_M:
            now.centres_ned_m[row], now.radii_m[row] = before.centres_ned_m[old], grown_m
            now.speeds_m_s[row] = before.speeds_m_s[old]
    return list(dict.fromkeys(broken))


def _unusable(motion: Motion, discs: Discs, dt_s: float, slack_m: Sequence[float]) -> str | None:
    """Return why there is nothing to decide on: something is not finite, or has a negative size."""
    if not math.isfinite(motion.north_m + motion.east_m + motion.heading_rad + motion.speed_m_s + dt_s + sum(slack_m)):
        return NOT_FINITE
    sizes = (motion.speed_m_s, min(discs.radii_m.tolist(), default=0.0), min(discs.speeds_m_s.tolist(), default=0.0))
    return IMPOSSIBLE if min(sizes) < 0.0 or dt_s <= 0.0 else None


def _slack_m(motion: Motion, discs: Discs, dt_s: float) -> list[float]:
    """Return the distance from each disc's edge, grown over the step; not finite where anything is not."""
    norths_m, easts_m = discs.centres_ned_m[:, 0] - motion.north_m, discs.centres_ned_m[:, 1] - motion.east_m
    slack_m: list[float] = (np.hypot(norths_m, easts_m) - (discs.radii_m + discs.speeds_m_s * dt_s)).tolist()
    return slack_m


def _pose(motion: Motion) -> _Pose:
    return _Pose(motion.north_m, motion.east_m, motion.heading_rad)


def _straight(pose: _Pose, length_m: float) -> Piece:
    return Piece(pose.north_m, pose.east_m, pose.heading_rad, 0.0, length_m)


def _turned(pose: _Pose, turn_rad: float, curvature_1_m: float, length_m: float) -> tuple[Piece, ...]:
    """Return an arc, in parts over which a growing disc may count as large as at their ends, and a line."""
    parts = math.ceil(abs(turn_rad) / SUB_ARC_RAD)
    pieces = []
    for _ in range(parts):
        arc_m = abs(turn_rad) / parts / curvature_1_m
        pieces.append(Piece(*pose, math.copysign(curvature_1_m, turn_rad), arc_m))
        pose = _end_of(pieces[-1])
    pieces.append(_straight(pose, length_m))
    return tuple(pieces)


def _place_on(piece: Piece, along_m: float) -> _Pose:
    """Return the pose after a way along a piece: exact, and without loss of digits at small curvature."""
    half_rad = 0.5 * piece.curvature_1_m * along_m
    chord_m = along_m * (math.sin(half_rad) / half_rad) if half_rad else along_m
    middle_rad = piece.heading_rad + half_rad
    return _Pose(
        piece.north_m + chord_m * math.cos(middle_rad),
        piece.east_m + chord_m * math.sin(middle_rad),
        middle_rad + half_rad,
    )


def _end_of(piece: Piece) -> _Pose:
    return _place_on(piece, piece.length_m)


def _at(path: _Path, along_m: float) -> _Pose:
    """Return the pose a way along a path; beyond its end, its end."""
    first = len(path.pieces) - path.loops
    for piece in path.pieces[:first]:
        if along_m <= piece.length_m:
            return _place_on(piece, along_m)
        along_m -= piece.length_m
    if path.loops == 0:
        return _end_of(path.pieces[-1])
    loop = path.pieces[first:]
    along_m %= sum(piece.length_m for piece in loop)
    for piece in loop[:-1]:
        if along_m <= piece.length_m:
            return _place_on(piece, along_m)
        along_m -= piece.length_m
    return _place_on(loop[-1], along_m)


def _rest_of(path: _Path, along_m: float) -> tuple[Piece, ...]:
    """Return what is left of a path, its loop whole."""
    first = len(path.pieces) - path.loops
    rest: list[Piece] = []
    for piece in path.pieces[:first]:
        done_m = min(along_m, piece.length_m)
        along_m -= done_m
        if done_m < piece.length_m:
            rest.append(Piece(*_place_on(piece, done_m), piece.curvature_1_m, piece.length_m - done_m))
    return (*rest, *path.pieces[first:])


def _seen_from(pose: _Pose, place: _Pose) -> tuple[float, float]:
    """Return how far ahead and to the right of a pose a place is."""
    north_m, east_m = place.north_m - pose.north_m, place.east_m - pose.east_m
    cosine, sine = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    return north_m * cosine + east_m * sine, east_m * cosine - north_m * sine


def _nearest_along_m(path: _Path, pose: _Pose) -> float:
    """Return how far along a path its nearest place is."""
    best_m, best_along_m, before_m = math.inf, 0.0, 0.0
    for piece in path.pieces:
        along_m = _nearest_on_m(piece, pose)
        place = _place_on(piece, along_m)
        apart_m = math.hypot(place.north_m - pose.north_m, place.east_m - pose.east_m)
        if apart_m < best_m:
            best_m, best_along_m = apart_m, before_m + along_m
        before_m += piece.length_m
    return best_along_m


def _nearest_on_m(piece: Piece, pose: _Pose) -> float:
    if piece.curvature_1_m == 0.0:
        return min(max(_seen_from(_Pose(*piece[:3]), pose)[0], 0.0), piece.length_m)
    north_m, east_m, radius_m = _circle(piece)
    phase_rad = _phase_rad(piece, pose.north_m - north_m, pose.east_m - east_m)
    if phase_rad * radius_m <= piece.length_m:
        return phase_rad * radius_m
    end = _end_of(piece)
    to_start_m = math.hypot(pose.north_m - piece.north_m, pose.east_m - piece.east_m)
    return 0.0 if to_start_m < math.hypot(pose.north_m - end.north_m, pose.east_m - end.east_m) else piece.length_m


def _circle(piece: Piece) -> tuple[float, float, float]:
    """Return centre and radius of an arc."""
    signed_m = 1.0 / piece.curvature_1_m
    north_m = piece.north_m - signed_m * math.sin(piece.heading_rad)
    return north_m, piece.east_m + signed_m * math.cos(piece.heading_rad), abs(signed_m)


def _phase_rad(piece: Piece, north_m: float, east_m: float) -> float:
    """Return the turn, 0 to 2 pi, after which an arc passes the bearing of a place seen from its centre."""
    side = math.copysign(1.0, piece.curvature_1_m)
    return (side * (math.atan2(east_m, north_m) - piece.heading_rad) + math.pi / 2.0) % math.tau


def _distance_m(piece: Piece, north_m: float, east_m: float) -> float:
    """Return the distance of a place from a piece, in closed form."""
    dn_m, de_m = north_m - piece.north_m, east_m - piece.east_m
    if piece.curvature_1_m == 0.0:
        cosine, sine = math.cos(piece.heading_rad), math.sin(piece.heading_rad)
        along_m = min(max(dn_m * cosine + de_m * sine, 0.0), piece.length_m)
        return math.hypot(dn_m - along_m * cosine, de_m - along_m * sine)
    centre_north_m, centre_east_m, radius_m = _circle(piece)
    from_north_m, from_east_m = north_m - centre_north_m, east_m - centre_east_m
    turned_rad = piece.length_m / radius_m
    if turned_rad >= math.tau or _phase_rad(piece, from_north_m, from_east_m) <= turned_rad:
        return abs(math.hypot(from_north_m, from_east_m) - radius_m)
    end = _end_of(piece)
    return min(math.hypot(dn_m, de_m), math.hypot(north_m - end.north_m, east_m - end.east_m))


def _hit(piece: Piece, discs: Iterable[_Disc], grown_s: float, spare_m: float) -> bool:
    """Return whether a piece enters a disc that has grown for a while."""
    start_north_m, start_east_m, _, _, length_m = piece
    for north_m, east_m, radius_m, speed_m_s in discs:
        kept_m = radius_m + speed_m_s * grown_s + spare_m
        reach_m = kept_m + length_m
        dn_m, de_m = north_m - start_north_m, east_m - start_east_m
        # Most are too far to look at closely.
        if dn_m * dn_m + de_m * de_m < reach_m * reach_m and _distance_m(piece, north_m, east_m) < kept_m:
            return True
    return False


def _clear(pieces: Iterable[Piece], discs: Sequence[_Disc], slow_m_s: float, at_s: float, spare_m: float) -> bool:
    """Return whether pieces flown from a time on, at the least speed along them, keep clear of moving discs.

    A line is decided exactly; on an arc a disc counts as large as at its end.
    """
    for piece in pieces:
        ends_s = at_s + piece.length_m / slow_m_s
        if piece.curvature_1_m == 0.0:
            if _met(piece, discs, slow_m_s, at_s, ends_s - at_s, spare_m):
                return False
        elif _hit(piece, discs, ends_s, spare_m):
            return False
        at_s = ends_s
    return True


def _met(line: Piece, discs: Iterable[_Disc], slow_m_s: float, at_s: float, lasts_s: float, spare_m: float) -> bool:
    """Return whether a growing disc reaches a vehicle on a line: where the quadratic of the module's proof is negative.

    A disc as fast as the vehicle needs a finite time: there the quadratic is least at one of the ends.
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


def _fan_rad(
    pose: _Pose,
    curvature_1_m: float,
    length_m: float,
    slow_m_s: float,
    discs: np.ndarray,  # (M, 4) m, m, m, m/s
    most_rad: float,
) -> list[float]:
    """Return the turns to either side after which a line of a length is clear of moving discs, mildest first.

    The same decisions as `_clear` makes, for all of them at once.
    """
    count = math.floor(most_rad / FAN_STEP_RAD + TURN_TOLERANCE_RAD)
    turns_rad = FAN_STEP_RAD * np.arange(count + 1)
    disc_norths_m, disc_easts_m, radii_m, speeds_m_s = discs.T
    grown_m = radii_m + speeds_m_s * (turns_rad[:, None] / (curvature_1_m * slow_m_s))
    closing = slow_m_s * slow_m_s - speeds_m_s * speeds_m_s
    found: list[tuple[float, float]] = []
    for side in (1.0, -1.0):
        north_m, east_m, radius_m = _circle(Piece(*pose, side * curvature_1_m, 0.0))
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
