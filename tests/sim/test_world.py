"""The truth about targets and threats: every motion, its speed and its repeatability."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.mission.model import parse_mission
from companion.mission.resolve import resolve
from sim.world import World

TEXT = """
agents: [{{id: 1, north_m: 0, east_m: 0}}]
targets: [{{id: 1, north_m: 5000, east_m: 100, speed_bound_m_s: 20, motion: {motion}}}]
threats: [{{id: 1, north_m: 9000, east_m: 0, detection_radius_m: 500, attack_radius_m: 200}}]
heading_hold_s: 5
"""


def world_of(motion: str, seed: int = 1) -> World:
    return World(resolve(parse_mission(TEXT.format(motion=motion), "test"), 1), seed)


def target_at(world: World, t_s: float) -> np.ndarray:
    world.advance(t_s)
    place: np.ndarray = world.rows()[0][0]
    return place


def test_what_is_static_stays() -> None:
    world = world_of("static")
    assert list(target_at(world, 1_000.0)) == [5000.0, 100.0, 0.0, 0.0]
    assert list(world.rows()[1][0, :2]) == [9000.0, 0.0]


def test_steady_motion_is_a_straight_line() -> None:
    row = target_at(world_of("{heading_deg: 90, speed_m_s: 10}"), 60.0)
    assert list(row) == pytest.approx([5000.0, 700.0, 90.0, 10.0])


def test_random_motion_walks_at_the_bound_and_turns_every_hold() -> None:
    world = world_of("random")
    rows = np.array([target_at(world, t_s) for t_s in np.arange(0.0, 60.0, 0.5)])
    steps_m = np.hypot(*np.diff(rows[:, :2], axis=0).T)
    assert steps_m == pytest.approx(np.full(len(steps_m), 10.0))
    turns_s = np.arange(0.5, 60.0, 0.5)[np.diff(rows[:, 2]) != 0.0]
    assert list(turns_s) == list(np.arange(5.0, 60.0, 5.0))


@given(st.floats(0.01, 7.0))
def test_random_motion_does_not_depend_on_how_often_it_is_advanced(step_s: float) -> None:
    fine, coarse = world_of("random"), world_of("random")
    for t_s in np.arange(step_s, 40.0, step_s):
        fine.advance(float(t_s))
    assert target_at(fine, 40.0)[:2] == pytest.approx(target_at(coarse, 40.0)[:2], abs=1e-6)


def test_random_motion_follows_its_seed() -> None:
    first, same, other = (target_at(world_of("random", seed), 100.0) for seed in (3, 3, 4))
    assert list(first) == list(same)
    assert list(first) != list(other)


def test_a_path_is_followed_between_its_points_and_ends_at_the_last() -> None:
    world = world_of("{path: [[100, 6000, 100], [200, 6000, 1100]]}")
    assert list(target_at(world, 50.0)) == pytest.approx([5500.0, 100.0, 0.0, 10.0])
    assert list(target_at(world, 150.0)) == pytest.approx([6000.0, 600.0, 90.0, 10.0])
    assert list(target_at(world, 500.0))[:2] == pytest.approx([6000.0, 1100.0])
    assert target_at(world, 500.0)[3] == 0.0


@pytest.mark.slow
@given(st.floats(0.0, 400.0), st.floats(0.01, 5.0))
def test_nothing_moves_faster_than_its_bound(t_s: float, dt_s: float) -> None:
    for motion in ("random", "{heading_deg: 200, speed_m_s: 20}", "{path: [[100, 6000, 100], [200, 6000, 1100]]}"):
        world = world_of(motion)
        before = target_at(world, t_s)[:2]
        after = target_at(world, t_s + dt_s)[:2]
        assert math.dist(before, after) <= 20.0 * dt_s + 1e-6


def test_a_chaser_flies_at_its_bound_towards_the_nearest_agent() -> None:
    text = TEXT.format(motion="static").replace("attack_radius_m: 200", "attack_radius_m: 200, motion: chase")
    world = World(resolve(parse_mission(text, "test"), 1), 1)
    agents_ned_m = np.array([[9_000.0, 400.0], [0.0, 0.0]])
    world.advance(0.0, agents_ned_m)
    world.advance(10.0, agents_ned_m)
    assert world.rows()[1][0].tolist() == pytest.approx([9_000.0, 100.0, 90.0, 10.0])
    world.advance(10.0, agents_ned_m[1:])
    world.advance(20.0)
    assert world.rows()[1][0, 0] == pytest.approx(8_900.0, abs=1.0)


def test_what_is_added_moved_or_retired_in_flight_is_so_in_truth_and_the_rest_goes_on() -> None:
    mission = resolve(parse_mission(TEXT.format(motion="{heading_deg: 90, speed_m_s: 10}"), "test"), 1)
    (target,), (threat,) = mission.targets, mission.threats
    world = World(mission, 1)
    world.advance(10.0)
    added = threat.model_copy(update={"id": 2, "north_m": 100.0, "east_m": 200.0})
    wider = threat.model_copy(update={"detection_radius_m": 900.0})
    world.follow(mission.model_copy(update={"threats": (wider, added)}))
    world.advance(20.0)
    targets, threats = world.rows()
    assert list(targets[0, :2]) == pytest.approx([5000.0, 300.0])
    assert threats[:, :2].tolist() == [[9000.0, 0.0], [100.0, 200.0]]
    moved = target.model_copy(update={"north_m": 1.0, "east_m": 2.0, "motion": "static"})
    world.follow(mission.model_copy(update={"targets": (moved,), "threats": (added,)}))
    world.advance(30.0)
    targets, threats = world.rows()
    assert targets.tolist() == [[1.0, 2.0, 0.0, 0.0]]
    assert threats[:, :2].tolist() == [[100.0, 200.0]]


@pytest.mark.parametrize("motion", ["random", "{heading_deg: 200, speed_m_s: 20}", "{path: [[100, 6000, 100]]}"])
def test_following_the_mission_that_is_flown_already_changes_nothing(motion: str) -> None:
    mission = resolve(parse_mission(TEXT.format(motion=motion), "test"), 1)
    first, second = World(mission, 1), World(mission, 1)
    for world in (first, second):
        world.advance(12.0)
    first.follow(mission)
    for world in (first, second):
        world.advance(33.0)
    assert np.array_equal(np.concatenate(first.rows()), np.concatenate(second.rows()))
