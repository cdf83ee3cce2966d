"""Case II: where each agent must be by now, found by flying its own companion on what was broadcast to it.

The centre does not see its agents (docs/method.md section 1, point 7; paper: update2). It knows where they began, what
each was told and what steers them, so it lets a companion of its own, the very code that flies, decide for each of
them, and moves the agent as that says. How far off it may be is an uncertainty that grows with time, by the bound of
the wind too, and shrinks when the agent is heard of. It is no bound where frames are lost or an autopilot lags: a
vehicle that missed a broadcast flies on for a broadcast period as it did before.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from companion.autopilot.point import PointAdapter
from companion.autopilot.telemetry import Neighbour
from companion.geo.kinematics import advance, turn_rate_rad_s, turn_towards
from companion.geo.local_frame import LocalFrame
from companion.guidance.laws import SteeringOf
from companion.guidance.settings import LawName
from companion.mission.model import AgentSpec, Mission
from companion.onboard.companion import Companion
from companion.onboard.config import config_for_agent
from companion.onboard.law_settings import law_settings

DRIFT_SHARE = 0.01
"""Of the distance that an agent may have flown: how much of it the reckoning may be wrong by in still air."""
FIX_ERROR_M = 10.0
"""What a report, or a place in the mission file, is wrong by: a satellite fix, and the step that it was made in."""
_TOLERANCE_S = 1e-6


@dataclass(frozen=True)
class Estimate:
    """Where an agent must be, and how far off that may be."""

    north_m: float
    east_m: float
    heading_rad: float
    speed_m_s: float
    flown_m: float
    uncertainty_m: float


@dataclass(frozen=True)
class Fix:
    """Where an agent said that it was."""

    position_ned_m: tuple[float, float]
    velocity_m_s: tuple[float, float]
    """(north, east), from grid north."""
    fixed_at_s: float
    flown_m: float | None = None
    """None: the reckoned distance stands."""


@dataclass(frozen=True)
class VehicleModel:
    """What the agents are reckoned to fly by."""

    law: LawName = "seed"
    can_stop: bool = False
    steering: SteeringOf | None = None
    """Makes the law that they fly by, where it is not one of the companion's own."""


class DeadReckoner:
    """Reckons all agents of one mission; times are Unix seconds given by the caller."""

    def __init__(self, mission: Mission, now_s: float, model: VehicleModel) -> None:
        """Begin with the agents where the mission says."""
        self._delay_s = mission.link.delay_s
        self._step_s = mission.guidance_step_s
        self._detector_range_m = mission.detector_range_m
        self._wind_bound_m_s = mission.wind.speed_m_s + mission.wind.gust_m_s
        self._start_s = self._at_s = now_s
        self._steps = 0
        self._decided = False
        frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        self._agents = {spec.id: _ReckonedAgent(mission, spec, frame, now_s, model) for spec in mission.agents}
        self._under_way: list[tuple[float, int, bytes]] = []
        self._heard = 0

    def hear(self, datagram: bytes, now_s: float) -> None:
        """Take in a frame that was broadcast at `now_s`: the agents hear it when the link has carried it."""
        self._heard += 1
        heapq.heappush(self._under_way, (now_s + self._delay_s, self._heard, datagram))

    def advance(self, now_s: float, flying: Collection[int]) -> None:
        """Let the agents `flying`, by id, decide and move until `now_s`; the others stay where they are."""
        moving = [self._agents[identity] for identity in self._agents if identity in flying]
        while self._at_s < now_s - _TOLERANCE_S:
            if not self._decided:
                self._decide(moving)
            if self._at_s + self._step_s > now_s + _TOLERANCE_S:
                break  # within a step the agents fly on as decided at its beginning
            for agent in moving:
                agent.move(self._step_s)
            self._decided = False
            # Counted, not summed: rounding must not creep over thousands of steps.
            self._steps += 1
            self._at_s = self._start_s + self._steps * self._step_s

    def _decide(self, moving: Sequence[_ReckonedAgent]) -> None:
        """Let the agents hear what has arrived by now, see each other, and decide."""
        while self._under_way and self._under_way[0][0] <= self._at_s + _TOLERANCE_S:
            arrival_s, _, datagram = heapq.heappop(self._under_way)
            for agent in self._agents.values():
                agent.companion.hear(datagram, arrival_s)
        for agent in moving:
            agent.look(moving, self._detector_range_m, self._at_s)
        for agent in moving:
            agent.decide(self._at_s)
        self._decided = True

    def fix(self, agent_id: int, fix: Fix) -> None:
        """Put an agent where it was heard or seen to be."""
        self._agents[agent_id].fix(fix, self._at_s)

    def estimate(self, agent_id: int, now_s: float) -> Estimate:
        """Return where an agent must be by `now_s`, which is not before the last step."""
        agent = self._agents[agent_id]
        motion = agent.motion.ahead(agent.spec.n_max, now_s - self._at_s)
        rate_m_s = DRIFT_SHARE * agent.spec.speed_m_s + self._wind_bound_m_s
        return Estimate(
            motion.north_m,
            motion.east_m,
            motion.heading_rad,
            motion.speed_m_s,
            agent.companion.flown_m,
            FIX_ERROR_M + rate_m_s * max(0.0, now_s - agent.fixed_at_s),
        )


@dataclass(frozen=True)
class _Motion:
    """Where a reckoned agent is, and how it flies on from there."""

    north_m: float
    east_m: float
    heading_rad: float
    speed_m_s: float
    commanded_rad: float
    """The heading that it turns to."""
    circles: bool = False
    """It turns on and on instead."""

    def ahead(self, n_max: float, dt_s: float) -> _Motion:
        """Return the motion a time later, flown on as last decided."""
        rate_rad_s = turn_rate_rad_s(self.speed_m_s, n_max)
        pose = (self.north_m, self.east_m, self.heading_rad, self.speed_m_s)
        if self.circles:
            north_m, east_m, heading_rad = advance(*pose, rate_rad_s, dt_s)
        else:
            north_m, east_m, heading_rad = turn_towards(*pose, self.commanded_rad, rate_rad_s, dt_s)
        return replace(self, north_m=north_m, east_m=east_m, heading_rad=heading_rad)


class _ReckonedAgent:
    """One agent as it must be by now."""

    def __init__(self, mission: Mission, spec: AgentSpec, frame: LocalFrame, now_s: float, model: VehicleModel) -> None:
        config = config_for_agent(mission, spec.id, model.law)
        law = None if model.steering is None else model.steering(law_settings(config))
        self.spec = spec
        heading_rad = math.radians(spec.heading_deg or 0.0)
        speed_m_s = 0.0 if model.can_stop else spec.speed_m_s
        self.motion = _Motion(*spec.position_ned_m, heading_rad, speed_m_s, heading_rad)
        self._adapter = PointAdapter(model.can_stop, frame.to_global(*spec.position_ned_m), config.height_m)
        self.companion = Companion(config, self._adapter, law)
        self.fixed_at_s = now_s
        self._frame = frame
        self._altitude_m = mission.origin.alt_m + config.height_m

    def look(self, others: Iterable[_ReckonedAgent], range_m: float, now_s: float) -> None:
        """See who is near, as the vehicle's own detector would."""
        here = self.motion
        self._adapter.neighbours = [
            other.as_neighbour(now_s)
            for other in others
            if other is not self
            and math.hypot(other.motion.north_m - here.north_m, other.motion.east_m - here.east_m) <= range_m
        ]

    def as_neighbour(self, now_s: float) -> Neighbour:
        """Return the agent as a neighbour's detector would see it."""
        motion = self.motion
        lat_deg, lon_deg, convergence_rad = self._frame.to_global_with_convergence(motion.north_m, motion.east_m)
        course_rad = motion.heading_rad + convergence_rad
        velocity_m_s = (motion.speed_m_s * math.cos(course_rad), motion.speed_m_s * math.sin(course_rad))
        return Neighbour(self.spec.id, lat_deg, lon_deg, *velocity_m_s, now_s, self._altitude_m)

    def decide(self, now_s: float) -> None:
        """Let the companion decide, and fly by that from now on."""
        self._adapter.tell(self.as_neighbour(now_s), None, now_s)
        self._adapter.setpoint = None
        decision, _ = self.companion.tick(now_s)
        setpoint = self._adapter.setpoint
        motion = self.motion
        if setpoint is not None:
            motion = replace(motion, commanded_rad=setpoint.heading_rad, speed_m_s=setpoint.speed_m_s)
        # Until its companion has a picture, what cannot stop circles where it is.
        self.motion = replace(motion, circles=decision.setpoint is None and not self._adapter.can_stop)

    def move(self, dt_s: float) -> None:
        """Fly on for a time."""
        self.motion = self.motion.ahead(self.spec.n_max, dt_s)

    def fix(self, fix: Fix, reckoned_at_s: float) -> None:
        """Go where the agent was heard to be, carried on by its velocity to the moment up to which it is reckoned."""
        since_s = reckoned_at_s - fix.fixed_at_s
        (north_m, east_m), (north_m_s, east_m_s) = fix.position_ned_m, fix.velocity_m_s
        self.motion = replace(self.motion, north_m=north_m + north_m_s * since_s, east_m=east_m + east_m_s * since_s)
        speed_m_s = math.hypot(north_m_s, east_m_s)
        if speed_m_s > 0.0:
            heading_rad = math.atan2(east_m_s, north_m_s)
            self.motion = replace(self.motion, heading_rad=heading_rad, commanded_rad=heading_rad)
        flown_m = self.companion.flown_m if fix.flown_m is None else fix.flown_m + max(0.0, since_s) * speed_m_s
        self.companion.relocate(flown_m)
        self.fixed_at_s = fix.fixed_at_s
