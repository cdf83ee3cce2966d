"""A vehicle that behaves as the guard assumes, reaction and wind included, and the scenes of the guard's tests."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from hypothesis import strategies as st

from companion.geo.kinematics import turn_towards
from companion.guard import arcs
from companion.guard.arcs import Path
from companion.guard.guard import Guard
from companion.guard.types import (
    FENCE,
    KEEP_OUT,
    NO_BACKUP,
    Discs,
    Limits,
    Motion,
    Piece,
    Setpoint,
    Verdict,
)

G_M_S2 = 9.80665

BAD = [math.nan, math.inf, -math.inf]

HAIR = 1e-8
"""Small length by which a scene is just allowed or just refused: far below the guard's own rounding allowance of 1e-6
m, far above the rounding errors here."""

PLANE = Limits(20.0, 20.0, 1.0, 50.0, 120.0, horizon_s=30.0)
"""Limits of a vehicle that cannot stop; its turning radius is 40.8 m, its step 10 m."""

COPTER = Limits(0.0, 20.0, 1.0, 50.0, 120.0, braking_m_s2=2.0, horizon_s=30.0)
"""Limits of a vehicle that can stop."""

DT_S = 0.5

RHO_M = 400.0 / G_M_S2
"""Turning radius of PLANE and COPTER at 20 m/s."""

NORTHWARD = Motion(0.0, 0.0, 0.0, 20.0)

AHEAD = Setpoint(0.0, 20.0, 100.0)

SPARE_M = 1e-6
"""The guard's own rounding allowance."""


def discs(*entries: tuple[float, float, float], speed_m_s: float = 0.0) -> Discs:
    """Return discs of (north, east, radius) in m, all with one speed."""
    table = np.array(entries, dtype=float).reshape(-1, 3)
    return Discs(table[:, :2], table[:, 2], np.full(len(table), speed_m_s))


NOTHING = discs()


def check(wanted: Setpoint, motion: Motion, around: Discs, limits: Limits, dt_s: float = DT_S) -> Verdict:
    """Return the verdict of a new guard on a setpoint."""
    return Guard(limits).check(wanted, motion, around, 0.0, dt_s)


def turn_rate_rad_s(speed_m_s: float, limits: Limits) -> float:
    return limits.rate_share * limits.n_max * G_M_S2 / max(speed_m_s, 0.5)


def turn_of(verdict: Verdict, motion: Motion) -> float:
    assert verdict.setpoint is not None
    return math.remainder(verdict.setpoint.heading_rad - motion.heading_rad, math.tau)


MOMENTS = 16
"""Number of positions that a vehicle returns for each time that it flies."""


def sent(verdict: Verdict) -> Setpoint:
    assert verdict.setpoint is not None
    return verdict.setpoint


def calm(_t_s: float) -> tuple[float, float]:
    return 0.0, 0.0


@dataclass
class Vehicle:
    """A vehicle that obeys a setpoint after the reaction time, drifts with the wind, and crabs to hold its course.

    It turns at the rate of the greater of its speeds before and after the setpoint. A vehicle that can stop slows down
    at its braking; any other change of speed is immediate.
    """

    start: Motion
    limits: Limits
    wind: Callable[[float], tuple[float, float]] = calm
    share: float = 1.0
    """Share of the guard's assumed turn rate at which the vehicle turns."""
    t_s: float = 0.0
    coming: list[tuple[float, Setpoint]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.north_m, self.east_m, self.speed_m_s = self.start.north_m, self.start.east_m, self.start.speed_m_s
        self.now: Setpoint | None = None
        self.nose_rad = self.crabbed(self.start.heading_rad)
        self.rate_rad_s = self.share * turn_rate_rad_s(self.speed_m_s, self.limits)

    def crabbed(self, course_rad: float) -> float:
        wind = self.wind(self.t_s)
        across_m_s = wind[1] * math.cos(course_rad) - wind[0] * math.sin(course_rad)
        return course_rad - math.asin(across_m_s / self.speed_m_s) if across_m_s else course_rad

    @property
    def motion(self) -> Motion:
        wind = self.wind(self.t_s)
        if wind == (0.0, 0.0):
            return Motion(self.north_m, self.east_m, self.nose_rad, self.speed_m_s)
        north_m_s = self.speed_m_s * math.cos(self.nose_rad) + wind[0]
        east_m_s = self.speed_m_s * math.sin(self.nose_rad) + wind[1]
        return Motion(self.north_m, self.east_m, math.atan2(east_m_s, north_m_s), math.hypot(north_m_s, east_m_s))

    def obey(self, setpoint: Setpoint) -> None:
        self.coming.append((self.limits.reaction_s, setpoint))

    def fly(self, dt_s: float) -> np.ndarray:  # (MOMENTS, 2) m
        """Fly for `dt_s`, and return the positions at evenly spaced moments."""
        places = []
        for _ in range(MOMENTS):
            left_s = dt_s / MOMENTS
            while left_s > 1e-12:
                while self.coming and self.coming[0][0] <= 1e-9:
                    self.take(self.coming.pop(0)[1])
                part_s = min([left_s, *(starts_s for starts_s, _ in self.coming[:1])])
                self.move(part_s)
                self.coming = [(starts_s - part_s, setpoint) for starts_s, setpoint in self.coming]
                left_s -= part_s
            places.append((self.north_m, self.east_m))
        return np.array(places)

    def take(self, setpoint: Setpoint) -> None:
        self.now = setpoint
        faster_m_s = max(self.speed_m_s, setpoint.speed_m_s)
        self.rate_rad_s = self.share * turn_rate_rad_s(faster_m_s, self.limits)
        self.speed_m_s = setpoint.speed_m_s if self.limits.braking_m_s2 is None else faster_m_s

    def move(self, dt_s: float) -> None:
        wanted_rad, mean_m_s = self.nose_rad, self.speed_m_s
        if self.now is not None:
            wanted_rad = self.crabbed(self.now.heading_rad)
            slowing_m_s2 = self.limits.braking_m_s2 or 0.0
            slower_m_s = max(self.now.speed_m_s, self.speed_m_s - slowing_m_s2 * dt_s)
            lost_m_s = self.speed_m_s - slower_m_s
            mean_m_s = slower_m_s + (lost_m_s * lost_m_s / slowing_m_s2 / dt_s / 2.0 if lost_m_s else 0.0)
            self.speed_m_s = slower_m_s
        at = (self.north_m, self.east_m, self.nose_rad)
        self.north_m, self.east_m, self.nose_rad = turn_towards(*at, mean_m_s, wanted_rad, self.rate_rad_s, dt_s)
        wind = self.wind(self.t_s)
        self.north_m, self.east_m, self.t_s = (
            self.north_m + wind[0] * dt_s,
            self.east_m + wind[1] * dt_s,
            self.t_s + dt_s,
        )


def gusts(rng: np.random.Generator, bound_m_s: float) -> Callable[[float], tuple[float, float]]:
    """Return a wind that never exceeds a bound: a mean, and gusts that change over ten seconds."""
    share, turned_rad = rng.uniform(), rng.uniform(0.0, math.tau)
    mean = bound_m_s * share * np.array([math.cos(turned_rad), math.sin(turned_rad)])
    bearings_rad = rng.uniform(0.0, math.tau, 200)
    drawn = bound_m_s * (1.0 - share) * np.sqrt(rng.uniform(size=(200, 1)))
    drawn = drawn * np.column_stack([np.cos(bearings_rad), np.sin(bearings_rad)])

    def at(t_s: float) -> tuple[float, float]:
        index, part = int(t_s // 10.0) % 199, t_s / 10.0 % 1.0
        wind = mean + (1.0 - part) * drawn[index] + part * drawn[index + 1]
        return float(wind[0]), float(wind[1])

    return at


def apart_m(places: np.ndarray, scene: Discs) -> float:
    """Return the least distance of any place from the edge of a disc, in m."""
    away = places[:, None, :] - scene.centres_ned_m
    return float(np.min(np.hypot(away[..., 0], away[..., 1]) - scene.radii_m, initial=math.inf))


def assert_refused_from(
    edge_m: float, scene: Callable[[float], Verdict], reason: str = KEEP_OUT, hair_m: float = HAIR
) -> None:
    """Assert that a scene of variable length is accepted below an edge and refused for the reason above it."""
    assert scene(edge_m - hair_m).changes == ()
    assert scene(edge_m + hair_m).changes[:1] == (reason,)


def lone(north_m: float, east_m: float, limits: Limits = PLANE, **wanted: float) -> Callable[[float], Verdict]:
    """Return the verdict on a step northward as a function of the radius of a single disc that stands still."""
    return lambda radius_m: check(replace(AHEAD, **wanted), NORTHWARD, discs((north_m, east_m, radius_m)), limits)


def box(north_m: float, east_m: float = 1e3) -> tuple[tuple[float, float], ...]:
    """Return a box that ends `north_m` ahead and `east_m` to the right of the origin, and 1 km off elsewhere."""
    return ((-1e3, -1e3), (north_m, -1e3), (north_m, east_m), (-1e3, east_m))


PIECES = st.builds(
    Piece,
    st.floats(-40.0, 40.0),
    st.floats(-40.0, 40.0),
    st.floats(-7.0, 7.0),
    st.just(0.0) | st.floats(0.01, 0.5) | st.floats(-0.5, -0.01),
    st.floats(0.1, 60.0),
)


def along(piece: Piece, count: int = 2001) -> np.ndarray:
    """Return points of a piece by summing its chords, independently of the guard's own method."""
    shares = (np.arange(count - 1) + 0.5) / (count - 1)
    headings_rad = piece.heading_rad + piece.curvature_1_m * piece.length_m * shares
    steps = np.column_stack([np.cos(headings_rad), np.sin(headings_rad)]) * piece.length_m / (count - 1)
    return np.vstack([np.zeros(2), np.cumsum(steps, axis=0)]) + (piece.north_m, piece.east_m)


def inside_polygon(places: np.ndarray, fence: Sequence[tuple[float, float]]) -> bool:
    """Return whether all places are inside a fence, by winding number, independently of the guard's own method."""
    corners = np.array(fence)[None, :, :] - places[:, None, :]
    ahead = np.roll(corners, -1, axis=1)
    cross = corners[..., 0] * ahead[..., 1] - corners[..., 1] * ahead[..., 0]
    dot = np.sum(corners * ahead, axis=-1)
    return bool(np.all(np.abs(np.sum(np.arctan2(cross, dot), axis=1)) > 1.0))


def wicked(rng: np.random.Generator, motion: Motion, limits: Limits, at: np.ndarray) -> Setpoint:
    """Return an adversary's setpoint: towards a disc or a place, grazing it, or anything at all, NaN included."""
    kind = rng.integers(7)
    away = at - (motion.north_m, motion.east_m)
    bearing_rad = math.atan2(away[1], away[0])
    heading_rad = {
        0: rng.uniform(-10.0, 10.0),
        1: motion.heading_rad,
        2: bearing_rad + rng.choice([-0.5, 0.5]) * math.pi,
        3: motion.heading_rad + rng.choice([-2.5, 2.5]),
    }.get(int(kind), bearing_rad)
    speed_m_s = rng.choice(
        [limits.speed_min_m_s, limits.speed_max_m_s, motion.speed_m_s, rng.uniform(-5.0, 1.2 * limits.speed_max_m_s)]
    )
    if rng.random() < 0.02:
        heading_rad = math.nan
    return Setpoint(float(heading_rad), float(speed_m_s), 100.0)


@dataclass(frozen=True)
class World:
    limits: Limits
    dt_s: float
    side_m: float
    discs: int
    radius_m: float
    """Greatest radius of a disc; the least is a tenth of it."""
    threat_share: float = 0.0
    """Speed at which each disc flies straight at the vehicle, as a share of the vehicle's greatest speed."""
    standing: int = 0
    """Number of discs that stand still all the same."""


FLAT_OUT = Limits(30.0, 30.0, 1.0, 50.0, 120.0)
"""Limits of a vehicle that flies at one speed."""

RHO_S = 30.0 / G_M_S2
"""Turning radius over speed of FLAT_OUT: the time in which it turns by one radian."""

STAR = ((-700.0, -700.0), (-100.0, 0.0), (-700.0, 700.0), (0.0, 150.0), (700.0, 700.0), (500.0, 0.0), (700.0, -700.0))

WORLDS = {
    "one speed": World(FLAT_OUT, 0.5, 1500.0, 25, 120.0),
    "reaction": World(replace(FLAT_OUT, reaction_s=0.1 * RHO_S), 0.5, 1500.0, 25, 120.0),
    "slow reaction": World(replace(FLAT_OUT, reaction_s=0.3 * RHO_S), 0.5, 1500.0, 16, 120.0),
    "very slow reaction": World(replace(FLAT_OUT, reaction_s=RHO_S), 0.5, 1800.0, 8, 200.0),
    "poor turns": World(replace(FLAT_OUT, rate_share=0.6), 0.5, 1500.0, 16, 120.0),
    "many speeds": World(replace(FLAT_OUT, speed_min_m_s=12.0), 0.5, 1500.0, 25, 120.0),
    "quick turns": World(replace(FLAT_OUT, speed_min_m_s=5.0, n_max=3.0), 1.0, 700.0, 25, 60.0),
    "the paper's step": World(Limits(60.0, 60.0, 10.0, 50.0, 120.0), 5.0, 6000.0, 25, 500.0),
    "the paper's step with a reaction": World(
        Limits(60.0, 60.0, 10, 50.0, 120.0, reaction_s=0.6), 5.0, 6000.0, 12, 500.0
    ),
    "fence": World(replace(FLAT_OUT, fence_ned_m=STAR, speed_min_m_s=20.0), 0.5, 1400.0, 8, 80.0),
    "stops": World(Limits(0.0, 20.0, 0.5, 50.0, 120.0, 3.0), 0.5, 500.0, 25, 50.0),
    "stops at a fence": World(Limits(0.0, 20.0, 0.5, 50.0, 120.0, 3.0, STAR), 0.5, 1400.0, 8, 80.0),
    "stops dead": World(Limits(0.0, 10.0, 0.25, 50.0, 120.0, 50.0), 0.5, 150.0, 25, 15.0),
    "wind": World(replace(FLAT_OUT, wind_m_s=10.0), 0.5, 2000.0, 12, 150.0),
    "wind and reaction": World(replace(FLAT_OUT, wind_m_s=10.0, reaction_s=0.8), 0.5, 2000.0, 12, 150.0),
    "chased": World(FLAT_OUT, 0.5, 1500.0, 10, 80.0, threat_share=0.2),
    "chased among standing discs": World(FLAT_OUT, 0.5, 1200.0, 12, 120.0, threat_share=0.2, standing=9),
    "hunted": World(replace(FLAT_OUT, reaction_s=0.3 * RHO_S), 0.5, 3000.0, 3, 200.0, threat_share=0.5),
    "hunted closely": World(FLAT_OUT, 0.5, 3000.0, 1, 300.0, threat_share=0.7),
    "chased in wind": World(replace(FLAT_OUT, wind_m_s=6.0), 0.5, 1200.0, 3, 100.0, threat_share=0.3),
}


def flown_against(world: World, seed: int, steps: int) -> tuple[int, int, float]:
    """Fly steps against an adversary in one random scene; return the steps refused, the steps flown and the least room.

    The room is the distance to a disc's edge in m. Asserts that the guard never lacks a path, that it reports no
    assumption as broken, and that no moment of the flight is inside a disc or outside the fence. No steps are flown
    where twenty random starts were not certified.
    """
    rng = np.random.default_rng(seed)
    limits = world.limits
    wind = gusts(rng, limits.wind_m_s) if limits.wind_m_s else calm
    speeds_m_s = np.full(world.discs, world.threat_share * limits.speed_max_m_s)
    speeds_m_s[: world.standing] = 0.0
    for _ in range(20):
        centres = rng.uniform(-world.side_m / 2.0, world.side_m / 2.0, (world.discs, 2))
        scene = Discs(centres, world.radius_m * rng.uniform(0.1, 1.0, world.discs), speeds_m_s)
        place = rng.uniform(-world.side_m / 2.0, world.side_m / 2.0, 2)
        speed_m_s = float(rng.uniform(limits.speed_min_m_s, limits.speed_max_m_s))
        vehicle = Vehicle(Motion(float(place[0]), float(place[1]), float(rng.uniform(-4, 4)), speed_m_s), limits, wind)
        if Guard(limits).certify(vehicle.motion, scene, world.dt_s):
            break
    else:
        return 0, 0, math.inf
    guarded, refused, at, room_m = Guard(limits), 0, np.zeros(2), math.inf
    for step in range(steps):
        if step % 25 == 0:
            aimed = rng.random() < 0.7
            at = scene.centres_ned_m[rng.integers(world.discs)] if aimed else rng.uniform(-1, 1, 2) * world.side_m
        wanted = wicked(rng, vehicle.motion, limits, at)
        verdict = guarded.check(wanted, vehicle.motion, scene, step * world.dt_s, world.dt_s)
        assert NO_BACKUP not in verdict.changes and verdict.certified_s == math.inf
        assert verdict.broken == ()
        assert_hangs_together(guarded._path)
        refused += KEEP_OUT in verdict.changes or FENCE in verdict.changes
        vehicle.obey(sent(verdict))
        places = vehicle.fly(world.dt_s)
        scene, moment_m = chased(scene, places, world.dt_s)
        room_m = min(room_m, moment_m)
        assert room_m > 0.0
        assert limits.fence_ned_m is None or inside_polygon(places, limits.fence_ned_m)
    return refused, steps, room_m


def chased(scene: Discs, places: np.ndarray, dt_s: float) -> tuple[Discs, float]:
    """Return the discs after each chased the vehicle along its places, and how near the nearest edge came, in m."""
    centres, room_m = scene.centres_ned_m, math.inf
    for place in places:
        towards = place - centres
        far_m = np.hypot(towards[:, 0], towards[:, 1])
        flown_m = np.minimum(scene.speeds_m_s * dt_s / len(places), far_m)
        centres = centres + towards * (flown_m / np.maximum(far_m, 1e-9))[:, None]
        room_m = min(room_m, float(np.min(np.hypot(*(place - centres).T) - scene.radii_m)))
    return replace(scene, centres_ned_m=centres), room_m


def assert_hangs_together(path: Path | None) -> None:
    """Assert that each piece of a path begins where the one before it ends, and that its loop closes."""
    if path is None:
        return
    after = [*path.pieces[1:], *path.pieces[len(path.pieces) - path.loops :][: path.loops and 1]]
    for piece, following in zip(path.pieces, after, strict=False):
        north_m, east_m, heading_rad = arcs.end_of(piece)
        assert math.dist((north_m, east_m), following[:2]) < 1e-6
        assert abs(math.remainder(heading_rad - following.heading_rad, math.tau)) < 1e-6
