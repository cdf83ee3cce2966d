"""The arena's flights: the same decisions as over the wire, repeatable, and what is counted of them."""

import dataclasses

import numpy as np
import pytest

from companion.guard.types import Motion
from companion.guidance.laws import SteeringDemand, Task
from companion.guidance.settings import LawSettings
from companion.guidance.steering import SteeringVector
from companion.guidance.view import View
from companion.mission.model import AgentSpec, LinkSpec, Loss, Mission, TargetSpec, ThreatSpec, Wind
from sim.arena.flight import fly_arena
from sim.arena.run import Job, flight_seed, fly_job
from sim.lockstep import FlightOptions, fly

LAWS = ("routed", "seed")


def a_mission(**changes: object) -> Mission:
    given = {
        "name": "one disc",
        "agents": (AgentSpec(id=1, north_m=0.0, east_m=0.0, heading_deg=0.0, speed_m_s=25.0, n_max=1.0),),
        "targets": (TargetSpec(id=1, north_m=3_000.0, east_m=0.0, speed_bound_m_s=0.0),),
        "threats": (
            ThreatSpec(
                id=1,
                north_m=1_500.0,
                east_m=100.0,
                detection_radius_m=500.0,
                attack_radius_m=250.0,
                speed_bound_m_s=0.0,
            ),
        ),
        "arrival_radius_m": 50.0,
        "separation_m": 40.0,
        "max_time_s": 300.0,
    }
    return Mission(**{**given, **changes})  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_a_flight_is_that_of_the_lockstep_runner_to_a_metre(law: str) -> None:
    mission = a_mission(link=LinkSpec(loss=0.2))
    here = fly_arena(mission, 1, law).trajectory  # type: ignore[arg-type]
    there = fly(mission, 1, FlightOptions(law=law)).trajectory  # type: ignore[arg-type]
    samples = min(len(here.t_s), len(there.t_s))
    assert abs(len(here.t_s) - len(there.t_s)) <= 1
    apart_m = np.hypot(*(here.agents_ned_m[:samples, 0] - there.agents_ned_m[:samples, 0]).T)
    assert apart_m.max() < 1.0


def test_a_flight_in_wind_is_that_of_the_lockstep_runner_to_a_few_metres() -> None:
    mission = a_mission(threats=(), wind=Wind(from_deg=90.0, speed_m_s=5.0, gust_m_s=2.0))
    here, there = fly_arena(mission, 1).trajectory, fly(mission, 1, FlightOptions(law="routed")).trajectory
    samples = min(len(here.t_s), len(there.t_s))
    apart_m = np.hypot(*(here.agents_ned_m[:samples, 0] - there.agents_ned_m[:samples, 0]).T)
    assert apart_m.max() < 5.0


def test_the_same_flight_comes_out_twice() -> None:
    mission = a_mission(link=LinkSpec(loss=0.3))
    first, second = fly_arena(mission, 7), fly_arena(mission, 7)
    np.testing.assert_array_equal(first.trajectory.agents_ned_m, second.trajectory.agents_ned_m)


class Straight:
    """Flies straight on for ever."""

    def steer(self, task: Task, pose: Motion, view: View, now_s: float) -> SteeringDemand:
        return SteeringDemand(SteeringVector(1.0, 0.0))


def test_a_law_of_the_callers_steers_in_the_place_of_ours() -> None:
    def straight(settings: LawSettings) -> Straight:
        return Straight()

    flight = fly_arena(a_mission(threats=()), 1, "seed", straight)
    assert np.abs(flight.trajectory.agents_ned_m[:, 0, 1]).max() < 20.0


def test_a_lost_agent_stands_where_it_was_lost() -> None:
    mission = a_mission(
        agents=(
            AgentSpec(id=1, north_m=0.0, east_m=0.0, heading_deg=0.0, speed_m_s=25.0, n_max=1.0),
            AgentSpec(id=2, north_m=0.0, east_m=-2_000.0, heading_deg=0.0, speed_m_s=25.0, n_max=1.0),
        ),
        losses=(Loss(agent=2, t_s=20.0),),
    )
    places = fly_arena(mission, 1).trajectory.agents_ned_m[:, 1]
    assert np.all(places[41:] == places[41])
    assert np.any(places[39] != places[41])


def test_a_job_flies_each_law_and_measures_it_against_the_planner() -> None:
    runs = fly_job(Job("dense", 1, 5, LAWS))
    assert [run.law for run in runs] == list(LAWS)
    ours = runs[0]
    assert ours.feasibility.feasible and ours.certified and ours.complete
    assert ours.entries == 0
    assert 0.99 < ours.path_ratios[0] < 1.1
    assert sum(ours.decision_counts) > 100


@pytest.mark.slow
def test_a_job_comes_out_the_same_twice_but_for_times() -> None:
    def timeless(job: Job) -> list[object]:
        return [
            dataclasses.replace(
                run,
                decision_counts=(),
                decision_max_us=0.0,
                wall_s=0.0,
                feasibility=dataclasses.replace(run.feasibility, seconds=0.0),
            )
            for run in fly_job(job)
        ]

    job = Job("traps", 2, 1, ("routed",))
    assert timeless(job) == timeless(job)


def test_flight_seeds_of_different_missions_differ() -> None:
    assert len({flight_seed(seed, index) for seed in (1, 2) for index in range(500)}) == 1_000
