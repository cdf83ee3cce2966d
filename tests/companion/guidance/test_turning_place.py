"""Where there is room to turn near a place."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.guidance.turning_place import Room, is_clear, is_open, room_m, turning_place

RADIUS_M = 40.0
places = st.tuples(st.floats(-500.0, 500.0), st.floats(-500.0, 500.0))
rows = st.lists(st.tuples(st.floats(-500.0, 500.0), st.floats(-500.0, 500.0), st.floats(1.0, 200.0)), max_size=6)
BOX = ((-600.0, -600.0), (600.0, -600.0), (600.0, 600.0), (-600.0, 600.0))


def room(
    *discs: tuple[float, float, float], fence: tuple[tuple[float, float], ...] = (), clearance_m: float = 0.0
) -> Room:
    table = np.array(discs, dtype=float).reshape(-1, 3)
    return Room(table[:, :2], table[:, 2], np.array(fence).reshape(-1, 2), (), clearance_m)


def test_in_open_water_every_circle_is_clear() -> None:
    assert is_open(room(), (0.0, 0.0), RADIUS_M)
    assert is_open(room((200.0, 0.0, 119.0)), (0.0, 0.0), RADIUS_M)
    assert not is_open(room((200.0, 0.0, 121.0)), (0.0, 0.0), RADIUS_M)


def test_beside_a_disc_the_circle_passes_the_place_on_the_other_side() -> None:
    found = turning_place(room((200.0, 0.0, 199.0)), (0.0, 0.0), RADIUS_M, 10.0, (0.0, -300.0))
    assert found is not None and found.passes_m == 0.0
    assert math.dist(found.centre_ned_m, (0.0, 0.0)) == pytest.approx(RADIUS_M)
    assert math.dist(found.centre_ned_m, (200.0, 0.0)) >= 199.0 + RADIUS_M


def test_inside_a_disc_the_circle_passes_as_near_as_it_may() -> None:
    found = turning_place(room((0.0, 0.0, 100.0)), (0.0, 95.0), RADIUS_M, 20.0, (0.0, 300.0))
    assert found is not None and 5.0 <= found.passes_m <= 20.0
    far = turning_place(room((0.0, 0.0, 100.0)), (0.0, 0.0), RADIUS_M, 20.0, (0.0, 300.0))
    assert far is not None and 100.0 <= far.passes_m < 100.0 + 2.0 * RADIUS_M


def test_behind_walls_all_around_there_is_no_place() -> None:
    ring = [(60.0 * math.cos(k), 60.0 * math.sin(k), 5_000.0) for k in range(6)]
    assert turning_place(room(*ring), (0.0, 0.0), RADIUS_M, 20.0, (0.0, 0.0)) is None


@given(rows, places, st.floats(0.0, 100.0), places)
def test_what_is_found_is_clear_of_discs_and_fence_and_passes_as_it_says(
    discs: list[tuple[float, float, float]],
    place: tuple[float, float],
    within_m: float,
    near: tuple[float, float],
) -> None:
    around = room(*discs, fence=BOX, clearance_m=3.0)
    found = turning_place(around, place, RADIUS_M, within_m, near)
    if found is None:
        return
    north_m, east_m = found.centre_ned_m
    assert is_clear(around, found.centre_ned_m, RADIUS_M)
    assert max(abs(north_m), abs(east_m)) <= 600.0 - 3.0 - RADIUS_M + 1e-6
    assert all(math.dist((north_m, east_m), disc[:2]) >= disc[2] + RADIUS_M - 1e-6 for disc in discs)
    assert abs(math.dist(found.centre_ned_m, place) - RADIUS_M) == pytest.approx(found.passes_m, abs=1e-6)


@given(places)
def test_the_room_at_a_place_is_the_distance_to_the_nearest_wall_or_less_than_nothing_behind_it(
    place: tuple[float, float],
) -> None:
    exclusion = np.array([(-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0)])
    around = Room(np.zeros((0, 2)), np.zeros(0), np.array(BOX), (exclusion,), 2.0)
    outer_m = 600.0 - max(abs(place[0]), abs(place[1]))
    beyond = np.maximum(np.abs(place) - 50.0, 0.0)
    inner_m = float(np.hypot(*beyond)) if beyond.any() else -(50.0 - max(abs(place[0]), abs(place[1])))
    assert room_m(around, np.array([place]))[0] == pytest.approx(min(outer_m, inner_m) - 2.0, abs=1e-6)
