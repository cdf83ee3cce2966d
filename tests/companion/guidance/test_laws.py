"""What steers: the route's direction, the surrogate as a thin wall beside it, and discs as they will be met."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geo.kinematics import shorter_turn_rad, turn_rate_rad_s, turn_towards
from companion.guard.types import ROUNDING_M, TRACKING_STEPS, Motion
from companion.guidance.course import following_m
from companion.guidance.laws import (
    LEAST_CLEARANCE_M,
    LOOK_AHEAD_S,
    WALL_SHARE,
    GradientLaw,
    RoutedLaw,
    SteeringDemand,
    Task,
    foreseen,
    law_of,
)
from companion.guidance.route.router import Reach
from companion.guidance.settings import LAWS, LawLimits, LawName, LawSettings
from companion.guidance.steering import PairSurrogate, SteeringVector, attraction
from companion.guidance.view import View
from companion.surrogate.cost import Weights
from companion.surrogate.profiles import AnalyticProfile, ThreatDiscs, gradient_for_agent, load_pairwise, wall_gradient

SPEED_M_S = 20.0
PERIOD_S = 5.0
ARRIVAL_RADIUS_M = 100.0
SETTINGS = LawSettings(
    agent_id=1,
    law="routed",
    surrogate="pairwise",
    weights=Weights(k_d=1e6, k_a=1e6, k_c=1e5, k_l=1e5),
    separation_m=50.0,
    guidance_step_s=0.5,
    coasting_after_s=15.0,
    limits=LawLimits(
        speed_m_s=SPEED_M_S,
        n_max=1.0,
        range_m=1e6,
        reaction_s=0.0,
        rate_share=1.0,
        wind_m_s=0.0,
        position_error_m=0.0,
    ),
)
TURN_RADIUS_M = SPEED_M_S / turn_rate_rad_s(SPEED_M_S, 1.0)
NORTHWARDS = Motion(0.0, 0.0, 0.0, SPEED_M_S)

angles_rad = st.floats(-math.pi, math.pi)
Disc = tuple[float, float, float]
"""North, east and detection radius, m."""


def view_of(
    *discs: Disc,
    velocity_m_s: tuple[float, float] = (0.0, 0.0),
    bound_m_s: float = 0.0,
    age_s: float = 0.0,
    peers: tuple[tuple[float, float], ...] = (),
) -> View:
    """Return a view of threats heard of `age_s` ago, attack radius half of R_d, all moving alike."""
    table, count = np.array(discs, dtype=float).reshape(-1, 3), len(discs)
    grown_m = bound_m_s * age_s
    return View(
        target_ned_m=None,
        target_age_s=0.0,
        threats_ned_m=table[:, :2],
        detection_radius_m=table[:, 2] + grown_m,
        attack_radius_m=0.5 * table[:, 2] + grown_m,
        threat_speed_m_s=np.full(count, bound_m_s),
        threat_ids=np.arange(1, count + 1),
        threat_velocity_m_s=np.tile(velocity_m_s, (count, 1)),
        threat_age_s=np.full(count, age_s),
        peers_ned_m=np.array(peers, dtype=float).reshape(-1, 2),
        peer_ids=np.zeros(len(peers), dtype=int),
        loitering_ned_m=np.zeros((0, 2)),
    )


def to(
    place_ned_m: tuple[float, float], pose: Motion = NORTHWARDS, *, loitering: bool = False, crowded: bool = False
) -> Task:
    """Return the task to go to a place."""
    pull = attraction(pose.position_ned_m, place_ned_m)
    return Task(place_ned_m, pull, loitering, True, 0.0, 0.8 * ARRIVAL_RADIUS_M, crowded)


def steered(
    place_ned_m: tuple[float, float], view: View, pose: Motion = NORTHWARDS, crowded: bool = False
) -> SteeringDemand:
    """Return the wish of a law that has never steered before."""
    return RoutedLaw(SETTINGS).steer(to(place_ned_m, pose, crowded=crowded), pose, view, 0.0)


def along_m(pull: SteeringVector, heading_rad: float) -> float:
    """Return the component of a pull along a heading."""
    return pull.north_m * math.cos(heading_rad) + pull.east_m * math.sin(heading_rad)


# Which law


@pytest.mark.parametrize("law", LAWS)
def test_a_configuration_names_its_law(law: LawName) -> None:
    kind = RoutedLaw if law == "routed" else GradientLaw
    assert isinstance(law_of(replace(SETTINGS, law=law)), kind)


def test_the_law_seed_adds_the_gradient_of_the_surrogate_and_of_the_range() -> None:
    settings = replace(SETTINGS, law="seed", limits=replace(SETTINGS.limits, range_m=500.0))
    view, task = view_of((0.0, 102.0, 100.0)), to((495.0, 0.0))
    wish = law_of(settings).steer(task, NORTHWARDS, view, 0.0)
    slope_m = PairSurrogate(load_pairwise(), settings.separation_m, settings.weights).gradient_m((0.0, 0.0), view)
    assert wish.pull.east_m == pytest.approx(-float(slope_m[1]))
    assert abs(wish.pull.east_m) > 1.0
    # Near the end of its range it is pulled harder to the target than by the distance and the surrogate.
    assert wish.pull.north_m > 495.0 - float(slope_m[0]) + 1.0


# The route's direction


@given(angles_rad, st.floats(10.0, 1e5))
def test_with_nothing_in_the_way_it_heads_for_the_place_as_strongly_as_it_is_far(
    bearing_rad: float, distance_m: float
) -> None:
    place = (distance_m * math.cos(bearing_rad), distance_m * math.sin(bearing_rad))
    wish = steered(place, view_of(), replace(NORTHWARDS, heading_rad=bearing_rad))
    assert (wish.pull.north_m, wish.pull.east_m) == pytest.approx(place, rel=1e-6, abs=1e-6)
    assert (wish.stay, wish.note, wish.opposed) == (None, None, False)


def test_around_a_disc_it_is_pulled_by_the_length_of_the_way_and_along_its_beginning() -> None:
    wish = steered((2_000.0, 0.0), view_of((1_000.0, 50.0, 400.0)))
    assert wish.route is not None
    assert wish.pull.strength_m == pytest.approx(wish.route.length_m) and wish.route.length_m > 2_100.0
    first = wish.route.pieces[0]
    assert wish.pull.heading_rad % math.tau == pytest.approx((first.curvature_1_m * first.length_m) % math.tau)
    assert wish.route.via == ((0, 1),)


@pytest.mark.parametrize("step_s", [0.5, 5.0])
def test_the_route_keeps_its_margin_outside_the_disc(step_s: float) -> None:
    law = RoutedLaw(replace(SETTINGS, guidance_step_s=step_s))
    wish = law.steer(to((2_000.0, 0.0)), NORTHWARDS, view_of((1_000.0, 50.0, 400.0)), 0.0)
    assert wish.route is not None
    (arc,) = [piece for piece in wish.route.pieces if 0.0 < piece.curvature_1_m < 0.5 / TURN_RADIUS_M]
    radius_m = 1.0 / arc.curvature_1_m
    off_m = following_m(SPEED_M_S * step_s, 400.0)
    assert radius_m == pytest.approx(400.0 + ROUNDING_M + LEAST_CLEARANCE_M + off_m)


@pytest.mark.parametrize(
    ("limits", "radii"),
    [
        ({}, 1.0),
        ({"rate_share": 0.5}, 2.0),
        ({"wind_m_s": 5.0}, 1.25**2),
        ({"rate_share": 0.5, "wind_m_s": 5.0}, 3.125),
    ],
)
def test_the_route_begins_on_the_turning_circle_that_wind_and_the_achieved_rate_leave(
    limits: dict[str, float], radii: float
) -> None:
    law = RoutedLaw(replace(SETTINGS, limits=replace(SETTINGS.limits, **limits)))  # type: ignore[arg-type]
    wish = law.steer(to((0.0, 2_000.0)), NORTHWARDS, view_of(), 0.0)
    assert wish.route is not None
    assert 1.0 / wish.route.pieces[0].curvature_1_m == pytest.approx(radii * TURN_RADIUS_M)


def test_from_step_to_step_it_keeps_to_the_side_that_it_has_chosen() -> None:
    law, sides = RoutedLaw(SETTINGS), []
    for east_m in (-0.5, 0.5, 1.0):
        pose = replace(NORTHWARDS, east_m=east_m)
        for _ in range(12):
            wish = law.steer(to((2_000.0, 0.0), pose), pose, view_of((1_000.0, 0.0, 400.0)), 0.0)
            assert wish.route is not None
            sides.append(wish.route.via)
    fresh = steered((2_000.0, 0.0), view_of((1_000.0, 0.0, 400.0)), replace(NORTHWARDS, east_m=1.0))
    assert fresh.route is not None
    assert fresh.route.via == ((0, -1),)
    assert set(sides) == {((0, 1),)}


def test_a_long_turn_keeps_its_side_though_its_end_is_nearer_by_the_other_one() -> None:
    # The circle to the right is blocked, and the one to the left is left after more than half a turn.
    wish = steered((-100.0 * TURN_RADIUS_M, 0.1 * TURN_RADIUS_M), view_of((0.0, 2.0 * TURN_RADIUS_M, 5.0)))
    assert wish.route is not None
    assert wish.route.turn == -1
    assert shorter_turn_rad(0.0, wish.route.heading_rad) > 0.0
    assert wish.pull.heading_rad == pytest.approx(1.5 * math.pi)
    assert wish.pull.strength_m == pytest.approx(wish.route.length_m)


@settings(max_examples=100)
@given(
    angles_rad,
    st.tuples(angles_rad, st.floats(1.0, 500.0)),
    st.lists(st.tuples(angles_rad, st.floats(1.0, 6.0), st.floats(0.1, 0.9)), max_size=4),
)
def test_no_wish_turns_the_vehicle_by_another_side_than_the_route(
    heading_rad: float, place: tuple[float, float], around: list[tuple[float, float, float]]
) -> None:
    discs, place_ned_m = [], (place[1] * math.cos(place[0]), place[1] * math.sin(place[0]))
    for bearing_rad, radii, share in around:
        away_m = radii * TURN_RADIUS_M
        discs.append((away_m * math.cos(bearing_rad), away_m * math.sin(bearing_rad), share * away_m - 2.0))
    wish = steered(place_ned_m, view_of(*discs), replace(NORTHWARDS, heading_rad=heading_rad))
    assert wish.route is not None
    # A turn that ends within the step is followed by what comes after it.
    if wish.stay is None and wish.route.turn != 0 and wish.route.pieces[0].length_m > SPEED_M_S * 0.5:
        assert wish.route.turn * shorter_turn_rad(heading_rad, wish.pull.heading_rad) >= -1e-9


# What cannot be reached


def test_to_a_place_inside_a_disc_it_goes_as_near_as_it_may_and_says_so() -> None:
    wish = steered((900.0, 0.0), view_of((1_000.0, 0.0, 400.0)))
    assert wish.route is not None
    assert wish.route.end_side != 0
    circle = wish.route.pieces[-1]
    end = math.dist(circle[:2], (1_000.0, 0.0))
    assert 400.0 < end < 400.0 + 4.0 * TURN_RADIUS_M
    assert (wish.stay, wish.note) == (None, "target out of reach: to the nearest safe point")


def flown(pose: Motion, wish: SteeringDemand) -> Motion:
    """Return where a vehicle is after one step that flies exactly what its law wants."""
    rate_rad_s = SPEED_M_S / TURN_RADIUS_M
    here = (pose.north_m, pose.east_m, pose.heading_rad)
    return Motion(*turn_towards(*here, SPEED_M_S, wish.pull.heading_rad, rate_rad_s, 0.5), SPEED_M_S)


def fly(law: RoutedLaw, place_ned_m: tuple[float, float], view: View, steps: int) -> list[SteeringDemand]:
    """Return the wishes of a law whose vehicle flies exactly as it is wanted to."""
    pose, wishes = NORTHWARDS, []
    for step in range(steps):
        wish = law.steer(to(place_ned_m, pose), pose, view, 0.5 * step)
        wishes.append(wish)
        if wish.stay is None:
            pose = flown(pose, wish)
    return wishes


def test_at_the_nearest_safe_point_it_wants_to_stay_and_goes_on_staying() -> None:
    wishes = fly(RoutedLaw(SETTINGS), (900.0, 0.0), view_of((1_000.0, 0.0, 400.0)), 120)
    stays = [wish.stay for wish in wishes]
    first = stays.index("at the nearest safe point")
    assert first > 20 and set(stays[:first]) == {None} and set(stays[first:]) == {"at the nearest safe point"}
    assert wishes[-1].pull == SteeringVector(0.0, 0.0)


@pytest.mark.parametrize("off_m", [-1.0, 0.0, 1.0, 40.0])
def test_a_place_within_the_arrival_radius_of_a_clear_circle_is_reached_though_it_is_beside_or_in_a_disc(
    off_m: float,
) -> None:
    view, place_ned_m = view_of((1_000.0, 0.0, 400.0)), (600.0 - off_m, 0.0)
    law, pose = RoutedLaw(SETTINGS), NORTHWARDS
    nearest_m = math.inf
    for step in range(120):
        wish = law.steer(to(place_ned_m, pose), pose, view, 0.5 * step)
        assert (wish.stay, wish.note) == (None, None)
        pose = flown(pose, wish)
        assert math.dist(pose.position_ned_m, (1_000.0, 0.0)) > 400.0
        nearest_m = min(nearest_m, math.dist(pose.position_ned_m, place_ned_m))
        if nearest_m < 0.8 * ARRIVAL_RADIUS_M:
            return
    raise AssertionError(f"it came no nearer than {nearest_m:.0f} m")


def test_with_no_way_at_all_it_wants_to_stay() -> None:
    # Closed in, and inside a disc that fills the ring: no safe point can be reached.
    ring = [(700.0 * math.cos(k * math.tau / 24), 700.0 * math.sin(k * math.tau / 24), 300.0) for k in range(24)]
    law, view = RoutedLaw(SETTINGS), view_of(*ring, (0.0, 0.0, 450.0))
    wish = [law.steer(to((3_500.0, 0.0)), NORTHWARDS, view, 0.5 * step) for step in range(5)][-1]
    assert wish.route is not None
    assert (wish.route.reach, wish.stay) == (Reach.NONE, "no way to the target")
    assert all(map(math.isfinite, (wish.pull.north_m, wish.pull.east_m)))


def test_loitering_it_follows_its_circle_and_no_route() -> None:
    law, circling = RoutedLaw(SETTINGS), replace(to((2_000.0, 0.0), loitering=True), pull=SteeringVector(3.0, -4.0))
    wish = law.steer(circling, NORTHWARDS, view_of((1_000.0, 0.0, 400.0)), 0.0)
    assert (wish.pull, wish.route) == (SteeringVector(3.0, -4.0), None)


# Room for a circle


def test_with_others_near_it_takes_the_way_that_leaves_room_for_a_circle() -> None:
    gap_m = 2.0 * TURN_RADIUS_M
    gap = view_of((500.0, 100.0 + 0.5 * gap_m, 100.0), (500.0, -100.0 - 0.5 * gap_m, 100.0))
    alone, crowded = steered((1_000.0, 0.0), gap), steered((1_000.0, 0.0), gap, crowded=True)
    assert alone.route is not None
    assert crowded.route is not None
    assert alone.route.length_m == pytest.approx(1_000.0)
    assert crowded.route.length_m > 1_100.0


def test_where_no_way_leaves_room_for_a_circle_it_takes_the_one_there_is() -> None:
    wall = view_of(*[(500.0, east_m, 100.0) for east_m in range(-3_000, 3_001, 250)])
    law = RoutedLaw(SETTINGS)
    # One step may not be enough to plan.
    for step in range(5):
        crowded = law.steer(to((1_000.0, 25.0), crowded=True), NORTHWARDS, wall, 0.5 * step)
    assert crowded.route is not None
    assert crowded.route.reach is Reach.TARGET


# The surrogate as a thin wall


@pytest.mark.slow
@given(
    st.tuples(st.floats(-30.0, 30.0), angles_rad),
    st.floats(10.0, 20_000.0),
    st.floats(0.05, 0.95),
    st.floats(0.05, 50.0),
)
def test_the_wall_is_the_analytic_surrogate_of_one_half_width_in_metres(
    place: tuple[float, float], radius_m: float, attack_share: float, half_width_m: float
) -> None:
    steps, bearing_rad = place
    weights, separation_m = Weights(3e6, 2e6, 1e5, 0.0), 40.0
    attack_m, near_m = attack_share * radius_m, max(0.0, radius_m + steps * half_width_m)
    position = near_m * np.array([math.cos(bearing_rad), math.sin(bearing_rad)])
    peers = position + np.array([[separation_m + steps * half_width_m, 0.0]])
    nobody, nowhere = np.zeros((0, 2)), np.zeros(0)
    here, radii = np.zeros((1, 2)), np.array([radius_m])

    def analytic(edge_m: float, k_d: float, k_c: float) -> np.ndarray:
        profile = AnalyticProfile(half_width_m / edge_m)
        edge, only = np.array([edge_m]), Weights(k_d, 0.0, k_c, 0.0)
        if k_c > 0.0:
            return gradient_for_agent(profile, position, ThreatDiscs(nobody, nowhere, nowhere), peers, edge_m, only)
        return gradient_for_agent(profile, position, ThreatDiscs(here, edge, edge), nobody, separation_m, only)

    expected_m = analytic(radius_m, weights.k_d, 0.0) + analytic(attack_m, weights.k_a, 0.0)
    expected_m += analytic(separation_m, 0.0, weights.k_c)
    found_m = wall_gradient(
        position, ThreatDiscs(here, radii, np.array([attack_m])), peers, separation_m, weights, half_width_m
    )
    assert found_m == pytest.approx(expected_m, rel=1e-6, abs=1e-9 * weights.k_d / half_width_m)


def wall_at(distance_m: float, half_width_m: float, weights: Weights) -> float:
    """Return how strong the wall of a disc of 400 m, attack disc of the same, is at a distance from its centre."""
    here, radius = np.zeros((1, 2)), np.array([400.0])
    place, nobody = np.array([distance_m, 0.0]), np.zeros((0, 2))
    discs = ThreatDiscs(here, radius, radius)
    return float(np.hypot(*wall_gradient(place, discs, nobody, 50.0, weights, half_width_m)))


@given(st.floats(2.0, 100.0))
def test_at_the_routes_margin_the_wall_weighs_nothing_even_with_the_papers_weights(margin_m: float) -> None:
    assert wall_at(400.0 + margin_m, margin_m / WALL_SHARE, Weights()) < 1e-5
    assert wall_at(400.0, margin_m / WALL_SHARE, Weights()) > 1e9


@given(st.floats(0.05, 50.0), st.floats(1.0, 1e4))
def test_where_the_wall_is_left_out_of_the_sum_it_would_weigh_nothing(half_width_m: float, beyond: float) -> None:
    just_within, just_outside = (wall_at(400.0 + k * half_width_m, half_width_m, Weights()) for k in (49.9, 50.1))
    assert just_outside == 0.0
    assert 0.0 < just_within < 1e-25 * Weights().k_d / half_width_m
    assert wall_at(400.0 + (50.0 + beyond) * half_width_m, half_width_m, Weights()) == 0.0


def test_in_the_middle_of_a_disc_the_wall_has_no_direction() -> None:
    assert wall_at(0.0, 5.0, Weights()) == 0.0


def test_one_that_flies_along_its_route_feels_no_wall() -> None:
    view = view_of((0.0, 401.0, 400.0))
    wish = steered((300.0, 2_000.0), view)
    assert wish.route is not None
    assert wish.route.via == ((0, 1),)
    assert abs(shorter_turn_rad(wish.route.heading_rad, wish.pull.heading_rad)) < 0.02
    assert not wish.opposed


def test_a_component_straight_against_the_route_is_dropped_and_said() -> None:
    peer = (SETTINGS.separation_m, 0.0)
    wish = steered((2_000.0, 0.0), view_of(peers=(peer,)))
    assert wish.opposed
    assert (wish.pull.north_m, wish.pull.east_m) == pytest.approx((2_000.0, 0.0))


def test_a_component_across_the_route_is_kept() -> None:
    separation_m, bearing_rad = SETTINGS.separation_m, math.radians(60.0)
    peer = (separation_m * math.cos(bearing_rad), separation_m * math.sin(bearing_rad))
    view = view_of(peers=(peer,))
    wish = steered((2_000.0, 0.0), view)
    weights, half_width_m = SETTINGS.weights, (LEAST_CLEARANCE_M + ROUNDING_M) / WALL_SHARE
    nothing = np.zeros(0)
    gradient_m = wall_gradient(
        np.zeros(2),
        ThreatDiscs(np.zeros((0, 2)), nothing, nothing),
        view.peers_ned_m,
        separation_m,
        weights,
        half_width_m,
    )
    assert wish.opposed
    assert wish.pull.north_m == pytest.approx(2_000.0)
    assert wish.pull.east_m == pytest.approx(-float(gradient_m[1]))


def test_a_component_along_the_route_is_kept() -> None:
    wish = steered((2_000.0, 0.0), view_of(peers=((-SETTINGS.separation_m, 0.0),)))
    assert not wish.opposed
    assert wish.pull.north_m > 2_100.0


def test_a_component_against_the_route_that_is_hardly_felt_is_not_counted() -> None:
    wish = steered((2_000.0, 0.0), view_of(peers=((SETTINGS.separation_m + 0.7, 0.0),)))
    assert wish.pull.north_m == pytest.approx(2_000.0)
    assert not wish.opposed


@given(
    st.lists(st.tuples(angles_rad, st.floats(-1.0, 1.0)), min_size=1, max_size=4),
    st.floats(100.0, 1e4),
)
def test_whatever_stands_about_it_is_never_pulled_back_along_its_route(
    about: list[tuple[float, float]], distance_m: float
) -> None:
    peers = []
    for bearing_rad, off_m in about:
        apart_m = SETTINGS.separation_m + off_m
        peers.append((apart_m * math.cos(bearing_rad), apart_m * math.sin(bearing_rad)))
    wish = steered((distance_m, 0.0), view_of(peers=tuple(peers)))
    assert along_m(wish.pull, 0.0) >= distance_m * (1.0 - 1e-9)


# Discs as they will be when the vehicle could be at them

speeds_m_s = st.floats(0.0, 15.0)
ages_s = st.floats(0.0, 60.0)


def one(centre_and_radius: tuple[np.ndarray, np.ndarray]) -> Disc:
    """Return the only disc foreseen."""
    ((north_m, east_m),), (radius_m,) = centre_and_radius
    return float(north_m), float(east_m), float(radius_m)


@given(ages_s)
def test_discs_that_stand_still_are_foreseen_as_they_are(age_s: float) -> None:
    view = view_of((1_000.0, 50.0, 400.0), (-300.0, 90.0, 20.0), age_s=age_s)
    centres, radii = foreseen(view, NORTHWARDS, SPEED_M_S, PERIOD_S)
    assert np.array_equal(centres, view.threats_ned_m)
    assert np.array_equal(radii, view.detection_radius_m)


@given(angles_rad, st.floats(0.0, 1.0), speeds_m_s, ages_s)
def test_at_no_look_ahead_a_disc_of_unknown_velocity_holds_the_one_that_the_guard_keeps(
    bearing_rad: float, inside: float, bound_m_s: float, age_s: float
) -> None:
    place = 400.0 * inside * math.cos(bearing_rad), 400.0 * inside * math.sin(bearing_rad)
    view = view_of((*place, 400.0), bound_m_s=bound_m_s, age_s=age_s)
    north_m, east_m, radius_m = one(foreseen(view, NORTHWARDS, SPEED_M_S, PERIOD_S))
    assert (north_m, east_m) == place
    assert radius_m >= float(view.detection_radius_m[0]) - 1e-9


@given(angles_rad, st.floats(0.0, 3_000.0), angles_rad, speeds_m_s, st.floats(0.0, 1.0), ages_s, angles_rad)
def test_a_disc_foreseen_holds_the_threat_that_flies_on_as_broadcast_until_the_vehicle_is_there(
    bearing_rad: float,
    apart_m: float,
    course_rad: float,
    bound_m_s: float,
    share: float,
    age_s: float,
    drift_rad: float,
) -> None:
    """Until now it may have drifted off its velocity by what the bound leaves beyond it."""
    velocity = share * bound_m_s * np.array([math.cos(course_rad), math.sin(course_rad)])
    heard = apart_m * np.array([math.cos(bearing_rad), math.sin(bearing_rad)])
    view = view_of(
        (float(heard[0]), float(heard[1]), 400.0), velocity_m_s=tuple(velocity), bound_m_s=bound_m_s, age_s=age_s
    )
    north_m, east_m, radius_m = one(foreseen(view, NORTHWARDS, SPEED_M_S, PERIOD_S))
    ahead_s = min(max((apart_m - float(view.detection_radius_m[0])) / SPEED_M_S, 0.0), LOOK_AHEAD_S)
    drift = (1.0 - share) * bound_m_s * age_s * np.array([math.cos(drift_rad), math.sin(drift_rad)])
    then = heard + velocity * (age_s + ahead_s) + drift
    assert math.dist((north_m, east_m), then) + 400.0 <= radius_m + 1e-6


@given(angles_rad, speeds_m_s, st.floats(0.0, 1.0), st.floats(0.0, 3.0 * PERIOD_S), st.floats(0.0, 3.0 * PERIOD_S))
def test_a_disc_does_not_shrink_between_broadcasts(
    course_rad: float, bound_m_s: float, share: float, age_s: float, later_s: float
) -> None:
    speed_m_s = share * bound_m_s
    velocity = (speed_m_s * math.cos(course_rad), speed_m_s * math.sin(course_rad))

    def radius_m(of_age_s: float) -> float:
        view = view_of((1_000.0, 0.0, 400.0), velocity_m_s=velocity, bound_m_s=bound_m_s, age_s=of_age_s)
        return one(foreseen(view, NORTHWARDS, SPEED_M_S, PERIOD_S))[2]

    assert radius_m(age_s + later_s) >= radius_m(age_s) - 1e-9


@given(speeds_m_s, st.floats(0.0, PERIOD_S))
def test_nor_does_it_with_a_broadcast_that_comes_within_the_period(bound_m_s: float, age_s: float) -> None:
    old, fresh = (view_of((1_000.0, 0.0, 400.0), bound_m_s=bound_m_s, age_s=age) for age in (age_s, 0.0))
    before, after = (one(foreseen(view, NORTHWARDS, SPEED_M_S, PERIOD_S)) for view in (old, fresh))
    assert after == pytest.approx(before)


def test_a_velocity_is_believed_no_farther_ahead_than_said() -> None:
    view = view_of((1e5, 0.0, 400.0), velocity_m_s=(0.0, 5.0), bound_m_s=5.0)
    north_m, east_m, _ = one(foreseen(view, NORTHWARDS, SPEED_M_S, PERIOD_S))
    assert (north_m, east_m) == pytest.approx((1e5, 5.0 * LOOK_AHEAD_S))


def test_a_velocity_beyond_the_bound_leaves_nothing_unexplained() -> None:
    view = view_of((1_000.0, 0.0, 400.0), velocity_m_s=(0.0, 9.0), bound_m_s=5.0, age_s=10.0)
    assert one(foreseen(view, NORTHWARDS, SPEED_M_S, PERIOD_S))[2] == pytest.approx(400.0)


def test_it_passes_behind_a_threat_that_crosses_its_way() -> None:
    # It will be 200 m to the right of the way when the vehicle could be there.
    crossing = view_of((1_000.0, 0.0, 300.0), velocity_m_s=(0.0, 5.7), bound_m_s=5.7)
    wish = steered((2_000.0, 0.0), crossing)
    assert wish.route is not None
    assert wish.route.via == ((0, 1),)
    mirrored = view_of((1_000.0, 0.0, 300.0), velocity_m_s=(0.0, -5.7), bound_m_s=5.7)
    wish = steered((2_000.0, 0.0), mirrored)
    assert wish.route is not None
    assert wish.route.via == ((0, -1),)


# From step to step among what stands


def test_among_standing_discs_the_route_is_planned_once_and_followed() -> None:
    law, view = RoutedLaw(SETTINGS), view_of((1_000.0, 50.0, 400.0))
    lengths_m = [wish.route.length_m for wish in fly(law, (2_000.0, 0.0), view, 100) if wish.route is not None]
    flown_m = [before_m - after_m for before_m, after_m in itertools.pairwise(lengths_m)]
    assert all(flown == pytest.approx(SPEED_M_S * 0.5, abs=0.05) for flown in flown_m)


def test_off_the_route_it_is_planned_anew() -> None:
    law, view = RoutedLaw(SETTINGS), view_of((1_000.0, 50.0, 400.0))
    law.steer(to((2_000.0, 0.0)), NORTHWARDS, view, 0.0)
    aside = Motion(100.0, -300.0, 0.0, SPEED_M_S)
    wish = law.steer(to((2_000.0, 0.0), aside), aside, view, 0.5)
    assert wish.route is not None
    assert wish.route.pieces[0][:2] == pytest.approx((100.0, -300.0))


def test_in_wind_the_route_keeps_outside_what_the_guard_adds_to_every_disc() -> None:
    windy = replace(SETTINGS, limits=replace(SETTINGS.limits, wind_m_s=5.0, position_error_m=1.0))
    disc = view_of((1_000.0, 0.0, 300.0))
    still = RoutedLaw(SETTINGS).steer(to((3_000.0, 0.0)), NORTHWARDS, disc, 0.0)
    wish = RoutedLaw(windy).steer(to((3_000.0, 0.0)), NORTHWARDS, disc, 0.0)
    assert still.route is not None and wish.route is not None
    # The arc about the disc is the flattest: that of the first turn is as tight as can be.
    radius_m, still_m = (
        max(1.0 / abs(piece.curvature_1_m) for piece in route.pieces if piece.curvature_1_m)
        for route in (wish.route, still.route)
    )
    wider_m = radius_m - still_m
    faster_m = following_m(12.5, 300.0) - following_m(10.0, 300.0)
    assert wider_m == pytest.approx(1.0 + 5.0 * TRACKING_STEPS * SETTINGS.guidance_step_s + faster_m, abs=0.01)
