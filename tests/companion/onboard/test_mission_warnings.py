"""Warnings before a flight that depend on how vehicles fly; sim/test_warnings_deserved.py flies what they are about."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest
import yaml

from companion.errors import InputError
from companion.geo.kinematics import advance
from companion.guidance.settings import LAWS, LawName
from companion.mission.model import Mission, load_mission, packaged_missions, parse_mission
from companion.mission.resolve import resolve
from companion.onboard.lint.warnings import lint_flight

RADIUS_M = 60.0**2 / 9.80665
"""Turn radius at 60 m/s and n_max 1."""
THREAT = {"id": 3, "north_m": 5000.0, "east_m": 0.0, "detection_radius_m": 800.0, "attack_radius_m": 400.0}
FINE: dict[str, Any] = {
    "agents": [{"id": 1, "north_m": 0.0, "east_m": 0.0, "heading_deg": 0.0, "n_max": 1.0}],
    "targets": [{"id": 1, "north_m": 12000.0, "east_m": 0.0}],
    "threats": [THREAT],
}


def agent(identity: int, north_m: float, east_m: float, **more: float) -> dict[str, float]:
    return {"id": identity, "north_m": north_m, "east_m": east_m, "heading_deg": 0.0, "n_max": 1.0, **more}


def target(north_m: float, east_m: float) -> list[dict[str, float]]:
    return [{"id": 1, "north_m": north_m, "east_m": east_m}]


def disc(identity: int, north_m: float, east_m: float, radius_m: float, **more: object) -> dict[str, Any]:
    return {
        "id": identity, "north_m": north_m, "east_m": east_m, "detection_radius_m": radius_m,
        "attack_radius_m": 0.5 * radius_m, **more,
    }  # fmt: skip


def mission_of(**changes: object) -> Mission:
    return resolve(parse_mission(yaml.safe_dump({**FINE, **changes}), "test"), 1)


def warnings_of(*kinds: str, law: LawName = "routed", **changes: object) -> list[str]:
    return lint_flight(mission_of(**changes), law, kinds or ("kinematic",), "test")


def the_warning(*kinds: str, law: LawName = "routed", **changes: object) -> str:
    (warning,) = warnings_of(*kinds, law=law, **changes)
    return warning


def test_a_sound_mission_raises_no_doubt() -> None:
    for law in LAWS:
        assert warnings_of(law=law) == []


@pytest.mark.parametrize("name", packaged_missions())
def test_of_the_packaged_missions_only_the_one_with_drifting_threats_in_a_fence_raises_a_doubt(name: str) -> None:
    warnings = lint_flight(resolve(load_mission(name), 1), "routed", ("kinematic",), name)
    assert ["not for ever" in warning for warning in warnings] == [True] * (name == "underwater")


# What only the guard refuses


@pytest.mark.parametrize("kind", ["kinematic", "arduplane"])
def test_a_vehicle_that_is_too_slow_to_turn_is_refused_by_file_and_key(kind: str) -> None:
    slow = [agent(1, 0.0, 0.0), agent(2, 900.0, 9000.0, speed_m_s=0.4)]
    with pytest.raises(
        InputError, match=r"^test: agents\[1\].speed_m_s: 0.4 m/s; allowed: at least 0.5 .*cannot stop$"
    ):
        warnings_of(kind, agents=slow)


def test_a_vehicle_that_can_stop_may_be_slow() -> None:
    slow = [agent(1, 0.0, 0.0, speed_m_s=0.4)]
    assert warnings_of("arducopter", agents=slow, targets=target(100.0, 0.0), threats=[]) == []


# Starts


@pytest.mark.parametrize(("north_m", "said"), [(4199.0, "1 m from threat 3"), (4100.0, "100 m from threat 3")])
def test_a_start_without_a_certified_back_up_is_named_with_its_clearance(north_m: float, said: str) -> None:
    warning = the_warning(agents=[agent(5, north_m, 0.0)], targets=target(20000.0, 0.0))
    assert warning.startswith(f"agents: id 5 has no certified back-up at its start, {said}")
    assert f"radius of {RADIUS_M:.0f} m" in warning


def test_a_start_that_turns_away_in_time_raises_no_doubt() -> None:
    assert warnings_of(agents=[agent(5, 4199.0 - RADIUS_M, 0.0)], targets=target(20000.0, 0.0)) == []


def test_a_disc_counts_as_large_as_the_broadcast_tells_it() -> None:
    # 900 km from the origin a place is told to 30 m: the vehicle believes itself inside a disc that ends 5 m off.
    far = [disc(3, 900000.0, 11.0, 200.0)]
    away = [agent(5, 900000.0 - 205.0, 0.0, heading_deg=180.0, n_max=10.0)]
    keys: dict[str, Any] = {"agents": away, "targets": target(890000.0, 0.0)}
    assert "5 m from threat 3" in the_warning(threats=far, **keys)
    near = [disc(3, 5000.0, 0.0, 200.0)]
    keys = {"agents": [agent(5, 5000.0 - 205.0, 0.0, heading_deg=180.0, n_max=10.0)], "targets": target(-5000.0, 0.0)}
    assert warnings_of(threats=near, **keys) == []


def test_a_copter_is_certified_where_it_can_stop() -> None:
    near = [agent(5, 4180.0, 0.0, speed_m_s=8.0)]
    assert warnings_of("arducopter", agents=near, targets=target(20000.0, 0.0)) == []
    assert warnings_of("kinematic", "arducopter", agents=near, targets=target(20000.0, 0.0)) == []


def test_a_certificate_for_a_time_is_told_with_the_time_and_the_threat() -> None:
    faster = [disc(4, -60000.0, 0.0, 800.0, motion="chase", speed_bound_m_s=70.0), disc(5, 60000.0, 9.0, 800.0)]
    warning = the_warning(threats=faster, agents=[agent(1, 0.0, 0.0, n_max=10.0)])
    assert "id 1 is certified at its start for" in warning
    assert "s only, not for ever, as threat 4 may move at 70 m/s, against its own 60 m/s" in warning


def test_pursuers_about_a_start_are_told_as_the_reason_that_nothing_is_certified() -> None:
    around = [
        disc(number + 1, 1500.0 * math.cos(0.7 + number), 1500.0 * math.sin(0.7 + number), 800.0, motion="chase",
             speed_bound_m_s=50.0) for number in range(6)
    ]  # fmt: skip
    warning = the_warning(threats=around, agents=[agent(1, 0.0, 0.0, n_max=10.0)])
    assert "id 1 has no certified back-up at its start, as threat 1 may move at 50 m/s, against its own" in warning


FENCE = [[-3000.0, -3000.0], [13000.0, -3000.0], [13000.0, 3000.0], [-3000.0, 3000.0]]


@pytest.mark.parametrize(("east_m", "sound"), [(2999.0, False), (2990.0, True)])
def test_a_start_nearer_to_the_fence_than_its_turn_needs_is_a_doubt(east_m: float, sound: bool) -> None:
    warnings = warnings_of(fence=FENCE, agents=[agent(1, 0.0, east_m)], threats=[])
    assert [f"{3000.0 - east_m:.0f} m from the fence" in warning for warning in warnings] == [True] * (not sound)


# Several vehicles


def pair(apart_m: float, first_deg: float = 0.0, second_deg: float = 180.0, **second: float) -> list[dict[str, float]]:
    return [
        agent(1, 0.0, 0.0, heading_deg=first_deg, only_target=1),
        agent(2, apart_m, 0.0, heading_deg=second_deg, only_target=2, **second),
    ]


TWO = [{"id": 1, "north_m": 9000.0, "east_m": 4000.0}, {"id": 2, "north_m": -9000.0, "east_m": -4000.0}]


@pytest.mark.parametrize(("first_deg", "second_deg"), [(0.0, 180.0), (250.0, 40.0), (10.0, 120.0)])
def test_starts_nearer_than_the_right_of_way_needs_are_named_with_the_least_spacing(
    first_deg: float, second_deg: float
) -> None:
    warning = the_warning(agents=pair(101.0, first_deg, second_deg), targets=TWO, threats=[])
    assert warning.startswith("agents: id 2 starts 101 m from agent 1: if both circle to the right")
    needed_m = float(re.search(r"headings (\d+) m", warning)[1])  # type: ignore[index]
    assert warnings_of(agents=pair(needed_m + 1.0, first_deg, second_deg), targets=TWO, threats=[]) == []
    assert warnings_of(agents=pair(needed_m - 1.0, first_deg, second_deg), targets=TWO, threats=[])


def test_the_least_distance_that_is_named_is_that_of_two_that_circle_to_the_right() -> None:
    agents = pair(101.0, 20.0, 150.0)
    places = []
    for each in agents:
        pose = (each["north_m"], each["east_m"], math.radians(each["heading_deg"]))
        places.append([advance(*pose, 60.0, 60.0 / RADIUS_M, 0.02 * step)[:2] for step in range(2000)])
    least_m = min(math.dist(one, other) for one, other in zip(*places, strict=True))
    assert f"they come within {least_m:.0f} m" in the_warning(agents=agents, targets=TWO, threats=[])


def test_a_row_and_a_column_of_vehicles_on_one_heading_raise_no_doubt() -> None:
    for heading_deg in (0.0, 90.0, 200.0):
        assert warnings_of(agents=pair(101.0, heading_deg, heading_deg), targets=TWO, threats=[]) == []


def test_layers_other_laws_and_vehicles_that_can_stop_need_no_spacing() -> None:
    slow = [{**each, "speed_m_s": 8.0} for each in pair(101.0)]
    assert warnings_of("arducopter", agents=slow, targets=TWO, threats=[]) == []
    assert warnings_of(agents=pair(101.0), targets=TWO, threats=[], layers=2, layer_spacing_m=50.0) == []
    assert warnings_of(agents=pair(101.0), targets=TWO, threats=[], law="seed") == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"detector": "none"}, "detector: 'none': agents know nothing of one another"),
        ({"detector": "broadcast", "case": "II"}, "detector: 'broadcast' in Case II: agents know nothing"),
        ({"detector": "broadcast", "broadcast_period_s": 20.0}, "detector: 'broadcast': with broadcast_period_s 20"),
    ],
)
def test_agents_that_know_too_little_of_one_another_are_named(changes: dict[str, Any], words: str) -> None:
    assert the_warning(agents=pair(8000.0), targets=TWO, threats=[], **changes).startswith(words)


@pytest.mark.parametrize("period_s", [0.5, 1.0, 2.0])
def test_agents_that_hear_of_one_another_often_enough_are_not_warned_of(period_s: float) -> None:
    told: dict[str, Any] = {"detector": "broadcast", "broadcast_period_s": period_s}
    assert warnings_of(agents=pair(8000.0), targets=TWO, threats=[], **told) == []


def test_copters_whose_words_grow_beyond_half_of_their_separation_are_warned_of() -> None:
    copters = [{**each, "speed_m_s": 8.0} for each in pair(8000.0)]
    told: dict[str, Any] = {"agents": copters, "targets": TWO, "threats": [], "detector": "broadcast"}
    warning = the_warning("arducopter", **told, separation_m=20.0, broadcast_period_s=3.0)
    assert warning.startswith("detector: 'broadcast': with broadcast_period_s 3")
    assert warnings_of("arducopter", **told, separation_m=40.0, broadcast_period_s=1.0) == []


def test_a_detector_that_sees_too_late_is_named_with_the_range_it_needs() -> None:
    far = pair(8000.0)
    warning = the_warning(agents=far, targets=TWO, threats=[], detector_range_m=1600.0)
    needed_m = 4.0 * RADIUS_M + 100.0 + 60.0
    assert f"detector_range_m: 1600 m: the right of way needs {needed_m:.0f} m" in warning
    assert warnings_of(agents=far, targets=TWO, threats=[], detector_range_m=needed_m + 1.0) == []
    alone: dict[str, Any] = {"agents": far[:1], "targets": TWO[:1]}
    assert warnings_of(**alone, detector_range_m=1.0) == []


def test_vehicles_of_different_turn_limits_are_named() -> None:
    warning = the_warning(agents=pair(8000.0, n_max=2.0), targets=TWO, threats=[])
    assert "agents: id 1 has n_max 1 and id 2 2" in warning
    assert warnings_of("arducopter", agents=pair(8000.0, n_max=2.0, speed_m_s=8.0), targets=TWO, threats=[]) == []


# Targets


def test_a_target_inside_a_disc_by_more_than_the_arrival_radius_is_a_doubt() -> None:
    inside = target(5000.0 - 490.0, 0.0)
    warning = the_warning(targets=inside, arrival_radius_m=300.0)
    assert "targets: id 1 is 310 m inside threat 3" in warning
    assert "310 m from it, arrival_radius_m is 300" in warning
    assert warnings_of(targets=inside, arrival_radius_m=320.0) == []


@pytest.mark.parametrize("clear_m", [1.0, 50.0, 400.0])
def test_a_target_beside_a_disc_is_a_doubt_only_for_the_laws_that_keep_off(clear_m: float) -> None:
    beside = target(5800.0 + clear_m, 0.0)
    assert warnings_of(targets=beside) == []
    said = [("targets: id 1" in one, "farther off" in one) for one in warnings_of(law="seed", targets=beside)]
    assert said == [(True, True)] * (clear_m < 380.0)


def ring(count: int, radius_m: float, disc_m: float) -> list[dict[str, Any]]:
    turns = [math.tau * number / count for number in range(count)]
    return [
        disc(number + 1, 12000.0 + radius_m * math.cos(turn), radius_m * math.sin(turn), disc_m)
        for number, turn in enumerate(turns)
    ]


def test_a_target_behind_a_closed_ring_of_discs_is_a_doubt() -> None:
    closed = ring(12, 3000.0, 800.0)
    assert "walled off by threats, fence or exclusions" in the_warning(threats=closed)
    assert warnings_of(threats=closed[1:]) == []


def test_a_target_in_a_yard_too_small_to_turn_in_is_a_doubt() -> None:
    yard = ring(9, 700.0, 400.0)[1:]
    warning = the_warning(threats=yard, arrival_radius_m=50.0)
    assert "has no room about it: agent 1 turns with a radius of 367 m" in warning
    assert warnings_of("arducopter", threats=yard, arrival_radius_m=50.0) == []


def test_a_target_in_a_corner_of_the_fence_that_no_turn_comes_near_is_a_doubt() -> None:
    corner: dict[str, Any] = {"fence": FENCE, "threats": [], "targets": target(12990.0, 2990.0)}
    # A circle that touches both edges passes 0.41 radii from the corner.
    assert "has no room about it" in the_warning(**corner, arrival_radius_m=100.0)
    assert warnings_of(**corner, arrival_radius_m=200.0) == []


def test_only_a_law_without_a_route_circles_a_target_inside_its_turn() -> None:
    beside: dict[str, Any] = {"targets": target(0.0, 200.0), "arrival_radius_m": 50.0, "threats": []}
    assert warnings_of(**beside) == []
    warning = the_warning(law="seed", **beside)
    assert "m from target 1, inside its own turning circle of 367 m radius" in warning
    assert warnings_of(law="seed", **{**beside, "targets": target(1000.0, 200.0)}) == []


# Many


def test_a_mission_of_a_hundred_agents_and_four_hundred_threats_raises_no_doubt() -> None:
    discs = [disc(number + 1, 2000.0 * (number // 20) + 3000.0, 2000.0 * (number % 20), 600.0) for number in range(400)]
    agents = [agent(number + 1, 0.0, 900.0 * number, n_max=3.0) for number in range(100)]
    targets = [{"id": number + 1, "north_m": 45000.0, "east_m": 900.0 * number} for number in range(100)]
    assert warnings_of(threats=discs, agents=agents, targets=targets) == []


# Speed and wind through the air


@pytest.mark.parametrize(
    ("kind", "speed_m_s", "warns"),
    [("arducopter", 8.0, True), ("arducopter", 5.2, False), ("px4-copter", 8.0, False), ("arduplane", 22.0, False)],
)
def test_a_wind_that_a_copter_cannot_fly_against_is_warned_of(kind: str, speed_m_s: float, warns: bool) -> None:
    slow = [{**agent(1, 0.0, 0.0), "speed_m_s": speed_m_s, "n_max": 0.1}]
    wind = {"from_deg": 270.0, "speed_m_s": 4.0, "gust_m_s": 1.0}
    found = [words for words in warnings_of(kind, agents=slow, wind=wind) if words.startswith("wind: ")]
    assert len(found) == warns
    if warns:
        assert found == [
            "wind: 5 m/s, gusts included, against the 8 m/s of agent 1: arducopter reaches 10.3 (ANGLE_MAX 3000) "
            "through the air, so that its companion does not begin to steer"
        ]


@pytest.mark.parametrize(
    ("kind", "parameters", "warns"),
    [
        ("arducopter", (("ANGLE_MAX", 4500.0),), False),
        ("arducopter", (("ANGLE_MAX", 2500.0),), True),
        ("px4-copter", (("SIH_KDV", 2.0),), True),
    ],
)
def test_a_wind_is_set_against_what_the_given_parameters_reach(
    kind: str, parameters: tuple[tuple[str, float], ...], warns: bool
) -> None:
    slow = [{**agent(1, 0.0, 0.0), "speed_m_s": 8.0, "n_max": 0.1}]
    wind = {"from_deg": 270.0, "speed_m_s": 4.0, "gust_m_s": 1.0}
    mission = mission_of(agents=slow, wind=wind)
    found = lint_flight(mission, "routed", (kind,), "mission.yaml", parameters)
    assert any(words.startswith("wind: ") for words in found) is warns
