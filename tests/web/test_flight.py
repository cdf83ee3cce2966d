"""The page on a simulated flight, from end to end: `sim fly --ui` as it is started by hand, Chromium, and an operator.

One flight and one browser for the whole module: each test does one thing and leaves the mission as it found it. With
the variable PAGE_SHOTS each photographs the page into that folder, wide, at 360 pixels and in high contrast, to be
looked at:

    PAGE_SHOTS=/tmp/shots pytest -n 0 tests/web/test_flight.py
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from tests.web.rig import NARROW, WIDE, Tab

pytestmark = pytest.mark.slow
SHOTS = os.environ.get("PAGE_SHOTS")
"""Folder for photographs; none are taken if it is not set."""
LOOKS = (("wide", WIDE, "light"), ("narrow", NARROW, "light"), ("contrast", WIDE, "contrast"))
MISSION = """
name: valley
origin: {lat_deg: 47.0, lon_deg: 8.0, alt_m: 500}
agents:
  - {id: 1, north_m: 0, east_m: 0, heading_deg: 0}
  - {id: 2, north_m: 0, east_m: 3000, heading_deg: 0}
  - {id: 3, north_m: -3000, east_m: 6000, heading_deg: 0}
targets:
  - {id: 1, north_m: 60000, east_m: 0}
  - {id: 2, north_m: 60000, east_m: 4000}
threats:
  - {id: 1, north_m: 30000, east_m: -9000, detection_radius_m: 2000, attack_radius_m: 1000}
defaults:
  agent: {speed_m_s: 30, n_max: 2, range_m: 400000}
  target: {speed_bound_m_s: 0}
  threat: {speed_bound_m_s: 0}
guidance_step_s: 1
integration_step_s: 1
broadcast_period_s: 1
assignment_period_s: 5
arrival_radius_m: 200
max_time_s: 20000
"""


class Flight(NamedTuple):
    """A flight under way, and its page."""

    tab: Tab
    url: str

    @property
    def page(self) -> Page:
        return self.tab.page

    def agent(self, identity: int) -> Locator:
        """Return an agent's row of the table."""
        return self.page.locator(f"#agents-table tbody tr:has(.pick:text-is('{identity}'))")

    def choose(self, identity: int) -> None:
        """Choose an agent."""
        self.page.click("#tab-agents")
        self.agent(identity).locator(".pick").click()
        expect(self.page.locator("#details-title")).to_have_text(f"Agent {identity}")

    def confirm(self, said: str) -> None:
        """Press the dialog's button, and wait until the page says what was done."""
        self.page.click("dialog [type=submit]")
        expect(self.page.locator("#toast")).to_contain_text(said)

    def undo(self) -> None:
        """Take back what was done last."""
        self.page.click("#toast button")
        self.confirm("Undone")

    def photograph(self, name: str) -> None:
        """Photograph the page in each look, if that is asked for."""
        if SHOTS is None:
            return
        for look, size, theme in LOOKS:
            self.page.set_viewport_size(size)
            self.page.select_option("#theme", theme)
            self.page.wait_for_timeout(500)
            self.page.screenshot(path=Path(SHOTS) / f"{name}-{look}.png")
        self.page.set_viewport_size(WIDE)
        self.page.select_option("#theme", "light")

    def told(self, path: str) -> Any:  # noqa: ANN401
        """Return what the API tells."""
        return json.loads(self.page.request.get(f"{self.url}api/v1/{path}").text())


@pytest.fixture(scope="module")
def flight(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flight]:
    folder = tmp_path_factory.mktemp("flight")
    (folder / "valley.yaml").write_text(MISSION)
    options = ["--realtime", "--speed", "4", "--ui", "127.0.0.1:0"]
    process = subprocess.Popen(
        [sys.executable, "-m", "sim", "fly", str(folder / "valley.yaml"), *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stderr is not None
        line = process.stderr.readline()
        url = re.search(r"http://\S+", line)
        assert url is not None, line + process.stderr.read()
        tab = Tab(browser, url[0])
        expect(tab.page.locator("#mission")).to_have_text("valley")
        expect(tab.page.locator("#agents-table tbody tr")).to_have_count(3)
        yield Flight(tab, url[0])
        assert tab.hosts() == {"127.0.0.1"}
        assert tab.complaints == []
        tab.close()
    finally:
        # Not by a signal that it obeys: it would draw figures of the flight, which nobody looks at.
        process.kill()
        process.wait()


def _routes(flight: Flight) -> dict[str, list[list[float]]]:
    routes: dict[str, list[list[float]]] = flight.told("routes")
    return routes


def test_the_mission_flies_and_the_clock_goes_on(flight: Flight) -> None:
    expect(flight.page.locator("#mode")).to_have_text("simulator")
    expect(flight.page.locator("#unsigned")).to_be_visible()
    before = flight.told("picture")
    flight.page.locator(f"#clock:not(:text-is('{flight.page.locator('#clock').inner_text()}'))").wait_for()
    expect(flight.agent(1)).to_contain_text("under way")
    moved = flight.told("picture")
    assert moved["t_s"] > before["t_s"]
    assert moved["agents"][0]["north_m"] > before["agents"][0]["north_m"]


def test_a_threat_dropped_on_a_route_bends_it_and_changes_the_broadcast(flight: Flight) -> None:
    flight.page.click("#tab-threats")
    straight = _straightened(flight, 1)
    revision = flight.told("picture")["revision"]
    _, (north_m, east_m) = straight[0], _middle(straight)
    flight.page.click("#form-threat")
    for name, value in (
        ("north_m", north_m),
        ("east_m", east_m),
        ("attack_radius_m", 700),
        ("detection_radius_m", 1200),
    ):
        flight.page.fill(f"[name={name}]", f"{value:.1f}")
    flight.confirm("threat added")
    expect(flight.page.locator("#threats-table tbody tr")).to_have_count(2)
    flight.page.click("#tab-events")
    expect(flight.page.locator("#events")).to_contain_text(f"revision {revision + 1} is broadcast, 2 threats")
    bent = _wait_for_route(flight, 1, lambda route: len(route) > len(straight))
    assert min(((n - north_m) ** 2 + (e - east_m) ** 2) ** 0.5 for n, e in bent) >= 1_200.0
    assert flight.told("picture")["revision"] == revision + 1
    flight.photograph("threat")
    flight.undo()
    expect(flight.page.locator("#events")).to_contain_text("takes back")
    _wait_for_route(flight, 1, lambda route: len(route) == len(straight))


def _straightened(flight: Flight, identity: int) -> list[list[float]]:
    """Return an agent's route, once there is one."""
    return _wait_for_route(flight, identity, lambda route: len(route) >= 2)


def _middle(route: list[list[float]]) -> tuple[float, float]:
    (north_m, east_m), (goal_north_m, goal_east_m) = route[0], route[-1]
    return (north_m + goal_north_m) / 2, (east_m + goal_east_m) / 2


def _wait_for_route(flight: Flight, identity: int, wanted: Any) -> list[list[float]]:  # noqa: ANN401
    for _ in range(60):
        route = _routes(flight).get(str(identity), [])
        if wanted(route):
            return route
        flight.page.wait_for_timeout(250)
    raise AssertionError(f"the route of agent {identity} is {route}")


def test_an_agent_is_taken_out_and_its_target_goes_to_another(flight: Flight) -> None:
    sent = {agent["id"]: agent["target"] for agent in flight.told("picture")["agents"]}
    alone = next(one for one, target in sent.items() if list(sent.values()).count(target) == 1)
    flight.choose(alone)
    flight.page.click("[data-act=take-out]")
    flight.confirm("taken out")
    expect(flight.agent(alone)).to_contain_text("out")
    other = flight.page.locator(f"#agents-table tbody tr:has(.col-target:text-is('{sent[alone]}'))")
    expect(other).to_have_count(1)
    flight.page.click("#tab-events")
    flight.photograph("taken-out")
    expect(flight.page.locator("#events [data-event=assigned]").first).to_contain_text(f"to target {sent[alone]}")
    flight.undo()
    expect(flight.agent(alone)).to_contain_text("under way")


def test_one_agent_is_held_and_all_are_recalled_and_sent_on(flight: Flight) -> None:
    flight.choose(1)
    flight.page.click("[data-act=hold]")
    flight.confirm("Hold: agent 1")
    expect(flight.agent(1)).to_contain_text("hold")
    expect(flight.agent(2)).not_to_contain_text("hold")
    flight.photograph("hold")
    flight.page.click("[data-act=normal]")
    flight.confirm("Back to normal: agent 1")
    flight.page.click("#recall-all")
    flight.confirm("Recall: all agents")
    expect(flight.page.locator("#directive")).to_have_text("return")
    flight.photograph("recall")
    flight.page.click("#normal-all")
    flight.confirm("Back to normal: all agents")
    expect(flight.page.locator("#directive")).to_have_text("normal")


def test_why_tells_the_decision_of_an_agent(flight: Flight) -> None:
    flight.choose(2)
    flight.page.click("[data-act=why]")
    expect(flight.page.locator("#why li").first).to_contain_text("target")
    flight.photograph("why")
    flight.page.click("[data-act=why]")
    expect(flight.page.locator("#why")).to_be_hidden()


def test_a_reload_finds_the_same_picture_and_the_same_events(flight: Flight) -> None:
    flight.page.click("#tab-events")
    before = flight.page.locator("#events .what").all_inner_texts()
    agents = flight.page.locator("#agents-table .col-target").all_text_contents()
    flight.page.reload()
    expect(flight.page.locator("#agents-table tbody tr")).to_have_count(3)
    flight.page.click("#tab-events")
    expect(flight.page.locator("#events .what")).to_have_count(len(before))
    assert flight.page.locator("#events .what").all_inner_texts() == before
    assert flight.page.locator("#agents-table .col-target").all_text_contents() == agents
    flight.photograph("reload")


def test_the_flight_is_hurried_and_stopped_from_the_page(flight: Flight) -> None:
    flight.page.locator("#playback button").click()
    expect(flight.page.locator("#playback button")).to_have_text("Play")
    expect(flight.page.locator("#stale")).to_be_hidden()
    flight.page.locator("#playback button").click()
    expect(flight.page.locator("#playback button")).to_have_text("Pause")
