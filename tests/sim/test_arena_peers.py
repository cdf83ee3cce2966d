"""The published methods of the arena: that each does what its publication claims, in a small world of its own."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import InputError
from companion.geo.kinematics import limit_turn, turn_rate_rad_s, turn_towards
from companion.guard.types import Motion
from companion.guidance.laws import SteeringLaw, Task
from companion.guidance.settings import LawLimits, LawSettings
from companion.guidance.steering import attraction, loiter_attraction
from companion.guidance.view import View
from companion.surrogate.cost import Weights
from sim.arena.peers import PEERS, SLOW
from sim.arena.peers.bendyruler import OFFSETS_RAD, BendyRuler
from sim.arena.peers.horizon import ITERATIONS, BatchPlanner, RecedingHorizon
from sim.arena.peers.orca import leave_velocity_obstacle, nearest_heading_rad
from sim.arena.peers.surroundings import Discs, discs_around, discs_foreseen, ray_margins_m, scale_of
from sim.arena.peers.vfhplus import SECTOR_RAD, SECTORS, VectorFieldHistogram, candidates_rad

SPEED_M_S = 25.0
STEP_S = 0.5
ARRIVAL_M = 100.0
SETTINGS = LawSettings(
    agent_id=1,
    law="seed",
    surrogate="pairwise",
    weights=Weights(),
    separation_m=40.0,
    guidance_step_s=STEP_S,
    coasting_after_s=15.0,
    limits=LawLimits(
        speed_m_s=SPEED_M_S,
        n_max=1.25,
        range_m=1e6,
        reaction_s=0.0,
        rate_share=1.0,
        wind_m_s=0.0,
        position_error_m=0.0,
    ),
)
TARGET = (3000.0, 0.0)
NOWHERE = np.zeros((0, 2))
FAST = sorted(set(PEERS) - SLOW)


@pytest.fixture(params=sorted(PEERS))
def make(request: pytest.FixtureRequest) -> Callable[[LawSettings], SteeringLaw]:
    """Return each method in turn; the planner only where its library is installed, and on a small budget."""
    return quick_horizon() if request.param == "horizon" else PEERS[request.param]


def quick_horizon() -> Callable[[LawSettings], SteeringLaw]:
    """Return the planner with a tenth of its budget."""
    pytest.importorskip("ompl")
    return partial(RecedingHorizon, iterations=ITERATIONS // 10)


@dataclass
class Threat:
    """A disc that goes straight."""

    north_m: float
    east_m: float
    radius_m: float
    velocity_m_s: tuple[float, float] = (0.0, 0.0)

    def at(self, t_s: float) -> tuple[float, float]:
        return self.north_m + self.velocity_m_s[0] * t_s, self.east_m + self.velocity_m_s[1] * t_s


@dataclass
class Flown:
    """What one vehicle did."""

    arrived: bool = False
    path_ned_m: list[tuple[float, float]] = field(default_factory=list)
    depth_m: float = 0.0
    """The deepest inside a disc."""


def view_of(threats: list[Threat], t_s: float = 0.0, age_s: float = 0.0) -> View:
    """Return the picture of threats last heard of `age_s` before `t_s`."""
    speed_m_s = np.array([math.hypot(*threat.velocity_m_s) for threat in threats])
    radius_m = np.array([threat.radius_m for threat in threats])
    return View(
        target_ned_m=TARGET,
        target_age_s=0.0,
        threats_ned_m=np.array([threat.at(t_s - age_s) for threat in threats]).reshape(-1, 2),
        detection_radius_m=radius_m + speed_m_s * age_s,
        attack_radius_m=radius_m / 2.0 + speed_m_s * age_s,
        threat_speed_m_s=speed_m_s,
        threat_ids=np.arange(1, len(threats) + 1),
        threat_velocity_m_s=np.array([threat.velocity_m_s for threat in threats]).reshape(-1, 2),
        threat_age_s=np.full(len(threats), age_s),
        peers_ned_m=NOWHERE,
        peer_ids=np.zeros(0, dtype=int),
        loitering_ned_m=NOWHERE,
    )


def seeing(view: View, position_ned_m: tuple[float, float], velocity_m_s: tuple[float, float]) -> View:
    """Return the view with one other agent that the own detector sees."""
    return replace(
        view,
        peers_ned_m=np.array([position_ned_m]),
        peer_ids=np.array([2]),
        traffic_ned_m=np.array([position_ned_m]),
        traffic_velocity_m_s=np.array([velocity_m_s]),
    )


def task_to(target: tuple[float, float], pose: Motion) -> Task:
    return Task(target, attraction(pose.position_ned_m, target), False, True, 0.0, 0.98 * ARRIVAL_M)


def moved(pose: Motion, wanted_rad: float) -> Motion:
    """Fly a step as the companion would have it flown: the turn limit after the wish."""
    n_max = SETTINGS.limits.n_max
    heading_rad, _ = limit_turn(pose.heading_rad, wanted_rad, SPEED_M_S, n_max, STEP_S)
    flown = turn_towards(
        *pose.position_ned_m, pose.heading_rad, SPEED_M_S, heading_rad, turn_rate_rad_s(SPEED_M_S, n_max), STEP_S
    )
    return Motion(*flown, SPEED_M_S)


def fly(law: SteeringLaw, threats: list[Threat], heading_rad: float = 0.0, limit_s: float = 300.0) -> Flown:
    """Fly from the origin to TARGET, the broadcast heard every 5 s."""
    pose, flown = Motion(0.0, 0.0, heading_rad, SPEED_M_S), Flown()
    for step in range(int(limit_s / STEP_S)):
        t_s = STEP_S * step
        flown.path_ned_m.append(pose.position_ned_m)
        inside_m = [threat.radius_m - math.dist(pose.position_ned_m, threat.at(t_s)) for threat in threats]
        flown.depth_m = max([flown.depth_m, *inside_m])
        if math.dist(pose.position_ned_m, TARGET) <= ARRIVAL_M:
            flown.arrived = True
            break
        wish = law.steer(task_to(TARGET, pose), pose, view_of(threats, t_s, t_s % 5.0), t_s)
        pose = moved(pose, wish.pull.heading_rad)
    return flown


def test_a_free_target_behind_the_vehicle_is_reached(make: Callable[[LawSettings], SteeringLaw]) -> None:
    flown = fly(make(SETTINGS), [], heading_rad=math.pi)
    assert flown.arrived
    turn_m = math.pi * scale_of(SETTINGS).turn_radius_m
    assert len(flown.path_ned_m) * SPEED_M_S * STEP_S < TARGET[0] + 2.0 * turn_m


def test_one_disc_in_the_way_is_gone_round_without_entering_it(make: Callable[[LawSettings], SteeringLaw]) -> None:
    flown = fly(make(SETTINGS), [Threat(1500.0, 60.0, 400.0)])
    assert flown.arrived
    assert flown.depth_m == 0.0


def test_a_disc_that_the_target_is_in_front_of_is_no_hindrance(make: Callable[[LawSettings], SteeringLaw]) -> None:
    flown = fly(make(SETTINGS), [Threat(3900.0, 0.0, 500.0)])
    assert flown.arrived
    assert flown.depth_m == 0.0


@pytest.mark.parametrize("name", ["apf", "vfhplus", "orca"])
def test_a_slow_mover_that_crosses_the_way_is_not_entered(name: str) -> None:
    flown = fly(PEERS[name](SETTINGS), [Threat(1500.0, -500.0, 250.0, (0.0, 8.0))])
    assert flown.arrived
    assert flown.depth_m == 0.0


def test_the_same_flight_is_flown_twice_alike(make: Callable[[LawSettings], SteeringLaw]) -> None:
    threats = [Threat(1200.0, 40.0, 300.0), Threat(2100.0, -200.0, 300.0)]
    assert fly(make(SETTINGS), threats).path_ned_m == fly(make(SETTINGS), threats).path_ned_m


def test_a_loitering_vehicle_is_left_to_its_loiter_circle(make: Callable[[LawSettings], SteeringLaw]) -> None:
    pose = Motion(0.0, 0.0, 0.0, SPEED_M_S)
    pull = loiter_attraction(pose.position_ned_m, (10.0, 20.0), 100.0)
    task = Task((10.0, 20.0), pull, True, False, 0.0, ARRIVAL_M)
    assert make(SETTINGS).steer(task, pose, view_of([Threat(300.0, 0.0, 250.0)]), 0.0).pull == pull


def test_inside_a_grown_disc_each_method_but_the_planner_heads_out_of_it() -> None:
    pose = Motion(0.0, 0.0, math.pi / 2.0, SPEED_M_S)
    view = view_of([Threat(180.0, 0.0, 200.0)])
    for name in FAST:
        wish = PEERS[name](SETTINGS).steer(task_to(TARGET, pose), pose, view, 0.0)
        assert math.cos(wish.pull.heading_rad) < 0.1, name


@pytest.mark.parametrize("name", FAST)
def test_two_that_meet_head_on_keep_their_separation(name: str) -> None:
    poses = [Motion(0.0, 0.0, 0.0, SPEED_M_S), Motion(2000.0, 5.0, math.pi, SPEED_M_S)]
    goals = [(2400.0, 0.0), (-400.0, 5.0)]
    laws = [PEERS[name](SETTINGS) for _ in poses]
    least_m = math.inf
    for step in range(160):
        velocities = [(SPEED_M_S * math.cos(p.heading_rad), SPEED_M_S * math.sin(p.heading_rad)) for p in poses]
        wanted_rad = [
            laws[own]
            .steer(
                task_to(goals[own], poses[own]),
                poses[own],
                seeing(view_of([]), poses[1 - own].position_ned_m, velocities[1 - own]),
                STEP_S * step,
            )
            .pull.heading_rad
            for own in (0, 1)
        ]
        poses = [moved(pose, wanted) for pose, wanted in zip(poses, wanted_rad, strict=True)]
        least_m = min(least_m, math.dist(poses[0].position_ned_m, poses[1].position_ned_m))
    assert least_m >= SETTINGS.separation_m


def test_importing_the_methods_does_not_load_the_planning_library() -> None:
    code = "import sys, sim.arena.peers; print([name for name in ('ompl', 'casadi') if name in sys.modules])"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.strip() == "[]"


def test_without_the_planning_library_horizon_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ompl.base", None)
    with pytest.raises(InputError, match=r"install '\.\[arena\]'"):
        PEERS["horizon"](SETTINGS)


def test_horizon_finds_the_way_out_of_a_pocket_that_opens_away_from_the_target() -> None:
    bow = [
        Threat(700.0 + 600.0 * math.cos(a), 600.0 * math.sin(a), 250.0) for a in np.radians(np.arange(-100, 101, 20))
    ]
    assert fly(quick_horizon()(SETTINGS), bow).arrived


def test_horizon_stays_where_the_target_is_covered() -> None:
    pytest.importorskip("ompl")
    pose = Motion(0.0, 0.0, 0.0, SPEED_M_S)
    wish = PEERS["horizon"](SETTINGS).steer(task_to(TARGET, pose), pose, view_of([Threat(3000.0, 50.0, 300.0)]), 0.0)
    assert wish.stay is not None


def test_horizon_plans_no_more_often_while_it_loiters_for_want_of_a_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ompl")
    asked_at_s: list[float] = []
    law, pose, view = (
        PEERS["horizon"](SETTINGS),
        Motion(0.0, 0.0, 0.0, SPEED_M_S),
        view_of([Threat(1500.0, 0.0, 300.0)]),
    )

    def asked(at_s: float, *_: object) -> object:
        asked_at_s.append(at_s)
        return NOWHERE

    for step in range(8):
        now_s = STEP_S * step
        monkeypatch.setattr(BatchPlanner, "plan", partial(asked, now_s))
        assert law.steer(task_to(TARGET, pose), pose, view, now_s).stay is not None
        law.steer(replace(task_to(TARGET, pose), loitering=True), pose, view, now_s)
    assert asked_at_s == [0.0, 2.0]


def test_a_threat_is_where_its_velocity_took_it_and_as_large_as_what_that_leaves_unexplained() -> None:
    threat = Threat(1000.0, 0.0, 300.0, (0.0, 10.0))
    view = replace(view_of([threat], 4.0, 4.0), threat_speed_m_s=np.array([15.0]), detection_radius_m=np.array([360.0]))
    discs = discs_around(view, scale_of(SETTINGS))
    assert discs.centres_ned_m[0] == pytest.approx((1000.0, 40.0))
    assert discs.radius_m[0] == pytest.approx(360.0 - 40.0 + 2.0)


def test_a_threat_is_foreseen_where_it_will_be_when_the_vehicle_could_be_at_it() -> None:
    view = view_of([Threat(802.0, 0.0, 300.0, (0.0, 10.0))])
    discs = discs_foreseen(view, Motion(0.0, 0.0, 0.0, SPEED_M_S), scale_of(SETTINGS))
    assert discs.centres_ned_m[0] == pytest.approx((802.0, 10.0 * 500.0 / SPEED_M_S))


def test_an_agent_that_is_heard_of_but_not_seen_is_taken_as_standing() -> None:
    view = seeing(view_of([]), (100.0, 0.0), (3.0, 4.0))
    heard = replace(view, peers_ned_m=np.array([(900.0, 9.0), (100.0, 0.0)]), peer_ids=np.array([3, 2]))
    discs = discs_around(heard, scale_of(SETTINGS))
    assert discs.velocity_m_s.tolist() == [[0.0, 0.0], [3.0, 4.0]]


@given(
    st.tuples(*[st.floats(-1e3, 1e3)] * 4),
    st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(1.0, 500.0)),
)
def test_the_margin_of_a_ray_is_the_least_distance_of_its_points(
    ends: tuple[float, ...], disc: tuple[float, float, float]
) -> None:
    begin, end = np.array([ends[:2]]), np.array([ends[2:]])
    discs = Discs(np.array([disc[:2]]), np.array([disc[2]]), np.zeros((1, 2)), 1)
    points = begin + np.linspace(0.0, 1.0, 2001)[:, np.newaxis] * (end - begin)
    sampled_m = np.hypot(*(points - disc[:2]).T).min() - disc[2]
    assert ray_margins_m(discs, begin, end)[0] == pytest.approx(sampled_m, abs=1.5)


def test_bendyruler_tries_bearings_to_170_degrees_each_side_the_nearest_first() -> None:
    degrees = np.degrees(OFFSETS_RAD)
    assert degrees[:5].round().tolist() == [0, -5, 5, -10, 10]
    assert degrees[-1] == pytest.approx(170.0)
    assert len(degrees) == 69


def test_bendyruler_keeps_its_bearing_rather_than_turn_far_for_little_more_room() -> None:
    pose = Motion(0.0, 0.0, 0.0, SPEED_M_S)
    # The wall is nearly symmetric; the way round it on the other side becomes shorter by a little.
    wall = [Threat(600.0, east_m, 250.0) for east_m in (-400.0, 0.0, 400.0)]
    law = BendyRuler(SETTINGS)
    first_rad = law.steer(task_to(TARGET, pose), pose, view_of(wall), 0.0).pull.heading_rad
    shift_m = -60.0 if math.sin(first_rad) > 0.0 else 60.0
    other = [replace(threat, east_m=threat.east_m - shift_m) for threat in wall]
    fresh_rad = BendyRuler(SETTINGS).steer(task_to(TARGET, pose), pose, view_of(other), 0.0).pull.heading_rad
    held_rad = law.steer(task_to(TARGET, pose), pose, view_of(other), 0.5).pull.heading_rad
    assert math.sin(fresh_rad) * math.sin(first_rad) < 0.0
    assert held_rad == pytest.approx(first_rad)


def test_a_wide_opening_offers_both_its_sides_and_the_goal_between_them() -> None:
    masked = np.zeros(SECTORS, dtype=bool)
    masked[40:60] = True
    found = [angle_rad % math.tau for angle_rad in candidates_rad(masked, 0.1, 8)]
    assert found == pytest.approx([SECTOR_RAD * 64, SECTOR_RAD * 35, 0.1])


def test_a_narrow_opening_offers_its_middle() -> None:
    masked = np.ones(SECTORS, dtype=bool)
    masked[10:15] = False
    assert candidates_rad(masked, 0.0, 8) == pytest.approx([SECTOR_RAD * 12])


def test_vfhplus_does_not_turn_to_the_side_where_a_disc_lies_in_its_turning_circle() -> None:
    radius_m = scale_of(SETTINGS).turn_radius_m
    beside = Threat(0.0, 1.5 * radius_m, 0.9 * radius_m)
    pose = Motion(0.0, 0.0, 0.0, SPEED_M_S)
    target = (-3000.0, 300.0)
    free = VectorFieldHistogram(SETTINGS).steer(task_to(target, pose), pose, view_of([]), 0.0)
    masked = VectorFieldHistogram(SETTINGS).steer(task_to(target, pose), pose, view_of([beside]), 0.0)
    assert math.sin(free.pull.heading_rad) > 0.0
    assert math.sin(masked.pull.heading_rad) < 0.0 or math.cos(masked.pull.heading_rad) > 0.5


@given(
    st.floats(50.0, 2000.0),
    st.floats(-math.pi, math.pi),
    st.floats(10.0, 1000.0),
    st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0)),
)
def test_past_the_edge_of_a_velocity_obstacle_nothing_is_hit_within_the_horizon(
    apart_m: float, bearing_rad: float, radius_m: float, relative: tuple[float, float]
) -> None:
    radius_m = min(radius_m, 0.95 * apart_m)
    offset_m = apart_m * np.array([[math.cos(bearing_rad), math.sin(bearing_rad)]])
    horizon_s = 10.0
    normals, change_m_s = leave_velocity_obstacle(
        offset_m, np.array([apart_m]), np.array([radius_m]), np.array([relative]), np.array([horizon_s]), STEP_S
    )
    leaving = np.array(relative) + (change_m_s[0] + 1e-6) * normals[0]
    times_s = np.linspace(0.0, horizon_s, 401)
    nearest_m = np.hypot(*(offset_m - times_s[:, np.newaxis] * leaving).T).min()
    assert nearest_m >= radius_m * (1.0 - 1e-6)


def test_orca_takes_the_permitted_heading_nearest_to_the_goal() -> None:
    # Velocities with an east component of at least 15 of 25 m/s.
    heading_rad = nearest_heading_rad(0.0, np.array([[0.0, 1.0]]), np.array([15.0]), scale_of(SETTINGS))
    assert heading_rad == pytest.approx(math.asin(15.0 / 25.0))


def test_orca_takes_the_safest_heading_where_none_is_permitted() -> None:
    normals = np.array([[0.0, 1.0], [0.0, -1.0]])
    heading_rad = nearest_heading_rad(1.0, normals, np.array([15.0, 5.0]), scale_of(SETTINGS))
    # Missed equally by both: 15 - 25 sin = 5 + 25 sin.
    assert 25.0 * math.sin(heading_rad) == pytest.approx(5.0, abs=0.5)
