"""Flies a mission with the decision functions of vehicles and ground station alone, without frames: the pure core.

`sim.lockstep` flies the programs over the wire, which takes a few seconds per flight; hundreds of seeds need something
faster. Everything happens in lockstep's order: the world moves, arrivals are noted, the ground station looks once a
second, assigns and broadcasts, then the agents decide. Left out is what only the wire or the flying system has: the
rounding of positions to the frame's resolution and of radii upwards, the guard, the failsafe stages, the budget of
range. Peers are seen where they are, not extrapolated from the last broadcast. The simulator is kinematic: the vehicles
are points that turn at a bounded rate.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Literal

import numpy as np

from companion.geo.kinematics import limit_turn, turn_rate_rad_s, turn_towards
from companion.guidance.steering import (
    Occupied,
    SteeringVector,
    attraction,
    circling,
    claim_m,
    loiter_place,
    loiter_radius_m,
    loiter_spacing_m,
)
from companion.mission.model import LinkSpec, Mission, Wind
from companion.onboard.goal import ARRIVAL_SHARE
from companion.surrogate.cost import Weights
from companion.surrogate.profiles import (
    PROFILE_NAMES,
    RadialProfile,
    StepProfile,
    ThreatDiscs,
    profile_by_name,
    surrogate_gradient,
)
from groundstation.assignment import OBJECTIVES, Objective, assign
from sim.arrivals import Passages
from sim.sensor import LOOK_PERIOD_S
from sim.trajectory import Trajectory, TrajectoryBuilder
from sim.world import World

CoreLaw = Literal["seed", "step"]
"""The paper's law on its surrogate F* (`seed`), or on F itself, whose gradient is zero wherever it exists (`step`)."""
PERFECT_LINK = LinkSpec(delay_s=0.0)
_TOLERANCE_S = 1e-6
_NO_TARGET = -1


@dataclass(frozen=True)
class CoreFlight:
    """The trajectory and the figures of a flight on the pure core."""

    trajectory: Trajectory
    steps: int
    """Number of guidance steps."""
    step_us: np.ndarray  # (steps,) us, wall-clock time of the centre's and all agents' decisions in each step
    turn_limited_steps: int
    """Number of decisions, over all agents, in which the turn limit was active."""


@dataclass(frozen=True)
class _Heard:
    """Content of the last broadcast."""

    t_s: float
    targets_ned_m: np.ndarray  # (K, 2) m
    threats_ned_m: np.ndarray  # (M, 2) m
    assigned: np.ndarray  # (N,) index of each agent's target, _NO_TARGET for none


class _Arrivals:
    """Agents still on their way and targets still open.

    The first arrival completes a target (docs/method.md section 1, point 5).
    """

    def __init__(self, agents: int, targets: int) -> None:
        self.flying = np.ones(agents, dtype=bool)
        self.open = np.ones(targets, dtype=bool)

    @property
    def over(self) -> bool:
        """Whether every target is reached, or no agent is left to reach one."""
        return not (self.open.any() and self.flying.any())

    def update(self, near: np.ndarray) -> bool:
        """Note which agents have arrived, targets in file order, and return whether any has.

        `near` (N, K) says which agents have come within the arrival radius of which targets.
        """
        changed = False
        if near.any():
            for target in np.flatnonzero(self.open & near.any(axis=0)):
                here = near[:, target] & self.flying
                if here.any():
                    self.flying &= ~here
                    self.open[target] = False
                    changed = True
        return changed


def fly_core(mission: Mission, seed: int, law: CoreLaw = "seed") -> CoreFlight:
    """Fly a resolved mission until every target is reached, no agent is left to reach one, or its time is up.

    Raises ValueError where the mission asks for what is not modelled here: a link that delays or loses, losses of
    agents, wind, Case II, a broadcast between two looks of the sensor, a range policy other than `arrive`, the
    objective `route`, the monolithic surrogate.
    """
    _check_modelled(mission)
    profile = profile_by_name(mission.surrogate) if law == "seed" else StepProfile()
    return _Flying(mission, seed, profile).run()


def _check_modelled(mission: Mission) -> None:
    looks = mission.broadcast_period_s / LOOK_PERIOD_S
    modelled = {
        "link": mission.link == PERFECT_LINK,
        "losses": not mission.losses,
        "wind": mission.wind == Wind(),
        "case": mission.case == "I",
        "broadcast_period_s": math.isclose(looks, round(looks)),
        "range_policy": mission.range_policy == "arrive",
        "objective": mission.objective in OBJECTIVES,
        "surrogate": mission.surrogate in PROFILE_NAMES,
    }
    missing = [key for key, is_modelled in modelled.items() if not is_modelled]
    if missing:
        raise ValueError(f"{mission.name}: {', '.join(missing)}: not modelled by the pure core")


@dataclass(frozen=True)
class _Threats:
    """The threats' radii and speed bounds from the mission, in file order, and the weights of their penalties."""

    detection_radius_m: np.ndarray  # (M,) m
    attack_radius_m: np.ndarray  # (M,) m
    speed_bound_m_s: np.ndarray  # (M,) m/s
    weights: Weights

    @classmethod
    def of(cls, mission: Mission) -> _Threats:
        """Return the threats of a mission."""
        return cls(
            np.array([threat.detection_radius_m for threat in mission.threats]),
            np.array([threat.attack_radius_m for threat in mission.threats]),
            np.array([threat.speed_bound_m_s for threat in mission.threats]),
            Weights(**mission.weights.model_dump()),
        )

    def discs(self, centres_ned_m: np.ndarray, age_s: float) -> ThreatDiscs:  # (M, 2) m
        """Return the discs where the threats were at the last broadcast, grown by what they may have moved since."""
        growth_m = self.speed_bound_m_s * age_s  # (M,)
        return ThreatDiscs(centres_ned_m, self.detection_radius_m + growth_m, self.attack_radius_m + growth_m)


class _Agents:
    """The agents of a flight, in file order: their limits, where they are and where they head."""

    def __init__(self, mission: Mission) -> None:
        self.ids = np.array([agent.id for agent in mission.agents])  # (N,)
        self.speed_m_s = [agent.speed_m_s for agent in mission.agents]
        self.n_max = [agent.n_max for agent in mission.agents]
        self._rate_rad_s = [turn_rate_rad_s(agent.speed_m_s, agent.n_max) for agent in mission.agents]
        # North m, east m and heading rad of each agent: arithmetic on ten tuples is faster than on arrays.
        self.poses = [(*agent.position_ned_m, math.radians(agent.heading_deg or 0.0)) for agent in mission.agents]
        self.ned_m = np.array(self.poses)[:, :2]  # (N, 2)
        self.commanded_rad = [pose[2] for pose in self.poses]

    def rows(self) -> np.ndarray:  # (N, 4) north m, east m, heading deg, speed m/s
        """Return the agents' true states as a trajectory has them."""
        rows = np.array([(*pose, 0.0) for pose in self.poses])
        rows[:, 2] = np.degrees(rows[:, 2]) % 360.0
        rows[:, 3] = self.speed_m_s
        return rows

    def fly(self, dt_s: float) -> None:
        """Fly for a time, turning towards the commanded headings along exact arcs."""
        self.poses = [
            turn_towards(*pose, speed_m_s, commanded_rad, rate_rad_s, dt_s)
            for pose, speed_m_s, commanded_rad, rate_rad_s in zip(
                self.poses, self.speed_m_s, self.commanded_rad, self._rate_rad_s, strict=True
            )
        ]
        self.ned_m = np.array(self.poses)[:, :2]


class _Loitering:
    """Which agents are at their targets or have none, and where each of them loiters, as on board."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._radius_m = [loiter_radius_m(a.speed_m_s, a.n_max, mission.guidance_step_s) for a in mission.agents]
        self._places_ned_m: list[tuple[float, float] | None] = [None] * len(mission.agents)
        self._latched = [False] * len(mission.agents)

    def pull(
        self, agents: _Agents, agent: int, target_ned_m: tuple[float, float] | None, heard: _Heard
    ) -> SteeringVector:
        """Return the pull on an agent: towards its target until it is there, then around its loiter circle."""
        position = agents.poses[agent][:2]
        radius_m = self._mission.arrival_radius_m * (1.0 if self._latched[agent] else ARRIVAL_SHARE)
        self._latched[agent] = target_ned_m is not None and math.dist(position, target_ned_m) <= radius_m
        if target_ned_m is not None and not self._latched[agent]:
            self._places_ned_m[agent] = None
            return attraction(position, target_ned_m)
        loiter_m, separation_m = self._radius_m[agent], self._mission.separation_m
        occupied = Occupied(
            agents.ned_m[_settled(agents.ids, agent, heard)],
            loiter_spacing_m(separation_m, loiter_m) + loiter_m,
            heard.targets_ned_m[_claimed(agent, heard)],
            claim_m(separation_m, loiter_m),
        )
        place = loiter_place(position, occupied, self._places_ned_m[agent])
        self._places_ned_m[agent] = place
        speed_m_s = self._mission.agents[agent].speed_m_s
        north_m, east_m, heading_rad = agents.poses[agent]
        lead_s = 0.5 * self._mission.guidance_step_s
        return circling((north_m, east_m, heading_rad), speed_m_s, lead_s, place, loiter_m)


def _settled(ids: np.ndarray, agent: int, heard: _Heard) -> np.ndarray:
    """Return which peers' loiter places have priority over an agent's, (N,) bool, by the rule of the world model."""
    settled: np.ndarray = (heard.assigned == _NO_TARGET) | (ids < ids[agent])
    settled[agent] = False
    return settled


def _claimed(agent: int, heard: _Heard) -> list[int]:
    """Return the indices of the targets that other agents are on their way to, but not this one."""
    return sorted({int(target) for target in heard.assigned} - {_NO_TARGET, int(heard.assigned[agent])})


class _Record:
    """The true positions of a flight, and who comes near which target."""

    def __init__(self, mission: Mission) -> None:
        self.trajectory = TrajectoryBuilder(
            [agent.id for agent in mission.agents],
            [target.id for target in mission.targets],
            [threat.id for threat in mission.threats],
        )
        self._passages = Passages(mission)

    def add(self, t_s: float, agents: np.ndarray, targets: np.ndarray, threats: np.ndarray) -> np.ndarray:
        """Record rows; return (N, K) bool, who came within the arrival radius of what since the last ones."""
        self.trajectory.append(t_s, agents, targets, threats)
        return self._passages.near(t_s, agents, targets)


class _Flying:
    """A flight in progress; N agents, K targets, M threats in file order."""

    def __init__(self, mission: Mission, seed: int, profile: RadialProfile) -> None:
        self._mission = mission
        self._profile = profile
        self._threats = _Threats.of(mission)
        self._world = World(mission, seed)
        self._agents = _Agents(mission)
        self._loitering = _Loitering(mission)
        self._true_arrivals = _Arrivals(len(mission.agents), len(mission.targets))
        self._seen_arrivals = _Arrivals(len(mission.agents), len(mission.targets))
        self._assigned = np.full(len(mission.agents), _NO_TARGET)
        self._heard: _Heard | None = None
        self._turn_limited = 0
        self._record = _Record(mission)

    def run(self) -> CoreFlight:
        """Fly to the end and return the flight."""
        mission = self._mission
        dt_s = mission.integration_step_s
        guide_every = round(mission.guidance_step_s / dt_s)
        last_tick = int(mission.max_time_s / dt_s + _TOLERANCE_S)
        next_look_s = next_assignment_s = next_broadcast_s = 0.0
        step_us = []
        spent_ns = 0
        seen = np.zeros((len(mission.agents), len(mission.targets)), dtype=bool)
        for tick in range(last_tick + 1):
            t_s = tick * dt_s
            self._world.advance(t_s)
            targets, threats = self._world.rows()
            near = self._record.add(t_s, self._agents.rows(), targets, threats)
            seen |= near
            self._true_arrivals.update(near)
            if self._true_arrivals.over or tick == last_tick:
                break
            began_ns = time.perf_counter_ns()
            if t_s >= next_look_s - _TOLERANCE_S:
                next_look_s += LOOK_PERIOD_S
                changed = self._seen_arrivals.update(seen)
                seen[:] = False
                due = t_s >= next_assignment_s - _TOLERANCE_S
                if changed or due:
                    self._assign(targets[:, :2])
                if due:
                    next_assignment_s += mission.assignment_period_s
            if t_s >= next_broadcast_s - _TOLERANCE_S:
                next_broadcast_s += mission.broadcast_period_s
                self._heard = _Heard(t_s, targets[:, :2], threats[:, :2], self._assigned.copy())
            if tick % guide_every == 0:
                self._guide(t_s)
            spent_ns += time.perf_counter_ns() - began_ns
            if tick % guide_every == 0:
                step_us.append(spent_ns / 1000.0)
                spent_ns = 0
            self._agents.fly(dt_s)
        return CoreFlight(self._record.trajectory.build(), len(step_us), np.array(step_us), self._turn_limited)

    def _assign(self, targets_ned_m: np.ndarray) -> None:
        """Assign one of the open targets (K, 2) to every agent on its way, as far as there are enough."""
        flying, open_targets = np.flatnonzero(self._seen_arrivals.flying), np.flatnonzero(self._seen_arrivals.open)
        objective: Objective = "inverse-distance" if self._mission.objective == "inverse-distance" else "distance"
        chosen = assign(self._agents.ned_m[flying], targets_ned_m[open_targets], objective)
        self._assigned[:] = _NO_TARGET
        served = chosen >= 0
        self._assigned[flying[served]] = open_targets[chosen[served]]

    def _guide(self, t_s: float) -> None:
        """Decide every agent's heading for the next step (paper: direct1, unitdirect)."""
        mission, agents, heard = self._mission, self._agents, self._heard
        assert heard is not None  # the first broadcast goes out before the first step
        discs = self._threats.discs(heard.threats_ned_m, t_s - heard.t_s)
        gradient_m = surrogate_gradient(
            self._profile, agents.ned_m, discs, mission.separation_m, self._threats.weights
        ).tolist()
        targets = heard.targets_ned_m.tolist()
        for agent, (_, _, heading_rad) in enumerate(agents.poses):
            target = int(heard.assigned[agent])
            target_ned_m = None if target == _NO_TARGET else (targets[target][0], targets[target][1])
            pull = self._loitering.pull(agents, agent, target_ned_m, heard)
            wanted = SteeringVector(pull.north_m - gradient_m[agent][0], pull.east_m - gradient_m[agent][1])
            agents.commanded_rad[agent], limited = limit_turn(
                heading_rad,
                wanted.heading_rad if wanted.strength_m > 0.0 else heading_rad,
                agents.speed_m_s[agent],
                agents.n_max[agent],
                mission.guidance_step_s,
            )
            self._turn_limited += limited
