"""The arena's yardstick against closed forms, an exhaustive search over a fine lattice, and ways that are not legal."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from companion.geo.polygon import inside_polygon
from companion.mission.model import (
    AgentSpec,
    Mission,
    PathMotion,
    SteadyMotion,
    TargetSpec,
    ThreatMotion,
    ThreatSpec,
    Wind,
)
from sim.arena.plan_check import verify
from sim.arena.plan_task import MARGIN_M, Needs, ground_turn_radius_m
from sim.arena.planner import Plan, plan, target_stays_clear
from sim.shortest_path import Departure, turning_path
from sim.world import World

SPEED_M_S = 25.0
N_MAX = 1.0
RADIUS_M = SPEED_M_S**2 / (N_MAX * 9.80665)
TARGET = (1200.0, 0.0)
ARRIVAL_M = 40.0
UNTIL_S = 120.0
SEED = 3
PIECES = 4
"""Of the lattice, to a turn radius: a radian."""
LOW_M, HIGH_M = np.array([-500.0, -700.0]), np.array([1400.0, 700.0])
"""Of the lattice."""

Disc = tuple[float, float, float]


def scene(
    *discs: Disc,
    heading_deg: float = 0.0,
    motion: ThreatMotion = "static",
    speed_bound_m_s: float = 0.0,
    n_max: float = N_MAX,
    **others: object,
) -> Mission:
    """Return one agent at the origin, a target north of it and discs (north, east, R_d) that all move alike."""
    placed = dict(
        agents=(AgentSpec(id=1, north_m=0, east_m=0, heading_deg=heading_deg, speed_m_s=SPEED_M_S, n_max=n_max),),
        targets=(TargetSpec(id=1, north_m=TARGET[0], east_m=TARGET[1], speed_bound_m_s=0),),
        threats=tuple(
            ThreatSpec(
                id=index + 1,
                north_m=north,
                east_m=east,
                detection_radius_m=radius,
                attack_radius_m=radius / 2,
                speed_bound_m_s=speed_bound_m_s,
                motion=motion,
            )
            for index, (north, east, radius) in enumerate(discs)
        ),
        arrival_radius_m=ARRIVAL_M,
        max_time_s=UNTIL_S,
    )
    return Mission.model_validate(placed | others)


def planned(mission: Mission, until_s: float = UNTIL_S) -> Plan:
    return plan(mission, 1, TARGET, until_s, SEED)


def faults(mission: Mission, found: Plan, until_s: float = UNTIL_S) -> list[str]:
    return verify(mission, 1, TARGET, until_s, SEED, found)


def by_lattice_m(mission: Mission, until_s: float) -> float:
    """Return the length of the first way that an exhaustive search over a fine lattice finds, infinite if none.

    All pieces are equally long, so the search goes level by level; of the poses in a cell of a fifth of a turn
    radius and 10 degrees only the first is followed. What it finds is a legal way, a little longer than the shortest.
    """
    agent = mission.agents[0]
    radius_m = SPEED_M_S**2 / (agent.n_max * 9.80665)
    piece_m, cell_m, bins = radius_m / PIECES, radius_m / 5, 36
    turns_rad = np.array([-1.0, 0.0, 1.0]) / PIECES
    chord_m = piece_m * np.sinc(turns_rad / math.tau)
    shape = (*np.ceil((HIGH_M - LOW_M) / cell_m).astype(int), bins)
    fresh = np.ones(shape, dtype=bool).ravel()
    world = World(mission, SEED)
    radii_m = np.array([threat.detection_radius_m + MARGIN_M for threat in mission.threats])
    poses = np.array([[0.0, 0.0, math.radians(agent.heading_deg or 0.0) % math.tau]])
    for level in range(1, int(until_s * SPEED_M_S / piece_m) + 1):
        course_rad = poses[:, 2:] + turns_rad / 2
        north_m = poses[:, :1] + chord_m * np.cos(course_rad)
        east_m = poses[:, 1:2] + chord_m * np.sin(course_rad)
        poses = np.column_stack((north_m.ravel(), east_m.ravel(), (poses[:, 2:] + turns_rad).ravel() % math.tau))
        poses = poses[((poses[:, :2] > LOW_M) & (poses[:, :2] < HIGH_M)).all(axis=1)]
        world.advance(level * piece_m / SPEED_M_S)
        discs_m = world.rows()[1][:, :2]
        poses = poses[(np.linalg.norm(poses[:, None, :2] - discs_m, axis=-1) >= radii_m).all(axis=1)]
        cells = ((poses[:, :2] - LOW_M) / cell_m).astype(int).T
        headings = np.minimum((poses[:, 2] / math.tau * bins).astype(int), bins - 1)
        keys, first = np.unique(np.ravel_multi_index((*cells, headings), shape), return_index=True)
        poses = poses[first[fresh[keys]]]
        fresh[keys] = False
        if not len(poses):
            return math.inf
        if (np.linalg.norm(poses[:, :2] - TARGET, axis=-1) <= ARRIVAL_M).any():
            return level * piece_m
    return math.inf


def test_without_discs_and_facing_the_target_the_way_is_the_line_to_the_arrival_circle() -> None:
    found = planned(scene())
    assert found.length_m == pytest.approx(TARGET[0] - ARRIVAL_M, abs=1e-9)
    assert found.gap == pytest.approx(0.0, abs=1e-9)


def test_a_target_behind_costs_the_turn_and_the_tangent() -> None:
    centre_m = math.hypot(TARGET[0], RADIUS_M)
    turn_rad = math.pi + math.asin(RADIUS_M / centre_m) + math.atan2(RADIUS_M, TARGET[0])
    expected_m = RADIUS_M * turn_rad + math.sqrt(centre_m**2 - RADIUS_M**2) - ARRIVAL_M
    found = planned(scene(heading_deg=180.0))
    assert found.length_m == pytest.approx(expected_m, rel=1e-6)
    assert found.gap == pytest.approx(0.0, abs=1e-9)


def test_within_the_arrival_circle_there_is_nothing_to_fly() -> None:
    found = plan(scene(), 1, (10.0, 5.0), UNTIL_S, SEED)
    assert found.length_m == 0.0
    assert verify(scene(), 1, (10.0, 5.0), UNTIL_S, SEED, found) == []


def test_wind_widens_the_turn_by_the_square_of_the_speed_over_the_ground() -> None:
    windy = scene(heading_deg=180.0, wind=Wind(speed_m_s=3.0, gust_m_s=2.0))
    assert ground_turn_radius_m(25.0, N_MAX, 5.0) == pytest.approx(RADIUS_M * 1.44)
    slack = scene(heading_deg=180.0, n_max=N_MAX / 1.44)
    assert planned(windy).length_m == pytest.approx(planned(slack).length_m, rel=1e-9)


STATIC_SCENES = {
    "one disc": scene((600, 20, 200)),
    "a slalom": scene((350, 120, 180), (800, -130, 190)),
    "a wall ahead": scene((200, 0, 120), (200, 180, 120), (200, -180, 120)),
    "a pocket": scene((250, 0, 100), (200, 150, 100), (200, -150, 100), (60, 260, 100), (60, -260, 100)),
    "discs smaller than the turn": scene((500, 10, 90), (700, -150, 80), (700, 120, 80), n_max=0.4),
    "away from the target": scene((-250, 60, 120), (400, 0, 150), heading_deg=150.0),
}
MOVING_SCENES = {
    "crossing": scene((600, -400, 180), motion=SteadyMotion(heading_deg=90, speed_m_s=15), speed_bound_m_s=15),
    "coming": scene((1000, 30, 150), motion=SteadyMotion(heading_deg=180, speed_m_s=8), speed_bound_m_s=8),
    "two crossing": scene(
        (500, -250, 150), (800, -600, 200), motion=SteadyMotion(heading_deg=90, speed_m_s=14), speed_bound_m_s=14
    ),
    "wandering": scene((500, 40, 160), (800, -150, 160), motion="random", speed_bound_m_s=10),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", STATIC_SCENES)
def test_among_discs_that_stand_still_the_way_is_as_short_as_an_exhaustive_search_finds(name: str) -> None:
    mission = STATIC_SCENES[name]
    found, lattice_m = planned(mission), by_lattice_m(mission, UNTIL_S)
    assert faults(mission, found) == []
    assert found.lower_bound_m <= found.length_m <= lattice_m
    assert found.length_m >= 0.95 * lattice_m - RADIUS_M / PIECES


@pytest.mark.slow
@pytest.mark.parametrize("name", MOVING_SCENES)
def test_among_discs_that_move_the_way_is_as_short_as_an_exhaustive_search_finds(name: str) -> None:
    mission = MOVING_SCENES[name]
    found, lattice_m = planned(mission), by_lattice_m(mission, UNTIL_S)
    assert faults(mission, found) == []
    assert found.lower_bound_m <= found.length_m <= lattice_m
    assert found.length_m >= 0.95 * lattice_m - RADIUS_M / PIECES


def test_a_chasing_threat_is_evaded() -> None:
    mission = scene((500, 150, 120), motion="chase", speed_bound_m_s=8)
    found = planned(mission)
    assert found.length_m > TARGET[0] - ARRIVAL_M
    assert faults(mission, found) == []


def test_behind_a_closed_ring_there_is_provably_no_way() -> None:
    angles_rad = np.arange(8) * math.tau / 8
    mission = scene(*((300 * math.cos(angle), 300 * math.sin(angle), 130.0) for angle in angles_rad))
    found = planned(mission)
    assert (found.length_m, found.lower_bound_m, found.method) == (math.inf, math.inf, "impossible")
    assert by_lattice_m(mission, 60.0) == math.inf


def test_a_start_too_narrow_to_turn_in_has_no_way_though_none_is_proven() -> None:
    angles_rad = np.arange(1, 12) * math.tau / 12
    mission = scene(
        *((240 * math.cos(angle), 240 * math.sin(angle), 90.0) for angle in angles_rad), heading_deg=180.0, n_max=0.3
    )
    found = planned(mission)
    assert (found.length_m, found.method) == (math.inf, "none")
    assert math.isfinite(found.lower_bound_m)
    assert by_lattice_m(mission, UNTIL_S) == math.inf


def test_what_cannot_be_reached_in_time_is_impossible() -> None:
    assert planned(scene(), until_s=46.3).method == "impossible"
    assert math.isfinite(planned(scene(), until_s=46.5).length_m)


def test_the_search_betters_lines_and_circles_among_discs_smaller_than_the_turn() -> None:
    mission = STATIC_SCENES["discs smaller than the turn"]
    discs = np.array([(*threat.position_ned_m, threat.detection_radius_m + MARGIN_M) for threat in mission.threats])
    turn_m = ground_turn_radius_m(SPEED_M_S, mission.agents[0].n_max, 0.0)
    lines = turning_path(Departure(np.zeros(2), 0.0, turn_m), np.array(TARGET), ARRIVAL_M, discs[:, :2], discs[:, 2])
    found = planned(mission)
    assert lines is not None
    assert found.length_m < 0.95 * math.fsum(piece.length_m for piece in lines)
    assert found.method == "search"
    assert faults(mission, found) == []


def test_the_same_mission_is_planned_the_same_again() -> None:
    mission = MOVING_SCENES["coming"]
    first, second = planned(mission), planned(mission)
    assert first.method == second.method
    np.testing.assert_array_equal(first.way, second.way)


disc = st.tuples(st.floats(-200, 1400), st.floats(-500, 500), st.floats(50, 250)).filter(
    lambda row: math.hypot(row[0], row[1]) > row[2] + 5 and math.hypot(row[0] - 1200, row[1]) > row[2] + 45
)


@pytest.mark.slow
@settings(max_examples=40)
@example(discs=[(0.0, 96.0, 50.0), (0.0, -67.0, 61.0)], heading_deg=93.0)
@given(discs=st.lists(disc, max_size=6), heading_deg=st.floats(-180, 180))
def test_every_way_among_discs_is_legal_and_no_shorter_than_the_bound(discs: list[Disc], heading_deg: float) -> None:
    mission = scene(*discs, heading_deg=heading_deg)
    found = planned(mission)
    assert faults(mission, found) == []
    assert found.length_m >= found.lower_bound_m - 1e-6


def test_a_way_through_a_disc_is_rejected() -> None:
    through = planned(scene())
    assert any("of a detection disc" in fault for fault in faults(scene((600, 20, 200)), through))


def test_a_way_that_meets_a_moving_disc_is_rejected_and_one_that_passes_before_it_is_not() -> None:
    straight = planned(scene())
    # The agent passes 600 m after 24 s; the disc is on the line then, or comes there half a minute later.
    meeting = scene((600, -240, 100), motion=SteadyMotion(heading_deg=90, speed_m_s=10), speed_bound_m_s=10)
    later = scene((600, -540, 100), motion=SteadyMotion(heading_deg=90, speed_m_s=10), speed_bound_m_s=10)
    assert any("of a detection disc" in fault for fault in faults(meeting, straight))
    assert faults(later, straight) == []


def test_a_way_that_a_chasing_disc_comes_to_is_rejected() -> None:
    mission = scene((600, 150, 100), motion="chase", speed_bound_m_s=10)
    assert faults(scene((600, 150, 100)), planned(scene())) == []
    assert any("of a detection disc" in fault for fault in faults(mission, planned(scene())))


def test_a_way_along_a_path_is_checked_where_the_disc_is_at_that_time() -> None:
    path = PathMotion(path=((0.0, 600.0, -400.0), (24.0, 600.0, 0.0), (40.0, 600.0, 300.0)))
    mission = scene((600, -400, 100), motion=path, speed_bound_m_s=20)
    assert any("of a detection disc" in fault for fault in faults(mission, planned(scene())))


def shifted(way: np.ndarray, point: int, aside_m: float) -> np.ndarray:
    bent = way.copy()
    bent[point, 1] += aside_m
    return bent


Doctor = Callable[[Plan], Plan]
DOCTORED: dict[str, tuple[Doctor, str]] = {
    "shortened": (lambda p: replace(p, length_m=p.length_m - 5.0), "said to be"),
    "without its end": (lambda p: replace(p, way=p.way[:-1]), "outside the arrival circle"),
    "without its beginning": (lambda p: replace(p, way=p.way[1:]), "begins elsewhere"),
    "turned": (lambda p: replace(p, way=p.way + (0.0, 0.0, 0.1)), "begins elsewhere"),
    "thinned": (lambda p: replace(p, way=np.delete(p.way, [2, 3], axis=0)), "too far apart"),
    "shrunk": (lambda p: replace(p, way=p.way * (0.9, 0.9, 1.0)), "tighter than the turn radius"),
    "bent": (lambda p: replace(p, way=shifted(p.way, 3, 1.0)), "bends"),
    "of no numbers": (lambda p: replace(p, way=np.full_like(p.way, np.nan)), "not a way"),
    "said to be none": (lambda p: replace(p, length_m=math.inf), "without a length"),
}


@pytest.mark.parametrize("how", DOCTORED)
def test_a_doctored_way_is_rejected(how: str) -> None:
    doctor, complaint = DOCTORED[how]
    mission = scene(heading_deg=60.0)
    genuine = planned(mission)
    assert faults(mission, genuine) == []
    assert any(complaint in fault for fault in faults(mission, doctor(genuine)))


def test_a_way_that_takes_too_long_is_rejected() -> None:
    assert any("arrives after" in fault for fault in faults(scene(), planned(scene()), until_s=40.0))


def test_a_target_is_clear_only_outside_the_discs_as_they_may_have_grown_by_the_end() -> None:
    mission = scene((600, 0, 200), speed_bound_m_s=10)
    assert target_stays_clear(mission, TARGET, 39.0)
    assert not target_stays_clear(mission, TARGET, 40.0)


BOX = ((-300.0, -400.0), (1500.0, -400.0), (1500.0, 400.0), (-300.0, 400.0))
SPIT = ((600.0, -400.0), (600.0, 100.0), (700.0, 100.0), (700.0, -400.0))
HOOK = ((-300.0, -400.0), *SPIT, (1500.0, -400.0), (1500.0, 600.0), (-300.0, 600.0))
"""A fence with a spit of land from the west that reaches 100 m past the line to the target."""


def test_a_fence_that_is_nowhere_in_the_way_changes_nothing() -> None:
    assert planned(scene(fence=BOX)).length_m == pytest.approx(planned(scene()).length_m, abs=1e-9)


def test_round_the_inner_corners_of_a_fence_the_way_turns_at_the_turn_radius() -> None:
    found = planned(scene(fence=HOOK))
    # Tangents to circles of the turn radius about the two corners, and the line between the circles.
    assert found.method == "tangents"
    assert faults(scene(fence=HOOK), found) == []
    by_corners_m = math.hypot(600.0, 100.0) + 100.0 + math.hypot(500.0, 100.0) - ARRIVAL_M
    assert by_corners_m < found.length_m < 1.1 * by_corners_m
    assert found.lower_bound_m >= by_corners_m


def test_a_wall_of_discs_to_the_fence_is_passed_on_the_side_that_the_fence_leaves_open() -> None:
    discs = ((600.0, -300.0, 120.0), (600.0, -100.0, 120.0), (600.0, 90.0, 120.0))
    fenced, free = scene(*discs, fence=BOX), scene(*discs)
    assert faults(fenced, planned(fenced)) == []
    assert planned(fenced).length_m == pytest.approx(planned(free).length_m, abs=1e-6)
    closed = scene(*discs, (600.0, 290.0, 120.0), fence=BOX)
    assert planned(closed).method == "impossible"


def test_an_exclusion_is_flown_round_and_a_way_through_it_is_rejected() -> None:
    island = ((500.0, -200.0), (700.0, -200.0), (700.0, 100.0), (500.0, 100.0))
    mission = scene(exclusions=(island,))
    assert faults(mission, planned(mission)) == []
    assert planned(mission).length_m > planned(scene()).length_m
    assert any("inside an exclusion" in fault for fault in faults(mission, planned(scene())))


def test_a_way_that_leaves_the_fence_is_rejected() -> None:
    assert any("outside the fence" in fault for fault in faults(scene(fence=HOOK), planned(scene())))


def test_a_start_a_metre_inside_the_fence_or_outside_a_disc_keeps_no_more_room_than_it_has() -> None:
    at_the_fence = scene(fence=((-1.0, -400.0), (1500.0, -400.0), (1500.0, 400.0), (-1.0, 400.0)))
    assert planned(at_the_fence).length_m == pytest.approx(TARGET[0] - ARRIVAL_M, abs=1e-6)
    at_a_disc = scene((-101.0, 0.0, 100.0))
    assert planned(at_a_disc).length_m == pytest.approx(TARGET[0] - ARRIVAL_M, abs=1e-6)
    assert faults(at_a_disc, planned(at_a_disc)) == []


def test_more_room_may_be_asked_for_than_a_legal_way_needs() -> None:
    gap = scene((600.0, 210.0, 200.0), (600.0, -210.0, 200.0))
    narrow = planned(gap)
    wide = plan(gap, 1, TARGET, UNTIL_S, SEED, Needs(margin_m=15.0))
    assert narrow.length_m == pytest.approx(TARGET[0] - ARRIVAL_M)
    assert wide.length_m > narrow.length_m + 50.0


corner = st.floats(0.55, 1.2)


@pytest.mark.slow
@settings(max_examples=40)
@given(reach=st.lists(corner, min_size=5, max_size=9), discs=st.lists(disc, max_size=4))
def test_every_way_inside_a_fence_is_legal_and_no_shorter_than_the_bound(reach: list[float], discs: list[Disc]) -> None:
    angles_rad = np.arange(len(reach)) * math.tau / len(reach)
    fence = tuple(
        (600.0 + 1200.0 * share * math.cos(angle), 1200.0 * share * math.sin(angle))
        for share, angle in zip(reach, angles_rad, strict=True)
    )
    mission = scene(*discs, fence=fence)
    if not (inside_polygon((0.0, 0.0), fence) and inside_polygon(TARGET, fence)):
        return
    found = planned(mission)
    assert faults(mission, found) == []
    assert found.length_m >= found.lower_bound_m - 1e-6


def test_an_agent_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ValueError, match="no agent 2"):
        plan(scene(), 2, TARGET, UNTIL_S, SEED)
