"""A threat is added on the page while copters fly: who hears it bends its way at once, who hears nothing loiters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
import pytest

import sim.ui
from companion.mission.model import parse_mission
from companion.mission.resolve import resolve
from groundstation.web.bridge import Bridge
from sim.lockstep import Flight, FlightOptions, fly
from sim.pace import Pace
from sim.ui import SimScreen
from tests.sim.test_sim_ui import Browser

MISSION = """
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}, {id: 2, north_m: 0, east_m: 300, heading_deg: 0}]
targets: [{id: 1, north_m: 400, east_m: 0, speed_bound_m_s: 0}, {id: 2, north_m: 400, east_m: 300, speed_bound_m_s: 0}]
defaults: {agent: {speed_m_s: 4, n_max: 0.25, range_m: 5000}}
surrogate: analytic
guidance_step_s: 1
integration_step_s: 0.5
broadcast_period_s: 1
assignment_period_s: 5
arrival_radius_m: 10
separation_m: 10
detector_range_m: 100
max_time_s: 76
"""
ADDED_S, RETIRED_S = 10.0, 24.0
HEARD_S = 1.0 + 0.1 + 0.5 + 1.0
"""From a command to the first step by it: a broadcast period, the link's delay, a tick and a guidance step."""
TURNS_S = 3.0
"""For a copter at 4 m/s to be on another course."""


class Flown(NamedTuple):
    """The flight and what the page was shown."""

    flight: Flight
    browser: Browser

    def course_deg(self, agent: int, t_s: float) -> float:
        """Return the course of an agent over the second before a time, in degrees east of north."""
        trajectory = self.flight.trajectory
        samples = [int(np.searchsorted(trajectory.t_s, at_s)) for at_s in (t_s - 1.0, t_s)]
        way_m = np.diff(trajectory.agents_ned_m[samples, agent], axis=0)[0]
        return math.degrees(math.atan2(way_m[1], way_m[0]))


class Deaf:
    """Loses every frame on its way to the second vehicle from a time of the flight on."""

    def __init__(self, browser: Browser, from_s: float) -> None:
        self._browser = browser
        self._from_s = from_s
        self._links: list[np.random.Generator] = []

    def __call__(self, datagram: bytes, generator: np.random.Generator) -> bytes:
        if not any(generator is known for known in self._links):
            self._links.append(generator)
        is_second = len(self._links) > 1 and generator is self._links[1]
        return b"" if is_second and self._browser.t_s >= self._from_s else datagram


@pytest.fixture(scope="module")
def flown() -> Flown:
    """Fly two copters; on the way of the first a threat is added and retired, and the second hears nothing of it."""
    threat = {"do": "add-threat", "north_m": 130.0, "east_m": 10.0, "radius_m": 50.0}
    asks: Sequence[tuple[float, Mapping[str, Any]]] = [
        (ADDED_S, threat),
        (RETIRED_S, {"do": "retire", "kind": "threat", "id": 1}),
    ]
    browser = Browser(asks)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sim.ui, "SHOW_PERIOD_S", 0.0)
        screen = SimScreen(cast(Bridge, browser), Pace())
        mission = resolve(parse_mission(MISSION, "test"), 1)
        options = FlightOptions("routed", "arducopter", screen=screen, tamper=Deaf(browser, ADDED_S))
        return Flown(fly(mission, 1, options), browser)


def test_the_copter_bends_its_way_within_one_broadcast_of_the_threat(flown: Flown) -> None:
    assert abs(flown.course_deg(0, ADDED_S)) < 3.0
    assert abs(flown.course_deg(0, ADDED_S + HEARD_S + TURNS_S)) > 10.0


def test_it_goes_straight_to_its_target_again_once_the_threat_is_retired(flown: Flown) -> None:
    trajectory = flown.flight.trajectory
    t_s = RETIRED_S + HEARD_S + TURNS_S
    north_m, east_m = trajectory.agents_ned_m[int(np.searchsorted(trajectory.t_s, t_s)), 0]
    straight_deg = math.degrees(math.atan2(-east_m, 400.0 - north_m))
    assert flown.course_deg(0, t_s + 1.0) == pytest.approx(straight_deg, abs=3.0)


def test_the_copter_that_hears_nothing_of_it_loiters_and_says_why(flown: Flown) -> None:
    last = flown.flight.logs[2].last
    assert last is not None
    assert last.purpose.value == "loiter"
    assert last.reason == "picture too old"
    shown = {agent["id"]: agent["reason"] for agent in flown.browser.pictures()[-1]["agents"]}
    assert shown[2].startswith("loiter: ")
    trajectory = flown.flight.trajectory
    settled = trajectory.t_s > 74.0
    assert np.ptp(trajectory.agents_ned_m[settled, 1], axis=0).max() < 5.0


def test_nobody_enters_the_threat_while_it_is_there(flown: Flown) -> None:
    trajectory = flown.flight.trajectory
    apart_m = np.hypot(*(trajectory.agents_ned_m - trajectory.threats_ned_m[:, :1]).transpose(2, 0, 1))
    assert np.nanmin(apart_m) > 50.0
    assert float(trajectory.t_s[~np.isnan(apart_m[:, 0])][0]) == ADDED_S
