"""The centre's picture: the newest detections, who is lost, who has arrived."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.geo.kinematics import advance
from companion.geo.local_frame import LocalFrame
from companion.mission.extent import FARTHEST_M
from companion.mission.model import parse_mission
from companion.protocol.codec import Detection, DetectionsFrame, Kind
from groundstation.agents import Estimate
from groundstation.origins import SEEN_S
from groundstation.track import Track, passed_at_m
from groundstation.tracks import TOO_FAR, TrackTable

START_S = 1_790_000_000.0
ORIGIN_DEG = (47.0, 8.0)
MISSION = parse_mission(
    """
agents: [{id: 1, north_m: 0, east_m: 0}, {id: 2, north_m: 0, east_m: 5000}, {id: 3, north_m: 0, east_m: 9000}]
targets: [{id: 1, north_m: 20000, east_m: 0}, {id: 2, north_m: 20000, east_m: 5000}]
defaults: {target: {speed_bound_m_s: 30}}
threats: [{id: 1, north_m: 10000, east_m: 0, detection_radius_m: 3000, attack_radius_m: 1000, speed_bound_m_s: 12},
  {id: 2, north_m: -9000, east_m: 0, detection_radius_m: 3000, attack_radius_m: 1000, speed_bound_m_s: 0}]
arrival_radius_m: 300
lost_after_s: 30
""",
    "test",
)


NOBODY_SENT: dict[int, int] = {}


def picture(silent_after_s: float | None = 30.0, case: str = "I") -> TrackTable:
    return TrackTable(MISSION.model_copy(update={"case": case}), START_S, silent_after_s)


def look(t_s: float, *detections: Detection, origin_deg: tuple[float, float] = ORIGIN_DEG) -> DetectionsFrame:
    return DetectionsFrame(int(START_S), round(t_s * 1000), *origin_deg, detections)


def agent(identity: int, north_m: float, east_m: float) -> Detection:
    return Detection(Kind.AGENT, identity, north_m, east_m, 60.0, 0.0)


def see(ground: TrackTable, t_s: float, *detections: Detection) -> None:
    ground.take(look(t_s, *detections), START_S + t_s)


def approach(ground: TrackTable, t_s: float, north_m: float, east_m: float, identity: int = 2) -> None:
    """Let an agent be found at a place and stay there for two looks, as one that the mission has elsewhere."""
    for before_s in (2.0, 1.0, 0.0):
        see(ground, t_s - before_s, agent(identity, north_m, east_m))


def all_seen(ground: TrackTable, t_s: float, but: int | None = None) -> None:
    see(ground, t_s, *(agent(k, 0.0, 5_000.0 * (k - 1)) for k in (1, 2, 3) if k != but))


def test_it_begins_with_what_the_mission_says() -> None:
    ground = picture()
    assert ground.tracks[Kind.AGENT, 2].position_ned_m == (0.0, 5_000.0)
    assert ground.tracks[Kind.TARGET, 1].position_ned_m == (20_000.0, 0.0)
    assert ground.tracks[Kind.THREAT, 1].position_ned_m == (10_000.0, 0.0)
    assert ground.tracks[Kind.AGENT, 2].age_s(START_S + 7.0) == 7.0
    assert (ground.active_agents, ground.open_targets) == ([1, 2, 3], [1, 2])


def test_a_detection_moves_a_track() -> None:
    ground = picture()
    see(ground, 5.0, Detection(Kind.THREAT, 1, 10_050.0, 20.0, 10.0, -4.0))
    track = ground.tracks[Kind.THREAT, 1]
    assert track.position_ned_m == (10_050.0, 20.0)
    assert (track.velocity_north_m_s, track.velocity_east_m_s) == (10.0, -4.0)
    assert track.age_s(START_S + 6.0) == pytest.approx(1.0)


def test_an_older_detection_is_ignored() -> None:
    ground = picture()
    see(ground, 5.0, agent(1, 300.0, 0.0))
    ground.take(look(4.0, agent(1, 240.0, 0.0)), START_S + 6.0)
    assert ground.tracks[Kind.AGENT, 1].north_m == 300.0


@pytest.mark.parametrize("kind", Kind)
def test_a_detection_of_something_unknown_is_ignored(kind: Kind) -> None:
    ground = picture()
    known = set(ground.tracks)
    see(ground, 5.0, Detection(kind, 77, 1.0, 1.0, 0.0, 0.0))
    assert set(ground.tracks) == known


def test_a_sensor_whose_clock_is_a_little_ahead_makes_no_track_younger_than_its_receipt() -> None:
    ground = picture()
    ground.take(look(2.9, agent(1, 60.0, 0.0)), START_S + 1.0)
    assert ground.tracks[Kind.AGENT, 1].seen_at_s == START_S + 1.0
    see(ground, 2.0, agent(1, 120.0, 0.0))
    assert ground.tracks[Kind.AGENT, 1].north_m == 120.0


def test_detections_about_another_origin_are_converted() -> None:
    ground = picture()
    here, there = LocalFrame(*ORIGIN_DEG), LocalFrame(47.5, 8.5)
    north_m, east_m = there.to_local(*here.to_global(234.0, -167.0))
    assert abs(north_m) > 10_000.0
    ground.take(look(5.0, agent(1, north_m, east_m), origin_deg=(47.5, 8.5)), START_S + 5.0)
    assert ground.tracks[Kind.AGENT, 1].position_ned_m == pytest.approx((234.0, -167.0), abs=0.01)


def test_an_agent_not_detected_for_long_enough_is_lost() -> None:
    ground = picture()
    for t_s in (8.0, 9.0, 10.0):
        all_seen(ground, t_s, but=2)
    assert not ground.update(START_S + 30.0, NOBODY_SENT)
    assert ground.update(START_S + 30.5, NOBODY_SENT)
    assert ground.progress.lost == {2}
    assert (ground.active_agents, ground.present_agents) == ([1, 3], [1, 3])


def test_a_lost_agent_that_is_detected_again_is_back() -> None:
    ground = picture()
    all_seen(ground, 20.0, but=2)
    ground.update(START_S + 40.0, NOBODY_SENT)
    all_seen(ground, 41.0)
    assert ground.update(START_S + 41.0, NOBODY_SENT)
    assert ground.progress.lost == frozenset()
    assert ground.active_agents == [1, 2, 3]


def test_nothing_having_changed_is_said_so() -> None:
    ground = picture()
    all_seen(ground, 1.0)
    assert not ground.update(START_S + 1.0, NOBODY_SENT)


def test_where_nobody_is_heard_of_nobody_is_ever_lost() -> None:
    ground = picture(None)
    assert not ground.update(START_S + 1e6, NOBODY_SENT)
    assert ground.active_agents == [1, 2, 3]


def test_an_agent_within_the_arrival_radius_completes_the_target() -> None:
    ground = picture()
    approach(ground, 5.0, 20_000.0, 300.0)
    assert ground.update(START_S + 5.0, NOBODY_SENT)
    assert (ground.progress.arrived, ground.progress.completed) == (frozenset({2}), frozenset({1}))
    assert (ground.active_agents, ground.present_agents, ground.open_targets) == ([1, 3], [1, 2, 3], [2])


def test_just_outside_the_arrival_radius_is_not_arrived() -> None:
    ground = picture()
    approach(ground, 5.0, 20_000.0, 300.1)
    assert not ground.update(START_S + 5.0, NOBODY_SENT)


def test_an_agent_that_has_arrived_completes_no_second_target() -> None:
    ground = picture()
    approach(ground, 5.0, 20_000.0, 0.0)
    ground.update(START_S + 5.0, NOBODY_SENT)
    see(ground, 6.0, agent(2, 20_000.0, 0.0))
    ground.update(START_S + 6.0, NOBODY_SENT)
    approach(ground, 105.0, 20_000.0, 5_000.0)
    ground.update(START_S + 105.0, NOBODY_SENT)
    assert ground.tracks[Kind.AGENT, 2].east_m == 5_000.0
    assert ground.open_targets == [2]


def test_a_completed_target_stays_completed_when_it_moves_away() -> None:
    ground = picture()
    approach(ground, 5.0, 20_000.0, 0.0)
    ground.update(START_S + 5.0, NOBODY_SENT)
    see(ground, 6.0, agent(2, 20_000.0, 0.0))
    for t_s in range(6, 60):
        see(ground, t_s, Detection(Kind.TARGET, 1, 20_000.0 + 30.0 * t_s, 0.0, 30.0, 0.0))
        ground.update(START_S + t_s, NOBODY_SENT)
    assert ground.tracks[Kind.TARGET, 1].north_m == 21_770.0
    assert ground.open_targets == [2]


def test_a_lost_agent_completes_nothing_where_it_was_last_seen() -> None:
    ground = picture()
    approach(ground, 2.0, 20_000.0, 600.0)
    all_seen(ground, 40.0, but=2)
    ground.update(START_S + 40.0, NOBODY_SENT)
    see(ground, 40.0, Detection(Kind.TARGET, 1, 20_000.0, 310.0, 0.0, 0.0))
    assert not ground.update(START_S + 40.0, NOBODY_SENT)
    assert ground.tracks[Kind.TARGET, 1].east_m == 310.0
    assert ground.progress.completed == frozenset()


# Case II: agents are placed, not detected


def placed(ground: TrackTable, t_s: float, north_m: float, uncertainty_m: float, identity: int = 1) -> None:
    estimate = Estimate(north_m, 0.0, 0.0, 60.0, 1_234.0, uncertainty_m)
    ground.place(identity, estimate, START_S + t_s)


def test_in_case_ii_an_agent_that_is_detected_all_the_same_is_told_where_it_was_seen() -> None:
    ground = picture(None, "II")
    see(ground, 5.0, agent(1, 300.0, 0.0), Detection(Kind.TARGET, 1, 19_900.0, 0.0, 0.0, 0.0))
    assert ground.tracks[Kind.AGENT, 1].north_m == 300.0
    assert ground.tracks[Kind.TARGET, 1].north_m == 19_900.0
    assert ground.told_agents(START_S + 6.0) == [1]
    assert ground.told_agents(START_S + 5.1 + SEEN_S) == []


def test_an_agent_is_placed_with_its_motion_its_doubt_and_the_way_that_it_has_flown() -> None:
    ground = picture(None, "II")
    ground.place(2, Estimate(100.0, 200.0, math.radians(90.0), 60.0, 1_234.0, 56.0), START_S + 7.0)
    track = ground.tracks[Kind.AGENT, 2]
    assert track.position_ned_m == (100.0, 200.0)
    assert (track.velocity_north_m_s, track.velocity_east_m_s) == pytest.approx((0.0, 60.0))
    assert (track.seen_at_s, ground.flown_m[2], ground.uncertainty_m[2]) == (START_S + 7.0, 1_234.0, 56.0)


def test_detections_measure_the_way_flown() -> None:
    ground = picture()
    for turn, place in enumerate([(300.0, 0.0), (300.0, 400.0), (0.0, 0.0)], 1):
        see(ground, 8.0 * turn, agent(1, *place))
    assert ground.flown_m == {1: 300.0 + 400.0 + 500.0, 2: 0.0, 3: 0.0}


def test_where_an_agent_is_certain_it_arrives_at_once_and_anywhere() -> None:
    ground = picture(None, "II")
    placed(ground, 5.0, 19_800.0, 0.0)
    assert ground.update(START_S + 5.0, {1: 2})
    assert (ground.progress.arrived, ground.progress.completed) == (frozenset({1}), frozenset({1}))


@given(uncertainty_m=st.floats(1.0, 3_000.0))
def test_an_uncertain_arrival_is_believed_when_the_doubt_could_be_flown(uncertainty_m: float) -> None:
    ground = picture(None, "II")
    placed(ground, 5.0, 19_800.0, uncertainty_m)
    doubt_s = uncertainty_m / 60.0
    assert not ground.update(START_S + 5.0, {1: 1})
    assert not ground.update(START_S + 5.0 + doubt_s - 0.01, {1: 1})
    assert ground.update(START_S + 5.0 + doubt_s + 0.01, {1: 1})
    assert (ground.progress.arrived, ground.progress.completed) == (frozenset({1}), frozenset({1}))


def test_an_uncertain_agent_passing_a_target_it_was_not_sent_to_does_not_arrive() -> None:
    ground = picture(None, "II")
    for t_s in (5.0, 50.0):
        placed(ground, t_s, 19_800.0, 600.0)
        assert not ground.update(START_S + t_s, {1: 2})
    assert not ground.update(START_S + 50.0, NOBODY_SENT)


def test_an_uncertain_agent_sent_elsewhere_in_the_meantime_begins_anew() -> None:
    ground = picture(None, "II")
    placed(ground, 5.0, 19_800.0, 600.0)
    ground.update(START_S + 5.0, {1: 1})
    ground.update(START_S + 10.0, {1: 2})
    assert not ground.update(START_S + 16.0, {1: 1})
    assert not ground.update(START_S + 25.9, {1: 1})
    assert ground.update(START_S + 26.1, {1: 1})


def test_an_uncertain_agent_need_not_stay_near_by_the_centres_own_lights() -> None:
    ground = picture(None, "II")
    placed(ground, 5.0, 19_800.0, 600.0)
    ground.update(START_S + 5.0, {1: 1})
    placed(ground, 10.0, 19_600.0, 600.0)
    assert ground.update(START_S + 15.1, {1: 1})


def test_an_arrival_waits_for_the_doubt_as_it_has_grown_since() -> None:
    ground = picture(None, "II")
    placed(ground, 5.0, 19_800.0, 60.0)
    ground.update(START_S + 5.0, {1: 1})
    placed(ground, 6.5, 19_800.0, 120.0)
    assert not ground.update(START_S + 6.5, {1: 1})
    assert ground.update(START_S + 7.1, {1: 1})


def test_what_nobody_has_seen_is_as_old_as_the_mission() -> None:
    ground = TrackTable(MISSION, START_S, 30.0, START_S - 600.0)
    see(ground, 1.0, Detection(Kind.TARGET, 1, 20_000.0, 0.0, 0.0, 0.0))
    assert ground.tracks[Kind.THREAT, 1].age_s(START_S) == 600.0
    assert ground.tracks[Kind.TARGET, 1].age_s(START_S + 1.0) == 0.0
    assert not ground.update(START_S + 2.0, NOBODY_SENT)


@pytest.mark.parametrize("origin_deg", [ORIGIN_DEG, (-40.0, 100.0)])
@pytest.mark.parametrize(
    ("north_m", "east_m"), [(21_474_836.0, 0.0), (0.0, -21_474_836.0), (15e6, 15e6), (FARTHEST_M * 1.001, 0.0)]
)
def test_a_detection_farther_than_a_frame_can_carry_is_counted_and_ignored(
    north_m: float, east_m: float, origin_deg: tuple[float, float]
) -> None:
    ground = picture()
    far = Detection(Kind.THREAT, 1, north_m, east_m, 0.0, 0.0)
    north_of_target = LocalFrame(*origin_deg).to_local(*LocalFrame(*ORIGIN_DEG).to_global(20_020.0, 0.0))
    near = Detection(Kind.TARGET, 1, *north_of_target, 0.0, 0.0)
    ground.take(look(1.0, far, near, origin_deg=origin_deg), START_S + 1.0)
    assert ground.refusals.count(TOO_FAR) == 1
    assert ground.tracks[Kind.THREAT, 1].position_ned_m == (10_000.0, 0.0)
    assert ground.tracks[Kind.TARGET, 1].seen_at_s == START_S + 1.0


def test_a_target_passed_between_two_detections_is_completed() -> None:
    ground = picture()
    approach(ground, 20.0, 19_000.0, 0.0, 1)
    assert not ground.update(START_S + 20.0, NOBODY_SENT)
    see(ground, 30.0, agent(1, 19_650.0, 0.0))
    assert not ground.update(START_S + 30.0, NOBODY_SENT)
    see(ground, 40.0, agent(1, 20_350.0, 0.0))
    assert ground.update(START_S + 40.0, NOBODY_SENT)
    assert ground.progress.completed == {1}


def test_a_sighting_that_no_flight_explains_completes_nothing_on_its_way() -> None:
    ground = picture()
    approach(ground, 10.0, 19_000.0, 0.0, 1)
    ground.update(START_S + 10.0, NOBODY_SENT)
    see(ground, 11.0, agent(1, 21_000.0, 0.0))
    assert not ground.update(START_S + 11.0, NOBODY_SENT)


@given(
    turn_rad=st.floats(-0.5, 0.5),
    heading_rad=st.floats(-math.pi, math.pi),
    north_m=st.floats(-60.0, 60.0),
    east_m=st.floats(-60.0, 60.0),
)
def test_the_way_between_two_detections_is_the_arc_that_was_flown(
    turn_rad: float, heading_rad: float, north_m: float, east_m: float
) -> None:
    def track(t_s: float) -> Track:
        there = advance(0.0, 0.0, heading_rad, 60.0, turn_rad, t_s)
        return Track(there[0], there[1], 60.0 * math.cos(there[2]), 60.0 * math.sin(there[2]), t_s)

    target = Track(north_m, east_m, 0.0, 0.0, 0.0)
    sampled_m = min(math.dist(track(step / 500.0).position_ned_m, (north_m, east_m)) for step in range(501))
    assert passed_at_m((track(0.0), track(1.0)), (target, target)) == pytest.approx(sampled_m, abs=0.1)
