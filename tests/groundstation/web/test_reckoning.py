"""Routes, decisions and trails: what the worker beside the page reckons from pictures and frames."""

from __future__ import annotations

import math
import socket
import subprocess
import sys
from typing import Any

import pytest

from companion.guard.types import Piece
from companion.mission.model import Mission, parse_mission
from groundstation.ground_station import GroundStation
from groundstation.view import Surroundings, moves, picture
from groundstation.web.pipe import frames_message, packed
from groundstation.web.routes import KEPT_S, WORK_S, Routes
from groundstation.web.trails import MOST_POINTS, Trails
from groundstation.web.why import why
from groundstation.web.worker import Worker

START_S = 1_790_000_000.0
MISSION = """
name: pair
agents:
  - {id: 1, north_m: 0, east_m: 0, heading_deg: 0, speed_m_s: 20, range_m: 50000}
  - {id: 2, north_m: 0, east_m: 4000, heading_deg: 0, speed_m_s: 20, range_m: 50000}
targets: [{id: 1, north_m: 8000, east_m: 0}, {id: 2, north_m: 8000, east_m: 4000}]
threats: [{id: 1, north_m: 4000, east_m: 10, detection_radius_m: 1000, attack_radius_m: 500, speed_bound_m_s: 0}]
"""


def mission() -> Mission:
    return parse_mission(MISSION, "pair")


@pytest.fixture(scope="module")
def heard() -> list[tuple[float, bytes]]:
    """Return the frames of the first two seconds."""
    station = GroundStation(mission(), START_S)
    times_s = [START_S + 0.5 * step for step in range(5)]
    return [(now_s, datagram) for now_s in times_s for datagram in station.tick(now_s)]


@pytest.fixture(scope="module")
def shown() -> dict[str, Any]:
    station = GroundStation(mission(), START_S)
    station.tick(START_S)
    return picture(station, START_S + 2.0, Surroundings())


def _clearance_m(line: list[tuple[float, float]], centre: tuple[float, float]) -> float:
    """Return the least distance of a line's legs to a point."""
    least = math.inf
    for (n0, e0), (n1, e1) in zip(line, line[1:], strict=False):
        north, east = n1 - n0, e1 - e0
        square = north * north + east * east or 1.0
        along = max(0.0, min(1.0, ((centre[0] - n0) * north + (centre[1] - e0) * east) / square))
        least = min(least, math.dist((n0 + along * north, e0 + along * east), centre))
    return least


def test_a_route_leads_around_the_threat_to_the_target_and_straight_where_nothing_is_in_the_way(
    shown: dict[str, Any],
) -> None:
    routes = Routes(mission()).update(shown)
    assert routes["1"][0] == (0.0, 0.0)
    assert routes["1"][-1] == (8000.0, 0.0)
    assert 990.0 <= _clearance_m(routes["1"], (4000.0, 10.0)) <= 1010.0
    assert routes["2"] == [(0.0, 4000.0), (8000.0, 4000.0)]


def test_a_threat_that_grows_with_age_is_passed_wider(shown: dict[str, Any]) -> None:
    grown = {**shown, "threats": [{**shown["threats"][0], "growth_m": 500.0}]}
    assert _clearance_m(Routes(mission()).update(grown)["1"], (4000.0, 10.0)) >= 1490.0


def test_a_threat_above_the_agents_is_flown_under(shown: dict[str, Any]) -> None:
    above = {**shown, "threats": [{**shown["threats"][0], "floor_m": 9000.0, "ceiling_m": None}]}
    assert len(Routes(mission()).update(above)["1"]) == 2


def test_nobody_has_a_route_who_is_not_under_way(shown: dict[str, Any]) -> None:
    first, second = shown["agents"]
    still = {**shown, "agents": [{**first, "state": "out"}, {**second, "target": None}]}
    assert Routes(mission()).update(still) == {}


def test_a_route_that_was_found_is_kept_and_shortened_until_it_is_old_or_something_changes(
    shown: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    searched: list[int] = []
    routes = Routes(mission())
    search = routes._searched

    def counted(agent: dict[str, Any], target: dict[str, Any], threats: list[dict[str, Any]]) -> tuple[Piece, ...]:
        searched.append(agent["id"])
        return search(agent, target, threats)

    monkeypatch.setattr(routes, "_searched", counted)
    second = {**shown["agents"][1], "north_m": 3000.0}
    routes.update(shown)
    later = routes.update({**shown, "t_s": shown["t_s"] + 1.0, "agents": [shown["agents"][0], second]})
    assert later["2"] == [(3000.0, 4000.0), (8000.0, 4000.0)]
    assert searched == [1, 2]
    moved = {**shown, "threats": [{**shown["threats"][0], "east_m": 200.0}]}
    routes.update(moved)
    routes.update({**moved, "t_s": shown["t_s"] + KEPT_S + 1.0})
    assert searched == [1, 2, 1, 2, 1, 2]


def test_the_work_for_one_picture_is_bounded_and_the_rest_is_done_for_the_next(shown: dict[str, Any]) -> None:
    clock = iter([0.0, 0.0, WORK_S + 0.1, 0.0, 0.0, 0.0])
    routes = Routes(mission(), lambda: next(clock))
    assert list(routes.update(shown)) == ["1"]
    assert sorted(routes.update(shown)) == ["1", "2"]


def test_the_copy_of_a_companion_says_what_it_would_do_and_why(
    shown: dict[str, Any], heard: list[tuple[float, bytes]]
) -> None:
    decision = why(mission(), shown, 1, heard, can_stop=False)
    assert (decision["purpose"], decision["reason"], decision["target"]) == ("target", "assigned", 1)
    assert decision["stage"] == "fresh"
    assert decision["certificate"] == "for ever"
    assert decision["sentences"][0] == "It is to target: assigned (target 1)."


def test_a_copy_that_has_heard_nothing_waits_and_says_so(shown: dict[str, Any]) -> None:
    decision = why(mission(), shown, 1, [], can_stop=False)
    assert decision["purpose"] == "idle"
    assert "It has heard no whole picture yet." in decision["sentences"]


def test_the_worker_answers_a_job_with_routes_or_with_decisions(
    shown: dict[str, Any], heard: list[tuple[float, bytes]]
) -> None:
    worker = Worker()
    job = {"type": "job", "picture": shown, "why": [], "heard": []}
    assert worker.answer(job) == {"type": "done", "routes": {}, "why": {}}
    known = {**job, "mission": mission().model_dump(mode="json")}
    assert sorted(worker.answer(known)["routes"]) == ["1", "2"]
    frames = [frames_message(heard_s, [datagram]) for heard_s, datagram in heard]
    asked = worker.answer({**job, "why": [2, 99], "heard": frames})
    assert asked["why"]["2"]["target"] == 2
    assert asked["why"]["99"] is None


def test_trails_hold_where_things_were_and_never_more_than_so_many_points() -> None:
    trails = Trails()
    for step in range(10_000):
        at = [1, 3.0 * step, 0.0, 0.0, 0.0, 0.0]
        trails.add({"t_s": float(step), "agents": [at], "targets": [], "threats": []})
    points = trails.to_dict()["agents"]["1"]
    assert MOST_POINTS / 4 <= len(points) <= MOST_POINTS
    assert points[0] == (0.0, 0.0, 0.0)
    assert points[-1][0] > 9_800.0
    trails.add({"t_s": 1e4, "agents": [], "targets": [], "threats": []})
    assert trails.to_dict()["agents"] == {}


def test_the_view_and_the_trails_agree_on_moves() -> None:
    trails = Trails()
    trails.add(moves(GroundStation(mission(), START_S), START_S))
    assert trails.to_dict()["targets"]["2"] == [(START_S, 8000.0, 4000.0)]


def test_a_worker_whose_web_process_was_killed_ends_without_a_word() -> None:
    ours, its = socket.socketpair()
    command = [sys.executable, "-m", "groundstation.web.worker", str(its.fileno())]
    with subprocess.Popen(command, pass_fds=[its.fileno()], stderr=subprocess.PIPE) as worker:
        its.close()
        # Closed with the answers unread, as by a process that is killed.
        for _ in range(3):
            ours.sendall(packed({"type": "job", "picture": {}, "heard": [], "why": []}))
        ours.close()
        _, said = worker.communicate(timeout=60.0)
    assert (worker.returncode, said) == (0, b"")
