"""Flies every law on every mission of an arena, and collects the figures of each flight.

Flights of different missions share nothing, so they run on as many processes as there are cores. The results depend on
the seed and the number of runs alone, except for the decision times.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from companion.guidance.laws import SteeringLaw, SteeringOf
from companion.guidance.settings import LAWS, LawName, LawSettings
from companion.mission.model import Mission
from sim.arena.families import FAMILIES, draw
from sim.arena.flight import ArenaFlight, fly_arena
from sim.arena.peers import PEERS, SLOW, horizon
from sim.arena.planner import plan, target_stays_clear
from sim.score import AgentScore, Score, score
from sim.worker_pool import outcomes

OWN_LAWS: tuple[LawName, ...] = ("routed", "seed")
"""This project's law and the paper's; `ramp` and `step`, which the paper only contrasts with its own, are left out."""
SLOW_RUNS = 20
"""Greatest number of missions of a family that a slow method flies; it flies only families with a single agent."""
DEAR_SHARE = 0.25
"""Share of the missions asked for that are flown of a family with several agents or of the field, because one of its
flights costs as much as many others."""
TIME_BINS_US = np.geomspace(1.0, 1e7, 281)
"""Edges of the bins in which decision times are counted, 6 % wide, so that the counts of many flights can be added."""


@dataclass(frozen=True)
class Feasibility:
    """Whether a mission can be flown at all, as found without any of the laws (docs/arena.md)."""

    feasible: bool
    why_not: str | None = None
    gap: float | None = None
    """Excess of the planner's length over its lower bound, as a share, for the worst agent; None where unknown."""
    seconds: float = 0.0
    """Wall-clock time that finding it out took."""


@dataclass(frozen=True)
class Run:
    """The figures of one flight: one law on one mission."""

    family: str
    index: int
    law: str
    feasibility: Feasibility
    certified: bool
    """Whether the guard certified every start for ever on the first picture, as known from the flight of `routed`; True
    if `routed` is not flown."""
    agents: int
    targets: int
    reached: int
    entries: int
    entries_attack: int
    worst_depth_m: float
    breaches: int
    min_separation_m: float | None
    path_ratios: tuple[float, ...]
    """Flown length over planned length of every agent that arrived and for which the planner found a path."""
    flight_time_s: float
    decision_counts: tuple[int, ...] = field(repr=False, default=())
    """Number of decisions in each bin of TIME_BINS_US."""
    decision_max_us: float = 0.0
    guarded: int = 0
    uncertified: int = 0
    gave_way: int = 0
    opposed: int = 0
    broken: dict[str, int] = field(default_factory=dict)
    stays: dict[str, int] = field(default_factory=dict)
    wall_s: float = 0.0
    until_s: float | None = None
    """How long the starts were certified for where that was neither for ever nor not at all."""

    @property
    def complete(self) -> bool:
        """Whether every target was reached."""
        return self.reached == self.targets


@dataclass(frozen=True)
class Job:
    """One mission, and the laws that fly it."""

    family: str
    seed: int
    index: int
    laws: tuple[str, ...]


def jobs_of(seed: int, runs: int | None, families: Sequence[str], laws: Sequence[str]) -> list[Job]:
    """Return the jobs of an arena: `runs` missions a family, fewer of dear ones, or those of a full arena.

    Slow methods fly the first SLOW_RUNS missions of the families with a single agent.
    """
    jobs = []
    for family in families:
        share = DEAR_SHARE if FAMILIES[family].dear else 1.0
        count = FAMILIES[family].count if runs is None else max(1, round(share * runs))
        for index in range(count):
            flown = [law for law in laws if law not in SLOW or (FAMILIES[family].single and index < SLOW_RUNS)]
            jobs.append(Job(family, seed, index, tuple(flown)))
    return jobs


def check_installed(jobs: Sequence[Job]) -> None:
    """Raise InputError if a law that the jobs fly needs a library that is not installed."""
    if any("horizon" in job.laws for job in jobs):
        horizon.check_installed()


def fly_all(jobs: Sequence[Job], workers: int, progress: Callable[[int, int], None]) -> list[Run]:
    """Fly every job on `workers` processes (0: in this process); return the runs in order of family, index and law."""
    # A fleet takes as long as many single agents: dear ones go first, so that no core waits for one at the end.
    ordered = sorted(jobs, key=lambda job: not FAMILIES[job.family].dear)
    runs: list[Run] = []
    for done, (_, flown) in enumerate(outcomes(fly_job, ordered, workers), start=1):
        runs += flown
        progress(done, len(ordered))
    families = list(FAMILIES)
    return sorted(runs, key=lambda run: (families.index(run.family), run.index, law_order(run.law)))


def law_order(law: str) -> int:
    """Return the position of a law in tables: this project's laws first, then the published methods."""
    return [*LAWS, *PEERS].index(law)


def fly_job(job: Job) -> list[Run]:
    """Fly one mission with each of its laws."""
    mission = draw(job.family, job.seed, job.index)
    seed = flight_seed(job.seed, job.index)
    planned = _Planned(mission, seed)
    feasibility = _feasibility(mission, planned)
    certified_s = math.inf
    runs = []
    for law in sorted(job.laws, key=law_order):
        began_s = time.perf_counter()
        flight = fly_law(mission, seed, law)
        if law == "routed":
            certified_s = flight.certified_s
        scored = score(flight.trajectory, mission)
        runs.append(
            Run(
                family=job.family,
                index=job.index,
                law=law,
                feasibility=feasibility,
                certified=math.isinf(certified_s),
                until_s=certified_s if 0.0 < certified_s < math.inf else None,
                agents=len(mission.agents),
                targets=scored.targets,
                reached=scored.targets_reached,
                entries=scored.threat_entries_detection,
                entries_attack=scored.threat_entries_attack,
                worst_depth_m=scored.worst_depth_m,
                breaches=scored.separation_breaches,
                min_separation_m=scored.min_separation_m,
                path_ratios=_ratios(scored, flight, mission, planned),
                flight_time_s=scored.flight_time_s,
                decision_counts=tuple(np.histogram(flight.decision_us, TIME_BINS_US)[0].tolist()),
                decision_max_us=float(flight.decision_us.max(initial=0.0)),
                guarded=flight.guarded,
                uncertified=flight.uncertified,
                gave_way=flight.gave_way,
                opposed=flight.opposed,
                broken=flight.broken,
                stays=flight.stays,
                wall_s=time.perf_counter() - began_s,
            )
        )
    return runs


def flight_seed(seed: int, index: int) -> int:
    """Return the seed that a mission is flown with, which `sim fly --seed` takes to repeat the flight."""
    return seed * 100_000 + index


def fly_law(mission: Mission, seed: int, law: str) -> ArenaFlight:
    """Fly a mission with one of our laws or one of the published methods (PEERS)."""
    own = next((name for name in LAWS if name == law), None)
    if own is not None:
        return fly_arena(mission, seed, own)
    return fly_arena(mission, seed, "seed", _steering(law))


def _steering(law: str) -> SteeringOf:
    def make(settings: LawSettings) -> SteeringLaw:
        return PEERS[law](settings)

    return make


class _Planned:
    """The planner's lengths for one mission, each computed once."""

    def __init__(self, mission: Mission, seed: int) -> None:
        self._mission = mission
        self.seconds = 0.0
        self.worst_gap: float | None = None
        self._plan = functools.cache(functools.partial(plan, mission, seed=seed))

    def length_m(self, agent_id: int, target_ned_m: tuple[float, float]) -> float:
        """Return the length of the path, within the turn limit, to the arrival radius of a place; infinite if none."""
        found = self._plan(agent_id, target_ned_m, until_s=self._mission.max_time_s)
        if math.isfinite(found.length_m) and found.lower_bound_m > 0.0:
            self.worst_gap = max(self.worst_gap or 0.0, found.gap)
        return found.length_m


def _feasibility(mission: Mission, planned: _Planned) -> Feasibility:
    """Return whether a mission can be flown: targets stay clear, and the planner finds some agent's path to each.

    The third condition of docs/arena.md, a start that the guard certifies, is found by flying: see Run.certified.
    """
    began_s = time.perf_counter()

    def verdict(why_not: str | None) -> Feasibility:
        return Feasibility(why_not is None, why_not, planned.worst_gap, time.perf_counter() - began_s)

    lost = {loss.agent for loss in mission.losses}
    able = [agent for agent in mission.agents if agent.id not in lost]
    for target in mission.targets:
        if not target_stays_clear(mission, target.position_ned_m, mission.max_time_s):
            return verdict(f"target {target.id} is inside a disc by the end")
    if len(able) < len(mission.targets):
        return verdict("fewer agents are left than there are targets")
    for target in mission.targets:
        sent = [agent for agent in able if agent.only_target == target.id] or [
            agent for agent in able if agent.only_target is None
        ]
        nearest = sorted(sent, key=lambda agent: math.dist(agent.position_ned_m, target.position_ned_m))
        if not any(math.isfinite(planned.length_m(agent.id, target.position_ned_m)) for agent in nearest):
            return verdict(f"no way to target {target.id}")
    return verdict(None)


def _ratios(scored: Score, flight: ArenaFlight, mission: Mission, planned: _Planned) -> tuple[float, ...]:
    """Return flown over planned lengths; to a target that moves, the path is planned to where it was reached."""
    static = {target.id: target.position_ned_m for target in mission.targets if target.motion == "static"}
    ratios = []
    for agent in scored.per_agent:
        if agent.arrived_t_s is None or agent.target_id is None:
            continue
        place = static.get(agent.target_id) or _target_at(flight, agent)
        length_m = planned.length_m(agent.id, place)
        if 0.0 < length_m < math.inf:
            ratios.append(agent.path_to_end_m / length_m)
    return tuple(ratios)


def _target_at(flight: ArenaFlight, agent: AgentScore) -> tuple[float, float]:
    trajectory = flight.trajectory
    sample = int(np.searchsorted(trajectory.t_s, agent.arrived_t_s or 0.0))
    north_m, east_m = trajectory.targets_ned_m[sample, trajectory.target_ids.index(agent.target_id or 0)]
    return float(north_m), float(east_m)
