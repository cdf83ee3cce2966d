"""The path between two samples is the one that was flown, and what is judged on it is what a fine sampling sees."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.geo.kinematics import turn_rate_rad_s, turn_towards
from companion.mission.model import AgentSpec, Mission, TargetSpec
from sim.arrivals import Arrivals
from sim.flown_path import ROUNDING_M, Crafts, Paths, Pose, first_within, flown, nearest, straight
from sim.score import score
from sim.trajectory import TrajectoryBuilder

SPEED_M_S, N_MAX = 60.0, 1.0
RATE_RAD_S = turn_rate_rad_s(SPEED_M_S, N_MAX)
angles = st.floats(-math.pi, math.pi)
steps_s = st.sampled_from([0.1, 0.5, 1.0, 2.0, 5.0])


def flight(heading_rad: float, wanted_rad: float, lasts_s: float, wind_m_s: float = 0.0) -> tuple[Paths, np.ndarray]:
    """Return the path between two rounded samples of a kinematic vehicle, and where it really was at 101 times."""
    places = []
    end_rad = heading_rad
    for t_s in np.linspace(0.0, lasts_s, 101):
        north_m, east_m, end_rad = turn_towards(0.0, 0.0, heading_rad, SPEED_M_S, wanted_rad, RATE_RAD_S, float(t_s))
        places.append((north_m + wind_m_s * t_s, east_m))
    truth = np.array(places)

    def pose(place: np.ndarray, towards_rad: float) -> Pose:
        return Pose(np.round(place[None], 3), np.round(np.degrees([towards_rad]) % 360.0, 4))

    crafts = Crafts(np.array([SPEED_M_S]), np.array([RATE_RAD_S]), abs(wind_m_s))
    return flown(pose(truth[0], heading_rad), pose(truth[-1], end_rad), np.array([lasts_s]), crafts), truth


@given(angles, angles, steps_s, st.sampled_from([0.0, 10.0]))
def test_the_path_of_a_kinematic_vehicle_is_the_one_that_it_flew(
    heading_rad: float, wanted_rad: float, lasts_s: float, wind_m_s: float
) -> None:
    path, truth = flight(heading_rad, wanted_rad, lasts_s, wind_m_s)
    found = np.concatenate([path.at(np.array([t_s])) for t_s in np.linspace(0.0, lasts_s, 101)])
    assert np.abs(found - truth).max() < ROUNDING_M


@given(angles, angles, steps_s, st.floats(-400.0, 400.0), st.floats(-400.0, 400.0), st.floats(1.0, 300.0))
def test_the_nearest_place_and_the_first_within_a_radius_are_those_of_a_fine_sampling(
    heading_rad: float, wanted_rad: float, lasts_s: float, north_m: float, east_m: float, radius_m: float
) -> None:
    path, truth = flight(heading_rad, wanted_rad, lasts_s)
    place = np.array([[north_m, east_m]])
    there = straight(place, place, np.array([lasts_s]))
    sampled_m = np.hypot(*(truth - place).T)
    at_s, apart_m = nearest(path, there)
    assert apart_m[0] <= sampled_m.min() + ROUNDING_M
    assert apart_m[0] >= sampled_m.min() - 0.01 * SPEED_M_S * lasts_s
    assert np.hypot(*(path.at(at_s) - place)[0]) == pytest.approx(apart_m[0])
    first_s = float(first_within(path, there, radius_m)[0])
    inside = np.flatnonzero(sampled_m <= radius_m - ROUNDING_M)
    if inside.size:
        assert first_s <= inside[0] / 100.0 * lasts_s + 1e-9
    if math.isfinite(first_s):
        assert np.hypot(*(path.at(np.array([first_s])) - place)[0]) <= radius_m + 1e-6
        assert not (sampled_m[: max(0, int(first_s / lasts_s * 100.0))] < radius_m - ROUNDING_M).any()


def test_a_vehicle_of_another_kind_flew_an_arc_that_turned_as_its_heading_did() -> None:
    radius_m, turn_rad = 50.0, 0.4
    end = np.array([[radius_m * math.sin(turn_rad), radius_m * (1.0 - math.cos(turn_rad))]])
    crafts = Crafts(np.array([SPEED_M_S]), np.array([RATE_RAD_S]), 0.0)
    after = Pose(end, np.array([math.degrees(turn_rad)]))
    path = flown(Pose(np.zeros((1, 2)), np.zeros(1)), after, np.array([1.0]), crafts)
    middle = path.at(np.array([0.5]))[0]
    assert middle == pytest.approx([radius_m * math.sin(0.2), radius_m * (1.0 - math.cos(0.2))], abs=1e-9)


def test_a_vehicle_that_jumped_is_taken_to_have_moved_straight() -> None:
    crafts = Crafts(np.array([SPEED_M_S]), np.array([RATE_RAD_S]), 0.0)
    after = Pose(np.array([[1_000.0, 0.0]]), np.array([170.0]))
    path = flown(Pose(np.zeros((1, 2)), np.zeros(1)), after, np.array([1.0]), crafts)
    assert path.at(np.array([0.25]))[0] == pytest.approx([250.0, 0.0])


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.5, 2.0, 5.0]), st.floats(1.0, 200.0))
def test_the_arrivals_found_step_by_step_are_those_of_the_score(seed: int, step_s: float, radius_m: float) -> None:
    draw = np.random.default_rng(seed)
    mission = Mission(
        name="random turns",
        agents=tuple(
            AgentSpec(id=k + 1, north_m=0.0, east_m=100.0 * k, heading_deg=0.0, speed_m_s=SPEED_M_S, n_max=N_MAX)
            for k in range(3)
        ),
        targets=tuple(TargetSpec(id=k + 1, north_m=300.0, east_m=150.0 * k) for k in range(3)),
        arrival_radius_m=radius_m,
        integration_step_s=step_s,
        guidance_step_s=step_s,
    )
    arrivals, record = Arrivals(mission), TrajectoryBuilder([1, 2, 3], [1, 2, 3], [])
    poses = [(0.0, 100.0 * k, 0.0) for k in range(3)]
    targets = np.array([(300.0, 150.0 * k, 0.0, 0.0) for k in range(3)])
    for step in range(30):
        rows = np.array([(north_m, east_m, math.degrees(heading), SPEED_M_S) for north_m, east_m, heading in poses])
        record.append(step * step_s, rows, targets, [])
        if arrivals.note(step * step_s, rows, [True] * 3, targets):
            break
        wanted_rad = draw.uniform(-math.pi, math.pi, 3)
        poses = [
            turn_towards(*pose, SPEED_M_S, float(wanted), RATE_RAD_S, step_s)
            for pose, wanted in zip(poses, wanted_rad, strict=True)
        ]
    found = score(record.build(), mission)
    assert [target.id for target in found.per_target if target.reached_t_s is None] == arrivals.open
