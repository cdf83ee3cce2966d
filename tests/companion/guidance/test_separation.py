"""The rule must keep vehicles apart that know of each other only where they are and how they move."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from companion.geo.kinematics import turn_rate_rad_s, turn_towards
from companion.geo.right_of_way import Rules, interaction_radius_m, reserved_radius_m
from companion.guard.types import Motion
from companion.guidance import separation as right_of_way
from companion.guidance.resolution import (
    CIRCLING,
    EVADING,
    LATE,
    PASSING,
    PIVOTING,
    STOPPING,
    AtEffect,
    Peers,
    Resolution,
)
from companion.guidance.separation import give_way
from tests.benchmarks import swarm

DT_S = 0.5
BRAKING_M_S2 = 3.0
NOBODY_NED_M = np.zeros((0, 2))

PLANES = Rules(separation_m=100.0, n_max=1.0, speed_m_s=60.0)
SLOW_TURNERS = replace(PLANES, n_max=0.5)
COPTERS = Rules(separation_m=20.0, n_max=0.5, speed_m_s=15.0, can_stop=True, braking_m_s2=BRAKING_M_S2)

headings_rad = st.floats(-math.pi, math.pi)
load_factors = st.sampled_from([0.5, 1.0, 2.0, 10.0])
plane_speeds_m_s = st.floats(30.0, 90.0)


def velocity_m_s(motion: Motion) -> tuple[float, float]:
    return motion.speed_m_s * math.cos(motion.heading_rad), motion.speed_m_s * math.sin(motion.heading_rad)


def decide(motion: Motion, wanted_rad: float, others: list[Motion], rules: Rules) -> Resolution:
    places = np.array([(each.north_m, each.east_m) for each in others]).reshape(-1, 2)
    velocities = np.array([velocity_m_s(each) for each in others]).reshape(-1, 2)
    return give_way(wanted_rad, motion, Peers(places, velocities), rules, DT_S)


def circle_centre_m(motion: Motion, n_max: float) -> tuple[float, float]:
    radius_m = motion.speed_m_s / turn_rate_rad_s(motion.speed_m_s, n_max)
    return (
        motion.north_m - radius_m * math.sin(motion.heading_rad),
        motion.east_m + radius_m * math.cos(motion.heading_rad),
    )


def flown(motion: Motion, heading_rad: float, n_max: float, time_s: float) -> Motion:
    rate_rad_s = turn_rate_rad_s(motion.speed_m_s, n_max)
    start = (motion.north_m, motion.east_m, motion.heading_rad)
    return Motion(*turn_towards(*start, motion.speed_m_s, heading_rad, rate_rad_s, time_s), motion.speed_m_s)


def discs_gap_m(first: Motion, second: Motion, rules: Rules) -> float:
    radii_m = sum(each.speed_m_s / turn_rate_rad_s(each.speed_m_s, rules.n_max) for each in (first, second))
    centres = circle_centre_m(first, rules.n_max), circle_centre_m(second, rules.n_max)
    return math.dist(*centres) - radii_m - rules.separation_m


def test_a_vehicle_that_is_alone_flies_where_it_wants() -> None:
    chosen = give_way(7.0, Motion(0.0, 0.0, 1.0, 60.0), Peers(NOBODY_NED_M, NOBODY_NED_M), PLANES, DT_S)
    assert chosen == Resolution(7.0 - math.tau, 60.0, None)


@given(headings_rad, headings_rad, headings_rad, headings_rad, load_factors, st.booleans())
def test_nothing_is_changed_beyond_the_interaction_radius(
    bearing: float, heading: float, peer_heading: float, wanted: float, n_max: float, can_stop: bool
) -> None:
    rules = replace(COPTERS if can_stop else PLANES, n_max=n_max)
    radius_m = interaction_radius_m(rules, DT_S) + 0.01
    peer = Motion(radius_m * math.cos(bearing), radius_m * math.sin(bearing), peer_heading, rules.speed_m_s)
    chosen = decide(Motion(0.0, 0.0, heading, rules.speed_m_s), wanted, [peer], rules)
    assert chosen.reason is None
    assert chosen.heading_rad == wanted % math.tau


@given(
    st.lists(st.tuples(headings_rad, headings_rad, plane_speeds_m_s), min_size=2, max_size=2),
    headings_rad,
    st.floats(0.0, 150.0),
    load_factors,
)
def test_reserved_discs_that_do_not_overlap_never_will(
    pair: list[tuple[float, float, float]], bearing: float, gap_m: float, n_max: float
) -> None:
    rules = replace(PLANES, n_max=n_max)
    first = Motion(0.0, 0.0, pair[0][0], pair[0][2])
    second = Motion(0.0, 0.0, pair[1][0], pair[1][2])
    apart_m = gap_m - discs_gap_m(first, first, rules) / 2 - discs_gap_m(second, second, rules) / 2
    ours, theirs = circle_centre_m(first, n_max), circle_centre_m(second, n_max)
    second = replace(
        second,
        north_m=ours[0] + apart_m * math.cos(bearing) - theirs[0],
        east_m=ours[1] + apart_m * math.sin(bearing) - theirs[1],
    )
    assert discs_gap_m(first, second, rules) == pytest.approx(gap_m, abs=1e-6)
    decisions = [decide(first, pair[0][1], [second], rules), decide(second, pair[1][1], [first], rules)]
    for part in range(1, 11):
        after = [
            flown(m, d.heading_rad, n_max, DT_S * part / 10) for m, d in zip((first, second), decisions, strict=True)
        ]
        assert discs_gap_m(after[0], after[1], rules) >= -1e-3
        assert math.dist((after[0].north_m, after[0].east_m), (after[1].north_m, after[1].east_m)) >= 100.0 - 1e-3


@settings(max_examples=40)
@given(headings_rad, st.floats(0.0, 1.0), st.floats(0.05, 2.8), st.floats(0.0, 60.0))
@example(-math.pi / 2 + 0.4, 1.0, 0.8, 3.0)  # goes out and comes back within the step
def test_a_left_turn_is_allowed_if_and_only_if_the_centre_stays_in_its_share(
    heading: float, part: float, step_turn_rad: float, share_m: float
) -> None:
    rate_rad_s = step_turn_rad / DT_S
    n_max = rate_rad_s * 60.0 / turn_rate_rad_s(1.0, 1.0)
    motion, turn_rad = Motion(0.0, 0.0, heading, 60.0), -part * step_turn_rad
    begun_m = circle_centre_m(motion, n_max)[0]
    times_s = np.linspace(0.0, DT_S, 101).tolist()
    ways_m = [circle_centre_m(flown(motion, heading + turn_rad, n_max, t), n_max)[0] - begun_m for t in times_s]
    north = [right_of_way._Neighbour(0, 0.0, share_m)]
    if right_of_way._left_turn_allowed(motion, turn_rad, rate_rad_s, DT_S, north):
        assert max(ways_m) <= share_m + 1e-6
    else:
        assert max(ways_m) > share_m - 0.01


def way_m(craft: swarm.Craft) -> np.ndarray:  # (101, 2) m
    """Return places along the straight way on which a craft comes to a stop if it brakes now."""
    ahead_m = craft.speed_m_s**2 / (2.0 * BRAKING_M_S2) * np.linspace(0.0, 1.0, 101)
    north_m, east_m = np.cos(craft.heading_rad) * ahead_m, np.sin(craft.heading_rad) * ahead_m
    return np.stack((craft.north_m + north_m, craft.east_m + east_m), axis=1)


def ways_apart_m(first: swarm.Craft, second: swarm.Craft) -> float:
    offset_m = way_m(first)[:, None] - way_m(second)[None]
    return float(np.hypot(offset_m[..., 0], offset_m[..., 1]).min())


@given(
    st.lists(st.tuples(headings_rad, headings_rad, st.floats(0.0, 15.0)), min_size=2, max_size=2),
    headings_rad,
    st.floats(0.0, 40.0),
)
@example([(0.0, 0.0, 0.0), (-2.0, 0.0, 0.5)], 0.0, 0.75)  # one gathers way
@example([(0.0, 0.0, 0.0), (0.0, 0.0, 0.0)], math.pi / 2, 0.0)  # two that stand at the separation
@example([(math.pi / 2, -1.5, 15.0), (-math.pi / 2, 1.6, 15.0)], 0.0, 0.0)  # both want to turn about
@example([(0.8671875, 0.0, 14.0), (0.8671875, 0.0, 7.0)], 0.8671875, 0.0)  # one follows the other, but for rounding
def test_ways_to_a_stop_that_are_apart_stay_apart(
    pair: list[tuple[float, float, float]], bearing: float, gap_m: float
) -> None:
    crafts = [swarm.Craft(0.0, 0.0, heading, speed, None) for heading, _, speed in pair]
    crafts[1].north_m, crafts[1].east_m = 120.0 * math.cos(bearing), 120.0 * math.sin(bearing)
    # As near as the ways allow, but for the gap.
    for _ in range(40):
        closer_m = ways_apart_m(*crafts) - COPTERS.separation_m - gap_m
        crafts[1].north_m -= closer_m * math.cos(bearing)
        crafts[1].east_m -= closer_m * math.sin(bearing)
    before_m = ways_apart_m(*crafts)
    assume(before_m >= COPTERS.separation_m)
    motions = [Motion(c.north_m, c.east_m, c.heading_rad, c.speed_m_s) for c in crafts]
    decisions = [decide(motions[k], pair[k][1], [motions[1 - k]], COPTERS) for k in (0, 1)]
    for craft, decision in zip(crafts, decisions, strict=True):
        heading_rad = swarm._reachable_rad(craft, swarm._at_effect(craft, COPTERS), decision, COPTERS)
        swarm._step(craft, heading_rad, decision.speed_m_s, COPTERS)
    # The harness flies pieces at their mean speed: one in which a craft comes to a stop is too long by up to this.
    piece_s = DT_S / swarm.PIECES
    assert ways_apart_m(*crafts) >= COPTERS.separation_m - len(crafts) * BRAKING_M_S2 * piece_s**2 / 8.0 - 1e-2


@given(
    st.lists(st.tuples(st.floats(20.0, 60.0), headings_rad), min_size=1, max_size=6),
    headings_rad,
    headings_rad,
    st.floats(0.0, 1.0),
)
def test_a_vehicle_that_stands_may_leave_everybody_who_stands_on_one_side(
    others: list[tuple[float, float]], side: float, yaw: float, reaction_s: float
) -> None:
    around = [(apart_m, side + 0.49 * turn_rad) for apart_m, turn_rad in others]
    peers = [Motion(apart_m * math.cos(at), apart_m * math.sin(at), 0.0, 0.0) for apart_m, at in around]
    rules = replace(COPTERS, reaction_s=reaction_s)
    craft = swarm.Craft(0.0, 0.0, yaw, 0.0, None)
    while craft.speed_m_s == 0.0:
        chosen = decide(Motion(0.0, 0.0, craft.heading_rad, 0.0), side + math.pi, peers, rules)
        turned_rad = abs(math.remainder(chosen.heading_rad - craft.heading_rad, math.tau))
        assert chosen.speed_m_s > 0.0 or (chosen.reason == PIVOTING and turned_rad > 0.1)
        swarm._step(craft, chosen.heading_rad, chosen.speed_m_s, rules)
    assert all(math.dist((craft.north_m, craft.east_m), each.position_ned_m) >= 20.0 - 1e-9 for each in peers)


@pytest.mark.parametrize("rules", [PLANES, SLOW_TURNERS, replace(PLANES, n_max=10.0), COPTERS])
def test_two_that_meet_head_on_pass_each_other_on_the_left(rules: Rules) -> None:
    there_m = 2.5 * interaction_radius_m(rules, DT_S)
    crafts = [
        swarm.bound((0.0, 0.0), (there_m, 0.0), rules.speed_m_s, 0),
        swarm.bound((there_m, 0.0), (0.0, 0.0), rules.speed_m_s, 1),
    ]
    easts_m: list[float] = []

    def watch(shape: tuple[int, ...]) -> np.ndarray:
        easts_m.append(crafts[0].east_m)
        return np.zeros(shape)

    outcome = swarm.fly(crafts, rules, 600.0, arrival_radius_m=30.0, noise=watch)
    assert (outcome.arrived, outcome.breaches) == (2, 0)
    assert max(easts_m) > 0.4 * rules.separation_m and min(easts_m) > -1.0


def test_two_that_meet_head_on_and_do_not_give_way_come_too_close() -> None:
    crafts = [swarm.bound((0.0, 0.0), (4000.0, 0.0), 60.0, 0), swarm.bound((4000.0, 0.0), (0.0, 0.0), 60.0, 1)]
    assert swarm.fly(crafts, PLANES, 600.0, give=False).breaches == 1


def test_who_is_overtaken_holds_its_course_and_who_overtakes_leaves_it_on_the_left() -> None:
    slow, fast = Motion(0.0, 0.0, 0.0, 40.0), Motion(-650.0, -200.0, 0.0, 60.0)
    assert 0.0 < discs_gap_m(slow, fast, PLANES) < 30.0
    assert decide(slow, 0.0, [fast], PLANES).reason is None
    chosen = decide(fast, 0.0, [slow], PLANES)
    assert chosen.reason == PASSING
    assert 0.0 < chosen.heading_rad < math.pi


def test_the_faster_of_two_on_one_course_overtakes() -> None:
    crafts = [swarm.bound((2500.0, 0.0), (20000.0, 0.0), 40.0, 0), swarm.bound((0.0, 0.0), (20000.0, 2000.0), 60.0, 1)]
    outcome = swarm.fly(crafts, PLANES, 900.0)
    assert (outcome.arrived, outcome.breaches) == (2, 0)
    first_s, second_s = crafts[1].done_s, crafts[0].done_s
    assert first_s is not None and second_s is not None
    assert first_s < second_s


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "count", "free", "rules"),
    [
        ("circle", 10, 12.0, PLANES),
        ("circle", 10, 12.0, replace(PLANES, n_max=10.0)),
        ("random", 12, 12.0, PLANES),
        ("streams", 10, 12.0, PLANES),
        ("loiterers", 10, 12.0, PLANES),
        ("converge", 10, 12.0, PLANES),
    ],
)
def test_a_swarm_arrives_and_keeps_apart(scene: str, count: int, free: float, rules: Rules) -> None:
    crafts = swarm.SCENES[scene](count, free, rules, np.random.default_rng(0))
    outcome = swarm.fly(crafts, rules, 1500.0, 50.0)
    assert outcome.bound > 0
    assert (outcome.arrived, outcome.breaches) == (outcome.bound, 0)


@pytest.mark.parametrize("scene", ["circle", "random"])
def test_a_swarm_that_can_stop_arrives_and_keeps_apart(scene: str) -> None:
    crafts = swarm.SCENES[scene](10, 8.0, COPTERS, np.random.default_rng(0))
    outcome = swarm.fly(crafts, COPTERS, 600.0, 20.0, arrival_radius_m=10.0)
    assert (outcome.arrived, outcome.breaches) == (10, 0)


@pytest.mark.parametrize("rules", [PLANES, COPTERS])
def test_the_stated_position_error_widens_the_gap_that_is_kept(rules: Rules) -> None:
    told = replace(rules, position_error_m=20.0)
    assert interaction_radius_m(told, DT_S) == pytest.approx(interaction_radius_m(rules, DT_S) + 40.0)
    motion = Motion(0.0, 0.0, 0.0, rules.speed_m_s)
    # Straight ahead and flying the same way, just so far that we may keep our course if positions are exact.
    distance_m = 2.0 * reserved_radius_m(rules.speed_m_s, rules, DT_S) + 2.1 * rules.speed_m_s * DT_S
    peer = Motion(distance_m, 0.0, 0.0, rules.speed_m_s)
    assert decide(motion, 0.0, [peer], rules).reason is None
    assert decide(motion, 0.0, [peer], told).reason is not None


def test_neighbours_whose_positions_jitter_by_the_stated_error_keep_apart_and_arrive() -> None:
    rules, rng = replace(PLANES, position_error_m=20.0), np.random.default_rng(0)

    def noise(shape: tuple[int, ...]) -> np.ndarray:
        angle = rng.uniform(0.0, math.tau, shape[0])
        return 20.0 * np.stack((np.cos(angle), np.sin(angle)), axis=1)

    outcome = swarm.fly(swarm.circle(5, 16.0, rules, rng), rules, 600.0, noise=noise)
    assert (outcome.arrived, outcome.breaches) == (5, 0)


def test_what_both_may_still_do_before_a_decision_takes_effect_is_kept_free() -> None:
    late = replace(PLANES, reaction_s=1.0)
    assert interaction_radius_m(late, DT_S) == interaction_radius_m(PLANES, DT_S) + 4.0 * 60.0
    motion, distance_m = Motion(0.0, 0.0, 0.0, 60.0), 2.0 * reserved_radius_m(60.0, PLANES, DT_S)
    assert decide(motion, 0.0, [Motion(distance_m + 220.0, 0.0, 0.0, 60.0)], PLANES).reason is None
    assert decide(motion, 0.0, [Motion(distance_m + 220.0, 0.0, 0.0, 60.0)], late).reason == PASSING


def test_decisions_that_take_effect_a_second_late_break_nothing_if_the_rules_say_so() -> None:
    rules = replace(PLANES, reaction_s=1.0)
    outcome = swarm.fly(swarm.circle(5, 20.0, rules, np.random.default_rng(0)), rules, 600.0)
    assert (outcome.arrived, outcome.breaches) == (5, 0)


def test_discs_that_overlap_after_all_are_led_apart() -> None:
    distance_m = 2.0 * reserved_radius_m(60.0, PLANES, DT_S) - 10.0
    chosen = decide(Motion(0.0, 0.0, 0.0, 60.0), 0.0, [Motion(distance_m, 0.0, 0.0, 60.0)], PLANES)
    assert chosen.reason == PASSING
    assert math.cos(chosen.heading_rad) < -0.1


def test_a_neighbour_seen_too_late_to_the_right_is_not_turned_into() -> None:
    crafts = [
        swarm.Craft(0.0, 0.0, 0.0, 60.0, (20000.0, 0.0), 0),
        swarm.Craft(4000.0, 1300.0, math.pi, 60.0, (-16000.0, 1300.0), 1),
    ]
    outcome = swarm.fly(crafts, SLOW_TURNERS, 600.0)
    assert (outcome.arrived, outcome.breaches) == (2, 0)
    assert outcome.least_m > 4.0 * SLOW_TURNERS.separation_m


def test_a_neighbour_on_a_collision_course_inside_our_disc_is_avoided_with_that_reason() -> None:
    chosen = decide(Motion(0.0, 0.0, 0.0, 60.0), 0.0, [Motion(1000.0, 900.0, -2.4, 60.0)], SLOW_TURNERS)
    assert chosen.reason == LATE


def test_a_circle_to_the_right_goes_on_from_the_heading_at_which_the_decision_takes_effect() -> None:
    # Eight neighbours all round that fly as we do, each disc a metre off ours.
    ring_m = 2.0 * reserved_radius_m(60.0, PLANES, DT_S) + 1.0
    bearings_rad = math.tau / 8 * np.arange(8)
    around = Peers(ring_m * np.column_stack((np.cos(bearings_rad), np.sin(bearings_rad))), np.tile((60.0, 0.0), (8, 1)))
    motion, step_turn_rad = Motion(0.0, 0.0, 0.0, 60.0), turn_rate_rad_s(60.0, 1.0) * DT_S
    for heading_rad in (0.0, 1.0):
        chosen = give_way(0.0, motion, around, PLANES, DT_S, AtEffect(heading_rad, 60.0))
        assert chosen.reason == CIRCLING
        assert chosen.heading_rad == pytest.approx(heading_rad + step_turn_rad)


def test_a_vehicle_that_can_stop_and_has_no_free_way_stops() -> None:
    # Six standing neighbours all round, at the separation.
    ring = [Motion(20.0 * math.cos(k * math.tau / 6), 20.0 * math.sin(k * math.tau / 6), 0.0, 0.0) for k in range(6)]
    chosen = decide(Motion(0.0, 0.0, 0.0, 0.0), 0.0, ring, COPTERS)
    assert (chosen.speed_m_s, chosen.reason) == (0.0, STOPPING)


@pytest.mark.parametrize("start_ned_m", [(67.0, 55.0), (69.0, 54.0), (70.0, 57.5), (72.0, 53.0)])
def test_where_keeping_right_would_lead_back_between_two_that_stand_it_passes_on_the_left(
    start_ned_m: tuple[float, float],
) -> None:
    rules = Rules(separation_m=5.0, n_max=0.5, speed_m_s=3.0, can_stop=True, braking_m_s2=4.0)
    standing = [swarm.Craft(79.3, 57.5, 0.0, 0.0, None), swarm.Craft(66.0, 62.9, 0.0, 0.0, None)]
    outcome = swarm.fly([swarm.bound(start_ned_m, (94.8, 52.8), 3.0, 0), *standing], rules, 60.0, arrival_radius_m=2.0)
    assert (outcome.arrived, outcome.breaches) == (1, 0)


def test_a_vehicle_that_can_stop_must_say_how_hard_it_brakes() -> None:
    with pytest.raises(ValueError, match="braking_m_s2"):
        decide(Motion(0.0, 0.0, 0.0, 5.0), 0.0, [Motion(50.0, 0.0, 0.0, 5.0)], replace(COPTERS, braking_m_s2=None))


@pytest.mark.slow
def test_an_exactly_symmetric_circle_resolves_only_because_shares_are_uneven(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(right_of_way, "UNEVENNESS", 0.0)
    outcome = swarm.fly(swarm.circle(10, 16.0, PLANES, np.random.default_rng(0)), PLANES, 240.0)
    assert outcome.arrived == 0
    monkeypatch.undo()
    outcome = swarm.fly(swarm.circle(10, 16.0, PLANES, np.random.default_rng(0)), PLANES, 240.0)
    assert outcome.arrived == 10


# A stranger, who keeps to no rule


@pytest.mark.parametrize(("east_m", "heading_rad"), [(0.0, math.pi / 2.0), (5.0, math.pi / 2.0), (-5.0, 1.5 * math.pi)])
def test_a_copter_makes_way_across_the_course_of_a_stranger_to_the_side_on_which_it_is(
    east_m: float, heading_rad: float
) -> None:
    """The stranger comes from the north; straight ahead this vehicle turns to its right."""
    motion, at_it = Motion(0.0, east_m, 0.0, 10.0), np.array([[60.0, 0.0]])
    peers = Peers(at_it, np.array([[-15.0, 0.0]]), np.array([True]))
    chosen = give_way(0.0, motion, peers, COPTERS, DT_S)
    assert (chosen.reason, chosen.speed_m_s, chosen.peer) == (EVADING, COPTERS.speed_m_s, 0)
    assert chosen.heading_rad == pytest.approx(heading_rad)


@pytest.mark.parametrize(
    ("place", "velocity", "stranger"),
    [
        ((60.0, 0.0), (-15.0, 0.0), False),
        ((60.0, 41.0), (-15.0, 0.0), True),
        ((-60.0, 0.0), (-15.0, 0.0), True),
        ((1_000.0, 0.0), (-15.0, 0.0), True),
        ((60.0, 0.0), (-0.1, 0.0), True),
    ],
    ids=["of the fleet", "passing", "flying away", "far away", "standing"],
)
def test_who_is_of_the_fleet_or_does_not_come_at_it_is_no_stranger_to_flee(
    place: tuple[float, float], velocity: tuple[float, float], stranger: bool
) -> None:
    peers = Peers(np.array([place]), np.array([velocity]), np.array([stranger]))
    assert give_way(0.0, Motion(0.0, 0.0, 0.0, 10.0), peers, COPTERS, DT_S).reason != EVADING
