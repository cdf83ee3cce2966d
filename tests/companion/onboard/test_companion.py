"""The companion as a whole: real frames in, a setpoint and its reasons out, and silence whenever a person steers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.autopilot.aircraft import NEIGHBOUR_MEMORY_S
from companion.autopilot.registry import ADAPTERS
from companion.autopilot.telemetry import HEARTBEAT_TIMEOUT_S
from companion.geo.kinematics import turn_towards
from companion.guard.types import KEEP_OUT, NEW_THREAT, Motion, Verdict
from companion.guidance.laws import SteeringDemand, Task
from companion.guidance.resolution import PASSING, PIVOTING, SLOWING, STOPPING
from companion.guidance.settings import LAWS
from companion.guidance.steering import SteeringVector
from companion.guidance.view import View
from companion.onboard.companion import HOME_TOO_FAR, Companion
from companion.onboard.config import Config
from companion.onboard.decision import Decision, Purpose
from companion.onboard.failsafe import Stage
from companion.onboard.goal import ARRIVAL_SHARE
from companion.protocol.authenticator import Authenticator, Trust
from companion.protocol.codec import (
    AgentEntry,
    AgentMotion,
    BandEntry,
    Directive,
    FrameReader,
    FrameWriter,
    MotionFrame,
    PointMotion,
    ReportFrame,
    Stamp,
    StateFrame,
    ThreatEntry,
)
from tests.companion.onboard.companion_flight import (
    CONFIG,
    EPOCH_S,
    FRAME,
    GUIDED,
    GUIDED_MODE,
    KINDS,
    ME,
    NOW_S,
    SYSTEM,
    Flight,
    guided,
)

BY_F_STAR = CONFIG.model_copy(update={"law": "seed"})
"""Steered by the surrogate's gradient, which neighbours push: no right of way."""


# When it steers at all


def test_it_is_idle_until_an_autopilot_is_heard() -> None:
    flight = Flight()
    flight.broadcast()
    decision, setpoint = flight.tick()
    assert (decision.purpose, decision.reason, setpoint) == (Purpose.IDLE, "no autopilot heard", None)


@pytest.mark.parametrize(
    ("base_mode", "custom_mode"),
    [
        (common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, GUIDED_MODE),
        (GUIDED, 5),
        (GUIDED, 6),
        (common.MAV_MODE_FLAG_SAFETY_ARMED, GUIDED_MODE),
    ],
)
def test_it_is_idle_until_a_person_arms_and_chooses_guided(base_mode: int, custom_mode: int) -> None:
    flight = Flight()
    flight.broadcast()
    flight.heartbeat(base_mode, custom_mode)
    decision, setpoint = flight.at()
    assert (decision.purpose, decision.reason, setpoint) == (Purpose.IDLE, "not armed and in the guided mode", None)


def test_it_is_idle_until_it_knows_where_it_is() -> None:
    flight = Flight()
    flight.broadcast()
    flight.heartbeat()
    decision, setpoint = flight.tick()
    assert (decision.purpose, decision.reason, setpoint) == (Purpose.IDLE, "no position yet", None)


def test_it_is_idle_when_its_position_is_too_old() -> None:
    flight = guided()
    flight.broadcast()
    flight.now_s += CONFIG.telemetry_timeout_s
    assert flight.tick()[1] is not None
    flight.now_s += 0.1
    decision, setpoint = flight.tick()
    assert (decision.purpose, decision.reason, setpoint) == (Purpose.IDLE, "position too old", None)


def test_a_change_of_mode_stops_the_setpoints_with_the_next_tick() -> None:
    flight = guided()
    flight.broadcast()
    assert flight.tick()[1] is not None
    flight.heartbeat(GUIDED, 5)
    decision, setpoint = flight.tick()
    assert (decision.purpose, setpoint) == (Purpose.IDLE, None)


def test_it_steers_again_when_the_person_gives_it_back() -> None:
    flight = guided()
    flight.broadcast()
    flight.heartbeat(GUIDED, 5)
    flight.tick()
    flight.heartbeat()
    assert flight.tick()[0].purpose is Purpose.TARGET


def test_a_heartbeat_goes_out_once_a_second_even_when_idle() -> None:
    companion = Companion(CONFIG)
    beats_s = []
    for step in range(50):
        _, datagrams = companion.tick(NOW_S + 0.1 * step)
        for datagram in datagrams:
            (message,) = common.MAVLink(None).parse_buffer(bytearray(datagram))
            assert message.type == common.MAV_TYPE_ONBOARD_CONTROLLER
            beats_s.append(0.1 * step)
    assert len(beats_s) == pytest.approx(5, abs=1)
    assert all(later - sooner >= 1.0 - 1e-6 for sooner, later in zip(beats_s, beats_s[1:], strict=False))


def test_it_is_idle_below_the_height_where_steering_begins() -> None:
    flight = guided()
    flight.broadcast()
    flight.position(height_mm=4_900)
    decision, setpoint = flight.tick()
    words = "below limits.height_min_m 5 m at 4.9 m: climb in another mode, then hand over again"
    assert (decision.purpose, decision.reason, setpoint) == (Purpose.IDLE, words, None)
    flight.position(height_mm=5_000)
    assert flight.tick()[0].purpose is Purpose.TARGET
    flight.position(height_mm=4_900)
    assert flight.tick()[0].purpose is Purpose.TARGET


# What it does


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_without_a_picture_it_is_idle_and_engages_with_the_first(kind: str) -> None:
    flight = guided(kind=kind)
    decision, setpoint = flight.tick()
    assert (decision.purpose, decision.reason, setpoint) == (Purpose.IDLE, "no picture", None)
    flight.broadcast()
    assert flight.tick()[0].purpose is Purpose.TARGET


FIVE = tuple(ThreatEntry(k, 9_000.0, 3_000.0 * k, 400.0, 200.0, 0.0) for k in range(1, 6))
"""Threats out of the way, in two frames."""


def test_with_a_part_of_the_picture_it_does_not_engage_and_says_what_is_missing() -> None:
    flight = guided()
    flight.broadcast(threats=FIVE, lost=(1,))
    assert (flight.tick()[0].purpose, flight.tick()[0].reason) == (Purpose.IDLE, "4 of 5 threats heard")
    flight.broadcast(threats=FIVE, lost=(0,))
    assert flight.tick()[0].purpose is Purpose.TARGET


def test_a_new_revision_heard_in_part_makes_it_loiter_until_the_rest_is_heard() -> None:
    flight = guided()
    flight.broadcast(threats=FIVE)
    assert flight.tick()[0].purpose is Purpose.TARGET
    flight.broadcast(threats=FIVE, revision=2, lost=(0,))
    decision, _ = flight.tick()
    words = "new revision: 1 of 5 threats heard"
    assert (decision.purpose, decision.stage, decision.reason) == (Purpose.LOITER, Stage.LOITERING, words)
    assert words in decision.triggers
    flight.broadcast(threats=FIVE, revision=2, lost=(1,))
    assert flight.tick()[0].purpose is Purpose.TARGET


def test_a_directive_in_a_frame_of_a_part_of_a_picture_is_obeyed() -> None:
    flight = guided()
    flight.broadcast(threats=FIVE)
    flight.tick()
    flight.at(2_000.0, 0.0)
    flight.broadcast(threats=FIVE, revision=2, lost=(0,), directive=Directive.RETURN)
    decision, _ = flight.tick()
    assert (decision.purpose, decision.reason) == (Purpose.RETURN, "directive return")


def test_with_an_old_picture_it_does_not_engage() -> None:
    flight = guided()
    flight.broadcast()
    flight.now_s += 60.0
    decision, setpoint = flight.at()
    assert (decision.purpose, decision.reason, setpoint) == (Purpose.IDLE, "picture too old", None)


@pytest.mark.parametrize("kind", KINDS)
def test_without_a_target_it_loiters_where_it_is(kind: str) -> None:
    flight = guided(kind=kind)
    flight.broadcast(None)
    _, setpoint = flight.tick()
    assert setpoint is not None
    assert math.hypot(setpoint.vx, setpoint.vy) == pytest.approx(0.0 if kind == "arducopter" else 10.0, abs=1e-3)


def test_with_a_target_it_heads_for_it_at_full_speed() -> None:
    flight = guided()
    flight.broadcast((4_000.0, 3_000.0))
    # Already under way, so that the turn limit has nothing to say.
    decision, setpoint = flight.at(velocity=(8.0, 6.0))
    assert (decision.purpose, decision.reason, decision.target_id) == (Purpose.TARGET, "assigned", 4)
    assert decision.wanted_heading_rad == pytest.approx(math.atan2(3_000.0, 4_000.0), abs=0.01)
    assert setpoint is not None
    assert (setpoint.vx, setpoint.vy) == pytest.approx((8.0, 6.0), abs=0.1)
    assert setpoint.target_system == SYSTEM


def test_a_turn_faster_than_the_limit_is_cut_and_said_to_be() -> None:
    flight = guided(CONFIG.model_copy(update={"limits": CONFIG.limits.model_copy(update={"n_max": 0.1})}))
    flight.broadcast((1_000.0, 5_000.0))
    decision, setpoint = flight.at(velocity=(10.0, 0.0))
    assert decision.turn_limited
    assert setpoint is not None
    greatest_rad = 0.1 * 9.80665 / 10.0 * CONFIG.guidance_step_s
    assert abs(math.atan2(setpoint.vy, setpoint.vx)) == pytest.approx(greatest_rad, abs=1e-3)


def test_far_from_the_origin_the_heading_is_turned_to_local_north() -> None:
    flight = Flight()
    flight.heartbeat()
    flight.broadcast((0.0, 200_000.0))
    convergence_rad = FRAME.convergence_rad(0.0, 150_000.0)
    assert abs(convergence_rad) > math.radians(1.0)
    _, setpoint = flight.at(0.0, 150_000.0, (10.0 * math.cos(math.pi / 2), 10.0))
    assert setpoint is not None
    heading_rad = math.atan2(setpoint.vy, setpoint.vx)
    assert heading_rad == pytest.approx(math.pi / 2 + convergence_rad, abs=0.005)


def test_it_turns_away_from_a_threat_in_its_way() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0), threats=(ThreatEntry(1, 1_000.0, 100.0, 400.0, 200.0, 0.0),))
    decision, _ = flight.at(600.0, 0.0, (10.0, 0.0))
    assert math.remainder(decision.wanted_heading_rad, math.tau) < -0.05


def test_the_guard_has_the_last_word_and_says_so() -> None:
    blind_law = CONFIG.model_copy(update={"law": "step", "keep_out": "attack"})
    flight = guided(blind_law)
    flight.broadcast((5_000.0, 0.0), threats=(ThreatEntry(1, 1_000.0, 0.0, 400.0, 200.0, 0.0),))
    decision, setpoint = flight.at(770.0, 0.0, (10.0, 0.0))
    assert decision.guard_changes == ("keep-out",)
    assert setpoint is not None
    assert (setpoint.vx, setpoint.vy) != pytest.approx((10.0, 0.0), abs=0.1)


def test_the_guard_keeps_out_of_the_detection_disc_unless_told_otherwise() -> None:
    flight = guided(CONFIG.model_copy(update={"law": "step"}))
    flight.broadcast((5_000.0, 0.0), threats=(ThreatEntry(1, 1_000.0, 0.0, 400.0, 200.0, 0.0),))
    assert flight.at(575.0, 0.0, (10.0, 0.0))[0].guard_changes == ("keep-out",)


def test_arrived_it_loiters() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0))
    decision, _ = flight.at(5_000.0 - ARRIVAL_SHARE * 100.0 + 1.0, 0.0)
    assert (decision.purpose, decision.reason) == (Purpose.LOITER, "arrived")


def test_who_has_arrived_stays_arrived_until_the_target_moves_away() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0))
    assert flight.at(5_000.0 - 90.0)[0].purpose is Purpose.TARGET
    assert flight.at(5_000.0)[0].reason == "arrived"
    assert flight.at(5_000.0 - 150.0)[0].reason == "arrived"
    flight.broadcast((5_021.0, 0.0))
    assert flight.at(5_000.0 - 150.0)[0].purpose is Purpose.TARGET


def test_a_person_taking_over_makes_it_forget_that_it_had_arrived() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0))
    flight.at(5_000.0)
    flight.heartbeat(GUIDED, 5)
    flight.tick()
    flight.heartbeat()
    assert flight.at(5_000.0 - 90.0)[0].purpose is Purpose.TARGET


def test_without_a_target_it_loiters() -> None:
    flight = guided()
    flight.broadcast(None)
    decision, _ = flight.tick()
    assert (decision.purpose, decision.reason, decision.target_id) == (Purpose.LOITER, "no target", None)


def test_it_holds_on_the_directive_hold() -> None:
    flight = guided()
    flight.broadcast(directive=Directive.HOLD)
    decision, setpoint = flight.tick()
    assert (decision.purpose, decision.reason) == (Purpose.LOITER, "directive hold")
    assert setpoint is not None
    assert math.hypot(setpoint.vx, setpoint.vy) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("for_all", "own", "purpose", "reason"),
    [
        (Directive.NORMAL, Directive.HOLD, Purpose.LOITER, "directive hold, for this agent"),
        (Directive.HOLD, Directive.RETURN, Purpose.RETURN, "directive return, for this agent"),
        (Directive.RETURN, Directive.HOLD, Purpose.RETURN, "directive return"),
        (Directive.HOLD, Directive.HOLD, Purpose.LOITER, "directive hold"),
    ],
)
def test_it_obeys_the_stronger_of_its_own_directive_and_that_for_all_and_says_which(
    for_all: Directive, own: Directive, purpose: Purpose, reason: str
) -> None:
    flight = guided()
    flight.home(-2_000.0, 0.0)
    flight.broadcast(directive=for_all, own=own)
    decision, _ = flight.at()
    assert (decision.purpose, decision.reason) == (purpose, reason)


def test_after_the_last_broadcast_it_flies_on_as_after_any_loss_and_says_at_once_that_nothing_is_broken() -> None:
    flight, silent = guided(), guided()
    flight.broadcast(is_last=True)
    silent.broadcast()
    for _ in range(3):
        (decision, _), (as_ever, _) = flight.tick(), silent.tick()
        assert decision.note == "the ground station has stopped"
        assert as_ever.note is None
        assert decision == replace(as_ever, note=decision.note)
    flight.broadcast()
    decision, _ = flight.tick()
    assert decision.note is None


def test_it_comes_home_on_the_directive_return_and_loiters_there() -> None:
    flight = guided()
    flight.home(-2_000.0, 0.0)
    flight.broadcast(directive=Directive.RETURN)
    decision, _ = flight.at(velocity=(-10.0, 0.0))
    assert (decision.purpose, decision.reason) == (Purpose.RETURN, "directive return")
    assert abs(decision.wanted_heading_rad) == pytest.approx(math.pi, abs=0.01)
    decision, _ = flight.at(-1_990.0, 0.0)
    assert (decision.purpose, decision.reason) == (Purpose.LOITER, "directive return: home")


def test_without_a_home_it_returns_to_where_it_began_to_steer() -> None:
    flight = guided()
    flight.broadcast()
    flight.at(0.0, 0.0)
    flight.broadcast(directive=Directive.RETURN)
    decision, _ = flight.at(0.0, 3_000.0, (0.0, -10.0))
    assert decision.purpose is Purpose.RETURN
    assert decision.wanted_heading_rad == pytest.approx(1.5 * math.pi, abs=0.01)


@pytest.mark.parametrize("kind", KINDS)
def test_a_vehicle_of_any_kind_that_loiters_where_it_arrived_flies_to_the_next_target(kind: str) -> None:
    flight = guided(kind=kind)
    flight.broadcast((1_000.0, 0.0))
    velocity = (15.0, 0.0) if kind.endswith("plane") else (0.0, 0.0)
    for _ in range(3):
        decision, _ = flight.at(1_000.0, 0.0, velocity)
    assert (decision.purpose, decision.reason) == (Purpose.LOITER, "arrived")
    flight.broadcast((1_000.0, 4_000.0))
    decision, _ = flight.at(1_000.0, 0.0, velocity)
    assert (decision.purpose, decision.reason) == (Purpose.TARGET, "assigned")


def test_the_directive_normal_sets_it_going_again() -> None:
    flight = guided()
    flight.broadcast(directive=Directive.HOLD)
    flight.tick()
    flight.broadcast()
    assert flight.tick()[0].purpose is Purpose.TARGET


# Losing the broadcast


@pytest.mark.parametrize(
    ("age_s", "stage", "purpose", "reason"),
    [
        (0.0, Stage.FRESH, Purpose.TARGET, "assigned"),
        (14.9, Stage.FRESH, Purpose.TARGET, "assigned"),
        (15.0, Stage.COASTING, Purpose.TARGET, "assigned"),
        (59.9, Stage.COASTING, Purpose.TARGET, "assigned"),
        (60.0, Stage.LOITERING, Purpose.LOITER, "picture too old"),
        (299.9, Stage.LOITERING, Purpose.LOITER, "picture too old"),
        (300.0, Stage.RETURNING, Purpose.RETURN, "blind"),
        (1e5, Stage.RETURNING, Purpose.RETURN, "blind"),
    ],
)
def test_losing_the_broadcast_walks_the_stages(age_s: float, stage: Stage, purpose: Purpose, reason: str) -> None:
    flight = guided()
    flight.home(-2_000.0, 0.0)
    flight.broadcast()
    flight.at()
    flight.now_s += age_s
    decision, setpoint = flight.at()
    assert (decision.stage, decision.purpose, decision.reason) == (stage, purpose, reason)
    assert decision.picture_age_s == pytest.approx(age_s)
    assert setpoint is not None


def test_regaining_the_broadcast_walks_back() -> None:
    flight = guided()
    flight.home(-2_000.0, 0.0)
    flight.broadcast()
    flight.at()
    flight.now_s += 400.0
    assert flight.at()[0].purpose is Purpose.RETURN
    flight.broadcast()
    flight.now_s += 0.9
    assert flight.at()[0].purpose is Purpose.RETURN
    flight.now_s += 0.1
    assert flight.at()[0].purpose is Purpose.TARGET


@pytest.mark.parametrize(("agreed", "age_s"), [(False, 2.0), (True, 3_602.0)])
def test_where_clocks_need_not_agree_a_vehicles_clock_an_hour_ahead_ages_nothing(agreed: bool, age_s: float) -> None:
    trust = Trust(max_age_s=math.inf, clock_checked=agreed)
    companion = Companion(CONFIG, authenticator=Authenticator(trust))
    frame = StateFrame(Stamp(1_800_000_000, 0, 1), 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, (), (), ())
    ahead_s = 1_800_003_600.0
    companion.hear(FrameWriter().encode(frame), ahead_s)
    assert companion.world_model.age_s(ahead_s + 2.0) == pytest.approx(age_s)
    assert companion.link_monitor.quality(ahead_s + 2.0).ages_s["state"] == pytest.approx(age_s)


def test_a_repeated_frame_does_not_count_as_regaining_it() -> None:
    flight = guided()
    flight.broadcast()
    flight.now_s += 100.0
    flight.sequence -= 1
    flight.broadcast()
    assert flight.at()[0].stage is Stage.LOITERING


# Range


def with_range(policy: str) -> Flight:
    limits = CONFIG.limits.model_copy(update={"range_m": 2_000.0})
    flight = guided(CONFIG.model_copy(update={"limits": limits, "range_policy": policy}))
    flight.home(0.0, 0.0)
    return flight


def flown(flight: Flight, *norths_m: float) -> Decision:
    """Fly to one place after another at 10 m/s; return the last decision."""
    decisions, before_m = [], norths_m[0]
    for north_m in norths_m:
        flight.now_s += abs(north_m - before_m) / 10.0
        before_m = north_m
        flight.broadcast((50_000.0, 0.0))
        decisions.append(flight.at(north_m, 0.0, (10.0, 0.0))[0])
    return decisions[-1]


def test_within_its_range_it_goes_on() -> None:
    assert flown(with_range("return"), 0.0, 500.0, 900.0).purpose is Purpose.TARGET


def test_it_turns_home_while_its_range_still_reaches() -> None:
    decision = flown(with_range("return"), 0.0, 500.0, 960.0)
    assert (decision.purpose, decision.reason) == (Purpose.RETURN, "range")


def test_near_home_the_moment_to_turn_home_cannot_fall_between_two_decisions() -> None:
    # Back and forth beside home in steps of 10 m: a tenth of the way home is less than a step.
    back_and_forth = [10.0 * (index % 2) for index in range(201)]
    assert flown(with_range("return"), *back_and_forth).reason == "range: home"


def test_having_turned_home_for_its_range_it_keeps_to_it() -> None:
    decision = flown(with_range("return"), 0.0, 500.0, 960.0, 500.0, 300.0)
    assert (decision.purpose, decision.reason) == (Purpose.RETURN, "range")


def test_one_wrong_position_far_away_does_not_use_up_its_range() -> None:
    flight = with_range("return")
    assert flown(flight, 0.0, 500.0).purpose is Purpose.TARGET
    for north_m in (30_000.0, 500.0):
        flight.now_s += 0.5
        flight.position(north_m, 0.0, (10.0, 0.0), jumps=True)
        flight.tick()
    assert flight.companion.flown_m == pytest.approx(500.0, abs=2.5)
    assert flown(flight, 500.0, 960.0).reason == "range"


def test_a_home_beyond_its_range_is_not_flown_to_and_that_is_said() -> None:
    flight = with_range("return")
    flight.home(5_000.0, 0.0)
    flown(flight, 300.0, 500.0)
    flight.broadcast(directive=Directive.RETURN)
    decision, _ = flight.at(500.0, 0.0, (-10.0, 0.0))
    assert (decision.purpose, decision.note) == (Purpose.RETURN, HOME_TOO_FAR)
    assert math.cos(decision.wanted_heading_rad) == pytest.approx(-1.0, abs=1e-3)
    # A home that is told anew counts from the next hand-over on.
    flight.home(1_500.0, 0.0)
    decision, _ = flight.at(500.0, 0.0, (10.0, 0.0))
    assert decision.note == HOME_TOO_FAR
    flight.heartbeat(GUIDED, 5)
    flight.tick()
    flight.heartbeat()
    decision, _ = flight.at(500.0, 0.0, (10.0, 0.0))
    assert (decision.purpose, decision.note) == (Purpose.RETURN, None)
    assert math.cos(decision.wanted_heading_rad) == pytest.approx(1.0, abs=1e-3)


def test_the_policy_arrive_goes_on_whatever_the_range() -> None:
    assert flown(with_range("arrive"), 0.0, 500.0, 960.0, 1_500.0).purpose is Purpose.TARGET


# Hostile bytes


@settings(max_examples=60)
@given(st.lists(st.tuples(st.booleans(), st.binary(max_size=300)), max_size=20))
def test_random_bytes_on_either_link_change_nothing(junk: list[tuple[bool, bytes]]) -> None:
    def decide(datagrams: list[tuple[bool, bytes]]) -> Decision:
        flight = guided()
        flight.broadcast()
        for from_broadcast, datagram in datagrams:
            (flight.companion.hear if from_broadcast else flight.companion.receive)(datagram, flight.now_s)
        return flight.tick()[0]

    assert decide(junk) == decide([])


def test_the_autopilots_bytes_on_the_broadcast_link_steer_nothing() -> None:
    flight = Flight()
    autopilot = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
    beat = common.MAVLink_heartbeat_message(2, common.MAV_AUTOPILOT_ARDUPILOTMEGA, GUIDED, GUIDED_MODE, 4, 3)
    flight.companion.hear(bytes(beat.pack(autopilot)), NOW_S)
    assert flight.tick()[0].reason == "no autopilot heard"


places_m = st.floats(-300_000.0, 300_000.0)
pairs = st.tuples(places_m, places_m)


@pytest.mark.slow
@settings(max_examples=150)
@given(
    st.sampled_from(KINDS),
    st.sampled_from(LAWS),
    pairs,
    st.none() | pairs,
    st.lists(st.tuples(pairs, st.floats(1.0, 1e5), st.floats(0.01, 1.0), st.floats(0.0, 255.0)), max_size=4),
    st.lists(pairs, max_size=3),
    st.sampled_from(Directive),
    st.tuples(st.floats(-300.0, 300.0), st.floats(-300.0, 300.0)),
    st.floats(0.0, 1e4),
)
def test_whatever_is_broadcast_the_velocity_asked_for_is_finite_and_within_the_limits(
    kind: str,
    law: str,
    place: tuple[float, float],
    target: tuple[float, float] | None,
    threats: list[tuple[tuple[float, float], float, float, float]],
    peers: list[tuple[float, float]],
    directive: Directive,
    velocity: tuple[float, float],
    age_s: float,
) -> None:
    flight = Flight(CONFIG.model_copy(update={"law": law}), kind)
    flight.heartbeat()
    flight.broadcast(
        target,
        directive=directive,
        threats=tuple(
            ThreatEntry(k, *centre, radius_m, radius_m * share, bound_m_s)
            for k, (centre, radius_m, share, bound_m_s) in enumerate(threats)
        ),
        agents=tuple(AgentEntry(10 + k, *peer, None) for k, peer in enumerate(peers)),
    )
    flight.at()
    flight.now_s += age_s
    decision, setpoint = flight.at(*place, velocity)
    assert setpoint is not None
    assert decision.reason
    assert all(map(math.isfinite, (setpoint.vx, setpoint.vy, setpoint.vz)))
    assert math.hypot(setpoint.vx, setpoint.vy) <= CONFIG.limits.speed_m_s + 1e-3


@given(st.lists(st.sampled_from(["beat", "manual", "place", "state", "hold", "wait", "long wait"]), max_size=12))
def test_every_decision_carries_its_reason(events: list[str]) -> None:
    flight = Flight()
    actions: dict[str, Callable[[], object]] = {
        "beat": flight.heartbeat,
        "manual": lambda: flight.heartbeat(GUIDED, 5),
        "place": flight.position,
        "state": flight.broadcast,
        "hold": lambda: flight.broadcast(directive=Directive.HOLD),
    }
    for event in events:
        if event in actions:
            actions[event]()
        else:
            flight.now_s += 1.0 if event == "wait" else 70.0
        decision, setpoint = flight.tick()
        assert decision.reason
        assert decision.t_s == flight.now_s
        assert (decision.purpose is Purpose.IDLE) == (setpoint is None) == (decision.setpoint is None)


def test_a_motion_frame_alone_is_no_picture() -> None:
    flight = guided()
    stamp = Stamp(EPOCH_S, 100_000, 1)
    frame = MotionFrame(stamp, (AgentMotion(ME, 0.0, 10.0, 0.0),), (PointMotion(4, 1.0, 0.0, 0.0),), ())
    flight.companion.hear(FrameWriter().encode(frame), NOW_S)
    assert flight.tick()[0].reason == "no picture"


def test_the_companion_takes_its_adapter_from_its_configuration() -> None:
    links = {"autopilot": {"kind": "arducopter", "link": "udpin:127.0.0.1:14540"}}
    companion = Companion(Config.model_validate({"agent_id": 1, **links}))
    assert companion.adapter.can_stop


def test_another_companion_hearing_the_same_decides_the_same() -> None:
    def decide() -> list[Decision]:
        flight = guided()
        flight.broadcast(threats=(ThreatEntry(1, 900.0, 50.0, 400.0, 200.0, 5.0),))
        return [flight.at(10.0 * step, 0.0, (10.0, 0.0))[0] for step in range(50)]

    assert decide() == decide()


def test_an_autopilot_whose_heartbeat_is_lost_is_not_steered() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0))
    companion = flight.companion
    assert companion.adapter.telemetry.heartbeat_at_s is not None
    late_s = companion.adapter.telemetry.heartbeat_at_s + HEARTBEAT_TIMEOUT_S + 0.1
    decision, _ = companion.tick(late_s)
    assert (decision.purpose, decision.reason) == (Purpose.IDLE, "autopilot's heartbeat lost")


def test_between_decisions_the_last_setpoint_is_repeated_as_it_was() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0))
    _, first = flight.at()
    assert first is not None
    again = flight.parsed(flight.companion.repeat(flight.now_s + 0.5))
    assert [(message.vx, message.vy) for message in again] == [(first.vx, first.vy)]


def test_nothing_is_repeated_once_a_person_has_the_vehicle() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0))
    flight.at()
    flight.heartbeat(custom_mode=5)
    assert flight.parsed(flight.companion.repeat(flight.now_s + 0.5)) == []
    flight.heartbeat()
    assert flight.parsed(flight.companion.repeat(flight.now_s + 0.6)) == []


def test_having_come_home_blind_it_stays_home_though_its_circle_is_wide() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0))
    flight.at()
    flight.now_s += 1_000.0
    near, wide = 0.79 * 100.0, 1.2 * 100.0
    reasons = [flight.at(place, 0.0, (10.0, 0.0))[0].purpose for place in (wide, near, wide, 400.0)]
    assert reasons == [Purpose.RETURN, Purpose.LOITER, Purpose.LOITER, Purpose.RETURN]


# Neighbours seen by the vehicle's own detector, as the law `seed` shows them: it turns away from them

CLOSE_M = (20.2, 3.0)
"""Where a neighbour stands that is a little more than a separation ahead, and to the right."""


def wanted_beside(
    *neighbours_ned_m: tuple[float, float],
    config: Config = BY_F_STAR,
    wait_s: float = 0.0,
    velocity: tuple[float, float] = (0.0, 0.0),
    callsign: bytes = b"OW00012",
) -> float:
    """Return the heading wanted, in (-pi, pi], on the way north with neighbours seen `wait_s` ago."""
    flight = guided(config)
    for address, place in enumerate(neighbours_ned_m):
        flight.neighbour(*place, velocity, address=address, callsign=callsign)
    flight.now_s += wait_s
    flight.broadcast((5_000.0, 0.0))
    decision, _ = flight.at(0.0, 0.0, (10.0, 0.0))
    return math.remainder(decision.wanted_heading_rad, math.tau)


STRAIGHT_RAD = wanted_beside()


def test_a_neighbour_that_is_seen_turns_the_vehicle_away() -> None:
    assert abs(STRAIGHT_RAD) < 0.001
    assert wanted_beside(CLOSE_M) < -0.5
    assert wanted_beside((CLOSE_M[0], -CLOSE_M[1])) > 0.5


@pytest.mark.parametrize("callsign", [b"OW00012", b"DLH123", b""])
def test_a_stranger_is_kept_clear_of_as_a_peer_is(callsign: bytes) -> None:
    assert wanted_beside(CLOSE_M, callsign=callsign) == wanted_beside(CLOSE_M)


@pytest.mark.parametrize("range_m", [0.0, 20.0])
def test_a_neighbour_beyond_the_range_of_the_detector_is_not_minded(range_m: float) -> None:
    short_sighted = BY_F_STAR.model_copy(update={"detector_range_m": range_m})
    assert wanted_beside(CLOSE_M, config=short_sighted) == STRAIGHT_RAD


def test_a_neighbour_just_within_the_range_of_the_detector_is_minded() -> None:
    assert wanted_beside(CLOSE_M, config=BY_F_STAR.model_copy(update={"detector_range_m": 21.0})) < -0.5


def test_a_neighbour_is_remembered_for_a_while_and_then_forgotten() -> None:
    assert wanted_beside(CLOSE_M, wait_s=NEIGHBOUR_MEMORY_S - 0.1) < -0.5
    assert wanted_beside(CLOSE_M, wait_s=NEIGHBOUR_MEMORY_S + 0.1) == STRAIGHT_RAD


def test_a_neighbour_seen_a_while_ago_is_where_it_must_be_by_now() -> None:
    begun_at = (CLOSE_M[0] + 30.0, CLOSE_M[1] + 80.0)
    assert wanted_beside(begun_at) == pytest.approx(STRAIGHT_RAD, abs=1e-3)
    moving = wanted_beside(begun_at, wait_s=4.0, velocity=(-7.5, -20.0))
    assert moving == pytest.approx(wanted_beside(CLOSE_M), abs=0.02)


def test_far_from_the_origin_a_neighbours_velocity_is_turned_from_true_north_to_the_grid() -> None:
    east_m, since_s, speed_m_s = 150_000.0, 4.0, 50.0

    def wanted(neighbour_ned_m: tuple[float, float], wait_s: float, velocity: tuple[float, float]) -> float:
        flight = Flight(BY_F_STAR)
        flight.heartbeat()
        flight.position(0.0, east_m)
        flight.neighbour(*neighbour_ned_m, velocity)
        flight.now_s += wait_s
        flight.broadcast((5_000.0, east_m))
        return math.remainder(flight.at(0.0, east_m, (10.0, 0.0))[0].wanted_heading_rad, math.tau)

    there = (CLOSE_M[0], east_m + CLOSE_M[1])
    grid_rad = math.pi / 2.0 - FRAME.convergence_rad(*there)
    way_m = since_s * speed_m_s
    begun_at = (there[0] - way_m * math.cos(grid_rad), there[1] - way_m * math.sin(grid_rad))
    assert begun_at[0] < there[0] - 3.0
    assert wanted(begun_at, since_s, (0.0, speed_m_s)) == pytest.approx(wanted(there, 0.0, (0.0, 0.0)), abs=0.05)


@pytest.mark.parametrize(
    ("told_at", "seen_at"),
    [
        (CLOSE_M, None),
        # Seen where it may be by now: what is seen goes before what is broadcast.
        ((CLOSE_M[0], CLOSE_M[1] - 60.0), CLOSE_M),
        # Seen where it cannot be: whoever says so is somebody else.
        (CLOSE_M, (500.0, 500.0)),
    ],
)
def test_no_transponder_moves_a_fleet_mate_from_where_the_broadcast_lets_it_be(
    told_at: tuple[float, float], seen_at: tuple[float, float] | None
) -> None:
    flight = guided(BY_F_STAR)
    if seen_at is not None:
        flight.neighbour(*seen_at, callsign=b"OW00012")
    flight.now_s += 2.0
    flight.broadcast((5_000.0, 0.0), agents=(AgentEntry(12, *told_at, None),))
    assert math.remainder(flight.at(0.0, 0.0, (10.0, 0.0))[0].wanted_heading_rad, math.tau) < -0.5


def test_its_own_echo_is_no_neighbour() -> None:
    assert wanted_beside(CLOSE_M, callsign=b"OW%05d" % ME) == STRAIGHT_RAD


@pytest.mark.parametrize(("traffic_ned_m", "speed_m_s"), [((5.0, 0.0), 1.25), ((500.0, 0.0), 0.0)])
def test_where_a_neighbour_is_seen_there_is_no_place_to_loiter(
    traffic_ned_m: tuple[float, float], speed_m_s: float
) -> None:
    flight = guided(BY_F_STAR)
    flight.neighbour(*traffic_ned_m)
    flight.broadcast(None)
    decision, setpoint = flight.tick()
    assert (decision.purpose, decision.reason) == (Purpose.LOITER, "no target")
    assert setpoint is not None
    assert math.hypot(setpoint.vx, setpoint.vy) == pytest.approx(speed_m_s, abs=1e-3)


# The law routed, with the right of way and the guard

AHEAD = ThreatEntry(1, 1_000.0, 0.0, 400.0, 200.0, 0.0)
NORTH_M_S = (10.0, 0.0)


def wanted_rad(decision: Decision) -> float:
    """Return the wanted heading in (-pi, pi]."""
    return math.remainder(decision.wanted_heading_rad, math.tau)


def test_it_heads_for_the_tangent_of_a_disc_ahead() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0), threats=(AHEAD,))
    decision, _ = flight.at(velocity=NORTH_M_S)
    assert (decision.purpose, decision.stay, decision.opposed) == (Purpose.TARGET, None, False)
    tangent_rad = math.asin(AHEAD.detection_radius_m / AHEAD.north_m)
    assert abs(wanted_rad(decision)) == pytest.approx(tangent_rad, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_it_flies_around_a_disc_ahead_to_its_target_without_entering_it(kind: str) -> None:
    flight = guided(kind=kind)
    flight.broadcast((2_000.0, 0.0), threats=(AHEAD,))
    state, least_m, steps = (0.0, 0.0, 0.3), math.inf, 0
    while (decision := flight.at(*state[:2], velocity_of(state))[0]).purpose is Purpose.TARGET:
        assert (decision.broken, decision.uncertified) == ((), False)
        flight.broadcast((2_000.0, 0.0), threats=(AHEAD,))
        setpoint = decision.setpoint
        assert setpoint is not None
        heading_rad, rate_rad_s = setpoint.heading_rad, 9.80665 / 10.0
        state = turn_towards(*state[:2], state[2], 10.0, heading_rad, rate_rad_s, CONFIG.guidance_step_s)
        least_m = min(least_m, math.dist(state[:2], (AHEAD.north_m, AHEAD.east_m)))
        flight.now_s += CONFIG.guidance_step_s
        steps += 1
        assert steps < 600
    assert decision.reason == "arrived"
    assert AHEAD.detection_radius_m < least_m < AHEAD.detection_radius_m + 10.0


def velocity_of(state: tuple[float, float, float]) -> tuple[float, float]:
    return 10.0 * math.cos(state[2]), 10.0 * math.sin(state[2])


def test_to_a_target_inside_a_disc_it_goes_as_near_as_is_safe_and_loiters_there_and_says_so() -> None:
    flight = guided()
    flight.broadcast((900.0, 0.0), threats=(AHEAD,))
    assert flight.at(0.0, 0.0, NORTH_M_S)[0].purpose is Purpose.TARGET
    decision, setpoint = flight.at(599.0, 0.0, (0.0, 10.0))
    assert (decision.purpose, decision.reason) == (Purpose.LOITER, "at the nearest safe point")
    assert decision.stay == decision.reason
    assert decision.target_id is None
    assert setpoint is not None


def test_out_of_a_ring_of_threats_it_goes_to_the_nearest_place_within_it_and_says_so() -> None:
    flight = guided()
    ring = [(700.0 * math.cos(k * math.tau / 24), 700.0 * math.sin(k * math.tau / 24), 300.0) for k in range(24)]
    # And one about the vehicle: it is on no shore.
    discs = [*ring, (0.0, 0.0, 90.0)]
    threats = (ThreatEntry(k, *disc, 1.0, 0.0) for k, disc in enumerate(discs))
    flight.broadcast((3_500.0, 0.0), threats=tuple(threats))
    decision, setpoint = flight.at(0.0, 0.0, NORTH_M_S)
    assert (decision.purpose, decision.note) == (Purpose.TARGET, "target out of reach: to the nearest safe point")
    assert setpoint is not None


def test_what_keeps_the_law_from_its_goal_is_the_reason_of_the_decision() -> None:
    class Resigned:
        """Wants to go nowhere."""

        def steer(self, task: Task, pose: Motion, view: View, now_s: float) -> SteeringDemand:
            """Loiter as asked, else stay."""
            return (
                SteeringDemand(task.pull) if task.loitering else SteeringDemand(SteeringVector(0.0, 0.0), stay="weary")
            )

    flight = Flight(kind="kinematic")
    flight.companion = Companion(CONFIG, ADAPTERS["kinematic"](SYSTEM), Resigned())
    flight.heartbeat()
    flight.broadcast()
    decision, setpoint = flight.at(velocity=NORTH_M_S)
    assert (decision.purpose, decision.reason, decision.stay) == (Purpose.LOITER, "weary", "weary")
    assert setpoint is not None
    assert math.hypot(setpoint.vx, setpoint.vy) == pytest.approx(10.0, abs=1e-3)


def meeting(
    config: Config = CONFIG, kind: str = "kinematic", above_m: float | None = None, apart_m: float = 44.0
) -> Decision:
    """Return the decision on the way north of one that sees another come head-on, both at 10 m/s."""
    flight = guided(config, kind)
    flight.neighbour(apart_m, 0.0, (-10.0, 0.0), above_m=above_m)
    flight.broadcast((5_000.0, 0.0))
    return flight.at(velocity=NORTH_M_S)[0]


def test_of_two_that_meet_head_on_it_turns_right_and_says_so() -> None:
    decision = meeting()
    assert wanted_rad(decision) == pytest.approx(0.0, abs=1e-6)
    assert decision.gave_way == f"{PASSING} (agent 12)"
    assert decision.setpoint is not None
    assert 0.1 < decision.setpoint.heading_rad < math.pi


def test_one_that_can_stop_slows_down_as_well() -> None:
    decision = meeting(kind="arducopter", apart_m=70.0)
    assert decision.gave_way == f"{SLOWING} (agent 12)"
    assert decision.setpoint is not None
    assert 0.0 < decision.setpoint.speed_m_s < CONFIG.limits.speed_m_s


def test_one_that_can_stop_stops_for_one_that_comes_too_near_and_says_so() -> None:
    decision = meeting(kind="arducopter")
    assert decision.gave_way == f"{STOPPING} (agent 12)"
    assert decision.setpoint is not None
    assert decision.setpoint.speed_m_s == 0.0


def test_one_that_stands_within_the_separation_of_another_moves_away_from_it() -> None:
    flight = guided()
    flight.neighbour(0.5 * CONFIG.separation_m, 0.0)
    flight.broadcast((5_000.0, 0.0))
    said: list[tuple[str | None, float]] = []
    while not said or said[-1][0] == f"{PIVOTING} (agent 12)":
        decision, setpoint = flight.at()
        assert setpoint is not None
        said.append((decision.gave_way, setpoint.vx))
    assert said[0][0] == f"{PIVOTING} (agent 12)"
    assert said[0][1] == pytest.approx(0.0, abs=1e-3)
    assert said[-1][1] < 0.0


def test_nobody_gives_way_to_one_that_is_only_broadcast() -> None:
    flight = guided(kind="kinematic")
    flight.broadcast((5_000.0, 0.0), agents=(AgentEntry(12, 44.0, 0.0, None),))
    assert flight.at(velocity=NORTH_M_S)[0].gave_way is None


@pytest.mark.parametrize("above_m", [-40.0, 40.0])
def test_nobody_gives_way_to_one_on_another_layer(above_m: float) -> None:
    layered = CONFIG.model_copy(update={"vertical_separation_m": 30.0})
    assert meeting(layered, above_m=above_m).gave_way is None
    assert meeting(layered, above_m=0.5 * above_m).gave_way is not None


def test_way_is_given_to_one_that_does_not_say_how_high_it_is() -> None:
    assert meeting(CONFIG.model_copy(update={"vertical_separation_m": 30.0})).gave_way is not None


def test_without_layers_way_is_given_at_any_height() -> None:
    assert meeting(above_m=1_000.0).gave_way is not None


@pytest.mark.parametrize("law", [law for law in LAWS if law != "routed"])
def test_the_papers_laws_know_of_no_right_of_way(law: str) -> None:
    assert meeting(CONFIG.model_copy(update={"law": law})).gave_way is None


def told_to_the_guard(flight: Flight, monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Return a list that each call of the guard from now on adds its arguments to."""
    told, check = [], flight.companion.steering.guard.check

    def listening(*arguments: Any) -> Verdict:  # noqa: ANN401
        told.append(arguments)
        return check(*arguments)

    monkeypatch.setattr(flight.companion.steering.guard, "check", listening)
    return told


def test_the_guard_is_given_the_route_as_a_possible_back_up_but_none_while_loitering(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    flight = guided()
    told = told_to_the_guard(flight, monkeypatch)
    flight.broadcast((2_000.0, 0.0), threats=(AHEAD,))
    flight.at(velocity=NORTH_M_S)
    flight.broadcast(directive=Directive.HOLD, threats=(AHEAD,))
    flight.at(velocity=NORTH_M_S)
    (*_, routed), (*_, loitering) = told
    length_m = sum(piece.length_m for piece in routed.route)
    assert 2_100.0 < length_m < 2_300.0
    assert loitering.route == ()


def test_what_the_surrogate_has_against_the_route_is_said() -> None:
    flight = guided()
    flight.neighbour(CONFIG.separation_m, 0.0)
    flight.broadcast((5_000.0, 0.0))
    assert flight.at(velocity=NORTH_M_S)[0].opposed


@pytest.mark.parametrize(("apart_m", "kept_right"), [(40.0, True), (99.0, True), (103.0, False)])
def test_the_guard_is_told_to_keep_the_right_circle_where_another_is_within_the_interaction_radius(
    apart_m: float, kept_right: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight = guided(kind="kinematic")
    told = told_to_the_guard(flight, monkeypatch)
    flight.neighbour(apart_m, 0.0)
    flight.broadcast((5_000.0, 0.0))
    flight.at(velocity=NORTH_M_S)
    assert [arguments[-1].keep_right for arguments in told] == [kept_right]


def test_a_threat_that_appears_later_breaks_an_assumption_of_the_guards_which_is_said() -> None:
    flight, beside = guided(kind="kinematic"), ThreatEntry(1, 0.0, -80.0, 60.0, 30.0, 0.0)
    flight.broadcast((5_000.0, 0.0), threats=(beside,))
    assert flight.at(velocity=NORTH_M_S)[0].broken == ()
    flight.now_s += CONFIG.guidance_step_s
    flight.broadcast((5_000.0, 0.0), threats=(beside, ThreatEntry(2, 0.0, 80.0, 60.0, 30.0, 0.0)))
    assert flight.at(5.0, 0.0, NORTH_M_S)[0].broken == (NEW_THREAT,)


def test_the_threats_of_the_first_picture_are_no_news() -> None:
    corners = ((-9_000.0, -9_000.0), (9_000.0, -9_000.0), (9_000.0, 9_000.0), (-9_000.0, 9_000.0))
    fenced = CONFIG.model_copy(update={"limits": CONFIG.limits.model_copy(update={"fence": corners})})
    flight = guided(fenced, "kinematic")
    flight.at(velocity=NORTH_M_S)
    flight.now_s += CONFIG.guidance_step_s
    flight.broadcast((5_000.0, 0.0), threats=(ThreatEntry(2, 0.0, 80.0, 60.0, 30.0, 0.0),))
    assert flight.at(5.0, 0.0, NORTH_M_S)[0].broken == ()


def test_inside_an_attack_disc_nothing_is_certified_and_it_says_so() -> None:
    flight = guided(kind="kinematic")
    flight.broadcast((5_000.0, 0.0), threats=(ThreatEntry(2, 0.0, 0.0, 300.0, 200.0, 0.0),))
    assert flight.at(100.0, 0.0, NORTH_M_S)[0].uncertified


# The heights that threats reach


def on_the_way_north(*bands: BandEntry, height_m: float = 30.0) -> float:
    """Return how far a disc ahead turns the vehicle, at 530 m above the sea and 30 m above home, to either side."""
    limits = CONFIG.limits.model_copy(update={"height_max_m": 200.0})
    flight = guided(CONFIG.model_copy(update={"height_m": height_m, "limits": limits}))
    flight.broadcast((5_000.0, 0.0), threats=(AHEAD,))
    flight.bands(*bands)
    return abs(wanted_rad(flight.at(velocity=NORTH_M_S)[0]))


@pytest.mark.parametrize("band", [BandEntry(1, 540.0, None), BandEntry(1, None, 520.0), BandEntry(1, 540.0, 600.0)])
def test_a_threat_whose_band_is_above_or_below_is_flown_over_or_under(band: BandEntry) -> None:
    assert on_the_way_north(band) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    "band",
    [BandEntry(1, 500.0, 600.0), BandEntry(1, 534.0, None), BandEntry(1, None, 526.0), BandEntry(7, 540.0, None)],
)
def test_a_threat_whose_band_holds_the_height_or_is_not_known_is_gone_around(band: BandEntry) -> None:
    assert on_the_way_north(band) == on_the_way_north() > 0.3


def test_a_threat_on_the_way_to_the_wanted_height_is_gone_around() -> None:
    assert on_the_way_north(BandEntry(1, 600.0, None), height_m=120.0) > 0.3
    assert on_the_way_north(BandEntry(1, 640.0, None), height_m=120.0) == pytest.approx(0.0, abs=1e-6)


def test_the_guard_too_leaves_a_threat_above_alone() -> None:
    flight = guided(CONFIG.model_copy(update={"law": "step"}))
    flight.broadcast((5_000.0, 0.0), threats=(AHEAD,))
    assert flight.at(575.0, 0.0, NORTH_M_S)[0].guard_changes == (KEEP_OUT,)
    flight.bands(BandEntry(1, 540.0, None))
    assert flight.at(575.0, 0.0, NORTH_M_S)[0].guard_changes == ()


# Reports on an uplink

REPORTING = CONFIG.model_copy(update={"report_period_s": 30.0})


def reported(flight: Flight) -> ReportFrame | None:
    """Return the report due now, if one is."""
    frames = [frame for datagram in flight.companion.report(flight.now_s) for frame in FrameReader().read(datagram)]
    assert len(frames) <= 1
    if not frames:
        return None
    assert isinstance(frames[0], ReportFrame)
    return frames[0]


def test_a_report_is_due_at_once_and_then_after_each_period() -> None:
    flight, times_s = guided(REPORTING), []
    for step in range(200):
        flight.now_s = NOW_S + 0.5 * step
        flight.position()
        flight.tick()
        if reported(flight) is not None:
            times_s.append(0.5 * step)
    assert times_s == [0.0, 30.0, 60.0, 90.0]


def test_without_a_period_nothing_is_reported() -> None:
    flight = guided()
    flight.tick()
    assert reported(flight) is None


def test_a_report_tells_where_the_vehicle_is_how_it_moves_and_how_far_it_has_flown() -> None:
    flight = guided(REPORTING)
    flight.broadcast()
    for north_m in (0.0, 100.0, 200.5):
        flight.at(north_m, -700.0, (3.0, -4.0))
        flight.now_s += 20.0
    flight.now_s -= 20.0
    report = reported(flight)
    assert report is not None
    assert (report.agent_id, report.unix_s) == (ME, NOW_S + 40.0)
    assert FRAME.to_local(report.lat_deg, report.lon_deg) == pytest.approx((200.5, -700.0), abs=0.02)
    assert (report.velocity_north_m_s, report.velocity_east_m_s) == (3.0, -4.0)
    assert report.flown_m == 201.0


def test_a_report_is_stamped_with_the_time_of_the_position() -> None:
    flight = guided(REPORTING)
    flight.now_s += 1.25
    report = reported(flight)
    assert report is not None
    assert report.unix_s == NOW_S


def test_no_report_is_made_without_a_fresh_position_and_the_next_one_is_made_at_once() -> None:
    flight = Flight(REPORTING)
    flight.heartbeat()
    assert reported(flight) is None
    flight.position()
    flight.now_s += REPORTING.telemetry_timeout_s + 0.1
    assert reported(flight) is None
    flight.position()
    assert reported(flight) is not None


def test_a_vehicle_that_a_person_flies_reports_as_well() -> None:
    flight = Flight(REPORTING)
    flight.heartbeat(GUIDED, 5)
    flight.position()
    assert flight.tick()[0].purpose is Purpose.IDLE
    assert reported(flight) is not None


def test_a_report_comes_from_the_companion_of_its_system() -> None:
    (datagram,) = guided(REPORTING).companion.report(NOW_S)
    assert (datagram[5], datagram[6]) == (SYSTEM, common.MAV_COMP_ID_ONBOARD_COMPUTER)


# The way flown


def test_relocated_it_measures_on_from_where_it_finds_itself() -> None:
    flight = guided()
    flight.broadcast()
    flight.at(0.0)
    flight.now_s += 10.0
    flight.at(100.0)
    assert flight.companion.flown_m == pytest.approx(100.0, abs=0.1)
    flight.companion.relocate(5_000.0)
    flight.at(3_000.0)
    assert flight.companion.flown_m == 5_000.0
    flight.now_s += 1.0
    flight.at(3_010.0)
    assert flight.companion.flown_m == pytest.approx(5_010.0, abs=0.1)


BESIDE_A_THREAT = ThreatEntry(1, 1_000.0, 100.0, 400.0, 200.0, 0.0)


def deflection_rad(range_m: float, law: str = "seed", k_l: float = 1e6, north_m: float = 600.0) -> float:
    """Return how far a threat turns a vehicle that has a way of 4400 m to go."""
    limits = CONFIG.limits.model_copy(update={"range_m": range_m})
    weights = CONFIG.weights.model_copy(update={"k_l": k_l})
    change = {"limits": limits, "weights": weights, "range_policy": "arrive", "law": law}
    flight = guided(CONFIG.model_copy(update=change))
    flight.broadcast((5_000.0, 0.0), threats=(BESIDE_A_THREAT,))
    decision, _ = flight.at(north_m, 0.0, (10.0, 0.0))
    return abs(math.remainder(decision.wanted_heading_rad, math.tau))


def test_at_the_end_of_its_range_a_vehicle_is_pulled_harder_and_deflected_less() -> None:
    plenty_rad = deflection_rad(50_000.0)
    assert plenty_rad > 0.05
    assert deflection_rad(4_400.0) < 0.7 * plenty_rad


@given(k_l=st.floats(0.0, 1e9))
@settings(max_examples=20)
def test_the_heavier_the_range_weighs_the_less_a_threat_deflects(k_l: float) -> None:
    assert deflection_rad(4_400.0, k_l=k_l) <= deflection_rad(50_000.0, k_l=k_l) + 1e-12


@pytest.mark.parametrize(("law", "weighed"), [("seed", True), ("ramp", False), ("step", False)])
def test_only_the_law_with_a_surrogate_weighs_its_range(law: str, weighed: bool) -> None:
    on_the_edge_m = 1_000.0 - math.sqrt(400.0**2 - 100.0**2)
    short, plenty = (deflection_rad(range_m, law, 1e8, on_the_edge_m) for range_m in (4_400.0, 50_000.0))
    assert (short != plenty) is weighed


def beside_its_target(north_m: float, rival_id: int, rival_target_id: int | None = 4, seen: bool = True) -> Flight:
    """Return a flight `north_m` from its target at 0, 0 beside another agent that may go there too."""
    flight = guided(CONFIG)
    if seen:
        flight.neighbour(north_m, 60.0, callsign=f"OW{rival_id:05d}".encode())
    flight.broadcast((0.0, 0.0), agents=(AgentEntry(rival_id, None, None, rival_target_id),))
    return flight


@pytest.mark.parametrize(
    ("rival_id", "rival_north_m", "waits"), [(ME + 1, 60.0, True), (ME - 1, 360.0, False)], ids=["nearer", "farther"]
)
def test_of_two_that_see_each_other_on_the_way_the_nearer_goes_first(
    rival_id: int, rival_north_m: float, waits: bool
) -> None:
    flight = guided(CONFIG)
    flight.neighbour(rival_north_m, 30.0, callsign=f"OW{rival_id:05d}".encode())
    flight.broadcast((0.0, 0.0), agents=(AgentEntry(rival_id, None, None, 4),))
    assert (flight.at(160.0, 0.0, (-10.0, 0.0))[0].purpose is Purpose.LOITER) is waits


def test_of_two_abreast_at_their_target_the_lower_id_goes_first() -> None:
    second, first = beside_its_target(160.0, ME - 1), beside_its_target(160.0, ME + 1)
    decision, _ = second.at(160.0, 0.0, (-10.0, 0.0))
    assert (decision.purpose, decision.reason) == (Purpose.LOITER, f"agent {ME - 1} arrives first")
    assert first.at(160.0, 0.0, (-10.0, 0.0))[0].purpose is Purpose.TARGET


@pytest.mark.parametrize(
    ("north_m", "rival_target_id", "seen"),
    [(200.0, 4, True), (160.0, None, True), (160.0, 4, False)],
    ids=["far from the target", "the other goes elsewhere", "the other is not seen"],
)
def test_otherwise_nobody_waits(north_m: float, rival_target_id: int | None, seen: bool) -> None:
    flight = beside_its_target(north_m, ME - 1, rival_target_id, seen)
    assert flight.at(north_m, 0.0, (-10.0, 0.0))[0].purpose is Purpose.TARGET


def test_who_waits_does_so_until_well_away() -> None:
    flight = beside_its_target(160.0, ME - 1)
    assert flight.at(160.0, 0.0)[0].purpose is Purpose.LOITER
    assert flight.at(260.0, 0.0)[0].purpose is Purpose.LOITER
    assert flight.at(280.0, 0.0)[0].purpose is Purpose.TARGET
    assert flight.at(260.0, 0.0)[0].purpose is Purpose.TARGET
