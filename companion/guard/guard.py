"""The guard: it holds a setpoint to every limit and reports what it changed and why (docs/method.md section 3).

It checks every input and imports nothing but numpy and the standard library, so that a fault in guidance, surrogate,
route or world model cannot reach the vehicle.

Assumptions, each monitored: a command begins to act `reaction_s` after it is given; the vehicle then turns by the
shorter side at rate_share n g / v until the heading is reached and flies straight (a heading that leads beyond a step,
companion/guard/lead.py, is not reached in that step and so changes nothing); no disc moves faster than its bound;
the wind stays within its bound; reported positions are within their error bound; `check` is called every `dt_s`.
Theorem: from a certificate "for ever" no disc is ever entered and no fence left, whatever is wanted; from one "until t"
not before t; "none" says nothing (Verdict.certified_s: infinite, t, 0).
Proof: the *tip* is the state at which the next command begins to act; it follows from the motion and the commands in
flight. Between calls the guard holds a path from the tip that is clear at all later times, or until t. A wanted step is
let through only if it and a new path from its end are clear: that path is held next. Otherwise the held path is
continued; what is left of a clear path is clear, so nothing needs to be certified again. A path follows circles, lines
and the route exactly as the vehicle is predicted to fly them, step by step (companion/guard/follow.py). It ends on a
turning circle or at rest, which discs that stand still never reach, or (discs that move) on a ray u from p at speed v:
with d = p - c, disc radius R + w t, a = v^2 - w^2, b = 2 (v d.u - w R), c0 = |d|^2 - R^2 the squared distance less the
squared radius is a t^2 + b t + c0, which is never negative iff c0 >= 0 and (b >= 0 or b^2 <= 4 a c0), and whose least
value until t is at one of the ends or at the vertex. A later report of a disc within its bound lies inside the earlier
one grown, so it takes nothing away; a disc that was never reported is no disc of the theorem, so whoever knows that one
is missing must not claim a certificate. By induction there is always a choice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from companion.guard.arcs import Path, Pose, is_clear, pose_at, pose_of, rest_of, seen_from, straight
from companion.guard.backup import BackupSearch, Flight
from companion.guard.fence import Fence
from companion.guard.lead import Turn, commanded_rad
from companion.guard.threats import ThreatMonitor
from companion.guard.types import (
    BACKUP,
    IMPOSSIBLE,
    KEEP_OUT,
    LATE,
    NO_BACKUP,
    NO_HINTS,
    NOT_FINITE,
    POSITION,
    RATE,
    WIND,
    Discs,
    Hints,
    Limits,
    Motion,
    Piece,
    Setpoint,
    Verdict,
)
from companion.guard.vehicle import Command, Step, VehicleModel

CLOCK_TOLERANCE = 1e-3
"""Share of a step by which the time between two calls may differ from one step and still count as one: clocks round."""
LATE_SHARE = 1.1
"""Number of steps after the last call from which a call is reported as late."""
GAP_STEPS = 3.0
"""Number of steps without a call after which the guard resets: what the vehicle did since is not known."""
HEADING_TOLERANCE_RAD = 0.02
"""Difference up to which a reported heading counts as the commanded one (without wind the commanded one is then used),
because reports resolve the velocity to 1 cm/s. Chosen, not measured."""
SPEED_TOLERANCE_M_S = 0.5
"""Amount by which a reported ground speed may be outside the speed limits beyond the wind. Chosen, not measured."""
COURSE_SHARE = 2.0
"""A changing wind turns the course by up to this factor times wind over least speed, in radians."""


class Guard:
    """Checks every setpoint of one vehicle; stores the commands that do not act yet and a path that stays clear."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._vehicle = VehicleModel(limits)
        walled = limits.fence_ned_m is not None or len(limits.exclusions_ned_m) > 0
        self._fence = Fence(limits.fence_ned_m, limits.exclusions_ned_m) if walled else None
        self.reset()

    def reset(self) -> None:
        """Forget commands, path and discs, because something else steered the vehicle or the origin has changed."""
        self._called_s: float | None = None
        self._motion = Motion(0.0, 0.0, 0.0, 0.0)
        self._commands: list[Command] = []
        self._path: Path | None = None
        self._along_m = 0.0
        self._left_s = 0.0
        self._threats = ThreatMonitor()

    def succeed(self, before: Guard) -> None:
        """Continue from the guard of the same vehicle by other limits: keep the commands in flight and the discs heard.

        Its path is not kept, as the vehicle flies it otherwise than it was certified for: a path is certified anew from
        the present state.
        """
        self._called_s, self._motion = before._called_s, before._motion
        self._commands, self._threats = list(before._commands), before._threats

    def certify(self, motion: Motion, discs: Discs, dt_s: float) -> float:
        """Return for how long a start is certified: straight on for the reaction time, then a path that stays clear.

        Infinity is for ever, 0 not at all. The guard's state does not change.
        """
        if unusable(motion, discs, dt_s, slack_m_of(motion, discs, 0.0)) is not None:
            return 0.0
        reaction_s = self._limits.reaction_s
        tip, speed_m_s = self._vehicle.flown(motion, [], reaction_s)
        committed = (straight(pose_of(motion), motion.speed_m_s * reaction_s),)
        flight = self._flight(tip, speed_m_s, motion, discs, dt_s, ())
        for horizon_s in self._horizons_s(discs, speed_m_s):
            search = self._search(flight, horizon_s)
            if search.blocked(committed, flight.discs, 0.0) is not None:
                return 0.0
            if isinstance(search.backup(tip, Step(0.0, speed_m_s), speed_m_s, 0.0, 0.0), Path):
                return horizon_s
        return 0.0

    def check(
        self,
        wanted: Setpoint,
        motion: Motion,
        discs: Discs,
        now_s: float,
        dt_s: float,
        hints: Hints = NO_HINTS,
    ) -> Verdict:
        """Return the setpoint nearest to the wanted one that every limit allows for the next `dt_s` seconds.

        `now_s` is the time of any clock that does not step. If a motion, a disc or a time is not finite, or a radius or
        a speed is negative, the verdict holds no setpoint. A wanted setpoint that is not finite is replaced by straight
        on at the present speed and the middle of the altitude band.
        """
        slack_m = slack_m_of(motion, discs, dt_s)
        reason = unusable(motion, discs, dt_s, slack_m) if math.isfinite(now_s) else NOT_FINITE
        if reason is not None:
            return Verdict(None, (reason,))
        elapsed_s = self._elapsed_s(now_s, dt_s)
        broken = self._monitored(motion, elapsed_s, dt_s)
        tip, before_m_s = self._vehicle.flown(self._motion, self._commands, self._limits.reaction_s)
        if self._limits.braking_m_s2 is None:
            before_m_s = self._vehicle.allowed_m_s(before_m_s)
        changes: list[str] = []
        step, altitude_m = self._vehicle.within_limits(wanted, tip, before_m_s, dt_s, changes)
        wanted_step = step
        near_m = self._vehicle.reach_m(motion, before_m_s, step, dt_s)
        moving = max(discs.speeds_m_s.tolist(), default=0.0) > 0.0
        if self._fence is None and not moving and min(slack_m, default=math.inf) > near_m:
            self._path, self._left_s = None, math.inf
            self._threats.note_far(discs)
        else:
            flight = self._flight(tip, before_m_s, motion, discs, dt_s, hints.route)
            if not moving:
                near = [disc for disc, apart_m in zip(flight.discs, slack_m, strict=True) if apart_m <= near_m]
                flight = flight._replace(near=near)
            threats = self._threats.contradicted_by(discs)
            broken += threats
            self._rejoin(flight, bool(threats))
            right = self._kept_right(step, flight, changes) if hints.keep_right and not moving else None
            step = right or self._kept_clear(step, flight, self._horizons_s(discs, step.speed_m_s), changes)
        most_rad = self._vehicle.greatest_turn_rad(step.speed_m_s, before_m_s, dt_s)
        last_rad = self._commands[-1].heading_rad if self._commands else None
        towards_rad = hints.towards_rad if step is wanted_step else None
        turn = Turn(tip.heading_rad, step.turn_rad, most_rad, self._motion.heading_rad, last_rad, towards_rad)
        heading_rad = commanded_rad(turn)
        self._commands.append(Command(self._limits.reaction_s, heading_rad, step.speed_m_s))
        return Verdict(Setpoint(heading_rad, step.speed_m_s, altitude_m), tuple(changes), tuple(broken), self._left_s)

    # The reports: what they say of vehicle and discs

    def tip(self, motion: Motion, now_s: float, dt_s: float) -> tuple[Pose, float]:
        """Return the pose and airspeed at which the next command begins to act, as `check` reckons with this motion.

        The guard's state does not change. The arguments are those of `check`, and finite.
        """
        elapsed_s = self._since_s(now_s, dt_s)
        if elapsed_s is None:
            return self._vehicle.flown(motion, [], self._limits.reaction_s)
        motion = self._as_expected(motion, self._expected(elapsed_s))
        return self._vehicle.flown(motion, self._in_flight(elapsed_s), self._limits.reaction_s)

    def _since_s(self, now_s: float, dt_s: float) -> float | None:
        """Return the time since the last call; None if there was none, or if it is too long ago to count."""
        elapsed_s = math.inf if self._called_s is None else now_s - self._called_s
        if not 0.0 <= elapsed_s <= GAP_STEPS * dt_s:
            return None
        return dt_s if abs(elapsed_s - dt_s) <= CLOCK_TOLERANCE * dt_s else elapsed_s

    def _elapsed_s(self, now_s: float, dt_s: float) -> float:
        """Return the time since the last call; after a gap, reset the guard and return 0."""
        elapsed_s = self._since_s(now_s, dt_s)
        if elapsed_s is None:
            self.reset()
        self._called_s = now_s
        return elapsed_s or 0.0

    def _expected(self, elapsed_s: float) -> tuple[Pose, float] | None:
        """Return the pose and airspeed that the commands lead to after `elapsed_s`; None if there were no commands."""
        return self._vehicle.flown(self._motion, self._commands, elapsed_s) if self._commands else None

    def _as_expected(self, motion: Motion, expected: tuple[Pose, float] | None) -> Motion:
        """Return a reported motion; without wind with the expected heading, where that is as good as the reported."""
        if expected is None or self._limits.wind_m_s > 0.0:
            return motion
        heading_rad = expected[0].heading_rad
        if abs(math.remainder(motion.heading_rad - heading_rad, math.tau)) > HEADING_TOLERANCE_RAD:
            return motion
        return Motion(motion.north_m, motion.east_m, heading_rad, motion.speed_m_s)

    def _in_flight(self, elapsed_s: float) -> list[Command]:
        """Return the commands that act after `elapsed_s` or later, with the times from then on."""
        moved = [command._replace(starts_s=command.starts_s - elapsed_s) for command in self._commands]
        return [moved[i] for i in range(len(moved)) if i + 1 == len(moved) or moved[i + 1].starts_s > 0.0]

    def _monitored(self, motion: Motion, elapsed_s: float, dt_s: float) -> list[str]:
        """Return the assumptions that the reported motion contradicts, and advance the stored state by `elapsed_s`."""
        limits = self._limits
        broken = []
        spare_m_s = limits.wind_m_s + SPEED_TOLERANCE_M_S
        if not limits.speed_min_m_s - spare_m_s <= motion.speed_m_s <= limits.speed_max_m_s + spare_m_s:
            broken.append(WIND)
        if elapsed_s > LATE_SHARE * dt_s:
            broken.append(LATE)
        expected = self._expected(elapsed_s)
        if expected is not None:
            pose, speed_m_s = expected
            change_m_s = abs(speed_m_s - self._motion.speed_m_s)
            turning = limits.braking_m_s2 is None
            if not turning:
                change_m_s = max(speed_m_s, self._motion.speed_m_s)
            off_m = math.hypot(motion.north_m - pose.north_m, motion.east_m - pose.east_m)
            if off_m > self._vehicle.tolerance_m() + (change_m_s + 2.0 * limits.wind_m_s) * elapsed_s:
                broken.append(POSITION)
            off_rad = abs(math.remainder(motion.heading_rad - pose.heading_rad, math.tau))
            if turning and off_rad > HEADING_TOLERANCE_RAD + COURSE_SHARE * limits.wind_m_s / limits.speed_min_m_s:
                broken.append(RATE)
            self._along_m += (motion.speed_m_s if limits.wind_m_s > 0.0 else speed_m_s) * elapsed_s
            self._commands = self._in_flight(elapsed_s)
        self._left_s -= elapsed_s
        self._threats.elapse(elapsed_s)
        self._motion = self._as_expected(motion, expected)
        return broken

    def _horizons_s(self, discs: Discs, speed_m_s: float) -> tuple[float, ...]:
        """Return for how long a path is to stay clear of the discs, the longest first: for ever where one can.

        Where a path for ever is lost for a while, only the longest horizon will do: whoever takes a shorter one among
        slower pursuers goes on to where they close in.
        """
        fastest_m_s = max(discs.speeds_m_s.tolist(), default=0.0)
        if fastest_m_s == 0.0:
            return (math.inf,)
        endless = self._limits.fence_ned_m is None and self._limits.braking_m_s2 is None
        horizons_s = self._vehicle.horizons_s()
        slower = fastest_m_s < speed_m_s - self._limits.wind_m_s
        return (math.inf, horizons_s[0]) if endless and slower else horizons_s

    def _flight(
        self, tip: Pose, before_m_s: float, motion: Motion, discs: Discs, dt_s: float, route: Sequence[Piece]
    ) -> Flight:
        """Return the flight situation, with every disc grown for the reaction time and inflated (see Flight)."""
        reaction_s, off_m = self._limits.reaction_s, self._vehicle.inflation_m(dt_s)
        inflated_m = discs.radii_m + (discs.speeds_m_s * reaction_s + off_m)
        columns = (*discs.centres_ned_m.T.tolist(), inflated_m.tolist(), discs.speeds_m_s.tolist())
        rows = list(zip(*columns, strict=True))
        attack_m = None if discs.attack_m is None else (discs.attack_m + (inflated_m - discs.radii_m)).tolist()
        moving = max(columns[3], default=0.0) > 0.0
        return Flight(tip, before_m_s, motion.speed_m_s, dt_s, rows, rows, moving, route, attack_m, off_m)

    # The stored path

    def _rejoin(self, flight: Flight, threats_broke: bool) -> None:
        """Find the tip on the stored path; drop the path if it has run out, is too far off or is no longer clear."""
        if self._path is None:
            return
        pose = pose_at(self._path, self._along_m)
        ahead_m, beside_m = seen_from(pose, flight.tip)
        if self._limits.braking_m_s2 is not None or self._limits.wind_m_s > 0.0:
            # Progress along the path is taken from the reports; only the distance beside the path counts.
            self._along_m = max(0.0, self._along_m + ahead_m)
            ahead_m, beside_m = seen_from(pose_at(self._path, self._along_m), flight.tip)
            ahead_m = 0.0
        most_m = self._vehicle.tolerance_m() + self._vehicle.tracking_m(flight.dt_s)
        lost = math.hypot(ahead_m, beside_m) > most_m or self._left_s <= 0.0
        if not lost and threats_broke:
            lost = not self._still_clear(flight)
        if lost:
            self._path = None

    def _still_clear(self, flight: Flight) -> bool:
        """Return whether the rest of the stored path is clear of the discs as reported now."""
        path = self._path
        assert path is not None
        rest = rest_of(path, self._along_m)
        if flight.moving and math.isinf(self._left_s):
            return is_clear(rest, flight.discs, flight.before_m_s - self._limits.wind_m_s, 0.0, 0.0)
        search = self._search(flight, math.inf)
        return search.blocked(rest, flight.discs, self._left_s if flight.moving else 0.0) is None

    def _search(self, flight: Flight, horizon_s: float) -> BackupSearch:
        """Return a search for a flight situation that uses the stored path."""
        return BackupSearch(self._vehicle, self._fence, flight, horizon_s, self._path, self._along_m)

    def _kept_right(self, wanted: Step, flight: Flight, changes: list[str]) -> Step | None:
        """Return the wanted step if the right-hand circle is clear after it, else a step on that circle, else None."""
        if self._limits.braking_m_s2 is not None:
            return None
        search = self._search(flight._replace(sides=(1.0,), route=()), math.inf)
        most_rad = self._vehicle.greatest_turn_rad(wanted.speed_m_s, flight.before_m_s, flight.dt_s)
        circling = Step(most_rad, wanted.speed_m_s)
        for step in (wanted, circling):
            found = search.accepted(step, False)
            if isinstance(found, Path):
                if step is not wanted:
                    changes.append(KEEP_OUT)
                self._hold(found)
                return step
        return None

    def _kept_clear(self, wanted: Step, flight: Flight, horizons_s: tuple[float, ...], changes: list[str]) -> Step:
        """Return the step to take, store the path that begins with it, and append to `changes` what was changed."""
        reason = ""
        endless = self._path is not None and math.isinf(self._left_s)
        for horizon_s in horizons_s[:1] if endless else horizons_s:
            search = self._search(flight, horizon_s)
            # Where nothing is clear for ever, what is wanted for a shorter time goes before what is not for a longer.
            only_wanted = not math.isinf(horizons_s[0]) and horizon_s != horizons_s[-1]
            for step in (wanted,) if only_wanted else search.choices(wanted):
                if step is wanted and search.follows(wanted):
                    found = search.accepted(step, False)
                    if isinstance(found, str):
                        changes.append(BACKUP)
                        return search.continued()
                else:
                    found = search.accepted(step, step is wanted)
                if isinstance(found, Path):
                    if step is not wanted:
                        changes.append(reason)
                    self._hold(found)
                    return step
                reason = reason or found
            if self._path is None and not only_wanted:
                found = search.from_tip()
                if isinstance(found, Path):
                    self._hold(found)
                    break
        changes.append(reason)
        if self._path is None:
            changes.append(NO_BACKUP)
            self._left_s = 0.0
            return min(search.choices(wanted), key=search.violation)
        changes.append(BACKUP)
        return self._search(flight, horizons_s[0]).continued()

    def _hold(self, path: Path) -> None:
        """Store a path as the one to continue where a wanted step is refused."""
        if path is not self._path:
            self._path, self._along_m, self._left_s = path, 0.0, path.lasts_s


def unusable(motion: Motion, discs: Discs, dt_s: float, slack_m: Sequence[float]) -> str | None:
    """Return NOT_FINITE or IMPOSSIBLE (a negative radius or speed, no positive step) for unusable input, else None."""
    if not math.isfinite(motion.north_m + motion.east_m + motion.heading_rad + motion.speed_m_s + dt_s + sum(slack_m)):
        return NOT_FINITE
    sizes = (motion.speed_m_s, min(discs.radii_m.tolist(), default=0.0), min(discs.speeds_m_s.tolist(), default=0.0))
    return IMPOSSIBLE if min(sizes) < 0.0 or dt_s <= 0.0 else None


def slack_m_of(motion: Motion, discs: Discs, dt_s: float) -> list[float]:
    """Return the vehicle's distance from each disc's edge, grown over the step; not finite where an input is not."""
    norths_m, easts_m = discs.centres_ned_m[:, 0] - motion.north_m, discs.centres_ned_m[:, 1] - motion.east_m
    slack_m: list[float] = (np.hypot(norths_m, easts_m) - (discs.radii_m + discs.speeds_m_s * dt_s)).tolist()
    return slack_m
