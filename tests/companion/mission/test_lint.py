"""Legal missions that will probably disappoint are said to, and the packaged ones are not among them."""

from __future__ import annotations

import pytest

from companion.mission.lint import lint
from companion.mission.model import load_mission, packaged_missions, parse_mission
from companion.mission.resolve import resolve

THREAT = "[{id: 1, north_m: 25000, east_m: 0, detection_radius_m: 5000, attack_radius_m: 2000}]"
FINE = {
    "agents": "[{id: 1, north_m: 0, east_m: 0}]",
    "targets": "[{id: 1, north_m: 50000, east_m: 0}]",
    "threats": THREAT,
}


def doubts_of(**changes: str) -> list[str]:
    text = "\n".join(f"{key}: {value}" for key, value in {**FINE, **changes}.items())
    return lint(resolve(parse_mission(text, "test"), 1))


def test_a_sound_mission_raises_no_doubt() -> None:
    assert doubts_of() == []


@pytest.mark.parametrize("name", packaged_missions())
def test_the_packaged_missions_raise_no_doubt(name: str) -> None:
    assert lint(resolve(load_mission(name), 1)) == []


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"agents": "[{id: 7, north_m: 22000, east_m: 0}]"}, ("agents: id 7", "inside detection_radius_m")),
        ({"agents": "[{id: 7, north_m: 0, east_m: 0, range_m: 99000}]"}, ("agents: id 7", "range_m 99000", "return")),
        ({"case": "II", "losses": "[{agent: 1, t_s: 9}]"}, ("losses: ", "no loss can be known")),
        (
            {"targets": "[{id: 4, north_m: 50000, east_m: 0, motion: random, speed_bound_m_s: 60}]"},
            ("targets: id 4", "speed_bound_m_s 60", "outrun"),
        ),
        (
            {"threats": THREAT.replace("}", ", ceiling_m: 520}")},
            ("threats: id 1", "floor_m and ceiling_m", "nobody keeps clear"),
        ),
        ({"threats": THREAT.replace("}", ", floor_m: 531}")}, ("threats: id 1", "no agent's height")),
        ({"report_period_s": "60"}, ("report_period_s: 60", "no effect in Case I")),
        ({"case": "II", "detector_range_m": "100"}, ("detector_range_m: 100", "separation_m 100")),
        (
            {"agents": "[{id: 7, north_m: 0, east_m: 0, range_m: 49000}]", "range_policy": "arrive"},
            ("range_m 49000", "arrive"),
        ),
        ({"link": "{loss: 1.0}"}, ("link.loss", "hear")),
        (
            {"threats": THREAT.replace("}", ", speed_bound_m_s: 3}")},
            ("threats: id 1", "stands still", "speed_bound_m_s 3"),
        ),
        (
            {"targets": "[{id: 4, north_m: 50000, east_m: 0, speed_bound_m_s: 3}]"},
            ("targets: id 4", "stands still", "speed_bound_m_s 3"),
        ),
    ],
)
def test_each_doubt_names_what_it_is_about(changes: dict[str, str], parts: tuple[str, ...]) -> None:
    (warning,) = doubts_of(**changes)
    assert all(part in warning for part in parts), warning


def test_a_range_that_is_enough_one_way_is_enough_to_arrive() -> None:
    agents = "[{id: 7, north_m: 0, east_m: 0, range_m: 51000}]"
    assert doubts_of(agents=agents, range_policy="arrive") == []


BELOW = THREAT.replace("}", ", ceiling_m: 520}")
ABOVE_IT = "[{id: 7, north_m: 22000, east_m: 0}, {id: 8, north_m: 0, east_m: 0, height_m: 10}]"


def test_a_threat_below_the_agent_is_no_threat_at_its_start() -> None:
    assert doubts_of(threats=BELOW, agents=ABOVE_IT) == []


def test_the_layer_of_an_agent_counts_to_its_height() -> None:
    agents = "[{id: 7, north_m: 0, east_m: 0}, {id: 8, north_m: 0, east_m: 900}]"
    layered = {"layers": "2", "layer_spacing_m": "50", "agents": agents}
    assert doubts_of(threats=THREAT.replace("}", ", floor_m: 575}"), **layered) == []


def test_many_of_a_kind_are_one_line() -> None:
    agents = "[{id: 1, north_m: 21000, east_m: 0}, {id: 2, north_m: 22000, east_m: 900}]"
    (warning,) = doubts_of(agents=agents)
    assert warning.endswith("(and 1 more like it)")


# What stands still and may move


@pytest.mark.parametrize("motion", ["random", "{heading_deg: 3, speed_m_s: 4}", "chase"])
def test_a_speed_bound_of_a_moving_threat_raises_no_doubt(motion: str) -> None:
    assert doubts_of(threats=THREAT.replace("}", f", speed_bound_m_s: 4, motion: {motion}}}")) == []


# Paths of targets


OUTSIDE = "[{id: 4, north_m: 9000, east_m: 0, motion: {path: [[0, 9000, 0], [500, 9000, 1900]]}}]"


def test_a_target_that_leaves_the_fence_is_a_doubt() -> None:
    fence = "[[-900, -1500], [19000, -1500], [19000, 1500], [-900, 1500]]"
    (warning,) = doubts_of(fence=fence, targets=OUTSIDE)
    assert all(part in warning for part in ("targets: id 4", "9000 m north, 1900 m east at 500 s", "outside the fence"))
    assert doubts_of(fence=fence.replace("1500", "2500"), targets=OUTSIDE) == []


def test_a_target_that_goes_into_an_exclusion_is_a_doubt() -> None:
    (warning,) = doubts_of(exclusions="[[[8900, 1800], [9100, 1800], [9000, 2000]]]", targets=OUTSIDE)
    assert "inside an exclusion" in warning


# Case II in wind


CALM = {"case": "II", "arrival_radius_m": "300", "targets": "[{id: 1, north_m: 6000, east_m: 0}]", "threats": "[]"}


@pytest.mark.parametrize(
    ("wind_m_s", "report_s", "off"),
    [(4.0, 0.0, "400 m off"), (2.9, 0.0, None), (4.0, 76.0, "304 m off"), (4.0, 74.0, None)],
)
def test_a_reckoning_that_wind_puts_farther_off_than_the_arrival_radius_is_a_doubt(
    wind_m_s: float, report_s: float, off: str | None
) -> None:
    wind = f"{{speed_m_s: {0.75 * wind_m_s}, gust_m_s: {0.25 * wind_m_s}}}"
    warnings = doubts_of(**CALM, wind=wind, report_period_s=str(report_s))
    assert len(warnings) == (off is not None)
    assert all(part in warnings[0] for part in ("wind: ", off, "arrival_radius_m 300")) if off else True
    assert doubts_of(**{**CALM, "case": "I"}, wind=wind) == []
