"""A mission with more targets than agents, flown: who has arrived flies to the next, until all are reached."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sim.fly import FlownResult, FlyOptions, fly_mission

MISSION = """
agents: [{id: 1, north_m: 0, east_m: 0}, {id: 2, north_m: 0, east_m: 1500}]
targets:
  - {id: 1, north_m: 2500, east_m: 0}
  - {id: 2, north_m: 2500, east_m: 1500}
  - {id: 3, north_m: 4500, east_m: 0}
  - {id: 4, north_m: 4500, east_m: 1500}
  - {id: 5, north_m: 6000, east_m: 700}
queue: true
broadcast_period_s: 2
guidance_step_s: 1
integration_step_s: 0.5
max_time_s: 600
"""


def flown(tmp_path: Path, autopilot: str, *, out: bool = False) -> FlownResult:
    path = tmp_path / "queue.yaml"
    path.write_text(MISSION)
    options = FlyOptions(
        mission=str(path),
        seed=1,
        law="routed",
        autopilot=autopilot,
        vehicles=None,
        out=tmp_path / "out" if out else None,
        radio=None,
        share=None,
        one_radio=False,
        parameters=(),
        scale=autopilot != "kinematic",
        realtime=False,
        allow_monolithic=False,
    )
    return fly_mission(options)


def test_two_agents_reach_five_targets_one_after_the_other(tmp_path: Path) -> None:
    done = flown(tmp_path, "kinematic", out=True)
    assert done.failure is None
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert (result["arrived"], result["targets_reached"], result["targets"]) == (2, 5, 5)
    reached = [[one["target"] for one in agent["reached"]] for agent in result["agents"]]
    assert sorted(sum(reached, [])) == [1, 2, 3, 4, 5]
    assert [agent["outcome"] for agent in result["agents"]] == ["arrived", "arrived"]
    assert all(agent["reason"].startswith("within 300 m of targets ") for agent in result["agents"])


@pytest.mark.slow
@pytest.mark.parametrize("autopilot", ["arducopter", "px4-plane"])
def test_copters_that_stand_and_planes_that_circle_where_they_arrived_fly_on(tmp_path: Path, autopilot: str) -> None:
    done = flown(tmp_path, autopilot)
    assert done.failure is None
    assert done.result["targets_reached"] == 5
