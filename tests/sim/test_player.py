"""The player of the report: its data are bounded and true, and Chromium plays them without a network."""

from __future__ import annotations

import json
import shutil
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.mission.model import Mission, parse_mission
from companion.onboard.decision import Decision, Purpose
from companion.onboard.failsafe import Stage
from sim.agent_log import AgentLog
from sim.flown import FlownMission
from sim.player import MOST_NUMBERS, player_data, script_json
from sim.report import Pictures, write_report
from sim.score import score
from sim.trajectory import TrajectoryBuilder

CHROMIUM = shutil.which("chromium")
MISSION = """
name: played
agents: [{id: 1, north_m: 0, east_m: 0}, {id: 2, north_m: 0, east_m: 4000}]
targets: [{id: 7, north_m: 12000, east_m: 0}]
threats: [{id: 4, north_m: 6000, east_m: 9000, detection_radius_m: 900, attack_radius_m: 300, speed_bound_m_s: 10}]
fence: [[-2000, -2000], [-2000, 12000], [15000, 12000], [15000, -2000]]
"""


def mission() -> Mission:
    return parse_mission(MISSION, "played")


def flown(steps: int = 401) -> FlownMission:
    builder = TrajectoryBuilder([1, 2], [7], [4])
    for step in range(steps):
        north_m = 30.0 * step
        builder.append(
            0.5 * step,
            [(north_m, 0.0, 0.0, 60.0), (0.9 * north_m, 4_000.0, 0.0, 54.0)],
            [(12_000.0, 0.0, 0.0, 0.0)],
            [(6_000.0, 9_000.0 - 2.0 * step, 270.0, 4.0)],
        )
    trajectory = builder.build()
    return FlownMission(mission(), trajectory, score(trajectory, mission()), 1, "routed")


def decision(t_s: float, picture_s: float | None, reason: str = "assigned") -> Decision:
    age_s = None if picture_s is None else t_s - picture_s
    return Decision(t_s, Purpose.TARGET, reason, Stage.FRESH, age_s, target_id=7)


def logs() -> dict[int, AgentLog]:
    first, second = AgentLog(), AgentLog()
    for step in range(0, 401):
        t_s = 0.5 * step
        first.note(decision(t_s, 5.0 * (t_s // 5.0)), t_s)
        second.note(decision(t_s, 0.0, f"late, {t_s:.1f} s"), t_s)
    return {1: first, 2: second}


def test_an_agents_log_keeps_each_picture_once_and_each_reason_once_whatever_its_numbers() -> None:
    first, second = (logs()[identity] for identity in (1, 2))
    assert first.pictures[:3] == [(0.0, 0.0), (5.0, 5.0), (10.0, 10.0)]
    assert second.pictures == [(0.0, 0.0)]
    assert [words for _, words in second.reasons] == ["fresh, target 7: late, 0.0 s; certified none"]


def test_the_samples_are_the_flight_to_the_decimetre_where_it_is_small() -> None:
    data = player_data(flown(), logs())
    assert data["unit_m"] == 0.1
    times_s = [ds / 10 for ds in accumulate(data["t_ds"])]
    assert (times_s[0], times_s[-1]) == (0.0, 200.0)
    assert list(accumulate(data["agents"][0]["n"])) == [round(600.0 * t_s) for t_s in times_s]
    assert (data["threats"][0]["bound"], data["threats"][0]["detection"]) == (10.0, 900.0)
    assert data["targets"][0]["reached"] == pytest.approx(195.0, abs=0.6)


def test_a_long_flight_of_many_is_thinned_out_until_it_fits() -> None:
    builder = TrajectoryBuilder(range(1, 501), [7], [4])
    rows = np.zeros((500, 4))
    for step in range(600):
        rows[:, 0] += 3.0
        builder.append(0.5 * step, rows, [(12_000.0, 0.0, 0.0, 0.0)], [(6_000.0, 9_000.0, 0.0, 0.0)])
    trajectory = builder.build()
    scored = score(flown(3).trajectory, mission())
    data = player_data(FlownMission(mission(), trajectory, scored, 1, "routed"), {})
    numbers = sum(len(one["n"]) + len(one["e"]) for kind in ("agents", "targets", "threats") for one in data[kind])
    assert numbers <= MOST_NUMBERS
    assert sum(data["agents"][0]["n"]) * data["unit_m"] == 1_800.0


@given(st.text())
def test_no_text_ends_the_script_that_it_stands_in(text: str) -> None:
    written = script_json({"text": text + "</script><!--"})
    assert not {"<", ">", "&"} & set(written)
    assert json.loads(written) == {"text": text + "</script><!--"}


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium")
def test_chromium_plays_the_report_from_a_file_on_a_small_screen(tmp_path: Path) -> None:
    playwright = pytest.importorskip("playwright.sync_api")
    pictures = Pictures(b"", b"", player_data(flown(), logs()))
    result: dict[str, Any] = {"seed": 1, "law": "routed"}
    write_report(tmp_path / "report.html", flown(), result, pictures, "sim fly played")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport={"width": 360, "height": 700})
        asked: list[str] = []
        faults: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto((tmp_path / "report.html").as_uri())
        page.select_option("#player-view", "2")
        page.focus("#player-map")
        page.keyboard.press("End")
        assert page.inner_text("#player-clock") == "200 s of 200 s"
        assert "newest picture is 200.0 s old" in page.inner_text("#player-words")
        page.keyboard.press("Home")
        page.keyboard.press(" ")
        playwright.expect(page.locator("#player-time")).not_to_have_value("0")
        page.click("#player-play")
        assert page.inner_text("#player-play") == "Play"
        assert page.evaluate("document.documentElement.scrollWidth") == 360
        colours = "(c => new Set(c.getContext('2d').getImageData(0, 0, c.width, c.height).data).size)"
        assert page.evaluate(f"{colours}(document.getElementById('player-map'))") > 20
        browser.close()
    assert faults == []
    assert asked == [(tmp_path / "report.html").as_uri()]
