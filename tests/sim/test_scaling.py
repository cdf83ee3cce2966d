"""Scaling for an autopilot kind: every length and speed by one factor, times as they were."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.autopilot.kinds import CRUISE_M_S
from companion.autopilot.missions import load_mission_to_fly
from companion.autopilot.registry import ADAPTERS
from companion.errors import InputError
from companion.mission.model import Mission, Wind, dump_mission, load_mission, parse_mission
from companion.mission.resolve import check_start, resolve
from companion.onboard.lint.fleet import abilities_of
from sim.scaling import check_speeds, scaled

KINDS = tuple(CRUISE_M_S)
PATHS = parse_mission(
    """
name: everything that moves
fence: [[0, 0], [60000, 0], [60000, 60000]]
exclusions: [[[600, 60], [900, 60], [900, 120]], [[60, 12], [90, 12], [90, 24]]]
agents: [{id: 1, north_m: 1200, east_m: 600, heading_deg: 30, height_m: 40}]
targets: [{id: 1, north_m: 30000, east_m: 6000, speed_bound_m_s: 6, motion: {heading_deg: 90, speed_m_s: 6}}]
threats:
  - {id: 1, north_m: 12000, east_m: 9000, detection_radius_m: 3000, attack_radius_m: 1500, speed_bound_m_s: 12,
     motion: {path: [[0, 12000, 9000], [100, 12000, 10200]]}, floor_m: 510, ceiling_m: 600}
wind: {from_deg: 10, speed_m_s: 12, gust_m_s: 3}
layers: 2
layer_spacing_m: 15
""",
    "test",
)


def paper(seed: int = 1) -> Mission:
    return resolve(load_mission("paper-dynamic"), seed)


@pytest.mark.parametrize("kind", KINDS)
def test_every_length_and_speed_of_the_papers_mission_is_multiplied_by_cruise_speed_over_60(kind: str) -> None:
    before, after = paper(), scaled(paper(), kind)
    factor = CRUISE_M_S[kind] / 60.0
    assert (after.arrival_radius_m, after.separation_m, after.detector_range_m) == pytest.approx(
        (300.0 * factor, 100.0 * factor, 2_000.0 * factor)
    )
    assert (after.area_m.north, after.area_m.east) == pytest.approx((200_000.0 * factor, 200_000.0 * factor))
    for old, new in zip(before.threats, after.threats, strict=True):
        assert new.position_ned_m == pytest.approx([factor * one for one in old.position_ned_m])
        assert (new.detection_radius_m, new.attack_radius_m) == pytest.approx((1e4 * factor, 5e3 * factor))
        assert new.speed_bound_m_s == pytest.approx(10.0 * factor)
        assert new.motion == "random"
    for old_agent, new_agent in zip(before.agents, after.agents, strict=True):
        assert new_agent.position_ned_m == pytest.approx([factor * one for one in old_agent.position_ned_m])
        assert (new_agent.speed_m_s, new_agent.range_m) == pytest.approx((CRUISE_M_S[kind], 5e5 * factor))
        assert new_agent.heading_deg == old_agent.heading_deg
    assert (after.weights.k_d, after.weights.k_c) == pytest.approx((1e11 * factor**2, 1e10 * factor**2))


@pytest.mark.parametrize("kind", KINDS)
def test_times_and_the_link_are_what_they_were(kind: str) -> None:
    keys = {
        "guidance_step_s", "integration_step_s", "broadcast_period_s", "assignment_period_s", "heading_hold_s",
        "lost_after_s", "report_period_s", "max_time_s", "link", "losses", "origin",
    }  # fmt: skip
    assert scaled(paper(), kind).model_dump(include=keys) == paper().model_dump(include=keys)


def test_paths_fence_and_wind_are_scaled_but_no_height() -> None:
    after = scaled(PATHS, "px4-plane")
    threat, target, agent = after.threats[0], after.targets[0], after.agents[0]
    assert threat.model_dump()["motion"]["path"] == ((0.0, 3000.0, 2250.0), (100.0, 3000.0, 2550.0))
    assert target.model_dump()["motion"] == {"heading_deg": 90.0, "speed_m_s": 1.5}
    assert (threat.floor_m, threat.ceiling_m, agent.height_m, after.layer_spacing_m) == (510.0, 600.0, 40.0, 15.0)
    assert after.fence == ((0.0, 0.0), (15_000.0, 0.0), (15_000.0, 15_000.0))
    assert after.exclusions == (
        ((150.0, 15.0), (225.0, 15.0), (225.0, 30.0)),
        ((15.0, 3.0), (22.5, 3.0), (22.5, 6.0)),
    )
    assert (after.wind.speed_m_s, after.wind.gust_m_s, after.wind.from_deg) == (3.0, 0.75, 10.0)


@pytest.mark.parametrize("kind", KINDS)
def test_nobody_is_to_turn_tighter_than_the_kind_can(kind: str) -> None:
    most = ADAPTERS[kind]().abilities.n_max
    assert all(agent.n_max <= most for agent in scaled(paper(), kind).agents)


def test_a_copter_is_no_faster_than_it_can_fly_against_the_wind() -> None:
    windy = paper().model_copy(update={"wind": Wind(from_deg=90.0, speed_m_s=15.0, gust_m_s=7.5)})
    after = scaled(windy, "arducopter")
    wind_m_s = after.wind.speed_m_s + after.wind.gust_m_s
    assert {round(agent.speed_m_s + wind_m_s, 6) for agent in after.agents} == {10.3}
    assert {round(agent.speed_m_s, 6) for agent in scaled(windy, "arduplane").agents} == {22.0}


def test_the_factor_is_written_down_and_read_back() -> None:
    after = scaled(paper(), "arduplane")
    assert after.scale is not None
    assert after.scale.autopilot == "arduplane"
    assert after.scale.factor == pytest.approx(22.0 / 60.0)
    assert parse_mission(dump_mission(after), "again") == after


def test_a_scaled_mission_is_not_scaled_again() -> None:
    once = scaled(paper(), "px4-copter")
    assert scaled(once, "px4-copter") == once


def test_a_mission_scaled_for_another_kind_is_refused() -> None:
    with pytest.raises(InputError, match=r"^paper-dynamic: scale.autopilot: 'px4-copter' with --autopilot arduplane; "):
        scaled(scaled(paper(), "px4-copter"), "arduplane")


def test_the_papers_own_vehicle_flies_the_mission_as_it_is() -> None:
    assert scaled(paper(), "kinematic") == paper()


@pytest.mark.parametrize("kind", KINDS)
def test_a_scaled_mission_has_speeds_that_its_kind_flies(kind: str) -> None:
    check_speeds(scaled(paper(), kind), kind, abilities_of(kind, ()), "scaled")


def test_what_a_kind_flies_follows_its_autopilots_parameters() -> None:
    mission = scaled(paper(), "px4-plane")
    with pytest.raises(
        InputError, match=r"^slow: agents\[0\].speed_m_s: 15 m/s with .*px4-plane, which flies 12 m/s; "
    ):
        check_speeds(mission, "px4-plane", abilities_of("px4-plane", (("FW_AIRSPD_TRIM", 12.0),)), "slow")


def test_a_mission_scaled_for_another_kind_is_not_flown_as_it_is_either() -> None:
    with pytest.raises(InputError, match=r"^other: scale.autopilot: 'px4-copter' with --autopilot arducopter; "):
        check_speeds(scaled(paper(), "px4-copter"), "arducopter", abilities_of("arducopter", ()), "other")


@pytest.mark.parametrize(
    ("scale", "said"),
    [
        ("{autopilot: arducoptor, factor: 0.2}", "scale: autopilot: 'arducoptor'; did you mean 'arducopter'?; allowed"),
        ("{autopilot: arducopter, factor: 0}", "scale.factor: 0"),
        ("{autopilot: arducopter}", "scale.factor"),
    ],
)
def test_a_scale_that_cannot_be_is_refused(tmp_path: Path, scale: str, said: str) -> None:
    path = tmp_path / "scaled.yaml"
    path.write_text(f"draw: {{agents: 1, targets: 1}}\nscale: {scale}", encoding="utf-8")
    with pytest.raises(InputError) as refused:
        load_mission_to_fly(path)
    assert str(refused.value).startswith(f"{path}: {said}")


@pytest.mark.slow
@given(seed=st.integers(0, 1000), kind=st.sampled_from(KINDS))
def test_a_legal_start_stays_legal_and_distances_keep_their_ratios(seed: int, kind: str) -> None:
    before, after = paper(seed), scaled(paper(seed), kind)
    check_start(after, "scaled")
    factor = CRUISE_M_S[kind] / 60.0
    for old, new in zip(before.targets, after.targets, strict=True):
        apart_m = math.dist(old.position_ned_m, before.threats[0].position_ned_m)
        assert math.dist(new.position_ned_m, after.threats[0].position_ned_m) == pytest.approx(factor * apart_m)
