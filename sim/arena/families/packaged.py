"""The family `paper`: the paper's scenes, as packaged."""

from __future__ import annotations

import numpy as np

from companion.mission.model import (
    AgentSpec,
    Mission,
    load_mission,
)
from companion.mission.resolve import resolve
from sim.arena.families.drawing import TRIES, NoRoomError, interaction_m, least_gap_m
from sim.arena.planner import target_stays_clear

PAPER_TIME_S = 2_400.0
"""Time limit of the paper's scenes: in it an agent flies 144 km at 60 m/s, and a threat of 10 m/s at most 24 km. Within
the default of 20 000 s every disc would grow over the whole square."""
PAPER_THREAT_M_S = 10.0
PAPER_WALK_M = 2_000.0
"""Distance around a walking target's start that is kept clear of every disc: 480 steps of 50 m in random directions
lead 1.1 km (rms) away from the start."""
PAPER_STEP_S = 1.0


def paper(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    """Draw a mission of the family `paper`; raise NoRoomError if it has no room."""
    kind = str(generator.choice(["static", "dynamic"]))
    packaged = load_mission(f"paper-{kind}")
    reach_s = PAPER_TIME_S + PAPER_WALK_M / PAPER_THREAT_M_S
    agent = AgentSpec(id=1, **packaged.defaults.agent.model_dump(exclude_none=True))
    gap_m = radius_m or interaction_m(packaged.separation_m, agent.n_max, agent.speed_m_s, PAPER_STEP_S)
    for _ in range(TRIES):
        mission = resolve(packaged, int(generator.integers(2**31)))
        apart_m = least_gap_m(np.array([agent.position_ned_m for agent in mission.agents]))
        clear = all(target_stays_clear(mission, target.position_ned_m, reach_s) for target in mission.targets)
        if clear and apart_m >= gap_m:
            changes = {
                "name": f"{name}-{kind}",
                "guidance_step_s": PAPER_STEP_S,
                "integration_step_s": PAPER_STEP_S,
                "range_policy": "arrive",
                "max_time_s": PAPER_TIME_S,
            }
            return mission.model_copy(update=changes)
    raise NoRoomError
