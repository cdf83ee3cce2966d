"""The search for a back-up: which step may be taken, and on which path the vehicle stays clear after it.

A search is made for one decision. It reads the flight situation and the path that the guard has stored ("the stored
path"), and changes neither.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from companion.guard.arcs import (
    TURN_TOLERANCE_RAD,
    Disc,
    Path,
    Pose,
    end_of,
    fan_rad,
    is_clear,
    is_hit,
    nearest_along_m,
    pose_at,
    straight,
    turned,
)
from companion.guard.fence import Fence
from companion.guard.follow import discs_near, next_stretch
from companion.guard.types import FENCE, KEEP_OUT, PIVOT_SPEED_M_S, Piece
from companion.guard.vehicle import GREATEST_TURN_RAD, Step, VehicleModel

MOST_STRETCHES = 400
"""Number of stretches along the route (steps on arcs, and whole straight lines) within which a way on must be clear."""
OFF_ROUTE_STEPS = 3.0
"""Number of steps that a vehicle may be off the route at the beginning of a stretch for discs far from the route not to
matter to it: one that cannot follow the route may meet any disc."""
NEAR_ROUTE_STEPS = 6.0
"""Number of steps, beyond a turning circle, within which a disc is near the route: OFF_ROUTE_STEPS, one that is flown,
and up to two across a rounded square (`VehicleModel.circle`)."""
CIRCLE_PARTS = 24
"""Number of places, per circumference of the turning circle flown along the route, at which a clear one is tried."""
FOLLOW_RAD = 0.01
"""Difference of turns up to which a wanted step counts as following the stored path, so that no other is searched."""
SLOWER_SHARES = (0.5, 0.25, 0.125)
"""Shares of the wanted speed at which a vehicle that can stop is offered the wanted turn: with less way to brake, it
may pass where it could not at full speed."""
FENCE_TRIES = 8
"""Number of clear headings of the fan that are compared with fence and exclusions, the mildest turns first."""
SAMPLES = 8
"""Number of sample points per step at which the choices are compared when none is certified."""


class Flight(NamedTuple):
    """The flight situation that one call of the guard decides on."""

    tip: Pose
    """The pose at which the next command begins to act."""
    before_m_s: float
    """The airspeed at the tip."""
    ground_m_s: float
    """The reported ground speed."""
    dt_s: float
    near: list[Disc]
    """The discs that can matter to the step and a turning circle after it; all discs where any of them moves."""
    discs: list[Disc]
    """All discs, as large as they are at the tip and inflated by `inflation_m`."""
    moving: bool
    """Whether any disc moves."""
    route: Sequence[Piece]
    attack_m: list[float] | None
    """The attack radii in the order of `discs`, grown and inflated likewise; None where none are given."""
    inflation_m: float
    """How far the vehicle may be off the path that it is commanded to fly."""
    sides: tuple[float, ...] = (1.0, -1.0)
    """Turning circles that may serve as back-up, in order of preference: 1.0 to the right, -1.0 to the left."""


class BackupSearch:
    """Finds the steps and back-up paths that are clear, for one decision; it does not change the guard."""

    def __init__(
        self,
        vehicle: VehicleModel,
        fence: Fence | None,
        flight: Flight,
        horizon_s: float,
        path: Path | None,
        along_m: float,
    ) -> None:
        """Prepare the search for one flight situation.

        A path needs to be clear for `horizon_s`, which is infinite for one that is clear for ever, or where all discs
        stand still. `path` is the stored path, and
        `along_m` the distance along it at which the tip is.
        """
        self._vehicle, self._limits, self._fence = vehicle, vehicle.limits, fence
        self._flight, self._horizon_s = flight, horizon_s
        self._path, self._along_m = path, along_m

    def choices(self, wanted: Step) -> Iterator[Step]:
        """Yield the wanted step, then other turns, nearest to it first; then the same turns at the present speed.

        A vehicle that can stop is first offered the wanted turn at lower speeds, and last the step straight on to a
        stop.
        """
        flight = self._flight
        yield wanted
        if self._limits.braking_m_s2 is not None:
            for share in SLOWER_SHARES:
                yield Step(wanted.turn_rad, wanted.speed_m_s * share)
        flown_m_s = self._vehicle.allowed_m_s(flight.before_m_s)
        for speed_m_s in dict.fromkeys((wanted.speed_m_s, flown_m_s)):
            most_rad = self._vehicle.greatest_turn_rad(speed_m_s, flight.before_m_s, flight.dt_s)
            turns_rad = (0.5 * wanted.turn_rad, 0.0, most_rad, -most_rad)
            for turn_rad in sorted(turns_rad, key=lambda turn_rad: abs(turn_rad - wanted.turn_rad)):
                yield Step(turn_rad, speed_m_s)
        if self._limits.braking_m_s2 is not None:
            yield Step(0.0, 0.0)

    def accepted(self, step: Step, thorough: bool) -> Path | str:
        """Return a path that begins with the step, if the step and a back-up after it are clear, or why there is none.

        With `thorough` the route and the whole fan of headings are tried too.
        """
        flight = self._flight
        pieces, after_m_s = self._vehicle.step_pieces(
            flight.tip, step, flight.before_m_s, flight.ground_m_s, flight.dt_s
        )
        spare_m = self.spare_m(step)
        if not flight.moving or self._limits.braking_m_s2 is not None:
            blocked = self.blocked(pieces, flight.near, flight.dt_s, spare_m)
        elif not is_clear(pieces, flight.near, step.speed_m_s - self._limits.wind_m_s, 0.0, spare_m):
            blocked = KEEP_OUT
        else:
            blocked = self.outside(pieces, spare_m)
        if blocked is not None:
            return blocked
        found = self.backup(end_of(pieces[-1]), step, after_m_s, flight.dt_s, spare_m, thorough)
        if isinstance(found, str) and self._path is not None and self.continues(step):
            return self._path
        if isinstance(found, str) and thorough and flight.route:
            found = self.along_route(end_of(pieces[-1]), step, flight.dt_s, spare_m) or found
        if isinstance(found, str):
            return found
        return found._replace(pieces=pieces + found.pieces)

    def follows(self, wanted: Step) -> bool:
        """Return whether the wanted step is within FOLLOW_RAD of the stored path, and all discs stand still."""
        if self._path is None or self._flight.moving:
            return False
        held = self.continued()
        return abs(held.turn_rad - wanted.turn_rad) <= FOLLOW_RAD and held.speed_m_s == wanted.speed_m_s

    def continues(self, step: Step) -> bool:
        """Return whether a step continues the stored path, but for rounding."""
        held = self.continued()
        return abs(held.turn_rad - step.turn_rad) <= TURN_TOLERANCE_RAD and held.speed_m_s == step.speed_m_s

    def continued(self) -> Step:
        """Return the step that continues the stored path."""
        flight, path = self._flight, self._path
        assert path is not None
        if path.speed_m_s == 0.0:
            turn_rad = math.remainder(path.pieces[-1].heading_rad - flight.tip.heading_rad, math.tau)
            most_rad = self._vehicle.greatest_turn_rad(0.0, flight.before_m_s, flight.dt_s)
            return Step(min(max(turn_rad, -most_rad), most_rad), 0.0)
        ground_m_s = flight.ground_m_s if self._limits.wind_m_s > 0.0 else path.speed_m_s
        return Step(
            self._vehicle.steered_rad(
                path,
                self._along_m,
                flight.tip,
                ground_m_s,
                flight.dt_s,
                0.0 if self._limits.wind_m_s == 0.0 else flight.dt_s,
            ),
            path.speed_m_s,
        )

    def from_tip(self) -> Path | str:
        """Return a certified path that begins at the tip, without a step before it, or why there is none."""
        flight = self._flight
        step = Step(0.0, self._vehicle.allowed_m_s(flight.before_m_s))
        return self.backup(flight.tip, step, flight.before_m_s, 0.0, 0.0)

    def spare_m(self, step: Step) -> float:
        """Return how far a change of speed during the step may put the vehicle off its path; 0 at a constant speed."""
        flight = self._flight
        change_m = abs(flight.before_m_s - step.speed_m_s) * flight.dt_s
        return change_m if self._limits.braking_m_s2 is None else change_m * abs(step.turn_rad)

    def backup(
        self,
        pose: Pose,
        step: Step,
        speed_m_s: float,
        after_s: float,
        spare_m: float,
        thorough: bool = True,
    ) -> Path | str:
        """Return a certified path from a pose that the vehicle reaches after `after_s`, or why there is none."""
        flight = self._flight
        lasts_s = after_s + self._horizon_s
        reason = KEEP_OUT
        if math.isfinite(lasts_s) or not flight.moving:
            grown_s = lasts_s if flight.moving else 0.0
            found = self.to_rest(pose, step, speed_m_s, flight.near, grown_s, spare_m)
            if isinstance(found, Path):
                return found._replace(lasts_s=lasts_s)
            reason = found
        if flight.moving:
            ray = self.ray(pose, step.speed_m_s, after_s, spare_m, thorough)
            if ray is not None:
                return Path(ray, 0, step.speed_m_s, lasts_s)
        return reason

    def to_rest(
        self,
        pose: Pose,
        step: Step,
        speed_m_s: float,
        discs: list[Disc],
        grown_s: float,
        spare_m: float,
    ) -> Path | str:
        """Return a clear path that brakes to a stop or, if the vehicle cannot stop, circles for ever; or why none is.

        Circles are tried in the order of `Flight.sides`.
        """
        if self._limits.braking_m_s2 is not None:
            line = (straight(pose, speed_m_s * speed_m_s / (2.0 * self._limits.braking_m_s2)),)
            return self.blocked(line, discs, grown_s, spare_m) or Path(line, 0, 0.0, math.inf)
        blocked: str | None = None
        for side in self._flight.sides:
            loop = self._vehicle.circle(pose, side, step.speed_m_s, self._flight.dt_s)
            blocked = self.blocked(loop, discs, grown_s, spare_m)
            if blocked is None:
                return Path(loop, len(loop), step.speed_m_s, math.inf)
        return str(blocked)

    def along_route(self, pose: Pose, step: Step, after_s: float, spare_m: float) -> Path | None:
        """Return a path along the route to the first place from which a way on is clear; None if there is none.

        The way on is a turning circle or, among moving discs, a ray. `after_s` is the time at which the vehicle is at
        the pose. The path is what `companion/guard/follow.py` predicts, so it is exact, however narrow the way.
        """
        flight = self._flight
        # Who can stop does so; at rest it has no turning circle either.
        if self._limits.braking_m_s2 is not None:
            return None
        pieces_of_route = tuple(flight.route)
        rate_1_m = self._vehicle.curvature_1_m(step.speed_m_s)
        # No way on need be clear where the route ends: one may be clear straight on from there.
        pieces_of_route += (straight(end_of(pieces_of_route[-1]), math.tau / rate_1_m),)
        finite = all(map(math.isfinite, itertools.chain(*pieces_of_route)))
        if not finite:
            return None
        step_m = step.speed_m_s * flight.dt_s
        route = Path(pieces_of_route, 0, step.speed_m_s, math.inf)
        along_m = nearest_along_m(route, pose)
        left_m = sum(stretch.length_m for stretch in route.pieces) - along_m
        reach_m = 2.0 / rate_1_m + NEAR_ROUTE_STEPS * step_m + spare_m
        near = flight.discs if flight.moving else discs_near(route.pieces, flight.discs, reach_m)
        around = math.ceil(math.tau / (rate_1_m * step_m))
        every = max(1, around // CIRCLE_PARTS)
        flown: list[Piece] = []
        for count in range(1, MOST_STRETCHES + 1):
            stretch = next_stretch(self._vehicle, route, along_m, pose, flight.dt_s)
            off_m = math.dist(pose[:2], pose_at(route, along_m)[:2])
            discs = near if off_m <= OFF_ROUTE_STEPS * step_m else flight.discs
            if self._enters(stretch.pieces, discs, step, after_s, spare_m):
                return None
            flown += stretch.pieces
            left_m -= stretch.steps * step_m
            # The wind may slow it all the way, while the discs grow.
            after_s += stretch.steps * step_m / (step.speed_m_s - self._limits.wind_m_s)
            along_m, pose = stretch.along_m, end_of(stretch.pieces[-1])
            if stretch.steps == 1 and count % every and left_m > 0.0:
                continue
            onward = self._way_on(pose, step, discs, after_s, spare_m, left_m <= 0.0)
            if onward is not None:
                return onward._replace(pieces=(*flown, *onward.pieces))
            if left_m <= 0.0:
                return None
        return None

    def _enters(self, pieces: Sequence[Piece], discs: list[Disc], step: Step, after_s: float, spare_m: float) -> bool:
        """Return whether pieces flown from a time on come too near to a disc or the fence."""
        if not self._flight.moving:
            return self.blocked(pieces, discs, 0.0, spare_m) is not None
        slow_m_s = step.speed_m_s - self._limits.wind_m_s
        clear = slow_m_s >= PIVOT_SPEED_M_S and is_clear(pieces, discs, slow_m_s, after_s, spare_m)
        return not clear or self.outside(pieces, spare_m) is not None

    def _way_on(
        self, pose: Pose, step: Step, discs: list[Disc], after_s: float, spare_m: float, thorough: bool
    ) -> Path | None:
        """Return a clear turning circle from a pose on the route or, among moving discs, a clear ray; or None."""
        if not self._flight.moving:
            circle = self.to_rest(pose, step, step.speed_m_s, discs, 0.0, spare_m)
            return circle if isinstance(circle, Path) else None
        ray = self.ray(pose, step.speed_m_s, after_s, spare_m, thorough)
        if ray is None:
            return None
        return Path(ray, 0, step.speed_m_s, after_s + self._horizon_s)

    def ray(
        self,
        pose: Pose,
        speed_m_s: float,
        after_s: float,
        spare_m: float,
        thorough: bool,
    ) -> tuple[Piece, ...] | None:
        """Return an arc and a straight line after it that no moving disc reaches; None if there is none."""
        flight = self._flight
        slow_m_s = speed_m_s - self._limits.wind_m_s
        if slow_m_s < PIVOT_SPEED_M_S:
            return None
        curvature_1_m = self._vehicle.curvature_1_m(speed_m_s)
        length_m = slow_m_s * self._horizon_s
        if self._fence is not None and length_m > self._fence.longest_m:
            return None
        coarse = speed_m_s * flight.dt_s * curvature_1_m > GREATEST_TURN_RAD
        for heading_rad in self.likely_headings_rad(pose, flight.discs):
            turn_rad = math.remainder(heading_rad - pose.heading_rad, math.tau)
            if coarse and abs(turn_rad) > GREATEST_TURN_RAD:
                continue
            pieces = turned(pose, turn_rad, curvature_1_m, length_m)
            # The straight line fails most often, so it is checked first.
            turned_s = after_s + abs(turn_rad) / (curvature_1_m * slow_m_s)
            clear = is_clear(pieces[-1:], flight.discs, slow_m_s, turned_s, spare_m) and is_clear(
                pieces[:-1], flight.discs, slow_m_s, after_s, spare_m
            )
            if clear and self.outside(pieces, spare_m) is None:
                return pieces
        if not thorough:
            return None
        most_rad = GREATEST_TURN_RAD if coarse else math.tau
        table = np.array(flight.discs)
        table[:, 2] += table[:, 3] * after_s + spare_m
        turns_rad = fan_rad(pose, curvature_1_m, length_m, slow_m_s, table, most_rad)
        for turn_rad in turns_rad[:FENCE_TRIES]:
            pieces = turned(pose, turn_rad, curvature_1_m, length_m)
            if self.outside(pieces, spare_m) is None:
                return pieces
        return None

    def likely_headings_rad(self, pose: Pose, discs: Iterable[Disc]) -> Iterator[float]:
        """Yield the heading straight on, that of the stored path's final line, and that away from the nearest disc."""
        yield pose.heading_rad
        if self._path is not None and self._path.loops == 0:
            yield self._path.pieces[-1].heading_rad
        north_m, east_m, _, _ = min(discs, key=lambda disc: math.dist(disc[:2], pose[:2]) - disc[2])
        yield math.atan2(pose.east_m - east_m, pose.north_m - north_m)

    def blocked(
        self, pieces: Sequence[Piece], discs: Iterable[Disc], grown_s: float, spare_m: float = 0.0
    ) -> str | None:
        """Return KEEP_OUT if a piece enters a disc grown for `grown_s`, FENCE if one violates the fence, else None."""
        if any(is_hit(piece, discs, grown_s, spare_m) for piece in pieces):
            return KEEP_OUT
        return self.outside(pieces, spare_m)

    def outside(self, pieces: Iterable[Piece], spare_m: float) -> str | None:
        """Return FENCE if a piece leaves the fence or comes too near to it, else None."""
        if self._fence is None or self._fence.holds(pieces, self._flight.inflation_m + spare_m):
            return None
        return FENCE

    def violation(self, step: Step) -> tuple[float, ...]:
        """Return the depths by which steps are ranked when none is certified, least first; six numbers in metres.

        They are the depth inside an attack disc, the distance outside the fence and the depth inside a disc (negative
        outside): first the greatest over the step and as long again straight on, then those at the end of it, which
        distinguish between the ways out.
        """
        flight = self._flight
        pieces, _ = self._vehicle.step_pieces(flight.tip, step, flight.before_m_s, flight.ground_m_s, flight.dt_s)
        path = Path((*pieces, straight(end_of(pieces[-1]), step.speed_m_s * flight.dt_s)), 0, step.speed_m_s, 0.0)
        length_m = sum(piece.length_m for piece in path.pieces)
        shares = np.linspace(0.0, 1.0, 2 * SAMPLES + 1)
        places = np.array([pose_at(path, share * length_m)[:2] for share in shares.tolist()])
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
