"""What the vehicle believes: the newest of everything, nothing lost by chance, and discs that only grow."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.guidance.view import NOBODY, Traffic
from companion.onboard.world_model import WorldModel
from companion.protocol.codec import (
    AgentEntry,
    AgentMotion,
    BandEntry,
    BandsFrame,
    Directive,
    FleetFrame,
    Grid,
    MissionFrame,
    MotionFrame,
    PointMotion,
    RadiiEntry,
    RadiiFrame,
    ReportFrame,
    Stamp,
    StateFrame,
    TargetEntry,
    ThreatEntry,
    ThreatPlace,
)
from companion.protocol.freshness import RESTART_AFTER_S

ME = 5
EPOCH_S = 1_790_000_000
PERIOD_S = 5.0
UNIT_CM = 200
ROUNDING_M = math.sqrt(0.5) * UNIT_CM / 100.0
THREAT = ThreatEntry(1, 1_000.0, 2_000.0, 500.0, 200.0, 10.0)


def time_of(sequence: int, epoch_s: int = EPOCH_S) -> float:
    return epoch_s + PERIOD_S * sequence


def stamp(sequence: int, index: int = 0, count: int = 1, epoch_s: int = EPOCH_S) -> Stamp:
    return Stamp(epoch_s, round(1000 * PERIOD_S * sequence), sequence, index, count)


def state(
    sequence: int,
    agents: tuple[AgentEntry, ...] = (AgentEntry(ME, 0.0, 0.0, 1),),
    targets: tuple[TargetEntry, ...] = (TargetEntry(1, 10.0, 20.0),),
    threats: tuple[ThreatEntry, ...] = (),
    *,
    index: int = 0,
    count: int = 1,
    epoch_s: int = EPOCH_S,
    directive: Directive = Directive.NORMAL,
    origin_deg: tuple[float, float] = (47.0, 8.0),
    revision: int = 1,
    picture_threats: int | None = None,
) -> StateFrame:
    told = len(threats) if picture_threats is None else picture_threats
    its_stamp = stamp(sequence, index, count, epoch_s)
    return StateFrame(
        its_stamp, *origin_deg, directive, revision, told, len(targets), UNIT_CM, agents, targets, threats
    )


def motion(sequence: int, *agents: AgentMotion, time_ms: int | None = None, epoch_s: int = EPOCH_S) -> MotionFrame:
    its_stamp = stamp(sequence, epoch_s=epoch_s)
    return MotionFrame(its_stamp if time_ms is None else replace(its_stamp, time_ms=time_ms), agents, (), ())


def picture_of(*frames: StateFrame) -> WorldModel:
    picture = WorldModel(ME)
    for frame in frames:
        assert picture.take_state(frame, frame.stamp.unix_s)
    return picture


def target_at(north_m: float) -> tuple[TargetEntry, ...]:
    return (TargetEntry(1, north_m, 0.0),)


# Newest wins


def test_nothing_is_believed_before_anything_is_heard() -> None:
    picture = WorldModel(ME)
    view = picture.view(0.0)
    assert picture.age_s(0.0) is None
    assert view.target_ned_m is None
    assert view.threats_ned_m.shape == view.peers_ned_m.shape == view.loitering_ned_m.shape == (0, 2)
    assert view.detection_radius_m.shape == (0,)


def test_a_newer_frame_replaces_what_was_believed() -> None:
    picture = picture_of(state(1, targets=target_at(1.0)), state(2, targets=target_at(2.0)))
    assert picture.view(time_of(2)).target_ned_m == (2.0, 0.0)


def test_a_repeated_frame_is_refused() -> None:
    picture = picture_of(state(1))
    assert not picture.take_state(state(1), time_of(1))


def test_a_repeated_frame_does_not_make_the_picture_younger() -> None:
    picture = picture_of(state(1))
    picture.take_state(state(1), time_of(3))
    assert picture.age_s(time_of(3)) == pytest.approx(2 * PERIOD_S)


def test_an_older_frame_is_refused() -> None:
    picture = picture_of(state(2, targets=target_at(2.0)))
    assert not picture.take_state(state(1, targets=target_at(1.0)), time_of(2))
    assert picture.view(time_of(2)).target_ned_m == (2.0, 0.0)


def test_the_directive_is_that_of_the_newest_frame() -> None:
    picture = picture_of(state(1, directive=Directive.RETURN), state(2, directive=Directive.HOLD))
    assert picture.directives.in_force is Directive.HOLD


def test_each_threat_is_of_the_picture_that_told_of_it_last() -> None:
    picture, told = WorldModel(ME), []
    for frame in (
        state(1, threats=(THREAT,), revision=7),
        state(2, threats=(replace(THREAT, north_m=1_040.0),), revision=7),
        state(3, threats=(replace(THREAT, north_m=1_080.0),), revision=8),
        state(1, threats=(replace(THREAT, north_m=1_120.0),), revision=8, epoch_s=EPOCH_S + 60),
    ):
        picture.take_state(frame, frame.stamp.unix_s)
        pictures = picture.view(frame.stamp.unix_s).threat_pictures
        assert pictures is not None
        told += pictures.tolist()
    assert told[0] == told[1]
    assert len(set(told)) == 3


def me(own: Directive) -> tuple[AgentEntry, ...]:
    return (AgentEntry(ME, 0.0, 0.0, 1, own), AgentEntry(9, 9.0, 9.0, 1, Directive.RETURN))


@pytest.mark.parametrize("own", Directive)
@pytest.mark.parametrize("for_all", Directive)
def test_of_the_directive_for_all_and_its_own_a_vehicle_obeys_the_stronger(own: Directive, for_all: Directive) -> None:
    picture = picture_of(state(1, agents=me(own), directive=for_all))
    assert picture.directives.in_force is max(own, for_all)


def test_its_own_directive_ends_with_the_first_frame_that_names_it_without_one() -> None:
    picture = picture_of(state(1, agents=me(Directive.HOLD)), state(2, agents=me(Directive.NORMAL)))
    assert picture.directives.in_force is Directive.NORMAL


def test_frames_that_do_not_name_it_leave_its_own_directive_also_after_the_ground_station_has_restarted() -> None:
    others = (AgentEntry(9, 9.0, 9.0, 1, Directive.HOLD),)
    picture = picture_of(state(1, agents=me(Directive.RETURN)), state(2, agents=others, index=1, count=2))
    later = EPOCH_S + 2_600
    picture.take_state(state(1, agents=others, index=1, count=2, epoch_s=later), time_of(1, later))
    assert picture.directives.words == "directive return, for this agent"
    picture.take_state(state(1, agents=me(Directive.HOLD), count=2, epoch_s=later), time_of(1, later))
    assert picture.directives.words == "directive hold, for this agent"


def test_its_own_directive_is_forgotten_with_a_whole_broadcast_that_does_not_name_it() -> None:
    picture = picture_of(state(1, agents=me(Directive.RETURN)), state(2, agents=()))
    assert picture.directives.in_force is Directive.NORMAL


# Epochs


def test_a_restarted_ground_station_is_heard_at_once_although_its_numbers_start_again() -> None:
    picture = picture_of(state(500, targets=target_at(1.0)))
    later = EPOCH_S + 2_600
    assert picture.take_state(state(1, targets=target_at(2.0), epoch_s=later), time_of(1, later))
    assert picture.view(time_of(1, later)).target_ned_m == (2.0, 0.0)


def test_what_a_restarted_ground_station_does_not_know_is_forgotten() -> None:
    picture = picture_of(state(500, threats=(THREAT,)))
    later = EPOCH_S + 2_600
    picture.take_state(state(1, epoch_s=later), time_of(1, later))
    assert picture.view(time_of(1, later)).threats_ned_m.shape == (0, 2)


def test_a_lower_epoch_is_an_old_run_replayed_and_is_refused() -> None:
    picture = picture_of(state(1))
    assert not picture.take_state(state(900, epoch_s=EPOCH_S - 1), time_of(1) + RESTART_AFTER_S - 0.1)


def test_a_lower_epoch_is_taken_after_silence() -> None:
    picture = picture_of(state(1))
    assert picture.take_state(state(1, targets=target_at(3.0), epoch_s=EPOCH_S - 1), time_of(1) + RESTART_AFTER_S + 0.1)
    assert picture.order.epoch_s == EPOCH_S - 1
    assert picture.view(time_of(9)).target_ned_m == (3.0, 0.0)


def test_refused_frames_do_not_break_the_silence_a_lower_epoch_needs() -> None:
    picture = picture_of(state(1))
    picture.take_state(state(1), time_of(1) + RESTART_AFTER_S - 1.0)
    assert picture.take_state(state(1, epoch_s=EPOCH_S - 1), time_of(1) + RESTART_AFTER_S + 0.1)


def test_a_lower_sequence_is_taken_after_silence() -> None:
    picture = picture_of(state(900))
    assert not picture.take_state(state(2), time_of(900) + RESTART_AFTER_S - 0.1)
    assert picture.take_state(state(3, targets=target_at(3.0)), time_of(900) + RESTART_AFTER_S + 0.1)
    assert picture.take_state(state(4, targets=target_at(4.0)), time_of(900) + RESTART_AFTER_S + 1.0)
    assert picture.view(time_of(900)).target_ned_m == (4.0, 0.0)


# Ages and clocks


@pytest.mark.parametrize("ahead_s", [-3_600.0, 0.0, 3_600.0])
def test_where_clocks_do_not_agree_a_picture_ages_from_its_arrival(ahead_s: float) -> None:
    picture = WorldModel(ME, clocks_agree=False)
    for sequence in (1, 2):
        picture.take_state(state(sequence, threats=(THREAT,)), time_of(sequence) + ahead_s)
    assert picture.age_s(time_of(2) + ahead_s) == pytest.approx(0.0)
    assert picture.view(time_of(2) + ahead_s + 10.0).attack_radius_m[0] == pytest.approx(300.0)


def test_a_frame_is_as_old_as_its_stamp_says() -> None:
    picture = WorldModel(ME)
    picture.take_state(state(1), time_of(1) + 3.0)
    assert picture.age_s(time_of(1) + 3.0) == pytest.approx(3.0)
    assert picture.view(time_of(1) + 4.0).target_age_s == pytest.approx(4.0)


def test_a_sender_whose_clock_is_ahead_makes_nothing_younger_than_its_receipt() -> None:
    picture = WorldModel(ME)
    picture.take_state(state(1), time_of(1) - 1_000.0)
    assert picture.age_s(time_of(1) - 1_000.0) == 0.0
    assert picture.age_s(time_of(1) - 990.0) == pytest.approx(10.0)


@given(st.floats(0.0, 1e4), st.floats(0.0, 100.0))
def test_discs_grow_by_the_bound_times_the_age(age_s: float, bound_m_s: float) -> None:
    threat = replace(THREAT, speed_bound_m_s=bound_m_s)
    view = picture_of(state(1, threats=(threat,))).view(time_of(1) + age_s)
    assert view.detection_radius_m[0] == pytest.approx(500.0 + bound_m_s * age_s, abs=1e-3)
    assert view.attack_radius_m[0] == pytest.approx(200.0 + bound_m_s * age_s, abs=1e-3)
    assert view.threat_speed_m_s[0] == bound_m_s
    assert tuple(view.threats_ned_m[0]) == (1_000.0, 2_000.0)


def test_a_late_frame_brings_discs_already_grown() -> None:
    picture = WorldModel(ME)
    picture.take_state(state(1, threats=(THREAT,)), time_of(1) + 20.0)
    assert picture.view(time_of(1) + 20.0).attack_radius_m[0] == pytest.approx(400.0)


def test_a_clock_that_runs_backwards_never_shrinks_a_disc() -> None:
    view = picture_of(state(1, threats=(THREAT,))).view(time_of(1) - 100.0)
    assert view.attack_radius_m[0] == 200.0


# Broadcasts of several frames


def halves(sequence: int, first: TargetEntry, second: TargetEntry) -> tuple[StateFrame, StateFrame]:
    return (
        state(sequence, targets=(TargetEntry(1, 0.0, 0.0), first), index=0, count=2),
        state(sequence, agents=(), targets=(second,), threats=(THREAT,), index=1, count=2),
    )


def test_the_frames_of_one_broadcast_add_up() -> None:
    picture = WorldModel(ME)
    for frame in halves(1, TargetEntry(2, 1.0, 1.0), TargetEntry(3, 2.0, 2.0)):
        assert picture.take_state(frame, time_of(1))
    assert picture.view(time_of(1)).target_ned_m == (0.0, 0.0)
    assert len(picture.view(time_of(1)).threats_ned_m) == 1


def test_an_incomplete_broadcast_forgets_nothing() -> None:
    picture = picture_of(*halves(1, TargetEntry(2, 1.0, 1.0), TargetEntry(3, 2.0, 2.0)))
    picture.take_state(state(2, count=2), time_of(2))
    assert len(picture.view(time_of(2)).threats_ned_m) == 1


def test_half_of_each_of_two_broadcasts_is_no_whole_one() -> None:
    picture = picture_of(*halves(1, TargetEntry(2, 1.0, 1.0), TargetEntry(3, 2.0, 2.0)))
    picture.take_state(state(2, index=0, count=2), time_of(2))
    picture.take_state(state(3, index=1, count=2), time_of(3))
    assert len(picture.view(time_of(3)).threats_ned_m) == 1


def test_a_threat_vanishes_only_once_a_whole_picture_of_a_later_revision_lacks_it() -> None:
    picture = picture_of(*halves(1, TargetEntry(2, 1.0, 1.0), TargetEntry(3, 2.0, 2.0)))
    picture.take_state(state(2, index=0, count=2), time_of(2))
    picture.take_state(state(2, agents=(), targets=(), index=1, count=2), time_of(2))
    assert len(picture.view(time_of(2)).threats_ned_m) == 1
    picture.take_state(state(3, revision=2), time_of(3))
    assert len(picture.view(time_of(3)).threats_ned_m) == 0


def test_an_agent_missing_from_a_whole_broadcast_has_no_target() -> None:
    picture = picture_of(state(1))
    picture.take_state(state(2, agents=(AgentEntry(9, 0.0, 0.0, 1),)), time_of(2))
    assert picture.target_id is None
    assert picture.view(time_of(2)).target_ned_m is None


def test_an_agent_missing_from_one_frame_of_several_keeps_its_target() -> None:
    picture = picture_of(state(1))
    picture.take_state(state(2, agents=(AgentEntry(9, 0.0, 0.0, 1),), index=1, count=2), time_of(2))
    assert picture.target_id == 1


def test_an_agent_told_to_loiter_has_no_target() -> None:
    picture = picture_of(state(1), state(2, agents=(AgentEntry(ME, 0.0, 0.0, None),)))
    assert picture.view(time_of(2)).target_ned_m is None


@st.composite
def histories(draw: st.DrawFn) -> list[StateFrame]:
    """Return broadcasts of one to three frames, each of a new revision: targets, threats and peers come and go."""
    frames = []
    for sequence in range(1, draw(st.integers(2, 5))):
        broadcast: list[StateFrame] = []
        count = draw(st.integers(1, 3))
        mine = draw(st.integers(0, count))  # count: the agent itself is missing
        for index in range(count):
            targets = tuple(
                TargetEntry(identity, 100.0 * sequence, 1.0 * identity)
                for identity in sorted(draw(st.sets(st.integers(1, 4))))
            )
            agents = tuple(
                AgentEntry(10 * (index + 1) + k, 7.0 * sequence, 1.0 * k, None) for k in range(draw(st.integers(0, 2)))
            )
            if index == mine:
                goal = draw(st.sampled_from([None, *[target.id for target in targets]]))
                agents = (AgentEntry(ME, 0.0, 0.0, goal), *agents)
            threats = tuple(
                replace(THREAT, id=identity, north_m=10.0 * sequence)
                for identity in sorted(draw(st.sets(st.integers(1, 3))))
            )
            broadcast.append(state(sequence, agents, targets, threats, index=index, count=count, revision=sequence))
        told = {threat.id for frame in broadcast for threat in frame.threats}
        frames += [replace(frame, picture_threats=len(told)) for frame in broadcast]
    return frames


def assert_same_view(left: WorldModel, right: WorldModel, now_s: float) -> None:
    a, b = left.view(now_s), right.view(now_s)
    assert (a.target_ned_m, a.target_age_s) == (b.target_ned_m, b.target_age_s)
    for name in ("threats_ned_m", "detection_radius_m", "attack_radius_m", "peers_ned_m", "loitering_ned_m"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name


@pytest.mark.slow
@settings(max_examples=150)
@given(histories(), st.data())
def test_the_order_and_number_of_copies_of_frames_do_not_matter(history: list[StateFrame], data: st.DataObject) -> None:
    now_s = history[-1].stamp.unix_s
    copies = data.draw(st.lists(st.sampled_from(history), max_size=6))
    shuffled = data.draw(st.permutations([*history, *copies]))
    picture, in_order = WorldModel(ME), WorldModel(ME)
    for frame in shuffled:
        picture.take_state(frame, now_s)
    for frame in history:
        in_order.take_state(frame, now_s)
    assert_same_view(picture, in_order, now_s)


@pytest.mark.slow
@settings(max_examples=150)
@given(histories(), st.data())
def test_no_frame_that_arrives_makes_the_picture_older(history: list[StateFrame], data: st.DataObject) -> None:
    now_s = history[-1].stamp.unix_s
    arriving = data.draw(st.lists(st.sampled_from(history), max_size=12))
    picture, ages_s, newest = WorldModel(ME), [math.inf], -1
    for frame in arriving:
        picture.take_state(frame, now_s)
        newest = max(newest, frame.stamp.sequence)
        age_s = picture.age_s(now_s)
        assert age_s is not None
        ages_s.append(age_s)
        assert picture.order.sequence == newest
    assert ages_s == sorted(ages_s, reverse=True)


@pytest.mark.slow
@settings(max_examples=150)
@given(histories(), st.data())
def test_a_threat_is_only_lost_if_a_whole_picture_lacked_it(history: list[StateFrame], data: st.DataObject) -> None:
    now_s = history[-1].stamp.unix_s
    arriving = data.draw(st.lists(st.sampled_from(history), max_size=12))
    picture = WorldModel(ME)
    for frame in arriving:
        before = set(picture.view(now_s).threat_ids.tolist())
        taken = picture.take_state(frame, now_s)
        lost = before - set(picture.view(now_s).threat_ids.tolist())
        if lost:
            told = {t.id for f in history if f.revision == frame.revision for t in f.threats}
            assert taken
            assert picture.view(now_s).whole
            assert not lost & told


# Another plane


def test_a_change_of_origin_forgets_everything_on_the_old_plane() -> None:
    picture = picture_of(state(1, threats=(THREAT,), agents=(AgentEntry(ME, 0.0, 0.0, 1), AgentEntry(9, 1.0, 1.0, 1))))
    moved = state(2, agents=(), targets=(), origin_deg=(48.0, 9.0), index=0, count=2)
    picture.take_state(moved, time_of(2))
    view = picture.view(time_of(2))
    assert picture.origin_deg == (48.0, 9.0)
    assert view.target_ned_m is None
    assert (len(view.threats_ned_m), len(view.peers_ned_m)) == (0, 0)


# Peers

WITH_PEER = (AgentEntry(ME, 0.0, 0.0, 1), AgentEntry(9, 100.0, 200.0, 1))


def test_the_vehicle_is_not_its_own_peer() -> None:
    assert picture_of(state(1, agents=WITH_PEER)).view(time_of(1)).peers_ned_m.tolist() == [[100.0, 200.0]]


def test_a_peer_is_extrapolated_along_its_heading() -> None:
    picture = picture_of(state(1, agents=WITH_PEER))
    assert picture.take_motion(motion(1, AgentMotion(9, math.radians(90.0), 60.0, 0.0)), time_of(1))
    assert picture.view(time_of(1) + 2.0).peers_ned_m[0] == pytest.approx((100.0, 320.0))


def test_a_peer_whose_motion_is_unknown_stands_where_it_was_heard() -> None:
    view = picture_of(state(1, agents=WITH_PEER)).view(time_of(1) + 2.0)
    assert view.peers_ned_m.tolist() == [[100.0, 200.0]]


def test_a_peer_that_came_to_a_stand_is_extrapolated_no_more() -> None:
    picture = picture_of(state(1, agents=WITH_PEER))
    picture.take_motion(motion(1, AgentMotion(9, math.radians(90.0), 60.0, 0.0)), time_of(1))
    picture.take_state(state(2, agents=WITH_PEER), time_of(2))
    picture.take_motion(motion(2, AgentMotion(9, None, 0.0, 0.0)), time_of(2))
    assert picture.view(time_of(2) + 10.0).peers_ned_m.tolist() == [[100.0, 200.0]]


def test_a_peer_heard_of_too_long_ago_is_left_out() -> None:
    picture = WorldModel(ME, peer_memory_s=30.0)
    picture.take_state(state(1, agents=WITH_PEER), time_of(1))
    assert len(picture.view(time_of(1) + 29.9).peers_ned_m) == 1
    assert len(picture.view(time_of(1) + 30.1).peers_ned_m) == 0


def test_peers_that_loiter_or_have_a_lower_id_settle_first() -> None:
    agents = (
        AgentEntry(ME, 0.0, 0.0, 1),
        AgentEntry(2, 2.0, 0.0, 1),
        AgentEntry(8, 8.0, 0.0, None),
        AgentEntry(9, 9.0, 0.0, 1),
    )
    view = picture_of(state(1, agents=agents)).view(time_of(1))
    assert view.loitering_ned_m[:, 0].tolist() == [2.0, 8.0]
    assert view.peers_ned_m[:, 0].tolist() == [2.0, 8.0, 9.0]


def test_the_targets_of_others_are_claimed_but_not_ones_own() -> None:
    agents = (AgentEntry(ME, 0.0, 0.0, 1), AgentEntry(2, 2.0, 0.0, 1), AgentEntry(8, 8.0, 0.0, 3))
    targets = tuple(TargetEntry(k, 100.0 * k, 0.0) for k in (1, 2, 3, 4))
    view = picture_of(state(1, agents=agents, targets=targets)).view(time_of(1))
    assert view.claimed_ned_m.tolist() == [[300.0, 0.0]]


# Motion frames


def test_the_motion_of_another_epoch_is_refused() -> None:
    picture = picture_of(state(1))
    assert not picture.take_motion(motion(1, epoch_s=EPOCH_S + 1), time_of(1))


def test_a_motion_older_than_the_state_is_refused() -> None:
    picture = picture_of(state(2))
    assert not picture.take_motion(motion(1), time_of(1))


def test_a_motion_overtaken_by_a_newer_one_is_refused() -> None:
    picture = picture_of(state(1, agents=WITH_PEER))
    picture.take_motion(motion(3, AgentMotion(9, 0.0, 10.0, 0.0)), time_of(3))
    assert not picture.take_motion(motion(2, AgentMotion(9, 0.0, 60.0, 0.0)), time_of(2))
    assert picture.view(time_of(1) + 10.0).peers_ned_m[0] == pytest.approx((200.0, 200.0))


def test_a_threat_moves_as_its_motion_says_and_stands_until_one_does() -> None:
    picture = picture_of(state(1, threats=(THREAT, replace(THREAT, id=2))))
    picture.take_motion(replace(motion(1), threats=(PointMotion(2, 3.0, -4.0, 0.0),)), time_of(1))
    view = picture.view(time_of(1) + 3.0)
    assert view.threat_velocity_m_s.tolist() == [[0.0, 0.0], [3.0, -4.0]]
    assert view.threat_age_s.tolist() == [3.0, 3.0]


def test_a_motion_makes_the_picture_no_younger() -> None:
    picture = picture_of(state(1))
    picture.take_motion(motion(1, time_ms=90_000), time_of(1))
    assert picture.age_s(time_of(1) + 90.0) == pytest.approx(90.0)


# Heights that threats reach

LOW, HIGH = ThreatEntry(1, 1_000.0, 0.0, 500.0, 200.0, 10.0), ThreatEntry(2, 2_000.0, 0.0, 600.0, 300.0, 20.0)
BANDS = (BandEntry(1, None, 400.0), BandEntry(2, 600.0, 900.0))


def bands(sequence: int, *threats: BandEntry, epoch_s: int = EPOCH_S) -> BandsFrame:
    return BandsFrame(stamp(sequence, epoch_s=epoch_s), threats)


def banded(*threats: BandEntry) -> WorldModel:
    picture = picture_of(state(1, threats=(LOW, HIGH)))
    assert picture.take_bands(bands(1, *threats))
    return picture


def ids_at(picture: WorldModel, low_m: float, high_m: float, now_s: float = time_of(1)) -> list[int]:
    return [int(one) for one in picture.view(now_s, (low_m, high_m)).threat_ids]


@pytest.mark.parametrize(
    ("band_m", "expected"),
    [
        ((450.0, 550.0), []),
        ((350.0, 450.0), [1]),
        ((-900.0, -800.0), [1]),
        ((400.0, 450.0), [1]),
        ((550.0, 600.0), [2]),
        ((900.0, 950.0), [2]),
        ((900.5, 9_000.0), []),
        ((700.0, 750.0), [2]),
        ((0.0, 9_000.0), [1, 2]),
    ],
)
def test_threats_that_do_not_reach_the_vehicles_heights_are_left_out(
    band_m: tuple[float, float], expected: list[int]
) -> None:
    assert ids_at(banded(*BANDS), *band_m) == expected


def test_without_a_band_of_the_vehicles_own_all_threats_are_in_the_view() -> None:
    assert banded(*BANDS).view(time_of(1)).threat_ids.tolist() == [1, 2]


def test_a_threat_whose_band_was_never_heard_of_reaches_everywhere() -> None:
    assert ids_at(picture_of(state(1, threats=(LOW, HIGH))), 450.0, 550.0) == [1, 2]
    assert ids_at(banded(BANDS[1]), 450.0, 550.0) == [1]


def test_a_vehicle_that_does_not_know_its_height_is_shown_every_threat() -> None:
    assert ids_at(banded(*BANDS), math.nan, math.nan) == [1, 2]


def test_what_is_left_of_the_view_is_of_the_threats_that_are_left() -> None:
    picture = banded(*BANDS)
    whole, view = picture.view(time_of(2)), picture.view(time_of(2), (700.0, 800.0))
    for part in fields(view):
        if part.name.startswith(("threat", "detection", "attack")):
            assert np.array_equal(getattr(view, part.name), getattr(whole, part.name)[1:]), part.name


def test_a_newer_band_replaces_the_one_heard_before() -> None:
    picture = banded(*BANDS)
    assert picture.take_bands(bands(2, BandEntry(2, 100.0, 200.0)))
    assert ids_at(picture, 700.0, 800.0) == []
    assert ids_at(picture, 150.0, 160.0) == [1, 2]


def test_a_band_overtaken_by_a_newer_one_is_refused() -> None:
    picture = banded(*BANDS)
    picture.take_bands(bands(3, BandEntry(2, 100.0, 200.0)))
    assert not picture.take_bands(bands(2, BandEntry(2, 5_000.0, None)))
    assert ids_at(picture, 150.0, 160.0) == [1, 2]


def test_a_band_older_than_the_state_is_refused() -> None:
    picture = picture_of(state(2, threats=(LOW, HIGH)))
    assert not picture.take_bands(bands(1, *BANDS))


@pytest.mark.parametrize("epoch_s", [EPOCH_S - 1, EPOCH_S + 1])
def test_the_bands_of_another_epoch_are_refused(epoch_s: int) -> None:
    picture = picture_of(state(1, threats=(LOW, HIGH)))
    assert not picture.take_bands(bands(9, *BANDS, epoch_s=epoch_s))
    assert ids_at(picture, 450.0, 550.0) == [1, 2]


def test_bands_that_overtake_their_state_are_kept_for_it() -> None:
    picture = picture_of(state(1))
    assert picture.take_bands(bands(2, *BANDS))
    picture.take_state(state(2, threats=(LOW, HIGH)), time_of(2))
    assert ids_at(picture, 450.0, 550.0, time_of(2)) == []


def test_a_new_epoch_forgets_the_bands_of_the_old_one() -> None:
    picture, later = banded(*BANDS), EPOCH_S + 2_600
    picture.take_state(state(1, threats=(LOW, HIGH), epoch_s=later), time_of(1, later))
    assert ids_at(picture, 450.0, 550.0, time_of(1, later)) == [1, 2]
    assert picture.take_bands(bands(1, *BANDS, epoch_s=later))


def test_a_threat_that_left_the_picture_comes_back_without_its_band() -> None:
    picture = banded(*BANDS)
    picture.take_state(state(2, threats=(LOW,), revision=2), time_of(2))
    picture.take_state(state(3, threats=(LOW, HIGH), revision=3), time_of(3))
    assert ids_at(picture, 450.0, 550.0, time_of(3)) == [1, 2]
    picture.take_bands(bands(3, BANDS[0]))
    assert ids_at(picture, 450.0, 550.0, time_of(3)) == [2]


def test_a_change_of_origin_forgets_the_bands() -> None:
    picture = banded(*BANDS)
    picture.take_state(state(2, threats=(LOW, HIGH), origin_deg=(48.0, 9.0)), time_of(2))
    assert ids_at(picture, 450.0, 550.0, time_of(2)) == [1, 2]


def test_bands_make_the_picture_no_younger() -> None:
    picture = picture_of(state(1, threats=(LOW, HIGH)))
    picture.take_bands(bands(3, *BANDS))
    assert picture.age_s(time_of(3)) == pytest.approx(2 * PERIOD_S)


# Case II: places that are not broadcast, and what the vehicle itself sees

STILL = (0.0, 0.0)
UNSEEN = (AgentEntry(ME, None, None, 1), AgentEntry(2, None, None, 1), AgentEntry(9, None, None, None))


def test_peers_whose_place_is_not_broadcast_are_not_in_the_view() -> None:
    view = picture_of(state(1, agents=UNSEEN)).view(time_of(1))
    assert view.peers_ned_m.shape == view.loitering_ned_m.shape == (0, 2)
    assert view.peer_ids.shape == (0,)


def test_without_places_a_frame_tells_targets_threats_and_assignment_all_the_same() -> None:
    picture = picture_of(state(1, agents=UNSEEN, threats=(THREAT,)))
    view = picture.view(time_of(1))
    assert (picture.target_id, view.target_ned_m) == (1, (10.0, 20.0))
    assert view.threat_ids.tolist() == [1]


def test_a_peer_whose_place_is_no_longer_broadcast_leaves_the_view() -> None:
    picture = picture_of(state(1, agents=WITH_PEER), state(2, agents=(WITH_PEER[0], AgentEntry(9, None, None, 1))))
    assert picture.view(time_of(2)).peer_ids.tolist() == []


def test_with_nobody_seen_the_view_is_as_it_was() -> None:
    picture = picture_of(state(1, agents=WITH_PEER))
    view = picture.view(time_of(1))
    assert picture.with_traffic(view, []) is view


def test_a_peer_that_is_seen_is_where_it_is_seen_and_not_where_it_was_broadcast() -> None:
    picture = picture_of(state(1, agents=(*WITH_PEER, AgentEntry(8, 8.0, 8.0, 1))))
    view = picture.with_traffic(picture.view(time_of(1)), [Traffic(9, (150.0, 250.0), (1.0, -2.0))])
    assert dict(zip(view.peer_ids.tolist(), view.peers_ned_m.tolist(), strict=True)) == {
        8: [8.0, 8.0],
        9: [150.0, 250.0],
    }


def test_whoever_is_seen_is_in_the_view_with_where_it_is_seen_to_go() -> None:
    picture = picture_of(state(1, agents=WITH_PEER))
    view = picture.with_traffic(picture.view(time_of(1)), [Traffic(9, (150.0, 250.0), (1.0, -2.0))])
    assert (view.traffic_ned_m.tolist(), view.traffic_velocity_m_s.tolist()) == ([[150.0, 250.0]], [[1.0, -2.0]])


def test_seeing_changes_nothing_but_the_peers() -> None:
    picture = picture_of(state(1, agents=WITH_PEER, threats=(THREAT,)))
    before = picture.view(time_of(1))
    after = picture.with_traffic(before, [Traffic(None, (1.0, 2.0), STILL)])
    assert (after.target_ned_m, after.target_age_s) == (before.target_ned_m, before.target_age_s)
    assert np.array_equal(after.threats_ned_m, before.threats_ned_m)
    assert np.array_equal(after.attack_radius_m, before.attack_radius_m)
    assert len(before.peer_ids) == 1


def test_strangers_are_peers_that_nobody_knows_and_settle_first() -> None:
    picture = picture_of(state(1, agents=UNSEEN))
    seen = [Traffic(None, (1.0, 0.0), STILL), Traffic(None, (2.0, 0.0), STILL), Traffic(77, (3.0, 0.0), STILL)]
    view = picture.with_traffic(picture.view(time_of(1)), seen)
    assert view.peer_ids.tolist() == [NOBODY, NOBODY, 77]
    assert view.loitering_ned_m[:, 0].tolist() == [1.0, 2.0, 3.0]


def test_of_the_peers_seen_those_that_loiter_or_have_a_lower_id_settle_first() -> None:
    agents = (*UNSEEN, AgentEntry(8, None, None, 1))
    picture = picture_of(state(1, agents=agents))
    seen = [Traffic(k, (1.0 * k, 0.0), STILL) for k in (2, 8, 9)]
    view = picture.with_traffic(picture.view(time_of(1)), seen)
    assert view.peers_ned_m[:, 0].tolist() == [2.0, 8.0, 9.0]
    assert view.loitering_ned_m[:, 0].tolist() == [2.0, 9.0]


def test_a_settled_peer_that_is_only_broadcast_stays_settled_beside_one_that_is_seen() -> None:
    agents = (AgentEntry(ME, 0.0, 0.0, 1), AgentEntry(2, 2.0, 0.0, 1), AgentEntry(9, 9.0, 0.0, 1))
    picture = picture_of(state(1, agents=agents))
    view = picture.with_traffic(picture.view(time_of(1)), [Traffic(9, (90.0, 0.0), STILL)])
    assert view.loitering_ned_m[:, 0].tolist() == [2.0]
    view = picture.with_traffic(picture.view(time_of(1)), [Traffic(2, (20.0, 0.0), STILL)])
    assert view.loitering_ned_m[:, 0].tolist() == [20.0]


@given(
    st.sets(st.integers(1, 12)),
    st.lists(
        st.tuples(st.none() | st.integers(1, 14), st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))), max_size=8
    ),
)
def test_everybody_seen_is_a_peer_once_and_everybody_unseen_stays(
    heard: set[int], seen: list[tuple[int | None, tuple[float, float]]]
) -> None:
    agents = (AgentEntry(ME, 0.0, 0.0, 1), *(AgentEntry(k, 1.0 * k, 5_000.0, 1) for k in sorted(heard - {ME})))
    picture = picture_of(state(1, agents=agents[:10]))
    before = picture.view(time_of(1))
    view = picture.with_traffic(before, [Traffic(identity, place, STILL) for identity, place in seen])
    seen_ids = [identity or NOBODY for identity, _ in seen]
    assert sorted(view.peer_ids.tolist()) == sorted(
        [k for k in before.peer_ids.tolist() if k not in seen_ids] + seen_ids
    )
    assert view.peers_ned_m.shape == (len(view.peer_ids), 2)
    assert {tuple(place) for place in view.loitering_ned_m.tolist()} <= {tuple(p) for p in view.peers_ned_m.tolist()}


# Packed frames

PLACE = ThreatPlace(1, 1_000.0, 2_000.0, 0.0)
RADII = RadiiEntry(1, 500.0, 200.0, 10.0)


def fleet(
    sequence: int,
    agents: tuple[AgentEntry, ...] = (AgentEntry(ME, 0.0, 0.0, 1),),
    targets: tuple[TargetEntry, ...] = (TargetEntry(1, 10.0, 20.0),),
    threats: tuple[ThreatPlace, ...] = (),
    *,
    index: int = 0,
    count: int = 1,
    epoch_s: int = EPOCH_S,
    directive: Directive = Directive.NORMAL,
    revision: int = 1,
) -> FleetFrame:
    its_stamp = stamp(sequence, index, count, epoch_s)
    return FleetFrame(its_stamp, directive, revision, Grid(UNIT_CM, 0, 0), agents, targets, threats)


def radii(sequence: int, *entries: RadiiEntry, epoch_s: int = EPOCH_S, revision: int = 1) -> RadiiFrame:
    return RadiiFrame(stamp(sequence, epoch_s=epoch_s), revision, 1, entries)


def mission(
    sequence: int,
    threats: int = 0,
    *,
    epoch_s: int = EPOCH_S,
    origin_deg: tuple[float, float] = (47.0, 8.0),
    digest: bytes = b"mission1",
    revision: int = 1,
) -> MissionFrame:
    its_stamp = stamp(sequence, epoch_s=epoch_s)
    return MissionFrame(its_stamp, revision, *origin_deg, 500.0, 100.0, 300.0, bytes(8), 1, 1, threats, "one", digest)


def heard(*frames: StateFrame | FleetFrame | RadiiFrame | MissionFrame) -> WorldModel:
    picture = WorldModel(ME)
    for frame in frames:
        assert picture.take(frame, frame.stamp.unix_s)
    return picture


def test_a_fleet_frame_tells_places_and_targets_once_the_origin_is_known() -> None:
    picture = heard(mission(1), fleet(1, (AgentEntry(ME, 0.0, 0.0, 1), AgentEntry(9, 5.0, 6.0, None))))
    view = picture.view(time_of(1))
    assert picture.origin_deg == (47.0, 8.0)
    assert view.target_ned_m == (10.0, 20.0)
    assert view.peer_ids.tolist() == [9]
    assert picture.age_s(time_of(2)) == pytest.approx(PERIOD_S)


def test_fleet_frames_wait_for_the_origin_and_keep_their_age() -> None:
    picture = heard(fleet(1), fleet(2, targets=target_at(7.0)))
    assert picture.view(time_of(2)).target_ned_m is None
    assert picture.age_s(time_of(2)) is None
    assert picture.take(mission(2), time_of(4))
    assert picture.view(time_of(4)).target_ned_m == (7.0, 0.0)
    assert picture.age_s(time_of(4)) == pytest.approx(2 * PERIOD_S)


def test_a_directive_needs_no_origin() -> None:
    assert heard(fleet(1, directive=Directive.HOLD)).directives.in_force is Directive.HOLD
    assert heard(fleet(1, me(Directive.RETURN))).directives.in_force is Directive.RETURN


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_threat_is_believed_once_place_and_radii_are_known(order: tuple[int, int]) -> None:
    parts: list[FleetFrame | RadiiFrame] = [fleet(1, threats=(PLACE,)), radii(1, RADII)]
    picture = heard(mission(1), parts[order[0]])
    assert len(picture.view(time_of(1)).threat_ids) == 0
    assert picture.take(parts[order[1]], time_of(1))
    view = picture.view(time_of(1))
    assert tuple(view.threats_ned_m[0]) == (1_000.0, 2_000.0)
    assert view.detection_radius_m[0] == pytest.approx(500.0 + ROUNDING_M)
    assert view.attack_radius_m[0] == pytest.approx(200.0 + ROUNDING_M)


@given(st.floats(0.0, 1e3), st.floats(0.0, 1e3), st.floats(0.0, 100.0))
def test_a_packed_threat_grows_by_its_age_when_sent_and_since(told_s: float, since_s: float, bound_m_s: float) -> None:
    picture = heard(
        mission(1),
        radii(1, replace(RADII, speed_bound_m_s=bound_m_s)),
        fleet(1, threats=(replace(PLACE, age_s=told_s),)),
    )
    view = picture.view(time_of(1) + since_s)
    grown_m = ROUNDING_M + bound_m_s * (told_s + since_s)
    assert view.detection_radius_m[0] == pytest.approx(500.0 + grown_m, abs=1e-3)
    assert view.attack_radius_m[0] == pytest.approx(200.0 + grown_m, abs=1e-3)


def test_radii_heard_again_do_not_make_a_place_younger() -> None:
    picture = heard(mission(1), fleet(1, threats=(PLACE,)), radii(1, RADII))
    picture.take(radii(4, RADII), time_of(4))
    assert picture.view(time_of(4)).attack_radius_m[0] == pytest.approx(200.0 + ROUNDING_M + 10.0 * 3 * PERIOD_S)


def test_who_does_not_know_all_threats_yet_has_nowhere_to_go() -> None:
    picture = heard(mission(1, threats=2), fleet(1, threats=(PLACE, replace(PLACE, id=2))), radii(1, RADII))
    assert picture.view(time_of(1)).target_ned_m is None
    picture.take(radii(1, replace(RADII, id=2)), time_of(1))
    assert picture.view(time_of(1)).target_ned_m == (10.0, 20.0)


def test_the_heights_that_radii_tell_are_those_of_the_threat() -> None:
    high = replace(RADII, floor_m=1_000.0)
    picture = heard(mission(1), radii(1, high), fleet(1, threats=(PLACE,)))
    assert len(picture.view(time_of(1), (0.0, 100.0)).threat_ids) == 0
    assert len(picture.view(time_of(1), (0.0, 1_000.0)).threat_ids) == 1


def test_a_threat_that_a_packed_picture_lacks_is_forgotten_once_that_is_whole() -> None:
    both = (PLACE, replace(PLACE, id=2))
    picture = heard(mission(1, 2), radii(1, RADII, replace(RADII, id=2)), fleet(1, threats=both))
    assert picture.view(time_of(1)).threat_ids.tolist() == [1, 2]
    for frame in (fleet(2, threats=both[:1], revision=2), radii(2, RADII, revision=2)):
        picture.take(frame, time_of(2))
        assert picture.view(time_of(2)).threat_ids.tolist() == [1, 2]
    picture.take(mission(2, 1, revision=2, digest=b"mission2"), time_of(2))
    assert picture.view(time_of(2)).threat_ids.tolist() == [1]


def test_a_fleet_broadcast_heard_in_part_forgets_nothing() -> None:
    picture = heard(mission(1), radii(1, RADII), fleet(1, threats=(PLACE,)), fleet(2, count=2))
    assert picture.view(time_of(2)).threat_ids.tolist() == [1]


def test_a_threat_of_the_epoch_before_stands_until_it_is_known_anew() -> None:
    later = EPOCH_S + 100
    picture = heard(mission(1, 1), radii(1, RADII), fleet(1, threats=(PLACE,)))
    moved = replace(PLACE, north_m=1_300.0)
    picture.take(mission(1, 1, epoch_s=later), time_of(1, later))
    picture.take(fleet(1, threats=(moved,), epoch_s=later), time_of(1, later))
    view = picture.view(time_of(1, later))
    assert tuple(view.threats_ned_m[0]) == (1_000.0, 2_000.0)
    assert view.attack_radius_m[0] == pytest.approx(200.0 + ROUNDING_M + 10.0 * 100.0)
    assert view.target_ned_m == (10.0, 20.0)
    picture.take(radii(1, RADII, epoch_s=later), time_of(1, later))
    view = picture.view(time_of(1, later))
    assert tuple(view.threats_ned_m[0]) == (1_300.0, 2_000.0)
    assert view.attack_radius_m[0] == pytest.approx(200.0 + ROUNDING_M)


def test_until_a_new_epoch_tells_its_origin_the_threats_of_the_old_one_stand_and_nobody_goes_anywhere() -> None:
    later = EPOCH_S + 100
    picture = heard(mission(1, 1), radii(1, RADII), fleet(1, targets=target_at(1.0), threats=(PLACE,)))
    picture.take(fleet(1, targets=target_at(2.0), epoch_s=later), time_of(1, later))
    assert picture.view(time_of(1, later)).target_ned_m is None
    assert picture.view(time_of(1, later)).threat_ids.tolist() == [1]
    assert picture.missing == "new revision: 0 threats heard, of how many is not known"
    assert picture.age_s(time_of(1, later)) == pytest.approx(100.0)
    picture.take(mission(1, 1, epoch_s=later), time_of(1, later))
    assert picture.view(time_of(1, later)).target_ned_m == (2.0, 0.0)
    assert picture.age_s(time_of(1, later)) == 0.0


def test_radii_of_an_epoch_before_do_not_join_a_place_of_this_one() -> None:
    later = EPOCH_S + 100
    picture = heard(mission(1), radii(1, RADII))
    picture.take(mission(1, epoch_s=later), time_of(1, later))
    picture.take(fleet(1, threats=(PLACE,), epoch_s=later), time_of(1, later))
    assert len(picture.view(time_of(1, later)).threat_ids) == 0


def test_a_place_of_an_epoch_before_does_not_join_radii_of_this_one() -> None:
    later = EPOCH_S + 100
    picture = heard(mission(1), fleet(1, threats=(PLACE,)))
    picture.take(radii(1, RADII, epoch_s=later), time_of(1, later))
    assert len(picture.view(time_of(1, later)).threat_ids) == 0


def test_frames_that_wait_for_the_origin_of_an_epoch_are_gone_with_it() -> None:
    later = EPOCH_S + 100
    picture = heard(fleet(1))
    picture.take(mission(1, epoch_s=later), time_of(1, later))
    assert picture.view(time_of(1, later)).target_ned_m is None


def test_of_waiting_frames_the_newest_wins() -> None:
    here, there = (TargetEntry(1, 10.0, 0.0),), (TargetEntry(2, 20.0, 0.0),)
    picture = heard(
        fleet(1, (), (), index=0, count=2),
        fleet(1, (AgentEntry(ME, 0.0, 0.0, 1),), here, index=1, count=2),
        fleet(2, (AgentEntry(ME, 0.0, 0.0, 2),), there, index=0, count=2),
        mission(2),
    )
    assert picture.target_id == 2
    assert picture.age_s(time_of(2)) == 0.0


def test_a_place_about_another_origin_does_not_join_radii() -> None:
    picture = heard(mission(1), fleet(1, threats=(PLACE,)), mission(2, origin_deg=(48.0, 8.0)), radii(2, RADII))
    assert len(picture.view(time_of(2)).threat_ids) == 0


@pytest.mark.parametrize("changed", [{"origin_deg": (48.0, 8.0)}, {"digest": b"mission2"}])
def test_another_mission_holds_nothing_of_the_one_before(changed: dict[str, object]) -> None:
    later = EPOCH_S + 100
    picture = heard(mission(1, 1), radii(1, RADII), fleet(1, threats=(PLACE,)))
    picture.take(mission(1, **{"threats": 1, **changed}, epoch_s=later), time_of(1, later))  # type: ignore[arg-type]
    assert picture.view(time_of(1, later)).target_ned_m is None
    picture.take(radii(1, replace(RADII, id=2), epoch_s=later), time_of(1, later))
    picture.take(fleet(1, targets=(), threats=(replace(PLACE, id=2),), epoch_s=later), time_of(1, later))
    view = picture.view(time_of(1, later))
    assert view.threat_ids.tolist() == [2]
    assert view.target_ned_m is None


def test_threats_of_another_mission_do_not_count_as_those_of_this_one() -> None:
    later = EPOCH_S + 100
    picture = heard(mission(1, 1), radii(1, RADII), fleet(1, threats=(PLACE,)))
    picture.take(mission(1, 1, epoch_s=later, digest=b"mission2"), time_of(1, later))
    picture.take(fleet(1, threats=(PLACE,), epoch_s=later), time_of(1, later))
    assert picture.view(time_of(1, later)).target_ned_m is None
    picture.take(radii(1, RADII, epoch_s=later), time_of(1, later))
    assert picture.view(time_of(1, later)).target_ned_m == (10.0, 20.0)


def test_threats_that_state_frames_told_of_stand_and_grow_but_do_not_count_as_those_of_a_mission() -> None:
    later = EPOCH_S + 100
    picture = heard(state(1, threats=(replace(THREAT, id=2), replace(THREAT, id=3))))
    picture.take(mission(1, 1, epoch_s=later), time_of(1, later))
    picture.take(fleet(1, epoch_s=later, count=2), time_of(1, later))
    view = picture.view(time_of(1, later))
    assert view.threat_ids.tolist() == [2, 3]
    assert view.attack_radius_m.tolist() == [1_200.0, 1_200.0]
    assert view.target_ned_m is None


def test_a_state_frame_between_two_missions_frees_nobody_of_knowing_the_threats_of_the_second() -> None:
    second, third = EPOCH_S + 100, EPOCH_S + 200
    picture = heard(mission(1, 1), radii(1, RADII), fleet(1, threats=(PLACE,)))
    picture.take(state(1, threats=(THREAT,), epoch_s=second), time_of(1, second))
    assert picture.view(time_of(1, second)).target_ned_m == (10.0, 20.0)
    picture.take(mission(1, 1, epoch_s=third), time_of(1, third))
    assert picture.view(time_of(1, third)).target_ned_m is None


def test_the_beginning_of_an_epoch_frees_nobody_of_knowing_the_threats_of_the_last() -> None:
    later = EPOCH_S + 100
    picture = heard(mission(1, 1), fleet(1))
    picture.take(radii(1, RADII, epoch_s=later), time_of(1, later))
    assert picture.view(time_of(1, later)).target_ned_m is None


def test_what_a_state_frame_told_in_this_epoch_outlives_the_first_word_of_another_mission() -> None:
    later = EPOCH_S + 100
    picture = heard(mission(1, 1), radii(1, RADII), fleet(1, threats=(PLACE,)))
    picture.take(state(1, threats=(replace(THREAT, id=2),), epoch_s=later), time_of(1, later))
    picture.take(mission(1, 1, epoch_s=later, digest=b"mission2"), time_of(1, later))
    view = picture.view(time_of(1, later))
    assert view.threat_ids.tolist() == [2]
    assert view.target_ned_m == (10.0, 20.0)


def test_a_fleet_frame_repeated_or_overtaken_is_refused() -> None:
    picture = heard(mission(2), fleet(2))
    assert not picture.take(fleet(2), time_of(2))
    assert not picture.take(fleet(1), time_of(2))


@pytest.mark.parametrize("frame", [fleet(9), radii(9, RADII), mission(9)])
def test_packed_frames_of_a_lower_epoch_are_refused(frame: FleetFrame | RadiiFrame | MissionFrame) -> None:
    picture = heard(mission(1), fleet(1))
    old = replace(frame, stamp=replace(frame.stamp, epoch_s=EPOCH_S - 1))
    assert not picture.take(old, time_of(1) + 1.0)


def test_the_carousel_does_not_hinder_the_fleet_frames_it_overtakes() -> None:
    picture = heard(radii(3, RADII), mission(3, 1))
    assert picture.take(fleet(2, threats=(PLACE,)), time_of(3))
    assert picture.view(time_of(3)).threat_ids.tolist() == [1]


def test_a_state_frame_after_fleet_frames_is_newer_than_they_are() -> None:
    picture = heard(mission(1, 1), radii(1, RADII), fleet(1, threats=(PLACE,)))
    assert picture.take(state(2, threats=(replace(THREAT, north_m=1_500.0),), count=2), time_of(2))
    picture.take(radii(2, RADII), time_of(2))
    assert tuple(picture.view(time_of(2)).threats_ned_m[0]) == (1_500.0, 2_000.0)


def test_frames_that_are_no_broadcast_are_not_taken() -> None:
    assert not WorldModel(ME).take(ReportFrame(EPOCH_S, 0, 1, 47.0, 8.0, 0.0, 0.0, 0.0), time_of(1))


def test_waiting_frames_of_a_broadcast_heard_whole_keep_all_that_they_hold() -> None:
    later = EPOCH_S + 100
    picture = heard(mission(1, 1), radii(1, RADII), fleet(1, threats=(PLACE,)))
    for index, threats in enumerate([(), (PLACE,)]):
        picture.take(fleet(1, threats=threats, index=index, count=2, epoch_s=later), time_of(1, later))
    picture.take(mission(1, 1, epoch_s=later), time_of(1, later))
    assert picture.view(time_of(1, later)).threat_ids.tolist() == [1]


# Whole pictures

STANDING = tuple(ThreatEntry(k, 1_000.0 * k, -500.0 * k, 300.0, 100.0, 0.0) for k in range(1, 6))


def parts(
    sequence: int, threats: tuple[ThreatEntry, ...], *, revision: int = 1, epoch_s: int = EPOCH_S
) -> list[StateFrame]:
    """Return a broadcast in frames of two threats each, every one with the vehicle and its target."""
    cut = [threats[at : at + 2] for at in range(0, len(threats), 2)] or [()]
    return [
        state(
            sequence,
            threats=part,
            index=index,
            count=len(cut),
            revision=revision,
            picture_threats=len(threats),
            epoch_s=epoch_s,
        )
        for index, part in enumerate(cut)
    ]


def test_until_every_threat_of_the_picture_was_heard_it_is_not_whole_and_there_is_no_target() -> None:
    first, second, third = parts(1, STANDING)
    picture = picture_of(first, third)
    assert picture.missing == "3 of 5 threats heard"
    view = picture.view(time_of(1))
    assert (view.whole, view.target_ned_m) == (False, None)
    assert view.threat_ids.tolist() == [1, 2, 5]
    picture.take(second, time_of(1))
    assert picture.missing is None
    assert (picture.view(time_of(1)).whole, picture.view(time_of(1)).target_ned_m) == (True, (10.0, 20.0))


def test_parts_of_several_broadcasts_of_one_revision_make_a_whole_picture() -> None:
    one, two = parts(1, STANDING), parts(4, STANDING)
    assert picture_of(one[0], two[1], two[2]).missing is None


def test_parts_of_two_revisions_do_not() -> None:
    one, two = parts(1, STANDING), parts(2, STANDING, revision=2)
    assert picture_of(*one[:2], two[2]).missing == "1 of 5 threats heard"


def test_a_new_revision_voids_a_whole_picture_as_soon_as_one_frame_of_it_is_heard() -> None:
    grown = (*STANDING[:4], replace(STANDING[4], detection_radius_m=900.0))
    picture = picture_of(*parts(1, STANDING))
    picture.take(parts(2, grown, revision=2)[0], time_of(2))
    assert picture.missing == "new revision: 2 of 5 threats heard"
    assert picture.view(time_of(2)).threat_ids.tolist() == [1, 2, 3, 4, 5]
    for frame in parts(3, grown, revision=2):
        picture.take(frame, time_of(3))
    assert picture.missing is None
    assert picture.view(time_of(3)).detection_radius_m[4] == 900.0


def test_a_frame_of_a_revision_overtaken_by_a_radii_frame_brings_its_directive_and_nothing_else() -> None:
    picture = heard(mission(1, 1), radii(1, RADII), fleet(1, threats=(PLACE,)), radii(3, RADII, revision=2))
    late = fleet(2, targets=target_at(99.0), threats=(replace(PLACE, north_m=9.0),), directive=Directive.RETURN)
    assert not picture.take(late, time_of(3))
    assert picture.directives.in_force is Directive.RETURN
    assert picture.view(time_of(3)).threats_ned_m.tolist() == [[1_000.0, 2_000.0]]


def test_a_frame_of_a_revision_overtaken_brings_the_vehicles_own_directive() -> None:
    picture = heard(mission(1, 1), radii(1, RADII), fleet(1, threats=(PLACE,)), radii(3, RADII, revision=2))
    assert not picture.take(fleet(2, me(Directive.HOLD)), time_of(3))
    assert picture.directives.words == "directive hold, for this agent"


def test_radii_of_a_revision_that_is_over_are_refused() -> None:
    picture = heard(mission(1, 1), fleet(2, threats=(PLACE,), revision=2))
    assert not picture.take(radii(1, RADII, revision=1), time_of(2))
    assert len(picture.view(time_of(2)).threat_ids) == 0


def test_a_packed_picture_is_whole_only_with_its_number_of_threats_its_places_and_its_radii() -> None:
    picture = heard(fleet(1, threats=(PLACE, replace(PLACE, id=2))), radii(1, RADII))
    assert picture.missing == "0 threats heard, of how many is not known"
    picture.take(mission(1, 2), time_of(1))
    assert picture.missing == "1 of 2 threats heard"
    picture.take(radii(1, replace(RADII, id=2)), time_of(1))
    assert picture.missing is None


def test_places_that_wait_for_the_origin_are_gone_with_their_revision() -> None:
    picture = heard(fleet(1, threats=(PLACE,)), radii(2, RADII, revision=2), mission(2, 1, revision=2))
    assert picture.missing == "0 of 1 threats heard"
    assert len(picture.view(time_of(2)).threat_ids) == 0


def test_a_new_revision_forgets_the_bands_of_the_one_before() -> None:
    picture = banded(*BANDS)
    picture.take_state(state(2, threats=(LOW, HIGH), revision=2), time_of(2))
    assert ids_at(picture, 450.0, 550.0, time_of(2)) == [1, 2]


def test_whoever_knows_the_picture_but_not_the_place_of_its_target_says_so() -> None:
    picture = heard(mission(1), fleet(1, targets=(), index=0, count=2))
    assert picture.missing == "target 1 not heard"
    assert picture.view(time_of(1)).whole
    picture.take(fleet(1, (), index=1, count=2), time_of(1))
    assert picture.missing is None


def test_a_coarser_word_never_replaces_a_finer_one_on_a_threat_that_stands() -> None:
    fine = STANDING[0]
    coarse = replace(fine, north_m=1_010.0, detection_radius_m=320.0, attack_radius_m=120.0)
    inside = replace(fine, north_m=1_002.0, detection_radius_m=298.0, attack_radius_m=98.0)
    picture = picture_of(state(1, threats=(fine,)), state(2, threats=(coarse,)))
    view = picture.view(time_of(2))
    assert (view.threats_ned_m[0, 0], view.detection_radius_m[0], view.threat_age_s[0]) == (1_000.0, 300.0, 0.0)
    picture.take(state(3, threats=(inside,)), time_of(3))
    assert picture.view(time_of(3)).detection_radius_m[0] == 298.0
    picture.take(state(4, threats=(coarse,), revision=2), time_of(4))
    assert picture.view(time_of(4)).detection_radius_m[0] == 320.0


def test_of_a_threat_that_moves_the_newest_word_counts() -> None:
    moved = replace(THREAT, north_m=1_020.0, detection_radius_m=540.0, attack_radius_m=240.0)
    picture = picture_of(state(1, threats=(THREAT,)), state(2, threats=(moved,)))
    assert picture.view(time_of(2)).detection_radius_m[0] == 540.0
