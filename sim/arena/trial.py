"""One random mission flown and judged: what was promised and kept, who arrived, and for what reason others did not.

The simulator is kinematic. A certificate counts only if it is for ever. Whether a mission is feasible is said by the
planner, which shares no code with the flight: from where the vehicle first steered there must be a path with as much
room as the vehicle's margins need, which follow from its step, its turn and the broadcast's grid.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from companion.mission.model import AgentSpec, Mission
from companion.onboard.decision import Purpose, certificate_of
from sim.approaches import threat_approaches
from sim.arena.flight import AgentFlight, ArenaFlight, fly_arena
from sim.arena.missions import RandomMission
from sim.arena.plan_task import Needs, ground_turn_radius_m
from sim.arena.planner import Plan, leads_on, plan
from sim.changes import things_of
from sim.score import AgentScore, score

CLOCK_S = 1e-6
"""Difference of two times of a flight that counts as none."""
GRID_UNITS = 32_767
"""Greatest number of a position on the wire: the farthest coordinate over it is the grid's resolution at the finest."""
LEAST_GRID_M = 0.01
GRIDS = 3.0
"""Resolutions by which a disc may be told greater than it is: its place and its radius are rounded."""
STEP_SHARE = 0.1
"""Room that a vehicle that is steered in steps needs beside every disc, as a share of one step's length."""
LEAST_ROOM_M = 4.0
"""Room beside every disc that is needed at the least: the planner's margin and that of the route."""
TURN_STEPS = 1.0
"""Least turn radius with which a path can be followed, in lengths of a guidance step."""
TIME_SHARE = 0.75
"""Share of the time left for which a path must suffice: what is flown is somewhat longer, and waits for pictures."""
LIMITS_MS = ((25, 20.0), (100, 50.0), (400, 100.0))
"""Longest processor time of a decision, ms, by the greatest number of discs for which it holds."""
RATIO_LIMIT = 1.05
LATE_SHARE = 0.25
"""Last part of a flight, in which an agent that is on its way comes nearer to its target than it was before."""
SILENT_CIRCLES, SILENT_STEPS = 4.0, 30.0
"""Turning circles and guidance steps after which an agent that comes no nearer must have said why."""
OUT_OF_TIME = "out of time on its way"
NO_PLAN = Plan(math.inf, math.inf, np.empty((0, 3)), "none", 0.0)
ASSIGNED = "assigned"
"""Reason of a decision that goes to its target and says nothing else."""


@dataclass(frozen=True)
class Trial:
    """The figures of one random mission's flight."""

    name: str
    recipe: str
    packed: bool
    agents: int
    discs: int
    static: bool
    """Whether no threat moves."""
    certificates: tuple[str, ...]
    """Kind of each agent's certificate when it first steered; `not engaged` if it never did."""
    arrived: int
    targets: int
    entries: int
    entries_for_ever: int
    """Entries into an R_d of agents that had been certified for ever before."""
    worst_depth_m: float
    breaches: int
    broken: dict[str, int]
    why_not: tuple[str, ...]
    """Last reason of each agent that did not arrive; empty if it had none."""
    feasible: bool | None
    """Whether the single agent could arrive; None where threats move or there are several agents."""
    path_ratio: float | None
    """Flown over planned length, both with the room of a certified flight, from where the single agent first steered;
    None where it is not known, or where the link loses frames: then the agent may have waited for a picture."""
    decision_ms: float
    """Processor time of the longest decision."""
    steps: int
    cpu_s: float

    @property
    def decision_limit_ms(self) -> float:
        """Longest time that a decision may take."""
        return next((limit_ms for discs, limit_ms in LIMITS_MS if self.discs <= discs), math.inf)

    @property
    def faults(self) -> tuple[str, ...]:
        """What the flight broke of what was promised."""
        found = []
        if self.entries_for_ever:
            found.append("entry from for ever")
        if self.feasible and self.certificates == ("for ever",) and self.arrived < self.targets:
            found.append("did not arrive")
        if any(reason in ("", ASSIGNED) for reason in self.why_not):
            found.append("no reason")
        return tuple(found)

    @property
    def slow(self) -> bool:
        """Whether a decision took longer than it may."""
        return self.decision_ms > self.decision_limit_ms


def fly_trial(given: RandomMission) -> Trial:
    """Fly a random mission and judge the flight."""
    mission, began_s = given.mission, time.process_time()
    flight = fly_arena(mission, given.seed, radio=given.radio)
    scored = score(flight.trajectory, mission)
    static = all(threat.speed_bound_m_s == 0.0 for threat in mission.threats)
    planned, losing = None, False
    if static and len(mission.agents) == 1 and math.isfinite(flight.agents[0].engaged_t_s):
        planned = _planned(mission, flight)
        losing = mission.link.loss > 0.0 or mission.link.burst is not None
    pairs = list(zip(flight.agents, scored.per_agent, strict=True))
    return Trial(
        name=mission.name,
        recipe=given.recipe,
        packed=given.radio is not None,
        agents=len(mission.agents),
        discs=len(mission.threats),
        static=static,
        certificates=tuple(_certificate(agent) for agent, _ in pairs),
        arrived=scored.targets_reached,
        targets=scored.targets,
        entries=scored.threat_entries_detection,
        entries_for_ever=_entries_for_ever(mission, flight),
        worst_depth_m=scored.worst_depth_m,
        breaches=scored.separation_breaches,
        broken=flight.broken,
        why_not=tuple(_reason(mission, flight, i) for i, (_, j) in enumerate(pairs) if j.arrived_t_s is None),
        feasible=None if planned is None else math.isfinite(planned.length_m),
        path_ratio=None if planned is None or losing else _ratio(planned, flight, mission, scored.per_agent[0]),
        decision_ms=float(flight.decision_us.max(initial=0.0)) / 1000.0,
        steps=len(flight.decision_us),
        cpu_s=time.process_time() - began_s,
    )


def grid_m(mission: Mission) -> float:
    """Return the resolution in m in which the broadcast tells the mission's places."""
    places = [agent.position_ned_m for agent in mission.agents]
    places += [thing.position_ned_m for things in (mission.targets, mission.threats) for thing in things]
    return max(LEAST_GRID_M, float(np.abs(np.array(places)).max()) / GRID_UNITS)


def room_m(mission: Mission, agent: AgentSpec) -> float:
    """Return the room in m that an agent needs beside every disc and edge so that it can be certified there."""
    step_m = agent.speed_m_s * mission.guidance_step_s
    return LEAST_ROOM_M + GRIDS * grid_m(mission) + STEP_SHARE * step_m


def _planned(mission: Mission, flight: ArenaFlight) -> Plan:
    """Return the plan for the single agent from where it first steered, with the room of a certified flight."""
    # Within a grid's resolution of the target nobody can tell whether the agent has arrived.
    arrival_m = mission.arrival_radius_m - grid_m(mission)
    if arrival_m <= 0.0:
        return NO_PLAN
    engaged_s, trajectory = flight.agents[0].engaged_t_s, flight.trajectory
    sample = int(np.searchsorted(trajectory.t_s, engaged_s - CLOCK_S))
    north_m, east_m = (float(value) for value in trajectory.agents_ned_m[sample, 0])
    heading_deg = float(trajectory.agents_heading_deg[sample, 0])
    agent = mission.agents[0].model_copy(update={"north_m": north_m, "east_m": east_m, "heading_deg": heading_deg})
    there = mission.model_copy(update={"agents": (agent,), "arrival_radius_m": arrival_m})
    needs = Needs(room_m(mission, agent), TURN_STEPS * agent.speed_m_s * mission.guidance_step_s)
    until_s = TIME_SHARE * (mission.max_time_s - engaged_s)
    found = plan(there, agent.id, mission.targets[0].position_ned_m, until_s, 0, needs)
    return found if len(found.way) and leads_on(there, agent.id, found, needs) else NO_PLAN


def _certificate(agent: AgentFlight) -> str:
    return "not engaged" if math.isinf(agent.engaged_t_s) else str(certificate_of(agent.certified_s).value)


def _entries_for_ever(mission: Mission, flight: ArenaFlight) -> int:
    """Return how often agents entered an R_d after they had been certified for ever."""
    if not mission.threats:
        return 0
    since_s = np.array([agent.for_ever_t_s for agent in flight.agents])
    counts = flight.trajectory.t_s[:, None] >= since_s - CLOCK_S
    things = things_of(flight.trajectory, mission, ())
    return int(threat_approaches(flight.trajectory, counts, mission, things).entries_detection.sum())


def _reason(mission: Mission, flight: ArenaFlight, index: int) -> str:
    """Return why an agent did not arrive: what its companion last said, or that the time was up on its way."""
    last = flight.agents[index].last
    if last is None:
        return ""
    words = [last.stay or "", "" if last.purpose is Purpose.TARGET else last.reason, last.note or "", *last.triggers]
    said = next((word for word in words if word), "")
    return said or (OUT_OF_TIME if _comes_nearer(mission, flight, index) else ASSIGNED)


def _comes_nearer(mission: Mission, flight: ArenaFlight, index: int) -> bool:
    """Return whether an agent was nearer to its target in the last part of its flight than ever before.

    That part is at least as long as the time after which its companion must say that it comes no nearer.
    """
    last, trajectory = flight.agents[index].last, flight.trajectory
    if last is None or last.target_id is None:
        return False
    target = trajectory.targets_ned_m[:, trajectory.target_ids.index(last.target_id)]
    to_go_m = np.linalg.norm(trajectory.agents_ned_m[:, index] - target, axis=-1)
    agent, engaged_s = mission.agents[index], flight.agents[index].engaged_t_s
    circle_s = math.tau * ground_turn_radius_m(agent.speed_m_s, agent.n_max, 0.0) / agent.speed_m_s
    silent_s = SILENT_CIRCLES * circle_s + SILENT_STEPS * mission.guidance_step_s
    end_s = float(trajectory.t_s[-1])
    late_s = end_s - max(LATE_SHARE * end_s, silent_s)
    if late_s <= engaged_s:
        return True
    before = int(np.searchsorted(trajectory.t_s, late_s))
    step_m = agent.speed_m_s * mission.guidance_step_s
    return bool(to_go_m[before:].min() < to_go_m[:before].min(initial=math.inf) - step_m)


def _ratio(planned: Plan, flight: ArenaFlight, mission: Mission, judged: AgentScore) -> float | None:
    """Return flown over planned length from where the agent first steered, None where there is no plan or arrival."""
    if judged.arrived_t_s is None or not 0.0 < planned.length_m < math.inf:
        return None
    return (judged.path_to_end_m - mission.agents[0].speed_m_s * flight.agents[0].engaged_t_s) / planned.length_m
