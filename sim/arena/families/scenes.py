"""Geometry of the scenes in which the other families and the random missions are drawn: discs, fence, start and target.

A scene lies about its origin, start in the south, target in the north; it is turned and shifted afterwards
(`sim.arena.families.field`). Lengths follow from three of the mission: how far it is to the target, the vehicle's turn
radius, and the width of the gaps that are left. Nothing here makes sure that a vehicle can fly through.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sim.arena.families.drawing import NoRoomError, with_radius

LEAST_DISC_M, GREATEST_DISC_M = 20.0, 20_000.0
"""Least and greatest R_d of a scene's discs."""
GREATEST_COUNT = 400
"""Most discs of a scene."""
OVERLAP = 1.4
"""Distance between the centres of neighbouring discs of a wall, as a multiple of their radius: below 2 they overlap."""
TRIES = 200
"""Draws of one place before the scene is given up."""

Rectangle = tuple[float, float, float, float]
"""South, west, north and east edge, in m."""


@dataclass(frozen=True)
class Size:
    """The lengths from which a scene's own follow."""

    length_m: float
    """Straight line from start to target, about."""
    turn_m: float
    gap_m: float


@dataclass(frozen=True)
class Scene:
    """A scene for one agent."""

    discs_m: np.ndarray  # (M, 3) north, east, R_d
    start_m: np.ndarray  # (2,)
    target_m: np.ndarray  # (2,)
    heading_rad: float
    way_m: float
    """Length that a path round everything may have, about, from which the time limit follows."""
    fence_m: np.ndarray | None = None  # (V, 2)
    exclusions_m: tuple[np.ndarray, ...] = ()  # (V, 2) each


def open_field(generator: np.random.Generator, size: Size) -> Scene:
    """Return a scene of no or a few discs."""
    return _among(generator, size, int(generator.integers(0, 7)), (0.03, 0.15))


def scattered_discs(generator: np.random.Generator, size: Size) -> Scene:
    """Return a scene of 10 to 60 scattered discs that may overlap."""
    return _among(generator, size, int(generator.integers(10, 61)), (0.02, 0.08))


def crowd(generator: np.random.Generator, size: Size) -> Scene:
    """Return a scene of 100 to 400 small discs."""
    return _among(generator, size, int(generator.integers(100, GREATEST_COUNT + 1)), (0.008, 0.03))


def mixed_radii(generator: np.random.Generator, size: Size) -> Scene:
    """Return a scene whose discs differ in radius by as much as there is room for, at most from 20 m to 20 km."""
    greatest_m = min(GREATEST_DISC_M, 0.35 * size.length_m)
    least_m = min(LEAST_DISC_M, greatest_m)
    radii_m = np.exp(generator.uniform(math.log(least_m), math.log(greatest_m), int(generator.integers(8, 61))))
    radii_m[0] = greatest_m
    return _placed_between(generator, size, radii_m)


def lattice(generator: np.random.Generator, size: Size) -> Scene:
    """Return equal discs on a square or honeycomb lattice, the start before or within it."""
    radius_m = _disc_m(generator, size, (0.015, 0.06))
    pitch_m = 2 * radius_m + size.gap_m
    honeycomb = bool(generator.random() < 0.5)
    rows = max(2, min(20, round(0.4 * size.length_m / pitch_m)))
    columns = max(3, min(20, round(0.7 * size.length_m / pitch_m)))
    row_m = pitch_m * (math.sqrt(0.75) if honeycomb else 1.0)
    places_m = [
        ((row - rows / 2 + 0.5) * row_m, (column - columns / 2 + (0.75 if honeycomb and row % 2 else 0.25)) * pitch_m)
        for row in range(rows)
        for column in range(columns)
    ]
    discs_m = with_radius(np.array(places_m), radius_m)
    inside = bool(generator.random() < 0.4)
    start_m = _free_place(generator, discs_m, (0.0, 0.0), pitch_m) if inside else np.array([-0.5 * size.length_m, 0.0])
    target_m = np.array([0.5 * size.length_m, generator.uniform(-0.3, 0.3) * size.length_m])
    return _scene(generator, discs_m, (start_m, target_m), 2.0)


def rooms(generator: np.random.Generator, size: Size) -> Scene:
    """Return one to three rooms joined by corridors as wide as the gap, of any length; one may lead outside."""
    side_m = max(2.5 * size.gap_m, generator.uniform(4.0, 9.0) * size.turn_m, 2.5 * LEAST_DISC_M)
    spaces: list[Rectangle] = []
    centres_m = [np.zeros(2)]
    north_m = east_m = 0.0
    for room in range(int(generator.integers(1, 4))):
        spaces.append((north_m - side_m / 2, east_m - side_m / 2, north_m + side_m / 2, east_m + side_m / 2))
        long_m = math.exp(generator.uniform(math.log(0.3), math.log(8.0))) * side_m
        across_m = generator.uniform(-0.5, 0.5) * (side_m - size.gap_m)
        if room % 2 and generator.random() < 0.6:
            south_m = north_m + across_m
            spaces.append((south_m - size.gap_m / 2, east_m, south_m + size.gap_m / 2, east_m + side_m / 2 + long_m))
            north_m, east_m = south_m, east_m + side_m + long_m
        else:
            west_m = east_m + across_m
            spaces.append((north_m, west_m - size.gap_m / 2, north_m + side_m / 2 + long_m, west_m + size.gap_m / 2))
            north_m, east_m = north_m + side_m + long_m, west_m
        centres_m.append(np.array([north_m, east_m]))
    if generator.random() < 0.5:
        # The last corridor leads into a room, else outside.
        spaces.append((north_m - side_m / 2, east_m - side_m / 2, north_m + side_m / 2, east_m + side_m / 2))
    discs_m = _walls_of(spaces, 0.2 * side_m)
    ends_m = (centres_m[0], centres_m[-1]) if generator.random() < 0.5 else (centres_m[-1], centres_m[0])
    return _scene(generator, discs_m, ends_m, 2.5)


def ring(generator: np.random.Generator, size: Size) -> Scene:
    """Return a ring with one gap about the target, the start, or each of them."""
    kind = str(generator.choice(["target", "start", "both"]))
    start_m, target_m = np.array([-0.5 * size.length_m, 0.0]), np.array([0.5 * size.length_m, 0.0])
    bow_m = min(0.3 * size.length_m, max(4.0 * size.turn_m, 0.15 * size.length_m))
    rings_m = [_ring_m(generator, place_m, bow_m, size.gap_m) for place_m in (start_m, target_m)]
    chosen = {"start": rings_m[:1], "target": rings_m[1:], "both": rings_m}[kind]
    aside_m = generator.uniform(-0.3, 0.3, 2) * bow_m
    return _scene(generator, np.vstack(chosen), (start_m + aside_m, target_m - aside_m), 2.5)


def wall(generator: np.random.Generator, size: Size) -> Scene:
    """Return a wall of overlapping discs across the way with one gap, or two."""
    return _scene(generator, _wall_m(generator, size, 0.7 * size.length_m), _ends_m(size), 2.5)


def fenced(generator: np.random.Generator, size: Size) -> Scene:
    """Return a fence, concave in most draws, with a few discs or a wall that leaves a gap to it, and exclusions."""
    half_m = max(generator.uniform(0.15, 0.45) * size.length_m, 3.0 * size.turn_m)
    fence_m, ends_m = _fence_m(generator, size, half_m)
    discs_m = np.empty((0, 3))
    exclusions_m: tuple[np.ndarray, ...] = ()
    kind = str(generator.choice(["empty", "discs", "wall", "exclusions"]))
    if kind == "discs":
        discs_m = _between_m(generator, size, np.full(int(generator.integers(2, 9)), 0.12 * half_m), half_m)
    elif kind == "wall":
        discs_m = _wall_m(generator, size, half_m)
    elif kind == "exclusions":
        exclusions_m = tuple(_island_m(generator, size, half_m) for _ in range(int(generator.integers(1, 4))))
    discs_m = discs_m[discs_m[:, 2] >= 1.0]
    return _scene(generator, discs_m, ends_m, 2.0, fence_m, exclusions_m)


def edges(generator: np.random.Generator, size: Size) -> Scene:
    """Return a start near a disc, a target near another, and in half of the draws a fence near one of them."""
    start_m, target_m = _ends_m(size)
    discs = []
    for place_m in (start_m, target_m):
        radius_m = _disc_m(generator, size, (0.02, 0.15))
        apart_m = radius_m + math.exp(generator.uniform(math.log(0.5), math.log(max(2.0, 4.0 * size.turn_m))))
        bearing_rad = generator.uniform(0.0, math.tau)
        discs.append((*(place_m + apart_m * np.array([math.cos(bearing_rad), math.sin(bearing_rad)])), radius_m))
    fence_m = None
    if generator.random() < 0.5:
        near_m = math.exp(generator.uniform(0.0, math.log(max(2.0, 4.0 * size.turn_m))))
        wide_m = 0.6 * size.length_m
        north_m = 0.5 * size.length_m + (near_m if generator.random() < 0.5 else wide_m)
        west_m = -near_m if generator.random() < 0.5 else -wide_m
        fence_m = _box_m((-0.5 * size.length_m - wide_m, west_m, north_m, wide_m))
    return _scene(generator, np.array(discs), (start_m, target_m), 2.0, fence_m)


SCENES: dict[str, Callable[[np.random.Generator, Size], Scene]] = {
    "open": open_field,
    "scattered": scattered_discs,
    "crowd": crowd,
    "mixed": mixed_radii,
    "lattice": lattice,
    "rooms": rooms,
    "ring": ring,
    "wall": wall,
    "fence": fenced,
    "edges": edges,
}
"""The scenes by name."""


def _scene(
    generator: np.random.Generator,
    discs_m: np.ndarray,
    ends_m: Sequence[np.ndarray],
    detour: float,
    fence_m: np.ndarray | None = None,
    exclusions_m: tuple[np.ndarray, ...] = (),
) -> Scene:
    """Return a scene with the start's heading drawn; its way is `detour` straight lines or half the fence long."""
    start_m, target_m = np.asarray(ends_m[0], dtype=float), np.asarray(ends_m[1], dtype=float)
    course_rad = math.atan2(target_m[1] - start_m[1], target_m[0] - start_m[0])
    heading_rad = course_rad + generator.choice([0.0, generator.uniform(-0.6, 0.6), generator.uniform(0.0, math.tau)])
    way_m = detour * float(np.linalg.norm(target_m - start_m))
    if fence_m is not None:
        around_m = float(np.linalg.norm(np.diff(fence_m, axis=0, append=fence_m[:1]), axis=-1).sum())
        way_m = max(way_m, 0.5 * around_m)
    return Scene(discs_m.reshape(-1, 3), start_m, target_m, heading_rad, way_m, fence_m, exclusions_m)


def _ends_m(size: Size) -> tuple[np.ndarray, np.ndarray]:
    return np.array([-0.5 * size.length_m, 0.0]), np.array([0.5 * size.length_m, 0.0])


def _disc_m(generator: np.random.Generator, size: Size, shares: tuple[float, float]) -> float:
    """Return a radius that is a share of the length between the two given ones, within what discs may have."""
    return float(np.clip(generator.uniform(*shares) * size.length_m, LEAST_DISC_M, GREATEST_DISC_M))


def _among(generator: np.random.Generator, size: Size, count: int, shares: tuple[float, float]) -> Scene:
    radii_m = np.clip(generator.uniform(*shares, count) * size.length_m, LEAST_DISC_M, GREATEST_DISC_M)
    return _placed_between(generator, size, radii_m)


def _placed_between(generator: np.random.Generator, size: Size, radii_m: np.ndarray) -> Scene:
    discs_m = _between_m(generator, size, radii_m, 0.4 * size.length_m)
    return _scene(generator, discs_m, _ends_m(size), 2.0)


def _between_m(
    generator: np.random.Generator, size: Size, radii_m: np.ndarray, half_m: float
) -> np.ndarray:  # (M,) m -> (M, 3) m
    """Return discs in a strip of half the given width that leave a turn's room about start and target."""
    ends_m = np.stack(_ends_m(size))
    discs = []
    for radius_m in radii_m:
        for _ in range(TRIES):
            place_m = generator.uniform((-0.55 * size.length_m, -half_m), (0.55 * size.length_m, half_m))
            if (np.linalg.norm(ends_m - place_m, axis=-1) > radius_m + 2.2 * size.turn_m).all():
                discs.append((*place_m, radius_m))
                break
    return np.array(discs).reshape(-1, 3)


def _free_place(
    generator: np.random.Generator, discs_m: np.ndarray, about_m: tuple[float, float], within_m: float
) -> np.ndarray:  # (M, 3) m -> (2,) m
    """Return a place outside every disc, near another; NoRoomError if none is found."""
    for _ in range(TRIES):
        place_m = np.asarray(about_m) + generator.uniform(-within_m, within_m, 2)
        if (np.linalg.norm(discs_m[:, :2] - place_m, axis=-1) > 1.02 * discs_m[:, 2] + 1.0).all():
            return place_m
    raise NoRoomError


def _walls_of(spaces: Sequence[Rectangle], thick_m: float) -> np.ndarray:  # (M, 3) m
    """Return discs that touch the outline of a union of rectangles from outside and close it.

    Their radius is `thick_m`, greater where there would be more than GREATEST_COUNT of them.
    """
    around_m = sum(2 * (north - south + east - west) for south, west, north, east in spaces)
    radius_m = float(np.clip(thick_m, max(LEAST_DISC_M, around_m / (0.8 * GREATEST_COUNT)), GREATEST_DISC_M))
    places = []
    for south, west, north, east in spaces:
        corners_m = _box_m((south - radius_m, west - radius_m, north + radius_m, east + radius_m))
        for begin_m, end_m in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True):
            parts = math.ceil(float(np.linalg.norm(end_m - begin_m)) / radius_m)
            places.append(begin_m + np.linspace(0.0, 1.0, parts, endpoint=False)[:, None] * (end_m - begin_m))
    places_m = np.vstack(places)
    clear = np.ones(len(places_m), dtype=bool)
    for south, west, north, east in spaces:
        nearest_m = np.clip(places_m, (south, west), (north, east))
        clear &= np.linalg.norm(places_m - nearest_m, axis=-1) >= radius_m * (1.0 - 1e-9)
    if clear.sum() > GREATEST_COUNT:
        raise NoRoomError
    return with_radius(places_m[clear], radius_m)


def _ring_m(generator: np.random.Generator, centre_m: np.ndarray, bow_m: float, gap_m: float) -> np.ndarray:
    """Return discs (M, 3) in m on a circle that overlap but for one gap of the given width."""
    radius_m = max(LEAST_DISC_M, generator.uniform(0.12, 0.35) * bow_m)
    open_rad = 2 * math.asin(min(1.0, (2 * radius_m + gap_m) / (2 * bow_m)))
    if open_rad > 0.8 * math.pi:
        raise NoRoomError
    count = math.ceil((math.tau - open_rad) * bow_m / (OVERLAP * radius_m)) + 1
    angles_rad = generator.uniform(0.0, math.tau) + np.linspace(open_rad / 2, math.tau - open_rad / 2, count)
    return with_radius(centre_m + bow_m * np.column_stack([np.cos(angles_rad), np.sin(angles_rad)]), radius_m)


def _wall_m(generator: np.random.Generator, size: Size, half_m: float) -> np.ndarray:  # (M, 3) m
    """Return discs across the way from `half_m` in the west to `half_m` in the east, with one gap or two."""
    radius_m = min(_disc_m(generator, size, (0.02, 0.08)), 0.4 * half_m)
    gap_m = size.gap_m
    places_m = np.sort(generator.uniform(-0.9, 0.9, int(generator.integers(1, 3)))) * half_m
    east_m: list[float] = []
    begin_m = -half_m
    for place_m in (*places_m, half_m + radius_m + gap_m / 2):
        end_m = place_m - gap_m / 2 - radius_m
        if end_m >= begin_m:
            east_m += np.linspace(begin_m, end_m, math.ceil((end_m - begin_m) / (OVERLAP * radius_m)) + 1).tolist()
        begin_m = place_m + gap_m / 2 + radius_m
    if not 0 < len(east_m) <= GREATEST_COUNT:
        raise NoRoomError
    return with_radius(np.column_stack([np.zeros(len(east_m)), east_m]), radius_m)


def _box_m(edges_m: Rectangle) -> np.ndarray:  # (4, 2) m
    south, west, north, east = edges_m
    return np.array([(south, west), (north, west), (north, east), (south, east)])


def _fence_m(
    generator: np.random.Generator, size: Size, half_m: float
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:  # (V, 2) m, ((2,) m, (2,) m)
    """Return a fence, a box, an L, a U or a star, with start and target inside, farther from it than a turn's room."""
    start_m, target_m = _ends_m(size)
    far_m = 0.5 * size.length_m + half_m
    kind = str(generator.choice(["box", "l", "u", "star"]))
    if kind == "box":
        return _box_m((-far_m, -half_m, far_m, half_m)), (start_m, target_m)
    if kind == "star":
        count = int(generator.integers(6, 15))
        angles_rad = np.arange(count) * math.tau / count
        reach = generator.uniform(0.55, 1.3, count)
        outline_m = (reach * far_m)[:, None] * np.column_stack([np.cos(angles_rad), np.sin(angles_rad)])
        return outline_m, (0.5 * start_m, 0.5 * target_m)
    wide_m = 2 * half_m
    far_m = max(far_m, 2.6 * wide_m)
    if kind == "l":
        corners = [(0.0, 0.0), (far_m, 0.0), (far_m, far_m), (far_m - wide_m, far_m), (far_m - wide_m, wide_m)]
        corners.append((0.0, wide_m))
        ends_m = (np.array([half_m, half_m]), np.array([far_m - half_m, far_m - half_m]))
    else:
        corners = [(0.0, 0.0), (far_m, 0.0), (far_m, 3 * wide_m), (0.0, 3 * wide_m), (0.0, 2 * wide_m)]
        corners += [(far_m - wide_m, 2 * wide_m), (far_m - wide_m, wide_m), (0.0, wide_m)]
        ends_m = (np.array([half_m, half_m]), np.array([half_m, 2.5 * wide_m]))
    return np.array(corners), ends_m


def _island_m(generator: np.random.Generator, size: Size, half_m: float) -> np.ndarray:  # (V, 2) m
    """Return a polygon to keep out of, between start and target: of three to eight corners, concave or not."""
    centre_m = generator.uniform((-0.25 * size.length_m, -0.5 * half_m), (0.25 * size.length_m, 0.5 * half_m))
    count = int(generator.integers(3, 9))
    angles_rad = generator.uniform(0.0, math.tau) + np.arange(count) * math.tau / count
    least = 0.4 if generator.random() < 0.5 else 0.95
    reach_m = generator.uniform(least, 1.0, count) * min(0.35 * half_m, 0.15 * size.length_m)
    outline_m: np.ndarray = centre_m + reach_m[:, None] * np.column_stack([np.cos(angles_rad), np.sin(angles_rad)])
    return outline_m
