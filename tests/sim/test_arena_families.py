"""The arena's scenes: legal, the same for the same seed, and of the kind their family says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.geo.kinematics import turn_rate_rad_s
from companion.geo.right_of_way import Rules, interaction_radius_m
from companion.mission.model import Mission, PathMotion, dump_mission, parse_mission
from companion.mission.resolve import check_start
from sim.arena.families import CLASSIC, FAMILIES, draw
from sim.arena.families.drawing import GREATEST_TURN_RAD
from sim.arena.families.field import FIELD
from sim.arena.planner import target_stays_clear

INDICES = range(20)
DRAWN: dict[str, list[Mission]] = {}


def drawn(family: str) -> list[Mission]:
    if family not in DRAWN:
        DRAWN[family] = [draw(family, 1, index) for index in INDICES]
    return DRAWN[family]


def start_gap_m(mission: Mission) -> float:
    starts_m = np.array([agent.position_ned_m for agent in mission.agents])
    first, second = np.triu_indices(len(starts_m), k=1)
    return float(np.linalg.norm(starts_m[first] - starts_m[second], axis=-1).min())


every_family = pytest.mark.parametrize("family", FAMILIES)
classic_family = pytest.mark.parametrize("family", CLASSIC)
fleet_family = pytest.mark.parametrize("family", [name for name in FAMILIES if not FAMILIES[name].single])


@pytest.mark.slow
@every_family
def test_every_mission_is_resolved_and_starts_legally_outside_every_detection_disc(family: str) -> None:
    for mission in drawn(family):
        assert mission.resolved
        check_start(mission, mission.name)
        places = [one.position_ned_m for one in mission.agents] + [one.position_ned_m for one in mission.targets]
        for place in places:
            for threat in mission.threats:
                assert math.dist(place, threat.position_ned_m) > threat.detection_radius_m


@pytest.mark.slow
@every_family
def test_a_mission_written_to_yaml_and_read_again_is_the_same_mission(family: str) -> None:
    for mission in drawn(family)[:5]:
        assert parse_mission(dump_mission(mission), mission.name) == mission


@pytest.mark.slow
@every_family
def test_the_same_seed_and_index_draw_the_same_mission_and_others_another(family: str) -> None:
    assert draw(family, 1, 3) == drawn(family)[3]
    names_apart = [mission.model_copy(update={"name": "x"}) for mission in (draw(family, 2, 3), *drawn(family))]
    assert all(names_apart[0] != other for other in names_apart[1:])
    assert all(one != other for one, other in zip(names_apart, names_apart[1:], strict=False))


@pytest.mark.slow
@classic_family
def test_every_target_lies_outside_the_discs_grown_to_the_end_of_the_run(family: str) -> None:
    for mission in drawn(family):
        for target in mission.targets:
            assert target_stays_clear(mission, target.position_ned_m, mission.max_time_s)


@every_family
def test_a_family_is_static_exactly_if_none_of_its_threats_may_move(family: str) -> None:
    bounds_m_s = [threat.speed_bound_m_s for mission in drawn(family) for threat in mission.threats]
    assert FAMILIES[family].static == (max(bounds_m_s) == 0.0)


@every_family
def test_a_family_is_single_exactly_if_all_its_missions_have_one_agent(family: str) -> None:
    assert FAMILIES[family].single == all(len(mission.agents) == 1 for mission in drawn(family))


@pytest.mark.parametrize("family", [name for name in CLASSIC if name != "paper"])
def test_no_agent_turns_further_in_a_guidance_step_than_a_law_can_follow(family: str) -> None:
    for mission in drawn(family):
        for agent in mission.agents:
            turn_rad = turn_rate_rad_s(agent.speed_m_s, agent.n_max) * mission.guidance_step_s
            assert turn_rad <= GREATEST_TURN_RAD + 1e-3


@fleet_family
def test_agents_start_outside_the_interaction_radius_of_each_other(family: str) -> None:
    for mission in drawn(family):
        agent = mission.agents[0]
        rules = Rules(separation_m=mission.separation_m, n_max=agent.n_max, speed_m_s=agent.speed_m_s)
        assert start_gap_m(mission) >= interaction_radius_m(rules, mission.guidance_step_s)


@fleet_family
def test_agents_start_as_far_apart_as_the_caller_asks(family: str) -> None:
    for index in range(4):
        assert start_gap_m(draw(family, 1, index, 700.0)) >= 700.0


def test_a_full_arena_has_500_missions_of_the_classic_families_and_150_of_the_field() -> None:
    assert sum(family.count for family in CLASSIC.values()) == 500
    assert sum(family.count for family in FIELD.values()) == 150


def test_the_name_of_a_moving_mission_says_the_threats_share_of_the_speed_and_their_motion() -> None:
    kinds = set()
    for mission in drawn("moving"):
        kind, share = mission.name.split("-")[3:]
        kinds.add(kind)
        for threat in mission.threats:
            assert f"{threat.speed_bound_m_s / mission.agents[0].speed_m_s:.2f}v" == share
    assert kinds == {"straight", "circling", "random", "chasing"}


def test_circling_threats_circle_to_the_end_of_the_run() -> None:
    ends_s = [
        (threat.motion.path[-1][0], mission.max_time_s)
        for mission in drawn("moving")
        for threat in mission.threats
        if isinstance(threat.motion, PathMotion)
    ]
    assert ends_s
    assert all(end_s >= until_s for end_s, until_s in ends_s)


def test_dense_scenes_have_10_to_60_discs_some_of_which_overlap() -> None:
    counts = [len(mission.threats) for mission in drawn("dense")]
    assert 10 <= min(counts) < 25 < 45 < max(counts) <= 60
    overlapping = sum(
        math.dist(one.position_ned_m, other.position_ned_m) < one.detection_radius_m + other.detection_radius_m
        for mission in drawn("dense")
        for one in mission.threats
        for other in mission.threats[: one.id - 1]
    )
    assert overlapping > 100


def test_tight_scenes_turn_within_a_twentieth_to_one_detection_radius() -> None:
    shares = []
    for mission in drawn("tight"):
        agent = mission.agents[0]
        radius_m = agent.speed_m_s / turn_rate_rad_s(agent.speed_m_s, agent.n_max)
        shares.append(radius_m / mission.threats[0].detection_radius_m)
    assert 0.049 < min(shares) < 0.2 < 0.6 < max(shares) < 1.02


def test_the_wind_with_gusts_is_at_most_a_third_of_the_speed() -> None:
    winds_m_s = [mission.wind.speed_m_s + mission.wind.gust_m_s for mission in drawn("wind")]
    assert min(winds_m_s) > 0.0
    assert max(winds_m_s) <= drawn("wind")[0].agents[0].speed_m_s / 3 + 0.11


def test_stale_pictures_are_broadcast_every_5_to_30_s_over_a_link_that_loses_in_bursts() -> None:
    periods_s = [mission.broadcast_period_s for mission in drawn("stale")]
    assert 5.0 <= min(periods_s) < max(periods_s) <= 30.0
    assert all(mission.link.burst is not None for mission in drawn("stale"))


def test_a_swarm_has_a_target_of_its_own_for_each_of_10_to_50_agents() -> None:
    counts = [len(mission.agents) for mission in drawn("swarm")]
    assert 10 <= min(counts) < max(counts) <= 50
    for mission in drawn("swarm"):
        assert [agent.only_target for agent in mission.agents] == [target.id for target in mission.targets]


def test_more_agents_are_left_after_the_losses_than_there_are_targets_or_as_many() -> None:
    for mission in drawn("losses"):
        assert 2 <= len(mission.losses) <= len(mission.agents) - len(mission.targets)


def test_an_unknown_family_is_refused() -> None:
    with pytest.raises(KeyError):
        draw("no such family", 1, 0)
