"""Case II in flight: the centre sees no agent, so it reckons and hears reports; the agents see each other."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import yaml

from companion.files.tlog import read_tlog
from companion.files.yaml import dump_yaml
from companion.mission.model import Mission, load_mission, parse_mission
from companion.mission.resolve import resolve
from companion.protocol.codec import FrameReader, Kind, MotionFrame, StateFrame
from groundstation.agents import FIX_ERROR_M
from groundstation.ground_station import GroundStation
from sim.lockstep import Flight, FlightOptions, fly
from sim.safety_pilot import HAND_OVER_S
from sim.score import Score, score

BASE = """
name: unseen
case: II
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}, {id: 2, north_m: 0, east_m: 3000, heading_deg: 90}]
targets: [{id: 1, north_m: 6000, east_m: 0}, {id: 2, north_m: 6000, east_m: 3000}]
defaults:
  target: {speed_bound_m_s: 0}
  threat: {detection_radius_m: 1200, attack_radius_m: 500, speed_bound_m_s: 0}
max_time_s: 300
"""
ONE_TARGET = "targets: [{id: 1, north_m: 6000, east_m: 0}]\n"
DISC_AHEAD = "threats: [{id: 1, north_m: 3000, east_m: 200}]\n"
WIND = "wind: {from_deg: 0, speed_m_s: 8, gust_m_s: 3}\n"
REPORTS = "report_period_s: 10\nlost_after_s: 5\n"
EARLY_LOSS = ONE_TARGET + "losses: [{agent: 1, t_s: 20}]\n"
MEETING = """
agents:
  - {id: 1, north_m: -300, east_m: 0, heading_deg: 0, speed_m_s: 10, n_max: 2}
  - {id: 2, north_m: 300, east_m: 20, heading_deg: 180, speed_m_s: 10, n_max: 2}
targets:
  - {id: 1, speed_bound_m_s: 1000, motion: {path: [[0, -150, 150], [4, 800, 150]]}}
  - {id: 2, speed_bound_m_s: 1000, motion: {path: [[0, 150, 170], [4, -800, 170]]}}
assignment_period_s: 1000
arrival_radius_m: 100
separation_m: 200
"""
"""Two agents whose targets run past them to the other's side, so that they meet head-on: no assignment would cross."""


def mission_of(changes: str) -> Mission:
    listed = {**yaml.safe_load(BASE), **(yaml.safe_load(changes) or {})}
    return resolve(parse_mission(dump_yaml(listed), "test"), seed=1)


@dataclass
class Watched:
    """What the centre believed of the agents at every step, and how far off that was."""

    mission: Mission
    t_s: list[float] = field(default_factory=list)
    error_m: list[list[float]] = field(default_factory=list)
    uncertainty_m: list[list[float]] = field(default_factory=list)
    lost: list[set[int]] = field(default_factory=list)

    def __call__(self, t_s: float, ground: GroundStation, agents: np.ndarray) -> None:
        ids = [agent.id for agent in self.mission.agents]
        places = [ground.tracks.tracks[Kind.AGENT, identity].position_ned_m for identity in ids]
        self.t_s.append(t_s)
        self.error_m.append([math.dist(place, row[:2]) for place, row in zip(places, agents, strict=True)])
        self.uncertainty_m.append([ground.tracks.uncertainty_m[identity] for identity in ids])
        self.lost.append(set(ground.tracks.progress.lost))


def watched(changes: str = "", autopilot: str = "kinematic") -> Watched:
    mission = mission_of(changes)
    watch = Watched(mission)
    fly(mission, 1, FlightOptions(autopilot=autopilot, watch=watch))
    return watch


# Where the agents are reckoned to be


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        "",
        "link: {delay_s: 0}\n",
        "link: {delay_s: 3}\n",
        "guidance_step_s: 0.1\nintegration_step_s: 0.1\nmax_time_s: 40\n",
        "guidance_step_s: 5\n",
    ],
    ids=["", "without delay", "with much delay", "with short steps", "within long steps"],
)
def test_in_still_air_and_without_loss_an_agent_is_where_it_is_reckoned_to_be(changes: str) -> None:
    assert np.max(watched(changes).error_m) < 1.0


@pytest.mark.slow
def test_beside_a_threat_an_agent_is_where_it_is_reckoned_to_be_within_the_stated_doubt() -> None:
    watch = watched("threats: [{id: 1, north_m: 3000, east_m: 400}]\n")
    assert np.max(watch.error_m) < 50.0
    assert np.all(np.array(watch.error_m) <= np.array(watch.uncertainty_m) + 1.0)


@pytest.mark.slow
def test_a_copter_on_its_way_is_behind_where_it_is_reckoned_to_be_by_no_more_than_hand_over_and_lag() -> None:
    demo = load_mission("copter-demo").model_copy(update={"case": "II", "threats": (), "max_time_s": 60.0})
    watch = Watched(resolve(demo, 1))
    fly(watch.mission, 1, FlightOptions(autopilot="arducopter", watch=watch))
    (speed_m_s,) = {agent.speed_m_s for agent in watch.mission.agents}
    behind_s = np.max(watch.error_m) / speed_m_s
    assert HAND_OVER_S + 0.3 < behind_s < HAND_OVER_S + 1.2


def test_in_wind_an_agent_is_where_it_is_reckoned_to_be_within_the_stated_doubt() -> None:
    watch = watched(WIND)
    error_m, doubt_m = np.array(watch.error_m), np.array(watch.uncertainty_m)
    assert np.max(error_m) > 500.0
    assert np.all(error_m <= doubt_m + 10.0)


def test_every_report_puts_the_agents_back_where_they_are() -> None:
    watch = watched(WIND + "report_period_s: 20\n")
    error_m, doubt_m, t_s = np.array(watch.error_m), np.array(watch.uncertainty_m), np.array(watch.t_s)
    # A report is made at a step and taken in with the next.
    reported = (t_s % 20.0 == 0.5) & (t_s > 1.0)
    assert np.count_nonzero(reported) >= 4
    assert np.max(error_m[reported]) < FIX_ERROR_M
    assert np.max(doubt_m[reported]) < FIX_ERROR_M + 11.6 * 0.5 + 1e-6
    assert np.max(error_m) > 100.0


# What the centre says


def test_the_broadcast_of_a_flight_tells_neither_place_nor_motion_of_any_agent(tmp_path: Path) -> None:
    fly(mission_of("max_time_s: 20"), 1, FlightOptions(out=tmp_path))
    reader = FrameReader()
    frames = [frame for _, data in read_tlog(tmp_path / "broadcast.tlog") for frame in reader.read(data)]
    states = [frame for frame in frames if isinstance(frame, StateFrame)]
    motions = [frame for frame in frames if isinstance(frame, MotionFrame)]
    assert (len(states), len(motions)) == (4, 4)
    assert {agent.position_ned_m for state in states for agent in state.agents} == {None}
    assert [agent for motion in motions for agent in motion.agents] == []


def test_a_loss_is_known_when_the_report_is_overdue() -> None:
    watch = watched(EARLY_LOSS + REPORTS)
    first_s = next(t_s for t_s, lost in zip(watch.t_s, watch.lost, strict=True) if lost)
    # It last reported at 10 s; the next was due at 20 s, when it was lost, and is awaited for 5 s.
    assert first_s == 25.5
    assert watch.lost[-1] == {1}


# Scenarios


def all_reached(flight: Flight, scored: Score) -> bool:
    return scored.targets_reached == scored.targets


def none_reached(flight: Flight, scored: Score) -> bool:
    return scored.targets_reached == 0


def no_entry(flight: Flight, scored: Score) -> bool:
    return scored.threat_entries_detection == 0 and scored.worst_depth_m == 0.0


def no_breach(flight: Flight, scored: Score) -> bool:
    return scored.separation_breaches == 0


def a_breach(flight: Flight, scored: Score) -> bool:
    return scored.separation_breaches > 0


def a_near_miss(flight: Flight, scored: Score) -> bool:
    return scored.min_separation_m is not None and scored.min_separation_m < 50.0


def nearly_straight(flight: Flight, scored: Score) -> bool:
    return all(agent.path_to_end_m <= 1.02 * agent.shortest_path_m for agent in scored.per_agent)


def agent_two_arrived(flight: Flight, scored: Score) -> bool:
    return [agent.id for agent in scored.per_agent if agent.arrived_t_s is not None] == [2]


Check = Callable[[Flight, Score], bool]
SCENARIOS: list[tuple[str, str, list[Check]]] = [
    ("agents that nobody sees reach their targets straight on", "", [all_reached, nearly_straight]),
    ("agents that nobody sees go around a disc ahead", DISC_AHEAD, [all_reached, no_entry]),
    (
        "where half the frames are lost and nobody reports, an arrival believed too early takes no target away",
        DISC_AHEAD + "link: {loss: 0.5, jitter_s: 1.0, duplicate: 0.3, reorder: 0.3}\n",
        [all_reached, no_entry],
    ),
    (
        "in wind and gusts, with a report now and then, they do so too",
        DISC_AHEAD + WIND + "report_period_s: 20\n",
        [all_reached, no_entry],
    ),
    ("without reports wind delays only what the centre believes", DISC_AHEAD + WIND, [all_reached, no_entry]),
    (
        "half of the frames lost changes little where the agents report",
        DISC_AHEAD + REPORTS + "link: {loss: 0.5, jitter_s: 1.0, duplicate: 0.3, reorder: 0.3}\n",
        [all_reached, no_entry],
    ),
    (
        "the target of an agent that no longer reports goes to another",
        EARLY_LOSS + REPORTS,
        [all_reached, agent_two_arrived],
    ),
    (
        "without reports a loss stays unknown: the centre believes in an arrival that never was",
        EARLY_LOSS + "max_time_s: 200\n",
        [none_reached],
    ),
    (
        "two that meet head-on keep apart by their detectors",
        MEETING + "detector_range_m: 2000\n",
        [all_reached, no_breach],
    ),
    (
        "two that meet head-on without a detector know nothing of each other",
        MEETING + "detector_range_m: 0\n",
        [all_reached, a_breach, a_near_miss],
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("title", "changes", "checks"), SCENARIOS, ids=[row[0] for row in SCENARIOS])
def test_scenario(title: str, changes: str, checks: list[Check]) -> None:
    mission = mission_of(changes)
    flight = fly(mission, 1)
    scored = score(flight.trajectory, mission)
    for check in checks:
        assert check(flight, scored), f"{title}: {check.__name__}: {scored}"


@pytest.mark.slow
def test_the_same_seed_gives_the_same_flight_in_wind_bit_for_bit() -> None:
    mission = mission_of(WIND + REPORTS + "link: {loss: 0.3, jitter_s: 2.0}\nmax_time_s: 60\n")
    first, second, other = (fly(mission, seed).trajectory.agents_ned_m for seed in (7, 7, 8))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)
