"""The guard's model of how the vehicle flies, from its limits alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from companion.guard.arcs import TURN_TOLERANCE_RAD, Path, Pose, end_of, pose_at, pose_of, seen_from, straight
from companion.guard.types import (
    ALTITUDE,
    NOT_FINITE,
    PIVOT_SPEED_M_S,
    ROUNDING_M,
    SPEED,
    TRACKING_REACTIONS,
    TRACKING_STEPS,
    TURN,
    Limits,
    Motion,
    Piece,
    Setpoint,
)

STANDARD_GRAVITY_M_S2 = 9.80665
"""Standard gravity (3rd CGPM, 1901). companion/geo/kinematics.py defines it as well, because the guard shares no code
with the guidance that it checks."""
GREATEST_TURN_RAD = 3.0
"""Greatest turn of one step, less than pi so that the vehicle's shorter side is the side that was checked."""
HORIZON_TURNS = (64.0, 8.0, 1.0)
"""Multiples of the time to turn around and stop for which a path is certified where none is for ever, the longest
first (docs/guard.md, Horizon)."""
LEAST_ARC_M = 1e-9
"""Length up to which an arc counts as a turn on the spot."""
POSITION_TOLERANCE_M = 0.1
"""Distance by which a reported position may differ from the expected one in addition to the bounds in Limits: telemetry
resolves 1 cm and 1 cm/s. Chosen, not measured."""
CLOSING_STEPS = 2.0
"""Number of steps in which the vehicle is steered back onto the path that wind has blown it off."""


class Command(NamedTuple):
    """A setpoint that was sent, and the time until it begins to act, `starts_s` (negative: it acts already)."""

    starts_s: float
    heading_rad: float
    speed_m_s: float


class Step(NamedTuple):
    """A choice for the next step: a turn (positive: to the right) and then straight flight, both at one speed."""

    turn_rad: float
    speed_m_s: float


class VehicleModel:
    """The motion of one vehicle as its limits describe it; it stores no state of a flight."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._load_m_s2 = limits.rate_share * limits.n_max * STANDARD_GRAVITY_M_S2

    def horizons_s(self) -> tuple[float, ...]:
        """Return for how long a path must stay clear where none does for ever, the longest first.

        They are multiples of the time that the vehicle needs to turn once around and to stop, unless the limits say how
        long.
        """
        limits = self.limits
        if limits.horizon_s is not None:
            return (limits.horizon_s,)
        around_s = math.tau / self.rate_rad_s(limits.speed_max_m_s + limits.wind_m_s)
        stopping_s = 0.0 if limits.braking_m_s2 is None else limits.speed_max_m_s / limits.braking_m_s2
        return tuple(count * (limits.reaction_s + around_s + stopping_s) for count in HORIZON_TURNS)

    def curvature_1_m(self, speed_m_s: float) -> float:
        """Return the curvature of the turning circle over the ground at an airspeed, flown down the greatest wind."""
        return self._load_m_s2 / (speed_m_s + self.limits.wind_m_s) ** 2

    def allowed_m_s(self, speed_m_s: float) -> float:
        """Return the speed within the limits that is nearest to the given one."""
        return min(max(speed_m_s, self.limits.speed_min_m_s), self.limits.speed_max_m_s)

    def rate_rad_s(self, speed_m_s: float) -> float:
        """Return the greatest turn rate at a speed."""
        return self._load_m_s2 / max(speed_m_s, PIVOT_SPEED_M_S)

    def greatest_turn_rad(self, speed_m_s: float, before_m_s: float, dt_s: float) -> float:
        """Return the greatest turn of one step, at the greater of the speeds before and during it."""
        return min(self.rate_rad_s(max(speed_m_s, before_m_s)) * dt_s, GREATEST_TURN_RAD)

    def tolerance_m(self) -> float:
        """Return how far apart two reports of the same position may be."""
        return 2.0 * self.limits.position_error_m + POSITION_TOLERANCE_M

    def tracking_m(self, dt_s: float) -> float:
        """Return how far the greatest wind may blow the vehicle off its path (see TRACKING_STEPS)."""
        return self.limits.wind_m_s * (TRACKING_STEPS * dt_s + TRACKING_REACTIONS * self.limits.reaction_s)

    def inflation_m(self, dt_s: float) -> float:
        """Return how far the vehicle may be off its commanded path, which every disc is inflated by."""
        limits = self.limits
        return ROUNDING_M + limits.position_error_m + self.tracking_m(dt_s)

    def reach_m(self, motion: Motion, before_m_s: float, step: Step, dt_s: float) -> float:
        """Return the distance beyond which a standing disc matters neither to a step nor to a back-up after it."""
        faster_m_s = max(before_m_s, step.speed_m_s, motion.speed_m_s) + self.limits.wind_m_s
        if self.limits.braking_m_s2 is None:
            path_m = 2.0 / self.curvature_1_m(faster_m_s)
        else:
            path_m = faster_m_s * faster_m_s / (2.0 * self.limits.braking_m_s2)
        # Of the six steps, one is flown, up to four are the sides of a rounded square, and one is margin.
        return faster_m_s * (6.0 * dt_s + self.limits.reaction_s) + path_m + self.inflation_m(dt_s)

    def within_limits(
        self, wanted: Setpoint, tip: Pose, before_m_s: float, dt_s: float, changes: list[str]
    ) -> tuple[Step, float]:
        """Return the wanted step limited in speed and turn, and the altitude limited likewise.

        Appends to `changes` what was limited.
        """
        limits = self.limits
        heading_rad, speed_m_s, altitude_m = wanted.heading_rad, wanted.speed_m_s, wanted.altitude_m
        if not all(map(math.isfinite, (heading_rad, speed_m_s, altitude_m))):
            changes.append(NOT_FINITE)
            heading_rad, speed_m_s = tip.heading_rad, before_m_s
            altitude_m = (limits.altitude_min_m + limits.altitude_max_m) / 2.0
        allowed_m_s = self.allowed_m_s(speed_m_s)
        if allowed_m_s != speed_m_s:
            changes.append(SPEED)
        allowed_m = min(max(altitude_m, limits.altitude_min_m), limits.altitude_max_m)
        if allowed_m != altitude_m:
            changes.append(ALTITUDE)
        turn_rad = math.remainder(heading_rad - tip.heading_rad, math.tau)
        greatest_rad = self.greatest_turn_rad(allowed_m_s, before_m_s, dt_s)
        if abs(turn_rad) > greatest_rad + TURN_TOLERANCE_RAD:
            changes.append(TURN)
            turn_rad = math.copysign(greatest_rad, turn_rad)
        return Step(turn_rad, allowed_m_s), allowed_m

    def flown(self, motion: Motion, commands: Sequence[Command], duration_s: float) -> tuple[Pose, float]:
        """Return the pose and the airspeed that a motion reaches after `duration_s` under commands.

        Until the first command acts, the vehicle flies straight on.
        """
        pose, speed_m_s = pose_of(motion), motion.speed_m_s
        at_s = 0.0
        for index, command in enumerate(commands):
            if command.starts_s >= duration_s:
                break
            if command.starts_s > at_s:
                pose = end_of(straight(pose, speed_m_s * (command.starts_s - at_s)))
                at_s = command.starts_s
            ends_s = min(commands[index + 1].starts_s, duration_s) if index + 1 < len(commands) else duration_s
            if ends_s <= at_s:
                continue
            turn_rad = math.remainder(command.heading_rad - pose.heading_rad, math.tau)
            pieces, speed_m_s = self.step_pieces(
                pose, Step(turn_rad, command.speed_m_s), speed_m_s, motion.speed_m_s, ends_s - at_s
            )
            pose, at_s = end_of(pieces[-1]), ends_s
        if at_s < duration_s:
            pose = end_of(straight(pose, speed_m_s * (duration_s - at_s)))
        return pose, speed_m_s

    def step_pieces(
        self, pose: Pose, step: Step, before_m_s: float, ground_m_s: float, duration_s: float
    ) -> tuple[tuple[Piece, ...], float]:
        """Return the pieces flown in a step, an arc and a straight line, and the airspeed after it.

        With wind, a vehicle that cannot stop is assumed to keep the reported ground speed, `ground_m_s`, for the step.
        """
        faster_m_s, after_m_s = max(before_m_s, step.speed_m_s), step.speed_m_s
        flown_m = faster_m_s * duration_s
        rate_rad_s = self.rate_rad_s(faster_m_s)
        if self.limits.braking_m_s2 is not None:
            slowing_m_s = faster_m_s - step.speed_m_s
            braking_s = min(duration_s, slowing_m_s / self.limits.braking_m_s2)
            after_m_s = faster_m_s - self.limits.braking_m_s2 * braking_s
            lost_m_s = self.limits.braking_m_s2 * braking_s / 2.0
            flown_m = step.speed_m_s * duration_s + (slowing_m_s - lost_m_s) * braking_s
        elif self.limits.wind_m_s > 0.0:
            faster_m_s = ground_m_s
            flown_m = ground_m_s * duration_s
        turn_rad = math.copysign(min(abs(step.turn_rad), rate_rad_s * duration_s), step.turn_rad)
        arc_m = min(faster_m_s * abs(turn_rad) / rate_rad_s, flown_m)
        heading_rad = pose.heading_rad + turn_rad
        if arc_m <= LEAST_ARC_M:
            return (Piece(pose.north_m, pose.east_m, heading_rad, 0.0, flown_m),), after_m_s
        arc = Piece(*pose, turn_rad / arc_m, arc_m)
        end = end_of(arc)
        rest_m = flown_m - arc_m
        if rest_m <= 0.0:
            return (arc,), after_m_s
        return (arc, Piece(end.north_m, end.east_m, heading_rad, 0.0, rest_m)), after_m_s

    def circle(self, pose: Pose, side: float, speed_m_s: float, dt_s: float) -> tuple[Piece, ...]:
        """Return the turning circle; a square with rounded corners if a step of it would exceed GREATEST_TURN_RAD.

        `side` is 1.0 for the circle to the right and -1.0 for the one to the left.
        """
        curvature_1_m = self.curvature_1_m(speed_m_s)
        if speed_m_s * dt_s * curvature_1_m <= GREATEST_TURN_RAD:
            return (Piece(*pose, side * curvature_1_m, math.tau / curvature_1_m),)
        arc_m = math.pi / 2.0 / curvature_1_m
        pieces: list[Piece] = []
        for _ in range(4):
            pieces.append(Piece(*pose, side * curvature_1_m, arc_m))
            pieces.append(straight(end_of(pieces[-1]), speed_m_s * dt_s - arc_m))
            pose = end_of(pieces[-1])
        return tuple(pieces)

    def steered_rad(
        self, path: Path, along_m: float, pose: Pose, ground_m_s: float, dt_s: float, gain_s: float
    ) -> float:
        """Return the turn to the path's heading one step ahead; a positive `gain_s` also steers back onto the path."""
        ahead = pose_at(path, along_m + ground_m_s * dt_s)
        heading_rad = ahead.heading_rad
        if gain_s > 0.0:
            beside_m = seen_from(pose_at(path, along_m), pose)[1]
            heading_rad -= math.atan(beside_m / (CLOSING_STEPS * ground_m_s * (dt_s + self.limits.reaction_s)))
        turn_rad = math.remainder(heading_rad - pose.heading_rad, math.tau)
        most_rad = min(ground_m_s * dt_s * self.curvature_1_m(path.speed_m_s), GREATEST_TURN_RAD)
        if self.limits.wind_m_s > 0.0:
            most_rad = self.greatest_turn_rad(path.speed_m_s, path.speed_m_s, dt_s)
        return min(max(turn_rad, -most_rad), most_rad)
