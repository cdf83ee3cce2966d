"""Guidance: the turn limit, the direction of descent, and the circle and the place of a loiter."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.geo.kinematics import PIVOT_SPEED_M_S, limit_turn, turn_rate_rad_s, turn_towards
from companion.guidance.steering import (
    Occupied,
    PairSurrogate,
    SteeringVector,
    attraction,
    circling,
    claim_m,
    direction,
    loiter_attraction,
    loiter_place,
    loiter_radius_m,
    loiter_spacing_m,
)
from companion.guidance.view import View
from companion.surrogate.cost import Weights
from companion.surrogate.profiles import AnalyticProfile, ThreatDiscs, surrogate_gradient

G_M_S2 = 9.80665
HEADINGS = st.floats(-10.0, 10.0)
SPEEDS = st.floats(0.0, 300.0)
LOADS = st.floats(0.01, 20.0)
STEPS = st.floats(0.01, 10.0)
WEIGHTS = Weights(k_d=1e11, k_a=3e11, k_c=1e10)


def turned_rad(before_rad: float, after_rad: float) -> float:
    return math.remainder(after_rad - before_rad, math.tau)


def most_rad(speed_m_s: float, n_max: float, dt_s: float) -> float:
    return n_max * G_M_S2 / max(speed_m_s, PIVOT_SPEED_M_S) * dt_s


# --- the turn limit


@given(speed_m_s=SPEEDS, n_max=LOADS)
def test_the_turn_rate_is_n_g_over_v_and_never_more_than_on_the_spot(speed_m_s: float, n_max: float) -> None:
    assert turn_rate_rad_s(speed_m_s, n_max) == pytest.approx(most_rad(speed_m_s, n_max, 1.0))


@given(heading_rad=HEADINGS, wanted_rad=HEADINGS, speed_m_s=SPEEDS, n_max=LOADS, dt_s=STEPS)
def test_a_step_never_turns_by_more_than_the_limit(
    heading_rad: float, wanted_rad: float, speed_m_s: float, n_max: float, dt_s: float
) -> None:
    reached_rad, _ = limit_turn(heading_rad, wanted_rad, speed_m_s, n_max, dt_s)
    assert abs(turned_rad(heading_rad, reached_rad)) <= most_rad(speed_m_s, n_max, dt_s) + 1e-14


@given(heading_rad=HEADINGS, wanted_rad=HEADINGS, speed_m_s=SPEEDS, n_max=LOADS, dt_s=STEPS)
def test_the_flag_says_whether_the_wanted_heading_is_out_of_reach(
    heading_rad: float, wanted_rad: float, speed_m_s: float, n_max: float, dt_s: float
) -> None:
    reached_rad, limited = limit_turn(heading_rad, wanted_rad, speed_m_s, n_max, dt_s)
    away_rad = abs(turned_rad(heading_rad, wanted_rad))
    assume(abs(away_rad - most_rad(speed_m_s, n_max, dt_s)) > 1e-12)
    assert limited == (away_rad > most_rad(speed_m_s, n_max, dt_s))
    if limited:
        turn_rad = abs(turned_rad(heading_rad, reached_rad))
        assert turn_rad == pytest.approx(most_rad(speed_m_s, n_max, dt_s), abs=1e-12)
    else:
        assert reached_rad == wanted_rad % math.tau


@given(heading_rad=HEADINGS, wanted_rad=HEADINGS, speed_m_s=st.floats(20.0, 300.0), n_max=st.floats(0.01, 5.0))
def test_a_limited_turn_goes_by_the_shorter_side(
    heading_rad: float, wanted_rad: float, speed_m_s: float, n_max: float
) -> None:
    wanted_turn_rad = turned_rad(heading_rad, wanted_rad)
    assume(abs(wanted_turn_rad) < math.pi - 1e-6)
    reached_rad, limited = limit_turn(heading_rad, wanted_rad, speed_m_s, n_max, 0.5)
    assume(limited)
    assert turned_rad(heading_rad, reached_rad) * wanted_turn_rad > 0.0


@given(
    heading_rad=HEADINGS,
    wanted_rad=HEADINGS,
    speed_m_s=st.floats(1.0, 300.0),
    n_max=LOADS,
    dt_s=STEPS,
    length_m=st.floats(0.1, 1e5),
)
def test_the_turn_limit_is_the_papers_rule_on_vectors(
    heading_rad: float, wanted_rad: float, speed_m_s: float, n_max: float, dt_s: float, length_m: float
) -> None:
    """Paper, unitdirect: if the angle to d exceeds psi_max, rotate the course by it towards d, else take d."""
    psi_max = n_max * G_M_S2 / speed_m_s * dt_s
    course = np.array([math.cos(heading_rad), math.sin(heading_rad)])
    d = length_m * np.array([math.cos(wanted_rad), math.sin(wanted_rad)])
    cross = float(course[0] * d[1] - course[1] * d[0])
    angle = math.atan2(abs(cross), float(course @ d))
    assume(angle < math.pi - 1e-6)
    assume(abs(angle - psi_max) > 1e-9)
    if angle > psi_max:
        c, s = math.cos(psi_max), math.copysign(math.sin(psi_max), cross)
        expected = np.array([[c, -s], [s, c]]) @ course
    else:
        expected = d / np.hypot(*d)
    reached_rad, _ = limit_turn(heading_rad, wanted_rad, speed_m_s, n_max, dt_s)
    np.testing.assert_allclose([math.cos(reached_rad), math.sin(reached_rad)], expected, atol=1e-9)


@given(heading_rad=HEADINGS, rounding_rad=st.floats(-1e-12, 1e-12))
def test_an_opposite_heading_is_turned_to_by_the_right(heading_rad: float, rounding_rad: float) -> None:
    opposite_rad = (heading_rad + math.pi + rounding_rad) % math.tau
    reached_rad, limited = limit_turn(heading_rad, opposite_rad, 60.0, 1.0, 0.5)
    assert limited
    assert turned_rad(heading_rad, reached_rad) == pytest.approx(most_rad(60.0, 1.0, 0.5))


@pytest.mark.parametrize("off_rad", [1e-3, 1e-6, 1e-8])
def test_short_of_opposite_the_shorter_side_still_decides(off_rad: float) -> None:
    left_rad, _ = limit_turn(0.0, math.pi + off_rad, 60.0, 1.0, 0.5)
    right_rad, _ = limit_turn(0.0, math.pi - off_rad, 60.0, 1.0, 0.5)
    assert turned_rad(0.0, left_rad) < 0.0 < turned_rad(0.0, right_rad)


@given(
    heading_rad=HEADINGS,
    off_rad=st.floats(-1e-8, 1e-8) | st.floats(-3.0, 3.0),
    speed_m_s=st.floats(5.0, 300.0),
    n_max=st.floats(0.3, 5.0),
)
def test_repeated_steps_keep_to_one_side_until_the_heading_is_reached(
    heading_rad: float, off_rad: float, speed_m_s: float, n_max: float
) -> None:
    wanted_rad = heading_rad + math.pi + off_rad
    assume(abs(turned_rad(heading_rad, wanted_rad)) > 1e-6)
    turns = []
    for _ in range(2 + int(math.pi / most_rad(speed_m_s, n_max, 0.5))):
        before_rad = heading_rad
        heading_rad, limited = limit_turn(heading_rad, wanted_rad, speed_m_s, n_max, 0.5)
        turns.append(turned_rad(before_rad, heading_rad))
        if not limited:
            break
    assert heading_rad == wanted_rad % math.tau
    assert all(turn_rad * turns[0] >= 0.0 for turn_rad in turns)


# --- direction


@given(north_m=st.floats(-1e5, 1e5), east_m=st.floats(-1e5, 1e5))
def test_a_pull_has_the_length_and_the_clockwise_heading_of_its_vector(north_m: float, east_m: float) -> None:
    assume(math.hypot(north_m, east_m) > 1e-3)
    pull = SteeringVector(north_m, east_m)
    back = (pull.strength_m * math.cos(pull.heading_rad), pull.strength_m * math.sin(pull.heading_rad))
    assert back == pytest.approx((north_m, east_m), abs=1e-9)
    assert 0.0 <= pull.heading_rad <= math.tau


@pytest.mark.parametrize(("pull", "heading_deg"), [((1, 0), 0.0), ((0, 1), 90.0), ((-1, 0), 180.0), ((0, -1), 270.0)])
def test_headings_run_clockwise_from_north(pull: tuple[float, float], heading_deg: float) -> None:
    assert math.degrees(SteeringVector(*pull).heading_rad) == pytest.approx(heading_deg)


def test_attraction_is_the_way_to_the_target() -> None:
    assert attraction((100.0, -50.0), (400.0, 350.0)) == SteeringVector(300.0, 400.0)
    assert attraction((100.0, -50.0), (400.0, 350.0)).strength_m == 500.0


@given(
    places=st.lists(st.tuples(st.floats(-15e3, 15e3), st.floats(-15e3, 15e3)), min_size=6, max_size=6, unique=True),
    pull=st.builds(SteeringVector, st.floats(-1e5, 1e5), st.floats(-1e5, 1e5)),
)
def test_direction_is_the_attraction_less_the_gradient_of_the_surrogate(
    places: list[tuple[float, float]], pull: SteeringVector
) -> None:
    profile, separation_m = AnalyticProfile(0.05), 4e3
    agents, threats = np.array(places[:3]), np.array(places[3:])
    detection_m, attack_m = np.array([8e3, 9e3, 10e3]), np.array([4e3, 4e3, 6e3])
    gradient_m = surrogate_gradient(
        profile, agents, ThreatDiscs(threats, detection_m, attack_m), separation_m, WEIGHTS
    )[0]
    ids, peer_ids, nobody = np.array([1, 2, 3]), np.array([2, 3]), np.zeros((0, 2))
    still = np.zeros(3)
    view = View(
        *(None, math.inf, threats, detection_m, attack_m, still, ids, np.zeros((3, 2)), still),
        *(agents[1:], peer_ids, nobody),
    )
    found = direction(pull, PairSurrogate(profile, separation_m, WEIGHTS).gradient_m(places[0], view))
    expected = np.array([pull.north_m, pull.east_m]) - gradient_m
    np.testing.assert_allclose([found.north_m, found.east_m], expected, rtol=1e-9, atol=1e-6)


# --- loiter


@pytest.mark.parametrize(
    ("speed_m_s", "n_max", "dt_s", "radius_m"),
    [
        (60.0, 1.0, 0.5, 1.5 * 3600.0 / G_M_S2),  # the turn limit decides
        (60.0, 10.0, 5.0, 600.0),  # the step decides
    ],
)
def test_a_loiter_circle_leaves_room_for_the_turn_limit_and_for_the_step(
    speed_m_s: float, n_max: float, dt_s: float, radius_m: float
) -> None:
    assert loiter_radius_m(speed_m_s, n_max, dt_s) == pytest.approx(radius_m)


@given(bearing_rad=HEADINGS)
def test_on_the_loiter_circle_the_pull_runs_clockwise_along_it(bearing_rad: float) -> None:
    place, radius_m = (500.0, -300.0), 100.0
    position = (place[0] + radius_m * math.cos(bearing_rad), place[1] + radius_m * math.sin(bearing_rad))
    pull = loiter_attraction(position, place, radius_m)
    assert abs(math.remainder(pull.heading_rad - (bearing_rad + math.pi / 2.0), math.tau)) < 1e-9
    assert pull.strength_m == pytest.approx(radius_m)


@given(bearing_rad=HEADINGS)
def test_far_outside_the_loiter_circle_the_pull_leads_to_the_place(bearing_rad: float) -> None:
    position = (1e6 * math.cos(bearing_rad), 1e6 * math.sin(bearing_rad))
    pull = loiter_attraction(position, (0.0, 0.0), 100.0)
    assert abs(math.remainder(pull.heading_rad - (bearing_rad + math.pi), math.tau)) < 1e-3
    assert pull.strength_m == pytest.approx(1e6)


@given(bearing_rad=HEADINGS, share=st.floats(0.05, 0.95))
def test_inside_the_loiter_circle_the_pull_leads_outwards_and_still_clockwise(bearing_rad: float, share: float) -> None:
    position = (share * 100.0 * math.cos(bearing_rad), share * 100.0 * math.sin(bearing_rad))
    pull = loiter_attraction(position, (0.0, 0.0), 100.0)
    assert pull.north_m * math.cos(bearing_rad) + pull.east_m * math.sin(bearing_rad) > 0.0
    assert pull.east_m * math.cos(bearing_rad) - pull.north_m * math.sin(bearing_rad) > 0.0
    assert pull.strength_m == pytest.approx(100.0)


@settings(max_examples=60)
@given(
    away=st.floats(0.0, 8.0),
    bearing_rad=HEADINGS,
    heading_rad=HEADINGS,
    speed_m_s=st.floats(10.0, 60.0),
    n_max=st.floats(0.5, 10.0),
)
def test_from_anywhere_the_loiter_reaches_its_circle_and_stays_on_it_clockwise(
    away: float, bearing_rad: float, heading_rad: float, speed_m_s: float, n_max: float
) -> None:
    dt_s, place = 0.5, (1e3, -2e3)
    radius_m = loiter_radius_m(speed_m_s, n_max, dt_s)
    rate_rad_s = turn_rate_rad_s(speed_m_s, n_max)
    north_m = place[0] + away * radius_m * math.cos(bearing_rad)
    east_m = place[1] + away * radius_m * math.sin(bearing_rad)
    settle_s = (away + 4.0 * math.tau) * radius_m / speed_m_s
    settle, circle = int(settle_s / dt_s), int(math.tau * radius_m / speed_m_s / dt_s) + 1
    about_rad = 0.0
    for step in range(settle + circle):
        pull = loiter_attraction((north_m, east_m), place, radius_m)
        wanted_rad, _ = limit_turn(heading_rad, pull.heading_rad, speed_m_s, n_max, dt_s)
        before_rad = math.atan2(east_m - place[1], north_m - place[0])
        north_m, east_m, heading_rad = turn_towards(
            north_m, east_m, heading_rad, speed_m_s, wanted_rad, rate_rad_s, dt_s
        )
        if step >= settle:
            assert 0.9 * radius_m < math.dist((north_m, east_m), place) < 1.2 * radius_m
            about_rad += turned_rad(before_rad, math.atan2(east_m - place[1], north_m - place[0]))
    assert 0.8 * math.tau < about_rad < 1.4 * math.tau


@settings(max_examples=40)
@given(
    speed_m_s=st.floats(12.0, 30.0),
    n_max=st.floats(0.3, 1.0),
    wind=st.floats(0.0, 0.5),
    wind_rad=HEADINGS,
    heading_rad=HEADINGS,
)
def test_a_circle_begun_at_its_place_leads_no_farther_away_than_the_bound_in_wind(
    speed_m_s: float, n_max: float, wind: float, wind_rad: float, heading_rad: float
) -> None:
    dt_s, wind_m_s, place = 0.5, wind * speed_m_s, (0.0, 0.0)
    radius_m = loiter_radius_m(speed_m_s, n_max, dt_s, wind_m_s)
    fastest_m_s = speed_m_s + wind_m_s
    rho_m = fastest_m_s * fastest_m_s / (n_max * G_M_S2)
    north_m = east_m = 0.0
    steps = math.ceil(5.0 * math.tau * radius_m / ((speed_m_s - wind_m_s) * dt_s))
    for step in range(steps):
        across_m_s = wind_m_s * math.sin(wind_rad - heading_rad)
        ground_m_s = wind_m_s * math.cos(wind_rad - heading_rad) + math.sqrt(speed_m_s**2 - across_m_s**2)
        pull = circling((north_m, east_m, heading_rad), ground_m_s, 0.5 * dt_s, place, radius_m)
        wanted_rad, _ = limit_turn(heading_rad, pull.heading_rad, ground_m_s, n_max, dt_s)
        rate_rad_s = turn_rate_rad_s(ground_m_s, n_max)
        north_m, east_m, heading_rad = turn_towards(
            north_m, east_m, heading_rad, ground_m_s, wanted_rad, rate_rad_s, dt_s
        )
        away_m = math.hypot(north_m, east_m)
        assert away_m <= max(radius_m, 2.0 * rho_m) + fastest_m_s * dt_s
        assert step < 0.4 * steps or away_m <= 1.1 * radius_m


@pytest.mark.parametrize(
    ("separation_m", "radius_m", "spacing_m"),
    [(100.0, 0.0, 200.0), (100.0, 50.0, 200.0), (100.0, 51.0, 202.0), (100.0, 500.0, 1100.0)],
)
def test_loiter_places_are_two_separations_apart_or_as_far_as_their_circles_need(
    separation_m: float, radius_m: float, spacing_m: float
) -> None:
    assert loiter_spacing_m(separation_m, radius_m) == spacing_m


PEERS = st.lists(st.tuples(st.floats(-400.0, 400.0), st.floats(-400.0, 400.0)), max_size=6)


def occupied(
    peers: list[tuple[float, float]], claimed: Sequence[tuple[float, float]] = (), claim_m: float = 300.0
) -> Occupied:
    return Occupied(np.array(peers).reshape(-1, 2), 200.0, np.array(claimed).reshape(-1, 2), claim_m)


@given(peers=PEERS, claimed=PEERS)
def test_a_loiter_place_keeps_its_spacing_from_a_handful_of_peers_and_targets(
    peers: list[tuple[float, float]], claimed: list[tuple[float, float]]
) -> None:
    """Half a dozen discs of either kind cannot cover the rings, which reach out to four spacings."""
    place = loiter_place((10.0, 20.0), occupied(peers, claimed))
    assert all(math.dist(place, peer) >= 200.0 for peer in peers)
    assert all(math.dist(place, target) >= 300.0 for target in claimed)


@given(peers=PEERS)
def test_a_free_position_is_its_own_loiter_place(peers: list[tuple[float, float]]) -> None:
    peers = [peer for peer in peers if math.hypot(*peer) >= 200.0]
    assert loiter_place((0.0, 0.0), occupied(peers)) == (0.0, 0.0)


def test_a_loiter_place_is_no_farther_away_than_it_must_be() -> None:
    place = loiter_place((0.0, 0.0), occupied([(50.0, 0.0)], claim_m=0.0))
    assert math.hypot(*place) == pytest.approx(200.0)
    nearer = loiter_place((0.0, 0.0), occupied([(150.0, 0.0)], claim_m=0.0))
    assert math.hypot(*nearer) == pytest.approx(100.0)


def test_a_peer_exactly_one_spacing_away_leaves_the_position_free() -> None:
    assert loiter_place((0.0, 0.0), occupied([(200.0, 0.0)])) == (0.0, 0.0)


CROWD = [(float(north), float(east)) for north in range(-1600, 1601, 100) for east in range(-1600, 1601, 100)]


def test_without_room_anywhere_near_the_position_is_the_loiter_place() -> None:
    assert loiter_place((10.0, 20.0), occupied(CROWD)) == (10.0, 20.0)


def test_who_loiters_stays_where_it_is_though_others_come_near() -> None:
    assert loiter_place((500.0, 0.0), occupied([(20.0, 0.0)]), before_ned_m=(0.0, 0.0)) == (0.0, 0.0)


def test_who_loiters_on_the_target_of_another_makes_room() -> None:
    place = loiter_place((500.0, 0.0), occupied([], [(250.0, 0.0)]), before_ned_m=(0.0, 0.0))
    assert math.dist(place, (250.0, 0.0)) >= 300.0


def test_who_loiters_on_the_target_of_another_stays_if_there_is_no_room_elsewhere() -> None:
    assert loiter_place((5.0, 0.0), occupied(CROWD, [(250.0, 0.0)]), before_ned_m=(0.0, 0.0)) == (0.0, 0.0)


@pytest.mark.parametrize(("separation_m", "radius_m", "wanted_m"), [(20.0, 0.0, 40.0), (100.0, 551.0, 1386.0)])
def test_a_claimed_target_is_left_two_separations_or_what_a_circle_and_two_reserved_discs_need(
    separation_m: float, radius_m: float, wanted_m: float
) -> None:
    assert claim_m(separation_m, radius_m) == pytest.approx(wanted_m, abs=1.0)
